/* budget.c - finds limits by which the training of a block fits into a memory budget (--ram), and into a
 * device's (--device-ram), by the predictions of cost.c.
 *
 * The image cache is reduced first, then an SH degree that is `auto`, the expected number of Gaussians and
 * the size of the blocks. Without --ram, a run that would exceed the free memory is planned as if --ram were
 * that much; run.json records the number.
 *
 * Invariant: the result depends on the survey, the options and that number alone, not on the memory that a
 * later machine has free.
 */
#include "large.h"
#include "../survey/scene.h"
#include "os_job.h"

/* Plans with this fraction of the budget: predictions are right within about 10 %. */
#define BUDGET_MARGIN 0.9
/* Makes room in a block for this factor of the Gaussians that it starts with, or for
 * BUDGET_EXPECTED, if that is less. */
#define BUDGET_GROWTH 1.25
/* Predicts the Gaussians that a block ends with, as a factor of those at its start; if they fit, no limit is
 * reduced (docs/log/SCALE.md). */
#define BUDGET_EXPECTED 1.5
#define BUDGET_ADVICE 1.1  /* Multiplies the least budget for the one that an error names. */
#define BUDGET_TRIED 1.04  /* Multiplies a budget for the next one that is tried, */
#define BUDGET_MOST 1e7    /* up to so many MiB. */
#define BUDGET_POINTS 1000 /* Bounds the points of a block from below. */
/* Limits the SH degree if memory is short: more Gaussians are worth more than
 * degree 3 (docs/log/SCALE.md). */
#define BUDGET_SH 1

static int budget_is_limited(const oxl_job_options *o)
{
    return o->ram > 0 || o->device_ram > 0;
}

/* Bytes grow in a straight line with the Gaussians. */
OXL_INTERNAL double budget_max_gaussians(const struct cost_load *load, const oxl_job_options *o)
{
    const double host = cost_memory(o, load, 0), device = cost_device_memory(o, load, 0);
    double most = JOB_GAUSSIANS_MAX;
    if (o->ram)
        most = OXL_MIN(most, (BUDGET_MARGIN * (double)o->ram - host) / (cost_memory(o, load, 1) - host));
    if (o->device_ram)
        most = OXL_MIN(most, (BUDGET_MARGIN * (double)o->device_ram - device) /
                                 (cost_device_memory(o, load, 1) - device));
    return OXL_MAX(0, floor(most));
}

/* Returns the Gaussians that a run is not expected to exceed, or fewer if the images allow fewer. */
static double budget_wanted(const oxl_job_options *o, const struct cost_load *load)
{
    return fmin(BUDGET_EXPECTED * cost_gaussians(o, load),
                (double)schedule_gaussian_cap_of(load->points, load->schedule_pixels, &o->train));
}

OXL_INTERNAL int budget_limit_gaussians(const struct cost_load *load, oxl_job_options *o)
{
    const double most = (double)schedule_gaussian_cap_of(load->points, load->schedule_pixels, &o->train);
    double gaussians;
    if (!budget_is_limited(o)) return 1;
    o->scene.image_cache_bytes = cost_cache(o);
    gaussians = OXL_MIN(most, budget_max_gaussians(load, o));
    if (o->train.sh_degree < 0 && gaussians < floor(budget_wanted(o, load))) {
        o->train.sh_degree = BUDGET_SH;
        gaussians = OXL_MIN(most, budget_max_gaussians(load, o));
    }
    o->train.max_gaussians = (int)gaussians;
    return gaussians >= 1;
}

OXL_INTERNAL int budget_fit(const struct cost_load *load, oxl_job_options *o)
{
    oxl_job_options fitted = *o;
    const double needed = OXL_MIN(BUDGET_GROWTH * (double)load->points, budget_wanted(o, load));
    if (!budget_is_limited(o)) return 1;
    if (!budget_limit_gaussians(load, &fitted) || fitted.train.max_gaussians < floor(needed)) return 0;
    *o = fitted;
    return 1;
}

/* Returns a sufficient budget in MiB, of the device or of --ram: a tenth above what the predictions allow,
 * since they differ between a survey and its one block, and files are read meanwhile. */
static double budget_needed(const struct cost_load *load, const oxl_job_options *o, int device)
{
    oxl_job_options tried;
    double mb = 1;
    do {
        mb = ceil(BUDGET_TRIED * mb);
        tried = *o;
        tried.ram = device ? 0 : (size_t)(mb * 1048576);
        tried.device_ram = device ? (size_t)(mb * 1048576) : 0;
    } while (!budget_fit(load, &tried) && mb < BUDGET_MOST);
    return ceil(BUDGET_ADVICE * mb);
}

OXL_INTERNAL oxl_result budget_refuse(oxl_context *ctx, const struct cost_load *load,
                                      const oxl_job_options *o)
{
    oxl_job_options host = *o;
    int device;
    double needed;
    host.device_ram = 0;
    device = o->device_ram > 0 && budget_fit(load, &host);
    needed = budget_needed(load, o, device);
    return oxl_fail(
        ctx, OXL_ERR_BUDGET,
        "%.0f MB%s are too little for %zu points and images of %.1f megapixels, which need %.0f MB\n"
        "fix: --%sram %.0fM, or a smaller --max-side, or --sh-degree 0",
        (double)(device ? o->device_ram : o->ram) / 1e6, device ? " of the device" : "", load->points,
        load->largest / 1e6, needed * 1048576 / 1e6, device ? "device-" : "", needed);
}

/* ---------------- blocks that fit */

/* Returns 1 if each block fits; otherwise *worst is the load of the largest one that does not. */
static int budget_fits_all(const oxl_scene *scene, const struct partition *p, const oxl_job_options *o,
                           struct cost_load *worst)
{
    double most = 0;
    for (int k = 0; k < p->block_count; k++) {
        oxl_job_options tried = *o;
        const struct cost_load load =
            p->block_count > 1 ? cost_load_of_block(p, k) : cost_load_of_scene(scene);
        const double bytes = cost_memory(o, &load, (double)load.points);
        if (bytes > most && !budget_fit(&load, &tried)) *worst = load, most = bytes;
    }
    return most == 0;
}

OXL_INTERNAL size_t budget_limit(const oxl_scene *scene, const oxl_job_options *o)
{
    const struct cost_load load = cost_load_of_scene(scene);
    const double most = (double)schedule_gaussian_cap(scene, &o->train), free = (double)os_memory_free();
    const int is_open = o->ram == 0 && o->partition.kind != OXL_PARTITION_NONE && o->partition.blocks == 0 &&
                        o->partition.block_points == 0 && free > 0; /* memory decides on blocks */
    return is_open && cost_memory(o, &load, most) > BUDGET_MARGIN * free ? (size_t)free : o->ram;
}

/* Doubles the number of blocks until each fits `limited`, or refuses the limits of o. */
static oxl_result budget_divide(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *o,
                                const oxl_job_options *limited, struct partition *out)
{
    oxl_partition_options tried = o->partition;
    struct cost_load worst;
    oxl_result rc = OXL_OK;
    while (rc == OXL_OK && !budget_fits_all(scene, out, limited, &worst)) {
        tried.blocks = 2 * OXL_MAX(tried.blocks, out->block_count);
        tried.block_points = 0;
        partition_free(ctx, out);
        if (tried.kind == OXL_PARTITION_NONE || scene->stats.points / (size_t)tried.blocks < BUDGET_POINTS)
            return budget_refuse(ctx, &worst, o);
        rc = partition_make(ctx, scene, &tried, out);
    }
    return rc;
}

OXL_INTERNAL oxl_result budget_partition(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *o,
                                         double memory, struct partition *out)
{
    /* MiB that reading the survey needs */
    const double reading = o->ram ? ceil((double)os_peak_rss() / BUDGET_MARGIN / 1048576) : 0;
    oxl_job_options limited = *o;
    oxl_result rc = partition_make(ctx, scene, &o->partition, out);
    limited.ram = memory >= 0 ? (size_t)memory : OXL_MAX(budget_limit(scene, o), (size_t)reading * 1048576);
    if (rc == OXL_OK && budget_is_limited(&limited)) rc = budget_divide(ctx, scene, o, &limited, out);
    if (rc == OXL_OK && o->ram && limited.ram > o->ram)
        rc = oxl_fail(ctx, OXL_ERR_BUDGET,
                      "reading the survey alone takes %.0f MB, but --ram allows %.0f MB\nfix: --ram %.0fM",
                      BUDGET_MARGIN * (double)limited.ram / 1e6, (double)o->ram / 1e6, reading);
    /* Continues without a limit that nobody set: the run may swap. */
    if (rc == OXL_ERR_BUDGET && !budget_is_limited(o)) {
        oxl_log(ctx, OXL_LOG_WARNING, "%.0f MB of memory are free, too little for blocks of any size",
                (double)limited.ram / 1e6);
        rc = partition_make(ctx, scene, &o->partition, out);
        limited.ram = 0;
    }
    out->memory = (double)limited.ram;
    return rc;
}

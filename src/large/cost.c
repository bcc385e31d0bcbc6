/* cost.c - predicts Gaussians, memory and time of training.
 *
 * Gaussians follow from a first look (src/train/forecast.c), memory from counts, with the measured constants
 * below. Time is extrapolated from the steps of the look; for blocks, and without a look, it is computed from
 * counts as well.
 */
#include "partition.h"
#include "large.h"

#include "../core/simd.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"

/* Lists constants measured on 2 cores with AVX-512, on surveys of 5 000 to 30 000
 * points (docs/log/SPEED.md). */
/* Counts (Gaussian, pixel) pairs evaluated forward per pixel; backward costs 2.5 times as much. */
#define COST_PAIRS_PER_PIXEL 40.0
#define COST_PAIR_RATE 1.0e9      /* Counts pairs per second and thread, with AVX2 or better. */
#define COST_PAIR_RATE_BASE 0.2e9 /* Counts pairs per second and thread, without AVX2. */
/* Counts s per pixel for SSIM forward and backward, and for the image's conversion to float. */
#define COST_PIXEL_COST 1.0e-7
#define COST_GAUSSIAN_COST 6.0e-8 /* Counts s per Gaussian for projection, binning and Adam. */
#define COST_PIXEL_BYTES 160.0    /* Counts bytes of working memory per pixel: images, SSIM's maps. */
#define COST_PROGRAM_BYTES 1.2e7  /* Counts bytes of the program itself; measured: 9 to 10 MB. */
/* Counts bytes per row on a device, as backends/vulkan reserves them. */
#define COST_DEVICE_ROW 110.0
#define COST_DEVICE_PAIR 84.0   /* Counts bytes per (tile, splat) pair on a device. */
#define COST_DEVICE_PAIRS 8.0   /* Counts pairs per row in a view of all Gaussians. */
#define COST_DEVICE_PIXEL 125.0 /* Counts bytes per pixel of loss and image on a device. */
#define COST_DEVICE_BYTES 2e6   /* Counts bytes on a device that do not grow. */
/* Multiplies the bytes on a device that grow with the Gaussians: a quarter more is reserved. */
#define COST_DEVICE_ROOM 1.25
/* Multiplies the time of a run in several blocks, each of which is rendered with Gaussians
 * of others (docs/SCALE.md). */
#define COST_CONTEXT 1.25
/* Judges a training view for each 20 iterations of a run: judging one takes about as long as an iteration. */
#define COST_JUDGED 20
#define COST_JUDGED_MIN 6 /* Bounds the number of judged views from below. */
/* Counts s for the files of a result, with the report. */
#define COST_FILES 0.1
/* Counts s for a held-out view, whose metrics, renders and place in the report the CPU makes: for the view
 * and for each of its pixels. */
#define COST_HELD_OUT 0.03
#define COST_HELD_OUT_PIXEL 6e-7
/* Counts s per pixel of a training view that is judged. */
#define COST_JUDGED_PIXEL 1e-7
/* Limits a preset's iterations per image: more overfit (docs/TRADEOFF.md). */
#define COST_STEPS_PER_IMAGE 700
/* Bounds the error of times computed from counts: they are right within this factor. */
#define COST_WITHIN 3.0
/* Bounds the error of times extrapolated from the steps of a look: they are right within this factor. */
#define COST_WITHIN_LOOK 1.7

OXL_INTERNAL int cost_iterations(const oxl_job_options *o, int images)
{
    const double more = OXL_MAX(1, (double)images / OXL_MAX(1, o->iterations_for));
    const double most = (double)COST_STEPS_PER_IMAGE * OXL_MAX(1, images);
    if (o->iterations_for == 0) return o->train.iterations;
    return (int)OXL_MIN(OXL_MIN(more * o->train.iterations, most), INT_MAX);
}

OXL_INTERNAL struct cost_load cost_load_of_scene(const oxl_scene *scene)
{
    const struct scene_stats *stats = &scene->stats;
    struct cost_load load = {.points = stats->points ? stats->points : scene_start_count(scene),
                             .begun = stats->begun,
                             .share = stats->splitting,
                             .observations = stats->observations,
                             .views = stats->views,
                             .schedule_pixels = schedule_pixels(scene)};
    for (int i = 0; i < oxl_scene_view_count(scene); i++) {
        const oxl_camera *c = &oxl_scene_view(scene, i)->camera;
        const double pixels = (double)c->width * c->height;
        load.pixels += pixels;
        load.largest = OXL_MAX(load.largest, pixels);
        load.largest_file = OXL_MAX(load.largest_file, scene_file_pixels(scene, i));
    }
    return load;
}

OXL_INTERNAL struct cost_load cost_load_of_block(const struct partition *p, int block)
{
    const struct partition_plan *plan = p->plan;
    const struct partition_block *b = &p->block[block];
    const size_t views = (size_t)oxl_scene_view_count(plan->scene);
    const double size = (double)OXL_MAX(b->points, (size_t)1);
    struct cost_load load = {.points = b->points,
                             .begun = plan->scene->stats.begun,
                             .share = plan->scene->stats.splitting,
                             .observations = plan->scene->stats.observations,
                             .survey = (sizeof(struct colmap_point) + sizeof(oxl_point)) *
                                       (double)(plan->scene->stats.points - b->points),
                             .context = OXL_MAX(0, (double)b->start_points / size - 1)};
    for (size_t v = 0; v < views; v++) {
        const oxl_camera *c = &oxl_scene_view(plan->scene, (int)v)->camera;
        if (plan->role[(size_t)block * views + v] == PARTITION_OUT) continue;
        load.views++;
        load.pixels += (double)c->width * c->height;
        load.largest = OXL_MAX(load.largest, (double)c->width * c->height);
        load.largest_file = OXL_MAX(load.largest_file, scene_file_pixels(plan->scene, (int)v));
    }
    load.schedule_pixels =
        schedule_pixels(plan->scene) * size / (double)OXL_MAX(plan->scene->stats.points, (size_t)1);
    return load;
}

/* Returns 1 if the run may end with a model that viewers show wrongly, and refine another one. */
static int cost_may_refine(const oxl_train_options *o, int plain)
{
    return (!plain && (o->exposure != OXL_OFF || o->medium != OXL_OFF)) || o->dog != OXL_DOG_OFF;
}

OXL_INTERNAL double cost_memory(const oxl_job_options *o, const struct cost_load *load, double gaussians)
{
    const int degree = o->train.sh_degree < 0 ? 3 : o->train.sh_degree;
    const double planes = OXL_SH + 3.0 * (degree + 1) * (degree + 1);
    const double cache =
        image_cache_bytes((double)o->scene.image_cache_bytes, load->pixels, load->largest_file);
    const double depths = parts_bytes(&o->train, (double)load->observations, load->views);
    /* Counts sets of planes: parameters and two moments; a trial keeps two more copies of each, in memory
     * that grows by quarters; a model for viewers is refined beside the one that it begins with. */
    const double refined = cost_may_refine(&o->train, load->plain) ? 4 : 3,
                 sets = parts_trials(&o->train) > 0 ? 3 + 2 * 3 * 1.25 : refined;
    return COST_PROGRAM_BYTES + cache + load->largest * COST_PIXEL_BYTES +
           gaussians * (sets * 4 * planes + COST_SPLAT_BYTES) +
           gaussians * load->context * (4 * planes + COST_SPLAT_BYTES) +
           (double)load->observations * sizeof(struct colmap_track) + load->survey + depths;
}

OXL_INTERNAL double cost_device_memory(const oxl_job_options *o, const struct cost_load *load,
                                       double gaussians)
{
    const int degree = o->train.sh_degree < 0 ? 3 : o->train.sh_degree;
    const double planes = OXL_SH + 3.0 * (degree + 1) * (degree + 1) + MODEL_LOBE_PLANES;
    const double a_row = COST_DEVICE_ROW + COST_DEVICE_PAIRS * COST_DEVICE_PAIR;
    return COST_DEVICE_BYTES + load->largest * COST_DEVICE_PIXEL +
           COST_DEVICE_ROOM * gaussians * (3 * 4 * planes + a_row + load->context * (4 * planes + a_row));
}

OXL_INTERNAL double cost_gaussians(const oxl_job_options *o, const struct cost_load *load)
{
    const size_t cap = schedule_gaussian_cap_of(load->points, load->schedule_pixels, &o->train);
    const double start = (double)load->points * (load->begun > 0 ? load->begun : 1);
    return OXL_MIN(forecast_gaussians(&o->train, start, load->share, (double)cap), (double)cap);
}

OXL_INTERNAL struct cost cost_estimate(const oxl_context *ctx, const oxl_job_options *o,
                                       const struct cost_load *load)
{
    const double a_view = load->pixels / OXL_MAX(1, load->views);
    const double rate = (ctx->isa == ISA_BASE ? COST_PAIR_RATE_BASE : COST_PAIR_RATE) * ctx->threads;
    struct cost cost = {.gaussians = cost_gaussians(o, load)};
    const double step = 3.5 * COST_PAIRS_PER_PIXEL * a_view / rate +
                        (COST_PIXEL_COST * a_view + COST_GAUSSIAN_COST * cost.gaussians) / ctx->threads;
    cost.seconds = o->train.iterations * step;
    if (o->train.max_seconds > 0) cost.seconds = OXL_MIN(cost.seconds, o->train.max_seconds);
    cost.memory = cost_memory(o, load, cost.gaussians);
    return cost;
}

/* Returns 1 if the options request several blocks. */
static int cost_has_blocks(const oxl_job_options *o, size_t points)
{
    const size_t most = (size_t)o->partition.block_points;
    return o->partition.kind != OXL_PARTITION_NONE &&
           (o->partition.blocks > 1 || (most > 0 && points > most));
}

OXL_INTERNAL int cost_judged_views(const oxl_scene *scene, int iterations)
{
    return OXL_MIN(OXL_MAX(iterations / COST_JUDGED, COST_JUDGED_MIN), schedule_training_views(scene));
}

OXL_INTERNAL int cost_evaluated_views(const oxl_scene *scene, int iterations)
{
    const int training = schedule_training_views(scene), held_out = oxl_scene_view_count(scene) - training;
    return held_out > 0 ? held_out + cost_judged_views(scene, iterations) : training;
}

OXL_INTERNAL double cost_range(const oxl_job_options *o, double seconds, int timed, double range[2])
{
    const double limit = o->train.max_seconds > 0 ? o->train.max_seconds : HUGE_VAL,
                 within = timed ? COST_WITHIN_LOOK : COST_WITHIN;
    range[0] = OXL_MIN(seconds / within, limit), range[1] = OXL_MIN(seconds * within, limit);
    return OXL_MIN(seconds, limit);
}

OXL_INTERNAL double cost_evaluation(const oxl_scene *scene, const oxl_job_options *o)
{
    const int training = schedule_training_views(scene), held_out = oxl_scene_view_count(scene) - training;
    const double a_view = schedule_pixels(scene) / OXL_MAX(1, training);
    return COST_FILES + held_out * (COST_HELD_OUT + COST_HELD_OUT_PIXEL * a_view) +
           cost_judged_views(scene, o->train.iterations) * COST_JUDGED_PIXEL * a_view;
}

OXL_INTERNAL double cost_seconds(const oxl_scene *scene, const oxl_job_options *o, const struct cost *cost,
                                 const struct look *look, double range[2])
{
    const double all = cost_has_blocks(o, oxl_scene_point_count(scene)) ? COST_CONTEXT : 1,
                 cap = (double)schedule_gaussian_cap(scene, &o->train),
                 seconds = look->steps ? forecast_seconds(scene, &o->train, look, cap,
                                                          cost_evaluated_views(scene, o->train.iterations),
                                                          viewer_hiding_steps(viewer_steps(&o->train)))
                                       : cost->seconds;
    return cost_range(o, seconds * all, look->steps, range);
}

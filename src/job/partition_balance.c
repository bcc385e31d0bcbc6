/* partition_balance.c - measures the balance of the blocks and predicts the cost of each, for the command
 * `partition`.
 *
 * Measures: largest / mean, the relative run time with one machine per block, and the coefficient of
 * variation. Both kinds of cut are measured, balanced and midpoint.
 */
#include "../large/partition.h"
#include "job.h"
#include "../survey/scene.h"

/* ---------------- one block */

static struct oxl_block balance_block(const oxl_context *ctx, const struct partition *p, int block,
                                      const oxl_job_options *o)
{
    const struct partition_block *b = &p->block[block];
    const struct cost_load load = cost_load_of_block(p, block);
    oxl_job_options fitted = *o;
    struct cost cost;
    budget_fit(ctx, &load, &fitted);
    cost = cost_estimate(ctx, &fitted, &load);
    return (oxl_block){.points = b->points,
                       .start_points = b->start_points,
                       .base_views = b->base_views,
                       .border_views = b->border_views,
                       .gaussians = cost.gaussians,
                       .memory = cost.memory,
                       .seconds = cost.seconds};
}

/* ---------------- all of them */

struct balance_sum {
    double sum, square, largest;
};

static void balance_add(struct balance_sum *s, double x)
{
    s->sum += x;
    s->square += x * x;
    s->largest = OXL_MAX(s->largest, x);
}

static void balance_measure(const struct balance_sum *s, int count, double *peak, double *spread)
{
    const double mean = s->sum / count, variance = s->square / count - mean * mean;
    *peak = mean > 0 ? s->largest / mean : 1;
    *spread = mean > 0 ? sqrt(OXL_MAX(variance, 0)) / mean : 0;
}

OXL_INTERNAL oxl_balance balance_summary(const oxl_block *block, int count)
{
    struct balance_sum points = {0}, views = {0};
    oxl_balance b = {.blocks = count};
    for (int i = 0; i < count; i++) {
        balance_add(&points, (double)block[i].points);
        balance_add(&views, block[i].base_views + block[i].border_views);
        b.memory = OXL_MAX(b.memory, block[i].memory);
        b.longest = OXL_MAX(b.longest, block[i].seconds);
        b.seconds += block[i].seconds;
    }
    balance_measure(&points, count, &b.points_peak, &b.points_spread);
    balance_measure(&views, count, &b.views_peak, &b.views_spread);
    return b;
}

/* Predicts the cost of each block into *blocks, which is allocated. */
static oxl_result balance_blocks(oxl_context *ctx, const struct partition *p, const oxl_job_options *o,
                                 oxl_block **blocks)
{
    *blocks = oxl_alloc(ctx, (size_t)p->block_count, sizeof **blocks);
    if (!*blocks) return OXL_ERR_MEMORY;
    for (int i = 0; i < p->block_count; i++) (*blocks)[i] = balance_block(ctx, p, i, o);
    return OXL_OK;
}

/* Measures the balance of the other kind of cut. */
static oxl_result balance_alternative(oxl_context *ctx, const struct partition *p, const oxl_job_options *o,
                                      oxl_balance *out)
{
    oxl_job_options other = *o;
    oxl_block *blocks = NULL;
    struct partition q;
    oxl_result rc;
    other.partition.cut = o->partition.cut == OXL_CUT_MIDPOINT ? OXL_CUT_BALANCED : OXL_CUT_MIDPOINT;
    rc = partition_variant(ctx, p, &other.partition, &q);
    if (rc == OXL_OK) rc = balance_blocks(ctx, &q, &other, &blocks);
    if (rc == OXL_OK) *out = balance_summary(blocks, q.block_count);
    oxl_free(ctx, blocks);
    partition_free(ctx, &q);
    return rc;
}

OXL_INTERNAL oxl_result partition_report(oxl_context *ctx, const struct partition *p,
                                         const oxl_job_options *o, oxl_partition_report *out)
{
    oxl_result rc;
    *out = (oxl_partition_report){
        .dimensions = p->dimensions, .cut = o->partition.cut, .block_count = p->block_count};
    memcpy(out->extent, p->extent, sizeof out->extent);
    rc = balance_blocks(ctx, p, o, &out->block);
    if (rc == OXL_OK) out->balance[o->partition.cut] = balance_summary(out->block, p->block_count);
    if (rc == OXL_OK)
        rc = balance_alternative(
            ctx, p, o,
            &out->balance[o->partition.cut == OXL_CUT_MIDPOINT ? OXL_CUT_BALANCED : OXL_CUT_MIDPOINT]);
    if (rc != OXL_OK) oxl_partition_report_free(ctx, out);
    return rc;
}

void oxl_partition_report_free(oxl_context *ctx, oxl_partition_report *report)
{
    oxl_free(ctx, report->block);
    *report = (oxl_partition_report){0};
}

/* ---------------- the command */

/* Reads no images if they are elsewhere, since the COLMAP model alone suffices. */
static oxl_result balance_check_images(oxl_context *ctx, const char *scene, oxl_scene_options *o)
{
    char *images = o->images ? oxl_strdup(ctx, o->images) : oxl_path_join(ctx, scene, "images");
    if (!images) return OXL_ERR_MEMORY;
    if (o->read_images && !os_is_folder(images)) {
        oxl_log(ctx, OXL_LOG_INFO, "%s is not there: the blocks are made of the model alone", images);
        o->read_images = 0;
    }
    oxl_free(ctx, images);
    return OXL_OK;
}

oxl_result oxl_partition(oxl_context *ctx, const char *scene_path, const char *out,
                         const oxl_job_options *options, oxl_partition_report *report)
{
    oxl_job_options o = options ? *options : oxl_job_options_default(OXL_PRESET_DRAFT);
    oxl_scene *scene = NULL;
    struct partition p = {0};
    oxl_partition_report own = {0};
    oxl_lock *lock = NULL;
    oxl_result rc = out_check_inputs(ctx, out, scene_path, &o.scene);
    if (rc == OXL_OK) rc = balance_check_images(ctx, scene_path, &o.scene);
    if (report) *report = own;
    if (rc == OXL_OK) rc = oxl_scene_load(ctx, scene_path, &o.scene, &scene);
    if (rc == OXL_OK) rc = oxl_lock_folder(ctx, out, &lock);
    if (rc == OXL_OK) rc = out_check_partition(ctx, out);
    if (rc == OXL_OK)
        o.train.iterations = cost_iterations(&o, scene->stats.images_listed - scene->stats.images_missing);
    if (rc == OXL_OK) rc = budget_partition(ctx, scene, &o, &p);
    if (rc == OXL_OK) o.ram = (size_t)p.memory;
    if (rc == OXL_OK && report) rc = partition_report(ctx, &p, &o, &own);
    if (rc == OXL_OK) rc = partition_export(ctx, &p, out);
    if (rc == OXL_OK && report) *report = own;
    else oxl_partition_report_free(ctx, &own);
    oxl_unlock_folder(ctx, &lock);
    partition_free(ctx, &p);
    oxl_scene_free(ctx, scene);
    return rc;
}

/* ---------------- JSON */

struct balance_member {
    const char *name;
    double value;
};

static void balance_add_members(struct text *t, const struct balance_member *m, size_t count)
{
    for (size_t i = 0; i < count; i++)
        text_add(t, "%s\"%s\": %s", i ? ", " : "{", m[i].name, NUMBER(m[i].value));
    text_add(t, "}");
}

static void balance_add_json(struct text *t, const char *name, const oxl_balance *b)
{
    const struct balance_member m[] = {{"blocks", b->blocks},
                                       {"points_peak", b->points_peak},
                                       {"points_spread", b->points_spread},
                                       {"views_peak", b->views_peak},
                                       {"views_spread", b->views_spread},
                                       {"predicted_memory_bytes", b->memory},
                                       {"predicted_seconds", b->seconds},
                                       {"predicted_longest_seconds", b->longest}};
    text_add(t, "  \"%s\": ", name);
    balance_add_members(t, m, OXL_COUNT(m));
    text_add(t, ",\n");
}

oxl_result oxl_partition_to_json(oxl_context *ctx, const oxl_partition_report *r, char **out)
{
    struct text t = {.ctx = ctx};
    text_add(&t, "{\n  \"dimensions\": %d,\n  \"cut\": \"%s\",\n  \"extent\": [%s, %s, %s],\n", r->dimensions,
             r->cut == OXL_CUT_MIDPOINT ? "midpoint" : "balanced", NUMBER(r->extent[0]), NUMBER(r->extent[1]),
             NUMBER(r->extent[2]));
    balance_add_json(&t, "balanced", &r->balance[OXL_CUT_BALANCED]);
    balance_add_json(&t, "midpoint", &r->balance[OXL_CUT_MIDPOINT]);
    text_add(&t, "  \"blocks\": [");
    for (int i = 0; i < r->block_count; i++) {
        const oxl_block *b = &r->block[i];
        const struct balance_member m[] = {
            {"points", (double)b->points},         {"start_points", (double)b->start_points},
            {"base_views", b->base_views},         {"border_views", b->border_views},
            {"predicted_gaussians", b->gaussians}, {"predicted_memory_bytes", b->memory},
            {"predicted_seconds", b->seconds}};
        text_add(&t, "%s\n    ", i ? "," : "");
        balance_add_members(&t, m, OXL_COUNT(m));
    }
    text_add(&t, "\n  ]\n}\n");
    return text_take(&t, out);
}

/* prune.c - Wise Adaptive Pruning: drops that shrink, with refinement between them (paper sec. 3.2 and 4;
 * "Prune Wisely, Reconstruct Sharply", arXiv 2602.24136, and its code, for the schedule; Speedy-Splat, arXiv
 * 2412.00578, for the score).
 *
 * When density control is over, a phase of a quarter of the run begins. In it 1/2, 1/4, 1/8, 1/16 and 1/16 of
 * the excess are removed:
 * the first at once, each further one when the mean L1 of training has fallen to 0.99 of its value before the
 * last drop, or after
 * 1500 of 40 000 iterations without that.
 *
 * The Gaussians with the lowest score are removed:  U = sum over views and pixels of (o dF/dalpha)^2,  where
 * F is the sum of the rendered image. Dividing U by the number of views was worse in 7 of 7 pairs
 * (docs/log/TRAINING.md).
 *
 * Invariants: the phase ends with exactly the requested number (or fewer, if there are fewer). Rows keep
 * their order. The choice is a function of the model, the scene and the options; ties are resolved by row.
 */
#include "prune.h"
#include "../core/option_rows.h"
#include "../survey/scene.h"

/* of the run, between the end of density control and the phase [paper sec. 4] */
#define PRUNE_WAIT (200.0 / 40000)
#define PRUNE_PHASE 0.25       /* of the run [paper sec. 4: 10 000 of 40 000] */
#define PRUNE_EVERY (1.0 / 80) /* of the run, between checks: 500 of 40 000 ["Prune Wisely", code] */
#define PRUNE_PATIENCE 3       /* checks without a drop: 1500 of 40 000 */
#define PRUNE_RECOVERY 0.99    /* x the L1 before the last drop ["Prune Wisely", code; its paper says 0.95] */
enum {
    PRUNE_EVERY_MIN = 25, /* steps: minimum for Gaussians to adapt */
    PRUNE_VIEWS = 100,    /* a score is taken of so many views, or of 1 for each */
    /* steps of the run, if that is more: five scores then cost about a sixteenth of it */
    PRUNE_STEPS_A_VIEW = 40
};
static const int prune_drops[] = {8, 12, 14, 15, 16}; /* sixteenths removed after each drop */

/* ---------------- what to keep */

static double prune_row_bytes(int sh_degree, int lobes)
{
    return model_row_bytes(sh_degree) + (lobes ? MODEL_LOBE_BYTES : 0);
}

static size_t prune_target(const struct prune *p, size_t count)
{
    double target = (double)count;
    if (p->keep.kind == OXL_KEEP_FRACTION) target = floor(p->keep.value * (double)count + 0.5);
    if (p->keep.kind == OXL_KEEP_COUNT) target = p->keep.value;
    if (p->keep.kind == OXL_KEEP_BYTES) target = floor((p->keep.value - PRUNE_FILE) / p->row_bytes);
    return (size_t)OXL_CLAMP(target, 1.0, (double)count);
}

/* ---------------- when */

OXL_INTERNAL void prune_begin(struct prune *p, oxl_keep keep, int iterations, int densified, int views,
                              double row_bytes)
{
    *p = (struct prune){.keep = keep, .row_bytes = row_bytes};
    p->start = (int)OXL_MIN(densified + OXL_MAX(1, PRUNE_WAIT * iterations), iterations);
    p->end = (int)OXL_MIN(p->start + PRUNE_PHASE * iterations, iterations);
    /* sees each view once */
    p->every = (int)OXL_MAX(PRUNE_EVERY * iterations + 0.5, OXL_MIN(views, (p->end - p->start) / 20));
    p->every = OXL_MAX(p->every, PRUNE_EVERY_MIN);
    p->patience = OXL_MIN(PRUNE_PATIENCE * p->every, (p->end - p->start) / (int)OXL_COUNT(prune_drops));
    p->views = OXL_MAX(PRUNE_VIEWS, iterations / PRUNE_STEPS_A_VIEW);
}

OXL_INTERNAL int prune_is_check_step(const struct prune *p, int step)
{
    if (p->keep.kind == OXL_KEEP_ALL || step < p->start) return 0;
    if (step < p->end) return (step - p->start) % p->every == 0;
    return p->drops < (int)OXL_COUNT(prune_drops);
}

OXL_INTERNAL void prune_observe(struct prune *p, int step, double l1)
{
    if (step <= p->start - p->every || step > p->end || !(l1 <= DBL_MAX)) return;
    p->l1_sum += l1;
    p->l1_count++;
}

OXL_INTERNAL size_t prune_due(struct prune *p, int step, size_t count)
{
    const int last_drop = (int)OXL_COUNT(prune_drops) - 1;
    const double mean = p->l1_count ? p->l1_sum / p->l1_count : 0;
    size_t excess, goal;
    if (!prune_is_check_step(p, step)) return 0;
    p->l1_sum = 0;
    p->l1_count = 0;
    if (p->first_count == 0) {
        p->first_count = count;
        p->target = prune_target(p, count);
    } else if (!(mean <= PRUNE_RECOVERY * p->drop_l1) && step - p->last < p->patience && step < p->end)
        return 0;
    if (p->drops > last_drop) return 0;
    excess = p->first_count - p->target;
    p->drops = step >= p->end ? last_drop + 1 : p->drops + 1;
    p->drop_l1 = mean;
    p->last = step;
    goal = p->first_count - excess * (size_t)prune_drops[p->drops - 1] / 16;
    return count > goal ? count - goal : 0;
}

/* ---------------- scores */

struct prune_pass { /* over the views */
    float *one;     /* (count) the score in the view at hand */
    float *drgb;    /* (3,H,W) weights of the pixels: dF/d(image) */
    size_t drgb_capacity;
};

/* Gives weight 0 to masked pixels, 1 to the others. */
static oxl_result prune_mask_view(oxl_context *ctx, const oxl_scene *scene, int view, struct prune_pass *pass)
{
    const oxl_camera *camera = &scene->view[view].camera;
    const size_t pixels = (size_t)camera->width * camera->height;
    const struct training_image *image = scene_image(ctx, scene, view);
    oxl_result rc = OXL_RESERVE(ctx, pass->drgb, 3 * pixels);
    if (rc != OXL_OK) return rc;
    /* else it was named when it was trained on */
    if (!image && !scene_lacks_image(ctx->failed)) return ctx->failed;
    for (size_t i = 0; i < 3 * pixels; i++)
        pass->drgb[i] = !image || !image->mask || image->mask[i % pixels] >= 128;
    return OXL_OK;
}

static oxl_result prune_score_view(oxl_context *ctx, const struct prune_of *of, const oxl_camera *camera,
                                   struct prune_pass *pass, float *score)
{
    const int64_t count = (int64_t)of->model->count;
    oxl_result rc = renderer_forward(ctx, of->r, of->model, camera, of->options);
    const int on = renderer_has_device(of->r);
    memset(pass->one, 0, (size_t)count * sizeof *pass->one);
    if (rc == OXL_OK) rc = renderer_score(ctx, of->r, pass->drgb, pass->one);
    if (rc == OXL_OK && on && !renderer_has_device(of->r))
        return prune_score_view(ctx, of, camera, pass, score);
    if (rc != OXL_OK) return rc;
#pragma omp parallel for schedule(static) num_threads(ctx->threads)
    for (int64_t i = 0; i < count; i++) score[i] += pass->one[i];
    return OXL_OK;
}

static oxl_result prune_score(oxl_context *ctx, const struct prune *p, const struct prune_of *of,
                              float *score)
{
    const size_t count = of->model->count;
    const oxl_scene *scene = of->scene;
    struct prune_pass pass = {.one = oxl_alloc(ctx, count, sizeof *pass.one)};
    const int views = schedule_training_views(scene), stride = (views + p->views - 1) / p->views;
    int index = 0; /* each drop takes other views, every stride-th */
    oxl_result rc = pass.one ? OXL_OK : OXL_ERR_MEMORY;
    memset(score, 0, count * sizeof *score);
    for (int i = 0; i < scene->view_count && rc == OXL_OK; i++) {
        const oxl_view *view = &scene->view[i];
        if (view->is_test || index++ % stride != p->drops % stride) continue;
        rc = prune_mask_view(ctx, of->scene, i, &pass);
        if (rc == OXL_OK) rc = prune_score_view(ctx, of, &view->camera, &pass, score);
    }
    for (size_t i = 0; i < count && rc == OXL_OK; i++) {
        /* Keeps rows that no sampled view sees: they may be visible in others. */
        if (views > p->views && score[i] == 0) score[i] = FLT_MAX;
        if (!(score[i] <= FLT_MAX)) score[i] = 0;
    }
    OXL_FREE(ctx, pass.one, pass.drgb);
    return rc;
}

/* ---------------- the drop */

static uint32_t prune_sort_key(float score) /* not negative: its bits are in order */
{
    uint32_t bits;
    memcpy(&bits, &score, sizeof bits);
    return bits;
}

/* Sets keep[i] = 0 for the `drop` lowest scores, by row where they are equal. The highest key below which no
 * more than `drop` rows lie is found bit by bit: no sort, no memory. */
OXL_INTERNAL void prune_select(const float *score, size_t count, size_t drop, uint8_t *keep)
{
    uint32_t limit = 0;
    size_t below = 0;
    for (int bit = 31; bit >= 0; bit--) {
        const uint32_t next = limit | (uint32_t)1 << bit;
        size_t n = 0;
        for (size_t i = 0; i < count; i++) n += prune_sort_key(score[i]) < next;
        if (n <= drop) limit = next, below = n;
    }
    for (size_t i = 0; i < count; i++) {
        const uint32_t key = prune_sort_key(score[i]);
        const int tied = key == limit && below < drop;
        keep[i] = key >= limit && !tied;
        below += tied;
    }
}

OXL_INTERNAL oxl_result prune_choose(oxl_context *ctx, const struct prune *p, const struct prune_of *of,
                                     size_t drop, uint8_t *keep)
{
    float *score = oxl_alloc(ctx, of->model->count, sizeof *score);
    oxl_result rc = score ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = prune_score(ctx, p, of, score);
    if (rc == OXL_OK) prune_select(score, of->model->count, drop, keep);
    oxl_free(ctx, score);
    return rc;
}

/* ---------------- the part */

static oxl_result prune_part_begin(struct train *t, void *state)
{
    const oxl_train_options *o = t->options;
    prune_begin(state, o->keep, o->iterations, (int)(o->densify_until * o->iterations),
                schedule_training_views(t->scene), prune_row_bytes(3, o->dog != OXL_DOG_OFF));
    return OXL_OK;
}

static void prune_after_loss(struct train *t, void *state, const struct train_deferred *step,
                             const struct renderer_loss *loss)
{
    (void)t;
    prune_observe(state, step->step, loss->l1);
}

/* Removes Gaussians with their moments and statistics. */
static oxl_result prune_remove_rows(struct train *t, const struct prune *p, size_t drop)
{
    const struct prune_of of = {t->renderer, t->scene, &t->render, &t->trained.model};
    const size_t count = t->trained.model.count;
    uint8_t *keep = oxl_alloc(t->ctx, count, sizeof *keep);
    int moved = 0;
    oxl_result rc = keep ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = step_flush(t);
    if (rc == OXL_OK) rc = prune_choose(t->ctx, p, &of, drop, keep);
    if (rc == OXL_OK) rc = step_download(t, DOWNLOAD_SHAPE);
    if (rc == OXL_OK) rc = step_move_rows(t, NULL, keep, t->trained.model.sh_degree, &moved);
    if (rc == OXL_OK) {
        for (int k = 0; k < TRAINED_PARTS; k++) model_keep_rows(model_trained_part(&t->trained, k), keep);
        density_keep_rows(&t->density, keep, count);
    }
    if (rc == OXL_OK && moved) rc = renderer_send_shape(t->renderer, &t->trained.model, 0);
    oxl_free(t->ctx, keep);
    return rc;
}

static oxl_result prune_after_step(struct train *t, void *state)
{
    struct prune *p = state;
    size_t drop;
    oxl_result rc;
    if (!prune_is_check_step(p, t->step)) return OXL_OK;
    rc = step_flush(t);
    if (rc != OXL_OK) return rc;
    p->row_bytes = prune_row_bytes(t->trained.model.sh_degree, t->options->dog != OXL_DOG_OFF);
    drop = prune_due(p, t->step, t->trained.model.count);
    if (drop == 0) return OXL_OK;
    return prune_remove_rows(t, p, drop);
}

static void prune_record(struct train *t, void *state)
{
    const struct prune *p = state;
    char chosen[64], why[320];
    snprintf(why, sizeof why,
             p->keep.kind == OXL_KEEP_ALL ? "all are kept: as set"
                                          : "%zu of %zu after density control: as set",
             p->target, p->first_count);
    snprintf(chosen, sizeof chosen, "%zu", t->trained.model.count);
    selection_record(t, "keep", chosen, why);
}

/* clang-format off */
static const oxl_option prune_options[] = {
{"keep", "FRACTION|COUNT|SIZE|all", OXL_OPTION_KEEP, OPTION_AT(train.keep), 0, 0, PRESETS("all", "all", "0.5"), OXL_TIER_BASIC, TRAINING | RESULT | NOT_REFINED, "Scene content", "Gaussians to keep when pruning, in all blocks together, e.g. 0.5, 400000 or 80MB. Keeping half costs 0 to 0.7 dB, and more in short runs"},
{0}};
/* clang-format on */

OXL_INTERNAL const struct part part_prune = {.name = "prune",
                                             .size = sizeof(struct prune),
                                             .option = prune_options,
                                             .begin = prune_part_begin,
                                             .is_plain = 1,
                                             .after_loss = prune_after_loss,
                                             .after_step = prune_after_step,
                                             .record = prune_record};

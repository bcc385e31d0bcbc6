/* block_plan.c - plans the part of a block in the run: its Gaussians and its surroundings, its window in each
 * view, its steps, its fraction of the budget.
 *
 * All of it follows from the coarse model, so any process finds the same plan. A block's fraction of a pixel
 * is the blend weight of its Gaussians there. Its window in a view is the rectangle that maximises the sum of
 * (fraction - PLAN_PIXEL_COST) over its pixels. Its fraction of the run is that of the Gaussians.
 *
 * Invariant: the work of all blocks, in pixels, is that of the steps which the coarse model and the merged
 * one leave of the run.
 */
#include "job_state.h"
#include "../formats/formats.h"
#include "../render/render.h"
#include "../survey/scene.h"
#include "../model/model.h"

/* Sets the price of a pixel of a window, in fractions of a pixel (docs/log/SCALE.md). */
#define PLAN_PIXEL_COST 0.35
/* Bounds the gain of a window from below, as a fraction of the image's pixels: the block does
 * without views that give less. */
#define PLAN_MIN 0.002
/* Reaches, in standard deviations, where alpha at opacity 1 is below 1/255 (3.33). */
#define PLAN_REACH 3.34
#define PLAN_BLUR 2.0 /* Widens the view (px) by the reach of the renderer's low pass. */
/* Bounds the slope at which a Gaussian is projected, in half images: the renderer evaluates its Jacobian at
 * most 1.3 of them from the centre. */
#define PLAN_SLOPE 1.5
#define PLAN_TILE 16 /* Sets the step (px) of the edges of windows, besides the image's borders. */

/* what a Gaussian of the coarse model is to a block; PLAN_OWN follows PLAN_CONTEXT (plan_take) */
enum plan_part { PLAN_HIDDEN, PLAN_CONTEXT, PLAN_OWN };

OXL_INTERNAL void block_plan_free(oxl_context *ctx, struct block_plan *plan)
{
    oxl_free(ctx, plan->window);
    oxl_model_free(ctx, &plan->own);
    oxl_model_free(ctx, &plan->surroundings);
    *plan = (struct block_plan){0};
}

OXL_INTERNAL double block_plan_merged_fraction(const struct job *job)
{
    const oxl_train_options *o = &job->options.train;
    return o->keep.kind == OXL_KEEP_ALL && o->dog == OXL_DOG_OFF ? JOB_MERGED : JOB_MERGED_LATER;
}

/* Returns 1 if a Gaussian may show in a view. */
static int plan_shows(const oxl_camera *c, double near_plane, const oxl_model *m, size_t row)
{
    const double focal[2] = {c->fx, c->fy}, middle[2] = {c->cx, c->cy}, size[2] = {c->width, c->height};
    double mean[3], at[3], sigma = -HUGE_VAL;
    for (int a = 0; a < 3; a++) {
        const double factor = row < m->lobes ? OXL_MAX((double)m->plane[OXL_LOBE + 1 + a][row], 0) : 0;
        mean[a] = m->plane[OXL_MEAN + a][row];
        sigma = OXL_MAX(sigma, m->plane[OXL_LOG_SCALE + a][row] + factor);
    }
    camera_transform(c, mean, NULL, at);
    if (!(at[2] > near_plane * (1 - 1e-6))) return 0;
    for (int a = 0; a < 2; a++) {
        const double slope = PLAN_SLOPE * OXL_MAX(middle[a], size[a] - middle[a]) / focal[a];
        const double reach = focal[a] * PLAN_REACH * vecmath_exp(sigma) * sqrt(1 + slope * slope);
        if (focal[a] * at[a] - reach > (size[a] - middle[a] + PLAN_BLUR) * at[2] ||
            focal[a] * at[a] + reach < (-middle[a] - PLAN_BLUR) * at[2])
            return 0;
    }
    return 1;
}

/* ---------------- windows */

/* Finds the rectangle of tiles with the largest sum of value (height,width), and returns the sum. For each
 * pair of rows it takes the best run of columns (Kadane). In `value` it leaves sums from the first row on. */
OXL_INTERNAL double plan_best_rectangle(double *value, int width, int height, struct image_window *best)
{
    double most = 0;
    *best = (struct image_window){0};
    for (int i = width; i < width * height; i++) value[i] += value[i - width];
    for (int top = 0; top < height; top++)
        for (int bottom = top + 1; bottom <= height; bottom++) {
            double run = 0;
            int left = 0;
            for (int x = 0; x < width; x++) {
                run += value[(bottom - 1) * width + x] - (top ? value[(top - 1) * width + x] : 0);
                if (run > most)
                    most = run, *best = (struct image_window){left, top, x + 1 - left, bottom - top};
                if (run < 0) run = 0, left = x + 1;
            }
        }
    return most;
}

/* Finds the window of a block from its blend weight, fraction (H,W). */
static oxl_result plan_window(oxl_context *ctx, const float *fraction, int width, int height,
                              struct image_window *out)
{
    const int tiles_x = (width + PLAN_TILE - 1) / PLAN_TILE, tiles_y = (height + PLAN_TILE - 1) / PLAN_TILE;
    double *value = oxl_calloc(ctx, (size_t)tiles_x * tiles_y, sizeof *value);
    if (!value) return OXL_ERR_MEMORY;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++)
            value[y / PLAN_TILE * tiles_x + x / PLAN_TILE] +=
                (double)fraction[(size_t)y * width + (size_t)x] - PLAN_PIXEL_COST;
    if (plan_best_rectangle(value, tiles_x, tiles_y, out) < PLAN_MIN * width * height)
        *out = (struct image_window){0};
    out->x *= PLAN_TILE, out->y *= PLAN_TILE;
    out->width = OXL_MIN(out->width * PLAN_TILE, width - out->x);
    out->height = OXL_MIN(out->height * PLAN_TILE, height - out->y);
    oxl_free(ctx, value);
    return OXL_OK;
}

static void plan_paint(oxl_model *model, double colour)
{
    for (int c = 0; c < 3; c++)
        for (size_t i = 0; i < model->count; i++)
            model->plane[OXL_SH + c][i] = (float)((colour - 0.5) / MODEL_SH0);
}

/* Finds the windows: renders the coarse model with the block's Gaussians in white and all others in black, so
 * that the image is the block's blend weight. */
static oxl_result plan_windows(struct job *job, struct block_plan *plan)
{
    oxl_render_options o = render_options_of(job->scene);
    struct renderer *r = NULL;
    oxl_result rc = renderer_create(job->ctx, &r);
    o.sh_degree = 0;
    plan_paint(&plan->own, 1);
    plan_paint(&plan->surroundings, 0);
    if (rc == OXL_OK) renderer_set_surroundings(r, &plan->surroundings);
    for (int i = 0; i < job->scene->view_count && rc == OXL_OK; i++) {
        const oxl_view *view = &job->scene->view[i];
        oxl_image image = {0};
        size_t row = view->is_test ? plan->own.count : 0;
        while (row < plan->own.count && !plan_shows(&view->camera, o.near_plane, &plan->own, row)) row++;
        if (row == plan->own.count) continue;
        rc = context_stopped(job->ctx);
        if (rc == OXL_OK) rc = renderer_draw(job->ctx, r, &plan->own, &view->camera, &o, &image, NULL);
        if (rc == OXL_OK)
            rc = plan_window(job->ctx, image.rgb, view->camera.width, view->camera.height, &plan->window[i]);
        plan->area += (double)plan->window[i].width * plan->window[i].height;
        plan->views += plan->window[i].width > 0;
        oxl_image_free(job->ctx, &image);
    }
    renderer_free(job->ctx, r);
    return rc;
}

/* ---------------- Gaussians, steps and budget */

/* Copies the rows of the coarse model that are the block's own, and its surroundings; part: (count). */
static oxl_result plan_take(struct job *job, const oxl_model *coarse, const uint8_t *part,
                            struct block_plan *plan)
{
    oxl_model *const out[] = {&plan->surroundings, &plan->own};
    uint8_t *keep = oxl_alloc(job->ctx, coarse->count + 1, 1);
    oxl_result rc = keep ? OXL_OK : OXL_ERR_MEMORY;
    for (int k = 0; k < 2 && rc == OXL_OK; k++) {
        oxl_model_free(job->ctx, out[k]);
        rc = oxl_model_create(job->ctx, 0, 0, out[k]);
        memcpy(out[k]->origin, coarse->origin, sizeof coarse->origin);
        for (size_t i = 0; i < coarse->count; i++) keep[i] = part[i] == PLAN_CONTEXT + k;
        if (rc == OXL_OK) rc = merge_rows(job->ctx, coarse, keep, out[k]);
    }
    oxl_free(job->ctx, keep);
    return rc;
}

/* Leaves out of the surroundings what shows in no view that has a window. */
static void plan_hide(const struct job *job, const struct block_plan *plan, const oxl_model *coarse,
                      uint8_t *part)
{
    const double near = oxl_scene_near_plane(job->scene);
#pragma omp parallel for schedule(dynamic, 1024) num_threads(job->ctx->threads)
    for (int64_t i = 0; i < (int64_t)coarse->count; i++) {
        int shown = part[i] == PLAN_OWN;
        for (int v = 0; v < job->scene->view_count && !shown; v++)
            shown =
                plan->window[v].width > 0 && plan_shows(&job->scene->view[v].camera, near, coarse, (size_t)i);
        if (!shown) part[i] = PLAN_HIDDEN;
    }
}

/* Gives the block its fraction of the run's pixels and of the Gaussians that memory holds of the merged model
 * in training. */
static void plan_divide(const struct job *job, const oxl_model *coarse, struct block_plan *plan)
{
    const struct cost_load load = cost_load_of_scene(job->scene);
    const double cap = OXL_MIN((double)schedule_gaussian_cap(job->scene, &job->options.train),
                               budget_max_gaussians(&load, &job->options));
    const double part = 1 - JOB_COARSE - block_plan_merged_fraction(job);
    /* px of a view, and of a window, on average */
    const double pixels = schedule_pixels(job->scene) / OXL_MAX(1, schedule_training_views(job->scene)),
                 window = plan->area / OXL_MAX(1, plan->views);
    const double rows = (double)plan->own.count, all = (double)OXL_MAX(coarse->count, (size_t)1);
    plan->fraction = rows / all;
    plan->iterations = (int)OXL_CLAMP(
        plan->fraction * job->options.train.iterations * pixels / OXL_MAX(1, window) + 0.5, 1, INT_MAX);
    plan->first = (int)(JOB_COARSE * plan->iterations);
    plan->last = (int)ceil((JOB_COARSE + part) * plan->iterations);
    plan->gaussians = OXL_MAX(1, rows + floor(OXL_MAX(0, cap - all) * plan->fraction));
}

OXL_INTERNAL oxl_result block_plan_make(struct job *job, int block, const oxl_model *coarse,
                                        struct block_plan *plan)
{
    uint8_t *part = oxl_alloc(job->ctx, coarse->count + 1, 1);
    oxl_result rc;
    *plan = (struct block_plan){0};
    plan->window = oxl_calloc(job->ctx, (size_t)job->scene->view_count + 1, sizeof *plan->window);
    rc = part && plan->window ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK) merge_mark(&job->partition, block, coarse, part);
    for (size_t i = 0; i < coarse->count && rc == OXL_OK; i++) part[i] = part[i] ? PLAN_OWN : PLAN_CONTEXT;
    if (rc == OXL_OK) rc = plan_take(job, coarse, part, plan);
    if (rc == OXL_OK) rc = plan_windows(job, plan);
    if (rc == OXL_OK) plan_hide(job, plan, coarse, part);
    if (rc == OXL_OK) rc = plan_take(job, coarse, part, plan); /* in their own colours */
    if (rc == OXL_OK) plan_divide(job, coarse, plan);
    oxl_free(job->ctx, part);
    return rc;
}

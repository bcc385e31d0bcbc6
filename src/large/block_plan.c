/* block_plan.c - plans the part of each block in the run: its Gaussians, its window in each view, its steps,
 * its fraction of the budget.
 *
 * All of it follows from the coarse model. A block's fraction of a pixel is the blend weight of its Gaussians
 * there. Its window in a view is the rectangle that maximises the sum of (fraction - PLAN_PIXEL_COST) over
 * its pixels.
 *
 * Invariant: the work of all blocks, in pixels, is that of the steps which the coarse model leaves of the
 * run.
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
#define PLAN_VIEWS_MAX (1 << 24)
#define PLAN_GAUSSIANS_MAX 1e15 /* Limits the number of Gaussians in a file. */
#define PLAN_VIEW_TEXT 10       /* Bounds the bytes of a view's line from below. */
/* Reaches, in standard deviations, where alpha at opacity 1 is below 1/255 (3.33). */
#define PLAN_REACH 3.34
#define PLAN_BLUR 2.0 /* Widens the view (px) by the reach of the renderer's low pass. */
/* Bounds the slope at which a Gaussian is projected, in half images: the renderer evaluates its Jacobian at
 * most 1.3 of them from the centre. */
#define PLAN_SLOPE 1.5
#define PLAN_TILE 16 /* Sets the step (px) of the edges of windows, besides the image's borders. */

OXL_INTERNAL void block_plan_free(oxl_context *ctx, struct block_plan *plan)
{
    OXL_FREE(ctx, plan->window, plan->shows, plan->neighbour);
    *plan = (struct block_plan){0};
}

OXL_INTERNAL int block_plan_until(const struct block_plan *plan, int round)
{
    return plan->first + (int)((int64_t)(plan->last - plan->first) * (round + 1) / JOB_ROUNDS);
}

OXL_INTERNAL double block_plan_merged_fraction(const struct job *job)
{
    const oxl_train_options *o = &job->options.train;
    return o->keep.kind == OXL_KEEP_ALL && o->dog == OXL_DOG_OFF ? JOB_MERGED : JOB_MERGED_LATER;
}

/* ---------------- what a view may show */

OXL_INTERNAL int block_plan_shows(const oxl_camera *c, double near_plane, const oxl_model *m, size_t row)
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

/* ---------------- the file */

static oxl_result plan_write(struct job *job, int block, const struct block_plan *plan)
{
    struct text t = {.ctx = job->ctx};
    const char *path = PATH(JOB_BLOCK(job, block), "plan.txt");
    const char *folder = JOB_BLOCK(job, block);
    oxl_result rc = oxl_make_folder(job->ctx, folder);
    text_add(
        &t,
        "# first step, last step, iterations, most Gaussians, fraction of the pixels, fraction of the work; neighbours; of each view "
        "the window, x y width height, and whether the block may show in it\n");
    text_add(&t, "plan %d %d %d %.17g %.17g %.17g\nneighbours", plan->first, plan->last, plan->iterations,
             plan->gaussians, plan->fraction, plan->work);
    for (int j = 0; j < job->partition.block_count; j++)
        if (plan->neighbour[j]) text_add(&t, " %d", j);
    text_add(&t, " -1\nviews %d\n", plan->views);
    for (int i = 0; i < plan->views; i++)
        text_add(&t, "%d %d %d %d %d\n", plan->window[i].x, plan->window[i].y, plan->window[i].width,
                 plan->window[i].height, plan->shows[i]);
    text_add(&t, "%s\n", job->key.data);
    checksum_end_text(&t);
    if (rc == OXL_OK) rc = os_write_text(job->ctx, path, &t);
    text_free(&t);
    return rc;
}

static const char *plan_read_windows(const char *s, struct block_plan *out)
{
    int used, shows;
    for (int i = 0; i < out->views; i++, s += used) {
        struct image_window *w = &out->window[i];
        if (sscanf(s, "%d %d %d %d %d\n%n", &w->x, &w->y, &w->width, &w->height, &shows, &used) != 5 ||
            w->x < 0 || w->y < 0 || w->width < 0 || w->height < 0 || w->x > INT_MAX - w->width ||
            w->y > INT_MAX - w->height || (w->width == 0) != (w->height == 0))
            return NULL;
        out->shows[i] = shows == 1;
    }
    return s;
}

static const char *plan_read_neighbours(const char *s, int blocks, struct block_plan *out)
{
    int used, j = 0;
    while (sscanf(s, " %d%n", &j, &used) == 1 && j >= 0 && j < blocks) out->neighbour[j] = 1, s += used;
    return j == -1 ? s + used : NULL;
}

static int plan_is_in_range(const struct block_plan *p)
{
    return p->first >= 0 && p->first <= p->last && p->last <= p->iterations && p->iterations >= 1 &&
           p->gaussians >= 1 && p->gaussians <= PLAN_GAUSSIANS_MAX && p->fraction >= 0 && p->fraction <= 1 &&
           p->work >= 0 && p->work <= 1 && p->views >= 0 && p->views <= PLAN_VIEWS_MAX;
}

/* Returns 1 if the plan has as many views as the scene, and its windows lie in their images. */
OXL_INTERNAL int block_plan_fits(const struct block_plan *plan, const oxl_scene *scene)
{
    if (plan->views != oxl_scene_view_count(scene)) return 0;
    for (int i = 0; i < plan->views; i++) {
        const struct image_window *w = &plan->window[i];
        const oxl_camera *c = &oxl_scene_view(scene, i)->camera;
        if (w->x + w->width > c->width || w->y + w->height > c->height) return 0;
    }
    return 1;
}

static oxl_result plan_parse(struct job *job, const char *s, struct block_plan *out)
{
    const int blocks = job->partition.block_count;
    int used = 0;
    out->neighbour = oxl_calloc(job->ctx, (size_t)blocks + 1, 1);
    if (!out->neighbour) return OXL_ERR_MEMORY;
    s = strstr(s, "plan ");
    if (!s ||
        sscanf(s, "plan %d %d %d %lf %lf %lf\nneighbours%n", &out->first, &out->last, &out->iterations,
               &out->gaussians, &out->fraction, &out->work, &used) != 6 ||
        !used)
        return OXL_ERR_INPUT;
    s = plan_read_neighbours(s + used, blocks, out);
    if (!s || sscanf(s, " views %d\n%n", &out->views, &used) != 1 || !plan_is_in_range(out) ||
        (size_t)out->views > strlen(s) / PLAN_VIEW_TEXT)
        return OXL_ERR_INPUT;
    out->window = oxl_calloc(job->ctx, (size_t)out->views + 1, sizeof *out->window);
    out->shows = oxl_calloc(job->ctx, (size_t)out->views + 1, 1);
    if (!out->window || !out->shows) return OXL_ERR_MEMORY;
    return plan_read_windows(s + used, out) ? OXL_OK : OXL_ERR_INPUT;
}

/* Reads a block's plan. Ignores a damaged file, or one of another run: the plan is made again. */
OXL_INTERNAL oxl_result block_plan_read(struct job *job, int block, struct block_plan *out)
{
    struct os_file_map map = {0};
    const char *path = PATH(JOB_BLOCK(job, block), "plan.txt");
    oxl_result rc = OXL_OK;
    *out = (struct block_plan){0};
    if (os_is_file(path)) rc = os_read_file(job->ctx, path, &map);
    if (rc == OXL_OK && map.data && checksum_of_text(map.data, map.size) == CHECKSUM_RIGHT &&
        text_has_line(map.data, job->key.data))
        rc = plan_parse(job, map.data, out);
    if (rc == OXL_ERR_INPUT || (rc == OXL_OK && out->views == 0)) block_plan_free(job->ctx, out), rc = OXL_OK;
    if (rc != OXL_OK) block_plan_free(job->ctx, out);
    os_release_file(job->ctx, &map);
    return rc;
}

/* ---------------- the block's Gaussians */

OXL_INTERNAL oxl_result block_plan_split(struct job *job, int block, const oxl_model *coarse, oxl_model *own,
                                         oxl_model *others)
{
    uint8_t *keep = oxl_alloc(job->ctx, coarse->count + 1, 1);
    oxl_result rc = keep ? OXL_OK : OXL_ERR_MEMORY;
    *own = *others = (oxl_model){0};
    if (rc == OXL_OK) rc = oxl_model_create(job->ctx, 0, 0, own);
    if (rc == OXL_OK) rc = oxl_model_create(job->ctx, 0, 0, others);
    for (int k = 0; k < 3 && rc == OXL_OK; k++) own->origin[k] = others->origin[k] = coarse->origin[k];
    if (rc == OXL_OK) merge_mark(&job->partition, block, coarse, keep);
    if (rc == OXL_OK) rc = merge_rows(job->ctx, coarse, keep, own);
    for (size_t i = 0; i < coarse->count && rc == OXL_OK; i++) keep[i] = !keep[i];
    if (rc == OXL_OK) rc = merge_rows(job->ctx, coarse, keep, others);
    if (rc != OXL_OK) {
        oxl_model_free(job->ctx, own);
        oxl_model_free(job->ctx, others);
    }
    oxl_free(job->ctx, keep);
    return rc;
}

/* ---------------- windows */

/* Finds the rectangle of tiles with the largest sum of value (height,width), and returns the sum. For each
 * pair of rows it takes the best run of columns (Kadane). */
OXL_INTERNAL double plan_best_rectangle(const double *value, int width, int height, struct image_window *best)
{
    double most = 0;
    *best = (struct image_window){0};
    for (int top = 0; top < height; top++)
        for (int bottom = top + 1; bottom <= height; bottom++) {
            double run = 0;
            int left = 0;
            for (int x = 0; x < width; x++) {
                for (int y = top; y < bottom; y++) run += value[y * width + x];
                if (run > most)
                    most = run, *best = (struct image_window){left, top, x + 1 - left, bottom - top};
                if (run < 0) run = 0, left = x + 1;
            }
        }
    return most;
}

/* Finds the window of a block from its blend weight, fraction (H,W), and adds the whole weight to *sum. */
static oxl_result plan_window(oxl_context *ctx, const float *fraction, int width, int height,
                              struct image_window *out, double *sum)
{
    const int tiles_x = (width + PLAN_TILE - 1) / PLAN_TILE, tiles_y = (height + PLAN_TILE - 1) / PLAN_TILE;
    double *value = oxl_calloc(ctx, (size_t)tiles_x * (size_t)tiles_y, sizeof *value);
    if (!value) return OXL_ERR_MEMORY;
    for (int y = 0; y < height; y++)
        for (int x = 0; x < width; x++) {
            const double s = fraction[(size_t)y * (size_t)width + (size_t)x];
            value[y / PLAN_TILE * tiles_x + x / PLAN_TILE] += s - PLAN_PIXEL_COST;
            *sum += s;
        }
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

struct plan_sum {        /* Sums over the views of a block. */
    double pixels, area; /* blend weight of the block; area of its windows */
    size_t rows;
    int views; /* views with a window */
};

static int plan_may_show(const oxl_camera *camera, double near_plane, const oxl_model *own)
{
    for (size_t i = 0; i < own->count; i++)
        if (block_plan_shows(camera, near_plane, own, i)) return 1;
    return 0;
}

/* Finds the windows of a block: renders the coarse model with the block's Gaussians in white and all others
 * in black, so that the image is the block's blend weight. */
static oxl_result plan_views(struct job *job, oxl_model *own, oxl_model *others, struct block_plan *plan,
                             struct plan_sum *sum)
{
    oxl_render_options o = oxl_render_options_default();
    struct renderer *r = NULL;
    oxl_result rc;
    o.sh_degree = 0;
    o.near_plane = (float)oxl_scene_near_plane(job->scene);
    plan_paint(own, 1);
    plan_paint(others, 0);
    rc = renderer_create(job->ctx, &r);
    if (rc == OXL_OK) renderer_set_context(r, others);
    for (int i = 0; i < plan->views && rc == OXL_OK; i++) {
        const oxl_view *view = oxl_scene_view(job->scene, i);
        oxl_image image = {0};
        if (view->is_test || !(plan->shows[i] = (uint8_t)plan_may_show(&view->camera, o.near_plane, own)))
            continue;
        rc = context_stopped(job->ctx);
        if (rc == OXL_OK) rc = renderer_draw(job->ctx, r, own, &view->camera, &o, &image, NULL);
        if (rc == OXL_OK)
            rc = plan_window(job->ctx, image.rgb, view->camera.width, view->camera.height, &plan->window[i],
                             &sum->pixels);
        sum->area += (double)plan->window[i].width * plan->window[i].height;
        sum->views += plan->window[i].width > 0;
        oxl_image_free(job->ctx, &image);
    }
    renderer_free(job->ctx, r);
    return rc;
}

static oxl_result plan_of_block(struct job *job, int block, const oxl_model *coarse, struct block_plan *plan,
                                struct plan_sum *sum)
{
    oxl_model own = {0}, others = {0};
    oxl_result rc;
    plan->views = oxl_scene_view_count(job->scene);
    plan->window = oxl_calloc(job->ctx, (size_t)plan->views + 1, sizeof *plan->window);
    plan->shows = oxl_calloc(job->ctx, (size_t)plan->views + 1, 1);
    plan->neighbour = oxl_calloc(job->ctx, (size_t)job->partition.block_count + 1, 1);
    rc = plan->window && plan->shows && plan->neighbour ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = block_plan_split(job, block, coarse, &own, &others);
    if (rc == OXL_OK) rc = plan_views(job, &own, &others, plan, sum);
    sum->rows = own.count;
    oxl_model_free(job->ctx, &own);
    oxl_model_free(job->ctx, &others);
    return rc;
}

/* ---------------- steps and budgets */

/* Returns the limit of Gaussians in the merged model: memory holds its training. */
static double plan_cap(const struct job *job)
{
    const struct cost_load load = cost_load_of_scene(job->scene);
    const double cap = (double)schedule_gaussian_cap(job->scene, &job->options.train);
    return OXL_MIN(cap, budget_max_gaussians(&load, &job->options));
}

/* Gives all blocks the same number of epochs, such that the pixels of all blocks' steps are those of the
 * run's steps between coarse and merged model. */
static void plan_divide(const struct job *job, double cap, struct block_plan *plan,
                        const struct plan_sum *sum)
{
    const int blocks = job->partition.block_count;
    /* px of a view, on average */
    const double pixels = schedule_pixels(job->scene) / OXL_MAX(1, schedule_training_views(job->scene));
    const double part = 1 - JOB_COARSE - block_plan_merged_fraction(job);
    double area = 0, sum_of_pixels = 0, rows = 0, epochs;
    for (int k = 0; k < blocks; k++) {
        area += sum[k].area;
        sum_of_pixels += sum[k].pixels;
        rows += (double)sum[k].rows;
    }
    epochs = area > 0 ? part * job->options.train.iterations * pixels / area : 0;
    for (int k = 0; k < blocks; k++) {
        plan[k].iterations = (int)OXL_CLAMP(epochs * sum[k].views / part + 0.5, 1, INT_MAX);
        plan[k].first = (int)(JOB_COARSE * plan[k].iterations);
        plan[k].last = (int)ceil((JOB_COARSE + part) * plan[k].iterations);
        plan[k].fraction = sum_of_pixels > 0 ? sum[k].pixels / sum_of_pixels : 1.0 / blocks;
        plan[k].work = area > 0 ? part * sum[k].area / area : 0;
        plan[k].gaussians =
            OXL_MAX(1, (double)sum[k].rows + floor(OXL_MAX(0, cap - rows) * plan[k].fraction));
    }
}

/* Marks two blocks as neighbours if both have a window in a view. */
static void plan_find_neighbours(const struct job *job, struct block_plan *plan)
{
    const int blocks = job->partition.block_count;
    for (int a = 0; a < blocks; a++)
        for (int b = 0; b < a; b++) {
            int shared = 0;
            for (int v = 0; v < plan[a].views && !shared; v++)
                shared = plan[a].window[v].width > 0 && plan[b].window[v].width > 0;
            plan[a].neighbour[b] = plan[b].neighbour[a] = (uint8_t)shared;
        }
}

OXL_INTERNAL oxl_result block_plan_make(struct job *job, const oxl_model *coarse)
{
    const int blocks = job->partition.block_count;
    const double pixels = schedule_pixels(job->scene) / OXL_MAX(1, schedule_training_views(job->scene));
    struct block_plan *plan = oxl_calloc(job->ctx, (size_t)blocks, sizeof *plan);
    struct plan_sum *sum = oxl_calloc(job->ctx, (size_t)blocks, sizeof *sum);
    oxl_result rc = plan && sum ? OXL_OK : OXL_ERR_MEMORY;
    for (int k = 0; k < blocks && rc == OXL_OK; k++) rc = plan_of_block(job, k, coarse, &plan[k], &sum[k]);
    if (rc == OXL_OK) {
        plan_divide(job, plan_cap(job), plan, sum);
        plan_find_neighbours(job, plan);
    }
    for (int k = 0; k < blocks && rc == OXL_OK; k++) {
        oxl_log(job->ctx, OXL_LOG_INFO,
                "block %d: %d steps on windows of %d views, %.0f %% of their pixels; at most %.0f Gaussians",
                k, plan[k].last - plan[k].first, sum[k].views,
                100 * sum[k].area / OXL_MAX(1, sum[k].views * pixels), plan[k].gaussians);
        rc = plan_write(job, k, &plan[k]);
    }
    for (int k = 0; k < blocks && plan; k++) block_plan_free(job->ctx, &plan[k]);
    OXL_FREE(job->ctx, plan, sum);
    return rc;
}

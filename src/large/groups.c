/* groups.c - trains the merged model in groups of views, the last stage of a run in blocks, if the model does
 * not fit into memory.
 *
 * Memory holds the Gaussians visible in the views of one group, with gradients and moments. A task trains
 * them, whichever block they belong to, on the group's views. Moments are stored with the Gaussians and each
 * group has several turns, so the result is close to that of training on all views in random order
 * (docs/SCALE.md).
 *
 * If images have a medium, or gains alone, a model for viewers follows: the model with them in its colours,
 * refined without them in as many turns. model.ply is written before.
 *
 * OUT/blocks/whole has groups.txt, imaging.V.txt, and for each block KKK.model.V.ply, KKK.mean.V.ply and
 * KKK.square.V.ply; V is the number of the task that wrote them. Invariant: a task writes files with its own
 * number, then groups.txt; if it is stopped, it is repeated and gives the same bytes. What began in groups
 * ends in groups, whatever memory there is then; after the finished record, these files are removed.
 */
#include "job_state.h"
#include "../formats/formats.h"
#include "../render/render.h"
#include "../survey/scene.h"
#include "../model/model.h"
#include "os_job.h"

#define GROUPS_PASSES 8 /* Turns of each group. */

struct groups {
    struct job *job;
    const char *folder;
    double limit; /* number of Gaussians that fit into memory */
    int views;    /* views of the survey */
    int count;    /* number of groups */
    int lost;     /* 1: groups had begun, but files of theirs are missing or damaged */
    int done;     /* number of tasks done, those of the model for viewers after those of the model */
    int viewers;  /* 1: the task is of the model for viewers */
    int steps;    /* steps of all tasks of the model, or of that for viewers */
    int before;   /* steps of the model, in the tasks of that for viewers; else 0 */
    int step;     /* step of the task that was reported last */
    int gains;    /* version of imaging.V.txt; 0: none */
    int *of;      /* (views) the view's group; -1: none */
    int *version; /* (blocks) version of the block's files; 0: the block's own model.ply */
    double seconds;
    uint8_t **keep; /* (blocks)(rows) 1: the row is in the task's model */
};

static void groups_free(struct groups *g)
{
    for (int k = 0; g->keep && k < g->job->partition.block_count; k++) oxl_free(g->job->ctx, g->keep[k]);
    OXL_FREE(g->job->ctx, g->keep, g->of, g->version);
}

/* ---------------- files */

static const char *groups_path(char out[PATH_LENGTH], const struct groups *g, int block, const char *what,
                               int version)
{
    if (block < 0) return path_in(out, g->folder, "%s.%d.txt", what, version);
    if (version > 0) return path_in(out, g->folder, "%03d.%s.%d.ply", block, what, version);
    return path_in(out, JOB_BLOCK(g->job, block), "model.ply");
}
#define GROUPS_PATH(...) groups_path((char[PATH_LENGTH]){0}, __VA_ARGS__)

static const char *const GROUPS_PART[TRAINED_PARTS] = {"model", "mean", "square"};

/* Returns the number of files that a version of a block has: moments that are 0 have none, before the first
 * task of the model and of that for viewers. */
static int groups_parts(const struct groups *g, int version)
{
    return version == 0 || version == GROUPS_PASSES * g->count + 1 ? 1 : TRAINED_PARTS;
}

/* Reads parameters and moments of a block. Moments are not checked as a model is:
 * their rotations may be zeros. */
static oxl_result groups_read(const struct groups *g, int block, struct trained_model *m)
{
    oxl_context *ctx = g->job->ctx;
    const int version = g->version[block];
    oxl_result rc = OXL_OK;
    *m = (struct trained_model){0};
    for (int k = 0; k < groups_parts(g, version) && rc == OXL_OK; k++) {
        const char *path = GROUPS_PATH(g, block, GROUPS_PART[k], version);
        rc = (k ? model_file_read_ply : oxl_model_read)(ctx, path, model_trained_part(m, k));
        if (rc == OXL_OK && model_trained_part(m, k)->count != m->model.count)
            rc = oxl_fail(ctx, OXL_ERR_INPUT, "%s: its rows differ from those of its model", path);
    }
    if (rc == OXL_OK && groups_parts(g, version) == 1) rc = model_trained_begin(ctx, m);
    memcpy(m->mean.origin, m->model.origin, sizeof m->mean.origin);
    memcpy(m->square.origin, m->model.origin, sizeof m->square.origin);
    if (rc != OXL_OK) model_trained_free(ctx, m);
    return rc;
}

static oxl_result groups_write(const struct groups *g, int block, int version, struct trained_model *m)
{
    oxl_result rc = OXL_OK;
    for (int k = 0; k < groups_parts(g, version) && rc == OXL_OK; k++)
        rc = model_file_write_ply(g->job->ctx, GROUPS_PATH(g, block, GROUPS_PART[k], version),
                                  model_trained_part(m, k), m->model.sh_degree);
    return rc;
}

/* Returns 1 if all files of the block exist. */
static int groups_has_files(const struct groups *g, int block)
{
    int all = 1;
    for (int k = 0; k < groups_parts(g, g->version[block]) && g->version[block] > 0; k++)
        all &= os_is_file(GROUPS_PATH(g, block, GROUPS_PART[k], g->version[block]));
    return all;
}

static void groups_remove(const struct groups *g, int block, int version)
{
    for (int k = 0; k < (block < 0 ? 1 : TRAINED_PARTS) && version > 0; k++)
        os_remove(GROUPS_PATH(g, block, block < 0 ? "imaging" : GROUPS_PART[k], version));
}

static oxl_result groups_write_state(const struct groups *g)
{
    struct text t = {.ctx = g->job->ctx};
    oxl_result rc;
    text_add(
        &t,
        "# groups, tasks done, version of the gains, seconds; of each block the version of its files; of each view the group\n"
        "groups %d %d %d %.17g\n",
        g->count, g->done, g->gains, g->seconds);
    for (int k = 0; k < g->job->partition.block_count; k++) text_add(&t, "%d ", g->version[k]);
    for (int i = 0; i < g->views; i++) text_add(&t, "%d ", g->of[i]);
    text_add(&t, "\n%s\n", g->job->key.data);
    checksum_end_text(&t);
    rc = os_write_text(g->job->ctx, PATH(g->folder, "groups.txt"), &t);
    text_free(&t);
    return rc;
}

/* Maps groups.txt. *numbers stays NULL if there is none, or it is damaged or of another run. */
static oxl_result groups_map_state(const struct job *job, const char *folder, struct os_file_map *map,
                                   const char **numbers)
{
    const char *path = PATH(folder, "groups.txt");
    const oxl_result rc = os_is_file(path) ? os_read_file(job->ctx, path, map) : OXL_OK;
    if (rc == OXL_OK && map->data && checksum_of_text(map->data, map->size) == CHECKSUM_RIGHT &&
        text_has_line(map->data, job->key.data))
        *numbers = strstr(map->data, "\ngroups ");
    return rc;
}

OXL_INTERNAL oxl_result groups_have_begun(const struct job *job, const char *folder, int *begun)
{
    struct os_file_map map = {0};
    const char *numbers = NULL;
    const oxl_result rc = groups_map_state(job, folder, &map, &numbers);
    *begun = numbers != NULL;
    os_release_file(job->ctx, &map);
    return rc;
}

/* Reads groups.txt; count stays 0 if there is none of this run, or files that it names are missing (lost). */
static oxl_result groups_read_state(struct groups *g)
{
    struct os_file_map map = {0};
    const int blocks = g->job->partition.block_count;
    const char *s = NULL;
    int used = 0, good;
    const oxl_result rc = groups_map_state(g->job, g->folder, &map, &s);
    good = s &&
           sscanf(s, "\ngroups %d %d %d %lf%n", &g->count, &g->done, &g->gains, &g->seconds, &used) == 4 &&
           g->count > 0 && g->count <= g->views && g->done >= 0 && g->gains >= 0 && g->seconds >= 0;
    for (int i = 0; i < blocks + g->views && good; i++) {
        s += used;
        good = sscanf(s, "%d%n", i < blocks ? &g->version[i] : &g->of[i - blocks], &used) == 1 &&
               (i < blocks ? g->version[i] >= 0 : g->of[i - blocks] >= -1 && g->of[i - blocks] < g->count);
    }
    for (int k = 0; k < blocks && good; k++) good = groups_has_files(g, k);
    if (good && g->done > GROUPS_PASSES * g->count)
        good = os_is_file(PATH(g->folder, "block.json")) && os_is_file(PATH(g->folder, "model.ply"));
    if (!good) {
        g->lost = s != NULL;
        g->count = g->done = g->gains = 0, g->seconds = 0;
        memset(g->version, 0, (size_t)blocks * sizeof *g->version);
    }
    os_release_file(g->job->ctx, &map);
    return rc;
}

/* Removes a file of another version than that in groups.txt: a process was killed before it
 * removed or named the file. */
static void groups_remove_other_version(void *user, const char *name)
{
    const struct groups *g = user;
    int block = -1, version = 0;
    if (sscanf(name, "imaging.%d.", &version) == 1 && version != g->gains) groups_remove(g, -1, version);
    else if (sscanf(name, "%d.%*[a-z].%d.", &block, &version) == 2 && block >= 0 &&
             block < g->job->partition.block_count && version != g->version[block])
        groups_remove(g, block, version);
}

/* Removes a file that groups have written. */
static void groups_remove_any(void *user, const char *name)
{
    const struct job *job = user;
    int block, version, end = 0;
    if (sscanf(name, "imaging.%d.txt%n", &version, &end) < 1)
        sscanf(name, "%d.%*[a-z].%d.ply%n", &block, &version, &end);
    if (!strcmp(name, "groups.txt") || (end > 0 && !name[end]))
        os_remove(PATH(JOB_BLOCK(job, JOB_MERGED_MODEL), "%s", name));
}

OXL_INTERNAL void groups_clean(struct job *job)
{
    const char *folder = JOB_BLOCK(job, JOB_MERGED_MODEL);
    if (os_is_folder(folder)) os_list_folder(job->ctx, folder, groups_remove_any, job);
}

static oxl_result groups_remove_temporaries(struct groups *g)
{
    if (!os_is_folder(g->folder)) return OXL_OK;
    os_list_folder(g->job->ctx, g->folder, groups_remove_other_version, g);
    return os_remove_temporaries(g->job->ctx, g->folder, BLOCK_FILES " groups.txt *.ply *.txt");
}

/* ---------------- groups */

/* Marks in keep (rows) the rows that one of `count` views may show, and returns their number. */
static size_t groups_mark_visible(const struct groups *g, const int *view, int count, const oxl_model *m,
                                  uint8_t *keep)
{
    const double near = oxl_scene_near_plane(g->job->scene);
    size_t kept = 0;
#pragma omp parallel for schedule(dynamic, 1024) num_threads(g->job->ctx->threads)
    for (int64_t i = 0; i < (int64_t)m->count; i++) {
        keep[i] = 0;
        for (int v = 0; v < count && !keep[i]; v++)
            keep[i] =
                (uint8_t)model_row_shows(&oxl_scene_view(g->job->scene, view[v])->camera, near, m, (size_t)i);
    }
    for (size_t i = 0; i < m->count; i++) kept += keep[i];
    return kept;
}

static oxl_result groups_count(const struct groups *g, const int *view, int count, double *rows)
{
    oxl_result rc = OXL_OK;
    *rows = 0;
    for (int k = 0; k < g->job->partition.block_count && rc == OXL_OK; k++) {
        oxl_model m = {0};
        uint8_t *keep = NULL;
        rc = job_read_model(g->job, k, 0, &m);
        if (rc == OXL_OK && !(keep = oxl_alloc(g->job->ctx, m.count + 1, 1))) rc = OXL_ERR_MEMORY;
        if (rc == OXL_OK) *rows += (double)groups_mark_visible(g, view, count, &m, keep);
        oxl_free(g->job->ctx, keep);
        oxl_model_free(g->job->ctx, &m);
    }
    return rc;
}

/* Makes one group of the views, or halves them until each part fits. */
static oxl_result groups_divide(struct groups *g, const int *view, int count)
{
    double rows = 0;
    oxl_result rc = context_stopped(g->job->ctx);
    if (rc == OXL_OK) rc = groups_count(g, view, count, &rows);
    if (rc != OXL_OK) return rc;
    if (rows > g->limit && count > 1) {
        rc = groups_divide(g, view, count / 2);
        return rc == OXL_OK ? groups_divide(g, view + count / 2, count - count / 2) : rc;
    }
    if (rows > g->limit) {
        oxl_log(
            g->job->ctx, OXL_LOG_WARNING,
            "%s shows %.0f Gaussians, more than the %.0f that fit into memory: it is left out of the last stage",
            oxl_scene_view(g->job->scene, view[0])->name, rows, g->limit);
        return OXL_OK;
    }
    for (int v = 0; v < count; v++) g->of[view[v]] = g->count;
    g->count++;
    return OXL_OK;
}

/* Orders the training views by the block that has the largest window in them, so that a group's
 * views show few Gaussians. */
static oxl_result groups_order(const struct groups *g, int *view, int *count)
{
    const int blocks = g->job->partition.block_count;
    double *largest = oxl_calloc(g->job->ctx, (size_t)g->views + 1, sizeof *largest);
    int *owner = oxl_calloc(g->job->ctx, (size_t)g->views + 1, sizeof *owner);
    oxl_result rc = largest && owner ? OXL_OK : OXL_ERR_MEMORY;
    *count = 0;
    for (int k = 0; k < blocks && rc == OXL_OK; k++) {
        struct block_plan plan = {0};
        rc = block_plan_read(g->job, k, &plan);
        for (int i = 0; i < plan.views; i++) {
            const double area = (double)plan.window[i].width * plan.window[i].height;
            if (area > largest[i]) largest[i] = area, owner[i] = k;
        }
        block_plan_free(g->job->ctx, &plan);
    }
    for (int k = 0; k < blocks && rc == OXL_OK; k++)
        for (int i = 0; i < g->views; i++)
            if (owner[i] == k && !oxl_scene_view(g->job->scene, i)->is_test) view[(*count)++] = i;
    OXL_FREE(g->job->ctx, largest, owner);
    return rc;
}

static oxl_result groups_make(struct groups *g)
{
    int *view = oxl_alloc(g->job->ctx, (size_t)g->views + 1, sizeof *view), count = 0;
    oxl_result rc = view ? groups_order(g, view, &count) : OXL_ERR_MEMORY;
    for (int i = 0; i < g->views; i++) g->of[i] = -1;
    if (rc == OXL_OK) rc = groups_divide(g, view, count);
    if (rc == OXL_OK)
        oxl_log(g->job->ctx, g->lost ? OXL_LOG_WARNING : OXL_LOG_INFO, "%s: %d group%s of views",
                g->lost ? "files of the last stage are missing or damaged, so it begins again"
                        : "the merged model does not fit into memory",
                g->count, g->count == 1 ? "" : "s");
    if (rc == OXL_OK) rc = oxl_make_folder(g->job->ctx, g->folder);
    if (rc == OXL_OK) rc = groups_write_state(g);
    oxl_free(g->job->ctx, view);
    return rc;
}

/* ---------------- a task */

/* Returns the last step of a task, counted from the first of the model, or of that for viewers. Each task has
 * steps in proportion to its views. */
static int groups_last_step(const struct groups *g, int task)
{
    int below = 0, all = 0;
    for (int i = 0; i < g->views; i++) {
        below += g->of[i] >= 0 && g->of[i] <= task % g->count;
        all += g->of[i] >= 0;
    }
    return (int)(g->steps * (task / g->count + (double)below / OXL_MAX(all, 1)) / GROUPS_PASSES + 0.5);
}

/* Merges the rows of all blocks that the views may show, with their moments. */
static oxl_result groups_load(struct groups *g, const int *view, int views, struct trained_model *all)
{
    oxl_context *ctx = g->job->ctx;
    oxl_result rc = OXL_OK;
    for (int k = 0; k < TRAINED_PARTS && rc == OXL_OK; k++) {
        oxl_model *to = model_trained_part(all, k);
        rc = oxl_model_create(ctx, 0, 0, to);
        memcpy(to->origin, g->job->origin, sizeof to->origin);
    }
    for (int b = 0; b < g->job->partition.block_count && rc == OXL_OK; b++) {
        struct trained_model m;
        rc = groups_read(g, b, &m);
        oxl_free(ctx, g->keep[b]);
        g->keep[b] = rc == OXL_OK ? oxl_alloc(ctx, m.model.count + 1, 1) : NULL;
        if (rc == OXL_OK && !g->keep[b]) rc = OXL_ERR_MEMORY;
        if (rc == OXL_OK) groups_mark_visible(g, view, views, &m.model, g->keep[b]);
        for (int k = 0; k < TRAINED_PARTS && rc == OXL_OK; k++)
            rc = merge_rows(ctx, model_trained_part(&m, k), g->keep[b], model_trained_part(all, k));
        model_trained_free(ctx, &m);
    }
    return rc;
}

/* Copies row `from` to row `to`. */
static void groups_copy_row(const oxl_model *all, size_t from, oxl_model *m, size_t to)
{
    for (int p = 0; p < oxl_model_planes(m); p++) m->plane[p][to] = all->plane[p][from];
    for (int p = OXL_LOBE; p < OXL_PLANES && to < m->lobes; p++) m->plane[p][to] = all->plane[p][from];
}

/* Takes the rows of a block from the task's model, in which rows with second lobes come first. A row that is
 * not finite keeps its values. */
static oxl_result groups_store_block(struct groups *g, int block, int version, struct trained_model *all,
                                     size_t at[2])
{
    const uint8_t *keep = g->keep[block];
    size_t kept = 0;
    struct trained_model m;
    oxl_result rc = groups_read(g, block, &m);
    if (rc == OXL_OK) rc = model_trained_set_degree(g->job->ctx, &m, all->model.sh_degree);
    for (size_t i = 0; i < m.model.count && rc == OXL_OK; i++) {
        const size_t from = keep[i] ? at[i >= m.model.lobes]++ : 0;
        kept += keep[i];
        for (int k = 0; k < TRAINED_PARTS && keep[i] && model_row_is_finite(&all->model, from); k++)
            groups_copy_row(model_trained_part(all, k), from, model_trained_part(&m, k), i);
    }
    if (rc == OXL_OK && kept > 0) rc = groups_write(g, block, version, &m);
    if (rc == OXL_OK && kept > 0) g->version[block] = version;
    model_trained_free(g->job->ctx, &m);
    return rc;
}

/* Writes a block's model with medium or gains in its colours. */
static oxl_result groups_bake_block(struct groups *g, int block, int version)
{
    struct trained_model m = {{0}, {0}, {0}};
    oxl_result rc =
        oxl_model_read(g->job->ctx, GROUPS_PATH(g, block, GROUPS_PART[0], g->version[block]), &m.model);
    if (rc == OXL_OK) {
        medium_make_standard(g->job->scene, imaging_is_gains_alone(&g->job->scene->imaging), &m.model);
        rc = groups_write(g, block, version, &m);
    }
    if (rc == OXL_OK) g->version[block] = version;
    model_trained_free(g->job->ctx, &m);
    return rc;
}

/* Writes all blocks as a new version, with the rows of a task, or with medium or gains in their colours if
 * `all` is NULL; then groups.txt, and only then removes the old version: a killed process loses the task
 * alone. */
static oxl_result groups_store(struct groups *g, struct trained_model *all)
{
    const int blocks = g->job->partition.block_count, version = g->done + 1;
    const int gains = g->gains;
    size_t at[2] = {0, all ? all->model.lobes : 0};
    int *old = oxl_alloc(g->job->ctx, (size_t)blocks, sizeof *old);
    oxl_result rc = old ? OXL_OK : OXL_ERR_MEMORY;
    for (int b = 0; b < blocks && rc == OXL_OK; b++) {
        old[b] = g->version[b];
        rc = all ? groups_store_block(g, b, version, all, at) : groups_bake_block(g, b, version);
    }
    if (rc == OXL_OK && all && !g->viewers && imaging_is_needed(&g->job->scene->imaging)) {
        rc = imaging_write(g->job->ctx, GROUPS_PATH(g, -1, "imaging", version), g->job->scene,
                           &g->job->scene->imaging);
        g->gains = version;
    }
    g->done = version;
    if (rc == OXL_OK) rc = groups_write_state(g);
    for (int b = 0; b < blocks && rc == OXL_OK; b++)
        if (old[b] != g->version[b]) groups_remove(g, b, old[b]);
    if (rc == OXL_OK && gains != g->gains) groups_remove(g, -1, gains);
    if (rc == OXL_OK) checkpoint_remove(g->folder, 0);
    oxl_free(g->job->ctx, old);
    return rc;
}

static int groups_progress(void *user, const oxl_progress *progress)
{
    struct groups *g = user;
    oxl_progress p = *progress;
    g->step = p.iteration;
    p.iteration += g->before, p.iterations += g->before;
    return job_progress(g->job, &p);
}

static oxl_result groups_train(struct groups *g, const struct image_window *window, struct trained_model *all,
                               int from, int until)
{
    struct job *job = g->job;
    const oxl_train_options *run = &job->options.train;
    oxl_train_options o =
        g->viewers ? block_standard_options(run, all->model.sh_degree, block_standard_steps(run), job->scene)
                   : block_refinement(run, all->model.sh_degree, g->steps);
    struct text key = {.ctx = job->ctx}, log = {.ctx = job->ctx}, notes = {.ctx = job->ctx};
    oxl_model out = {0};
    struct train_task train = {.log = &log,
                               .notes = &notes,
                               .start = &all->model,
                               .moments = all,
                               .window = window,
                               .first = from,
                               .until = until,
                               .frozen = g->viewers};
    const double started = os_seconds();
    oxl_result rc;
    text_add(&key, "task %d, %s", g->done, job->key.data);
    train.store = checkpoint_in(g->folder, key.data);
    rc = key.failed ? OXL_ERR_MEMORY : OXL_OK;
    job_limit_time(job, &o);
    if (rc == OXL_OK)
        rc = train_run(job->ctx, job->scene, &o, &(oxl_callback){groups_progress, g}, &train, &out);
    if (rc == OXL_OK) oxl_model_free(job->ctx, &all->model), all->model = out;
    else oxl_model_free(job->ctx, &out);
    g->seconds += os_seconds() - started;
    text_free(&key);
    text_free(&log);
    text_free(&notes);
    return rc;
}

static oxl_result groups_task(struct groups *g, int group, int from, int until)
{
    oxl_context *ctx = g->job->ctx;
    struct image_window *window = oxl_calloc(ctx, (size_t)g->views + 1, sizeof *window);
    int *view = oxl_alloc(ctx, (size_t)g->views + 1, sizeof *view), views = 0;
    struct trained_model all = {{0}, {0}, {0}};
    oxl_result rc = window && view ? OXL_OK : OXL_ERR_MEMORY;
    for (int i = 0; i < g->views && rc == OXL_OK; i++) {
        const oxl_camera *c = &oxl_scene_view(g->job->scene, i)->camera;
        if (g->of[i] != group) continue;
        window[i] = (struct image_window){0, 0, c->width, c->height};
        view[views++] = i;
    }
    if (rc == OXL_OK) rc = groups_load(g, view, views, &all);
    if (rc == OXL_OK) rc = groups_train(g, window, &all, from, until);
    if (rc == OXL_OK && g->step >= until) rc = groups_store(g, &all);
    else if (rc == OXL_OK) g->job->unfinished++; /* Ends the run early: the time allowed is over. */
    model_trained_free(ctx, &all);
    OXL_FREE(ctx, window, view);
    return rc;
}

/* ---------------- all tasks */

/* Reads the imaging that the last task left, or that of the blocks. */
static oxl_result groups_read_gains(const struct groups *g)
{
    const char *path = GROUPS_PATH(g, -1, "imaging", g->gains);
    imaging_free(g->job->ctx, &g->job->scene->imaging);
    if (g->gains == 0 || !os_is_file(path)) return job_join_imaging(g->job, &g->job->scene->imaging);
    return imaging_read(g->job->ctx, path, g->job->scene, &g->job->scene->imaging);
}

/* Merges the blocks' files into blocks/whole/NAME, and writes the record. model_standard.ply of an earlier
 * model.ply is removed. */
static oxl_result groups_write_result(struct groups *g, const char *name, int finished)
{
    const int blocks = g->job->partition.block_count;
    const struct block_record record = {
        .trained = 1, .finished = finished, .iterations = 1, .seconds = g->seconds};
    char **path = oxl_calloc(g->job->ctx, (size_t)blocks + 1, sizeof *path);
    oxl_result rc = path ? OXL_OK : OXL_ERR_MEMORY;
    for (int b = 0; b < blocks && rc == OXL_OK; b++) {
        path[b] = oxl_strdup(g->job->ctx, GROUPS_PATH(g, b, GROUPS_PART[0], g->version[b]));
        if (!path[b]) rc = OXL_ERR_MEMORY;
    }
    if (!strcmp(name, "model.ply")) os_remove(PATH(g->folder, "model_standard.ply"));
    if (rc == OXL_OK)
        rc = merge_files(g->job->ctx, path, blocks, g->job->origin, PATH(g->folder, "%s", name));
    if (rc == OXL_OK) rc = groups_read_gains(g); /* Undoes what the training of a model for viewers left. */
    if (rc == OXL_OK)
        rc = block_write_finished(g->job->ctx, g->job->scene, g->folder, g->job->key.data, &record);
    for (int b = 0; b < blocks && path; b++) oxl_free(g->job->ctx, path[b]);
    oxl_free(g->job->ctx, path);
    return rc;
}

/* Trains in all turns that are left. first: number of the first task in them. */
static oxl_result groups_run_tasks(struct groups *g, int first)
{
    oxl_result rc = OXL_OK;
    while (rc == OXL_OK && g->done < first + GROUPS_PASSES * g->count && !g->job->unfinished) {
        const int task = g->done - first, from = task > 0 ? groups_last_step(g, task - 1) : 0,
                  until = groups_last_step(g, task);
        if (until <= from) {
            g->done++;
            continue;
        }
        if (g->viewers) rc = groups_read_gains(g);
        if (rc == OXL_OK) rc = groups_task(g, task % g->count, from, until);
    }
    return rc;
}

/* Writes model.ply and trains the model for viewers, which a task without steps begins. */
static oxl_result groups_run_viewers(struct groups *g)
{
    const int first = GROUPS_PASSES * g->count;
    oxl_result rc = OXL_OK;
    if (g->done == first) rc = groups_write_result(g, "model.ply", 0);
    if (rc == OXL_OK && g->done == first) rc = groups_store(g, NULL);
    g->viewers = 1, g->before = g->steps, g->step = 0;
    g->steps = block_hiding_steps(block_standard_steps(&g->job->options.train));
    if (rc == OXL_OK)
        oxl_log(g->job->ctx, OXL_LOG_INFO, "the model without %s, for viewers, is refined for %d iterations",
                imaging_is_gains_alone(&g->job->scene->imaging) ? "gains" : "medium", g->steps);
    return rc == OXL_OK ? groups_run_tasks(g, first + 1) : rc;
}

OXL_INTERNAL oxl_result groups_run(struct job *job, const char *folder)
{
    const struct cost_load load = cost_load_of_scene(job->scene);
    const int blocks = job->partition.block_count;
    struct groups g = {.job = job,
                       .folder = folder,
                       .steps = job->stage_until,
                       .limit = budget_max_gaussians(&load, &job->options),
                       .views = oxl_scene_view_count(job->scene),
                       .version = oxl_calloc(job->ctx, (size_t)blocks, sizeof *g.version),
                       .keep = oxl_calloc(job->ctx, (size_t)blocks, sizeof *g.keep)};
    int hides = 0;
    oxl_result rc = (g.of = oxl_calloc(job->ctx, (size_t)g.views + 1, sizeof *g.of)) && g.version && g.keep
                        ? OXL_OK
                        : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = groups_read_state(&g);
    if (rc == OXL_OK) rc = groups_remove_temporaries(&g);
    if (rc == OXL_OK && g.count == 0) rc = groups_make(&g);
    if (rc == OXL_OK && g.count == 0) rc = budget_refuse(job->ctx, &load, &job->options, 0);
    if (rc == OXL_OK) rc = groups_read_gains(&g);
    hides = rc == OXL_OK && block_hides(job->scene);
    if (hides) job->stage_viewers = block_hiding_steps(block_standard_steps(&job->options.train));
    job_set_cache(job, budget_cache(&job->options));
    if (rc == OXL_OK) rc = groups_run_tasks(&g, 0);
    if (rc == OXL_OK && hides && !job->unfinished) rc = groups_run_viewers(&g);
    if (rc == OXL_OK && !job->unfinished)
        rc = groups_write_result(&g, hides ? "model_standard.ply" : "model.ply", 1);
    groups_free(&g);
    return rc;
}

/* block.c - the training of one block, in its folder OUT/blocks/KKK: checkpoint.oxl while it runs, then model.ply, log.csv, block.json.
 *
 * block.json is written last. Invariant: a block.json that says "finished": true describes the model.ply beside it, and the line
 * "job" in it says of which run it is.
 */
#include "internal.h"

#define BLOCK_LOG_ROWS    200  /* rows of log.csv in a whole run */
#define BLOCK_LOG_SECONDS 30.0 /* log.csv on disk is at most this old */

struct block {
    oxl_context             *ctx;
    const struct block_task *task;
    oxl_progress             last;
    struct text              log, notes;
    double                   log_written; /* seconds */
    oxl_faults               faults;
};

static oxl_result block_write(struct block *b, const char *name, const struct text *t)
{
    char      *path = oxl_path_join(b->ctx, b->task->folder, name);
    oxl_result rc   = path && !t->failed ? OXL_OK : oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory to write %s", name);
    if (rc == OXL_OK) rc = os_write_file(b->ctx, path, t->data, t->size);
    oxl_free(b->ctx, path);
    return rc;
}

/* ---------------------------------------------------------------- block.json */

OXL_INTERNAL oxl_result block_read(oxl_context *ctx, const char *folder, const char *key, struct block_record *out)
{
    struct os_file_map map   = {0};
    char              *path  = oxl_path_join(ctx, folder, "block.json");
    char              *model = oxl_path_join(ctx, folder, "model.ply");
    oxl_result         rc    = path && model ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to look into %s", folder);
    *out                     = (struct block_record){0};
    if (rc == OXL_OK && os_is_file(path) && os_is_file(model)) rc = os_read_file(ctx, path, &map);
    if (rc == OXL_OK && map.data && strstr(map.data, key)) {
        out->there             = 1;
        out->finished          = strstr(map.data, "\"finished\": true") != NULL;
        out->iterations        = (int)OXL_CLAMP(run_number(map.data, "iterations_done"), 0, INT_MAX);
        out->gaussians         = (size_t)OXL_CLAMP(run_number(map.data, "gaussians"), 0, 1e9);
        out->seconds           = run_number(map.data, "seconds");
        out->peak              = run_number(map.data, "peak_rss_bytes");
        out->predicted_peak    = run_number(map.data, "predicted_memory_bytes");
        out->predicted_seconds = run_number(map.data, "predicted_seconds");
        faults_read_json(map.data, &out->faults);
    }
    os_release_file(ctx, &map);
    oxl_free(ctx, path);
    oxl_free(ctx, model);
    return rc;
}

static void block_add(struct text *t, const char *name, double value)
{
    text_add(t, "  \"%s\": ", name);
    text_add_number(t, value);
    text_add(t, ",\n");
}

static oxl_result block_write_record(struct block *b, const struct block_record *r)
{
    struct text t = {.ctx = b->ctx};
    oxl_result  rc;
    text_add(&t, "{\n  \"finished\": %s,\n", r->finished ? "true" : "false");
    block_add(&t, "iterations_done", r->iterations);
    block_add(&t, "gaussians", (double)r->gaussians);
    block_add(&t, "seconds", r->seconds);
    block_add(&t, "peak_rss_bytes", r->peak);
    block_add(&t, "predicted_memory_bytes", r->predicted_peak);
    block_add(&t, "predicted_seconds", r->predicted_seconds);
    faults_add_json(&t, &r->faults);
    text_add(&t, "  %s,\n  \"notes\": [%s]\n}\n", b->task->key, b->notes.size ? b->notes.data : "");
    t.failed |= b->notes.failed;
    rc = block_write(b, "block.json", &t);
    text_free(&t);
    return rc;
}

/* ---------------------------------------------------------------- while it runs */

static double block_rounded(double value, double parts)
{
    return floor(value * parts + 0.5) / parts;
}

static void block_log_row(struct block *b, const oxl_progress *p)
{
    text_add(&b->log, "%d,", p->iteration);
    text_add_number(&b->log, block_rounded(p->loss, 1e6));
    text_add(&b->log, ",");
    text_add_number(&b->log, block_rounded(p->psnr, 1e3));
    text_add(&b->log, ",%zu,", p->gaussians);
    text_add_number(&b->log, block_rounded(p->seconds, 1e3));
    text_add(&b->log, ",");
    text_add_number(&b->log, block_rounded(p->f_mid, 1e4));
    text_add(&b->log, ",");
    text_add_number(&b->log, block_rounded(p->f_far, 1e4));
    text_add(&b->log, ",%zu\n", os_peak_rss());
}

static int block_progress(void *user, const oxl_progress *progress)
{
    struct block       *b     = user;
    const oxl_callback *next  = b->task->callback;
    oxl_progress        p     = *progress;
    const int           every = OXL_MAX(1, p.iterations / BLOCK_LOG_ROWS);
    const int again = b->last.iteration == 0 && p.iteration > 1; /* a resumed run says where it stands: that row is there */
    if (!again && (p.iteration % every == 0 || p.iteration == p.iterations)) block_log_row(b, &p);
    if (p.seconds - b->log_written > BLOCK_LOG_SECONDS) {
        block_write(b, "log.csv", &b->log); /* a full disk is reported at the end, where it matters */
        b->log_written = p.seconds;
    }
    b->last       = p;
    b->last.model = NULL;
    return next && next->progress ? next->progress(next->user, &p) : 0;
}

/* What a killed process left of files that it was writing: no other one writes into this folder. */
struct block_sweep {
    oxl_context *ctx;
    const char  *folder;
};

static void block_sweep_file(void *user, const char *name)
{
    struct block_sweep *s      = user;
    const size_t        length = strlen(name);
    char               *path   = oxl_path_join(s->ctx, s->folder, name);
    if (path && length > 4 && !strcmp(name + length - 4, ".tmp")) os_remove(path);
    oxl_free(s->ctx, path);
}

static oxl_result block_sweep(oxl_context *ctx, const char *folder)
{
    char      *text = oxl_path_join(ctx, folder, "sparse/0");
    oxl_result rc   = text ? OXL_OK : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to look into %s", folder);
    if (rc == OXL_OK) rc = os_list_folder(ctx, folder, block_sweep_file, &(struct block_sweep){ctx, folder});
    if (rc == OXL_OK && os_is_folder(text)) rc = os_list_folder(ctx, text, block_sweep_file, &(struct block_sweep){ctx, text});
    oxl_free(ctx, text);
    return rc;
}

/* ---------------------------------------------------------------- the block */

static oxl_result block_finish(struct block *b, const oxl_model *model, int finished)
{
    const struct block_record record = {.finished          = finished,
                                        .iterations        = b->last.iteration,
                                        .gaussians         = model->count,
                                        .seconds           = block_rounded(b->last.seconds, 1e3),
                                        .peak              = (double)os_peak_rss(),
                                        .predicted_peak    = b->task->predicted_peak,
                                        .predicted_seconds = block_rounded(b->task->predicted_seconds, 1e3),
                                        .faults            = b->faults};
    char                     *path   = oxl_path_join(b->ctx, b->task->folder, "model.ply");
    oxl_result rc = path ? block_write(b, "log.csv", &b->log) : oxl_fail(b->ctx, OXL_ERR_MEMORY, "no memory to write model.ply");
    if (rc == OXL_OK) rc = modelfile_write_ply(b->ctx, path, model, model->sh_degree);
    if (rc == OXL_OK) rc = block_write_record(b, &record);
    if (rc == OXL_OK && finished) checkpoint_remove(b->ctx, b->task->folder);
    oxl_free(b->ctx, path);
    return rc;
}

OXL_INTERNAL oxl_result block_train(oxl_context *ctx, oxl_scene *scene, const struct block_task *task)
{
    struct block             b     = {.ctx = ctx, .task = task, .log = {.ctx = ctx}, .notes = {.ctx = ctx}};
    const struct train_place place = {task->folder, task->key, &b.log, &b.notes, &b.faults};
    struct text             *outer = ctx->notes;
    oxl_model                model = {0};
    oxl_result               rc    = os_make_folder(ctx, task->folder), written;
    if (rc == OXL_OK) rc = block_sweep(ctx, task->folder);
    if (rc != OXL_OK) return rc;
    text_add(&b.log, "iteration,loss,psnr,gaussians,seconds,f_mid,f_far,peak_rss_bytes\n");
    ctx->notes = &b.notes;
    rc         = train_run(ctx, scene, &task->train, &(oxl_callback){block_progress, &b}, &place, &model);
    ctx->notes = outer;
    if (rc == OXL_OK || rc == OXL_ERR_INTERRUPTED) {
        written = block_finish(&b, &model, rc == OXL_OK && b.last.iteration == task->train.iterations);
        if (written != OXL_OK) rc = written;
    }
    oxl_model_free(ctx, &model);
    text_free(&b.log);
    text_free(&b.notes);
    return rc;
}

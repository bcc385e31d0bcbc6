/* block.c - trains one block in its folder OUT/blocks/KKK: checkpoint.oxl while it runs, then model.ply,
 * log.csv, block.json, and, where viewers need another model (train/trained.c), model_standard.ply.
 *
 * Invariant: block.json is written last; one that says "finished": true describes the model.ply beside it,
 * and its line "job" identifies the run.
 */
#include "large.h"
#include "../formats/formats.h"
#include "../render/render.h"

#include "../formats/json.h"
#include "../survey/scene.h"
#include "../model/model.h"
#include "os_job.h"

#define BLOCK_LOG_ROWS 200     /* Limits the rows of log.csv in a whole run. */
#define BLOCK_LOG_SECONDS 30.0 /* Limits the age of log.csv on disk. */

struct block {
    oxl_context *ctx;
    const struct block_task *task;
    oxl_progress last;
    struct text log, notes;
    double log_written; /* seconds of the run at the last writing of log.csv */
};

/* ---------------- block.json */

OXL_INTERNAL void text_add_member(struct text *t, const char *name, double value)
{
    text_add(t, "  \"%s\": %s,\n", name, NUMBER(value));
}

static const char BLOCK_CHECKSUM[] = "  \"checksum\": \"";

static const char *const BLOCK_NUMBER[BLOCK_NUMBERS] = {
    "iterations_done",        "gaussians",        "seconds",
    "peak_rss_bytes",         "images_left_out",  "steps_skipped",
    "gaussian_steps_skipped", "gaussians_cleared"};

OXL_INTERNAL void block_add_numbers(struct text *t, const struct block_record *r, int first)
{
    for (int k = first; k < BLOCK_NUMBERS; k++) text_add_member(t, BLOCK_NUMBER[k], r->number[k]);
}

/* Adds the checksum, of the text before it and of the files in the folder, which ends block.json. */
static oxl_result block_add_checksum(oxl_context *ctx, const char *folder, const char *text, size_t size,
                                     struct text *out)
{
    static const char *const files[] = {"model.ply", "imaging.txt", "model_standard.ply"};
    uint64_t sum = checksum_add(CHECKSUM_SEED, text, size);
    oxl_result rc = OXL_OK;
    for (size_t i = 0; i < OXL_COUNT(files) && rc == OXL_OK; i++) {
        const char *path = PATH(folder, "%s", files[i]);
        uint64_t of_file = 0;
        if (os_is_file(path)) rc = checksum_of_file(ctx, path, 0, &of_file);
        sum = checksum_add(sum, &of_file, sizeof of_file);
    }
    text_add(out, "%s%016llx\"\n}\n", BLOCK_CHECKSUM, (unsigned long long)sum);
    return rc;
}

/* Returns 1 if the members "job" and "found" are those of the key, their text in block.json. */
static int block_has_key(const char *json, const char *key)
{
    static const char begin[] = "\"job\": ";
    const char *job = oxl_json_member(json, "job");
    return job && !strncmp(key, begin, sizeof begin - 1) &&
           !strncmp(job, key + sizeof begin - 1, strlen(key) - (sizeof begin - 1));
}

/* Compares text and files with the checksum. */
static oxl_result block_check(oxl_context *ctx, const char *folder, const char *json, int *whole)
{
    const char *end = strstr(json, BLOCK_CHECKSUM);
    struct text t = {.ctx = ctx};
    oxl_result rc = OXL_OK;
    if (end) rc = block_add_checksum(ctx, folder, json, (size_t)(end - json), &t);
    *whole = end && t.data && !strcmp(end, t.data);
    text_free(&t);
    return rc;
}

OXL_INTERNAL oxl_result block_read(oxl_context *ctx, const char *folder, const char *key,
                                   struct block_record *out)
{
    struct os_file_map map = {0};
    const char *path = PATH(folder, "block.json");
    int whole = 1;
    oxl_result rc = OXL_OK;
    *out = (struct block_record){0};
    if (os_is_file(path) && os_is_file(PATH(folder, "model.ply"))) rc = os_read_file(ctx, path, &map);
    if (rc == OXL_OK && map.data && block_has_key(map.data, key)) {
        out->exists = 1;
        out->finished = oxl_json_is_true(map.data, "finished");
        for (int k = 0; k < BLOCK_NUMBERS; k++) {
            const double value = oxl_json_number(map.data, BLOCK_NUMBER[k]);
            out->number[k] = value >= 0 && value < BLOCK_NUMBER_MAX ? value : 0;
        }
        if (out->finished) rc = block_check(ctx, folder, map.data, &whole);
    }
    os_release_file(ctx, &map);
    if (rc != OXL_OK || whole) return rc;
    oxl_log(ctx, OXL_LOG_WARNING,
            "%s: block.json, a model or imaging.txt is damaged; that part is trained again", folder);
    *out = (struct block_record){0};
    return OXL_OK;
}

/* Appends the text inside the brackets of an object or array of a folder's block.json. */
OXL_INTERNAL oxl_result block_read_member(oxl_context *ctx, const char *folder, const char *name,
                                          struct text *out)
{
    struct os_file_map map = {0};
    const char *path = PATH(folder, "block.json"), *value;
    oxl_result rc = os_is_file(path) ? os_read_file(ctx, path, &map) : OXL_OK;
    value = oxl_json_member(map.data, name);
    if (value) {
        const size_t size = (size_t)(oxl_json_end(value) - value);
        if (size > 2) text_add(out, "%.*s", (int)(size - 2), value + 1);
    }
    os_release_file(ctx, &map);
    return rc;
}

static double block_round(double value, double parts)
{
    return floor(value * parts + 0.5) / parts;
}

static oxl_result block_write_record(struct block *b, const oxl_trained *trained)
{
    const oxl_nonfinite *n = &trained->nonfinite;
    const struct block_record record = {.number = {trained->iterations, (double)trained->model.count,
                                                   block_round(trained->seconds, 1e3), (double)os_peak_rss(),
                                                   (double)n->images, (double)n->steps, (double)n->rows,
                                                   (double)n->cleared}};
    struct text t = {.ctx = b->ctx};
    oxl_result rc;
    text_add(&t, "{\n  \"finished\": %s,\n", trained->finished ? "true" : "false");
    block_add_numbers(&t, &record, 0);
    text_add(&t, "  \"decisions\": {%s},\n", trained->decisions ? trained->decisions : "");
    text_add(&t, "  %s,\n  \"notes\": [%s],\n", b->task->key, b->notes.size ? b->notes.data : "");
    rc = block_add_checksum(b->ctx, b->task->folder, t.data ? t.data : "", t.size, &t);
    t.failed |= b->notes.failed;
    if (rc == OXL_OK) rc = os_write_text(b->ctx, PATH(b->task->folder, "block.json"), &t);
    text_free(&t);
    return rc;
}

/* Writes the block's files; the record comes last. The folder is made again if it was deleted meanwhile. */
static oxl_result block_write(struct block *b, const oxl_scene *scene, const oxl_trained *t)
{
    const char *folder = b->task->folder, *imaging = PATH(folder, "imaging.txt"),
               *viewer = PATH(folder, "model_standard.ply");
    oxl_result rc = oxl_make_folder(b->ctx, folder);
    os_remove(viewer); /* of an earlier model.ply */
    if (!imaging_is_needed(t->imaging)) os_remove(imaging);
    else if (rc == OXL_OK) rc = oxl_imaging_write(b->ctx, imaging, scene, t->imaging);
    if (rc == OXL_OK && b->log.size) rc = os_write_text(b->ctx, PATH(folder, "log.csv"), &b->log);
    if (rc == OXL_OK)
        rc = model_file_write_ply(b->ctx, PATH(folder, "model.ply"), &t->model, t->model.sh_degree);
    if (rc == OXL_OK && t->viewer.count)
        rc = model_file_write_ply(b->ctx, viewer, &t->viewer, t->viewer.sh_degree);
    return rc == OXL_OK ? block_write_record(b, t) : rc;
}

OXL_INTERNAL oxl_result block_keep(oxl_context *ctx, const oxl_scene *scene, const struct block_task *task,
                                   const oxl_trained *trained)
{
    return block_write(&(struct block){.ctx = ctx, .task = task}, scene, trained);
}

/* ---------------- while it runs */

static void block_log_row(struct block *b, const oxl_progress *p)
{
    text_add(&b->log, "%d,%s,%s,%zu,%s,%zu\n", p->iteration, NUMBER(block_round(p->loss, 1e6)),
             NUMBER(block_round(p->psnr, 1e3)), p->gaussians, NUMBER(block_round(p->seconds, 1e3)),
             os_peak_rss());
}

static int block_progress(void *user, const oxl_progress *progress)
{
    struct block *b = user;
    oxl_progress p = *progress;
    const int every = OXL_MAX(1, p.iterations / BLOCK_LOG_ROWS);
    /* Marks steps whose row a resumed log.csv has already. */
    const int again = (b->last.iteration == 0 && p.iteration > 1) || p.iteration <= b->last.iteration;
    /* Keeps steps of the model for viewers out of the log. */
    if (p.iteration > b->task->train.iterations) return context_report(b->task->callback, &p);
    if (!again && (p.iteration / every > b->last.iteration / every || p.iteration == p.iterations))
        block_log_row(b, &p);
    if (p.seconds - b->log_written > BLOCK_LOG_SECONDS) {
        /* Ignores a full disk, which the end of the run reports. */
        os_write_text(b->ctx, PATH(b->task->folder, "log.csv"), &b->log);
        b->log_written = p.seconds;
    }
    b->last = p;
    b->last.model = NULL;
    return context_report(b->task->callback, &p);
}

/* ---------------- the block */

/* Trains the block, or resumes its training; writes its files even if the callback stopped it. */
static oxl_result block_run(struct block *b, const oxl_scene *scene, oxl_trained *t)
{
    const struct block_task *task = b->task;
    const char *viewer = PATH(task->folder, "viewer");
    struct train_task run = task->run;
    oxl_result rc, written;
    run.store = checkpoint_in(task->folder, task->key), run.log = &b->log, run.notes = &b->notes;
    run.viewer_store = checkpoint_in(viewer, task->key);
    text_add(&b->log, "iteration,loss,psnr,gaussians,seconds,peak_rss_bytes\n");
    rc = trained_make(b->ctx, scene, &task->train, &(oxl_callback){block_progress, b}, &run, t);
    if (rc != OXL_OK && rc != OXL_ERR_INTERRUPTED) return rc;
    if (t->model.count == 0) return rc;
    t->finished |= run.until > 0 && t->iterations >= run.until;
    written = block_write(b, scene, t);
    /* The models are complete. */
    if (written == OXL_OK && t->finished) {
        checkpoint_remove(task->folder);
        checkpoint_remove(viewer);
        os_remove_folder(viewer);
    }
    return written == OXL_OK ? rc : written;
}

OXL_INTERNAL oxl_result block_train(oxl_context *ctx, const oxl_scene *scene, const struct block_task *task)
{
    struct block b = {.ctx = ctx, .task = task, .log = {.ctx = ctx}, .notes = {.ctx = ctx}};
    struct text *outer = ctx->notes;
    oxl_trained trained = {.finished = 0};
    oxl_result rc = oxl_make_folder(ctx, task->folder);
    if (rc == OXL_OK) rc = os_remove_temporaries(ctx, task->folder);
    if (rc != OXL_OK) return rc;
    ctx->notes = &b.notes;
    rc = block_run(&b, scene, &trained);
    ctx->notes = outer;
    if (trained.imaging) OXL_SWAP(struct oxl_imaging, *task->run.imaging, *trained.imaging);
    oxl_trained_free(ctx, &trained);
    text_free(&b.log);
    text_free(&b.notes);
    return rc;
}

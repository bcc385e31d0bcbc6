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
    const char *decisions; /* members of a JSON object */
    double log_written;    /* seconds of the run at the last writing of log.csv */
};

/* Writes a file of the block's folder, which is made again if it was deleted meanwhile. */
static oxl_result block_write(struct block *b, const char *name, const struct text *t)
{
    const oxl_result rc = oxl_make_folder(b->ctx, b->task->folder);
    return rc == OXL_OK ? os_write_text(b->ctx, PATH(b->task->folder, "%s", name), t) : rc;
}

static oxl_result block_write_model(struct block *b, const char *name, const oxl_model *model)
{
    const oxl_result rc = oxl_make_folder(b->ctx, b->task->folder);
    return rc == OXL_OK
               ? model_file_write_ply(b->ctx, PATH(b->task->folder, "%s", name), model, model->sh_degree)
               : rc;
}

/* Writes gains, lamp and medium; removes the file if there are none. */
static oxl_result block_write_imaging(struct block *b, const oxl_scene *scene, const oxl_imaging *imaging)
{
    const char *path = PATH(b->task->folder, "imaging.txt");
    const oxl_result rc = oxl_make_folder(b->ctx, b->task->folder);
    if (rc != OXL_OK) return rc;
    if (imaging_is_needed(imaging)) return oxl_imaging_write(b->ctx, path, scene, imaging);
    os_remove(path);
    return OXL_OK;
}

/* ---------------- block.json */

static const char BLOCK_CHECKSUM[] = "  \"checksum\": \"";

/* Returns 1 if the last member, "checksum", is the checksum of all text before it. */
static int block_has_checksum(const char *json)
{
    const char *at = NULL;
    char line[48];
    for (const char *next = json; (next = strstr(next, BLOCK_CHECKSUM)) != NULL; next++) at = next;
    if (!at) return 0;
    snprintf(line, sizeof line, "%s%016llx\"\n}", BLOCK_CHECKSUM,
             (unsigned long long)checksum_add(CHECKSUM_SEED, json, (size_t)(at - json)));
    return !strncmp(at, line, strlen(line));
}

static uint64_t block_read_sum(const char *json, const char *name)
{
    char text[24];
    unsigned long long sum = 0;
    oxl_json_text(oxl_json_member(json, name), text, sizeof text);
    return sscanf(text, "%llx", &sum) == 1 ? sum : 0;
}

static const struct {
    const char *file, *member;
} BLOCK_SUMMED[BLOCK_SUMS] = {{"model.ply", "model_checksum"},
                              {"imaging.txt", "imaging_checksum"},
                              {"model_standard.ply", "standard_checksum"}};

/* Computes the checksums of the files in the folder; 0: the file does not exist. */
static oxl_result block_sums(oxl_context *ctx, const char *folder, uint64_t sum[BLOCK_SUMS])
{
    oxl_result rc = OXL_OK;
    for (int i = 0; i < BLOCK_SUMS && rc == OXL_OK; i++) {
        const char *path = PATH(folder, "%s", BLOCK_SUMMED[i].file);
        sum[i] = 0;
        if (os_is_file(path)) rc = checksum_of_file(ctx, path, &sum[i]);
    }
    return rc;
}

/* Compares the files with the record. */
OXL_INTERNAL oxl_result block_check(oxl_context *ctx, const char *folder, const struct block_record *r,
                                    int *whole)
{
    uint64_t sum[BLOCK_SUMS];
    const oxl_result rc = block_sums(ctx, folder, sum);
    *whole = rc == OXL_OK;
    for (int i = 0; *whole && i < BLOCK_SUMS; i++) *whole = sum[i] == r->sum[i];
    return rc;
}

/* Returns a member's value; 0 if it is absent or not finite. */
static double block_number(const char *object, const char *name)
{
    const double value = oxl_json_number(object, name);
    return fabs(value) <= DBL_MAX ? value : 0;
}

/* Returns 1 if the members "job" and "found" are those of the key, their text in block.json. */
static int block_has_key(const char *json, const char *key)
{
    static const char begin[] = "\"job\": ";
    const char *job = oxl_json_member(json, "job");
    return job && !strncmp(key, begin, sizeof begin - 1) &&
           !strncmp(job, key + sizeof begin - 1, strlen(key) - (sizeof begin - 1));
}

OXL_INTERNAL oxl_result block_read(oxl_context *ctx, const char *folder, const char *key,
                                   struct block_record *out)
{
    struct os_file_map map = {0};
    const char *path = PATH(folder, "block.json");
    oxl_result rc = OXL_OK;
    *out = (struct block_record){0};
    if (os_is_file(path) && os_is_file(PATH(folder, "model.ply"))) rc = os_read_file(ctx, path, &map);
    if (rc == OXL_OK && map.data && !block_has_checksum(map.data)) out->damaged = 1;
    else if (rc == OXL_OK && map.data && block_has_key(map.data, key)) {
        out->exists = 1;
        for (int i = 0; i < BLOCK_SUMS; i++) out->sum[i] = block_read_sum(map.data, BLOCK_SUMMED[i].member);
        out->finished = oxl_json_is_true(map.data, "finished");
        out->iterations = (int)OXL_CLAMP(block_number(map.data, "iterations_done"), 0, INT_MAX);
        out->gaussians = (size_t)OXL_CLAMP(block_number(map.data, "gaussians"), 0, JOB_GAUSSIANS_MAX);
        out->seconds = block_number(map.data, "seconds");
        out->peak = block_number(map.data, "peak_rss_bytes");
        out->predicted_peak = block_number(map.data, "predicted_memory_bytes");
        nonfinite_read_json(map.data, &out->nonfinite);
    }
    os_release_file(ctx, &map);
    return rc;
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

static oxl_result block_write_record(struct block *b, const struct block_record *r)
{
    struct text t = {.ctx = b->ctx};
    uint64_t sum[BLOCK_SUMS];
    oxl_result rc = block_sums(b->ctx, b->task->folder, sum);
    if (rc != OXL_OK) return rc;
    text_add(&t, "{\n  \"finished\": %s,\n", r->finished ? "true" : "false");
    text_add_member(&t, "iterations_done", r->iterations);
    text_add_member(&t, "gaussians", (double)r->gaussians);
    text_add_member(&t, "seconds", r->seconds);
    text_add_member(&t, "peak_rss_bytes", r->peak);
    text_add_member(&t, "predicted_memory_bytes", r->predicted_peak);
    nonfinite_add_json(&t, &r->nonfinite);
    text_add(&t, "  \"decisions\": {%s},\n", b->decisions ? b->decisions : "");
    for (int i = 0; i < BLOCK_SUMS; i++)
        text_add(&t, "  \"%s\": \"%016llx\",\n", BLOCK_SUMMED[i].member, (unsigned long long)sum[i]);
    text_add(&t, "  %s,\n  \"notes\": [%s],\n", b->task->key, b->notes.size ? b->notes.data : "");
    text_add(&t, "%s%016llx\"\n}\n", BLOCK_CHECKSUM,
             (unsigned long long)checksum_add(CHECKSUM_SEED, t.data ? t.data : "", t.size));
    t.failed |= b->notes.failed;
    rc = block_write(b, "block.json", &t);
    text_free(&t);
    return rc;
}

OXL_INTERNAL oxl_result block_write_finished(oxl_context *ctx, const oxl_scene *scene,
                                             struct oxl_imaging *imaging, const char *folder, const char *key,
                                             const struct block_record *record)
{
    const struct block_task task = {.folder = folder, .key = key};
    struct block b = {.ctx = ctx, .task = &task};
    const oxl_result rc = block_write_imaging(&b, scene, imaging);
    return rc == OXL_OK ? block_write_record(&b, record) : rc;
}

/* ---------------- while it runs */

static double block_round(double value, double parts)
{
    return floor(value * parts + 0.5) / parts;
}

static void block_log_row(struct block *b, const oxl_progress *p)
{
    text_add(&b->log, "%d,%s,%s,%zu,%s,%s,%s,%zu\n", p->iteration, NUMBER(block_round(p->loss, 1e6)),
             NUMBER(block_round(p->psnr, 1e3)), p->gaussians, NUMBER(block_round(p->seconds, 1e3)),
             NUMBER(block_round(p->f_mid, 1e4)), NUMBER(block_round(p->f_far, 1e4)), os_peak_rss());
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
        block_write(b, "log.csv", &b->log); /* Ignores a full disk, which the end of the run reports. */
        b->log_written = p.seconds;
    }
    b->last = p;
    b->last.model = NULL;
    return context_report(b->task->callback, &p);
}

/* ---------------- the block */

static struct block_record block_record_of(const struct block *b, const oxl_trained *t)
{
    return (struct block_record){.finished = t->finished,
                                 .iterations = t->iterations,
                                 .gaussians = t->model.count,
                                 .seconds = block_round(t->seconds, 1e3),
                                 .peak = (double)os_peak_rss(),
                                 .predicted_peak = b->task->predicted_peak,
                                 .nonfinite = t->nonfinite};
}

/* Writes the block's files; the record comes last. */
static oxl_result block_write_result(struct block *b, const oxl_scene *scene, const oxl_trained *t)
{
    const struct block_record record = block_record_of(b, t);
    oxl_result rc = block_write(b, "log.csv", &b->log);
    os_remove(PATH(b->task->folder, "model_standard.ply")); /* of an earlier model.ply */
    if (rc == OXL_OK) rc = block_write_model(b, "model.ply", &t->model);
    if (rc == OXL_OK && t->viewer.count) rc = block_write_model(b, "model_standard.ply", &t->viewer);
    if (rc == OXL_OK) rc = block_write_imaging(b, scene, t->imaging);
    b->decisions = t->decisions;
    return rc == OXL_OK ? block_write_record(b, &record) : rc;
}

/* Trains the block, or resumes its training; writes its files even if the callback stopped it. */
static oxl_result block_run(struct block *b, const oxl_scene *scene, oxl_trained *t)
{
    const struct block_task *task = b->task;
    const char *viewer = PATH(task->folder, "viewer");
    struct train_task run = task->run;
    struct train_extra extra = task->extra;
    oxl_result rc, written;
    run.store = checkpoint_in(task->folder, task->key), run.log = &b->log, run.notes = &b->notes;
    extra.viewer_store = checkpoint_in(viewer, task->key);
    text_add(&b->log, "iteration,loss,psnr,gaussians,seconds,f_mid,f_far,peak_rss_bytes\n");
    rc = trained_make(b->ctx, scene, &task->train, &(oxl_callback){block_progress, b}, &run, &extra, t);
    if (rc != OXL_OK && rc != OXL_ERR_INTERRUPTED) return rc;
    if (t->model.count == 0) return rc;
    t->finished |= run.until > 0 && t->iterations >= run.until;
    written = block_write_result(b, scene, t);
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
    if (rc == OXL_OK) rc = os_remove_temporaries(ctx, task->folder, BLOCK_FILES);
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

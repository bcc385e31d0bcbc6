/* block.c - trains one block in its folder OUT/blocks/KKK: checkpoint.oxl while it runs, then model.ply,
 * log.csv, block.json.
 *
 * A model with second lobes, a medium, or gains alone may be followed by model_standard.ply, for viewers that
 * support none of them: the lobes are dropped, medium or gains are baked into the colours, the rest is
 * refined for a twentieth of the run, or longer with a medium or gains. Else its gains and lamp are those of
 * model.ply.
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
/* Sets the fraction of the run's steps for which the standard model is refined; it takes twice as many steps
 * with a medium or gains (docs/IMAGING.md). */
#define BLOCK_REFINE 0.05
/* Limits the steps up to which a medium or gains take three times as many, not twice. */
#define BLOCK_REFINE_MORE 300
/* Multiplies the learning rate of SH where the standard model learns the colours that a medium gave. */
#define BLOCK_REFINE_SH 10
/* Multiplies the learning rate of SH where the standard model learns what gains gave. */
#define BLOCK_REFINE_GAINS_SH 3
/* Multiplies the rate of base colours where the standard model learns what gains gave. */
#define BLOCK_REFINE_GAINS_SH0 2

struct block {
    oxl_context *ctx;
    const struct block_task *task;
    oxl_progress last;
    int before;           /* iterations of the run that precede those of the standard model, */
    double seconds, left; /* its seconds by then, and those left as it said */
    struct text log, notes;
    struct text decisions; /* members of a JSON object */
    double log_written;    /* seconds of the run at the last writing of log.csv */
    oxl_nonfinite nonfinite;
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
static oxl_result block_write_imaging(struct block *b, oxl_scene *scene)
{
    const char *path = PATH(b->task->folder, "imaging.txt");
    const oxl_result rc = oxl_make_folder(b->ctx, b->task->folder);
    if (rc != OXL_OK) return rc;
    if (imaging_is_needed(&scene->imaging)) return imaging_write(b->ctx, path, scene, &scene->imaging);
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

/* Compares the files with the record. The standard model counts only in a finished record: before,
 * its checksum was not noted. */
OXL_INTERNAL oxl_result block_check(oxl_context *ctx, const char *folder, const struct block_record *r,
                                    int *whole)
{
    uint64_t sum[BLOCK_SUMS];
    const oxl_result rc = block_sums(ctx, folder, sum);
    *whole = rc == OXL_OK;
    for (int i = 0; *whole && i < BLOCK_SUMS; i++)
        *whole = sum[i] == r->sum[i] || (i == BLOCK_SUMS - 1 && !r->finished);
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
        out->idle = oxl_json_is_true(map.data, "idle");
        for (int i = 0; i < BLOCK_SUMS; i++) out->sum[i] = block_read_sum(map.data, BLOCK_SUMMED[i].member);
        out->trained = oxl_json_is_true(map.data, "trained");
        out->finished = oxl_json_is_true(map.data, "finished");
        out->iterations = (int)OXL_CLAMP(block_number(map.data, "iterations_done"), 0, INT_MAX);
        out->gaussians = (size_t)OXL_CLAMP(block_number(map.data, "gaussians"), 0, JOB_GAUSSIANS_MAX);
        out->seconds = block_number(map.data, "seconds");
        out->peak = block_number(map.data, "peak_rss_bytes");
        out->predicted_peak = block_number(map.data, "predicted_memory_bytes");
        out->predicted_seconds = block_number(map.data, "predicted_seconds");
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
    text_add(&t, "{\n  \"trained\": %s,\n  \"finished\": %s,\n", r->trained ? "true" : "false",
             r->finished ? "true" : "false");
    if (r->idle) text_add(&t, "  \"idle\": true,\n");
    text_add_member(&t, "iterations_done", r->iterations);
    text_add_member(&t, "gaussians", (double)r->gaussians);
    text_add_member(&t, "seconds", r->seconds);
    text_add_member(&t, "peak_rss_bytes", r->peak);
    text_add_member(&t, "predicted_memory_bytes", r->predicted_peak);
    text_add_member(&t, "predicted_seconds", r->predicted_seconds);
    nonfinite_add_json(&t, &r->nonfinite);
    text_add(&t, "  \"decisions\": {%s},\n", b->decisions.data ? b->decisions.data : "");
    for (int i = 0; i < BLOCK_SUMS; i++)
        text_add(&t, "  \"%s\": \"%016llx\",\n", BLOCK_SUMMED[i].member, (unsigned long long)sum[i]);
    text_add(&t, "  %s,\n  \"notes\": [%s],\n", b->task->key, b->notes.size ? b->notes.data : "");
    text_add(&t, "%s%016llx\"\n}\n", BLOCK_CHECKSUM,
             (unsigned long long)checksum_add(CHECKSUM_SEED, t.data ? t.data : "", t.size));
    t.failed |= b->notes.failed || b->decisions.failed;
    rc = block_write(b, "block.json", &t);
    text_free(&t);
    return rc;
}

OXL_INTERNAL oxl_result block_write_finished(oxl_context *ctx, oxl_scene *scene, const char *folder,
                                             const char *key, const struct block_record *record)
{
    const struct block_task task = {.folder = folder, .key = key};
    struct block b = {.ctx = ctx, .task = &task};
    const oxl_result rc = block_write_imaging(&b, scene);
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
    /* Keeps trials, which are taken back, out of log and record. */
    if (p.trial) return context_report(b->task->callback, &p);
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

static struct block_record block_record_of(const struct block *b, const oxl_model *model)
{
    return (struct block_record){.iterations = b->last.iteration,
                                 .gaussians = model->count,
                                 .seconds = block_round(b->last.seconds, 1e3),
                                 .peak = (double)os_peak_rss(),
                                 .predicted_peak = b->task->predicted_peak,
                                 .predicted_seconds = block_round(b->task->predicted_seconds, 1e3),
                                 .nonfinite = b->nonfinite};
}

/* Trains the block, or resumes its training; writes its files even if the callback stopped it. */
static oxl_result block_train_model(struct block *b, oxl_scene *scene, struct block_record *record,
                                    oxl_model *model)
{
    const struct block_task *task = b->task;
    struct train_task train = {.store = checkpoint_in(task->folder, task->key),
                               .log = &b->log,
                               .notes = &b->notes,
                               .decisions = &b->decisions,
                               .start = task->start,
                               .context = task->context,
                               .window = task->window,
                               .first = task->first,
                               .until = task->until,
                               .viewed = task->viewed,
                               .after = task->after,
                               .refined = block_hiding_steps(task->standard),
                               .from = task->from,
                               .grown = task->grown};
    oxl_result rc, written;
    text_add(&b->log, "iteration,loss,psnr,gaussians,seconds,f_mid,f_far,peak_rss_bytes\n");
    rc = train_run(b->ctx, scene, &task->train, &(oxl_callback){block_progress, b}, &train, model);
    b->nonfinite = train.nonfinite;
    if (rc != OXL_OK && (rc != OXL_ERR_INTERRUPTED || model->count == 0)) return rc;
    *record = block_record_of(b, model);
    record->trained = train.finished;
    /* Removes the standard model of an earlier model.ply. */
    os_remove(PATH(task->folder, "model_standard.ply"));
    written = block_write(b, "log.csv", &b->log);
    if (written == OXL_OK) written = block_write_model(b, "model.ply", model);
    if (written == OXL_OK) written = block_write_imaging(b, scene);
    if (written == OXL_OK) written = block_write_record(b, record);
    /* Removes the checkpoint, since the model is complete. */
    if (written == OXL_OK && train.finished) checkpoint_remove(task->folder);
    return written == OXL_OK ? rc : written;
}

/* ---------------- the standard model */

static int block_refine_progress(void *user, const oxl_progress *progress)
{
    struct block *b = user;
    oxl_progress p = *progress;
    b->last = p;
    b->last.model = NULL;
    p.iteration += b->before;
    p.iterations += b->before;
    p.seconds += b->seconds;
    /* The first step's time is not known yet: repeats what the run said last. */
    if (!(p.seconds_left > 0) && p.iteration < p.iterations) p.seconds_left = b->left;
    return context_report(b->task->callback, &p);
}

OXL_INTERNAL int block_standard_steps(const oxl_train_options *run)
{
    return OXL_MAX(1, (int)(BLOCK_REFINE * run->iterations));
}

OXL_INTERNAL int block_hiding_steps(int standard)
{
    return OXL_MAX(2 * standard, OXL_MIN(BLOCK_REFINE_MORE, 3 * standard));
}

/* Returns the options of `steps` further steps. Keeps the learning rates that the whole run has in its second
 * half before its cool-down, not those of a run of `steps`; but opacities and colours lose the factor of runs
 * below SCHEDULE_BRISK_ITERATIONS. Momentum as in Kerbl 2023. */
OXL_INTERNAL oxl_train_options block_refinement(const oxl_train_options *run, int sh_degree, int steps)
{
    const double short_run_factor = schedule_short_run_factor(run);
    oxl_train_options o = *run;
    o.iterations = steps;
    o.sh_degree = sh_degree;
    options_drop(&o, OXL_OPTION_NOT_REFINED);
    o.lr_position_final = (float)(short_run_factor * run->lr_position_final);
    o.lr_position = o.lr_position_final;
    o.lr_scale = schedule_scale_rate(run);
    o.lr_rotation = (float)(short_run_factor * run->lr_rotation);
    o.lr_sh = (float)(sqrt(short_run_factor) * run->lr_sh);
    if (o.medium == OXL_ON) o.medium = OXL_AUTO; /* Keeps the medium that the model has. */
    return o;
}

OXL_INTERNAL int block_hides(const oxl_scene *scene)
{
    return imaging_alters_colours(&scene->imaging) || imaging_is_gains_alone(&scene->imaging);
}

OXL_INTERNAL oxl_train_options block_standard_options(const oxl_train_options *run, int sh_degree,
                                                      int standard, oxl_scene *scene)
{
    const int drops_gains = imaging_is_gains_alone(&scene->imaging), hides = block_hides(scene);
    oxl_train_options o = block_refinement(run, sh_degree, hides ? block_hiding_steps(standard) : standard);
    scene->imaging.medium = (struct medium){0};
    o.medium = OXL_OFF;
    if (drops_gains) {
        o.exposure = OXL_OFF, scene->imaging.on = 0;
        o.lr_sh0 *= BLOCK_REFINE_GAINS_SH0, o.lr_sh *= BLOCK_REFINE_GAINS_SH;
    } else if (hides) o.lr_sh *= BLOCK_REFINE_SH;
    return o;
}

/* Trains the standard model: without second lobes and medium, and without gains if there is nothing else.
 * *done: model_standard.ply is written. */
static oxl_result block_refine(struct block *b, oxl_scene *scene, oxl_model *model, int *done)
{
    struct text key = {.ctx = b->ctx}, log = {.ctx = b->ctx}, notes = {.ctx = b->ctx};
    struct train_task train = {.log = &log,
                               .notes = &notes,
                               .start = model,
                               .context = b->task->context,
                               .window = b->task->window,
                               .viewed = b->task->viewed,
                               .after = b->task->after,
                               .frozen = 1};
    const int drops_gains = imaging_is_gains_alone(&scene->imaging);
    oxl_train_options o;
    oxl_model plain = {0};
    oxl_result rc;
    *done = 0;
    b->before = b->task->train.iterations;
    medium_make_standard(scene, drops_gains, model);
    o = block_standard_options(&b->task->train, model->sh_degree, b->task->standard, scene);
    text_add(&key, "standard %s", b->task->key);
    train.store = checkpoint_in(b->task->folder, key.data);
    rc = key.failed ? OXL_ERR_MEMORY : OXL_OK;
    if (rc == OXL_OK)
        oxl_log(b->ctx, OXL_LOG_INFO,
                "the model without second lobes%s, for viewers, is refined for %d iterations",
                drops_gains ? " and gains" : " and medium", o.iterations);
    if (rc == OXL_OK)
        rc = train_run(b->ctx, scene, &o, &(oxl_callback){block_refine_progress, b}, &train, &plain);
    b->nonfinite = train.nonfinite;
    *done = rc == OXL_OK && b->last.iteration == o.iterations;
    if (*done) rc = block_write_model(b, "model_standard.ply", &plain);
    oxl_model_free(b->ctx, &plain);
    text_free(&key);
    text_free(&log);
    text_free(&notes);
    return rc;
}

/* ---------------- both */

/* Reads the trained model of an earlier process, which did not finish the standard model. */
static oxl_result block_reopen(struct block *b, oxl_scene *scene, oxl_model *model)
{
    const char *path = PATH(b->task->folder, "model.ply");
    oxl_result rc = oxl_model_read(b->ctx, path, model);
    if (rc == OXL_OK) rc = oxl_scene_read_imaging(b->ctx, scene, path);
    if (rc == OXL_OK) rc = block_read_member(b->ctx, b->task->folder, "decisions", &b->decisions);
    return rc == OXL_OK ? block_read_member(b->ctx, b->task->folder, "notes", &b->notes) : rc;
}

static oxl_result block_finish(struct block *b, oxl_scene *scene, struct block_record *record,
                               oxl_model *model)
{
    int done = 1;
    oxl_result rc = OXL_OK;
    if ((model->lobes > 0 || block_hides(scene)) && b->task->standard > 0) {
        b->seconds = record->seconds, b->left = b->last.seconds_left;
        b->last = (oxl_progress){0};
        b->nonfinite = (oxl_nonfinite){0};
        rc = block_refine(b, scene, model, &done);
        record->seconds += block_round(b->last.seconds, 1e3);
        /* Counts an image that both runs left out only once. */
        b->nonfinite.images -= OXL_MIN(b->nonfinite.images, record->nonfinite.images);
        nonfinite_add(&record->nonfinite, &b->nonfinite);
    }
    if (rc != OXL_OK || !done) return rc;
    record->finished = 1;
    rc = block_write_record(b, record);
    if (rc == OXL_OK) checkpoint_remove(b->task->folder);
    return rc;
}

OXL_INTERNAL oxl_result block_train(oxl_context *ctx, oxl_scene *scene, const struct block_task *task)
{
    struct block b = {
        .ctx = ctx, .task = task, .log = {.ctx = ctx}, .notes = {.ctx = ctx}, .decisions = {.ctx = ctx}};
    struct text *outer = ctx->notes;
    oxl_model model = {0};
    struct block_record record = {0};
    oxl_result rc = oxl_make_folder(ctx, task->folder);
    if (rc == OXL_OK) rc = os_remove_temporaries(ctx, task->folder, BLOCK_FILES);
    if (rc == OXL_OK) rc = block_read(ctx, task->folder, task->key, &record);
    if (rc != OXL_OK) return rc;
    ctx->notes = &b.notes;
    rc = record.trained ? block_reopen(&b, scene, &model) : block_train_model(&b, scene, &record, &model);
    if (rc == OXL_OK && record.trained) rc = block_finish(&b, scene, &record, &model);
    ctx->notes = outer;
    oxl_model_free(ctx, &model);
    text_free(&b.log);
    text_free(&b.notes);
    text_free(&b.decisions);
    return rc;
}

/* study.c - one survey, trained many times: each training in a folder of its own, so that a study that was stopped goes on where it was.
 *
 * Memory is counted by the allocator that the trainings get, one by one; the process's own peak never falls, and so would say nothing
 * about one that comes after a larger one. What was counted stands in the folder's study.json for the processes that go on.
 */
#include "study.h"
#include "synth.h" /* synth_file: files appear whole */

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* ---------------------------------------------------------------- memory, counted */

struct study_head { /* stands before each block, and keeps it aligned to 16 bytes */
    size_t size, unused[16 / sizeof(size_t) - 1];
};

static void *study_reallocate(void *user, void *old, size_t size)
{
    struct study      *s    = user;
    struct study_head *head = old ? (struct study_head *)old - 1 : NULL;
    const size_t       had  = head ? head->size : 0;
    if (size == 0) free(head);
    else head = size > (size_t)-1 - sizeof *head ? NULL : realloc(head, size + sizeof *head);
    if (size > 0 && !head) return NULL;
    s->held = s->held - had + size;
    if (s->held > s->peak) s->peak = s->held;
    if (size == 0) return NULL;
    head->size = size;
    return head + 1;
}

static void study_pass_on(void *user, oxl_log_level level, const char *text)
{
    const struct study *s = user;
    if (s->options->log) s->options->log(s->options->user, level, text);
}

void study_log(struct study *s, const char *text)
{
    study_pass_on(s, OXL_LOG_INFO, text);
}

oxl_result study_fail(struct study *s, oxl_result rc, const char *what, const char *detail)
{
    snprintf(s->error, s->error_size, "%s%s", what, detail);
    return rc;
}

oxl_result study_open(struct study *s, const char *out)
{
    oxl_context_options own = *s->options;
    oxl_result          rc;
    own.reallocate = study_reallocate;
    own.log        = study_pass_on;
    own.user       = s;
    if (strlen(out) > 900) return study_fail(s, OXL_ERR_USAGE, "the name of the folder is too long: ", out);
    rc = oxl_context_create(&own, &s->ctx);
    if (rc == OXL_OK) rc = oxl_make_folder(s->ctx, out);
    return rc == OXL_OK ? rc : study_fail(s, rc, "", oxl_error_text(s->ctx));
}

/* ---------------------------------------------------------------- files */

char *study_read(const char *folder, const char *name)
{
    char  path[1024], *text = calloc(1, 65536); /* figures come first, then views in any number */
    FILE *file;
    snprintf(path, sizeof path, "%s/%s", folder, name);
    file = fopen(path, "rb");
    if (file && text) text[fread(text, 1, 65535, file)] = 0;
    if (file) fclose(file);
    else free(text), text = NULL;
    return text;
}

oxl_result study_write(struct study *s, const char *folder, const char *name, const struct study_text *t)
{
    struct synth_file file;
    char              path[1024];
    if (t->failed) return study_fail(s, OXL_ERR_MEMORY, "no memory for ", name);
    snprintf(path, sizeof path, "%s/%s", folder, name);
    synth_file_open(&file, path);
    synth_file_bytes(&file, t->data, t->used);
    return synth_file_close(&file) ? OXL_OK : study_fail(s, OXL_ERR_IO, "cannot write ", path);
}

/* ---------------------------------------------------------------- one training */

static double study_cpu(void)
{
    return (double)clock() / CLOCKS_PER_SEC;
}

static int study_progress(void *user, const oxl_progress *p)
{
    struct study       *s = user;
    const oxl_callback *c = s->callback;
    if (!s->begun) {
        s->begun  = p->iteration <= 1 && p->block == 0 ? 1 : 2;
        s->cpu_at = study_cpu();
    }
    s->cpu = study_cpu() - s->cpu_at;
    return c->progress ? c->progress(c->user, p) : 0;
}

/* Memory: the peak over all the parts in which it was trained; CPU time: their sum. */
static oxl_result study_note(struct study *s, const char *folder, struct study_result *r)
{
    char             *before = study_read(folder, "study.json");
    struct study_text t      = {0};
    oxl_result        rc     = OXL_OK;
    r->memory                = json_number(before, "library_peak_bytes");
    r->cpu                   = json_number(before, "cpu_seconds");
    free(before);
    if (s->begun == 0) return OXL_OK;
    if (s->begun == 1 || !(r->memory > (double)s->peak)) r->memory = (double)s->peak;
    r->cpu = s->begun == 1 ? s->cpu : r->cpu + s->cpu;
    study_add(&t, "{\n  \"library_peak_bytes\": %s", STUDY_FIXED(r->memory, 0));
    if (!isnan(r->cpu)) study_add(&t, ",\n  \"cpu_seconds\": %s", STUDY_FIXED(r->cpu, 2));
    study_add(&t, "\n}\n");
    rc = study_write(s, folder, "study.json", &t);
    free(t.data);
    return rc;
}

static oxl_result study_read_metrics(struct study *s, const char *folder, struct study_result *r)
{
    char        *text  = study_read(folder, "metrics.json");
    const double all[] = {r->psnr = json_number(text, "psnr"),       r->ssim = json_number(text, "ssim"),
                          r->ms_ssim = json_number(text, "ms_ssim"), r->gaussians = json_number(text, "gaussians"),
                          r->bytes = json_number(text, "bytes"),     r->seconds = json_number(text, "seconds"),
                          r->blocks = json_number(text, "blocks")};
    r->far             = json_number(json_member(text, "by_depth"), "far_psnr");
    r->held_out        = text && strstr(text, "\"split\": \"test\"") != NULL;
    free(text);
    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        if (isnan(all[i])) return study_fail(s, OXL_ERR_INPUT, "no whole metrics.json of a training in ", folder);
    return OXL_OK;
}

oxl_result study_train(struct study *s, const char *scene, const char *folder, const oxl_job_options *job,
                       struct study_result *out)
{
    const oxl_callback callback = {study_progress, s};
    oxl_result         rc, noted;
    *out     = (struct study_result){.psnr = NAN};
    s->peak  = s->held;
    s->begun = 0;
    rc       = oxl_job_run(s->ctx, scene, folder, job, &callback);
    if (rc != OXL_OK && rc != OXL_ERR_INTERRUPTED) return study_fail(s, rc, "", oxl_error_text(s->ctx));
    noted = study_note(s, folder, out);
    if (rc != OXL_OK || noted != OXL_OK) return rc != OXL_OK ? rc : noted;
    return study_read_metrics(s, folder, out);
}

/* manifest.c - writes, reads and compares the inputs of a run's result in run.json.
 *
 * Invariant: runs with equal members "job" and "found" end in the same bytes. Options that only affect speed
 * or memory (threads, --max-time, --image-cache) are in neither; paths are in "inputs", since "found" has
 * checksums of what they lead to. So a survey may move.
 */
#include "job.h"
#include "../render/render.h"

#include "../formats/json.h"
#include "../large/os_job.h"

enum { MANIFEST_DIFFERENCES = 10 /* most lines about differences */ };

/* ---------------- options to text */

static int manifest_is_json(const char *text)
{
    const char *end = text;
    double value;
    if (strcmp(text, "true") == 0 || strcmp(text, "false") == 0) return 1;
    return ((unsigned char)(text[0] - '0') < 10 || text[0] == '-') &&
           parse_double(&end, text + strlen(text), &value) && !*end;
}

/* Adds a member: numbers, true and false unquoted, other values as strings. */
static void manifest_add(struct text *t, const char *name, const char *value, int is_text)
{
    text_add(t, ", \"%s\": ", name);
    if (!value) text_add(t, "null");
    else if (!is_text && manifest_is_json(value)) text_add(t, "%s", value);
    else text_add_json_string(t, value);
}

OXL_INTERNAL void manifest_describe(struct text *job, struct text *inputs, const char *scene,
                                    const oxl_job_options *o)
{
    text_add(inputs, "\"inputs\": {\"scene\": ");
    text_add_json_string(inputs, scene);
    text_add(job, "\"job\": {\"version\": \"%s\", \"seed\": %llu", OXL_VERSION,
             (unsigned long long)(o->seed ? o->seed : job->ctx->options.seed));
    for (int i = 0; i < oxl_option_count(); i++) {
        const oxl_option *option = oxl_option_at(i);
        const int is_path = option->kind == OXL_OPTION_TEXT;
        char name[40], value[128];
        const char *path = NULL;
        if (!(option->use & OXL_OPTION_OF_RESULT)) continue;
        memcpy(&path, (const char *)o + option->at, is_path ? sizeof path : 0);
        manifest_add(is_path ? inputs : job, oxl_option_member(option, name),
                     is_path ? path : oxl_option_get(option, o, value, sizeof value), is_path);
    }
    if (backend_device(job->ctx)) /* Adds the device, since results depend on it. */
        manifest_add(job, "device", backend_device(job->ctx), 0);
    text_add(job, "}");
    text_add(inputs, "}");
}

/* ---------------- text to options */

OXL_INTERNAL oxl_result manifest_read(oxl_context *ctx, const char *folder, struct oxl_manifest *out)
{
    struct os_file_map map = {0};
    const char *path = PATH(folder, "run.json");
    oxl_result rc = os_is_file(path) ? os_read_file(ctx, path, &map) : OXL_OK;
    *out = (struct oxl_manifest){0};
    if (rc == OXL_OK && oxl_json_member(map.data, "job")) {
        out->finished = oxl_json_is_true(map.data, "finished");
        out->text = oxl_strdup(ctx, map.data);
        out->values = oxl_calloc(ctx, map.size + 8, 1);
        if (!out->text || !out->values) rc = OXL_ERR_MEMORY;
    }
    os_release_file(ctx, &map);
    if (rc != OXL_OK) manifest_free(ctx, out);
    return rc;
}

OXL_INTERNAL void manifest_free(oxl_context *ctx, struct oxl_manifest *run)
{
    OXL_FREE(ctx, run->text, run->values);
    *run = (struct oxl_manifest){0};
}

/* Returns a member's value as text, a string unescaped; NULL: null or missing. No member is taken twice, so
 * all values fit. */
static char *manifest_take(struct oxl_manifest *run, const char *object, const char *name)
{
    const char *value = oxl_json_member(object, name);
    char *out = run->values + run->used;
    if (!value || strncmp(value, "null", 4) == 0) return NULL;
    if (*value == '"') oxl_json_text(value, out, oxl_json_room(value));
    else memcpy(out, value, (size_t)(oxl_json_end(value) - value));
    run->used += strlen(out) + 1;
    return out;
}

OXL_INTERNAL const char *manifest_options(struct oxl_manifest *run, oxl_job_options *o)
{
    const char *job = oxl_json_member(run->text, "job"), *inputs = oxl_json_member(run->text, "inputs"),
               *seed = oxl_json_member(job, "seed"), *const none = NULL;
    for (int i = 0; i < oxl_option_count(); i++) {
        const oxl_option *option = oxl_option_at(i);
        const int is_path = option->kind == OXL_OPTION_TEXT;
        char name[40];
        const char *value;
        if (is_path) memcpy((char *)o + option->at, &none, sizeof none);
        if (!(option->use & OXL_OPTION_OF_RESULT)) continue;
        value = manifest_take(run, is_path ? inputs : job, oxl_option_member(option, name));
        /* Ignores invalid values; the run then counts as one with other options. */
        if (value) oxl_option_set(option, o, value, NULL, 0);
    }
    o->preset = manifest_take(run, run->text, "preset");
    o->seed = seed ? strtoull(seed, NULL, 10) : 0;
    return manifest_take(run, inputs, "scene");
}

oxl_result oxl_job_resume(oxl_context *ctx, const char *scene, const char *out, oxl_job_options *options,
                          oxl_manifest **run)
{
    oxl_job_options o = *options;
    const char *was;
    oxl_result rc;
    *run = oxl_calloc(ctx, 1, sizeof **run);
    if (!*run) return OXL_ERR_MEMORY;
    rc = manifest_read(ctx, out, *run);
    was = rc == OXL_OK && (*run)->text ? manifest_options(*run, &o) : NULL;
    if (was && (!strcmp(was, scene) || os_is_same(was, scene))) *options = o;
    if (rc != OXL_OK) oxl_manifest_free(ctx, run);
    return rc;
}

void oxl_manifest_free(oxl_context *ctx, oxl_manifest **run)
{
    if (*run) manifest_free(ctx, *run);
    oxl_free(ctx, *run);
    *run = NULL;
}

/* ---------------- two runs */

OXL_INTERNAL int manifest_differences(const struct oxl_manifest *run, const char *member, struct text *t)
{
    const char *current = oxl_json_value(member), *old;
    char name[40];
    int count = 0;
    snprintf(name, sizeof name, "%.*s", (int)strcspn(member + 1, "\""), member + 1);
    old = oxl_json_member(run->text, name);
    for (const char *key = oxl_json_first(current); key; key = oxl_json_next(oxl_json_value(key))) {
        const char *now = oxl_json_value(key), *was;
        const int size = (int)(oxl_json_end(now) - now);
        snprintf(name, sizeof name, "%.*s", (int)strcspn(key + 1, "\""), key + 1);
        was = oxl_json_member(old, name);
        if (was && oxl_json_end(was) - was == size && !memcmp(was, now, (size_t)size)) continue;
        if (count++ < MANIFEST_DIFFERENCES)
            text_add(t, "  %s: %.*s there, %.*s here\n", name,
                     was ? OXL_MIN((int)(oxl_json_end(was) - was), 60) : 4, was ? was : "none",
                     OXL_MIN(size, 60), now);
    }
    if (count > MANIFEST_DIFFERENCES) text_add(t, "  and %d more\n", count - MANIFEST_DIFFERENCES);
    return count;
}

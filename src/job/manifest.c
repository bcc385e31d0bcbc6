/* manifest.c - writes, reads and compares the inputs of a run's result in run.json.
 *
 * Invariant: runs with equal members "job" on the same files end in the same bytes, unless one says by
 * "began_on" that it was continued on another device. Options that only affect speed or memory (threads,
 * --max-time, --image-cache) are not in it.
 */
#include "job.h"
#include "../render/render.h"

#include "../formats/json.h"
#include "../large/os_job.h"

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
static void manifest_add_value(struct text *t, const char *name, const char *value)
{
    text_add(t, ", \"%s\": ", name);
    if (!value) text_add(t, "null");
    else if (manifest_is_json(value)) text_add(t, "%s", value);
    else text_add_json_string(t, value);
}

static void manifest_add_option(struct text *t, const oxl_option *option, const oxl_job_options *o)
{
    const char *folder = NULL;
    char name[40], value[128];
    oxl_option_member(option, name);
    if (option->kind == OXL_OPTION_TEXT) {
        memcpy(&folder, (const char *)o + option->at, sizeof folder);
        text_add(t, ", \"%s\": ", name);
        if (folder) text_add_json_string(t, folder);
        else text_add(t, "null");
    } else manifest_add_value(t, name, oxl_option_get(option, o, value, sizeof value));
}

OXL_INTERNAL void manifest_describe(struct text *t, const char *scene, const oxl_job_options *o)
{
    text_add(t, "\"job\": {\"version\": \"%s\", \"seed\": %llu, \"scene\": ", OXL_VERSION,
             (unsigned long long)(o->seed ? o->seed : t->ctx->options.seed));
    text_add_json_string(t, scene);
    for (int i = 0; i < oxl_option_count(); i++)
        if (oxl_option_at(i)->use & OXL_OPTION_OF_RESULT) manifest_add_option(t, oxl_option_at(i), o);
    if (backend_device(t->ctx)) /* Adds the device, since results depend on it. */
        manifest_add_value(t, "device", backend_device(t->ctx));
    text_add(t, "}");
}

/* Returns the place of the device, the last member of a line "job": {...}, or that of the closing bracket.
 * Quotes inside of strings are escaped, so the text is found as a member only. */
static const char *manifest_end(const char *line)
{
    const char *at = strstr(line, ", \"device\": ");
    return at ? at : line + strlen(line) - 1;
}

OXL_INTERNAL void manifest_add_with_device(struct text *t, const char *line, const char *of)
{
    text_add(t, "%.*s%s", (int)(manifest_end(line) - line), line, manifest_end(of));
}

OXL_INTERNAL int manifest_same_device(const char *a, const char *b)
{
    return strcmp(manifest_end(a), manifest_end(b)) == 0;
}

OXL_INTERNAL void manifest_add_device(struct text *t, const char *line)
{
    const char *value = oxl_json_member(oxl_json_value(line), "device");
    if (value) text_add(t, "%.*s", (int)(oxl_json_end(value) - value), value);
    else text_add(t, "\"cpu\"");
}

/* ---------------- text to options */

/* Finds a member of one of the objects of `"job": {...}, "found": {...}`; NULL: there is none. */
static const char *manifest_find(const char *line, const char *name)
{
    const char *found = NULL;
    for (const char *key = line; key && *key == '"' && !found;) {
        const char *object = oxl_json_value(key);
        found = oxl_json_member(object, name);
        key = oxl_json_next(object);
    }
    return found;
}

/* Reads a JSON value as allocated text, a string unescaped; *out NULL: null or missing. */
static oxl_result manifest_read_value(oxl_context *ctx, const char *value, char **out)
{
    const size_t room = value ? OXL_MAX(oxl_json_room(value), (size_t)(oxl_json_end(value) - value) + 1) : 0;
    *out = NULL;
    if (!value || strncmp(value, "null", 4) == 0) return OXL_OK;
    if (!(*out = oxl_calloc(ctx, room, 1))) return OXL_ERR_MEMORY;
    if (*value == '"') oxl_json_text(value, *out, room);
    else memcpy(*out, value, (size_t)(oxl_json_end(value) - value));
    return OXL_OK;
}

static oxl_result manifest_read_values(oxl_context *ctx, const char *job, struct oxl_manifest *run)
{
    oxl_result rc = manifest_read_value(ctx, oxl_json_member(job, "scene"), &run->scene);
    char name[40];
    for (int i = 0; i < oxl_option_count() && i < MANIFEST_VALUES && rc == OXL_OK; i++)
        if (oxl_option_at(i)->use & OXL_OPTION_OF_RESULT)
            rc = manifest_read_value(ctx, oxl_json_member(job, oxl_option_member(oxl_option_at(i), name)),
                                     &run->value[i]);
    return rc;
}

/* Copies `"name": {...}` into allocated text; "": the object is truncated; *out NULL: there is none. */
static oxl_result manifest_copy_member(oxl_context *ctx, const char *root, const char *name, char **out)
{
    struct text t = {.ctx = ctx};
    const char *object = oxl_json_member(root, name), *end = object ? oxl_json_end(object) : NULL;
    *out = NULL;
    if (!object) return OXL_OK;
    text_add(&t, "%s", "");
    if (end[-1] == '}') text_add(&t, "\"%s\": %.*s", name, (int)(end - object), object);
    return text_take(&t, out);
}

OXL_INTERNAL oxl_result manifest_read(oxl_context *ctx, const char *folder, struct oxl_manifest *out)
{
    struct os_file_map map = {0};
    const char *path = PATH(folder, "run.json"), *root, *job;
    oxl_result rc = os_is_file(path) ? os_read_file(ctx, path, &map) : OXL_OK;
    *out = (struct oxl_manifest){0};
    root = map.data;
    job = oxl_json_member(root, "job");
    if (rc == OXL_OK && job) {
        const char *seed = oxl_json_member(job, "seed");
        out->finished = oxl_json_is_true(root, "finished");
        out->is_mixed = oxl_json_member(root, "began_on") != NULL;
        out->seed = seed ? strtoull(seed, NULL, 10) : 0;
        rc = manifest_copy_member(ctx, root, "job", &out->line);
        if (rc == OXL_OK) rc = manifest_copy_member(ctx, root, "found", &out->found);
        if (rc == OXL_OK) rc = manifest_read_value(ctx, oxl_json_member(root, "preset"), &out->preset);
        if (rc == OXL_OK) rc = manifest_read_value(ctx, oxl_json_member(root, "result"), &out->result);
        if (rc == OXL_OK) rc = manifest_read_values(ctx, job, out);
    }
    os_release_file(ctx, &map);
    if (rc != OXL_OK) manifest_free(ctx, out);
    return rc;
}

OXL_INTERNAL void manifest_free(oxl_context *ctx, struct oxl_manifest *run)
{
    OXL_FREE(ctx, run->line, run->found, run->scene, run->preset, run->result);
    for (size_t i = 0; i < OXL_COUNT(run->value); i++) oxl_free(ctx, run->value[i]);
    *run = (struct oxl_manifest){0};
}

/* Applies the run's options. Ignores invalid values; the run then counts as one with
 * other options (job_run.c). */
OXL_INTERNAL void manifest_options(const struct oxl_manifest *run, oxl_job_options *o)
{
    const char *const none = NULL;
    for (int i = 0; i < oxl_option_count() && i < MANIFEST_VALUES; i++) {
        const oxl_option *option = oxl_option_at(i);
        if (run->value[i]) oxl_option_set(option, o, run->value[i], NULL, 0);
        else if (option->kind == OXL_OPTION_TEXT) memcpy((char *)o + option->at, &none, sizeof none);
    }
    o->preset = run->preset;
    o->seed = run->seed;
}

/* ---------------- differences of two runs */

struct manifest_comparison {
    oxl_context *ctx;
    const char *old, *current; /* "job": {...} and "found": {...} of each run */
    struct text *t;            /* gets a line for each difference; or NULL */
    struct manifest_changes changes;
};

/* Counts a member whose values differ, and adds its line. */
static oxl_result manifest_compare(struct manifest_comparison *c, const char *member, const char *label)
{
    char *old = NULL, *current = NULL;
    oxl_result rc = manifest_read_value(c->ctx, manifest_find(c->old, member), &old);
    if (rc == OXL_OK) rc = manifest_read_value(c->ctx, manifest_find(c->current, member), &current);
    if (rc == OXL_OK && (old || current) && (!old || !current || strcmp(old, current) != 0)) {
        c->changes.iterations |= !strcmp(member, "iterations");
        c->changes.start |= !strcmp(member, "start");
        if (c->changes.count++ < MANIFEST_DIFFERENCES && c->t)
            text_add(c->t, "  %s: %.60s there, %.60s here\n", label, old ? old : "not given",
                     current ? current : "not given");
    }
    OXL_FREE(c->ctx, old, current);
    return rc;
}

OXL_INTERNAL oxl_result manifest_differences(oxl_context *ctx, const char *old, const char *current,
                                             struct text *t, struct manifest_changes *changes)
{
    static const char *const others[][2] = {{"version", "version"},
                                            {"scene", "survey"},
                                            {"seed", "--seed"},
                                            {"device", "device"},
                                            {"images", "images of the survey"},
                                            {"points", "points of the survey"},
                                            {"extent", "extent of the survey"},
                                            {"files", "checksum of its poses, points, image and mask files"},
                                            {"start", "model to start from"}};
    struct manifest_comparison c = {.ctx = ctx, .old = old, .current = current, .t = t};
    oxl_result rc = OXL_OK;
    for (int i = 0; i < oxl_option_count() && rc == OXL_OK; i++) {
        char member[40], label[48];
        if (!(oxl_option_at(i)->use & OXL_OPTION_OF_RESULT)) continue;
        snprintf(label, sizeof label, "--%s", oxl_option_at(i)->name);
        rc = manifest_compare(&c, oxl_option_member(oxl_option_at(i), member), label);
    }
    for (size_t i = 0; i < OXL_COUNT(others) && rc == OXL_OK; i++)
        rc = manifest_compare(&c, others[i][0], others[i][1]);
    if (c.changes.count > MANIFEST_DIFFERENCES && t)
        text_add(t, "  and %d more\n", c.changes.count - MANIFEST_DIFFERENCES);
    *changes = c.changes;
    return rc;
}

/* ---------------- the same folders by other names */

OXL_INTERNAL int manifest_is_of(const struct oxl_manifest *run, const char *scene)
{
    return run->scene && (!strcmp(run->scene, scene) || os_is_same(run->scene, scene) ||
                          (!os_is_folder(run->scene) && os_is_folder(scene)));
}

/* Compares a member's values in both lines. is_path: names of the same folder are equal and, if `found` is
 * the same, names of a folder that no longer exists. */
static oxl_result manifest_same_member(oxl_context *ctx, const char *const line[2], const char *member,
                                       int is_path, int found, int *same)
{
    char *value[2] = {NULL, NULL};
    oxl_result rc = OXL_OK;
    for (int i = 0; i < 2 && rc == OXL_OK; i++)
        rc = manifest_read_value(ctx, manifest_find(line[i], member), &value[i]);
    if (rc == OXL_OK && value[0] && value[1])
        *same &= !strcmp(value[0], value[1]) ||
                 (is_path && (os_is_same(value[0], value[1]) || (found && !os_is_folder(value[0]))));
    else *same &= !value[0] && !value[1];
    OXL_FREE(ctx, value[0], value[1]);
    return rc;
}

OXL_INTERNAL oxl_result manifest_equivalent(oxl_context *ctx, const char *old, const char *current, int found,
                                            int *same)
{
    static const char *const others[] = {"version", "seed", "device"};
    const char *const line[2] = {old, current};
    oxl_result rc = OXL_OK;
    char name[40];
    *same = 1;
    for (size_t i = 0; i < OXL_COUNT(others) && rc == OXL_OK; i++)
        rc = manifest_same_member(ctx, line, others[i], 0, found, same);
    for (int i = 0; i < oxl_option_count() && rc == OXL_OK; i++)
        if (oxl_option_at(i)->use & OXL_OPTION_OF_RESULT)
            rc = manifest_same_member(ctx, line, oxl_option_member(oxl_option_at(i), name),
                                      oxl_option_at(i)->kind == OXL_OPTION_TEXT, found, same);
    if (rc == OXL_OK && *same && !found) rc = manifest_same_member(ctx, line, "scene", 1, 0, same);
    return rc;
}

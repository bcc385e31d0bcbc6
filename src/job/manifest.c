/* manifest.c - run.json: what a run's result depends on, written so that it can be compared and read back.
 *
 * Invariant: two runs whose lines "job" are equal, on the same files, end in the same bytes. What only says how fast or how
 * much at a time (threads, --max-time, --image-cache) is not in the line.
 */
#include "job.h"

/* ---------------------------------------------------------------- options to text */

static int manifest_is_json(const char *text)
{
    const char *end = text;
    double      value;
    if (strcmp(text, "true") == 0 || strcmp(text, "false") == 0) return 1;
    return ((unsigned char)(text[0] - '0') < 10 || text[0] == '-') && parse_double(&end, text + strlen(text), &value) && !*end;
}

/* A number, true or false as it is, anything else as a string. */
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
    char        name[40], value[128];
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
    if (t->ctx->vulkan) manifest_add_value(t, "device", oxl_backend_name(t->ctx)); /* its bytes are its own */
    text_add(t, "}");
}

/* ---------------------------------------------------------------- text to options */

/* What follows "name": in the line, or NULL. */
static const char *manifest_find(const char *line, const char *name)
{
    char quoted[64];
    snprintf(quoted, sizeof quoted, "\"%s\": ", name);
    line = strstr(line, quoted);
    return line ? line + strlen(quoted) : NULL;
}

OXL_INTERNAL double manifest_number(const char *text, const char *name)
{
    const char *s     = manifest_find(text, name);
    double      value = 0;
    if (s) parse_double(&s, s + strlen(s), &value);
    return fabs(value) <= DBL_MAX ? value : 0;
}

/* A JSON string as text_add_json_string writes it, into fresh memory; *out = NULL for null or nothing. */
static oxl_result manifest_read_string(oxl_context *ctx, const char *line, const char *name, char **out)
{
    struct text t = {.ctx = ctx};
    const char *s = manifest_find(line, name);
    *out          = NULL;
    if (!s || *s != '"') return OXL_OK;
    for (s++; *s && *s != '"'; s++) {
        if (*s == '\\' && s[1] == 'u') {
            char digits[5] = {0};
            memcpy(digits, s + 2, strnlen(s + 2, 4));
            text_add(&t, "%c", (char)strtol(digits, NULL, 16));
            s += 1 + strlen(digits);
        } else if (*s == '\\' && s[1]) text_add(&t, "%c", *++s);
        else text_add(&t, "%c", *s);
    }
    text_add(&t, "%s", "");
    return text_take(&t, out);
}

/* A value of the line as text, its quotes off, in fresh memory; *out = NULL when it is not there, or null. */
static oxl_result manifest_read_value(oxl_context *ctx, const char *line, const char *name, char **out)
{
    struct text t = {.ctx = ctx};
    const char *s = manifest_find(line, name);
    *out          = NULL;
    if (!s || strncmp(s, "null", 4) == 0) return OXL_OK;
    if (*s == '"') return manifest_read_string(ctx, line, name, out);
    text_add(&t, "%.*s", (int)strcspn(s, ",} \n"), s);
    return text_take(&t, out);
}

static oxl_result manifest_read_values(oxl_context *ctx, const char *line, struct oxl_manifest *run)
{
    oxl_result rc = manifest_read_string(ctx, line, "scene", &run->scene);
    char       name[40];
    for (int i = 0; i < oxl_option_count() && i < MANIFEST_VALUES && rc == OXL_OK; i++)
        if (oxl_option_at(i)->use & OXL_OPTION_OF_RESULT)
            rc = manifest_read_value(ctx, line, oxl_option_member(oxl_option_at(i), name), &run->value[i]);
    return rc;
}

/* The member that starts so, up to its closing brace, in fresh memory; NULL when there is none. */
static char *manifest_copy_line(oxl_context *ctx, const char *text, const char *start)
{
    const char *line   = strstr(text, start);
    size_t      length = line ? strcspn(line, "\n") : 0;
    char       *copy   = line ? oxl_calloc(ctx, length + 1, 1) : NULL;
    while (length > 0 && line[length - 1] != '}') length--; /* the comma behind it */
    if (copy) memcpy(copy, line, length);
    return copy;
}

OXL_INTERNAL oxl_result manifest_read(oxl_context *ctx, const char *folder, struct oxl_manifest *out)
{
    struct os_file_map map  = {0};
    char              *path = oxl_path_join(ctx, folder, "run.json");
    oxl_result         rc   = OXL_OK;
    *out                    = (struct oxl_manifest){0};
    if (!path) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to look into %s", folder);
    if (os_is_file(path)) rc = os_read_file(ctx, path, &map);
    if (rc == OXL_OK && map.data && strstr(map.data, "\"job\": {")) {
        out->finished = strstr(map.data, "\"finished\": true") != NULL;
        out->refine   = (float)OXL_CLAMP(manifest_number(map.data, "refine"), 0, oxl_option_find("refine")->high);
        out->line     = manifest_copy_line(ctx, map.data, "\"job\": {");
        out->found    = manifest_copy_line(ctx, map.data, "\"found\": {");
        if (out->line && manifest_find(out->line, "seed")) out->seed = strtoull(manifest_find(out->line, "seed"), NULL, 10);
        rc = manifest_read_string(ctx, map.data, "preset", &out->preset);
        if (rc == OXL_OK)
            rc = out->line ? manifest_read_values(ctx, out->line, out) : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %s", path);
    }
    os_release_file(ctx, &map);
    oxl_free(ctx, path);
    if (rc != OXL_OK) manifest_free(ctx, out);
    return rc;
}

OXL_INTERNAL void manifest_free(oxl_context *ctx, struct oxl_manifest *run)
{
    oxl_free(ctx, run->line);
    oxl_free(ctx, run->found);
    oxl_free(ctx, run->scene);
    oxl_free(ctx, run->preset);
    for (size_t i = 0; i < OXL_COUNT(run->value); i++) oxl_free(ctx, run->value[i]);
    *run = (struct oxl_manifest){0};
}

/* A value that the option cannot hold is not taken: the run is then one of other options, and job.c says so. */
OXL_INTERNAL void manifest_options(const struct oxl_manifest *run, oxl_job_options *o)
{
    const char *const none = NULL;
    for (int i = 0; i < oxl_option_count() && i < MANIFEST_VALUES; i++) {
        const oxl_option *option = oxl_option_at(i);
        if (run->value[i]) oxl_option_set(option, o, run->value[i], NULL, 0);
        else if (option->kind == OXL_OPTION_TEXT) memcpy((char *)o + option->at, &none, sizeof none);
    }
    o->refine = run->refine;
    o->preset = run->preset;
    o->seed   = run->seed;
}

/* ---------------------------------------------------------------- what tells two runs apart */

struct manifest_comparison {
    struct text *t;
    const char  *there, *here; /* "job": {...} and "found": {...} of both */
    int          count;
};

/* One line for a member that is not the same in both. */
static oxl_result manifest_compare(struct manifest_comparison *c, const char *member, const char *label)
{
    char      *there = NULL, *here = NULL;
    oxl_result rc = manifest_read_value(c->t->ctx, c->there, member, &there);
    if (rc == OXL_OK) rc = manifest_read_value(c->t->ctx, c->here, member, &here);
    if (rc == OXL_OK && (there || here) && (!there || !here || strcmp(there, here) != 0) && c->count++ < MANIFEST_DIFFERENCES)
        text_add(c->t, "  %s: %.60s there, %.60s here\n", label, there ? there : "not given", here ? here : "not given");
    oxl_free(c->t->ctx, there);
    oxl_free(c->t->ctx, here);
    return rc;
}

OXL_INTERNAL oxl_result manifest_differences(struct text *t, const char *there, const char *here)
{
    static const char *const   others[][2] = {{"version", "version"},
                                              {"scene", "survey"},
                                              {"seed", "--seed"},
                                              {"device", "device"},
                                              {"images", "images of the survey"},
                                              {"points", "points of the survey"},
                                              {"extent", "extent of the survey"}};
    struct manifest_comparison c           = {t, there, here, 0};
    oxl_result                 rc          = OXL_OK;
    for (int i = 0; i < oxl_option_count() && rc == OXL_OK; i++) {
        char member[40], label[48];
        if (!(oxl_option_at(i)->use & OXL_OPTION_OF_RESULT)) continue;
        snprintf(label, sizeof label, "--%s", oxl_option_at(i)->name);
        rc = manifest_compare(&c, oxl_option_member(oxl_option_at(i), member), label);
    }
    for (size_t i = 0; i < OXL_COUNT(others) && rc == OXL_OK; i++) rc = manifest_compare(&c, others[i][0], others[i][1]);
    if (c.count > MANIFEST_DIFFERENCES) text_add(t, "  and %d more\n", c.count - MANIFEST_DIFFERENCES);
    return rc;
}

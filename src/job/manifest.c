/* manifest.c - run.json: what a run's result depends on, written so that it can be compared and read back.
 *
 * Invariant: two runs whose lines "job" are equal, on the same files, end in the same bytes. What only says how fast or how
 * much at a time (threads, --max-time, --image-cache) is not in the line.
 */
#include "../internal.h"

#include <stddef.h>

enum run_kind { RUN_INT, RUN_CHOICE, RUN_FLOAT, RUN_DOUBLE, RUN_SIZE };

/* Each option once, for both ways. */
static const struct run_field {
    const char   *name;
    enum run_kind kind;
    size_t        at;   /* in oxl_job_options */
    int           last; /* of a choice: its enum counts from 0 to here */
} RUN_FIELDS[] = {
#define RUN_FIELD(name, kind, member)                    \
    {                                                    \
        name, kind, offsetof(oxl_job_options, member), 0 \
    }
#define RUN_ENUM(name, member, last)                              \
    {                                                             \
        name, RUN_CHOICE, offsetof(oxl_job_options, member), last \
    }
    RUN_FIELD("max_side", RUN_INT, scene.max_side),
    RUN_FIELD("test_every", RUN_INT, scene.test_every),
    RUN_FIELD("iterations", RUN_INT, train.iterations),
    RUN_FIELD("sh_degree", RUN_INT, train.sh_degree),
    RUN_FIELD("max_gaussians", RUN_INT, train.max_gaussians),
    RUN_FIELD("background_r", RUN_FLOAT, train.background[0]),
    RUN_FIELD("background_g", RUN_FLOAT, train.background[1]),
    RUN_FIELD("background_b", RUN_FLOAT, train.background[2]),
    RUN_FIELD("ssim_weight", RUN_FLOAT, train.ssim_weight),
    RUN_FIELD("ssim_every", RUN_INT, train.ssim_every),
    RUN_FIELD("exp_degree", RUN_INT, train.exp_degree),
    RUN_FIELD("stop_early", RUN_INT, train.stop_early),
    RUN_FIELD("coarse", RUN_FLOAT, train.coarse),
    RUN_FIELD("alpha_min", RUN_FLOAT, train.alpha_min),
    RUN_FIELD("tile_share", RUN_FLOAT, train.tile_share),
    RUN_FIELD("bands_every", RUN_FLOAT, train.bands_every),
    RUN_FIELD("rate_mean_first", RUN_FLOAT, train.rate_mean_first),
    RUN_FIELD("rate_mean_last", RUN_FLOAT, train.rate_mean_last),
    RUN_FIELD("rate_log_scale", RUN_FLOAT, train.rate_log_scale),
    RUN_FIELD("rate_rotation", RUN_FLOAT, train.rate_rotation),
    RUN_FIELD("rate_opacity", RUN_FLOAT, train.rate_opacity),
    RUN_FIELD("rate_sh0", RUN_FLOAT, train.rate_sh0),
    RUN_FIELD("rate_sh", RUN_FLOAT, train.rate_sh),
    RUN_FIELD("haste", RUN_FLOAT, train.haste),
    RUN_FIELD("settle", RUN_FLOAT, train.settle),
    RUN_FIELD("densify_from", RUN_FLOAT, train.densify_from),
    RUN_FIELD("densify_until", RUN_FLOAT, train.densify_until),
    RUN_FIELD("densify_every", RUN_INT, train.densify_every),
    RUN_FIELD("densify_gradient", RUN_FLOAT, train.densify_gradient),
    RUN_FIELD("reset_opacity_every", RUN_FLOAT, train.reset_opacity_every),
    RUN_ENUM("ucd", train.ucd.mode, OXL_UCD_AUTO),
    RUN_ENUM("ucd_bands", train.ucd.bands, OXL_UCD_FADING),
    RUN_FIELD("ucd_mid", RUN_FLOAT, train.ucd.f_mid),
    RUN_FIELD("ucd_far", RUN_FLOAT, train.ucd.f_far),
    RUN_FIELD("ucd_learn", RUN_INT, train.ucd.learn),
    RUN_ENUM("keep", train.keep.kind, OXL_KEEP_AUTO),
    RUN_FIELD("keep_value", RUN_DOUBLE, train.keep.value),
    RUN_ENUM("dog", train.dog, OXL_DOG_AUTO),
    RUN_FIELD("robust", RUN_INT, train.robust),
    RUN_ENUM("exposure", train.exposure, OXL_EXPOSURE_AUTO),
    RUN_FIELD("medium", RUN_INT, train.medium),
    RUN_FIELD("dog_from", RUN_FLOAT, train.dog_from),
    RUN_FIELD("dog_threshold", RUN_FLOAT, train.dog_threshold),
    RUN_FIELD("dog_opacity_factor", RUN_FLOAT, train.dog_opacity_factor),
    RUN_FIELD("dog_scale_factor", RUN_FLOAT, train.dog_scale_factor),
    RUN_FIELD("ram", RUN_SIZE, ram),
    RUN_FIELD("block_points", RUN_INT, partition.block_points),
    RUN_ENUM("partition", partition.kind, OXL_PARTITION_NONE),
    RUN_ENUM("cut", partition.cut, OXL_CUT_MIDPOINT),
#undef RUN_FIELD
#undef RUN_ENUM
};

static const struct run_path {
    const char *name;
    size_t      at;
} RUN_PATHS[] = {{"images_folder", offsetof(oxl_job_options, scene.images)},
                 {"sparse_folder", offsetof(oxl_job_options, scene.sparse)},
                 {"masks_folder", offsetof(oxl_job_options, scene.masks)}};

/* ---------------------------------------------------------------- options to text */

/* The shortest decimal of a float, as a double: 0.00016, not 0.000159999996. */
static double run_decimal(float value)
{
    char digits[32];
    for (int precision = 1; precision <= 9; precision++) {
        snprintf(digits, sizeof digits, "%.*g", precision, value);
        if ((float)strtod(digits, NULL) == value) break;
    }
    return strtod(digits, NULL);
}

static double run_get(const oxl_job_options *o, const struct run_field *field)
{
    const char *at = (const char *)o + field->at;
    if (field->kind == RUN_INT || field->kind == RUN_CHOICE) return *(const int *)at;
    if (field->kind == RUN_DOUBLE) return *(const double *)at;
    if (field->kind == RUN_SIZE) return (double)*(const size_t *)at;
    return run_decimal(*(const float *)at);
}

static void run_add_string(struct text *t, const char *name, const char *value)
{
    text_add(t, ", \"%s\": ", name);
    if (value) text_add_json_string(t, value);
    else text_add(t, "null");
}

OXL_INTERNAL void run_describe(struct text *t, const char *scene, const oxl_job_options *o)
{
    text_add(t, "\"job\": {\"version\": \"%s\", \"seed\": %llu", OXL_VERSION,
             (unsigned long long)(o->seed ? o->seed : t->ctx->options.seed));
    run_add_string(t, "scene", scene);
    for (size_t i = 0; i < OXL_COUNT(RUN_PATHS); i++)
        run_add_string(t, RUN_PATHS[i].name, *(const char *const *)((const char *)o + RUN_PATHS[i].at));
    for (size_t i = 0; i < OXL_COUNT(RUN_FIELDS); i++) {
        text_add(t, ", \"%s\": ", RUN_FIELDS[i].name);
        text_add_number(t, run_get(o, &RUN_FIELDS[i]));
    }
    if (t->ctx->vulkan) run_add_string(t, "device", oxl_backend_name(t->ctx)); /* its bytes are its own */
    text_add(t, "}");
}

/* ---------------------------------------------------------------- text to options */

/* A number that the option cannot hold is not taken: the run is then one of other options, and job.c says so. */
static int run_holds(const struct run_field *field, double value)
{
    if (field->kind == RUN_INT) return fabs(value) <= INT_MAX;
    if (field->kind == RUN_CHOICE) return value >= 0 && value <= field->last;
    if (field->kind == RUN_SIZE) return value >= 0 && value <= (double)(SIZE_MAX / 2);
    return fabs(value) <= (field->kind == RUN_FLOAT ? FLT_MAX : DBL_MAX);
}

static void run_set(oxl_job_options *o, const struct run_field *field, double value)
{
    char *at = (char *)o + field->at;
    if (!run_holds(field, value)) return;
    if (field->kind == RUN_INT || field->kind == RUN_CHOICE) *(int *)at = (int)value;
    else if (field->kind == RUN_DOUBLE) *(double *)at = value;
    else if (field->kind == RUN_SIZE) *(size_t *)at = (size_t)value;
    else *(float *)at = (float)value;
}

/* What follows "name": in the line, or NULL. */
static const char *run_find(const char *line, const char *name)
{
    char quoted[64];
    snprintf(quoted, sizeof quoted, "\"%s\": ", name);
    line = strstr(line, quoted);
    return line ? line + strlen(quoted) : NULL;
}

OXL_INTERNAL double run_number(const char *text, const char *name)
{
    const char *s     = run_find(text, name);
    double      value = 0;
    if (s) parse_double(&s, s + strlen(s), &value);
    return fabs(value) <= DBL_MAX ? value : 0;
}

/* A JSON string as text_add_json_string writes it, into fresh memory; *out = NULL for null or nothing. */
static oxl_result run_read_string(oxl_context *ctx, const char *line, const char *name, char **out)
{
    struct text t = {.ctx = ctx};
    const char *s = run_find(line, name);
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

static oxl_result run_read_paths(oxl_context *ctx, const char *line, struct oxl_run *run)
{
    oxl_result rc = run_read_string(ctx, line, "scene", &run->scene);
    for (size_t i = 0; i < OXL_COUNT(RUN_PATHS) && rc == OXL_OK; i++)
        rc = run_read_string(ctx, line, RUN_PATHS[i].name, &run->path[i]);
    return rc;
}

/* The member that starts so, up to its closing brace, in fresh memory; NULL when there is none. */
static char *run_copy_line(oxl_context *ctx, const char *text, const char *start)
{
    const char *line   = strstr(text, start);
    size_t      length = line ? strcspn(line, "\n") : 0;
    char       *copy   = line ? oxl_calloc(ctx, length + 1, 1) : NULL;
    while (length > 0 && line[length - 1] != '}') length--; /* the comma behind it */
    if (copy) memcpy(copy, line, length);
    return copy;
}

OXL_INTERNAL oxl_result run_read(oxl_context *ctx, const char *folder, struct oxl_run *out)
{
    struct os_file_map map  = {0};
    char              *path = oxl_path_join(ctx, folder, "run.json");
    oxl_result         rc   = OXL_OK;
    *out                    = (struct oxl_run){0};
    if (!path) return oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to look into %s", folder);
    if (os_is_file(path)) rc = os_read_file(ctx, path, &map);
    if (rc == OXL_OK && map.data && strstr(map.data, "\"job\": {")) {
        out->finished = strstr(map.data, "\"finished\": true") != NULL;
        out->refine   = (float)OXL_CLAMP(run_number(map.data, "refine"), 0, RUN_REFINE_MOST);
        out->line     = run_copy_line(ctx, map.data, "\"job\": {");
        out->found    = run_copy_line(ctx, map.data, "\"found\": {");
        if (out->line && run_find(out->line, "seed")) out->seed = strtoull(run_find(out->line, "seed"), NULL, 10);
        rc = run_read_string(ctx, map.data, "preset", &out->preset);
        if (rc == OXL_OK)
            rc = out->line ? run_read_paths(ctx, out->line, out) : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for %s", path);
    }
    os_release_file(ctx, &map);
    oxl_free(ctx, path);
    if (rc != OXL_OK) run_free(ctx, out);
    return rc;
}

OXL_INTERNAL void run_free(oxl_context *ctx, struct oxl_run *run)
{
    oxl_free(ctx, run->line);
    oxl_free(ctx, run->found);
    oxl_free(ctx, run->scene);
    oxl_free(ctx, run->preset);
    for (size_t i = 0; i < OXL_COUNT(run->path); i++) oxl_free(ctx, run->path[i]);
    *run = (struct oxl_run){0};
}

OXL_INTERNAL void run_options(const struct oxl_run *run, oxl_job_options *o)
{
    for (size_t i = 0; i < OXL_COUNT(RUN_FIELDS); i++) {
        const char *s = run_find(run->line, RUN_FIELDS[i].name);
        double      value;
        if (s && parse_double(&s, s + strlen(s), &value)) run_set(o, &RUN_FIELDS[i], value);
    }
    for (size_t i = 0; i < OXL_COUNT(RUN_PATHS); i++) memcpy((char *)o + RUN_PATHS[i].at, &run->path[i], sizeof run->path[i]);
    o->refine = run->refine;
    o->preset = run->preset;
    o->seed   = run->seed;
}

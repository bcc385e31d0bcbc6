/* survey_report.c - describes the content of a survey and the predicted cost of training, for `check` and the
 * first message of `train`.
 *
 * Invariant: nothing here changes what is trained.
 */
#include "job.h"
#include "../large/os_job.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../checks/checks.h"

/* Writes a line as "3 cameras, the first OPENCV 1920 x 1080, distorted (undistorted on load)" */
static void survey_cameras(const struct colmap *c, oxl_survey *s)
{
    const struct colmap_camera *first = c && c->camera_count ? c->camera : NULL;
    if (!first) return;
    s->cameras = (int)c->camera_count;
    for (size_t i = 0; i < c->camera_count; i++) s->cameras_distorted += camera_is_distorted(&first[i]);
    snprintf(s->cameras_text, sizeof s->cameras_text, "%d%s %s %d x %d, %s", s->cameras,
             s->cameras == 1 ? " camera," : " cameras, the first", camera_model_at(first->model)->name,
             first->width, first->height,
             s->cameras_distorted ? "distorted (undistorted on load)" : "without distortion");
}

/* Finds the size of the largest view, on which most of the memory depends. */
static void survey_largest(const oxl_scene *scene, oxl_survey *s)
{
    for (int i = 0; i < scene->view_count; i++) {
        const oxl_camera *c = &scene->view[i].camera;
        if ((double)c->width * c->height > (double)s->width * s->height)
            s->width = c->width, s->height = c->height;
    }
}

static void survey_predict(const oxl_scene *scene, const oxl_job_options *o, oxl_survey *s)
{
    oxl_job_options fitted = *o;
    const struct cost_load load = cost_load_of_scene(scene);
    fitted.ram = budget_limit(scene, o);
    budget_fit(&load, &fitted); /* assumes blocks if one does not fit */
    s->gaussians = cost_gaussians(&fitted, &load);
    s->memory = cost_memory(&fitted, &load, s->gaussians);
    if (fitted.ram) s->memory = OXL_MIN(s->memory, (double)fitted.ram);
    s->memory_free = (double)os_memory_free();
}

/* ---------------- words */

/* Adds to a text of a survey, as far as there is room. */
static void survey_add(char *text, const char *format, ...) OXL_PRINTF(2, 3);
static void survey_add(char *text, const char *format, ...)
{
    const size_t used = strlen(text);
    va_list args;
    va_start(args, format);
    vsnprintf(text + used, OXL_SURVEY_TEXT - used, format, args);
    va_end(args);
}

static void survey_write_facts(oxl_survey *s)
{
    survey_add(s->text,
               "images       %d in the model, %d missing on disk; %d for training, %d held out; %d masks",
               s->images, s->images_missing, s->train_views, s->test_views, s->masks);
    if (s->masked > 0)
        survey_add(s->text, " (%.0f %% of their pixels are black and ignored)", 100 * s->masked);
    if (s->fixed > 0)
        survey_add(s->text, "; %.1f %% of all pixels look the same in all images and are ignored",
                   100 * s->fixed);
    survey_add(s->text, "\n");
    survey_add(s->text, "cameras      %s; trained at %d x %d\n",
               s->cameras_text[0] ? s->cameras_text : "given by the caller", s->width, s->height);
    if (s->points == 0) return;
    survey_add(s->text, "points       %zu in a box of %.3g x %.3g x %.3g units", s->points,
               s->bounds_max[0] - s->bounds_min[0], s->bounds_max[1] - s->bounds_min[1],
               s->bounds_max[2] - s->bounds_min[2]);
    if (s->mean_track > 0) survey_add(s->text, ", each seen in %.1f images on average", s->mean_track);
    if (s->mean_error > 0) survey_add(s->text, "; reprojection error %.2f px", s->mean_error);
    survey_add(s->text, "\n");
}

static void survey_write_prediction(const oxl_context *ctx, oxl_survey *s)
{
    const double seconds = s->seconds, unit = seconds < 90 ? 1 : seconds < 5400 ? 60 : 3600;
    survey_add(s->text,
               s->gaussians < 1e4 ? "prediction   %.0f Gaussians" : "prediction   %.0f thousand Gaussians",
               s->gaussians < 1e4 ? s->gaussians : s->gaussians / 1e3);
    survey_add(s->text, ", %.2f GB of memory", s->memory / 1e9);
    if (s->memory_free > 0) survey_add(s->text, " (%.1f GB free)", s->memory_free / 1e9);
    if (seconds > 0)
        survey_add(s->text, ", about %.*f %s on %d thread%s (%s)", unit > 60, OXL_MAX(seconds / unit, 1),
                   seconds < 90     ? "s"
                   : seconds < 5400 ? "min"
                                    : "h",
                   ctx->threads, ctx->threads == 1 ? "" : "s", oxl_isa_name(ctx));
    survey_add(s->text, "\n");
}

/* Writes the number of steps and its reason. */
static void survey_write_iterations(const oxl_job_options *o, int iterations, oxl_survey *s)
{
    const int images = s->images - s->images_missing;
    survey_add(s->text, "iterations   %d", iterations);
    if (iterations > o->train.iterations)
        survey_add(s->text, " for %d images, %d for every %d", images, o->train.iterations,
                   o->iterations_for);
    else if (iterations < o->train.iterations)
        survey_add(s->text, ", not %d, for only %d images", o->train.iterations, images);
    else if (o->iterations_for > 0) survey_add(s->text, ", enough for up to %d images", o->iterations_for);
    survey_add(s->text, "\n");
}

/* Writes the number of blocks and its reason. */
static oxl_result survey_write_blocks(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *o,
                                      oxl_survey *s)
{
    const struct cost_load load = cost_load_of_scene(scene);
    const double needs = cost_memory(o, &load, cost_gaussians(o, &load)),
                 limit = (double)budget_limit(scene, o);
    const int set =
        o->partition.kind == OXL_PARTITION_NONE || o->partition.blocks > 0 || o->partition.block_points > 0;
    struct partition p = {0};
    oxl_result rc = set || limit > 0 || o->device_ram ? budget_partition(ctx, scene, o, NAN, &p) : OXL_OK;
    if (rc != OXL_OK) return rc;
    survey_add(s->text, "blocks       %d%s; one block takes about %.2f GB", OXL_MAX(1, p.block_count),
               set ? ", as set" : "", needs / 1e9);
    survey_add(s->text, limit > 0 ? ", of the %.2f GB allowed\n" : "\n", limit / 1e9);
    partition_free(ctx, &p);
    return OXL_OK;
}

#define SURVEY_BASELINE 0.003 /* of the median depth: the least distance of cameras that tells depths */

/* Returns 1 if all camera centres are nearly in one place, so that images tell no depths. */
static int survey_has_no_baseline(const oxl_scene *scene)
{
    double apart = 0;
    for (int i = 1; i < scene->view_count; i++)
        apart = OXL_MAX(apart, camera_distance(&scene->view[0].camera, &scene->view[i].camera));
    return apart <= SURVEY_BASELINE * scene_depth_quantile(scene, 0.5);
}

static void survey_write_warnings(oxl_survey *s, int one_place)
{
    if (s->images_unregistered > 0)
        survey_add(
            s->warnings,
            "%d of the %d images in the folder are not in the model (COLMAP did not register them), so "
            "places that only they show are missing; match again with more overlap or another matcher, "
            "or name another sub-model by --sparse\n",
            s->images_unregistered, s->images_unregistered + s->images - s->images_missing);
    if (s->unusable > 0)
        survey_add(s->warnings, "%d of %d images cannot be used and are left out\n", s->unusable, s->images);
    if (s->points == 0)
        survey_add(s->warnings,
                   s->outlined
                       ? "the survey has no points: training starts from depth maps of its images or, "
                         "without depth, from random points within their outlines\n"
                       : "the survey has no points: training starts from depth maps of its images, which "
                         "need texture and overlap; export points3D as well\n");
    else if (s->points < 500)
        survey_add(s->warnings, "the survey has only %zu points; check that this is the right sub-model\n",
                   s->points);
    if (s->mean_error > 2)
        survey_add(
            s->warnings,
            "a reprojection error of %.1f px blurs the whole model (good: below 1); run colmap bundle_adjuster\n",
            s->mean_error);
    if (s->train_views == 1)
        survey_add(s->warnings, "a single training view: depth cannot be learned from it\n");
    else if (one_place)
        survey_add(s->warnings, "all cameras are at the same place: depth cannot be learned from them\n");
    else if (s->train_views < 10)
        survey_add(s->warnings, "the survey has only %d training views; expect holes\n", s->train_views);
    if (s->test_views == 0)
        survey_add(s->warnings, "no view is held out, so the metrics are of training views\n");
    if (s->memory_free > 0 && s->memory > 0.9 * s->memory_free)
        survey_add(
            s->warnings,
            "memory may not suffice; reduce it with --max-side, --max-gaussians, --image-cache or --sh-degree 0\n");
}

/* ---------------- public functions */

OXL_INTERNAL oxl_result survey_describe(oxl_context *ctx, oxl_scene *scene, const oxl_job_options *options,
                                        int closely, oxl_survey *out)
{
    oxl_result rc;
    const struct scene_stats *stats = &scene->stats;
    const double *origin = scene->origin;
    oxl_job_options whole = *options;
    *out = (oxl_survey){.images = stats->images_listed,
                        .images_missing = stats->images_missing,
                        .images_unregistered = stats->unregistered,
                        .train_views = stats->views - stats->test_views,
                        .test_views = stats->test_views,
                        .masks = stats->masks,
                        .fixed = stats->fixed,
                        .points = stats->points,
                        .outlined = scene_is_composited(scene),
                        .observations = stats->observations,
                        .mean_track = stats->mean_track,
                        .mean_error = stats->mean_error,
                        .extent = scene->extent};
    for (int k = 0; k < 3; k++) {
        out->bounds_min[k] = stats->bounds_min[k] + origin[k];
        out->bounds_max[k] = stats->bounds_max[k] + origin[k];
    }
    survey_cameras(scene_colmap(scene), out);
    survey_largest(scene, out);
    rc = lint_images(ctx, scene, closely, out);
    if (rc != OXL_OK) return rc;
    whole.train.iterations = cost_iterations(options, out->images - out->images_missing);
    survey_predict(scene, &whole, out);
    if (closely) rc = cost_seconds(ctx, scene, &whole, &out->seconds);
    if (rc != OXL_OK) return rc;
    survey_write_facts(out);
    survey_write_prediction(ctx, out);
    survey_write_iterations(options, whole.train.iterations, out);
    if (closely) rc = survey_write_blocks(ctx, scene, &whole, out);
    survey_write_warnings(out, survey_has_no_baseline(scene));
    context_name_fields(ctx, out->warnings, OXL_SURVEY_TEXT);
    return rc;
}

oxl_result oxl_check(oxl_context *ctx, const char *path, const oxl_job_options *options, int quality,
                     oxl_survey *out)
{
    const oxl_job_options o = options ? *options : oxl_job_options_default(OXL_PRESET_DRAFT);
    oxl_scene *scene = NULL;
    oxl_result rc = oxl_scene_load(ctx, path, &o.scene, &scene);
    *out = (oxl_survey){0};
    if (rc == OXL_OK) rc = survey_describe(ctx, scene, &o, 1, out);
    if (rc == OXL_OK) rc = hypotheses_check(ctx, scene, 1, &out->foreign);
    if (rc == OXL_OK && quality) rc = quality_check(ctx, scene, out);
    oxl_scene_free(ctx, scene);
    return rc;
}

static void survey_add_triple(struct text *t, const char *indent, const char *name, const double v[3])
{
    text_add(t, ",\n%s  \"%s\": [%s, %s, %s]", indent, name, NUMBER(v[0]), NUMBER(v[1]), NUMBER(v[2]));
}

OXL_INTERNAL void survey_add_json(struct text *t, const oxl_survey *s, const char *indent)
{
    const struct {
        const char *name;
        double value;
    } numbers[] = {{"images", s->images},
                   {"images_missing", s->images_missing},
                   {"images_unregistered", s->images_unregistered},
                   {"train_views", s->train_views},
                   {"test_views", s->test_views},
                   {"masks", s->masks},
                   {"cameras", s->cameras},
                   {"cameras_distorted", s->cameras_distorted},
                   {"width", s->width},
                   {"height", s->height},
                   {"points", (double)s->points},
                   {"observations", (double)s->observations},
                   {"mean_track", s->mean_track},
                   {"mean_error", s->mean_error > 0 ? s->mean_error : NAN},
                   {"extent", s->extent},
                   {"masked_share", s->masked},
                   {"fixed_share", s->fixed},
                   {"unusable", s->unusable},
                   {"foreign", s->foreign},
                   {"blurred", s->blurred},
                   {"badly_exposed", s->badly_exposed},
                   {"predicted_gaussians", s->gaussians},
                   {"predicted_memory_bytes", s->memory},
                   {"predicted_seconds", s->seconds}};
    text_add(t, "{\n%s  \"cameras_text\": ", indent);
    text_add_json_string(t, s->cameras_text);
    for (size_t i = 0; i < OXL_COUNT(numbers); i++)
        text_add(t, ",\n%s  \"%s\": %s", indent, numbers[i].name, NUMBER(numbers[i].value));
    survey_add_triple(t, indent, "bounds_min", s->bounds_min);
    survey_add_triple(t, indent, "bounds_max", s->bounds_max);
    text_add(t, "\n%s}", indent);
}

oxl_result oxl_survey_to_json(oxl_context *ctx, const oxl_survey *survey, char **out)
{
    struct text t = {.ctx = ctx};
    survey_add_json(&t, survey, "");
    text_add(&t, "\n");
    return text_take(&t, out);
}

/* job.c - the whole job: a survey in, a folder with the model, its metrics and its pictures out.
 *
 * OUT/run.json is removed first and written last, whole, when everything else is in place. Invariant: a run.json that says
 * "finished": true describes the scene.ply beside it; the line "job" in it is all that the result depends on, so a second run
 * that would write the same line has nothing to do.
 */
#include "internal.h"

#define JOB_LOG_ROWS    200  /* rows of log.csv in a whole run */
#define JOB_LOG_SECONDS 30.0 /* log.csv on disk is at most this old */

struct job {
    oxl_context           *ctx;
    const char            *scene_path, *out;
    const oxl_job_options *options;
    const oxl_callback    *callback; /* the caller's, or NULL */
    oxl_scene             *scene;
    oxl_survey             survey;
    oxl_model              model;
    struct text            line, log; /* "job": {...} of run.json; log.csv so far */
    oxl_progress           last;
    double                 log_written; /* seconds */
};

oxl_job_options oxl_job_options_default(oxl_preset preset)
{
    static const char *const names[] = {"draft", "standard", "paper"};
    return (oxl_job_options){.scene     = oxl_scene_options_default(),
                             .train     = oxl_train_options_default(preset),
                             .partition = oxl_partition_options_default(),
                             .preset    = names[preset],
                             .renders   = 1};
}

/* ---------------------------------------------------------------- files of OUT */

static oxl_result job_write(struct job *job, const char *name, const struct text *t)
{
    char      *path = oxl_path_join(job->ctx, job->out, name);
    oxl_result rc   = path && !t->failed ? OXL_OK : oxl_fail(job->ctx, OXL_ERR_MEMORY, "no memory to write %s", name);
    if (rc == OXL_OK) rc = os_write_file(job->ctx, path, t->data, t->size);
    oxl_free(job->ctx, path);
    return rc;
}

static oxl_result job_remove(struct job *job, const char *name)
{
    char *path = oxl_path_join(job->ctx, job->out, name);
    if (!path) return oxl_fail(job->ctx, OXL_ERR_MEMORY, "no memory to remove %s", name);
    remove(path);
    oxl_free(job->ctx, path);
    return OXL_OK;
}

/* ---------------------------------------------------------------- what the result depends on */

/* The shortest decimal of a float, as a double: 0.00016, not 0.000159999996. */
static double job_decimal(float value)
{
    char digits[32];
    for (int precision = 1; precision <= 9; precision++) {
        snprintf(digits, sizeof digits, "%.*g", precision, value);
        if ((float)strtod(digits, NULL) == value) break;
    }
    return strtod(digits, NULL);
}

static void job_add_path(struct text *t, const char *name, const char *path)
{
    text_add(t, ", \"%s\": ", name);
    if (path) text_add_json_string(t, path);
    else text_add(t, "null");
}

static void job_describe(struct job *job)
{
    const oxl_scene_options *s = &job->options->scene;
    const oxl_train_options *o = &job->options->train;
    struct text             *t = &job->line;
    const struct {
        const char *name;
        double      value;
    } numbers[] = {{"images", job->survey.images - job->survey.images_missing},
                   {"points", (double)job->survey.points},
                   {"extent", job->survey.extent},
                   {"max_side", s->max_side},
                   {"test_every", s->test_every},
                   {"iterations", o->iterations},
                   {"sh_degree", o->sh_degree},
                   {"max_gaussians", o->max_gaussians},
                   {"max_seconds", o->max_seconds},
                   {"background_r", job_decimal(o->background[0])},
                   {"background_g", job_decimal(o->background[1])},
                   {"background_b", job_decimal(o->background[2])},
                   {"ssim_weight", job_decimal(o->ssim_weight)},
                   {"rate_mean_first", job_decimal(o->rate_mean_first)},
                   {"rate_mean_last", job_decimal(o->rate_mean_last)},
                   {"rate_log_scale", job_decimal(o->rate_log_scale)},
                   {"rate_rotation", job_decimal(o->rate_rotation)},
                   {"rate_opacity", job_decimal(o->rate_opacity)},
                   {"rate_sh0", job_decimal(o->rate_sh0)},
                   {"rate_sh", job_decimal(o->rate_sh)},
                   {"densify_from", job_decimal(o->densify_from)},
                   {"densify_until", job_decimal(o->densify_until)},
                   {"densify_every", o->densify_every},
                   {"densify_gradient", job_decimal(o->densify_gradient)},
                   {"reset_opacity_every", job_decimal(o->reset_opacity_every)}};
    text_add(t, "\"job\": {\"version\": \"%s\", \"seed\": %llu", OXL_VERSION, (unsigned long long)job->ctx->options.seed);
    job_add_path(t, "scene", job->scene_path);
    job_add_path(t, "images_folder", s->images);
    job_add_path(t, "sparse_folder", s->sparse);
    job_add_path(t, "masks_folder", s->masks);
    for (size_t i = 0; i < OXL_COUNT(numbers); i++) {
        text_add(t, ", \"%s\": ", numbers[i].name);
        text_add_number(t, numbers[i].value);
    }
    text_add(t, "}");
}

static oxl_result job_is_done(struct job *job, int *done)
{
    struct os_file_map map   = {0};
    char              *run   = oxl_path_join(job->ctx, job->out, "run.json");
    char              *model = oxl_path_join(job->ctx, job->out, "scene.ply");
    oxl_result         rc    = OXL_OK;
    *done                    = 0;
    if (!run || !model || job->line.failed) rc = oxl_fail(job->ctx, OXL_ERR_MEMORY, "no memory to look into %s", job->out);
    else if (os_is_file(run) && os_is_file(model)) rc = os_read_file(job->ctx, run, &map);
    if (rc == OXL_OK && map.data) *done = strstr(map.data, "\"finished\": true") && strstr(map.data, job->line.data);
    os_release_file(job->ctx, &map);
    oxl_free(job->ctx, run);
    oxl_free(job->ctx, model);
    return rc;
}

/* ---------------------------------------------------------------- while it runs */

static void job_log_survey(struct job *job)
{
    static const char warning[] = "warning: ";
    for (const char *s = job->survey.text; *s; s += strcspn(s, "\n") + 1) {
        const size_t skip = strncmp(s, warning, sizeof warning - 1) == 0 ? sizeof warning - 1 : 0;
        oxl_log(job->ctx, skip ? OXL_LOG_WARNING : OXL_LOG_INFO, "%.*s", (int)(strcspn(s, "\n") - skip), s + skip);
    }
}

static oxl_result job_open(struct job *job)
{
    oxl_result rc = os_make_folder(job->ctx, job->out);
    if (rc == OXL_OK) rc = oxl_scene_load(job->ctx, job->scene_path, &job->options->scene, &job->scene);
    if (rc != OXL_OK) return rc;
    survey_describe(job->ctx, job->scene, job->options, &job->survey);
    job_log_survey(job);
    job_describe(job);
    text_add(&job->log, "iteration,loss,psnr,gaussians,seconds\n");
    return OXL_OK;
}

static double job_rounded(double value, double parts)
{
    return floor(value * parts + 0.5) / parts;
}

static int job_progress(void *user, const oxl_progress *progress)
{
    struct job  *job   = user;
    oxl_progress p     = *progress;
    const int    every = OXL_MAX(1, p.iterations / JOB_LOG_ROWS);
    const double limit = job->options->train.max_seconds;
    p.memory           = os_peak_rss();
    if (limit > 0) p.seconds_left = OXL_MIN(p.seconds_left, OXL_MAX(0, limit - p.seconds));
    if (p.iteration % every == 0 || p.iteration == p.iterations) {
        text_add(&job->log, "%d,", p.iteration);
        text_add_number(&job->log, job_rounded(p.loss, 1e6));
        text_add(&job->log, ",");
        text_add_number(&job->log, job_rounded(p.psnr, 1e3));
        text_add(&job->log, ",%zu,", p.gaussians);
        text_add_number(&job->log, job_rounded(p.seconds, 1e3));
        text_add(&job->log, "\n");
    }
    if (p.seconds - job->log_written > JOB_LOG_SECONDS) {
        job_write(job, "log.csv", &job->log); /* a full disk is reported at the end, where it matters */
        job->log_written = p.seconds;
    }
    job->last       = p;
    job->last.model = NULL;
    return job->callback ? job->callback->progress(job->callback->user, &p) : 0;
}

/* ---------------------------------------------------------------- pictures */

/* FOLDER/NAME + suffix, with the folders that NAME asks for, none of them outside FOLDER. */
static char *job_picture_path(oxl_context *ctx, const char *folder, const char *name, const char *suffix)
{
    struct text t = {.ctx = ctx};
    char       *path, *slash;
    const int   escapes = name[0] == '/' || strstr(name, "..");
    text_add(&t, "%s/%s%s", folder, name, suffix);
    if (text_take(&t, &path) != OXL_OK) {
        oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the name of a picture");
        return NULL;
    }
    for (char *c = path + strlen(folder) + 1; escapes && *c; c++)
        if (*c == '/') *c = '_';
    slash  = strrchr(path, '/');
    *slash = 0;
    if (os_make_folder(ctx, path) != OXL_OK) {
        oxl_free(ctx, path);
        return NULL;
    }
    *slash = '/';
    return path;
}

static oxl_result job_write_image(oxl_context *ctx, const char *folder, const char *name, const char *suffix,
                                  const oxl_image *image)
{
    char            *path = job_picture_path(ctx, folder, name, suffix);
    const oxl_result rc   = path ? oxl_image_write(ctx, path, image) : OXL_ERR_IO;
    oxl_free(ctx, path);
    return rc;
}

/* Portable float map: rows from the bottom, the sign of the scale tells the byte order. */
static oxl_result job_write_pfm(oxl_context *ctx, const char *folder, const char *name, const float *depth, int width, int height)
{
    const uint16_t   one   = 1;
    const int        small = *(const unsigned char *)&one; /* little endian */
    char            *path  = job_picture_path(ctx, folder, name, ".depth.pfm");
    struct os_writer writer;
    oxl_result       rc = path ? os_writer_open(ctx, path, &writer) : OXL_ERR_IO;
    if (rc != OXL_OK) goto done;
    fprintf(writer.file, "Pf\n%d %d\n%s\n", width, height, small ? "-1.0" : "1.0");
    for (int y = height - 1; y >= 0; y--) fwrite(depth + (size_t)y * width, sizeof *depth, (size_t)width, writer.file);
    rc = os_writer_close(ctx, &writer, OXL_OK);
done:
    oxl_free(ctx, path);
    return rc;
}

/* A picture of depth that needs no limits: mean / (mean + z), so 1 is here, 1/2 the mean depth, 0 far or nothing. */
static oxl_result job_write_depth(oxl_context *ctx, const char *folder, const char *name, const float *depth, int width,
                                  int height)
{
    const size_t pixels  = (size_t)width * height;
    oxl_image    picture = {0};
    double       sum     = 0;
    size_t       met     = 0;
    oxl_result   rc      = oxl_image_create(ctx, width, height, &picture);
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; i < pixels; i++)
        if (depth[i] > 0) sum += depth[i], met++;
    for (size_t i = 0; i < pixels; i++) {
        const float mean = (float)(met ? sum / (double)met : 1), v = depth[i] > 0 ? mean / (mean + depth[i]) : 0;
        for (int c = 0; c < 3; c++) picture.rgb[c * pixels + i] = v;
    }
    rc = job_write_image(ctx, folder, name, ".depth.png", &picture);
    if (rc == OXL_OK) rc = job_write_pfm(ctx, folder, name, depth, width, height);
    oxl_image_free(ctx, &picture);
    return rc;
}

static oxl_result job_render_view(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, int index, const oxl_pictures *what,
                                  const char *folder)
{
    const oxl_view *view  = oxl_scene_view(scene, index);
    const int       width = view->camera.width, height = view->camera.height;
    oxl_image       drawn = {0}, photograph = {0};
    float          *depth = NULL;
    oxl_result      rc    = OXL_OK;

    oxl_render_options options = oxl_render_options_default();
    options.near_plane         = (float)scene_near_plane(scene);
    if (what->depth) {
        depth = oxl_alloc(ctx, (size_t)width * height, sizeof *depth);
        if (!depth) {
            rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for a depth map of %d x %d", width, height);
            goto done;
        }
    }
    rc = oxl_render(ctx, model, &view->camera, &options, &drawn, depth);
    if (rc == OXL_OK) rc = job_write_image(ctx, folder, view->name, ".png", &drawn);
    if (rc == OXL_OK && depth) rc = job_write_depth(ctx, folder, view->name, depth, width, height);
    if (rc == OXL_OK && what->photographs) rc = oxl_scene_image(ctx, scene, index, &photograph);
    if (rc == OXL_OK && what->photographs) rc = job_write_image(ctx, folder, view->name, ".photo.png", &photograph);
done:
    oxl_image_free(ctx, &drawn);
    oxl_image_free(ctx, &photograph);
    oxl_free(ctx, depth);
    return rc;
}

oxl_result oxl_render_views(oxl_context *ctx, const oxl_model *model, oxl_scene *scene, const oxl_pictures *what,
                            const char *folder, int *count)
{
    oxl_result rc = os_make_folder(ctx, folder);
    *count        = 0;
    for (int i = 0; i < oxl_scene_view_count(scene) && rc == OXL_OK; i++) {
        const int is_test = oxl_scene_view(scene, i)->is_test;
        if (what->split != OXL_SPLIT_ALL && is_test != (what->split == OXL_SPLIT_TEST)) continue;
        rc = job_render_view(ctx, model, scene, i, what, folder);
        *count += rc == OXL_OK;
    }
    return rc;
}

/* ---------------------------------------------------------------- at the end */

oxl_result oxl_metrics_to_json(oxl_context *ctx, const oxl_scene *scene, const oxl_metrics *metrics, char **out)
{
    struct text t  = {.ctx = ctx};
    oxl_result  rc = OXL_OK;
    *out           = NULL;
    text_add(&t, "{\n");
    rc = metrics_write_json(ctx, &t, scene, metrics);
    text_add(&t, "}\n");
    if (rc == OXL_OK) rc = text_take(&t, out);
    text_free(&t);
    return rc;
}

static oxl_result job_write_metrics(struct job *job, size_t bytes)
{
    const oxl_split split = job->survey.test_views > 0 ? OXL_SPLIT_TEST : OXL_SPLIT_TRAIN;
    oxl_metrics     m     = {0};
    struct text     t     = {.ctx = job->ctx};
    int             drawn = 0;
    oxl_result      rc    = oxl_evaluate(job->ctx, &job->model, job->scene, split, &m);
    if (rc != OXL_OK) goto done;
    oxl_log(job->ctx, OXL_LOG_INFO, "%s views: PSNR %.2f dB, SSIM %.4f over %d; %zu Gaussians, %.1f MB",
            split == OXL_SPLIT_TEST ? "test" : "training", m.psnr, m.ssim, m.count, job->model.count, (double)bytes / 1e6);
    text_add(&t, "{\n  \"split\": \"%s\",\n  \"gaussians\": %zu,\n  \"bytes\": %zu,\n  \"seconds\": ",
             split == OXL_SPLIT_TEST ? "test" : "train", job->model.count, bytes);
    text_add_number(&t, job_rounded(job->last.seconds, 1e3));
    text_add(&t, ",\n  \"iterations\": %d,\n  \"peak_rss_bytes\": %zu,\n", job->last.iteration, os_peak_rss());
    rc = metrics_write_json(job->ctx, &t, job->scene, &m);
    text_add(&t, "}\n");
    if (rc == OXL_OK) rc = job_write(job, "metrics.json", &t);
    if (rc == OXL_OK && job->options->renders) {
        char *folder = oxl_path_join(job->ctx, job->out, "renders");
        rc           = folder ? oxl_render_views(job->ctx, &job->model, job->scene, &(oxl_pictures){split, 1, 0}, folder, &drawn)
                              : oxl_fail(job->ctx, OXL_ERR_MEMORY, "no memory for the pictures");
        oxl_free(job->ctx, folder);
    }
done:
    oxl_metrics_free(job->ctx, &m);
    text_free(&t);
    return rc;
}

static oxl_result job_write_run(struct job *job, int finished)
{
    struct text t = {.ctx = job->ctx};
    oxl_result  rc;
    text_add(&t, "{\n  \"oceanxl\": \"%s\",\n  \"finished\": %s,\n  \"preset\": ", OXL_VERSION, finished ? "true" : "false");
    text_add_json_string(&t, job->options->preset ? job->options->preset : "");
    text_add(&t, ",\n  \"threads\": %d,\n  \"instructions\": \"%s\",\n  \"iterations_done\": %d,\n  \"origin\": [",
             job->ctx->threads, oxl_isa_name(job->ctx), job->last.iteration);
    for (int k = 0; k < 3; k++) {
        if (k > 0) text_add(&t, ", ");
        text_add_number(&t, job->model.origin[k]);
    }
    text_add(&t, "],\n  %s,\n  \"survey\": ", job->line.data);
    survey_add_json(&t, &job->survey, "  ");
    text_add(&t, "\n}\n");
    rc = job_write(job, "run.json", &t);
    text_free(&t);
    return rc;
}

/* Everything that belongs to the result; `finished` 0: the model and the log alone. */
static oxl_result job_write_all(struct job *job, int finished)
{
    struct os_file_map map  = {0};
    char              *path = oxl_path_join(job->ctx, job->out, "scene.ply");
    oxl_result rc = path ? job_remove(job, "run.json") : oxl_fail(job->ctx, OXL_ERR_MEMORY, "no memory to write scene.ply");
    if (rc == OXL_OK) rc = job_remove(job, "metrics.json");
    if (rc == OXL_OK) rc = oxl_model_write(job->ctx, path, &job->model);
    if (rc == OXL_OK) rc = job_write(job, "log.csv", &job->log);
    if (rc == OXL_OK && finished) rc = os_read_file(job->ctx, path, &map);
    if (rc == OXL_OK && finished) rc = job_write_metrics(job, map.size);
    if (rc == OXL_OK) rc = job_write_run(job, finished);
    os_release_file(job->ctx, &map);
    oxl_free(job->ctx, path);
    return rc;
}

oxl_result oxl_job_run(oxl_context *ctx, const char *scene, const char *out, const oxl_job_options *options,
                       const oxl_callback *callback)
{
    const oxl_job_options defaults = oxl_job_options_default(OXL_PRESET_DRAFT);
    struct job            job      = {.ctx        = ctx,
                                      .scene_path = scene,
                                      .out        = out,
                                      .options    = options ? options : &defaults,
                                      .callback   = callback,
                                      .line       = {.ctx = ctx},
                                      .log        = {.ctx = ctx}};
    oxl_result            rc, written;
    int                   done = 0;
    rc                         = job_open(&job);
    if (rc == OXL_OK) rc = job_is_done(&job, &done);
    if (rc != OXL_OK) goto done;
    if (done) {
        oxl_log(ctx, OXL_LOG_INFO, "%s already holds the finished result of this survey, these options and this seed", out);
        goto done;
    }
    rc = oxl_train(ctx, job.scene, &job.options->train, &(oxl_callback){job_progress, &job}, &job.model);
    if (rc != OXL_OK && rc != OXL_ERR_INTERRUPTED) goto done;
    written = job_write_all(&job, rc == OXL_OK);
    if (written != OXL_OK) rc = written;
done:
    oxl_model_free(ctx, &job.model);
    oxl_scene_free(ctx, job.scene);
    text_free(&job.line);
    text_free(&job.log);
    return rc;
}

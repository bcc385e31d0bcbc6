/* cost.c - predicts Gaussians, memory and time of training.
 *
 * Gaussians and memory follow from counts, with the measured constants below; time from some steps on the
 * survey's points, for which no image is read.
 */
#include "partition.h"
#include "large.h"
#include "../render/render.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

#define COST_STEREO_PIXELS 100.0 /* training pixels, as the run begins, for each point of parts/stereo.c */
#define COST_PIXEL_BYTES 160.0   /* of working memory a pixel: images, SSIM's maps */
#define COST_PROGRAM_BYTES 1.2e7 /* of the program itself; measured: 9 to 10 MB */
#define COST_DEVICE_ROW 110.0    /* bytes a row on a device, as backends/vulkan reserves them, */
#define COST_DEVICE_PAIR 116.0   /* a pair of tile and splat, */
#define COST_DEVICE_PAIRS 8.0    /* of which a row has so many in a view of all Gaussians, */
#define COST_DEVICE_PIXEL 141.0  /* a pixel of loss and image, */
#define COST_DEVICE_BYTES 2e6    /* and those that do not grow; */
#define COST_DEVICE_ROOM 1.25    /* those that grow with the Gaussians are reserved by a quarter more */
#define COST_STEPS_PER_IMAGE \
    700 /* most iterations of a preset for an image: more overfit (docs/log/TRAINING.md) */
/* Limits the fraction of the budget for decoded images: others are read from files (docs/SCALE.md). */
#define COST_CACHE 0.1
#define COST_TIMED_SECONDS 1.0 /* after which no more steps are timed */
enum {
    COST_STEPS = 10,      /* timed, */
    COST_POINTS = 100000, /* with at most so many points */
    COST_JUDGED = 20,     /* iterations for each training view that is judged: that takes as long as a step */
    COST_JUDGED_MIN = 6,  /* but at least so many views */
    COST_HELD_OUT = 3     /* steps that take as long as the metrics of a held-out view */
};

OXL_INTERNAL int cost_iterations(const oxl_job_options *o, int images)
{
    const double more = OXL_MAX(1, (double)images / OXL_MAX(1, o->iterations_for));
    const double most = (double)COST_STEPS_PER_IMAGE * OXL_MAX(1, images);
    if (o->iterations_for == 0) return o->train.iterations;
    return (int)OXL_MIN(OXL_MIN(more * o->train.iterations, most), INT_MAX);
}

static void cost_add_view(struct cost_load *load, const oxl_scene *scene, int view)
{
    const oxl_camera *c = &scene->view[view].camera;
    const double pixels = (double)c->width * c->height;
    load->views++;
    load->pixels += pixels;
    load->largest = OXL_MAX(load->largest, pixels);
    load->largest_file = OXL_MAX(load->largest_file, scene_file_pixels(scene, view));
}

OXL_INTERNAL struct cost_load cost_load_of_scene(const oxl_scene *scene)
{
    const struct scene_stats *stats = &scene->stats;
    struct cost_load load = {.points = stats->points ? stats->points : scene_start_count(scene),
                             .observations = stats->observations,
                             .schedule_pixels = schedule_pixels(scene),
                             .stereo = (double)scene_stereo_count(scene)};
    for (int v = 0; v < scene->view_count; v++) cost_add_view(&load, scene, v);
    return load;
}

OXL_INTERNAL struct cost_load cost_load_of_block(const struct partition *p, int block)
{
    const struct partition_plan *plan = p->plan;
    const struct partition_block *b = &p->block[block];
    const struct scene_stats *stats = &plan->scene->stats;
    const double size = (double)OXL_MAX(b->points, (size_t)1);
    struct cost_load load = {
        .points = b->points,
        .observations = stats->observations,
        .schedule_pixels = schedule_pixels(plan->scene) * size / (double)OXL_MAX(stats->points, (size_t)1),
        .survey = (sizeof(struct colmap_point) + sizeof(oxl_point)) * (double)(stats->points - b->points),
        .stereo = (double)scene_stereo_count(plan->scene),
        .surroundings = OXL_MAX(0, (double)b->start_points / size - 1)};
    for (int v = 0; v < plan->scene->view_count; v++)
        if (partition_has_view(p, block, v)) cost_add_view(&load, plan->scene, v);
    return load;
}

/* Returns the numbers of a Gaussian at the end of a run, without a second lobe. */
static double cost_planes(const oxl_train_options *o)
{
    const int degree = o->sh_degree < 0 ? 3 : o->sh_degree;
    return OXL_SH + 3.0 * (degree + 1) * (degree + 1);
}

OXL_INTERNAL size_t cost_cache(const oxl_job_options *o)
{
    return o->ram ? OXL_MIN(o->scene.image_cache_bytes, (size_t)(COST_CACHE * (double)o->ram))
                  : o->scene.image_cache_bytes;
}

/* Bounds the bytes of images of `pixels` in total, without masks, and of decoding file_pixels. */
static double cost_images(double cache, double pixels, double file_pixels)
{
    const double one = SCENE_DECODE_BYTES * file_pixels, ahead = OXL_MIN(cache / 4, SCENE_AHEAD * one);
    return OXL_MIN(3 * pixels + ahead, cache) + one;
}

OXL_INTERNAL double cost_memory(const oxl_job_options *o, const struct cost_load *load, double gaussians)
{
    const oxl_train_options *train = &o->train;
    const double planes = cost_planes(train);
    const double cache = cost_images((double)cost_cache(o), load->pixels, load->largest_file);
    const double depths = parts_bytes(train, load->views);
    /* Counts sets of planes: parameters and two moments; a model for viewers, which some runs may need, is
     * refined beside the one that it begins with. */
    const double sets =
        train->exposure != OXL_OFF || train->medium != OXL_OFF || train->dog != OXL_DOG_OFF ? 4 : 3;
    return COST_PROGRAM_BYTES + cache + load->largest * COST_PIXEL_BYTES +
           gaussians * (sets * 4 * planes + COST_SPLAT_BYTES) +
           gaussians * load->surroundings * (4 * planes + COST_SPLAT_BYTES) +
           (double)load->observations * sizeof(struct colmap_track) + load->survey + depths;
}

OXL_INTERNAL double cost_device_memory(const oxl_job_options *o, const struct cost_load *load,
                                       double gaussians)
{
    const double planes = cost_planes(&o->train) + MODEL_LOBE_PLANES;
    const double a_row = COST_DEVICE_ROW + COST_DEVICE_PAIRS * COST_DEVICE_PAIR;
    return COST_DEVICE_BYTES + load->largest * COST_DEVICE_PIXEL +
           COST_DEVICE_ROOM * gaussians *
               (3 * 4 * planes + a_row + load->surroundings * (4 * planes + a_row));
}

/* Returns the Gaussians that a run starts with: stereo takes up to half of what may be added. */
static double cost_start(const oxl_train_options *o, const struct cost_load *load, double cap)
{
    const int side = (int)sqrt(load->largest);
    const double points = (double)load->points, halved = schedule_coarse_fraction(o, side, side) > 0 ? 4 : 1,
                 dense = OXL_MIN(load->schedule_pixels / halved / COST_STEREO_PIXELS, load->stereo);
    return OXL_MIN(o->stereo ? OXL_MAX(points, OXL_MIN(dense, (points + cap) / 2)) : points, OXL_MAX(cap, 1));
}

OXL_INTERNAL double cost_gaussians(const oxl_job_options *o, const struct cost_load *load)
{
    const oxl_camera none = {0};
    const double cap = (double)schedule_gaussian_cap_of(load->points, load->schedule_pixels, &o->train);
    double gaussians = cost_start(&o->train, load, cap);
    forecast_ahead(&o->train, 0, &none, cap, &gaussians);
    return gaussians;
}

OXL_INTERNAL int cost_judged_views(const oxl_scene *scene, int iterations)
{
    return OXL_MIN(OXL_MAX(iterations / COST_JUDGED, COST_JUDGED_MIN), schedule_training_views(scene));
}

OXL_INTERNAL int cost_evaluation_steps(const oxl_scene *scene, int iterations)
{
    const int training = schedule_training_views(scene), held_out = scene->view_count - training;
    return held_out > 0 ? COST_HELD_OUT * held_out + cost_judged_views(scene, iterations)
                        : COST_HELD_OUT * training;
}

/* ---------------- seconds */

/* Makes steps on black images of some views, which change nothing. Returns the seconds of the median one. */
static oxl_result cost_time_steps(oxl_context *ctx, const oxl_scene *scene, struct trained_model *trained,
                                  double *seconds)
{
    const double started = os_seconds();
    const int views = scene->view_count;
    struct renderer *renderer = NULL;
    oxl_adam still = {.beta = RENDERER_BETAS, .step = 1};
    struct renderer_loss loss;
    struct renderer_nonfinite skipped;
    oxl_render_options render = render_options_of(scene);
    double took[COST_STEPS];
    int steps = 0;
    oxl_result rc = renderer_create(ctx, &renderer);
    while (rc == OXL_OK && steps < COST_STEPS && os_seconds() - started < COST_TIMED_SECONDS) {
        const oxl_camera *c = &scene->view[(int)((double)steps / COST_STEPS * views)].camera;
        float *image = oxl_calloc(ctx, 3 * (size_t)c->width * c->height, sizeof *image);
        took[steps] = os_seconds();
        rc = image ? renderer_forward(ctx, renderer, &trained->model, c, &render) : OXL_ERR_MEMORY;
        if (rc == OXL_OK) rc = renderer_loss(ctx, renderer, image, NULL, 0.2f, &loss);
        if (rc == OXL_OK) rc = renderer_backward(ctx, renderer, NULL, NULL);
        if (rc == OXL_OK) rc = renderer_step(ctx, renderer, trained, NULL, &still, &skipped);
        took[steps] = os_seconds() - took[steps];
        steps++;
        oxl_free(ctx, image);
    }
    if (rc == OXL_OK) *seconds = stats_select(took, (size_t)steps, 0.5);
    renderer_free(ctx, renderer);
    return rc;
}

OXL_INTERNAL oxl_result cost_seconds(oxl_context *ctx, const oxl_scene *scene, const oxl_job_options *o,
                                     double *seconds)
{
    const struct cost_load load = cost_load_of_scene(scene);
    const double cap = (double)schedule_gaussian_cap(scene, &o->train);
    struct trained_model trained = {0};
    double gaussians = cost_start(&o->train, &load, cap);
    const oxl_camera *c = &scene->view[0].camera;
    oxl_point *some = NULL;
    size_t count = 0;
    oxl_result rc = train_some_points(ctx, scene, COST_POINTS, &some, &count);
    const double work = forecast_ahead(&o->train, 0, c, cap, &gaussians);
    if (rc == OXL_OK) rc = oxl_model_from_points(ctx, some, count, 3, &trained.model);
    if (rc == OXL_OK) rc = model_trained_begin(ctx, &trained);
    if (rc == OXL_OK) rc = cost_time_steps(ctx, scene, &trained, seconds);
    if (rc == OXL_OK) *seconds *= work / forecast_step(c, (double)trained.model.count, 0);
    if (o->train.max_seconds > 0) *seconds = OXL_MIN(*seconds, o->train.max_seconds);
    model_trained_free(ctx, &trained);
    oxl_free(ctx, some);
    return rc;
}

/* synth.c - a procedural underwater survey with known truth, as a COLMAP text export.
 *
 *     images/IMG_00000.png ...                images: through water, with the sensor's noise
 *     sparse/0/{cameras,images,points3D}.txt  the poses and a sparse cloud with tracks
 *     truth/clean, truth/depth                the same images without water and noise; camera z in metres
 *     truth/water.txt, truth/model.txt        the water's coefficients; description of the world and of these files
 *     truth/exposure.txt, truth/lamp.txt      with --exposure-jitter, --stereo and --lamp: what was applied
 *
 * Water: I = J exp(-bD z) + Binf (1 - exp(-bB z)) for each channel (Akkaynak & Treibitz 2018), z the range
 * along the ray.
 * Invariant: an image is that formula on clean and depth, pixel by pixel, plus noise and rounding: nothing
 * else, but for exposure and lamp.
 * The same options give the same files with any number of threads.
 */
#include "synth.h"

#include <stdlib.h>
#include <string.h>

#ifdef _OPENMP
#include <omp.h>
#endif

/* display values: pixels that differ more from a neighbour are rendered from four rays */
#define EDGE_COLOUR 0.10
#define EDGE_DEPTH 0.02 /* fraction of the depth */

/* ---------------- options */

/* Checks what the table of options does not know. */
static oxl_result synth_check(oxl_context *ctx, const synth_options *o)
{
    if (!o->out[0] || strlen(o->out) > 900)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "synth: the folder's name has no or more than 900 letters\nfix: -o FOLDER");
    if (o->lamp < 0 && o->backscatter > 0)
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "synth: backscatter needs a lamp, whose power is 0 to 2\nfix: --lamp 1");
    for (int k = 0; k < 3; k++)
        if (fabs(o->origin[k]) > 8e6)
            return oxl_fail(ctx, OXL_ERR_USAGE,
                            "synth: the origin can lie 8000 km off\nfix: a smaller --origin");
    return OXL_OK;
}

/* ---------------- water */

/* Lists the attenuation per metre of Jerlov's water types (Akkaynak & Treibitz 2018, as in algorithm.md);
 * backscatter changes from blue in the ocean to green and brown at the coast. */
static const struct synth_water synth_waters[] = {
    /* by enum synth_type */
    {"none", {0, 0, 0}, {0, 0, 0}},
    {"I", {.163, .040, .018}, {.06, .27, .52}},
    {"IA", {.174, .046, .025}, {.06, .28, .51}},
    {"IB", {.186, .051, .033}, {.06, .30, .50}},
    {"II", {.223, .078, .062}, {.07, .34, .48}},
    {"III", {.288, .122, .117}, {.08, .39, .46}},
    {"1C", {.288, .122, .134}, {.10, .42, .43}},
    {"3C", {.342, .198, .223}, {.12, .44, .38}},
    {"5C", {.400, .315, .400}, {.15, .45, .33}},
    {"7C", {.478, .494, .693}, {.18, .43, .27}},
    {"9C", {.598, .777, 1.24}, {.22, .40, .20}},
};

/* ---------------- images */

/* Renders one ray; *depth gets the camera z, 0 when there is only water. width: that of the ray in pixels. */
static v3 synth_trace(const struct synth_run *s, const struct synth_camera *c, double x, double y,
                      double width, float *depth)
{
    static const v3 far_off = {0.08, 0.32, 0.45};
    const v3 ray = synth_pixel_ray(c, x, y);
    const double range = synth_cast(&s->world, c->centre, ray, SYNTH_FAR);
    if (depth) *depth = range < 0 ? 0 : (float)(range * v3_dot(c->rotation[2], ray));
    if (range >= 0) return synth_shade(&s->world, v3_along(c->centre, ray, range), width * range / c->f);
    return s->water.veil.y > 0 ? s->water.veil : far_off;
}

static v3 synth_pixel(const oxl_image *image, size_t at)
{
    const size_t plane = (size_t)image->width * image->height;
    return v3_of(image->rgb[at], image->rgb[at + plane], image->rgb[at + 2 * plane]);
}

static void synth_set(oxl_image *image, size_t at, v3 colour)
{
    const size_t plane = (size_t)image->width * image->height;
    image->rgb[at] = (float)colour.x;
    image->rgb[at + plane] = (float)colour.y;
    image->rgb[at + 2 * plane] = (float)colour.z;
}

/* Renders one ray through the middle of each pixel, into `image` for now: it is also the truth for depth. */
static void synth_draw_row(struct synth_run *s, const struct synth_camera *c, int y)
{
    for (int x = 0; x < c->width; x++) {
        const size_t at = (size_t)y * c->width + (size_t)x;
        synth_set(&s->image, at, synth_trace(s, c, x + 0.5, y + 0.5, 1, &s->depth[at]));
    }
}

static int synth_differs(const struct synth_run *s, size_t a, size_t b)
{
    const v3 step = v3_sub(synth_pixel(&s->image, a), synth_pixel(&s->image, b));
    const float za = s->depth[a], zb = s->depth[b];
    return fabsf(za - zb) > EDGE_DEPTH * (za + zb) || fabsf((float)step.x) > EDGE_COLOUR ||
           fabsf((float)step.y) > EDGE_COLOUR || fabsf((float)step.z) > EDGE_COLOUR;
}

/* Renders the clean image: where neighbours differ, the mean of four rays, the one that is there among
 * them. */
static void synth_smooth_row(struct synth_run *s, const struct synth_camera *c, int y)
{
    static const double around[3][2] = {{0.50, 0.12}, {0.83, 0.69}, {0.17, 0.69}};
    const size_t width = (size_t)c->width;
    for (int x = 0; x < c->width; x++) {
        const size_t at = (size_t)y * width + (size_t)x;
        v3 colour = synth_pixel(&s->image, at);
        const int edge = (x > 0 && synth_differs(s, at, at - 1)) ||
                         (x + 1 < c->width && synth_differs(s, at, at + 1)) ||
                         (y > 0 && synth_differs(s, at, at - width)) ||
                         (y + 1 < c->height && synth_differs(s, at, at + width));
        if (edge && s->depth[at] > 0) { /* where only water is, no range would dim what is mixed in */
            for (int k = 0; k < 3; k++)
                colour = v3_add(colour, synth_trace(s, c, x + around[k][0], y + around[k][1], 0.5, NULL));
            colour = v3_scale(colour, 0.25);
        }
        synth_set(&s->clean, at, colour);
    }
}

/* Returns the range along the ray of a pixel's middle. */
static double synth_range(const struct synth_run *s, const struct synth_camera *c, int x, int y)
{
    return s->depth[(size_t)y * c->width + (size_t)x] *
           hypot(1, hypot((x + 0.5 - c->cx) / c->f, (y + 0.5 - c->cy) / c->f));
}

/* Lights a pixel's clean colour by the lamp, sends it through water, adds backscatter, applies the image's gain,
 * the lamp's, noise, and the rounding to 8 bits, so that colours picked from it are those in the file. */
static void synth_expose(struct synth_run *s, const struct synth_camera *c, int view, v3 gain, int x, int y)
{
    const synth_options *o = s->options;
    const v3 direct = s->water.direct;
    const size_t at = (size_t)y * o->width + (size_t)x;
    const double range = synth_range(s, c, x, y);
    const v3 seen = synth_through_water(
        &s->water, v3_scale(synth_pixel(&s->clean, at), synth_lamp_falloff(o, range)), range);
    const v3 near = v3_of(synth_lamp_backscatter(o, direct.x, x + 0.5, y + 0.5, range),
                          synth_lamp_backscatter(o, direct.y, x + 0.5, y + 0.5, range),
                          synth_lamp_backscatter(o, direct.z, x + 0.5, y + 0.5, range));
    const v3 exposed = v3_scale(v3_times(v3_add(seen, near), gain), synth_lamp_radial(o, x + 0.5, y + 0.5));
    double level[3] = {255 * exposed.x, 255 * exposed.y, 255 * exposed.z};
    for (size_t k = 0; k < 3; k++) {
        if (o->noise > 0)
            level[k] +=
                o->noise * synth_random_normal(synth_bits(o->seed ^ 0x5e25, (uint64_t)view, 3 * at + k));
        level[k] = floor(synth_clamp(level[k], 0, 255) + 0.5) / 255;
    }
    synth_set(&s->image, at, v3_of(level[0], level[1], level[2]));
}

static void synth_expose_row(struct synth_run *s, const struct synth_camera *c, int view, int y)
{
    const v3 gain = synth_gain(s->options, view);
    for (int x = 0; x < c->width; x++) synth_expose(s, c, view, gain, x, y);
}

static oxl_result synth_write_image(struct synth_run *s, const char *folder, int view, const oxl_image *image)
{
    char name[32], path[1024];
    synth_image_name(s->options, view, name);
    snprintf(path, sizeof path, "%s/%s/%s", s->options->out, folder, name);
    return (image->weight ? oxl_image_write_alpha : oxl_image_write)(s->ctx, path, image);
}

/* Makes the image opaque within options.alpha of the vertical axis through the centre; beyond, and where no
 * surface is, transparent and black, as programs that cut out an object leave it. */
static void synth_cut_out(struct synth_run *s, const struct synth_camera *c)
{
    const size_t width = (size_t)c->width;
    for (size_t at = 0; at < width * (size_t)c->height; at++) {
        const int x = (int)(at % width), y = (int)(at / width);
        const double range = synth_range(s, c, x, y);
        const v3 p = v3_along(c->centre, synth_pixel_ray(c, x + 0.5, y + 0.5), range);
        s->image.weight[at] = range > 0 && hypot(p.x, p.y) <= s->options->alpha;
        if (!(s->image.weight[at] > 0)) synth_set(&s->image, at, v3_of(0, 0, 0));
    }
}

static oxl_result synth_write_depth(struct synth_run *s, int view)
{
    char name[32], path[1024];
    synth_image_name(s->options, view, name);
    name[strlen(name) - 4] = 0; /* .png */
    snprintf(path, sizeof path, "%s/truth/depth/%s.pfm", s->options->out, name);
    return oxl_write_pfm(s->ctx, path, s->depth, s->options->width, s->options->height);
}

static oxl_result synth_view(struct synth_run *s, int view)
{
    const struct synth_camera *c = &s->trajectory.camera[view];
    oxl_result rc;
#pragma omp parallel for schedule(dynamic, 2)
    for (int y = 0; y < c->height; y++) synth_draw_row(s, c, y);
#pragma omp parallel for schedule(dynamic, 2)
    for (int y = 0; y < c->height; y++) synth_smooth_row(s, c, y);
#pragma omp parallel for schedule(dynamic, 2)
    for (int y = 0; y < c->height; y++) synth_expose_row(s, c, view, y);
    synth_points_collect(&s->points, view, &s->image);
    if (s->options->alpha > 0) synth_cut_out(s, c);
    rc = synth_write_image(s, synth_image_folder(s->options, view), view, &s->image);
    if (rc == OXL_OK) rc = synth_write_image(s, "truth/clean", view, &s->clean);
    return rc == OXL_OK ? synth_write_depth(s, view) : rc;
}

/* Gives the image the memory of its alpha from the library, which frees it. */
static oxl_result synth_reserve_weight(struct synth_run *s)
{
    oxl_image other;
    const oxl_result rc = oxl_image_create(s->ctx, s->options->width, s->options->height, &other);
    if (rc == OXL_OK) s->image.weight = other.rgb; /* of three planes the first is used */
    return rc;
}

static oxl_result synth_make_images(struct synth_run *s)
{
    const synth_options *o = s->options;
    oxl_result rc = oxl_image_create(s->ctx, o->width, o->height, &s->image);
    if (rc == OXL_OK) rc = oxl_image_create(s->ctx, o->width, o->height, &s->clean);
    s->depth = malloc((size_t)o->width * o->height * sizeof *s->depth);
    if (rc == OXL_OK && o->alpha > 0) rc = synth_reserve_weight(s);
    return rc == OXL_OK && s->depth ? OXL_OK
                                    : oxl_fail(s->ctx, OXL_ERR_MEMORY, "synth: no memory for an image");
}

static oxl_result synth_views(struct synth_run *s)
{
    const synth_options *o = s->options;
    oxl_result rc = synth_make_images(s);
    for (int i = 0; i < o->views && rc == OXL_OK; i++) {
        rc = synth_view(s, i);
        if (rc == OXL_OK && o->progress && o->progress(o->user, "images", i + 1, o->views))
            rc = oxl_fail(s->ctx, OXL_ERR_INTERRUPTED, "synth: stopped");
    }
    return rc;
}

/* ---------------- the run */

/* Refuses OUT where it holds a survey, or a folder of one, that synth did not write. */
static oxl_result synth_check_own(const struct synth_run *s)
{
    static const char *const others[] = {"images",
                                         "sparse",
                                         "truth",
                                         "train",
                                         "test",
                                         "transforms_train.json",
                                         "poses_bounds.npy",
                                         "transforms.json",
                                         "cameras.txt",
                                         "reconstruction.json",
                                         "cameras.bin"};
    static const char mark[] = "A made-up seabed, ";
    char path[1024], *model = output_read(s->options->out, "truth/model.txt");
    const int is_own = model && strncmp(model, mark, strlen(mark)) == 0;
    free(model);
    for (size_t i = is_own ? 7 : 0; i < sizeof others / sizeof *others; i++) {
        FILE *file;
        snprintf(path, sizeof path, "%s/%s", s->options->out, others[i]);
        file = oxl_open(path);
        if (file) fclose(file);
        if (file || oxl_is_folder(path))
            return oxl_fail(
                s->ctx, OXL_ERR_USAGE,
                "%s is there, and synth did not write it\nfix: another folder by -o, or move this "
                "one away",
                path);
    }
    return OXL_OK;
}

/* Makes the folders, and removes the survey of the run before, whose images would belong to other poses. */
static oxl_result synth_make_folders(struct synth_run *s)
{
    static const char *const images[] = {"images", "train", "test"};
    const synth_options *o = s->options;
    const char *const folders[] = {"truth",
                                   o->layout == SYNTH_NERF ? "truth" : "sparse/0",
                                   synth_image_folder(o, 0),
                                   synth_image_folder(o, 1),
                                   "truth/clean",
                                   "truth/depth"};
    char path[1024], name[32];
    oxl_result rc = OXL_OK;
    for (int i = 0; i < (o->write_images ? 6 : 2) && rc == OXL_OK; i++) {
        snprintf(path, sizeof path, "%s/%s", o->out, folders[i]);
        rc = oxl_make_folder(s->ctx, path);
    }
    if (rc == OXL_OK) rc = synth_write_model(s);
    if (rc != OXL_OK) return rc;
    synth_remove_files(o);
    for (int i = 0, there = 1; there; i++) {
        synth_image_name(o, i, name);
        there = 0;
        for (int k = 0; k < 3; k++) {
            snprintf(path, sizeof path, "%s/%s/%s", o->out, images[k], name);
            there |= oxl_remove(path) == 0;
        }
    }
    return OXL_OK;
}

static oxl_result synth_make_points(struct synth_run *s)
{
    const oxl_result rc = synth_points_create(s, &s->points);
    if (rc == OXL_ERR_INTERRUPTED) return oxl_fail(s->ctx, rc, "synth: stopped");
    return rc == OXL_OK ? rc : oxl_fail(s->ctx, rc, "synth: no memory for the points\nfix: fewer --points");
}

/* Makes the dive a second one to the same world: other cameras and noise, another sun, and perhaps changes. */
static int synth_dive_again(struct synth_run *s)
{
    const struct synth_trajectory first = s->trajectory;
    struct synth_trajectory *second = &s->trajectory;
    s->again = *s->options;
    s->again.seed = synth_bits(s->options->seed, 77, 1);
    s->options = &s->again;
    if (!synth_trajectory_create(&s->again, second)) {
        *second = first;
        return 0;
    }
    second->half = first.half;
    free(first.camera);
    s->world.sun = v3_unit(v3_of(-0.5, 0.35, 0.8));
    if (s->again.change == SYNTH_CHANGED) synth_world_change(&s->world, s->change);
    return 1;
}

static oxl_result synth_make(struct synth_run *s)
{
    const synth_options *o = s->options;
    oxl_result rc = synth_check(s->ctx, o);
    if (rc == OXL_OK) rc = synth_check_own(s);
    if (rc != OXL_OK) return rc;
    s->water = synth_waters[o->water];
    if (!synth_trajectory_create(o, &s->trajectory) ||
        !synth_world_create(o->seed, s->trajectory.half, &s->world))
        return oxl_fail(s->ctx, OXL_ERR_MEMORY,
                        "synth: no memory for the world\nfix: a smaller --extent or fewer --views");
    s->world.sand_contrast = o->sand_contrast;
    if (o->change && !synth_dive_again(s)) return oxl_fail(s->ctx, OXL_ERR_MEMORY, "synth: no memory");
    synth_trajectory_set_heights(&s->trajectory, &s->world);
    rc = synth_make_folders(s);
    if (rc == OXL_OK) rc = synth_make_points(s);
    if (rc == OXL_OK && o->write_images) rc = synth_views(s);
    return rc == OXL_OK ? synth_write_files(s) : rc;
}

oxl_result synth_run(oxl_context *ctx, const synth_options *options)
{
    struct synth_run s = {.ctx = ctx, .options = options};
    oxl_result rc;
#ifdef _OPENMP
    const int threads = omp_get_max_threads();
    if (options->threads > 0) omp_set_num_threads(options->threads);
#endif
    rc = synth_make(&s);
    oxl_image_free(ctx, &s.image);
    oxl_image_free(ctx, &s.clean);
    free(s.depth);
    synth_points_free(&s.points);
    synth_world_free(&s.world);
    synth_trajectory_free(&s.trajectory);
#ifdef _OPENMP
    omp_set_num_threads(threads);
#endif
    return rc;
}

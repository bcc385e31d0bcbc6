/* ideal_camera.c - finds the pinhole camera of the undistorted images of a survey's camera.
 *
 * Invariant: all pixels of an undistorted camera lie inside the field of view of the real one. A distortion
 * polynomial is not monotonic beyond some radius; directions beyond it are outside the field of view.
 */
#include "survey_read.h"

enum {
    CAMERA_SIDE_MAX = 32768, /* px; greatest side, as of images */
    CAMERA_SIDE_MIN = 16,    /* px; least side of an undistorted image */
    CAMERA_RAYS = 128,       /* rays towards each side of the image */
    CAMERA_STEPS = 32,       /* steps along a ray to the first direction outside the field of view */
    CAMERA_SHRINK = 64       /* px; most by which a side is corrected at the end */
};
#define CAMERA_PX_MAX 1e9 /* Bounds plausible focal lengths and principal points (px). */
/* Bounds focal lengths from below, in longer sides of the image: 179.5 degrees. */
#define CAMERA_FOCAL_MIN 0.002
/* Limits the distance of a side from the principal point, relative to the image's;
 * COLMAP uses the same limit. */
#define CAMERA_GROWTH 2.0

/* Sides of an image: 2 axis for the lower end of an axis, x or y, and 2 axis + 1 for the upper one. */
enum { CAMERA_SIDES = 4, CAMERA_FOLD = 4, CAMERA_OPEN };

/* Returns 1 if the direction is inside the field of view: its pixel is within the centres of the outermost
 * pixels, and the polynomial is monotonic there. */
static int camera_in_field(const struct colmap_camera *camera, const double direction[2], double pixel[2])
{
    const double farther[2] = {direction[0] * 1.001, direction[1] * 1.001};
    const int size[2] = {camera->width, camera->height};
    double k[4], beyond[2], r2 = 0, beyond2 = 0;
    int is_inside = 1;
    camera_intrinsics(camera, k);
    camera_distort(camera, direction, pixel);
    camera_distort(camera, farther, beyond);
    for (int a = 0; a < 2; a++) {
        r2 += (pixel[a] - k[2 + a]) * (pixel[a] - k[2 + a]);
        beyond2 += (beyond[a] - k[2 + a]) * (beyond[a] - k[2 + a]);
        is_inside &= pixel[a] >= 0.5 && pixel[a] <= size[a] - 0.5;
    }
    return is_inside && beyond2 > r2;
}

/* Steps from the axis towards `target`, then bisects; `end` receives the limit of the field of view. Returns
 * the side that is the limit, CAMERA_FOLD for the polynomial, CAMERA_OPEN if there is none. */
static int camera_trace(const struct colmap_camera *camera, const double target[2], double end[2])
{
    const int size[2] = {camera->width, camera->height};
    double pixel[2], good = 0, bad = 0;
    for (int i = 1, halvings = 40; bad > 0 ? halvings-- > 0 : i <= CAMERA_STEPS; i++) {
        const double t = bad > 0 ? 0.5 * (good + bad) : i * (1.0 / CAMERA_STEPS),
                     direction[2] = {t * target[0], t * target[1]};
        if (camera_in_field(camera, direction, pixel)) good = t;
        else bad = t;
    }
    if (bad == 0) return CAMERA_OPEN;
    for (int a = 0; a < 2; a++) end[a] = bad * target[a];
    camera_distort(camera, end, pixel);
    for (int a = 0; a < 2; a++) {
        if (pixel[a] < 0.5) return 2 * a;
        if (pixel[a] > size[a] - 0.5) return 2 * a + 1;
    }
    return CAMERA_FOLD;
}

/* Measures the distance in px from the principal point to each side of a rectangle inside the field of view.
 * A side moves inwards if the image's border is the limit; all four sides move inwards by the same factor if
 * the polynomial is, whose limit is a curve around the axis. */
static void camera_rectangle(const struct colmap_camera *camera, double side[CAMERA_SIDES])
{
    const double size[2] = {camera->width, camera->height};
    double k[4], folded = 1, fold_at[4 * CAMERA_RAYS][2];
    int folds = 0;
    camera_intrinsics(camera, k);
    for (int s = 0; s < CAMERA_SIDES; s++)
        side[s] = CAMERA_GROWTH * (s % 2 ? size[s / 2] - k[2 + s / 2] : k[2 + s / 2]);
    for (int i = 0; i < 4 * CAMERA_RAYS; i++) {
        const double along = (i / 4 + 0.5) / CAMERA_RAYS; /* a point on the image's border */
        const double x = (i % 4 < 2 ? along : i % 4 - 2) * size[0] - k[2];
        const double y = (i % 4 < 2 ? i % 4 : along) * size[1] - k[3];
        double end[2], target[2] = {CAMERA_GROWTH * x / k[0], CAMERA_GROWTH * y / k[1]};
        const int s = camera_trace(camera, target, end);
        if (s < CAMERA_SIDES) side[s] = OXL_MIN(side[s], (s % 2 ? 1 : -1) * k[s / 2] * end[s / 2]);
        for (int a = 0; a < 2 && s == CAMERA_FOLD; a++) fold_at[folds][a] = k[a] * end[a];
        folds += s == CAMERA_FOLD;
    }
    for (int i = 0; i < folds; i++) {
        double most = 0;
        for (int a = 0; a < 2; a++) {
            const double at = fold_at[i][a], part = at < 0 ? -at / side[2 * a] : at / side[2 * a + 1];
            most = OXL_MAX(most, part);
        }
        folded = OXL_MIN(folded, most);
    }
    for (int s = 0; s < CAMERA_SIDES; s++) side[s] *= folded;
}

/* Rounds to whole pixels and divides the remainder between both sides. */
static void camera_round(const double side[CAMERA_SIDES], oxl_camera *c)
{
    int *const size[2] = {&c->width, &c->height};
    double *const centre[2] = {&c->cx, &c->cy};
    for (int a = 0; a < 2; a++) {
        const double sum = side[2 * a] + side[2 * a + 1];
        *size[a] = (int)OXL_CLAMP(sum, 0, 2 * CAMERA_SIDE_MAX);
        *centre[a] = side[2 * a] - 0.5 * (sum - *size[a]);
    }
}

/* Checks all border pixels, and removes a row or column of pixels from each side that has one outside the
 * field of view. Returns 1 if there was none. */
static int camera_shrink(const struct colmap_camera *camera, const oxl_camera *c, double side[CAMERA_SIDES])
{
    int is_whole = 1;
    for (int s = 0; s < CAMERA_SIDES; s++) {
        const int length = s < 2 ? c->height : c->width, last = (s < 2 ? c->width : c->height) - 1;
        int bad = 0;
        for (int i = 0; i < length && !bad; i++) {
            const int at = s % 2 ? last : 0, x = s < 2 ? at : i, y = s < 2 ? i : at;
            const double direction[2] = {(x + 0.5 - c->cx) / c->fx, (y + 0.5 - c->cy) / c->fy};
            double pixel[2];
            bad = !camera_in_field(camera, direction, pixel);
        }
        side[s] -= bad;
        is_whole &= !bad;
    }
    return is_whole;
}

OXL_INTERNAL int camera_focal_is_plausible(double focal, double width, double height)
{
    const double sides = focal / OXL_MAX(width, height);
    return sides >= 0.2 && sides <= 20;
}

/* Fails at the camera's line: "camera ID (MODEL) TEXT". */
static oxl_result camera_fail(oxl_context *ctx, const struct colmap_camera *camera, const char *format, ...)
    OXL_PRINTF(3, 4);
static oxl_result camera_fail(oxl_context *ctx, const struct colmap_camera *camera, const char *format, ...)
{
    char text[400];
    va_list args;
    va_start(args, format);
    vsnprintf(text, sizeof text, format, args);
    va_end(args);
    return oxl_fail(ctx, OXL_ERR_INPUT, "%s:%d: camera %lld (%s) %s", camera->file, camera->line,
                    (long long)camera->id, camera_model_at(camera->model)->name, text);
}

static oxl_result camera_check(oxl_context *ctx, const struct colmap_camera *camera, const double k[4])
{
    const double w = camera->width, h = camera->height, least = CAMERA_FOCAL_MIN * OXL_MAX(w, h);
    if (camera_model_at(camera->model)->kind == CAMERA_SPHERE)
        return camera_fail(
            ctx, camera,
            "is a 360-degree camera, expected a perspective or fisheye camera\n"
            "fix: cut its images into perspective ones and align those: COLMAP's python/examples/panorama_sfm.py");
    if (!(w >= 1 && h >= 1 && w <= CAMERA_SIDE_MAX && h <= CAMERA_SIDE_MAX))
        return camera_fail(ctx, camera,
                           "is %.0f x %.0f px, expected 1 to %d a side\nfix: export the model again", w, h,
                           CAMERA_SIDE_MAX);
    for (int a = 0; a < 2; a++) {
        const double centre = k[2 + a];
        if (!(k[a] >= least && k[a] <= CAMERA_PX_MAX))
            return camera_fail(ctx, camera,
                               "has the focal length %g, %g px, expected %g (half a turn of view) to 1e9\n"
                               "fix: check the order of the parameters",
                               k[0], k[1], least);
        if (!(fabs(centre) <= CAMERA_PX_MAX) ||
            (camera_is_distorted(camera) && !(centre > 0 && centre < (a ? h : w))))
            return camera_fail(
                ctx, camera,
                "has its principal point at %g, %g, outside of its %.0f x %.0f px, and is distorted or "
                "beyond 1e9 px\nfix: export the model again; or run COLMAP's image_undistorter and "
                "use what it writes",
                k[2], k[3], w, h);
    }
    return OXL_OK;
}

OXL_INTERNAL oxl_result camera_undistorted(oxl_context *ctx, const struct colmap_camera *camera,
                                           oxl_camera *out)
{
    double k[4], side[4];
    oxl_result rc;
    *out = (oxl_camera){0};
    camera_intrinsics(camera, k);
    rc = camera_check(ctx, camera, k);
    if (rc != OXL_OK) return rc;
    *out = (oxl_camera){
        .width = camera->width, .height = camera->height, .fx = k[0], .fy = k[1], .cx = k[2], .cy = k[3]};
    if (!camera_is_distorted(camera)) return OXL_OK;
    camera_rectangle(camera, side);
    for (int i = 0; i < CAMERA_SHRINK; i++) {
        camera_round(side, out);
        if (out->width < CAMERA_SIDE_MIN || out->height < CAMERA_SIDE_MIN) break;
        if (camera_shrink(camera, out, side)) return OXL_OK;
    }
    *out = (oxl_camera){0};
    return camera_fail(ctx, camera,
                       "has a distortion that leaves no image of %d x %d px or more without blank pixels\n"
                       "fix: check its parameters, or run COLMAP's image_undistorter and use what it writes",
                       CAMERA_SIDE_MIN, CAMERA_SIDE_MIN);
}

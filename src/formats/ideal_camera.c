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

enum camera_side { CAMERA_LEFT, CAMERA_RIGHT, CAMERA_TOP, CAMERA_BOTTOM, CAMERA_FOLD };

/* Returns 1 if the direction is inside the field of view: its pixel is within the centres of the outermost
 * pixels, and the polynomial is monotonic there. */
static int camera_in_field(const struct colmap_camera *camera, const double direction[2], double pixel[2])
{
    const double farther[2] = {direction[0] * 1.001, direction[1] * 1.001};
    double k[4], beyond[2], r2, beyond2;
    camera_intrinsics(camera, k);
    camera_distort(camera, direction, pixel);
    camera_distort(camera, farther, beyond);
    r2 = (pixel[0] - k[2]) * (pixel[0] - k[2]) + (pixel[1] - k[3]) * (pixel[1] - k[3]);
    beyond2 = (beyond[0] - k[2]) * (beyond[0] - k[2]) + (beyond[1] - k[3]) * (beyond[1] - k[3]);
    return pixel[0] >= 0.5 && pixel[0] <= camera->width - 0.5 && pixel[1] >= 0.5 &&
           pixel[1] <= camera->height - 0.5 && beyond2 > r2;
}

/* Steps from the axis towards `target`, then bisects; `end` receives the limit of the field of view. Returns
 * the kind of limit; -1: there is none. */
static int camera_trace(const struct colmap_camera *camera, const double target[2], double end[2])
{
    double pixel[2], good = 0, bad = 0;
    for (int i = 1; i <= CAMERA_STEPS && bad == 0; i++) {
        const double t = i * (1.0 / CAMERA_STEPS), direction[2] = {t * target[0], t * target[1]};
        if (camera_in_field(camera, direction, pixel)) good = t;
        else bad = t;
    }
    if (bad == 0) return -1;
    for (int i = 0; i < 40; i++) {
        const double t = 0.5 * (good + bad), direction[2] = {t * target[0], t * target[1]};
        if (camera_in_field(camera, direction, pixel)) good = t;
        else bad = t;
    }
    end[0] = bad * target[0];
    end[1] = bad * target[1];
    camera_distort(camera, end, pixel);
    if (pixel[0] < 0.5) return CAMERA_LEFT;
    if (pixel[0] > camera->width - 0.5) return CAMERA_RIGHT;
    if (pixel[1] < 0.5) return CAMERA_TOP;
    if (pixel[1] > camera->height - 0.5) return CAMERA_BOTTOM;
    return CAMERA_FOLD;
}

/* Measures the distance in px from the principal point to each side of a rectangle inside the field of view.
 * A side moves inwards if the image's border is the limit; all four sides move inwards by the same factor if
 * the polynomial is, whose limit is a curve around the axis. */
static void camera_rectangle(const struct colmap_camera *camera, double side[4])
{
    double k[4], folded = 1, fold_at[4 * CAMERA_RAYS][2];
    int folds = 0;
    const double w = camera->width, h = camera->height;
    camera_intrinsics(camera, k);
    side[CAMERA_LEFT] = CAMERA_GROWTH * k[2];
    side[CAMERA_RIGHT] = CAMERA_GROWTH * (w - k[2]);
    side[CAMERA_TOP] = CAMERA_GROWTH * k[3];
    side[CAMERA_BOTTOM] = CAMERA_GROWTH * (h - k[3]);
    for (int i = 0; i < 4 * CAMERA_RAYS; i++) {
        const double along = (i / 4 + 0.5) / CAMERA_RAYS;
        /* (x, y): a point on the image's border, from the principal point */
        const double x = (i % 4 < 2 ? along : i % 4 - 2) * w - k[2];
        const double y = (i % 4 < 2 ? i % 4 : along) * h - k[3];
        double end[2], target[2] = {CAMERA_GROWTH * x / k[0], CAMERA_GROWTH * y / k[1]};
        switch (camera_trace(camera, target, end)) {
        case CAMERA_LEFT: side[CAMERA_LEFT] = OXL_MIN(side[CAMERA_LEFT], -k[0] * end[0]); break;
        case CAMERA_RIGHT: side[CAMERA_RIGHT] = OXL_MIN(side[CAMERA_RIGHT], k[0] * end[0]); break;
        case CAMERA_TOP: side[CAMERA_TOP] = OXL_MIN(side[CAMERA_TOP], -k[1] * end[1]); break;
        case CAMERA_BOTTOM: side[CAMERA_BOTTOM] = OXL_MIN(side[CAMERA_BOTTOM], k[1] * end[1]); break;
        case CAMERA_FOLD:
            fold_at[folds][0] = k[0] * end[0];
            fold_at[folds++][1] = k[1] * end[1];
            break;
        default: break;
        }
    }
    for (int i = 0; i < folds; i++) {
        const double x =
            fold_at[i][0] < 0 ? -fold_at[i][0] / side[CAMERA_LEFT] : fold_at[i][0] / side[CAMERA_RIGHT];
        const double y =
            fold_at[i][1] < 0 ? -fold_at[i][1] / side[CAMERA_TOP] : fold_at[i][1] / side[CAMERA_BOTTOM];
        folded = OXL_MIN(folded, OXL_MAX(x, y));
    }
    for (int i = 0; i < 4; i++) side[i] *= folded;
}

/* Rounds to whole pixels and divides the remainder between both sides. */
static void camera_round(const double side[4], oxl_camera *c)
{
    c->width = (int)OXL_CLAMP(side[CAMERA_LEFT] + side[CAMERA_RIGHT], 0, 2 * CAMERA_SIDE_MAX);
    c->height = (int)OXL_CLAMP(side[CAMERA_TOP] + side[CAMERA_BOTTOM], 0, 2 * CAMERA_SIDE_MAX);
    c->cx = side[CAMERA_LEFT] - 0.5 * (side[CAMERA_LEFT] + side[CAMERA_RIGHT] - c->width);
    c->cy = side[CAMERA_TOP] - 0.5 * (side[CAMERA_TOP] + side[CAMERA_BOTTOM] - c->height);
}

static int camera_covers_pixel(const struct colmap_camera *camera, const oxl_camera *c, int x, int y)
{
    const double direction[2] = {(x + 0.5 - c->cx) / c->fx, (y + 0.5 - c->cy) / c->fy};
    double pixel[2];
    return camera_in_field(camera, direction, pixel);
}

/* Checks all border pixels, and removes a row or column of pixels from each side that has one outside the
 * field of view. Returns 1 if there was none. */
static int camera_shrink(const struct colmap_camera *camera, const oxl_camera *c, double side[4])
{
    int bad[4] = {0, 0, 0, 0};
    for (int y = 0; y < c->height; y++) {
        bad[CAMERA_LEFT] |= !camera_covers_pixel(camera, c, 0, y);
        bad[CAMERA_RIGHT] |= !camera_covers_pixel(camera, c, c->width - 1, y);
    }
    for (int x = 0; x < c->width; x++) {
        bad[CAMERA_TOP] |= !camera_covers_pixel(camera, c, x, 0);
        bad[CAMERA_BOTTOM] |= !camera_covers_pixel(camera, c, x, c->height - 1);
    }
    for (int i = 0; i < 4; i++) side[i] -= bad[i];
    return !(bad[0] || bad[1] || bad[2] || bad[3]);
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
    if (!(k[0] >= least && k[0] <= CAMERA_PX_MAX && k[1] >= least && k[1] <= CAMERA_PX_MAX))
        return camera_fail(ctx, camera,
                           "has the focal length %g, %g px, expected %g (half a turn of view) to 1e9\n"
                           "fix: check the order of the parameters",
                           k[0], k[1], least);
    if (!(fabs(k[2]) <= CAMERA_PX_MAX && fabs(k[3]) <= CAMERA_PX_MAX) ||
        (camera_is_distorted(camera) && !(k[2] > 0 && k[2] < w && k[3] > 0 && k[3] < h)))
        return camera_fail(
            ctx, camera,
            "has its principal point at %g, %g, outside of its %.0f x %.0f px, and is distorted or "
            "beyond 1e9 px\nfix: export the model again; or run COLMAP's image_undistorter and "
            "use what it writes",
            k[2], k[3], w, h);
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

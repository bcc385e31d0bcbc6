/* reprojection.c - measures how far points project from where the images saw them.
 *
 * COLMAP's images list their 2D points, each with the point that it is of. Camera, pose and point of one
 * model agree to a pixel or two. A wrong focal length or distortion, a pose in another convention, or points
 * of another run are off by many, though they may still project inside the image, where lint.c sees nothing
 * wrong.
 *
 * Invariant: no check changes what is trained. A file that has become unreadable is left to other checks.
 */
#include "checks.h"
#include "../formats/survey_read.h"
#include "../survey/scene.h"
#include "../survey/sparse.h"
#include "../survey/survey.h"

enum {
    REPROJECTION_VIEWS = 64,     /* most images, evenly spaced */
    REPROJECTION_POINTS = 256,   /* most 2D points of an image */
    REPROJECTION_FEWEST = 12,    /* 2D points; an image with fewer is not judged */
    REPROJECTION_NAMED = 3,      /* images that are named */
    REPROJECTION_BYTES = 1 << 17 /* most bytes of an image's 2D points, from their beginning */
};
/* Bounds the factor by which images are reduced from below; a smaller one is a wrong focal length. */
#define REPROJECTION_REDUCED 1.25
#define REPROJECTION_PIXELS 4.0 /* Counts an image as wrong from this median error (px) on. */
/* Counts an image as wrong from this median error on, as a fraction of its longer side; the
 * larger of both limits holds. */
#define REPROJECTION_SIDE 0.004

enum reprojection_pose {
    REPROJECTION_AS_IS,
    REPROJECTION_XYZW,
    REPROJECTION_INVERSE,
    REPROJECTION_ROTATION, /* rotation transposed, translation as it is */
    REPROJECTION_CENTRE,   /* the camera's centre in the place of the translation */
    REPROJECTION_OPENGL,
    REPROJECTION_POSES
};
static const char *const reprojection_words[REPROJECTION_POSES] = {
    "",
    "the quaternions stand as x y z w, and w is wanted first",
    "the poses are camera to world, and world to camera is wanted",
    "the rotations are of camera to world, and world to camera is wanted",
    "the cameras' places stand as translations, and these are -R times the place",
    "the camera axes are those of OpenGL (y up, z back), and y down, z ahead is wanted"};

struct reprojection_view {
    int view, judged;
    double error[REPROJECTION_POSES]; /* px; median errors */
};

/* ---------------- errors */

/* Computes the pose, world to camera, that an image has if its file is in another convention. */
static void reprojection_convert(const struct colmap_image *image, enum reprojection_pose pose, double r[9],
                                 double t[3])
{
    const double *q = image->rotation, turned[4] = {q[3], q[0], q[1], q[2]};
    camera_rotation_from_quaternion(pose == REPROJECTION_XYZW ? turned : q, r);
    memcpy(t, image->translation, sizeof image->translation);
    for (int i = 0; i < 3 && (pose == REPROJECTION_INVERSE || pose == REPROJECTION_ROTATION); i++)
        for (int k = i + 1; k < 3; k++) {
            const double swapped = r[3 * i + k];
            r[3 * i + k] = r[3 * k + i], r[3 * k + i] = swapped;
        }
    for (int i = 0; i < 3 && (pose == REPROJECTION_INVERSE || pose == REPROJECTION_CENTRE); i++)
        t[i] = -(r[3 * i] * image->translation[0] + r[3 * i + 1] * image->translation[1] +
                 r[3 * i + 2] * image->translation[2]);
    for (int i = 1; i < 3 && pose == REPROJECTION_OPENGL; i++) {
        t[i] = -t[i];
        for (int k = 0; k < 3; k++) r[3 * i + k] = -r[3 * i + k];
    }
}

/* Projects the points to px of the camera; NaN: behind the camera. */
static void reprojection_project(const oxl_scene *scene, int view, enum reprojection_pose pose,
                                 const struct colmap_sighting *seen, int count, double (*pixel)[2])
{
    double r[9], t[3];
    reprojection_convert(scene_source_image(scene, view), pose, r, t);
    for (int i = 0; i < count; i++) {
        double x[3];
        for (int k = 0; k < 3; k++)
            x[k] = r[3 * k] * seen[i].world[0] + r[3 * k + 1] * seen[i].world[1] +
                   r[3 * k + 2] * seen[i].world[2] + t[k];
        pixel[i][0] = pixel[i][1] = NAN;
        if (x[2] > 0)
            camera_distort(scene_source_camera(scene, view), (double[2]){x[0] / x[2], x[1] / x[2]}, pixel[i]);
    }
}

/* Returns the median distance in px to the 2D points times `factor`; a point without a
 * projection counts as farthest. */
static double reprojection_median(const struct colmap_sighting *seen, int count, double (*pixel)[2],
                                  double factor)
{
    double error[REPROJECTION_POINTS];
    for (int i = 0; i < count; i++) {
        error[i] = hypot(pixel[i][0] - factor * seen[i].pixel[0], pixel[i][1] - factor * seen[i].pixel[1]);
        if (!(error[i] < DBL_MAX)) error[i] = DBL_MAX;
    }
    return stats_select(error, (size_t)count, 0.5);
}

/* Returns the median ratio of distances from the image's corner. Programs that reduce images write new
 * cameras, and often leave the 2D points as they were; resection leaves such poses (resect.c). */
static double reprojection_factor(const struct colmap_sighting *seen, int count, double (*pixel)[2])
{
    double ratio[REPROJECTION_POINTS];
    for (int i = 0; i < count; i++) {
        const double by = hypot(seen[i].pixel[0], seen[i].pixel[1]);
        ratio[i] = by > 0 ? hypot(pixel[i][0], pixel[i][1]) / by : 1;
        if (!(ratio[i] < DBL_MAX)) ratio[i] = 1;
    }
    return stats_select(ratio, (size_t)count, 0.5);
}

static double reprojection_limit(const oxl_scene *scene, int view)
{
    const struct colmap_camera *c = scene_source_camera(scene, view);
    return OXL_MAX(REPROJECTION_PIXELS, REPROJECTION_SIDE * (double)OXL_MAX(c->width, c->height));
}

static int reprojection_is_wrong(const oxl_scene *scene, const struct reprojection_view *v)
{
    return v->judged && v->error[REPROJECTION_AS_IS] > reprojection_limit(scene, v->view);
}

/* Computes the errors of an image as read, and in the other conventions if it is wrong as read. */
static void reprojection_judge(oxl_context *ctx, const oxl_scene *scene, struct colmap_sightings *from,
                               struct reprojection_view *v)
{
    struct colmap_sighting seen[REPROJECTION_POINTS];
    int count = 0;
    if (colmap_sightings_of(ctx, from, scene_source_image(scene, v->view)) != OXL_OK) return;
    while (count < REPROJECTION_POINTS && colmap_sightings_next(from, &seen[count])) count++;
    if (count < REPROJECTION_FEWEST) return;
    v->judged = 1;
    for (int k = 0; k < REPROJECTION_POSES && (k < 1 || reprojection_is_wrong(scene, v)); k++) {
        double pixel[REPROJECTION_POINTS][2], factor;
        reprojection_project(scene, v->view, (enum reprojection_pose)k, seen, count, pixel);
        v->error[k] = reprojection_median(seen, count, pixel, 1);
        factor = reprojection_factor(seen, count, pixel);
        if (factor < 1 / REPROJECTION_REDUCED || factor > REPROJECTION_REDUCED)
            v->error[k] = OXL_MIN(v->error[k], reprojection_median(seen, count, pixel, factor));
    }
}

/* ---------------- messages */

/* Returns the convention in which nine of ten wrong images are right; REPROJECTION_AS_IS: there is none. */
static enum reprojection_pose reprojection_guess(const oxl_scene *scene, const struct reprojection_view *v,
                                                 int count, int wrong)
{
    for (int k = REPROJECTION_AS_IS + 1; k < REPROJECTION_POSES; k++) {
        int right = 0;
        for (int i = 0; i < count; i++)
            right +=
                reprojection_is_wrong(scene, &v[i]) && v[i].error[k] <= reprojection_limit(scene, v[i].view);
        if (10 * right >= 9 * wrong) return (enum reprojection_pose)k;
    }
    return REPROJECTION_AS_IS;
}

/* Returns the id of the camera that all wrong images have and no other image; -1: there is none. */
static int64_t reprojection_camera(const oxl_scene *scene, const struct reprojection_view *v, int count)
{
    int64_t camera = -1;
    for (int i = 0; i < count; i++) {
        const int64_t id = scene_source_image(scene, v[i].view)->camera_id;
        if (!reprojection_is_wrong(scene, &v[i])) continue;
        if (camera >= 0 && id != camera) return -1;
        camera = id;
    }
    for (int i = 0; i < count; i++)
        if (v[i].judged && !reprojection_is_wrong(scene, &v[i]) &&
            scene_source_image(scene, v[i].view)->camera_id == camera)
            return -1;
    return camera;
}

static void reprojection_report(oxl_context *ctx, const oxl_scene *scene, const struct reprojection_view *v,
                                int count)
{
    int wrong = 0, judged = 0, named = 0;
    const struct reprojection_view *first = NULL;
    enum reprojection_pose pose;
    int64_t camera;
    for (int i = 0; i < count; i++) {
        judged += v[i].judged;
        if (!reprojection_is_wrong(scene, &v[i])) continue;
        if (!first) first = &v[i];
        wrong++;
    }
    if (!first) return;
    pose = reprojection_guess(scene, v, count, wrong);
    camera = reprojection_camera(scene, v, count);
    if (pose != REPROJECTION_AS_IS || 10 * wrong >= 9 * judged || camera >= 0)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "points project %s px from where %d of %d images saw them (%s, median)%s%s%s\n"
            "fix: %s",
            first->error[0] < 1e6 ? NUMBER(floor(first->error[0] + 0.5)) : "far more than 1000", wrong,
            judged, oxl_scene_view(scene, first->view)->name, pose ? ": " : "", reprojection_words[pose],
            camera >= 0 && wrong < judged ? ": the same camera took all of these and no other" : "",
            pose ? "write the poses as COLMAP does"
            : camera >= 0 && wrong < judged
                ? "look at its focal length and distortion in the file of cameras"
                : "take cameras, images and points3D of one model; one wrong focal length or distortion of all images looks the same");
    else
        for (int i = 0; i < count && named <= REPROJECTION_NAMED; i++)
            if (reprojection_is_wrong(scene, &v[i]) && named++ < REPROJECTION_NAMED)
                oxl_log(
                    ctx, OXL_LOG_WARNING,
                    "%s: points project far from where this image saw them (by a median of %s px), so its "
                    "pose or camera is wrong\n"
                    "fix: take it out of the model: colmap image_deleter",
                    oxl_scene_view(scene, v[i].view)->name,
                    v[i].error[0] < 1e6 ? NUMBER(floor(v[i].error[0] + 0.5)) : "more than 1000");
}

OXL_INTERNAL oxl_result reprojection_check(oxl_context *ctx, const oxl_scene *scene)
{
    const struct colmap *c = scene_colmap(scene);
    const int views = oxl_scene_view_count(scene), step = views / (REPROJECTION_VIEWS + 1) + 1;
    struct reprojection_view v[REPROJECTION_VIEWS + 1];
    struct colmap_sightings from;
    int count = 0;
    oxl_result rc;
    if (!c || c->track_count == 0 || c->format == COLMAP_JSON) return OXL_OK;
    rc = colmap_sightings_open(ctx, c, REPROJECTION_BYTES, &from);
    for (int i = 0; i < views && count < REPROJECTION_VIEWS && rc == OXL_OK; i += step) {
        v[count] = (struct reprojection_view){.view = i};
        reprojection_judge(ctx, scene, &from, &v[count++]);
    }
    colmap_sightings_close(ctx, &from);
    if (rc == OXL_OK) reprojection_report(ctx, scene, v, count);
    return rc == OXL_ERR_MEMORY ? rc : OXL_OK;
}

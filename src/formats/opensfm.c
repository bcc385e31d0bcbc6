/* opensfm.c - reads reconstruction.json of OpenSfM and OpenDroneMap: the reconstruction with most shots in
 * it.
 *
 * Source: opensfm.org, "Dataset structure" and "Camera models" (mapillary/OpenSfM). The normalised image has
 * its origin in the middle and the longer side as its unit: px = size x + w/2, in COLMAP's pixels. Poses are
 * world to camera, as an angle times an axis. Models:
 *
 *     perspective    focal k1 k2                         RADIAL
 *     simple_radial, radial   focal_x focal_y c_x c_y k1 k2        OPENCV
 *     brown          focal_x focal_y c_x c_y k1 k2 k3 p1 p2        FULL_OPENCV
 *     fisheye        focal k1 k2                         RADIAL_FISHEYE
 *     fisheye_opencv focal_x focal_y c_x c_y k1-k4       OPENCV_FISHEYE
 *     spherical, equirectangular                         EQUIRECTANGULAR, which training refuses
 */
#include "json_survey.h"

#include "../core/vecmath.h"

static const struct opensfm_model {
    const char *name, *colmap;
    int focals; /* 1: `focal`, the axis in the middle; 2: focal_x, focal_y, c_x, c_y; 0: no focal length */
    const char *distortion[5]; /* in COLMAP's order */
} opensfm_models[] = {
    {"perspective", "RADIAL", 1, {"k1", "k2"}},
    {"simple_radial", "OPENCV", 2, {"k1"}},
    {"radial", "OPENCV", 2, {"k1", "k2"}},
    {"brown", "FULL_OPENCV", 2, {"k1", "k2", "p1", "p2", "k3"}},
    {"fisheye", "RADIAL_FISHEYE", 1, {"k1", "k2"}},
    {"fisheye_opencv", "OPENCV_FISHEYE", 2, {"k1", "k2", "k3", "k4"}},
    {"spherical", "EQUIRECTANGULAR", 0, {NULL}},
    {"equirectangular", "EQUIRECTANGULAR", 0, {NULL}},
};

static double opensfm_number(const char *object, const char *name)
{
    const double value = oxl_json_number(object, name);
    return isnan(value) ? 0 : value;
}

static int64_t opensfm_camera(struct colmap_reader *r, const char *camera)
{
    char name[40];
    const double w = oxl_json_number(camera, "width"), h = oxl_json_number(camera, "height"),
                 size = OXL_MAX(w, h);
    struct colmap_camera c = {0};
    const struct opensfm_model *m = opensfm_models, *end = m + OXL_COUNT(opensfm_models);
    double *p = c.parameter;
    oxl_json_text(oxl_json_member(camera, "projection_type"), name, sizeof name);
    while (m < end && strcmp(m->name, name) != 0) m++;
    if (m == end)
        json_survey_fail(r, "projection_type", name[0] ? name : "none",
                         "perspective, simple_radial, radial, brown, fisheye or fisheye_opencv");
    if (!(w >= 1 && w <= INT_MAX && h >= 1 && h <= INT_MAX))
        json_survey_fail(r, "width and height", "none", "1 px or more");
    if (r->rc != OXL_OK) return -1;
    c.model = camera_model_find(m->colmap, strlen(m->colmap));
    c.width = (int)w, c.height = (int)h;
    if (m->focals == 0) *p++ = w, *p++ = h;
    if (m->focals == 1) *p++ = size * opensfm_number(camera, "focal");
    if (m->focals == 2)
        *p++ = size * opensfm_number(camera, "focal_x"), *p++ = size * opensfm_number(camera, "focal_y");
    if (m->focals) {
        *p++ = 0.5 * c.width + size * opensfm_number(camera, "c_x");
        *p++ = 0.5 * c.height + size * opensfm_number(camera, "c_y");
    }
    for (int i = 0; i < 5 && m->distortion[i]; i++) *p++ = opensfm_number(camera, m->distortion[i]);
    return json_survey_camera(r, &c);
}

#define OPENSFM_SMALL 1e-12 /* Bounds the half angles (radians) below which sin x / x is 1 to the last bit. */

/* Computes the quaternion of the rotation by |v| about v. */
static void opensfm_quaternion(const double v[3], double q[4])
{
    const double angle = sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), half = angle / 2;
    const double scale = half < OPENSFM_SMALL ? 0.5 : vecmath_sin(half) / angle;
    q[0] = vecmath_cos(half);
    for (int i = 0; i < 3; i++) q[1 + i] = scale * v[i];
}

static void opensfm_shot(struct colmap_reader *r, const struct json_names *cameras, const char *key,
                         const char *shot)
{
    char name[1024];
    const int64_t camera = json_names_find(cameras, oxl_json_member(shot, "camera"));
    double v[3], t[3], q[4];
    if (!oxl_json_text(key, name, sizeof name))
        json_survey_fail(r, "a shot's name", "none", "a file of the image folder");
    if (camera < 0)
        json_survey_fail(r, "camera of a shot", "a name that is not among the cameras", "one of them");
    if (!json_survey_numbers(oxl_json_member(shot, "rotation"), 3, v) ||
        !json_survey_numbers(oxl_json_member(shot, "translation"), 3, t) ||
        !(fabs(v[0]) + fabs(v[1]) + fabs(v[2]) < 100))
        json_survey_fail(r, "rotation and translation of a shot", "too little", "3 finite numbers each");
    if (r->rc != OXL_OK) return;
    opensfm_quaternion(v, q);
    json_survey_add_image(r, name, camera, q, t);
}

/* Goes through the members of an object: key and its value. */
#define OPENSFM_EACH(r, key, value, object)                                                                  \
    for (const char *key = oxl_json_first(object), *value = oxl_json_value(key); (r)->rc == OXL_OK && value; \
         key = oxl_json_next(value), value = oxl_json_value(key))

static void opensfm_points(struct colmap_reader *r, const char *points)
{
    r->line = 0;
    OPENSFM_EACH(r, key, point, points)
    {
        double position[3], rgb[3];
        r->line++;
        if (!json_survey_numbers(oxl_json_member(point, "coordinates"), 3, position))
            json_survey_fail(r, "coordinates of a point", "too little", "3 finite numbers");
        if (!json_survey_numbers(oxl_json_member(point, "color"), 3, rgb)) memset(rgb, 0, sizeof rgb);
        json_survey_add_point(r, position, rgb);
    }
}

/* Reads the place of the world's origin, {"latitude": , "longitude": } in degrees. */
static void opensfm_reference(struct colmap *out, const char *lla)
{
    const double latitude = oxl_json_number(lla, "latitude"), longitude = oxl_json_number(lla, "longitude");
    if (!(fabs(latitude) < 90 && fabs(longitude) <= 360)) return;
    out->reference[0] = latitude, out->reference[1] = longitude;
    out->has_reference = 1;
}

/* Reads the reference of the reconstruction, or else reference_lla.json of its folder,
 * where OpenDroneMap writes it. */
static void opensfm_read_reference(struct colmap_reader *r, const char *reconstruction)
{
    struct os_file_map map = {0};
    const char *path = PATH_BESIDE(r->path, "reference_lla.json");
    opensfm_reference(r->out, oxl_json_member(reconstruction, "reference_lla"));
    if (r->rc != OXL_OK || r->out->has_reference || !os_is_file(path)) return;
    r->rc = os_read_file(r->ctx, path, &map);
    if (r->rc == OXL_OK && !oxl_json_error(map.data)) opensfm_reference(r->out, map.data);
    if (r->rc == OXL_OK && !r->out->has_reference)
        oxl_log(r->ctx, OXL_LOG_WARNING,
                "%s has no latitude and longitude in degrees, so maps are not georeferenced", path);
    os_release_file(r->ctx, &map);
}

OXL_INTERNAL void opensfm_read(struct colmap_reader *r, const struct os_file_map *file)
{
    const char *json = file->data, *best = NULL;
    struct json_names cameras = {0};
    size_t most = 0, found = 0;
    for (const char *one = oxl_json_first(json); one && *json == '['; one = oxl_json_next(one), found++) {
        size_t shots = 0;
        OPENSFM_EACH(r, key, shot, oxl_json_member(one, "shots")) shots++;
        if (shots > most) best = one, most = shots;
    }
    if (found > 1)
        oxl_log(r->ctx, OXL_LOG_WARNING,
                "%s holds %zu reconstructions; the one with most shots (%zu) is used", r->path, found, most);
    OPENSFM_EACH(r, key, camera, oxl_json_member(best, "cameras"))
    {
        r->line++;
        json_names_add(r, &cameras, key, opensfm_camera(r, camera));
    }
    r->line = 0;
    OPENSFM_EACH(r, key, shot, oxl_json_member(best, "shots"))
    {
        r->line++;
        opensfm_shot(r, &cameras, key, shot);
    }
    oxl_free(r->ctx, cameras.name);
    opensfm_read_reference(r, best);
    opensfm_points(r, oxl_json_member(best, "points"));
}

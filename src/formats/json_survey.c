/* json_survey.c - fills the struct of COLMAP's files from surveys in JSON, nerfstudio's transforms.json and
 * OpenSfM's reconstruction.json, and from LLFF's poses.
 *
 * Invariant: as in colmap.c: finite numbers, rotations, names inside the image folder, each image's camera
 * exists. There are no 2D points and no tracks, so such a survey is one block.
 */
#include "formats.h"
#include "json_survey.h"

OXL_INTERNAL void json_survey_fail(struct colmap_reader *r, const char *what, const char *seen,
                                   const char *wanted)
{
    colmap_fail(r, "export the survey again", "found %s for %s, expected %s", seen, what, wanted);
}

OXL_INTERNAL int json_survey_numbers(const char *array, int count, double *out)
{
    const char *at = array && *array == '[' ? oxl_json_first(array) : NULL;
    for (int i = 0; i < count; i++) {
        const char *number = at;
        out[i] = number ? oxl_json_number_at(&number) : NAN;
        if (!(fabs(out[i]) <= DBL_MAX)) return 0;
        at = oxl_json_next(at);
    }
    return 1;
}

/* ---------------- strings of the text */

/* Finds the string of a value, without a leading "./"; the length is 0 if it is none. */
static struct json_name json_name_of(const char *text, int64_t value)
{
    struct json_name name = {text, text && *text == '"' ? (size_t)(oxl_json_end(text) - text) : 0, value};
    if (name.length > 2 && !strncmp(text, "\"./", 3)) name.text += 2, name.length -= 2;
    if (name.length) name.text++, name.length--;
    return name;
}

OXL_INTERNAL void json_names_add(struct colmap_reader *r, struct json_names *names, const char *text,
                                 int64_t value)
{
    const struct json_name name = json_name_of(text, value);
    if (r->rc != OXL_OK || !name.length) return;
    r->rc = oxl_reserve(r->ctx, &names->name, &names->capacity, names->count + 1, sizeof name);
    if (r->rc == OXL_OK) names->name[names->count++] = name;
}

OXL_INTERNAL int64_t json_names_find(const struct json_names *names, const char *text)
{
    const struct json_name wanted = json_name_of(text, 0);
    for (size_t i = 0; i < names->count && wanted.length; i++)
        if (names->name[i].length == wanted.length &&
            !memcmp(names->name[i].text, wanted.text, wanted.length))
            return names->name[i].value;
    return -1;
}

/* ---------------- poses */

/* Computes the unit quaternion of a rotation matrix, by its largest component [Shepperd 1978]. */
static void json_survey_quaternion(const double m[9], double q[4])
{
    const double trace[4] = {m[0] + m[4] + m[8], m[0] - m[4] - m[8], m[4] - m[0] - m[8], m[8] - m[0] - m[4]};
    int largest = 0, i, j, k;
    double s;
    for (int t = 1; t < 4; t++)
        if (trace[t] > trace[largest]) largest = t;
    s = 0.5 / sqrt(1 + trace[largest]);
    i = OXL_MAX(largest - 1, 0), j = (i + 1) % 3, k = (i + 2) % 3;
    q[largest] = 0.25 / s;
    if (largest) {
        q[0] = s * (m[3 * k + j] - m[3 * j + k]);
        q[1 + j] = s * (m[3 * i + j] + m[3 * j + i]);
        q[1 + k] = s * (m[3 * i + k] + m[3 * k + i]);
    } else q[1] = s * (m[7] - m[5]), q[2] = s * (m[2] - m[6]), q[3] = s * (m[3] - m[1]);
}

/* R = diag(1,-1,-1) M^T, t = -R c. Refuses matrices that are no rotation: they would bend the scene. */
OXL_INTERNAL void json_survey_pose(struct colmap_reader *r, const char *what, double m[3][4], double q[4],
                                   double t[3])
{
    double rotation[9];
    for (int i = 0; i < 9; i++) rotation[i] = i < 3 ? m[i][0] : -m[i % 3][i / 3];
    json_survey_quaternion(rotation, q);
    if (!camera_is_rotation(rotation))
        json_survey_fail(r, what, "no rotation",
                         "columns of length 1 at right angles, and right-handed: two axes exchanged need one "
                         "of them negated");
    for (int i = 0; i < 3; i++)
        t[i] = -(rotation[3 * i] * m[0][3] + rotation[3 * i + 1] * m[1][3] + rotation[3 * i + 2] * m[2][3]);
}

/* ---------------- rows */

OXL_INTERNAL int64_t json_survey_camera(struct colmap_reader *r, const struct colmap_camera *camera)
{
    struct colmap *out = r->out;
    struct colmap_camera c = *camera;
    const struct colmap_camera *last = out->camera_count ? &out->camera[out->camera_count - 1] : NULL;
    const struct camera_model *m = camera_model_at(c.model);
    if (r->rc != OXL_OK) return -1;
    if (last && last->model == c.model && last->width == c.width && last->height == c.height &&
        memcmp(last->parameter, c.parameter, sizeof c.parameter) == 0)
        return last->id;
    for (int i = 0; i < m->parameter_count; i++)
        if (!(fabs(c.parameter[i]) <= DBL_MAX) || (i < m->focal_count && !(c.parameter[i] > 0)))
            json_survey_fail(r, "the camera",
                             "a parameter that is missing or not finite, or a focal length of 0 or less",
                             "focal lengths and distortion as numbers");
    c.id = (int64_t)out->camera_count;
    c.line = r->line;
    c.file = out->images_file;
    c.parameter_count = m->parameter_count;
    COLMAP_ADD(r, camera, c);
    return c.id;
}

OXL_INTERNAL void json_survey_add_image(struct colmap_reader *r, const char *name, int64_t camera,
                                        const double rotation[4], const double translation[3])
{
    struct colmap_image image = {.id = (int64_t)r->out->image_count, .camera_id = camera, .line = r->line};
    colmap_check_rotation(r, rotation);
    memcpy(image.rotation, rotation, sizeof image.rotation);
    memcpy(image.translation, translation, sizeof image.translation);
    r->cursor = name;
    r->end = name + strlen(name);
    colmap_read_name(r, &image.name);
    COLMAP_ADD(r, image, image);
}

OXL_INTERNAL void json_survey_add_point(struct colmap_reader *r, const double position[3],
                                        const double rgb[3])
{
    struct colmap_point point = {.id = (int64_t)r->out->point_count, .error = -1};
    for (int i = 0; i < 3; i++) {
        point.position[i] = position[i];
        point.rgb[i] = (uint8_t)(OXL_MIN(OXL_MAX(rgb[i], 0), 255) + 0.5);
    }
    COLMAP_ADD(r, point, point);
}

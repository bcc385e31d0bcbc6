/* json_survey.c - adds rows for the readers of surveys in JSON: nerfstudio's transforms.json and OpenSfM's
 * reconstruction.json, read into the struct of COLMAP's files.
 *
 * Invariant: as in colmap.c: finite numbers, rotations, names inside the image folder, each image's camera
 * exists. There are no 2D points and no tracks, so such a survey is one block.
 */
#include "json_survey.h"

OXL_INTERNAL oxl_result json_survey_fail(struct colmap_reader *r, const char *what, const char *seen,
                                         const char *wanted)
{
    return colmap_fail(r, "export the survey again", "found %s for %s, expected %s", seen, what, wanted);
}

OXL_INTERNAL oxl_result json_survey_open(struct colmap_reader *r, const char *path, struct os_file_map *map)
{
    const char *fault;
    snprintf(r->path, sizeof r->path, "%s", path);
    r->rc = os_read_file(r->ctx, path, map);
    if (r->rc == OXL_OK) r->rc = os_refuse_gzip(r->ctx, path, map->data, map->size);
    if (r->rc != OXL_OK) return r->rc;
    /* Blanks the byte order mark, which programs of Windows write. */
    if (map->size >= 3 && !memcmp(map->data, "\xef\xbb\xbf", 3)) memset((char *)map->data, ' ', 3);
    fault = memchr(map->data, 0, map->size) ? map->data + strlen(map->data) : oxl_json_error(map->data);
    if (!fault) return OXL_OK;
    return r->rc = oxl_fail(
               r->ctx, OXL_ERR_INPUT,
               "%s: byte %zu: the JSON text ends too early, or something follows it\nfix: export the survey again",
               path, (size_t)(fault - map->data));
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

OXL_INTERNAL oxl_result json_survey_add_camera(struct colmap_reader *r, const struct colmap_camera *camera)
{
    struct colmap *out = r->out;
    const struct camera_model *m = camera_model_at(camera->model);
    oxl_result rc =
        oxl_reserve(r->ctx, &out->camera, &r->camera_capacity, out->camera_count + 1, sizeof *camera);
    if (rc != OXL_OK) return rc;
    if (camera->width < 1 || camera->height < 1)
        return json_survey_fail(r, "width and height", "none", "1 px or more of each");
    for (int i = 0; i < m->parameter_count; i++)
        if (!(fabs(camera->parameter[i]) <= DBL_MAX) || (i < m->focal_count && !(camera->parameter[i] > 0)))
            return json_survey_fail(
                r, "the camera", "a parameter that is missing or not finite, or a focal length of 0 or less",
                "focal lengths and distortion as numbers");
    out->camera[out->camera_count] = *camera;
    out->camera[out->camera_count].id = (int64_t)out->camera_count;
    out->camera[out->camera_count].line = r->line;
    out->camera[out->camera_count].file = out->images_file;
    out->camera[out->camera_count].parameter_count = m->parameter_count;
    out->camera_count++;
    return OXL_OK;
}

OXL_INTERNAL oxl_result json_survey_add_image(struct colmap_reader *r, const char *name, const char *end,
                                              int64_t camera, const double rotation[4],
                                              const double translation[3])
{
    struct colmap *out = r->out;
    struct colmap_image image = {.id = (int64_t)out->image_count, .camera_id = camera, .line = r->line};
    oxl_result rc;
    colmap_check_rotation(r, rotation);
    memcpy(image.rotation, rotation, sizeof image.rotation);
    memcpy(image.translation, translation, sizeof image.translation);
    r->cursor = name;
    r->end = end;
    colmap_read_name(r, &image.name);
    rc = r->rc;
    if (rc == OXL_OK)
        rc = oxl_reserve(r->ctx, &out->image, &r->image_capacity, out->image_count + 1, sizeof image);
    if (rc == OXL_OK) out->image[out->image_count++] = image;
    return rc;
}

OXL_INTERNAL oxl_result json_survey_add_mask(struct colmap_reader *r, const char *path)
{
    size_t offset = 0;
    r->cursor = path;
    r->end = path + strlen(path);
    colmap_read_name(r, &offset);
    if (r->rc == OXL_OK) r->out->image[r->out->image_count - 1].mask = offset;
    return r->rc;
}

OXL_INTERNAL oxl_result json_survey_add_point(struct colmap_reader *r, const double position[3],
                                              const double rgb[3])
{
    struct colmap *out = r->out;
    struct colmap_point point = {.id = (int64_t)out->point_count, .error = -1};
    const oxl_result rc =
        oxl_reserve(r->ctx, &out->point, &r->point_capacity, out->point_count + 1, sizeof point);
    if (rc != OXL_OK) return rc;
    for (int i = 0; i < 3; i++) {
        point.position[i] = position[i];
        point.rgb[i] = (uint8_t)(OXL_CLAMP(rgb[i], 0, 255) + 0.5);
    }
    out->point[out->point_count++] = point;
    return OXL_OK;
}

/* json_survey.h - shared by the readers of surveys in JSON. They fill struct colmap. */
#ifndef OXL_JSON_SURVEY_H
#define OXL_JSON_SURVEY_H

#include "json.h"
#include "colmap.h"

OXL_INTERNAL void json_survey_fail(struct colmap_reader *r, const char *what, const char *seen,
                                   const char *wanted);

/* Add a row each. json_survey_add_camera checks the numbers and makes the row the
 * id. `name` ends at `end`. */
OXL_INTERNAL void json_survey_add_camera(struct colmap_reader *r, const struct colmap_camera *camera);
OXL_INTERNAL void json_survey_add_image(struct colmap_reader *r, const char *name, const char *end,
                                        int64_t camera, const double rotation[4],
                                        const double translation[3]);
OXL_INTERNAL void json_survey_add_point(struct colmap_reader *r, const double position[3],
                                        const double rgb[3]);
/* Reads the points of a PLY file (ply_points.c). */
OXL_INTERNAL oxl_result ply_points_read(struct colmap_reader *r, const char *path);

OXL_INTERNAL int json_survey_numbers(const char *array, int count, double *out); /* 0: fewer, or not finite */

/* Holds strings as they stand in the text, with a value each; json_names_sort comes before searches, since
 * each frame and shot searches. Of equal strings, the least value is found; -1: there is none. */
struct json_names {
    struct json_name {
        const char *text;
        size_t length;
        int64_t value;
    } * name;
    size_t count, capacity;
};
OXL_INTERNAL void json_names_add(struct colmap_reader *r, struct json_names *names, const char *text,
                                 int64_t value);
OXL_INTERNAL void json_names_sort(struct json_names *names);
OXL_INTERNAL int64_t json_names_find(const struct json_names *names, const char *text);

/* Names NeRF synthetic's file of training images; the held-out images are in another file of the folder. */
#define JSON_SURVEY_TRAIN "transforms_train.json"

/* Read a survey from the text of its file (nerfstudio.c, opensfm.c). */
OXL_INTERNAL void nerfstudio_read(struct colmap_reader *r, const char *json);
OXL_INTERNAL void opensfm_read(struct colmap_reader *r, const char *json);

#endif

/* json_survey.h - shared by the readers of surveys in JSON. They fill struct colmap. */
#ifndef OXL_JSON_SURVEY_H
#define OXL_JSON_SURVEY_H

#include "json.h"
#include "colmap.h"
#include "../survey/sparse.h"

/* Reads the file into memory and checks that all brackets are closed (json_survey.c). r->path and r->line,
 * the record, are for messages. */
OXL_INTERNAL oxl_result json_survey_open(struct colmap_reader *r, const char *path, struct os_file_map *map);
OXL_INTERNAL oxl_result json_survey_fail(struct colmap_reader *r, const char *what, const char *seen,
                                         const char *wanted);

/* Add a row each. json_survey_add_camera checks the numbers and makes the row the
 * id. `name` ends at `end`. */
OXL_INTERNAL oxl_result json_survey_add_camera(struct colmap_reader *r, const struct colmap_camera *camera);
OXL_INTERNAL oxl_result json_survey_add_image(struct colmap_reader *r, const char *name, const char *end,
                                              int64_t camera, const double rotation[4],
                                              const double translation[3]);
OXL_INTERNAL oxl_result json_survey_add_point(struct colmap_reader *r, const double position[3],
                                              const double rgb[3]);

/* Gives the image that was added last a mask: a path from the file's folder. */
OXL_INTERNAL oxl_result json_survey_add_mask(struct colmap_reader *r, const char *path);
/* Reads the points of a PLY file (ply_points.c). */
OXL_INTERNAL oxl_result ply_points_read(struct colmap_reader *r, const char *path);

OXL_INTERNAL int json_survey_numbers(const char *array, int count, double *out); /* 0: fewer, or not finite */

/* Names NeRF synthetic's file of training images; the held-out images are in another file of the folder. */
#define JSON_SURVEY_TRAIN "transforms_train.json"

/* Read a survey from the text of its file (nerfstudio.c, opensfm.c). */
OXL_INTERNAL oxl_result nerfstudio_read(struct colmap_reader *r, const char *json);
OXL_INTERNAL oxl_result opensfm_read(struct colmap_reader *r, const char *json);

/* Turns an image's path in the file into a name: from the image folder, with an extension. path:
 * (NERFSTUDIO_PATH) buffer that holds the name; *end: its end. Returns NULL if the value is no text.
 * (nerfstudio_names.c) */
enum { NERFSTUDIO_PATH = 1024 };
OXL_INTERNAL const char *nerfstudio_name(const struct colmap_reader *r, const char *value, char *path,
                                         const char **end);
/* Writes the folder in which names start to `out` (PATH_LENGTH). */
OXL_INTERNAL const char *nerfstudio_folder(const struct colmap_reader *r, char *out);
/* Sets r->width and r->height from the first image that exists; both stay 0 if there is none. */
OXL_INTERNAL void nerfstudio_measure_image(struct colmap_reader *r, const char *json);
/* Marks images by train_filenames, val_filenames and test_filenames, and removes those
 * that none of them lists. */
OXL_INTERNAL oxl_result nerfstudio_split(struct colmap_reader *r, const char *json);

#endif

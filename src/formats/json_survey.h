/* json_survey.h - shared by the readers of surveys in JSON and of LLFF's poses. They fill struct colmap. */
#ifndef OXL_JSON_SURVEY_H
#define OXL_JSON_SURVEY_H

#include "json.h"
#include "colmap.h"

OXL_INTERNAL void json_survey_fail(struct colmap_reader *r, const char *what, const char *seen,
                                   const char *wanted);

/* Add a row each. json_survey_camera checks the numbers, adds the camera unless it is the one added last, and
 * returns its id, the row. */
OXL_INTERNAL int64_t json_survey_camera(struct colmap_reader *r, const struct colmap_camera *camera);
OXL_INTERNAL void json_survey_add_image(struct colmap_reader *r, const char *name, int64_t camera,
                                        const double rotation[4], const double translation[3]);
OXL_INTERNAL void json_survey_add_point(struct colmap_reader *r, const double position[3],
                                        const double rgb[3]);
/* Reads the points of a PLY file (ply_points.c). */
OXL_INTERNAL oxl_result ply_points_read(struct colmap_reader *r, const char *path);

/* Turns camera to world, x right, y up, z back, into world to camera, y down. `what` names the matrix. */
OXL_INTERNAL void json_survey_pose(struct colmap_reader *r, const char *what, double m[3][4], double q[4],
                                   double t[3]);

OXL_INTERNAL int json_survey_numbers(const char *array, int count, double *out); /* 0: fewer, or not finite */

/* Holds strings as they stand in the text, with a value each; of equal strings, the first one's is found; -1:
 * there is none. */
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
OXL_INTERNAL int64_t json_names_find(const struct json_names *names, const char *text);

/* Read a survey from its file r->path (nerfstudio.c, opensfm.c, llff.c). */
OXL_INTERNAL void nerfstudio_read(struct colmap_reader *r, const struct os_file_map *file);
OXL_INTERNAL void opensfm_read(struct colmap_reader *r, const struct os_file_map *file);
OXL_INTERNAL void llff_read(struct colmap_reader *r, const struct os_file_map *file);

#endif

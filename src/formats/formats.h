/* formats.h - readers and writers of files: surveys, models. */
#ifndef OXL_FORMATS_H
#define OXL_FORMATS_H

#include "../model/model.h"
#include "../survey/imaging.h"
#include "../survey/sparse.h"
#include "../../oceanxl_job.h"
#include "survey_read.h"

/* ---------------- survey_find.c: the survey of a folder */

/* Reads the sub-model with most images among the folder `sparse` (NULL: SCENE/sparse), its sub-folders and,
 * without `sparse`, SCENE. A file `sparse` replaces the points of its folder's model or else of SCENE's.
 * Observations are not kept. images: as in struct survey_given. file: of SCENE, read first; or NULL. */
OXL_INTERNAL oxl_result survey_find_model(oxl_context *ctx, const char *path, const char *sparse,
                                          const char *images, const char *file, struct colmap *out);
/* Reads a survey in JSON, or LLFF's, by the reader of its file's name. given NULL: nothing. */
OXL_INTERNAL oxl_result json_survey_read(oxl_context *ctx, const char *folder, const char *name,
                                         const struct survey_given *given, struct colmap *out);

/* Returns the folder that an option names, from here or else from the survey's folder, which has `otherwise`
 * where the option is NULL. */
OXL_INTERNAL const char *survey_folder(char out[PATH_LENGTH], const char *survey, const char *option,
                                       const char *otherwise);

/* Reads a model, .txt or .bin, by parts of `buffer` bytes; of both, the one that the images fit better.
 * Invariants: colmap.c. 2D points are not read. given NULL: nothing. */
OXL_INTERNAL oxl_result colmap_read(oxl_context *ctx, const char *folder, size_t buffer,
                                    const struct survey_given *given, struct colmap *out);
/* Replaces a model's points by those of a file, .txt, .bin or .ply. */
OXL_INTERNAL oxl_result colmap_read_points(oxl_context *ctx, const char *path, struct colmap *out);

/* ---------------- spz.c, splat_file.c: rows of the table in model_formats.c */

/* Read and write models without second lobes. model_formats.c drops rows that are not finite after
 * reading. */
OXL_INTERNAL oxl_result spz_read(oxl_context *ctx, const char *path, oxl_model *out);
OXL_INTERNAL oxl_result spz_write(oxl_context *ctx, const char *path, const oxl_model *model);
OXL_INTERNAL oxl_result splat_file_read(oxl_context *ctx, const char *path, oxl_model *out);
OXL_INTERNAL oxl_result splat_file_write(oxl_context *ctx, const char *path, const oxl_model *model);

/* ---------------- model_text.c: what they share */

OXL_INTERNAL void model_rotation(const oxl_model *model, size_t row, double q[4]); /* w x y z, length 1 */
OXL_INTERNAL unsigned char model_byte(double x); /* nearest to x in 0..255 */
/* Writes what a model has beside its Gaussians as lines, each after the text `before`. */
OXL_INTERNAL void model_write_comments(struct text *t, const char *before, const oxl_model *model);
/* Reads origin, scale, background, view and anti-aliasing from the lines of a text that begin with `before`;
 * other lines are ignored. */
OXL_INTERNAL void model_read_comments(oxl_context *ctx, const char *path, const char *text, size_t size,
                                      const char *before, oxl_model *model);

/* ---------------- model_file.c: models as PLY */

/* Reads a PLY file for oxl_model_read. */
OXL_INTERNAL oxl_result model_file_read_ply(oxl_context *ctx, const char *path, oxl_model *out);
/* Removes rows with values that are not finite, with messages. */
OXL_INTERNAL oxl_result model_file_drop_rows(oxl_context *ctx, const char *path, oxl_model *model);
/* Writes a model with its second lobes. oxl_model_write passes file_degree 3, the standard's; the model's own
 * degree writes fewer columns. */
OXL_INTERNAL oxl_result model_file_write_ply(oxl_context *ctx, const char *path, const oxl_model *model,
                                             int file_degree);
/* Fails if a value of the model is not finite. */
OXL_INTERNAL oxl_result model_write_check_finite(oxl_context *ctx, const char *path, const oxl_model *model);

/* ---------------- imaging_file.c: imaging.txt */

/* Returns 1 if images differ from the scene's colours, so that the model needs an imaging.txt. */
OXL_INTERNAL int imaging_is_needed(const struct oxl_imaging *m);
/* Reads like oxl_imaging_read; out->views 0: there is none. */
OXL_INTERNAL oxl_result imaging_read_beside(oxl_context *ctx, const char *model_path, const oxl_scene *scene,
                                            struct oxl_imaging *out);
/* Reads imaging.txt, and ignores images that are not in the scene. */
OXL_INTERNAL oxl_result imaging_read(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                     struct oxl_imaging *out);

#endif

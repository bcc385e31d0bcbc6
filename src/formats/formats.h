/* formats.h - readers and writers of files: surveys, models. */
#ifndef OXL_FORMATS_H
#define OXL_FORMATS_H

#include "../model/model.h"
#include "../survey/imaging.h"
#include "../survey/sparse.h"
#include "../../oceanxl_job.h"

/* ---------------- survey_find.c: the survey of a folder */

/* Reads the sub-model with most images of `sparse`, or of SCENE/sparse, its folders, and SCENE. Observations
 * are not kept. images: as in json_survey_read. */
OXL_INTERNAL oxl_result survey_find_model(oxl_context *ctx, const char *path, const char *sparse,
                                          const char *images, struct colmap *out);
/* Reads a survey in JSON, by the name of its file in the table of survey_find.c. images: the folder that the
 * names start from; NULL: as the file has it. */
OXL_INTERNAL oxl_result json_survey_read(oxl_context *ctx, const char *folder, const char *name,
                                         const char *images, struct colmap *out);

/* Reads a model, .txt or .bin, the newer if both exist; invariants: colmap.c. 2D points are not read. */
OXL_INTERNAL oxl_result colmap_read(oxl_context *ctx, const char *folder, struct colmap *out);
/* Does the same with a buffer of so many bytes, for tests. */
OXL_INTERNAL oxl_result colmap_read_buffered(oxl_context *ctx, const char *folder, size_t buffer,
                                             struct colmap *out);

/* ---------------- spz.c, gltf.c, splat_file.c: rows of the table in model_formats.c */

/* Read and write models whose values are finite and that have no lobes: model_file.c has checked both. */
OXL_INTERNAL oxl_result spz_read(oxl_context *ctx, const char *path, oxl_model *out);
OXL_INTERNAL oxl_result spz_write(oxl_context *ctx, const char *path, const oxl_model *model);
OXL_INTERNAL oxl_result gltf_write(oxl_context *ctx, const char *path, const oxl_model *model);
OXL_INTERNAL oxl_result splat_file_read(oxl_context *ctx, const char *path, oxl_model *out);
OXL_INTERNAL oxl_result splat_file_write(oxl_context *ctx, const char *path, const oxl_model *model);

/* ---------------- model_text.c: what they share */

OXL_INTERNAL void model_rotation(const oxl_model *model, size_t row, double q[4]); /* w x y z, of length 1 */
OXL_INTERNAL unsigned char model_byte(double x);                                   /* the nearest */
/* Names the anti-aliasing in comments of PLY files, as Brush writes it; "mip" or "default" follows. */
#define MODEL_RENDER_MODE "SplatRenderMode: "
/* Writes the background's comment for a file, after the text `before`; nothing where it is not known. */
OXL_INTERNAL void model_write_background(struct text *t, const char *before, const oxl_model *model);
/* Writes the view's comment; nothing where there is none. */
OXL_INTERNAL void model_write_view(struct text *t, const char *before, const oxl_model *model);
/* Reads origin, scale, background or view from a comment of a file; other comments are ignored. */
OXL_INTERNAL void model_read_comment(oxl_context *ctx, const char *path, const char *comment,
                                     oxl_model *model);

/* ---------------- model_file.c, model_write.c: models as PLY */

/* Replaces infinite logits and logarithms by limits; returns the rows. The other says which were left out. */
OXL_INTERNAL size_t model_file_settle_limits(oxl_model *model);
OXL_INTERNAL void model_file_report_dropped(oxl_context *ctx, const char *path, size_t dropped, size_t count);

/* Describes a PLY file that this module wrote. */
struct model_file_layout {
    uint64_t data, lobe_data; /* offsets of the first row of elements vertex and dog */
    size_t rows, row_bytes, lobes;
    int degree, offset[OXL_PLANES]; /* of a plane's value in a row */
};
/* Reads a PLY file for oxl_model_read. model_file_drop_rows removes rows with values that are not finite. */
OXL_INTERNAL oxl_result model_file_read_ply(oxl_context *ctx, const char *path, oxl_model *out);
OXL_INTERNAL oxl_result model_file_drop_rows(oxl_context *ctx, const char *path, oxl_model *model);
/* Finds the layout and gives the model the file's origin and scale; *has 0: the file has another layout. */
OXL_INTERNAL oxl_result model_file_layout(oxl_context *ctx, const char *path, struct model_file_layout *out,
                                          oxl_model *model, int *has);
/* Reads model->count rows, starting at row `first`. */
OXL_INTERNAL oxl_result model_file_read_rows(oxl_context *ctx, const struct model_file_layout *l,
                                             struct os_reader *file, size_t first, oxl_model *model);
/* Writes a model with its lobes. oxl_model_write takes file_degree 3; with the model's own degree only its
 * coefficients are written. */
OXL_INTERNAL oxl_result model_file_write_ply(oxl_context *ctx, const char *path, const oxl_model *model,
                                             int file_degree);
/* Fails if a value in the columns of a file of this degree is not finite. */
OXL_INTERNAL oxl_result model_write_check_finite(oxl_context *ctx, const char *path, const oxl_model *model,
                                                 int file_degree);
/* Writes several models of the same origin as one file; those in files are read page by page. */
OXL_INTERNAL oxl_result model_file_write_large(oxl_context *ctx, const char *path,
                                               const oxl_large_model *large, int count, int file_degree);

/* ---------------- model_pages.c: a model that stays in its file */

struct model_page {
    double centre[3], radius, sigma; /* relative to the file's origin */
};

struct oxl_model_pages {
    char *path;
    struct model_file_layout layout;
    double origin[3];        /* of the file */
    struct model_page *page; /* (pages) */
    size_t pages;
};
OXL_INTERNAL int model_row_shows(const oxl_camera *camera, double near_plane, const oxl_model *model,
                                 size_t row);
/* Opens a model whose rows stay in a file of this layout; out->model has origin and scale already. */
OXL_INTERNAL oxl_result model_pages_open(oxl_context *ctx, const char *path,
                                         const struct model_file_layout *of, oxl_large_model *out);
OXL_INTERNAL oxl_result model_pages_get(oxl_context *ctx, const oxl_large_model *large, size_t page,
                                        oxl_model *out);
/* Copies the rows of a model with pages that a view may show. */
OXL_INTERNAL oxl_result model_pages_view(oxl_context *ctx, const oxl_large_model *large,
                                         const oxl_camera *camera, double near_plane, oxl_model *out);

/* ---------------- imaging_file.c: imaging.txt */

/* Returns 1 if images are not the scene's colours: a model has an imaging.txt. */
OXL_INTERNAL int imaging_is_needed(const struct imaging *m);
OXL_INTERNAL oxl_result imaging_write(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                      const struct imaging *m);
/* Reads imaging.txt, and ignores images that are not in the scene. */
OXL_INTERNAL oxl_result imaging_read(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                     struct imaging *out);

#endif

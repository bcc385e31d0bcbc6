/* model_columns.h - the columns of the standard PLY, shared by its reader and its writer. */
#ifndef OXL_MODEL_COLUMNS_H
#define OXL_MODEL_COLUMNS_H

#include "formats.h"

enum { MODEL_FILE_COLUMNS = 62 /* columns of the standard layout */ };

struct model_file_column {
    char name[20];
    int plane; /* plane of the model; -1: written as 0, not needed when read */
};

/* Lists the columns of a PLY of `file_degree` for a model of `sh_degree`, in the standard's order; f_rest is
 * channel-major: all coefficients of red, then of green, then of blue. Returns their number: 62 when
 * file_degree is 3. */
OXL_INTERNAL int model_file_columns(int file_degree, int sh_degree,
                                    struct model_file_column out[MODEL_FILE_COLUMNS]);

/* Names the float columns of element dog, one for each plane from OXL_LOBE on. */
static const char *const MODEL_FILE_LOBE[MODEL_LOBE_PLANES] = {"opacity_factor", "scale_factor_0",
                                                               "scale_factor_1", "scale_factor_2"};

static inline int model_file_finite(float x)
{
    return fabsf(x) <= FLT_MAX;
}

#endif

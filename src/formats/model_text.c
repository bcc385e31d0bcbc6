/* model_text.c - shares among the formats of models: origin, scale, background and first view as comments,
 * and values as bytes.
 */
#include "formats.h"

/* ---------------- values for other formats */

OXL_INTERNAL void model_rotation(const oxl_model *model, size_t row, double q[4])
{
    double norm = 0;
    for (int i = 0; i < 4; i++) {
        q[i] = model->plane[OXL_ROTATION + i][row];
        norm += q[i] * q[i];
    }
    norm = sqrt(norm);
    for (int i = 0; i < 4; i++) q[i] = norm > 0 ? q[i] / norm : i == 0;
}

OXL_INTERNAL unsigned char model_byte(double x)
{
    return (unsigned char)(OXL_CLAMP(x, 0, 255) + 0.5);
}

/* ---------------- origin, scale and background as text, in comments of files */

#define MODEL_ORIGIN_MAX 1e15 /* Limits |origin| and the other numbers. */

/* Parses `count` finite numbers after blanks; returns 0 if they are malformed. */
static int model_read_numbers(const char *text, double *value, int count)
{
    const char *end = text + strlen(text);
    for (int n = 0; n < count; n++) {
        while (*text == ' ') text++;
        if (!parse_double(&text, end, &value[n]) || !(fabs(value[n]) <= MODEL_ORIGIN_MAX)) return 0;
    }
    return 1;
}

OXL_INTERNAL void model_write_background(struct text *t, const char *before, const oxl_model *model)
{
    if (model->has_background) text_add(t, "%sbackground", before);
    for (int c = 0; c < 3 && model->has_background; c++) {
        char number[NUMBER_TEXT_MAX];
        format_float(number, model->background[c]);
        text_add(t, " %s", number);
    }
}

OXL_INTERNAL void model_write_view(struct text *t, const char *before, const oxl_model *model)
{
    char number[NUMBER_TEXT_MAX];
    if (!(model->view[0] > 0)) return;
    text_add(t, "%sview", before);
    for (size_t k = 0; k < OXL_COUNT(model->view); k++) {
        if (k < 10) format_float(number, (float)model->view[k]);
        /* Writes the position in double, since the world's origin may be far away. */
        else format_double(number, model->view[k]);
        text_add(t, " %s", number);
    }
}

/* Reads "view FOCAL R11 .. R33 X Y Z"; returns 0 for another comment. */
static int model_read_view(const char *comment, oxl_model *model)
{
    double value[OXL_COUNT(model->view)];
    if (strncmp(comment, "view ", 5) || !model_read_numbers(comment + 5, value, (int)OXL_COUNT(value)) ||
        !(value[0] > 0))
        return 0;
    memcpy(model->view, value, sizeof value);
    return 1;
}

/* Reads "background R G B"; returns 0 for another comment. */
static int model_read_background(const char *comment, oxl_model *model)
{
    double value[3];
    if (strncmp(comment, "background ", 11) || !model_read_numbers(comment + 11, value, 3)) return 0;
    for (int c = 0; c < 3; c++) model->background[c] = (float)OXL_CLAMP(value[c], 0, 1);
    return model->has_background = 1;
}

/* Reads Brush's "SplatRenderMode: mip" or Postshot's "antialiased 1"; returns 0 for another comment. */
static int model_read_antialias(const char *comment, oxl_model *model)
{
    const size_t length = strlen(MODEL_RENDER_MODE);
    if (!strncmp(comment, MODEL_RENDER_MODE, length))
        return model->antialias = !strcmp(comment + length, "mip"), 1;
    if (strncmp(comment, "antialiased ", 12)) return 0;
    return model->antialias = strcmp(comment + 12, "0") != 0, 1;
}

/* Reads "origin X Y Z", "scale S", "background R G B", "view ..." and anti-aliasing. */
OXL_INTERNAL void model_read_comment(oxl_context *ctx, const char *path, const char *comment,
                                     oxl_model *model)
{
    const int is_origin = !strncmp(comment, "origin ", 7), is_scale = !strncmp(comment, "scale ", 6);
    double value[3];
    if (model_read_background(comment, model) || model_read_antialias(comment, model) ||
        model_read_view(comment, model))
        return;
    if (is_origin && model_read_numbers(comment + 7, value, 3)) memcpy(model->origin, value, sizeof value);
    else if (is_scale && model_read_numbers(comment + 6, value, 1) && value[0] >= 1 / MODEL_ORIGIN_MAX)
        model->scale = value[0] == 1 ? 0 : value[0];
    else if (is_origin || is_scale)
        oxl_log(ctx, OXL_LOG_WARNING, "%s: comment '%s' ignored: expected %s, %s%g", path, comment,
                is_origin ? "origin X Y Z" : "scale S", is_origin ? "each within " : "above 0 and up to ",
                MODEL_ORIGIN_MAX);
}

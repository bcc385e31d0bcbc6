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

/* Reads Brush's "SplatRenderMode: mip" or Postshot's "antialiased 1"; returns 0 for another comment. */
static int model_read_antialias(const char *comment, oxl_model *model)
{
    const size_t length = strlen(MODEL_RENDER_MODE);
    if (!strncmp(comment, MODEL_RENDER_MODE, length))
        return model->antialias = !strcmp(comment + length, "mip"), 1;
    if (strncmp(comment, "antialiased ", 12)) return 0;
    return model->antialias = strcmp(comment + 12, "0") != 0, 1;
}

/* Reads "origin X Y Z", "scale S", "background R G B", "view FOCAL R11 .. R33 X Y Z" and anti-aliasing. */
OXL_INTERNAL void model_read_comment(oxl_context *ctx, const char *path, const char *comment,
                                     oxl_model *model)
{
    enum { ORIGIN, SCALE, BACKGROUND, VIEW, KINDS };
    static const char *const words[KINDS] = {"origin ", "scale ", "background ", "view "};
    const int counts[KINDS] = {3, 1, 3, (int)OXL_COUNT(model->view)};
    double v[OXL_COUNT(model->view)];
    int kind = 0, good;
    while (kind < KINDS && strncmp(comment, words[kind], strlen(words[kind])) != 0) kind++;
    if (model_read_antialias(comment, model) || kind == KINDS) return;
    good = model_read_numbers(comment + strlen(words[kind]), v, counts[kind]);
    if (good && kind == ORIGIN) memcpy(model->origin, v, sizeof model->origin);
    else if (good && kind == SCALE && v[0] >= 1 / MODEL_ORIGIN_MAX) model->scale = v[0] == 1 ? 0 : v[0];
    else if (good && kind == VIEW && v[0] > 0) memcpy(model->view, v, sizeof model->view);
    else if (good && kind == BACKGROUND)
        for (int c = 0; c < 3; c++) {
            model->background[c] = (float)OXL_CLAMP(v[c], 0, 1);
            model->has_background = 1;
        }
    else if (kind <= SCALE)
        oxl_log(ctx, OXL_LOG_WARNING, "%s: comment '%s' ignored: expected %s, %s%g", path, comment,
                kind == ORIGIN ? "origin X Y Z" : "scale S",
                kind == ORIGIN ? "each within " : "above 0 and up to ", MODEL_ORIGIN_MAX);
}

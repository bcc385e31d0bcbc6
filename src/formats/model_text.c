/* model_text.c - shares among the formats of models: comments with origin, scale, background, first view and
 * anti-aliasing, and values as bytes.
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

/* ---------------- comments of files: a word, and numbers behind it */

#define MODEL_ORIGIN_MAX 1e15                /* Limits |origin| and the other numbers. */
#define MODEL_RENDER_MODE "SplatRenderMode:" /* Brush's word of anti-aliasing; "mip" or "default" follows. */
enum { MODEL_NUMBERS = 13, MODEL_FLOATS = 10 /* numbers of a view that are floats */ };

static void model_write_comment(struct text *t, const char *before, const char *word, const double *value,
                                int count)
{
    text_add(t, "%s%s", before, word);
    for (int k = 0; k < count; k++) {
        char number[NUMBER_TEXT_MAX];
        if (count < MODEL_NUMBERS) number_text(number, value[k]);
        else if (k < MODEL_FLOATS) format_float(number, (float)value[k]);
        /* Writes the position in double, since the world's origin may be far away. */
        else format_double(number, value[k]);
        text_add(t, " %s", number);
    }
    text_add(t, "\n");
}

OXL_INTERNAL void model_write_comments(struct text *t, const char *before, const oxl_model *model)
{
    const oxl_model *m = model;
    double background[3];
    for (int c = 0; c < 3; c++) background[c] = m->background[c];
    model_write_comment(t, before, "origin", m->origin, 3);
    if (m->scale > 0) model_write_comment(t, before, "scale", &m->scale, 1);
    if (m->has_background) model_write_comment(t, before, "background", background, 3);
    if (m->view[0] > 0) model_write_comment(t, before, "view", m->view, MODEL_NUMBERS);
    if (m->antialias) text_add(t, "%s" MODEL_RENDER_MODE " mip\n", before);
}

/* Reads finite numbers after blanks; returns how many there are. */
static int model_read_numbers(const char *text, double value[MODEL_NUMBERS])
{
    const char *end = text + strlen(text);
    int n = 0;
    for (; n < MODEL_NUMBERS; n++) {
        while (*text == ' ') text++;
        if (!parse_double(&text, end, &value[n]) || !(fabs(value[n]) <= MODEL_ORIGIN_MAX)) break;
    }
    return n;
}

/* Reads "origin X Y Z", "scale S", "background R G B", "view FOCAL R11 .. R33 X Y Z", Brush's "SplatRenderMode:
 * mip" or Postshot's "antialiased 1". */
static void model_read_comment(oxl_context *ctx, const char *path, const char *comment, oxl_model *model)
{
    char word[20] = "";
    double v[MODEL_NUMBERS] = {0};
    const int length = (int)strcspn(comment, " "), count = model_read_numbers(comment + length, v);
    snprintf(word, sizeof word, "%.*s", length, comment);
    if (!strcmp(word, MODEL_RENDER_MODE)) model->antialias = !strncmp(comment + length, " mip", 4);
    else if (!strcmp(word, "antialiased")) model->antialias = v[0] != 0;
    else if (!strcmp(word, "view") && count == MODEL_NUMBERS && v[0] > 0)
        memcpy(model->view, v, sizeof model->view);
    else if (!strcmp(word, "background") && count >= 3) {
        for (int c = 0; c < 3; c++) model->background[c] = (float)OXL_CLAMP(v[c], 0, 1);
        model->has_background = 1;
    } else if (!strcmp(word, "origin") && count >= 3) memcpy(model->origin, v, sizeof model->origin);
    else if (!strcmp(word, "scale") && v[0] >= 1 / MODEL_ORIGIN_MAX) model->scale = v[0] == 1 ? 0 : v[0];
    else if (!strcmp(word, "origin") || !strcmp(word, "scale"))
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: comment '%s' ignored: expected origin X Y Z, each within %g, or "
                "scale S, above 0 and up to that",
                path, comment, MODEL_ORIGIN_MAX);
}

OXL_INTERNAL void model_read_comments(oxl_context *ctx, const char *path, const char *text, size_t size,
                                      const char *before, oxl_model *model)
{
    const size_t skip = strlen(before);
    for (const char *at = text, *end = text + size, *stop; at < end; at = stop + 1) {
        char line[512];
        stop = memchr(at, '\n', (size_t)(end - at));
        if (!stop) stop = end;
        if ((size_t)(stop - at) < skip || memcmp(at, before, skip)) continue;
        snprintf(line, sizeof line, "%.*s", (int)OXL_MIN((size_t)(stop - at) - skip, sizeof line - 1),
                 at + skip);
        model_read_comment(ctx, path, line + strspn(line, " \t"), model);
    }
}

/* study_text.c - means and spreads, digits that no locale changes, the parts of a drawing. */
#include "study.h"

#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

struct study_figure study_summary(const double *x, int count)
{
    double sum = 0, square = 0, mean;
    for (int i = 0; i < count; i++) sum += x[i];
    mean = sum / count;
    for (int i = 0; i < count; i++) square += (x[i] - mean) * (x[i] - mean);
    return (struct study_figure){mean, count > 1 ? sqrt(square / (count - 1)) : NAN};
}

/* ---------------------------------------------------------------- text */

void study_add(struct study_text *t, const char *format, ...)
{
    va_list list;
    int     size;
    va_start(list, format);
    size = vsnprintf(NULL, 0, format, list);
    va_end(list);
    if (size < 0) t->failed = 1;
    if (!t->failed && t->used + (size_t)size + 1 > t->capacity) {
        const size_t capacity = 2 * t->capacity + (size_t)size + 1024;
        char        *data     = realloc(t->data, capacity);
        if (data) t->data = data, t->capacity = capacity;
        else t->failed = 1;
    }
    if (t->failed) return;
    va_start(list, format);
    vsnprintf(t->data + t->used, t->capacity - t->used, format, list);
    va_end(list);
    t->used += (size_t)size;
}

const char *study_fixed(char out[32], double value, int decimals)
{
    char   text[64];
    size_t size = 0;
    out[0]      = 0;
    if (!isfinite(value) || fabs(value) >= 1e18) return out;
    snprintf(text, sizeof text, "%.*f", decimals, value);
    for (const char *p = text; *p; p++) {
        if (strchr("-0123456789", *p)) out[size++] = *p;
        else if (size > 0 && out[size - 1] != '.') out[size++] = '.'; /* the locale's point has one byte or more */
    }
    out[size] = 0;
    if (out[0] == '-' && strspn(out, "-0.") == size) memmove(out, out + 1, size); /* -0.00 */
    return out;
}

/* ---------------------------------------------------------------- drawings */

double study_step(double span)
{
    static const double factor[] = {1, 2, 5};
    for (double power = 1e-6; power < 1e9; power *= 10)
        for (int i = 0; i < 3; i++)
            if (factor[i] * power * 5 >= span) return factor[i] * power;
    return span;
}

static void study_escape(struct study_text *t, const char *text)
{
    for (; *text; text++) {
        if (*text == '<') study_add(t, "&lt;");
        else if (*text == '>') study_add(t, "&gt;");
        else if (*text == '&') study_add(t, "&amp;");
        else if ((unsigned char)*text >= ' ') study_add(t, "%c", *text);
    }
}

void study_drawing(struct study_text *t, int width, int height, const char *title)
{
    study_add(t,
              "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"%d\" viewBox=\"0 0 %d %d\" "
              "style=\"font-family:system-ui,sans-serif;font-size:13px;fill:#1d262c\">\n",
              width, height, width, height);
    study_box(t, 0, 0, width, height, "#ffffff");
    study_label(t, 16, 30, "font-size:18px;font-weight:600", title);
}

void study_line(struct study_text *t, double x0, double y0, double x1, double y1, const char *style)
{
    study_add(t, "<line x1=\"%s\" y1=\"%s\" x2=\"%s\" y2=\"%s\" style=\"%s\"/>\n", STUDY_FIXED(x0, 1), STUDY_FIXED(y0, 1),
              STUDY_FIXED(x1, 1), STUDY_FIXED(y1, 1), style);
}

void study_box(struct study_text *t, double x, double y, double width, double height, const char *fill)
{
    study_add(t, "<rect x=\"%s\" y=\"%s\" width=\"%s\" height=\"%s\" style=\"fill:%s\"/>\n", STUDY_FIXED(x, 1), STUDY_FIXED(y, 1),
              STUDY_FIXED(width, 1), STUDY_FIXED(height, 1), fill);
}

void study_label(struct study_text *t, double x, double y, const char *style, const char *text)
{
    study_add(t, "<text x=\"%s\" y=\"%s\" style=\"%s\">", STUDY_FIXED(x, 1), STUDY_FIXED(y, 1), style);
    study_escape(t, text);
    study_add(t, "</text>\n");
}

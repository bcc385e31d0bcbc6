/* output.c - growing text; numbers independent of the locale. */
#include "cli.h"

#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

void output_add(struct output *t, const char *format, ...)
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

const char *output_fixed(char out[32], double value, int decimals)
{
    char   text[64];
    size_t size = 0;
    out[0]      = 0;
    if (!isfinite(value) || fabs(value) >= 1e18) return out;
    snprintf(text, sizeof text, "%.*f", decimals, value);
    for (const char *p = text; *p; p++) {
        if (strchr("-0123456789", *p)) out[size++] = *p;
        else if (size > 0 && out[size - 1] != '.') out[size++] = '.'; /* the locale's decimal point can have several bytes */
    }
    out[size] = 0;
    if (out[0] == '-' && strspn(out, "-0.") == size) memmove(out, out + 1, size); /* -0.00 */
    return out;
}

char *output_read(const char *folder, const char *name, size_t *size)
{
    char  path[2048], *text = NULL;
    FILE *file;
    long  end;
    if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path) return NULL;
    file = fopen(path, "rb");
    if (!file) return NULL;
    if (fseek(file, 0, SEEK_END) == 0 && (end = ftell(file)) >= 0 && fseek(file, 0, SEEK_SET) == 0)
        text = malloc((size_t)end + 1);
    if (text) {
        const size_t got = fread(text, 1, (size_t)end, file);
        text[got]        = 0;
        if (size) *size = got;
    }
    fclose(file);
    return text;
}

int output_save(struct output *t, const char *path)
{
    struct output_file f;
    int                saved = !t->failed;
    if (saved) {
        output_file_open(&f, path);
        output_file_bytes(&f, t->data, t->used);
        saved = output_file_close(&f);
    }
    free(t->data);
    *t = (struct output){0};
    return saved;
}

double axis_step(double span)
{
    static const double factor[] = {1, 2, 5};
    for (double power = 1e-6; power < 1e9; power *= 10)
        for (int i = 0; i < 3; i++)
            if (factor[i] * power * 5 >= span) return factor[i] * power;
    return span;
}

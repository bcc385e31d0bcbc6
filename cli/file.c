/* file.c - writes numbers to files, fast and independent of the locale.
 *
 * A load test writes gigabytes of digits; printf would take most of the time and may write decimal commas.
 * Invariant: files are atomic; errors are kept and reported on close.
 */
#include "cli.h"

#include <math.h>

#include <string.h>

static void file_flush(struct output_file *f)
{
    if (f->used > 0 && f->file && fwrite(f->buffer, 1, f->used, f->file) != f->used) f->failed = 1;
    f->used = 0;
}

void output_file_open(struct output_file *f, const char *path)
{
    f->used   = 0;
    f->failed = snprintf(f->path, sizeof f->path, "%s", path) >= (int)sizeof f->path;
    snprintf(f->temporary, sizeof f->temporary, "%s.part", f->path);
    f->file = f->failed ? NULL : fopen(f->temporary, "wb");
    if (!f->file) f->failed = 1;
}

void output_file_bytes(struct output_file *f, const void *data, size_t size)
{
    const char *from = data;
    while (size > 0) {
        size_t part;
        if (f->used == sizeof f->buffer) file_flush(f);
        part = sizeof f->buffer - f->used;
        if (part > size) part = size;
        memcpy(f->buffer + f->used, from, part);
        f->used += part;
        from += part;
        size -= part;
    }
}

void output_file_text(struct output_file *f, const char *text)
{
    output_file_bytes(f, text, strlen(text));
}

/* Writes at least `least` digits of value before `end`. Returns their start. */
static char *file_digits(char *end, uint64_t value, int least)
{
    char *at = end;
    while (value > 0 || end - at < least) {
        *--at = (char)('0' + value % 10);
        value /= 10;
    }
    return at;
}

void output_file_integer(struct output_file *f, uint64_t value)
{
    char  digits[24], *end = digits + sizeof digits;
    char *at = file_digits(end, value, 1);
    output_file_bytes(f, at, (size_t)(end - at));
}

void output_file_fixed(struct output_file *f, double value, int decimals)
{
    char     digits[32], *end = digits + sizeof digits, *at;
    uint64_t power = 1, scaled;
    for (int i = 0; i < decimals; i++) power *= 10;
    scaled = (uint64_t)(fabs(value) * (double)power + 0.5);
    at     = file_digits(end, scaled % power, decimals);
    *--at  = '.';
    at     = file_digits(at, scaled / power, 1);
    if (value < 0 && scaled > 0) *--at = '-';
    output_file_bytes(f, at, (size_t)(end - at));
}

int output_file_close(struct output_file *f)
{
    file_flush(f);
    if (f->file && fclose(f->file) != 0) f->failed = 1;
    if (f->file && !f->failed && rename(f->temporary, f->path) != 0) /* Windows replaces no file */
        f->failed = remove(f->path) != 0 || rename(f->temporary, f->path) != 0;
    if (f->file && f->failed) remove(f->temporary);
    f->file = NULL;
    return !f->failed;
}

int output_write_pfm(const char *path, const float *value, int width, int height)
{
    struct output_file f;
    char               header[64];
    output_file_open(&f, path);
    snprintf(header, sizeof header, "Pf\n%d %d\n-1.0\n", width, height);
    output_file_text(&f, header);
    for (int y = height - 1; y >= 0; y--)
        for (int x = 0; x < width; x++) {
            uint32_t      bits;
            unsigned char bytes[4];
            memcpy(&bits, value + (size_t)y * (size_t)width + (size_t)x, sizeof bits);
            for (int k = 0; k < 4; k++) bytes[k] = (unsigned char)(bits >> 8 * k);
            output_file_bytes(&f, bytes, 4);
        }
    return output_file_close(&f);
}

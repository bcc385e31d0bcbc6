/* output.c - writes text in memory or to a file, with numbers that do not depend on the locale; reads and
 * writes strings of JSON.
 *
 * A load test writes gigabytes of digits; printf would take most of the time and may write decimal commas.
 *
 * Invariant: files are atomic; errors are kept and reported on close.
 */
#include "cli.h"

#include <errno.h>
#include <math.h>
#include <stdarg.h>
#include <stdlib.h>
#include <string.h>

enum { OUTPUT_FLUSH = 1 << 16 }; /* Size, in bytes, of the pieces in which a file is written. */

static void output_flush(struct output *t)
{
    if (t->used > 0 && fwrite(t->data, 1, t->used, t->file) != t->used) t->failed = 1;
    t->used = 0;
}

void output_bytes(struct output *t, const void *data, size_t size)
{
    if (t->file && t->used + size > OUTPUT_FLUSH) output_flush(t);
    if (!t->failed && t->used + size + 1 > t->capacity) {
        const size_t capacity = 2 * t->capacity + size + 1024;
        char *grown = realloc(t->data, capacity);
        if (grown) t->data = grown, t->capacity = capacity;
        else t->failed = 1;
    }
    if (t->failed) return;
    memcpy(t->data + t->used, data, size);
    t->used += size;
    t->data[t->used] = 0;
}

/* ---------------- numbers */

/* Writes a number, rounded half up; nothing if |value| x 10^decimals is not below 9e18. */
const char *output_fixed(char out[32], double value, int decimals)
{
    unsigned long long scaled;
    double power = 1;
    char *at = out + 31;
    for (int i = 0; i < decimals; i++) power *= 10;
    *at = 0;
    scaled = fabs(value) * power < 9e18 ? (unsigned long long)(fabs(value) * power + 0.5) : 0;
    for (int i = 0, left = fabs(value) * power < 9e18, is_negative = value < 0 && scaled > 0; left; i++) {
        if (i == decimals && i > 0) *--at = '.';
        *--at = (char)('0' + scaled % 10);
        scaled /= 10;
        left = scaled > 0 || i < decimals;
        if (!left && is_negative) *--at = '-';
    }
    return memmove(out, at, strlen(at) + 1);
}

/* ---------------- formats */

/* Adds text, escaped, without the control characters that XML does not have. */
static void output_escaped(struct output *t, const char *text, size_t size)
{
    static const char special[] = "&<>\"'";
    static const char *const escape[] = {"&amp;", "&lt;", "&gt;", "&quot;", "&#39;"};
    for (size_t i = 0; i < size; i++) {
        const char *found = strchr(special, text[i]);
        if (found) output_add(t, "%s", escape[found - special]);
        else if ((unsigned char)text[i] >= ' ' || strchr("\t\n\r", text[i])) output_bytes(t, text + i, 1);
    }
}

static void output_json(struct output *t, const char *value)
{
    char *text = json_string(value);
    if (text) output_escaped(t, text, strlen(text));
    else if (value && strncmp(value, "null", 4) != 0)
        output_escaped(t, value, (size_t)(oxl_json_end(value) - value));
    else output_add(t, "unknown");
    free(text);
}

void output_add(struct output *t, const char *format, ...)
{
    va_list list;
    va_start(list, format);
    for (const char *at = format; *at;) {
        const size_t plain = strcspn(at, "%"), size = strcspn(at + plain, "dfsSJzl") + 1;
        const char *type = at + plain + size - 1, *text = "";
        char digits[40], spec[8] = "";
        output_bytes(t, at, plain);
        if (!at[plain]) break;
        if (at[plain + 1] == '%') {
            output_bytes(t, "%", 1);
            at += plain + 2;
            continue;
        }
        memcpy(spec, at + plain, size < sizeof spec ? size : 0);
        at = type + (*type == 'z' ? 2 : *type == 'l' ? 3 : 1);
        switch (*type) {
        case 'd': snprintf(digits, sizeof digits, spec, va_arg(list, int)); break;
        case 'f': output_fixed(digits, va_arg(list, double), atoi(spec + 2)); break;
        case 'z': snprintf(digits, sizeof digits, "%zu", va_arg(list, size_t)); break;
        case 'l': snprintf(digits, sizeof digits, "%llu", va_arg(list, unsigned long long)); break;
        default: text = va_arg(list, const char *); digits[0] = 0;
        }
        if (*type == 'J') output_json(t, text);
        else if (*type == 'S' && text) output_escaped(t, text, strlen(text));
        else if (*type == 's') output_bytes(t, text, strlen(text));
        else output_bytes(t, digits, strlen(digits));
    }
    va_end(list);
}

/* Writes a count; numbers of more than four digits have narrow no-break spaces between groups of three. */
const char *output_count(char out[40], double value)
{
    char digits[32];
    size_t length, used = 0;
    output_fixed(digits, floor(value + 0.5), 0);
    length = strlen(digits);
    for (size_t i = 0; i < length; i++) {
        if (i > 0 && (length - i) % 3 == 0 && length > 4 && digits[i - 1] != '-') {
            memcpy(out + used, "\xE2\x80\xAF", 3);
            used += 3;
        }
        out[used++] = digits[i];
    }
    out[used] = 0;
    return length ? out : memcpy(out, "-", 2);
}

const char *output_size(char out[40], double value)
{
    if (!(value >= 0)) return memcpy(out, "-", 2);
    if (value < 1e6) snprintf(out, 40, "%s KB", OUTPUT_FIXED(value / 1e3, 1));
    else if (value < 1e9) snprintf(out, 40, "%s MB", OUTPUT_FIXED(value / 1e6, 1));
    else snprintf(out, 40, "%s GB", OUTPUT_FIXED(value / 1e9, 2));
    return out;
}

const char *output_seconds(char out[40], double value)
{
    if (!(value >= 0)) return memcpy(out, "-", 2);
    if (value < 120) snprintf(out, 40, "%s s", OUTPUT_FIXED(value, value < 10 ? 1 : 0));
    else if (value < 7200) snprintf(out, 40, "%s min", OUTPUT_FIXED(value / 60, 1));
    else snprintf(out, 40, "%s h", OUTPUT_FIXED(value / 3600, 1));
    return out;
}

double axis_step(double span)
{
    static const double factor[] = {1, 2, 5};
    for (double power = 1e-6; power < 1e9; power *= 10)
        for (int i = 0; i < 3; i++)
            if (factor[i] * power * 5 >= span) return factor[i] * power;
    return span;
}

/* ---------------- files */

const char *output_split(const char *path, char folder[4096])
{
    const char *slash = strrchr(path, '/');
    snprintf(folder, 4096, "%.*s", slash ? (int)(slash - path) : 1, slash ? path : ".");
    return slash ? slash + 1 : path;
}

char *output_read(const char *folder, const char *name)
{
    char path[4200], *text = NULL;
    FILE *file;
    long end;
    if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path) return NULL;
    file = oxl_open(path);
    if (!file) return NULL;
    if (fseek(file, 0, SEEK_END) == 0 && (end = ftell(file)) >= 0 && fseek(file, 0, SEEK_SET) == 0)
        text = malloc((size_t)end + 1);
    if (text) text[fread(text, 1, (size_t)end, file)] = 0;
    fclose(file);
    return text;
}

/* Returns 1 if the file holds `mark`, which is shorter than a piece. Keeps the end of each
 * piece, where a mark may begin. */
static int output_has(FILE *file, const char *mark)
{
    enum { PIECE = 1 << 14 };
    char piece[2 * PIECE];
    const size_t size = strlen(mark);
    size_t kept = 0, got;
    while ((got = fread(piece + kept, 1, PIECE, file)) > 0) {
        const char *end = piece + kept + got;
        for (const char *at = piece; (at = memchr(at, mark[0], (size_t)(end - at))); at++)
            if ((size_t)(end - at) < size) break;
            else if (memcmp(at, mark, size) == 0) return 1;
        kept = kept + got < size ? kept + got : size - 1;
        memmove(piece, end - kept, kept);
    }
    return 0;
}

oxl_result output_check_own(oxl_context *ctx, const char *folder, const char *name, const char *mark)
{
    char path[4200];
    FILE *file;
    int is_own;
    if (snprintf(path, sizeof path, "%s/%s", folder, name) >= (int)sizeof path) return OXL_OK;
    file = oxl_open(path);
    if (!file && (errno == ENOENT || errno == ENOTDIR)) return OXL_OK;
    is_own = file && mark && (!mark[0] || output_has(file, mark));
    if (file) fclose(file);
    return is_own ? OXL_OK
                  : oxl_fail(ctx, OXL_ERR_USAGE,
                             "%s exists, and OceanXL did not write it\nfix: choose another folder, or move "
                             "the file away",
                             path);
}

void output_integer(struct output *t, uint64_t value, int size)
{
    unsigned char b[8];
    for (int i = 0; i < size; i++) b[i] = (unsigned char)(value >> 8 * i);
    output_bytes(t, b, (size_t)size);
}

void output_real(struct output *t, double value, int size)
{
    const float single = (float)value;
    uint64_t bits;
    uint32_t few;
    memcpy(&bits, &value, sizeof bits);
    memcpy(&few, &single, sizeof few);
    output_integer(t, size == 8 ? bits : few, size);
}

void output_open(struct output *t, const char *path)
{
    if (snprintf(t->path, sizeof t->path, "%s", path) >= (int)sizeof t->path) t->failed = 1;
    t->file = t->failed ? NULL : oxl_create_beside(t->path, t->temporary, sizeof t->temporary);
    if (!t->file) t->failed = 1;
}

oxl_result output_close(oxl_context *ctx, struct output *t)
{
    int written = !t->failed;
    oxl_result rc = OXL_OK;
    if (t->file) {
        output_flush(t);
        written = fclose(t->file) == 0 && !t->failed;
        if (written) written = oxl_rename(t->temporary, t->path) == 0;
        if (!written) oxl_remove(t->temporary);
    }
    if (!written)
        rc = oxl_fail(
            ctx, OXL_ERR_IO,
            "%s cannot be written\nfix: choose a folder that you may write to, on a disk with free space",
            t->path);
    free(t->data);
    *t = (struct output){0};
    return rc;
}

oxl_result output_save(oxl_context *ctx, struct output *t, const char *path)
{
    output_open(t, path);
    return output_close(ctx, t);
}

/* ---------------- what a terminal shows */

/* Returns how many bytes of a character that moves the cursor, or changes the terminal or the order in which it shows
 * characters, stand at s; 0: another. */
static size_t print_controls(const unsigned char *s)
{
    if (s[0] < ' ' || s[0] == 0x7F) return s[0] != '\n' && s[0] != '\t';
    if (s[0] == 0xC2 && s[1] >= 0x80 && s[1] < 0xA0) return 2;
    return s[0] == 0xE2 && ((s[1] == 0x80 && s[2] >= 0xAA && s[2] <= 0xAE) ||
                            (s[1] == 0x81 && s[2] >= 0xA6 && s[2] <= 0xA9))
               ? 3
               : 0;
}

void print_text(FILE *to, const char *text)
{
    for (const unsigned char *s = (const unsigned char *)text; *s;) {
        const size_t bytes = print_controls(s);
        if (!bytes) fputc(*s++, to);
        for (const unsigned char *end = s + bytes; s < end; s++) fprintf(to, "\\x%02x", *s);
    }
}

void print_format(FILE *to, const char *format, ...)
{
    va_list list;
    char *text = NULL;
    int length;
    va_start(list, format);
    length = vsnprintf(NULL, 0, format, list);
    va_end(list);
    if (length >= 0) text = malloc((size_t)length + 1);
    if (!text) return;
    va_start(list, format);
    vsnprintf(text, (size_t)length + 1, format, list);
    va_end(list);
    print_text(to, text);
    free(text);
}

/* ---------------- strings of JSON */

char *json_string(const char *value)
{
    const size_t room = oxl_json_room(value);
    char *out = room ? malloc(room) : NULL;
    if (out) oxl_json_text(value, out, room);
    return out;
}

void json_print(FILE *to, const char *text)
{
    char character[8];
    fputc('"', to);
    while (*text) {
        text += oxl_json_escape(text, character);
        fputs(character, to);
    }
    fputc('"', to);
}

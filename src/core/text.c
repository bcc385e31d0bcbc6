/* text.c - makes growing text, copies of text, and paths. */
#include "core.h"
#include "../../oceanxl_job.h"

OXL_INTERNAL void text_add(struct text *t, const char *format, ...)
{
    va_list args;
    int length;
    if (t->failed) return;
    va_start(args, format);
    length = vsnprintf(NULL, 0, format, args);
    va_end(args);
    if (length < 0 ||
        oxl_reserve(t->ctx, &t->data, &t->capacity, t->size + (size_t)length + 1, 1) != OXL_OK) {
        t->failed = 1;
        return;
    }
    va_start(args, format);
    vsnprintf(t->data + t->size, (size_t)length + 1, format, args);
    va_end(args);
    t->size += (size_t)length;
}

/* ---------------- JSON */

/* Counts the bytes of the UTF-8 character at s; 0: no character begins there. */
static size_t json_character(const unsigned char *s)
{
    const size_t size = s[0] < 0x80   ? 1
                        : s[0] < 0xC2 ? 0
                        : s[0] < 0xE0 ? 2
                        : s[0] < 0xF0 ? 3
                        : s[0] < 0xF5 ? 4
                                      : 0;
    for (size_t i = 1; i < size; i++)
        if ((s[i] & 0xC0) != 0x80) return 0;
    if ((s[0] == 0xE0 && s[1] < 0xA0) || (s[0] == 0xED && s[1] > 0x9F)) return 0;
    return (s[0] == 0xF0 && s[1] < 0x90) || (s[0] == 0xF4 && s[1] > 0x8F) ? 0 : size;
}

size_t oxl_json_escape(const char *s, char out[8])
{
    const unsigned char c = (unsigned char)*s;
    const size_t size = json_character((const unsigned char *)s);
    if (c == '"' || c == '\\') snprintf(out, 8, "\\%c", c);
    else if (c == 0xC2 && size == 2 && (unsigned char)s[1] < 0xA0) /* a control character of two bytes */
        snprintf(out, 8, "\\u%04x", (unsigned)(unsigned char)s[1]);
    else if (c < 0x20 || c == 0x7F || size == 0)
        snprintf(out, 8, "\\u%04x", size ? (unsigned)c : JSON_LOW + (unsigned)c);
    else snprintf(out, 8, "%.*s", (int)size, s);
    return OXL_MAX(size, 1);
}

const char *oxl_json_number_text(char out[48], double value)
{
    return number_text(out, value);
}

OXL_INTERNAL void text_add_json_string(struct text *t, const char *s)
{
    char character[8];
    text_add(t, "\"");
    while (*s) {
        s += oxl_json_escape(s, character);
        text_add(t, "%s", character);
    }
    text_add(t, "\"");
}

OXL_INTERNAL void text_free(struct text *t)
{
    oxl_free(t->ctx, t->data);
    *t = (struct text){.ctx = t->ctx};
}

OXL_INTERNAL oxl_result text_take(struct text *t, char **out)
{
    const int failed = t->failed;
    *out = NULL;
    if (failed) text_free(t);
    else *out = t->data;
    *t = (struct text){.ctx = t->ctx};
    return failed ? OXL_ERR_MEMORY : OXL_OK;
}

void oxl_text_free(oxl_context *ctx, char *text)
{
    oxl_free(ctx, text);
}

OXL_INTERNAL char *oxl_strdup(oxl_context *ctx, const char *s)
{
    const size_t size = strlen(s) + 1;
    char *copy = oxl_alloc(ctx, size, 1);
    if (copy) memcpy(copy, s, size);
    return copy;
}

/* ---------------- paths */

OXL_INTERNAL const char *path_in(char out[PATH_LENGTH], const char *folder, const char *format, ...)
{
    const size_t size = strlen(folder), slash = size > 0 && folder[size - 1] != '/', at = size + slash;
    int rest = PATH_LENGTH;
    va_list args;
    if (at < PATH_LENGTH) {
        memcpy(out, folder, size);
        memcpy(out + size, "/", slash);
        va_start(args, format);
        rest = vsnprintf(out + at, PATH_LENGTH - at, format, args);
        va_end(args);
    }
    return rest >= 0 && at + (size_t)rest < PATH_LENGTH ? out : "/dev/null/a path of more than 4095 bytes";
}

/* Adds text after `used` bytes, if room remains for the quote that ends the word. */
static size_t path_add(char *out, size_t size, size_t used, const char *text)
{
    const size_t length = strlen(text);
    if (used + length + 2 > size) return size; /* Stops all further additions. */
    memcpy(out + used, text, length + 1);
    return used + length;
}

const char *oxl_shell_word(const char *path, char *out, size_t size)
{
    static const char plain[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789_./,-+:@%";
    const char *quote = path[0] && strspn(path, plain) == strlen(path) ? "" : "'";
    size_t used = 0;
    if (size) out[0] = 0;
    if (size < 8) return out;
    used = path_add(out, size, used, quote);
    for (; *path && used < size; path++)
        used = path_add(out, size, used, *path == '\'' ? "'\\''" : (char[2]){*path, 0});
    return strcat(out, quote);
}

OXL_INTERNAL const char *path_base_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

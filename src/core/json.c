/* json.c - see json.h. */
#include "core.h"

#include "json.h"

static const char *json_blank(const char *at)
{
    return at + strspn(at, " \t\r\n");
}

/* Skips the string at p. */
static const char *json_past_string(const char *at)
{
    for (at++; *at && *at != '"'; at++)
        if (*at == '\\' && at[1]) at++;
    return *at ? at + 1 : at;
}

static const char *json_past(const char *at)
{
    int depth = 0;
    if (*at != '{' && *at != '[') return *at == '"' ? json_past_string(at) : at + strcspn(at, ",]} \t\r\n");
    do {
        if (*at == '"') {
            at = json_past_string(at);
            continue;
        }
        depth += (*at == '{' || *at == '[') - (*at == '}' || *at == ']');
        at++;
    } while (*at && depth > 0);
    return at;
}

const char *oxl_json_error(const char *text)
{
    const char *at    = json_blank(text);
    int         depth = 0;
    if (*at != '{' && *at != '[') return at;
    do {
        if (*at == '"') {
            at = json_past_string(at);
            if (at[-1] != '"') return at;
            continue;
        }
        depth += (*at == '{' || *at == '[') - (*at == '}' || *at == ']');
        if (*at) at++;
    } while (*at && depth > 0);
    at = json_blank(at);
    return depth == 0 && *at == 0 ? NULL : at;
}

/* The value after the comma, or NULL at the end of the object or array. */
const char *oxl_json_next(const char *value)
{
    const char *at = value ? json_blank(json_past(value)) : "";
    return *at == ',' ? json_blank(at + 1) : NULL;
}

const char *oxl_json_first(const char *value)
{
    const char *at = value ? json_blank(value) : NULL;
    if (!at || (*at != '[' && *at != '{')) return NULL;
    at = json_blank(at + 1);
    return *at && *at != ']' && *at != '}' ? at : NULL;
}

const char *oxl_json_value(const char *key)
{
    const char *at = key && *key == '"' ? json_blank(json_past_string(key)) : NULL;
    return at && *at == ':' ? json_blank(at + 1) : NULL;
}

const char *oxl_json_member(const char *object, const char *name)
{
    const size_t length = strlen(name);
    const char  *at     = object ? json_blank(object) : NULL;
    if (!at || *at != '{') return NULL;
    for (at = oxl_json_first(at); at && *at == '"';) {
        const char *value = oxl_json_value(at);
        if (!value) return NULL;
        if (strncmp(at + 1, name, length) == 0 && at[1 + length] == '"') return value;
        at = oxl_json_next(value);
    }
    return NULL;
}

double oxl_json_number_at(const char **cursor)
{
    const char *at = *cursor;
    double      value;
    if (*at != '-' && (*at < '0' || *at > '9')) return NAN;
    if (!parse_double(&at, at + strcspn(at, ",]} \t\r\n"), &value)) return NAN;
    *cursor = at;
    return value;
}

double oxl_json_number(const char *object, const char *name)
{
    const char *value = oxl_json_member(object, name);
    return value ? oxl_json_number_at(&value) : NAN;
}

int oxl_json_is_true(const char *object, const char *name)
{
    const char *value = oxl_json_member(object, name);
    return value && strncmp(value, "true", 4) == 0;
}

/* ---------------------------------------------------------------- strings */

/* Writes a 16-bit character as UTF-8; returns its length, at most half of the escape's. */
static size_t json_put(char *out, unsigned long code)
{
    if (code < 0x80) {
        out[0] = (char)code;
        return 1;
    }
    if (code < 0x800) {
        out[0] = (char)(0xC0 | code >> 6), out[1] = (char)(0x80 | (code & 63));
        return 2;
    }
    out[0] = (char)(0xE0 | code >> 12), out[1] = (char)(0x80 | (code >> 6 & 63)), out[2] = (char)(0x80 | (code & 63));
    return 3;
}

static size_t json_unescape(const char **cursor, char *out)
{
    static const char from[] = "\"\\/bfnrt", to[] = "\"\\/\b\f\n\r\t";
    const char       *at        = *cursor, *known;
    char              digits[5] = {0};
    if (*at == 'u' && strspn(at + 1, "0123456789abcdefABCDEF") >= 4) {
        memcpy(digits, at + 1, 4);
        *cursor = at + 5;
        return json_put(out, strtoul(digits, NULL, 16));
    }
    known   = strchr(from, *at);
    out[0]  = known ? to[known - from] : *at;
    *cursor = at + 1;
    return 1;
}

size_t oxl_json_room(const char *value)
{
    return value && *value == '"' ? (size_t)(json_past_string(value) - value) + 4 : 0;
}

size_t oxl_json_text(const char *value, char *out, size_t size)
{
    char *to = out;
    if (size) *out = 0;
    if (!value || *value != '"' || oxl_json_room(value) > size) return 0;
    for (const char *at = value + 1; *at && *at != '"';) {
        if (*at == '\\' && at[1]) {
            at++;
            to += json_unescape(&at, to);
        } else *to++ = *at++;
    }
    *to = 0;
    return (size_t)(to - out);
}

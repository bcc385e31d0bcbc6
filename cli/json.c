/* json.c - a cursor over JSON text: what the library writes, read back by the tools without building a tree.
 *
 * A value is a pointer to its first byte within the text, and NULL is the value that is not there: it has no members, no number.
 * Invariant: no function reads past the 0 at the text's end, whatever the text holds.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const char *json_blank(const char *at)
{
    return at + strspn(at, " \t\r\n");
}

/* Past the string that begins here. */
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

/* What stands after the comma, or NULL at the end of the object or array. */
static const char *json_after(const char *value)
{
    const char *at = json_blank(json_past(value));
    return *at == ',' ? json_blank(at + 1) : NULL;
}

const char *json_member(const char *object, const char *name)
{
    const size_t length = strlen(name);
    const char  *at     = object ? json_blank(object) : NULL;
    if (!at || *at != '{') return NULL;
    for (at = json_blank(at + 1); at && *at == '"';) {
        const char *value = json_blank(json_past_string(at));
        if (*value != ':') return NULL;
        value = json_blank(value + 1);
        if (strncmp(at + 1, name, length) == 0 && at[1 + length] == '"') return value;
        at = json_after(value);
    }
    return NULL;
}

const char *json_first(const char *array)
{
    const char *at = array ? json_blank(array) : NULL;
    if (!at || *at != '[') return NULL;
    at = json_blank(at + 1);
    return *at && *at != ']' ? at : NULL;
}

const char *json_next(const char *element)
{
    return json_after(element);
}

double json_number_at(const char **cursor)
{
    const char *at    = *cursor;
    double      value = 0, sign = 1;
    int         exponent = 0;
    if (*at == '-') sign = -1, at++;
    if (*at < '0' || *at > '9') return NAN;
    for (; *at >= '0' && *at <= '9'; at++) value = 10 * value + (*at - '0');
    if (*at == '.')
        for (at++; *at >= '0' && *at <= '9'; at++) value = 10 * value + (*at - '0'), exponent--;
    if (*at == 'e' || *at == 'E') {
        char *end;
        exponent += (int)strtol(at + 1, &end, 10);
        at = end;
    }
    *cursor = at;
    return sign * (exponent < 0 ? value / pow(10, -exponent) : value * pow(10, exponent));
}

double json_number(const char *object, const char *name)
{
    const char *value = json_member(object, name);
    return value ? json_number_at(&value) : NAN;
}

int json_is_true(const char *object, const char *name)
{
    const char *value = json_member(object, name);
    return value && strncmp(value, "true", 4) == 0;
}

/* One character of up to 16 bits as UTF-8; returns its length. The library escapes control characters alone, which are below 128. */
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

char *json_string(const char *value)
{
    char  *out, *to;
    size_t length;
    if (!value || *value != '"') return NULL;
    length = (size_t)(json_past_string(value) - value);
    out = to = malloc(length + 4);
    if (!out) return NULL;
    for (const char *at = value + 1; *at && *at != '"';) {
        if (*at == '\\' && at[1]) {
            at++;
            to += json_unescape(&at, to);
        } else *to++ = *at++;
    }
    *to = 0;
    return out;
}

/* json.c - reads JSON text (json.h). */
#include "json.h"
#include "../core/core.h"

static const char *json_blank(const char *at)
{
    return at + strspn(at, " \t\r\n");
}

/* Returns the position after the string at `at`. */
static const char *json_past_string(const char *at)
{
    for (at++; *at && *at != '"'; at++)
        if (*at == '\\' && at[1]) at++;
    return *at ? at + 1 : at;
}

/* Goes past an object or array, and counts in *depth the brackets that are still open, of any kind. */
static const char *json_past_brackets(const char *at, int *depth)
{
    *depth = 0;
    do {
        if (*at == '"') {
            at = json_past_string(at);
            continue;
        }
        *depth += (*at == '{' || *at == '[') - (*at == '}' || *at == ']');
        at += *at != 0;
    } while (*at && *depth > 0);
    return at;
}

const char *oxl_json_end(const char *at)
{
    int depth;
    if (*at == '{' || *at == '[') return json_past_brackets(at, &depth);
    return *at == '"' ? json_past_string(at) : at + strcspn(at, ",]} \t\r\n");
}

/* Counts brackets and skips strings; a text whose root is no object and no array is an error at its start. */
const char *oxl_json_error(const char *text)
{
    const char *at = json_blank(text);
    int depth;
    if (*at != '{' && *at != '[') return at;
    at = json_blank(json_past_brackets(at, &depth));
    return depth == 0 && *at == 0 ? NULL : at;
}

/* Returns the value after the comma, or NULL at the end of the object or array. */
const char *oxl_json_next(const char *value)
{
    const char *at = value ? json_blank(oxl_json_end(value)) : "";
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

/* Goes through the object's keys in order: of equal ones the first counts. */
const char *oxl_json_member(const char *object, const char *name)
{
    const size_t length = strlen(name);
    const char *at = object ? json_blank(object) : NULL;
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
    double value;
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

/* ---------------- strings */

/* Writes a character as UTF-8; returns its length, at most half of the escapes'. Surrogates DC80 to DCFF,
 * which no text holds alone, become the bytes 80 to FF (Python's surrogateescape): names of files that are
 * not UTF-8 come back as they were. */
static size_t json_put(char *out, unsigned long code)
{
    const int more = code >= 0x10000 ? 3 : code >= 0x800 ? 2 : code >= 0x80; /* bytes behind the first */
    if (code >= JSON_LOW + 0x80 && code <= JSON_LOW + 0xFF) return *out = (char)(code & 0xFF), 1;
    out[0] = (char)((more ? 0xFF00 >> (more + 1) & 0xFF : 0) | code >> 6 * more);
    for (int i = 1; i <= more; i++) out[i] = (char)(0x80 | (code >> 6 * (more - i) & 63));
    return (size_t)more + 1;
}

/* Reads uXXXX at `at`; returns 0 for anything else. */
static unsigned long json_code(const char *at)
{
    char digits[5] = {0};
    if (*at != 'u' || strspn(at + 1, "0123456789abcdefABCDEF") < 4) return 0;
    memcpy(digits, at + 1, 4);
    return strtoul(digits, NULL, 16);
}

static size_t json_unescape(const char **cursor, char *out)
{
    static const char from[] = "\"\\/bfnrt", to[] = "\"\\/\b\f\n\r\t";
    const char *at = *cursor, *known;
    unsigned long code = json_code(at), second;
    if (code) {
        *cursor = at + 5;
        second = code - JSON_HIGH < JSON_SURROGATES && at[5] == '\\' ? json_code(at + 6) : 0;
        if (second - JSON_LOW < JSON_SURROGATES) { /* Joins two surrogates into one character. */
            *cursor = at + 11;
            code = 0x10000 + ((code - JSON_HIGH) << 10) + (second - JSON_LOW);
        }
        return json_put(out, code);
    }
    known = strchr(from, *at);
    out[0] = known ? to[known - from] : *at;
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

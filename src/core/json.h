/* json.h - a cursor over JSON text, without a tree: for what the library writes and for what other programs write about surveys.
 *
 * A value is a pointer to its first byte within the text, and NULL is the value that is not there: it has no members, no number.
 * The functions are no part of the API; they are not OXL_INTERNAL, since the program reads JSON by them too.
 * Invariant: no function reads past the 0 at the text's end, whatever the text holds.
 */
#ifndef OXL_JSON_H
#define OXL_JSON_H

#include <stddef.h>

/* NULL when brackets and strings are closed and nothing follows; else where the text goes wrong or ends too early. */
const char *oxl_json_fault(const char *text);

/* The first element of an array, the first key of an object; what follows an element, or the value of a key; what a key names. */
const char *oxl_json_first(const char *value);
const char *oxl_json_next(const char *value);
const char *oxl_json_value(const char *key);

const char *oxl_json_member(const char *object, const char *name);
double      oxl_json_number_at(const char **cursor); /* past it; NAN when there is none */
double      oxl_json_number(const char *object, const char *name);
int         oxl_json_is_true(const char *object, const char *name);

/* The string, unescaped and terminated, into `size` bytes; its length, or 0 when it is none or does not fit. A string never becomes
 * longer than it stands. */
size_t oxl_json_text(const char *value, char *out, size_t size);
size_t oxl_json_room(const char *value); /* bytes that oxl_json_text may need */

#endif

/* json_text.h - text.c: numbers and characters as JSON has them. The library and the program use it, so that
 * they are not OXL_INTERNAL.
 */
#ifndef OXL_JSON_TEXT_H
#define OXL_JSON_TEXT_H

#include <stddef.h>

enum { JSON_LOW = 0xDC00, JSON_HIGH = 0xD800, JSON_SURROGATES = 0x400 }; /* of UTF-16 */

/* Writes the character at s for a string of JSON; returns the bytes that it takes of s. A byte that is not
 * of UTF-8 comes back from oxl_json_text. */
size_t oxl_json_escape(const char *s, char out[8]);
/* Writes the shortest text that parses to the same value; null: not finite. Returns out. */
const char *oxl_json_number_text(char out[48], double value);

#endif

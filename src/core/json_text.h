/* json_text.h - declares the functions of text.c that write numbers and characters of JSON. They are not
 * OXL_INTERNAL, since the program calls them, too.
 */
#ifndef OXL_JSON_TEXT_H
#define OXL_JSON_TEXT_H

#include <stddef.h>

/* Lists UTF-16's first low surrogate, its first high one, and the number of each. */
enum { JSON_LOW = 0xDC00, JSON_HIGH = 0xD800, JSON_SURROGATES = 0x400 };

/* Writes the character at s for a string of JSON and returns the number of its bytes in s. A byte that is not
 * UTF-8 becomes a low surrogate, from which oxl_json_text restores it. */
size_t oxl_json_escape(const char *s, char out[8]);
/* Writes a number as text that parses to the same value, or "null" if it is not finite; returns out. */
const char *oxl_json_number_text(char out[48], double value);

#endif

/* json.h - reads JSON text through a cursor, without building a tree.
 *
 * A value is a pointer to its first byte in the text; NULL is a missing value, without members or number.
 * All but oxl_json_error are public: oceanxl_job.h declares them, too.
 * Invariant: no function reads past the terminating 0, for any text.
 */
#ifndef OXL_JSON_H
#define OXL_JSON_H

#include "../core/json_text.h"

/* Returns NULL if every bracket and string is closed and nothing follows; otherwise the position of the
 * error. Not a validator: brackets are counted, their kind is not compared ("[}" passes). The functions
 * below treat what they cannot parse as a missing value. */
const char *oxl_json_error(const char *text);

/* Find places in an array or object: oxl_json_first its first element or key, oxl_json_next the element
 * after an element or the key after a value, oxl_json_value a key's value, oxl_json_end the first byte
 * after a value. */
const char *oxl_json_first(const char *value);
const char *oxl_json_next(const char *value);
const char *oxl_json_value(const char *key);
const char *oxl_json_end(const char *value);

const char *oxl_json_member(const char *object, const char *name);
double oxl_json_number_at(const char **cursor); /* moves the cursor past the number; NAN: there is none */
double oxl_json_number(const char *object, const char *name);
int oxl_json_is_true(const char *object, const char *name);

/* Unescapes the string into `size` bytes, terminated; returns its length, or 0 if the value is no string or
 * does not fit. The result is never longer than the source. */
size_t oxl_json_text(const char *value, char *out, size_t size);
size_t oxl_json_room(const char *value); /* bytes that oxl_json_text needs at most */

#endif

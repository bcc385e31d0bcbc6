/* json.h - reads JSON text through a cursor, without building a tree; oceanxl_job.h declares the rest of it.
 *
 * A value is a pointer to its first byte in the text; NULL is a missing value, without members or number.
 * Invariant: no function reads past the terminating 0, for any text.
 */
#ifndef OXL_JSON_H
#define OXL_JSON_H

#include "../../oceanxl_job.h"

/* Returns NULL if every bracket and string is closed and nothing follows; otherwise the position of the
 * error. Not a validator: brackets are counted, their kind is not compared ("[}" passes). The functions
 * of oceanxl_job.h treat what they cannot parse as a missing value. */
const char *oxl_json_error(const char *text);

#endif

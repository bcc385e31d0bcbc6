/* json.c - a string of a JSON text in memory of its own; the rest of reading JSON is the library's (src/core/json.h). */
#include "cli.h"

#include <stdlib.h>

char *json_string(const char *value)
{
    const size_t room = oxl_json_room(value);
    char        *out  = room ? malloc(room) : NULL;
    if (out) oxl_json_text(value, out, room);
    return out;
}

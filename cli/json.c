/* json.c - strings of JSON: read into memory of their own, printed. The rest of reading is the library's (src/core/json.h). */
#include "cli.h"

#include <stdlib.h>

char *json_string(const char *value)
{
    const size_t room = oxl_json_room(value);
    char        *out  = room ? malloc(room) : NULL;
    if (out) oxl_json_text(value, out, room);
    return out;
}

void json_print(FILE *to, const char *text)
{
    char character[8];
    fputc('"', to);
    while (*text) {
        text += oxl_json_escape(text, character);
        fputs(character, to);
    }
    fputc('"', to);
}

/* nonfinite_record.c - adds counts of values that are not finite over blocks, and keeps them in block.json
 * and run.json.
 */
#include "large.h"
#include "../formats/json.h"

#include <stddef.h>

#define NONFINITE_COUNT_MAX 1e9 /* Limits a count in a file, so that it fits 32 bits. */

static const struct nonfinite_member {
    const char *name;
    size_t at;
} NONFINITE_MEMBERS[] = {{"images_left_out", offsetof(oxl_nonfinite, images)},
                         {"steps_skipped", offsetof(oxl_nonfinite, steps)},
                         {"gaussian_steps_skipped", offsetof(oxl_nonfinite, rows)},
                         {"gaussians_cleared", offsetof(oxl_nonfinite, cleared)},
                         {"gaussians_degenerate", offsetof(oxl_nonfinite, degenerate)}};

OXL_INTERNAL void nonfinite_add_json(struct text *t, const oxl_nonfinite *n)
{
    for (size_t i = 0; i < OXL_COUNT(NONFINITE_MEMBERS); i++)
        text_add(t, "  \"%s\": %zu,\n", NONFINITE_MEMBERS[i].name,
                 *(const size_t *)((const char *)n + NONFINITE_MEMBERS[i].at));
}

OXL_INTERNAL void nonfinite_read_json(const char *text, oxl_nonfinite *n)
{
    for (size_t i = 0; i < OXL_COUNT(NONFINITE_MEMBERS); i++) {
        const double count = oxl_json_number(text, NONFINITE_MEMBERS[i].name);
        *(size_t *)((char *)n + NONFINITE_MEMBERS[i].at) =
            count > 0 ? (size_t)OXL_MIN(count, NONFINITE_COUNT_MAX) : 0;
    }
}

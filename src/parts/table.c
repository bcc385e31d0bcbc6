/* table.c - the table of parts: the loop calls their hooks through it, and the table of options takes their
 * rows from it. */
#include "../train/part.h"
#include "../core/option_rows.h"
#include "parts.h"

#define PARTS_DECLARE(name) OXL_TABLE const struct part part_##name;
PARTS_EACH(PARTS_DECLARE)

#define PARTS_ROW(name) &part_##name,
static const struct part *const PARTS[] = {PARTS_EACH(PARTS_ROW) NULL};

OXL_INTERNAL const struct part *parts_at(int index)
{
    return PARTS[index];
}

OXL_INTERNAL const oxl_option *parts_option(int index)
{
    for (int k = 0; PARTS[k]; k++)
        for (const oxl_option *o = PARTS[k]->option; o && o->name; o++)
            if (index-- == 0) return o;
    return NULL;
}

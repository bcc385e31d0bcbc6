/* option_rows.h - defines words for rows of the table of options, for options.c and the parts of training,
 * which add rows of their own. A row is
 *
 *     {name, value, kind, field, lowest, highest, default, tier, use, group, help}
 */
#ifndef OXL_OPTION_ROWS_H
#define OXL_OPTION_ROWS_H

#include "core.h"
#include "../../oceanxl_job.h"

#include <stddef.h>

#define OPTION_AT(member) offsetof(oxl_job_options, member), #member
#define EACH(text)       \
    {                    \
        text, text, text \
    }
#define PRESETS(draft, standard, paper) \
    {                                   \
        draft, standard, paper          \
    }
#define SURVEY OXL_OPTION_OF_SURVEY
#define TRAINING OXL_OPTION_OF_TRAINING
#define RUN OXL_OPTION_OF_RUN
#define RESULT OXL_OPTION_OF_RESULT
#define NOT_REFINED OXL_OPTION_NOT_REFINED
#define ONE_BLOCK OXL_OPTION_ONE_BLOCK

/* Returns the index-th row that the parts of training add, or NULL; from src/parts/table.c, which
 * this layer reads as data. */
OXL_INTERNAL const oxl_option *parts_option(int index);

#endif

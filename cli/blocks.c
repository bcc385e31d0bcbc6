/* blocks.c - tables of a partition: content and predicted cost of each block, and balance compared with the baseline. */
#include "cli.h"

enum { ROWS = 60 }; /* blocks that are listed; partition.txt has them all */

static void print_row(FILE *to, const char *what, const char *balanced, const char *midpoint)
{
    fprintf(to, "%-34s%11s%11s\n", what, balanced, midpoint);
}

void blocks_print(FILE *to, const oxl_partition_report *r)
{
    const oxl_balance *b = &r->balance[OXL_CUT_BALANCED], *m = &r->balance[OXL_CUT_MIDPOINT];
    fprintf(to, "%6s %10s %10s %6s %7s %11s %10s\n", "block", "points", "starts", "base", "border", "memory", "time");
    for (int i = 0; i < r->block_count && i < ROWS; i++) {
        const oxl_block *k = &r->block[i];
        fprintf(to, "%6d %10zu %10zu %6d %7d %11s %10s\n", i, k->points, k->start_points, k->base_views, k->border_views,
                OUTPUT_SIZE(k->memory), OUTPUT_SECONDS(k->seconds));
    }
    if (r->block_count > ROWS) fprintf(to, "   ... and %d more\n", r->block_count - ROWS);
    fprintf(to, "\n%-34s%11s%11s   (%s was used)\n", "", "balanced", "midpoint",
            r->cut == OXL_CUT_MIDPOINT ? "midpoint" : "balanced");
    print_row(to, "blocks", OUTPUT_FIXED(b->blocks, 0), OUTPUT_FIXED(m->blocks, 0));
    print_row(to, "points a block, largest / mean", OUTPUT_FIXED(b->points_peak, 3), OUTPUT_FIXED(m->points_peak, 3));
    print_row(to, "  coefficient of variation", OUTPUT_FIXED(b->points_spread, 3), OUTPUT_FIXED(m->points_spread, 3));
    print_row(to, "cameras a block, largest / mean", OUTPUT_FIXED(b->views_peak, 3), OUTPUT_FIXED(m->views_peak, 3));
    print_row(to, "  coefficient of variation", OUTPUT_FIXED(b->views_spread, 3), OUTPUT_FIXED(m->views_spread, 3));
    print_row(to, "memory of the largest block", OUTPUT_SIZE(b->memory), OUTPUT_SIZE(m->memory));
    print_row(to, "time of the longest block", OUTPUT_SECONDS(b->longest), OUTPUT_SECONDS(m->longest));
    print_row(to, "time of all, one after the other", OUTPUT_SECONDS(b->seconds), OUTPUT_SECONDS(m->seconds));
}

/* blocks.c - tables of a partition: content and predicted cost of each block, and balance compared with the baseline. */
#include "cli.h"

enum { ROWS = 60 }; /* blocks that are listed; partition.txt has them all */

static void print_duration(FILE *to, int width, double seconds)
{
    if (seconds < 90) fprintf(to, "%*.0f s  ", width - 4, seconds);
    else if (seconds < 5400) fprintf(to, "%*.0f min", width - 4, seconds / 60);
    else fprintf(to, "%*.1f h  ", width - 4, seconds / 3600);
}

static void print_blocks(FILE *to, const oxl_partition_report *r)
{
    fprintf(to, "%6s %10s %10s %6s %7s %11s %10s\n", "block", "points", "starts", "base", "border", "memory", "time");
    for (int i = 0; i < r->block_count && i < ROWS; i++) {
        const oxl_block *b = &r->block[i];
        fprintf(to, "%6d %10zu %10zu %6d %7d %8.2f GB ", i, b->points, b->start_points, b->base_views, b->border_views,
                b->memory / 1e9);
        print_duration(to, 10, b->seconds);
        fputc('\n', to);
    }
    if (r->block_count > ROWS) fprintf(to, "   ... and %d more\n", r->block_count - ROWS);
}

static void print_row(FILE *to, const char *what, const char *format, double balanced, double midpoint)
{
    fprintf(to, "%-34s", what);
    fprintf(to, format, balanced);
    fprintf(to, format, midpoint);
    fputc('\n', to);
}

static void print_times(FILE *to, const char *what, double balanced, double midpoint)
{
    fprintf(to, "%-34s", what);
    print_duration(to, 11, balanced);
    print_duration(to, 11, midpoint);
    fputc('\n', to);
}

void blocks_print(FILE *to, const oxl_partition_report *r)
{
    const oxl_balance *b = &r->balance[OXL_CUT_BALANCED], *m = &r->balance[OXL_CUT_MIDPOINT];
    print_blocks(to, r);
    fprintf(to, "\n%-34s%11s%11s   (%s was used)\n", "", "balanced", "midpoint",
            r->cut == OXL_CUT_MIDPOINT ? "midpoint" : "balanced");
    print_row(to, "blocks", "%11.0f", b->blocks, m->blocks);
    print_row(to, "points a block, largest / mean", "%11.3f", b->points_peak, m->points_peak);
    print_row(to, "  coefficient of variation", "%11.3f", b->points_spread, m->points_spread);
    print_row(to, "cameras a block, largest / mean", "%11.3f", b->views_peak, m->views_peak);
    print_row(to, "  coefficient of variation", "%11.3f", b->views_spread, m->views_spread);
    print_row(to, "memory of the largest block", "%8.2f GB", b->memory / 1e9, m->memory / 1e9);
    print_times(to, "time of the longest block", b->longest, m->longest);
    print_times(to, "time of all, one after the other", b->seconds, m->seconds);
}

/* compare.c - what changed between two surveys of one place: heights, volume, and where the change is more than both
 * surveys' uncertainty.
 *
 * The second survey is registered to the first by their clouds: an iterated closest point method (Chen and Medioni
 * 1992) whose pairs are the places of one cloud and their projections on the other's surface, with Tukey's weights,
 * so that what changed does not count. Where the two do not overlap as they are, their principal axes are tried, turned
 * by eighths. Then both are mapped on one grid, and a cell's level of detection is 1.96 standard deviations of the
 * difference: of both heights (map.c) and of the registration. A change is significant where the difference is beyond
 * it in most of the cells around, with one sign: single cells are noise.
 *
 * Invariant: the same two models give the same bytes.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    COMPARE_SIDE = 320,     /* px; of the views' depths, as of maps */
    COMPARE_SAMPLE = 20000, /* places of a cloud that are paired */
    COMPARE_TRIES = 9,      /* as they are, and eight turns */
    COMPARE_PASSES = 30,
    COMPARE_TRY_PASSES = 8,
    COMPARE_HOLE = 8,   /* passes that fill holes */
    COMPARE_AROUND = 6, /* cells on each side that a significant change is seen in */
    COMPARE_LEAST = (2 * COMPARE_AROUND + 1) * (2 * COMPARE_AROUND + 1) / 2, /* cells of a changed place */
    COMPARE_PLACES = 1000, /* most changed places that are listed */
    COMPARE_LINKED = 400   /* cells whose errors are taken as one in the volume's uncertainty */
};
#define COMPARE_LEVEL 1.96 /* of 95 % */
#define COMPARE_RIM 0.5    /* of the level of detection, around a significant change */
#define COMPARE_TUKEY 4.685
#define COMPARE_REACH 0.1   /* of the cameras' distance: farthest pair, at the beginning */
#define COMPARE_OVERLAP 0.3 /* least share of places with a pair */
#define COMPARE_MARK "oceanxl comparison"

struct compare {
    oxl_context *ctx;
    struct surface surface[2];
    struct cloud cloud[2];
    struct similarity move; /* of the second survey to the first */
    double overlap;         /* share of the second's places with a pair */
    double noise;           /* standard deviation of the registration, units */
    struct map map[2];
    float *difference, *level; /* (height,width) second less first, units; level of detection; NaN: none */
    signed char *sign;         /* (height,width) of a significant change; 0: none */
    size_t filled;             /* cells that have the mean of those around */
};

struct compare_sum {
    size_t cells, changed;
    double net, raised, lowered, doubt; /* cubic units; doubt: standard deviation of net */
    double place[2], most;              /* of a changed place: its centre in the map, largest difference */
    int sign;
};

/* ---------------- registration */

/* Pairs a sample of the second cloud's places with their projections on the first's surface. Returns the count. */
static size_t compare_pair(const struct compare *c, const struct near *near, const struct similarity *move,
                           double (*from)[3], double (*to)[3], double *off)
{
    const size_t count = c->cloud[1].count, stride = 1 + count / COMPARE_SAMPLE;
    size_t n = 0;
    for (size_t i = 0; i < count; i += stride) {
        double p[3], distance, along = 0;
        const struct cloud_point *q;
        similarity_apply(move, c->cloud[1].point[i].place, p);
        q = near_find(near, p, &distance);
        if (!q) continue;
        for (int k = 0; k < 3; k++) along += (q->place[k] - p[k]) * (double)q->normal[k];
        for (int k = 0; k < 3; k++) to[n][k] = p[k] + along * (double)q->normal[k];
        memcpy(from[n], c->cloud[1].point[i].place, sizeof from[n]);
        off[n++] = along;
    }
    return n;
}

/* Returns 1.4826 times the median of |off|: the standard deviation of what is not changed. */
static double compare_spread(const double *off, size_t count, double *scratch)
{
    for (size_t i = 0; i < count; i++) scratch[i] = fabs(off[i]);
    qsort(scratch, count, sizeof *scratch, frame_compare);
    return count > 0 ? 1.4826 * scratch[count / 2] : HUGE_VAL;
}

/* Moves the second cloud onto the first from `move` on. Sets the share of its places with a pair, and what is left. */
static int compare_approach(struct compare *c, struct similarity *move, int passes, double *share,
                            double *left)
{
    const size_t room = COMPARE_SAMPLE + 2,
                 tried = (c->cloud[1].count - 1) / (1 + c->cloud[1].count / COMPARE_SAMPLE) + 1;
    double(*from)[3] = malloc(room * sizeof *from), (*to)[3] = malloc(room * sizeof *to);
    double *off = malloc(3 * room * sizeof *off), reach = COMPARE_REACH * c->surface[0].distance;
    int done = from && to && off;
    *share = 0, *left = HUGE_VAL;
    for (int pass = 0; pass < passes && done; pass++, reach = fmax(0.8 * reach, 4 * c->surface[0].sampling)) {
        struct near near;
        size_t n;
        done = near_open(&near, c->cloud[0].point, c->cloud[0].count, reach);
        n = done ? compare_pair(c, &near, move, from, to, off) : 0;
        near_close(&near);
        *left = compare_spread(off, n, off + room);
        *share = (double)n / (double)tried;
        for (size_t i = 0; i < n; i++) {
            const double u = off[i] / (COMPARE_TUKEY * fmax(*left, 1e-12));
            off[room + i] = fabs(u) < 1 ? (1 - u * u) * (1 - u * u) : 0;
        }
        if (n < 10 ||
            !similarity_fit((const double(*)[3])from, (const double(*)[3])to, off + room, n, 1, move))
            break;
    }
    free(from);
    free(to);
    free(off);
    return done;
}

/* The k-th try: 0: worlds as they are; else principal axes on principal axes, turned by eighths. */
static struct similarity compare_guess(const struct compare *c, int k)
{
    const oxl_scene *a = c->surface[0].scene, *b = c->surface[1].scene;
    struct similarity s = {1, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 0}};
    struct frame f[2];
    double turned[3], angle = (k - 1) * 0.7853981633974483, axis[3][3];
    for (int i = 0; i < 3; i++) s.move[i] = oxl_scene_origin(b)[i] - oxl_scene_origin(a)[i];
    if (k == 0) return s;
    frame_choose(a, FRAME_SURVEY_AXES, &f[0]);
    frame_choose(b, FRAME_SURVEY_AXES, &f[1]);
    s.scale = c->surface[0].distance / c->surface[1].distance;
    for (int i = 0; i < 3; i++) {
        axis[0][i] = cos(angle) * f[0].axis[0][i] + sin(angle) * f[0].axis[1][i];
        axis[1][i] = cos(angle) * f[0].axis[1][i] - sin(angle) * f[0].axis[0][i];
        axis[2][i] = f[0].axis[2][i];
    }
    for (int i = 0; i < 9; i++) {
        s.rotation[i] = 0;
        for (int d = 0; d < 3; d++) s.rotation[i] += axis[d][i / 3] * f[1].axis[d][i % 3];
    }
    frame_to_camera(s.rotation, f[1].centre, turned);
    for (int i = 0; i < 3; i++) s.move[i] = f[0].centre[i] - s.scale * turned[i];
    return s;
}

static oxl_result compare_register(struct compare *c)
{
    double share, left, best = -1;
    for (int k = 0; k < COMPARE_TRIES && best < COMPARE_OVERLAP; k++) {
        struct similarity move = compare_guess(c, k);
        if (!compare_approach(c, &move, COMPARE_TRY_PASSES, &share, &left))
            return oxl_fail(c->ctx, OXL_ERR_MEMORY, "compare: no memory");
        if (share > best) best = share, c->move = move;
    }
    if (!compare_approach(c, &c->move, COMPARE_PASSES, &c->overlap, &left))
        return oxl_fail(c->ctx, OXL_ERR_MEMORY, "compare: no memory");
    c->noise = left / sqrt(c->surface[0].views + c->surface[1].views);
    return c->overlap >= COMPARE_OVERLAP
               ? OXL_OK
               : oxl_fail(c->ctx, OXL_ERR_INPUT,
                          "compare: only %.0f %% of the second survey lies on the first, expected at least "
                          "%.0f %%\nfix: georeference both surveys, so that they share one coordinate system",
                          100 * c->overlap, 100 * COMPARE_OVERLAP);
}

/* ---------------- both heights on one grid */

/* Places the second map on the first's grid: the first's frame, moved into the second survey's coordinates. */
static void compare_place(const struct compare *c, const struct map *a, struct map *b)
{
    double away[3];
    b->pixel = a->pixel / c->move.scale, b->width = a->width, b->height = a->height, b->is_placed = 1;
    b->frame.spread = a->frame.spread / c->move.scale;
    for (int d = 0; d < 2; d++) b->corner[d] = a->corner[d] / c->move.scale;
    for (int k = 0; k < 3; k++) away[k] = (a->frame.centre[k] - c->move.move[k]) / c->move.scale;
    for (int k = 0; k < 3; k++) {
        b->frame.centre[k] = 0;
        for (int j = 0; j < 3; j++) b->frame.centre[k] += c->move.rotation[3 * j + k] * away[j];
        for (int d = 0; d < 3; d++) {
            b->frame.axis[d][k] = 0;
            for (int j = 0; j < 3; j++)
                b->frame.axis[d][k] += c->move.rotation[3 * j + k] * a->frame.axis[d][j];
        }
    }
}

static oxl_result compare_map(struct compare *c, const struct arguments *a, oxl_model *model[2], double unit)
{
    oxl_result rc = OXL_OK;
    for (int i = 0; i < 2 && rc == OXL_OK; i++) {
        struct map *m = &c->map[i];
        *m = (struct map){
            .ctx = c->ctx, .scene = c->surface[i].scene, .surface = &c->surface[i], .enough = a->min_views};
        m->pixel =
            i ? 0
              : fmax(a->pixel / unit, fmax(c->surface[0].sampling, c->move.scale * c->surface[1].sampling));
        if (i) compare_place(c, &c->map[0], m);
        rc = map_make(m, model[i], (enum frame_kind)a->frame, 0);
    }
    return rc;
}

/* 1: the place is in the polygon "X,Y;X,Y;..." of map coordinates, or there is none. */
static int compare_is_inside(const char *polygon, double x, double y)
{
    double first[2] = {0, 0}, last[2] = {0, 0}, p[2];
    int inside = 0, n = 0, is_end = !polygon;
    if (!polygon) return 1;
    for (const char *at = polygon; !is_end;) {
        is_end = !*at;
        for (int k = 0; k < 2 && !is_end; k++) {
            p[k] = oxl_json_number_at(&at);
            at += *at == ',' || *at == ';';
        }
        if (is_end) memcpy(p, first, sizeof p); /* closes it */
        if (!n++) memcpy(first, p, sizeof p);
        else if ((p[1] > y) != (last[1] > y) && x < (last[0] - p[0]) * (y - p[1]) / (last[1] - p[1]) + p[0])
            inside = !inside;
        memcpy(last, p, sizeof p);
    }
    return inside;
}

/* Returns 0 for a text that is no polygon of three corners or more. */
static int compare_is_polygon(const char *text)
{
    int numbers = 0;
    for (const char *at = text; at && *at; numbers++) {
        if (isnan(oxl_json_number_at(&at))) return 0;
        if (*at && *at++ != (numbers % 2 ? ';' : ',')) return 0;
    }
    return !text || (numbers >= 6 && numbers % 2 == 0);
}

static oxl_result compare_subtract(struct compare *c, const char *polygon, double unit)
{
    const struct map *a = &c->map[0], *b = &c->map[1];
    const size_t cells = (size_t)a->width * (size_t)a->height;
    c->difference = malloc(cells * sizeof *c->difference);
    c->level = malloc(cells * sizeof *c->level);
    c->sign = calloc(cells, 1);
    if (!c->difference || !c->level || !c->sign)
        return oxl_fail(c->ctx, OXL_ERR_MEMORY, "compare: no memory");
    for (size_t i = 0; i < cells; i++) {
        const double x = a->corner[0] + ((double)(i % (size_t)a->width) + 0.5) * a->pixel + a->shift[0],
                     y = a->corner[1] - ((double)(i / (size_t)a->width) + 0.5) * a->pixel + a->shift[1];
        const double sigma[2] = {(double)a->sigma[i], c->move.scale * (double)b->sigma[i]};
        c->difference[i] = (float)(c->move.scale * (double)b->level[i] - (double)a->level[i]);
        c->level[i] =
            (float)(COMPARE_LEVEL * sqrt(sigma[0] * sigma[0] + sigma[1] * sigma[1] + c->noise * c->noise));
        if (isnan(c->difference[i]) || !compare_is_inside(polygon, x * unit, y * unit))
            c->difference[i] = c->level[i] = NAN;
    }
    return OXL_OK;
}

/* Fills small holes in what both surveys have, pass by pass: a cell with most cells around known gets their means, and
 * their level of detection. Volumes would lack them. */
static oxl_result compare_fill(struct compare *c)
{
    const int width = c->map[0].width, height = c->map[0].height;
    const size_t cells = (size_t)width * (size_t)height;
    float *from = malloc(2 * cells * sizeof *from);
    if (!from) return oxl_fail(c->ctx, OXL_ERR_MEMORY, "compare: no memory");
    for (int pass = 0; pass < COMPARE_HOLE; pass++) {
        memcpy(from, c->difference, cells * sizeof *from);
        memcpy(from + cells, c->level, cells * sizeof *from);
        for (size_t at = (size_t)width + 1; at + (size_t)width + 1 < cells; at++) {
            float sum[2] = {0, 0};
            int known = 0;
            for (int k = 0; k < 9 && isnan(from[at]); k++) {
                const size_t to = at + (size_t)(k % 3) - 1 + (size_t)(k / 3) * (size_t)width - (size_t)width;
                if (!isnan(from[to])) known++, sum[0] += from[to], sum[1] += from[cells + to];
            }
            if (known < 5) continue;
            c->difference[at] = sum[0] / (float)known, c->level[at] = sum[1] / (float)known;
            c->filled++;
        }
    }
    free(from);
    return OXL_OK;
}

/* ---------------- what is significant */

static int compare_beyond(const struct compare *c, size_t at)
{
    return (c->difference[at] > c->level[at]) - (c->difference[at] < -c->level[at]); /* NaN: 0 */
}

static void compare_judge(struct compare *c)
{
    const int width = c->map[0].width, height = c->map[0].height;
#pragma omp parallel for schedule(static)
    for (int y = COMPARE_AROUND; y < height - COMPARE_AROUND; y++)
        for (int x = COMPARE_AROUND; x < width - COMPARE_AROUND; x++) {
            const size_t at = (size_t)y * (size_t)width + (size_t)x;
            const int own = compare_beyond(c, at), side = 2 * COMPARE_AROUND + 1;
            int same = 0;
            for (int k = 0; k < side * side && own; k++)
                same += compare_beyond(c, (size_t)(y + k / side - COMPARE_AROUND) * (size_t)width +
                                              (size_t)(x + k % side - COMPARE_AROUND)) == own;
            c->sign[at] = (signed char)(2 * same > side * side ? own : 0);
        }
}

static void compare_add(const struct compare *c, size_t at, struct compare_sum *s)
{
    const struct map *m = &c->map[0];
    const double d = (double)c->difference[at];
    s->cells++;
    s->net += d;
    s->doubt += pow((double)c->level[at] / COMPARE_LEVEL, 2);
    s->place[0] += (double)(at % (size_t)m->width), s->place[1] += (double)(at / (size_t)m->width);
    if (fabs(d) > fabs(s->most)) s->most = d;
    if (!c->sign[at]) return;
    s->changed++;
    s->raised += d > 0 ? d : 0, s->lowered += d < 0 ? d : 0;
}

/* From sums over cells to volumes, places, and the standard deviation of the net volume: what all cells share, and
 * what they do not. */
static void compare_close_sum(const struct compare *c, struct compare_sum *s)
{
    const struct map *m = &c->map[0];
    const double cell = m->pixel * m->pixel, n = (double)s->cells;
    s->net *= cell, s->raised *= cell, s->lowered *= cell;
    s->doubt = cell * sqrt(s->doubt * fmin(COMPARE_LINKED, n) + n * n * c->noise * c->noise);
    for (int d = 0; d < 2 && n > 0; d++)
        s->place[d] = m->corner[d] + (d ? -1 : 1) * (s->place[d] / n + 0.5) * m->pixel + m->shift[d];
}

/* Sums the changed place that a cell belongs to: the significant cells of one sign that hang together, grown by those
 * beyond a share of their level of detection that hang together with them: its rim. Where fewer cells are significant than one of them has
 * around, there is none. Returns the number of places, 0 or 1. */
static int compare_collect(struct compare *c, size_t from, unsigned char *taken, size_t *list,
                           struct compare_sum *s)
{
    const int width = c->map[0].width, height = c->map[0].height, sign = c->sign[from];
    size_t n = 1, significant = 0;
    *s = (struct compare_sum){.sign = sign};
    list[0] = from, taken[from] = 1;
    for (size_t i = 0; i < n; i++) {
        const int x = (int)(list[i] % (size_t)width), y = (int)(list[i] / (size_t)width);
        significant += c->sign[list[i]] != 0;
        c->sign[list[i]] = (signed char)sign;
        compare_add(c, list[i], s);
        for (int k = 0; k < 4; k++) {
            const int u = x + (k == 0) - (k == 1), w = y + (k == 2) - (k == 3);
            const size_t to = (size_t)w * (size_t)width + (size_t)u;
            if (u < 0 || w < 0 || u >= width || w >= height || taken[to] ||
                !((double)((float)sign * c->difference[to]) > COMPARE_RIM * (double)c->level[to]))
                continue;
            taken[to] = 1, list[n++] = to;
        }
    }
    for (size_t i = 0; i < n && significant < COMPARE_LEAST; i++) c->sign[list[i]] = 0;
    compare_close_sum(c, s);
    return significant >= COMPARE_LEAST;
}

static int compare_larger(const void *a, const void *b)
{
    const double x = fabs(((const struct compare_sum *)a)->net),
                 y = fabs(((const struct compare_sum *)b)->net);
    return (x < y) - (x > y);
}

/* Lists the changed places, the largest volume first, and sums the whole. */
static oxl_result compare_list(struct compare *c, struct compare_sum *whole, struct compare_sum *place,
                               int *places)
{
    const size_t cells = (size_t)c->map[0].width * (size_t)c->map[0].height;
    unsigned char *taken = calloc(cells, 1);
    size_t *list = malloc(cells * sizeof *list);
    *whole = (struct compare_sum){.sign = 0};
    *places = 0;
    for (size_t i = 0; i < cells && taken && list; i++)
        if (c->sign[i] && !taken[i] && *places < COMPARE_PLACES)
            *places += compare_collect(c, i, taken, list, &place[*places]);
    for (size_t i = 0; i < cells; i++)
        if (!isnan(c->difference[i])) compare_add(c, i, whole);
    compare_close_sum(c, whole);
    qsort(place, (size_t)*places, sizeof *place, compare_larger);
    free(taken);
    free(list);
    return taken && list ? OXL_OK : oxl_fail(c->ctx, OXL_ERR_MEMORY, "compare: no memory");
}

/* ---------------- files */

static void compare_row(struct output *t, const char *form, const char *name, const struct compare_sum *s,
                        double cell, double unit)
{
    const double area = cell * unit * unit, volume = unit * unit * unit;
    output_add(t, form, name, OUTPUT_FIXED(s->place[0] * unit, 3), OUTPUT_FIXED(s->place[1] * unit, 3),
               OUTPUT_FIXED((double)s->cells * area, 4), OUTPUT_FIXED((double)s->changed * area, 4),
               OUTPUT_FIXED(s->net * volume, 6), OUTPUT_FIXED(COMPARE_LEVEL * s->doubt * volume, 6),
               OUTPUT_FIXED(s->raised * volume, 6), OUTPUT_FIXED(s->lowered * volume, 6),
               OUTPUT_FIXED(s->most * unit, 4));
}

static void compare_rows(const struct compare *c, struct output *t, const char *form,
                         const struct compare_sum *whole, const struct compare_sum *place, int places,
                         double unit)
{
    const double cell = c->map[0].pixel * c->map[0].pixel;
    compare_row(t, form, "whole", whole, cell, unit);
    for (int i = 0; i < places; i++)
        compare_row(t, form, place[i].sign > 0 ? "raised" : "lowered", &place[i], cell, unit);
}

/* The first orthomosaic in grey; raised red, lowered blue, without a difference dark. */
static oxl_result compare_draw(const struct compare *c, const char *folder)
{
    const struct map *m = &c->map[0];
    const size_t pixels = (size_t)m->width * (size_t)m->height;
    char path[4200];
    oxl_image image;
    oxl_result rc = oxl_image_create(c->ctx, m->width, m->height, &image);
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; i < pixels; i++) {
        const unsigned char *p = m->rgba + 4 * i;
        const float grey = p[3] ? (float)(p[0] + p[1] + p[2]) / 765 : 0;
        for (size_t k = 0; k < 3; k++) {
            float value = isnan(c->difference[i]) ? 0.3f * grey : 0.3f + 0.6f * grey;
            if (c->sign[i]) value = 0.5f * value + (k == (c->sign[i] > 0 ? 0u : 2u) ? 0.5f : 0);
            image.rgb[k * pixels + i] = value;
        }
    }
    snprintf(path, sizeof path, "%s/change.png", folder);
    rc = oxl_image_write(c->ctx, path, &image);
    oxl_image_free(c->ctx, &image);
    return rc;
}

static oxl_result compare_save(struct compare *c, struct output *t, const char *folder, const char *name)
{
    char path[4200];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return output_save(t, path)
               ? OXL_OK
               : oxl_fail(c->ctx, OXL_ERR_IO, "%s cannot be written\nfix: free space on the disk", path);
}

/* Writes difference.tif: difference and level of detection; significant.tif: the difference where it is beyond. */
static oxl_result compare_write_tiffs(struct compare *c, const struct arguments *a, double unit)
{
    const size_t cells = (size_t)c->map[0].width * (size_t)c->map[0].height;
    struct geotiff g = map_georeference(&c->map[0], a, unit);
    float *band = malloc(2 * cells * sizeof *band);
    char path[4200];
    oxl_result rc = band ? OXL_OK : oxl_fail(c->ctx, OXL_ERR_MEMORY, "compare: no memory");
    for (int file = 0; file < 2 && rc == OXL_OK; file++) {
        g.floats = 2 - file;
        for (size_t i = 0; i < cells; i++) {
            const float d = (float)(c->difference[i] * unit);
            if (file) band[i] = c->sign[i] ? d : NAN;
            else band[2 * i] = d, band[2 * i + 1] = (float)(c->level[i] * unit);
        }
        snprintf(path, sizeof path, "%s/%s", a->out, file ? "significant.tif" : "difference.tif");
        rc = geotiff_write(c->ctx, path, &g, band);
    }
    free(band);
    return rc;
}

static void compare_say(const struct compare *c, struct output *t, const struct compare_sum *whole,
                        int places, double unit, const char *words)
{
    const double area = c->map[0].pixel * c->map[0].pixel * unit * unit, volume = unit * unit * unit;
    output_add(t, "%s %% of the second survey lie on the first; registration: scale %s, uncertain by %s %s. ",
               OUTPUT_FIXED(100 * c->overlap, 1), OUTPUT_FIXED(c->move.scale, 5),
               OUTPUT_FIXED(c->noise * unit, 5), words);
    output_add(
        t,
        "%s square %s have both heights (%s %% of them filled from around), of these %s %% changed significantly, at %d places. ",
        OUTPUT_FIXED((double)whole->cells * area, 2), words,
        OUTPUT_FIXED(100.0 * (double)c->filled / fmax(1, (double)whole->cells), 1),
        OUTPUT_FIXED(100.0 * (double)whole->changed / fmax(1, (double)whole->cells), 2), places);
    output_add(
        t,
        "Volume: %s cubic %s raised, %s lowered where it is significant; net of all cells %s, within %s (95 %%).",
        OUTPUT_FIXED(whole->raised * volume, 4), words, OUTPUT_FIXED(-whole->lowered * volume, 4),
        OUTPUT_FIXED(whole->net * volume, 4), OUTPUT_FIXED(COMPARE_LEVEL * whole->doubt * volume, 4));
}

static oxl_result compare_write(struct compare *c, const struct arguments *a, double unit, FILE *to)
{
    static const char head[] =
        "change,x,y,area,significant_area,volume,volume_95,raised,lowered,largest_difference\n";
    const char *words = a->scale > 0 ? "metres" : "units";
    struct compare_sum whole = {0}, *place = calloc(COMPARE_PLACES + 1, sizeof *place);
    struct output csv = {0}, page = {0}, say = {0};
    int places = 0;
    oxl_result rc = place ? compare_list(c, &whole, place, &places)
                          : oxl_fail(c->ctx, OXL_ERR_MEMORY, "compare: no memory");
    if (rc == OXL_OK) {
        output_add(&csv, "# " COMPARE_MARK " in %s\n%s", words, head);
        compare_rows(c, &csv, "%s,%s,%s,%s,%s,%s,%s,%s,%s,%s\n", &whole, place, places, unit);
        compare_say(c, &say, &whole, places, unit, words);
        output_add(
            &page,
            "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>%S and %S - " COMPARE_MARK
            "</title>"
            "<style>body{font:15px sans-serif;max-width:1100px;margin:auto}img{max-width:100%%}td,th{padding:2px 9px;text-align:right}</style></head>"
            "<body><h1>%S, then %S</h1><p>%S</p><p>The first survey in grey; red: raised, blue: lowered, beyond the level of detection "
            "of 95 %% in most cells around; dark: no height in one of the two.</p><img src=\"change.png\" alt=\"Map of changes\"><table>"
            "<tr><th>change<th>x<th>y<th>area<th>significant<th>volume<th>within<th>raised<th>lowered<th>largest</tr>\n",
            a->path[0], a->path[1], a->path[0], a->path[1], say.data ? say.data : "");
        compare_rows(c, &page, "<tr><td>%s<td>%s<td>%s<td>%s<td>%s<td>%s<td>%s<td>%s<td>%s<td>%s</tr>\n",
                     &whole, place, places, unit);
        output_add(&page, "</table></body></html>\n");
        rc = compare_draw(c, a->out);
    }
    if (rc == OXL_OK) rc = compare_write_tiffs(c, a, unit);
    if (rc == OXL_OK) rc = compare_save(c, &csv, a->out, "compare.csv");
    if (rc == OXL_OK) rc = compare_save(c, &page, a->out, "compare.html");
    if (rc == OXL_OK) print_format(to, "%s\n", say.data ? say.data : "");
    free(csv.data), free(page.data), free(say.data), free(place);
    return rc;
}

static oxl_result compare_check(oxl_context *ctx, const struct arguments *a)
{
    static const char *const own[][2] = {{"difference.tif", "oceanxl: "},
                                         {"significant.tif", "oceanxl: "},
                                         {"compare.csv", COMPARE_MARK},
                                         {"compare.html", COMPARE_MARK}};
    oxl_result rc = oxl_make_folder(ctx, a->out);
    for (int i = 0; i < 4 && rc == OXL_OK; i++) rc = output_check_own(ctx, a->out, own[i][0], own[i][1]);
    if (rc == OXL_OK && !compare_is_polygon(a->polygon))
        rc = oxl_fail(
            ctx, OXL_ERR_USAGE,
            "--polygon: found '%.100s', expected three corners or more, X,Y;X,Y;X,Y, of the map\nfix: --polygon 0,0;4,0;4,3",
            a->polygon);
    return rc;
}

oxl_result compare_run(oxl_context *ctx, oxl_model *model[2], const oxl_scene *const scene[2],
                       const struct arguments *a, FILE *to)
{
    const double unit = a->scale > 0 ? a->scale : 1;
    struct compare c = {.ctx = ctx};
    oxl_result rc = compare_check(ctx, a);
    for (int i = 0; i < 2 && rc == OXL_OK; i++) {
        rc = surface_open(ctx, model[i], scene[i], COMPARE_SIDE, &c.surface[i]);
        if (rc == OXL_OK) rc = cloud_make(&c.surface[i], a->min_views, &c.cloud[i]);
    }
    if (rc == OXL_OK) rc = compare_register(&c);
    if (rc == OXL_OK) rc = compare_map(&c, a, model, unit);
    if (rc == OXL_OK) rc = compare_subtract(&c, a->polygon, unit);
    if (rc == OXL_OK) rc = compare_fill(&c);
    if (rc == OXL_OK) compare_judge(&c);
    if (rc == OXL_OK) rc = compare_write(&c, a, unit, to);
    for (int i = 0; i < 2; i++) surface_close(&c.surface[i]), cloud_free(&c.cloud[i]), map_free(&c.map[i]);
    free(c.difference), free(c.level), free(c.sign);
    return rc;
}

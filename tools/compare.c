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
    COMPARE_SAMPLE = 20000, /* places of a cloud that are paired */
    COMPARE_TRIES = 9,      /* as they are, and eight turns */
    COMPARE_PASSES = 30,
    COMPARE_HOLE = 8,      /* passes that fill holes: volumes would lack them */
    COMPARE_AROUND = 6,    /* cells on each side that a significant change is seen in */
    COMPARE_LEAST = 84,    /* cells of a changed place: half of a square of them */
    COMPARE_PLACES = 1000, /* most changed places that are listed */
    COMPARE_LINKED = 400   /* cells whose errors are taken as one in the volume's uncertainty */
};
#define COMPARE_LEVEL 1.96  /* of 95 % */
#define COMPARE_RIM 0.5     /* of the level of detection, around a significant change */
#define COMPARE_REACH 0.1   /* of the cameras' distance: farthest match, at the beginning */
#define COMPARE_OVERLAP 0.3 /* least share of places with a match */

struct compare {
    const struct product *p;
    struct surface surface[2];
    struct cloud cloud[2];
    struct similarity move; /* of the second survey to the first */
    double overlap;         /* share of the second's places with a match */
    double noise;           /* standard deviation of the registration, in the map's unit as all below */
    struct map map[2];
    size_t cells, filled; /* filled: cells that have the mean of those around */
    float *difference;    /* (cells) second less first; NaN: none */
    float *level;         /* (cells) of detection; behind `difference` */
    signed char *sign;    /* (cells) of a significant change; 0: none */
    size_t *place;        /* (cells) scratch: of a changed place */
};

/* ---------------- registration */

/* Moves the second cloud onto the first from `move` on. Returns the share of its places with a match; left: the standard
 * deviation of what is left of them. */
static double compare_approach(const struct compare *c, struct similarity *move, double *left)
{
    const size_t count = c->cloud[1].count, stride = 1 + count / COMPARE_SAMPLE;
    struct match *match = product_room(count / stride + 1, sizeof *match);
    double reach = COMPARE_REACH * c->surface[0].distance;
    size_t n = 10;
    for (int pass = 0; pass < COMPARE_PASSES && n >= 10; pass++) {
        struct near near;
        n = 0;
        near_open(&near, &c->cloud[0], reach);
        for (size_t i = 0; i < count; i += stride) {
            const double *from = c->cloud[1].point[i].place;
            const struct cloud_point *q;
            double p[3];
            similarity_apply(move, from, p);
            q = near_find(&near, p, &match[n].off);
            if (!q) continue;
            memcpy(match[n].from, from, sizeof match[n].from);
            vector_add(p, -match[n].off, q->normal, match[n].to), n++;
        }
        free(near.first);
        *left = similarity_weigh(match, n);
        if (!similarity_fit(match, n, move)) break;
        reach = fmax(0.8 * reach, 4 * c->surface[0].sampling);
    }
    free(match);
    return (double)n * (double)stride / (double)count;
}

/* The k-th try: 0: worlds as they are; else principal axes on principal axes, turned by eighths. */
static struct similarity compare_guess(const struct compare *c, int k)
{
    const double angle = fmax(k - 1, 0) * 0.7853981633974483, x = cos(angle), y = sin(angle);
    const struct similarity turn = {1, {x, -y, 0, y, x, 0, 0, 0, 1}, {0, 0, 0}};
    struct similarity own[2], back, turned;
    for (int i = 0; i < 2; i++) {
        const oxl_scene *scene = c->surface[i].scene;
        struct frame f;
        frame_choose(scene, FRAME_SURVEY_AXES, &f);
        own[i] = k ? similarity_of_frame(&f, 1 / c->surface[i].distance) : similarity_of_world(scene, 1);
    }
    back = similarity_inverse(&own[0]), turned = similarity_compose(&turn, &own[1]);
    return similarity_compose(&back, &turned);
}

static oxl_result compare_register(struct compare *c)
{
    for (int k = 0; k < COMPARE_TRIES && c->overlap < COMPARE_OVERLAP; k++) {
        struct similarity move = compare_guess(c, k);
        double left;
        const double share = compare_approach(c, &move, &left);
        if (share <= c->overlap) continue;
        c->overlap = share, c->move = move;
        c->noise = c->p->world.scale * left / sqrt(c->surface[0].views + c->surface[1].views);
    }
    if (c->overlap >= COMPARE_OVERLAP) return OXL_OK;
    return oxl_fail(c->p->ctx, OXL_ERR_INPUT,
                    "compare: %.0f %% of the second survey lies on the first, expected at least %.0f %%\n"
                    "fix: georeference both surveys in one coordinate system",
                    100 * c->overlap, 100 * COMPARE_OVERLAP);
}

/* ---------------- both heights on one grid */

/* Maps both surveys, the second on the first's grid. */
static oxl_result compare_map(struct compare *c, oxl_model *model[2])
{
    struct map *m = c->map;
    oxl_result rc;
    m[0] = map_of(c->p, &c->surface[0]);
    m[0].pixel = fmax(m[0].pixel,
                      m[0].to.scale * fmax(c->surface[0].sampling, c->move.scale * c->surface[1].sampling));
    rc = map_make(&m[0], model[0]);
    if (rc != OXL_OK) return rc;
    m[1] = m[0], m[1].surface = &c->surface[1];
    m[1].to = similarity_compose(&m[0].to, &c->move);
    return map_make(&m[1], model[1]);
}

/* Reads "X,Y;X,Y;..." into room for all numbers. Returns their count; 0: it is no polygon of three corners or more. */
static int compare_polygon(const char *text, double *number)
{
    int n = 0;
    for (const char *at = text; *at; n++) {
        number[n] = oxl_json_number_at(&at);
        if (isnan(number[n]) || (*at && *at++ != (n % 2 ? ';' : ','))) return 0;
    }
    return n >= 6 && n % 2 == 0 ? n : 0;
}

static int compare_is_inside(const double *number, int count, double x, double y)
{
    int inside = count == 0;
    for (int i = 0; i < count; i += 2) {
        const double *p = number + i, *q = number + (i + 2) % count;
        if ((p[1] > y) != (q[1] > y) && x < (q[0] - p[0]) * (y - p[1]) / (q[1] - p[1]) + p[0])
            inside = !inside;
    }
    return inside;
}

/* Map coordinates of a cell's place, which may lie between cells. */
static double compare_along(const struct map *m, int axis, double cell)
{
    return m->corner[axis] + (axis ? -1 : 1) * (cell + 0.5) * m->pixel;
}

static void compare_subtract(struct compare *c, const double *polygon, int corners)
{
    const struct map *a = &c->map[0], *b = &c->map[1];
    c->cells = (size_t)a->width * a->height;
    c->difference = product_room(2 * c->cells, sizeof *c->difference), c->level = c->difference + c->cells;
    c->sign = product_room(c->cells, 1);
    c->place = product_room(c->cells, sizeof *c->place);
    for (size_t i = 0; i < c->cells; i++) {
        const double x = compare_along(a, 0, (double)(i % (size_t)a->width)),
                     y = compare_along(a, 1, (double)(i / (size_t)a->width)),
                     sigma[3] = {(double)a->sigma[i], (double)b->sigma[i], c->noise};
        c->difference[i] = b->level[i] - a->level[i];
        c->level[i] = COMPARE_LEVEL * frame_length(sigma);
        if (isnan(c->difference[i]) || !compare_is_inside(polygon, corners, x, y))
            c->difference[i] = c->level[i] = NAN;
    }
    c->filled = map_fill(a, c->difference, 2, COMPARE_HOLE);
}

/* ---------------- what is significant */

static int compare_beyond(const struct compare *c, int at)
{
    return (c->difference[at] > c->level[at]) - (c->difference[at] < -c->level[at]); /* NaN: 0 */
}

static void compare_judge(struct compare *c)
{
    enum { A = COMPARE_AROUND, SIDE = 2 * A + 1 };
    const int width = c->map[0].width, height = c->map[0].height;
#pragma omp parallel for schedule(static)
    for (int y = A; y < height - A; y++)
        for (int x = A; x < width - A; x++) {
            const int at = y * width + x, own = compare_beyond(c, at);
            int same = 0;
            for (int k = 0; k < SIDE * SIDE && own; k++)
                same += compare_beyond(c, at + (k / SIDE - A) * width + k % SIDE - A) == own;
            c->sign[at] = same > COMPARE_LEAST ? own : 0;
        }
}

/* Columns of a row: centre; areas of all cells and of those that changed; net volume, 95 % of it; volumes raised and
 * lowered; largest difference. */
enum { X, Y, AREA, CHANGED, NET, DOUBT, RAISED, LOWERED, MOST, COLUMNS };
struct compare_row {
    double value[COLUMNS];
    int sign;
};

/* Sums the listed cells. */
static struct compare_row compare_sum(const struct compare *c, const size_t *cell, size_t count, int sign)
{
    const struct map *m = &c->map[0];
    const double side = m->pixel, n = fmax(1, (double)count);
    struct compare_row row = {.sign = sign};
    double *v = row.value;
    for (size_t i = 0; i < count; i++) {
        const double d = (double)c->difference[cell[i]];
        v[X] += (double)(cell[i] % (size_t)m->width) / n, v[Y] += (double)(cell[i] / (size_t)m->width) / n;
        v[NET] += d * side * side;
        v[DOUBT] += pow((double)c->level[cell[i]], 2);
        if (fabs(d) > fabs(v[MOST])) v[MOST] = d;
        if (!c->sign[cell[i]]) continue;
        v[CHANGED] += side * side;
        v[d > 0 ? RAISED : LOWERED] += d * side * side;
    }
    v[AREA] = (double)count * side * side;
    /* what cells share, and what they do not */
    v[DOUBT] = side * side * sqrt(v[DOUBT] * fmin(COMPARE_LINKED, n) + pow(n * COMPARE_LEVEL * c->noise, 2));
    for (int d = 0; d < 2; d++) v[d] = compare_along(m, d, v[d]);
    return row;
}

/* Collects the changed place that a cell belongs to in c->place: the significant cells of one sign that hang together,
 * grown by those beyond a share of their level of detection that hang together with them: its rim. Where fewer cells are
 * significant than one of them has around, there is none. Returns the number of cells. */
static size_t compare_collect(struct compare *c, size_t from, unsigned char *taken)
{
    const int sign = c->sign[from];
    size_t n = 1, significant = 0;
    c->place[0] = from, taken[from] = 1;
    for (size_t i = 0; i < n; i++) {
        significant += c->sign[c->place[i]] != 0;
        c->sign[c->place[i]] = (signed char)sign;
        for (int k = 1; k < 9; k += 2) {
            const size_t to = map_next(&c->map[0], c->place[i], k);
            if (!taken[to] && (float)sign * c->difference[to] > (float)COMPARE_RIM * c->level[to])
                taken[to] = 1, c->place[n++] = to;
        }
    }
    if (significant >= COMPARE_LEAST) return n;
    for (size_t i = 0; i < n; i++) c->sign[c->place[i]] = 0;
    return 0;
}

/* Lists the whole, then the changed places, from the top of the map down. Returns the number of rows. */
static int compare_list(struct compare *c, struct compare_row row[COMPARE_PLACES + 1])
{
    unsigned char *taken = product_room(c->cells, 1);
    int rows = 1;
    size_t n = 0;
    for (size_t i = 0; i < c->cells && rows <= COMPARE_PLACES; i++) {
        const size_t count = c->sign[i] && !taken[i] ? compare_collect(c, i, taken) : 0;
        if (count) row[rows++] = compare_sum(c, c->place, count, c->sign[i]);
    }
    for (size_t i = 0; i < c->cells; i++)
        if (!isnan(c->difference[i])) c->place[n++] = i;
    row[0] = compare_sum(c, c->place, n, 0);
    free(taken);
    return rows;
}

/* ---------------- files */

/* The first orthomosaic's green in grey; raised red, lowered blue, without a difference dark. */
static oxl_result compare_draw(const struct compare *c)
{
    char path[4200];
    oxl_image image;
    oxl_result rc = oxl_image_create(c->p->ctx, c->map[0].width, c->map[0].height, &image);
    for (size_t i = 0; i < 3 * c->cells && rc == OXL_OK; i++) {
        const size_t at = i % c->cells;
        const float green = c->map[0].colour[c->cells + at], grey = isnan(green) ? 0 : green;
        image.rgb[i] = isnan(c->difference[at]) ? 0.3f * grey : 0.3f + 0.6f * grey;
        if (c->sign[at])
            image.rgb[i] = 0.5f * image.rgb[i] + (i / c->cells == 1 - (size_t)c->sign[at] ? 0.5f : 0);
    }
    snprintf(path, sizeof path, "%s/change.png", c->p->a->out);
    if (rc == OXL_OK) rc = oxl_image_write(c->p->ctx, path, &image);
    oxl_image_free(c->p->ctx, &image);
    return rc;
}

/* Writes the page from the table: its first line, then its rows. */
static void compare_page(const struct compare *c, const char *csv, struct output *page)
{
    const char *const *path = c->p->a->path, *end = strchr(csv, '\n');
    output_add(
        page,
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>%S and %S</title>"
        "<style>body{font:15px sans-serif;max-width:1100px;margin:auto}img{max-width:100%%}td{padding:2px "
        "9px;text-align:right}</style></head><body><h1>%S, then %S</h1><p>",
        path[0], path[1], path[0], path[1]);
    output_bytes(page, csv + 2, (size_t)(end - csv - 2));
    output_add(
        page,
        "</p><p>Grey is the first survey. Red ground was raised and blue ground lowered by more than the 95 %% level of detection, "
        "as were most cells around it. Dark cells have no height in one of the two surveys.</p><img src=\"change.png\" alt=\"Map of changes\"><table>");
    for (; *end; end++)
        if (*end == ',' || *end == '\n') output_add(page, *end == ',' ? "<td>" : "\n<tr><td>");
        else output_bytes(page, *end == '_' ? " " : end, 1);
    output_add(page, "</table></body></html>\n");
}

static void compare_table(const struct compare *c, const struct compare_row *row, int rows, struct output *t)
{
    static const char *const names[] = {"lowered", "whole", "raised"};
    const char *words = c->p->words;
    const double *v = row->value;
    output_add(
        t,
        "# oceanxl compare: %.0f %% of the second survey lies on the first. Its registration has the scale %.4f and a standard deviation of "
        "%.4f %s. %.2f square %s have a height in both surveys (%zu cells are filled from their neighbours). Of these, %.2f changed significantly, at "
        "%d places: %.3f cubic %s were added and %.3f removed there. The net change of all cells is %.3f +- %.3f cubic %s "
        "(95 %%).\nchange,x,y,area,significant_area,volume,volume_95,raised,lowered,largest_difference\n",
        100 * c->overlap, c->move.scale, c->noise, words, v[AREA], words, c->filled, v[CHANGED], rows - 1,
        v[RAISED], words, -v[LOWERED], v[NET], v[DOUBT], words);
    for (int i = 0; i < rows; i++) {
        output_add(t, "%s", names[row[i].sign + 1]);
        for (int k = 0; k < COLUMNS; k++) output_add(t, ",%.4f", row[i].value[k]);
        output_add(t, "\n");
    }
}

static oxl_result compare_write(struct compare *c)
{
    struct compare_row *row = product_room(COMPARE_PLACES + 1, sizeof *row);
    struct output csv = {0}, page = {0};
    const int rows = compare_list(c, row);
    oxl_result rc = compare_draw(c);
    if (rc == OXL_OK) compare_table(c, row, rows, &csv);
    if (rc == OXL_OK && !csv.failed) {
        compare_page(c, csv.data, &page);
        print_format(c->p->to, "%.*s\n", (int)strcspn(csv.data, "\n") - 2, csv.data + 2);
    }
    if (rc == OXL_OK) rc = map_raster(&c->map[0], c->p, "difference.tif", c->difference, 2);
    for (size_t i = 0; i < c->cells; i++)
        if (!c->sign[i]) c->difference[i] = NAN;
    if (rc == OXL_OK) rc = map_raster(&c->map[0], c->p, "significant.tif", c->difference, 1);
    if (rc == OXL_OK) rc = product_save(c->p, &csv, "compare.csv");
    if (rc == OXL_OK) rc = product_save(c->p, &page, "compare.html");
    free(csv.data), free(page.data), free(row);
    return rc;
}

oxl_result compare_run(const struct product *p, oxl_model *model[2], const oxl_scene *second)
{
    const char *polygon = p->a->polygon ? p->a->polygon : "";
    double *number = product_room(strlen(polygon), sizeof *number);
    const int corners = compare_polygon(polygon, number);
    struct compare c = {.p = p};
    oxl_result rc = product_folder(p);
    if (rc == OXL_OK && *polygon && !corners)
        rc = oxl_fail(
            p->ctx, OXL_ERR_USAGE,
            "--polygon: found '%.100s', expected three corners or more, X,Y;X,Y;X,Y, of the map\nfix: use --polygon 0,0;4,0;4,3",
            polygon);
    for (int i = 0; i < 2 && rc == OXL_OK; i++) {
        rc = surface_open(p->ctx, model[i], i ? second : p->scene, SURFACE_SIDE, &c.surface[i]);
        if (rc == OXL_OK) rc = cloud_make(&c.surface[i], p->a->min_views, &c.cloud[i]);
    }
    if (rc == OXL_OK) rc = compare_register(&c);
    if (rc == OXL_OK) rc = compare_map(&c, model);
    if (rc == OXL_OK) {
        compare_subtract(&c, number, corners);
        compare_judge(&c);
        rc = compare_write(&c);
    }
    for (int i = 0; i < 2; i++) surface_close(&c.surface[i]), cloud_free(&c.cloud[i]), map_free(&c.map[i]);
    free(c.difference), free(c.sign), free(c.place), free(number);
    return rc;
}

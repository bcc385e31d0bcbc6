/* partition_svg.c - draws partition.svg: the survey from above, and from the side when it is cut in 3D, with
 * its blocks, points and cameras.
 *
 * A plain SVG: shapes and text, no script, no font of its own. Points and cameras are thinned at a fixed
 * stride, so that the file of a large survey stays small and the same survey gives the same bytes. No number
 * is written through the locale.
 */
#include "partition.h"
#include "../formats/svg.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"

enum {
    DRAW_POINTS = 12000, /* most points in all panels together; 13 bytes each */
    DRAW_CAMERAS = 4000, /* most cameras in all panels together */
    DRAW_WIDTH = 1120,   /* px; greatest width of a panel */
    DRAW_HEIGHT = 760,
    DRAW_MIN = 612, /* px; least width of panels and table, for the text */
    DRAW_EDGE = 44,
    /* px by which an unbounded block extends past its panel, where the clip hides its line */
    DRAW_BEYOND = 4,
    DRAW_MANY = 300, /* views; with more, their marks are small */
    DRAW_COLOURS = 12,
    DRAW_COLUMN = 190, /* px; width of a column of the table */
    DRAW_ROW = 18,
    DRAW_DIGITS = 20, /* px; width of a block's number */
    DRAW_ROOM = 96    /* bytes of a count or of the attributes of a shape */
};
#define DRAW_MARGIN 0.05 /* Enlarges the drawing around the extents, as a fraction of them. */
#define DRAW_POINT 1e-9  /* Replaces the extent (units) of points that are all in one place. */
#define DRAW_FLAT 1e-3   /* Bounds the drawn extent from below, as a fraction of the largest extent. */

static const char *const draw_colour[DRAW_COLOURS] = {"#1f77a8", "#e07b39", "#3a9d6e", "#b5507f",
                                                      "#7a68b3", "#c9a227", "#3fa7b5", "#c4504b",
                                                      "#6b8e3d", "#8c6d5a", "#5479c4", "#a35fb0"};

struct drawing_panel {
    const char *title;
    int axis[2];            /* axes of the frame that point right and up */
    double low[2], high[2]; /* range of the frame that is shown */
    double scale;           /* px per unit */
    double top, wide, tall; /* px */
    int stacked;            /* 1: blocks lie behind each other in this view */
};

enum { DRAW_NO_BLOCK = -1, DRAW_TEST_VIEW = -2 };
struct drawing {
    struct text t;
    const struct partition *p;
    size_t views;
    int blocks;
    int *colour;    /* (blocks) index of draw_colour */
    double *camera; /* (views,3) camera centres in the frame */
    int *base;      /* (views) first block that has the view as a base view */
    int *border;    /* (views) first block that has it as a border view */
    struct drawing_panel panel[2];
    int panels;
    int rows;                 /* rows of the table */
    double wide, tall, below; /* px; size of the image, and the end of the panels */
};

/* ---------------- numbers and looks */

/* Writes a count as 28 366, with thin spaces. */
static const char *draw_count(char out[DRAW_ROOM], size_t count)
{
    char digits[24], *to = out;
    int n = snprintf(digits, sizeof digits, "%zu", count);
    for (int i = 0; i < n; i++)
        to += sprintf(to, "%s%c", i > 0 && (n - i) % 3 == 0 ? "\xE2\x80\x89" : "", digits[i]);
    return out;
}
#define COUNT(count) draw_count((char[DRAW_ROOM]){0}, count)

static const char *draw_look(char out[DRAW_ROOM], const char *class, int colour)
{
    snprintf(out, DRAW_ROOM, "class='%s' fill='%s' stroke='%s'", class, draw_colour[colour],
             draw_colour[colour]);
    return out;
}
#define LOOK(class, colour) draw_look((char[DRAW_ROOM]){0}, class, colour)

/* ---------------- layout */

/* Returns the least overlap of two blocks along n axes; 0: they touch; below 0: they are apart. */
static double draw_overlap(const struct drawing *d, int i, int j, const int *axis, int n)
{
    const struct partition_box *a = &d->p->block[i].box, *b = &d->p->block[j].box;
    double least = INFINITY;
    for (int k = 0; k < n; k++)
        least = OXL_MIN(least, OXL_MIN(a->high[axis[k]], b->high[axis[k]]) -
                                   OXL_MAX(a->low[axis[k]], b->low[axis[k]]));
    return least;
}

/* Gives neighbours different colours, as long as there are unused ones. */
static void draw_choose_colours(struct drawing *d)
{
    for (int i = 0; i < d->blocks; i++)
        for (int k = 0, clash = 1; k < DRAW_COLOURS && clash; k++) {
            clash = 0;
            d->colour[i] = (i + k) % DRAW_COLOURS;
            for (int j = 0; j < i; j++)
                clash |=
                    d->colour[j] == d->colour[i] && draw_overlap(d, i, j, (const int[]){0, 1, 2}, 3) >= 0;
        }
}

/* Opens a panel bounded by the trimmed extents with a margin, and by the cameras near them. */
static struct drawing_panel draw_open_panel(const struct drawing *d, const char *title, int up)
{
    struct drawing_panel panel = {.title = title, .axis = {0, up}};
    for (int k = 0; k < 2; k++) {
        const int axis = panel.axis[k];
        const double low = d->p->plan->finite.low[axis], high = d->p->plan->finite.high[axis];
        const double size = OXL_MAX(high - low, DRAW_FLAT * OXL_MAX(d->p->extent[0], DRAW_POINT));
        double from = low, to = high;
        for (size_t v = 0; v < d->views; v++) {
            const double at = d->camera[3 * v + (size_t)axis];
            if (at > low - size && at < high + 2 * size) from = OXL_MIN(from, at), to = OXL_MAX(to, at);
        }
        panel.low[k] = from - DRAW_MARGIN * size;
        panel.high[k] = to + DRAW_MARGIN * size;
    }
    for (int i = 0; i < d->blocks; i++)
        for (int j = 0; j < i; j++) panel.stacked |= draw_overlap(d, i, j, panel.axis, 2) > 0;
    return panel;
}

static void draw_lay_out(struct drawing *d)
{
    double scale = INFINITY, wide = DRAW_MIN;
    d->below = 92; /* px; end of the title */
    for (int i = 0; i < d->panels; i++) {
        const struct drawing_panel *p = &d->panel[i];
        scale = OXL_MIN(
            scale, OXL_MIN(DRAW_WIDTH / (p->high[0] - p->low[0]), DRAW_HEIGHT / (p->high[1] - p->low[1])));
    }
    for (int i = 0; i < d->panels; i++) {
        struct drawing_panel *p = &d->panel[i];
        p->scale = scale;
        p->wide = scale * (p->high[0] - p->low[0]);
        p->tall = scale * (p->high[1] - p->low[1]);
        p->top = d->below + 26;
        d->below = p->top + p->tall + 46;
        wide = OXL_MAX(wide, p->wide);
    }
    d->rows = (d->blocks - 1) / (int)(wide / DRAW_COLUMN) + 1;
    d->wide = ceil(wide) + 2 * DRAW_EDGE;
    d->tall = ceil(d->below) + 74 + DRAW_ROW * d->rows;
}

/* ---------------- what is drawn in a panel */

/* Converts a point of the frame to px of the panel. */
static void draw_place(const struct drawing_panel *p, const double frame[3], double at[2])
{
    at[0] = p->scale * (frame[p->axis[0]] - p->low[0]);
    at[1] = p->tall - p->scale * (frame[p->axis[1]] - p->low[1]);
}

/* Computes x, y, width and height of the part of a box that the panel shows,
 * extended by DRAW_BEYOND at most. */
static void draw_place_box(const struct drawing_panel *p, const struct partition_box *box, double out[4])
{
    double low[2], high[2];
    draw_place(p, box->low, low);
    draw_place(p, box->high, high);
    out[0] = OXL_MAX(low[0], -DRAW_BEYOND);
    out[1] = OXL_MAX(high[1], -DRAW_BEYOND);
    out[2] = OXL_MIN(high[0], p->wide + DRAW_BEYOND) - out[0];
    out[3] = OXL_MIN(low[1], p->tall + DRAW_BEYOND) - out[1];
}

/* Draws a mark at a point of the frame. mark: commands of an SVG path, from the middle on. */
static void draw_mark(struct text *t, const struct drawing_panel *p, const double frame[3], const char *mark)
{
    double at[2];
    draw_place(p, frame, at);
    text_add(t, "M%s %s%s", PX(at[0]), PX(at[1]), mark);
}

/* Draws the points, one path per block. */
static void draw_points(struct drawing *d, const struct drawing_panel *panel)
{
    const struct colmap *c = scene_colmap(d->p->plan->scene);
    const double count = (double)c->point_count, step = OXL_MAX(1, count * d->panels / DRAW_POINTS);
    for (int block = 0; block < d->blocks; block++) {
        text_add(&d->t, "<path %s d='", LOOK("point", d->colour[block]));
        /* Draws a random point of each section, against periodic files. */
        for (size_t k = 0; (double)(k + 1) * step <= count; k++) {
            const size_t i = (size_t)(((double)k + random_unit(random_bits(1, k, 0))) * step);
            double frame[3];
            if (d->p->plan->owner[i] != (uint32_t)block) continue;
            partition_to_frame(d->p, c->point[i].position, frame);
            draw_mark(&d->t, panel, frame, "h0");
        }
        text_add(&d->t, "'/>\n");
    }
}

/* Draws the cameras whose list[v] is `block`, as one path. */
static void draw_cameras_of(struct drawing *d, const struct drawing_panel *panel, const int *list, int block,
                            const char *class, const char *mark)
{
    const size_t views = d->views, stride = views * (size_t)d->panels / DRAW_CAMERAS + 1;
    text_add(&d->t, "<path %s d='", LOOK(class, block < 0 ? 0 : d->colour[block]));
    for (size_t v = 0; v < views; v += stride)
        if (list[v] == block) draw_mark(&d->t, panel, d->camera + 3 * v, mark);
    text_add(&d->t, "'/>\n");
}

static void draw_cameras(struct drawing *d, const struct drawing_panel *panel)
{
    const int blocks = d->blocks;
    draw_cameras_of(d, panel, d->base, DRAW_TEST_VIEW, "test", "m0-3.5l3.5 3.5-3.5 3.5-3.5-3.5z");
    for (int i = 0; i < blocks; i++) draw_cameras_of(d, panel, d->border, i, "ring", "h0");
    for (int i = DRAW_NO_BLOCK; i < blocks; i++) draw_cameras_of(d, panel, d->base, i, "halo", "h0");
    for (int i = 0; i < blocks; i++) draw_cameras_of(d, panel, d->base, i, "camera", "h0");
}

/* Writes a block's number in its corner; numbers of blocks with the same corner stand side
 * by side, as many as fit. */
static void draw_number(struct drawing *d, const struct drawing_panel *panel, int block)
{
    double at[4], other[4], x = 4;
    draw_place_box(panel, &d->p->block[block].box, at);
    for (int i = 0; panel->stacked && i < block; i++) {
        draw_place_box(panel, &d->p->block[i].box, other);
        if (fabs(other[0] - at[0]) < DRAW_DIGITS && fabs(other[1] - at[1]) < DRAW_DIGITS) x += DRAW_DIGITS;
    }
    if (at[2] >= x + DRAW_DIGITS && at[3] >= DRAW_DIGITS)
        text_add(&d->t, "%s%d</text>\n",
                 SVG_TEXT(OXL_MAX(at[0], 0) + x, OXL_MAX(at[1], 0) + 15, "class='number'"), block);
}

static void draw_panel(struct drawing *d, const struct drawing_panel *p)
{
    const double length = svg_scale_bar(DRAW_WIDTH / 7.0 / p->scale), y = p->tall + 18;
    text_add(&d->t, "<g transform='translate(%d %s)'>%s%s</text>\n", DRAW_EDGE, PX(p->top),
             SVG_TEXT(0, -10, "class='head'"), p->title);
    text_add(&d->t, "%s%s",
             /* an inner svg, which clips its content */
             SVG_OPEN(p->wide, p->tall, d->views > DRAW_MANY ? "class='many'" : ""),
             SVG_RECTANGLE(0, 0, p->wide, p->tall, "fill='#fff'"));
    draw_points(d, p);
    for (int i = 0; i < d->blocks; i++) {
        double at[4];
        draw_place_box(p, &d->p->block[i].box, at);
        text_add(&d->t, "%s",
                 SVG_RECTANGLE(at[0], at[1], at[2], at[3],
                               LOOK(p->stacked ? "block line" : "block", d->colour[i])));
    }
    draw_cameras(d, p);
    for (int i = 0; i < d->blocks; i++) draw_number(d, p, i);
    text_add(&d->t, "</svg>\n%s", SVG_RECTANGLE(0, 0, p->wide, p->tall, "class='frame'"));
    text_add(&d->t, "<path class='scale' d='M0 %sv4h%sv-4'/>\n%s%s unit%s</text>\n", PX(y - 4),
             PX(length * p->scale), SVG_TEXT(length * p->scale + 8, y + 2, ""), NUMBER(length),
             length == 1 ? "" : "s");
    text_add(&d->t, "%sprincipal axes %d \xE2\x86\x92 and %d \xE2\x86\x91</text></g>\n", /* arrows */
             SVG_TEXT(p->wide, y + 2, "class='end'"), p->axis[0] + 1, p->axis[1] + 1);
}

/* ---------------- words around the panels */

static void draw_title(struct drawing *d)
{
    const struct scene_stats *stats = &d->p->plan->scene->stats;
    text_add(&d->t, "%s%d block%s</text>\n", SVG_TEXT(DRAW_EDGE, 46, "class='title'"), d->blocks,
             d->blocks == 1 ? "" : "s");
    text_add(&d->t, "%s%s points, %s training views, %d held out; cut in %dD</text>\n",
             SVG_TEXT(DRAW_EDGE, 70, "class='sub'"), COUNT(stats->points),
             COUNT((size_t)(stats->views - stats->test_views)), stats->test_views, d->p->dimensions);
}

static void draw_legend(struct drawing *d)
{
    text_add(
        &d->t,
        "<g class='key' transform='translate(%d %s)'><path class='camera' d='M6 0h0'/><text x='17' y='4'>base view of a "
        "block (of several: the first)</text><path class='ring' d='M290 0h0'/><path class='halo' d='M290 0h0'/><text x='301' "
        "y='4'>ring: border view of a block</text><path class='test' d='M484-3.5l3.5 3.5-3.5 3.5-3.5-3.5z'/><text x='495' "
        "y='4'>held out for the test</text><text y='24'>P points inside, C base + border views. Blocks at the edge are "
        "unbounded: the dashed line is the border of the image.</text></g>\n",
        DRAW_EDGE, PX(d->below));
}

static void draw_table(struct drawing *d)
{
    for (int i = 0; i < d->blocks; i++) {
        const struct partition_block *b = &d->p->block[i];
        const double x = DRAW_EDGE + DRAW_COLUMN * (i / d->rows),
                     y = d->below + 50 + DRAW_ROW * (i % d->rows);
        text_add(&d->t, "%s%s%d</text>%sP %s</text>%sC %d + %d</text>\n",
                 SVG_RECTANGLE(x, y - 9, 10, 10, LOOK("swatch", d->colour[i])),
                 SVG_TEXT(x + 36, y, "class='cell bold end'"), i, SVG_TEXT(x + 104, y, "class='cell end'"),
                 COUNT(b->points), SVG_TEXT(x + 114, y, "class='cell'"), b->base_views, b->border_views);
    }
}

static const char draw_style[] =
    "text{font:12px ui-sans-serif,system-ui,'Segoe UI','Helvetica Neue',Helvetica,Arial,sans-serif;fill:#4b5a66}"
    ".title{font-size:26px;font-weight:650;fill:#22313c}.sub{font-size:14px}.head{font-size:13px;font-weight:600}"
    ".cell{font-variant-numeric:tabular-nums;fill:#22313c}.bold{font-weight:650}.end{text-anchor:end}"
    ".number{font-size:14px;font-weight:700;fill:#22313c;paint-order:stroke;stroke:#fff;stroke-width:4px;stroke-opacity:.85;"
    "stroke-linejoin:round}.key .camera,.key .ring{stroke:#4b5a66}"
    ".frame{fill:none;stroke:#b7c2ca;stroke-dasharray:2 4}.block{fill-opacity:.1;stroke-width:1.4}.line{fill:none}"
    ".point,.ring,.halo,.camera{fill:none;stroke-linecap:round}.point{stroke-width:2;stroke-opacity:.55}"
    ".ring{stroke-width:11}.halo{stroke:#fff;stroke-width:8}.camera{stroke-width:5.4}"
    ".many .ring{stroke-width:6.4}.many .halo{stroke-width:4.6}.many .camera{stroke-width:3}.many .point{stroke-width:1.5}"
    ".test{fill:#fff;stroke:#6d7b86}.scale{fill:none;stroke:#22313c;stroke-width:1.5}.swatch{stroke:none}";

/* ---------------- the file */

static void draw_find_cameras(struct drawing *d)
{
    const struct partition_plan *plan = d->p->plan;
    for (size_t v = 0; v < d->views; v++) {
        const oxl_view *view = oxl_scene_view(plan->scene, (int)v);
        double centre[3];
        camera_position(&view->camera, centre);
        for (int k = 0; k < 3; k++) centre[k] += d->p->origin[k];
        partition_to_frame(d->p, centre, d->camera + 3 * v);
        d->base[v] = d->border[v] = view->is_test ? DRAW_TEST_VIEW : DRAW_NO_BLOCK;
        for (int i = d->blocks - 1; i >= 0; i--) {
            if (plan->role[(size_t)i * d->views + v] == PARTITION_BASE) d->base[v] = i;
            if (plan->role[(size_t)i * d->views + v] == PARTITION_BORDER) d->border[v] = i;
        }
    }
}

OXL_INTERNAL oxl_result partition_draw(oxl_context *ctx, const struct partition *p, const char *path)
{
    const size_t views = p->plan->visibility->views;
    struct drawing d = {.t = {.ctx = ctx}, .p = p, .views = views, .blocks = p->block_count};
    oxl_result rc = OXL_OK;
    d.colour = oxl_alloc(ctx, (size_t)p->block_count, sizeof *d.colour);
    d.camera = oxl_alloc(ctx, views, 3 * sizeof *d.camera);
    d.base = oxl_alloc(ctx, views, sizeof *d.base);
    d.border = oxl_alloc(ctx, views, sizeof *d.border);
    if (!d.colour || !d.camera || !d.base || !d.border) rc = OXL_ERR_MEMORY;
    if (rc != OXL_OK) goto done;
    draw_find_cameras(&d);
    draw_choose_colours(&d);
    d.panel[d.panels++] = draw_open_panel(&d, "From above", 1);
    if (p->dimensions == 3) d.panel[d.panels++] = draw_open_panel(&d, "From the side", 2);
    draw_lay_out(&d);
    text_add(&d.t, "%s<title>The survey in %d blocks</title>\n<style>%s</style>\n%s",
             SVG_OPEN(d.wide, d.tall, ""), d.blocks, draw_style,
             SVG_RECTANGLE(0, 0, d.wide, d.tall, "fill='#f4f7f9'"));
    draw_title(&d);
    for (int i = 0; i < d.panels; i++) draw_panel(&d, &d.panel[i]);
    draw_legend(&d);
    draw_table(&d);
    text_add(&d.t, "</svg>\n");
    rc = os_write_text(ctx, path, &d.t);
done:
    text_free(&d.t);
    OXL_FREE(ctx, d.colour, d.camera, d.base, d.border);
    return rc;
}

/* partition_svg.c - partition.svg: the survey from above, and from the side when it is cut in 3D, with its blocks, points and cameras.
 *
 * A plain SVG: shapes and text, no script, no font of its own. Points and cameras are thinned at a fixed stride, so that the file of a
 * large survey stays small and the same survey gives the same bytes. No number is written through the locale.
 */
#include "partition.h"

enum {
    SVG_POINTS  = 12000, /* rendered in all panels together; 13 bytes each */
    SVG_CAMERAS = 4000,
    SVG_WIDTH   = 1120, /* px of a panel, at most */
    SVG_HEIGHT  = 760,
    SVG_MIN     = 700, /* px minimum width of the image, for the text */
    SVG_EDGE    = 44,
    SVG_MANY    = 300, /* views, from which on their marks are small */
    SVG_COLOURS = 12,
    SVG_LISTED  = 8,   /* blocks in a common label */
    SVG_ROWS    = 300, /* blocks listed in the table */
    SVG_COLUMN  = 190, /* px of a column of the table */
    SVG_NUMBER  = 48   /* bytes of a number as text */
};
#define SVG_MARGIN 0.05 /* of the extents, around them */

static const char *const svg_colour[SVG_COLOURS] = {"#1f77a8", "#e07b39", "#3a9d6e", "#b5507f", "#7a68b3", "#c9a227",
                                                    "#3fa7b5", "#c4504b", "#6b8e3d", "#8c6d5a", "#5479c4", "#a35fb0"};

struct svg_panel {
    const char *title;
    int         across, up;            /* axes of the frame */
    double      low[2], high[2];       /* of the frame, that are shown */
    double      scale;                 /* px a unit */
    double      left, top, wide, tall; /* px */
    int         stacked;               /* blocks lie behind each other, as seen from here */
};

struct svg {
    struct text             t;
    const struct partition *p;
    const struct colmap    *colmap;
    int                    *colour; /* (blocks) */
    double                 *camera; /* (views,3) in the frame */
    int                    *base;   /* (views) first block that has it as a base view, -1 */
    int                    *border; /* (views) */
    struct svg_panel        panel[2];
    int                     panels;
};

/* ---------------------------------------------------------------- numbers and words */

/* With one decimal. */
static const char *svg_px(char out[SVG_NUMBER], double px)
{
    const long tenths = (long)floor(10 * px + 0.5), whole = labs(tenths) / 10, rest = labs(tenths) % 10;
    snprintf(out, SVG_NUMBER, rest ? "%s%ld.%ld" : "%s%ld", tenths < 0 ? "-" : "", whole, rest);
    return out;
}

/* 28 366, with thin spaces. */
static const char *svg_count(char out[SVG_NUMBER], size_t count)
{
    char digits[24], *to = out;
    int  n = snprintf(digits, sizeof digits, "%zu", count);
    for (int i = 0; i < n; i++) to += sprintf(to, "%s%c", i > 0 && (n - i) % 3 == 0 ? "\xE2\x80\x89" : "", digits[i]);
    return out;
}

#define PX(px)       svg_px((char[SVG_NUMBER]){0}, px)
#define COUNT(count) svg_count((char[SVG_NUMBER]){0}, count)

/* Three significant digits of a length below 100, whole units above. */
static double svg_rounded(double units)
{
    double parts = 1;
    while (parts < 1e9 && units * parts < 100) parts *= 10;
    return floor(units * parts + 0.5) / parts;
}

static void svg_text(struct text *t, const char *class, double x, double y, const char *format, ...) OXL_PRINTF(5, 6);
static void svg_text(struct text *t, const char *class, double x, double y, const char *format, ...)
{
    char    words[400];
    va_list args;
    va_start(args, format);
    vsnprintf(words, sizeof words, format, args);
    va_end(args);
    text_add(t, "<text class=\"%s\" x=\"%s\" y=\"%s\">%s</text>\n", class, PX(x), PX(y), words);
}

/* ---------------------------------------------------------------- layout */

/* The trimmed extents with a margin, and the cameras near them. */
static void svg_set_bounds(struct svg *s, struct svg_panel *panel)
{
    const int views = (int)s->p->plan->visibility->views;
    for (int k = 0; k < 2; k++) {
        const int    axis = k ? panel->up : panel->across;
        const double low = s->p->plan->finite.low[axis], high = s->p->plan->finite.high[axis];
        const double size = OXL_MAX(high - low, 1e-3 * OXL_MAX(s->p->extent[0], 1e-9));
        double       from = low, to = high;
        for (int v = 0; v < views; v++) {
            const double at = s->camera[3 * v + axis];
            if (at > low - size && at < high + 2 * size) from = OXL_MIN(from, at), to = OXL_MAX(to, at);
        }
        panel->low[k]  = from - SVG_MARGIN * size;
        panel->high[k] = to + SVG_MARGIN * size;
    }
}

static int svg_is_stacked(const struct partition *p, const struct svg_panel *panel)
{
    for (int i = 0; i < p->block_count; i++)
        for (int j = 0; j < i; j++) {
            const struct partition_box *a = &p->block[i].box, *b = &p->block[j].box;
            const int                   x = panel->across, y = panel->up;
            if (a->low[x] < b->high[x] && b->low[x] < a->high[x] && a->low[y] < b->high[y] && b->low[y] < a->high[y]) return 1;
        }
    return 0;
}

static double svg_lay_out(struct svg *s, double top)
{
    double scale = INFINITY;
    for (int i = 0; i < s->panels; i++) {
        const struct svg_panel *p = &s->panel[i];
        scale = OXL_MIN(scale, OXL_MIN(SVG_WIDTH / (p->high[0] - p->low[0]), SVG_HEIGHT / (p->high[1] - p->low[1])));
    }
    for (int i = 0; i < s->panels; i++) {
        struct svg_panel *p = &s->panel[i];
        p->scale            = scale;
        p->wide             = scale * (p->high[0] - p->low[0]);
        p->tall             = scale * (p->high[1] - p->low[1]);
        p->left             = SVG_EDGE;
        p->top              = top + 26;
        top                 = p->top + p->tall + 46;
    }
    return top;
}

static double svg_x(const struct svg_panel *p, double across)
{
    return p->left + p->scale * (across - p->low[0]);
}

static double svg_y(const struct svg_panel *p, double up)
{
    return p->top + p->tall - p->scale * (up - p->low[1]);
}

static int svg_shows(const struct svg_panel *p, const double frame[3])
{
    const double a = frame[p->across], b = frame[p->up];
    return a >= p->low[0] && a <= p->high[0] && b >= p->low[1] && b <= p->high[1];
}

/* ---------------------------------------------------------------- colours */

static int svg_touch(const struct partition_box *a, const struct partition_box *b)
{
    int touch = 1;
    for (int k = 0; k < 3; k++) touch &= a->low[k] <= b->high[k] && b->low[k] <= a->high[k];
    return touch;
}

/* Neighbours differ: of the colours that no neighbour has, the one that was used least. */
static void svg_choose_colours(struct svg *s)
{
    int used[SVG_COLOURS] = {0};
    for (int i = 0; i < s->p->block_count; i++) {
        int taken[SVG_COLOURS] = {0}, best = 0;
        for (int j = 0; j < i; j++)
            if (svg_touch(&s->p->block[i].box, &s->p->block[j].box)) taken[s->colour[j]]++;
        for (int c = 1; c < SVG_COLOURS; c++)
            if (taken[c] < taken[best] || (taken[c] == taken[best] && used[c] < used[best])) best = c;
        s->colour[i] = best;
        used[best]++;
    }
}

/* ---------------------------------------------------------------- what is rendered in a panel */

static void svg_rectangle(struct text *t, const char *class, const char *colour, double x, double y, double wide, double tall)
{
    text_add(t, "<rect class=\"%s\" x=\"%s\" y=\"%s\" width=\"%s\" height=\"%s\"", class, PX(x), PX(y), PX(OXL_MAX(wide, 0)),
             PX(OXL_MAX(tall, 0)));
    if (colour) text_add(t, " fill=\"%s\" stroke=\"%s\"", colour, colour);
    text_add(t, "/>\n");
}

/* The part of a block's owner that the panel shows: x, y, width, height. */
static void svg_to_pixels(const struct svg_panel *p, const struct partition_box *box, double out[4])
{
    const double left  = svg_x(p, OXL_MAX(box->low[p->across], p->low[0])),
                 right = svg_x(p, OXL_MIN(box->high[p->across], p->high[0]));
    const double top = svg_y(p, OXL_MIN(box->high[p->up], p->high[1])), bottom = svg_y(p, OXL_MAX(box->low[p->up], p->low[1]));
    out[0] = left;
    out[1] = top;
    out[2] = right - left;
    out[3] = bottom - top;
}

static void svg_dot(struct text *t, const struct svg_panel *p, const double frame[3])
{
    text_add(t, "M%s %sh0", PX(svg_x(p, frame[p->across])), PX(svg_y(p, frame[p->up])));
}

/* One path a block. */
static void svg_draw_points(struct svg *s, const struct svg_panel *panel)
{
    const size_t count = s->colmap->point_count, most = SVG_POINTS / (size_t)s->panels;
    const double stride = OXL_MAX(1, (double)count / (double)most);
    for (int block = 0; block < s->p->block_count; block++) {
        text_add(&s->t, "<path class=\"point\" stroke=\"%s\" d=\"", svg_colour[s->colour[block]]);
        for (size_t k = 0; (double)(k + 1) * stride <= (double)count;
             k++) { /* one of each stretch: files have their own rhythm */
            const size_t i = (size_t)(((double)k + random_unit(random_bits(1, k, 0))) * stride);
            double       frame[3];
            if (s->p->plan->owner[i] != (uint32_t)block) continue;
            partition_to_frame(s->p, s->colmap->point[i].position, frame);
            if (svg_shows(panel, frame)) svg_dot(&s->t, panel, frame);
        }
        text_add(&s->t, "\"/>\n");
    }
}

static void svg_draw_blocks(struct svg *s, const struct svg_panel *panel)
{
    for (int i = 0; i < s->p->block_count; i++) {
        const struct partition_box *box  = &s->p->block[i].box;
        const double                left = box->low[panel->across] < panel->low[0] ? 4 : 0,
                     right               = box->high[panel->across] > panel->high[0] ? 4 : 0;
        const double top = box->high[panel->up] > panel->high[1] ? 4 : 0, bottom = box->low[panel->up] < panel->low[1] ? 4 : 0;
        double       at[4];
        svg_to_pixels(panel, box, at); /* an open side has its line outside the panel, where it is clipped */
        svg_rectangle(&s->t, panel->stacked ? "block line" : "block", svg_colour[s->colour[i]], at[0] - left, at[1] - top,
                      at[2] + left + right, at[3] + top + bottom);
    }
}

/* The cameras whose list[v] is `block`, as one path. */
static void svg_draw_cameras_of(struct svg *s, const struct svg_panel *panel, const int *list, int block, const char *class)
{
    const size_t views = s->p->plan->visibility->views, stride = views * (size_t)s->panels / SVG_CAMERAS + 1;
    int          any = 0;
    for (size_t v = 0; v < views; v += stride) {
        if (oxl_scene_view(s->p->plan->scene, (int)v)->is_test || !svg_shows(panel, s->camera + 3 * v)) continue;
        if (list[v] != block) continue;
        if (!any++)
            text_add(&s->t, "<path class=\"%s\" stroke=\"%s\" d=\"", class, block < 0 ? "#98a4ad" : svg_colour[s->colour[block]]);
        svg_dot(&s->t, panel, s->camera + 3 * v);
    }
    if (any) text_add(&s->t, "\"/>\n");
}

static void svg_draw_cameras(struct svg *s, const struct svg_panel *panel)
{
    const int blocks = s->p->block_count;
    for (int i = 0; i < blocks; i++) svg_draw_cameras_of(s, panel, s->border, i, "ring");
    for (int i = -1; i < blocks; i++) svg_draw_cameras_of(s, panel, s->base, i, "halo");
    for (int i = 0; i < blocks; i++) svg_draw_cameras_of(s, panel, s->base, i, "camera");
}

static void svg_draw_test_views(struct svg *s, const struct svg_panel *panel)
{
    const size_t views = s->p->plan->visibility->views, stride = views * (size_t)s->panels / SVG_CAMERAS + 1;
    text_add(&s->t, "<path class=\"test\" d=\"");
    for (size_t v = 0; v < views; v += stride) {
        if (!oxl_scene_view(s->p->plan->scene, (int)v)->is_test || !svg_shows(panel, s->camera + 3 * v)) continue;
        text_add(&s->t, "M%s %sl3.5 3.5-3.5 3.5-3.5-3.5z", PX(svg_x(panel, s->camera[3 * v + (size_t)panel->across])),
                 PX(svg_y(panel, s->camera[3 * v + (size_t)panel->up]) - 3.5));
    }
    text_add(&s->t, "\"/>\n");
}

static void svg_label(struct svg *s, const struct svg_panel *panel, int i)
{
    const struct partition_block *b = &s->p->block[i];
    double                        at[4];
    svg_to_pixels(panel, &b->box, at);
    if (at[2] < 24 || at[3] < 16) return;
    if (at[2] < 92 || at[3] < 62) {
        svg_text(&s->t, "number small", at[0] + at[2] / 2, at[1] + at[3] / 2 + 4, "%d", i);
        return;
    }
    svg_text(&s->t, "number", at[0] + 10, at[1] + 25, "%d", i);
    svg_text(&s->t, "count", at[0] + 10, at[1] + 42, "P %s", COUNT(b->points));
    svg_text(&s->t, "count", at[0] + 10, at[1] + 58, "C %d + %d", b->base_views, b->border_views);
}

/* Blocks that have their middle in the same place share a label: 3, 4, 5. It is drawn for the first of them. */
static void svg_label_stacked(struct svg *s, const struct svg_panel *panel, int i)
{
    double mine[4], other[4];
    int    listed = 0, used = 0;
    char   words[SVG_LISTED * 12 + 8];
    svg_to_pixels(panel, &s->p->block[i].box, mine);
    for (int pass = 0; pass < 2; pass++)
        for (int j = pass ? i : 0; j < (pass ? s->p->block_count : i); j++) {
            svg_to_pixels(panel, &s->p->block[j].box, other);
            if (fabs(2 * mine[0] + mine[2] - 2 * other[0] - other[2]) > 2 * 14) continue;
            if (fabs(2 * mine[1] + mine[3] - 2 * other[1] - other[3]) > 2 * 14) continue;
            if (!pass) return;
            if (++listed <= SVG_LISTED) used += sprintf(words + used, listed > 1 ? ", %d" : "%d", j);
        }
    svg_text(&s->t, "number small", mine[0] + mine[2] / 2, mine[1] + mine[3] / 2 + 4, "%s%s", words,
             listed > SVG_LISTED ? " ..." : "");
}

/* 1, 2 or 5 times a power of ten, about a seventh of the panel. */
static void svg_draw_scale(struct svg *s, const struct svg_panel *panel)
{
    const double wanted = SVG_WIDTH / 7.0 / panel->scale, y = panel->top + panel->tall + 18;
    double       length = 1;
    while (length > wanted) length /= 10;
    while (10 * length <= wanted) length *= 10;
    length *= 5 * length <= wanted ? 5 : 2 * length <= wanted ? 2 : 1;
    text_add(&s->t, "<path class=\"scale\" d=\"M%s %sv4h%sv-4\"/>\n", PX(panel->left), PX(y - 4), PX(length * panel->scale));
    svg_text(&s->t, "note", panel->left + length * panel->scale + 8, y + 2, "%s unit%s", NUMBER(svg_rounded(length)),
             length == 1 ? "" : "s");
    svg_text(&s->t, "note end", panel->left + panel->wide, y + 2, "principal axes %d \xE2\x86\x92 and %d \xE2\x86\x91",
             panel->across + 1, panel->up + 1); /* arrows */
}

static void svg_draw_panel(struct svg *s, const struct svg_panel *panel, int index)
{
    svg_text(&s->t, "head", panel->left, panel->top - 10, "%s", panel->title);
    text_add(&s->t, "<clipPath id=\"clip%d\">", index);
    svg_rectangle(&s->t, "clip", NULL, panel->left, panel->top, panel->wide, panel->tall);
    text_add(&s->t, "</clipPath>\n");
    svg_rectangle(&s->t, "paper", NULL, panel->left, panel->top, panel->wide, panel->tall);
    text_add(&s->t, "<g clip-path=\"url(#clip%d)\"%s>\n", index,
             s->p->plan->visibility->views > SVG_MANY ? " class=\"many\"" : "");
    svg_draw_points(s, panel);
    svg_draw_blocks(s, panel);
    svg_draw_test_views(s, panel);
    svg_draw_cameras(s, panel);
    for (int i = 0; i < s->p->block_count; i++) {
        if (panel->stacked) svg_label_stacked(s, panel, i);
        else svg_label(s, panel, i);
    }
    text_add(&s->t, "</g>\n");
    svg_rectangle(&s->t, "frame", NULL, panel->left, panel->top, panel->wide, panel->tall);
    svg_draw_scale(s, panel);
}

/* ---------------------------------------------------------------- words around the panels */

static void svg_draw_title(struct svg *s)
{
    const struct scene_stats *stats = &s->p->plan->scene->stats;
    const double             *e     = s->p->extent;
    svg_text(&s->t, "title", SVG_EDGE, 46, "%d block%s", s->p->block_count, s->p->block_count == 1 ? "" : "s");
    svg_text(&s->t, "sub", SVG_EDGE, 70,
             "%s points, %s training views, %d held out; cut in %dD, principal extents %s \xC3\x97 %s \xC3\x97 %s", /* times */
             COUNT(stats->points), COUNT((size_t)(stats->views - stats->test_views)), stats->test_views, s->p->dimensions,
             NUMBER(svg_rounded(e[0])), NUMBER(svg_rounded(e[1])), NUMBER(svg_rounded(e[2])));
}

static double svg_key(struct svg *s, double x, double y, const char *shapes, const char *words)
{
    text_add(&s->t, "<g transform=\"translate(%s %s)\">%s<text class=\"note\" x=\"11\" y=\"4\">%s</text></g>\n", PX(x), PX(y),
             shapes, words);
    return x + 26 + 6.0 * (double)strlen(words);
}

static double svg_draw_legend(struct svg *s, double y)
{
    double x = SVG_EDGE + 6;
    x        = svg_key(s, x, y, "<path class=\"camera\" stroke=\"#4b5a66\" d=\"M0 0h0\"/>",
                       "base view of the block of its colour, the first if of several");
    x        = svg_key(s, x, y,
                       "<path class=\"ring\" stroke=\"#4b5a66\" d=\"M0 0h0\"/><path class=\"halo\" stroke=\"#fff\" d=\"M0 0h0\"/>",
                       "ring: border view of the block of its colour");
    x        = svg_key(s, x, y, "<path class=\"test\" d=\"M0-3.5l3.5 3.5-3.5 3.5-3.5-3.5z\"/>", "held out for the test");
    svg_text(
        &s->t, "note", SVG_EDGE, y + 24,
        "P points inside, C base + border views. Blocks at the edge are unbounded: the dashed line is the border of the image.");
    return y + 50;
}

static double svg_draw_table(struct svg *s, double y, double wide)
{
    const int columns = OXL_MAX(1, (int)((wide - 2 * SVG_EDGE) / SVG_COLUMN)), shown = OXL_MIN(s->p->block_count, (int)SVG_ROWS);
    const int rows = (shown + columns - 1) / columns;
    for (int i = 0; i < shown; i++) {
        const struct partition_block *b = &s->p->block[i];
        const double                  x = SVG_EDGE + SVG_COLUMN * (i / rows), at = y + 18.0 * (i % rows);
        svg_rectangle(&s->t, "swatch", svg_colour[s->colour[i]], x, at - 9, 10, 10);
        svg_text(&s->t, "cell bold end", x + 36, at, "%d", i);
        svg_text(&s->t, "cell end", x + 104, at, "P %s", COUNT(b->points));
        svg_text(&s->t, "cell", x + 114, at, "C %d + %d", b->base_views, b->border_views);
    }
    if (shown < s->p->block_count)
        svg_text(&s->t, "note", SVG_EDGE, y + 18.0 * rows + 4, "and %d more: partition.txt lists them all",
                 s->p->block_count - shown);
    return y + 18.0 * rows + (shown < s->p->block_count ? 18 : 0);
}

static const char svg_style[] =
    "text{font-family:ui-sans-serif,system-ui,'Segoe UI','Helvetica Neue',Helvetica,Arial,sans-serif;fill:#22313c}"
    ".title{font-size:26px;font-weight:650}.sub{font-size:14px;fill:#4b5a66}.head{font-size:13px;font-weight:600;fill:#4b5a66}"
    ".note{font-size:12px;fill:#4b5a66}.cell{font-size:12px;font-variant-numeric:tabular-nums}.bold{font-weight:650}"
    ".end{text-anchor:end}.number,.count{paint-order:stroke;stroke:#fff;stroke-width:4px;stroke-opacity:.85;"
    "stroke-linejoin:round}.number{font-size:19px;font-weight:700}.small{font-size:12px;text-anchor:middle}"
    ".count{font-size:12px;font-weight:500}"
    ".paper{fill:#fff}.frame{fill:none;stroke:#b7c2ca;stroke-dasharray:2 4}.block{fill-opacity:.1;stroke-width:1.4}.line{fill:none}"
    ".point,.ring,.halo,.camera{fill:none;stroke-linecap:round}.point{stroke-width:2;stroke-opacity:.55}"
    ".ring{stroke-width:11}.halo{stroke:#fff;stroke-width:8}.camera{stroke-width:5.4}"
    ".many .ring{stroke-width:6.4}.many .halo{stroke-width:4.6}.many .camera{stroke-width:3}.many .point{stroke-width:1.5}"
    ".test{fill:#fff;stroke:#6d7b86}.scale{fill:none;stroke:#22313c;stroke-width:1.5}.swatch{stroke:none}";

static void svg_draw(struct svg *s)
{
    double bottom, wide = 0, tall;
    int    rows;
    bottom = svg_lay_out(s, 92);
    for (int i = 0; i < s->panels; i++) wide = OXL_MAX(wide, s->panel[i].wide);
    wide = OXL_MAX(wide + 2 * SVG_EDGE, (double)SVG_MIN);
    rows = OXL_MAX(1, (int)((wide - 2 * SVG_EDGE) / SVG_COLUMN));
    rows = (OXL_MIN(s->p->block_count, (int)SVG_ROWS) + rows - 1) / rows;
    tall = bottom + 50 + 18.0 * rows + (s->p->block_count > SVG_ROWS ? 18 : 0) + 24;
    text_add(
        &s->t,
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"%d\" height=\"%d\" viewBox=\"0 0 %d %d\">\n"
        "<title>The survey in %d blocks</title>\n<style>%s</style>\n<rect width=\"100%%\" height=\"100%%\" fill=\"#f4f7f9\"/>\n",
        (int)ceil(wide), (int)ceil(tall), (int)ceil(wide), (int)ceil(tall), s->p->block_count, svg_style);
    svg_draw_title(s);
    for (int i = 0; i < s->panels; i++) svg_draw_panel(s, &s->panel[i], i);
    bottom = svg_draw_legend(s, bottom);
    svg_draw_table(s, bottom, wide);
    text_add(&s->t, "</svg>\n");
}

/* ---------------------------------------------------------------- the file */

static void svg_find_cameras(struct svg *s)
{
    const struct partition_plan *plan  = s->p->plan;
    const size_t                 views = plan->visibility->views;
    for (size_t v = 0; v < views; v++) {
        double centre[3];
        camera_position(&oxl_scene_view(plan->scene, (int)v)->camera, centre);
        for (int k = 0; k < 3; k++) centre[k] += s->p->origin[k];
        partition_to_frame(s->p, centre, s->camera + 3 * v);
        s->base[v] = s->border[v] = -1;
        for (int i = s->p->block_count - 1; i >= 0; i--) {
            if (plan->role[(size_t)i * views + v] == PARTITION_BASE) s->base[v] = i;
            if (plan->role[(size_t)i * views + v] == PARTITION_BORDER) s->border[v] = i;
        }
    }
}

OXL_INTERNAL oxl_result partition_draw(oxl_context *ctx, const struct partition *p, const char *path)
{
    const size_t views = p->plan->visibility->views;
    struct svg   s  = {.t = {.ctx = ctx}, .p = p, .colmap = scene_colmap(p->plan->scene), .panels = p->dimensions == 3 ? 2 : 1};
    oxl_result   rc = OXL_OK;
    s.panel[0]      = (struct svg_panel){.title = "From above", .across = 0, .up = 1};
    s.panel[1]      = (struct svg_panel){.title = "From the side", .across = 0, .up = 2};
    s.colour        = oxl_calloc(ctx, (size_t)p->block_count, sizeof *s.colour);
    s.camera        = oxl_alloc(ctx, views, 3 * sizeof *s.camera);
    s.base          = oxl_alloc(ctx, views, sizeof *s.base);
    s.border        = oxl_alloc(ctx, views, sizeof *s.border);
    if (!s.colour || !s.camera || !s.base || !s.border) {
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "no memory for the image of the partition");
        goto done;
    }
    svg_find_cameras(&s);
    svg_choose_colours(&s);
    for (int i = 0; i < s.panels; i++) {
        svg_set_bounds(&s, &s.panel[i]);
        s.panel[i].stacked = svg_is_stacked(p, &s.panel[i]);
    }
    svg_draw(&s);
    rc = os_write_text(ctx, path, &s.t);
done:
    text_free(&s.t);
    OXL_FREE(ctx, s.colour, s.camera, s.base, s.border);
    return rc;
}

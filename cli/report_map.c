/* report_map.c - draws the survey from above (frame.c): its points in their colours, the cameras on top.
 *
 * The points become one image, so that the page does not grow with them; cameras are drawn over it as
 * circles, so that they are distinguishable at any size.
 */
#include "report_state.h"
#include "../src/formats/svg.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MAP_WIDTH = 960, MAP_CAMERAS = 4000 };

struct map {
    const oxl_scene *scene;
    struct frame frame;
    double low[2], high[2]; /* bounds of the map along right and up, units */
    double scale;           /* px a unit */
    int width, height;
};

/* Sets the scale and the size of the map, with a margin. Reduces the scale where the map would be
 * higher than twice its width. */
static void map_size(struct map *m)
{
    const double wide = fmax(m->high[0] - m->low[0], 1e-9), tall = fmax(m->high[1] - m->low[1], 1e-9),
                 edge = 0.03 * fmax(wide, tall);
    for (int d = 0; d < 2; d++) m->low[d] -= edge, m->high[d] += edge;
    m->width = MAP_WIDTH;
    m->scale = MAP_WIDTH / (wide + 2 * edge);
    m->height = (int)fmin(ceil((tall + 2 * edge) * m->scale), 2 * MAP_WIDTH);
    m->scale = fmin(m->scale, m->height / (tall + 2 * edge));
}

static double map_x(const struct map *m, const double p[3])
{
    return (frame_along(&m->frame, p, 0) - m->low[0]) * m->scale;
}

static double map_y(const struct map *m, const double p[3])
{
    return (m->high[1] - frame_along(&m->frame, p, 1)) * m->scale;
}

/* ---------------- the image of the points */

/* Draws the points as squares, which are larger where there are few. The highest point of a pixel
 * shows. top (H,W): its height. */
static void map_draw_points(const struct map *m, oxl_image *image, double *top)
{
    const oxl_point *point = oxl_scene_points(m->scene);
    const size_t count = oxl_scene_point_count(m->scene), pixels = (size_t)m->width * (size_t)m->height;
    const int side = fmin(sqrt((double)pixels / ((double)count + 1)), 5) < 2
                         ? 1
                         : (int)fmin(sqrt((double)pixels / (double)count), 5);
    static const float sea[3] = {0.035f, 0.10f, 0.14f};
    for (size_t i = 0; i < pixels; i++) {
        top[i] = -INFINITY;
        for (int c = 0; c < 3; c++) image->rgb[(size_t)c * pixels + i] = sea[c];
    }
    for (size_t i = 0; i < count; i++) {
        const double x = map_x(m, point[i].position), y = map_y(m, point[i].position),
                     height = frame_along(&m->frame, point[i].position, 2);
        for (int k = 0; k < side * side; k++) {
            const double px = floor(x) + k % side, py = floor(y) + k / side;
            size_t at;
            if (!(px >= 0 && py >= 0 && px < m->width && py < m->height)) continue;
            at = (size_t)py * (size_t)m->width + (size_t)px;
            if (height <= top[at]) continue;
            top[at] = height;
            for (int c = 0; c < 3; c++) image->rgb[(size_t)c * pixels + at] = (float)point[i].rgb[c] / 255;
        }
    }
}

static void map_points(struct report *r, const struct map *m)
{
    oxl_image image = {0};
    double *top = malloc(sizeof *top * (size_t)m->width * (size_t)m->height);
    if (top && oxl_image_create(r->ctx, m->width, m->height, &image) == OXL_OK) {
        map_draw_points(m, &image, top);
        page_jpeg(r, &image, 82);
    } else r->page.failed = 1;
    oxl_image_free(r->ctx, &image);
    free(top);
}

/* ---------------- the drawing */

static void map_cameras(struct output *t, const struct map *m)
{
    const int views = oxl_scene_view_count(m->scene), stride = 1 + views / MAP_CAMERAS;
    const double radius = fmax(2.2, fmin(6, 60 / sqrt((double)views)));
    for (int test = 0; test < 2; test++)
        for (int i = 0; i < views; i += stride) {
            const oxl_view *view = oxl_scene_view(m->scene, i);
            double c[3];
            if (view->is_test != test) continue;
            frame_eye(view, c);
            output_add(t, "%s", SVG_CIRCLE(map_x(m, c), map_y(m, c), radius, test ? "class='test'" : ""));
            if (views <= 500) output_add(t, "<title>%S</title>", view->name);
            output_add(t, "</circle>\n");
        }
}

/* Draws a scale bar of 1, 2 or 5 times a power of ten, a fifth of the width at most. */
static void map_ruler(struct report *r, const struct map *m)
{
    struct output *t = &r->page;
    const double scale = m->scale / (r->scale > 0 ? r->scale : 1),
                 length = svg_scale_bar(m->width / scale / 5), px = length * scale;
    const int y = m->height - 22, decimals = length < 1 ? (int)ceil(-log10(length) - 1e-9) : 0;
    output_add(t, "%s<path d=\"M26 %d v8 h%.1f v-8\"/>%s%.*f %s%s</text>",
               SVG_RECTANGLE(14, y - 36, fmax(px, 100) + 24, 50, "rx='6'"), y - 2, px,
               SVG_TEXT(26, y - 12, ""), decimals, length, r->scale > 0 ? "metre" : "unit",
               length == 1 ? "" : "s");
}

static void map_figure(struct report *r, const oxl_scene *scene)
{
    struct output *t = &r->page;
    struct map m = {.scene = scene};
    frame_of(scene, &m.frame);
    if (!frame_bounds(&m.frame, scene, 1, m.low, m.high)) {
        t->failed = 1;
        return;
    }
    map_size(&m);
    output_add(t, "<figure>%s<image width=\"%d\" height=\"%d\" href=\"",
               SVG_OPEN(m.width, m.height, "class='map' role='img' aria-label='Map of cameras and points'"),
               m.width, m.height);
    map_points(r, &m);
    output_add(t, "\"/>\n");
    map_cameras(t, &m);
    map_ruler(r, &m);
    output_add(t,
               "</svg>\n<figcaption>View from above. Initial points in their colours; white: training views, "
               "yellow: held-out views.</figcaption></figure>\n");
}

static void map_partition(struct report *r)
{
    size_t size = 0;
    char *svg = r->blocks > 1 ? output_read(r->out, "partition.svg", &size) : NULL;
    if (svg && size < 3000000) {
        output_add(&r->page, "<figure><img alt=\"Blocks of the survey\" src=\"");
        page_data(&r->page, "image/svg+xml", svg, size);
        output_add(&r->page,
                   "\"><figcaption>partition.svg: the blocks of the survey.</figcaption></figure>\n");
    } else if (svg)
        output_add(&r->page,
                   "<p>The blocks are shown in partition.svg, which is too large to embed here.</p>\n");
    free(svg);
}

void map_section(struct report *r)
{
    if (r->survey_scene && oxl_scene_point_count(r->survey_scene) > 0) map_figure(r, r->survey_scene);
    else output_add(&r->page, "<p class=\"pale\">No map: the survey is not found.</p>\n");
    map_partition(r);
}

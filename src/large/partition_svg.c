/* partition_svg.c - draws partition.svg: the blocks, points and cameras of a survey from above, and from the
 * side where it is cut in 3D.
 *
 * Coordinates are whole numbers, so the locale has no effect. Points are thinned at a fixed stride.
 */
#include "partition.h"
#include "../survey/sparse.h"
#include "../survey/scene.h"

enum { DRAW_SIDE = 1000, DRAW_EDGE = 80, DRAW_POINTS = 12000 }; /* px; px; most points */

struct drawing_panel { /* Shows two axes of the frame, to the right and up. */
    struct text *t;
    const struct partition *p;
    int up, top; /* axis; px */
    double scale;
};

/* Calculates the px of a place in the frame. */
static void draw_place(const struct drawing_panel *d, const double frame[3], int at[2])
{
    const struct partition_box *all = &d->p->plan->finite;
    const double x = d->scale * (frame[0] - all->low[0]), y = d->scale * (all->high[d->up] - frame[d->up]);
    at[0] = DRAW_EDGE + (int)OXL_CLAMP(x, -DRAW_EDGE, DRAW_SIDE + DRAW_EDGE);
    at[1] = d->top + (int)OXL_CLAMP(y, -DRAW_EDGE, DRAW_SIDE + DRAW_EDGE);
}

static void draw_mark(const struct drawing_panel *d, const double world[3])
{
    double frame[3];
    int at[2];
    partition_to_frame(d->p, world, frame);
    draw_place(d, frame, at);
    text_add(d->t, "M%d %dh0", at[0], at[1]);
}

/* Draws a block in a colour of its own: every step-th point, box, number. */
static void draw_block(const struct drawing_panel *d, int block, size_t step)
{
    const struct colmap *c = scene_colmap(d->p->plan->scene);
    const struct partition_box *box = &d->p->block[block].finite;
    int low[2], high[2];
    draw_place(d, box->low, low);
    draw_place(d, box->high, high);
    text_add(d->t, "<g stroke='hsl(%d 60%% 45%%)'><path d='", block * 137 % 360); /* the golden angle */
    for (size_t i = 0; i < c->point_count; i += step)
        if (d->p->plan->owner[i] == block) draw_mark(d, c->point[i].position);
    text_add(d->t, "'/><rect x='%d' y='%d' width='%d' height='%d'/></g><text x='%d' y='%d'>%d</text>\n",
             low[0], high[1], high[0] - low[0], low[1] - high[1], low[0] + 4, high[1] + 15, block);
}

static void draw_panel(const struct drawing_panel *d)
{
    const oxl_scene *scene = d->p->plan->scene;
    for (int i = 0; i < d->p->block_count; i++)
        draw_block(d, i, scene_colmap(scene)->point_count / DRAW_POINTS + 1);
    text_add(d->t, "<path class='camera' d='");
    for (int v = 0; v < oxl_scene_view_count(scene); v++) {
        double centre[3];
        camera_position(&oxl_scene_view(scene, v)->camera, centre);
        for (int k = 0; k < 3; k++) centre[k] += d->p->origin[k];
        draw_mark(d, centre);
    }
    text_add(d->t, "'/>\n");
}

OXL_INTERNAL oxl_result partition_draw(oxl_context *ctx, const struct partition *p, const char *path)
{
    struct text t = {.ctx = ctx};
    const double scale = DRAW_SIDE / OXL_MAX(OXL_MAX(p->extent[0], p->extent[1]), 1e-9);
    const struct drawing_panel above = {&t, p, 1, DRAW_EDGE, scale},
                               beside = {&t, p, 2, 2 * DRAW_EDGE + (int)(scale * p->extent[1]), scale};
    const int deep = p->dimensions == 3 ? (int)(scale * p->extent[2]) + DRAW_EDGE : 0;
    oxl_result rc;
    text_add(&t,
             "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 %d %d'>\n"
             "<title>The survey in %d blocks, along its principal axes; dots: cameras</title>\n"
             "<style>path{stroke-width:2;stroke-linecap:round}rect{fill:none;stroke-width:2}"
             ".camera{stroke:#000;stroke-width:4}text{font:15px sans-serif}</style>\n",
             DRAW_SIDE + 2 * DRAW_EDGE, beside.top + deep, p->block_count);
    draw_panel(&above);
    if (deep) draw_panel(&beside);
    text_add(&t, "</svg>\n");
    rc = os_write_text(ctx, path, &t);
    text_free(&t);
    return rc;
}

OXL_INTERNAL oxl_result partition_save(oxl_context *ctx, const struct partition *p, const char *out)
{
    oxl_result rc = oxl_make_folder(ctx, out);
    if (rc == OXL_OK) rc = partition_draw(ctx, p, PATH(out, "partition.svg"));
    return rc == OXL_OK ? partition_write(ctx, PATH(out, "partition.txt"), p) : rc;
}

/* cloud.c - writes points on the surface of a model, as PLY or LAS.
 *
 * Each training view's pixel whose place two views or more confirm (surface.c) is a point, of the view that sees it
 * nearest alone, so that places are not written once a view. A point has the model's colour, the normal of its
 * view's depths, and the number of views that confirm it. Coordinates are the survey's world, in metres with
 * --scale.
 *
 * The PLY is binary, with double coordinates. The LAS is version 1.4 R15 (ASPRS 2019), point format 2, with the CRS
 * as GeoTIFF keys, which this format allows without a database of CRS; the views are its user data, and
 * it has no normals.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LAS_HEADER = 375, LAS_RECORD = 26 };
#define CLOUD_EDGE 0.05 /* fraction of the depth: largest distance of neighbours on one surface */

/* ---------------- points of a view */

struct cloud_view {
    const struct surface *s;
    int view, enough;
    struct cloud_point *point; /* (height,width) views 0: there is none */
};

/* Sets the unit normal on the camera's side from the places around; towards the camera where they are no surface. */
static void cloud_normal(const struct surface_view *v, size_t at, const double p[3], double normal[3])
{
    const struct sheet *t = &v->sheet;
    const size_t row = 2 * (size_t)t->camera.width, step[4] = {(size_t)-2, 2, -row, row};
    double across[2][3] = {{0}}, q[3], n[3];
    for (int k = 0; k < 4; k++) { /* what is not in the image has a large number, or lies at its other side */
        if (at + step[k] >= sheet_pixels(t) || !sheet_place(t, at + step[k], q)) continue;
        vector_add(q, -1, p, q);
        if (frame_length(q) <= CLOUD_EDGE * (double)t->depth[at])
            vector_add(across[k / 2], k % 2 ? 1 : -1, q, across[k / 2]);
    }
    frame_cross(across[1], across[0], n); /* right, down and ahead are right-handed: towards the camera */
    if (!(frame_length(n) > 0)) vector_add(v->eye, -1, p, n);
    for (int k = 0; k < 3; k++) normal[k] = n[k] / frame_length(n);
}

static int cloud_place(const void *user, size_t at, double p[3])
{
    const struct cloud_view *c = user;
    const struct surface_view *v = &c->s->view[c->view];
    return v->sheet.depth[at] > 0 && !v->guess[at] && sheet_place(&v->sheet, at, p);
}

static void cloud_take(void *user, size_t at, const double p[3], const struct surface_vote *v)
{
    const struct cloud_view *c = user;
    const struct surface_view *view = &c->s->view[c->view];
    struct cloud_point *out = &c->point[at];
    if (v->nearest != c->view || !surface_holds(v, c->enough)) return;
    memcpy(out->place, p, sizeof out->place);
    memcpy(out->rgb, view->rgb + 3 * at, 3);
    out->views = fmin(v->confirms, 255);
    cloud_normal(view, at, p, out->normal);
}

oxl_result cloud_make(const struct surface *s, int enough, struct cloud *out)
{
    size_t room = 0;
    for (int v = 0; v < s->views; v++) {
        const size_t pixels = sheet_pixels(&s->view[v].sheet), all = out->count + pixels;
        struct cloud_point *point = product_room(pixels, sizeof *point), *more = out->point;
        struct cloud_view c = {s, v, enough, point};
        surface_ask_all(s, pixels, cloud_place, cloud_take, &c);
        if (all > room) {
            out->point = product_room(room = 2 * all, sizeof *more);
            if (more) memcpy(out->point, more, out->count * sizeof *more);
            free(more);
        }
        for (size_t i = 0; i < pixels; i++)
            if (point[i].views) out->point[out->count++] = point[i];
        free(point);
    }
    return out->count > 0 ? OXL_OK
                          : oxl_fail(s->ctx, OXL_ERR_INPUT,
                                     "cloud: no place of the model is confirmed by %d training views\nfix: "
                                     "set --min-views 1, or train a model for longer",
                                     enough);
}

void cloud_free(struct cloud *c)
{
    free(c->point);
    free(c->index);
}

/* How far a place is from the surface through its nearest point of the cloud. */
static double cloud_off(const void *user, const double p[3])
{
    double off;
    return near_find(user, p, &off) ? fabs(off) : NAN;
}

/* ---------------- files */

static void cloud_put_ply(const struct cloud *c, struct output *t)
{
    output_add(
        t,
        "ply\nformat binary_little_endian 1.0\ncomment oceanxl cloud, in the survey's world\nelement vertex %zu\n"
        "property double x\nproperty double y\nproperty double z\n"
        "property float nx\nproperty float ny\nproperty float nz\n"
        "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar views\n",
        c->count);
    if (c->index) output_add(t, "element face %zu\nproperty list uchar int vertex_indices\n", c->triangles);
    output_add(t, "end_header\n");
    for (size_t i = 0; i < c->count; i++) {
        const struct cloud_point *q = &c->point[i];
        for (int k = 0; k < 3; k++) output_real(t, q->place[k], 8);
        for (int k = 0; k < 3; k++) output_real(t, q->normal[k], 4);
        output_bytes(t, q->rgb, 3);
        output_bytes(t, &q->views, 1);
    }
    for (size_t i = 0; i < 3 * c->triangles; i++) {
        if (i % 3 == 0) output_integer(t, 3, 1);
        output_integer(t, c->index[i], 4);
    }
}

static void cloud_put_obj(const struct cloud *c, struct output *t)
{
    output_add(t, "# oceanxl mesh, in the survey's world");
    for (size_t i = 0; i < c->count; i++) {
        output_add(t, "\nv");
        for (int k = 0; k < 3; k++) output_add(t, " %.6f", c->point[i].place[k]);
        for (int k = 0; k < 3; k++) output_add(t, " %.3f", c->point[i].rgb[k] / 255.0);
    }
    for (size_t i = 0; i < 3 * c->triangles; i++)
        output_add(t, i % 3 ? " %zu" : "\nf %zu", (size_t)c->index[i] + 1);
    output_add(t, "\n");
}

static void las_text(struct output *t, const char *text, size_t size)
{
    char room[36] = {0};
    memcpy(room, text, strlen(text));
    output_bytes(t, room, size);
}

static void las_record(struct output *t, const char *user, int id, size_t size)
{
    output_integer(t, 0, 2);
    las_text(t, user, 16);
    output_integer(t, (uint64_t)id, 2);
    output_integer(t, size, 2);
    las_text(t, "", 32);
}

/* Adds the three variable length records: the keys of the CRS, as in a GeoTIFF. */
static void las_records(const struct geotiff *place, struct output *t)
{
    struct geotiff_crs crs;
    geotiff_crs(place, &crs);
    las_record(t, "LASF_Projection", 34735, 2 * crs.keys);
    for (size_t i = 0; i < crs.keys; i++) output_integer(t, (uint64_t)crs.key[i], 2);
    las_record(t, "LASF_Projection", 34736, 8 * crs.numbers);
    for (size_t i = 0; i < crs.numbers; i++) output_real(t, crs.number[i], 8);
    las_record(t, "LASF_Projection", 34737, strlen(crs.words) + 1);
    output_bytes(t, crs.words, strlen(crs.words) + 1);
}

static void las_header(const struct cloud *c, size_t records, const double low[3], const double high[3],
                       double scale, struct output *t)
{
    output_bytes(t, "LASF", 4);
    las_text(t, "", 20); /* no source, GeoTIFF keys, no project */
    output_bytes(t, "\1\4", 2);
    las_text(t, "OTHER", 32);
    las_text(t, "oceanxl " OXL_VERSION, 36); /* and no date: the same bytes on any day */
    output_integer(t, LAS_HEADER, 2);
    output_integer(t, LAS_HEADER + records, 4);
    output_integer(t, 3, 4);
    output_integer(t, 2, 1); /* format of the points */
    output_integer(t, LAS_RECORD, 2);
    for (int i = 0; i < 6; i++) output_integer(t, i < 2 && c->count <= UINT32_MAX ? c->count : 0, 4);
    for (int k = 0; k < 3; k++) output_real(t, scale, 8);
    for (int k = 0; k < 3; k++) output_real(t, floor(low[k]), 8);
    for (int k = 0; k < 3; k++) output_real(t, high[k], 8), output_real(t, low[k], 8);
    las_text(t, "", 20); /* no waveforms, no extended records */
    for (int i = 0; i < 16; i++) output_integer(t, i < 2 ? c->count : 0, 8);
}

static void cloud_put_las(const struct cloud *c, struct output *t)
{
    struct output records = {0};
    double low[3], high[3], scale = 1e-6;
    for (size_t i = 0; i < 3 * c->count; i++) {
        const double x = c->point[i / 3].place[i % 3];
        low[i % 3] = i < 3 ? x : fmin(low[i % 3], x), high[i % 3] = i < 3 ? x : fmax(high[i % 3], x);
    }
    for (int k = 0; k < 3; k++)
        while ((high[k] - floor(low[k])) / scale > INT32_MAX) scale *= 10;
    las_records(c->place, &records);
    las_header(c, records.used, low, high, scale, t);
    output_bytes(t, records.data, records.used);
    for (size_t i = 0; i < c->count; i++) {
        const struct cloud_point *q = &c->point[i];
        for (int k = 0; k < 3; k++)
            output_integer(t, (uint64_t)floor((q->place[k] - floor(low[k])) / scale + 0.5), 4);
        output_integer(t, 0, 2);
        output_integer(t, 1 | 1 << 3, 3); /* the one return of one, no class, no angle */
        output_integer(t, q->views, 1);
        output_integer(t, 0, 2);
        for (int k = 0; k < 3; k++) output_integer(t, 257u * q->rgb[k], 2);
    }
    t->failed |= records.failed;
    free(records.data);
}

/* Moves the points into the world of files. */
static void cloud_move(struct cloud *c, const struct similarity *world)
{
    for (size_t i = 0; i < c->count; i++) {
        struct cloud_point *q = &c->point[i];
        double turned[3];
        similarity_apply(world, q->place, q->place);
        frame_to_camera(world->rotation, q->normal, turned);
        memcpy(q->normal, turned, sizeof turned);
    }
}

oxl_result cloud_write(const struct product *p, const oxl_model *model)
{
    const struct arguments *a = p->a;
    const char *dot = strrchr(a->out, '.'), *end = dot ? dot : "", *name;
    void (*const put)(const struct cloud *c, struct output *t) = strcmp(end, ".ply") == 0 ? cloud_put_ply
                                                                 : strcmp(end, a->mesh ? ".obj" : ".las")
                                                                     ? NULL
                                                                 : a->mesh ? cloud_put_obj
                                                                           : cloud_put_las;
    struct surface s = {0};
    struct cloud c = {.place = &p->place};
    struct output t = {0};
    char folder[4096];
    double step;
    oxl_result rc;
    if (!put)
        return oxl_fail(p->ctx, OXL_ERR_USAGE, "cloud: -o is %s, expected a file %s\nfix: use -o %s.ply",
                        a->out, a->mesh ? "*.ply or *.obj" : "*.ply or *.las", a->mesh ? "mesh" : "cloud");
    name = output_split(a->out, folder);
    rc = output_check_own(p->ctx, folder, name, "oceanxl");
    if (rc == OXL_OK) rc = surface_open(p->ctx, model, p->scene, 1 << 20, &s);
    if (rc == OXL_OK) rc = cloud_make(&s, a->min_views, &c);
    step = a->mesh ? a->pixel > 0 ? a->pixel / p->world.scale : 2 * s.sampling : s.sampling;
    if (rc == OXL_OK && a->mesh) rc = mesh_make(&s, a->min_views, step, &c);
    if (rc == OXL_OK) {
        struct deviation d;
        struct near near;
        cloud_move(&c, &p->world);
        near_open(&near, &c, PRODUCT_GROSS * s.distance * p->world.scale);
        d = product_deviation(&s, &p->world, cloud_off, &near);
        free(near.first);
        output_open(&t, a->out);
        put(&c, &t);
        rc = output_close(p->ctx, &t);
        if (rc == OXL_OK)
            print_format(p->to,
                         a->mesh ? "mesh      %s, %zu points about %.3g %s apart, %zu triangles\n"
                                 : "cloud     %s, %zu points about %.3g %s apart\n",
                         a->out, c.count, step * p->world.scale, p->words, c.triangles);
        if (rc == OXL_OK) product_say(p, &d);
    }
    cloud_free(&c);
    surface_close(&s);
    return rc;
}

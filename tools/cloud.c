/* cloud.c - writes points on the surface of a model, as PLY or LAS.
 *
 * Each training view's pixel whose place two views or more confirm (surface.c) is a point, of the view that sees it
 * nearest alone, so that places are not written once a view. A point has the model's colour, the normal of its
 * view's depths, and the number of views that confirm it. Coordinates are the survey's world, in metres with
 * --scale.
 *
 * The PLY is binary, with double coordinates. The LAS is version 1.4 R15 (ASPRS 2019), point format 2, with the CRS
 * as GeoTIFF keys, which this format allows without a database of CRS; the views are its user data, and the normal
 * is in extra bytes.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    CLOUD_TILE = 32,        /* px; side of a tile of a view, whose places are asked of the same views */
    CLOUD_CHECKED = 100000, /* most points of the survey that the cloud is compared with */
    LAS_HEADER = 375,
    LAS_RECORD = 26 + 12,
    LAS_VLR = 54,
    LAS_EXTRA = 192
};
#define CLOUD_REACH 0.05 /* of the cameras' distance: farther from a point of the survey there is none */
#define CLOUD_EDGE 0.05  /* fraction of the depth by which neighbours on one surface differ at most */

/* ---------------- points of a view */

/* The difference of two places along x or y, of neighbours on the surface; 0 where there are none. */
static void cloud_along(const struct surface_view *v, int x, int y, int dx, int dy, double out[3])
{
    const float own = v->depth[(size_t)y * (size_t)v->camera.width + (size_t)x];
    double end[2][3];
    surface_place(v, x + 0.5, y + 0.5, (double)own, end[0]);
    memcpy(end[1], end[0], sizeof end[0]);
    for (int side = 0; side < 2; side++) {
        const int u = side ? x + dx : x - dx, w = side ? y + dy : y - dy;
        float z;
        if (u < 0 || w < 0 || u >= v->camera.width || w >= v->camera.height) continue;
        z = fabsf(v->depth[(size_t)w * (size_t)v->camera.width + (size_t)u]);
        if (fabsf(z - own) <= (float)CLOUD_EDGE * own)
            surface_place(v, u + 0.5, w + 0.5, (double)z, end[side]);
    }
    for (int k = 0; k < 3; k++) out[k] = end[1][k] - end[0][k];
}

/* Sets the unit normal on the camera's side; towards the camera where the depths around are no surface. */
static void cloud_normal(const struct surface_view *v, int x, int y, struct cloud_point *p)
{
    double right[3], down[3], n[3], length;
    cloud_along(v, x, y, 2, 0, right);
    cloud_along(v, x, y, 0, 2, down);
    frame_cross(down, right, n); /* right, down and ahead are right-handed: this is towards the camera */
    length = frame_length(n);
    if (!(length > 0)) {
        for (int k = 0; k < 3; k++) n[k] = v->eye[k] - p->place[k];
        length = frame_length(n);
    }
    for (int k = 0; k < 3; k++) p->normal[k] = (float)(n[k] / length);
}

/* Sets the points of a tile; views 0: the pixel has none. */
static void cloud_tile(const struct surface *s, int view, int enough, int tile, int *list,
                       struct cloud_point *point)
{
    const struct surface_view *v = &s->view[view];
    const int width = v->camera.width, across = (width + CLOUD_TILE - 1) / CLOUD_TILE,
              left = tile % across * CLOUD_TILE, top = tile / across * CLOUD_TILE;
    double low[3] = {HUGE_VAL, HUGE_VAL, HUGE_VAL}, high[3] = {-HUGE_VAL, -HUGE_VAL, -HUGE_VAL}, centre[3],
           half[3];
    int count = -1;
    for (int i = 0; i < 2 * CLOUD_TILE * CLOUD_TILE; i++) {
        const int x = left + i % CLOUD_TILE, y = top + i / CLOUD_TILE % CLOUD_TILE;
        const size_t at = (size_t)y * (size_t)width + (size_t)x;
        double p[3];
        struct surface_vote vote;
        if (x >= width || y >= v->camera.height || !(v->depth[at] > 0) || v->guess[at]) continue;
        surface_place(v, x + 0.5, y + 0.5, (double)v->depth[at], p);
        if (i < CLOUD_TILE * CLOUD_TILE) { /* first the box of the places, then the places */
            for (int k = 0; k < 3; k++) low[k] = fmin(low[k], p[k]), high[k] = fmax(high[k], p[k]);
            continue;
        }
        for (int k = 0; k < 3; k++) centre[k] = 0.5 * (low[k] + high[k]), half[k] = 0.5 * (high[k] - low[k]);
        if (count < 0) count = surface_list(s, centre, frame_length(half), list);
        vote = surface_ask(s, list, count, p);
        if (vote.nearest != view || !surface_holds(&vote, enough)) continue;
        memcpy(point[at].place, p, sizeof p);
        memcpy(point[at].rgb, v->rgb + 3 * at, 3);
        point[at].views = (unsigned char)(vote.confirms < 255 ? vote.confirms : 255);
        cloud_normal(v, x, y, &point[at]);
    }
}

static int cloud_view(const struct surface *s, int view, int enough, struct cloud_point *point)
{
    const oxl_camera *c = &s->view[view].camera;
    const int tiles =
        ((c->width + CLOUD_TILE - 1) / CLOUD_TILE) * ((c->height + CLOUD_TILE - 1) / CLOUD_TILE);
    int failed = 0;
#pragma omp parallel reduction(+ : failed)
    {
        int *list = malloc(((size_t)s->views + 1) * sizeof *list);
        failed += list == NULL;
#pragma omp for schedule(dynamic)
        for (int i = 0; i < tiles; i++)
            if (list) cloud_tile(s, view, enough, i, list, point);
        free(list);
    }
    return failed == 0;
}

oxl_result cloud_make(const struct surface *s, int enough, struct cloud *out)
{
    *out = (struct cloud){0};
    for (int v = 0; v < s->views; v++) {
        const size_t pixels = (size_t)s->view[v].camera.width * (size_t)s->view[v].camera.height;
        struct cloud_point *point = calloc(pixels, sizeof *point), *larger;
        size_t n = 0;
        int done = point && cloud_view(s, v, enough, point);
        for (size_t i = 0; i < pixels && done; i++)
            if (point[i].views) point[n++] = point[i];
        larger = done ? realloc(out->point, (out->count + n + 1) * sizeof *larger) : NULL;
        if (larger)
            memcpy(larger + out->count, point, n * sizeof *point), out->point = larger, out->count += n;
        free(point);
        if (!larger)
            return oxl_fail(s->ctx, OXL_ERR_MEMORY,
                            "cloud: no memory\nfix: use a smaller "
                            "--max-side");
    }
    return out->count > 0 ? OXL_OK
                          : oxl_fail(s->ctx, OXL_ERR_INPUT,
                                     "cloud: no place of the model is confirmed by %d training "
                                     "views\nfix: use --min-views 1, or train the model for longer",
                                     enough);
}

void cloud_free(struct cloud *c)
{
    free(c->point);
    *c = (struct cloud){0};
}

/* ---------------- deviation from the survey's points */

oxl_result cloud_deviation(const struct surface *s, const struct cloud *c, struct deviation *d)
{
    const size_t count = oxl_scene_point_count(s->scene), stride = 2 * (1 + count / 2 / CLOUD_CHECKED);
    double *error = malloc((count / stride + 1) * sizeof *error);
    struct near near;
    size_t n = 0, all = 0;
    const int is_open = near_open(&near, c->point, c->count, CLOUD_REACH * s->distance);
    *d = (struct deviation){NAN, NAN, NAN};
    for (size_t i = 1; i < count && error && is_open; i += stride, all++) {
        const double *p = oxl_scene_points(s->scene)[i].position;
        double distance, along = 0;
        const struct cloud_point *q = near_find(&near, p, &distance);
        if (!q) continue;
        for (int k = 0; k < 3; k++) along += (p[k] - q->place[k]) * (double)q->normal[k];
        error[n++] = fabs(along);
    }
    if (error) qsort(error, n, sizeof *error, frame_compare);
    if (n > 0) *d = (struct deviation){error[n / 2], error[n * 9 / 10], (double)(all - n) / (double)all};
    free(error);
    near_close(&near);
    return error && is_open ? OXL_OK : oxl_fail(s->ctx, OXL_ERR_MEMORY, "cloud: no memory");
}

/* ---------------- files */

/* World coordinates of a place. */
static double cloud_world(const struct cloud_file *f, const double p[3], int k)
{
    return (p[k] + f->origin[k]) * f->unit;
}

static void cloud_put_ply(const struct cloud_file *f, const struct cloud *c, struct output *t)
{
    output_add(
        t,
        "ply\nformat binary_little_endian 1.0\ncomment oceanxl cloud, in the survey's world\nelement vertex %zu\n",
        c->count);
    for (int k = 0; k < 3; k++) output_add(t, "property double %s\n", &"x\0y\0z"[2 * k]);
    for (int k = 0; k < 3; k++) output_add(t, "property float %s\n", &"nx\0ny\0nz"[3 * k]);
    output_add(
        t,
        "property uchar red\nproperty uchar green\nproperty uchar blue\nproperty uchar views\nend_header\n");
    for (size_t i = 0; i < c->count; i++) {
        const struct cloud_point *p = &c->point[i];
        for (int k = 0; k < 3; k++) output_real(t, cloud_world(f, p->place, k), 8);
        for (int k = 0; k < 3; k++) output_real(t, (double)p->normal[k], 4);
        output_bytes(t, p->rgb, 3);
        output_bytes(t, &p->views, 1);
    }
}

static void las_text(struct output *t, const char *text, size_t size)
{
    char room[32] = {0};
    memcpy(room, text, strlen(text) < size ? strlen(text) : size);
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

/* Adds the variable length records: the keys of the CRS as in a GeoTIFF, and what the extra bytes are. */
static int las_records(const struct cloud_file *f, struct output *t)
{
    struct geotiff_crs crs;
    geotiff_crs(&f->place, &crs);
    las_record(t, "LASF_Projection", 34735, 2 * crs.keys);
    for (size_t i = 0; i < crs.keys; i++) output_integer(t, (uint64_t)crs.key[i], 2);
    las_record(t, "LASF_Projection", 34736, 8 * crs.numbers);
    for (size_t i = 0; i < crs.numbers; i++) output_real(t, crs.number[i], 8);
    las_record(t, "LASF_Projection", 34737, strlen(crs.words) + 1);
    output_bytes(t, crs.words, strlen(crs.words) + 1);
    las_record(t, "LASF_Spec", 4, 3 * LAS_EXTRA);
    for (int k = 0; k < 3; k++) {
        output_integer(t, 9 << 16, 4); /* reserved, type 9: float, no options */
        las_text(t, &"NormalX\0NormalY\0NormalZ"[8 * k], 32);
        for (int i = 0; i < LAS_EXTRA - 36; i += 4) output_integer(t, 0, 4);
    }
    return 4;
}

/* Bounds of the cloud in the world: low, high. */
static void las_bounds(const struct cloud_file *f, const struct cloud *c, double bound[2][3])
{
    for (int k = 0; k < 3; k++) {
        bound[0][k] = HUGE_VAL, bound[1][k] = -HUGE_VAL;
        for (size_t i = 0; i < c->count; i++) {
            const double x = cloud_world(f, c->point[i].place, k);
            bound[0][k] = fmin(bound[0][k], x), bound[1][k] = fmax(bound[1][k], x);
        }
    }
}

static void las_header(const struct cloud *c, size_t records_size, int records, const double bound[2][3],
                       double scale, struct output *t)
{
    output_bytes(t, "LASF", 4);
    for (int i = 0; i < 5; i++) output_integer(t, 0, 4); /* no source, GeoTIFF keys, no project */
    output_bytes(t, "\1\4", 2);
    las_text(t, "OTHER", 32);
    las_text(t, "oceanxl " OXL_VERSION, 32);
    output_integer(t, 0, 4); /* no date: the same bytes on any day */
    output_integer(t, LAS_HEADER, 2);
    output_integer(t, LAS_HEADER + records_size, 4);
    output_integer(t, (uint64_t)records, 4);
    output_integer(t, 2, 1);
    output_integer(t, LAS_RECORD, 2);
    for (int i = 0; i < 6; i++) output_integer(t, i < 2 && c->count <= UINT32_MAX ? c->count : 0, 4);
    for (int k = 0; k < 3; k++) output_real(t, scale, 8);
    for (int k = 0; k < 3; k++) output_real(t, floor(bound[0][k]), 8);
    for (int k = 0; k < 6; k++) output_real(t, bound[1 - k % 2][k / 2], 8);
    output_integer(t, 0, 8); /* no waveforms, no extended records */
    output_integer(t, 0, 8);
    output_integer(t, 0, 4);
    for (int i = 0; i < 16; i++) output_integer(t, i < 2 ? c->count : 0, 8);
}

static void cloud_put_las(const struct cloud_file *f, const struct cloud *c, struct output *t)
{
    struct output records = {0};
    const int count = las_records(f, &records);
    double bound[2][3], scale = pow(10, floor(log10(f->step)) - 1), widest = 0;
    las_bounds(f, c, bound);
    for (int k = 0; k < 3; k++) widest = fmax(widest, bound[1][k] - floor(bound[0][k]));
    while (widest / scale > INT32_MAX) scale *= 10;
    las_header(c, records.used, count, (const double(*)[3])bound, scale, t);
    output_bytes(t, records.data, records.used);
    for (size_t i = 0; i < c->count; i++) {
        const struct cloud_point *p = &c->point[i];
        for (int k = 0; k < 3; k++)
            output_integer(
                t, (uint64_t)floor((cloud_world(f, p->place, k) - floor(bound[0][k])) / scale + 0.5), 4);
        output_integer(t, 0, 2);
        output_integer(t, 1 | 1 << 3, 3); /* the one return of one, no class, no angle */
        output_integer(t, p->views, 1);
        output_integer(t, 0, 2);
        for (int k = 0; k < 3; k++) output_integer(t, 257u * p->rgb[k], 2);
        for (int k = 0; k < 3; k++) output_real(t, (double)p->normal[k], 4);
    }
    t->failed |= records.failed;
    free(records.data);
}

static int cloud_ends(const char *path, const char *with)
{
    const size_t size = strlen(path), tail = strlen(with);
    return size > tail && strcmp(path + size - tail, with) == 0;
}

static oxl_result cloud_check(oxl_context *ctx, const oxl_scene *scene, const struct arguments *a)
{
    const int known = cloud_ends(a->out, ".ply") || cloud_ends(a->out, a->mesh ? ".obj" : ".las");
    if (!known)
        return oxl_fail(ctx, OXL_ERR_USAGE, "cloud: -o is %s, expected a file %s\nfix: -o %s.ply", a->out,
                        a->mesh ? "*.ply or *.obj" : "*.ply or *.las", a->mesh ? "mesh" : "cloud");
    if (a->epsg && oxl_scene_reference(scene))
        return oxl_fail(ctx, OXL_ERR_USAGE,
                        "cloud: the survey's coordinates are metres around a reference, not of EPSG:%d\n"
                        "fix: leave --epsg out",
                        a->epsg);
    return OXL_OK;
}

static oxl_result cloud_save(const struct surface *s, const struct cloud_file *f, const struct cloud *c,
                             const struct arguments *a, struct deviation *d, FILE *to)
{
    struct output t = {0};
    output_open(&t, a->out);
    (cloud_ends(a->out, ".las") ? cloud_put_las : cloud_put_ply)(f, c, &t);
    if (!output_close(&t))
        return oxl_fail(f->ctx, OXL_ERR_IO, "%s cannot be written\nfix: free space on the disk", a->out);
    print_format(to, "cloud     %s, %zu points about %.3g %s apart\n", a->out, c->count, f->step, f->words);
    return cloud_deviation(s, c, d);
}

static void cloud_say(const struct surface *s, const struct deviation *d, const struct cloud_file *f,
                      FILE *to)
{
    if (isnan(d->median)) return;
    print_format(
        to,
        "deviation every second point of the survey is %.3g %s from the surface in the median, 90 %% less than "
        "%.3g: %.2f and %.2f %% of the cameras' distance; %.1f %% have none within %.0f %%\n",
        d->median * f->unit, f->words, d->most * f->unit, 100 * d->median / s->distance,
        100 * d->most / s->distance, 100 * d->none, 100 * CLOUD_REACH);
}

oxl_result cloud_write(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                       const struct arguments *a, FILE *to)
{
    struct cloud_file f = {.ctx = ctx,
                           .origin = oxl_scene_origin(scene),
                           .unit = a->scale > 0 ? a->scale : 1,
                           .words = a->scale > 0 ? "metres" : "units"};
    struct surface s = {0};
    struct cloud c = {0};
    struct deviation d;
    oxl_result rc = cloud_check(ctx, scene, a);
    if (rc == OXL_OK)
        rc = output_check_own(ctx, ".", a->out,
                              a->mesh                      ? "oceanxl mesh"
                              : cloud_ends(a->out, ".las") ? "oceanxl "
                                                           : "oceanxl cloud");
    if (rc == OXL_OK) rc = surface_open(ctx, model, scene, 1 << 20, &s);
    f.step = s.sampling * f.unit;
    f.place = (struct geotiff){.epsg = a->epsg,
                               .reference = oxl_scene_reference(scene),
                               .is_metric = a->scale > 0,
                               .citation = "oceanxl: coordinates of the survey's world"};
    if (rc == OXL_OK) rc = cloud_make(&s, a->min_views, &c);
    if (rc == OXL_OK) rc = a->mesh ? mesh_save(&s, &c, &f, a, &d, to) : cloud_save(&s, &f, &c, a, &d, to);
    if (rc == OXL_OK) cloud_say(&s, &d, &f, to);
    cloud_free(&c);
    surface_close(&s);
    return rc;
}

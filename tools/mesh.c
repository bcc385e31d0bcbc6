/* mesh.c - a triangle mesh of the surface that the training views agree on, of any orientation: walls, overhangs.
 *
 * Signed distances along the views' depths are averaged at the points of a lattice, cut off at MESH_TRUNCATE cells
 * (Curless and Levoy 1996), in blocks around the points of the cloud alone. Each cell of the lattice that the surface of
 * distance 0 crosses has one vertex, at the mean of the crossings of its edges, and each edge that it crosses has two
 * triangles between the vertices of the four cells around it (surface nets, Gibson 1998): marching cubes without its
 * table, and without its slivers. Parts of fewer than MESH_SMALL triangles are left out.
 *
 * Invariant: a sample's index says its block and its place there; the index behind the last is that of no sample.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    MESH_SIDE = 8, /* lattice points along a block */
    MESH_BLOCK = MESH_SIDE * MESH_SIDE * MESH_SIDE,
    MESH_BITS = 20, /* of a block's coordinate */
    MESH_SMALL = 200
};
#define MESH_TRUNCATE 4.0 /* cells */

struct mesh {
    const struct surface *s;
    int enough;
    double cell, low[3]; /* units; side of a cell, the lattice's origin */
    uint64_t *block;     /* (blocks) coordinates, sorted */
    size_t blocks, samples;
    float *distance;         /* (samples) cells; negative: behind the surface; NaN: too few views */
    unsigned char (*rgb)[3]; /* (samples) */
    uint32_t *vertex;        /* (samples) of the cell above the lattice point, from 1; 0: none */
};

static int mesh_compare_key(const void *a, const void *b)
{
    const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

static uint64_t mesh_key(const int at[3])
{
    uint64_t key = 0;
    for (int k = 0; k < 3; k++) key = key << MESH_BITS | (uint64_t)(at[k] / MESH_SIDE);
    return key;
}

static void mesh_find_blocks(struct mesh *m, const struct cloud *c)
{
    const double reach = MESH_TRUNCATE * m->cell;
    m->block = product_room(8 * c->count, sizeof *m->block);
    for (int k = 0; k < 3; k++) {
        m->low[k] = HUGE_VAL;
        for (size_t i = 0; i < c->count; i++) m->low[k] = fmin(m->low[k], c->point[i].place[k]);
        m->low[k] -= 4 * reach;
    }
    for (size_t i = 0; i < 8 * c->count; i++) {
        int at[3];
        for (int k = 0; k < 3; k++)
            at[k] =
                (int)fmin((c->point[i / 8].place[k] + (i >> k & 1 ? reach : -reach) - m->low[k]) / m->cell,
                          (1 << MESH_BITS) - 1);
        m->block[i] = mesh_key(at);
    }
    qsort(m->block, 8 * c->count, sizeof *m->block, mesh_compare_key);
    for (size_t i = 0; i < 8 * c->count; i++)
        if (i == 0 || m->block[i] != m->block[i - 1]) m->block[m->blocks++] = m->block[i];
    m->samples = m->blocks * MESH_BLOCK;
}

/* ---------------- samples */

static void mesh_lattice(const struct mesh *m, size_t sample, int at[3])
{
    for (int k = 2; k >= 0; k--) {
        const uint64_t block = m->block[sample / MESH_BLOCK] >> (2 - k) * MESH_BITS & ((1 << MESH_BITS) - 1);
        at[k] = MESH_SIDE * (int)block + (int)(sample >> 3 * (2 - k)) % MESH_SIDE;
    }
}

/* The sample at the lattice point that corner 0 to 7 of the cell above `at` has; its bits are x, y, z. */
static size_t mesh_find(const struct mesh *m, const int at[3], int corner)
{
    const int to[3] = {at[0] + (corner & 1), at[1] + (corner >> 1 & 1), at[2] + (corner >> 2)};
    const uint64_t key = mesh_key(to),
                   *block = bsearch(&key, m->block, m->blocks, sizeof key, mesh_compare_key);
    if (!block) return m->samples;
    return (size_t)(block - m->block) * MESH_BLOCK +
           (size_t)((to[0] % MESH_SIDE * MESH_SIDE + to[1] % MESH_SIDE) * MESH_SIDE + to[2] % MESH_SIDE);
}

static void mesh_place(const struct mesh *m, size_t sample, double out[3])
{
    int at[3];
    mesh_lattice(m, sample, at);
    for (int k = 0; k < 3; k++) out[k] = m->low[k] + at[k] * m->cell;
}

static void mesh_sample(const struct mesh *m, const struct surface_list *list, size_t sample,
                        const double p[3])
{
    const double reach = MESH_TRUNCATE * m->cell;
    double sum = 0, rgb[3] = {0, 0, 0};
    int views = 0, near = 0;
    for (int i = 0; i < list->count; i++) {
        const struct surface_view *v = &m->s->view[list->view[i]];
        double at[2], off;
        size_t pixel;
        const double z = surface_pixel(v, p, at, &pixel);
        if (!(z > 0 && v->sheet.depth[pixel] > 0) || v->guess[pixel]) continue;
        off = (double)v->sheet.depth[pixel] - z;
        if (off < -reach) continue;
        views++, sum += fmin(off, reach), near += off <= reach;
        for (int c = 0; c < 3 && off <= reach; c++) rgb[c] += v->rgb[3 * pixel + (size_t)c];
    }
    m->distance[sample] = views >= m->enough ? (float)(sum / views / m->cell) : NAN;
    for (int c = 0; c < 3; c++) m->rgb[sample][c] = (unsigned char)(near ? rgb[c] / near : 128);
}

static void mesh_sample_blocks(struct mesh *m)
{
    m->distance = product_room(m->samples, sizeof *m->distance);
    m->rgb = product_room(m->samples, sizeof *m->rgb);
    m->distance[m->samples] = NAN;
#pragma omp parallel for schedule(dynamic)
    for (size_t b = 0; b < m->blocks; b++) {
        double place[MESH_BLOCK][3];
        struct surface_list list;
        for (size_t i = 0; i < MESH_BLOCK; i++) mesh_place(m, b * MESH_BLOCK + i, place[i]);
        surface_find(m->s, place, MESH_BLOCK, &list);
        for (size_t i = 0; i < MESH_BLOCK; i++) mesh_sample(m, &list, b * MESH_BLOCK + i, place[i]);
    }
}

/* ---------------- vertices and triangles */

/* Returns 0 where the surface does not cross the cell. Its vertex is the mean of the crossings; the normal is the
 * gradient. */
static int mesh_vertex(const struct mesh *m, size_t sample, struct cloud_point *out)
{
    double normal[3] = {0, 0, 0}, rgb[3] = {0, 0, 0}, place[3] = {0, 0, 0}, length;
    size_t corner[8];
    int at[3], cuts = 0;
    mesh_lattice(m, sample, at);
    for (int i = 0; i < 8; i++)
        if (isnan(m->distance[corner[i] = mesh_find(m, at, i)])) return 0;
    for (int i = 0; i < 24;
         i++) { /* the edge from corner i % 8 along axis i / 8, and that channel of its colour */
        const int axis = i / 8;
        const float a = m->distance[corner[i % 8]], b = m->distance[corner[i % 8 | 1 << axis]];
        rgb[axis] += m->rgb[corner[i % 8]][axis];
        normal[axis] += (double)(b - a);
        if ((a < 0) == (b < 0)) continue;
        cuts++, place[axis] += (double)(a / (a - b));
        for (int k = 0; k < 3; k++) place[k] += i >> k & 1;
    }
    if (cuts == 0) return 0;
    length = fmax(frame_length(normal), 1e-30);
    for (int k = 0; k < 3; k++) {
        out->place[k] = m->low[k] + (at[k] + place[k] / cuts) * m->cell;
        out->normal[k] = (float)(normal[k] / length);
        out->rgb[k] = (unsigned char)(rgb[k] / 8);
    }
    return 1;
}

static void mesh_vertices(struct mesh *m, struct cloud *c)
{
    struct cloud_point one = {.views = 0};
    size_t n = 0;
    m->vertex = product_room(m->samples, sizeof *m->vertex);
    for (size_t i = 0; i < m->samples; i++)
        n += m->vertex[i] = !isnan(m->distance[i]) && mesh_vertex(m, i, &one);
    c->point = product_room(n, sizeof *c->point);
    for (size_t i = 0; i < m->samples; i++)
        if (m->vertex[i]) mesh_vertex(m, i, &c->point[c->count++]), m->vertex[i] = (uint32_t)c->count;
}

/* Adds the triangles of the edge from a lattice point along an axis where the surface crosses it. */
static void mesh_add(const struct mesh *m, size_t sample, int axis, struct cloud *c)
{
    /* cells around the edge, counter-clockwise against the axis, two triangles; backwards for a surface that faces it */
    static const int ring[6][2] = {{1, 1}, {0, 1}, {0, 0}, {1, 1}, {0, 0}, {1, 0}};
    uint32_t *to = c->index + 3 * c->triangles;
    int at[3];
    float a = m->distance[sample], b;
    mesh_lattice(m, sample, at);
    b = m->distance[mesh_find(m, at, 1 << axis)];
    if (isnan(b) || (a < 0) == (b < 0)) return;
    for (int i = 0; i < 6; i++) {
        int around[3] = {at[0], at[1], at[2]};
        const int k = a < 0 ? i : 5 - i;
        uint32_t vertex;
        around[(axis + 1) % 3] -= ring[k][0], around[(axis + 2) % 3] -= ring[k][1];
        vertex = m->vertex[mesh_find(m, around, 0)];
        if (!vertex) return;
        to[i] = vertex - 1;
    }
    c->triangles += 2;
}

static uint32_t mesh_root(uint32_t *parent, uint32_t i)
{
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
}

/* Leaves out small parts, and the vertices that no triangle has. */
static void mesh_clean(struct cloud *c)
{
    uint32_t *parent = product_room(2 * c->count, sizeof *parent), *number = parent + c->count;
    const size_t all = 3 * c->triangles, points = c->count;
    for (uint32_t i = 0; i < points; i++) parent[i] = i;
    for (size_t i = 0; i < all; i++) {
        const uint32_t a = mesh_root(parent, c->index[i]), b = mesh_root(parent, c->index[i - i % 3]);
        parent[a > b ? a : b] = a > b ? b : a;
    }
    for (size_t i = 0; i < all; i += 3) number[mesh_root(parent, c->index[i])]++;
    c->triangles = c->count = 0;
    for (size_t i = 0; i < all; i += 3)
        if (number[mesh_root(parent, c->index[i])] >= MESH_SMALL)
            memmove(c->index + 3 * c->triangles++, c->index + i, 3 * sizeof *c->index);
    memset(number, 0, points * sizeof *number);
    for (size_t i = 0; i < 3 * c->triangles; i++) number[c->index[i]] = 1;
    for (size_t i = 0; i < points; i++)
        if (number[i]) c->point[c->count] = c->point[i], number[i] = (uint32_t)c->count++;
    for (size_t i = 0; i < 3 * c->triangles; i++) c->index[i] = number[c->index[i]];
    free(parent);
}

oxl_result mesh_make(const struct surface *s, int enough, double cell, struct cloud *c)
{
    struct mesh m = {.s = s, .enough = enough, .cell = cell};
    mesh_find_blocks(&m, c);
    cloud_free(c);
    mesh_sample_blocks(&m);
    mesh_vertices(&m, c);
    c->index = product_room(18 * c->count, sizeof *c->index); /* three edges a cell, as each has four cells */
    for (size_t i = 0; i < 3 * m.samples; i++)
        if (!isnan(m.distance[i / 3])) mesh_add(&m, i / 3, (int)(i % 3), c);
    mesh_clean(c);
    free(m.block), free(m.distance), free(m.rgb), free(m.vertex);
    return c->triangles > 0
               ? OXL_OK
               : oxl_fail(s->ctx, OXL_ERR_INPUT,
                          "mesh: no surface is found at cells of %g units\nfix: use another --pixel", cell);
}

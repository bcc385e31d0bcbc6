/* mesh.c - a triangle mesh of the surface that the training views agree on, of any orientation: walls, overhangs.
 *
 * Signed distances along the views' depths are averaged at the points of a lattice, cut off at MESH_TRUNCATE cells
 * (Curless and Levoy 1996), around the points of the cloud alone. Each cell of the lattice that the surface of
 * distance 0 crosses has one vertex, at the mean of the crossings of its edges, and each edge that it crosses has two
 * triangles between the vertices of the four cells around it (surface nets, Gibson 1998): marching cubes without its
 * table, and without its slivers.
 *
 * Invariant: a sample is found by the key of its lattice point; the index behind the last is that of no sample.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MESH_BITS = 20 };  /* of a coordinate in a key */
#define MESH_TRUNCATE 4.0 /* cells */

struct mesh {
    int enough;
    double cell, low[3]; /* units; side of a cell, the lattice's origin */
    size_t samples;
    uint64_t *key;    /* (samples) coordinates of a lattice point, x in the lowest bits; sorted */
    float *distance;  /* (samples + 1) cells; negative: behind the surface; NaN: too few views */
    uint32_t *vertex; /* (samples + 1) of the cell above the lattice point, from 1; 0: none */
};

static int mesh_compare_key(const void *a, const void *b)
{
    const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

/* Sorts the keys, and keeps one of each. */
static void mesh_sort(struct mesh *m, uint64_t *key, size_t count)
{
    qsort(key, count, sizeof *key, mesh_compare_key);
    m->samples = 0, m->key = key;
    for (size_t i = 0; i < count; i++)
        if (i == 0 || key[i] != key[i - 1]) key[m->samples++] = key[i];
}

/* What the corner 0 to 7 of a cell, whose bits are x, y, z, adds to the cell's key. */
static uint64_t mesh_corner(int corner)
{
    uint64_t key = 0;
    for (int k = 0; k < 3; k++) key |= (uint64_t)(corner >> k & 1) << k * MESH_BITS;
    return key;
}

/* Finds the lattice points up to 4 cells from the cloud's along each axis: by one cell, then by three. */
static void mesh_find_samples(struct mesh *m, const struct cloud *c)
{
    uint64_t *key = product_room(c->count, sizeof *key);
    for (int k = 0; k < 3; k++) {
        m->low[k] = HUGE_VAL;
        for (size_t i = 0; i < c->count; i++) m->low[k] = fmin(m->low[k], c->point[i].place[k]);
        m->low[k] -= 2 * MESH_TRUNCATE * m->cell;
        for (size_t i = 0; i < c->count; i++)
            key[i] |= (uint64_t)fmin((c->point[i].place[k] - m->low[k]) / m->cell, (1 << MESH_BITS) - 1)
                      << k * MESH_BITS;
    }
    mesh_sort(m, key, c->count);
    for (int pass = 0; pass < 6; pass++) {
        const uint64_t step = mesh_corner(1 << pass / 2) * (pass % 2 ? 3 : 1);
        key = product_room(3 * m->samples, sizeof *key);
        for (size_t i = 0; i < 3 * m->samples; i++) key[i] = m->key[i / 3] + i % 3 * step - step;
        free(m->key);
        mesh_sort(m, key, 3 * m->samples);
    }
}

/* ---------------- samples */

static size_t mesh_find(const struct mesh *m, uint64_t key)
{
    const uint64_t *at = bsearch(&key, m->key, m->samples, sizeof key, mesh_compare_key);
    return at ? (size_t)(at - m->key) : m->samples;
}

static int mesh_place(const void *user, size_t sample, double out[3])
{
    const struct mesh *m = user;
    for (int k = 0; k < 3; k++)
        out[k] = m->low[k] + (double)(m->key[sample] >> k * MESH_BITS & ((1 << MESH_BITS) - 1)) * m->cell;
    return 1;
}

static void mesh_take(void *user, size_t sample, const double p[3], const struct surface_vote *v)
{
    struct mesh *m = user;
    (void)p;
    m->distance[sample] = v->clear >= m->enough ? v->ahead / v->clear / m->cell : NAN;
}

/* ---------------- vertices and triangles */

/* Returns 0 where the surface does not cross the cell. Its vertex is the mean of the crossings; the normal is the
 * gradient. */
static int mesh_vertex(const struct mesh *m, size_t sample, struct cloud_point *out)
{
    double normal[3] = {0, 0, 0}, place[3] = {0, 0, 0}, low[3];
    size_t corner[8];
    int cuts = 0;
    for (int i = 0; i < 8; i++)
        if (isnan(m->distance[corner[i] = mesh_find(m, m->key[sample] + mesh_corner(i))])) return 0;
    for (int i = 0; i < 24; i++) { /* the edge from corner i % 8 along axis i / 8 */
        const int axis = i / 8;
        const float a = m->distance[corner[i % 8]], b = m->distance[corner[i % 8 | 1 << axis]];
        normal[axis] += (double)(b - a);
        if ((a < 0) == (b < 0)) continue;
        cuts++, place[axis] += (double)(a / (a - b));
        for (int k = 0; k < 3; k++) place[k] += i >> k & 1;
    }
    if (cuts == 0) return 0;

    mesh_place(m, sample, low);
    vector_add(low, m->cell / cuts, place, out->place);
    for (int k = 0; k < 3; k++) out->normal[k] = normal[k] / fmax(frame_length(normal), 1e-30);
    return 1;
}

/* The colour of a vertex is that of the cloud's nearest point. */
static void mesh_vertices(struct mesh *m, const struct near *near, struct cloud *c)
{
    m->vertex = product_room(m->samples, sizeof *m->vertex);
    c->point = product_room(m->samples, sizeof *c->point);
    for (size_t i = 0; i < m->samples; i++) {
        struct cloud_point *to = &c->point[c->count];
        const struct cloud_point *from;
        double off;
        if (!mesh_vertex(m, i, to)) continue;
        m->vertex[i] = (uint32_t)++c->count, from = near_find(near, to->place, &off);
        if (from) memcpy(to->rgb, from->rgb, sizeof to->rgb);
    }
}

/* Adds the triangles of the edge from a lattice point along an axis where the surface crosses it. */
static void mesh_add(const struct mesh *m, size_t sample, int axis, struct cloud *c)
{
    /* cells around the edge, counter-clockwise against the axis, two triangles; backwards for a surface that faces it */
    static const int ring[6][2] = {{1, 1}, {0, 1}, {0, 0}, {1, 1}, {0, 0}, {1, 0}};
    uint32_t *to = c->index + 3 * c->triangles;
    const uint64_t key = m->key[sample];
    const float a = m->distance[sample], b = m->distance[mesh_find(m, key + mesh_corner(1 << axis))];
    if (isnan(b) || (a < 0) == (b < 0)) return;
    for (int i = 0; i < 6; i++) {
        const int *back = ring[a < 0 ? i : 5 - i],
                  corner = back[0] << (axis + 1) % 3 | back[1] << (axis + 2) % 3;
        const uint32_t vertex = m->vertex[mesh_find(m, key - mesh_corner(corner))];
        if (!vertex) return;
        to[i] = vertex - 1;
    }
    c->triangles += 2;
}

oxl_result mesh_make(struct surface *s, int enough, double cell, struct cloud *c)
{
    struct mesh m = {.enough = enough, .cell = cell};
    struct cloud_point *cloud = c->point;
    struct near near;
    mesh_find_samples(&m, c);
    near_open(&near, c, 2 * cell);
    c->count = 0;
    m.distance = product_room(m.samples, sizeof *m.distance), m.distance[m.samples] = NAN;
    s->reach = MESH_TRUNCATE * cell;
    surface_ask_all(s, m.samples, mesh_place, mesh_take, &m);
    mesh_vertices(&m, &near, c);
    c->index = product_room(18 * c->count, sizeof *c->index); /* three edges a cell, as each has four cells */
    for (size_t i = 0; i < 3 * m.samples; i++)
        if (!isnan(m.distance[i / 3])) mesh_add(&m, i / 3, (int)(i % 3), c);
    free(m.key), free(m.distance), free(m.vertex), free(near.first), free(cloud);
    return c->triangles > 0
               ? OXL_OK
               : oxl_fail(s->ctx, OXL_ERR_INPUT,
                          "mesh: no surface is found at cells of %g units\nfix: use another --pixel", cell);
}

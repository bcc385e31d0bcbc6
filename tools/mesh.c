/* mesh.c - a triangle mesh of the surface that the training views agree on, of any orientation: walls, overhangs.
 *
 * Signed distances along the views' depths are averaged on a lattice, cut off at MESH_TRUNCATE cells (Curless and Levoy
 * 1996), in blocks around the points of the cloud alone. The surface of distance 0 is traced cell by cell, as marching
 * cubes does (Lorensen and Cline 1987), without a table of cases: on each face of a cell a line leads from the edge
 * where its border leaves the inside to the one where it had come in, and the lines of all faces are closed loops.
 * Neighbouring cells see the same corners, so their loops fit each other.
 *
 * Blocks share no samples: each takes the corners on its border anew, with the same result, and vertices are one where
 * they lie on one edge of the lattice. Parts of fewer than MESH_SMALL triangles are left out.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum {
    MESH_CELLS = 8,
    MESH_CORNERS = MESH_CELLS + 1, /* a side of a block */
    MESH_SAMPLES = MESH_CORNERS * MESH_CORNERS * MESH_CORNERS,
    MESH_BITS = 20, /* of a coordinate in the lattice */
    MESH_SMALL = 200
};
#define MESH_TRUNCATE 4.0 /* cells */

struct mesh_vertex {
    uint64_t key;   /* lattice edge: x, y, z of its lower corner, axis */
    float place[3]; /* in cells, from the lattice's origin */
    unsigned char rgb[3];
    uint32_t at; /* place in the list of corners of triangles */
};

struct mesh {
    const struct surface *s;
    int enough;
    double cell, low[3]; /* units; the lattice's origin */
    uint64_t *block;     /* (blocks) sorted */
    size_t blocks;
    struct mesh_vertex *corner; /* (corners) three a triangle, until they are joined */
    size_t corners, room;
    struct cloud vertex;
    uint32_t *index; /* (3 triangles) */
    size_t triangles;
};

struct mesh_samples {
    float distance[MESH_SAMPLES]; /* cells, cut off; negative: behind the surface */
    float rgb[MESH_SAMPLES][3];
    unsigned char known[MESH_SAMPLES];
};

/* ---------------- blocks */

static int mesh_compare_key(const void *a, const void *b)
{
    const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return (x > y) - (x < y);
}

static int mesh_find_blocks(struct mesh *m, const struct cloud *c)
{
    const double side = MESH_CELLS * m->cell, reach = MESH_TRUNCATE * m->cell;
    size_t n = 0;
    for (int k = 0; k < 3; k++) {
        m->low[k] = HUGE_VAL;
        for (size_t i = 0; i < c->count; i++) m->low[k] = fmin(m->low[k], c->point[i].place[k]);
        m->low[k] -= 2 * reach;
    }
    m->block = malloc((8 * c->count + 1) * sizeof *m->block);
    if (!m->block) return 0;
    for (size_t i = 0; i < 8 * c->count; i++) {
        uint64_t key = 0;
        for (int k = 0; k < 3; k++) {
            const double at = c->point[i / 8].place[k] + (i >> k & 1 ? reach : -reach) - m->low[k];
            key = key << MESH_BITS | (uint64_t)fmin(floor(at / side), (1 << (MESH_BITS - 4)) - 1);
        }
        m->block[n++] = key;
    }
    qsort(m->block, n, sizeof *m->block, mesh_compare_key);
    for (size_t i = 0; i < n; i++)
        if (i == 0 || m->block[i] != m->block[i - 1]) m->block[m->blocks++] = m->block[i];
    return 1;
}

/* ---------------- distances */

static void mesh_sample(const struct mesh *m, const int *list, int count, const double p[3],
                        struct mesh_samples *to, int at)
{
    const double reach = MESH_TRUNCATE * m->cell;
    double sum = 0, rgb[3] = {0, 0, 0};
    int views = 0, near = 0;
    for (int i = 0; i < count; i++) {
        const struct surface_view *v = &m->s->view[list[i]];
        double pixel[2], off;
        const double z = surface_project(&v->camera, p, pixel);
        size_t k;
        if (!(z > 0 && pixel[0] >= 0 && pixel[1] >= 0 && pixel[0] < v->camera.width &&
              pixel[1] < v->camera.height))
            continue;
        k = (size_t)pixel[1] * (size_t)v->camera.width + (size_t)pixel[0];
        off = (double)v->depth[k] - z;
        if (!(v->depth[k] > 0) || v->guess[k] || off < -reach) continue;
        views++, sum += fmin(off, reach);
        if (off > reach) continue;
        near++;
        for (int c = 0; c < 3; c++) rgb[c] += v->rgb[3 * k + (size_t)c];
    }
    to->known[at] = views >= m->enough;
    to->distance[at] = views ? (float)(sum / views / m->cell) : 0;
    for (int c = 0; c < 3; c++) to->rgb[at][c] = near ? (float)(rgb[c] / near) : 128;
}

/* ---------------- triangles of a cell */

/* Edges of a cell are numbered by their axis and lower corner: 8 axis + corner; corners have bits x, y, z. Sets the edge
 * that follows each edge of the loops; -1: the edge is not cut. */
static void mesh_trace(unsigned inside, int next[24])
{
    for (int e = 0; e < 24; e++) next[e] = -1;
    for (int face = 0; face < 6; face++) {
        const int axis = face / 2, u = 1 << (axis + 1) % 3, v = 1 << (axis + 2) % 3, base = face % 2 << axis;
        /* around the face, as seen from outside of the cell */
        const int ring[4] = {base, face % 2 ? base + u : base + v, base + u + v,
                             face % 2 ? base + v : base + u};
        for (int i = 0; i < 4; i++) { /* the border leaves the inside between i and i + 1 */
            int back = i, from, to;
            if (!(inside >> ring[i] & 1) || inside >> ring[(i + 1) % 4] & 1) continue;
            while (inside >> ring[back] & 1) back = (back + 3) % 4; /* and came in behind `back` */
            from = ring[i] ^ ring[(i + 1) % 4], to = ring[back] ^ ring[(back + 1) % 4];
            next[8 * (from >> 1) + (ring[i] & ring[(i + 1) % 4])] =
                8 * (to >> 1) + (ring[back] & ring[(back + 1) % 4]);
        }
    }
}

static int mesh_corner_at(const int cell[3], int corner)
{
    return ((cell[0] + (corner & 1)) * MESH_CORNERS + cell[1] + (corner >> 1 & 1)) * MESH_CORNERS + cell[2] +
           (corner >> 2);
}

static struct mesh_vertex mesh_cut(const struct mesh_samples *s, const int first[3], const int cell[3],
                                   int edge)
{
    const int axis = edge / 8, low = edge % 8, a = mesh_corner_at(cell, low),
              b = mesh_corner_at(cell, low | 1 << axis);
    const float t = s->distance[a] / (s->distance[a] - s->distance[b]);
    struct mesh_vertex v = {.key = 0};
    for (int k = 0; k < 3; k++) {
        const int x = first[k] + cell[k] + (low >> k & 1);
        v.key = v.key << MESH_BITS | (uint64_t)x;
        v.place[k] = (float)x + (k == axis ? t : 0);
        v.rgb[k] = (unsigned char)(s->rgb[a][k] + t * (s->rgb[b][k] - s->rgb[a][k]) + 0.5f);
    }
    v.key = v.key << 2 | (uint64_t)axis;
    return v;
}

/* Adds the triangles of a cell to `out`, three corners each; returns the number of corners, 30 at most. */
static int mesh_cell(const struct mesh_samples *s, const int first[3], const int cell[3],
                     struct mesh_vertex *out)
{
    unsigned inside = 0;
    int next[24], n = 0;
    for (int i = 0; i < 8; i++) {
        const int at = mesh_corner_at(cell, i);
        if (!s->known[at]) return 0;
        inside |= (unsigned)(s->distance[at] < 0) << i;
    }
    if (inside == 0 || inside == 255) return 0;
    mesh_trace(inside, next);
    for (int e = 0; e < 24; e++) {
        int b = next[e], c;
        if (b < 0) continue;
        next[e] = -1;
        for (c = next[b]; c != e && c >= 0; c = next[b]) { /* a fan around the loop's first edge */
            out[n++] = mesh_cut(s, first, cell, e), out[n++] = mesh_cut(s, first, cell, c),
            out[n++] = mesh_cut(s, first, cell, b);
            next[b] = -1, b = c;
        }
        next[b] = -1;
    }
    return n;
}

enum { MESH_MOST = MESH_CELLS * MESH_CELLS * MESH_CELLS * 30 };

/* Returns the corners of a block's triangles. */
static int mesh_block(const struct mesh *m, size_t block, int *list, struct mesh_samples *s,
                      struct mesh_vertex *out)
{
    int first[3], count, n = 0;
    double centre[3];
    for (int k = 0; k < 3; k++) {
        first[k] = MESH_CELLS * (int)(m->block[block] >> (2 - k) * MESH_BITS & ((1 << MESH_BITS) - 1));
        centre[k] = m->low[k] + (first[k] + 0.5 * MESH_CELLS) * m->cell;
    }
    count = surface_list(m->s, centre, 0.87 * MESH_CELLS * m->cell, list);
    for (int i = 0; i < MESH_SAMPLES; i++) {
        const int at[3] = {i / (MESH_CORNERS * MESH_CORNERS), i / MESH_CORNERS % MESH_CORNERS,
                           i % MESH_CORNERS};
        double p[3];
        for (int k = 0; k < 3; k++) p[k] = m->low[k] + (first[k] + at[k]) * m->cell;
        mesh_sample(m, list, count, p, s, i);
    }
    for (int i = 0; i < MESH_CELLS * MESH_CELLS * MESH_CELLS; i++)
        n += mesh_cell(s, first,
                       (int[3]){i / (MESH_CELLS * MESH_CELLS), i / MESH_CELLS % MESH_CELLS, i % MESH_CELLS},
                       out + n);
    return n;
}

/* ---------------- the mesh */

static int mesh_append(struct mesh *m, const struct mesh_vertex *v, size_t n)
{
    if (n == 0) return 1;
    if (m->corners + n > m->room) {
        const size_t room = 2 * (m->corners + n);
        struct mesh_vertex *larger = realloc(m->corner, room * sizeof *larger);
        if (!larger) return 0;
        m->corner = larger, m->room = room;
    }
    memcpy(m->corner + m->corners, v, n * sizeof *v);
    m->corners += n;
    return 1;
}

/* Traces all blocks, and keeps their order. */
static int mesh_trace_blocks(struct mesh *m)
{
    int failed = 0;
#pragma omp parallel reduction(+ : failed)
    {
        int *list = malloc(((size_t)m->s->views + 1) * sizeof *list);
        struct mesh_samples *s = malloc(sizeof *s);
        struct mesh_vertex *out = malloc(MESH_MOST * sizeof *out);
#pragma omp for schedule(dynamic) ordered
        for (size_t b = 0; b < m->blocks; b++) {
            const int n = list && s && out ? mesh_block(m, b, list, s, out) : -1;
#pragma omp ordered
            failed += n < 0 || !mesh_append(m, out, (size_t)n);
        }
        free(list);
        free(s);
        free(out);
    }
    return failed == 0;
}

static int mesh_compare_vertex(const void *a, const void *b)
{
    const struct mesh_vertex *x = a, *y = b;
    if (x->key != y->key) return x->key < y->key ? -1 : 1;
    return (x->at > y->at) - (x->at < y->at);
}

static uint32_t mesh_root(uint32_t *parent, uint32_t i)
{
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
}

/* Leaves out the triangles of small parts, and those without area. parent, count: (vertices) scratch. */
static void mesh_drop_small(struct mesh *m, uint32_t *parent, uint32_t *count)
{
    size_t kept = 0;
    for (uint32_t i = 0; i < m->vertex.count; i++) parent[i] = i, count[i] = 0;
    for (size_t i = 0; i < m->corners; i++) {
        const uint32_t a = mesh_root(parent, m->index[i]), b = mesh_root(parent, m->index[i - i % 3]);
        if (a != b) parent[a > b ? a : b] = a > b ? b : a;
    }
    for (size_t i = 0; i < m->corners; i += 3) count[mesh_root(parent, m->index[i])]++;
    for (size_t i = 0; i < m->corners; i += 3) {
        const uint32_t *t = m->index + i;
        if (count[mesh_root(parent, t[0])] < MESH_SMALL || t[0] == t[1] || t[1] == t[2] || t[2] == t[0])
            continue;
        memmove(m->index + 3 * kept++, t, 3 * sizeof *t);
    }
    m->triangles = kept;
}

/* Adds up the triangles' normals at their vertices. */
static void mesh_normals(struct mesh *m)
{
    for (size_t i = 0; i < 3 * m->triangles; i++) {
        const uint32_t *t = m->index + i - i % 3;
        double edge[2][3], n[3];
        for (int k = 0; k < 6; k++)
            edge[k / 3][k % 3] =
                m->vertex.point[t[1 + k / 3]].place[k % 3] - m->vertex.point[t[0]].place[k % 3];
        frame_cross(edge[0], edge[1], n);
        for (int k = 0; k < 3; k++)
            m->vertex.point[m->index[i]].normal[k] += (float)(n[k] / (m->cell * m->cell));
    }
    for (size_t i = 0; i < m->vertex.count; i++) {
        float *n = m->vertex.point[i].normal;
        const double length = frame_length((double[3]){(double)n[0], (double)n[1], (double)n[2]});
        for (int k = 0; k < 3 && length > 0; k++) n[k] = (float)((double)n[k] / length);
    }
}

/* Joins corners of triangles on one edge of the lattice to vertices, and numbers those that are used. */
static int mesh_join(struct mesh *m)
{
    uint32_t *scratch = malloc((2 * m->corners + 2) * sizeof *scratch);
    struct cloud *v = &m->vertex;
    size_t used = 0;
    m->index = malloc((m->corners + 1) * sizeof *m->index);
    v->point = calloc(m->corners + 1, sizeof *v->point);
    if (!scratch || !m->index || !v->point) return free(scratch), 0;
    for (size_t i = 0; i < m->corners; i++) m->corner[i].at = (uint32_t)i;
    qsort(m->corner, m->corners, sizeof *m->corner, mesh_compare_vertex);
    for (size_t i = 0; i < m->corners; i++) {
        const struct mesh_vertex *c = &m->corner[i];
        if (i == 0 || c->key != c[-1].key) {
            struct cloud_point *p = &v->point[v->count++];
            for (int k = 0; k < 3; k++) p->place[k] = m->low[k] + (double)c->place[k] * m->cell;
            memcpy(p->rgb, c->rgb, 3);
        }
        m->index[c->at] = (uint32_t)v->count - 1;
    }
    mesh_drop_small(m, scratch, scratch + m->corners + 1);
    memset(scratch, 0, v->count * sizeof *scratch);
    for (size_t i = 0; i < 3 * m->triangles; i++) scratch[m->index[i]] = 1;
    for (size_t i = 0; i < v->count; i++)
        if (scratch[i]) v->point[used] = v->point[i], scratch[i] = (uint32_t)used++;
    for (size_t i = 0; i < 3 * m->triangles; i++) m->index[i] = scratch[m->index[i]];
    v->count = used;
    free(scratch);
    mesh_normals(m);
    return 1;
}

/* ---------------- files */

static void mesh_put_ply(const struct mesh *m, const struct cloud_file *f, struct output *t)
{
    output_add(
        t,
        "ply\nformat binary_little_endian 1.0\ncomment oceanxl mesh, in the survey's world\nelement vertex %zu\n",
        m->vertex.count);
    output_add(
        t,
        "property double x\nproperty double y\nproperty double z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\n"
        "element face %zu\nproperty list uchar int vertex_indices\nend_header\n",
        m->triangles);
    for (size_t i = 0; i < m->vertex.count; i++) {
        for (int k = 0; k < 3; k++) output_real(t, (m->vertex.point[i].place[k] + f->origin[k]) * f->unit, 8);
        output_bytes(t, m->vertex.point[i].rgb, 3);
    }
    for (size_t i = 0; i < 3 * m->triangles; i++) {
        if (i % 3 == 0) output_integer(t, 3, 1);
        output_integer(t, m->index[i], 4);
    }
}

static void mesh_put_obj(const struct mesh *m, const struct cloud_file *f, struct output *t)
{
    const int decimals = (int)fmin(9, fmax(0, 3 - floor(log10(f->step))));
    output_add(t, "# oceanxl mesh, in the survey's world\n");
    for (size_t i = 0; i < m->vertex.count; i++) {
        const struct cloud_point *p = &m->vertex.point[i];
        output_add(t, "v");
        for (int k = 0; k < 3; k++)
            output_add(t, " %s", OUTPUT_FIXED((p->place[k] + f->origin[k]) * f->unit, decimals));
        output_add(t, " %s %s %s\n", OUTPUT_FIXED(p->rgb[0] / 255.0, 3), OUTPUT_FIXED(p->rgb[1] / 255.0, 3),
                   OUTPUT_FIXED(p->rgb[2] / 255.0, 3));
    }
    for (size_t i = 0; i < m->triangles; i++)
        output_add(t, "f %zu %zu %zu\n", (size_t)m->index[3 * i] + 1, (size_t)m->index[3 * i + 1] + 1,
                   (size_t)m->index[3 * i + 2] + 1);
}

static void mesh_free(struct mesh *m)
{
    free(m->block);
    free(m->corner);
    free(m->index);
    cloud_free(&m->vertex);
}

oxl_result mesh_save(const struct surface *s, const struct cloud *c, const struct cloud_file *f,
                     const struct arguments *a, struct deviation *d, FILE *to)
{
    struct mesh m = {
        .s = s, .enough = a->min_views, .cell = a->pixel > 0 ? a->pixel / f->unit : 2 * s->sampling};
    const size_t length = strlen(a->out);
    struct output t = {0};
    oxl_result rc = OXL_OK;
    if (!mesh_find_blocks(&m, c) || !mesh_trace_blocks(&m) || !mesh_join(&m))
        rc = oxl_fail(s->ctx, OXL_ERR_MEMORY, "mesh: no memory\nfix: use a larger --pixel");
    else if (m.triangles == 0)
        rc = oxl_fail(s->ctx, OXL_ERR_INPUT,
                      "mesh: no surface is found at cells of %g\nfix: use another "
                      "--pixel",
                      m.cell * f->unit);
    if (rc == OXL_OK) rc = cloud_deviation(s, &m.vertex, d);
    if (rc == OXL_OK) {
        output_open(&t, a->out);
        (strcmp(a->out + length - 4, ".obj") ? mesh_put_ply : mesh_put_obj)(&m, f, &t);
        if (!output_close(&t))
            rc = oxl_fail(s->ctx, OXL_ERR_IO, "%s cannot be written\nfix: free space on the disk", a->out);
    }
    if (rc == OXL_OK)
        print_format(to, "mesh      %s, %zu triangles of cells of %.3g %s\n", a->out, m.triangles,
                     m.cell * f->unit, f->words);
    mesh_free(&m);
    return rc;
}

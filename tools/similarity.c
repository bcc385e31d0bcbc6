/* similarity.c - finds the nearest point of a cloud, and the similarity that moves one cloud onto another.
 *
 * Points are listed by a hash of their cell of a cubic lattice, whose side is the largest distance asked for, so that a
 * place's neighbours are in the 27 cells around it.
 *
 * The similarity of pairs is Horn's (1987): the rotation is the unit quaternion of the largest eigenvalue of a
 * 4 x 4 matrix of the pairs' products, and the scale the ratio of the spreads.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define SIMILARITY_TUKEY 4.685 /* standard deviations from which on a residual has no weight (Huber 1981) */

/* ---------------- nearest neighbours */

/* The hash of the cell that lies `step` from the place's, of 0 to 26; 13: its own. */
static size_t near_cell(const struct near *n, const double p[3], int step)
{
    uint64_t hash = 0;
    for (int k = 0; k < 3; k++, step /= 3)
        hash = (hash ^ (uint64_t)(int64_t)(floor(p[k] / n->reach) + step % 3)) * 0x9e3779b97f4a7c15u;
    return (size_t)(hash >> 32) & (n->cells - 1);
}

void near_open(struct near *n, const struct cloud *c, double reach)
{
    *n = (struct near){.point = c->point, .reach = reach, .cells = 1};
    while (n->cells < c->count) n->cells *= 2;
    n->first = product_room(n->cells + c->count, sizeof *n->first), n->next = n->first + n->cells;
    for (size_t i = c->count; i > 0; i--) {
        uint32_t *first = &n->first[near_cell(n, c->point[i - 1].place, 13)];
        n->next[i - 1] = *first, *first = (uint32_t)i;
    }
}

const struct cloud_point *near_find(const struct near *n, const double p[3], double *off)
{
    const struct cloud_point *best = NULL;
    double least = n->reach;
    for (int k = 0; k < 27; k++)
        for (uint32_t i = n->first[near_cell(n, p, k)]; i; i = n->next[i - 1]) {
            const struct cloud_point *q = &n->point[i - 1];
            double away[3];
            vector_add(p, -1, q->place, away);
            if (!(frame_length(away) < least)) continue;
            least = frame_length(away), best = q;
            *off = vector_dot(away, q->normal);
        }
    return best;
}

/* ---------------- the similarity of pairs */

void similarity_apply(const struct similarity *s, const double p[3], double out[3])
{
    double turned[3];
    frame_to_camera(s->rotation, p, turned);
    vector_add(s->move, s->scale, turned, out);
}

struct similarity similarity_inverse(const struct similarity *s)
{
    struct similarity out = {.scale = 1 / s->scale};
    for (int k = 0; k < 9; k++) out.rotation[k] = s->rotation[k % 3 * 3 + k / 3];
    similarity_apply(&out, s->move, out.move);
    for (int k = 0; k < 3; k++) out.move[k] = -out.move[k];
    return out;
}

struct similarity similarity_compose(const struct similarity *a, const struct similarity *b)
{
    struct similarity out = {.scale = a->scale * b->scale};
    for (int i = 0; i < 27; i++)
        out.rotation[i / 3] += a->rotation[i / 9 * 3 + i % 3] * b->rotation[i % 3 * 3 + i / 3 % 3];
    similarity_apply(a, b->move, out.move);
    return out;
}

struct similarity similarity_of_world(const oxl_scene *scene, double scale)
{
    struct similarity out = {.scale = scale, .rotation = {1, 0, 0, 0, 1, 0, 0, 0, 1}};
    vector_add(out.move, scale, oxl_scene_origin(scene), out.move);
    return out;
}

struct similarity similarity_of_frame(const struct frame *f, double scale)
{
    struct similarity out = {.scale = scale};
    double centre[3];
    memcpy(out.rotation, f->axis, sizeof f->axis);
    similarity_apply(&out, f->centre, centre);
    vector_add(out.move, -1, centre, out.move);
    return out;
}

static void similarity_of_quaternion(const double q[4], double r[9])
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            r[3 * i + k] = 2 * q[i + 1] * q[k + 1] +
                           (i == k ? 2 * q[0] * q[0] - 1 : ((i + 1) % 3 == k ? -2 : 2) * q[0] * q[4 - i - k]);
}

int similarity_fit(const struct match *match, size_t count, struct similarity *out)
{
    double sum = 0, centre[2][3] = {{0}}, m[9] = {0}, spread[2] = {0, 0}, n[16], q[4], least = 0, moved[3];
    for (size_t i = 0; i < count; i++) {
        sum += match[i].weight;
        vector_add(centre[0], match[i].weight, match[i].from, centre[0]);
        vector_add(centre[1], match[i].weight, match[i].to, centre[1]);
    }
    for (int k = 0; k < 6; k++) centre[k / 3][k % 3] /= sum;
    for (size_t i = 0; i < count; i++) {
        double a[3], b[3];
        vector_add(match[i].from, -1, centre[0], a);
        vector_add(match[i].to, -1, centre[1], b);
        for (int k = 0; k < 9; k++) m[k] += match[i].weight * a[k / 3] * b[k % 3];
        spread[0] += match[i].weight * vector_dot(a, a), spread[1] += match[i].weight * vector_dot(b, b);
    }
    if (!(spread[0] > 0 && spread[1] > 0)) return 0;
    n[0] = m[0] + m[4] + m[8];
    for (int k = 0; k < 3; k++) {
        const int j = (k + 1) % 3, l = (k + 2) % 3;
        n[k + 1] = n[4 * k + 4] = m[3 * j + l] - m[3 * l + j];
        n[5 * k + 5] = m[4 * k] - m[4 * j] - m[4 * l];
        n[4 * k + j + 5] = n[4 * j + k + 5] = m[3 * k + j] + m[3 * j + k];
    }
    for (int k = 0; k < 16; k++) least += fabs(n[k]);
    for (int k = 0; k < 16; k += 5) n[k] += least; /* no eigenvalue is negative */
    frame_widest(4, n, q);
    similarity_of_quaternion(q, out->rotation);
    out->scale = sqrt(spread[1] / spread[0]);
    frame_to_camera(out->rotation, centre[0], moved);
    vector_add(centre[1], -out->scale, moved, out->move);
    return 1;
}

double similarity_weigh(struct match *match, size_t count)
{
    double *size = product_room(count, sizeof *size), spread;
    for (size_t i = 0; i < count; i++) size[i] = fabs(match[i].off);
    spread = 1.4826 * product_quantile(size, count, 0.5);
    for (size_t i = 0; i < count; i++) {
        const double u = match[i].off / (SIMILARITY_TUKEY * fmax(spread, 1e-12));
        match[i].weight = fabs(u) < 1 ? (1 - u * u) * (1 - u * u) : 0;
    }
    free(size);
    return spread;
}

/* similarity.c - finds the nearest point of a cloud, and the similarity that moves one cloud onto another.
 *
 * Points are sorted by the cell of a cubic lattice, whose side is the largest distance asked for, so that a place's
 * neighbours are in the 27 cells around it.
 *
 * The similarity of pairs is Horn's (1987): the rotation is the unit quaternion of the largest eigenvalue of a
 * 4 x 4 matrix of the pairs' products, and the scale the ratio of the spreads.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { SIMILARITY_SQUARINGS = 40, NEAR_BITS = 21 };

/* ---------------- nearest neighbours */

struct near_key {
    uint64_t cell;
    uint32_t index;
};

static int near_compare(const void *a, const void *b)
{
    const struct near_key *x = a, *y = b;
    if (x->cell != y->cell) return x->cell < y->cell ? -1 : 1;
    return (x->index > y->index) - (x->index < y->index);
}

static uint64_t near_cell(const struct near *n, const double p[3], const int step[3])
{
    uint64_t cell = 0;
    for (int k = 0; k < 3; k++) {
        const double at = floor((p[k] - n->low[k]) / n->reach) + step[k] + 1;
        cell = cell << NEAR_BITS | (uint64_t)fmin(fmax(at, 0), (1 << NEAR_BITS) - 1);
    }
    return cell;
}

int near_open(struct near *n, const struct cloud_point *point, size_t count, double reach)
{
    *n = (struct near){.point = point, .count = count, .reach = reach};
    n->key = malloc((count + 1) * sizeof *n->key);
    if (!n->key) return 0;
    for (int k = 0; k < 3; k++) n->low[k] = HUGE_VAL;
    for (size_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) n->low[k] = fmin(n->low[k], point[i].place[k]);
    for (size_t i = 0; i < count; i++)
        n->key[i] = (struct near_key){near_cell(n, point[i].place, (int[3]){0, 0, 0}), (uint32_t)i};
    qsort(n->key, count, sizeof *n->key, near_compare);
    return 1;
}

void near_close(struct near *n)
{
    free(n->key);
    *n = (struct near){0};
}

static size_t near_first(const struct near *n, uint64_t cell)
{
    size_t low = 0, high = n->count;
    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        if (n->key[middle].cell < cell) low = middle + 1;
        else high = middle;
    }
    return low;
}

const struct cloud_point *near_find(const struct near *n, const double p[3], double *distance)
{
    const struct cloud_point *best = NULL;
    *distance = n->reach;
    for (int k = 0; k < 27; k++) {
        const uint64_t cell = near_cell(n, p, (int[3]){k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1});
        for (size_t i = near_first(n, cell); i < n->count && n->key[i].cell == cell; i++) {
            const struct cloud_point *q = &n->point[n->key[i].index];
            const double away[3] = {p[0] - q->place[0], p[1] - q->place[1], p[2] - q->place[2]},
                         length = frame_length(away);
            if (length < *distance) *distance = length, best = q;
        }
    }
    return best;
}

/* ---------------- the similarity of pairs */

void similarity_apply(const struct similarity *s, const double p[3], double out[3])
{
    double turned[3];
    frame_to_camera(s->rotation, p, turned);
    for (int k = 0; k < 3; k++) out[k] = s->scale * turned[k] + s->move[k];
}

/* Sets q to the eigenvector of the largest eigenvalue of a symmetric 4 x 4 matrix, by repeated squaring of the
 * matrix, moved so that none is negative. */
static void similarity_widest(double n[4][4], double q[4])
{
    double bound = 0;
    int column = 0;
    for (int i = 0; i < 4; i++) {
        double row = 0;
        for (int k = 0; k < 4; k++) row += fabs(n[i][k]);
        bound = fmax(bound, row);
    }
    for (int i = 0; i < 4; i++) n[i][i] += bound;
    for (int pass = 0; pass < SIMILARITY_SQUARINGS; pass++) {
        const double trace = n[0][0] + n[1][1] + n[2][2] + n[3][3];
        double square[4][4] = {{0}};
        for (int k = 0; k < 64; k++)
            square[k / 16][k % 4] += n[k / 16][k / 4 % 4] / trace * (n[k / 4 % 4][k % 4] / trace);
        memcpy(n, square, sizeof square);
    }
    for (int i = 1; i < 4; i++)
        if (n[i][i] > n[column][column]) column = i;
    for (int i = 0; i < 4; i++)
        q[i] = n[i][column] / sqrt(n[column][0] * n[column][0] + n[column][1] * n[column][1] +
                                   n[column][2] * n[column][2] + n[column][3] * n[column][3]);
}

static void similarity_of_quaternion(const double q[4], double r[9])
{
    const double w = q[0], v[3] = {q[1], q[2], q[3]};
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) {
            const int next = (i + 1) % 3 == k;
            r[3 * i + k] = 2 * v[i] * v[k];
            if (i == k) r[3 * i + k] += 2 * w * w - 1;
            else r[3 * i + k] += (next ? -2 : 2) * w * v[3 - i - k];
        }
}

int similarity_fit(const double (*from)[3], const double (*to)[3], const double *weight, size_t count,
                   int with_scale, struct similarity *out)
{
    double sum = 0, a[3] = {0}, b[3] = {0}, m[3][3] = {{0}}, spread[2] = {0, 0}, n[4][4], q[4], moved[3];
    for (size_t i = 0; i < count; i++) {
        sum += weight[i];
        for (int k = 0; k < 3; k++) a[k] += weight[i] * from[i][k], b[k] += weight[i] * to[i][k];
    }
    if (!(sum > 0)) return 0;
    for (int k = 0; k < 3; k++) a[k] /= sum, b[k] /= sum;
    for (size_t i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) {
            for (int j = 0; j < 3; j++) m[k][j] += weight[i] * (from[i][k] - a[k]) * (to[i][j] - b[j]);
            spread[0] += weight[i] * (from[i][k] - a[k]) * (from[i][k] - a[k]);
            spread[1] += weight[i] * (to[i][k] - b[k]) * (to[i][k] - b[k]);
        }
    if (!(spread[0] > 0 && spread[1] > 0)) return 0;
    n[0][0] = m[0][0] + m[1][1] + m[2][2];
    for (int k = 0; k < 3; k++) {
        const int j = (k + 1) % 3, l = (k + 2) % 3;
        n[0][k + 1] = n[k + 1][0] = m[j][l] - m[l][j];
        n[k + 1][k + 1] = m[k][k] - m[j][j] - m[l][l];
        n[k + 1][j + 1] = n[j + 1][k + 1] = m[k][j] + m[j][k];
    }
    similarity_widest(n, q);
    similarity_of_quaternion(q, out->rotation);
    out->scale = with_scale ? sqrt(spread[1] / spread[0]) : 1;
    frame_to_camera(out->rotation, a, moved);
    for (int k = 0; k < 3; k++) out->move[k] = b[k] - out->scale * moved[k];
    return 1;
}

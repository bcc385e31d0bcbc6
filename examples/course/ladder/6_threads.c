/* 6_threads.c - tiles side by side: none reads what another writes, so any number of threads gives the same bytes. */
#include "ladder.h"
#include "../../../src/core/simd.h"

typedef float real;
enum { TILE = 16, ACROSS = WIDTH / TILE, DOWN = HEIGHT / TILE, TILES = ACROSS * DOWN, PAIRS = 1 << 20 };

struct pair { /* key: tile, then the bits of the depth, which sort as the depth does */
    unsigned long long key;
    int disc;
};

struct disc { /* what compositing reads of a splat */
    real x, y, half_x, half_y, A, B, C, opacity, rgb[3], depth;
};

/* Projects all Gaussians in parallel; returns how many are in view, in the model's order. */
static int project(const struct model *m, const struct camera *cam, struct disc *d) {
    static char seen[COUNT];
    int count = 0;
#pragma omp parallel for schedule(static)
    for (int i = 0; i < m->count; i++) {
        struct splat s = {.row = i};
        seen[i] = (char)project_forward(&m->row[i], m->degree, cam, &s);
        d[i].x = (real)s.centre[0], d[i].y = (real)s.centre[1], d[i].half_x = (real)s.half[0], d[i].half_y = (real)s.half[1];
        d[i].A = (real)s.conic[0][0], d[i].B = (real)s.conic[0][1], d[i].C = (real)s.conic[0][2], d[i].depth = (real)s.p[2];
        d[i].opacity = (real)s.opacity[0];
        for (int c = 0; c < 3; c++) d[i].rgb[c] = (real)s.colour[c];
    }
    for (int i = 0; i < m->count; i++)
        if (seen[i]) d[count++] = d[i];
    return count;
}

/* 2^x for x <= 0, 0 below 2^-126: a polynomial for the fraction, the whole part in the exponent's bits (src/render/kernels.h). */
SIMD_INLINE float power_of_two(float x) {
    const float shifted = (x < -126 ? -126 : x) + 12582912.0f, f = (x < -126 ? -126 : x) - (shifted - 12582912.0f);
    float p = ((((0.00132647273f * f + 0.00967151277f) * f + 0.0555073374f) * f + 0.240222421f) * f + 0.693146978f) * f + 1;
    int whole, bits;
    memcpy(&whole, &shifted, sizeof whole), memcpy(&bits, &p, sizeof bits);
    bits = (int)((unsigned)bits + ((unsigned)whole << 23));
    memcpy(&p, &bits, sizeof p);
    return p;
}

struct job { /* a row of a tile */
    const struct disc *disc;
    const struct pair *p;
    const double *background;
    int count, x, y;
    float *rgb;
};

SIMD_BODY void composite_body(const int fused, const struct job *j) {
    float T[TILE], live[TILE], sum[3][TILE] = {{0}}, open = 1;
    (void)fused;
    for (int l = 0; l < TILE; l++) T[l] = live[l] = 1;
    for (int i = 0; i < j->count && open > 0; i++) {
        const struct disc *d = &j->disc[j->p[i].disc];
        const float dy = j->y + 0.5f - d->y, e = -0.72134752f; /* -log2(e) / 2 */
        if (fabsf(dy) > d->half_y) continue;
        open = 0;
#pragma omp simd reduction(+ : open)
        for (int l = 0; l < TILE; l++) {
            const float dx = j->x + l + 0.5f - d->x, G = power_of_two(e * (d->A * dx * dx + 2 * d->B * dx * dy + d->C * dy * dy));
            const float full = d->opacity * G, alpha = full < (float)ALPHA_MIN   ? 0
                                                       : full > (float)ALPHA_MAX ? (float)ALPHA_MAX
                                                                                 : full;
            live[l] = T[l] * (1 - alpha) < (float)T_MIN ? 0 : live[l]; /* a pixel that has ended takes nothing more */
            const float share = alpha * live[l];
            for (int c = 0; c < 3; c++) sum[c][l] += d->rgb[c] * share * T[l];
            T[l] *= 1 - share, open += live[l];
        }
    }
    for (int l = 0; l < TILE; l++)
        for (int c = 0; c < 3; c++) j->rgb[3 * l + c] = sum[c][l] + T[l] * (float)j->background[c];
}
SIMD_DISPATCH(static, composite, struct job)

static int clamp(int v, int most) { return v < 0 ? 0 : v > most ? most : v; }

/* A pair for each tile that a splat's box meets. */
static int emit(const struct disc *d, int count, struct pair *p) {
    int n = 0;
    for (int i = 0; i < count; i++) {
        const int left = clamp((int)((d[i].x - d[i].half_x) / TILE), ACROSS - 1),
                  right = clamp((int)((d[i].x + d[i].half_x) / TILE), ACROSS - 1);
        const int top = clamp((int)((d[i].y - d[i].half_y) / TILE), DOWN - 1),
                  bottom = clamp((int)((d[i].y + d[i].half_y) / TILE), DOWN - 1);
        unsigned bits;
        memcpy(&bits, &d[i].depth, sizeof bits);
        for (int t = top; t <= bottom; t++)
            for (int k = left; k <= right && n < PAIRS; k++)
                p[n++] = (struct pair){(unsigned long long)(t * ACROSS + k) << 32 | bits, i};
    }
    return n;
}

/* Stable, 11 bits at a time, from the lowest: 4 passes over 43 bits. */
static void radix_sort(struct pair *p, struct pair *other, int n) {
    for (int shift = 0; shift < 44; shift += 11) {
        int start[2049] = {0};
        for (int i = 0; i < n; i++) start[(p[i].key >> shift & 2047) + 1]++;
        for (int k = 0; k < 2048; k++) start[k + 1] += start[k];
        for (int i = 0; i < n; i++) other[start[p[i].key >> shift & 2047]++] = p[i];
        struct pair *swap = p;
        p = other, other = swap;
    }
}

void render(const struct model *m, const struct camera *cam, float *rgb) {
    static struct disc d[COUNT];
    static struct pair p[PAIRS], other[PAIRS];
    static int begin[TILES + 1];
    const int isa = simd_detect(), pairs = emit(d, project(m, cam, d), p);
    radix_sort(p, other, pairs);
    for (int tile = 0, at = 0; tile < TILES; tile++) {
        begin[tile] = at;
        while (at < pairs && p[at].key >> 32 == (unsigned)tile) at++;
    }
    begin[TILES] = pairs;
#pragma omp parallel for schedule(dynamic, 8)
    for (int tile = 0; tile < TILES; tile++) {
        const int left = tile % ACROSS * TILE, top = tile / ACROSS * TILE, n = begin[tile + 1] - begin[tile];
        for (int y = top; y < top + TILE; y++) {
            const struct job job = {d, p + begin[tile], m->background, n, left, y, rgb + 3 * (y * WIDTH + left)};
            composite(isa, &job);
        }
    }
}

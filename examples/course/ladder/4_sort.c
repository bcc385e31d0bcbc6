/* 4_sort.c - one sort for all tiles: pairs of tile and depth, sorted by the bits of both. No insertion, no search per tile. */
#include "ladder.h"

typedef float real;
enum { TILE = 16, ACROSS = WIDTH / TILE, DOWN = HEIGHT / TILE, TILES = ACROSS * DOWN, PAIRS = 1 << 20 };

struct pair { /* key: tile, then the bits of the depth, which sort as the depth does */
    unsigned long long key;
    int disc;
};

struct disc { /* what compositing reads of a splat */
    real x, y, half_x, half_y, A, B, C, opacity, rgb[3], depth;
};

/* Projects all Gaussians; returns how many are in view. */
static int project(const struct model *m, const struct camera *cam, struct disc *d) {
    int count = 0;
    for (int i = 0; i < m->count; i++) {
        struct splat s = {.row = i};
        struct disc new;
        if (!project_forward(&m->row[i], m->degree, cam, &s)) continue;
        new.x = (real)s.centre[0], new.y = (real)s.centre[1], new.half_x = (real)s.half[0], new.half_y = (real)s.half[1];
        new.A = (real)s.conic[0][0], new.B = (real)s.conic[0][1], new.C = (real)s.conic[0][2], new.depth = (real)s.p[2];
        new.opacity = (real)s.opacity[0];
        for (int c = 0; c < 3; c++) new.rgb[c] = (real)s.colour[c];
        d[count++] = new;
    }
    return count;
}

static real alpha_at(const struct disc *d, real x, real y) {
    const real dx = x - d->x, dy = y - d->y;
    if (fabsf(dx) > d->half_x || fabsf(dy) > d->half_y) return 0;
    const real alpha = d->opacity * expf(-(d->A * dx * dx + 2 * d->B * dx * dy + d->C * dy * dy) / 2);
    return alpha < (real)ALPHA_MIN ? 0 : alpha > (real)ALPHA_MAX ? (real)ALPHA_MAX : alpha;
}

static void composite(const struct disc *disc, const struct pair *p, int count, const double background[3], int x, int y,
                      float *rgb) {
    real T = 1, sum[3] = {0, 0, 0};
    for (int i = 0; i < count; i++) {
        const struct disc *d = &disc[p[i].disc];
        const real alpha = alpha_at(d, x + (real)0.5, y + (real)0.5);
        if (T * (1 - alpha) < (real)T_MIN) break;
        for (int c = 0; c < 3; c++) sum[c] += d->rgb[c] * alpha * T;
        T *= 1 - alpha;
    }
    for (int c = 0; c < 3; c++) rgb[c] = (float)(sum[c] + T * (real)background[c]);
}

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
    const int pairs = emit(d, project(m, cam, d), p);
    radix_sort(p, other, pairs);
    for (int tile = 0, begin = 0, end = 0; tile < TILES; tile++, begin = end) {
        const int left = tile % ACROSS * TILE, top = tile / ACROSS * TILE;
        while (end < pairs && p[end].key >> 32 == (unsigned)tile) end++;
        for (int y = top; y < top + TILE; y++)
            for (int x = left; x < left + TILE; x++)
                composite(d, p + begin, end - begin, m->background, x, y, rgb + 3 * (y * WIDTH + x));
    }
}

/* 1_double.c - the plain loops of splat.c: every pixel asks every splat, in double. */
#include "ladder.h"

typedef double real;

struct disc { /* what compositing reads of a splat */
    real x, y, half_x, half_y, A, B, C, opacity, rgb[3], depth;
};

/* Projects all Gaussians; returns how many are in view, sorted by depth. */
static int project(const struct model *m, const struct camera *cam, struct disc *d) {
    int count = 0;
    for (int i = 0, at; i < m->count; i++) {
        struct splat s = {.row = i};
        struct disc new;
        if (!project_forward(&m->row[i], m->degree, cam, &s)) continue;
        new.x = (real)s.centre[0], new.y = (real)s.centre[1], new.half_x = (real)s.half[0], new.half_y = (real)s.half[1];
        new.A = (real)s.conic[0][0], new.B = (real)s.conic[0][1], new.C = (real)s.conic[0][2], new.depth = (real)s.p[2];
        new.opacity = (real)s.opacity[0];
        for (int c = 0; c < 3; c++) new.rgb[c] = (real)s.colour[c];
        for (at = count++; at > 0 && d[at - 1].depth > new.depth; at--) d[at] = d[at - 1];
        d[at] = new;
    }
    return count;
}

static real alpha_at(const struct disc *d, real x, real y) {
    const real dx = x - d->x, dy = y - d->y;
    if (fabs(dx) > d->half_x || fabs(dy) > d->half_y) return 0;
    const real alpha = d->opacity * exp(-(d->A * dx * dx + 2 * d->B * dx * dy + d->C * dy * dy) / 2);
    return alpha < (real)ALPHA_MIN ? 0 : alpha > (real)ALPHA_MAX ? (real)ALPHA_MAX : alpha;
}

static void composite(const struct disc *d, int count, const double background[3], int x, int y, float *rgb) {
    real T = 1, sum[3] = {0, 0, 0};
    for (int i = 0; i < count; i++) {
        const real alpha = alpha_at(&d[i], x + (real)0.5, y + (real)0.5);
        if (T * (1 - alpha) < (real)T_MIN) break;
        for (int c = 0; c < 3; c++) sum[c] += d[i].rgb[c] * alpha * T;
        T *= 1 - alpha;
    }
    for (int c = 0; c < 3; c++) rgb[c] = (float)(sum[c] + T * (real)background[c]);
}

void render(const struct model *m, const struct camera *cam, float *rgb) {
    static struct disc d[COUNT];
    const int count = project(m, cam, d);
    for (int y = 0; y < HEIGHT; y++)
        for (int x = 0; x < WIDTH; x++) composite(d, count, m->background, x, y, rgb + 3 * (y * WIDTH + x));
}

/* ladder.h - what the rungs share: a scene, the clock, the comparison with rung 1. A rung defines render() and includes this first.
 *
 * The scene: 8000 Gaussians of degree 0 before a camera of 640 x 480 px. Projection is splat.c's on every rung but the last.
 */
#define _POSIX_C_SOURCE 199309L
#define SPLAT_NO_MAIN
#include "../../../reference/splat.c"
#include <time.h>

enum { WIDTH = 640, HEIGHT = 480, COUNT = 8000 };

/* rgb (HEIGHT, WIDTH, 3) */
void render(const struct model *m, const struct camera *cam, float *rgb);

static double ladder_random(void) {
    static unsigned state = 1;
    return ((state = state * 1664525u + 1013904223u) + 0.5) / 4294967296.0;
}

static struct model ladder_scene(void) {
    struct model m = {COUNT, 0, {0.05, 0.25, 0.35}, calloc(COUNT, sizeof *m.row)};
    for (int i = 0; m.row && i < COUNT; i++) {
        struct gaussian *g = &m.row[i];
        g->mean[2] = 2 + 6 * ladder_random();
        for (int a = 0; a < 2; a++) g->mean[a] = (ladder_random() - 0.5) * (a ? 0.9 : 1.2) * g->mean[2];
        for (int a = 0; a < 3; a++)
            g->log_scale[a] = -5.2 + 1.4 * ladder_random() + log(g->mean[2] / 3), g->sh[a] = 3 * ladder_random() - 1.5;
        for (int a = 0; a < 4; a++) g->rotation[a] = ladder_random() - 0.5;
        g->logit = 5 * ladder_random() - 2;
    }
    return m;
}

static double ladder_seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* NAME TRUTH: prints "name, CPU ms of all threads, wall ms, difference"; rung 1 writes its image to TRUTH, the others compare theirs with it, in
 * grey levels of 255. */
int main(int argc, char **argv) {
    static float rgb[3 * WIDTH * HEIGHT], truth[3 * WIDTH * HEIGHT];
    const struct camera cam = {{WIDTH, HEIGHT}, {500, 500}, {WIDTH / 2.0, HEIGHT / 2.0}, {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}},
                               {0, 0, 0},       0.2};
    const struct model m = ladder_scene();
    const int first = argc > 1 && argv[1][0] == '1';
    double wall = HUGE_VAL, cpu = HUGE_VAL, all = 0, most = 0;
    FILE *f = argc > 2 ? fopen(argv[2], first ? "wb" : "rb") : NULL;
    if (!f || !m.row) return fprintf(stderr, "usage: rung NAME TRUTH\n"), 2;
    for (int i = 0; i < 300 && all < 1.5; i++) {
        const double begin = ladder_seconds();
        const clock_t used = clock();
        render(&m, &cam, rgb);
        cpu = fmin(cpu, (double)(clock() - used) / CLOCKS_PER_SEC), wall = fmin(wall, ladder_seconds() - begin),
        all += ladder_seconds() - begin;
    }
    if (first) fwrite(rgb, sizeof rgb, 1, f);
    else if (fread(truth, sizeof truth, 1, f) != 1) return fprintf(stderr, "%s: too short\n", argv[2]), 2;
    for (int i = 0; !first && i < 3 * WIDTH * HEIGHT; i++) most = fmax(most, 255 * fabs(rgb[i] - truth[i]));
    printf("%s %.3f %.3f %.4f\n", argv[1], 1e3 * cpu, 1e3 * wall, most);
    return fclose(f);
}

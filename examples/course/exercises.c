/* exercises.c - checks an exercise: compiled with STUDENT, the changed copy of splat.c, and EXERCISE, its number (make exercise-N).
 *
 * Prints the task from exercises.txt with the line to change, measures one number, and says whether it is the expected one.
 */
#define SPLAT_NO_MAIN
#include STUDENT

enum { RIGHT = 0, RIGHT_WITHOUT_PICTURE = 10, UNCHANGED = 11, WRONG = 12 }; /* exit status, which course.mk reads */

static double logit(double p) { return log(p / (1 - p)); }

static struct camera camera(void) {
    return (struct camera){{16, 16}, {16, 16}, {8, 8}, {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}}, {0, 0, 0}, 0.2};
}

/* On the line of sight of the pixel centre (8.5, 8.5) at `depth`; every scale s px there; one colour channel. */
static struct gaussian ball(double depth, double s, double opacity, int channel) {
    struct gaussian g = {.mean = {0.5 / 16 * depth, 0.5 / 16 * depth, depth}, .rotation = {1}, .logit = logit(opacity)};
    for (int a = 0; a < 3; a++) g.log_scale[a] = log(s / 16 * depth), g.sh[a] = (a == channel ? 0.5 : -0.5) * sqrt(4 * PI);
    return g;
}

/* The middle pixel of the image of these Gaussians. */
static void middle(struct gaussian *row, int count, double background, double rgb[3]) {
    static double image[3 * 256];
    static struct splat s[16];
    const struct camera cam = camera();
    const struct model m = {count, 0, {background, background, background}, row};
    render_forward(&m, &cam, s, image);
    memcpy(rgb, image + 3 * (8 * 16 + 8), 3 * sizeof *rgb);
}

/* Its red, straight ahead, of a coefficient of z of 0.5. */
static double colour_ahead(void) {
    const struct camera cam = camera();
    struct gaussian g = ball(2, 4, 0.5, 0);
    struct splat s = {.row = 0};
    g.mean[0] = g.mean[1] = g.sh[0] = 0, g.sh[3 * 2] = 0.5;
    project_forward(&g, 1, &cam, &s);
    return s.colour[0];
}

static double needle_between_rows(void) {
    const struct camera cam = camera();
    struct gaussian g = ball(4, 0.02, 0.9, 0);
    struct splat s = {.row = 0};
    double G[2];
    g.log_scale[0] = log(4.0 / 16 * 4);
    return project_forward(&g, 0, &cam, &s) ? alpha_forward(&s, s.centre[0], s.centre[1] + 0.5, 1, G) : 0;
}

static double red_before_blue(void) {
    struct gaussian row[2] = {ball(2, 4, 0.95, 0), ball(4, 4, 0.95, 2)};
    double rgb[3];
    middle(row, 2, 0, rgb);
    return rgb[0];
}

static double ten_layers(void) {
    struct gaussian row[10];
    double rgb[3];
    for (int i = 0; i < 10; i++) row[i] = ball(2 + i, 4, 0.5, 0);
    middle(row, 10, 0, rgb);
    return rgb[0];
}

/* dL/dalpha over the finite difference, L the red of the middle pixel. */
static double opacity_gradient(void) {
    const struct camera cam = camera();
    const double h = 1e-6, drgb[3] = {1, 0, 0};
    struct gaussian g = ball(2, 4, 0.5, 0), up = g, down = g;
    struct splat s = {.row = 0}, ds = {.row = 0};
    double rgb[3], more[3], less[3];
    up.logit += h, down.logit -= h;
    middle(&up, 1, 0.5, more), middle(&down, 1, 0.5, less), middle(&g, 1, 0.5, rgb);
    project_forward(&g, 0, &cam, &s);
    composite_backward(&s, 1, 8.5, 8.5, rgb, drgb, &ds);
    return ds.opacity[0] * 0.25 / ((more[0] - less[0]) / (2 * h)); /* d sigmoid = o (1 - o) = 1/4 */
}

/* |q . dq| / (|q| |dq|) of a Gaussian that is turned. */
static double along_itself(void) {
    const struct camera cam = camera();
    struct gaussian g = ball(2, 4, 0.5, 0), dg = {.lobed = 0};
    struct splat s = {.row = 0}, ds = {.row = 0, .centre = {0, 0}, .conic = {{1, 0.3, -0.4}}};
    const double q[4] = {0.9, 0.3, -0.2, 0.4};
    memcpy(g.rotation, q, sizeof q), g.log_scale[0] += 1, g.log_scale[1] -= 1;
    project_forward(&g, 0, &cam, &s), project_backward(&g, 0, &cam, &s, &ds, &dg);
    return fabs(dot(q, dg.rotation, 4)) / sqrt(dot(q, q, 4) * dot(dg.rotation, dg.rotation, 4));
}

/* dL/dx of a pixel that is 0.25 too bright, over the finite difference. */
static double loss_gradient(void) {
    const double y[3] = {0.5, 0.5, 0.5}, h = 1e-6;
    double x[3] = {0.75, 0.5, 0.5}, dx[3], unused[3];
    const double more = (x[0] += h, loss(x, y, 1, 1, 0, unused)), less = (x[0] -= 2 * h, loss(x, y, 1, 1, 0, unused));
    loss(x, y, 1, 1, 0, dx);
    return dx[0] / ((more - less) / (2 * h));
}

static double first_step(void) {
    double x = 0, m = 0, v = 0;
    adam(&x, 7, 1, 1, &m, &v);
    return fabs(x);
}

static double spread(void) {
    struct gaussian g = {.rotation = {1}};
    split(&g, 1);
    return g.mean[0] * g.mean[0] + exp(2 * g.log_scale[0]);
}

static double growth(void) {
    const struct splat s = {.lobes = 2, .half = {1, 1}, .opacity = {0, 0.1}};
    double T = 1, G[2];
    for (int i = 0; i < 100; i++) T *= 1 - alpha_forward(&s, 0, 0, T, G);
    return T;
}

static const struct {
    const char *what;
    double (*measure)(void);
    double before, low, high; /* of the unchanged file; range of the solution */
} CHECK[] = {
    {"red of the Gaussian", colour_ahead, 0.7443, 0.2556, 0.2558},
    {"alpha half a pixel beside the needle", needle_between_rows, 0.5937, 0, 1e-12},
    {"red of the pixel", red_before_blue, 0.95, 0.0474, 0.0476},
    {"brightness of the pixel", ten_layers, 0.9990, 0.8749, 0.8751},
    {"T behind 100 layers", growth, 17.449, 13780, 13782},
    {"gradient / finite difference", opacity_gradient, 1, 1.999, 2.001},
    {"part of the gradient along the quaternion", along_itself, 0, 0.137, 0.139},
    {"gradient / finite difference", loss_gradient, 1, 0.2499, 0.2501},
    {"first step in units of the learning rate", first_step, 1, 31.5, 31.7},
    {"variance of the two, relative to their parent's", spread, 1, 1.499, 1.501},
};

/* The value of `key` of exercise EXERCISE in exercises.txt. */
static const char *field(const char *path, const char *key) {
    static char line[1000];
    const size_t length = strlen(key);
    int number = 0;
    FILE *f = fopen(path, "r");
    if (!f) return perror(path), exit(1), NULL;
    while (fgets(line, sizeof line, f)) {
        line[strcspn(line, "\n")] = 0;
        if (!strncmp(line, "exercise: ", 10)) number = atoi(line + 10);
        if (number == EXERCISE && !strncmp(line, key, length) && line[length] == ':') return fclose(f), line + length + 2;
    }
    return fclose(f), "";
}

/* The line of the student's file with `part`, or 0. */
static int find_line(const char *part) {
    char line[1000];
    int number = 0, found = 0;
    FILE *f = fopen(STUDENT, "r");
    while (f && !found && fgets(line, sizeof line, f)) number++, found = strstr(line, part) ? number : 0;
    if (f) fclose(f);
    return found;
}

int main(int argc, char **argv) {
    const char *texts = argc > 1 ? argv[1] : "examples/course/exercises.txt";
    const double value = CHECK[EXERCISE - 1].measure(), before = CHECK[EXERCISE - 1].before;
    const int at = find_line(field(texts, "at")), solved = value >= CHECK[EXERCISE - 1].low && value <= CHECK[EXERCISE - 1].high;
    printf("Exercise %d: %s\n", EXERCISE, field(texts, "title"));
    printf("  change    %s", field(texts, "change"));
    printf(at ? " %s:%d\n" : " %s\n", STUDENT, at);
    printf("  predict   %s\n", field(texts, "predict"));
    printf("  measured  %s: %.6g; unchanged it is %.6g\n", CHECK[EXERCISE - 1].what, value, before);
    if (solved) {
        printf("  expected  %s\n", field(texts, "observe"));
        printf("  fast      %s\n", field(texts, "kernel"));
        printf("  test      %s\n", field(texts, "test"));
        printf("  picture   %s\n", field(texts, "picture"));
        return strncmp(field(texts, "picture"), "None", 4) ? RIGHT : RIGHT_WITHOUT_PICTURE;
    }
    if (fabs(value - before) < 0.01 * fmax(1, before)) {
        printf("  Nothing has changed yet. Edit the line, and run make exercise-%d again.\n", EXERCISE);
        return UNCHANGED;
    }
    printf("  This is not the result that the exercise expects. Edit again, or delete %s to begin anew.\n", STUDENT);
    return WRONG;
}

/* synth_fish.c - fish: transient objects, each in at most three consecutive images.
 *
 * A fish is a set of ellipsoids: body, peduncle, tail and fins; dark above, pale below, some with bars, as
 * reef fish are. Each is placed in one image, between the camera and the ground, and moves: the images before
 * and after, a second apart, may see it elsewhere. It casts no shadow, and sparse points lie on the static
 * scene.
 *
 * Invariant: a fish is a function of the options, the world and its number alone.
 */
#include "synth.h"

#define FISH_SECONDS 1.0 /* between images */
#define FISH_REACH 0.75  /* lengths: radius of the sphere that holds a fish */
enum { FISH_PARTS = 5 };

/* Of a fish of length 1 that looks along x; z is up. turn: fraction of the beat of its tail that a part
 * follows. */
static const struct fish_part {
    v3 centre, axes;
    double turn;
} fish_parts[FISH_PARTS] = {{{0.10, 0, 0}, {0.36, 0.075, 0.16}, 0},
                            {{-0.26, 0, 0}, {0.20, 0.045, 0.06}, 0.5},
                            {{-0.50, 0, 0}, {0.11, 0.014, 0.15}, 1},
                            {{0.12, 0.11, -0.04}, {0.07, 0.06, 0.012}, 0},
                            {{0.12, -0.11, -0.04}, {0.07, 0.06, 0.012}, 0}};

/* ---------------- where they are */

static uint64_t fish_bits(const synth_options *o, int view, int number, uint64_t what)
{
    return random_bits(o->seed, 400 + what, (uint64_t)view * SYNTH_FISH_MAX + (uint64_t)number);
}

/* Places the number-th fish of a view, `after` seconds later. */
static struct synth_fish fish_of(const synth_options *o, const struct synth_world *w,
                                 const struct synth_camera *c, int view, int number, double after)
{
    double u[8];
    struct synth_fish f;
    v3 ray;
    double range;
    for (int k = 0; k < 8; k++) u[k] = random_unit(fish_bits(o, view, number, (uint64_t)k));
    ray = synth_pixel_ray(c, u[0] * c->width, u[1] * c->height);
    range = synth_cast(w, c->centre, ray, SYNTH_FAR);
    range = synth_min(range < 0 ? 6 : range, 6) * (0.35 + 0.5 * u[2]);
    f.ahead = v3_unit(v3_of(cos(2 * SYNTH_PI * u[3]), sin(2 * SYNTH_PI * u[3]), 0.5 * (u[4] - 0.5)));
    f.side = v3_unit(v3_cross(v3_of(0, 0, 1), f.ahead));
    f.up = v3_cross(f.ahead, f.side);
    f.length = 0.18 + 0.3 * u[5] * u[5];
    f.seed = (uint32_t)(fish_bits(o, view, number, 8) >> 32);
    f.beat = 0.5 * sin(2 * SYNTH_PI * (u[6] + 1.7 * after));
    f.at = v3_along(v3_along(c->centre, ray, range), f.ahead, after * (0.2 + 0.6 * u[7]));
    return f;
}

int synth_fish_near(const synth_options *o, const struct synth_world *w,
                    const struct synth_trajectory *trajectory, int view, struct synth_fish *out)
{
    int count = 0;
    for (int source = view - 1; source <= view + 1; source++)
        for (int i = 0; i < o->fish && source >= 0 && source < trajectory->count; i++)
            out[count++] =
                fish_of(o, w, &trajectory->camera[source], source, i, FISH_SECONDS * (view - source));
    return count;
}

/* ---------------- a ray meets one */

static v3 fish_frame(const struct synth_fish *f, v3 p)
{
    return v3_of(v3_dot(p, f->ahead), v3_dot(p, f->side), v3_dot(p, f->up));
}

static v3 fish_turn(v3 p, double angle)
{
    return v3_of(p.x * cos(angle) - p.y * sin(angle), p.x * sin(angle) + p.y * cos(angle), p.z);
}

/* Traces a ray. from, ray: in the fish's frame and in lengths. Returns the range, or -1; *normal is in the
 * fish's frame. */
static double fish_part_cast(const struct fish_part *part, double beat, v3 from, v3 ray, v3 *normal)
{
    static const v3 hinge = {-0.12, 0, 0};
    const double angle = -part->turn * beat;
    const v3 p = v3_sub(v3_add(fish_turn(v3_sub(from, hinge), angle), hinge), part->centre),
             d = fish_turn(ray, angle);
    const v3 q = v3_of(p.x / part->axes.x, p.y / part->axes.y, p.z / part->axes.z),
             r = v3_of(d.x / part->axes.x, d.y / part->axes.y, d.z / part->axes.z);
    const double a = v3_dot(r, r), b = v3_dot(q, r), root = b * b - a * (v3_dot(q, q) - 1);
    double t;
    v3 n;
    if (root < 0) return -1;
    t = -(b + sqrt(root)) / a;
    n = v3_along(q, r, t);
    *normal = fish_turn(v3_unit(v3_of(n.x / part->axes.x, n.y / part->axes.y, n.z / part->axes.z)), -angle);
    return t;
}

/* Colours the fish. at: on the skin, in the fish's frame and in lengths. */
static v3 fish_albedo(const struct synth_fish *f, v3 at, int part)
{
    static const v3 backs[4] = {
        {0.10, 0.13, 0.10}, {0.06, 0.10, 0.20}, {0.30, 0.20, 0.05}, {0.16, 0.15, 0.14}};
    static const v3 flanks[4] = {
        {0.55, 0.58, 0.55}, {0.25, 0.45, 0.60}, {0.75, 0.55, 0.10}, {0.70, 0.66, 0.60}};
    const uint32_t kind = f->seed & 3, bars = f->seed >> 2 & 1;
    v3 colour = v3_mix(flanks[kind], backs[kind], synth_step(-0.02, 0.09, at.z));
    const double eye = hypot(at.x - 0.36, at.z - 0.03);
    if (part >= 2) colour = f->seed >> 3 & 1 ? v3_of(0.70, 0.55, 0.08) : v3_scale(backs[kind], 1.6);
    if (part < 2 && bars)
        colour = v3_scale(colour, 1 - 0.75 * synth_step(0.2, 0.6, sin(38 * at.x + (f->seed >> 4 & 7))));
    return part == 0 && eye < 0.022 ? v3_of(0.02, 0.02, 0.02) : colour;
}

static v3 fish_colour(const struct synth_fish *f, const struct synth_world *w, v3 at, v3 normal, int part)
{
    const v3 up =
        v3_add(v3_scale(f->ahead, normal.x), v3_add(v3_scale(f->side, normal.y), v3_scale(f->up, normal.z)));
    return synth_light(fish_albedo(f, at, part), up, synth_max(0, v3_dot(up, w->sun)), 1);
}

double synth_fish_cast(const struct synth_fish *fish, int count, const struct synth_world *w, v3 from, v3 ray,
                       double far, v3 *colour)
{
    double nearest = far;
    for (int i = 0; i < count; i++) {
        const struct synth_fish *f = &fish[i];
        const v3 to = v3_sub(f->at, from);
        const double along = v3_dot(to, ray), reach = FISH_REACH * f->length;
        if (along < 0 || v3_dot(to, to) - along * along > reach * reach) continue;
        for (int k = 0; k < FISH_PARTS; k++) {
            const v3 p = v3_scale(fish_frame(f, v3_scale(to, -1)), 1 / f->length), d = fish_frame(f, ray);
            v3 normal = {0, 0, 1};
            const double t = fish_part_cast(&fish_parts[k], f->beat, p, d, &normal);
            if (t <= 0 || t * f->length >= nearest) continue;
            nearest = t * f->length;
            *colour = fish_colour(f, w, v3_along(p, d, t), normal, k);
        }
    }
    return nearest < far ? nearest : -1;
}

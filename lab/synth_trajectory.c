/* synth_trajectory.c - camera paths.
 *
 * lawnmower: rows to and fro, 3 m over the ground, looking down and a little ahead; images overlap by 75 %
 * along a row and rows by 60 %, as survey manuals recommend. orbit: two rings around the boulder in the
 * middle, looking at it. Position, height and angles are perturbed. forward: one straight line, 2 m over the ground, looking ahead and
 * 35 degrees down, as a vehicle does.
 */
#include "synth.h"

#include <stdlib.h>
#include <string.h>

#define ALTITUDE 3.0       /* metres over the ground */
#define FOCAL_FRACTION 0.8 /* f / width: 64 degrees across */
#define STEP_FORWARD 0.25  /* of an image's height on the ground: 75 % overlap */
#define STEP_SIDEWAYS 0.40 /* of its width: 60 % */
#define TILT 8.0           /* degrees ahead of straight down */
#define CLEARANCE 0.5      /* metres over the ground around, at least */
#define MARGIN 3.0         /* metres of ground around what is in view */
#define FORWARD_HEIGHT 2.0 /* metres over the ground */
#define FORWARD_ASIDE -1.5 /* metres from the boulder */
#define FORWARD_STEP 0.35  /* metres between images */
#define FORWARD_PITCH 35.0 /* degrees below the horizon */

static const double degree = SYNTH_PI / 180;

static double trajectory_waver(const synth_options *o, int view, uint64_t what, double sigma)
{
    return sigma *
           synth_clamp(synth_random_normal(synth_bits(o->seed, 200 + what, (uint64_t)view)), -2.5, 2.5);
}

/* Looks along `forward`; the top of the image towards `up`; rotated around the view direction by `roll`. */
static void trajectory_aim(struct synth_camera *c, v3 forward, v3 up, double roll)
{
    const v3 z = v3_unit(forward), level = v3_unit(v3_cross(z, up)), down = v3_cross(z, level);
    c->rotation[0] = v3_add(v3_scale(level, cos(roll)), v3_scale(down, sin(roll)));
    c->rotation[1] = v3_cross(z, c->rotation[0]);
    c->rotation[2] = z;
}

/* Finds the leg of so many, flown one after the other, that a view lies on, and its place on it: -1/2 at
 * its beginning, 1/2 at its end. */
static int trajectory_leg(const synth_options *o, int legs, int view, double *along)
{
    const int64_t views = o->views;
    const int leg = (int)(view * (int64_t)legs / views);
    const int first = (int)((leg * views + legs - 1) / legs),
              after = (int)(((leg + 1) * views + legs - 1) / legs);
    *along = after - first > 1 ? (double)(view - first) / (after - first - 1) - 0.5 : 0;
    return leg;
}

/* Flies along `level`, horizontal, and looks down from it by the angle whose cosine and sine are given; turns
 * by roll. */
static void trajectory_look(const synth_options *o, int view, v3 level, double along, double down, v3 up,
                            struct synth_camera *c)
{
    trajectory_aim(c, v3_add(v3_scale(level, along), v3_of(0, 0, -down)), up,
                   trajectory_waver(o, view, 5, 2 * degree));
}

/* Poses the camera of a view, as all that follow. */
static void trajectory_lawnmower(const synth_options *o, int i, struct synth_camera *c)
{
    const double step = STEP_FORWARD * ALTITUDE * o->height / (FOCAL_FRACTION * o->width);
    const double apart = STEP_SIDEWAYS * ALTITUDE / FOCAL_FRACTION;
    const int rows = (int)synth_max(1, sqrt(o->views * step / apart) + 0.5);
    const double length = o->extent > 0 ? o->extent : step * synth_max(1, (double)o->views / rows - 1);
    const double width = o->extent > 0 ? o->extent : apart * (rows - 1);
    double along;
    const int row = trajectory_leg(o, rows, i, &along);
    const double across = rows > 1 ? (double)row / (rows - 1) - 0.5 : 0;
    const double there = row % 2 ? -1 : 1; /* to and fro */
    const double heading = trajectory_waver(o, i, 0, 3 * degree),
                 pitch = TILT * degree + trajectory_waver(o, i, 1, 2 * degree);
    const v3 ahead = v3_of(there * sin(heading), there * cos(heading), 0);
    c->centre = v3_of(width * across + trajectory_waver(o, i, 2, 0.05),
                      there * length * along + trajectory_waver(o, i, 3, 0.05),
                      ALTITUDE + trajectory_waver(o, i, 4, 0.1));
    trajectory_look(o, i, ahead, sin(pitch), cos(pitch), ahead, c);
}

static void trajectory_orbit(const synth_options *o, int i, struct synth_camera *c)
{
    const double radius = o->extent > 0 ? 0.5 * o->extent : 4.2;
    const int rings = o->views >= 16 ? 2 : 1, first = (o->views + rings - 1) / rings, ring = i / first;
    const double turn = 2 * SYNTH_PI * ((i % first) + 0.5 * ring) / (ring ? o->views - first : first);
    const double out = (ring ? 0.8 : 1) * radius + trajectory_waver(o, i, 0, 0.1);
    const v3 target = v3_of(trajectory_waver(o, i, 1, 0.15), trajectory_waver(o, i, 2, 0.15), 0.25);
    c->centre = v3_of(out * cos(turn), out * sin(turn),
                      (ring ? 1.15 : 0.8) * radius + trajectory_waver(o, i, 3, 0.1));
    trajectory_aim(c, v3_sub(target, c->centre), v3_of(0, 0, 1), trajectory_waver(o, i, 4, 2 * degree));
}

static void trajectory_forward(const synth_options *o, int i, struct synth_camera *c)
{
    const double length = o->extent > 0 ? o->extent : FORWARD_STEP * (o->views - 1);
    const double heading = trajectory_waver(o, i, 0, 3 * degree),
                 pitch = FORWARD_PITCH * degree + trajectory_waver(o, i, 1, 2 * degree);
    double along;
    trajectory_leg(o, 1, i, &along);
    c->centre = v3_of(FORWARD_ASIDE + trajectory_waver(o, i, 2, 0.15),
                      length * along + trajectory_waver(o, i, 3, 0.03),
                      FORWARD_HEIGHT + trajectory_waver(o, i, 4, 0.1));
    trajectory_look(o, i, v3_of(sin(heading), cos(heading), 0), cos(pitch), sin(pitch), v3_of(0, 0, 1), c);
}

/* Finds where the corners' rays meet z = -0.5, lower than most of the ground. */
static void trajectory_measure(struct synth_trajectory *trajectory)
{
    for (int i = 0; i < trajectory->count; i++) {
        const struct synth_camera *c = &trajectory->camera[i];
        for (int k = 0; k < 4; k++) {
            const v3 ray = synth_pixel_ray(c, k & 1 ? c->width : 0, k & 2 ? c->height : 0);
            const double range = ray.z < 0 ? synth_min(SYNTH_FAR, (c->centre.z + 0.5) / -ray.z) : SYNTH_FAR;
            const v3 hit = v3_along(c->centre, ray, range);
            trajectory->reach = synth_max(trajectory->reach, hypot(hit.x - c->centre.x, hit.y - c->centre.y));
            trajectory->half = synth_max(trajectory->half, synth_max(fabs(hit.x), fabs(hit.y)));
        }
    }
    trajectory->half += MARGIN;
}

/* Makes two cameras of each: at half the distance to its left and right. */
static void trajectory_pair(double apart, struct synth_trajectory *trajectory)
{
    for (int i = trajectory->count - 1; i >= 0; i--) {
        const struct synth_camera c = trajectory->camera[i / 2];
        trajectory->camera[i] = c;
        trajectory->camera[i].centre = v3_along(c.centre, c.rotation[0], (i % 2 ? 0.5 : -0.5) * apart);
    }
}

/* by enum synth_path */
static void (*const trajectory_paths[])(const synth_options *o, int i, struct synth_camera *c) = {
    trajectory_lawnmower, trajectory_orbit, trajectory_forward};

int synth_trajectory_create(const synth_options *o, struct synth_trajectory *trajectory)
{
    synth_options rig = *o;
    *trajectory = (struct synth_trajectory){.count = o->views};
    trajectory->camera = calloc((size_t)o->views, sizeof *trajectory->camera);
    if (!trajectory->camera) return 0;
    if (o->stereo > 0) rig.views = (o->views + 1) / 2;
    for (int i = 0; i < o->views; i++) {
        struct synth_camera *c = &trajectory->camera[i];
        *c = (struct synth_camera){.width = o->width, .height = o->height, .f = FOCAL_FRACTION * o->width};
        /* Off the middle, as calibration finds it; the other layouts state no principal point. */
        c->cx = (o->layout ? 0.5 : 0.504) * o->width, c->cy = (o->layout ? 0.5 : 0.497) * o->height;
        if (i < rig.views) trajectory_paths[o->path](&rig, i, c);
    }
    if (o->stereo > 0) trajectory_pair(o->stereo, trajectory);
    trajectory_measure(trajectory);
    return 1;
}

/* Follows the ground roughly, as a boat does: its mean over a few metres. */
void synth_trajectory_set_heights(struct synth_trajectory *trajectory, const struct synth_world *w)
{
    for (int i = 0; i < trajectory->count; i++) {
        v3 *c = &trajectory->camera[i].centre;
        double sum = 0, top = -1e9;
        for (int k = 0; k < 9; k++) {
            const double ground = synth_ground(w, c->x + k % 3 - 1, c->y + k / 3 - 1);
            sum += ground;
            top = synth_max(top, ground);
        }
        c->z = synth_max(c->z + sum / 9, top + CLEARANCE);
    }
}

void synth_trajectory_free(struct synth_trajectory *trajectory)
{
    free(trajectory->camera);
    *trajectory = (struct synth_trajectory){0};
}

v3 synth_pixel_ray(const struct synth_camera *c, double px, double py)
{
    const v3 across = v3_scale(c->rotation[0], (px - c->cx) / c->f),
             down = v3_scale(c->rotation[1], (py - c->cy) / c->f);
    return v3_unit(v3_add(v3_add(across, down), c->rotation[2]));
}

int synth_project(const struct synth_camera *c, v3 p, double *px, double *py, double *z)
{
    const v3 q = v3_turn(c->rotation, v3_sub(p, c->centre));
    *z = q.z;
    *px = c->cx + c->f * q.x / q.z;
    *py = c->cy + c->f * q.y / q.z;
    return q.z >= 1e-3;
}

const char *synth_image_folder(const synth_options *o, int view)
{
    return o->layout != SYNTH_NERF ? "images" : view % SYNTH_TEST_EVERY ? "train" : "test";
}

/* Names the image; a stereo pair is one number: IMG_00012L.png, IMG_00012R.png. */
void synth_image_name(const synth_options *o, int view, char name[32])
{
    if (o->stereo > 0) snprintf(name, 32, "IMG_%05d%c.png", view / 2, "LR"[view % 2]);
    else snprintf(name, 32, "IMG_%05d.png", view);
}

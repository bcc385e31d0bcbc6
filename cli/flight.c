/* flight.c - renders frames along a camera path: through the survey's cameras, or on an orbit around its
 * centre.
 *
 * The path through the cameras is a Catmull-Rom spline (1974) of their positions at about constant speed;
 * rotations are interpolated from one camera to the next. Frames have the intrinsics and size of the first
 * view. They are PNG, numbered from 0, as ffmpeg takes them.
 */
#include "cli.h"

#include <math.h>
#include <string.h>

#define FLIGHT_TURN 6.283185307179586

/* Turns the camera at `eye` to look along `forward`, with `down` as near to the image's down as possible. */
static void flight_look(const double eye[3], const double forward[3], const double down[3], oxl_camera *c)
{
    double right[3], *ahead = c->rotation + 6;
    for (int k = 0; k < 3; k++) ahead[k] = forward[k] / frame_length(forward);
    frame_cross(down, ahead, right);
    for (int k = 0; k < 3; k++) c->rotation[k] = right[k] / frame_length(right);
    frame_cross(ahead, c->rotation, c->rotation + 3);
    frame_place(c, eye);
}

/* Places the camera on a circle around the survey's centre, at least 0.6 of its radius above it, looking at
 * the centre. Returns 0 without memory. */
static int flight_orbit(const oxl_scene *scene, double fraction, oxl_camera *c)
{
    struct frame f;
    double low[2], high[2], eye[3], forward[3], down[3], radius, height;
    frame_choose(scene, FRAME_AUTO, &f);
    if (!frame_bounds(&f, scene, low, high)) return 0;
    radius = 0.5 * fmax(high[0] - low[0], high[1] - low[1]);
    height = fmax(frame_camera_height(&f, scene), 0.6 * radius);
    for (int k = 0; k < 3; k++) {
        forward[k] = -radius * (cos(FLIGHT_TURN * fraction) * f.axis[0][k] +
                                sin(FLIGHT_TURN * fraction) * f.axis[1][k]) -
                     height * f.axis[2][k];
        eye[k] = f.centre[k] - forward[k];
        down[k] = -f.axis[2][k];
    }
    flight_look(eye, forward, down, c);
    return 1;
}

/* Returns the camera of the i-th view, of the first before it and of the last behind. */
static const oxl_camera *flight_camera(const oxl_scene *scene, int i)
{
    const int last = oxl_scene_view_count(scene) - 1;
    return &oxl_scene_view(scene, i < 0 ? 0 : i > last ? last : i)->camera;
}

static double flight_leg(const oxl_scene *scene, int i)
{
    double a[3], b[3];
    frame_eye(flight_camera(scene, i), a);
    frame_eye(flight_camera(scene, i + 1), b);
    for (int k = 0; k < 3; k++) a[k] -= b[k];
    return frame_length(a);
}

/* Places the camera at t, 0 to 1, between the views i and i + 1. `ease` has slope 0 at both ends, so that
 * turns do not begin abruptly. */
static void flight_between(const oxl_scene *scene, int i, double t, oxl_camera *c)
{
    const oxl_camera *a = flight_camera(scene, i), *b = flight_camera(scene, i + 1);
    const double ease = t * t * (3 - 2 * t);
    double p[4][3], eye[3], forward[3], down[3];
    for (int k = 0; k < 4; k++) frame_eye(flight_camera(scene, i - 1 + k), p[k]);
    for (int k = 0; k < 3; k++) {
        eye[k] = p[1][k] + 0.5 * t *
                               (p[2][k] - p[0][k] +
                                t * (2 * p[0][k] - 5 * p[1][k] + 4 * p[2][k] - p[3][k] +
                                     t * (3 * (p[1][k] - p[2][k]) + p[3][k] - p[0][k])));
        forward[k] = (1 - ease) * a->rotation[6 + k] + ease * b->rotation[6 + k];
        down[k] = (1 - ease) * a->rotation[3 + k] + ease * b->rotation[3 + k];
    }
    /* Takes the nearer camera's down where the two are opposite and cancel. */
    if (frame_length(down) < 0.03) memcpy(down, (t < 0.5 ? a : b)->rotation + 3, sizeof down);
    flight_look(eye, forward, down, c);
}

static void flight_survey(const oxl_scene *scene, double fraction, oxl_camera *c)
{
    const int legs = oxl_scene_view_count(scene) - 1;
    double whole = 0, at;
    int i = 0;
    for (int k = 0; k < legs; k++) whole += flight_leg(scene, k);
    for (at = fraction * whole; i < legs - 1 && at > flight_leg(scene, i); i++) at -= flight_leg(scene, i);
    whole = flight_leg(scene, i);
    flight_between(scene, i, whole > 0 ? fmin(at / whole, 1) : 0, c);
}

/* Removes frames of an earlier, longer flight, which a film of these would show. */
static void flight_remove_frames(const char *folder, int count)
{
    char path[4200];
    do snprintf(path, sizeof path, "%s/frame_%05d.png", folder, count++);
    while (oxl_remove(path) == 0);
}

oxl_result flight_write(oxl_context *ctx, const oxl_model *model, const oxl_scene *scene,
                        const struct arguments *a,
                        int (*stop)(void *user, const char *what, long done, long total), void *user)
{
    oxl_render_options render = oxl_render_options_default();
    const int orbit = a->flight == FLIGHT_ORBIT;
    oxl_result rc = oxl_make_folder(ctx, a->out);
    memcpy(render.background, model->background, sizeof render.background);
    render.near_plane = (float)oxl_scene_near_plane(scene);
    if (rc == OXL_OK && (oxl_scene_view_count(scene) < 1 || (orbit && oxl_scene_point_count(scene) < 3)))
        return oxl_fail(ctx, OXL_ERR_INPUT, "--flight: the survey has too few views or points");
    if (rc == OXL_OK) flight_remove_frames(a->out, a->frames);
    for (int i = 0; i < a->frames && rc == OXL_OK; i++) {
        oxl_camera c = oxl_scene_view(scene, 0)->camera;
        oxl_image image = {0};
        char path[4200];
        if (!orbit) flight_survey(scene, (double)i / (a->frames > 1 ? a->frames - 1 : 1), &c);
        else if (!flight_orbit(scene, (double)i / a->frames, &c)) rc = OXL_ERR_MEMORY;
        snprintf(path, sizeof path, "%s/frame_%05d.png", a->out, i);
        if (rc == OXL_OK) rc = oxl_render(ctx, model, &c, &render, &image, NULL);
        if (rc == OXL_OK) rc = oxl_image_write(ctx, path, &image);
        oxl_image_free(ctx, &image);
        if (rc == OXL_OK && stop(user, "frames", i + 1, a->frames)) rc = OXL_ERR_INTERRUPTED;
    }
    return rc;
}

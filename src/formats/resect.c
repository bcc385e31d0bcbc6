/* resect.c - finds the poses of training views from where their images saw the points, which stay.
 *
 * Structure from motion leaves poses where their points are: none moves. Poses rounded, smoothed or taken
 * from elsewhere are off by what the views' tracks tell, image by image, to a few hundredths of a pixel.
 *
 * Gauss-Newton with Levenberg's damping (Marquardt 1963) over six numbers, a turn and a move in the axes of
 * the camera (pose.c), in pixels of the image file, distorted as its lens does. Distances beyond `limit`
 * count linearly (Huber 1964), so that wrong matches pull little.
 *
 * Invariant: sums in the order of the points, so a pose has the same bits whatever else runs.
 */
#include "survey_read.h"
#include "../survey/scene.h"

enum {
    RESECT_STEPS = 30,    /* most steps of a search */
    RESECT_POINTS = 4096, /* most points of an image; of more, every other, fourth ... */
    RESECT_FEWEST = 24    /* with fewer points, a pose stays */
};
#define RESECT_SHIFT 0.2 /* Moves poses if images shift by so many px of the views, rms over these. */
#define RESECT_FALL 0.8  /* Bounds the cost that is left by then, as a fraction of the cost before. */
#define RESECT_LIMIT 2.0 /* Sets `limit`, in mean errors of the survey's points, and in RESECT_ERROR. */
#define RESECT_ERROR 0.5 /* px; instead of a smaller mean error, or an unknown one */
/* Leaves a pose where points would move by this fraction of the image's longer side: programs that reduce
 * images write new cameras, and often leave the 2D points as they were. */
#define RESECT_MOST 0.1
#define RESECT_TURN 0.5     /* Leaves a pose where the sum of its three turns (rad) is greater. */
#define RESECT_DAMPING 1e-4 /* Damps the first step, as a fraction of the normal matrix' diagonal. */
#define RESECT_DAMPED 1e6   /* Ends the search at this damping: no step lowers the cost. */
#define RESECT_ENOUGH 1e-9  /* Ends the search where a step lowers the cost by no more than this fraction. */
#define RESECT_LENS_STEP 1e-5 /* Differentiates the lens over this distance, in the plane at z = 1. */
#define RESECT_UNSEEN 100.0   /* Counts a point behind the camera as so many limits away. */

struct resect_normal { /* Holds the normal equations of a step, and the cost where it begins. */
    double a[POSE_TERMS][POSE_TERMS], b[POSE_TERMS], cost;
};

OXL_INTERNAL int resect_residual(const struct resect *r, const oxl_camera *now,
                                 const struct colmap_sighting *seen, double e[2],
                                 double jacobian[2][POSE_TERMS])
{
    double x[3], pixel[2], lens[2][2], size = 0;
    camera_transform(now, seen->world, r->origin, x);
    if (!(x[2] > 0)) return 0;
    camera_distort(r->lens, (double[2]){x[0] / x[2], x[1] / x[2]}, pixel);
    for (int k = 0; k < 2; k++) {
        double ahead[2], back[2], at[2] = {x[0] / x[2], x[1] / x[2]};
        at[k] += RESECT_LENS_STEP;
        camera_distort(r->lens, at, ahead);
        at[k] -= 2 * RESECT_LENS_STEP;
        camera_distort(r->lens, at, back);
        for (int i = 0; i < 2; i++) lens[i][k] = (ahead[i] - back[i]) / (2 * RESECT_LENS_STEP);
    }
    for (int i = 0; i < 2; i++) {
        /* of the pixel by the point: the lens, then (x, y) / z */
        const double d[3] = {lens[i][0] / x[2], lens[i][1] / x[2],
                             -(lens[i][0] * x[0] + lens[i][1] * x[1]) / (x[2] * x[2])};
        for (int k = 0; k < 3; k++) { /* dx = w x (x - c) - c */
            const int next = (k + 1) % 3, last = (k + 2) % 3;
            jacobian[i][k] = d[last] * x[next] - d[next] * x[last];
            jacobian[i][3 + k] = -d[k];
            size += fabs(jacobian[i][k]) + fabs(d[k]);
        }
        e[i] = pixel[i] - seen->pixel[i];
    }
    return size + fabs(e[0]) + fabs(e[1]) <= DBL_MAX;
}

static void resect_sum(const struct resect *r, const double at[POSE_TERMS], struct resect_normal *out)
{
    oxl_camera now = *r->given;
    pose_apply(r->given, at, &now);
    *out = (struct resect_normal){.cost = 0};
    for (int n = 0; n < r->count; n++) {
        double e[2], j[2][POSE_TERMS], far = RESECT_UNSEEN * r->limit, weight;
        const int known = resect_residual(r, &now, &r->seen[n], e, j);
        if (known) far = OXL_MIN(far, sqrt(e[0] * e[0] + e[1] * e[1]));
        weight = far > r->limit ? r->limit / far : 1;
        out->cost += far > r->limit ? r->limit * (far - r->limit / 2) : far * far / 2;
        for (int i = 0; i < 2 && known; i++)
            for (int k = 0; k < POSE_TERMS; k++) {
                out->b[k] -= weight * j[i][k] * e[i];
                for (int l = 0; l <= k; l++) out->a[k][l] += weight * j[i][k] * j[i][l];
            }
    }
}

/* Solves by Cholesky's factors; 0: the points leave the pose open. */
static int resect_solve(const struct resect_normal *n, double damping, double step[POSE_TERMS])
{
    double l[POSE_TERMS][POSE_TERMS];
    for (int i = 0; i < POSE_TERMS; i++) {
        for (int k = 0; k <= i; k++) {
            double sum = n->a[i][k] * (i == k ? 1 + damping : 1);
            for (int m = 0; m < k; m++) sum -= l[i][m] * l[k][m];
            if (i == k && !(sum > 0)) return 0;
            l[i][k] = i == k ? sqrt(sum) : sum / l[k][k];
        }
        step[i] = n->b[i];
        for (int m = 0; m < i; m++) step[i] -= l[i][m] * step[m];
        step[i] /= l[i][i];
    }
    for (int i = POSE_TERMS - 1; i >= 0; i--) {
        for (int m = i + 1; m < POSE_TERMS; m++) step[i] -= l[m][i] * step[m];
        step[i] /= l[i][i];
    }
    return 1;
}

OXL_INTERNAL struct resect_found resect(const struct resect *r, double at[POSE_TERMS])
{
    struct resect_normal now, next;
    struct resect_found found = {0};
    double damping = RESECT_DAMPING, step[POSE_TERMS], to[POSE_TERMS];
    oxl_camera moved = *r->given;
    memset(at, 0, POSE_TERMS * sizeof *at);
    resect_sum(r, at, &now);
    found.before = now.cost / r->count;
    for (int i = 0; i < RESECT_STEPS && damping < RESECT_DAMPED; i++) {
        double gain;
        if (!resect_solve(&now, damping, step)) break;
        memcpy(to, at, sizeof to);
        pose_add(to, step);
        resect_sum(r, to, &next);
        gain = now.cost - next.cost;
        damping *= gain > 0 ? 0.1 : 10;
        if (!(gain > 0)) continue;
        memcpy(at, to, sizeof to);
        now = next;
        if (gain <= RESECT_ENOUGH * now.cost) break;
    }
    found.after = now.cost / r->count;
    pose_apply(r->given, at, &moved);
    for (int n = 0; n < r->count; n++) {
        double e[2], from[2], j[2][POSE_TERMS];
        if (!resect_residual(r, r->given, &r->seen[n], from, j) ||
            !resect_residual(r, &moved, &r->seen[n], e, j))
            continue;
        for (int i = 0; i < 2; i++) found.shift += (e[i] - from[i]) * (e[i] - from[i]) / r->count;
    }
    found.shift = sqrt(found.shift);
    return found;
}

/* ---------------- the views of a survey */

/* Holds an image's sightings, evenly thinned to RESECT_POINTS at most. */
static int resect_collect(struct colmap_sightings *from, struct colmap_sighting *seen)
{
    size_t every = 1, n = 0;
    int count = 0;
    for (struct colmap_sighting next; colmap_sightings_next(from, &next);) {
        if (n++ % every) continue;
        if (count == RESECT_POINTS) {
            count /= 2;
            every *= 2;
            for (int i = 0; i < count; i++) seen[i] = seen[2 * i];
        }
        seen[count++] = next;
    }
    return count;
}

OXL_INTERNAL int resect_holds(const struct resect *r, const struct resect_found *f,
                              const double at[POSE_TERMS])
{
    return f->after <= r->limit * r->limit / 2 &&
           f->shift <= RESECT_MOST * (double)OXL_MAX(r->lens->width, r->lens->height) &&
           fabs(at[0]) + fabs(at[1]) + fabs(at[2]) <= RESECT_TURN;
}

/* Finds a view's pose; shift, in px of the view; 0: the pose stays. */
static struct resect_found resect_view(const oxl_scene *scene, int view, const struct colmap_sighting *seen,
                                       int count, double at[POSE_TERMS])
{
    const struct resect r = {.given = &oxl_scene_view(scene, view)->camera,
                             .lens = scene_source_camera(scene, view),
                             .origin = oxl_scene_origin(scene),
                             .seen = seen,
                             .count = count,
                             .limit = RESECT_LIMIT * OXL_MAX(scene->stats.mean_error, RESECT_ERROR)};
    double lens[4];
    struct resect_found f;
    if (count < RESECT_FEWEST) return (struct resect_found){0};
    f = resect(&r, at);
    if (resect_holds(&r, &f, at)) {
        camera_intrinsics(r.lens, lens);
        f.shift *= r.given->fx / lens[0];
        return f;
    }
    memset(at, 0, POSE_TERMS * sizeof *at);
    return (struct resect_found){0};
}

OXL_INTERNAL oxl_result scene_resect(oxl_context *ctx, const oxl_scene *scene, double (*pose)[POSE_TERMS],
                                     int *moved)
{
    const struct colmap *c = scene_colmap(scene);
    const int views = oxl_scene_view_count(scene);
    struct colmap_sighting *seen;
    struct colmap_sightings from;
    struct resect_found sum = {0};
    oxl_result rc;
    *moved = 0;
    if (!c || c->track_count == 0 || c->format == COLMAP_JSON) return OXL_OK;
    rc = colmap_sightings_open(ctx, c, SIZE_MAX, &from);
    seen = oxl_alloc(ctx, RESECT_POINTS, sizeof *seen);
    if (rc == OXL_OK && !seen) rc = OXL_ERR_MEMORY;
    for (int v = 0; v < views && rc == OXL_OK; v++) {
        struct resect_found f;
        if (oxl_scene_view(scene, v)->is_test) continue;
        rc = colmap_sightings_of(ctx, &from, scene_source_image(scene, v));
        if (rc == OXL_OK) rc = context_stopped(ctx);
        if (rc != OXL_OK) break;
        f = resect_view(scene, v, seen, resect_collect(&from, seen), pose[v]);
        sum.before += f.before, sum.after += f.after, sum.shift += f.shift * f.shift;
        *moved += f.shift > 0;
    }
    colmap_sightings_close(ctx, &from);
    oxl_free(ctx, seen);
    sum.shift = sqrt(sum.shift / OXL_MAX(*moved, 1));
    if (sum.shift >= RESECT_SHIFT && sum.after <= RESECT_FALL * sum.before)
        oxl_log(ctx, OXL_LOG_INFO, "poses of %d views moved onto their points: images shift by %.2f px (rms)",
                *moved, sum.shift);
    else *moved = 0, memset(pose, 0, (size_t)views * sizeof *pose);
    return rc;
}

/* conventions.c - finds whether poses and points of a survey without tracks fit, and if not, in which
 * convention the poses were written.
 *
 * Tracks would tell which points an image observes (lint.c). Without them, points in front of the cameras and
 * inside the images are counted, and their colours compared with the images. Where that fails, the poses are
 * read as other programs write them: with other axes of the camera, inverted, with other axes of the world.
 *
 * Invariant: nothing that is trained changes.
 */
#include "checks.h"
#include "match.h"
#include "../survey/survey.h"

enum {
    CONVENTIONS_VIEWS = 24,   /* most images in which other conventions are tried */
    CONVENTIONS_EMPTY = 8,    /* points; an image with fewer shows nothing of the model */
    CONVENTIONS_POINTS = 100, /* points; a survey with fewer is not judged */
    CONVENTIONS_LEAST = 3,    /* images; a survey with fewer is not judged */
    CONVENTIONS_NAMED = 3     /* images that are named for each convention */
};
#define CONVENTIONS_CORRELATION 0.15 /* Bounds the median correlation of another convention from below. */
/* Bounds from below the fraction of the images that must have points in another convention,
 * if few have them as read. */
#define CONVENTIONS_FILLED 0.8
/* Limits the fraction of the images with points as read, at which points alone may decide. */
#define CONVENTIONS_UNFILLED 0.2

/* Names what is done to a pose between the two changes of axes, with x the rotation and t the translation. */
enum convention_turn {
    TURN_NONE,
    TURN_INVERTED,   /* x^T, -x^T t */
    TURN_TRANSPOSED, /* x^T; the camera's centre stays */
    TURN_ROTATION,   /* x^T, t */
    TURN_CENTRE,     /* x, -x t */
    TURN_XYZW        /* the quaternion's parts in the order x y z w */
};
static const struct convention {
    enum convention_turn turn;
    int flip_first, flip; /* 1: y and z are negated before, after the turn */
    int world[3]; /* axis of the points for each axis of the poses' world, from 1; negative: negated */
    const char *of_json, *of_colmap; /* name of the convention in messages; NULL: no program writes it */
} conventions[] = {
    {TURN_NONE,
     0,
     1,
     {1, 2, 3},
     "camera axes as in OpenCV (y down, z ahead)",
     "camera axes as in OpenGL (y up, z back)"},
    {TURN_INVERTED, 0, 0, {1, 2, 3}, NULL, "camera to world"},
    {TURN_INVERTED, 0, 1, {1, 2, 3}, NULL, "camera to world, with camera axes as in OpenGL (y up, z back)"},
    {TURN_INVERTED,
     1,
     0,
     {1, 2, 3},
     "world to camera, with camera axes as in OpenCV (y down, z ahead)",
     NULL},
    {TURN_INVERTED, 1, 1, {1, 2, 3}, "world to camera", NULL},
    {TURN_TRANSPOSED,
     1,
     1,
     {1, 2, 3},
     "rotations transposed (of world to camera) beside the cameras' places",
     NULL},
    {TURN_TRANSPOSED,
     1,
     0,
     {1, 2, 3},
     "rotations transposed (of world to camera, axes as in OpenCV) beside the cameras' places",
     NULL},
    {TURN_ROTATION, 0, 0, {1, 2, 3}, NULL, "rotations transposed (of camera to world)"},
    {TURN_CENTRE, 0, 0, {1, 2, 3}, NULL, "the cameras' places as translations"},
    {TURN_XYZW, 0, 0, {1, 2, 3}, NULL, "quaternions as x y z w"},
    {TURN_NONE,
     0,
     0,
     {1, 3, -2},
     "points in the frame before applied_transform (x z -y)",
     "world axes x z -y for the points"},
    {TURN_NONE,
     0,
     0,
     {1, -3, 2},
     "points in the frame after applied_transform (x -z y)",
     "world axes x -z y for the points"},
    {TURN_NONE,
     0,
     0,
     {2, 1, -3},
     "points in the frame before applied_transform (y x -z)",
     "world axes y x -z for the points"},
};

static void convention_transpose(double r[9])
{
    for (int i = 0; i < 3; i++)
        for (int k = i + 1; k < 3; k++) {
            const double swapped = r[3 * i + k];
            r[3 * i + k] = r[3 * k + i], r[3 * k + i] = swapped;
        }
}

/* Sets t = -r t. */
static void convention_minus(const double r[9], double t[3])
{
    const double x[3] = {t[0], t[1], t[2]};
    for (int i = 0; i < 3; i++) t[i] = -(r[3 * i] * x[0] + r[3 * i + 1] * x[1] + r[3 * i + 2] * x[2]);
}

/* Applies a turn to a pose. q: the quaternion as read. */
static void convention_turn(enum convention_turn turn, const double q[4], double r[9], double t[3])
{
    double centre[9];
    memcpy(centre, r, sizeof centre);
    convention_transpose(centre);
    if (turn == TURN_INVERTED) convention_transpose(r), convention_minus(r, t);
    if (turn == TURN_TRANSPOSED) convention_minus(centre, t), convention_transpose(r), convention_minus(r, t);
    if (turn == TURN_ROTATION) convention_transpose(r);
    if (turn == TURN_CENTRE) convention_minus(r, t);
    if (turn == TURN_XYZW) camera_rotation_from_quaternion((const double[4]){q[3], q[0], q[1], q[2]}, r);
}

static void convention_flip(double r[9], double t[3])
{
    for (int i = 3; i < 9; i++) r[i] = -r[i];
    t[1] = -t[1], t[2] = -t[2];
}

/* Returns the camera of a view whose pose is read in another convention. */
static oxl_camera convention_apply(const struct convention *c, const oxl_scene *scene, int view)
{
    const oxl_camera *as_read = &oxl_scene_view(scene, view)->camera;
    const double *origin = oxl_scene_origin(scene);
    oxl_camera out = *as_read;
    double r[9], t[3];
    memcpy(r, as_read->rotation, sizeof r);
    for (int i = 0; i < 3; i++) {
        t[i] = as_read->translation[i];
        for (int k = 0; k < 3; k++) t[i] -= r[3 * i + k] * origin[k];
    }
    if (c->flip_first) convention_flip(r, t);
    convention_turn(c->turn, scene_source_image(scene, view)->rotation, r, t);
    if (c->flip) convention_flip(r, t);
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            const int axis = abs(c->world[k]) - 1; /* since p'[k] = +-p[axis] */
            out.rotation[3 * i + axis] = r[3 * i + k] * (c->world[k] < 0 ? -1 : 1);
        }
        out.translation[i] = t[i];
    }
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) out.translation[i] += out.rotation[3 * i + k] * origin[k];
    return out;
}

static const char *convention_name(const struct match *w, size_t i)
{
    const int json = w->colmap->format == COLMAP_JSON && !strcmp(w->colmap->images_file, "transforms.json");
    return json ? conventions[i].of_json : conventions[i].of_colmap;
}

/* Correlates the image that match_take_image took last with the points under a convention.
 * room: gets these points. */
static double convention_correlate(struct match *w, size_t i, int view, struct match_layout *room)
{
    const oxl_camera camera = convention_apply(&conventions[i], w->scene, view);
    match_by_projection(w, room, &camera);
    return match_correlate(w, room, &w->map[0]);
}

struct convention_trial {
    double r[OXL_COUNT(conventions)][CONVENTIONS_VIEWS]; /* correlations of the images */
    int full[OXL_COUNT(conventions)];                    /* number of images that have points */
    struct match_layout room;
};

/* Tries all conventions on some images. */
static oxl_result conventions_try(struct match *w, int tried, struct convention_trial *t)
{
    for (int k = 0; k < tried; k++) {
        const int view = w->layout[(int)((int64_t)k * w->count / tried)].view;
        int has = 0;
        const oxl_result rc = match_take_image(w, view, &has);
        if (rc != OXL_OK) return rc;
        for (size_t i = 0; i < OXL_COUNT(conventions) && has; i++) {
            if (!convention_name(w, i)) continue;
            t->r[i][k] = convention_correlate(w, i, view, &t->room);
            t->full[i] += t->room.count >= MATCH_FEWEST;
        }
    }
    return OXL_OK;
}

/* Finds the other convention that fits; NULL: none does. filled: fraction of the
 * images with points as read. */
static oxl_result conventions_find(struct match *w, double filled, const char **name)
{
    const int tried = OXL_MIN(w->count, (int)CONVENTIONS_VIEWS);
    struct convention_trial *t = oxl_calloc(w->ctx, 1, sizeof *t);
    double best = OXL_MAX(CONVENTIONS_CORRELATION, match_median(w) + MATCH_CHANCE);
    double most = filled <= CONVENTIONS_UNFILLED ? CONVENTIONS_FILLED : 1;
    const char *by_count = NULL;
    const oxl_result rc = t ? conventions_try(w, tried, t) : OXL_ERR_MEMORY;
    *name = NULL;
    for (size_t i = 0; i < OXL_COUNT(conventions) && rc == OXL_OK; i++) {
        const char *called = convention_name(w, i);
        const double r = stats_select(t->r[i], (size_t)tried, 0.5), full = (double)t->full[i] / tried;
        if (!called) continue;
        if (r > best) best = r, *name = called;
        if (full > most || (full == most && most < 1 && !by_count)) most = full, by_count = called;
    }
    if (!*name) *name = by_count;
    oxl_free(w->ctx, t);
    return rc;
}

static const char *conventions_wanted(const struct match *w)
{
    return w->colmap->format != COLMAP_JSON ? "world to camera, x right, y down, z ahead"
           : strcmp(w->colmap->images_file, "transforms.json")
               ? "as OpenSfM writes them"
               : "camera to world, x right, y up, z back, and points of ply_file_path in the same world";
}

/* ---------------- poses of which some are in another convention */

struct convention_mixed {
    int image[OXL_COUNT(conventions)];                    /* number of images that fit the convention */
    int named[OXL_COUNT(conventions)][CONVENTIONS_NAMED]; /* first of these images, as views */
};

/* Finds the convention of an image that does not fit as read. */
static oxl_result convention_place(struct match *w, int k, double high, struct match_layout *room,
                                   struct convention_mixed *m)
{
    const double as_is = w->judged[k] ? w->score[k].as_is[0] : 0;
    const int view = w->layout[k].view;
    double best = 0;
    int found = -1, has = 0;
    const oxl_result rc = match_take_image(w, view, &has);
    for (size_t i = 0; i < OXL_COUNT(conventions) && rc == OXL_OK && has; i++) {
        const double r = convention_name(w, i) ? convention_correlate(w, i, view, room) : 0;
        if (r > best && match_is_better(r, as_is, room->count, high)) best = r, found = (int)i;
    }
    if (rc != OXL_OK || found < 0) return rc;
    if (m->image[found] < CONVENTIONS_NAMED) m->named[found][m->image[found]] = view;
    m->image[found]++;
    return OXL_OK;
}

/* Warns of images that fit in another convention while the other images fit as read. *found
 * 1: there are such images. */
static oxl_result conventions_find_mixed(struct match *w, int *found)
{
    struct match_layout *room = oxl_calloc(w->ctx, 1, sizeof *room);
    struct convention_mixed m = {.image = {0}};
    const double high = match_high(w);
    int fit = 0;
    oxl_result rc = room ? OXL_OK : OXL_ERR_MEMORY;
    for (int k = 0; k < w->count && rc == OXL_OK; k++)
        if (match_is_suspect(w, k, high)) rc = convention_place(w, k, high, room, &m);
        else fit++;
    for (size_t i = 0; i < OXL_COUNT(conventions) && rc == OXL_OK; i++) {
        struct text names = {.ctx = w->ctx};
        const int fits =
            high > 2 * CONVENTIONS_CORRELATION && fit + m.image[i] >= CONVENTIONS_FILLED * w->count;
        if (!m.image[i]) continue;
        for (int n = 0; n < OXL_MIN(m.image[i], (int)CONVENTIONS_NAMED); n++)
            text_add(&names, "%s%s", n ? ", " : "", oxl_scene_view(w->scene, m.named[i][n])->name);
        *found = 1;
        oxl_log(w->ctx, OXL_LOG_WARNING,
                "%s%d of %d images%s: %s: %s%s\n"
                "fix: write all poses %s",
                fits ? "the poses of " : "poses and points do not fit; ", m.image[i], w->count,
                fits ? " are in another convention than the others; they would fit as" : " would as",
                convention_name(w, i), names.data ? names.data : "",
                m.image[i] > CONVENTIONS_NAMED ? ", ..." : "", conventions_wanted(w));
        text_free(&names);
    }
    oxl_free(w->ctx, room);
    return rc;
}

/* Warns that poses and points do not fit, and names the convention in which they would. */
static void conventions_warn(const struct match *w, const char *name, int empty)
{
    struct text how = {.ctx = w->ctx};
    if (empty)
        text_add(&how, ": %d of %d images have fewer than %d points in front of them and inside", empty,
                 w->count, (int)CONVENTIONS_EMPTY);
    oxl_log(w->ctx, OXL_LOG_WARNING, "poses and points do not fit%s%s%s\nfix: %s the poses %s",
            name ? "; they would as: " : "", name ? name : "", how.data ? how.data : "",
            name ? "write" : "take points and poses of one model and one frame, with", conventions_wanted(w));
    text_free(&how);
}

/* Looks for a convention for all poses first, then for single poses among poses that fit. */
OXL_INTERNAL oxl_result conventions_check(struct match *w, int *found)
{
    const char *name = NULL;
    int empty = 0, judged = 0, fits;
    oxl_result rc = OXL_OK;
    *found = 0;
    for (int k = 0; k < w->count; k++) {
        empty += w->layout[k].count < CONVENTIONS_EMPTY;
        judged += w->judged[k];
    }
    if (w->count < CONVENTIONS_LEAST || w->colmap->point_count < CONVENTIONS_POINTS) return OXL_OK;
    fits = !w->tracked && 2 * empty <= w->count &&
           (!w->coloured || match_median(w) >= match_median_by_chance(w) + MATCH_CHANCE);
    if (fits && !w->coloured) return OXL_OK;
    rc = conventions_find(w, (double)judged / w->count, &name);
    if (rc == OXL_OK && !name && !w->tracked && w->coloured) rc = conventions_find_mixed(w, found);
    if (rc != OXL_OK || *found || (!name && (w->tracked || 2 * empty <= w->count))) return rc;
    *found = 1;
    conventions_warn(w, name, empty);
    return rc;
}

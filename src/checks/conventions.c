/* conventions.c - for surveys without tracks: do poses and points fit, and if not, in which convention were
 * the poses written?
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
    CONVENTIONS_VIEWS = 24,   /* images in which others are tried */
    CONVENTIONS_EMPTY = 8,    /* points: an image with fewer shows nothing of the model */
    CONVENTIONS_POINTS = 100, /* surveys with fewer are not judged by their number */
    CONVENTIONS_LEAST = 3     /* images */
};
#define CONVENTIONS_CORRELATION 0.15 /* that another convention must have in the median, */
#define CONVENTIONS_FILLED 0.8       /* or fraction of the images that must have points, */
#define CONVENTIONS_UNFILLED 0.2     /* where at most this fraction has as it was read */

static const struct convention {
    int inverted, flip_first, flip; /* as read, then: y and z negated, inverted, y and z negated */
    int world[3]; /* axis of the points for each of the poses' world, from 1; negative: negated */
    const char *of_json, *of_colmap; /* what it is called; NULL: none writes it */
} conventions[] = {
    {0,
     0,
     1,
     {1, 2, 3},
     "camera axes as in OpenCV (y down, z ahead)",
     "camera axes as in OpenGL (y up, z back)"},
    {1, 0, 0, {1, 2, 3}, NULL, "camera to world"},
    {1, 0, 1, {1, 2, 3}, NULL, "camera to world, with camera axes as in OpenGL (y up, z back)"},
    {1, 1, 0, {1, 2, 3}, "world to camera, with camera axes as in OpenCV (y down, z ahead)", NULL},
    {1, 1, 1, {1, 2, 3}, "world to camera", NULL},
    {0,
     0,
     0,
     {1, 3, -2},
     "points in the frame before applied_transform (x z -y)",
     "world axes x z -y for the points"},
    {0,
     0,
     0,
     {1, -3, 2},
     "points in the frame after applied_transform (x -z y)",
     "world axes x -z y for the points"},
    {0,
     0,
     0,
     {2, 1, -3},
     "points in the frame before applied_transform (y x -z)",
     "world axes y x -z for the points"},
};

/* Returns the camera of a view, read in another way. */
static oxl_camera convention_apply(const struct convention *c, const oxl_camera *as_read,
                                   const double origin[3])
{
    oxl_camera out = *as_read;
    double r[9], t[3];
    memcpy(r, as_read->rotation, sizeof r);
    for (int i = 0; i < 3; i++) {
        t[i] = as_read->translation[i];
        for (int k = 0; k < 3; k++) t[i] -= r[3 * i + k] * origin[k];
    }
    for (int step = 0; step < 3; step++) {
        double x[9], y[3];
        memcpy(x, r, sizeof x);
        memcpy(y, t, sizeof y);
        for (int i = 0; i < 3 && (step == 1 ? c->inverted : step == 0 ? c->flip_first : c->flip); i++) {
            const double sign = step != 1 && i > 0 ? -1 : 1;
            t[i] = step == 1 ? -(x[i] * y[0] + x[3 + i] * y[1] + x[6 + i] * y[2]) : sign * y[i];
            for (int k = 0; k < 3; k++) r[3 * i + k] = step == 1 ? x[3 * k + i] : sign * x[3 * i + k];
        }
    }
    for (int i = 0; i < 3; i++) {
        for (int k = 0; k < 3; k++) {
            const int axis = abs(c->world[k]) - 1; /* p'[k] = +-p[axis] */
            out.rotation[3 * i + axis] = r[3 * i + k] * (c->world[k] < 0 ? -1 : 1);
        }
        out.translation[i] = t[i];
    }
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++) out.translation[i] += out.rotation[3 * i + k] * origin[k];
    return out;
}

/* Computes the median correlation of some images, and the fraction of them that have points. */
static oxl_result convention_try(struct match *w, const struct convention *c, struct match_layout *room,
                                 double *correlation, double *filled)
{
    const int tried = OXL_MIN(w->count, (int)CONVENTIONS_VIEWS);
    double r[CONVENTIONS_VIEWS];
    int full = 0;
    for (int k = 0; k < tried; k++) {
        const int view = w->layout[(int)((int64_t)k * w->count / tried)].view;
        const oxl_camera camera =
            convention_apply(c, &oxl_scene_view(w->scene, view)->camera, oxl_scene_origin(w->scene));
        int has = 0;
        const oxl_result rc = match_take_image(w, view, &has);
        if (rc != OXL_OK) return rc;
        match_by_projection(w, room, &camera);
        r[k] = has ? match_correlate(w, room, &w->map[0]) : 0;
        full += room->count >= MATCH_FEWEST;
    }
    *correlation = stats_select(r, (size_t)tried, 0.5);
    *filled = (double)full / tried;
    return OXL_OK;
}

/* Finds which other convention fits; NULL: none. filled: of the images as read. */
static oxl_result conventions_find(struct match *w, double filled, const char **name)
{
    const int json = w->colmap->format == COLMAP_JSON && !strcmp(w->colmap->images_file, "transforms.json");
    struct match_layout *room = oxl_calloc(w->ctx, 1, sizeof *room);
    double best = OXL_MAX(CONVENTIONS_CORRELATION, match_median(w) + MATCH_CHANCE);
    double most = filled <= CONVENTIONS_UNFILLED ? CONVENTIONS_FILLED : 1;
    const char *by_count = NULL;
    oxl_result rc = room ? OXL_OK : OXL_ERR_MEMORY;
    *name = NULL;
    for (size_t i = 0; i < OXL_COUNT(conventions) && rc == OXL_OK; i++) {
        const char *called = json ? conventions[i].of_json : conventions[i].of_colmap;
        double r = 0, full = 0;
        if (!called) continue;
        rc = convention_try(w, &conventions[i], room, &r, &full);
        if (r > best) best = r, *name = called;
        if (full > most || (full == most && most < 1 && !by_count)) most = full, by_count = called;
    }
    if (!*name) *name = by_count;
    oxl_free(w->ctx, room);
    return rc;
}

static const char *conventions_wanted(const struct match *w)
{
    return w->colmap->format != COLMAP_JSON ? "world to camera, x right, y down, z ahead"
           : strcmp(w->colmap->images_file, "transforms.json")
               ? "as OpenSfM writes them"
               : "camera to world, x right, y up, z back, and points of ply_file_path in the same world";
}

OXL_INTERNAL oxl_result conventions_check(struct match *w, int *found)
{
    const char *name = NULL;
    int empty = 0, judged = 0;
    oxl_result rc = OXL_OK;
    *found = 0;
    for (int k = 0; k < w->count; k++) {
        empty += w->layout[k].count < CONVENTIONS_EMPTY;
        judged += w->judged[k];
    }
    if (w->count < CONVENTIONS_LEAST || w->colmap->point_count < CONVENTIONS_POINTS) return OXL_OK;
    if (!w->tracked && 2 * empty <= w->count &&
        (!w->coloured || match_median(w) >= match_median_by_chance(w) + MATCH_CHANCE))
        return OXL_OK;
    rc = conventions_find(w, (double)judged / w->count, &name);
    if (rc != OXL_OK || (!name && (w->tracked || 2 * empty <= w->count))) return rc;
    *found = 1;
    oxl_log(
        w->ctx, OXL_LOG_WARNING,
        "poses and points do not fit%s%s: %d of %d images have fewer than %d points in front of them and inside\n"
        "fix: %s the poses %s",
        name ? "; they would as: " : "", name ? name : "", empty, w->count, (int)CONVENTIONS_EMPTY,
        name ? "write" : "take points and poses of one model and one frame, with", conventions_wanted(w));
    return rc;
}

/* scene_views.c - makes the views of a survey: COLMAP's images that exist on disk, with undistorted, reduced
 * cameras.
 *
 * Invariant: views and the test split follow the bytewise order of names, not the order in images.txt.
 */
#include "survey_read.h"
#include "../core/vecmath.h"
#include "../survey/image_header.h"
#include "../survey/scene.h"
#include "../survey/tracks.h"

enum {
    SCENE_TEST_EVERY = 8, /* of so many views by name, the first is held out [Barron 2022] */
    SCENE_NAMED = 3       /* most images that a message names */
};
#define SCENE_NO_MOVE 1e-9  /* Limits a translation that is none. */
#define SCENE_ASPECT 0.4    /* Limits the logarithm of the ratio of focal lengths. */
#define SCENE_SAME_SIZE 1.5 /* Limits how far the sides of images of one size differ, px. */

/* ---------------- missing images */

/* Says which images are missing, and fails if that is too many. */
static oxl_result scene_check_missing(oxl_context *ctx, const oxl_scene *scene, double fraction,
                                      const char *names)
{
    const struct colmap *c = &scene->colmap;
    const int missing = scene->stats.images_missing;
    if (missing && scene->view_count && missing <= fraction * (double)c->image_count)
        oxl_log(ctx, OXL_LOG_WARNING, "%d of %zu images are not in %s, and are left out: %s", missing,
                c->image_count, scene->images, names);
    else if (missing)
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%d of the %zu images of %s are not in %s: %s; at most %.0f %% may be missing\n"
            "fix: %s",
            missing, c->image_count, c->images_file, scene->images, names, 100 * fraction,
            scene->view_count == 0
                ? "use --images to name the folder where the image names of the model start"
                : "put them there; or train without them by a larger --missing-images; or take them out of the "
                  "file that names them (COLMAP's: colmap image_deleter)");
    return OXL_OK;
}

/* ---------------- views */

/* Reduces a camera until the longer side is at most max_side, and to the size on disk when the images were
 * made smaller. */
static oxl_camera scene_reduce(const oxl_camera *ideal, int max_side, double on_disk)
{
    oxl_camera c = *ideal;
    const int side = OXL_MAX(c.width, c.height);
    const double limited = max_side > 0 && max_side < side ? (double)max_side / side : 1,
                 scale = OXL_MIN(limited, on_disk);
    c.width = OXL_MAX(1, (int)(ideal->width * scale + 0.5));
    c.height = OXL_MAX(1, (int)(ideal->height * scale + 0.5));
    c.fx *= (double)c.width / ideal->width;
    c.cx *= (double)c.width / ideal->width;
    c.fy *= (double)c.height / ideal->height;
    c.cy *= (double)c.height / ideal->height;
    return c;
}

/* Returns the pixels of the image per pixel of its camera; 1 if the image is unreadable, which is reported
 * later. *turned: its EXIF orientation turns it into the camera's shape. */
static double scene_size_on_disk(oxl_context *ctx, const char *path, const struct colmap_camera *camera,
                                 int *turned)
{
    struct image_header h;
    if (image_read_header(ctx, path, &h) != OXL_OK) return 1;
    if ((h.width < 1 || h.height < 1) && image_size(ctx, path, &h.width, &h.height) != OXL_OK) return 1;
    *turned = h.orientation >= 5 && !image_has_shape(h.width, h.height, camera->width, camera->height) &&
              image_has_shape(h.width, h.height, camera->height, camera->width);
    if (*turned) OXL_SWAP(int, h.width, h.height);
    return OXL_MAX((double)h.width / camera->width, (double)h.height / camera->height);
}

struct scene_build { /* Holds the working data of scene construction. */
    const oxl_scene_options *options;
    struct scene_order *order; /* (images) */
    oxl_camera *ideal;         /* (cameras) undistorted and reduced; width 0: not yet */
    struct scene_size {        /* (images) those that are there, by the size that their camera states */
        int width, height;
        double on_disk;
        size_t camera, order;
    } * size;
    size_t odd_focals;
    uint8_t *unplaced; /* (images) 1: without a pose of its own */
};

/* Adds a name to those of a message, up to SCENE_NAMED. */
static void scene_add_name(struct text *t, size_t count, const char *name)
{
    if (count <= SCENE_NAMED) text_add(t, "%s%s", count > 1 ? ", " : "", name);
    else if (count == SCENE_NAMED + 1) text_add(t, ", ...");
}

static int scene_compare_sizes(const void *a, const void *b)
{
    const struct scene_size *s = a, *t = b;
    if (s->width != t->width) return s->width < t->width ? -1 : 1;
    if (s->height != t->height) return s->height < t->height ? -1 : 1;
    if (s->on_disk != t->on_disk) return s->on_disk < t->on_disk ? -1 : 1;
    return (s->order > t->order) - (s->order < t->order);
}

/* Gives cameras of one size the size on disk that most of their images have: one that is smaller would make
 * all of them small. Names the others. size: (count) sorted. */
static void scene_use_most(oxl_context *ctx, oxl_scene *scene, const struct scene_build *b, size_t count)
{
    struct text names = {.ctx = ctx};
    size_t others = 0;
    for (size_t from = 0, to = 0; from < count; from = to) {
        const struct scene_size *first = &b->size[from], *most;
        while (to < count && b->size[to].width == first->width && b->size[to].height == first->height) to++;
        most = &b->size[(from + to) / 2];
        for (const struct scene_size *s = first; s < b->size + to; s++) {
            char name[400];
            scene->on_disk[s->camera] = most->on_disk;
            if (fabs(s->on_disk - most->on_disk) * OXL_MAX(s->width, s->height) <= SCENE_SAME_SIZE) continue;
            snprintf(name, sizeof name, "%.300s (%.0f x %.0f px, most have %.0f x %.0f)",
                     b->order[s->order].name, s->on_disk * s->width, s->on_disk * s->height,
                     most->on_disk * s->width, most->on_disk * s->height);
            scene_add_name(&names, ++others, name);
        }
    }
    if (others)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%zu images differ in size from most images of their camera, and are scaled to that size: "
                "%s\nfix: use images of one size; enlarged images make the model blurred",
                others, names.data ? names.data : "");
    text_free(&names);
}

/* Measures the images that are there. */
static void scene_measure_images(oxl_context *ctx, oxl_scene *scene, struct scene_build *b)
{
    const struct colmap *c = &scene->colmap;
    size_t turned = 0, count = 0;
    for (size_t i = 0; i < c->image_count; i++) {
        const struct colmap_camera *from = colmap_find_camera(c, c->image[b->order[i].image].camera_id);
        const char *path = PATH(scene->images, "%s", b->order[i].name);
        int is_turned = 0;
        if (b->options->read_images && !os_is_file(path)) continue;
        b->size[count++] =
            (struct scene_size){from->width, from->height,
                                b->options->read_images ? scene_size_on_disk(ctx, path, from, &is_turned) : 1,
                                (size_t)(from - c->camera), i};
        turned += (size_t)is_turned;
    }
    qsort(b->size, count, sizeof *b->size, scene_compare_sizes);
    scene_use_most(ctx, scene, b, count);
    if (turned)
        oxl_log(ctx, OXL_LOG_INFO,
                "%zu images are turned by their EXIF orientation, since their cameras are upright", turned);
}

static oxl_result scene_ideal_camera(oxl_context *ctx, const oxl_scene *scene, struct scene_build *b,
                                     size_t camera)
{
    const struct colmap_camera *from = &scene->colmap.camera[camera];
    oxl_camera *ideal = &b->ideal[camera];
    char said[sizeof ctx->error];
    oxl_result rc;
    if (ideal->width) return OXL_OK;
    rc = camera_undistorted(ctx, from, ideal);
    if (rc != OXL_OK) { /* an error about a line of the survey's files; the folder is not in it */
        memcpy(said, ctx->error, sizeof said);
        return oxl_fail(ctx, rc, "%s/%s", scene->colmap.folder, said);
    }
    if ((!camera_focal_is_plausible(ideal->fx, from->width, from->height) ||
         !camera_focal_is_plausible(ideal->fy, from->width, from->height) ||
         fabs(vecmath_log(ideal->fx / ideal->fy)) > SCENE_ASPECT) &&
        !b->odd_focals++)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s:%d: the focal length of camera %lld is %g, %g px, for images of %d x %d px: expected 0.2 "
                "to 20 times the longer side, about the same along both\n"
                "fix: give focal lengths in px: millimetres times the image's width over the sensor's",
                from->file, from->line, (long long)from->id, ideal->fx, ideal->fy, from->width, from->height);
    *ideal = scene_reduce(ideal, b->options->max_side, scene->on_disk[camera]);
    return OXL_OK;
}

/* Returns 1 if an image has the pose of no turn and no move, or, where there are tracks, that of another that
 * is in none. */
static int scene_has_no_pose(const struct colmap *c, const struct colmap_image *image,
                             const uint8_t *trackless)
{
    const double *q = image->rotation, *t = image->translation;
    int shared = 0;
    for (size_t i = 0; i < c->image_count && c->track_count; i++)
        shared += trackless[i] && !memcmp(q, c->image[i].rotation, sizeof image->rotation) &&
                  !memcmp(t, c->image[i].translation, sizeof image->translation);
    return shared > 1 || ((q[0] != 0) + (q[1] != 0) + (q[2] != 0) + (q[3] != 0) == 1 &&
                          fabs(t[0]) + fabs(t[1]) + fabs(t[2]) < SCENE_NO_MOVE);
}

/* Finds images that programs could not place: where there are tracks, they are in none, and where there are
 * none, more than one has the pose of no turn and no move. */
static void scene_find_unplaced(oxl_context *ctx, const oxl_scene *scene, struct scene_build *b)
{
    const struct colmap *c = &scene->colmap;
    struct text names = {.ctx = ctx};
    size_t count = 0;
    memset(b->unplaced, 1, c->image_count);
    for (size_t k = 0; k < c->track_count; k++) b->unplaced[c->track[k].image_row] = 0;
    for (size_t i = 0; i < c->image_count; i++) {
        b->unplaced[i] = b->unplaced[i] && scene_has_no_pose(c, &c->image[i], b->unplaced);
        if (b->unplaced[i]) scene_add_name(&names, ++count, c->names + c->image[i].name);
    }
    if (count == 0 || count == c->image_count ||
        (c->track_count == 0 && (count == 1 || 2 * count > c->image_count)))
        memset(b->unplaced, 0, c->image_count);
    else
        oxl_log(ctx, OXL_LOG_WARNING,
                "%zu of %zu images have no pose of their own and see no point: they were not registered, and "
                "are left out: %s",
                count, c->image_count, names.data ? names.data : "");
    text_free(&names);
}

/* Adds the view of an image that is there. */
static oxl_result scene_add_view(oxl_context *ctx, oxl_scene *scene, struct scene_build *b,
                                 const struct scene_order *o)
{
    const struct colmap_image *image = &scene->colmap.image[o->image];
    const struct colmap_camera *from = colmap_find_camera(&scene->colmap, image->camera_id);
    const size_t camera = (size_t)(from - scene->colmap.camera);
    oxl_view *view = &scene->view[scene->view_count];
    oxl_result rc;
    rc = scene_ideal_camera(ctx, scene, b, camera);
    if (rc != OXL_OK) return rc;
    *view = (oxl_view){.name = o->name, .camera = b->ideal[camera]};
    camera_rotation_from_quaternion(image->rotation, view->camera.rotation);
    memcpy(view->camera.translation, image->translation, sizeof image->translation);
    if (!camera_has_pose(&view->camera))
        return oxl_fail(ctx, OXL_ERR_INPUT,
                        "%s/%s:%d: the pose of %s is not finite, or beyond 1e15\n"
                        "fix: remove the image, or export the model again",
                        scene->colmap.folder, scene->colmap.images_file, image->line, o->name);
    scene->source[scene->view_count++] = (struct scene_source){o->image, camera};
    return OXL_OK;
}

/* Refuses two images with one name. */
static oxl_result scene_check_names(oxl_context *ctx, const oxl_scene *scene, const struct scene_order *order)
{
    const struct colmap *c = &scene->colmap;
    for (size_t i = 1; i < c->image_count; i++)
        if (strcmp(order[i - 1].name, order[i].name) == 0)
            return oxl_fail(ctx, OXL_ERR_INPUT,
                            "%s/%s:%d: %s appears twice, first in line %d; expected each image "
                            "once\nfix: export the model again, or take one of the two out",
                            c->folder, c->images_file, c->image[order[i].image].line, order[i].name,
                            c->image[order[i - 1].image].line);
    return OXL_OK;
}

static oxl_result scene_add_views(oxl_context *ctx, oxl_scene *scene, struct scene_build *b)
{
    const struct colmap *c = &scene->colmap;
    struct text missing = {.ctx = ctx};
    oxl_result rc = b->options->read_images ? survey_match_names(ctx, scene) : OXL_OK;
    if (rc != OXL_OK) return rc;
    for (size_t i = 0; i < c->image_count; i++)
        b->order[i] = (struct scene_order){c->names + c->image[i].name, i};
    qsort(b->order, c->image_count, sizeof *b->order, scene_compare_order);
    rc = scene_check_names(ctx, scene, b->order);
    scene_find_unplaced(ctx, scene, b);
    scene_measure_images(ctx, scene, b);
    for (size_t i = 0; i < c->image_count && rc == OXL_OK; i++) {
        const char *name = b->order[i].name;
        if (b->unplaced[b->order[i].image]) continue;
        if (b->options->read_images && !os_is_file(PATH(scene->images, "%s", name)))
            scene_add_name(&missing, (size_t)++scene->stats.images_missing, name);
        else rc = scene_add_view(ctx, scene, b, &b->order[i]);
    }
    if (rc == OXL_OK)
        rc = scene_check_missing(ctx, scene, b->options->missing_images, missing.data ? missing.data : "");
    text_free(&missing);
    return rc;
}

OXL_INTERNAL oxl_result scene_build_views(oxl_context *ctx, oxl_scene *scene,
                                          const oxl_scene_options *options)
{
    const struct colmap *c = &scene->colmap;
    struct scene_build b = {.options = options};
    oxl_result rc;
    if (c->image_count == 0 || c->image_count > INT_MAX / 2)
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s holds %zu images\nfix: run COLMAP's mapper, and name its best sub-model by --sparse",
            c->images_file, c->image_count);
    b.order = oxl_alloc(ctx, c->image_count, sizeof *b.order);
    b.ideal = oxl_calloc(ctx, c->camera_count + 1, sizeof *b.ideal);
    b.size = oxl_alloc(ctx, c->image_count, sizeof *b.size);
    b.unplaced = oxl_alloc(ctx, c->image_count, 1);
    rc = scene_alloc_views(ctx, scene, c->image_count);
    scene->on_disk = oxl_calloc(ctx, c->camera_count + 1, sizeof *scene->on_disk);
    if (rc == OXL_OK && !(b.order && b.ideal && b.size && b.unplaced && scene->on_disk)) rc = OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = scene_add_views(ctx, scene, &b);
    OXL_FREE(ctx, b.order, b.ideal, b.size, b.unplaced);
    return rc;
}

/* Marks the views that the survey's files hold out. Refuses --test-every beside them, since one of
 * the two would be ignored. */
static oxl_result scene_mark_stated_views(oxl_context *ctx, oxl_scene *scene, int test_every)
{
    const struct colmap *c = &scene->colmap;
    for (int i = 0; i < scene->view_count; i++) {
        scene->view[i].is_test = scene_source_image(scene, i)->split == COLMAP_TEST;
        scene->stats.test_views += scene->view[i].is_test;
    }
    if (test_every < 0) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE,
                    "--test-every %d: the survey itself states which of its images are held out (%d of %d)\n"
                    "fix: leave --test-every out; %s/%s and the files beside it state the split",
                    test_every, scene->stats.test_views, scene->view_count, c->folder, c->images_file);
}

/* Holds out the views with index 0, 8, 16... by name, as 3DGS does; copies are not counted and go with the
 * image that they show. A single view is a training view. */
static void scene_mark_every(oxl_scene *scene, int every, const int *of)
{
    int own = 0;
    for (int i = 0; i < scene->view_count && scene->view_count > 1 && every > 0; i++) {
        scene->view[i].is_test = of[i] < i ? scene->view[of[i]].is_test : own++ % every == 0;
        scene->stats.test_views += scene->view[i].is_test;
    }
}

OXL_INTERNAL oxl_result scene_mark_test_views(oxl_context *ctx, oxl_scene *scene, int test_every, int looks)
{
    int *of = oxl_alloc(ctx, (size_t)scene->view_count + 1, sizeof *of);
    oxl_result rc = of ? OXL_OK : OXL_ERR_MEMORY;
    for (int i = 0; of && i < scene->view_count; i++) of[i] = i;
    if (rc == OXL_OK && looks) rc = scene_find_twins(ctx, scene, of);
    if (rc == OXL_OK && scene->colmap.states_split) rc = scene_mark_stated_views(ctx, scene, test_every);
    else if (rc == OXL_OK) scene_mark_every(scene, test_every < 0 ? SCENE_TEST_EVERY : test_every, of);
    oxl_free(ctx, of);
    return rc;
}

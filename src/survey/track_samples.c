/* track_samples.c - samples points in the images that observe them, by tracks: what is measured of a survey's
 * images before any training.
 *
 * Invariant: a function of the scene. Samples follow the file order of points and the name order of views.
 */
#include "image.h"
#include "scene.h"
#include "track_samples.h"
#include "tracks.h"

/* Chooses the training views, or every k-th view of each camera if there are too many: every k-th of all
 * might be those of one camera of a stereo pair. */
static void track_samples_choose_views(const oxl_scene *scene, struct track_samples *s)
{
    const struct colmap *c = scene_colmap(scene);
    const int views = scene->view_count;
    int train = 0;
    int64_t seen[LAMP_MAX] = {0}, most;
    for (int i = 0; i < views; i++) train += !scene->view[i].is_test;
    for (size_t i = 0; i < c->image_count; i++) s->view[i] = -1;
    most = OXL_MAX(train, TRACK_SAMPLES_VIEWS);
    for (int i = 0; i < views; i++) {
        const int lamp = imaging_find_lamp(scene, s->lamp, s->lamps, i);
        if (scene->view[i].is_test) continue;
        seen[lamp]++;
        if ((seen[lamp] - 1) * TRACK_SAMPLES_VIEWS / most == seen[lamp] * TRACK_SAMPLES_VIEWS / most)
            continue;
        s->view[scene_source_image(scene, i) - c->image] = s->views;
        s->lamp_of[s->views] = lamp;
        s->chosen[s->views++] = i;
    }
}

static void track_sample_project(const oxl_scene *scene, int view, struct track_sample *s)
{
    double x[3], pixel[2];
    s->valid = scene_project_point(scene, view, s->point, x, pixel);
    if (!s->valid) return;
    s->z = x[2];
    s->range = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]);
    s->x = (float)pixel[0];
    s->y = (float)pixel[1];
}

static double track_sample_depth(const oxl_scene *scene, const struct track_samples *s, size_t k)
{
    return s->at[k].z / scene->view[s->chosen[s->at[k].view]].camera.fx;
}

/* Takes points with all their chosen views; every k-th point if there are too many. */
static void track_samples_choose(const oxl_scene *scene, size_t most, struct track_samples *s)
{
    const struct colmap *c = scene_colmap(scene);
    struct tracks_walk all = tracks_of(c, s->view);
    size_t count = 0;
    while (tracks_next(&all)) count++;
    for (size_t i = 0; i < c->point_count; i += count / most + 1) {
        const size_t first = s->count;
        struct tracks_walk own = tracks_of(c, s->view);
        double farthest = 0;
        own.point = i, own.end = i + 1;
        own.origin = scene->origin;
        while (s->count < most && s->count - first < TRACK_SAMPLES_LONGEST && tracks_next(&own)) {
            s->at[s->count] = (struct track_sample){.point = i, .view = own.view};
            track_sample_project(scene, s->chosen[own.view], &s->at[s->count]);
            if (!s->at[s->count].valid) continue;
            farthest = OXL_MAX(farthest, track_sample_depth(scene, s, s->count));
            s->count++;
        }
        if (s->count - first < s->fewest) s->count = first;
        for (size_t k = first; k < s->count; k++)
            s->at[k].near = (float)(farthest / track_sample_depth(scene, s, k));
    }
}

OXL_INTERNAL oxl_result track_samples_take(oxl_context *ctx, const oxl_scene *scene, size_t most,
                                           size_t fewest, struct track_samples *out)
{
    const struct colmap *c = scene_colmap(scene);
    *out = (struct track_samples){.view = oxl_alloc(ctx, c->image_count + 1, sizeof *out->view),
                                  .at = oxl_alloc(ctx, OXL_MIN(most, c->track_count) + 1, sizeof *out->at),
                                  .fewest = fewest};
    if (!out->view || !out->at) return OXL_ERR_MEMORY;
    out->lamps = imaging_set_lamps(scene, out->lamp);
    track_samples_choose_views(scene, out);
    track_samples_choose(scene, most, out);
    return OXL_OK;
}

OXL_INTERNAL void track_samples_free(oxl_context *ctx, struct track_samples *s)
{
    OXL_FREE(ctx, s->view, s->at);
}

OXL_INTERNAL size_t track_samples_end(const struct track_samples *s, size_t first)
{
    size_t end = first;
    while (end < s->count && s->at[end].point == s->at[first].point) end++;
    return end;
}

OXL_INTERNAL int track_sample_sum(const struct training_image *image, const int from[2], const int to[2],
                                  double sum[3])
{
    const size_t width = (size_t)image->width, plane = width * (size_t)image->height;
    sum[0] = sum[1] = sum[2] = 0;
    if (from[0] < 0 || from[1] < 0 || to[0] > image->width || to[1] > image->height) return 0;
    for (int y = from[1]; y < to[1]; y++)
        for (size_t i = (size_t)y * width + (size_t)from[0], end = (size_t)y * width + (size_t)to[0]; i < end;
             i++) {
            if (image->mask && image->mask[i] < 128) return 0;
            for (size_t c = 0; c < 3; c++) sum[c] += image->rgb[i + c * plane];
        }
    return 1;
}

/* Removes unusable samples, and points that have too few left. */
static void track_samples_compact(struct track_samples *s)
{
    size_t kept = 0;
    for (size_t first = 0, end; first < s->count; first = end) {
        const size_t start = kept;
        end = track_samples_end(s, first);
        for (size_t k = first; k < end; k++)
            if (s->at[k].valid) s->at[kept++] = s->at[k];
        if (kept - start < s->fewest) kept = start;
    }
    s->count = kept;
}

OXL_INTERNAL oxl_result track_samples_measure(oxl_context *ctx, const oxl_scene *scene,
                                              track_sample_measurer *measure, struct track_samples *s)
{
    for (int v = 0; v < s->views; v++) {
        const struct training_image *image;
        if (context_stopped(ctx) != OXL_OK) return OXL_ERR_INTERRUPTED;
        scene_images_ahead(ctx, scene, s->chosen + v, s->views - v);
        image = scene_image(ctx, scene, s->chosen[v]);
        if (!image && !scene_lacks_image(ctx->failed)) return ctx->failed;
        for (size_t i = 0; i < s->count; i++)
            if (s->at[i].view == v) s->at[i].valid = image && measure(image, &s->at[i]);
    }
    track_samples_compact(s);
    return OXL_OK;
}

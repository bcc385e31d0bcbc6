/* test_track_depth.c - which depths of tracks a step compares, and where. */
#include "test.h"
#include "../src/parts/track_depth.h"

TEST(depth_of_tracks_is_that_of_training_views_and_its_weight_falls_to_zero)
{
    struct track_depth d = {0};
    struct depth_point point[DEPTH_POINTS], again[DEPTH_POINTS];
    int count, same;
    size_t kept = 0;
    photometry_test_make("depth_tracks", SYNTH_3C);
    oxl_scene *scene = test_load("depth_tracks", NULL);
    CHECK_OK(track_depth_begin(test_ctx, &d, scene, NULL));
    for (int v = 0; v < oxl_scene_view_count(scene); v++) {
        const oxl_view *view = oxl_scene_view(scene, v);
        const double full = track_depth_of_step(&d, v, 7, 0, &count, point);
        kept += (size_t)OXL_MIN(d.view[v].seen, 1024);
        CHECK(view->is_test ? count == 0 && full == 0 : count > 10 && full > 0);
        if (view->is_test) continue;
        CHECK_CLOSE(track_depth_of_step(&d, v, 7, 0.75, &same, again), full / 4, 1e-9);
        CHECK(same == count && memcmp(point, again, (size_t)count * sizeof *point) == 0);
        CHECK(track_depth_of_step(&d, v, 7, 1, &same, again) == 0);
        for (int i = 0; i < count; i++)
            CHECK(point[i].z > 0 && point[i].x > -1 && point[i].x < view->camera.width + 1 &&
                  point[i].y > -1 && point[i].y < view->camera.height + 1);
    }
    { /* what the prediction of memory says */
        const double bytes =
            part_track_depth.bytes(&(oxl_train_options){.medium = OXL_AUTO}, oxl_scene_view_count(scene));
        CHECK((double)(kept * sizeof *d.all) < bytes && bytes < 1.5 * (double)(kept * sizeof *d.all));
    }
    track_depth_free(&(struct train){.ctx = test_ctx}, &d);
    oxl_scene_free(test_ctx, scene);
}

TEST(depth_of_tracks_is_kept_for_views_with_a_window_alone)
{
    struct track_depth d = {0};
    struct depth_point point[DEPTH_POINTS];
    OWNED_MEMORY struct image_window *window = NULL;
    int count;
    photometry_test_make("depth_windows", SYNTH_3C);
    OWNED_SCENE *scene = test_load("depth_windows", NULL);
    int views = oxl_scene_view_count(scene);
    window = oxl_calloc(test_ctx, (size_t)views, sizeof *window);
    for (int v = 0; v < views; v += 2) window[v] = (struct image_window){.width = 8, .height = 8};
    CHECK_OK(track_depth_begin(test_ctx, &d, scene, window));
    for (int v = 0; v < views; v++) {
        track_depth_of_step(&d, v, 7, 0, &count, point);
        CHECK((count > 0) == (v % 2 == 0 && !oxl_scene_view(scene, v)->is_test));
    }
    track_depth_free(&(struct train){.ctx = test_ctx}, &d);
}

TEST(depth_of_tracks_is_compared_at_the_places_of_the_window_and_of_halved_images)
{
    const struct image_window window = {.x = 16, .y = 32, .width = 64, .height = 48};
    struct image_window all[14];
    const struct train_task task = {.window = all};
    struct depth_point point[DEPTH_POINTS];
    struct train t = {.ctx = test_ctx, .task = task, .step = 7};
    struct track_depth d = {0};
    int count;
    photometry_test_make("depth_window", SYNTH_3C);
    CHECK_OK(oxl_scene_load(test_ctx, test_path("depth_window"), NULL, (oxl_scene **)&t.survey));
    t.scene = t.survey;
    t.renderer = test_renderer();
    for (int v = 0; v < 14; v++) all[v] = window;
    for (t.halved = 0; t.halved < 2; t.halved++) {
        struct part_view v = {.view = 3, .progress = 0.5, .imaging = {.medium = {.on = 1}}};
        CHECK_OK(track_depth_before_backward(&t, &d, &v));
        track_depth_of_step(&d, 3, 7, 0.5, &count, point);
        CHECK(count == DEPTH_POINTS && t.renderer->depth_points == count);
        for (int i = 0; i < count; i++) {
            const float side = t.halved ? 2 : 1;
            CHECK_CLOSE(side * t.renderer->depth_point[i].x + 16, point[i].x, 1e-4);
            CHECK_CLOSE(side * t.renderer->depth_point[i].y + 32, point[i].y, 1e-4);
        }
    }
    track_depth_free(&(struct train){.ctx = test_ctx}, &d);
    renderer_free(test_ctx, t.renderer);
    oxl_scene_free(test_ctx, (oxl_scene *)t.survey);
}

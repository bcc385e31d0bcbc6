/* test_dropout.c - which surveys have dropout. */
#include "test.h"
#include "cases.h"
#include "../src/parts/dropout.h"

TEST(train_drops_gaussians_out_where_views_and_images_per_point_are_few)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_STANDARD);
    oxl_scene scene = {.view_count = 40};
    oxl_view view[40];
    memset(view, 0, sizeof view);
    scene.view = view;
    scene.stats.mean_track = 4.5;
    for (int i = 0; i < 11; i++) view[i].is_test = 1;
    CHECK_CLOSE(dropout_rate(&o, &scene), 0.4, 0);
    o.iterations = 45 * 29; /* 45 steps per view */
    CHECK_CLOSE(dropout_rate(&o, &scene), 0.2, 1e-12);
    o.iterations = 30 * 29;
    CHECK(dropout_rate(&o, &scene) == 0);
    o.iterations = 60 * 29;
    scene.stats.mean_track = 4.6;
    CHECK(dropout_rate(&o, &scene) == 0);
    scene.stats.mean_track = 0;
    CHECK(dropout_rate(&o, &scene) == 0);
    scene.stats.mean_track = 4.5, view[10].is_test = 0;
    CHECK(dropout_rate(&o, &scene) == 0);
    o.dropout = 0.25f;
    CHECK(dropout_rate(&o, &scene) == 0.25);
}

TEST(train_records_the_rate_of_dropout_in_the_digits_that_were_asked_for)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    OWNED_SCENE *scene = train_scene(14);
    OWNED_TEXT decisions = test_text();
    struct train_task task = {.decisions = &decisions};
    OWNED_MODEL model = {0};
    o.iterations = 1;
    o.dropout = 0.3f;
    CHECK_OK(train_run(test_ctx, scene, &o, NULL, &task, &model));
    CHECK_TEXT(decisions.data, "\"dropout\": {\"chosen\": \"0.3\", \"evidence\": \"as set\"}");
}

/* test_train_rehearse.c - steps that are tried before a run tell its time and leave nothing behind. */

TEST(rehearse_tells_a_time_and_leaves_the_run_as_it_would_be)
{
    oxl_scene        *scene = train_scene(5);
    oxl_train_options o     = train_options(20);
    oxl_model         before, after;
    double            few, many;
    CHECK_OK(oxl_train(test_ctx, scene, &o, NULL, &before));
    few          = rehearse(test_ctx, scene, &o, 400);
    o.iterations = 20000;
    many         = rehearse(test_ctx, scene, &o, 400);
    o.iterations = 20;
    CHECK(few > 0 && many > few);
    CHECK_OK(oxl_train(test_ctx, scene, &o, NULL, &after));
    CHECK(train_same(&before, &after));
    oxl_model_free(test_ctx, &before);
    oxl_model_free(test_ctx, &after);
    oxl_scene_free(test_ctx, scene);
}

TEST(rehearse_expects_more_gaussians_the_more_often_the_run_is_densified_up_to_the_cap)
{
    oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    double            before;
    o.iterations = 400;
    before       = rehearse_expected(&o, 1000, 1000000);
    o.iterations = 800;
    CHECK(before > 1000 && rehearse_expected(&o, 1000, 1000000) > before);
    CHECK(rehearse_expected(&o, 1000, 1100) == 1100 && rehearse_expected(&o, 1000, 10) == 10);
}

/* The earlier a run is full, the more of it is spent with the grown model. */
TEST(rehearse_weighs_the_grown_model_by_when_the_run_has_grown)
{
    const oxl_train_options draft = oxl_train_options_default(OXL_PRESET_DRAFT),
                            paper = oxl_train_options_default(OXL_PRESET_PAPER);
    CHECK_CLOSE(rehearse_share(&draft, 1000, 1000), 1, 1e-12);
    CHECK(rehearse_share(&draft, 1000, 1250) > 0 && rehearse_share(&draft, 1000, 1250) < rehearse_share(&paper, 1000, 1250));
    CHECK(rehearse_share(&paper, 1000, 2000) < 1);
}

TEST(rehearse_expects_more_over_a_pixel_where_more_were_and_where_more_come)
{
    const oxl_train_options o = oxl_train_options_default(OXL_PRESET_DRAFT);
    CHECK(rehearse_trained(&o, 0, 2) == 0);
    CHECK(rehearse_trained(&o, 80, 1) > rehearse_trained(&o, 40, 1));
    CHECK(rehearse_trained(&o, 40, 2) > rehearse_trained(&o, 40, 1));
}

TEST(rehearse_grows_a_model_beside_its_own_centres)
{
    static const oxl_point at[3] = {{.position = {0, 0, 0}}, {.position = {1, 0, 0}}, {.position = {0, 1, 0}}};
    oxl_model              model, grown;
    CHECK_OK(oxl_model_from_points(test_ctx, at, 3, 1, &model));
    CHECK_OK(rehearse_grow(test_ctx, &model, 9, &grown));
    CHECK(grown.count == 9 && grown.sh_degree == 1);
    for (int i = 0; i < 9; i++)
        for (int a = 0; a < 3; a++) CHECK(grown.plane[OXL_MEAN + a][i] > -1.5f && grown.plane[OXL_MEAN + a][i] < 2.5f);
    oxl_model_free(test_ctx, &model);
    oxl_model_free(test_ctx, &grown);
}

/* Each from the widths that the one before has left. */
TEST(rehearse_makes_widths_that_as_many_gaussians_lie_over_a_pixel_as_were_asked_for)
{
    oxl_scene       *scene = train_scene(5);
    struct rehearsal r     = {.ctx = test_ctx, .scene = scene, .render = oxl_render_options_default()};
    oxl_model        model;
    float            before;
    CHECK_OK(renderer_create(test_ctx, &r.renderer));
    CHECK_OK(oxl_model_from_points(test_ctx, oxl_scene_points(scene), oxl_scene_point_count(scene), 1, &model));
    for (double overlap = 3; overlap < 100; overlap *= 4) {
        CHECK_OK(rehearse_train_widths(&r, &model, overlap));
        CHECK_OK(rehearse_look(&r, &model));
        CHECK(rehearse_overlap(&r) > 0.7 * overlap && rehearse_overlap(&r) < 1.4 * overlap);
    }
    before = model.plane[OXL_LOG_SCALE][0];
    CHECK_OK(rehearse_train_widths(&r, &model, 1e9));
    CHECK(model.plane[OXL_LOG_SCALE][0] - before < REHEARSE_ROUNDS * REHEARSE_WIDER + 1e-5);
    renderer_free(test_ctx, r.renderer);
    oxl_model_free(test_ctx, &model);
    oxl_scene_free(test_ctx, scene);
}

/* test_train_robust.c - content of one image alone is masked; content of all images, or not learned yet, is not. */

enum { ROBUST_TEST_SIDE = 48, ROBUST_TEST_PIXELS = ROBUST_TEST_SIDE * ROBUST_TEST_SIDE, ROBUST_TEST_BLOT = 12 };

struct robust_case {
    oxl_scene        *scene;
    struct transients transients;
    float             rendered[3 * ROBUST_TEST_PIXELS], image[3 * ROBUST_TEST_PIXELS], weight[ROBUST_TEST_PIXELS];
};

static struct robust_case *robust_case(void)
{
    struct robust_case *c = calloc(1, sizeof *c);
    c->scene              = train_scene(7);
    CHECK_OK(transients_begin(test_ctx, &c->transients, c->scene, 1));
    return c;
}

static void robust_case_free(struct robust_case *c)
{
    transients_free(test_ctx, &c->transients);
    oxl_scene_free(test_ctx, c->scene);
    free(c);
}

/* The image is what is rendered, but for a blot with its corner at (x, y). */
static void robust_test_paint(float *rgb, int x, int y, float by)
{
    for (int c = 0; c < 3; c++)
        for (int j = 0; j < ROBUST_TEST_BLOT; j++)
            for (int i = 0; i < ROBUST_TEST_BLOT; i++) rgb[c * ROBUST_TEST_PIXELS + (y + j) * ROBUST_TEST_SIDE + x + i] += by;
}

static void robust_test_look(struct robust_case *c, int view, int masked)
{
    const struct transients_view v = {&oxl_scene_view(c->scene, view)->camera, 0.2, c->rendered, c->image, c->weight, masked};
    CHECK_OK(transients_weigh(test_ctx, &c->transients, c->scene, &v, 1));
}

static int robust_test_aside(const struct robust_case *c)
{
    int count = 0;
    for (int i = 0; i < ROBUST_TEST_PIXELS; i++) count += c->weight[i] == 0;
    return count;
}

TEST(robust_puts_aside_a_blot_in_one_image_and_nothing_else)
{
    struct robust_case *c = robust_case();
    for (int i = 0; i < 3 * ROBUST_TEST_PIXELS; i++) /* texture that is not learned yet: large, but none in the mean */
        c->image[i] = 0.5f + (i % 2 ? 0.2f : -0.2f), c->rendered[i] = 0.5f;
    for (int k = 0; k < 30; k++) robust_test_look(c, k % 7, 0);
    CHECK(robust_test_aside(c) == 0);
    robust_test_paint(c->image, 16, 20, 0.3f);
    robust_test_look(c, 3, 0);
    CHECK(robust_test_aside(c) == ROBUST_TEST_BLOT * ROBUST_TEST_BLOT);
    CHECK(c->weight[20 * ROBUST_TEST_SIDE + 16] == 0 && c->weight[31 * ROBUST_TEST_SIDE + 27] == 0);
    CHECK(c->weight[19 * ROBUST_TEST_SIDE + 16] == 1 && c->weight[31 * ROBUST_TEST_SIDE + 28] == 1);
    robust_test_paint(c->image, 28, 20, 0.04f); /* faint beside it: one square of that, 4 px wide, goes with it */
    robust_test_look(c, 3, 0);
    CHECK(robust_test_aside(c) == (ROBUST_TEST_BLOT + 4) * ROBUST_TEST_BLOT);
    CHECK(c->weight[20 * ROBUST_TEST_SIDE + 31] == 0 && c->weight[20 * ROBUST_TEST_SIDE + 32] == 1);
    robust_case_free(c);
}

TEST(robust_puts_aside_nothing_that_the_other_views_do_not_explain_either)
{
    struct robust_case *c = robust_case();
    robust_test_paint(c->image, 16, 20, 0.15f); /* hard to model: there in all views, from the first look on */
    for (int k = 0; k < 200; k++) {
        robust_test_look(c, 3, 0);
        CHECK(robust_test_aside(c) == 0);
    }
    memset(c->image, 0, sizeof c->image); /* learned at last: a fish before it is seen then */
    for (int k = 0; k < 30; k++) robust_test_look(c, 3, 0);
    robust_test_paint(c->image, 16, 20, 0.15f);
    robust_test_look(c, 3, 0);
    CHECK(robust_test_aside(c) == ROBUST_TEST_BLOT * ROBUST_TEST_BLOT);
    robust_case_free(c);
}

TEST(robust_keeps_masks_and_asks_nobody_about_what_they_hide)
{
    struct robust_case *c = robust_case();
    float               before, after;
    size_t              hidden = 0;
    for (int i = 0; i < ROBUST_TEST_PIXELS; i++) c->weight[i] = i / ROBUST_TEST_SIDE < 24 ? 0 : 1;
    robust_test_look(c, 3, 1);
    CHECK(robust_test_aside(c) == ROBUST_TEST_PIXELS / 2);
    while (hidden < c->transients.points && (c->transients.place[hidden] < 0 || c->transients.place[hidden] >= 60)) hidden++;
    CHECK(hidden < c->transients.points); /* 5 of 12 rows of squares: well behind the mask */
    before = c->transients.usual[hidden];
    robust_test_look(c, 3, 1);
    after = c->transients.usual[hidden];
    CHECK(before == after && before == TRANSIENTS_MOST);
    for (int i = 0; i < ROBUST_TEST_PIXELS; i++) c->weight[i] = 0;
    robust_test_look(c, 3, 0); /* without a mask the weights are made anew */
    CHECK(robust_test_aside(c) == 0 && c->transients.usual[hidden] < before);
    robust_case_free(c);
}

TEST(robust_without_points_is_off_and_says_so)
{
    oxl_view          view  = {"a.png", {8, 8, 9, 9, 4, 4, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0}}, 0};
    oxl_image         image = {0};
    oxl_scene        *scene = NULL;
    struct transients r;
    CHECK_OK(oxl_image_create(test_ctx, 8, 8, &image));
    CHECK_OK(oxl_scene_from_arrays(test_ctx, &view, &image, 1, NULL, 0, &scene));
    faults_heard[0]       = 0;
    test_ctx->options.log = faults_listen;
    CHECK_OK(transients_begin(test_ctx, &r, scene, 1));
    CHECK(r.points == 0 && !r.usual);
    CHECK_TEXT(faults_heard, "the scene has no points");
    transients_free(test_ctx, &r);
    oxl_image_free(test_ctx, &image);
    oxl_scene_free(test_ctx, scene);
}

/* The scene of train_scene in twilight, a tenth as bright, so that soon all is explained but one thing: a blot in the image of view 5, less
 * than what counts before anything is known. */
static oxl_scene *robust_test_scene(int views)
{
    oxl_scene *scene = train_scene(views), *blotted = NULL;
    oxl_view   view[16];
    oxl_image  image[16];
    oxl_point  point[144];
    CHECK(oxl_scene_point_count(scene) == OXL_COUNT(point));
    for (size_t i = 0; i < OXL_COUNT(point); i++) {
        point[i] = oxl_scene_points(scene)[i];
        memset(point[i].rgb, 13, sizeof point[i].rgb);
    }
    for (int v = 0; v < views; v++) {
        view[v] = *oxl_scene_view(scene, v);
        CHECK_OK(oxl_scene_image(test_ctx, scene, v, &image[v]));
        for (int i = 0; i < 3 * ROBUST_TEST_PIXELS; i++) image[v].rgb[i] *= 0.1f;
    }
    robust_test_paint(image[5].rgb, 16, 20, 0.19f);
    CHECK_OK(oxl_scene_from_arrays(test_ctx, view, image, views, point, OXL_COUNT(point), &blotted));
    for (int v = 0; v < views; v++) oxl_image_free(test_ctx, &image[v]);
    oxl_scene_free(test_ctx, scene);
    return blotted;
}

/* Stopped before and after masks begin, and in the trial of the bands. */
TEST(robust_a_run_stopped_at_any_step_ends_in_the_same_bytes)
{
    static const int       stops[] = {20, 61, 99, 122, 125, 127, 150};
    struct checkpoint_case c       = checkpoint_of(robust_test_scene(14), train_options(240));
    oxl_model              model, plain;
    c.options.sh_degree = -1;
    CHECK_OK(oxl_train(test_ctx, c.scene, &c.options, NULL, &plain));
    c.options.mask_transients = 1;
    CHECK_OK(oxl_train(test_ctx, c.scene, &c.options, NULL, &c.whole));
    CHECK(!train_same(&plain, &c.whole));
    for (size_t i = 0; i < OXL_COUNT(stops); i++) {
        CHECK(checkpoint_run(&c, "key", stops[i], &model) == OXL_ERR_INTERRUPTED);
        oxl_model_free(test_ctx, &model);
    }
    CHECK_OK(checkpoint_run(&c, "key", -1, &model));
    CHECK(train_same(&model, &c.whole));
    oxl_model_free(test_ctx, &model);
    oxl_model_free(test_ctx, &plain);
    checkpoint_case_free(&c);
}

TEST(robust_gives_the_same_bytes_with_one_and_three_threads)
{
    oxl_scene        *scene   = robust_test_scene(9);
    oxl_train_options options = train_options(100);
    oxl_model         one, three;
    const int         threads = test_ctx->threads;
    options.mask_transients   = 1;
    test_ctx->threads         = 1;
    CHECK_OK(oxl_train(test_ctx, scene, &options, NULL, &one));
    test_ctx->threads = 3;
    CHECK_OK(oxl_train(test_ctx, scene, &options, NULL, &three));
    test_ctx->threads = threads;
    CHECK(train_same(&one, &three));
    oxl_model_free(test_ctx, &one);
    oxl_model_free(test_ctx, &three);
    oxl_scene_free(test_ctx, scene);
}

/* ---------------------------------------------------------------- free space */

/* Points 10 in front of the cameras of scene_survey, all over their images, seen from `track` images; and one at depth 3 that two saw. */
static oxl_scene *carve_scene(int track)
{
    const char       *path    = scene_survey("carve", 4, 0, 1);
    struct text       points  = {.ctx = test_ctx};
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene        *scene;
    for (int i = 0; i < 23 * 13; i++) {
        text_add(&points, "%d %g %g 10 10 20 30 0.5", 2 + i, i % 23 * 0.5 - 4, i / 23 * 0.5 - 3);
        for (int k = 0; k < track; k++) text_add(&points, " %d 0", 10 + k);
        text_add(&points, "\n");
    }
    text_add(&points, "1 1.5 0 3 10 20 30 0.5 11 0 12 0\n");
    test_write("carve/sparse/0/points3D.txt", points.data);
    text_free(&points);
    CHECK_OK(oxl_scene_load(test_ctx, path, &options, &scene));
    return scene;
}

static int carve_free(const struct free_space *f, const oxl_scene *scene, double x, double y, double z)
{
    const double *o    = oxl_scene_origin(scene);
    const double  p[3] = {x - o[0], y - o[1], z - o[2]};
    return free_space_holds(f, p);
}

TEST(carve_free_space_lies_between_training_cameras_and_the_points_of_their_tracks)
{
    oxl_scene        *scene = carve_scene(3);
    struct free_space f     = {0};
    char              words[160];
    CHECK_OK(free_space_begin(test_ctx, &f, scene));
    CHECK(f.views == 3);
    free_space_describe(&f, words, sizeof words);
    CHECK_TEXT(words, "65 % of the cells of 3 training views"); /* the third saw no point, and rims have few neighbours */
    CHECK(carve_free(&f, scene, 1.5, 0, 3) && carve_free(&f, scene, 1.5, 0, 6.9));
    CHECK(!carve_free(&f, scene, 1.5, 0, 7.1) && !carve_free(&f, scene, 1.5, 0, 11) && !carve_free(&f, scene, 1.5, 0, -3));
    CHECK(!carve_free(&f, scene, -0.8, 0, 3)); /* seen by the held-out view alone */
    CHECK(!carve_free(&f, scene, 3.8, 0, 3));  /* and by one that is in no track */
    free_space_free(test_ctx, &f);
    oxl_scene_free(test_ctx, scene);
    scene = carve_scene(2);
    CHECK_OK(free_space_begin(test_ctx, &f, scene));
    CHECK(!carve_free(&f, scene, 1.5, 0, 3));
    free_space_free(test_ctx, &f);
    oxl_scene_free(test_ctx, scene);
}

TEST(carve_removes_gaussians_in_free_space_and_nothing_where_there_are_no_tracks)
{
    oxl_scene        *scene   = carve_scene(3), *plain;
    oxl_train_options options = train_options(200);
    struct free_space f       = {0};
    oxl_model         model, same;
    CHECK_OK(free_space_begin(test_ctx, &f, scene));
    for (int carve = 0; carve < 2; carve++) {
        uint8_t *carved;
        size_t   count = 0;
        options.carve  = carve;
        CHECK_OK(oxl_train(test_ctx, scene, &options, NULL, &model));
        CHECK_OK(free_space_carve(test_ctx, &f, &model, &carved));
        for (size_t i = 0; i < model.count; i++) count += carved[i];
        CHECK((count > 0) == !carve);
        oxl_free(test_ctx, carved);
        oxl_model_free(test_ctx, &model);
    }
    free_space_free(test_ctx, &f);
    oxl_scene_free(test_ctx, scene);
    plain = train_scene(5);
    CHECK_OK(oxl_train(test_ctx, plain, &options, NULL, &model));
    options.carve = 0;
    CHECK_OK(oxl_train(test_ctx, plain, &options, NULL, &same));
    CHECK(train_same(&model, &same));
    oxl_model_free(test_ctx, &model);
    oxl_model_free(test_ctx, &same);
    oxl_scene_free(test_ctx, plain);
}

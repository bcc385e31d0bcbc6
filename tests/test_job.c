/* test_job.c - the whole job and the survey's report, on a survey of nine small images of a coloured wall. */
#include "test.h"

oxl_result job_test_image(const char *path, int view)
{
    oxl_image image = {0};
    oxl_result rc = oxl_image_create(test_ctx, JOB_WIDTH, JOB_HEIGHT, &image);
    if (rc != OXL_OK) return rc;
    for (int i = 0; i < JOB_WIDTH * JOB_HEIGHT; i++) {
        image.rgb[i] = (float)(i % JOB_WIDTH) / JOB_WIDTH;
        image.rgb[i + JOB_WIDTH * JOB_HEIGHT] = (float)i / (JOB_WIDTH * JOB_HEIGHT);
        image.rgb[i + 2 * JOB_WIDTH * JOB_HEIGHT] = 0.1f * (float)view;
    }
    rc = oxl_image_write(test_ctx, path, &image);
    oxl_image_free(test_ctx, &image);
    return rc;
}

/* Writes the survey into the test's folder and returns its path. Cameras stand in a row and look at a wall at
 * z = 4, with six rows of points. */
const char *job_test_survey_of(int count)
{
    const int across = count / 6;
    OWNED_TEXT images = test_text(), points = test_text();
    test_write("survey/images/.keep", "");
    for (int i = 0; i < JOB_VIEWS; i++) {
        CHECK_OK(job_test_image(test_path("survey/images/%d.png", i), i));
        text_add(&images, "%d 1 0 0 0 %.3f 0 0 1 %d.png\n24 16 %d\n", i + 1, -0.1 * i, i, i + 1);
    }
    for (int i = 0; i < count; i++)
        text_add(&points, "%d %.3f %.3f 4 %d 120 60 0.5 1 0 2 0\n", i + 1, -2 + 5.0 * (i % across) / across,
                 -1.25 + 0.5 * (i / across), 240 * i / count);
    test_write_colmap("survey/sparse/0", "1 PINHOLE 48 32 40 40 24 16\n", images.data, points.data);
    return test_path("survey");
}

const char *job_test_survey(void)
{
    return job_test_survey_of(60);
}

oxl_job_options job_test_options(void)
{
    oxl_job_options options = oxl_job_options_default(OXL_PRESET_DRAFT);
    options.train.iterations = 12;
    return options;
}

int job_test_has(const char *file, const char *words)
{
    if (!test_has(file)) return 0;
    OWNED_FILE map = test_file(file);
    return strstr(map.data, words) != NULL;
}

/* The first `from` in a file becomes `to`. */
void job_test_replace(const char *file, const char *from, const char *to)
{
    OWNED_TEXT t = test_text();
    OWNED_FILE map = test_file(file);
    const char *at = strstr(map.data, from);
    CHECK(at != NULL);
    text_add(&t, "%.*s%s%s", (int)(at - map.data), map.data, to, at + strlen(from));
    test_write_bytes(file, t.data, t.size);
}

int job_test_progress(void *user, const oxl_progress *p)
{
    struct job_test_watch *w = user;
    w->calls++;
    return p->iteration == w->stop_at;
}

oxl_result job_test_watched(const char *out, const oxl_job_options *options, struct job_test_watch *watch)
{
    const oxl_callback callback = {job_test_progress, watch};
    if (!os_is_folder(test_path("survey"))) job_test_survey();
    return oxl_job_run(test_ctx, test_path("survey"), test_path(out), options, watch ? &callback : NULL);
}

oxl_result job_test_run(const char *out, const oxl_job_options *options)
{
    return job_test_watched(out, options, NULL);
}

void job_test_done(const char *out, const oxl_job_options *options)
{
    CHECK_OK(job_test_run(out, options));
}

/* Of the training views the one nearest to their centre, whatever the block or the run was before. */
TEST(job_begins_viewers_at_a_training_view)
{
    const oxl_job_options options = job_test_options();
    const char *survey = job_test_survey();
    oxl_scene_options load = oxl_scene_options_default();
    int same = 0;
    job_test_done("out", &options);
    OWNED_MODEL model = test_read_model("out/scene.ply");
    load.test_every = 8;
    OWNED_SCENE *scene = test_load(survey, &load);
    for (int v = 0; scene && v < oxl_scene_view_count(scene); v++) {
        const oxl_camera *c = &oxl_scene_view(scene, v)->camera;
        double away = fabs(model.view[0] - c->fx / OXL_MAX(c->width, c->height));
        for (int i = 0; i < 3; i++) {
            double x = c->translation[i];
            for (int k = 0; k < 3; k++)
                x += c->rotation[3 * i + k] * (model.view[10 + k] - oxl_scene_origin(scene)[k]);
            away = fmax(away, fabs(x));
            for (int k = 0; k < 3; k++)
                away = fmax(away, fabs(model.view[1 + 3 * i + k] - c->rotation[3 * i + k]));
        }
        same += away < 1e-6 && !oxl_scene_view(scene, v)->is_test;
    }
    CHECK(same == 1);
}

TEST(job_writes_model_metrics_log_renders_and_last_run_json)
{
    const oxl_job_options options = job_test_options();
    job_test_done("out", &options);
    CHECK(test_has("out/scene.ply"));
    CHECK_IN("out/metrics.json", "\"split\": \"test\"");
    CHECK_IN("out/metrics.json", "\"peak_rss_bytes\": ");
    CHECK_IN("out/metrics.json", "\"psnr\": ");
    CHECK_IN("out/blocks/000/log.csv", "iteration,loss,psnr,gaussians,seconds,peak_rss_bytes\n1,");
    CHECK_IN("out/blocks/000/log.csv", "\n12,");
    CHECK_IN("out/run.json", "\"finished\": true");
    CHECK(test_has("out/renders/0.png.png"));
    CHECK(test_has("out/renders/0.png.image.png") && !test_has("out/renders/0.png.clear.png"));
    CHECK(!test_has("out/renders/1.png.png"));
}

TEST(job_log_holds_no_iteration_twice)
{
    oxl_job_options options = job_test_options();
    int last = 0;
    options.train.iterations = 400;
    job_test_done("out", &options);
    OWNED_FILE map = test_file("out/blocks/000/log.csv");
    for (const char *at = strchr(map.data, '\n'); at && at[1]; at = strchr(at + 1, '\n')) {
        CHECK(atoi(at + 1) > last);
        last = atoi(at + 1);
    }
    CHECK(last == 400);
}

TEST(job_that_is_finished_is_not_done_again_but_another_is)
{
    oxl_job_options options = job_test_options();
    struct job_test_watch watch = {0, -1};
    CHECK_OK(job_test_watched("out", &options, &watch));
    CHECK(watch.calls == 12);
    options.preset = "a name changes nothing";
    CHECK_OK(job_test_watched("out", &options, &watch));
    CHECK(watch.calls == 12);
    options.train.lr_scale *= 2;
    CHECK_ERROR(job_test_watched("out", &options, &watch), OXL_ERR_USAGE,
                "holds the finished result of a run with other options");
    CHECK(watch.calls == 12);
    options.restart = 1;
    for (int again = 2; again < 4; again++) {
        CHECK_OK(job_test_watched("out", &options, &watch));
        CHECK(watch.calls == 12 * again);
    }
    test_ctx->options.seed = 7;
    CHECK_OK(job_test_watched("out", &options, &watch));
    CHECK(watch.calls == 48);
}

TEST(job_that_is_stopped_keeps_its_model_and_does_not_count_as_finished)
{
    oxl_job_options options = job_test_options();
    struct job_test_watch watch = {0, 5};
    job_test_done("out", &options);
    test_ctx->options.seed = 2; /* another job in the same folder */
    options.restart = 1;
    CHECK(job_test_watched("out", &options, &watch) == OXL_ERR_INTERRUPTED && watch.calls == 5);
    OWNED_MODEL model = test_read_model("out/scene.ply");
    CHECK(model.count >= 60);
    CHECK_IN("out/run.json", "\"finished\": false");
    CHECK(!test_has("out/metrics.json"));
    watch = (struct job_test_watch){0, -1};
    options.restart = 0;
    CHECK_OK(job_test_watched("out", &options, &watch));
    CHECK(watch.calls == 1 + 12 - 5); /* where it stood, and what was left */
}

/* ---------------- resumed, and in blocks */

static int job_test_same(const char *a, const char *b)
{
    OWNED_FILE x = test_file(a);
    OWNED_FILE y = test_file(b);
    return x.size == y.size && x.size > 0 && !memcmp(x.data, y.data, x.size);
}

/* Nine views and 60 points make two blocks or more when a block may hold 40. */
static oxl_job_options job_test_blocks(void)
{
    oxl_job_options options = job_test_options();
    options.partition.block_points = 40;
    options.renders = 0;
    options.train.stereo = 0; /* The points are those of the survey. */
    return options;
}

TEST(job_by_blocks_gives_the_same_bytes_in_one_process_and_in_many)
{
    oxl_job_options options = job_test_blocks();
    job_test_done("whole", &options);
    CHECK(test_has("whole/blocks/001/model.ply"));
    for (options.block = 1; options.block >= 0; options.block--) job_test_done("parts", &options);
    CHECK(!test_has("parts/scene.ply"));
    job_test_done("parts", &options);
    CHECK(job_test_same("whole/scene.ply", "parts/scene.ply"));
    CHECK_IN("parts/run.json", "\"finished\": true");
    CHECK_IN("parts/metrics.json", "\"blocks\": 2");
}

static double job_test_psnr(const char *model_path)
{
    OWNED_MODEL model = test_read_model(model_path);
    OWNED_SCENE *scene = test_load("survey", NULL);
    oxl_model_move_origin(&model, oxl_scene_origin(scene));
    return test_evaluate(&model, scene, &test_imaging, OXL_SPLIT_TRAIN).psnr;
}

TEST(job_options_that_cannot_be_are_refused_before_anything_is_written)
{
    oxl_job_options options = job_test_options();
    options.train.coarse = 2;
    CHECK(job_test_run("out", &options) == OXL_ERR_USAGE && !test_has("out/run.json"));
}

TEST(job_in_blocks_is_about_as_good_as_in_one_for_the_same_work)
{
    oxl_job_options options = job_test_blocks(), one = job_test_options();
    one.renders = 0;
    one.train.iterations = options.train.iterations = 240;
    job_test_done("one", &one);
    job_test_done("out", &options);
    CHECK_IN("out/metrics.json", "\"iterations\": 240,");
    CHECK(job_test_psnr("out/scene.ply") > job_test_psnr("one/scene.ply") - 2);
    CHECK(!test_has("out/blocks/000/checkpoint.oxl") && !os_is_folder(test_path("out/blocks/decoded")));
}

TEST(job_in_blocks_lets_the_merged_model_grow_to_what_its_blocks_have_left_of_the_number_allowed)
{
    oxl_job_options options = job_test_blocks();
    size_t blocks = 0;
    OWNED_MODEL model = {0};
    options.train.iterations = 40;
    options.train.densify_every = 1 << 20; /* none in a block */
    options.train.densify_gradient = 1e-12f;
    options.train.max_gaussians = 67;
    job_test_done("out", &options);
    for (int b = 0; b < 2; b++) {
        model = test_read_model(PATH(test_path("out"), "blocks/%03d/model.ply", b));
        blocks += model.count;
        oxl_model_free(test_ctx, &model);
    }
    model = test_read_model("out/scene.ply");
    CHECK(blocks <= 60 && model.count > blocks && model.count <= 67);
}

TEST(job_reads_decoded_images_from_files_and_ends_in_the_same_bytes)
{
    oxl_job_options options = job_test_options();
    options.scene.image_cache_bytes = 1; /* memory holds one: files hold the rest */
    job_test_done("small", &options);
    options.scene.image_cache_bytes = 1 << 30;
    job_test_done("large", &options);
    CHECK(job_test_same("small/scene.ply", "large/scene.ply"));
}

TEST(job_in_blocks_that_is_stopped_anywhere_ends_in_the_same_bytes)
{
    oxl_job_options options = job_test_blocks();
    const int stops[] = {1, 3, 9, 14};
    options.train.iterations = 40;
    /* a block begins with the coarse model's gains, not with those that the one before has left */
    options.train.exposure = OXL_ON;
    job_test_done("whole", &options);
    for (size_t i = 0; i < sizeof stops / sizeof *stops; i++) {
        struct job_test_watch watch = {0, stops[i]};
        char out[32], scene[48];
        snprintf(out, sizeof out, "stop%d", stops[i]);
        snprintf(scene, sizeof scene, "%s/scene.ply", out);
        CHECK(job_test_watched(out, &options, &watch) == OXL_ERR_INTERRUPTED && !test_has(scene));
        job_test_done(out, &options);
        CHECK(job_test_same("whole/scene.ply", scene));
    }
}

TEST(job_in_blocks_of_a_wholly_black_survey_ends_with_a_model)
{
    oxl_job_options options = job_test_blocks();
    job_test_survey();
    options.train.iterations = 200;
    OWNED_IMAGE black = test_image(JOB_WIDTH, JOB_HEIGHT);
    for (int i = 0; i < JOB_VIEWS; i++) {
        test_write_image(test_path("survey/images/%d.png", i), &black);
    }
    job_test_done("out", &options);
    CHECK(test_has("out/scene.ply"));
    CHECK_IN("out/blocks/000/block.json", "\"iterations_done\": 0,"); /* no view shows it: not trained */
}

/* Leaves in `out` a run with these options that was stopped after five steps. */
static void job_test_stopped(const oxl_job_options *options)
{
    struct job_test_watch watch = {0, 5};
    CHECK(job_test_watched("out", options, &watch) == OXL_ERR_INTERRUPTED);
}

/* Memory that an earlier process of the run has found is kept, whatever the machine has. */
TEST(job_in_blocks_grows_to_what_memory_holds_of_the_merged_model)
{
    oxl_job_options options = job_test_blocks();
    char memory[40];
    options.train.iterations = 120;
    options.train.densify_gradient = 1e-12f;
    options.train.max_gaussians = 400;
    job_test_survey();
    OWNED_SCENE *scene = test_load("survey", &options.scene);
    struct cost_load load = cost_load_of_scene(scene);
    oxl_job_options limited = options;
    for (limited.ram = (size_t)1e7; budget_max_gaussians(&load, &limited) < 150;) limited.ram += 1000;
    job_test_stopped(&options);
    snprintf(memory, sizeof memory, "\"memory\": %zu", limited.ram);
    job_test_replace("out/run.json", "\"memory\": 0", memory);
    job_test_done("out", &options);
    OWNED_MODEL model = test_read_model("out/blocks/whole/model.ply");
    CHECK(model.count > 100 && model.count <= 150);
}

static double job_test_figure(const char *out, const char *name)
{
    OWNED_FILE json = test_file(test_path("%s/metrics.json", out));
    return oxl_json_number(json.data, name);
}

/* Of a run with gains alone: scene.ply shows the held-out views without imaging.txt, and metrics.json says how
 * well. Returns how much better it does so than scene_clear.ply, dB. */
static double job_test_shows_viewers(const char *out)
{
    char scene[64], clear[64];
    snprintf(scene, sizeof scene, "%s/scene.ply", out);
    snprintf(clear, sizeof clear, "%s/scene_clear.ply", out);
    CHECK(test_has(clear) && os_is_file(test_path("%s/imaging.txt", out)));
    oxl_metrics plain = job_test_evaluate(scene, 0);
    CHECK(job_test_evaluate(scene, 1).psnr == plain.psnr);
    OWNED_FILE json = test_file(test_path("%s/metrics.json", out));
    const char *standard = oxl_json_member(json.data, "standard");
    CHECK_CLOSE(oxl_json_number(json.data, "psnr"), job_test_evaluate(clear, 1).psnr, 1e-9);
    CHECK_CLOSE(oxl_json_number(json.data, "plain_psnr"), plain.psnr, 1e-9);
    CHECK_CLOSE(oxl_json_number(standard, "psnr"), plain.psnr, 1e-9);
    CHECK_CLOSE(oxl_json_number(standard, "ssim"), plain.ssim, 1e-9);
    return plain.psnr - job_test_evaluate(clear, 0).psnr;
}

/* Stops once in the model for viewers, which follows the steps of the merged model. */
static int job_test_stop_viewers(void *user, const oxl_progress *p)
{
    int *left = user;
    return p->stage == OXL_STAGE_MERGED && p->iteration > 42 && --*left == 0;
}

static oxl_job_options job_test_gains_in_blocks(void)
{
    oxl_job_options options = job_test_blocks();
    options.train.iterations = 120; /* 42 of the merged model, 18 of that for viewers */
    options.train.densify_every = 50;
    options.train.exposure = OXL_ON;
    options.train.lamp = options.train.medium = OXL_OFF;
    options.renders = 0;
    return options;
}

struct job_test_left {
    int steps;               /* of the run, or of the merged model, before those for viewers */
    double end, least, last; /* s left at its last step, and least and last of those for viewers */
    double seconds;
    int falls; /* reports with fewer seconds than the one before */
};

static int job_test_note_left(void *user, const oxl_progress *p)
{
    struct job_test_left *l = user;
    if (p->blocks > 1 && p->stage != OXL_STAGE_MERGED) return 0;
    if (p->iteration == l->steps) l->end = p->seconds_left;
    if (p->iteration > l->steps) l->least = OXL_MIN(l->least, l->last = p->seconds_left);
    l->falls += p->seconds < l->seconds;
    l->seconds = p->seconds;
    return 0;
}

TEST(job_with_a_model_for_viewers_says_the_time_left_until_it_and_the_evaluation_end)
{
    NEEDS_PART(exposure);
    oxl_job_options options = job_test_gains_in_blocks();
    for (int blocks = 1; blocks < 3; blocks++) {
        struct job_test_left l = {.steps = blocks == 1 ? 120 : 42, .least = 1e9};
        const oxl_callback callback = {job_test_note_left, &l};
        options.partition = blocks == 1 ? job_test_options().partition : job_test_blocks().partition;
        CHECK_OK(oxl_job_run(test_ctx, job_test_survey(), test_path(blocks == 1 ? "one" : "two"), &options,
                             &callback));
        CHECK(l.end > 1e-4 && (blocks == 1 ? l.least > 0 && l.falls == 0 : l.last < 1e-6));
    }
}

TEST(job_in_blocks_with_gains_alone_writes_a_model_for_viewers_and_resumes_it)
{
    NEEDS_PART(exposure);
    const oxl_job_options options = job_test_gains_in_blocks();
    int left = 5;
    const oxl_callback stop = {job_test_stop_viewers, &left};
    job_test_done("whole", &options);
    CHECK(job_test_shows_viewers("whole") > 0.01);
    CHECK(oxl_job_run(test_ctx, test_path("survey"), test_path("stopped"), &options, &stop) ==
          OXL_ERR_INTERRUPTED);
    CHECK(left == 0);
    job_test_done("stopped", &options);
    CHECK(job_test_same("whole/scene.ply", "stopped/scene.ply"));
    CHECK(job_test_same("whole/scene_clear.ply", "stopped/scene_clear.ply"));
}

TEST(job_does_not_overwrite_the_unfinished_work_of_other_options)
{
    oxl_job_options options = job_test_options();
    job_test_stopped(&options);
    options.train.iterations++;
    CHECK_ERROR(job_test_run("out", &options), OXL_ERR_USAGE, "--restart");
    CHECK_SAYS("survey:\n  iterations: 12 there, 13 here\nfix: "); /* and nothing else */
    CHECK(test_has("out/blocks/000/checkpoint.oxl"));
    options.restart = 1;
    job_test_done("out", &options);
    CHECK_IN("out/run.json", "\"iterations_done\": 13");
}

TEST(job_knows_a_survey_that_was_moved_and_does_not_overwrite_the_finished_model_of_another)
{
    oxl_job_options options = job_test_options();
    struct job_test_watch watch = {0, -1};
    const oxl_callback callback = {job_test_progress, &watch};
    job_test_done("out", &options);
    CHECK(rename(test_path("survey"), test_path("moved")) == 0);
    CHECK_OK(oxl_job_run(test_ctx, test_path("moved"), test_path("out"), &options, &callback));
    CHECK(watch.calls == 0);
    job_test_survey_of(30);
    CHECK_ERROR(job_test_run("out", &options), OXL_ERR_USAGE,
                "holds the finished result of a run with other options or of another survey");
}

TEST(job_keeps_what_the_log_said_also_over_an_interruption)
{
    const oxl_job_options options = job_test_options();
    struct job_test_watch watch = {0, 5};
    CHECK(job_test_watched("out", &options, &watch) == OXL_ERR_INTERRUPTED);
    job_test_done("out", &options);
    CHECK_IN("out/run.json", "{\"level\": \"info\", \"text\": \"images ");
    CHECK_IN("out/run.json", "{\"level\": \"info\", \"text\": \"iterations ");
    CHECK(!job_test_has("out/run.json", "resumed after iteration"));
    CHECK_IN("out/blocks/000/block.json", "{\"level\": \"info\", \"text\": \"resumed after iteration 5\"}");
}

static int job_test_delete(void *user, const oxl_progress *p)
{
    char command[300];
    (void)user;
    snprintf(command, sizeof command, "rm -rf '%s'", test_path("out"));
    return p->iteration == p->iterations ? system(command) : 0;
}

TEST(job_whose_folder_is_deleted_before_its_last_step_ends_with_its_model)
{
    const oxl_job_options options = job_test_options();
    const oxl_callback callback = {job_test_delete, NULL};
    CHECK_OK(oxl_job_run(test_ctx, job_test_survey(), test_path("out"), &options, &callback));
    CHECK(test_has("out/scene.ply") && test_has("out/blocks/000/model.ply"));
}

TEST(job_resume_finds_the_options_that_a_run_was_given)
{
    oxl_job_options given = job_test_options(), found = oxl_job_options_default(OXL_PRESET_PAPER);
    const char *survey = job_test_survey();
    oxl_manifest *run = NULL;
    given.scene.max_side = 40;
    given.train.lr_sh = 1e-3f;
    given.seed = 77;
    given.scene.images = test_path("survey/images");
    job_test_done("out", &given);
    CHECK_OK(oxl_job_resume(test_ctx, survey, test_path("out"), &found, &run));
    CHECK(found.train.iterations == 12 && found.scene.max_side == 40 && found.train.lr_sh == 1e-3f &&
          found.seed == 77);
    CHECK_TEXT(found.scene.images ? found.scene.images : "", "survey/images");
    CHECK_TEXT(found.preset ? found.preset : "", "draft");
    oxl_manifest_free(test_ctx, &run);
    CHECK_OK(oxl_job_resume(test_ctx, "another survey", test_path("out"), &given, &run));
    CHECK(given.train.iterations == 12);
    oxl_manifest_free(test_ctx, &run);
}

TEST(job_without_held_out_views_evaluates_training_views_and_says_so)
{
    oxl_job_options options = job_test_options();
    options.scene.test_every = 0;
    options.renders = 0;
    job_test_done("out", &options);
    CHECK_IN("out/metrics.json", "\"split\": \"train\"");
    CHECK_IN("out/metrics.json", "\"training\": {\"count\": 9, \"of\": 9, "); /* not 6 */
    CHECK(!os_is_folder(test_path("out/renders")));
}

TEST(job_renders_stay_inside_their_folder)
{
    static const char *const names[][2] = {{"../dive/a.jpg", "images/.._dive_a.jpg.png"},
                                           {"dive/a.jpg", "images/dive/a.jpg.png"}};
    for (int i = 0; i < 2; i++) {
        OWNED_MEMORY char *path = NULL;
        CHECK_OK(oxl_render_path(test_ctx, test_path("images"), names[i][0], ".png", &path));
        CHECK(strcmp(path, test_path(names[i][1])) == 0);
    }
}

/* With four threads, which write a view's files side by side: a folder stands where one of the second view's is
 * to be. */
TEST(renders_that_cannot_be_written_are_named_and_those_before_counted)
{
    const oxl_render_output what = {.split = OXL_SPLIT_ALL, .images = 1};
    const oxl_point point = {.position = {0, 0, 4}};
    const int threads = test_ctx->threads;
    OWNED_MODEL model = test_model_of(&point, 1, 0);
    int count = -1;
    OWNED_SCENE *scene = test_load(job_test_survey(), NULL);
    test_ctx->threads = 4;
    CHECK_OK(oxl_render_views(test_ctx, &model, scene, NULL, &what, test_path("drawn"), &count));
    CHECK(count == JOB_VIEWS && test_has("drawn/0.png.png") && test_has("drawn/8.png.image.png"));
    test_write("again/1.png.png/.keep", "");
    CHECK_ERROR(oxl_render_views(test_ctx, &model, scene, NULL, &what, test_path("again"), &count),
                OXL_ERR_IO, "again/1.png.png");
    CHECK(count == 1 && test_has("again/0.png.image.png") && !test_has("again/8.png.png"));
    test_ctx->threads = threads;
}

/* Rows from the bottom in the float map; grey is 1/2 at the mean depth. */
TEST(renders_of_depth_are_floats_in_the_unit_and_grey)
{
    static const char head[] = "Pf\n3 2\n";
    float depth[6] = {0, 1, 2, -1, 3, 2}, grey[18];
    render_depth_grey(depth, 6, 2, grey);
    CHECK(depth[1] == 2 && depth[3] == 0 && grey[0] == 0 && grey[2] == 0.5f && grey[6 + 4] == 0.4f);
    CHECK_OK(oxl_write_pfm(test_ctx, test_path("a.pfm"), depth, 3, 2));
    OWNED_FILE pfm = test_file("a.pfm");
    CHECK(pfm.size > sizeof depth && memcmp(pfm.data, head, strlen(head)) == 0);
    CHECK(!memcmp(pfm.data + pfm.size - sizeof depth, depth + 3, 3 * sizeof *depth));
    CHECK(!memcmp(pfm.data + pfm.size - 3 * sizeof *depth, depth, 3 * sizeof *depth));
}

TEST(survey_does_not_state_errors_that_its_files_do_not_know)
{
    oxl_survey s;
    char *json = NULL;
    const char *survey = job_test_survey();
    CHECK_OK(oxl_check(test_ctx, survey, NULL, 0, &s));
    CHECK_TEXT(s.text, "; reprojection error 0.50 px");
    test_write("survey/sparse/0/points3D.txt", "1 0 0 4 9 9 9 0 1 0 2 0\n2 1 0 4 9 9 9 0 1 1 2 1\n");
    CHECK_OK(oxl_check(test_ctx, survey, NULL, 0, &s));
    CHECK(!strstr(s.text, "reprojection"));
    CHECK_OK(oxl_survey_to_json(test_ctx, &s, &json));
    CHECK_TEXT(json, "\"mean_error\": null");
    oxl_text_free(test_ctx, json);
}

TEST(survey_counts_what_the_files_hold)
{
    oxl_survey s;
    char *json = NULL;
    CHECK_OK(oxl_check(test_ctx, job_test_survey(), NULL, 0, &s));
    CHECK(s.images == 9 && s.images_missing == 0 && s.test_views == 2 && s.train_views == 7);
    CHECK(s.cameras == 1 && s.cameras_distorted == 0 && s.width == 48 && s.height == 32 && s.points == 60);
    CHECK_CLOSE(s.mean_track, 2, 1e-12);
    CHECK_CLOSE(s.mean_error, 0.5, 1e-6);
    CHECK_CLOSE(s.bounds_max[2], 4, 1e-6);
    CHECK_TEXT(s.text, "9 in the model, 0 missing on disk; 7 for training, 2 held out");
    CHECK_TEXT(s.text, "PINHOLE 48 x 32");
    CHECK_TEXT(s.warnings, "only 60 points");
    CHECK_OK(oxl_survey_to_json(test_ctx, &s, &json));
    CHECK_TEXT(json, "\"train_views\": 7");
    oxl_text_free(test_ctx, json);
}

TEST(survey_predicts_that_more_takes_more)
{
    oxl_job_options options = job_test_options();
    oxl_survey less, more;
    const char *survey = job_test_survey();
    CHECK_OK(oxl_check(test_ctx, survey, &options, 0, &less));
    options.train.iterations *= 10000;
    CHECK_OK(oxl_check(test_ctx, survey, &options, 0, &more));
    /* of steps that were tried: a busy machine makes some many times as long */
    CHECK(more.seconds > less.seconds && less.seconds > 0);
    options.train.max_gaussians = 70;
    CHECK_OK(oxl_check(test_ctx, survey, &options, 0, &less));
    CHECK(less.gaussians == 70 && less.memory < more.memory);
    options.train.max_seconds = 1e-9;
    CHECK_OK(oxl_check(test_ctx, survey, &options, 0, &less));
    CHECK_CLOSE(less.seconds, 1e-9, 1e-12);
}

TEST(run_numbers_that_no_option_can_hold_are_not_taken)
{
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    const oxl_job_options plain = o;
    struct oxl_manifest run;
    test_write(
        "run.json",
        "{\n  \"job\": {\"cut\": 77, \"ucd\": -1, \"iterations\": 3e9, \"ram\": -1, \"keep\": nan, \"max_side\": 900}\n}\n");
    CHECK_OK(manifest_read(test_ctx, test_folder(), &run));
    manifest_options(&run, &o);
    CHECK(o.partition.cut == plain.partition.cut && o.train.ucd == plain.train.ucd && o.ram == plain.ram);
    CHECK(o.train.iterations == plain.train.iterations && o.train.keep.kind == plain.train.keep.kind &&
          o.scene.max_side == 900);
    manifest_free(test_ctx, &run);
}

TEST(job_leaves_out_images_that_cannot_be_read_and_counts_them)
{
    oxl_job_options options = job_test_options();
    job_test_survey();
    test_write("survey/images/4.png", "no image");
    test_write("survey/images/2.png", "nor this");
    test_make_folder("survey/masks");
    OWNED_IMAGE mask = test_image(8, 8);
    test_write_image("survey/masks/3.png", &mask); /* all of it black */
    job_test_done("out", &options);
    CHECK_IN("out/metrics.json", "\"images_left_out\": 3");
    CHECK_IN("out/metrics.json", "\"steps_skipped\": 0");
    CHECK_IN("out/blocks/000/block.json", "\"images_left_out\": 3");
    CHECK_IN("out/blocks/000/block.json", "the mask is all black at");
    CHECK(remove(test_path("out/run.json")) == 0 && remove(test_path("out/scene.ply")) == 0);
    job_test_done("out", &options);
    CHECK_IN("out/run.json", "trained without 3 images");
}

/* Reads tracks, then images for pruning; then there are no points, and images colour random ones. */
TEST(training_leaves_out_an_image_that_goes_after_loading)
{
    for (int k = 0; k < 6; k++) {
        oxl_job_options options = job_test_options();
        oxl_train_options *o = &options.train;
        oxl_trained trained = {.finished = 0};
        options.scene.image_cache_bytes = 1;
        o->exposure = o->medium = k < 2 ? OXL_AUTO : OXL_OFF;
        if (k / 2 == 1) o->keep = (oxl_keep){OXL_KEEP_FRACTION, 0.5};
        o->stereo = 0;
        OWNED_SCENE *scene = test_load(k < 4 ? job_test_survey() : job_test_survey_of(0), &options.scene);
        if (k % 2) CHECK(remove(test_path("survey/images/4.png")) == 0);
        else test_write("survey/images/4.png", "no image");
        CHECK_OK(oxl_train(test_ctx, scene, o, NULL, &trained));
        CHECK(trained.nonfinite.images == 1);
        oxl_trained_free(test_ctx, &trained);
    }
}

/* It used to start from every point, and each block had the whole number to itself. */
TEST(job_has_as_many_gaussians_as_were_asked_for_also_in_blocks)
{
    NEEDS_PART(prune);
    for (int k = 0; k < 4; k++) {
        oxl_job_options options = k < 2 ? job_test_options() : job_test_blocks();
        options.train.iterations = 40;
        options.restart = 1;
        if (k % 2) options.train.keep = (oxl_keep){OXL_KEEP_COUNT, 30};
        else options.train.max_gaussians = 30;
        job_test_done("out", &options);
        OWNED_MODEL model = test_read_model("out/scene.ply");
        CHECK(k < 2 ? model.count == 30 || (k == 0 && model.count < 30)
                    : model.count > 20 && model.count < 38);
    }
}

TEST(job_completes_when_a_held_out_image_cannot_be_read)
{
    oxl_job_options options = job_test_options();
    job_test_survey();
    test_write("survey/images/8.png", "no image");
    job_test_done("out", &options);
    CHECK_IN("out/metrics.json", "\"count\": 1");
    CHECK(test_has("out/renders/8.png.png") && !test_has("out/renders/8.png.image.png"));
    CHECK_IN("out/run.json", "\"finished\": true");
}

/* A model with second lobes is followed by a standard one, refined without them; a run that ended between the
 * two resumes there. */
TEST(job_writes_a_standard_model_beside_one_with_lobes)
{
    NEEDS_PART(lobes);
    NEEDS_PART(sh_degree);
    oxl_job_options options = job_test_options();
    options.train.dog = OXL_DOG_ALL;
    options.train.sh_degree = 1;
    job_test_done("out", &options);
    OWNED_MODEL model = test_read_model("out/scene.ply");
    OWNED_MODEL standard = test_read_model("out/scene_standard.ply");
    CHECK(model.lobes == model.count && model.sh_degree == 1);
    CHECK(standard.lobes == 0 && standard.count == model.count && standard.sh_degree == 3); /* 62 columns */
    CHECK(standard.plane[OXL_OPACITY][0] != model.plane[OXL_OPACITY][0]);
    CHECK(job_test_has("out/metrics.json", "\"psnr_lost\": ") && !test_has("out/blocks/000/checkpoint.oxl"));
    job_test_replace("out/blocks/000/block.json", "\"finished\": true", "\"finished\": false");
    job_test_replace("out/run.json", "\"finished\": true", "\"finished\": false");
    CHECK(os_remove(test_path("out/blocks/000/model_standard.ply")) == 0 &&
          rename(test_path("out/scene_standard.ply"), test_path("first.ply")) == 0);
    job_test_done("out", &options);
    CHECK(job_test_same("out/scene_standard.ply", "first.ply"));
}

/* Held-out views of the survey by a model of OUT, with the imaging.txt beside it or with none. */
oxl_metrics job_test_evaluate(const char *model, int imaging)
{
    oxl_scene_options o = oxl_scene_options_default();
    o.test_every = oxl_job_options_default(OXL_PRESET_DRAFT).scene.test_every;
    OWNED_SCENE *scene = test_load("survey", &o);
    OWNED_MODEL read = test_read_model(model);
    if (imaging) CHECK_OK(test_read_imaging(scene, test_path(model)));
    return test_evaluate(&read, scene, imaging ? &test_imaging : NULL, OXL_SPLIT_TEST);
}

/* scene.ply has learned what lamp and medium showed; scene_clear.ply has not, and shows it with
 * imaging.txt. */
TEST(job_with_lamp_and_medium_writes_a_model_for_viewers_and_one_for_imaging_txt_and_the_figures_of_both)
{
    NEEDS_PART(medium);
    NEEDS_PART(lamp);
    oxl_job_options options = job_test_options();
    oxl_metrics full, plain;
    options.train.lamp = options.train.medium = OXL_ON;
    options.train.dog = OXL_DOG_ALL;
    options.train.iterations = 60;
    photometry_test_make("survey", SYNTH_3C);
    job_test_done("out", &options);
    full = job_test_evaluate("out/scene_clear.ply", 1), plain = job_test_evaluate("out/scene.ply", 0);
    oxl_metrics gains = job_test_evaluate("out/scene.ply", 1);
    CHECK(full.psnr > 0 && fabs(full.psnr - plain.psnr) > 1e-6);
    CHECK_CLOSE(job_test_figure("out", "psnr"), full.psnr, 1e-9);
    CHECK_CLOSE(job_test_figure("out", "plain_psnr"), plain.psnr, 1e-9);
    CHECK_CLOSE(gains.plain_psnr, plain.psnr, 1e-9);
    for (int i = 0; i < 4; i++) { /* in whatever format, it has the medium in its colours */
        static const char *const names[] = {"out/scene_clear.ply", "out/scene.ply", "out/scene.spz",
                                            "out/scene_standard.splat"};
        oxl_scene_options o = oxl_scene_options_default();
        OWNED_SCENE *scene = test_load("survey", &o);
        CHECK_OK(test_read_imaging(scene, test_path(names[i])));
        CHECK(test_imaging.medium.on == (i == 0));
    }
    OWNED_FILE clear = test_file("out/scene_clear.ply");
    CHECK(job_test_figure("out", "bytes") == (double)clear.size);
    CHECK(test_has("out/renders/IMG_00000.png.clear.png"));
    CHECK(!job_test_same("out/renders/IMG_00000.png.clear.png", "out/renders/IMG_00000.png.png"));
}

/* Where the images differ by gains alone, scene.ply is trained on without them, and is read without them in whatever
 * format; scene_clear.ply has what the figures are of. */
TEST(job_with_gains_alone_writes_a_model_for_viewers_that_needs_none)
{
    NEEDS_PART(exposure);
    oxl_job_options options = job_test_options();
    options.train.exposure = OXL_ON;
    options.train.lamp = options.train.medium = OXL_OFF;
    options.train.iterations = 60;
    job_test_done("out", &options);
    CHECK(test_has("out/blocks/000/model_standard.ply") && job_test_shows_viewers("out") != 0);
    double plain = job_test_evaluate("out/scene.ply", 0).psnr;
    CHECK(os_remove(test_path("out/scene_clear.ply")) == 0); /* a model of before: it has none of the gains */
    CHECK(fabs(job_test_evaluate("out/scene.ply", 1).psnr - plain) > 1e-6);
}

/* A gain over the image is not in the model's colours: scene.ply is the model itself, by even light and at
 * mean exposure. */
TEST(job_with_a_lamp_and_no_medium_shows_even_light_in_scene_ply_and_refines_nothing)
{
    NEEDS_PART(sh_degree);
    NEEDS_PART(lamp);
    oxl_job_options options = job_test_options();
    double full, plain;
    options.train.lamp = OXL_ON;
    options.train.medium = OXL_OFF;
    options.train.sh_degree = 3;
    options.train.iterations = 60;
    job_test_done("out", &options);
    full = job_test_evaluate("out/scene.ply", 1).psnr, plain = job_test_evaluate("out/scene.ply", 0).psnr;
    CHECK(fabs(full - plain) > 1e-6);
    CHECK_CLOSE(job_test_figure("out", "psnr"), full, 1e-9);
    CHECK_CLOSE(job_test_figure("out", "plain_psnr"), plain, 1e-9);
    CHECK(!test_has("out/scene_clear.ply") && !test_has("out/scene_standard.ply"));
    CHECK(!test_has("out/blocks/000/model_standard.ply"));
}

TEST(job_says_in_run_json_what_was_decided_and_why)
{
    NEEDS_PART(ucd);
    oxl_job_options options = job_test_options();
    job_test_done("out", &options);
    CHECK_IN("out/run.json", "\"decisions\": {\"partition\": {\"chosen\": \"none\", ");
    CHECK_IN("out/run.json", "\"ucd\": {\"chosen\": \"off\", \"evidence\": \"no points are seen");
}

/* ---------------- from a model */

TEST(job_starts_from_a_model_of_any_format_and_notices_when_it_changes)
{
    static const char *const names[] = {"from.ply", "from.splat", "from.spz"};
    oxl_job_options options = job_test_options();
    struct job_test_watch watch = {0, 5};
    uint8_t keep[200];
    char from[512];
    job_test_survey();
    job_test_done("out", &options);
    OWNED_MODEL model = test_read_model("out/scene.ply");
    CHECK(model.count <= 200);
    oxl_model_move_origin(&model, (double[3]){0, 0, 0}); /* as another trainer's has it */
    for (size_t i = 0; i < model.count; i++) keep[i] = i < 30;
    model_keep_rows(&model, keep);
    for (size_t i = 0; i < OXL_COUNT(names); i++) test_write_model(names[i], &model);
    for (size_t i = 0; i < OXL_COUNT(names); i++) {
        snprintf(from, sizeof from, "%s", test_path(names[i]));
        options.from = from;
        options.restart = 1;
        job_test_done("other", &options);
        OWNED_MODEL found = test_read_model("other/scene.ply");
        CHECK(found.count >= 30 && found.count < 60); /* the points are 60 */
    }
    CHECK(job_test_watched("changed", &options, &watch) == OXL_ERR_INTERRUPTED);
    model.plane[OXL_OPACITY][0] += 1;
    test_write_model(options.from, &model);
    options.restart = 0;
    CHECK_ERROR(job_test_run("changed", &options), OXL_ERR_USAGE, "  start: \"");
    options.partition.block_points = 40;
    CHECK(job_test_run("cut", &options) == OXL_ERR_USAGE);
    for (int i = 0; i < oxl_option_count(); i++) { /* the table names this option, and no other */
        snprintf(from, sizeof from, "--%s needs a survey of one block", oxl_option_at(i)->name);
        CHECK((strstr(oxl_error_text(test_ctx), from) != NULL) ==
              ((oxl_option_at(i)->use & OXL_OPTION_ONE_BLOCK) != 0));
    }
}

/* ---------------- the library and the command */

/* With gains, with a medium and lamp, with second lobes, with none. */
TEST(job_of_one_block_writes_what_the_library_does_byte_for_byte)
{
    NEEDS_PART(medium);
    NEEDS_PART(lamp);
    NEEDS_PART(exposure);
    NEEDS_PART(lobes);
    job_test_survey();
    photometry_test_make("water", SYNTH_3C);
    for (int k = 0; k < 4; k++) {
        const char *const survey = k == 1 ? "water" : "survey";
        oxl_job_options options = job_test_options();
        oxl_train_options *o = &options.train;
        oxl_trained trained = {.finished = 0};
        options.restart = 1, options.seed = 0;
        o->iterations = 60;
        o->exposure = k == 0 ? OXL_ON : OXL_OFF, o->medium = k == 1 ? OXL_ON : OXL_OFF, o->lamp = o->medium;
        o->dog = k == 2 ? OXL_DOG_ALL : OXL_DOG_OFF;
        CHECK_OK(oxl_job_run(test_ctx, test_path(survey), test_path("command"), &options, NULL));
        OWNED_SCENE *scene = test_load(survey, &options.scene);
        CHECK_OK(oxl_train(test_ctx, scene, o, NULL, &trained));
        CHECK(trained.finished && trained.iterations == 60 && (trained.viewer.count > 0) == (k < 3));
        test_make_folder("library");
        CHECK_OK(oxl_trained_write(test_ctx, test_path("library"), scene, &trained));
        for (int f = 0; f < 4; f++) {
            static const char *const files[] = {"scene.ply", "scene_clear.ply", "scene_standard.ply",
                                                "imaging.txt"};
            char one[64], other[64];
            snprintf(one, sizeof one, "library/%s", files[f]);
            snprintf(other, sizeof other, "command/%s", files[f]);
            CHECK(test_has(one) == test_has(other) && (!test_has(one) || job_test_same(one, other)));
        }
        oxl_trained_free(test_ctx, &trained);
    }
}

/* Waits at the last step of the first run until the time is over. */
static int job_test_wait(void *user, const oxl_progress *p)
{
    const double *until = user;
    while (p->iteration == 40 && os_seconds() < *until) continue;
    return 0;
}

TEST(time_limit_is_that_of_both_runs_of_a_training)
{
    NEEDS_PART(exposure);
    oxl_train_options o = job_test_options().train;
    double until;
    const oxl_callback callback = {job_test_wait, &until};
    oxl_trained t = {.finished = 1};
    OWNED_SCENE *scene = test_load(job_test_survey(), NULL);
    o.iterations = 40, o.exposure = OXL_ON, o.max_seconds = 1;
    until = os_seconds() + 1.1;
    CHECK_OK(oxl_train(test_ctx, scene, &o, &callback, &t));
    CHECK(!t.finished && t.model.count > 0 && t.viewer.count == 0);
    oxl_trained_free(test_ctx, &t);
}

TEST(job_evaluates_what_the_library_renders)
{
    NEEDS_PART(exposure);
    oxl_job_options options = job_test_options();
    oxl_trained t = {.finished = 0};
    oxl_metrics m;
    options.train.iterations = 60, options.train.exposure = options.train.lamp = OXL_ON;
    OWNED_SCENE *scene = test_load(job_test_survey(), &options.scene);
    CHECK_OK(oxl_train(test_ctx, scene, &options.train, NULL, &t));
    CHECK_OK(oxl_evaluate(test_ctx, &t.model, scene, t.imaging, OXL_SPLIT_ALL, &m));
    CHECK(m.count == JOB_VIEWS);
    for (int i = 0; i < m.count; i++) {
        OWNED_IMAGE rendered = {0}, image = {0};
        double psnr;
        CHECK_OK(oxl_render_view(test_ctx, &t.model, scene, m.views[i].view, t.imaging, &rendered, NULL));
        CHECK_OK(oxl_scene_image(test_ctx, scene, m.views[i].view, NULL, &image));
        CHECK_OK(oxl_psnr(test_ctx, &rendered, &image, &psnr));
        CHECK(psnr == m.views[i].psnr);
    }
    oxl_metrics_free(test_ctx, &m);
    oxl_trained_free(test_ctx, &t);
}

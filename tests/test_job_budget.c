/* test_job_budget.c - --ram: what gives way, in which order, and what is refused. */
#include "test.h"

static struct cost_load budget_test_load(void)
{
    return (struct cost_load){.points = 20000,
                              .observations = 100000,
                              .views = 50,
                              .pixels = 50e6,
                              .schedule_pixels = 45e6,
                              .largest = 1e6};
}

static oxl_job_options budget_test_options(double ram)
{
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    o.train.iterations = 3000;
    o.ram = (size_t)ram;
    o.train.sh_degree = -1; /* as in the preset, also where no part of the build reads it */
    return o;
}

TEST(budget_without_ram_changes_nothing)
{
    const struct cost_load load = budget_test_load();
    oxl_job_options o = budget_test_options(0), before = o;
    CHECK(budget_fit(&load, &o) && o.train.max_gaussians == before.train.max_gaussians);
    CHECK(o.train.sh_degree == before.train.sh_degree &&
          o.scene.image_cache_bytes == before.scene.image_cache_bytes);
}

/* Memory for all Gaussians of a run with SH degree 3. */
static double budget_test_degree_3(const oxl_job_options *o, const struct cost_load *load, int gaussians)
{
    oxl_job_options of = *o;
    of.train.sh_degree = 3;
    of.train.dog = OXL_DOG_OFF;
    return cost_memory(&of, load, gaussians);
}

TEST(budget_takes_the_cache_then_the_sh_degree_then_gaussians)
{
    NEEDS_PART(sh_degree);
    const struct cost_load load = budget_test_load();
    const oxl_job_options free = budget_test_options(0);
    oxl_job_options o = budget_test_options(20e9);
    const double most = cost_gaussians(&o, &load); /* that are expected */
    const int cap = (int)schedule_gaussian_cap_of(load.points, load.schedule_pixels, &free.train);
    const int wanted = (int)OXL_MIN(1.5 * most, cap); /* with room for so many nothing gives way */
    int seen[5] = {0};                                /* by SH degree from -1, undecided */
    CHECK(budget_fit(&load, &o) && o.train.sh_degree == -1 && o.scene.image_cache_bytes == (size_t)1 << 30);
    CHECK(o.train.max_gaussians == cap);
    o = budget_test_options(3e9);
    CHECK(budget_fit(&load, &o) && o.train.sh_degree == -1 && o.scene.image_cache_bytes == (size_t)3e8);
    CHECK(o.train.max_gaussians >= most);
    for (double ram = 2e9; ram > 2e8; ram *= 0.9) {
        o = budget_test_options(ram);
        if (!budget_fit(&load, &o)) continue;
        CHECK(cost_memory(&o, &load, o.train.max_gaussians) <= 0.9 * ram);
        seen[1 + o.train.sh_degree]++;
        CHECK((o.train.sh_degree == 1) == (budget_test_degree_3(&o, &load, wanted) > 0.9 * ram));
    }
    CHECK(seen[1 - 1] && seen[1 + 1]);
    o = budget_test_options(5e8);
    o.train.sh_degree = 2;
    CHECK(budget_fit(&load, &o) && o.train.sh_degree == 2); /* as asked */
}

TEST(budget_refuses_what_cannot_fit_and_names_a_flag_that_would)
{
    const struct cost_load load = budget_test_load();
    oxl_job_options o = budget_test_options(1e8);
    double mb = 0;
    CHECK(!budget_fit(&load, &o) && budget_refuse(test_ctx, &load, &o) == OXL_ERR_BUDGET);
    const char *fix = strstr(oxl_error_text(test_ctx), "--ram ");
    CHECK(fix != NULL);
    if (fix) mb = atof(fix + 6);
    oxl_job_options enough = budget_test_options(mb * 1048576);
    CHECK(budget_fit(&load, &enough));
    CHECK_SAYS("100 MB are too little");
}

TEST(budget_of_a_job_is_kept_and_one_too_small_is_refused_at_once)
{
    oxl_job_options options = job_test_options();
    options.ram = 3 << 20;
    CHECK(job_test_run("out", &options) == OXL_ERR_BUDGET);
    CHECK(!test_has("out/scene.ply") && strstr(oxl_error_text(test_ctx), "fix: --ram ") != NULL);
    options.ram = (size_t)2 << 30;
    job_test_done("out", &options);
    CHECK_IN("out/metrics.json", "\"peak_rss_bytes\": ");
}

TEST(budget_of_steps_grows_with_many_images_and_is_limited_with_few_unless_iterations_are_given)
{
    const oxl_option *iterations = oxl_option_find("iterations");
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    CHECK(cost_iterations(&o, 170) == 1200 && cost_iterations(&o, 340) == 2400);
    CHECK(cost_iterations(&o, 2) == 1200 && cost_iterations(&o, 1) == 700 && cost_iterations(&o, 0) == 700);
    CHECK_OK(oxl_option_set(iterations, &o, "2000", NULL, 0));
    CHECK(cost_iterations(&o, 340) == 2000 && cost_iterations(&o, 2) == 2000);
    o = oxl_job_options_default(OXL_PRESET_PAPER);
    CHECK(cost_iterations(&o, 2239) == 40000 && cost_iterations(&o, 5600) == 80000 &&
          cost_iterations(&o, 18) == 12600);
}

TEST(budget_of_steps_of_a_large_survey_is_kept_in_run_json_and_its_run_is_found_finished)
{
    struct job_test_watch watch = {0, -1};
    oxl_job_options options = job_test_options();
    options.iterations_for = 3; /* of 9 images */
    job_test_done("out", &options);
    CHECK_IN("out/run.json", "\"iterations\": 36,");
    CHECK_IN("out/blocks/000/log.csv", "\n36,");
    CHECK_OK(job_test_watched("out", &options, &watch));
    CHECK(watch.calls == 0);
    options.block = 0;
    options.partition.blocks = 2;
    job_test_done("parts", &options);
    options.block = 1; /* reads run.json, not the survey */
    job_test_done("parts", &options);
    options.block = -1;
    job_test_done("parts", &options);
    CHECK_IN("parts/metrics.json", "\"iterations\": 36,");
}

TEST(budget_cuts_into_blocks_that_are_predicted_to_fit)
{
    oxl_job_options options = job_test_options();
    OWNED_PARTITION p = {0};
    options.train.max_gaussians = 300000;
    options.train.iterations = 3000;
    job_test_survey_of(30000);
    OWNED_SCENE *scene = test_load("survey", &options.scene);
    struct cost_load load = cost_load_of_scene(scene);
    /* not less than the tests hold, which is more with a sanitizer */
    options.ram = (size_t)OXL_MAX(0.9 * cost_memory(&options, &load, cost_gaussians(&options, &load)),
                                  1.5 * (double)os_peak_rss());
    CHECK_OK(budget_partition(test_ctx, scene, &options, NAN, &p));
    for (int k = 0; k < p.block_count; k++) {
        oxl_job_options fitted = options;
        load = cost_load_of_block(&p, k);
        CHECK(budget_fit(&load, &fitted));
        CHECK(cost_memory(&fitted, &load, cost_gaussians(&fitted, &load)) <= (double)options.ram);
    }
}

TEST(budget_counts_of_lamp_and_medium_the_depths_of_tracks_alone)
{
    NEEDS_PART(track_depth);
    NEEDS_PART(exposure); /* by which a run has a model for viewers, too */
    struct cost_load load = budget_test_load();
    oxl_job_options o = budget_test_options(4e8);
    o.train.sh_degree = 3;
    o.train.lamp = o.train.medium = OXL_AUTO;
    oxl_job_options off = o;
    off.train.lamp = off.train.medium = OXL_OFF;
    /* 1024 of a view */
    CHECK_CLOSE(cost_memory(&o, &load, 1e5) - cost_memory(&off, &load, 1e5), 51200 * 12 + 50 * 16, 1);
}

TEST(budget_thins_a_model_that_does_not_fit)
{
    NEEDS_PART(stereo); /* whose depth maps count */
    const struct cost_load load = budget_test_load();
    oxl_job_options o = budget_test_options(0), none = o;
    CHECK(budget_limit_gaussians(&load, &none) && none.train.max_gaussians == o.train.max_gaussians);
    o.ram = (size_t)2.45e8;
    CHECK(!budget_fit(&load, &o));
    CHECK(budget_limit_gaussians(&load, &o) && o.train.max_gaussians > 0 &&
          (size_t)o.train.max_gaussians < load.points);
    o.ram = 1 << 20;
    CHECK(!budget_limit_gaussians(&load, &o));
}

TEST(budget_asks_for_no_more_gaussians_than_the_images_allow)
{
    struct cost_load load = budget_test_load();
    oxl_job_options o = budget_test_options(2e9);
    load.schedule_pixels = 1e6; /* for fewer than points: none is added */
    CHECK(budget_fit(&load, &o) && o.train.max_gaussians >= 20000);
}

TEST(budget_counts_the_images_that_are_on_their_way)
{
    struct cost_load load = budget_test_load();
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_STANDARD);
    o.scene.image_cache_bytes = (size_t)4e8;
    load.pixels = 1e7;
    double before = cost_memory(&o, &load, 1e5);
    /* 6 MB each, with what decoding takes: 4 at once, and one beside a cache that is full */
    load.largest_file = 1e6;
    CHECK_CLOSE(cost_memory(&o, &load, 1e5) - before, 5 * 6e6, 1);
    load.largest_file = 2e7; /* a quarter of the cache, and 120 MB */
    CHECK_CLOSE(cost_memory(&o, &load, 1e5) - before, 220e6, 1);
    load.pixels = 1e9; /* the cache is full of them anyway */
    load.largest_file = 0;
    before = cost_memory(&o, &load, 1e5);
    load.largest_file = 2e7;
    CHECK_CLOSE(cost_memory(&o, &load, 1e5) - before, 120e6, 1);
}

static double budget_test_bytes_each(const oxl_job_options *o)
{
    const struct cost_load load = budget_test_load();
    return (cost_memory(o, &load, 1e5) - cost_memory(o, &load, 0)) / 1e5;
}

/* A run that ends with gains or a medium holds its model while another one is refined. */
TEST(budget_counts_the_model_beside_which_one_for_viewers_is_refined)
{
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    const double model = 4 * (OXL_SH + 48);
    o.train.sh_degree = 3;
    o.train.exposure = OXL_OFF, o.train.medium = OXL_OFF, o.train.dog = OXL_DOG_OFF;
    double without = budget_test_bytes_each(&o);
    o.train.exposure = OXL_AUTO;
    CHECK_CLOSE(budget_test_bytes_each(&o) - without, model, 1e-6);
    o.train.exposure = OXL_OFF, o.train.medium = OXL_ON;
    CHECK_CLOSE(budget_test_bytes_each(&o) - without, model, 1e-6);
}

/* They start at random places, and grow as those of any other survey. */
TEST(budget_predicts_the_gaussians_of_a_scene_without_points)
{
    const char *path = job_test_survey();
    oxl_job_options o = job_test_options();
    oxl_survey survey;
    char points[600];
    snprintf(points, sizeof points, "%s/sparse/0/points3D.txt", path);
    test_write_bytes(points, "# none\n", 7);
    o.train.max_gaussians = 100000;
    CHECK_OK(oxl_check(test_ctx, path, &o, 0, &survey));
    CHECK(survey.gaussians >= SCENE_START_RANDOM && survey.gaussians < 10.0 * SCENE_START_RANDOM);
    CHECK(survey.seconds > 0);
    CHECK_TEXT(survey.warnings, "starts from depth maps");
}

TEST(budget_predicts_few_gaussians_where_most_pixels_are_transparent)
{
    NEEDS_PART(stereo); /* else opaque scenes without points begin with as few */
    const oxl_job_options o = oxl_job_options_default(OXL_PRESET_STANDARD);
    OWNED_SCENE *scene = test_load(job_test_survey(), NULL);
    for (int transparent = 0; transparent < 2; transparent++) {
        scene->transparent = transparent;
        struct cost_load load = cost_load_of_scene(scene);
        load.schedule_pixels = 6.4e7, load.largest = 640000; /* 100 views of 800 x 800 px */
        CHECK((cost_gaussians(&o, &load) < 10.0 * SCENE_START_HULL) == transparent);
    }
}

/* test_tradeoff.c - what a sweep says is what its runs left: fronts, prices in words, tradeoff.csv, tradeoff.svg. */
#include "../lab/tradeoff.c"
#include "../lab/tradeoff_render.c"
#include "../lab/tradeoff_svg.c"
#include "../lab/tradeoff_text.c"

/* The base, half its iterations, coarse-0.5 (cheaper and better than half), ssim-every-2 (dearer and worse than the base), and the paper's
 * preset, which was not trained. */
static struct tradeoff tradeoff_test_made_up(void)
{
    static const double value[4][2][TRADEOFF_MEASURES] = {
        {{30, 0.90, 0.95, 100, 60, 50e6, 10e6, 1000}, {31, 0.92, 0.97, 120, 70, 50e6, 10e6, 1000}},
        {{28, 0.85, 0.90, 50, 30, 40e6, 8e6, 800}, {29, 0.87, 0.92, 60, 35, 40e6, 8e6, 800}},
        {{29.5, 0.88, 0.93, 40, 30, 50e6, 10e6, 1000}, {30.5, 0.90, 0.95, 48, 30, 50e6, 10e6, 1000}},
        {{29.9, 0.89, 0.94, 110, 62, 50e6, 9e6, 900}}};
    static const char *const names[5] = {"base", "iterations-half", "coarse-0.5", "ssim-every-2", "paper"};
    static const int         done[5]  = {2, 2, 2, 1, 0};
    struct tradeoff          t        = {.scene      = "reef <east> & west",
                                         .preset     = "draft",
                                         .iterations = 2000,
                                         .max_side   = 320,
                                         .held_out   = 1,
                                         .budget     = 600,
                                         .rows       = 5,
                                         .seeds      = 2,
                                         .pictures   = 3,
                                         .picture    = {{"exact", "exact", 10, 100, 4e6},
                                                        {"sh-degree-0", "SH degree 0", 12, 40, 4e6},
                                                        {"splat", "from .splat", 11, 38, 1e6}}};
    for (int r = 0; r < 5; r++) {
        t.row[r]  = tradeoff_variant(names[r], strlen(names[r]));
        t.done[r] = done[r];
        if (r < 4) memcpy(t.value[r], value[r], sizeof value[r]);
    }
    t.wanted[4] = 1234;
    return t;
}

TEST(tradeoff_front_holds_what_nothing_beats_in_no_more_time)
{
    static struct tradeoff t;
    t = tradeoff_test_made_up();
    CHECK(tradeoff_on_front(&t, 0) && !tradeoff_on_front(&t, 1) && tradeoff_on_front(&t, 2));
    CHECK(!tradeoff_on_front(&t, 3) && !tradeoff_on_front(&t, 4));
    CHECK(tradeoff_picture_on_front(&t, 0) && tradeoff_picture_on_front(&t, 1) && !tradeoff_picture_on_front(&t, 2));
    memcpy(t.value[3], t.value[0], sizeof t.value[0]); /* of equals the first is on it */
    t.done[3] = 2;
    CHECK(tradeoff_on_front(&t, 0) && !tradeoff_on_front(&t, 3));
}

TEST(tradeoff_compares_seed_by_seed_and_with_fewer_iterations)
{
    static struct tradeoff t;
    t = tradeoff_test_made_up();
    CHECK_CLOSE(tradeoff_against_base(&t, 2, TRADEOFF_PSNR).mean, -0.5, 1e-12);
    CHECK_CLOSE(tradeoff_against_base(&t, 2, TRADEOFF_PSNR).spread, 0, 1e-12);
    CHECK_CLOSE(tradeoff_against_base(&t, 2, TRADEOFF_CPU).mean, 0.4, 1e-12);
    CHECK_CLOSE(tradeoff_against_base(&t, 3, TRADEOFF_PSNR).mean, -0.1, 1e-12); /* of the one seed that both have */
    CHECK(isnan(tradeoff_against_base(&t, 4, TRADEOFF_PSNR).mean));
    CHECK_CLOSE(tradeoff_by_iterations(&t, sqrt(55. * 110)), 29.5, 1e-12);
    CHECK_CLOSE(tradeoff_by_iterations(&t, 110), 30.5, 1e-12);
    CHECK(isnan(tradeoff_by_iterations(&t, 50))); /* coarse-0.5, below, has not the base's options */
    CHECK(isnan(tradeoff_by_iterations(&t, 200)));
}

static struct study_text tradeoff_test_text(void (*write)(struct study_text *out, const struct tradeoff *t))
{
    static struct tradeoff t;
    struct study_text      out = {0};
    t                          = tradeoff_test_made_up();
    write(&out, &t);
    CHECK(!out.failed && out.data != NULL && !strstr(out.data, "nan") && !strstr(out.data, "inf"));
    return out;
}

TEST(tradeoff_says_in_words_what_each_row_costs_and_what_was_not_trained)
{
    struct study_text table = tradeoff_test_text(tradeoff_table), page = tradeoff_test_text(tradeoff_page);
    CHECK_TEXT(table.data, "coarse-0.5: 2.50x faster, -0.50 dB (spread 0.00), SSIM -0.0200, MS-SSIM -0.0200");
    CHECK_TEXT(table.data, "ssim-every-2: 1.10x slower, -0.10 dB");
    CHECK_TEXT(table.data, "the base for as long reaches 30.50 dB: -0.60 dB");
    CHECK_TEXT(table.data, "* coarse-0.5 ");
    CHECK_TEXT(table.data, "pictures, SH degree 0: 1.20x the frames a second, 40.0 dB to the exact pictures");
    CHECK_TEXT(table.data, "not trained: paper: 0 of 2 seeds; the next takes about 1234 s, more than is left of 600 s.");
    CHECK_TEXT(page.data, "| coarse-0.5 \\* | 30.00 +-0.71 |");
    CHECK_TEXT(page.data, "- not trained: paper");
    CHECK(!strcmp(TRADEOFF_SIGNED(0.5, 2), "+0.50") && !strcmp(TRADEOFF_SIGNED(-0.5, 2), "-0.50"));
    free(table.data);
    free(page.data);
}

TEST(tradeoff_csv_holds_every_run_means_and_pictures_in_whole_rows)
{
    struct study_text csv   = tradeoff_test_text(tradeoff_csv);
    int               lines = 0, commas = 0;
    CHECK_TEXT(csv.data, "\ntrain,coarse-0.5,2,30.500000,0.90000000,0.95000000,48.00,30.000,50000000,10000000,1000,,1\n");
    CHECK_TEXT(csv.data, "\ntrain,iterations-half,mean,28.500000,");
    CHECK_TEXT(csv.data, "\nrender,sh-degree-0,1,40.0000,,,,,,4000000,,12.0000,1\n");
    for (const char *p = csv.data; *p; p++) {
        commas += *p == ',';
        if (*p != '\n') continue;
        CHECK(commas == 2 + TRADEOFF_MEASURES + 2);
        commas = 0, lines++;
    }
    CHECK(lines == 1 + (2 + 2) * 3 + (1 + 1) + 3);
    free(csv.data);
}

TEST(tradeoff_svg_is_well_formed_and_names_its_points)
{
    struct study_text svg = tradeoff_test_text(tradeoff_svg);
    CHECK(ablate_test_is_nested(svg.data));
    CHECK_TEXT(svg.data, "reef &lt;east&gt; &amp; west");
    CHECK_TEXT(svg.data, ">coarse-0.5</text>");
    CHECK_TEXT(svg.data, ">SH degree 0</text>");
    free(svg.data);
}

/* By the line of run.json, which has every option; structs have gaps that a copy need not keep. */
static int tradeoff_test_same_options(const oxl_train_options *a, const oxl_train_options *b)
{
    oxl_job_options job = oxl_job_options_default(OXL_PRESET_DRAFT);
    struct text     x = {.ctx = test_ctx}, y = x;
    int             same = 0;
    job.train            = *a;
    run_describe(&x, "", &job);
    job.train = *b;
    run_describe(&y, "", &job);
    same = !x.failed && !y.failed && !strcmp(x.data, y.data);
    text_free(&x);
    text_free(&y);
    return same;
}

TEST(tradeoff_rows_differ_by_one_option_or_are_a_preset)
{
    oxl_job_options       base       = oxl_job_options_default(OXL_PRESET_DRAFT);
    const oxl_job_options coarse     = tradeoff_job(&base, tradeoff_variant("coarse-0.25", 11), 3),
                          half       = tradeoff_job(&base, tradeoff_variant("iterations-half", 15), 1),
                          paper      = tradeoff_job(&base, tradeoff_variant("paper", 5), 1);
    const oxl_train_options standard = oxl_train_options_default(OXL_PRESET_PAPER);
    CHECK(coarse.seed == 3 && coarse.train.coarse == 0.25f && coarse.train.iterations == base.train.iterations);
    CHECK(coarse.train.ssim_every == base.train.ssim_every && coarse.train.sh_degree == base.train.sh_degree);
    CHECK(half.train.iterations * 2 == base.train.iterations && half.train.coarse == base.train.coarse);
    CHECK(base.train.coarse == -1 && tradeoff_job(&base, tradeoff_variant("coarse-0", 8), 1).train.coarse == 0);
    CHECK(tradeoff_test_same_options(&paper.train, &standard) && !tradeoff_test_same_options(&half.train, &standard));
}

/* Nothing of what the paper does not have. */
TEST(tradeoff_options_are_off_in_the_papers_preset)
{
    const oxl_train_options o = oxl_train_options_default(OXL_PRESET_PAPER);
    CHECK(o.coarse == 0 && o.ssim_every == 1 && o.exp_degree == 5 && o.alpha_min == 1.0f / 255 && o.tile_share == 1 &&
          o.stop_early == 0 && o.bands_every == 1.0f / 30 && o.sh_degree == 3 && o.iterations == 40000 && o.haste == 0);
}

TEST(tradeoff_pictures_enlarged_keep_a_slope_and_reach_odd_edges)
{
    oxl_image small, large;
    CHECK_OK(oxl_image_create(test_ctx, 4, 3, &small));
    for (int i = 0; i < 36; i++) small.rgb[i] = (float)(i % 4 + 10 * (i / 4 % 3));
    CHECK_OK(tradeoff_enlarge(test_ctx, &small, 9, 7, &large));
    CHECK_CLOSE(large.rgb[2 * 9 + 3], 1.25 + 10 * 0.75, 1e-5); /* the centre of pixel (3, 2) is (1.25, 0.75) of the small one's */
    CHECK_CLOSE(large.rgb[0], 0, 1e-6);
    CHECK_CLOSE(large.rgb[6 * 9 + 8], 23, 1e-5);
    oxl_image_free(test_ctx, &small);
    oxl_image_free(test_ctx, &large);
}

TEST(tradeoff_refuses_rows_and_seeds_that_make_no_sense)
{
    char             error[400];
    tradeoff_options o = {.scene = "nowhere", .out = test_path("out"), .seeds = 1, .budget = 60};
    o.job              = oxl_job_options_default(OXL_PRESET_DRAFT);
    o.context          = oxl_context_options_default();
    o.rows             = "coarse-0.5,fast";
    CHECK(tradeoff_run(&o, stdout, error, sizeof error) == OXL_ERR_USAGE);
    CHECK_TEXT(error, "'fast'");
    CHECK_TEXT(error, "ssim-every-2");
    o.rows = "coarse-0.5,coarse-0.5";
    CHECK(tradeoff_run(&o, stdout, error, sizeof error) == OXL_ERR_USAGE);
    o.rows = NULL, o.seeds = 0;
    CHECK(tradeoff_run(&o, stdout, error, sizeof error) == OXL_ERR_USAGE);
    CHECK_TEXT(error, "1 to 99");
}

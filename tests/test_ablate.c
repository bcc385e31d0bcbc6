/* test_ablate.c - what an ablation says is what its runs left, in the table, in ablation.csv and in ablation.svg. */
#include "../lab/ablate.c"
#include "../lab/ablate_svg.c"
#include "../lab/ablate_table.c"
#include "../lab/study.c"
#include "../lab/study_text.c"

#include <locale.h>

/* Two seeds of the midpoint baseline, V1 and V3 with keep 0.315; the memory of V1's second seed is not known. */
static struct ablation ablate_test_made_up(void)
{
    static const double value[3][2][ABLATE_MEASURES] = {
        {{22, 0.70, 18, 1000, 2e6, 100, 50e6}, {24, 0.80, 19, 3000, 4e6, 200, 70e6}},
        {{22.5, 0.71, NAN, 900, 1e6, 80, 40e6}, {25, 0.83, 20, 2700, 2e6, 160, NAN}},
        {{21, 0.70, 18, 500, 1e6, 25, 25e6}, {23.5, 0.80, 19, 1500, 1e6, 50, 35e6}}};
    struct ablation a = {.scene = "reef <east> & west", .iterations = 700, .sh_degree = 2, .rows = 3, .seeds = 2, .held_out = 1};
    const int       variant[3] = {0, 1, 6};
    for (int r = 0; r < 3; r++) {
        a.row[r]    = &ABLATE_VARIANTS[variant[r]];
        a.blocks[r] = r + 2;
        memcpy(a.value[r], value[r], sizeof value[r]);
    }
    return a;
}

static struct study_text ablate_test_text(void (*write)(struct study_text *t, const struct ablation *a), const struct ablation *a)
{
    struct study_text t = {0};
    write(&t, a);
    CHECK(!t.failed && t.data != NULL);
    return t;
}

TEST(ablate_means_and_spreads_are_over_the_seeds)
{
    const struct ablation a = ablate_test_made_up();
    CHECK_CLOSE(ablate_mean(&a, 0, ABLATE_PSNR).mean, 23, 1e-12);
    CHECK_CLOSE(ablate_mean(&a, 0, ABLATE_PSNR).spread, sqrt(2), 1e-12);
    CHECK_CLOSE(ablate_mean(&a, 0, ABLATE_SECONDS).mean, 150, 1e-12);
    CHECK(isnan(ablate_mean(&a, 1, ABLATE_MEMORY).mean));
}

TEST(ablate_compares_rows_seed_by_seed_and_the_paper_with_itself)
{
    const struct ablation a = ablate_test_made_up();
    CHECK_CLOSE(ablate_against(&a, 1, 0, ABLATE_PSNR).mean, 0.75, 1e-12);
    CHECK_CLOSE(ablate_against(&a, 1, 0, ABLATE_PSNR).spread, 0.25 * sqrt(2), 1e-12);
    CHECK_CLOSE(ablate_against(&a, 1, 0, ABLATE_BYTES).mean, 0.5, 1e-12);
    CHECK_CLOSE(ablate_against(&a, 1, 0, ABLATE_BYTES).spread, 0, 1e-12);
    CHECK_CLOSE(ablate_against(&a, 2, 1, ABLATE_BYTES).mean, 0.75, 1e-12);
    CHECK_CLOSE(ablate_paper_against(&a, 1, 0, ABLATE_PSNR), 0.65, 1e-12);
    CHECK_CLOSE(ablate_paper_against(&a, 1, 0, ABLATE_SECONDS), (31 * 60 + 17) / (43 * 60 + 7.), 1e-12);
    CHECK(isnan(ablate_paper_against(&a, 2, 0, ABLATE_PSNR)));
    CHECK(isnan(ablate_paper_against(&a, 1, 0, ABLATE_MEMORY)));
}

/* Counts heads, which start with blanks; the lines below one, up to an empty line, are as long as it is. */
static int ablate_test_tables(const char *text)
{
    size_t length = 0;
    int    tables = 0;
    for (const char *line = text; *line; line += strcspn(line, "\n") + 1) {
        const size_t size = strcspn(line, "\n");
        if (size == 0) length = 0;
        CHECK(length == 0 || size == length);
        if (line[0] == ' ') length = size, tables++;
    }
    return tables;
}

TEST(ablate_table_says_ours_and_the_papers_in_aligned_columns)
{
    struct ablation   a = ablate_test_made_up();
    struct study_text t = ablate_test_text(ablate_table, &a);
    CHECK_TEXT(t.data, "700 iterations, SH degree 2, seeds 1 to 2 (mean +- standard deviation)");
    CHECK_TEXT(t.data, "23.00 +-1.41");
    CHECK_TEXT(t.data, "+0.75 (+0.65)");
    CHECK_TEXT(t.data, "x0.800 (x0.726)");
    CHECK_TEXT(t.data, "-1.50"); /* V3 against the row before, */
    CHECK_TEXT(t.data, "-0.75"); /* and against the first */
    CHECK(ablate_test_tables(t.data) == 3);
    CHECK(!strstr(t.data, "one block"));
    free(t.data);
    a.seeds = a.blocks[0] = a.blocks[1] = a.blocks[2] = 1;
    t                                                 = ablate_test_text(ablate_table, &a);
    CHECK_TEXT(t.data, "seed 1\n");
    CHECK_TEXT(t.data, "The survey is one block");
    CHECK(!strstr(t.data, "+-"));
    free(t.data);
}

/* In the first line that starts so. */
static int ablate_test_commas(const char *text, const char *start)
{
    const char *line   = strstr(text, start);
    int         commas = 0;
    CHECK(line != NULL);
    for (line += line && *line == '\n'; line && *line && *line != '\n'; line++) commas += *line == ',';
    return commas;
}

TEST(ablate_csv_holds_every_run_then_means_and_spreads)
{
    const struct ablation a     = ablate_test_made_up();
    struct study_text     t     = ablate_test_text(ablate_csv, &a);
    int                   lines = 0;
    const int             wide  = ablate_test_commas(t.data, "row,seed,blocks,psnr_db");
    for (const char *p = t.data; *p; p++) lines += *p == '\n';
    CHECK(lines == 1 + 3 * 2 + 3 * 2);
    CHECK(wide == 2 + 7 + 7 + 4);
    CHECK_TEXT(t.data, "\nv1,2,3,25.000000,0.83000000,20.000000,2700,2000000,160.000,,1.000000,");
    CHECK_TEXT(t.data, "\n3dgs,mean,2,23.000000,0.75000000,18.500000,2000,3000000,150.000,60000000,0.000000,");
    CHECK_TEXT(t.data, "\n3dgs,sd,2,1.4142136,");
    CHECK(ablate_test_commas(t.data, "\nv1,2,3") == wide);
    CHECK(ablate_test_commas(t.data, "\nv1,mean,3") == wide);
    CHECK(ablate_test_commas(t.data, "\nv3-315,sd,4") == wide);
    free(t.data);
}

/* Elements are opened and closed in pairs, and nothing is left open. */
static int ablate_test_is_nested(const char *xml)
{
    int depth = 0;
    for (const char *p = strchr(xml, '<'); p; p = strchr(p + 1, '<')) {
        const char *end = strchr(p, '>');
        if (!end || depth < 0 || (depth == 0 && p > xml)) return 0;
        if (p[1] == '/') depth--;
        else if (end[-1] != '/') depth++;
    }
    return depth == 0;
}

TEST(ablate_svg_is_well_formed_and_draws_both)
{
    const struct ablation a = ablate_test_made_up();
    struct study_text     t = ablate_test_text(ablate_svg, &a);
    CHECK(ablate_test_is_nested(t.data));
    CHECK_TEXT(t.data, "reef &lt;east&gt; &amp; west");
    CHECK_TEXT(t.data, ">+0.75</text>");
    CHECK_TEXT(t.data, ">+0.65</text>");
    CHECK_TEXT(t.data, ">x0.885</text>");
    CHECK(!strstr(t.data, "nan") && !strstr(t.data, "script"));
    free(t.data);
}

TEST(ablate_digits_do_not_follow_the_locale)
{
    const struct ablation a      = ablate_test_made_up();
    struct study_text     before = ablate_test_text(ablate_svg, &a), after;
    if (!setlocale(LC_NUMERIC, "de_DE.UTF-8") && !setlocale(LC_NUMERIC, "fr_FR.UTF-8")) {
        free(before.data);
        SKIP("no locale with a decimal comma is installed");
    }
    after = ablate_test_text(ablate_svg, &a);
    CHECK(strcmp(before.data, after.data) == 0);
    CHECK_CLOSE(json_number("{\"psnr\": 23.25, \"x\": 1}", "psnr"), 23.25, 1e-12);
    setlocale(LC_NUMERIC, "C");
    free(before.data);
    free(after.data);
}

TEST(ablate_reads_numbers_as_metrics_json_has_them)
{
    const char *json =
        "{\n  \"standard\": {\"psnr\": 2, \"ssim\": 1},\n  \"gaussians\": 12345,\n  \"ssim\": 0.71828182845904523,\n"
        "  \"small\": -2.5e-05, \"large\": 1e+20,\n  \"none\": null }";
    CHECK_CLOSE(json_number(json, "gaussians"), 12345, 0);
    CHECK_CLOSE(json_number(json, "ssim"), 0.71828182845904523, 1e-15);
    CHECK_CLOSE(json_number(json, "small"), -2.5e-5, 1e-18);
    CHECK_CLOSE(json_number(json, "large"), 1e20, 1e6);
    CHECK(isnan(json_number(json, "none")) && isnan(json_number(json, "psnr")) && isnan(json_number(NULL, "psnr")));
}

TEST(ablate_rows_differ_by_what_the_paper_switches_and_nothing_else)
{
    ablate_options        o    = {.job = oxl_job_options_default(OXL_PRESET_DRAFT)};
    const oxl_job_options base = ablate_job(&o, ablate_variant("3dgs", 4), 3), v2 = ablate_job(&o, ablate_variant("v2", 2), 3),
                          v3   = ablate_job(&o, ablate_variant("v3-315", 6), 3),
                          full = ablate_job(&o, ablate_variant("oceanxl", 7), 3);
    CHECK(base.seed == 3 && base.partition.cut == OXL_CUT_MIDPOINT && base.train.ucd.mode == OXL_UCD_OFF);
    CHECK(base.train.keep.kind == OXL_KEEP_ALL && base.train.dog == OXL_DOG_OFF);
    CHECK(v2.partition.cut == OXL_CUT_BALANCED && v2.train.ucd.mode == OXL_UCD_ON && v2.train.keep.kind == OXL_KEEP_ALL);
    CHECK(v3.train.keep.kind == OXL_KEEP_FRACTION && v3.train.keep.value == 0.315 && v3.train.dog == OXL_DOG_OFF);
    CHECK(full.train.keep.kind == OXL_KEEP_FRACTION && full.train.keep.value == 0.5 && full.train.dog == OXL_DOG_SELECTIVE);
    CHECK(full.train.iterations == base.train.iterations && full.train.sh_degree == base.train.sh_degree);
}

TEST(ablate_refuses_rows_and_seeds_that_make_no_sense)
{
    char           error[300];
    ablate_options o = {
        .scene = "nowhere", .out = test_path("out"), .seeds = 1, .job = oxl_job_options_default(OXL_PRESET_DRAFT)};
    o.context = oxl_context_options_default();
    o.rows    = "v1,v9";
    CHECK(ablate_run(&o, stdout, error, sizeof error) == OXL_ERR_USAGE);
    CHECK_TEXT(error, "'v9'");
    CHECK_TEXT(error, "3dgs v1 v2 v3 v4 oceanxl v3-315 auto");
    o.rows = "v1,v1";
    CHECK(ablate_run(&o, stdout, error, sizeof error) == OXL_ERR_USAGE);
    o.rows  = NULL;
    o.seeds = 0;
    CHECK(ablate_run(&o, stdout, error, sizeof error) == OXL_ERR_USAGE);
    CHECK_TEXT(error, "1 to 99");
}

TEST(study_counts_the_memory_that_a_context_holds)
{
    struct study        meter   = {0};
    oxl_context_options options = {.seed = 1, .reallocate = study_reallocate, .user = &meter};
    oxl_context        *ctx     = NULL;
    oxl_image           image   = {0};
    size_t              held;
    CHECK_OK(oxl_context_create(&options, &ctx));
    held = meter.held;
    CHECK_OK(oxl_image_create(ctx, 100, 50, &image));
    CHECK(meter.held >= held + 100 * 50 * 3 * sizeof(float) && meter.held < held + 100 * 50 * 3 * sizeof(float) + 1000);
    oxl_image_free(ctx, &image);
    CHECK(meter.held == held && meter.peak > held + 100 * 50 * 3 * sizeof(float) - 1);
    oxl_context_free(ctx);
    CHECK(meter.held == 0);
}

/* begun 1: trained from its start; 2: in parts; 0: finished before. */
TEST(study_remembers_peak_and_processor_time_over_the_parts_of_a_training)
{
    char                error[200], folder[300];
    struct study        s = {.peak = 5000, .begun = 1, .cpu = 7, .error = error, .error_size = sizeof error};
    struct study_result r;
    snprintf(folder, sizeof folder, "%s", test_folder());
    CHECK_OK(study_note(&s, folder, &r));
    s.begun = 2, s.peak = 3000, s.cpu = 2.5;
    CHECK_OK(study_note(&s, folder, &r));
    CHECK_CLOSE(r.memory, 5000, 0);
    CHECK_CLOSE(r.cpu, 9.5, 1e-12);
    s.begun = 0, s.peak = 9000, s.cpu = 1;
    CHECK_OK(study_note(&s, folder, &r));
    CHECK_CLOSE(r.memory, 5000, 0);
    CHECK_CLOSE(r.cpu, 9.5, 1e-12);
    s.begun = 1, s.peak = 4000;
    CHECK_OK(study_note(&s, folder, &r));
    CHECK_CLOSE(r.memory, 4000, 0);
    CHECK_CLOSE(r.cpu, 1, 1e-12);
}

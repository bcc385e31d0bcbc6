/* test_study.c - what a study says is what its runs left: rows, comparisons, controls, the front; its page,
 * CSV and drawing. */
#include "test.h"
#include "../lab/studies.c"
#include "../lab/study.c"
#include "../lab/study_plot.c"
#include "../lab/study_report.c"
#include "../lab/study_train.c"

#include <locale.h>

/* Rows of the kind by name, two seeds of each; free() it. */
static struct study *study_test_of(const struct study_kind *kind, const study_options *options, int rows,
                                   const char *const *name)
{
    struct study *s = calloc(1, sizeof *s);
    CHECK(s != NULL);
    s->kind = kind;
    s->options = options;
    s->base = oxl_job_options_default(OXL_PRESET_DRAFT);
    s->base.train.iterations = 700;
    s->held_out = 1;
    s->rows = rows;
    for (int r = 0; r < rows; r++) {
        s->row[r] = study_find_row(kind, name[r], strlen(name[r]));
        s->done[r] = 2;
        s->blocks[r] = r + 2;
        CHECK(s->row[r] != NULL);
    }
    return s;
}

static const study_options study_test_two_seeds = {
    .scene = "reef <east> & west", .out = "nowhere", .seeds = 2, .budget = 600};

/* PSNR, SSIM, Gaussians, bytes, seconds, CPU s, memory. */
static void study_test_fill(struct study *s, int row, int seed, const double v[7])
{
    static const enum study_measure to[7] = {STUDY_PSNR,    STUDY_SSIM, STUDY_GAUSSIANS, STUDY_BYTES,
                                             STUDY_SECONDS, STUDY_CPU,  STUDY_MEMORY};
    for (int m = 0; m < STUDY_MEASURES; m++) s->value[row][seed - 1][m] = NAN;
    for (int i = 0; i < 7; i++) s->value[row][seed - 1][to[i]] = v[i];
}

/* The baseline, V1, V2, V1 with V2's count, and V3 with keep 0.315; the memory of V1's second seed is not
 * known. */
static struct study *study_test_ablation(void)
{
    static const char *const names[] = {"3dgs", "v1", "v2", "v1-count", "v3-315"};
    static const double value[5][2][7] = {
        {{22, 0.70, 1000, 2e6, 100, 90, 50e6}, {24, 0.80, 3000, 4e6, 200, 190, 70e6}},
        {{22.5, 0.71, 900, 1e6, 80, 70, 40e6}, {25, 0.83, 2700, 2e6, 160, 150, NAN}},
        {{23, 0.72, 1200, 3e6, 90, 80, 45e6}, {25.2, 0.84, 3300, 5e6, 170, 160, 45e6}},
        {{23.1, 0.72, 1190, 3e6, 90, 80, 45e6}, {25, 0.84, 3310, 5e6, 170, 160, 45e6}},
        {{21, 0.70, 500, 1e6, 25, 20, 25e6}, {23.5, 0.80, 1500, 1e6, 50, 40, 35e6}}};
    struct study *s = study_test_of(&ABLATE_KIND, &study_test_two_seeds, 5, names);
    for (int r = 0; r < 5; r++)
        for (int seed = 1; seed <= 2; seed++) study_test_fill(s, r, seed, value[r][seed - 1]);
    return s;
}

/* The base, half its iterations, coarse-0.5 (cheaper and better than half), keep-0.5 (dearer and worse than
 * the base; one seed), and the paper's preset, which was not trained. */
static struct study *study_test_sweep(void)
{
    static const char *const names[] = {"base", "iterations-half", "coarse-0.5", "keep-0.5", "paper"};
    static const double value[4][2][7] = {
        {{30, 0.90, 1000, 10e6, 60, 100, 50e6}, {31, 0.92, 1000, 10e6, 70, 120, 50e6}},
        {{28, 0.85, 800, 8e6, 30, 50, 40e6}, {29, 0.87, 800, 8e6, 35, 60, 40e6}},
        {{29.5, 0.88, 1000, 10e6, 30, 40, 50e6}, {30.5, 0.90, 1000, 10e6, 30, 48, 50e6}},
        {{29.9, 0.89, 900, 9e6, 62, 110, 50e6}, {0}}};
    struct study *s = study_test_of(&TRADEOFF_KIND, &study_test_two_seeds, 5, names);
    for (int r = 0; r < 4; r++)
        for (int seed = 1; seed <= 2; seed++) study_test_fill(s, r, seed, value[r][seed - 1]);
    s->done[3] = 1, s->done[4] = 0, s->wanted[4] = 1234;
    return s;
}

static struct output study_test_text(void (*write)(struct output *t, const struct study *s),
                                     const struct study *s)
{
    struct output t = {0};
    write(&t, s);
    CHECK(!t.failed && t.data != NULL && !strstr(t.data, "nan") && !strstr(t.data, "inf"));
    return t;
}

/* ---------------- figures */

TEST(study_means_spreads_and_comparisons_are_over_the_seeds)
{
    struct study *s = study_test_ablation();
    CHECK_CLOSE(study_mean(s, 0, STUDY_PSNR).mean, 23, 1e-12);
    CHECK_CLOSE(study_mean(s, 0, STUDY_PSNR).spread, sqrt(2), 1e-12);
    CHECK(isnan(study_mean(s, 1, STUDY_MEMORY).mean));
    CHECK_CLOSE(study_compare(s, 1, 0, STUDY_PSNR).mean, 0.75, 1e-12);
    CHECK_CLOSE(study_compare(s, 1, 0, STUDY_PSNR).spread, 0.25 * sqrt(2), 1e-12);
    CHECK_CLOSE(study_compare(s, 1, 0, STUDY_BYTES).mean, 0.5, 1e-12);
    CHECK_CLOSE(study_compare(s, 4, 1, STUDY_BYTES).mean, 0.75, 1e-12);
    s->done[1] = 1;
    CHECK_CLOSE(study_compare(s, 1, 0, STUDY_PSNR).mean, 0.5, 1e-12); /* of the one seed that both have */
    s->done[1] = 0;
    CHECK(isnan(study_compare(s, 1, 0, STUDY_PSNR).mean));
    free(s);
}

TEST(study_compares_the_paper_with_itself)
{
    struct study *s = study_test_ablation();
    CHECK_CLOSE(table_paper_effect(s, 1, 0, STUDY_PSNR), 0.65, 1e-12);
    CHECK_CLOSE(table_paper_effect(s, 1, 0, STUDY_SECONDS), (31 * 60 + 17) / (43 * 60 + 7.), 1e-12);
    CHECK(isnan(table_paper_effect(s, 4, 0, STUDY_PSNR)) && isnan(table_paper_effect(s, 1, 0, STUDY_MEMORY)));
    free(s);
}

TEST(study_front_holds_what_nothing_beats_in_no_more_time)
{
    struct study *s = study_test_sweep();
    CHECK(study_is_pareto_optimal(s, 0) && !study_is_pareto_optimal(s, 1) && study_is_pareto_optimal(s, 2) &&
          !study_is_pareto_optimal(s, 3) && !study_is_pareto_optimal(s, 4));
    memcpy(s->value[3], s->value[0], sizeof s->value[0]); /* of equals the first is on it */
    s->done[3] = 2;
    CHECK(study_is_pareto_optimal(s, 0) && !study_is_pareto_optimal(s, 3));
    free(s);
}

TEST(study_compares_a_saving_with_fewer_iterations)
{
    struct study *s = study_test_sweep();
    CHECK_CLOSE(table_by_iterations(s, sqrt(55. * 110)), 29.5, 1e-12);
    CHECK_CLOSE(table_by_iterations(s, 110), 30.5, 1e-12);
    /* coarse-0.5, below, is not of the base's options */
    CHECK(isnan(table_by_iterations(s, 50)) && isnan(table_by_iterations(s, 200)));
    free(s);
}

/* ---------------- page, CSV, drawing */

TEST(study_page_says_none_where_an_effect_is_within_the_spread)
{
    struct study *s = study_test_ablation();
    struct output t = study_test_text(study_page, s);
    CHECK_TEXT(t.data, "700 iterations");
    CHECK_TEXT(t.data, "seeds 1 to 2 (mean +- standard deviation)");
    CHECK_TEXT(t.data, "23.00 +-1.41");
    CHECK_TEXT(t.data, "| V1 +BSP against 3DGS, midpoint        |   +0.75 +-0.35 (+0.65)");
    CHECK_TEXT(t.data, "x0.800 +-0.000 (x0.726)");
    CHECK_TEXT(t.data, "| V2 +UCD against V1 +BSP               |   +0.35 +-0.21 (+3.31)");
    CHECK_TEXT(
        t.data,
        "| V2 +UCD against V1, count of V2       |                   none |"); /* -0.10, +0.20: the control */
    CHECK(!strstr(t.data, "one block"));
    free(t.data);
    free(s);
}

/* Counts in the first line that starts so. */
static int study_test_count(const char *text, const char *start, char what)
{
    const char *line = strstr(text, start);
    int found = 0;
    CHECK(line != NULL);
    for (line += line && *line == '\n'; line && *line && *line != '\n'; line++) found += *line == what;
    return found;
}

TEST(study_page_of_one_seed_has_whole_tables_and_no_spreads)
{
    study_options one = {.scene = "reef", .seeds = 1};
    struct study *s = study_test_ablation();
    struct output t;
    s->options = &one;
    for (int r = 0; r < 5; r++) s->done[r] = s->blocks[r] = 1;
    t = study_test_text(study_page, s);
    CHECK(!strstr(t.data, "+-") && !strstr(t.data, "| none"));
    CHECK_TEXT(t.data, "The survey is one block");
    CHECK_TEXT(t.data, "memory MB");
    CHECK(study_test_count(t.data, "| row ", '|') == study_test_count(t.data, "| V1 +BSP \\*", '|'));
    CHECK(study_test_count(t.data, "| row against", '|') ==
          study_test_count(t.data, "| V2 +UCD against", '|'));
    free(t.data);
    free(s);
}

TEST(study_page_of_a_sweep_says_the_front_and_what_was_not_trained)
{
    struct study *s = study_test_sweep();
    struct output t = study_test_text(study_page, s);
    CHECK_TEXT(t.data, "| --coarse 0.5 \\*  ");
    CHECK_TEXT(t.data, "| --coarse 0.5 against base ");
    CHECK_TEXT(t.data, "x0.400 +-0.000");
    CHECK_TEXT(t.data, " -0.60 |\n"); /* keep-0.5 against the base for as long */
    CHECK_TEXT(
        t.data,
        "Not trained: paper, 0 of 2 seeds done; the next takes about 1234 s, more than is left of 600 s.");
    free(t.data);
    free(s);
}

TEST(study_csv_holds_every_run_means_spreads_and_comparisons_in_whole_lines)
{
    struct study *s = study_test_ablation();
    struct output t = study_test_text(study_csv, s);
    int commas = 0, lines = 0;
    CHECK_TEXT(
        t.data,
        "row,against,seed,blocks,psnr_db,ssim,structure,structure_least,near_psnr_db,mid_psnr_db,far_psnr_db,gaussians,bytes,seconds,cpu_seconds,"
        "memory_bytes,ms_ssim,lpips,front\n");
    CHECK_TEXT(t.data, "\nv1,,2,3,25.000000,0.83000000,,,,,,2700,2000000,160.000,150.00,,,,1\n");
    CHECK_TEXT(t.data, "\n3dgs,,mean,2,23.000000,0.75000000,,,,,,2000,3000000,150.000,140.00,60000000,,,0\n");
    CHECK_TEXT(t.data, "\nv1,3dgs,mean,3,0.750000,");
    CHECK_TEXT(t.data, "\nv1,3dgs,paper,3,0.650000,");
    CHECK_TEXT(t.data, "\nv2,v1-count,sd,4,0.212132,");
    for (const char *p = t.data; *p; p++) {
        commas += *p == ',';
        if (*p != '\n') continue;
        CHECK(commas == 4 + STUDY_MEASURES);
        commas = 0, lines++;
    }
    /* v1; v2; v1-count; v3-315 against v2 and 3dgs */
    CHECK(lines == 1 + 5 * (2 + 2) + 3 + (3 + 2 + 3) + 2 + (2 + 2));
    free(t.data);
    free(s);
}

/* Elements are opened and closed in pairs, and nothing is left open. */
static int study_test_is_nested(const char *xml)
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

TEST(study_drawing_is_well_formed_and_names_its_points)
{
    struct study *s = study_test_sweep();
    struct output t = study_test_text(study_plot, s);
    CHECK(study_test_is_nested(t.data));
    CHECK_TEXT(t.data, "reef &lt;east&gt; &amp; west");
    CHECK_TEXT(t.data, ">coarse-0.5</text>");
    CHECK_TEXT(t.data, ">MB of the model (logarithmic)</text>");
    CHECK(!strstr(t.data, ">paper</text>") && !strstr(t.data, "script"));
    free(t.data);
    free(s);
}

TEST(study_digits_do_not_follow_the_locale)
{
    struct study *s = study_test_ablation();
    struct output before = study_test_text(study_csv, s), after;
    if (!setlocale(LC_NUMERIC, "de_DE.UTF-8") && !setlocale(LC_NUMERIC, "fr_FR.UTF-8")) {
        free(before.data);
        free(s);
        SKIP("no locale with a decimal comma is installed");
    }
    after = study_test_text(study_csv, s);
    CHECK(strcmp(before.data, after.data) == 0);
    CHECK_CLOSE(oxl_json_number("{\"psnr\": 23.25, \"x\": 1}", "psnr"), 23.25, 1e-12);
    setlocale(LC_NUMERIC, "C");
    free(before.data);
    free(after.data);
    free(s);
}

/* ---------------- rows */

TEST(ablate_rows_differ_by_what_the_paper_switches_and_nothing_else)
{
    NEEDS_PART(ucd);
    NEEDS_PART(prune);
    NEEDS_PART(lobes);
    static const char *const names[] = {"3dgs", "v2", "v3-315", "oceanxl", "v3-bytes"};
    struct study *s = study_test_of(&ABLATE_KIND, &study_test_two_seeds, 5, names);
    oxl_job_options job[5];
    s->value[3][0][STUDY_BYTES] = 123456;
    for (int r = 0; r < 5; r++) job[r] = study_job(s, r, 1);
    CHECK(job[0].seed == 1 && job[0].partition.cut == OXL_CUT_MIDPOINT &&
          job[0].train.ucd.mode == OXL_UCD_OFF);
    CHECK(job[0].train.keep.kind == OXL_KEEP_ALL && job[0].train.dog == OXL_DOG_OFF);
    CHECK(job[1].partition.cut == OXL_CUT_BALANCED && job[1].train.ucd.mode == OXL_UCD_ON &&
          job[1].train.keep.kind == OXL_KEEP_ALL);
    CHECK(job[2].train.keep.kind == OXL_KEEP_FRACTION && job[2].train.keep.value == 0.315 &&
          job[2].train.dog == OXL_DOG_OFF);
    CHECK(job[3].train.keep.value == 0.5 && job[3].train.dog == OXL_DOG_SELECTIVE);
    CHECK(job[4].train.keep.kind == OXL_KEEP_BYTES && job[4].train.keep.value == 123456 &&
          job[4].train.dog == OXL_DOG_OFF);
    for (int r = 0; r < 5; r++)
        CHECK(job[r].train.iterations == 700 &&
              job[r].train.densify_gradient == s->base.train.densify_gradient);
    free(s);
}

/* By the line of run.json, which has every option; structs have gaps that a copy need not keep. */
static int study_test_same_options(const oxl_train_options *a, const oxl_train_options *b)
{
    oxl_job_options job = oxl_job_options_default(OXL_PRESET_DRAFT);
    struct text x = {.ctx = test_ctx}, y = x;
    int same = 0;
    job.train = *a;
    manifest_describe(&x, "", &job);
    job.train = *b;
    manifest_describe(&y, "", &job);
    same = !x.failed && !y.failed && !strcmp(x.data, y.data);
    text_free(&x);
    text_free(&y);
    return same;
}

TEST(tradeoff_rows_differ_by_one_option_or_are_a_preset)
{
    static const char *const names[] = {"base", "coarse-0.25", "iterations-half", "paper"};
    struct study *s = study_test_of(&TRADEOFF_KIND, &study_test_two_seeds, 4, names);
    const oxl_job_options base = study_job(s, 0, 3), half = study_job(s, 2, 1), paper = study_job(s, 3, 1);
    oxl_job_options coarse = study_job(s, 1, 3);
    const oxl_train_options standard = oxl_train_options_default(OXL_PRESET_PAPER);
    CHECK(coarse.seed == 3 && coarse.train.coarse == 0.25f && half.train.iterations == 350);
    CHECK(study_test_same_options(&base.train, &s->base.train) &&
          !study_test_same_options(&coarse.train, &base.train));
    coarse.train.coarse = base.train.coarse;
    CHECK(study_test_same_options(&coarse.train, &base.train));
    CHECK(study_test_same_options(&paper.train, &standard) &&
          !study_test_same_options(&half.train, &standard));
    free(s);
}

/* Nothing of what the paper does not have. */
TEST(tradeoff_options_are_off_in_the_papers_preset)
{
    const oxl_train_options o = oxl_train_options_default(OXL_PRESET_PAPER);
    CHECK(o.coarse == 0 && o.alpha_min == 1.0f / 255 && o.iterations == 40000 && o.short_run_exponent == 0);
}

/* Rows that others are compared with, or made equal to, exist and precede the controls. */
TEST(study_rows_name_options_and_rows_of_their_study)
{
    NEEDS_PART(ucd);
    NEEDS_PART(prune);
    NEEDS_PART(lobes);
    NEEDS_PART(sh_degree);
    const struct study_kind *const kinds[] = {&ABLATE_KIND, &TRADEOFF_KIND};
    oxl_job_options job = oxl_job_options_default(OXL_PRESET_DRAFT);
    for (int k = 0; k < 2; k++) {
        CHECK(kinds[k]->rows <= STUDY_ROWS && kinds[k]->by_default <= kinds[k]->rows);
        for (int r = 0; r < kinds[k]->rows; r++) {
            const struct study_row *row = &kinds[k]->row[r];
            CHECK(study_find_row(kinds[k], row->name, strlen(row->name)) == row);
            for (int i = 0; i < STUDY_AGAINST; i++)
                CHECK(!row->against[i] || study_find_row(kinds[k], row->against[i], strlen(row->against[i])));
            for (int i = 0; i < STUDY_OPTIONS && row->option[i][0]; i++)
                CHECK(oxl_option_set(oxl_option_find(row->option[i][0]), &job, row->option[i][1], NULL, 0) ==
                      OXL_OK);
            CHECK(!row->like == !row->equal);
            CHECK(!row->like || study_find_row(kinds[k], row->like, strlen(row->like)) < row);
        }
    }
}

static oxl_result study_test_run(oxl_result (*run)(oxl_context *ctx, const study_options *o, FILE *to),
                                 const char *rows, int seeds)
{
    study_options o = {
        .scene = "nowhere", .out = test_path("out"), .rows = rows, .seeds = seeds, .budget = 60};
    o.job = oxl_job_options_default(OXL_PRESET_DRAFT);
    return run(test_ctx, &o, stdout);
}

TEST(study_refuses_invalid_rows)
{
    CHECK(study_test_run(ablate_run, "v1,v9", 1) == OXL_ERR_USAGE);
    CHECK_TEXT(oxl_error_text(test_ctx), "'v9'");
    CHECK_TEXT(oxl_error_text(test_ctx), "3dgs v1 v2 v1-count v3 v4 oceanxl v3-bytes v3-315 auto");
    CHECK(study_test_run(ablate_run, "v1,v1", 1) == OXL_ERR_USAGE);
    CHECK(study_test_run(ablate_run, "v1,v1-count", 1) == OXL_ERR_USAGE);
    CHECK_TEXT(oxl_error_text(test_ctx), "fix: --rows v2,v1-count");
    CHECK(study_test_run(tradeoff_run, "coarse-0.5,fast", 1) == OXL_ERR_USAGE);
    CHECK_TEXT(oxl_error_text(test_ctx), "iterations-half coarse-0 ");
    CHECK(study_test_run(tradeoff_run, "coarse-0.5,coarse-0.5", 1) == OXL_ERR_USAGE);
}

/* As where a build has not the part of training that an option belongs to. */
TEST(study_refuses_rows_whose_options_the_build_does_not_have)
{
    static const struct study_row plain = {.name = "plain", .option = {{"cooldown", "0"}}},
                                  odd = {.name = "odd", .option = {{"cooldown", "0"}, {"no-such", "1"}}};
    struct study s = {.rows = 2, .row = {&plain, &plain}};
    s.meter.ctx = test_ctx;
    CHECK_OK(study_check_options(&s));
    s.row[1] = &odd;
    CHECK(study_check_options(&s) == OXL_ERR_USAGE);
    CHECK_TEXT(oxl_error_text(test_ctx), "row odd sets --no-such");
}

TEST(study_finds_the_threshold_of_an_equal_count_in_a_few_trials)
{
    for (double power = -2; power < -0.4; power += 0.5) /* of the count over the threshold */
        for (double wanted = 0.5; wanted < 4; wanted *= 1.5) {
            double threshold[STUDY_TRIALS], off[STUDY_TRIALS], least = HUGE_VAL, next = log(STUDY_GUESS);
            for (int k = 0; k < STUDY_TRIALS; k++) {
                threshold[k] = next;
                off[k] = power * threshold[k] - log(wanted);
                least = fmin(least, fabs(off[k]));
                next = study_next(threshold, off, k);
            }
            CHECK(least < STUDY_ALIKE);
        }
}

/* ---------------- trainings */

/* A survey of the training tests on disk would be long; a job that is finished is only read: metrics.json
 * decides what is found. */
TEST(study_reads_what_a_training_left_and_says_when_it_is_not_whole)
{
    char folder[300];
    struct study_meter s = {.ctx = test_ctx};
    struct study_result r;
    snprintf(folder, sizeof folder, "%s", test_folder());
    test_write(
        "metrics.json",
        "{\n  \"split\": \"test\",\n  \"psnr\": 25.5, \"ssim\": 0.75, \"structure\": 0.875, \"structure_least\": 0.5, \"training\": "
        "{\"structure_least\": 0.25}, \"ms_ssim\": 0.875, \"gaussians\": 1000, "
        "\"bytes\": 5e4, \"seconds\": 12, \"blocks\": 3,\n  \"by_depth\": {\"near_psnr\": 20, \"mid_psnr\": 21, "
        "\"far_psnr\": null}\n}\n");
    CHECK_OK(study_read_metrics(&s, folder, &r));
    CHECK(r.value[STUDY_PSNR] == 25.5 && r.value[STUDY_BYTES] == 5e4 && r.value[STUDY_MIDDLE] == 21 &&
          isnan(r.value[STUDY_FAR]));
    CHECK(r.value[STUDY_STRUCTURE] == 0.875 && r.value[STUDY_LEAST] == 0.25);
    CHECK(r.blocks == 3 && r.held_out == 1);
    test_write("metrics.json", "{\"psnr\": 25.5}\n");
    CHECK(study_read_metrics(&s, folder, &r) == OXL_ERR_INPUT);
    CHECK_TEXT(oxl_error_text(test_ctx), "metrics.json");
}

/* begun 1: trained from its start; 2: in parts; 0: finished before. */
TEST(study_remembers_peak_and_processor_time_over_the_parts_of_a_training)
{
    static const struct {
        int started, peak;
        double cpu, wanted_peak, wanted_cpu;
    } parts[] = {
        {1, 5000, 7, 5000, 7}, {2, 3000, 2.5, 5000, 9.5}, {0, 9000, 1, 5000, 9.5}, {1, 4000, 1, 4000, 1}};
    char folder[300];
    snprintf(folder, sizeof folder, "%s", test_folder());
    for (int i = 0; i < 4; i++) {
        struct cli_memory memory = {.peak = (size_t)parts[i].peak};
        const study_options options = {.memory = &memory};
        struct study_meter s = {test_ctx, &options, parts[i].started, 0, parts[i].cpu};
        double value[STUDY_MEASURES];
        CHECK_OK(study_record_cost(&s, folder, value));
        CHECK_CLOSE(value[STUDY_MEMORY], parts[i].wanted_peak, 0);
        CHECK_CLOSE(value[STUDY_CPU], parts[i].wanted_cpu, 1e-12);
    }
}

TEST(study_counts_processor_time_from_the_first_step_of_one_block_or_of_the_coarse_model)
{
    static const struct {
        int iteration, block, blocks, started;
        enum oxl_stage stage;
    } first[] = {{1, 0, 1, 1, OXL_STAGE_BLOCK}, {1, 0, 3, 1, OXL_STAGE_COARSE},
                 {9, 0, 1, 2, OXL_STAGE_BLOCK}, {9, 0, 3, 2, OXL_STAGE_COARSE},
                 {1, 0, 3, 2, OXL_STAGE_BLOCK}, {400, 0, 3, 2, OXL_STAGE_MERGED}};
    for (size_t i = 0; i < OXL_COUNT(first); i++) {
        const study_options none = {0};
        const oxl_progress p = {.iteration = first[i].iteration,
                                .block = first[i].block,
                                .blocks = first[i].blocks,
                                .stage = first[i].stage};
        struct study_meter s = {.options = &none};
        CHECK(study_progress(&s, &p) == 0 && s.started == first[i].started);
    }
}

TEST(study_reads_numbers_as_metrics_json_has_them)
{
    const char *json =
        "{\n  \"standard\": {\"psnr\": 2, \"ssim\": 1},\n  \"gaussians\": 12345,\n  \"ssim\": 0.71828182845904523,\n"
        "  \"small\": -2.5e-05, \"large\": 1e+20,\n  \"none\": null }";
    CHECK_CLOSE(oxl_json_number(json, "gaussians"), 12345, 0);
    CHECK_CLOSE(oxl_json_number(json, "ssim"), 0.71828182845904523, 1e-15);
    CHECK_CLOSE(oxl_json_number(json, "small"), -2.5e-5, 1e-18);
    CHECK_CLOSE(oxl_json_number(json, "large"), 1e20, 1e6);
    CHECK(isnan(oxl_json_number(json, "none")) && isnan(oxl_json_number(json, "psnr")) &&
          isnan(oxl_json_number(NULL, "psnr")));
}

/* test_study.c - what a study says is what its runs left: rows, comparisons, controls, the front; its page and
 * CSV. */
#include "test.h"
#include "../lab/studies.c"
#include "../lab/study.c"
#include "../lab/study_page.c"
#include "../lab/results.c"

static const study_options study_test_two_seeds = {.out = "nowhere", .name = "tradeoff", .seeds = 2};

/* Rows of the kind by name, two seeds of each, with PSNR, SSIM, Gaussians, bytes, seconds, CPU s, memory;
 * free() it. */
static struct study *study_test_of(const struct study_kind *kind, int rows, const char *const *name,
                                   double value[][2][7])
{
    static const enum study_measure to[7] = {STUDY_PSNR,    STUDY_SSIM, STUDY_GAUSSIANS, STUDY_BYTES,
                                             STUDY_SECONDS, STUDY_CPU,  STUDY_MEMORY};
    struct study *s = calloc(1, sizeof *s);
    CHECK(s != NULL);
    s->ctx = test_ctx;
    s->kind = kind;
    s->options = &study_test_two_seeds;
    s->survey = "dives/reef";
    s->base = oxl_job_options_default(OXL_PRESET_DRAFT);
    s->base.train.iterations = 700;
    s->rows = rows;
    for (int r = 0; r < rows; r++) {
        s->row[r] = study_find_row(kind, name[r], strlen(name[r]));
        CHECK(s->row[r] != NULL);
        s->done[r] = 2;
        for (int i = 0; i < 2 * STUDY_MEASURES; i++)
            s->value[r][i / STUDY_MEASURES][i % STUDY_MEASURES] = NAN;
        for (int i = 0; value && i < 14; i++) s->value[r][i / 7][to[i % 7]] = value[r][i / 7][i % 7];
    }
    return s;
}

/* The baseline, V1, V2 and V1 with V2's count; the memory of V1's second seed is not known. */
static struct study *study_test_ablation(void)
{
    static const char *const names[] = {"3dgs", "v1", "v2", "v1-count"};
    static double value[4][2][7] = {
        {{22, 0.70, 1000, 2e6, 100, 90, 50e6}, {24, 0.80, 3000, 4e6, 200, 190, 70e6}},
        {{22.5, 0.71, 900, 1e6, 80, 70, 40e6}, {25, 0.83, 2700, 2e6, 160, 150, NAN}},
        {{23, 0.72, 1200, 3e6, 90, 80, 45e6}, {25.2, 0.84, 3300, 5e6, 170, 160, 45e6}},
        {{23.1, 0.72, 1190, 3e6, 90, 80, 45e6}, {25, 0.84, 3310, 5e6, 170, 160, 45e6}}};
    return study_test_of(&STUDY_KINDS[STUDY_ABLATION], 4, names, value);
}

/* The base, half its iterations, coarse-0.5 (cheaper and better than half), keep-0.5 (dearer and worse than
 * the base; one seed), and the paper's preset, which was not trained. */
static struct study *study_test_sweep(void)
{
    static const char *const names[] = {"base", "iterations-half", "coarse-0.5", "keep-0.5", "paper"};
    static double value[5][2][7] = {
        {{30, 0.90, 1000, 10e6, 60, 100, 50e6}, {31, 0.92, 1000, 10e6, 70, 120, 50e6}},
        {{28, 0.85, 800, 8e6, 30, 50, 40e6}, {29, 0.87, 800, 8e6, 35, 60, 40e6}},
        {{29.5, 0.88, 1000, 10e6, 30, 40, 50e6}, {30.5, 0.90, 1000, 10e6, 30, 48, 50e6}},
        {{29.9, 0.89, 900, 9e6, 62, 110, 50e6}, {0}}};
    struct study *s = study_test_of(&STUDY_KINDS[STUDY_TRADEOFF], 5, names, value);
    s->done[3] = 1, s->done[4] = 0;
    return s;
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
    s->done[1] = 1;
    CHECK_CLOSE(study_compare(s, 1, 0, STUDY_PSNR).mean, 0.5, 1e-12); /* of the one seed that both have */
    s->done[1] = 0;
    CHECK(isnan(study_compare(s, 1, 0, STUDY_PSNR).mean));
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

/* ---------------- page, CSV */

/* Counts in the first line that starts so. */
static int study_test_count(const char *text, const char *start, char what)
{
    const char *line = strstr(text, start);
    int found = 0;
    CHECK(line != NULL);
    for (line += line && *line == '\n'; line && *line && *line != '\n'; line++) found += *line == what;
    return found;
}

TEST(study_page_says_none_where_an_effect_is_within_the_spread_and_has_whole_tables)
{
    struct study *s = study_test_ablation();
    for (int seeds = 2; seeds > 0; seeds--) {
        struct output t = {0};
        for (int r = 0; r < s->rows; r++) s->done[r] = seeds;
        study_section(&t, s, 1);
        CHECK(!t.failed && !strstr(t.data, "nan") && !strstr(t.data, "inf"));
        CHECK(!strstr(t.data, "| 23.00 +-1.41 |") == (seeds == 1));
        CHECK(!strstr(t.data, "| reef | V1 +BSP against 3DGS, midpoint | - | +0.75 +-0.35 |") ==
              (seeds == 1));
        CHECK(!strstr(t.data, "| V2 +UCD against V1, count of V2 | - | none |") == (seeds == 1));
        CHECK(!strstr(t.data, "Not trained within the budget on reef: 3dgs (1 of 2 seeds), v1 (1 of 2") ==
              (seeds == 2));
        CHECK_TEXT(t.data, "| x0.7");
        CHECK(study_test_count(t.data, "| scene | row |", '|') ==
              study_test_count(t.data, "| reef | V1 +BSP \\*", '|'));
        CHECK(study_test_count(t.data, "| scene | row against", '|') ==
              study_test_count(t.data, "| reef | V2 +UCD against", '|'));
        free(t.data);
    }
    free(s);
}

TEST(study_page_of_a_sweep_says_the_front_and_what_was_not_trained)
{
    struct study *s = study_test_sweep();
    struct output t = {0};
    study_section(&t, s, 1);
    CHECK_TEXT(t.data, "| --coarse 0.5 \\* |");
    CHECK_TEXT(t.data, "| --coarse 0.5 against base |");
    CHECK_TEXT(t.data, " x0.400 +-0.000 |");
    CHECK_TEXT(t.data,
               "Not trained within the budget on reef: keep-0.5 (1 of 2 seeds), paper (0 of 2 seeds)\n");
    free(t.data);
    free(s);
}

TEST(study_csv_holds_every_run_in_whole_lines)
{
    struct study *s = study_test_ablation();
    struct output page = {0}, t = {0};
    int commas = 0, lines = 0;
    results_begin(&page, &t, &study_test_two_seeds);
    study_csv(&t, s, 1);
    CHECK_TEXT(
        t.data,
        "study,scene,row,seed,iterations,psnr,shown_psnr,ssim,structure,gaussians,bytes,seconds,cpu_seconds,"
        "library_peak_bytes\n");
    CHECK_TEXT(
        t.data,
        "\nablation,reef,v1,2,,25.000000,,0.830000,,2700.000000,2000000.000000,160.000000,150.000000,\n");
    for (const char *p = t.data; *p; p++) {
        commas += *p == ',';
        if (*p != '\n') continue;
        CHECK(commas == 3 + STUDY_MEASURES);
        commas = 0, lines++;
    }
    CHECK(lines == 1 + 8);
    free(page.data);
    free(t.data);
    free(s);
}

/* ---------------- the budget */

/* The base takes 65 s for 700 iterations, and 20 of the second row before it is there; then a row that is finished,
 * one that has begun, and one of another build. */
TEST(study_trains_what_fits_the_budget_from_the_first_row_on_and_keeps_what_is_there)
{
    const char *const builds[] = {STUDY_BUILD, STUDY_BUILD, "another"};
    struct study *s = study_test_sweep();
    study_options o = study_test_two_seeds;
    o.out = test_folder(), s->options = &o;
    CHECK(study_is_due(s, 2, 2, 70) && !study_is_due(s, 2, 2, 60));
    CHECK(study_is_due(s, 0, 2, 70) && !study_is_due(s, 0, 2, 60)); /* the first row, too */
    CHECK(!study_is_due(s, 4, 2, 1e9));                             /* seed 1 is missing */
    s->done[0] = 0, s->predicted = 40;
    CHECK(study_is_due(s, 0, 1, 41) && !study_is_due(s, 0, 1, 39));
    CHECK(study_is_due(s, 1, 1, 21) && !study_is_due(s, 1, 1, 19)); /* half the iterations */
    for (int k = 0; k < 3; k++) {
        char record[200];
        snprintf(record, sizeof record, "{\"build\": \"%s\", \"finished\": %s}", builds[k],
                 k ? "false" : "true");
        test_write("reef/iterations-half-seed2/study.json", record);
        CHECK(study_is_due(s, 1, 2, 0) == (k < 2));
    }
    free(s);
}

/* ---------------- rows */

TEST(ablate_rows_differ_by_what_the_paper_switches_and_nothing_else)
{
    NEEDS_PART(ucd);
    NEEDS_PART(prune);
    NEEDS_PART(lobes);
    static const char *const names[] = {"3dgs", "v2", "v1-count", "oceanxl", "v3-bytes"};
    struct study *s = study_test_of(&STUDY_KINDS[STUDY_ABLATION], 5, names, NULL);
    oxl_job_options job[5];
    s->value[3][0][STUDY_BYTES] = 123456, s->value[1][0][STUDY_GAUSSIANS] = 789;
    for (int r = 0; r < 5; r++) CHECK_OK(study_job(s, r, 1, &job[r]));
    CHECK(job[0].seed == 1 && job[0].partition.cut == OXL_CUT_MIDPOINT && job[0].train.ucd == OXL_UCD_OFF);
    CHECK(job[0].train.keep.kind == OXL_KEEP_ALL && job[0].train.dog == OXL_DOG_OFF);
    CHECK(job[1].partition.cut == OXL_CUT_BALANCED && job[1].train.ucd == OXL_UCD_ON &&
          job[1].train.keep.kind == OXL_KEEP_ALL);
    CHECK(job[2].train.max_gaussians == 789 && job[2].train.ucd == OXL_UCD_OFF);
    CHECK(job[3].train.keep.value == 0.5 && job[3].train.dog == OXL_DOG_SELECTIVE);
    CHECK(job[4].train.keep.kind == OXL_KEEP_BYTES && job[4].train.keep.value == 123456 &&
          job[4].train.dog == OXL_DOG_OFF);
    for (int r = 0; r < 5; r++)
        CHECK(job[r].train.iterations == 700 &&
              job[r].train.densify_gradient == s->base.train.densify_gradient * (r == 2 ? STUDY_DENSER : 1));
    free(s);
}

/* By the texts of all options; structs have gaps that a copy need not keep. Returns how many differ. */
static int study_test_different(const oxl_train_options *a, const oxl_train_options *b)
{
    oxl_job_options job[2] = {oxl_job_options_default(OXL_PRESET_DRAFT),
                              oxl_job_options_default(OXL_PRESET_DRAFT)};
    int different = 0;
    job[0].train = *a, job[1].train = *b;
    for (int i = 0; i < oxl_option_count(); i++) {
        char text[2][300];
        for (int k = 0; k < 2; k++) oxl_option_get(oxl_option_at(i), &job[k], text[k], sizeof text[k]);
        different += strcmp(text[0], text[1]) != 0;
    }
    return different;
}

TEST(tradeoff_rows_differ_by_one_option_or_are_a_preset)
{
    static const char *const names[] = {"base", "coarse-0", "iterations-half", "paper"};
    struct study *s = study_test_of(&STUDY_KINDS[STUDY_TRADEOFF], 4, names, NULL);
    const oxl_train_options paper = oxl_train_options_default(OXL_PRESET_PAPER);
    oxl_job_options job[4];
    s->base.train.coarse = 0.5f;
    for (int r = 0; r < 4; r++) CHECK_OK(study_job(s, r, 3, &job[r]));
    CHECK(job[1].seed == 3 && job[1].train.coarse == 0 && job[2].train.iterations == 350);
    CHECK(study_test_different(&job[0].train, &s->base.train) == 0);
    CHECK(study_test_different(&job[1].train, &job[0].train) == 1);
    CHECK(study_test_different(&job[2].train, &job[0].train) == 1);
    CHECK(study_test_different(&job[3].train, &paper) == 0 && study_test_different(&job[2].train, &paper));
    free(s);
}

/* Skips a test of all studies in a build without a part that one of them varies. */
#define NEEDS_PARTS_OF_STUDIES() \
    NEEDS_PART(ucd);             \
    NEEDS_PART(prune);           \
    NEEDS_PART(lobes);           \
    NEEDS_PART(sh_degree);       \
    NEEDS_PART(medium);          \
    NEEDS_PART(exposure);        \
    NEEDS_PART(lamp)

/* Rows that others are compared with, or made equal to, exist and precede the controls. */
TEST(study_rows_name_options_and_rows_of_their_study)
{
    NEEDS_PARTS_OF_STUDIES();
    oxl_job_options job = oxl_job_options_default(OXL_PRESET_DRAFT);
    for (int k = 0; k < STUDY_ALL; k++) {
        const struct study_kind *kind = &STUDY_KINDS[k];
        CHECK(kind->rows <= STUDY_ROWS);
        for (int r = 0; r < kind->rows; r++) {
            const struct study_row *row = &kind->row[r];
            for (int other = 0; other < STUDY_ALL; other++) /* the studies share a folder */
                CHECK(study_find_row(&STUDY_KINDS[other], row->name, strlen(row->name)) ==
                      (other == k ? row : NULL));
            for (int i = 0; i < STUDY_AGAINST && row->against[i]; i++)
                CHECK(study_find_row(kind, row->against[i], strlen(row->against[i])) != NULL);
            CHECK_OK(study_set_options(test_ctx, row, &job));
            CHECK(!row->like == !row->equal);
            CHECK(!row->like || study_find_row(kind, row->like, strlen(row->like)) < row);
        }
    }
}

TEST(study_refuses_rows_that_are_not_there_are_twice_or_lack_an_option)
{
    static const struct {
        int study;
        const char *rows, *said;
    } wrong[] = {
        {STUDY_ABLATION, "v1,v9", "found 'v9'"},
        {STUDY_ABLATION, "v1,v9", "3dgs v1 v2 v1-count v3 v4 oceanxl v3-bytes"},
        {STUDY_ABLATION, "v1,v1", "at most once"},
        {STUDY_ABLATION, "v1,v1-count", "controls after their rows"},
        {STUDY_TRADEOFF, "fast", ": iterations-half iterations-sixteenth iterations-quarter coarse-0 "},
        {STUDY_TRADEOFF, "coarse-0.5,coarse-0.5", "at most once"}};
    static const struct study_row odd = {.name = "odd", .options = "cooldown=0 no-such=1"};
    oxl_job_options job = oxl_job_options_default(OXL_PRESET_DRAFT);
    const char *const survey = "nowhere";
    for (size_t i = 0; i < OXL_COUNT(wrong); i++) {
        study_options o = {.survey = &survey, .surveys = 1, .out = test_path("out"), .name = "x", .seeds = 1};
        o.job = job, o.rows = wrong[i].rows, o.studies = 1u << wrong[i].study;
        CHECK_ERROR(study_run(test_ctx, &o, stdout), OXL_ERR_USAGE, wrong[i].said);
    }
    CHECK_ERROR(study_set_options(test_ctx, &odd, &job), OXL_ERR_USAGE, "row odd sets --no-such");
}

TEST(results_of_published_scenes_are_those_of_their_own_study_alone)
{
    NEEDS_PARTS_OF_STUDIES();
    const char *surveys[2];
    char scene[300];
    study_options o = {.survey = surveys, .surveys = 2, .out = "out", .name = "results", .seeds = 1};
    struct study *s = calloc(2 * STUDY_ALL, sizeof *s);
    oxl_result rc = OXL_OK;
    o.job = oxl_job_options_default(OXL_PRESET_DRAFT);
    test_write("llff/poses_bounds.npy", "");
    snprintf(scene, sizeof scene, "%s", test_path("llff"));
    surveys[0] = test_path("dive"), surveys[1] = scene;
    o.studies = (1u << STUDY_ALL) - 1;
    CHECK(results_plan(test_ctx, &o, s, &rc) == STUDY_ALL && rc == OXL_OK);
    for (int i = 0; i < STUDY_ALL; i++) CHECK(s[i].kind->is_published == (s[i].survey == scene));
    o.studies = 1u << STUDY_ABLATION; /* of a command of its own, on any survey */
    CHECK(results_plan(test_ctx, &o, s, &rc) == 2);
    free(s);
}

/* ---------------- trainings */

TEST(study_reads_what_a_training_left_and_says_when_it_is_not_whole)
{
    struct study s = {.ctx = test_ctx};
    double value[STUDY_MEASURES];
    char folder[300];
    snprintf(folder, sizeof folder, "%s", test_folder());
    test_write("metrics.json",
               "{\n  \"split\": \"test\",\n  \"psnr\": 25.5, \"ssim\": 0.75, \"structure\": 0.875, "
               "\"gaussians\": 1000, \"bytes\": 5e4, \"seconds\": 12, \"iterations\": 9\n}\n");
    test_write("study.json", "{\"cpu_seconds\": 20}\n");
    CHECK_OK(study_read(&s, folder, value));
    CHECK(value[STUDY_PSNR] == 25.5 && value[STUDY_BYTES] == 5e4 && value[STUDY_CPU] == 20);
    CHECK(value[STUDY_STRUCTURE] == 0.875 && value[STUDY_ITERATIONS] == 9 && isnan(value[STUDY_MEMORY]));
    test_write("metrics.json", "{\"psnr\": 25.5}\n");
    CHECK_ERROR(study_read(&s, folder, value), OXL_ERR_INPUT, "metrics.json");
}

/* Trained from its start; in parts; finished before; from its start again; after the process was killed, which leaves
 * the record of the first step. */
TEST(study_remembers_peak_and_processor_time_over_the_parts_of_a_training)
{
    static const struct {
        int fresh, peak;
        double cpu, wanted_peak, wanted_cpu;
    } parts[] = {{1, 5000, 7, 5000, 7},
                 {0, 3000, 2.5, 5000, 9.5},
                 {-1, 9000, 1, 5000, 9.5},
                 {1, 4000, 1, 4000, 1},
                 {0, 4000, 1, NAN, NAN}};
    struct cli_memory memory = {0};
    const study_options options = {.memory = &memory};
    struct study s = {.ctx = test_ctx, .options = &options};
    snprintf(s.folder, sizeof s.folder, "%s", test_folder());
    for (int i = 0; i < 5; i++) {
        const oxl_progress first = {.iteration = 9, .blocks = 1};
        s.is_fresh = -1;
        if (i == 4) CHECK(study_progress(&s, &first) == 0);
        struct study_record r = study_read_record(s.folder);
        CHECK(r.is_there == (i > 0) && r.is_ours == (i > 0) && r.is_finished == (i == 3));
        memory.peak = (size_t)parts[i].peak, s.is_fresh = parts[i].fresh, s.cpu = study_cpu() - parts[i].cpu;
        study_add_cost(&s, &r);
        r.is_finished = i == 2;
        CHECK_OK(study_write_record(test_ctx, s.folder, &r));
        r = study_read_record(s.folder);
        CHECK(isnan(parts[i].wanted_cpu) ? isnan(r.cpu) : fabs(r.cpu - parts[i].wanted_cpu) < 0.05);
        CHECK(r.peak == parts[i].wanted_peak || isnan(parts[i].wanted_cpu));
    }
}

TEST(study_counts_processor_time_from_the_first_step_of_one_block_or_of_the_coarse_model)
{
    static const struct {
        int iteration, block, blocks, fresh;
        enum oxl_stage stage;
    } first[] = {{1, 0, 1, 1, OXL_STAGE_BLOCK}, {1, 0, 3, 1, OXL_STAGE_COARSE},
                 {9, 0, 1, 0, OXL_STAGE_BLOCK}, {9, 0, 3, 0, OXL_STAGE_COARSE},
                 {1, 0, 3, 0, OXL_STAGE_BLOCK}, {400, 0, 3, 0, OXL_STAGE_MERGED}};
    for (size_t i = 0; i < OXL_COUNT(first); i++) {
        const oxl_progress p = {.iteration = first[i].iteration,
                                .block = first[i].block,
                                .blocks = first[i].blocks,
                                .stage = first[i].stage};
        struct study s = {.ctx = test_ctx, .options = &study_test_two_seeds, .is_fresh = -1};
        snprintf(s.folder, sizeof s.folder, "%s", test_folder());
        CHECK(study_progress(&s, &p) == 0 && s.is_fresh == first[i].fresh);
    }
}

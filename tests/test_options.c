/* test_options.c - the table of options: what it promises of defaults, texts, ranges and run.json. */
#include "test.h"

TEST(options_have_names_of_their_own_and_one_place_each_in_run_json)
{
    CHECK(oxl_option_at(0)->kind == OXL_OPTION_PRESET);
    for (int i = 0; i < oxl_option_count(); i++) {
        const oxl_option *o = oxl_option_at(i);
        CHECK(oxl_option_find(o->name) == o && strlen(o->name) < 32 && o->group && o->help);
        for (int k = 0; k < i; k++) CHECK(oxl_option_at(k)->at != o->at || k == 0);
    }
    CHECK(!oxl_option_find("no-such-option"));
}

TEST(options_of_every_preset_are_in_range_and_their_texts_read_back)
{
    for (int preset = 0; preset < 3; preset++) {
        oxl_job_options o = oxl_job_options_default((oxl_preset)preset);
        CHECK_OK(oxl_job_options_check(test_ctx, &o));
        CHECK(strcmp(o.preset, oxl_option_at(0)->preset[preset]) == 0);
        for (int i = 1; i < oxl_option_count(); i++) {
            const oxl_option *row = oxl_option_at(i);
            oxl_job_options read = {0};
            char text[128], again[128];
            if (row->kind == OXL_OPTION_TEXT) continue;
            CHECK(row->preset[preset] != NULL);
            CHECK(oxl_option_set(row, &read, oxl_option_get(row, &o, text, sizeof text), NULL, 0) == OXL_OK);
            CHECK(strcmp(oxl_option_get(row, &read, again, sizeof again), text) == 0);
        }
    }
}

/* The values that the paper states (sec. 4: iterations) and Kerbl 2023's code (rates but that of positions, alpha_min, gradient). */
TEST(options_of_preset_paper_are_those_of_the_paper_and_of_kerbl)
{
    const oxl_train_options o = oxl_train_options_default(OXL_PRESET_PAPER);
    CHECK(o.iterations == 40000 && o.lr_position == 1.6e-4f && o.lr_position_final == 1.6e-6f);
    CHECK(o.lr_sh == 0.0025f / 20 && o.alpha_min == 1.0f / 255 && o.densify_gradient == 2e-4f);
    CHECK(o.coarse == 0 && o.short_run_exponent == 0);
}

/* The paper's UCD, keep and second lobes (sec. 4), and Kerbl's degree. */
TEST(options_of_parts_in_preset_paper_are_those_of_the_paper)
{
    const oxl_train_options o = oxl_train_options_default(OXL_PRESET_PAPER);
    NEEDS_PART(ucd);
    NEEDS_PART(prune);
    NEEDS_PART(lobes);
    NEEDS_PART(sh_degree);
    CHECK(o.sh_degree == 3 && o.ucd == OXL_UCD_SEARCH);
    CHECK(o.keep.kind == OXL_KEEP_FRACTION && o.keep.value == 0.5 && o.dog == OXL_DOG_SELECTIVE);
}

TEST(options_of_floats_are_the_shortest_text_of_the_same_bits)
{
    oxl_job_options a = oxl_job_options_default(OXL_PRESET_DRAFT), b = a;
    const oxl_option *row = oxl_option_find("cooldown");
    char text[64];
    a.train.cooldown = 0.1f;
    CHECK(strcmp(oxl_option_get(row, &a, text, sizeof text), "0.1") == 0);
    for (uint64_t i = 0; i < 3000; i++) {
        const float v = (float)((double)(random_bits(3, i, 0) >> 11) * 0x1p-53) * (i % 3 ? 1 : 1e-6f);
        a.train.cooldown = v;
        CHECK(oxl_option_set(row, &b, oxl_option_get(row, &a, text, sizeof text), NULL, 0) == OXL_OK &&
              b.train.cooldown == v);
    }
}

TEST(options_are_named_as_fields_in_texts_for_programs)
{
    test_ctx->options.command_line = 0;
    oxl_fail(test_ctx, OXL_ERR_MEMORY,
             "by --max-side or --image-cache; colmap --output_path, --partition none, --force");
    CHECK(!strcmp(
        oxl_error_text(test_ctx),
        "by max_side or image_cache_bytes; colmap --output_path, partition.kind none, allow_truncated"));
    oxl_fail(test_ctx, OXL_ERR_MEMORY, "%*s--image-cache", (int)sizeof test_ctx->error - 14, "");
    test_ctx->options.command_line = 1;
    CHECK_SAYS(" image_cache_");
    oxl_fail(test_ctx, OXL_ERR_MEMORY, "limit it by --max-side");
    CHECK_SAYS("limit it by --max-side");
}

TEST(options_are_named_as_fields_in_the_warnings_of_a_survey)
{
    OWNED_IMAGE image = test_image(8, 8);
    const char *survey = job_test_survey();
    static oxl_survey s;
    test_write_image(test_path("survey/images/more.png"), &image);
    for (int program = 0; program < 2; program++) {
        test_ctx->options.command_line = !program;
        CHECK_OK(oxl_check(test_ctx, survey, NULL, 0, &s));
        CHECK_TEXT(s.warnings, program ? "by sparse" : "by --sparse");
    }
    test_ctx->options.command_line = 1;
}

TEST(options_of_sizes_and_times_are_read_as_people_write_them)
{
    static const struct {
        const char *name, *text, *same;
    } written[] = {
        {"ram", "4 GB", "4G"},
        {"ram", "512mib", "512M"},
        {"ram", "4096 MB", "4G"},
        {"max-time", "1h30m", "90m"},
        {"max-time", "2 hours 5 min", "125m"},
        {"max-time", "90 s", "90"},
        {"max-gaussians", "1.5M", "1500000"},
        {"iterations", "30k", "30000"},
    };
    static const char *const wrong[][3] = {{"ram", "4 X", "fix: --ram 4G"},
                                           {"max-time", "1h30", "fix: --max-time 90m"},
                                           {"max-gaussians", "many", "fix: --max-gaussians N"},
                                           {"max-gaussians", "1.5", "fix: --max-gaussians N"}};
    char text[64], error[300];
    for (size_t i = 0; i < OXL_COUNT(written); i++) {
        oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT), same = o;
        const oxl_option *row = oxl_option_find(written[i].name);
        CHECK_OK(oxl_option_set(row, &o, written[i].text, NULL, 0));
        CHECK_OK(oxl_option_set(row, &same, written[i].same, NULL, 0));
        CHECK(!memcmp((char *)&o + row->at, (char *)&same + row->at,
                      row->kind == OXL_OPTION_INT ? sizeof(int) : sizeof(double)));
        CHECK_OK(oxl_option_set(row, &same, oxl_option_get(row, &o, text, sizeof text), NULL, 0));
    }
    for (size_t i = 0; i < OXL_COUNT(wrong); i++) {
        oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
        CHECK(oxl_option_set(oxl_option_find(wrong[i][0]), &o, wrong[i][1], error, sizeof error) ==
              OXL_ERR_USAGE);
        CHECK_TEXT(error, wrong[i][2]);
    }
}

static void options_test_refusal(const char *name, const char *text, const char *words)
{
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    char before[64], after[64], error[400] = "", start[64];
    oxl_option_get(oxl_option_find(name), &o, before, sizeof before);
    CHECK(oxl_option_set(oxl_option_find(name), &o, text, error, sizeof error) == OXL_ERR_USAGE);
    CHECK(strcmp(oxl_option_get(oxl_option_find(name), &o, after, sizeof after), before) == 0);
    snprintf(start, sizeof start, "option --%s: found '%s', ", name, text);
    CHECK(strncmp(error, start, strlen(start)) == 0);
    CHECK_TEXT(error, words);
    CHECK_TEXT(error, "\nfix: --");
}

/* Of an option of a part of training, where this build has the part. */
static void options_test_refusal_of(const char *part, const char *name, const char *text, const char *words)
{
    if (test_has_part(part)) options_test_refusal(name, text, words);
    else CHECK(!oxl_option_find(name));
}

TEST(options_that_cannot_be_are_refused_with_value_found_value_expected_and_a_fix)
{
    options_test_refusal("iterations", "0", "a whole number from 1 to 2147483647\nfix: --iterations 1200");
    options_test_refusal("iterations", "-3", "from 1");
    options_test_refusal("iterations", "2e3", "whole");
    options_test_refusal_of("sh_degree", "sh-degree", "4", "expected auto or a whole number from 0 to 3");
    options_test_refusal("cooldown", "1.5", "expected a number from 0 to 1");
    options_test_refusal("cooldown", "nan", "a number");
    options_test_refusal("alpha-min", "0.06", "0.05");
    options_test_refusal("alpha-min", "1/0", "0.05");
    options_test_refusal("ram", "4Q", "a size, e.g. 512M or 4G");
    options_test_refusal("max-time", "20q", "a time, e.g. 90s");
    options_test_refusal_of("lobes", "dog", "some", "expected off|selective|all");
    options_test_refusal("densify-gradient", "1.#IND", "a number"); /* not a number in files */
    options_test_refusal_of("ucd", "ucd", "3,2", "off|on|auto|search");
    options_test_refusal_of("prune", "keep", "0", "FRACTION");
    options_test_refusal_of("prune", "keep", "97350650T", "FRACTION"); /* more bytes than any option takes */
    options_test_refusal("background", "0,0,2", "auto|R,G,B");
    options_test_refusal("seed", "9007199254740992", "2^53");
}

TEST(options_check_names_the_one_that_is_out_of_range)
{
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    o.train.iterations = 0;
    CHECK_ERROR(oxl_job_options_check(test_ctx, &o), OXL_ERR_USAGE,
                "iterations is 0, expected a whole number from 1");
    CHECK(!strstr(oxl_error_text(test_ctx), "degree"));
    o = oxl_job_options_default(OXL_PRESET_DRAFT);
    o.train.cooldown = NAN;
    CHECK_ERROR(oxl_train_options_check(test_ctx, &o.train), OXL_ERR_USAGE,
                "cooldown is nan, expected a number from 0 to 1");
    o = oxl_job_options_default(OXL_PRESET_DRAFT);
    o.train.max_seconds = -1;
    CHECK_ERROR(oxl_job_options_check(test_ctx, &o), OXL_ERR_USAGE, "max_seconds is -1, expected a time");
    for (int value = -1; value < 4; value += 4) { /* OXL_ALPHA_AUTO is 0, OXL_ALPHA_MASK 2 */
        char said[32];
        o = oxl_job_options_default(OXL_PRESET_DRAFT);
        memcpy(&o.scene.alpha, &value, sizeof value);
        snprintf(said, sizeof said, "alpha is %d, expected", value);
        CHECK_ERROR(oxl_job_options_check(test_ctx, &o), OXL_ERR_USAGE, said);
    }
}

/* Another value than the default's for every option of the result. */
static oxl_job_options options_test_others(void)
{
    static const char *const texts[] = {"search",    "12345678B", "85%",         "true",  "2",        "0.04",
                                        "0.0003",    "0.2",       "4G",          "paper", "midpoint", "3d",
                                        "quantiles", "selective", "0.1,0.2,0.3", "on",    "off",      "mask"};
    oxl_job_options o = oxl_job_options_default(OXL_PRESET_DRAFT);
    const oxl_job_options plain = o;
    for (int i = 1; i < oxl_option_count(); i++) {
        const oxl_option *row = oxl_option_at(i);
        char was[128], now[128];
        if (!(row->use & OXL_OPTION_OF_RESULT)) continue;
        oxl_option_get(row, &plain, was, sizeof was);
        for (size_t k = 0; k < OXL_COUNT(texts); k++) {
            if (strcmp(oxl_option_get(row, &o, now, sizeof now), was) != 0) break;
            oxl_option_set(row, &o, texts[k], NULL, 0);
        }
        CHECK(strcmp(oxl_option_get(row, &o, now, sizeof now), was) != 0);
    }
    return o;
}

/* Rates of a refinement follow from the run's, and it fits a medium that the model has. */
TEST(options_that_a_refinement_must_not_have_are_off_in_it_and_others_stay)
{
    oxl_job_options others = options_test_others();
    others.train.medium = OXL_OFF;
    oxl_job_options used = others;
    used.train = train_refinement(&others.train, others.train.sh_degree, others.train.iterations);
    CHECK(used.train.dog == OXL_DOG_OFF && used.train.keep.kind == OXL_KEEP_ALL &&
          used.train.densify_until == 0);
    for (int i = 1; i < oxl_option_count(); i++) {
        const oxl_option *row = oxl_option_at(i);
        char was[128], now[128];
        oxl_option_get(row, &others, was, sizeof was);
        oxl_option_get(row, &used, now, sizeof now);
        if (row->use & OXL_OPTION_NOT_REFINED)
            CHECK(!strcmp(now, "off") || !strcmp(now, "all") || !strcmp(now, "0"));
        else CHECK(!strncmp(row->name, "lr-", 3) || !strcmp(now, was));
    }
}

TEST(options_in_run_json_are_read_back_every_one)
{
    static const char survey[] = "a survey, \"quoted\"";
    const oxl_job_options others = options_test_others();
    oxl_job_options read = oxl_job_options_default(OXL_PRESET_PAPER);
    OWNED_TEXT line = test_text(), inputs = line, again = line, paths = line, file = line;
    struct oxl_manifest run;
    manifest_describe(&line, &inputs, survey, &others);
    text_add(&file, "{\n  %s,\n  %s,\n  \"found\": {\"images\": 1}\n}\n", inputs.data, line.data);
    test_write("run.json", file.data);
    CHECK_OK(manifest_read(test_ctx, test_folder(), &run));
    const char *scene = manifest_options(&run, &read);
    CHECK(scene && !strcmp(scene, survey));
    manifest_describe(&again, &paths, survey, &read);
    CHECK(strcmp(again.data, line.data) == 0 && strcmp(paths.data, inputs.data) == 0);
    if (test_has_part("prune")) CHECK_TEXT(line.data, "\"keep\": \"12345678B\"");
    if (test_has_part("ucd")) CHECK_TEXT(line.data, "\"ucd\": \"search\"");
    manifest_free(test_ctx, &run);
}

TEST(options_that_differ_between_two_runs_are_named_with_both_values)
{
    oxl_job_options a = oxl_job_options_default(OXL_PRESET_DRAFT), b = a;
    OWNED_TEXT there = test_text(), here = there, paths = there, file = there, t = there;
    struct oxl_manifest run;
    b.scene.images = "here";
    b.partition.cut = OXL_CUT_MIDPOINT;
    a.train.cooldown = 0.5f;
    manifest_describe(&there, &paths, "one", &a);
    text_add(&file, "{%s, %s}", there.data, paths.data);
    test_write("run.json", file.data);
    text_free(&paths);
    manifest_describe(&here, &paths, "two", &b);
    CHECK_OK(manifest_read(test_ctx, test_folder(), &run));
    CHECK(manifest_differences(&run, here.data, &t) == 2 && manifest_differences(&run, paths.data, &t) == 2);
    CHECK(strcmp(t.data, "  cut: \"balanced\" there, \"midpoint\" here\n  cooldown: 0.5 there, 0.2 here\n"
                         "  scene: \"one\" there, \"two\" here\n"
                         "  images_folder: null there, \"here\" here\n") == 0);
    manifest_free(test_ctx, &run);
}

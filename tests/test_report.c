/* test_report.c - the page says what the folder holds, whatever names are in it and whatever is missing. */
#include "test.h"
#include "../cli/output.c"
#include "../cli/report.c"
#include "../cli/report_chart.c"
#include "../cli/report_map.c"
#include "../cli/report_read.c"
#include "../cli/report_page.c"
#include "../cli/report_views.c"
#include "../cli/report_ground.c"
#include "../cli/report_verdict.c"

#define REPORT_TEST_JOB                                                                                                                      \
    "\"inputs\": {\"scene\": \"no <where> & 'here'\", \"images_folder\": null, \"masks_folder\": \"m & n\"}, "                               \
    "\"job\": {\"version\": \"0\", \"seed\": 3, \"iterations\": 12, "                                                                        \
    "\"sh_degree\": 3, \"ucd\": \"1.5,3,fixed\", \"keep\": 0.5, \"dog\": \"selective\", \"dog_threshold\": \"90%\", \"partition\": \"2d\", " \
    "\"cut\": \"midpoint\", \"coarse\": 0.125, \"cooldown\": 0.5, \"alpha_min\": 0.04, \"lr_sh\": 0.001, "                                   \
    "\"densify_gradient\": 4e-4, \"max_gaussians\": 0}"

/* The page of the test's folder OUT, in memory to be freed. */
static char *report_test_page(void)
{
    const struct report r = {.out = test_path("out")};
    const oxl_result rc = report_write(test_ctx, test_path("out"), 0);
    char *page;
    CHECK(rc == OXL_OK);
    if (rc != OXL_OK) printf("  %s\n", oxl_error_text(test_ctx));
    page = output_read(r.out, "report.html", NULL);
    CHECK(page != NULL);
    return page ? page : calloc(1, 1);
}

static void report_test_picture(const char *name, float grey)
{
    oxl_image image = {0};
    CHECK_OK(oxl_image_create(test_ctx, 24, 16, &image));
    for (int i = 0; i < 3 * 24 * 16; i++) image.rgb[i] = grey;
    CHECK_OK(oxl_image_write(test_ctx, test_path(name), &image));
    oxl_image_free(test_ctx, &image);
}

/* Two blocks; the worst view's name is as bad as a name can be. */
static void report_test_run(void)
{
    test_write(
        "out/run.json",
        "{\"oceanxl\": \"0\", \"finished\": true, \"threads\": 2, \"instructions\": \"base\", \"preset\": \"draft\", "
        "\"iterations_done\": 24, \"blocks\": 2, \"origin\": [1, -2.5, 3],\n" REPORT_TEST_JOB ",\n"
        "\"survey\": {\"images\": 9, \"images_missing\": 0, \"train_views\": 7, \"test_views\": 2, \"points\": 16000},\n"
        "\"notes\": [{\"level\": \"warning\", \"text\": \"a <warning> & more\"}, "
        "{\"level\": \"info\", \"text\": \"a line of the log\"}],\n"
        "\"decisions\": {\"partition\": {\"chosen\": \"2d\", \"blocks\": 2, \"evidence\": \"16000 points; l3/l2 = 0.1\"}}}");
    test_write(
        "out/metrics.json",
        "{\"split\": \"test\", \"gaussians\": 22400, \"bytes\": 5736276, \"seconds\": 15.2, "
        "\"psnr\": 28.5, \"ssim\": 0.82, \"views\": [{\"name\": \"fine.png\", \"psnr\": 31, \"ssim\": 0.9}, "
        "{\"name\": \"<b>&\\\".jpg\", \"psnr\": 26, \"ssim\": 0.8, \"structure\": 0.25}]}");
    for (int k = 0; k < 2; k++) {
        char name[64];
        snprintf(name, sizeof name, "out/blocks/%03d/block.json", k);
        test_write(
            name,
            "{\"finished\": true, \"gaussians\": 11200, \"seconds\": 7.5, \"decisions\": {\"sh_degree\": "
            "{\"chosen\": \"2\", \"evidence\": \"degree 3 26.6 dB, degree <2> 26.7\"}}}");
        snprintf(name, sizeof name, "out/blocks/%03d/log.csv", k);
        test_write(
            name,
            "iteration,loss,psnr,gaussians,seconds,f_mid,f_far,peak_rss_bytes\n1,0.2,14,100,0.1,1.5,2,1000000\n"
            "12,0.1,20,200,1,1.5,2,2000000\n");
    }
}

TEST(report_escapes_every_name)
{
    char *page;
    report_test_run();
    CHECK_OK(oxl_make_folder(test_ctx, test_path("out/renders")));
    report_test_picture("out/renders/<b>&\".jpg.png", 0.5f);
    report_test_picture("out/renders/<b>&\".jpg.image.png", 0.75f);
    page = report_test_page();
    CHECK(!strstr(page, "<b>&\""));
    CHECK(!strstr(page, "<warning>"));
    CHECK(!strstr(page, "<where>"));
    CHECK_TEXT(page,
               "alt=\"Image, brightened of &lt;b&gt;&amp;&quot;.jpg\" src=\"data:image/jpeg;base64,/9j/");
    CHECK_TEXT(page, "<li>a &lt;warning&gt; &amp; more</li>");
    free(page);
}

TEST(report_shows_views_without_structure_brightened_and_where)
{
    char *page;
    report_test_run();
    CHECK_OK(oxl_make_folder(test_ctx, test_path("out/renders")));
    report_test_picture("out/renders/<b>&\".jpg.png", 0.5f);
    report_test_picture("out/renders/<b>&\".jpg.image.png", 0.75f);
    page = report_test_page();
    CHECK_TEXT(page, "1 of 2 held-out views are rendered without the structure of their images");
    CHECK_TEXT(page, "26.00<td class=\"n\">0.800<td class=\"n\">0.25</tr>");
    CHECK_TEXT(page, "31.00<td class=\"n\">0.900<td class=\"n\"></tr>"); /* of a run before it was measured */
    CHECK_TEXT(page, "<figcaption>Rendered, brightened</figcaption>");
    CHECK_TEXT(page, "<figcaption>Structure</figcaption>");
    free(page);
}

/* The page's command has the options of REPORT_TEST_JOB that this build has. */
static void report_test_command(const char *page)
{
    static const char *const words[][2] = {
        {NULL, " --preset draft --iterations 12"},
        {NULL, " --seed 3 --masks &#39;m &amp; n&#39; --partition 2d --cut midpoint"},
        {NULL, " --coarse 0.125 --cooldown 0.5 --alpha-min 0.04 --lr-sh 0.001"},
        {"sh_degree", " --sh-degree 3"},
        {"ucd", " --ucd 1.5,3,fixed"},
        {"prune", " --keep 0.5"},
        {"lobes", " --dog selective --dog-threshold 90%"}};
    for (size_t i = 0; i < OXL_COUNT(words); i++)
        if (!words[i][0] || test_has_part(words[i][0])) CHECK_TEXT(page, words[i][1]);
}

TEST(report_of_blocks_has_curves_decisions_and_the_command)
{
    char *page;
    const char *worst;
    report_test_run();
    page = report_test_page();
    CHECK_TEXT(page, "<tr><td>block 0<td class=\"n\">");
    CHECK_TEXT(page, "<tr><td>block 1<td class=\"n\">");
    CHECK(!strstr(page, "<tr><td>block 2") && !strstr(page, "coarse model"));
    CHECK_TEXT(page, "<dd>2, midpoint cuts<small>2d: 16000 points; l3/l2 = 0.1</small>");
    CHECK_TEXT(page, "<dd>3<small>block 0: 2: degree 3 26.6 dB, degree &lt;2&gt; 26.7</small>");
    CHECK(!strstr(page, "a line of the log"));
    CHECK_TEXT(page, "Depth weights f_mid");
    CHECK_TEXT(page, "22\xE2\x80\xAF"
                     "400");
    CHECK_TEXT(page, "<dt>Points</dt><dd>16\xE2\x80\xAF"
                     "000</dd>"); /* neither tracks nor their errors are known */
    CHECK_TEXT(page, "world = model + (1.000000, -2.500000, 3.000000)");
    CHECK_TEXT(page,
               "oceanxl train &#39;no &lt;where&gt; &amp; &#39;\\&#39;&#39;here&#39;\\&#39;&#39;&#39; -o ");
    report_test_command(page);
    CHECK_TEXT(page, "&#39; --masks &#39;m &amp; n&#39;\n</pre>"); /* of eval: no option of training */
    worst = strstr(page, "<td class=\"name\">&lt;b&gt;&amp;&quot;.jpg<td class=\"n\">26.00");
    CHECK(worst && strstr(worst, "<td class=\"name\">fine.png<td class=\"n\">31.00")); /* the worst first */
    free(page);
}

TEST(report_of_blocks_shows_the_coarse_model_as_one_more_row)
{
    char *page;
    report_test_run();
    test_write("out/blocks/coarse/block.json",
               "{\"finished\": false, \"gaussians\": 22400, \"iterations_done\": 77}");
    page = report_test_page();
    CHECK_TEXT(page, "<tr><td>coarse model<td class=\"n\">77<td");
    CHECK_TEXT(page, "&#9644; coarse model</b>");
    CHECK(!strstr(page, "not finished"));
    free(page);
}

TEST(report_has_the_decisions_of_the_merged_model)
{
    char *page;
    report_test_run();
    test_write("out/blocks/coarse/block.json", "{\"finished\": true, \"decisions\": {}}");
    test_write(
        "out/blocks/whole/block.json",
        "{\"finished\": true, \"iterations_done\": 55, \"decisions\": {\"keep\": {\"chosen\": \"1600\", \"evidence\": \"1600 of 3200 "
        "after density control: as set\"}, \"dog\": {\"chosen\": \"0 of 1600\"}}}");
    page = report_test_page();
    CHECK_TEXT(
        page,
        "<dt>Pruning (--keep)</dt><dd>0.5<small>merged model: 1600: 1600 of 3200 after density control: as set</small>");
    CHECK_TEXT(page, "<dt>Second lobes (--dog)</dt><dd>selective</dd>"); /* without evidence: not shown */
    CHECK_TEXT(page, "<tr><td>merged model<td class=\"n\">55<td");
    free(page);
}

TEST(report_asks_the_network_for_nothing)
{
    char *page;
    report_test_run();
    page = report_test_page();
    CHECK(!strstr(page, "http:") && !strstr(page, "https:") && !strstr(page, "url(") &&
          !strstr(page, "<script") && !strstr(page, "<link"));
    free(page);
}

TEST(report_says_what_is_missing)
{
    char *page;
    CHECK(report_write(test_ctx, test_path("nowhere"), 0) == OXL_ERR_INPUT);
    CHECK_TEXT(oxl_error_text(test_ctx), "holds no run.json");
    report_test_run();
    page = report_test_page();
    CHECK_TEXT(page, "Its images are not in renders/.");
    CHECK_TEXT(page, "No map: the survey is not found.");
    free(page);
    test_write("out/run.json", "{\"finished\": false, \"blocks\": 3, " REPORT_TEST_JOB "}");
    remove(test_path("out/metrics.json"));
    page = report_test_page();
    CHECK_TEXT(page, "not finished: run the same command again");
    CHECK_TEXT(page, "Not evaluated yet");
    free(page);
}

TEST(report_survives_files_that_are_cut_short)
{
    char *page;
    report_test_run();
    test_write("out/metrics.json", "{\"split\": \"test\", \"views\": [{\"name\": \"a\\");
    test_write("out/blocks/000/log.csv", "iteration,loss\n1,0.2\n2,");
    test_write("out/blocks/001/log.csv", "");
    test_write("out/blocks/001/block.json", "{\"finished\": tr");
    page = report_test_page();
    CHECK_TEXT(page, "</html>");
    free(page);
}

TEST(report_base64_pads_as_rfc_4648_says)
{
    static const char *const plain[] = {"f", "fo", "foo", "foob"}, *const coded[] = {"Zg==", "Zm8=", "Zm9v",
                                                                                     "Zm9vYg=="};
    for (int i = 0; i < 4; i++) {
        struct output t = {0};
        page_data(&t, "a/b", plain[i], strlen(plain[i]));
        CHECK(strcmp(t.data + strlen("data:a/b;base64,"), coded[i]) == 0);
        free(t.data);
    }
}

TEST(report_json_reads_escapes_and_finds_members_at_their_own_depth)
{
    const char *json =
        "{\"a\": {\"b\": 1}, \"s\": \"x\\\"\\u00e9\\n]\", \"b\": [2, -3.5e-1 ,{}], \"t\": true}";
    const char *list = oxl_json_member(json, "b");
    char *s = json_string(oxl_json_member(json, "s"));
    CHECK(s && strcmp(s, "x\"\xC3\xA9\n]") == 0);
    CHECK(oxl_json_number(oxl_json_member(json, "a"), "b") == 1);
    list = oxl_json_first(list);
    CHECK_CLOSE(oxl_json_number_at(&(const char *){list}), 2, 0);
    list = oxl_json_next(list);
    CHECK_CLOSE(oxl_json_number_at(&(const char *){list}), -0.35, 1e-15);
    list = oxl_json_next(list);
    CHECK(*list == '{' && oxl_json_next(list) == NULL);
    CHECK(oxl_json_is_true(json, "t") && !oxl_json_is_true(json, "a") &&
          isnan(oxl_json_number(json, "none")));
    free(s);
}

TEST(report_json_reads_nothing_past_the_end_of_a_text_that_is_cut_short)
{
    static const char in_a_name[] = "{\"a\": \"x\0, \"b\": 2}", in_an_escape[] = "{\"a\": \"x\\\0, \"b\": 2}",
                      in_a_list[] = "{\"a\": [1\0, \"b\": 2}";
    CHECK(!oxl_json_member(in_a_name, "b") && !oxl_json_member(in_an_escape, "b") &&
          !oxl_json_member(in_a_list, "b"));
    CHECK(!oxl_json_next(oxl_json_first(oxl_json_member(in_a_list, "a"))));
}

/* The verdict's word for a mean structure and explained contrast, in dB; PSNR is high. */
static void report_test_verdict(double structure, double explained, double training, const char *word)
{
    char json[600], *page;
    snprintf(
        json, sizeof json,
        "{\"split\": \"test\", \"psnr\": 38, \"cc_psnr\": 39, \"ssim\": 0.97, \"structure\": %.3f, \"explained\": %.3f, "
        "\"structure_least\": 0.1, \"no_structure\": 1, \"training\": {\"psnr\": 40.5, \"structure\": %.3f, \"views\": []}, "
        "\"views\": [{\"name\": \"a.jpg\", \"psnr\": 38, \"ssim\": 0.97}]}",
        structure, explained, training);
    report_test_run();
    test_write("out/metrics.json", json);
    page = report_test_page();
    CHECK_TEXT(page, word);
    CHECK_TEXT(page, "it is 39.00 dB (cc-PSNR): about 21 % of the squared error is brightness or colour");
    CHECK_TEXT(page, "1 view has no structure");
    CHECK_TEXT(page, "40.50 dB (2.50 dB more than held-out views)");
    CHECK(!strstr(page, "New views are worse") == (training - structure <= VERDICT_GAP));
    CHECK(!strstr(page, "but their errors are larger") == (training - structure > VERDICT_GAP));
    CHECK(!strstr(page, "New views are about as good")); /* 2.5 dB */
    free(page);
}

TEST(report_judges_by_structure_and_explained_contrast_whatever_the_psnr)
{
    report_test_verdict(0.97, 13, 0.98, "Image quality: very good.");
    report_test_verdict(0.97, 9, 0.98, "Image quality: good.");
    report_test_verdict(0.91, 13, 0.98, "Image quality: good.");
    report_test_verdict(0.82, 13, 0.95, "Image quality: fair.");
    report_test_verdict(0.55, 13, 0.60, "Image quality: poor.");
    report_test_verdict(0.97, 1, 0.98, "Image quality: not usable.");
    report_test_verdict(0.3, 13, 0.35, "Image quality: not usable.");
}

TEST(report_shows_a_view_without_structure_once)
{
    const char *first;
    char *page;
    report_test_run();
    test_write("out/metrics.json", "{\"split\": \"test\", \"psnr\": 20, \"views\": [{\"name\": \"a.jpg\", "
                                   "\"psnr\": 20, \"structure\": 0.1}]}");
    page = report_test_page();
    first = strstr(page, "<h3>a.jpg");
    CHECK(first && !strstr(first + 1, "<h3>a.jpg"));
    CHECK_TEXT(page, "1 of 1 held-out views are rendered without the structure");
    free(page);
}

TEST(report_calls_new_views_as_good_whose_errors_are_no_larger)
{
    char *page;
    report_test_run();
    test_write("out/metrics.json",
               "{\"split\": \"test\", \"psnr\": 38, \"structure\": 0.9, \"training\": {\"psnr\": 38.4, "
               "\"structure\": 0.91, \"views\": []}, \"views\": [{\"name\": \"a.jpg\", \"psnr\": 38}]}");
    page = report_test_page();
    CHECK_TEXT(page, "(0.40 dB more than held-out views). New views are about as good as those trained on");
    free(page);
}

/* What other viewers lack is from what the run fitted: of exposure, lamp and medium those in `on`. */
static void report_test_viewers(int on, const char *said, const char *advice)
{
    static const char *const names[] = {"exposure", "lamp", "medium"};
    struct output t = {0};
    char *page;
    report_test_run();
    output_add(&t, "{\"finished\": true, \"decisions\": {");
    for (int k = 0; k < 3; k++)
        output_add(&t, "%s\"%s\": {\"chosen\": \"%s\", \"evidence\": \"\"}", k ? ", " : "", names[k],
                   on >> k & 1 ? "on" : "off");
    output_add(&t, "}}");
    test_write("out/blocks/001/block.json", t.data);
    test_write("out/metrics.json",
               "{\"split\": \"test\", \"psnr\": 30, \"plain_psnr\": 27, \"structure\": 0.9, "
               "\"views\": [{\"name\": \"a.jpg\", \"psnr\": 30}]}");
    page = report_test_page();
    CHECK_TEXT(page, said);
    CHECK_TEXT(page, advice);
    CHECK(!strstr(page, "--exposure off") == !(on & 1) && !strstr(page, "--lamp off") == !(on & 2));
    free(page);
    free(t.data);
}

/* A switch that is set to on has no decision. */
TEST(report_says_why_other_viewers_show_less_by_what_was_set)
{
    char *page;
    report_test_run();
    test_write("out/run.json",
               "{\"finished\": true, \"blocks\": 1, \"job\": {\"exposure\": \"auto\", \"lamp\": \"on\"}}");
    test_write("out/metrics.json",
               "{\"split\": \"test\", \"psnr\": 30, \"plain_psnr\": 27, \"structure\": 0.9, "
               "\"views\": [{\"name\": \"a.jpg\", \"psnr\": 30}]}");
    page = report_test_page();
    CHECK_TEXT(page, "alone: by even light, 27.00");
    free(page);
}

TEST(report_says_why_other_viewers_show_less_by_what_was_fitted)
{
    report_test_viewers(0, "scene.ply alone: 27.00 dB against these images.</li>", "");
    report_test_viewers(1, "alone: at mean exposure, 27.00", "<code>--exposure off</code>");
    report_test_viewers(2, "alone: by even light, 27.00", "<code>--lamp off</code>");
    report_test_viewers(3, "alone: at mean exposure and by even light, 27.00",
                        "<code>--exposure off --lamp off</code>");
    report_test_viewers(4, "alone: with the medium in the colours of the Gaussians, 27.00",
                        "<code>oceanxl render</code> shows it");
    report_test_viewers(6, "alone: by even light, with the medium in", "<code>--lamp off</code>");
}

/* Writes metrics of three training views, the first with a flag; NULL: with none. */
static char *report_test_training(const char *flag, int all)
{
    struct output t = {0};
    char *page;
    report_test_run();
    output_add(
        &t,
        "{\"split\": \"test\", \"psnr\": 30, \"iterations\": 60, \"training\": {\"count\": 3, \"of\": %d, "
        "\"flagged\": %d, %s\"views\": [",
        all, flag != NULL, all > 3 ? "\"shown\": 2, " : "");
    for (int k = 0; k < 3; k++)
        output_add(&t,
                   "%s{\"name\": \"t%d.jpg\", \"psnr\": %d, \"structure\": 0.9, \"lacks\": %d.2, "
                   "\"lacks_exposure\": %d.8%s%s%s}",
                   k ? ", " : "", k, 25 + k, 8 - 4 * k, 4 * k, k == 0 && flag ? ", \"flag\": \"" : "",
                   k == 0 && flag ? flag : "", k == 0 && flag ? "\"" : "");
    output_add(&t, "]}, \"views\": [{\"name\": \"a.jpg\", \"psnr\": 30}]}");
    test_write("out/metrics.json", t.data);
    page = report_test_page();
    free(t.data);
    return page;
}

TEST(report_shows_what_training_images_lack_and_what_was_found)
{
    static const char *const findings[][2] = {{"pose", "Correct an image with a wrong pose"},
                                              {"blur", "Correct an image with a wrong pose"},
                                              {"colour", "Colour: it differs in colour or light"},
                                              {"reflections", "Reflections: it has bright spots"}};
    char *page = report_test_training(NULL, 3);
    CHECK_TEXT(page, "<th class=\"n\">structure<th class=\"n\">lacks, dB</tr>");
    CHECK_TEXT(page, "t0.jpg<td class=\"n\">25.00<td class=\"n\">0.90<td class=\"n\">8.2</tr>");
    CHECK_TEXT(page,
               "t2.jpg<td class=\"n\">27.00<td class=\"n\">0.90<td class=\"n\">8.8</tr>"); /* exposure */
    CHECK_TEXT(page, "0 of 3 fit far worse");
    CHECK_TEXT(page, "Sorted by what an image lacks");
    CHECK(!strstr(page, "finding") && !strstr(page, "are judged") && !strstr(page, "Correct an image"));
    free(page);
    for (size_t i = 0; i < OXL_COUNT(findings); i++) {
        char cell[80];
        page = report_test_training(findings[i][0], 3);
        snprintf(cell, sizeof cell, "8.2<td class=\"n\">%s</tr>", findings[i][0]);
        CHECK_TEXT(page, "lacks, dB<th class=\"n\">finding</tr>");
        CHECK_TEXT(page, cell);
        CHECK_TEXT(page, findings[i][1]);
        CHECK(!strstr(page, "Reflections:") == (i != 3) && !strstr(page, "Colour:") == (i != 2));
        free(page);
    }
    page = report_test_training(NULL, 7);
    CHECK(strstr(page, "<h3>t1.jpg") && !strstr(page, "<h3>t2.jpg")); /* "shown" of metrics.json */
    CHECK_TEXT(page, "3 of 7 training images are judged, evenly spaced: one for each 20 iterations.");
    free(page);
}

/* 0.9 of white by 0.14 is 6.4. */
TEST(report_shows_dark_images_brighter_and_says_by_how_much)
{
    static const struct {
        float grey;
        const char *said;
    } cases[] = {{0.14f, ", 6.3 times as bright<"}, {0.7f, "<figcaption>Image<"}};
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        char *page;
        report_test_run();
        CHECK_OK(oxl_make_folder(test_ctx, test_path("out/renders")));
        report_test_picture("out/renders/fine.png.png", cases[i].grey / 2);
        report_test_picture("out/renders/fine.png.image.png", cases[i].grey);
        page = report_test_page();
        CHECK_TEXT(page, cases[i].said);
        CHECK(!strstr(page, "times as bright") == (i == 1));
        CHECK_TEXT(page, "<figcaption>Error<");
        free(page);
    }
}

TEST(report_has_every_warning_of_the_log)
{
    struct output t = {0};
    char *page;
    report_test_run();
    output_add(&t, "{\"finished\": true, \"blocks\": 1, " REPORT_TEST_JOB ", \"notes\": [");
    for (int i = 0; i < 150; i++)
        output_add(&t, "%s{\"level\": \"warning\", \"text\": \"number %d.\"}", i ? ", " : "", i);
    output_add(&t, "]}");
    test_write("out/run.json", t.data);
    page = report_test_page();
    for (int i = 0; i < 150; i++) {
        char line[40];
        snprintf(line, sizeof line, "<li>number %d.</li>", i);
        CHECK_TEXT(page, line);
    }
    free(page);
    free(t.data);
}

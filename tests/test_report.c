/* test_report.c - the page says what the folder holds, whatever names are in it and whatever is missing. */
#include "test.h"
#include "../cli/output.c"
#include "../cli/report.c"
#include "../cli/chart.c"
#include "../cli/report_page.c"
#include "../cli/report_views.c"

#define REPORT_TEST_JOB                                                                                        \
    "\"inputs\": {\"scene\": \"no <where> & 'here'\", \"images_folder\": null, \"masks_folder\": \"m & n\"}, " \
    "\"job\": {\"version\": \"0\", \"seed\": 3, \"iterations\": 12, "                                          \
    "\"sh_degree\": 3, \"ucd\": \"search\", \"keep\": 0.5, \"dog\": \"selective\", \"partition\": \"2d\", "    \
    "\"cut\": \"midpoint\", \"coarse\": 0.125, \"cooldown\": 0.5, \"alpha_min\": 0.04, \"lr_sh\": 0.001, "     \
    "\"densify_gradient\": 4e-4, \"max_gaussians\": 0}"

/* The page of the test's folder OUT, in memory to be freed. */
static char *report_test_page(void)
{
    CHECK_OK(report_write(test_ctx, test_path("out"), 0));
    char *page = output_read(test_path("out"), "report.html");
    CHECK(page != NULL);
    return page ? page : calloc(1, 1);
}

static void report_test_picture(const char *name, float grey)
{
    OWNED_IMAGE image = test_image(24, 16);
    for (int i = 0; i < 3 * 24 * 16; i++) image.rgb[i] = grey;
    test_write_image(name, &image);
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

TEST(report_escapes_every_name_and_asks_the_network_for_nothing)
{
    report_test_run();
    test_make_folder("out/renders");
    report_test_picture("out/renders/<b>&\".jpg.png", 0.5f);
    report_test_picture("out/renders/<b>&\".jpg.image.png", 0.75f);
    char *page = report_test_page();
    CHECK(!strstr(page, "<b>&\"") && !strstr(page, "<warning>") && !strstr(page, "<where>"));
    CHECK_TEXT(page, "alt=\"Image of &lt;b&gt;&amp;&quot;.jpg\" src=\"data:image/jpeg;base64,/9j/");
    CHECK_TEXT(page, "<li>a &lt;warning&gt; &amp; more</li>");
    CHECK(!strstr(page, "http:") && !strstr(page, "https:") && !strstr(page, "url(") &&
          !strstr(page, "<script") && !strstr(page, "<link"));
    free(page);
}

TEST(report_lists_views_worst_first_and_says_which_have_no_structure)
{
    const char *worst;
    report_test_run();
    char *page = report_test_page();
    CHECK_TEXT(page, "1 of 2 views are rendered without the structure of their images");
    worst =
        strstr(page, "<td class=\"name\">&lt;b&gt;&amp;&quot;.jpg<td class=\"n\">26.00<td class=\"n\">0.25<");
    CHECK(worst && strstr(worst, "<td class=\"name\">fine.png<td class=\"n\">31.00<td class=\"n\"><td"));
    free(page);
    test_write(
        "out/metrics.json",
        "{\"split\": \"test\", \"psnr\": 30, \"training\": {\"shown\": 2, \"views\": [{\"name\": \"a\", "
        "\"psnr\": 20}, {\"name\": \"b\", \"psnr\": 25, \"flag\": \"pose\"}, {\"name\": \"c\", \"psnr\": "
        "19}]}, \"views\": []}");
    page = report_test_page();
    CHECK_TEXT(page,
               "b<td class=\"n\">25.00<td class=\"n\"><td class=\"n\">pose</tr>\n<tr><td class=\"name\">c<");
    CHECK(strstr(page, "<h3>b ") && strstr(page, "<h3>c ") && !strstr(page, "<h3>a "));
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
        {"ucd", " --ucd search"},
        {"prune", " --keep 0.5"},
        {"lobes", " --dog selective"}};
    for (size_t i = 0; i < OXL_COUNT(words); i++)
        if (!words[i][0] || test_has_part(words[i][0])) CHECK_TEXT(page, words[i][1]);
}

TEST(report_of_blocks_has_curves_decisions_and_the_command)
{
    report_test_run();
    test_write("out/blocks/coarse/block.json",
               "{\"finished\": false, \"gaussians\": 22400, \"iterations_done\": 77}");
    test_write(
        "out/blocks/whole/block.json",
        "{\"iterations_done\": 55, \"decisions\": {\"keep\": {\"chosen\": \"1600\", \"evidence\": \"as "
        "set\"}, \"dog\": {\"chosen\": \"0 of 1600\"}}}");
    char *page = report_test_page();
    CHECK_TEXT(page, "<tr><td>block 0<td class=\"n\">");
    CHECK_TEXT(page, "<tr><td>block 1<td class=\"n\">");
    CHECK(!strstr(page, "<tr><td>block 2"));
    CHECK_TEXT(page, "<tr><td>coarse model<td class=\"n\">77<td");
    CHECK_TEXT(page, "<tr><td>merged model<td class=\"n\">55<td");
    CHECK_TEXT(page, "<dt>blocks (--partition)</dt><dd>2d<small>16000 points; l3/l2 = 0.1</small>");
    CHECK_TEXT(
        page,
        "<dt>decision of another version</dt><dd>2<small>block 0: degree 3 26.6 dB, degree &lt;2&gt; 26.7</small>");
    CHECK_TEXT(page, "<dt>Gaussians after pruning (--keep)</dt><dd>1600<small>merged model: as set</small>");
    CHECK(!strstr(page, "(--dog)")); /* without evidence: not shown */
    CHECK(!strstr(page, "a line of the log"));
    CHECK_TEXT(page, "d=\"M76.0 "); /* iteration 1 of 12 */
    CHECK_TEXT(page, "L406.0 ");
    CHECK_TEXT(page, "22\xE2\x80\xAF"
                     "400");
    CHECK_TEXT(page, "world = model + (1.000000, -2.500000, 3.000000)");
    CHECK_TEXT(page,
               "oceanxl train &#39;no &lt;where&gt; &amp; &#39;\\&#39;&#39;here&#39;\\&#39;&#39;&#39; -o ");
    report_test_command(page);
    free(page);
}

TEST(report_says_what_is_missing)
{
    CHECK_ERROR(report_write(test_ctx, test_path("nowhere"), 0), OXL_ERR_INPUT, "holds no run.json");
    report_test_run();
    char *page = report_test_page();
    CHECK_TEXT(page, "Its images are not in renders/.");
    CHECK_TEXT(page, "No map: the survey or the model is not found");
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
    report_test_run();
    test_write("out/metrics.json", "{\"split\": \"test\", \"views\": [{\"name\": \"a\\");
    test_write("out/blocks/000/log.csv", "iteration,loss\n1,0.2\n2,");
    test_write("out/blocks/001/log.csv", "");
    test_write("out/blocks/001/block.json", "{\"finished\": tr");
    char *page = report_test_page();
    CHECK_TEXT(page, "</html>");
    free(page);
}

TEST(report_base64_pads_as_rfc_4648_says)
{
    static const char *const plain[] = {"f", "fo", "foo", "foob"}, *const coded[] = {"Zg==", "Zm8=", "Zm9v",
                                                                                     "Zm9vYg=="};
    for (int i = 0; i < 4; i++) {
        struct output t = {0};
        page_data(&t, plain[i], strlen(plain[i]));
        CHECK(strcmp(t.data + strlen("data:image/jpeg;base64,"), coded[i]) == 0);
        free(t.data);
    }
}

TEST(report_json_reads_escapes_and_finds_members_at_their_own_depth)
{
    const char *json =
        "{\"a\": {\"b\": 1}, \"s\": \"x\\\"\\u00e9\\n]\", \"b\": [2, -3.5e-1 ,{}], \"t\": true}";
    const char *list = oxl_json_member(json, "b");
    char *s = json_string(oxl_json_member(json, "s"));
    CHECK(s && strcmp(s, "x\"\xC3\xA9\n]") == 0 && oxl_json_number(oxl_json_member(json, "a"), "b") == 1);
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

/* 0.35 of white by 0.14 is 2.5. */
TEST(report_shows_dark_images_brighter_and_says_by_how_much)
{
    static const struct {
        float grey;
        const char *said;
    } cases[] = {{0.14f, ", 2.5 times as bright<"}, {0.7f, "<figcaption>Image<"}};
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        report_test_run();
        test_make_folder("out/renders");
        report_test_picture("out/renders/fine.png.png", cases[i].grey / 2);
        report_test_picture("out/renders/fine.png.image.png", cases[i].grey);
        char *page = report_test_page();
        CHECK_TEXT(page, cases[i].said);
        CHECK(!strstr(page, "times as bright") == (i == 1));
        CHECK_TEXT(page, "<figcaption>Error<");
        free(page);
    }
}

TEST(report_has_every_warning_of_the_log)
{
    struct output t = {0};
    report_test_run();
    output_add(&t, "{\"finished\": true, \"blocks\": 1, " REPORT_TEST_JOB ", \"notes\": [");
    for (int i = 0; i < 150; i++)
        output_add(&t, "%s{\"level\": \"warning\", \"text\": \"number %d.\"}", i ? ", " : "", i);
    output_add(&t, "]}");
    test_write("out/run.json", t.data);
    char *page = report_test_page();
    for (int i = 0; i < 150; i++) {
        char line[40];
        snprintf(line, sizeof line, "<li>number %d.</li>", i);
        CHECK_TEXT(page, line);
    }
    free(page);
    free(t.data);
}

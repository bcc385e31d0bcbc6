/* test_links.c - links and files of others in OUT: a run writes, changes and removes its own files alone. */
#include "test.h"

#ifndef _WIN32

#include <sys/stat.h>
#include <unistd.h>

static int links_holds(const char *path, const char *text)
{
    if (!os_is_file(path)) return 0;
    OWNED_FILE map = test_file(path);
    int same = map.size == strlen(text) && !memcmp(map.data, text, map.size);
    return same;
}

TEST(a_folder_given_by_the_user_may_be_a_link)
{
    const oxl_job_options options = job_test_options();
    test_make_folder("disk");
    CHECK(symlink(test_path("disk"), test_path("out")) == 0);
    job_test_done("out", &options);
    CHECK(test_has("disk/scene.ply"));
}

TEST(a_lock_that_is_a_link_or_a_pipe_is_refused_and_stays)
{
    oxl_lock *lock = NULL;
    struct stat s;
    test_write("victim", "secret");
    CHECK(chmod(test_path("victim"), 0600) == 0);
    test_make_folder("out");
    for (int kind = 0; kind < 3; kind++) {
        const char *path = test_path("out/.lock");
        if (kind == 0) CHECK(symlink(test_path("victim"), path) == 0);
        if (kind == 1) CHECK(link(test_path("victim"), path) == 0);
        if (kind == 2) CHECK(mkfifo(path, 0666) == 0);
        CHECK(oxl_lock_folder(test_ctx, test_path("out"), &lock) == OXL_ERR_IO && !lock);
        CHECK_SAYS("\nfix: remove it");
        CHECK(links_holds(test_path("victim"), "secret"));
        CHECK(stat(test_path("victim"), &s) == 0 && (s.st_mode & 0777) == 0600 && unlink(path) == 0);
    }
}

TEST(a_temporary_name_that_is_a_link_is_replaced_and_its_target_stays)
{
    char temporary[300];
    test_write("victim", "keep");
    CHECK(symlink(test_path("victim"), test_path("a.%ld.oxl.tmp", (long)getpid())) == 0);
    CHECK(symlink(test_path("victim"), test_path("report.html.%ld.oxl.tmp", (long)getpid())) == 0);
    test_write_bytes("a", "new", 3);
    FILE *file = oxl_create_beside(test_path("report.html"), temporary, sizeof temporary);
    CHECK(file && fputs("new", file) >= 0 && fclose(file) == 0);
    CHECK(links_holds(test_path("a"), "new") && links_holds(temporary, "new"));
    CHECK(links_holds(test_path("victim"), "keep"));
}

TEST(a_file_that_is_a_link_is_replaced_and_its_target_stays)
{
    oxl_job_options options = job_test_options();
    options.restart = 1; /* without, a model that no run wrote is kept */
    test_write("victim", "keep");
    test_make_folder("out");
    CHECK(symlink(test_path("victim"), test_path("out/scene.ply")) == 0);
    CHECK(symlink(test_path("victim"), test_path("out/metrics.json")) == 0);
    job_test_done("out", &options);
    CHECK(links_holds(test_path("victim"), "keep") && job_test_has("out/scene.ply", "ply\n"));
}

TEST(a_folder_of_the_survey_is_not_taken_for_the_output)
{
    static const char *const folders[] = {"survey", "survey/images", "survey/sparse", "survey/sparse/0"};
    oxl_job_options options = job_test_options();
    job_test_survey();
    for (size_t k = 0; k < OXL_COUNT(folders); k++) {
        char path[64];
        snprintf(path, sizeof path, "%s/./", folders[k]);
        CHECK_ERROR(job_test_run(path, &options), OXL_ERR_USAGE, "survey/out");
    }
    options.scene.images = test_path("survey/images");
    CHECK(job_test_run("survey/images", &options) == OXL_ERR_USAGE);
    CHECK(!test_has("survey/.lock") && !os_is_folder(test_path("survey/images/blocks")));
    options.scene.images = NULL;
    job_test_done("survey/out", &options);
}

TEST(a_model_that_no_run_wrote_is_replaced_with_restart_alone)
{
    oxl_job_options options = job_test_options();
    test_write("out/scene.ply", "of another program");
    CHECK_ERROR(job_test_run("out", &options), OXL_ERR_USAGE, "no run.json shows");
    CHECK(links_holds(test_path("out/scene.ply"), "of another program"));
    options.restart = 1;
    job_test_done("out", &options);
    CHECK(!links_holds(test_path("out/scene.ply"), "of another program"));
}

#endif

TEST(only_files_that_a_run_writes_are_swept)
{
    static const char *const stays[] = {"mydata.tmp", "mydata.12.tmp", "run.json", "scene.oxl.tmp.ply",
                                        ".oxl.tmp"};
    static const char *const goes[] = {"run.json.12.oxl.tmp", "a.png.4.oxl.tmp", "b.png.77.oxl.tmp"};
    for (size_t k = 0; k < OXL_COUNT(stays); k++) test_write(stays[k], "1");
    for (size_t k = 0; k < OXL_COUNT(goes); k++) test_write(goes[k], "1");
    CHECK_OK(os_remove_temporaries(test_ctx, test_folder()));
    CHECK_OK(os_remove_temporaries(test_ctx, test_path("nowhere")));
    for (size_t k = 0; k < OXL_COUNT(stays); k++) CHECK(test_has(stays[k]));
    for (size_t k = 0; k < OXL_COUNT(goes); k++) CHECK(!test_has(goes[k]));
}

TEST(decoded_images_are_removed_by_the_names_that_a_run_gives_them)
{
    oxl_job_options options = job_test_options();
    options.scene.image_cache_bytes = 1;
    test_write("out/blocks/decoded/photo", "keep");
    test_write("out/blocks/decoded/0123456789abcdef.7.oxl.tmp", "of a killed run");
    job_test_done("out", &options);
    CHECK(test_has("out/blocks/decoded/photo"));
    CHECK(!test_has("out/blocks/decoded/0123456789abcdef.7.oxl.tmp"));
}

/* ---------------- names of renders */

TEST(renders_of_long_names_are_cut_and_stay_different)
{
    char a[300], b[300], *path[2] = {NULL}, *again = NULL;
    memset(a, 'n', sizeof a), memset(b, 'n', sizeof b);
    snprintf(a + 240, 8, "1.png"), snprintf(b + 240, 8, "2.png");
    CHECK_OK(oxl_render_path(test_ctx, "f", a, ".image.png", &path[0]));
    CHECK_OK(oxl_render_path(test_ctx, "f", b, ".image.png", &path[1]));
    CHECK_OK(oxl_render_path(test_ctx, "f", a, ".image.png", &again));
    CHECK(strlen(path[0]) <= 2 + 200 + 10 && strcmp(path[0], path[1]) && !strcmp(path[0], again));
    CHECK_TEXT(path[0], ".image.png");
    OXL_FREE(test_ctx, path[0], path[1], again);
    CHECK_OK(oxl_render_path(test_ctx, "f", "../a/b", ".png", &path[0]));
    CHECK(!strcmp(path[0], "f/.._a_b.png"));
    oxl_free(test_ctx, path[0]);
}

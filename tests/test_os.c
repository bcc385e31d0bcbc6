/* test_os.c - files appear whole or not at all. */
#include "test.h"
#include <sys/resource.h>
#include <signal.h>

static int os_count_entry_total;

static void os_count_entry(void *user, const char *name)
{
    os_count_entry_total++;
    if (user && strcmp(user, name) == 0) os_count_entry_total += 100;
}

/* Entries of the test's folder, + 100 when one is called `name`. */
static int os_entries(const char *name)
{
    char wanted[64] = "";
    if (name) snprintf(wanted, sizeof wanted, "%s", name);
    os_count_entry_total = 0;
    CHECK_OK(os_list_folder(test_ctx, test_folder(), os_count_entry, wanted));
    return os_count_entry_total;
}

static int os_file_holds(const char *path, const char *text)
{
    OWNED_FILE file = test_file(path);
    int same = file.data && file.size == strlen(text) && memcmp(file.data, text, file.size + 1) == 0;
    return same;
}

TEST(os_a_written_file_reads_back_with_a_zero_behind_it)
{
    const char *path = test_path("a");
    test_write_bytes(path, "one\0two", 7);
    {
        struct os_file_map file = test_file(path);
        CHECK(file.size == 7 && memcmp(file.data, "one\0two", 8) == 0);
        os_release_file(test_ctx, &file);
        CHECK(!file.data && file.size == 0);
    }
}

TEST(os_an_empty_file_is_no_error)
{
    const char *path = test_path("a");
    test_write_bytes(path, NULL, 0);
    CHECK(os_is_file(path) && os_file_holds(path, ""));
}

/* Whole, discarded, and shorter than what was there: the new file is not seen before it is whole. */
TEST(os_writing_replaces_what_was_there_and_leaves_nothing_else)
{
    const char *path = test_write("a", "a long first text");
    for (int discarded = 1; discarded >= 0; discarded--) {
        const oxl_result rc = discarded ? OXL_ERR_INTERRUPTED : OXL_OK;
        struct os_writer writer;
        CHECK_OK(os_writer_open(test_ctx, path, &writer));
        fputs("new", writer.file);
        fflush(writer.file);
        CHECK(os_file_holds(path, "a long first text") && os_writer_close(test_ctx, &writer, rc) == rc);
        CHECK(os_file_holds(path, discarded ? "a long first text" : "new"));
        CHECK(os_entries("a") == 101);
    }
}

#ifndef _WIN32
/* A limit on the size of files stands for the full disk: write fails in the same way, at the same place. */
static void os_limit_file_size(rlim_t size, struct rlimit *old)
{
    signal(SIGXFSZ, SIG_IGN);
    getrlimit(RLIMIT_FSIZE, old);
    struct rlimit limit = (struct rlimit){.rlim_cur = size, .rlim_max = old->rlim_max};
    setrlimit(RLIMIT_FSIZE, &limit);
}

TEST(os_a_full_disk_is_noticed_and_the_old_file_stays)
{
    static char data[100000];
    const char *path = test_write("a", "old");
    struct rlimit old;
    struct os_writer writer;
    os_limit_file_size(4096, &old);
    oxl_result rc = os_write_file(test_ctx, path, data, sizeof data); /* fails in fwrite */
    setrlimit(RLIMIT_FSIZE, &old);
    CHECK_ERROR(rc, OXL_ERR_IO, path);
    CHECK_SAYS("cannot write: File too large");

    os_limit_file_size(100, &old);
    CHECK_OK(os_writer_open(test_ctx, path, &writer));
    fwrite(data, 1, 200, writer.file); /* buffered: fails in fflush */
    rc = os_writer_close(test_ctx, &writer, OXL_OK);
    setrlimit(RLIMIT_FSIZE, &old);
    CHECK_ERROR(rc, OXL_ERR_IO, "cannot write: File too large");

    os_limit_file_size(4096, &old);
    CHECK_OK(os_writer_open(test_ctx, path, &writer));
    fwrite(data, 1, sizeof data, writer.file); /* nobody looked at its result */
    rc = os_writer_close(test_ctx, &writer, OXL_OK);
    setrlimit(RLIMIT_FSIZE, &old);
    CHECK(rc == OXL_ERR_IO && os_file_holds(path, "old") && os_entries("a") == 101);
}
#endif

TEST(os_a_file_that_cannot_be_opened_is_named)
{
    struct os_file_map file;
    CHECK_ERROR(os_read_file(test_ctx, test_path("nothing"), &file), OXL_ERR_INPUT,
                "/nothing: cannot open: No such file");
    CHECK_ERROR(os_write_file(test_ctx, test_path("no/such/folder"), "x", 1), OXL_ERR_IO,
                "/no/such/folder: cannot write: No such file");
}

TEST(os_a_folder_is_not_read_as_a_file)
{
    struct os_file_map file;
    CHECK(os_read_file(test_ctx, test_folder(), &file) != OXL_OK);
    CHECK_SAYS(test_folder());
    CHECK(!os_is_file(test_folder()) && os_is_folder(test_folder()));
}

TEST(os_folders_are_made_with_their_parents_and_twice)
{
    test_make_folder("a/b//c/");
    test_make_folder("a/b/c");
    CHECK(os_is_folder(test_path("a/b/c")) && !test_has("a/b/c"));
}

TEST(os_a_file_in_the_way_of_a_folder_is_named)
{
    const char *path = test_write("a", "");
    CHECK_ERROR(oxl_make_folder(test_ctx, test_path("a/b")), OXL_ERR_IO, path);
    CHECK(oxl_make_folder(test_ctx, path) == OXL_ERR_IO);
}

TEST(os_a_listing_names_every_entry_but_the_folder_itself)
{
    test_write("one", "");
    test_write("two words", "");
    test_make_folder("three");
    CHECK(os_entries("two words") == 103 && os_entries("three") == 103);
    CHECK_ERROR(os_list_folder(test_ctx, test_path("nothing"), os_count_entry, NULL), OXL_ERR_IO, "/nothing");
}

TEST(os_the_clock_goes_forward_and_memory_use_is_seen)
{
    const double before = os_seconds();
    const size_t rss = os_peak_rss();
    const size_t size = rss + ((size_t)32 << 20);
    OWNED_MEMORY char *memory = oxl_alloc(test_ctx, size, 1);
    CHECK(memory != NULL);
    if (memory) memset(memory, 1, size);
    CHECK(os_peak_rss() == 0 || os_peak_rss() >= rss + ((size_t)24 << 20));
    CHECK(os_seconds() >= before);
}

TEST(os_path_has_one_slash_between_its_parts_and_none_before_an_empty_folder_and_a_long_one_names_no_file)
{
    char long_name[PATH_LENGTH + 8];
    memset(long_name, 'a', sizeof long_name - 1), long_name[sizeof long_name - 1] = 0;
    CHECK(strcmp(PATH("out", "blocks/%03d", 7), "out/blocks/007") == 0);
    CHECK(strcmp(PATH("out/", "%s", "run.json"), "out/run.json") == 0);
    CHECK(strcmp(PATH("", "%s", "run.json"), "run.json") == 0);
    CHECK(!os_is_file(PATH("out", "%s", long_name)) &&
          os_write_file(test_ctx, PATH("out", "%s", long_name), "x", 1) != OXL_OK);
    CHECK(os_write_file(test_ctx, PATH(long_name, "x"), "x", 1) != OXL_OK);
    long_name[PATH_LENGTH - 2] = 0;
    CHECK(strlen(PATH("o", "%s", long_name)) < PATH_LENGTH - 3); /* one more than fits */
    long_name[PATH_LENGTH - 3] = 0;
    CHECK(strlen(PATH("o", "%s", long_name)) == PATH_LENGTH - 1);
}

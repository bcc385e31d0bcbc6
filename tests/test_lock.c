/* test_lock.c - a folder is written to by one process at a time. The other process is a child that is
 * killed. */
#include "test.h"
#include <unistd.h>
#ifndef _WIN32
#include <sys/wait.h>

/* A child that holds a lock on the folder; killed and waited for by lock_test_kill. */
static pid_t lock_test_child(const char *folder, int shared)
{
    int ready[2];
    char byte;
    CHECK(pipe(ready) == 0);
    fflush(stdout);
    pid_t child = fork();
    if (child == 0) {
        oxl_lock *lock;
        oxl_result rc = lock_folder(test_ctx, folder, shared, &lock);
        if (write(ready[1], rc == OXL_OK ? "+" : "-", 1) != 1) _exit(1);
        for (;;) pause();
    }
    CHECK(child > 0 && read(ready[0], &byte, 1) == 1 && byte == '+');
    close(ready[0]);
    close(ready[1]);
    return child;
}

static void lock_test_kill(pid_t child)
{
    kill(child, SIGKILL);
    waitpid(child, NULL, 0);
}

TEST(lock_of_a_live_process_is_refused_by_its_number_and_that_of_a_killed_one_is_taken_over)
{
    const char *folder = test_path("out");
    const pid_t child = lock_test_child(folder, 0);
    oxl_lock *lock = NULL;
    char message[64];
    snprintf(message, sizeof message, "is in use by process %ld on ", (long)child);
    CHECK(oxl_lock_folder(test_ctx, folder, &lock) == OXL_ERR_FAILED && !lock);
    CHECK(strstr(oxl_error_text(test_ctx), message) && strstr(oxl_error_text(test_ctx), "\nfix: "));
    CHECK(lock_folder(test_ctx, folder, 1, &lock) == OXL_ERR_FAILED);
    lock_test_kill(child);
    CHECK(test_has("out/.lock"));
    CHECK_OK(oxl_lock_folder(test_ctx, folder, &lock));
    oxl_unlock_folder(test_ctx, &lock);
    CHECK(!lock && !test_has("out/.lock"));
}

TEST(lock_that_is_shared_lets_others_share_it_and_nobody_have_it_alone)
{
    const char *folder = test_path("out");
    const pid_t child = lock_test_child(folder, 1);
    oxl_lock *lock = NULL;
    CHECK(oxl_lock_folder(test_ctx, folder, &lock) == OXL_ERR_FAILED);
    CHECK_OK(lock_folder(test_ctx, folder, 1, &lock));
    CHECK(lock_change(test_ctx, lock, folder, 0) == OXL_ERR_FAILED);
    oxl_unlock_folder(test_ctx, &lock);
    CHECK(test_has("out/.lock")); /* the child's still */
    CHECK_OK(lock_folder(test_ctx, folder, 1, &lock));
    lock_test_kill(child);
    CHECK_OK(lock_change(test_ctx, lock, folder, 0));
    oxl_unlock_folder(test_ctx, &lock);
    CHECK(!test_has("out/.lock"));
}

TEST(lock_of_a_survey_of_one_block_is_not_shared)
{
    oxl_job_options options = job_test_options();
    struct job_test_watch watch = {0, 5};
    const oxl_callback callback = {job_test_progress, &watch};
    const char *survey = job_test_survey(), *folder = test_path("out");
    options.block = 0;
    CHECK(oxl_job_run(test_ctx, survey, folder, &options, &callback) == OXL_ERR_INTERRUPTED);
    pid_t child = lock_test_child(folder, 1);
    CHECK(oxl_job_run(test_ctx, survey, folder, &options, NULL) == OXL_ERR_FAILED);
    CHECK(strstr(oxl_error_text(test_ctx), "is in use by process"));
    lock_test_kill(child);
    CHECK_OK(oxl_job_run(test_ctx, survey, folder, &options, NULL));
}
#endif

/* A folder in the place of .lock stands for a disk that is only to be read, which tests cannot mount. */
TEST(lock_is_not_needed_where_the_run_is_finished)
{
    oxl_job_options options = job_test_options();
    job_test_done("out", &options);
    test_make_folder("out/.lock");
    job_test_done("out", &options);
    options.restart = 1;
    CHECK_ERROR(job_test_run("out", &options), OXL_ERR_IO, ".lock: cannot write");
    CHECK(test_has("out/scene.ply") && test_has("out/run.json"));
}

/* test_train_resume.c - a run stopped at any step resumes to the same bytes; a damaged file is detected. */
#include "test.h"

struct checkpoint_watch {
    int stop_at, first; /* iteration: to stop at; of the first report, 0: none yet */
};

static int checkpoint_stop(void *user, const oxl_progress *progress)
{
    struct checkpoint_watch *w = user;
    if (!w->first) w->first = progress->iteration;
    return progress->iteration == w->stop_at;
}

struct checkpoint_case checkpoint_of(oxl_scene *scene, oxl_train_options options)
{
    const struct text empty = test_text();
    return (struct checkpoint_case){
        .scene = scene, .options = options, .log = empty, .notes = empty, .decisions = empty};
}

/* All options that save work are on: the stops below fall on both sides of their changes. */
static struct checkpoint_case checkpoint_case(void)
{
    struct checkpoint_case c = checkpoint_of(train_scene(7), train_options(130));
    c.options.coarse = 0.5f;
    c.options.densify_until = 0.9f; /* at 100: rows, moments and statistics change shape */
    return c;
}

void checkpoint_case_free(struct checkpoint_case *c)
{
    oxl_model_free(test_ctx, &c->whole);
    oxl_scene_free(test_ctx, c->scene);
    text_free(&c->log);
    text_free(&c->notes);
    text_free(&c->decisions);
}

/* Runs from where the folder's state is to step `until`. */
oxl_result checkpoint_run(struct checkpoint_case *c, const char *key, int until, oxl_model *out)
{
    struct train_task place = {.store = checkpoint_in(test_folder(), key),
                               .log = &c->log,
                               .notes = &c->notes,
                               .imaging = &test_imaging,
                               .decisions = &c->decisions};
    struct checkpoint_watch watch = {until, 0};
    const oxl_callback stop = {checkpoint_stop, &watch};
    const oxl_result rc = train_run(test_ctx, c->scene, &c->options, &stop, &place, out);
    c->first = watch.first;
    return rc;
}

void checkpoint_stop_at(struct checkpoint_case *c, int step)
{
    OWNED_MODEL model = {0};
    CHECK(checkpoint_run(c, "key", step, &model) == OXL_ERR_INTERRUPTED);
}

static int checkpoint_same_imaging(const struct oxl_imaging *a, const struct oxl_imaging *b, size_t views)
{
    return a->on == b->on && memcmp(&a->medium, &b->medium, sizeof a->medium) == 0 &&
           memcmp(a->lamp, b->lamp, sizeof a->lamp) == 0 &&
           (!a->log_gain || memcmp(a->log_gain, b->log_gain, 3 * views * sizeof *a->log_gain) == 0) &&
           (!a->pose || memcmp(a->pose, b->pose, views * sizeof *a->pose) == 0);
}

void checkpoint_check_stops(struct checkpoint_case *c, const int *stop)
{
    const size_t views = (size_t)oxl_scene_view_count(c->scene);
    OWNED_IMAGING whole = {0};
    OWNED_MODEL model = {0};
    c->whole = test_trained(c->scene, &c->options);
    CHECK_OK(imaging_clone(test_ctx, &test_imaging, views, &whole));
    for (; *stop; stop++) checkpoint_stop_at(c, *stop);
    text_free(&c->decisions);
    CHECK_OK(checkpoint_run(c, "key", -1, &model));
    CHECK(test_same_model(&model, &c->whole) && checkpoint_same_imaging(&test_imaging, &whole, views));
}

TEST(checkpoint_a_run_stopped_at_any_step_ends_in_the_same_bytes)
{
    OWNED_CHECKPOINT_CASE c = checkpoint_case();
    checkpoint_check_stops(&c, (const int[]){1, 29, 99, 100, 101, 0});
    CHECK(c.whole.count != oxl_scene_point_count(c.scene));
}

TEST(checkpoint_keeps_the_callers_log)
{
    OWNED_CHECKPOINT_CASE c = checkpoint_case();
    OWNED_MODEL model = {0};
    text_add(&c.log, "iteration,loss\n");
    checkpoint_stop_at(&c, 5);
    text_free(&c.log);
    CHECK_OK(checkpoint_run(&c, "key", -1, &model));
    CHECK_TEXT(c.log.data ? c.log.data : "", "iteration,loss\n");
}

static void checkpoint_change_byte(const char *path, long at)
{
    FILE *file = fopen(path, "r+b");
    CHECK(file != NULL);
    fseek(file, at, at < 0 ? SEEK_END : SEEK_SET);
    int byte = fgetc(file);
    fseek(file, at, at < 0 ? SEEK_END : SEEK_SET);
    fputc(byte ^ 1, file);
    fclose(file);
}

static void checkpoint_cut(const char *path, size_t size)
{
    OWNED_FILE map = test_file(path);
    test_write_bytes(path, map.data, OXL_MIN(size, map.size));
}

/* Damaged in each of several places: the run starts again. */
TEST(checkpoint_that_is_damaged_is_noticed)
{
    static const long places[] = {0, 30, 5000, -1, -20};
    OWNED_CHECKPOINT_CASE c = checkpoint_case();
    OWNED_MODEL model = {0};
    for (size_t i = 0; i <= OXL_COUNT(places); i++) {
        checkpoint_remove(test_folder());
        checkpoint_stop_at(&c, 10);
        if (i < OXL_COUNT(places)) checkpoint_change_byte(test_path("checkpoint.oxl"), places[i]);
        else checkpoint_cut(test_path("checkpoint.oxl"), 4000);
        checkpoint_stop_at(&c, 10);
        CHECK(c.first == 1);
    }
    CHECK_OK(checkpoint_run(&c, "key", -1, &model));
    c.whole = test_trained(c.scene, &c.options);
    CHECK(test_same_model(&model, &c.whole));
}

TEST(checkpoint_of_another_key_is_left_aside)
{
    OWNED_CHECKPOINT_CASE c = checkpoint_case();
    OWNED_MODEL model = {0};
    checkpoint_stop_at(&c, 10);
    CHECK(checkpoint_run(&c, "other", 1, &model) == OXL_ERR_INTERRUPTED && c.first == 1);
}

static void checkpoint_numbers(struct archive *a, void *user)
{
    oxl_model *model = user;
    archive_model(a, model);
}

TEST(checkpoint_that_counts_more_than_it_holds_is_refused)
{
    struct archive a = {.ctx = test_ctx, .reading = 1, .path = "small", .left = 100};
    OWNED_MODEL other = {0};
    OWNED_MODEL model = test_model(3, 0);
    model.count = SIZE_MAX / 4096; /* a count from elsewhere, and a right checksum */
    CHECK(!archive_fits(&a, model.count, sizeof(float)) && a.rc == OXL_ERR_INPUT);
    model.count = 3;
    test_archive(checkpoint_numbers, &model, &other);
    CHECK(test_same_model(&model, &other));
}

#ifndef _WIN32
#include <sys/resource.h>

static void checkpoint_no_state(struct archive *a, void *user)
{
    (void)a, (void)user;
}

TEST(checkpoint_that_cannot_be_opened_does_not_count_as_none)
{
    struct rlimit old;
    int found;
    CHECK_OK(checkpoint_write(test_ctx, test_folder(), "key", checkpoint_no_state, NULL));
    getrlimit(RLIMIT_NOFILE, &old);
    struct rlimit few = old;
    few.rlim_cur = 3;
    setrlimit(RLIMIT_NOFILE, &few);
    oxl_result rc = checkpoint_read(test_ctx, test_folder(), "key", checkpoint_no_state, NULL, &found);
    setrlimit(RLIMIT_NOFILE, &old);
    CHECK_ERROR(rc, OXL_ERR_IO, "fix: allow more open files");
}
#endif

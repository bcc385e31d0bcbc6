/* test.h - the smallest harness that serves: TEST(promise) { CHECK(...); }
 *
 * A test's name is its promise. A failed CHECK prints file:line and what was seen and ends its test. Each test
 * runs in a process of its own where the system has fork, so that a crash ends that test alone.
 * The list of tests is made by the Makefile from the lines that begin with TEST( (build/test_list.h).
 */
#ifndef TEST_H
#define TEST_H

#include "library.h" /* first: it chooses POSIX before any system header */
#include "cases.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

extern oxl_context *test_ctx; /* fresh for every test; memory still held at its end fails the test */
extern const char *test_case; /* which of several cases the running test is at; a failure prints it */
extern const char *test_skip; /* why the running test was skipped, or NULL */

#define TEST(name)          \
    void test_##name(void); \
    void test_##name(void)

/* Prints the place and the text, and ends the running test. */
void test_fail(const char *file, int line, const char *format, ...);

#define CHECK(condition)                                                             \
    do {                                                                             \
        if (!(condition)) test_fail(__FILE__, __LINE__, "not true: %s", #condition); \
    } while (0)

#define CHECK_OK(call)                                                                                  \
    do {                                                                                                \
        const oxl_result check_rc = (call);                                                             \
        if (check_rc != OXL_OK)                                                                         \
            test_fail(__FILE__, __LINE__, "%s gave %d: %s", #call, check_rc, oxl_error_text(test_ctx)); \
    } while (0)

/* |a - b| <= tolerance; not-a-number fails. */
#define CHECK_CLOSE(a, b, tolerance)                                                                  \
    do {                                                                                              \
        const double check_a = (a), check_b = (b);                                                    \
        if (!(fabs(check_a - check_b) <= (tolerance)))                                                \
            test_fail(__FILE__, __LINE__, "%s = %.9g, expected %s = %.9g within %g", #a, check_a, #b, \
                      check_b, (double)(tolerance));                                                  \
    } while (0)

/* The text holds the words. */
#define CHECK_TEXT(text, words)                                                            \
    do {                                                                                   \
        const char *check_text = (text);                                                   \
        if (!strstr(check_text, (words)))                                                  \
            test_fail(__FILE__, __LINE__, "\"%s\" is not in \"%s\"", (words), check_text); \
    } while (0)

/* The last error's text holds the words. */
#define CHECK_SAYS(words) CHECK_TEXT(oxl_error_text(test_ctx), words)

/* A warning, or anything that was logged since test_listen, holds the words. */
#define CHECK_WARNED(words) CHECK_TEXT(test_said.warning, words)
#define CHECK_LOGGED(words) CHECK_TEXT(test_said.all, words)

/* The file is there and holds the words. */
#define CHECK_IN(file, words)                                                                              \
    do {                                                                                                   \
        if (!job_test_has(file, words)) test_fail(__FILE__, __LINE__, "\"%s\" is not in %s", words, file); \
    } while (0)

/* The call is refused with this code, and the error's text holds the words. */
#define CHECK_ERROR(call, code, words) \
    do {                               \
        CHECK((call) == (code));       \
        CHECK_SAYS(words);             \
    } while (0)

#define SKIP(why)          \
    do {                   \
        test_skip = (why); \
        return;            \
    } while (0)

/* Skips a test that needs a part of training, where the build has none of this name (make without). */
#define NEEDS_PART(name) \
    if (!test_has_part(#name)) SKIP("a build without " #name)
int test_has_part(const char *name);

/* Local variables that are freed where their block ends: OWNED_MODEL m = {0}; (a feature of gcc and clang). */
#define OWNED(name) __attribute__((cleanup(owned_##name)))
#define OWNED_COLMAP OWNED(colmap) struct colmap
#define OWNED_FILE OWNED(file) struct os_file_map
#define OWNED_IMAGE OWNED(image) oxl_image
#define OWNED_IMAGING OWNED(imaging) struct oxl_imaging
#define OWNED_MEMORY OWNED(memory) /* any pointer: OWNED_MEMORY float *x = oxl_alloc(...); */
#define OWNED_MODEL OWNED(model) oxl_model
#define OWNED_PARTITION OWNED(partition) struct partition
#define OWNED_RENDERER OWNED(renderer) struct renderer
#define OWNED_SCENE OWNED(scene) oxl_scene
#define OWNED_TEXT OWNED(text) struct text
#define OWNED_TRAINING OWNED(training) struct training_image
void owned_colmap(struct colmap *c);
void owned_file(struct os_file_map *map);
void owned_image(oxl_image *image);
void owned_imaging(struct oxl_imaging *imaging);
void owned_memory(void *pointer);
void owned_model(oxl_model *model);
void owned_partition(struct partition *p);
void owned_renderer(struct renderer **r);
void owned_scene(oxl_scene **scene);
void owned_text(struct text *t);
void owned_training(struct training_image *image);

/* What the library has logged since the test began, or since test_listen, a line each. */
struct test_said {
    int warnings;
    char all[8192], warning[8192]; /* with "info: " or "warning: " before each; the warnings' texts alone */
};
extern struct test_said test_said;
void test_listen(void);

/* A fresh folder for the running test's files; removed afterwards. */
const char *test_folder(void);
/* "FOLDER/name" in a ring of buffers; a path from the root stays. Functions below take such names. */
const char *test_path(const char *format, ...);
int test_has(const char *file);
oxl_image test_read_image(const char *file);
oxl_model test_read_model(const char *file);
/* Loads a survey; options may be NULL. */
oxl_scene *test_load(const char *survey, const oxl_scene_options *options);
/* A scene of these views, whose images are freed. */
oxl_scene *test_scene(const oxl_view *view, oxl_image *image, int views, const oxl_point *point,
                      size_t points);
struct os_file_map test_file(const char *file);
struct text test_text(void); /* empty */
struct renderer *test_renderer(void);
oxl_image test_render(const oxl_model *model, const oxl_camera *camera);
/* Renders with default options; the image belongs to the renderer. */
const float *test_draw(struct renderer *r, const oxl_model *model, const oxl_camera *camera);
/* Stands at (x, y, z), looks along z, its principal point in the middle. */
oxl_camera test_camera(int width, int height, double focal, double x, double y, double z);
oxl_image test_image(int width, int height);
oxl_model test_model(size_t count, int sh_degree);
oxl_model test_model_of(const oxl_point *point, size_t count, int sh_degree);
/* A model of the scene's points. */
oxl_model test_points(const oxl_scene *scene, int sh_degree);
/* Writes a text file into the test's folder (parents are made) and returns its path. */
const char *test_write(const char *name, const char *text);
/* Writes into the test's folder as it is: no folder is made. */
void test_write_bytes(const char *name, const void *bytes, size_t size);
void test_write_image(const char *name, const oxl_image *image);
void test_write_model(const char *name, const oxl_model *model);
void test_make_folder(const char *name);
/* Path of the folder of surveys beside the project, or NULL when it is not there: then SKIP. */
const char *test_shared(const char *name);

extern struct oxl_imaging test_imaging; /* of the last test_train, test_read_imaging; freed after the test */
/* Reads the imaging that belongs to a model file. */
oxl_result test_read_imaging(const oxl_scene *scene, const char *model_path);
/* The first run of oxl_train, without a model for viewers. */
oxl_result test_train(oxl_scene *scene, const oxl_train_options *options, const oxl_callback *callback,
                      oxl_model *out);
/* What it trains without a callback. */
oxl_model test_trained(oxl_scene *scene, const oxl_train_options *options);

/* What a step of density control does. */
static inline oxl_result test_density(oxl_context *ctx, struct density *d, struct trained_model *trained,
                                      const struct density_rules *rules, struct density_change *out)
{
    const oxl_result rc = density_decide(ctx, d, &trained->model, rules, out);
    return rc == OXL_OK ? density_apply(ctx, d, trained, out, 0) : rc;
}

#endif

/* test.h - the smallest harness that serves: TEST(promise) { CHECK(...); }
 *
 * A test's name is its promise. A failed CHECK prints file:line and what was seen, marks the test as failed
 * and continues.
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
extern int test_failed;       /* in the running test */
extern const char *test_skip; /* why the running test was skipped, or NULL */

#define TEST(name)          \
    void test_##name(void); \
    void test_##name(void)

#define CHECK(condition)                                                       \
    do {                                                                       \
        if (!(condition)) {                                                    \
            test_failed++;                                                     \
            printf("  %s:%d: not true: %s\n", __FILE__, __LINE__, #condition); \
        }                                                                      \
    } while (0)

#define CHECK_OK(call)                                                               \
    do {                                                                             \
        oxl_result check_rc = (call);                                                \
        if (check_rc != OXL_OK) {                                                    \
            test_failed++;                                                           \
            printf("  %s:%d: %s gave %d: %s\n", __FILE__, __LINE__, #call, check_rc, \
                   oxl_error_text(test_ctx));                                        \
        }                                                                            \
    } while (0)

/* |a - b| <= tolerance; not-a-number fails. */
#define CHECK_CLOSE(a, b, tolerance)                                                                      \
    do {                                                                                                  \
        const double check_a = (a), check_b = (b);                                                        \
        if (!(fabs(check_a - check_b) <= (tolerance))) {                                                  \
            test_failed++;                                                                                \
            printf("  %s:%d: %s = %.9g, expected %s = %.9g within %g\n", __FILE__, __LINE__, #a, check_a, \
                   #b, check_b, (double)(tolerance));                                                     \
        }                                                                                                 \
    } while (0)

/* The text holds the words. */
#define CHECK_TEXT(text, words)                                                                    \
    do {                                                                                           \
        const char *check_text = (text);                                                           \
        if (!strstr(check_text, (words))) {                                                        \
            test_failed++;                                                                         \
            printf("  %s:%d: \"%s\" is not in \"%s\"\n", __FILE__, __LINE__, (words), check_text); \
        }                                                                                          \
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

/* A fresh folder for the running test's files; removed afterwards. */
const char *test_folder(void);
/* "FOLDER/name" in a small ring of buffers. */
const char *test_path(const char *name);
/* Writes a text file into the test's folder (parents are made) and returns its path. */
const char *test_write(const char *name, const char *text);
/* Path of the folder of surveys beside the project, or NULL when it is not there: then SKIP. */
const char *test_shared(const char *name);

extern struct oxl_imaging test_imaging; /* of the last test_train, test_read_imaging; freed after the test */
/* Reads the imaging that belongs to a model file. */
oxl_result test_read_imaging(const oxl_scene *scene, const char *model_path);
/* The first run of oxl_train, without a model for viewers. */
oxl_result test_train(oxl_scene *scene, const oxl_train_options *options, const oxl_callback *callback,
                      oxl_model *out);

/* What a step of density control does. */
static inline oxl_result test_density(oxl_context *ctx, struct density *d, struct trained_model *trained,
                                      const struct density_rules *rules, struct density_change *out)
{
    const oxl_result rc = density_decide(ctx, d, &trained->model, rules, out);
    return rc == OXL_OK ? density_apply(ctx, d, trained, out, 0) : rc;
}

#endif

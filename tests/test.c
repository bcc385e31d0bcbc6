/* test.c - runs the tests: all, or those whose names hold one of the words given, and no -WORD. One line a
 * test, then a sum. OXL_TEST_SHARE=K/N runs each N-th of them, from the K-th on, so that N processes share
 * them.
 *
 * Test files are objects that link the library's objects and see its internal headers. Each test gets a
 * context that counts memory.
 */
#include "test.h"

#include <setjmp.h>
#include <stdarg.h>

#ifndef _WIN32
#include <sys/wait.h>
#include <unistd.h>
#endif

oxl_context *test_ctx;
const char *test_case, *test_skip;

static jmp_buf test_end; /* where a failed CHECK goes to */

static char folder[256];
static struct {
    int index, count;
} share = {0, 1};      /* of the tests: OXL_TEST_SHARE */
long blocks_held;      /* given by the counting allocator and not yet freed */
long allocations_left; /* until the counting allocator refuses one */

void *counting_reallocate(void *user, void *old, size_t size)
{
    (void)user;
    if (size == 0) {
        blocks_held -= old != NULL;
        free(old);
        return NULL;
    }
    if (allocations_left-- == 0) return NULL;
    blocks_held += old == NULL;
    return realloc(old, size);
}

/* An allocator that never grows in place and counts what is held as realloc would. */
struct memory_weighed memory_weighed;

enum { MEMORY_HEAD = 128 };

/* Size and the place of the allocation itself stand in front. Never grows in place. */
static void *memory_weigh(void *user, void *old, size_t size)
{
    const size_t shift = 16 * (size_t)(memory_weighed.calls++ % 4);
    char *memory = NULL;
    size_t had = 0;
    (void)user;
    if (old) memcpy(&had, (char *)old - 16, sizeof had);
    if (size && memory_weighed.limit && memory_weighed.held - had + size > memory_weighed.limit) return NULL;
    char *base = size ? malloc(size + MEMORY_HEAD) : NULL;
    if (base) {
        memory = base + 64 + shift;
        memcpy(memory - 16, &size, sizeof size);
        memcpy(memory - 8, &base, sizeof base);
        if (old) memcpy(memory, old, OXL_MIN(had, size));
    }
    memory_weighed.held += size - had;
    memory_weighed.most = OXL_MAX(memory_weighed.most, memory_weighed.held);
    if (old) memcpy(&base, (char *)old - 8, sizeof base);
    if (old) free(base);
    return memory;
}

void memory_weigh_start(size_t limit)
{
    memory_weighed = (struct memory_weighed){.limit = limit};
    test_ctx->options.reallocate = memory_weigh;
}

void memory_weigh_end(void)
{
    CHECK(memory_weighed.held == 0);
    test_ctx->options.reallocate = counting_reallocate;
}

const char *test_path(const char *format, ...)
{
    static char ring[256][512];
    static unsigned next;
    char name[400], *path = ring[next++ % OXL_COUNT(ring)];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(name, sizeof name, format, arguments);
    va_end(arguments);
    /* absolute, or of test_shared */
    if (name[0] == '/' || !strncmp(name, "../", 3)) snprintf(path, sizeof ring[0], "%s", name);
    else snprintf(path, sizeof ring[0], "%s/%s", test_folder(), name);
    return path;
}

int test_has(const char *file)
{
    return os_is_file(test_path("%s", file));
}

oxl_image test_read_image(const char *file)
{
    oxl_image image;
    CHECK_OK(oxl_image_read(test_ctx, test_path("%s", file), &image));
    return image;
}

oxl_model test_read_model(const char *file)
{
    oxl_model model;
    CHECK_OK(oxl_model_read(test_ctx, test_path("%s", file), &model));
    return model;
}

oxl_scene *test_load(const char *survey, const oxl_scene_options *options)
{
    oxl_scene *scene = NULL;
    CHECK_OK(oxl_scene_load(test_ctx, test_path("%s", survey), options, &scene));
    return scene;
}

oxl_scene *test_scene(const oxl_view *view, oxl_image *image, int views, const oxl_point *point,
                      size_t points)
{
    oxl_scene *scene = NULL;
    CHECK_OK(oxl_scene_from_arrays(test_ctx, view, image, views, point, points, &scene));
    for (int v = 0; v < views; v++) oxl_image_free(test_ctx, &image[v]);
    return scene;
}

struct os_file_map test_file(const char *file)
{
    struct os_file_map map;
    CHECK_OK(os_read_file(test_ctx, test_path("%s", file), &map));
    return map;
}

struct text test_text(void)
{
    return (struct text){.ctx = test_ctx};
}

oxl_image test_image(int width, int height)
{
    oxl_image image;
    CHECK_OK(oxl_image_create(test_ctx, width, height, &image));
    return image;
}

oxl_model test_model(size_t count, int sh_degree)
{
    oxl_model model;
    CHECK_OK(oxl_model_create(test_ctx, count, sh_degree, &model));
    return model;
}

struct renderer *test_renderer(void)
{
    struct renderer *r = NULL;
    CHECK_OK(renderer_create(test_ctx, &r));
    return r;
}

const float *test_draw(struct renderer *r, const oxl_model *model, const oxl_camera *camera)
{
    const oxl_render_options options = oxl_render_options_default();
    const float *rgb;
    CHECK_OK(renderer_forward(test_ctx, r, model, camera, &options));
    CHECK_OK(renderer_image(r, &rgb));
    return rgb;
}

oxl_image test_render(const oxl_model *model, const oxl_camera *camera)
{
    oxl_image image;
    CHECK_OK(oxl_render(test_ctx, model, camera, NULL, &image, NULL));
    return image;
}

oxl_camera test_camera(int width, int height, double focal, double x, double y, double z)
{
    return (oxl_camera){
        width, height, focal, focal, width / 2.0, height / 2.0, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {-x, -y, -z}};
}

oxl_model test_model_of(const oxl_point *point, size_t count, int sh_degree)
{
    oxl_model model;
    CHECK_OK(oxl_model_from_points(test_ctx, point, count, sh_degree, &model));
    return model;
}

oxl_model test_points(const oxl_scene *scene, int sh_degree)
{
    return test_model_of(oxl_scene_points(scene), oxl_scene_point_count(scene), sh_degree);
}

const char *test_folder(void)
{
    oxl_make_folder(test_ctx, folder);
    return folder;
}

void test_write_bytes(const char *name, const void *bytes, size_t size)
{
    CHECK_OK(os_write_file(test_ctx, test_path("%s", name), bytes, size));
}

void test_write_image(const char *name, const oxl_image *image)
{
    CHECK_OK(oxl_image_write(test_ctx, test_path("%s", name), image));
}

void test_write_model(const char *name, const oxl_model *model)
{
    CHECK_OK(oxl_model_write(test_ctx, test_path("%s", name), model));
}

void test_make_folder(const char *name)
{
    CHECK_OK(oxl_make_folder(test_ctx, test_path("%s", name)));
}

const char *test_write(const char *name, const char *text)
{
    const char *path = test_path("%s", name);
    char parent[512];
    snprintf(parent, sizeof parent, "%s", path);
    char *slash = strrchr(parent, '/');
    if (slash) *slash = 0;
    test_make_folder(parent);
    test_write_bytes(path, text, strlen(text));
    return path;
}

const char *test_shared(const char *name)
{
    static char path[512];
    const char *base = getenv("OXL_SHARED");
    snprintf(path, sizeof path, "%s/%s", base ? base : "../shared", name);
    return os_is_file(path) || os_is_folder(path) ? path : NULL;
}

int test_has_part(const char *name)
{
    for (int k = 0; parts_at(k); k++)
        if (strcmp(parts_at(k)->name, name) == 0) return 1;
    return 0;
}

static void remove_folder(void)
{
    char command[300];
    if (!os_is_folder(folder)) return;
    snprintf(command, sizeof command, "rm -rf '%s'", folder);
    if (system(command) != 0) printf("could not remove %s\n", folder);
}

#define ENTRY(name) void test_##name(void);
#ifdef OXL_VULKAN
#define DEVICE_ENTRY ENTRY
#else
#define DEVICE_ENTRY(name)                                          \
    static void test_##name(void)                                   \
    {                                                               \
        SKIP("a build without the Vulkan backend (make VULKAN=1)"); \
    }
#endif
#include "test_list.h" /* generated: ENTRY(name) for each TEST(name), DEVICE_ENTRY(name) for each DEVICE_TEST(name) */
#undef ENTRY
#undef DEVICE_ENTRY
#define DEVICE_ENTRY ENTRY

static const struct {
    const char *name;
    void (*run)(void);
} tests[] = {
#define ENTRY(name) {#name, test_##name},
#include "test_list.h"
};

static int wanted(const char *name, int argc, char **argv)
{
    int has_words = 0, found = 0;
    for (int i = 1; i < argc; i++) {
        const int without = argv[i][0] == '-', holds = strstr(name, argv[i] + without) != NULL;
        if (without && holds) return 0;
        has_words |= !without, found |= holds;
    }
    return found || !has_words;
}

struct oxl_imaging test_imaging;

oxl_result test_read_imaging(const oxl_scene *scene, const char *model_path)
{
    imaging_free(test_ctx, &test_imaging);
    return imaging_read_beside(test_ctx, model_path, scene, &test_imaging);
}

oxl_result test_train(oxl_scene *scene, const oxl_train_options *options, const oxl_callback *callback,
                      oxl_model *out)
{
    return train_run(test_ctx, scene, options, callback, &(struct train_task){.imaging = &test_imaging}, out);
}

oxl_model test_trained(oxl_scene *scene, const oxl_train_options *options)
{
    oxl_model model;
    CHECK_OK(test_train(scene, options, NULL, &model));
    return model;
}

void test_fail(const char *file, int line, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    printf("  %s:%d: ", file, line);
    vprintf(format, arguments);
    va_end(arguments);
    printf(test_case ? " (%s)\n" : "\n", test_case);
    longjmp(test_end, 1);
}

struct test_said test_said;

static void test_add(char *to, size_t size, const char *before, const char *text)
{
    const size_t used = strlen(to);
    snprintf(to + used, size - used, "%s%s\n", before, text);
}

static void test_hear(void *user, oxl_log_level level, const char *text)
{
    const int warns = level == OXL_LOG_WARNING;
    (void)user;
    test_said.warnings += warns;
    test_add(test_said.all, sizeof test_said.all, warns ? "warning: " : "info: ", text);
    if (warns) test_add(test_said.warning, sizeof test_said.warning, "", text);
}

void test_listen(void)
{
    memset(&test_said, 0, sizeof test_said);
}

void owned_colmap(struct colmap *c)
{
    colmap_free(test_ctx, c);
}
void owned_file(struct os_file_map *map)
{
    os_release_file(test_ctx, map);
}
void owned_image(oxl_image *image)
{
    oxl_image_free(test_ctx, image);
}
void owned_imaging(struct oxl_imaging *imaging)
{
    imaging_free(test_ctx, imaging);
}
void owned_model(oxl_model *model)
{
    oxl_model_free(test_ctx, model);
}
void owned_partition(struct partition *p)
{
    partition_free(test_ctx, p);
}
void owned_renderer(struct renderer **r)
{
    renderer_free(test_ctx, *r);
}
void owned_scene(oxl_scene **scene)
{
    oxl_scene_free(test_ctx, *scene);
}
void owned_text(struct text *t)
{
    text_free(t);
}

void owned_training(struct training_image *image)
{
    image_training_free(test_ctx, image);
}

void owned_memory(void *pointer)
{
    void *memory;
    memcpy(&memory, pointer, sizeof memory);
    oxl_free(test_ctx, memory);
}

enum { PASSED, FAILED, SKIPPED, RESULTS };

static int run_here(const char *name, void (*body)(void))
{
    oxl_context_options options = oxl_context_options_default();
    options.reallocate = counting_reallocate;
    options.log = test_hear;
    test_listen();
    test_case = test_skip = NULL;
    blocks_held = 0;
    allocations_left = LONG_MAX;
    if (setjmp(test_end)) return FAILED;
    options.command_line = 1;
    if (oxl_context_create(&options, &test_ctx) != OXL_OK) test_fail(__FILE__, __LINE__, "no context");
    body();
    imaging_free(test_ctx, &test_imaging);
    oxl_context_free(test_ctx);
    if (blocks_held != 0)
        test_fail(__FILE__, __LINE__, "%ld blocks of memory were not given back", blocks_held);
    if (test_skip) printf("skip %s: %s\n", name, test_skip);
    return test_skip ? SKIPPED : PASSED;
}

/* In a process of its own where there is fork: a crash, or a leak that its sanitizer finds, fails this test. */
static int run(const char *name, void (*body)(void))
{
    int result = FAILED;
#ifdef _WIN32
    const long process = 0;
#else
    const long process = getpid(); /* another that begins in the same microsecond */
#endif
    snprintf(folder, sizeof folder, "%s/oceanxl-test-%ld-%ld-%d",
             getenv("TMPDIR") ? getenv("TMPDIR") : "/tmp", process, (long)(os_seconds() * 1e6), share.index);
#ifdef _WIN32
    result = run_here(name, body);
#else
    const pid_t child = fork();
    int status = 0;
    if (child == 0) exit(run_here(name, body));
    if (child > 0 && waitpid(child, &status, 0) == child && WIFEXITED(status) &&
        WEXITSTATUS(status) < RESULTS)
        result = WEXITSTATUS(status);
    else printf("  ended with status %d\n", status);
#endif
    remove_folder();
    if (result != SKIPPED) printf("%s %s\n", result == PASSED ? "ok  " : "FAIL", name);
    return result;
}

/* Makes threads that wait for others sleep, as the program does: polling makes tests of 1 s one of 64 s on a
 * busy machine. OpenMP reads its settings before main(). */
static void wait_passively(char **argv)
{
#if defined(_OPENMP) && !defined(_WIN32)
    if (!getenv("OMP_WAIT_POLICY") && setenv("OMP_WAIT_POLICY", "passive", 1) == 0)
        execv("/proc/self/exe", argv); /* returns only on failure */
#else
    (void)argv;
#endif
}

int main(int argc, char **argv)
{
    int count[RESULTS] = {0};
    wait_passively(argv);
    setvbuf(stdout, NULL, _IOLBF, 0);
    if (getenv("OXL_TEST_SHARE") &&
        (sscanf(getenv("OXL_TEST_SHARE"), "%d/%d", &share.index, &share.count) != 2 || share.count < 1)) {
        printf("OXL_TEST_SHARE: expected K/N, found '%s'\n", getenv("OXL_TEST_SHARE"));
        return 1;
    }
    for (size_t i = 0; i < OXL_COUNT(tests); i++) {
        if ((int)(i % (size_t)share.count) != share.index || !wanted(tests[i].name, argc, argv)) continue;
        count[run(tests[i].name, tests[i].run)]++;
    }
    printf("%d passed, %d failed, %d skipped\n", count[PASSED], count[FAILED], count[SKIPPED]);
    return count[FAILED] != 0;
}

/* test_lpips.c - LPIPS against tests/lpips.py (numpy), and against the network's published weights where they are
 * at hand. */
#include "test.h"
#include "../lab/lpips.c"

/* A congruential generator, the upper 24 bits: from -1 to 1. */
static float lpips_test_next(uint32_t *state)
{
    *state = *state * 1664525u + 1013904223u;
    return (float)(*state >> 8) / 8388608.0f - 1;
}

static void lpips_test_put(struct text *t, const void *data, size_t size)
{
    CHECK_OK(oxl_reserve(test_ctx, &t->data, &t->capacity, t->size + size, 1));
    memcpy(t->data + t->size, data, size);
    t->size += size;
}

/* Weights as tests/lpips.py draws them: few channels, of no multiple of the kernel's block. Its size. */
static size_t lpips_test_weights(const char *name, size_t drop, size_t change)
{
    static const uint32_t channels[6] = {3, 5, 6, 7, 5, 4}, sizes[5] = {11, 5, 3, 3, 3};
    struct text t = {.ctx = test_ctx};
    uint32_t state = 7;
    size_t size;
    lpips_test_put(&t, "LPIPS1 alex\n", 12);
    for (int k = 0; k < 5; k++) {
        const uint32_t shape[4] = {channels[k + 1], channels[k], sizes[k], sizes[k]};
        const uint32_t taps = channels[k] * sizes[k] * sizes[k];
        lpips_test_put(&t, shape, sizeof shape);
        for (uint32_t i = 0; i < shape[0] * taps; i++) {
            const float w = lpips_test_next(&state) * 2 / (float)sqrt(taps);
            lpips_test_put(&t, &w, 4);
        }
        for (uint32_t i = 0; i < shape[0]; i++) {
            const float w = lpips_test_next(&state) / 4;
            lpips_test_put(&t, &w, 4);
        }
    }
    for (int k = 1; k < 6; k++) {
        lpips_test_put(&t, &channels[k], 4);
        for (uint32_t i = 0; i < channels[k]; i++) {
            const float w = (lpips_test_next(&state) + 1) / 2;
            lpips_test_put(&t, &w, 4);
        }
    }
    if (change) memset(t.data + change - 1, 0xff, 4);
    size = t.size;
    CHECK_OK(os_write_file(test_ctx, test_path(name), t.data, t.size - drop));
    text_free(&t);
    return size;
}

/* Noise, and the same with half of other noise. */
static void lpips_test_pair(int width, int height, oxl_image pair[2])
{
    uint32_t state = 11;
    for (int i = 0; i < 2; i++) CHECK_OK(oxl_image_create(test_ctx, width, height, &pair[i]));
    for (int k = 0; k < 3 * width * height; k++) pair[0].rgb[k] = (lpips_test_next(&state) + 1) / 2;
    for (int k = 0; k < 3 * width * height; k++)
        pair[1].rgb[k] = (pair[0].rgb[k] + (lpips_test_next(&state) + 1) / 2) / 2;
}

static void lpips_test_free(oxl_image pair[2])
{
    for (int i = 0; i < 2; i++) oxl_image_free(test_ctx, &pair[i]);
}

TEST(lpips_of_small_random_networks_is_the_references_at_any_size)
{
    static const struct {
        int width, height;
        double value;
    } cases[] = {{64, 64, 0.6726584}, {71, 93, 0.5419794}, {130, 67, 0.7137190}, {31, 40, 0.5169990}};
    struct lpips net;
    lpips_test_weights("w.bin", 0, 0);
    CHECK_OK(lpips_read(test_ctx, test_path("w.bin"), &net));
    for (size_t k = 0; k < OXL_COUNT(cases); k++) {
        oxl_image pair[2];
        double value = 0, itself = 1;
        lpips_test_pair(cases[k].width, cases[k].height, pair);
        CHECK_OK(lpips_distance(test_ctx, &net, &pair[0], &pair[1], &value));
        CHECK_CLOSE(value, cases[k].value, 1e-5);
        CHECK_OK(lpips_distance(test_ctx, &net, &pair[0], &pair[0], &itself));
        CHECK(itself == 0);
        lpips_test_free(pair);
    }
    lpips_free(&net);
}

TEST(lpips_is_the_same_on_any_number_of_threads_and_leaves_masked_pixels_out)
{
    oxl_image pair[2];
    struct lpips net;
    double one, many, masked;
    const int threads = test_ctx->threads;
    lpips_test_weights("w.bin", 0, 0);
    CHECK_OK(lpips_read(test_ctx, test_path("w.bin"), &net));
    lpips_test_pair(70, 50, pair);
    test_ctx->threads = 1;
    CHECK_OK(lpips_distance(test_ctx, &net, &pair[0], &pair[1], &one));
    test_ctx->threads = 3;
    CHECK_OK(lpips_distance(test_ctx, &net, &pair[0], &pair[1], &many));
    test_ctx->threads = threads;
    CHECK(one == many && one > 0);
    pair[1].weight = oxl_calloc(test_ctx, 70 * 50, sizeof(float));
    CHECK_OK(lpips_distance(test_ctx, &net, &pair[0], &pair[1], &masked));
    CHECK(masked == 0);
    lpips_test_free(pair);
    lpips_test_pair(30, 70, pair);
    CHECK_OK(lpips_distance(test_ctx, &net, &pair[0], &pair[1], &one));
    CHECK(isnan(one)); /* the fourth convolution would have no column */
    lpips_test_free(pair);
    lpips_free(&net);
}

TEST(lpips_weights_that_are_damaged_are_refused)
{
    struct lpips net;
    const size_t size = lpips_test_weights("w.bin", 0, 0);
    for (size_t drop = 0; drop < size; drop += drop < 64 ? 1 : 997) {
        lpips_test_weights("w.bin", drop, drop ? 0 : 13); /* a shape is another */
        CHECK_ERROR(lpips_read(test_ctx, test_path("w.bin"), &net), OXL_ERR_INPUT, "\nfix: ");
        lpips_free(&net);
    }
    CHECK(lpips_read(test_ctx, test_path("none.bin"), &net) == OXL_ERR_INPUT);
    lpips_free(&net);
}

/* values.txt: two images below data/, and the distance by PyTorch. */
TEST(lpips_of_real_images_is_the_references)
{
    const char *shared = test_shared("lpips/alex.bin");
    char folder[512], data[600];
    struct os_file_map map = {0};
    struct lpips net;
    int pairs = 0;
    if (!shared) SKIP("../shared/lpips is not there");
    snprintf(folder, sizeof folder, "%.*s", (int)strlen(shared) - 9, shared);
    snprintf(data, sizeof data, "%s/../data", folder);
    CHECK_OK(lpips_read(test_ctx, PATH(folder, "alex.bin"), &net));
    CHECK_OK(os_read_file(test_ctx, PATH(folder, "values.txt"), &map));
    /* with LPIPS_TEST_ALL all of them: half a minute */
    for (const char *line = getenv("LPIPS_TEST_ALL") ? map.data : strstr(map.data, "subvo_pool/"); *line;
         line += strcspn(line, "\n") + 1) {
        char name[2][200];
        double wanted, value;
        oxl_image pair[2];
        if (sscanf(line, "%199s %199s %lf", name[0], name[1], &wanted) != 3) break;
        for (int i = 0; i < 2; i++) CHECK_OK(oxl_image_read(test_ctx, PATH(data, "%s", name[i]), &pair[i]));
        CHECK_OK(lpips_distance(test_ctx, &net, &pair[0], &pair[1], &value));
        CHECK_CLOSE(value, wanted, 1e-4); /* JPEG decoders differ; of the same pixels it is within 2e-6 */
        lpips_test_free(pair);
        pairs++;
    }
    CHECK(pairs > 0);
    os_release_file(test_ctx, &map);
    lpips_free(&net);
}

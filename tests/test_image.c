/* test_image.c - what comes out of image files, whole and broken, and how images are reduced, undistorted and
 * masked. */
#include "test.h"

#include "../src/survey/image_header.h"

static const struct colmap_camera image_pinhole = {.id = 1,
                                                   .model = 1,
                                                   .width = 64,
                                                   .height = 48,
                                                   .parameter = {60, 60, 32, 24},
                                                   .file = "cameras.txt",
                                                   .line = 4};

static struct colmap_camera image_lens(void)
{
    return (struct colmap_camera){.id = 1,
                                  .model = camera_model_find("SIMPLE_RADIAL", 13),
                                  .width = 64,
                                  .height = 48,
                                  .parameter = {80, 32, 24, -0.3}};
}

static uint8_t image_pattern(int x, int y, int c)
{
    return (uint8_t)(x * 3 + y * (2 + c) + 40 * c);
}

static void image_append(void *user, void *data, int size)
{
    struct text *t = user;
    CHECK_OK(oxl_reserve(test_ctx, &t->data, &t->capacity, t->size + (size_t)size, 1));
    memcpy(t->data + t->size, data, (size_t)size);
    t->size += (size_t)size;
}

static void image_append_png(struct text *t, const uint8_t *rows, int w, int h, int channels)
{
    int size = 0;
    uint8_t *png = codec_encode_png(test_ctx, rows, w, h, channels, &size);
    CHECK(png);
    image_append(t, png, size);
    codec_free(test_ctx, png);
}

/* An image of w x h px with the pattern above. */
static const char *image_test_file(const char *name, int w, int h)
{
    const char *path = test_path(name);
    OWNED_TEXT file = test_text();
    uint8_t *bytes = oxl_alloc(test_ctx, (size_t)w * h, 3);
    for (int i = 0; i < w * h; i++)
        for (int c = 0; c < 3; c++) bytes[3 * i + c] = image_pattern(i % w, i / w, c);
    image_append_png(&file, bytes, w, h, 3);
    test_write_bytes(path, file.data, file.size);
    oxl_free(test_ctx, bytes);
    return path;
}

/* A grey PNG from a drawing: '.' white, '#' black. */
static const char *image_mask(const char *name, int w, int h, const char *drawing)
{
    const char *path = test_path(name);
    OWNED_TEXT file = test_text();
    uint8_t bytes[64];
    for (int i = 0; i < w * h; i++) bytes[i] = drawing[i] == '#' ? 0 : 255;
    image_append_png(&file, bytes, w, h, 1);
    test_write_bytes(path, file.data, file.size);
    return path;
}

static const char *image_bytes(const char *name, const char *bytes, size_t size)
{
    const char *path = test_path(name);
    test_write_bytes(path, bytes, size);
    return path;
}

static oxl_camera image_camera(int w, int h)
{
    return (oxl_camera){
        .width = w, .height = h, .fx = 60.0 * w / 64, .fy = 60.0 * h / 48, .cx = w / 2.0, .cy = h / 2.0};
}

TEST(image_png_comes_back_as_it_was_written)
{
    const char *path = test_path("a.png");
    OWNED_IMAGE a = test_image(37, 11);
    for (int i = 0; i < 3 * 37 * 11; i++) a.rgb[i] = (float)(i % 256) / 255.0f;
    test_write_image(path, &a);
    OWNED_IMAGE b = test_read_image(path);
    CHECK(b.width == 37 && b.height == 11 && !b.weight);
    CHECK(memcmp(a.rgb, b.rgb, 3 * 37 * 11 * sizeof(float)) == 0);
}

static void image_chunk(struct text *png, const char *type, const void *data, size_t size)
{
    const char length[4] = {0, 0, (char)(size >> 8), (char)size};
    const size_t at = png->size + 4;
    char big[4];
    image_append(png, (void *)(uintptr_t)length, 4);
    image_append(png, (void *)(uintptr_t)type, 4);
    image_append(png, (void *)(uintptr_t)data, (int)size);
    unsigned sum = codec_png_checksum((const uint8_t *)png->data + at, (int)(png->size - at));
    for (int k = 0; k < 4; k++) big[k] = (char)(sum >> (24 - 8 * k));
    image_append(png, big, 4);
}

/* stb leaves them as they lay on the stack. */
TEST(image_colours_that_a_palette_has_not_are_black)
{
    static unsigned char row[5] = {0, 0, 1, 2, 255}; /* no filter; four pixels */
    static const char head[] = {0, 0, 0, 4, 0, 0, 0, 1, 8, 3, 0, 0, 0}, two[] = {10, 20, 30, 40, 50, 60};
    static const uint8_t wanted[12] = {10, 20, 30, 40, 50, 60};
    OWNED_TEXT png = test_text();
    struct pixels pixels;
    int size;
    unsigned char *packed = codec_deflate(test_ctx, row, 5, &size);
    image_append(&png, (void *)(uintptr_t) "\x89PNG\r\n\x1a\n", 8);
    image_chunk(&png, "IHDR", head, 13);
    image_chunk(&png, "PLTE", two, 6);
    image_chunk(&png, "IDAT", packed, (size_t)size);
    image_chunk(&png, "IEND", "", 0);
    CHECK_OK(image_decode(test_ctx, image_bytes("palette.png", png.data, png.size), 3, &pixels));
    CHECK(pixels.width == 4 && memcmp(pixels.data, wanted, 12) == 0);
    image_pixels_free(test_ctx, &pixels);
    codec_free(test_ctx, packed);
}

TEST(image_png_of_linear_light_gets_the_curve_of_srgb_but_no_mask_or_alpha_does)
{
    static unsigned char row[5] = {0, 0, 55, 255, 55}; /* no filter; a pixel */
    static const char head[] = {0, 0, 0, 1, 0, 0, 0, 1, 8, 6, 0, 0, 0},
                      gamma[] = {0, 1, (char)0x86, (char)0xa0};
    int size;
    unsigned char *packed = codec_deflate(test_ctx, row, 5, &size);
    for (int states = 0; states < 2; states++) {
        OWNED_TEXT png = test_text();
        struct pixels pixels;
        const uint8_t wanted[4] = {0, states ? 55 : 128, 255, 55};
        image_append(&png, (void *)(uintptr_t) "\x89PNG\r\n\x1a\n", 8);
        image_chunk(&png, "IHDR", head, 13);
        image_chunk(&png, "gAMA", gamma, 4);
        if (states) image_chunk(&png, "sRGB", "", 1);
        image_chunk(&png, "IDAT", packed, (size_t)size);
        image_chunk(&png, "IEND", "", 0);
        CHECK_OK(image_decode(test_ctx, image_bytes("linear.png", png.data, png.size), 4, &pixels));
        CHECK(memcmp(pixels.data, wanted, 4) == 0);
        image_pixels_free(test_ctx, &pixels);
        CHECK_OK(image_decode(test_ctx, test_path("linear.png"), 1, &pixels));
        CHECK(pixels.data[0] < 100);
        image_pixels_free(test_ctx, &pixels);
    }
    codec_free(test_ctx, packed);
}

TEST(image_write_clamps_and_paints_not_a_number_black)
{
    const float in[4] = {-3, NAN, 7, INFINITY}, out[4] = {0, 0, 1, 1};
    oxl_image a = test_image(4, 1);
    for (int c = 0; c < 3; c++) memcpy(a.rgb + 4 * c, in, sizeof in);
    test_write_image("a.png", &a);
    OWNED_IMAGE b = test_read_image("a.png");
    for (int i = 0; i < 12; i++) CHECK(b.rgb[i] == out[i % 4]);
    oxl_image_free(test_ctx, &a);
    CHECK(oxl_image_write(test_ctx, test_path("b.png"), &a) == OXL_ERR_USAGE);
    CHECK(oxl_image_create(test_ctx, 0, 5, &a) == OXL_ERR_USAGE);
}

TEST(image_png_of_16_bits_is_rounded_and_grey_becomes_rgb)
{
    static const char png[] = /* 4 x 1, grey, 16 bits: 0 65535 254 32896 */
        "\x89\x50\x4e\x47\x0d\x0a\x1a\x0a\x00\x00\x00\x0d\x49\x48\x44\x52\x00\x00\x00\x04\x00\x00\x00\x01\x10\x00\x00\x00"
        "\x00\x8c\xc7\x8c\x52\x00\x00\x00\x11\x49\x44\x41\x54\x78\xda\x63\x60\x60\xf8\xff\x9f\xe1\x5f\x43\x03\x00\x0f\x78"
        "\x03\xfd\x92\xec\xff\x1f\x00\x00\x00\x00\x49\x45\x4e\x44\xae\x42\x60\x82";
    static const uint8_t wanted[4] = {0, 255, 1, 128};
    struct pixels p;
    CHECK_OK(image_decode(test_ctx, image_bytes("grey.png", png, sizeof png - 1), 3, &p));
    for (int i = 0; i < 12; i++) CHECK(p.data[i] == wanted[i / 3]);
    image_pixels_free(test_ctx, &p);
}

TEST(image_alpha_of_a_png_is_ignored_unless_it_is_asked_for)
{
    static const char png[] = /* 2 x 1, RGBA: 10 20 30 0, 200 100 50 128 */
        "\x89\x50\x4e\x47\x0d\x0a\x1a\x0a\x00\x00\x00\x0d\x49\x48\x44\x52\x00\x00\x00\x02\x00\x00\x00\x01\x08\x06\x00\x00"
        "\x00\xf4\x22\x7f\x8a\x00\x00\x00\x11\x49\x44\x41\x54\x78\xda\x63\xe0\x12\x91\x63\x38\x91\x62\xd4\x00\x00\x06\xc9"
        "\x02\x1b\x4d\x33\xef\x54\x00\x00\x00\x00\x49\x45\x4e\x44\xae\x42\x60\x82";
    static const uint8_t wanted[6] = {10, 20, 30, 200, 100, 50};
    struct pixels p;
    CHECK_OK(image_decode(test_ctx, image_bytes("rgba.png", png, sizeof png - 1), 3, &p));
    CHECK(memcmp(p.data, wanted, 6) == 0);
    image_pixels_free(test_ctx, &p);
}

static void image_refused(const char *path, const char *words)
{
    oxl_image image;
    CHECK(oxl_image_read(test_ctx, path, &image) == OXL_ERR_INPUT && image.rgb == NULL && image.width == 0);
    CHECK_SAYS(path);
    CHECK_SAYS(words);
    CHECK_SAYS("fix: ");
}

TEST(image_of_another_file_type_is_refused_by_name)
{
    static const char giant[] = /* 40000 x 1, grey */
        "\x89\x50\x4e\x47\x0d\x0a\x1a\x0a\x00\x00\x00\x0d\x49\x48\x44\x52\x00\x00\x9c\x40\x00\x00\x00\x01\x08\x00\x00\x00"
        "\x00\x98\x0b\x94\x58\x00\x00\x00\x3d\x49\x44\x41\x54\x78\xda\xed\xc1\x31\x01\x00\x00\x00\xc2\xa0\xf5\x4f\xed\x67"
        "\x0a\xa0\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00"
        "\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x00\x80\x1b\x9c\x41\x00\x01\xe5\x4f\xfe\xdf\x00\x00\x00\x00\x49\x45"
        "\x4e\x44\xae\x42\x60\x82";
    oxl_image image;
    image_refused(test_write("text.jpg", "GIF89a, say"), "neither a JPEG nor a PNG");
    image_refused(test_write("empty.jpg", ""), "it is empty");
    image_refused(image_bytes("giant.png", giant, sizeof giant - 1), "40000 x 1 px");
    CHECK(oxl_image_read(test_ctx, test_path("none.jpg"), &image) != OXL_OK);
    CHECK_SAYS("none.jpg");
}

/* Small images of every kind: baseline with 4:2:0 and a preview in its EXIF segment, progressive, and a
 * PNG. */
static const char *const image_kinds[] = {"tests/data/baseline.jpg", "tests/data/progressive.jpg",
                                          "tests/data/photo.png"};

/* A copy of a file's bytes, in twice their memory. */
static char *image_copy(const char *path, size_t *size)
{
    OWNED_FILE whole;
    CHECK_OK(os_read_file(test_ctx, path, &whole));
    char *bytes = oxl_calloc(test_ctx, 2 * whole.size, 1);
    memcpy(bytes, whole.data, whole.size);
    *size = whole.size;
    return bytes;
}

/* A PNG is whole without its last chunk, IEND, of 12 bytes. */
TEST(image_cut_anywhere_is_refused)
{
    for (size_t k = 0; k < OXL_COUNT(image_kinds); k++) {
        OWNED_FILE whole;
        oxl_image image;
        int taken = 0;
        CHECK_OK(oxl_image_read(test_ctx, image_kinds[k], &image));
        CHECK(image.width == 64 && image.height == 48);
        oxl_image_free(test_ctx, &image);
        CHECK_OK(os_read_file(test_ctx, image_kinds[k], &whole));
        for (size_t size = 0; size < whole.size - (k == 2 ? 12 : 0);
             size += size + 80 < whole.size ? 37 : 1) {
            taken +=
                oxl_image_read(test_ctx, image_bytes("cut.jpg", whole.data, size), &image) != OXL_ERR_INPUT;
            oxl_image_free(test_ctx, &image);
        }
        CHECK(taken == 0);
    }
}

/* The decoder compares no checksum: some of these would be other pixels without a word. */
TEST(image_png_with_a_changed_byte_is_refused)
{
    size_t size;
    OWNED_MEMORY char *bytes = image_copy("tests/data/photo.png", &size);
    for (size_t i = 0; i < 60; i++) {
        char *changed = &bytes[60 + i * (size - 80) / 60];
        *changed ^= 1;
        image_refused(image_bytes("changed.png", bytes, size), "fix: ");
        *changed ^= 1;
    }
}

TEST(image_png_that_was_cut_is_found_by_its_chunks_alone)
{
    OWNED_FILE whole;
    int w, h;
    CHECK_OK(os_read_file(test_ctx, "tests/data/photo.png", &whole));
    CHECK_OK(image_size(test_ctx, "tests/data/photo.png", &w, &h));
    for (size_t part = 1; part < 8; part++) {
        const char *path = image_bytes("cut.png", whole.data, whole.size * part / 8);
        CHECK_ERROR(image_size(test_ctx, path, &w, &h), OXL_ERR_INPUT, "it ends too early");
    }
}

/* Where a marker stands in a JPEG. */
static char *image_marker(char *bytes, size_t size, unsigned char marker)
{
    for (size_t i = 0; i + 1 < size; i++)
        if ((unsigned char)bytes[i] == 0xff && (unsigned char)bytes[i + 1] == marker) return bytes + i;
    return NULL;
}

TEST(image_jpeg_that_would_overrun_the_decoder_is_refused)
{
    /* a table before the frame header, its 16 counts beyond the end of its segment */
    static const char early[] =
        "\xff\xd8\xff\xc4\x00\x03\x00\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff\xff";
    size_t size;
    OWNED_MEMORY char *twice = image_copy("tests/data/progressive.jpg", &size);
    OWNED_MEMORY char *table = image_copy("tests/data/progressive.jpg", &size);
    char *frame = image_marker(twice, size, 0xc2);
    image_refused(image_bytes("early.jpg", early, sizeof early - 1), "a Huffman table is damaged");
    memset(image_marker(table, size, 0xc4) + 5, 255, 16); /* a table of 4080 symbols */
    image_refused(image_bytes("tables.jpg", table, size), "a Huffman table is damaged");
    size_t length = 2 + (size_t)((unsigned char)frame[2] << 8 | (unsigned char)frame[3]);
    memmove(frame + length, frame, size - (size_t)(frame - twice)); /* a frame header twice */
    image_refused(image_bytes("frames.jpg", twice, size + length), "two frame headers");
}

TEST(image_jpeg_whose_scan_has_no_table_is_refused)
{
    static const char *const kinds[] = {"tests/data/baseline.jpg", "tests/data/progressive.jpg"};
    for (size_t k = 0; k < OXL_COUNT(kinds); k++) {
        size_t size;
        OWNED_MEMORY char *bytes = image_copy(kinds[k], &size);
        char *scan = bytes + size - 8;
        while (memcmp(scan, "\xff\xda", 2) != 0) scan--; /* not that of a preview */
        scan[6] = 0x33;                                  /* of its first component */
        image_refused(image_bytes("scan.jpg", bytes, size), "a scan has no Huffman table");
    }
}

TEST(image_with_flipped_bits_is_read_or_refused_without_a_crash)
{
    for (size_t k = 0; k < OXL_COUNT(image_kinds); k++) {
        for (uint64_t i = 0; i < 200; i++) {
            OWNED_IMAGE image = {0};
            size_t size;
            OWNED_MEMORY char *bytes = image_copy(image_kinds[k], &size);
            for (uint64_t j = 0; j < 3; j++)
                bytes[random_bits(i, j, 0) % size] ^= (char)(1 << random_bits(i, j, 1) % 8);
            oxl_result rc = oxl_image_read(test_ctx, image_bytes("flipped", bytes, size), &image);
            CHECK(rc == OXL_OK || rc == OXL_ERR_INPUT);
            CHECK((rc == OXL_OK) == (image.rgb != NULL));
        }
    }
}

/* The sums were taken with stb built without its SIMD paths (-DSTBI_NO_SIMD). */
TEST(image_jpeg_of_another_coding_is_not_called_damaged)
{
    static const char arithmetic[] = "\xff\xd8\xff\xc9\0\x0b\x08\0\x10\0\x10\x01\x01\x11\0\xff\xd9",
                      lossless[] = "\xff\xd8\xff\xc3\0\x0b\x08\0\x10\0\x10\x01\x01\x11\0\xff\xd9",
                      of_12_bits[] = "\xff\xd8\xff\xc1\0\x0b\x0c\0\x10\0\x10\x01\x01\x11\0\xff\xd9";
    int w, h;
    test_write_bytes("a.jpg", arithmetic, sizeof arithmetic - 1);
    CHECK_ERROR(image_size(test_ctx, test_path("a.jpg"), &w, &h), OXL_ERR_INPUT,
                "a JPEG with arithmetic coding");
    test_write_bytes("a.jpg", lossless, sizeof lossless - 1);
    CHECK_ERROR(image_size(test_ctx, test_path("a.jpg"), &w, &h), OXL_ERR_INPUT, "a JPEG with lossless");
    test_write_bytes("a.jpg", of_12_bits, sizeof of_12_bits - 1);
    CHECK_ERROR(image_size(test_ctx, test_path("a.jpg"), &w, &h), OXL_ERR_INPUT, "or more than 8 bits");
}

TEST(image_jpeg_bytes_do_not_depend_on_simd)
{
    static const uint64_t sums[] = {UINT64_C(0x259690ffcf0fcbec), UINT64_C(0x5ddc3bf00bb6ebb0)};
    for (size_t k = 0; k < OXL_COUNT(sums); k++) {
        struct pixels p;
        uint64_t sum = UINT64_C(1469598103934665603); /* FNV-1a */
        CHECK_OK(image_decode(test_ctx, image_kinds[k], 3, &p));
        for (int i = 0; i < 3 * p.width * p.height; i++) sum = (sum ^ p.data[i]) * UINT64_C(1099511628211);
        CHECK(sum == sums[k]);
        image_pixels_free(test_ctx, &p);
    }
}

static struct training_image image_load(const char *path, const char *mask, const struct colmap_camera *from,
                                        const oxl_camera *to)
{
    struct training_image image;
    CHECK_OK(image_load_training(test_ctx, path, mask, NULL, from, to, &image));
    return image;
}

TEST(image_reduction_is_the_exact_mean_over_the_area)
{
    const char *path = image_test_file("p.png", 64, 48);
    oxl_camera to = image_camera(24, 12); /* 64/24 = 2 2/3 px wide, 4 high */
    OWNED_TRAINING image = image_load(path, NULL, &image_pinhole, &to);
    CHECK(image.width == 24 && image.height == 12 && !image.mask);
    for (int at = 0; at < 3 * 24 * 12; at++) {
        const int c = at / (24 * 12), y = at / 24 % 12, x = at % 24;
        double sum = 0, weight = 0;
        for (int j = 4 * y; j < 4 * y + 4; j++)
            for (int i = 0; i < 64; i++) {
                const double overlap = OXL_MIN(i + 1, (x + 1) * 64.0 / 24) - OXL_MAX(i, x * 64.0 / 24);
                if (overlap <= 0) continue;
                sum += overlap * image_pattern(i, j, c);
                weight += overlap;
            }
        CHECK_CLOSE(image.rgb[at], sum / weight, 0.5 + 1e-9);
    }
}

TEST(image_of_the_right_size_is_taken_byte_by_byte)
{
    const char *path = image_test_file("p.png", 64, 48);
    oxl_camera to = image_camera(64, 48);
    OWNED_TRAINING image = image_load(path, NULL, &image_pinhole, &to);
    float rgb[3 * 64 * 48], weight[64 * 48];
    int wrong = 0;
    image_from_training(test_ctx, &image, NULL, rgb, weight);
    for (int at = 0; at < 3 * 64 * 48; at++) {
        const int v = image_pattern(at % 64, at / 64 % 48, at / (64 * 48));
        wrong += image.rgb[at] != v || rgb[at] != (float)v / 255.0f || weight[at % (64 * 48)] != 1;
    }
    CHECK(wrong == 0);
}

TEST(image_resized_after_colmap_is_taken_but_no_other_shape)
{
    oxl_camera to = image_camera(32, 24);
    struct training_image image;
    OWNED_TRAINING half = image_load(image_test_file("half.png", 32, 24), NULL, &image_pinhole, &to);
    CHECK(half.width == 32);
    CHECK_ERROR(image_load_training(test_ctx, image_test_file("crop.png", 60, 48), NULL, NULL, &image_pinhole,
                                    &to, &image),
                OXL_ERR_INPUT, "crop.png has 60 x 48 px, but camera 1 (cameras.txt:4) has 64 x 48");
    CHECK(!image.rgb);
    CHECK_ERROR(image_load_training(test_ctx, image_test_file("turned.png", 48, 64), NULL, NULL,
                                    &image_pinhole, &to, &image),
                OXL_ERR_INPUT, "fix: turn it");
}

/* The pattern is linear in x and y, so a bilinear sample of it is exact, and so is a mean of samples. */
static void image_check_undistorted(int file_width, int file_height, double reduction)
{
    const struct colmap_camera from = image_lens();
    const double zoom = file_width / 64.0;
    oxl_camera to;
    double worst = 0;
    CHECK_OK(camera_undistorted(test_ctx, &from, &to));
    to.width = (int)(to.width / reduction);
    to.height = (int)(to.height / reduction);
    to.fx /= reduction;
    to.fy /= reduction;
    to.cx /= reduction;
    to.cy /= reduction;
    OWNED_TRAINING image = image_load(image_test_file("d.png", file_width, file_height), NULL, &from, &to);
    CHECK(!image.mask);
    for (int at = 0; at < to.width * to.height; at++) { /* red: 3 x + 2 y, which wraps round at 256 */
        const double direction[2] = {(at % to.width + 0.5 - to.cx) / to.fx,
                                     (at / to.width + 0.5 - to.cy) / to.fy};
        double p[2];
        camera_distort(&from, direction, p);
        double wanted = 3 * (zoom * p[0] - 0.5) + 2 * (zoom * p[1] - 0.5);
        if (wanted < 240) worst = OXL_MAX(worst, fabs(image.rgb[at] - wanted));
    }
    CHECK_CLOSE(worst, 0, 0.6); /* half a level, and a little from 1/256 px and the curve within a pixel */
}

TEST(image_undistortion_follows_the_camera_model)
{
    image_check_undistorted(64, 48, 1);
    image_check_undistorted(32, 24, 1); /* the file was halved after COLMAP saw it */
    image_check_undistorted(64, 48, 2.5);
}

TEST(image_undistorted_agrees_with_colmaps_own)
{
    static const struct colmap_camera lens = {
        .id = 1,
        .model = 2,
        .width = 960,
        .height = 512,
        .parameter = {1042.8142056641748, 480, 256, -0.27931708280078082}};
    static const struct colmap_camera ideal = {
        .id = 1,
        .model = 1,
        .width = 1028,
        .height = 520,
        .parameter = {1042.8142056641748, 1042.8142056641748, 514, 260}};
    oxl_camera to;
    double error = 0;
    if (!test_shared("data/subvo_pool_distorted/images/f150.jpg")) SKIP("no ../shared/data");
    CHECK_OK(camera_undistorted(test_ctx, &lens, &to));
    OWNED_TRAINING ours =
                       image_load(test_shared("data/subvo_pool_distorted/images/f150.jpg"), NULL, &lens, &to),
                   colmaps = image_load(test_shared("data/subvo_pool/images/f150.jpg"), NULL, &ideal, &to);
    CHECK(!ours.mask);
    for (int i = 0; i < 3 * to.width * to.height; i++)
        error += (ours.rgb[i] - colmaps.rgb[i]) * (ours.rgb[i] - colmaps.rgb[i]);
    error /= 3.0 * to.width * to.height;
    /* 36 dB: its JPEG of quality 92 lies between; 1/8 px off would be 36.2 -> 35 */
    CHECK(error < 255.0 * 255 / 4000);
}

TEST(image_mask_covers_every_pixel_that_touches_black)
{
    const char *path = image_test_file("p.png", 64, 48);
    const char *mask = image_mask("m.png", 4, 3,
                                  "...."
                                  ".#.."
                                  "...#");
    oxl_camera to = image_camera(16, 12), odd = image_camera(6, 4);
    struct training_image refused;
    OWNED_TRAINING image = image_load(path, mask, &image_pinhole, &to),
                   at_odd = image_load(path, mask, &image_pinhole, &odd),
                   white = image_load(path, image_mask("white.png", 2, 2, "...."), &image_pinhole, &to);
    for (int i = 0; i < 16 * 12; i++) {
        const int x = i % 16 / 4, y = i / 16 / 4;
        CHECK(image.mask[i] == ((x == 1 && y == 1) || (x == 3 && y == 2) ? 0 : 255));
    }
    CHECK(memcmp(at_odd.mask,
                 "\377\377\377\377\377\377"
                 "\377\0\0\377\377\377"
                 "\377\0\0\377\0\0"
                 "\377\377\377\377\0\0",
                 24) == 0);
    CHECK(!white.mask);
    CHECK_ERROR(
        image_load_training(test_ctx, path, test_write("bad.png", "no"), NULL, &image_pinhole, &to, &refused),
        OXL_ERR_INPUT, "bad.png");
}

TEST(image_mask_is_undistorted_with_its_image)
{
    const struct colmap_camera from = image_lens();
    const char *mask = image_mask("m.png", 4, 3,
                                  "#..."
                                  "...."
                                  "....");
    oxl_camera to;
    int wrong = 0;
    CHECK_OK(camera_undistorted(test_ctx, &from, &to));
    OWNED_TRAINING image = image_load(image_test_file("p.png", 64, 48), mask, &from, &to);
    CHECK(image.mask && image.mask[0] == 0);
    for (int i = 0; image.mask && i < to.width * to.height; i++) {
        const double direction[2] = {(i % to.width + 0.5 - to.cx) / to.fx,
                                     (i / to.width + 0.5 - to.cy) / to.fy};
        double p[2];
        camera_distort(&from, direction, p);
        wrong += (image.mask[i] == 0) != (p[0] < 16 && p[1] < 16);
    }
    CHECK(wrong == 0);
}

TEST(image_image_is_the_same_with_any_number_of_threads)
{
    const struct colmap_camera from = image_lens();
    const char *path = image_test_file("p.png", 64, 48);
    oxl_camera to;
    CHECK_OK(camera_undistorted(test_ctx, &from, &to));
    for (int distorted = 0; distorted < 2; distorted++) {
        const struct colmap_camera *camera = distorted ? &from : &image_pinhole;
        test_ctx->threads = 1;
        OWNED_TRAINING one = image_load(path, NULL, camera, &to);
        test_ctx->threads = 7;
        OWNED_TRAINING many = image_load(path, NULL, camera, &to);
        CHECK(memcmp(one.rgb, many.rgb, (size_t)3 * to.width * to.height) == 0);
    }
}

TEST(image_halved_is_means_of_four_and_drops_an_odd_edge)
{
    float rgb[3 * 5 * 3], weight[5 * 3];
    for (int i = 0; i < 3 * 5 * 3; i++) rgb[i] = (float)(i % 15 + 100 * (i / 15));
    for (int i = 0; i < 5 * 3; i++) weight[i] = i != 6; /* row 1, column 1 */
    image_halve(5, 3, rgb, weight);
    for (int c = 0; c < 3; c++) {
        CHECK_CLOSE(rgb[2 * c], 100 * c + (0 + 1 + 5 + 6) / 4.0, 1e-5);
        CHECK_CLOSE(rgb[2 * c + 1], 100 * c + (2 + 3 + 7 + 8) / 4.0, 1e-5);
    }
    CHECK(weight[0] == 0 && weight[1] == 1);
}

/* ---------------- alpha */

/* 64 x 48 px of the pattern; alpha: a column's index x 4, so that most are in between. */
static const char *image_with_alpha(const char *name)
{
    OWNED_IMAGE image = test_image(64, 48);
    image.weight = oxl_alloc(test_ctx, 64 * 48, sizeof *image.weight);
    for (int i = 0; i < 64 * 48; i++) {
        for (int c = 0; c < 3; c++)
            image.rgb[c * 64 * 48 + i] = (float)image_pattern(i % 64, i / 64, c) / 255.0f;
        image.weight[i] = (float)(i % 64 * 4) / 255.0f;
    }
    CHECK_OK(oxl_image_write_alpha(test_ctx, test_path(name), &image));
    return test_path(name);
}

TEST(image_with_alpha_is_composited_before_it_is_reduced)
{
    const struct image_alpha over = {0, {255, 100, 0}};
    const char *path = image_with_alpha("alpha.png");
    oxl_camera to = image_camera(16, 12);
    OWNED_TRAINING image = {0};
    for (int k = 0; k < 4; k++) {
        const char *const files[] = {path, image_test_file("p.png", 64, 48), "nothing",
                                     test_write("x.png", "\x89PNG")};
        struct image_header header;
        CHECK_OK(image_read_header(test_ctx, files[k], &header));
        CHECK(header.has_alpha == (k == 0));
    }
    CHECK_OK(image_load_training(test_ctx, path, NULL, &over, &image_pinhole, &to, &image));
    CHECK(!image.mask);
    for (int at = 0; at < 3 * 16 * 12; at++) {
        const int c = at / (16 * 12), y = at / 16 % 12, x = at % 16;
        double sum = 0;
        for (int j = 4 * y; j < 4 * y + 4; j++)
            for (int i = 4 * x; i < 4 * x + 4; i++) {
                const double alpha = 4 * i / 255.;
                sum += alpha * image_pattern(i, j, c) + (1 - alpha) * over.background[c];
            }
        CHECK_CLOSE(image.rgb[at], sum / 16, 1.0);
    }
}

TEST(image_with_alpha_as_its_mask_leaves_out_transparent_pixels_and_those_of_the_mask)
{
    const struct image_alpha masks = {1, {0, 0, 0}};
    const char *path = image_with_alpha("alpha.png");
    const char *mask = image_mask("m.png", 4, 1, "...#");
    oxl_camera to = image_camera(64, 48);
    for (int with = 0; with < 2; with++) {
        OWNED_TRAINING image;
        CHECK_OK(
            image_load_training(test_ctx, path, with ? mask : NULL, &masks, &image_pinhole, &to, &image));
        for (int i = 0; image.mask && i < 64 * 48; i++) {
            const int x = i % 64;
            CHECK(image.mask[i] == (x < 32 || (with && x >= 48) ? 0 : 255));
            CHECK(image.rgb[i] == image_pattern(x, i / 64, 0));
        }
        CHECK(image.mask != NULL);
    }
}

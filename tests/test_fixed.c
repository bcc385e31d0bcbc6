/* test_fixed.c - pixels that show the same in all images of a camera are masked, and nothing else is. */
#include "test.h"

enum { FIXED_TEST_VIEWS = 12, FIXED_TEST_W = 96, FIXED_TEST_H = 64 };

/* Smooth random ground, another one in each image: values of a grid of 5 px, interpolated. */
static float fixed_ground(int view, int channel, double x, double y)
{
    const double u = x / 5, v = y / 5, a = u - floor(u), b = v - floor(v);
    double value[4];
    for (uint64_t k = 0; k < 4; k++)
        value[k] = random_unit(random_bits(
            11 + (uint64_t)view, (uint64_t)(u + (k & 1)) * 99 + (uint64_t)(v + (k >> 1)), (uint64_t)channel));
    return (float)(0.2 + 0.6 * ((1 - b) * ((1 - a) * value[0] + a * value[1]) +
                                b * ((1 - a) * value[2] + a * value[3])));
}

enum fixed_kind {
    FIXED_NOTHING,
    FIXED_ROUND_PORT,
    FIXED_SOFT_PORT,
    FIXED_TWO_SIDES,
    FIXED_LETTERBOX,
    FIXED_HALF_TEXT,
    FIXED_LOGO,
    FIXED_MOUNT,
    FIXED_SHADOW,
    FIXED_FRAME,
    FIXED_WHITE_STUDIO,
    FIXED_BLACK_STUDIO,
    FIXED_SKY,
    FIXED_LAMP,
    FIXED_KINDS
};

/* What a pixel shows of the overlay: opacity, colour, factor of the light; noise: in levels. */
struct fixed_pixel {
    double opacity, grey, light, noise;
};

static struct fixed_pixel fixed_paint(enum fixed_kind kind, int view, int x, int y)
{
    const double u = x + 0.5 - FIXED_TEST_W / 2.0, v = y + 0.5 - FIXED_TEST_H / 2.0, r = sqrt(u * u + v * v),
                 object = hypot(u - 14 * sin(view * 1.7), v - 9 * cos(view * 2.3));
    switch (kind) {
    case FIXED_ROUND_PORT: return (struct fixed_pixel){r > 50, 0, 1, 4};
    case FIXED_SOFT_PORT: return (struct fixed_pixel){0, 0, OXL_CLAMP((52 - r) / 5, 0, 1), 4};
    case FIXED_TWO_SIDES: return (struct fixed_pixel){x < 6 || y < 5, 0, 1, 0};
    case FIXED_LETTERBOX: return (struct fixed_pixel){y < 8 || y >= 56, 0.02, 1, 3};
    case FIXED_HALF_TEXT:
        return (struct fixed_pixel){x >= 8 && x < 50 && y >= 54 && y < 60 && (x / 2 + y / 3) % 2 ? 0.5 : 0, 1,
                                    1, 0};
    case FIXED_LOGO: return (struct fixed_pixel){x >= 76 && x < 92 && y >= 50 && y<60, x> 82, 1, 2};
    case FIXED_MOUNT: return (struct fixed_pixel){x < 26 && y > 44 + x / 2, 0.3 + 0.2 * (x / 3 % 2), 1, 3};
    case FIXED_SHADOW: return (struct fixed_pixel){0, 0, x >= 60 && x < 72 ? 0.2 : 1, 2};
    case FIXED_FRAME: return (struct fixed_pixel){x < 3 || x >= 93 || y < 3 || y >= 61, 1, 1, 0};
    case FIXED_WHITE_STUDIO: return (struct fixed_pixel){object > 14, 1, 1, 0};
    case FIXED_BLACK_STUDIO: return (struct fixed_pixel){object > 14, 0, 1, 0};
    case FIXED_SKY: return (struct fixed_pixel){y < 24, 0.6 + 0.01 * y, 1, 2};
    case FIXED_LAMP: return (struct fixed_pixel){0, 0, exp(-r * r / 900), 2};
    default: return (struct fixed_pixel){0, 0, 1, 0};
    }
}

/* Writes a survey of images that two cameras take in turns, with overlays of their own, and loads it. */
static oxl_scene *fixed_survey(enum fixed_kind first, enum fixed_kind second, int mask)
{
    const size_t pixels = (size_t)FIXED_TEST_W * FIXED_TEST_H;
    oxl_scene_options options = oxl_scene_options_default();
    OWNED_TEXT images = test_text();
    test_write("s/sparse/0/cameras.txt", "1 PINHOLE 96 64 80 80 48 32\n2 PINHOLE 96 64 80 80 48 32\n");
    test_write("s/sparse/0/points3D.txt", "1 0 0 5 90 80 70 0.5 1 0 3 0\n");
    test_make_folder("s/images");
    OWNED_IMAGE image = test_image(FIXED_TEST_W, FIXED_TEST_H);
    for (int v = 0; v < 2 * FIXED_TEST_VIEWS; v++) {
        for (size_t i = 0; i < 3 * pixels; i++) {
            const int x = (int)(i % pixels % FIXED_TEST_W), y = (int)(i % pixels / FIXED_TEST_W);
            const struct fixed_pixel p = fixed_paint(v % 2 ? second : first, v, x, y);
            image.rgb[i] =
                (float)((fixed_ground(v, (int)(i / pixels), x, y) * (1 - p.opacity) + p.grey * p.opacity) *
                            p.light +
                        p.noise / 255 * (random_unit(random_bits(3, i, (uint64_t)v)) - 0.5));
        }
        test_write_image(test_path("s/images/%02d.png", v), &image);
        text_add(&images, "%d 1 0 0 0 %.17g 0 0 %d %02d.png\n1 2 1\n", v + 1, 0.1 * v, 1 + v % 2, v);
    }
    test_write("s/sparse/0/images.txt", images.data);
    options.auto_mask = mask;
    test_listen();
    oxl_scene *scene = test_load("s", &options);
    return scene;
}

/* Counts the pixels of a view that are masked and, of those of the overlay, not; far: masked more than 4 px
 * away from it. */
static void fixed_count(const oxl_scene *scene, int view, enum fixed_kind kind, int *missed, int *far)
{
    const struct training_image *image = scene_image(test_ctx, scene, view);
    *missed = *far = 0;
    for (int y = 0; y < FIXED_TEST_H; y++)
        for (int x = 0; x < FIXED_TEST_W; x++) {
            const int masked = image->mask && !image->mask[y * FIXED_TEST_W + x];
            int near = 0;
            for (int k = 0; k < 81; k++) {
                const struct fixed_pixel p = fixed_paint(kind, view, x + k % 9 - 4, y + k / 9 - 4);
                near |= p.opacity > 0 || p.light < 0.3;
                if (k == 40) *missed += (p.opacity > 0 || p.light < 0.1) && !masked;
            }
            *far += masked && !near;
        }
}

TEST(fixed_pixels_of_each_camera_are_masked)
{
    for (enum fixed_kind kind = FIXED_ROUND_PORT; kind < FIXED_WHITE_STUDIO; kind++) {
        OWNED_SCENE *scene = fixed_survey(kind, kind == FIXED_LOGO ? FIXED_TWO_SIDES : FIXED_NOTHING, 1);
        int missed, far;
        fixed_count(scene, 2, kind, &missed, &far);
        CHECK(missed <= 4 && far <= 8);
        fixed_count(scene, 3, kind == FIXED_LOGO ? FIXED_TWO_SIDES : FIXED_NOTHING, &missed, &far);
        CHECK(missed <= 4 && far <= 8);
        CHECK_WARNED(kind == FIXED_LOGO ? "24 images show the same at " : "12 images show the same at ");
        CHECK(scene->stats.fixed > 0.005 && scene->stats.fixed < 0.2);
    }
}

TEST(fixed_backgrounds_a_sky_and_a_lamp_are_no_part_of_the_camera)
{
    for (enum fixed_kind kind = FIXED_WHITE_STUDIO; kind < FIXED_KINDS; kind++) {
        OWNED_SCENE *scene = fixed_survey(kind, FIXED_NOTHING, 1);
        CHECK(test_said.warning[0] == 0 && scene->stats.fixed == 0 && !scene_image(test_ctx, scene, 0)->mask);
    }
}

TEST(fixed_pixels_are_masked_after_memory_was_refused)
{
    OWNED_SCENE *scene = fixed_survey(FIXED_ROUND_PORT, FIXED_NOTHING, 1);
    for (long allowed = 0; allowed < 99; allowed++) {
        allocations_left = allowed;
        const struct training_image *image = scene_image(test_ctx, scene, 0);
        allocations_left = LONG_MAX;
        CHECK(!image || image->mask);
    }
}

TEST(fixed_pixels_stay_where_auto_mask_is_off)
{
    OWNED_SCENE *scene = fixed_survey(FIXED_ROUND_PORT, FIXED_NOTHING, 0);
    CHECK(test_said.warning[0] == 0 && !scene_image(test_ctx, scene, 0)->mask);
}

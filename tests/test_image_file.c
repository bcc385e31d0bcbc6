/* test_image_file.c - decoded images in files: whole or not at all. */
#include "test.h"

TEST(decoded_image_comes_back_whole_or_not_at_all)
{
    uint8_t rgb[36], mask[12];
    struct training_image image = {4, 3, rgb, mask}, back;
    const oxl_camera to = {.width = 4, .height = 3};
    for (int i = 0; i < 36; i++) rgb[i] = (uint8_t)(7 * i), mask[i % 12] = (uint8_t)(i % 2 ? 255 : 0);
    CHECK_OK(image_file_write(test_ctx, test_path("one"), 5, &image));
    CHECK(image_file_read(test_ctx, test_path("one"), 5, &to, &back));
    CHECK(!memcmp(back.rgb, rgb, 36) && !memcmp(back.mask, mask, 12));
    image_training_free(test_ctx, &back);
    CHECK(!image_file_read(test_ctx, test_path("one"), 6, &to, &back) && !back.rgb); /* of other inputs */
    CHECK(!image_file_read(test_ctx, test_path("none"), 5, &to, &back));
    OWNED_FILE map = test_file("one");
    for (size_t cut = 0; cut < map.size; cut += 5) {
        test_write_bytes("cut", map.data, cut);
        CHECK(!image_file_read(test_ctx, test_path("cut"), 5, &to, &back) && !back.rgb && !back.mask);
    }
    for (size_t at = 0; at < map.size; at += 3) {
        OWNED_MEMORY char *bent = oxl_alloc(test_ctx, map.size, 1);
        memcpy(bent, map.data, map.size);
        bent[at] ^= 4;
        test_write_bytes("bent", bent, map.size);
        CHECK(!image_file_read(test_ctx, test_path("bent"), 5, &to, &back));
    }
}

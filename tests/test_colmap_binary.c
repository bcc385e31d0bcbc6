/* test_colmap_binary.c - the binary export: the same model as the text, and a refusal with a place for any
 * other bytes. */
#include "test.h"

/* ---------------- a writer */

static FILE *binary_file(const char *folder, const char *name)
{
    FILE *file = fopen(test_path("%s/%s", folder, name), "wb");
    CHECK(file != NULL);
    return file;
}

static void binary_put(FILE *file, int64_t value, int bytes)
{
    unsigned char text[8];
    bytes_put(text, (uint64_t)value, bytes);
    fwrite(text, 1, (size_t)bytes, file);
}

static void binary_put_reals(FILE *file, const double *value, int count)
{
    for (int i = 0; i < count; i++) {
        int64_t bits;
        memcpy(&bits, &value[i], sizeof bits);
        binary_put(file, bits, 8);
    }
}

/* As COLMAP writes it, with the 2D points of the model in the folder `text`, rows the other way round: its
 * order is that of a hash table. */
static void binary_write(const char *folder, const struct colmap *c, const char *text)
{
    struct colmap_observed o = colmap_observe(text, c);
    FILE *cameras = binary_file(folder, "cameras.bin"), *images = binary_file(folder, "images.bin"),
         *points = binary_file(folder, "points3D.bin");
    binary_put(cameras, (int64_t)c->camera_count, 8);
    for (size_t i = c->camera_count; i-- > 0;) {
        const struct colmap_camera *k = &c->camera[i];
        binary_put(cameras, k->id, 4), binary_put(cameras, k->model, 4);
        binary_put(cameras, k->width, 8), binary_put(cameras, k->height, 8);
        binary_put_reals(cameras, k->parameter, k->parameter_count);
    }
    binary_put(images, (int64_t)c->image_count, 8);
    for (size_t i = c->image_count; i-- > 0;) {
        const struct colmap_image *k = &c->image[i];
        binary_put(images, k->id, 4);
        binary_put_reals(images, k->rotation, 4), binary_put_reals(images, k->translation, 3);
        binary_put(images, k->camera_id, 4);
        fwrite(c->names + k->name, 1, strlen(c->names + k->name) + 1, images);
        binary_put(images, (int64_t)colmap_observed_count(&o, i), 8);
        for (size_t j = o.first[i]; j < o.first[i + 1]; j++)
            binary_put_reals(images, &o.at[j].x, 2), binary_put(images, o.at[j].point, 8);
    }
    binary_put(points, (int64_t)c->point_count, 8);
    for (size_t i = c->point_count; i-- > 0;) {
        const struct colmap_point *k = &c->point[i];
        const struct colmap_track *t = &c->track[k->first_track];
        binary_put(points, k->id, 8);
        binary_put_reals(points, k->position, 3);
        fwrite(k->rgb, 1, 3, points);
        binary_put_reals(points, &k->error, 1);
        binary_put(points, k->track_count, 8);
        for (size_t j = 0; j < k->track_count; j++)
            binary_put(points, c->image[t[j].image_row].id, 4), binary_put(points, t[j].observation, 4);
    }
    CHECK(fclose(cameras) == 0 && fclose(images) == 0 && fclose(points) == 0);
    colmap_observed_free(&o);
}

/* The good model in the test's folder `binary`, its text in `model`. */
static void binary_good(void)
{
    OWNED_COLMAP c = colmap_of(colmap_good_cameras, colmap_good_images, colmap_good_points);
    test_make_folder("binary");
    binary_write(test_path("binary"), &c, test_path("model"));
}

static const char *const binary_names[] = {"cameras.bin", "images.bin", "points3D.bin"};

/* Puts bytes into a file of the good model; returns what was there. */
static void binary_replace(const char *name, const void *data, size_t size)
{
    FILE *file = binary_file(test_path("binary"), name);
    CHECK(size == 0 || fwrite(data, 1, size, file) == size);
    CHECK(fclose(file) == 0);
}

static const char *binary_refused(void)
{
    const struct colmap zero = {0};
    struct colmap c;
    CHECK(colmap_read(test_ctx, test_path("binary"), 64, NULL, &c) == OXL_ERR_INPUT);
    CHECK(memcmp(&c, &zero, sizeof c) == 0);
    CHECK_SAYS("\nfix: ");
    return oxl_error_text(test_ctx);
}

/* ---------------- what is read */

static void binary_check_same(const char *text_folder, const char *binary_folder, size_t window)
{
    OWNED_COLMAP text = {0}, binary = {0};
    CHECK_OK(colmap_read_folder(text_folder, &text));
    CHECK_OK(colmap_read(test_ctx, binary_folder, window, NULL, &binary));
    CHECK(text.format == COLMAP_TEXT && binary.format == COLMAP_BINARY && binary.warnings == 0);
    CHECK(colmap_same(&text, &binary));
}

TEST(colmap_binary_is_the_model_of_the_text_through_any_window)
{
    char text[300];
    binary_good();
    snprintf(text, sizeof text, "%s", test_path("model"));
    binary_replace("rigs.bin", "junk", 4); /* not read */
    for (size_t window = 1; window < 300; window += 7) binary_check_same(text, test_path("binary"), window);
}

TEST(colmap_binary_real_surveys_are_those_of_their_text)
{
    const char *path = test_shared("data/caliterra/sparse/0");
    char text[600];
    struct colmap c;
    if (!path) SKIP("no shared data");
    snprintf(text, sizeof text, "%s", path);
    test_make_folder("binary");
    CHECK_OK(colmap_read_folder(text, &c));
    binary_write(test_path("binary"), &c, text);
    colmap_free(test_ctx, &c);
    binary_check_same(text, test_path("binary"), COLMAP_BUFFER);
}

TEST(colmap_binary_invalid_values_are_handled_as_in_text)
{
    OWNED_COLMAP c = colmap_of(colmap_good_cameras, colmap_good_images, colmap_good_points);
    test_make_folder("binary");
    c.point[1].position[1] = INFINITY;
    c.point[0].error = NAN;
    c.image[1].rotation[0] = 8;
    binary_write(test_path("binary"), &c, test_path("model"));
    colmap_free(test_ctx, &c);
    CHECK_OK(colmap_read_folder(test_path("binary"), &c));
    CHECK(c.warnings == 3 && c.point_count == 1 && c.point[0].id == 4 && c.point[0].error == -1 &&
          c.track_count == 2);
}

/* Does what the words say, and reads the model in `binary`; only numbers are left of it. */
static struct colmap binary_after(const char *words, const char *images)
{
    const struct survey_given given = {.folder = images};
    OWNED_TEXT t = test_text();
    struct colmap c;
    text_add(&t, "cd '%s' && %s", test_path("binary"), words);
    CHECK(system(t.data) == 0);
    CHECK_OK(colmap_read(test_ctx, test_path("binary"), COLMAP_BUFFER, &given, &c));
    struct colmap numbers = c;
    colmap_free(test_ctx, &c);
    return numbers;
}

TEST(colmap_of_text_and_binary_the_one_that_the_images_fit_better_is_read_with_a_message)
{
    binary_good();
    test_listen();
    CHECK(binary_after("cp ../model/*.txt .", NULL).format == COLMAP_BINARY);
    CHECK(!strstr(test_said.all, "two models"));
    CHECK(binary_after("touch ../model/z.jpg; sed -i s/b.jpg/z.jpg/ images.txt", test_path("model")).format ==
          COLMAP_TEXT);
    binary_after("cp ../model/*.txt .; sed -i s/500.5/600/ cameras.txt", NULL);
    CHECK_LOGGED("the binary one is read");
    struct colmap c =
        binary_after("touch ../model/b.jpg; sed -i 4,7d images.txt", test_path("model")); /* fits */
    CHECK(c.format == COLMAP_TEXT && c.image_count == 1);
    CHECK(binary_after("touch ../model/c.png", test_path("model")).format == COLMAP_BINARY);
    binary_replace("points3D.bin", "\0\0\0\0\0\0\0\0", 8); /* none */
    CHECK(binary_after("cp ../model/*.txt .", NULL).format == COLMAP_TEXT);
    CHECK_LOGGED("the text one is read");
    c = binary_after("rm images.txt points3D.bin", NULL);
    CHECK(c.format == COLMAP_BINARY && c.point_count == 2);
    binary_replace("images.bin", "", 0); /* cannot be read */
    CHECK(binary_after("cp ../model/*.txt .", NULL).format == COLMAP_TEXT);
    test_write("binary/cameras.txt", ""); /* nor the text */
    CHECK(colmap_read_folder(test_path("binary"), &c) == OXL_ERR_INPUT);
}

/* ---------------- what is refused */

/* Every file cut at every byte, and every byte of the three set to 0xff in turn: counts become huge, numbers
 * nan, ids strange. */
TEST(colmap_binary_that_is_cut_or_has_a_wrong_byte_is_refused_with_the_place_or_read)
{
    int refused = 0;
    for (int f = 0; f < 3; f++) {
        OWNED_MEMORY char *copy = NULL;
        binary_good();
        OWNED_FILE map = test_file(test_path("binary/%s", binary_names[f]));
        for (size_t size = 0; size < map.size; size++) {
            binary_replace(binary_names[f], map.data, size);
            CHECK_TEXT(binary_refused(), binary_names[f]);
            CHECK_SAYS(": byte ");
        }
        copy = oxl_alloc(test_ctx, map.size, 1);
        for (size_t i = 0; i < map.size; i++) {
            OWNED_COLMAP c = {0};
            memcpy(copy, map.data, map.size);
            copy[i] = (char)0xff;
            binary_replace(binary_names[f], copy, map.size);
            oxl_result rc = colmap_read_folder(test_path("binary"), &c);
            CHECK(rc == OXL_OK || rc == OXL_ERR_INPUT);
            if (rc != OXL_OK) CHECK_SAYS("\nfix: ");
            refused += rc != OXL_OK;
        }
    }
    CHECK(refused > 60);
}

TEST(colmap_binary_huge_counts_are_refused_before_memory_is_taken)
{
    static const unsigned char many[64] = {0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0xff, 0x0f};
    for (int f = 0; f < 3; f++) {
        binary_good();
        binary_replace(binary_names[f], many, sizeof many);
        CHECK_TEXT(binary_refused(), ": found the number 1152921504606846975 where 56 bytes follow");
    }
}

TEST(colmap_binary_empty_and_random_files_are_refused)
{
    char noise[500];
    for (int f = 0; f < 3; f++) {
        binary_good();
        binary_replace(binary_names[f], "", 0);
        CHECK_TEXT(binary_refused(), "byte 0, record 0: found the end of the file");
        for (uint64_t seed = 1; seed < 20; seed++) {
            for (size_t i = 0; i < sizeof noise; i++) noise[i] = (char)random_bits(seed, i, 0);
            binary_replace(binary_names[f], noise, sizeof noise);
            binary_refused();
        }
    }
}

TEST(colmap_binary_an_unknown_camera_model_leads_to_the_undistorter)
{
    unsigned char cameras[64] = {1, 0, 0, 0,   0, 0, 0, 0, 1, 0, 0, 0,  18,
                                 0, 0, 0, 100, 0, 0, 0, 0, 0, 0, 0, 100};
    binary_good();
    binary_replace("cameras.bin", cameras, sizeof cameras);
    CHECK_TEXT(binary_refused(),
               "byte 12, record 1: found 18 for the camera model, expected one of SIMPLE_PINHOLE, ");
    CHECK_SAYS("colmap image_undistorter");
}

TEST(colmap_binary_names_stay_in_the_image_folder_and_on_one_line)
{
    static const char *const wrong[][2] = {{"../..", "expected NAME, a file in the image folder"},
                                           {"b\nc.jpg", "a line end in a name"}};
    for (size_t i = 0; i < OXL_COUNT(wrong); i++) {
        OWNED_COLMAP c = colmap_of(colmap_good_cameras, "7 1 0 0 0 0 0 0 1 12345678\n\n", "");
        test_make_folder("binary");
        strcpy(c.names + c.image[0].name, wrong[i][0]);
        binary_write(test_path("binary"), &c, test_path("model"));
        CHECK_TEXT(binary_refused(), wrong[i][1]);
    }
}

/* test_colmap.c - the text export with its traps: what is read, what is mended, what is refused and with
 * which words. */
#include "test.h"
#include <locale.h>

const char colmap_good_cameras[] = "# Camera list\n"
                                   "1 PINHOLE 640 480 500.5 501.5 320 240\n"
                                   "3 OPENCV 1280 960 900 901 640 480 0.1 -0.02 1e-3 -2e-4\n";
const char colmap_good_images[] = "# Image list\n"
                                  "7 1 0 0 0 0.5 -1.5 2 1 b.jpg\n"
                                  "10.5 20.25 4 30 -0.5 -1\n"
                                  "2 0.8 0.6 0 0 1 2 3 3 dive 1/IMG 0001.JPG\n"
                                  "\n"
                                  "5 0 0 0 1 0 0 0 1 c.png\n"
                                  "1.5 2.5 9\n";
const char colmap_good_points[] = "# 3D point list\n"
                                  "9 1.5 -2.5 3 255 0 128 0.25 5 0\n"
                                  "4 1e2 0 -0.125 1 2 3 -1 7 0 2 11\n";

/* Without the fsync of test_write: the loops below write a thousand files. */
static void colmap_file(const char *name, const char *text)
{
    FILE *file = fopen(test_path(name), "wb");
    CHECK(file && fputs(text, file) >= 0 && fclose(file) == 0);
}

/* Any of the three may be NULL: not written. */
oxl_result colmap_try(const char *cameras, const char *images, const char *points, struct colmap *out)
{
    CHECK_OK(oxl_make_folder(test_ctx, test_path("model")));
    if (cameras) colmap_file("model/cameras.txt", cameras);
    if (images) colmap_file("model/images.txt", images);
    if (points) colmap_file("model/points3D.txt", points);
    return colmap_read(test_ctx, test_path("model"), out);
}

/* The input is refused, and `out` is zeroed; returns what was said. */
static const char *colmap_refused(const char *cameras, const char *images, const char *points)
{
    const struct colmap zero = {0};
    struct colmap c;
    CHECK(colmap_try(cameras, images, points, &c) == OXL_ERR_INPUT);
    CHECK(memcmp(&c, &zero, sizeof c) == 0);
    CHECK_SAYS("\nfix: ");
    return oxl_error_text(test_ctx);
}

static const char *colmap_refused_cameras(const char *cameras)
{
    return colmap_refused(cameras, colmap_good_images, colmap_good_points);
}

static const char *colmap_refused_images(const char *images)
{
    return colmap_refused(colmap_good_cameras, images, colmap_good_points);
}

static const char *colmap_refused_points(const char *points)
{
    return colmap_refused(colmap_good_cameras, colmap_good_images, points);
}

/* The 2D points of all images, which the library does not read, from the file of images of the model; those
 * of image i from first[i] on. */
struct colmap_observed colmap_observe(const char *folder, const struct colmap *c)
{
    struct os_file_map file = {0};
    struct colmap_observed o = {NULL, oxl_calloc(test_ctx, c->image_count + 1, sizeof *o.first)};
    char path[600];
    snprintf(path, sizeof path, "%s/images.txt", folder);
    CHECK_OK(os_read_file(test_ctx, path, &file));
    o.at = oxl_alloc(test_ctx, file.size / 6 + 1, sizeof *o.at); /* "0 0 0 " is the shortest */
    for (size_t i = 0; i < c->image_count; i++) {
        const char *p = file.data + c->image[i].points_at, *end = p + c->image[i].points_size;
        size_t n = o.first[i];
        for (size_t k = 0; p < end; p += *p == ' ', k++, n = o.first[i] + k / 3) { /* X Y POINT3D_ID */
            struct colmap_observation *to = &o.at[n];
            const int read = k % 3 == 2 ? parse_int64(&p, end, &to->point)
                                        : parse_double(&p, end, k % 3 ? &to->y : &to->x);
            CHECK(read);
            if (!read) break;
        }
        o.first[i + 1] = n;
    }
    os_release_file(test_ctx, &file);
    return o;
}
size_t colmap_observed_count(const struct colmap_observed *o, size_t image)
{
    return o->first[image + 1] - o->first[image];
}
void colmap_observed_free(struct colmap_observed *o)
{
    oxl_free(test_ctx, o->at);
    oxl_free(test_ctx, o->first);
}

/* Rows are the same; where observations and tracks lie is not. */
int colmap_same(const struct colmap *a, const struct colmap *b)
{
    int same = a->camera_count == b->camera_count && a->image_count == b->image_count &&
               a->point_count == b->point_count && a->track_count == b->track_count;
    for (size_t i = 0; same && i < a->camera_count; i++)
        same = a->camera[i].id == b->camera[i].id && a->camera[i].model == b->camera[i].model &&
               a->camera[i].width == b->camera[i].width && a->camera[i].height == b->camera[i].height &&
               memcmp(a->camera[i].parameter, b->camera[i].parameter, sizeof a->camera[i].parameter) == 0;
    for (size_t i = 0; same && i < a->image_count; i++) {
        const struct colmap_image *x = &a->image[i], *y = &b->image[i];
        same = x->id == y->id && x->camera_id == y->camera_id &&
               strcmp(a->names + x->name, b->names + y->name) == 0 &&
               memcmp(x->rotation, y->rotation, sizeof x->rotation) == 0 &&
               memcmp(x->translation, y->translation, sizeof x->translation) == 0 &&
               (x->points_size == 0) == (y->points_size == 0);
    }
    for (size_t i = 0; same && i < a->point_count; i++) {
        const struct colmap_point *x = &a->point[i], *y = &b->point[i];
        same = x->id == y->id && memcmp(x->position, y->position, sizeof x->position) == 0 &&
               x->error == y->error && memcmp(x->rgb, y->rgb, 3) == 0 && x->track_count == y->track_count &&
               (x->track_count == 0 || memcmp(a->track + x->first_track, b->track + y->first_track,
                                              x->track_count * sizeof *a->track) == 0);
    }
    return same;
}

/* The good model, changed in a way that must not matter, reads as before; `warnings` oddities are mended. */
static void colmap_check_same(const char *cameras, const char *images, const char *points, size_t warnings)
{
    OWNED_COLMAP good = {0}, seen = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, colmap_good_points, &good));
    CHECK_OK(colmap_try(cameras, images, points, &seen));
    CHECK(colmap_same(&good, &seen));
    CHECK(seen.warnings == warnings);
}

/* Every `from` becomes `to`. */
static const char *colmap_replaced(const char *text, char from, const char *to)
{
    static char ring[3][2048];
    static int next;
    char *out = ring[next++ % 3], *p = out;
    for (; *text; text++) {
        if (*text == from) p += sprintf(p, "%s", to);
        else *p++ = *text;
    }
    *p = 0;
    return out;
}

/* ---------------- what is read */

TEST(colmap_a_file_of_fewer_rows_than_announced_is_reported)
{
    char images[1024], points[1024];
    OWNED_COLMAP c = {0};
    snprintf(images, sizeof images, "# Number of images: 3, mean observations per image: 2\n%s",
             colmap_good_images);
    snprintf(points, sizeof points, "# Number of points:  3\n%s", colmap_good_points);
    colmap_check_same(colmap_good_cameras, images, colmap_good_points, 0);
    test_listen();
    CHECK_OK(colmap_try(colmap_good_cameras, images, points, &c));
    CHECK(test_said.warnings == 1 && c.warnings == 1);
    CHECK_TEXT(test_said.warning, "points3D.txt: its header announces 3 points, and 2 are there");
    colmap_free(test_ctx, &c);
    CHECK_OK(colmap_try(colmap_good_cameras, "# Number of images:\n7 1 0 0 0 0 0 0 1 b.jpg\n\n",
                        "# Number of points: 0\n", &c));
    CHECK(test_said.warnings == 1);
}

/* ---------------- dialects */

/* Agisoft Metashape 2.2, "Export Cameras", COLMAP: labels with spaces, no 2D points, CR LF. */
TEST(colmap_reads_the_dialect_of_metashape)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(
        "# Camera list with one line of data per camera:\r\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\r\n"
        "# Number of cameras: 1\r\n0 PINHOLE 5472 3648 3666.6660000000002 3666.6660000000002 2736 1824\r\n",
        "# Image list with two lines of data per image:\r\n# Number of images: 2, mean observations per image: 0\r\n"
        "0 0.99 0.1 0.05 0.08 1.5 -2.5 3 0 dive 1/GOPR 0001 (2).JPG\r\n\r\n"
        "1 0.99 0.1 0.05 0.08 2.5 -2.5 3 0 dive 1/GOPR 0002.JPG\r\n\r\n",
        "# Number of points: 1, mean track length: 0\r\n0 1.25 -0.5 7 90 120 140 0\r\n", &c));
    CHECK(c.image_count == 2 && c.point_count == 1 && c.warnings == 0 && !c.is_truncated &&
          c.track_count == 0);
    CHECK(strcmp(c.names + c.image[0].name, "dive 1/GOPR 0001 (2).JPG") == 0 && c.camera[0].id == 0);
}

/* Epic RealityScan (RealityCapture), "COLMAP" export: FULL_OPENCV with zeros for undistorted images, lines of
 * 2D points that are empty, and what Microsoft's printf makes of not-a-number. */
TEST(colmap_reads_the_dialect_of_realityscan)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(
        "1 FULL_OPENCV 4000 3000 2911.5 2911.5 2000 1500 0 0 0 0 0 0 0 0\r\n",
        "1 0.70710678118654757 0 0.70710678118654757 0 -1e-003 0 2.5 1 IMG 0001.jpg\r\n\r\n"
        "2 0.70710678118654757 0 0.70710678118654757 0 1e+000 0 2.5 1 IMG 0002.jpg\r\n \r\n",
        "1 0.5 0.25 8 10 20 30 -nan(ind) 1 0 2 0\r\n2 -1.#IND 0 0 1 2 3 0.5\r\n3 1 1 1 1 2 3 1.#QNAN\r\n",
        &c));
    CHECK(c.image_count == 2 && c.point_count == 2 && c.warnings == 3);
    CHECK(c.point[0].error == -1 && c.point[0].track_count == 2 && c.point[1].id == 3 &&
          c.point[1].error == -1);
    CHECK(!camera_is_distorted(&c.camera[0]));
}

/* ---------------- what is read, again */

TEST(colmap_cameras_are_read_as_written)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, colmap_good_points, &c));
    CHECK(c.camera_count == 2 && c.warnings == 0);
    CHECK(c.camera[0].id == 1 && c.camera[0].width == 640 && c.camera[0].height == 480 &&
          c.camera[0].line == 2);
    CHECK(strcmp(camera_model_at(c.camera[0].model)->name, "PINHOLE") == 0 &&
          c.camera[0].parameter_count == 4);
    CHECK_CLOSE(c.camera[0].parameter[1], 501.5, 0);
    CHECK(c.camera[1].id == 3 && c.camera[1].parameter_count == 8 && c.camera[1].line == 3);
    CHECK_CLOSE(c.camera[1].parameter[7], -2e-4, 0);
}

TEST(colmap_a_ninth_number_of_opencv_is_k3)
{
    struct colmap c;
    CHECK_OK(
        colmap_try("7 OPENCV 64 48 50 50 32 24 .1 .2 .3 .4 .5\n", "7 1 0 0 0 0 0 0 7 a.jpg\n\n", "", &c));
    CHECK(!strcmp(camera_model_at(c.camera->model)->name, "FULL_OPENCV") && c.camera->parameter_count == 12);
    CHECK(c.camera->parameter[7] == .4 && c.camera->parameter[8] == .5 && c.camera->parameter[9] == 0);
    colmap_free(test_ctx, &c);
}

TEST(colmap_images_are_read_as_written_by_id)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, colmap_good_points, &c));
    CHECK(c.image_count == 3);
    CHECK(c.image[2].id == 7 && c.image[2].camera_id == 1 && c.image[2].line == 2 &&
          c.image[2].points_size > 0);
    CHECK_CLOSE(c.image[2].translation[1], -1.5, 0);
    CHECK(c.image[0].id == 2 && c.image[0].camera_id == 3 && c.image[0].points_size == 0);
    CHECK_CLOSE(c.image[0].rotation[1], 0.6, 0);
    CHECK(c.image[1].id == 5 && c.image[1].points_at > c.image[2].points_at && c.image[1].points_size > 0);
}

TEST(colmap_a_name_is_the_rest_of_the_line)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, colmap_good_points, &c));
    CHECK_TEXT(c.names + c.image[0].name, "dive 1/IMG 0001.JPG");
    CHECK(strlen(c.names + c.image[0].name) == 19);
}

TEST(colmap_a_name_that_begins_in_this_folder_is_the_name_alone)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, "7 1 0 0 0 0 0 0 1 ././/a.png\n\n", "", &c));
    CHECK(c.image_count == 1 && strcmp(c.names + c.image[0].name, "a.png") == 0);
}

TEST(colmap_points_are_read_by_id_with_their_tracks)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, colmap_good_points, &c));
    CHECK(c.point_count == 2 && c.track_count == 3);
    CHECK(c.point[1].id == 9 && c.point[1].rgb[0] == 255 && c.point[1].rgb[1] == 0 &&
          c.point[1].rgb[2] == 128);
    CHECK_CLOSE(c.point[1].error, 0.25, 0);
    CHECK_CLOSE(c.point[0].position[0], 100, 0);
    CHECK(c.point[1].first_track == 0 && c.point[1].track_count == 1 &&
          c.image[c.track[0].image_row].id == 5 && c.track[0].observation == 0);
    CHECK(c.point[0].first_track == 1 && c.point[0].track_count == 2 &&
          c.image[c.track[2].image_row].id == 2 && c.track[2].observation == 11);
}

TEST(colmap_an_export_without_points_is_read)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, "# nothing\n", &c));
    CHECK(c.point_count == 0 && c.image_count == 3);
}

TEST(colmap_real_surveys_are_read_without_a_warning)
{
    const char *path = test_shared("data/caliterra/sparse/0");
    OWNED_COLMAP c = {0};
    if (!path) SKIP("no shared data");
    CHECK_OK(colmap_read(test_ctx, path, &c));
    CHECK(c.image_count == 75 && c.point_count == 28366 && c.track_count == 229775 && c.warnings == 0);
}

/* ---------------- what must not matter */

TEST(colmap_carriage_returns_tabs_and_doubled_spaces_do_not_matter)
{
    colmap_check_same(colmap_replaced(colmap_good_cameras, '\n', "\r\n"),
                      colmap_replaced(colmap_good_images, '\n', "\r\n"),
                      colmap_replaced(colmap_good_points, '\n', " \r\n"), 0);
    colmap_check_same(colmap_replaced(colmap_good_cameras, ' ', "\t "),
                      colmap_replaced(colmap_good_images, '\n', " \t\n\t "),
                      colmap_replaced(colmap_good_points, ' ', "  "), 0);
}

TEST(colmap_comments_and_blank_lines_before_records_do_not_matter)
{
    colmap_check_same(
        "\n# a\n\n1 PINHOLE 640 480 500.5 501.5 320 240\n# b\n"
        "3 OPENCV 1280 960 900 901 640 480 0.1 -0.02 1e-3 -2e-4\n\n",
        "# a\n\n7 1 0 0 0 0.5 -1.5 2 1 b.jpg\n10.5 20.25 4 30 -0.5 -1\n# b\n\n"
        "2 0.8 0.6 0 0 1 2 3 3 dive 1/IMG 0001.JPG\n\n\n\n5 0 0 0 1 0 0 0 1 c.png\n1.5 2.5 9\n\n",
        "\n9 1.5 -2.5 3 255 0 128 0.25 5 0\n\n# x\n4 1e2 0 -0.125 1 2 3 -1 7 0 2 11\n", 0);
}

TEST(colmap_a_byte_order_mark_does_not_matter)
{
    colmap_check_same(
        "\xEF\xBB\xBF"
        "1 PINHOLE 640 480 500.5 501.5 320 240\n3 OPENCV 1280 960 900 901 640 480 0.1 -0.02 1e-3 -2e-4\n",
        colmap_good_images, colmap_good_points, 0);
}

TEST(colmap_the_last_line_may_lack_its_end)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try("1 PINHOLE 640 480 500 500 320 240", "7 1 0 0 0 0.5 -1.5 2 1 b.jpg",
                        "9 1 2 3 4 5 6 0.5 7 0", &c));
    CHECK(c.image_count == 1 && c.point_count == 1 && c.warnings == 0);
}

TEST(colmap_exponents_of_three_digits_are_read)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(
        colmap_try("1 PINHOLE 640 480 5.0e+002 500 320 240\n", "7 1 1.5e-002 0 0 0 0 0 1 b.jpg\n", "", &c));
    CHECK_CLOSE(c.camera[0].parameter[0], 500, 0);
    CHECK_CLOSE(c.image[0].rotation[1], 0.015, 0);
}

/* ---------------- what is mended, with a warning */

TEST(colmap_missing_lines_of_2d_points_are_noticed)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(
        colmap_good_cameras,
        "7 1 0 0 0 0.5 -1.5 2 1 b.jpg\n2 0.8 0.6 0 0 1 2 3 3 dive 1/IMG 0001.JPG\n# a\n5 0 0 0 1 0 0 0 1 c.png\n",
        colmap_good_points, &c));
    CHECK(c.image_count == 3 && c.image[0].id == 2 && c.image[1].id == 5 && c.image[1].points_size == 0 &&
          c.warnings == 2);
}

TEST(colmap_missing_lines_of_2d_points_are_noticed_when_names_are_numbers)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras,
                        "7 1 0 0 0 0.5 -1.5 2 1 0001\n2 0.8 0.6 0 0 1 2 3 3 0002\n5 0 0 0 1 0 0 0 1 0003 4\n",
                        colmap_good_points, &c));
    CHECK(c.image_count == 3 && c.warnings == 2);
    CHECK_TEXT(c.names + c.image[1].name, "0003 4");
}

TEST(colmap_2d_points_of_whole_numbers_are_not_taken_for_an_image)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(
        colmap_try(colmap_good_cameras, "7 1 0 0 0 0.5 -1.5 2 1 b.jpg\n2 1 0 0 0 1 2 3 1 7 8 9\n", "", &c));
    CHECK(c.image_count == 1 && c.image[0].points_size > 0 && c.warnings == 0);
}

TEST(colmap_a_point_that_is_not_finite_is_left_out)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images,
                        "# Number of points: 2\n9 1 nan 3 4 5 6 0.5 7 0\n8 1 2 3 4 5 6 0.5 7 0\n", &c));
    CHECK(!c.is_truncated && c.point_count == 1 && c.point[0].id == 8 && c.point[0].first_track == 0 &&
          c.track_count == 1 && c.warnings == 1);
}

TEST(colmap_a_reprojection_error_that_is_not_finite_becomes_unknown)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, "9 1 2 3 4 5 6 -nan(ind) 7 0\n", &c));
    CHECK(c.point_count == 1 && c.track_count == 1 && c.warnings == 1);
    CHECK_CLOSE(c.point[0].error, -1, 0);
}

TEST(colmap_a_track_entry_of_an_unknown_image_is_left_out)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, "9 1 2 3 4 5 6 0.5 7 0 99 3 5 1\n", &c));
    CHECK(c.point[0].track_count == 2 && c.track_count == 2 && c.image[c.track[1].image_row].id == 5 &&
          c.warnings == 1);
}

TEST(colmap_a_quaternion_of_another_length_is_read_with_a_warning)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(colmap_good_cameras, "7 2 0 0 0 0 0 0 1 b.jpg\n", "", &c));
    CHECK_CLOSE(c.image[0].rotation[0], 2, 0);
    CHECK(c.warnings == 1);
}

TEST(colmap_warnings_name_file_and_line_and_are_cut_after_three_of_a_kind)
{
    OWNED_TEXT points = {.ctx = test_ctx};
    OWNED_COLMAP c = {0};
    test_listen();
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, "9 1 2 3 4 5 6 nan 7 0\n", &c));
    CHECK(test_said.warnings == 1);
    CHECK_TEXT(test_said.warning, "points3D.txt:1: ");
    colmap_free(test_ctx, &c);
    for (int i = 0; i < 25; i++) text_add(&points, "%d 1 2 3 4 5 6 nan 7 0\n", i);
    test_listen();
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, points.data, &c));
    CHECK(test_said.warnings == 4 && c.warnings == 25);
    CHECK_TEXT(test_said.warning, "points3D.txt: 22 more cases");
}

/* ---------------- what is refused */

TEST(colmap_a_missing_file_is_named)
{
    CHECK_TEXT(colmap_refused(NULL, NULL, NULL), "cameras.txt is not there");
    CHECK_TEXT(colmap_refused(colmap_good_cameras, NULL, NULL), "images.txt is not there");
}

TEST(colmap_of_an_incomplete_binary_model_the_missing_file_is_named)
{
    test_write("model/cameras.bin", "");
    CHECK_TEXT(colmap_refused(NULL, NULL, NULL), "images.bin is not there");
}

TEST(colmap_an_unknown_camera_model_leads_to_the_undistorter)
{
    const char *text = colmap_refused_cameras("# x\n1 THICK_PRISM 640 480 1 2 3 4 5 6 7 8 9 10 11 12\n");
    CHECK_TEXT(text, "cameras.txt:2: found 'THICK_PRISM'");
    CHECK_TEXT(text, "SIMPLE_PINHOLE");
    CHECK_TEXT(text, "colmap image_undistorter");
}

TEST(colmap_sizes_and_focal_lengths_must_be_positive)
{
    CHECK_TEXT(colmap_refused_cameras("1 PINHOLE 0 480 500 500 320 240\n"),
               "cameras.txt:1: found '0', expected WIDTH");
    CHECK_TEXT(colmap_refused_cameras("1 PINHOLE 640 -480 500 500 320 240\n"),
               "found '-480', expected HEIGHT");
    CHECK_TEXT(colmap_refused_cameras("1 PINHOLE 99999999999 480 500 500 320 240\n"),
               "found '99999999999', expected WIDTH");
    CHECK_TEXT(colmap_refused_cameras("1 PINHOLE 640 480 500 -500 320 240\n"),
               "found '-500', expected a focal length");
    CHECK_TEXT(colmap_refused_cameras("1 SIMPLE_RADIAL 640 480 0 320 240 0\n"),
               "found '0', expected a focal length");
}

TEST(colmap_intrinsics_must_be_finite_and_as_many_as_the_model_has)
{
    CHECK_TEXT(colmap_refused_cameras("1 PINHOLE 640 480 -nan(ind) 500 320 240\n"),
               "found '-nan(ind)', expected PARAMS, a finite number");
    CHECK_TEXT(colmap_refused_cameras("1 PINHOLE 640 480 500 500 320\n"),
               "found the end of the line, expected PARAMS");
    CHECK_TEXT(colmap_refused_cameras("1 PINHOLE 640 480 500 500 320 240 0.1\n"),
               "found '0.1', expected the end of the line");
}

TEST(colmap_each_id_comes_once)
{
    CHECK_TEXT(
        colmap_refused_cameras("1 PINHOLE 640 480 500 500 320 240\n1 PINHOLE 640 480 500 500 320 240\n"),
        "cameras.txt:2: CAMERA_ID 1 appears twice");
    CHECK_TEXT(colmap_refused_images("7 1 0 0 0 0 0 0 1 a\n\n8 1 0 0 0 0 0 0 1 b\n\n7 1 0 0 0 0 0 0 1 c\n"),
               "images.txt:5: IMAGE_ID 7 appears twice");
    CHECK_TEXT(colmap_refused_points("9 1 2 3 4 5 6 0.5\n8 1 2 3 4 5 6 0.5\n9 1 2 3 4 5 6 0.5\n"),
               "points3D.txt:3: POINT3D_ID 9 appears twice");
}

TEST(colmap_an_image_without_its_camera_is_refused_with_the_ids_that_are_there)
{
    CHECK_TEXT(colmap_refused_images("7 1 0 0 0 0 0 0 9 b.jpg\n"),
               "images.txt:1: camera id 9 is not in cameras.txt (2 ids there: 1 to 3)");
    CHECK_TEXT(colmap_refused("1 PINHOLE 640 480 500 500 320 240\n2 PINHOLE 640 480 500 500 320 240\n",
                              "7 1 0 0 0 0 0 0 9 b.jpg\n", ""),
               "(2 ids there: 1 to 2)");
}

TEST(colmap_a_pose_must_be_finite_and_a_rotation)
{
    CHECK_TEXT(colmap_refused_images("7 nan 0 0 0 0 0 0 1 b.jpg\n"),
               "images.txt:1: found 'nan', expected QW, a finite number");
    CHECK_TEXT(colmap_refused_images("7 1 0 0 0 0 inf 0 1 b.jpg\n"),
               "found 'inf', expected TY, a finite number");
    CHECK_TEXT(colmap_refused_images("7 0 0 0 0 0 0 0 1 b.jpg\n"), "found the quaternion 0 0 0 0");
    CHECK_TEXT(colmap_refused_images("7 1e200 1e200 0 0 0 0 0 1 b.jpg\n"), "expected a rotation");
}

TEST(colmap_a_truncated_line_is_named)
{
    CHECK_TEXT(colmap_refused_images("7 1 0 0 0 0 0\n"),
               "images.txt:1: found the end of the line, expected TZ");
    CHECK_TEXT(colmap_refused_images("7 1 0 0 0 0 0 0 1\n"),
               "images.txt:1: found the end of the line, expected NAME");
    CHECK_TEXT(colmap_refused_images("7 1 0 0 0 0 0 0 b.jpg\n"),
               "images.txt:1: found 'b.jpg', expected CAMERA_ID");
    CHECK_TEXT(colmap_refused_points("9 1 2 3 4 5\n"),
               "points3D.txt:1: found the end of the line, expected B");
}

TEST(colmap_a_track_comes_in_pairs)
{
    CHECK_TEXT(colmap_refused_points("9 1 2 3 4 5 6 0.5 7 0 5\n"),
               "points3D.txt:1: found the end of the line, expected POINT2D_IDX");
    CHECK_TEXT(colmap_refused_points("9 1 2 3 4 5 6 0.5 7 -1\n"), "found '-1', expected POINT2D_IDX");
}

TEST(colmap_colours_are_bytes)
{
    CHECK_TEXT(colmap_refused_points("9 1 2 3 4 256 6 0.5\n"),
               "points3D.txt:1: found '256', expected G, an integer from 0 to 255");
    CHECK_TEXT(colmap_refused_points("9 1 2 3 0.5 5 6 0.5\n"), "found '0.5', expected R");
}

TEST(colmap_a_decimal_comma_is_explained)
{
    CHECK_TEXT(colmap_refused_cameras("1 PINHOLE 640 480 500,25 500,5 320 240\n"),
               "cameras.txt:1: found '500,25', a decimal comma");
    CHECK_TEXT(colmap_refused_images("7 0,99 0,01 0 0 0 0 0 1 b.jpg\n"), "LC_ALL=C");
    CHECK_TEXT(colmap_refused_points("9 1,5 2 3 4 5 6 0.5\n"),
               "points3D.txt:1: found '1,5', a decimal comma");
}

TEST(colmap_no_name_leads_out_of_the_image_folder)
{
    static const char *const names[][2] = {{"/etc/passwd", "etc/passwd"},
                                           {"\\\\host\\x.jpg", "host/x.jpg"},
                                           {"C:\\d\\x.jpg", "C/d/x.jpg"},
                                           {"../x.jpg", "x.jpg"},
                                           {"a/../../x.jpg", "a/x.jpg"},
                                           {"a\\..\\x.jpg", "a/x.jpg"},
                                           {"a/..", "a"},
                                           {"a..b.jpg", "a..b.jpg"},
                                           {"..a/b.jpg", "..a/b.jpg"},
                                           {"a/...jpg", "a/...jpg"},
                                           {"a../b", "a../b"},
                                           {"./a.jpg", "a.jpg"}};
    char images[200];
    struct colmap c;
    for (size_t i = 0; i < OXL_COUNT(names); i++) {
        snprintf(images, sizeof images, "7 1 0 0 0 0 0 0 1 %s\n", names[i][0]);
        CHECK_OK(colmap_try(colmap_good_cameras, images, "", &c));
        CHECK(!strcmp(c.names + c.image[0].name, names[i][1]));
        colmap_free(test_ctx, &c);
    }
    CHECK_TEXT(colmap_refused_images("7 1 0 0 0 0 0 0 1 ..\n"), "expected NAME, a file in the image folder");
}

TEST(colmap_files_without_cameras_or_images_are_refused)
{
    CHECK_TEXT(colmap_refused_cameras("# nothing\n"),
               "cameras.txt:1: found the end of the file, expected a camera");
    CHECK_TEXT(colmap_refused_images(""), "expected an image");
}

TEST(colmap_text_in_utf16_is_explained)
{
    CHECK_TEXT(colmap_refused_cameras("\xFF\xFE"
                                      "1"),
               "UTF-16");
}

/* ---------------- what must not happen */

TEST(colmap_a_file_cut_at_any_byte_is_read_or_refused_with_a_text)
{
    struct colmap c;
    char cut[sizeof colmap_good_images + sizeof colmap_good_points];
    for (size_t n = 0; n < sizeof colmap_good_images; n++) {
        snprintf(cut, sizeof cut, "%.*s", (int)n, colmap_good_images);
        test_ctx->error[0] = 0;
        if (colmap_try(colmap_good_cameras, cut, colmap_good_points, &c) != OXL_OK) CHECK_SAYS("images.txt:");
        colmap_free(test_ctx, &c);
    }
    for (size_t n = 0; n < sizeof colmap_good_points; n++) {
        snprintf(cut, sizeof cut, "%.*s", (int)n, colmap_good_points);
        test_ctx->error[0] = 0;
        if (colmap_try(colmap_good_cameras, colmap_good_images, cut, &c) != OXL_OK)
            CHECK_SAYS("points3D.txt:");
        colmap_free(test_ctx, &c);
    }
}

/* One byte changed at a time, to each of those that steer the reader: for the sanitizers. */
TEST(colmap_a_changed_byte_never_breaks_the_reader)
{
    static const char steer[] = "\n\t -.,#9eX\\";
    struct colmap c;
    char images[sizeof colmap_good_images];
    for (size_t n = 0; n + 1 < sizeof images; n++) {
        memcpy(images, colmap_good_images, sizeof images);
        images[n] = steer[n % (sizeof steer - 1)];
        if (colmap_try(colmap_good_cameras, images, colmap_good_points, &c) != OXL_OK) CHECK_SAYS("fix: ");
        colmap_free(test_ctx, &c);
    }
}

/* Allocations that fail from the n-th on. */
static struct {
    void *(*reallocate)(void *user, void *old, size_t size);
    int left;
} colmap_scarce;

static void *colmap_reallocate(void *user, void *old, size_t size)
{
    if (size > 0 && colmap_scarce.left-- <= 0) return NULL;
    return colmap_scarce.reallocate(user, old, size);
}

TEST(colmap_out_of_memory_is_reported_and_nothing_leaks)
{
    OWNED_COLMAP c = {0};
    oxl_result rc = OXL_ERR_MEMORY;
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, colmap_good_points, &c));
    colmap_free(test_ctx, &c);
    colmap_scarce.reallocate = test_ctx->options.reallocate;
    test_ctx->options.reallocate = colmap_reallocate;
    for (int n = 0; n < 200 && rc != OXL_OK; n++) {
        colmap_scarce.left = n;
        rc = colmap_read(test_ctx, test_path("model"), &c);
        CHECK(rc == OXL_OK || (rc == OXL_ERR_MEMORY && !c.camera && !c.names));
    }
    CHECK_OK(rc);
    test_ctx->options.reallocate = colmap_scarce.reallocate;
}

/* ---------------- windows, pieces, threads */

/* A thousand points of which every 50th has something wrong that is mended. */
static void colmap_add_points(struct text *t)
{
    text_add(t, "# 3D point list\n");
    for (int i = 0; i < 1000; i++) {
        text_add(t, "%d %d.%03d -0.5 1e1 %d 2 3 %s", 3 * ((i * 7) % 1000), i, i, i % 256,
                 i % 50 == 7 ? "nan" : "0.25");
        for (int k = 0; k < i % 6; k++) text_add(t, " %d %d", i % 50 == 9 ? 99 : k % 2 ? 7 : 5, i + k);
        text_add(t, i % 3 ? "\n" : " \r\n");
    }
}

TEST(colmap_the_window_and_the_threads_do_not_matter)
{
    OWNED_TEXT points = {.ctx = test_ctx};
    const int threads = test_ctx->threads;
    struct colmap whole, parts;
    colmap_add_points(&points);
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images, points.data, &whole));
    CHECK(whole.point_count == 1000 && whole.warnings > 0);
    for (size_t window = 1; window < 100000; window += window / 2 + 1) {
        test_ctx->threads = (int)(window % 4) + 1;
        CHECK_OK(colmap_read_buffered(test_ctx, test_path("model"), window, &parts));
        CHECK(colmap_same(&whole, &parts) && whole.warnings == parts.warnings);
        colmap_free(test_ctx, &parts);
    }
    test_ctx->threads = threads;
    colmap_free(test_ctx, &whole);
}

/* The same words, with the same line, from whichever piece of whichever window. */
static void colmap_check_refused_in_windows(const char *points, const char *wanted)
{
    struct colmap c;
    CHECK_TEXT(colmap_refused_points(points), wanted);
    for (size_t window = 1; window < 100000; window += window / 2 + 1) {
        test_ctx->error[0] = 0;
        CHECK_ERROR(colmap_read_buffered(test_ctx, test_path("model"), window, &c), OXL_ERR_INPUT, wanted);
    }
}

TEST(colmap_an_error_names_its_line_whatever_the_window)
{
    OWNED_TEXT points = {.ctx = test_ctx};
    colmap_add_points(&points); /* 1001 lines */
    text_add(&points, "5 1 2 3 4 5 6 0.5 7 0\n7 1 2 x 4 5 6 0.5\n7 1 2 y 4 5 6 0.5\n");
    colmap_check_refused_in_windows(points.data, "points3D.txt:1003: found 'x', expected Z");
}

TEST(colmap_a_point_id_that_comes_again_names_its_line_whatever_the_window)
{
    OWNED_TEXT points = {.ctx = test_ctx};
    colmap_add_points(&points);
    text_add(
        &points,
        "7 1 2 nan 4 5 6 0.5 7 0\n7 1 2 3 4 5 6 0.5\n\n7 1 2 3 4 5 6 0.5\n"); /* the first of them is left out */
    colmap_check_refused_in_windows(points.data, "points3D.txt:1003: POINT3D_ID 7 appears twice");
    text_add(&points, "9000000000000000000 1 2 3 4 5 6 0.5\n"); /* too far off for a bit each */
    colmap_check_refused_in_windows(points.data, "points3D.txt:1003: POINT3D_ID 7 appears twice");
}

TEST(colmap_point_ids_may_lie_far_apart)
{
    OWNED_COLMAP c = {0};
    CHECK_OK(colmap_try(
        colmap_good_cameras, colmap_good_images,
        "-9223372036854775808 1 2 3 4 5 6 0.5\n9223372036854775807 1 2 3 4 5 6 0.5\n0 1 2 3 4 5 6 0.5\n",
        &c));
    CHECK(c.point_count == 3 && c.point[0].id == INT64_MIN && c.point[2].id == INT64_MAX);
}

TEST(colmap_a_place_in_a_track_has_32_bits)
{
    struct colmap c;
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_good_images,
                        "9 1 2 3 4 5 6 0.5 +7 4294967295 0000000005 7\n", &c));
    CHECK(c.track_count == 2 && c.track[0].observation == 4294967295u &&
          c.image[c.track[1].image_row].id == 5);
    colmap_free(test_ctx, &c);
    CHECK_TEXT(colmap_refused_points("9 1 2 3 4 5 6 0.5 7 4294967296\n"),
               "found '4294967296', expected POINT2D_IDX");
}

TEST(colmap_records_the_offset_of_the_text_of_2d_points)
{
    static const char *const wanted[3] = {"", "1.5 2.5 9", "10.5 20.25 4 30 -0.5 -1"};
    struct colmap c;
    struct os_reader file;
    char text[64];
    size_t got = 0;
    CHECK_OK(colmap_try(colmap_good_cameras, colmap_replaced(colmap_good_images, '\n', " \r\n\t"),
                        colmap_good_points, &c));
    colmap_free(test_ctx, &c);
    CHECK_OK(os_reader_open(test_ctx, test_path("model/images.txt"), &file));
    for (size_t window = 1; window < 1000; window += window / 2 + 1) {
        CHECK_OK(colmap_read_buffered(test_ctx, test_path("model"), window, &c));
        CHECK(c.image_count == 3);
        for (size_t i = c.image_count; i-- > 0;) {
            CHECK(c.image[i].points_size == strlen(wanted[i]));
            CHECK_OK(os_reader_seek(test_ctx, &file, c.image[i].points_at));
            CHECK_OK(
                os_reader_read(test_ctx, &file, text, OXL_MIN(c.image[i].points_size, sizeof text), &got));
            CHECK(got == strlen(wanted[i]) && memcmp(text, wanted[i], got) == 0);
        }
        colmap_free(test_ctx, &c);
    }
    os_reader_close(&file);
}

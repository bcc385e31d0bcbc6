/* test_colmap.c - the text export with its traps: what is read, what is mended, what is refused and with
 * which words. */
#include "test.h"

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

oxl_result colmap_read_folder(const char *folder, struct colmap *out)
{
    return colmap_read(test_ctx, folder, COLMAP_BUFFER, NULL, out);
}

/* Any of the three may be NULL: not written. */
oxl_result colmap_try(const char *cameras, const char *images, const char *points, struct colmap *out)
{
    test_make_folder("model");
    if (cameras) colmap_file("model/cameras.txt", cameras);
    if (images) colmap_file("model/images.txt", images);
    if (points) colmap_file("model/points3D.txt", points);
    return colmap_read_folder(test_path("model"), out);
}

struct colmap colmap_of(const char *cameras, const char *images, const char *points)
{
    struct colmap c;
    CHECK_OK(colmap_try(cameras, images, points, &c));
    return c;
}

/* The good model with another text in the place of one of the files is refused, and `out` is zeroed; returns
 * what was said. */
static const char *colmap_refused(int file, const char *text)
{
    const struct colmap zero = {0};
    struct colmap c;
    CHECK_ERROR(colmap_try(file == 0 ? text : colmap_good_cameras, file == 1 ? text : colmap_good_images,
                           file == 2 ? text : colmap_good_points, &c),
                OXL_ERR_INPUT, "\nfix: ");
    CHECK(memcmp(&c, &zero, sizeof c) == 0);
    return oxl_error_text(test_ctx);
}

/* The 2D points of all images, which the library does not read, from the file of images of the model; those
 * of image i from first[i] on. */
struct colmap_observed colmap_observe(const char *folder, const struct colmap *c)
{
    struct colmap_observed o = {NULL, oxl_calloc(test_ctx, c->image_count + 1, sizeof *o.first)};
    OWNED_FILE file = test_file(test_path("%s/images.txt", folder));
    o.at = oxl_alloc(test_ctx, file.size / 6 + 1, sizeof *o.at); /* "0 0 0 " is the shortest */
    for (size_t i = 0; i < c->image_count; i++) {
        const char *p = file.data, *end = p + file.size;
        for (int line = 0; line < c->image[i].line; line++)
            p = (const char *)memchr(p, '\n', (size_t)(end - p)) + 1;
        end = memchr(p, '\n', (size_t)(end - p));
        size_t n = o.first[i];
        for (size_t k = 0; p < end; p += *p == ' ', k++, n = o.first[i] + k / 3) { /* X Y POINT3D_ID */
            struct colmap_observation *to = &o.at[n];
            CHECK(k % 3 == 2 ? parse_int64(&p, end, &to->point)
                             : parse_double(&p, end, k % 3 ? &to->y : &to->x));
        }
        o.first[i + 1] = n;
    }
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
               memcmp(x->translation, y->translation, sizeof x->translation) == 0;
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
    OWNED_COLMAP good = colmap_of(colmap_good_cameras, colmap_good_images, colmap_good_points);
    OWNED_COLMAP seen = colmap_of(cameras, images, points);
    CHECK(colmap_same(&good, &seen) && seen.warnings == warnings);
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
    snprintf(images, sizeof images, "# Number of images: 3, mean observations per image: 2\n%s",
             colmap_good_images);
    snprintf(points, sizeof points, "# Number of points:  3\n%s", colmap_good_points);
    test_listen();
    OWNED_COLMAP c = colmap_of(colmap_good_cameras, images, points);
    CHECK(test_said.warnings == 1 && c.warnings == 1 && c.is_truncated);
    CHECK_WARNED("points3D.txt: its header announces 3 points, and 2 are there");
}

/* ---------------- dialects */

/* Agisoft Metashape 2.2, "Export Cameras", COLMAP: labels with spaces, no 2D points, CR LF. */
TEST(colmap_reads_the_dialect_of_metashape)
{
    OWNED_COLMAP c = colmap_of(
        "# Camera list with one line of data per camera:\r\n#   CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\r\n"
        "# Number of cameras: 1\r\n0 PINHOLE 5472 3648 3666.6660000000002 3666.6660000000002 2736 1824\r\n",
        "# Image list with two lines of data per image:\r\n# Number of images: 2, mean observations per image: 0\r\n"
        "0 0.99 0.1 0.05 0.08 1.5 -2.5 3 0 dive 1/GOPR 0001 (2).JPG\r\n\r\n"
        "1 0.99 0.1 0.05 0.08 2.5 -2.5 3 0 dive 1/GOPR 0002.JPG\r\n\r\n",
        "# Number of points: 1, mean track length: 0\r\n0 1.25 -0.5 7 90 120 140 0\r\n");
    CHECK(c.image_count == 2 && c.point_count == 1 && c.warnings == 0 && !c.is_truncated &&
          c.track_count == 0);
    CHECK(strcmp(c.names + c.image[0].name, "dive 1/GOPR 0001 (2).JPG") == 0 && c.camera[0].id == 0);
}

/* Epic RealityScan (RealityCapture), "COLMAP" export: FULL_OPENCV with zeros for undistorted images, lines of
 * 2D points that are empty, and what Microsoft's printf makes of not-a-number. */
TEST(colmap_reads_the_dialect_of_realityscan)
{
    OWNED_COLMAP c =
        colmap_of("1 FULL_OPENCV 4000 3000 2911.5 2911.5 2000 1500 0 0 0 0 0 0 0 0\r\n",
                  "1 0.70710678118654757 0 0.70710678118654757 0 -1e-003 0 2.5 1 IMG 0001.jpg\r\n\r\n"
                  "2 0.70710678118654757 0 0.70710678118654757 0 1e+000 0 2.5 1 IMG 0002.jpg\r\n \r\n",
                  "1 0.5 0.25 8 10 20 30 -nan(ind) 1 0 2 0\r\n2 -nan 0 0 1 2 3 0.5\r\n3 1 1 1 1 2 3 nan\r\n");
    CHECK(c.image_count == 2 && c.point_count == 2 && c.warnings == 3);
    CHECK(c.point[0].error == -1 && c.point[0].track_count == 2 && c.point[1].id == 3 &&
          c.point[1].error == -1);
    CHECK(!camera_is_distorted(&c.camera[0]));
}

/* ---------------- what is read, again */

TEST(colmap_rows_are_read_as_written_by_id)
{
    OWNED_COLMAP c = colmap_of(colmap_good_cameras, colmap_good_images, colmap_good_points);
    CHECK(c.camera_count == 2 && c.image_count == 3 && c.point_count == 2 && c.track_count == 3 &&
          c.warnings == 0);
    CHECK(c.camera[0].id == 1 && c.camera[0].width == 640 && c.camera[0].height == 480 &&
          c.camera[0].line == 2 && c.camera[0].parameter_count == 4 && c.camera[0].parameter[1] == 501.5);
    CHECK(strcmp(camera_model_at(c.camera[0].model)->name, "PINHOLE") == 0);
    CHECK(c.camera[1].id == 3 && c.camera[1].parameter_count == 8 && c.camera[1].parameter[7] == -2e-4);
    CHECK(c.image[2].id == 7 && c.image[2].camera_id == 1 && c.image[2].line == 2 &&
          c.image[2].translation[1] == -1.5);
    CHECK(c.image[0].id == 2 && c.image[0].camera_id == 3 && c.image[0].rotation[1] == 0.6 &&
          !strcmp(c.names + c.image[0].name, "dive 1/IMG 0001.JPG"));
    CHECK(c.image[1].id == 5);
    CHECK(c.point[1].id == 9 && c.point[1].rgb[0] == 255 && c.point[1].rgb[1] == 0 &&
          c.point[1].rgb[2] == 128 && c.point[1].error == 0.25 && c.point[0].position[0] == 100);
    CHECK(c.point[1].first_track == 0 && c.point[1].track_count == 1 &&
          c.image[c.track[0].image_row].id == 5 && c.track[0].observation == 0);
    CHECK(c.point[0].first_track == 1 && c.point[0].track_count == 2 &&
          c.image[c.track[2].image_row].id == 2 && c.track[2].observation == 11);
}

TEST(colmap_a_ninth_number_of_opencv_is_k3)
{
    OWNED_COLMAP c =
        colmap_of("7 OPENCV 64 48 50 50 32 24 .1 .2 .3 .4 .5\n", "7 1 0 0 0 0 0 0 7 a.jpg\n\n", "");
    CHECK(!strcmp(camera_model_at(c.camera->model)->name, "FULL_OPENCV") && c.camera->parameter_count == 12);
    CHECK(c.camera->parameter[7] == .4 && c.camera->parameter[8] == .5 && c.camera->parameter[9] == 0);
}

TEST(colmap_real_surveys_are_read_without_a_warning)
{
    const char *path = test_shared("data/caliterra/sparse/0");
    OWNED_COLMAP c = {0};
    if (!path) SKIP("no shared data");
    CHECK_OK(colmap_read_folder(path, &c));
    CHECK(c.image_count == 75 && c.point_count == 28366 && c.track_count == 229775 && c.warnings == 0);
}

/* ---------------- what must not matter */

TEST(colmap_blanks_line_ends_comments_and_a_byte_order_mark_do_not_matter)
{
    colmap_check_same(colmap_replaced(colmap_good_cameras, '\n', "\r\n"),
                      colmap_replaced(colmap_good_images, '\n', "\r\n"),
                      colmap_replaced(colmap_good_points, '\n', " \r\n"), 0);
    colmap_check_same(colmap_replaced(colmap_good_cameras, ' ', "\t "),
                      colmap_replaced(colmap_good_images, '\n', " \t\n\t "),
                      colmap_replaced(colmap_good_points, ' ', "  "), 0);
    colmap_check_same(
        "\xEF\xBB\xBF\n# a\n\n1 PINHOLE 640 480 500.5 501.5 320 240\n# b\n"
        "3 OPENCV 1280 960 900 901 640 480 0.1 -0.02 1e-3 -2.0e-004\n\n",
        "# a\n\n7 1 0 0 0 0.5 -1.5 2 1 b.jpg\n10.5 20.25 4 30 -0.5 -1\n# b\n\n"
        "2 0.8 0.6 0 0 1 2 3 3 dive 1/IMG 0001.JPG\n\n\n\n5 0 0 0 1 0 0 0 1 c.png\n1.5 2.5 9\n\n",
        "\n9 1.5 -2.5 3 255 0 128 0.25 5 0\n\n# x\n4 1e2 0 -0.125 1 2 3 -1 7 0 2 11", 0);
}

/* ---------------- what is mended, with a warning */

TEST(colmap_missing_lines_of_2d_points_are_noticed)
{
    static const struct {
        const char *images;
        size_t count, warnings;
    } cases[] = {
        {"7 1 0 0 0 0.5 -1.5 2 1 b.jpg\n2 0.8 0.6 0 0 1 2 3 3 dive 1/IMG 0001.JPG\n# a\n5 0 0 0 1 0 0 0 1 c.png\n",
         3, 2},
        /* names that are numbers */
        {"7 1 0 0 0 0.5 -1.5 2 1 0001\n2 0.8 0.6 0 0 1 2 3 3 0002\n5 0 0 0 1 0 0 0 1 0003 4\n", 3, 2},
        {"7 1 0 0 0 0.5 -1.5 2 1 b.jpg\n2 1 0 0 0 1 2 3 1 7 8 9\n", 1, 0}, /* 2D points of whole numbers */
    };
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        OWNED_COLMAP c = colmap_of(colmap_good_cameras, cases[i].images, "");
        CHECK(c.image_count == cases[i].count && c.warnings == cases[i].warnings);
    }
}

TEST(colmap_points_with_values_that_cannot_be_are_mended)
{
    static const struct {
        const char *points;
        double error;
        size_t count, tracks;
    } cases[] = {{"9 1 nan 3 4 5 6 0.5 7 0\n8 1 2 3 4 5 6 0.5 7 0\n", 0.5, 1, 1},
                 {"9 1 2 3 4 5 6 -nan(ind) 7 0\n", -1, 1, 1},
                 {"9 1 2 3 4 5 6 0.5 7 0 99 3 5 1\n", 0.5, 1, 2}}; /* 99: an unknown image */
    for (size_t i = 0; i < OXL_COUNT(cases); i++) {
        OWNED_COLMAP c = colmap_of(colmap_good_cameras, colmap_good_images, cases[i].points);
        CHECK(!c.is_truncated && c.warnings == 1 && c.point_count == cases[i].count &&
              c.track_count == cases[i].tracks && c.point[0].error == cases[i].error &&
              c.point[0].first_track == 0);
    }
}

TEST(colmap_a_quaternion_of_another_length_is_read_with_a_warning)
{
    OWNED_COLMAP c = colmap_of(colmap_good_cameras, "7 2 0 0 0 0 0 0 1 b.jpg\n", "");
    CHECK(c.image[0].rotation[0] == 2 && c.warnings == 1);
}

TEST(colmap_warnings_name_file_and_line_and_are_cut_after_three_of_a_kind)
{
    OWNED_TEXT points = test_text();
    for (int i = 0; i < 25; i++) text_add(&points, "%d 1 2 3 4 5 6 nan 7 0\n", i);
    test_listen();
    OWNED_COLMAP c = colmap_of(colmap_good_cameras, colmap_good_images, points.data);
    CHECK(test_said.warnings == 4 && c.warnings == 25);
    CHECK_WARNED("points3D.txt:1: ");
    CHECK_WARNED("points3D.txt: 22 more cases");
}

/* ---------------- what is refused */

TEST(colmap_a_missing_file_is_named)
{
    struct colmap c;
    CHECK_ERROR(colmap_try(NULL, NULL, NULL, &c), OXL_ERR_INPUT, "cameras.txt is not there");
    test_write("model/cameras.bin", "");
    CHECK_ERROR(colmap_try(NULL, NULL, NULL, &c), OXL_ERR_INPUT, "images.bin is not there");
    CHECK_ERROR(colmap_try(colmap_good_cameras, NULL, NULL, &c), OXL_ERR_INPUT, "images.txt is not there");
    test_write("model/images.txt.gz", "");
    CHECK_ERROR(colmap_try(NULL, NULL, NULL, &c), OXL_ERR_INPUT,
                "images.txt: it is compressed\nfix: gunzip ");
}

TEST(colmap_values_that_cannot_be_are_refused_with_file_line_and_what_was_seen)
{
    static const struct {
        int file;
        const char *text, *said;
    } cases[] = {
        {0, "# nothing\n", "cameras.txt:1: found the end of the file, expected a camera"},
        {0, "\xFF\xFE\1", "found text in UTF-16, expected ASCII"},
        {0, "# x\n1 THICK_PRISM 640 480 1 2 3 4 5 6 7 8 9 10 11 12\n",
         "cameras.txt:2: found 'THICK_PRISM' for the camera model, expected one of SIMPLE_PINHOLE, "},
        {0, "1 THICK_PRISM 640 480 1\n", "fix: let COLMAP undistort: colmap image_undistorter"},
        {0, "1 PINHOLE 0 480 500 500 320 240\n", "cameras.txt:1: found '0', expected WIDTH"},
        {0, "1 PINHOLE 640 -480 500 500 320 240\n", "found '-480', expected HEIGHT"},
        {0, "1 PINHOLE 99999999999 480 500 500 320 240\n", "found '99999999999', expected WIDTH"},
        {0, "1 PINHOLE 640 480 500 -500 320 240\n", "found '-500', expected a focal length"},
        {0, "1 SIMPLE_RADIAL 640 480 0 320 240 0\n", "found '0', expected a focal length"},
        {0, "1 PINHOLE 640 480 -nan(ind) 500 320 240\n",
         "found '-nan(ind)', expected the 4 PARAMS of PINHOLE, a finite number"},
        {0, "1 PINHOLE 640 480 500 500 320\n", "found the end of the line, expected the 4 PARAMS of PINHOLE"},
        {0, "1 PINHOLE 640 480 500 500 320 240 0.1\n", "found '0.1', expected the end of the line"},
        {0, "1 PINHOLE 640 480 500 500 320 240\n1 PINHOLE 640 480 500 500 320 240\n",
         "cameras.txt: the id 1 appears twice"},
        {0, "1 PINHOLE 640 480 500,25 500,5 320 240\n",
         "cameras.txt:1: found '500,25', expected the 4 PARAMS"},
        {1, "", "expected an image"},
        {1, "7 1 0 0 0 0 0 0 1 a\n\n8 1 0 0 0 0 0 0 1 b\n\n7 1 0 0 0 0 0 0 1 c\n",
         "images.txt: the id 7 appears twice"},
        {1, "7 1 0 0 0 0 0 0 9 b.jpg\n",
         "images.txt:1: camera id 9 is not in cameras.txt (2 ids there: 1 to 3)"},
        {1, "7 nan 0 0 0 0 0 0 1 b.jpg\n", "images.txt:1: found 'nan', expected QW, a finite number"},
        {1, "7 1 0 0 0 0 inf 0 1 b.jpg\n", "found 'inf', expected TY, a finite number"},
        {1, "7 0 0 0 0 0 0 0 1 b.jpg\n", "found the quaternion 0 0 0 0"},
        {1, "7 1e200 1e200 0 0 0 0 0 1 b.jpg\n", "expected a rotation"},
        {1, "7 1 0 0 0 0 0\n", "images.txt:1: found the end of the line, expected TZ"},
        {1, "7 1 0 0 0 0 0 0 1\n", "images.txt:1: found the end of the line, expected NAME"},
        {1, "7 1 0 0 0 0 0 0 b.jpg\n", "images.txt:1: found 'b.jpg', expected CAMERA_ID"},
        {1, "7 1 0 0 0 0 0 0 1 ..\n", "expected NAME, a file in the image folder"},
        {1, "7 0,99 0,01 0 0 0 0 0 1 b.jpg\n", "LC_ALL=C"},
        {2, "9 1 2 3 4 5 6 0.5\n8 1 2 3 4 5 6 0.5\n9 1 2 3 4 5 6 0.5\n",
         "points3D.txt: the id 9 appears twice"},
        {2, "9 1 2 3 4 5\n", "points3D.txt:1: found the end of the line, expected B"},
        {2, "9 1 2 3 4 5 6 0.5 7 0 5\n", "points3D.txt:1: found the end of the line, expected POINT2D_IDX"},
        {2, "9 1 2 3 4 5 6 0.5 7 -1\n", "found '-1', expected POINT2D_IDX"},
        {2, "9 1 2 3 4 5 6 0.5 7 4294967296\n", "found '4294967296', expected POINT2D_IDX"},
        {2, "9 1 2 3 4 256 6 0.5\n", "points3D.txt:1: found '256', expected G, an integer from 0 to 255"},
        {2, "9 1 2 3 0.5 5 6 0.5\n", "found '0.5', expected R"},
        {2, "9 1,5 2 3 4 5 6 0.5\n", "points3D.txt:1: found '1,5', expected X"},
    };
    for (size_t i = 0; i < OXL_COUNT(cases); i++)
        CHECK_TEXT(colmap_refused(cases[i].file, cases[i].text), cases[i].said);
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
                                           {"././/a.jpg", "a.jpg"}};
    char images[200];
    for (size_t i = 0; i < OXL_COUNT(names); i++) {
        snprintf(images, sizeof images, "7 1 0 0 0 0 0 0 1 %s\n", names[i][0]);
        OWNED_COLMAP c = colmap_of(colmap_good_cameras, images, "");
        CHECK(!strcmp(c.names + c.image[0].name, names[i][1]));
    }
}

/* ---------------- what must not happen */

TEST(colmap_a_file_cut_at_any_byte_is_read_or_refused_with_a_text)
{
    char cut[1000];
    for (int file = 1; file < 3; file++) {
        const char *whole = file == 1 ? colmap_good_images : colmap_good_points;
        for (int n = 0; n < (int)strlen(whole); n++) {
            OWNED_COLMAP c = {0};
            snprintf(cut, sizeof cut, "%.*s", n, whole);
            test_ctx->error[0] = 0;
            if (colmap_try(colmap_good_cameras, file == 1 ? cut : colmap_good_images,
                           file == 2 ? cut : colmap_good_points, &c) != OXL_OK)
                CHECK_SAYS(file == 1 ? "images.txt:" : "points3D.txt:");
        }
    }
}

/* ---------------- windows */

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

TEST(colmap_the_window_does_not_matter_to_rows_and_errors)
{
    OWNED_TEXT points = test_text();
    struct colmap parts;
    colmap_add_points(&points); /* 1001 lines */
    OWNED_COLMAP whole = colmap_of(colmap_good_cameras, colmap_good_images, points.data);
    CHECK(whole.point_count == 1000 && whole.warnings > 0);
    for (size_t window = 1; window < 100000; window += window / 2 + 1) {
        CHECK_OK(colmap_read(test_ctx, test_path("model"), window, NULL, &parts));
        CHECK(colmap_same(&whole, &parts) && whole.warnings == parts.warnings);
        colmap_free(test_ctx, &parts);
    }
    text_add(&points, "5 1 2 3 4 5 6 0.5 7 0\n7 1 2 x 4 5 6 0.5\n7 1 2 y 4 5 6 0.5\n");
    colmap_refused(2, points.data);
    for (size_t window = 1; window < 100000; window += window / 2 + 1) {
        CHECK_ERROR(colmap_read(test_ctx, test_path("model"), window, NULL, &parts), OXL_ERR_INPUT,
                    "points3D.txt:1003: found 'x', expected Z");
    }
}

TEST(colmap_ids_and_places_in_tracks_may_be_any)
{
    OWNED_COLMAP c = colmap_of(colmap_good_cameras, colmap_good_images,
                               "-9223372036854775808 1 2 3 4 5 6 0.5\n9223372036854775807 1 2 3 4 5 6 0.5\n"
                               "0 1 2 3 4 5 6 0.5 +7 4294967295 0000000005 7\n");
    CHECK(c.point_count == 3 && c.point[0].id == INT64_MIN && c.point[2].id == INT64_MAX);
    CHECK(c.track_count == 2 && c.track[0].observation == 4294967295u &&
          c.image[c.track[1].image_row].id == 5);
}

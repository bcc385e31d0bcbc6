/* test_model.c - planes of Gaussians: their memory, their start from points, their files. */
#include "test.h"

/* ---------------- helpers */

static double model_test_unit(uint64_t i, uint64_t a)
{
    return random_unit(random_bits(11, i, a));
}

/* All rows different, as raw as a trained model's. */
static oxl_model model_test_random(size_t count, int degree)
{
    oxl_model m = test_model(count, degree);
    for (int p = 0; p < oxl_model_planes(&m); p++)
        for (size_t i = 0; i < count; i++) m.plane[p][i] = (float)(8 * model_test_unit(i, (uint64_t)p) - 4);
    return m;
}

/* Bit for bit; planes past b's degree must be zero in a. */
static int model_test_same(const oxl_model *a, const oxl_model *b)
{
    int same = a->count == b->count && !memcmp(a->origin, b->origin, sizeof a->origin);
    for (int p = 0; same && p < oxl_model_planes(a); p++)
        for (size_t i = 0; i < a->count; i++) {
            const float zero = 0;
            same &= !memcmp(&a->plane[p][i], b->plane[p] ? &b->plane[p][i] : &zero, sizeof zero);
        }
    return same;
}

static oxl_point *model_test_points(size_t count)
{
    oxl_point *p = oxl_calloc(test_ctx, count, sizeof *p);
    for (size_t i = 0; i < count; i++) {
        for (uint64_t a = 0; a < 3; a++) {
            p[i].position[a] = (float)(10 * model_test_unit(i, a) * (a == 2 ? 0.1 : 1)); /* a seabed */
            p[i].rgb[a] = (uint8_t)(random_bits(3, i, a) >> 56);
        }
        if (i % 97 == 0) p[i].position[0] = (float)(p[i].position[0] + 5000); /* outliers */
    }
    return p;
}

/* ---------------- memory */

TEST(model_planes_are_aligned_and_padded_with_identity_rows_to_whole_packs)
{
    for (size_t count = 0; count < 70; count += 23) {
        oxl_model m = test_model(count, 2);
        CHECK(m.count == count && m.capacity >= OXL_MAX(count, (size_t)16) && m.capacity % 16 == 0);
        CHECK(oxl_model_planes(&m) == 38 && m.plane[37] && !m.plane[38]);
        for (int p = 0; p < 38; p++) {
            CHECK((uintptr_t)m.plane[p] % 64 == 0);
            for (size_t i = 0; i < m.capacity; i++) CHECK(m.plane[p][i] == (p == OXL_ROTATION));
        }
        oxl_model_free(test_ctx, &m);
        CHECK(!m.memory && !m.plane[0]);
    }
}

TEST(model_reserve_and_set_degree_keep_rows_and_clear_the_rest)
{
    OWNED_MODEL m = model_test_random(50, 1), old = {0};
    CHECK_OK(model_copy(test_ctx, &m, &old));
    CHECK(model_test_same(&m, &old));
    CHECK_OK(model_reserve(test_ctx, &m, 1000));
    CHECK(m.capacity >= 1000 && model_test_same(&m, &old));
    for (size_t i = 50; i < m.capacity; i++)
        CHECK(m.plane[OXL_ROTATION][i] == 1 && m.plane[OXL_MEAN][i] == 0);
    CHECK_OK(model_set_degree(test_ctx, &m, 3));
    CHECK(m.capacity >= 1000 && oxl_model_planes(&m) == 59 && model_test_same(&m, &old));
    CHECK_OK(model_set_degree(test_ctx, &m, 0));
    CHECK(!m.plane[14] && !memcmp(m.plane[13], old.plane[13], 50 * sizeof(float)));
}

TEST(model_sizes_and_degrees_that_cannot_be_are_errors)
{
    oxl_model m;
    CHECK(oxl_model_create(test_ctx, SIZE_MAX - 3, 0, &m) == OXL_ERR_MEMORY && !m.memory && m.count == 0);
    CHECK(oxl_model_create(test_ctx, SIZE_MAX / 100, 3, &m) == OXL_ERR_MEMORY && !m.memory);
    CHECK(oxl_model_create(test_ctx, 1, 4, &m) == OXL_ERR_USAGE && !m.memory);
    CHECK(oxl_model_create(test_ctx, 1, -1, &m) == OXL_ERR_USAGE && !m.memory);
}

/* ---------------- the second lobe */

static int model_test_same_lobes(const oxl_model *a, const oxl_model *b)
{
    int same = a->lobes == b->lobes;
    for (int p = OXL_LOBE; same && p < OXL_PLANES; p++)
        same = a->lobes ? !memcmp(a->plane[p], b->plane[p], a->lobes * sizeof(float))
                        : !a->plane[p] && !b->plane[p];
    return same;
}

/* Rows 0..lobes-1 with random factors. */
static oxl_model model_test_lobed(size_t count, int degree, size_t lobes)
{
    oxl_model m = model_test_random(count, degree);
    CHECK_OK(model_set_lobes(test_ctx, &m, lobes));
    for (int p = OXL_LOBE; lobes && p < OXL_PLANES; p++)
        for (size_t i = 0; i < lobes; i++) m.plane[p][i] = (float)(4 * model_test_unit(i, (uint64_t)p) - 2);
    return m;
}

TEST(model_lobes_are_held_for_whole_packs_of_their_rows_alone_and_survive_growth_and_copies)
{
    OWNED_MODEL m = model_test_lobed(100, 1, 17), old = {0}, none = model_test_random(5, 0);
    CHECK(!none.plane[OXL_LOBE] && none.lobes == 0);
    CHECK((float *)m.memory + 23 * m.capacity == m.plane[OXL_LOBE] &&
          m.plane[OXL_LOBE + 1] == m.plane[OXL_LOBE] + 32);
    for (int p = OXL_LOBE; p < OXL_PLANES; p++)
        for (int i = 17; i < 32; i++) CHECK((uintptr_t)m.plane[p] % 64 == 0 && m.plane[p][i] == 0);
    CHECK_OK(model_copy(test_ctx, &m, &old));
    CHECK(model_test_same(&m, &old) && model_test_same_lobes(&m, &old));
    CHECK_OK(model_reserve(test_ctx, &m, 1000));
    CHECK_OK(model_set_degree(test_ctx, &m, 3));
    CHECK(model_test_same(&m, &old) && model_test_same_lobes(&m, &old));
    CHECK(model_set_lobes(test_ctx, &m, 101) == OXL_ERR_USAGE);
    CHECK_OK(model_set_lobes(test_ctx, &m, 20));
    CHECK(m.lobes == 20 && !memcmp(m.plane[OXL_LOBE + 3], old.plane[OXL_LOBE + 3], 17 * sizeof(float)));
    CHECK(m.plane[OXL_LOBE + 3][17] == 0);
    model_drop_lobes(&m);
    CHECK(m.lobes == 0 && !m.plane[OXL_LOBE] && model_test_same(&m, &old));
}

TEST(model_keep_rows_keeps_order_and_lobes)
{
    OWNED_MODEL m = model_test_lobed(50, 1, 30), old = {0};
    uint8_t keep[50];
    size_t at = 0, lobes = 0;
    CHECK_OK(model_copy(test_ctx, &m, &old));
    for (int i = 0; i < 50; i++) keep[i] = (uint8_t)(i % 3 != 1);
    model_keep_rows(&m, keep);
    for (size_t i = 0; i < 50; i++) {
        if (!keep[i]) continue;
        for (int p = 0; p < oxl_model_planes(&m); p++) CHECK(m.plane[p][at] == old.plane[p][i]);
        for (int p = OXL_LOBE; i < 30 && p < OXL_PLANES; p++) CHECK(m.plane[p][at] == old.plane[p][i]);
        at++;
        lobes += i < 30;
    }
    CHECK(m.count == at && m.lobes == lobes && m.plane[OXL_LOBE][lobes] == 0 &&
          m.plane[OXL_ROTATION][at] == 1);
    memset(keep, 0, sizeof keep);
    keep[m.lobes] = 1;
    model_keep_rows(&m, keep);
    CHECK(m.count == 1 && m.lobes == 0 && !m.plane[OXL_LOBE]);
}

TEST(model_activation_brings_active_rows_to_the_front_and_keeps_each_rows_numbers)
{
    enum { N = 70 };
    struct trained_model t;
    oxl_model old[3];
    uint8_t active[N];
    size_t front = 0, back = 0;
    for (int n = 0; n < 3; n++) {
        oxl_model *m = model_trained_part(&t, n);
        *m = model_test_random(N, n % 2 ? 1 : 2);
        for (size_t i = 0; i < N; i++) m->plane[OXL_MEAN][i] = (float)(1000 * n) + (float)i;
        CHECK_OK(model_copy(test_ctx, m, &old[n]));
    }
    for (size_t i = 0; i < N; i++) back += active[i] = (uint8_t)(random_bits(5, i, 0) % 3 == 0);
    CHECK_OK(model_trained_make_lobes(test_ctx, &t, active, 0.25f, 1.6f));
    CHECK(t.model.lobes == back && t.mean.lobes == back && t.square.lobes == back && back > 10);
    for (size_t i = 0; i < N; i++) {
        const size_t at = active[i] ? front++ : back++;
        for (int n = 0; n < 3; n++)
            for (int p = 0; p < oxl_model_planes(&old[n]); p++)
                CHECK(model_trained_part(&t, n)->plane[p][at] == old[n].plane[p][i]);
        for (int p = OXL_LOBE; active[i] && p < OXL_PLANES; p++) {
            CHECK_CLOSE(t.model.plane[p][at], p == OXL_LOBE ? log(0.25 / 0.75) : log(1.6), 1e-6);
            CHECK(t.mean.plane[p][at] == 0 && t.square.plane[p][at] == 0);
        }
    }
    CHECK(model_trained_make_lobes(test_ctx, &t, active, 0.25f, 1.6f) == OXL_ERR_USAGE);
    model_trained_free(test_ctx, &t);
    for (int n = 0; n < 3; n++) oxl_model_free(test_ctx, &old[n]);
}

TEST(model_lobes_come_back_from_a_ply_and_nowhere_else)
{
    OWNED_MODEL m = model_test_lobed(300, 3, 77), plain = {0};
    m.origin[1] = 0.1;
    test_write_model("m.ply", &m);
    OWNED_MODEL same = test_read_model("m.ply");
    CHECK(same.lobes == 77 && model_test_same(&same, &m) && model_test_same_lobes(&same, &m));
    OWNED_FILE lobed = test_file("m.ply");
    CHECK(lobed.size > 300 * 248 + 77 * 16 && lobed.size < 300 * 248 + 77 * 16 + 2048);
    CHECK(strstr(lobed.data, "element dog 77\nproperty float opacity_factor\n"));
    CHECK(strstr(lobed.data, "scale_factor_2\nend_header\n") && strstr(lobed.data, "comment dog: "));
    test_listen();
    test_write_model("m_standard.ply", &m);
    CHECK_LOGGED("second lobes of 77 of 300");
    test_said.all[0] = 0;
    CHECK_OK(model_copy(test_ctx, &m, &plain));
    model_drop_lobes(&plain);
    test_write_model("plain.ply", &plain);
    CHECK(!test_said.all[0]);
    OWNED_FILE a = test_file("m_standard.ply"), b = test_file("plain.ply");
    CHECK(a.size == b.size && !memcmp(a.data, b.data, a.size) && !strstr(b.data, "dog"));
    test_write_model("m.splat", &m);
    m.plane[OXL_LOBE + 2][70] = INFINITY;
    CHECK_ERROR(oxl_model_write(test_ctx, test_path("m.ply"), &m), OXL_ERR_FAILED, "row 70 holds a value");
}

#define MODEL_TEST_LOBED                                                                                                     \
    "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nproperty float f_dc_0\n" \
    "property float f_dc_1\nproperty float f_dc_2\nproperty float scale_0\nproperty float scale_1\nproperty float scale_2\n" \
    "property float rot_0\nproperty float rot_1\nproperty float rot_2\nproperty float rot_3\nproperty float opacity\n"       \
    "element dog 2\nproperty float scale_factor_2\nproperty float scale_factor_1\nproperty float scale_factor_0\n"           \
    "property %s opacity_factor\nend_header\n"                                                                               \
    "0 0 0 0 0 0 0 0 0 1 0 0 0 0\n1 0 0 0 0 0 0 0 0 1 0 0 0 0\n2 0 0 0 0 0 0 0 0 1 0 0 0 0\n3 0 0 0 0 0 0 0 0 1 0 0 0 0\n%s\n"

static const char *model_test_lobed_file(const char *type, const char *rows)
{
    static char text[2048];
    snprintf(text, sizeof text, MODEL_TEST_LOBED, type, rows);
    return test_write("m.ply", text);
}

TEST(model_read_takes_the_columns_of_lobes_in_any_order)
{
    OWNED_MODEL m = test_read_model(model_test_lobed_file("double", "13 12 11 10\n43 42 41 40"));
    CHECK(m.count == 4 && m.lobes == 2);
    for (int k = 0; k < 4; k++)
        CHECK(m.plane[OXL_MEAN][1] == 1 && m.plane[OXL_LOBE + k][0] == 10 + k &&
              m.plane[OXL_LOBE + k][1] == 40 + k);
    oxl_model_free(test_ctx, &m);
    m = test_read_model(model_test_lobed_file("float", "0 0 0 0\n0 nan 0 0"));
    CHECK(m.count == 3 && m.lobes == 1 && m.plane[OXL_MEAN][0] == 0 && m.plane[OXL_MEAN][2] == 3);
}

TEST(model_read_refuses_lobes_without_their_columns)
{
    oxl_model m;
    CHECK_ERROR(
        oxl_model_read(test_ctx, model_test_lobed_file("list uchar float", "0 0 0 1 0\n0 0 0 1 0"), &m),
        OXL_ERR_INPUT, "element dog has no property 'opacity_factor'");
}

/* ---------------- start from points */

/* Exact, by trying all pairs, in the model's own rows: positions are floats, so nothing was rounded. */
static double model_test_log_width(const oxl_model *m, size_t row)
{
    double nearest[3] = {INFINITY, INFINITY, INFINITY};
    for (size_t j = 0; j < m->count; j++) {
        double d = 0;
        for (int a = 0; a < 3; a++) {
            const double e = (double)m->plane[OXL_MEAN + a][row] - m->plane[OXL_MEAN + a][j];
            d += e * e;
        }
        for (int k = 0; k < 3 && j != row; k++)
            if (d < nearest[k]) {
                const double further = nearest[k];
                nearest[k] = d;
                d = further;
            }
    }
    return 0.5 * log((nearest[0] + nearest[1] + nearest[2]) / 3);
}

TEST(model_from_points_is_as_wide_as_the_mean_distance_to_the_three_nearest)
{
    OWNED_MEMORY oxl_point *points = model_test_points(3000);
    OWNED_MODEL m = test_model_of(points, 3000, 1);
    CHECK(m.count == 3000 && m.sh_degree == 1);
    for (size_t i = 0; i < m.count; i++) {
        CHECK_CLOSE(m.plane[OXL_LOG_SCALE][i], model_test_log_width(&m, i), 1e-6);
        CHECK(m.plane[OXL_LOG_SCALE][i] == m.plane[OXL_LOG_SCALE + 1][i] &&
              m.plane[OXL_LOG_SCALE][i] == m.plane[OXL_LOG_SCALE + 2][i]);
        CHECK(m.plane[OXL_ROTATION][i] == 1 && m.plane[OXL_ROTATION + 3][i] == 0 &&
              m.plane[OXL_SH + 3][i] == 0);
        CHECK_CLOSE(m.plane[OXL_OPACITY][i], log(0.1 / 0.9), 1e-6);
    }
}

/* Each point is found once, with its own colour. */
TEST(model_from_points_keeps_every_point_and_its_colour)
{
    OWNED_MEMORY oxl_point *points = model_test_points(500);
    uint8_t seen[500] = {0};
    /* x names the point */
    for (size_t i = 0; i < 500; i++) points[i].position[0] = (float)((i * 7919) % 500);
    OWNED_MODEL m = test_model_of(points, 500, 0);
    for (size_t row = 0; row < m.count; row++) {
        size_t i = 0;
        while (i < 500 && points[i].position[0] != (double)m.plane[OXL_MEAN][row]) i++;
        CHECK(i < 500 && !seen[i]);
        seen[i] = 1;
        CHECK(m.plane[OXL_MEAN + 1][row] == (float)points[i].position[1] &&
              m.plane[OXL_MEAN + 2][row] == (float)points[i].position[2]);
        for (int c = 0; c < 3; c++)
            CHECK_CLOSE(0.5 + MODEL_SH0 * m.plane[OXL_SH + c][row], points[i].rgb[c] / 255.0, 1e-6);
    }
}

TEST(model_from_points_gives_the_same_bytes_with_any_number_of_threads)
{
    OWNED_MEMORY oxl_point *points = model_test_points(20000);
    test_ctx->threads = 1;
    OWNED_MODEL one = test_model_of(points, 20000, 0);
    test_ctx->threads = 7;
    OWNED_MODEL seven = test_model_of(points, 20000, 0);
    CHECK(model_test_same(&one, &seven));
}

/* The eight corners of a cube in any order come out in Z-order, x fastest; of three at the same corner the
 * first one counts. */
TEST(model_from_points_orders_rows_along_the_z_curve_and_takes_the_first_of_those_that_coincide)
{
    static const int corner[10] = {5, 2, 7, 0, 3, 6, 1, 4, 6, 6};
    oxl_point points[10] = {{.error = 0}};
    for (int i = 0; i < 10; i++) {
        for (int a = 0; a < 3; a++) points[i].position[a] = corner[i] >> a & 1;
        points[i].rgb[0] = (uint8_t)i;
    }
    points[9].position[0] = -0.0; /* the same place as 0 */
    OWNED_MODEL m = test_model_of(points, 10, 0);
    CHECK(m.count == 8);
    for (int i = 0; i < 8; i++) {
        const int found = (int)(m.plane[0][i] + 2 * m.plane[1][i] + 4 * m.plane[2][i]);
        CHECK(found == i);
    }
    CHECK_CLOSE(0.5 + MODEL_SH0 * m.plane[OXL_SH][6], 5 / 255.0, 1e-6);
}

/* Half a million points on 50 places, and on one, are as many Gaussians, and as wide as those of the places
 * alone. */
TEST(model_from_points_on_few_places_has_one_gaussian_a_place)
{
    enum { N = 500000, PLACES = 50 };
    OWNED_MEMORY oxl_point *place = model_test_points(PLACES),
                           *points = oxl_alloc(test_ctx, N, sizeof *points);
    OWNED_MODEL few = test_model_of(place, PLACES, 0);
    for (int places = PLACES; places >= 1; places -= PLACES - 1) {
        for (size_t i = 0; i < N; i++) points[i] = place[i % (size_t)places];
        OWNED_MODEL m = test_model_of(points, N, 0);
        CHECK(m.count == (size_t)places);
        for (int i = 0; i < places && places == PLACES; i++)
            CHECK(m.plane[OXL_LOG_SCALE][i] == few.plane[OXL_LOG_SCALE][i]);
    }
}

TEST(model_from_points_that_almost_coincide_has_a_floor_of_one_percent_of_the_median_width)
{
    enum { N = 4000 };
    OWNED_MEMORY oxl_point *points = model_test_points(N);
    double least = 1e9;
    float sorted[N];
    for (int i = 0; i < 1500; i++)
        for (int a = 0; a < 3; a++) points[i].position[a] = points[0].position[a] + (a ? 0 : 1e-9 * i);
    OWNED_MODEL m = test_model_of(points, N, 0);
    for (int i = 0; i < N; i++) least = OXL_MIN(least, (double)m.plane[OXL_LOG_SCALE][i]);
    for (int i = 0; i < N; i++) { /* insertion sort of the widths */
        int j = i;
        for (; j > 0 && sorted[j - 1] > m.plane[OXL_LOG_SCALE][i]; j--) sorted[j] = sorted[j - 1];
        sorted[j] = m.plane[OXL_LOG_SCALE][i];
    }
    CHECK(sorted[1499] == (float)least && sorted[1500] > (float)least);
    double median = sorted[N / 2];
    CHECK_CLOSE(least, median + log(0.01), 1e-5);
}

TEST(model_from_one_two_three_and_coincident_points_is_finite)
{
    static const oxl_point points[3] = {{.error = 0}, {.position = {3, 0, 0}}, {.position = {0, 4, 0}}};
    oxl_point heap[100] = {{.error = 0}};
    for (size_t count = 0; count <= 3; count++) {
        const double width[] = {0, 0, log(3), 0.5 * log((9 + 16) / 2.0)};
        OWNED_MODEL m = test_model_of(points, count, 0);
        CHECK(m.count == count);
        if (count) CHECK_CLOSE(m.plane[OXL_LOG_SCALE][0], width[count], 1e-6);
    }
    for (size_t i = 0; i < 100; i++) heap[i].position[1] = -7;
    OWNED_MODEL m = test_model_of(heap, 100, 0);
    CHECK(m.count == 1 && m.plane[OXL_LOG_SCALE][0] == 0 && m.plane[OXL_MEAN + 1][0] == -7);
}

TEST(model_from_points_that_are_not_finite_names_the_point)
{
    oxl_point points[2] = {{.error = 0}, {.position = {0, NAN, 0}}};
    oxl_model m;
    CHECK(oxl_model_from_points(test_ctx, points, 2, 0, &m) == OXL_ERR_INPUT && !m.memory);
    CHECK_SAYS("point 1 of 2: coordinate 1 is");
}

/* ---------------- PLY */

/* "property float " and each of the 62 names, written out by rule. */
static void model_test_header(struct text *t, size_t rows, const char *origin)
{
    static const char *const first[] = {"x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"};
    static const char *const last[] = {"opacity", "scale_0", "scale_1", "scale_2",
                                       "rot_0",   "rot_1",   "rot_2",   "rot_3"};
    text_add(t, "ply\nformat binary_little_endian 1.0\ncomment origin %s\nelement vertex %zu\n", origin,
             rows);
    for (size_t i = 0; i < OXL_COUNT(first); i++) text_add(t, "property float %s\n", first[i]);
    for (int i = 0; i < 45; i++) text_add(t, "property float f_rest_%d\n", i);
    for (size_t i = 0; i < OXL_COUNT(last); i++) text_add(t, "property float %s\n", last[i]);
    text_add(t, "end_header\n");
}

TEST(model_write_gives_exactly_the_standard_header_and_248_bytes_a_gaussian)
{
    const char *path = test_path("m.ply");
    OWNED_TEXT header = test_text();
    OWNED_MODEL m = test_model(3, 1);
    m.origin[0] = 500000.25;
    m.origin[1] = -4200000.1;
    /* row 1 holds: planes numbered p as the value p + 100 */
    for (int p = 0; p < oxl_model_planes(&m); p++) m.plane[p][1] = (float)(p + 100);
    test_write_model(path, &m);
    OWNED_FILE file = test_file(path);
    model_test_header(&header, 3, "500000.25 -4200000.1 0");
    CHECK(header.size < 10240 && file.size == header.size + 3 * 248);
    {
        const unsigned char *row = (const unsigned char *)file.data + header.size + 248;
        CHECK(!memcmp(file.data, header.data, header.size));
        for (int c = 0; c < 62; c++) {
            int plane = -1;
            uint32_t wanted = 0;
            if (c < 3) plane = OXL_MEAN + c;
            else if (c >= 6 && c < 9) plane = OXL_SH + c - 6;
            else if (c >= 9 && c < 12) plane = OXL_SH + 3 * (c - 8) + 0;   /* red of coefficients 1, 2, 3 */
            else if (c >= 24 && c < 27) plane = OXL_SH + 3 * (c - 23) + 1; /* green, 15 columns on */
            else if (c >= 39 && c < 42) plane = OXL_SH + 3 * (c - 38) + 2;
            else if (c == 54) plane = OXL_OPACITY;
            else if (c >= 55 && c < 58) plane = OXL_LOG_SCALE + c - 55;
            else if (c >= 58) plane = OXL_ROTATION + c - 58;
            if (plane >= 0) memcpy(&wanted, &m.plane[plane][1], sizeof wanted);
            CHECK(bytes_u32(row + 4 * c) == wanted);
        }
    }
}

TEST(model_read_gives_back_every_bit_that_was_written)
{
    const char *path = test_path("m.ply");
    for (int degree = 0; degree <= 3; degree++) {
        OWNED_MODEL m = model_test_random(1000, degree);
        m.plane[0][0] = -0.0f;
        m.plane[1][0] = FLT_MAX;
        m.plane[2][0] = 1e-45f;
        m.origin[0] = 0.1;
        m.origin[1] = 1.0 / 3;
        m.origin[2] = -123456789.123456789;
        test_write_model(path, &m);
        OWNED_MODEL standard = test_read_model(path);
        CHECK(standard.sh_degree == 3 && model_test_same(&standard, &m));
        CHECK_OK(model_file_write_ply(test_ctx, path, &m, degree));
        OWNED_MODEL compact = test_read_model(path);
        CHECK(compact.sh_degree == degree && model_test_same(&compact, &m));
    }
}

TEST(model_write_refuses_values_that_are_not_finite_and_leaves_the_old_file)
{
    const char *path = test_path("m.ply");
    OWNED_MODEL m = model_test_random(20, 1);
    test_write_bytes(path, "old", 3);
    m.plane[OXL_SH + 3 * 2 + 1][7] = NAN;
    CHECK_ERROR(oxl_model_write(test_ctx, path, &m), OXL_ERR_FAILED,
                "row 7 holds a value that is not finite");
    m.plane[OXL_SH + 3 * 2 + 1][7] = 0;
    m.plane[OXL_OPACITY][19] = -INFINITY;
    CHECK_ERROR(oxl_model_write(test_ctx, path, &m), OXL_ERR_FAILED, "row 19 holds");
    CHECK(oxl_model_write(test_ctx, test_path("m.splat"), &m) == OXL_ERR_FAILED && !test_has("m.splat"));
    m.plane[OXL_OPACITY][19] = 0;
    m.origin[1] = NAN;
    CHECK(oxl_model_write(test_ctx, path, &m) == OXL_ERR_FAILED);
    OWNED_FILE file = test_file(path);
    CHECK(file.size == 3);
}

TEST(model_write_wants_a_known_extension)
{
    OWNED_MODEL m = model_test_random(1, 0);
    CHECK_ERROR(oxl_model_write(test_ctx, test_path("m.obj"), &m), OXL_ERR_USAGE, ".ply, .spz or .splat");
}

TEST(model_read_takes_properties_of_any_order_and_type_and_others_beside_them)
{
    static const float wanted[14] = {1.5f, 3.5f, 2.5f, 4, 5, 6, 6.5f, 7, 8, 9, -3, 10, 11, 12};
    OWNED_MODEL m = test_read_model(test_write(
        "m.ply", "ply\r\nformat ascii 1.0\r\nelement camera 1\r\nproperty list uchar float view\r\n"
                 "element vertex 2\r\nproperty float rot_3\r\nproperty double x\r\nproperty int opacity\r\n"
                 "property float z\r\nproperty float y\r\nproperty uchar red\r\nproperty float scale_2\r\n"
                 "property float scale_1\r\nproperty float scale_0\r\nproperty float f_dc_2\r\n"
                 "property float f_dc_0\r\nproperty float f_dc_1\r\nproperty float rot_0\r\n"
                 "property float rot_1\r\nproperty float rot_2\r\nend_header\r\n2 0.5 0.5\r\n"
                 "9 1.5 -3 2.5 3.5 255 6 5 4 12 10 11 6.5 7 8\r\n1 2 3 4 5 6 7 8 9 10 11 12 13 14 15\r\n"));
    CHECK(m.count == 2 && m.sh_degree == 0 && m.origin[0] == 0);
    for (int p = 0; p < 14; p++) CHECK(m.plane[p][0] == wanted[p]);
}

#define MODEL_TEST_REQUIRED                                                                                                       \
    "property float x\nproperty float y\nproperty float z\nproperty float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\n" \
    "property float scale_0\nproperty float scale_1\nproperty float scale_2\nproperty float rot_0\nproperty float rot_1\n"        \
    "property float rot_2\nproperty float rot_3\n"

TEST(model_read_drops_rows_that_are_not_finite_and_says_how_many)
{
    test_listen();
    OWNED_MODEL m = test_read_model(test_write(
        "m.ply",
        "ply\nformat ascii 1.0\nelement vertex 5\n" MODEL_TEST_REQUIRED "property float opacity\nend_header\n"
        "4 0 0 0 0 0 0 1e38 0 1 0 0 0 0\nnan 0 0 0 0 0 0 0 0 1 0 0 0 0\n1 0 0 0 0 0 0 0 0 1 0 0 0 0\n2 0 0 0 0 0 0 0 0 1 0 0 0 nan\n"
        "3 0 0 0 0 0 0 0 0 1 0 0 0 0\n"));
    CHECK(m.count == 2 && m.not_finite == 3 && m.plane[0][0] == 1 && m.plane[0][1] == 3);
    CHECK_LOGGED("3 of 5 Gaussians hold values");
    for (size_t i = 2; i < m.capacity; i++) CHECK(m.plane[0][i] == 0 && m.plane[OXL_ROTATION][i] == 1);
}

static void model_test_refused(const char *header, const char *words, const char *more)
{
    oxl_model m;
    char text[2048];
    snprintf(text, sizeof text, "ply\nformat ascii 1.0\n%send_header\n", header);
    CHECK(oxl_model_read(test_ctx, test_write("m.ply", text), &m) == OXL_ERR_INPUT && !m.memory &&
          m.count == 0);
    CHECK_SAYS(words);
    CHECK_SAYS(more);
}

TEST(model_read_explains_files_that_are_no_models)
{
    oxl_model m;
    model_test_refused("element face 0\n", "no element 'vertex'", "3DGS PLY");
    model_test_refused("element vertex 0\n" MODEL_TEST_REQUIRED,
                       "no property 'opacity'; it has: x y z f_dc_0", "fix: rename its columns of Gaussians");
    model_test_refused(
        "element vertex 0\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n",
        "no property 'f_dc_1'; it has: x y z red", "this is a point cloud");
    model_test_refused("element vertex 0\n" MODEL_TEST_REQUIRED
                       "property float opacity\nproperty float f_rest_0\n",
                       "1 properties f_rest_*, expected 0, 9, 24 or 45", "fix:");
    CHECK(oxl_model_read(test_ctx, test_path("missing.ply"), &m) != OXL_OK && !m.memory);
    CHECK_SAYS("missing.ply");
}

TEST(model_read_ignores_an_origin_that_is_no_origin)
{
    test_listen();
    OWNED_MODEL m = test_read_model(test_write(
        "m.ply", "ply\nformat ascii 1.0\ncomment origin of species\nelement vertex 0\n" MODEL_TEST_REQUIRED
                 "property float opacity\nend_header\n"));
    CHECK(m.count == 0 && m.origin[0] == 0 && m.origin[1] == 0 && m.origin[2] == 0);
    CHECK_LOGGED("origin of species");
    CHECK_LOGGED("holds no Gaussians");
    oxl_model_free(test_ctx, &m);
    m = test_read_model(test_write(
        "m.ply", "ply\nformat ascii 1.0\ncomment origin 1 2e300 3\nelement vertex 0\n" MODEL_TEST_REQUIRED
                 "property float opacity\nend_header\n"));
    CHECK(m.origin[0] == 0 && m.origin[1] == 0);
    CHECK_LOGGED("expected origin X Y Z, each within 1e+15");
}

/* ---------------- .splat */

TEST(model_splat_file_has_the_32_byte_layout_and_the_most_visible_first)
{
    /* 1 -2 3 */
    static const unsigned char wanted[32] = {0, 0, 0x80, 0x3f, 0, 0, 0, 0xc0, 0, 0, 0x40, 0x40,
                                             /* 0.5 1 2 */
                                             0, 0, 0, 0x3f, 0, 0, 0x80, 0x3f, 0, 0, 0, 0x40,
                                             /* rgba */
                                             255, 0, 128, 128,
                                             /* 0 .6 0 -.8 */
                                             128, 205, 128, 26};
    const char *path = test_path("m.splat");
    OWNED_MODEL m = test_model(3, 1);
    for (int i = 0; i < 3; i++) {
        const float mean[3] = {1, -2, 3}, rotation[4] = {0, 3, 0, -4}, sh[3] = {9, -9, 0.01f};
        m.plane[OXL_MEAN + i][1] = mean[i];
        m.plane[OXL_LOG_SCALE + i][1] = (float)((i - 1) * log(2));
        m.plane[OXL_SH + i][1] = sh[i];
        m.plane[OXL_OPACITY][i] = 0;
        for (int q = 0; q < 4; q++) m.plane[OXL_ROTATION + q][1] = rotation[q];
    }
    m.plane[OXL_LOG_SCALE][0] = -1; /* the least volume */
    m.plane[OXL_OPACITY][2] = 1;
    test_write_model(path, &m);
    OWNED_FILE file = test_file(path);
    CHECK(file.size == 96 && memcmp(file.data + 32, wanted, 32) == 0); /* row 1 is second: 2, 1, 0 */
    CHECK((unsigned char)file.data[27] == 186 && (unsigned char)file.data[64 + 27] == 128);
    CHECK((unsigned char)file.data[28] == 255); /* w = 1 */
}

TEST(model_splat_bytes_survive_reading_and_writing_at_their_ends_too)
{
    const char *path = test_path("m.splat");
    unsigned char bytes[256 * 32];
    memset(bytes, 0, sizeof bytes);
    for (int i = 0; i < 256; i++) {
        unsigned char *p = bytes + 32 * i;
        p[2] = (unsigned char)i;      /* a position */
        p[15] = p[19] = p[23] = 0x3f; /* scales of 0.5, */
        p[24] = (unsigned char)i;
        p[25] = (unsigned char)(255 - i);
        p[27] = (unsigned char)(255 - i); /* falling, so that the order is kept */
        p[28] = 255;
        p[29] = p[30] = p[31] = 128;
    }
    test_write_bytes(path, bytes, sizeof bytes);
    OWNED_MODEL m = test_read_model(path);
    CHECK(m.count == 256 && m.sh_degree == 0);
    test_write_model(path, &m);
    OWNED_FILE file = test_file(path);
    CHECK(file.size == sizeof bytes && !memcmp(file.data, bytes, sizeof bytes));
}

TEST(model_splat_of_no_rows_zero_scale_or_zero_rotation_is_repaired_and_a_cut_file_refused)
{
    unsigned char bytes[64] = {0};
    const char *path = test_path("m.splat");
    test_listen();
    memset(bytes + 28, 128, 4);
    bytes[32 + 15] = 0xbf; /* a scale of -0.5 */
    test_write_bytes(path, bytes, 64);
    oxl_model m = test_read_model(path);
    CHECK(m.count == 1);
    CHECK_LOGGED("1 of 2 Gaussians hold");
    CHECK_CLOSE(m.plane[OXL_LOG_SCALE][0], log(FLT_MIN), 1e-5);
    CHECK(m.plane[OXL_ROTATION][0] == 1 && m.plane[OXL_OPACITY][0] < -5);
    oxl_model_free(test_ctx, &m);
    test_write_bytes(path, bytes, 33);
    CHECK(oxl_model_read(test_ctx, path, &m) == OXL_ERR_INPUT && !m.memory);
    CHECK_SAYS("33 bytes, expected a multiple of 32");
}

TEST(model_read_refuses_more_lobes_than_vertices_before_any_memory_is_taken)
{
    static const char text[] =
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\n"
        "property float f_dc_0\nproperty float f_dc_1\nproperty float f_dc_2\nproperty float opacity\n"
        "property float scale_0\nproperty float scale_1\nproperty float scale_2\nproperty float rot_0\n"
        "property float rot_1\nproperty float rot_2\nproperty float rot_3\nelement dog 1000000000000\n"
        "end_header\n0 0 0 0 0 0 0 0 0 0 1 0 0 0\n";
    oxl_model m;
    CHECK_ERROR(oxl_model_read(test_ctx, test_write("m.ply", text), &m), OXL_ERR_INPUT,
                "element dog announces 1000000000000 rows for 1 vertices");
}

/* ---------------- where it is */

TEST(model_is_in_the_same_place_relative_to_another_origin)
{
    const double origin[3] = {5e5, -2, 0.25};
    OWNED_MODEL m = test_model(20, 0);
    for (size_t i = 0; i < 20; i++) m.plane[OXL_MEAN][i] = (float)i;
    m.origin[0] = 5e5 + 8, m.origin[1] = -2;
    oxl_model_move_origin(&m, origin);
    CHECK(m.plane[OXL_MEAN][3] == 11 && m.plane[OXL_MEAN + 1][3] == 0 && m.plane[OXL_MEAN + 2][19] == -0.25f);
    CHECK(memcmp(m.origin, origin, sizeof origin) == 0);
}

/* test_partition.c - blocks of a survey: homes, balance, frames, views, guards, files. */
#include "test.h"

/* A survey of n points and views x views cameras on a grid above their middle 98 %, each of which looks down
 * and sees what lies within `reach` of it. Text files alone. */
struct partition_test {
    double *p; /* (n,3) world */
    int n, views;
    double low[2], high[2], reach;
};

static double partition_test_unit(int i, int k)
{
    return random_unit(random_bits(7, (uint64_t)i, (uint64_t)k));
}

static void partition_test_centre(const struct partition_test *t, int view, double centre[2])
{
    const int at[2] = {view % t->views, view / t->views};
    for (int k = 0; k < 2; k++) centre[k] = t->low[k] + (t->high[k] - t->low[k]) * (at[k] + 0.5) / t->views;
}

static int partition_test_sees(const struct partition_test *t, int view, int point)
{
    double centre[2];
    partition_test_centre(t, view, centre);
    return fabs(t->p[3 * point] - centre[0]) < t->reach && fabs(t->p[3 * point + 1] - centre[1]) < t->reach;
}

static const char *partition_test_survey(const char *name, const struct partition_test *t)
{
    OWNED_TEXT images = test_text(), points = test_text();
    int *next = calloc((size_t)(t->views * t->views), sizeof *next);
    for (int v = 0; v < t->views * t->views; v++) {
        double c[2];
        int unmatched = v % 3; /* lists do not begin with points */
        partition_test_centre(t, v, c);
        text_add(&images, "%d 0 1 0 0 %.17g %.17g 10 1 dive/v %03d.jpg\n", 100 + 7 * v, -c[0], c[1], v);
        for (int k = 0; k < unmatched; k++) text_add(&images, "1.5 %d.25 -1 ", k);
        for (int i = 0; i < t->n; i++)
            if (partition_test_sees(t, v, i))
                text_add(&images, "%d.125 %d.5 %d ", i % 640, i % 480, 2 * i + 1);
        text_add(&images, "\n");
        next[v] = unmatched;
    }
    for (int i = 0; i < t->n; i++) {
        text_add(&points, "%d %.17g %.17g %.17g %d 9 200 0.1", 2 * i + 1, t->p[3 * i], t->p[3 * i + 1],
                 t->p[3 * i + 2], i % 256);
        for (int v = 0; v < t->views * t->views; v++)
            if (partition_test_sees(t, v, i)) text_add(&points, " %d %d", 100 + 7 * v, next[v]++);
        text_add(&points, "\n");
    }
    test_write_colmap(test_path("%s/sparse/0", name), "1 SIMPLE_RADIAL 640 480 500.5 320 240 0.01\n",
                      images.data, points.data);
    free(next);
    return test_path(name);
}

static oxl_scene *partition_test_load(const char *path)
{
    oxl_scene_options options = oxl_scene_options_default();
    options.read_images = 0;
    oxl_scene *scene = test_load(path, &options);
    return scene;
}

static struct partition partition_test_cut(const oxl_scene *scene, int block_points, oxl_cut cut)
{
    oxl_partition_options o = oxl_job_options_default(OXL_PRESET_DRAFT).partition;
    struct partition p;
    o.block_points = block_points;
    o.cut = cut;
    CHECK_OK(partition_make(test_ctx, scene, &o, &p));
    return p;
}

/* How many blocks hold a place. */
static int partition_test_homes(const struct partition *p, const double frame[3])
{
    int count = 0;
    for (int i = 0; i < p->block_count; i++) count += partition_contains(&p->block[i].box, frame);
    return count;
}

/* Points, and places on every face, edge and corner, far away too, have one owner each. */
static void partition_test_check_homes(const struct partition *p, const oxl_scene *scene)
{
    const struct colmap *c = scene_colmap(scene);
    size_t sum = 0;
    for (size_t i = 0; i < c->point_count; i++) {
        double at[3];
        partition_to_frame(p, c->point[i].position, at);
        CHECK(partition_test_homes(p, at) == 1 && partition_contains(&p->block[p->plan->owner[i]].box, at));
    }
    for (int i = 0; i < p->block_count; i++) sum += p->block[i].points;
    CHECK(sum == c->point_count);
    for (int i = 0; i < 2000; i++) {
        double at[3];
        for (int k = 0; k < 3; k++) {
            const struct partition_block *b = &p->block[(int)(partition_test_unit(i, k) * p->block_count)];
            const double face = partition_test_unit(i, 3 + k) < 0.5 ? b->box.low[k] : b->box.high[k];
            at[k] = fabs(face) <= DBL_MAX ? face : 1e30 * (partition_test_unit(i, 6 + k) - 0.5);
        }
        CHECK(partition_test_homes(p, at) == 1);
    }
}

enum { PARTITION_TEST_POINTS = 2000, PARTITION_TEST_VIEWS = 64 };

/* A reef: half of the points crowd in a corner, some at the same place, a few are absurd. flat: of its
 * height. */
static void partition_test_reef(struct partition_test *t, double *p, double flat)
{
    for (int i = 0; i < PARTITION_TEST_POINTS; i++) {
        const double crowd = i % 2 ? 1 : 0.15, sx = partition_test_unit(i, 0), sy = partition_test_unit(i, 1);
        p[3 * i] = 40 * crowd * sx;
        p[3 * i + 1] = 25 * crowd * sy;
        p[3 * i + 2] = flat * partition_test_unit(i, 2);
        if (i % 7 == 0 && i > 0) memcpy(p + 3 * i, p + 3 * i - 3, 3 * sizeof *p);
        if (i % 50 == 3) p[3 * i + 2] += 4000 * (partition_test_unit(i, 5) - 0.5);
    }
    *t =
        (struct partition_test){.p = p, .n = PARTITION_TEST_POINTS, .views = 8, .high = {40, 25}, .reach = 8};
}

static oxl_scene *partition_test_reef_scene(double flat)
{
    static double p[3 * PARTITION_TEST_POINTS];
    struct partition_test t;
    partition_test_reef(&t, p, flat);
    return partition_test_load(partition_test_survey("reef", &t));
}

TEST(partition_assigns_every_position_to_exactly_one_block)
{
    for (int flat = 0; flat < 2; flat++) {
        OWNED_SCENE *scene = partition_test_reef_scene(flat ? 2 : 30);
        for (int cut = 0; cut < 2; cut++) {
            OWNED_PARTITION p = partition_test_cut(scene, 150, (oxl_cut)cut);
            CHECK(p.block_count > 10 && p.dimensions == (flat ? 2 : 3));
            partition_test_check_homes(&p, scene);
        }
    }
}

/* Clouds that no cut can divide, or only in one direction. */
TEST(partition_of_degenerate_clouds_ends_and_leaves_no_hole)
{
    static double cloud[3 * 400];
    struct partition_test t = {
        .p = cloud, .n = 400, .views = 4, .low = {-50, -50}, .high = {50, 50}, .reach = 20};
    for (int kind = 0; kind < 4; kind++) {
        for (int i = 0; i < 400; i++)
            for (int k = 0; k < 3; k++) {
                const double line = (i - 200) * 0.2 * (k + 1) / 3, two = i % 2 ? -30 : 31;
                cloud[3 * i + k] = kind == 0   ? 7.25
                                   : kind == 1 ? line
                                   : kind == 2 ? two
                                   : i == 0    ? 1e14
                                               : k * 1e-9 * i;
            }
        OWNED_SCENE *scene = partition_test_load(partition_test_survey("degenerate", &t));
        OWNED_PARTITION p = partition_test_cut(scene, 40, OXL_CUT_BALANCED);
        CHECK(p.block_count >= 1 && p.block_count <= 40);
        if (kind == 1) CHECK(p.block_count > 4 && p.dimensions == 2);
        if (kind == 2) CHECK(p.block_count == 2);
        partition_test_check_homes(&p, scene);
    }
}

/* crowd 1: even; the larger, the fewer points at the far end of both axes. */
static oxl_scene *partition_test_crowd(double crowd)
{
    static double p[3 * PARTITION_TEST_POINTS];
    struct partition_test t = {.p = p, .n = PARTITION_TEST_POINTS, .views = 8, .high = {40, 25}, .reach = 10};
    for (int i = 0; i < 3 * PARTITION_TEST_POINTS; i++)
        p[i] = (i % 3 == 0 ? 40 : i % 3 == 1 ? 25 : 1) * pow(partition_test_unit(i / 3, i % 3), crowd);
    return partition_test_load(partition_test_survey("crowd", &t));
}

TEST(partition_cuts_at_the_share_of_the_points_within_the_middle_of_the_box)
{
    for (int crowd = 1; crowd <= 3; crowd += 2) {
        OWNED_SCENE *scene = partition_test_crowd(crowd);
        oxl_partition_options o = oxl_job_options_default(OXL_PRESET_DRAFT).partition;
        for (o.blocks = 2; o.blocks <= 7; o.blocks++) {
            const size_t share = PARTITION_TEST_POINTS / (size_t)o.blocks;
            OWNED_PARTITION p = {0};
            double low, size;
            CHECK_OK(partition_make(test_ctx, scene, &o, &p));
            CHECK(p.block_count == o.blocks);
            for (int b = 0; crowd == 1 && b < p.block_count; b++)
                CHECK(p.block[b].points >= share && p.block[b].points <= share + 2);
            low = p.plan->finite.low[0], size = p.plan->finite.high[0] - low;
            if (crowd > 1 && o.blocks == 2) /* the median is beyond 0.3 */
                CHECK_CLOSE(fabs((p.block[0].box.high[0] - low) / size - 0.5), 0.2, 1e-9);
        }
    }
}

TEST(partition_holds_the_limit_of_points_with_fewer_blocks_in_all_than_midpoints_do)
{
    int fewer = 0;
    OWNED_SCENE *scene = partition_test_crowd(2.5);
    for (int limit = 60; limit < PARTITION_TEST_POINTS; limit += limit / 3) {
        OWNED_PARTITION a = partition_test_cut(scene, limit, OXL_CUT_BALANCED),
                        b = partition_test_cut(scene, limit, OXL_CUT_MIDPOINT);
        fewer += b.block_count - a.block_count;
        CHECK(a.block_count <= b.block_count + 1);
        for (int i = 0; i < a.block_count; i++) CHECK(a.block[i].points <= (size_t)limit);
        for (int i = 0; i < b.block_count; i++) CHECK(b.block[i].points <= (size_t)limit);
    }
    CHECK(fewer > 5);
}

TEST(partition_takes_a_slab_for_2d_and_a_cube_for_3d_whatever_a_few_outliers_say)
{
    static double p[3 * 2000];
    struct partition_test t = {
        .p = p, .n = 2000, .views = 5, .low = {-20, -20}, .high = {20, 20}, .reach = 6};
    for (int cube = 0; cube < 2; cube++) {
        const double tilt = 0.3, height = cube ? 20 : 3;
        for (int i = 0; i < 2000; i++) {
            const double x = 40 * partition_test_unit(i, 0) - 20, y = 24 * partition_test_unit(i, 1) - 12,
                         /* 4 % */
                z = height * (partition_test_unit(i, 2) - 0.5), far = i % 25 == 1 ? 1e5 : 0;
            p[3 * i] = x * cos(tilt) - z * sin(tilt) + far * (partition_test_unit(i, 3) - 0.5);
            p[3 * i + 1] = y + far * (partition_test_unit(i, 4) - 0.5);
            p[3 * i + 2] = x * sin(tilt) + z * cos(tilt) + far * (partition_test_unit(i, 5) - 0.5);
        }
        OWNED_SCENE *scene = partition_test_load(partition_test_survey("box", &t));
        OWNED_PARTITION q = partition_test_cut(scene, 100, OXL_CUT_BALANCED);
        CHECK(q.dimensions == (cube ? 3 : 2));
        CHECK_CLOSE(q.extent[0], 40, 1.5);
        CHECK_CLOSE(q.extent[1], 24, 1);
        CHECK_CLOSE(q.extent[2], height, 1.5);
        CHECK_CLOSE(fabs(q.rotation[0]), cos(tilt), cube ? 0.05 : 0.01);
        CHECK_CLOSE(q.rotation[2] * q.rotation[0], sin(tilt) * cos(tilt), cube ? 0.1 : 0.02);
        CHECK(q.rotation[8] > 0); /* to the cameras */
        for (int i = 0; i < q.block_count && !cube; i++) CHECK(q.block[i].box.low[2] == -INFINITY);
    }
}

/* Counts the points of a block (-1: of all) that a view sees, by the tracks alone. */
static size_t partition_test_count(const struct partition *p, int block, int view)
{
    const struct colmap *c = scene_colmap(p->plan->scene);
    size_t count = 0;
    for (size_t k = 0; k < c->point_count; k++)
        for (uint32_t j = 0; j < c->point[k].track_count && (block < 0 || p->plan->owner[k] == block); j++)
            count += &c->image[c->track[c->point[k].first_track + j].image_row] ==
                     scene_source_image(p->plan->scene, view);
    return count;
}

TEST(partition_assigns_training_views_by_its_rules_and_test_views_never)
{
    OWNED_SCENE *scene = partition_test_reef_scene(2);
    const int views = oxl_scene_view_count(scene);
    OWNED_PARTITION p = partition_test_cut(scene, 300, OXL_CUT_BALANCED);
    int has[2] = {0};
    for (int b = 0; b < p.block_count; b++)
        for (int v = 0; v < views; v++) {
            const double all = (double)partition_test_count(&p, -1, v),
                         both = (double)partition_test_count(&p, b, v);
            const int is_base = both > 0.3 * all, is_border = both > 0.1 * (double)p.block[b].points;
            CHECK(partition_has_view(&p, b, v) ==
                  (!oxl_scene_view(scene, v)->is_test && (is_base || is_border)));
            has[0] += is_base, has[1] += is_border && !is_base;
        }
    CHECK(has[0] > 20 && has[1] > 2);
}

TEST(partition_of_a_small_survey_is_one_block_with_every_training_view)
{
    OWNED_SCENE *scene = partition_test_reef_scene(2);
    for (int limit = 0; limit <= PARTITION_TEST_POINTS; limit += PARTITION_TEST_POINTS) {
        OWNED_PARTITION p = partition_test_cut(scene, limit, OXL_CUT_BALANCED);
        int views = 0;
        for (int v = 0; v < oxl_scene_view_count(scene); v++) views += partition_has_view(&p, 0, v);
        CHECK(p.block_count == 1 && p.block[0].points == PARTITION_TEST_POINTS && views == 56);
        CHECK(p.block[0].start_points == PARTITION_TEST_POINTS);
        CHECK(p.block[0].box.low[1] == -INFINITY && p.block[0].box.high[0] == INFINITY);
    }
}

TEST(partition_does_not_depend_on_threads)
{
    OWNED_SCENE *scene = partition_test_reef_scene(30);
    test_ctx->threads = 1;
    OWNED_PARTITION p = partition_test_cut(scene, 150, OXL_CUT_BALANCED);
    test_ctx->threads = 3;
    OWNED_PARTITION q = partition_test_cut(scene, 150, OXL_CUT_BALANCED);
    CHECK(q.block_count == p.block_count && p.block_count > 1);
    CHECK(memcmp(q.rotation, p.rotation, sizeof p.rotation) == 0);
    for (int b = 0; b < p.block_count; b++) CHECK(memcmp(&q.block[b], &p.block[b], sizeof *p.block) == 0);
}

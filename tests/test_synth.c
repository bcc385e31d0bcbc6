/* test_synth.c - the synthetic survey is what it says it is: poses, points, tracks, depth and water agree
 * with each other. */
#include "test.h"
#include "../cli/synth_options.c"
#include "../lab/synth.c"
#include "../lab/synth_export.c"
#include "../lab/synth_light.c"
#include "../lab/synth_trajectory.c"
#include "../lab/synth_points.c"
#include "../lab/synth_shade.c"
#include "../lab/synth_world.c"

synth_options synth_test_options(const char *name)
{
    synth_options o = synth_options_default();
    o.out = test_path(name);
    o.views = 6;
    o.width = 96;
    o.height = 64;
    return o;
}

/* Makes the survey and reads its text files back as any reader would; NULL: does not read them. */
void synth_test_make(const synth_options *o, struct colmap *survey)
{
    CHECK_OK(synth_run(test_ctx, o));
    if (survey) CHECK_OK(colmap_read_folder(PATH(o->out, "sparse/0"), survey));
}

/* A survey as its text files have it: the model, its keypoints, the list of its outliers. */
struct synth_test_read {
    struct colmap survey;
    struct colmap_observed seen;
    struct os_file_map outliers;
};

static struct synth_test_read synth_test_read(const synth_options *o)
{
    struct synth_test_read r;
    synth_test_make(o, &r.survey);
    r.seen = colmap_observe(PATH(o->out, "sparse/0"), &r.survey);
    r.outliers = test_file(PATH(o->out, "truth/outliers.txt"));
    return r;
}

static void synth_test_release(struct synth_test_read *r)
{
    os_release_file(test_ctx, &r->outliers);
    colmap_observed_free(&r->seen);
    colmap_free(test_ctx, &r->survey);
}
#define OWNED_READ __attribute__((cleanup(synth_test_release))) struct synth_test_read

static void synth_test_to_camera(const struct colmap_image *image, const double p[3], double out[3])
{
    const double *q = image->rotation;
    const v3 v = {q[1], q[2], q[3]}, x = {p[0], p[1], p[2]}, once = v3_cross(v, x), twice = v3_cross(v, once);
    const v3 y = v3_along(v3_along(x, once, 2 * q[0]), twice, 2);
    out[0] = y.x + image->translation[0];
    out[1] = y.y + image->translation[1];
    out[2] = y.z + image->translation[2];
}

/* Where a point should be seen, minus where it was; *z gets its depth. */
static void synth_test_residual(const struct synth_test_read *s, const struct colmap_point *p,
                                const struct colmap_track *t, double out[2], double *z)
{
    const struct colmap_observation *at = &s->seen.at[s->seen.first[t->image_row] + t->observation];
    const double *k = s->survey.camera[0].parameter;
    double q[3];
    CHECK(t->observation < colmap_observed_count(&s->seen, t->image_row));
    synth_test_to_camera(&s->survey.image[t->image_row], p->position, q);
    out[0] = k[0] * q[0] / q[2] + k[2] - at->x;
    out[1] = k[1] * q[1] / q[2] + k[3] - at->y;
    *z = q[2];
}

static int synth_test_is_outlier(const struct synth_test_read *s, int64_t id)
{
    char line[40];
    snprintf(line, sizeof line, "\n%lld\n", (long long)id);
    return strstr(s->outliers.data, line) != NULL;
}

TEST(synth_tracks_and_observations_name_each_other_both_ways_hundreds_in_a_view_three_of_most_points)
{
    const synth_options o = synth_test_options("survey");
    OWNED_READ s = synth_test_read(&o);
    size_t named = 0, three = 0;
    CHECK(s.survey.image_count == 6 && s.survey.camera_count == 1 && s.survey.point_count > 6 * 350);
    for (size_t i = 0; i < s.survey.point_count; i++) {
        const struct colmap_point *p = &s.survey.point[i];
        CHECK(p->track_count >= 2);
        three += p->track_count >= 3;
        for (uint32_t k = 0; k < p->track_count; k++) {
            const struct colmap_track *t = &s.survey.track[p->first_track + k];
            CHECK(t->observation < colmap_observed_count(&s.seen, t->image_row));
            CHECK(s.seen.at[s.seen.first[t->image_row] + t->observation].point == p->id);
        }
    }
    CHECK(three > s.survey.point_count * 8 / 10);
    for (size_t i = 0; i < s.survey.image_count; i++) CHECK(colmap_observed_count(&s.seen, i) >= 300);
    for (size_t i = 0; i < s.seen.first[s.survey.image_count]; i++) named += s.seen.at[i].point >= 0;
    CHECK(named == s.survey.track_count);
    /* keypoints without a point stand between them */
    CHECK(s.seen.first[s.survey.image_count] > named + named / 5);
}

TEST(synth_quaternions_turn_as_their_matrices_whichever_component_is_largest)
{
    static const double quaternion[][4] = {
        {0.9, 0.3, -0.2, 0.24}, {0.1, 0.9, 0.4, -0.1}, {0.2, -0.1, 0.95, 0.2}, {0.05, 0.3, 0.1, 0.94}};
    for (size_t i = 0; i < OXL_COUNT(quaternion); i++) {
        struct colmap_image image = {.rotation = {0}};
        double matrix[9], q[4], length = 0;
        for (int k = 0; k < 4; k++) length += quaternion[i][k] * quaternion[i][k];
        for (int k = 0; k < 4; k++) image.rotation[k] = quaternion[i][k] / sqrt(length);
        for (int k = 0; k < 3; k++) {
            double unit[3] = {k == 0, k == 1, k == 2}, column[3];
            synth_test_to_camera(&image, unit, column);
            for (int j = 0; j < 3; j++) matrix[3 * j + k] = column[j];
        }
        export_quaternion(matrix, q);
        for (int k = 0; k < 4; k++) CHECK_CLOSE(q[k], image.rotation[k], 1e-14);
    }
}

/* Also far from the origin, where floats would be off by decimetres. */
static void synth_test_reprojection(const synth_options *o)
{
    OWNED_READ s = synth_test_read(o);
    double square = 0;
    size_t count = 0, outliers = 0;
    for (size_t i = 0; i < s.survey.point_count; i++) {
        const struct colmap_point *p = &s.survey.point[i];
        const int odd = synth_test_is_outlier(&s, p->id);
        double mean = 0;
        outliers += (size_t)odd;
        for (uint32_t k = 0; k < p->track_count; k++) {
            double r[2], z;
            synth_test_residual(&s, p, &s.survey.track[p->first_track + k], r, &z);
            mean += hypot(r[0], r[1]) / p->track_count;
            CHECK(hypot(r[0], r[1]) < (odd ? 9 : 1.8));
            if (!odd) square += r[0] * r[0] + r[1] * r[1], count += 2;
        }
        CHECK_CLOSE(mean, p->error, 1e-3);
    }
    CHECK_CLOSE(sqrt(square / (double)count), 0.3, 0.01);
    CHECK(outliers > 0 && outliers < s.survey.point_count / 40);
}

TEST(synth_points_reproject_onto_their_observations_within_the_stated_noise)
{
    synth_options o = synth_test_options("survey");
    synth_test_reprojection(&o);
    o = synth_test_options("survey far off");
    o.origin[0] = 431500;
    o.origin[1] = 4581200;
    o.origin[2] = -32;
    o.write_images = 0;
    synth_test_reprojection(&o);
    CHECK(!os_is_folder(test_path("survey far off/images")));
}

/* (H,W) depths of a view, rows from the top; free() it. */
static float *synth_test_depth(const synth_options *o, const char *name)
{
    const size_t count = (size_t)o->width * o->height;
    float *depth = malloc(count * sizeof *depth);
    char header[64];
    OWNED_FILE map = test_file(test_path("%s/truth/depth/%.9s.pfm", o->out, name));
    snprintf(header, sizeof header, "Pf\n%d %d\n-1.0\n", o->width, o->height);
    CHECK(map.size == strlen(header) + 4 * count && memcmp(map.data, header, strlen(header)) == 0);
    for (size_t i = 0; i < count; i++) {
        const size_t row = i / (size_t)o->width,
                     at = ((size_t)o->height - 1 - row) * (size_t)o->width + i % (size_t)o->width;
        depth[at] = bytes_float((const char *)map.data + strlen(header) + 4 * i);
    }
    return depth;
}

TEST(synth_points_lie_where_the_depth_maps_say)
{
    const synth_options o = synth_test_options("survey");
    OWNED_READ s = synth_test_read(&o);
    size_t checked = 0, near = 0;
    for (size_t v = 0; v < s.survey.image_count; v++) {
        float *depth = synth_test_depth(&o, s.survey.names + s.survey.image[v].name);
        for (size_t i = 0; i < s.survey.point_count; i++)
            for (uint32_t k = 0; k < s.survey.point[i].track_count; k++) {
                const struct colmap_track *t = &s.survey.track[s.survey.point[i].first_track + k];
                const struct colmap_observation *at = &s.seen.at[s.seen.first[v] + t->observation];
                double r[2], z = 0;
                if (t->image_row != v || synth_test_is_outlier(&s, s.survey.point[i].id)) continue;
                synth_test_residual(&s, &s.survey.point[i], t, r, &z);
                checked++;
                near += fabs(z - depth[(size_t)at->y * (size_t)o.width + (size_t)at->x]) < 0.03 * z;
            }
        free(depth);
    }
    CHECK(checked > 5000);
    CHECK(near > checked * 95 / 100); /* the others stand beside a step: a pixel is 3 cm wide here */
}

static void synth_test_water_text(const char *survey, const char *name, double out[3])
{
    char *text = output_read(survey, "truth/water.txt");
    const char *at = text ? strstr(text, name) : NULL;
    CHECK(at && sscanf(at + strlen(name), "%lf %lf %lf", &out[0], &out[1], &out[2]) == 3);
    free(text);
}

/* The formula again, from the files alone. */
TEST(synth_images_are_clean_pictures_behind_the_stated_water_within_noise)
{
    synth_options o = synth_test_options("survey");
    OWNED_COLMAP survey = {0};
    double direct[3] = {0}, scatter[3] = {0}, veil[3] = {0}, square = 0, sum = 0;
    size_t count = 0;
    o.water = SYNTH_5C;
    synth_test_make(&o, &survey);
    synth_test_water_text(o.out, "\nbD ", direct);
    synth_test_water_text(o.out, "\nbB ", scatter);
    synth_test_water_text(o.out, "\nBinf ", veil);
    for (size_t v = 0; v < survey.image_count; v++) {
        const char *name = survey.names + survey.image[v].name;
        const double *k = survey.camera[0].parameter;
        float *depth = synth_test_depth(&o, name);
        OWNED_IMAGE image = test_read_image(test_path("%s/images/%s", o.out, name));
        OWNED_IMAGE clean = test_read_image(test_path("%s/truth/clean/%s", o.out, name));
        CHECK(image.width == 96 && image.height == 64 && clean.width == 96 && clean.height == 64);
        for (int i = 0; i < 96 * 64; i++) {
            const double x = (i % 96 + 0.5 - k[2]) / k[0], y = (i / 96 + 0.5 - k[3]) / k[1],
                         z = depth[i] * sqrt(1 + x * x + y * y);
            CHECK(depth[i] > 0.5 && depth[i] < 6);
            for (int c = 0; c < 3; c++) {
                const double wanted =
                    clean.rgb[c * 96 * 64 + i] * exp(-direct[c] * z) + veil[c] * (1 - exp(-scatter[c] * z));
                const double off = 255 * (image.rgb[c * 96 * 64 + i] - wanted);
                CHECK(fabs(off) < 6 * o.noise + 1);
                square += off * off;
                sum += off;
                count++;
            }
        }
        free(depth);
    }
    CHECK_CLOSE(sum / (double)count, 0, 0.05);
    /* both images are rounded: 1/12 each, at most */
    CHECK_CLOSE(sqrt(square / (double)count), sqrt(o.noise * o.noise + 2 / 12.), 0.1);
}

static int synth_test_same_files(const char *a, const char *b, const char *name)
{
    OWNED_FILE x = {0}, y = {0};
    return os_read_file(test_ctx, PATH(a, "%s", name), &x) == OXL_OK &&
           os_read_file(test_ctx, PATH(b, "%s", name), &y) == OXL_OK && x.size > 0 && x.size == y.size &&
           memcmp(x.data, y.data, x.size) == 0;
}

TEST(synth_writes_the_same_bytes_with_one_and_three_threads_and_others_with_another_seed)
{
    static const char *const files[] = {"sparse/0/cameras.txt",      "sparse/0/images.txt",
                                        "sparse/0/points3D.txt",     "truth/outliers.txt",
                                        "truth/depth/IMG_00004.pfm", "images/IMG_00004.png",
                                        "truth/model.txt",           "truth/clean/IMG_00004.png"};
    const char *out[3];
    for (int k = 0; k < 3; k++) {
        synth_options o = synth_test_options((const char *[]){"one", "three", "other"}[k]);
        o.threads = k == 1 ? 3 : 1, o.seed = k == 2 ? 2 : 1;
        o.path = SYNTH_ORBIT, o.views = 5, o.extent = 4;
        synth_test_make(&o, NULL);
        out[k] = o.out;
    }
    for (size_t i = 0; i < OXL_COUNT(files); i++) {
        CHECK(synth_test_same_files(out[0], out[1], files[i]));
        CHECK(i == 0 || !synth_test_same_files(out[0], out[2], files[i]));
    }
}

TEST(synth_refuses_invalid_options_and_to_replace_what_is_not_its_own)
{
    static const char *const others[] = {"dive/sparse/0/images.txt", "photos/images/a.png",
                                         "a/transforms.json", "b/cameras.bin", "c/truth/points.txt"};
    synth_options o = synth_test_options("survey");
    o.backscatter = 0.5;
    CHECK_ERROR(synth_run(test_ctx, &o), OXL_ERR_USAGE, "--lamp 1");
    o.backscatter = 0, o.origin[1] = 9e6;
    CHECK(synth_run(test_ctx, &o) == OXL_ERR_USAGE && !os_is_folder(test_path("survey")));
    test_write("in the way", "a file where a folder should be");
    o = synth_test_options("in the way");
    CHECK(synth_run(test_ctx, &o) == OXL_ERR_IO);
    o = synth_test_options("a");
    o.views = 4, o.points = 50, o.width = o.height = 32;
    CHECK_OK(synth_run(test_ctx, &o));
    CHECK_OK(synth_run(test_ctx, &o)); /* its own */
    for (size_t i = 0; i < OXL_COUNT(others); i++) {
        char name[40];
        snprintf(name, sizeof name, "%.*s", (int)strcspn(others[i], "/"), others[i]);
        test_write(others[i], "somebody's own");
        o.out = test_path(name);
        CHECK_ERROR(synth_run(test_ctx, &o), OXL_ERR_USAGE, "and synth did not write it");
        char *kept = output_read(test_folder(), others[i]);
        CHECK(kept && !strcmp(kept, "somebody's own"));
        free(kept);
    }
}

TEST(synth_in_the_place_of_a_larger_survey_leaves_none_of_its_images)
{
    synth_options o = synth_test_options("a");
    o.views = 5, o.points = 50, o.width = o.height = 32;
    CHECK_OK(synth_run(test_ctx, &o));
    o.views = 3;
    CHECK_OK(synth_run(test_ctx, &o));
    CHECK(test_has("a/images/IMG_00002.png") && !test_has("a/images/IMG_00003.png"));
    o.write_images = 0; /* its poses are others': so are the images */
    CHECK_OK(synth_run(test_ctx, &o));
    CHECK(!test_has("a/images/IMG_00002.png"));
}

static int synth_test_stop(void *user, const char *what, long done, long total)
{
    (void)total;
    return strcmp(what, user) == 0 && done >= 2;
}

TEST(synth_stops_when_asked_and_leaves_no_text_files_behind)
{
    synth_options o = synth_test_options("survey");
    o.progress = synth_test_stop;
    o.user = "images";
    CHECK(synth_run(test_ctx, &o) == OXL_ERR_INTERRUPTED);
    test_write("survey/sparse/0/images.txt", "of an earlier run");
    CHECK(synth_run(test_ctx, &o) == OXL_ERR_INTERRUPTED && test_has("survey/images/IMG_00001.png"));
    CHECK(!test_has("survey/images/IMG_00002.png") && !test_has("survey/sparse/0/images.txt"));
}

TEST(synth_numbers_are_written_as_meant)
{
    static const double value[] = {0, -0.0004, -1.5, 0.9996, 12.3456, 4581200.125};
    struct output t = {0};
    for (size_t i = 0; i < OXL_COUNT(value); i++) output_add(&t, "%.3f ", value[i]);
    output_add(&t, "%d%.1f|%05d|%s|%zu %%|%.15f|%S|%llu", 0, NAN, 12, "cut", (size_t)7, 0.125, "<&'",
               18446744073709551615ull);
    CHECK(!strcmp(t.data, "0.000 0.000 -1.500 1.000 12.346 4581200.125 0|00012|cut|7 %|0.125000000000000|"
                          "&lt;&amp;&#39;|18446744073709551615"));
    free(t.data);
}

TEST(lint_flags_images_that_are_blurred_or_badly_exposed_beside_their_neighbours)
{
    synth_options o = synth_options_default();
    oxl_survey s;
    char out[512], *const names[] = {"IMG_00007.png", "IMG_00014.png", "IMG_00021.png"};
    o.views = 30, o.width = 120, o.height = 80, o.points = 900, o.water = SYNTH_AIR;
    snprintf(out, sizeof out, "%s", test_path("synth"));
    o.out = out;
    CHECK(synth_run(test_ctx, &o) == OXL_OK);
    test_listen();
    CHECK_OK(oxl_check(test_ctx, out, NULL, 1, &s));
    CHECK(s.blurred == 0 && s.badly_exposed == 0 && test_said.warning[0] == 0);
    for (int k = 0; k < 3; k++) { /* blurred along x, darker, brighter */
        char name[80];
        const size_t n = 120 * 80;
        snprintf(name, sizeof name, "synth/images/%s", names[k]);
        OWNED_IMAGE image = test_read_image(name);
        OWNED_IMAGE soft = test_image(120, 80);
        for (size_t i = 0; i < 3 * n; i++) {
            float sum = 0;
            for (int d = 0; d < 7; d++) sum += image.rgb[OXL_MIN(i + (size_t)d - OXL_MIN(i, 3), 3 * n - 1)];
            soft.rgb[i] = k == 0 ? sum / 7 : image.rgb[i] * (k == 1 ? 0.4f : 1.7f);
        }
        test_write_image(name, &soft);
    }
    CHECK_OK(oxl_check(test_ctx, out, NULL, 1, &s));
    CHECK(s.blurred == 1 && s.badly_exposed == 2);
    CHECK_WARNED("1 image is less sharp than the images beside it: IMG_00007.png");
    CHECK_WARNED("1 image is much darker than the images beside it: IMG_00014.png");
    CHECK_WARNED("1 image is much brighter than the images beside it: IMG_00021.png");
    test_listen();
    CHECK_OK(oxl_check(test_ctx, out, NULL, 0, &s)); /* headers alone */
    CHECK(s.blurred == 0 && test_said.warning[0] == 0);
}

/* ---------------- poses */

TEST(synth_pose_noise_turns_and_moves_the_exported_poses_alone)
{
    synth_options o = synth_test_options("exact");
    OWNED_COLMAP exact = {0}, noisy = {0};
    double turn = 0, move = 0;
    char rows[2000];
    int found = 0;
    o.write_images = 0, o.views = 30;
    synth_test_make(&o, &exact);
    o = synth_test_options("noisy");
    o.write_images = 0, o.views = 30, o.pose_noise = 0.2;
    synth_test_make(&o, &noisy);
    CHECK(noisy.image_count == 30 && exact.image_count == 30 && noisy.point_count == exact.point_count);
    for (size_t i = 0; i < 30; i++) {
        const struct colmap_image *a = &exact.image[i], *b = &noisy.image[i];
        oxl_camera from = {0}, to = {0};
        double centre[2][3], cosine = 0;
        for (int k = 0; k < 4; k++) cosine += a->rotation[k] * b->rotation[k];
        turn += 4 * (1 - cosine * cosine) / 30;
        camera_rotation_from_quaternion(a->rotation, from.rotation);
        camera_rotation_from_quaternion(b->rotation, to.rotation);
        memcpy(from.translation, a->translation, sizeof from.translation);
        memcpy(to.translation, b->translation, sizeof to.translation);
        camera_position(&from, centre[0]);
        camera_position(&to, centre[1]);
        for (int k = 0; k < 3; k++) move += pow(centre[1][k] - centre[0][k], 2) / 30;
    }
    CHECK_CLOSE(sqrt(turn) * 57.29578, 0.2, 0.04);
    CHECK(sqrt(move) > 0.002 && sqrt(move) < 0.02); /* 0.2 % of some metres */
    OWNED_FILE truth = test_file(test_path("%s/truth/poses.txt", o.out));
    snprintf(rows, sizeof rows, " %.9f %.9f %.9f", exact.image[0].translation[0],
             exact.image[0].translation[1], exact.image[0].translation[2]);
    for (size_t i = 0; i + strlen(rows) < truth.size && !found; i++)
        found = memcmp((const char *)truth.data + i, rows, strlen(rows)) == 0;
    CHECK(found);
}

/* ---------------- layouts of published scenes */

/* Trains a little and returns the PSNR of the held-out views; scene: the survey. */
static double synth_test_train(const char *path, oxl_scene **scene)
{
    oxl_train_options options = oxl_train_options_default(OXL_PRESET_DRAFT);
    oxl_trained trained;
    options.iterations = 40, options.stereo = 0; /* The medium is found by tracks, which NeRF has not. */
    *scene = test_load(path, NULL);
    CHECK_OK(oxl_train(test_ctx, *scene, &options, NULL, &trained));
    double psnr = test_evaluate(&trained.model, *scene, trained.imaging, OXL_SPLIT_TEST).psnr;
    oxl_trained_free(test_ctx, &trained);
    return psnr;
}

static void synth_test_same_poses(const oxl_scene *a, const oxl_scene *b)
{
    CHECK(oxl_scene_view_count(a) == oxl_scene_view_count(b) && a->stats.test_views == b->stats.test_views);
    for (int i = 0; i < oxl_scene_view_count(a); i++)
        for (int j = 0; j < oxl_scene_view_count(b); j++) {
            const oxl_view *x = oxl_scene_view(a, i), *y = oxl_scene_view(b, j);
            double p[3], q[3];
            if (strcmp(path_base_name(x->name), path_base_name(y->name)) != 0) continue;
            CHECK(x->is_test == y->is_test && x->camera.width == y->camera.width);
            CHECK_CLOSE(x->camera.fx, y->camera.fx, 1e-6);
            camera_position(&x->camera, p), camera_position(&y->camera, q);
            for (int k = 0; k < 3; k++) CHECK_CLOSE(p[k] + a->origin[k], q[k] + b->origin[k], 1e-6);
            for (int k = 0; k < 9; k++) CHECK_CLOSE(x->camera.rotation[k], y->camera.rotation[k], 1e-6);
        }
}

TEST(synth_layouts_of_nerf_and_llff_are_read_and_trained_as_that_of_colmap)
{
    NEEDS_PART(antialias); /* Without one of the two, rounding of the poses grows to 0.08 dB. */
    NEEDS_PART(sh_degree);
    synth_options o = synth_test_options("llff");
    OWNED_SCENE *colmap, *nerf;
    o.views = 9, o.layout = SYNTH_LLFF, o.points = 500, o.water = SYNTH_AIR;
    CHECK_OK(synth_run(test_ctx, &o));
    o.out = test_path("nerf"), o.layout = SYNTH_NERF;
    CHECK_OK(synth_run(test_ctx, &o));
    CHECK(os_is_file(test_path("nerf/test/IMG_00008.png")) && !os_is_folder(test_path("nerf/sparse")));
    OWNED_SCENE *llff = test_load("llff", NULL);
    CHECK(llff->stats.mean_track > 1 && scene_depth_range(llff, 0));
    os_rename(test_path("llff/sparse"), test_path("llff/other"));
    OWNED_SCENE *bare = test_load("llff", NULL);
    CHECK(bare->stats.points == 0);
    os_rename(test_path("llff/other"), test_path("llff/sparse"));
    os_remove(test_path("llff/poses_bounds.npy"));
    double psnr = synth_test_train(test_path("llff"), &colmap);
    CHECK(scene_depth_range(colmap, 0) == NULL);
    CHECK_CLOSE(synth_test_train(test_path("nerf"), &nerf), psnr, 0.05);
    synth_test_same_poses(colmap, llff);
    synth_test_same_poses(colmap, bare);
    synth_test_same_poses(colmap, nerf);
}

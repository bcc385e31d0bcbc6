/* test_underwater.c - exposure, lamp and medium: gradients, gauge, what is written and read; a run recovers
 * values that are known. */
#include "test.h"

/* ---------------- gains by hand */

struct oxl_imaging imaging_test_make(int views, const int *known, int count)
{
    struct oxl_imaging m;
    CHECK_OK(imaging_create(test_ctx, views, &m));
    m.on = 1;
    for (int k = 0; k < count; k++) {
        m.known[known[k]] = 1;
        for (int c = 0; c < 3; c++) m.log_gain[3 * known[k] + c] = 0.1f * (float)known[k] + 0.01f * (float)c;
    }
    return m;
}

static const struct medium imaging_test_murky = {
    1, {0.10f, 0.05f, 0.03f}, {0.12f, 0.08f, 0.06f}, {0.1f, 0.3f, 0.5f}, 0};

struct lamp lamp_of(int view)
{
    struct lamp lamp = {.view = view};
    for (int t = 0; t < LAMP_TERMS; t++) lamp.shape[t] = 0.15f * (float)sin(1.7 * t + 1);
    return lamp;
}

TEST(exposure_of_a_view_that_was_not_trained_lies_on_the_line_between_its_neighbours)
{
    OWNED_IMAGING m = imaging_test_make(9, (int[]){2, 6}, 2);
    float gain[3];
    oxl_imaging_gain(&m, 3, gain);
    CHECK_CLOSE(gain[1], exp(0.31), 1e-5);
    oxl_imaging_gain(&m, 0, gain);
    CHECK_CLOSE(gain[0], exp(0.2), 1e-5);
    oxl_imaging_gain(&m, 8, gain);
    CHECK_CLOSE(gain[2], exp(0.62), 1e-5);
    for (int k = 0; k < 2; k++) {
        oxl_imaging_gain(&m, k ? 9 : INT_MIN / 4, gain); /* no such view */
        CHECK(gain[0] == 1 && gain[1] == 1 && gain[2] == 1);
    }
}

TEST(exposure_of_a_stereo_pair_is_interpolated_for_each_camera_on_its_own)
{
    const double wanted[] = {0.4, 0.2}; /* between the left images 2 and 6; between 3 and 5, lowered by 0.2 */
    for (int k = 0; k < 2; k++) {
        OWNED_SCENE *scene = k ? train_scene(8) : train_scene_of_pairs(8, NULL, NULL);
        OWNED_IMAGING m = imaging_test_make(8, (int[]){1, 2, 3, 5, 6, 7}, 6);
        float between[3];
        for (int v = 1; v < 8; v += 2) m.log_gain[3 * v] -= k == 0 ? 1 : 0.2f;
        CHECK_OK(imaging_set_cameras(test_ctx, scene, &m));
        imaging_interpolate(&m, 4, between);
        CHECK_CLOSE(between[0], wanted[k], 1e-6);
        CHECK((m.camera[0] == m.camera[2]) && (m.camera[0] == m.camera[1]) == (k == 1));
    }
}

TEST(exposure_of_two_blocks_is_their_mean_where_they_share_views)
{
    OWNED_IMAGING a = imaging_test_make(9, (int[]){0, 2, 4}, 3),
                  b = imaging_test_make(9, (int[]){2, 4, 8}, 3), all = {0};
    int count[9] = {0};
    const float of_a = a.log_gain[3 * 2], of_b = b.log_gain[3 * 8 + 2];
    CHECK_OK(imaging_create(test_ctx, 9, &all));
    for (int i = 0; i < 27; i++) b.log_gain[i] += b.known[i / 3] ? 0.7f : 0;
    job_add_imaging(&all, count, &a);
    job_add_imaging(&all, count, &b);
    CHECK_CLOSE(all.log_gain[3 * 8 + 2], of_b + 0.7, 1e-5);
    CHECK_CLOSE(all.log_gain[3 * 2 + 0], of_a + 0.35, 1e-5);
    CHECK(count[0] == 1 && count[2] == 2 && count[1] == 0 && !all.known[1]);
}

TEST(model_colours_scale_by_a_factor_for_each_channel)
{
    const oxl_point point = {.position = {0, 0, 4}, .rgb = {100, 150, 200}};
    const double half[3] = {0.5, 1, 2};
    OWNED_MODEL model = test_model_of(&point, 1, 1);
    model_scale_colour(&model, half);
    CHECK_CLOSE(0.5 + MODEL_SH0 * model.plane[OXL_SH][0], 50 / 255., 1e-5);
    CHECK_CLOSE(0.5 + MODEL_SH0 * model.plane[OXL_SH + 1][0], 150 / 255., 1e-5);
    CHECK_CLOSE(0.5 + MODEL_SH0 * model.plane[OXL_SH + 2][0], 400 / 255., 1e-5);
}

/* ---------------- the gradient */

/* L1 + SSIM of a rendered view times its gains, against its image. */
static struct renderer_loss exposure_loss(struct renderer *r, oxl_scene *scene, const oxl_model *model,
                                          const double log_gain[3])
{
    struct renderer_loss loss;
    OWNED_IMAGE image;
    float gain[3];
    for (int c = 0; c < 3; c++) gain[c] = (float)exp(log_gain[c]);
    CHECK_OK(oxl_scene_image(test_ctx, scene, 1, NULL, &image));
    test_draw(r, model, &oxl_scene_view(scene, 1)->camera);
    renderer_settings(r)->gain = gain;
    CHECK_OK(renderer_loss(test_ctx, r, image.rgb, NULL, 0.2f, &loss));
    renderer_complete_loss(r, &loss);
    return loss;
}

TEST(exposure_gradient_agrees_with_finite_differences)
{
    OWNED_SCENE *scene = train_scene(3);
    OWNED_RENDERER *r = test_renderer();
    OWNED_MODEL model = test_points(scene, 0);
    for (int k = -1; k <= 1; k++)
        for (int c = 0; c < 3; c++) {
            const double h = 1e-3;
            double at[3] = {0.5 * k, 0.3 * k, -0.4 * k}, plus, minus;
            double here = exposure_loss(r, scene, &model, at).dlog_gain[c];
            at[c] += h, plus = exposure_loss(r, scene, &model, at).total;
            at[c] -= 2 * h, minus = exposure_loss(r, scene, &model, at).total;
            CHECK_CLOSE(here, (plus - minus) / (2 * h), 1e-4 + 5e-3 * fabs(here));
        }
}

/* ---------------- runs */

/* Each image brighter or darker by up to a third, in a wave along the views. */
static void exposure_test_wave(const void *amplitude, const oxl_scene *scene, int view, oxl_image *image)
{
    (void)scene;
    for (int i = 0; i < 3 * image->width * image->height; i++)
        image->rgb[i] =
            OXL_MIN(1.0f, image->rgb[i] * (float)exp(*(const float *)amplitude * sin(0.4 * view)));
}

static oxl_scene *exposure_scene(int views, float amplitude)
{
    return train_scene_changed(views, NULL, exposure_test_wave, &amplitude);
}

/* How much larger the PSNR of the held-out views is with a part of training, of the options, than without; the
 * imaging is that of the run with it. */
static double imaging_test_helps(oxl_scene *scene, const oxl_train_options *options, oxl_switch *part)
{
    double psnr[2];
    for (int on = 0; on < 2; on++) {
        *part = on ? OXL_ON : OXL_OFF;
        OWNED_MODEL model = test_trained(scene, options);
        psnr[on] = train_psnr(scene, &model);
    }
    return psnr[1] - psnr[0];
}

TEST(exposure_of_known_gains_is_recovered_and_helps_views_that_were_held_out)
{
    NEEDS_PART(exposure);
    OWNED_SCENE *scene = exposure_scene(14, 0.2f);
    oxl_train_options options = train_options(600);
    const struct oxl_imaging *m = &test_imaging;
    double sum = 0, error = 0, square = 0;
    int n = 0;
    CHECK(imaging_test_helps(scene, &options, &options.exposure) > 0.5);
    for (int c = 0; c < 3; c++) CHECK_CLOSE(imaging_mean(m, c), 0, 1e-6);
    for (int v = 0; v < 14; v++)
        if (m->known[v]) sum += 0.2 * sin(0.4 * v), n++;
    for (int v = 0; v < 14; v++) {
        const double truth = 0.2 * sin(0.4 * v) - sum / n;
        if (!m->known[v]) continue;
        square += truth * truth;
        error += (m->log_gain[3 * v + 1] - truth) * (m->log_gain[3 * v + 1] - truth);
    }
    CHECK(error < 0.1 * square);
}

TEST(exposure_auto_is_off_where_all_images_are_alike_and_then_changes_nothing)
{
    OWNED_SCENE *scene = train_scene(14);
    oxl_train_options options = train_options(1000);
    options.exposure = OXL_OFF;
    OWNED_MODEL off = test_trained(scene, &options);
    options.exposure = OXL_AUTO;
    OWNED_MODEL automatic = test_trained(scene, &options);
    CHECK(!test_imaging.on && test_same_model(&off, &automatic));
}

/* Both cameras jump together, or only the right ones do. */
TEST(exposure_of_a_stereo_pair_follows_the_other_camera_as_far_as_known_views_do)
{
    OWNED_SCENE *scene = train_scene_of_pairs(10, NULL, NULL);
    for (int together = 0; together < 2; together++) {
        OWNED_IMAGING m = imaging_test_make(10, NULL, 0);
        float gain[3];
        for (int v = 0; v < 10; v++) {
            m.known[v] = v != 4;
            for (int c = 0; c < 3; c++) m.log_gain[3 * v + c] = v / 2 % 2 && (together || v % 2) ? 0.3f : 0;
        }
        CHECK_OK(imaging_set_cameras(test_ctx, scene, &m));
        CHECK(m.partner[4] == 5 && m.partner[5] == 4);
        imaging_predict(&m, 4, gain);
        CHECK_CLOSE(gain[0], 0, 0.02); /* the left neighbours' line is at 0.3, or at 0 */
    }
}

TEST(exposure_a_run_that_is_stopped_ends_in_the_same_bytes)
{
    NEEDS_PART(exposure);
    OWNED_CHECKPOINT_CASE c = checkpoint_of(exposure_scene(14, 0.3f), train_options(1000));
    c.options.exposure = OXL_ON;
    checkpoint_check_stops(&c, (const int[]){5, 99, 100, 101, 320, 0});
    CHECK(test_imaging.on);
}

/* ---------------- the file */

static struct oxl_imaging imaging_test_reread(const oxl_scene *scene, const struct oxl_imaging *m)
{
    struct oxl_imaging read;
    CHECK_OK(oxl_imaging_write(test_ctx, test_path("imaging.txt"), scene, m));
    CHECK_OK(imaging_read(test_ctx, test_path("imaging.txt"), scene, &read));
    return read;
}

TEST(gains_medium_and_lamp_are_read_as_they_were_written)
{
    OWNED_SCENE *scene = train_scene(7);
    for (int on = 0; on < 2; on++) {
        OWNED_IMAGING m = imaging_test_make(7, (int[]){1, 3, 5}, 3 * on), read = {0};
        m.on = on, m.medium = imaging_test_murky, m.lamps = 1, m.lamp[0] = lamp_of(-1);
        read = imaging_test_reread(scene, &m);
        CHECK(read.on == on && !read.known[0] && read.known[3] == on);
        for (int i = 0; i < 21; i++) CHECK_CLOSE(read.log_gain[i], m.log_gain[i], 1e-6);
        CHECK(!memcmp(&read.medium, &m.medium, sizeof m.medium) && read.lamps == 1);
        CHECK(!memcmp(read.lamp, m.lamp, sizeof *m.lamp) && imaging_lamp(&read, scene, 0) == read.lamp);
    }
}

TEST(imaging_and_results_of_another_scene_or_without_gaussians_are_not_written)
{
    OWNED_SCENE *scene = train_scene(3);
    OWNED_IMAGING other = imaging_test_make(4000, (int[]){3000, 3999}, 2);
    OWNED_MODEL model = test_model(2, 0);
    const oxl_trained results[] = {{.model = model, .imaging = &other}, {.finished = 1}};
    other.medium = imaging_test_murky;
    CHECK_ERROR(oxl_imaging_write(test_ctx, test_path("imaging.txt"), scene, &other), OXL_ERR_USAGE,
                "4000 views, the scene has 3");
    for (int k = 0; k < 2; k++) {
        test_write("imaging.txt", "# kept\n");
        CHECK_ERROR(oxl_trained_write(test_ctx, test_folder(), scene, &results[k]), OXL_ERR_USAGE,
                    k ? "no Gaussian" : "4000 views, the scene has 3");
        CHECK(!test_has("scene.ply"));
        CHECK_IN("imaging.txt", "# kept");
    }
}

TEST(a_medium_of_a_survey_in_tiny_or_huge_units_is_read_as_it_was_written)
{
    OWNED_SCENE *scene = train_scene(3);
    for (int e = -14; e <= 14; e += 7) {
        const float unit = (float)pow(10, e);
        OWNED_IMAGING m = imaging_test_make(3, (int[]){1, 2}, 2), read = {0};
        m.medium.on = 1;
        for (int c = 0; c < 3; c++)
            m.medium.attenuation[c] = 0.4f / unit, m.medium.backscatter[c] = 0.3f / unit;
        read = imaging_test_reread(scene, &m);
        CHECK_CLOSE(read.medium.attenuation[0] * unit, 0.4, 1e-6);
    }
}

TEST(exposure_of_a_damaged_file_names_line_and_value)
{
    static const char *const broken[] = {"gain 1 0 1 a.png\n", "gain 1 1\n",          "lamp 1\n",
                                         "bD 1 2\n",           "falloff 1\n",         "lamp all 1 2\n",
                                         "lantern 1\n",        "gain 1 1e9 1 a.png\n"};
    OWNED_SCENE *scene = train_scene(3);
    OWNED_IMAGING read = {0};
    for (size_t i = 0; i < OXL_COUNT(broken); i++) {
        CHECK_ERROR(imaging_read(test_ctx, test_write("imaging.txt", broken[i]), scene, &read), OXL_ERR_INPUT,
                    "imaging.txt:1: ");
        CHECK_SAYS("fix: ");
    }
    CHECK_OK(imaging_read(test_ctx,
                          test_write("imaging.txt", "# nothing\n\ngain 1 1 1 of another survey.png\n"), scene,
                          &read));
    CHECK(!read.on);
}

/* ---------------- synth */

/* The image is the formula on clean, depth, lamp and gain, but for noise and rounding. */
TEST(synth_exposure_and_lamp_are_what_truth_says)
{
    synth_options o = synth_test_options("lamp");
    o.exposure_jitter = 0.5, o.lamp = 1, o.noise = 0, o.water = SYNTH_AIR, o.path = SYNTH_FORWARD;
    synth_test_make(&o, NULL);
    for (int view = 0; view < o.views; view += 5) {
        char name[64];
        const v3 gain = synth_gain(&o, view);
        double most = 0;
        synth_image_name(&o, view, name);
        OWNED_IMAGE seen = test_read_image(test_path("lamp/images/%s", name));
        OWNED_IMAGE clean = test_read_image(test_path("lamp/truth/clean/%s", name));
        for (int y = 0; y < o.height; y++)
            /* the falloff is one for all channels: the ratio of red to green is the gains' */
            for (int x = 0; x < o.width; x++) {
                const size_t at = (size_t)(y * o.width + x), plane = (size_t)(o.width * o.height);
                const double red = seen.rgb[at], green = seen.rgb[at + plane];
                if (red > 0.95 || green > 0.95 || clean.rgb[at] < 0.2 || clean.rgb[at + plane] < 0.2 ||
                    red < 0.1)
                    continue;
                most = OXL_MAX(
                    most, fabs(log(red / green * clean.rgb[at + plane] / clean.rgb[at] * gain.y / gain.x)));
            }
        CHECK(most < 0.06);
    }
    CHECK(test_has("lamp/truth/exposure.txt") && test_has("lamp/truth/lamp.txt"));
    CHECK(synth_lamp_falloff(&o, 3) == 1 && synth_lamp_falloff(&o, 6) == 0.5);
}

/* ---------------- photometry of tracks */

static void photometry_test_free(struct photometry *p)
{
    photometry_free(test_ctx, p);
}
#define PHOTOMETRY __attribute__((cleanup(photometry_test_free))) struct photometry

static struct photometry photometry_test_measure(const char *survey)
{
    OWNED_SCENE *scene = test_load(survey, NULL);
    struct photometry p;
    CHECK_OK(photometry_measure(test_ctx, scene, PHOTOMETRY_ALL, &p));
    return p;
}

static synth_options photometry_test_options(const char *name, enum synth_type water)
{
    synth_options o = synth_test_options(name);
    o.views = 14, o.water = water, o.path = SYNTH_FORWARD, o.threads = 0;
    o.noise = 0.5;
    return o;
}

synth_options photometry_test_make(const char *name, enum synth_type water)
{
    synth_options o = photometry_test_options(name, water);
    synth_test_make(&o, NULL);
    return o;
}

/* The image times a factor for each channel, and the exponential of a ramp across it. */
static void photometry_test_change(const synth_options *o, const char *survey, int view,
                                   const double factor[3], double ramp)
{
    char name[32], path[64];
    synth_image_name(o, view, name);
    snprintf(path, sizeof path, "%s/images/%s", survey, name);
    OWNED_IMAGE image = test_read_image(path);
    for (int i = 0; i < 3 * o->width * o->height; i++)
        image.rgb[i] *= (float)(factor[i / (o->width * o->height)] *
                                exp(ramp * (2.0 * (i % o->width + 0.5) / o->width - 1)));
    test_write_image(path, &image);
}

TEST(photometry_of_tracks_in_air_finds_neither_medium_nor_lamp_nor_gains)
{
    photometry_test_make("air", SYNTH_AIR);
    PHOTOMETRY p = photometry_test_measure("air");
    CHECK(p.points > 50 && p.parts == 0);
}

/* synth's shape, less its mean over a grid, as the polynomial's is. */
TEST(photometry_of_a_lamp_in_air_finds_its_shape_and_no_medium)
{
    enum { N = 16 };
    synth_options o = photometry_test_options("lit", SYNTH_AIR);
    double truth[N * N], mean = 0, error = 0, square = 0;
    o.lamp = 0;
    synth_test_make(&o, NULL);
    PHOTOMETRY p = photometry_test_measure("lit");
    CHECK(p.parts == PHOTOMETRY_LAMP);
    for (int i = 0; i < N * N; i++) {
        truth[i] =
            log(synth_lamp_radial(&o, (i % N + 0.5) * o.width / N, ((double)(i / N) + 0.5) * o.height / N));
        mean += truth[i] / (N * N);
    }
    for (int i = 0; i < N * N; i++) {
        const float x = (float)((i % N + 0.5) * 2 / N - 1), y = (float)(((double)(i / N) + 0.5) * 2 / N - 1);
        square += (truth[i] - mean) * (truth[i] - mean);
        error += pow(lamp_log_gain(p.shape[0], x, y) - truth[i] + mean, 2);
    }
    CHECK(sqrt(square) / N > 0.1 && error < 0.05 * square);
}

/* Along a strip a lamp's slope across it may as well be the ground's colours: their prior decides. Its images
 * have one white balance, red by green 0.63 to 0.66: gains that drift would make the ground's colour of it. */
TEST(photometry_along_a_strip_keeps_the_slope_of_the_lamp_and_its_colour_out_of_the_gains)
{
    const char *path = test_shared("data/haltbrekken_a");
    oxl_scene_options small = oxl_scene_options_default();
    PHOTOMETRY p = {0};
    double worst = 0, red = 0;
    if (!path) SKIP("no ../shared/data");
    small.max_side = 320;
    OWNED_SCENE *scene = test_load(path, &small);
    CHECK_OK(photometry_measure(test_ctx, scene, PHOTOMETRY_ALL, &p));
    CHECK(p.parts == (PHOTOMETRY_LAMP | PHOTOMETRY_GAINS));
    for (int i = 0; i < oxl_scene_view_count(scene); i++)
        worst = OXL_MAX(worst, fabs((double)p.log_gain[3 * i + 1])), /* green */
            red = OXL_MAX(red, fabs((double)(p.log_gain[3 * i] - p.log_gain[3 * i + 1])));
    CHECK(worst < 0.8 && red < 0.66);
}

/* The residuals support a medium, but not as clearly as depths that span less than a factor of 2 require. */
TEST(photometry_of_a_medium_that_is_refused_leaves_lamp_and_gains_as_if_none_had_been_fitted)
{
    synth_options o = synth_test_options("faint");
    PHOTOMETRY alone;
    o.views = 14, o.water = SYNTH_II, o.threads = 0;
    o.noise = 3, o.lamp = 0, o.exposure_jitter = 0.3;
    synth_test_make(&o, NULL);
    PHOTOMETRY p = photometry_test_measure("faint");
    OWNED_SCENE *scene = test_load("faint", NULL);
    CHECK(scene_depth_span(scene) < SCENE_DEPTH_SPAN_MIN);
    CHECK(p.without[0] > 1.1 * p.with_medium && p.without[0] < 1.3 * p.with_medium);
    CHECK(p.parts == (PHOTOMETRY_LAMP | PHOTOMETRY_GAINS));
    CHECK_OK(photometry_measure(test_ctx, scene, PHOTOMETRY_LAMP | PHOTOMETRY_GAINS, &alone));
    for (int t = 0; t < LAMP_TERMS; t++) CHECK_CLOSE(p.shape[0][t], alone.shape[0][t], 0.01);
    for (int i = 0; i < 3 * oxl_scene_view_count(scene); i++)
        CHECK_CLOSE(p.log_gain[i], alone.log_gain[i], 0.01);
}

/* Red that water has taken, and a view without light, say nothing about gains: what the others say is the same. */
TEST(photometry_judges_gains_by_the_channels_and_views_that_are_in_the_fit)
{
    static const double no_red[3] = {0.001, 0.5, 0.5}, brighter[3] = {1, 1.5, 1.5}, none[3] = {0, 0, 0};
    synth_options o = photometry_test_make("deep", SYNTH_AIR);
    int unseen = 0;
    for (int v = 0; v < o.views; v++) photometry_test_change(&o, "deep", v, v == 3 ? none : no_red, 0);
    photometry_test_change(&o, "deep", 6, brighter, 0);
    PHOTOMETRY p = photometry_test_measure("deep");
    CHECK(p.parts == PHOTOMETRY_GAINS);
    CHECK(p.unexplained > 0.405 / sqrt(12.0) && p.unexplained < 0.405 / sqrt(8.0));
    CHECK(p.brightness > 0.1 && p.brightness < 0.4);
    for (int v = 0; v < o.views; v++) {
        CHECK(p.fitted[v] == 0 || p.fitted[v] == 6); /* green and blue */
        unseen += p.fitted[v] == 0;
    }
    CHECK(unseen == 3); /* the view without light, and two held out */
}

/* The right images of stereo pairs get a ramp; without it both cameras have the same shape. */
TEST(photometry_gives_each_camera_its_lamp_where_these_differ)
{
    synth_options o = photometry_test_options("lamps", SYNTH_AIR);
    o.views = 28, o.stereo = 0.3, o.lamp = 0;
    synth_test_make(&o, NULL);
    PHOTOMETRY alike = photometry_test_measure("lamps");
    CHECK(alike.parts & PHOTOMETRY_LAMP);
    CHECK(memcmp(alike.shape[1], alike.shape[2], sizeof alike.shape[1]) == 0);
    for (int v = 1; v < o.views; v += 2)
        photometry_test_change(&o, "lamps", v, (const double[3]){0.67, 0.67, 0.67}, 0.4);
    PHOTOMETRY p = photometry_test_measure("lamps");
    CHECK_CLOSE(p.shape[2][0] - p.shape[1][0], 0.4, 0.04);
}

/* 260 training views, L and R in turn: every other one of all would be those of one camera. */
TEST(photometry_of_more_images_than_it_fits_takes_as_many_of_each_camera_of_a_stereo_pair)
{
    synth_options o = synth_test_options("pairs");
    struct track_samples s;
    oxl_scene_options all = oxl_scene_options_default();
    int of[2] = {0, 0}, last = -1;
    o.views = 260, o.width = 20, o.height = 16, o.points = 50, o.stereo = 0.3, o.water = SYNTH_AIR;
    all.test_every = 0;
    synth_test_make(&o, NULL);
    OWNED_SCENE *scene = test_load("pairs", &all);
    CHECK_OK(track_samples_take(test_ctx, scene, 100, 3, &s));
    CHECK(s.lamps == 3);
    for (int i = 0; i < s.views; last = s.chosen[i++]) {
        CHECK(s.chosen[i] > last &&
              s.view[scene_source_image(scene, s.chosen[i]) - scene_colmap(scene)->image] == i);
        of[s.lamp_of[i] - 1]++;
    }
    CHECK(of[0] == 64 && of[1] == 64 && last >= 256);
    track_samples_free(test_ctx, &s);
}

/* Gains that jump from image to image predict no other image. Larger ones hide the lamp from a fit without
 * gains, which then does not count. */
TEST(exposure_that_is_refused_leaves_a_lamp_fitted_without_it_unless_that_hides_the_lamp)
{
    NEEDS_PART(exposure);
    NEEDS_PART(lamp);
    synth_options o = photometry_test_options("apart", SYNTH_AIR);
    o.lamp = 0, o.seed = 3;
    synth_test_make(&o, NULL);
    for (int large = 0; large < 2; large++) {
        oxl_model model[2];
        for (int v = 0; v < 14; v++) {
            const double f = 1 + (v % 2 ? -1 : 1) * (large ? 0.1 : 0.01);
            photometry_test_change(&o, "apart", v, (const double[3]){f, f, f}, 0);
        }
        for (int k = 0; k < 2; k++) {
            oxl_train_options options = train_options(10);
            options.exposure = k ? OXL_AUTO : OXL_OFF, options.lamp = OXL_AUTO, options.medium = OXL_OFF;
            OWNED_SCENE *scene = test_load("apart", NULL);
            model[k] = test_trained(scene, &options);
            CHECK(!test_imaging.on && test_imaging.lamps == (k || !large));
        }
        CHECK(test_same_model(&model[0], &model[1]) == !large);
        for (int k = 0; k < 2; k++) oxl_model_free(test_ctx, &model[k]);
    }
}

/* Medium, exposure and lamp of a synthetic survey; then all images times 0.5, and tinted. */
TEST(photometry_of_tracks_finds_the_medium_and_gains_and_scales_with_the_images)
{
    static const double factor[3] = {0.4, 0.5, 0.6};
    synth_options o = photometry_test_options("tracks", SYNTH_7C);
    o.exposure_jitter = 0.4;
    synth_test_make(&o, NULL);
    PHOTOMETRY p = photometry_test_measure("tracks");
    CHECK(p.parts & PHOTOMETRY_MEDIUM && p.parts & PHOTOMETRY_GAINS);
    for (int c = 0; c < 3; c++) {
        static const double direct[3] = {.478, .494, .693}, veil[3] = {.18, .43, .27};
        CHECK_CLOSE(p.attenuation[c], direct[c], 0.15 * direct[c]);
        CHECK_CLOSE(p.backscatter[c], 1.2 * direct[c], 0.2 * direct[c]);
        CHECK_CLOSE(p.veiling_light[c], veil[c], 0.15 * veil[c]);
    }
    for (int v = 0; v < o.views; v++) photometry_test_change(&o, "tracks", v, factor, 0);
    PHOTOMETRY scaled = photometry_test_measure("tracks");
    CHECK(scaled.parts == p.parts);
    for (int c = 0; c < 3; c++) {
        CHECK_CLOSE(scaled.attenuation[c], p.attenuation[c], 0.03 * p.attenuation[c]);
        CHECK_CLOSE(scaled.backscatter[c], p.backscatter[c], 0.08 * p.backscatter[c]);
        CHECK_CLOSE(scaled.veiling_light[c], factor[c] * p.veiling_light[c],
                    0.08 * factor[c] * p.veiling_light[c]);
        for (int v = 0; v < o.views - 2; v++) /* the last ones see no more tracks */
            CHECK_CLOSE(scaled.log_gain[3 * v + c], p.log_gain[3 * v + c], 0.05);
    }
}

/* Mean of each channel of a view without the medium, after a short run. */
static void photometry_test_clear(const char *survey, double mean[3])
{
    oxl_train_options o = train_options(150);
    o.medium = OXL_AUTO, o.exposure = o.lamp = OXL_OFF;
    OWNED_SCENE *scene = test_load(survey, NULL);
    OWNED_MODEL model = test_trained(scene, &o);
    CHECK(test_imaging.medium.on);
    OWNED_IMAGE image = test_render(&model, &oxl_scene_view(scene, 7)->camera);
    size_t pixels = (size_t)image.width * image.height;
    for (size_t i = 0; i < 3 * pixels; i++) mean[i / pixels] += (double)image.rgb[i] / (double)pixels;
}

/* The survey's points keep their colours, as where images are corrected after COLMAP. */
TEST(tinted_images_in_water_give_the_same_clear_scene_times_the_tint)
{
    NEEDS_PART(medium);
    static const double factor[3] = {0.4, 0.5, 0.6};
    const synth_options o = photometry_test_make("gauge", SYNTH_3C);
    double mean[3] = {0, 0, 0}, tinted[3] = {0, 0, 0};
    photometry_test_clear("gauge", mean);
    for (int v = 0; v < o.views; v++) photometry_test_change(&o, "gauge", v, factor, 0);
    photometry_test_clear("gauge", tinted);
    for (int c = 0; c < 3; c++) CHECK_CLOSE(tinted[c], factor[c] * mean[c], 0.04 * factor[c] * mean[c]);
}

/* ---------------- the medium */

/* S = the sum of drgb x the image, rendered through the medium. */
static double medium_score(struct renderer *r, const oxl_camera *camera, const oxl_model *model,
                           const struct medium *medium, const float *drgb)
{
    const size_t n = 3 * (size_t)camera->width * camera->height;
    double sum = 0;
    renderer_settings(r)->medium = medium ? *medium : (struct medium){0};
    const float *rgb = test_draw(r, model, camera);
    for (size_t i = 0; i < n; i++) sum += (double)drgb[i] * rgb[i];
    return sum;
}

static void medium_move(oxl_model *model, const double eye[3], double factor)
{
    for (size_t i = 0; i < model->count; i++)
        for (int a = 0; a < 3; a++) {
            float *x = &model->plane[OXL_MEAN + a][i];
            *x = (float)(eye[a] + factor * (*x - eye[a]));
            model->plane[OXL_LOG_SCALE + a][i] += (float)log(factor);
        }
}

TEST(medium_gradient_of_the_centres_agrees_with_finite_differences)
{
    OWNED_SCENE *scene = train_scene(3);
    const oxl_camera *camera = &oxl_scene_view(scene, 1)->camera;
    const size_t n = 3 * (size_t)camera->width * camera->height;
    OWNED_MEMORY float *drgb = oxl_alloc(test_ctx, n, sizeof *drgb);
    struct medium m = imaging_test_murky;
    for (size_t i = 0; i < n; i++) drgb[i] = (float)(random_unit(random_bits(1, i, 0)) - 0.3);
    OWNED_RENDERER *r = test_renderer();
    OWNED_MODEL model = test_points(scene, 1);
    OWNED_MODEL gradient = test_model(model.count, 1);
    medium_score(r, camera, &model, &m, drgb);
    CHECK_OK(renderer_backward(test_ctx, r, drgb, &gradient));
    { /* all moved away from the eye and grown alike: the image stays, but for the medium */
        const double h = 1e-3;
        double eye[3], slope = 0;
        camera_position(camera, eye);
        for (size_t i = 0; i < model.count; i++)
            for (int a = 0; a < 3; a++) {
                slope += gradient.plane[OXL_MEAN + a][i] * (model.plane[OXL_MEAN + a][i] - eye[a]);
                slope += gradient.plane[OXL_LOG_SCALE + a][i];
            }
        medium_move(&model, eye, 1 + h);
        double plus = medium_score(r, camera, &model, &m, drgb);
        medium_move(&model, eye, (1 - h) / (1 + h));
        double minus = medium_score(r, camera, &model, &m, drgb);
        CHECK(fabs(slope) > 10);
        CHECK_CLOSE(slope, (plus - minus) / (2 * h), 0.01 * fabs(slope));
    }
}

/* Means over the views that see a row, weighted by 1 / range^2, or over all views where none does; with a
 * medium and lamp. */
TEST(medium_baked_into_the_colours_is_the_mean_over_the_views_that_see_a_row)
{
    OWNED_SCENE *scene = train_scene(3);
    struct oxl_imaging imaging = {.medium = imaging_test_murky,
                                  .lamps = 1,
                                  .lamp = {{.view = -1, .shape = {0.3f, -0.2f, 0.1f, 0.15f, -0.1f}}}};
    const struct medium *m = &imaging.medium;
    int unseen = 0, by_some = 0;
    OWNED_MODEL model = test_model(60, 0);
    for (size_t i = 0; i < model.count; i++)
        for (int a = 0; a < 3; a++)
            model.plane[OXL_MEAN + a][i] = (float)(5 * random_unit(random_bits(8, i, (uint64_t)a)) - 2.5);
    medium_bake(scene, &imaging, 0, &model);
    for (size_t i = 0; i < model.count; i++) {
        const double at[3] = {model.plane[OXL_MEAN][i], model.plane[OXL_MEAN + 1][i],
                              model.plane[OXL_MEAN + 2][i]};
        double sum[3] = {0}, all[3] = {0}, weights = 0, all_weights = 0;
        int seen = 0;
        for (int v = 0; v < 3; v++) {
            const oxl_camera *camera = &oxl_scene_view(scene, v)->camera;
            double eye[3], axes[3], x[2] = {0}, square = 0;
            const int here = camera_project(camera, at, (double[3]){0}, axes, x) && x[0] >= 0 && x[1] >= 0 &&
                             x[0] <= camera->width && x[1] <= camera->height;
            camera_position(camera, eye);
            for (int a = 0; a < 3; a++) square += (at[a] - eye[a]) * (at[a] - eye[a]);
            double gain = exp(lamp_log_gain(imaging.lamp[0].shape, (float)(2 * x[0] / camera->width - 1),
                                            (float)(2 * x[1] / camera->height - 1)));
            for (int c = 0; c < 3; c++) {
                const double r = sqrt(square);
                const double shown = 0.5 * exp(-(double)m->attenuation[c] * r) +
                                     (double)m->veiling_light[c] * (1 - exp(-(double)m->backscatter[c] * r));
                all[c] += shown / square;
                if (here) sum[c] += gain * shown / square;
            }
            all_weights += 1 / square;
            if (here) weights += 1 / square;
            seen += here;
        }
        unseen += seen == 0;
        by_some += seen > 0 && seen < 3;
        for (int c = 0; c < 3; c++) {
            const double expected = seen ? sum[c] / weights : all[c] / all_weights;
            CHECK_CLOSE(0.5 + 0.28209479177387814 * (double)model.plane[OXL_SH + c][i], expected,
                        2e-5 * expected);
        }
    }
    CHECK(unseen > 3 && by_some > 3);
    medium_bake(scene, &imaging, 1, &model); /* backwards, they are what they were */
    for (size_t i = 0; i < 3 * model.count; i++) CHECK_CLOSE(model.plane[OXL_SH + i % 3][i / 3], 0, 1e-4);
}

/* No Gaussian in view: the veiling light alone. */
TEST(medium_alone_shows_its_veil)
{
    OWNED_SCENE *scene = train_scene(3);
    OWNED_RENDERER *r = test_renderer();
    OWNED_MODEL model = test_model(1, 0);
    model.plane[OXL_OPACITY][0] = -20;
    renderer_settings(r)->medium = imaging_test_murky;
    CHECK(test_draw(r, &model, &oxl_scene_view(scene, 0)->camera)[0] == imaging_test_murky.veiling_light[0]);
}

/* ---------------- depths of tracks */

static double depth_z(const oxl_camera *c, const oxl_model *model, size_t row)
{
    double z = c->translation[2];
    for (int a = 0; a < 3; a++) z += c->rotation[6 + a] * (double)model->plane[OXL_MEAN + a][row];
    return z;
}

/* The sum of 1 - T over the points' pixels: black Gaussians before a white background. */
static double depth_hidden(struct renderer *r, const oxl_camera *camera, const oxl_model *front,
                           const struct depth_point *point, int count)
{
    oxl_render_options o = oxl_render_options_default();
    const float *rgb;
    double sum = 0;
    for (int k = 0; k < 3; k++) o.background[k] = 1;
    CHECK_OK(renderer_forward(test_ctx, r, front, camera, &o));
    CHECK_OK(renderer_image(r, &rgb));
    for (int i = 0; i < count; i++) sum += 1 - (double)rgb[(int)point[i].y * camera->width + (int)point[i].x];
    return sum;
}

/* Black Gaussians, each 16th of them half-way to the camera, and three points behind those. */
struct depth_case {
    oxl_scene *scene;
    const oxl_camera *camera;
    struct renderer *r;
    float *drgb; /* 0 */
    struct depth_point point[3];
    oxl_model model, front, gradient; /* front: those in front of the points */
    uint8_t *in_front;                /* (rows of the model) */
};

/* The next step's gradient, into `out`. */
static void depth_case_step(struct depth_case *c, int points, oxl_model *out)
{
    test_draw(c->r, &c->model, c->camera);
    if (points) renderer_set_depths(c->r, c->point, points, 1);
    CHECK_OK(renderer_backward(test_ctx, c->r, c->drgb, out));
}

static struct depth_case depth_case_begin(void)
{
    struct depth_case c = {.scene = train_scene(3)};
    double eye[3];
    c.camera = &oxl_scene_view(c.scene, 1)->camera;
    c.drgb = oxl_calloc(test_ctx, 3 * (size_t)c.camera->width * c.camera->height, sizeof *c.drgb);
    c.r = test_renderer();
    c.model = test_points(c.scene, 0);
    c.gradient = test_model(c.model.count, 0);
    c.in_front = oxl_alloc(test_ctx, c.model.count, 1);
    for (int i = 0; i < 3; i++)
        c.point[i] = (struct depth_point){(float)(8 + (c.camera->width - 16) / 2 * i) + 0.5f,
                                          (float)(c.camera->height / 2) + 0.5f,
                                          (float)scene_depth_quantile(c.scene, 0.5)};
    camera_position(c.camera, eye);
    for (size_t j = 0; j < c.model.count; j++) {
        for (int a = 0; a < 3 && j % 16 == 0; a++) {
            float *x = &c.model.plane[OXL_MEAN + a][j];
            *x = (float)(eye[a] + 0.5 * (*x - eye[a]));
        }
        c.in_front[j] = depth_z(c.camera, &c.model, j) < 0.8 * (double)c.point[0].z;
        for (int k = 0; k < 3; k++) {
            c.model.plane[OXL_SH + k][j] = -9;
            c.model.plane[OXL_LOG_SCALE + k][j] -= 0.6f;
            c.model.plane[OXL_OPACITY][j] = -0.5f;
        }
    }
    CHECK_OK(model_copy(test_ctx, &c.model, &c.front));
    model_keep_rows(&c.front, c.in_front);
    depth_case_step(&c, 3, &c.gradient);
    return c;
}

static void depth_case_end(struct depth_case *c)
{
    OXL_FREE(test_ctx, c->drgb, c->in_front);
    oxl_model_free(test_ctx, &c->model);
    oxl_model_free(test_ctx, &c->front);
    oxl_model_free(test_ctx, &c->gradient);
    renderer_free(test_ctx, c->r);
    oxl_scene_free(test_ctx, c->scene);
}
#define DEPTH_CASE __attribute__((cleanup(depth_case_end))) struct depth_case

/* How the sum of depth_hidden changes with the opacity of one of the rows in front, or with all (row
 * SIZE_MAX). */
static double depth_slope(struct depth_case *c, size_t row)
{
    const double h = 0.05;
    double slope = 0;
    oxl_model moved;
    for (int side = -1; side <= 1; side += 2) {
        CHECK_OK(model_copy(test_ctx, &c->front, &moved));
        for (size_t j = 0; j < moved.count; j++)
            if (row == SIZE_MAX || j == row) moved.plane[OXL_OPACITY][j] += (float)(side * h);
        slope += side * depth_hidden(c->r, c->camera, &moved, c->point, 3) / (2 * h);
        oxl_model_free(test_ctx, &moved);
    }
    return slope;
}

TEST(depth_loss_lowers_the_opacity_in_front_of_points_by_its_exact_gradient)
{
    DEPTH_CASE c = depth_case_begin();
    double largest = 0, all = 0;
    for (size_t j = 0, row = 0; j < c.model.count; row += c.in_front[j++]) {
        const double d = (double)c.gradient.plane[OXL_OPACITY][j];
        largest = fmax(largest, d);
        all += d;
        if (c.in_front[j] && fabs(d) > 0.02) CHECK_CLOSE(d, depth_slope(&c, row), 0.01 * fabs(d));
    }
    CHECK(largest > 0.02);
    CHECK_CLOSE(all, depth_slope(&c, SIZE_MAX), 0.01 * all); /* no point is missed */
}

TEST(depth_loss_changes_nothing_but_opacities_in_front_of_points_in_its_step_with_a_context_or_without)
{
    DEPTH_CASE c = depth_case_begin();
    double elsewhere = 0, behind = 0, in_front = 0;
    for (size_t j = 0; j < c.model.count; j++) {
        *(c.in_front[j] ? &in_front : &behind) += fabs((double)c.gradient.plane[OXL_OPACITY][j]);
        for (int p = 0; p < OXL_SH; p++)
            if (p != OXL_OPACITY) elsewhere += fabs((double)c.gradient.plane[p][j]);
    }
    CHECK(in_front > 0.02 && elsewhere == 0 && behind == 0);
    OWNED_MODEL beside = test_model(c.model.count, 0);
    renderer_set_surroundings(c.r, &c.front);
    depth_case_step(&c, 3, &beside);
    renderer_set_surroundings(c.r, NULL);
    for (size_t j = 0; j < c.model.count; j++)
        CHECK(beside.plane[OXL_OPACITY][j] == c.gradient.plane[OXL_OPACITY][j]);
    depth_case_step(&c, 0, &beside);
    for (size_t j = 0; j < c.model.count; j++) CHECK(beside.plane[OXL_OPACITY][j] == 0);
}

TEST(medium_a_run_that_is_stopped_ends_in_the_same_bytes)
{
    NEEDS_PART(medium);
    photometry_test_make("survey", SYNTH_3C);
    OWNED_CHECKPOINT_CASE c = checkpoint_of(test_load("survey", NULL), train_options(130));
    checkpoint_check_stops(&c, (const int[]){1, 80, 0});
    CHECK(test_imaging.medium.on);
}

/* ---------------- the lamp */

TEST(lamp_has_a_log_gain_of_zero_mean_over_the_image)
{
    enum { W = 64, H = 48 };
    static float gain[W * H];
    for (int t = 0; t < LAMP_TERMS; t++) {
        struct lamp lamp = {.view = -1};
        double sum = 0, square = 0;
        lamp.shape[t] = 0.5f;
        lamp_gain(lamp.shape, &(struct lamp_area){W, H, W, H, 0, 0}, gain);
        for (int i = 0; i < W * H; i++)
            sum += log(gain[i]) / (W * H), square += log(gain[i]) * log(gain[i]) / (W * H);
        CHECK_CLOSE(sum, 0, 1e-3);
        CHECK(square > 0.008);
    }
}

/* With gains as well: both are between the rendered image and the loss. */
static struct renderer_loss lamp_loss(struct renderer *r, oxl_scene *scene, const oxl_model *model,
                                      const struct lamp *lamp)
{
    renderer_settings(r)->lamp = lamp;
    struct renderer_loss loss = exposure_loss(r, scene, model, (double[]){0.1, -0.2, 0.3});
    renderer_settings(r)->lamp = NULL;
    return loss;
}

TEST(lamp_gradients_of_all_terms_and_of_the_gaussians_agree_with_finite_differences)
{
    OWNED_SCENE *scene = train_scene(3);
    struct lamp lamp = lamp_of(-1);
    double d[LAMP_TERMS], slope = 0, plus, minus;
    const float h = 4e-3f;
    OWNED_RENDERER *r = test_renderer();
    OWNED_MODEL model = test_points(scene, 0);
    OWNED_MODEL gradient = test_model(model.count, 0);
    memcpy(d, lamp_loss(r, scene, &model, &lamp).dlamp, sizeof d);
    CHECK_OK(renderer_backward(test_ctx, r, NULL, &gradient));
    for (int t = 0; t < LAMP_TERMS; t++) {
        const float is = lamp.shape[t];
        lamp.shape[t] = is + h;
        plus = lamp_loss(r, scene, &model, &lamp).total;
        lamp.shape[t] = is - h;
        minus = lamp_loss(r, scene, &model, &lamp).total;
        lamp.shape[t] = is;
        CHECK_CLOSE(d[t], (plus - minus) / (2 * (double)h), 2e-4 + 5e-3 * fabs(d[t]));
    }
    for (size_t i = 0; i < model.count; i++) slope += gradient.plane[OXL_SH + 1][i];
    for (size_t i = 0; i < model.count; i++) model.plane[OXL_SH + 1][i] += h;
    plus = lamp_loss(r, scene, &model, &lamp).total;
    for (size_t i = 0; i < model.count; i++) model.plane[OXL_SH + 1][i] -= 2 * h;
    minus = lamp_loss(r, scene, &model, &lamp).total;
    CHECK(fabs(slope) > 1e-3);
    CHECK_CLOSE(slope, (plus - minus) / (2 * (double)h), 1e-4 + 5e-3 * fabs(slope));
}

/* Gradients of a loss through the medium, lamp and gains: of the Gaussians; then of the
 * lamp, the gains. */
static void imaging_test_gradients(int isa, int threads, oxl_model *gradient, double d[LAMP_TERMS + 3])
{
    const double log_gain[3] = {0.1, -0.2, 0.3};
    const struct lamp lamp = lamp_of(-1);
    OWNED_SCENE *scene = train_scene(3);
    test_ctx->isa = isa, test_ctx->threads = threads;
    OWNED_RENDERER *r = test_renderer();
    OWNED_MODEL model = test_points(scene, 1);
    *gradient = test_model(model.count, 1);
    renderer_settings(r)->medium = imaging_test_murky;
    renderer_settings(r)->lamp = &lamp;
    struct renderer_loss loss = exposure_loss(r, scene, &model, log_gain);
    CHECK_OK(renderer_backward(test_ctx, r, NULL, gradient));
    memcpy(d, loss.dlamp, sizeof loss.dlamp);
    memcpy(d + LAMP_TERMS, loss.dlog_gain, 3 * sizeof *d);
}

TEST(medium_lamp_and_gains_have_the_same_gradients_with_avx2_and_avx512_and_any_number_of_threads)
{
    const int isa = test_ctx->isa;
    double d[3][LAMP_TERMS + 3];
    oxl_model gradient[3];
    imaging_test_gradients(isa, 1, &gradient[0], d[0]);
    imaging_test_gradients(isa, 3, &gradient[1], d[1]);
    imaging_test_gradients(OXL_MIN(isa, ISA_AVX2), 2, &gradient[2], d[2]);
    for (int k = 1; k < 3; k++) {
        CHECK(memcmp(d[0], d[k], sizeof d[0]) == 0 && test_same_model(&gradient[0], &gradient[k]));
    }
    for (int i = 0; i < LAMP_TERMS + 3; i++) CHECK(d[0][i] != 0);
    for (int k = 0; k < 3; k++) oxl_model_free(test_ctx, &gradient[k]);
}

struct lamp_test {
    const struct lamp *lamp;
    int lamps;
};

static void lamp_test_light(const void *how, const oxl_scene *scene, int view, oxl_image *image)
{
    const struct lamp_test *l = how;
    struct oxl_imaging m = {.lamps = 1, .lamp = {l->lamp[view % l->lamps]}};
    CHECK_OK(imaging_apply_lamp(test_ctx, scene, &m, view, image));
    for (int i = 0; i < 3 * image->width * image->height; i++)
        image->rgb[i] = OXL_MIN(1.0f, 0.7f * image->rgb[i]);
}

/* The scene of test_train.c, each image times the lamp's gain; of two lamps in turn, the one of a left, the
 * other of a right camera. */
static oxl_scene *lamp_scene(int views, const struct lamp *lamp, int lamps)
{
    const struct lamp_test light = {lamp, lamps};
    return lamps == 1 ? train_scene_changed(views, NULL, lamp_test_light, &light)
                      : train_scene_of_pairs(views, lamp_test_light, &light);
}

/* The left camera has eight training views and a lamp of its own, the right one seven and the lamp of all
 * others, as the held-out view. */
TEST(lamp_of_each_camera_is_trained_on_its_own_views_and_shown_in_them)
{
    NEEDS_PART(lamp);
    const struct lamp lamp[2] = {{-1, {0.4f, 0, 0, 0, 0.1f}}, {-1, {-0.4f, 0, 0, 0, 0, 0.1f}}};
    OWNED_SCENE *scene = lamp_scene(16, lamp, 2);
    oxl_train_options options = train_options(500);
    options.medium = OXL_OFF;
    CHECK(imaging_test_helps(scene, &options, &options.lamp) > 3);
    CHECK(test_imaging.lamps == 2 && imaging_lamp(&test_imaging, scene, 3)->view < 0);
    for (int v = 3; v < 5; v++)
        CHECK_CLOSE(imaging_lamp(&test_imaging, scene, v)->shape[0], v % 2 ? -0.4 : 0.4, 0.1);
}

TEST(lamp_a_run_stopped_before_and_after_it_starts_ends_in_the_same_bytes)
{
    NEEDS_PART(lamp);
    const struct lamp lamp = lamp_of(-1);
    OWNED_CHECKPOINT_CASE c = checkpoint_of(lamp_scene(7, &lamp, 1), train_options(130));
    c.options.lamp = OXL_ON;
    checkpoint_check_stops(&c, (const int[]){9, 10, 11, 60, 0});
    CHECK(test_imaging.lamp[0].shape[1] != 0);
}

TEST(lamp_of_a_stereo_pair_is_one_for_each_folder_or_prefix)
{
    OWNED_SCENE *scene = train_scene_of_pairs(8, NULL, NULL);
    OWNED_IMAGING m = imaging_test_make(8, NULL, 0), read = {0};
    m.lamps = 2, m.lamp[0] = lamp_of(-1), m.lamp[1] = lamp_of(1);
    read = imaging_test_reread(scene, &m);
    CHECK(read.lamps == 2 && memcmp(read.lamp, m.lamp, 2 * sizeof *m.lamp) == 0);
    for (int v = 0; v < 8; v++) CHECK(imaging_lamp(&read, scene, v) == &read.lamp[v % 2]);
}

/* ---------------- in blocks */

/* The first line of a file that begins so. */
static const char *blocks_test_line(const char *file, const char *word, char line[300])
{
    OWNED_FILE map = test_file(file);
    const char *at = map.data ? strstr(map.data, word) : NULL;
    snprintf(line, 300, "%.*s", at ? (int)strcspn(at, "\r\n") : 0, at ? at : "");
    return line;
}

static oxl_job_options blocks_test_options(void)
{
    oxl_job_options o = job_test_options();
    o.train.iterations = 120;
    o.train.exposure = OXL_OFF;
    o.train.lamp = OXL_ON;
    o.renders = 0;
    o.partition.block_points = 3000;
    photometry_test_make("survey", SYNTH_3C);
    return o;
}

/* scene_clear.ply and scene.ply, each as it is meant to be seen. */
static void blocks_test_shows_the_images(double viewer)
{
    CHECK(job_test_evaluate("out/scene_clear.ply", 1).psnr > 28 &&
          job_test_evaluate("out/scene_clear.ply", 0).psnr < 15);
    CHECK(job_test_evaluate("out/scene.ply", 0).psnr > viewer);
}

TEST(medium_and_lamp_of_blocks_are_the_coarse_model_s_and_show_the_images)
{
    NEEDS_PART(medium);
    NEEDS_PART(lamp);
    const oxl_job_options o = blocks_test_options();
    const char *word[2] = {"bD 0.3", "lamp all "};
    char line[2][300];
    job_test_done("out", &o);
    for (int k = 0; k < 2; k++) {
        CHECK(strlen(blocks_test_line("out/blocks/coarse/imaging.txt", word[k], line[0])) > 20);
        CHECK(!strcmp(line[0], blocks_test_line("out/blocks/000/imaging.txt", word[k], line[1])));
        CHECK(!strcmp(line[0], blocks_test_line("out/blocks/001/imaging.txt", word[k], line[1])));
        CHECK(!strcmp(line[0], blocks_test_line("out/imaging.txt", word[k], line[1])) ==
              (k == 0)); /* the merged model's lamp goes on */
        CHECK(strlen(line[1]) > 20);
    }
    blocks_test_shows_the_images(23);
}

/* imaging.c - exposure gains per view and channel, and the medium, between the model's colours and an image.
 *
 * Cameras adapt exposure and white balance. A view that was not trained has a gain interpolated between the
 * training views of the same camera before and after it in file order, which is the order of time in most
 * surveys: linear in the logarithm. The two cameras of a stereo pair, interleaved by name, have gains of
 * their own; the deviation of the other camera's gain at that moment from the line between its own neighbours
 * is added, times a factor from 0 to 1 measured on the known views: 1 if the cameras adapt together.
 *
 * Invariant: an `imaging` that is off changes nothing. Logarithms are natural; gains multiply the rendered
 * image.
 */
#include "sparse.h"
#include "imaging.h"
#include "scene.h"
#include "../core/vecmath.h"

#define IMAGING_CAMERA_VIEWS 4 /* Bounds the mean number of views of a camera from below. */

OXL_INTERNAL oxl_result imaging_create(oxl_context *ctx, int views, struct oxl_imaging *out)
{
    *out = (struct oxl_imaging){.views = views};
    out->log_gain = oxl_calloc(ctx, 3 * (size_t)views + 1, sizeof *out->log_gain);
    out->known = oxl_calloc(ctx, (size_t)views + 1, sizeof *out->known);
    out->camera = oxl_calloc(ctx, (size_t)views + 1, sizeof *out->camera);
    out->partner = oxl_calloc(ctx, (size_t)views + 1, sizeof *out->partner);
    for (int i = 0; out->partner && i < views; i++) out->partner[i] = -1;
    if (out->log_gain && out->known && out->camera && out->partner) return OXL_OK;
    imaging_free(ctx, out);
    return OXL_ERR_MEMORY;
}

/* Copies gains, cameras and medium, but neither lamps nor poses, to an imaging of as many views. */
OXL_INTERNAL void imaging_copy(const struct oxl_imaging *from, struct oxl_imaging *to)
{
    to->on = from->on;
    to->medium = from->medium;
    if (from->views == 0) return; /* a build without gains */
    memcpy(to->log_gain, from->log_gain, 3 * (size_t)from->views * sizeof *to->log_gain);
    memcpy(to->known, from->known, (size_t)from->views * sizeof *to->known);
    memcpy(to->camera, from->camera, (size_t)from->views * sizeof *to->camera);
    memcpy(to->partner, from->partner, (size_t)from->views * sizeof *to->partner);
}

OXL_INTERNAL oxl_result imaging_clone(oxl_context *ctx, const struct oxl_imaging *from, size_t views,
                                      struct oxl_imaging *out)
{
    oxl_result rc = imaging_create(ctx, from->views, out);
    if (rc != OXL_OK) return rc;
    imaging_copy(from, out);
    out->lamps = from->lamps;
    memcpy(out->lamp, from->lamp, sizeof out->lamp);
    if (!from->pose) return OXL_OK;
    out->pose = oxl_alloc(ctx, views + 1, sizeof *out->pose);
    if (out->pose) memcpy(out->pose, from->pose, views * sizeof *out->pose);
    else imaging_free(ctx, out), rc = OXL_ERR_MEMORY;
    return rc;
}

OXL_INTERNAL void imaging_clear(struct oxl_imaging *m)
{
    memset(m->log_gain, 0, 3 * (size_t)m->views * sizeof *m->log_gain);
    memset(m->known, 0, (size_t)m->views * sizeof *m->known);
}

/* ---------------- cameras */

/* Hashes CAMERA_ID, the folder, and the name without its digits: IMG_0012.JPG and IMG_0013.JPG are of one
 * camera, L/0012.png and R/0012.png are not. */
static uint64_t imaging_camera(const oxl_scene *scene, int view)
{
    const struct colmap *from = scene_colmap(scene);
    const int has_ids = from && from->camera_count * IMAGING_CAMERA_VIEWS <= (size_t)scene->view_count;
    const char *name = scene->view[view].name, *base = path_base_name(name);
    const uint64_t id = has_ids ? (uint64_t)scene_source_image(scene, view)->camera_id : 0;
    uint64_t hash = CHECKSUM_SEED;
    hash = checksum_add(hash, &id, sizeof id);
    for (const char *c = name; *c; c++)
        if (c < base || *c < '0' || *c > '9') hash = checksum_add(hash, c, 1);
    return hash;
}

/* Returns a hash of the longest number in the name, without leading zeros, the last of equally
 * long ones; 0: there is none. */
static uint64_t imaging_timestamp(const char *name)
{
    const char *base = path_base_name(name), *best = NULL;
    int most = 0, length;
    for (const char *c = base; *c; c += OXL_MAX(length, 1)) {
        for (length = 0; c[length] >= '0' && c[length] <= '9';) length++;
        if (length >= OXL_MAX(most, 1)) best = c, most = length;
    }
    if (!best) return 0;
    while (most > 1 && *best == '0') best++, most--;
    return checksum_add(CHECKSUM_SEED, best, (size_t)most);
}

static int imaging_compare_keys(const void *a, const void *b)
{
    const uint64_t *x = a, *y = b;
    return (*x > *y) - (*x < *y);
}

struct imaging_timestamp {
    uint64_t of;
    int view;
};

static int imaging_compare_moments(const void *a, const void *b)
{
    const struct imaging_timestamp *x = a, *y = b;
    const int order = imaging_compare_keys(&x->of, &y->of);
    return order ? order : (x->view > y->view) - (x->view < y->view);
}

/* Makes two images of one moment partners, if there are just two and their cameras differ. */
static oxl_result imaging_set_partners(oxl_context *ctx, const oxl_scene *scene, struct oxl_imaging *m)
{
    struct imaging_timestamp *sorted = oxl_alloc(ctx, (size_t)m->views + 1, sizeof *sorted);
    if (!sorted) return OXL_ERR_MEMORY;
    for (int i = 0; i < m->views; i++)
        sorted[i] = (struct imaging_timestamp){imaging_timestamp(scene->view[i].name), i};
    qsort(sorted, (size_t)m->views, sizeof *sorted, imaging_compare_moments);
    for (int first = 0, end; first < m->views; first = end) {
        for (end = first + 1; end < m->views && sorted[end].of == sorted[first].of;) end++;
        if (end - first != 2 || !sorted[first].of ||
            m->camera[sorted[first].view] == m->camera[sorted[first + 1].view])
            continue;
        m->partner[sorted[first].view] = sorted[first + 1].view;
        m->partner[sorted[first + 1].view] = sorted[first].view;
    }
    oxl_free(ctx, sorted);
    return OXL_OK;
}

/* Finds each view's camera. Counts all views as one camera's if cameras have fewer than
 * IMAGING_CAMERA_VIEWS views on average, as where COLMAP gave each image its own camera, or names are
 * random: there the keys have no meaning. */
OXL_INTERNAL oxl_result imaging_set_cameras(oxl_context *ctx, const oxl_scene *scene, struct oxl_imaging *m)
{
    uint64_t *sorted = oxl_alloc(ctx, (size_t)m->views + 1, sizeof *sorted);
    int cameras = 0;
    if (!sorted) return OXL_ERR_MEMORY;
    for (int i = 0; i < m->views; i++) sorted[i] = m->camera[i] = imaging_camera(scene, i);
    qsort(sorted, (size_t)m->views, sizeof *sorted, imaging_compare_keys);
    for (int i = 0; i < m->views; i++) cameras += i == 0 || sorted[i] != sorted[i - 1];
    if (cameras * IMAGING_CAMERA_VIEWS > m->views) memset(m->camera, 0, (size_t)m->views * sizeof *m->camera);
    oxl_free(ctx, sorted);
    return imaging_set_partners(ctx, scene, m);
}

/* ---------------- gains */

/* Finds the nearest view of known gain from `view` on, in steps of `step`, of the same camera or
 * of any; -1: there is none. */
static int imaging_neighbour(const struct oxl_imaging *m, int view, int step, int any)
{
    for (int i = view + step; i >= 0 && i < m->views; i += step)
        if (m->known[i] && (any || m->camera[i] == m->camera[view])) return i;
    return -1;
}

OXL_INTERNAL void imaging_interpolate(const struct oxl_imaging *m, int view, float out[3])
{
    int before = imaging_neighbour(m, view, -1, 0), after = imaging_neighbour(m, view, 1, 0);
    if (before < 0 && after < 0)
        before = imaging_neighbour(m, view, -1, 1), after = imaging_neighbour(m, view, 1, 1);
    for (int c = 0; c < 3; c++) {
        const float a = before >= 0 ? m->log_gain[3 * before + c] : 0,
                    b = after >= 0 ? m->log_gain[3 * after + c] : 0;
        const float t =
            before >= 0 && after >= 0 ? (float)(view - before) / (float)(after - before) : after >= 0;
        out[c] = a + t * (b - a);
    }
}

static int imaging_partner(const struct oxl_imaging *m, int view)
{
    const int partner = m->partner[view];
    return partner >= 0 && m->known[partner] ? partner : -1;
}

/* Measures the deviation of a known view's log gains from the line between its neighbours. */
static void imaging_deviation(const struct oxl_imaging *m, int view, double out[3])
{
    float between[3];
    imaging_interpolate(m, view, between);
    for (int c = 0; c < 3; c++) out[c] = (double)m->log_gain[3 * view + c] - (double)between[c];
}

/* Fits the factor, 0 to 1, by which a partner's deviation predicts a view's own, by least
 * squares over the known views. */
static double imaging_fraction(const struct oxl_imaging *m)
{
    double xx = 0, xy = 0;
    for (int i = 0; i < m->views; i++) {
        const int j = m->known[i] ? imaging_partner(m, i) : -1;
        double own[3], other[3];
        if (j < 0) continue;
        imaging_deviation(m, i, own), imaging_deviation(m, j, other);
        for (int c = 0; c < 3; c++) xx += other[c] * other[c], xy += own[c] * other[c];
    }
    return xx > 0 ? OXL_CLAMP(xy / xx, 0, 1) : 0;
}

OXL_INTERNAL void imaging_predict(const struct oxl_imaging *m, int view, float out[3])
{
    const int partner = imaging_partner(m, view);
    const double fraction = partner >= 0 ? imaging_fraction(m) : 0;
    double other[3];
    imaging_interpolate(m, view, out);
    if (partner < 0) return;
    imaging_deviation(m, partner, other);
    for (int c = 0; c < 3; c++) out[c] += (float)(fraction * other[c]);
}

OXL_INTERNAL oxl_result imaging_check_scene(oxl_context *ctx, const oxl_scene *scene,
                                            const oxl_imaging *imaging)
{
    if (!imaging || !imaging->views || imaging->views == scene->view_count) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_USAGE, "the imaging is of %d views, the scene has %d\nfix: pass the model's",
                    imaging->views, scene->view_count);
}

void oxl_imaging_gain(const oxl_imaging *m, int view, float out[3])
{
    if (!m || !m->on || view < 0 || view >= m->views) out[0] = out[1] = out[2] = 0;
    else if (m->known[view]) memcpy(out, m->log_gain + 3 * view, 3 * sizeof *out);
    else imaging_predict(m, view, out);
    for (int c = 0; c < 3; c++) out[c] = (float)vecmath_exp(out[c]);
}

OXL_INTERNAL void imaging_apply(const struct oxl_imaging *m, int view, oxl_image *image)
{
    const size_t plane = (size_t)image->width * image->height;
    float gain[3];
    if (!m->on) return;
    oxl_imaging_gain(m, view, gain);
    for (size_t c = 0; c < 3; c++)
        for (size_t i = c * plane; i < (c + 1) * plane; i++) image->rgb[i] *= gain[c];
}

OXL_INTERNAL double imaging_mean(const struct oxl_imaging *m, int channel)
{
    double sum = 0;
    int count = 0;
    for (int i = 0; i < m->views; i++)
        if (m->known[i]) sum += m->log_gain[3 * i + channel], count++;
    return count ? sum / count : 0;
}

OXL_INTERNAL void imaging_centre(struct oxl_imaging *m, const double mean[3])
{
    for (int c = 0; c < 3; c++) {
        const double shift = mean[c] - imaging_mean(m, c);
        for (int i = 0; i < m->views; i++)
            if (m->known[i]) m->log_gain[3 * i + c] = (float)(m->log_gain[3 * i + c] + shift);
    }
}

/* ---------------- the lamp */

/* Lists the degrees of the terms in y and in x. Legendre polynomials have the mean 0 over -1..1, but for the
 * constant, which is left out. */
static const int lamp_terms[LAMP_TERMS][2] = {{0, 1}, {0, 2}, {0, 3}, {0, 4}, {1, 0}, {1, 1}, {1, 2},
                                              {1, 3}, {2, 0}, {2, 1}, {2, 2}, {3, 0}, {3, 1}, {4, 0}};

/* Lists coefficients: Legendre polynomial n is the sum over k of [n][k] x^k. */
static const float lamp_legendre[LAMP_DEGREE + 1][LAMP_DEGREE + 1] = {
    {1}, {0, 1}, {-0.5f, 0, 1.5f}, {0, -1.5f, 0, 2.5f}, {0.375f, 0, -3.75f, 0, 4.375f}};

static void lamp_evaluate(float x, float out[LAMP_DEGREE + 1])
{
    for (int n = 0; n <= LAMP_DEGREE; n++) {
        out[n] = 0;
        for (int k = LAMP_DEGREE; k >= 0; k--) out[n] = out[n] * x + lamp_legendre[n][k];
    }
}

OXL_INTERNAL void lamp_terms_at(float x, float y, float term[LAMP_TERMS])
{
    float px[LAMP_DEGREE + 1], py[LAMP_DEGREE + 1];
    lamp_evaluate(x, px), lamp_evaluate(y, py);
    for (int t = 0; t < LAMP_TERMS; t++) term[t] = py[lamp_terms[t][0]] * px[lamp_terms[t][1]];
}

OXL_INTERNAL double lamp_log_gain(const float shape[LAMP_TERMS], float x, float y)
{
    float term[LAMP_TERMS];
    double sum = 0;
    lamp_terms_at(x, y, term);
    for (int t = 0; t < LAMP_TERMS; t++) sum += shape[t] * term[t];
    return sum;
}

OXL_INTERNAL void lamp_row(const float shape[LAMP_TERMS], const struct lamp_area *area, int y,
                           float a[LAMP_DEGREE + 1])
{
    float py[LAMP_DEGREE + 1];
    lamp_evaluate(lamp_coordinate(area->y + (float)y, area->full_height), py);
    memset(a, 0, (LAMP_DEGREE + 1) * sizeof *a);
    for (int t = 0; t < LAMP_TERMS; t++)
        for (int k = 0; k <= LAMP_DEGREE; k++)
            a[k] += shape[t] * py[lamp_terms[t][0]] * lamp_legendre[lamp_terms[t][1]][k];
}

OXL_INTERNAL void lamp_add_row(const struct lamp_area *area, int y, const double power[LAMP_DEGREE + 1],
                               double sum[LAMP_TERMS])
{
    float py[LAMP_DEGREE + 1];
    lamp_evaluate(lamp_coordinate(area->y + (float)y, area->full_height), py);
    for (int t = 0; t < LAMP_TERMS; t++)
        for (int k = 0; k <= LAMP_DEGREE; k++)
            sum[t] += (double)py[lamp_terms[t][0]] * lamp_legendre[lamp_terms[t][1]][k] * power[k];
}

#ifdef OXL_VULKAN
OXL_INTERNAL double lamp_coefficient(int term, int j, int k)
{
    return (double)lamp_legendre[lamp_terms[term][0]][j] * (double)lamp_legendre[lamp_terms[term][1]][k];
}
#endif

OXL_INTERNAL void lamp_gain(const float shape[LAMP_TERMS], const struct lamp_area *area, float *gain)
{
    for (int y = 0; y < area->height; y++) {
        float a[LAMP_DEGREE + 1];
        lamp_row(shape, area, y, a);
        for (int i = 0; i < area->width; i++) {
            const float x = lamp_coordinate(area->x + (float)i, area->full_width);
            gain[(size_t)y * area->width + (size_t)i] =
                (float)vecmath_exp(a[0] + x * (a[1] + x * (a[2] + x * (a[3] + x * a[4]))));
        }
    }
}

/* Returns 1 if the view is the first of its camera, and this camera has enough training views for a lamp of
 * its own, but not all of them. */
static int lamp_is_separate(const oxl_scene *scene, int view)
{
    const uint64_t camera = imaging_camera(scene, view);
    int count = 0, others = 0;
    for (int i = 0; i < view; i++)
        if (imaging_camera(scene, i) == camera) return 0;
    for (int i = 0; i < scene->view_count; i++) {
        const int trains = !scene->view[i].is_test, own = imaging_camera(scene, i) == camera;
        count += trains && own;
        others += trains && !own;
        if (count >= LAMP_VIEWS && others > 0) return 1;
    }
    return 0;
}

OXL_INTERNAL int imaging_set_lamps(const oxl_scene *scene, struct lamp lamp[LAMP_MAX])
{
    int count = 1;
    lamp[0] = (struct lamp){.view = -1};
    for (int i = 0; i < scene->view_count && count < LAMP_MAX; i++)
        if (lamp_is_separate(scene, i)) lamp[count++] = (struct lamp){.view = i};
    return count;
}

OXL_INTERNAL int imaging_find_lamp(const oxl_scene *scene, const struct lamp *lamp, int lamps, int view)
{
    const uint64_t camera = lamps > 1 || (lamps == 1 && lamp->view >= 0) ? imaging_camera(scene, view) : 0;
    int others = -1;
    for (int i = 0; i < lamps; i++) {
        if (lamp[i].view < 0) others = i;
        else if (imaging_camera(scene, lamp[i].view) == camera) return i;
    }
    return others;
}

OXL_INTERNAL const struct lamp *imaging_lamp(const struct oxl_imaging *m, const oxl_scene *scene, int view)
{
    const int which = imaging_find_lamp(scene, m->lamp, m->lamps, view);
    return which < 0 ? NULL : &m->lamp[which];
}

OXL_INTERNAL oxl_result imaging_apply_lamp(oxl_context *ctx, const oxl_scene *scene,
                                           const struct oxl_imaging *m, int view, oxl_image *image)
{
    const struct lamp *lamp = imaging_lamp(m, scene, view);
    const size_t plane = (size_t)image->width * image->height;
    float *gain;
    if (!lamp) return OXL_OK;
    gain = oxl_alloc(ctx, plane, sizeof *gain);
    if (!gain) return OXL_ERR_MEMORY;
    lamp_gain(lamp->shape,
              &(struct lamp_area){image->width, image->height, image->width, image->height, 0, 0}, gain);
    for (size_t i = 0; i < 3 * plane; i++) image->rgb[i] *= gain[i % plane];
    oxl_free(ctx, gain);
    return OXL_OK;
}

OXL_INTERNAL void imaging_hide(struct oxl_imaging *m, int gains)
{
    if (gains && imaging_is_gains_alone(m)) m->on = 0;
    m->medium = (struct medium){0};
}

OXL_INTERNAL int imaging_alters_colours(const struct oxl_imaging *m)
{
    return m->medium.on;
}

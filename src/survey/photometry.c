/* photometry.c - measures exposure, lamp and medium from the colours that tracks have in several images,
 * before any training.
 *
 * A point seen from several ranges r identifies attenuation and backscatter without a model of the scene:
 *     I = exp(a + s(x, y)) (J exp(-bD r) + Binf (1 - exp(-bB r)))          (Akkaynak & Treibitz 2018)
 * for each channel, with J its own colour, a the log gain of the image and channel, and s the polynomial of
 * the camera's lamp or vignetting. J is eliminated (variable projection, Golub & Pereyra 1973); bD, bB and
 * Binf, by their logarithms, s and a are found by damped Gauss-Newton steps on squared residuals with Huber's
 * weights. On a straight path a drift of gains, and on flat ground s, do what attenuation does: priors of
 * zero mean on a and s decide then, and without a medium one of the points' colours. A lamp's falloff with
 * range counts as attenuation.
 *
 * Each part is left out once: the growth of the residuals is the evidence for it. What has none is not in the
 * last fit.
 *
 * Invariant: a function of the scene. Sums follow the file order of points and the name order of views.
 */
#include "sparse.h"
#include "image.h"
#include "imaging.h"
#include "photometry.h"
#include "scene.h"
#include "survey.h"
#include "../core/vecmath.h"
#include "tracks.h"

/* Leaves out patches that are darker than this, or brighter than the next (fractions of white). */
#define PHOTOMETRY_DARK 0.02
#define PHOTOMETRY_BRIGHT 0.98
/* Starts the fit at this log of the attenuation over the median range; from -0.7 it went astray in 7C. */
#define PHOTOMETRY_START 0.2
#define PHOTOMETRY_VEIL -1.2 /* Starts the fit at this log of Binf. */
/* Weights the square of a channel's sum of log gains, so that their mean is 0. */
#define PHOTOMETRY_CENTRE 1e3
/* Sets the size of a residual, in sigma, from which on it counts less (Huber). */
#define PHOTOMETRY_HUBER 1.5
/* Makes the median of absolute values the standard deviation of a normal distribution. */
#define PHOTOMETRY_NORMAL 1.48
/* Bounds sigma from below (fraction of white), since synthetic tracks may be exact. */
#define PHOTOMETRY_SIGMA_MIN 1e-4
/* Adds this fraction to the diagonal at the start (Levenberg-Marquardt). */
#define PHOTOMETRY_DAMPING 1e-3
#define PHOTOMETRY_DAMPING_MIN 1e-6 /* Bounds the fraction added to the diagonal from below. */
#define PHOTOMETRY_DAMPING_MAX 1e4  /* Ends the search at this fraction added to the diagonal. */
/* Multiplies the fraction added to the diagonal after a step that does not lower the cost. */
#define PHOTOMETRY_HARDER 10
/* Multiplies the fraction added to the diagonal after a step that lowers the cost. */
#define PHOTOMETRY_EASIER 0.2
/* Ends the search after a step that lowers the cost by a smaller fraction. */
#define PHOTOMETRY_GAIN_MIN 1e-4
#define PHOTOMETRY_RADIUS 1.0 /* Sets half the side (px) of a patch in the point's farthest view. */
#define PHOTOMETRY_WIDE 5.0   /* Limits half the side (px) of a patch in nearer views. */
/* Lists standard deviations of the priors: logs of attenuation over the median range, of bB / bD, of Binf;
 * gains; the lamps' common shape, and a camera's deviation from it. In clear water the tracks hardly
 * determine bB, and a wrong one costs 2 dB (docs/log/IMAGING.md). */
static const double photometry_prior[6] = {1.5, 0.2, 1.5, 0.2, 0.3, 0.1};
/* Sets the standard deviation of the prior of a channel's log gain less the mean of its view's three: of
 * white balance, which cameras change less than exposure. What images differ by from one to the next
 * overrules it; without it, a small error of colour in each pair of images adds up along a strip, and ground
 * whose colour is the same in all images ends blue and red. */
#define PHOTOMETRY_CHROMA 0.05
/* Lists the least growth of the residuals without the medium, lamp, gains that is evidence for a part. In
 * surveys with a medium they grow to 2 to 4 times, in those without to 1.01 times (docs/log/IMAGING.md); a
 * lamp gains nothing at 1.09 times, 0.3 dB at 1.21 (docs/log/IMAGING.md). */
static const double photometry_evidence[3] = {0.1, 0.15, 0.02};
/* Sets the standard deviation of the prior of points' own colours, of their mean, where no medium is fitted:
 * along a strip a lamp's slope across it may as well be theirs, and gains of one survey were 0.45 to 4.4,
 * with the prior 0.7 to 1.7 (docs/log/IMAGING.md). */
#define PHOTOMETRY_COLOUR 0.25
/* Bounds from below the growth without a lamp's shape for each camera: if points cover only a part of the
 * images, these shapes are ill determined. */
#define PHOTOMETRY_SEPARATE 0.1

/* ---------------- which points in which images */

/* Chooses the training views, or every k-th view of each camera if there are too many: every k-th of all
 * might be those of one camera of a stereo pair. */
OXL_INTERNAL void photometry_choose_views(const oxl_scene *scene, const struct colmap *c,
                                          struct photometry_work *w)
{
    const int views = oxl_scene_view_count(scene);
    int train = 0;
    int64_t seen[LAMP_MAX] = {0};
    for (int i = 0; i < views; i++) train += !oxl_scene_view(scene, i)->is_test;
    for (size_t i = 0; i < c->image_count; i++) w->view[i] = -1;
    for (int i = 0; i < views; i++) {
        const int lamp = imaging_find_lamp(scene, w->lamp, w->lamps, i),
                  most = OXL_MAX(train, PHOTOMETRY_VIEWS);
        if (oxl_scene_view(scene, i)->is_test) continue;
        seen[lamp]++;
        if ((seen[lamp] - 1) * PHOTOMETRY_VIEWS / most == seen[lamp] * PHOTOMETRY_VIEWS / most) continue;
        w->view[scene_source_image(scene, i) - c->image] = w->views;
        w->lamp_of[w->views] = lamp;
        w->chosen[w->views++] = i;
    }
}

static void photometry_project(const oxl_scene *scene, const struct photometry_work *w, double median,
                               struct photometry_sample *s)
{
    const oxl_camera *c = &oxl_scene_view(scene, w->chosen[s->view])->camera;
    double x[3], pixel[2];
    s->valid = scene_project_point(scene, w->chosen[s->view], s->point, x, pixel);
    if (!s->valid) return;
    s->z = x[2] / c->fx;
    s->range = sqrt(x[0] * x[0] + x[1] * x[1] + x[2] * x[2]) / median;
    s->x = (float)pixel[0];
    s->y = (float)pixel[1];
    lamp_terms_at(2 * s->x / (float)c->width - 1, 2 * s->y / (float)c->height - 1, s->term);
}

/* Takes points with all their chosen views; every k-th point if there are too many. */
static void photometry_choose_samples(const oxl_scene *scene, double median, struct photometry_work *w)
{
    const struct colmap *c = scene_colmap(scene);
    struct tracks_walk all = tracks_of(c, w->view);
    size_t count = 0;
    while (tracks_next(&all)) count++;
    for (size_t i = 0; i < c->point_count; i += count / PHOTOMETRY_SAMPLE + 1) {
        const size_t first = w->samples;
        struct tracks_walk own = tracks_of_point(c, w->view, i);
        double farthest = 0;
        own.origin = oxl_scene_origin(scene);
        while (w->samples < PHOTOMETRY_SAMPLE && w->samples - first < PHOTOMETRY_TRACK && tracks_next(&own)) {
            struct photometry_sample *s = &w->sample[w->samples];
            *s = (struct photometry_sample){.point = i, .view = own.view, .lamp = w->lamp_of[own.view]};
            photometry_project(scene, w, median, s);
            if (s->valid) w->samples++, farthest = OXL_MAX(farthest, s->z);
        }
        if (w->samples - first < PHOTOMETRY_FEWEST) w->samples = first;
        for (size_t k = first; k < w->samples; k++)
            w->sample[k].size =
                (float)OXL_MIN(PHOTOMETRY_RADIUS * farthest / w->sample[k].z, PHOTOMETRY_WIDE);
    }
}

/* Averages the colour of the patch; the sample becomes invalid if the patch is not
 * inside the image or is masked. */
static void photometry_sample_colour(const struct training_image *image, struct photometry_sample *s)
{
    const size_t plane = (size_t)image->width * (size_t)image->height;
    const int x0 = (int)(s->x - s->size), x1 = (int)(s->x + s->size), y0 = (int)(s->y - s->size),
              y1 = (int)(s->y + s->size);
    double sum[3] = {0, 0, 0};
    const double n = (double)(x1 - x0 + 1) * (y1 - y0 + 1) * 255;
    s->valid = s->x >= s->size && s->y >= s->size && x1 < image->width && y1 < image->height;
    for (int y = y0; y <= y1 && s->valid; y++)
        for (int x = x0; x <= x1; x++) {
            const size_t i = (size_t)y * (size_t)image->width + (size_t)x;
            if (image->mask && image->mask[i] < 128) s->valid = 0;
            for (int c = 0; c < 3; c++) sum[c] += image->rgb[i + (size_t)c * plane];
        }
    for (int c = 0; c < 3 && s->valid; c++) {
        s->value[c] = (float)(sum[c] / n);
        s->weight[c] = s->value[c] >= PHOTOMETRY_DARK && s->value[c] <= PHOTOMETRY_BRIGHT;
    }
}

static oxl_result photometry_sample_colours(oxl_context *ctx, const oxl_scene *scene,
                                            struct photometry_work *w)
{
    for (int v = 0; v < w->views; v++) {
        const struct training_image *image;
        if (context_stopped(ctx) != OXL_OK) return OXL_ERR_INTERRUPTED;
        scene_images_ahead(ctx, scene, w->chosen + v, w->views - v);
        image = scene_image(ctx, scene, w->chosen[v]);
        if (!image && ctx->failed != OXL_ERR_INPUT) return ctx->failed;
        for (size_t i = 0; i < w->samples; i++) {
            if (w->sample[i].view != v) continue;
            if (image) photometry_sample_colour(image, &w->sample[i]);
            else w->sample[i].valid = 0;
        }
    }
    return OXL_OK;
}

/* Removes unusable samples, and points that have too few left. */
static void photometry_compact(struct photometry_work *w)
{
    size_t kept = 0;
    for (size_t first = 0, end; first < w->samples; first = end) {
        const size_t start = kept;
        for (end = first; end < w->samples && w->sample[end].point == w->sample[first].point; end++)
            if (w->sample[end].valid) w->sample[kept++] = w->sample[end];
        if (kept - start < PHOTOMETRY_FEWEST) kept = start;
    }
    w->samples = kept;
}

/* ---------------- the model of a point in one channel */

struct photometry_point {
    int count;
    const struct photometry_form *form; /* (count,3) of the channel on, */
    double *rest;                       /* as w->rest from there */
    double j, aa;
};

/* Evaluates what the model of all samples has of the parameters `at`; it does not change with the weights. */
static void photometry_evaluate(struct photometry_work *w, const double *at)
{
    const int medium = w->free & PHOTOMETRY_MEDIUM, lamp = w->free & PHOTOMETRY_LAMP;
    double m[9] = {0};
    for (int i = 0; i < 9 && medium; i++) m[i] = vecmath_exp(at[i]);
    for (size_t i = 0; i < 3 * w->samples; i++) {
        const struct photometry_sample *s = &w->sample[i / 3];
        struct photometry_form *f = &w->form[i];
        const int c = (int)(i % 3);
        double gain = at[w->gains + 3 * s->view + c], left;
        for (int t = 0; t < LAMP_TERMS && lamp; t++)
            gain += (at[9 + t] + (s->lamp ? at[9 + LAMP_TERMS * s->lamp + t] : 0)) * (double)s->term[t];
        gain = vecmath_exp(OXL_CLAMP(gain, -5, 5));
        *f = (struct photometry_form){.a = gain};
        if (!medium) continue;
        left = vecmath_exp(-m[3 + c] * s->range);
        f->a = gain * vecmath_exp(-m[c] * s->range);
        f->b = gain * m[6 + c] * (1 - left);
        f->through = -f->a * m[c] * s->range;
        f->near = gain * m[6 + c] * m[3 + c] * s->range * left;
    }
}

/* Finds the point's colour J in a channel that fits its samples and the prior best, sets their w->rest, and
 * adds to the sums of w. */
static void photometry_find_colour(struct photometry_work *w, size_t first, int c, struct photometry_point *p)
{
    const struct photometry_sample *s = &w->sample[first];
    double ab = w->pull[c] * w->mean[c];
    p->form = &w->form[3 * first + (size_t)c], p->rest = &w->rest[3 * first + (size_t)c];
    p->aa = w->pull[c];
    for (int k = 0; k < p->count; k++) {
        const double a = p->form[3 * k].a, by = (double)s[k].weight[c] * a;
        p->aa += by * a;
        ab += by * (s[k].value[c] - p->form[3 * k].b);
    }
    p->j = p->aa > 0 ? ab / p->aa : 0;
    if (p->aa > w->pull[c]) w->sum[c] += p->j, w->seen[c]++;
    w->pulled += w->pull[c] * (p->j - w->mean[c]) * (p->j - w->mean[c]);
    for (int k = 0; k < p->count; k++)
        p->rest[3 * k] = s[k].value[c] - p->form[3 * k].a * p->j - p->form[3 * k].b;
}

static int photometry_track(const struct photometry_work *w, size_t first)
{
    size_t end = first;
    while (end < w->samples && w->sample[end].point == w->sample[first].point) end++;
    return (int)(end - first);
}

/* Computes w->rest at the parameters `at`, by the present weights. */
static void photometry_find_residuals(struct photometry_work *w, const double *at)
{
    struct photometry_point p;
    photometry_evaluate(w, at);
    memset(w->sum, 0, sizeof w->sum);
    memset(w->seen, 0, sizeof w->seen);
    w->pulled = 0;
    for (size_t first = 0; first < w->samples; first += (size_t)p.count) {
        p.count = photometry_track(w, first);
        for (int c = 0; c < 3; c++) photometry_find_colour(w, first, c, &p);
    }
}

/* Returns Huber's cost of w->rest in units of sigma^2; with `reweigh` also sets the
 * weights for the next step. */
static double photometry_cost(struct photometry_work *w, int reweigh)
{
    double sum = w->pulled / (w->sigma * w->sigma);
    for (size_t i = 0; i < 3 * w->samples; i++) {
        float *weight = &w->sample[i / 3].weight[i % 3];
        const double e = fabs(w->rest[i]) / w->sigma;
        if (*weight <= 0) continue;
        sum += e <= PHOTOMETRY_HUBER ? e * e : PHOTOMETRY_HUBER * (2 * e - PHOTOMETRY_HUBER);
        if (reweigh) *weight = (float)(e <= PHOTOMETRY_HUBER ? 1 : PHOTOMETRY_HUBER / e);
    }
    return sum;
}

/* Estimates the standard deviation of w->rest from the median of the absolute values. */
static double photometry_sigma(const struct photometry_work *w)
{
    size_t n = 0;
    for (size_t i = 0; i < 3 * w->samples; i++)
        if (w->sample[i / 3].weight[i % 3] > 0) w->scratch[n++] = fabs(w->rest[i]);
    return OXL_MAX(n ? PHOTOMETRY_NORMAL * stats_select(w->scratch, n, 0.5) : 1, PHOTOMETRY_SIGMA_MIN);
}

/* ---------------- normal equations */

static void photometry_add(struct photometry_work *w, int row, int column, double value)
{
    if (row < column) OXL_SWAP(int, row, column);
    w->normal[(size_t)row * PHOTOMETRY_PARAMETERS + (size_t)column] += value;
}

static double *photometry_row(struct photometry_work *w, int row)
{
    return w->normal + (size_t)row * PHOTOMETRY_PARAMETERS;
}

/* Counts the derivatives of a sample or point: by a channel's three parameters of the medium, then by lamp
 * terms, in the order of the parameters from 9 on. */
enum { PHOTOMETRY_SHARED = 3 + LAMP_MAX * LAMP_TERMS };

/* Adds `by` times v, for the lamp terms from `first` on, to a row of the normal equations. What is added
 * beyond the diagonal is not read. */
static void photometry_add_terms(double *row, int first, double by, const double *v)
{
    for (int t = 0; t < LAMP_TERMS; t++) row[9 + first + t] += by * v[3 + first + t];
}

/* Subtracts from a row what the point's colour explains, `by` times u / aa. */
static void photometry_subtract(double *row, int c, int count, double by, const double *u, double aa)
{
    double *to = row + 6;
    for (int j = 0; j < 3 && j < count; j++) row[3 * j + c] += -by * u[j] / aa;
    for (int j = 3; j < count; j++) to[j] += -by * u[j] / aa;
}

/* Eliminates the point's colour J from the equations (Schur complement), since there are far
 * more points than parameters. */
static void photometry_eliminate(struct photometry_work *w, const struct photometry_sample *s, int c,
                                 const struct photometry_point *p, const double *u, const double *gains,
                                 int shared)
{
    for (int i = w->free & PHOTOMETRY_MEDIUM ? 0 : 3; i < shared; i++)
        photometry_subtract(photometry_row(w, i < 3 ? 3 * i + c : 6 + i), c, i + 1, u[i], u, p->aa);
    for (int k = 0; k < p->count && (w->free & PHOTOMETRY_GAINS); k++) {
        const int own = w->gains + 3 * s[k].view + c;
        photometry_subtract(photometry_row(w, own), c, shared, gains[k], u, p->aa);
        for (int l = 0; l <= k; l++)
            photometry_add(w, own, w->gains + 3 * s[l].view + c, -gains[k] * gains[l] / p->aa);
    }
}

static void photometry_add_point(struct photometry_work *w, const struct photometry_sample *s, int c,
                                 const struct photometry_point *p)
{
    /* Leaves out fixed parameters, which need no equations. */
    const int medium = w->free & PHOTOMETRY_MEDIUM, terms = w->free & PHOTOMETRY_LAMP ? LAMP_TERMS : 0;
    const int shared = 3 + terms * (w->apart ? w->lamps : 1);
    double u[PHOTOMETRY_SHARED] = {0}, gains[PHOTOMETRY_TRACK];
    if (!(p->aa > 0)) return;
    for (int k = 0; k < p->count; k++) {
        const struct photometry_form *f = &p->form[3 * k];
        const double seen = f->a * p->j + f->b, weight = s[k].weight[c];
        const int own = w->gains + 3 * s[k].view + c, lamp = w->apart ? LAMP_TERMS * s[k].lamp : 0;
        double d[PHOTOMETRY_SHARED], *gain = photometry_row(w, own);
        d[0] = f->through * p->j, d[1] = f->near, d[2] = f->b;
        for (int t = 0; t < terms; t++) d[3 + t] = d[3 + lamp + t] = seen * (double)s[k].term[t];
        gains[k] = weight * f->a * seen;
        /* Takes the medium, the common shape, then the camera's own shape. */
        for (int part = medium ? 0 : 1; part < 3; part++) {
            const int first = part == 0 ? 0 : part == 1 ? 3 : 3 + lamp, end = part == 0 ? 3 : first + terms;
            for (int i = first; i < end && (part < 2 || lamp > 0); i++) {
                const double by = weight * d[i];
                const int at = i < 3 ? 3 * i + c : 6 + i;
                double *row = photometry_row(w, at);
                for (int j = 0; j < 3 && j <= i; j++) row[3 * j + c] += by * d[j];
                if (part > 0) photometry_add_terms(row, 0, by, d);
                if (part > 1) photometry_add_terms(row, lamp, by, d);
                gain[at] += by * seen;
                u[i] += weight * f->a * d[i];
                w->right[at] += by * p->rest[3 * k];
            }
        }
        gain[own] += weight * seen * seen;
        w->right[own] += weight * seen * p->rest[3 * k];
    }
    photometry_eliminate(w, s, c, p, u, gains, shared);
}

static int photometry_is_free(const struct photometry_work *w, int index)
{
    if (index >= 9 + LAMP_TERMS && index < w->gains && !w->apart) return 0;
    return w->free & (index < 9 ? PHOTOMETRY_MEDIUM : index < w->gains ? PHOTOMETRY_LAMP : PHOTOMETRY_GAINS);
}

static double photometry_prior_sigma(const struct photometry_work *w, int index)
{
    return photometry_prior[index < 9 ? index / 3 : index >= w->gains ? 3 : index < 9 + LAMP_TERMS ? 4 : 5];
}

/* Returns the mean of the prior; that of bB is the present bD. */
static double photometry_prior_mean(const double *at, int index)
{
    /* log 0.5 over the median range; log 0.3 of white */
    return index < 3 ? -0.7 : index < 6 ? at[index - 3] : index < 9 ? -1.2 : 0;
}

/* Returns a log gain less the mean of its view's three. */
static double photometry_chroma(const struct photometry_work *w, const double *at, int index)
{
    const double *of = at + index - (index - w->gains) % 3;
    return at[index] - (of[0] + of[1] + of[2]) / 3;
}

static double photometry_prior_cost(const struct photometry_work *w, const double *at)
{
    double sum = 0;
    for (int i = 0; i < w->parameters; i++) {
        const double e = (at[i] - photometry_prior_mean(at, i)) / photometry_prior_sigma(w, i);
        if (photometry_is_free(w, i)) sum += e * e;
        if (photometry_is_free(w, i) && i >= w->gains)
            sum += pow(photometry_chroma(w, at, i) / PHOTOMETRY_CHROMA, 2);
    }
    return sum;
}

/* Sets the normal equations at w->at, where the model is evaluated. */
static void photometry_normal_equations(struct photometry_work *w)
{
    struct photometry_point p;
    memset(w->normal, 0, sizeof *w->normal * PHOTOMETRY_PARAMETERS * (size_t)w->parameters);
    memset(w->right, 0, sizeof w->right);
    for (size_t first = 0; first < w->samples; first += (size_t)p.count) {
        p.count = photometry_track(w, first);
        for (int c = 0; c < 3; c++) {
            photometry_find_colour(w, first, c, &p);
            photometry_add_point(w, &w->sample[first], c, &p);
        }
    }
    for (int i = 0; i < w->parameters; i++) {
        const double of = w->sigma * w->sigma / (photometry_prior_sigma(w, i) * photometry_prior_sigma(w, i));
        const double e = photometry_prior_mean(w->at, i) - w->at[i];
        photometry_add(w, i, i, of);
        w->right[i] += of * e;
        if (i < 3 || i >= 6) continue;
        photometry_add(w, i - 3, i - 3, of);
        photometry_add(w, i, i - 3, -of);
        w->right[i - 3] -= of * e;
    }
    for (int i = w->gains; i < w->parameters; i++) {
        const double of = w->sigma * w->sigma / (PHOTOMETRY_CHROMA * PHOTOMETRY_CHROMA);
        for (int k = i - (i - w->gains) % 3; k <= i; k++) photometry_add(w, i, k, of * ((i == k) - 1.0 / 3));
        w->right[i] -= of * photometry_chroma(w, w->at, i);
    }
    for (int v = 0; v < w->views; v++) /* Pulls the sum of each channel's gains to 0. */
        for (int k = 0; k <= v; k++)
            for (int c = 0; c < 3; c++)
                photometry_add(w, w->gains + 3 * v + c, w->gains + 3 * k + c, PHOTOMETRY_CENTRE);
    /* Replaces the equations of fixed parameters by the identity. */
    for (int i = 0; i < w->parameters; i++) {
        if (photometry_is_free(w, i)) continue;
        for (int k = 0; k < w->parameters; k++) photometry_row(w, OXL_MAX(i, k))[OXL_MIN(i, k)] = i == k;
        w->right[i] = 0;
    }
}

/* Factors a matrix in place into its lower Cholesky factor; returns 0 if it is not positive definite. */
static int photometry_factor(double *m, int n)
{
    for (int i = 0; i < n; i++) {
        double *row = m + (size_t)i * PHOTOMETRY_PARAMETERS;
        for (int j = 0; j <= i; j++) {
            const double *other = m + (size_t)j * PHOTOMETRY_PARAMETERS;
            double sum = row[j];
            for (int k = 0; k < j; k++) sum -= row[k] * other[k];
            if (i == j && !(sum > 0)) return 0;
            row[j] = i == j ? sqrt(sum) : sum / other[j];
        }
    }
    return 1;
}

/* Solves by the factor, forward and back, in place. */
static void photometry_solve(const double *m, int n, double *x)
{
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++) x[i] -= m[(size_t)i * PHOTOMETRY_PARAMETERS + (size_t)k] * x[k];
        x[i] /= m[(size_t)i * PHOTOMETRY_PARAMETERS + (size_t)i];
    }
    for (int i = n; i-- > 0;) {
        for (int k = i + 1; k < n; k++) x[i] -= m[(size_t)k * PHOTOMETRY_PARAMETERS + (size_t)i] * x[k];
        x[i] /= m[(size_t)i * PHOTOMETRY_PARAMETERS + (size_t)i];
    }
}

/* Estimates sigma, and gives the points' colours their prior in the last fit, where no medium is fitted. */
static void photometry_set_scale(struct photometry_work *w)
{
    w->sigma = photometry_sigma(w);
    if (!w->is_last || w->free & PHOTOMETRY_MEDIUM) return;
    for (int c = 0; c < 3; c++) {
        w->mean[c] = OXL_MAX(w->sum[c] / OXL_MAX(w->seen[c], 1), PHOTOMETRY_SIGMA_MIN);
        w->pull[c] = w->sigma / (PHOTOMETRY_COLOUR * w->mean[c]);
        w->pull[c] *= w->pull[c];
    }
    photometry_find_residuals(w, w->at);
}

/* Takes damped steps from w->at. */
static void photometry_descend(struct photometry_work *w)
{
    /* Gains that are fixed have no step, and are the last parameters. */
    const int count = w->free & PHOTOMETRY_GAINS ? w->parameters : w->gains;
    double damping = PHOTOMETRY_DAMPING, cost = 0;
    int moved = 1; /* 1: the equations are of another place than w->at */
    memset(w->pull, 0, sizeof w->pull);
    photometry_find_residuals(w, w->at);
    for (int step = 0;; step++) {
        double to[PHOTOMETRY_PARAMETERS], x[PHOTOMETRY_PARAMETERS], better;
        if (moved) photometry_set_scale(w);
        if (moved) cost = photometry_cost(w, 1) + photometry_prior_cost(w, w->at);
        if (step == PHOTOMETRY_STEPS) return;
        if (moved) photometry_normal_equations(w);
        memcpy(w->factor, w->normal, sizeof *w->factor * PHOTOMETRY_PARAMETERS * (size_t)count);
        for (int i = 0; i < count; i++) w->factor[(size_t)i * (PHOTOMETRY_PARAMETERS + 1)] *= 1 + damping;
        memcpy(x, w->right, sizeof x);
        if (!photometry_factor(w->factor, count)) return;
        photometry_solve(w->factor, count, x);
        for (int i = 0; i < w->parameters; i++) to[i] = w->at[i] + OXL_CLAMP(x[i], -1, 1);
        photometry_find_residuals(w, to);
        better = photometry_cost(w, 0) + photometry_prior_cost(w, to);
        moved = better < cost;
        if (!moved) {
            damping *= PHOTOMETRY_HARDER;
            if (damping > PHOTOMETRY_DAMPING_MAX) return;
            continue;
        }
        damping = OXL_MAX(damping * PHOTOMETRY_EASIER, PHOTOMETRY_DAMPING_MIN);
        memcpy(w->at, to, sizeof w->at);
        if (cost - better < PHOTOMETRY_GAIN_MIN * better) return;
    }
}

/* Computes the standard errors of the nine logs. Residuals of a point may be correlated, so each point
 * counts as one observation. */
static void photometry_errors(struct photometry_work *w, struct photometry *out)
{
    const double alike = sqrt((double)w->samples / (double)OXL_MAX(out->points, 1));
    photometry_evaluate(w, w->at);
    photometry_normal_equations(w);
    if (!photometry_factor(w->normal, w->parameters)) return;
    for (int i = 0; i < 9; i++) {
        double x[PHOTOMETRY_PARAMETERS] = {0};
        x[i] = 1;
        photometry_solve(w->normal, w->parameters, x);
        out->error[i] = alike * w->sigma * sqrt(OXL_MAX(x[i], 0));
    }
}

/* Refits `parts` from the parameters in w->at, without the others; returns the
 * robust size of the residuals. */
static double photometry_fit(struct photometry_work *w, int parts)
{
    w->free = parts;
    for (int i = 9; i < w->parameters; i++)
        if (!photometry_is_free(w, i)) w->at[i] = 0;
    photometry_descend(w);
    return w->sigma;
}

/* Fits a lamp for each camera after the fit of a common one, and keeps them if the
 * residuals are evidence for that. */
static void photometry_fit_separate_lamps(struct photometry_work *w, int requested, struct photometry *out)
{
    double one[PHOTOMETRY_PARAMETERS], apart;
    if (w->lamps == 1 || !(requested & PHOTOMETRY_LAMP)) return;
    memcpy(one, w->at, sizeof one);
    w->apart = 1;
    apart = photometry_fit(w, requested);
    w->apart = out->residual > (1 + PHOTOMETRY_SEPARATE) * apart;
    if (w->apart) out->residual = apart;
    else memcpy(w->at, one, sizeof one);
}

OXL_INTERNAL int photometry_supports(int part, double growth, double span)
{
    const int unclear = part == 0 && span < SCENE_DEPTH_SPAN_MIN;
    return growth >= 1 + (unclear ? PHOTOMETRY_EVIDENT : photometry_evidence[part]);
}

/* Fits all parts, then without each, a medium that is refused left out from then on, and at last the parts
 * that the residuals are evidence for. span: of the points' depths. */
static void photometry_choose_parts(struct photometry_work *w, int requested, double span,
                                    struct photometry *out)
{
    double all[PHOTOMETRY_PARAMETERS];
    w->parameters = w->gains + 3 * w->views;
    memset(w->at, 0, sizeof w->at);
    for (int i = 0; i < 9; i++) w->at[i] = i < 6 ? PHOTOMETRY_START : PHOTOMETRY_VEIL;
    out->residual = photometry_fit(w, requested);
    photometry_fit_separate_lamps(w, requested, out);
    out->with_medium = out->residual;
    out->parts = requested;
    memcpy(all, w->at, sizeof all);
    for (int k = 0; k < 3; k++) {
        if (!(requested >> k & 1)) continue;
        memcpy(w->at, all, sizeof all);
        out->without[k] = photometry_fit(w, requested & ~(1 << k));
        if (photometry_supports(k, out->without[k] / out->residual, span)) continue;
        out->parts &= ~(1 << k);
        if (k > 0) continue;
        requested = out->parts, out->residual = out->without[0];
        if (w->apart) w->apart = 0, out->residual = photometry_fit(w, requested);
        photometry_fit_separate_lamps(w, requested, out);
        memcpy(all, w->at, sizeof all);
    }
    memcpy(w->at, all, sizeof all);
    w->is_last = 1;
    photometry_fit(w, out->parts);
}

/* Returns Pearson's correlation of gain and mean range over the images; 0: gains are not
 * fitted, or nothing varies. */
static double photometry_drift(const struct photometry_work *w, const struct photometry *p)
{
    double x[PHOTOMETRY_VIEWS] = {0}, sum[2] = {0, 0}, xx = 0, xy = 0, yy = 0;
    int count[PHOTOMETRY_VIEWS] = {0}, views = 0;
    for (size_t i = 0; i < w->samples; i++)
        x[w->sample[i].view] += w->sample[i].range, count[w->sample[i].view]++;
    for (int v = 0; v < w->views; v++) {
        const double *gain = w->at + w->gains + 3 * v, y = gain[0] + gain[1] + gain[2],
                     range = x[v] / OXL_MAX(count[v], 1);
        if (count[v] == 0) continue;
        views++, sum[0] += range, sum[1] += y;
        xx += range * range, xy += range * y, yy += y * y;
    }
    views = OXL_MAX(views, 1);
    xx -= sum[0] * sum[0] / views, xy -= sum[0] * sum[1] / views, yy -= sum[1] * sum[1] / views;
    return (p->parts & PHOTOMETRY_GAINS) && xx > 0 && yy > 0 ? xy / sqrt(xx * yy) : 0;
}

/* Returns the rms over images and channels of the mean of the log gain less that of the other images of the
 * same points. */
static double photometry_unexplained(const struct photometry_work *w)
{
    double apart[3 * PHOTOMETRY_VIEWS] = {0}, square = 0;
    int count[3 * PHOTOMETRY_VIEWS] = {0}, known = 0;
    for (size_t first = 0, end; first < w->samples; first = end) {
        end = first + (size_t)photometry_track(w, first);
        for (int c = 0; c < 3; c++) {
            double sum = 0;
            int used = 0;
            for (size_t i = first; i < end; i++)
                if (w->sample[i].weight[c] > 0) sum += w->at[w->gains + 3 * w->sample[i].view + c], used++;
            for (size_t i = first; i < end && used > 1; i++) {
                const int at = 3 * w->sample[i].view + c;
                const double own = w->at[w->gains + at];
                if (w->sample[i].weight[c] > 0) apart[at] += own - (sum - own) / (used - 1), count[at]++;
            }
        }
    }
    for (int i = 0; i < 3 * w->views; i++)
        if (count[i]) square += apart[i] * apart[i] / ((double)count[i] * count[i]), known++;
    return sqrt(known ? square / known : 0);
}

/* Compares the images' colours with those of the points, which show images that were altered after COLMAP. */
static void photometry_compare_colours(const struct colmap *c, const struct photometry_work *w,
                                       struct photometry *out)
{
    for (int k = 0; k < 3; k++) {
        double seen = 0, own = 0;
        for (size_t i = 0; i < w->samples; i++) {
            seen += (double)w->sample[i].value[k];
            own += c->point[w->sample[i].point].rgb[k] / 255.0;
        }
        out->colour[k] = own > 0 ? seen / own : 0;
    }
}

static void photometry_report(struct photometry_work *w, const oxl_scene *scene, double median, int requested,
                              struct photometry *out)
{
    double n = 0;
    out->observations = w->samples;
    for (size_t i = 0; i < w->samples; i++)
        out->points += i == 0 || w->sample[i].point != w->sample[i - 1].point;
    photometry_choose_parts(w, requested, scene_depth_span(scene), out);
    if (out->parts & PHOTOMETRY_MEDIUM) photometry_errors(w, out);
    for (int c = 0; c < 3 && (out->parts & PHOTOMETRY_MEDIUM); c++) {
        out->attenuation[c] = vecmath_exp(w->at[c]) / median;
        out->backscatter[c] = vecmath_exp(w->at[3 + c]) / median;
        out->veiling_light[c] = vecmath_exp(w->at[6 + c]);
    }
    for (int t = 0; t < LAMP_TERMS * w->lamps; t++)
        out->shape[t / LAMP_TERMS][t % LAMP_TERMS] =
            (float)(w->at[9 + t % LAMP_TERMS] + (t < LAMP_TERMS ? 0 : w->at[9 + t]));
    for (int i = 0; i < 3 * w->views; i++)
        out->log_gain[3 * w->chosen[i / 3] + i % 3] = (float)w->at[w->gains + i];
    out->drift = photometry_drift(w, out);
    out->unexplained = photometry_unexplained(w);
    for (size_t i = 0; i < 3 * w->samples; i++) {
        const struct photometry_sample *at = &w->sample[i / 3];
        if (!(at->weight[i % 3] > 0)) continue;
        out->fitted[w->chosen[at->view]] |= (uint8_t)(1 << i % 3);
        out->brightness += (double)at->value[i % 3], n++;
    }
    out->brightness /= OXL_MAX(n, 1);
}

OXL_INTERNAL oxl_result photometry_begin(oxl_context *ctx, const oxl_scene *scene, struct photometry_work *w,
                                         struct photometry *out)
{
    const size_t views = (size_t)oxl_scene_view_count(scene);
    w->view = oxl_alloc(ctx, scene_colmap(scene)->image_count + 1, sizeof *w->view);
    w->chosen = oxl_alloc(ctx, PHOTOMETRY_VIEWS + 1, sizeof *w->chosen);
    w->sample = oxl_alloc(ctx, PHOTOMETRY_SAMPLE + 1, sizeof *w->sample);
    w->normal = oxl_alloc(ctx, (size_t)PHOTOMETRY_PARAMETERS * PHOTOMETRY_PARAMETERS, sizeof *w->normal);
    w->factor = oxl_alloc(ctx, (size_t)PHOTOMETRY_PARAMETERS * PHOTOMETRY_PARAMETERS, sizeof *w->factor);
    w->form = oxl_alloc(ctx, 3 * PHOTOMETRY_SAMPLE + 1, sizeof *w->form);
    w->scratch = oxl_alloc(ctx, 3 * PHOTOMETRY_SAMPLE + 1, sizeof *w->scratch);
    w->rest = oxl_alloc(ctx, 3 * PHOTOMETRY_SAMPLE + 1, sizeof *w->rest);
    out->log_gain = oxl_calloc(ctx, 3 * views + 1, sizeof *out->log_gain);
    out->fitted = oxl_calloc(ctx, views + 1, sizeof *out->fitted);
    return w->view && w->chosen && w->sample && w->normal && w->factor && w->form && w->scratch && w->rest &&
                   out->log_gain && out->fitted
               ? OXL_OK
               : OXL_ERR_MEMORY;
}

OXL_INTERNAL void photometry_end(oxl_context *ctx, struct photometry_work *w)
{
    OXL_FREE(ctx, w->view, w->chosen, w->sample, w->normal, w->factor, w->form, w->scratch, w->rest);
}

OXL_INTERNAL oxl_result photometry_measure(oxl_context *ctx, const oxl_scene *scene, int parts,
                                           struct photometry *out)
{
    const struct colmap *c = scene_colmap(scene);
    const double median = scene_depth_quantile(scene, 0.5);
    struct photometry_work w = {0};
    oxl_result rc;
    *out = (struct photometry){.requested = parts};
    if (!parts || !c || c->track_count == 0 || !(median > 0)) return OXL_OK;
    rc = photometry_begin(ctx, scene, &w, out);
    w.lamps = imaging_set_lamps(scene, w.lamp);
    w.gains = 9 + w.lamps * LAMP_TERMS;
    if (rc == OXL_OK) photometry_choose_views(scene, c, &w), photometry_choose_samples(scene, median, &w);
    if (rc == OXL_OK) rc = photometry_sample_colours(ctx, scene, &w);
    if (rc == OXL_OK) photometry_compact(&w);
    if (rc == OXL_OK && w.samples >= PHOTOMETRY_ENOUGH) {
        photometry_compare_colours(c, &w, out);
        photometry_report(&w, scene, median, parts, out);
    }
    photometry_end(ctx, &w);
    if (rc != OXL_OK) photometry_free(ctx, out);
    return rc;
}

OXL_INTERNAL void photometry_free(oxl_context *ctx, struct photometry *p)
{
    OXL_FREE(ctx, p->log_gain, p->fitted);
    *p = (struct photometry){0};
}

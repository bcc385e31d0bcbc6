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
#include "photometry.h"
#include "scene.h"
#include "survey.h"
#include "../core/vecmath.h"

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
/* Lists the parameters in their order, with the part that they are of, the standard deviation of their prior,
 * and its mean: logs of attenuation over the median range (0.5), of bB, whose mean is the present bD, and of
 * Binf (0.3 of white); the lamps' common shape, a camera's deviation from it, gains. In clear water the
 * tracks hardly determine bB, and a wrong one costs 2 dB (docs/log/IMAGING.md). */
enum { PHOTOMETRY_BACKSCATTER = 1, PHOTOMETRY_COMMON = 3, PHOTOMETRY_OWN, PHOTOMETRY_GAIN };
static const struct {
    int part;
    double sigma, mean;
} photometry_rows[] = {{PHOTOMETRY_MEDIUM, 1.5, -0.7}, {PHOTOMETRY_MEDIUM, 0.2, 0},
                       {PHOTOMETRY_MEDIUM, 1.5, -1.2}, {PHOTOMETRY_LAMP, 0.3, 0},
                       {PHOTOMETRY_LAMP, 0.1, 0},      {PHOTOMETRY_GAINS, 0.2, 0}};
/* Sets the standard deviation of the prior of a channel's log gain less the mean of its view's three: of
 * white balance, which cameras change less than exposure. What images differ by from one to the next
 * overrules it; without it, a small error of colour in each pair of images adds up along a strip, and ground
 * whose colour is the same in all images ends blue and red. */
#define PHOTOMETRY_CHROMA 0.1
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

struct photometry_form {  /* Holds what a sample's channel has of the parameters. */
    double a, b;          /* I = a J + b; b is dI/d(log Binf), too */
    double through, near; /* dI/d(log bD) / J; dI/d(log bB) */
};
struct photometry_work {
    struct track_samples of;
    float term[PHOTOMETRY_SAMPLE][LAMP_TERMS];
    struct photometry_form form[PHOTOMETRY_SAMPLE][3];
    double rest[PHOTOMETRY_SAMPLE][3], scratch[3 * PHOTOMETRY_SAMPLE]; /* rest: image less model */
    double normal[PHOTOMETRY_PARAMETERS][PHOTOMETRY_PARAMETERS];       /* lower triangles */
    double factor[PHOTOMETRY_PARAMETERS][PHOTOMETRY_PARAMETERS];
    double right[PHOTOMETRY_PARAMETERS], at[PHOTOMETRY_PARAMETERS], sigma;
    /* of a point: sums of weight a dI/d(parameter); 1: there is one; else 0 */
    double u[PHOTOMETRY_PARAMETERS];
    uint8_t is_seen[PHOTOMETRY_PARAMETERS];
    /* of the points' colours, by channel: sum and number, mean, weight of their prior; pulled: its cost of
     * all points, times sigma^2 */
    double sum[3], mean[3], pull[3], pulled;
    int seen[3], is_last; /* is_last: the fit whose result is reported */
    int gains;            /* index of the first gain among the parameters */
    int apart;            /* 1: each camera has a shape of its own */
    int parameters, free; /* number of parameters; PHOTOMETRY_* that are fitted */
};

/* Averages the colour of the patch. */
static int photometry_sample_colour(const struct training_image *image, struct track_sample *s)
{
    const float size = (float)OXL_MIN(PHOTOMETRY_RADIUS * (double)s->near, PHOTOMETRY_WIDE);
    const int from[2] = {(int)(s->x - size), (int)(s->y - size)},
              to[2] = {(int)(s->x + size) + 1, (int)(s->y + size) + 1};
    double sum[3];
    if (s->x < size || s->y < size || !track_sample_sum(image, from, to, sum)) return 0;
    for (int c = 0; c < 3; c++) {
        s->value[c] = (float)(sum[c] / ((double)(to[0] - from[0]) * (to[1] - from[1]) * 255));
        s->weight[c] = s->value[c] >= PHOTOMETRY_DARK && s->value[c] <= PHOTOMETRY_BRIGHT;
    }
    return 1;
}

/* ---------------- the model of a point in one channel */

/* Evaluates what the model of all samples has of the parameters `at`; it does not change with the weights. */
static void photometry_evaluate(struct photometry_work *w, const double *at)
{
    const int medium = w->free & PHOTOMETRY_MEDIUM, lamp = w->free & PHOTOMETRY_LAMP;
    double m[9] = {0};
    for (int i = 0; i < 9 && medium; i++) m[i] = vecmath_exp(at[i]);
    for (size_t i = 0; i < 3 * w->of.count; i++) {
        const struct track_sample *s = &w->of.at[i / 3];
        const int c = (int)(i % 3), own = LAMP_TERMS * w->of.lamp_of[s->view];
        struct photometry_form *f = &w->form[i / 3][c];
        double gain = at[w->gains + 3 * s->view + c], left;
        for (int t = 0; t < LAMP_TERMS && lamp; t++)
            gain += (at[9 + t] + (own ? at[9 + own + t] : 0)) * (double)w->term[i / 3][t];
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
 * adds to the sums of w. Returns J; *aa: its weight. */
static double photometry_find_colour(struct photometry_work *w, size_t first, size_t end, int c, double *aa)
{
    const struct track_sample *s = w->of.at;
    double ab = w->pull[c] * w->mean[c], j;
    *aa = w->pull[c];
    for (size_t k = first; k < end; k++) {
        const double a = w->form[k][c].a, by = (double)s[k].weight[c] * a;
        *aa += by * a;
        ab += by * (s[k].value[c] - w->form[k][c].b);
    }
    j = *aa > 0 ? ab / *aa : 0;
    if (*aa > w->pull[c]) w->sum[c] += j, w->seen[c]++;
    w->pulled += w->pull[c] * (j - w->mean[c]) * (j - w->mean[c]);
    for (size_t k = first; k < end; k++)
        w->rest[k][c] = s[k].value[c] - w->form[k][c].a * j - w->form[k][c].b;
    return j;
}

/* Computes w->rest at the parameters `at`, by the present weights. */
static void photometry_find_residuals(struct photometry_work *w, const double *at)
{
    double aa;
    photometry_evaluate(w, at);
    memset(w->sum, 0, sizeof w->sum);
    memset(w->seen, 0, sizeof w->seen);
    w->pulled = 0;
    for (size_t first = 0, end; first < w->of.count; first = end) {
        end = track_samples_end(&w->of, first);
        for (int c = 0; c < 3; c++) photometry_find_colour(w, first, end, c, &aa);
    }
}

/* Returns Huber's cost of w->rest in units of sigma^2; with `reweigh` also sets the
 * weights for the next step. */
static double photometry_cost(struct photometry_work *w, int reweigh)
{
    double sum = w->pulled / (w->sigma * w->sigma);
    for (size_t i = 0; i < 3 * w->of.count; i++) {
        float *weight = &w->of.at[i / 3].weight[i % 3];
        const double e = fabs(w->rest[i / 3][i % 3]) / w->sigma;
        if (*weight <= 0) continue;
        sum += e <= PHOTOMETRY_HUBER ? e * e : PHOTOMETRY_HUBER * (2 * e - PHOTOMETRY_HUBER);
        if (reweigh) *weight = (float)(e <= PHOTOMETRY_HUBER ? 1 : PHOTOMETRY_HUBER / e);
    }
    return sum;
}

/* Estimates the standard deviation of w->rest from the median of the absolute values. */
static double photometry_sigma(struct photometry_work *w)
{
    size_t n = 0;
    for (size_t i = 0; i < 3 * w->of.count; i++)
        if (w->of.at[i / 3].weight[i % 3] > 0) w->scratch[n++] = fabs(w->rest[i / 3][i % 3]);
    return OXL_MAX(n ? PHOTOMETRY_NORMAL * stats_select(w->scratch, n, 0.5) : 1, PHOTOMETRY_SIGMA_MIN);
}

/* ---------------- normal equations */

/* Returns the row of photometry_rows that a parameter is of. */
static int photometry_row(const struct photometry_work *w, int index)
{
    if (index < 9) return index / 3;
    return index >= w->gains ? PHOTOMETRY_GAIN : index < 9 + LAMP_TERMS ? PHOTOMETRY_COMMON : PHOTOMETRY_OWN;
}

static int photometry_is_free(const struct photometry_work *w, int index)
{
    const int row = photometry_row(w, index);
    return (row != PHOTOMETRY_OWN || w->apart) && (w->free & photometry_rows[row].part);
}

/* Returns the distance of a parameter from the mean of its prior. */
static double photometry_prior(const struct photometry_work *w, const double *at, int index)
{
    const int row = photometry_row(w, index);
    return at[index] - (row == PHOTOMETRY_BACKSCATTER ? at[index - 3] : photometry_rows[row].mean);
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
        const double e = photometry_prior(w, at, i) / photometry_rows[photometry_row(w, i)].sigma;
        if (photometry_is_free(w, i)) sum += e * e;
        if (photometry_is_free(w, i) && i >= w->gains)
            sum += pow(photometry_chroma(w, at, i) / PHOTOMETRY_CHROMA, 2);
    }
    return sum;
}

static void photometry_add(struct photometry_work *w, int row, int column, double value)
{
    w->normal[OXL_MAX(row, column)][OXL_MIN(row, column)] += value;
}

struct photometry_slope { /* Holds a derivative dI/d(parameter) of a sample. */
    int at;
    double by;
};
enum { PHOTOMETRY_SLOPES = 1 + 3 + 2 * LAMP_TERMS };

/* Lists the derivatives of a sample's channel that is J: by the gain, the medium, the common shape, then the
 * camera's own shape; without fixed parameters. Returns their number. */
static int photometry_slopes(const struct photometry_work *w, size_t k, int c, double j,
                             struct photometry_slope out[PHOTOMETRY_SLOPES])
{
    const struct photometry_form *f = &w->form[k][c];
    const double seen = f->a * j + f->b, medium[3] = {f->through * j, f->near, f->b};
    const int view = w->of.at[k].view, own = w->apart ? LAMP_TERMS * w->of.lamp_of[view] : 0;
    int n = 0;
    if (w->free & PHOTOMETRY_GAINS) out[n++] = (struct photometry_slope){w->gains + 3 * view + c, seen};
    for (int i = 0; i < 3 && w->free & PHOTOMETRY_MEDIUM; i++)
        out[n++] = (struct photometry_slope){3 * i + c, medium[i]};
    for (int i = 0; i < (own ? 2 : 1) * LAMP_TERMS && w->free & PHOTOMETRY_LAMP; i++) {
        const int t = i % LAMP_TERMS;
        out[n++] =
            (struct photometry_slope){9 + t + (i < LAMP_TERMS ? 0 : own), seen * (double)w->term[k][t]};
    }
    return n;
}

/* Adds the samples of a point in a channel, and eliminates its colour J from the equations (Schur
 * complement), since there are far more points than parameters. */
static void photometry_add_point(struct photometry_work *w, size_t first, size_t end, int c)
{
    int of[PHOTOMETRY_SLOPES * TRACK_SAMPLES_LONGEST], count = 0;
    double aa;
    const double j = photometry_find_colour(w, first, end, c, &aa);
    if (!(aa > 0)) return;
    for (size_t k = first; k < end; k++) {
        struct photometry_slope d[PHOTOMETRY_SLOPES];
        const int n = photometry_slopes(w, k, c, j, d);
        const double weight = w->of.at[k].weight[c];
        for (int i = 0; i < n; i++) {
            const double by = weight * d[i].by, u = weight * w->form[k][c].a * d[i].by;
            for (int l = 0; l <= i; l++) photometry_add(w, d[i].at, d[l].at, by * d[l].by);
            w->right[d[i].at] += by * w->rest[k][c];
            if (!w->is_seen[d[i].at]) of[count++] = d[i].at;
            w->is_seen[d[i].at] = 1, w->u[d[i].at] += u;
        }
    }
    for (int i = 0; i < count; i++)
        for (int l = 0; l <= i; l++) photometry_add(w, of[i], of[l], -w->u[of[i]] * w->u[of[l]] / aa);
    for (int i = 0; i < count; i++) w->u[of[i]] = w->is_seen[of[i]] = 0;
}

/* Sets the normal equations at w->at, where the model is evaluated. */
static void photometry_normal_equations(struct photometry_work *w)
{
    memset(w->normal, 0, sizeof w->normal);
    memset(w->right, 0, sizeof w->right);
    for (size_t first = 0, end; first < w->of.count; first = end) {
        end = track_samples_end(&w->of, first);
        for (int c = 0; c < 3; c++) photometry_add_point(w, first, end, c);
    }
    for (int i = 0; i < w->parameters; i++) {
        const int row = photometry_row(w, i);
        const double sigma = photometry_rows[row].sigma, of = w->sigma * w->sigma / (sigma * sigma),
                     e = photometry_prior(w, w->at, i);
        if (!photometry_is_free(w, i)) { /* An equation of a fixed parameter is the identity. */
            w->normal[i][i] = 1;
            continue;
        }
        photometry_add(w, i, i, of);
        w->right[i] -= of * e;
        if (row != PHOTOMETRY_BACKSCATTER) continue;
        photometry_add(w, i - 3, i - 3, of);
        photometry_add(w, i, i - 3, -of);
        w->right[i - 3] += of * e;
    }
    for (int i = w->gains; i < w->parameters && w->free & PHOTOMETRY_GAINS; i++) {
        const double of = w->sigma * w->sigma / (PHOTOMETRY_CHROMA * PHOTOMETRY_CHROMA);
        for (int k = i - (i - w->gains) % 3; k <= i; k++) photometry_add(w, i, k, of * ((i == k) - 1.0 / 3));
        w->right[i] -= of * photometry_chroma(w, w->at, i);
        for (int k = i; k >= w->gains; k -= 3) /* Pulls the sum of each channel's gains to 0. */
            photometry_add(w, i, k, PHOTOMETRY_CENTRE);
    }
}

/* Factors a matrix in place into its lower Cholesky factor; returns 0 if it is not positive definite. */
static int photometry_factor(double m[][PHOTOMETRY_PARAMETERS], int n)
{
    for (int i = 0; i < n; i++)
        for (int j = 0; j <= i; j++) {
            double sum = m[i][j];
            for (int k = 0; k < j; k++) sum -= m[i][k] * m[j][k];
            if (i == j && !(sum > 0)) return 0;
            m[i][j] = i == j ? sqrt(sum) : sum / m[j][j];
        }
    return 1;
}

/* Solves by the factor, forward and back, in place. */
static void photometry_solve(double m[][PHOTOMETRY_PARAMETERS], int n, double *x)
{
    for (int i = 0; i < n; i++) {
        for (int k = 0; k < i; k++) x[i] -= m[i][k] * x[k];
        x[i] /= m[i][i];
    }
    for (int i = n; i-- > 0;) {
        for (int k = i + 1; k < n; k++) x[i] -= m[k][i] * x[k];
        x[i] /= m[i][i];
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
        memcpy(w->factor, w->normal, sizeof w->factor);
        for (int i = 0; i < count; i++) w->factor[i][i] *= 1 + damping;
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
    if (w->of.lamps == 1 || !(requested & PHOTOMETRY_LAMP)) return;
    memcpy(one, w->at, sizeof one);
    w->apart = 1;
    apart = photometry_fit(w, requested);
    w->apart = out->residual > (1 + PHOTOMETRY_SEPARATE) * apart;
    if (w->apart) out->residual = apart;
    else memcpy(w->at, one, sizeof one);
}

OXL_INTERNAL int photometry_supports(int part, double growth, double span)
{
    return growth >=
           1 + (part == 0 && span < SCENE_DEPTH_SPAN_MIN ? PHOTOMETRY_EVIDENT : photometry_evidence[part]);
}

/* Fits all parts, then without each, a medium that is refused left out from then on, and at last the parts
 * that the residuals are evidence for. span: of the points' depths. */
static void photometry_choose_parts(struct photometry_work *w, int requested, double span,
                                    struct photometry *out)
{
    double all[PHOTOMETRY_PARAMETERS];
    w->parameters = w->gains + 3 * w->of.views;
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

/* Returns the rms over images and channels of the mean of the log gain less that of the other images of the
 * same points. */
static double photometry_unexplained(const struct photometry_work *w)
{
    double apart[3 * PHOTOMETRY_VIEWS] = {0}, square = 0;
    int count[3 * PHOTOMETRY_VIEWS] = {0}, known = 0;
    for (size_t first = 0, end; first < w->of.count; first = end) {
        end = track_samples_end(&w->of, first);
        for (int c = 0; c < 3; c++) {
            double sum = 0;
            int used = 0;
            for (size_t i = first; i < end; i++)
                if (w->of.at[i].weight[c] > 0) sum += w->at[w->gains + 3 * w->of.at[i].view + c], used++;
            for (size_t i = first; i < end && used > 1; i++) {
                const int at = 3 * w->of.at[i].view + c;
                const double own = w->at[w->gains + at];
                if (w->of.at[i].weight[c] > 0) apart[at] += own - (sum - own) / (used - 1), count[at]++;
            }
        }
    }
    for (int i = 0; i < 3 * w->of.views; i++)
        if (count[i]) square += apart[i] * apart[i] / ((double)count[i] * count[i]), known++;
    return sqrt(known ? square / known : 0);
}

/* Compares the images' colours with those of the points, which show images that were altered after COLMAP. */
static void photometry_compare_colours(const struct colmap *c, const struct photometry_work *w,
                                       struct photometry *out)
{
    for (int k = 0; k < 3; k++) {
        double seen = 0, own = 0;
        for (size_t i = 0; i < w->of.count; i++) {
            seen += (double)w->of.at[i].value[k];
            own += c->point[w->of.at[i].point].rgb[k] / 255.0;
        }
        out->colour[k] = own > 0 ? seen / own : 0;
    }
}

static void photometry_report(struct photometry_work *w, const oxl_scene *scene, double median, int requested,
                              struct photometry *out)
{
    double n = 0;
    out->observations = w->of.count;
    for (size_t i = 0; i < w->of.count; i++)
        out->points += i == 0 || w->of.at[i].point != w->of.at[i - 1].point;
    photometry_choose_parts(w, requested, scene_depth_span(scene), out);
    for (int c = 0; c < 3 && (out->parts & PHOTOMETRY_MEDIUM); c++) {
        out->attenuation[c] = vecmath_exp(w->at[c]) / median;
        out->backscatter[c] = vecmath_exp(w->at[3 + c]) / median;
        out->veiling_light[c] = vecmath_exp(w->at[6 + c]);
    }
    for (int t = 0; t < LAMP_TERMS * w->of.lamps; t++)
        out->shape[t / LAMP_TERMS][t % LAMP_TERMS] =
            (float)(w->at[9 + t % LAMP_TERMS] + (t < LAMP_TERMS ? 0 : w->at[9 + t]));
    for (int i = 0; i < 3 * w->of.views; i++)
        out->log_gain[3 * w->of.chosen[i / 3] + i % 3] = (float)w->at[w->gains + i];
    out->unexplained = photometry_unexplained(w);
    for (size_t i = 0; i < 3 * w->of.count; i++) {
        const struct track_sample *at = &w->of.at[i / 3];
        if (!(at->weight[i % 3] > 0)) continue;
        out->fitted[w->of.chosen[at->view]] |= (uint8_t)(1 << i % 3);
        out->brightness += (double)at->value[i % 3], n++;
    }
    out->brightness /= OXL_MAX(n, 1);
}

/* Puts ranges in units of their median, and evaluates the lamps' terms. */
static void photometry_prepare(const oxl_scene *scene, double median, struct photometry_work *w)
{
    w->gains = 9 + w->of.lamps * LAMP_TERMS;
    for (size_t i = 0; i < w->of.count; i++) {
        struct track_sample *s = &w->of.at[i];
        const oxl_camera *c = &scene->view[w->of.chosen[s->view]].camera;
        s->range /= median;
        lamp_terms_at(2 * s->x / (float)c->width - 1, 2 * s->y / (float)c->height - 1, w->term[i]);
    }
}

OXL_INTERNAL oxl_result photometry_measure(oxl_context *ctx, const oxl_scene *scene, int parts,
                                           struct photometry *out)
{
    const size_t views = (size_t)scene->view_count;
    const double median = scene_depth_quantile(scene, 0.5);
    struct photometry_work *w;
    oxl_result rc = OXL_ERR_MEMORY;
    *out = (struct photometry){.requested = parts};
    if (!parts || !scene_colmap(scene) || scene_colmap(scene)->track_count == 0 || !(median > 0))
        return OXL_OK;
    w = oxl_calloc(ctx, 1, sizeof *w);
    out->log_gain = oxl_calloc(ctx, 3 * views + 1, sizeof *out->log_gain);
    out->fitted = oxl_calloc(ctx, views + 1, sizeof *out->fitted);
    if (w && out->log_gain && out->fitted)
        rc = track_samples_take(ctx, scene, PHOTOMETRY_SAMPLE, PHOTOMETRY_FEWEST, &w->of);
    if (rc == OXL_OK) rc = track_samples_measure(ctx, scene, photometry_sample_colour, &w->of);
    if (rc == OXL_OK && w->of.count >= PHOTOMETRY_ENOUGH) {
        photometry_prepare(scene, median, w);
        photometry_compare_colours(scene_colmap(scene), w, out);
        photometry_report(w, scene, median, parts, out);
    }
    if (w) track_samples_free(ctx, &w->of);
    oxl_free(ctx, w);
    if (rc != OXL_OK) photometry_free(ctx, out);
    return rc;
}

OXL_INTERNAL void photometry_free(oxl_context *ctx, struct photometry *p)
{
    OXL_FREE(ctx, p->log_gain, p->fitted);
    *p = (struct photometry){0};
}

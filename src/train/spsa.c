/* spsa.c - optimises the two depth weights from noisy costs, without a gradient (paper sec. 3.2; Spall 1998, "Implementation of the
 * simultaneous perturbation algorithm for stochastic optimization", IEEE Trans. AES 34(3)).
 *
 * Pair k shifts both weights at once by c_k times random signs, in both directions, and asks for the cost of either point;
 * their difference, over the distance of the two points, is the gradient's estimate. A prior is added to the measured costs:
 * P/2 (f - prior_mean)^2, P = prior_precision. Where the costs are flat, as they are between few noisy pairs, a search without it stays
 * where it began, or drifts. Its curvature is known, and with it the best gain, a_k = 1 / (P (k + 2)) [Spall 1998, III.B: exponent 1]:
 *     f <- project(f - a_k ((cost+ - cost-) / (point+ - point-) + P (f - prior_mean))),   c_k = c / (k + 1)^0.101,
 * after a first step that is independent of the start: f is the mean of prior_mean and of each pair's own estimate,
 * prior_mean - slope / P.
 * Every second pair is perpendicular to the one before it, so that the effect of the other weight cancels (Bhatnagar 2003,
 * "Two-timescale simultaneous perturbation stochastic approximation using deterministic perturbation sequences").
 * The order of the two points is random, so that a drift of the cost has no bias.
 *
 * The search moves in f_mid and f_far - f_mid: so each has a bound of its own, and neither is stuck where f_far = f_mid.
 *
 * Invariants: f_far >= f_mid >= 1 and both at most the cap, for the estimate and for every point. Points are a function of the seed and
 * of the costs.
 */
#include "train.h"
#include "../core/vecmath.h"

#define SPSA_SHIFT_DECAY    0.101
#define SPSA_SHIFT          1.0 /* c: differences over less are lost in the noise of a cost (docs/ABLATION.md) */
#define SPSA_OFFSET_MAX     1.0 /* limit of a single pair's distance from prior_mean: during the first, the loss still falls fast */
#define SPSA_STREAM         (UINT64_C(0x5350534) << 32) /* random numbers apart from those of steps and epochs */
#define SPSA_DISTANCE_LEAST 0.5 /* x c_k: minimum distance of the projected points for a usable difference */

static double spsa_power(double base, double exponent)
{
    return vecmath_exp(exponent * vecmath_log(base));
}

/* Into 1 <= f_mid <= f_far <= cap, one after the other: only the order is the paper's. */
static void spsa_project(double cap, double f[2])
{
    f[0] = OXL_CLAMP(f[0], 1.0, cap);
    f[1] = OXL_CLAMP(f[1], f[0], cap);
}

/* f moved by so much in f_mid and in f_far - f_mid. */
static void spsa_move(double cap, const double f[2], double by_mid, double by_beyond, double out[2])
{
    const double mid = OXL_CLAMP(f[0] + by_mid, 1.0, cap), beyond = OXL_MAX(0, f[1] - f[0] + by_beyond);
    out[0] = mid;
    out[1] = OXL_MIN(mid + beyond, cap);
}

static double spsa_shift(const struct spsa *s)
{
    return SPSA_SHIFT / spsa_power(s->pair + 1, SPSA_SHIFT_DECAY);
}

/* The two points of the pair that begins. */
static void spsa_open_pair(struct spsa *s)
{
    const uint64_t bits   = random_bits(s->seed, SPSA_STREAM, (uint64_t)s->pair);
    const uint64_t signs  = s->pair % 2 ? s->signs ^ 1 : bits >> 62;
    const double   shift  = spsa_shift(s);
    const double   mid    = signs & 2 ? shift : -shift;
    const double   beyond = signs & 1 ? shift : -shift;
    spsa_move(s->cap, s->f, mid, beyond, s->point[0]);
    spsa_move(s->cap, s->f, -mid, -beyond, s->point[1]);
    s->signs = signs;
    s->first = (int)(bits >> 61 & 1);
    s->known = 0;
}

OXL_INTERNAL void spsa_begin(struct spsa *s, const double start[2], const double prior_mean[2], double prior_precision,
                             double cap, uint64_t seed)
{
    memset(s, 0, sizeof *s);
    s->cap             = OXL_MAX(cap, 1.0);
    s->seed            = seed;
    s->prior_precision = prior_precision;
    memcpy(s->f, start, sizeof s->f);
    memcpy(s->prior_mean, prior_mean, sizeof s->prior_mean);
    spsa_project(s->cap, s->f);
    spsa_open_pair(s);
}

OXL_INTERNAL void spsa_ask(const struct spsa *s, double f[2])
{
    memcpy(f, s->point[s->known ? !s->first : s->first], 2 * sizeof *f);
}

static void spsa_step(struct spsa *s)
{
    const double *p = s->point[0], *q = s->point[1], least = SPSA_DISTANCE_LEAST * spsa_shift(s);
    const double  distance[2] = {p[0] - q[0], (p[1] - p[0]) - (q[1] - q[0])}; /* as projected, not as meant */
    for (int i = 0; i < 2; i++) {
        const double slope = fabs(distance[i]) >= least ? (s->cost[0] - s->cost[1]) / distance[i] : 0;
        s->offset_sum[i] += OXL_CLAMP(-slope / s->prior_precision, -SPSA_OFFSET_MAX, SPSA_OFFSET_MAX);
    }
    spsa_move(s->cap, s->prior_mean, s->offset_sum[0] / (s->pair + 2), s->offset_sum[1] / (s->pair + 2), s->f);
}

OXL_INTERNAL int spsa_update(struct spsa *s, double cost)
{
    if (!(fabs(cost) <= DBL_MAX)) {
        spsa_skip(s);
        return 0;
    }
    s->cost[s->known ? !s->first : s->first] = cost;
    if (!s->known++) return 0;
    spsa_step(s);
    s->pair++;
    spsa_open_pair(s);
    return 1;
}

OXL_INTERNAL void spsa_skip(struct spsa *s)
{
    s->known = 0; /* discards half a pair */
}

OXL_INTERNAL void spsa_archive(struct archive *a, struct spsa *s)
{
    archive_doubles(a, s->f, 2);
    archive_doubles(a, s->point[0], 4);
    archive_doubles(a, s->cost, 2);
    archive_doubles(a, &s->cap, 1);
    archive_doubles(a, s->prior_mean, 2);
    archive_doubles(a, s->offset_sum, 2);
    archive_doubles(a, &s->prior_precision, 1);
    archive_u64(a, &s->seed);
    archive_u64(a, &s->signs);
    archive_int(a, &s->pair);
    archive_int(a, &s->known);
    archive_int(a, &s->first);
    archive_expect(a, s->pair >= 0 && s->pair < INT_MAX / 2 && (s->known | 1) == 1 && (s->first | 1) == 1);
}

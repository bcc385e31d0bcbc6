/* synth_light.c - what real surveys add to a static scene: exposure that drifts, and a lamp that moves with
 * the camera.
 *
 *     exposure   an image is multiplied by one gain per channel before noise and rounding: 3/4 of the range
 *     is a slow drift along
 *                the path, 1/4 belongs to the image alone; white balance drifts by a fifth of that.
 *     stereo     both cameras of a pair have its gain, the right one times STEREO_RIGHT.
 *     backscatter light of the lamp, LAMP_AT beside the camera, that the water throws back before it reaches
 *     the surface: single
 *                scattering, the integral of exp(-c (t + d)) h / d^2 along the ray; d: from lamp to there, h:
 *                from lamp to camera.
 *     lamp       the scene's own light J is multiplied by z^-p / z0^-p (z: range, z0: LAMP_RANGE metres), and
 *     the whole image by
 *                a radial gain 1 + a r^2 + b r^4 about a centre beside the image's (r in half diagonals).
 *
 * Invariant: without both options an image is what it was. truth/exposure.txt and truth/lamp.txt hold what
 * was applied.
 */
#include "synth.h"

#define LAMP_RANGE 3.0   /* metres: where the lamp leaves J as it is */
#define LAMP_NEAREST 0.5 /* metres: nearer than that the lamp is as bright as there */
#define EXPOSURE_DRIFT 0.75
#define EXPOSURE_BALANCE 0.2

#define STEREO_RIGHT 0.8
#define BACKSCATTER_END 6.0  /* metres: nothing comes back from farther off */
#define BACKSCATTER_FULL 2.5 /* about the integral towards the lamp in clear water */
enum { BACKSCATTER_STEPS = 24 };
/* metres, in the camera's frame: left, above, a little ahead */
static const v3 lamp_at = {-0.25, -0.45, 0.1};

static const double lamp_centre[2] = {0.46, 0.56}, lamp_radial[2] = {-0.55, 0.12};

static double light_through_water(double direct, double veil, double colour, double range)
{
    return colour * exp(-direct * range) + veil * (1 - exp(-SYNTH_SCATTER * direct * range));
}

v3 synth_through_water(const struct synth_water *w, v3 colour, double range)
{
    return v3_of(light_through_water(w->direct.x, w->veil.x, colour.x, range),
                 light_through_water(w->direct.y, w->veil.y, colour.y, range),
                 light_through_water(w->direct.z, w->veil.z, colour.z, range));
}

/* Draws a number within -1..1, smooth over about a dozen views. */
static double light_drift(uint64_t seed, int view, uint64_t what)
{
    const double a = 2 * SYNTH_PI * synth_unit(synth_bits(seed, 400 + what, 1));
    const double b = 2 * SYNTH_PI * synth_unit(synth_bits(seed, 400 + what, 2));
    return 0.6 * sin(2 * SYNTH_PI * view / (37.0 + (double)what) + a) +
           0.4 * sin(2 * SYNTH_PI * view / (16.0 + (double)what) + b);
}

v3 synth_gain(const synth_options *o, int view)
{
    const double right = o->stereo > 0 && view % 2 ? STEREO_RIGHT : 1;
    double gain[3];
    if (o->stereo > 0) view /= 2;
    if (!(o->exposure_jitter > 0)) return v3_of(right, right, right);
    for (uint64_t c = 0; c < 3; c++) {
        const double own = 2 * synth_unit(synth_bits(o->seed, 410, (uint64_t)view)) - 1;
        const double all = EXPOSURE_DRIFT * light_drift(o->seed, view, 0) + (1 - EXPOSURE_DRIFT) * own;
        const double tint = EXPOSURE_BALANCE * light_drift(o->seed, view, 1 + c);
        gain[c] = right * pow(2, o->exposure_jitter * (all + tint));
    }
    return v3_of(gain[0], gain[1], gain[2]);
}

double synth_lamp_falloff(const synth_options *o, double range)
{
    return o->lamp >= 0 && range > 0 ? pow(LAMP_RANGE / synth_max(range, LAMP_NEAREST), o->lamp) : 1;
}

double synth_lamp_radial(const synth_options *o, double x, double y)
{
    const double dx = x - lamp_centre[0] * o->width, dy = y - lamp_centre[1] * o->height;
    const double r2 = 4 * (dx * dx + dy * dy) / ((double)o->width * o->width + (double)o->height * o->height);
    return o->lamp >= 0 ? 1 + r2 * (lamp_radial[0] + r2 * lamp_radial[1]) : 1;
}

double synth_lamp_backscatter(const synth_options *o, double attenuation, double x, double y, double range)
{
    const v3 ray =
        v3_unit(v3_of((x - 0.5 * o->width) / (0.8 * o->width), (y - 0.5 * o->height) / (0.8 * o->width), 1));
    const double end = range > 0 ? synth_min(range, BACKSCATTER_END) : BACKSCATTER_END,
                 step = end / BACKSCATTER_STEPS;
    double sum = 0;
    if (!(o->backscatter > 0)) return 0;
    for (int i = 0; i < BACKSCATTER_STEPS; i++) {
        const double t = (i + 0.5) * step, d = v3_length(v3_sub(v3_scale(ray, t), lamp_at));
        sum += step * exp(-attenuation * (t + d)) * v3_length(lamp_at) / (d * d);
    }
    return o->backscatter * synth_min(sum / BACKSCATTER_FULL, 1);
}

void synth_write_exposure(const struct synth_run *s, struct output *t)
{
    output_add(
        t,
        "# NAME GAIN_RED GAIN_GREEN GAIN_BLUE: what the image was multiplied by, before noise and rounding\n");
    for (int i = 0; i < s->options->views; i++) {
        const v3 gain = synth_gain(s->options, i);
        char name[32];
        synth_image_name(s->options, i, name);
        output_add(t, "%s %.6f %.6f %.6f\n", name, gain.x, gain.y, gain.z);
    }
}

void synth_write_lamp(const struct synth_run *s, struct output *t)
{
    const synth_options *o = s->options;
    output_add(
        t,
        "# J of the water's formula is multiplied by (range / z)^power, the image by 1 + r2 r^2 + r4 r^4;\n"
        "# r: distance from the centre in half diagonals. Metres, px.\n"
        "power %.6f\nrange %.6f\ncentre_x %.6f\ncentre_y %.6f\nr2 %.6f\nr4 %.6f\nbackscatter %.6f\n",
        o->lamp, LAMP_RANGE, lamp_centre[0] * o->width, lamp_centre[1] * o->height, lamp_radial[0],
        lamp_radial[1], o->backscatter);
}

/* product.c - what all products share: memory, options, the world of their files, the hue of their colours, their
 * distance from the survey's points.
 *
 * Invariant: product.world is the one place where coordinates of the model become those of a file.
 */
#include "tools.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define PRODUCT_GREY 1.7724538509055159 /* 0.5 in units of the harmonic of degree 0: sqrt(pi) */

void *product_room(size_t count, size_t size)
{
    void *room = calloc(count + 1, size);
    if (room) return room;
    fputs("oxl: out of memory\n     fix: use a larger --pixel, or a smaller --max-side\n", stderr);
    exit(EXIT_FAILED);
}

double product_quantile(double *value, size_t count, double share)
{
    qsort(value, count, sizeof *value, frame_compare);
    return count > 0 ? value[(size_t)(share * (double)count)] : NAN;
}

double vector_dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

void vector_add(const double a[3], double by, const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++) out[k] = a[k] + by * b[k];
}

struct deviation product_deviation(const struct surface *s, const struct similarity *to,
                                   double (*off)(const void *user, const double p[3]), const void *user)
{
    const size_t points = oxl_scene_point_count(s->scene);
    double *by = product_room(points, sizeof *by), all = 0;
    struct deviation d = {.distance = to->scale * s->distance};
    size_t n = 0;
    for (size_t i = 1; i < points; i += 2) {
        double p[3];
        similarity_apply(to, oxl_scene_points(s->scene)[i].position, p);
        by[n] = off(user, p);
        all += !(by[n] < 0), d.gross += by[n] > PRODUCT_GROSS * d.distance, n += by[n] >= 0;
    }
    d.median = product_quantile(by, n, 0.5), d.most = product_quantile(by, n, 0.9);
    d.gross /= (double)n, d.none = 1 - (double)n / all;
    free(by);
    return d;
}

void product_say(const struct product *p, const struct deviation *d)
{
    if (isnan(d->median)) return;
    print_format(
        p->to,
        "deviation every second sparse point is a test point. The test points deviate from the surface by a median of %.2g %s and a 90th "
        "percentile of %.2g (%.2f and %.2f %% of the cameras' distance); %.1f %% of them deviate by more than %.0f %% of it; %.1f %% "
        "have no surface\n",
        d->median, p->words, d->most, 100 * d->median / d->distance, 100 * d->most / d->distance,
        100 * d->gross, 100 * PRODUCT_GROSS, 100 * d->none);
}

oxl_result product_open(oxl_context *ctx, const oxl_scene *scene, const char *survey,
                        const struct arguments *a, FILE *to, struct product *p)
{
    const double *reference = oxl_scene_reference(scene);
    *p = (struct product){
        .ctx = ctx,
        .scene = scene,
        .a = a,
        .to = to,
        .world = similarity_of_world(scene, a->scale > 0 ? a->scale : 1),
        .words = a->scale > 0 || a->gps ? "metres" : "units",
        .place = {.epsg = a->epsg,
                  .reference = a->scale > 0 ? NULL : reference,
                  .citation = "oceanxl: coordinates of the survey's world, height along its z",
                  .is_metric = a->scale > 0}};

    if (a->epsg && reference)
        return oxl_fail(
            ctx, OXL_ERR_USAGE,
            "the survey's coordinates are metres around a reference (%.6f, %.6f), not of EPSG:%d\n"
            "fix: leave --epsg out, then run gdalwarp -t_srs EPSG:%d map/ortho.tif warped.tif",
            reference[0], reference[1], a->epsg, a->epsg);
    if (!a->gps) return OXL_OK;
    p->place.reference = NULL, p->place.citation = "oceanxl: UTM by the photos' GPS, height above its datum";
    return gps_fit(p, survey, &p->world, &p->place.epsg);
}

oxl_result product_folder(const struct product *p)
{
    static const char *const names[] = {"ortho.tif",      "height.tif",      "certainty.tif", "frame.txt",
                                        "difference.tif", "significant.tif", "compare.csv",   "compare.html"};
    oxl_result rc = oxl_make_folder(p->ctx, p->a->out);
    for (int i = 0; i < 8 && rc == OXL_OK; i++) rc = output_check_own(p->ctx, p->a->out, names[i], "oceanxl");
    return rc;
}

oxl_result product_save(const struct product *p, struct output *t, const char *name)
{
    char path[4200];
    snprintf(path, sizeof path, "%s/%s", p->a->out, name);
    return output_save(p->ctx, t, path);
}

void product_balance(const oxl_scene *scene, const oxl_imaging *imaging, oxl_model *model)
{
    const int views = oxl_scene_view_count(scene);
    const double least = pow(oxl_scene_extent(scene), 2);
    double(*eye)[3] = product_room(2 * (size_t)views, sizeof *eye), (*hue)[3] = eye + views;
    for (int v = 0; v < views; v++) {
        float gain[3];
        frame_eye(&oxl_scene_view(scene, v)->camera, eye[v]);
        oxl_imaging_gain(imaging, v, gain);
        for (int c = 0; c < 3; c++) hue[v][c] = log(gain[c] / cbrt((double)gain[0] * gain[1] * gain[2]));
    }
#pragma omp parallel for schedule(static)
    for (size_t i = 0; i < model->count; i++) {
        float *const *at = model->plane;
        const double p[3] = {(double)at[OXL_MEAN][i], (double)at[OXL_MEAN + 1][i],
                             (double)at[OXL_MEAN + 2][i]};
        double all = 0, sum[3] = {0}, away[3];
        for (int v = 0; v < views; v++) {
            double weight;
            vector_add(p, -1, eye[v], away);
            weight = pow(least + vector_dot(away, away), -3);
            vector_add(sum, weight, hue[v], sum);
            all += weight;
        }
        for (int k = 0; k < 3 * (model->sh_degree + 1) * (model->sh_degree + 1); k++) {
            const double factor = exp(sum[k % 3] / all), grey = k < 3 ? PRODUCT_GREY : 0;
            at[OXL_SH + k][i] = (float)(factor * ((double)at[OXL_SH + k][i] + grey) - grey);
        }
    }
    free(eye);
}

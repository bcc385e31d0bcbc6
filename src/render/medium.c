/* medium.c - water between the camera and the Gaussians: attenuation and backscatter.
 *
 * Per Gaussian, with the range r from the camera to its centre, and for the background (Akkaynak & Treibitz 2018; SeaSplat, arXiv
 * 2409.17345, applies it per pixel):
 *     c' = J (r0 / r)^p exp(-bD r) + Binf (1 - exp(-bB r)),     background = Binf.
 * (r0 / r)^p: a lamp that moves with the camera, p from 0 to 2, r0 the median range of the survey.
 * Forward between project and raster; backward between raster and project: the sums of a splat's pairs hold dL/dc', and become dL/dJ.
 * The range, unlike depth z, does not change when the camera rotates.
 *
 * Invariant: exact gradients of the nine parameters, of p, and of the centre through r. Sums have a fixed order: by task of packs, row and
 * pair, and by pixel for the background.
 */
#include "kernels.h"
#include "../core/vecmath.h"

#define MEDIUM_MIN  0.02 /* of J: what is seen through more water than this lets through is no evidence of it */
#define MEDIUM_DARK 0.02 /* J at the start, at least */

/* Of J: attenuation and, with a lamp, falloff. *log_near: ln (reference / r), 0 where the falloff does not change with r. */
static void medium_through(const struct medium *m, float range, float through[3], float *log_near)
{
    const float near = m->has_falloff ? OXL_MAX(range, LAMP_RANGE_MIN * m->reference) : 1;
    *log_near        = m->has_falloff ? (float)(real_log2(0, m->reference / near) * 0.693147181f) : 0;
    for (int c = 0; c < 3; c++) through[c] = real_exp(0, m->falloff * *log_near - m->direct[c] * (range - m->training_range));
}

SIMD_BODY void medium_pack_forward(const int fused, const struct medium_job *job, size_t pack)
{
    const struct medium *m     = job->medium;
    struct medium_pack  *out   = &job->pack[pack];
    const struct vec3    eye   = job->kernel_camera->eye;
    const float          least = m->has_falloff ? LAMP_RANGE_MIN * m->reference : 0;
#pragma omp simd
    for (int l = 0; l < PACK; l++) {
        const size_t i = pack * PACK + (size_t)l;
        const float  x = job->in.plane[OXL_MEAN][i] - eye.x, y = job->in.plane[OXL_MEAN + 1][i] - eye.y;
        const float  z = job->in.plane[OXL_MEAN + 2][i] - eye.z;
        out->range[l]  = real_sqrt(x * x + y * y + z * z);
        out->log_near[l] =
            m->has_falloff ? real_log2(fused, m->reference / (out->range[l] > least ? out->range[l] : least)) * 0.693147181f : 0;
    }
    for (int c = 0; c < (m->on ? 3 : 1); c++)
#pragma omp simd
        for (int l = 0; l < PACK; l++)
            out->through[c][l] =
                real_exp(fused, m->falloff * out->log_near[l] - m->direct[c] * (out->range[l] - m->training_range));
    for (int c = 0; c < 3 && m->on; c++)
#pragma omp simd
        for (int l = 0; l < PACK; l++) out->rest[c][l] = real_exp(fused, -m->scatter[c] * out->range[l]);
    for (int c = 1; c < 3 && !m->on; c++) memcpy(out->through[c], out->through[0], sizeof out->through[c]);
}

SIMD_BODY void medium_forward_body(const int fused, const struct medium_job *job)
{
    const struct medium *m = job->medium;
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++) {
        if (!job->visible[pack]) continue;
        medium_pack_forward(fused, job, pack);
        for (unsigned l = 0; l < PACK; l++) {
            struct splat *s = &job->splat[pack * PACK + l];
            if (!(job->visible[pack] >> l & 1)) continue;
            for (int c = 0; c < 3; c++) {
                const float clear           = s->colour[c];
                job->pack[pack].clear[c][l] = clear;
                s->colour[c]                = clear * job->pack[pack].through[c][l];
                if (m->on) s->colour[c] += m->veil[c] * (1 - job->pack[pack].rest[c][l]);
            }
        }
    }
}
SIMD_DISPATCH(OXL_INTERNAL, medium_forward, struct medium_job)

/* A visible row: dL/dc' of each channel (3) -> the parameters' sums; returns dL/dr. */
static float medium_row(const struct medium *m, const struct medium_pack *p, unsigned l, const float g[3],
                        double sum[MEDIUM_SUMS])
{
    const float range = p->range[l], falloff = m->has_falloff && range > LAMP_RANGE_MIN * m->reference ? m->falloff / range : 0;
    float       dr = 0, lit = 0;
    for (int c = 0; c < 3; c++) {
        const float direct = g[c] * p->clear[c][l] * p->through[c][l];
        lit += direct;
        if (!m->on) continue;
        sum[c] += -((double)range - (double)m->training_range) * direct;
        sum[3 + c] += (double)g[c] * m->veil[c] * range * p->rest[c][l];
        sum[6 + c] += (double)g[c] * (1 - p->rest[c][l]);
        dr += g[c] * m->veil[c] * m->scatter[c] * p->rest[c][l] - m->direct[c] * direct;
    }
    sum[9] += (double)p->log_near[l] * lit;
    return dr - falloff * lit;
}

/* Converts sums and the splats' colours to those without the medium. */
OXL_INTERNAL void medium_backward(const struct medium_job *job, double sum[MEDIUM_SUMS])
{
    memset(sum, 0, MEDIUM_SUMS * sizeof *sum);
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++)
        for (unsigned l = 0; l < PACK; l++) {
            struct splat       *s    = &job->splat[pack * PACK + l];
            struct medium_pack *p    = &job->pack[pack];
            float               g[3] = {0, 0, 0};
            if (!(job->visible[pack] >> l & 1)) continue;
            for (uint32_t slot = s->first_slot; slot < s->first_slot + s->slots; slot++)
                for (int c = 0; c < 3; c++) {
                    g[c] += job->sums[slot][SUM_RED + c];
                    job->sums[slot][SUM_RED + c] *= p->through[c][l];
                }
            p->drange[l] = p->range[l] > 0 ? medium_row(job->medium, p, l, g, sum) / p->range[l] : 0;
            for (int c = 0; c < 3; c++) s->colour[c] = p->clear[c][l];
        }
}

/* After project_backward: adds the gradient of the range to that of the centre. out, out_row: as in project_job. */
OXL_INTERNAL void medium_backward_centres(const struct medium_job *job, const struct gaussians *out, size_t out_row)
{
    const float eye[3] = {job->kernel_camera->eye.x, job->kernel_camera->eye.y, job->kernel_camera->eye.z};
    for (size_t pack = job->first_pack; pack < job->end_pack; pack++)
        for (unsigned l = 0; l < PACK; l++) {
            const size_t i = pack * PACK + l;
            if (!(job->visible[pack] >> l & 1)) continue;
            for (int a = 0; a < 3; a++)
                out->plane[OXL_MEAN + a][i - out_row] += job->pack[pack].drange[l] * (job->in.plane[OXL_MEAN + a][i] - eye[a]);
        }
}

/* What a viewer without imaging.txt is to show: the colours through the water and, where `imaging` has lamps, by these, as the views see
 * the centre; the mean of both terms over these views, by the centre's size in the image, 1 / r^2; over all views, without the lamp's
 * polynomial, where none sees it. */
OXL_INTERNAL void medium_bake(oxl_scene *scene, const struct imaging *imaging, int backwards, oxl_model *model)
{
    enum { VIEWS = 64 };
    const struct medium *m = &imaging->medium;
    const oxl_camera    *camera[VIEWS];
    const struct lamp   *lamp[VIEWS];
    double               eye[VIEWS][3];
    int                  views = 0;
    const int            all = oxl_scene_view_count(scene), stride = OXL_MAX(1, (all + VIEWS - 1) / VIEWS);
    const int            bands = (model->sh_degree + 1) * (model->sh_degree + 1);
    for (int v = 0; v < all; v += stride, views++) {
        camera[views] = &oxl_scene_view(scene, v)->camera;
        lamp[views]   = imaging_lamp(imaging, scene, v);
        camera_position(camera[views], eye[views]);
    }
    for (size_t i = 0; i < model->count; i++) {
        double sum[2][7] = {{0}}; /* over all views, over those that see it: both terms by channel, their number */
        for (int v = 0; v < views; v++) {
            const double *r = camera[v]->rotation, *t = camera[v]->translation;
            const double  p[3]  = {model->plane[OXL_MEAN][i], model->plane[OXL_MEAN + 1][i], model->plane[OXL_MEAN + 2][i]};
            const double  z     = r[6] * p[0] + r[7] * p[1] + r[8] * p[2] + t[2];
            const double  x     = camera[v]->fx * (r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + t[0]) / z + camera[v]->cx;
            const double  y     = camera[v]->fy * (r[3] * p[0] + r[4] * p[1] + r[5] * p[2] + t[1]) / z + camera[v]->cy;
            const int     seen  = z > 0 && x >= 0 && y >= 0 && x <= camera[v]->width && y <= camera[v]->height;
            const double  d[3]  = {p[0] - eye[v][0], p[1] - eye[v][1], p[2] - eye[v][2]};
            const float   range = (float)sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
            float         through[3], log_near;
            medium_through(m, range, through, &log_near);
            for (int k = 0; k <= seen; k++) {
                const double weight = 1 / OXL_MAX(range * range, 1e-12); /* its size in the image */
                const double light  = k && lamp[v]
                                          ? vecmath_exp(lamp_log_gain(lamp[v]->shape, (float)(2 * x / camera[v]->width - 1),
                                                                      (float)(2 * y / camera[v]->height - 1)))
                                          : 1;
                for (int c = 0; c < 3; c++) {
                    sum[k][c] += weight * light * through[c];
                    sum[k][3 + c] += weight * light * m->veil[c] * (1 - real_exp(0, -m->scatter[c] * range));
                }
                sum[k][6] += weight;
            }
        }
        for (int c = 0; c < 3 && views > 0; c++) {
            const double *s = sum[sum[1][6] > 0], factor = s[c] / s[6], more = s[3 + c] / s[6];
            const double  by = backwards ? 1 / OXL_MAX(factor, MEDIUM_MIN) : factor, add = backwards ? -more * by : more;
            double        colour;
            for (int k = 0; k < bands; k++)
                model->plane[OXL_SH + 3 * k + c][i] = (float)(by * model->plane[OXL_SH + 3 * k + c][i]);
            colour = 0.5 * by + add + MODEL_SH0 * model->plane[OXL_SH + c][i];
            if (backwards) colour = OXL_MAX(colour, MEDIUM_DARK); /* noise is amplified; a colour below 0 has no gradient */
            model->plane[OXL_SH + c][i] = (float)((colour - 0.5) / MODEL_SH0);
        }
    }
}

/* dL/dBinf of the light behind the last splat: sum of T dL/dC, row by row. */
OXL_INTERNAL void medium_backward_veil(const float *drgb, const float *transmittance, int width, int height,
                                       double sum[MEDIUM_SUMS])
{
    const size_t plane = (size_t)width * (size_t)height;
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < height; y++) {
            double row = 0;
            for (size_t i = (size_t)y * (size_t)width; i < (size_t)(y + 1) * (size_t)width; i++)
                row += (double)transmittance[i] * drgb[(size_t)c * plane + i];
            sum[6 + c] += row;
        }
}

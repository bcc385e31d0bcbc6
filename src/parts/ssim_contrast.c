/* ssim_contrast.c - the contrast at which SSIM is half as sensitive as at its best, taken from the images.
 *
 * SSIM compares contrasts as (2 sxy + C2) / (sxx + syy + C2) (Wang 2004). Its C2 = 0.03^2 is that of bright
 * images: detail of a smaller standard deviation hardly counts. On a dark seabed, whose detail has 0.009, the
 * loss is then L1 alone, whose sign follows what gains and lamp do not explain, not the ground; its gradients
 * stay below the threshold of density control, and whole views become a glow (docs/log/IMAGING.md). So where
 * the images are faint, C2 is the median variance of their small cells, at least that of one 8-bit level.
 * Others keep Wang's, which is worth 0.2 dB of PSNR to them; so does what is faint without a lamp: behind
 * haze the loss that sees detail costs 0.5 dB and gives no structure. Density control follows, since it adds
 * up gradients of this loss.
 *
 * Invariant: a function of the scene's training images and tracks. Views and cells are taken in order. The
 * constant is archived, since tracks are compared before the first step alone.
 */
#include "ssim_contrast.h"
#include "../train/part.h"
#include "../survey/image.h"
#include "../survey/photometry.h"
#include "../train/train_tools.h"
#include "../survey/scene.h"
#include "../survey/survey.h"

enum {
    SSIM_CONTRAST_CELL = 5,     /* px: the side of a cell; its variance is that under SSIM's window */
    SSIM_CONTRAST_VIEWS = 32,   /* limit of images, */
    SSIM_CONTRAST_SAMPLE = 4096 /* and of cells of each, in each channel */
};
#define SSIM_CONTRAST_WANG 0.03         /* [Wang 2004] */
#define SSIM_CONTRAST_FAINT 0.011       /* images of less detail are faint: 0.009 is, 0.012 is not */
#define SSIM_CONTRAST_LEAST (1.0 / 255) /* below is rounding to 8 bits */

struct ssim_contrast {
    double contrast; /* standard deviation, fraction of white: C2 = contrast^2 */
    double measured; /* the images'; 0: not measured */
    int views;       /* it was measured in */
    int is_unlit;    /* 1: no lamp is known of, which keeps Wang's */
};

/* Variance of a cell's values, in squared levels; -1: one of them is masked. */
static double ssim_contrast_of_cell(const struct training_image *image, int channel, int x, int y)
{
    const size_t w = (size_t)image->width, plane = w * (size_t)image->height;
    const double n = SSIM_CONTRAST_CELL * SSIM_CONTRAST_CELL;
    double sum = 0, square = 0;
    for (size_t k = 0; k < SSIM_CONTRAST_CELL * SSIM_CONTRAST_CELL; k++) {
        const size_t at = ((size_t)y + k / SSIM_CONTRAST_CELL) * w + (size_t)x + k % SSIM_CONTRAST_CELL;
        const double v = image->rgb[(size_t)channel * plane + at];
        if (image->mask && !image->mask[at]) return -1;
        sum += v, square += v * v;
    }
    return square / n - (sum / n) * (sum / n);
}

/* Adds the variances of at most SSIM_CONTRAST_SAMPLE cells of each channel; returns their number. */
static size_t ssim_contrast_of_image(const struct training_image *image, double *out)
{
    const int across = image->width / SSIM_CONTRAST_CELL, down = image->height / SSIM_CONTRAST_CELL;
    const size_t cells = (size_t)across * down, step = cells / SSIM_CONTRAST_SAMPLE + 1;
    size_t count = 0;
    for (int c = 0; c < 3; c++)
        for (size_t k = 0; k < cells; k += step) {
            const int x = (int)(k % (size_t)across), y = (int)(k / (size_t)across);
            out[count] = ssim_contrast_of_cell(image, c, SSIM_CONTRAST_CELL * x, SSIM_CONTRAST_CELL * y);
            count += out[count] >= 0;
        }
    return count;
}

/* Takes training views evenly spaced; leaves out images that cannot be read. */
OXL_INTERNAL oxl_result ssim_contrast_measure(oxl_context *ctx, const oxl_scene *scene, double *contrast,
                                              int *views)
{
    const int train = schedule_training_views(scene), step = train / SSIM_CONTRAST_VIEWS + 1;
    double *value = oxl_alloc(ctx, 3 * SSIM_CONTRAST_SAMPLE * SSIM_CONTRAST_VIEWS, sizeof *value);
    oxl_result rc = OXL_OK;
    size_t count = 0;
    int seen = 0;
    *contrast = *views = 0;
    if (!value) return OXL_ERR_MEMORY;
    for (int i = 0; i < scene->view_count && rc == OXL_OK; i++) {
        const struct training_image *image;
        if (scene->view[i].is_test || seen++ % step != 0) continue;
        image = scene_image(ctx, scene, i);
        if (!image && !scene_lacks_image(ctx->failed)) rc = ctx->failed;
        if (!image) continue;
        count += ssim_contrast_of_image(image, value + count);
        ++*views;
    }
    if (count > 0) *contrast = sqrt(stats_select(value, count, 0.5)) / 255;
    oxl_free(ctx, value);
    return rc;
}

OXL_INTERNAL double ssim_contrast_of_detail(double measured)
{
    return measured > 0 && measured < SSIM_CONTRAST_FAINT ? OXL_MAX(measured, SSIM_CONTRAST_LEAST)
                                                          : SSIM_CONTRAST_WANG;
}

static oxl_result ssim_contrast_begin(struct train *t, void *state)
{
    struct ssim_contrast *s = state;
    const oxl_result rc = ssim_contrast_measure(t->ctx, t->scene, &s->measured, &s->views);
    s->contrast = ssim_contrast_of_detail(s->measured);
    return rc;
}

/* Keeps Wang's where neither the tracks nor the user say that a lamp lights the scene. */
static void ssim_contrast_use_tracks(struct train *t, void *state, const struct photometry *p)
{
    struct ssim_contrast *s = state;
    if (s->views == 0 || t->options->lamp == OXL_ON) return;
    s->is_unlit = !(p->parts & PHOTOMETRY_LAMP);
    s->contrast = s->is_unlit ? SSIM_CONTRAST_WANG : ssim_contrast_of_detail(s->measured);
}

static oxl_result ssim_contrast_before_render(struct train *t, void *state, struct part_view *v)
{
    const struct ssim_contrast *s = state;
    (void)v;
    renderer_settings(t->renderer)->contrast = s->contrast;
    return OXL_OK;
}

static void ssim_contrast_record(struct train *t, void *state)
{
    const struct ssim_contrast *s = state;
    char why[200];
    snprintf(
        why, sizeof why,
        "detail of the images has a standard deviation of %.2g of white (median of %d views)%s; from %g on, "
        "and without a lamp, SSIM keeps its usual constant, %g",
        s->measured, s->views, s->is_unlit ? ", no lamp is known" : "", SSIM_CONTRAST_FAINT,
        SSIM_CONTRAST_WANG);
    selection_record(t, "ssim_contrast", NUMBER(floor(s->contrast * 1e5 + 0.5) / 1e5), why);
}

OXL_INTERNAL const struct part part_ssim_contrast = {.name = "ssim_contrast",
                                                     .size = sizeof(struct ssim_contrast),
                                                     .begin = ssim_contrast_begin,
                                                     .is_plain = 1,
                                                     .use_tracks = ssim_contrast_use_tracks,
                                                     .before_render = ssim_contrast_before_render,
                                                     .record = ssim_contrast_record};

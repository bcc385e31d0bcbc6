/* imaging.h - declares what lies between the scene's colours and an image: gains, medium, lamp, poses. */
#ifndef OXL_IMAGING_H
#define OXL_IMAGING_H

#include "../core/core.h"

#define EXPOSURE_MIN 0.05 /* Bounds gains from below; its inverse bounds them from above. */
/* Describes a medium: c' = J exp(-attenuation r) + veiling_light (1 - exp(-backscatter r)), with r the range;
 * imaging.txt and the evidence name attenuation bD, backscatter bB and veiling light Binf. */
#define LAMP_SHAPE_MAX 4 /* Bounds a lamp's coefficients (log units). */
struct medium {
    int on;                                                 /* 0: there is no medium, and the others are 0 */
    float attenuation[3], backscatter[3], veiling_light[3]; /* per unit of the scene; per unit; 0..1 */
    /* range through which training has J; 0 outside of training */
    float training_range;
};
enum { LAMP_DEGREE = 4, LAMP_TERMS = 14, LAMP_MAX = 8, LAMP_VIEWS = 8 };
/* Describes a light that moves with the camera: the log gain over the image, a polynomial of degree 4
 * without its constant. Its terms are products of Legendre polynomials in x and y, each -1..1 across the
 * image, so that the mean over the image is 0: by degree in y, then in x. */
struct lamp {
    /* first view of the lamp's camera; -1: the lamp is that of all cameras without one of their own */
    int view;
    float shape[LAMP_TERMS];
};
/* Counts the numbers of a pose beside that of the survey's files: a turn (rad) and a move of the centre
 * (units of the scene), both in the axes of the survey's pose (pose.c). */
enum { POSE_TERMS = 6 };
struct oxl_imaging {
    struct medium medium;
    int lamps; /* number of lamps */
    struct lamp lamp[LAMP_MAX];
    int on;          /* 0: gains are 1 */
    int views;       /* views of the scene */
    float *log_gain; /* (views,3) */
    uint8_t *known;  /* (views) 1: the gain is trained; others are interpolated */
    /* (views) equal for images of one camera; 0 before imaging_set_cameras */
    uint64_t *camera;
    double (*pose)[POSE_TERMS]; /* (views) poses beside the survey's; NULL: the survey's */
    int *partner;               /* (views) view of another camera at the same moment; -1: none or several */
};
/* Creates an imaging that is off and knows no view's gain. */
OXL_INTERNAL oxl_result imaging_create(oxl_context *ctx, int views, struct oxl_imaging *out);
/* Sets m->camera and m->partner. */
OXL_INTERNAL oxl_result imaging_set_cameras(oxl_context *ctx, const oxl_scene *scene, struct oxl_imaging *m);
static inline void imaging_free(oxl_context *ctx, struct oxl_imaging *m)
{
    OXL_FREE(ctx, m->log_gain, m->known, m->camera, m->partner, m->pose);
    *m = (struct oxl_imaging){0};
}
/* Refuses the imaging of another scene, whose gains are of other views; NULL: none. */
OXL_INTERNAL oxl_result imaging_check_scene(oxl_context *ctx, const oxl_scene *scene,
                                            const oxl_imaging *imaging);
/* Makes an independent copy of the imaging of a scene with so many views. */
OXL_INTERNAL oxl_result imaging_clone(oxl_context *ctx, const struct oxl_imaging *from, size_t views,
                                      struct oxl_imaging *out);
OXL_INTERNAL void imaging_copy(const struct oxl_imaging *from, struct oxl_imaging *to);
OXL_INTERNAL void imaging_clear(struct oxl_imaging *m);
/* Interpolates a view's log gain from its neighbours, even if it is known. */
OXL_INTERNAL void imaging_interpolate(const struct oxl_imaging *m, int view, float log_gain[3]);
/* Interpolates as well, and adds the partner's deviation. */
OXL_INTERNAL void imaging_predict(const struct oxl_imaging *m, int view, float log_gain[3]);
/* Returns the mean log gain of the known views. */
OXL_INTERNAL double imaging_mean(const struct oxl_imaging *m, int channel);
/* Multiplies an image that was rendered at mean exposure by the view's gain, if gains are on. */
OXL_INTERNAL void imaging_apply(const struct oxl_imaging *m, int view, oxl_image *image);
/* Evaluates the polynomial at (x, y); both run from -1 to 1 across the image. */
OXL_INTERNAL double lamp_log_gain(const float shape[LAMP_TERMS], float x, float y);
OXL_INTERNAL void lamp_terms_at(float x, float y, float term[LAMP_TERMS]);
/* Names the pixels from (x, y), width x height, of an image of full_width x full_height. */
struct lamp_area {
    int width, height, full_width, full_height;
    float x, y;
};
/* Maps a pixel to -1..1 over `count` pixels. */
static inline float lamp_coordinate(float at, int count)
{
    return (2 * at + 1) / (float)count - 1;
}
#ifdef OXL_VULKAN
/* Returns the coefficient of y^j x^k in a term. */
OXL_INTERNAL double lamp_coefficient(int term, int j, int k);
#endif
/* Evaluates exp of the polynomial: gain (H,W). */
OXL_INTERNAL void lamp_gain(const float shape[LAMP_TERMS], const struct lamp_area *area, float *gain);
/* Prepares row y of the area: the log gain is the sum over k of a[k] x^k, with x by lamp_coordinate. */
OXL_INTERNAL void lamp_row(const float shape[LAMP_TERMS], const struct lamp_area *area, int y,
                           float a[LAMP_DEGREE + 1]);
/* Adds, for row y, the sum of each term times a pixel's value to sum (14). power[k]: the sum
 * of the values times x^k. */
OXL_INTERNAL void lamp_add_row(const struct lamp_area *area, int y, const double power[LAMP_DEGREE + 1],
                               double sum[LAMP_TERMS]);
/* Sets flat lamps: the first for all cameras with fewer than LAMP_VIEWS training views, then one for each
 * other camera. Returns their number. */
OXL_INTERNAL int imaging_set_lamps(const oxl_scene *scene, struct lamp lamp[LAMP_MAX]);
/* Returns the index of the view's lamp; -1: none. */
OXL_INTERNAL int imaging_find_lamp(const oxl_scene *scene, const struct lamp *lamp, int lamps, int view);
/* Returns the view's lamp; NULL: none. */
OXL_INTERNAL const struct lamp *imaging_lamp(const struct oxl_imaging *m, const oxl_scene *scene, int view);
/* Multiplies a rendered image by the view's lamp, before the gain. */
OXL_INTERNAL oxl_result imaging_apply_lamp(oxl_context *ctx, const oxl_scene *scene,
                                           const struct oxl_imaging *m, int view, oxl_image *image);
/* Shifts the log gains of the known views to this mean. */
OXL_INTERNAL void imaging_centre(struct oxl_imaging *m, const double mean[3]);
/* Returns 1 if there is a medium, or light that falls off with range: viewers need a separate model. */
OXL_INTERNAL int imaging_alters_colours(const struct oxl_imaging *m);
/* Takes out what the colours of a model for viewers have in them: the medium, and, where `gains`, gains that
 * are alone. */
OXL_INTERNAL void imaging_hide(struct oxl_imaging *m, int gains);
/* Returns 1 if there are gains and nothing else: viewers then show colours nearer to the images if the model
 * was trained without gains at the end. */
static inline int imaging_is_gains_alone(const struct oxl_imaging *m)
{
    return m->on && m->lamps == 0 && !imaging_alters_colours(m);
}

/* Returns 1 if there is a medium, or gains alone, which a model for viewers has in its colours. */
static inline int imaging_hides(const struct oxl_imaging *m)
{
    return imaging_alters_colours(m) || imaging_is_gains_alone(m);
}

#endif

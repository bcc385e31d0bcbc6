/* photometry.h - exposure, lamp and medium from the colours of tracks. */
#ifndef OXL_PHOTOMETRY_H
#define OXL_PHOTOMETRY_H

#include "imaging.h"

enum { PHOTOMETRY_MEDIUM = 1, PHOTOMETRY_LAMP = 2, PHOTOMETRY_GAINS = 4, PHOTOMETRY_ALL = 7 };
struct photometry {
    size_t points, observations; /* 0: too few tracks */
    /* the requested parts that the residuals support */
    int parts;
    double attenuation[3], backscatter[3], veiling_light[3]; /* as in struct medium */
    double error[9];                                         /* standard errors of their logarithms */
    /* of the lamps, in the order of imaging_set_lamps */
    float shape[LAMP_MAX][LAMP_TERMS];
    float *log_gain;   /* (views,3) of zero mean */
    uint8_t *known;    /* (views) 1: log_gain is fitted */
    double colour[3];  /* mean colour of the images over that of the points; 0: the points are black */
    double drift;      /* correlation of the images' gains with the mean range of their points */
    double residual;   /* fraction of white, robust: with all parts, */
    double without[3]; /* and without the medium, lamp, gains (0: not requested) */
};
/* Fits what the tracks support. parts: PHOTOMETRY_* that may be used. Free the result with photometry_free.
 */
OXL_INTERNAL oxl_result photometry_measure(oxl_context *ctx, oxl_scene *scene, int parts,
                                           struct photometry *out);
OXL_INTERNAL void photometry_free(oxl_context *ctx, struct photometry *p);

enum {
    PHOTOMETRY_VIEWS = 128,   /* limit of images */
    PHOTOMETRY_SAMPLE = 8000, /* limit of observations */
    PHOTOMETRY_TRACK = 32,    /* observations of a point, at most; */
    PHOTOMETRY_FEWEST = 3,    /* and at least */
    PHOTOMETRY_ENOUGH = 500,  /* observations */
    PHOTOMETRY_STEPS = 12,    /* of Gauss-Newton, at most */
    PHOTOMETRY_PARAMETERS = 9 + LAMP_MAX * LAMP_TERMS + 3 * PHOTOMETRY_VIEWS
};
struct photometry_sample { /* a point in an image */
    size_t point;
    int view, valid;  /* view: index in `chosen` */
    int lamp;         /* of the view's camera */
    float x, y, size; /* px; half the patch's side */
    double range, z;  /* range: in medians; z: over the focal length */
    float value[3], weight[3];
    float term[LAMP_TERMS];
};
struct photometry_work {
    int *view, *chosen;                   /* as in contrast.c */
    int views, lamp_of[PHOTOMETRY_VIEWS]; /* of the chosen ones: its camera's lamp */
    struct photometry_sample *sample;
    size_t samples;
    double *normal;  /* (PHOTOMETRY_PARAMETERS^2) lower triangle */
    double *scratch; /* (3 PHOTOMETRY_SAMPLE) */
    double *rest;    /* (samples,3) image less model */
    double right[PHOTOMETRY_PARAMETERS], at[PHOTOMETRY_PARAMETERS], sigma;
    struct lamp lamp[LAMP_MAX];
    int lamps, gains;     /* the first parameter that is a gain */
    int apart;            /* 1: cameras have shapes of their own */
    int parameters, free; /* parts */
};
#endif

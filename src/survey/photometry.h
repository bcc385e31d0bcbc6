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
/* parts: PHOTOMETRY_* that may be used. Free the result with photometry_free. */
OXL_INTERNAL oxl_result photometry_measure(oxl_context *ctx, oxl_scene *scene, int parts,
                                           struct photometry *out);
OXL_INTERNAL void photometry_free(oxl_context *ctx, struct photometry *p);

#endif

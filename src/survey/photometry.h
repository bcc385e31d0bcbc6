/* photometry.h - measures exposure, lamp and medium from the colours of tracks. */
#ifndef OXL_PHOTOMETRY_H
#define OXL_PHOTOMETRY_H

#include "imaging.h"
#include "track_samples.h"

/* Sets by how much larger residuals must be without the medium where the points' depths span too little to
 * identify it: images gain 1.3 to 1.5 dB by one from 0.6 on, nothing at 0.1 (docs/log/IMAGING.md). */
#define PHOTOMETRY_EVIDENT 0.3
enum { PHOTOMETRY_MEDIUM = 1, PHOTOMETRY_LAMP = 2, PHOTOMETRY_GAINS = 4, PHOTOMETRY_ALL = 7 };
struct photometry {
    size_t points, observations; /* 0: too few tracks */
    int requested, parts;        /* PHOTOMETRY_*; those that the residuals support, and perhaps gains */
    double attenuation[3], backscatter[3], veiling_light[3]; /* as in struct medium */
    /* shapes of the lamps, in the order of imaging_set_lamps */
    float shape[LAMP_MAX][LAMP_TERMS];
    float *log_gain;  /* (views,3) log gains of mean 0 */
    uint8_t *fitted;  /* (views) bit c: channel c has observations in the fit; else log_gain is its prior */
    double colour[3]; /* mean colour of the images over that of the points; 0: the points are black */
    /* rms over images and channels of the log gain less the mean of those of the other images of the same
     * points: by how much a model without gains is wrong about a held-out image */
    double unexplained;
    double brightness;  /* mean of the observations in the fit (fraction of white) */
    double with_medium; /* residuals with all parts (fraction of white, robust) */
    double residual;    /* residuals with all parts but a medium that is refused */
    double without[3];  /* residuals without the medium, lamp, gains; 0: not requested */
};
/* Fits the parts that the tracks support. parts: PHOTOMETRY_* that may be used. Free the
 * result with photometry_free. */
OXL_INTERNAL oxl_result photometry_measure(oxl_context *ctx, const oxl_scene *scene, int parts,
                                           struct photometry *out);
OXL_INTERNAL void photometry_free(oxl_context *ctx, struct photometry *p);

/* Returns 1 if residuals that grow by this factor without the medium, the lamp or the gains (part 0 to 2) are
 * evidence for it, where the points' depths span so much. */
OXL_INTERNAL int photometry_supports(int part, double growth, double span);

enum {
    PHOTOMETRY_VIEWS = TRACK_SAMPLES_VIEWS, /* most images */
    PHOTOMETRY_SAMPLE = 8000,               /* most observations */
    PHOTOMETRY_FEWEST = 3,                  /* least observations of a point */
    PHOTOMETRY_ENOUGH = 500,                /* least observations in all */
    PHOTOMETRY_STEPS = 12,                  /* most Gauss-Newton steps */
    PHOTOMETRY_PARAMETERS = 9 + LAMP_MAX * LAMP_TERMS + 3 * PHOTOMETRY_VIEWS
};
#endif

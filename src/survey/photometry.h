/* photometry.h - measures exposure, lamp and medium from the colours of tracks. */
#ifndef OXL_PHOTOMETRY_H
#define OXL_PHOTOMETRY_H

#include "imaging.h"

/* Sets by how much larger residuals must be without the medium where the points' depths span too little to
 * identify it: images gain 1.3 to 1.5 dB by one from 0.6 on, nothing at 0.1 (docs/log/IMAGING.md). */
#define PHOTOMETRY_EVIDENT 0.3
enum { PHOTOMETRY_MEDIUM = 1, PHOTOMETRY_LAMP = 2, PHOTOMETRY_GAINS = 4, PHOTOMETRY_ALL = 7 };
struct photometry {
    size_t points, observations; /* 0: too few tracks */
    int requested, parts;        /* PHOTOMETRY_*; those that the residuals support, and perhaps gains */
    double attenuation[3], backscatter[3], veiling_light[3]; /* as in struct medium */
    double error[9];                                         /* standard errors of their nine logarithms */
    /* shapes of the lamps, in the order of imaging_set_lamps */
    float shape[LAMP_MAX][LAMP_TERMS];
    float *log_gain;  /* (views,3) log gains of mean 0 */
    uint8_t *fitted;  /* (views) bit c: channel c has observations in the fit; else log_gain is its prior */
    double colour[3]; /* mean colour of the images over that of the points; 0: the points are black */
    double drift;     /* correlation of the images' gains with the mean range of their points */
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
    PHOTOMETRY_VIEWS = 128,   /* most images */
    PHOTOMETRY_SAMPLE = 8000, /* most observations */
    PHOTOMETRY_TRACK = 32,    /* most observations of a point */
    PHOTOMETRY_FEWEST = 3,    /* least observations of a point */
    PHOTOMETRY_ENOUGH = 500,  /* least observations in all */
    PHOTOMETRY_STEPS = 12,    /* most Gauss-Newton steps */
    PHOTOMETRY_PARAMETERS = 9 + LAMP_MAX * LAMP_TERMS + 3 * PHOTOMETRY_VIEWS
};
struct photometry_sample { /* Holds a point in an image. */
    size_t point;
    int view, valid;  /* view: index in `chosen` */
    int lamp;         /* lamp of the view's camera */
    float x, y, size; /* px; centre and half the side of the patch */
    double range, z;  /* range in medians; camera z over the focal length */
    float value[3], weight[3];
    float term[LAMP_TERMS];
};
struct photometry_form {  /* Holds what a sample's channel has of the parameters. */
    double a, b;          /* I = a J + b; b is dI/d(log Binf), too */
    double through, near; /* dI/d(log bD) / J; dI/d(log bB) */
};
struct photometry_work {
    int *view, *chosen;                   /* (images) index in `chosen`, -1: not used; (views) views used */
    int views, lamp_of[PHOTOMETRY_VIEWS]; /* number of chosen views; (views) lamp of each view's camera */
    struct photometry_sample *sample;
    size_t samples;
    double *normal, *factor;      /* (PHOTOMETRY_PARAMETERS^2) lower triangles */
    struct photometry_form *form; /* (samples,3) */
    double *scratch;              /* (3 PHOTOMETRY_SAMPLE) */
    double *rest;                 /* (samples,3) image less model */
    double right[PHOTOMETRY_PARAMETERS], at[PHOTOMETRY_PARAMETERS], sigma;
    /* of the points' colours, by channel: sum and number, mean, weight of their prior; pulled: its cost of
     * all points, times sigma^2 */
    double sum[3], mean[3], pull[3], pulled;
    int seen[3], is_last; /* is_last: the fit whose result is reported */
    struct lamp lamp[LAMP_MAX];
    int lamps, gains;     /* number of lamps; index of the first gain among the parameters */
    int apart;            /* 1: each camera has a shape of its own */
    int parameters, free; /* number of parameters; PHOTOMETRY_* that are fitted */
};
#endif

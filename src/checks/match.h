/* match.h - declares what match.c, which compares images with points, and conventions.c, which looks for the
 * convention of poses, share. */
#ifndef OXL_MATCH_H
#define OXL_MATCH_H

#include "../survey/scene.h"

enum {
    MATCH_SAMPLES = 256, /* most points of an image */
    MATCH_FEWEST = 24,   /* points; an image with fewer is not judged */
    MATCH_NEAR = 4,      /* nearest points that a point is compared with */
    MATCH_MAPS = 56
};
/* Bounds from below the median correlation, above that by chance, of a survey that fits. */
#define MATCH_CHANCE 0.08

enum match_kind {
    MATCH_AS_IS,
    MATCH_TURNED,
    MATCH_QUARTER,
    MATCH_MIRRORED,
    MATCH_CROPPED,
    MATCH_DISTORTED,
    MATCH_SHIFTED
};

struct match_map { /* Maps the place that the camera gives to the place in the image, sides 0 to 1. */
    enum match_kind kind;
    double m[6];   /* u' = m0 u + m1 v + m2, v' = m3 u + m4 v + m5 */
    double radial; /* moves the place away from the middle by 1 + radial r^2 */
};
struct match_layout { /* Holds points of an image. */
    int count, view;
    double focal[2]; /* focal lengths in sides of the image */
    float u[MATCH_SAMPLES], v[MATCH_SAMPLES];
    float colour[MATCH_SAMPLES]; /* brightness of the points; later its limited difference */
    uint8_t near[MATCH_SAMPLES][MATCH_NEAR];
};
struct match_plane { /* Holds the reduced brightness of an image; below 0: masked. */
    int width, height;
    float *value;
    size_t capacity;
    int grey; /* 1: the image has no colour */
};
struct match_score { /* Holds correlations of an image. */
    double as_is[MATCH_MAPS], chance;
    double other; /* best correlation at the points of another image, or turned */
    int fits;     /* this image; -1: none */
    int blank;    /* 1: the image has the same brightness everywhere */
    int grey;     /* 1: red, green and blue are the same everywhere */
    int masked;   /* number of points at which the image is masked */
};
struct match {
    oxl_context *ctx;
    oxl_scene *scene;
    const struct colmap *colmap;
    struct match_layout *layout; /* (count) */
    struct match_score *score;   /* (count) */
    uint8_t *judged;             /* (count) */
    double *work;                /* (2 (count + MATCH_SAMPLES)) scratch */
    int count, tracked;
    int damaged;  /* number of images whose pixels cannot be decoded */
    int coloured; /* 1: colours differ from point to point */
    struct match_plane plane;
    struct match_map map[MATCH_MAPS];
    int maps;
};

/* Lists the points that the camera has in its image (match.c). */
OXL_INTERNAL void match_by_projection(struct match *w, struct match_layout *l, const oxl_camera *camera);
/* Takes a view's brightness for match_correlate. *has 0: the image cannot be read,
 * which is reported elsewhere. */
OXL_INTERNAL oxl_result match_take_image(struct match *w, int view, int *has);
/* Correlates differences of brightness and colour under a map; returns 0 with too few points. */
OXL_INTERNAL double match_correlate(struct match *w, const struct match_layout *l,
                                    const struct match_map *map);
/* Return the median correlation of the judged images: as they are, and by chance. */
OXL_INTERNAL double match_median(struct match *w);
OXL_INTERNAL double match_median_by_chance(struct match *w);

/* Returns the correlation that a tenth of the images exceeds. */
OXL_INTERNAL double match_high(struct match *w);
/* Returns 1 if an image is far below `high` and not above chance, or has too few points. */
OXL_INTERNAL int match_is_suspect(const struct match *w, int k, double high);
/* Returns 1 if the correlation r at `count` points, in another reading, is right while as_is is not. */
OXL_INTERNAL int match_is_better(double r, double as_is, int count, double high);

enum { MATCH_ENOUGH = 3 }; /* least judged images; with fewer nothing is reported */
/* Make the steps of match_check in belongs.c: allocate, find points, correlate. */
OXL_INTERNAL oxl_result match_begin(oxl_context *ctx, oxl_scene *scene, struct match *w);
OXL_INTERNAL oxl_result match_lay_out(struct match *w);
OXL_INTERNAL oxl_result match_compare(struct match *w, int damaged);
/* Warns of images without colours, and of masks that ignore most points. Returns 1 if these are so many that
 * colours cannot be compared. */
OXL_INTERNAL int match_check_masks(struct match *w);
OXL_INTERNAL int match_judged(const struct match *w);
/* Warns of images that do not fit, and sets *foreign to their number. */
OXL_INTERNAL oxl_result match_judge(struct match *w, int *foreign);
/* Compares poses and points without tracks (conventions.c). *found 1: they do not fit, which is logged. */
OXL_INTERNAL oxl_result conventions_check(struct match *w, int *found);

#endif

/* match.h - shared by match.c, which compares images with points, and conventions.c, which looks for the
 * convention that poses were written in. */
#ifndef OXL_MATCH_H
#define OXL_MATCH_H

#include "../survey/scene.h"

enum {
    MATCH_SAMPLES = 256, /* limit of points of an image; */
    MATCH_FEWEST = 24,   /* images with fewer are not judged */
    MATCH_NEAR = 4,      /* nearest points */
    MATCH_MAPS = 56
};
#define MATCH_CHANCE 0.08 /* median correlation, above that by chance, that a survey has at least */

enum match_kind {
    MATCH_AS_IS,
    MATCH_TURNED,
    MATCH_QUARTER,
    MATCH_MIRRORED,
    MATCH_CROPPED,
    MATCH_DISTORTED,
    MATCH_SHIFTED
};

struct match_map { /* from the place that the camera gives to the one in the image, sides 0 to 1 */
    enum match_kind kind;
    double m[6];   /* u' = m0 u + m1 v + m2, v' = m3 u + m4 v + m5 */
    double radial; /* then away from the middle by 1 + radial r^2 */
};
struct match_layout { /* points of an image */
    int count, view;
    double focal[2]; /* in sides */
    float u[MATCH_SAMPLES], v[MATCH_SAMPLES];
    float colour[MATCH_SAMPLES]; /* first brightness, then the limited difference */
    uint8_t near[MATCH_SAMPLES][MATCH_NEAR];
};
struct match_plane { /* brightness of an image, reduced; below 0: masked */
    int width, height;
    float *value;
    size_t capacity;
    int grey; /* 1: the image has no colour */
};
struct match_score { /* correlations of an image */
    double as_is[MATCH_MAPS], chance;
    double other; /* the best at the points of another image, */
    int fits;     /* and which */
    int blank;    /* 1: the image has one brightness everywhere */
    int grey;     /* 1: red, green and blue are the same everywhere */
    int masked;   /* points where the image is masked */
};
struct match {
    oxl_context *ctx;
    oxl_scene *scene;
    const struct colmap *colmap;
    struct match_layout *layout; /* (count) */
    struct match_score *score;   /* (count) */
    uint8_t *judged;             /* (count) */
    double *work;                /* (count + MATCH_SAMPLES) */
    int count, tracked;
    int damaged;  /* images whose pixels cannot be decoded */
    int coloured; /* 1: colours differ from point to point */
    struct match_plane plane;
    struct match_map map[MATCH_MAPS];
    int maps;
};

/* Lists the points that the camera has in its image (match.c). */
OXL_INTERNAL void match_by_projection(struct match *w, struct match_layout *l, const oxl_camera *camera);
/* Takes a view's brightness for match_correlate. *has 0: it cannot be read, which is reported elsewhere. */
OXL_INTERNAL oxl_result match_take_image(struct match *w, int view, int *has);
/* Correlates differences of brightness and colour under a map; 0 with too few points. */
OXL_INTERNAL double match_correlate(struct match *w, const struct match_layout *l,
                                    const struct match_map *map);
/* Return the median over the judged images: as they are; by chance. */
OXL_INTERNAL double match_median(struct match *w);
OXL_INTERNAL double match_median_by_chance(struct match *w);

/* The correlation that a tenth of the images exceeds. 1: an image is far below it, and not above chance, or
 * has too few points. 1: r at `count` points, which another reading gives, is right where as_is is not. */
OXL_INTERNAL double match_high(struct match *w);
OXL_INTERNAL int match_is_suspect(const struct match *w, int k, double high);
OXL_INTERNAL int match_is_better(double r, double as_is, int count, double high);

enum { MATCH_ENOUGH = 3 }; /* images to be judged; with fewer nothing is said */
/* Make the steps of match_check (belongs.c). */
OXL_INTERNAL oxl_result match_begin(oxl_context *ctx, oxl_scene *scene, struct match *w);
OXL_INTERNAL oxl_result match_lay_out(struct match *w);
OXL_INTERNAL oxl_result match_compare(struct match *w, int damaged);
/* Says which images have no colours, and that masks ignore most points. 1: so many that colours cannot be
 * compared. */
OXL_INTERNAL int match_check_masks(struct match *w);
OXL_INTERNAL int match_judged(const struct match *w);
OXL_INTERNAL oxl_result match_judge(struct match *w, int *foreign);
/* Compares poses and points without tracks (conventions.c). *found 1: they do not fit, which was said. */
OXL_INTERNAL oxl_result conventions_check(struct match *w, int *found);

#endif

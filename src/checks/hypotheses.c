/* hypotheses.c - tells whether images, poses and points belong together, and if not, how they would.
 *
 * Each row of a table is a way to read a survey: as it is, with poses in another convention, with another
 * focal length or lens, with images turned. It says where in its image a point of the world is. The images'
 * colours say how well that fits: at the points that tracks have in an image, or, without tracks, that its
 * camera has. A point's colour is the mean of what its images show there, so an image's brightness at its
 * points correlates with their colours. Compared are differences between points side by side, limited to
 * HYPOTHESIS_CLIP medians: light that varies smoothly (lamp, haze, exposure) drops out, and fish count
 * little. The median over the images of a survey is 0.3 to 0.9 where they belong together, 0.0 to 0.2 else.
 *
 * Invariant: nothing that is trained changes.
 */
#include "../core/random.h"
#include "../core/vecmath.h"
#include "../formats/survey_read.h"
#include "../survey/image_header.h"
#include "../survey/scene.h"
#include "../survey/survey.h"
#include "../survey/tracks.h"
#include "checks.h"

enum {
    HYPOTHESIS_VIEWS = 256,     /* most images, evenly spaced */
    HYPOTHESIS_LEAST = 3,       /* images; with fewer nothing is reported */
    HYPOTHESIS_SAMPLES = 512,   /* most points of an image */
    HYPOTHESIS_FEWEST = 24,     /* points; an image with fewer is not judged */
    HYPOTHESIS_EMPTY = 8,       /* points; an image with fewer shows nothing of the model */
    HYPOTHESIS_ENOUGH = 100,    /* points; a survey with fewer may have empty images */
    HYPOTHESIS_POINTS = 131072, /* most points to project into an image without tracks */
    HYPOTHESIS_STRIPS = 24,     /* strips of an image in which points lie side by side */
    HYPOTHESIS_ROWS = 80,       /* most ways to read a survey */
    HYPOTHESIS_MANY = 12,       /* images, from which on HYPOTHESIS_ALWAYS decides */
    HYPOTHESIS_NAMED = 3,       /* images that are named */
    HYPOTHESIS_DARK = 76        /* brightest value of 16-bit images that hold fewer bits (14 bits: 64) */
};
#define HYPOTHESIS_CLIP 1.5    /* Limits differences, in medians of their absolute values. */
#define HYPOTHESIS_BORDER 0.01 /* Leaves out points in the border of an image, as a fraction of its sides. */
#define HYPOTHESIS_CHANCE 0.08 /* Bounds the median above that by chance, of a survey that fits. */
#define HYPOTHESIS_BETTER \
    0.06 /* Bounds the gain of the median of a reading that wins in the fraction WINS. */
#define HYPOTHESIS_WINS 0.7
#define HYPOTHESIS_STEADY 0.03 /* Bounds it where it wins in the fraction ALWAYS of many images. */
#define HYPOTHESIS_ALWAYS 0.9
#define HYPOTHESIS_SUSPECT \
    0.5 /* Looks at an image below this fraction of what a tenth of the images exceeds. */
#define HYPOTHESIS_ELSE 0.25   /* Bounds the gain of another reading of a single image from below. */
#define HYPOTHESIS_NOISE 3.6   /* Bounds what chance gives an image, in roots of the number of points. */
#define HYPOTHESIS_CERTAIN 6.0 /* Bounds the best of hundreds of places from below, likewise. */
/* Requires an image that fits nowhere to be so many spreads below the median, and below this fraction. */
#define HYPOTHESIS_SPREADS 4.0
#define HYPOTHESIS_LOW 0.3

/* ---------------- the table */

struct hypothesis {
    /* poses: the quaternion is x y z w; y and z of the camera are negated; the rotation is transposed;
     * translations become -R t so many times; y and z are negated then */
    int pose, xyzw, flip_first, transposed, moved, flip;
    int world[3]; /* axis of the points for each axis of the poses' world, from 1; negative: negated */
    /* images: the place from the middle becomes m x (1 + radial r^2), in sides; r is the tangent of the
     * angle */
    double m[4], radial;
    int middle;                /* 1: the principal point is in the middle of the image */
    const char *json, *colmap; /* what the files would hold; NULL: no program writes it */
    const char *fix;           /* NULL: write the poses as they are wanted */
};
#define HYPOTHESIS_POSE(xyzw, first, transposed, moved, flip, json, colmap)                        \
    {                                                                                              \
        1, xyzw, first, transposed, moved, flip, {1, 2, 3}, {1, 0, 0, 1}, 0, 0, json, colmap, NULL \
    }
#define HYPOTHESIS_WORLD(x, y, z, json, colmap)                             \
    {                                                                       \
        1, 0, 0, 0, 0, 0, {x, y, z}, {1, 0, 0, 1}, 0, 0, json, colmap, NULL \
    }
#define HYPOTHESIS_IMAGE(a, b, c, d, what)                                                         \
    {                                                                                              \
        0, 0, 0, 0, 0, 0, {1, 2, 3}, {a, b, c, d}, 0, 0, what, what,                               \
            "turn them back to the orientation of the model; another program may have applied or " \
            "removed an EXIF orientation"                                                          \
    }
static const struct hypothesis HYPOTHESES[] = {
    HYPOTHESIS_IMAGE(1, 0, 0, 1, "as they are"),
    HYPOTHESIS_IMAGE(-1, 0, 0, -1, "turned by 180 degrees"),
    HYPOTHESIS_IMAGE(0, 1, -1, 0, "turned by 90 degrees"),
    HYPOTHESIS_IMAGE(0, -1, 1, 0, "turned by 90 degrees"),
    HYPOTHESIS_IMAGE(-1, 0, 0, 1, "mirrored"),
    HYPOTHESIS_IMAGE(1, 0, 0, -1, "mirrored"),
    HYPOTHESIS_POSE(0, 0, 0, 0, 1, "camera axes as in OpenCV (y down, z ahead)",
                    "camera axes as in OpenGL (y up, z back)"),
    HYPOTHESIS_POSE(0, 0, 1, 1, 0, NULL, "camera to world"),
    HYPOTHESIS_POSE(0, 0, 1, 1, 1, NULL, "camera to world, with camera axes as in OpenGL (y up, z back)"),
    HYPOTHESIS_POSE(0, 1, 1, 1, 0, "world to camera, with camera axes as in OpenCV (y down, z ahead)", NULL),
    HYPOTHESIS_POSE(0, 1, 1, 1, 1, "world to camera", NULL),
    HYPOTHESIS_POSE(0, 1, 1, 2, 1, "rotations transposed (of world to camera) beside the cameras' places",
                    NULL),
    HYPOTHESIS_POSE(0, 1, 1, 2, 0,
                    "rotations transposed (of world to camera, axes as in OpenCV) beside the cameras' places",
                    NULL),
    HYPOTHESIS_POSE(0, 0, 1, 0, 0, NULL, "rotations transposed (of camera to world)"),
    HYPOTHESIS_POSE(0, 0, 0, 1, 0, NULL, "the cameras' places as translations"),
    HYPOTHESIS_POSE(1, 0, 0, 0, 0, NULL, "quaternions as x y z w"),
    HYPOTHESIS_WORLD(1, 3, -2, "points in the frame before applied_transform (x z -y)",
                     "world axes x z -y for the points"),
    HYPOTHESIS_WORLD(1, -3, 2, "points in the frame after applied_transform (x -z y)",
                     "world axes x -z y for the points"),
    HYPOTHESIS_WORLD(2, 1, -3, "points in the frame before applied_transform (y x -z)",
                     "world axes y x -z for the points")};

struct sample {
    double u, v;   /* place that the camera gives, sides 0 to 1; -1: none in the image */
    double colour; /* brightness of the point; later its limited difference */
};
struct looked {                    /* Holds what is known of an image. */
    int view, count, is_seen;      /* is_seen 1: the points are those that tracks have in it */
    uint64_t in_tracks;            /* entries of tracks */
    int judged, masked;            /* judged 1: it has a score; masked: points at which the image is masked */
    int row, place;                /* reading, or else image, whose points fit better; 0 and -1: none */
    double score[HYPOTHESIS_ROWS]; /* for each reading */
    double chance;                 /* with the points of another image */
    struct sample at[HYPOTHESIS_SAMPLES];
};
struct hypotheses {
    oxl_context *ctx;
    oxl_scene *scene;
    const struct colmap *colmap;
    struct hypothesis row[HYPOTHESIS_ROWS];
    int rows, plain, count;             /* rows; rows of the table among them; images */
    struct looked *look, room;          /* (count); points under another pose */
    int coloured;                       /* colours differ from point to point */
    const struct training_image *image; /* taken last */
    int brightest;                      /* value of all images */
    double work[HYPOTHESIS_SAMPLES];
    /* scores of the images as they are, of the best tenth, and by chance; 1: as by chance; images judged */
    double median, high, by_chance;
    int none, judged;
    int named, explained, exchanged; /* images that do not fit; in another reading; with another's points */
    const char *fix;
    struct text names;
};

static void hypotheses_fill(struct hypotheses *w)
{
    const int transforms =
        w->colmap->format == COLMAP_JSON && !strncmp(w->colmap->images_file, "transforms", 10);
    const char *wanted = transforms ? "write the poses camera to world, x right, y up, z back, and points of "
                                      "ply_file_path in the same world"
                         : w->colmap->format == COLMAP_JSON
                             ? "write the poses as OpenSfM does"
                             : "write the poses world to camera, x right, y down, z ahead";
    for (size_t i = 0; i < OXL_COUNT(HYPOTHESES); i++) {
        struct hypothesis *h = &w->row[w->rows];
        *h = HYPOTHESES[i];
        if (!transforms) h->json = h->colmap;
        if (h->pose) h->fix = wanted;
        w->rows += h->json != NULL;
    }
    w->plain = w->rows;
    w->row[w->rows] = HYPOTHESES[0];
    w->row[w->rows].middle = 1;
    w->row[w->rows].json = "with the principal point in the middle";
    w->row[w->rows++].fix = "give focal lengths, principal point, width and height of one size of the images";
    for (int i = -16; i <= 16; i++) { /* factors of 1/2 to 2; lenses from barrel to pincushion */
        struct hypothesis zoom = HYPOTHESES[0], lens = zoom;
        zoom.m[0] = zoom.m[3] = vecmath_exp(vecmath_log(2) * i / 16), lens.radial = 0.05 * i;
        zoom.json = "with another focal length";
        zoom.fix =
            "correct the focal length in the file of cameras, or use whole images in the place of cropped ones";
        lens.json = "through a lens with distortion";
        lens.fix =
            "use the images that colmap image_undistorter wrote beside this model, or the model from before it";
        if (abs(i) == 16) zoom.middle = 1, zoom.fix = w->row[w->plain].fix; /* of images of another size */
        if (i) w->row[w->rows++] = zoom;
        if (i && abs(i) <= 8) w->row[w->rows++] = lens;
    }
}

static void hypothesis_flip(double r[9], double t[3])
{
    for (int i = 3; i < 9; i++) r[i] = -r[i];
    t[1] = -t[1], t[2] = -t[2];
}

/* Returns the camera, in the frame of the files, of a view whose pose is read in another convention. */
static oxl_camera hypothesis_camera(const struct hypotheses *w, const struct hypothesis *h, int view)
{
    const struct colmap_image *from = scene_source_image(w->scene, view);
    const double *q = from->rotation, xyzw[4] = {q[3], q[0], q[1], q[2]};
    oxl_camera out = w->scene->view[view].camera;
    double r[9], x[9], *t = out.translation;
    camera_rotation_from_quaternion(h->xyzw ? xyzw : q, r);
    memcpy(t, from->translation, sizeof from->translation);
    if (h->flip_first) hypothesis_flip(r, t);
    memcpy(x, r, sizeof x);
    for (int i = 0; h->transposed && i < 9; i++) r[i] = x[i % 3 * 3 + i / 3];
    for (int n = 0; n < h->moved; n++) {
        memcpy(x, t, sizeof from->translation);
        for (int i = 0; i < 3; i++) t[i] = -(r[3 * i] * x[0] + r[3 * i + 1] * x[1] + r[3 * i + 2] * x[2]);
    }
    if (h->flip) hypothesis_flip(r, t);
    for (int i = 0; i < 9; i++) /* since p'[k] = +-p[axis] */
        out.rotation[i / 3 * 3 + abs(h->world[i % 3]) - 1] = h->world[i % 3] < 0 ? -r[i] : r[i];
    return out;
}

/* Maps a place that the camera gives to the one in the image. */
static void hypothesis_place(const struct hypothesis *h, const oxl_camera *c, double u, double v,
                             double out[2])
{
    const double x = u - (h->middle ? c->cx / c->width : 0.5), y = v - (h->middle ? c->cy / c->height : 0.5),
                 p = x * c->width / c->fx, q = y * c->height / c->fy,
                 factor = 1 + h->radial * (p * p + q * q);
    out[0] = 0.5 + factor * (h->m[0] * x + h->m[1] * y);
    out[1] = 0.5 + factor * (h->m[2] * x + h->m[3] * y);
}

/* ---------------- points of an image */

/* Orders points along strips of the image, there and back. */
static int looked_order(const void *a, const void *b)
{
    double key[2];
    for (int i = 0; i < 2; i++) {
        const struct sample *s = i ? b : a;
        const int strip = (int)(HYPOTHESIS_STRIPS * s->v);
        key[i] = strip + (strip & 1 ? 1 - s->u : s->u);
    }
    return (key[0] > key[1]) - (key[0] < key[1]);
}

/* Replaces each value by its difference to the mean of the two beside it, limited to HYPOTHESIS_CLIP medians;
 * NaN: not known. work: (count) scratch. */
static void looked_differences(double *value, int count, double *work)
{
    double before = NAN, limit;
    size_t known = 0;
    for (int k = 0; k < count; k++) {
        const double own = value[k], after = k + 1 < count ? value[k + 1] : NAN;
        value[k] -= isnan(before) ? after : isnan(after) ? before : 0.5 * (before + after);
        if (!isnan(value[k])) work[known++] = fabs(value[k]);
        before = own;
    }
    limit = HYPOTHESIS_CLIP * stats_select(work, known, 0.5);
    for (int k = 0; k < count; k++)
        if (!isnan(value[k])) value[k] = OXL_CLAMP(value[k], -limit, limit);
}

/* Orders the points, and replaces their colours by differences. */
static void looked_finish(struct looked *v, double *work)
{
    double value[HYPOTHESIS_SAMPLES];
    qsort(v->at, (size_t)v->count, sizeof *v->at, looked_order);
    for (int k = 0; k < v->count; k++) value[k] = v->at[k].colour;
    looked_differences(value, v->count, work);
    for (int k = 0; k < v->count; k++) v->at[k].colour = value[k];
}

/* Sets point k of an image. */
static void looked_set(struct looked *v, int k, const oxl_camera *c, const struct colmap_point *from)
{
    struct sample *s = &v->at[k];
    double x[3], p[2];
    *s = (struct sample){.u = -1, .v = -1, .colour = from->rgb[0] + from->rgb[1] + from->rgb[2]};
    if (camera_project(c, from->position, NULL, x, p)) s->u = p[0] / c->width, s->v = p[1] / c->height;
    if (!(fabs(s->u - 0.5) < 0.5 - HYPOTHESIS_BORDER && fabs(s->v - 0.5) < 0.5 - HYPOTHESIS_BORDER))
        s->u = s->v = -1;
}

/* Takes points that tracks have in the images, each of an image's with equal probability (Vitter 1985,
 * algorithm R). */
static oxl_result looked_by_tracks(struct hypotheses *w)
{
    int *look_of = oxl_alloc(w->ctx, w->colmap->image_count + 1, sizeof *look_of);
    struct tracks_walk walk = tracks_of(w->colmap, look_of);
    if (!look_of) return OXL_ERR_MEMORY;
    for (size_t i = 0; i < w->colmap->image_count; i++) look_of[i] = -1;
    for (int k = 0; k < w->count; k++)
        look_of[scene_source_image(w->scene, w->look[k].view) - w->colmap->image] = k;
    while (tracks_next(&walk)) {
        struct looked *v = &w->look[walk.view];
        const uint64_t seen = v->in_tracks++,
                       to = seen < HYPOTHESIS_SAMPLES
                                ? seen
                                : random_bits(0, (uint64_t)walk.view, seen) % (seen + 1);
        const oxl_camera camera = hypothesis_camera(w, &w->row[0], v->view);
        if (to < HYPOTHESIS_SAMPLES) looked_set(v, (int)to, &camera, &w->colmap->point[walk.point]);
        v->count = (int)OXL_MIN(v->in_tracks, (uint64_t)HYPOTHESIS_SAMPLES);
        v->is_seen = v->count >= HYPOTHESIS_FEWEST;
    }
    oxl_free(w->ctx, look_of);
    return OXL_OK;
}

/* Takes points that the camera has in its image, in an order without a pattern. */
static void looked_by_projection(const struct hypotheses *w, struct looked *v, const oxl_camera *camera)
{
    const size_t count = w->colmap->point_count;
    v->count = 0;
    for (uint64_t n = 0; n < OXL_MIN(count, (size_t)HYPOTHESIS_POINTS) && v->count < HYPOTHESIS_SAMPLES;
         n++) {
        const struct colmap_point *point = &w->colmap->point[n * 2654435761u % count];
        if (!tracks_accept_point(point, w->scene->origin)) continue;
        looked_set(v, v->count, camera, point);
        v->count += v->at[v->count].u >= 0;
    }
}

/* Lists the points of each image. */
static oxl_result hypotheses_lay_out(struct hypotheses *w)
{
    oxl_result rc;
    for (int k = 0; k < w->count; k++) w->look[k].view = (int)((int64_t)k * w->scene->view_count / w->count);
    rc = looked_by_tracks(w);
    for (int k = 0; k < w->count && rc == OXL_OK; k++) {
        struct looked *v = &w->look[k];
        const oxl_camera camera = hypothesis_camera(w, &w->row[0], v->view);
        if (!v->is_seen) looked_by_projection(w, v, &camera);
        looked_finish(v, w->work);
    }
    for (size_t i = 0; i < w->colmap->point_count; i++)
        w->coloured |=
            memcmp(w->colmap->point[i].rgb, w->colmap->point[0].rgb, sizeof w->colmap->point->rgb) != 0;
    return rc;
}

/* ---------------- scores */

/* Returns the sum of nine pixels of the image taken last; NaN: outside, or masked. */
static double hypotheses_brightness(const struct hypotheses *w, double u, double v)
{
    const int width = w->image->width, height = w->image->height, step = 1 + OXL_MAX(width, height) / 400;
    const size_t pixels = (size_t)width * (size_t)height;
    double sum = 0;
    if (!(u >= 0 && v >= 0 && u < 1 && v < 1)) return NAN;
    for (int i = 0; i < 9; i++) {
        const int x = (int)(u * width) + (i % 3 - 1) * step, y = (int)(v * height) + (i / 3 - 1) * step;
        const size_t at =
            (size_t)OXL_CLAMP(y, 0, height - 1) * (size_t)width + (size_t)OXL_CLAMP(x, 0, width - 1);
        if (w->image->mask && !w->image->mask[at]) return NAN;
        sum += w->image->rgb[at] + w->image->rgb[pixels + at] + w->image->rgb[2 * pixels + at];
    }
    return sum;
}

/* Correlates differences of the brightness of the image taken last with those of colours at the points of v;
 * returns 0 with too few points. */
static double hypotheses_correlate(struct hypotheses *w, const struct hypothesis *h, const struct looked *v)
{
    double value[HYPOTHESIS_SAMPLES], own = 0, its = 0, both = 0;
    int n = 0;
    for (int k = 0; k < v->count; k++) {
        double at[2];
        hypothesis_place(h, &w->scene->view[v->view].camera, v->at[k].u, v->at[k].v, at);
        value[k] = v->at[k].u < 0 ? NAN : hypotheses_brightness(w, at[0], at[1]);
    }
    looked_differences(value, v->count, w->work);
    for (int k = 0; k < v->count; k++) {
        const double c = v->at[k].colour, d = value[k];
        if (!isnan(c * d)) own += d * d, its += c * c, both += d * c, n++;
    }
    return n >= HYPOTHESIS_FEWEST && own * its > 0 ? both / sqrt(own * its) : 0;
}

/* Returns how well an image fits a reading; without colours, whether it has points in it. The points of
 * another pose are in w->room then. */
static double hypotheses_score(struct hypotheses *w, const struct hypothesis *h, const struct looked *v)
{
    if (h->pose) {
        const oxl_camera camera = hypothesis_camera(w, h, v->view);
        w->room.view = v->view;
        looked_by_projection(w, &w->room, &camera);
        looked_finish(&w->room, w->work);
        v = &w->room;
    }
    return w->coloured ? hypotheses_correlate(w, h, v) : v->count >= HYPOTHESIS_FEWEST;
}

/* Takes the image of a view. w->image NULL: it cannot be read, which is reported elsewhere. */
static oxl_result hypotheses_take(struct hypotheses *w, int k)
{
    const oxl_result rc = context_stopped(w->ctx);
    int ahead[8], n = 0;
    for (int i = k; i < w->count && n < (int)OXL_COUNT(ahead); i++) ahead[n++] = w->look[i].view;
    if (rc != OXL_OK) return rc;
    scene_images_ahead(w->ctx, w->scene, ahead, n);
    w->image = scene_image(w->ctx, w->scene, w->look[k].view);
    return w->image || scene_lacks_image(w->ctx->failed) ? OXL_OK : w->ctx->failed;
}

/* Scores the image taken last: as it is, in all readings but other poses, and with the points of another
 * image, by chance; and notes what its values tell. */
static void hypotheses_score_image(struct hypotheses *w, int k)
{
    struct looked *v = &w->look[k];
    const size_t pixels = (size_t)w->image->width * (size_t)w->image->height;
    for (size_t i = 0; i < 3 * pixels; i++) w->brightest = OXL_MAX(w->brightest, w->image->rgb[i]);
    for (int i = 0; i < v->count; i++)
        v->masked += v->at[i].u >= 0 && isnan(hypotheses_brightness(w, v->at[i].u, v->at[i].v));
    for (int r = 0; r < w->rows; r++) v->score[r] = w->row[r].pose ? 0 : hypotheses_score(w, &w->row[r], v);
    v->chance = hypotheses_correlate(w, &w->row[0], &w->look[(k + w->count / 2) % w->count]);
    /* The image half of all later shows the same where stereo pairs, or two dives, follow each other. */
    if (v->score[0] > 2 * HYPOTHESIS_CHANCE && 2 * v->chance > v->score[0])
        v->chance = hypotheses_correlate(w, &w->row[0], &w->look[(k + w->count / 3) % w->count]);
}

/* Scores the images by colours. damaged: warns of images whose pixel data are damaged, unless lint_image
 * finds
 * the same. */
static oxl_result hypotheses_score_images(struct hypotheses *w, int damaged)
{
    for (int k = 0; k < w->count; k++) {
        const oxl_result rc = hypotheses_take(w, k);
        if (rc != OXL_OK) return rc;
        w->look[k].judged = w->image != NULL;
        if (w->image) hypotheses_score_image(w, k);
        else if (damaged) {
            char *text = oxl_strdup(w->ctx, oxl_error_text(w->ctx));
            if (text && lint_image(w->ctx, w->scene, w->look[k].view) == OXL_OK)
                oxl_log(w->ctx, OXL_LOG_WARNING, "%s; training would go on without it", text);
            oxl_free(w->ctx, text);
        }
    }
    return OXL_OK;
}

/* Warns of what the values of images and masks tell. Returns 1 if masks hide too much to compare colours. */
static int hypotheses_check_values(struct hypotheses *w)
{
    struct image_header header = {0};
    int masked = 0, points = 0;
    for (int k = 0; k < w->count; k++) masked += w->look[k].masked, points += w->look[k].count;
    if (2 * masked > points)
        oxl_log(w->ctx, OXL_LOG_WARNING,
                "%.0f %% of the points that images show lie where their masks are black, and black "
                "pixels are ignored\nfix: exchange black and white if the masks mark ignored pixels in "
                "white; --auto-mask off where no masks are given",
                100.0 * masked / points);
    if (w->brightest <= HYPOTHESIS_DARK &&
        image_read_header(w->ctx, PATH(w->scene->images, "%s", w->scene->view[0].name), &header) == OXL_OK &&
        header.bits == 16)
        oxl_log(w->ctx, OXL_LOG_WARNING,
                "the brightest value of the 16-bit images is %d of 255, so they use few grey levels: their "
                "values have fewer bits\nfix: brighten all of them alike: mogrify -evaluate multiply %d "
                "IMAGES",
                w->brightest, 255 / OXL_MAX(w->brightest, 1));
    return 10 * masked > 9 * points;
}

/* ---------------- verdicts */

/* Returns a quantile of a reading's scores, as it is of images with enough points; row -1: of those by
 * chance. */
static double hypotheses_quantile(struct hypotheses *w, int row, double quantile)
{
    w->judged = 0;
    for (int k = 0; k < w->count; k++)
        if (w->look[k].judged && (row > 0 || w->look[k].count >= HYPOTHESIS_FEWEST))
            w->work[w->judged++] = row < 0 ? w->look[k].chance : w->look[k].score[row];
    return stats_select(w->work, (size_t)w->judged, quantile);
}

static int hypotheses_is_noise(const struct hypotheses *w, const struct looked *v)
{
    return v->score[0] < w->by_chance + HYPOTHESIS_NOISE / sqrt(v->count + 1);
}

/* Looks for another reading of an image, and for another image whose points it fits. */
static oxl_result hypotheses_explain(struct hypotheses *w, int k)
{
    struct looked *v = &w->look[k];
    double best = OXL_MAX(v->score[0] + HYPOTHESIS_ELSE,
                          w->none ? w->by_chance + HYPOTHESIS_CHANCE : HYPOTHESIS_SUSPECT * w->high);
    const oxl_result rc = hypotheses_take(w, k);
    if (rc != OXL_OK || !w->image) return rc;
    for (int r = 1; r < w->plain; r++) {
        const struct hypothesis *h = &w->row[r];
        if (h->pose) v->score[r] = hypotheses_score(w, h, v);
        if (v->score[r] > OXL_MAX(best, HYPOTHESIS_CERTAIN / sqrt((h->pose ? &w->room : v)->count + 1)))
            best = v->score[r], v->row = r;
    }
    for (int i = 0; i < w->count && w->coloured; i++) {
        const double r = i == k ? 0 : hypotheses_correlate(w, &w->row[0], &w->look[i]);
        if (r > OXL_MAX(best, HYPOTHESIS_CERTAIN / sqrt(w->look[i].count + 1)))
            best = r, v->row = 0, v->place = i;
    }
    return rc;
}

/* Counts an image that does not fit, and names the first ones. */
static void hypotheses_name(struct hypotheses *w, const struct looked *v)
{
    w->explained += v->row > 0, w->exchanged += v->place >= 0;
    if (v->row) w->fix = w->row[v->row].fix;
    if (w->named++ >= HYPOTHESIS_NAMED) return;
    text_add(&w->names, "%s%s", w->named > 1 ? ", " : "", w->scene->view[v->view].name);
    if (v->row) text_add(&w->names, " (fits %s)", w->row[v->row].json);
    else if (v->place >= 0)
        text_add(&w->names, " (fits the place of %s)", w->scene->view[w->look[v->place].view].name);
}

/* Finds the images that fit in another way, or nowhere while the others fit well. */
static oxl_result hypotheses_find_images(struct hypotheses *w)
{
    double value[HYPOTHESIS_VIEWS], middle, low;
    size_t n = 0;
    for (int k = 0; k < w->count; k++)
        if (w->look[k].judged) value[n++] = w->look[k].score[0];
    low = w->median - HYPOTHESIS_SPREADS * quality_spread(value, n, w->work, &middle);
    low = w->none ? -1 : OXL_MIN(low, HYPOTHESIS_LOW * w->median);
    for (int k = 0; k < w->count; k++) {
        struct looked *v = &w->look[k];
        const double r = v->score[0];
        const int noise = hypotheses_is_noise(w, v);
        oxl_result rc = OXL_OK;
        v->row = 0, v->place = -1;
        if (!v->judged) continue;
        if (w->none || v->count < HYPOTHESIS_FEWEST || (r < HYPOTHESIS_SUSPECT * w->high && noise))
            rc = hypotheses_explain(w, k);
        if (rc != OXL_OK) return rc;
        if (v->row || v->place >= 0 || (v->is_seen && noise && r < low)) hypotheses_name(w, v);
    }
    return OXL_OK;
}

/* Returns the reading in which all images fit better; 0: there is none. Flat ground seen from below looks
 * like
 * a mirrored image, and the poses are wrong. */
static int hypotheses_best(struct hypotheses *w)
{
    double most = OXL_MAX(w->median + HYPOTHESIS_STEADY, w->by_chance + 2 * HYPOTHESIS_CHANCE);
    int best = 0, wins = 0;
    for (int r = 1; r < w->rows; r++) {
        const double median = hypotheses_quantile(w, r, 0.5) + (w->row[r].pose ? HYPOTHESIS_STEADY : 0);
        if (median > most) most = median, best = r;
    }
    for (int k = 0; k < w->count; k++)
        wins += w->look[k].judged && w->look[k].score[best] > w->look[k].score[0];
    return (most > w->median + HYPOTHESIS_BETTER && wins > HYPOTHESIS_WINS * w->judged) ||
                   (w->judged >= HYPOTHESIS_MANY && wins > HYPOTHESIS_ALWAYS * w->judged)
               ? best
               : 0;
}

/* Warns of all images. Returns 0 if that is not called for. */
static int hypotheses_report_all(struct hypotheses *w)
{
    const struct hypothesis *h = &w->row[hypotheses_best(w)];
    char zoom[40] = "";
    int empty = 0;
    for (int k = 0; k < w->count; k++) empty += w->look[k].judged && w->look[k].count < HYPOTHESIS_EMPTY;
    if (fabs(h->m[0]) != 1 && h->m[0] != 0) snprintf(zoom, sizeof zoom, ", %.2f times as long", h->m[0]);
    if (h > w->row)
        oxl_log(w->ctx, OXL_LOG_WARNING, "%s %s%s\nfix: %s",
                h->pose ? "poses and points do not fit; they would fit as:"
                        : "the images fit the model's points better",
                h->json, zoom, h->fix);
    else if (4 * w->explained >= w->judged) return 0;
    else if (2 * empty > w->judged && w->colmap->point_count >= HYPOTHESIS_ENOUGH)
        oxl_log(
            w->ctx, OXL_LOG_WARNING,
            "poses and points do not fit: %d of %d images have fewer than %d points in front of them and inside\n"
            "fix: take points and poses from one model and one frame, and %s",
            empty, w->judged, (int)HYPOTHESIS_EMPTY, w->row[w->plain - 1].fix);
    else if (!w->none && 2 * w->exchanged <= w->judged) return 0;
    else
        oxl_log(w->ctx, OXL_LOG_WARNING,
                "the images are not those of the model: their brightness at its points does not follow the "
                "points' colours (correlation %.2f, by chance %.2f)%s%s\nfix: use the images that the model "
                "was made from, under the same names, and points and poses of one frame and scale",
                w->median, w->by_chance, w->named ? "; " : "", w->named ? w->names.data : "");
    return 1;
}

/* Warns once, of all images or some. *foreign: number of images that do not fit. */
static oxl_result hypotheses_judge(struct hypotheses *w, int *foreign)
{
    oxl_result rc;
    w->names = (struct text){.ctx = w->ctx};
    w->named = w->explained = w->exchanged = 0;
    w->fix = "use the images that the model was made from, under the same names, correct their poses "
             "(--poses auto), or leave these out of the folder";
    w->high = hypotheses_quantile(w, 0, 0.9);
    w->by_chance = hypotheses_quantile(w, -1, 0.5);
    w->median = hypotheses_quantile(w, 0, 0.5);
    w->none = w->judged >= HYPOTHESIS_LEAST && w->median < w->by_chance + HYPOTHESIS_CHANCE;
    rc = hypotheses_find_images(w);
    hypotheses_quantile(w, 1, 0.5); /* counts the images */
    if (rc != OXL_OK || w->judged < HYPOTHESIS_LEAST) w->named = 0;
    else if (hypotheses_report_all(w)) w->named = w->judged;
    else if (w->named && w->coloured)
        oxl_log(w->ctx, OXL_LOG_WARNING,
                "%d of %d images do not show the colours that the model's points have: %s%s\nfix: %s",
                w->named, w->judged, w->names.data, w->named > HYPOTHESIS_NAMED ? ", ..." : "", w->fix);
    *foreign = w->named;
    text_free(&w->names);
    return rc;
}

OXL_INTERNAL oxl_result hypotheses_check(oxl_context *ctx, oxl_scene *scene, int damaged, int *foreign)
{
    struct hypotheses *w;
    oxl_result rc;
    *foreign = 0;
    if (!scene_colmap(scene)) return OXL_OK;
    w = oxl_calloc(ctx, 1, sizeof *w);
    if (!w) return OXL_ERR_MEMORY;
    w->ctx = ctx, w->scene = scene, w->colmap = scene_colmap(scene);
    w->count = OXL_MIN(scene->view_count, (int)HYPOTHESIS_VIEWS);
    w->look = oxl_calloc(ctx, (size_t)w->count + 1, sizeof *w->look);
    hypotheses_fill(w);
    rc = w->look ? hypotheses_lay_out(w) : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = hypotheses_score_images(w, damaged);
    if (rc == OXL_OK && !hypotheses_check_values(w)) rc = hypotheses_judge(w, foreign);
    oxl_free(ctx, w->look);
    oxl_free(ctx, w);
    return rc;
}

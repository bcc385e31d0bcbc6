/* synth_points.c - a sparse cloud with tracks, as structure from motion would leave it.
 *
 * Each point starts as a random pixel of an image; the ray through it meets the surface there. Every other
 * view that has the point in its frame, looks from a similar side and is not blocked (a ray again; in load
 * tests, without images, the surface's normal alone) finds it with probability DETECTED, 0.3 px off. One
 * point in a hundred is an outlier: a mismatch that was triangulated off the surface.
 *
 * Invariant: a point depends on the seed and its number alone. Points are made in parallel by the chunk and
 * appended in order.
 */
#include "synth.h"

#include <stdlib.h>
#include <string.h>

#define DETECTED 0.75      /* probability that a view which could see a point has it */
#define SIMILAR_SIDE 0.68  /* cosine: descriptors match up to about 47 degrees apart */
#define FACING 0.15        /* cosine between normal and view when no ray is cast */
#define NOISE 0.3          /* px, each axis */
#define SAND_FRACTION 0.05 /* of the features that a reef has, on faint sand */
#define OUTLIER_FRACTION 0.01
#define OUTLIER_NOISE 1.5 /* px */
#define FRAME 2.0         /* px at the border where no feature is found */
enum { MOST_VIEWS = 64, OBSERVATIONS_MAX = 512, ATTEMPTS = 12, BARE_ATTEMPTS = 60, CHUNK = 8192 };

struct points_track {          /* one point as it is made */
    v3 position, normal, side; /* side: from where it was first seen, unit; normal, rgb: in load tests */
    int source, is_outlier;    /* source: the view where it was first seen */
    uint8_t rgb[3];
    int count;
    struct synth_observation seen[MOST_VIEWS];
};

struct points_search { /* cameras by the square of ground below them */
    const struct synth_run *run;
    double side;     /* metres; the views of a point are in its square or a neighbouring one */
    int row;         /* squares in it, and rows */
    uint32_t *first; /* (row row + 1) into list */
    uint32_t *list;
};

/* ---------------- cameras near a point */

static size_t points_square(const struct points_search *s, v3 p)
{
    const double half = s->run->trajectory.half;
    const int x = (int)synth_clamp((p.x + half) / s->side, 0, s->row - 1),
              y = (int)synth_clamp((p.y + half) / s->side, 0, s->row - 1);
    return (size_t)y * s->row + (size_t)x;
}

static int points_search_create(struct points_search *s)
{
    const struct synth_trajectory *trajectory = &s->run->trajectory;
    size_t squares;
    s->side = trajectory->reach + 1.5; /* ground that lies lower than the path's plane is seen farther off */
    s->row = (int)(2 * trajectory->half / s->side) + 1;
    squares = (size_t)s->row * s->row;
    s->first = calloc(squares + 1, sizeof *s->first);
    s->list = malloc((size_t)trajectory->count * sizeof *s->list);
    if (!s->first || !s->list) return 0;
    for (int i = 0; i < trajectory->count; i++) s->first[points_square(s, trajectory->camera[i].centre)]++;
    for (size_t i = 0; i < squares; i++) s->first[i + 1] += s->first[i];
    for (int i = trajectory->count - 1; i >= 0; i--)
        s->list[--s->first[points_square(s, trajectory->camera[i].centre)]] = (uint32_t)i;
    return 1;
}

/* ---------------- one point */

struct points_observation {
    int view;
    double x, y; /* px, exact */
};

/* Tells whether a view has the point in its frame and from a similar side. */
static int points_in_frame(const struct points_search *s, const struct points_track *t, int view, double *x,
                           double *y)
{
    const struct synth_camera *c = &s->run->trajectory.camera[view];
    double z;
    if (!synth_project(c, t->position, x, y, &z) || z > SYNTH_FAR) return 0;
    if (*x < FRAME || *y < FRAME || *x > c->width - FRAME || *y > c->height - FRAME) return 0;
    return v3_dot(v3_unit(v3_sub(c->centre, t->position)), t->side) > SIMILAR_SIDE;
}

static int points_visible(const struct points_search *s, const struct points_track *t, int view)
{
    const v3 from = s->run->trajectory.camera[view].centre, toward = v3_sub(t->position, from);
    const double range = v3_length(toward);
    if (t->is_outlier) return 1;
    if (!s->run->options->write_images) return -v3_dot(t->normal, toward) > FACING * range;
    return synth_cast(&s->run->world, from, v3_scale(toward, 1 / range), 0.997 * range - 0.004) < 0;
}

/* Rounds as a text export with three decimals does. */
static float points_measured(double exact, double noise, int size)
{
    return (float)(floor(synth_clamp(exact + noise, 0.001, size - 0.001) * 1000 + 0.5) / 1000);
}

/* Lists the views around that have the point in their frame. */
static int points_list(const struct points_search *s, const struct points_track *t,
                       struct points_observation *list)
{
    const int here = (int)points_square(s, t->position), hx = here % s->row, hy = here / s->row;
    int found = 0;
    for (int square = 0; square < 9; square++) {
        const int qx = hx + square % 3 - 1, qy = hy + square / 3 - 1;
        size_t at;
        if (qx < 0 || qy < 0 || qx >= s->row || qy >= s->row) continue;
        at = (size_t)qy * s->row + (size_t)qx;
        for (uint32_t i = s->first[at]; i < s->first[at + 1] && found < OBSERVATIONS_MAX; i++) {
            list[found].view = (int)s->list[i];
            found += points_in_frame(s, t, list[found].view, &list[found].x, &list[found].y);
        }
    }
    return found;
}

/* Gives the point to its source view, and to each other one with probability `chance` unless it is
 * occluded. */
static void points_detect(const struct points_search *s, uint64_t seed, const struct points_observation *list,
                          int found, struct points_track *t)
{
    const double chance = synth_min(DETECTED, DETECTED * MOST_VIEWS / found),
                 sigma = t->is_outlier ? OUTLIER_NOISE : NOISE;
    const int most = t->is_outlier ? 3 : MOST_VIEWS;
    int others = 0;
    for (int i = 0; i < found; i++) {
        const uint64_t bits = synth_bits(seed, 5, (uint64_t)list[i].view);
        if (list[i].view != t->source) {
            if (others + 1 >= most || synth_unit(bits) >= chance || !points_visible(s, t, list[i].view))
                continue;
            others++;
        }
        t->seen[t->count++] = (struct synth_observation){
            .view = (uint32_t)list[i].view,
            .x = points_measured(list[i].x, sigma * synth_random_normal(synth_mix(bits ^ 1)),
                                 s->run->options->width),
            .y = points_measured(list[i].y, sigma * synth_random_normal(synth_mix(bits ^ 2)),
                                 s->run->options->height)};
    }
}

static int points_by_view(const void *a, const void *b)
{
    const struct synth_observation *x = a, *y = b;
    return x->view < y->view ? -1 : x->view > y->view;
}

static void points_colour(const struct points_search *s, double range, struct points_track *t)
{
    const v3 seen = synth_through_water(
        &s->run->water,
        synth_shade(&s->run->world, t->position, range / s->run->trajectory.camera[t->source].f), range);
    const double rgb[3] = {seen.x, seen.y, seen.z};
    for (int c = 0; c < 3; c++) t->rgb[c] = (uint8_t)(255 * synth_clamp(rgb[c], 0, 1) + 0.5);
}

static int points_are_uneven(const struct points_search *s)
{
    return s->run->world.sand_contrast < 1;
}

/* Returns 1 for a point that is left out as bare sand, which has few features: so most points lie on the
 * objects on it. */
static int points_is_bare(const struct points_search *s, v3 p, uint64_t seed)
{
    struct synth_surface surface;
    if (!points_are_uneven(s) || synth_unit(synth_bits(seed, 4, 0)) < SAND_FRACTION) return 0;
    synth_distance(&s->run->world, p, &surface);
    return surface.material == SYNTH_SAND;
}

/* Picks a random pixel's point. 0: nothing there, or fewer than `least` views have it. */
static int points_try(const struct points_search *s, uint64_t number, uint64_t attempt, int least,
                      struct points_track *t)
{
    const uint64_t seed = synth_bits(s->run->options->seed ^ 0x9017, number, attempt);
    /* of cameras over sand less */
    const uint64_t pick = points_are_uneven(s) ? synth_bits(seed, 3, 0) : number;
    const int source = (int)(pick % (uint64_t)s->run->trajectory.count);
    const struct synth_camera *c = &s->run->trajectory.camera[source];
    const double u = synth_unit(synth_bits(seed, 0, 0)), v = synth_unit(synth_bits(seed, 1, 0));
    const v3 ray =
        synth_pixel_ray(c, FRAME + u * (c->width - 2 * FRAME), FRAME + v * (c->height - 2 * FRAME));
    double range = synth_cast(&s->run->world, c->centre, ray, SYNTH_FAR);
    struct points_observation list[OBSERVATIONS_MAX];
    int found;
    if (range < 0 || points_is_bare(s, v3_along(c->centre, ray, range), seed)) return 0;
    t->count = 0;
    t->source = source;
    t->is_outlier = synth_unit(synth_bits(s->run->options->seed ^ 0x0dd, number, 0)) < OUTLIER_FRACTION;
    if (t->is_outlier) range *= 0.6 + 0.8 * synth_unit(synth_bits(seed, 2, 0));
    t->position = v3_along(c->centre, ray, range);
    if (s->run->options->alpha > 0 && hypot(t->position.x, t->position.y) > s->run->options->alpha) return 0;
    t->side = v3_scale(ray, -1);
    if (!s->run->options->write_images) t->normal = synth_normal(&s->run->world, t->position, 0.02);
    found = points_list(s, t, list);
    if (found >= least) points_detect(s, seed, list, found, t);
    if (t->count < least) return 0;
    qsort(t->seen, (size_t)t->count, sizeof *t->seen, points_by_view);
    if (!s->run->options->write_images) points_colour(s, range, t);
    return 1;
}

static void points_make(const struct points_search *s, uint64_t number, struct points_track *t)
{
    const uint64_t attempts = points_are_uneven(s) ? BARE_ATTEMPTS : ATTEMPTS;
    t->count = 0;
    for (uint64_t attempt = 0; attempt < attempts; attempt++)
        if (points_try(s, number, attempt, attempt < attempts / 2 ? 3 : 2, t)) return;
    t->count = 0;
}

/* ---------------- all points */

static float points_error(const struct synth_trajectory *trajectory, const struct points_track *t)
{
    double sum = 0;
    for (int i = 0; i < t->count; i++) {
        double x = 0, y = 0, z = 0;
        synth_project(&trajectory->camera[t->seen[i].view], t->position, &x, &y, &z);
        sum += hypot(x - t->seen[i].x, y - t->seen[i].y);
    }
    return (float)(sum / t->count);
}

static int points_append(struct synth_points *out, const struct synth_trajectory *trajectory,
                         const struct points_track *t, size_t *capacity)
{
    struct synth_point *p = &out->point[out->count];
    if (t->count == 0) return 1;
    if (out->observation_count + MOST_VIEWS > *capacity) {
        const size_t more = *capacity + *capacity / 2 + 4 * CHUNK;
        void *grown = realloc(out->observation, more * sizeof *out->observation);
        if (!grown) return 0;
        out->observation = grown;
        *capacity = more;
    }
    *p = (struct synth_point){.position = t->position,
                              .first = out->observation_count,
                              .error = points_error(trajectory, t),
                              .count = (uint16_t)t->count,
                              .is_outlier = (uint8_t)t->is_outlier};
    for (int c = 0; c < 3; c++) p->sum[c] = (uint16_t)(t->rgb[c] * t->count);
    memcpy(out->observation + out->observation_count, t->seen, (size_t)t->count * sizeof *t->seen);
    out->observation_count += (size_t)t->count;
    out->count++;
    return 1;
}

/* Sorts points by view, and finds each observation's place in its view's list, stray keypoints between them
 * counted. */
static int points_index(struct synth_points *out, uint64_t seed, int views)
{
    uint64_t *next = calloc((size_t)views + 1, sizeof *next);
    out->views = views;
    out->view_first = calloc((size_t)views + 1, sizeof *out->view_first);
    out->by_view = malloc((out->observation_count + 1) * sizeof *out->by_view);
    if (!next || !out->view_first || !out->by_view) {
        free(next);
        return 0;
    }
    for (size_t i = 0; i < out->observation_count; i++) out->view_first[out->observation[i].view + 1]++;
    for (int v = 0; v < views; v++) out->view_first[v + 1] += out->view_first[v];
    for (size_t i = 0; i < out->count; i++) {
        const struct synth_point *p = &out->point[i];
        for (int k = 0; k < p->count; k++) {
            struct synth_observation *o = &out->observation[p->first + (size_t)k];
            const uint64_t place = next[o->view]; /* low half: observations so far; high half: with strays */
            const uint64_t at = place & 0xffffffffu, index = place >> 32;
            out->by_view[out->view_first[o->view] + at] = (uint32_t)i;
            o->index = (uint32_t)index;
            next[o->view] = (at + 1) | (index + 1 + (uint64_t)synth_has_stray(seed, (int)o->view, at)) << 32;
        }
    }
    free(next);
    return 1;
}

static oxl_result points_fill(const struct points_search *s, uint64_t wanted, struct points_track *tracks,
                              struct synth_points *out)
{
    const synth_options *o = s->run->options;
    size_t capacity = 0;
    for (uint64_t from = 0; from < wanted; from += CHUNK) {
        const int chunk = wanted - from < CHUNK ? (int)(wanted - from) : CHUNK;
#pragma omp parallel for schedule(dynamic, 32)
        for (int i = 0; i < chunk; i++) points_make(s, from + (uint64_t)i, &tracks[i]);
        for (int i = 0; i < chunk; i++)
            if (!points_append(out, &s->run->trajectory, &tracks[i], &capacity)) return OXL_ERR_MEMORY;
        if (o->progress && o->progress(o->user, "points", (long)(from + (uint64_t)chunk), (long)wanted))
            return OXL_ERR_INTERRUPTED;
    }
    return OXL_OK;
}

oxl_result synth_points_create(const struct synth_run *run, struct synth_points *out)
{
    const synth_options *o = run->options;
    const uint64_t wanted = o->points > 0 ? (uint64_t)o->points : 400 * (uint64_t)o->views;
    struct points_search s = {.run = run};
    struct points_track *tracks = calloc(CHUNK, sizeof *tracks);
    oxl_result rc;
    *out = (struct synth_points){.point = calloc((size_t)wanted, sizeof *out->point)};
    rc = tracks && out->point && points_search_create(&s) ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = points_fill(&s, wanted, tracks, out);
    if (rc == OXL_OK && !points_index(out, o->seed, o->views)) rc = OXL_ERR_MEMORY;
    free(tracks);
    free(s.first);
    free(s.list);
    if (rc != OXL_OK) synth_points_free(out);
    return rc;
}

void synth_points_free(struct synth_points *p)
{
    free(p->point);
    free(p->observation);
    free(p->view_first);
    free(p->by_view);
    *p = (struct synth_points){0};
}

const struct synth_observation *synth_observation_in(const struct synth_points *p, size_t point, int view)
{
    const struct synth_observation *o = p->observation + p->point[point].first;
    while (o->view != (uint32_t)view) o++;
    return o;
}

int synth_has_stray(uint64_t seed, int view, size_t k)
{
    return synth_bits(seed ^ 0x57a9, (uint64_t)view, k) % 4 == 0;
}

/* Samples the image, bilinear, 0..255. */
static unsigned points_sample(const oxl_image *image, int channel, double x, double y)
{
    const int ix = (int)synth_clamp(x - 0.5, 0, image->width - 2),
              iy = (int)synth_clamp(y - 0.5, 0, image->height - 2);
    const double fx = synth_clamp(x - 0.5 - ix, 0, 1), fy = synth_clamp(y - 0.5 - iy, 0, 1);
    const size_t width = (size_t)image->width;
    const float *at = image->rgb + ((size_t)channel * image->height + (size_t)iy) * width + (size_t)ix;
    return (unsigned)(255 * synth_lerp(synth_lerp(at[0], at[1], fx), synth_lerp(at[width], at[width + 1], fx),
                                       fy) +
                      0.5);
}

void synth_points_collect(struct synth_points *p, int view, const oxl_image *image)
{
    for (size_t i = p->view_first[view]; i < p->view_first[view + 1]; i++) {
        const struct synth_observation *o = synth_observation_in(p, p->by_view[i], view);
        for (int c = 0; c < 3; c++)
            p->point[p->by_view[i]].sum[c] =
                (uint16_t)(p->point[p->by_view[i]].sum[c] + points_sample(image, c, o->x, o->y));
    }
}

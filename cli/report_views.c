/* report_views.c - lists every evaluated view by PSNR; shows the worst beside their images, with an error
 * map, and those without structure, stretched, with a map of it. Dark images are shown brighter, by a factor
 * that is written below them.
 *
 * Images are those of OUT/renders and OUT/training_views, reduced for the page. The error is the mean over
 * the channels of |rendered - image|.
 */
#include "report_state.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { VIEWS_SHOWN = 4, VIEWS_SIDE = 560, VIEWS_OPEN = 12 /* rows that are seen without a click */ };
/* Gives this error, as a fraction of full white, the brightest colour of the error map. */
#define VIEWS_ERROR_FULL 0.25f
/* Shows an image brighter if its brightest hundredth begins below VIEWS_DARK, by the factor that brings it to
 * VIEWS_BRIGHT; both are fractions of full white. */
#define VIEWS_DARK 0.6f
#define VIEWS_BRIGHT 0.9f
#define VIEWS_FACTOR_MAX 20

struct views_row {
    char *name;
    double psnr, ssim, structure,
        plain;    /* plain: PSNR of scene.ply alone; NaN: not known, as is the SSIM of training views */
    double lacks; /* dB to the neighbours' median, of cc-PSNR or by its exposure; NaN: no training view */
    /* what is wrong with a training view: "pose", "exposure", "blur", "colour", "reflections",
     * "no structure"; NULL: nothing */
    char *flag;
    int shown; /* 1: its images are on the page */
};

struct views {
    struct views_row *row;
    int count;
};

/* ---------------- the rows */

static int views_compare(const void *a, const void *b)
{
    const struct views_row *x = a, *y = b;
    if (x->psnr != y->psnr) return x->psnr < y->psnr ? -1 : 1;
    return strcmp(x->name, y->name);
}

/* Reads the rows of a list, in its order, without those that have no name or no PSNR. */
static struct views views_read(struct report *r, const char *list)
{
    struct views v = {0};
    int n = 0;
    for (const char *e = oxl_json_first(list); e; e = oxl_json_next(e)) n++;
    v.row = calloc((size_t)n + 1, sizeof *v.row);
    if (!v.row) r->page.failed = 1;
    for (const char *e = oxl_json_first(list); v.row && e; e = oxl_json_next(e)) {
        struct views_row row = {json_string(oxl_json_member(e, "name")),
                                oxl_json_number(e, "psnr"),
                                oxl_json_number(e, "ssim"),
                                oxl_json_number(e, "structure"),
                                oxl_json_number(e, "plain_psnr"),
                                fmax(oxl_json_number(e, "lacks"), oxl_json_number(e, "lacks_exposure")),
                                json_string(oxl_json_member(e, "flag")),
                                0};
        if (row.name && isfinite(row.psnr)) v.row[v.count++] = row;
        else free(row.name), free(row.flag);
    }
    return v;
}

static void views_free(struct views *v)
{
    for (int i = 0; i < v->count; i++) free(v->row[i].name), free(v->row[i].flag);
    free(v->row);
}

/* ---------------- images */

/* Reads the image OUT/FOLDER/NAME + suffix, as the library names it. Returns 0 if it is not there. */
static int views_image(struct report *r, const char *folder, const char *name, const char *suffix,
                       oxl_image *out)
{
    struct output place = {0};
    char *path = NULL;
    int found;
    output_add(&place, "%s/%s", r->out, folder);
    found = !place.failed && oxl_render_path(r->ctx, place.data, name, suffix, &path) == OXL_OK &&
            oxl_image_read(r->ctx, path, out) == OXL_OK;
    oxl_text_free(r->ctx, path);
    free(place.data);
    return found;
}

/* Reduces an image to the means of n x n pixels, so that the longer side is at most VIEWS_SIDE. */
static oxl_result views_reduce(struct report *r, oxl_image *image)
{
    const int longer = image->width > image->height ? image->width : image->height,
              n = (longer + VIEWS_SIDE - 1) / VIEWS_SIDE;
    oxl_image small = {0};
    oxl_result rc = n > 1 ? oxl_image_create(r->ctx, image->width / n, image->height / n, &small) : OXL_OK;
    if (rc != OXL_OK || n <= 1) return rc;
    for (int c = 0; c < 3; c++)
        for (int y = 0; y < small.height; y++)
            for (int x = 0; x < small.width; x++) {
                float sum = 0;
                for (int k = 0; k < n * n; k++)
                    sum += image->rgb[((size_t)c * (size_t)image->height + (size_t)(y * n + k / n)) *
                                          (size_t)image->width +
                                      (size_t)(x * n + k % n)];
                small.rgb[((size_t)c * (size_t)small.height + (size_t)y) * (size_t)small.width + (size_t)x] =
                    sum / (float)(n * n);
            }
    oxl_image_free(r->ctx, image);
    *image = small;
    return OXL_OK;
}

/* Colours of the error map, from black over blue and green to pale yellow. They grow in brightness, so that
 * the map can be read without colour. */
static const float VIEWS_RAMP[5][3] = {
    {.02f, .03f, .08f}, {.10f, .22f, .52f}, {.10f, .55f, .53f}, {.55f, .80f, .30f}, {1.f, .97f, .70f}};

static void views_colour(float error, float out[3])
{
    const float at = fminf(error / VIEWS_ERROR_FULL, 1) * 4;
    const int k = at < 3 ? (int)at : 3;
    for (int c = 0; c < 3; c++)
        out[c] = VIEWS_RAMP[k][c] + (at - (float)k) * (VIEWS_RAMP[k + 1][c] - VIEWS_RAMP[k][c]);
}

static oxl_result views_error(struct report *r, const oxl_image *a, const oxl_image *b, oxl_image *out)
{
    const size_t pixels = (size_t)a->width * (size_t)a->height;
    const oxl_result rc = oxl_image_create(r->ctx, a->width, a->height, out);
    for (size_t i = 0; rc == OXL_OK && i < pixels; i++) {
        float error = 0, colour[3];
        for (size_t c = 0; c < 3; c++) error += fabsf(a->rgb[c * pixels + i] - b->rgb[c * pixels + i]) / 3;
        views_colour(error, colour);
        for (size_t c = 0; c < 3; c++) out->rgb[c * pixels + i] = colour[c];
    }
    return rc;
}

/* ---------------- views without structure */

static int views_is_fog(const struct views_row *row)
{
    return row->structure < OXL_STRUCTURE_NONE;
}

/* Returns the value that would be at `rank` if the array was sorted [Hoare 1961]; reorders the array. */
static float views_ranked(float *value, size_t count, size_t rank)
{
    size_t first = 0, end = count;
    while (end - first > 1) {
        const float pivot = value[first + (end - first - 1) / 2];
        size_t i = first, j = end - 1;
        for (;; i++, j--) {
            float swapped;
            while (value[i] < pivot) i++;
            while (value[j] > pivot) j--;
            if (i >= j) break;
            swapped = value[i], value[i] = value[j], value[j] = swapped;
        }
        if (rank <= j) end = j + 1;
        else first = j + 1;
    }
    return value[rank];
}

/* Finds the values below and above which the darkest and the brightest hundredth of an image's values are. */
static void views_range(struct report *r, const oxl_image *image, float *low, float *high)
{
    const size_t values = 3 * (size_t)image->width * (size_t)image->height;
    float *work = malloc(values * sizeof *work);
    *low = 0, *high = 1;
    if (!work) {
        r->page.failed = 1;
        return;
    }
    memcpy(work, image->rgb, values * sizeof *work);
    *low = views_ranked(work, values, values / 100);
    *high = views_ranked(work, values, values - 1 - values / 100);
    free(work);
}

/* Maps the values from `low` to low + range to black to white. */
static void views_stretch(oxl_image *image, float low, float range)
{
    for (size_t i = 0; i < 3 * (size_t)image->width * (size_t)image->height; i++)
        image->rgb[i] = (image->rgb[i] - low) / range;
}

/* Stretches both images to the range of `image`, without its darkest and brightest hundredth: a dark image of
 * low contrast hides what its render lacks. */
static void views_brighten(struct report *r, oxl_image *image, oxl_image *rendered)
{
    float low, high;
    views_range(r, image, &low, &high);
    views_stretch(image, low, fmaxf(high - low, 1.0f / 255));
    views_stretch(rendered, low, fmaxf(high - low, 1.0f / 255));
}

/* Returns the factor by which an image is shown brighter, in tenths; 1: it is not dark. */
static float views_factor(struct report *r, const oxl_image *image)
{
    float low, high;
    views_range(r, image, &low, &high);
    if (!(high < VIEWS_DARK)) return 1;
    return floorf(10 * fminf(VIEWS_BRIGHT / fmaxf(high, 1.0f / 255), VIEWS_FACTOR_MAX)) / 10;
}

/* Draws a map of structure: black where the render has nothing of the image's, white where it has all, grey
 * where the image has none. */
static oxl_result views_structure(struct report *r, const oxl_image *rendered, const oxl_image *image,
                                  oxl_image *out)
{
    const size_t pixels = (size_t)image->width * (size_t)image->height;
    float *map = malloc(pixels * sizeof *map);
    double value;
    oxl_result rc = map ? OXL_OK : OXL_ERR_MEMORY;
    if (rc == OXL_OK) rc = oxl_structure(r->ctx, rendered, image, &value, map);
    if (rc == OXL_OK) rc = oxl_image_create(r->ctx, image->width, image->height, out);
    for (size_t i = 0; rc == OXL_OK && i < 3 * pixels; i++)
        out->rgb[i] = isnan(map[i % pixels]) ? 0.5f : fmaxf(map[i % pixels], 0);
    free(map);
    return rc;
}

/* how: ", brightened", or "". */
static void views_figure(struct report *r, const oxl_image *image, const char *what, const char *how,
                         const char *name)
{
    output_add(&r->page, "<figure><img width=\"%d\" height=\"%d\" alt=\"%s%s of %S\" src=\"", image->width,
               image->height, what, how, name);
    page_jpeg(r, image, 80);
    output_add(&r->page, "\"><figcaption>%s%s</figcaption></figure>\n", what, how);
}

/* Shows a view: image, render and error, brightened and with structure where the render has none; without
 * medium, and as other viewers show it, where there is such an image. */
static void views_show(struct report *r, const char *folder, struct views_row *row)
{
    struct output *t = &r->page;
    oxl_image rendered = {0}, image = {0}, error = {0}, clear = {0}, plain = {0}, structure = {0};
    const int fog = views_is_fog(row);
    row->shown = 1;
    output_add(t, "<h3>%S <span class=\"pale\">%.2f dB%s%s%s%s</span>%s</h3>\n", row->name, row->psnr,
               isnan(row->ssim) ? "" : ", SSIM ", OUTPUT_FIXED(row->ssim, 3),
               isnan(row->structure) ? "" : ", structure ", OUTPUT_FIXED(row->structure, 2),
               fog ? " <span class=\"mark warn\">no structure</span>" : "");
    if (!views_image(r, folder, row->name, ".png", &rendered) ||
        !views_image(r, folder, row->name, ".image.png", &image) || rendered.width != image.width ||
        rendered.height != image.height)
        output_add(t, "<p class=\"pale\">Its images are not in %s/.</p>\n", folder);
    else if (views_reduce(r, &rendered) == OXL_OK && views_reduce(r, &image) == OXL_OK &&
             views_error(r, &rendered, &image, &error) == OXL_OK &&
             (!fog || views_structure(r, &rendered, &image, &structure) == OXL_OK)) {
        const float factor = fog ? 1 : views_factor(r, &image);
        char how[64] = "";
        if (fog) views_brighten(r, &image, &rendered), snprintf(how, sizeof how, ", brightened");
        if (factor > 1) {
            snprintf(how, sizeof how, ", %.1f times as bright", (double)factor);
            views_stretch(&image, 0, 1 / factor), views_stretch(&rendered, 0, 1 / factor);
        }
        output_add(t, "<div class=\"three\">\n");
        views_figure(r, &image, "Image", how, row->name);
        views_figure(r, &rendered, "Rendered", how, row->name);
        if (views_image(r, folder, row->name, ".clear.png", &clear) && views_reduce(r, &clear) == OXL_OK)
            views_figure(r, &clear, "Without medium and lamp", "", row->name);
        if (row->psnr - row->plain >= REPORT_VIEWER_LOSS && !fog && ground_view(r, row->name, &plain) &&
            views_reduce(r, &plain) == OXL_OK) {
            views_stretch(&plain, 0, 1 / factor);
            views_figure(r, &plain, "In other viewers", how, row->name);
        }
        views_figure(r, &error, "Error", "", row->name);
        if (fog) views_figure(r, &structure, "Structure", "", row->name);
        output_add(t, "</div>\n");
    } else t->failed = 1;
    oxl_image_free(r->ctx, &rendered);
    oxl_image_free(r->ctx, &image);
    oxl_image_free(r->ctx, &error);
    oxl_image_free(r->ctx, &clear);
    oxl_image_free(r->ctx, &plain);
    oxl_image_free(r->ctx, &structure);
}

/* ---------------- the section */

/* Writes a table of the views from `from` to `to` - 1. flags: with a column for what is wrong with a view. */
static void views_rows(struct output *t, const struct views *v, int from, int to, int flags)
{
    const int with_ssim = from < to && !isnan(v->row[from].ssim),
              with_lacks = from < to && !isnan(v->row[from].lacks);
    output_add(
        t,
        "<div class=\"scroll\"><table><tr><th>view<th class=\"n\">PSNR, dB%s<th class=\"n\">structure%s%s</tr>\n",
        with_ssim ? "<th class=\"n\">SSIM" : "", with_lacks ? "<th class=\"n\">lacks, dB" : "",
        flags ? "<th class=\"n\">finding" : "");
    for (int i = from; i < to; i++)
        output_add(t, "<tr><td class=\"name\">%S<td class=\"n\">%.2f%s%s<td class=\"n\">%s%s%s%s%S</tr>\n",
                   v->row[i].name, v->row[i].psnr, with_ssim ? "<td class=\"n\">" : "",
                   with_ssim ? OUTPUT_FIXED(v->row[i].ssim, 3) : "", OUTPUT_FIXED(v->row[i].structure, 2),
                   with_lacks ? "<td class=\"n\">" : "", with_lacks ? OUTPUT_FIXED(v->row[i].lacks, 1) : "",
                   flags ? "<td class=\"n\">" : "", flags ? v->row[i].flag : NULL);
    output_add(t, "</table></div>\n");
}

static int views_compare_structure(const void *a, const void *b)
{
    const struct views_row *x = a, *y = b;
    if (x->structure != y->structure && !isnan(x->structure) && !isnan(y->structure))
        return x->structure < y->structure ? -1 : 1;
    if (isnan(x->structure) != isnan(y->structure)) return isnan(x->structure) ? 1 : -1;
    return strcmp(x->name, y->name);
}

/* Lists the views below OXL_STRUCTURE_NONE, and shows the worst of them that are not on the page already; sorts
 * the rows. what: "held-out" or "training". */
static void views_fog(struct report *r, const char *folder, const char *what, struct views *v)
{
    struct output *t = &r->page;
    int fog = 0;
    qsort(v->row, (size_t)v->count, sizeof *v->row, views_compare_structure);
    while (fog < v->count && views_is_fog(&v->row[fog])) fog++;
    if (fog == 0) return;
    output_add(
        t,
        "<h3>No structure</h3>\n<p><b class=\"warn\">%d of %d %s views are rendered without the structure of their "
        "images</b>: the detail of the two correlates by less than %.1f (1: the same, 0: none, as behind a "
        "veil). PSNR and SSIM do not show this where images are dark or of low contrast. Train longer, or "
        "look for a wrong pose.</p>\n",
        fog, v->count, what, OXL_STRUCTURE_NONE);
    views_rows(t, v, 0, fog < VIEWS_OPEN ? fog : VIEWS_OPEN, 0);
    for (int i = 0; i < fog && i < VIEWS_SHOWN; i++)
        if (!v->row[i].shown) views_show(r, folder, &v->row[i]);
}

void views_section(struct report *r)
{
    struct output *t = &r->page;
    struct views v = views_read(r, oxl_json_member(r->metrics, "views"));
    const char *split = oxl_json_member(r->metrics, "split");
    const int held = split && strncmp(split, "\"test\"", 6) == 0;
    if (v.count > 0) qsort(v.row, (size_t)v.count, sizeof *v.row, views_compare);
    page_section(r, held || v.count == 0 ? "Held-out image quality" : "Image quality on training views");
    if (v.count == 0) output_add(t, "<p>Not evaluated yet: there is no metrics.json.</p>\n");
    else {
        output_add(
            t,
            held
                ? "<p>Training has not seen these images."
                : "<p><b class=\"warn\">These are training views, because none is held out: expect lower quality on new views.</b>");
        output_add(
            t,
            " PSNR is the error in decibels: 3 dB more is half the squared error. SSIM compares structure: 1 is identical. "
            "Structure is the correlation of detail, whatever the contrast: 0 is none. Worst first.</p>\n");
        views_rows(t, &v, 0, v.count < VIEWS_OPEN ? v.count : VIEWS_OPEN, 0);
        if (v.count > VIEWS_OPEN) {
            output_add(t, "<details><summary>%d more views</summary>\n", v.count - VIEWS_OPEN);
            views_rows(t, &v, VIEWS_OPEN, v.count, 0);
            output_add(t, "</details>\n");
        }
        page_section(r, "Worst views");
        for (int i = 0; i < v.count && i < VIEWS_SHOWN; i++) views_show(r, "renders", &v.row[i]);
        output_add(
            t,
            "<p><small>Error: mean absolute difference of the three channels, from black (none) over blue and green to pale "
            "yellow (%.0f %% of full white and above).</small></p>\n",
            100 * VIEWS_ERROR_FULL);
        views_fog(r, "renders", held ? "held-out" : "training", &v);
    }
    views_free(&v);
}

/* ---------------- training images */

static int views_flagged(const struct views *v, const char *flag)
{
    int count = 0;
    for (int i = 0; i < v->count; i++) count += v->row[i].flag && strcmp(v->row[i].flag, flag) == 0;
    return count;
}

/* Says what each finding of the table means. */
static void views_findings(struct output *t, const struct views *v)
{
    if (views_flagged(v, "pose") + views_flagged(v, "exposure") + views_flagged(v, "blur") > 0)
        output_add(
            t, " Correct an image with a wrong pose, another exposure or blur, or leave it out, and train "
               "again.");
    if (views_flagged(v, "colour") > 0)
        output_add(t, " Colour: it differs in colour or light over part of the image.");
    if (views_flagged(v, "reflections") > 0)
        output_add(t,
                   " Reflections: it has bright spots that other views do not show, which the model cannot "
                   "follow; nothing to mend.");
}

void views_training_section(struct report *r)
{
    struct output *t = &r->page;
    const char *list = oxl_json_member(r->metrics, "training");
    const double flagged = oxl_json_number(list, "flagged"), all = oxl_json_number(list, "of"),
                 iterations = oxl_json_number(r->metrics, "iterations"), few = oxl_json_number(list, "shown");
    struct views v = views_read(r, oxl_json_member(list, "views"));
    int shown = 0;
    if (v.count > 0) {
        page_section(r, "Training images that fit worst");
        output_add(t,
                   "<p>%d of %d fit far worse than neighbouring images, or are rendered without structure.",
                   flagged > 0 ? (int)flagged : 0, v.count);
        views_findings(t, &v);
        output_add(t,
                   " %sorted by what an image lacks: dB of cc-PSNR, or of exposure, to the median of its "
                   "neighbours.",
                   flagged > 0 ? "Those first; s" : "S");
        if (all > v.count)
            output_add(t, " %d of %.0f training images are judged, evenly spaced", v.count, all);
        if (all > v.count && iterations >= v.count)
            output_add(t, ": one for each %.0f iterations", floor(iterations / v.count));
        output_add(t, all > v.count ? ".</p>\n" : "</p>\n");
        while (shown < v.count && (v.row[shown].flag || shown < VIEWS_OPEN)) shown++;
        views_rows(t, &v, 0, shown, flagged > 0);
        for (int i = 0; i < v.count && i < (few >= 0 ? few : VIEWS_SHOWN); i++)
            views_show(r, "training_views", &v.row[i]);
        views_fog(r, "training_views", "training", &v);
    }
    views_free(&v);
}

/* report_views.c - lists views by PSNR, and shows the worst beside their images, with an error map. Dark images
 * are shown brighter, by a factor that is written below them.
 *
 * Images are those of OUT/renders and OUT/training_views, reduced for the page. The error is the mean over
 * the channels of |rendered - image|.
 */
#include "report.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { VIEWS_SHOWN = 4, VIEWS_SIDE = 560, VIEWS_OPEN = 12 /* rows that are seen without a click */ };
/* error that has the brightest colour of the map, as a fraction of full white */
#define VIEWS_ERROR_FULL 0.25f
/* An image whose mean is below VIEWS_DARK is shown brighter, by the factor that brings it to VIEWS_BRIGHT; both
 * are fractions of full white. */
#define VIEWS_DARK 0.2f
#define VIEWS_BRIGHT 0.35f
#define VIEWS_FACTOR_MAX 20

struct views_row {
    const char *json;
    double psnr, structure;
    int place; /* in the list */
};

/* Flagged views come first, in the list's order, then by PSNR. */
static int views_compare(const void *a, const void *b)
{
    const struct views_row *x = a, *y = b;
    const int flag = !oxl_json_member(x->json, "flag"), other = !oxl_json_member(y->json, "flag");
    if (flag != other) return flag - other;
    if (flag && x->psnr != y->psnr) return x->psnr < y->psnr ? -1 : 1;
    return x->place - y->place;
}

/* Reads the rows of a list that have a name and a PSNR, the worst first; free them. */
static struct views_row *views_read(struct report *r, const char *list, int *count)
{
    struct views_row *row;
    int n = 0;
    for (const char *e = oxl_json_first(list); e; e = oxl_json_next(e)) n++;
    row = calloc((size_t)n + 1, sizeof *row);
    *count = 0;
    if (!row) r->page.failed = 1;
    for (const char *e = oxl_json_first(list); row && e; e = oxl_json_next(e)) {
        row[*count] =
            (struct views_row){e, oxl_json_number(e, "psnr"), oxl_json_number(e, "structure"), *count};
        *count += oxl_json_member(e, "name") && isfinite(row[*count].psnr);
    }
    if (row) qsort(row, (size_t)*count, sizeof *row, views_compare);
    return row;
}

/* ---------------- images */

/* Reads the image OUT/FOLDER/NAME + suffix, as the library names it, reduced to means of n x n pixels, so that
 * the longer side is at most VIEWS_SIDE. Returns 0 if it is not there. */
static int views_image(struct report *r, const char *folder, const char *name, const char *suffix,
                       oxl_image *out)
{
    char place[4200], *path = NULL;
    oxl_image image = {0};
    int n, found;
    snprintf(place, sizeof place, "%s/%s", r->out, folder);
    found = oxl_render_path(r->ctx, place, name, suffix, &path) == OXL_OK &&
            oxl_image_read(r->ctx, path, &image) == OXL_OK;
    oxl_text_free(r->ctx, path);
    n = (int)ceil(fmax(image.width, image.height) / VIEWS_SIDE);
    found = found && oxl_image_create(r->ctx, image.width / n, image.height / n, out) == OXL_OK;
    for (int i = 0; found && i < 3 * out->height * out->width; i++) {
        const int x = i % out->width * n, y = i / out->width % out->height * n,
                  channel = i / out->width / out->height;
        for (int k = 0; k < n * n; k++)
            out->rgb[i] += image.rgb[(size_t)(channel * image.height + y + k / n) * (size_t)image.width +
                                     (size_t)(x + k % n)] /
                           (float)(n * n);
    }
    oxl_image_free(r->ctx, &image);
    return found;
}

/* Colours of the error map, from black over blue and green to pale yellow. They grow in brightness, so that
 * the map can be read without colour. */
static const float VIEWS_RAMP[5][3] = {
    {.02f, .03f, .08f}, {.10f, .22f, .52f}, {.10f, .55f, .53f}, {.55f, .80f, .30f}, {1.f, .97f, .70f}};

/* Replaces the rendering by the map of its error. */
static void views_error(oxl_image *rendered, const oxl_image *image)
{
    const size_t pixels = (size_t)image->width * image->height;
    for (size_t i = 0; i < pixels; i++) {
        float error = 0, at;
        int k;
        for (size_t c = i; c < 3 * pixels; c += pixels)
            error += fabsf(rendered->rgb[c] - image->rgb[c]) / (3 * VIEWS_ERROR_FULL);
        at = 4 * fminf(error, 1);
        k = at < 3 ? (int)at : 3;
        for (size_t c = 0; c < 3; c++)
            rendered->rgb[i + c * pixels] =
                VIEWS_RAMP[k][c] + (at - (float)k) * (VIEWS_RAMP[k + 1][c] - VIEWS_RAMP[k][c]);
    }
}

/* Returns the factor by which an image is shown brighter; 1: it is not dark. */
static float views_factor(const oxl_image *image)
{
    const size_t values = 3 * (size_t)image->width * image->height;
    float mean = 0;
    for (size_t i = 0; i < values; i++) mean += image->rgb[i] / (float)values;
    return mean < VIEWS_DARK ? fminf(VIEWS_BRIGHT / fmaxf(mean, 1e-3f), VIEWS_FACTOR_MAX) : 1;
}

/* Writes an image, `factor` times as bright. */
static void views_figure(struct report *r, oxl_image *image, const char *what, const char *name, float factor)
{
    struct output *t = &r->page;
    const size_t values = 3 * (size_t)image->width * image->height;
    for (size_t i = 0; i < values; i++) image->rgb[i] *= factor;
    output_add(t, "<figure><img width=\"%d\" height=\"%d\" alt=\"%s of %S\" src=\"", image->width,
               image->height, what, name);
    page_jpeg(r, image);
    output_add(t, "\"><figcaption>%s", what);
    if (factor > 1) output_add(t, ", %.1f times as bright", (double)factor);
    output_add(t, "</figcaption></figure>\n");
    for (size_t i = 0; i < values; i++) image->rgb[i] /= factor;
}

/* Shows a view: image, render and error; and without the medium, where there is such an image. */
static void views_show(struct report *r, const char *folder, const struct views_row *row)
{
    struct output *t = &r->page;
    oxl_image image[3] = {{0}, {0}, {0}};
    char *name = json_string(oxl_json_member(row->json, "name"));
    if (!name) return;
    output_add(t, "<h3>%S <span class=\"pale\">%.2f dB</span></h3>\n", name, row->psnr);
    if (views_image(r, folder, name, ".image.png", &image[0]) &&
        views_image(r, folder, name, ".png", &image[1]) && image[0].width == image[1].width &&
        image[0].height == image[1].height) {
        const float factor = views_factor(&image[0]);
        output_add(t, "<div class=\"three\">\n");
        views_figure(r, &image[0], "Image", name, factor);
        views_figure(r, &image[1], "Rendered", name, factor);
        if (views_image(r, folder, name, ".clear.png", &image[2]))
            views_figure(r, &image[2], "Without water and lamp", name, 1);
        views_error(&image[1], &image[0]);
        views_figure(r, &image[1], "Error", name, 1);
        output_add(t, "</div>\n");
    } else output_add(t, "<p class=\"pale\">Its images are not in %s/.</p>\n", folder);
    for (int i = 0; i < 3; i++) oxl_image_free(r->ctx, &image[i]);
    free(name);
}

/* ---------------- the section */

/* Says what of a held-out view no training view shows: metrics rate a guess there. */
static void views_gap(struct output *t, const char *view)
{
    static const char *const quarters[4] = {"upper left", "upper right", "lower left", "lower right"};
    const char *share = oxl_json_first(oxl_json_member(view, "unshown"));
    double all = 0, most = 0;
    int where = 0;
    for (int k = 0; k < 4 && share; k++, share = oxl_json_next(share)) {
        const char *cursor = share;
        const double part = oxl_json_number_at(&cursor);
        all += part;
        if (part > most) most = part, where = k;
    }
    if (all >= REPORT_GAP)
        output_add(t, "no training view shows %.0f %%, most in the %s; %.2f dB without it", 100 * all,
                   quarters[where], oxl_json_number(view, "shown_psnr"));
}

void views_section(struct report *r, const char *title, const char *list, const char *folder)
{
    struct output *t = &r->page;
    const double shown = oxl_json_number(list, "shown");
    int count, fog = 0;
    struct views_row *row = views_read(r, oxl_json_member(list, "views"), &count);
    for (int i = 0; i < count; i++) fog += row[i].structure < OXL_STRUCTURE_NONE;
    if (count > 0)
        output_add(
            t,
            "<section>\n<h2>%s</h2>\n<p class=\"pale\">A misfit is far worse than its neighbours, as after a wrong pose or blur; the finding exposure "
            "means that a view is brighter or darker than its neighbours predict.</p>\n",
            title);
    if (fog > 0)
        output_add(
            t,
            "<p><b class=\"warn\">%d of %d views are rendered without the structure of their images</b>: "
            "the detail of the two has a correlation below %.1f. Train longer, or with more "
            "Gaussians.</p>\n",
            fog, count, OXL_STRUCTURE_NONE);
    for (int i = 0; i < count; i++) {
        if (i == VIEWS_OPEN) output_add(t, "</table><details><summary>all %d views</summary>", count);
        if (i == 0 || i == VIEWS_OPEN)
            output_add(t, "<table><tr><th>view<th class=\"n\">PSNR, dB<th class=\"n\">structure<th "
                          "class=\"n\">finding</tr>\n");
        output_add(t, "<tr><td class=\"name\">%J<td class=\"n\">%.2f<td class=\"n\">%.2f<td class=\"n\">",
                   oxl_json_member(row[i].json, "name"), row[i].psnr, row[i].structure);
        if (oxl_json_member(row[i].json, "flag")) output_add(t, "%J", oxl_json_member(row[i].json, "flag"));
        else views_gap(t, row[i].json);
        output_add(t, "</tr>\n");
    }
    if (count > 0) output_add(t, "</table>%s\n", count > VIEWS_OPEN ? "</details>" : "");
    for (int i = 0; i < count && i < (shown >= 0 ? shown : VIEWS_SHOWN); i++) views_show(r, folder, &row[i]);
    if (count > 0) output_add(t, "</section>\n");
    free(row);
}

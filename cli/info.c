/* info.c - prints statistics of a model (number of Gaussians, position, size, opacity, nonfinite values); keeps
 * imaging.txt with a model that is converted. */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define INFO_FIRST "gaussians"

static int info_compare(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

/* Prints a figure, or a list in brackets: a line of text, or a member of JSON. */
static void info_line(FILE *to, int json, const char *name, const char *text)
{
    if (json) fprintf(to, "%s\n  \"%s\": %s", strcmp(name, INFO_FIRST) ? "," : "{", name, text);
    else print_format(to, "%-11s %s\n", name, text);
}

/* Prints the 5th, 50th and 95th percentile of the finite values of a plane, each through `map`. */
static void info_spread(FILE *to, int json, const char *name, const float *plane, size_t count, float *sorted,
                        double (*map)(double))
{
    char text[200];
    size_t n = 0, at[3];
    for (size_t i = 0; i < count; i++)
        if (isfinite(plane[i])) sorted[n++] = plane[i];
    qsort(sorted, n, sizeof *sorted, info_compare);
    if (n == 0) sorted[n++] = 0;
    at[0] = n / 20, at[1] = n / 2, at[2] = n - 1 - n / 20;
    snprintf(text, sizeof text, "[%.6g, %.6g, %.6g]", map((double)sorted[at[0]]), map((double)sorted[at[1]]),
             map((double)sorted[at[2]]));
    info_line(to, json, name, text);
}

static double info_same(double value)
{
    return value;
}

static double info_logistic(double value)
{
    return 1 / (1 + exp(-value));
}

static void info_model(FILE *to, const oxl_model *m, float *sorted, int json)
{
    static const struct {
        const char *name;
        int plane;
        double (*map)(double);
    } planes[] = {{"x", OXL_MEAN, info_same},
                  {"y", OXL_MEAN + 1, info_same},
                  {"z", OXL_MEAN + 2, info_same},
                  {"scale_0", OXL_LOG_SCALE, exp},
                  {"scale_1", OXL_LOG_SCALE + 1, exp},
                  {"scale_2", OXL_LOG_SCALE + 2, exp},
                  {"opacity", OXL_OPACITY, info_logistic}};
    const double counts[] = {(double)m->count, (double)m->lobes, m->sh_degree, (double)m->not_finite,
                             m->scale > 0 ? m->scale : 1};
    static const char *const names[] = {INFO_FIRST, "lobes", "sh_degree", "not_finite", "scale"};
    char origin[3][48], text[160];
    for (int i = 0; i < 5; i++) info_line(to, json, names[i], oxl_json_number_text((char[48]){0}, counts[i]));
    for (int k = 0; k < 3; k++) oxl_json_number_text(origin[k], m->origin[k]);
    snprintf(text, sizeof text, "[%s, %s, %s]", origin[0], origin[1], origin[2]);
    info_line(to, json, "origin", text);
    if (!json) fputs("            5th, 50th, 95th percentile\n", to);
    for (size_t i = 0; i < sizeof planes / sizeof *planes; i++)
        info_spread(to, json, planes[i].name, m->plane[planes[i].plane], m->count, sorted, planes[i].map);
}

/* ---------------- imaging.txt beside a model (docs/UNDERWATER.md) */

/* Prints the lines of the imaging.txt beside the model, and how many images have gains and poses. */
static void info_imaging(FILE *to, const char *path, int json)
{
    char folder[4096], *text;
    int gains = 0, poses = 0, lines = 0;
    output_split(path, folder);
    text = output_read(folder, "imaging.txt");
    for (char *line = text, *next; line && *line; line = next) {
        next = line + strcspn(line, "\n");
        if (*next) *next++ = 0;
        gains += strncmp(line, "gain ", 5) == 0;
        poses += strncmp(line, "pose ", 5) == 0;
        if (line[0] == '#' || strncmp(line, "gain ", 5) == 0 || strncmp(line, "pose ", 5) == 0) continue;
        fputs(json ? lines ? ", " : ",\n  \"imaging\": [" : lines ? "            " : "imaging     ", to);
        if (json) json_print(to, line);
        else print_format(to, "%s\n", line);
        lines++;
    }
    if (lines && json) fputc(']', to);
    if (gains) fprintf(to, json ? ",\n  \"gains\": %d" : "gains       of %d images, in imaging.txt\n", gains);
    if (poses) fprintf(to, json ? ",\n  \"poses\": %d" : "poses       of %d images, in imaging.txt\n", poses);
    free(text);
}

/* Returns 1 for scene.* and scene_standard.*, whose colours hold the medium, as viewers need it. */
static int info_is_for_viewers(const char *name)
{
    return strncmp(name, "scene.", 6) == 0 || strncmp(name, "scene_standard.", 15) == 0;
}

oxl_result info_convert_imaging(oxl_context *ctx, const char *from, const char *to)
{
    char source[4096], target[4096], path[4200];
    const int viewers = info_is_for_viewers(output_split(from, source)),
              named_so = info_is_for_viewers(output_split(to, target));
    char *imaging = output_read(source, "imaging.txt"), *there = output_read(target, "imaging.txt");
    struct output t = {0};
    oxl_result rc = OXL_OK;
    snprintf(path, sizeof path, "%s/imaging.txt", target);
    if (viewers && !named_so && there)
        rc = oxl_fail(
            ctx, OXL_ERR_USAGE,
            "%s is not written: commands would render it with the medium or gains of the imaging.txt "
            "beside it, unlike %s\nfix: choose another folder",
            to, from);
    else if (!viewers && named_so && imaging)
        rc = oxl_fail(ctx, OXL_ERR_USAGE,
                      "%s is not written: models called scene.* are rendered without the medium or gains "
                      "of imaging.txt, unlike %s\nfix: choose another name, such as clear.ply",
                      to, from);
    else if (there && imaging && strcmp(there, imaging) != 0)
        print_format(stderr,
                     "oxl: imaging.txt beside %s belongs to another model: it is kept and will apply "
                     "to this one, too\n",
                     to);
    else if (!viewers && imaging && !there) {
        output_add(&t, "%s", imaging);
        rc = output_save(ctx, &t, path);
    }
    free(imaging);
    free(there);
    return rc;
}

oxl_result info_print(oxl_context *ctx, FILE *to, const char *path, int json)
{
    oxl_model model = {0};
    float *sorted;
    oxl_result rc = oxl_model_read(ctx, path, &model);
    if (rc != OXL_OK) return rc;
    sorted = malloc((model.count + 1) * sizeof *sorted);
    if (sorted) {
        info_model(to, &model, sorted, json);
        info_imaging(to, path, json);
        if (json) fprintf(to, "\n}\n");
    } else rc = OXL_ERR_MEMORY;
    free(sorted);
    oxl_model_free(ctx, &model);
    return rc;
}

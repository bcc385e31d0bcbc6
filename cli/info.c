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

/* Prints the 5th, 50th and 95th percentile of the finite values of a plane, as a file's user knows them. */
static void info_spread(FILE *to, int json, const oxl_model *m, int row, float *sorted)
{
    static const char *const names[] = {"x", "y", "z", "scale_0", "scale_1", "scale_2", "opacity"};
    static const int planes[] = {OXL_MEAN, OXL_LOG_SCALE, OXL_OPACITY};
    const float *plane = m->plane[planes[row / 3] + row % 3];
    char text[200];
    size_t n = 0;
    double value[3];
    for (size_t i = 0; i < m->count; i++)
        if (isfinite(plane[i])) sorted[n++] = plane[i];
    qsort(sorted, n, sizeof *sorted, info_compare);
    if (n == 0) sorted[n++] = 0;
    for (int k = 0; k < 3; k++) {
        const double v = (double)sorted[k == 0 ? n / 20 : k == 1 ? n / 2 : n - 1 - n / 20];
        value[k] = row < 3 ? v : row < 6 ? exp(v) : 1 / (1 + exp(-v));
    }
    snprintf(text, sizeof text, json ? "[%.6g, %.6g, %.6g]" : "[%.4g, %.4g, %.4g]", value[0], value[1],
             value[2]);
    info_line(to, json, names[row], text);
}

static void info_model(FILE *to, const oxl_model *m, float *sorted, int json)
{
    const double counts[] = {(double)m->count, (double)m->lobes, m->sh_degree, (double)m->not_finite,
                             m->scale > 0 ? m->scale : 1};
    static const char *const names[] = {INFO_FIRST, "lobes", "sh_degree", "not_finite", "scale"};
    char origin[3][48], text[160];
    for (int i = 0; i < 5; i++) info_line(to, json, names[i], oxl_json_number_text((char[48]){0}, counts[i]));
    for (int k = 0; k < 3; k++)
        if (json) oxl_json_number_text(origin[k], m->origin[k]);
        else snprintf(origin[k], sizeof origin[k], "%.3f", m->origin[k]);
    snprintf(text, sizeof text, "[%s, %s, %s]", origin[0], origin[1], origin[2]);
    info_line(to, json, "origin", text);
    if (!json) fputs("            5th, 50th, 95th percentile\n", to);
    for (int row = 0; row < 7; row++) info_spread(to, json, m, row, sorted);
}

/* ---------------- imaging.txt beside a model (docs/UNDERWATER.md) */

/* Prints the parameters in the imaging.txt beside the model: as JSON its lines, as text the medium's; and how many
 * lamps, gains and poses it has. */
static void info_imaging(FILE *to, const char *path, int json)
{
    static const char *const kinds[] = {"lamp", "gain", "pose"};
    char folder[4096], *text, name[8];
    int count[3] = {0, 0, 0}, lines = 0;
    double value[3];
    output_split(path, folder);
    text = output_read(folder, "imaging.txt");
    for (char *line = text, *next; line && *line; line = next) {
        int kind = 0;
        next = line + strcspn(line, "\n");
        if (*next) *next++ = 0;
        while (kind < 3 && strncmp(line, kinds[kind], 4) != 0) kind++;
        if (kind < 3) count[kind]++;
        if (line[0] == '#' || kind == 1 || kind == 2) continue;
        if (json) {
            fputs(lines++ ? ", " : ",\n  \"imaging\": [", to);
            json_print(to, line);
        } else if (kind == 3 && sscanf(line, "%7s %lf %lf %lf", name, value, value + 1, value + 2) == 4)
            print_format(to, "%s%-11s [%.4g, %.4g, %.4g]\n", lines++ ? "" : "            red, green, blue\n",
                         name, value[0], value[1], value[2]);
    }
    if (lines && json) fputc(']', to);
    for (int k = json; k < 3; k++)
        if (count[k])
            fprintf(to, json ? ",\n  \"%ss\": %d" : "%ss       %d, in imaging.txt\n", kinds[k], count[k]);
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

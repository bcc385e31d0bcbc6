/* info.c - prints statistics of a model (number of Gaussians, position, size, opacity, nonfinite values) and
 * tables of a partition; compares and copies the imaging.txt beside models. */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static int info_compare(const void *a, const void *b)
{
    const float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

struct spread info_spread(const float *plane, size_t count, float *sorted)
{
    size_t n = 0;
    for (size_t i = 0; i < count; i++)
        if (isfinite(plane[i])) sorted[n++] = plane[i];
    if (n == 0) return (struct spread){0, 0, 0};
    qsort(sorted, n, sizeof *sorted, info_compare);
    return (struct spread){sorted[n / 20], sorted[n / 2], sorted[n - 1 - n / 20]};
}

#define INFO_NUMBER(value) oxl_json_number_text((char[48]){0}, value)

static void info_write_head(FILE *to, const oxl_model *m, int json)
{
    const double scale = m->scale > 0 ? m->scale : 1;
    if (json)
        fprintf(to,
                "{\n  \"gaussians\": %zu,\n  \"lobes\": %zu,\n  \"sh_degree\": %d,\n  \"not_finite\": %zu,\n"
                "  \"origin\": [%s, %s, %s],\n  \"scale\": %s",
                m->count, m->lobes, m->sh_degree, m->not_finite, INFO_NUMBER(m->origin[0]),
                INFO_NUMBER(m->origin[1]), INFO_NUMBER(m->origin[2]), INFO_NUMBER(scale));
    else
        fprintf(
            to,
            "Gaussians   %zu\nlobes       %zu (Gaussians with a second one)\nSH degree   %d\nnot finite  %zu\n"
            "origin      %.10g %.10g %.10g (world = local + origin)\n"
            "scale       %.10g (units of this file in a unit of the survey)\n"
            "            5th, 50th, 95th percentile\n",
            m->count, m->lobes, m->sh_degree, m->not_finite, m->origin[0], m->origin[1], m->origin[2], scale);
}

/* Prints the spread of a parameter. */
static void info_write_spread(FILE *to, const char *name, const struct spread *s, int json)
{
    const float value[3] = {s->low, s->middle, s->high};
    if (!json) {
        fprintf(to, "%-11s %.4g  %.4g  %.4g\n", name, s->low, s->middle, s->high);
        return;
    }
    fprintf(to, ",\n  \"%s\": [", name);
    for (int k = 0; k < 3; k++) {
        fputs(k ? ", " : "", to);
        if (isfinite(value[k])) fprintf(to, "%.6g", value[k]);
        else fputs("null", to);
    }
    fputc(']', to);
}

static void info_write(FILE *to, const oxl_model *m, float *sorted, int json)
{
    static const char *const names[] = {"x", "y", "z", "scale_0", "scale_1", "scale_2", "opacity"};
    static const int planes[] = {OXL_MEAN,          OXL_MEAN + 1,      OXL_MEAN + 2, OXL_LOG_SCALE,
                                 OXL_LOG_SCALE + 1, OXL_LOG_SCALE + 2, OXL_OPACITY};
    info_write_head(to, m, json);
    for (int i = 0; i < 7; i++) {
        struct spread s = info_spread(m->plane[planes[i]], m->count, sorted);
        if (i >= 3 && i < 6) s = (struct spread){expf(s.low), expf(s.middle), expf(s.high)};
        if (i == 6)
            s = (struct spread){1 / (1 + expf(-s.low)), 1 / (1 + expf(-s.middle)), 1 / (1 + expf(-s.high))};
        info_write_spread(to, names[i], &s, json);
    }
}

/* ---------------- imaging.txt beside a model (docs/IMAGING.md) */

static void info_imaging_path(const char *model, char path[4096])
{
    const char *base = strrchr(model, '/');
    snprintf(path, 4096, "%.*simaging.txt", base ? (int)(base + 1 - model) : 0, model);
}

/* Opens the imaging.txt beside `model`; returns NULL if there is none. */
static FILE *info_open_imaging(const char *model)
{
    char path[4096];
    info_imaging_path(model, path);
    return oxl_open(path);
}

/* Returns 1 for scene.* and scene_standard.*, whose colours hold the medium, as viewers need it. */
static int info_is_for_viewers(const char *model)
{
    const char *base = strrchr(model, '/');
    base = base ? base + 1 : model;
    return strncmp(base, "scene.", 6) == 0 || strncmp(base, "scene_standard.", 15) == 0;
}

static int info_is_gain(const char *line)
{
    return strncmp(line, "gain ", 5) == 0;
}

static int info_is_pose(const char *line)
{
    return strncmp(line, "pose ", 5) == 0;
}

static int info_is_medium(const char *line) /* of bD, bB or Binf */
{
    return line[0] == 'b' || line[0] == 'B' || line[0] == 'f';
}

/* Returns 1 for a line whose effect the colours of a model for viewers hold; gains: oxl_has_gains_alone. */
static int info_is_hidden(const char *line, int gains)
{
    return info_is_medium(line) || (gains && info_is_gain(line));
}

/* Returns 1 for the line with the file's checksum, which a copy without some of the lines must not have. */
static int info_is_checksum(const char *line)
{
    return strncmp(line, "# checksum ", 11) == 0;
}

static void info_write_imaging(oxl_context *ctx, FILE *to, const char *path, int json)
{
    FILE *file = info_open_imaging(path);
    const int alone = oxl_has_gains_alone(ctx, path);
    int gains = 0, poses = 0, lines = 0;
    char line[4096];
    while (file && fgets(line, sizeof line, file)) {
        if (info_is_hidden(line, alone) && info_is_for_viewers(path)) continue;
        gains += info_is_gain(line);
        poses += info_is_pose(line);
        if (line[0] == '#' || info_is_gain(line) || info_is_pose(line)) continue;
        line[strcspn(line, "\r\n")] = 0;
        if (json) {
            fputs(lines ? ", " : ",\n  \"imaging\": [", to);
            json_print(to, line);
        } else print_format(to, "%s%s\n", lines ? "            " : "imaging     ", line);
        lines++;
    }
    if (lines && json) fputc(']', to);
    if (gains) fprintf(to, json ? ",\n  \"gains\": %d" : "gains       of %d images, in imaging.txt\n", gains);
    if (poses) fprintf(to, json ? ",\n  \"poses\": %d" : "poses       of %d images, in imaging.txt\n", poses);
    if (file) fclose(file);
}

/* Adds the lines of the imaging.txt beside `model` that are hidden, or all the others. Returns 1
 * if there is such a file. */
static int info_take_lines(oxl_context *ctx, struct output *t, const char *model, int hidden)
{
    FILE *file = info_open_imaging(model);
    const int alone = oxl_has_gains_alone(ctx, model);
    char line[4096];
    while (file && fgets(line, sizeof line, file))
        if (line[0] != '#' && info_is_hidden(line, alone) == hidden) output_bytes(t, line, strlen(line));
    if (file) fclose(file);
    return file != NULL;
}

/* Compares the lines that `from` is rendered with and those that `to` will be.
 * Returns 1 if they are the same. */
static int info_is_same_imaging(oxl_context *ctx, const char *from, const char *to, int hidden,
                                struct output *a, struct output *b)
{
    if (!hidden || !info_is_for_viewers(from)) info_take_lines(ctx, a, from, hidden);
    /* from's is copied there */
    if (!info_take_lines(ctx, b, to, hidden)) output_bytes(b, a->data ? a->data : "", a->used);
    if (hidden && info_is_for_viewers(to)) b->used = 0;
    return a->failed || b->failed || (a->used == b->used && (!a->used || !memcmp(a->data, b->data, a->used)));
}

int info_takes_medium(oxl_context *ctx, const char *model)
{
    const char *base = strrchr(model, '/');
    struct output lines = {0};
    const int is_clear = strncmp(base ? base + 1 : model, "scene_clear.", 12) == 0;
    const int takes =
        !is_clear && !info_is_for_viewers(model) && info_take_lines(ctx, &lines, model, 1) && lines.used;
    free(lines.data);
    return takes;
}

oxl_result info_check_imaging(oxl_context *ctx, const char *from, const char *to, int *is_other)
{
    struct output hidden[2] = {{0}, {0}}, rest[2] = {{0}, {0}};
    const int same = info_is_same_imaging(ctx, from, to, 1, &hidden[0], &hidden[1]);
    oxl_result rc = OXL_OK;
    *is_other = !info_is_same_imaging(ctx, from, to, 0, &rest[0], &rest[1]);
    if (!same)
        rc = oxl_fail(
            ctx, OXL_ERR_USAGE,
            hidden[1].used
                ? "%s: not written: it would be rendered with the medium or gains that imaging.txt beside "
                  "it has, unlike %s\nfix: another folder"
                : "%s: not written: models called scene.* are rendered without the medium or gains of "
                  "imaging.txt, unlike %s\nfix: another name, such as clear.ply",
            to, from);
    for (int i = 0; i < 2; i++) free(hidden[i].data), free(rest[i].data);
    return rc;
}

oxl_result info_copy_imaging(oxl_context *ctx, const char *from, const char *to, int *copied)
{
    FILE *in = info_open_imaging(from), *there = in ? info_open_imaging(to) : NULL;
    const int hides = info_is_for_viewers(from), alone = hides && oxl_has_gains_alone(ctx, from);
    struct output out = {0};
    char path[4096], line[4096];
    int failed = 0, left = 0;
    while (in && fgets(line, sizeof line, in))
        left |= line[0] != '#' && !(hides && info_is_hidden(line, alone));
    if (in) rewind(in);
    *copied = in && !there && (left || !alone);
    info_imaging_path(to, path);
    if (*copied) output_open(&out, path);
    while (*copied && fgets(line, sizeof line, in))
        if (!info_is_checksum(line) && !(hides && info_is_hidden(line, alone)))
            output_bytes(&out, line, strlen(line));
    if (*copied) failed = ferror(in) != 0, out.failed |= failed, failed |= !output_close(&out);
    if (in) fclose(in);
    if (there) fclose(there);
    if (!failed) return OXL_OK;
    *copied = 0;
    return oxl_fail(ctx, OXL_ERR_IO,
                    "%s: the gains of the images could not be copied beside the model, which is there\n"
                    "fix: free space on the disk, and copy imaging.txt from beside %s",
                    path, from);
}

oxl_result info_print(oxl_context *ctx, FILE *to, const char *path, int json)
{
    oxl_model model = {0};
    float *sorted;
    oxl_result rc = oxl_model_read(ctx, path, &model);
    if (rc != OXL_OK) return rc;
    sorted = malloc((model.count + 1) * sizeof *sorted);
    if (sorted) info_write(to, &model, sorted, json);
    else rc = OXL_ERR_MEMORY;
    if (sorted) info_write_imaging(ctx, to, path, json);
    if (sorted && json) fprintf(to, "\n}\n");
    free(sorted);
    oxl_model_free(ctx, &model);
    return rc;
}

/* ---------------- a partition */

enum { INFO_BLOCKS = 60 }; /* most blocks that are printed; partition.txt has them all */

void info_print_blocks(FILE *to, const oxl_partition_report *r)
{
    double points = 0, views = 0, most_points = 0, most_views = 0;
    fprintf(to, "%6s %10s %10s %6s %7s %11s\n", "block", "points", "starts", "base", "border", "memory");
    for (int i = 0; i < r->block_count; i++) {
        const oxl_block *k = &r->block[i];
        const double seen_by = k->base_views + k->border_views;
        points += (double)k->points, views += seen_by;
        most_points = fmax(most_points, (double)k->points), most_views = fmax(most_views, seen_by);
        if (i < INFO_BLOCKS)
            fprintf(to, "%6d %10zu %10zu %6d %7d %11s\n", i, k->points, k->start_points, k->base_views,
                    k->border_views, OUTPUT_SIZE(k->memory));
    }
    if (r->block_count > INFO_BLOCKS) fprintf(to, "   ... and %d more\n", r->block_count - INFO_BLOCKS);
    fprintf(to, "\nlargest / mean: %.3f of the points, %.3f of the views\n",
            most_points * r->block_count / points, most_views * r->block_count / fmax(views, 1));
}

/* control.c - measures the accuracy of a georeferenced survey: compares control points of known coordinates
 * with the places where its cameras see them.
 *
 * A line of the file is NAME,X,Y,Z,IMG,X,Y,IMG,X,Y...: coordinates in the survey's world, and the point's
 * pixels in two original images or more. '#' begins a comment; a first line whose X is no number is a
 * header.
 */
#include "cli.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct control_sum {
    double square[3], miss;
    int count;
};

/* Prints the residuals of one line, and adds them to the sum. Skips comments and a header. */
static oxl_result control_line(oxl_context *ctx, const oxl_scene *scene, const char *line, size_t size,
                               int is_first, struct control_sum *sum, FILE *to)
{
    const double *origin = oxl_scene_origin(scene);
    double place[3], seen[3], miss, distance, d[3];
    int used = 0;
    oxl_result rc;
    if (size == 0 || line[0] == '#') return OXL_OK;
    sscanf(line, "%*[^,\n],%lf,%lf,%lf,%n", &place[0], &place[1], &place[2], &used);
    if (!used || (size_t)used > size)
        return is_first
                   ? OXL_OK
                   : oxl_fail(ctx, OXL_ERR_INPUT,
                              "found '%.*s', expected NAME,X,Y,Z and pixels\nfix: NAME,X,Y,Z,IMG,X,Y,IMG,X,Y",
                              (int)(size < 100 ? size : 100), line);
    rc = scale_place(ctx, scene, line + used, size - (size_t)used, seen, &miss, &distance);
    if (rc != OXL_OK) return rc;
    for (int k = 0; k < 3; k++) {
        d[k] = seen[k] + origin[k] - place[k];
        sum->square[k] += d[k] * d[k];
    }
    sum->count++;
    print_format(to, "%-16.*s %10.4f %10.4f %10.4f %10.4f %10.4f\n", (int)strcspn(line, ","), line, d[0],
                 d[1], d[2], sqrt(d[0] * d[0] + d[1] * d[1] + d[2] * d[2]), miss);
    return OXL_OK;
}

static void control_print_sum(const struct control_sum *s, FILE *to)
{
    double rms[3], all = 0;
    for (int k = 0; k < 3; k++) {
        rms[k] = sqrt(s->square[k] / s->count);
        all += s->square[k] / s->count;
    }
    fprintf(to, "%-16s %10.4f %10.4f %10.4f %10.4f  rms of %d\n", "", rms[0], rms[1], rms[2], sqrt(all),
            s->count);
}

oxl_result control_check(oxl_context *ctx, const oxl_scene *scene, const char *path, FILE *to)
{
    struct control_sum sum = {{0}, 0, 0};
    char folder[4096];
    const char *name = output_split(path, folder);
    char *text = output_read(folder, name);
    int number = 1;
    oxl_result rc = OXL_OK;
    if (!text) return oxl_fail(ctx, OXL_ERR_INPUT, "%s: the file cannot be read\nfix: --control FILE", path);
    fprintf(to, "%-16s %10s %10s %10s %10s %10s  (measured - given; rays' distance)\n", "control point", "dX",
            "dY", "dZ", "3D", "rays");
    for (const char *line = text; rc == OXL_OK && *line; number++) {
        const size_t size = strcspn(line, "\r\n");
        rc = control_line(ctx, scene, line, size, number == 1, &sum, to);
        if (rc != OXL_OK) {
            char why[600];
            snprintf(why, sizeof why, "%.599s", oxl_error_text(ctx));
            oxl_fail(ctx, rc, "%s:%d: %s", path, number, why);
        }
        line += size + strspn(line + size, "\r");
        line += *line == '\n';
    }
    free(text);
    if (rc == OXL_OK && sum.count == 0)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s holds no control point\nfix: write lines of "
                      "NAME,X,Y,Z,IMG,X,Y,IMG,X,Y",
                      path);
    if (rc == OXL_OK) control_print_sum(&sum, to);
    return rc;
}

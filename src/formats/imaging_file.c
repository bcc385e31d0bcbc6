/* imaging_file.c - reads and writes imaging.txt, the formation of images beside a model: gains, medium, lamp,
 * poses.
 *
 *     # comment
 *     gain 1.0231 0.9877 1.0102 dive1/IMG 0001.JPG      red green blue, then the name to the end of the line
 *
 * Lines of the medium, lamps and poses begin with bD, bB, Binf, lamp and pose.
 */
#include "formats.h"
#include "survey_read.h"
#include "../survey/imaging.h"
#include "../survey/scene.h"
#include "../core/vecmath.h"

#define IMAGING_MEDIUM_MAX 1e20   /* Limits bD and bB (1/unit; units may be tiny) and Binf in a file. */
#define IMAGING_DISTANCE_MAX 1e15 /* Limits distances (units); no camera lies farther. */

enum imaging_kind {
    IMAGING_ATTENUATION,
    IMAGING_BACKSCATTER,
    IMAGING_VEIL,
    IMAGING_LAMP_ALL,
    IMAGING_LAMP,
    IMAGING_GAIN,
    IMAGING_POSE,
    IMAGING_KINDS
};
static const struct imaging_line {
    const char *word;
    int count, has_name; /* numbers behind the word; 1: the name of an image behind them */
    double low, high;    /* of the numbers */
} imaging_lines[IMAGING_KINDS] = {
    {"bD", 3, 0, 0, IMAGING_MEDIUM_MAX},
    {"bB", 3, 0, 0, IMAGING_MEDIUM_MAX},
    {"Binf", 3, 0, 0, IMAGING_MEDIUM_MAX},
    {"lamp all", LAMP_TERMS, 0, -LAMP_SHAPE_MAX, LAMP_SHAPE_MAX},
    {"lamp", LAMP_TERMS, 1, -LAMP_SHAPE_MAX, LAMP_SHAPE_MAX},
    {"gain", 3, 1, EXPOSURE_MIN, 1 / EXPOSURE_MIN},
    {"pose", POSE_TERMS, 1, -IMAGING_DISTANCE_MAX, IMAGING_DISTANCE_MAX},
};

/* ---------------- writing */

static void imaging_write_line(struct text *t, enum imaging_kind kind, const double *values, const char *name)
{
    text_add(t, "%s", imaging_lines[kind].word);
    for (int k = 0; k < imaging_lines[kind].count; k++) text_add(t, " %s", NUMBER(values[k]));
    text_add(t, name ? " %s\n" : "\n", name);
}

static void imaging_write_floats(struct text *t, enum imaging_kind kind, const float *values,
                                 const char *name)
{
    double wide[LAMP_TERMS];
    for (int k = 0; k < imaging_lines[kind].count; k++) wide[k] = values[k];
    imaging_write_line(t, kind, wide, name);
}

static void imaging_write_views(struct text *t, const oxl_scene *scene, const struct oxl_imaging *m)
{
    for (int i = 0; i < m->views; i++) {
        double gain[3];
        for (int c = 0; c < 3; c++) gain[c] = vecmath_exp(m->log_gain[3 * i + c]);
        if (m->known[i]) imaging_write_line(t, IMAGING_GAIN, gain, scene->view[i].name);
    }
    if (m->pose)
        text_add(t,
                 "# pose TURN MOVE NAME: the camera turned, rad, and its centre moved, units of the scene, "
                 "right down ahead; training views\n");
    for (int v = 0; m->pose && v < scene->view_count; v++)
        if (pose_is_moved(m->pose[v])) imaging_write_line(t, IMAGING_POSE, m->pose[v], scene->view[v].name);
}

OXL_INTERNAL int imaging_is_needed(const struct oxl_imaging *m)
{
    return m->on || m->pose || m->lamps > 0 || imaging_alters_colours(m);
}

oxl_result oxl_imaging_write(oxl_context *ctx, const char *path, const oxl_scene *scene, const oxl_imaging *m)
{
    struct text t = {.ctx = ctx};
    oxl_result rc = imaging_check_scene(ctx, scene, m);
    if (rc != OXL_OK) return rc;
    text_add(&t, "# what lies between the colours of the model and the images: OceanXL " OXL_VERSION
                 ", docs/UNDERWATER.md\n"
                 "# gain RED GREEN BLUE NAME: the rendered image times these is the image; training views\n");
    if (m->medium.on) {
        text_add(&t, "# I = J exp(-bD r) + Binf (1 - exp(-bB r)), red green blue; r: range, bD and bB per "
                     "unit of the scene\n");
        imaging_write_floats(&t, IMAGING_ATTENUATION, m->medium.attenuation, NULL);
        imaging_write_floats(&t, IMAGING_BACKSCATTER, m->medium.backscatter, NULL);
        imaging_write_floats(&t, IMAGING_VEIL, m->medium.veiling_light, NULL);
    }
    if (m->lamps > 0)
        text_add(&t, "# lamp all; lamp ... NAME: of the camera that took NAME; log gain over the image, "
                     "products of Legendre polynomials of degree 0 to 4 in y and x\n");
    for (int i = 0; i < m->lamps; i++) {
        const int view = m->lamp[i].view;
        imaging_write_floats(&t, view < 0 ? IMAGING_LAMP_ALL : IMAGING_LAMP, m->lamp[i].shape,
                             view < 0 ? NULL : scene->view[view].name);
    }
    imaging_write_views(&t, scene, m);
    checksum_end_text(&t);
    rc = os_write_text(ctx, path, &t);
    text_free(&t);
    return rc;
}

/* ---------------- reading */

static int imaging_compare_name(const void *name, const void *view)
{
    return strcmp(name, ((const oxl_view *)view)->name);
}

/* Finds a view by the name that is the rest of a line; views are ordered by name. -1: none of that name. */
static int imaging_find(const oxl_scene *scene, const char *at, const char *end)
{
    char name[PATH_LENGTH];
    const oxl_view *found;
    while (end > at && (end[-1] == '\r' || end[-1] == ' ')) end--;
    snprintf(name, sizeof name, "%.*s", (int)OXL_MIN((size_t)(end - at), sizeof name - 1), at);
    found = bsearch(name, scene->view, (size_t)scene->view_count, sizeof *scene->view, imaging_compare_name);
    return found ? (int)(found - scene->view) : -1;
}

static int imaging_set_lamp(struct oxl_imaging *m, int view, const double *value)
{
    struct lamp *lamp = m->lamp;
    while (lamp < m->lamp + m->lamps && lamp->view != view) lamp++;
    if (lamp == m->lamp + LAMP_MAX) return 0;
    m->lamps = OXL_MAX(m->lamps, (int)(lamp - m->lamp) + 1);
    lamp->view = view;
    for (int k = 0; k < LAMP_TERMS; k++) lamp->shape[k] = (float)value[k];
    return 1;
}

/* Takes what a line states. Images of another block of the survey are not in the scene, and skipped. */
static int imaging_set(struct oxl_imaging *m, enum imaging_kind kind, int view, const double *value)
{
    float *const medium[3] = {m->medium.attenuation, m->medium.backscatter, m->medium.veiling_light};
    if (imaging_lines[kind].has_name && view < 0) return 1;
    if (kind == IMAGING_LAMP_ALL || kind == IMAGING_LAMP) return imaging_set_lamp(m, view, value);
    if (kind == IMAGING_GAIN) m->on = m->known[view] = 1;
    for (int k = 0; k < imaging_lines[kind].count; k++) {
        if (kind <= IMAGING_VEIL) m->medium.on = 1, medium[kind][k] = (float)value[k];
        else if (kind == IMAGING_POSE && k < 3 && fabs(value[k]) > 1) return 0;
        else if (kind == IMAGING_POSE) m->pose[view][k] = value[k];
        else m->log_gain[3 * view + k] = (float)vecmath_log(value[k]);
    }
    return 1;
}

/* Reads a line; 0: it is not complete, or no line of the file. */
static int imaging_read_line(const char *at, const char *end, const oxl_scene *scene, struct oxl_imaging *m)
{
    const struct imaging_line *line = imaging_lines;
    double value[LAMP_TERMS];
    for (; line < imaging_lines + IMAGING_KINDS; line++) {
        const size_t length = strlen(line->word);
        if ((size_t)(end - at) <= length || strncmp(at, line->word, length) || at[length] != ' ') continue;
        at += length;
        break;
    }
    if (line == imaging_lines + IMAGING_KINDS) return 0;
    for (int k = 0; k < line->count; k++) {
        while (at < end && *at == ' ') at++;
        if (!parse_double(&at, end, &value[k]) || !(value[k] >= line->low && value[k] <= line->high))
            return 0;
    }
    while (at < end && *at == ' ') at++;
    if (!line->has_name && at < end && *at != '\r') return 0;
    return imaging_set(m, (enum imaging_kind)(line - imaging_lines),
                       line->has_name ? imaging_find(scene, at, end) : -1, value);
}

static oxl_result imaging_read_lines(oxl_context *ctx, const char *path, const struct os_file_map *map,
                                     const oxl_scene *scene, struct oxl_imaging *m)
{
    int number = 0;
    for (const char *at = map->data, *end = at + map->size, *stop; at < end; at = stop + 1) {
        stop = memchr(at, '\n', (size_t)(end - at));
        if (!stop) stop = end;
        number++;
        if (!m->pose && !strncmp(at, "pose", 4) &&
            !(m->pose = oxl_calloc(ctx, (size_t)m->views + 1, sizeof *m->pose)))
            return OXL_ERR_MEMORY;
        if (stop > at && *at != '#' && *at != '\r' && !imaging_read_line(at, stop, scene, m))
            return oxl_fail(
                ctx, OXL_ERR_INPUT,
                "%s:%d: this is not a complete line of gain (%g to %g), bD, bB, Binf, lamp, pose or #\n"
                "fix: write the file again by training",
                path, number, EXPOSURE_MIN, 1 / EXPOSURE_MIN);
    }
    return OXL_OK;
}

/* Refuses a zero byte and, if the file ends in a checksum, a text with another one. */
static oxl_result imaging_check_bytes(oxl_context *ctx, const char *path, const struct os_file_map *map)
{
    const char *zero = memchr(map->data, 0, map->size);
    int line = 1;
    for (const char *at = map->data; zero && at < zero; at++) line += *at == '\n';
    if (zero)
        return oxl_fail(
            ctx, OXL_ERR_INPUT,
            "%s:%d: found a byte of value 0, expected text\nfix: write the file again by training", path,
            line);
    if (!checksum_is_wrong(map->data, map->size)) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "%s: the checksum does not match the lines: the file was damaged or edited\nfix: "
                    "write the file again by training, or remove its last line if you have edited it",
                    path);
}

OXL_INTERNAL oxl_result imaging_read(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                     struct oxl_imaging *out)
{
    struct os_file_map map = {0};
    oxl_result rc = imaging_create(ctx, scene->view_count, out);
    if (rc == OXL_OK) rc = imaging_set_cameras(ctx, scene, out);
    if (rc == OXL_OK) rc = os_read_file(ctx, path, &map);
    if (rc == OXL_OK) rc = imaging_check_bytes(ctx, path, &map);
    if (rc == OXL_OK) rc = imaging_read_lines(ctx, path, &map, scene, out);
    os_release_file(ctx, &map);
    if (rc != OXL_OK) imaging_free(ctx, out);
    return rc;
}

OXL_INTERNAL oxl_result imaging_read_beside(oxl_context *ctx, const char *model_path, const oxl_scene *scene,
                                            struct oxl_imaging *out)
{
    const char *name = path_base_name(model_path), *path = PATH_BESIDE(model_path, "imaging.txt");
    oxl_result rc = OXL_OK;
    *out = (struct oxl_imaging){0};
    if (os_is_file(path)) rc = imaging_read(ctx, path, scene, out);
    if (rc != OXL_OK || (strncmp(name, "scene.", 6) && strncmp(name, "scene_standard.", 15))) return rc;
    /* Images with gains alone go with scene_clear.ply, if train left it beside the model. */
    imaging_hide(out, os_is_file(PATH_BESIDE(model_path, "scene_clear.ply")));
    return OXL_OK;
}

oxl_result oxl_imaging_read(oxl_context *ctx, const char *model_path, const oxl_scene *scene,
                            oxl_imaging **out)
{
    struct oxl_imaging read;
    oxl_result rc = imaging_read_beside(ctx, model_path, scene, &read);
    *out = NULL;
    if (rc != OXL_OK || !read.views) return rc;
    *out = oxl_alloc(ctx, 1, sizeof **out);
    if (*out) **out = read;
    else imaging_free(ctx, &read), rc = OXL_ERR_MEMORY;
    return rc;
}

void oxl_imaging_free(oxl_context *ctx, oxl_imaging *imaging)
{
    if (imaging) imaging_free(ctx, imaging);
    oxl_free(ctx, imaging);
}

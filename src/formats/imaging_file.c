/* imaging_file.c - reads and writes imaging.txt, the formation of images beside a model: gains, medium, lamp,
 * poses.
 *
 *     # comment
 *     gain 1.0231 0.9877 1.0102 dive1/IMG 0001.JPG      red green blue, then the name to the end of the line
 *
 * Lines of the medium, lamps and poses begin with bD, bB, Binf, lamp and pose.
 */
#include "formats.h"
#include "../survey/imaging.h"
#include "../survey/scene.h"
#include "../core/vecmath.h"

#define IMAGING_MEDIUM_MAX 1e20   /* Limits bD and bB (1/unit; units may be tiny) and Binf in a file. */
#define IMAGING_DISTANCE_MAX 1e15 /* Limits distances (units); no camera lies farther. */

/* Adds a line of the file: a word, `count` numbers, and the name of an image or NULL. */
static void imaging_write_line(struct text *t, const char *word, const float *values, int count,
                               const char *name)
{
    text_add(t, "%s", word);
    for (int k = 0; k < count; k++) {
        text_add(t, " ");
        text_add_number(t, (double)values[k]);
    }
    text_add(t, name ? " %s\n" : "\n", name);
}

static void imaging_write_medium(struct text *t, const struct medium *m)
{
    if (m->on) {
        text_add(
            t,
            "# I = J exp(-bD r) + Binf (1 - exp(-bB r)), red green blue; r: range, bD and bB per unit of the scene\n");
        imaging_write_line(t, "bD", m->attenuation, 3, NULL);
        imaging_write_line(t, "bB", m->backscatter, 3, NULL);
        imaging_write_line(t, "Binf", m->veiling_light, 3, NULL);
    }
}

static void imaging_write_lamps(struct text *t, const oxl_scene *scene, const struct oxl_imaging *m)
{
    if (m->lamps > 0)
        text_add(
            t,
            "# lamp all; lamp ... NAME: of the camera that took NAME; log gain over the image, products of Legendre polynomials of "
            "degree 0 to 4 in y and x\n");
    for (int i = 0; i < m->lamps; i++)
        imaging_write_line(t, m->lamp[i].view < 0 ? "lamp all" : "lamp", m->lamp[i].shape, LAMP_TERMS,
                           m->lamp[i].view < 0 ? NULL : oxl_scene_view(scene, m->lamp[i].view)->name);
}

static void imaging_write_poses(struct text *t, const oxl_scene *scene, const struct oxl_imaging *m)
{
    if (m->pose)
        text_add(t,
                 "# pose TURN MOVE NAME: the camera turned, rad, and its centre moved, units of the scene, "
                 "right down ahead; training views\n");
    for (int v = 0; m->pose && v < oxl_scene_view_count(scene); v++) {
        if (!pose_is_moved(m->pose[v])) continue;
        text_add(t, "pose");
        for (int k = 0; k < POSE_TERMS; k++) text_add(t, " %s", NUMBER(m->pose[v][k]));
        text_add(t, " %s\n", oxl_scene_view(scene, v)->name);
    }
}

static int imaging_read_values(const char **at, const char *end, double lowest, double highest, float *values,
                               int count)
{
    for (int k = 0; k < count; k++) {
        double value;
        while (*at < end && **at == ' ') ++*at;
        if (!parse_double(at, end, &value) || !(value >= lowest && value <= highest)) return 0;
        values[k] = (float)value;
    }
    while (*at < end && **at == ' ') ++*at;
    return 1;
}

/* Returns 1 for `count` numbers from lowest to highest, and no more. */
static int imaging_read_numbers(const char *at, const char *end, double lowest, double highest, float *values,
                                int count)
{
    return imaging_read_values(&at, end, lowest, highest, values, count) && (at == end || *at == '\r');
}

/* Finds a view by its name; views are ordered by name. -1: none of that name. */
static int imaging_find(const oxl_scene *scene, const char *name, size_t length)
{
    for (int low = 0, high = oxl_scene_view_count(scene) - 1; low <= high;) {
        const int middle = low + (high - low) / 2;
        const char *at = oxl_scene_view(scene, middle)->name;
        int order = strncmp(at, name, length);
        /* Orders a view whose name goes on after `length` behind. */
        if (order == 0 && strlen(at) != length) order = strlen(at) > length ? 1 : -1;
        if (order == 0) return middle;
        if (order < 0) low = middle + 1;
        else high = middle - 1;
    }
    return -1;
}

/* Finds a view by the name that is the rest of a line. */
static int imaging_find_name(const oxl_scene *scene, const char *at, const char *end)
{
    while (end > at && (end[-1] == '\r' || end[-1] == ' ')) end--;
    return imaging_find(scene, at, (size_t)(end - at));
}

static int imaging_skip_word(const char **at, const char *end, const char *word)
{
    const size_t length = strlen(word);
    if ((size_t)(end - *at) <= length || strncmp(*at, word, length) != 0 || (*at)[length] != ' ') return 0;
    *at += length + 1;
    return 1;
}

/* Returns 1 if the line states the medium and is complete. */
static int imaging_read_medium(const char *at, const char *end, struct medium *m)
{
    static const char *const names[3] = {"bD", "bB", "Binf"};
    float *const values[3] = {m->attenuation, m->backscatter, m->veiling_light};
    for (int k = 0; k < 3; k++)
        if (imaging_skip_word(&at, end, names[k]))
            return m->on = imaging_read_numbers(at, end, 0, IMAGING_MEDIUM_MAX, values[k], 3);
    return 0;
}

/* Returns 1 if the line states a lamp and is complete; skips the lamp of a view that
 * the scene does not have. */
static int imaging_read_lamp(const char *at, const char *end, const oxl_scene *scene, struct oxl_imaging *m)
{
    struct lamp lamp = {.view = -1};
    int which = 0;
    if (!imaging_skip_word(&at, end, "lamp")) return 0;
    if (imaging_skip_word(&at, end, "all")) {
        if (!imaging_read_numbers(at, end, -LAMP_SHAPE_MAX, LAMP_SHAPE_MAX, lamp.shape, LAMP_TERMS)) return 0;
    } else {
        if (!imaging_read_values(&at, end, -LAMP_SHAPE_MAX, LAMP_SHAPE_MAX, lamp.shape, LAMP_TERMS)) return 0;
        lamp.view = imaging_find_name(scene, at, end);
        if (lamp.view < 0) return 1;
    }
    while (which < m->lamps && m->lamp[which].view != lamp.view) which++;
    if (which == LAMP_MAX) return 0;
    m->lamps = OXL_MAX(m->lamps, which + 1);
    m->lamp[which] = lamp;
    return 1;
}

/* Returns 1 if the line states a pose and is complete; skips the pose of a view that
 * the scene does not have. */
static int imaging_read_pose(const char *at, const char *end, const oxl_scene *scene, struct oxl_imaging *m)
{
    double pose[POSE_TERMS];
    int view;
    if (!imaging_skip_word(&at, end, "pose")) return 0;
    for (int k = 0; k < POSE_TERMS; k++) {
        while (at < end && *at == ' ') at++;
        if (!parse_double(&at, end, &pose[k]) || !(fabs(pose[k]) <= (k < 3 ? 1 : IMAGING_DISTANCE_MAX)))
            return 0;
    }
    while (at < end && *at == ' ') at++;
    view = imaging_find_name(scene, at, end);
    if (view >= 0) memcpy(m->pose[view], pose, sizeof pose);
    return 1;
}

OXL_INTERNAL int imaging_is_needed(const struct oxl_imaging *m)
{
    return m->on || m->pose || m->lamps > 0 || imaging_alters_colours(m);
}

oxl_result oxl_imaging_write(oxl_context *ctx, const char *path, const oxl_scene *scene, const oxl_imaging *m)
{
    struct text t = {.ctx = ctx};
    oxl_result rc;
    text_add(&t, "# what lies between the colours of the model and the images: OceanXL " OXL_VERSION
                 ", docs/UNDERWATER.md\n"
                 "# gain RED GREEN BLUE NAME: the rendered image times these is the image; training views\n");
    imaging_write_medium(&t, &m->medium);
    imaging_write_lamps(&t, scene, m);
    for (int i = 0; i < m->views; i++) {
        if (!m->known[i]) continue;
        text_add(&t, "gain");
        for (int c = 0; c < 3; c++) {
            text_add(&t, " ");
            text_add_number(&t, vecmath_exp(m->log_gain[3 * i + c]));
        }
        text_add(&t, " %s\n", oxl_scene_view(scene, i)->name);
    }
    imaging_write_poses(&t, scene, m);
    checksum_end_text(&t);
    rc = os_write_text(ctx, path, &t);
    text_free(&t);
    return rc;
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
    if (checksum_of_text(map->data, map->size) != CHECKSUM_WRONG) return OXL_OK;
    return oxl_fail(ctx, OXL_ERR_INPUT,
                    "%s: the checksum does not match the lines: the file was damaged or edited\nfix: "
                    "write the file again by training, or remove its last line if you have edited it",
                    path);
}

/* Reads a line "gain R G B NAME" of the file. */
static oxl_result imaging_read_gain(oxl_context *ctx, const char *path, int line, const char *at,
                                    const char *end, const oxl_scene *scene, struct oxl_imaging *out)
{
    double gain[3];
    int view;
    for (int c = 0; c < 3; c++) {
        while (at < end && *at == ' ') at++;
        if (!parse_double(&at, end, &gain[c]) || !(gain[c] >= EXPOSURE_MIN && gain[c] <= 1 / EXPOSURE_MIN))
            return oxl_fail(
                ctx, OXL_ERR_INPUT,
                "%s:%d: the gain of channel %d is missing or is not a number from %g to %g\nfix: write the file again by training",
                path, line, c, EXPOSURE_MIN, 1 / EXPOSURE_MIN);
    }
    while (at < end && *at == ' ') at++;
    view = imaging_find_name(scene, at, end);
    if (view < 0) return OXL_OK; /* Skips an image of another block of the survey. */
    out->known[view] = 1;
    out->on = 1;
    for (int c = 0; c < 3; c++) out->log_gain[3 * view + c] = (float)vecmath_log(gain[c]);
    return OXL_OK;
}

/* Reads the file; skips names that are not in the scene. */
OXL_INTERNAL oxl_result imaging_read(oxl_context *ctx, const char *path, const oxl_scene *scene,
                                     struct oxl_imaging *out)
{
    struct os_file_map map = {0};
    oxl_result rc = imaging_create(ctx, oxl_scene_view_count(scene), out);
    int line = 0;
    if (rc == OXL_OK) rc = imaging_set_cameras(ctx, scene, out);
    if (rc == OXL_OK) rc = os_read_file(ctx, path, &map);
    if (rc == OXL_OK) rc = imaging_check_bytes(ctx, path, &map);
    for (const char *at = map.data, *end = map.data + map.size; rc == OXL_OK && at < end;) {
        const char *stop = memchr(at, '\n', (size_t)(end - at));
        if (!stop) stop = end;
        line++;
        if (stop - at > 5 && strncmp(at, "pose ", 5) == 0 && !out->pose)
            out->pose = oxl_calloc(ctx, (size_t)out->views + 1, sizeof *out->pose);
        if (stop - at > 5 && strncmp(at, "pose ", 5) == 0 && !out->pose) rc = OXL_ERR_MEMORY;
        else if (stop - at > 5 && strncmp(at, "gain ", 5) == 0)
            rc = imaging_read_gain(ctx, path, line, at + 5, stop, scene, out);
        else if (stop > at && *at != '#' && *at != '\r' && !imaging_read_medium(at, stop, &out->medium) &&
                 !imaging_read_lamp(at, stop, scene, out) && !imaging_read_pose(at, stop, scene, out))
            rc = oxl_fail(
                ctx, OXL_ERR_INPUT,
                "%s:%d: this is not a complete line of gain, bD, bB, Binf, lamp, pose or #\nfix: write "
                "the file again by training",
                path, line);
        at = stop + 1;
    }
    os_release_file(ctx, &map);
    if (rc != OXL_OK) imaging_free(ctx, out);
    return rc;
}

/* Returns 1 if train left scene_clear.ply beside the model, which images with gains alone go with. */
static int imaging_has_clear(const char *model_path)
{
    const int folder = (int)(path_base_name(model_path) - model_path);
    return os_is_file(PATH("", "%.*sscene_clear.ply", folder, model_path));
}

/* Notes which terms the file beside the model has, whatever the survey; a damaged file is refused where it is
 * read. */
int oxl_has_gains_alone(oxl_context *ctx, const char *model_path)
{
    const int folder = (int)(path_base_name(model_path) - model_path);
    const char *path = PATH("", "%.*simaging.txt", folder, model_path);
    struct oxl_imaging has = {0};
    struct os_file_map map = {0};
    if (!imaging_has_clear(model_path) || !os_is_file(path) || os_read_file(ctx, path, &map) != OXL_OK)
        return 0;
    for (const char *at = map.data, *end = map.data + map.size; at < end;) {
        const char *stop = memchr(at, '\n', (size_t)(end - at)), *word = at;
        if (!stop) stop = end;
        has.on |= imaging_skip_word(&word, stop, "gain");
        has.lamps |= imaging_skip_word(&word, stop, "lamp");
        imaging_read_medium(at, stop, &has.medium);
        at = stop + 1;
    }
    os_release_file(ctx, &map);
    return imaging_is_gains_alone(&has);
}

OXL_INTERNAL oxl_result imaging_read_beside(oxl_context *ctx, const char *model_path, const oxl_scene *scene,
                                            struct oxl_imaging *out)
{
    const char *name = path_base_name(model_path);
    const char *path = PATH("", "%.*simaging.txt", (int)(name - model_path), model_path);
    oxl_result rc = OXL_OK;
    *out = (struct oxl_imaging){0};
    if (os_is_file(path)) rc = imaging_read(ctx, path, scene, out);
    if (rc != OXL_OK || (strncmp(name, "scene.", 6) && strncmp(name, "scene_standard.", 15))) return rc;
    imaging_hide(out, imaging_has_clear(model_path));
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

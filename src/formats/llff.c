/* llff.c - reads poses_bounds.npy of LLFF [Mildenhall 2019], for the images of a folder in the order of their
 * names.
 *
 * Source: llff/poses/pose_utils.py of Fyusion/LLFF. The file is a NumPy array of N x 17 numbers:
 *
 *     "\x93NUMPY"  u8 major  u8 minor  header's length, u16 in major 1, else u32
 *     {'descr': '<f8', 'fortran_order': False, 'shape': (N, 17), }  blanks, newline, then the numbers by rows
 *
 * A row is a 3 x 5 matrix, then the range of the depths of points in the image. The matrix has the camera's
 * axes in the world, down, right and back, the camera's centre, and height, width and focal length in px of
 * the images that COLMAP saw. images_4 and images_8 are the same images, a quarter and an eighth of the size.
 */
#include "../core/bytes.h"
#include "../survey/image.h"
#include "../survey/scene.h"
#include "json_survey.h"

enum {
    LLFF_COLUMNS = 17,
    LLFF_SIDE = 1600 /* px; longer side of the images of the folder that is chosen, at most [Kerbl 2023] */
};

struct llff_array {
    const char *data;
    size_t rows;
    int size; /* bytes of a number */
};

#define LLFF_FIX "write it again with LLFF's imgs2poses.py, or remove it and export a COLMAP model"

/* Finds the numbers behind the header, whose keys NumPy writes in this order. */
static void llff_read_header(struct colmap_reader *r, const struct os_file_map *file, struct llff_array *out)
{
    const size_t wide = file->size > 6 && file->data[6] > 1 ? 4 : 2, begin = 8 + wide;
    char head[200], seen[64], end;
    size_t length, left, row;
    unsigned long rows = 0;
    int columns = 0;
    if (file->size < begin || memcmp(file->data, "\x93NUMPY", 6) != 0) {
        r->field = file->data, r->end = file->data + file->size;
        colmap_fail(r, LLFF_FIX, "found %s, expected an array that np.save wrote",
                    file->size == 0                    ? "an empty file"
                    : memcmp(file->data, "PK", 2) == 0 ? "a zip archive, as np.savez writes it"
                                                       : colmap_printable(r, seen));
        return;
    }
    length = OXL_MIN((size_t)bytes_get(file->data + 8, (int)wide), file->size - begin);
    snprintf(head, sizeof head, "%.*s", (int)OXL_MIN(length, sizeof head - 1), file->data + begin);
    head[strcspn(head, "}\n")] = 0;
    if (sscanf(head, " { 'descr' : '<f%d' , 'fortran_order' : False , 'shape' : ( %lu %*[L, ] %d%c",
               &out->size, &rows, &columns, &end) != 4 ||
        (out->size != 4 && out->size != 8) || columns != LLFF_COLUMNS || !strchr("L)", end))
        colmap_fail(r, LLFF_FIX,
                    "found an array of %s}, expected '<f8' or '<f4', Fortran order False, and shape (N, 17)",
                    head);
    if (r->rc != OXL_OK) return;
    out->data = file->data + begin + length;
    out->rows = (size_t)rows;
    left = file->size - begin - length, row = LLFF_COLUMNS * (size_t)out->size;
    if (left / row != out->rows || left % row)
        colmap_fail(r, LLFF_FIX, "found %zu bytes after the header, expected %lu x 17 numbers of %d bytes",
                    left, rows, out->size);
}

/* Adds the image of a row, and its camera. */
static void llff_add(struct colmap_reader *r, const struct llff_array *a, const char *name)
{
    double v[LLFF_COLUMNS], m[3][4], q[4], t[3], sum = 0;
    struct colmap_camera camera = {.model = camera_model_find("PINHOLE", 7)};
    struct colmap_image *image;
    for (size_t i = 0; i < LLFF_COLUMNS; i++) {
        const char *at = a->data + ((size_t)r->line * LLFF_COLUMNS + i) * (size_t)a->size;
        v[i] = a->size == 8 ? bytes_double(at) : (double)bytes_float(at);
        sum += fabs(v[i]);
    }
    r->line++;
    if (!(sum <= DBL_MAX && v[4] >= 1 && v[4] < INT_MAX && v[9] >= 1 && v[9] < INT_MAX))
        colmap_fail(
            r, LLFF_FIX,
            "found height %g, width %g and numbers that add up to %g, expected pixels and finite numbers",
            v[4], v[9], sum);
    if (r->rc != OXL_OK) return;
    for (int i = 0; i < 3; i++)
        m[i][0] = v[5 * i + 1], m[i][1] = -v[5 * i], m[i][2] = v[5 * i + 2], m[i][3] = v[5 * i + 3];
    json_survey_pose(r, "the matrix", m, q, t);
    camera.height = (int)(v[4] + 0.5), camera.width = (int)(v[9] + 0.5);
    camera.parameter[0] = camera.parameter[1] = v[14];
    camera.parameter[2] = v[9] / 2, camera.parameter[3] = v[4] / 2;
    json_survey_add_image(r, name, json_survey_camera(r, &camera), q, t);
    if (r->rc != OXL_OK || !(v[15] > 0 && v[15] < v[16])) return;
    image = &r->out->image[r->out->image_count - 1];
    image->range[0] = v[15], image->range[1] = v[16];
}

/* ---------------- the images */

struct llff_folder {
    oxl_context *ctx;
    char path[PATH_LENGTH];
    struct scene_order *image; /* by name */
    size_t count, image_capacity;
    oxl_result rc;
};

static void llff_visit(void *user, const char *name)
{
    struct llff_folder *f = user;
    if (f->rc != OXL_OK || !survey_is_image_name(name)) return;
    f->rc = OXL_RESERVE(f->ctx, f->image, f->count + 1);
    if (f->rc != OXL_OK) return;
    f->image[f->count] = (struct scene_order){oxl_strdup(f->ctx, name), f->count};
    if (f->image[f->count++].name == NULL) f->rc = OXL_ERR_MEMORY;
}

static void llff_forget(struct llff_folder *f)
{
    for (size_t i = 0; i < f->count; i++) oxl_free(f->ctx, (char *)f->image[i].name);
    f->count = 0;
}

/* Lists the images of f->path in the order of their names. */
static void llff_list(struct llff_folder *f)
{
    llff_forget(f);
    if (os_is_folder(f->path)) os_list_folder(f->ctx, f->path, llff_visit, f);
    if (f->count && f->rc == OXL_OK) qsort(f->image, f->count, sizeof *f->image, scene_compare_order);
}

/* Lists the folder of the largest images of at most LLFF_SIDE, or else the last one that there is. */
static void llff_choose(struct colmap_reader *r, struct llff_folder *f)
{
    static const char *const names[] = {"images", "images_2", "images_4", "images_8"};
    for (int i = 0, width = INT_MAX, height = 0; i < 4 && OXL_MAX(width, height) > LLFF_SIDE; i++) {
        const char *path = PATH_BESIDE(r->path, names[i]);
        if (i > 0 && !os_is_folder(path)) continue;
        memcpy(f->path, path, PATH_LENGTH);
        llff_list(f);
        if (f->count && f->rc == OXL_OK)
            image_size(r->ctx, PATH(path, "%s", f->image[0].name), &width, &height);
    }
}

OXL_INTERNAL void llff_read(struct colmap_reader *r, const struct os_file_map *file)
{
    struct llff_folder f = {.ctx = r->ctx};
    struct llff_array array = {0};
    llff_read_header(r, file, &array);
    if (r->rc != OXL_OK) return;
    snprintf(f.path, sizeof f.path, "%s", r->given.images ? r->given.images : "");
    if (r->given.images) llff_list(&f);
    else llff_choose(r, &f);
    r->rc = f.rc;
    if (f.count != array.rows)
        colmap_fail(r, "use --images to name the folder of the images that the poses belong to",
                    "found %zu images in %s, expected %zu, one for each pose", f.count, f.path, array.rows);
    for (size_t i = 0; i < f.count && r->rc == OXL_OK; i++) llff_add(r, &array, f.image[i].name);
    if (r->rc == OXL_OK && (r->out->images = oxl_strdup(r->ctx, f.path)) == NULL) r->rc = OXL_ERR_MEMORY;
    llff_forget(&f);
    oxl_free(r->ctx, f.image);
}

/* gltf.c - writes models as binary glTF files (GLB) with the extension KHR_gaussian_splatting.
 *
 * Source: the glTF 2.0 specification, 5.20 "GLB"; KhronosGroup/glTF,
 * extensions/2.0/Khronos/KHR_gaussian_splatting (release candidate).
 *
 *     "glTF" 2 length | length "JSON" text, padded with blanks | length "BIN\0" the arrays, one after the
 *     other
 *
 * All attributes are float: positions, unit quaternions x y z w, activated scales and opacities, harmonics by
 * degree and order with the signs of the standard PLY. The frame is converted (frame_flip.h); the origin is
 * the node's translation, in 17 digits, and the model's scale, if any, is extras.scale of the node. The
 * format has no second lobes.
 *
 * Invariant: valid files: unit rotations, opacities in 0..1, finite scales, bounds of the positions.
 */
#include "formats.h"

#include "../core/bytes.h"
#include "../core/vecmath.h"
#include "frame_flip.h"

#include <inttypes.h>

enum { GLTF_ARRAYS = 4, GLTF_FLOAT = 5126, GLTF_BUFFER = 1024 };

struct gltf_array {
    const char *semantic, *type;
    int width; /* floats a Gaussian */
};

static const struct gltf_array gltf_arrays[GLTF_ARRAYS] = {{"POSITION", "VEC3", 3},
                                                           {"KHR_gaussian_splatting:ROTATION", "VEC4", 4},
                                                           {"KHR_gaussian_splatting:SCALE", "VEC3", 3},
                                                           {"KHR_gaussian_splatting:OPACITY", "SCALAR", 1}};

static int gltf_count(const oxl_model *model)
{
    return GLTF_ARRAYS + (model->sh_degree + 1) * (model->sh_degree + 1);
}

static int gltf_width(int array)
{
    return array < GLTF_ARRAYS ? gltf_arrays[array].width : 3;
}

/* ---------------- numbers */

static void gltf_rotation(const oxl_model *model, size_t row, float out[4])
{
    double q[4];
    model_rotation(model, row, q);
    for (int i = 0; i < 4; i++) out[i] = (float)(q[(i + 1) % 4] * (i == 1 || i == 2 ? -1 : 1)); /* x y z w */
}

static void gltf_values(const oxl_model *model, int array, size_t row, float out[4])
{
    const int k = array - GLTF_ARRAYS;
    for (int i = 0; i < gltf_width(array); i++) {
        if (array == 0) out[i] = model->plane[OXL_MEAN + i][row] * (i ? -1.0f : 1.0f);
        if (array == 2) out[i] = (float)OXL_MIN(vecmath_exp(model->plane[OXL_LOG_SCALE + i][row]), FLT_MAX);
        if (array == 3) out[i] = (float)vecmath_sigmoid(model->plane[OXL_OPACITY][row]);
        if (k >= 0) out[i] = model->plane[OXL_SH + 3 * k + i][row] * (k ? (float)frame_flip_sh[k - 1] : 1.0f);
    }
    if (array == 1) gltf_rotation(model, row, out);
}

static void gltf_write_array(FILE *file, const oxl_model *model, int array)
{
    unsigned char bytes[16 * GLTF_BUFFER];
    const int width = gltf_width(array);
    for (size_t first = 0; first < model->count; first += GLTF_BUFFER) {
        const size_t rows = OXL_MIN(model->count - first, (size_t)GLTF_BUFFER);
        for (size_t i = 0; i < rows; i++) {
            float value[4];
            gltf_values(model, array, first + i, value);
            for (int k = 0; k < width; k++)
                bytes_put_float(bytes + 4 * (i * (size_t)width + (size_t)k), value[k]);
        }
        fwrite(bytes, 4 * (size_t)width, rows, file); /* Leaves errors to os_writer_close. */
    }
}

/* ---------------- the text */

/* Adds the bounds of the positions, which the specification requires. */
static void gltf_add_bounds(struct text *t, const oxl_model *model)
{
    double low[3] = {0}, high[3] = {0};
    for (int k = 0; k < 3; k++)
        for (size_t i = 0; i < model->count; i++) {
            const double x = model->plane[OXL_MEAN + k][i] * (k ? -1.0 : 1.0);
            low[k] = i ? OXL_MIN(low[k], x) : x;
            high[k] = i ? OXL_MAX(high[k], x) : x;
        }
    text_add(t, ",\"min\":[%s,%s,%s],\"max\":[%s,%s,%s]", NUMBER(low[0] + 0.0), NUMBER(low[1] + 0.0),
             NUMBER(low[2] + 0.0), NUMBER(high[0] + 0.0), NUMBER(high[1] + 0.0), NUMBER(high[2] + 0.0));
}

/* Names the k-th array of SH by its degree and coefficient; the degrees are 0; 1 1 1; 2 2 2 2 2 and so on. */
static void gltf_add_semantic(struct text *t, int array)
{
    const int k = array - GLTF_ARRAYS, degree = k < 1 ? 0 : k < 4 ? 1 : k < 9 ? 2 : 3;
    if (k < 0) text_add(t, "\"%s\":%d", gltf_arrays[array].semantic, array);
    else
        text_add(t, "\"KHR_gaussian_splatting:SH_DEGREE_%d_COEF_%d\":%d", degree, k - degree * degree, array);
}

/* Adds the origin as the node's translation, in the frame of glTF, and what glTF has
 * no member for as extras. */
static void gltf_add_origin(struct text *t, const oxl_model *model)
{
    const double *o = model->origin;
    const int extras = model->scale > 0 || model->has_background || model->antialias;
    const char *before = "";
    text_add(t, "\"translation\":[");
    for (int i = 0; i < 3; i++) {
        char text[NUMBER_TEXT_MAX];
        format_double(text, i ? 0.0 - o[i] : o[i]);
        text_add(t, "%s%s", i ? "," : "", text);
    }
    text_add(t, "]");
    if (extras) text_add(t, ",\"extras\":{");
    if (model->scale > 0) text_add(t, "\"scale\":%s", NUMBER(model->scale)), before = ",";
    if (model->has_background)
        text_add(t, "%s\"background\":[%s,%s,%s]", before, NUMBER((double)model->background[0]),
                 NUMBER((double)model->background[1]), NUMBER((double)model->background[2])),
            before = ",";
    if (model->antialias) text_add(t, "%s\"antialias\":true", before);
    if (extras) text_add(t, "}");
}

static oxl_result gltf_text(oxl_context *ctx, const oxl_model *model, uint64_t bytes, struct text *t)
{
    const int arrays = gltf_count(model);
    uint64_t offset = 0;
    (void)ctx;
    text_add(
        t,
        "{\"asset\":{\"version\":\"2.0\",\"generator\":\"OceanXL " OXL_VERSION "\"},"
        "\"extensionsUsed\":[\"KHR_gaussian_splatting\"],\"scene\":0,\"scenes\":[{\"nodes\":[0]}],\"nodes\":[{\"mesh\":0,");
    gltf_add_origin(t, model);
    text_add(t, "}],\"meshes\":[{\"primitives\":[{\"mode\":0,\"attributes\":{");
    for (int i = 0; i < arrays; i++) text_add(t, i ? "," : ""), gltf_add_semantic(t, i);
    text_add(
        t,
        "},\"extensions\":{\"KHR_gaussian_splatting\":{\"kernel\":\"ellipse\",\"colorSpace\":\"srgb_rec709_display\","
        "\"projection\":\"perspective\",\"sortingMethod\":\"cameraDistance\"}}}]}],\"accessors\":[");
    for (int i = 0; i < arrays; i++) {
        text_add(t, "%s{\"bufferView\":%d,\"componentType\":%d,\"count\":%zu,\"type\":\"%s\"", i ? "," : "",
                 i, GLTF_FLOAT, model->count, i < GLTF_ARRAYS ? gltf_arrays[i].type : "VEC3");
        if (i == 0) gltf_add_bounds(t, model);
        text_add(t, "}");
    }
    text_add(t, "],\"bufferViews\":[");
    for (int i = 0; i < arrays; i++) {
        const uint64_t size = 4 * (uint64_t)gltf_width(i) * model->count;
        text_add(t, "%s{\"buffer\":0,\"byteOffset\":%" PRIu64 ",\"byteLength\":%" PRIu64 ",\"target\":34962}",
                 i ? "," : "", offset, size);
        offset += size;
    }
    text_add(t, "],\"buffers\":[{\"byteLength\":%" PRIu64 "}]}", bytes);
    while (t->size % 4) text_add(t, " ");
    return t->failed ? OXL_ERR_MEMORY : OXL_OK;
}

/* ---------------- the file */

static void gltf_write_chunk(FILE *file, uint64_t length, const char *kind)
{
    unsigned char head[8];
    bytes_put(head, length, 4);
    memcpy(head + 4, kind, 4);
    fwrite(head, 1, sizeof head, file);
}

OXL_INTERNAL oxl_result gltf_write(oxl_context *ctx, const char *path, const oxl_model *model)
{
    struct text t = {.ctx = ctx};
    struct os_writer w = {0};
    unsigned char head[12] = {'g', 'l', 'T', 'F', 2};
    uint64_t bytes = 0, all;
    oxl_result rc;
    if (model->count == 0)
        return oxl_fail(
            ctx, OXL_ERR_FAILED,
            "%s: glTF has no empty arrays, and the model holds no Gaussians\nfix: write it as .ply", path);
    for (int i = 0; i < gltf_count(model); i++) bytes += 4 * (uint64_t)gltf_width(i) * model->count;
    rc = gltf_text(ctx, model, bytes, &t);
    all = 12 + 8 + t.size + 8 + bytes;
    if (rc != OXL_OK) rc = oxl_fail(ctx, rc, "%s: no memory for its header", path);
    else if (all > UINT32_MAX)
        rc = oxl_fail(ctx, OXL_ERR_FAILED,
                      "%s: a GLB holds 4 GB, this model needs %" PRIu64 " bytes\nfix: write it as .ply", path,
                      all);
    if (rc == OXL_OK) rc = os_writer_open(ctx, path, &w);
    if (rc == OXL_OK) {
        bytes_put(head + 8, all, 4);
        fwrite(head, 1, sizeof head, w.file);
        gltf_write_chunk(w.file, t.size, "JSON");
        fwrite(t.data, 1, t.size, w.file);
        gltf_write_chunk(w.file, bytes, "BIN\0");
        for (int i = 0; i < gltf_count(model); i++) gltf_write_array(w.file, model, i);
        rc = os_writer_close(ctx, &w, OXL_OK);
    }
    text_free(&t);
    return rc;
}

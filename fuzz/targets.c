/* targets.c - readers of external files and text, each as a function of some bytes: for fuzz.c and
 * tests/test_fuzz.c.
 *
 * It promises of any bytes: no crash, no undefined behaviour, no memory left, never more of it than
 * FUZZ_MEMORY, and a text that says why when something is refused.
 *
 * Include it after oceanxl.c.
 */
#ifndef FUZZ_TARGETS_C
#define FUZZ_TARGETS_C
#include "../cli/arguments.c"
#include "../cli/options.c"

#define FUZZ_MEMORY ((size_t)64 << 20) /* bytes; inputs are of a few thousand */

/* ---------------- a context that counts */

struct fuzz_memory {
    size_t held, blocks;
};

/* The size precedes the block. */
static void *fuzz_reallocate(void *user, void *old, size_t size)
{
    enum { HEAD = 16 };
    struct fuzz_memory *m = user;
    char *raw = old ? (char *)old - HEAD : NULL;
    size_t old_size = 0;
    if (raw) memcpy(&old_size, raw, sizeof old_size);
    if (size == 0) {
        m->held -= old_size;
        m->blocks -= raw != NULL;
        free(raw);
        return NULL;
    }
    if (size > FUZZ_MEMORY || m->held - old_size + size > FUZZ_MEMORY) return NULL;
    if ((raw = realloc(raw, HEAD + size)) == NULL) return NULL;
    memcpy(raw, &size, sizeof size);
    m->held += size - old_size;
    m->blocks += old == NULL;
    return raw + HEAD;
}

static void fuzz_promise(int kept, const char *what)
{
    if (kept) return;
    fprintf(stderr, "fuzz: not kept: %s\n", what);
    abort();
}

/* Either it went well or there is a text. */
static void fuzz_explained(oxl_context *ctx, oxl_result rc)
{
    fuzz_promise(rc == OXL_OK || oxl_error_text(ctx)[0], "a refusal has a text");
    ctx->error[0] = 0;
}

/* ---------------- bytes as files */

static const char *fuzz_folder(void)
{
    static char folder[128];
    if (folder[0]) return folder;
    snprintf(folder, sizeof folder, "%s/oceanxl-fuzz-%ld", os_is_folder("/dev/shm") ? "/dev/shm" : "/tmp",
             os_process());
    os_make_one_folder(folder);
    return folder;
}

static const char *fuzz_path(const char *name)
{
    static char path[160];
    snprintf(path, sizeof path, "%s/%s", fuzz_folder(), name);
    return path;
}

static void fuzz_write(const char *name, const uint8_t *data, size_t size)
{
    FILE *file = fopen(fuzz_path(name), "wb");
    fuzz_promise(file && (size == 0 || fwrite(data, 1, size, file) == size) && fclose(file) == 0,
                 "the input can be written");
}

static void fuzz_clean(void)
{
    static const char *const names[] = {
        "cameras.txt", "images.txt", "points3D.txt",    "model.ply",           "model.splat",
        "run.json",    "block.json", "transforms.json", "reconstruction.json", "model.spz",
        "cameras.bin", "images.bin", "points3D.bin",    "imaging.txt"};
    for (size_t i = 0; i < OXL_COUNT(names); i++) os_remove(fuzz_path(names[i]));
    remove(fuzz_folder());
    os_make_one_folder(fuzz_folder());
}

/* ---------------- COLMAP: three files, a form feed between them */

static void fuzz_colmap_files(const uint8_t *data, size_t size)
{
    static const char *const names[] = {"cameras.txt", "images.txt", "points3D.txt"};
    for (int i = 0; i < 3; i++) {
        const uint8_t *feed = i < 2 ? memchr(data, '\f', size) : NULL;
        const size_t part = feed ? (size_t)(feed - data) : size;
        fuzz_write(names[i], data, part);
        data += part + (feed != NULL), size -= part + (feed != NULL);
    }
}

/* No step of a path goes up, and it does not begin at the top. */
static int fuzz_stays_inside(const char *name)
{
    if (!name[0] || name[0] == '/' || name[0] == '\\') return 0;
    for (const char *part = name;; part += strcspn(part, "/\\") + 1) {
        if (strncmp(part, "..", 2) == 0 && strchr("/\\", part[2])) return 0; /* strchr finds the end too */
        if (!part[strcspn(part, "/\\")]) return 1;
    }
}

/* What was promised of names and ids. */
static void fuzz_check_colmap(const struct colmap *c)
{
    for (size_t i = 0; i < c->image_count; i++)
        fuzz_promise(fuzz_stays_inside(c->names + c->image[i].name), "names stay in the image folder");
    for (size_t i = 0; i < c->track_count; i++)
        fuzz_promise(c->track[i].image_row < c->image_count, "tracks name images");
    for (size_t i = 0; i < c->point_count; i++)
        fuzz_promise(c->point[i].first_track + c->point[i].track_count <= c->track_count,
                     "points have their tracks");
}

/* The model in the folder: whole, then as a scene, then cut into blocks. */
static void fuzz_use_colmap(oxl_context *ctx)
{
    oxl_scene_options options = oxl_scene_options_default();
    oxl_partition_options cut = oxl_job_options_default(OXL_PRESET_DRAFT).partition;
    struct partition partition;
    struct colmap c;
    oxl_scene *scene = NULL;
    oxl_result rc = colmap_read(ctx, fuzz_folder(), 64, NULL, &c);
    fuzz_explained(ctx, rc);
    if (rc != OXL_OK) return;
    fuzz_check_colmap(&c);
    colmap_free(ctx, &c);
    options.read_images = 0;
    cut.block_points = 4;
    rc = oxl_scene_load(ctx, fuzz_folder(), &options, &scene);
    fuzz_explained(ctx, rc);
    if (rc == OXL_OK) {
        fuzz_explained(ctx, partition_make(ctx, scene, &cut, &partition));
        partition_free(ctx, &partition);
    }
    oxl_scene_free(ctx, scene);
}

static void fuzz_colmap(oxl_context *ctx, const uint8_t *data, size_t size)
{
    fuzz_clean();
    fuzz_colmap_files(data, size);
    fuzz_use_colmap(ctx);
}

/* Two lengths of 16 bits, little endian: of the first and the second file; what is left is the third. */
static void fuzz_colmap_binary(oxl_context *ctx, const uint8_t *data, size_t size)
{
    static const char *const names[] = {"cameras.bin", "images.bin", "points3D.bin"};
    size_t part[3] = {0, 0, 0};
    fuzz_clean();
    if (size < 4) return;
    part[0] = OXL_MIN((size_t)data[0] | (size_t)data[1] << 8, size - 4);
    part[1] = OXL_MIN((size_t)data[2] | (size_t)data[3] << 8, size - 4 - part[0]);
    part[2] = size - 4 - part[0] - part[1];
    for (int i = 0; i < 3; i++)
        fuzz_write(names[i], data + 4 + (i > 0) * part[0] + (i > 1) * part[1], part[i]);
    fuzz_use_colmap(ctx);
}

/* A '{' at the start: nerfstudio's file; the first byte of NumPy's: LLFF's, without images; else OpenSfM's. */
static void fuzz_json_survey(oxl_context *ctx, const uint8_t *data, size_t size)
{
    const char *name = size > 0 && data[0] == '{'    ? "transforms.json"
                       : size > 0 && data[0] == 0x93 ? "poses_bounds.npy"
                                                     : "reconstruction.json";
    oxl_scene_options options = oxl_scene_options_default();
    oxl_scene *scene = NULL;
    struct colmap c;
    oxl_result rc;
    fuzz_clean();
    fuzz_write(name, data, size);
    rc = json_survey_read(ctx, fuzz_folder(), name, NULL, &c);
    fuzz_explained(ctx, rc);
    if (rc != OXL_OK) return;
    fuzz_check_colmap(&c);
    colmap_free(ctx, &c);
    options.read_images = 0;
    fuzz_explained(ctx, oxl_scene_load(ctx, fuzz_folder(), &options, &scene));
    oxl_scene_free(ctx, scene);
}

/* ---------------- models */

/* A model that was read can be written and rendered. */
static void fuzz_use_model(oxl_context *ctx, const oxl_model *model)
{
    const oxl_camera camera = {16, 16, 20, 20, 8, 8, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0, 0, 2}};
    oxl_image image;
    oxl_result rc = oxl_render(ctx, model, &camera, NULL, &image, NULL);
    fuzz_explained(ctx, rc);
    for (int i = 0; rc == OXL_OK && i < 3 * 16 * 16; i++)
        fuzz_promise(fabsf(image.rgb[i]) <= FLT_MAX, "a finite image");
    oxl_image_free(ctx, &image);
}

static void fuzz_model(oxl_context *ctx, const char *name, const uint8_t *data, size_t size)
{
    oxl_model model;
    oxl_result rc;
    fuzz_write(name, data, size);
    rc = oxl_model_read(ctx, fuzz_path(name), &model);
    fuzz_explained(ctx, rc);
    if (rc == OXL_OK) fuzz_use_model(ctx, &model);
    oxl_model_free(ctx, &model);
}

static void fuzz_ply(oxl_context *ctx, const uint8_t *data, size_t size)
{
    fuzz_model(ctx, "model.ply", data, size);
}

/* Bytes that begin with "NGSP" are what gzip packs: wrapped in one stored block with the right sum, which no
 * mutation would find. */
static void fuzz_spz(oxl_context *ctx, const uint8_t *data, size_t size)
{
    enum { HEAD = 15, TAIL = 8 };
    unsigned char *file;
    if (size < 4 || size > 0xffff || memcmp(data, "NGSP", 4) != 0) {
        fuzz_model(ctx, "model.spz", data, size);
        return;
    }
    file = calloc(HEAD + size + TAIL, 1);
    fuzz_promise(file != NULL, "memory for the input");
    memcpy(file, "\x1f\x8b\x08", 3);
    file[10] = 1; /* the last block, stored; its size and the complement of it */
    for (size_t i = 0; i < 2; i++)
        file[11 + i] = (unsigned char)(size >> 8 * i), file[13 + i] = (unsigned char)(~size >> 8 * i);
    memcpy(file + HEAD, data, size);
    bytes_put(file + HEAD + size, codec_png_checksum(data, (int)size), 4);
    bytes_put(file + HEAD + size + 4, (uint32_t)size, 4);
    fuzz_model(ctx, "model.spz", file, HEAD + size + TAIL);
    free(file);
}

static void fuzz_splat(oxl_context *ctx, const uint8_t *data, size_t size)
{
    fuzz_model(ctx, "model.splat", data, size);
}

static oxl_scene *fuzz_scene(oxl_context *ctx)
{
    enum { SIDE = 12, VIEWS = 3, POINTS = 6 };
    static const char *const names[VIEWS] = {"a", "b", "c"};
    oxl_view view[VIEWS];
    oxl_image image[VIEWS];
    oxl_point point[POINTS];
    oxl_scene *scene = NULL;
    for (int i = 0; i < POINTS; i++)
        point[i] =
            (oxl_point){.position = {0.3 * (i % 3) - 0.3, 0.3 * (i / 3), 0.1 * i}, .rgb = {90, 120, 200}};
    for (int v = 0; v < VIEWS; v++) {
        view[v] =
            (oxl_view){names[v], {SIDE, SIDE, 14, 14, 6, 6, {1, 0, 0, 0, 1, 0, 0, 0, 1}, {0.1 * v, 0, 2}}, 0};
        fuzz_promise(oxl_image_create(ctx, SIDE, SIDE, &image[v]) == OXL_OK, "memory for an image");
    }
    fuzz_promise(oxl_scene_from_arrays(ctx, view, image, VIEWS, point, POINTS, &scene) == OXL_OK,
                 "a scene of three views");
    for (int v = 0; v < VIEWS; v++) oxl_image_free(ctx, &image[v]);
    return scene;
}

/* ---------------- run.json, block.json */

static void fuzz_run(oxl_context *ctx, const uint8_t *data, size_t size)
{
    oxl_job_options options = oxl_job_options_default(OXL_PRESET_DRAFT);
    struct oxl_manifest run;
    struct block_record record;
    struct text line = {.ctx = ctx}, inputs = line;
    oxl_result rc;
    fuzz_write("run.json", data, size);
    fuzz_write("block.json", data, size);
    fuzz_write("model.ply", data, 0);
    rc = manifest_read(ctx, fuzz_folder(), &run);
    fuzz_explained(ctx, rc);
    if (rc == OXL_OK && run.text) {
        manifest_options(&run, &options);
        manifest_describe(&line, &inputs, "scene", &options);
        manifest_differences(&run, line.data, &inputs);
    }
    text_free(&line);
    text_free(&inputs);
    manifest_free(ctx, &run);
    fuzz_explained(ctx, block_read(ctx, fuzz_folder(), "\"job\": {", &record));
}

/* ---------------- what a run leaves for itself: with a right checksum, so that ranges are all that is left */

static void fuzz_imaging(oxl_context *ctx, const uint8_t *data, size_t size)
{
    oxl_scene *scene = fuzz_scene(ctx);
    struct oxl_imaging m = {0};
    oxl_result rc;
    fuzz_write("imaging.txt", data, size);
    rc = imaging_read(ctx, fuzz_path("imaging.txt"), scene, &m);
    fuzz_explained(ctx, rc);
    for (int i = 0; rc == OXL_OK && i < 3 * m.views; i++)
        fuzz_promise(fabsf(m.log_gain[i]) <= FLT_MAX, "gains are finite");
    imaging_free(ctx, &m);
    oxl_scene_free(ctx, scene);
}

/* ---------------- words: one a line */

static void fuzz_options(oxl_context *ctx, const uint8_t *data, size_t size)
{
    enum { WORDS = 24 };
    char *text = oxl_calloc(ctx, size + 1, 1), *argv[WORDS + 1] = {(char *)"oceanxl"};
    int argc = 1;
    struct arguments a;
    fuzz_promise(text != NULL, "memory for the words");
    if (size) memcpy(text, data, size);
    for (char *word = text; argc < WORDS && word < text + size; word += strlen(word) + 1) {
        word[strcspn(word, "\n")] = 0;
        argv[argc++] = word;
    }
    if (arguments_parse(argc, argv, &a)) {
        fuzz_promise(a.error[0] != 0, "a refusal has a text");
    } else {
        fuzz_promise(oxl_job_options_check(ctx, &a.job) == OXL_OK, "what was parsed is in range");
    }
    oxl_free(ctx, text);
}

/* ---------------- the list */

static const struct fuzz_target {
    const char *name; /* its inputs are in fuzz/corpus/NAME */
    void (*run)(oxl_context *ctx, const uint8_t *data, size_t size);
} fuzz_targets[] = {{"colmap", fuzz_colmap},
                    {"colmap_binary", fuzz_colmap_binary},
                    {"json_survey", fuzz_json_survey},
                    {"spz", fuzz_spz},
                    {"ply", fuzz_ply},
                    {"splat", fuzz_splat},
                    {"run", fuzz_run},
                    {"imaging", fuzz_imaging},
                    {"options", fuzz_options}};

static void fuzz_one(const struct fuzz_target *target, const uint8_t *data, size_t size)
{
    struct fuzz_memory memory = {0};
    oxl_context_options options = oxl_context_options_default();
    oxl_context *ctx;
    options.reallocate = fuzz_reallocate;
    options.user = &memory;
    options.threads = 1;
    fuzz_promise(oxl_context_create(&options, &ctx) == OXL_OK, "a context");
    target->run(ctx, data, size);
    oxl_context_free(ctx);
    fuzz_promise(memory.blocks == 0 && memory.held == 0, "all memory is given back");
}

#endif

/* model_formats.c - the formats of model files, a row each, and the public functions that choose among them.
 *
 * A file is read by what its first bytes say it is, else by its name; it is written by its name.
 */
#include "formats.h"

struct model_format {
    const char *ending;   /* end of the file's name; the first row that fits is taken */
    const char *begin[2]; /* first bytes of the file; NULL: any */
    oxl_result (*read)(oxl_context *ctx, const char *path, oxl_model *out);
    oxl_result (*write)(oxl_context *ctx, const char *path, const oxl_model *model);
    int has_lobes;   /* 1: it stores second lobes */
    const char *why; /* reason and fix if `read` or `write` is NULL */
};

static oxl_result model_write_ply(oxl_context *ctx, const char *path, const oxl_model *model)
{
    return model_file_write_ply(ctx, path, model, 3);
}

static const struct model_format MODEL_FORMATS[] = {
    {"_standard.ply", {NULL}, model_file_read_ply, model_write_ply, 0, NULL},
    {".compressed.ply",
     {NULL},
     model_file_read_ply,
     NULL,
     0,
     "viewers take this name for PlayCanvas's compressed PLY\n"
     "fix: a name that ends in .ply alone, then splat-transform IN.ply OUT.compressed.ply"},
    {".ply", {"ply"}, model_file_read_ply, model_write_ply, 1, NULL},
    {".splat", {NULL}, splat_file_read, splat_file_write, 0, NULL},
    {".spz", {"\x1f\x8b", "NGSP"}, spz_read, spz_write, 0, NULL},
    {".glb",
     {"glTF"},
     NULL,
     NULL,
     0,
     "a file in the format glTF is neither read nor written\n"
     "fix: read the .ply or .spz that it was made from; write it by splat-transform IN.ply OUT.glb"},
    {".sog",
     {"PK\3\4"},
     NULL,
     NULL,
     0,
     "a zip file, a model in the format SOG or a checkpoint of PyTorch, is neither read nor written\n"
     "fix: splat-transform IN.sog OUT.ply, or the other way; of a checkpoint, its program exports a PLY"},
    {".ksplat",
     {NULL},
     NULL,
     NULL,
     0,
     "a model in the format of GaussianSplats3D, KSPLAT, is neither read nor written\n"
     "fix: splat-transform IN.ksplat OUT.ply"},
};

/* Compares extensions without regard to case. */
static int model_format_ends(const char *path, const char *ending)
{
    const size_t n = strlen(path), m = strlen(ending);
    for (size_t i = 0; i < m && n >= m; i++) {
        const char c = path[n - m + i];
        if ((c >= 'A' && c <= 'Z' ? c + 'a' - 'A' : c) != ending[i]) return 0;
    }
    return n >= m;
}

/* Finds the format by the file's name; NULL: no row has this ending. */
static const struct model_format *model_format_by_name(const char *path)
{
    for (size_t i = 0; i < OXL_COUNT(MODEL_FORMATS); i++)
        if (model_format_ends(path, MODEL_FORMATS[i].ending)) return &MODEL_FORMATS[i];
    return NULL;
}

enum { MODEL_HEAD = 64 }; /* bytes by which a file is known */

/* Finds the format by the file's first bytes, or else by its name. */
static const struct model_format *model_format_of_file(const char *path, const char head[MODEL_HEAD + 1])
{
    for (size_t i = 0; i < OXL_COUNT(MODEL_FORMATS); i++)
        for (int k = 0; k < 2 && MODEL_FORMATS[i].begin[k]; k++)
            if (!strncmp(head, MODEL_FORMATS[i].begin[k], strlen(MODEL_FORMATS[i].begin[k])))
                return &MODEL_FORMATS[i];
    return model_format_by_name(path);
}

/* Reads the first bytes. Returns 1 if they are text, but no PLY's or SPZ's: a web page, or git-lfs's pointer
 * to a file. */
static int model_read_head(const char *path, char head[MODEL_HEAD + 1])
{
    FILE *file = os_open(path);
    const size_t size = file ? fread(head, 1, MODEL_HEAD, file) : 0;
    size_t text = 0;
    if (file) fclose(file);
    head[size] = 0;
    while (text < size && head[text] && ((unsigned char)head[text] >= ' ' || strchr("\r\n\t", head[text])))
        text++;
    return size > 0 && text == size && strncmp(head, "ply", 3) && strncmp(head, "NGSP", 4);
}

oxl_result oxl_model_read(oxl_context *ctx, const char *path, oxl_model *out)
{
    char head[MODEL_HEAD + 1];
    const int is_text = model_read_head(path, head);
    const struct model_format *format = model_format_of_file(path, head);
    oxl_result rc;
    *out = (oxl_model){0};
    if (format && !format->read) rc = oxl_fail(ctx, OXL_ERR_INPUT, "%s: %s", path, format->why);
    else if (is_text)
        rc = oxl_fail(ctx, OXL_ERR_INPUT,
                      "%s: the file is text that begins '%.*s', not a model\nfix: download the model "
                      "itself; a web page or a pointer of git-lfs was saved under its name",
                      path, (int)OXL_MIN(strcspn(head, "\r\n"), (size_t)40), head);
    else rc = (format ? format->read : model_file_read_ply)(ctx, path, out);
    if (rc == OXL_OK) rc = model_file_drop_rows(ctx, path, out);
    if (rc == OXL_OK && out->count == 0)
        oxl_log(ctx, OXL_LOG_WARNING, "%s holds no Gaussians: there is nothing to draw", path);
    if (rc != OXL_OK) oxl_model_free(ctx, out);
    return rc;
}

oxl_result oxl_model_write(oxl_context *ctx, const char *path, const oxl_model *model)
{
    const struct model_format *format = model_format_by_name(path);
    oxl_model stored = *model; /* a copy that shares its planes, for model_drop_lobes */
    if (!format || !format->write)
        return oxl_fail(ctx, OXL_ERR_USAGE, "%s: not written: %s", path,
                        format ? format->why
                               : "the format is not known\nfix: a name that ends in .ply, .spz or .splat");
    if (model->lobes && !format->has_lobes) {
        oxl_log(ctx, OXL_LOG_WARNING, "%s: this format cannot store the second lobes of %zu of %zu Gaussians",
                path, model->lobes, model->count);
        model_drop_lobes(&stored);
    }
    return format->write(ctx, path, &stored);
}

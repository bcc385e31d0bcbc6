/* checkpoint.c - the training state in a file, from which a killed run resumes.
 *
 *     8  "OXLSTATE"        8  version of this layout        8 + n  key: the options and the scene that the
 *     run depends on
 *     ...  the state, as the modules' archive functions list it        8  FNV-1a of all bytes before it
 *
 * Everything is little endian. A module describes its state once, in one function that goes both ways (struct
 * archive).
 *
 * Invariant: once one checkpoint has been written, at least one of checkpoint.oxl and checkpoint.prev.oxl is
 * complete. The new one is written under a temporary name; the current one is renamed to checkpoint.prev.oxl;
 * the new one, flushed to disk, is renamed to checkpoint.oxl (os_writer_close in os.c). A crash between the
 * two renames leaves checkpoint.prev.oxl.
 */
#include "train_tools.h"

#include <errno.h>

#define CHECKPOINT_MAGIC UINT64_C(0x45544154534C584F) /* "OXLSTATE" */
#define CHECKPOINT_PRIME UINT64_C(0x100000001B3)

enum { CHECKPOINT_CHUNK = 1 << 16 };

/* ---------------- bytes, both ways */

OXL_INTERNAL uint64_t checkpoint_hash(uint64_t sum, const unsigned char *bytes, size_t size)
{
    for (size_t i = 0; i < size; i++) sum = (sum ^ bytes[i]) * CHECKPOINT_PRIME;
    return sum;
}

OXL_INTERNAL uint64_t checkpoint_sum(const void *bytes, size_t size)
{
    return checkpoint_hash(CHECKPOINT_SEED, bytes, size);
}

static void archive_fail(struct archive *a, oxl_result rc, const char *what)
{
    if (a->rc == OXL_OK)
        a->rc = oxl_fail(a->ctx, rc, "%s: %s\nfix: %s", a->path, what,
                         rc == OXL_ERR_IO ? "check the disk and its free space"
                                          : "remove this file, or train with --restart");
}

/* Converts a number to the disk's order, low byte first, or back. */
static void archive_swap(unsigned char *bytes, size_t size)
{
    const uint16_t one = 1;
    if (*(const unsigned char *)&one == 1) return;
    for (size_t i = 0; i < size / 2; i++) OXL_SWAP(unsigned char, bytes[i], bytes[size - 1 - i]);
}

static void archive_write(struct archive *a, const unsigned char *data, size_t count, size_t size)
{
    unsigned char chunk[4096];
    const size_t room = sizeof chunk / size;
    for (size_t at = 0; at < count && a->rc == OXL_OK; at += room) {
        const size_t n = OXL_MIN(room, count - at);
        memcpy(chunk, data + at * size, n * size);
        for (size_t i = 0; i < n; i++) archive_swap(chunk + i * size, size);
        a->sum = checkpoint_hash(a->sum, chunk, n * size);
        if (fwrite(chunk, size, n, a->file) != n)
            archive_fail(a, OXL_ERR_IO, "cannot write; the disk may be full");
    }
}

static void archive_write_memory(struct archive *a, const unsigned char *data, size_t bytes)
{
    struct archive_memory *m = a->memory;
    a->rc = oxl_reserve(a->ctx, &m->data, &m->capacity, m->size + bytes, 1);
    if (a->rc != OXL_OK || bytes == 0) return;
    memcpy(m->data + m->size, data, bytes);
    m->size += bytes;
}

OXL_INTERNAL int archive_fits(struct archive *a, size_t count, size_t size)
{
    if (a->reading && a->rc == OXL_OK && count > a->left / size)
        archive_fail(a, OXL_ERR_INPUT, "ends too early");
    return a->rc == OXL_OK;
}

static void archive_read(struct archive *a, unsigned char *data, size_t count, size_t size)
{
    if (!archive_fits(a, count, size)) return;
    if (a->memory) {
        if (count > 0) memcpy(data, a->memory->data + a->memory->size - a->left, count * size);
        a->left -= count * size;
        return;
    }
    if (fread(data, size, count, a->file) != count) archive_fail(a, OXL_ERR_IO, "cannot be read");
    for (size_t i = 0; i < count; i++) archive_swap(data + i * size, size);
    a->left -= count * size;
}

static void archive_numbers(struct archive *a, void *data, size_t count, size_t size)
{
    if (a->rc != OXL_OK) return;
    if (a->reading) archive_read(a, data, count, size);
    else if (a->memory) archive_write_memory(a, data, count * size);
    else archive_write(a, data, count, size);
}

/* ---------------- what modules call */

static void archive_u64(struct archive *a, uint64_t *value)
{
    archive_numbers(a, value, 1, sizeof *value);
}

OXL_INTERNAL void archive_int(struct archive *a, int *value)
{
    uint64_t bits = (uint64_t)(int64_t)*value;
    archive_u64(a, &bits);
    if (a->reading && a->rc == OXL_OK) *value = (int)(int64_t)bits;
}

OXL_INTERNAL void archive_size(struct archive *a, size_t *value)
{
    uint64_t bits = *value;
    archive_u64(a, &bits);
    if (a->reading && a->rc == OXL_OK) *value = (size_t)bits;
    if (a->rc == OXL_OK && bits > SIZE_MAX)
        archive_fail(a, OXL_ERR_INPUT, "holds more than this machine can address");
}

OXL_INTERNAL void archive_doubles(struct archive *a, double *values, size_t count)
{
    archive_numbers(a, values, count, sizeof *values);
}

OXL_INTERNAL void archive_floats(struct archive *a, float *values, size_t count)
{
    archive_numbers(a, values, count, sizeof *values);
}

OXL_INTERNAL void archive_ints(struct archive *a, int *values, size_t count)
{
    for (size_t i = 0; i < count; i++) archive_int(a, &values[i]);
}

OXL_INTERNAL void archive_expect(struct archive *a, int is_so)
{
    if (a->reading && !is_so && !a->memory)
        archive_fail(a, OXL_ERR_INPUT,
                     "holds invalid numbers\nfix: remove this file and run again; the run starts again");
}

OXL_INTERNAL void archive_text(struct archive *a, struct text *t)
{
    size_t size = t->size;
    char *data = NULL;
    archive_size(a, &size);
    if (!a->reading) {
        archive_numbers(a, t->data, size, 1);
        return;
    }
    if (!archive_fits(a, size, 1)) return;
    data = oxl_calloc(a->ctx, size + 1, 1);
    if (!data) archive_fail(a, OXL_ERR_MEMORY, "no memory for a text in it");
    else archive_numbers(a, data, size, 1);
    text_free(t);
    if (data) text_add(t, "%s", data);
    oxl_free(a->ctx, data);
}

OXL_INTERNAL void archive_model(struct archive *a, oxl_model *model)
{
    size_t count = model->count, lobes = model->lobes;
    int degree = model->sh_degree;
    const int antialias = model->antialias; /* the run's, which no step changes */
    archive_size(a, &count);
    archive_size(a, &lobes);
    archive_int(a, &degree);
    if (a->reading) {
        oxl_model_free(a->ctx, model);
        if (archive_fits(a, count, OXL_SH * sizeof(float)))
            a->rc = oxl_model_create(a->ctx, count, degree, model);
        model->antialias = antialias;
        if (a->rc == OXL_OK) a->rc = model_set_lobes(a->ctx, model, lobes);
    }
    archive_doubles(a, model->origin, 3);
    for (int k = 0; k < oxl_model_planes(model) && a->rc == OXL_OK; k++)
        archive_floats(a, model->plane[k], count);
    for (int k = OXL_LOBE; lobes && k < OXL_PLANES && a->rc == OXL_OK; k++)
        archive_floats(a, model->plane[k], lobes);
    for (size_t i = 0; a->reading && a->rc == OXL_OK && i < count; i++)
        archive_expect(a, model_row_is_finite(model, i));
}

OXL_INTERNAL oxl_result archive_to_memory(oxl_context *ctx, struct archive_memory *memory,
                                          checkpoint_state *state, void *user)
{
    struct archive a = {.ctx = ctx, .path = "memory", .memory = memory};
    memory->size = 0;
    state(&a, user);
    return a.rc;
}

OXL_INTERNAL oxl_result archive_from_memory(oxl_context *ctx, struct archive_memory *memory,
                                            checkpoint_state *state, void *user)
{
    struct archive a = {.ctx = ctx, .path = "memory", .memory = memory, .reading = 1, .left = memory->size};
    state(&a, user);
    return a.rc;
}

/* ---------------- writing */

static void checkpoint_add_key(struct archive *a, const char *key)
{
    size_t length = strlen(key);
    archive_size(a, &length);
    archive_write(a, (const unsigned char *)key, length, 1);
}

static const char *const checkpoint_names[] = {
    "checkpoint.oxl", "checkpoint.prev.oxl", "checkpoint.oxl.other",
    "checkpoint.prev.oxl.other"}; /* the latter two: see checkpoint_rename */

/* Renames a checkpoint of another run to NAME.other, which replaces an earlier one. */
static oxl_result checkpoint_rename(oxl_context *ctx, const char *path)
{
    const char *renamed = PATH("", "%s.other", path);
    if (os_rename(path, renamed) != 0)
        return oxl_fail(
            ctx, OXL_ERR_IO,
            "%s belongs to a run with other options or of another version, and cannot be renamed (%s)\n"
            "fix: move it, or choose another folder with -o",
            path, strerror(errno));
    oxl_log(ctx, OXL_LOG_WARNING,
            "%s is of a run with other options or of another version; it is kept as %s\n"
            "fix: rename it back and remove run.json to resume that run, or delete it",
            path, renamed);
    return OXL_OK;
}

OXL_INTERNAL oxl_result checkpoint_write(oxl_context *ctx, const char *folder, const char *key,
                                         checkpoint_state *state, void *user)
{
    uint64_t magic = CHECKPOINT_MAGIC, version = CHECKPOINT_VERSION, sum;
    const char *path = PATH(folder, "%s", checkpoint_names[0]);
    struct os_writer writer;
    struct archive a = {.ctx = ctx, .path = path, .sum = CHECKPOINT_SEED};
    oxl_result rc = os_make_folder(ctx, folder); /* it may have been deleted */
    if (rc == OXL_OK) rc = os_writer_open(ctx, path, &writer);
    if (rc != OXL_OK) return rc;
    a.file = writer.file;
    archive_u64(&a, &magic);
    archive_u64(&a, &version);
    checkpoint_add_key(&a, key);
    state(&a, user);
    sum = a.sum;
    archive_u64(&a, &sum);
    if (a.rc == OXL_OK && fflush(writer.file) != 0)
        archive_fail(&a, OXL_ERR_IO, "cannot write; the disk may be full");
    if (a.rc == OXL_OK)
        os_rename(path, PATH(folder, "%s", checkpoint_names[1])); /* there is none before the first */
    return os_writer_close(ctx, &writer, a.rc);
}

/* ---------------- reading */

/* Reads the file through once: 1 when it ends in the sum of its bytes. */
static int checkpoint_is_whole(FILE *file, uint64_t *size)
{
    unsigned char chunk[CHECKPOINT_CHUNK + 8];
    uint64_t sum = CHECKPOINT_SEED, stored = 0;
    size_t held = 0, got;
    *size = 0;
    while ((got = fread(chunk + held, 1, CHECKPOINT_CHUNK, file)) > 0) { /* the last 8 bytes are held back */
        const size_t body = held + got > 8 ? held + got - 8 : 0;
        sum = checkpoint_hash(sum, chunk, body);
        *size += got;
        held = held + got - body;
        memmove(chunk, chunk + body, held);
    }
    for (size_t i = 0; i < 8; i++) stored |= (uint64_t)chunk[i] << 8 * i;
    return held == 8 && *size >= 40 && stored == sum && !ferror(file);
}

/* Returns 1 if the checkpoint has this key. */
static int checkpoint_has_key(struct archive *a, const char *key)
{
    size_t length = 0;
    int same;
    archive_size(a, &length);
    same = a->rc == OXL_OK && length == strlen(key);
    for (size_t i = 0; i < length && same; i++) {
        char c = 0;
        archive_numbers(a, &c, 1, 1);
        same = a->rc == OXL_OK && c == key[i];
    }
    return same;
}

static oxl_result checkpoint_read_one(oxl_context *ctx, const char *path, const char *key,
                                      checkpoint_state *state, void *user, int *found)
{
    struct archive a = {.ctx = ctx, .reading = 1, .path = path, .file = os_open(path)};
    uint64_t magic = 0, version = 0;
    int other = 0;
    if (!a.file) return os_is_file(path) ? os_fail(ctx, OXL_ERR_IO, path, "cannot open", errno) : OXL_OK;
    if (!checkpoint_is_whole(a.file, &a.left)) {
        oxl_log(ctx, OXL_LOG_WARNING, "%s is damaged (wrong checksum); the previous checkpoint is tried",
                path);
        goto done;
    }
    rewind(a.file);
    archive_u64(&a, &magic);
    archive_u64(&a, &version);
    other = magic != CHECKPOINT_MAGIC || version != CHECKPOINT_VERSION || !checkpoint_has_key(&a, key);
    if (other) goto done;
    state(&a, user);
    *found = a.rc == OXL_OK;
done:
    fclose(a.file);
    return other ? checkpoint_rename(ctx, path) : a.rc;
}

OXL_INTERNAL oxl_result checkpoint_read(oxl_context *ctx, const char *folder, const char *key,
                                        checkpoint_state *state, void *user, int *found)
{
    oxl_result rc = OXL_OK;
    *found = 0;
    for (int i = 0; i < 2 && rc == OXL_OK && !*found; i++)
        rc = checkpoint_read_one(ctx, PATH(folder, "%s", checkpoint_names[i]), key, state, user, found);
    return rc;
}

OXL_INTERNAL int checkpoint_step(oxl_context *ctx, const char *folder, const char *key)
{
    int step = 0;
    for (int i = 0; i < 2 && step <= 0; i++) {
        const char *path = PATH(folder, "%s", checkpoint_names[i]);
        struct archive a = {.ctx = ctx, .reading = 1, .path = path, .file = os_open(path)};
        uint64_t magic = 0, version = 0;
        if (!a.file) continue;
        if (checkpoint_is_whole(a.file, &a.left)) {
            rewind(a.file);
            archive_u64(&a, &magic);
            archive_u64(&a, &version);
            if (magic == CHECKPOINT_MAGIC && version == CHECKPOINT_VERSION && checkpoint_has_key(&a, key))
                archive_int(&a, &step); /* the first number of train_archive */
        }
        fclose(a.file);
    }
    return OXL_MAX(step, 0);
}

OXL_INTERNAL void checkpoint_remove(const char *folder, int others)
{
    for (int i = 0; i < (others ? 4 : 2); i++) os_remove(PATH(folder, "%s", checkpoint_names[i]));
}

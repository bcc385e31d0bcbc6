/* checkpoint.c - keeps the training state in a file, from which a killed run resumes.
 *
 *     8  "OXLSTATE"        8  version of this layout        8 + n  key: the options and the scene that the
 *     run depends on
 *     ...  the state, as the modules' archive functions list it        8  FNV-1a of all bytes before it
 *
 * Everything is little endian.
 *
 * Invariant: once one checkpoint has been written, at least one of checkpoint.oxl and checkpoint.prev.oxl is
 * complete. The new one is written under a temporary name; the current one is renamed to checkpoint.prev.oxl;
 * the new one, flushed to disk, is renamed to checkpoint.oxl (os_writer_close in os.c). A crash between the
 * two renames leaves checkpoint.prev.oxl.
 */
#include "large.h"
#include "../train/train_tools.h"

#include <errno.h>

#define CHECKPOINT_MAGIC UINT64_C(0x45544154534C584F) /* Spells "OXLSTATE". */

enum { CHECKPOINT_CHUNK = 1 << 16 };

OXL_INTERNAL uint64_t checkpoint_sum(const void *bytes, size_t size)
{
    return archive_hash(ARCHIVE_SEED, bytes, size);
}

/* ---------------- writing */

static void checkpoint_number(struct archive *a, uint64_t *value)
{
    archive_numbers(a, value, 1, sizeof *value);
}

static void checkpoint_add_key(struct archive *a, const char *key)
{
    uint64_t length = strlen(key);
    checkpoint_number(a, &length);
    archive_numbers(a, (void *)(uintptr_t)key, (size_t)length, 1);
}

static const char *const checkpoint_names[] = {
    "checkpoint.oxl", "checkpoint.prev.oxl", "checkpoint.oxl.other",
    "checkpoint.prev.oxl.other"}; /* the latter two are written by checkpoint_rename */

/* Renames a checkpoint of another run to NAME.other, which replaces an earlier one:
 * the user may still want it. */
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

static oxl_result checkpoint_write_once(oxl_context *ctx, const char *folder, const char *key,
                                        archive_state *state, void *user)
{
    uint64_t magic = CHECKPOINT_MAGIC, version = CHECKPOINT_VERSION, sum;
    const char *path = PATH(folder, "%s", checkpoint_names[0]);
    struct os_writer writer;
    struct archive a = {.ctx = ctx, .path = path, .sum = ARCHIVE_SEED};
    oxl_result rc = oxl_make_folder(ctx, folder); /* Makes the folder again if it was deleted. */
    if (rc == OXL_OK) rc = os_writer_open(ctx, path, &writer);
    if (rc != OXL_OK) return rc;
    a.file = writer.file;
    checkpoint_number(&a, &magic);
    checkpoint_number(&a, &version);
    checkpoint_add_key(&a, key);
    state(&a, user);
    sum = a.sum;
    checkpoint_number(&a, &sum);
    if (a.rc == OXL_OK && fflush(writer.file) != 0)
        archive_fail(&a, OXL_ERR_IO, "cannot write; the disk may be full");
    if (a.rc == OXL_OK) /* Fails before the second checkpoint, without harm. */
        os_rename(path, PATH(folder, "%s", checkpoint_names[1]));
    return os_writer_close(ctx, &writer, a.rc);
}

OXL_INTERNAL oxl_result checkpoint_write(oxl_context *ctx, const char *folder, const char *key,
                                         archive_state *state, void *user)
{
    oxl_result rc = checkpoint_write_once(ctx, folder, key, state, user);
    /* Writes again if the folder was deleted meanwhile; it is made anew. */
    if (rc == OXL_ERR_IO && !os_is_folder(folder)) rc = checkpoint_write_once(ctx, folder, key, state, user);
    return rc;
}

OXL_INTERNAL struct train_store checkpoint_in(const char *folder, const char *key)
{
    return (struct train_store){checkpoint_write, checkpoint_read, folder, key};
}

/* ---------------- reading */

/* Reads the file once; returns 1 if it ends in the checksum of its bytes. */
static int checkpoint_is_whole(FILE *file, uint64_t *size)
{
    unsigned char chunk[CHECKPOINT_CHUNK + 8];
    uint64_t sum = ARCHIVE_SEED, stored = 0;
    size_t held = 0, got;
    *size = 0;
    /* Holds the last 8 bytes back: they may be the checksum. */
    while ((got = fread(chunk + held, 1, CHECKPOINT_CHUNK, file)) > 0) {
        const size_t body = held + got > 8 ? held + got - 8 : 0;
        sum = archive_hash(sum, chunk, body);
        *size += got;
        held = held + got - body;
        memmove(chunk, chunk + body, held);
    }
    for (size_t i = 0; i < 8; i++) stored |= (uint64_t)chunk[i] << 8 * i;
    return held == 8 && *size >= 40 && stored == sum && !ferror(file);
}

/* Returns 1 if the checkpoint has the key `key`. */
static int checkpoint_has_key(struct archive *a, const char *key)
{
    uint64_t length = 0;
    int same;
    checkpoint_number(a, &length);
    same = a->rc == OXL_OK && length == strlen(key);
    for (size_t i = 0; i < length && same; i++) {
        char c = 0;
        archive_numbers(a, &c, 1, 1);
        same = a->rc == OXL_OK && c == key[i];
    }
    return same;
}

static oxl_result checkpoint_read_one(oxl_context *ctx, const char *path, const char *key,
                                      archive_state *state, void *user, int *found)
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
    checkpoint_number(&a, &magic);
    checkpoint_number(&a, &version);
    other = magic != CHECKPOINT_MAGIC || version != CHECKPOINT_VERSION || !checkpoint_has_key(&a, key);
    if (other) goto done;
    state(&a, user);
    *found = a.rc == OXL_OK;
done:
    fclose(a.file);
    return other ? checkpoint_rename(ctx, path) : a.rc;
}

OXL_INTERNAL oxl_result checkpoint_read(oxl_context *ctx, const char *folder, const char *key,
                                        archive_state *state, void *user, int *found)
{
    oxl_result rc = OXL_OK;
    *found = 0;
    for (int i = 0; i < 2 && rc == OXL_OK && !*found; i++)
        rc = checkpoint_read_one(ctx, PATH(folder, "%s", checkpoint_names[i]), key, state, user, found);
    return rc;
}

/* Reads the step alone, without the state behind it. */
OXL_INTERNAL int checkpoint_step(oxl_context *ctx, const char *folder, const char *key)
{
    uint64_t step = 0;
    for (int i = 0; i < 2 && step == 0; i++) {
        const char *path = PATH(folder, "%s", checkpoint_names[i]);
        struct archive a = {.ctx = ctx, .reading = 1, .path = path, .file = os_open(path)};
        uint64_t magic = 0, version = 0;
        if (!a.file) continue;
        if (checkpoint_is_whole(a.file, &a.left)) {
            rewind(a.file);
            checkpoint_number(&a, &magic);
            checkpoint_number(&a, &version);
            if (magic == CHECKPOINT_MAGIC && version == CHECKPOINT_VERSION && checkpoint_has_key(&a, key))
                checkpoint_number(&a, &step); /* Reads the step, the first number of train_archive. */
        }
        fclose(a.file);
    }
    return step <= INT_MAX ? (int)step : 0;
}

OXL_INTERNAL void checkpoint_remove(const char *folder, int others)
{
    for (int i = 0; i < (others ? 4 : 2); i++) os_remove(PATH(folder, "%s", checkpoint_names[i]));
}

/* checkpoint.c - keeps the training state in a file, from which a killed run resumes.
 *
 *     8  "OXLSTATE"        8  version of this layout, bytes of size_t        8  checksum of the key: the options and the scene
 *     that the run depends on
 *     ...  the state, as the modules' archive functions list it        8  checksum of all bytes before it
 *
 * Values are as the machine has them in memory; to one of another byte order the file is damaged, to one of
 * another size of size_t it is another run's.
 *
 * Invariant: checkpoint.oxl is complete, since it is written under a temporary name, flushed to disk and
 * renamed (os_writer_close in os.c). One that a fault of the disk has changed, or of another key, counts as
 * none: the run starts again and ends in the same bytes.
 */
#include "large.h"
#include "../core/os.h"
#include "../train/train_tools.h"

#include <errno.h>

#define CHECKPOINT_MAGIC UINT64_C(0x45544154534C584F) /* Spells "OXLSTATE". */

enum { CHECKPOINT_CHUNK = 1 << 16, CHECKPOINT_HEAD = 3 };

static const char CHECKPOINT_NAME[] = "checkpoint.oxl";

OXL_INTERNAL oxl_result checksum_of_file(oxl_context *ctx, const char *path, size_t end, uint64_t *sum)
{
    struct os_reader file = {0};
    unsigned char *chunk = oxl_alloc(ctx, CHECKPOINT_CHUNK, 1);
    size_t got = 1;
    oxl_result rc = chunk ? os_reader_open(ctx, path, &file) : OXL_ERR_MEMORY;
    *sum = CHECKSUM_SEED;
    for (uint64_t left = file.size > end ? file.size - end : 0; rc == OXL_OK && left && got; left -= got) {
        rc = os_reader_read(ctx, &file, chunk, (size_t)OXL_MIN(left, (uint64_t)CHECKPOINT_CHUNK), &got);
        *sum = checksum_add(*sum, chunk, got);
    }
    os_reader_close(&file);
    oxl_free(ctx, chunk);
    return rc;
}

/* ---------------- writing */

static void checkpoint_head(uint64_t head[CHECKPOINT_HEAD], const char *key)
{
    head[0] = CHECKPOINT_MAGIC;
    head[1] = CHECKPOINT_VERSION << 8 | sizeof(size_t);
    head[2] = checksum_add(CHECKSUM_SEED, key, strlen(key));
}

OXL_INTERNAL oxl_result checkpoint_write(oxl_context *ctx, const char *folder, const char *key,
                                         archive_state *state, void *user)
{
    uint64_t head[CHECKPOINT_HEAD], sum = 0;
    struct os_writer writer = {0};
    struct archive a = {.ctx = ctx, .path = PATH(folder, "%s", CHECKPOINT_NAME)};
    oxl_result rc = oxl_make_folder(ctx, folder); /* Makes the folder again if it was deleted. */
    if (rc == OXL_OK) rc = os_writer_open(ctx, a.path, &writer);
    if (rc != OXL_OK) return rc;
    a.file = writer.file;
    checkpoint_head(head, key);
    archive_numbers(&a, head, CHECKPOINT_HEAD, sizeof *head);
    state(&a, user);
    if (a.rc == OXL_OK && fflush(writer.file) != 0)
        archive_fail(&a, OXL_ERR_IO, "cannot write; the disk may be full");
    if (a.rc == OXL_OK) a.rc = checksum_of_file(ctx, writer.temporary, 0, &sum);
    archive_numbers(&a, &sum, 1, sizeof sum);
    return os_writer_close(ctx, &writer, a.rc);
}

OXL_INTERNAL struct train_store checkpoint_in(const char *folder, const char *key)
{
    return (struct train_store){checkpoint_write, checkpoint_read, folder, key};
}

/* ---------------- reading */

OXL_INTERNAL oxl_result checkpoint_read(oxl_context *ctx, const char *folder, const char *key,
                                        archive_state *state, void *user, int *found)
{
    const char *path = PATH(folder, "%s", CHECKPOINT_NAME);
    struct archive a = {.ctx = ctx, .reading = 1, .path = path, .file = os_open(path)};
    uint64_t head[CHECKPOINT_HEAD] = {0}, wanted[CHECKPOINT_HEAD], sum, end = 0;
    *found = 0;
    if (!a.file) return os_is_file(path) ? os_fail(ctx, OXL_ERR_IO, path, "cannot open", errno) : OXL_OK;
    checkpoint_head(wanted, key);
    os_kind_of(path, &a.left);
    a.rc = checksum_of_file(ctx, path, sizeof sum, &sum);
    if (os_seek(a.file, a.left - sizeof end) == 0 && fread(&end, sizeof end, 1, a.file) == 1 && end == sum) {
        rewind(a.file);
        archive_numbers(&a, head, CHECKPOINT_HEAD, sizeof *head);
    } else oxl_log(ctx, OXL_LOG_WARNING, "%s is damaged (wrong checksum); the run starts again", path);
    if (a.rc == OXL_OK && memcmp(head, wanted, sizeof head) == 0) {
        state(&a, user);
        *found = a.rc == OXL_OK;
    }
    fclose(a.file);
    return a.rc;
}

OXL_INTERNAL void checkpoint_remove(const char *folder)
{
    os_remove(PATH(folder, "%s", CHECKPOINT_NAME));
}

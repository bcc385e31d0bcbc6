/* os.c - reads and writes files and folders, in C99 on top of the system's functions (os.h): atomic writes,
 * reading, errors with a fix.
 *
 * Invariant: after a failed or interrupted write, the file at the path is unchanged.
 */
#include "os.h"

/* ---------------- errors and folders */

OXL_INTERNAL oxl_result os_fail(oxl_context *ctx, oxl_result rc, const char *path, const char *what,
                                int error)
{
    const char *fix = error == ENOENT || error == ENOTDIR ? "correct the path"
                      : error == EACCES || error == EPERM || error == EROFS || error == 0
                          ? "choose a place that you may use, or change its permissions"
                      : error == EMFILE || error == ENFILE ? "allow more open files, as ulimit -n 1024 does"
                      : error == ENOSPC || error == EFBIG  ? "free space on the disk"
                      : error == EISDIR                    ? "name a file, not a folder"
                      : error == ENXIO                     ? "name a file, not a pipe, a socket or a device"
                      : error == ENAMETOOLONG              ? "use a shorter name"
                      : error == ELOOP || error == EMLINK || error == EEXIST
                          ? "remove it: a run replaces no other program's files and follows no links"
                          : "check the disk or the network drive";
    if (error == ENOENT && os_is_compressed(path))
        return oxl_fail(ctx, OXL_ERR_INPUT, "%s: it is compressed\nfix: gunzip %s.gz", path,
                        SHELL_WORD(path));
    return oxl_fail(ctx, rc, "%s: %s: %s\nfix: %s", path, what, error ? strerror(error) : "failed", fix);
}

OXL_INTERNAL int os_is_compressed(const char *path)
{
    char name[PATH_LENGTH];
    return snprintf(name, sizeof name, "%s.gz", path) < PATH_LENGTH && !os_is_file(path) && os_is_file(name);
}

OXL_INTERNAL oxl_result os_refuse_gzip(oxl_context *ctx, const char *path, const void *data, size_t size)
{
    static const char pointer[] = "version https://git-lfs";
    if (size > strlen(pointer) && !memcmp(data, pointer, strlen(pointer)))
        return oxl_fail(ctx, OXL_ERR_INPUT, "%s: it is a pointer of Git LFS, not the file\nfix: git lfs pull",
                        path);
    return size < 3 || memcmp(data, "\x1f\x8b\x08", 3) != 0
               ? OXL_OK
               : oxl_fail(ctx, OXL_ERR_INPUT, "%s: it is compressed by gzip\nfix: gunzip < %s > FILE", path,
                          SHELL_WORD(path));
}

OXL_INTERNAL int os_is_file(const char *path)
{
    return os_kind_of(path, NULL) == OS_FILE;
}

OXL_INTERNAL int os_is_folder(const char *path)
{
    return os_kind_of(path, NULL) == OS_FOLDER;
}

OXL_INTERNAL oxl_result os_list_folder(oxl_context *ctx, const char *path,
                                       void (*visit)(void *user, const char *name), void *user)
{
    return os_list(path, visit, user) == 0 ? OXL_OK
                                           : os_fail(ctx, OXL_ERR_IO, path, "cannot list the folder", errno);
}

/* ---------------- reading */

/* Fails after a read. A folder in the place of a file is OXL_ERR_INPUT: the user named it,
 * and the disk has no fault. */
static oxl_result os_fail_to_read(oxl_context *ctx, const char *path)
{
    return os_fail(ctx, errno == EISDIR ? OXL_ERR_INPUT : OXL_ERR_IO, path, "cannot read", errno);
}

OXL_INTERNAL void os_release_file(oxl_context *ctx, struct os_file_map *map)
{
    oxl_free(ctx, (void *)map->data);
    *map = (struct os_file_map){0};
}

OXL_INTERNAL oxl_result os_reader_open(oxl_context *ctx, const char *path, struct os_reader *out)
{
    *out = (struct os_reader){.file = os_open(path), .path = path};
    if (!out->file) return os_fail(ctx, OXL_ERR_INPUT, path, "cannot open", errno);
    if (os_kind_of(path, &out->size) != OS_FILE) out->size = 0;
    setvbuf(out->file, NULL, _IONBF, 0); /* Needs no buffer: pieces are large. */
    return OXL_OK;
}

OXL_INTERNAL oxl_result os_reader_read(oxl_context *ctx, struct os_reader *r, void *data, size_t size,
                                       size_t *got)
{
    errno = 0;
    *got = fread(data, 1, size, r->file);
    if (*got < size && ferror(r->file)) return os_fail_to_read(ctx, r->path);
    return OXL_OK;
}

OXL_INTERNAL oxl_result os_reader_seek(oxl_context *ctx, struct os_reader *r, uint64_t offset)
{
    if (os_seek(r->file, offset) == 0) return OXL_OK;
    return os_fail(ctx, OXL_ERR_IO, r->path, "cannot seek", errno);
}

OXL_INTERNAL void os_reader_close(struct os_reader *r)
{
    if (r->file) fclose(r->file);
    *r = (struct os_reader){0};
}

OXL_INTERNAL oxl_result os_read_file(oxl_context *ctx, const char *path, struct os_file_map *out)
{
    struct os_reader file;
    char *data = NULL;
    size_t capacity = 0, size = 0, got = 0;
    oxl_result rc = os_reader_open(ctx, path, &file);
    *out = (struct os_file_map){0};
    do { /* Adds the zero byte, and a byte to detect the end without growing. */
        const size_t expected = (size_t)OXL_MIN(file.size, SIZE_MAX / 2);
        if (rc == OXL_OK) rc = oxl_reserve(ctx, &data, &capacity, OXL_MAX(size, expected) + 2, 1);
        if (rc == OXL_OK) rc = os_reader_read(ctx, &file, data + size, capacity - 1 - size, &got);
        size += got;
    } while (rc == OXL_OK && size == capacity - 1);
    os_reader_close(&file);
    if (rc != OXL_OK) {
        oxl_free(ctx, data);
        return rc;
    }
    data[size] = 0;
    *out = (struct os_file_map){.data = data, .size = size};
    return OXL_OK;
}

/* ---------------- writing */

static void os_writer_free(oxl_context *ctx, struct os_writer *writer)
{
    OXL_FREE(ctx, writer->path, writer->temporary);
    *writer = (struct os_writer){0};
}

OXL_INTERNAL oxl_result os_writer_open(oxl_context *ctx, const char *path, struct os_writer *out)
{
    oxl_result rc = OXL_ERR_MEMORY;
    struct text name = {.ctx = ctx};
    *out = (struct os_writer){.path = oxl_strdup(ctx, path)};
    /* The name is unique among processes that share an output folder. */
    text_add(&name, "%s.%ld" OS_TEMPORARY, path, os_process());
    out->temporary = name.data;
    if (out->path && !name.failed) {
        out->file = os_create(out->temporary);
        rc = out->file ? OXL_OK : os_fail(ctx, OXL_ERR_IO, path, "cannot write", errno);
    }
    if (rc != OXL_OK) os_writer_free(ctx, out);
    return rc;
}

/* Syncs the folder of a path, which is cut to the folder in place. */
static void os_sync_parent(char *path)
{
    size_t end = strlen(path);
    while (end > 0 && !os_is_separator(path[end - 1])) end--;
    if (end > 0) path[end] = 0;
    os_sync_folder(end > 0 ? path : ".");
}

OXL_INTERNAL oxl_result os_writer_close(oxl_context *ctx, struct os_writer *writer, oxl_result rc)
{
    int failed = rc != OXL_OK, error = 0;
    if (!writer->file) return rc; /* Returns if the writer is not open. */
    errno = 0;
    if (!failed && (ferror(writer->file) || fflush(writer->file) != 0 ||
                    (!writer->unsynced && os_sync(writer->file) != 0)))
        failed = 1, error = errno;
    if (fclose(writer->file) != 0 && !failed) failed = 1, error = errno;
    if (!failed && os_rename(writer->temporary, writer->path) != 0) failed = 1, error = errno;
    if (failed) os_remove(writer->temporary);
    /* Assumes a full disk, the most likely cause, since errno of an earlier fwrite is lost. */
    if (failed && rc == OXL_OK)
        rc = os_fail(ctx, OXL_ERR_IO, writer->path, "cannot write", error ? error : ENOSPC);
    if (!failed && !writer->unsynced) os_sync_parent(writer->path);
    os_writer_free(ctx, writer);
    return rc;
}

OXL_INTERNAL oxl_result os_write_file(oxl_context *ctx, const char *path, const void *data, size_t size)
{
    struct os_writer writer;
    oxl_result rc = os_writer_open(ctx, path, &writer);
    if (rc != OXL_OK) return rc;
    if (size > 0 && fwrite(data, 1, size, writer.file) != size)
        rc = os_fail(ctx, OXL_ERR_IO, path, "cannot write", errno);
    return os_writer_close(ctx, &writer, rc);
}

OXL_INTERNAL oxl_result os_write_text(oxl_context *ctx, const char *path, const struct text *t)
{
    return t->failed ? OXL_ERR_MEMORY : os_write_file(ctx, path, t->data, t->size);
}

OXL_INTERNAL const char *path_longest_tail(const char *folder, const char *name)
{
    for (const char *tail = name; tail; tail = strchr(tail, '/') ? strchr(tail, '/') + 1 : NULL)
        if (os_is_file(PATH(folder, "%s", tail))) return tail;
    return name;
}

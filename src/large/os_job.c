/* os_job.c - handles files and folders of a job, in C99 on top of the system: refuses links, removes files of
 * killed processes, locks.
 */
#include "os_job.h"
#include "../../oceanxl_job.h"

OXL_INTERNAL oxl_result os_wait(oxl_context *ctx, double seconds)
{
    os_sleep(seconds);
    return context_stopped(ctx);
}

/* ---------------- folders and links */

int oxl_is_folder(const char *path)
{
    return os_is_folder(path);
}

/* Names what a walk does at each folder of a path; the values may be added. */
enum { OS_WALK_MAKES = 1, OS_WALK_REFUSES_LINKS = 2 };

/* Walks from `folder` into `inside`, folder by folder. */
static oxl_result os_walk_in(oxl_context *ctx, const char *folder, const char *inside, int does)
{
    char *path = oxl_path_join(ctx, folder, inside);
    const size_t size = path ? strlen(path) : 0;
    oxl_result rc = OXL_OK;
    if (!path) return OXL_ERR_MEMORY;
    for (size_t i = size - strlen(inside) + 1; i <= size && rc == OXL_OK; i++) {
        const char had = path[i];
        if (i < size && !os_is_separator(had)) continue;
        path[i] = 0;
        if (does & OS_WALK_REFUSES_LINKS && os_is_link(path))
            rc = oxl_fail(ctx, OXL_ERR_INPUT,
                          "%s is a link, so files would be written or removed elsewhere\nfix: remove the "
                          "link, or choose another folder",
                          path);
        /* Looks for the folder itself: mkdir of an existing one may fail with other errors than
         * EEXIST (read-only disk, "C:"). */
        else if (does & OS_WALK_MAKES && os_make_one_folder(path) != 0) {
            const int error = errno;
            if (!os_is_folder(path)) rc = os_fail(ctx, OXL_ERR_IO, path, "cannot make the folder", error);
        }
        path[i] = had;
    }
    oxl_free(ctx, path);
    return rc;
}

oxl_result oxl_make_folder(oxl_context *ctx, const char *path)
{
    return os_walk_in(ctx, "", path, OS_WALK_MAKES);
}

OXL_INTERNAL oxl_result os_make_folder_in(oxl_context *ctx, const char *folder, const char *inside)
{
    const oxl_result rc = oxl_make_folder(ctx, folder);
    return rc == OXL_OK && inside[0] ? os_walk_in(ctx, folder, inside, OS_WALK_MAKES | OS_WALK_REFUSES_LINKS)
                                     : rc;
}

OXL_INTERNAL oxl_result os_refuse_links(oxl_context *ctx, const char *folder, const char *inside)
{
    return inside[0] ? os_walk_in(ctx, folder, inside, OS_WALK_REFUSES_LINKS) : OXL_OK;
}

OXL_INTERNAL int os_link(const char *target, const char *path)
{
    char here[PATH_LENGTH] = "";
    if (!os_is_absolute(target) && os_working_folder(here, sizeof here) != 0) return 0;
    return os_make_link(PATH(here, "%s", target), path) == 0;
}

/* ---------------- locks */

OXL_INTERNAL enum os_locked os_lock_change(struct os_lock *lock, int shared)
{
    const enum os_locked got = os_lock_try(lock, shared);
    if (got == OS_LOCK_BUSY) {
        lock->holder[os_lock_read(lock, lock->holder, sizeof lock->holder - 1)] = 0;
        lock->holder[strcspn(lock->holder, "\r\n")] = 0;
    }
    return got;
}

OXL_INTERNAL enum os_locked os_lock_open(const char *path, int shared, struct os_lock *out)
{
    enum os_locked got;
    *out = (struct os_lock){0};
    if (os_lock_file(path, out) != 0) return OS_LOCK_FAILED;
    got = os_lock_change(out, shared);
    if (got == OS_LOCK_BUSY || got == OS_LOCK_REMOVED) os_lock_close(out, NULL);
    return got;
}

OXL_INTERNAL void os_lock_write_owner(const struct os_lock *lock)
{
    char host[64], text[128];
    os_host_name(host, sizeof host);
    snprintf(text, sizeof text, "process %ld on %s\n", os_process(), host);
    os_lock_write(lock, text);
}

/* ---------------- files */

OXL_INTERNAL uint64_t os_read_end(const char *path, void *data, size_t size, size_t *got)
{
    uint64_t bytes = 0;
    FILE *file = os_kind_of(path, &bytes) == OS_FILE ? os_open(path) : NULL;
    *got = 0;
    if (!file) return 0;
    setvbuf(file, NULL, _IONBF, 0);
    if (os_seek(file, bytes > size ? bytes - size : 0) == 0) *got = fread(data, 1, size, file);
    fclose(file);
    return bytes;
}

FILE *oxl_open(const char *path)
{
    return os_open(path);
}

FILE *oxl_create_beside(const char *path, char *temporary, size_t size)
{
    const int length = snprintf(temporary, size, "%s.%ld.tmp", path, os_process());
    if (length >= 0 && (size_t)length < size) return os_create(temporary);
    errno = ENAMETOOLONG;
    return NULL;
}

struct os_sweeping {
    oxl_context *ctx;
    const char *folder, *names;
};

/* Returns 1 if `name` (size) is one of the names, which are separated by blanks; "*.ply" is
 * any name that ends in .ply. */
static int os_is_named(const char *names, const char *name, size_t size)
{
    for (size_t length; *names; names += length, names += *names == ' ') {
        const int any = *names == '*';
        length = strcspn(names, " ");
        if (any ? size >= length && !memcmp(name + size - (length - 1), names + 1, length - 1)
                : size == length && !memcmp(name, names, size))
            return 1;
    }
    return 0;
}

/* Removes NAME.PID.tmp, the name that os_writer_open gives. */
static void os_remove_temporary(void *user, const char *name)
{
    const struct os_sweeping *s = user;
    size_t end = strlen(name), digits = 0;
    if (end < 4 || strcmp(name + end - 4, ".tmp")) return;
    end -= 4;
    while (end > 0 && name[end - 1] >= '0' && name[end - 1] <= '9') end--, digits++;
    if (digits > 0 && end > 1 && name[end - 1] == '.' && os_is_named(s->names, name, end - 1))
        os_remove(PATH(s->folder, "%s", name));
}

OXL_INTERNAL oxl_result os_remove_temporaries(oxl_context *ctx, const char *folder, const char *names)
{
    return os_is_folder(folder)
               ? os_list_folder(ctx, folder, os_remove_temporary, &(struct os_sweeping){ctx, folder, names})
               : OXL_OK;
}

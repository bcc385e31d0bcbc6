/* os_job.c - handles files and folders of a job, in C99 on top of the system: removes files of killed
 * processes, locks.
 */
#include "os_job.h"
#include "../../oceanxl_job.h"

/* ---------------- folders */

int oxl_is_folder(const char *path)
{
    return os_is_folder(path);
}

oxl_result oxl_make_folder(oxl_context *ctx, const char *path)
{
    char *part = oxl_strdup(ctx, path);
    const size_t size = strlen(path);
    oxl_result rc = part ? OXL_OK : OXL_ERR_MEMORY;
    for (size_t i = 1; i <= size && rc == OXL_OK; i++) {
        if (i < size && !os_is_separator(path[i])) continue;
        part[i] = 0;
        /* Looks for the folder itself: mkdir of an existing one may fail with other errors than
         * EEXIST (read-only disk, "C:"). */
        if (os_make_one_folder(part) != 0) {
            const int error = errno;
            if (!os_is_folder(part)) rc = os_fail(ctx, OXL_ERR_IO, part, "cannot make the folder", error);
        }
        part[i] = path[i];
    }
    oxl_free(ctx, part);
    return rc;
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

FILE *oxl_open(const char *path)
{
    return os_open(path);
}

FILE *oxl_create_beside(const char *path, char *temporary, size_t size)
{
    const int length = snprintf(temporary, size, "%s.%ld" OS_TEMPORARY, path, os_process());
    if (length >= 0 && (size_t)length < size) return os_create(temporary);
    errno = ENAMETOOLONG;
    return NULL;
}

int oxl_rename(const char *from, const char *to)
{
    return os_rename(from, to);
}

int oxl_remove(const char *path)
{
    return os_remove(path);
}

static void os_remove_temporary(void *folder, const char *name)
{
    const size_t size = strlen(name), end = sizeof OS_TEMPORARY - 1;
    if (size > end && !strcmp(name + size - end, OS_TEMPORARY)) os_remove(PATH(folder, "%s", name));
}

OXL_INTERNAL oxl_result os_remove_temporaries(oxl_context *ctx, const char *folder)
{
    return os_is_folder(folder) ? os_list_folder(ctx, folder, os_remove_temporary, (void *)folder) : OXL_OK;
}

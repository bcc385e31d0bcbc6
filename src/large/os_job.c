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
    const int length = snprintf(temporary, size, "%s.%ld.tmp", path, os_process());
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

/* lock.c - a folder that one process writes to at a time.
 *
 * FOLDER/.lock is locked by the operating system, which releases it when the process ends, however it ends: so a lock without a
 * holder is free, and the text in the file, "process N on HOST", only names the process that holds it or was killed with it.
 * Processes that train different blocks of one run share OUT's lock and hold one of their own in each blocks/KKK.
 *
 * Invariant: the lock is held on the file that FOLDER/.lock names, not on one that its last holder has removed.
 */
#include "core.h"

enum { LOCK_TRIES = 1000 /* each stands for a process that ended meanwhile */ };

struct oxl_lock {
    struct os_lock file;
    char          *path;
};

static oxl_result lock_refuse(oxl_context *ctx, const char *folder, const struct os_lock *file)
{
    return oxl_fail(ctx, OXL_ERR_FAILED, "%s is in use by %s\nfix: wait until it ends, or stop it", folder,
                    file->holder[0] ? file->holder : "another process");
}

/* Closes a file that was removed after it was opened, and opens the new one. */
static enum os_locked lock_open(const char *path, int shared, struct os_lock *file)
{
    enum os_locked got = OS_LOCK_REMOVED;
    for (int tries = 0; tries < LOCK_TRIES && got == OS_LOCK_REMOVED; tries++) got = os_lock_open(path, shared, file);
    return got;
}

static oxl_result lock_take(oxl_context *ctx, const char *folder, int shared, int *busy, oxl_lock **out)
{
    oxl_lock      *lock = oxl_calloc(ctx, 1, sizeof *lock);
    enum os_locked got;
    oxl_result     rc;
    *out  = NULL;
    *busy = 0;
    if (lock) lock->path = oxl_path_join(ctx, folder, ".lock");
    rc = lock && lock->path ? os_make_folder(ctx, folder) : oxl_fail(ctx, OXL_ERR_MEMORY, "no memory to lock %s", folder);
    if (rc != OXL_OK) goto done;
    got   = lock_open(lock->path, shared, &lock->file);
    *busy = got == OS_LOCK_BUSY;
    if (*busy) rc = lock_refuse(ctx, folder, &lock->file);
    if (got == OS_LOCK_FAILED || got == OS_LOCK_REMOVED) rc = os_lock_fail(ctx, lock->path);
    if (got == OS_LOCK_NONE)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: this file system has no locks; two processes that write there destroy each other's files", folder);
    if (got == OS_LOCK_TAKEN && !shared && lock->file.holder[0])
        oxl_log(ctx, OXL_LOG_INFO, "%s: %s was ended while it wrote there; its lock is taken over", folder, lock->file.holder);
    if (rc == OXL_OK) os_lock_sign(&lock->file);
done:
    if (rc == OXL_OK) *out = lock;
    else if (lock) {
        oxl_free(ctx, lock->path);
        oxl_free(ctx, lock);
    }
    return rc;
}

OXL_INTERNAL oxl_result lock_folder(oxl_context *ctx, const char *folder, int shared, oxl_lock **out)
{
    int busy;
    return lock_take(ctx, folder, shared, &busy, out);
}

OXL_INTERNAL oxl_result lock_folder_if_free(oxl_context *ctx, const char *folder, oxl_lock **out)
{
    int              busy;
    const oxl_result rc = lock_take(ctx, folder, 0, &busy, out);
    return busy ? OXL_OK : rc;
}

OXL_INTERNAL oxl_result lock_change(oxl_context *ctx, oxl_lock *lock, const char *folder, int shared)
{
    return os_lock_change(&lock->file, shared) == OS_LOCK_BUSY ? lock_refuse(ctx, folder, &lock->file) : OXL_OK;
}

oxl_result oxl_lock_folder(oxl_context *ctx, const char *folder, oxl_lock **out)
{
    return lock_folder(ctx, folder, 0, out);
}

/* The last one who leaves removes the file. */
void oxl_unlock_folder(oxl_context *ctx, oxl_lock **lock)
{
    if (!*lock) return;
    os_lock_close(&(*lock)->file, os_lock_change(&(*lock)->file, 0) != OS_LOCK_BUSY ? (*lock)->path : NULL);
    oxl_free(ctx, (*lock)->path);
    oxl_free(ctx, *lock);
    *lock = NULL;
}

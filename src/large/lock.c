/* lock.c - locks a folder, so that one process at a time writes to it.
 *
 * FOLDER/.lock is locked by the operating system, which releases it when the process ends, however it ends:
 * so a lock without a holder is free, and the text in the file, "process N on HOST", only names the process
 * that took it last. Processes that train different blocks of one run share OUT's lock and
 * hold one of their own in each blocks/KKK.
 *
 * Invariant: the lock is held on the file that FOLDER/.lock names, not on one that its last holder has
 * removed.
 */
#include "large.h"
#include "os_job.h"
#include <errno.h>

enum { LOCK_TRIES = 1000 /* tries; in each a process removed the file meanwhile */ };
#define LOCK_WAIT 0.5 /* s between tries of lock_wait */

struct oxl_lock {
    struct os_lock file;
    char *path;
};

static oxl_result lock_refuse(oxl_context *ctx, const char *folder, const struct os_lock *file)
{
    return oxl_fail(ctx, OXL_ERR_FAILED, "%s is in use by %s\nfix: wait until it ends, or stop it", folder,
                    file->holder[0] ? file->holder : "another process");
}

static oxl_result lock_open(oxl_context *ctx, const char *folder, int shared, oxl_lock *lock)
{
    enum os_locked got = OS_LOCK_REMOVED;
    oxl_result rc = oxl_make_folder(ctx, folder);
    if (rc != OXL_OK) return rc;
    /* Opens the file again as long as its last holder has removed it meanwhile. */
    for (int tries = 0; tries < LOCK_TRIES && got == OS_LOCK_REMOVED; tries++)
        got = os_lock_open(lock->path, shared, &lock->file);
    if (got == OS_LOCK_BUSY) rc = lock_refuse(ctx, folder, &lock->file);
    if (got == OS_LOCK_FAILED || got == OS_LOCK_REMOVED)
        rc = os_fail(ctx, OXL_ERR_IO, lock->path, "cannot write", errno);
    if (got == OS_LOCK_NONE)
        oxl_log(ctx, OXL_LOG_WARNING,
                "%s: this file system has no locks; two processes that write there would destroy each "
                "other's files",
                folder);
    if (rc == OXL_OK) os_lock_write_owner(&lock->file);
    return rc;
}

OXL_INTERNAL oxl_result lock_folder(oxl_context *ctx, const char *folder, int shared, oxl_lock **out)
{
    oxl_lock *lock = oxl_calloc(ctx, 1, sizeof *lock);
    oxl_result rc = OXL_ERR_MEMORY;
    if (lock) lock->path = oxl_strdup(ctx, PATH(folder, ".lock"));
    if (lock && lock->path) rc = lock_open(ctx, folder, shared, lock);
    *out = rc == OXL_OK ? lock : NULL;
    if (rc != OXL_OK && lock) OXL_FREE(ctx, lock->path, lock);
    return rc;
}

oxl_result oxl_lock_folder(oxl_context *ctx, const char *folder, oxl_lock **out)
{
    return lock_folder(ctx, folder, 0, out);
}

OXL_INTERNAL oxl_result lock_wait(oxl_context *ctx, const char *folder, const char *file, oxl_lock **out)
{
    oxl_result rc = OXL_ERR_FAILED; /* Only lock_refuse fails so. */
    for (*out = NULL; rc == OXL_ERR_FAILED;) {
        if (file && os_is_file(file)) return OXL_OK;
        rc = lock_folder(ctx, folder, 0, out);
        if (rc != OXL_ERR_FAILED) break;
        if (context_stopped(ctx) != OXL_OK) return OXL_ERR_INTERRUPTED;
        os_sleep(LOCK_WAIT);
    }
    return rc;
}

OXL_INTERNAL oxl_result lock_change(oxl_context *ctx, oxl_lock *lock, const char *folder, int shared)
{
    return os_lock_change(&lock->file, shared) == OS_LOCK_BUSY ? lock_refuse(ctx, folder, &lock->file)
                                                               : OXL_OK;
}

/* Releases the lock; the last holder removes the file. */
void oxl_unlock_folder(oxl_context *ctx, oxl_lock **lock)
{
    if (!*lock) return;
    os_lock_close(&(*lock)->file, os_lock_change(&(*lock)->file, 0) != OS_LOCK_BUSY ? (*lock)->path : NULL);
    OXL_FREE(ctx, (*lock)->path, *lock);
    *lock = NULL;
}

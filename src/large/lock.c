/* lock.c - locks a folder, so that one process at a time writes to it.
 *
 * FOLDER/.lock is locked by the operating system, which releases it when the process ends, however it ends:
 * so a lock without a holder is free, and the text in the file, "process N on HOST", only names the process
 * that holds it or was killed with it. Processes that train different blocks of one run share OUT's lock and
 * hold one of their own in each blocks/KKK.
 *
 * Invariant: the lock is held on the file that FOLDER/.lock names, not on one that its last holder has
 * removed.
 */
#include "large.h"
#include "os_job.h"
#include <errno.h>

enum { LOCK_TRIES = 1000 /* tries; in each a process removed the file meanwhile */ };

struct oxl_lock {
    struct os_lock file;
    char *path;
};

static oxl_result lock_refuse(oxl_context *ctx, const char *folder, const char *where,
                              const struct os_lock *file)
{
    return oxl_fail(ctx, OXL_ERR_FAILED, "%s %s by %s\nfix: wait until it ends, or stop it", folder, where,
                    file->holder[0] ? file->holder : "another process");
}

/* Opens the lock's file, again as long as its last holder has removed the file meanwhile. */
static enum os_locked lock_open(const char *path, int shared, struct os_lock *file)
{
    enum os_locked got = OS_LOCK_REMOVED;
    for (int tries = 0; tries < LOCK_TRIES && got == OS_LOCK_REMOVED; tries++)
        got = os_lock_open(path, shared, 1, file);
    return got;
}

/* Takes the lock; *busy: another process holds it, and the error names that process. */
static oxl_result lock_take(oxl_context *ctx, const char *folder, int shared, int *busy, oxl_lock **out)
{
    oxl_lock *lock = oxl_calloc(ctx, 1, sizeof *lock);
    enum os_locked got;
    oxl_result rc;
    *out = NULL;
    *busy = 0;
    if (lock) lock->path = oxl_path_join(ctx, folder, ".lock");
    rc = lock && lock->path ? oxl_make_folder(ctx, folder) : OXL_ERR_MEMORY;
    if (rc != OXL_OK) goto done;
    got = lock_open(lock->path, shared, &lock->file);
    *busy = got == OS_LOCK_BUSY;
    if (*busy) rc = lock_refuse(ctx, folder, "is in use", &lock->file);
    if (got == OS_LOCK_FAILED || got == OS_LOCK_REMOVED)
        rc = os_fail(ctx, OXL_ERR_IO, lock->path, "cannot write", errno);
    if (got == OS_LOCK_NONE)
        oxl_log(
            ctx, OXL_LOG_WARNING,
            "%s: this file system has no locks; two processes that write there destroy each other's files",
            folder);
    if (got == OS_LOCK_TAKEN && !shared && lock->file.holder[0])
        oxl_log(ctx, OXL_LOG_INFO, "%s: %s was ended while it wrote there; its lock is taken over", folder,
                lock->file.holder);
    if (rc == OXL_OK) os_lock_write_owner(&lock->file);
done:
    if (rc == OXL_OK) *out = lock;
    else if (lock) {
        OXL_FREE(ctx, lock->path, lock);
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
    int busy;
    const oxl_result rc = lock_take(ctx, folder, 0, &busy, out);
    return busy ? OXL_OK : rc;
}

OXL_INTERNAL oxl_result lock_change(oxl_context *ctx, oxl_lock *lock, const char *folder, int shared)
{
    return os_lock_change(&lock->file, shared) == OS_LOCK_BUSY
               ? lock_refuse(ctx, folder, "is in use", &lock->file)
               : OXL_OK;
}

/* Returns the parent folder, from the path's text if the folder does not exist. */
static char *lock_parent(oxl_context *ctx, const char *folder)
{
    char *up = oxl_path_join(ctx, folder, ".."), *slash;
    if (!up || os_is_folder(folder)) return up;
    up[strlen(folder)] = 0;
    slash = strrchr(up, '/');
    if (slash) slash[slash == up] = 0;
    else strcpy(up, ".");
    return up;
}

/* Refuses a folder within OUT of a run that another process has, such as OUT/renders and OUT/blocks/KKK.
 * Opens no .lock of a folder without run.json, such as a folder of runs that this process has locked itself:
 * closing it would end that lock. */
OXL_INTERNAL oxl_result lock_check_parents(oxl_context *ctx, const char *folder)
{
    char *up = lock_parent(ctx, folder);
    oxl_result rc = OXL_OK;
    for (int level = 0; rc == OXL_OK && level < 2; level++) {
        char *run = up ? oxl_path_join(ctx, up, "run.json") : NULL,
             *path = up ? oxl_path_join(ctx, up, ".lock") : NULL;
        struct os_lock file;
        if (!run || !path) rc = OXL_ERR_MEMORY;
        else if (os_is_file(run) && os_is_file(path)) {
            const enum os_locked got = os_lock_open(path, 0, 0, &file);
            if (got == OS_LOCK_BUSY)
                rc = lock_refuse(ctx, folder, "lies in the folder of a run, which is in use", &file);
            if (got == OS_LOCK_TAKEN || got == OS_LOCK_NONE) os_lock_close(&file, NULL);
        }
        OXL_FREE(ctx, run, path);
        run = up && rc == OXL_OK ? lock_parent(ctx, up) : NULL;
        oxl_free(ctx, up);
        up = run;
    }
    oxl_free(ctx, up);
    return rc;
}

oxl_result oxl_lock_folder(oxl_context *ctx, const char *folder, oxl_lock **out)
{
    const oxl_result rc = lock_check_parents(ctx, folder);
    *out = NULL;
    return rc == OXL_OK ? lock_folder(ctx, folder, 0, out) : rc;
}

/* Releases the lock; the last holder removes the file. */
void oxl_unlock_folder(oxl_context *ctx, oxl_lock **lock)
{
    if (!*lock) return;
    os_lock_close(&(*lock)->file, os_lock_change(&(*lock)->file, 0) != OS_LOCK_BUSY ? (*lock)->path : NULL);
    OXL_FREE(ctx, (*lock)->path, *lock);
    *lock = NULL;
}

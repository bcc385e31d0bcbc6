/* os_job.h - declares files, locks and memory of a job: what one scene in memory
 * does not need of the system. */
#ifndef OXL_OS_JOB_H
#define OXL_OS_JOB_H

#include "../core/os.h"

/* Removes the temporary files that a killed process left in a folder. No other process may be writing
 * there. */
OXL_INTERNAL oxl_result os_remove_temporaries(oxl_context *ctx, const char *folder);

/* Returns 1 if both paths exist and lead to one file or folder. */
OXL_INTERNAL int os_is_same(const char *a, const char *b);
OXL_INTERNAL double os_disk_free(const char *folder); /* bytes; 0: unknown */
OXL_INTERNAL int os_remove_folder(const char *path);  /* an empty folder; 0: success */
OXL_INTERNAL size_t os_memory_free(void);             /* bytes available without swapping; 0: unknown */
OXL_INTERNAL size_t os_peak_rss(void);                /* bytes; 0 when unknown */

/* ---------------- locks; see lock.c */

/* Names the result of locking a file, exclusively or shared between processes (lock.c). */
enum os_locked {
    OS_LOCK_TAKEN,
    OS_LOCK_BUSY,    /* `holder` holds it; the file is closed, or the lock is unchanged */
    OS_LOCK_REMOVED, /* its last holder has removed the file, which is closed */
    OS_LOCK_NONE,    /* the file system has no locks; the file stays open */
    OS_LOCK_FAILED   /* the file cannot be opened: errno */
};
struct os_lock {
    intptr_t file;
    char holder[128]; /* BUSY: the file's text, "process 17 on reef" */
};
OXL_INTERNAL enum os_locked os_lock_open(const char *path, int shared, struct os_lock *out);
OXL_INTERNAL enum os_locked os_lock_change(struct os_lock *lock, int shared);
OXL_INTERNAL void os_lock_write_owner(const struct os_lock *lock); /* names this process in the file */
/* Releases the lock. remove: path of the file to remove first, or NULL. */
OXL_INTERNAL void os_lock_close(struct os_lock *lock, const char *remove);

/* ---------------- os_job_posix.c or os_job_windows.c: what a port provides; os_job.c alone uses these */

OXL_INTERNAL int os_make_one_folder(const char *path);  /* 0: success */
OXL_INTERNAL void os_host_name(char *out, size_t size); /* name of this machine */
OXL_INTERNAL void os_sleep(double seconds);             /* returns early after a signal */
/* Opens or creates the file. Refuses a link, a pipe and a file of several names, since
 * writing to them would change what lies elsewhere. */
OXL_INTERNAL int os_lock_file(const char *path, struct os_lock *lock);
OXL_INTERNAL enum os_locked os_lock_try(struct os_lock *lock, int shared);
OXL_INTERNAL size_t os_lock_read(const struct os_lock *lock, char *text, size_t size); /* bytes read */
OXL_INTERNAL void os_lock_write(const struct os_lock *lock, const char *text); /* replaces the file's text */

#endif

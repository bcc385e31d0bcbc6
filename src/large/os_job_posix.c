/* os_job_posix.c - implements os_job.h through POSIX. Each function sets errno on failure.
 */
#include "os_job.h" /* asks for POSIX before any system header */
#include "../../oceanxl_job.h"

#ifndef _WIN32
#include <fcntl.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

OXL_INTERNAL int os_is_same(const char *a, const char *b)
{
    struct stat x, y;
    return stat(a, &x) == 0 && stat(b, &y) == 0 && x.st_dev == y.st_dev && x.st_ino == y.st_ino;
}

OXL_INTERNAL int os_make_one_folder(const char *path)
{
    return mkdir(path, 0777);
}

int oxl_is_terminal(int stream)
{
    return isatty(stream) != 0;
}

OXL_INTERNAL double os_disk_free(const char *folder)
{
    struct statvfs s;
    return statvfs(folder, &s) == 0 ? (double)s.f_bavail * (double)s.f_frsize : 0;
}

OXL_INTERNAL int os_remove_folder(const char *path)
{
    return rmdir(path);
}

OXL_INTERNAL void os_sleep(double seconds)
{
    const struct timespec t = {(time_t)seconds, (long)((seconds - (double)(time_t)seconds) * 1e9)};
    nanosleep(&t, NULL);
}

/* Returns the limit less the memory used, without counting file caches that can be dropped. */
static double os_memory_of(double limit, double used, double cache)
{
    return limit > 0 && used >= 0 ? OXL_MAX(limit - used + OXL_MAX(cache, 0), 1) : 0;
}

static double os_memory_in(const char *folder)
{
    return os_memory_of(os_number_in(folder, "memory.max", ""), os_number_in(folder, "memory.current", ""),
                        os_number_in(folder, "memory.stat", "inactive_file "));
}

OXL_INTERNAL size_t os_memory_free(void)
{
    static const char root[] = "/sys/fs/cgroup/memory";                           /* cgroups version 1 */
    const double free = 1024 * os_number_in("/proc", "meminfo", "MemAvailable:"); /* known on Linux only */
    const double limit =
        os_least_limit(os_memory_in, os_memory_of(os_number_in(root, "memory.limit_in_bytes", ""),
                                                  os_number_in(root, "memory.usage_in_bytes", ""),
                                                  os_number_in(root, "memory.stat", "inactive_file ")));
    return free > 0 ? (size_t)(limit > 0 ? OXL_MIN(free, limit) : free) : 0;
}

OXL_INTERNAL size_t os_peak_rss(void)
{
    struct rusage usage;
    if (getrusage(RUSAGE_SELF, &usage) != 0) return 0;
#ifdef __APPLE__
    return (size_t)usage.ru_maxrss;
#else
    return (size_t)usage.ru_maxrss * 1024;
#endif
}

/* ---- locks: fcntl's, of the whole file; the kernel releases them when the process ends */

OXL_INTERNAL enum os_locked os_lock_try(struct os_lock *lock, int shared)
{
    struct flock l = {.l_type = shared ? F_RDLCK : F_WRLCK, .l_whence = SEEK_SET};
    struct stat s;
    if (fcntl((int)lock->file, F_SETLK, &l) == 0)
        return fstat((int)lock->file, &s) == 0 && s.st_nlink == 0 ? OS_LOCK_REMOVED : OS_LOCK_TAKEN;
    return errno == EACCES || errno == EAGAIN ? OS_LOCK_BUSY : OS_LOCK_NONE;
}

/* Opens or creates the file. A new one is writable for all, so that users with different umask take
 * over each other's locks. */
OXL_INTERNAL int os_lock_file(const char *path, struct os_lock *lock)
{
    enum { flags = O_RDWR | O_NOFOLLOW | O_NONBLOCK | O_CLOEXEC };
    struct stat s;
    int file = open(path, flags | O_CREAT | O_EXCL, 0666);
    if (file >= 0 && fchmod(file, 0666) != 0) errno = 0; /* Ignores file systems without modes. */
    if (file < 0) file = open(path, flags | O_CREAT, 0666);
    if (file >= 0 && (fstat(file, &s) != 0 || !S_ISREG(s.st_mode) || s.st_nlink > 1)) {
        close(file);
        errno = EMLINK;
        file = -1;
    }
    lock->file = file;
    return file >= 0 ? 0 : -1;
}

OXL_INTERNAL size_t os_lock_read(const struct os_lock *lock, char *text, size_t size)
{
    const ssize_t got = pread((int)lock->file, text, size, 0);
    return got > 0 ? (size_t)got : 0;
}

OXL_INTERNAL void os_lock_write(const struct os_lock *lock, const char *text)
{
    /* Ignores a full disk: the lock holds without its text. */
    if (ftruncate((int)lock->file, 0) != 0 || pwrite((int)lock->file, text, strlen(text), 0) < 0) errno = 0;
}

OXL_INTERNAL void os_lock_close(struct os_lock *lock, const char *remove)
{
    if (remove) unlink(remove); /* Removes the file while it is locked. */
    close((int)lock->file);
}

OXL_INTERNAL void os_host_name(char *out, size_t size)
{
    if (gethostname(out, size) != 0) snprintf(out, size, "this machine");
    out[size - 1] = 0;
}

#endif

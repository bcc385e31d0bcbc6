/* os.c - operating system: atomic file writes, folders, clock, memory use. The one file to port.
 *
 * The first half exists for POSIX and for Windows: small primitives that set errno. The second half is C99 on top of them.
 *
 * Invariant: after a failed or interrupted write, the file at the path is unchanged.
 */
#include "core.h" /* asks for POSIX before any system header */

#include <errno.h>

enum { OS_START = 64 }; /* bytes that identify a format */

enum os_kind { OS_NOTHING, OS_FILE, OS_FOLDER };

#ifndef _WIN32 /* ---------------------------------------------------------------- POSIX */

#ifdef OXL_VULKAN
#include <dlfcn.h>
#endif
#include <dirent.h>
#include <fcntl.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <time.h>
#include <unistd.h>

static int os_is_separator(char c)
{
    return c == '/';
}

static enum os_kind os_kind_of(const char *path, uint64_t *size)
{
    struct stat s;
    if (stat(path, &s) != 0) return OS_NOTHING;
    if (size) *size = (uint64_t)s.st_size;
    return S_ISREG(s.st_mode) ? OS_FILE : S_ISDIR(s.st_mode) ? OS_FOLDER : OS_NOTHING;
}

/* Nanoseconds. */
OXL_INTERNAL int64_t os_modified(const char *path)
{
    struct stat s;
    if (stat(path, &s) != 0) return 0;
#ifdef __APPLE__
    return (int64_t)s.st_mtimespec.tv_sec * 1000000000 + s.st_mtimespec.tv_nsec;
#else
    return (int64_t)s.st_mtim.tv_sec * 1000000000 + s.st_mtim.tv_nsec;
#endif
}

OXL_INTERNAL FILE *os_open(const char *path, const char *mode)
{
    return fopen(path, mode);
}

static const char *os_map(const char *path, size_t *size)
{
    struct stat s;
    const int   file = open(path, O_RDONLY);
    void       *data = MAP_FAILED;
    if (file >= 0 && fstat(file, &s) == 0 && s.st_size > 0)
        data = mmap(NULL, *size = (size_t)s.st_size, PROT_READ, MAP_PRIVATE, file, 0);
    if (file >= 0) close(file);
    return data == MAP_FAILED ? NULL : data;
}

static int os_unmap(const char *data, size_t size)
{
    return munmap((void *)(uintptr_t)data, size) == 0;
}

OXL_INTERNAL int os_remove(const char *path)
{
    return unlink(path);
}

/* Some network file systems cannot sync and return EINVAL, which is ignored. */
static int os_sync(FILE *file)
{
    return fsync(fileno(file)) == 0 || errno == EINVAL ? 0 : -1;
}

OXL_INTERNAL int os_rename(const char *from, const char *to)
{
    return rename(from, to);
}

static int os_seek(FILE *file, uint64_t offset)
{
    return fseeko(file, (off_t)offset, SEEK_SET);
}

static int os_make_link(const char *target, const char *path)
{
    struct stat s;
    if (lstat(path, &s) == 0 && S_ISLNK(s.st_mode)) unlink(path);
    return symlink(target, path);
}

static int os_is_absolute(const char *path)
{
    return path[0] == '/';
}

static int os_working_folder(char *out, size_t size)
{
    return getcwd(out, size) ? 0 : -1;
}

/* Makes the rename durable. Errors are ignored: not all file systems support it, and the data are on disk already. */
static void os_sync_folder(const char *path)
{
    const int fd = open(path, O_RDONLY);
    if (fd < 0) return;
    fsync(fd);
    close(fd);
}

static int os_make_one_folder(const char *path)
{
    return mkdir(path, 0777);
}

static long os_process(void)
{
    return (long)getpid();
}

int oxl_is_terminal(int stream)
{
    return isatty(stream) != 0;
}

OXL_INTERNAL double os_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
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

/* The number after `name` in a file of a folder, or its first one with name ""; -1: none, or "max". */
static double os_number_in(const char *folder, const char *file, const char *name)
{
    char   path[3200], line[300];
    double value = -1;
    FILE  *opened;
    snprintf(path, sizeof path, "%s/%s", folder, file);
    opened = fopen(path, "r");
    while (opened && value < 0 && fgets(line, sizeof line, opened))
        if (strncmp(line, name, strlen(name)) != 0 || sscanf(line + strlen(name), "%lf", &value) != 1) value = -1;
    if (opened) fclose(opened);
    return value;
}

/* The least of `limit` over the control group of the process and those above it, of version 2; 0: none has a limit. In a container, and
 * of version 1, the root's files are the container's. */
static double os_least_limit(double (*limit)(const char *folder), double of_version_1)
{
    FILE  *file  = fopen("/proc/self/cgroup", "r");
    double least = of_version_1;
    char   line[3000], path[3100];
    while (file && fgets(line, sizeof line, file)) {
        if (strncmp(line, "0::/", 4) != 0) continue;
        line[strcspn(line, "\n")] = 0;
        for (char *end = line + strlen(line); end >= line + 3; end--) {
            double one;
            if (*end != '/' && *end != 0) continue;
            *end = 0;
            snprintf(path, sizeof path, "/sys/fs/cgroup%s", line + 3);
            one = limit(path);
            if (one > 0 && (least <= 0 || one < least)) least = one;
        }
    }
    if (file) fclose(file);
    return OXL_MAX(least, 0);
}

static double os_processors_of(double quota, double period)
{
    return quota > 0 && period > 0 ? ceil(quota / period) : 0;
}

/* "QUOTA PERIOD" in microseconds, QUOTA "max" when there is none. */
static double os_processors_in(const char *folder)
{
    char   path[3200];
    double quota = 0, period = 0;
    FILE  *file;
    snprintf(path, sizeof path, "%s/cpu.max", folder);
    file = fopen(path, "r");
    if (file && fscanf(file, "%lf %lf", &quota, &period) != 2) quota = 0;
    if (file) fclose(file);
    return os_processors_of(quota, period);
}

OXL_INTERNAL int os_processor_quota(void)
{
    static const char root[] = "/sys/fs/cgroup/cpu";
    const double      quota = os_number_in(root, "cpu.cfs_quota_us", ""), period = os_number_in(root, "cpu.cfs_period_us", "");
    return (int)OXL_MIN(os_least_limit(os_processors_in, os_processors_of(quota, period)), INT_MAX);
}

/* The limit, less what is used and is not a cache of files that can be dropped. */
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
    static const char root[] = "/sys/fs/cgroup/memory";                                  /* of version 1 */
    const double      free   = 1024 * os_number_in("/proc", "meminfo", "MemAvailable:"); /* Linux; elsewhere unknown */
    const double      limit  = os_least_limit(os_memory_in, os_memory_of(os_number_in(root, "memory.limit_in_bytes", ""),
                                                                         os_number_in(root, "memory.usage_in_bytes", ""),
                                                                         os_number_in(root, "memory.stat", "inactive_file ")));
    return free > 0 ? (size_t)(limit > 0 ? OXL_MIN(free, limit) : free) : 0;
}

OXL_INTERNAL oxl_result os_list_folder(oxl_context *ctx, const char *path, void (*visit)(void *user, const char *name),
                                       void *user)
{
    DIR           *folder = opendir(path);
    struct dirent *entry;
    if (!folder) return os_fail(ctx, OXL_ERR_IO, path, "cannot list the folder", errno);
    while ((entry = readdir(folder)) != NULL)
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0) visit(user, entry->d_name);
    closedir(folder);
    return OXL_OK;
}

/* ---- locks: fcntl's, of the whole file; the kernel releases them when the process ends */

static enum os_locked os_lock_try(struct os_lock *lock, int shared)
{
    struct flock l = {.l_type = shared ? F_RDLCK : F_WRLCK, .l_whence = SEEK_SET};
    struct stat  s;
    lock->process = 0;
    if (fcntl((int)lock->file, F_SETLK, &l) == 0)
        return fstat((int)lock->file, &s) == 0 && s.st_nlink == 0 ? OS_LOCK_REMOVED : OS_LOCK_TAKEN;
    if (errno != EACCES && errno != EAGAIN) return OS_LOCK_NONE;
    if (fcntl((int)lock->file, F_GETLK, &l) == 0 && l.l_type != F_UNLCK) lock->process = (long)l.l_pid;
    return OS_LOCK_BUSY;
}

/* Users with different umask take over each other's: the mode is for all. */
static int os_lock_file(const char *path, struct os_lock *lock)
{
    const int file = open(path, O_RDWR | O_CREAT | O_CLOEXEC, 0666);
    lock->file     = file;
    if (file >= 0 && fchmod(file, 0666) != 0) errno = 0; /* it is another user's */
    return file >= 0 ? 0 : -1;
}

static size_t os_lock_read(const struct os_lock *lock, char *text, size_t size)
{
    const ssize_t got = pread((int)lock->file, text, size, 0);
    return got > 0 ? (size_t)got : 0;
}

static void os_lock_write(const struct os_lock *lock, const char *text)
{
    if (ftruncate((int)lock->file, 0) != 0 || pwrite((int)lock->file, text, strlen(text), 0) < 0) errno = 0; /* a full disk */
}

OXL_INTERNAL void os_lock_close(struct os_lock *lock, const char *remove)
{
    if (remove) unlink(remove); /* while it is locked */
    close((int)lock->file);
}

static void os_host(char *out, size_t size)
{
    if (gethostname(out, size) != 0) snprintf(out, size, "this machine");
    out[size - 1] = 0;
}

#ifdef OXL_VULKAN
OXL_INTERNAL void *os_library_open(const char *name)
{
    return dlopen(name, RTLD_NOW | RTLD_LOCAL);
}

/* ISO C has no cast from an object pointer to a function pointer; POSIX guarantees equal bits. */
OXL_INTERNAL void os_library_symbol(void *library, const char *name, void *out, size_t size)
{
    void *symbol = dlsym(library, name);
    memset(out, 0, size);
    memcpy(out, &symbol, OXL_MIN(size, sizeof symbol));
}

OXL_INTERNAL void os_library_close(void *library)
{
    dlclose(library);
}
#endif

#else /* ---------------------------------------------------------------- Windows; our paths are UTF-8, its own are UTF-16 */

#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#include <io.h>
#include <psapi.h> /* link with -lpsapi */
#undef near        /* macros of 16-bit Windows */
#undef far

enum { OS_PATH_MAX = 4096 };

static const wchar_t *os_wide(const char *path, wchar_t *wide)
{
    if (MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, OS_PATH_MAX) == 0) wide[0] = 0;
    return wide;
}

static int os_done(BOOL ok)
{
    const DWORD error = ok ? 0 : GetLastError();
    if (ok) return 0;
    errno = error == ERROR_ALREADY_EXISTS                                      ? EEXIST
            : error == ERROR_FILE_NOT_FOUND || error == ERROR_PATH_NOT_FOUND   ? ENOENT
            : error == ERROR_DISK_FULL                                         ? ENOSPC
            : error == ERROR_ACCESS_DENIED || error == ERROR_SHARING_VIOLATION ? EACCES
                                                                               : EIO;
    return -1;
}

static int os_is_separator(char c)
{
    return c == '/' || c == '\\';
}

static enum os_kind os_kind_of(const char *path, uint64_t *size)
{
    wchar_t                   wide[OS_PATH_MAX];
    WIN32_FILE_ATTRIBUTE_DATA data;
    if (os_done(GetFileAttributesExW(os_wide(path, wide), GetFileExInfoStandard, &data)) != 0) return OS_NOTHING;
    if (size) *size = (uint64_t)data.nFileSizeHigh << 32 | data.nFileSizeLow;
    return data.dwFileAttributes & FILE_ATTRIBUTE_DIRECTORY ? OS_FOLDER : OS_FILE;
}

/* Tenths of microseconds. */
OXL_INTERNAL int64_t os_modified(const char *path)
{
    wchar_t                   wide[OS_PATH_MAX];
    WIN32_FILE_ATTRIBUTE_DATA data;
    if (!GetFileAttributesExW(os_wide(path, wide), GetFileExInfoStandard, &data)) return 0;
    return (int64_t)((uint64_t)data.ftLastWriteTime.dwHighDateTime << 32 | data.ftLastWriteTime.dwLowDateTime);
}

OXL_INTERNAL FILE *os_open(const char *path, const char *mode)
{
    wchar_t wide[OS_PATH_MAX], wide_mode[8];
    for (int i = 0; i < 8; i++) {
        wide_mode[i] = (wchar_t)mode[i];
        if (!mode[i]) break;
    }
    return _wfopen(os_wide(path, wide), wide_mode);
}

OXL_INTERNAL int os_remove(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    return os_done(DeleteFileW(os_wide(path, wide)));
}

static int os_sync(FILE *file)
{
    return _commit(_fileno(file));
}

static int os_seek(FILE *file, uint64_t offset)
{
    return _fseeki64(file, (int64_t)offset, SEEK_SET);
}

OXL_INTERNAL int os_rename(const char *from, const char *to)
{
    wchar_t a[OS_PATH_MAX], b[OS_PATH_MAX];
    return os_done(MoveFileExW(os_wide(from, a), os_wide(to, b), MOVEFILE_REPLACE_EXISTING | MOVEFILE_WRITE_THROUGH));
}

static int os_make_link(const char *target, const char *path)
{
    (void)target, (void)path; /* needs rights that programs rarely have */
    return -1;
}

static int os_is_absolute(const char *path)
{
    return os_is_separator(path[0]) || (path[0] && path[1] == ':');
}

static int os_working_folder(char *out, size_t size)
{
    wchar_t wide[OS_PATH_MAX];
    if (GetCurrentDirectoryW(OS_PATH_MAX, wide) == 0) return -1;
    return WideCharToMultiByte(CP_UTF8, 0, wide, -1, out, (int)size, NULL, NULL) ? 0 : -1;
}

static void os_sync_folder(const char *path)
{
    (void)path; /* MOVEFILE_WRITE_THROUGH did it */
}

static int os_make_one_folder(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    return os_done(CreateDirectoryW(os_wide(path, wide), NULL));
}

static long os_process(void)
{
    return (long)GetCurrentProcessId();
}

int oxl_is_terminal(int stream)
{
    return _isatty(stream) != 0;
}

OXL_INTERNAL double os_seconds(void)
{
    LARGE_INTEGER count, per_second;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&per_second);
    return (double)count.QuadPart / (double)per_second.QuadPart;
}

OXL_INTERNAL double os_disk_free(const char *folder)
{
    wchar_t        wide[OS_PATH_MAX];
    const wchar_t *name = os_wide(folder, wide);
    ULARGE_INTEGER bytes;
    return name && GetDiskFreeSpaceExW(name, &bytes, NULL, NULL) ? (double)bytes.QuadPart : 0;
}

OXL_INTERNAL int os_remove_folder(const char *path)
{
    wchar_t        wide[OS_PATH_MAX];
    const wchar_t *name = os_wide(path, wide);
    return name && RemoveDirectoryW(name) ? 0 : -1;
}

OXL_INTERNAL void os_sleep(double seconds)
{
    Sleep((DWORD)(1000 * seconds));
}

OXL_INTERNAL size_t os_peak_rss(void)
{
    PROCESS_MEMORY_COUNTERS counters;
    return GetProcessMemoryInfo(GetCurrentProcess(), &counters, sizeof counters) ? counters.PeakWorkingSetSize : 0;
}

OXL_INTERNAL int os_processor_quota(void)
{
    return 0;
}

static const char *os_map(const char *path, size_t *size)
{
    (void)path, (void)size;
    return NULL; /* it is read */
}

static int os_unmap(const char *data, size_t size)
{
    (void)data, (void)size;
    return 0;
}

OXL_INTERNAL size_t os_memory_free(void)
{
    MEMORYSTATUSEX status = {.dwLength = sizeof status};
    return GlobalMemoryStatusEx(&status) ? (size_t)status.ullAvailPhys : 0;
}

OXL_INTERNAL oxl_result os_list_folder(oxl_context *ctx, const char *path, void (*visit)(void *user, const char *name),
                                       void *user)
{
    wchar_t          wide[OS_PATH_MAX];
    char             name[OS_PATH_MAX];
    WIN32_FIND_DATAW data;
    HANDLE           find;
    snprintf(name, sizeof name, "%s/*", path);
    find = FindFirstFileW(os_wide(name, wide), &data);
    if (find == INVALID_HANDLE_VALUE) return os_fail(ctx, OXL_ERR_IO, path, "cannot list the folder", ENOENT);
    do {
        if (WideCharToMultiByte(CP_UTF8, 0, data.cFileName, -1, name, sizeof name, NULL, NULL) == 0) continue;
        if (strcmp(name, ".") != 0 && strcmp(name, "..") != 0) visit(user, name);
    } while (FindNextFileW(find, &data));
    FindClose(find);
    return OXL_OK;
}

/* ---- locks: of a byte that no file reaches, so that the text stays readable; Windows releases them when the process ends */

static enum os_locked os_lock_try(struct os_lock *lock, int shared)
{
    OVERLAPPED  place = {.Offset = 0x7fffffff};
    const DWORD how   = LOCKFILE_FAIL_IMMEDIATELY | (shared ? 0 : LOCKFILE_EXCLUSIVE_LOCK);
    lock->process     = 0;
    UnlockFileEx((HANDLE)lock->file, 0, 1, 0, &place); /* what this handle holds: it cannot be changed */
    if (LockFileEx((HANDLE)lock->file, how, 0, 1, 0, &place)) return OS_LOCK_TAKEN;
    return GetLastError() == ERROR_LOCK_VIOLATION || GetLastError() == ERROR_IO_PENDING ? OS_LOCK_BUSY : OS_LOCK_NONE;
}

static int os_lock_file(const char *path, struct os_lock *lock)
{
    wchar_t wide[OS_PATH_MAX];
    lock->file = (intptr_t)CreateFileW(os_wide(path, wide), GENERIC_READ | GENERIC_WRITE, FILE_SHARE_READ | FILE_SHARE_WRITE,
                                       NULL, OPEN_ALWAYS, FILE_ATTRIBUTE_NORMAL, NULL); /* nobody removes it while it is open */
    return os_done((HANDLE)lock->file != INVALID_HANDLE_VALUE);
}

static size_t os_lock_read(const struct os_lock *lock, char *text, size_t size)
{
    DWORD got = 0;
    SetFilePointer((HANDLE)lock->file, 0, NULL, FILE_BEGIN);
    return ReadFile((HANDLE)lock->file, text, (DWORD)size, &got, NULL) ? got : 0;
}

static void os_lock_write(const struct os_lock *lock, const char *text)
{
    DWORD put = 0;
    SetFilePointer((HANDLE)lock->file, 0, NULL, FILE_BEGIN);
    SetEndOfFile((HANDLE)lock->file);
    WriteFile((HANDLE)lock->file, text, (DWORD)strlen(text), &put, NULL);
}

OXL_INTERNAL void os_lock_close(struct os_lock *lock, const char *remove)
{
    CloseHandle((HANDLE)lock->file);
    if (remove) os_remove(remove); /* fails where another process has opened it */
}

static void os_host(char *out, size_t size)
{
    DWORD length = (DWORD)size;
    if (!GetComputerNameA(out, &length)) snprintf(out, size, "this machine");
}

#ifdef OXL_VULKAN
OXL_INTERNAL void *os_library_open(const char *name)
{
    return LoadLibraryA(name);
}

OXL_INTERNAL void os_library_symbol(void *library, const char *name, void *out, size_t size)
{
    const FARPROC symbol = GetProcAddress(library, name);
    memset(out, 0, size);
    memcpy(out, &symbol, OXL_MIN(size, sizeof symbol));
}

OXL_INTERNAL void os_library_close(void *library)
{
    FreeLibrary(library);
}
#endif

#endif /* ---------------------------------------------------------------- plain C from here on */

OXL_INTERNAL oxl_result os_fail(oxl_context *ctx, oxl_result rc, const char *path, const char *what, int error)
{
    const char *fix = error == ENOENT || error == ENOTDIR ? "correct the path"
                      : error == EACCES || error == EPERM || error == EROFS || error == 0
                          ? "choose a place that you may use, or change its permissions"
                      : error == EMFILE || error == ENFILE ? "allow more open files, as ulimit -n 1024 does"
                      : error == ENOSPC || error == EFBIG  ? "free space on the disk"
                      : error == EISDIR                    ? "name a file, not a folder"
                      : error == ENAMETOOLONG              ? "use a shorter name"
                                                           : "look at the disk or the network drive";
    return oxl_fail(ctx, rc, "%s: %s: %s\nfix: %s", path, what, error ? strerror(error) : "failed", fix);
}

OXL_INTERNAL int os_is_file(const char *path)
{
    return os_kind_of(path, NULL) == OS_FILE;
}

OXL_INTERNAL int os_is_folder(const char *path)
{
    return os_kind_of(path, NULL) == OS_FOLDER;
}

OXL_INTERNAL oxl_result os_make_folder(oxl_context *ctx, const char *path)
{
    oxl_result   rc   = OXL_OK;
    char        *part = oxl_strdup(ctx, path);
    const size_t size = strlen(path);
    if (!part) return oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory to make the folder", path);
    for (size_t i = 1; i <= size && rc == OXL_OK; i++) {
        if (i < size && !os_is_separator(part[i])) continue;
        part[i] = 0;
        /* mkdir of an existing parent can fail with other errors than EEXIST (read-only disk, "C:") */
        if (os_make_one_folder(part) != 0) {
            const int error = errno;
            if (!os_is_folder(part)) rc = os_fail(ctx, OXL_ERR_IO, part, "cannot make the folder", error);
        }
        part[i] = path[i];
    }
    oxl_free(ctx, part);
    return rc;
}

OXL_INTERNAL int os_link(const char *target, const char *path)
{
    char here[PATH_MOST] = "";
    if (!os_is_absolute(target) && os_working_folder(here, sizeof here) != 0) return 0;
    return os_make_link(PATH(here, "%s", target), path) == 0;
}

/* ---------------------------------------------------------------- locks */

/* "process N on HOST" of the text in the file; of another process than that, N alone. */
static void os_lock_holder(struct os_lock *lock)
{
    const size_t size                           = os_lock_read(lock, lock->holder, sizeof lock->holder - 1);
    long         named                          = 0;
    lock->holder[size]                          = 0;
    lock->holder[strcspn(lock->holder, "\r\n")] = 0;
    if (sscanf(lock->holder, "process %ld", &named) != 1) lock->holder[0] = 0;
    if (lock->process > 0 && named != lock->process) snprintf(lock->holder, sizeof lock->holder, "process %ld", lock->process);
}

OXL_INTERNAL enum os_locked os_lock_open(const char *path, int shared, struct os_lock *out)
{
    enum os_locked got;
    *out = (struct os_lock){0};
    if (os_lock_file(path, out) != 0) return OS_LOCK_FAILED;
    got = os_lock_try(out, shared);
    os_lock_holder(out);
    if (got == OS_LOCK_BUSY || got == OS_LOCK_REMOVED) os_lock_close(out, NULL);
    return got;
}

OXL_INTERNAL enum os_locked os_lock_change(struct os_lock *lock, int shared)
{
    const enum os_locked got = os_lock_try(lock, shared);
    if (got == OS_LOCK_BUSY) os_lock_holder(lock);
    return got;
}

OXL_INTERNAL void os_lock_sign(const struct os_lock *lock)
{
    char host[64], text[128];
    os_host(host, sizeof host);
    snprintf(text, sizeof text, "process %ld on %s\n", os_process(), host);
    os_lock_write(lock, text);
}

OXL_INTERNAL oxl_result os_lock_fail(oxl_context *ctx, const char *path)
{
    return os_fail(ctx, OXL_ERR_IO, path, "cannot write", errno);
}

/* ---------------------------------------------------------------- reading */

OXL_INTERNAL oxl_result os_read_file(oxl_context *ctx, const char *path, struct os_file_map *out)
{
    return os_read_file_like(ctx, path, "", out);
}

OXL_INTERNAL oxl_result os_read_file_like(oxl_context *ctx, const char *path, const char *start, struct os_file_map *out)
{
    oxl_result rc       = OXL_OK;
    char      *data     = NULL;
    size_t     capacity = 0, size = 0, got = 0;
    uint64_t   expected = 0; /* a hint: the file may grow, and a pipe has no size */
    FILE      *file     = os_open(path, "rb");
    *out                = (struct os_file_map){0};
    if (!file) return os_fail(ctx, OXL_ERR_INPUT, path, "cannot open", errno);
    if (os_kind_of(path, &expected) != OS_FILE) expected = 0;
    if (expected > SIZE_MAX / 2) {
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "%s: too large for this machine's addresses", path);
        goto done;
    }
    capacity = (start[0] ? OS_START : (size_t)expected) + 2; /* the zero byte, and one byte to detect the end without growing */
    data     = oxl_alloc(ctx, capacity, 1);
    if (!data) {
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory for %zu bytes", path, capacity);
        goto done;
    }
    setvbuf(file, NULL, _IONBF, 0);
    errno = 0;
    while ((got = fread(data + size, 1, OXL_MIN(capacity - 1 - size, size < OS_START ? OS_START - size : SIZE_MAX), file)) > 0) {
        size += got;
        if (size >= strlen(start) && memcmp(data, start, strlen(start)) != 0) break;
        rc = oxl_reserve(ctx, (void **)&data, &capacity, OXL_MAX(size, (size_t)expected) + 2, 1);
        if (rc != OXL_OK) goto done;
    }
    if (ferror(file)) {
        rc = os_fail(ctx, OXL_ERR_IO, path, "cannot read", errno);
        goto done;
    }
    data[size] = 0;
    *out       = (struct os_file_map){.data = data, .size = size};
done:
    fclose(file);
    if (rc != OXL_OK) oxl_free(ctx, data);
    return rc;
}

OXL_INTERNAL void os_release_file(oxl_context *ctx, struct os_file_map *map)
{
    oxl_free(ctx, (void *)map->data);
    *map = (struct os_file_map){0};
}

OXL_INTERNAL oxl_result os_map_file(oxl_context *ctx, const char *path, struct os_file_map *out)
{
    *out = (struct os_file_map){0};
    return (out->data = os_map(path, &out->size)) != NULL ? OXL_OK : os_read_file(ctx, path, out);
}

OXL_INTERNAL void os_unmap_file(oxl_context *ctx, struct os_file_map *map)
{
    if (map->data && !os_unmap(map->data, map->size)) oxl_free(ctx, (void *)map->data);
    *map = (struct os_file_map){0};
}

OXL_INTERNAL oxl_result os_reader_open(oxl_context *ctx, const char *path, struct os_reader *out)
{
    *out = (struct os_reader){.file = os_open(path, "rb"), .path = path};
    if (!out->file) return os_fail(ctx, OXL_ERR_INPUT, path, "cannot open", errno);
    if (os_kind_of(path, &out->size) != OS_FILE) out->size = 0;
    setvbuf(out->file, NULL, _IONBF, 0); /* pieces are large: no buffer needed */
    return OXL_OK;
}

OXL_INTERNAL oxl_result os_reader_read(oxl_context *ctx, struct os_reader *r, void *data, size_t size, size_t *got)
{
    errno = 0;
    *got  = fread(data, 1, size, r->file);
    if (*got < size && ferror(r->file)) return os_fail(ctx, OXL_ERR_IO, r->path, "cannot read", errno);
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

/* ---------------------------------------------------------------- writing */

static void os_writer_free(oxl_context *ctx, struct os_writer *writer)
{
    oxl_free(ctx, writer->path);
    oxl_free(ctx, writer->temporary);
    *writer = (struct os_writer){0};
}

OXL_INTERNAL oxl_result os_writer_open(oxl_context *ctx, const char *path, struct os_writer *out)
{
    oxl_result  rc   = OXL_OK;
    struct text name = {.ctx = ctx};
    *out             = (struct os_writer){.path = oxl_strdup(ctx, path)};
    text_add(&name, "%s.%ld.tmp", path, os_process()); /* unique among processes that share an output folder */
    out->temporary = name.data;
    if (!out->path || name.failed) {
        rc = oxl_fail(ctx, OXL_ERR_MEMORY, "%s: no memory to write it", path);
        goto done;
    }
    out->file = os_open(out->temporary, "wb");
    if (!out->file) rc = os_fail(ctx, OXL_ERR_IO, path, "cannot write", errno);
done:
    if (rc != OXL_OK) os_writer_free(ctx, out);
    return rc;
}

/* Folder of a path, in place. */
static void os_sync_parent(char *path)
{
    size_t end = strlen(path);
    while (end > 0 && !os_is_separator(path[end - 1])) end--;
    if (end > 0) path[end] = 0;
    os_sync_folder(end > 0 ? path : ".");
}

OXL_INTERNAL void os_writer_sync(struct os_writer *writer)
{
    errno = 0;
    if (fflush(writer->file) != 0 || os_sync(writer->file) != 0) writer->error = errno ? errno : EIO;
}

OXL_INTERNAL oxl_result os_writer_close(oxl_context *ctx, struct os_writer *writer, oxl_result rc)
{
    int failed = rc != OXL_OK, error = 0;
    if (!writer->file) return rc; /* not open */
    if (!failed) {
        errno  = writer->error;
        failed = writer->error || ferror(writer->file) || fflush(writer->file) != 0 ||
                 (!writer->unsynced && os_sync(writer->file) != 0);
        error = errno;
    }
    if (fclose(writer->file) != 0 && !failed) {
        failed = 1;
        error  = errno;
    }
    if (!failed && os_rename(writer->temporary, writer->path) != 0) {
        failed = 1;
        error  = errno;
    }
    if (failed) os_remove(writer->temporary);
    if (failed && rc == OXL_OK) /* errno of an earlier fwrite is lost; a full disk is the most likely cause */
        rc = os_fail(ctx, OXL_ERR_IO, writer->path, "cannot write", error ? error : ENOSPC);
    if (!failed && !writer->unsynced) os_sync_parent(writer->path);
    os_writer_free(ctx, writer);
    return rc;
}

struct os_sweeping {
    oxl_context *ctx;
    const char  *folder;
};

static void os_sweep_file(void *user, const char *name)
{
    const struct os_sweeping *s      = user;
    const size_t              length = strlen(name);
    if (length > 4 && !strcmp(name + length - 4, ".tmp")) os_remove(PATH(s->folder, "%s", name));
}

OXL_INTERNAL oxl_result os_sweep(oxl_context *ctx, const char *folder)
{
    return os_is_folder(folder) ? os_list_folder(ctx, folder, os_sweep_file, &(struct os_sweeping){ctx, folder}) : OXL_OK;
}

OXL_INTERNAL oxl_result os_write_file(oxl_context *ctx, const char *path, const void *data, size_t size)
{
    struct os_writer writer;
    oxl_result       rc = os_writer_open(ctx, path, &writer);
    if (rc != OXL_OK) return rc;
    if (size > 0 && fwrite(data, 1, size, writer.file) != size) rc = os_fail(ctx, OXL_ERR_IO, path, "cannot write", errno);
    return os_writer_close(ctx, &writer, rc);
}

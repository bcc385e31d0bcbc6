/* os_posix.c - implements os.h through POSIX. Each function sets errno on failure. */
#include "os.h" /* asks for POSIX before any system header */

#ifndef _WIN32

#ifdef OXL_VULKAN
#include <dlfcn.h>
#endif
#include <dirent.h>
#include <fcntl.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

OXL_INTERNAL int os_is_separator(char c)
{
    return c == '/';
}

OXL_INTERNAL enum os_kind os_kind_of(const char *path, uint64_t *size)
{
    struct stat s;
    if (stat(path, &s) != 0) return OS_NOTHING;
    if (size) *size = (uint64_t)s.st_size;
    return S_ISREG(s.st_mode) ? OS_FILE : S_ISDIR(s.st_mode) ? OS_FOLDER : OS_SPECIAL;
}

/* Returns the time in nanoseconds. */
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

/* Opens a regular file to read; -1: errno has the reason. Refuses a pipe, which would wait for a writer, and
 * a device, which has no end. */
static int os_open_regular(const char *path)
{
    const int file = open(path, O_RDONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
    struct stat s = {.st_mode = 0};
    if (file < 0) return -1;
    if (fstat(file, &s) == 0 && S_ISREG(s.st_mode)) return file;
    close(file);
    errno = S_ISDIR(s.st_mode) ? EISDIR : ENXIO;
    return -1;
}

OXL_INTERNAL FILE *os_open(const char *path)
{
    const int file = os_open_regular(path);
    return file >= 0 ? fdopen(file, "rb") : NULL;
}

OXL_INTERNAL FILE *os_create(const char *path)
{
    enum { flags = O_WRONLY | O_CREAT | O_EXCL | O_NOFOLLOW | O_CLOEXEC };
    int file = open(path, flags, 0666);
    FILE *out;
    if (file < 0 && errno == EEXIST && unlink(path) == 0) file = open(path, flags, 0666);
    if (file < 0) return NULL;
    out = fdopen(file, "wb");
    if (!out) close(file);
    return out;
}

OXL_INTERNAL int os_remove(const char *path)
{
    return unlink(path);
}

/* Syncs a file. Ignores EINVAL, which some network file systems return since they cannot sync. */
OXL_INTERNAL int os_sync(FILE *file)
{
    return fsync(fileno(file)) == 0 || errno == EINVAL ? 0 : -1;
}

OXL_INTERNAL int os_rename(const char *from, const char *to)
{
    return rename(from, to);
}

OXL_INTERNAL int os_seek(FILE *file, uint64_t offset)
{
    return fseeko(file, (off_t)offset, SEEK_SET);
}

/* Makes a rename durable. Ignores errors: not all file systems support it, and the
 * data are on disk already. */
OXL_INTERNAL void os_sync_folder(const char *path)
{
    const int fd = open(path, O_RDONLY);
    if (fd < 0) return;
    fsync(fd);
    close(fd);
}

OXL_INTERNAL long os_process(void)
{
    return (long)getpid();
}

OXL_INTERNAL double os_seconds(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

OXL_INTERNAL double os_number_in(const char *folder, const char *file, const char *name)
{
    char path[3200], line[300];
    double value = -1;
    FILE *opened;
    snprintf(path, sizeof path, "%s/%s", folder, file);
    opened = fopen(path, "r");
    while (opened && value < 0 && fgets(line, sizeof line, opened))
        if (strncmp(line, name, strlen(name)) != 0 || sscanf(line + strlen(name), "%lf", &value) != 1)
            value = -1;
    if (opened) fclose(opened);
    return value;
}

OXL_INTERNAL double os_least_limit(double (*limit)(const char *folder), double of_version_1)
{
    FILE *file = fopen("/proc/self/cgroup", "r");
    double least = of_version_1;
    char line[3000], path[3100];
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

/* Reads "QUOTA PERIOD" in microseconds; QUOTA is "max" if there is none. */
static double os_processors_in(const char *folder)
{
    char path[3200];
    double quota = 0, period = 0;
    FILE *file;
    snprintf(path, sizeof path, "%s/cpu.max", folder);
    file = fopen(path, "r");
    if (file && fscanf(file, "%lf %lf", &quota, &period) != 2) quota = 0;
    if (file) fclose(file);
    return os_processors_of(quota, period);
}

OXL_INTERNAL int os_processor_quota(void)
{
    static const char root[] = "/sys/fs/cgroup/cpu";
    const double quota = os_number_in(root, "cpu.cfs_quota_us", ""),
                 period = os_number_in(root, "cpu.cfs_period_us", "");
    return (int)OXL_MIN(os_least_limit(os_processors_in, os_processors_of(quota, period)), INT_MAX);
}

OXL_INTERNAL int os_list(const char *path, void (*visit)(void *user, const char *name), void *user)
{
    DIR *folder = opendir(path);
    struct dirent *entry;
    if (!folder) return -1;
    while ((entry = readdir(folder)) != NULL)
        if (strcmp(entry->d_name, ".") != 0 && strcmp(entry->d_name, "..") != 0) visit(user, entry->d_name);
    closedir(folder);
    return 0;
}

#ifdef OXL_VULKAN
OXL_INTERNAL void *os_library_open(const char *name)
{
    return dlopen(name, RTLD_NOW | RTLD_LOCAL);
}

/* Copies the bits, since ISO C has no cast from an object pointer to a function pointer;
 * POSIX guarantees equal bits. */
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

#endif

/* os_windows.c - the operating system through the Windows API: the functions of os.h. Each sets errno on
 * failure.
 *
 * Paths are UTF-8 here and UTF-16 in the API.
 */
#include "os.h"

#ifdef _WIN32

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

OXL_INTERNAL int os_is_separator(char c)
{
    return c == '/' || c == '\\';
}

OXL_INTERNAL enum os_kind os_kind_of(const char *path, uint64_t *size)
{
    wchar_t wide[OS_PATH_MAX];
    WIN32_FILE_ATTRIBUTE_DATA data;
    if (os_done(GetFileAttributesExW(os_wide(path, wide), GetFileExInfoStandard, &data)) != 0)
        return OS_NOTHING;
    if (size) *size = (uint64_t)data.nFileSizeHigh << 32 | data.nFileSizeLow;
    return data.dwFileAttributes & FILE_ATTRIBUTE_DIRECTORY ? OS_FOLDER : OS_FILE;
}

/* Tenths of microseconds. */
OXL_INTERNAL int64_t os_modified(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    WIN32_FILE_ATTRIBUTE_DATA data;
    if (!GetFileAttributesExW(os_wide(path, wide), GetFileExInfoStandard, &data)) return 0;
    return (int64_t)((uint64_t)data.ftLastWriteTime.dwHighDateTime << 32 |
                     data.ftLastWriteTime.dwLowDateTime);
}

static int os_identity(const char *path, BY_HANDLE_FILE_INFORMATION *out)
{
    wchar_t wide[OS_PATH_MAX];
    const HANDLE file =
        CreateFileW(os_wide(path, wide), 0, FILE_SHARE_READ | FILE_SHARE_WRITE | FILE_SHARE_DELETE, NULL,
                    OPEN_EXISTING, FILE_FLAG_BACKUP_SEMANTICS, NULL);
    const int known = file != INVALID_HANDLE_VALUE && GetFileInformationByHandle(file, out);
    if (file != INVALID_HANDLE_VALUE) CloseHandle(file);
    return known;
}

OXL_INTERNAL int os_is_same(const char *a, const char *b)
{
    BY_HANDLE_FILE_INFORMATION x, y;
    return os_identity(a, &x) && os_identity(b, &y) && x.dwVolumeSerialNumber == y.dwVolumeSerialNumber &&
           x.nFileIndexHigh == y.nFileIndexHigh && x.nFileIndexLow == y.nFileIndexLow;
}

OXL_INTERNAL FILE *os_open(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    return _wfopen(os_wide(path, wide), L"rb");
}

OXL_INTERNAL FILE *os_create(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    DeleteFileW(os_wide(path, wide));
    wchar_t wide[OS_PATH_MAX];
    return _wfopen(os_wide(path, wide), L"wb");
}

OXL_INTERNAL int os_is_link(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    const DWORD attributes = GetFileAttributesW(os_wide(path, wide));
    return attributes != INVALID_FILE_ATTRIBUTES && attributes & FILE_ATTRIBUTE_REPARSE_POINT;
}

OXL_INTERNAL int os_remove(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    return os_done(DeleteFileW(os_wide(path, wide)));
}

OXL_INTERNAL int os_sync(FILE *file)
{
    return _commit(_fileno(file));
}

OXL_INTERNAL int os_seek(FILE *file, uint64_t offset)
{
    return _fseeki64(file, (int64_t)offset, SEEK_SET);
}

OXL_INTERNAL int os_rename(const char *from, const char *to)
{
    wchar_t a[OS_PATH_MAX], b[OS_PATH_MAX];
    return os_done(
        MoveFileExW(os_wide(from, a), os_wide(to, b), MOVEFILE_REPLACE_EXISTING | MOVEFILE_WRITE_THROUGH));
}

OXL_INTERNAL int os_make_link(const char *target, const char *path)
{
    (void)target, (void)path; /* needs rights that programs rarely have */
    return -1;
}

OXL_INTERNAL int os_is_absolute(const char *path)
{
    return os_is_separator(path[0]) || (path[0] && path[1] == ':');
}

OXL_INTERNAL int os_working_folder(char *out, size_t size)
{
    wchar_t wide[OS_PATH_MAX];
    if (GetCurrentDirectoryW(OS_PATH_MAX, wide) == 0) return -1;
    return WideCharToMultiByte(CP_UTF8, 0, wide, -1, out, (int)size, NULL, NULL) ? 0 : -1;
}

OXL_INTERNAL void os_sync_folder(const char *path)
{
    (void)path; /* MOVEFILE_WRITE_THROUGH did it */
}

OXL_INTERNAL int os_make_one_folder(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    return os_done(CreateDirectoryW(os_wide(path, wide), NULL));
}

OXL_INTERNAL long os_process(void)
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
    wchar_t wide[OS_PATH_MAX];
    const wchar_t *name = os_wide(folder, wide);
    ULARGE_INTEGER bytes;
    return name && GetDiskFreeSpaceExW(name, &bytes, NULL, NULL) ? (double)bytes.QuadPart : 0;
}

OXL_INTERNAL int os_remove_folder(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
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
    return GetProcessMemoryInfo(GetCurrentProcess(), &counters, sizeof counters) ? counters.PeakWorkingSetSize
                                                                                 : 0;
}

OXL_INTERNAL int os_processor_quota(void)
{
    return 0;
}

OXL_INTERNAL const char *os_map(const char *path, size_t *size)
{
    (void)path, (void)size;
    return NULL; /* it is read */
}

OXL_INTERNAL int os_unmap(const char *data, size_t size)
{
    (void)data, (void)size;
    return 0;
}

OXL_INTERNAL size_t os_memory_free(void)
{
    MEMORYSTATUSEX status = {.dwLength = sizeof status};
    return GlobalMemoryStatusEx(&status) ? (size_t)status.ullAvailPhys : 0;
}

OXL_INTERNAL int os_list(const char *path, void (*visit)(void *user, const char *name), void *user)
{
    wchar_t wide[OS_PATH_MAX];
    char name[OS_PATH_MAX];
    WIN32_FIND_DATAW data;
    HANDLE find;
    snprintf(name, sizeof name, "%s/*", path);
    find = FindFirstFileW(os_wide(name, wide), &data);
    if (find == INVALID_HANDLE_VALUE) {
        errno = ENOENT;
        return -1;
    }
    do {
        if (WideCharToMultiByte(CP_UTF8, 0, data.cFileName, -1, name, sizeof name, NULL, NULL) == 0) continue;
        if (strcmp(name, ".") != 0 && strcmp(name, "..") != 0) visit(user, name);
    } while (FindNextFileW(find, &data));
    FindClose(find);
    return 0;
}

/* ---- locks: of a byte that no file reaches, so that the text stays readable; Windows releases them when the
 * process ends */

OXL_INTERNAL enum os_locked os_lock_try(struct os_lock *lock, int shared)
{
    OVERLAPPED place = {.Offset = 0x7fffffff};
    const DWORD how = LOCKFILE_FAIL_IMMEDIATELY | (shared ? 0 : LOCKFILE_EXCLUSIVE_LOCK);
    lock->process = 0;
    UnlockFileEx((HANDLE)lock->file, 0, 1, 0, &place); /* what this handle holds: it cannot be changed */
    if (LockFileEx((HANDLE)lock->file, how, 0, 1, 0, &place)) return OS_LOCK_TAKEN;
    return GetLastError() == ERROR_LOCK_VIOLATION || GetLastError() == ERROR_IO_PENDING ? OS_LOCK_BUSY
                                                                                        : OS_LOCK_NONE;
}

OXL_INTERNAL int os_lock_file(const char *path, int create, struct os_lock *lock)
{
    wchar_t wide[OS_PATH_MAX];
    lock->file = (intptr_t)CreateFileW(
        os_wide(path, wide), GENERIC_READ | GENERIC_WRITE, FILE_SHARE_READ | FILE_SHARE_WRITE, NULL,
        /* it cannot be removed while it is open */
        create ? OPEN_ALWAYS : OPEN_EXISTING, FILE_ATTRIBUTE_NORMAL | FILE_FLAG_OPEN_REPARSE_POINT, NULL);
    return os_done((HANDLE)lock->file != INVALID_HANDLE_VALUE);
}

OXL_INTERNAL size_t os_lock_read(const struct os_lock *lock, char *text, size_t size)
{
    DWORD got = 0;
    SetFilePointer((HANDLE)lock->file, 0, NULL, FILE_BEGIN);
    return ReadFile((HANDLE)lock->file, text, (DWORD)size, &got, NULL) ? got : 0;
}

OXL_INTERNAL void os_lock_write(const struct os_lock *lock, const char *text)
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

OXL_INTERNAL void os_host_name(char *out, size_t size)
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

#endif

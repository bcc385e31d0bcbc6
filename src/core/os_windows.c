/* os_windows.c - implements os.h through the Windows API. Each function sets errno on failure.
 *
 * Paths are UTF-8 here and UTF-16 in the API.
 */
#include "os.h"

#ifdef _WIN32

#include "os_windows.h"
#include <io.h>

OXL_INTERNAL const wchar_t *os_wide(const char *path, wchar_t *wide)
{
    if (MultiByteToWideChar(CP_UTF8, 0, path, -1, wide, OS_PATH_MAX) == 0) wide[0] = 0;
    return wide;
}

OXL_INTERNAL int os_done(BOOL ok)
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

/* Returns the time in tenths of microseconds. */
OXL_INTERNAL int64_t os_modified(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    WIN32_FILE_ATTRIBUTE_DATA data;
    if (!GetFileAttributesExW(os_wide(path, wide), GetFileExInfoStandard, &data)) return 0;
    return (int64_t)((uint64_t)data.ftLastWriteTime.dwHighDateTime << 32 |
                     data.ftLastWriteTime.dwLowDateTime);
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
    return _wfopen(wide, L"wb");
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

OXL_INTERNAL void os_sync_folder(const char *path)
{
    (void)path; /* MOVEFILE_WRITE_THROUGH has done it */
}

OXL_INTERNAL long os_process(void)
{
    return (long)GetCurrentProcessId();
}

OXL_INTERNAL double os_seconds(void)
{
    LARGE_INTEGER count, per_second;
    QueryPerformanceCounter(&count);
    QueryPerformanceFrequency(&per_second);
    return (double)count.QuadPart / (double)per_second.QuadPart;
}

OXL_INTERNAL int os_processor_quota(void)
{
    return 0;
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

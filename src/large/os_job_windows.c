/* os_job_windows.c - implements os_job.h through the Windows API. Each function sets errno on failure.
 */
#include "os_job.h"
#include "../../oceanxl_job.h"

#ifdef _WIN32
#include "../core/os_windows.h"
#include <io.h>
#include <psapi.h> /* link with -lpsapi */

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

OXL_INTERNAL int os_make_one_folder(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    return os_done(CreateDirectoryW(os_wide(path, wide), NULL));
}

int oxl_is_terminal(int stream)
{
    return _isatty(stream) != 0;
}

OXL_INTERNAL double os_disk_free(const char *folder)
{
    wchar_t wide[OS_PATH_MAX];
    ULARGE_INTEGER bytes;
    return GetDiskFreeSpaceExW(os_wide(folder, wide), &bytes, NULL, NULL) ? (double)bytes.QuadPart : 0;
}

OXL_INTERNAL int os_remove_folder(const char *path)
{
    wchar_t wide[OS_PATH_MAX];
    return os_done(RemoveDirectoryW(os_wide(path, wide)));
}

OXL_INTERNAL void os_sleep(double seconds)
{
    Sleep((DWORD)(1000 * seconds));
}

OXL_INTERNAL size_t os_memory_free(void)
{
    MEMORYSTATUSEX status = {.dwLength = sizeof status};
    return GlobalMemoryStatusEx(&status) ? (size_t)status.ullAvailPhys : 0;
}

OXL_INTERNAL size_t os_peak_rss(void)
{
    PROCESS_MEMORY_COUNTERS counters;
    return GetProcessMemoryInfo(GetCurrentProcess(), &counters, sizeof counters) ? counters.PeakWorkingSetSize
                                                                                 : 0;
}

/* ---- locks: of a byte that no file reaches, so that the text stays readable; Windows releases them when the
 * process ends */

OXL_INTERNAL enum os_locked os_lock_try(struct os_lock *lock, int shared)
{
    OVERLAPPED place = {.Offset = 0x7fffffff};
    const DWORD how = LOCKFILE_FAIL_IMMEDIATELY | (shared ? 0 : LOCKFILE_EXCLUSIVE_LOCK);
    /* Releases the handle's own lock first, since a lock cannot be changed. */
    UnlockFileEx((HANDLE)lock->file, 0, 1, 0, &place);
    if (LockFileEx((HANDLE)lock->file, how, 0, 1, 0, &place)) return OS_LOCK_TAKEN;
    return GetLastError() == ERROR_LOCK_VIOLATION || GetLastError() == ERROR_IO_PENDING ? OS_LOCK_BUSY
                                                                                        : OS_LOCK_NONE;
}

OXL_INTERNAL int os_lock_file(const char *path, struct os_lock *lock)
{
    wchar_t wide[OS_PATH_MAX];
    lock->file = (intptr_t)CreateFileW(
        os_wide(path, wide), GENERIC_READ | GENERIC_WRITE, FILE_SHARE_READ | FILE_SHARE_WRITE, NULL,
        /* Omits FILE_SHARE_DELETE, so that the file cannot be removed while it is open. */
        OPEN_ALWAYS, FILE_ATTRIBUTE_NORMAL | FILE_FLAG_OPEN_REPARSE_POINT, NULL);
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
    if (remove) os_remove(remove); /* Fails if another process has the file open. */
}

OXL_INTERNAL void os_host_name(char *out, size_t size)
{
    DWORD length = (DWORD)size;
    if (!GetComputerNameA(out, &length)) snprintf(out, size, "this machine");
}

#endif

/* os_windows.h - declares what os_windows.c and large/os_job_windows.c share. */
#ifndef OXL_OS_WINDOWS_H
#define OXL_OS_WINDOWS_H

#include "core.h"

#define WIN32_LEAN_AND_MEAN
#include <windows.h>
#undef near /* undefines macros of 16-bit Windows */
#undef far

enum { OS_PATH_MAX = 4096 };
/* Converts a path to UTF-16 in wide (OS_PATH_MAX); "": it cannot be converted. */
OXL_INTERNAL const wchar_t *os_wide(const char *path, wchar_t *wide);
/* Returns 0 for success; otherwise sets errno from the system's last error and returns -1. */
OXL_INTERNAL int os_done(BOOL ok);

#endif

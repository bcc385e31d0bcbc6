/* os.h - declares what a port to another system has to provide, besides the functions under os.c in core.h:
 * os_posix.c or os_windows.c.
 *
 * os.c and large/os_job.c use these functions, which set errno on failure.
 */
#ifndef OXL_OS_H
#define OXL_OS_H
#include "core.h"

#include <errno.h>

/* Ends the names of files that are being written, which no other program uses. */
#define OS_TEMPORARY ".oxl.tmp"

enum os_kind { OS_NOTHING, OS_FILE, OS_FOLDER, OS_SPECIAL /* a pipe, socket or device */ };

OXL_INTERNAL int os_is_separator(char c);
/* Returns the kind of a path. size: gets the bytes of a file; or NULL. */
OXL_INTERNAL enum os_kind os_kind_of(const char *path, uint64_t *size);
/* Opens a new file for writing. Removes a file with its name first; of a link the
 * link itself, not its target. */
OXL_INTERNAL FILE *os_create(const char *path);
/* Calls `visit` with the name of each entry but "." and "..". */
OXL_INTERNAL int os_list(const char *path, void (*visit)(void *user, const char *name), void *user);
OXL_INTERNAL long os_process(void); /* id of this process */

OXL_INTERNAL int os_seek(FILE *file, uint64_t offset); /* offset: from the start */
OXL_INTERNAL int os_sync(FILE *file);                  /* makes written data reach the disk */
/* Makes renames in the folder reach the disk, if the system supports this. */
OXL_INTERNAL void os_sync_folder(const char *path);

#ifndef _WIN32
/* Reads the number after `name` in a file of a folder, or the file's first number with
 * name ""; -1: none, or "max". */
OXL_INTERNAL double os_number_in(const char *folder, const char *file, const char *name);
/* Returns the least `limit` of the process's control group and those above it, in cgroups version 2; 0: none
 * has a limit. In a container, and in version 1, the root's files are the container's. */
OXL_INTERNAL double os_least_limit(double (*limit)(const char *folder), double of_version_1);
#endif

#endif

/* core.h - context, errors, memory, text, numbers, files, the table of options. Each layer has one header,
 * with a section per module; it includes headers of lower layers only (make rooms).
 *
 * Names: oxl_* is public; OXL_INTERNAL functions start with their module's name and may be called by other
 * modules; static functions belong to their file. In the single translation unit
 * (OXL_UNITY) OXL_INTERNAL is static; in objects per file it is extern, so every dependency must be declared
 * in a header.
 */
#ifndef OXL_CORE_H
#define OXL_CORE_H

/* Selects POSIX for os_posix.c under -std=c99. The first system header decides, so core.h is included
 * before any system header. */
#if !defined(_WIN32) && !defined(_POSIX_C_SOURCE)
#define _POSIX_C_SOURCE 200809L
#endif
#if !defined(_WIN32) && !defined(_FILE_OFFSET_BITS)
/* Allows files past 2 GB, and folders of file systems with large offsets, on 32-bit machines, too. */
#define _FILE_OFFSET_BITS 64
#endif
#if defined(__MINGW32__) && !defined(__USE_MINGW_ANSI_STDIO)
#define __USE_MINGW_ANSI_STDIO 1 /* Selects printf of C99: %zu. */
#endif
#if defined(__APPLE__) && !defined(_DARWIN_C_SOURCE)
#define _DARWIN_C_SOURCE /* Makes the system declare ru_maxrss. */
#endif

#include "../../oceanxl.h"
#include "random.h"

#include <float.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#ifdef _OPENMP
#include <omp.h>
#endif

#if !defined(OXL_UNITY)
#define OXL_INTERNAL
#elif defined(__GNUC__)
#define OXL_INTERNAL static __attribute__((unused)) /* Allows functions that only tests or benchmarks use. */
#else
#define OXL_INTERNAL static
#endif

/* Declares a constant table before its definition. */
#ifdef OXL_UNITY
#define OXL_TABLE static
#else
#define OXL_TABLE extern
#endif

#define OXL_COUNT(array) (sizeof(array) / sizeof *(array))
#define OXL_MIN(a, b) ((a) < (b) ? (a) : (b))
#define OXL_MAX(a, b) ((a) > (b) ? (a) : (b))
#define OXL_SWAP(type, a, b)      \
    do {                          \
        type const swapped = (a); \
        (a) = (b);                \
        (b) = swapped;            \
    } while (0)
#define OXL_CLAMP(x, lo, hi) ((x) < (lo) ? (lo) : (x) > (hi) ? (hi) : (x))

/* ---------------- context.c: the context; memory.c: errors, memory; log.c: the log */

struct oxl_context {
    oxl_context_options options;
    int threads;             /* threads in use, at least 1 */
    int isa;                 /* enum isa of simd.h */
    struct backend *backend; /* backend of the renderer; NULL: not opened */
    char error[1024];
    struct text *notes; /* copies of log lines, as elements of a JSON array; NULL: none are kept */
    oxl_result failed;  /* code of `error`, for callers of functions that return a pointer */
    void (*name_fields)(char *text, size_t size); /* option_name_fields, or NULL */
};

/* Open and close a context without its backend, which backend.c opens. */
OXL_INTERNAL oxl_result context_open(const oxl_context_options *options, oxl_context **out);
OXL_INTERNAL void context_close(oxl_context *ctx);

/* Names options in a text as fields, unless the caller is the command line. */
static inline void context_name_fields(const oxl_context *ctx, char *text, size_t size)
{
    if (!ctx->options.command_line && ctx->name_fields) ctx->name_fields(text, size);
}

OXL_INTERNAL int context_thread(void); /* index of this thread in a parallel region, from 0 */

/* Returns OXL_ERR_INTERRUPTED if the caller asks to stop. Loops over files, images and blocks that report no
 * progress call it, on one thread only, and never while the state is saved. */
OXL_INTERNAL oxl_result context_stopped(oxl_context *ctx);
/* Reports progress; callback may be NULL. Returns nonzero if the caller stops the run. */
OXL_INTERNAL int context_report(const oxl_callback *callback, const oxl_progress *progress);
/* Makes a context for one of several threads, with memory from ctx. It does not log and keeps its own
 * errors. */
OXL_INTERNAL oxl_context context_for_thread(oxl_context *ctx);

/* Allocate all memory of the library, aligned to 64 bytes; NULL if the allocator fails or count x size
 * overflows: the context then has the error, and the caller returns OXL_ERR_MEMORY. */
OXL_INTERNAL void *oxl_alloc(oxl_context *ctx, size_t count, size_t size);
OXL_INTERNAL void *oxl_calloc(oxl_context *ctx, size_t count, size_t size);
/* Changes the number of elements and keeps min(old, new) of them; on failure `old` stays valid. */
OXL_INTERNAL void *oxl_regrow(oxl_context *ctx, void *old, size_t old_count, size_t new_count, size_t size);
OXL_INTERNAL void oxl_free(oxl_context *ctx, void *memory);
OXL_INTERNAL void oxl_free_all(oxl_context *ctx, void *const *memory, size_t count);
#define OXL_FREE(ctx, ...) oxl_free_all(ctx, (void *[]){__VA_ARGS__}, OXL_COUNT(((void *[]){__VA_ARGS__})))

/* Grows an array until it holds at least `needed` elements of `size` bytes, by a quarter if memory allows,
 * and keeps its elements. array: address of the pointer to them. */
OXL_INTERNAL oxl_result oxl_reserve(oxl_context *ctx, void *array, size_t *capacity, size_t needed,
                                    size_t size);
/* Does the same for an array whose capacity is beside it, named like it with _capacity behind. */
#define OXL_RESERVE(ctx, array, needed) oxl_reserve(ctx, &(array), &array##_capacity, needed, sizeof *(array))

#if defined(__MINGW32__)
#define OXL_PRINTF(at, first) __attribute__((format(gnu_printf, at, first)))
#elif defined(__GNUC__)
#define OXL_PRINTF(at, first) __attribute__((format(printf, at, first)))
#else
#define OXL_PRINTF(at, first)
#endif

/* Sets the context's error and returns rc: `return oxl_fail(ctx, OXL_ERR_INPUT, "%s:%d: ...", path, line);`.
 * Declares the public function again, with a check of its format. */
OXL_API oxl_result oxl_fail(oxl_context *ctx, oxl_result rc, const char *format, ...) OXL_PRINTF(3, 4);
OXL_INTERNAL void oxl_log(oxl_context *ctx, oxl_log_level level, const char *format, ...) OXL_PRINTF(3, 4);

/* ---------------- text.c */

/* Holds growing text. A failed allocation sets `failed`, which callers test once at the end. */
struct text {
    oxl_context *ctx;
    char *data; /* zero-terminated; NULL before the first addition */
    size_t size, capacity;
    int failed;
};
OXL_INTERNAL void text_add(struct text *t, const char *format, ...) OXL_PRINTF(2, 3);
/* Lists UTF-16's first low surrogate, its first high one, and the number of each. A byte that is not UTF-8
 * becomes a low surrogate in JSON, from which oxl_json_text restores it. */
enum { JSON_LOW = 0xDC00, JSON_HIGH = 0xD800, JSON_SURROGATES = 0x400 };
OXL_INTERNAL void text_add_json_string(struct text *t, const char *s); /* quoted and escaped */
OXL_INTERNAL void text_free(struct text *t);
/* Moves the text to *out and empties t; OXL_ERR_MEMORY if an addition failed. */
OXL_INTERNAL oxl_result text_take(struct text *t, char **out);

/* Copies text; NULL: no memory. */
OXL_INTERNAL char *oxl_strdup(oxl_context *ctx, const char *s);
/* Makes the path "folder/rest" in a temporary of the enclosing block, its second part from a format:
 * PATH(folder, "blocks/%03d", k); folder may be "" or end in a slash. A path that is too long becomes one that
 * cannot exist. */
enum { PATH_LENGTH = 4096 };
OXL_INTERNAL const char *path_in(char out[PATH_LENGTH], const char *folder, const char *format, ...)
    OXL_PRINTF(3, 4);
#define PATH(...) path_in((char[PATH_LENGTH]){0}, __VA_ARGS__)
/* Makes oxl_shell_word's text in a temporary, for the commands in messages. */
#define SHELL_WORD(path) oxl_shell_word(path, (char[PATH_LENGTH]){0}, PATH_LENGTH)
OXL_API const char *oxl_shell_word(const char *path, char *out, size_t size);
/* Names options in a text as the fields that programs set: --image-cache becomes image_cache_bytes. */
OXL_INTERNAL void option_name_fields(char *text, size_t size);
OXL_INTERNAL const char *path_base_name(const char *path); /* part after the last slash */
/* Returns the longest end of a name, from a slash on, that is a file of the folder; else the name. */
OXL_INTERNAL const char *path_longest_tail(const char *folder, const char *name);

/* ---------------- number.c: fast, exact, locale-independent number parsing */

/* Parses one decimal number at *cursor, which moves past it; returns 0 if there is none. Independent of the
 * locale and correctly rounded, as strtod in the C locale. Accepts signs, exponents, nan and inf in the usual
 * spellings, also "-nan(ind)". */
OXL_INTERNAL int parse_double(const char **cursor, const char *end, double *out);
OXL_INTERNAL int parse_int64(const char **cursor, const char *end, int64_t *out);

/* Writes the value as %.17g in the "C" locale, which parses to the same value; returns the length. */
enum { NUMBER_TEXT_MAX = 48 };
OXL_INTERNAL size_t format_double(char out[NUMBER_TEXT_MAX], double value);
/* Writes the shortest text that parses to the same double. */
OXL_INTERNAL void format_shortest(char out[NUMBER_TEXT_MAX], double value);
/* Writes the shortest text that parses to the same float. */
OXL_INTERNAL void format_float(char out[NUMBER_TEXT_MAX], float value);

/* Returns the value as text for %s in a format, which parses to the same value;
 * "null" if it is not finite. */
OXL_INTERNAL const char *number_text(char out[NUMBER_TEXT_MAX], double value);
#define NUMBER(value) number_text((char[NUMBER_TEXT_MAX]){0}, value)

/* ---------------- options.c: the table of options; other functions are public */

/* Turns the options off whose `use` has this flag. */
OXL_INTERNAL void options_drop(oxl_train_options *train, unsigned flag);

/* ---------------- os.c, and os_posix.c or os_windows.c: what C99 lacks */

struct os_file_map { /* Holds a whole file in memory, read-only, followed by a zero byte. */
    const char *data;
    size_t size;
};
OXL_INTERNAL oxl_result os_read_file(oxl_context *ctx, const char *path, struct os_file_map *out);
/* Fails if the first bytes are those of a file by gzip, or of a Git LFS pointer; readers of text,
 * images and PLY files call it. */
OXL_INTERNAL oxl_result os_refuse_gzip(oxl_context *ctx, const char *path, const void *data, size_t size);
/* 1: missing, but there is one with .gz behind its name */
OXL_INTERNAL int os_is_compressed(const char *path);
OXL_INTERNAL void os_release_file(oxl_context *ctx, struct os_file_map *map);

/* Reads a file in pieces. `path` is borrowed. */
struct os_reader {
    FILE *file;
    const char *path;
    uint64_t size; /* bytes; only a hint, since a file may grow */
};
OXL_INTERNAL oxl_result os_reader_open(oxl_context *ctx, const char *path, struct os_reader *out);
OXL_INTERNAL oxl_result os_reader_read(oxl_context *ctx, struct os_reader *r, void *data, size_t size,
                                       size_t *got); /* *got < size: the end of the file */
OXL_INTERNAL oxl_result os_reader_seek(oxl_context *ctx, struct os_reader *r, uint64_t offset);
OXL_INTERNAL void os_reader_close(struct os_reader *r);
/* Writes a file completely or not at all: temporary name in the same folder, write, fsync,
 * rename, fsync of the folder. */
OXL_INTERNAL oxl_result os_write_file(oxl_context *ctx, const char *path, const void *data, size_t size);
OXL_INTERNAL oxl_result os_write_text(oxl_context *ctx, const char *path, const struct text *t);
/* Writes a file as os_write_file does, piece by piece. */
struct os_writer {
    FILE *file;
    char *path, *temporary;
    int unsynced; /* 1: no fsync, for files that a crash of the machine may lose */
};
OXL_INTERNAL oxl_result os_writer_open(oxl_context *ctx, const char *path, struct os_writer *out);
/* Closes the file and gives it its name; rc other than OXL_OK: discards it. */
OXL_INTERNAL oxl_result os_writer_close(oxl_context *ctx, struct os_writer *writer, oxl_result rc);

/* Opens a file to read; NULL: errno has the reason, ENXIO for a pipe, a socket or a device. */
OXL_INTERNAL FILE *os_open(const char *path);
OXL_INTERNAL int os_rename(const char *from, const char *to); /* replaces `to`; 0: success */
OXL_INTERNAL int os_remove(const char *path);                 /* 0: success */

/* Fails with "PATH: WHAT: REASON" of an errno, and a fix for the user. */
OXL_INTERNAL oxl_result os_fail(oxl_context *ctx, oxl_result rc, const char *path, const char *what,
                                int error);
#ifdef OXL_VULKAN
/* Opens a shared library at run time; NULL: it is not found. */
OXL_INTERNAL void *os_library_open(const char *name);
/* Finds a symbol of the library. out: (size) a function pointer. */
OXL_INTERNAL void os_library_symbol(void *library, const char *name, void *out, size_t size);
OXL_INTERNAL void os_library_close(void *library);
#endif

OXL_INTERNAL int os_is_file(const char *path);
OXL_INTERNAL int os_is_folder(const char *path);
OXL_INTERNAL int64_t os_modified(const char *path); /* modification time in the system's unit; 0: unknown */
/* Returns the number of processors that the process may use (Linux cgroups); 0: no limit is known. */
OXL_INTERNAL int os_processor_quota(void);
OXL_INTERNAL double os_seconds(void); /* seconds of a monotonic clock */
/* Calls `visit` with the name of each entry of a folder, in any order. */
OXL_INTERNAL oxl_result os_list_folder(oxl_context *ctx, const char *path,
                                       void (*visit)(void *user, const char *name), void *user);

/* ---------------- checksum.c: checksums of working files */

#define CHECKSUM_SEED UINT64_C(14695981039346656037)
/* begins with CHECKSUM_SEED */
OXL_INTERNAL uint64_t checksum_add(uint64_t sum, const void *data, size_t size);

/* Ends a text with the line "# checksum HEX", the checksum of all text before it. checksum_is_wrong returns 1
 * if a text ends in such a line with another checksum. */
OXL_INTERNAL void checksum_end_text(struct text *t);
OXL_INTERNAL int checksum_is_wrong(const char *data, size_t size);

#endif

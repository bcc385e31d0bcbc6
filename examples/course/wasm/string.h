/* string.h - for WebAssembly; the compiler makes instructions of both (-mbulk-memory). */
#ifndef COURSE_STRING_H
#define COURSE_STRING_H
#include <stddef.h>
#define memcpy __builtin_memcpy
#define memset __builtin_memset
#endif

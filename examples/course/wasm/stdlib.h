/* stdlib.h - for WebAssembly: memory for one caller at a time, ssim() of splat.c, which frees before it allocates again. */
#ifndef COURSE_STDLIB_H
#define COURSE_STDLIB_H
#include <string.h>

static double course_heap[5 * 48 * 36];

static inline void *calloc(size_t count, size_t size) {
    return count * size > sizeof course_heap ? 0 : memset(course_heap, 0, count * size);
}
static inline void free(void *p) { (void)p; }
#endif

/* bytes.h - reads and writes little-endian numbers in files, whatever the machine's own order. */
#ifndef OXL_BYTES_H
#define OXL_BYTES_H

#include <stdint.h>
#include <string.h>

static inline uint64_t bytes_get(const void *from, int size)
{
    const unsigned char *p = from;
    uint64_t value = 0;
    for (int i = size - 1; i >= 0; i--) value = value << 8 | p[i];
    return value;
}

static inline void bytes_put(void *to, uint64_t value, int size)
{
    for (int i = 0; i < size; i++) ((unsigned char *)to)[i] = (unsigned char)(value >> 8 * i);
}

static inline uint32_t bytes_u32(const void *from)
{
    return (uint32_t)bytes_get(from, 4);
}

static inline float bytes_float(const void *from)
{
    const uint32_t bits = bytes_u32(from);
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline double bytes_double(const void *from)
{
    const uint64_t bits = bytes_get(from, 8);
    double value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline void bytes_put_float(void *to, float value)
{
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    bytes_put(to, bits, 4);
}

#endif

/* random.h - draws random numbers without state: each is a function of a seed and two numbers, whatever was
 * drawn before, and equal on all machines.
 */
#ifndef OXL_RANDOM_H
#define OXL_RANDOM_H

#include <stdint.h>

static inline uint64_t random_mix(uint64_t x) /* finaliser of splitmix64 (Steele, Lea & Flood 2014) */
{
    x += UINT64_C(0x9E3779B97F4A7C15);
    x = (x ^ (x >> 30)) * UINT64_C(0xBF58476D1CE4E5B9);
    x = (x ^ (x >> 27)) * UINT64_C(0x94D049BB133111EB);
    return x ^ (x >> 31);
}

static inline uint64_t random_bits(uint64_t seed, uint64_t a, uint64_t b)
{
    return random_mix(random_mix(random_mix(seed) ^ a) ^ b);
}

static inline double random_unit(uint64_t bits) /* [0,1) */
{
    return (double)(bits >> 11) * (1.0 / 9007199254740992.0); /* 2^-53 */
}

#endif

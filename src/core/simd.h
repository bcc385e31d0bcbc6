/* simd.h - selects the instruction set at run time, for arithmetic that vectorises.
 *
 * A kernel is written once, as an always-inlined body over a struct of its arguments:
 *
 *     SIMD_BODY void blur_body(const int fused, const struct blur *job) { ... #pragma omp simd ... }
 *     SIMD_DISPATCH(static, blur, struct blur)      makes   static void blur(int isa, const struct blur *job)
 *
 * Each wrapper is compiled for its own target. `fused` is a constant there: 1 where the target has fused
 * multiply-add. Invariant: AVX2 and AVX-512 (and every machine with FMA) give the same bytes for any vector
 * width: all sums have a fixed order, and every fused operation is explicit.
 */
#ifndef OXL_SIMD_H
#define OXL_SIMD_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

enum isa { ISA_BASE, ISA_AVX2, ISA_AVX512 };

#ifdef __GNUC__
#define SIMD_INLINE static inline __attribute__((always_inline, unused))
#else
#define SIMD_INLINE static inline
#endif
#define SIMD_BODY SIMD_INLINE

/* Tells whether the baseline has FMA, as on aarch64, and on x86 with -mfma. */
#ifdef __FP_FAST_FMAF
#define SIMD_BASE_FUSED 1
#else
#define SIMD_BASE_FUSED 0
#endif

#if defined(__GNUC__) && defined(__x86_64__) && !defined(OXL_NO_SIMD)
#define SIMD_X86 1
#define SIMD_TARGET_AVX2 __attribute__((target("avx2,fma")))
#ifdef __clang__
#define SIMD_TARGET_AVX512 \
    __attribute__((target("avx2,fma,avx512f,avx512bw,avx512dq,avx512vl"), min_vector_width(512)))
#else
/* Tunes for AVX-512: with generic costs gcc reloads a vector at each use, even across cache lines, instead of
 * keeping it in a register. */
#define SIMD_TARGET_AVX512 \
    __attribute__((        \
        target("avx2,fma,avx512f,avx512bw,avx512dq,avx512vl,prefer-vector-width=512,tune=skylake-avx512")))
#endif
#ifdef OXL_ONE_ISA /* make DEV=1 compiles each body once, for the machine that builds it */
#if OXL_ONE_ISA == 2
#define SIMD_TARGET_ONE SIMD_TARGET_AVX512
#elif OXL_ONE_ISA == 1
#define SIMD_TARGET_ONE SIMD_TARGET_AVX2
#else
#define SIMD_TARGET_ONE
#endif
#define SIMD_DISPATCH(linkage, name, job_type)                  \
    SIMD_TARGET_ONE static void name##_one(const job_type *job) \
    {                                                           \
        name##_body(OXL_ONE_ISA > 0 || SIMD_BASE_FUSED, job);   \
    }                                                           \
    linkage void name(int isa, const job_type *job)             \
    {                                                           \
        (void)isa;                                              \
        name##_one(job);                                        \
    }
#else
#define SIMD_DISPATCH(linkage, name, job_type)                        \
    SIMD_TARGET_AVX512 static void name##_avx512(const job_type *job) \
    {                                                                 \
        name##_body(1, job);                                          \
    }                                                                 \
    SIMD_TARGET_AVX2 static void name##_avx2(const job_type *job)     \
    {                                                                 \
        name##_body(1, job);                                          \
    }                                                                 \
    static void name##_base(const job_type *job)                      \
    {                                                                 \
        name##_body(SIMD_BASE_FUSED, job);                            \
    }                                                                 \
    linkage void name(int isa, const job_type *job)                   \
    {                                                                 \
        if (isa == ISA_AVX512) name##_avx512(job);                    \
        else if (isa == ISA_AVX2) name##_avx2(job);                   \
        else name##_base(job);                                        \
    }
#endif
#else
#define SIMD_X86 0
#define SIMD_DISPATCH(linkage, name, job_type)      \
    linkage void name(int isa, const job_type *job) \
    {                                               \
        (void)isa;                                  \
        name##_body(SIMD_BASE_FUSED, job);          \
    }
#endif

/* Returns the index of the lowest set bit; bits is not 0. */
SIMD_INLINE int simd_lowest_bit(uint32_t bits)
{
#ifdef __GNUC__
    return __builtin_ctz(bits);
#else
    int index = 0;
    for (; !(bits & 1); bits >>= 1) index++;
    return index;
#endif
}

/* Prefetches the cache line at `at`, for access patterns that the hardware prefetcher does not detect. */
SIMD_INLINE void simd_prefetch(const void *at)
{
#ifdef __GNUC__
    __builtin_prefetch(at);
#else
    (void)at;
#endif
}

SIMD_INLINE int simd_detect(void)
{
    int best = ISA_BASE;
#if SIMD_X86 && defined(OXL_ONE_ISA)
    best = OXL_ONE_ISA;
#elif SIMD_X86
    const char *forced = getenv("OXL_ISA");
    if (__builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma")) best = ISA_AVX2;
    if (best == ISA_AVX2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512bw") &&
        __builtin_cpu_supports("avx512dq") && __builtin_cpu_supports("avx512vl"))
        best = ISA_AVX512;
    if (forced && !strcmp(forced, "base")) best = ISA_BASE;
    if (forced && !strcmp(forced, "avx2") && best > ISA_AVX2) best = ISA_AVX2;
#endif
    return best;
}

SIMD_INLINE const char *simd_name(int isa)
{
    return isa == ISA_AVX512 ? "avx512" : isa == ISA_AVX2 ? "avx2" : "base";
}

#endif

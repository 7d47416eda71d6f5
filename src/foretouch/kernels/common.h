/* SPDX-License-Identifier: Apache-2.0 */
/* Headers, vectors and macros that the compiled loops share. */
#ifndef FORETOUCH_COMMON_H
#define FORETOUCH_COMMON_H

#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Compiled twice, for AVX2 as well, and selected when the library is loaded. */
#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define VECTORISED __attribute__((target_clones("avx2", "default")))
#else
#define VECTORISED
#endif

/* Four or eight float32, eight int32, and four double or int64 at once, in any processor's registers; the u forms need no alignment. */
typedef float float4 __attribute__((vector_size(16)));
typedef float float8 __attribute__((vector_size(32)));
typedef int32_t int8x32 __attribute__((vector_size(32)));
typedef double double4 __attribute__((vector_size(32)));
typedef int64_t int64x4 __attribute__((vector_size(32)));
typedef float float4u __attribute__((vector_size(16), aligned(4), may_alias));
typedef float float8u __attribute__((vector_size(32), aligned(4), may_alias));
typedef int32_t int8x32u __attribute__((vector_size(32), aligned(4), may_alias));
typedef double double4u __attribute__((vector_size(32), aligned(8), may_alias));
typedef int64_t int64x4u __attribute__((vector_size(32), aligned(8), may_alias));
#define INLINE static inline __attribute__((always_inline))

INLINE float8 larger8(float8 a, float8 b) {
    const int8x32 which = a > b;
    return (float8)(((int8x32)a & which) | ((int8x32)b & ~which));
}

#endif

/* SPDX-License-Identifier: Apache-2.0 */
/* Compiled loops of foretouch: plain C without Python, called from kernels/__init__.py.
 *
 * Each has a NumPy form beside its caller, which the tests compare it with. To give the same bits, the file is compiled
 * without contraction of a * b + c and without reordering of sums; float32 stays float32 where NumPy has it.
 * Arrays are contiguous and belong to the caller; no function allocates what it does not free, or keeps a state. */
#ifndef FORETOUCH_KERNELS_H
#define FORETOUCH_KERNELS_H

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

#endif

/* SPDX-License-Identifier: Apache-2.0 */
/* The maximum over the points of a shared layer, for training: which point wins, and value and gradient from it alone. */
#include "kernels.h"

#define COLUMNS 64
#define LANES 16

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define COMPARING __attribute__((target_clones("arch=skylake-avx512", "avx2", "default"))) /* masks: half of the time of AVX2 */
#else
#define COMPARING
#endif

INLINE float of_float32(float value) { return value; }

INLINE float of_bfloat16(uint16_t bits) {
    const uint32_t wide = (uint32_t)bits << 16;
    float value;
    memcpy(&value, &wide, sizeof value);
    return value;
}

/* winner (clouds, features): the row of the largest of values (clouds, points, features), the first of equal ones. A value
 * that is not a number wins. */
#define LARGEST(name, type, as_float)                                                                                  \
    COMPARING void name(const type *values, int64_t clouds, int64_t points, int64_t features, int64_t *winner) {       \
        for (int64_t c = 0; c < clouds; c++, values += points * features, winner += features) {                        \
            for (int64_t f = 0; f < features; f += COLUMNS) {                                                          \
                const int64_t count = features - f < COLUMNS ? features - f : COLUMNS;                                 \
                float most[COLUMNS];                                                                                   \
                int32_t at[COLUMNS] = {0};                                                                             \
                for (int64_t l = 0; l < count; l++) {                                                                  \
                    most[l] = as_float(values[f + l]);                                                                 \
                }                                                                                                      \
                for (int32_t i = 0; i < points; i++) {                                                                 \
                    const type *row = values + i * features + f;                                                       \
                    if (count == COLUMNS) { /* a constant number, so that the compiler keeps all in registers */       \
                        for (int l = 0; l < COLUMNS; l++) {                                                            \
                            const float v = as_float(row[l]);                                                          \
                            const int wins = (v > most[l]) | (v != v);                                                 \
                            most[l] = wins ? v : most[l];                                                              \
                            at[l] = wins ? i : at[l];                                                                  \
                        }                                                                                              \
                        continue;                                                                                      \
                    }                                                                                                  \
                    for (int64_t l = 0; l < count; l++) {                                                              \
                        const float v = as_float(row[l]);                                                              \
                        const int wins = (v > most[l]) | (v != v);                                                     \
                        most[l] = wins ? v : most[l];                                                                  \
                        at[l] = wins ? i : at[l];                                                                      \
                    }                                                                                                  \
                }                                                                                                      \
                for (int64_t l = 0; l < count; l++) {                                                                  \
                    winner[f + l] = at[l];                                                                             \
                }                                                                                                      \
            }                                                                                                          \
        }                                                                                                              \
    }

LARGEST(largest_float32, float, of_float32)
LARGEST(largest_bfloat16, uint16_t, of_bfloat16)

/* products (clouds, features): the row of x (., inputs) given for each by rows, times the feature's row of weight. */
#define PRODUCTS(name, type)                                                                                           \
    VECTORISED void name(const type *x, const type *weight, const int64_t *rows, int64_t clouds, int64_t features,     \
                         int64_t inputs, type *products) {                                                             \
        const int64_t whole = inputs - inputs % LANES;                                                                 \
        for (int64_t i = 0; i < clouds * features; i++) {                                                              \
            const type *a = x + rows[i] * inputs, *b = weight + i % features * inputs;                                 \
            type lanes[LANES] = {0}, sum = 0;                                                                          \
            for (int64_t k = 0; k < whole; k += LANES) {                                                               \
                for (int l = 0; l < LANES; l++) {                                                                      \
                    lanes[l] += a[k + l] * b[k + l];                                                                   \
                }                                                                                                      \
            }                                                                                                          \
            for (int64_t k = whole; k < inputs; k++) {                                                                 \
                sum += a[k] * b[k];                                                                                    \
            }                                                                                                          \
            for (int l = 0; l < LANES; l++) {                                                                          \
                sum += lanes[l];                                                                                       \
            }                                                                                                          \
            products[i] = sum;                                                                                         \
        }                                                                                                              \
    }

PRODUCTS(winner_products_float32, float)
PRODUCTS(winner_products_float64, double)

/* Adds to g_x, shaped as x, and to g_weight, shaped as weight, the gradient of the products above, whose slope is given.
 * g_weight is not written where need_weight is 0, nor g_x where need_x is. */
#define GRADIENTS(name, type)                                                                                          \
    VECTORISED void name(const type *slope, const type *x, const type *weight, const int64_t *rows, int64_t clouds,    \
                         int64_t features, int64_t inputs, int64_t need_x, int64_t need_weight, type *restrict g_x,    \
                         type *restrict g_weight) {                                                                    \
        for (int64_t i = 0; i < clouds * features; i++) {                                                              \
            const type s = slope[i];                                                                                   \
            const int64_t from = rows[i] * inputs, to = i % features * inputs;                                         \
            if (s == 0) {                                                                                              \
                continue; /* its ReLU is off */                                                                        \
            }                                                                                                          \
            if (need_x) {                                                                                              \
                for (int64_t k = 0; k < inputs; k++) {                                                                 \
                    g_x[from + k] += s * weight[to + k];                                                               \
                }                                                                                                      \
            }                                                                                                          \
            if (need_weight) {                                                                                         \
                for (int64_t k = 0; k < inputs; k++) {                                                                 \
                    g_weight[to + k] += s * x[from + k];                                                               \
                }                                                                                                      \
            }                                                                                                          \
        }                                                                                                              \
    }

GRADIENTS(winner_gradients_float32, float)
GRADIENTS(winner_gradients_float64, double)

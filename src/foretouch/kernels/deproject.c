/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"

/* A depth has a point where it is above 0 and finite, and its pixel has a ray. */
#define IS_DEPTH(z) ((z) > 0.0f && (z) < INFINITY)

/* Points of every `step`-th pixel of every `step`-th row, h x w of them, from the first pixel on; NaN in all three without a point.
 *
 * depth: its rows have `across` pixels; `scale`: metres of its unit. x: of each column, y: of each row; or both of each pixel where
 * `each`. xyz: from the first point on, with rows of `line` points. */
#define DEPROJECT(name, type)                                                                                       \
    INLINE void name##_by(const type *depth, int64_t across, int64_t h, int64_t w, int64_t step, float metres,      \
                          const float *x, const float *y, int64_t each, float *xyz, int64_t line) {                 \
        for (int64_t row = 0; row < h; row++, depth += step * across, xyz += 3 * line) {                            \
            const float *ray_x = each ? x + row * step * across : x, *ray_y = y + row * step * (each ? across : 1); \
            float *point = xyz;                                                                                     \
            for (int64_t column = 0; column < w; column++, point += 3) {                                            \
                const float z = (float)depth[column * step] * metres;                                               \
                const float a = ray_x[column * step], b = each ? ray_y[column * step] : *ray_y;                     \
                const int none = !(IS_DEPTH(z) && a == a && b == b);                                                \
                point[0] = none ? NAN : a * z;                                                                      \
                point[1] = none ? NAN : b * z;                                                                      \
                point[2] = none ? NAN : z;                                                                          \
            }                                                                                                       \
        }                                                                                                           \
    }                                                                                                               \
    VECTORISED void name(const type *depth, int64_t across, int64_t h, int64_t w, int64_t step, double scale,       \
                         const float *x, const float *y, int64_t each, float *xyz, int64_t line) {                  \
        if (step == 1) {                                                                                            \
            name##_by(depth, across, h, w, 1, (float)scale, x, y, each, xyz, line);                                 \
        } else {                                                                                                    \
            name##_by(depth, across, h, w, step, (float)scale, x, y, each, xyz, line);                              \
        }                                                                                                           \
    }

/* Number of points of n pixels, and of those between low and high; rays are given where `each`. counts: (2). */
#define COUNT_DEPTHS(name, type)                                                                                    \
    VECTORISED void name(const type *depth, int64_t n, double scale, double low, double high, const float *x,       \
                         const float *y, int64_t each, int64_t *counts) {                                           \
        const float metres = (float)scale, near = (float)low, far = (float)high;                                    \
        counts[0] = counts[1] = 0;                                                                                  \
        for (int64_t start = 0; start < n; start += 65536) {                                                        \
            const int64_t stop = start + 65536 < n ? start + 65536 : n;                                             \
            int32_t some = 0, within = 0; /* of a block, so that both are as wide as a depth */                     \
            for (int64_t i = start; i < stop && each; i++) {                                                        \
                const float z = (float)depth[i] * metres;                                                           \
                const int32_t is = (z > 0.0f) & (z < INFINITY) & (x[i] == x[i]) & (y[i] == y[i]);                   \
                some += is, within += is & (z >= near) & (z <= far);                                                \
            }                                                                                                       \
            for (int64_t i = start; i < stop && !each; i++) {                                                       \
                const float z = (float)depth[i] * metres;                                                           \
                const int32_t is = (z > 0.0f) & (z < INFINITY);                                                     \
                some += is, within += is & (z >= near) & (z <= far);                                                \
            }                                                                                                       \
            counts[0] += some, counts[1] += within;                                                                 \
        }                                                                                                           \
    }

DEPROJECT(deproject_whole, uint16_t)
DEPROJECT(deproject_single, float)
COUNT_DEPTHS(count_whole, uint16_t)
COUNT_DEPTHS(count_single, float)

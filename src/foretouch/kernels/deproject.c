/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"
#include <float.h>

/* A depth has a point where it is above 0 and finite, and its pixel has a ray. */
#define IS_DEPTH(z) ((z) > 0.0f && (z) < INFINITY)

/* Points of every `step`-th pixel of every `step`-th row, h x w of them, from the first pixel on; NaN in all three without a point.
 *
 * depth: its rows have `across` pixels. xyz: from the first point on, with rows of `line` points. */
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
    VECTORISED void name(const type *depth, int64_t across, int64_t h, int64_t w, int64_t step, const Rays *rays,   \
                         float *xyz, int64_t line) {                                                                \
        if (step == 1) {                                                                                            \
            name##_by(depth, across, h, w, 1, (float)rays->scale, rays->x, rays->y, rays->each, xyz, line);         \
        } else {                                                                                                    \
            name##_by(depth, across, h, w, step, (float)rays->scale, rays->x, rays->y, rays->each, xyz, line);      \
        }                                                                                                           \
    }

/* The least number whose depth is not below `low`, where depths grow with the numbers. */
static int32_t first_above(float metres, float low) {
    int32_t first = 1, end = 65536; /* 0 is no depth */
    while (first < end) {
        const int32_t middle = (first + end) / 2;
        if ((float)middle * metres >= low) {
            end = middle;
        } else {
            first = middle + 1;
        }
    }
    return first;
}

/* Number of points of n pixels, and of those between low and high. counts: (2). */
void count_single(const float *depth, int64_t n, const Rays *rays, double low, double high, int64_t *counts) {
    const float metres = (float)rays->scale, near = (float)low, far = (float)high, *x = rays->x, *y = rays->y;
    const int64_t each = rays->each;
    counts[0] = counts[1] = 0;
    for (int64_t i = 0; i < n; i++) {
        const float z = depth[i] * metres;
        const int is = IS_DEPTH(z) && (!each || (x[i] == x[i] && y[i] == y[i]));
        counts[0] += is, counts[1] += is && z >= near && z <= far;
    }
}

/* As count_single, of whole numbers: by what they are compared with, in place of their depths. */
VECTORISED void count_whole(const uint16_t *depth, int64_t n, const Rays *rays, double low, double high, int64_t *counts) {
    const float metres = (float)rays->scale, *x = rays->x, *y = rays->y;
    const int64_t each = rays->each;
    const uint16_t least = (uint16_t)(first_above(metres, FLT_TRUE_MIN) - 1), most = (uint16_t)(first_above(metres, INFINITY) - 1);
    const uint16_t near = (uint16_t)(first_above(metres, (float)low) - 1), far = (uint16_t)(first_above(metres, nextafterf((float)high, INFINITY)) - 1);
    counts[0] = counts[1] = 0;
    for (int64_t start = 0; start < n; start += 32768) {
        const int64_t stop = start + 32768 < n ? start + 32768 : n;
        uint16_t some = 0, within = 0; /* of a block, so that both are as wide as a number */
        for (int64_t i = start; i < stop; i++) {
            const uint16_t ray = each ? (x[i] == x[i]) & (y[i] == y[i]) : 1;
            const uint16_t is = ray & (depth[i] > least) & (depth[i] <= most);
            some += is, within += is & (depth[i] > near) & (depth[i] <= far);
        }
        counts[0] += some, counts[1] += within;
    }
}

DEPROJECT(deproject_whole, uint16_t)
DEPROJECT(deproject_single, float)

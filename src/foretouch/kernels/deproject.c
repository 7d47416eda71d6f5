/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"

/* Points (height, width, 3) of a depth image (height, width) whose unit is `scale` metres; NaN in all three where the depth is
 * not above 0, or not finite, or its pixel has no ray. x: of each column, y: of each row; or both of each pixel where `each`. */
#define DEPROJECT(name, type)                                                                                       \
    VECTORISED void name(const type *depth, int64_t height, int64_t width, double scale, const float *x,            \
                         const float *y, int64_t each, float *xyz) {                                                \
        const float metres = (float)scale;                                                                          \
        for (int64_t row = 0; row < height; row++) {                                                                \
            const type *line = depth + row * width;                                                                 \
            const float *across = each ? x + row * width : x;                                                       \
            float *point = xyz + 3 * row * width;                                                                   \
            for (int64_t column = 0; column < width; column++, point += 3) {                                        \
                const float z = (float)line[column] * metres;                                                       \
                const float a = across[column], b = each ? y[row * width + column] : y[row];                        \
                const int none = !(z > 0.0f && z < INFINITY && a == a && b == b);                                   \
                point[0] = none ? NAN : a * z;                                                                      \
                point[1] = none ? NAN : b * z;                                                                      \
                point[2] = none ? NAN : z;                                                                          \
            }                                                                                                       \
        }                                                                                                           \
    }

DEPROJECT(deproject_whole, uint16_t)
DEPROJECT(deproject_single, float)

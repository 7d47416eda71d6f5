/* SPDX-License-Identifier: Apache-2.0 */
/* What cloud/segmentation/plane.py does point by point; sums are left to it. */
#include "kernels.h"

/* Number of points within `reach` of each of m planes; distances: (m, n) from each but for its offset (m). */
VECTORISED void count_near(const float *distances, const float *offsets, int64_t m, int64_t n, double reach, int64_t *counts) {
    const float limit = (float)reach;
    for (int64_t i = 0; i < m; i++) {
        const float *distance = distances + i * n, offset = offsets[i];
        int32_t count = 0;
        for (int64_t j = 0; j < n; j++) {
            count += fabsf(distance[j] + offset) < limit;
        }
        counts[i] = count;
    }
}

/* The points (n, 3) within `reach` of a plane, of which `along` (n) are the distances but for its offset; count: (1). */
void points_near(const double *points, const double *along, int64_t n, double offset, double reach, double *near,
                 int64_t *count) {
    int64_t found = 0;
    for (int64_t i = 0; i < n; i++) {
        near[3 * found] = points[3 * i];
        near[3 * found + 1] = points[3 * i + 1];
        near[3 * found + 2] = points[3 * i + 2];
        found += fabs(along[i] + offset) < reach;
    }
    count[0] = found;
}

/* Residuals of the points within `reach` of a plane, divided by the squares of their depths.
 *
 * depth_m: depth of the origin of the points. scaled: (n). counts: within reach, and within three times. */
void residuals_near(const double *points, const double *along, int64_t n, double offset, double reach, double depth_m,
                    double *scaled, int64_t *counts) {
    int64_t found = 0, wide = 0;
    for (int64_t i = 0; i < n; i++) {
        const double residual = along[i] + offset, depth = points[3 * i + 2] + depth_m, square = depth * depth;
        scaled[found] = residual / (square > 1e-4 ? square : 1e-4);
        found += fabs(residual) < reach;
        wide += fabs(residual) < 3.0 * reach;
    }
    counts[0] = found;
    counts[1] = wide;
}

/* SPDX-License-Identifier: Apache-2.0 */
/* Measures of all points of a cloud, for cloud/geometry. */
#include "kernels.h"

/* Mean (3) of points (n, 3), n > 0, summed in their order; columns (3, n) from it; mean products (3, 3) of two columns. */
VECTORISED void centre_points(const double *points, int64_t n, double *centre, double *columns, double *products) {
    double sums[6] = {0.0};
    double *x = columns, *y = columns + n, *z = columns + 2 * n;
    for (int64_t i = 0; i < n; i++) {
        sums[0] += points[3 * i], sums[1] += points[3 * i + 1], sums[2] += points[3 * i + 2];
    }
    for (int axis = 0; axis < 3; axis++) {
        centre[axis] = sums[axis] / (double)n;
    }
    memset(sums, 0, sizeof sums);
    for (int64_t i = 0; i < n; i++) {
        x[i] = points[3 * i] - centre[0], y[i] = points[3 * i + 1] - centre[1], z[i] = points[3 * i + 2] - centre[2];
    }
    for (int64_t i = 0; i < n; i++) {
        sums[0] += x[i] * x[i], sums[1] += x[i] * y[i], sums[2] += x[i] * z[i];
        sums[3] += y[i] * y[i], sums[4] += y[i] * z[i], sums[5] += z[i] * z[i];
    }
    for (int k = 0, row = 0; row < 3; row++) {
        for (int column = row; column < 3; column++, k++) {
            products[3 * row + column] = products[3 * column + row] = sums[k] / (double)n;
        }
    }
}

/* Smallest and largest coordinates (3) of the points (n, 3) that are finite; infinite the wrong way round without one. */
VECTORISED void bounds(const float *points, int64_t n, double *low, double *high) {
    float least[3] = {INFINITY, INFINITY, INFINITY}, most[3] = {-INFINITY, -INFINITY, -INFINITY};
    for (int64_t i = 0; i < n; i++) {
        const float x = points[3 * i], y = points[3 * i + 1], z = points[3 * i + 2];
        const int finite = (x - x) + (y - y) + (z - z) == 0.0f;
        least[0] = finite & (x < least[0]) ? x : least[0], most[0] = finite & (x > most[0]) ? x : most[0];
        least[1] = finite & (y < least[1]) ? y : least[1], most[1] = finite & (y > most[1]) ? y : most[1];
        least[2] = finite & (z < least[2]) ? z : least[2], most[2] = finite & (z > most[2]) ? z : most[2];
    }
    for (int axis = 0; axis < 3; axis++) {
        low[axis] = least[axis], high[axis] = most[axis];
    }
}

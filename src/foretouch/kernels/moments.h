/* SPDX-License-Identifier: Apache-2.0 */
#ifndef FORETOUCH_MOMENTS_H
#define FORETOUCH_MOMENTS_H

#include "kernels.h"

#define MOMENTS 10 /* 1, x, y, z, xx, xy, xz, yy, yz, zz */
#define PADDED 12  /* room for them in three double4 */

/* Moments (PADDED) of a point, its coordinates from `origin`. */
INLINE void moments_of(const float *point, const float *origin, double *m) {
    m[0] = 1.0;
    for (int axis = 0; axis < 3; axis++) {
        m[1 + axis] = (double)point[axis] - (double)origin[axis];
    }
    m[4] = m[1] * m[1], m[5] = m[1] * m[2], m[6] = m[1] * m[3];
    m[7] = m[2] * m[2], m[8] = m[2] * m[3], m[9] = m[3] * m[3];
    m[10] = m[11] = 0.0;
}

INLINE void add_moments(double4 *sum, const double *other, double weight) {
    const double4u *m = (const double4u *)other;
    sum[0] += weight * m[0];
    sum[1] += weight * m[1];
    sum[2] += weight * m[2];
}

/* The covariance xx, xy, xz, yy, yz, zz of summed moments; zero without points. */
INLINE void covariance_of(const double *sum, double *covariance) {
    const double n = sum[0] > 1.0 ? sum[0] : 1.0, x = sum[1] / n, y = sum[2] / n, z = sum[3] / n;
    covariance[0] = sum[4] / n - x * x, covariance[1] = sum[5] / n - x * y, covariance[2] = sum[6] / n - x * z;
    covariance[3] = sum[7] / n - y * y, covariance[4] = sum[8] / n - y * z, covariance[5] = sum[9] / n - z * z;
}

#endif

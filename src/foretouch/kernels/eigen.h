/* SPDX-License-Identifier: Apache-2.0 */
#ifndef FORETOUCH_EIGEN_H
#define FORETOUCH_EIGEN_H

#include "kernels.h"

/* Eigenvalues of the symmetric matrix xx, xy, xz, yy, yz, zz, ascending, and the unit vector of the smallest, by Jacobi's
 * rotations: as accurate as LAPACK, also where two values are nearly equal, which a closed form is not. */
INLINE void eigen3(const double *matrix, double *values, double *minor) {
    double a[3][3] = {{matrix[0], matrix[1], matrix[2]}, {matrix[1], matrix[3], matrix[4]}, {matrix[2], matrix[4], matrix[5]}};
    double v[3][3] = {{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}};
    for (int sweep = 0; sweep < 20; sweep++) {
        const double off = a[0][1] * a[0][1] + a[0][2] * a[0][2] + a[1][2] * a[1][2];
        const double size = a[0][0] * a[0][0] + a[1][1] * a[1][1] + a[2][2] * a[2][2];
        if (!(off > 1e-34 * size)) {
            break;
        }
        for (int p = 0; p < 2; p++) {
            for (int q = p + 1; q < 3; q++) {
                if (a[p][q] == 0.0) {
                    continue;
                }
                const int r = 3 - p - q;
                const double theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
                const double t = (theta < 0.0 ? -1.0 : 1.0) / (fabs(theta) + sqrt(theta * theta + 1.0));
                const double c = 1.0 / sqrt(t * t + 1.0), s = t * c;
                a[p][p] -= t * a[p][q];
                a[q][q] += t * a[p][q];
                a[p][q] = a[q][p] = 0.0;
                const double rp = a[r][p], rq = a[r][q];
                a[r][p] = a[p][r] = c * rp - s * rq;
                a[r][q] = a[q][r] = s * rp + c * rq;
                for (int i = 0; i < 3; i++) {
                    const double vp = v[i][p], vq = v[i][q];
                    v[i][p] = c * vp - s * vq;
                    v[i][q] = s * vp + c * vq;
                }
            }
        }
    }
    int order[3] = {0, 1, 2};
    for (int i = 0; i < 2; i++) {
        for (int j = 0; j < 2 - i; j++) {
            if (a[order[j + 1]][order[j + 1]] < a[order[j]][order[j]]) {
                const int other = order[j];
                order[j] = order[j + 1];
                order[j + 1] = other;
            }
        }
    }
    for (int i = 0; i < 3; i++) {
        values[i] = a[order[i]][order[i]];
        minor[i] = v[i][order[0]];
    }
}

#endif

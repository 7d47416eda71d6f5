/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"

#define LANES 16

/* Squared distances (count) of targets (count, 3) from the nearest of n points (3, n); infinite without points. */
VECTORISED void nearest_squares(const float *targets, int64_t count, const float *points, int64_t n, float *squares) {
    const float *x = points, *y = points + n, *z = points + 2 * n;
    const int64_t whole = n - n % LANES;
    for (int64_t i = 0; i < count; i++) {
        const float tx = targets[3 * i], ty = targets[3 * i + 1], tz = targets[3 * i + 2];
        float least[LANES];
        for (int l = 0; l < LANES; l++) {
            least[l] = INFINITY;
        }
        for (int64_t k = 0; k < whole; k += LANES) {
            for (int l = 0; l < LANES; l++) {
                const float dx = x[k + l] - tx, dy = y[k + l] - ty, dz = z[k + l] - tz;
                const float square = dx * dx + dy * dy + dz * dz;
                least[l] = square < least[l] ? square : least[l];
            }
        }
        float found = INFINITY;
        for (int64_t k = whole; k < n; k++) {
            const float dx = x[k] - tx, dy = y[k] - ty, dz = z[k] - tz;
            const float square = dx * dx + dy * dy + dz * dz;
            found = square < found ? square : found;
        }
        for (int l = 0; l < LANES; l++) {
            found = least[l] < found ? least[l] : found;
        }
        squares[i] = found;
    }
}

/* SPDX-License-Identifier: Apache-2.0 */
/* How far a hand can go on before it meets something, for grasp/hand.py. All lengths are in metres. */
#include "kernels.h"

#define FAR_M 10.0f /* where nothing is met */

/* How far a hand can go on along each of `n_tilts` angles (tilts) about a line before it meets one of n points (n, 3) [along the line, beside it, up], the
 * first `own` of which are the object's.
 *
 * fronts (2, cells, cells): how far the hand reaches along z over x and y, opened, which counts for the object, and closing, for the others; the border is empty.
 * sizes: cells in a metre, half and a quarter of the object's width, half of what counts across the fingers, the free depths beside the middle half of the
 * line and over it. clear (2, n_tilts): with the thumb at the line's end and at its beginning. behind (n_tilts): how far the object reaches towards the palm. */
VECTORISED void hand_clearance(const double *points, int64_t n, int64_t own, const double *tilts, int64_t n_tilts, const float *fronts, int64_t cells,
                               const double *sizes, double *clear, double *behind) {
    const float per_cell = (float)sizes[0], half = (float)sizes[1], quarter = (float)sizes[2], across = (float)sizes[3];
    const float free_m[2] = {(float)sizes[4], (float)sizes[5]}, middle = (float)cells / 2.0f, last = (float)cells - 0.5f;
    for (int64_t k = 0; k < n_tilts; k++) {
        const float c = (float)cos(tilts[k]), s = (float)sin(tilts[k]);
        float least[2] = {FAR_M, FAR_M}, deepest = 0.0f;
        for (int64_t i = 0; i < n; i++) {
            const float x = (float)points[3 * i], beside = (float)points[3 * i + 1], up = (float)points[3 * i + 2];
            const float z = -s * beside - c * up, y = s * up - c * beside;
            const float row = x * per_cell + middle, column = y * per_cell + middle;
            const float *front = fronts + (i < own ? 0 : cells * cells);
            const int64_t at = (int64_t)(row < 0.5f ? 0.5f : row > last ? last : row) * cells + (int64_t)(column < 0.5f ? 0.5f : column > last ? last : column);
            const int between = i < own && fabsf(x) <= half && fabsf(y) <= across;
            const float left = between ? z + free_m[fabsf(x) <= quarter] : FAR_M;
            const float there = z - front[at], turned = z - front[cells * cells - 1 - at]; /* by half a turn about z */
            least[0] = there < least[0] ? there : least[0], least[1] = turned < least[1] ? turned : least[1];
            least[0] = left < least[0] ? left : least[0], least[1] = left < least[1] ? left : least[1];
            deepest = between && -z > deepest ? -z : deepest;
        }
        clear[k] = (double)least[0], clear[n_tilts + k] = (double)least[1], behind[k] = (double)deepest;
    }
}

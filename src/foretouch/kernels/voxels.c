/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"

#define FREE_CELLS 65536 /* of a table in any case, and beyond it eight for each point */

/* The occupied cells of a grid anchored at the origin, x fastest, then y, z, and the cell of each of n points (n, 3).
 *
 * cell: (n). counts: (n), points of each cell. found: (1), their number; -1 for a grid too wide for a table, without memory
 * or with a coordinate that is not finite. */
VECTORISED void voxel_cells(const float *xyz, int64_t n, double cells_per_m, int64_t *cell, int64_t *counts, int64_t *found) {
    const float per_m = (float)cells_per_m;
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    double size[3], total = 1.0;
    found[0] = -1;
    for (int64_t i = 0; i < n; i++) {
        for (int axis = 0; axis < 3; axis++) {
            const float at = floorf(xyz[3 * i + axis] * per_m);
            if (!((at - at) == 0.0f)) {
                return;
            }
            low[axis] = at < low[axis] ? at : low[axis];
            high[axis] = at > high[axis] ? at : high[axis];
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        size[axis] = (double)high[axis] - (double)low[axis] + 1.0;
        total *= size[axis];
    }
    if (n < 1 || !(total <= (double)FREE_CELLS + 8.0 * (double)n)) {
        return;
    }
    const int64_t cells = (int64_t)total, wide = (int64_t)size[0], tall = (int64_t)size[1];
    int64_t *number = calloc((size_t)cells, sizeof(int64_t)), last = 0;
    if (!number) {
        return;
    }
    for (int64_t i = 0; i < n; i++) {
        int64_t at[3];
        for (int axis = 0; axis < 3; axis++) {
            at[axis] = (int64_t)((double)floorf(xyz[3 * i + axis] * per_m) - (double)low[axis]);
        }
        cell[i] = at[0] + wide * (at[1] + tall * at[2]);
        number[cell[i]]++;
    }
    for (int64_t key = 0; key < cells; key++) {
        if (number[key]) {
            counts[last] = number[key];
            number[key] = last++;
        }
    }
    for (int64_t i = 0; i < n; i++) {
        cell[i] = number[cell[i]];
    }
    free(number);
    found[0] = last;
}

/* Mean of `columns` values (n, columns) over the points of each of m cells, summed in the order of the points. */
void cell_means(const double *values, int64_t n, int64_t columns, const int64_t *cell, const int64_t *counts, int64_t m,
                double *means) {
    memset(means, 0, (size_t)(m * columns) * sizeof(double));
    for (int64_t i = 0; i < n; i++) {
        double *sum = means + cell[i] * columns;
        for (int64_t j = 0; j < columns; j++) {
            sum[j] += values[i * columns + j];
        }
    }
    for (int64_t i = 0; i < m; i++) {
        for (int64_t j = 0; j < columns; j++) {
            means[i * columns + j] /= (double)counts[i];
        }
    }
}

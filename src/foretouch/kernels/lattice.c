/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"

/* Column and row of the points (n, 3) on a lattice of rays. A point whose position is farther than `tolerance` from a whole number,
 * or whose |x / z| or |y / z| is above `tangent`, ends the search. Points out of the range from low to high, or not finite, are no
 * part of it: -1.
 * cells: (n, 2), column and row; result: (6) how many are part of it or -1, the smallest and largest column and row. */
VECTORISED void ray_cells(const float *xyz, int64_t n, const Lattice *lattice, int32_t *cells, int64_t *result) {
    const float near = (float)lattice->low, far = (float)lattice->high, widest = (float)lattice->tangent;
    const double *fit = lattice->fit, tolerance = lattice->tolerance;
    int64_t count = 0, first[2] = {INT64_MAX, INT64_MAX}, last[2] = {INT64_MIN, INT64_MIN};
    result[0] = -1;
    for (int64_t i = 0; i < n; i++, xyz += 3, cells += 2) {
        const float z = xyz[2];
        cells[0] = cells[1] = -1;
        if (!(z >= near && z <= far) || !isfinite(xyz[0]) || !isfinite(xyz[1])) continue;
        if (!(fabsf(xyz[0]) <= z * widest && fabsf(xyz[1]) <= z * widest)) return;
        count++;
        const double inverse = 1.0 / (double)z;
        for (int axis = 0; axis < 2; axis++) {
            const double at = ((double)xyz[axis] * inverse - fit[3 * axis]) * fit[3 * axis + 1] + fit[3 * axis + 2];
            const double nearest = rint(at);
            if (!(fabs(at - nearest) <= tolerance && fabs(nearest) <= 1e5)) return;
            const int64_t cell = (int64_t)nearest;
            cells[axis] = (int32_t)cell;
            if (cell < first[axis]) first[axis] = cell;
            if (cell > last[axis]) last[axis] = cell;
        }
    }
    result[0] = count;
    for (int axis = 0; axis < 2; axis++) {
        result[1 + 2 * axis] = first[axis];
        result[2 + 2 * axis] = last[axis];
    }
}

/* Put those points of a list (n, 3) that `ray_cells` gave a cell into the image of them (height, width, 3), NaN elsewhere, and
 * their number in the list into `place` (height, width), -1 elsewhere. result: (2) how many have a right neighbour, and whether
 * two points share a pixel. */
VECTORISED void fill_image(const float *xyz, int64_t n, const Lattice *lattice, const int32_t *cells, const Window *window, float *image,
                int32_t *place, int64_t *result) {
    const float near = (float)lattice->low, far = (float)lattice->high;
    const int64_t column = window->column, row = window->row, height = window->height, width = window->width;
    for (int64_t k = 0; k < height * width; k++) place[k] = -1;
    for (int64_t k = 0; k < 3 * height * width; k++) image[k] = NAN;
    result[0] = result[1] = 0;
    for (int64_t i = 0; i < n; i++) {
        const float *point = xyz + 3 * i;
        if (!(point[2] >= near && point[2] <= far) || !isfinite(point[0]) || !isfinite(point[1])) continue;
        const int64_t k = (cells[2 * i + 1] - row) * width + cells[2 * i] - column;
        if (place[k] >= 0) {
            result[1] = 1;
            return;
        }
        place[k] = (int32_t)i;
        memcpy(image + 3 * k, point, 3 * sizeof *point);
    }
    for (int64_t k = 1; k < height * width; k++) result[0] += place[k] >= 0 && place[k - 1] >= 0;
}

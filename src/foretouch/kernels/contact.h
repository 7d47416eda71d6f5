/* SPDX-License-Identifier: Apache-2.0 */
/* The loops of contact.c that are compiled for several instruction sets: included once for each, with its own NAME.
 * (The compiler splits vectors before it clones functions, so that VECTORISED would not widen them.) */

/* Add the points to the sums, each with weight 1 - (distance / radius)^2. */
static void NAME(add_near)(
    Patch *patch, const double *sorted, int64_t n, const double *squares
) {
    for (int64_t k = patch->size; k < patch->size + LANES; k++) { /* no weight */
        patch->index[k] = 0;
        patch->square[k] = INFINITY;
    }
    double columns[4][NEAR + LANES];
    const int64_t groups = (patch->size + LANES - 1) / LANES;
    for (int64_t i = 0; i < LANES * groups; i++) {
        for (int k = 0; k < 3; k++) {
            columns[k][i] = sorted[k * n + patch->index[i]];
        }
        columns[3][i] = patch->square[i];
    }
    for (int r = 0; r < RADII; r++) {
        const double per_square = 1.0 / squares[r];
        for (int half = 0; half < LANES; half += 4) { /* of the lanes, which are two vectors of AVX2 */
            double4 sums[SUMS];
            int64x4 counts = LOAD(int64x4u, patch->counts[r] + half);
            for (int k = 0; k < SUMS; k++) {
                sums[k] = LOAD(double4u, patch->sums[r][k] + half);
            }
            for (int64_t i = half; i < LANES * groups; i += LANES) {
                const double4 x = LOAD(double4u, columns[0] + i), y = LOAD(double4u, columns[1] + i);
                const double4 z = LOAD(double4u, columns[2] + i);
                const double4 left = 1.0 - LOAD(double4u, columns[3] + i) * per_square;
                const int64x4 inside = left > 0.0;
                const double4 w = (double4)((int64x4)left & inside);
                const double4 wx = w * x, wy = w * y, wz = w * z;
                sums[0] += w;
                sums[1] += wx;
                sums[2] += wy;
                sums[3] += wz;
                sums[4] += wx * x;
                sums[5] += wx * y;
                sums[6] += wx * z;
                sums[7] += wy * y;
                sums[8] += wy * z;
                sums[9] += wz * z;
                counts += inside;
            }
            memcpy(patch->counts[r] + half, &counts, sizeof counts);
            for (int k = 0; k < SUMS; k++) {
                memcpy(patch->sums[r][k] + half, &sums[k], sizeof sums[k]);
            }
        }
    }
    patch->size = 0;
}

/* Collect the points of sorted from i to stop that are within the last radius. */
static void NAME(collect)(
    Patch *patch, const double *sorted, int64_t n, const double *squares, const double *contact, int64_t i, int64_t stop
) {
    const double *x = sorted, *y = sorted + n, *z = sorted + 2 * n;
    double found[NEAR];
    while (i < stop) {
        const int64_t size = stop - i < NEAR - patch->size ? stop - i : NEAR - patch->size;
        for (int64_t k = 0; k < size; k++) {
            const double dx = x[i + k] - contact[0], dy = y[i + k] - contact[1], dz = z[i + k] - contact[2];
            found[k] = dx * dx + dy * dy + dz * dz;
        }
        for (int64_t k = 0; k < size; k++) {
            patch->index[patch->size] = (int32_t)(i + k);
            patch->square[patch->size] = found[k];
            patch->size += found[k] < squares[RADII - 1];
        }
        i += size;
        if (patch->size == NEAR) {
            NAME(add_near)(patch, sorted, n, squares);
        }
    }
}

static void NAME(describe)(
    const Cells *points, const double *squares, const double *contacts, const double *frames, int64_t count, double *rows
) {
    const double *sorted = points->sorted, *grid = points->grid, reach = sqrt(squares[RADII - 1]);
    const int64_t n = points->n, *cells = points->cells;
    const int32_t *starts = points->starts;
    for (int64_t k = 0; k < count; k++) {
        const double *contact = contacts + 3 * k, *frame = frames + 9 * k;
        double *row = rows + FEATURES * k;
        Patch patch;
        memset(patch.sums, 0, sizeof patch.sums);
        memset(patch.counts, 0, sizeof patch.counts);
        patch.size = 0;
        int64_t from[3], to[3];
        for (int j = 0; j < 3; j++) {
            from[j] = cell_of(contact[j] - reach, grid[j], grid[3], cells[j]);
            to[j] = cell_of(contact[j] + reach, grid[j], grid[3], cells[j]);
        }
        for (int64_t z = from[2]; z <= to[2]; z++) {
            const double dz = beside(contact[2], grid[2], grid[3], z);
            for (int64_t y = from[1]; y <= to[1]; y++) {
                const double dy = beside(contact[1], grid[1], grid[3], y);
                const double left = squares[RADII - 1] - (dy * dy + dz * dz);
                if (!(left > 0.0)) {
                    continue;
                }
                const int64_t run = (z * cells[1] + y) * cells[0];
                const int64_t first = run + cell_of(contact[0] - sqrt(left), grid[0], grid[3], cells[0]);
                const int64_t last = run + cell_of(contact[0] + sqrt(left), grid[0], grid[3], cells[0]);
                NAME(collect)(&patch, sorted, n, squares, contact, starts[first], starts[last + 1]);
            }
        }
        NAME(add_near)(&patch, sorted, n, squares);
        int rounding = 0;
        for (int r = 0; r < RADII; r++) {
            double mean[3], covariance[6], values[3], axis[3], found;
            const double total = moments(&patch, r, (double)n, mean, covariance, &found);
            eigen3(covariance, values, axis);
            const double size_of_terms = mean[0] * mean[0] + mean[1] * mean[1] + mean[2] * mean[2] + values[2];
            rounding |= (r == 0 ? total > 0.0 : found >= FEWEST) && !(values[0] > FLAT * size_of_terms);
            const double thin = sqrt(values[0] > 0.0 ? values[0] : 0.0), wide = sqrt(values[1] > 0.0 ? values[1] : 0.0);
            if (r == 0) {
                double away[3];
                for (int j = 0; j < 3; j++) {
                    away[j] = total > 0.0 ? mean[j] - contact[j] : 0.0;
                }
                row[0] = total;
                row[1] = thin;
                into(frame, away, row + 2);
                continue;
            }
            double normal[3], *slope = row + 5 + 3 * (r - 1);
            into(frame, axis, normal);
            const double flat = 1.0 - thin / (wide > NOTHING ? wide : NOTHING), size = flat * fabs(normal[2]);
            for (int j = 0; j < 3; j++) {
                slope[j] = found < FEWEST ? 0.0 : size * normal[j] * (normal[2] > 0.0 ? -1.0 : 1.0);
            }
        }
        if (rounding) {
            row[0] = NAN;
        }
    }
}

/* See city_distances. */
static void NAME(city)(
    const double *rows, int64_t count, int64_t columns, const double *packed, int64_t size, double *distances
) {
    const int64x4 magnitude = ~(int64x4)(-(double4){0.0});
    for (int64_t start = 0; start < size; start += KNOWN) {
        const double *group = packed + start * columns; /* stays in the cache for all rows */
        const int64_t left = size - start < KNOWN ? size - start : KNOWN;
        for (int64_t i = 0; i < count; i++) {
            const double *row = rows + i * columns;
            double4 sum[KNOWN / 4] = {{0.0}};
            for (int64_t j = 0; j < columns; j++) {
                const double *known = group + KNOWN * j;
#pragma GCC unroll 8
                for (int k = 0; k < KNOWN / 4; k++) {
                    sum[k] += (double4)((int64x4)(row[j] - LOAD(double4u, known + 4 * k)) & magnitude);
                }
            }
            memcpy(distances + i * size + start, sum, left * sizeof *distances);
        }
    }
}

/* See weighted_sums. */
static void NAME(weigh)(
    const double *weights, int64_t count, int64_t size, const double *packed, int64_t outputs, double *sums
) {
    for (int64_t i = 0; i < count; i++) {
        const double *weight = weights + i * size, *value = packed;
        for (int64_t start = 0; start < outputs; start += OUTPUTS) {
            double4 sum[OUTPUTS / 4] = {{0.0}};
            for (int64_t k = 0; k < size; k++, value += OUTPUTS) {
#pragma GCC unroll 14
                for (int l = 0; l < OUTPUTS / 4; l++) {
                    sum[l] += weight[k] * LOAD(double4u, value + 4 * l);
                }
            }
            const int64_t left = outputs - start < OUTPUTS ? outputs - start : OUTPUTS;
            memcpy(sums + i * outputs + start, sum, left * sizeof *sums);
        }
    }
}

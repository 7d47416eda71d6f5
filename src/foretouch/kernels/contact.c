/* SPDX-License-Identifier: Apache-2.0 */
#include "eigen.h"
#include "kernels.h"

#define RADII 4     /* of the pad and of the patches, the largest last */
#define SUMS 10     /* 1, x, y, z, xx, xy, xz, yy, yz, zz */
#define FEATURES 14 /* share, roughness, mean of the pad (3), slopes of the patches (3 x 3) */
#define NEAR 1024   /* points summed at once */
#define LANES 8     /* sums of every eighth point, which are added at the end */
#define KNOWN 32   /* known rows that a row is compared with at once */
#define OUTPUTS 56 /* values summed at once: as many as a touch has, in whole vectors */
#define FEWEST 4       /* points that determine a slope */
#define NOTHING 1e-12  /* a smaller share of the points, or a smaller spread [m], is none */
#define FLAT 2e-12     /* a smaller variance across a patch, over the terms that it is a difference of, is rounding */

/* Index of the cell of a coordinate, which may be any number. */
static inline int64_t cell_of(double x, double low, double per_m, int64_t cells) {
    const double at = (x - low) * per_m, last = (double)(cells - 1);
    return (int32_t)(at > last ? last : at > 0.0 ? at : 0.0);
}

/* Cells of points (n, 3) in a grid; see sort_into_cells. */
VECTORISED static void find_cells(const double *xyz, int64_t n, const double *grid, const int64_t *cells, int32_t *cell) {
    const double low[3] = {grid[0], grid[1], grid[2]}, per_m = grid[3];
    const double last[3] = {(double)(cells[0] - 1), (double)(cells[1] - 1), (double)(cells[2] - 1)};
    const int32_t columns = (int32_t)cells[0], rows = (int32_t)cells[1];
    for (int64_t i = 0; i < n; i++) {
        int32_t at[3];
        for (int k = 0; k < 3; k++) {
            const double x = (xyz[3 * i + k] - low[k]) * per_m;
            at[k] = (int32_t)(x > last[k] ? last[k] : x > 0.0 ? x : 0.0);
        }
        cell[i] = (at[2] * rows + at[1]) * columns + at[0];
    }
}

/* Points (n, 3) as columns (3, n), sorted by the cells of a grid of cells[0] x cells[1] x cells[2], x fastest; those of
 * a cell keep their order and begin at starts (one more than cells). grid: low x, y, z, cells per metre. */
void sort_into_cells(
    const double *xyz, int64_t n, const double *grid, const int64_t *cells, int32_t *cell, int32_t *starts, double *sorted
) {
    const int64_t count = cells[0] * cells[1] * cells[2];
    memset(starts, 0, (count + 1) * sizeof *starts);
    find_cells(xyz, n, grid, cells, cell);
    for (int64_t i = 0; i < n; i++) {
        starts[cell[i] + 1]++;
    }
    for (int64_t k = 0; k < count; k++) {
        starts[k + 1] += starts[k];
    }
    for (int64_t i = 0; i < n; i++) {
        const int64_t at = starts[cell[i]]++;
        sorted[at] = xyz[3 * i];
        sorted[n + at] = xyz[3 * i + 1];
        sorted[2 * n + at] = xyz[3 * i + 2];
    }
    for (int64_t k = count; k > 0; k--) { /* each start was moved to the next one */
        starts[k] = starts[k - 1];
    }
    starts[0] = 0;
}

#define LOAD(type, from) (*(const type *)(from))

/* Sums around one contact, and points within the last radius that wait to be added. */
typedef struct {
    double sums[RADII][SUMS][LANES];
    int64_t counts[RADII][LANES]; /* minus the number of points */
    double square[NEAR + LANES];
    int32_t index[NEAR + LANES]; /* in sorted */
    int64_t size;
} Patch;

/* Distance of a coordinate from a cell along one axis; 0 within it. */
static double beside(double x, double low, double per_m, int64_t cell) {
    const double at = (x - low) * per_m, gap = at < (double)cell ? (double)cell - at : at - (double)(cell + 1);
    return gap > 0.0 ? gap / per_m : 0.0;
}

/* Mean and moments of the sums of one radius. Gives the total and the number of points. */
static double moments(const Patch *patch, int r, double n, double mean[3], double covariance[6], double *count) {
    double scaled[SUMS], total;
    for (int k = 0; k < SUMS; k++) {
        const double *lane = patch->sums[r][k];
        scaled[k] = (((lane[0] + lane[1]) + (lane[2] + lane[3])) + ((lane[4] + lane[5]) + (lane[6] + lane[7]))) / n;
    }
    const int64_t *lane = patch->counts[r];
    *count = -(double)(lane[0] + lane[1] + lane[2] + lane[3] + lane[4] + lane[5] + lane[6] + lane[7]);
    total = scaled[0];
    const double divisor = total > NOTHING ? total : NOTHING;
    for (int k = 1; k < SUMS; k++) {
        scaled[k] /= divisor;
    }
    memcpy(mean, scaled + 1, 3 * sizeof *mean);
    const double *second = scaled + 4;
    for (int i = 0; i < 3; i++) {
        for (int j = i; j < 3; j++) {
            *covariance++ = *second++ - mean[i] * mean[j];
        }
    }
    return total;
}

static void into(const double *frame, const double *vector, double *turned) {
    for (int j = 0; j < 3; j++) {
        turned[j] = frame[j] * vector[0] + frame[3 + j] * vector[1] + frame[6 + j] * vector[2];
    }
}

#if defined(__x86_64__) && defined(__gnu_linux__) && defined(__GNUC__) && !defined(__clang__)
#define SETS 1
#pragma GCC push_options
#pragma GCC target("avx2")
#define NAME(function) function##_avx2
#include "contact.h"
#undef NAME
#pragma GCC pop_options
#pragma GCC push_options
#pragma GCC target("avx512f")
#define NAME(function) function##_avx512
#include "contact.h"
#undef NAME
#pragma GCC pop_options
#endif
#define NAME(function) function##_any
#include "contact.h"

/* Call a function of contact.h as it was compiled for this machine. */
#ifdef SETS
#define CALL(function, ...) \
    (__builtin_cpu_supports("avx512f") ? function##_avx512(__VA_ARGS__) \
     : __builtin_cpu_supports("avx2")  ? function##_avx2(__VA_ARGS__) \
                                       : function##_any(__VA_ARGS__))
#else
#define CALL(function, ...) function##_any(__VA_ARGS__)
#endif

/* Rows (k, 14) of contacts (k, 3) in the frames (k, 3, 3) of their fingers, whose axes are columns. squares: of the
 * radii [m^2], the pad's first and the largest last. A row begins with NaN where a patch is so flat that rounding
 * decides. */
void describe_contacts(
    const Cells *points, const double *squares, const double *contacts, const double *frames, int64_t count, double *rows
) {
    CALL(describe, points, squares, contacts, frames, count, rows);
}

/* Sums of the absolute differences (count, size) of rows (count, columns) from size known ones: over the columns in
 * their order, as SciPy adds them. packed: (size / 32, rounded up, columns, 32), the known rows in groups. */
void city_distances(
    const double *rows, int64_t count, int64_t columns, const double *packed, int64_t size, double *distances
) {
    CALL(city, rows, count, columns, packed, size, distances);
}

/* Products (count, outputs) of weights (count, size) with values (size, outputs): over size in its order. packed:
 * (outputs / 56, rounded up, size, 56), the values in groups. */
void weighted_sums(
    const double *weights, int64_t count, int64_t size, const double *packed, int64_t outputs, double *sums
) {
    CALL(weigh, weights, count, size, packed, outputs, sums);
}

/* Pixels (n, 2) of points (n, 3) of a camera whose pixels are `pitch` wide, as tangents; NaN of those behind it. */
VECTORISED static void find_pixels(const double *points, int64_t n, double pitch, double *pixels) {
    for (int64_t i = 0; i < n; i++) {
        const double z = points[3 * i + 2] > 0.0 ? points[3 * i + 2] : NAN;
        pixels[2 * i] = floor(points[3 * i] / z / pitch);
        pixels[2 * i + 1] = floor(points[3 * i + 1] / z / pitch);
    }
}

/* Which of m places are more than `behind` behind one of n points for a camera whose pixels are `pitch` wide, as tangents.
 *
 * Nothing is hidden in an image of more than `most` pixels. hidden: (m). found: (1), -1 without memory. */
void hide_places(const double *points, int64_t n, const double *places, int64_t m, double pitch, double behind, int64_t most,
                 uint8_t *hidden, int64_t *found) {
    double *pixels = malloc((size_t)(2 * (n > m ? n : m) + 1) * sizeof(double)), *nearest;
    double low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    memset(hidden, 0, (size_t)m);
    found[0] = pixels ? 0 : -1;
    if (!pixels) {
        return;
    }
    find_pixels(points, n, pitch, pixels);
    for (int64_t i = 0; i < 2 * n; i++) {
        low[i % 2] = pixels[i] < low[i % 2] ? pixels[i] : low[i % 2];
        high[i % 2] = pixels[i] > high[i % 2] ? pixels[i] : high[i % 2];
    }
    const double across = high[0] - low[0] + 1.0, down = high[1] - low[1] + 1.0;
    if (across > 0.0 && down > 0.0 && across * down <= (double)most) { /* false without a point in front of the camera */
        nearest = malloc((size_t)(across * down) * sizeof(double));
        found[0] = nearest ? 0 : -1;
        for (int64_t i = 0; nearest && i < (int64_t)(across * down); i++) {
            nearest[i] = INFINITY;
        }
        for (int64_t i = 0; nearest && i < n; i++) {
            if (points[3 * i + 2] > 0.0) {
                double *at = nearest + (int64_t)((pixels[2 * i] - low[0]) * down + pixels[2 * i + 1] - low[1]);
                *at = points[3 * i + 2] < *at ? points[3 * i + 2] : *at;
            }
        }
        find_pixels(places, m, pitch, pixels);
        for (int64_t i = 0; nearest && i < m; i++) {
            const double u = pixels[2 * i] - low[0], v = pixels[2 * i + 1] - low[1];
            if (u >= 0.0 && u < across && v >= 0.0 && v < down) {
                hidden[i] = places[3 * i + 2] > nearest[(int64_t)(u * down + v)] + behind;
            }
        }
        free(nearest);
    }
    free(pixels);
}

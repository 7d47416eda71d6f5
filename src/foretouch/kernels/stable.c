/* SPDX-License-Identifier: Apache-2.0 */
/* Loops over the points of an object for grasp/stable.py. */
#include "eigen.h"

#define DIGIT 11 /* bits sorted at once */
#define DIGITS 2048
#define LANES 4

/* The order of n points (n, 3) by x, then y, then z; equal ones keep theirs. order: (n); its first is -1 without memory. */
void canonical_order(const float *xyz, int64_t n, int64_t *order) {
    uint32_t *keys = malloc((size_t)(n > 0 ? n : 1) * sizeof(uint32_t));
    int64_t *other = malloc((size_t)(n > 0 ? n : 1) * sizeof(int64_t)), *from = order, *to = other;
    if (!keys || !other || n < 1) {
        if (n > 0) {
            order[0] = -1;
        }
        free(keys);
        free(other);
        return;
    }
    for (int64_t i = 0; i < n; i++) {
        order[i] = i;
    }
    for (int axis = 2; axis >= 0; axis--) {
        int64_t starts[3][DIGITS] = {{0}};
        for (int64_t i = 0; i < n; i++) {
            const float value = xyz[3 * i + axis] + 0.0f; /* no negative zero */
            uint32_t bits;
            memcpy(&bits, &value, sizeof bits);
            keys[i] = bits & 0x80000000u ? ~bits : bits | 0x80000000u; /* in the order of the numbers */
            for (int digit = 0; digit < 3; digit++) {
                starts[digit][(keys[i] >> (digit * DIGIT)) % DIGITS]++;
            }
        }
        for (int digit = 0; digit < 3; digit++) {
            int64_t sum = 0;
            for (int i = 0; i < DIGITS; i++) {
                const int64_t count = starts[digit][i];
                starts[digit][i] = sum;
                sum += count;
            }
            for (int64_t i = 0; i < n; i++) {
                to[starts[digit][(keys[from[i]] >> (digit * DIGIT)) % DIGITS]++] = from[i];
            }
            int64_t *swap = from;
            from = to;
            to = swap;
        }
    }
    if (from != order) {
        memcpy(order, from, (size_t)n * sizeof(int64_t));
    }
    free(keys);
    free(other);
}

/* Weights of the points (n, 3) around an initial point, spread with tents over the nodes of a grid along `basis` (3, 3).
 *
 * The weight of a point falls smoothly from `inlier` to 0 between the distances near and far. sums: (most, 4), mass and
 * mass times x, y, z of each node that has any, in the order of the nodes. found: points of a weight, and nodes; the nodes
 * are -1 where they are more than `most`, span too wide a grid, or where there is no memory. */
VECTORISED void tent_sums(const double *xyz, const double *inlier, int64_t n, const double *initial, const double *basis,
                          double voxel, double near, double far, int64_t most, double *sums, int64_t *found) {
    double *at = malloc((size_t)(n > 0 ? n : 1) * 4 * sizeof(double));
    int64_t *index = malloc((size_t)(n > 0 ? n : 1) * sizeof(int64_t));
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, cells = 1.0;
    int64_t count = 0;
    found[0] = 0;
    found[1] = -1;
    for (int64_t i = 0; at && index && i < n; i++) {
        const double x = xyz[3 * i] - initial[0], y = xyz[3 * i + 1] - initial[1], z = xyz[3 * i + 2] - initial[2];
        const double squared = x * x + y * y + z * z;
        if (!(squared < far * far) || !(inlier[i] > 0.0)) {
            continue;
        }
        double t = (far - sqrt(squared)) / (far - near);
        t = t < 0.0 ? 0.0 : (t > 1.0 ? 1.0 : t);
        const double weight = inlier[i] * (t * t * (3.0 - 2.0 * t));
        if (!(weight > 0.0)) {
            continue;
        }
        double *one = at + 4 * count;
        for (int axis = 0; axis < 3; axis++) {
            one[axis] = (x * basis[3 * axis] + y * basis[3 * axis + 1] + z * basis[3 * axis + 2]) / voxel;
            const double cell = floor(one[axis]);
            low[axis] = cell < low[axis] ? cell : low[axis];
            high[axis] = cell > high[axis] ? cell : high[axis];
        }
        one[3] = weight;
        index[count++] = i;
    }
    found[0] = count;
    int64_t size[3] = {0, 0, 0};
    for (int axis = 0; axis < 3 && count; axis++) {
        const double extent = high[axis] - low[axis] + 2.0;
        cells *= extent;
        size[axis] = extent < 1e6 ? (int64_t)extent : 0;
    }
    double *table = count && cells <= 65536.0 ? calloc((size_t)cells * 4, sizeof(double)) : NULL;
    if (!table || !(cells >= 1.0)) {
        found[1] = at && index && !count ? 0 : -1;
        free(table);
        free(at);
        free(index);
        return;
    }
    for (int64_t i = 0; i < count; i++) {
        const double *one = at + 4 * i, *point = xyz + 3 * index[i];
        double part[3];
        int64_t cell[3];
        for (int axis = 0; axis < 3; axis++) {
            const double floored = floor(one[axis]);
            part[axis] = one[axis] - floored;
            cell[axis] = (int64_t)(floored - low[axis]);
        }
        for (int corner = 0; corner < 8; corner++) {
            const int a = corner >> 2, b = (corner >> 1) & 1, c = corner & 1;
            double share = (a ? part[0] : 1.0 - part[0]) * (b ? part[1] : 1.0 - part[1]);
            share = share * (c ? part[2] : 1.0 - part[2]) * one[3];
            double *sum = table + 4 * (((cell[0] + a) * size[1] + cell[1] + b) * size[2] + cell[2] + c);
            sum[0] += share;
            sum[1] += share * point[0];
            sum[2] += share * point[1];
            sum[3] += share * point[2];
        }
    }
    int64_t nodes = 0;
    for (int64_t i = 0; i < (int64_t)cells && nodes >= 0; i++) {
        if (table[4 * i] > 0.0) {
            if (nodes == most) {
                nodes = -2;
            } else {
                memcpy(sums + 4 * nodes, table + 4 * i, 4 * sizeof(double));
            }
            nodes++;
        }
    }
    found[1] = nodes;
    free(table);
    free(at);
    free(index);
}

INLINE double4 positive(double4 a) {
    typedef int64_t int4x64 __attribute__((vector_size(32)));
    const double4 none = {0.0};
    return (double4)((int4x64)a & (int4x64)(a > none));
}

/* Normals (m, 3) and curvature (m) of the surface around m places (m, 3) of the points (n, 3), which fade out towards a
 * radius. Both are NaN without memory. */
VECTORISED void local_planes(const double *xyz, const double *inlier, int64_t n, const double *places, int64_t m, double radius,
                             double *normals, double *curvature) {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, origin[3] = {0.0, 0.0, 0.0};
    const double per_square = 1.0 / (radius * radius);
    double *near = malloc((size_t)(n > 0 ? n + LANES : LANES) * 4 * sizeof(double));
    for (int64_t i = 0; i < m; i++) {
        for (int axis = 0; axis < 3; axis++) {
            const double value = places[3 * i + axis];
            low[axis] = value - radius < low[axis] ? value - radius : low[axis];
            high[axis] = value + radius > high[axis] ? value + radius : high[axis];
            origin[axis] += value / (double)m;
        }
        curvature[i] = normals[3 * i] = normals[3 * i + 1] = normals[3 * i + 2] = NAN;
    }
    if (!near) {
        return;
    }
    int64_t count = 0;
    for (int64_t i = 0; i < n; i++) { /* LANES x, y, z and weights after another */
        const double x = xyz[3 * i], y = xyz[3 * i + 1], z = xyz[3 * i + 2];
        const int inside = x >= low[0] && x <= high[0] && y >= low[1] && y <= high[1] && z >= low[2] && z <= high[2];
        if (inside && inlier[i] > 0.0) {
            double *block = near + count / LANES * 4 * LANES + count % LANES;
            block[0] = x - origin[0], block[LANES] = y - origin[1], block[2 * LANES] = z - origin[2];
            block[3 * LANES] = inlier[i];
            count++;
        }
    }
    for (; count % LANES; count++) {
        double *block = near + count / LANES * 4 * LANES + count % LANES;
        block[0] = block[LANES] = block[2 * LANES] = block[3 * LANES] = 0.0;
    }
    for (int64_t i = 0; i < m; i++) {
        const double px = places[3 * i] - origin[0], py = places[3 * i + 1] - origin[1], pz = places[3 * i + 2] - origin[2];
        double4 sum[10] = {{0.0}};
        for (int64_t j = 0; j < count; j += LANES) {
            const double4u *block = (const double4u *)(near + 4 * j);
            const double4 x = block[0] - px, y = block[1] - py, z = block[2] - pz; /* small: their products round less */
            const double4 share = 1.0 - (x * x + y * y + z * z) * per_square;
            const double4 weight = positive(share) * block[3];
            const double4 wx = weight * x, wy = weight * y, wz = weight * z;
            sum[0] += weight, sum[1] += wx, sum[2] += wy, sum[3] += wz;
            sum[4] += wx * x, sum[5] += wx * y, sum[6] += wx * z;
            sum[7] += wy * y, sum[8] += wy * z, sum[9] += wz * z;
        }
        double total[10], c[6], values[3];
        for (int j = 0; j < 10; j++) {
            total[j] = (sum[j][0] + sum[j][1]) + (sum[j][2] + sum[j][3]);
        }
        const double weight = total[0] > 1e-9 ? total[0] : 1e-9;
        const double x = total[1] / weight, y = total[2] / weight, z = total[3] / weight;
        c[0] = total[4] / weight - x * x, c[1] = total[5] / weight - x * y, c[2] = total[6] / weight - x * z;
        c[3] = total[7] / weight - y * y, c[4] = total[8] / weight - y * z, c[5] = total[9] / weight - z * z;
        eigen3(c, values, normals + 3 * i);
        const double all = values[0] + values[1] + values[2];
        curvature[i] = (values[0] > 0.0 ? values[0] : 0.0) / (all > 1e-15 ? all : 1e-15);
    }
    free(near);
}

/* Mean (3) of the points (n, 3) near a place, with weights that fall with the square of the distance beyond the nearest. */
void surface_mean(const double *xyz, const double *inlier, int64_t n, const double *place, double depth, double *mean) {
    double least = INFINITY, sum[4] = {0.0};
    for (int round = 0; round < 2; round++) {
        for (int64_t i = 0; i < n; i++) {
            const double x = xyz[3 * i] - place[0], y = xyz[3 * i + 1] - place[1], z = xyz[3 * i + 2] - place[2];
            const double squared = x * x + y * y + z * z + (inlier[i] > 0.0 ? 0.0 : 1.0);
            if (round == 0) {
                least = squared < least ? squared : least;
            } else if (inlier[i] > 0.0 && (squared - least) / (2.0 * depth * depth) < 40.0) {
                const double weight = inlier[i] * exp(-(squared - least) / (2.0 * depth * depth));
                sum[0] += weight;
                sum[1] += weight * xyz[3 * i], sum[2] += weight * xyz[3 * i + 1], sum[3] += weight * xyz[3 * i + 2];
            }
        }
    }
    for (int axis = 0; axis < 3; axis++) {
        mean[axis] = sum[1 + axis] / sum[0];
    }
}

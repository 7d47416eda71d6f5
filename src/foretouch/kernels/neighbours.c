/* SPDX-License-Identifier: Apache-2.0 */
#include "eigen.h"
#include "moments.h"
#include "points_tree.h"

#define MOST_LEAVES 512 /* gathered around one leaf: of 4096 points 50 are found without a better start */
#define TRIES 48        /* of another radius around one leaf */

typedef struct {
    float *x, *y, *z; /* (MOST_LEAVES LEAF) each */
    float *squared;   /* (MOST_LEAVES LEAF) */
    int64_t n;        /* a multiple of LEAF */
} crowd;

/* The points of all leaves whose box is within a squared radius of a box; 0 if they are too many. */
static inline int gather(const tree *t, const float *box, float reach, crowd *c) {
    int64_t stack[64];
    int depth = 0;
    c->n = 0;
    stack[depth++] = 1;
    while (depth) {
        const int64_t node = stack[--depth];
        if (!(gap(t->boxes + 6 * node, box, box + 3) <= reach)) {
            continue;
        }
        if (node < t->width) {
            stack[depth++] = 2 * node + 1;
            stack[depth++] = 2 * node;
            continue;
        }
        if (c->n == MOST_LEAVES * LEAF) {
            return 0;
        }
        const float *column = t->columns + (node - t->width) * 3 * LEAF;
        memcpy(c->x + c->n, column, LEAF * sizeof(float));
        memcpy(c->y + c->n, column + LEAF, LEAF * sizeof(float));
        memcpy(c->z + c->n, column + 2 * LEAF, LEAF * sizeof(float));
        c->n += LEAF;
    }
    return 1;
}

/* Squares compare as their bits do. */
static inline int32_t bits_of(float value) {
    int32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

static inline float value_of(int32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

static inline int32_t count_up_to(const float *squared, int64_t n, int32_t limit) {
    int32_t count = 0;
    for (int64_t i = 0; i < n; i++) {
        int32_t bits;
        memcpy(&bits, squared + i, sizeof bits);
        count += bits <= limit;
    }
    return count;
}

static inline void squared_distances(crowd *c, const float *point) {
    const float x = point[0], y = point[1], z = point[2];
    for (int64_t i = 0; i < c->n; i++) {
        const float dx = c->x[i] - x, dy = c->y[i] - y, dz = c->z[i] - z;
        c->squared[i] = dx * dx + dy * dy + dz * dz;
    }
}

/* Sum of the roots of the `wanted` smallest squares, of which there are `count` up to `limit`, no less than wanted.
 * Also the largest of them, or a number between it and the next. */
static inline double sum_of_nearest(const float *squared, int64_t n, int32_t wanted, float limit, int32_t count,
                                    float *largest) {
    int32_t low = -1, high = bits_of(limit), below = 0;
    for (int round = 0; count != wanted && high - low > 1; round++) {
        /* On a surface the number grows with the square of the distance; then halve, which ends in 31 rounds. */
        const float guess = value_of(high) * (float)wanted / (float)count;
        int32_t middle = round < 6 ? bits_of(guess) : low + (high - low) / 2;
        if (middle <= low || middle >= high) {
            middle = low + (high - low) / 2;
        }
        const int32_t found = count_up_to(squared, n, middle);
        if (found < wanted) {
            low = middle;
            below = found;
        } else {
            high = middle;
            count = found;
        }
    }
    /* Either those up to `high` are as many as wanted, or `high` is a tie, of which some are taken. */
    const int32_t last = count == wanted ? high : low;
    const float edge = value_of(last);
    double part[LEAF] = {0.0};
    if (last >= 0) {
        for (int64_t i = 0; i < n; i += LEAF) {
            for (int j = 0; j < LEAF; j++) {
                const float one = squared[i + j] <= edge ? squared[i + j] : 0.0f;
                part[j] += (double)sqrtf(one);
            }
        }
    }
    double sum = ((part[0] + part[4]) + (part[2] + part[6])) + ((part[1] + part[5]) + (part[3] + part[7]));
    *largest = value_of(high);
    return last == high ? sum : sum + (wanted - below) * (double)sqrtf(*largest);
}

/* Mean distance of each of n points (n, 3) to its k nearest others, 0 < k < n, summed in double.
 *
 * mean: (n). proven: (n), 0 where the search was given up (more than thousands of points at one place, numbers whose
 * squares overflow) and the mean is meaningless. Around a leaf the points within a radius are gathered, wider until each
 * of its points has k others within it: nearer ones are then nowhere else. */
VECTORISED void mean_neighbour_distance(const float *xyz, int64_t n, int64_t k, float *mean, uint8_t *proven) {
    tree t;
    memset(proven, 0, (size_t)(n > 0 ? n : 0));
    if (k < 1 || k >= n || k >= MOST_LEAVES * LEAF || !build_tree(&t, xyz, n)) {
        return;
    }
    float *memory = malloc(4 * MOST_LEAVES * LEAF * sizeof(float));
    const int32_t wanted = (int32_t)k + 1; /* itself, at distance 0, included */
    float start = 0.0f;
    for (int64_t leaf = 0; memory && leaf < t.leaves; leaf++) {
        crowd c = {memory, memory + MOST_LEAVES * LEAF, memory + 2 * MOST_LEAVES * LEAF, memory + 3 * MOST_LEAVES * LEAF, 0};
        const slot *slots = t.slots + leaf * LEAF;
        const int size = (int)(t.n - leaf * LEAF < LEAF ? t.n - leaf * LEAF : LEAF);
        const float *box = t.boxes + 6 * (t.width + leaf);
        float reach = start, few = -1.0f, many = INFINITY, farthest = 0.0f;
        int left = size, done[LEAF] = {0};
        for (int round = 0; left && round < TRIES; round++) {
            if (!gather(&t, box, reach, &c)) {
                many = reach;
                reach = few > 0.0f ? sqrtf(few) * sqrtf(many) : many / 4.0f;
                if (!(reach > few && reach < many)) {
                    break;
                }
                continue;
            }
            for (int i = 0; i < size; i++) {
                if (done[i]) {
                    continue;
                }
                squared_distances(&c, slots[i].c);
                const int32_t count = count_up_to(c.squared, c.n, bits_of(reach));
                if (count < wanted) {
                    continue;
                }
                float largest;
                const double sum = sum_of_nearest(c.squared, c.n, wanted, reach, count, &largest);
                mean[slots[i].id] = (float)(sum / (double)k);
                proven[slots[i].id] = 1;
                done[i] = 1;
                left--;
                farthest = larger_of(largest, farthest);
            }
            if (left) {
                few = reach;
                reach = many < INFINITY ? sqrtf(few > 0.0f ? few : many / 1e6f) * sqrtf(many) : 2.0f * reach + 1e-12f;
                if (!(reach > few && reach < many && reach < INFINITY)) {
                    break;
                }
            }
        }
        start = 1.2f * farthest;
    }
    free(memory);
    free_tree(&t);
}

/* Sums of the moments of the points (n, 3) strictly within a squared radius of each of q places (q, 3).
 *
 * Moments: 1, the coordinates from `origin`, and their products xx, xy, xz, yy, yz, zz. sums: (q, 10); the first is
 * negative for all if there is no memory. */
VECTORISED void summed_moments(const float *xyz, int64_t n, const float *places, int64_t q, double limit, const float *origin,
                               double *sums) {
    tree t;
    double *of_points = NULL, *of_nodes = NULL;
    const float within = (float)limit;
    if (build_tree(&t, xyz, n)) {
        of_points = calloc((size_t)t.leaves * LEAF * MOMENTS, sizeof(double));
        of_nodes = calloc((size_t)t.width * 2 * MOMENTS, sizeof(double));
    }
    if (!of_points || !of_nodes) {
        for (int64_t i = 0; i < q; i++) {
            sums[i * MOMENTS] = -1.0;
        }
        free(of_points);
        free(of_nodes);
        free_tree(&t);
        return;
    }
    for (int64_t i = 0; i < t.n; i++) {
        double *m = of_points + i * MOMENTS;
        moments_of(t.slots[i].c, origin, m);
        add_moments(of_nodes + (t.width + i / LEAF) * MOMENTS, m, 1.0);
    }
    for (int64_t node = t.width - 1; node > 0; node--) {
        add_moments(of_nodes + node * MOMENTS, of_nodes + 2 * node * MOMENTS, 1.0);
        add_moments(of_nodes + node * MOMENTS, of_nodes + (2 * node + 1) * MOMENTS, 1.0);
    }
    for (int64_t i = 0; i < q; i++) {
        const float *p = places + 3 * i;
        double sum[MOMENTS] = {0.0};
        int64_t stack[64];
        int depth = 0;
        stack[depth++] = 1;
        while (depth) {
            const int64_t node = stack[--depth];
            const float *box = t.boxes + 6 * node;
            if (!(gap(box, p, p) < within)) {
                continue;
            }
            if (span(box, p) < within) {
                add_moments(sum, of_nodes + node * MOMENTS, 1.0);
            } else if (node < t.width) {
                stack[depth++] = 2 * node + 1;
                stack[depth++] = 2 * node;
            } else {
                const int64_t leaf = node - t.width;
                const float *column = t.columns + leaf * 3 * LEAF;
                const double *m = of_points + leaf * LEAF * MOMENTS;
                double weight[LEAF];
                for (int j = 0; j < LEAF; j++) {
                    const float dx = column[j] - p[0], dy = column[LEAF + j] - p[1], dz = column[2 * LEAF + j] - p[2];
                    weight[j] = dx * dx + dy * dy + dz * dz < within ? 1.0 : 0.0;
                }
                for (int j = 0; j < LEAF; j++) {
                    add_moments(sum, m + j * MOMENTS, weight[j]);
                }
            }
        }
        memcpy(sums + i * MOMENTS, sum, sizeof sum);
    }
    free(of_points);
    free(of_nodes);
    free_tree(&t);
}

/* Normals and curvature from summed moments (q, 10), as `_fit` of pcl_filters.py: NaN where they span no plane.
 *
 * places: (q, 3), which the normals (q, 3) face the origin from. curvature: (q). */
void fit_planes(const double *sums, const float *places, int64_t q, double line, double *normals, double *curvature) {
    for (int64_t i = 0; i < q; i++) {
        const double *sum = sums + i * MOMENTS;
        double c[6], values[3], minor[3];
        covariance_of(sum, c);
        const double trace = c[0] + c[3] + c[5];
        const double squares = c[0] * c[0] + c[3] * c[3] + c[5] * c[5] + 2.0 * (c[1] * c[1] + c[2] * c[2] + c[4] * c[4]);
        if (!(sum[0] >= 3.0 && (trace * trace - squares) / 2.0 > line * trace * trace)) {
            normals[3 * i] = normals[3 * i + 1] = normals[3 * i + 2] = curvature[i] = NAN;
            continue;
        }
        eigen3(c, values, minor);
        const float *p = places + 3 * i;
        const double away = minor[0] * (double)p[0] + minor[1] * (double)p[1] + minor[2] * (double)p[2];
        for (int axis = 0; axis < 3; axis++) {
            normals[3 * i + axis] = away > 0.0 ? -minor[axis] : minor[axis];
        }
        curvature[i] = (values[0] > 0.0 ? values[0] : 0.0) / (values[0] + values[1] + values[2]);
    }
}

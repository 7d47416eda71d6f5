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
INLINE int gather(const tree *t, const float *low, const float *high, float reach, crowd *c) {
    int64_t stack[128];
    int depth = start_nodes(t, stack);
    c->n = 0;
    while (depth) {
        const int64_t node = stack[--depth];
        if (node < t->width) {
            float apart[8];
            *(float8u *)apart = gaps(box_of(t, 8 * node), low, high);
            for (int i = 7; i >= 0; i--) {
                stack[depth] = 8 * node + i;
                depth += apart[i] <= reach;
            }
        } else if (node - t->width < t->leaves) {
            if (c->n == MOST_LEAVES * LEAF) {
                return 0;
            }
            const float8u *column = (const float8u *)(t->columns + (node - t->width) * 3 * LEAF);
            *(float8u *)(c->x + c->n) = column[0];
            *(float8u *)(c->y + c->n) = column[1];
            *(float8u *)(c->z + c->n) = column[2];
            c->n += LEAF;
        }
    }
    return 1;
}

/* Squares compare as their bits do. */
INLINE int32_t bits_of(float value) {
    int32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return bits;
}

INLINE float value_of(int32_t bits) {
    float value;
    memcpy(&value, &bits, sizeof value);
    return value;
}

INLINE int32_t count_up_to(const float *squared, int64_t n, int32_t limit) {
    int8x32 counts[4] = {{0}};
    int64_t i = 0;
    for (; i + 4 * LEAF <= n; i += 4 * LEAF) {
        for (int k = 0; k < 4; k++) {
            counts[k] -= *(const int8x32u *)(squared + i + k * LEAF) <= limit;
        }
    }
    for (; i < n; i += LEAF) {
        counts[0] -= *(const int8x32u *)(squared + i) <= limit;
    }
    const int8x32 count = (counts[0] + counts[1]) + (counts[2] + counts[3]);
    return ((count[0] + count[4]) + (count[2] + count[6])) + ((count[1] + count[5]) + (count[3] + count[7]));
}

INLINE void squared_distances(crowd *c, const float *point) {
    for (int64_t i = 0; i < c->n; i += LEAF) {
        const float8 x = *(const float8u *)(c->x + i) - point[0];
        const float8 y = *(const float8u *)(c->y + i) - point[1];
        const float8 z = *(const float8u *)(c->z + i) - point[2];
        *(float8u *)(c->squared + i) = x * x + y * y + z * z;
    }
}

/* Sum of the roots of the `wanted` smallest squares, of which there are `count` up to `limit`, no less than wanted.
 * Also the largest of them, or a number between it and the next. */
INLINE double sum_of_nearest(const float *squared, int64_t n, int32_t wanted, float limit, int32_t count,
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
        const float *box = box_of(&t, t.width + leaf);
        const float low[3] = {box[0], box[8], box[16]}, high[3] = {box[24], box[32], box[40]};
        float reach = start, few = -1.0f, many = INFINITY, farthest = 0.0f;
        int left = size, done[LEAF] = {0};
        for (int round = 0; left && round < TRIES; round++) {
            if (!gather(&t, low, high, reach, &c)) {
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
    free(t.slots);
}

/* Sums of the moments of the points (n, 3) strictly within a squared radius of each of q places (q, 3).
 *
 * Moments: 1, the coordinates from `origin`, and their products xx, xy, xz, yy, yz, zz. sums: (q, 10); the first is
 * negative for all if there is no memory. */
VECTORISED void summed_moments(const float *xyz, int64_t n, const float *places, int64_t q, double limit, const float *origin,
                               double *sums) {
    tree t;
    double *of_points = NULL;
    const float within = (float)limit;
    if (build_tree(&t, xyz, n)) {
        of_points = calloc((size_t)(t.leaves * LEAF + t.width * 2) * PADDED, sizeof(double));
    }
    if (!of_points) {
        for (int64_t i = 0; i < q; i++) {
            sums[i * MOMENTS] = -1.0;
        }
        free(t.slots);
        return;
    }
    double *of_nodes = of_points + t.leaves * LEAF * PADDED;
    for (int64_t i = 0; i < t.n; i++) {
        double *m = of_points + i * PADDED;
        moments_of(t.slots[i].c, origin, m);
        for (int j = 0; j < MOMENTS; j++) {
            of_nodes[(t.width + i / LEAF) * PADDED + j] += m[j];
        }
    }
    for (int64_t node = t.width - 1; node > 0; node--) {
        for (int j = 0; j < MOMENTS; j++) {
            of_nodes[node * PADDED + j] = of_nodes[2 * node * PADDED + j] + of_nodes[(2 * node + 1) * PADDED + j];
        }
    }
    for (int64_t i = 0; i < q; i++) {
        const float *p = places + 3 * i;
        double4 sum[3] = {{0.0}};
        int64_t stack[128];
        int depth = start_nodes(&t, stack);
        while (depth) {
            const int64_t node = stack[--depth];
            if (node < t.width) {
                float apart[8], wide[8];
                *(float8u *)apart = gaps(box_of(&t, 8 * node), p, p);
                *(float8u *)wide = spans(box_of(&t, 8 * node), p);
                for (int j = 7; j >= 0; j--) {
                    if (wide[j] < within) {
                        add_moments(sum, of_nodes + (8 * node + j) * PADDED, 1.0);
                    } else {
                        stack[depth] = 8 * node + j;
                        depth += apart[j] < within;
                    }
                }
            } else if (node - t.width < t.leaves) {
                const float8u *column = (const float8u *)(t.columns + (node - t.width) * 3 * LEAF);
                const double *m = of_points + (node - t.width) * LEAF * PADDED;
                const float8 x = column[0] - p[0], y = column[1] - p[1], z = column[2] - p[2];
                int32_t near[8];
                *(int8x32u *)near = (x * x + y * y + z * z) < within;
                for (int j = 0; j < LEAF; j++) {
                    add_moments(sum, m + j * PADDED, (double)-near[j]);
                }
            }
        }
        memcpy(sums + i * MOMENTS, sum, MOMENTS * sizeof(double));
    }
    free(of_points);
    free(t.slots);
}

/* Normals and curvature from summed moments (q, 10): NaN where they span no plane.
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

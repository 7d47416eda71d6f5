/* SPDX-License-Identifier: Apache-2.0 */
/* A k-d tree over the points of one object, for the searches of neighbours.c.
 *
 * Leaves hold eight points each (the last one fewer) and are numbered from left to right; inner nodes are those of a heap:
 * node i has the children 2 i and 2 i + 1, so 8 i to 8 i + 7 are three levels below it, and leaf j is node width + j.
 * Searches go down three levels at a time and test eight boxes at once. Boxes are exact bounds. Differences, squares and
 * sums of float32 are monotone, so the squared distance of two boxes, computed with the operations used for two points, is
 * never more than that of any of their points: what a box excludes needs no margin for rounding. Splits only affect the
 * speed. */
#ifndef FORETOUCH_POINTS_TREE_H
#define FORETOUCH_POINTS_TREE_H

#include "kernels.h"

#define LEAF 8
#define SPLIT_ROUNDS 64 /* of one selection; hostile orders end in a worse split instead of in a quadratic time */

typedef struct {
    float c[3];
    int32_t id;
} slot;

typedef struct {
    int64_t n, leaves, width; /* points; leaves in use; leaves of the complete tree, a power of two */
    slot *slots;              /* (n), by leaf; the others are in its memory */
    float *columns;           /* (leaves, 3, LEAF): x, y and z of each leaf, infinite where there is no point */
    float *boxes;             /* (2 width / 8, 6, 8): low x, y, z, high x, y, z; low above high where there is no point */
} tree;

/* The low x of a node's box; the other five numbers follow in steps of eight. */
INLINE float *box_of(const tree *t, int64_t node) { return t->boxes + node / 8 * 48 + node % 8; }

static inline float smaller_of(float a, float b) { return a < b ? a : b; }

static inline float larger_of(float a, float b) { return a > b ? a : b; }

static inline float middle_of(float a, float b, float c) {
    return larger_of(smaller_of(a, b), smaller_of(larger_of(a, b), c));
}

/* Moves the slots of [first, end) so that those before `middle` are not beyond the others along an axis. */
static void split_slots(slot *s, int64_t first, int64_t middle, int64_t end, int axis) {
    for (int round = 0; round < SPLIT_ROUNDS && end - first > 1; round++) {
        const float pivot =
            middle_of(s[first].c[axis], s[first + (end - first) / 2].c[axis], s[end - 1].c[axis]);
        int64_t less = first;
        for (int64_t i = first; i < end; i++) {
            const slot one = s[i];
            s[i] = s[less];
            s[less] = one;
            less += one.c[axis] < pivot;
        }
        if (middle < less) {
            end = less;
        } else if (less > first) {
            first = less;
        } else { /* the pivot is the smallest: set its equals aside */
            int64_t equal = first;
            for (int64_t i = first; i < end; i++) {
                const slot one = s[i];
                s[i] = s[equal];
                s[equal] = one;
                equal += !(one.c[axis] > pivot);
            }
            if (middle < equal) {
                return;
            }
            first = equal;
        }
    }
}

/* Splits the `count` leaves (a power of two) below a node; `box` bounds its points loosely. */
static void build_node(tree *t, int64_t node, int64_t leaf, int64_t count, const float *box) {
    float *bound = box_of(t, node);
    if (leaf >= t->leaves) {
        return;
    }
    const int64_t first = leaf * LEAF;
    if (count == 1) {
        const int64_t size = t->n - first < LEAF ? t->n - first : LEAF;
        float *column = t->columns + leaf * 3 * LEAF;
        for (int axis = 0; axis < 3; axis++) {
            float low = INFINITY, high = -INFINITY;
            for (int64_t i = 0; i < size; i++) {
                const float value = t->slots[first + i].c[axis];
                column[axis * LEAF + i] = value;
                low = smaller_of(value, low);
                high = larger_of(value, high);
            }
            bound[8 * axis] = low;
            bound[8 * (3 + axis)] = high;
        }
        return;
    }
    const int64_t half = count / 2, middle = first + half * LEAF;
    const int64_t end = first + count * LEAF < t->n ? first + count * LEAF : t->n;
    float left[6], right[6];
    memcpy(left, box, sizeof left);
    memcpy(right, box, sizeof right);
    if (middle < end) {
        int axis = 0;
        for (int other = 1; other < 3; other++) {
            axis = box[3 + other] - box[other] > box[3 + axis] - box[axis] ? other : axis;
        }
        split_slots(t->slots, first, middle, end, axis);
        left[3 + axis] = right[axis] = t->slots[middle].c[axis];
    }
    build_node(t, 2 * node, leaf, half, left);
    build_node(t, 2 * node + 1, leaf + half, half, right);
    const float *a = box_of(t, 2 * node), *b = box_of(t, 2 * node + 1);
    for (int axis = 0; axis < 3; axis++) {
        bound[8 * axis] = smaller_of(a[8 * axis], b[8 * axis]);
        bound[8 * (3 + axis)] = larger_of(a[8 * (3 + axis)], b[8 * (3 + axis)]);
    }
}

/* The tree of n points (n, 3); 0 without memory, or for more points than an int32 numbers. */
static int build_tree(tree *t, const float *xyz, int64_t n) {
    memset(t, 0, sizeof *t);
    if (n < 1 || n > INT32_MAX / 64) {
        return 0;
    }
    t->n = n;
    t->leaves = (n + LEAF - 1) / LEAF;
    for (t->width = 1; t->width < t->leaves; t->width *= 2) {
    }
    const int64_t groups = (2 * t->width + 7) / 8;
    t->slots = malloc((size_t)n * sizeof(slot) + (size_t)(t->leaves * 3 * LEAF + groups * 48) * sizeof(float));
    if (!t->slots) {
        return 0;
    }
    t->columns = (float *)(t->slots + n), t->boxes = t->columns + t->leaves * 3 * LEAF;
    for (int64_t i = 0; i < groups * 48; i++) {
        t->boxes[i] = i % 48 < 24 ? INFINITY : -INFINITY;
    }
    for (int64_t i = (t->leaves - 1) * 3 * LEAF; i < t->leaves * 3 * LEAF; i++) {
        t->columns[i] = INFINITY;
    }
    float box[6] = {INFINITY, INFINITY, INFINITY, -INFINITY, -INFINITY, -INFINITY};
    for (int64_t i = 0; i < n; i++) {
        for (int axis = 0; axis < 3; axis++) {
            const float value = xyz[3 * i + axis];
            t->slots[i].c[axis] = value;
            box[axis] = smaller_of(value, box[axis]);
            box[3 + axis] = larger_of(value, box[3 + axis]);
        }
        t->slots[i].id = (int32_t)i;
    }
    build_node(t, 1, 0, t->width, box);
    return 1;
}

/* The nodes where a search begins, on a level from which it reaches the leaves in steps of three; returns their number. */
INLINE int start_nodes(const tree *t, int64_t *stack) {
    int64_t first = 1;
    for (int64_t rest = t->width; rest > 1; rest /= 8) {
        first = rest >= 8 ? first : rest;
    }
    for (int i = 0; i < first; i++) {
        stack[i] = first + i;
    }
    return (int)first;
}

/* Squared distances of eight boxes from a box, 0 where they touch. */
INLINE float8 gaps(const float *group, const float *low, const float *high) {
    const float8u *box = (const float8u *)group;
    const float8 none = {0.0f};
    const float8 x = larger8(larger8(low[0] - box[3], box[0] - high[0]), none);
    const float8 y = larger8(larger8(low[1] - box[4], box[1] - high[1]), none);
    const float8 z = larger8(larger8(low[2] - box[5], box[2] - high[2]), none);
    return x * x + y * y + z * z;
}

/* Squares of the largest distances of a point from any place of each of eight boxes. */
INLINE float8 spans(const float *group, const float *point) {
    const float8u *box = (const float8u *)group;
    const float8 x = larger8(box[3] - point[0], point[0] - box[0]);
    const float8 y = larger8(box[4] - point[1], point[1] - box[1]);
    const float8 z = larger8(box[5] - point[2], point[2] - box[2]);
    return x * x + y * y + z * z;
}

#endif

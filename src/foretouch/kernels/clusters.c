/* SPDX-License-Identifier: Apache-2.0 */
/* Clusters of an image: connected points above the table (docs/segmentation.md). test/kernels/references/segmentation.py states
 * each step in NumPy.
 *
 * - Patches: connected pixels of the coarse grid above the table, each with a window of the image around it (grid_patches).
 * - Clusters of a window: neighbours of the grid are connected on faces that are not too steep, small sets on steeper ones; their
 *   labels grow to all pixels; flying pixels are dropped, and those at the foot of an object are added (label_window).
 * - Points of each cluster (collect_members), and its id in the image (write_ids).
 *
 * `settings` are, in this order, float32 numbers but for the rays: */
#include "sets.h"

enum {
    PLANE_A, /* of the table, its normal towards the camera */
    PLANE_B,
    PLANE_C,
    PLANE_D,
    LOW,      /* minimum height above the table [m] */
    NOISE,    /* minimum height divided by the square of the depth [1/m] */
    HIGH,     /* maximum height [m] */
    NEAREST,  /* depth range [m] */
    FARTHEST,
    CLOSE,     /* depth per depth of connected neighbours, */
    CONNECTED, /* of those of which one is in a small set, */
    SUPPORTED, /* and of those that support each other, */
    GAP,       /* or this depth, if larger [m] */
    TOP,       /* height that a patch must reach [m] */
    CHECKED,   /* whether rays are given */
    DEVIATION, /* largest distance from the ray, per depth */
    RAY_X,     /* x / z of the first pixel, per column, per row */
    RAY_Y = RAY_X + 3
};

#define BLOCK 32
#define BASE_FRACTION (1.0f / 3.0f)
#define MIN_SUPPORT 4
#define MIN_STRAIGHT 3
#define WINDOW 5 /* cells of a side of a window in which the noise is measured, */
#define APART 6  /* and from one window to the next */
#define SMALL 8 /* times the least number of nodes: of a set that is connected across larger steps */

INLINE float height_of(const float *p, const double *s) {
    return p[0] * (float)s[PLANE_A] + p[1] * (float)s[PLANE_B] + p[2] * (float)s[PLANE_C] + (float)s[PLANE_D];
}

/* As np.maximum: NaN if either is. */
INLINE float maximum(float a, float b) { return a != a ? a : (b != b ? b : (a > b ? a : b)); }

INLINE float threshold_at(float z, const double *s) {
    return maximum(z * (float)s[NOISE] * z, (float)s[LOW]);
}

INLINE float step_at(float z, double slope, const double *s) { return maximum(z * (float)slope, (float)s[GAP]); }

INLINE int is_above(float height, float z, const double *s) {
    return (height > threshold_at(z, s)) & (height < (float)s[HIGH]) & (z >= (float)s[NEAREST]) & (z <= (float)s[FARTHEST]);
}

INLINE int is_beside(const float *p, double row, double column, const double *s) {
    const float x = (float)(s[RAY_X] + s[RAY_X + 1] * column + s[RAY_X + 2] * row);
    const float y = (float)(s[RAY_Y] + s[RAY_Y + 1] * column + s[RAY_Y + 2] * row);
    const float dx = fabsf(p[0] - x * p[2]), dy = fabsf(p[1] - y * p[2]), limit = p[2] * (float)s[DEVIATION];
    return ((dx > limit) | (dy > limit)) & (dx == dx) & (dy == dy) & (p[2] > 0.0f);
}

/* Numbers the connected sets of the n cells with a number above 0, from 1 in the order of their first cells, 0 for those of fewer
 * than `least` cells or, where that is given, with none that is tall. count: (n), zeros. Returns the largest number. */
INLINE int32_t number_sets(int32_t *parent, int32_t *number, int64_t n, int64_t least, uint8_t *tall, int32_t *count) {
    int32_t last = 0;
    for (int64_t i = 0; i < n; i++) {
        if (number[i] > 0) {
            const int32_t root = root_of(parent, (int32_t)i);
            count[root]++;
            if (tall) {
                tall[root] |= tall[i];
            }
        }
    }
    for (int64_t i = 0; i < n; i++) {
        if (number[i] > 0) {
            const int32_t root = root_of(parent, (int32_t)i);
            if (root == i) { /* the first of its set: from here on its count is its number */
                count[i] = count[i] >= least && (!tall || tall[i]) ? ++last : 0;
            }
            number[i] = count[root];
        }
    }
    return last;
}

/* Patches of the coarse grid (h, w, 3) above the table; diagonal neighbours are in one patch.
 *
 * of->number: written, from 1 in the order of their first pixels, without those of fewer than `min_nodes` pixels or nowhere
 * high; -1 for pixels above the table but beside their ray. boxes: (h w / min_nodes + 1, 4), first row, end, first column,
 * end of each. found: the number of patches, -1 without memory; and whether a pixel is beside its ray. */
VECTORISED void grid_patches(const float *grid, const Patches *of, int64_t *boxes, int64_t *found) {
    const int64_t h = of->h, w = of->w, stride = of->stride, n = h * w;
    int32_t *number = of->number;
    int32_t *parent = n < INT32_MAX ? calloc((size_t)n + 1, 2 * sizeof(int32_t) + 1) : NULL;
    double s[RAY_Y + 3];
    memcpy(s, of->settings, sizeof s);
    found[0] = -1, found[1] = 0;
    if (!parent) {
        return;
    }
    int32_t *count = parent + n;
    uint8_t *tall = (uint8_t *)(count + n);
    for (int64_t row = 0; row < h; row++) {
        for (int64_t column = 0; column < w; column++) {
            const int64_t i = row * w + column;
            const float *p = grid + 3 * i;
            number[i] = is_above(height_of(p, s), p[2], s);
            tall[i] = height_of(p, s) > (float)s[TOP];
            parent[i] = (int32_t)i;
        }
        for (int64_t column = 0; column < w; column++) {
            const int64_t i = row * w + column;
            if (!number[i]) {
                continue;
            }
            if (s[CHECKED] > 0.0 && is_beside(grid + 3 * i, (double)(row * stride), (double)(column * stride), s)) {
                number[i] = -1, found[1] = 1;
                continue;
            }
            if (column && number[i - 1] > 0) {
                join(parent, (int32_t)i, (int32_t)i - 1);
            }
            for (int64_t other = column - 1; row && other <= column + 1; other++) {
                if (other >= 0 && other < w && number[(row - 1) * w + other] > 0) {
                    join(parent, (int32_t)i, (int32_t)((row - 1) * w + other));
                }
            }
        }
    }
    const int32_t last = number_sets(parent, number, n, of->min_nodes, tall, count);
    for (int64_t k = 0; k < last; k++) {
        boxes[4 * k] = h, boxes[4 * k + 1] = 0, boxes[4 * k + 2] = w, boxes[4 * k + 3] = 0;
    }
    for (int64_t i = 0; i < n; i++) {
        const int64_t row = i / w, column = i % w;
        if (number[i] > 0) {
            int64_t *box = boxes + 4 * (number[i] - 1);
            box[0] = row < box[0] ? row : box[0], box[1] = row + 1;
            box[2] = column < box[2] ? column : box[2], box[3] = column + 1 > box[3] ? column + 1 : box[3];
        }
    }
    found[0] = last;
    free(parent);
}

enum { TAKEN = 1, BESIDE = 2 };   /* of a pixel, whatever the window */
enum { ABOVE = 1, BELOW = 2, LOW_EDGE = 4, OFF = 8 }; /* of a pixel by its height; LOW_EDGE may be the foot of an object; OFF its ray */

typedef struct {
    int64_t h, w, stride, gh, gw; /* size of the window, step and size of its part of the coarse grid */
    int64_t line;                 /* from one row of `z` and `kind` to the next */
    float *z;                     /* (h + 2, w + 2), from the first pixel; NaN around the window */
    uint8_t *kind;                /* the same shape, not set around the window */
    int32_t *nodes;               /* (gh, gw), labels of the grid */
    const double *s;
} view; /* of a window */

/* Whether two neighbours of the grid, `step` numbers apart for each of `stride` pixels, are joined: up to a depth per depth. */
INLINE int is_joined(const view *v, int64_t first, int64_t step, double slope) {
    const float *z = v->z + first;
    const uint8_t *kind = v->kind + first;
    int hole = 0;
    if (kind[0] & BELOW) {
        return 0;
    }
    for (int64_t i = 0; i < v->stride; i++) {
        const float here = z[i * step], next = z[(i + 1) * step];
        hole |= here != here;
        if (fabsf(next - here) > step_at(here, slope, v->s) || kind[(i + 1) * step] & BELOW) {
            return 0;
        }
    }
    const float allowed = (hole ? 1.0f : (float)v->stride) * step_at(z[0], slope, v->s);
    return fabsf(z[v->stride * step] - z[0]) <= allowed;
}

/* Joins sets of nodes of which one is small across larger steps in depth. size: (gh gw), zeros. */
INLINE void join_small(const view *v, int32_t *parent, int32_t *size, int64_t min_nodes) {
    for (int64_t i = 0; i < v->gh * v->gw; i++) {
        size[root_of(parent, (int32_t)i)]++;
    }
    for (int64_t i = 0; i < v->gh * v->gw; i++) {
        for (int side = 0; v->nodes[i] && side < 2; side++) {
            const int64_t other = side ? i - 1 : i - v->gw, step = side ? 1 : v->line;
            if (!(side ? i % v->gw : i / v->gw) || !v->nodes[other]) {
                continue;
            }
            const int64_t pixel = other / v->gw * v->stride * v->line + other % v->gw * v->stride;
            const int32_t a = root_of(parent, (int32_t)i), b = root_of(parent, (int32_t)other), both = size[a] + size[b];
            if (a != b && (size[a] < size[b] ? size[a] : size[b]) < SMALL * min_nodes && is_joined(v, pixel, step, v->s[CONNECTED])) {
                join(parent, a, b);
                size[root_of(parent, a)] = both;
            }
        }
    }
}

/* Labels the nodes of one patch and drops small components; the largest label, -1 without memory. */
INLINE int64_t label_nodes(view *v, const int32_t *patches, int64_t across, int64_t patch, int64_t min_nodes) {
    const int64_t gh = v->gh, gw = v->gw;
    int32_t *parent = calloc((size_t)(gh * gw + 1), 3 * sizeof(int32_t));
    int64_t last = -1;
    if (parent) {
        int32_t *count = parent + gh * gw;
        for (int64_t row = 0; row < gh; row++) {
            for (int64_t column = 0; column < gw; column++) {
                const int32_t i = (int32_t)(row * gw + column);
                const int64_t pixel = row * v->stride * v->line + column * v->stride;
                v->nodes[i] = patches[row * across + column] == patch && v->kind[pixel] & ABOVE;
                parent[i] = i;
                if (!v->nodes[i]) {
                    continue;
                }
                if (row && v->nodes[i - gw] && is_joined(v, pixel - v->stride * v->line, v->line, v->s[CLOSE])) {
                    join(parent, i, i - (int32_t)gw);
                }
                if (column && v->nodes[i - 1] && is_joined(v, pixel - v->stride, 1, v->s[CLOSE])) {
                    join(parent, i, i - 1);
                }
            }
        }
        join_small(v, parent, count + gh * gw, min_nodes);
        last = number_sets(parent, v->nodes, gh * gw, min_nodes, NULL, count);
    }
    free(parent);
    return last;
}

/* The label of a pixel in a cell whose corners have different ones: that of the corner which is nearest in depth. */
INLINE int32_t nearest_label(const view *v, const int64_t *corners, float z) {
    int nearest = 0;
    float least = INFINITY;
    for (int i = 0; i < 4; i++) {
        const int64_t at = corners[i] / v->gw * v->stride * v->line + corners[i] % v->gw * v->stride;
        const float apart = fabsf(v->z[at] - z);
        if (v->nodes[corners[i]] && apart < least) {
            least = apart;
            nearest = i;
        }
    }
    return v->nodes[corners[nearest]];
}

/* The labels of the grid at full resolution. */
INLINE void grow(const view *v, int32_t *labels) {
    memset(labels, 0, (size_t)(v->h * v->w) * sizeof(int32_t));
    for (int64_t top = 0; top < v->gh; top++) {
        const int64_t bottom = top + 1 < v->gh ? top + 1 : top;
        const int64_t end_row = (top + 1) * v->stride < v->h ? (top + 1) * v->stride : v->h;
        for (int64_t cell = 0; cell < v->gw; cell++) {
            const int64_t right = cell + 1 < v->gw ? cell + 1 : cell;
            const int64_t end = (cell + 1) * v->stride < v->w ? (cell + 1) * v->stride : v->w;
            const int64_t at[4] = {top * v->gw + cell, top * v->gw + right, bottom * v->gw + cell, bottom * v->gw + right};
            int32_t most = 0;
            int shared = 0;
            for (int i = 0; i < 4; i++) {
                most = v->nodes[at[i]] > most ? v->nodes[at[i]] : most;
            }
            for (int i = 0; i < 4; i++) {
                shared |= v->nodes[at[i]] > 0 && v->nodes[at[i]] != most;
            }
            for (int64_t row = top * v->stride; most && row < end_row; row++) {
                for (int64_t i = cell * v->stride; i < end; i++) {
                    if (v->kind[row * v->line + i] & ABOVE) {
                        labels[row * v->w + i] = shared ? nearest_label(v, at, v->z[row * v->line + i]) : most;
                    }
                }
            }
        }
    }
}

/* Whether a pixel is in the air between two surfaces. */
INLINE int is_flying(const view *v, const float *z) {
    const float near = step_at(*z, v->s[SUPPORTED], v->s);
    const float *up = z - v->line, *down = z + v->line;
    const float steps[8] = {up[-1] - *z, up[0] - *z,    up[1] - *z,  z[-1] - *z,
                            z[1] - *z,   down[-1] - *z, down[0] - *z, down[1] - *z};
    int support = 0, straight = 0;
    for (int i = 0; i < 8; i++) {
        support += fabsf(steps[i]) <= near;
    }
    for (int i = 0; i < 4; i++) {
        straight += fabsf(steps[i] + steps[7 - i]) <= near;
    }
    return support < MIN_SUPPORT && straight < MIN_STRAIGHT;
}

enum { NO, SOLID, FLYING, BASE }; /* of a pixel while the outlines are refined */

/* Whether a solid pixel around a flying one has its label. */
INLINE int is_outline(const view *v, const int32_t *labels, const uint8_t *solid, int64_t row, int64_t column) {
    const int32_t own = labels[row * v->w + column];
    for (int64_t i = row ? row - 1 : 0; i <= row + 1 && i < v->h; i++) {
        for (int64_t j = column ? column - 1 : 0; j <= column + 1 && j < v->w; j++) {
            if (solid[i * v->w + j] == SOLID && labels[i * v->w + j] == own) {
                return 1;
            }
        }
    }
    return 0;
}

/* The label of the last solid pixel around a low one that is at its depth, or 0. */
INLINE int32_t owner_of(const view *v, const int32_t *labels, const uint8_t *solid, int64_t row, int64_t column) {
    const float own = v->z[row * v->line + column], near = step_at(own, v->s[SUPPORTED], v->s);
    int32_t owner = 0;
    for (int64_t i = row ? row - 1 : 0; i <= row + 1 && i < v->h; i++) {
        for (int64_t j = column ? column - 1 : 0; j <= column + 1 && j < v->w; j++) {
            if (solid[i * v->w + j] == SOLID && fabsf(v->z[i * v->line + j] - own) <= near) {
                owner = labels[i * v->w + j];
            }
        }
    }
    return owner;
}

/* Removes flying pixels from the labels and adds base pixels; `solid` marks which are left or added. `least` is the
 * smallest depth, with which a cheap superset of the flying pixels is found first; jump: (w). */
INLINE void refine(const view *v, float least, int32_t *jump, int32_t *labels, uint8_t *solid) {
    const int64_t h = v->h, w = v->w;
    const float limit = step_at(least, v->s[SUPPORTED], v->s);
    for (int64_t row = 0; row < h; row++) {
        const float *z = v->z + row * v->line, *up = z - v->line, *down = z + v->line;
        const int32_t *label = labels + row * w;
        uint8_t *kind = solid + row * w;
        for (int64_t i = 0; i < w; i++) {
            const int32_t across = (fabsf(z[i] - z[i - 1]) > limit) | (fabsf(z[i + 1] - z[i]) > limit);
            const int32_t along = (fabsf(z[i] - up[i]) > limit) | (fabsf(down[i] - z[i]) > limit);
            jump[i] = (across | along) & (label[i] > 0);
        }
        for (int64_t i = 0; i < w; i++) {
            kind[i] = label[i] > 0;
        }
        for (int64_t i = 0; i < w; i++) {
            if (jump[i] && is_flying(v, z + i)) {
                kind[i] = FLYING;
            }
        }
    }
    for (int64_t row = 0; row < h; row++) {
        for (int64_t start = 0; start < w; start += BLOCK) {
            const int64_t end = start + BLOCK < w ? start + BLOCK : w;
            uint8_t any = 0; /* most pixels are neither */
            for (int64_t column = start; column < end; column++) {
                any |= (solid[row * w + column] == FLYING) | (v->kind[row * v->line + column] & LOW_EDGE);
            }
            for (int64_t column = start; column < end && any; column++) {
                const int64_t i = row * w + column;
                if (solid[i] == FLYING) {
                    if (!is_outline(v, labels, solid, row, column)) {
                        labels[i] = 0;
                    }
                } else if (v->kind[row * v->line + column] & LOW_EDGE) {
                    const int32_t owner = owner_of(v, labels, solid, row, column);
                    if (owner) {
                        labels[i] = owner;
                        solid[i] = BASE;
                    }
                }
            }
        }
    }
}

/* The tangents x / z or y / z of the rays of a row of pixels; `slopes`: of the first pixel, per column, per row. */
INLINE void rays_of(double row, int64_t column, int64_t w, const double *slopes, float *tangent) {
    for (int64_t i = 0; i < w; i++) {
        tangent[i] = (float)(slopes[0] + slopes[1] * (double)(column + i) + slopes[2] * row);
    }
}

/* Depth and kind of a row of a window; the smallest depth so far. Points beside their ray become holes. */
INLINE float read_row(const view *v, const float *points, int64_t row, const float *ray_x, const float *ray_y, float least,
                      uint8_t *marks, int64_t *any_beside, int32_t *kinds) {
    const double *s = v->s;
    float *z = v->z + row * v->line;
    uint8_t *kind = v->kind + row * v->line;
    int32_t beside = 0;
    const float a = (float)s[PLANE_A], b = (float)s[PLANE_B], c = (float)s[PLANE_C], d = (float)s[PLANE_D];
    const float noise = (float)s[NOISE], low = (float)s[LOW], high = (float)s[HIGH], deviation = (float)s[DEVIATION];
    const float nearest = (float)s[NEAREST], farthest = (float)s[FARTHEST];
    for (int64_t i = 0; i < v->w; i++) {
        const float x = points[3 * i], y = points[3 * i + 1], depth = points[3 * i + 2];
        const float raised = x * a + y * b + depth * c + d;
        const float least_height = depth * noise * depth > low ? depth * noise * depth : low; /* a NaN has no height */
        const int32_t above = (raised > least_height) & (raised < high) & (depth >= nearest) & (depth <= farthest);
        const int32_t edge = (raised > least_height * BASE_FRACTION) & (raised <= least_height);
        z[i] = depth;
        kinds[i] = above * ABOVE + (raised <= least_height) * BELOW + edge * LOW_EDGE;
    }
    if (ray_x) {
        for (int64_t i = 0; i < v->w; i++) {
            const float dx = fabsf(points[3 * i] - ray_x[i] * z[i]), dy = fabsf(points[3 * i + 1] - ray_y[i] * z[i]);
            const float limit = z[i] * deviation;
            const int32_t off = ((dx > limit) | (dy > limit)) & (dx == dx) & (dy == dy) & (z[i] > 0.0f);
            beside |= off, kinds[i] |= off * OFF;
        }
    }
    for (int64_t i = 0; i < v->w; i++) {
        kind[i] = (uint8_t)kinds[i];
    }
    for (int64_t i = 0; i < v->w && beside; i++) {
        if (kind[i] & OFF) {
            if (z[i] >= nearest && z[i] <= farthest) {
                marks[i] |= BESIDE;
                *any_beside = 1;
            }
            z[i] = NAN;
            kind[i] = 0;
        }
    }
    float part[8] = {least, least, least, least, least, least, least, least};
    int64_t i = 0;
    for (; i + 8 <= v->w; i += 8) {
        for (int j = 0; j < 8; j++) {
            part[j] = z[i + j] < part[j] ? z[i + j] : part[j];
        }
    }
    for (; i < v->w; i++) {
        part[0] = z[i] < part[0] ? z[i] : part[0];
    }
    for (int j = 0; j < 8; j++) {
        least = part[j] < least ? part[j] : least;
    }
    return least;
}

/* Labels one window of an image: that around the `patch`-th of the patches.
 *
 * of->labels, of->solid: written. marks: TAKEN, pixels that are solid in a window, which others leave out; BESIDE, pixels in range
 * beside their ray. found: the largest label, -1 without memory; and whether there are pixels BESIDE. */
VECTORISED void label_window(const Labelled *of, const Patches *patches, int64_t patch, const Marks *marks, int64_t *found) {
    const int64_t h = of->h, w = of->w, row = of->row, column = of->column, stride = patches->stride;
    int32_t *labels = of->labels;
    uint8_t *solid = of->solid, *first = marks->marks + (row - marks->row) * marks->across + column - marks->column;
    const int64_t line = w + 2;
    const size_t size = (size_t)((h + 2) * line);
    double s[RAY_Y + 3];
    memcpy(s, patches->settings, sizeof s);
    const size_t nodes = (size_t)(((h + stride - 1) / stride) * ((w + stride - 1) / stride));
    float *memory = h * w < INT32_MAX ? malloc((size + 3 * (size_t)w + nodes) * sizeof(float) + size) : NULL;
    view v = {h, w, stride, (h + stride - 1) / stride, (w + stride - 1) / stride, line, NULL, NULL, NULL, s};
    found[0] = -1, found[1] = 0;
    if (memory) {
        v.z = memory + line + 1;
        float *ray_x = memory + size, *ray_y = ray_x + w, least = INFINITY;
        int32_t *row_of_flags = (int32_t *)(ray_y + w);
        v.nodes = row_of_flags + w;
        v.kind = (uint8_t *)(v.nodes + nodes) + line + 1;
        for (int64_t i = 0; i < line; i++) {
            memory[i] = memory[(h + 1) * line + i] = NAN;
        }
        for (int64_t i = 0; i < h; i++) {
            v.z[i * line - 1] = v.z[i * line + w] = NAN;
            if (s[CHECKED] > 0.0 && (i == 0 || s[RAY_X + 2] != 0.0)) { /* x of all rows is mostly the same */
                rays_of((double)(row + i), column, w, s + RAY_X, ray_x);
            }
            if (s[CHECKED] > 0.0 && (i == 0 || s[RAY_Y + 1] != 0.0)) {
                rays_of((double)(row + i), column, w, s + RAY_Y, ray_y);
            } else { /* and y of all columns */
                const float y = (float)(s[RAY_Y] + s[RAY_Y + 2] * (double)(row + i));
                for (int64_t j = 0; j < w; j++) {
                    ray_y[j] = y;
                }
            }
            least = read_row(&v, of->xyz + 3 * ((row + i) * of->across + column), i, s[CHECKED] > 0.0 ? ray_x : NULL, ray_y, least,
                             first + i * marks->across, found + 1, row_of_flags);
        }
        found[0] = label_nodes(&v, patches->number + row / stride * patches->w + column / stride, patches->w, patch, patches->min_nodes);
        if (found[0] >= 0) {
            grow(&v, labels);
            refine(&v, least, row_of_flags, labels, solid);
            for (int64_t i = 0; i < h; i++) { /* base pixels may lie between two patches: they belong to the first */
                uint8_t *mark = first + i * marks->across, *own = solid + i * w;
                uint8_t any = 0;
                for (int64_t j = 0; j < w; j++) {
                    any |= mark[j];
                    own[j] = ((own[j] == SOLID) | (own[j] == BASE)) & ~mark[j] & TAKEN;
                }
                for (int64_t j = 0; j < w && any & TAKEN; j++) {
                    labels[i * w + j] = mark[j] & TAKEN ? 0 : labels[i * w + j];
                }
                for (int64_t j = 0; j < w; j++) {
                    mark[j] |= own[j]; /* TAKEN is 1 */
                }
            }
        }
    }
    free(memory);
}

/* The end of the pixels from `first` that are solid with one label, or that are not solid. */
INLINE int64_t end_of_run(const int32_t *labels, const uint8_t *solid, int64_t first, int64_t end) {
    int64_t i = first + 1;
    if (!solid[first]) {
        const uint8_t *next = memchr(solid + i, 1, (size_t)(end - i));
        return next ? next - solid : end;
    }
    while (i < end && solid[i] && labels[i] == labels[first]) {
        i++;
    }
    return i;
}

/* The solid pixels of a window by label, in their order within.
 *
 * ends: (labels + 1), the end of each label in the list; the last is n, the number of solid pixels. pixels: (n), flat
 * indices into the image. points: (n, 3). columns: (3, n). bounds: (labels + 1, 6), smallest and largest x, y, z of each
 * label. tops: (labels + 1), the largest heights above the plane (4). */
VECTORISED void collect_members(const Labelled *of, const float *plane, int64_t n_labels, int64_t *ends, int64_t *pixels,
                                float *points, double *columns, float *bounds, float *tops) {
    memset(ends, 0, (size_t)(n_labels + 1) * sizeof(int64_t));
    for (int64_t i = 0; i < of->h; i++) {
        const int32_t *label = of->labels + i * of->w;
        for (int64_t j = 0, end; j < of->w; j = end) {
            end = end_of_run(label, of->solid + i * of->w, j, of->w);
            ends[label[j]] += of->solid[i * of->w + j] ? end - j : 0;
        }
    }
    int64_t n = 0;
    for (int64_t i = 0; i <= n_labels; i++) { /* of each label its start, which ends where the next one starts */
        const int64_t count = ends[i];
        ends[i] = n;
        n += count;
    }
    for (int64_t i = 0; i < of->h; i++) {
        const int32_t *label = of->labels + i * of->w;
        for (int64_t j = 0, end; j < of->w; j = end) {
            end = end_of_run(label, of->solid + i * of->w, j, of->w);
            if (of->solid[i * of->w + j]) {
                int64_t *to = pixels + ends[label[j]];
                ends[label[j]] += end - j;
                for (int64_t k = 0; k < end - j; k++) {
                    to[k] = (of->row + i) * of->across + of->column + j + k;
                }
            }
        }
    }
    int64_t start = 0;
    for (int64_t label = 0; label <= n_labels; start = ends[label++]) {
        float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, top = -INFINITY;
        for (int64_t i = start; i < ends[label]; i++) {
            const float *p = of->xyz + 3 * pixels[i];
            const float height = p[0] * plane[0] + p[1] * plane[1] + p[2] * plane[2] + plane[3];
            top = height > top ? height : top;
            for (int axis = 0; axis < 3; axis++) {
                points[3 * i + axis] = p[axis];
                columns[axis * n + i] = (double)p[axis];
                low[axis] = p[axis] < low[axis] ? p[axis] : low[axis];
                high[axis] = p[axis] > high[axis] ? p[axis] : high[axis];
            }
        }
        tops[label] = top;
        memcpy(bounds + 6 * label, low, sizeof low);
        memcpy(bounds + 6 * label + 3, high, sizeof high);
    }
}

/* Writes ids (labels + 1) by the labels of a window (h, w) into an image, where they are not 0; count: (1), of those. */
void write_ids(const int32_t *labels, int64_t h, int64_t w, int64_t row, int64_t column, const int32_t *ids, int64_t across,
               int32_t *image, int64_t *count) {
    int64_t written = 0;
    for (int64_t i = 0; i < h; i++) {
        const int32_t *own = labels + i * w;
        int32_t *line = image + (row + i) * across + column;
        for (int64_t j = 0; j < w; j += BLOCK) {
            const int64_t end = j + BLOCK < w ? j + BLOCK : w;
            int32_t any = 0; /* most of an image has no label */
            for (int64_t k = j; k < end; k++) {
                any |= own[k];
            }
            for (int64_t k = j; k < end && any; k++) {
                const int32_t id = own[k] ? ids[own[k]] : 0;
                line[k] = id ? id : line[k];
                written += id != 0;
            }
        }
    }
    count[0] = written;
}

/* How many of n pixels of an image have each of its labels, up to `last`. counts: (last + 1). */
void count_labels(const int32_t *labels, const int64_t *pixels, int64_t n, int64_t last, int64_t *counts) {
    int32_t label = 0;
    int64_t from = 0; /* the first pixel of a run with this label */
    memset(counts, 0, (size_t)(last + 1) * sizeof *counts);
    for (int64_t i = 0; i < n; i++) {
        const int32_t next = labels[pixels[i]];
        if (next != label) {
            counts[label] += i - from;
            label = next, from = i;
        }
    }
    counts[label] += n - from;
}

/* Every `stride`-th point of every `stride`-th row of an image of h x w points, and which of them are in range.
 *
 * coarse: (h', w', 3). index: (h' w'), their flat indices in it; count: (1), how many. */
void coarse_grid(const float *xyz, int64_t h, int64_t w, int64_t stride, double nearest, double farthest, float *coarse,
                 int64_t *index, int64_t *count) {
    const float near = (float)nearest, far = (float)farthest;
    int64_t found = 0, i = 0;
    for (int64_t row = 0; row < h; row += stride) {
        for (int64_t column = 0; column < w; column += stride, i++) {
            const float *p = xyz + 3 * (row * w + column);
            coarse[3 * i] = p[0];
            coarse[3 * i + 1] = p[1];
            coarse[3 * i + 2] = p[2];
            index[found] = i;
            found += (p[2] >= near) & (p[2] <= far);
        }
    }
    count[0] = found;
}

/* How much the inverse depth in small windows of a coarse grid (h, w, 3) deviates from that of a plane, which changes by the same step
 * from each point to the next: the root of the residual's mean square [1/m], of each window whose points are all in range. residuals: ((h / APART + 1) (w / APART + 1)), of which
 * `count` (1) are written. */
VECTORISED void window_residuals(const float *grid, int64_t h, int64_t w, double nearest, double farthest, double *residuals, int64_t *count) {
    int64_t found = 0;
    for (int64_t row = 0; row + WINDOW <= h; row += APART) {
        for (int64_t column = 0; column + WINDOW <= w; column += APART) {
            const float *first = grid + 3 * (row * w + column) + 2;
            const double middle = 1.0 / (double)first[3 * (WINDOW / 2) * (w + 1)];
            double sum = 0.0, across = 0.0, down = 0.0, squares = 0.0;
            int all = 1;
            for (int64_t i = 0; i < WINDOW; i++) {
                for (int64_t j = 0; j < WINDOW; j++) {
                    const double z = (double)first[3 * (i * w + j)], d = 1.0 / z - middle;
                    all &= (z >= nearest) & (z <= farthest);
                    sum += d, across += d * (double)(j - WINDOW / 2), down += d * (double)(i - WINDOW / 2), squares += d * d;
                }
            }
            const double n = WINDOW * WINDOW, spread = n * (n - 1.0) / 12.0; /* of the columns, and of the rows: sum of their squares */
            const double rest = squares - sum * sum / n - (across * across + down * down) / spread;
            residuals[found] = sqrt(rest > 0.0 ? rest / (n - 3.0) : 0.0);
            found += all;
        }
    }
    count[0] = found;
}

/* SPDX-License-Identifier: Apache-2.0 */
/* The image of a cloud as cloud/segmentation/organised_clusters.py labels it, whose functions define every step.
 *
 * `settings` are, in this order, float32 numbers but for the rays: */
#include "kernels.h"

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
    CONNECTED, /* depth per depth of connected neighbours, */
    SUPPORTED, /* and of those that support each other, */
    GAP,       /* or this depth, if larger [m] */
    TOP,       /* height that a patch must reach [m] */
    CHECKED,   /* whether rays are given */
    DEVIATION, /* largest distance from the ray, per depth */
    RAY_X,     /* x / z of the first pixel, per column, per row */
    RAY_Y = RAY_X + 3
};

#define BASE_FRACTION (1.0f / 3.0f)
#define MIN_SUPPORT 4
#define MIN_STRAIGHT 3

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

/* The first cell of a connected set, with which those of its other cells are numbered. */
INLINE int32_t root_of(int32_t *parent, int32_t i) {
    while (parent[i] != i) {
        parent[i] = parent[parent[i]];
        i = parent[i];
    }
    return i;
}

INLINE void join(int32_t *parent, int32_t i, int32_t j) {
    i = root_of(parent, i);
    j = root_of(parent, j);
    if (i < j) {
        parent[j] = i;
    } else {
        parent[i] = j;
    }
}

/* Patches of the coarse grid (h, w, 3) above the table; diagonal neighbours are in one patch.
 *
 * number: (h, w), from 1 in the order of their first pixels, without those of fewer than `min_nodes` pixels or nowhere
 * high. boxes: (h w / min_nodes + 1, 4), first row, end, first column, end of each. off: the image, of `across` columns;
 * 1 is written for pixels above the table but beside their ray. found: the number of patches, -1 without memory; and
 * whether there are such pixels. */
VECTORISED void grid_patches(const float *grid, int64_t h, int64_t w, int64_t stride, int64_t min_nodes, const double *settings,
                             int64_t across, uint8_t *off, int32_t *number, int64_t *boxes, int64_t *found) {
    if (h * w >= INT32_MAX) {
        found[0] = -1;
        return;
    }
    int32_t *parent = malloc((size_t)(h * w + 1) * sizeof(int32_t)), *count = calloc((size_t)(h * w + 1), sizeof(int32_t));
    uint8_t *tall = calloc((size_t)(h * w + 1), 1);
    double s[RAY_Y + 3];
    memcpy(s, settings, sizeof s);
    found[0] = -1;
    found[1] = 0;
    if (!parent || !count || !tall) {
        goto done;
    }
    for (int64_t row = 0; row < h; row++) {
        for (int64_t column = 0; column < w; column++) {
            const int64_t i = row * w + column;
            const float *p = grid + 3 * i;
            number[i] = is_above(height_of(p, s), p[2], s);
            parent[i] = (int32_t)i;
        }
        for (int64_t column = 0; column < w; column++) {
            const int64_t i = row * w + column;
            if (!number[i]) {
                continue;
            }
            if (s[CHECKED] > 0.0 && is_beside(grid + 3 * i, (double)(row * stride), (double)(column * stride), s)) {
                number[i] = 0;
                off[row * stride * across + column * stride] = 1;
                found[1] = 1;
                continue;
            }
            if (column && number[i - 1]) {
                join(parent, (int32_t)i, (int32_t)i - 1);
            }
            for (int64_t other = column - 1; row && other <= column + 1; other++) {
                if (other >= 0 && other < w && number[(row - 1) * w + other]) {
                    join(parent, (int32_t)i, (int32_t)((row - 1) * w + other));
                }
            }
        }
    }
    for (int64_t i = 0; i < h * w; i++) {
        if (number[i]) {
            const int32_t root = root_of(parent, (int32_t)i);
            count[root]++;
            tall[root] |= height_of(grid + 3 * i, s) > (float)s[TOP];
        }
    }
    int32_t last = 0;
    for (int64_t i = 0; i < h * w; i++) {
        if (!number[i]) {
            continue;
        }
        const int64_t root = root_of(parent, (int32_t)i), row = i / w, column = i % w;
        if (root == i) { /* the first of its patch: from here on its count is its number */
            const int keep = count[i] >= min_nodes && tall[i];
            count[i] = keep ? ++last : 0;
            if (keep) {
                int64_t *box = boxes + 4 * (last - 1);
                box[0] = row, box[1] = row + 1, box[2] = column, box[3] = column + 1;
            }
        }
        number[i] = count[root];
        if (number[i]) {
            int64_t *box = boxes + 4 * (number[i] - 1);
            box[1] = row + 1;
            box[2] = column < box[2] ? column : box[2];
            box[3] = column + 1 > box[3] ? column + 1 : box[3];
        }
    }
    found[0] = last;
done:
    free(parent);
    free(count);
    free(tall);
}

typedef struct {
    int64_t h, w, stride, gh, gw; /* size of the window, step and size of its part of the coarse grid */
    float *z, *height;            /* (h, w) */
    uint8_t *above;               /* (h, w) */
    int32_t *nodes;               /* (gh, gw), labels of the grid */
    const double *s;
} window;

/* Whether two neighbours of the grid, `step` pixels apart between each of `stride`, are joined. */
INLINE int is_joined(const window *v, int64_t first, int64_t step) {
    const float *z = v->z + first, *height = v->height + first;
    int hole = 0;
    if (height[0] <= threshold_at(z[0], v->s)) {
        return 0;
    }
    for (int64_t i = 0; i < v->stride; i++) {
        const float here = z[i * step], next = z[(i + 1) * step];
        hole |= here != here;
        if (fabsf(next - here) > step_at(here, v->s[CONNECTED], v->s) ||
            height[(i + 1) * step] <= threshold_at(next, v->s)) {
            return 0;
        }
    }
    const float allowed = (hole ? 1.0f : (float)v->stride) * step_at(z[0], v->s[CONNECTED], v->s);
    return fabsf(z[v->stride * step] - z[0]) <= allowed;
}

/* Labels the nodes of one patch and drops small components; the largest label, -1 without memory. */
INLINE int64_t label_nodes(window *v, const int32_t *patches, int64_t across, int64_t patch, int64_t min_nodes) {
    const int64_t gh = v->gh, gw = v->gw;
    int32_t *parent = malloc((size_t)(gh * gw + 1) * sizeof(int32_t)), *count = calloc((size_t)(gh * gw + 1), sizeof(int32_t));
    int64_t last = -1;
    if (parent && count) {
        for (int64_t row = 0; row < gh; row++) {
            for (int64_t column = 0; column < gw; column++) {
                const int32_t i = (int32_t)(row * gw + column);
                const int64_t pixel = row * v->stride * v->w + column * v->stride;
                v->nodes[i] = v->above[pixel] && patches[row * across + column] == patch;
                parent[i] = i;
                if (!v->nodes[i]) {
                    continue;
                }
                if (row && v->nodes[i - gw] && is_joined(v, pixel - v->stride * v->w, v->w)) {
                    join(parent, i, i - (int32_t)gw);
                }
                if (column && v->nodes[i - 1] && is_joined(v, pixel - v->stride, 1)) {
                    join(parent, i, i - 1);
                }
            }
        }
        for (int64_t i = 0; i < gh * gw; i++) {
            count[v->nodes[i] ? root_of(parent, (int32_t)i) : gh * gw]++;
        }
        last = 0;
        for (int64_t i = 0; i < gh * gw; i++) {
            if (v->nodes[i]) {
                const int32_t root = root_of(parent, (int32_t)i);
                if (root == i) {
                    count[i] = count[i] >= min_nodes ? (int32_t)++last : 0;
                }
                v->nodes[i] = count[root];
            }
        }
    }
    free(parent);
    free(count);
    return last;
}

/* The labels of the grid at full resolution. */
INLINE void grow(const window *v, int32_t *labels) {
    for (int64_t row = 0; row < v->h; row++) {
        const int64_t top = row / v->stride, bottom = top + 1 < v->gh ? top + 1 : top;
        for (int64_t cell = 0; cell < v->gw; cell++) {
            const int64_t right = cell + 1 < v->gw ? cell + 1 : cell, start = row * v->w + cell * v->stride;
            const int64_t at[4] = {top * v->gw + cell, top * v->gw + right, bottom * v->gw + cell, bottom * v->gw + right};
            const int64_t size = v->w - cell * v->stride < v->stride ? v->w - cell * v->stride : v->stride;
            int32_t most = 0;
            int shared = 0;
            for (int i = 0; i < 4; i++) {
                most = v->nodes[at[i]] > most ? v->nodes[at[i]] : most;
            }
            for (int i = 0; i < 4; i++) {
                shared |= v->nodes[at[i]] > 0 && v->nodes[at[i]] != most;
            }
            for (int64_t i = start; i < start + size; i++) {
                labels[i] = v->above[i] ? most : 0;
                if (!shared || !v->above[i]) {
                    continue;
                }
                int nearest = 0;
                float least = INFINITY;
                for (int j = 0; j < 4; j++) {
                    const float z = v->z[at[j] / v->gw * v->stride * v->w + at[j] % v->gw * v->stride];
                    const float apart = fabsf(z - v->z[i]);
                    if (v->nodes[at[j]] && apart < least) {
                        least = apart;
                        nearest = j;
                    }
                }
                labels[i] = v->nodes[at[nearest]];
            }
        }
    }
}

/* Differences in depth of the eight neighbours of a pixel, row by row; NaN beyond the window. */
INLINE void neighbour_steps(const window *v, int64_t row, int64_t column, float *steps) {
    int next = 0;
    for (int64_t i = row - 1; i <= row + 1; i++) {
        for (int64_t j = column - 1; j <= column + 1; j++) {
            if (i != row || j != column) {
                const int outside = i < 0 || i >= v->h || j < 0 || j >= v->w;
                steps[next++] = outside ? NAN : v->z[i * v->w + j] - v->z[row * v->w + column];
            }
        }
    }
}

INLINE int is_flying(const window *v, int64_t row, int64_t column) {
    const float near = step_at(v->z[row * v->w + column], v->s[SUPPORTED], v->s);
    float steps[8];
    int support = 0, straight = 0;
    neighbour_steps(v, row, column, steps);
    for (int i = 0; i < 8; i++) {
        support += fabsf(steps[i]) <= near;
    }
    for (int i = 0; i < 4; i++) {
        straight += fabsf(steps[i] + steps[7 - i]) <= near;
    }
    return support < MIN_SUPPORT && straight < MIN_STRAIGHT;
}

enum { NO, SOLID, FLYING, BASE }; /* of a pixel while the outlines are refined */

/* Removes flying pixels from the labels and adds base pixels; `solid` tells which are left or added. */
INLINE void refine(const window *v, int32_t *labels, uint8_t *solid) {
    const int64_t h = v->h, w = v->w;
    const float *z = v->z;
    float least = NAN;
    for (int64_t i = 0; i < h * w; i++) {
        least = z[i] == z[i] && !(least <= z[i]) ? z[i] : least;
    }
    const float limit = step_at(least, v->s[SUPPORTED], v->s);
    for (int64_t row = 0; row < h; row++) {
        const float *line = z + row * w, *before = row ? line - w : line, *after = row + 1 < h ? line + w : line;
        for (int64_t column = 0; column < w; column++) {
            solid[row * w + column] = labels[row * w + column] > 0;
        }
        for (int64_t column = 0; column < w; column++) { /* a cheap superset first, as in the reference */
            const float here = line[column], left = line[column ? column - 1 : 0], right = line[column + 1 < w ? column + 1 : column];
            const int jump = (fabsf(here - before[column]) > limit) | (fabsf(after[column] - here) > limit) |
                             (fabsf(here - left) > limit) | (fabsf(right - here) > limit);
            if (jump && labels[row * w + column] > 0 && is_flying(v, row, column)) {
                solid[row * w + column] = FLYING;
            }
        }
    }
    for (int64_t row = 0; row < h; row++) {
        for (int64_t column = 0; column < w; column++) {
            const int64_t i = row * w + column;
            const int64_t top = row ? row - 1 : 0, bottom = row + 1 < h ? row + 1 : row;
            const int64_t left = column ? column - 1 : 0, right = column + 1 < w ? column + 1 : column;
            if (solid[i] == FLYING) {
                int outline = 0;
                for (int64_t j = top; j <= bottom; j++) {
                    for (int64_t k = left; k <= right; k++) {
                        outline |= solid[j * w + k] == SOLID && labels[j * w + k] == labels[i];
                    }
                }
                labels[i] = outline ? labels[i] : -labels[i]; /* negative is removed below: others may still ask for it */
            } else if (!v->above[i]) {
                const float own = z[i], height = v->height[i], threshold = threshold_at(own, v->s);
                if (!(height > threshold * BASE_FRACTION && height <= threshold)) {
                    continue;
                }
                const float near = step_at(own, v->s[SUPPORTED], v->s);
                int32_t owner = 0;
                for (int64_t j = top; j <= bottom; j++) {
                    for (int64_t k = left; k <= right; k++) {
                        const int64_t other = j * w + k;
                        owner = solid[other] == SOLID && fabsf(z[other] - own) <= near ? labels[other] : owner;
                    }
                }
                if (owner) {
                    labels[i] = owner;
                    solid[i] = BASE;
                }
            }
        }
    }
    for (int64_t i = 0; i < h * w; i++) {
        solid[i] = solid[i] == SOLID || solid[i] == BASE;
        labels[i] = labels[i] > 0 ? labels[i] : 0;
    }
}

/* Labels one window of an image.
 *
 * xyz: the image, whose rows have `across` points; the window is at `row`, `column`, of h x w. patches: the coarse grid,
 * whose rows have `grid_across` numbers. taken: as the image, pixels that are solid in a window, which others leave out.
 * off: as of grid_patches, of any pixel in range. labels, solid: (h, w), written. found: the largest label, -1 without
 * memory; and whether a point is beside its ray. */
VECTORISED void label_window(const float *xyz, int64_t across, int64_t row, int64_t column, int64_t h, int64_t w,
                             const int32_t *patches, int64_t grid_across, int64_t stride, int64_t patch, int64_t min_nodes,
                             const double *settings, uint8_t *taken, uint8_t *off, int32_t *labels, uint8_t *solid,
                             int64_t *found) {
    double s[RAY_Y + 3];
    memcpy(s, settings, sizeof s);
    window v = {h, w, stride, (h + stride - 1) / stride, (w + stride - 1) / stride, NULL, NULL, NULL, NULL, s};
    v.z = malloc((size_t)(h * w) * sizeof(float) + 1);
    v.height = malloc((size_t)(h * w) * sizeof(float) + 1);
    v.above = malloc((size_t)(h * w) + 1);
    v.nodes = malloc((size_t)(v.gh * v.gw) * sizeof(int32_t) + 1);
    found[0] = -1;
    found[1] = 0;
    if (!v.z || !v.height || !v.above || !v.nodes || h * w >= INT32_MAX) {
        goto done;
    }
    for (int64_t i = 0; i < h; i++) {
        const float *line = xyz + 3 * ((row + i) * across + column);
        int32_t beside = 0;
        for (int64_t j = 0; j < w; j++) {
            const float *p = line + 3 * j;
            const float height = height_of(p, s);
            v.z[i * w + j] = p[2];
            v.height[i * w + j] = height;
            v.above[i * w + j] = (uint8_t)is_above(height, p[2], s);
        }
        for (int64_t j = 0; j < w && s[CHECKED] > 0.0; j++) {
            beside |= is_beside(line + 3 * j, (double)(row + i), (double)(column + j), s);
        }
        for (int64_t j = 0; j < w && beside; j++) {
            const float z = line[3 * j + 2];
            if (is_beside(line + 3 * j, (double)(row + i), (double)(column + j), s)) {
                if (z >= (float)s[NEAREST] && z <= (float)s[FARTHEST]) {
                    off[(row + i) * across + column + j] = 1;
                    found[1] = 1;
                }
                v.z[i * w + j] = v.height[i * w + j] = NAN;
                v.above[i * w + j] = 0;
            }
        }
    }
    found[0] = label_nodes(&v, patches + row / stride * grid_across + column / stride, grid_across, patch, min_nodes);
    if (found[0] >= 0) {
        grow(&v, labels);
        refine(&v, labels, solid);
    }
    for (int64_t i = 0; i < h && found[0] >= 0; i++) {
        uint8_t *line = taken + (row + i) * across + column;
        for (int64_t j = 0; j < w; j++) { /* base pixels may lie between two patches: they belong to the first */
            labels[i * w + j] = line[j] ? 0 : labels[i * w + j];
            solid[i * w + j] = line[j] ? 0 : solid[i * w + j];
            line[j] |= solid[i * w + j];
        }
    }
done:
    free(v.z);
    free(v.height);
    free(v.above);
    free(v.nodes);
}

/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"

#define LANES 8   /* walks at a time, each of which waits for its memory */
#define ROWS 64   /* rows at a time, so that a tree stays in the cache */

typedef struct {
    float threshold;  /* right where a column is above; infinite at a leaf */
    int32_t feature;  /* column of the row; 0 at a leaf */
    int32_t child[2]; /* left, right; of a leaf, itself */
} Node;

/* The value of a finite float16 by its bits. */
static inline float value_of(uint16_t half) {
    const uint32_t bits = (uint32_t)(half & 0x7fff) << 13, sign = (uint32_t)(half & 0x8000) << 16;
    float scaled;
    uint32_t result;
    memcpy(&scaled, &bits, sizeof scaled);
    scaled *= 0x1p112f; /* the exponents of float16 begin at -14, those of float32 at -126 */
    memcpy(&result, &scaled, sizeof result);
    result |= sign;
    memcpy(&scaled, &result, sizeof scaled);
    return scaled;
}

/* The sum as NumPy has it, of contiguous numbers: in pairs. */
static double pairwise(const double *a, int64_t n) {
    if (n < 8) {
        double sum = -0.0;
        for (int64_t i = 0; i < n; i++) {
            sum += a[i];
        }
        return sum;
    }
    if (n <= 128) {
        double r[8];
        int64_t i = 8;
        memcpy(r, a, sizeof r);
        for (; i < n - n % 8; i += 8) {
            for (int k = 0; k < 8; k++) {
                r[k] += a[i + k];
            }
        }
        double sum = ((r[0] + r[1]) + (r[2] + r[3])) + ((r[4] + r[5]) + (r[6] + r[7]));
        for (; i < n; i++) {
            sum += a[i];
        }
        return sum;
    }
    int64_t half = n / 2;
    half -= half % 8;
    return pairwise(a, half) + pairwise(a + half, n - half);
}

/* Leaves (trees, rows) of rows at the roots of all trees. */
static void find_leaves(
    const float *rows, int64_t count, int64_t columns, const Node *nodes, const int32_t *roots, int64_t trees, int32_t *at
) {
    const int64_t walks = trees * count;
    int64_t tree = 0, r = 0;
    for (int64_t start = 0; start < walks; start += LANES) {
        const int64_t lanes = walks - start < LANES ? walks - start : LANES;
        const float *row[LANES];
        int32_t node[LANES];
        for (int64_t k = 0; k < LANES; k++) { /* lanes without a walk repeat the last one */
            row[k] = rows + r * columns;
            node[k] = roots[tree];
            if (k < lanes - 1 || (k == lanes - 1 && start + lanes < walks)) {
                r = r + 1 < count ? r + 1 : 0;
                tree += r == 0;
            }
        }
        for (int32_t open = 1; open;) {
            open = 0;
            for (int k = 0; k < LANES; k++) {
                const Node *one = nodes + node[k];
                const int32_t next = one->child[row[k][one->feature] > one->threshold];
                open |= next ^ node[k];
                node[k] = next;
            }
        }
        memcpy(at + start, node, lanes * sizeof *at);
    }
}

/* Means over the trees of several forests of the values that rows (count, columns) reach.
 *
 * scratch: 64 times the most trees; single: as many as the most trees; result: (count, width). */
VECTORISED void forest_means(
    const float *rows, int64_t count, int64_t columns, const Forests *forests, int32_t *scratch, double *single,
    double *result
) {
    const Node *nodes = (const Node *)forests->nodes;
    const int64_t *leaf = forests->leaf, width = forests->width;
    const uint16_t *value = forests->value;
    for (int64_t start = 0; start < count; start += ROWS) {
        const int64_t block = count - start < ROWS ? count - start : ROWS;
        const int32_t *root = forests->roots;
        double *sums = result + start * width;
        for (int64_t f = 0; f < forests->count; f++) {
            const int64_t trees = forests->sizes[2 * f], outputs = forests->sizes[2 * f + 1];
            find_leaves(rows + start * columns, block, columns, nodes, root, trees, scratch);
            for (int64_t i = 0; i < block; i++) {
                double *sum = sums + i * width;
                if (outputs == 1) {
                    for (int64_t t = 0; t < trees; t++) {
                        single[t] = value_of(value[leaf[scratch[t * block + i]]]);
                    }
                    sum[0] = pairwise(single, trees) / (double)trees;
                    continue;
                }
                const uint16_t *first = value + leaf[scratch[i]];
                for (int64_t j = 0; j < outputs; j++) {
                    sum[j] = value_of(first[j]);
                }
                for (int64_t t = 1; t < trees; t++) {
                    const uint16_t *reached = value + leaf[scratch[t * block + i]];
                    for (int64_t j = 0; j < outputs; j++) {
                        sum[j] += value_of(reached[j]);
                    }
                }
                for (int64_t j = 0; j < outputs; j++) {
                    sum[j] /= (double)trees;
                }
            }
            root += trees;
            sums += outputs;
        }
    }
}

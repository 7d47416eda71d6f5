/* SPDX-License-Identifier: Apache-2.0 */
/* The order of an object's points, for grasp/preprocessing.py. */
#include "kernels.h"

#define DIGIT 11 /* bits sorted at once */
#define DIGITS 2048

/* The order of n points (n, 3) by x, then y, then z; equal ones keep theirs. order: (n); its first is -1 without memory. */
void canonical_order(const float *xyz, int64_t n, int64_t *order) {
    int64_t *other = n > 0 ? malloc((size_t)n * (sizeof(int64_t) + sizeof(uint32_t))) : NULL, *from = order, *to = other;
    if (!other) {
        memset(order, -1, n > 0 ? sizeof(int64_t) : 0);
        return;
    }
    uint32_t *keys = (uint32_t *)(other + n);
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
    free(other);
}

/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"

/* Hash of the files that the library was compiled from, given by build.py. */
const char *sources(void) { return SOURCES; }

/* Number of finite depths, and of those between low and high, of n points (n, 3). counts: (2). */
VECTORISED void count_range(const float *xyz, int64_t n, double low, double high, int64_t *counts) {
    const float near = (float)low, far = (float)high;
    int64_t finite = 0, within = 0;
    for (int64_t start = 0; start < n; start += 65536) {
        const int64_t stop = start + 65536 < n ? start + 65536 : n;
        int32_t some = 0, inside = 0; /* of a block, so that both are as wide as a depth */
        for (int64_t i = start; i < stop; i++) {
            const float z = xyz[3 * i + 2];
            some += (z - z) == 0.0f;
            inside += (z >= near) & (z <= far);
        }
        finite += some;
        within += inside;
    }
    counts[0] = finite;
    counts[1] = within;
}

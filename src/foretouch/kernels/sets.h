/* SPDX-License-Identifier: Apache-2.0 */
/* Connected sets of cells by union and find. */
#ifndef FORETOUCH_SETS_H
#define FORETOUCH_SETS_H

#include "kernels.h"

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

#endif

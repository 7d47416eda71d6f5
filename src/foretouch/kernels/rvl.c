/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"

/* A number of 3 bits a nibble, lowest first, whose highest bit says that another nibble follows; -1 if it has no end. Nibbles
 * stand in 32-bit words, little-endian, highest nibble first. */
static inline int64_t next_number(const uint8_t *data, int64_t nibbles, int64_t *at) {
    uint64_t value = 0;
    for (int shift = 0; shift < 33 && *at < nibbles; shift += 3) {
        const int64_t i = (*at)++;
        const uint8_t byte = data[(i >> 3) * 4 + 3 - ((i & 7) >> 1)];
        const uint8_t nibble = i & 1 ? byte & 15 : byte >> 4;
        value |= (uint64_t)(nibble & 7) << shift;
        if (!(nibble & 8)) return (int64_t)value;
    }
    return -1;
}

/* Decode a depth image of RVL (Wilson 2017): runs of zeros and of differences to the depth before. data: (4 words) bytes;
 * depth: (pixels); decoded: (1), the number of pixels before the data end, or contradict the size. */
void decode_rvl(const uint8_t *data, int64_t words, int64_t pixels, uint16_t *depth, int64_t *decoded) {
    const int64_t nibbles = 8 * words;
    int64_t at = 0, done = 0;
    uint16_t value = 0;
    *decoded = 0;
    while (done < pixels) {
        const int64_t zeros = next_number(data, nibbles, &at);
        if (zeros < 0 || zeros > pixels - done) return;
        memset(depth + done, 0, (size_t)zeros * sizeof *depth);
        done += zeros;
        *decoded = done;
        const int64_t others = next_number(data, nibbles, &at);
        if (others < 0 || others > pixels - done || (zeros == 0 && others == 0)) return;
        for (int64_t k = 0; k < others; k++) {
            const int64_t coded = next_number(data, nibbles, &at);
            if (coded < 0) return;
            value = (uint16_t)(value + ((coded >> 1) ^ -(coded & 1)));
            depth[done++] = value;
            *decoded = done;
        }
    }
}

/* SPDX-License-Identifier: Apache-2.0 */
/* An object and what is beside it in the depth image, for grasp/outline.py and grasp/unseen.py. All lengths are in metres. */
#include "kernels.h"

#define BEYOND 3 /* pixels beyond the last one of an object: of an edge, two mix both depths, one on either side */

/* The pixel of a place (3), or -1 where it is out of view. */
INLINE int64_t pixel_of(const Depths *image, const double *place) {
    const double *c = image->camera, row = rint(place[1] / place[2] * c[2] + c[3]), column = rint(place[0] / place[2] * c[0] + c[1]);
    const int inside = row >= 0.0 && column >= 0.0 && row < (double)image->h && column < (double)image->w;
    return inside ? (int64_t)row * image->w + (int64_t)column : -1;
}

/* The depth of a pixel; NaN without one, infinite out of view. */
INLINE float depth_of(const Depths *image, int64_t pixel) {
    if (pixel < 0 || image->xyz) {
        return pixel < 0 ? INFINITY : image->xyz[3 * pixel + 2];
    }
    const float depth = (image->whole ? (float)image->whole[pixel] : image->single[pixel]) * (float)image->scale;
    return depth > 0.0f && depth < INFINITY ? depth : NAN;
}

/* The outermost points of an object on either side of a line, in rows that are one pixel wide. found (4, 2, rows), the lower side first: number of the
 * outermost point of a row, -1 without one; its places along the line and beside it; and the mean place along it of those of the row that are at its
 * height and within two pixels of that, NaN without one. */
INLINE void outermost(const float *points, int64_t n, const double *frame, const double *settings, int64_t rows, double *found) {
    const double reach = settings[0], tip = settings[1], width = settings[2];
    double *number = found, *farthest = found + 2 * rows, *apart = found + 4 * rows, *face = found + 6 * rows;
    double *counts = calloc((size_t)rows * 2, sizeof(double));
    for (int64_t i = 0; i < 2 * rows; i++) {
        number[i] = -1.0, farthest[i] = apart[i] = NAN, face[i] = 0.0;
    }
    for (int64_t pass = 0; pass < 2 && counts; pass++) {
        for (int64_t i = 0; i < n; i++) {
            const double x = points[3 * i] - frame[9], y = points[3 * i + 1] - frame[10], z = points[3 * i + 2] - frame[11];
            const double beside = x * frame[3] + y * frame[4] + z * frame[5];
            if (!(fabs(beside) < reach)) {
                continue;
            }
            const double up = x * frame[6] + y * frame[7] + z * frame[8], along = x * frame[0] + y * frame[1] + z * frame[2];
            const int64_t row = (int64_t)((beside + reach) / width);
            if (!(up > -tip) || row >= rows) {
                continue;
            }
            for (int64_t side = 0; side < 2; side++) {
                const int64_t at = side * rows + row;
                const int farther = side ? along > farthest[at] : along < farthest[at];
                if (pass == 0 && (number[at] < 0.0 || farther)) {
                    number[at] = (double)i, farthest[at] = along, apart[at] = beside;
                }
                if (pass == 1 && fabs(up) < tip / 2.0 && fabs(along - farthest[at]) < 2.0 * width) {
                    face[at] += along, counts[at] += 1.0;
                }
            }
        }
    }
    for (int64_t i = 0; i < 2 * rows; i++) {
        face[i] = counts && counts[i] > 0.0 ? face[i] / counts[i] : NAN;
    }
    free(counts);
}

/* Where an object ends on either side along a line, as a mean over rows that are one pixel wide, the nearest with the largest weight.
 *
 * points (n, 3): all of it. own (h, w): its pixels in the image. frame (12): three directions of unit length, along the line, beside it and up, and a
 * place on it. settings: how far the first and the last row are beside it, radius of a fingertip, whose lower points do not count, width of a row, and
 * the largest difference of the depths of two pixels of one surface, for a pixel of no width and for each metre of its width.
 * found (4, 2, rows): see `outermost`. ends (2, 2): places along the line, the lower one first, NaN without a point; and the share of the rows that end on
 * the outline, half a pixel beyond the last one or in the middle of those that mix both depths; others end where their surface is. */
void outline_ends(const float *points, int64_t n, const uint8_t *own, const Depths *image, const double *frame, const double *settings, int64_t rows,
                  double *found, double *ends) {
    const double *number = found, *farthest = found + 2 * rows, *apart = found + 4 * rows, *face = found + 6 * rows;
    double depth = 0.0, count = 0.0;
    outermost(points, n, frame, settings, rows, found);
    for (int64_t i = 0; i < 2 * rows; i++) {
        if (number[i] >= 0.0) {
            depth += (double)points[3 * (int64_t)number[i] + 2], count += 1.0;
        }
    }
    const double step = depth / count / ((fabs(image->camera[0]) + fabs(image->camera[2])) / 2.0);
    const float apart_m = (float)(settings[3] + settings[4] * step);
    for (int64_t side = 0; side < 2; side++) {
        const double outwards = side ? 1.0 : -1.0;
        double total = 0.0, sum = 0.0, outline = 0.0;
        for (int64_t i = side * rows; i < (side + 1) * rows; i++) {
            if (number[i] < 0.0) {
                continue;
            }
            const float *last = points + 3 * (int64_t)number[i];
            float depths[BEYOND];
            int on_outline = 0, settled[BEYOND - 1];
            for (int64_t k = 0; k < BEYOND; k++) {
                const double m = (double)(k + 1) * step * outwards;
                const double place[3] = {last[0] + m * frame[0], last[1] + m * frame[1], last[2] + m * frame[2]};
                const int64_t pixel = pixel_of(image, place);
                depths[k] = depth_of(image, pixel), on_outline |= pixel < 0 || !own[pixel];
            }
            for (int64_t k = 0; k < BEYOND - 1; k++) {
                settled[k] = fabsf(depths[k + 1] - depths[k]) < apart_m;
            }
            const double mixed = settled[0] ? 0.0 : settled[1] ? 1.0 : 2.0, weight = 1.0 - fabs(apart[i]) / settings[0];
            const double beyond = farthest[i] + 0.5 * settings[2] * outwards * (1.0 + mixed);
            total += weight, outline += on_outline ? weight : 0.0;
            sum += weight * (on_outline ? beyond : isnan(face[i]) ? farthest[i] : face[i]);
        }
        ends[side] = sum / total, ends[2 + side] = outline / total;
    }
}

/* How far pixels without depth reach outwards from n contacts (n, 3) along directions (n, 3), beyond what is expected beside any object: 0 where the camera
 * sees through the way of the finger, or what is in front of it, or nothing.
 *
 * steps: on the way. settings: length of one, the depth behind a place from which on the camera sees through it, the baseline of a stereo camera, and what
 * is expected besides, in metres and in pixels. beyond (n). */
void unseen_beyond(const double *contacts, const double *outwards, int64_t n, const Depths *image, int64_t steps, const double *settings, double *beyond) {
    for (int64_t i = 0; i < n; i++) {
        int64_t first = -1, last = steps;
        double near = 0.0, far = INFINITY;
        for (int64_t k = 0; k < steps && last == steps; k++) {
            const double *from = contacts + 3 * i, *to = outwards + 3 * i, m = (double)k * settings[0];
            const double place[3] = {from[0] + m * to[0], from[1] + m * to[1], from[2] + m * to[2]};
            const float depth = depth_of(image, pixel_of(image, place));
            if (first < 0 && depth > place[2] + settings[1]) {
                break; /* seen through, also what is out of view */
            }
            if (first < 0 && isnan(depth)) {
                first = k, near = place[2];
            } else if (first >= 0 && !isnan(depth)) {
                last = k, far = depth;
            }
        }
        const double shadow = last < steps ? settings[2] * fabs(1.0 - near / far) : 0.0;
        const double left = (double)(last - first) * settings[0] - (shadow + (settings[3] + settings[4] * near / image->camera[0]));
        beyond[i] = first >= 0 && left > 0.0 ? left : 0.0;
    }
}

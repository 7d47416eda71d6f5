/* SPDX-License-Identifier: Apache-2.0 */
/* An object along horizontal closing lines, for grasp/completed.py. All lengths are in metres. */
#include "kernels.h"

#define HEIGHT_M 0.001f /* of a bin of the histogram of heights */
#define ALONG_M 0.0005f /* of a bin of the histogram along a line */
#define HEIGHTS 640     /* bins: no object is higher than 0.6 m */
#define ALONGS 2560     /* bins: nor longer than 1.2 m */
#define STEPS 24        /* places of a column that are tried for free space */
#define END_M 0.003f    /* from either end of a line are the points that have the height of the end */
#define SEEN_M 0.003    /* in front of the nearest point, where a place still counts as hidden */
#define FOUND 6         /* values of a line */

typedef struct {
    const double *camera; /* rotation (9) and origin (3) of the table's frame in the camera's; column, row and pitch of the grid */
    const float *nearest; /* (rows, columns) depth of the nearest point of a cell, infinite in a gap, 0 outside of the outline */
    int64_t rows, columns;
} Outline;

/* Whether a place of the table's frame is behind the object's nearest point on its ray, by a margin. */
INLINE int is_hidden(const Outline *seen, double x, double y, double z, double margin) {
    const double *c = seen->camera, depth = c[6] * x + c[7] * y + c[8] * z + c[11];
    if (!(depth > 0.0)) {
        return 0;
    }
    const double column = floor(((c[0] * x + c[1] * y + c[2] * z + c[9]) / depth - c[12]) / c[14]);
    const double row = floor(((c[3] * x + c[4] * y + c[5] * z + c[10]) / depth - c[13]) / c[14]);
    if (!(column >= 0.0 && row >= 0.0 && column < (double)seen->columns && row < (double)seen->rows)) {
        return 0;
    }
    const float nearest = seen->nearest[(int64_t)row * seen->columns + (int64_t)column];
    return nearest != 0.0f && (isinf(nearest) || depth >= (double)nearest + margin);
}

/* hidden (n): 1 for each of the points (n, 3) that the object hides from the camera, by a margin. */
void hidden_points(const double *points, int64_t n, double margin, const double *camera, const float *nearest, int64_t rows,
                   int64_t columns, uint8_t *hidden) {
    const Outline seen = {camera, nearest, rows, columns};
    for (int64_t i = 0; i < n; i++) {
        hidden[i] = (uint8_t)is_hidden(&seen, points[3 * i], points[3 * i + 1], points[3 * i + 2], margin);
    }
}

INLINE double smooth(double value, double low, double high) {
    const double t = (value - low) / (high - low), inside = t < 0.0 ? 0.0 : (t > 1.0 ? 1.0 : t);
    return inside * inside * (3.0 - 2.0 * inside);
}

typedef struct {
    float *bins;
    int64_t from, to; /* bins in use */
    double total;
} Histogram;

INLINE void clear(Histogram *one, int64_t from, int64_t to) {
    one->from = from, one->to = to, one->total = 0.0;
    memset(one->bins + from, 0, (size_t)(to - from + 1) * sizeof(float));
}

/* Interpolated quantile, in bins. */
INLINE double quantile(const Histogram *one, double share) {
    double left = share * one->total;
    for (int64_t i = one->from; i <= one->to; i++) {
        const double bin = one->bins[i];
        if (bin > 0.0 && bin >= left) {
            return (double)i + left / bin;
        }
        left -= bin;
    }
    return (double)one->to + 1.0;
}

/* The points of one strip, which lie one after the other. */
typedef struct {
    const float *along, *height, *weight;
    int64_t n;
} Strip;

/* Ends of a strip along its line: quantiles of the points above a height. */
INLINE void ends(const Strip *one, Histogram *bins, float above, double share, double *low, double *high) {
    float least = INFINITY, most = -INFINITY;
    for (int64_t i = 0; i < one->n; i++) {
        least = one->along[i] < least ? one->along[i] : least;
        most = one->along[i] > most ? one->along[i] : most;
    }
    clear(bins, (int64_t)least, (int64_t)most);
    for (int64_t i = 0; i < one->n; i++) {
        bins->bins[(int32_t)one->along[i]] += one->height[i] > above ? one->weight[i] : 0.0f;
    }
    for (int64_t i = bins->from; i <= bins->to; i++) {
        bins->total += bins->bins[i];
    }
    *low = quantile(bins, share);
    *high = quantile(bins, 1.0 - share);
}

/* Median height of the points of a strip before (sign -1) or beyond (sign 1) a place along its line [bins]. */
INLINE double height_at_end(const Strip *one, Histogram *bins, float place, float sign) {
    clear(bins, bins->from, bins->to);
    for (int64_t i = 0; i < one->n; i++) {
        if (sign * (one->along[i] - place) > 0.0f) {
            bins->bins[(int64_t)one->height[i]] += one->weight[i];
            bins->total += one->weight[i];
        }
    }
    return quantile(bins, 0.5);
}

/* Height of the underside of a body that is as thick as it is wide, as an arch seen from above; 0 if the points speak for walls.
 *
 * Evidence are ends that are seen well below the top, and nothing that is seen lower than the underside of a round body is seen. */
INLINE double round_underside(double top, double lowest, double end, double width, double horizontal) {
    const double radius = width / 2.0, below = lowest - (top - radius - radius * horizontal);
    const double tall = smooth(top / width, 1.2, 1.5), none = smooth(below, -0.4 * radius, -0.2 * radius);
    const double bent = smooth(top - end, 0.25 * radius, 0.5 * radius), from_above = 1.0 - smooth(horizontal, 0.3, 0.5);
    const double underside = top - width;
    return underside > 0.0 ? tall * none * bent * from_above * underside : 0.0;
}

/* The object along `angles` x `lines` horizontal lines about a vertical axis, whose fingers close at a height between the top and the underside.
 *
 * points (n, 3), weights (n): of the object, in the table's frame (z = 0), x and y from the axis, |x| and |y| below 0.6 m.
 * settings: distance of the lines, radius of a fingertip, lowest height of its centre, share of the points beyond either end, horizontal
 * part of the direction of view, shift of the height from the middle, length of the way in. others (m, 3): what stands around.
 * found (angles, lines, 6): both ends, height, top, the first of `others` in the way of a finger, or -1, and the weight of the points. Ends are
 * NaN where the line meets no points or there is no memory. */
VECTORISED void closing_lines(const double *points, const double *weights, int64_t n, int64_t angles, int64_t lines,
                              const double *settings, const double *camera, const float *nearest, int64_t rows, int64_t columns,
                              const double *others, int64_t m, double *found) {
    const double step = settings[0], tip = settings[1], floor_m = settings[2], share = settings[3], horizontal = settings[4];
    const double shift = settings[5], way = settings[6], middle = ALONGS / 2;
    const Outline seen = {camera, nearest, rows, columns};
    const int64_t bins = lines + 2;
    float *memory = malloc(((size_t)n * 9 + HEIGHTS + ALONGS + 8) * sizeof(float));
    int64_t *start = malloc((size_t)(bins + 1) * sizeof(int64_t)), used = 0, highest = 0;
    for (int64_t i = 0; i < angles * lines * FOUND; i++) {
        found[i] = NAN;
    }
    if (!memory || !start) {
        free(memory), free(start);
        return;
    }
    float *along = memory, *height = along + n, *weight = height + n, *x = weight + n, *y = x + n, *level = y + n, *share_of = level + n;
    float *place = share_of + n, *beside = place + n;
    Histogram heights = {beside + n, 0, 0, 0.0}, alongs = {beside + n + HEIGHTS, 0, 0, 0.0};
    for (int64_t i = 0; i < n; i++) {
        if (weights[i] > 0.0) {
            const double bin = points[3 * i + 2] / (double)HEIGHT_M;
            level[used] = bin < 0.0 ? 0.0f : (bin > HEIGHTS - 1.0 ? HEIGHTS - 1.0f : (float)bin);
            highest = (int64_t)level[used] > highest ? (int64_t)level[used] : highest;
            x[used] = (float)points[3 * i], y[used] = (float)points[3 * i + 1], share_of[used] = (float)weights[i];
            used++;
        }
    }
    for (int64_t angle = 0; angle < angles; angle++) {
        const double turn = 3.14159265358979323846 * (double)angle / (double)angles, c = cos(turn), s = sin(turn);
        const float c_place = (float)c / ALONG_M, s_place = (float)s / ALONG_M, c_line = (float)(c / step), s_line = (float)(s / step);
        const float first = (float)(bins / 2) + 0.5f, last = (float)bins;
        memset(start, 0, (size_t)(bins + 1) * sizeof(int64_t));
        for (int64_t i = 0; i < used; i++) {
            const float value = x[i] * c_place + y[i] * s_place + (float)middle;
            place[i] = value < 0.0f ? 0.0f : (value > ALONGS - 1.0f ? ALONGS - 1.0f : value);
            beside[i] = y[i] * c_line - x[i] * s_line + first;
        }
        for (int64_t i = 0; i < used; i++) {
            if (beside[i] >= 0.0f && beside[i] < last) {
                start[(int32_t)beside[i] + 1]++;
            }
        }
        for (int64_t j = 0; j < bins; j++) {
            start[j + 1] += start[j];
        }
        for (int64_t i = 0; i < used; i++) { /* sorted by strips of one step; afterwards start[j] is the end of strip j */
            if (beside[i] >= 0.0f && beside[i] < last) {
                const int64_t at = start[(int32_t)beside[i]]++;
                along[at] = place[i], height[at] = level[i], weight[at] = share_of[i];
            }
        }
        for (int64_t line = 0; line < lines; line++) {
            const int64_t from = line ? start[line - 1] : 0;
            const Strip strip = {along + from, height + from, weight + from, start[line + 2] - from};
            double *one = found + (angle * lines + line) * FOUND, low, high;
            if (strip.n < 8) {
                continue;
            }
            ends(&strip, &alongs, -1.0f, share, &low, &high);
            clear(&heights, 0, highest);
            for (int64_t i = 0; i < strip.n; i++) {
                heights.bins[(int32_t)strip.height[i]] += strip.weight[i];
            }
            heights.total = alongs.total;
            const double top = quantile(&heights, 0.95) * (double)HEIGHT_M, lowest = quantile(&heights, 0.03) * (double)HEIGHT_M;
            const double width = (high - low) * (double)ALONG_M, offset = ((double)(line + 1 - bins / 2)) * step;
            const double mid = ((low + high) / 2.0 - middle) * (double)ALONG_M;
            double under = 0.0;
            for (int64_t k = 2; k <= STEPS; k++) { /* downwards from the top, until the table is seen through the column */
                const double z = top * (1.0 - (double)k / STEPS);
                if (rows > 0 && !is_hidden(&seen, c * mid - s * offset, s * mid + c * offset, z, -SEEN_M)) {
                    under = z;
                    break;
                }
            }
            if (horizontal < 0.5 && top > 1.2 * width && width > 0.0) {
                const float at_end = END_M / ALONG_M;
                const double first = height_at_end(&strip, &heights, (float)low + at_end, -1.0f);
                const double second = height_at_end(&strip, &heights, (float)high - at_end, 1.0f);
                const double end = (first > second ? first : second) * (double)HEIGHT_M;
                const double round = round_underside(top, lowest, end, width, horizontal);
                under = round > under ? round : under;
            }
            double z = (top + under) / 2.0 + shift;
            z = z > top - tip / 2.0 ? top - tip / 2.0 : z;
            z = z < under ? under : z;
            z = z < floor_m ? floor_m : z;
            ends(&strip, &alongs, (float)((z - tip) / (double)HEIGHT_M), share, &low, &high);
            if (!(alongs.total >= 4.0)) {
                continue;
            }
            one[0] = (low - middle) * (double)ALONG_M, one[1] = (high - middle) * (double)ALONG_M;
            one[2] = z, one[3] = top, one[4] = -1.0, one[5] = alongs.total;
            for (int64_t i = 0; i < m && one[4] < 0.0; i++) {
                const double x = c * others[3 * i] + s * others[3 * i + 1], y = c * others[3 * i + 1] - s * others[3 * i];
                const int beside = fabs(y - offset) < tip && others[3 * i + 2] > z - tip;
                const int outside = (x > one[0] - way && x < one[0]) || (x > one[1] && x < one[1] + way);
                one[4] = beside && outside ? (double)i : -1.0;
            }
        }
    }
    free(memory), free(start);
}

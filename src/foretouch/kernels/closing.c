/* SPDX-License-Identifier: Apache-2.0 */
/* An object along horizontal closing lines, for grasp/completed.py. All lengths are in metres. */
#include "kernels.h"

#define HEIGHT_M 0.001f /* of a bin of the histogram of heights */
#define ALONG_M 0.0005f /* of a bin of the histogram along a line */
#define HEIGHTS 640     /* bins: no object is higher than 0.6 m */
#define ALONGS 2560     /* bins: nor longer than 1.2 m */
#define STEPS 16        /* places of a column that are tried for free space */
#define FADE 4.0f       /* bins of height over which points fade out below the fingertips */
#define SIDE 0.2f       /* of the width, from either end, where the height of a side is measured */
#define AROUND 0.15f    /* of the width, on either side of that place */
#define INSET_M 0.004   /* from either end, where a line must meet the object */
#define SEEN_M 0.003    /* in front of the nearest point, where a place still counts as hidden */
#define LEAST 0.5       /* of the share beyond an end, from which on its place is a mean */
#define MOST 2.5        /* up to which */
#define OUTWARDS 0.75   /* shares of a line by which its ends move outwards: half of what these means leave out */
#define FADE_M 0.002    /* before and behind such a depth, over which it fades */
#define FOUND 6         /* values of a line */

typedef struct {
    const double *camera; /* rotation (9) and origin (3) of the table's frame in the camera's; column, row and pitch of the grid */
    const float *nearest; /* (rows, columns) depth of the nearest point of a cell, infinite in a gap */
    const float *inside;  /* (rows, columns) how certainly a cell is inside of the outline, 0 ... 1 */
    int64_t rows, columns;
} Outline;

INLINE double smooth(double value, double low, double high) {
    const double t = (value - low) / (high - low), inside = t < 0.0 ? 0.0 : (t > 1.0 ? 1.0 : t);
    return inside * inside * (3.0 - 2.0 * inside);
}

/* The largest (sign 1) or smallest (-1) of each cell and its neighbours up to two cells away, first along rows, then along columns; the
 * two cells at the border are left as they are. values, other: (rows, columns); the result is in `values`. */
INLINE void widen(float *values, float *other, int64_t rows, int64_t columns, float sign) {
    for (int64_t axis = 0; axis < 2; axis++) {
        const int64_t step = axis ? columns : 1;
        const float *from = axis ? other : values;
        float *to = axis ? values : other;
        for (int64_t i = 2 * step; i < rows * columns - 2 * step; i++) {
            float best = sign * from[i - 2 * step];
            for (int64_t k = -1; k <= 2; k++) {
                best = sign * from[i + k * step] > best ? sign * from[i + k * step] : best;
            }
            to[i] = sign * best;
        }
    }
}

/* The outline of n points (n, 3) in front of the camera, in cells of grid[2] from column grid[0] and row grid[1] on, with four empty cells around.
 *
 * nearest (rows, columns): depth of the nearest point, infinite without one. inside (rows, columns): 0 ... 1, each point counts for the four
 * cells around it, one in all; gaps narrower than five cells are closed. It is continuous in the points. inside[0] is NaN without memory. */
void outline(const double *points, int64_t n, const double *grid, int64_t rows, int64_t columns, float *nearest, float *inside) {
    float *other = calloc((size_t)(rows * columns), sizeof(float));
    for (int64_t i = 0; i < rows * columns; i++) {
        nearest[i] = INFINITY, inside[i] = 0.0f;
    }
    if (!other) {
        inside[0] = NAN;
        return;
    }
    for (int64_t i = 0; i < n; i++) {
        const double depth = points[3 * i + 2];
        const double column = (points[3 * i] / depth - grid[0]) / grid[2], row = (points[3 * i + 1] / depth - grid[1]) / grid[2];
        float *cell = nearest + (int64_t)row * columns + (int64_t)column;
        *cell = (float)depth < *cell ? (float)depth : *cell;
        const int64_t left = (int64_t)(column - 0.5), up = (int64_t)(row - 0.5);
        const float right = (float)(column - 0.5 - (double)left), down = (float)(row - 0.5 - (double)up);
        float *first = inside + up * columns + left;
        first[0] += (1.0f - right) * (1.0f - down), first[1] += right * (1.0f - down);
        first[columns] += (1.0f - right) * down, first[columns + 1] += right * down;
    }
    for (int64_t i = 0; i < rows * columns; i++) {
        inside[i] = inside[i] > 1.0f ? 1.0f : inside[i];
    }
    widen(inside, other, rows, columns, 1.0f);
    widen(inside, other, rows, columns, -1.0f);
    free(other);
}

/* How certainly a place of the table's frame is hidden by the object, 0 ... 1, around a depth behind its nearest point on the ray. */
INLINE double hidden_by(const Outline *seen, double x, double y, double z, double depth_behind) {
    const double *c = seen->camera, depth = c[6] * x + c[7] * y + c[8] * z + c[11];
    if (!(depth > 0.0)) {
        return 0.0;
    }
    const double column = floor(((c[0] * x + c[1] * y + c[2] * z + c[9]) / depth - c[12]) / c[14]);
    const double row = floor(((c[3] * x + c[4] * y + c[5] * z + c[10]) / depth - c[13]) / c[14]);
    if (!(column >= 0.0 && row >= 0.0 && column < (double)seen->columns && row < (double)seen->rows)) {
        return 0.0;
    }
    const int64_t cell = (int64_t)row * seen->columns + (int64_t)column;
    const float nearest = seen->nearest[cell];
    const double behind = isinf(nearest) ? 1.0 : depth - (double)nearest;
    return (double)seen->inside[cell] * smooth(behind, depth_behind - FADE_M, depth_behind + FADE_M);
}

/* hidden (n): how certainly the object hides each of the points (n, 3) from the camera, 0 ... 1, around a depth behind it. */
void hidden_points(const double *points, int64_t n, double depth, const double *camera, const float *nearest, const float *inside,
                   int64_t rows, int64_t columns, double *hidden) {
    const Outline seen = {camera, nearest, inside, rows, columns};
    for (int64_t i = 0; i < n; i++) {
        hidden[i] = hidden_by(&seen, points[3 * i], points[3 * i + 1], points[3 * i + 2], depth);
    }
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

/* Mean of the quantiles from one share to another, in bins, from below (sign 1) or above (-1): it moves little where few points decide. */
INLINE double mean_quantile(const Histogram *one, double first, double last, int64_t sign) {
    const double from = first * one->total, to = last * one->total;
    double below = 0.0, sum = 0.0;
    for (int64_t i = sign > 0 ? one->from : one->to; i >= one->from && i <= one->to && below < to; i += sign) {
        const double bin = one->bins[i], above = below + bin;
        const double a = below > from ? below : from, b = above < to ? above : to;
        if (b > a) {
            sum += (b - a) * ((double)(i + (sign < 0)) + (double)sign * ((a + b) / 2.0 - below) / bin);
        }
        below = above;
    }
    return to > from ? sum / (to - from) : (double)one->to;
}

/* The points of one strip, which lie one after the other. */
typedef struct {
    const float *along, *height, *weight;
    int64_t n, first, last; /* number of points; first and last bin along the line */
    float *faded;           /* place for n weights */
} Strip;

/* Ends of a strip along its line: quantiles of the points above a height [bins]. */
INLINE void ends(const Strip *one, Histogram *bins, float above, double share, double *low, double *high) {
    float total = 0.0f;
    clear(bins, one->first, one->last);
    for (int64_t i = 0; i < one->n; i++) {
        const float part = (one->height[i] - above) / FADE + 0.5f, positive = part < 0.0f ? 0.0f : part;
        one->faded[i] = one->weight[i] * (positive > 1.0f ? 1.0f : positive);
    }
    for (int64_t i = 0; i < one->n; i++) {
        bins->bins[(int32_t)one->along[i]] += one->faded[i];
        total += one->faded[i];
    }
    bins->total = total;
    const double first = mean_quantile(bins, LEAST * share, MOST * share, 1);
    const double last = mean_quantile(bins, LEAST * share, MOST * share, -1);
    const double beyond = OUTWARDS * share * (last - first); /* of what an even density leaves beyond such a mean */
    *low = first - beyond > 0.0 ? first - beyond : 0.0;
    *high = last + beyond < ALONGS - 1.0 ? last + beyond : ALONGS - 1.0;
}

/* Mean height of the points of a strip around a place along its line [bins], the nearest with the largest weight. */
INLINE double height_around(const Strip *one, double place, double reach) {
    float sum = 0.0f, total = 1e-9f;
    for (int64_t i = 0; i < one->n; i++) {
        const float near = 1.0f - fabsf(one->along[i] - (float)place) / (float)reach, share = near < 0.0f ? 0.0f : near;
        sum += one->weight[i] * share * one->height[i], total += one->weight[i] * share;
    }
    return (double)(sum / total);
}

/* Height of the underside of a body that is as thick as it is wide, as an arch seen from above; 0 if the points speak for walls.
 *
 * Evidence are sides that are seen below the top, and that nothing is seen below the side of a round body. */
INLINE double round_underside(double top, double lowest, double side, double width, double horizontal) {
    const double radius = width / 2.0, below = lowest - (top - radius - radius * horizontal);
    const double tall = smooth(top / width, 1.2, 1.5), none = smooth(below, -0.4 * radius, -0.1 * radius);
    const double bent = smooth(top - side, 0.06 * radius, 0.22 * radius), from_above = 1.0 - smooth(horizontal, 0.3, 0.5);
    const double underside = top - width;
    return underside > 0.0 ? tall * none * bent * from_above * underside : 0.0;
}

/* The middle of what the object hides of its column, as a mean over three columns along a line, whose middle is at `mid`: half of the height,
 * unless the camera sees through the column. Its top is the object's own. */
INLINE double hidden_middle(const Outline *seen, double c, double s, double mid, double offset, double top, double tip) {
    double sum = 0.0, moment = 0.0;
    for (int64_t j = -1; j <= 1; j++) {
        const double along = mid + (double)j * tip / 2.0, x = c * along - s * offset, y = s * along + c * offset;
        for (int64_t k = 0; k < STEPS; k++) {
            const double z = top * (1.0 - ((double)k + 0.5) / STEPS), hidden = k < 2 ? 1.0 : hidden_by(seen, x, y, z, -SEEN_M);
            sum += hidden, moment += hidden * z;
        }
    }
    return moment / sum;
}

/* How certainly the object hides both ends of a line at a height from the camera, 0 ... 1: 0 where it is seen through. */
INLINE double hidden_ends(const Outline *seen, double c, double s, const double *ends, double offset, double z) {
    const double half = (ends[1] - ends[0]) / 2.0, inset = half < INSET_M ? half : INSET_M;
    const double low = ends[0] + inset, high = ends[1] - inset;
    return (hidden_by(seen, c * low - s * offset, s * low + c * offset, z, -SEEN_M) +
            hidden_by(seen, c * high - s * offset, s * high + c * offset, z, -SEEN_M)) / 2.0;
}

/* The object along `angles` x `lines` horizontal lines, on which two fingers close at a height between its top and its underside.
 *
 * points (n, 3), weights (n): of the object, in the table's frame (z = 0), x and y from the axis, |x| and |y| below 0.6 m.
 * turns (angles, 3): direction of the lines [rad], how far the middle one is beside the axis, and their height, or NaN if it follows from the points.
 * settings: distance of the lines, radius of a fingertip, lowest height of its centre, share of the points beyond either end, horizontal part of the
 * direction of view, shift of the height from the middle, length of the way in. others (m, 3): what stands around.
 * found (angles, lines, 6): both ends, height, top, the first of `others` in the way of a finger, or -1, and how certainly the object is at both ends,
 * 0 ... 1. The first two and the last two are NaN where a fingertip meets no points, and all where the line meets none or there is no memory. */
VECTORISED void closing_lines(const double *points, const double *weights, int64_t n, const double *turns, int64_t angles,
                              int64_t lines, const double *settings, const double *camera, const float *nearest, const float *inside, int64_t rows, int64_t columns,
                              const double *others, int64_t m, double *found) {
    const double step = settings[0], tip = settings[1], floor_m = settings[2], share = settings[3], horizontal = settings[4];
    const double shift = settings[5], way = settings[6], middle = ALONGS / 2;
    const Outline seen = {camera, nearest, inside, rows, columns};
    const int64_t bins = lines + 3; /* bin j holds what is from (j - bins / 2) to (j + 1 - bins / 2) steps beside the middle */
    float *memory = malloc(((size_t)n * 12 + HEIGHTS + ALONGS + 8) * sizeof(float));
    int64_t *start = malloc((size_t)(bins + 1) * 3 * sizeof(int64_t)), used = 0, highest = 0;
    for (int64_t i = 0; i < angles * lines * FOUND; i++) {
        found[i] = NAN;
    }
    if (!memory || !start) {
        free(memory), free(start);
        return;
    }
    float *along = memory, *height = along + n, *weight = height + n, *x = weight + n, *y = x + n, *level = y + n, *share_of = level + n;
    float *place = share_of + n, *beside = place + n, *across = beside + n, *tent = across + n, *faded = tent + n;
    int64_t *least = start + bins + 1, *most = least + bins; /* bins along the line of the points in each strip of one step */
    Histogram heights = {faded + n, 0, 0, 0.0}, alongs = {faded + n + HEIGHTS, 0, 0, 0.0};
    for (int64_t i = 0; i < n; i++) {
        if (weights[i] > 0.0) {
            const double bin = points[3 * i + 2] / (double)HEIGHT_M;
            level[used] = bin < 0.0 ? 0.0f : (bin > HEIGHTS - 2.0 ? HEIGHTS - 2.0f : (float)bin);
            highest = (int64_t)level[used] > highest ? (int64_t)level[used] : highest;
            x[used] = (float)points[3 * i], y[used] = (float)points[3 * i + 1], share_of[used] = (float)weights[i];
            used++;
        }
    }
    for (int64_t angle = 0; angle < angles; angle++) {
        const double c = cos(turns[3 * angle]), s = sin(turns[3 * angle]), beside_m = turns[3 * angle + 1];
        const float c_place = (float)c / ALONG_M, s_place = (float)s / ALONG_M, c_line = (float)(c / step), s_line = (float)(s / step);
        const float first = (float)((double)(bins / 2) - beside_m / step), last = (float)bins;
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
            least[j] = ALONGS, most[j] = 0;
        }
        for (int64_t i = 0; i < used; i++) { /* sorted by strips of one step; afterwards start[j] is the end of strip j */
            if (beside[i] >= 0.0f && beside[i] < last) {
                const int64_t j = (int64_t)(int32_t)beside[i], at = start[j]++, bin = (int64_t)(int32_t)place[i];
                least[j] = bin < least[j] ? bin : least[j], most[j] = bin > most[j] ? bin : most[j];
                along[at] = place[i], height[at] = level[i], weight[at] = share_of[i], across[at] = beside[i];
            }
        }
        for (int64_t line = 0; line < lines; line++) {
            const int64_t from = line ? start[line - 1] : 0;
            Strip strip = {along + from, height + from, tent, start[line + 3] - from, ALONGS, 0, faded};
            double *one = found + (angle * lines + line) * FOUND, low, high;
            if (strip.n < 8) {
                continue;
            }
            for (int64_t i = 0; i < strip.n; i++) { /* a point on the line counts once, one two steps beside it not at all */
                tent[i] = weight[from + i] * (1.0f - 0.5f * fabsf(across[from + i] - (float)(line + 2)));
            }
            for (int64_t j = line; j < line + 4; j++) {
                strip.first = least[j] < strip.first ? least[j] : strip.first;
                strip.last = most[j] > strip.last ? most[j] : strip.last;
            }
            clear(&heights, 0, highest + 1);
            for (int64_t i = 0; i < strip.n; i++) { /* shared by two bins: depth comes in whole millimetres, which are borders of bins */
                const float at = strip.height[i] < 0.5f ? 0.0f : strip.height[i] - 0.5f, part = at - (float)(int32_t)at;
                float *bin = heights.bins + (int32_t)at;
                bin[0] += strip.weight[i] * (1.0f - part), bin[1] += strip.weight[i] * part;
            }
            ends(&strip, &alongs, -FADE, share, &low, &high);
            heights.total = alongs.total;
            const double top = quantile(&heights, 0.95) * (double)HEIGHT_M, lowest = quantile(&heights, 0.03) * (double)HEIGHT_M;
            const double width = (high - low) * (double)ALONG_M, offset = beside_m + (double)(line + 2 - bins / 2) * step;
            const double mid = ((low + high) / 2.0 - middle) * (double)ALONG_M;
            double grip = rows > 0 ? hidden_middle(&seen, c, s, mid, offset, top, tip) : top / 2.0;
            if (horizontal < 0.5 && top > 1.2 * width && width > 0.0) {
                const double from_end = SIDE * (high - low), reach = AROUND * (high - low);
                const double first = height_around(&strip, low + from_end, reach), second = height_around(&strip, high - from_end, reach);
                const double side = (first > second ? first : second) * (double)HEIGHT_M;
                const double arch = (top + round_underside(top, lowest, side, width, horizontal)) / 2.0;
                grip = arch > grip ? arch : grip;
            }
            const double shifted = grip + shift > grip / 2.0 ? grip + shift : grip / 2.0;
            double z = isnan(turns[3 * angle + 2]) ? shifted : turns[3 * angle + 2];
            z = z > top - tip / 2.0 ? top - tip / 2.0 : z;
            z = z < floor_m ? floor_m : z;
            one[2] = z, one[3] = top;
            ends(&strip, &alongs, (float)((z - tip) / (double)HEIGHT_M), share, &low, &high);
            if (!(alongs.total >= 3.0)) {
                continue;
            }
            one[0] = (low - middle) * (double)ALONG_M, one[1] = (high - middle) * (double)ALONG_M;
            one[4] = -1.0, one[5] = rows > 0 ? hidden_ends(&seen, c, s, one, offset, z) : 1.0;
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

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
#define FOUND 10        /* values of a line */
#define COLUMNS 64      /* of two steps across a direction, for the depth of the object */
#define TILTS 16        /* angles of a palm, at most */
#define TOPS_M 0.004f    /* of the grid over the object whose heights the palm must not meet */
#define EDGE_M 0.012    /* below the top of a line, at least, where a raised line closes */
#define FIT_M 0.004     /* around a limit of the palm, over which it fades */
#define UNDER_M 0.004   /* wider than planned, for the free depth of the hand */
#define LOWER_M 0.006   /* by which a line is lower than the middle: most sides face downwards there, and carry */
#define ROOM_M 0.006    /* of free depth that is left, from where on a line is lowered, wholly with LOWER_M more */
#define TOP_SHARE 0.12    /* of the height, and at least TOP_M: what counts as the top of an object */
#define TOP_M 0.004
#define TOP_CELL_M 0.003  /* of the grid for the middle of the top */
#define MASS_CELL_M 0.004 /* of that for the centre of mass */
#define MOST_CELLS 4e6    /* of such a grid */
#define BEHIND_M 0.004    /* behind the seen surface, from where on a mirrored point is unseen */
#define FAR_M 0.6         /* from the centre: no hand reaches it */

INLINE double smooth(double value, double low, double high) {
    const double t = (value - low) * (1.0 / (high - low)), inside = t < 0.0 ? 0.0 : (t > 1.0 ? 1.0 : t);
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
    const double near = 1.0 / depth;
    const double column = ((c[0] * x + c[1] * y + c[2] * z + c[9]) * near - c[12]) * seen->per_cell;
    const double row = ((c[3] * x + c[4] * y + c[5] * z + c[10]) * near - c[13]) * seen->per_cell;
    if (!(column >= 0.0 && row >= 0.0 && column < (double)seen->columns && row < (double)seen->rows)) {
        return 0.0;
    }
    const int64_t cell = (int64_t)row * seen->columns + (int64_t)column;
    const float nearest = seen->nearest[cell];
    const double behind = isinf(nearest) ? 1.0 : depth - (double)nearest;
    return (double)seen->inside[cell] * smooth(behind, depth_behind - FADE_M, depth_behind + FADE_M);
}

/* The centre (2) of columns over the table under the n points (n, 3) with weights above 0.5, or of all without such: one in each cell of a grid, as
 * high as its highest point, weighing its height, or 0 below one height to 1 above another. 0 where the grid is too large, or without memory. */
INLINE int centre_of_columns(const double *points, const double *weights, int64_t n, double cell_m, double low, double high, double *centre) {
    double from[2] = {INFINITY, INFINITY}, to[2] = {-INFINITY, -INFINITY}, sums[3] = {0.0, 0.0, 0.0};
    int all = 1;
    for (int64_t i = 0; i < n; i++) {
        all = all && !(weights[i] > 0.5);
    }
    for (int64_t i = 0; i < n; i++) {
        for (int axis = 0; axis < 2 && (all || weights[i] > 0.5); axis++) {
            const double cell = floor(points[3 * i + axis] / cell_m);
            from[axis] = cell < from[axis] ? cell : from[axis], to[axis] = cell > to[axis] ? cell : to[axis];
        }
    }
    const double rows = to[0] - from[0] + 1.0, columns = to[1] - from[1] + 1.0;
    double *highest = rows * columns < MOST_CELLS ? malloc((size_t)(rows * columns) * sizeof(double)) : NULL;
    if (!highest) {
        return 0;
    }
    for (int64_t cell = 0; cell < (int64_t)(rows * columns); cell++) {
        highest[cell] = -INFINITY;
    }
    for (int64_t i = 0; i < n; i++) {
        if (all || weights[i] > 0.5) {
            const double row = floor(points[3 * i] / cell_m) - from[0], column = floor(points[3 * i + 1] / cell_m) - from[1];
            double *one = highest + (int64_t)(row * columns + column);
            *one = points[3 * i + 2] > *one ? points[3 * i + 2] : *one;
        }
    }
    for (int64_t cell = 0; cell < (int64_t)(rows * columns); cell++) {
        if (highest[cell] > -INFINITY) {
            const double mass = low < high ? smooth(highest[cell], low, high) : (highest[cell] > 1e-6 ? highest[cell] : 1e-6);
            const double row = (double)(cell / (int64_t)columns), column = (double)(cell % (int64_t)columns);
            sums[0] += mass, sums[1] += mass * (row + from[0] + 0.5) * cell_m, sums[2] += mass * (column + from[1] + 0.5) * cell_m;
        }
    }
    free(highest);
    centre[0] = sums[1] / sums[0], centre[1] = sums[2] / sums[0];
    return 1;
}

/* An object with its unseen side: its n points (n, 3) in the table's frame, and behind them the same mirrored about the vertical line through the
 * middle of its top, where the camera cannot see, with their weights and how certainly they are hidden.
 *
 * top: height of the top, NaN where nothing is to be mirrored. shift (2): of the grasps. completed (2 n, 3): from the centre of mass, shifted. shares (2 n): their
 * weights, 0 where no hand reaches. found (3): their number, -1 where they are too far apart or there is no memory; and the place of that centre. */
void complete_object(const double *points, const double *weights, int64_t n, double top, const double *shift, const Outline *seen, double *completed,
                     double *shares, double *found) {
    int64_t size = n;
    double centre[2];
    memcpy(completed, points, (size_t)n * 3 * sizeof(double));
    memcpy(shares, weights, (size_t)n * sizeof(double));
    found[0] = -1.0;
    if (seen->rows > 0 && !isnan(top)) {
        const double below = TOP_SHARE * top > TOP_M ? TOP_SHARE * top : TOP_M;
        if (!centre_of_columns(points, weights, n, TOP_CELL_M, top - 1.5 * below, top - 0.5 * below, centre)) {
            return;
        }
        for (int64_t i = 0; i < n; i++) {
            double *one = completed + 3 * size;
            one[0] = 2.0 * centre[0] - points[3 * i], one[1] = 2.0 * centre[1] - points[3 * i + 1], one[2] = points[3 * i + 2];
            shares[size] = weights[i] * hidden_by(seen, one[0], one[1], one[2], BEHIND_M);
            size += shares[size] > 0.0;
        }
    }
    if (!centre_of_columns(completed, shares, size, MASS_CELL_M, 0.0, 0.0, centre)) {
        return;
    }
    centre[0] += shift[0], centre[1] += shift[1];
    for (int64_t i = 0; i < size; i++) {
        completed[3 * i] -= centre[0], completed[3 * i + 1] -= centre[1];
        shares[i] = fabs(completed[3 * i]) < FAR_M && fabs(completed[3 * i + 1]) < FAR_M ? shares[i] : 0.0;
    }
    found[0] = (double)size, found[1] = centre[0], found[2] = centre[1];
}

typedef struct {
    float *bins;
    int64_t from, to; /* bins in use */
    double total;
} Histogram;

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

/* The sum of a histogram's bins. */
INLINE void add_up(Histogram *one) {
    float8 sum = {0.0f};
    int64_t i = one->from;
    for (; i + 7 <= one->to; i += 8) {
        sum += *(const float8u *)(one->bins + i);
    }
    float left = ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
    for (; i <= one->to; i++) {
        left += one->bins[i];
    }
    one->total = left;
}

/* The points sorted by strips of one step, those above a height first, and two histograms of each strip.
 *
 * A line takes the points of four strips. Their weights rise over the first two and fall over the others, so that they follow from two sums for
 * each bin: over the parts of a step by which points are behind the beginning of their strip, and over what is missing to whole steps. */
typedef struct {
    const float *along, *height, *weight, *across;
    const int64_t *start; /* first point of each strip, and its first that is not above `most_lower` */
    const int64_t *least, *most; /* of each strip: its first and last bin along the line */
    float most_lower; /* [bins] */
    float *heights, *alongs;             /* (strips, HEIGHTS + 8, 2) and (strips, ALONGS, 2): both sums */
    float *faded;                        /* place for the weights of all points */
} Strips;

/* The histograms of a strip, of the bins up to a height, and from one to another along the line; also its first and last bin there. */
INLINE void add_strip(const Strips *all, int64_t strip, int64_t highest, int64_t first, int64_t last, int64_t *least, int64_t *most) {
    float *heights = all->heights + strip * (HEIGHTS + 8) * 2, *alongs = all->alongs + strip * ALONGS * 2;
    memset(heights, 0, (size_t)(highest + 2) * 2 * sizeof(float));
    memset(alongs + 2 * first, 0, (size_t)(last - first + 1) * 2 * sizeof(float));
    *least = ALONGS, *most = 0;
    for (int64_t i = all->start[2 * strip]; i < all->start[2 * strip + 2]; i++) {
        const float behind = all->weight[i] * (all->across[i] - (float)strip), missing = all->weight[i] - behind;
        /* Shared by two bins: depth comes in whole millimetres, which are borders of bins. */
        const float at = all->height[i] < 0.5f ? 0.0f : all->height[i] - 0.5f, part = at - (float)(int32_t)at;
        const float4 one = {behind, missing, behind, missing}, parts = {1.0f - part, 1.0f - part, part, part};
        *(float4u *)(heights + 2 * (int32_t)at) += one * parts;
        const int64_t bin = (int32_t)all->along[i];
        alongs[2 * bin] += behind, alongs[2 * bin + 1] += missing;
        *least = bin < *least ? bin : *least, *most = bin > *most ? bin : *most;
    }
}

/* The histogram of a line over the bins that it has, from those (width, 2) of its four strips. */
INLINE void add_strips(const float *sums, int64_t width, Histogram *line) {
    const float8 first = {0.5f, 0.0f, 0.5f, 0.0f, 0.5f, 0.0f, 0.5f, 0.0f}, second = {1.0f, 0.5f, 1.0f, 0.5f, 1.0f, 0.5f, 1.0f, 0.5f};
    const float8 third = {0.5f, 1.0f, 0.5f, 1.0f, 0.5f, 1.0f, 0.5f, 1.0f}, fourth = {0.0f, 0.5f, 0.0f, 0.5f, 0.0f, 0.5f, 0.0f, 0.5f};
    for (int64_t i = line->from; i <= line->to; i += 8) {
        float both[16];
        for (int64_t k = 0; k < 16; k += 8) {
            const float *at = sums + 2 * i + k;
            const float8 rising = first * *(const float8u *)at + second * *(const float8u *)(at + 2 * width);
            *(float8u *)(both + k) = rising + (third * *(const float8u *)(at + 4 * width) + fourth * *(const float8u *)(at + 6 * width));
        }
        for (int64_t k = 0; k < 8; k++) {
            line->bins[i + k] = both[2 * k] + both[2 * k + 1];
        }
    }
    add_up(line);
}

/* Takes the points below a height [bins] out of the histogram along a line. */
INLINE void take_lower(const Strips *all, int64_t line, float above, Histogram *bins) {
    const int64_t first = above + FADE / 2.0f < all->most_lower;
    for (int64_t strip = line; strip < line + 4; strip++) {
        const int64_t from = all->start[2 * strip + first], to = all->start[2 * strip + 2];
        for (int64_t i = from; i < to; i++) { /* a point on the line counts once, one two steps beside it not at all */
            const float part = (above - all->height[i]) * (1.0f / FADE) + 0.5f, positive = part < 0.0f ? 0.0f : part;
            const float tent = all->weight[i] * (1.0f - 0.5f * fabsf(all->across[i] - (float)(line + 2)));
            all->faded[i] = tent * (positive > 1.0f ? 1.0f : positive);
        }
        for (int64_t i = from; i < to; i++) {
            bins->bins[(int32_t)all->along[i]] -= all->faded[i];
        }
    }
    add_up(bins);
}

/* Ends of an object along a line [bins], from the histogram along it. */
INLINE void find_ends(const Histogram *bins, double share, double *low, double *high) {
    const double first = mean_quantile(bins, LEAST * share, MOST * share, 1);
    const double last = mean_quantile(bins, LEAST * share, MOST * share, -1);
    const double beyond = OUTWARDS * share * (last - first); /* of what an even density leaves beyond such a mean */
    *low = first - beyond > 0.0 ? first - beyond : 0.0;
    *high = last + beyond < ALONGS - 1.0 ? last + beyond : ALONGS - 1.0;
}

/* Mean height of the points from one to another around a place along a line [bins], the nearest with the largest weight. */
INLINE double height_around(const Strips *all, int64_t line, int64_t from, int64_t to, double place, double reach) {
    float sum = 0.0f, total = 1e-9f;
    for (int64_t i = from; i < to; i++) {
        const float near = 1.0f - fabsf(all->along[i] - (float)place) / (float)reach, share = near < 0.0f ? 0.0f : near;
        const float weight = all->weight[i] * (1.0f - 0.5f * fabsf(all->across[i] - (float)(line + 2))) * share;
        sum += weight * all->height[i], total += weight;
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

/* What an object leaves free of the hand, as it comes at some angles over a line: beside the middle half of a line, and over it. */
typedef struct {
    const double *lifts, *free; /* lowest height of a line at each angle, upright first; free depths by width, of the middle after those beside it */
    int64_t n_tilts, n_free;
    double free_step, across;   /* from one width to the next; half the extent across the fingers that counts */
    float tops[2][COLUMNS];     /* the highest places in each column across the direction, beside the middle and in it; the second half of the columns is beyond the centre */
    int64_t from, to;
    double cosine[TILTS], sine[TILTS], inverse[TILTS]; /* of the angles from straight above; 1 / sine, 0 where it is upright */
} Palm;

/* Shares of two neighbours in what lies between the first and the second by `part` of their distance: those in the outer half fade out. */
INLINE void fading(float part, float *shares) {
    shares[0] = part < 0.5f ? 1.0f : 2.0f - 2.0f * part, shares[1] = part > 0.5f ? 1.0f : 2.0f * part;
}

/* The second highest point (levels) around each cell of a grid over n points (x, y, level) with weights; points with a small weight fade out, as those
 * in the outer half of a cell's neighbourhood do, so that no point is taken or left at once.
 *
 * tops (3, 4 n): x, y and level of the cells that are not empty; returns their number, 0 without memory. */
INLINE int64_t height_map(const float *x, const float *y, const float *level, const float *weight, int64_t n, float *tops) {
    float low[2] = {INFINITY, INFINITY}, high[2] = {-INFINITY, -INFINITY};
    for (int64_t i = 0; i < n; i++) {
        low[0] = x[i] < low[0] ? x[i] : low[0], high[0] = x[i] > high[0] ? x[i] : high[0];
        low[1] = y[i] < low[1] ? y[i] : low[1], high[1] = y[i] > high[1] ? y[i] : high[1];
    }
    const float corner[2] = {floorf(low[0] / TOPS_M), floorf(low[1] / TOPS_M)}; /* of a grid that does not move with the points */
    const int64_t columns = (int64_t)(high[1] / TOPS_M - corner[1]) + 2, rows = (int64_t)(high[0] / TOPS_M - corner[0]) + 2;
    float *cells = n ? calloc((size_t)(rows * columns * 2), sizeof(float)) : NULL;
    int64_t size = 0;
    if (!cells) {
        return 0;
    }
    for (int64_t i = 0; i < n; i++) {
        const float row = x[i] / TOPS_M - corner[0], column = y[i] / TOPS_M - corner[1];
        const float certain = weight[i] < 0.5f ? 2.0f * weight[i] * level[i] : level[i];
        float down[2], right[2];
        fading(row - (float)(int64_t)row, down), fading(column - (float)(int64_t)column, right);
        for (int64_t k = 0; k < 4; k++) {
            float *cell = cells + 2 * (((int64_t)row + k / 2) * columns + (int64_t)column + k % 2);
            const float own = certain * down[k / 2] * right[k % 2], lower = own < cell[0] ? own : cell[0];
            cell[0] = own > cell[0] ? own : cell[0], cell[1] = lower > cell[1] ? lower : cell[1];
        }
    }
    for (int64_t cell = 0; cell < rows * columns; cell++) {
        if (cells[2 * cell + 1] > 0.0f) {
            tops[size] = ((float)(cell / columns) + corner[0]) * TOPS_M, tops[4 * n + size] = ((float)(cell % columns) + corner[1]) * TOPS_M;
            tops[8 * n + size++] = cells[2 * cell + 1];
        }
    }
    free(cells);
    return size;
}

/* The highest columns across a direction, from `n` cells of the map of heights (3, stride), x and y in steps; those within `half` of the middle of the line
 * are apart from the others. */
INLINE void find_tops(Palm *palm, const float *tops, int64_t stride, int64_t n, float c, float s, float step, float middle, float half) {
    memset(palm->tops, 0, sizeof(palm->tops));
    palm->from = COLUMNS, palm->to = 0;
    for (int64_t i = 0; i < n; i++) {
        const float x = tops[i], y = tops[stride + i], level = tops[2 * stride + i];
        const float at = (c * y - s * x) / (2.0f * step) + (float)(COLUMNS / 2) - 0.5f;
        if (at >= 0.0f && at < (float)(COLUMNS - 1)) {
            const int64_t left = (int64_t)at, k = fabsf(c * x + s * y - middle) <= half;
            float shares[2];
            fading(at - (float)left, shares);
            for (int64_t side = 0; side < 2; side++) {
                float *top = &palm->tops[k][left + side];
                *top = level * shares[side] > *top ? level * shares[side] : *top;
            }
            palm->from = left < palm->from ? left : palm->from, palm->to = left + 1 > palm->to ? left + 1 : palm->to;
        }
    }
}

INLINE double4 larger4(double4 a, double4 b) {
    const int64x4 which = a > b;
    return (double4)(((int64x4)a & which) | ((int64x4)b & ~which));
}

INLINE double4 smaller4(double4 a, double4 b) { return -larger4(-a, -b); }

/* How far the object reaches from a line towards a palm that tilts by an angle, beside the middle of the line and in it [m]; columns count as solid from
 * the table on, and those without a point as nothing. */
INLINE void depths_at(const Palm *palm, int64_t tilt, double offset, double z, double step, double *deepest) {
    const double c = palm->cosine[tilt], s = palm->sine[tilt], t = palm->inverse[tilt], sign = t < 0.0 ? -1.0 : 1.0;
    double4 most[2] = {{0.0}, {0.0}};
    for (int64_t j = palm->from & ~3; j <= palm->to; j += 4) {
        const double first = (double)(2 * (j - COLUMNS / 2) + 1);
        const double4 v = (double4){first, first + 2.0, first + 4.0, first + 6.0} * step - offset;
        const double4 from = t == 0.0 ? v * 0.0 - z : larger4((v * c - sign * palm->across) * t, v * 0.0 - z);
        const double4 to = (v * c + sign * palm->across) * t; /* what is across of it by no more than `across` */
        for (int64_t part = 0; part < 2; part++) {
            const float *top = palm->tops[part] + j;
            const double4 high = (double4){top[0], top[1], top[2], top[3]} * (double)HEIGHT_M - z;
            const int64x4 within = t == 0.0 ? (v < palm->across) & (v > -palm->across) : (int64x4){-1, -1, -1, -1};
            const double4 end = t == 0.0 ? high : smaller4(high, to), depth = end * c + v * s;
            most[part] = larger4((double4)((int64x4)depth & within & (end > from)), most[part]);
        }
    }
    for (int64_t part = 0; part < 2; part++) {
        const double4 one = most[part];
        const double left = one[0] > one[1] ? one[0] : one[1], right = one[2] > one[3] ? one[2] : one[3];
        deepest[part] = left > right ? left : right;
    }
}

/* How much deeper the object is than a hand that tilts by an angle [m]. */
INLINE double too_deep(const Palm *palm, int64_t tilt, double offset, double width, double z, double step) {
    const double at = (width + UNDER_M) / palm->free_step, inside = at < (double)(palm->n_free - 1) ? at : (double)(palm->n_free - 1);
    const int64_t k = (int64_t)inside < palm->n_free - 2 ? (int64_t)inside : palm->n_free - 2;
    double over[2];
    depths_at(palm, tilt, offset, z, step, over);
    for (int64_t part = 0; part < 2; part++) {
        const double *free_m = palm->free + part * palm->n_free + k;
        over[part] -= free_m[0] + (inside - (double)k) * (free_m[1] - free_m[0]);
    }
    return over[0] > over[1] ? over[0] : over[1];
}

/* As `too_deep`, at the angle that fits best. Raises the line as no palm fits and one from above would, by parts where it is not certain; lowers it, not
 * below a height, where there is room for that. */
INLINE double fit_palm(const Palm *palm, double offset, double width, double top, double lowest, double step, double *z, double *raised) {
    const double up = too_deep(palm, 0, offset, width, *z, step), lower = LOWER_M * smooth(-up, ROOM_M, ROOM_M + LOWER_M);
    double least = up;
    *raised = 0.0;
    *z -= lower < *z - lowest ? lower : *z - lowest;
    for (int64_t i = 1; i < palm->n_tilts && least > -FIT_M; i++) {
        const double over = *z < palm->lifts[i] ? INFINITY : too_deep(palm, i, offset, width, *z, step);
        least = over < least ? over : least;
    }
    if (least > -FIT_M && up > 0.0) {
        *raised = up * smooth(least, -FIT_M, 0.0) * smooth(top - EDGE_M - *z - up, -FIT_M, FIT_M);
        *z += *raised;
        least = up - *raised < least ? up - *raised : least;
    }
    return least;
}

/* The object along `angles` x `lines` horizontal lines, on which two fingers close at a height between its top and its underside.
 *
 * points (n, 3), weights (n): of the object, in the table's frame (z = 0), x and y from the axis, |x| and |y| below 0.6 m.
 * turns (angles, 3): direction of the lines [rad], how far the middle one is beside the axis, and their height, or NaN if it follows from the points.
 * settings: distance of the lines, radius of a fingertip, lowest height of its centre, share of the points beyond either end, horizontal part of the
 * direction of view, shift of the height from the middle, length of the way in, share of the points beyond either outer end. others (m, 3): what
 * stands around.
 * palm: half the extent across the fingers that counts, and the step of its widths; then n_tilts angles, upright first, the lowest height of a line at
 * each, and the n_free free depths by width, beside the middle half of a line and over it; n_free is 0 for a hand without a palm.
 * found (angles, lines, 10): both ends, height, top, the first of `others` in the way of a finger, or -1, how certainly the object is at both ends,
 * 0 ... 1, how much deeper the object is than the hand, how far the line was raised for it, and both outer ends. The first two, the fifth, the sixth and the last two are NaN where a fingertip meets no points, and all where the line meets none or there is no memory. */
VECTORISED void closing_lines(const double *points, const double *weights, int64_t n, const double *turns, int64_t angles,
                              int64_t lines, const double *settings, const Outline *seen, const double *others, int64_t m, const double *palm, int64_t n_tilts, int64_t n_free, double *found) {
    const double step = settings[0], tip = settings[1], floor_m = settings[2], share = settings[3], horizontal = settings[4];
    const double shift = settings[5], way = settings[6], outer = settings[7], middle = ALONGS / 2;
    Palm hand = {palm + 2 + n_tilts, palm + 2 + 2 * n_tilts, n_tilts < TILTS ? n_tilts : TILTS, n_free, palm[1], palm[0], {{0.0f}}, 0, 0, {0.0}, {0.0}, {0.0}};
    for (int64_t i = 0; i < hand.n_tilts; i++) {
        hand.cosine[i] = cos(palm[2 + i]), hand.sine[i] = sin(palm[2 + i]);
        hand.inverse[i] = fabs(hand.sine[i]) > 1e-9 ? 1.0 / hand.sine[i] : 0.0;
    }
    const int64_t bins = lines + 3; /* bin j holds what is from (j - bins / 2) to (j + 1 - bins / 2) steps beside the middle */
    const size_t sums = (size_t)bins * (HEIGHTS + 8 + ALONGS) * 2;
    int64_t *start = malloc((size_t)(bins + 1) * 5 * sizeof(int64_t) + ((size_t)n * 13 + sums + HEIGHTS + ALONGS + 32) * sizeof(float));
    int64_t used = 0, highest = 0;
    for (int64_t i = 0; i < angles * lines * FOUND; i++) {
        found[i] = NAN;
    }
    if (!start) {
        return;
    }
    float *along = (float *)(start + (bins + 1) * 5), *height = along + n, *weight = height + n, *x = weight + n, *y = x + n, *level = y + n, *share_of = level + n;
    float *place = share_of + n, *beside = place + n, *across = beside + n, *faded = across + n;
    int32_t *strip = (int32_t *)(faded + n), *rank = strip + n;
    int64_t *least = start + 2 * bins + 3, *most = least + bins; /* bins along the line of the points in each strip of one step */
    Strips all = {along, height, weight, across, start, least, most, 0.0f, faded + 3 * n, faded + 3 * n + bins * (HEIGHTS + 8) * 2, faded};
    Histogram heights = {faded + 3 * n + sums, 0, 0, 0.0}, alongs = {heights.bins + HEIGHTS + 16, 0, 0, 0.0};
    for (int64_t i = 0; i < n; i++) {
        if (weights[i] > 0.0) {
            const double bin = points[3 * i + 2] / (double)HEIGHT_M;
            level[used] = bin < 0.0 ? 0.0f : (bin > HEIGHTS - 2.0 ? HEIGHTS - 2.0f : (float)bin);
            highest = (int64_t)level[used] > highest ? (int64_t)level[used] : highest;
            x[used] = (float)points[3 * i], y[used] = (float)points[3 * i + 1], share_of[used] = (float)weights[i];
            used++;
        }
    }
    int64_t n_tops = 0, free_heights = 0;
    for (int64_t angle = 0; angle < angles; angle++) {
        free_heights |= isnan(turns[3 * angle + 2]);
    }
    float *tops = n_free && free_heights ? malloc((size_t)n * 12 * sizeof(float)) : NULL;
    if (tops) {
        n_tops = height_map(x, y, level, share_of, used, tops);
    }
    heights.to = highest + 1;
    all.most_lower = (float)highest / 2.0f;
    for (int64_t angle = 0; angle < angles; angle++) {
        const double c = cos(turns[3 * angle]), s = sin(turns[3 * angle]), beside_m = turns[3 * angle + 1];
        const float c_place = (float)c / ALONG_M, s_place = (float)s / ALONG_M, c_line = (float)(c / step), s_line = (float)(s / step);
        const float first = (float)((double)(bins / 2) - beside_m / step), last = (float)bins;
        memset(start, 0, (size_t)(2 * bins + 3) * sizeof(int64_t));
        int32_t from_bin = ALONGS - 1, to_bin = 0;
        for (int64_t i = 0; i < used; i++) {
            const float value = x[i] * c_place + y[i] * s_place + (float)middle;
            place[i] = value > 0.0f ? (value < ALONGS - 1.0f ? value : ALONGS - 1.0f) : 0.0f;
            beside[i] = y[i] * c_line - x[i] * s_line + first;
            const int32_t own = beside[i] >= 0.0f && beside[i] < last ? (int32_t)beside[i] : (int32_t)bins; /* the last one holds all others */
            strip[i] = 2 * own + (level[i] <= all.most_lower);
        }
        for (int64_t i = 0; i < used; i++) {
            rank[i] = (int32_t)start[strip[i] + 1]++;
            from_bin = (int32_t)place[i] < from_bin ? (int32_t)place[i] : from_bin, to_bin = (int32_t)place[i] > to_bin ? (int32_t)place[i] : to_bin;
        }
        for (int64_t j = 0; j < 2 * bins + 2; j++) {
            start[j + 1] += start[j];
        }
        for (int64_t i = 0; i < used; i++) { /* sorted by strips of one step, and there those above `most_lower` first */
            const int64_t at = start[strip[i]] + rank[i];
            along[at] = place[i], height[at] = level[i], weight[at] = share_of[i], across[at] = beside[i];
        }
        for (int64_t j = 0; j < bins && used; j++) {
            add_strip(&all, j, highest, from_bin, to_bin, least + j, most + j);
        }
        if (n_tops) {
            const float ends[2] = {((float)from_bin - (float)middle) * ALONG_M, ((float)to_bin - (float)middle) * ALONG_M};
            find_tops(&hand, tops, 4 * used, n_tops, (float)c, (float)s, (float)step, (ends[0] + ends[1]) / 2.0f, (ends[1] - ends[0]) / 4.0f);
        }
        for (int64_t line = 0; line < lines; line++) {
            const int64_t from = start[2 * line], to = start[2 * line + 8];
            double *one = found + (angle * lines + line) * FOUND, low, high;
            if (to - from < 8) {
                continue;
            }
            alongs.from = ALONGS, alongs.to = 0;
            for (int64_t j = line; j < line + 4; j++) {
                alongs.from = least[j] < alongs.from ? least[j] : alongs.from;
                alongs.to = most[j] > alongs.to ? most[j] : alongs.to;
            }
            add_strips(all.heights + line * (HEIGHTS + 8) * 2, HEIGHTS + 8, &heights);
            add_strips(all.alongs + line * ALONGS * 2, ALONGS, &alongs);
            find_ends(&alongs, share, &low, &high);
            const double top = quantile(&heights, 0.95) * (double)HEIGHT_M;
            const double width = (high - low) * (double)ALONG_M, offset = beside_m + (double)(line + 2 - bins / 2) * step;
            const double mid = ((low + high) / 2.0 - middle) * (double)ALONG_M;
            double grip = seen->rows > 0 ? hidden_middle(seen, c, s, mid, offset, top, tip) : top / 2.0;
            if (horizontal < 0.5 && top > 1.2 * width && width > 0.0) {
                const double from_end = SIDE * (high - low), reach = AROUND * (high - low);
                const double near = height_around(&all, line, from, to, low + from_end, reach);
                const double far = height_around(&all, line, from, to, high - from_end, reach);
                const double side = (near > far ? near : far) * (double)HEIGHT_M, lowest = quantile(&heights, 0.03) * (double)HEIGHT_M;
                const double arch = (top + round_underside(top, lowest, side, width, horizontal)) / 2.0;
                grip = arch > grip ? arch : grip;
            }
            const double shifted = grip + shift > grip / 2.0 ? grip + shift : grip / 2.0;
            double z = isnan(turns[3 * angle + 2]) ? shifted : turns[3 * angle + 2];
            z = z > top - tip / 2.0 ? top - tip / 2.0 : z;
            z = z < floor_m ? floor_m : z;
            one[6] = one[7] = 0.0;
            if (n_free && isnan(turns[3 * angle + 2])) {
                one[6] = fit_palm(&hand, offset, width, top, floor_m, step, &z, one + 7);
            } else if (isnan(turns[3 * angle + 2])) {
                z -= LOWER_M < z - floor_m ? LOWER_M : z - floor_m;
            }
            one[2] = z, one[3] = top;
            take_lower(&all, line, (float)((z - tip) / (double)HEIGHT_M), &alongs);
            if (!(alongs.total >= 3.0)) {
                continue;
            }
            find_ends(&alongs, share, &low, &high);
            one[0] = (low - middle) * (double)ALONG_M, one[1] = (high - middle) * (double)ALONG_M;
            one[4] = -1.0, one[5] = seen->rows > 0 ? hidden_ends(seen, c, s, one, offset, z) : 1.0;
            find_ends(&alongs, outer, &low, &high);
            one[8] = (low - middle) * (double)ALONG_M, one[9] = (high - middle) * (double)ALONG_M;
        }
        for (int64_t i = 0; i < m; i++) { /* the lines beside which it stands */
            const double ahead = c * others[3 * i] + s * others[3 * i + 1], y = c * others[3 * i + 1] - s * others[3 * i];
            const double nearest_line = (y - beside_m) / step - (double)(2 - bins / 2), reach = tip / step + 1.0;
            const int64_t until = nearest_line + reach < (double)lines ? (int64_t)(nearest_line + reach) + 1 : lines;
            for (int64_t line = nearest_line - reach > 0.0 ? (int64_t)(nearest_line - reach) : 0; line < until; line++) {
                double *one = found + (angle * lines + line) * FOUND;
                const double offset = beside_m + (double)(line + 2 - bins / 2) * step;
                const int beside_it = fabs(y - offset) < tip && others[3 * i + 2] > one[2] - tip;
                const int outside = (ahead > one[0] - way && ahead < one[0]) || (ahead > one[1] && ahead < one[1] + way);
                one[4] = one[4] == -1.0 && beside_it && outside ? (double)i : one[4];
            }
        }
    }
    free(tops);
    free(start);
}

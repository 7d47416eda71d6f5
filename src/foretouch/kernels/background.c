/* SPDX-License-Identifier: Apache-2.0 */
/* Which parts of a scene stand on the table, and which are background, for cloud/segmentation/background.py.
 *
 * It is decided on the coarse grid of pixels. The outline of the table is the convex hull, in the image, of those of its pieces
 * that belong together: holes, and what stands on the table, may lie between them, but not the world below it. A part is inside if
 * the feet of its points, along the normal of the table, are. */
#include "eigen.h"
#include "sets.h"

enum { STANDS, ENTERS, BEYOND, FLOATS, WALL }; /* reasons; STANDS is none */
enum { HOLE, TABLE, UNDER, OVER };             /* kinds of cells */

#define EMPTY 50     /* a margin on the left or right with depth in fewer than one of as many cells of each column is out of view, */
#define FILLED 2     /* if every other cell has depth near it, */
#define NEXT 3       /* cells further in, */
#define MARGIN 8     /* and if it is as many times narrower than the image: registered depth has such; above, it may be the horizon */
#define PIECE 100    /* a piece of the table that is as many times smaller than the largest is noise */
#define CONTACT 20   /* and a part of whose outline, or cells, fewer than one of as many are at the table floats */
#define ABROAD 50    /* what hovers above the table comes from out of view if one of as many edges around it is at the border, and high */
#define MOSTLY 0.37  /* share of the outline at the border of the image, from which on too little of a part is seen */
#define FALLS 0.67f   /* height at the border by the largest, of a part that may stand on the table beyond */
#define FURTHER 0.3f /* of the width of the view: so far goes a table on that is cut off by the image */
#define CLOSE 0.02f  /* difference in depth of cells that are connected [m] */
#define MANY 30      /* cells of a wall */
#define TALL 0.05f   /* height of a bin's sides, */
#define LONG 0.2     /* and their length, which few objects have [m], */
#define THIN 0.006   /* standard deviation of their depth [m], */
#define STEEP 0.35   /* largest cosine between their normal and that of the table, */
#define OPEN 4       /* all of them together have the table between them in a quarter as many cells as they have, */
#define RIM 0.005f   /* difference of their heights [m], */
#define NARROW 4     /* of a piece of a rim, fewer than one of as many cells are within it, */
#define CORNER 2     /* and cells with which they meet */
#define BLOCK 32     /* cells without a label that are passed at once */

typedef struct {
    double sum[9];       /* of cells within: x, y, z and their products */
    int64_t first, last; /* cells */
    float top, foot;     /* heights: the largest, and the least at the border of the image where the foot of a cell is beyond it [m] */
    int32_t cells, within, low, inside, ring, border, raised, away, table, touching, front, reason, upright; /* ring: edges around it, and those at
        the border of the image, also without the low ones, or with their feet beyond it; beside the table, at its depth, and before it */
} part;

typedef struct {
    double middle[3], normal[3], variance;
} sheet;

typedef struct {
    float u, v;
} ray;

typedef struct {
    int32_t row, first, end;
} run; /* of cells of a row */

typedef struct {
    int64_t ends, beyond;
} ray_counts;

typedef struct {
    int64_t h, w, first[2], last[2]; /* rows and columns in view */
    const Parts *of;
    float *height;
    uint8_t *kind;
} board;

INLINE float side_of(const ray *a, const ray *b, float u, float v) { return (b->u - a->u) * (v - a->v) - (b->v - a->v) * (u - a->u); }

INLINE int is_before(const ray *a, const ray *b) { return a->v < b->v || (a->v == b->v && a->u > b->u); }

/* The convex hull of n rays, counter-clockwise; hull: (2 n). Sorts them, which are nearly sorted by v. Returns its size (Andrew 1979). */
INLINE int64_t hull_of(ray *rays, int64_t n, ray *hull) {
    int64_t count = 0, least = 2;
    for (int64_t k = 1; k < n; k++) {
        const ray moved = rays[k];
        int64_t to = k;
        for (; to && is_before(&moved, rays + to - 1); to--) {
            rays[to] = rays[to - 1];
        }
        rays[to] = moved;
    }
    for (int64_t k = 0; k < 2 * n; k++) {
        const ray *next = rays + (k < n ? k : 2 * n - 1 - k);
        least = k == n ? count + 1 : least;
        while (count >= least && side_of(hull + count - 2, hull + count - 1, next->u, next->v) <= 0.0f) {
            count--;
        }
        hull[count++] = *next;
    }
    return count > 1 ? count - 1 : count;
}

INLINE int is_within(const ray *hull, int64_t n, float u, float v) {
    for (int64_t k = 0; k < n; k++) {
        if (side_of(hull + k, hull + (k + 1 < n ? k + 1 : 0), u, v) < 0.0f) {
            return 0;
        }
    }
    return n > 2;
}

/* Heights and kinds of the cells, and the rows and columns in view. filled: (w), zeros. */
INLINE void read_cells(board *g, int32_t *filled) {
    const Parts *of = g->of;
    const float a = (float)of->plane[0], b = (float)of->plane[1], c = (float)of->plane[2], d = (float)of->plane[3];
    const float least = (float)of->level, noise = (float)of->noise, below = -(float)of->below;
    for (int64_t y = 0; y < g->h; y++) {
        const float *p = of->grid + 3 * y * g->w;
        const int32_t *label = of->labels + y * g->w;
        float *height = g->height + y * g->w;
        uint8_t *kind = g->kind + y * g->w;
        for (int64_t x = 0; x < g->w; x++) {
            const float z = p[3 * x + 2], up = p[3 * x] * a + p[3 * x + 1] * b + z * c + d, level = z * z * noise;
            const int32_t is_table = fabsf(up) <= (level > least ? level : least), is_hole = up != up, is_under = up < below;
            const int32_t other = is_under ? UNDER : is_table ? TABLE : OVER;
            height[x] = up;
            kind[x] = (uint8_t)(is_hole ? HOLE : label[x] ? OVER : other);
            filled[x] += !is_hole;
        }
    }
    int64_t first = 0, last = g->w - 1;
    while (first < last && EMPTY * filled[first] < g->h) {
        first++;
    }
    while (last > first && EMPTY * filled[last] < g->h) {
        last--;
    }
    const int enough = first + NEXT < last;
    g->first[0] = 0, g->last[0] = g->h - 1;
    g->first[1] = enough && MARGIN * first < g->w && FILLED * filled[first + NEXT] >= g->h ? first : 0;
    g->last[1] = enough && MARGIN * (g->w - 1 - last) < g->w && FILLED * filled[last - NEXT] >= g->h ? last : g->w - 1;
}

/* Runs of cells of a kind, or, if `but`, of any other, and the connected sets of them; diagonal neighbours are connected.
 * Returns the number of runs; root: the first run of the set of each. */
INLINE int32_t connect_runs(const board *g, int kind, int but, run *runs, int32_t *root) {
    int32_t n = 0, above = 0, own = 0; /* first runs of the row above, from the one beside the next run on, and of this row */
    for (int32_t y = 0; y < g->h; y++) {
        const uint8_t *row = g->kind + y * g->w;
        above = own, own = n;
        for (int32_t x = 0; x < g->w; n++) {
            while (x < g->w && (row[x] == kind) == but) {
                x++;
            }
            if (x == g->w) {
                break;
            }
            runs[n] = (run){y, x, x}, root[n] = n;
            while (x < g->w && (row[x] == kind) != but) {
                x++;
            }
            runs[n].end = x;
            while (above < own && runs[above].end < runs[n].first) {
                above++;
            }
            for (int32_t k = above; k < own && runs[k].first <= x; k++) {
                join(root, n, k);
            }
        }
    }
    for (int32_t k = 0; k < n; k++) {
        root[k] = root[root[k]]; /* those before are numbered with their roots already */
    }
    return n;
}

/* Keeps as TABLE the cells of the pieces that belong together. runs, roots: of two sets of runs each; size: of as many, zeros. */
INLINE void gather_table(board *g, run *runs[2], int32_t *roots[2], int32_t *size) {
    const int32_t n = connect_runs(g, TABLE, 0, runs[0], roots[0]), *root = roots[0];
    int32_t largest = 0, several = 0;
    for (int32_t k = 0; k < n; k++) {
        size[root[k]] += runs[0][k].end - runs[0][k].first;
        largest = size[root[k]] > size[largest] ? root[k] : largest;
    }
    for (int32_t k = 0; k < n; k++) {
        const int kept = PIECE * size[root[k]] >= size[largest];
        several |= kept && root[k] != largest;
        memset(g->kind + runs[0][k].row * g->w + runs[0][k].first, kept ? TABLE : OVER, (size_t)(runs[0][k].end - runs[0][k].first));
    }
    if (!several) {
        return;
    }
    connect_runs(g, UNDER, 1, runs[1], roots[1]);
    int32_t *whole = size; /* the set of all but the world below that a run of the table is in */
    for (int32_t k = 0, j = 0; k < n; k++) {
        while (runs[1][j].row < runs[0][k].row || runs[1][j].end <= runs[0][k].first) {
            j++;
        }
        whole[k] = roots[1][j];
    }
    for (int32_t k = 0; k < n; k++) {
        if (whole[k] != whole[largest]) {
            memset(g->kind + runs[0][k].row * g->w + runs[0][k].first, OVER, (size_t)(runs[0][k].end - runs[0][k].first));
        }
    }
}

/* The ends of each row of the table, and, where the image cuts it off, points `further` beyond. Returns the numbers of both. */
INLINE ray_counts ends_of(const board *g, float further, ray *ends, ray *beyond) {
    ray_counts n = {0, 0};
    for (int64_t y = g->first[0]; y <= g->last[0]; y++) {
        const uint8_t *kind = g->kind + y * g->w;
        int64_t at[2] = {g->first[1], g->last[1]};
        while (at[0] <= at[1] && kind[at[0]] != TABLE) {
            at[0]++;
        }
        while (at[1] > at[0] && kind[at[1]] != TABLE) {
            at[1]--;
        }
        for (int k = 0; k < 2 && at[0] <= at[1]; k++) {
            const float *p = g->of->grid + 3 * (y * g->w + at[k]);
            const float aside = (float)((at[k] == g->last[1]) - (at[k] == g->first[1]));
            const float along = (float)((y == g->last[0]) - (y == g->first[0]));
            const ray end = ends[n.ends++] = (ray){p[0] / p[2], p[1] / p[2]};
            if (aside != 0.0f || along != 0.0f) {
                beyond[n.beyond++] = (ray){end.u + aside * further, end.v + along * further};
            }
        }
    }
    return n;
}

/* One edge between a cell of a part and what is beside it: another cell, or nothing at the border of the image. `onward`: whether the foot
 * of the cell lies in that direction. near: (n, n, 2), edges between parts that are close, and all. */
INLINE void add_edge(const board *g, part *parts, int32_t *near, int64_t i, int64_t other, int at_border, int onward) {
    const int32_t *labels = g->of->labels;
    part *own = parts + labels[i];
    own->ring++, own->border += at_border, own->raised += at_border && g->height[i] > (float)g->of->foot, own->away += at_border && onward;
    own->foot = at_border && onward && (own->foot == 0.0f || g->height[i] < own->foot) ? g->height[i] : own->foot;
    if (!at_border) {
        const int close = fabsf(g->of->grid[3 * other + 2] - g->of->grid[3 * i + 2]) < CLOSE, table = g->kind[other] == TABLE;
        int32_t *edges = near + (labels[i] * g->of->n + labels[other]) * 2;
        own->table += table, own->touching += close && table, own->front += close && table && onward;
        edges[0] += close && labels[other], edges[1] += labels[other] != 0;
    }
}

/* Adds a cell to its part. */
INLINE void add_cell(const board *g, const ray *hull, int64_t n_hull, part *parts, int32_t *near, int64_t y, int64_t x) {
    const int64_t i = y * g->w + x, around[4] = {i - 1, i + 1, i - g->w, i + g->w};
    const int ends[4] = {x == g->first[1], x == g->last[1], y == g->first[0], y == g->last[0]};
    const float *p = g->of->grid + 3 * i, up = g->height[i];
    const float foot[3] = {p[0] - up * (float)g->of->plane[0], p[1] - up * (float)g->of->plane[1], p[2] - up * (float)g->of->plane[2]};
    const float right = foot[0] * p[2] - p[0] * foot[2], down = foot[1] * p[2] - p[1] * foot[2];
    const int onward[4] = {right < 0.0f, right > 0.0f, down < 0.0f, down > 0.0f};
    part *own = parts + g->of->labels[i];
    const int32_t ring = own->ring;
    own->top = own->cells && own->top > up ? own->top : up;
    own->first = own->cells ? own->first : i, own->last = i;
    own->cells++, own->low += up < (float)g->of->foot;
    own->inside += foot[2] > 0.0f && is_within(hull, n_hull, foot[0] / foot[2], foot[1] / foot[2]);
    for (int k = 0; k < 4; k++) {
        if (ends[k] || g->of->labels[around[k]] != g->of->labels[i]) {
            add_edge(g, parts, near, i, around[k], ends[k], onward[k]);
        }
    }
    if (own->ring > ring) { /* depth is mixed at an outline */
        return;
    }
    own->within++;
    for (int k = 0, at = 3; k < 3; k++) {
        own->sum[k] += (double)p[k];
        for (int l = k; l < 3; l++) {
            own->sum[at++] += (double)p[k] * (double)p[l];
        }
    }
}

INLINE void measure(const board *g, const ray *hull, int64_t n_hull, part *parts, int32_t *near) {
    for (int64_t y = g->first[0]; y <= g->last[0]; y++) {
        const int32_t *label = g->of->labels + y * g->w;
        for (int64_t x = g->first[1]; x <= g->last[1]; x += BLOCK) {
            const int64_t end = x + BLOCK <= g->last[1] ? x + BLOCK : g->last[1] + 1;
            int32_t any = 0;
            for (int64_t k = x; k < end; k++) {
                any |= label[k];
            }
            for (int64_t k = x; k < end && any; k++) {
                if (label[k] && g->kind[y * g->w + k] != HOLE) {
                    add_cell(g, hull, n_hull, parts, near, y, k);
                }
            }
        }
    }
}

/* Largest extent of a part along x, y or z [m]. */
static double size_of(const board *g, const part *own, int64_t label) {
    float low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY}, most = 0.0f;
    for (int64_t c = own->first; c <= own->last; c++) {
        for (int k = 0; k < 3 && g->of->labels[c] == label; k++) {
            const float at = g->of->grid[3 * c + k];
            low[k] = at < low[k] ? at : low[k], high[k] = at > high[k] ? at : high[k];
        }
    }
    for (int k = 0; k < 3; k++) {
        most = high[k] - low[k] > most ? high[k] - low[k] : most;
    }
    return most;
}

/* The reason of each part by itself; FLOATS also where it may rest on another one. What the image cuts is an object if the table is seen
 * before its foot, or if that may be out of view, if most of it is in view and it is not longer than few objects are. */
static void judge(const board *g, part *parts) {
    for (int64_t label = 1; label < g->of->n; label++) {
        part *own = parts + label;
        const int inside = 2 * own->inside >= own->cells, rests = CONTACT * own->table >= own->ring || CONTACT * own->low >= own->cells;
        const int stands = CONTACT * own->touching >= own->ring, hidden = 2 * own->away >= own->border && own->foot < FALLS * own->top, cut = own->border >= g->of->border * own->ring;
        const int hovers = ABROAD * own->border >= own->ring && 10 * own->raised >= 9 * own->border && CONTACT * own->touching < own->ring && !hidden;
        const int whole = (stands || hidden) && own->border < MOSTLY * own->ring && size_of(g, own, label) < LONG;
        const int enters = hovers || (cut && !whole);
        own->reason = !own->cells ? STANDS : enters ? (inside ? ENTERS : BEYOND) : !inside ? BEYOND : rests ? STANDS : FLOATS;
    }
}

/* What rests on a part that stands does so, too; what is joined to one that enters the view, and not to the table, enters it. */
static void spread(part *parts, const int32_t *near, int64_t n) {
    for (int changed = 1; changed;) {
        changed = 0;
        for (int64_t i = 1; i < n; i++) {
            int32_t on = 0, robot = 0, beside = 0;
            for (int64_t j = 1; j < n && (parts[i].reason == FLOATS || (parts[i].reason == STANDS && !parts[i].touching)); j++) {
                const int32_t *edges = near + 2 * (i * n + j);
                on += parts[j].reason == STANDS ? edges[0] : 0, robot += parts[j].reason == ENTERS ? edges[0] : 0;
                beside += parts[j].reason == STANDS ? edges[1] : 0;
            }
            const int32_t reason = robot > on ? ENTERS : CONTACT * beside >= parts[i].ring && parts[i].reason == FLOATS ? STANDS : parts[i].reason;
            changed |= reason != parts[i].reason;
            parts[i].reason = reason;
        }
    }
}

/* The plane of the cells within a part, and the mean square of their distance from it, which is infinite if they are few. */
static sheet fit_sheet(const part *own) {
    sheet fit = {.variance = INFINITY};
    double spread[6], values[3];
    if (own->within < MANY) {
        return fit;
    }
    for (int k = 0, at = 3; k < 3; k++) {
        fit.middle[k] = own->sum[k] / own->within;
        for (int l = k; l < 3; l++, at++) {
            spread[at - 3] = own->sum[at] / own->within - fit.middle[k] * (own->sum[l] / own->within);
        }
    }
    eigen3(spread, values, fit.normal);
    fit.variance = values[0];
    return fit;
}

/* Least and largest of the products of the points of a part with a vector. */
static double extent(const board *g, const part *own, int64_t label, const double *along) {
    double low = INFINITY, high = -INFINITY;
    for (int64_t c = own->first; c <= own->last; c++) {
        const float *p = g->of->grid + 3 * c;
        const double at = p[0] * along[0] + p[1] * along[1] + p[2] * along[2];
        low = g->of->labels[c] == label && at < low ? at : low;
        high = g->of->labels[c] == label && at > high ? at : high;
    }
    return high - low;
}

/* Whether a part is an upright sheet as large as the side of a bin. */
static int is_upright(const board *g, const part *own, int64_t label) {
    const double *t = g->of->plane;
    if (own->reason != STANDS || own->top < TALL) {
        return 0;
    }
    const sheet fit = fit_sheet(own);
    const double *n = fit.normal, along[3] = {n[1] * t[2] - n[2] * t[1], n[2] * t[0] - n[0] * t[2], n[0] * t[1] - n[1] * t[0]};
    const double sine = sqrt(along[0] * along[0] + along[1] * along[1] + along[2] * along[2]);
    return fit.variance < THIN * THIN && sine * sine > 1.0 - STEEP * STEEP && extent(g, own, label, along) > LONG * sine;
}

/* Whether a part is all sides of a bin: as large as they are, with the table between its cells in many rows. */
static int is_frame(const board *g, const part *own, int64_t label) {
    const double *t = g->of->plane, across[3] = {0.0, t[2], -t[1]}, size = sqrt(t[1] * t[1] + t[2] * t[2]);
    const double along[3] = {-t[1] * t[1] - t[2] * t[2], t[0] * t[1], t[0] * t[2]};
    int64_t open = 0;
    if (own->reason != STANDS || own->top < TALL) {
        return 0;
    }
    for (int64_t y = own->first / g->w; y <= own->last / g->w; y++) {
        int64_t cells = 0, table = 0, between = 0; /* of the row; of the table since the first, and up to the last cell */
        for (int64_t x = 0; x < g->w; x++) {
            const int is_own = g->of->labels[y * g->w + x] == label;
            cells += is_own, table += cells && g->kind[y * g->w + x] == TABLE;
            between = is_own ? table : between;
        }
        open += between;
    }
    return OPEN * open > own->cells && extent(g, own, label, across) > LONG * size && extent(g, own, label, along) > LONG * size;
}

/* The sides of a bin: upright sheets of one height, or that meet, also what is beyond the table; and what meets one and has its height. */
static void find_bin(const board *g, part *parts, const int32_t *near) {
    const int64_t n = g->of->n;
    int changed = 0;
    for (int64_t i = 1; i < n; i++) {
        parts[i].upright = is_upright(g, parts + i, i);
        if (is_frame(g, parts + i, i)) {
            parts[i].reason = WALL, changed = 1;
        }
    }
    for (int64_t i = 1; i < n; i++) {
        for (int64_t j = 1; j < n && parts[i].upright; j++) {
            const int meets = near[2 * (i * n + j)] >= CORNER, level = j != i && fabsf(parts[i].top - parts[j].top) < RIM;
            if (parts[j].upright ? meets || level : meets && (parts[j].reason == BEYOND || parts[j].reason == WALL)) {
                parts[i].reason = WALL, changed = 1;
            }
        }
    }
    while (changed) {
        changed = 0;
        for (int64_t i = 1; i < n; i++) {
            for (int64_t j = 1; j < n && parts[i].reason == STANDS; j++) {
                const int joined = near[2 * (i * n + j)] || NARROW * parts[i].within < parts[i].cells;
                if (joined && parts[j].reason == WALL && fabsf(parts[i].top - parts[j].top) < RIM) {
                    parts[i].reason = WALL, changed = 1;
                }
            }
        }
    }
}

/* A part that lies in the plane of a larger one beyond the table beside it is a piece of the same wall. */
static void continue_walls(const board *g, part *parts, const int32_t *near) {
    const int64_t n = g->of->n;
    const double flat = g->of->flat;
    for (int64_t j = 1; j < n; j++) {
        const sheet fit = parts[j].reason == BEYOND ? fit_sheet(parts + j) : (sheet){.variance = INFINITY};
        for (int64_t i = 1; i < n && fit.variance < flat * flat; i++) {
            int32_t within = 0;
            if (parts[i].reason != STANDS || !near[2 * (i * n + j)] || parts[j].cells < parts[i].cells) {
                continue;
            }
            for (int64_t c = parts[i].first; c <= parts[i].last; c++) {
                const float *p = g->of->grid + 3 * c;
                const double x = p[0] - fit.middle[0], y = p[1] - fit.middle[1], z = p[2] - fit.middle[2];
                within += g->of->labels[c] == i && fabs(x * fit.normal[0] + y * fit.normal[1] + z * fit.normal[2]) < 2.0 * flat;
            }
            parts[i].reason = 5 * within > 4 * parts[i].cells ? WALL : parts[i].reason;
        }
    }
}

/* Why each part is background, and whether the image cuts it. reasons, cut: (n). outline: (4 h + 2, 3), the corners of the hull of the table [m]; found: (1), how many,
 * -1 without memory. */
VECTORISED void find_background(const Parts *of, int64_t *reasons, uint8_t *cut, double *outline, int64_t *found) {
    const int64_t h = of->h, w = of->w, n = of->n, most = h * (w / 2 + 1), some = 4 * h + 2;
    const size_t zeros = (size_t)n * sizeof(part) + (size_t)(2 * n * n + w + most) * sizeof(int32_t);
    const size_t rest = (size_t)(3 * some) * sizeof(ray) + (size_t)(2 * most) * (sizeof(run) + sizeof(int32_t)) + (size_t)(h * w) * (sizeof(float) + 1);
    part *parts = malloc(zeros + rest);
    *found = -1;
    if (!parts) {
        return;
    }
    memset(parts, 0, zeros);
    int32_t *near = (int32_t *)(parts + n), *filled = near + 2 * n * n, *size = filled + w;
    ray *ends = (ray *)(size + most), *hull = ends + some;
    run *runs[2] = {(run *)(hull + 2 * some), (run *)(hull + 2 * some) + most};
    int32_t *roots[2] = {(int32_t *)(runs[1] + most), (int32_t *)(runs[1] + most) + most};
    board g = {.h = h, .w = w, .of = of, .height = (float *)(roots[1] + most)};
    g.kind = (uint8_t *)(g.height + h * w);
    read_cells(&g, filled);
    gather_table(&g, runs, roots, size);
    ray *beyond = ends + 2 * h;
    const ray_counts count = ends_of(&g, FURTHER * (float)of->pitch * (float)(h > w ? h : w), ends, beyond);
    int64_t n_hull = *found = hull_of(ends, count.ends, hull);
    for (int64_t k = 0; k < n_hull; k++) {
        const double u = (double)hull[k].u, v = (double)hull[k].v, *t = of->plane, z = -t[3] / (u * t[0] + v * t[1] + t[2]);
        outline[3 * k] = u * z, outline[3 * k + 1] = v * z, outline[3 * k + 2] = z;
    }
    if (count.beyond) { /* the hull is that of its own corners, and of the points beyond */
        memcpy(ends, hull, (size_t)n_hull * sizeof(ray));
        memmove(ends + n_hull, beyond, (size_t)count.beyond * sizeof(ray));
        n_hull = hull_of(ends, n_hull + count.beyond, hull);
    }
    measure(&g, hull, n_hull, parts, near);
    judge(&g, parts);
    spread(parts, near, n);
    continue_walls(&g, parts, near);
    find_bin(&g, parts, near);
    for (int64_t i = 0; i < n; i++) {
        reasons[i] = parts[i].reason, cut[i] = ABROAD * parts[i].border >= parts[i].ring && parts[i].border;
    }
    free(parts);
}

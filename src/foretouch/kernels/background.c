/* SPDX-License-Identifier: Apache-2.0 */
/* Which parts of a scene stand on the table, and which are background, for cloud/segmentation/background.py.
 *
 * It is decided on the coarse grid of pixels. The outline of the table is the convex hull, in the image, of those of its pieces
 * that belong together: holes, and what stands on the table, may lie between them, but not the world below it. A part is inside if
 * the feet of its points, along the normal of the table, are. */
#include "eigen.h"
#include "sets.h"

enum { PLANE, LEVEL = 4, NOISE, BELOW, BORDER, FLOOR, FLAT }; /* of `settings`: the table, its height [m], and divided by depth^2 [1/m],
    the depth from which on the world is below it [m], share of an outline at the border, height of a foot, thickness of a wall [m] */
enum { STANDS, ENTERS, BEYOND, FLOATS, WALL }; /* reasons; STANDS is none */
enum { HOLE, TABLE, UNDER, OVER };             /* kinds of cells */

#define EMPTY 50     /* a margin on the left or right with depth in fewer than one of as many cells of each column is out of view, */
#define FILLED 2     /* if every other cell has depth near it, */
#define NEXT 3       /* cells further in, */
#define MARGIN 8     /* and if it is as many times narrower than the image: registered depth has such; above, it may be the horizon */
#define PIECE 100    /* a piece of the table that is as many times smaller than the largest is noise */
#define CONTACT 20   /* and a part of whose outline, or cells, fewer than one of as many are at the table floats */
#define ABROAD 50    /* what hovers above the table comes from out of view if one of as many edges around it is at the border, and high */
#define FURTHER 0.3f /* of the width of the view: so far goes a table on that is cut off by the image */
#define CLOSE 0.02f  /* difference in depth of cells that are connected [m] */
#define MANY 30      /* cells of a wall */

typedef struct {
    double sum[9];
    int32_t cells, low, inside, ring, border, raised, table, touching, reason; /* ring: edges around it, and those at the border of the
        image, also without the low ones, beside the table, and at its depth */
} part;

typedef struct {
    float u, v;
} ray;

typedef struct {
    int64_t h, w, first[2], last[2]; /* rows and columns in view */
    const float *p;
    float *height;
    uint8_t *kind;
    int32_t *piece, *link;
    const int32_t *labels;
    const double *s;
} board;

static int before(const void *a, const void *b) {
    const ray *one = a, *other = b;
    return one->u != other->u ? (one->u > other->u) - (one->u < other->u) : (one->v > other->v) - (one->v < other->v);
}

INLINE float side_of(const ray *a, const ray *b, float u, float v) { return (b->u - a->u) * (v - a->v) - (b->v - a->v) * (u - a->u); }

/* The convex hull of n rays, sorted by this, counter-clockwise; hull: (2 n). Returns its size (Andrew 1979). */
static int64_t hull_of(ray *some, int64_t n, ray *hull) {
    int64_t count = 0, least = 2;
    qsort(some, (size_t)n, sizeof *some, before);
    for (int64_t k = 0; k < 2 * n; k++) {
        const ray *one = some + (k < n ? k : 2 * n - 1 - k);
        least = k == n ? count + 1 : least;
        while (count >= least && side_of(hull + count - 2, hull + count - 1, one->u, one->v) <= 0.0f) {
            count--;
        }
        hull[count++] = *one;
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

/* Connects neighbours that are of a kind, or, if `but`, that are not; a neighbour that is connected by another one already is left out. */
INLINE void connect(const board *g, int32_t *parent, int kind, int but) {
    for (int64_t y = 0; y < g->h; y++) {
        for (int64_t x = 0; x < g->w; x++) {
            const int64_t i = y * g->w + x, up = i - g->w;
            if ((g->kind[i] == kind) == but) {
                parent[i] = (int32_t)i;
                continue;
            }
            const int left = x && (g->kind[i - 1] == kind) != but, above = y && (g->kind[up] == kind) != but;
            const int before = x && y && (g->kind[up - 1] == kind) != but, after = y && x + 1 < g->w && (g->kind[up + 1] == kind) != but;
            parent[i] = left ? parent[i - 1] : above ? parent[up] : before ? parent[up - 1] : after ? parent[up + 1] : (int32_t)i;
            if (left && above && !before) {
                join(parent, (int32_t)i, (int32_t)up);
            }
            if ((left || before) && after && !above) {
                join(parent, (int32_t)i, (int32_t)up + 1);
            }
        }
    }
}

/* Heights and kinds of the cells, the rows and columns in view, and the connected sets of the table, and of all but the world below. */
INLINE void read_cells(board *g) {
    const float a = (float)g->s[PLANE], b = (float)g->s[PLANE + 1], c = (float)g->s[PLANE + 2], d = (float)g->s[PLANE + 3];
    int32_t *filled = calloc((size_t)g->w, sizeof(int32_t));
    for (int64_t y = 0; y < g->h; y++) {
        const float *p = g->p + 3 * y * g->w;
        float *height = g->height + y * g->w;
        for (int64_t x = 0; x < g->w; x++) {
            height[x] = p[3 * x] * a + p[3 * x + 1] * b + p[3 * x + 2] * c + d;
        }
        for (int64_t x = 0; x < g->w; x++) {
            const float z = p[3 * x + 2], noise = z * z * (float)g->s[NOISE], level = noise > (float)g->s[LEVEL] ? noise : (float)g->s[LEVEL];
            const int32_t other = height[x] < -(float)g->s[BELOW] ? UNDER : fabsf(height[x]) <= level ? TABLE : OVER;
            g->kind[y * g->w + x] = (uint8_t)(height[x] != height[x] ? HOLE : g->labels[y * g->w + x] ? OVER : other);
        }
        for (int64_t x = 0; x < g->w && filled; x++) {
            filled[x] += g->kind[y * g->w + x] != HOLE;
        }
    }
    connect(g, g->piece, TABLE, 0);
    int64_t first = 0, last = g->w - 1;
    while (filled && first < last && EMPTY * filled[first] < g->h) {
        first++;
    }
    while (filled && last > first && EMPTY * filled[last] < g->h) {
        last--;
    }
    const int enough = filled && first + NEXT < last;
    g->first[0] = 0, g->last[0] = g->h - 1;
    g->first[1] = enough && MARGIN * first < g->w && FILLED * filled[first + NEXT] >= g->h ? first : 0;
    g->last[1] = enough && MARGIN * (g->w - 1 - last) < g->w && FILLED * filled[last - NEXT] >= g->h ? last : g->w - 1;
    free(filled);
}

/* Keeps as TABLE the cells of the pieces that belong together; size: (h w), zeros. */
INLINE void gather_table(board *g, int32_t *size) {
    int32_t largest = -1;
    for (int64_t i = 0; i < g->h * g->w; i++) {
        if (g->kind[i] == TABLE) {
            const int32_t root = g->piece[i] = g->piece[g->piece[i]]; /* those before are numbered with their roots already */
            size[root]++;
            largest = largest < 0 || size[root] > size[largest] ? root : largest;
        }
    }
    int several = 0;
    for (int64_t i = 0; i < g->h * g->w; i++) {
        if (g->kind[i] == TABLE && g->piece[i] != largest) {
            const int kept = PIECE * size[g->piece[i]] >= size[largest];
            g->kind[i] = kept ? TABLE : OVER, several |= kept;
        }
    }
    if (several) {
        connect(g, g->link, UNDER, 1);
        const int32_t whole = root_of(g->link, largest);
        for (int64_t i = 0; i < g->h * g->w; i++) {
            g->kind[i] = g->kind[i] == TABLE && root_of(g->link, (int32_t)i) != whole ? OVER : g->kind[i];
        }
    }
}

/* The ends of each row of the table, and where the image cuts it off and `further` is positive, points so far beyond. */
INLINE int64_t ends_of(const board *g, float further, ray *some) {
    int64_t n = 0;
    for (int64_t y = g->first[0]; y <= g->last[0]; y++) {
        const uint8_t *kind = g->kind + y * g->w;
        int64_t ends[2] = {g->first[1], g->last[1]};
        while (ends[0] <= ends[1] && kind[ends[0]] != TABLE) {
            ends[0]++;
        }
        while (ends[1] > ends[0] && kind[ends[1]] != TABLE) {
            ends[1]--;
        }
        for (int k = 0; k < 2 && ends[0] <= ends[1]; k++) {
            const float *p = g->p + 3 * (y * g->w + ends[k]);
            const float aside = (float)((ends[k] == g->last[1]) - (ends[k] == g->first[1]));
            const float along = (float)((y == g->last[0]) - (y == g->first[0]));
            some[n++] = (ray){p[0] / p[2], p[1] / p[2]};
            if (further > 0.0f && (aside != 0.0f || along != 0.0f)) {
                some[n] = (ray){some[n - 1].u + aside * further, some[n - 1].v + along * further};
                n++;
            }
        }
    }
    return n;
}

/* One edge between a cell of a part and what is beside it: another cell, or nothing at the border of the image. near: (n, n, 2), edges
 * between parts that are close, and all. */
INLINE void add_edge(const board *g, part *parts, int32_t *near, int64_t n, int64_t i, int64_t other, int at_border) {
    part *one = parts + g->labels[i];
    one->ring++, one->border += at_border, one->raised += at_border && g->height[i] > (float)g->s[FLOOR];
    if (!at_border) {
        const int close = fabsf(g->p[3 * other + 2] - g->p[3 * i + 2]) < CLOSE;
        one->table += g->kind[other] == TABLE, one->touching += close && g->kind[other] == TABLE;
        near[(g->labels[i] * n + g->labels[other]) * 2] += close && g->labels[other];
        near[(g->labels[i] * n + g->labels[other]) * 2 + 1] += g->labels[other] != 0;
    }
}

static void measure(const board *g, const ray *hull, int64_t n_hull, part *parts, int32_t *near, int64_t n) {
    const float *t = (const float[3]){(float)g->s[PLANE], (float)g->s[PLANE + 1], (float)g->s[PLANE + 2]};
    for (int64_t y = g->first[0]; y <= g->last[0]; y++) {
        for (int64_t x = g->first[1]; x <= g->last[1]; x++) {
            const int64_t i = y * g->w + x, around[4] = {i - 1, i + 1, i - g->w, i + g->w};
            const int ends[4] = {x == g->first[1], x == g->last[1], y == g->first[0], y == g->last[0]};
            if (!g->labels[i] || g->kind[i] == HOLE) {
                continue;
            }
            part *one = parts + g->labels[i];
            const float *p = g->p + 3 * i, up = g->height[i], z = p[2] - up * t[2];
            one->cells++, one->low += up < (float)g->s[FLOOR];
            one->inside += z > 0.0f && is_within(hull, n_hull, (p[0] - up * t[0]) / z, (p[1] - up * t[1]) / z);
            for (int k = 0, at = 3; k < 3; k++) {
                one->sum[k] += (double)p[k];
                for (int l = k; l < 3; l++) {
                    one->sum[at++] += (double)p[k] * (double)p[l];
                }
            }
            for (int k = 0; k < 4; k++) {
                if (ends[k] || g->labels[around[k]] != g->labels[i]) {
                    add_edge(g, parts, near, n, i, around[k], ends[k]);
                }
            }
        }
    }
}

/* The reason of each part by itself; FLOATS also where it may rest on another one. */
static void judge(part *parts, int64_t n, const double *s) {
    for (part *one = parts + 1; one < parts + n; one++) {
        const int inside = 2 * one->inside >= one->cells;
        const int hovers = ABROAD * one->border >= one->ring && 10 * one->raised >= 9 * one->border && CONTACT * one->touching < one->ring;
        const int cut = hovers || (double)one->border >= s[BORDER] * (double)one->ring;
        const int rests = CONTACT * one->table >= one->ring || CONTACT * one->low >= one->cells;
        one->reason = !one->cells ? STANDS : cut ? (inside ? ENTERS : BEYOND) : !inside ? BEYOND : rests ? STANDS : FLOATS;
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

/* A part that lies in the plane of one beyond the table beside it is a piece of the same wall. */
static void continue_walls(const board *g, part *parts, const int32_t *near, int64_t n) {
    for (int64_t j = 1; j < n; j++) {
        if (parts[j].reason != BEYOND || parts[j].cells < MANY) {
            continue;
        }
        double middle[3], spread[6], values[3], normal[3];
        for (int k = 0, at = 3; k < 3; k++) {
            middle[k] = parts[j].sum[k] / parts[j].cells;
            for (int l = k; l < 3; l++, at++) {
                spread[at - 3] = parts[j].sum[at] / parts[j].cells - middle[k] * (parts[j].sum[l] / parts[j].cells);
            }
        }
        eigen3(spread, values, normal);
        for (int64_t i = 1; i < n && values[0] < g->s[FLAT] * g->s[FLAT]; i++) {
            int32_t within = 0;
            for (int64_t c = 0; c < g->h * g->w && parts[i].reason == STANDS && near[2 * (i * n + j)]; c++) {
                const float *p = g->p + 3 * c;
                within += g->labels[c] == i && fabs((p[0] - middle[0]) * normal[0] + (p[1] - middle[1]) * normal[1] + (p[2] - middle[2]) * normal[2]) < 2.0 * g->s[FLAT];
            }
            parts[i].reason = 5 * within > 4 * parts[i].cells ? WALL : parts[i].reason;
        }
    }
}

/* Why each part of a coarse grid (h, w, 3) is background.
 *
 * labels: (h, w), from 1 to n - 1. pitch: of the grid, lateral distance per depth. reasons: (n). outline: (4 h + 2, 2), the ends of the hull of the
 * table as x / z and y / z; found: (1), how many, -1 without memory. */
VECTORISED void find_background(const float *grid, int64_t h, int64_t w, const int32_t *labels, int64_t n, double pitch, const double *settings, int64_t *reasons,
                     float *outline, int64_t *found) {
    const size_t cells = (size_t)(h * w), some = (size_t)(4 * h + 2);
    board g = {.h = h, .w = w, .p = grid, .labels = labels, .s = settings};
    part *parts = calloc(1, (size_t)n * sizeof(part) + (size_t)(2 * n * n) * sizeof(int32_t) + 3 * some * sizeof(ray) + cells * (4 * sizeof(int32_t) + 1));
    *found = -1;
    if (!parts) {
        return;
    }
    int32_t *near = (int32_t *)(parts + n), *size;
    ray *ends = (ray *)(near + 2 * n * n), *hull = ends + some;
    size = (int32_t *)(hull + 2 * some), g.piece = size + cells, g.link = g.piece + cells, g.height = (float *)(g.link + cells), g.kind = (uint8_t *)(g.height + cells);
    read_cells(&g);
    gather_table(&g, size);
    *found = hull_of(ends, ends_of(&g, 0.0f, ends), hull);
    memcpy(outline, hull, (size_t)*found * sizeof(ray));
    const int64_t n_hull = hull_of(ends, ends_of(&g, FURTHER * (float)pitch * (float)(h > w ? h : w), ends), hull);
    measure(&g, hull, n_hull, parts, near, n);
    judge(parts, n, settings);
    spread(parts, near, n);
    continue_walls(&g, parts, near, n);
    for (int64_t i = 0; i < n; i++) {
        reasons[i] = parts[i].reason;
    }
    free(parts);
}

/* SPDX-License-Identifier: Apache-2.0 */
/* Objects that touch: clusters are divided into fragments, and those of one object joined again (docs/segmentation.md).
 *
 * - Cells: squares of some pixels, with their mean point. Normals are fitted over 5x5 of them, to the inverse depth: on a plane it
 *   changes by the same step from each pixel to the next, and the noise of a stereo camera is the same at all depths.
 * - Edges between two cells: how much they `bend`, positive where concave, by the normals on both sides; STEP where the depth jumps.
 * - Fragments: watersheds of the distance from concave edges and steps, so that necks divide as well.
 * - Input of the trees: sums over each fragment, over the border of two, and over the lines on which one continues in the other
 *   behind a nearer one; from these the shape of a fragment, and FEATURES numbers of both and their border.
 * - Joining: tiny fragments first, then the pairs that the trees rate highest, again with what they have become, then small parts.
 * - Parts: what the fragments of cells have become, for each pixel.
 *
 * All steps are INLINE, as only what is inlined in `split_clusters` is compiled for AVX2, too. */
#include "eigen.h"
#include "sets.h"

enum { BEND, STEP_M, PART_M2, SAME, PLANE, PITCH = PLANE + 4, NOISE }; /* of `settings` */
enum { PARTS, BY_SIZE, BY_BORDER, BY_VIEW, RATED, COUNTS };       /* of `counts` */
enum { TINY_ONES, RATED_ONES, SMALL_ONES };                       /* that are joined, in this order */
enum { REFUSED, ACCEPTED, CELLS_OF, JOINS };                      /* of `joins` */

#define STEP 2.0f   /* bend of a step in depth: chord of opposite normals */
#define FULL 0.7f   /* a sharper bend counts as much as this one, of 40 degrees, and a convex one as none */
#define CONVEX_BEND 0.17f /* an edge is convex from 10 degrees on */
#define REACH 2     /* cells from an edge to the normals that are compared, and from a normal to the edge of its window */
#define NECK 2      /* halves of a cell by which a neck is narrower than both fragments that it separates, on each side */
#define SLOPE 4.0f  /* depth per lateral distance of cells that have no further neighbours */
#define TINY 10     /* a fragment of fewer cells has no shape, and joins the neighbour from which it is separated least */
#define SMOOTH 2.0  /* log odds of one object that are added where a border bends less than the angle on average */
#define TURN 0.25f  /* chord of the normals of one surface on both sides of a nearer part */
#define SKEW 0.05f  /* and how far it may be off for each metre between them */
#define LIKE 0.005f /* a difference in depth that counts as much as a cell [m] */
#define HOLLOW 0.1f /* bend of a surface that is hollow, 6 degrees over 2 * REACH + 1 cells */
#define AT_ONCE 4   /* trees that are walked, each of which waits for its memory */
#define SOME 64     /* borders whose highest key is kept */
#define EVEN 0.02   /* share of the normals in all directions that is assumed besides those that are seen */

/* Sums over the cells of a fragment: of points p about an origin, and where there is a normal n of p, n and m = p x n. */
enum { CELLS, AREA, OUTLINE, P, PP = P + 3, SEEN = PP + 6, HOLLOWS, PN, Q, N = Q + 3, NN = N + 3, NM = NN + 6, MM = NM + 9, TOUCH = MM + 6, SUMS };
/* and over the edges of a border: `before` those where the first is nearer less the others, then lines behind a nearer part, and points. */
enum { LENGTH, BENT, STEPS, CONVEX, SIGNED, BEFORE, STEPPED, LINES, AGREE, SHARP, UNEVEN, MIDDLE, EDGES = MIDDLE + 3, FEATURES = 64 };

typedef struct {
    float p[3], n[3]; /* mean point [m], normal towards the camera; NAN where there is none */
    int32_t label, part;
} cell;

typedef struct {
    double c[3], n[3], flat, thin, slim, full, out; /* middle, mean normal and its length, thickness, width per length, area per both, mean of n (p - c) */
    double u[3], axis[3], miss, next, side; /* axis that the normals meet, how far they miss it and the next best, share across it */
} shape;

typedef struct {
    double sum[SUMS], top, bottom; /* heights above the table */
    double accepted;       /* lowest log odds of the joins that made it, infinite without any that was rated */
    shape is;              /* of the sums, once it is `known` */
    int32_t known, to, first, seed; /* the fragment that it has joined, its first border (a side of it), the innermost cell of its largest */
} fragment;

typedef struct {
    int32_t of[2], next[2]; /* fragments, `of` 0 where it is gone; the next side of a border of each of them: 2 borders + side, or -1 */
    double sum[EDGES], score;
} border;

typedef struct {
    const Labelled *of;   /* of which a cell has k x k pixels, */
    const float *first; /* and its first point */
    const double *s;    /* settings */
    const Trees *trees;
    int64_t k, h, w, n, n_fragments, n_borders; /* cells; fragments count from 1 */
    cell *cells;
    float *u, *v, *d;  /* of the cells: x / z and y / z of the mean point, and its inverse depth */
    uint8_t *reach[4]; /* cells to the left, right, up and down, at most REACH, from which no step separates a cell */
    float *bends;      /* of the edges to the right and down (n, 2); NAN where there is none */
    int32_t *inside;   /* halves of a cell from the nearest edge that may separate */
    int32_t *root, *first_of, *next; /* first cell of each distance from an edge, and the next one of that distance */
    fragment *fragments;
    border *borders;
    double *keys, *peaks; /* of the borders: the highest is joined next; and the highest of each SOME borders */
    int32_t *met;     /* of fragments: a border with the one that is joined, or -1 */
    double origin[3]; /* of the sums */
    int64_t *counts;
} graph;

/* Whether clusters of a window call for splitting or joining, from every `stride`-th pixel: the nodes that lie deeper than the
 * middle between two of their cluster `arm` pixels away by more than sag + noise z^2, and those next to another cluster. */
void concave_nodes(const Labelled *v, int64_t stride, int64_t arm, double sag, double noise, int64_t *counts) {
    counts[0] = counts[1] = 0;
    for (int dir = 0; dir < 2; dir++) {
        const int64_t row = dir ? arm : 0, column = dir ? 0 : arm;
        for (int64_t y = row; y < v->h - row; y += stride) {
            for (int64_t x = column; x < v->w - column; x += stride) {
                const int32_t *label = v->labels + y * v->w + x, first = label[-row * v->w - column], last = label[row * v->w + column];
                if (first && last && first == *label && first == last) {
                    const float *p = v->xyz + 3 * ((v->row + y) * v->across + v->column + x) + 2;
                    const float d = 0.5f / p[-3 * (row * v->across + column)] + 0.5f / p[3 * (row * v->across + column)], z = *p;
                    counts[0] += z - 1.0f / d > (float)sag + (float)noise * z * z;
                } else {
                    counts[1] += first && last && first != last;
                }
            }
        }
    }
}

/* CELLS. The mean point of each, by its cluster: of those pixels whose depth is near that of one in the middle. A cell of no cluster
 * has the point in its middle. */
INLINE void make_cells(graph *g) {
    const Labelled *l = g->of;
    const int64_t k = g->k, h = l->h, w = l->w;
    for (int64_t i = 0, at = 0; i < g->h; i++) {
        for (int64_t j = 0; j < g->w; j++, at++) {
            cell *c = g->cells + at;
            const int64_t bottom = (i + 1) * k < h ? (i + 1) * k : h, right = (j + 1) * k < w ? (j + 1) * k : w;
            int64_t y0 = (i * k + bottom) / 2, x0 = (j * k + right) / 2;
            for (int64_t y = i * k; y < bottom && !l->solid[y0 * w + x0]; y++) { /* a point at the middle, else any */
                for (int64_t x = j * k; x < right; x++) {
                    x0 = l->solid[y * w + x] ? x : x0, y0 = l->solid[y * w + x] ? y : y0;
                }
            }
            const float *middle = g->first + 3 * (y0 * l->across + x0), gap = (float)g->s[STEP_M];
            float sum[4] = {0.0f};
            c->label = l->solid[y0 * w + x0] ? l->labels[y0 * w + x0] : 0;
            for (int64_t y = i * k; y < bottom && c->label; y++) {
                for (int64_t x = j * k; x < right; x++) {
                    const float *p = g->first + 3 * (y * l->across + x);
                    if (l->solid[y * w + x] && l->labels[y * w + x] == c->label && fabsf(p[2] - middle[2]) < gap) {
                        const float d = 1.0f / p[2];
                        sum[0] += p[0] * d, sum[1] += p[1] * d, sum[2] += d, sum[3] += 1.0f;
                    }
                }
            }
            const float d = g->d[at] = c->label ? sum[2] / sum[3] : 1.0f / middle[2];
            c->p[0] = c->label ? sum[0] / sum[3] / d : middle[0], c->p[1] = c->label ? sum[1] / sum[3] / d : middle[1], c->p[2] = 1.0f / d;
            g->u[at] = c->p[0] * d, g->v[at] = c->p[1] * d;
        }
    }
}

/* EDGES. Whether the depth jumps between two cells, by more than it changes before and after them; -1 for no cell there. */
INLINE int broken(const graph *g, int64_t i, int64_t o, int64_t before, int64_t after) {
    const cell *a = g->cells + i, *b = g->cells + o;
    const float *d = g->d, limit = (float)g->s[STEP_M] * d[i] * d[o], by = d[o] - d[i];
    if (!(fabsf(by) > limit)) {
        return 0;
    }
    const float slope = SLOPE * sqrtf((b->p[0] - a->p[0]) * (b->p[0] - a->p[0]) + (b->p[1] - a->p[1]) * (b->p[1] - a->p[1]));
    const float left = before >= 0 && g->cells[before].label == a->label ? by - (d[i] - d[before]) : NAN;
    const float right = after >= 0 && g->cells[after].label == a->label ? by - (d[after] - d[o]) : NAN;
    if (left != left && right != right) {
        return fabsf(by) > limit + slope * d[i] * d[o];
    }
    return fabsf(by) > limit + slope / 2 * d[i] * d[o] && !(fabsf(left) <= limit) && !(fabsf(right) <= limit);
}

/* The step in depth across each edge, before there are normals, and how far cells reach without one. */
INLINE void find_steps(graph *g) {
    for (int64_t y = 0, i = 0; y < g->h; y++) {
        for (int64_t x = 0; x < g->w; x++, i++) {
            g->bends[2 * i] = g->bends[2 * i + 1] = NAN;
            for (int dir = 0; dir < 2 && g->cells[i].label; dir++) {
                const int64_t to = dir ? g->w : 1, at = dir ? y : x, length = dir ? g->h : g->w;
                if (at + 1 == length || !g->cells[i + to].label) {
                    continue;
                }
                uint8_t *back = g->reach[2 * dir], *on = g->reach[2 * dir + 1];
                const int jump = g->cells[i + to].label != g->cells[i].label || broken(g, i, i + to, at ? i - to : -1, at + 2 < length ? i + 2 * to : -1);
                g->bends[2 * i + dir] = jump ? STEP : 0.0f;
                back[i + to] = jump ? 0 : back[i] < REACH ? back[i] + 1 : REACH;
                for (int64_t t = 0; t < back[i + to]; t++) {
                    on[i - t * to]++;
                }
            }
        }
    }
}

INLINE int8x32 wide(const uint8_t *bytes) {
    typedef uint8_t bytes8 __attribute__((vector_size(8), aligned(1), may_alias));
    return __builtin_convertvector(*(const bytes8 *)bytes, int8x32);
}

/* Planes through the inverse depth of the cells around each, without a step between: those of eight cells at once. */
INLINE void make_normals(graph *g) {
    for (int64_t i = 0; i < g->n; i += 8) {
        const float8 u0 = *(const float8u *)(g->u + i), v0 = *(const float8u *)(g->v + i), d0 = *(const float8u *)(g->d + i);
        float8 m[9] = {{0.0f}}, n[3], size;
        int any = 0;
        for (int64_t k = i; k < i + 8 && k < g->n; k++) {
            any |= g->cells[k].label, g->cells[k].n[0] = g->cells[k].n[1] = g->cells[k].n[2] = NAN;
        }
        if (!any) {
            continue;
        }
        for (int64_t y = -REACH; y <= REACH; y++) {
            const int64_t row = i + y * g->w;
            const int8x32 left = wide(g->reach[0] + row), right = wide(g->reach[1] + row), column = wide(g->reach[y < 0 ? 2 : 3] + i) >= (int32_t)labs(y);
            for (int64_t x = -REACH; x <= REACH; x++) {
                const int8x32 there = column & ((x < 0 ? left : right) >= (int32_t)labs(x));
                const float8 u = (float8)(there & (int8x32)(*(const float8u *)(g->u + row + x) - u0)), v = (float8)(there & (int8x32)(*(const float8u *)(g->v + row + x) - v0));
                const float8 d = (float8)(there & (int8x32)(*(const float8u *)(g->d + row + x) - d0));
                m[0] -= __builtin_convertvector(there, float8), m[1] += u, m[2] += v, m[3] += d;
                m[4] += u * u, m[5] += u * v, m[6] += v * v, m[7] += u * d, m[8] += v * d;
            }
        }
        const float8 uu = m[4] - m[1] * m[1] / m[0], uv = m[5] - m[1] * m[2] / m[0], vv = m[6] - m[2] * m[2] / m[0];
        const float8 ud = m[7] - m[1] * m[3] / m[0], vd = m[8] - m[2] * m[3] / m[0], det = uu * vv - uv * uv;
        n[0] = (ud * vv - vd * uv) / det, n[1] = (vd * uu - ud * uv) / det; /* a x + b y + e z = 1 */
        n[2] = d0 + (m[3] - n[0] * m[1] - n[1] * m[2]) / m[0] - n[0] * u0 - n[1] * v0, size = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
        for (int64_t k = 0; k < 8 && i + k < g->n; k++) {
            for (int x = 0; x < 3 && m[0][k] >= 5.0f && det[k] > 1e-3f * uu[k] * vv[k]; x++) {
                g->cells[i + k].n[x] = -n[x][k] / sqrtf(size[k]);
            }
        }
    }
}

/* The cell farthest along a line without a step; way 0 left, 1 right, 2 up, 3 down. */
INLINE int64_t walk(const graph *g, int64_t i, int way) {
    return i + (way & 1 ? 1 : -1) * (way & 2 ? g->w : 1) * g->reach[way][i];
}

INLINE void make_bends(graph *g) {
    for (int64_t k = 0; k < 2 * g->n; k++) {
        const int dir = k & 1;
        if (g->bends[k] == 0.0f) {
            const cell *a = g->cells + walk(g, k / 2, 2 * dir), *b = g->cells + walk(g, k / 2 + (dir ? g->w : 1), 2 * dir + 1);
            float chord = 0.0f, side = 0.0f;
            for (int x = 0; x < 3; x++) {
                const float turn = a->n[x] - b->n[x];
                chord += turn * turn, side += turn * (a->p[x] - b->p[x]);
            }
            g->bends[k] = chord == chord ? (side < 0.0f ? sqrtf(chord) : -sqrtf(chord)) : 0.0f;
        }
    }
}

/* FRAGMENTS. Distance of cells from the nearest edge that is concave, a step, or that of the cluster: in halves of a cell, 2 to a neighbour
 * and 3 to a diagonal one; 1 beside such an edge, 0 without a normal. Returns the largest. */
INLINE int32_t find_depths(graph *g) {
    int32_t most = 0, *inside = g->inside;
    for (int64_t i = 0; i < g->n; i++) {
        inside[i] = g->cells[i].n[0] == g->cells[i].n[0] ? INT32_MAX / 2 : 0;
    }
    for (int64_t k = 0; k < 2 * g->n; k++) {
        if (!(g->bends[k] <= (float)g->s[BEND])) {
            const int64_t i = k / 2, o = i + (k & 1 ? g->w : 1);
            inside[i] = inside[i] ? 1 : 0;
            if (o < g->n) {
                inside[o] = inside[o] ? 1 : 0;
            }
        }
    }
    for (int64_t to = -1; to <= 1; to += 2) { /* from the first cell to the last, and back */
        for (int64_t t = 0; t < g->n; t += g->w) {
            for (int64_t x = 0; x < g->w; x++) {
                const int64_t i = to < 0 ? t + x : g->n - 1 - t - x, row = i + to * g->w;
                const int above = row >= 0 && row < g->n, before = x > 0, after = x + 1 < g->w;
                if (!inside[i]) {
                    continue;
                }
                const int32_t ways[4] = {before ? inside[i + to] + 2 : 1, above ? inside[row] + 2 : 1, above && before ? inside[row + to] + 3 : 1, above && after ? inside[row - to] + 3 : 1};
                for (int way = 0; way < 4; way++) {
                    inside[i] = ways[way] < inside[i] ? ways[way] : inside[i];
                }
                most = to > 0 && inside[i] > most ? inside[i] : most;
            }
        }
    }
    return most;
}

/* Fragments: watersheds of that distance, as a neck between concave edges separates two fragments as well as an edge all
 * along. Cells are added from the innermost on; two fragments that meet are one unless the neck is narrower than both. */
INLINE void make_fragments(graph *g) {
    const int32_t innermost = find_depths(g);
    memset(g->root, -1, (size_t)g->n * sizeof(int32_t));
    memset(g->first_of, -1, ((size_t)innermost + 1) * sizeof(int32_t));
    for (int64_t i = g->n - 1; i >= 0; i--) {
        if (g->cells[i].label) {
            g->next[i] = g->first_of[g->inside[i]], g->first_of[g->inside[i]] = (int32_t)i;
        }
    }
    for (int32_t level = innermost; level >= 0; level--) {
        for (int64_t i = g->first_of[level]; i >= 0; i = g->next[i]) {
            const int64_t edges[4] = {2 * (i - 1), 2 * i, 2 * (i - g->w) + 1, 2 * i + 1}, others[4] = {i - 1, i + 1, i - g->w, i + g->w};
            int32_t own = g->root[i] = (int32_t)i;
            for (int side = 0; side < 4; side++) {
                const int64_t o = others[side];
                if (edges[side] < 0 || !(g->bends[edges[side]] <= (float)g->s[BEND]) || g->root[o] < 0) {
                    continue;
                }
                const int32_t next = root_of(g->root, (int32_t)o), a = g->inside[next], b = g->inside[own];
                if (own != i && (a < b ? a : b) < level + NECK) {
                    g->root[a > b ? own : next] = a > b ? next : own;
                }
                own = own == i || a > b ? next : own;
            }
            g->root[i] = own;
        }
    }
    int32_t count = 0;
    for (int64_t i = 0; i < g->n; i++) {
        g->cells[i].part = g->root[i] == i ? ++count : 0;
    }
    for (int64_t i = 0; i < g->n; i++) {
        g->cells[i].part = g->root[i] < 0 ? 0 : g->cells[root_of(g->root, (int32_t)i)].part;
    }
    g->n_fragments = count;
}

/* INPUT OF THE TREES. The border of two fragments, made if there is none; the first of them is `of[0]`, as it has the smaller number. */
INLINE border *border_of(graph *g, int32_t a, int32_t b) {
    const int32_t ends[2] = {a < b ? a : b, a < b ? b : a};
    for (int32_t at = g->fragments[ends[0]].first; at >= 0; at = g->borders[at / 2].next[at & 1]) {
        if (g->borders[at / 2].of[!(at & 1)] == ends[1]) {
            return g->borders + at / 2;
        }
    }
    border *made = g->borders + g->n_borders;
    *made = (border){.of = {ends[0], ends[1]}};
    for (int side = 0; side < 2; side++) {
        made->next[side] = g->fragments[ends[side]].first;
        g->fragments[ends[side]].first = (int32_t)(2 * g->n_borders + side);
    }
    g->n_borders++;
    return made;
}

static const int AT[9] = {0, 1, 2, 1, 3, 4, 2, 4, 5}; /* of a symmetric matrix in its upper half */

INLINE double dot(const double *a, const double *b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }

INLINE void cross(const double *a, const double *b, double *c) {
    c[0] = a[1] * b[2] - a[2] * b[1], c[1] = a[2] * b[0] - a[0] * b[2], c[2] = a[0] * b[1] - a[1] * b[0];
}

/* Adds a vector to a sum, and its products with itself to the one behind that. */
INLINE void add(double *sum, const double *p) {
    for (int k = 0, at = 3; k < 3; k++) {
        sum[k] += p[k];
        for (int l = k; l < 3; l++) {
            sum[at++] += p[k] * p[l];
        }
    }
}

/* Adds a cell to the sums of its fragment. */
INLINE void add_cell(graph *g, int64_t i) {
    const cell *c = g->cells + i;
    fragment *f = g->fragments + c->part;
    const double *t = g->s + PLANE, height = c->p[0] * t[0] + c->p[1] * t[1] + c->p[2] * t[2] + t[3], side = g->s[PITCH] * c->p[2];
    const double p[3] = {c->p[0] - g->origin[0], c->p[1] - g->origin[1], c->p[2] - g->origin[2]}, n[3] = {c->n[0], c->n[1], c->n[2]};
    f->top = height > f->top ? height : f->top, f->bottom = height < f->bottom ? height : f->bottom;
    f->seed = g->root[i] == i ? (int32_t)i : f->seed;
    f->sum[CELLS] += 1.0, f->sum[AREA] += side * side;
    add(f->sum + P, p);
    if (c->n[0] == c->n[0]) {
        double m[6] = {0.0}, *nm = f->sum + NM;
        cross(p, n, m);
        f->sum[SEEN] += 1.0, f->sum[PN] += dot(n, p);
        f->sum[HOLLOWS] += (g->bends[2 * i] > HOLLOW && g->bends[2 * i] < STEP) || (g->bends[2 * i + 1] > HOLLOW && g->bends[2 * i + 1] < STEP);
        add(f->sum + N, n);
        for (int k = 0; k < 9; k++) {
            nm[k] += n[k / 3] * m[k % 3];
            f->sum[Q + k % 3] += k < 3 ? p[k] : 0.0;
            f->sum[MM + AT[k]] += k % 3 >= k / 3 ? m[k / 3] * m[k % 3] : 0.0;
        }
    }
}

/* Sums of all fragments, and of all borders. */
INLINE void measure(graph *g) {
    for (int64_t i = 0; i <= g->n_fragments; i++) {
        g->fragments[i] = (fragment){.top = -INFINITY, .bottom = INFINITY, .accepted = INFINITY, .to = (int32_t)i, .first = -1};
    }
    for (int64_t i = 0, any = 0, end = 0; i < g->n; i++) {
        const cell *c = g->cells + i;
        end = i == end ? end + g->w : end; /* of the row */
        for (int k = 0; k < 3 && c->part && !any; k++) {
            g->origin[k] = c->p[k]; /* near all others, so that moments about it are exact enough */
        }
        if (c->part) {
            any = 1;
            add_cell(g, i);
        }
        for (int dir = 0; dir < 2; dir++) {
            const int last = dir ? i + g->w >= g->n : i == end - 1;
            const cell *o = last ? g->cells + g->n : c + (dir ? g->w : 1); /* behind the last cell is one of no part */
            const float bend = g->bends[2 * i + dir];
            if (c->part == o->part) {
                continue;
            }
            g->fragments[c->part].sum[OUTLINE] += 1.0, g->fragments[o->part].sum[OUTLINE] += 1.0;
            if (bend == bend) {
                border *of = border_of(g, c->part, o->part);
                const double before = (c->p[2] < o->p[2]) == (c->part == of->of[0]) ? 1.0 : -1.0;
                const int step = bend == STEP;
                const float even = bend > FULL ? FULL : bend < -FULL ? -FULL : bend;
                of->sum[LENGTH] += 1.0, of->sum[BENT] += even < 0.0f ? 0.0f : even, of->sum[UNEVEN] += even * even, of->sum[SHARP] += bend > (float)g->s[BEND];
                of->sum[STEPS] += step, of->sum[CONVEX] += bend < -CONVEX_BEND, of->sum[SIGNED] += step ? 0.0f : bend;
                of->sum[BEFORE] += before, of->sum[STEPPED] += step ? before : 0.0;
                g->fragments[c->part].sum[TOUCH] += 1.0, g->fragments[o->part].sum[TOUCH] += 1.0;
                for (int k = 0; k < 3; k++) {
                    of->sum[MIDDLE + k] += (c->p[k] + o->p[k]) / 2.0 - g->origin[k];
                }
            }
        }
    }
}

/* Depth of the plane of cell `i` on the ray of cell `o` [m]. */
INLINE float depth_on(const graph *g, int64_t i, int64_t o) {
    const float *n = g->cells[i].n, *p = g->cells[i].p;
    return (n[0] * p[0] + n[1] * p[1] + n[2] * p[2]) / (n[0] * g->u[o] + n[1] * g->v[o] + n[2]);
}

/* The first cell beyond a nearer part that hides the surface of cell `i`, whose normal is that of cell `a`, on a line of `most` cells;
 * -1 if there is none. */
INLINE int64_t beyond(const graph *g, int64_t i, const cell *a, int64_t to, int64_t most) {
    int hidden = 0, open = 0; /* cells */
    for (int64_t t = 1; t < most; t++) {
        const int64_t at = i + t * to;
        const cell *o = g->cells + at;
        const float od = g->d[at];
        if (od != od) {
            continue;
        }
        const float d = (a->n[0] * g->u[at] + a->n[1] * g->v[at] + a->n[2]) / (a->n[0] * a->p[0] + a->n[1] * a->p[1] + a->n[2] * a->p[2]);
        if (o->part == g->cells[i].part) {
            return -1;
        }
        if (o->label && od > d + (float)g->s[STEP_M] * d * d) {
            hidden++;
        } else if (o->label && hidden) {
            return at;
        } else if (++open > 2) { /* nothing hides the surface */
            return -1;
        }
    }
    return -1;
}

/* Lines of cells from a fragment to another one behind a nearer one, and those on which their surfaces agree. */
INLINE void look_behind(graph *g) {
    for (int64_t y = 0, i = 0; y < g->h; y++) {
        for (int64_t x = 0; x < g->w; x++, i++) {
            for (int dir = 0; dir < 2 && g->cells[i].label; dir++) {
                const int64_t to = dir ? g->w : 1, most = dir ? g->h - y : g->w - x;
                if (most < 2 || g->cells[i + to].part == g->cells[i].part) {
                    continue;
                }
                const int64_t own = walk(g, i, 2 * dir);
                const cell *a = g->cells + own;
                const int64_t other = a->part == g->cells[i].part && a->n[0] == a->n[0] ? beyond(g, i, a, to, most) : -1;
                if (other < 0) {
                    continue;
                }
                const int64_t far = walk(g, other, 2 * dir + 1);
                const cell *b = g->cells + far;
                float chord = 0.0f, apart = 0.0f;
                for (int k = 0; k < 3; k++) {
                    chord += (a->n[k] - b->n[k]) * (a->n[k] - b->n[k]), apart += (a->p[k] - b->p[k]) * (a->p[k] - b->p[k]);
                }
                const float limit = (float)g->s[STEP_M] + SKEW * sqrtf(apart);
                border *of = border_of(g, g->cells[i].part, g->cells[other].part);
                of->sum[AGREE] += chord < TURN * TURN && fabsf(depth_on(g, own, far) - b->p[2]) < limit && fabsf(depth_on(g, far, own) - a->p[2]) < limit;
                of->sum[LINES] += 1.0;
            }
        }
    }
}

/* The shape of cells by their sums. The axis: the lines along normals that meet it are a linear complex, fitted as by Pottmann and
 * Randrup (Computing 60, 1998): the motion with rotation u and velocity v of the middle q in which the cells move least in the
 * direction of their normals, sum (n v + u (p x n))^2. */
INLINE void derive(const double *s, shape *is) {
    const double seen = s[SEEN] > 0.0 ? s[SEEN] : 1.0, length = sqrt(dot(s + N, s + N));
    double spread[6], values[3], q[3], v[3] = {0.0}, nn[6], nm[9], mm[6], turn[9], move[9];
    for (int k = 0; k < 3; k++) {
        is->c[k] = s[P + k] / s[CELLS], is->n[k] = length > 0.0 ? s[N + k] / length : 0.0, q[k] = s[Q + k] / seen;
    }
    for (int k = 0; k < 9; k++) {
        spread[AT[k]] = s[PP + AT[k]] / s[CELLS] - is->c[k / 3] * is->c[k % 3];
    }
    eigen3(spread, values, v);
    is->slim = sqrt(fabs(values[1] / (values[2] + 1e-9))), is->full = s[AREA] / (12.0 * sqrt(fabs(values[1] * values[2]) + 1e-12));
    is->thin = sqrt(values[0] > 0.0 ? values[0] : 0.0), is->flat = length / seen, is->out = (s[PN] - dot(s + N, q)) / seen;
    const double shift[9] = {0.0, -q[2], q[1], q[2], 0.0, -q[0], -q[1], q[0], 0.0}; /* q x n: from the origin to the middle */
    for (int k = 0; k < 9; k++) {
        const double *row = shift + k / 3 * 3, *column = s + NN;
        turn[k] = row[0] * column[AT[k % 3]] + row[1] * column[AT[3 + k % 3]] + row[2] * column[AT[6 + k % 3]];
        nn[AT[k]] = column[AT[k]] + (k % 4 ? 0.0 : EVEN * seen + 1e-9); /* a cylinder may move along its axis */
    }
    for (int k = 0; k < 9; k++) {
        const int a = k / 3, b = k % 3;
        nm[k] = s[NM + k] - turn[3 * b + a];
        mm[AT[k]] = s[MM + AT[k]];
        for (int x = 0; x < 3; x++) {
            mm[AT[k]] += turn[3 * a + x] * shift[3 * b + x] - shift[3 * a + x] * s[NM + 3 * x + b] - shift[3 * b + x] * s[NM + 3 * x + a];
        }
    }
    const double minors[6] = {nn[3] * nn[5] - nn[4] * nn[4], nn[2] * nn[4] - nn[1] * nn[5], nn[1] * nn[4] - nn[2] * nn[3],
                              nn[0] * nn[5] - nn[2] * nn[2], nn[1] * nn[2] - nn[0] * nn[4], nn[0] * nn[3] - nn[1] * nn[1]};
    const double det = nn[0] * minors[0] + nn[1] * minors[1] + nn[2] * minors[2];
    for (int k = 0; k < 9; k++) {
        const int *at = AT + k / 3 * 3, y = k % 3;
        move[k] = (minors[at[0]] * nm[y] + minors[at[1]] * nm[3 + y] + minors[at[2]] * nm[6 + y]) / det;
    }
    for (int k = 0; k < 9; k++) {
        const int a = k / 3, b = k % 3;
        mm[AT[k]] -= b < a ? 0.0 : nm[a] * move[b] + nm[3 + a] * move[3 + b] + nm[6 + a] * move[6 + b];
    }
    eigen3(mm, values, is->u);
    for (int k = 0; k < 3; k++) {
        v[k] = -dot(move + 3 * k, is->u);
    }
    cross(is->u, v, is->axis);
    is->miss = sqrt(values[0] > 0.0 ? values[0] / seen : 0.0), is->next = sqrt(values[1] > 0.0 ? values[1] / seen : 0.0), is->side = 1.0;
    for (int k = 0; k < 9; k++) {
        is->side -= is->u[k / 3] * is->u[k % 3] * s[NN + AT[k]] / seen;
        is->axis[k % 3] += k < 3 ? q[k] : 0.0;
    }
}

/* Features of two fragments, from which the trees predict whether they are one object: of their border, of the smaller and the
 * larger one, and of both together [m, share]. */
INLINE void describe(const graph *g, const border *of, double *x) {
    const int swap = g->fragments[of->of[0]].sum[AREA] < g->fragments[of->of[1]].sum[AREA];
    const fragment *large = g->fragments + of->of[swap], *small = g->fragments + of->of[!swap], *both[2] = {small, large};
    const double *b = of->sum, *t = g->s + PLANE, sign = swap ? 1.0 : -1.0, length = b[LENGTH] > 0.0 ? b[LENGTH] : 1.0;
    const double firm = b[LENGTH] > b[STEPS] ? b[LENGTH] - b[STEPS] : 1.0, side = sqrt(small->sum[AREA] / small->sum[CELLS]);
    double sum[SUMS], turn[3], away[3], beside[3];
    double apart[3], at[3]; /* `apart` leads from the middle of the larger fragment to the middle of the smaller one, `at` to the middle of the border */
    shape all;
    for (int k = 0; k < SUMS; k++) {
        sum[k] = small->sum[k] + large->sum[k];
    }
    derive(sum, &all);
    for (int k = 0; k < 3; k++) {
        apart[k] = small->is.c[k] - large->is.c[k], turn[k] = small->is.n[k] - large->is.n[k], away[k] = small->is.c[k] - large->is.axis[k];
        at[k] = b[LENGTH] > 0.0 ? b[MIDDLE + k] / length - large->is.c[k] : 0.0;
    }
    cross(away, large->is.u, beside);
    const double far = dot(apart, apart) + 1e-9, high = b[LENGTH] > 0.0 ? dot(t, at) + dot(t, large->is.c) + dot(t, g->origin) + t[3] : 0.0;
    const double top = fmin(small->top, large->top), bottom = fmax(small->bottom, large->bottom), seen = sum[SEEN] > 0.0 ? sum[SEEN] : 1.0;
    *x++ = b[BENT] / length, *x++ = b[STEPS] / length, *x++ = b[CONVEX] / length, *x++ = b[SIGNED] / firm;
    *x++ = sign * b[BEFORE] / length, *x++ = sign * b[STEPPED] / (b[STEPS] > 0.0 ? b[STEPS] : 1.0);
    *x++ = b[LINES] > 0.0 ? b[AGREE] / b[LINES] : -1.0, *x++ = b[AGREE] / sqrt(small->sum[CELLS]);
    for (int k = 0; k < 2; k++) {
        const fragment *f = both[k];
        *x++ = b[LENGTH] * side / sqrt(f->sum[AREA]), *x++ = b[LENGTH] / f->sum[OUTLINE];
        *x++ = f->is.flat, *x++ = f->is.thin, *x++ = f->is.side, *x++ = f->is.out / sqrt(f->sum[AREA]);
        *x++ = fabs(dot(f->is.n, apart)), *x++ = f->sum[HOLLOWS] / (f->sum[SEEN] > 0.0 ? f->sum[SEEN] : 1.0);
        *x++ = sqrt(f->sum[CELLS]), *x++ = f->bottom, *x++ = f->top, *x++ = f->sum[TOUCH] / f->sum[OUTLINE], *x++ = f->is.slim;
    }
    *x++ = sqrt(small->sum[AREA] / large->sum[AREA]), *x++ = sqrt(dot(turn, turn)), *x++ = dot(large->is.n, apart), *x++ = dot(small->is.n, apart);
    *x++ = dot(t, apart), *x++ = small->top - large->top, *x++ = small->bottom - large->bottom;
    *x++ = large->is.miss, *x++ = fabs(dot(large->is.u, t)), *x++ = sqrt(dot(beside, beside));
    *x++ = all.miss, *x++ = all.next, *x++ = fabs(dot(all.u, t)), *x++ = all.thin, *x++ = all.full, *x++ = small->is.miss;
    *x++ = b[SHARP] / length, *x++ = sqrt(fabs(b[UNEVEN] / length - b[SIGNED] / length * b[SIGNED] / length));
    *x++ = all.miss - sqrt((small->is.miss * small->is.miss * small->sum[SEEN] + large->is.miss * large->is.miss * large->sum[SEEN]) / seen);
    *x++ = all.thin - sqrt((small->is.thin * small->is.thin * small->sum[CELLS] + large->is.thin * large->is.thin * large->sum[CELLS]) / sum[CELLS]);
    *x++ = top - high, *x++ = high - bottom, *x++ = high / fmax(top, 0.005), *x++ = dot(small->is.n, at) - dot(small->is.n, apart), *x++ = dot(large->is.n, at);
    *x++ = (dot(all.n, at) - dot(at, apart) / far * dot(all.n, apart)) / sqrt(far), *x++ = all.out / sqrt(sum[AREA]);
    *x++ = (all.out - (small->is.out * small->sum[SEEN] + large->is.out * large->sum[SEEN]) / seen) / sqrt(sum[AREA]);
    *x++ = side, *x++ = g->s[NOISE] * side / (g->s[PITCH] * g->s[PITCH]); /* of a cell, and deviation of its depth by its side */
}

/* JOINING. Rates a border by trees: log odds that its fragments are one object. With room for it, the row is kept for learning, after the
 * pixels in the middle of both fragments. */
INLINE void rate(graph *g, border *of) {
    double x[FEATURES + 2] = {0.0};
    float row[FEATURES]; /* as the trees have learned from */
    const int64_t inner = ((int64_t)1 << g->trees->depth) - 1;
    for (int k = 0; k < 2; k++) {
        fragment *f = g->fragments + of->of[k];
        x[k] = (double)((f->seed / g->w * g->k + g->k / 2) * g->w * g->k + f->seed % g->w * g->k + g->k / 2);
        if (!f->known) {
            derive(f->sum, &f->is);
            f->known = 1;
        }
    }
    describe(g, of, x + 2);
    of->score = of->sum[LENGTH] > 0.0 && of->sum[BENT] < of->sum[LENGTH] * g->s[BEND] ? SMOOTH : 0.0;
    for (int k = 0; k < FEATURES; k++) {
        row[k] = (float)x[2 + k];
    }
    for (int64_t first = 0; first < g->trees->count; first += AT_ONCE) {
        const int64_t some = g->trees->count - first < AT_ONCE ? g->trees->count - first : AT_ONCE;
        int64_t at[AT_ONCE] = {0};
        for (int64_t level = 0; level < g->trees->depth; level++) {
            for (int64_t k = 0; k < some; k++) {
                const int64_t node = (first + k) * inner + at[k];
                at[k] = 2 * at[k] + 1 + (row[g->trees->features[node]] > g->trees->thresholds[node]);
            }
        }
        for (int64_t k = 0; k < some; k++) {
            of->score += g->trees->leaves[(first + k) * (inner + 1) + at[k] - inner];
        }
    }
    if (g->counts[RATED] < g->trees->room) {
        memcpy(g->trees->rows + g->counts[RATED] * (FEATURES + 2), x, sizeof x);
    }
    g->counts[RATED]++;
}

INLINE void set_key(graph *g, int64_t k, double key) {
    double *peak = g->peaks + k / SOME, *first = g->keys + k / SOME * SOME;
    const int was = g->keys[k] == *peak;
    g->keys[k] = key;
    *peak = key > *peak ? key : *peak;
    if (was && key < *peak) {
        *peak = -INFINITY;
        for (int i = 0; i < SOME; i++) {
            *peak = first[i] > *peak ? first[i] : *peak;
        }
    }
}

/* Adds border `from` to another one, `turned` if their first fragments differ, and drops it. */
INLINE void add_border(graph *g, border *to, border *from, int turned) {
    from->sum[BEFORE] = turned ? -from->sum[BEFORE] : from->sum[BEFORE], from->sum[STEPPED] = turned ? -from->sum[STEPPED] : from->sum[STEPPED];
    for (int j = 0; j < EDGES; j++) {
        to->sum[j] += from->sum[j];
    }
    from->of[0] = from->of[1] = 0;
    set_key(g, from - g->borders, -INFINITY);
}

/* Joins fragment b to a, which is rated by log odds: their sums, and their borders with others. */
INLINE void join_pair(graph *g, int32_t a, int32_t b, double score) {
    fragment *to = g->fragments + a, *from = g->fragments + b;
    to->accepted = fmin(score, fmin(to->accepted, from->accepted));
    to->known = 0, to->seed = from->sum[CELLS] > to->sum[CELLS] ? from->seed : to->seed;
    to->top = to->top > from->top ? to->top : from->top, to->bottom = to->bottom < from->bottom ? to->bottom : from->bottom;
    from->to = a;
    for (int k = 0; k < SUMS; k++) {
        to->sum[k] += from->sum[k];
    }
    int32_t *last = &to->first; /* borders that are gone leave the list of a */
    for (int32_t at; (at = *last) >= 0;) {
        border *of = g->borders + at / 2;
        if (of->of[0] && of->of[!(at & 1)] != b) {
            g->met[of->of[!(at & 1)]] = at;
            last = &of->next[at & 1];
        } else {
            *last = of->next[at & 1];
        }
    }
    for (int32_t at = from->first, next; at >= 0; at = next) {
        border *of = g->borders + at / 2;
        const int side = at & 1;
        const int32_t other = of->of[!side];
        next = of->next[side];
        if (!of->of[0]) {
            continue;
        }
        if (other == a) {
            to->sum[OUTLINE] -= 2.0 * of->sum[LENGTH], to->sum[TOUCH] -= 2.0 * of->sum[LENGTH];
            of->of[0] = of->of[1] = 0;
            set_key(g, at / 2, -INFINITY);
        } else if (g->met[other] >= 0) {
            add_border(g, g->borders + g->met[other] / 2, of, (g->met[other] & 1) != side);
        } else {
            of->of[side] = a, of->next[side] = to->first, to->first = at;
        }
    }
    for (int32_t at = to->first; at >= 0; at = g->borders[at / 2].next[at & 1]) {
        g->met[g->borders[at / 2].of[!(at & 1)]] = -1;
    }
}

/* How soon a pass joins the fragments of a border, -INFINITY for never: tiny ones across the border that bends least, across a step only
 * where nothing else is beside them; the pair that is rated highest, while that is as one object; at last the small parts. */
INLINE double key_of(graph *g, border *of, int pass) {
    const double *a = g->fragments[of->of[0]].sum, *b = g->fragments[of->of[1]].sum;
    const int tiny = a[CELLS] < TINY || b[CELLS] < TINY, small = a[AREA] < g->s[PART_M2] || b[AREA] < g->s[PART_M2];
    if (pass == TINY_ONES) {
        return of->sum[LENGTH] > 0.0 && tiny ? -(of->sum[BENT] + of->sum[STEPS]) / of->sum[LENGTH] : -INFINITY;
    }
    return pass == RATED_ONES ? (of->score > g->s[SAME] ? of->score : -INFINITY) : (of->sum[LENGTH] > 0.0 && small ? of->score : -INFINITY);
}

INLINE void join_all(graph *g) {
    memset(g->met, -1, ((size_t)g->n_fragments + 1) * sizeof(int32_t));
    for (int64_t k = 0; k < g->n_borders + SOME; k++) {
        g->keys[k] = g->peaks[k / SOME] = -INFINITY;
    }
    for (int pass = TINY_ONES; pass <= SMALL_ONES; pass++) {
        for (int64_t k = 0; k < g->n_borders; k++) {
            border *of = g->borders + k;
            if (of->of[0] && pass == RATED_ONES) {
                rate(g, of);
            }
            set_key(g, k, of->of[0] ? key_of(g, of, pass) : -INFINITY);
        }
        for (;;) {
            int64_t block = 0, best;
            for (int64_t k = 1; k * SOME < g->n_borders; k++) {
                block = g->peaks[k] > g->peaks[block] ? k : block;
            }
            if (g->peaks[block] == -INFINITY) {
                break;
            }
            for (best = block * SOME; g->keys[best] < g->peaks[block]; best++) {
            }
            const border *of = g->borders + best;
            const int32_t a = of->of[0], b = of->of[1];
            g->counts[pass != RATED_ONES ? BY_SIZE : of->sum[LENGTH] > 0.0 ? BY_BORDER : BY_VIEW]++;
            join_pair(g, a, b, pass == TINY_ONES ? INFINITY : of->score);
            for (int32_t at = g->fragments[a].first; at >= 0; at = g->borders[at / 2].next[at & 1]) {
                if (pass != TINY_ONES) {
                    rate(g, g->borders + at / 2);
                }
                set_key(g, at / 2, key_of(g, g->borders + at / 2, pass));
            }
        }
    }
    for (int64_t i = 1; i <= g->n_fragments; i++) { /* each joined one that has joined another one */
        int32_t to = g->fragments[i].to;
        while (g->fragments[to].to != to) {
            to = g->fragments[to].to;
        }
        g->fragments[i].to = to;
    }
    for (int64_t i = 0; i < g->n; i++) {
        g->cells[i].part = g->fragments[g->cells[i].part].to;
    }
}

/* PARTS. In `inside`, the part of cells all of whose neighbours that are of a cluster are of it, else 0. */
INLINE void find_sole_parts(graph *g) {
    for (int64_t i = 0; i < g->n; i++) {
        g->inside[i] = g->cells[i].part;
    }
    for (int64_t y = 0, i = 0; y < g->h; y++) {
        for (int64_t x = 0; x < g->w; x++, i++) {
            const int64_t others[4] = {x + 1 < g->w ? i + 1 : i, y + 1 < g->h ? i + g->w : i, x > 0 && y + 1 < g->h ? i + g->w - 1 : i, x + 1 < g->w && y + 1 < g->h ? i + g->w + 1 : i};
            for (int k = 0; k < 4 && g->cells[i].part; k++) {
                const int32_t other = g->cells[others[k]].part;
                if (other && other != g->cells[i].part) {
                    g->inside[i] = g->inside[others[k]] = 0;
                }
            }
        }
    }
}

/* The part of the cell of a pixel's cluster that is nearest: in cells, and in depth by LIKE. */
INLINE int32_t nearest_part(const graph *g, int64_t y, int64_t x, int32_t label) {
    const float z = g->first[3 * (y * g->of->across + x) + 2];
    float best = INFINITY;
    int32_t part = 0;
    for (int64_t near = 0; near < 9; near++) {
        const int64_t i = y / g->k + near / 3 - 1, j = x / g->k + near % 3 - 1;
        const cell *c = g->cells + i * g->w + j;
        if (i < 0 || j < 0 || i >= g->h || j >= g->w || c->label != label) {
            continue;
        }
        const float dy = ((float)y + 0.5f) / (float)g->k - (float)i - 0.5f, dx = ((float)x + 0.5f) / (float)g->k - (float)j - 0.5f;
        const float dz = (z - c->p[2]) / LIKE, apart = dx * dx + dy * dy + dz * dz;
        if (apart < best) {
            best = apart, part = c->part;
        }
    }
    return part;
}

/* Writes the parts of pixels over the labels of their clusters, numbered from 1, and which clusters have solid pixels; the number of parts. */
INLINE int64_t write_parts(graph *g, uint8_t *clusters) {
    const Labelled *v = g->of;
    int32_t *names = g->root, count = 0;
    memset(names, 0, (size_t)g->n * sizeof(int32_t));
    find_sole_parts(g);
    for (int64_t y = 0; y < v->h; y++) {
        int32_t *labels = v->labels + y * v->w;
        for (int64_t x = 0, at = y / g->k * g->w - 1, next = 0; x < v->w; x++) {
            const int32_t label = labels[x];
            if (x == next) { /* the next cell */
                at++, next += g->k;
            }
            if (label) {
                const int32_t part = g->inside[at] && label == g->cells[at].label ? g->inside[at] : nearest_part(g, y, x, label);
                if (part && !names[part - 1]) {
                    names[part - 1] = ++count;
                }
                labels[x] = part ? names[part - 1] : 0, clusters[label] |= v->solid[y * v->w + x];
            }
        }
    }
    return count;
}

/* Writes what tells whether each part is a whole object, in the row of its name. */
INLINE void write_joins(const graph *g, double *joins) {
    const int32_t *names = g->root;
    for (int64_t i = 1; i <= g->n_fragments; i++) {
        const fragment *f = g->fragments + i;
        double *row = joins + names[i - 1] * JOINS;
        if (f->to == i && names[i - 1]) {
            row[REFUSED] = -INFINITY, row[ACCEPTED] = f->accepted, row[CELLS_OF] = f->sum[CELLS];
        }
    }
    for (const border *of = g->borders; of < g->borders + g->n_borders; of++) {
        const int32_t first = of->of[0] ? names[of->of[0] - 1] : 0, second = of->of[0] ? names[of->of[1] - 1] : 0;
        double *a = joins + first * JOINS, *b = joins + second * JOINS;
        if (first && second) {
            a[REFUSED] = fmax(a[REFUSED], of->score), b[REFUSED] = fmax(b[REFUSED], of->score);
        }
    }
}

/* Splits the clusters of a window into parts, whose labels, from 1, replace those of the clusters.
 *
 * k: side of a cell in pixels. counts: (COUNTS), the number of parts, those that were joined for each reason, and the borders that
 * were rated; -1 in the first without memory. joins: (cells + 1, JOINS), of each part the highest log odds of a join that was
 * refused, the lowest of those that made it, both infinite without any, and its cells. clusters: (labels + 1), zeros, whether each
 * has solid pixels. */
VECTORISED void split_clusters(const Labelled *of, int64_t k, const double *settings, const Trees *trees, int64_t *counts, double *joins, uint8_t *clusters) {
    graph g = {.of = of, .first = of->xyz + 3 * (of->row * of->across + of->column), .k = k, .h = (of->h + k - 1) / k, .w = (of->w + k - 1) / k, .s = settings, .trees = trees, .counts = counts};
    const size_t n = (size_t)(g.n = g.h * g.w), most = 4 * n + SOME, beside = REACH * (size_t)(g.w + 1), padded = n + 2 * beside + 8; /* the most borders; windows reach beside the image */
    memset(counts, 0, COUNTS * sizeof(int64_t));
    g.cells = malloc((n + 1) * sizeof(cell) + (6 * n + 1 + 3 * padded) * sizeof(float) + 4 * padded);
    counts[PARTS] = -1;
    if (g.cells) {
        g.bends = (float *)(g.cells + n + 1), g.inside = (int32_t *)(g.bends + 2 * n), g.root = g.inside + n, g.next = g.root + n, g.first_of = g.next + n;
        g.u = (float *)(g.first_of + n + 1) + beside, g.v = g.u + padded, g.d = g.v + padded;
        for (int way = 0; way < 4; way++) {
            g.reach[way] = (uint8_t *)(g.d - beside + padded) + way * padded + beside;
        }
        memset(g.reach[0] - beside, 0, 4 * padded);
        g.cells[n].part = 0;
        make_cells(&g);
        find_steps(&g);
        make_normals(&g);
        make_bends(&g);
        make_fragments(&g);
        g.fragments = malloc(((size_t)g.n_fragments + 1) * (sizeof(fragment) + sizeof(int32_t)) + most * (sizeof(border) + sizeof(double)) + most / SOME * sizeof(double));
    }
    if (g.fragments) {
        g.borders = (border *)(g.fragments + g.n_fragments + 1), g.keys = (double *)(g.borders + most), g.peaks = g.keys + most;
        g.met = (int32_t *)(g.peaks + most / SOME);
        measure(&g);
        look_behind(&g);
        join_all(&g);
        counts[PARTS] = write_parts(&g, clusters);
        write_joins(&g, joins);
    }
    free(g.fragments), free(g.cells);
}

/* SPDX-License-Identifier: Apache-2.0 */
/* Objects that touch: clusters are divided into fragments, and those of one object joined again (docs/segmentation.md).
 *
 * - Cells: squares of some pixels, with their mean point. Normals are fitted over five of them, to the inverse depth: in it the image
 *   of a plane is linear, and the noise of a stereo camera is even.
 * - Edges between two cells: how much they `bend`, positive where concave, by the normals on both sides; STEP where the depth jumps.
 * - Fragments: watersheds of the distance from concave edges and steps, so that necks divide as well.
 * - Input of the trees: sums over each fragment, over the border of two, and over the lines on which one continues in the other
 *   behind a nearer one; from these the shape of a fragment, and FEATURES numbers of both and their border.
 * - Joining: tiny fragments first, then the pairs that the trees rate highest, again with what they have become, then small parts.
 * - Parts: what the fragments of cells have become, for each pixel. */
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
#define EVEN 0.02   /* share of the normals in all directions that is assumed besides those that are seen */

/* Sums over the cells of a fragment: of points p about an origin, and where there is a normal n of p, n and m = p x n. */
enum { CELLS, AREA, OUTLINE, P, PP = P + 3, SEEN = PP + 6, HOLLOWS, PN, Q, N = Q + 3, NN = N + 3, NM = NN + 6, MM = NM + 9, TOUCH = MM + 6, SUMS };
/* and over the edges of a border: `before` those where the first is nearer less the others, then lines behind a nearer part, and points. */
enum { LENGTH, BENT, STEPS, CONVEX, SIGNED, BEFORE, STEPPED, LINES, AGREE, SHARP, UNEVEN, MIDDLE, EDGES = MIDDLE + 3, FEATURES = 64 };

typedef struct {
    float p[3], d, n[3]; /* mean point [m], its inverse depth, normal towards the camera; NAN where there is none */
    int32_t label, part, inside; /* halves of a cell from the nearest edge that may separate */
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
    float *bends; /* of the edges to the right and down (n, 2); NAN where there is none */
    int32_t *root, *first_of; /* first_of: first cell of each distance from an edge; `part` of a cell is the next one */
    fragment *fragments;
    border *borders;
    double *keys;     /* of the borders: which is joined next */
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
static void make_cells(graph *g) {
    const Labelled *v = g->of;
    const int64_t k = g->k, h = v->h, w = v->w;
    for (int64_t i = 0; i < g->h; i++) {
        for (int64_t j = 0; j < g->w; j++) {
            cell *c = g->cells + i * g->w + j;
            const int64_t bottom = (i + 1) * k < h ? (i + 1) * k : h, right = (j + 1) * k < w ? (j + 1) * k : w;
            const int64_t y0 = (i * k + bottom) / 2, x0 = (j * k + right) / 2;
            int64_t at = y0 * w + x0;
            for (int64_t y = i * k; y < bottom && !v->solid[at]; y++) { /* a point at the middle, else any */
                for (int64_t x = j * k; x < right; x++) {
                    at = v->solid[y * w + x] ? y * w + x : at;
                }
            }
            const float *middle = g->first + 3 * (at / w * v->across + at % w), z = middle[2], gap = (float)g->s[STEP_M];
            float sum[4] = {0.0f};
            c->label = v->solid[at] ? v->labels[at] : 0;
            for (int64_t y = i * k; y < bottom && c->label; y++) {
                for (int64_t x = j * k; x < right; x++) {
                    const float *p = g->first + 3 * (y * v->across + x);
                    if (v->solid[y * w + x] && v->labels[y * w + x] == c->label && fabsf(p[2] - z) < gap) {
                        const float d = 1.0f / p[2];
                        sum[0] += p[0] * d, sum[1] += p[1] * d, sum[2] += d, sum[3] += 1.0f;
                    }
                }
            }
            c->part = 0;
            if (c->label) {
                c->d = sum[2] / sum[3];
                c->p[0] = sum[0] / sum[3] / c->d, c->p[1] = sum[1] / sum[3] / c->d;
            } else {
                c->d = 1.0f / z;
                c->p[0] = middle[0], c->p[1] = middle[1];
            }
            c->p[2] = 1.0f / c->d;
        }
    }
}

/* EDGES. Whether the depth jumps between two cells, by more than it changes before and after them. */
INLINE int broken(const cell *c, const cell *o, const cell *before, const cell *after, float step) {
    const float limit = step * c->d * o->d, by = o->d - c->d;
    const float slope = SLOPE * sqrtf((o->p[0] - c->p[0]) * (o->p[0] - c->p[0]) + (o->p[1] - c->p[1]) * (o->p[1] - c->p[1]));
    const float left = before && before->label == c->label ? by - (c->d - before->d) : NAN;
    const float right = after && after->label == c->label ? by - (after->d - o->d) : NAN;
    if (left != left && right != right) {
        return fabsf(by) > limit + slope * c->d * o->d;
    }
    return fabsf(by) > limit + slope / 2 * c->d * o->d && !(fabsf(left) <= limit) && !(fabsf(right) <= limit);
}

/* The step in depth across each edge, before there are normals. */
static void find_steps(graph *g) {
    for (int dir = 0; dir < 2; dir++) {
        const int64_t to = dir ? g->w : 1;
        for (int64_t i = 0; i < g->n; i++) {
            const int64_t at = dir ? i / g->w : i % g->w, length = dir ? g->h : g->w;
            const cell *c = g->cells + i;
            g->bends[2 * i + dir] = NAN;
            if (at + 1 < length && c->label && c[to].label) {
                const int jump = c[to].label != c->label || broken(c, c + to, at ? c - to : NULL, at + 2 < length ? c + 2 * to : NULL, (float)g->s[STEP_M]);
                g->bends[2 * i + dir] = jump ? STEP : 0.0f;
            }
        }
    }
}

/* The cell up to `most` cells along a line without a step: dir 0 right, 1 down; sign -1 backwards. */
INLINE int64_t walk(const graph *g, int64_t i, int dir, int sign, int most) {
    const int64_t to = dir ? g->w : 1, length = dir ? g->h : g->w;
    int64_t at = dir ? i / g->w : i % g->w;
    for (int t = 0; t < most && at + sign >= 0 && at + sign < length; t++, at += sign, i += sign * to) {
        const float edge = g->bends[2 * (sign > 0 ? i : i - to) + dir];
        if (edge != edge || edge == STEP) {
            break;
        }
    }
    return i;
}

/* A plane through the inverse depth of the cells around each, without a step between. */
static void make_normals(graph *g) {
    for (int64_t i = 0; i < g->n; i++) {
        cell *c = g->cells + i;
        c->n[0] = c->n[1] = c->n[2] = NAN;
        if (!c->label) {
            continue;
        }
        const float u0 = c->p[0] * c->d, v0 = c->p[1] * c->d;
        float m[9] = {0.0f};
        const int64_t top = walk(g, i, 1, -1, REACH), end = walk(g, i, 1, 1, REACH);
        for (int64_t middle = top; middle <= end; middle += g->w) {
            const int64_t last = walk(g, middle, 0, 1, REACH);
            for (int64_t b = walk(g, middle, 0, -1, REACH); b <= last; b++) {
                const cell *o = g->cells + b;
                const float u = o->p[0] * o->d - u0, v = o->p[1] * o->d - v0, d = o->d - c->d;
                m[0] += 1.0f, m[1] += u, m[2] += v, m[3] += d;
                m[4] += u * u, m[5] += u * v, m[6] += v * v, m[7] += u * d, m[8] += v * d;
            }
        }
        const float uu = m[4] - m[1] * m[1] / m[0], uv = m[5] - m[1] * m[2] / m[0], vv = m[6] - m[2] * m[2] / m[0];
        const float ud = m[7] - m[1] * m[3] / m[0], vd = m[8] - m[2] * m[3] / m[0], det = uu * vv - uv * uv;
        if (m[0] >= 5.0f && det > 1e-3f * uu * vv) { /* a x + b y + e z = 1 */
            const float a = (ud * vv - vd * uv) / det, b = (vd * uu - ud * uv) / det;
            const float e = c->d + (m[3] - a * m[1] - b * m[2]) / m[0] - a * u0 - b * v0, size = sqrtf(a * a + b * b + e * e);
            c->n[0] = -a / size, c->n[1] = -b / size, c->n[2] = -e / size;
        }
    }
}

/* In place: a bend is never as large as a step, as all normals face the camera. */
static void make_bends(graph *g) {
    for (int64_t k = 0; k < 2 * g->n; k++) {
        const int dir = k & 1;
        if (g->bends[k] == 0.0f) {
            const cell *a = g->cells + walk(g, k / 2, dir, -1, REACH);
            const cell *b = g->cells + walk(g, k / 2 + (dir ? g->w : 1), dir, 1, REACH);
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
static int32_t find_depths(graph *g) {
    int32_t most = 0;
    for (int64_t i = 0; i < g->n; i++) {
        g->cells[i].inside = g->cells[i].n[0] == g->cells[i].n[0] ? INT32_MAX / 2 : 0;
    }
    for (int64_t k = 0; k < 2 * g->n; k++) {
        if (!(g->bends[k] <= (float)g->s[BEND])) {
            const int64_t i = k / 2, o = i + (k & 1 ? g->w : 1);
            g->cells[i].inside = g->cells[i].inside ? 1 : 0;
            if (o < g->n) {
                g->cells[o].inside = g->cells[o].inside ? 1 : 0;
            }
        }
    }
    for (int64_t t = 0; t < 2 * g->n; t++) { /* from the first cell to the last, and back */
        const int64_t to = t < g->n ? -1 : 1, i = t < g->n ? t : 2 * g->n - 1 - t, x = i % g->w, row = i + to * g->w;
        const int above = row >= 0 && row < g->n, before = to < 0 ? x > 0 : x + 1 < g->w, after = to < 0 ? x + 1 < g->w : x > 0;
        const int32_t ways[4] = {before ? g->cells[i + to].inside + 2 : 1, above ? g->cells[row].inside + 2 : 1,
                                 above && before ? g->cells[row + to].inside + 3 : 1, above && after ? g->cells[row - to].inside + 3 : 1};
        for (int way = 0; way < 4; way++) {
            g->cells[i].inside = ways[way] < g->cells[i].inside ? ways[way] : g->cells[i].inside;
        }
        most = t >= g->n && g->cells[i].inside > most ? g->cells[i].inside : most;
    }
    return most;
}

/* Fragments: watersheds of that distance, as a neck between concave edges separates two fragments as well as an edge all
 * along. Cells are added from the innermost on; two fragments that meet are one unless the neck is narrower than both. */
static void make_fragments(graph *g) {
    const int32_t innermost = find_depths(g);
    memset(g->root, -1, (size_t)g->n * sizeof(int32_t));
    memset(g->first_of, -1, ((size_t)innermost + 1) * sizeof(int32_t));
    for (int64_t i = g->n - 1; i >= 0; i--) {
        if (g->cells[i].label) {
            g->cells[i].part = g->first_of[g->cells[i].inside], g->first_of[g->cells[i].inside] = (int32_t)i;
        }
    }
    for (int32_t level = innermost; level >= 0; level--) {
        for (int64_t i = g->first_of[level]; i >= 0; i = g->cells[i].part) {
            const int64_t edges[4] = {2 * (i - 1), 2 * i, 2 * (i - g->w) + 1, 2 * i + 1}, others[4] = {i - 1, i + 1, i - g->w, i + g->w};
            int32_t own = g->root[i] = (int32_t)i;
            for (int side = 0; side < 4; side++) {
                const int64_t o = others[side];
                if (edges[side] < 0 || !(g->bends[edges[side]] <= (float)g->s[BEND]) || g->root[o] < 0) {
                    continue;
                }
                const int32_t next = root_of(g->root, (int32_t)o), a = g->cells[next].inside, b = g->cells[own].inside;
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
static border *border_of(graph *g, int32_t a, int32_t b) {
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
static void add_cell(graph *g, int64_t i) {
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
static void measure(graph *g) {
    for (int64_t i = 0; i <= g->n_fragments; i++) {
        g->fragments[i] = (fragment){.top = -INFINITY, .bottom = INFINITY, .accepted = INFINITY, .to = (int32_t)i, .first = -1};
    }
    for (int64_t i = 0, any = 0; i < g->n; i++) {
        const cell *c = g->cells + i;
        for (int k = 0; k < 3 && c->part && !any; k++) {
            g->origin[k] = c->p[k]; /* near all others, so that moments about it are exact enough */
        }
        if (c->part) {
            any = 1;
            add_cell(g, i);
        }
        for (int dir = 0; dir < 2; dir++) {
            const int last = dir ? i + g->w >= g->n : i % g->w == g->w - 1;
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

/* Depth of the plane of cell a on the ray of cell b, minus that of b [m]. */
INLINE float behind(const cell *a, const cell *b) {
    const float *n = a->n, u = b->p[0] * b->d, v = b->p[1] * b->d;
    return (n[0] * a->p[0] + n[1] * a->p[1] + n[2] * a->p[2]) / (n[0] * u + n[1] * v + n[2]) - b->p[2];
}

/* The first cell beyond a nearer part that hides the surface of cell `i` along a line of cells; -1 if there is none. */
static int64_t beyond(const graph *g, int64_t i, const cell *a, int dir) {
    const int64_t to = dir ? g->w : 1, at = dir ? i / g->w : i % g->w, length = dir ? g->h : g->w;
    int hidden = 0, open = 0; /* cells */
    for (int64_t t = 1; at + t < length; t++) {
        const cell *o = g->cells + i + t * to;
        if (o->d != o->d) {
            continue;
        }
        const float u = o->p[0] * o->d, v = o->p[1] * o->d;
        const float d = (a->n[0] * u + a->n[1] * v + a->n[2]) / (a->n[0] * a->p[0] + a->n[1] * a->p[1] + a->n[2] * a->p[2]);
        if (o->part == g->cells[i].part) {
            return -1;
        }
        if (o->label && o->d > d + (float)g->s[STEP_M] * d * d) {
            hidden++;
        } else if (o->label && hidden) {
            return i + t * to;
        } else if (++open > 2) { /* nothing hides the surface */
            return -1;
        }
    }
    return -1;
}

/* Lines of cells from a fragment to another one behind a nearer one, and those on which their surfaces agree. */
static void look_behind(graph *g) {
    for (int64_t k = 0; k < 2 * g->n; k++) {
        const int dir = k & 1;
        const int64_t i = k / 2, to = dir ? g->w : 1, at = dir ? i / g->w : i % g->w;
        if (!g->cells[i].label || at + 1 >= (dir ? g->h : g->w) || g->cells[i + to].part == g->cells[i].part) {
            continue;
        }
        const cell *a = g->cells + walk(g, i, dir, -1, REACH);
        const int64_t other = a->part == g->cells[i].part && a->n[0] == a->n[0] ? beyond(g, i, a, dir) : -1;
        if (other < 0) {
            continue;
        }
        const cell *b = g->cells + walk(g, other, dir, 1, REACH);
        float chord = 0.0f, apart = 0.0f;
        for (int x = 0; x < 3; x++) {
            chord += (a->n[x] - b->n[x]) * (a->n[x] - b->n[x]), apart += (a->p[x] - b->p[x]) * (a->p[x] - b->p[x]);
        }
        const float limit = (float)g->s[STEP_M] + SKEW * sqrtf(apart);
        border *of = border_of(g, g->cells[i].part, g->cells[other].part);
        of->sum[AGREE] += chord < TURN * TURN && fabsf(behind(a, b)) < limit && fabsf(behind(b, a)) < limit;
        of->sum[LINES] += 1.0;
    }
}

/* The shape of cells by their sums. The axis: the lines along normals that meet it are a linear complex, fitted as by Pottmann and
 * Randrup (Computing 60, 1998): the motion with rotation u and velocity v of the middle q in which the cells move least in the
 * direction of their normals, sum (n v + u (p x n))^2. */
static void derive(const double *s, shape *is) {
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
static void describe(const graph *g, const border *of, double *x) {
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
static void rate(graph *g, border *of) {
    double x[FEATURES + 2] = {0.0};
    const int64_t inner = ((int64_t)1 << g->trees->depth) - 1, size = 3 * inner + 1;
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
    for (const float *tree = g->trees->nodes; tree < g->trees->nodes + g->trees->count * size; tree += size) {
        int64_t at = 0;
        while (at < inner) {
            at = 2 * at + 1 + (x[2 + (int)tree[2 * at]] > tree[2 * at + 1]);
        }
        of->score += tree[inner + at];
    }
    if (g->counts[RATED] < g->trees->room) {
        memcpy(g->trees->rows + g->counts[RATED] * (FEATURES + 2), x, sizeof x);
    }
    g->counts[RATED]++;
}

/* Adds border `from` to another one, `turned` if their first fragments differ, and drops it. */
static void add_border(graph *g, border *to, border *from, int turned) {
    from->sum[BEFORE] = turned ? -from->sum[BEFORE] : from->sum[BEFORE], from->sum[STEPPED] = turned ? -from->sum[STEPPED] : from->sum[STEPPED];
    for (int j = 0; j < EDGES; j++) {
        to->sum[j] += from->sum[j];
    }
    from->of[0] = from->of[1] = 0;
    g->keys[from - g->borders] = -INFINITY;
}

/* Joins fragment b to a, which is rated by log odds: their sums, and their borders with others. */
static void join_pair(graph *g, int32_t a, int32_t b, double score) {
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
            of->of[0] = of->of[1] = 0, g->keys[at / 2] = -INFINITY;
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
static double key_of(graph *g, border *of, int pass) {
    const double *a = g->fragments[of->of[0]].sum, *b = g->fragments[of->of[1]].sum;
    const int tiny = a[CELLS] < TINY || b[CELLS] < TINY, small = a[AREA] < g->s[PART_M2] || b[AREA] < g->s[PART_M2];
    if (pass == TINY_ONES) {
        return of->sum[LENGTH] > 0.0 && tiny ? -(of->sum[BENT] + of->sum[STEPS]) / of->sum[LENGTH] : -INFINITY;
    }
    return pass == RATED_ONES ? (of->score > g->s[SAME] ? of->score : -INFINITY) : (of->sum[LENGTH] > 0.0 && small ? of->score : -INFINITY);
}

static void join_all(graph *g) {
    memset(g->met, -1, ((size_t)g->n_fragments + 1) * sizeof(int32_t));
    for (int pass = TINY_ONES; pass <= SMALL_ONES; pass++) {
        for (int64_t k = 0; k < g->n_borders; k++) {
            border *of = g->borders + k;
            if (of->of[0] && pass == RATED_ONES) {
                rate(g, of);
            }
            g->keys[k] = of->of[0] ? key_of(g, of, pass) : -INFINITY;
        }
        for (;;) {
            int64_t best = -1;
            double most = -INFINITY;
            for (int64_t k = 0; k < g->n_borders; k++) {
                if (g->keys[k] > most) {
                    most = g->keys[k], best = k;
                }
            }
            if (best < 0) {
                break;
            }
            const border *of = g->borders + best;
            const int32_t a = of->of[0], b = of->of[1];
            g->counts[pass != RATED_ONES ? BY_SIZE : of->sum[LENGTH] > 0.0 ? BY_BORDER : BY_VIEW]++;
            join_pair(g, a, b, pass == TINY_ONES ? INFINITY : of->score);
            for (int32_t at = g->fragments[a].first; at >= 0; at = g->borders[at / 2].next[at & 1]) {
                if (pass != TINY_ONES) {
                    rate(g, g->borders + at / 2);
                }
                g->keys[at / 2] = key_of(g, g->borders + at / 2, pass);
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

/* PARTS. The part of cells all of whose neighbours that are of a cluster are of it, else 0. */
static void find_sole_parts(graph *g) {
    for (int64_t i = 0; i < g->h; i++) {
        for (int64_t j = 0; j < g->w; j++) {
            cell *c = g->cells + i * g->w + j;
            c->inside = c->part;
            for (int64_t y = i ? i - 1 : 0; c->part && y <= i + 1 && y < g->h; y++) {
                for (int64_t x = j ? j - 1 : 0; x <= j + 1 && x < g->w; x++) {
                    const int32_t part = g->cells[y * g->w + x].part;
                    c->inside = part && part != c->part ? 0 : c->inside;
                }
            }
        }
    }
}

/* The part of the cell of a pixel's cluster that is nearest: in cells, and in depth by LIKE. */
static int32_t nearest_part(const graph *g, int64_t y, int64_t x, float z, int32_t label) {
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

/* Writes the parts of pixels over the labels of their clusters, numbered from 1; their number. */
static int64_t write_parts(graph *g) {
    const Labelled *v = g->of;
    int32_t *names = g->root, count = 0;
    memset(names, 0, (size_t)g->n * sizeof(int32_t));
    find_sole_parts(g);
    for (int64_t y = 0; y < v->h; y++) {
        for (int64_t j = 0; j < g->w; j++) {
            const cell *c = g->cells + y / g->k * g->w + j;
            for (int64_t x = j * g->k; x < (j + 1) * g->k && x < v->w; x++) {
                const int32_t label = v->labels[y * v->w + x];
                if (label) {
                    const float z = g->first[3 * (y * v->across + x) + 2];
                    const int32_t part = c->inside && label == c->label ? c->inside : nearest_part(g, y, x, z, label);
                    if (part && !names[part - 1]) {
                        names[part - 1] = ++count;
                    }
                    v->labels[y * v->w + x] = part ? names[part - 1] : 0;
                }
            }
        }
    }
    return count;
}

/* Writes what tells whether each part is a whole object, in the row of its name. */
static void write_joins(const graph *g, double *joins) {
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
 * refused, the lowest of those that made it, both infinite without any, and its cells. */
VECTORISED void split_clusters(const Labelled *of, int64_t k, const double *settings, const Trees *trees, int64_t *counts, double *joins) {
    graph g = {.of = of, .first = of->xyz + 3 * (of->row * of->across + of->column), .k = k, .h = (of->h + k - 1) / k, .w = (of->w + k - 1) / k, .s = settings, .trees = trees, .counts = counts};
    const size_t n = (size_t)(g.n = g.h * g.w);
    memset(counts, 0, COUNTS * sizeof(int64_t));
    g.cells = calloc(1, (n + 1) * (sizeof(cell) + 2 * sizeof(int32_t)) + 2 * n * sizeof(float));
    g.root = (int32_t *)(g.cells + n + 1), g.first_of = g.root + n + 1, g.bends = (float *)(g.first_of + n + 1);
    if (g.cells) {
        make_cells(&g);
        find_steps(&g);
        make_normals(&g);
        make_bends(&g);
        make_fragments(&g);
        g.fragments = malloc(((size_t)g.n_fragments + 1) * (sizeof(fragment) + sizeof(double)) + (4 * n + 1) * (sizeof(border) + sizeof(double)));
    }
    counts[PARTS] = -1;
    if (g.fragments) {
        g.borders = (border *)(g.fragments + g.n_fragments + 1), g.keys = (double *)(g.borders + 4 * n + 1), g.met = (int32_t *)(g.keys + 4 * n + 1);
        measure(&g);
        look_behind(&g);
        join_all(&g);
        counts[PARTS] = write_parts(&g);
        write_joins(&g, joins);
    }
    free(g.fragments), free(g.cells);
}

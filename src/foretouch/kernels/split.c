/* SPDX-License-Identifier: Apache-2.0 */
/* Parts of clusters, by local convexity: two convex objects that touch meet in a concave edge or at a step in depth.
 *
 * A window is divided into square cells of a few millimetres. A surface is fitted to the inverse depth of each cell and its
 * neighbours: the image of a plane is linear in it, and the noise of a stereo camera has the same size everywhere. Across each
 * edge between two cells the normals some cells away from it are compared: `bend`, positive where concave, STEP where the
 * depth jumps. Fragments are the watersheds of the distance from such edges; a border between two of them then has a mean bend
 * along its whole length, and the fragments whose border bends least are joined first. */
#include "eigen.h"

enum { BEND, STEP_M, PART_M2, PLANE, PITCH = PLANE + 4, SETTINGS }; /* of `settings` */
enum { PARTS, BY_SIZE, BY_HOLLOW, BY_VIEW, BY_AXIS, COUNTS };                      /* of `counts` */

#define STEP 2.0f   /* bend of a step in depth: chord of opposite normals */
#define FULL 0.7f   /* a sharper bend counts as much as this one, of 40 degrees, and a convex one as none */
#define REACH 2     /* cells from an edge to the normals that are compared, and from a normal to the edge of its window */
#define EDGE 0.75f /* of the angle that separates two objects: a sharper edge may separate two fragments */
#define NECK 2     /* halves of a cell by which a neck is narrower than both fragments that it separates, on each side */
#define SLOPE 4.0f  /* depth per lateral distance of cells that have no further neighbours */
#define TURN 0.25f /* chord of the normals of one surface on both sides of a nearer part */
#define SKEW 0.05f /* and how far it may be off for each metre between them */
#define LINES 4    /* of cells on which they agree, at least */
#define TOUCH 0.03 /* height between a hollow part and its rim [m] */
#define LIKE 0.005f /* a difference in depth that counts as much as a cell [m] */
#define HOLLOW 0.1f /* bend of a surface that is hollow, 6 degrees over 2 * REACH + 1 cells */
#define EVEN 0.02  /* share of the normals in all directions that is assumed besides those that are seen */
#define ECCENTRIC 0.006 /* distance of normals from the common axis of two parts, root mean square [m] */
#define SIDE 0.3   /* mean of the squared sine between normals and the axis, at least */
#define FLAT 0.9   /* squared length of the mean of normals across the axis: 1 for a plane, 0.4 for half a cylinder, at most */
#define SURE 2.0   /* squares of ECCENTRIC by which the next best axis fits worse, at least: two balls have a common axis anyway */
#define UPRIGHT 0.7 /* cosine between the axis and the table's normal */
#define CLOSED 0.2 /* and 0 for a ring */
#define LID 0.1    /* mean of the squared sine of a lid */

typedef struct {
    float p[3], d, n[3]; /* mean point [m], its inverse depth, normal towards the camera; NAN where there is none */
    int32_t label, part, inside; /* halves of a cell from the nearest edge that may separate */
} cell;

typedef struct {
    int32_t a, b, next; /* fragments, a < b; the next border of a */
    int32_t steps, length, behind, apart; /* edges; those where b is behind a less those where it is before; no common axis */
    double bend; /* sum */
} border;

typedef struct {
    double area, tops; /* m2; largest height above the table */
    int32_t cells, hollow, rim, to, first;
} fragment;

typedef struct {
    int64_t h, w, n, n_fragments, n_borders;
    cell *cells;
    float *bends; /* right and down (n, 2); NAN where there is no edge */
    int32_t *root;
    fragment *fragments;
    border *borders;
    const double *s;
} graph;

/* A sharper edge may separate two fragments. */
INLINE float least_bend(const graph *g) { return (float)g->s[BEND] * EDGE; }

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

static void make_cells(graph *g, const float *xyz, int64_t across, int64_t h, int64_t w, const int32_t *labels,
                       const uint8_t *solid, int64_t k) {
    for (int64_t i = 0; i < g->h; i++) {
        for (int64_t j = 0; j < g->w; j++) {
            cell *c = g->cells + i * g->w + j;
            const int64_t bottom = (i + 1) * k < h ? (i + 1) * k : h, right = (j + 1) * k < w ? (j + 1) * k : w;
            const int64_t y0 = (i * k + bottom) / 2, x0 = (j * k + right) / 2;
            int64_t at = y0 * w + x0;
            for (int64_t y = i * k; y < bottom && !solid[at]; y++) { /* a point at the middle, else any */
                for (int64_t x = j * k; x < right; x++) {
                    at = solid[y * w + x] ? y * w + x : at;
                }
            }
            const float z = xyz[3 * (at / w * across + at % w) + 2], gap = (float)g->s[STEP_M];
            float sum[4] = {0.0f};
            c->label = solid[at] ? labels[at] : 0;
            for (int64_t y = i * k; y < bottom && c->label; y++) {
                for (int64_t x = j * k; x < right; x++) {
                    const float *p = xyz + 3 * (y * across + x);
                    if (solid[y * w + x] && labels[y * w + x] == c->label && fabsf(p[2] - z) < gap) {
                        const float d = 1.0f / p[2];
                        sum[0] += p[0] * d, sum[1] += p[1] * d, sum[2] += d, sum[3] += 1.0f;
                    }
                }
            }
            c->part = 0;
            c->d = c->label ? sum[2] / sum[3] : 1.0f / z;
            c->p[0] = sum[0] / sum[3] / c->d, c->p[1] = sum[1] / sum[3] / c->d, c->p[2] = 1.0f / c->d;
        }
    }
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

static void make_bends(graph *g) {
    float *bends = malloc((size_t)(2 * g->n) * sizeof(float) + 1);
    for (int64_t k = 0; bends && k < 2 * g->n; k++) {
        const int dir = k & 1;
        bends[k] = g->bends[k];
        if (bends[k] == 0.0f) {
            const cell *a = g->cells + walk(g, k / 2, dir, -1, REACH);
            const cell *b = g->cells + walk(g, k / 2 + (dir ? g->w : 1), dir, 1, REACH);
            float chord = 0.0f, side = 0.0f;
            for (int x = 0; x < 3; x++) {
                const float turn = a->n[x] - b->n[x];
                chord += turn * turn, side += turn * (a->p[x] - b->p[x]);
            }
            bends[k] = chord == chord ? (side < 0.0f ? sqrtf(chord) : -sqrtf(chord)) : 0.0f;
        }
    }
    if (bends) {
        memcpy(g->bends, bends, (size_t)(2 * g->n) * sizeof(float));
    }
    free(bends);
}

INLINE int32_t root_of(int32_t *root, int32_t i) {
    while (root[i] != i) {
        i = root[i] = root[root[i]];
    }
    return i;
}

/* Distance of cells from the nearest edge that is concave, a step, or that of the cluster: in halves of a cell, 2 to a neighbour
 * and 3 to a diagonal one; 1 beside such an edge, 0 without a normal. Returns the largest. */
static int32_t find_depths(graph *g) {
    int32_t most = 0;
    for (int64_t i = 0; i < g->n; i++) {
        g->cells[i].inside = g->cells[i].n[0] == g->cells[i].n[0] ? INT32_MAX / 2 : 0;
    }
    for (int64_t k = 0; k < 2 * g->n; k++) {
        if (!(g->bends[k] <= least_bend(g))) {
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
    memset(g->root, -1, (size_t)g->n * sizeof(int32_t));
    for (int32_t level = find_depths(g); level >= 0; level--) {
        for (int64_t i = 0; i < g->n; i++) {
            if (!g->cells[i].label || g->cells[i].inside != level) {
                continue;
            }
            const int64_t edges[4] = {2 * (i - 1), 2 * i, 2 * (i - g->w) + 1, 2 * i + 1}, others[4] = {i - 1, i + 1, i - g->w, i + g->w};
            int32_t own = g->root[i] = (int32_t)i;
            for (int side = 0; side < 4; side++) {
                const int64_t o = others[side];
                if (edges[side] < 0 || !(g->bends[edges[side]] <= least_bend(g)) || g->root[o] < 0) {
                    continue;
                }
                const int32_t one = root_of(g->root, (int32_t)o), a = g->cells[one].inside, b = g->cells[own].inside;
                if (own != i && (a < b ? a : b) < level + NECK) {
                    g->root[a > b ? own : one] = a > b ? one : own;
                }
                own = own == i || a > b ? one : own;
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

/* The border of two fragments, made if there is none; NULL without memory. */
static border *border_of(graph *g, int32_t a, int32_t b) {
    const int32_t first = a < b ? a : b, second = a < b ? b : a;
    int32_t *at = &g->fragments[first].first;
    while (*at >= 0 && g->borders[*at].b != second) {
        at = &g->borders[*at].next;
    }
    if (*at < 0) {
        g->borders[g->n_borders] = (border){first, second, -1, 0, 0, 0, 0, 0.0};
        *at = (int32_t)g->n_borders++;
    }
    return g->borders + *at;
}

static void measure(graph *g) {
    for (int64_t i = 0; i <= g->n_fragments; i++) {
        g->fragments[i] = (fragment){0.0, -INFINITY, 0, 0, 0, (int32_t)i, -1};
    }
    for (int64_t i = 0; i < g->n; i++) {
        const cell *c = g->cells + i;
        if (c->part) {
            fragment *f = g->fragments + c->part;
            const double *t = g->s + PLANE, side = g->s[PITCH] * c->p[2];
            const double height = c->p[0] * t[0] + c->p[1] * t[1] + c->p[2] * t[2] + t[3];
            f->tops = height > f->tops ? height : f->tops;
            f->area += side * side;
            f->cells++;
            f->hollow += (g->bends[2 * i] > HOLLOW && g->bends[2 * i] < STEP) || (g->bends[2 * i + 1] > HOLLOW && g->bends[2 * i + 1] < STEP);
        }
        for (int dir = 0; dir < 2; dir++) {
            const cell *o = c + (dir ? g->w : 1);
            const float bend = g->bends[2 * i + dir];
            if (bend == bend && c->part != o->part) {
                border *one = border_of(g, c->part, o->part);
                one->bend += bend > FULL ? FULL : bend < 0.0f ? 0.0f : bend;
                one->steps += bend == STEP;
                one->length++;
                one->behind += (c->p[2] < o->p[2]) == (c->part == one->a) ? 1 : -1;
            }
        }
    }
}

/* More than half of its cells are; one that has joined its rim counts as solid. */
INLINE int is_hollow(const fragment *f) { return !f->rim && 2 * f->hollow > f->cells; }

static void join(graph *g, int32_t a, int32_t b) {
    fragment *to = g->fragments + a, *from = g->fragments + b;
    to->area += from->area, to->cells += from->cells, to->hollow += from->hollow, to->rim |= from->rim;
    to->tops = to->tops > from->tops ? to->tops : from->tops;
    for (int64_t i = 1; i <= g->n_fragments; i++) {
        g->fragments[i].to = g->fragments[i].to == b ? a : g->fragments[i].to;
        g->fragments[i].first = -1; /* from here on: the border of a with this one */
    }
    int64_t kept = 0;
    for (int64_t k = 0; k < g->n_borders; k++) {
        border one = g->borders[k];
        one.a = one.a == b ? a : one.a, one.b = one.b == b ? a : one.b;
        if (one.a > one.b) {
            const int32_t first = one.b;
            one.b = one.a, one.a = first, one.behind = -one.behind;
        }
        const int32_t other = one.a == a ? one.b : one.b == a ? one.a : 0;
        if (other == a) {
            continue;
        }
        one.apart = other ? 0 : one.apart;
        if (other && g->fragments[other].first >= 0) {
            border *same = g->borders + g->fragments[other].first;
            same->bend += one.bend, same->steps += one.steps, same->length += one.length;
            same->behind += one.behind;
        } else {
            if (other) {
                g->fragments[other].first = (int32_t)kept;
            }
            g->borders[kept++] = one;
        }
    }
    g->n_borders = kept;
}

/* Whether a border may be that of a hollow fragment with its rim: as high, mostly before it, and mostly at a step in depth. */
INLINE int rim_of(const graph *g, const border *one) {
    const fragment *a = g->fragments + one->a, *b = g->fragments + one->b;
    const int front = is_hollow(a) && !is_hollow(b) ? -one->behind : is_hollow(b) && !is_hollow(a) ? one->behind : -1;
    return front >= 0 && 2 * one->steps >= one->length && fabs(a->tops - b->tops) < TOUCH;
}

/* Whether two fragments are surfaces of revolution about one axis, seen from outside, as a bottle and its neck: the lines along
 * their normals meet the axis; or a closed ring and a flat part in the middle of it. The axis is that of the larger one, since
 * one between two axes side by side fits both. Lines that meet it are a linear complex, fitted as by Pottmann and Randrup
 * (Computing 60, 1998): the motion with rotation u and velocity v of the middle of the cells in which the cells move least in
 * the direction of their normals, sum (n v + u (p x n))^2. */
static int concentric(const graph *g, const border *one) {
    const int32_t large = g->fragments[one->a].cells < g->fragments[one->b].cells ? one->b : one->a;
    double middle[3] = {0.0}, nn[6] = {1e-9, 0.0, 0.0, 1e-9, 0.0, 1e-9}, nm[9] = {0.0}, mm[6] = {0.0}, count = 0.0;
    for (int pass = 0; pass < 2; pass++) {
        for (int64_t i = 0; i < g->n; i++) {
            const cell *c = g->cells + i;
            const int32_t part = g->fragments[c->part].to;
            if (part != large || !c->part || c->n[0] != c->n[0]) {
                continue;
            }
            if (!pass) {
                middle[0] += c->p[0], middle[1] += c->p[1], middle[2] += c->p[2], count += 1.0;
                continue;
            }
            const double p[3] = {c->p[0] - middle[0], c->p[1] - middle[1], c->p[2] - middle[2]};
            const double n[3] = {c->n[0], c->n[1], c->n[2]};
            const double m[3] = {p[1] * n[2] - p[2] * n[1], p[2] * n[0] - p[0] * n[2], p[0] * n[1] - p[1] * n[0]};
            for (int x = 0, at = 0; x < 3; x++) {
                for (int y = 0; y < 3; y++) {
                    nm[3 * x + y] += n[x] * m[y];
                    if (y >= x) {
                        nn[at] += n[x] * n[y], mm[at++] += m[x] * m[y];
                    }
                }
            }
        }
        for (int x = 0; x < 3 && !pass; x++) {
            middle[x] /= count > 0.0 ? count : 1.0;
        }
    }
    nn[0] += EVEN * count, nn[3] += EVEN * count, nn[5] += EVEN * count; /* a cylinder may move along its axis */
    const double minors[6] = {nn[3] * nn[5] - nn[4] * nn[4], nn[2] * nn[4] - nn[1] * nn[5], nn[1] * nn[4] - nn[2] * nn[3],
                              nn[0] * nn[5] - nn[2] * nn[2], nn[1] * nn[2] - nn[0] * nn[4], nn[0] * nn[3] - nn[1] * nn[1]};
    const double det = nn[0] * minors[0] + nn[1] * minors[1] + nn[2] * minors[2];
    double move[9], values[3], u[3], v[3] = {0.0}; /* v = -move u */
    for (int k = 0; k < 9; k++) {
        static const int at[9] = {0, 1, 2, 1, 3, 4, 2, 4, 5};
        const int x = k / 3, y = k % 3;
        move[k] = (minors[at[3 * x]] * nm[y] + minors[at[3 * x + 1]] * nm[3 + y] + minors[at[3 * x + 2]] * nm[6 + y]) / det;
    }
    for (int x = 0, at = 0; x < 3; x++) {
        for (int y = x; y < 3; y++) {
            mm[at++] -= nm[x] * move[y] + nm[3 + x] * move[3 + y] + nm[6 + x] * move[6 + y];
        }
    }
    eigen3(mm, values, u);
    for (int k = 0; k < 9; k++) {
        v[k / 3] -= move[k] * u[k % 3];
    }
    const double axis[3] = {u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]};
    double side[2] = {0.0}, off[2] = {0.0}, out[2] = {0.0}, normals[2][3] = {{0.0}}, places[2][3] = {{0.0}}, cells[2] = {0.0};
    for (int64_t i = 0; i < g->n; i++) {
        const cell *c = g->cells + i;
        const int32_t part = g->fragments[c->part].to;
        if ((part != one->a && part != one->b) || !c->part || c->n[0] != c->n[0]) {
            continue;
        }
        const int k = part != large;
        const double r[3] = {c->p[0] - middle[0] - axis[0], c->p[1] - middle[1] - axis[1], c->p[2] - middle[2] - axis[2]};
        const double along = u[0] * c->n[0] + u[1] * c->n[1] + u[2] * c->n[2], height = u[0] * r[0] + u[1] * r[1] + u[2] * r[2];
        double n[3], miss = 0.0;
        for (int x = 0; x < 3; x++) {
            n[x] = c->n[x] - along * u[x];
            out[k] += n[x] * r[x], side[k] += n[x] * n[x];
            normals[k][x] += n[x], places[k][x] += r[x] - height * u[x];
        }
        for (int x = 0; x < 3; x++) {
            miss += u[x] * (r[(x + 1) % 3] * n[(x + 2) % 3] - r[(x + 2) % 3] * n[(x + 1) % 3]);
        }
        off[k] += miss * miss, cells[k] += 1.0;
    }
    const int sure = values[1] > SURE * ECCENTRIC * ECCENTRIC * count;
    int turned[2], closed[2], lid[2];
    for (int k = 0; k < 2; k++) {
        const double *n = normals[k], *r = places[k], flat = (n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / (cells[k] * side[k]);
        turned[k] = side[k] > SIDE * cells[k] && off[k] < ECCENTRIC * ECCENTRIC * side[k] && flat < FLAT && out[k] > 0.0;
        closed[k] = turned[k] && flat < CLOSED;
        lid[k] = side[k] < LID * cells[k] && sqrt(r[0] * r[0] + r[1] * r[1] + r[2] * r[2]) < ECCENTRIC * cells[k];
    }
    const double *t = g->s + PLANE, upright = u[0] * t[0] + u[1] * t[1] + u[2] * t[2];
    const fragment *a = g->fragments + large, *b = g->fragments + one->a + one->b - large;
    if (fabs(upright) > UPRIGHT && b->tops < a->tops) {
        return 0; /* it stands on the smaller one */
    }
    return (turned[0] && turned[1] && sure) || (closed[0] && lid[1]);
}

/* Joins fragments whose border bends least, as long as it bends less than the limit. A fragment smaller than a fingertip joins
 * the neighbour from which it is separated least; two hollow ones are one wall; a hollow one joins its rim; concentric ones are one. */
static void join_all(graph *g, int64_t *counts) {
    for (;;) {
        const border *best = NULL;
        double least = g->s[BEND];
        const border *rim = NULL;
        int why = -1;
        for (int64_t k = 0; k < g->n_borders; k++) {
            const border *one = g->borders + k;
            const fragment *a = g->fragments + one->a, *b = g->fragments + one->b;
            double bend = one->bend / one->length;
            int reason = -1;
            if (a->area < g->s[PART_M2] || b->area < g->s[PART_M2]) {
                reason = bend < g->s[BEND] ? -1 : BY_SIZE;
                bend -= 10.0;
            } else if (is_hollow(a) && is_hollow(b) && 2 * one->steps < one->length) {
                reason = bend < g->s[BEND] ? -1 : BY_HOLLOW;
                bend -= 5.0;
            }
            if (bend < least) {
                least = bend, best = one, why = reason;
            }
        }
        for (int64_t k = 0; k < g->n_borders && why < 0 && !best; k++) { /* a hollow fragment and its longest border */
            rim = rim_of(g, g->borders + k) && (!rim || g->borders[k].length > rim->length) ? g->borders + k : rim;
        }
        if (rim && !best) {
            best = rim, why = BY_HOLLOW;
            g->fragments[rim->a].rim = 1;
        }
        for (int64_t k = 0; k < g->n_borders && !best; k++) {
            border *other = g->borders + k;
            if (!other->apart && !(other->apart = !concentric(g, other))) {
                best = other, why = BY_AXIS;
            }
        }
        if (!best) {
            break;
        }
        if (why >= 0) {
            counts[why]++;
        }
        join(g, best->a, best->b);
    }
}

static void name_parts(graph *g) {
    for (int64_t i = 0; i < g->n; i++) {
        g->cells[i].part = g->fragments[g->cells[i].part].to;
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
        if (!o->label) {
            continue;
        }
        const float u = o->p[0] * o->d, v = o->p[1] * o->d;
        const float d = (a->n[0] * u + a->n[1] * v + a->n[2]) / (a->n[0] * a->p[0] + a->n[1] * a->p[1] + a->n[2] * a->p[2]);
        if (o->part == g->cells[i].part) {
            return -1;
        }
        if (o->d > d + (float)g->s[STEP_M] * d * d) {
            hidden++;
        } else if (hidden) {
            return i + t * to;
        } else if (++open > 2) { /* nothing hides the surface */
            return -1;
        }
    }
    return -1;
}

/* Joins parts on both sides of a nearer one where their surfaces agree along most lines of cells. */
static void join_hidden(graph *g, int64_t *counts) {
    g->n_borders = 0;
    for (int64_t i = 1; i <= g->n_fragments; i++) {
        g->fragments[i].first = -1;
    }
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
        border *one = border_of(g, g->cells[i].part, g->cells[other].part);
        one->steps += chord < TURN * TURN && fabsf(behind(a, b)) < limit && fabsf(behind(b, a)) < limit;
        one->length++;
    }
    for (int64_t k = 0; k < g->n_borders; k++) {
        const border *one = g->borders + k;
        if (one->steps >= LINES && 2 * one->steps > one->length) {
            counts[BY_VIEW]++;
            join(g, one->a, one->b);
            k = -1;
        }
    }
}

/* Gives each pixel the part of the cell of its cluster that is nearest: in cells, and in depth by LIKE. */
static int64_t write_parts(const graph *g, const float *xyz, int64_t across, int64_t h, int64_t w, int64_t k, int32_t *labels) {
    int32_t *names = g->root, count = 0;
    memset(names, 0, (size_t)g->n * sizeof(int32_t));
    for (int64_t y = 0; y < h; y++) {
        for (int64_t x = 0; x < w; x++) {
            const int32_t label = labels[y * w + x];
            const float z = xyz[3 * (y * across + x) + 2];
            float best = INFINITY;
            int32_t part = 0;
            for (int64_t near = 0; near < 9 && label; near++) {
                const int64_t i = y / k + near / 3 - 1, j = x / k + near % 3 - 1;
                const cell *c = g->cells + i * g->w + j;
                if (i < 0 || j < 0 || i >= g->h || j >= g->w || c->label != label) {
                    continue;
                }
                const float dy = ((float)y + 0.5f) / (float)k - (float)i - 0.5f, dx = ((float)x + 0.5f) / (float)k - (float)j - 0.5f;
                const float dz = (z - c->p[2]) / LIKE, apart = dx * dx + dy * dy + dz * dz;
                if (apart < best) {
                    best = apart, part = c->part;
                }
            }
            if (part && !names[part - 1]) {
                names[part - 1] = ++count;
            }
            labels[y * w + x] = part ? names[part - 1] : 0;
        }
    }
    return count;
}

/* Splits the clusters of a window (h, w) of an image, at `xyz`, whose rows have `across` points.
 *
 * k: side of a cell in pixels. solid: (h, w), pixels with a reliable depth. labels: (h, w), in: the clusters, out: the parts, from
 * 1. counts: (COUNTS), the number of parts, and of those that each rule joined; -1 in the first without memory. */
VECTORISED void split_clusters(const float *xyz, int64_t across, int64_t h, int64_t w, int64_t k, const double *settings,
                               const uint8_t *solid, int32_t *labels, int64_t *counts) {
    graph g = {(h + k - 1) / k, (w + k - 1) / k, 0, 0, 0, NULL, NULL, NULL, NULL, NULL, settings};
    const size_t n = (size_t)(g.n = g.h * g.w);
    memset(counts, 0, COUNTS * sizeof(int64_t));
    g.cells = malloc((n + 1) * sizeof(cell));
    g.bends = malloc((2 * n + 1) * sizeof(float));
    g.root = malloc((n + 1) * sizeof(int32_t));
    g.fragments = malloc((n + 1) * sizeof(fragment));
    g.borders = malloc((2 * n + 1) * sizeof(border));
    if (g.cells && g.bends && g.root && g.fragments && g.borders) {
        make_cells(&g, xyz, across, h, w, labels, solid, k);
        find_steps(&g);
        make_normals(&g);
        make_bends(&g);
        make_fragments(&g);
        measure(&g);
        join_all(&g, counts);
        name_parts(&g);
        join_hidden(&g, counts);
        name_parts(&g);
        counts[PARTS] = write_parts(&g, xyz, across, h, w, k, labels);
    } else {
        counts[PARTS] = -1;
    }
    free(g.cells);
    free(g.bends);
    free(g.root);
    free(g.fragments);
    free(g.borders);
}

/* Whether clusters of a window call for splitting or joining, from every `stride`-th pixel: the nodes that lie deeper than the
 * middle between two of their cluster `arm` pixels away by more than sag + noise z^2, and those next to another cluster. */
void concave_nodes(const float *xyz, int64_t across, int64_t h, int64_t w, int64_t stride, int64_t arm, double sag, double noise,
                   const int32_t *labels, int64_t *counts) {
    counts[0] = counts[1] = 0;
    for (int dir = 0; dir < 2; dir++) {
        const int64_t row = dir ? arm : 0, column = dir ? 0 : arm;
        for (int64_t y = row; y < h - row; y += stride) {
            for (int64_t x = column; x < w - column; x += stride) {
                const int32_t one = labels[(y - row) * w + x - column], two = labels[(y + row) * w + x + column];
                if (one && two && one == labels[y * w + x] && one == two) {
                    const float *p = xyz + 3 * (y * across + x) + 2;
                    const float d = 0.5f / p[-3 * (row * across + column)] + 0.5f / p[3 * (row * across + column)], z = *p;
                    counts[0] += z - 1.0f / d > (float)sag + (float)noise * z * z;
                } else {
                    counts[1] += one && two && one != two;
                }
            }
        }
    }
}

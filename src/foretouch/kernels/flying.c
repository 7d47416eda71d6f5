/* SPDX-License-Identifier: Apache-2.0 */
#include "kernels.h"

#define SPARSE 64 /* cells of a grid for each point; a grid of more is nearly empty */
#define FEWEST 5  /* neighbours from which a point is judged */

/* Of the settings: neighbours of a point, points from which on any are marked; then of cloud/geometry/flying.py. */
enum { WANTED, LEAST, GAP, SLOPE, SHARE, SUPPORT, SHARE_AGAIN, SUPPORT_AGAIN };

typedef struct {
    const float *u, *v; /* (n), rays x / z and y / z */
    float low[2], edge; /* of the grid */
    int64_t across, down;
} grid;

typedef struct { /* ordered by cell: cell c holds those from first[c] to first[c + 1] */
    float *u, *v, *z;
    int64_t *order, *first; /* number of each among all points */
} ordered;

INLINE int64_t cell_of(const grid *g, int64_t i) {
    return (int64_t)((g->v[i] - g->low[1]) / g->edge) * g->across + (int64_t)((g->u[i] - g->low[0]) / g->edge);
}

/* The cells of a grid with cells of an edge, 0 if they are too many. */
INLINE int64_t cells_of(grid *g, const float *high, float edge, int64_t n) {
    const double across = floor((high[0] - g->low[0]) / edge) + 1.0, down = floor((high[1] - g->low[1]) / edge) + 1.0;
    if (!(edge > 0.0f && across * down <= (double)SPARSE * (double)n)) {
        return 0;
    }
    g->edge = edge;
    g->across = (int64_t)across;
    g->down = (int64_t)down;
    return g->across * g->down;
}

/* Marks the points that are alone among those that are there; returns their number. */
INLINE int64_t mark_alone(
    const grid *g, const ordered *p, float reach, const double *settings, double share, int32_t most, uint8_t *flying
) {
    const float within = reach * reach, gap = (float)(settings[GAP] * settings[GAP]);
    const float slope = (float)(settings[SLOPE] * settings[SLOPE]);
    int64_t found = 0;
    for (int64_t cell = 0; cell < g->across * g->down; cell++) {
        const int64_t row = cell / g->across, column = cell % g->across;
        const int64_t left = column ? column - 1 : 0, right = column + 1 < g->across ? column + 1 : column;
        for (int64_t at = p->first[cell]; at < p->first[cell + 1]; at++) {
            const float x = p->u[at], y = p->v[at], z = p->z[at], steep = slope * z * z;
            int32_t around = -1, behind = 0, support = -1; /* of the others */
            for (int k = 0; k < 3 && support <= most; k++) { /* its own row first: most find their support there */
                const int64_t other = k == 0 ? row : (k == 1 ? row - 1 : row + 1);
                if (other < 0 || other >= g->down) {
                    continue;
                }
                const int64_t end = p->first[other * g->across + right + 1];
                for (int64_t j = p->first[other * g->across + left]; j < end; j++) {
                    const float a = p->u[j] - x, b = p->v[j] - y, deeper = p->z[j] - z, apart = a * a + b * b;
                    const float limit = steep * apart > gap ? steep * apart : gap;
                    const int32_t near = apart <= within, close = deeper * deeper <= limit;
                    around += near;
                    support += near & close;
                    behind += near & (close ^ 1) & (deeper > 0.0f);
                }
            }
            const int32_t before = around - support - behind, side = behind > before ? behind : before;
            const uint8_t alone = support <= most && around >= FEWEST && (double)side >= share * (double)around;
            flying[p->order[at]] = alone;
            found += alone;
        }
    }
    return found;
}

/* Takes the marked points out. */
INLINE void leave_out(const grid *g, ordered *p, const uint8_t *flying) {
    int64_t kept = 0, at = 0;
    for (int64_t cell = 0; cell < g->across * g->down; cell++) {
        const int64_t end = p->first[cell + 1];
        p->first[cell] = kept;
        for (; at < end; at++) {
            if (!flying[p->order[at]]) {
                p->u[kept] = p->u[at], p->v[kept] = p->v[at], p->z[kept] = p->z[at];
                p->order[kept++] = p->order[at];
            }
        }
    }
    p->first[g->across * g->down] = kept;
}

/* Marks the points (n, 3) that are alone in front of those around them, or alone behind them. If there are at least
 * settings[LEAST] of them, those that are so among the rest are marked, too; else none is.
 *
 * flying: (n). settings: see the enumeration. radius: that of the neighbourhood among the rays, in which a point has
 * about so many neighbours as wanted; 0 where rays define none (no depth, a single line), and -1 without memory. */
VECTORISED void flying_points(const float *xyz, int64_t n, const double *settings, uint8_t *flying, double *radius) {
    memset(flying, 0, (size_t)(n > 0 ? n : 0));
    *radius = 0.0;
    if (n <= FEWEST) {
        return;
    }
    int64_t *order = malloc((size_t)n * (sizeof(int64_t) + 5 * sizeof(float))), *first = NULL;
    uint8_t *used = NULL;
    if (!order) {
        *radius = -1.0;
        return;
    }
    float *u = (float *)(order + n), *v = u + n, *sorted = v + n;
    grid g = {u, v, {INFINITY, INFINITY}, 0.0f, 0, 0};
    float high[2] = {-INFINITY, -INFINITY};
    for (int64_t i = 0; i < n; i++) {
        if (!(xyz[3 * i + 2] > 0.0f)) {
            goto done;
        }
        u[i] = xyz[3 * i] / xyz[3 * i + 2];
        v[i] = xyz[3 * i + 1] / xyz[3 * i + 2];
        g.low[0] = u[i] < g.low[0] ? u[i] : g.low[0];
        g.low[1] = v[i] < g.low[1] ? v[i] : g.low[1];
        high[0] = u[i] > high[0] ? u[i] : high[0];
        high[1] = v[i] > high[1] ? v[i] : high[1];
    }
    /* The area of the rays is that of the cells in use, of which a full one holds four points. */
    const float edge = 2.0f * sqrtf((high[0] - g.low[0]) * (high[1] - g.low[1]) / (float)n);
    int64_t cells = cells_of(&g, high, edge, n), area = 0;
    if (!cells) {
        goto done;
    }
    used = calloc((size_t)cells, 1);
    for (int64_t i = 0; used && i < n; i++) {
        uint8_t *cell = used + cell_of(&g, i);
        area += !*cell;
        *cell = 1;
    }
    const float reach = sqrtf((float)settings[WANTED] * (float)area * edge * edge / (3.14159265f * (float)n));
    cells = cells_of(&g, high, 1.001f * reach, n); /* a margin for rounding */
    first = calloc((size_t)(cells + 2), sizeof(int64_t));
    *radius = used && first ? (double)reach : -1.0;
    if (!cells || !used || !first) {
        goto done;
    }
    for (int64_t i = 0; i < n; i++) {
        first[cell_of(&g, i) + 2]++;
    }
    for (int64_t i = 2; i < cells + 2; i++) {
        first[i] += first[i - 1];
    }
    ordered points = {sorted, sorted + n, sorted + 2 * n, order, first};
    for (int64_t i = 0; i < n; i++) { /* from here on, cell c holds those from first[c] to first[c + 1] */
        const int64_t at = first[cell_of(&g, i) + 1]++;
        order[at] = i;
        points.u[at] = u[i], points.v[at] = v[i], points.z[at] = xyz[3 * i + 2];
    }
    const int64_t found = mark_alone(&g, &points, reach, settings, settings[SHARE], (int32_t)settings[SUPPORT], flying);
    if ((double)found < settings[LEAST]) {
        memset(flying, 0, (size_t)n);
    } else if (found) {
        leave_out(&g, &points, flying);
        mark_alone(&g, &points, reach, settings, settings[SHARE_AGAIN], (int32_t)settings[SUPPORT_AGAIN], flying);
    }
done:
    free(order);
    free(first);
    free(used);
}

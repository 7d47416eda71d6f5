/* SPDX-License-Identifier: Apache-2.0 */
/* What Python calls: plain C without Python. build.py gives this file to cffi, and to the compiler with the sources.
 *
 * `test/kernels` compares each function with a NumPy or SciPy reference. To give the same bits on every machine, the files
 * are compiled without contraction of a * b + c and without reordering of sums; float32 stays float32 where NumPy has it.
 * Arrays are contiguous and belong to the caller; no function allocates what it does not free, or keeps a state. */
#ifndef FORETOUCH_KERNELS_H
#define FORETOUCH_KERNELS_H

#include "common.h"

/* background.c */
typedef struct {
    const float *grid;     /* (h, w, 3) points of a coarse grid of pixels */
    const int32_t *labels; /* (h, w) their parts, from 1 to n - 1; 0 is none */
    int64_t h, w, n;
    double pitch;        /* of the grid, lateral distance per depth */
    const double *plane; /* (4) the table, its normal towards the camera */
    double level;        /* height [m], */
    double noise;        /* and height divided by depth^2 [1/m], up to which a cell belongs to the table */
    double below;        /* depth from which on the world is below the table [m] */
    double border;       /* share of an outline at the border of the image, from which on a part may be cut off */
    double foot;         /* height of a foot [m] */
    double flat;         /* thickness of a wall [m] */
} Parts;
void find_background(const Parts *of, int64_t *reasons, uint8_t *cut, double *outline, int64_t *found);

/* closing.c */
void outline(const double *points, int64_t n, const double *grid, int64_t rows, int64_t columns, float *nearest,
    float *inside);
typedef struct { /* of an object in the image */
    const double *camera; /* rotation (9) and origin (3) of the table's frame in the camera's; column, row and pitch */
    const float *nearest; /* (rows, columns) depth of the nearest point of a cell, infinite in a gap */
    const float *inside;  /* (rows, columns) how certainly a cell is inside of the outline, 0 ... 1 */
    int64_t rows;
    int64_t columns;
    double per_cell; /* 1 / pitch */
} Outline;
void complete_object(const double *points, const double *weights, int64_t n, double top, const double *shift,
    const Outline *seen, double *completed, double *shares, double *found);
void closing_lines(const double *points, const double *weights, int64_t n, const double *turns, int64_t angles,
    int64_t lines, const double *settings, const Outline *seen, const double *others, int64_t m, const double *palm,
    int64_t n_tilts, int64_t n_free, double *found);

/* clusters.c */
typedef struct {
    const float *xyz;            /* the image */
    int64_t across, row, column; /* width of the image, first pixel of the window */
    int64_t h, w;
    int32_t *labels; /* (h, w) its clusters or parts, 0 is none */
    uint8_t *solid;  /* (h, w) whether it is labelled, with a reliable depth */
} Labelled;
typedef struct {
    int32_t *number; /* (h, w) of the patches of a coarse grid of pixels */
    int64_t h, w, stride, min_nodes;
    const double *settings; /* see clusters.c */
} Patches;
typedef struct {
    uint8_t *marks; /* of a part of the image, from `row` and `column`, with rows of `across` */
    int64_t row, column, across;
} Marks;
void grid_patches(const float *grid, const Patches *of, int64_t *boxes, int64_t *found);
void label_window(const Labelled *of, const Patches *patches, int64_t patch, const Marks *marks, int64_t *found);
void collect_members(const Labelled *of, const float *plane, int64_t n_labels, int64_t *ends, int64_t *pixels,
    float *points, double *columns, float *bounds, float *tops);
void write_ids(const int32_t *labels, int64_t h, int64_t w, int64_t row, int64_t column, const int32_t *ids,
    int64_t across, int32_t *image, int64_t *count);
void count_labels(const int32_t *labels, const int64_t *pixels, int64_t n, int64_t last, int64_t *counts);
void coarse_grid(const float *xyz, int64_t h, int64_t w, int64_t stride, double nearest, double farthest, float *coarse,
    int64_t *index, int64_t *count);
void window_residuals(const float *grid, int64_t h, int64_t w, double nearest, double farthest, double *residuals,
    int64_t *count);

/* columns.c */
void centre_points(const double *points, int64_t n, double *centre, double *columns, double *products);
void bounds(const float *points, int64_t n, double *low, double *high);

/* contact.c */
typedef struct {
    const double *sorted; /* (3, n) points as sort_into_cells sorts them */
    int64_t n;
    const double *grid;    /* low x, y, z, cells per metre */
    const int64_t *cells;  /* numbers along x, y, z */
    const int32_t *starts; /* where the points of each cell begin */
} Cells;
void sort_into_cells(const double *xyz, int64_t n, const double *grid, const int64_t *cells, int32_t *cell,
    int32_t *starts, double *sorted);
void describe_contacts(const Cells *points, const double *squares, const double *contacts, const double *frames,
    int64_t count, double *rows);
void city_distances(const double *rows, int64_t count, int64_t columns, const double *packed, int64_t size,
    double *distances);
void weighted_sums(const double *weights, int64_t count, int64_t size, const double *packed, int64_t outputs,
    double *sums);
void hide_places(const double *points, int64_t n, const double *places, int64_t m, double pitch, double behind,
    int64_t most, uint8_t *hidden, int64_t *found);

/* crop.c */
const char *sources(void);
void count_range(const float *xyz, int64_t n, double low, double high, int64_t *counts);

/* deproject.c */
typedef struct {
    double scale;   /* metres of the unit of depth */
    const float *x; /* x / z of each column, or of each pixel */
    const float *y; /* y / z of each row, or of each pixel */
    int64_t each;   /* 1 where each pixel has its own */
} Rays;
void deproject_whole(const uint16_t *depth, int64_t across, int64_t h, int64_t w, int64_t step, const Rays *rays,
    float *xyz, int64_t line);
void deproject_single(const float *depth, int64_t across, int64_t h, int64_t w, int64_t step, const Rays *rays,
    float *xyz, int64_t line);
void count_whole(const uint16_t *depth, int64_t n, const Rays *rays, double low, double high, int64_t *counts);
void count_single(const float *depth, int64_t n, const Rays *rays, double low, double high, int64_t *counts);

/* flying.c */
void flying_points(const float *xyz, int64_t n, const double *settings, uint8_t *flying, double *radius);

/* forest.c */
typedef struct { /* several forests, one after the other */
    const int32_t *nodes;  /* (nodes, 4) threshold as bits of a float, column, left and right child */
    const int32_t *roots;  /* (trees) nodes */
    const int64_t *leaf;   /* (nodes) where the values of a leaf begin */
    const uint16_t *value; /* bits of float16 */
    const int64_t *sizes;  /* (count, 2) trees and outputs of each forest */
    int64_t count;
    int64_t width; /* sum of the outputs */
} Forests;
void forest_means(const float *rows, int64_t count, int64_t columns, const Forests *forests, int32_t *scratch,
    double *single, double *result);

/* hand.c */
void hand_clearance(const double *points, int64_t n, int64_t own, const double *tilts, int64_t n_tilts,
    const float *fronts, int64_t cells, const double *sizes, double *clear, double *behind);

/* lattice.c */
typedef struct {
    double low;        /* least depth */
    double high;       /* largest depth */
    double tangent;    /* largest |x / z| and |y / z| */
    double tolerance;  /* largest distance from a whole number, in pixels */
    const double *fit; /* (2, 3) for x / z, then y / z: the middle, one divided by the pitch, the index of the middle */
} Lattice;
typedef struct {
    int64_t column; /* first */
    int64_t row;    /* first */
    int64_t height;
    int64_t width;
} Window;
void ray_cells(const float *xyz, int64_t n, const Lattice *lattice, int32_t *cells, int64_t *result);
void fill_image(const float *xyz, int64_t n, const Lattice *lattice, const int32_t *cells, const Window *window,
    float *image, int32_t *place, int64_t *result);

/* layer.c */
typedef struct {
    double given;       /* depth, or sum of the pressure */
    int64_t by_force;   /* 1 for the sum of the pressure */
    double safe_length; /* of a step */
    double tolerance;
    int64_t most; /* iterations */
} Descent;
void layer_descent(const double *gap, const double *spectrum, int64_t n, const Descent *how, double *pressure,
    double *end);

/* nearest.c */
void nearest_squares(const float *targets, int64_t count, const float *points, int64_t n, float *squares);

/* neighbours.c */
void mean_neighbour_distance(const float *xyz, int64_t n, int64_t k, float *mean, uint8_t *proven);
void summed_moments(const float *xyz, int64_t n, const float *places, int64_t q, double limit, const float *origin,
    double *sums);
void fit_planes(const double *sums, const float *places, int64_t q, double line, double *normals, double *curvature);

/* order.c */
void canonical_order(const float *xyz, int64_t n, int64_t *order);

/* outline.c */
typedef struct { /* a depth image: one of the three */
    const float *xyz;      /* (h, w, 3) points */
    const uint16_t *whole; /* (h, w) depths in a unit */
    const float *single;   /* (h, w) the same */
    double scale;          /* the unit */
    int64_t h, w;
    const double *camera; /* (4) focal length and principal point across, then down [px] */
} Depths;
void outline_ends(const float *points, int64_t n, const uint8_t *own, const Depths *image, const double *frame,
    const double *settings, int64_t rows, double *found, double *ends);
void unseen_beyond(const double *contacts, const double *outwards, int64_t n, const Depths *image, int64_t steps,
    const double *settings, double *beyond);

/* plane.c */
void count_near(const float *distances, const float *offsets, int64_t m, int64_t n, double reach, int64_t *counts);
void points_near(const double *points, const double *along, int64_t n, double offset, double reach, double *near,
    int64_t *count);
void residuals_near(const double *points, const double *along, int64_t n, double offset, double reach, double depth_m,
    double *scaled, int64_t *counts);

/* rvl.c */
void decode_rvl(const uint8_t *data, int64_t words, int64_t pixels, uint16_t *depth, int64_t *decoded);

/* split.c */
typedef struct { /* nodes and leaves of each tree in the order of a heap */
    const uint8_t *features; /* (count, 2^depth - 1) that a node looks at */
    const float *thresholds; /* the same: to the second branch where the feature is above */
    const float *leaves;     /* (count, 2^depth) log odds */
    int64_t count, depth;
    double *rows; /* (room, 2 + FEATURES), where the first that are rated are kept */
    int64_t room;
} Trees;
void concave_nodes(const Labelled *of, int64_t stride, int64_t arm, double sag, double noise, int64_t *counts);
void split_clusters(const Labelled *of, int64_t k, const double *settings, const Trees *trees, int64_t *counts,
    double *joins, uint8_t *clusters);

/* voxels.c */
void voxel_cells(const float *xyz, int64_t n, double cells_per_m, int64_t *cell, int64_t *counts, int64_t *found);
void cell_means(const double *values, int64_t n, int64_t columns, const int64_t *cell, const int64_t *counts, int64_t m,
    double *means);

#endif

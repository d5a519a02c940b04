/* Compliance of needle and tissue between points along the needle. Points are numbered by their places from base to tip, and all data are stored by
   components, so that several points are processed at once. */
#ifndef TROCAR_BETWEEN_KERNELS_H
#define TROCAR_BETWEEN_KERNELS_H

#include "base/vec.h"
#include "linalg/elimination.h"
#include "linalg/rows.h"

enum {
    BETWEEN_POINTS = 81,     /* at most */
    BETWEEN_PLACES = (BETWEEN_POINTS + 2 * ROW_ROOM - 2) / ROW_ROOM * ROW_ROOM, /* plus the rest of a vector that starts at any of them; whole cache
                                                                                   lines */
    BETWEEN_JOINTS = 3,      /* consecutive joints of the needle from which a point is interpolated */
};

typedef double between_rows[3][3][BETWEEN_PLACES];    /* [a][b]: component a, b of each place */
typedef double between_components[3][BETWEEN_PLACES]; /* [b]: component b of each place */

/* A point on the needle: its first joint, and the weights of the following joints. */
typedef struct {
    int first;
    const double *weights;
} between_interpolation;

/* Between the point in one place and those in places [begin, end), in whole vectors. The first vector may start earlier, at place `lowest`. */
typedef struct {
    int lowest, begin, end;
    const mat3 *frame;             /* of the point: columns are its axes, world frame */
    const double *weights;         /* of its BETWEEN_JOINTS joints */
    const between_components *needle; /* m/N, world frame, [row]: motion of the joints, from the point's first on, under unit forces at each place */
    const double *tissue[3][3];    /* m/N, world frame, before multiplication by `yield`: that of place l is at l + shift, for places before
                                      `tip_place` */
    int shift;
    double yield;
    int tip_place;                 /* or the number of places, if there is no tip */
    mat3 at_tip;                   /* m/N, world frame: the tissue's compliance with the tip */
    double mount;                  /* m/N */
    const between_rows *frames;    /* [a][b]: component a of axis b */
} between_points_row;

/* Compliance of tissue, needle and mount, in the frames of the points. Each number is computed by the same operations in the same order for any
   vector width. RT */
typedef void between_kernel(const between_points_row *row, between_rows blocks);

/* The kernels for any processor that can run this program and for AVX-512 (x86-64 only), and the best one for this processor. RT */
extern between_kernel between_portable, between_avx512;
between_kernel *between_kernel_here(void);

/* Motion of the joints, from the first point's first on, under unit forces at each of the points, which are in places from base to tip: to[3 joint +
   a][b]. `compliance`: between joints, rows `ld` apart. Entries beyond a point's joints are meaningless. RT */
void between_interpolate(const double *compliance, int ld, int count, const between_interpolation *points, between_components *to);

/* Stores the blocks of the point in place k with all `count` places from there on in the upper triangle of a matrix: first two unknowns across each
   point, then one along each. Writes whole vectors, which start before place k and overwrite blocks of points closer to the base; store those
   afterwards. RT */
void between_store(int count, int k, between_rows blocks, double (*matrix)[MOST_COLUMNS]);

#endif

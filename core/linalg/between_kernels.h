/* Compliance of needle and tissue between points along the needle. Places number the points from base to tip, and all data are stored by components, so that
   several points are processed at once. */
#ifndef TROCAR_BETWEEN_KERNELS_H
#define TROCAR_BETWEEN_KERNELS_H

#include "base/vec.h"
#include "linalg/elimination.h"
#include "linalg/rows.h"

enum {
    BETWEEN_POINTS = 81,     /* largest number of points */
    BETWEEN_PLACES = (BETWEEN_POINTS + 2 * ROW_ROOM - 2) / ROW_ROOM * ROW_ROOM, /* padded by the remainder of a vector that starts at any place, to whole cache
                                                                                   lines */
    BETWEEN_JOINTS = 3,      /* consecutive joints of the needle between which a point is interpolated */
};

typedef double between_rows[3][3][BETWEEN_PLACES];    /* [a][b]: components a, b of each place */
typedef double between_components[3][BETWEEN_PLACES]; /* [b]: component b of each place */

/* A point on the needle: its first joint, and the weights of the following joints. */
typedef struct {
    int first;
    const double *weights;
} between_interpolation;

/* Input of the kernel: the point at one place and those at places [begin, end), in whole vectors. The first vector may start earlier, at place `lowest`. */
typedef struct {
    int lowest, begin, end;
    const mat3 *frame;             /* the point's frame: columns are its axes, world frame */
    const double *weights;         /* weights of the point's BETWEEN_JOINTS joints */
    const between_components *needle; /* m/N, world frame, [row]: displacement of the joints, starting with the point's first one, under unit forces at each
                                         place */
    const double *tissue[3][3];    /* m/N, world frame, before multiplication by `yield`: the entry of place l is at l + shift, for places before `tip_place` */
    int shift;
    double yield;
    int tip_place;                 /* place of the tip, or the number of places if there is no tip */
    mat3 at_tip;                   /* m/N, world frame: the tissue's compliance with the tip */
    double mount;                  /* m/N, compliance of the mount */
    const between_rows *frames;    /* [a][b]: component a of axis b */
} between_points_row;

/* Compliance of tissue, needle and mount, in the frames of the points. Each number is computed by the same operations in the same order for any
   vector width. RT */
typedef void between_kernel(const between_points_row *row, between_rows blocks);

/* The kernel for any processor supported by this program, the one for AVX-512 (x86-64 only), and the best one for the present processor. RT */
extern between_kernel between_portable, between_avx512;
between_kernel *between_kernel_here(void);

/* Displacement of the joints, starting with the first joint of the first point, under unit forces at each of the points, which are sorted from base to tip:
   to[3 joint + a][b]. `compliance`: between joints, rows `ld` apart. Entries beyond a point's joints are meaningless. RT */
void between_interpolate(const double *compliance, int ld, int count, const between_interpolation *points, between_components *to);

/* Stores the blocks between the point at place k and all later ones (`count` places in total) in the upper triangle of a matrix: first the two unknowns across
   each point, then the one along each. Writes whole vectors, which start before place k and overwrite blocks of points closer to the base; store those later.
   RT */
void between_store(int count, int k, between_rows blocks, double (*matrix)[MOST_COLUMNS]);

#endif

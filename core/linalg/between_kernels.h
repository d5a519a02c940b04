/* Compliance of needle and tissue between points along the needle. A point's place is its number, counted from base to tip. Data are stored as structures of
   arrays, so that several points are processed at once. */
#ifndef TROCAR_BETWEEN_KERNELS_H
#define TROCAR_BETWEEN_KERNELS_H

#include "base/vec.h"
#include "linalg/elimination.h"
#include "linalg/rows.h"

enum {
    BETWEEN_POINTS = 81,     /* maximum number of points */
    BETWEEN_PLACES = (BETWEEN_POINTS + 2 * ROW_ROOM - 2) / ROW_ROOM * ROW_ROOM, /* number of places, padded to whole cache lines and by the part of a
                                                                                   vector that can extend beyond the last place */
    BETWEEN_JOINTS = 3,      /* number of consecutive joints between which a point on the needle is interpolated */
};

typedef double between_rows[3][3][BETWEEN_PLACES];    /* [a][b]: components a, b at each place */
typedef double between_components[3][BETWEEN_PLACES]; /* [b]: component b at each place */

/* A point on the needle: its first joint, and the weights of that joint and the following ones. */
typedef struct {
    int first;
    const double *weights;
} between_interpolation;

/* Input of the kernel: the point at one place and the points at places [begin, end), in whole vectors. The first vector may start before `begin`, but not
   before place `lowest`. */
typedef struct {
    int lowest, begin, end;
    const mat3 *frame;             /* frame of the point: its columns are the point's axes in the world frame */
    const double *weights;         /* weights of the point's BETWEEN_JOINTS joints */
    const between_components *needle; /* m/N, world frame, [row]: displacement of the joints, starting with the point's first one, under unit forces at
                                         each place */
    const double *tissue[3][3];    /* m/N, world frame, before multiplication by `yield`: the entry for place l, which must be before `tip_place`, is at l
                                      + shift */
    int shift;
    double yield;
    int tip_place;                 /* place of the tip; if there is no tip, the number of places */
    mat3 at_tip;                   /* m/N, world frame: the tissue's compliance between the point and the tip */
    double mount;                  /* m/N, compliance of the mount */
    const between_rows *frames;    /* [a][b]: component a of axis b of the frame at each place */
} between_points_row;

/* Computes the compliance of tissue, needle and mount in the frames of the points. Each number is computed by the same operations in the same order for
   any vector width. RT */
typedef void between_kernel(const between_points_row *row, between_rows blocks);

/* The kernel for any processor that this program supports, the kernel for AVX-512 (x86-64 only), and the faster of those that the current processor
   supports. RT */
extern between_kernel between_portable, between_avx512;
between_kernel *between_kernel_here(void);

/* Computes the displacement of the joints, starting with the first joint of the first point, under unit forces at each of the points, which are sorted
   from base to tip: to[3 joint + a][b]. `compliance`: between joints, with rows `ld` apart. Entries beyond the joints of a point are meaningless. RT */
void between_interpolate(const double *compliance, int ld, int count, const between_interpolation *points, between_components *to);

/* Stores the blocks between the point at place k and all later points (`count` places in total) in the upper triangle of a matrix: first the two unknowns
   across the needle at each point, then the one along it. Writes whole vectors, which may start before place k and overwrite blocks of points closer to the
   base; store those blocks afterwards. RT */
void between_store(int count, int k, between_rows blocks, double (*matrix)[MOST_COLUMNS]);

#endif

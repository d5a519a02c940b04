/* Compliance of needle and tissue between points along the needle. Points are numbered from base to tip; the number is the point's place. Data are stored as
   structures of arrays, so that several points are processed at once. */
#ifndef TROCAR_BETWEEN_KERNELS_H
#define TROCAR_BETWEEN_KERNELS_H

#include "base/vec.h"
#include "linalg/elimination.h"
#include "linalg/rows.h"

enum {
    BETWEEN_POINTS = 81,     /* most points */
    BETWEEN_PLACES = (BETWEEN_POINTS + 2 * ROW_ROOM - 2) / ROW_ROOM * ROW_ROOM, /* places, padded to whole cache lines and by as much as a vector can extend
                                                                                   beyond the last place */
    BETWEEN_JOINTS = 3,      /* a point on the needle is interpolated between this many consecutive joints */
};

typedef double between_rows[3][3][BETWEEN_PLACES];    /* [a][b]: components a, b at each place */
typedef double between_components[3][BETWEEN_PLACES]; /* [b]: component b at each place */

/* How a point on the needle is interpolated: its first joint, and the weights of that joint and the next ones. */
typedef struct {
    int first;
    const double *weights;
} between_interpolation;

/* Input of the kernel: one point, and the points at places [begin, end), in whole vectors. The first vector may start before `begin`, but not before place
   `lowest`. */
typedef struct {
    int lowest, begin, end;
    const mat3 *frame;             /* frame of the point; the columns are its axes in the world frame */
    const double *weights;         /* weights of the point's BETWEEN_JOINTS joints */
    const between_components *needle; /* m/N, world frame, [row]: displacement of the joints, from the point's first one on, per unit force at each place */
    const double *tissue[3][3];    /* m/N, world frame, before multiplication by `yield`. The entry for place l is at l + shift; only for places before
                                      `tip_place` */
    int shift;
    double yield;
    int tip_place;                 /* place of the tip; if there is no tip, the number of places */
    mat3 at_tip;                   /* m/N, world frame: compliance of the tissue between the point and the tip */
    double mount;                  /* m/N, compliance of the mount */
    const between_rows *frames;    /* [a][b]: component a of axis b of the frame at each place */
} between_points_row;

/* Computes the compliance of tissue, needle and mount in the frames of the points. Whatever the vector width, each number results from the same operations in
   the same order. RT */
typedef void between_kernel(const between_points_row *row, between_rows blocks);

/* The kernel for any supported processor, the kernel for AVX-512 (x86-64 only), and the fastest that this processor can run. RT */
extern between_kernel between_portable, between_avx512;
between_kernel *between_kernel_here(void);

/* Computes how far unit forces at each of the points, sorted from base to tip, displace the joints from the first point's first joint on: to[3 joint + a][b].
   `compliance`: between joints, with rows `ld` apart. Entries beyond a point's own joints are meaningless. RT */
void between_interpolate(const double *compliance, int ld, int count, const between_interpolation *points, between_components *to);

/* Stores the blocks between the point at place k and all later ones (`count` places in total) in the upper triangle of a matrix. The unknowns are the two
   across the needle at each point, followed by the one along it at each point. Writes whole vectors, which may start before place k and overwrite the blocks of
   points closer to the base; so store the blocks of those points afterwards. RT */
void between_store(int count, int k, between_rows blocks, double (*matrix)[MOST_COLUMNS]);

#endif

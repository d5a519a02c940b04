/* Data types of the needle: its parameters, state, centreline points and linearisation. */
#ifndef TROCAR_NEEDLE_MODEL_H
#define TROCAR_NEEDLE_MODEL_H

#include "base/error.h"
#include "base/vec.h"

enum {
    NEEDLE_MAX_SEGMENTS = 64,
    NEEDLE_LD = (NEEDLE_MAX_SEGMENTS / 4 + 1) * 12, /* three columns per joint, rounded up to whole blocks of four joints */
    NEEDLE_PLACES = NEEDLE_MAX_SEGMENTS + 4, /* enough for whole SIMD vectors of segments, plus the joint after the last segment */
    NEEDLE_POINT_JOINTS = 3,                /* joints that determine a point on the centreline */
};

typedef struct {
    double length;           /* m */
    double outer_diameter;   /* m */
    double inner_diameter;   /* m */
    double youngs_modulus;   /* Pa */
    double poisson_ratio;
    double bow;              /* how far the needle's middle lies off the line from base to tip, toward local +y, divided by the length */
    double bevel_slope;      /* lateral displacement per axial displacement while cutting, directed away from the bevel face (toward local -y) */
    int segments;            /* 2..NEEDLE_MAX_SEGMENTS */
} needle_parameters;

typedef struct {
    needle_parameters given;
    double segment_length;   /* m */
    double radius;           /* m, outer */
    double bending;          /* EI, N m^2 */
    double torsion;          /* GJ, N m^2 */
    double natural[NEEDLE_PLACES]; /* rad, how far each segment of the unloaded needle is rotated about local x relative to the previous one */
} needle_model;

typedef struct {
    pose base;
    quat frames[NEEDLE_MAX_SEGMENTS];      /* orientation of each segment; its axis is local +z */
    vec3 joints[NEEDLE_MAX_SEGMENTS + 1];  /* m, from the base (joints[0]) to the tip (the last joint) */
} needle_state;

/* How the needle's shape changed during a step. */
typedef struct {
    double time;             /* s, duration of the step; 0 if unknown */
    quat turn[NEEDLE_MAX_SEGMENTS]; /* rotation of each segment, world frame */
} needle_motion;

/* A point on the centreline. The centreline is a quadratic B-spline with the joints as control points, and straight in the first and last half segments. So its
   tangent is continuous, and a point's position is a linear function of the joint positions. */
typedef struct {
    int first;               /* the point depends on joints first, first + 1 and first + 2 */
    double weights[NEEDLE_POINT_JOINTS]; /* the sum is 1 */
    vec3 position;           /* m */
    mat3 frame;              /* columns: normal 1 (near local x), normal 2 (near local y), tangent */
} needle_point;

/* One vector or matrix per segment or joint, stored as structure of arrays so that four can be processed at once. Order of a symmetric matrix's entries: xx,
   xy, xz, yy, yz, zz. */
typedef struct { double at[3][NEEDLE_PLACES]; } vector_series;
typedef struct { double at[6][NEEDLE_PLACES]; } symmetric_series;
typedef struct { double at[9][NEEDLE_PLACES]; } matrix_series;

/* The linearisation about the current shape. Scratch memory for one Newton iteration. */
typedef struct {
    int unstable;                               /* number of negative eigenvalues of the tangent stiffness: how many buckling modes the needle would have under
                                                   these loads without the tissue's support */
    vec3 drift[NEEDLE_MAX_SEGMENTS + 1];        /* m, how far each joint would move, to first order, if the loads were removed */
    double compliance[NEEDLE_LD][NEEDLE_LD];    /* m/N, compliance between joints i and j: [3 i + a][3 j + b]. Filled for j > i - NEEDLE_POINT_JOINTS only */
    symmetric_series pivot_inverse;             /* D^-1, the inverted pivots of the L D L^T factorisation of the block tridiagonal tangent stiffness */
    matrix_series lower;
    vector_series moments;                      /* N m, moment at the joint before each segment, in the world frame */
    double rotation[3 * NEEDLE_MAX_SEGMENTS][NEEDLE_LD]; /* rad/N, rotation of each segment per unit force at each later joint */
} needle_tangent;

#endif

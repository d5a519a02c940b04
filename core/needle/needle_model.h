/* The needle's parameters, its state, a point on its centreline, and its linearisation. */
#ifndef TROCAR_NEEDLE_MODEL_H
#define TROCAR_NEEDLE_MODEL_H

#include "base/error.h"
#include "base/vec.h"

enum {
    NEEDLE_MAX_SEGMENTS = 64,
    NEEDLE_LD = (NEEDLE_MAX_SEGMENTS / 4 + 1) * 12, /* three columns for each joint, padded to whole blocks of four joints */
    NEEDLE_PLACES = NEEDLE_MAX_SEGMENTS + 4, /* room for whole SIMD vectors of segments, and for the joint after the last segment */
    NEEDLE_POINT_JOINTS = 3,                /* number of joints that determine a point on the centreline */
};

typedef struct {
    double length;           /* m */
    double outer_diameter;   /* m */
    double inner_diameter;   /* m */
    double youngs_modulus;   /* Pa */
    double poisson_ratio;
    double bow;              /* distance of the needle's middle from the line between base and tip, toward local +y, divided by the length */
    double bevel_slope;      /* lateral displacement per axial displacement while cutting, away from the bevel's face (toward local -y) */
    int segments;            /* 2..NEEDLE_MAX_SEGMENTS */
} needle_parameters;

typedef struct {
    needle_parameters given;
    double segment_length;   /* m */
    double radius;           /* m, outer */
    double bending;          /* EI, N m^2 */
    double torsion;          /* GJ, N m^2 */
    double natural[NEEDLE_PLACES]; /* rad, rotation about local x of each segment of the unloaded needle relative to the previous one */
} needle_model;

typedef struct {
    pose base;
    quat frames[NEEDLE_MAX_SEGMENTS];      /* orientation of each segment; its axis is local +z */
    vec3 joints[NEEDLE_MAX_SEGMENTS + 1];  /* m; joints[0] is the base, and the last joint is the tip */
} needle_state;

/* Change of the needle's shape during a step. */
typedef struct {
    double time;             /* s, duration of the step; 0 if not known */
    quat turn[NEEDLE_MAX_SEGMENTS]; /* rotation of each segment, world frame */
} needle_motion;

/* A point on the centreline, which is a quadratic B-spline over three joints (linear at both ends). Its tangent is continuous, and its position is linear
   in the joints. */
typedef struct {
    int first;               /* its joints are first, first + 1 and first + 2 */
    double weights[NEEDLE_POINT_JOINTS]; /* the sum is 1 */
    vec3 position;           /* m */
    mat3 frame;              /* columns: normal 1 (near local x), normal 2 (near local y), tangent */
} needle_point;

/* Vectors or matrices of segments or joints, stored by component so that four are computed at once. Symmetric matrices: xx, xy, xz, yy, yz, zz. */
typedef struct { double at[3][NEEDLE_PLACES]; } vector_series;
typedef struct { double at[6][NEEDLE_PLACES]; } symmetric_series;
typedef struct { double at[9][NEEDLE_PLACES]; } matrix_series;

/* Linearisation at the current shape (scratch memory of one Newton iteration). */
typedef struct {
    int unstable;                               /* number of negative eigenvalues of the tangent stiffness: the number of buckling modes of the unsupported
                                                   needle under these loads */
    vec3 drift[NEEDLE_MAX_SEGMENTS + 1];        /* m, linearised displacement of the joints if the loads were removed */
    double compliance[NEEDLE_LD][NEEDLE_LD];    /* m/N, compliance between joints: [3 i + a][3 j + b], for j > i - NEEDLE_POINT_JOINTS */
    symmetric_series pivot_inverse;             /* inverses of the pivots D in the factorisation L D L^T of the block tridiagonal tangent stiffness */
    matrix_series lower;
    vector_series moments;                      /* N m, spatial moment at the joint before each segment */
    double rotation[3 * NEEDLE_MAX_SEGMENTS][NEEDLE_LD]; /* rad/N, rotation of each segment under unit forces at each later joint */
} needle_tangent;

#endif

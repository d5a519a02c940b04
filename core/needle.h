/* The needle: an inextensible, geometrically exact Kirchhoff rod, a chain of rigid segments with elastic joints,
   clamped in the hand at its base. Base = arc 0, tip = arc `length`; axis along local +z. See README.md, "Needle". */
#ifndef TROCAR_NEEDLE_H
#define TROCAR_NEEDLE_H

#include "report.h"
#include "vec.h"

enum { NEEDLE_MAX_SEGMENTS = 64, NEEDLE_LD = 3 * (NEEDLE_MAX_SEGMENTS + 1) };

typedef struct {
    double length;           /* m */
    double outer_diameter;   /* m */
    double inner_diameter;   /* m */
    double youngs_modulus;   /* Pa */
    double poisson_ratio;
    double bevel_slope;      /* sideways cut per forward cut, away from the bevel's face (toward local -y) */
    int segments;            /* 2..NEEDLE_MAX_SEGMENTS */
} needle_parameters;

typedef struct {
    needle_parameters given;
    double segment_length;   /* m */
    double radius;           /* m, outer */
    double bending;          /* EI, N m^2 */
    double torsion;          /* GJ, N m^2 */
} needle_model;

typedef struct {
    pose base;
    quat frames[NEEDLE_MAX_SEGMENTS];      /* orientation of each segment; its axis is local +z */
    vec3 joints[NEEDLE_MAX_SEGMENTS + 1];  /* m; joints[0] is the base, the last one the tip */
} needle_state;

/* A point on the centreline: quadratic B-spline over three joints (linear at both ends), so that its tangent is
   continuous and its position linear in the joints. */
typedef struct {
    int first;               /* joints first, first+1, first+2 */
    double weights[3];       /* sum to 1 */
    vec3 position;           /* m */
    mat3 frame;              /* columns: normal 1 (near local x), normal 2 (near local y), tangent */
} needle_point;

/* Tangent at the current shape (scratch of one pass). */
typedef struct {
    int first;                                  /* compliance is valid for joints >= first */
    mat3 pivot_inverse[NEEDLE_MAX_SEGMENTS];    /* block L D L^T of the tangent stiffness */
    mat3 lower[NEEDLE_MAX_SEGMENTS];
    vec3 moments[NEEDLE_MAX_SEGMENTS];          /* spatial moment of the joint before each segment, N m */
    vec3 drift[NEEDLE_MAX_SEGMENTS + 1];        /* joints' displacement if all forces vanished (linearised), m */
    double rotation[3 * NEEDLE_MAX_SEGMENTS][NEEDLE_LD]; /* of the segments per unit force at each joint, rad/N */
    double compliance[NEEDLE_LD][NEEDLE_LD];    /* between joints, m/N: [3 i + a][3 j + b] */
} needle_tangent;

trocar_status needle_create(const needle_parameters *given, needle_model *model, report *why);

/* Straight, unloaded, held at `base`. */
void needle_rest(const needle_model *model, pose base, needle_state *state);

/* Moves the base only; the segments keep their orientation in space (the next solve bends them). */
void needle_hold(const needle_model *model, pose base, needle_state *state);

needle_point needle_at(const needle_model *model, const needle_state *state, double arc);

/* Linearises about the current shape under the joint forces `load` (N, segments + 1), which enter the geometric
   stiffness; compliance for joints >= first. RT */
void needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent);

/* Rotates the segments to the linearised equilibrium under `load`. Returns the largest rotation, rad. */
double needle_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state);

/* Elastic moment at the base in its present shape, world frame, N m: in equilibrium the loads' moment about the base. */
vec3 needle_root_moment(const needle_model *model, const needle_state *state);

double needle_energy(const needle_model *model, const needle_state *state); /* elastic, J */

#endif

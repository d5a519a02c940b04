/* The needle, clamped in the hand at its base: a centreline of segments, with the elasticity of one of two models.
   Base = arc 0, tip = arc `length`; axis along local +z. See README.md, "Needle".
   - rod: geometrically exact, inextensible Kirchhoff rod of rigid segments with elastic joints;
   - tetrahedra: solid of linear tetrahedra with quadratic strain, five nodes a section (needle_tets.c). */
#ifndef TROCAR_NEEDLE_H
#define TROCAR_NEEDLE_H

#include "needle/block_tridiagonal.h"
#include "base/report.h"
#include "base/vec.h"

enum {
    NEEDLE_MAX_SEGMENTS = TRIDIAGONAL_BLOCKS,
    NEEDLE_LD = 3 * (NEEDLE_MAX_SEGMENTS + 1),
    NEEDLE_RIM = 4,                         /* nodes of a section of the tetrahedra around its centre node */
    NEEDLE_SECTION = 1 + NEEDLE_RIM,
    NEEDLE_LAYER_TETS = 3 * NEEDLE_RIM,     /* tetrahedra between two sections */
};
_Static_assert(3 * NEEDLE_SECTION == TRIDIAGONAL_ROWS, "a section is one block of the tangent");

typedef enum { NEEDLE_ROD, NEEDLE_TETRAHEDRA } needle_choice;
typedef struct needle_kind needle_kind; /* needle_kind.h */

typedef struct {
    double length;           /* m */
    double outer_diameter;   /* m */
    double inner_diameter;   /* m */
    double youngs_modulus;   /* Pa */
    double poisson_ratio;
    double bevel_slope;      /* sideways cut per forward cut, away from the bevel's face (toward local -y) */
    int segments;            /* 2..NEEDLE_MAX_SEGMENTS */
    needle_choice kind;
} needle_parameters;

/* One of the tetrahedra between two sections, at rest. */
typedef struct {
    int nodes[4];            /* 0..NEEDLE_SECTION of the section below, then those of the section above; 0 is its centre */
    vec3 gradients[4];       /* of the shape functions, 1/m */
} layer_tet;

typedef struct {
    layer_tet layers[2][NEEDLE_LAYER_TETS]; /* between sections k and k + 1, for even and odd k: mirror images */
    vec3 rim[NEEDLE_RIM];    /* m, from the centre of a section at rest */
    double volume;           /* m^3, of each tetrahedron */
    double lambda, mu;       /* Pa, Lame's moduli after calibration */
    double calibration;      /* factor on Young's modulus that gives the rod's deflection under a small load on the tip */
} needle_solid;

typedef struct {
    needle_parameters given;
    const needle_kind *kind;
    double segment_length;   /* m */
    double radius;           /* m, outer */
    double bending;          /* EI, N m^2 */
    double torsion;          /* GJ, N m^2 */
    needle_solid solid;      /* of the tetrahedra */
} needle_model;

typedef struct {
    pose base;
    quat frames[NEEDLE_MAX_SEGMENTS];      /* orientation of each segment; its axis is local +z */
    vec3 joints[NEEDLE_MAX_SEGMENTS + 1];  /* m; joints[0] is the base, the last one the tip */
    vec3 rim[NEEDLE_MAX_SEGMENTS + 1][NEEDLE_RIM]; /* m; of the tetrahedra, whose centre nodes are the joints */
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
    int unstable;                               /* of the rod: ways in which it would give under these loads if nothing held it,
                                                   negative eigenvalues of the tangent stiffness; 0 of the tetrahedra */
    vec3 drift[NEEDLE_MAX_SEGMENTS + 1];        /* joints' displacement if all forces vanished (linearised), m */
    double compliance[NEEDLE_LD][NEEDLE_LD];    /* between joints, m/N: [3 i + a][3 j + b] */
    union {
        struct {
            mat3 pivot_inverse[NEEDLE_MAX_SEGMENTS];    /* block L D L^T of the tangent stiffness */
            mat3 lower[NEEDLE_MAX_SEGMENTS];
            vec3 moments[NEEDLE_MAX_SEGMENTS];          /* spatial moment of the joint before each segment, N m */
            double rotation[3 * NEEDLE_MAX_SEGMENTS][NEEDLE_LD]; /* of the segments per unit force at each joint, rad/N */
        } rod;
        struct {
            block_tridiagonal stiffness;                      /* of sections 1..segments, factored, N/m */
            vec3 internal[NEEDLE_MAX_SEGMENTS + 1][NEEDLE_SECTION]; /* force that holds each node in its place, N */
        } tets;
    };
} needle_tangent;

/* BAD_INPUT for values out of range, NO_MEMORY. Nothing to free. */
trocar_status needle_create(const needle_parameters *given, needle_model *model, report *why);

/* Straight, unloaded, held at `base`. RT */
void needle_rest(const needle_model *model, pose base, needle_state *state);

/* Moves the base and shifts the rest with it; the segments keep their orientation in space (the next solve bends them). RT */
void needle_hold(const needle_model *model, pose base, needle_state *state);

/* RT */
needle_point needle_at(const needle_model *model, const needle_state *state, double arc);

/* Unit vector along the centreline, toward the tip. RT */
static inline vec3 needle_along(const needle_point *p) { return v3(p->frame.m[0][2], p->frame.m[1][2], p->frame.m[2][2]); }

/* Linearises about the current shape under the joint forces `load` (N, segments + 1), which enter the rod's geometric
   stiffness (the tetrahedra have it from their stress); compliance for joints >= first. RT */
void needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent);

/* Moves the needle to the linearised equilibrium under `load`. Returns the largest rotation of a segment, rad. RT */
double needle_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state);

/* Elastic moment at the base in its present shape, world frame, N m: in equilibrium the loads' moment about the base. */
vec3 needle_root_moment(const needle_model *model, const needle_state *state);

double needle_energy(const needle_model *model, const needle_state *state); /* elastic, J */

#endif

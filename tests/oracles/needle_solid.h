/* The paper's needle: a solid of linear tetrahedra with quadratic strain and five nodes per section, for use on its own or in place of the library's rod in
   an insertion. */
#ifndef TROCAR_ORACLES_NEEDLE_SOLID_H
#define TROCAR_ORACLES_NEEDLE_SOLID_H

#include <stdbool.h>

#include "needle/needle.h"
#include "oracles/block_tridiagonal.h"

enum {
    SOLID_RIM = 4,           /* rim nodes of a section, around its centre node */
    SOLID_SECTION = 1 + SOLID_RIM,
    SOLID_LAYER_TETS = 3 * SOLID_RIM, /* tetrahedra between two sections */
};
_Static_assert(3 * SOLID_SECTION == TRIDIAGONAL_ROWS, "a section is one block of the tangent");

/* A tetrahedron between two sections, in the rest shape. */
typedef struct {
    int nodes[4];            /* 0..SOLID_SECTION for the lower section, followed by those of the upper section; 0 is the centre */
    vec3 gradients[4];       /* 1/m, of the shape functions */
} layer_tet;

typedef struct {
    layer_tet layers[2][SOLID_LAYER_TETS]; /* between sections k and k + 1, for even and for odd k, which are mirror images */
    vec3 rim[SOLID_RIM];     /* m, rim nodes relative to a section's centre in the rest shape */
    double volume;           /* m^3, of each tetrahedron */
    double lambda, mu;       /* Pa, Lame parameters after calibration */
    double calibration;      /* factor on Young's modulus with which the deflection under a small tip load equals the rod's */
} solid_mesh;

typedef struct {
    needle_model line;       /* the rod with the same parameters */
    solid_mesh solid;
} solid_model;

typedef struct {
    needle_state line;       /* the centre nodes are its joints; a segment's axis connects two of them, and its roll is the mean of its two end rims' rolls */
    vec3 rim[NEEDLE_MAX_SEGMENTS + 1][SOLID_RIM]; /* m */
} solid_state;

typedef struct {
    needle_tangent line;
    block_tridiagonal stiffness;                           /* N/m, of sections 1..segments, factorised */
    vec3 internal[NEEDLE_MAX_SEGMENTS + 1][SOLID_SECTION]; /* N, external force that keeps each node in place */
} solid_tangent;

/* These functions correspond to those of needle.h. */
trocar_status solid_create(const needle_parameters *given, solid_model *model, trocar_error *why);
void solid_rest(const solid_model *model, pose base, solid_state *state);
void solid_hold(const solid_model *model, pose base, solid_state *state);
void solid_linearise(const solid_model *model, const solid_state *state, const vec3 *load, int first, solid_tangent *tangent);
double solid_advance(const solid_model *model, const solid_tangent *tangent, const vec3 *load, solid_state *state);
vec3 solid_root_moment(const solid_model *model, const solid_state *state);
double solid_energy(const solid_model *model, const solid_state *state);

/* Replaces all of the program's needles with such solids, or with rods again if the argument is NULL. The linker must wrap the library's functions declared
   in needle.h: see needle_solid_wraps in CMakeLists.txt. Supports only one thread and no resting needles. */
void solid_in_tissue(const needle_parameters *given);

#endif

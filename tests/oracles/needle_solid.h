/* The paper's needle: a solid of linear tetrahedra with quadratic strain and five nodes per section, on its own or as a replacement for the library's
   rod in an insertion. */
#ifndef TROCAR_ORACLES_NEEDLE_SOLID_H
#define TROCAR_ORACLES_NEEDLE_SOLID_H

#include <stdbool.h>

#include "needle/needle.h"
#include "oracles/block_tridiagonal.h"

enum {
    SOLID_RIM = 4,           /* nodes of a section around its centre node */
    SOLID_SECTION = 1 + SOLID_RIM,
    SOLID_LAYER_TETS = 3 * SOLID_RIM, /* tetrahedra between two sections */
};
_Static_assert(3 * SOLID_SECTION == TRIDIAGONAL_ROWS, "a section is one block of the tangent");

/* One of the tetrahedra between two sections, at rest. */
typedef struct {
    int nodes[4];            /* 0..SOLID_SECTION of the section below, then those of the section above; 0 is its centre */
    vec3 gradients[4];       /* gradients of the shape functions, 1/m */
} layer_tet;

typedef struct {
    layer_tet layers[2][SOLID_LAYER_TETS]; /* between sections k and k + 1, for even and odd k: mirror images */
    vec3 rim[SOLID_RIM];     /* m, positions of the rim nodes relative to the centre of a section at rest */
    double volume;           /* m^3, volume of each tetrahedron */
    double lambda, mu;       /* Pa, Lame parameters after calibration */
    double calibration;      /* factor on Young's modulus with which the deflection under a small tip load equals the rod's */
} solid_mesh;

typedef struct {
    needle_model line;       /* the rod of the same parameters */
    solid_mesh solid;
} solid_model;

typedef struct {
    needle_state line;       /* centre nodes are its joints; a segment's axis is between them, its roll that of the rims at its ends */
    vec3 rim[NEEDLE_MAX_SEGMENTS + 1][SOLID_RIM]; /* m */
} solid_state;

typedef struct {
    needle_tangent line;
    block_tridiagonal stiffness;                           /* stiffness of sections 1..segments, factorised, N/m */
    vec3 internal[NEEDLE_MAX_SEGMENTS + 1][SOLID_SECTION]; /* external force that keeps each node in place, N */
} solid_tangent;

/* Functions like those of needle.h. */
trocar_status solid_create(const needle_parameters *given, solid_model *model, report *why);
void solid_rest(const solid_model *model, pose base, solid_state *state);
void solid_hold(const solid_model *model, pose base, solid_state *state);
void solid_linearise(const solid_model *model, const solid_state *state, const vec3 *load, int first, solid_tangent *tangent);
double solid_advance(const solid_model *model, const solid_tangent *tangent, const vec3 *load, solid_state *state);
vec3 solid_root_moment(const solid_model *model, const solid_state *state);
double solid_energy(const solid_model *model, const solid_state *state);

/* Makes all needles of the program such solids (NULL: rods again). This needs the library's functions of needle.h wrapped by the linker:
   needle_solid_wraps in CMakeLists.txt. For one thread; not for needles that rest. */
void solid_in_tissue(const needle_parameters *given);

#endif

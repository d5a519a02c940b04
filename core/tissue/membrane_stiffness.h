/* Membranes: named surfaces that are stiff in their plane, such as skin, capsules and fascia. On each face of the mesh, a membrane is a constant-strain
   triangle in plane stress. It is unstressed at rest, so to first order it does not resist displacement normal to its plane. See docs/mechanics.md,
   "Membranes". */
#ifndef TROCAR_MEMBRANE_STIFFNESS_H
#define TROCAR_MEMBRANE_STIFFNESS_H

#include "mesh/mesh.h"

/* In-plane elasticity of a membrane. The stiffness is 0 for a named surface without any. */
typedef struct {
    double stiffness;          /* N/m, Young's modulus times thickness */
    double poisson_ratio;      /* below 0.5 */
} membrane_material;

/* Computes the 9 x 9 stiffness of a triangle (node-major, 3 dofs per node), N/m. */
void triangle_stiffness(const vec3 corners[3], const membrane_material *material, double k[9][9]);

/* A face of the mesh with membranes on it. */
typedef struct {
    int nodes[3];
    double stiffness[9][9];  /* N/m, sum over all membranes on the face */
} membrane_face;

/* In the functions below, `materials` has an entry for each group of the mesh, of which only those of dimension 2 are used. NULL: no membranes. */

/* Computes the stiffness of the membranes on a face. Returns false if no membrane there has any. A face between two tetrahedra is reported only for the
   lower-numbered one. */
bool membrane_on_face(const mesh *m, const membrane_material *materials, int tet, int face, membrane_face *found);

/* Returns the number of faces with membranes. */
int membrane_face_count(const mesh *m, const membrane_material *materials);

/* Adds to a hash (base/hash.h) everything that the membranes contribute to K. Returns it unchanged if there are none. */
uint64_t membrane_hash(uint64_t h, const mesh *m, const membrane_material *materials);

#endif

/* Linear elastic tissue: materials by region, the sparse stiffness matrix K and its factor. */
#ifndef TROCAR_TISSUE_H
#define TROCAR_TISSUE_H

#include <suitesparse/cholmod.h>

#include "tissue/mesh.h"

/* What one region is made of. */
typedef struct {
    double youngs_modulus;     /* Pa */
    double poisson_ratio;      /* below 0.5 */
    double cutting_force;      /* N, resistance at the tip; INFINITY: bone, never cut */
    double cutting_viscosity;  /* N s/m, added resistance per tip speed */
    double friction_static;    /* N/m, shaft friction limit per length while stuck */
    double friction_kinetic;   /* N/m, the same after sliding on */
    double friction_viscous;   /* N s/m^2, added friction per length and sliding speed */
} region_material;

/* Where the volumetric strain's energy, lambda/2 (div u)^2, is taken. Linear tetrahedra lock when it is counted element by
   element (at nu = 0.45 a needle feels 10 to 15 % too much); averaged at the nodes, region by region, they do not
   (Bonet and Burton 1998). The rest of the energy, mu eps:eps, is taken element by element either way, which keeps K
   positive definite. */
typedef enum { STRAIN_BY_NODE, STRAIN_BY_ELEMENT } volumetric_strain;

typedef struct {
    const mesh *mesh;
    volumetric_strain volumetric;
    const region_material *materials; /* by group index; only the entries of dimension 3 count */
    bool *fixed;               /* node_count: held at zero displacement */
    int dof_count;             /* free displacements */
    int *dof;                  /* node_count: first of the node's three dofs, or -1 where fixed */
    cholmod_common common;     /* of the thread that owns the factor */
    cholmod_sparse *stiffness; /* K, dof_count square, lower triangle, N/m */
    cholmod_factor *factor;    /* supernodal Cholesky factor of K; NULL before tissue_factor */
    int *column;               /* dof_count / 3: where the three dofs from 3 i on stand in the factor */
} tissue;

/* Assembles K. `mesh` and `materials` must outlive the tissue. */
trocar_status tissue_assemble(const mesh *m, const region_material *materials, const bool *fixed, volumetric_strain volumetric,
                              tissue *t, report *why);

/* Factors K. These nodes are eliminated last: rows of the inverse between them then cost a small part of the factor.
   BAD_INPUT when the fixed nodes do not hold the body. There is no factor where it fails. */
trocar_status tissue_factor(tissue *t, int count, const int *nodes, report *why);

/* Both, in an order that favours no node: for tests. A simulation factors when it knows which nodes come last, or never. */
trocar_status tissue_create(const mesh *m, const region_material *materials, const bool *fixed, volumetric_strain volumetric,
                            tissue *t, report *why);
void tissue_free(tissue *t);

/* Moduli that give the part of an element's energy which is taken element by element. */
void element_moduli(const tissue *t, int tet, double *youngs_modulus, double *poisson_ratio);

/* 12 x 12 stiffness of a linear tetrahedron (node-major, 3 dofs a node), N/m. Zienkiewicz & Taylor, vol. 1. */
void tet_stiffness(const vec3 corners[4], double youngs_modulus, double poisson_ratio, double k[12][12]);

/* 3 x 3 block of the same for shape-function gradients ga, gb: V (lambda ga gb^T + mu gb ga^T + mu (ga.gb) I). */
mat3 stiffness_block(vec3 ga, vec3 gb, double volume, double youngs_modulus, double poisson_ratio);

#endif

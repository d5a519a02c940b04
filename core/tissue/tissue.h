/* Linear elastic tissue: the regions' materials, the sparse stiffness matrix K and its Cholesky factor. */
#ifndef TROCAR_TISSUE_H
#define TROCAR_TISSUE_H

#include <stdatomic.h>
#include <suitesparse/cholmod.h>

#include "mesh/mesh.h"
#include "tissue/membrane_stiffness.h"
#include "tissue/sliding_stiffness.h"

/* Material of a region. */
typedef struct {
    double youngs_modulus;     /* Pa */
    double poisson_ratio;      /* below 0.5 */
    double stiffening;         /* C20 / C10 of a Yeoh material; 0 if linear. Used only for the local compliance; K is linear */
    double cutting_force;      /* N, cutting resistance at the tip; INFINITY for bone, which cannot be cut */
    double cutting_viscosity;  /* N s/m, extra resistance per unit tip speed */
    double spreading_force;    /* N, resistance at the tip that remains along an open track */
    double friction_static;    /* N/m, friction limit per unit length of shaft while it sticks */
    double friction_kinetic;   /* N/m, friction limit per unit length of shaft after it has slid over the weakening distance */
    double friction_viscous;   /* N s/m^2, extra friction per unit length and unit sliding speed */
} region_material;

/* Sets the modulus and stiffening of `mixed` by interpolating between two tissues. `weight`: that of the second one, from 0 to 1. The compliance, and so 1 / E,
   is linear in the weight. RT */
void mix_moduli(const region_material *first, const region_material *second, double weight, region_material *mixed);

/* How the volumetric energy, lambda/2 (div u)^2, is integrated. If it is integrated element by element, linear tetrahedra lock (at nu = 0.45, needle forces are
   10 to 15 % too large). Averaging the volumetric strain prevents this. It can be averaged over disjoint patches of 8 tetrahedra of the same region (after the
   F-bar patches of de Souza Neto and others 2005), or at the nodes of each region (Bonet and Burton 1998), which couples a node with its neighbours' neighbours
   and makes large meshes expensive. The remaining energy, mu eps:eps, is always integrated element by element, which keeps K positive definite. */
typedef enum { STRAIN_BY_PATCH, STRAIN_BY_NODE, STRAIN_BY_ELEMENT } volumetric_strain;

typedef struct {
    const mesh *mesh;
    volumetric_strain volumetric;
    int *patch, patch_count;   /* [tet_count]: patch of each tetrahedron, see strain_patches.h; NULL if the strain is not averaged by patch */
    const region_material *materials; /* materials by group index; only those of dimension 3 are used */
    const membrane_material *membranes; /* MESH_MAX_GROUPS entries, by group index; only those of dimension 2 are used. NULL if there are no membranes. After
                                           tissue_define, the caller sets this before K is assembled */
    const sliding_material *sliding; /* the same for surfaces on which the tissue slides; NULL if the mesh has no pairs of nodes */
    bool *fixed;               /* [node_count]: whether the node is fixed (zero displacement) */
    int dof_count;             /* number of free displacements */
    int *dof;                  /* [node_count]: first of each node's three dofs, or -1 if the node is fixed */
    cholmod_common common;     /* workspace of the thread that owns the factor */
    cholmod_sparse *stiffness; /* K, N/m, dof_count x dof_count, lower triangle; NULL until tissue_stiffness is called */
    atomic_bool assembled;     /* K exists and is visible to all threads */
    cholmod_factor *factor;    /* supernodal Cholesky factor of K; NULL until tissue_factor is called */
    double refused;            /* bytes that the last tissue_factor needed, if it failed for lack of memory; otherwise 0 */
    int *column;               /* [dof_count / 3]: where dofs 3 i, 3 i + 1, 3 i + 2 are in the factor */
} tissue;

/* Defines everything except K and its factor. `mesh` and `materials` must outlive the tissue. */
trocar_status tissue_define(const mesh *m, const region_material *materials, const bool *fixed, volumetric_strain volumetric,
                            tissue *t, trocar_error *why);

/* Assembles K unless it is already assembled. */
trocar_status tissue_stiffness(tissue *t, trocar_error *why);

/* Calls tissue_define and tissue_stiffness. */
trocar_status tissue_assemble(const mesh *m, const region_material *materials, const bool *fixed, volumetric_strain volumetric,
                              tissue *t, trocar_error *why);

/* Factorises K, after assembling it if necessary. The given nodes are eliminated last, so that blocks of the inverse between them need only a small part of the
   factor. BAD_INPUT if the fixed nodes do not constrain the body, or if the factor exceeds the machine's memory or the range of CHOLMOD's indices. NO_MEMORY,
   before anything is computed, if too little memory is available at the moment. After an error, `factor` is NULL. */
trocar_status tissue_factor(tissue *t, int count, const int *nodes, trocar_error *why);

static const double LOOSE_BODY = 1e-13; /* fraction: the body counts as insufficiently constrained if the smallest eigenvalue of K is below this fraction of the
                                           largest. Rounding tolerance */

/* Reports in `why` that the fixed nodes do not constrain the body, and returns BAD_INPUT. */
trocar_status tissue_loose(trocar_error *why);

/* A load that is not orthogonal to any rigid-body motion; finds bodies that are not constrained. */
static inline double tissue_test_load(int dof) { return 1.0 + 0.37 * (dof % 7); }

/* Assembles and factorises K without choosing nodes to eliminate last; for tests. A simulation factorises only once it knows these nodes, or never. */
trocar_status tissue_create(const mesh *m, const region_material *materials, const bool *fixed, volumetric_strain volumetric,
                            tissue *t, trocar_error *why);
void tissue_free(tissue *t);

/* Copies what stays constant after tissue_define, for use while another thread computes K and its factor, which stay with the original. Nothing needs to be
   freed. The original must outlive the copy. */
tissue tissue_constants(const tissue *t);

/* Returns the elastic moduli for the part of the energy that is integrated by element. */
void element_moduli(const tissue *t, int tet, double *youngs_modulus, double *poisson_ratio);

/* Lists the means of div u that include this element, each with an equal part of its volume: that of its patch, or those of its nodes. Returns how many there
   are. Not for STRAIN_BY_ELEMENT. tissue_mean_count: number of all means. */
int tissue_means_of(const tissue *t, int tet, int means[4]);
int tissue_mean_count(const tissue *t);

/* Computes the 12 x 12 stiffness of a linear tetrahedron (node-major, 3 dofs per node), N/m. Zienkiewicz & Taylor, vol. 1. */
void tet_stiffness(const vec3 corners[4], double youngs_modulus, double poisson_ratio, double k[12][12]);

/* Returns the 3 x 3 block of an element's stiffness for the shape-function gradients ga, gb: V (lambda ga gb^T + mu gb ga^T + mu (ga.gb) I). */
mat3 stiffness_block(vec3 ga, vec3 gb, double volume, double youngs_modulus, double poisson_ratio);

#endif

/* Models: mesh, stiffness, inverse, needle and materials. Models are immutable, so threads can share them without locking. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_MODEL_H
#define TROCAR_PUBLIC_MODEL_H

#include "trocar/scene.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct trocar_model trocar_model;

/* ---- creation ---- */

typedef struct trocar_model_options {
    trocar_watch watch;      /* its functions must not wait for another model to be created. Mesh reading and matrix factorisation cannot be
                                interrupted */
    trocar_log log;          /* used by this model, its simulations and all models derived from it, until the last of them is freed */
    int max_substeps;    /* a tick longer than 1 ms is divided into 1 ms steps, but at most this many; 0 selects the default, 4 */
    int mesh_only;           /* 1: only read and check the mesh and its names, as a viewer needs; no simulation can be created */
    int keep_inverse;        /* 1: if a condensed inverse could not be saved in the cache, fail (SYSTEM) before computing it */
} trocar_model_options;

/* Returns the defaults: no callbacks, at most 4 steps per tick, and a complete model. [any, RT] */
TROCAR_API trocar_model_options trocar_default_model_options(void);

/* Builds a model. This takes seconds to minutes. `options` may be NULL; the scene is not needed afterwards. Limits OpenBLAS to one thread in the whole
   process. Meshes in formats other than MSH 2.2 and 4.1 are read by Gmsh: if the host also uses Gmsh, call this from the same thread. BAD_INPUT, NO_MEMORY,
   NUMERIC, SYSTEM, CANCELLED. [any, allocates] */
TROCAR_API trocar_status trocar_model_create(const trocar_scene *scene, const trocar_model_options *options, trocar_model **model,
                                             trocar_error *error);

/* Builds a model that shares the mesh, stiffness and inverse of `base`. This takes only milliseconds. BAD_INPUT if the mesh came from arrays, or if the
   scenes differ in a key that affects the shared parts (the message names it); NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_model_derive(const trocar_model *base, const trocar_scene *scene, trocar_model **model, trocar_error *error);

/* Frees a model. Its memory is released once no simulation, picture or derived model uses it any more. [any] */
TROCAR_API void trocar_model_free(trocar_model *model);

/* Computes the factorisation for contacts outside the region covered by a condensed inverse, so that it need not be computed on first use. On a large mesh,
   this takes a minute and gigabytes of memory. NO_MEMORY, NUMERIC. [any, allocates] */
TROCAR_API trocar_status trocar_model_prepare(trocar_model *model, trocar_error *error);

/* ---- facts; strings and arrays belong to the model [any, RT] ---- */

TROCAR_API const char *trocar_model_inverse(const trocar_model *model);        /* "dense", "sparse" or "condensed"; empty with mesh_only */
TROCAR_API const char *trocar_model_description(const trocar_model *model);    /* which inverse was chosen, and why */
TROCAR_API const char *trocar_model_remarks(const trocar_model *model);        /* repairs made to the mesh, and suspected errors in it; empty if there are
                                                                                  none */
TROCAR_API int trocar_model_unknowns(const trocar_model *model);               /* number of unknowns: three per free node */
TROCAR_API int trocar_model_needles(const trocar_model *model);                /* number of needles in the scene */
TROCAR_API int trocar_model_segments(const trocar_model *model);               /* number of needle segments; there is one more joint than segments */
TROCAR_API double trocar_model_needle_length(const trocar_model *model);       /* m */
TROCAR_API double trocar_model_rate(const trocar_model *model);                /* Hz, rate of the haptic loop: the scene's rate_hz */

/* Gets the pose of the first needle's base before insertion, from the keys "needle.start.". Returns 1, or 0 without writing if the scene gives none. */
TROCAR_API int trocar_model_start(const trocar_model *model, trocar_pose *start);

/* Gets the transform from patient coordinates (DICOM: mm to the left, back and head) to mesh coordinates (m), from the key "patient_to_mesh", as a row-major
   matrix. Its upper left 3 x 3 block is a rotation times 1e-3. Returns 1, or 0 without writing if the scene gives none. */
TROCAR_API int trocar_model_patient_to_mesh(const trocar_model *model, double matrix[16]);

/* ---- mesh at rest; its named groups are called regions, with dimension 3 for volumes, 2 for surfaces, 1 for curves, 0 for points [any, RT] ---- */

TROCAR_API int trocar_model_node_count(const trocar_model *model);
TROCAR_API int trocar_model_tet_count(const trocar_model *model);
TROCAR_API const double *trocar_model_nodes(const trocar_model *model);        /* [node_count][3], m */
TROCAR_API const int32_t *trocar_model_tets(const trocar_model *model);        /* [tet_count][4], node indices; all volumes are positive */
TROCAR_API const int32_t *trocar_model_neighbours(const trocar_model *model);  /* [tet_count][4]: tetrahedron across the face opposite each corner; -1 if there
                                                                                  is none */
TROCAR_API const int32_t *trocar_model_tet_regions(const trocar_model *model); /* [tet_count]: index of the region that contains each tetrahedron */
TROCAR_API const uint32_t *trocar_model_face_surfaces(const trocar_model *model); /* [tet_count][4]: bit i is set if the face opposite the corner lies on
                                                                                     surface i */
TROCAR_API const uint8_t *trocar_model_fixed(const trocar_model *model);       /* [node_count]: 1 if the node is fixed; NULL with mesh_only */
TROCAR_API int trocar_model_region_count(const trocar_model *model);           /* number of regions of any dimension, at most 32 */
TROCAR_API const char *trocar_model_region_name(const trocar_model *model, int index); /* "" if out of range */
TROCAR_API int trocar_model_region_dimension(const trocar_model *model, int index);    /* -1 if out of range */
TROCAR_API int trocar_model_find_region(const trocar_model *model, const char *name, int dimension); /* index, or -1 */

/* Returns the index of the volume that this region is part of (key "regions[].part_of"), its own index if it is not part of another, or -1 if `index` is out
   of range. The organ with a region's name consists of that region and its parts. */
TROCAR_API int trocar_model_part_of(const trocar_model *model, int index);

/* Finds where the line segment between two points (m) first enters the tissue at rest. Returns 1 and writes the point, or returns 0 if it never enters. */
TROCAR_API int trocar_model_entry(const trocar_model *model, const double from[3], const double to[3], double point[3]);

/* Returns 1 if volumetric strains are averaged around nodes (key "volumetric_strain"), otherwise 0. */
TROCAR_API int trocar_model_averages_strain(const trocar_model *model);

/* Returns, for each of the tet_count tetrahedra, the index of the patch over which its volumetric strain is averaged; NULL if strains are not averaged over
   patches, or with mesh_only. */
TROCAR_API const int32_t *trocar_model_strain_patches(const trocar_model *model);

/* ---- materials and guides ---- */

/* Material of a volume, from the keys "regions[]." of the same name. */
typedef struct trocar_material {
    double youngs_modulus;    /* Pa */
    double poisson_ratio;
    double cutting_force;     /* N; INFINITY for bone */
    double cutting_viscosity; /* N s/m */
    double friction_static;   /* N/m */
    double friction_kinetic;  /* N/m */
    double friction_viscous;  /* N s/m^2 */
    double spreading_force;   /* N */
    double stiffening;        /* C20 / C10 of a Yeoh material */
} trocar_material;
TROCAR_API trocar_material trocar_model_material(const trocar_model *model, int region); /* all members are 0 if the region is not a volume. [any, RT] */

/* In-plane elasticity of a surface, from the keys "membranes[]." of the same name. */
typedef struct trocar_membrane {
    double stiffness;         /* N/m, Young's modulus times thickness; 0 if the surface resists puncture only */
    double poisson_ratio;
} trocar_membrane;
TROCAR_API trocar_membrane trocar_model_membrane(const trocar_model *model, int region); /* all members are 0 if the region is not a membrane. [any, RT] */

/* A guide, from the key "guides[]". Columns and rows are counted from 0. On the front face, the axis of hole (column, row) is at origin + (column -
   (columns - 1) / 2) spacing across[0] + (row - (rows - 1) / 2) spacing across[1]. */
typedef struct trocar_guide {
    double origin[3];        /* m, centre of the hole grid on the front face */
    double normal[3];        /* unit vector through the plate, in the direction of insertion */
    double across[2][3];     /* unit vectors along which columns and rows are counted, perpendicular to each other and to the normal; with the normal, they
                                may form a left-handed system */
    double spacing;          /* m */
    double hole_diameter;    /* m */
    double thickness;        /* m */
    int32_t columns, rows;
} trocar_guide;
TROCAR_API int trocar_model_guide_count(const trocar_model *model);                /* [any, RT] */
TROCAR_API trocar_guide trocar_model_guide(const trocar_model *model, int index);  /* all members are 0 if the index is out of range. [any, RT] */

#ifdef __cplusplus
}
#endif
#endif

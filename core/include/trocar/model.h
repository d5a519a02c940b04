/* Models: mesh, stiffness, inverse, needle and materials. Constant, and shared by threads without a lock. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_MODEL_H
#define TROCAR_PUBLIC_MODEL_H

#include "trocar/scene.h"

#ifdef __cplusplus
extern "C" {
#endif

typedef struct trocar_model trocar_model;

/* ---- creation ---- */

typedef struct trocar_model_options {
    trocar_watch watch;      /* must not wait for another model to be created. Reading a mesh and factorising are not interrupted */
    trocar_log log;          /* of this model, its simulations and models derived from it; kept until the last of them is freed */
    int max_substeps;    /* a long tick is divided into steps of 1 ms, but at most this many; 0: the default */
    int mesh_only;           /* 1: only reads and checks the mesh and the names in it, for viewers; no simulation can be created */
    int keep_inverse;        /* 1: fail (SYSTEM), before a condensed inverse is computed, if it cannot be saved in the cache */
} trocar_model_options;

/* No callbacks, 4 steps, everything built. [any, RT] */
TROCAR_API trocar_model_options trocar_default_model_options(void);

/* Builds everything: seconds to minutes. `options` may be NULL; the scene is not needed afterwards. Sets OpenBLAS to one thread for the process. From
   one thread if Gmsh reads the mesh (not MSH 2.2 or 4.1) and the host uses it, too. BAD_INPUT, NO_MEMORY, NUMERIC, SYSTEM, CANCELLED. [any, allocates] */
TROCAR_API trocar_status trocar_model_create(const trocar_scene *scene, const trocar_model_options *options, trocar_model **model,
                                             trocar_error *error);

/* Builds a model that shares mesh, stiffness and inverse with `base`: milliseconds. BAD_INPUT, with the key, if the scenes differ in what these depend
   on, and for meshes from arrays; NO_MEMORY. [any, allocates] */
TROCAR_API trocar_status trocar_model_derive(const trocar_model *base, const trocar_scene *scene, trocar_model **model, trocar_error *error);

/* Memory is released with the last simulation, picture or derived model that uses it. [any] */
TROCAR_API void trocar_model_free(trocar_model *model);

/* Computes now what would otherwise be computed on first use: the factor for contacts outside a condensed inverse's region, a minute and gigabytes on a
   large mesh. NO_MEMORY, NUMERIC. [any, allocates] */
TROCAR_API trocar_status trocar_model_prepare(trocar_model *model, trocar_error *error);

/* ---- facts; strings and arrays belong to the model [any, RT] ---- */

TROCAR_API const char *trocar_model_inverse(const trocar_model *model);        /* "dense", "sparse" or "condensed"; "" with mesh_only */
TROCAR_API const char *trocar_model_description(const trocar_model *model);    /* which inverse was chosen, and why */
TROCAR_API const char *trocar_model_remarks(const trocar_model *model);        /* repairs of the mesh, suspected errors in it; "": none */
TROCAR_API int trocar_model_unknowns(const trocar_model *model);               /* three per free node */
TROCAR_API int trocar_model_needles(const trocar_model *model);                /* number of needles of the scene */
TROCAR_API int trocar_model_segments(const trocar_model *model);               /* of the needle, which has one joint more */
TROCAR_API double trocar_model_needle_length(const trocar_model *model);       /* m */
TROCAR_API double trocar_model_rate(const trocar_model *model);                /* Hz, rate_hz of the scene */

/* The pose of the first needle's base before the insertion: the keys "needle.start.". Returns 1 and the pose, or 0 if there is none. */
TROCAR_API int trocar_model_start(const trocar_model *model, trocar_pose *start);

/* The key "patient_to_mesh", row by row: from the patient's coordinates (DICOM: mm to the left, back and head) to the mesh's (m); its upper left 3 x 3
   is a rotation times 1e-3. Returns 1 and the matrix, or 0 if there is none. */
TROCAR_API int trocar_model_patient_to_mesh(const trocar_model *model, double matrix[16]);

/* ---- mesh at rest; its named groups, called regions, have a dimension: 3 for volumes, 2 for surfaces, 1 for curves, 0 for points [any, RT] ---- */

TROCAR_API int trocar_model_node_count(const trocar_model *model);
TROCAR_API int trocar_model_tet_count(const trocar_model *model);
TROCAR_API const double *trocar_model_nodes(const trocar_model *model);        /* 3 node_count, m */
TROCAR_API const int32_t *trocar_model_tets(const trocar_model *model);        /* 4 tet_count, positive volume */
TROCAR_API const int32_t *trocar_model_neighbours(const trocar_model *model);  /* 4 tet_count: across the face opposite each corner, -1: none */
TROCAR_API const int32_t *trocar_model_tet_regions(const trocar_model *model); /* tet_count: index of the volume */
TROCAR_API const uint32_t *trocar_model_face_surfaces(const trocar_model *model); /* 4 tet_count: bit i: the face lies on surface i */
TROCAR_API const uint8_t *trocar_model_fixed(const trocar_model *model);       /* node_count: 1: held at 0; NULL with mesh_only */
TROCAR_API int trocar_model_region_count(const trocar_model *model);           /* of any dimension, at most 32 */
TROCAR_API const char *trocar_model_region_name(const trocar_model *model, int index); /* "" if out of range */
TROCAR_API int trocar_model_region_dimension(const trocar_model *model, int index);    /* -1 if out of range */
TROCAR_API int trocar_model_find_region(const trocar_model *model, const char *name, int dimension); /* index, or -1 */

/* Finds where the segment between two points (m) first enters the tissue at rest. Returns 1 and the point, or 0 if it never does. */
TROCAR_API int trocar_model_entry(const trocar_model *model, const double from[3], const double to[3], double point[3]);

/* 1 if volumetric strains are averaged around nodes (key "volumetric_strain"), else 0. */
TROCAR_API int trocar_model_averages_strain(const trocar_model *model);

/* tet_count numbers, from 0, of the patches over which volumetric strains are averaged; NULL if they are not, and with mesh_only. */
TROCAR_API const int32_t *trocar_model_strain_patches(const trocar_model *model);

/* ---- materials and guides ---- */

/* Material of a volume: the keys "regions[]." of the same name. */
typedef struct trocar_material {
    double youngs_modulus;    /* Pa */
    double poisson_ratio;
    double cutting_force;     /* N; INFINITY: bone */
    double cutting_viscosity; /* N s/m */
    double friction_static;   /* N/m */
    double friction_kinetic;  /* N/m */
    double friction_viscous;  /* N s/m^2 */
    double spreading_force;   /* N */
    double stiffening;        /* C20 / C10 of a Yeoh material */
} trocar_material;
TROCAR_API trocar_material trocar_model_material(const trocar_model *model, int region); /* all zero if it is not a volume. [any, RT] */

/* A guide, the key "guides[]". Hole (column, row), counted from 0, has its axis at origin + (column - (columns - 1) / 2) spacing across[0] +
   (row - (rows - 1) / 2) spacing across[1] on the front face. */
typedef struct trocar_guide {
    double origin[3];        /* m, middle of the holes on the front face */
    double normal[3];        /* unit vectors: through the plate, */
    double across[2][3];     /* along columns, and along rows, perpendicular to each other; with the normal, right- or left-handed */
    double spacing;          /* m */
    double hole_diameter;    /* m */
    double thickness;        /* m */
    int32_t columns, rows;
} trocar_guide;
TROCAR_API int trocar_model_guide_count(const trocar_model *model);                /* [any, RT] */
TROCAR_API trocar_guide trocar_model_guide(const trocar_model *model, int index);  /* all zero if out of range. [any, RT] */

#ifdef __cplusplus
}
#endif
#endif

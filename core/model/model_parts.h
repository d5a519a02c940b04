/* All constant data of a simulation, built from one configuration and owned by one struct. */
#ifndef TROCAR_MODEL_PARTS_H
#define TROCAR_MODEL_PARTS_H

#include "insertion/step/tick.h"
#include "scene/simulation_config.h"

typedef struct {
    simulation_config config;
    bool shares;                        /* the mesh belongs to another model, which frees it; so do the tissue and inverse, unless `stiffened` */
    bool stiffened;                     /* tissue and inverse are this model's own, although the mesh is shared */
    mesh mesh;
    region_material materials[MESH_MAX_GROUPS];
    membrane_material membrane_materials[MESH_MAX_GROUPS]; /* membranes' elasticity, indexed by group; the stiffness is 0 for surfaces that are not membranes */
    int wholes[MESH_MAX_GROUPS];        /* for each group, the group of which it is a part (key `part_of`), or its own index */
    membrane membranes[MAX_MEMBRANES];
    guide guides[MAX_GUIDES];
    int probe_surface;                  /* index of the probe's surface among the groups; -1 if there is no probe */
    tissue tissue;
    inverse *inverse;
    trocar_error about_inverse;         /* the kind of inverse that was chosen, and the reason for the choice */
    needle_model needle;
    insertion_model insertion;
} model_parts;

/* Reads the mesh and looks up the scene's names in it; the other members stay empty. After a failure, everything has been freed. */
trocar_status model_parts_create_mesh(const simulation_config *config, model_parts *s, trocar_error *why);

/* Reads the mesh and builds all constant data. After a failure, everything has been freed and `why` is set. */
trocar_status model_parts_create(const simulation_config *config, model_parts *s, trocar_error *why);

/* Builds the constant data for a configuration with the same mesh and stiffness as `base`; shares the mesh, tissue and inverse of `base`, which must
   outlive it. Returns BAD_INPUT, naming the key, if the stiffness or inverse would differ, or if the mesh was given as arrays. */
trocar_status model_parts_derive(const model_parts *base, const simulation_config *config, model_parts *s, trocar_error *why);

/* True if two configurations of the same mesh have the same moduli, as listed by simulation_moduli. */
bool same_elasticity(const simulation_config *a, const simulation_config *b);

/* Builds the constant data for a configuration that differs from that of `base` only in moduli (same_elasticity). Shares the mesh of `base` and, if K is the
   same, also its tissue and inverse; `base` must outlive it. */
trocar_status model_parts_stiffen(const model_parts *base, const simulation_config *config, model_parts *s, trocar_error *why);

void model_parts_free(model_parts *s);

/* Computes the displacements (m) of the mesh's nodes (`nominal`, node_count entries) and of the contact nodes as listed by insertion_refinement() (`added`,
   MAX_CONTACTS entries). On entry, `nominal` holds the nodal forces (N) of all other loads on the tissue. `scratch` has model_parts_field_scratch() entries;
   each thread needs its own. Does not allocate memory; not for the haptic thread. */
size_t model_parts_field_scratch(const model_parts *s);
void model_parts_field(const model_parts *s, inverse *inv, const insertion_state *state, vec3 *scratch, vec3 *nominal, vec3 *added);

#endif

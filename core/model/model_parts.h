/* All the constant data of a simulation, in one struct. */
#ifndef TROCAR_MODEL_PARTS_H
#define TROCAR_MODEL_PARTS_H

#include "insertion/step/tick.h"
#include "scene/simulation_config.h"

typedef struct {
    simulation_config config;
    bool shares;                        /* true if another model owns the mesh and, unless `stiffened`, the tissue and inverse */
    bool stiffened;                     /* true if the mesh is shared but the tissue and inverse are this model's own */
    mesh mesh;
    region_material materials[MESH_MAX_GROUPS];
    sliding_material sliding_materials[MESH_MAX_GROUPS]; /* by group; used only for surfaces on which the tissue slides */
    membrane_material membrane_materials[MESH_MAX_GROUPS]; /* membrane elasticity by group; the stiffness is 0 for surfaces that are not membranes */
    int wholes[MESH_MAX_GROUPS];        /* for each group, the group that it is part of (key `part_of`), or its own index */
    membrane membranes[MAX_MEMBRANES];
    guide guides[MAX_GUIDES];
    int probe_surface;                  /* index of the probe's surface among the groups; -1 if there is no probe */
    tissue tissue;
    inverse *inverse;
    trocar_error about_inverse;         /* which kind of inverse was chosen, and why */
    needle_model needle;
    insertion_model insertion;
} model_parts;

/* Reads the mesh and looks up the scene's names in it; the other members stay empty. On failure, frees everything. */
trocar_status model_parts_create_mesh(const simulation_config *config, model_parts *s, trocar_error *why);

/* Reads the mesh and builds all the constant data. On failure, frees everything. */
trocar_status model_parts_create(const simulation_config *config, model_parts *s, trocar_error *why);

/* Builds the constant data for a configuration with the same mesh and stiffness as `base`. The result shares the mesh, tissue and inverse of `base`, which
   must outlive it. BAD_INPUT if the stiffness or inverse would differ (the message names the key), or if the mesh was given as arrays. */
trocar_status model_parts_derive(const model_parts *base, const simulation_config *config, model_parts *s, trocar_error *why);

/* True if two configurations of the same mesh have the same moduli, as listed by simulation_moduli. */
bool same_elasticity(const simulation_config *a, const simulation_config *b);

/* Builds the constant data for a configuration that differs from that of `base` only in moduli (same_elasticity). The result shares the mesh of `base` and, if
   K is the same, its tissue and inverse; `base` must outlive it. */
trocar_status model_parts_stiffen(const model_parts *base, const simulation_config *config, model_parts *s, trocar_error *why);

void model_parts_free(model_parts *s);

/* Computes the displacements (m) of the mesh nodes (`nominal`, node_count entries) and of the contact nodes, in the order of insertion_refinement() (`added`,
   MAX_CONTACTS entries). On entry, `nominal` holds the nodal forces (N) of all other loads on the tissue. `scratch` has model_parts_field_scratch() entries;
   each thread needs its own. Allocates no memory, but is too slow for the haptic thread. */
size_t model_parts_field_scratch(const model_parts *s);
void model_parts_field(const model_parts *s, inverse *inv, const insertion_state *state, vec3 *scratch, vec3 *nominal, vec3 *added);

#endif

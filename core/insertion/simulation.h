/* All that is constant in a simulation, built from one configuration and owned by one struct. */
#ifndef TROCAR_SIMULATION_H
#define TROCAR_SIMULATION_H

#include "condensed/inverse_choice.h"
#include "insertion/seeds.h"
#include "insertion/step/insertion.h"
#include "mesh/region_of_interest.h"
#include "probe/probe.h"
#include "remesh/remesh.h"

typedef struct { char name[MESH_NAME]; region_material material; } region_config;
typedef struct { char name[MESH_NAME]; double puncture_force; } membrane_config;

typedef struct {
    char surface[MESH_NAME]; /* that it presses; empty: there is no probe */
    probe_shape shape;
    double max_force;        /* N, where it stops */
    pose start;              /* of its base; its position is NAN: nowhere until it is told */
    int surface_line, start_line; /* of these keys in the scene file, for messages; 0: none */
} probe_config;

enum { MAX_REGIONS = 16, MAX_MEMBRANES = 16, MAX_FIXED = 8 };

typedef struct {
    const char *scene_path;              /* for messages, while the model is created; NULL where nothing has a line */
    char mesh_path[1024];
    const trocar_mesh *mesh_given;      /* in place of a file; NULL: there is a path */
    double mesh_unit;                    /* m: what a coordinate of 1 in that file means */
    int region_count;   region_config regions[MAX_REGIONS];
    int membrane_count; membrane_config membranes[MAX_MEMBRANES];
    int fixed_count;    char fixed[MAX_FIXED][MESH_NAME];   /* groups of any dimension held at zero displacement */
    int guide_count;    guide_config guides[MAX_GUIDES];
    int relaxation_count; relaxation_term relaxation[MAX_RELAXATION]; /* of all regions; none: elastic */
    needle_parameters needle;
    int needle_count;                    /* in the same tissue, all alike; 1 .. MAX_NEEDLES */
    seed_size seeds;
    insertion_settings insertion;
    remesh_method remeshing;
    inverse_choice inverse;
    inverse_precision precision;
    probe_config probe;
    roi_config roi;                  /* region of interest; nothing given: see roi_find */
    char cache[1024];                    /* directory of condensed inverses; empty: the user's */
    bool keep_inverse;                   /* a condensed inverse that cannot be saved there is an error */
    volumetric_strain volumetric;
    inverse_progress progress;           /* told how far a long start has come; its function may be NULL */
} simulation_config;

typedef struct {
    simulation_config config;
    bool shares;                        /* mesh, tissue and inverse are those of another simulation, which frees them */
    mesh mesh;
    region_material materials[MESH_MAX_GROUPS];
    membrane membranes[MAX_MEMBRANES];
    guide guides[MAX_GUIDES];
    int probe_surface;                  /* group, -1: there is no probe */
    tissue tissue;
    inverse *inverse;
    report about_inverse;               /* which owner, and why */
    needle_model needle;
    insertion_model insertion;
} simulation;

/* Defaults of docs/reference/scene.md; names and mesh are empty. */
void simulation_defaults(simulation_config *config);
region_material region_defaults(void);

/* Reads the mesh and finds the scene's names in it; the rest stays empty. On failure everything is freed. */
trocar_status simulation_create_mesh(const simulation_config *config, simulation *s, report *why);

/* Reads the mesh and builds all that is constant, or frees everything and says why. */
trocar_status simulation_create_model(const simulation_config *config, simulation *s, report *why);

/* Builds what is constant for a configuration with the same mesh and stiffness as `base`, and shares its mesh, tissue and inverse. `base`
   must outlive it. BAD_INPUT, with the key, if the stiffness or the inverse would be another one, and for a mesh that came as arrays. */
trocar_status simulation_derive(const simulation *base, const simulation_config *config, simulation *s, report *why);

void simulation_free(simulation *s);

/* Displacement of the nominal nodes (node_count) and of the nodes of insertion_refinement() (MAX_CONTACTS), m. `scratch` has
   simulation_field_scratch entries: from several threads, each with its own. `nominal` holds the forces of what else
   loads the tissue, N, on its nodes. Allocates nothing; not for the haptic thread. */
size_t simulation_field_scratch(const simulation *s);
void simulation_field(simulation *s, const insertion_state *state, vec3 *scratch, vec3 *nominal, vec3 *added);

#endif

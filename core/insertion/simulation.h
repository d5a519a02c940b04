/* All constant data of a simulation, built from one configuration and owned by one struct. */
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
    char surface[MESH_NAME]; /* surface that the probe presses; empty: there is no probe */
    probe_shape shape;
    double max_force;        /* N, force at which the probe stops */
    pose start;              /* initial pose of its base; the position is NAN until a pose is given */
    int surface_line, start_line; /* lines of these keys in the scene file, for messages; 0: none */
} probe_config;

enum { MAX_REGIONS = 16, MAX_MEMBRANES = 16, MAX_FIXED = 8 };

typedef struct {
    const char *scene_path;              /* used in messages while the model is created; NULL: the configuration is not from a file */
    char mesh_path[1024];
    const trocar_mesh *mesh_given;      /* used instead of a file; NULL: there is a path */
    double mesh_unit;                    /* m, length of one unit of the file's coordinates */
    int region_count;   region_config regions[MAX_REGIONS];
    int membrane_count; membrane_config membranes[MAX_MEMBRANES];
    int fixed_count;    char fixed[MAX_FIXED][MESH_NAME];   /* groups of any dimension with zero displacement */
    int guide_count;    guide_config guides[MAX_GUIDES];
    int relaxation_count; relaxation_term relaxation[MAX_RELAXATION]; /* the same for all regions; none: elastic */
    needle_parameters needle;
    int needle_count;                    /* identical needles in the same tissue, 1 .. MAX_NEEDLES */
    seed_size seeds;
    insertion_settings insertion;
    remesh_method remeshing;
    inverse_choice inverse;
    inverse_precision precision;
    probe_config probe;
    roi_config roi;                  /* region of interest; if empty, see roi_find */
    char cache[1024];                    /* directory of condensed inverses; empty: the user's cache directory */
    bool keep_inverse;                   /* failure to save a condensed inverse in `cache` is an error */
    volumetric_strain volumetric;
    inverse_progress progress;           /* reports the progress of a long start; its function may be NULL */
} simulation_config;

typedef struct {
    simulation_config config;
    bool shares;                        /* mesh, tissue and inverse belong to another simulation, which frees them */
    mesh mesh;
    region_material materials[MESH_MAX_GROUPS];
    membrane membranes[MAX_MEMBRANES];
    guide guides[MAX_GUIDES];
    int probe_surface;                  /* group index; -1: there is no probe */
    tissue tissue;
    inverse *inverse;
    report about_inverse;               /* name of the chosen owner, and the reason for the choice */
    needle_model needle;
    insertion_model insertion;
} simulation;

/* Defaults as in docs/reference/scene.md; names and mesh are empty. */
void simulation_defaults(simulation_config *config);
region_material region_defaults(void);

/* Reads the mesh and looks up the scene's names in it; the other members stay empty. Frees everything on failure. */
trocar_status simulation_create_mesh(const simulation_config *config, simulation *s, report *why);

/* Reads the mesh and builds all constant data. On failure, frees everything and sets `why`. */
trocar_status simulation_create_model(const simulation_config *config, simulation *s, report *why);

/* Builds the constant data for a configuration with the same mesh and stiffness as `base`, and shares its mesh, tissue and inverse. `base` must outlive it.
   BAD_INPUT, with the key, if stiffness or inverse would differ, or if the mesh was given as arrays. */
trocar_status simulation_derive(const simulation *base, const simulation_config *config, simulation *s, report *why);

void simulation_free(simulation *s);

/* Displacements of the nominal nodes (node_count) and of the nodes of insertion_refinement() (MAX_CONTACTS), m. `scratch` has simulation_field_scratch
   entries, one array for each thread. On entry, `nominal` holds the nodal forces of all other loads on the tissue, N. Allocates nothing; not for the haptic
   thread. */
size_t simulation_field_scratch(const simulation *s);
void simulation_field(simulation *s, const insertion_state *state, vec3 *scratch, vec3 *nominal, vec3 *added);

#endif

/* The configuration of a simulation. The model is built from it. */
#ifndef TROCAR_SIMULATION_CONFIG_H
#define TROCAR_SIMULATION_CONFIG_H

#include "condensed/inverse_choice.h"
#include "insertion/model/insertion_model.h"
#include "insertion/seeds.h"
#include "mesh/region_of_interest.h"
#include "probe/probe.h"
#include "remesh/remesh.h"

typedef struct {
    char name[MESH_NAME], part_of[MESH_NAME]; /* `part_of`: name of the region that stands for the organ which this region is part of; empty if none */
    region_material material;
} region_config;
typedef struct {
    char name[MESH_NAME];
    double puncture_force;   /* N */
    membrane_material material;
} membrane_config;

typedef struct {
    char name[MESH_NAME], beside[MESH_NAME]; /* `beside`: the region on one side of the faces on which the tissue slides; empty for all faces between regions */
    sliding_material material;
} sliding_config;

typedef struct {
    char surface[MESH_NAME]; /* the surface that the probe presses on; empty if there is no probe */
    probe_shape shape;
    double max_force;        /* N, the probe stops at this force */
    pose start;              /* initial pose of the probe's base; the position is NAN if not given */
    int surface_line, start_line; /* lines of `surface` and `start` in the scene file, for messages; 0 if not from a file */
} probe_config;

enum { MAX_REGIONS = 32, MAX_MEMBRANES = 32, MAX_SLIDING = 16, MAX_CALCIFICATIONS = 64, MAX_FIXED = 8 };

typedef struct {
    const char *scene_path;              /* file to name in messages while the model is created; NULL if there is none */
    char mesh_path[1024];
    const trocar_mesh *mesh_given;      /* a mesh to use instead of a file; NULL to read the file */
    double mesh_unit;                    /* m, length of one unit of the mesh file's coordinates */
    int region_count;   region_config regions[MAX_REGIONS];
    int membrane_count; membrane_config membranes[MAX_MEMBRANES];
    int sliding_count;  sliding_config sliding[MAX_SLIDING];
    int calcification_count; calcification calcifications[MAX_CALCIFICATIONS];
    int fixed_count;    char fixed[MAX_FIXED][MESH_NAME];   /* mesh groups of any dimension whose nodes do not move */
    int guide_count;    guide_config guides[MAX_GUIDES];
    int relaxation_count; relaxation_term relaxation[MAX_RELAXATION]; /* relaxation series, the same for all regions; with no terms, the tissue is elastic */
    needle_parameters needle;
    int needle_count;                    /* how many identical needles there are in the tissue, 1 to MAX_NEEDLES */
    seed_size seeds;
    insertion_settings insertion;
    inverse_choice inverse;
    inverse_precision precision;
    probe_config probe;
    roi_config roi;                  /* region of interest; if empty, roi_find chooses one */
    char cache[1024];                    /* directory for condensed inverses; if empty, the user's cache directory */
    bool keep_inverse;                   /* fail if a condensed inverse cannot be saved in `cache` */
    volumetric_strain volumetric;
    inverse_progress progress;           /* reports the progress of a long start; its function may be NULL */
} simulation_config;

/* Set the defaults listed in docs/reference/scene.csv. Names and mesh are left empty. */
void simulation_defaults(simulation_config *config);
region_material region_defaults(void);
membrane_material membrane_defaults(void);
sliding_material sliding_defaults(void);
calcification calcification_defaults(void); /* the centre is NAN and the radius 0 until set */

/* Lists in `moduli` where the configuration keeps the values that a change of moduli replaces: the regions' Young's moduli and stiffening, and the membranes'
   stiffness. Returns how many there are. */
enum { MAX_MODULI = 2 * MAX_REGIONS + MAX_MEMBRANES };
int simulation_moduli(simulation_config *config, double *moduli[MAX_MODULI]);

#endif

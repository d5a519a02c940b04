/* The configuration of a simulation, from which its model is built. */
#ifndef TROCAR_SIMULATION_CONFIG_H
#define TROCAR_SIMULATION_CONFIG_H

#include "condensed/inverse_choice.h"
#include "insertion/model/insertion_model.h"
#include "insertion/seeds.h"
#include "mesh/region_of_interest.h"
#include "probe/probe.h"
#include "remesh/remesh.h"

typedef struct {
    char name[MESH_NAME], part_of[MESH_NAME]; /* `part_of`: name of the region that represents the organ to which this region belongs; empty if none */
    region_material material;
} region_config;
typedef struct {
    char name[MESH_NAME];
    double puncture_force;   /* N */
    membrane_material material;
} membrane_config;

typedef struct {
    char surface[MESH_NAME]; /* surface on which the probe presses; empty if there is no probe */
    probe_shape shape;
    double max_force;        /* N, force at which the probe stops */
    pose start;              /* initial pose of the probe's base; its position is NAN if none is given */
    int surface_line, start_line; /* lines of the keys `surface` and `start` in the scene file, for messages; 0 if not given in a file */
} probe_config;

enum { MAX_REGIONS = 32, MAX_MEMBRANES = 32, MAX_CALCIFICATIONS = 64, MAX_FIXED = 8 };

typedef struct {
    const char *scene_path;              /* name used in messages while the model is created; NULL if the configuration is not from a file */
    char mesh_path[1024];
    const trocar_mesh *mesh_given;      /* mesh used instead of a file; NULL if the mesh is read from a file */
    double mesh_unit;                    /* m, length of one unit of the file's coordinates */
    int region_count;   region_config regions[MAX_REGIONS];
    int membrane_count; membrane_config membranes[MAX_MEMBRANES];
    int calcification_count; calcification calcifications[MAX_CALCIFICATIONS];
    int fixed_count;    char fixed[MAX_FIXED][MESH_NAME];   /* mesh groups, of any dimension, with zero displacement */
    int guide_count;    guide_config guides[MAX_GUIDES];
    int relaxation_count; relaxation_term relaxation[MAX_RELAXATION]; /* relaxation series, the same for all regions; without terms, the tissue is elastic */
    needle_parameters needle;
    int needle_count;                    /* number of identical needles in the same tissue, 1 to MAX_NEEDLES */
    seed_size seeds;
    insertion_settings insertion;
    inverse_choice inverse;
    inverse_precision precision;
    probe_config probe;
    roi_config roi;                  /* region of interest; if it is empty, roi_find determines it */
    char cache[1024];                    /* directory of condensed inverses; if empty, the user's cache directory */
    bool keep_inverse;                   /* true: treat it as an error if a condensed inverse cannot be saved in `cache` */
    volumetric_strain volumetric;
    inverse_progress progress;           /* reports progress during a long start; its function may be NULL */
} simulation_config;

/* Sets the defaults listed in docs/reference/scene.csv; names and mesh are empty. */
void simulation_defaults(simulation_config *config);
region_material region_defaults(void);
membrane_material membrane_defaults(void);
calcification calcification_defaults(void); /* the centre is NAN and the radius 0 until they are given */

/* Fills `moduli` with pointers to those values of a configuration that a change of moduli replaces: Young's moduli and stiffening of the regions, and the
   stiffness of the membranes. Returns their number. */
enum { MAX_MODULI = 2 * MAX_REGIONS + MAX_MEMBRANES };
int simulation_moduli(simulation_config *config, double *moduli[MAX_MODULI]);

#endif

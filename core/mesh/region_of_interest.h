/* The region of interest: the nodes that needles are expected to touch. */
#ifndef TROCAR_REGION_OF_INTEREST_H
#define TROCAR_REGION_OF_INTEREST_H

#include "mesh/mesh.h"

enum { REACH_MAX_REGIONS = 32, REACH_USUAL = 3000 /* default number of nodes */ };

/* The region of interest as given in the scene: the union of mesh regions and a corridor. */
typedef struct {
    int region_count;
    char regions[REACH_MAX_REGIONS][MESH_NAME];
    vec3 from, to;           /* m, ends of the corridor's axis */
    double radius;           /* m, radius of the corridor; 0 for no corridor */
} roi_config;

bool roi_given(const roi_config *given);

/* Lists the nodes in the region of interest, in ascending order; the caller must free the list. If no region is given, takes the REACH_USUAL nodes closest to
   the normal through the centroid of surface group `surface`, or all nodes if the mesh has no more than that, or none if `surface` is -1 or not an open outer
   surface. BAD_INPUT for an unknown region, or if a given region contains no nodes. */
trocar_status roi_find(const mesh *m, const roi_config *given, int surface, int **nodes, int *count, trocar_error *why);

#endif

/* The region of interest: nodes that the needle is expected to touch. */
#ifndef TROCAR_REGION_OF_INTEREST_H
#define TROCAR_REGION_OF_INTEREST_H

#include "mesh/mesh.h"

enum { REACH_MAX_REGIONS = 16, REACH_USUAL = 3000 /* nodes, default size */ };

/* The region of interest as given in the scene: the union of regions and corridor. */
typedef struct {
    int region_count;
    char regions[REACH_MAX_REGIONS][MESH_NAME];
    vec3 from, to;           /* m, axis of a corridor */
    double radius;           /* m, of the corridor; 0: no corridor */
} roi_config;

bool roi_given(const roi_config *given);

/* Finds the nodes in the region of interest, ascending; the caller frees them. By default, these are all nodes of a mesh with up to REACH_USUAL nodes,
   otherwise that many nodes around the normal through the centroid of the surface group `surface`; none if that is not an outer surface (or is -1). BAD_INPUT
   for an unknown region, or if a given region contains no nodes. */
trocar_status roi_find(const mesh *m, const roi_config *given, int surface, int **nodes, int *count, report *why);

#endif

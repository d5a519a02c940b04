/* The region of interest: nodes that the needle is expected to touch. */
#ifndef TROCAR_REGION_OF_INTEREST_H
#define TROCAR_REGION_OF_INTEREST_H

#include "mesh/mesh.h"

enum { REACH_MAX_REGIONS = 32, REACH_USUAL = 3000 /* default number of nodes */ };

/* The region of interest as given in the scene: the union of mesh regions and a corridor. */
typedef struct {
    int region_count;
    char regions[REACH_MAX_REGIONS][MESH_NAME];
    vec3 from, to;           /* m, ends of the axis of a corridor */
    double radius;           /* m, radius of the corridor; 0 if there is none */
} roi_config;

bool roi_given(const roi_config *given);

/* Lists the nodes in the region of interest in ascending order; the caller frees the list. If no region is given, these are all nodes of a mesh with up to
   REACH_USUAL nodes; in a larger mesh, they are the REACH_USUAL nodes closest to the normal through the centroid of surface group `surface`, or none if this
   is not an open outer surface (or is -1). BAD_INPUT for an unknown region, or if a given region contains no nodes. */
trocar_status roi_find(const mesh *m, const roi_config *given, int surface, int **nodes, int *count, trocar_error *why);

#endif

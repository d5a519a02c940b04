/* The region of interest: which nodes a needle is expected to touch. */
#ifndef TROCAR_REGION_OF_INTEREST_H
#define TROCAR_REGION_OF_INTEREST_H

#include "tissue/mesh.h"

enum { REACH_MAX_REGIONS = 16, REACH_USUAL = 3000 /* nodes, where the scene says nothing */ };

/* As the scene gives it; the union of all. */
typedef struct {
    int region_count;
    char regions[REACH_MAX_REGIONS][MESH_NAME];
    vec3 from, to;           /* m, axis of a corridor */
    double radius;           /* m, of the corridor; 0: none */
} roi_config;

bool roi_given(const roi_config *given);

/* Nodes in the region of interest, ascending, to be freed. Where nothing is given: all nodes of a mesh of up to REACH_USUAL,
   else as many around the line that enters the middle of the surface named by group `surface` at right angles; none where
   that is no outer surface (-1, say). BAD_INPUT for an unknown region or when there are no nodes in what is given. */
trocar_status roi_find(const mesh *m, const roi_config *given, int surface, int **nodes, int *count, report *why);

#endif

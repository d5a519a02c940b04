/* What a viewer may see of a state, as messages: the needle with its contacts, and the displacement of every node. */
#ifndef TROCAR_VIEWER_MESSAGES_H
#define TROCAR_VIEWER_MESSAGES_H

#include "insertion/simulation.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"

typedef struct {
    simulation *simulation;
    vec3 *nodal, *added;           /* displacements, m: of the mesh's nodes and of those that the insertion added */
    float *displacement;           /* 3 node_count, m */
    float **displacement_rows;     /* node_count rows of it, as LCM wants them */
    double joints[NEEDLE_MAX_SEGMENTS + 1][3], positions[MAX_POINTS][3], forces[MAX_POINTS][3];
    double *joint_rows[NEEDLE_MAX_SEGMENTS + 1], *position_rows[MAX_POINTS], *force_rows[MAX_POINTS];
    double arc[MAX_POINTS];
    int8_t sliding[MAX_POINTS];
    trocar_contacts_t contacts;    /* both valid until the next viewer_messages_take; utime is left to the sender */
    trocar_deformation_t deformation;
} viewer_messages;

/* `s` must outlive it. NO_MEMORY. */
trocar_status viewer_messages_create(viewer_messages *v, simulation *s, report *why);
void viewer_messages_free(viewer_messages *v);

/* Fills both messages from `state`. Not for the haptic thread. */
void viewer_messages_take(viewer_messages *v, const insertion_state *state, int64_t tick, int64_t pose_utime);

#endif

/* Organ surfaces as OpenIGTLink POLYDATA messages, one for each volume of the mesh, with its name. The surfaces move with the tissue. */
#ifndef TROCAR_ORGANS_H
#define TROCAR_ORGANS_H

#include "igtl.h"

typedef struct {
    igtl_message *message;
    int count;               /* number of points on the surface */
    int32_t *nodes;          /* [count], mesh node at each point */
    float *points;           /* [3 count], scratch memory */
} organ;

/* Returns the number of volumes in the model. */
int organs_count(const trocar_model *model);

/* Creates `organs_count` surfaces, with outward normals, and their messages, which have no value yet. Volume names are truncated to 20 bytes. If that makes two
   names equal, the end of one is replaced with the volume's number. NO_MEMORY. */
trocar_status organs_make(const trocar_model *model, organ *organs, igtl_message *messages, trocar_error *why);
void organs_free(organ *organs, int count);

/* Moves the surface with the tissue. nodes: current positions (m) of all mesh nodes, 3 coordinates each. */
void organ_move(organ *o, int64_t utime, const patient_frame *frame, const double *nodes);

#endif

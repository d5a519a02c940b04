/* The surfaces of the organs as OpenIGTLink POLYDATA messages: one message for each volume of the mesh, named after the volume. The surfaces move
   with the tissue. */
#ifndef TROCAR_ORGANS_H
#define TROCAR_ORGANS_H

#include "igtl.h"

typedef struct {
    igtl_message *message;
    int count;               /* number of points on the surface */
    int32_t *nodes;          /* array [count] of the mesh nodes at the points */
    float *points;           /* array [3 count], scratch memory */
} organ;

/* Returns the number of volumes in the model. */
int organs_count(const trocar_model *model);

/* Creates `organs_count` surfaces and their messages, which have no value yet. The faces of the surfaces point outwards. The name of a volume is truncated to
   20 bytes; if two truncated names are equal, the last letters of one of them are replaced by the volume's number. NO_MEMORY. */
trocar_status organs_make(const trocar_model *model, organ *organs, igtl_message *messages, trocar_error *why);
void organs_free(organ *organs, int count);

/* Moves the surface with the tissue; `nodes` contains the current positions (m) of all nodes of the mesh, 3 coordinates each. */
void organ_move(organ *o, int64_t utime, const patient_frame *frame, const double *nodes);

#endif

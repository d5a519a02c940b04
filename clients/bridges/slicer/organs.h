/* The organs' surfaces as POLYDATA messages of OpenIGTLink: one for each volume of the mesh, named after it and moved with the tissue. */
#ifndef TROCAR_ORGANS_H
#define TROCAR_ORGANS_H

#include "igtl.h"

typedef struct {
    igtl_message *message;
    int count;               /* number of points of the surface */
    int32_t *nodes;          /* [count], node of the mesh at each point */
    float *points;           /* [3 count], scratch memory */
} organ;

/* Returns the number of volumes in the model. */
int organs_count(const trocar_model *model);

/* Creates `organs_count` surfaces and their messages, which have no value yet. Their faces point outwards. The name of a volume is cut after 20
   bytes; if two names are then equal, the last letters of one are replaced by its number. NO_MEMORY. */
trocar_status organs_make(const trocar_model *model, organ *organs, igtl_message *messages, report *why);
void organs_free(organ *organs, int count);

/* Moves the surface with the tissue; `nodes` are the present positions of all nodes of the mesh, 3 each, m. */
void organ_move(organ *o, int64_t utime, const patient_frame *frame, const double *nodes);

#endif

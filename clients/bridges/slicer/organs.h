/* The organs' surfaces as OpenIGTLink's POLYDATA: one for each volume of the mesh, under its name, moved with the tissue. */
#ifndef TROCAR_ORGANS_H
#define TROCAR_ORGANS_H

#include "igtl.h"

typedef struct {
    igtl_message *message;
    int count;               /* points of the surface, */
    int32_t *nodes;          /* [count], the mesh's node at each point */
    float *points;           /* 3 count, scratch */
} organ;

/* Volumes of the model. */
int organs_count(const trocar_model *model);

/* Creates `organs_count` surfaces and their messages, which have no value yet. Their faces point outwards. The name of a volume is cut after 20
   bytes; if it then equals another one, its last letters are replaced by its number. NO_MEMORY. */
trocar_status organs_make(const trocar_model *model, organ *organs, igtl_message *messages, report *why);
void organs_free(organ *organs, int count);

/* `nodes`: present positions of all nodes of the mesh, 3 each, m. */
void organ_move(organ *o, int64_t utime, const patient_frame *frame, const double *nodes);

#endif

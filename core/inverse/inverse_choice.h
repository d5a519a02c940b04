/* Which owner of the inverse a simulation takes. */
#ifndef TROCAR_INVERSE_CHOICE_H
#define TROCAR_INVERSE_CHOICE_H

#include "remesh/remesh.h"

typedef enum {
    INVERSE_AUTO,            /* by size and memory: see inverse_choose */
    INVERSE_DENSE,
    INVERSE_SPARSE,
    INVERSE_CONDENSED,
    INVERSE_CHOICES,
} inverse_choice;

const char *inverse_choice_name(inverse_choice choice);

/* What it depends on. */
typedef struct {
    inverse_choice given;
    remesh_method remeshing;
    int node_count, dof_count;
    bool roi_given;        /* the scene says where needles go, */
    int roi_count;         /* to so many nodes */
    double memory;           /* bytes, of the machine */
} inverse_facts;

/* What the scene gives; with auto: dense where the method works on all of it, or where it is small; else condensed where the
   scene says where needles go and that much fits; else sparse. `about` gets its name and the reason. Never AUTO. */
inverse_choice inverse_choose(const inverse_facts *facts, report *about);

#endif

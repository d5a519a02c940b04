/* Selects the implementation of the inverse. */
#ifndef TROCAR_INVERSE_CHOICE_H
#define TROCAR_INVERSE_CHOICE_H

#include <stdbool.h>

#include "base/error.h"

typedef enum {
    INVERSE_AUTO,            /* let inverse_choose decide by size and memory */
    INVERSE_DENSE,
    INVERSE_SPARSE,
    INVERSE_CONDENSED,
    INVERSE_CHOICES,
} inverse_choice;

const char *inverse_choice_name(inverse_choice choice);

/* Precision of a condensed inverse. */
typedef enum {
    PRECISION_AUTO,          /* double precision if that takes at most 0.5 GB, otherwise single */
    PRECISION_DOUBLE,
    PRECISION_SINGLE,
    PRECISIONS,
} inverse_precision;

const char *inverse_precision_name(inverse_precision precision);

/* True if a condensed inverse between this many nodes is stored in single precision. */
bool inverse_is_single(inverse_precision given, int nodes);

/* What the choice depends on. */
typedef struct {
    inverse_choice given;
    inverse_precision precision;
    int node_count, dof_count;
    bool roi_given;          /* true if the scene defines a region of interest */
    int roi_count;           /* number of nodes in the region of interest */
    double memory;           /* bytes, the machine's memory */
} inverse_facts;

/* Returns the scene's choice (facts->given) unless that is auto. For auto, returns dense if a dense inverse would be small; otherwise condensed, if the scene
   defines a region of interest and both the inverse and its computation fit into memory; otherwise sparse. Whether the inverse is cached makes no difference,
   so that the choice is always the same. `about` receives the name of the choice and the reason. Never returns INVERSE_AUTO. */
inverse_choice inverse_choose(const inverse_facts *facts, trocar_error *about);

#endif

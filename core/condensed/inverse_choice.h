/* Selects the implementation of the inverse. */
#ifndef TROCAR_INVERSE_CHOICE_H
#define TROCAR_INVERSE_CHOICE_H

#include <stdbool.h>

#include "base/report.h"

typedef enum {
    INVERSE_AUTO,            /* depends on size and memory: see inverse_choose */
    INVERSE_DENSE,
    INVERSE_SPARSE,
    INVERSE_CONDENSED,
    INVERSE_CHOICES,
} inverse_choice;

const char *inverse_choice_name(inverse_choice choice);

/* Precision of a condensed inverse. */
typedef enum {
    PRECISION_AUTO,          /* double up to 0.5 GB */
    PRECISION_DOUBLE,
    PRECISION_SINGLE,
    PRECISIONS,
} inverse_precision;

const char *inverse_precision_name(inverse_precision precision);

/* True if the inverse between this many nodes is stored in single precision. */
bool inverse_is_single(inverse_precision given, int nodes);

/* Inputs of the choice. */
typedef struct {
    inverse_choice given;
    inverse_precision precision;
    int node_count, dof_count;
    bool roi_given;          /* the scene defines a region of interest */
    int roi_count;           /* number of its nodes */
    double memory;           /* bytes, of the machine */
} inverse_facts;

/* Returns the scene's choice. If that is auto: dense if remeshing requires it or if it is small; otherwise condensed, if the scene defines a region of
   interest and the inverse fits into memory, including its computation (even if it is cached, so that the choice is always the same); otherwise sparse.
   `about` receives the name and the reason. Never returns AUTO. */
inverse_choice inverse_choose(const inverse_facts *facts, report *about);

#endif

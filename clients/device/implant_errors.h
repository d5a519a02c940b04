/* The placement errors of an implant's seeds, split into the components tissue, image, splay and remainder. */
#ifndef TROCAR_IMPLANT_ERRORS_H
#define TROCAR_IMPLANT_ERRORS_H

#include <stdio.h>

#include "device/implant_plan.h"
#include "device/implant_watch.h"

enum { ERROR_TOTAL, ERROR_TISSUE, ERROR_IMAGE, ERROR_SPLAY, ERROR_REMAINDER, ERROR_PARTS };

typedef struct {
    trocar_operator_seed seed;
    vec3 axis;               /* unit vector along the axis of the hole */
    vec3 parts[ERROR_PARTS]; /* m, vectors in the tissue at rest */
} seed_error;

typedef struct {
    int count;
    seed_error seeds[TROCAR_MAX_SEEDS];
} implant_errors;

/* Compares the seeds that the server has reported with those that the operator dropped; the seeds of a needle are in the same order in both. */
void implant_errors_find(const implant_plan *plan, const trocar_operator *op, const implant_watch *watch, implant_errors *errors);

/* Prints, for each component, the means over all seeds of the error along the needle (positive: too deep), of its magnitude, and of the magnitude of the
   error across the needle. */
void implant_errors_print(const implant_errors *errors, FILE *file);

/* Writes a row for each seed. */
void implant_errors_write_csv(const implant_errors *errors, const implant_plan *plan, FILE *file);

#endif

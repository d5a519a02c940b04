/* The placement error of each seed of an implant, and the contributions of tissue, image and splay to it; the rest is the remainder. */
#ifndef TROCAR_IMPLANT_ERRORS_H
#define TROCAR_IMPLANT_ERRORS_H

#include <stdio.h>

#include "device/implant_plan.h"
#include "device/implant_watch.h"

enum { ERROR_TOTAL, ERROR_TISSUE, ERROR_IMAGE, ERROR_SPLAY, ERROR_REMAINDER, ERROR_PARTS };

typedef struct {
    trocar_operator_seed seed;
    vec3 axis;               /* unit vector along the hole */
    vec3 parts[ERROR_PARTS]; /* m, in the undeformed tissue */
} seed_error;

typedef struct {
    int count;
    seed_error seeds[TROCAR_MAX_SEEDS];
} implant_errors;

/* Compares the seeds that the server has reported with those that the operator dropped. For each needle, both must be in the same order. */
void implant_errors_find(const implant_plan *plan, const trocar_operator *op, const implant_watch *watch, implant_errors *errors);

/* Prints three means over all seeds for the total error and each contribution: its component along the needle (positive if too deep), the magnitude of that
   component, and the magnitude across the needle. */
void implant_errors_print(const implant_errors *errors, FILE *file);

/* Writes one row per seed. */
void implant_errors_write_csv(const implant_errors *errors, const implant_plan *plan, FILE *file);

#endif

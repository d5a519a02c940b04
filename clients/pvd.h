/* A time series for ParaView: PREFIX.pvd lists PREFIX-0000-tissue.vtu, PREFIX-0000-needle.vtu, -0001- ... with their times. */
#ifndef TROCAR_PVD_H
#define TROCAR_PVD_H

#include <stdbool.h>

#include "output.h"
#include "trocar.h"

enum { PVD_HZ = 30 };        /* states a second of the motion's time */

typedef struct {
    const char *prefix;
    output list;
    int count;               /* states written */
} pvd_series;

/* BAD_INPUT when the place cannot be written. `prefix` must outlive it. */
trocar_status pvd_open(pvd_series *p, const char *prefix, report *why);

/* Writes this state, of this time (s). */
trocar_status pvd_take(pvd_series *p, const trocar_model *model, trocar_picture *picture, const trocar_output *output, double time,
                       report *why);

/* Is the state at this time (s) one of the series? */
bool pvd_is_due(const pvd_series *p, double time);

/* Puts the list in place; until then there is none. */
trocar_status pvd_close(pvd_series *p, report *why);
void pvd_abandon(pvd_series *p);

#endif

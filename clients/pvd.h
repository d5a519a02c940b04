/* A time series for ParaView: PREFIX.pvd lists PREFIX-0000-tissue.vtu, PREFIX-0000-needle.vtu, -0001- ... with their times. */
#ifndef TROCAR_PVD_H
#define TROCAR_PVD_H

#include "output.h"
#include "insertion/simulation.h"

enum { PVD_HZ = 30 };        /* states a second of the motion's time */

typedef struct {
    const char *prefix;
    output list;
    int count;               /* states written */
} pvd_series;

/* BAD_INPUT when the place cannot be written. `prefix` must outlive it. */
trocar_status pvd_open(pvd_series *p, const char *prefix, report *why);

/* Writes this state if its time (s) is due. */
trocar_status pvd_take(pvd_series *p, simulation *s, const insertion_state *state, const insertion_wrench *wrench, double time,
                       report *why);

/* Puts the list in place; until then there is none. */
trocar_status pvd_close(pvd_series *p, report *why);
void pvd_abandon(pvd_series *p);

#endif

/* A time series for ParaView: PREFIX.pvd lists the times and files of the states. State 0 is in PREFIX-0000-tissue.vtu, PREFIX-0000-needle.vtu and, if the
   scene has a probe or stiff membranes, PREFIX-0000-probe.vtu and PREFIX-0000-membranes.vtu; state 1 is in PREFIX-0001-..., and so on. */
#ifndef TROCAR_PVD_H
#define TROCAR_PVD_H

#include <stdbool.h>

#include "shared/output.h"
#include "shared/patient.h"
#include "trocar.h"

enum { PVD_HZ = 30 };        /* states per second of simulated time */

typedef struct {
    const char *prefix;
    output list;
    int count;               /* states written */
} pvd_series;

/* Starts a series. `prefix` must outlive it. Returns BAD_INPUT if PREFIX.pvd cannot be written. */
trocar_status pvd_open(pvd_series *p, const char *prefix, trocar_error *why);

/* Adds the state at this time (s), in patient coordinates unless `patient` is NULL. */
trocar_status pvd_take(pvd_series *p, const trocar_model *model, trocar_picture *picture, const trocar_output *output,
                       const patient_frame *patient, double time, trocar_error *why);

/* True if a state is due at this time (s). */
bool pvd_is_due(const pvd_series *p, double time);

/* Writes the list, PREFIX.pvd. Until then, that file does not exist. */
trocar_status pvd_close(pvd_series *p, trocar_error *why);
void pvd_abandon(pvd_series *p);

#endif

/* A time series for ParaView: PREFIX.pvd lists the files PREFIX-0000-tissue.vtu, PREFIX-0000-needle.vtu, PREFIX-0000-probe.vtu and
   PREFIX-0000-membranes.vtu (if the scene has a probe or membranes with a stiffness), PREFIX-0001-... and their times. */
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
    int count;               /* number of states written */
} pvd_series;

/* Starts a series. BAD_INPUT if PREFIX.pvd cannot be written. `prefix` must outlive the series. */
trocar_status pvd_open(pvd_series *p, const char *prefix, trocar_error *why);

/* Adds a state at this time (s) to the series, in patient coordinates if `patient` is not NULL. */
trocar_status pvd_take(pvd_series *p, const trocar_model *model, trocar_picture *picture, const trocar_output *output,
                       const patient_frame *patient, double time, trocar_error *why);

/* True if the state at this time (s) belongs to the series. */
bool pvd_is_due(const pvd_series *p, double time);

/* Writes the list, PREFIX.pvd; the file does not exist before this call. */
trocar_status pvd_close(pvd_series *p, trocar_error *why);
void pvd_abandon(pvd_series *p);

#endif

/* One tick in the output of trocar-replay, written as a CSV row or as a JSON line. Both contain the same values, with full precision. */
#ifndef TROCAR_TICK_ROW_H
#define TROCAR_TICK_ROW_H

#include <stdbool.h>
#include <stdio.h>

#include "base/vec.h"

typedef struct {
    double time;             /* s since the first pose */
    vec3 force, torque;      /* force (N) and torque (N m) that the needle's base exerts on the hand */
    double depth;            /* m */
    int contacts;
    char events[256];        /* see events_text */
    int needle;
    double tip_lead;         /* rad, roll of the tip minus roll of the base */
    vec3 base, tip;          /* positions of base and tip, in the unit `unit` */
    const char *unit;        /* "m" or, in patient coordinates, "mm" */
    bool has_probe;          /* true if the scene has a probe; otherwise, the following members are not written */
    vec3 probe_force, probe_torque; /* force (N) and torque (N m) exerted on the hand that holds the probe */
    int probe_contacts;
    bool probe_placed;
    vec3 probe_base;         /* position of the probe's base, in `unit`; valid once the probe has been placed */
} tick_row;

/* Writes the names of the columns; those of the probe come last. */
void tick_row_csv_head(FILE *out, const char *unit, bool has_probe);
void tick_row_csv(const tick_row *r, FILE *out);

/* Writes one object on one line; member names include units. */
void tick_row_json(const tick_row *r, FILE *out);

#endif

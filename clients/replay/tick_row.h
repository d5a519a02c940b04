/* One tick in the output of trocar-replay, as a CSV row or as a line of JSON. Both contain the same values, at full precision. */
#ifndef TROCAR_TICK_ROW_H
#define TROCAR_TICK_ROW_H

#include <stdbool.h>
#include <stdio.h>

#include "base/vec.h"

typedef struct {
    double time;             /* s since the first pose */
    vec3 force, torque;      /* N and N m, exerted on the hand by the needle's base */
    double depth;            /* m */
    int contacts;
    char events[256];        /* see events_text */
    int needle;
    double tip_lead;         /* rad, roll of the tip minus roll of the base */
    vec3 base, tip;          /* positions, in `unit` */
    const char *unit;        /* "m" or, in patient coordinates, "mm" */
    bool has_probe;          /* true if the scene has a probe; if false, the members below are not written */
    vec3 probe_force, probe_torque; /* N and N m, exerted on the hand that holds the probe */
    int probe_contacts;
    bool probe_placed;
    vec3 probe_base;         /* position of the probe's base, in `unit`; valid once the probe has been placed */
} tick_row;

/* Writes the column names; those of the probe come last. */
void tick_row_csv_head(FILE *out, const char *unit, bool has_probe);
void tick_row_csv(const tick_row *r, FILE *out);

/* Writes the row as a JSON object on one line. The member names include units. */
void tick_row_json(const tick_row *r, FILE *out);

#endif

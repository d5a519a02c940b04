/* What the operator of an implant can see: the marks on each needle at the template, and, as in an image, where the tissue has moved. */
#ifndef TROCAR_IMPLANT_WATCH_H
#define TROCAR_IMPLANT_WATCH_H

#include <lcm/lcm.h>

#include "device/implant_plan.h"
#include "shared/server_choice.h"

typedef struct {
    lcm_t *lcm;
    server_choice choice;
    int node_count;
    double *displacements;   /* [node_count][3] m, of the newest picture; zero before the first */
    pose bases[TROCAR_MAX_NEEDLES];
    double seen[TROCAR_MAX_NEEDLES]; /* s, playing_now at which that base arrived; 0: never */
} implant_watch;

/* `url`: NULL for LCM's default. SYSTEM if LCM fails. */
trocar_status implant_watch_open(implant_watch *w, const char *url, int node_count, report *why);

/* Releases everything. May be called after a failed open, and for a zeroed struct. */
void implant_watch_close(implant_watch *w);

/* Receives all messages that have arrived. */
void implant_watch_look(implant_watch *w);

/* m, how far a needle reaches beyond the template's face, read from its marks there. */
double implant_watch_depth(const implant_watch *w, int needle, const planned_needle *planned, double needle_length);

/* m, how far the tissue has moved the place of a needle's seed along the hole. */
double implant_watch_shift(const implant_watch *w, const planned_needle *planned, int seed);

#endif

/* The information that an operator of an implant sees: the marks on each needle at the template, and, as in an image, the displacement of the tissue. */
#ifndef TROCAR_IMPLANT_WATCH_H
#define TROCAR_IMPLANT_WATCH_H

#include <lcm/lcm.h>

#include "device/implant_plan.h"
#include "shared/server_choice.h"

typedef struct {
    lcm_t *lcm;
    server_choice choice;
    int node_count;
    double *displacements;   /* [node_count][3] m, displacements in the newest picture; zero before the first */
    pose bases[TROCAR_MAX_NEEDLES];
    double seen[TROCAR_MAX_NEEDLES]; /* s, value of playing_now when that base arrived; 0 before the first */
} implant_watch;

/* Opens the watch; `url` is NULL for LCM's default. SYSTEM if LCM fails. */
trocar_status implant_watch_open(implant_watch *w, const char *url, int node_count, report *why);

/* Releases everything. May be called after a failed open, and for a zeroed struct. */
void implant_watch_close(implant_watch *w);

/* Receives all messages that have arrived. */
void implant_watch_look(implant_watch *w);

/* Returns how far (m) a needle reaches beyond the template's face, as read from its marks there. */
double implant_watch_depth(const implant_watch *w, int needle, const planned_needle *planned, double needle_length);

/* Returns how far (m) the tissue has moved the place of a seed of this needle along the hole. */
double implant_watch_shift(const implant_watch *w, const planned_needle *planned, int seed);

#endif

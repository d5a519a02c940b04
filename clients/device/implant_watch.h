/* What an operator of an implant can see: the depth marks on each needle at the template, and the displacement of the tissue, as in an image. */
#ifndef TROCAR_IMPLANT_WATCH_H
#define TROCAR_IMPLANT_WATCH_H

#include <lcm/lcm.h>

#include "device/implant_plan.h"
#include "shared/server_choice.h"

typedef struct {
    lcm_t *lcm;
    server_choice choice;
    int node_count;
    double *displacements;   /* array [node_count][3], m: displacements in the newest picture; zero before the first picture */
    pose bases[TROCAR_MAX_NEEDLES];
    double seen[TROCAR_MAX_NEEDLES]; /* s, time (as returned by playing_now) at which each needle's last base pose arrived; 0 before the first */
} implant_watch;

/* Starts watching; `url` is NULL for LCM's default. SYSTEM if LCM fails. */
trocar_status implant_watch_open(implant_watch *w, const char *url, int node_count, report *why);

/* Releases everything. May also be called after a failed open, and for a zeroed struct. */
void implant_watch_close(implant_watch *w);

/* Receives all messages that have arrived. */
void implant_watch_look(implant_watch *w);

/* Returns the length (m) of a needle beyond the template's face, as read from the needle's marks at the template. */
double implant_watch_depth(const implant_watch *w, int needle, const planned_needle *planned, double needle_length);

/* Returns the distance (m) along the hole by which the tissue has displaced the planned position of a seed of this needle. */
double implant_watch_shift(const implant_watch *w, const planned_needle *planned, int seed);

#endif

/* What the server reports about an implant: the needles' base poses, the tissue displacements, and the seeds. From these, the operator can read the
   depth marks on the needles at the template and, in the image, see the displaced tissue. */
#ifndef TROCAR_IMPLANT_WATCH_H
#define TROCAR_IMPLANT_WATCH_H

#include <lcm/lcm.h>

#include "device/implant_plan.h"
#include "shared/server_choice.h"

typedef struct {
    lcm_t *lcm;
    server_choice choice;
    int node_count;
    double *displacements;   /* array [node_count][3], m: displacements in the newest deformation_t; zero before the first one */
    trocar_pose bases[TROCAR_MAX_NEEDLES];
    double seen[TROCAR_MAX_NEEDLES]; /* s, time (as returned by playing_now) at which each needle's last base pose arrived; 0 before the first */
    int seed_count;          /* number of seeds in the tissue; the arrays list them in the order in which they were left */
    int seed_needles[TROCAR_MAX_SEEDS];
    double seeds[TROCAR_MAX_SEEDS][3]; /* m, centres in the tissue at rest */
} implant_watch;

/* Starts watching; `url` is NULL for LCM's default. Returns SYSTEM if LCM fails. */
trocar_status implant_watch_open(implant_watch *w, const char *url, int node_count, trocar_error *why);

/* Releases everything. May also be called after a failed open, and for a zeroed struct. */
void implant_watch_close(implant_watch *w);

/* Receives all messages that have arrived. */
void implant_watch_look(implant_watch *w);

#endif

/* What the server reports about an implant: the poses of the needle bases, the tissue displacements and the seeds. They let the operator read the needles'
   depth marks at the template and see the deformed tissue in the image. */
#ifndef TROCAR_IMPLANT_WATCH_H
#define TROCAR_IMPLANT_WATCH_H

#include <lcm/lcm.h>

#include "device/implant_plan.h"
#include "shared/server_choice.h"

typedef struct {
    lcm_t *lcm;
    server_choice choice;
    int node_count;
    double *displacements;   /* m, array [node_count][3], from the newest deformation_t; zero before the first */
    trocar_pose bases[TROCAR_MAX_NEEDLES];
    double seen[TROCAR_MAX_NEEDLES]; /* s, by playing_now, when each needle's base pose last arrived; 0 before the first */
    int seed_count;          /* seeds in the tissue, in the order they were left */
    int seed_needles[TROCAR_MAX_SEEDS];
    double seeds[TROCAR_MAX_SEEDS][3]; /* m, centres in the undeformed tissue */
} implant_watch;

/* Starts watching. A `url` of NULL means LCM's default. Returns SYSTEM if LCM fails. */
trocar_status implant_watch_open(implant_watch *w, const char *url, int node_count, trocar_error *why);

/* Frees everything. Also safe after a failed open, or on a zeroed struct. */
void implant_watch_close(implant_watch *w);

/* Receives the messages that have arrived, without waiting. */
void implant_watch_look(implant_watch *w);

#endif

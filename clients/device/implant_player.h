/* Carries out a planned implant over LCM, performing the actions chosen by a virtual operator (trocar/operator.h). */
#ifndef TROCAR_IMPLANT_PLAYER_H
#define TROCAR_IMPLANT_PLAYER_H

#include <stdbool.h>
#include <stdio.h>

#include "device/implant_plan.h"
#include "device/implant_watch.h"

typedef struct {
    const char *lcm_url;     /* LCM URL; NULL selects $LCM_DEFAULT_URL or, if that is not set, LCM's default */
    double rate;             /* Hz */
    double patience;         /* s to wait for the server */
    double settle;           /* s, pause before each needle moves, while the server ramps the force up */
    bool realtime;           /* request SCHED_FIFO */
    FILE *csv;               /* file that receives one row per period; NULL if no table is written */
} implant_play;

typedef struct {
    int needles, seeds;      /* number of needles inserted, and of seeds dropped */
    int repeats;             /* number of times a drop command was repeated because the previous seed was still in the needle */
    double greatest_drag;    /* m, largest change in a resting needle's depth after it was left */
    int greatest_drag_needle; /* index of the needle with the largest change */
    double duration;         /* s */
    double greatest_force;   /* N */
    int greatest_force_needle; /* index of the needle that felt the greatest force */
} implant_summary;

/* Carries out the plan with this operator. At the end, `watch` contains the seeds. SYSTEM if the server refuses a command or falls silent
   (the message gives the needle's hole and the reason), and after SIGINT or SIGTERM. In these cases, the needles stay where they are. */
trocar_status implant_carry_out(const implant_plan *plan, trocar_operator *op, const implant_play *play, implant_watch *watch, implant_summary *summary,
                                trocar_error *why);

#endif

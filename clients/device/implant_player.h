/* Carries out a planned implant over LCM in the way a surgeon would: inserts and leaves all needles, then takes each one again, drops its seeds while
   drawing it back, and pulls it out. Depths are read from the needle's marks at the template, because the tissue drags resting needles along. */
#ifndef TROCAR_IMPLANT_PLAYER_H
#define TROCAR_IMPLANT_PLAYER_H

#include <stdbool.h>
#include <stdio.h>

#include "device/implant_plan.h"

typedef struct {
    const char *lcm_url;     /* LCM URL; NULL selects $LCM_DEFAULT_URL or, if that is not set, LCM's default */
    double rate;             /* Hz */
    double speed;            /* factor by which the hand moves faster than normal */
    double patience;         /* s to wait for the server */
    double settle;           /* s, rest before each needle moves, while the server ramps the force up */
    bool realtime;           /* ask for SCHED_FIFO */
    bool follow;             /* true: move to the displaced positions at which the seeds should be, as if seen in an image, instead of the planned depths */
    FILE *csv;               /* file that receives one row per period; NULL if no table is written */
} implant_play;

typedef struct {
    int needles, seeds;      /* inserted; dropped */
    int repeats;             /* number of times a drop command was repeated because the previous seed was still in the needle */
    double greatest_drag;    /* m, largest change of a resting needle's depth after it was left */
    int greatest_drag_needle; /* that needle */
    double duration;         /* s */
    double greatest_force;   /* N */
    int greatest_force_needle; /* index of the needle that felt the greatest force */
} implant_summary;

/* Carries out the plan. SYSTEM if the server refuses a command or falls silent (the message gives the needle's hole and the reason), and after SIGINT
   or SIGTERM. In these cases, the needles stay where they are. */
trocar_status implant_carry_out(const implant_plan *plan, const implant_play *play, implant_summary *summary, report *why);

#endif

/* Carries out a planned implant over LCM, as a hand would: inserts and leaves every needle, then takes each again, drops its seeds while drawing
   it back, and pulls it out. Depths are read from the needle's marks at the template, because the tissue drags resting needles along. */
#ifndef TROCAR_IMPLANT_PLAYER_H
#define TROCAR_IMPLANT_PLAYER_H

#include <stdbool.h>
#include <stdio.h>

#include "device/implant_plan.h"

typedef struct {
    const char *lcm_url;     /* NULL: $LCM_DEFAULT_URL, or else LCM's default */
    double rate;             /* Hz */
    double speed;            /* factor on the hand's speed */
    double patience;         /* s to wait for the server */
    double settle;           /* s at rest before each needle moves, while the server ramps the force up */
    bool realtime;           /* ask for SCHED_FIFO */
    bool follow;             /* move to the seeds' displaced places, as if seen in an image, instead of the planned depths */
    FILE *csv;               /* receives one row per period; NULL if no table is written */
} implant_play;

typedef struct {
    int needles, seeds;      /* inserted; dropped */
    int repeats;             /* number of repeated commands to drop a seed because the previous seed was still in the needle */
    double greatest_drag;    /* m, largest change of a resting needle's depth since it was left */
    int greatest_drag_needle; /* that needle */
    double duration;         /* s */
    double greatest_force;   /* N */
    int greatest_force_needle; /* the needle that had the greatest force */
} implant_summary;

/* Carries out the plan. SYSTEM, with the needle's hole and the reason, if the server refuses a command or falls silent, and after SIGINT or SIGTERM.
   The needles then stay where they are. */
trocar_status implant_carry_out(const implant_plan *plan, const implant_play *play, implant_summary *summary, report *why);

#endif

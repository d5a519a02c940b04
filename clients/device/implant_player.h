/* Carries out a planned implant over LCM: does what a virtual operator (trocar/operator.h) decides. */
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
    double settle;           /* s to wait before each needle moves, while the server ramps the force up */
    bool realtime;           /* request SCHED_FIFO */
    FILE *csv;               /* one row per period is written here; NULL for none */
} implant_play;

typedef struct {
    int needles, seeds;      /* needles inserted, seeds dropped */
    int repeats;             /* how often a drop had to be repeated because the previous seed was still in the needle */
    double greatest_drag;    /* m, farthest that a resting needle was dragged along its axis after it was left */
    int greatest_drag_needle; /* needle that was dragged the farthest */
    double duration;         /* s */
    double greatest_force;   /* N */
    int greatest_force_needle; /* needle that felt the greatest force */
} implant_summary;

/* Carries out the plan with this operator and leaves the seeds in `watch`. Returns SYSTEM if the server refuses a command or falls silent (the message names
   the hole and the reason), or after SIGINT or SIGTERM; the needles then stay where they are. */
trocar_status implant_carry_out(const implant_plan *plan, trocar_operator *op, const implant_play *play, implant_watch *watch, implant_summary *summary,
                                trocar_error *why);

#endif

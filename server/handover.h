/* A needle changes hands: what the server does, and the replay of a log of the server after it. */
#ifndef TROCAR_HANDOVER_H
#define TROCAR_HANDOVER_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"

/* A hand that takes a resting needle is elsewhere: from then on the needle moves as the hand does, from where it lay. */
typedef struct {
    bool engaged;            /* if not, the needle is where the hand is */
    pose from, to;           /* of the hand and of the needle's base, when it was taken */
} hand_clutch;

hand_clutch clutch_engage(pose hand, const trocar_pose *base); /* RT */
pose clutch_follow(const hand_clutch *clutch, pose hand);      /* where the base is to be. RT */

/* Takes the needle out of the tissue, and far away from it. Errors as trocar_sim_reset. RT */
trocar_status remove_needle(trocar_sim *sim, int needle, trocar_error *why);

#endif

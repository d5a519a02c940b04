/* What commands do: a needle changes hands, seeds are dropped. For the server, and for the replay of a log of the server. */
#ifndef TROCAR_HANDOVER_H
#define TROCAR_HANDOVER_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"
#include "trocar_command_t.h"

/* A hand that takes a resting needle is elsewhere: from then on the needle moves as the hand does, from where it lay. */
typedef struct {
    bool engaged;            /* if not, the needle is where the hand is */
    pose from, to;           /* of the hand and of the needle's base, when it was taken */
} hand_clutch;

hand_clutch clutch_engage(pose hand, const trocar_pose *base); /* RT */
pose clutch_follow(const hand_clutch *clutch, pose hand);      /* where the base is to be. RT */

/* Carries out the DROP_SEED or UNDO that `m` asks for, with this needle of the simulation. Errors as trocar_sim_drop_seeds. RT, but for the text of a
   refusal. */
trocar_status handle_seeds(trocar_sim *sim, int needle, const trocar_command_t *m, trocar_error *why);

/* Takes the needle out of the tissue, and far away from it. Errors as trocar_sim_reset. RT */
trocar_status remove_needle(trocar_sim *sim, int needle, trocar_error *why);

#endif

/* Carries out commands that transfer a needle between hands or drop seeds. Used by the server, and when a server's log is replayed. */
#ifndef TROCAR_HANDOVER_H
#define TROCAR_HANDOVER_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"
#include "trocar_command_t.h"

/* The offset between a hand and the resting needle that it has picked up. The needle starts from where it rested and follows the hand's motion from then on. */
typedef struct {
    bool engaged;            /* if false, there is no offset: the needle's base has the hand's pose */
    pose from, to;           /* poses of the hand and of the needle's base when the needle was picked up */
} hand_clutch;

hand_clutch clutch_engage(pose hand, const trocar_pose *base); /* RT */
pose clutch_follow(const hand_clutch *clutch, pose hand);      /* Returns the pose of the needle's base when the hand is at `hand`. RT */

/* Carries out `m`, a DROP_SEED or UNDO command, or what a CLEAR does to seeds, on this needle. Errors as in trocar_sim_drop_seeds. RT, except when it formats the
   reason for a refusal. */
trocar_status handle_seeds(trocar_sim *sim, int needle, const trocar_command_t *m, trocar_error *why);

/* Takes the needle out of the tissue and parks it far away. Errors as in trocar_sim_reset. RT */
trocar_status remove_needle(trocar_sim *sim, int needle, trocar_error *why);

#endif

/* Effects of commands: a needle changes hands, seeds are dropped. Used by the server, and by the replay of a server's log. */
#ifndef TROCAR_HANDOVER_H
#define TROCAR_HANDOVER_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"
#include "trocar_command_t.h"

/* Offset between a hand and the resting needle that it has taken: the needle follows the hand's motion from where it lay. */
typedef struct {
    bool engaged;            /* false: the needle is where the hand is */
    pose from, to;           /* poses of the hand and of the needle's base when it was taken */
} hand_clutch;

hand_clutch clutch_engage(pose hand, const trocar_pose *base); /* RT */
pose clutch_follow(const hand_clutch *clutch, pose hand);      /* Returns the pose for the base. RT */

/* Executes the DROP_SEED or UNDO in `m` on this needle of the simulation. Errors as trocar_sim_drop_seeds. RT, except for the text of a refusal. */
trocar_status handle_seeds(trocar_sim *sim, int needle, const trocar_command_t *m, trocar_error *why);

/* Takes the needle out of the tissue, and moves it far away. Errors as trocar_sim_reset. RT */
trocar_status remove_needle(trocar_sim *sim, int needle, trocar_error *why);

#endif

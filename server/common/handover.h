/* Executes commands that transfer a needle between hands or drop seeds. Used by the server and by the replay of a server's log. */
#ifndef TROCAR_HANDOVER_H
#define TROCAR_HANDOVER_H

#include <stdbool.h>

#include "base/vec.h"
#include "trocar.h"
#include "trocar_command_t.h"

/* Offset between a hand and the resting needle that it has taken. The needle starts from its resting pose and follows the hand's motion from then
   on. */
typedef struct {
    bool engaged;            /* false: there is no offset, and the needle's base has the same pose as the hand */
    pose from, to;           /* poses of the hand and of the needle's base at the moment when the hand took the needle */
} hand_clutch;

hand_clutch clutch_engage(pose hand, const trocar_pose *base); /* RT */
pose clutch_follow(const hand_clutch *clutch, pose hand);      /* Returns the pose of the needle's base for the hand's pose `hand`. RT */

/* Executes the command `m`, a DROP_SEED or UNDO, on this needle of the simulation. Errors as in trocar_sim_drop_seeds. RT, except when it formats the
   text of a refusal. */
trocar_status handle_seeds(trocar_sim *sim, int needle, const trocar_command_t *m, trocar_error *why);

/* Removes the needle from the tissue and parks it far away. Errors as in trocar_sim_reset. RT */
trocar_status remove_needle(trocar_sim *sim, int needle, trocar_error *why);

#endif

/* Executes commands for seeds in a replay. Commands that the server refused are not executed. A drop that the server executed may come too early in a
   replay, because the previous seed leaves the needle a few um later; the drop then remains pending until that seed is out, or until the needle's next command
   or reset at the latest. */
#ifndef TROCAR_SEED_REPLAY_H
#define TROCAR_SEED_REPLAY_H

#include <stdbool.h>

#include "shared/poselog.h"

typedef struct {
    const trocar_command_t *drop; /* the pending drop from the log; NULL if there is none */
    trocar_error reason;     /* reason why the drop is pending, or why it was abandoned */
} waiting_drop;

/* Executes a command in the same way as handle_seeds. Also returns TROCAR_OK for commands that the server refused, for a drop that becomes pending, and for an
   undo of a pending drop. */
trocar_status replay_seed_command(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *logged, trocar_error *why);

/* Tries to execute a pending drop. Must be called before each tick of the needle. If the drop is refused for another reason, abandons it and returns false. */
bool try_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle);

/* Ends the wait of a pending drop, which is executed if possible and otherwise abandoned. Must be called before the needle's next command (`next`), before the
   needle is reset, and at the end (NULL). Returns false if it was abandoned. */
bool end_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *next);

#endif

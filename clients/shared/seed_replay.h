/* Executes commands for seeds in a replay. Commands that the server refused are not executed. A drop that the server executed may come too early in a
   replay, because the previous seed leaves the needle a few um later; the drop then waits until that seed is out, but at most until the needle's next
   command or reset.
   */
#ifndef TROCAR_SEED_REPLAY_H
#define TROCAR_SEED_REPLAY_H

#include <stdbool.h>

#include "shared/poselog.h"

typedef struct {
    const trocar_command_t *drop; /* a drop from the log that is still waiting; NULL if there is none */
    report reason;           /* reason why the drop waits, or why it was given up */
} waiting_drop;

/* Executes a command in the same way as handle_seeds. Also returns TROCAR_OK for commands that the server refused, for a drop that starts to wait,
   and for an undo of a waiting drop. */
trocar_status replay_seed_command(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *logged, report *why);

/* Tries to execute a waiting drop. Must be called before each tick of the needle. If the drop is refused for another reason, gives it up and returns
   false. */
bool try_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle);

/* Ends the wait. Must be called before the needle's next command (`next`), before the needle is reset, and at the end (NULL). Returns false if a
   waiting drop is given up. */
bool end_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *next);

#endif

/* Commands for seeds in a replay. What the server refused is not carried out. A drop that the server carried out may come too early in a replay, where the
   seed before leaves the needle a few um later: it waits until that seed is out, at most for the needle's next command or reset. */
#ifndef TROCAR_SEED_REPLAY_H
#define TROCAR_SEED_REPLAY_H

#include <stdbool.h>

#include "poselog.h"

typedef struct {
    const trocar_command_t *drop; /* that waits, in the log; NULL: none */
    report reason;           /* why it waits, or why it was given up */
} waiting_drop;

/* As handle_seeds. TROCAR_OK also for what the server refused, for a drop that waits from now on, and for an undo of the one that waits. */
trocar_status replay_seed_command(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *logged, report *why);

/* Before each tick of the needle. False: the drop that waited is refused for another reason, and given up. */
bool try_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle);

/* Before the needle's next command (`next`), before it is reset, and at the end (NULL). False: the drop that waited is given up. */
bool end_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *next);

#endif

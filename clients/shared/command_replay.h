/* Executes commands for seeds, and changes, in a replay; those that the server refused are skipped. One that the server executed may come too early in a
   replay, because the previous seed leaves the needle a few um later, or because moduli reach their last values a few ticks later; it is then kept pending. A
   drop remains pending until that seed is out, or until the needle's next command or reset at the latest. */
#ifndef TROCAR_COMMAND_REPLAY_H
#define TROCAR_COMMAND_REPLAY_H

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

typedef struct {
    trocar_change *change;   /* the pending change; NULL if there is none */
    double time;             /* s, duration of the change */
} waiting_change;

/* Executes a change; builds a model first if moduli change. While earlier moduli are still moving, the change becomes pending, which is TROCAR_OK. BAD_INPUT if it
   is refused; NO_MEMORY, and errors of trocar_change_prepare. */
trocar_status replay_change(waiting_change *w, trocar_sim *sim, const logged_command *logged, trocar_error *why);

/* Executes a pending change if the simulation accepts it now. Must be called before each tick. */
trocar_status try_waiting_change(waiting_change *w, trocar_sim *sim, trocar_error *why);

/* Abandons a pending change. Returns false if there was one. */
bool end_waiting_change(waiting_change *w);

#endif

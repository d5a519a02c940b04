/* Executes a recording's seed commands and changes in a replay, except those that the server refused. A command that the server executed may come too early
   in a replay, because the previous seed leaves the needle a few um later, or because moduli reach their final values a few ticks later; it is then kept
   pending. A drop remains pending until that seed is out, or until the needle's next command or reset at the latest. */
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

/* Executes a pending drop once the previous seed is out of the needle. Must be called before each tick of the needle. If the drop is still refused then,
   abandons it and returns false. */
bool try_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle);

/* Executes a pending drop if that is possible, and abandons it otherwise. Must be called before the needle's next command (`next`), before the
   needle is reset, and at the end (NULL). Returns false if it was abandoned. */
bool end_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *next);

typedef struct {
    trocar_change *change;   /* the pending change; NULL if there is none */
    double time;             /* s, duration of the change */
} waiting_change;

/* Executes a change; builds a model first if moduli change. If moduli are still moving to the values of an earlier change, the change becomes pending, and the
   function returns TROCAR_OK. BAD_INPUT if the change is refused; NO_MEMORY, and errors of trocar_change_prepare. */
trocar_status replay_change(waiting_change *w, trocar_sim *sim, const logged_command *logged, trocar_error *why);

/* Executes a pending change if the simulation accepts it now. Must be called before each tick. */
trocar_status try_waiting_change(waiting_change *w, trocar_sim *sim, trocar_error *why);

/* Abandons a pending change. Returns false if there was one. */
bool end_waiting_change(waiting_change *w);

#endif

/* Executes the seed commands and changes of a recording in a replay, except those that the server refused. In a replay, a command may come slightly too early:
   the previous seed leaves the needle a few um later, or moduli reach their final values a few ticks later. The command is then kept pending. A drop stays
   pending until the previous seed is out or, at the latest, until the needle's next command or reset. */
#ifndef TROCAR_COMMAND_REPLAY_H
#define TROCAR_COMMAND_REPLAY_H

#include <stdbool.h>

#include "shared/poselog.h"

typedef struct {
    const trocar_command_t *drop; /* the pending drop in the log; NULL if there is none */
    trocar_error reason;     /* why the drop is pending, or why it was given up */
} waiting_drop;

/* Executes a seed command as handle_seeds does. Also returns TROCAR_OK if the server refused the command, if a drop becomes pending, or if the command undoes a
   pending drop. */
trocar_status replay_seed_command(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *logged, trocar_error *why);

/* Executes a pending drop if the previous seed is out of the needle. Call it before each tick of the needle. If the drop is refused even then, gives it up and
   returns false. */
bool try_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle);

/* Executes a pending drop if possible, and otherwise gives it up and returns false. Call it before the needle's next command (`next`), before the needle is
   reset, and at the end (`next` is NULL). */
bool end_waiting_drop(waiting_drop *w, trocar_sim *sim, int needle, const logged_command *next);

typedef struct {
    trocar_change *change;   /* the pending change; NULL if there is none */
    double time;             /* s, how long the change takes */
} waiting_change;

/* Executes a change, building a model first if moduli change. If moduli are still moving because of an earlier change, the change becomes pending and the
   function returns TROCAR_OK. Returns BAD_INPUT if the change is refused, or NO_MEMORY, or an error of trocar_change_prepare. */
trocar_status replay_change(waiting_change *w, trocar_sim *sim, const logged_command *logged, trocar_error *why);

/* Executes a pending change if the simulation accepts it now. Call it before each tick. */
trocar_status try_waiting_change(waiting_change *w, trocar_sim *sim, trocar_error *why);

/* Gives up a pending change. Returns false if there was one. */
bool end_waiting_change(waiting_change *w);

#endif

/* The ticking thread's side of a simulation. */
#ifndef TROCAR_TICKING_H
#define TROCAR_TICKING_H

#include "api/api.h"

/* Returns BAD_INPUT if `needle` is out of range. RT */
trocar_status check_needle(const trocar_sim *sim, int needle, trocar_error *why);

/* Converts the pose to `out`, normalising its quaternion. Returns BAD_INPUT if the pose is not finite or its quaternion's length is not close to 1. RT */
trocar_status check_pose(const trocar_pose *p, pose *out, trocar_error *why);

/* Returns the probe's state as last published by the worker; NULL if there is no probe. RT */
const shown_probe *shown_probe_of(const trocar_sim *sim);

/* Returns the needle's visible state; for a resting needle, this is the state last published by the worker. Writes its stamp unless `stamp` is NULL. RT */
const insertion_state *state_of_needle(const trocar_sim *sim, int needle, uint64_t *stamp);

/* Returns the pose of the base: for a held needle, the last commanded pose plus the spring's deflection; for a resting needle, its current pose. RT */
pose base_of_needle(const trocar_sim *sim, int needle);

/* If the worker has handed the needle back, continues with the state it returned. Otherwise does nothing. RT */
void adopt_needle(trocar_sim *sim, sim_needle *needle);

/* Fills the message that hands a needle being left to the worker: its state, and other needles' tracks near its tip. RT */
void fill_message_of_left_needle(trocar_sim *sim, int needle);

/* Returns the input for a tick of this needle. RT */
tick_input tick_of(const trocar_sim *sim, int needle, const compliance_snapshot *answer, double dt);

/* Computes one tick using the snapshot `answer`. If the result is not finite, restarts the insertion, because the state would never recover, and returns
   NUMERIC. RT */
trocar_status run_tick(trocar_sim *sim, int needle, const compliance_snapshot *answer, pose base, double dt, trocar_output *output);

/* Tells the worker how the needle supports the tissue against the probe (needle_hold). Call it after run_tick, with the same answer. RT */
void post_hold(trocar_sim *sim, sim_needle *needle, const compliance_snapshot *answer);

/* A callback that runs after a tick with a finite result, before the worker answers the tick's request. It gets the tick's input and resulting state. */
typedef struct {
    trocar_status (*call)(const tick_input *tick, const insertion_state *state, const insertion_workspace *workspace, void *context, trocar_error *why);
    void *context;
} after_tick;

/* Implements trocar_sim_step (in api_sim.c). `after` may be NULL; if it fails, the step is still completed before its error is returned. */
trocar_status sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, const after_tick *after, trocar_output *output, trocar_error *why);

#endif

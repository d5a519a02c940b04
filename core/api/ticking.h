/* The ticking thread's side of a simulation. */
#ifndef TROCAR_TICKING_H
#define TROCAR_TICKING_H

#include "api/api.h"

/* Returns BAD_INPUT if `needle` is out of range. RT */
trocar_status check_needle(const trocar_sim *sim, int needle, trocar_error *why);

/* Returns BAD_INPUT if the pose is not finite or its quaternion is not of unit length. RT */
trocar_status check_pose(const trocar_pose *p, pose *out, trocar_error *why);

/* Returns the state of the probe last published by the worker; NULL if there is no probe. RT */
const shown_probe *shown_probe_of(const trocar_sim *sim);

/* Returns the needle's visible state and, unless `stamp` is NULL, its stamp. For a resting needle, this is the state last published by the worker. RT */
const insertion_state *state_of_needle(const trocar_sim *sim, int needle, uint64_t *stamp);

/* Returns the pose of the base. Held needle: the pose last given, displaced by the deflection of its spring. Resting needle: its current pose. RT */
pose base_of_needle(const trocar_sim *sim, int needle);

/* If the worker has returned the needle, adopts its state. RT */
void adopt_needle(trocar_sim *sim, sim_needle *needle);

/* Fills the message about a needle that is being left in the tissue: its state, and the tracks of other needles near its tip. RT */
void fill_message_of_left_needle(trocar_sim *sim, int needle);

/* Returns the input for a tick of this needle. RT */
tick_input tick_of(const trocar_sim *sim, int needle, const compliance_snapshot *answer, double dt);

/* Computes one tick with the snapshot `answer`. If the result is not finite, the insertion restarts, because a non-finite number would persist in the
   state; the status is then NUMERIC. RT */
trocar_status run_tick(trocar_sim *sim, int needle, const compliance_snapshot *answer, pose base, double dt, trocar_output *output);

/* Tells the worker how the needle supports the tissue against the probe (needle_hold). To be called after run_tick, with the same answer. RT */
void post_hold(trocar_sim *sim, sim_needle *needle, const compliance_snapshot *answer);

/* A function to be called after a tick with a finite result, with the data of that tick, before the worker answers the tick's request. */
typedef struct {
    trocar_status (*call)(const tick_input *tick, const insertion_state *state, const insertion_workspace *workspace, void *context, trocar_error *why);
    void *context;
} after_tick;

/* Implements trocar_sim_step. `after` may be NULL; its error is returned after the step has been completed. Implemented in api_sim.c. */
trocar_status sim_step(trocar_sim *sim, int needle, const trocar_pose *base, double dt, const after_tick *after, trocar_output *output, trocar_error *why);

#endif

/* The ticking thread's side of a simulation. */
#ifndef TROCAR_TICKING_H
#define TROCAR_TICKING_H

#include "api/api.h"

/* BAD_INPUT if `needle` is out of range. RT */
trocar_status check_needle(const trocar_sim *sim, int needle, report *why);

/* BAD_INPUT if the pose is not finite or its quaternion is not of unit length. RT */
trocar_status check_pose(const trocar_pose *p, pose *out, report *why);

/* The probe as last published by the worker; NULL if there is no probe. RT */
const shown_probe *shown_probe_of(const trocar_sim *sim);

/* The visible state: for a resting needle, the state last published by the worker. RT */
const insertion_state *state_of_needle(const trocar_sim *sim, int needle, uint64_t *stamp);

/* The base: as given last, moved by its spring; of a needle that rests, its current pose. RT */
pose base_of_needle(const trocar_sim *sim, int needle);

/* Adopts the state of a needle that the worker has returned, if it has. RT */
void adopt_needle(trocar_sim *sim, needle_track *needle);

/* Fills the message about a needle that is left, including the tracks of all needles. RT */
void fill_left(trocar_sim *sim, int needle);

/* Computes one tick with the snapshot `answer`. A non-finite number would stay in the state, so in that case the insertion restarts and the result is NUMERIC.
   RT */
trocar_status run_tick(trocar_sim *sim, int needle, const compliance_snapshot *answer, pose base, double dt, trocar_output *output);

#endif

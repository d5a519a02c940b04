/* The ticking thread's side of a simulation. */
#ifndef TROCAR_TICKING_H
#define TROCAR_TICKING_H

#include "api/api.h"

/* BAD_INPUT for a needle that does not exist. RT */
trocar_status check_needle(const trocar_sim *sim, int needle, report *why);

/* BAD_INPUT for what is not finite or not of unit length. RT */
trocar_status check_pose(const trocar_pose *p, pose *out, report *why);

/* What the worker has shown last; NULL: there is no probe. RT */
const shown_probe *shown_probe_of(const trocar_sim *sim);

/* The state to show: of a needle that rests, what the worker has made of it last. RT */
const insertion_state *state_of_needle(const trocar_sim *sim, int needle, uint64_t *stamp);

/* The base: as given last, moved by its spring; of a needle that rests, its current pose. RT */
pose base_of_needle(const trocar_sim *sim, int needle);

/* Goes on with a needle that the worker has handed back, if it has. RT */
void adopt_needle(trocar_sim *sim, needle_track *needle);

/* Fills in what is handed over of a needle that is left, with the tracks of all. RT */
void fill_left(trocar_sim *sim, int needle);

/* One tick with what `answer` knows of the tissue. A number that is not finite would stay in the state: then the insertion starts
   over, and the outcome is NUMERIC. RT */
trocar_status run_tick(trocar_sim *sim, int needle, const compliance_snapshot *answer, pose base, double dt, trocar_output *output);

#endif

/* Newton passes, each consisting of the stages needle, problem, solve and advance, until the state is in equilibrium. See docs/mechanics.md, "One tick is one
   convex problem". */
#ifndef TROCAR_PASSES_H
#define TROCAR_PASSES_H

#include "insertion/state/tick_data.h"

/* Outcome of a series of passes. */
typedef struct {
    bool found;              /* all contact problems had solutions */
    bool converged;
    bool diverging;
    bool saddle;             /* the equilibrium is unstable */
    bool leapt;              /* a segment has rotated so far from its direction in w->start that the needle may be on another branch */
} pass_result;

static inline bool passes_are_stable(pass_result r) { return r.found && r.converged && !r.saddle; } /* RT */

/* Locates the points on the needle's current shape, for its current forces. To be called before the first pass. RT */
void passes_begin(const tick_input *tick, const insertion_state *state, insertion_workspace *w);

/* Restores the checkpoint w->start, and assembles the contact problem for the restored shape and forces. RT */
void passes_go_back(const tick_input *tick, insertion_state *state, insertion_workspace *w);

/* Linearises needle and tissue (in the first pass, about the current shape and forces) and assembles the contact problem. RT */
void passes_linearise(const tick_input *tick, const insertion_state *state, insertion_workspace *w, bool first);

/* Runs up to `most` passes, starting from the current shape. RT */
pass_result passes_run(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output, int most);

/* Adds the forces of all points, and the drag, to the loads on the needle's joints. RT */
void passes_load_joints(const tick_input *tick, const insertion_state *state, const contact_points *points, needle_response *response, const pass_checkpoint *start);

/* Largest rotation (rad) of a segment relative to the given shape of the needle. RT */
double passes_turned_since(const tick_input *tick, const insertion_state *state, const needle_state *shape);

/* Euler load (N) of the needle, clamped at its base and hinged at its tip. RT */
double euler_load(const needle_model *needle);

#endif

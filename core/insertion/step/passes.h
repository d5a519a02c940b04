/* Newton passes. Each runs the stages needle, problem, solve and advance; they repeat until the state is in equilibrium. See docs/mechanics.md, "One tick is
   one convex problem". */
#ifndef TROCAR_PASSES_H
#define TROCAR_PASSES_H

#include "insertion/state/tick_data.h"

/* Outcome of passes_run. */
typedef struct {
    bool found;              /* every pass's contact problem had a solution */
    bool converged;
    bool diverging;
    bool saddle;             /* the equilibrium is unstable */
    bool leapt;              /* a segment has rotated so far since w->start that the needle may be on another branch of equilibria */
} pass_result;

static inline bool passes_are_stable(pass_result r) { return r.found && r.converged && !r.saddle; } /* RT */

/* Locates the points for the needle's current shape and forces. Call this before the first pass. RT */
void passes_begin(const tick_input *tick, const insertion_state *state, insertion_workspace *w);

/* Restores the checkpoint w->start and assembles the contact problem for its shape and forces. RT */
void passes_go_back(const tick_input *tick, insertion_state *state, insertion_workspace *w);

/* Linearises needle and tissue and assembles the contact problem. If `first`, the tissue is linearised about the current shape and forces. RT */
void passes_linearise(const tick_input *tick, const insertion_state *state, insertion_workspace *w, bool first);

/* Runs up to `most` passes, starting from the current shape. RT */
pass_result passes_run(const tick_input *tick, insertion_state *state, insertion_workspace *w, tick_output *output, int most);

/* Computes the loads on the needle's joints: the forces of all points, and the drag. RT */
void passes_load_joints(const tick_input *tick, const insertion_state *state, const contact_points *points, needle_response *response, const pass_checkpoint *start);

/* Returns the largest rotation (rad) of a segment relative to `shape`. RT */
double passes_turned_since(const tick_input *tick, const insertion_state *state, const needle_state *shape);

/* Returns the Euler load (N) of the needle, clamped at its base and hinged at its tip. RT */
double euler_load(const needle_model *needle);

#endif

/* A single insertion in lockstep, without trocar.h, for tests that look at internal state. */
#ifndef TROCAR_ORACLES_RUN_H
#define TROCAR_ORACLES_RUN_H

#include "model/model_parts.h"

typedef struct {
    model_parts *parts;
    remesher *remesher;
    insertion_workspace *workspace;
    vec3 *field_scratch;
} needle_run;

/* Creates the run. `parts` must outlive it. If this fails, nothing stays allocated. */
trocar_status run_create(model_parts *parts, needle_run *r, trocar_error *why);
void run_free(needle_run *r);

/* Runs one tick, after which the remesher answers its request for the next. The result is deterministic. The caller sets base and dt of `tick`; this
   function sets the other members. */
trocar_status run_step(needle_run *r, tick_input tick, insertion_state *state, compliance_snapshot *snapshot, tick_output *output, trocar_error *why);

/* The complete mutable state between two ticks: about 2 MB of plain data. */
typedef struct {
    insertion_state state;
    compliance_snapshot snapshot;
} checkpoint;

void run_save(const insertion_state *state, const compliance_snapshot *snapshot, checkpoint *saved);

/* Restores the state in this run or in another with the same configuration. The results continue as after the save. They are bit-identical for the nested
   method with a dense or condensed inverse, and equal except for rounding errors for other methods, for the sparse inverse, and outside the region of a
   condensed inverse. */
trocar_status run_restore(needle_run *r, const checkpoint *saved, insertion_state *state, compliance_snapshot *snapshot, trocar_error *why);

/* Same as model_parts_field, for this needle alone. */
void run_displacement(needle_run *r, const insertion_state *state, vec3 *nominal, vec3 *added);

#endif

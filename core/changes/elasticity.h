/* The moduli that a simulation uses, and how they change. The mesh's compliance belongs to the worker, the local compliances to the ticking thread; both follow
   the same ramp. Models are constant: a change goes from one model to another, which is built beforehand. See docs/training/changes.md. */
#ifndef TROCAR_ELASTICITY_H
#define TROCAR_ELASTICITY_H

#include <stdatomic.h>
#include <stdint.h>

#include "changes/changing.h"
#include "changes/stiffness_ramp.h"
#include "inverse/inverse_mixed.h"
#include "trocar.h"

/* The ticking thread begins a change (MOVING), the worker completes it (SETTLED), and the ticking thread then drops the old model (STILL). The worker may read
   `from`, `to` and `ramp` only while MOVING. */
typedef enum { ELASTICITY_STILL, ELASTICITY_MOVING, ELASTICITY_SETTLED } elasticity_stage;

/* A model whose moduli a simulation uses now or after the change. core/api counts the references to it. */
typedef struct {
    trocar_model *model;
    const model_parts *parts;
} moduli;

/* Progress of a change. Saved. */
typedef struct {
    double part;             /* from 0 to 1, how much of the change the ticking thread has completed */
    double duration, time;   /* s: duration of the change; simulated time of the last update of `part` */
    double mixed, mixed_at;  /* used by the worker: how much of the change the mesh's compliance has completed (0 to 1), and simulated time (s) of its last
                                step */
} change_course;

typedef struct {
    atomic_int stage;
    moduli from, to;         /* the same model unless MOVING or SETTLED */
    stiffness_ramp ramp;
    change_course course;
    uint64_t moves;          /* used by the ticking thread: steps taken so far */
    _Atomic double part;     /* course.part, for the worker */
    _Atomic double mixed;    /* course.mixed, for the ticking thread */
} elasticity;

/* ---- the ticking thread. All RT ---- */

/* Begins a change at this simulated time (s). Call this only in stage STILL. */
void elasticity_change(elasticity *e, moduli to, double time, double duration);

/* Advances the change to a later simulated time (s) and applies the local compliances. Returns true once the worker has completed the change; the caller then
   replaces `from`, the old model, with `to`. */
bool elasticity_follow(elasticity *e, values_in_use *ticking, double time);
void elasticity_rest(elasticity *e); /* call this after replacing `from` */

/* Returns the weight (0 to 1) of `to` in the ticking thread. */
double elasticity_weight(const elasticity *e);

/* Returns the simulated time (s) until the change is complete; 0 if none is under way. */
double elasticity_left(const elasticity *e);

/* ---- the worker ---- */

/* True if the mesh's compliance is behind the ticking thread and should advance by a step at the simulated time `now` (s): as soon as a needle feels the last
   step (`felt`), or 20 ms after that step. */
bool elasticity_lags(const elasticity *e, double now, bool felt);

/* Advances the mesh's compliance by at most one step. */
void elasticity_mix(elasticity *e, inverse *mixed, values_in_use *worker, double now);

/* ---- both: between lockstep steps ---- */

size_t elasticity_state_size(void);
void elasticity_save(state_stream *to, elasticity *e, const trocar_model *original);

/* The moduli in a saved state. config[0], config[1]: moduli before and after the change. Before elasticity_read, the caller sets both to those of the
   simulation's model. */
typedef struct {
    int moves;
    change_course course;
    simulation_config config[2];
} saved_elasticity;

void elasticity_read(state_stream *from, saved_elasticity *saved);
void elasticity_resume(elasticity *e, const saved_elasticity *saved, moduli from, moduli to, inverse *mixed, sim_changing *changing);

#endif

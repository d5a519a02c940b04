/* The moduli that a simulation uses, and changes to them. The mesh's compliance belongs to the worker, and the local compliances to the ticking thread; both
   follow the same ramp. Models are constant: a change goes from one model to another, which is built beforehand. See docs/training/changes.md. */
#ifndef TROCAR_ELASTICITY_H
#define TROCAR_ELASTICITY_H

#include <stdatomic.h>
#include <stdint.h>

#include "changes/changing.h"
#include "changes/stiffness_ramp.h"
#include "inverse/inverse_mixed.h"
#include "trocar.h"

/* The ticking thread begins a change (MOVING), the worker completes it (SETTLED), and the ticking thread then drops the old model (STILL). The worker reads
   `from`, `to` and `ramp` only while MOVING. */
typedef enum { ELASTICITY_STILL, ELASTICITY_MOVING, ELASTICITY_SETTLED } elasticity_stage;

/* A model whose moduli a simulation uses, or will use after the change. core/api counts the references to it. */
typedef struct {
    trocar_model *model;
    const model_parts *parts;
} moduli;

/* Progress of a change. Saved. */
typedef struct {
    double part;             /* from 0 to 1, fraction of the change that the ticking thread has completed */
    double duration, time;   /* s: duration of the change; simulated time at which `part` was last updated */
    double mixed, mixed_at;  /* used by the worker: fraction of the change that the mesh's compliance has completed, and simulated time (s) of its last
                                step */
} change_course;

typedef struct {
    atomic_int stage;
    moduli from, to;         /* the same model unless MOVING or SETTLED */
    stiffness_ramp ramp;
    change_course course;
    uint64_t moves;          /* used by the ticking thread: number of steps taken so far */
    _Atomic double part;     /* course.part, for the worker */
    _Atomic double mixed;    /* course.mixed, for the ticking thread */
} elasticity;

/* ---- the ticking thread. All RT ---- */

/* Begins a change at this simulated time (s). To be called in stage STILL. */
void elasticity_change(elasticity *e, moduli to, double time, double duration);

/* Advances the change to a later simulated time (s), and applies the local compliances. Returns true once the worker has completed the change; the caller
   then replaces `from`, the old model, by `to`. */
bool elasticity_follow(elasticity *e, values_in_use *ticking, double time);
void elasticity_rest(elasticity *e); /* to be called after `from` has been replaced */

/* Returns the weight (0 to 1) of `to` in the ticking thread. */
double elasticity_weight(const elasticity *e);

/* Simulated time in s until the change is complete; 0 if none is under way. */
double elasticity_left(const elasticity *e);

/* ---- the worker ---- */

/* True if the mesh's compliance is behind the ticking thread and should advance by a step at the simulated time `now` (s): once a needle feels the last step
   (`felt`), or 20 ms after that step. */
bool elasticity_lags(const elasticity *e, double now, bool felt);

/* Advances the mesh's compliance by at most one step. */
void elasticity_mix(elasticity *e, inverse *mixed, values_in_use *worker, double now);

/* ---- both: between lockstep steps ---- */

size_t elasticity_state_size(void);
void elasticity_save(state_stream *to, elasticity *e, const trocar_model *original);

/* The moduli in a saved state. config[0], config[1]: moduli before and after the change; the caller of elasticity_read first sets both to those of the
   simulation's model. */
typedef struct {
    int moves;
    change_course course;
    simulation_config config[2];
} saved_elasticity;

void elasticity_read(state_stream *from, saved_elasticity *saved);
void elasticity_resume(elasticity *e, const saved_elasticity *saved, moduli from, moduli to, inverse *mixed, sim_changing *changing);

#endif

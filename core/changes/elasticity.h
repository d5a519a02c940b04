/* The moduli that a simulation uses, and their change. The mesh's compliance belongs to the worker, and the local compliances to the ticking thread; both
   follow the same ramp. Models are constant: a change leads from one to another, which is built beforehand. See docs/training/changes.md. */
#ifndef TROCAR_ELASTICITY_H
#define TROCAR_ELASTICITY_H

#include <stdatomic.h>
#include <stdint.h>

#include "changes/changing.h"
#include "changes/stiffness_ramp.h"
#include "inverse/inverse_mixed.h"
#include "trocar.h"

/* The ticking thread begins a change (MOVING), the worker completes it (SETTLED), and the ticking thread then gives up the old model (STILL). The worker reads
   `from`, `to` and `ramp` only while MOVING. */
typedef enum { ELASTICITY_STILL, ELASTICITY_MOVING, ELASTICITY_SETTLED } elasticity_stage;

/* A model whose moduli a simulation uses, or will use after the change. core/api counts the references to it. */
typedef struct {
    trocar_model *model;
    const model_parts *parts;
} moduli;

/* How far a change has come. Saved. */
typedef struct {
    double part;             /* from 0 to 1, part of the change that the ticking thread has completed */
    double duration, time;   /* s: duration of the change; simulated time at which `part` was last updated */
    double mixed, mixed_at;  /* used by the worker: part of the change that the mesh's compliance has completed, and the simulated time (s) of its last step */
} change_course;

typedef struct {
    atomic_int stage;
    moduli from, to;         /* the same model unless MOVING or SETTLED */
    stiffness_ramp ramp;
    change_course course;
    uint64_t moves;          /* used by the ticking thread: number of steps that it has taken */
    _Atomic double part;     /* course.part, for the worker */
    _Atomic double mixed;    /* course.mixed, for the ticking thread */
} elasticity;

/* ---- the ticking thread. All RT ---- */

/* Begins a change at this simulated time (s). To be called in stage STILL. */
void elasticity_change(elasticity *e, moduli to, double time, double duration);

/* Advances the change to a later simulated time (s), and applies the local compliances. Returns true if the change is complete: `from` is the old model, which
   the caller replaces by `to`. */
bool elasticity_follow(elasticity *e, values_in_use *ticking, double time);
void elasticity_rest(elasticity *e); /* to be called after `from` has been replaced */

/* Weight of `to`, from 0 to 1, that the ticking thread uses. */
double elasticity_weight(const elasticity *e);

/* Simulated time in s until the change is complete; 0 if none is under way. */
double elasticity_left(const elasticity *e);

/* ---- the worker ---- */

/* True if the mesh's compliance should move by a step at the simulated time `now` (s): when a needle feels the last step (`felt`), or 20 ms after it. */
bool elasticity_lags(const elasticity *e, double now, bool felt);

/* Moves the mesh's compliance by at most one step. */
void elasticity_mix(elasticity *e, inverse *mixed, values_in_use *worker, double now);

/* ---- both: between lockstep steps ---- */

size_t elasticity_state_size(void);
void elasticity_save(state_stream *to, elasticity *e, const trocar_model *original);

/* The moduli in a saved state. config[0], config[1]: moduli before and after the change; before elasticity_read, those of the simulation's model. */
typedef struct {
    int moves;
    change_course course;
    simulation_config config[2];
} saved_elasticity;

void elasticity_read(state_stream *from, saved_elasticity *saved);
void elasticity_resume(elasticity *e, const saved_elasticity *saved, moduli from, moduli to, inverse *mixed, sim_changing *changing);

#endif

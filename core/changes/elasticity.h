/* The moduli that a simulation uses, and their change. The mesh's compliance belongs to the worker, and the local compliances to the ticking thread; both move
   along the same ramp. Models are constant: a change leads from one to another, which was built in advance. See docs/training/changes.md. */
#ifndef TROCAR_ELASTICITY_H
#define TROCAR_ELASTICITY_H

#include <stdatomic.h>

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
    double part;             /* from 0 to 1: of the ticking thread */
    double duration, time;   /* s: of the change; simulated time for which `part` holds */
    double mixed, mixed_at;  /* used by the worker: part that the mesh's compliance has reached, and the simulated time, s, at which it last moved */
} change_course;

typedef struct {
    atomic_int stage;
    moduli from, to;         /* the same model unless MOVING or SETTLED */
    stiffness_ramp ramp;
    change_course course;
    _Atomic double part;     /* course.part, for the worker */
} elasticity;

/* ---- the ticking thread. All RT ---- */

/* Begins a change, at this simulated time, s. To be called while STILL. */
void elasticity_change(elasticity *e, moduli to, double time, double duration);

/* Moves on to a later simulated time, and applies the local compliances. Returns true if the change is complete: `from` is the old model, which the caller
   replaces by `to`. */
bool elasticity_follow(elasticity *e, values_in_use *ticking, double time);
void elasticity_rest(elasticity *e); /* to be called after that */

/* The weight of `to` for the ticking thread. */
double elasticity_weight(const elasticity *e);

/* Simulated time in s until the change is complete; 0 if none is under way. */
double elasticity_left(const elasticity *e);

/* ---- the worker ---- */

/* Moves the mesh's compliance by at most one step, at this simulated time, s. Returns true if it has changed. The step after it waits until a needle feels it,
   or 20 ms. */
bool elasticity_mix(elasticity *e, inverse *mixed, values_in_use *worker, double now, bool felt);

/* ---- both: between lockstep steps ---- */

size_t elasticity_state_size(void);
void elasticity_save(state_stream *to, elasticity *e, const trocar_model *original);

/* What a saved state contains. moduli[0] and [1]: configurations between which they move; on entry, those of the simulation's model. */
typedef struct {
    int moves;
    change_course course;
    simulation_config config[2];
} saved_elasticity;

void elasticity_read(state_stream *from, saved_elasticity *saved);
void elasticity_resume(elasticity *e, const saved_elasticity *saved, moduli from, moduli to, inverse *mixed, sim_changing *changing);

#endif

#include "changes/elasticity.h"

static const double PATIENCE = 0.02;   /* s of simulated time: longest delay between two steps (see elasticity_lags). Chosen: longer than the worker needs for
                                          an answer, much shorter than a change */
static const double WHOLE = 1.0 - 1e-9; /* fraction above which a change counts as complete. Rounding tolerance */

static const double MOST_AHEAD = 5.0;  /* steps: how far the ticking thread may get ahead of the worker, whose steps take longer if there are resting needles.
                                          Chosen: a change in compliance of 10 %, more than a worker that keeps up ever lags */

static elasticity_stage stage_of(const elasticity *e) { return (elasticity_stage)atomic_load_explicit(&e->stage, memory_order_acquire); }
static void set_stage(elasticity *e, elasticity_stage stage) { atomic_store_explicit(&e->stage, (int)stage, memory_order_release); }

static void use(values_in_use *v, const elasticity *e, double weight) {
    const insertion_model *from = &e->from.parts->insertion, *to = &e->to.parts->insertion;
    v->model.local = weight == 1.0 ? to->local : from->local;
    v->model.next = weight == 0.0 ? from->local : to->local;
    v->model.weight = weight == 1.0 ? 0.0 : weight;
    v->model.stiffens = (weight < 1.0 && from->stiffens) || (weight > 0.0 && to->stiffens);
    for (int g = 0; g < MESH_MAX_GROUPS; g++) mix_moduli(&e->from.parts->materials[g], &e->to.parts->materials[g], weight, &v->now.materials[g]);
}

/* ---- the ticking thread -------------------------------------------------------------------------------------------------------- */

static void set_mixed(elasticity *e, double mixed) {
    e->course.mixed = mixed;
    atomic_store_explicit(&e->mixed, mixed, memory_order_release);
}

static void set_part(elasticity *e, double part) {
    e->course.part = part;
    atomic_store_explicit(&e->part, part, memory_order_release);
}

void elasticity_change(elasticity *e, moduli to, double time, double duration) {
    e->to = to;
    e->ramp = ramp_between(&e->from.parts->config, &to.parts->config);
    e->course.duration = duration;
    e->course.time = time;
    set_part(e, 0.0);
    set_mixed(e, 0.0);
    set_stage(e, ELASTICITY_MOVING);
}

bool elasticity_follow(elasticity *e, values_in_use *ticking, double time) {
    elasticity_stage stage = stage_of(e);
    if (stage != ELASTICITY_MOVING) return stage == ELASTICITY_SETTLED;
    double step = ramp_step(&e->ramp), limit = atomic_load_explicit(&e->mixed, memory_order_acquire) + MOST_AHEAD * step;
    double part = larger_of(e->course.part, smaller_of(e->course.part + smaller_of((time - e->course.time) / e->course.duration, step), limit));
    e->course.time = time;
    if (part > WHOLE) part = 1.0;
    use(ticking, e, ramp_weight(&e->ramp, part));
    set_part(e, part);
    e->moves++;
    return false;
}

void elasticity_rest(elasticity *e) { set_stage(e, ELASTICITY_STILL); }

double elasticity_weight(const elasticity *e) { return stage_of(e) == ELASTICITY_STILL ? 0.0 : ramp_weight(&e->ramp, e->course.part); }

double elasticity_left(const elasticity *e) {
    static const double LAST = 1e-3; /* s, returned if only the worker still has to complete the change. Chosen: one tick */
    return stage_of(e) == ELASTICITY_STILL ? 0.0 : larger_of((1.0 - e->course.part) * e->course.duration, LAST);
}

/* ---- the worker ------------------------------------------------------------------------------------------------------------------ */

bool elasticity_lags(const elasticity *e, double now, bool felt) {
    const change_course *c = &e->course;
    return stage_of(e) == ELASTICITY_MOVING && atomic_load_explicit(&e->part, memory_order_acquire) > c->mixed && (felt || now >= c->mixed_at + PATIENCE);
}

void elasticity_mix(elasticity *e, inverse *mixed, values_in_use *worker, double now) {
    change_course *c = &e->course;
    set_mixed(e, smaller_of(atomic_load_explicit(&e->part, memory_order_acquire), c->mixed + ramp_step(&e->ramp)));
    c->mixed_at = now;
    bool complete = c->mixed > WHOLE;
    double weight = complete ? 1.0 : ramp_weight(&e->ramp, c->mixed);
    inverse_mix(mixed, complete ? e->to.parts->inverse : e->from.parts->inverse, e->to.parts->inverse, weight);
    use(worker, e, weight);
    if (!complete) return;
    set_mixed(e, 0.0);
    set_stage(e, ELASTICITY_SETTLED);
}

/* ---- saved states ------------------------------------------------------------------------------------------------------------------- */

size_t elasticity_state_size(void) { return sizeof(change_course) + 2 * (MAX_MODULI + 1) * sizeof(double); }

static void pass_moduli(state_stream *s, simulation_config *config) {
    double *moduli[MAX_MODULI];
    int count = simulation_moduli(config, moduli);
    for (int i = 0; i < count; i++) STREAM(s, *moduli[i]);
}

/* Streams each member separately, because saved_layout does not include the size of this struct. */
static void pass_course(state_stream *s, change_course *c) {
    STREAM(s, c->part);
    STREAM(s, c->duration);
    STREAM(s, c->time);
    STREAM(s, c->mixed);
    STREAM(s, c->mixed_at);
}

void elasticity_save(state_stream *to, elasticity *e, const trocar_model *original) {
    int moves = stage_of(e) == ELASTICITY_MOVING, differs = moves || e->to.model != original;
    stream_count(to, &differs, 1);
    if (!differs) return;
    pass_moduli(to, (simulation_config *)&e->to.parts->config); /* cast away const: an output stream only reads the configuration */
    stream_count(to, &moves, 1);
    if (!moves) return;
    pass_moduli(to, (simulation_config *)&e->from.parts->config);
    pass_course(to, &e->course);
}

void elasticity_read(state_stream *from, saved_elasticity *saved) {
    int differs;
    saved->moves = 0;
    saved->course = (change_course){0};
    stream_count(from, &differs, 1);
    if (differs) {
        pass_moduli(from, &saved->config[1]);
        stream_count(from, &saved->moves, 1);
        saved->config[0] = saved->config[1];
    }
    if (!saved->moves) return;
    pass_moduli(from, &saved->config[0]);
    pass_course(from, &saved->course);
}

void elasticity_resume(elasticity *e, const saved_elasticity *saved, moduli from, moduli to, inverse *mixed, sim_changing *changing) {
    e->from = from;
    e->to = to;
    e->ramp = ramp_between(&from.parts->config, &to.parts->config);
    e->course = saved->course;
    set_part(e, saved->course.part);
    set_mixed(e, saved->course.mixed);
    set_stage(e, saved->moves ? ELASTICITY_MOVING : ELASTICITY_STILL);
    double weight = ramp_weight(&e->ramp, saved->course.mixed);
    inverse_mix(mixed, from.parts->inverse, to.parts->inverse, weight);
    if (!changing) return; /* nothing has been changed since the simulation was created */
    use(&changing->worker, e, weight);
    use(&changing->ticking, e, ramp_weight(&e->ramp, saved->course.part));
}

#include "coupling/virtual_coupling.h"

#include "common/coupling_rule.h"

static const double DEFAULT_ROUND_TRIP = 5e-3; /* s, assumed until one has been measured */
static const double RISE = 0.02, FALL = 0.002; /* filter weights per round trip. With these, the estimate stays near the longest of the last ten round trips */
static const double MEAN = 0.02;            /* weight of the newest interval between poses in the running mean */
static const double ACTIVE_ENERGY = 1e-3;   /* J, if the hand has received more energy than this, the coupling counts as active */

enum { SWINGS = 4 };                        /* number of undamped swings after which to soften the coupling */
static const double STEP = 2.0;             /* factor from one level of caution to the next; each level divides the stiffness by four */
static const double LONGEST_DELAY = 40e-3;  /* s, longest delay to design the coupling for. At this delay, the coupling is too soft to make a hand oscillate */
static const double PAUSE = 0.5;            /* s without undamped swings after which an oscillation is considered over */
static const double SETTLE = 1.0;           /* s, time constant with which the caution factor falls to its level */
static const double LOADED = 0.1;           /* N: only while the hand feels at least this force can one tell whether the loop is stable */
/* s under load after which to lower the caution level, and the factor by which to extend this time if that was a mistake */
static const double PATIENCE = 20.0, MORE_PATIENCE = 4.0;

void coupling_engage(virtual_coupling *p, const pose_sample *hand) {
    coupling_caution *c = &p->caution;
    if (c->level == 0.0) *c = (coupling_caution){.factor = 1.0, .level = 1.0};
    if (c->patience == 0.0 || p->session != hand->session) c->patience = PATIENCE;
    c->trusted = c->level;
    c->own = false;
    p->session = hand->session;
    p->rendered = hand->wrench_tick >= 0;
    p->received = hand->received;
    p->hand = hand->base;
    p->delay = DEFAULT_ROUND_TRIP;
    p->interval = 0.0;
    p->stretch = p->before = v3(0, 0, 0);
    p->age = 0.0;
    p->energy = p->lowest = 0.0;
    swing_begin(&p->swings, hand->base.position, hand->received);
}

/* ---- caution -------------------------------------------------------------------------------------------------------- */

/* Raises the caution level because the hand keeps oscillating. At the highest level, the coupling is too soft to cause this, so the oscillation is the hand's
   own. */
static void raise_caution(coupling_caution *c, double known) {
    if (c->lowered) c->patience *= MORE_PATIENCE;
    c->own |= c->level * known > 0.9 * LONGEST_DELAY;
    if (!c->own) c->level = fmin(STEP * c->level, LONGEST_DELAY / known);
    c->lowered = false;
    c->loaded = 0.0;
}

/* Handles a new pose. `lasting`: the result of swing_observe. */
static void heed_swings(virtual_coupling *p, int lasting) {
    coupling_caution *c = &p->caution;
    if (lasting == 0 || !(p->known > 0.0)) return;
    if (c->calm > PAUSE) c->trusted = c->level;
    c->calm = c->loaded = 0.0;
    if (lasting % SWINGS == 0) raise_caution(c, p->known);
}

/* Advances the time without undamped swings. Lowers the caution level after enough time under load; without load, calm says nothing about the loop's stability.
   After an oscillation of the hand's own, returns to the level before it. */
static void heed_calm(coupling_caution *c, bool loaded, double dt) {
    c->calm += dt;
    if (loaded) c->loaded += dt;
    bool over = c->own && c->calm > PAUSE, stable = c->level > 1.0 && c->loaded > c->patience;
    if (over) c->level = c->trusted;
    if (stable) c->level = fmax(1.0, c->level / STEP);
    if (over || stable) c->loaded = 0.0;
    c->own &= !over;
    c->lowered |= stable;
    c->factor = c->level > c->factor ? c->level : c->factor + fmin(1.0, dt / SETTLE) * (c->level - c->factor);
}

/* ---- poses ---------------------------------------------------------------------------------------------------------- */

static const coupling_wrench *wrench_of(const virtual_coupling *p, int64_t tick) { return &p->sent[(uint64_t)tick % COUPLING_TICKS]; }

/* Returns which tick's wrench a pose responds to. A client that renders no force sends -1 minus the tick. */
static int64_t tick_named(const pose_sample *hand) { return hand->wrench_tick >= 0 ? hand->wrench_tick : -1 - hand->wrench_tick; }

/* Returns the wrench that a pose responds to or, if that is not stored, the last one sent. */
static const coupling_wrench *wrench_named(const virtual_coupling *p, int64_t named) {
    const coupling_wrench *w = wrench_of(p, named);
    return named > 0 && w->tick == named ? w : wrench_of(p, p->newest);
}

/* Returns the wrench sent `time` (s) before `w`, or the oldest one stored. */
static const coupling_wrench *wrench_before(const virtual_coupling *p, const coupling_wrench *w, double time) {
    int64_t sent = w->computed - (int64_t)(1e9 * time);
    for (int i = 1; i < COUPLING_TICKS && w->computed > sent; i++) {
        const coupling_wrench *earlier = wrench_of(p, w->tick - 1);
        if (earlier->tick != w->tick - 1) break;
        w = earlier;
    }
    return w;
}

static void note_energy(virtual_coupling *p, const coupling_wrench *felt, const pose *now) {
    vec3 way = v3_sub(now->position, p->hand.position);
    vec3 turn = q_log(q_multiply(now->orientation, q_conjugate(p->hand.orientation)));
    p->energy -= v3_dot(felt->force, way) + v3_dot(felt->torque, turn);
    p->lowest = fmin(p->lowest, p->energy);
}

int64_t coupling_receive(virtual_coupling *p, const pose_sample *hand) {
    if (hand->received == p->received) return -1;
    int64_t tick = tick_named(hand);
    const coupling_wrench *named = wrench_named(p, tick), *felt = wrench_before(p, named, p->unseen);
    note_energy(p, felt, &hand->base);
    p->interval += MEAN * (1e-9 * (double)(hand->received - p->received) - p->interval);
    p->before = p->stretch;
    p->age = 0.0;
    p->received = hand->received;
    p->hand = hand->base;
    p->rendered |= hand->wrench_tick >= 0;
    heed_swings(p, swing_observe(&p->swings, hand->base.position, named->force, hand->received));
    if (named->tick != tick || named->tick <= p->felt) return -1;
    p->felt = named->tick;
    int64_t round_trip = hand->received - named->computed;
    double change = 1e-9 * (double)round_trip - p->delay;
    p->delay += (change > 0.0 ? RISE : FALL) * change;
    return round_trip;
}

/* ---- ticks ---------------------------------------------------------------------------------------------------------- */

pose coupling_hold(virtual_coupling *p, const trocar_device_limits *limits, pose hand, double dt, double *compliance) {
    *compliance = p->stiffness = p->damping = 0.0;
    if (!p->rendered || isinf(limits->max_stiffness)) return hand;
    double hold = fmax(p->interval, dt); /* s, how long a pose is used until the next one arrives */
    if (p->age >= 2.0 * hold) p->before = p->stretch; /* no more poses are coming, so let the damper come to rest */
    p->age += dt;
    heed_calm(&p->caution, v3_norm(wrench_of(p, p->newest)->force) > LOADED, dt);
    p->known = p->delay + hold + limits->delay;
    double delay = p->caution.factor * p->known;
    p->unseen = delay - p->known + limits->delay;
    p->stiffness = coupling_rule_stiffness(limits, delay);
    p->damping = coupling_rule_damping(p->stiffness, delay);
    *compliance = 1.0 / (p->stiffness + p->damping / hold);
    double memory = p->damping / hold * *compliance; /* fraction of the stretch that the damper retains */
    return (pose){v3_axpy(-memory, p->before, hand.position), hand.orientation};
}

vec3 coupling_yield(virtual_coupling *p, pose hand, vec3 base, vec3 force, vec3 torque) {
    p->stretch = v3_sub(hand.position, base);
    return v3_sub(torque, v3_cross(p->stretch, force));
}

void coupling_send(virtual_coupling *p, int64_t tick, int64_t now, vec3 force, vec3 torque) {
    p->sent[(uint64_t)tick % COUPLING_TICKS] = (coupling_wrench){tick, now, force, torque};
    p->newest = tick;
}

bool coupling_active(const virtual_coupling *p) { return p->energy < -ACTIVE_ENERGY || p->caution.level > 1.0; }

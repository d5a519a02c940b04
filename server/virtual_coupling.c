#include "virtual_coupling.h"

static const double LIGHTEST_HAND = 0.05;   /* kg, including the device's handle */
static const double FAR = 5e-3;             /* s, assumed round trip until it is known */
static const double RISE = 0.02, FALL = 0.002; /* filter weights per round trip: follows the longest one in ten */
static const double MEAN = 0.02;            /* filter weight of the newest interval, per pose */
static const double ACTIVE_ENERGY = 1e-3;   /* J */

/* A hand of mass m on a spring K and a damper B that respond after T is stable for K T^2 / m <= 0.3 with B = 2 K T: the delay acts
   as a damper of -K T, and the damper itself must be slow compared with the delay, B T / m <= 0.6. With any other spring in series,
   no more than K T / 8 of damping in the hand is then needed. */
static const double DELAY_MARGIN = 0.25, DAMPING = 2.0;

void coupling_engage(virtual_coupling *p, const pose_sample *hand) {
    p->received = hand->received;
    p->hand = hand->base;
    p->delay = FAR;
    p->interval = 0.0;
    p->stretch = p->before = v3(0, 0, 0);
    p->age = 0.0;
    p->energy = p->lowest = 0.0;
}

/* The wrench that the hand felt until this pose: the one that the pose names, or the last one sent. */
static const coupling_wrench *wrench_felt(const virtual_coupling *p, int64_t named) {
    const coupling_wrench *w = &p->sent[(uint64_t)named % COUPLING_TICKS];
    return named > 0 && w->tick == named ? w : &p->sent[(uint64_t)p->newest % COUPLING_TICKS];
}

static void note_energy(virtual_coupling *p, const coupling_wrench *felt, const pose *now) {
    vec3 way = v3_sub(now->position, p->hand.position);
    vec3 turn = q_log(q_multiply(now->orientation, q_conjugate(p->hand.orientation)));
    p->energy -= v3_dot(felt->force, way) + v3_dot(felt->torque, turn);
    p->lowest = fmin(p->lowest, p->energy);
}

int64_t coupling_receive(virtual_coupling *p, const pose_sample *hand) {
    if (hand->received == p->received) return -1;
    const coupling_wrench *felt = wrench_felt(p, hand->wrench_tick);
    note_energy(p, felt, &hand->base);
    p->interval += MEAN * (1e-9 * (double)(hand->received - p->received) - p->interval);
    p->before = p->stretch;
    p->age = 0.0;
    p->received = hand->received;
    p->hand = hand->base;
    if (felt->tick != hand->wrench_tick || felt->tick <= p->felt) return -1;
    p->felt = felt->tick;
    int64_t round_trip = hand->received - felt->computed;
    double change = 1e-9 * (double)round_trip - p->delay;
    p->delay += (change > 0.0 ? RISE : FALL) * change;
    return round_trip;
}

pose coupling_hold(virtual_coupling *p, double limit, pose hand, double dt, double *compliance) {
    *compliance = p->stiffness = p->damping = 0.0;
    if (isinf(limit)) return hand;
    double hold = fmax(p->interval, dt), delay = p->delay + hold; /* a pose is in use, or waits, for this time */
    if (p->age >= 2.0 * hold) p->before = p->stretch; /* the hand has stopped sending: the damper comes to rest */
    p->age += dt;
    p->stiffness = fmin(limit, DELAY_MARGIN * LIGHTEST_HAND / (delay * delay));
    p->damping = DAMPING * p->stiffness * delay;
    *compliance = 1.0 / (p->stiffness + p->damping / hold);
    double memory = p->damping / hold * *compliance; /* part of the stretch that the damper keeps */
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

bool coupling_active(const virtual_coupling *p) { return p->energy < -ACTIVE_ENERGY; }

/* Tests the virtual coupling alone and in the closed loop that it must keep stable: a simulated hand, a network with delay and loss, the coupling, and a
   needle in tissue or on a spring of any stiffness. */
#include <math.h>

#include "coupling/virtual_coupling.h"
#include "device/hand.h"
#include "lockstep.h"
#include "trocar_needle_wrench_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const double DT = 1e-3;
static const int64_t MS = 1000000;

static pose_sample sample(int64_t ms, double x, int64_t wrench_tick) {
    return (pose_sample){.held = true, .engagement = 1, .session = 1, .seq = ms, .received = ms * MS, .wrench_tick = wrench_tick,
                         .base = {v3(x, 0, 0), {1, 0, 0, 0}}};
}

/* Returns the limits of a device that adds no delay. The next call overwrites them. */
static const device_limits *limited_to(double stiffness) {
    static device_limits limits;
    limits = device_defaults();
    limits.max_stiffness = stiffness;
    limits.delay = 0.0;
    return &limits;
}

/* ---- the coupling alone ------------------------------------------------------------------------------------------------- */

static void round_trip_ends_with_the_first_acknowledging_pose(void **unused) {
    (void)unused;
    static virtual_coupling p;
    pose_sample s = sample(0, 0, 0);
    p = (virtual_coupling){0};
    coupling_engage(&p, &s);
    for (int64_t tick = 1; tick <= 5; tick++) coupling_send(&p, tick, tick * MS, v3(0, 0, 0), v3(0, 0, 0));
    s = sample(6, 0, 3);
    assert_int_equal(coupling_receive(&p, &s), 3 * MS);
    assert_int_equal(coupling_receive(&p, &s), -1); /* the same pose */
    /* Tests wrench numbers that are repeated, old, missing, in the future, without a force, or invalid. */
    static const int64_t others[] = {3, 2, 0, 900, -4, 3 + COUPLING_TICKS, INT64_MIN, INT64_MAX};
    for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
        s = sample(7 + (int64_t)i, 0, others[i]);
        assert_int_equal(coupling_receive(&p, &s), -1);
    }
    s = sample(20, 0, 5);
    assert_int_equal(coupling_receive(&p, &s), 15 * MS);
}

static void energy_is_the_work_of_the_hand_against_the_rendered_wrench(void **unused) {
    (void)unused;
    static virtual_coupling p;
    pose_sample s = sample(0, 0, 0);
    p = (virtual_coupling){0};
    coupling_engage(&p, &s);
    coupling_send(&p, 1, 0, v3(-2, 0, 0), v3(0, 0, -0.5));
    coupling_send(&p, 2, 0, v3(-4, 0, 0), v3(0, 0, 0));
    s = sample(1, 0.010, 1); /* 10 mm against 2 N, and 0.1 rad against 0.5 N m */
    s.base.orientation = q_exp(v3(0, 0, 0.1));
    coupling_receive(&p, &s);
    assert_true(fabs(p.energy - 0.07) < 1e-12 && p.lowest == 0.0 && !coupling_active(&p));
    s.received++;
    s.base.position.x = -0.010; /* 20 mm the other way, with 4 N */
    s.wrench_tick = 2;
    coupling_receive(&p, &s);
    assert_true(fabs(p.energy + 0.01) < 1e-12 && fabs(p.lowest + 0.01) < 1e-12 && coupling_active(&p));
}

static void rigid_coupling_changes_nothing(void **unused) {
    (void)unused;
    static virtual_coupling p;
    pose_sample s = sample(0, 0.1, 0);
    p = (virtual_coupling){0};
    coupling_engage(&p, &s);
    double compliance = 1;
    pose rest = coupling_hold(&p, limited_to(INFINITY), s.base, DT, &compliance);
    assert_memory_equal(&rest, &s.base, sizeof rest);
    assert_true(compliance == 0.0 && p.stiffness == 0.0);
}

/* A client that renders no wrenches refers to the newest one as -1 - tick. The round trip is measured, and the needle follows the poses rigidly. */
static void a_hand_without_force_holds_rigidly(void **unused) {
    (void)unused;
    static virtual_coupling p;
    pose_sample s = sample(0, 0.1, -1);
    p = (virtual_coupling){0};
    coupling_engage(&p, &s);
    double compliance = 1;
    for (int64_t tick = 1; tick <= 5; tick++) coupling_send(&p, tick, tick * MS, v3(0, 0, 0), v3(0, 0, 0));
    s = sample(6, 0.1, -1 - 3);
    assert_int_equal(coupling_receive(&p, &s), 3 * MS);
    coupling_hold(&p, limited_to(400), s.base, DT, &compliance);
    assert_true(compliance == 0.0 && p.stiffness == 0.0);
    s = sample(7, 0.1, 4); /* from here on, this client renders the wrench */
    assert_int_equal(coupling_receive(&p, &s), 3 * MS);
    coupling_hold(&p, limited_to(400), s.base, DT, &compliance);
    assert_true(compliance > 0.0 && p.stiffness > 0.0);
}

/* The stiffness follows from the device's values in the scene by the formula in docs/connect-a-device.md. */
static void stiffness_follows_delay_and_mass_of_the_device(void **unused) {
    (void)unused;
    static virtual_coupling p;
    p = (virtual_coupling){0};
    pose_sample s = sample(0, 0, 0);
    coupling_engage(&p, &s);
    for (int64_t ms = 1; ms < 20000; ms++) { /* 1 ms round trip, one pose per millisecond */
        s = sample(ms, 0, ms - 1);
        coupling_receive(&p, &s);
        coupling_send(&p, ms, ms * MS, v3(0, 0, 0), v3(0, 0, 0));
    }
    static const double delays[] = {0, 2e-3, 8e-3, 20e-3}, masses[] = {0.05, 0.1, 0.4};
    for (int d = 0; d < 4; d++)
        for (int m = 0; m < 3; m++) {
            double compliance, sum = 2e-3 + delays[d], rule = 0.125 * masses[m] / (sum * sum);
            device_limits limits = *limited_to(1000);
            limits.delay = delays[d];
            limits.mass = masses[m];
            coupling_hold(&p, &limits, s.base, DT, &compliance);
            assert_true(fabs(p.stiffness - fmin(1000, rule)) < 1e-3 * p.stiffness);
            assert_true(fabs(p.damping - 2 * p.stiffness * sum) < 1e-3 * p.damping);
        }
}

/* The energy of a motion is that of the wrench felt during it, which was sent one device delay before the wrench the pose refers to. */
static void energy_is_accounted_with_the_wrench_that_the_device_felt(void **unused) {
    (void)unused;
    static virtual_coupling p;
    p = (virtual_coupling){0};
    pose_sample s = sample(0, 0, 0);
    coupling_engage(&p, &s);
    device_limits limits = *limited_to(400);
    limits.delay = 3e-3;
    double compliance, expected = 0.0;
    for (int64_t ms = 1; ms < 200; ms++) {
        coupling_send(&p, ms, ms * MS, v3(-(double)ms, 0, 0), v3(0, 0, 0));
        double step = ms % 2 ? 1e-5 : 2e-5;
        s = sample(ms, s.base.position.x + step, ms);
        coupling_receive(&p, &s);
        coupling_hold(&p, &limits, s.base, DT, &compliance);
        expected += (ms == 1 ? 1 : fmax(0, (double)ms - 3)) * step; /* the delay applies from the second tick on; before the first there is no wrench */
        assert_true(fabs(p.energy - expected) < 1e-9);
    }
}

/* ---- caution: a hand that oscillates as it likes ---------------------------------------------------------------------------- */

/* A hand that sends one pose per millisecond. It either oscillates against an opposing force, with an amplitude of 2 mm and half-periods of 50 ms, or holds
   still under a force. */
typedef struct { virtual_coupling p; device_limits limits; int64_t ms; int swung; /* half periods */ } swinging;

static void go_on(swinging *w, double x, double force) {
    double compliance;
    w->ms++;
    pose_sample s = sample(w->ms, x, w->ms - 1);
    coupling_receive(&w->p, &s);
    coupling_hold(&w->p, &w->limits, s.base, DT, &compliance);
    coupling_send(&w->p, w->ms, w->ms * MS, v3(force, 0, 0), v3(0, 0, 0));
}

static void swing(swinging *w, int count) {
    for (int i = 0; i < 50 * count; i++) {
        double phase = M_PI * (w->swung + i / 50.0);
        go_on(w, 1e-3 * sin(phase), -0.05 * sin(phase));
    }
    w->swung += count;
}

static void rest(swinging *w, double seconds, double force) {
    for (int i = 0; i < 1000 * seconds; i++) go_on(w, 0, force);
}

static swinging *begin_to_swing(void) {
    static swinging w;
    w = (swinging){.limits = *limited_to(400)};
    w.limits.delay = 2e-3;
    pose_sample s = sample(0, 0, 0);
    coupling_engage(&w.p, &s);
    rest(&w, 5, 1.0);
    assert_true(fabs(w.p.stiffness - 400) < 1e-9 && !coupling_active(&w.p));
    return &w;
}

/* Four half-oscillations that do not decay soften the coupling by one level, even if the measured energy shows no instability. The ACTIVE flag reports this. */
static void lasting_swings_soften_the_coupling(void **unused) {
    (void)unused;
    swinging *w = begin_to_swing();
    swing(w, 3);
    assert_true(w->p.stiffness == 400);
    swing(w, 2);
    double delay = 2 * w->p.known;
    assert_true(w->p.caution.level == 2 && coupling_active(&w->p));
    assert_true(fabs(w->p.stiffness - fmin(400, 0.0125 / (delay * delay))) < 1e-9);
    swing(w, 4);
    assert_true(w->p.caution.level == 4 && w->p.stiffness < 110);
}

/* After some time under force without such oscillations, the coupling stiffens again, one level at a time. If it then oscillates again, it waits longer
   before the next attempt. */
static void the_coupling_recovers_slowly_and_learns(void **unused) {
    (void)unused;
    swinging *w = begin_to_swing();
    swing(w, 5);
    assert_true(w->p.caution.level == 2);
    rest(w, 60, 0.0); /* the needle moves through air; time without force does not count */
    assert_true(w->p.caution.level == 2);
    rest(w, 19, 1.0);
    assert_true(w->p.caution.level == 2);
    rest(w, 2, 1.0);
    assert_true(w->p.caution.level == 1 && w->p.caution.factor > 1.1); /* the stiffness does not change abruptly */
    rest(w, 10, 1.0);
    assert_true(!coupling_active(&w->p) && fabs(w->p.stiffness - 400) < 1e-3);
    swing(w, 5);
    assert_true(w->p.caution.level == 2);
    rest(w, 79, 1.0);
    assert_true(w->p.caution.level == 2);
    rest(w, 2, 1.0);
    assert_true(w->p.caution.level == 1);
}

/* A hand that keeps oscillating even at the highest level does so of its own accord. When it stops, the coupling returns to where it was. */
static void what_the_hand_does_by_itself_is_forgotten(void **unused) {
    (void)unused;
    swinging *w = begin_to_swing();
    swing(w, 40);
    assert_true(w->p.caution.own && w->p.stiffness < 10);
    rest(w, 0.6, 1.0);
    assert_true(w->p.caution.level == 1);
    rest(w, 8, 1.0);
    assert_true(fabs(w->p.stiffness - 400) < 1);
}

/* If the needle is held against a wall long enough, spring and damper settle at the force that matches the spring's extension. */
static void the_coupling_settles_at_its_stiffness(void **unused) {
    (void)unused;
    static virtual_coupling p;
    pose_sample s = sample(0, 0, 0);
    p = (virtual_coupling){0};
    coupling_engage(&p, &s);
    vec3 force = v3(0, 0, 0), torque = v3(0, 0, 0), base = v3(0, 0, 0);
    for (int i = 0; i < 2000; i++) {
        double compliance;
        pose rest = coupling_hold(&p, limited_to(200), (pose){v3(0.004, 0, 0), {1, 0, 0, 0}}, DT, &compliance);
        double k = 1e9; /* N/m, of the wall at x = 0 */
        base = v3(rest.position.x / (1 + compliance * k), 0, 0);
        force = v3(-k * base.x, 0, 0);
        torque = coupling_yield(&p, (pose){v3(0.004, 0, 0), {1, 0, 0, 0}}, base, force, v3(0, 0, 1));
    }
    assert_true(p.stiffness == 200);
    assert_true(fabs(force.x + 0.8) < 1e-3); /* -0.8 N = -4 mm * 200 N/m */
    assert_true(fabs(torque.z - 1) < 1e-9);  /* the force has no lever arm */
    torque = coupling_yield(&p, (pose){v3(0, 0.004, 0), {1, 0, 0, 0}}, v3(0, 0, 0), v3(-1, 0, 0), v3(0, 0, 0));
    assert_true(fabs(torque.z + 0.004) < 1e-12); /* r x F, where r points from the hand to the base */
}

/* With four ticks per pose, a device that uses every fourth wrench feels the same damping whichever of the four it uses. */
static void damper_acts_between_poses(void **unused) {
    (void)unused;
    static virtual_coupling p;
    pose_sample s = sample(0, 0, 0);
    p = (virtual_coupling){0};
    coupling_engage(&p, &s);
    for (int ms = 1; ms <= 1000; ms++) {
        s = sample(ms, 1e-5 * ms, 0);
        double force[4], compliance;
        for (int i = 0; i < 4; i++) { /* pushed against a wall at x = 0 */
            coupling_receive(&p, &s);
            pose rest = coupling_hold(&p, limited_to(200), s.base, 0.25e-3, &compliance);
            force[i] = -rest.position.x / compliance;
            coupling_yield(&p, s.base, v3(0, 0, 0), v3(force[i], 0, 0), v3(0, 0, 0));
            if (ms > 500) assert_true(fabs(force[i] - force[0]) < 1e-12);
        }
        if (ms > 500) assert_true(fabs(force[0] + 1e-5 * ms * p.stiffness + 0.01 * p.damping) < 1e-6); /* 10 mm/s */
    }
    assert_true(fabs(p.interval - 1e-3) < 1e-6 && p.damping > 0.0);
    double compliance;
    pose rest = s.base;
    for (int i = 0; i < 20; i++) { /* from here on, no poses arrive */
        rest = coupling_hold(&p, limited_to(200), s.base, 0.25e-3, &compliance);
        coupling_yield(&p, s.base, v3(0, 0, 0), v3(0, 0, 0), v3(0, 0, 0));
    }
    assert_true(fabs(rest.position.x / compliance - 1e-2 * p.stiffness) < 1e-6);
}

/* ---- the closed loop ---------------------------------------------------------------------------------------------------- */

enum { FLIGHT = 64 };                /* most messages in transit at once */

typedef struct {
    double period, sampling;         /* s; period: of the server; sampling: of the device */
    double mass;                     /* kg */
    double delay, jitter;            /* s, each way; delay: minimum; jitter: largest random addition */
    int lost;                        /* percentage of messages lost */
    double knock;                    /* m/s */
    device_limits limits;
} situation;

/* What the needle is in. Determines the force on the hand (N), and the position of a base that a spring attaches to `rest`. */
typedef struct {
    lockstep *tissue;                /* NULL for a spring to x = 0 instead */
    double stiffness;                /* N/m, of the spring to x = 0 */
} surroundings;

/* A weakly damped hand and the server, each running at its own rate. */
typedef struct {
    situation situation;
    hand hand;
    safety_limits guard;
    virtual_coupling port;
    int64_t now, next_tick, next_sample; /* ns */
    int64_t tick, seq;
    pose_sample poses[FLIGHT], newest;   /* poses: sent ones, indexed by number modulo FLIGHT; newest: the newest that has arrived */
    coupling_wrench wrenches[FLIGHT], felt;
    int64_t arrives[FLIGHT];             /* ns, when the wrenches arrive */
    double worst;                        /* m/s, highest speed of the hand since this was last set to zero */
    int64_t saturated;                   /* ticks */
} loop;

static vec3 push(const loop *l, surroundings *in, pose rest, double compliance, vec3 *base, vec3 *torque) {
    *torque = v3(0, 0, 0);
    if (in->tissue) {
        in->tissue->base_compliance = compliance;
        lockstep_tick(in->tissue, rest, l->situation.period);
        *base = v3_add(rest.position, in->tissue->state.base_shift);
        *torque = in->tissue->wrench.torque;
        return in->tissue->wrench.force;
    }
    *base = v3(rest.position.x / (1 + compliance * in->stiffness), rest.position.y, rest.position.z);
    return v3(-in->stiffness * base->x, 0, 0);
}

static double draw(void) {
    static uint32_t random = 12345;
    random = 1664525u * random + 1013904223u; /* Numerical Recipes' LCG */
    return (random >> 8) / 16777216.0;
}

static int64_t ns(double seconds) { return (int64_t)(1e9 * seconds + 0.5); }

static int64_t arrival(const loop *l) {
    if (100 * draw() < l->situation.lost) return INT64_MAX;
    return l->now + ns(l->situation.delay + l->situation.jitter * draw());
}

static void loop_init(loop *l, const situation *s, vec3 start) {
    *l = (loop){.situation = *s, .hand = {.mass = s->mass, .damping = 1, .stiffness = 300, .position = start}, .next_sample = ns(s->sampling / 3)};
    l->newest = (pose_sample){.held = true, .engagement = 1, .base = {start, {1, 0, 0, 0}}};
}

/* Runs the server's tick as haptic.c does. */
static void serve(loop *l, surroundings *in) {
    const device_limits *limits = &l->situation.limits;
    double period = l->situation.period, compliance;
    for (int64_t i = l->seq; i > l->newest.seq; i--) /* finds the newest pose that has arrived; older ones are refused */
        if (l->poses[i % FLIGHT].received <= l->now) l->newest = l->poses[i % FLIGHT];
    safety_decision decision = safety_pose(&l->guard, limits, &l->newest, l->now);
    assert_true(l->tick == 0 || decision != SAFETY_ENGAGE);
    if (decision == SAFETY_ENGAGE) coupling_engage(&l->port, &l->newest);
    if (decision == SAFETY_FOLLOW) coupling_receive(&l->port, &l->newest);
    pose rest = coupling_hold(&l->port, limits, l->guard.base, period, &compliance);
    vec3 base, torque, force = push(l, in, rest, compliance, &base, &torque);
    torque = coupling_yield(&l->port, l->guard.base, base, force, torque);
    int flags = safety_wrench(&l->guard, limits, false, period, &force, &torque);
    l->saturated += (flags & TROCAR_NEEDLE_WRENCH_T_SATURATED) != 0;
    coupling_send(&l->port, ++l->tick, l->now, force, torque);
    l->wrenches[l->tick % FLIGHT] = (coupling_wrench){l->tick, l->now, force, torque};
    l->arrives[l->tick % FLIGHT] = arrival(l);
    l->next_tick += ns(period);
}

static void feel(loop *l, vec3 target) {
    for (int64_t i = l->tick; i > l->felt.tick && i > l->tick - FLIGHT; i--)
        if (l->arrives[i % FLIGHT] <= l->now) l->felt = l->wrenches[i % FLIGHT];
    hand_step(&l->hand, target, l->felt.force, l->situation.sampling);
    l->worst = fmax(l->worst, v3_norm(l->hand.velocity));
    l->seq++;
    l->poses[l->seq % FLIGHT] = (pose_sample){.held = true, .engagement = 1, .seq = l->seq, .wrench_tick = l->felt.tick,
                                              .received = arrival(l), .base = {l->hand.position, {1, 0, 0, 0}}};
    l->next_sample += ns(l->situation.sampling);
}

static void loop_run(loop *l, surroundings *in, vec3 target, double seconds) {
    int64_t end = l->now + ns(seconds);
    for (l->worst = 0.0; l->worst < 100 && fmin(l->next_tick, l->next_sample) < end;) {
        l->now = l->next_tick < l->next_sample ? l->next_tick : l->next_sample;
        if (l->now == l->next_tick) serve(l, in);
        else feel(l, target);
    }
    l->now = end;
}

/* Returns whether the hand's motion dies down after a knock, to a fifth or less in the time its own damping would take. */
static bool dies_away(loop *l, surroundings *in, vec3 target) {
    l->hand.velocity = v3_add(l->hand.velocity, v3(l->situation.knock, 0, 0));
    loop_run(l, in, target, 0.3);
    double first = l->worst;
    loop_run(l, in, target, 2.4);
    loop_run(l, in, target, 0.3);
    double alone = exp(-0.5 * l->hand.damping / l->hand.mass * 2.7);
    return first < 10 && l->worst < fmax(1.4 * alone, 0.2) * first;
}

static device_limits limits_of(const char *device) {
    device_limits limits = device_defaults();
    assert_true(device_use_profile(device, &limits));
    limits.delay = 0.0;
    return limits;
}

/* Returns limits with the highest stiffness a scene may request (docs/connect-a-device.md) and the force rate that a hand moving at 1 m/s then needs. */
static device_limits own_limits(void) {
    device_limits limits = device_defaults();
    limits.max_stiffness = limits.max_force_rate = 14500;
    limits.delay = 0.0;
    return limits;
}

#define EACH(x, list) for (const double *x = (list); x < (list) + sizeof(list) / sizeof *(list); x++)

static int64_t try_springs(const situation *s) {
    static loop l;
    int64_t saturated = 0;
    for (double stiffness = 10; stiffness < 1e7; stiffness *= 6) {
        surroundings in = {.stiffness = stiffness};
        loop_init(&l, s, v3(0, 0, 0));
        loop_run(&l, &in, v3(0, 0, 0), 1.0); /* measures the delay */
        if (!dies_away(&l, &in, v3(0, 0, 0)))
            fail_msg("%g and %g s, mass %g, delay %g, jitter %g, lost %d, limit %g, %g N/s, stiffness %g: %g m/s at the end", s->period, s->sampling,
                     s->mass, s->delay, s->jitter, s->lost, s->limits.max_stiffness, s->limits.max_force_rate, stiffness, l.worst);
        saturated += l.saturated;
    }
    return saturated;
}

/* The knock is so hard that force and force rate reach their limits, on a good network and on a bad one. */
static void stable_against_a_spring_of_any_stiffness(void **unused) {
    (void)unused;
    static const double masses[] = {0.05, 0.1, 0.3, 1, 2}, delays[] = {0, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3};
    const device_limits devices[] = {limits_of("touch"), limits_of("falcon"), limits_of("omega.3"), own_limits()};
    for (size_t d = 0; d < sizeof devices / sizeof *devices; d++) {
        int64_t saturated = 0;
        EACH(mass, masses) EACH(delay, delays) {
            saturated += try_springs(&(situation){DT, DT, *mass, *delay, 0, 0, 1.0, devices[d]});
            saturated += try_springs(&(situation){DT, DT, *mass, *delay, 2e-3, 20, 1.0, devices[d]});
        }
        assert_true(saturated > 1000);
    }
}

/* The server is slower or faster than the device, or both are fast. */
static void stable_at_other_rates(void **unused) {
    (void)unused;
    static const double masses[] = {0.05, 0.3, 2}, delays[] = {0, 1e-3, 5e-3};
    static const struct { double period, sampling; } rates[] = {{4e-3, 1e-3}, {0.25e-3, 1e-3}, {0.25e-3, 0.25e-3}};
    const device_limits devices[] = {limits_of("touch"), limits_of("omega.3"), own_limits()};
    for (size_t r = 0; r < sizeof rates / sizeof *rates; r++)
        for (size_t d = 0; d < sizeof devices / sizeof *devices; d++)
            EACH(mass, masses) EACH(delay, delays) {
                try_springs(&(situation){rates[r].period, rates[r].sampling, *mass, *delay, 0, 0, 1.0, devices[d]});
                try_springs(&(situation){rates[r].period, rates[r].sampling, *mass, *delay, 2e-3, 20, 1.0, devices[d]});
            }
}

/* Without the coupling, such a loop is unstable, which shows that the tests above can fail. */
static void unstable_without_the_coupling(void **unused) {
    (void)unused;
    static loop l;
    surroundings in = {.stiffness = 2000};
    situation s = {DT, DT, 0.05, 3e-3, 0, 0, 0.05, device_defaults()};
    s.limits.max_stiffness = INFINITY;
    loop_init(&l, &s, v3(0, 0, 0));
    assert_false(dies_away(&l, &in, v3(0, 0, 0)));
}

/* A force rate limit that is too low makes the force lag behind the hand. The coupling cannot know of this delay until the hand oscillates. */
static void a_slow_slew_softens_the_coupling(void **unused) {
    (void)unused;
    static loop l;
    surroundings in = {.stiffness = 1e5};
    situation s = {DT, DT, 0.05, 1e-3, 0, 0, 1.0, limits_of("falcon")};
    s.limits.max_force_rate = s.limits.max_force / 15e-3;
    loop_init(&l, &s, v3(0, 0, 0));
    loop_run(&l, &in, v3(0, 0, 0), 1.0);
    assert_true(dies_away(&l, &in, v3(0, 0, 0)));
    assert_true(l.port.caution.level > 1 && coupling_active(&l.port));
}

/* Lets the hand push the needle more than 20 mm into the tissue, in some cases against bone, and then knocks the hand. */
static void knock_in_tissue(const situation *s, lockstep *tissue) {
    static loop l;
    surroundings in = {.tissue = tissue};
    vec3 start = lockstep_start().position, target = start;
    insertion_reset(&tissue->parts.insertion, lockstep_start(), &tissue->state);
    loop_init(&l, s, start);
    for (int i = 0; i < 300; i++) {
        target.z += 0.2e-3; /* extends the hand's spring; the needle follows part of the way */
        loop_run(&l, &in, target, DT);
    }
    loop_run(&l, &in, target, 0.5);
    assert_true(tissue->wrench.depth > 20e-3);
    l.hand.velocity.z += 0.02;
    if (!dies_away(&l, &in, target))
        fail_msg("mass %g, delay %g, limit %g, lost %d: %g m/s", s->mass, s->delay, s->limits.max_stiffness, s->lost, l.worst);
    if (l.port.lowest < -1e-3) fail_msg("mass %g, delay %g: energy %g J", s->mass, s->delay, l.port.lowest);
}

static void stable_in_tissue_and_against_bone(void **unused) {
    (void)unused;
    simulation_config config = lockstep_config();
    for (int bone = 0; bone < 2; bone++) {
        for (int i = 0; i < config.region_count; i++)
            if (bone && strcmp(config.regions[i].name, "prostate") == 0) config.regions[i].material.cutting_force = INFINITY;
        lockstep *tissue = lockstep_create(&config, lockstep_start());
        static const double masses[] = {0.05, 0.3, 2}, delays[] = {0, 2e-3, 5e-3};
        EACH(mass, masses) EACH(delay, delays) {
            knock_in_tissue(&(situation){DT, DT, *mass, *delay, 1e-3, 10, 0.05, limits_of("touch")}, tissue);
            knock_in_tissue(&(situation){DT, DT, *mass, *delay, 1e-3, 10, 0.05, own_limits()}, tissue);
        }
        lockstep_free(tissue);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(round_trip_ends_with_the_first_acknowledging_pose),
        cmocka_unit_test(energy_is_the_work_of_the_hand_against_the_rendered_wrench),
        cmocka_unit_test(rigid_coupling_changes_nothing),
        cmocka_unit_test(a_hand_without_force_holds_rigidly),
        cmocka_unit_test(stiffness_follows_delay_and_mass_of_the_device),
        cmocka_unit_test(energy_is_accounted_with_the_wrench_that_the_device_felt),
        cmocka_unit_test(lasting_swings_soften_the_coupling),
        cmocka_unit_test(the_coupling_recovers_slowly_and_learns),
        cmocka_unit_test(what_the_hand_does_by_itself_is_forgotten),
        cmocka_unit_test(the_coupling_settles_at_its_stiffness),
        cmocka_unit_test(damper_acts_between_poses),
        cmocka_unit_test(stable_against_a_spring_of_any_stiffness),
        cmocka_unit_test(stable_at_other_rates),
        cmocka_unit_test(unstable_without_the_coupling),
        cmocka_unit_test(a_slow_slew_softens_the_coupling),
        cmocka_unit_test(stable_in_tissue_and_against_bone),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

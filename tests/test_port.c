/* The port by hand, and the closed loop that it must keep stable: a simulated hand, a network that is late and loses
   messages, the coupling, and a needle in tissue or a plain spring of any stiffness. */
#include <math.h>

#include "hand.h"
#include "lockstep.h"
#include "port.h"

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

/* ---- the parts ---------------------------------------------------------------------------------------------------------- */

static void a_round_trip_ends_with_the_first_pose_that_names_the_wrench(void **unused) {
    (void)unused;
    static port p;
    pose_sample s = sample(0, 0, 0);
    p = (port){0};
    port_engage(&p, &s);
    for (int64_t tick = 1; tick <= 5; tick++) port_send(&p, tick, tick * MS, v3(0, 0, 0), v3(0, 0, 0));
    s = sample(6, 0, 3);
    assert_int_equal(port_receive(&p, &s), 3 * MS);
    assert_int_equal(port_receive(&p, &s), -1); /* the same pose */
    static const int64_t others[] = {3, 2, 0, 900, -4, 3 + PORT_TICKS}; /* again, older, none, to come, nonsense */
    for (size_t i = 0; i < sizeof others / sizeof *others; i++) {
        s = sample(7 + (int64_t)i, 0, others[i]);
        assert_int_equal(port_receive(&p, &s), -1);
    }
    s = sample(20, 0, 5);
    assert_int_equal(port_receive(&p, &s), 15 * MS);
}

static void energy_is_what_the_hand_does_against_the_wrench_it_felt(void **unused) {
    (void)unused;
    static port p;
    pose_sample s = sample(0, 0, 0);
    p = (port){0};
    port_engage(&p, &s);
    port_send(&p, 1, 0, v3(-2, 0, 0), v3(0, 0, -0.5));
    port_send(&p, 2, 0, v3(-4, 0, 0), v3(0, 0, 0));
    s = sample(1, 0.010, 1); /* 10 mm against 2 N, a tenth of an rad against 0.5 N m */
    s.base.orientation = q_exp(v3(0, 0, 0.1));
    port_receive(&p, &s);
    assert_true(fabs(p.energy - 0.07) < 1e-12 && p.lowest == 0.0 && !port_active(&p));
    s.received++;
    s.base.position.x = -0.010; /* 20 mm back with 4 N */
    s.wrench_tick = 2;
    port_receive(&p, &s);
    assert_true(fabs(p.energy + 0.01) < 1e-12 && fabs(p.lowest + 0.01) < 1e-12 && port_active(&p));
}

static void a_rigid_hold_changes_nothing(void **unused) {
    (void)unused;
    static port p;
    pose_sample s = sample(0, 0.1, 0);
    p = (port){0};
    port_engage(&p, &s);
    double compliance = 1;
    pose rest = port_hold(&p, INFINITY, s.base, DT, &compliance);
    assert_memory_equal(&rest, &s.base, sizeof rest);
    assert_true(compliance == 0.0 && p.stiffness == 0.0);
}

/* Held against a wall for long, spring and damper come to rest at the spring's stretch. */
static void the_coupling_settles_at_its_stiffness(void **unused) {
    (void)unused;
    static port p;
    pose_sample s = sample(0, 0, 0);
    p = (port){0};
    port_engage(&p, &s);
    vec3 force = v3(0, 0, 0), torque = v3(0, 0, 0), base = v3(0, 0, 0);
    for (int i = 0; i < 2000; i++) {
        double compliance;
        pose rest = port_hold(&p, 200, (pose){v3(0.004, 0, 0), {1, 0, 0, 0}}, DT, &compliance);
        double k = 1e9; /* the wall at x = 0 */
        base = v3(rest.position.x / (1 + compliance * k), 0, 0);
        force = v3(-k * base.x, 0, 0);
        torque = port_yield(&p, (pose){v3(0.004, 0, 0), {1, 0, 0, 0}}, base, force, v3(0, 0, 1));
    }
    assert_true(p.stiffness == 200);
    assert_true(fabs(force.x + 0.8) < 1e-3); /* 4 mm * 200 N/m */
    assert_true(fabs(torque.z - 1) < 1e-9);  /* no lever along the force */
    torque = port_yield(&p, (pose){v3(0, 0.004, 0), {1, 0, 0, 0}}, v3(0, 0, 0), v3(-1, 0, 0), v3(0, 0, 0));
    assert_true(fabs(torque.z + 0.004) < 1e-12); /* r x F, r from the hand to the base */
}

/* ---- the closed loop ---------------------------------------------------------------------------------------------------- */

enum { LATEST = 5, QUEUE = LATEST + 2 };

typedef struct {
    double mass, delay;              /* kg; s, each way: a whole number of milliseconds */
    double limit;                    /* N/m, of the device */
    int lost;                        /* of a hundred messages */
} situation;

/* What the needle is in: the base's force (N, on the hand) and place when it rests on a spring at `rest`. */
typedef struct {
    lockstep *tissue;                /* or NULL: a plain spring to x = 0 */
    double stiffness;                /* N/m, of that */
} surroundings;

static vec3 push(surroundings *in, pose rest, double compliance, vec3 *base, vec3 *torque) {
    *torque = v3(0, 0, 0);
    if (in->tissue) {
        in->tissue->state.base_compliance = compliance;
        lockstep_tick(in->tissue, rest, DT);
        *base = v3_add(rest.position, in->tissue->state.base_shift);
        *torque = in->tissue->wrench.torque;
        return in->tissue->wrench.force;
    }
    *base = v3(rest.position.x / (1 + compliance * in->stiffness), rest.position.y, rest.position.z);
    return v3(-in->stiffness * base->x, 0, 0);
}

static bool arrives(const situation *s) {
    static uint32_t random = 12345;
    random = 1664525u * random + 1013904223u; /* Numerical Recipes' LCG */
    return (int)((random >> 8) % 100) >= s->lost;
}

/* A weakly damped hand and the server, a millisecond at a time, the hand half a millisecond after the server. */
typedef struct {
    situation situation;
    hand hand;
    port port;
    int64_t tick;
    pose_sample poses[QUEUE], newest;   /* on their way, by tick modulo QUEUE; arrived */
    port_wrench wrenches[QUEUE], felt;
    double worst;                       /* m/s, the hand's highest speed since it was cleared */
} loop;

static void loop_init(loop *l, const situation *s, vec3 start) {
    *l = (loop){.situation = *s, .hand = {.mass = s->mass, .damping = 1, .stiffness = 300, .position = start}};
    l->newest = (pose_sample){.held = true, .base = {start, {1, 0, 0, 0}}};
    port_engage(&l->port, &l->newest);
}

static void serve(loop *l, surroundings *in) {
    int late = (int)(l->situation.delay / DT + 0.5);
    const pose_sample *arrived = &l->poses[(l->tick - late + QUEUE) % QUEUE];
    if (arrived->held && arrived->seq == l->tick - late) l->newest = *arrived;
    port_receive(&l->port, &l->newest);
    double compliance;
    vec3 base, torque;
    pose rest = port_hold(&l->port, l->situation.limit, l->newest.base, DT, &compliance);
    vec3 force = push(in, rest, compliance, &base, &torque);
    torque = port_yield(&l->port, l->newest.base, base, force, torque);
    port_send(&l->port, l->tick, l->tick * MS, force, torque);
    l->wrenches[l->tick % QUEUE] = (port_wrench){arrives(&l->situation) ? l->tick : -1, 0, force, torque};
}

static void feel(loop *l, vec3 target) {
    int late = (int)(l->situation.delay / DT + 0.5);
    const port_wrench *arrived = &l->wrenches[(l->tick - late + QUEUE) % QUEUE];
    if (l->tick >= late && arrived->tick == l->tick - late) l->felt = *arrived;
    hand_step(&l->hand, target, l->felt.force, DT);
    l->worst = fmax(l->worst, v3_norm(l->hand.velocity));
    int64_t seq = l->tick + 1; /* the tick that it could reach at the earliest */
    l->poses[seq % QUEUE] = (pose_sample){.held = arrives(&l->situation), .seq = seq, .wrench_tick = l->felt.tick,
                                          .received = (seq + late) * MS - MS / 2, .base = {l->hand.position, {1, 0, 0, 0}}};
}

static void loop_run(loop *l, surroundings *in, vec3 target, double seconds) {
    l->worst = 0.0;
    for (int i = 0; i < seconds / DT; i++) {
        serve(l, in);
        feel(l, target);
        l->tick++;
        if (!(l->worst < 100)) return;
    }
}

/* The hand is knocked, then left alone: does its motion die away? The heaviest loses 40 % by its own damping alone. */
static bool dies_away(loop *l, surroundings *in, vec3 target) {
    l->hand.velocity = v3_add(l->hand.velocity, v3(0.05, 0, 0));
    loop_run(l, in, target, 0.3);
    double first = l->worst;
    loop_run(l, in, target, 2.4);
    loop_run(l, in, target, 0.3);
    return first < 10 && l->worst < 0.7 * first;
}

static const double MASSES[] = {0.05, 0.1, 0.3, 1, 2}, DELAYS[] = {0, 1e-3, 2e-3, 3e-3, 4e-3, 5e-3};
#define EACH(x, list) for (const double *x = (list); x < (list) + sizeof(list) / sizeof *(list); x++)

static void stable_against_a_spring_of_any_stiffness(void **unused) {
    (void)unused;
    static loop l;
    EACH(mass, MASSES) EACH(delay, DELAYS)
        for (double limit = 500; limit < 20000; limit *= 3)
            for (double stiffness = 10; stiffness < 1e7; stiffness *= 3)
                for (int lost = 0; lost <= 20; lost += 20) {
                    surroundings in = {.stiffness = stiffness};
                    situation s = {*mass, *delay, limit, lost};
                    loop_init(&l, &s, v3(0, 0, 0));
                    loop_run(&l, &in, v3(0, 0, 0), 1.0); /* learns the delay */
                    if (!dies_away(&l, &in, v3(0, 0, 0)))
                        fail_msg("mass %g, delay %g, limit %g, stiffness %g, lost %d: %g m/s at the end", *mass, *delay, limit, stiffness, lost, l.worst);
                }
}

/* Without the coupling the same loops are not stable: the test can fail. */
static void unstable_without_the_coupling(void **unused) {
    (void)unused;
    static loop l;
    surroundings in = {.stiffness = 2000};
    situation s = {0.05, 3e-3, INFINITY, 0};
    loop_init(&l, &s, v3(0, 0, 0));
    assert_false(dies_away(&l, &in, v3(0, 0, 0)));
}

/* A needle pushed 20 mm into tissue by the hand, knocked there; then on against bone. */
static void knock_in_tissue(const situation *s, lockstep *tissue) {
    static loop l;
    surroundings in = {.tissue = tissue};
    vec3 start = lockstep_start().position, target = start;
    insertion_reset(&tissue->simulation.insertion, lockstep_start(), &tissue->state);
    loop_init(&l, s, start);
    for (int i = 0; i < 300; i++) {
        target.z += 0.2e-3; /* the hand's spring stretches: the needle follows some way */
        loop_run(&l, &in, target, DT);
    }
    loop_run(&l, &in, target, 0.5);
    assert_true(tissue->wrench.depth > 20e-3);
    l.hand.velocity.z += 0.02;
    if (!dies_away(&l, &in, target)) fail_msg("mass %g, delay %g, limit %g, lost %d: %g m/s", s->mass, s->delay, s->limit, s->lost, l.worst);
    if (l.port.lowest < -1e-3) fail_msg("mass %g, delay %g: energy %g J", s->mass, s->delay, l.port.lowest);
}

static void stable_in_tissue_and_against_bone(void **unused) {
    (void)unused;
    simulation_config config = lockstep_config();
    for (int bone = 0; bone < 2; bone++) {
        for (int i = 0; i < config.region_count; i++)
            if (bone && strcmp(config.regions[i].name, "prostate") == 0) config.regions[i].material.cutting_force = INFINITY;
        lockstep *tissue = lockstep_create(&config, lockstep_start());
        static const double masses[] = {0.05, 0.3, 2}, delays[] = {0, 2e-3, 5e-3}, limits[] = {1000, 14500};
        EACH(mass, masses) EACH(delay, delays) EACH(limit, limits)
            knock_in_tissue(&(situation){*mass, *delay, *limit, 10}, tissue);
        lockstep_free(tissue);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_round_trip_ends_with_the_first_pose_that_names_the_wrench),
        cmocka_unit_test(energy_is_what_the_hand_does_against_the_wrench_it_felt),
        cmocka_unit_test(a_rigid_hold_changes_nothing),
        cmocka_unit_test(the_coupling_settles_at_its_stiffness),
        cmocka_unit_test(stable_against_a_spring_of_any_stiffness),
        cmocka_unit_test(unstable_without_the_coupling),
        cmocka_unit_test(stable_in_tissue_and_against_bone),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

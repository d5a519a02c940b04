/* Tests a worker that gets too little CPU time: either a newer request is always waiting by the time it has answered one, or it does not run at all. The
   force on a tip in the tissue must be about the same as with a punctual worker, and every tick must report that the worker is late. Once the worker has
   caught up, the state must be the same as if it had always been on time. */
#include <math.h>

#include "api/api.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "host.h"

enum { TICKS = 6000, AFTER = 1500 };
static const double SPEED = 0.01;    /* m/s, while inserting by 60 mm through the skin and the capsule */
static const double ALMOST = 0.02;   /* largest permitted difference, relative to the peak force; 0.6 % was measured */
static const double SAME = 0.005;

typedef struct {
    host h;
    int tick;
    int slow;                /* ticks that the worker takes to answer a request or to measure a line */
    int late;                /* ticks that reported the worker late */
    int measured;            /* lines */
    double depth;            /* m, deepest */
    double force[TICKS + AFTER]; /* N, force along the needle */
} insertion;

static insertion now;

static void tick_on(void) {
    trocar_pose base = {{0.005, 0.003, -0.201 + 1e-3 * SPEED * now.tick}, {1, 0, 0, 0}};
    trocar_output *o = &now.h.output;
    if (now.tick == TICKS + AFTER) return;
    assert_int_equal(trocar_sim_tick(now.h.sim, 0, &base, 1e-3, o), TROCAR_OK);
    now.force[now.tick++] = o->force[2];
    now.late += (o->events & TROCAR_EVENT_LATE) != 0;
    now.depth = fmax(now.depth, o->depth);
    double tip = base.position[2] + 0.2;
    if (tip > 0.5e-3 && !(o->force[2] < -5e-3)) fail_msg("tick %d, tip at %.1f mm, events %#x: %.4f N", now.tick, 1e3 * tip, o->events, o->force[2]);
}

static void wait_a_little(void) {
    for (int i = 0; i < now.slow; i++) tick_on();
}

trocar_status __real_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_serve(remesher *r, const remesh_request *request, compliance_snapshot *snapshot, trocar_error *why) {
    trocar_status status = __real_remesher_serve(r, request, snapshot, why);
    wait_a_little();
    return status;
}

trocar_status __real_remesher_measure(remesher *r, const remesh_request *request, int most, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_measure(remesher *r, const remesh_request *request, int most, compliance_snapshot *snapshot, trocar_error *why);
trocar_status __wrap_remesher_measure(remesher *r, const remesh_request *request, int most, compliance_snapshot *snapshot, trocar_error *why) {
    trocar_status status = __real_remesher_measure(r, request, most, snapshot, why);
    now.measured++;
    wait_a_little();
    return status;
}

/* Continues the motion for `ticks` ticks. The worker takes `slow` ticks per task; INT_MAX means that it never runs. */
static void push(int ticks, int slow) {
    now.slow = slow;
    for (int end = now.tick + ticks; now.tick < end && now.tick < TICKS + AFTER;) {
        tick_on();
        if (slow < TICKS) assert_int_equal(trocar_sim_work(now.h.sim, NULL, NULL), TROCAR_OK);
    }
}

static insertion in_time; /* for comparison: the insertion with a worker that answers at once */

static void begin(void) {
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    now = (insertion){.h = host_open(MESHES "/figure8.yaml")};
    assert_int_equal(trocar_sim_reset(now.h.sim, 0, &base, NULL), TROCAR_OK);
}

static int insert_in_time(void **unused) {
    (void)unused;
    begin();
    push(TICKS + AFTER, 0);
    in_time = now;
    host_close(&now.h);
    return 0;
}

/* Returns the largest difference between the forces of two insertions over these ticks, relative to the peak force. Ticks around a puncture are excluded. */
static double difference(int from, int to) {
    double most = 0.0, peak = 0.0;
    for (int i = from; i < to; i++) {
        peak = fmax(peak, fabs(in_time.force[i]));
        double nearest = INFINITY; /* N, smallest difference from the other run's forces within 1 mm of travel */
        for (int k = i - 100 < 0 ? 0 : i - 100; k < i + 100 && k < to; k++) nearest = fmin(nearest, fabs(now.force[i] - in_time.force[k]));
        most = fmax(most, nearest);
    }
    return most / peak;
}

static void a_slow_worker_makes_progress(void **unused) {
    (void)unused;
    begin();
    push(TICKS, 300);
    double starved = difference(0, TICKS);
    print_message("%d of %d ticks late, %d lines measured, forces within %.1f %%\n", now.late, now.tick, now.measured, 1e2 * starved);
    assert_true(now.measured >= 5 && now.late > 100 && now.late < TICKS);
    assert_true(starved < ALMOST);
    push(AFTER, 0);
    assert_true(difference(TICKS + 1000, TICKS + AFTER) < SAME);
    assert_true(now.h.output.contacts == in_time.h.output.contacts && fabs(now.depth - in_time.depth) < 1e-4);
    host_close(&now.h);
}

static void without_a_worker_forces_are_estimated(void **unused) {
    (void)unused;
    begin();
    push(TICKS, INT32_MAX);
    double starved = difference(0, TICKS);
    print_message("%d of %d ticks late, forces within %.1f %%\n", now.late, now.tick, 1e2 * starved);
    assert_true(now.late > TICKS - 200); /* late in every tick with the tip in the tissue */
    assert_true(starved < ALMOST && now.depth > 0.05);
    push(AFTER, 0);
    assert_true(difference(TICKS + 1000, TICKS + AFTER) < SAME);
    assert_true(now.h.output.contacts == in_time.h.output.contacts && !(now.h.output.events & TROCAR_EVENT_LATE));
    host_close(&now.h);
}

/* Inserts the needle by 30 mm and then moves it sideways by up to 5 mm. Returns the largest lateral force (N). */
static double sway(bool with_worker) {
    host h = host_open(MESHES "/figure8.yaml");
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    double most = 0.0;
    assert_int_equal(trocar_sim_reset(h.sim, 0, &base, NULL), TROCAR_OK);
    for (int t = 0; t < 1600; t++) {
        if (t < 600) base.position[2] += 50e-6;
        else base.position[0] = 0.005 + 0.005 * sin(2 * M_PI * (t - 600) / 1000);
        assert_int_equal(trocar_sim_tick(h.sim, 0, &base, 1e-3, &h.output), TROCAR_OK);
        for (trocar_work done = {.more = with_worker}; done.more;) assert_int_equal(trocar_sim_work(h.sim, &done, NULL), TROCAR_OK);
        most = fmax(most, fabs(h.output.force[0]));
    }
    host_close(&h);
    return most;
}

static void sideways_the_tip_alone_holds(void **unused) {
    (void)unused;
    now.slow = 0;
    double known = sway(true), estimated = sway(false);
    print_message("swayed: %.4f N, without a worker %.4f N\n", known, estimated);
    assert_true(estimated > 0.3 * known && estimated < known);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_slow_worker_makes_progress),
        cmocka_unit_test(without_a_worker_forces_are_estimated),
        cmocka_unit_test(sideways_the_tip_alone_holds),
    };
    return cmocka_run_group_tests(tests, insert_in_time, NULL);
}

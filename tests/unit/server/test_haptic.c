/* Calls the server's tick directly: one pose in, one wrench out, with no threads and a simulated clock. */
#include <poll.h>
#include <stdlib.h>
#include <string.h>

#include "api/api.h" /* gives access to the state, so that invalid numbers can be put into it */
#include "haptic.h"
#include "trocar_loop_timing_t.h"
#include "trocar_needle_wrench_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "host.h"

enum { RATE = 1000 };
static const int64_t MS = 1000000;

typedef struct {
    host host;
    exchange exchange;
    haptic haptic;
    newest_poses poses;      /* the most recently published poses */
    int64_t tick;
} fixture;

static bool readable(int descriptor) {
    struct pollfd p = {.fd = descriptor, .events = POLLIN};
    return poll(&p, 1, 0) == 1;
}

static int64_t made_time;
static int64_t made_clock(void) { return made_time; }

static int open_scene(void **state) {
    fixture *f = *state = allocate_on_cache_lines(sizeof *f);
    f->host = host_open(MESHES "/figure8.yaml");
    return 0;
}

static int close_scene(void **state) {
    fixture *f = *state;
    host_close(&f->host);
    free(f);
    return 0;
}

static int begin(void **state) {
    fixture *f = *state;
    trocar_error why;
    f->tick = made_time = 0;
    f->poses = (newest_poses){0};
    trocar_sim_free(f->host.sim);
    assert_int_equal(trocar_sim_create(f->host.model, &f->host.sim, &why), TROCAR_OK);
    assert_int_equal(exchange_create(&f->exchange, f->host.model, &why), TROCAR_OK);
    trocar_device_limits limits = trocar_scene_device(f->host.scene);
    limits.max_stiffness = INFINITY; /* with unlimited stiffness, the needle follows the poses exactly */
    limits.delay = 0.0;
    haptic_init(&f->haptic, f->host.sim, trocar_model_needles(f->host.model), &limits, RATE, TROCAR_NEEDLE_WRENCH_T_NOT_REALTIME, &f->exchange);
    trocar_sim_set_clock(f->host.sim, made_clock);
    return 0;
}

static int end(void **state) {
    fixture *f = *state;
    exchange_free(&f->exchange);
    return 0;
}

/* Lets the worker answer a quarter of a tick after the request. */
static void serve_worker(fixture *f) {
    trocar_error why;
    trocar_work done = {0};
    if (!readable(trocar_sim_work_descriptor(f->host.sim))) return;
    made_time += MS / 4;
    assert_int_equal(trocar_sim_work(f->host.sim, &done, &why), TROCAR_OK);
    assert_int_equal(done.answered, 1);
    assert_int_equal(done.latency, MS / 4);
}

static void put_pose_of(fixture *f, int needle, uint64_t engagement, int64_t seq, double x, double z) {
    f->poses.needles[needle] = (pose_sample){.held = true, .engagement = engagement, .session = 8 + needle, .seq = seq, .utime = 1000 + seq,
                                             .received = f->tick * MS, .base = {{x, 0.003, z}, {1, 0, 0, 0}}};
    *(newest_poses *)triple_buffer_slot(&f->exchange.poses) = f->poses;
    triple_buffer_publish(&f->exchange.poses);
}

static void put_pose(fixture *f, uint64_t engagement, int64_t seq, double z) { put_pose_of(f, 0, engagement, seq, 0.005, z); }

/* Marks the pending pose as sent in response to this wrench. */
static void name_wrench(fixture *f, int64_t tick) {
    newest_poses waiting = *(const newest_poses *)triple_buffer_read(&f->exchange.poses, NULL);
    waiting.needles[0].wrench_tick = tick;
    *(newest_poses *)triple_buffer_slot(&f->exchange.poses) = waiting;
    triple_buffer_publish(&f->exchange.poses);
}

static bool tick(fixture *f, trocar_needle_wrench_t *out) {
    made_time = f->tick * MS;
    loop_wake wake = {.tick = f->tick, .now = f->tick * MS, .elapsed = 1e-3};
    f->tick++;
    bool on = haptic_tick(&f->haptic, &wake);
    if (out != NULL) assert_true(spsc_ring_pop(&f->exchange.wrenches, out));
    return on;
}

static double norm(const double a[3]) { return sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2]); }

static void zero_wrench_before_the_first_pose(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w;
    assert_true(tick(f, &w));
    assert_int_equal(w.pose_seq, -1);
    assert_int_equal(w.session, 0);
    assert_int_equal(w.flags, TROCAR_NEEDLE_WRENCH_T_NOT_REALTIME);
    assert_true(w.force[0] == 0 && w.force[1] == 0 && w.force[2] == 0);
    assert_true(readable(f->exchange.io_wake));
}

static void wrench_echoes_its_pose(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w;
    put_pose(f, 1, 41, -0.205);
    tick(f, &w);
    assert_int_equal(w.session, 8);
    assert_int_equal(w.pose_seq, 41);
    assert_int_equal(w.pose_utime, 1041);
    assert_int_equal(w.tick, 0);

    f->poses.needles[0].held = false; /* as after a release */
    *(newest_poses *)triple_buffer_slot(&f->exchange.poses) = f->poses;
    triple_buffer_publish(&f->exchange.poses);
    tick(f, &w);
    assert_true(w.session == 0 && w.pose_seq == -1 && w.pose_utime == 0);
}

/* Moves the tip from `from` to `to` (mm from its start) at 20 ticks per mm, letting the worker answer requests along the way. */
static trocar_needle_wrench_t move(fixture *f, uint64_t engagement, double from, double to) {
    trocar_needle_wrench_t w = {0};
    for (int i = 0; i < 20 * fabs(to - from); i++) {
        put_pose(f, engagement, f->tick, -0.205 + 1e-3 * from + 0.05e-3 * i * copysign(1, to - from));
        tick(f, &w);
        serve_worker(f);
    }
    return w;
}

static trocar_needle_wrench_t push(fixture *f, double mm) { return move(f, 1, 0, mm); }

static void insertion_gives_force_and_requests_to_the_worker(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w = push(f, 20);
    assert_true(w.force[2] < -0.3);                        /* against the push */
    assert_true(fabs(w.force[2] - w.raw_force[2]) < 1e-12); /* within the limits, so unchanged */
    assert_true(w.depth > 0.005 && w.contacts >= 1);
    assert_true(f->host.sim->needles[0].link.posted > 1);
    bool fresh;
    const view_sample *view = triple_buffer_read(&f->exchange.views, &fresh);
    assert_true(fresh && view->needles[0].contacts >= 1);
    assert_true(view->snapshot_age < 2e-3);
    trocar_contact contacts[TROCAR_MAX_POINTS];
    assert_int_equal(trocar_view_contacts(trocar_picture_view(view->picture), 0, contacts, TROCAR_MAX_POINTS), view->needles[0].contacts + 1);
    assert_true(view->needles[0].pose_utime > 0 && view->needles[0].pose_utime <= w.pose_utime);
}

static void snapshot_age_is_that_of_the_oldest_pending_request(void **state) {
    fixture *f = *state;
    push(f, 10);
    uint64_t posted = f->host.sim->needles[0].link.posted;
    int64_t opened = 0;
    for (int i = 0; i < 400; i++) {
        put_pose(f, 1, 1000 + i, -0.195 + 0.05e-3 * i);
        tick(f, NULL);
        if (opened == 0 && f->host.sim->needles[0].link.posted > posted) opened = f->tick - 1;
    }
    const view_sample *view = triple_buffer_read(&f->exchange.views, NULL);
    assert_true(opened > 0 && view->tick > opened + 100);
    assert_true(fabs(view->snapshot_age - 1e-3 * (double)(view->tick - opened)) < 1e-9);
}

static void silence_ramps_to_zero_and_is_flagged(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w = push(f, 20);
    for (int i = 0; i < 9; i++) tick(f, &w); /* within the hold time, the model's force is sent unchanged */
    assert_false(w.flags & TROCAR_NEEDLE_WRENCH_T_STALE);
    assert_true(fabs(w.force[2] - w.raw_force[2]) < 1e-12);
    for (int i = 0; i < 105; i++) tick(f, &w);
    assert_true(w.flags & TROCAR_NEEDLE_WRENCH_T_STALE);
    assert_true(w.force[2] == 0.0 && w.raw_force[2] < -0.1); /* the model's own force is still reported */
}

/* Returns the largest step in the force after a gap of `gap` ms, during which the hand moves on by 3 mm. During the gap, either no poses arrive or, if
   `stalled`, the loop does not run. */
static double largest_step_after(fixture *f, uint64_t engagement, int gap, bool stalled, double *jump) {
    trocar_needle_wrench_t w = move(f, engagement, 0, 20), next;
    double largest = 0.0, z = f->poses.needles[0].base.position.z + 3e-3;
    if (stalled) f->tick += gap;
    for (int i = 0; !stalled && i < gap; i++) {
        tick(f, &w);
        serve_worker(f);
    }
    for (int i = 0; i < 150; i++, w = next) {
        put_pose(f, engagement, f->tick, z);
        tick(f, &next);
        serve_worker(f);
        if (i == 0) *jump = fabs(next.raw_force[2] - w.raw_force[2]);
        largest = fmax(largest, fabs(next.force[2] - w.force[2]));
    }
    assert_true(fabs(w.force[2] - w.raw_force[2]) < 1e-12);
    print_message("%d ms %s: the model's force jumps by %.2f N, the hand feels %.3f N in a tick\n", gap, stalled ? "stalled" : "silent", *jump, largest);
    return largest;
}

static void what_comes_after_a_gap_comes_by_a_ramp(void **state) {
    fixture *f = *state;
    uint64_t engagement = 0;
    double jump;
    for (int stalled = 0; stalled < 2; stalled++) {
        double at_once = largest_step_after(f, ++engagement, 5, stalled, &jump);
        assert_true(jump > 0.3 && at_once > 0.9 * jump); /* a fast hand */
        double largest = largest_step_after(f, ++engagement, 40, stalled, &jump);
        assert_true(jump > 0.3 && largest < 0.05 * jump);
    }
}

static void wrenches_dropped_by_a_full_ring_are_counted(void **state) {
    fixture *f = *state;
    size_t capacity = f->exchange.wrenches.capacity;
    for (size_t i = 0; i < capacity + 7; i++) tick(f, NULL);
    assert_int_equal(f->haptic.wrench_dropped, 7);
}

static void winding_down_ends_the_loop_at_zero(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w = push(f, 20);
    atomic_store(&f->haptic.wind_down, true);
    int ticks = 1;
    for (; tick(f, &w); ticks++) put_pose(f, 1, 10000 + ticks, -0.185);
    assert_in_range(ticks, 95, 110);
    assert_true(w.force[0] == 0 && w.force[1] == 0 && w.force[2] == 0 && w.torque[0] == 0);
}

/* A new engagement starts far away. The needle is not dragged there, and the force does not jump. */
static void new_engagement_starts_outside(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w = push(f, 20), next;
    put_pose(f, 2, 100000, -0.5);
    tick(f, &next);
    assert_int_equal(next.contacts, 0);
    assert_true(next.depth == 0.0 && next.raw_force[2] == 0.0);
    assert_true(fabs(next.force[2] - w.force[2]) <= f->haptic.limits.max_force_rate / RATE + 1e-9);
}

/* Advances the needle by 20 mm, holds it until the tissue has relaxed, and puts an invalid value into its state. Then holds the needle, draws it back by 5
   mm and advances it to 25 mm. As soon as the value has an effect, the insertion must restart with a ramp, and after that the needle must behave as before. */
static void survive(fixture *f, const char *name, size_t place, double bad, double force) {
    static uint64_t engagement = 100;
    trocar_needle_wrench_t w = move(f, ++engagement, 0, 20);
    for (int i = -50; i < 350; i++) {
        if (i == 0) *(double *)((char *)&f->host.sim->needles[0].state + place) = bad;
        put_pose(f, engagement, f->tick, -0.185 + 0.05e-3 * (i < 50 ? 0 : i < 150 ? 50 - i : i - 250));
        tick(f, &w);
        serve_worker(f);
        if (!isfinite(norm(w.force) + norm(w.torque) + norm(w.raw_force) + norm(w.raw_torque))) fail_msg("%s = %g: a wrench is not finite", name, bad);
    }
    bool healthy = (w.flags & ~TROCAR_NEEDLE_WRENCH_T_NOT_REALTIME) == 0 && fabs(norm(w.force) / force - 1) < 0.2;
    if (!healthy) fail_msg("%s = %g: %g N, undisturbed %g N, flags %d", name, bad, norm(w.force), force, w.flags);
}

static void recovers_from_non_finite_values(void **state) {
    fixture *f = *state;
#define PLACE(name) {#name, offsetof(insertion_state, name)}
    static const struct { const char *name; size_t place; } places[] = {
        PLACE(base_shift.x), PLACE(needle.base.position.y), PLACE(needle.joints[10].x), PLACE(needle.frames[10].w), PLACE(entry.z),
        PLACE(tip.place.nominal.x), PLACE(tip.place.depth), PLACE(tip.solved.slip), PLACE(tip.solved.force.z), PLACE(tip.shaft.slip), PLACE(tip.shaft.slid),
        PLACE(tip.shaft.origin), PLACE(tip.dent.size), PLACE(tip.dent.damping.z), PLACE(tip.filtered_push), PLACE(tip.known.weights[1]), PLACE(strata[1].depth), PLACE(refined.nodes[1].position.z),
        PLACE(contacts[1].shaft.origin), PLACE(contacts[1].depth), PLACE(contacts[1].shaft.slip), PLACE(contacts[1].shaft.slid), PLACE(contacts[1].force.y),
        PLACE(contacts[1].log_lateral.xy), PLACE(contacts[1].log_axial),
    };
    double rigid = f->haptic.limits.max_stiffness;
    for (int soft = 0; soft < 2; soft++) {
        f->haptic.limits.max_stiffness = soft ? 500 : rigid;
        double force = norm(move(f, 2 + (uint64_t)soft, 0, 25).force);
        for (size_t i = 0; i < sizeof places / sizeof *places; i++) survive(f, places[i].name, places[i].place, soft ? INFINITY : NAN, force);
    }
    f->haptic.limits.max_stiffness = rigid;
}

static void round_trip_ends_with_the_first_acknowledging_pose(void **state) {
    fixture *f = *state;
    int64_t round_trip;
    for (int i = 0; i < 5; i++) tick(f, NULL);
    put_pose(f, 1, 1, -0.205);
    tick(f, NULL);
    assert_false(spsc_ring_pop(&f->exchange.round_trips, &round_trip)); /* the pose refers to no wrench */
    static const int64_t named[] = {3, 3, 2, 900, -4};             /* repeated, too old, in the future, or invalid */
    for (size_t i = 0; i < sizeof named / sizeof *named; i++) {
        put_pose(f, 1, 2 + (int64_t)i, -0.205);
        name_wrench(f, named[i]);
        tick(f, NULL);
    }
    assert_true(spsc_ring_pop(&f->exchange.round_trips, &round_trip));
    assert_int_equal(round_trip, 3 * MS); /* the wrench was computed at 3 ms and referred to by a pose at 6 ms */
    assert_false(spsc_ring_pop(&f->exchange.round_trips, &round_trip));
}

/* The stages are parts of the tick, so together they take no longer than the tick. */
static void stage_times_add_up_to_the_tick(void **state) {
    fixture *f = *state;
    push(f, 20);
    trocar_sim_set_clock(f->host.sim, monotonic_ns);
    int64_t before = monotonic_ns();
    put_pose(f, 1, 1000, -0.185);
    tick(f, NULL);
    int64_t lasted = monotonic_ns() - before, sum = 0;
    for (int i = 0; i < LOOP_STAGES; i++) {
        assert_true(f->haptic.stages[i] > 0);
        sum += f->haptic.stages[i];
    }
    assert_true(sum <= lasted && sum > f->haptic.stages[TROCAR_LOOP_TIMING_T_STAGE_CONTACT]);
}

static needle_command tell(fixture *f, int what, int seeds) {
    needle_command answer = {.refused = true}, command = {.asked = {.session = 8, .command = what, .seq = 5, .seeds = seeds}};
    assert_true(spsc_ring_push(&f->exchange.commands, &command));
    tick(f, NULL);
    serve_worker(f);
    assert_true(spsc_ring_pop(&f->exchange.replies, &answer));
    assert_true(readable(f->exchange.io_wake) && answer.asked.seq == 5 && answer.asked.command == what);
    return answer;
}

/* Moves the needle's base to z at 0.1 m/s. */
static void move_to(fixture *f, double *z, double to, int64_t *seq) {
    while (fabs(*z - to) > 1e-9) {
        *z += fmax(fmin(to - *z, 1e-4), -1e-4);
        put_pose(f, 1, ++*seq, *z);
        tick(f, NULL);
        serve_worker(f);
    }
}

static void a_seed_is_dropped_and_taken_back(void **state) {
    fixture *f = *state;
    int64_t seq = 0;
    double z = -0.201;
    needle_command answer = tell(f, TROCAR_COMMAND_T_DROP_SEED, 1);
    assert_true(answer.refused);
    assert_string_equal(answer.why, "needle 0 has not been held yet");
    put_pose(f, 1, ++seq, z);
    tick(f, NULL);
    serve_worker(f);
    answer = tell(f, TROCAR_COMMAND_T_DROP_SEED, 1);
    assert_true(answer.refused);
    assert_non_null(strstr(answer.why, "outside the tissue"));
    move_to(f, &z, -0.16, &seq);
    answer = tell(f, TROCAR_COMMAND_T_DROP_SEED, 2);
    assert_true(!answer.refused && answer.why[0] == '\0');
    assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(f->host.sim), 0), 2);
    move_to(f, &z, -0.17, &seq);
    assert_int_equal(trocar_view_seeds(trocar_sim_view(f->host.sim), NULL, 0), 1);
    assert_false(tell(f, TROCAR_COMMAND_T_UNDO, 0).refused);
    assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(f->host.sim), 0), 0);
    assert_int_equal(trocar_view_seeds(trocar_sim_view(f->host.sim), NULL, 0), 1);
    assert_false(tell(f, TROCAR_COMMAND_T_UNDO, 0).refused);
    assert_int_equal(trocar_view_seeds(trocar_sim_view(f->host.sim), NULL, 0), 0);
    answer = tell(f, TROCAR_COMMAND_T_UNDO, 0);
    assert_true(answer.refused && strstr(answer.why, "has no dropped seed"));
}

/* Removes the seed that the needle left, the one still in it and the needle itself. A clear that is carried out after the next insertion has begun leaves the
   needle. */
static void a_clear_removes_the_needle_and_its_seeds(void **state) {
    fixture *f = *state;
    int64_t seq = 0;
    double z = -0.201;
    move_to(f, &z, -0.15, &seq);
    for (uint64_t engagement = 0; engagement <= 1; engagement++) {
        needle_command clear = {.asked = {.command = TROCAR_COMMAND_T_CLEAR}, .engagement = engagement}, answer;
        trocar_needle_wrench_t w = {.depth = -1.0};
        assert_false(tell(f, TROCAR_COMMAND_T_DROP_SEED, 2).refused);
        move_to(f, &z, z - 0.01, &seq);
        assert_int_equal(trocar_view_seeds(trocar_sim_view(f->host.sim), NULL, 0), 1);
        assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(f->host.sim), 0), 1);
        assert_true(spsc_ring_push(&f->exchange.commands, &clear));
        while (spsc_ring_pop(&f->exchange.wrenches, &w)) continue; /* of earlier ticks */
        tick(f, &w);
        assert_true(spsc_ring_pop(&f->exchange.replies, &answer) && !answer.refused);
        assert_int_equal(trocar_view_seeds(trocar_sim_view(f->host.sim), NULL, 0), 0);
        assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(f->host.sim), 0), 0);
        assert_true(engagement == 1 ? w.depth == 0.0 && w.raw_force[2] == 0.0 : w.depth > 0.01);
    }
}

/* Passes a command to the haptic thread as the IO thread does, with the number of the needle's engagement. */
static void give(fixture *f, int what, uint64_t engagement) {
    needle_command c = {.asked = {.command = what, .seq = 9}, .engagement = engagement};
    assert_true(spsc_ring_push(&f->exchange.commands, &c));
}

static bool was_done(fixture *f) {
    needle_command answer;
    return spsc_ring_pop(&f->exchange.replies, &answer) && !answer.refused && answer.asked.seq == 9;
}

static double tissue_moved(const fixture *f) {
    static double u[3 * 4096];
    double most = 0.0;
    assert_int_equal(trocar_view_displacements(trocar_sim_view(f->host.sim), u, NULL), TROCAR_OK);
    for (int i = 0; i < 3 * trocar_model_node_count(f->host.model); i++) most = fmax(most, fabs(u[i]));
    return most;
}

/* The tick that carries out the reset removes the needle and leaves the tissue at rest, even if the owner holds still and sends no new pose. The wrench
   ramps down to zero. */
static void a_reset_of_a_held_needle_takes_effect_at_once(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w = push(f, 20), next;
    assert_true(tissue_moved(f) > 1e-4);
    give(f, TROCAR_COMMAND_T_RESET, 1);
    tick(f, &next);
    assert_true(was_done(f));
    assert_true(next.raw_force[2] == 0.0 && next.depth == 0.0 && next.contacts == 0);
    assert_true(tissue_moved(f) == 0.0);
    for (int i = 0; i < 110; i++) { /* poses from before the reset do not move the needle */
        double before = norm(w.force);
        put_pose(f, 1, f->tick, -0.185);
        w = next;
        tick(f, &next);
        assert_true(norm(next.force) <= norm(w.force) && norm(w.force) - norm(next.force) < 0.02 * 0.5);
        assert_true(next.depth == 0.0 && before >= norm(w.force));
    }
    assert_true(norm(next.force) == 0.0);
    w = move(f, 2, 0, 20); /* the next insertion is the same as the first */
    assert_true(w.force[2] < -0.3 && w.contacts >= 1 && w.depth > 0.005);
}

/* The command and the first pose after it may reach the tick in either order. */
static void a_reset_is_carried_out_once(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w;
    push(f, 20);
    give(f, TROCAR_COMMAND_T_RESET, 1);
    put_pose(f, 2, f->tick, -0.200);
    tick(f, &w);
    serve_worker(f);
    assert_true(was_done(f));
    for (int i = 0; i < 200; i++) { /* moves the tip from 0 to 10 mm */
        put_pose(f, 2, f->tick, -0.200 + 0.05e-3 * i);
        tick(f, &w);
        serve_worker(f);
    }
    double force = w.raw_force[2];
    assert_true(force < -0.1);
    give(f, TROCAR_COMMAND_T_RESET, 1); /* too late: the current engagement began after the command was issued */
    put_pose(f, 2, f->tick, -0.190);
    tick(f, &w);
    assert_true(was_done(f) && fabs(w.raw_force[2] - force) < 0.1 * fabs(force));
    give(f, TROCAR_COMMAND_T_RESET, 3); /* issued after a pose that the tick has not processed yet */
    put_pose(f, 3, f->tick, -0.190);
    tick(f, &w);
    assert_true(was_done(f) && w.raw_force[2] == 0.0 && w.depth == 0.0);
    put_pose(f, 3, f->tick, -0.190);
    tick(f, &w);
    assert_true(w.depth == 0.0);
    put_pose(f, 4, f->tick, -0.190);
    tick(f, &w);
    assert_true(w.depth > 0.005); /* inserted, without force */
}

static void work_until_answered(fixture *f) {
    for (int i = 0; i < 50 && !was_done(f); i++) {
        tick(f, NULL);
        for (trocar_work done = {.more = 1}; done.more;) assert_int_equal(trocar_sim_work(f->host.sim, &done, NULL), TROCAR_OK);
    }
}

/* A resting needle that has been taken is still in place when the reset arrives, but not afterwards. */
static void a_reset_after_take_is_not_lost(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w = {0};
    push(f, 20);
    give(f, TROCAR_COMMAND_T_LEAVE, 1);
    work_until_answered(f);
    assert_int_equal(trocar_sim_needle_state(f->host.sim, 0), TROCAR_NEEDLE_RESTING);
    give(f, TROCAR_COMMAND_T_TAKE, 1);
    work_until_answered(f);
    assert_int_equal(trocar_sim_needle_state(f->host.sim, 0), TROCAR_NEEDLE_HELD);
    give(f, TROCAR_COMMAND_T_RESET, 1);
    tick(f, NULL);
    assert_true(was_done(f));
    assert_true(tissue_moved(f) == 0.0);
    while (spsc_ring_pop(&f->exchange.wrenches, &w)) continue;
    put_pose_of(f, 0, 2, f->tick, 0.02, -0.201); /* the next hand starts at its own pose, not where the needle was */
    tick(f, &w);
    trocar_pose base = trocar_view_base(trocar_sim_view(f->host.sim), 0);
    assert_true(fabs(base.position[0] - 0.02) < 1e-9 && fabs(base.position[2] + 0.201) < 1e-9 && w.depth == 0.0);
}

/* Replies are kept until the IO thread reads them. Until then, further commands stay pending. */
static void every_command_is_answered_however_late(void **state) {
    enum { COUNT = 200 };
    fixture *f = *state;
    needle_command c = {.asked = {.command = TROCAR_COMMAND_T_UNDO}}, answer;
    int given = 0, answered = 0;
    for (int round = 0; round < 2 * COUNT; round++) {
        if (given < COUNT && (c.asked.seq = given, spsc_ring_push(&f->exchange.commands, &c))) given++;
        tick(f, NULL);
        if (round < COUNT) continue; /* up to here, the IO thread does not run */
        while (spsc_ring_pop(&f->exchange.replies, &answer)) assert_int_equal(answer.asked.seq, answered++);
    }
    assert_int_equal(given, COUNT);
    assert_int_equal(answered, COUNT);
}

/* The probe moves 100 times per second, even if the loop rate is not a multiple of 100 Hz. */
static void the_probe_moves_at_its_pace_at_any_rate(void **state) {
    fixture *f = *state;
    static const int rates[] = {250, 256, 1000, 1001, 3333};
    for (size_t r = 0; r < sizeof rates / sizeof *rates; r++) {
        f->haptic.period = 1.0 / rates[r];
        int moved = 0;
        for (int t = 0; t < 3 * rates[r]; t++) {
            probe_sample sample = {.session = 3, .seq = t};
            *(probe_sample *)triple_buffer_slot(&f->exchange.probe_poses) = sample;
            triple_buffer_publish(&f->exchange.probe_poses);
            haptic_tick(&f->haptic, &(loop_wake){.tick = t, .now = (int64_t)(1e9 * t / rates[r]), .elapsed = 1.0 / rates[r]});
            moved += f->haptic.probe_seq == t;
        }
        assert_in_range(moved, 299, 301);
    }
}

/* ---- two needles, 60 mm apart ---- */

static int open_pair(void **state) {
    fixture *f = *state = allocate_on_cache_lines(sizeof *f);
    f->host = host_open_with(MESHES "/figure8.yaml", "needles", "2");
    return 0;
}

enum { PUSHED = 400, AT_REST = 100 }; /* 400 ticks of 0.05 mm insert by 20 mm, followed by 100 ticks at rest */
static double depth_at(int i) { return -0.205 + 0.05e-3 * (i < PUSHED ? i : PUSHED); }
static void put_in_pair(fixture *f, int needle, int i) { put_pose_of(f, needle, 1, i, 0.06 * (needle - 0.5), depth_at(i)); }

static void tick_pair(fixture *f, trocar_needle_wrench_t w[2]) {
    tick(f, &w[0]);
    bool held = f->poses.needles[1].held; /* whether a hand has ever held it; until then, nothing is published for any needle but the first */
    w[1] = (trocar_needle_wrench_t){.needle = 1, .pose_seq = -1, .tick = w[0].tick};
    assert_int_equal(spsc_ring_pop(&f->exchange.wrenches, &w[1]), held);
    assert_true(w[0].needle == 0 && w[1].needle == 1 && w[0].tick == w[1].tick);
    for (trocar_work done = {.answered = 1}; done.answered;) assert_int_equal(trocar_sim_work(f->host.sim, &done, NULL), TROCAR_OK);
}

/* Inserts one needle or both. */
static void push_pair(fixture *f, bool first, bool second, trocar_needle_wrench_t w[2]) {
    for (int i = 0; i <= PUSHED + AT_REST; i++) {
        if (first) put_in_pair(f, 0, i);
        if (second) put_in_pair(f, 1, i);
        tick_pair(f, w);
    }
}

/* Uses the bound from tests/public/test_needles.c: each needle changes the other's force by less than a tenth. */
static void each_device_feels_its_own_needle(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t both[2], alone[2][2];
    push_pair(f, true, true, both);
    for (int n = 0; n < 2; n++) {
        end(state);
        begin(state);
        push_pair(f, n == 0, n == 1, alone[n]);
        const trocar_needle_wrench_t *other = &alone[n][1 - n];
        assert_true(other->session == 0 && other->pose_seq == -1 && norm(other->force) == 0.0 && other->depth == 0.0);
        double off = 0.0;
        for (int a = 0; a < 3; a++) off = fmax(off, fabs(both[n].force[a] - alone[n][n].force[a]));
        print_message("needle %d: %.4f N, alone %.4f N\n", n, norm(both[n].force), norm(alone[n][n].force));
        assert_true(both[n].session == 8 + n && both[n].contacts >= 1 && norm(both[n].force) > 0.2);
        assert_true(off < 0.1 * norm(both[n].force));
    }
}

static void a_fault_of_one_needle_leaves_the_other_alone(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t before[2], w[2];
    push_pair(f, true, true, before);
    f->host.sim->needles[0].state.tip.place.depth = NAN;
    put_in_pair(f, 0, PUSHED + AT_REST + 1);
    put_in_pair(f, 1, PUSHED + AT_REST + 1);
    tick_pair(f, w);
    assert_true(w[0].flags & TROCAR_NEEDLE_WRENCH_T_UNSTABLE);
    assert_false(w[1].flags & TROCAR_NEEDLE_WRENCH_T_UNSTABLE);
    assert_true(fabs(norm(w[1].force) - norm(before[1].force)) < 0.01);

    for (int i = 0; i < 115; i++) { /* needle 0's device has gone silent */
        put_in_pair(f, 1, PUSHED + AT_REST + 2 + i);
        tick_pair(f, w);
    }
    assert_true(w[0].flags & TROCAR_NEEDLE_WRENCH_T_STALE && norm(w[0].force) == 0.0);
    assert_true(w[1].flags == TROCAR_NEEDLE_WRENCH_T_NOT_REALTIME && norm(w[1].force) > 0.2 && w[1].depth >= before[1].depth);

    int contacts = w[1].contacts;
    put_pose_of(f, 0, 2, 1000, -0.03, -0.205); /* the device is back and starts a new insertion */
    tick_pair(f, w);
    assert_true(w[0].depth == 0.0 && w[0].contacts == 0);
    assert_true(w[1].depth >= before[1].depth && w[1].contacts == contacts);
}

static void both_needles_wind_down(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t w[2];
    push_pair(f, true, true, w);
    atomic_store(&f->haptic.wind_down, true);
    int ticks = 1;
    for (bool on = true; on; ticks++) {
        on = tick(f, &w[0]);
        assert_true(spsc_ring_pop(&f->exchange.wrenches, &w[1]));
    }
    assert_in_range(ticks, 95, 110);
    assert_true(norm(w[0].force) == 0.0 && norm(w[1].force) == 0.0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(zero_wrench_before_the_first_pose, begin, end),
        cmocka_unit_test_setup_teardown(wrench_echoes_its_pose, begin, end),
        cmocka_unit_test_setup_teardown(insertion_gives_force_and_requests_to_the_worker, begin, end),
        cmocka_unit_test_setup_teardown(snapshot_age_is_that_of_the_oldest_pending_request, begin, end),
        cmocka_unit_test_setup_teardown(silence_ramps_to_zero_and_is_flagged, begin, end),
        cmocka_unit_test_setup_teardown(what_comes_after_a_gap_comes_by_a_ramp, begin, end),
        cmocka_unit_test_setup_teardown(wrenches_dropped_by_a_full_ring_are_counted, begin, end),
        cmocka_unit_test_setup_teardown(every_command_is_answered_however_late, begin, end),
        cmocka_unit_test_setup_teardown(the_probe_moves_at_its_pace_at_any_rate, begin, end),
        cmocka_unit_test_setup_teardown(winding_down_ends_the_loop_at_zero, begin, end),
        cmocka_unit_test_setup_teardown(new_engagement_starts_outside, begin, end),
        cmocka_unit_test_setup_teardown(recovers_from_non_finite_values, begin, end),
        cmocka_unit_test_setup_teardown(round_trip_ends_with_the_first_acknowledging_pose, begin, end),
        cmocka_unit_test_setup_teardown(a_seed_is_dropped_and_taken_back, begin, end),
        cmocka_unit_test_setup_teardown(a_clear_removes_the_needle_and_its_seeds, begin, end),
        cmocka_unit_test_setup_teardown(a_reset_of_a_held_needle_takes_effect_at_once, begin, end),
        cmocka_unit_test_setup_teardown(a_reset_is_carried_out_once, begin, end),
        cmocka_unit_test_setup_teardown(a_reset_after_take_is_not_lost, begin, end),
        cmocka_unit_test_setup_teardown(stage_times_add_up_to_the_tick, begin, end),
    };
    const struct CMUnitTest pair[] = {
        cmocka_unit_test_setup_teardown(each_device_feels_its_own_needle, begin, end),
        cmocka_unit_test_setup_teardown(a_fault_of_one_needle_leaves_the_other_alone, begin, end),
        cmocka_unit_test_setup_teardown(both_needles_wind_down, begin, end),
    };
    int failed = cmocka_run_group_tests(tests, open_scene, close_scene);
    return failed + cmocka_run_group_tests(pair, open_pair, close_scene);
}

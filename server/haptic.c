#include "haptic.h"

#include <stdlib.h>
#include <string.h>

#include "messages.h"
#include "trocar_loop_timing_t.h"

enum { VIEWS_HZ = 60 };

trocar_status haptic_create(haptic *h, const insertion_model *model, insertion_workspace *scratch, const device_limits *limits,
                            double rate_hz, int flags, exchange *x, report *why) {
    *h = (haptic){.model = model, .limits = *limits, .period = 1.0 / rate_hz, .flags = flags, .exchange = x,
                  .scratch = scratch};
    atomic_init(&h->wind_down, false);
    h->state = malloc(sizeof *h->state);
    if (h->state == NULL) return fail(why, TROCAR_NO_MEMORY, "cannot allocate the needle's state");
    memset(h->state, 0, sizeof *h->state); /* touched, not only zero: no page faults later */
    memset(scratch, 0, sizeof *scratch);
    scratch->profile.clock = monotonic_ns;
    return TROCAR_OK;
}

void haptic_free(haptic *h) {
    free(h->state);
    h->state = NULL;
}

/* A number that is not finite would stay in the model for good: start over where the hand is, by a ramp. RT */
static void start_over(haptic *h, const pose_sample *newest, insertion_wrench *wrench) {
    insertion_start_over(h->model, h->safety.base, h->state, wrench);
    coupling_engage(&h->coupling, newest);
    h->safety.gain = 0.0;
}

/* The model's wrench for the newest pose; zero before the first one. RT */
static insertion_wrench run_model(haptic *h, safety_decision decision, const pose_sample *newest, const compliance_snapshot *snapshot, double dt) {
    insertion_wrench wrench = {.membrane = -1};
    if (decision == SAFETY_IDLE) return wrench;
    pose hand = h->safety.base;
    if (decision == SAFETY_ENGAGE) insertion_reset(h->model, hand, h->state);
    pose rest = coupling_hold(&h->coupling, h->limits.max_stiffness, hand, dt, &h->state->base_compliance);
    insertion_tick(h->model, h->state, h->scratch, snapshot, rest, dt, &wrench);
    vec3 base = v3_add(rest.position, h->state->base_shift);
    wrench.torque = coupling_yield(&h->coupling, hand, base, wrench.force, wrench.torque);
    if (!insertion_is_finite(h->state, &wrench)) start_over(h, newest, &wrench);
    return wrench;
}

static trocar_needle_wrench_t message_of(const haptic *h, const insertion_wrench *raw, const pose_sample *answered, int64_t tick) {
    trocar_needle_wrench_t m = wrench_message(raw);
    m.utime = wall_us();
    m.tick = tick;
    m.server = h->server;
    m.session = answered->session;
    m.pose_seq = answered->held ? answered->seq : -1;
    m.pose_utime = answered->held ? answered->utime : 0;
    return m;
}

/* Queues the wrench for the IO thread. RT */
static void send_wrench(haptic *h, const trocar_needle_wrench_t *message) {
    if (!spsc_ring_push(&h->exchange->wrenches, message)) h->wrench_dropped++;
    wake(h->exchange->io_wake);
}

/* What the newest pose tells of the way to the hand. RT */
static void note_hand(haptic *h, safety_decision decision, const pose_sample *newest) {
    if (decision == SAFETY_ENGAGE) coupling_engage(&h->coupling, newest);
    if (decision != SAFETY_FOLLOW) return;
    int64_t round_trip = coupling_receive(&h->coupling, newest);
    if (round_trip >= 0) spsc_ring_push(&h->exchange->round_trips, &round_trip);
}

/* Where the tick's time went: before, in and after the model. RT */
static void note_stages(haptic *h, int64_t began, int64_t asked, int64_t answered) {
    const int64_t *model = h->scratch->profile.spent;
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_INPUT] = asked - began;
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_TISSUE] = model[INSERTION_TISSUE];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_NEEDLE] = model[INSERTION_NEEDLE];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_CONTACT] = model[INSERTION_CONTACT];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_WRENCH] = model[INSERTION_WRENCH];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_OUTPUT] = monotonic_ns() - answered;
}

/* Hands the worker what the tick wants to know next, if that has changed. RT */
static void ask_worker(haptic *h, int64_t now) {
    if (h->state->request.serial == h->posted) return;
    request_sample *sample = triple_buffer_slot(&h->exchange->requests);
    sample->requested = now;
    sample->request = h->state->request;
    triple_buffer_publish(&h->exchange->requests);
    wake(h->exchange->worker_wake);
    while (h->posted < sample->request.serial) h->asked[++h->posted % REQUESTS_REMEMBERED] = now;
}

/* Seconds since the oldest request that is not answered yet, 0 if all are. RT */
static double snapshot_age(const haptic *h, int64_t now, uint64_t answered) {
    if (answered == h->posted) return 0.0;
    uint64_t waiting = h->posted - answered < REQUESTS_REMEMBERED ? answered : h->posted; /* or the oldest remembered */
    return 1e-9 * (double)(now - h->asked[(waiting + 1) % REQUESTS_REMEMBERED]);
}

/* Shows the state to telemetry, VIEWS_HZ times a second, once there is one. RT */
static void show(haptic *h, const loop_wake *wake, const trocar_needle_wrench_t *message, uint64_t answered) {
    int64_t ticks_per_view = (int64_t)fmax(1.0, 1.0 / (VIEWS_HZ * h->period));
    if (h->safety.engagement == 0 || wake->tick % ticks_per_view != 0) return;
    view_sample *view = triple_buffer_slot(&h->exchange->views);
    view->tick = wake->tick;
    view->pose_utime = message->pose_utime;
    view->flags = message->flags;
    view->wrench_dropped = h->wrench_dropped;
    view->saturated_ticks = h->saturated_ticks;
    view->energy = h->coupling.energy;
    view->energy_lowest = h->coupling.lowest;
    view->coupling_stiffness = h->coupling.stiffness;
    view->snapshot_age = snapshot_age(h, wake->now, answered);
    view->state = *h->state;
    triple_buffer_publish(&h->exchange->views);
}

bool haptic_tick(void *context, const loop_wake *wake) {
    haptic *h = context;
    int64_t began = monotonic_ns();
    bool wind_down = atomic_load_explicit(&h->wind_down, memory_order_relaxed);
    const pose_sample *newest = triple_buffer_read(&h->exchange->poses, NULL);
    const compliance_snapshot *snapshot = triple_buffer_read(&h->exchange->snapshots, NULL);

    safety_timing(&h->safety, wake->late, h->period);
    safety_decision decision = safety_pose(&h->safety, &h->limits, newest, wake->now);
    note_hand(h, decision, newest);
    int64_t asked = monotonic_ns();
    insertion_wrench raw = run_model(h, decision, newest, snapshot, wake->elapsed);
    int64_t answered = monotonic_ns();
    trocar_needle_wrench_t message = message_of(h, &raw, newest, wake->tick);

    vec3 force = raw.force, torque = raw.torque;
    message.flags |= h->flags | safety_wrench(&h->safety, &h->limits, wind_down, h->period, &force, &torque);
    if (coupling_active(&h->coupling)) message.flags |= TROCAR_NEEDLE_WRENCH_T_ACTIVE;
    h->saturated_ticks += (message.flags & TROCAR_NEEDLE_WRENCH_T_SATURATED) != 0;
    store_vec3(force, message.force);
    store_vec3(torque, message.torque);
    coupling_send(&h->coupling, wake->tick, wake->now, force, torque);
    send_wrench(h, &message);

    ask_worker(h, wake->now);
    show(h, wake, &message, snapshot->serial);
    note_stages(h, began, asked, answered);
    return !(wind_down && safety_at_rest(&h->safety));
}

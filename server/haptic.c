#include "haptic.h"

#include "messages.h"
#include "trocar_loop_timing_t.h"

enum { VIEWS_HZ = 60, NEEDLE = 0 };

void haptic_init(haptic *h, trocar_sim *sim, const trocar_device_limits *limits, double rate_hz, int flags, exchange *x) {
    *h = (haptic){.sim = sim, .limits = *limits, .period = 1.0 / rate_hz, .flags = flags, .exchange = x};
    atomic_init(&h->wind_down, false);
    trocar_sim_set_clock(sim, monotonic_ns);
}

/* RT */
static void reset_needle(haptic *h) {
    trocar_pose base = library_pose(h->safety.base);
    trocar_sim_reset(h->sim, NEEDLE, &base, NULL);
}

static bool is_finite(const trocar_output *out) {
    return isfinite(out->force[0] + out->force[1] + out->force[2] + out->torque[0] + out->torque[1] + out->torque[2]);
}

/* After a tick whose result was not finite: restarts at the hand's position, with a ramp of the wrench. RT */
static void start_over(haptic *h, const pose_sample *newest, trocar_output *out) {
    reset_needle(h);
    coupling_engage(&h->coupling, newest);
    h->safety.gain = 0.0;
    *out = (trocar_output){.membrane = -1, .events = TROCAR_EVENT_UNSTABLE};
}

/* The simulation's answer to the newest pose; zero before the first one. RT */
static trocar_output run_simulation(haptic *h, safety_decision decision, const pose_sample *newest, double dt) {
    static const double LONGEST = 1.0; /* s, longest tick of the library */
    trocar_output out = {.membrane = -1};
    if (decision == SAFETY_IDLE) return out;
    if (decision == SAFETY_ENGAGE) reset_needle(h);
    double compliance;
    pose hand = h->safety.base;
    trocar_pose rest = library_pose(coupling_hold(&h->coupling, h->limits.max_stiffness, hand, dt, &compliance));
    trocar_sim_set_base_compliance(h->sim, NEEDLE, compliance);
    trocar_status status = trocar_sim_tick(h->sim, NEEDLE, &rest, fmin(dt, LONGEST), &out);
    trocar_pose base = trocar_sim_base(h->sim, NEEDLE);
    store_vec3(coupling_yield(&h->coupling, hand, load_vec3(base.position), load_vec3(out.force), load_vec3(out.torque)), out.torque);
    if (status != TROCAR_OK || !is_finite(&out)) start_over(h, newest, &out);
    return out;
}

static trocar_needle_wrench_t message_of(const haptic *h, const trocar_output *raw, const pose_sample *answered, int64_t tick) {
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

/* Passes the newest pose to the virtual coupling, which measures the round trip. RT */
static void note_hand(haptic *h, safety_decision decision, const pose_sample *newest) {
    if (decision == SAFETY_ENGAGE) coupling_engage(&h->coupling, newest);
    if (decision != SAFETY_FOLLOW) return;
    int64_t round_trip = coupling_receive(&h->coupling, newest);
    if (round_trip >= 0) spsc_ring_push(&h->exchange->round_trips, &round_trip);
}

/* Records the tick's times before, in and after the simulation. RT */
static void note_stages(haptic *h, int64_t began, int64_t asked, int64_t answered) {
    int64_t spent[TROCAR_STAGES];
    trocar_sim_stages(h->sim, spent);
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_INPUT] = asked - began;
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_TISSUE] = spent[TROCAR_STAGE_TISSUE];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_NEEDLE] = spent[TROCAR_STAGE_NEEDLE];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_CONTACT] = spent[TROCAR_STAGE_CONTACT];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_WRENCH] = spent[TROCAR_STAGE_WRENCH];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_OUTPUT] = monotonic_ns() - answered;
}

/* Publishes a view for telemetry, VIEWS_HZ times per second, once a needle has been engaged. RT */
static void show(haptic *h, const loop_wake *wake, const trocar_needle_wrench_t *message) {
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
    view->snapshot_age = 1e-9 * (double)trocar_sim_waiting(h->sim);
    view->contacts = message->contacts;
    trocar_sim_take_picture(h->sim, view->picture);
    triple_buffer_publish(&h->exchange->views);
}

bool haptic_tick(void *context, const loop_wake *wake) {
    haptic *h = context;
    int64_t began = monotonic_ns();
    bool wind_down = atomic_load_explicit(&h->wind_down, memory_order_relaxed);
    const pose_sample *newest = triple_buffer_read(&h->exchange->poses, NULL);

    safety_timing(&h->safety, wake->late, h->period);
    safety_decision decision = safety_pose(&h->safety, &h->limits, newest, wake->now);
    note_hand(h, decision, newest);
    int64_t asked = monotonic_ns();
    trocar_output raw = run_simulation(h, decision, newest, wake->elapsed);
    int64_t answered = monotonic_ns();
    trocar_needle_wrench_t message = message_of(h, &raw, newest, wake->tick);

    vec3 force = load_vec3(raw.force), torque = load_vec3(raw.torque);
    message.flags |= h->flags | safety_wrench(&h->safety, &h->limits, wind_down, h->period, &force, &torque);
    if (coupling_active(&h->coupling)) message.flags |= TROCAR_NEEDLE_WRENCH_T_ACTIVE;
    h->saturated_ticks += (message.flags & TROCAR_NEEDLE_WRENCH_T_SATURATED) != 0;
    store_vec3(force, message.force);
    store_vec3(torque, message.torque);
    coupling_send(&h->coupling, wake->tick, wake->now, force, torque);
    send_wrench(h, &message);

    show(h, wake, &message);
    note_stages(h, began, asked, answered);
    return !(wind_down && safety_at_rest(&h->safety));
}

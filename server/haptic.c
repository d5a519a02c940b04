#include "haptic.h"

#include <stdio.h>
#include <string.h>

#include "base/error.h"
#include "common/messages.h"
#include "common/eventfd_signal.h"
#include "trocar_command_t.h"
#include "trocar_loop_timing_t.h"
#include "trocar_probe_wrench_t.h"

enum { VIEWS_HZ = 60, PROBE_HZ = 100, PROBE_LEAST_HZ = 10 };

void haptic_init(haptic *h, trocar_sim *sim, int needle_count, const trocar_device_limits *limits, double rate_hz, int flags, exchange *x) {
    *h = (haptic){.sim = sim, .needle_count = needle_count, .limits = *limits, .period = 1.0 / rate_hz, .flags = flags, .exchange = x,
                  .probe_seq = -1};
    atomic_init(&h->wind_down, false);
    trocar_sim_set_clock(sim, monotonic_ns);
}

/* RT */
static void reset_needle(haptic *h, int needle) {
    trocar_pose base = library_pose(h->needles[needle].safety.base);
    trocar_sim_reset(h->sim, needle, &base, NULL);
}

static bool is_finite(const trocar_output *out) {
    return isfinite(out->force[0] + out->force[1] + out->force[2] + out->torque[0] + out->torque[1] + out->torque[2]);
}

/* Recovers from a tick with a non-finite result: resets the needle to the hand's position and ramps its wrench up from zero. RT */
static void start_over(haptic *h, int needle, const pose_sample *newest, trocar_output *out) {
    reset_needle(h, needle);
    coupling_engage(&h->needles[needle].coupling, newest);
    h->needles[needle].safety.gain = 0.0;
    *out = (trocar_output){.membrane = -1, .events = TROCAR_EVENT_UNSTABLE};
}

/* Engages the needle. A resting needle that the hand has picked up stays where it is; any other needle starts a new insertion. RT */
static void engage_needle(haptic *h, int needle) {
    haptic_needle *n = &h->needles[needle];
    if (!n->taken) reset_needle(h, needle);
    n->taken = n->rests = false;
}

/* Returns the pose that drives the needle's base: the hand's pose, shifted by the clutch's offset if the hand picked the needle up. RT */
static pose_sample hand_on_needle(haptic *h, int needle, const pose_sample *newest) {
    haptic_needle *n = &h->needles[needle];
    pose_sample hand = *newest;
    if (newest->held && newest->engagement != n->safety.engagement) {
        trocar_pose base = trocar_view_base(trocar_sim_view(h->sim), needle);
        n->clutch = n->taken ? clutch_engage(newest->base, &base) : (hand_clutch){.engaged = false};
    }
    hand.base = clutch_follow(&n->clutch, newest->base);
    return hand;
}

/* Queues the reply to a command. The queue must have room. RT */
static void answer_command(haptic *h, needle_command *c, bool refused, const char *why) {
    c->refused = refused;
    snprintf(c->why, sizeof c->why, "%.*s", (int)sizeof c->why - 1, why);
    spsc_ring_push(&h->exchange->replies, c);
    eventfd_signal(h->exchange->io_wake);
}

/* Drops seeds, or takes one back. Refused if the needle has never been held, because its position in the simulation is then arbitrary. RT, except when it
   formats the reason for a refusal. */
static trocar_status handle_held_seeds(haptic *h, const trocar_command_t *m, trocar_error *why) {
    if (h->needles[m->needle].safety.engagement == 0) return fail(why, TROCAR_BAD_INPUT, "needle %d has not been held yet", m->needle);
    return handle_seeds(h->sim, m->needle, m, why);
}

/* Starts a command that takes the needle from the hand or prepares to give it to one. The worker may have to complete it, so finish_command replies. Until a
   hand picks the needle up or starts a new insertion, nothing moves it. RT, except when it formats the reason for a refusal. */
static trocar_status hand_over_needle(haptic *h, const needle_command *c, trocar_error *why) {
    int needle = c->asked.needle;
    haptic_needle *n = &h->needles[needle];
    trocar_status status;
    if (n->pending) return fail(why, TROCAR_BAD_INPUT, "another command is being carried out");
    switch (c->asked.command) {
    case TROCAR_COMMAND_T_LEAVE: status = trocar_sim_leave(h->sim, needle, why); break;
    case TROCAR_COMMAND_T_TAKE: status = trocar_sim_take(h->sim, needle, why); break;
    default:
        status = remove_needle(h->sim, needle, why);
        if (n->safety.engagement < c->engagement) n->safety.engagement = c->engagement; /* poses from before the reset must not engage the needle */
    }
    if (status != TROCAR_OK) return status;
    n->rests = n->pending = true;
    n->taken = false;
    n->command = *c;
    safety_begin_transfer(&n->safety);
    return TROCAR_OK;
}

/* Returns whether a new insertion has begun already, because the first pose after a reset arrived before the reset was carried out. RT */
static bool has_begun_anew(const haptic *h, const needle_command *c) {
    bool resets = c->asked.command == TROCAR_COMMAND_T_RESET || c->asked.command == TROCAR_COMMAND_T_CLEAR;
    return resets && h->needles[c->asked.needle].safety.engagement > c->engagement;
}

/* Carries out or starts a command. Replies if nothing remains to be done. RT, except when it formats the reason for a refusal. */
static void start_command(haptic *h, needle_command *c) {
    trocar_error why = {""};
    trocar_status status = TROCAR_OK;
    if (c->change) {
        status = trocar_sim_change(h->sim, c->change, c->change_time, &why);
        answer_command(h, c, status != TROCAR_OK, why.text);
        return;
    }
    bool seeds = c->asked.command == TROCAR_COMMAND_T_DROP_SEED || c->asked.command == TROCAR_COMMAND_T_UNDO, hands_over = !seeds && !has_begun_anew(h, c);
    if (seeds) status = handle_held_seeds(h, &c->asked, &why);
    if (hands_over) status = hand_over_needle(h, c, &why);
    if (status == TROCAR_OK && c->asked.command == TROCAR_COMMAND_T_CLEAR) handle_seeds(h->sim, c->asked.needle, &c->asked, &why);
    if (!hands_over || status != TROCAR_OK) answer_command(h, c, status != TROCAR_OK, why.text);
}

/* RT */
static void finish_command(haptic *h, int needle) {
    haptic_needle *n = &h->needles[needle];
    if (!n->pending) return;
    trocar_needle_state state = trocar_sim_needle_state(h->sim, needle);
    if (state == TROCAR_NEEDLE_LEAVING || state == TROCAR_NEEDLE_TAKING) return;
    bool left = n->command.asked.command == TROCAR_COMMAND_T_LEAVE, refused = left && state == TROCAR_NEEDLE_HELD;
    n->pending = false;
    n->rests = !refused;
    n->taken = n->command.asked.command == TROCAR_COMMAND_T_TAKE;
    answer_command(h, &n->command, refused, refused ? "it would not come to rest in the tissue when released: draw it back a little, or hold it still" : "");
}

/* Starts at most one command per tick, so that a flood of commands delays no tick. While the reply queue is full, commands wait, because client and arbiter
   would wait forever for a reply that was lost. A change of moduli waits until the previous one is complete. RT */
static void follow_commands(haptic *h) {
    spsc_ring *replies = &h->exchange->replies;
    needle_command c;
    bool waits = h->later.change && !trocar_sim_accepts(h->sim, h->later.change);
    if (h->later.change && !waits && spsc_ring_has_room(replies)) {
        start_command(h, &h->later);
        h->later.change = NULL;
    } else if (spsc_ring_has_room(replies) && spsc_ring_pop(&h->exchange->commands, &c)) {
        if (c.change && !trocar_sim_accepts(h->sim, c.change)) h->later = c;
        else start_command(h, &c);
    }
    for (int i = 0; i < h->needle_count && spsc_ring_has_room(replies); i++) finish_command(h, i);
}

/* Returns how the simulation responds to the newest pose; zero if there has been no pose yet. RT */
static trocar_output run_simulation(haptic *h, int needle, safety_decision decision, const pose_sample *newest, double dt) {
    static const double LONGEST = 1.0; /* s, longest tick that the library accepts */
    haptic_needle *n = &h->needles[needle];
    trocar_output out = {.membrane = -1};
    if (decision == SAFETY_IDLE) return out;
    if (decision == SAFETY_ENGAGE) engage_needle(h, needle);
    if (n->rests) return out;
    double compliance;
    pose hand = n->safety.base;
    trocar_pose rest = library_pose(coupling_hold(&n->coupling, &h->limits, hand, dt, &compliance));
    trocar_sim_set_base_compliance(h->sim, needle, compliance);
    trocar_status status = trocar_sim_tick(h->sim, needle, &rest, fmin(dt, LONGEST), &out);
    trocar_pose base = trocar_view_base(trocar_sim_view(h->sim), needle);
    store_vec3(coupling_yield(&n->coupling, hand, load_vec3(base.position), load_vec3(out.force), load_vec3(out.torque)), out.torque);
    if (status != TROCAR_OK || !is_finite(&out)) start_over(h, needle, newest, &out);
    return out;
}

static trocar_needle_wrench_t message_of(const haptic *h, int needle, const trocar_output *raw, const pose_sample *answered, int64_t tick) {
    trocar_needle_wrench_t m = wrench_message(raw);
    m.utime = wall_us();
    m.tick = tick;
    m.server = h->server;
    m.needle = needle;
    m.session = answered->held ? answered->session : 0;
    m.pose_seq = answered->held ? answered->seq : -1;
    m.pose_utime = answered->held ? answered->utime : 0;
    return m;
}

/* Queues the wrench for the IO thread, which sends it while this thread computes the next needle. RT */
static void send_wrench(haptic *h, const trocar_needle_wrench_t *message) {
    if (!spsc_ring_push(&h->exchange->wrenches, message)) h->wrench_dropped++;
    eventfd_signal(h->exchange->io_wake);
}

/* Passes the newest pose to the virtual coupling so that it can measure the round-trip time. RT */
static void note_hand(haptic *h, virtual_coupling *coupling, safety_decision decision, const pose_sample *newest) {
    if (decision == SAFETY_ENGAGE) coupling_engage(coupling, newest);
    if (decision != SAFETY_FOLLOW) return;
    int64_t round_trip = coupling_receive(coupling, newest);
    if (round_trip >= 0) spsc_ring_push(&h->exchange->round_trips, &round_trip);
}

/* Adds the time spent on one needle before, during and after the simulation to the stages of the tick. `ticked`: whether the simulation was called. RT */
static void note_stages(haptic *h, bool ticked, int64_t began, int64_t asked, int64_t answered) {
    int64_t spent[TROCAR_STAGES] = {0};
    if (ticked) trocar_sim_stages(h->sim, spent);
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_INPUT] += asked - began;
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_TISSUE] += spent[TROCAR_STAGE_TISSUE];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_NEEDLE] += spent[TROCAR_STAGE_NEEDLE];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_CONTACT] += spent[TROCAR_STAGE_CONTACT];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_WRENCH] += spent[TROCAR_STAGE_WRENCH];
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_OUTPUT] += monotonic_ns() - answered;
}

static needle_view view_of(const haptic *h, int needle, const trocar_needle_wrench_t *message) {
    const haptic_needle *n = &h->needles[needle];
    return (needle_view){.engaged = n->safety.engagement != 0, .pose_utime = message->pose_utime, .flags = message->flags,
                         .saturated_ticks = n->saturated_ticks, .energy = n->coupling.energy, .energy_lowest = n->coupling.lowest,
                         .coupling_stiffness = n->coupling.stiffness, .contacts = message->contacts,
                         .state = trocar_sim_needle_state(h->sim, needle)};
}

/* Returns true in `hz` ticks per second, even if the loop's rate is not a multiple of `hz`. A tick due at some rate is also due at ten times that rate. RT */
static bool is_due(const haptic *h, int64_t tick, int hz) { return tick * hz % llround(1.0 / h->period) < hz; }

/* Publishes a view for telemetry, VIEWS_HZ times per second, once a hand has held a needle or the probe has been placed. RT */
static void show(haptic *h, const loop_wake *wake, const trocar_needle_wrench_t *messages) {
    bool engaged = h->probe.placed != 0;
    for (int i = 0; i < h->needle_count; i++) engaged |= h->needles[i].safety.engagement != 0;
    if (!engaged || !is_due(h, wake->tick, VIEWS_HZ)) return;
    view_sample *view = triple_buffer_slot(&h->exchange->views);
    view->tick = wake->tick;
    view->wrench_dropped = h->wrench_dropped;
    view->snapshot_age = 1e-9 * (double)trocar_sim_waiting(h->sim);
    for (int i = 0; i < h->needle_count; i++) view->needles[i] = view_of(h, i, &messages[i]);
    trocar_sim_take_picture(h->sim, view->picture);
    triple_buffer_publish(&h->exchange->views);
}

/* Starts a bumpless transfer when the model's wrench becomes reliable again. Does so also if the wrench jumps because the worker was late, or because the hand
   moved while no poses arrived or the loop was suspended. RT */
static void heed_faults(haptic_needle *n, const trocar_output *raw, bool unseen) {
    static const double FELT = 0.05, FELT_PART = 0.07; /* FELT in N, FELT_PART as a fraction of the force: if the force changes by more than both within a tick,
                                                          it feels like a knock */
    bool late = raw->events & TROCAR_EVENT_LATE, faulty = late || raw->events & TROCAR_EVENT_UNSTABLE;
    bool punctures = raw->events & TROCAR_EVENT_PUNCTURED && !unseen;
    vec3 force = load_vec3(raw->force);
    double jump = v3_norm(v3_sub(force, n->force));
    bool jumps = jump > fmax(FELT, FELT_PART * v3_norm(force)) && (late || unseen);
    if ((n->faulty && !faulty) || (jumps && !punctures)) safety_begin_transfer(&n->safety);
    n->faulty = faulty;
    n->force = force;
}

/* Computes and sends the needle's wrench. Returns false once the wrench has been ramped down to zero after `wind_down`. RT */
static bool tick_needle(haptic *h, int needle, const loop_wake *wake, const pose_sample *newest, bool wind_down,
                        trocar_needle_wrench_t *message) {
    haptic_needle *n = &h->needles[needle];
    int64_t began = monotonic_ns();
    safety_timing(&n->safety, wake->late, h->period);
    pose_sample hand = hand_on_needle(h, needle, newest);
    double unseen = 1e-9 * (double)(hand.received - n->safety.received); /* s between the last two poses that moved the needle */
    safety_decision decision = safety_pose(&n->safety, &h->limits, &hand, wake->now);
    note_hand(h, &n->coupling, decision, &hand);
    int64_t asked = monotonic_ns();
    trocar_output raw = run_simulation(h, needle, decision, &hand, wake->elapsed);
    int64_t answered = monotonic_ns();
    heed_faults(n, &raw, decision == SAFETY_FOLLOW && unseen > h->limits.hold_time);

    *message = message_of(h, needle, &raw, newest, wake->tick);
    vec3 force = load_vec3(raw.force), torque = load_vec3(raw.torque);
    message->flags |= h->flags | safety_wrench(&n->safety, &h->limits, wind_down, h->period, &force, &torque);
    if (coupling_active(&n->coupling)) message->flags |= TROCAR_NEEDLE_WRENCH_T_ACTIVE;
    if (h->probe.stopped) message->flags |= TROCAR_NEEDLE_WRENCH_T_PROBE_STOPPED;
    n->saturated_ticks += (message->flags & TROCAR_NEEDLE_WRENCH_T_SATURATED) != 0;
    store_vec3(force, message->force);
    store_vec3(torque, message->torque);
    coupling_send(&n->coupling, wake->tick, wake->now, force, torque);
    bool silent = needle > 0 && (n->safety.engagement == 0 || (n->rests && safety_at_rest(&n->safety)));
    if (!silent) send_wrench(h, message);
    note_stages(h, decision != SAFETY_IDLE, began, asked, answered);
    return !(wind_down && safety_at_rest(&n->safety));
}

static void send_probe(haptic *h, int64_t tick) {
    const trocar_probe *now = &h->probe;
    trocar_probe_wrench_t m = {.utime = wall_us(), .server = h->server, .tick = tick, .session = h->probe_session, .pose_seq = h->probe_seq,
                               .contacts = now->contacts};
    memcpy(m.position, now->base.position, sizeof m.position);
    memcpy(m.orientation, now->base.orientation, sizeof m.orientation);
    memcpy(m.force, now->force, sizeof m.force);
    memcpy(m.torque, now->torque, sizeof m.torque);
    spsc_ring_push(&h->exchange->probe_wrenches, &m);
    eventfd_signal(h->exchange->io_wake);
}

/* Moves the probe to its newest pose. Sends the probe's state if it has changed, and PROBE_LEAST_HZ times per second in any case. RT */
static void tick_probe(haptic *h, const loop_wake *wake) {
    if (!is_due(h, wake->tick, PROBE_HZ)) return;
    const probe_sample *newest = triple_buffer_read(&h->exchange->probe_poses, NULL);
    if (newest->session != 0 && (newest->session != h->probe_session || newest->seq != h->probe_seq)) {
        trocar_pose base = library_pose(newest->base);
        trocar_sim_set_probe(h->sim, &base, NULL);
        h->probe_session = newest->session;
        h->probe_seq = newest->seq;
    }
    trocar_probe now = trocar_view_probe(trocar_sim_view(h->sim));
    bool changed = memcmp(&now, &h->probe, sizeof now) != 0;
    h->probe = now;
    atomic_store_explicit(&h->exchange->probe_stopped, now.stopped != 0, memory_order_relaxed);
    if (now.placed && (changed || is_due(h, wake->tick, PROBE_LEAST_HZ))) send_probe(h, wake->tick);
}

bool haptic_tick(void *context, const loop_wake *wake) {
    haptic *h = context;
    bool wind_down = atomic_load_explicit(&h->wind_down, memory_order_relaxed), goes_on = false;
    const newest_poses *newest = triple_buffer_read(&h->exchange->poses, NULL);
    trocar_needle_wrench_t messages[TROCAR_MAX_NEEDLES];

    memset(h->stages, 0, sizeof h->stages);
    h->received = 0;
    for (int i = 0; i < h->needle_count; i++)
        if (newest->needles[i].held && newest->needles[i].received > h->received) h->received = newest->needles[i].received;
    tick_probe(h, wake);
    follow_commands(h);
    for (int i = 0; i < h->needle_count; i++) goes_on |= tick_needle(h, i, wake, &newest->needles[i], wind_down, &messages[i]);
    int64_t sent = monotonic_ns();
    show(h, wake, messages);
    h->stages[TROCAR_LOOP_TIMING_T_STAGE_OUTPUT] += monotonic_ns() - sent;
    return goes_on;
}

#include "closed_loop.h"

#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int64_t loop_clock_now;
static int64_t loop_clock(void) { return loop_clock_now; }

static int64_t to_ns(double seconds) { return llround(1e9 * seconds); }
double rig_time(const closed_loop *l) { return 1e-9 * (double)l->now; }

static void must(trocar_status status, const trocar_error *why) {
    if (status == TROCAR_OK) return;
    fprintf(stderr, "%s\n", why->text);
    abort();
}

closed_loop *rig_create(trocar_model *model, const trocar_device_limits *limits, const loop_properties *properties, const device_properties *device,
                         vec3 start) {
    trocar_error why;
    closed_loop *l = aligned_alloc(64, (sizeof *l + 63) / 64 * 64);
    if (l == NULL) abort();
    memset(l, 0, sizeof *l);
    l->model = model;
    l->properties = *properties;
    must(trocar_sim_create(model, &l->sim, &why), &why);
    must(exchange_create(&l->exchange, model, &why), &why);
    haptic_init(&l->haptic, l->sim, trocar_model_needles(model), limits, 1.0 / properties->period, 0, &l->exchange);
    trocar_sim_set_clock(l->sim, loop_clock);
    device_init(&l->device, device, start, 0.0);
    l->start = start;
    l->limiter = (limiter){.max_force = properties->max_force, .max_rate = properties->max_force_rate};
    l->felt = -1;
    l->now = 1;
    l->next_tick = to_ns(properties->period);
    l->next_message = to_ns(0.3 * properties->sampling);
    rig_watch(l);
    return l;
}

void rig_free(closed_loop *l) {
    exchange_free(&l->exchange);
    trocar_sim_free(l->sim);
    free(l);
}

void rig_watch(closed_loop *l) {
    l->flags = 0;
    l->greatest_force = 0.0;
    device_watch(&l->device);
}

/* Delivers the newest pose that has arrived to the server's next tick. */
static void deliver_pose(closed_loop *l) {
    for (int64_t i = l->seq; i > 0 && i > l->seq - LOOP_FLIGHT; i--) {
        const pose_sample *p = &l->poses[i % LOOP_FLIGHT];
        if (p->received > l->now) continue;
        newest_poses newest = {0};
        newest.needles[0] = *p;
        *(newest_poses *)triple_buffer_slot(&l->exchange.poses) = newest;
        triple_buffer_publish(&l->exchange.poses);
        return;
    }
}

/* Lets the worker answer at once. */
static void serve_worker(closed_loop *l) {
    trocar_error why;
    trocar_work done = {0};
    struct pollfd p = {.fd = trocar_sim_work_descriptor(l->sim), .events = POLLIN};
    if (poll(&p, 1, 0) == 1) must(trocar_sim_work(l->sim, &done, &why), &why);
}

static void run_server(closed_loop *l) {
    deliver_pose(l);
    loop_wake wake = {.tick = ++l->tick, .now = l->now, .elapsed = l->properties.period};
    loop_clock_now = l->now;
    haptic_tick(&l->haptic, &wake);
    trocar_needle_wrench_t *w = &l->wrenches[l->tick % LOOP_FLIGHT].wrench;
    if (!spsc_ring_pop(&l->exchange.wrenches, w)) abort();
    int64_t round_trip;
    while (spsc_ring_pop(&l->exchange.round_trips, &round_trip)) {}
    l->newest = *w;
    l->flags |= w->flags;
    l->wrenches[l->tick % LOOP_FLIGHT].arrival = l->now + to_ns(l->properties.network);
    serve_worker(l);
    l->next_tick += to_ns(l->properties.period);
}

/* Returns the newest wrench that has arrived, or NULL if none has yet. */
static const trocar_needle_wrench_t *newest_wrench(const closed_loop *l) {
    for (int64_t i = l->tick; i > 0 && i > l->tick - LOOP_FLIGHT; i--)
        if (l->wrenches[i % LOOP_FLIGHT].arrival <= l->now) return &l->wrenches[i % LOOP_FLIGHT].wrench;
    return NULL;
}

/* Turns the position in the service's reply into a pose, and sends the next message with the newest force. */
static void run_bridge(closed_loop *l) {
    const trocar_needle_wrench_t *w = newest_wrench(l);
    vec3 force = v3(0, 0, 0);
    if (w != NULL && w->session != 0) force = limiter_next(&l->limiter, v3_scale(l->properties.force_scale, v3(w->force[0], w->force[1], w->force[2])), v3(0, 0, 0), l->properties.sampling);
    vec3 position = device_read(&l->device, rig_time(l));
    if (l->passivity.period > 0.0) force = passivity_next(&l->passivity, position, force);
    l->greatest_force = fmax(l->greatest_force, v3_norm(force));
    device_apply(&l->device, rig_time(l), force);
    vec3 base = v3_axpy(l->properties.scale, v3_sub(position, l->start), l->start);
    l->seq++;
    l->poses[l->seq % LOOP_FLIGHT] = (pose_sample){.held = true, .engagement = 1, .session = 1, .seq = l->seq, .base = {base, {1, 0, 0, 0}},
                                                   .wrench_tick = l->properties.names_wrenches && w != NULL && w->session != 0 ? w->tick : 0,
                                                   .received = l->now + to_ns(l->properties.network)};
    l->next_message += to_ns(l->properties.sampling);
}

void rig_run(closed_loop *l, double seconds) {
    int64_t end = l->now + to_ns(seconds);
    for (;;) {
        int64_t next = l->next_tick < l->next_message ? l->next_tick : l->next_message;
        if (next > end) break;
        l->now = next;
        if (next == l->next_tick) run_server(l);
        else run_bridge(l);
    }
    l->now = end;
}

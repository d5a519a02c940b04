#include "intake/safety_limits.h"

#include <stdio.h>
#include <string.h>

#include "trocar_needle_wrench_t.h"

static bool finite3(vec3 a) { return isfinite(a.x) && isfinite(a.y) && isfinite(a.z); }

pose_verdict safety_check_pose(const pose *p) {
    quat q = p->orientation;
    double norm = sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
    bool finite = finite3(p->position) && isfinite(q.w) && finite3(v3(q.x, q.y, q.z));
    if (!finite) return POSE_NOT_FINITE;
    return fabs(norm - 1.0) > 1e-3 ? POSE_NOT_UNIT : POSE_ACCEPTED;
}

double safety_travel_time(const trocar_device_limits *limits, const pose *a, const pose *b) {
    double distance = v3_norm(v3_sub(b->position, a->position));
    double angle = v3_norm(q_log(q_multiply(b->orientation, q_conjugate(a->orientation))));
    return fmax(distance / limits->max_speed, angle / limits->max_turn_rate);
}

void safety_begin_transfer(safety_limits *g) {
    g->kept = 1.0;
    g->before_force = g->force;
    g->before_torque = g->torque;
}

/* Starts a new engagement. If the same hand goes on holding the needle, its last wrench fades out. A different hand feels nothing of that wrench. */
static safety_decision engage(safety_limits *g, const pose_sample *newest) {
    if (newest->session == g->session) safety_begin_transfer(g);
    else g->kept = 0.0;
    g->session = newest->session;
    g->engagement = newest->engagement;
    g->base = newest->base;
    g->received = newest->received;
    g->released = g->stale = g->overrun = false;
    g->late_ticks = 0;
    g->gain = 0.0;
    return SAFETY_ENGAGE;
}

safety_decision safety_pose(safety_limits *g, const trocar_device_limits *limits, const pose_sample *newest, int64_t now) {
    g->released = !newest->held;
    if (!newest->held) return g->engagement == 0 ? SAFETY_IDLE : SAFETY_HOLD;

    double silence = 1e-9 * (double)(now - newest->received);
    bool fresh = silence <= limits->hold_time;
    if (newest->engagement != g->engagement) return engage(g, newest);
    if (!fresh) {
        g->stale = true;
        return SAFETY_HOLD;
    }
    double elapsed = 1e-9 * (double)(newest->received - g->received);
    if (g->stale && safety_travel_time(limits, &g->base, &newest->base) > elapsed) return engage(g, newest);
    g->stale = false;
    g->base = newest->base;
    g->received = newest->received;
    return SAFETY_FOLLOW;
}

void safety_timing(safety_limits *g, bool late, double dt) {
    g->late_ticks = late ? g->late_ticks + 1 : 0;
    g->good_time = late ? 0.0 : g->good_time + dt;
    if (g->late_ticks >= SAFETY_OVERRUNS) g->overrun = true;
    else if (g->good_time >= 1.0) g->overrun = false;
}

/* Shortens `wanted` to `limit` if it is longer, then keeps it within `step` of `last`. */
static vec3 limited(vec3 wanted, vec3 last, double limit, double step, bool *saturated) {
    double length = v3_norm(wanted);
    if (length > limit) {
        wanted = v3_scale(limit / length, wanted);
        *saturated = true;
    }
    vec3 change = v3_sub(wanted, last);
    double size = v3_norm(change);
    if (size <= step) return wanted;
    *saturated = true;
    return v3_axpy(step / size, change, last);
}

/* Moves the gain one tick toward its target. Returns true while it is below 1. */
static bool ramp(safety_limits *g, const trocar_device_limits *limits, bool wind_down, double dt) {
    bool full = g->engagement != 0 && !(g->released || g->stale || g->overrun || wind_down);
    double before = g->gain, step = dt / limits->ramp_time;
    g->gain = full ? fmin(1.0, g->gain + step) : fmax(0.0, g->gain - step);
    return g->gain != before || (g->gain > 0.0 && g->gain < 1.0);
}

static vec3 between(vec3 a, vec3 b, double part_of_a) { return v3_axpy(part_of_a, v3_sub(a, b), b); }

/* Advances the bumpless transfer by one tick. Returns true while it is in progress. */
static bool transfer(safety_limits *g, const trocar_device_limits *limits, double dt, vec3 *force, vec3 *torque) {
    if (g->kept == 0.0) return false;
    g->kept = fmax(0.0, g->kept - dt / limits->ramp_time);
    *force = between(g->before_force, *force, g->kept);
    *torque = between(g->before_torque, *torque, g->kept);
    return true;
}

int safety_wrench(safety_limits *g, const trocar_device_limits *limits, bool wind_down, double dt, vec3 *force, vec3 *torque) {
    int flags = ramp(g, limits, wind_down, dt) ? TROCAR_NEEDLE_WRENCH_T_RAMPING : 0;
    bool saturated = false, finite = finite3(*force) && finite3(*torque);
    vec3 wanted_force = finite ? v3_scale(g->gain, *force) : v3(0, 0, 0);
    vec3 wanted_torque = finite ? v3_scale(g->gain, *torque) : v3(0, 0, 0);
    if (transfer(g, limits, dt, &wanted_force, &wanted_torque)) flags |= TROCAR_NEEDLE_WRENCH_T_RAMPING;

    *force = g->force = limited(wanted_force, g->force, limits->max_force, limits->max_force_rate * dt, &saturated);
    *torque = g->torque =
        limited(wanted_torque, g->torque, limits->max_torque, limits->max_torque_rate * dt, &saturated);

    if (saturated) flags |= TROCAR_NEEDLE_WRENCH_T_SATURATED;
    if (!finite) flags |= TROCAR_NEEDLE_WRENCH_T_UNSTABLE;
    if (g->stale) flags |= TROCAR_NEEDLE_WRENCH_T_STALE;
    if (g->overrun) flags |= TROCAR_NEEDLE_WRENCH_T_OVERRUN;
    return flags;
}

bool safety_at_rest(const safety_limits *g) { return g->gain == 0.0 && v3_norm(g->force) == 0.0 && v3_norm(g->torque) == 0.0; }

#include "pose_arbiter.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>

#include "trocar_command_t.h"
#include "trocar_needle_pose_t.h"

static const double OWNER_SILENCE = 2.0;  /* s after which another session may take over */
static const uint64_t LONGEST_GAP = 100000000; /* poses; a longer gap means a client that numbers poses differently */
static const double ARRIVAL_JITTER = 5e-3; /* s: poses may be delayed by this much and then arrive together */

void arbiter_init(pose_arbiter *in, const trocar_device_limits *limits) {
    *in = (pose_arbiter){.limits = *limits, .newest = {.seq = -1}, .begin_anew = true};
}

__attribute__((format(printf, 2, 3)))
static void say(pose_arbiter *in, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(in->record.message, sizeof in->record.message, format, arguments);
    va_end(arguments);
}

/* Fixed-size types only: a decode must consume exactly what was received. */
static bool decode_pose(const void *data, size_t size, trocar_needle_pose_t *m) {
    return size == (size_t)trocar_needle_pose_t_encoded_size(m)
        && trocar_needle_pose_t_decode(data, 0, (int)size, m) == (int)size;
}

static bool decode_command(const void *data, size_t size, trocar_command_t *m) {
    return size == (size_t)trocar_command_t_encoded_size(m)
        && trocar_command_t_decode(data, 0, (int)size, m) == (int)size;
}

static pose pose_of(const trocar_needle_pose_t *m) {
    const double *x = m->position, *q = m->orientation;
    return (pose){{x[0], x[1], x[2]}, {q[0], q[1], q[2], q[3]}};
}

static double since_last(const pose_arbiter *in, int64_t now) { return 1e-9 * (double)(now - in->record.received); }

static bool may_hold(const pose_arbiter *in, int64_t session, int64_t now) {
    return in->record.owner == 0 || in->record.owner == session || since_last(in, now) > OWNER_SILENCE;
}

/* The limits apply to the mean speed, not to that between two poses that the network has delivered together: unused time is
   credited, up to the jitter. Once the wrench has been ramped to zero for lack of poses, any position is accepted: the safety
   limits then decide whether the needle continues or engages again. */
static bool motion_possible(pose_arbiter *in, const pose *p, int64_t now) {
    double elapsed = since_last(in, now);
    if (elapsed > in->limits.hold_time + in->limits.ramp_time) {
        in->travel_credit = 0.0;
        return true;
    }
    double credit = fmin(in->travel_credit + elapsed, fmax(elapsed, ARRIVAL_JITTER));
    double needed = safety_travel_time(&in->limits, &in->newest.base, p);
    if (needed > credit) return false;
    in->travel_credit = credit - needed;
    return true;
}

/* Counts lost poses of the owner. */
static void count_lost(pose_arbiter *in, const trocar_needle_pose_t *m) {
    if (in->record.owner == 0 || m->session != in->record.owner || m->seq <= in->heard) return;
    uint64_t gap = (uint64_t)m->seq - (uint64_t)in->heard - 1;
    if (gap < LONGEST_GAP) in->record.poses_lost += (int64_t)gap;
    in->heard = m->seq;
}

static void accept(pose_arbiter *in, const trocar_needle_pose_t *m, pose p, int64_t now) {
    bool anew = in->begin_anew || m->session != in->record.owner;
    if (m->session != in->record.owner) in->heard = m->seq;
    in->newest = (pose_sample){.held = true, .engagement = in->newest.engagement + (anew ? 1 : 0), .session = m->session,
                               .seq = m->seq, .utime = m->utime, .wrench_tick = m->wrench_tick, .received = now, .base = p};
    if (anew) in->travel_credit = ARRIVAL_JITTER;
    in->begin_anew = false;
    in->record.owner = m->session;
    in->record.received = now;
}

static pose_verdict judge_numbers(pose_arbiter *in, const trocar_needle_pose_t *m, const pose *p) {
    pose_verdict verdict = safety_check_pose(p);
    if (verdict == POSE_NOT_FINITE) say(in, "pose %" PRId64 " of session %" PRId64 ": not finite", m->seq, m->session);
    if (verdict == POSE_NOT_UNIT)
        say(in, "pose %" PRId64 " of session %" PRId64 ": quaternion not of unit length", m->seq, m->session);
    return verdict;
}

static pose_verdict judge_sender(pose_arbiter *in, const trocar_needle_pose_t *m, int64_t now) {
    int64_t seq = m->seq, session = m->session;
    if (session == 0) {
        say(in, "session 0 refused: 0 means nobody; choose another number");
        return POSE_REFUSED;
    }
    if (!may_hold(in, session, now)) {
        say(in, "session %" PRId64 " refused: session %" PRId64 " holds the needle", session, in->record.owner);
        return POSE_REFUSED;
    }
    if (session == in->newest.session && seq <= in->newest.seq) {
        say(in, "pose %" PRId64 " of session %" PRId64 ": out of order, after %" PRId64, seq, session, in->newest.seq);
        return POSE_OLD;
    }
    return POSE_ACCEPTED;
}

static pose_verdict judge_motion(pose_arbiter *in, const trocar_needle_pose_t *m, const pose *p, int64_t now) {
    bool same_insertion = m->session == in->record.owner && !in->begin_anew;
    if (!same_insertion || motion_possible(in, p, now)) return POSE_ACCEPTED;
    say(in, "pose %" PRId64 " of session %" PRId64 ": faster than the scene's limits", m->seq, m->session);
    return POSE_JUMPED;
}

static pose_verdict judge(pose_arbiter *in, const void *data, size_t size, int64_t now) {
    trocar_needle_pose_t m = {0};
    if (!decode_pose(data, size, &m)) {
        say(in, "pose of %zu bytes: not a trocar.needle_pose_t of this version", size);
        return POSE_MALFORMED;
    }
    count_lost(in, &m);
    pose p = pose_of(&m);
    pose_verdict verdict = judge_numbers(in, &m, &p);
    if (verdict == POSE_ACCEPTED) verdict = judge_sender(in, &m, now);
    if (verdict != POSE_ACCEPTED) return verdict;
    p.orientation = q_unit(p.orientation);
    verdict = judge_motion(in, &m, &p, now);
    if (verdict == POSE_ACCEPTED) accept(in, &m, p, now);
    return verdict;
}

pose_verdict arbiter_pose(pose_arbiter *in, const void *data, size_t size, int64_t now) {
    pose_verdict verdict = judge(in, data, size, now);
    in->record.counts[verdict]++;
    return verdict;
}

static void release(pose_arbiter *in) {
    in->newest.held = false;
    in->begin_anew = true;
    in->record.owner = 0;
}

bool arbiter_command(pose_arbiter *in, const void *data, size_t size) {
    trocar_command_t m = {0};
    if (!decode_command(data, size, &m)) {
        in->record.commands_refused++;
        say(in, "command of %zu bytes refused: not a trocar.command_t of this version", size);
        return false;
    }
    if (m.command == TROCAR_COMMAND_T_SHUTDOWN) return true;
    bool allowed = in->record.owner == 0 || in->record.owner == m.session;
    if (allowed && m.command == TROCAR_COMMAND_T_RESET) in->begin_anew = true;
    else if (allowed && m.command == TROCAR_COMMAND_T_RELEASE) release(in);
    else {
        in->record.commands_refused++;
        say(in, "command %d of session %" PRId64 " refused: %s", m.command, m.session,
            allowed ? "unknown" : "another session holds the needle");
    }
    return false;
}

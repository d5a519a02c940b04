#include "intake/pose_arbiter.h"

#include <inttypes.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "common/messages.h"
#include "trocar_needle_pose_t.h"

static const double OWNER_SILENCE = 2.0;  /* s after which another session may take over if the owner is silent */
static const double ARRIVAL_JITTER = 5e-3; /* s, longest time by which the network may delay poses, so that they arrive together */

void arbiter_init(pose_arbiter *in, int needle_count, const trocar_device_limits *limits) {
    *in = (pose_arbiter){.limits = *limits, .needle_count = needle_count};
    for (int i = 0; i < TROCAR_MAX_NEEDLES; i++) in->needles[i] = (arbiter_needle){.newest = {.seq = -1}, .begin_anew = true};
}

__attribute__((format(printf, 2, 3)))
static void say(pose_arbiter *in, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(in->record.message, sizeof in->record.message, format, arguments);
    va_end(arguments);
}

/* Decodes a pose. Returns true if decoding used exactly the bytes received, which is a valid check only for types of fixed size. */
static bool decode_pose(const void *data, size_t size, trocar_needle_pose_t *m) {
    return size == (size_t)trocar_needle_pose_t_encoded_size(m)
        && trocar_needle_pose_t_decode(data, 0, (int)size, m) == (int)size;
}

static bool decode_command(const void *data, size_t size, trocar_command_t *m) {
    return size == (size_t)trocar_command_t_encoded_size(m)
        && trocar_command_t_decode(data, 0, (int)size, m) == (int)size;
}

static bool has_needle(const pose_arbiter *in, int needle) { return needle >= 0 && needle < in->needle_count; }

static int64_t owner_of(const pose_arbiter *in, int needle) { return in->record.needles[needle].owner; }

static double since_last(const pose_arbiter *in, int needle, int64_t now) { return 1e-9 * (double)(now - in->record.needles[needle].received); }

static bool is_silent(const pose_arbiter *in, int needle, int64_t now) { return since_last(in, needle, now) > OWNER_SILENCE; }

static bool may_hold(const pose_arbiter *in, int needle, int64_t session, int64_t now) {
    int64_t owner = owner_of(in, needle);
    return owner == 0 || owner == session || is_silent(in, needle, now);
}

/* Returns the index of another needle owned by the session, or -1. */
static int other_needle_of(const pose_arbiter *in, int needle, int64_t session) {
    for (int i = 0; i < in->needle_count; i++)
        if (i != needle && owner_of(in, i) == session) return i;
    return -1;
}

/* Limits the poses' mean speed. Poses that the network has delivered together may seem faster, so unused travel time is credited, up to ARRIVAL_JITTER. After a
   silence long enough for the wrench to have been ramped to zero, any position is accepted; the safety limits then decide whether to continue the insertion or
   to begin a new engagement. */
static bool motion_possible(pose_arbiter *in, int needle, const pose *p, int64_t now) {
    arbiter_needle *n = &in->needles[needle];
    double elapsed = since_last(in, needle, now);
    if (elapsed > in->limits.hold_time + in->limits.ramp_time) {
        n->travel_credit = 0.0;
        return true;
    }
    double credit = fmin(n->travel_credit + elapsed, fmax(elapsed, ARRIVAL_JITTER));
    double needed = safety_travel_time(&in->limits, &n->newest.base, p);
    if (needed > credit) return false;
    n->travel_credit = credit - needed;
    return true;
}

/* Counts how many of the owner's poses were lost. */
static void count_lost(pose_arbiter *in, const trocar_needle_pose_t *m) {
    arbiter_needle *n = &in->needles[m->needle];
    int64_t owner = owner_of(in, m->needle), gap = sequence_gap(&n->heard, m->seq);
    if (owner == 0 || m->session != owner || gap < 0) return;
    in->record.needles[m->needle].poses_lost += gap;
    sequence_begin(&n->heard, m->seq);
}

static void release(pose_arbiter *in, int needle) {
    in->needles[needle].newest.held = false;
    in->needles[needle].begin_anew = true;
    in->record.needles[needle].owner = 0;
}

static void accept(pose_arbiter *in, const trocar_needle_pose_t *m, pose p, int64_t now) {
    arbiter_needle *n = &in->needles[m->needle];
    needle_record *record = &in->record.needles[m->needle];
    int left = other_needle_of(in, m->needle, m->session);
    if (left >= 0) release(in, left);
    bool anew = n->begin_anew || m->session != record->owner;
    if (m->session != record->owner || sequence_gap(&n->order, m->seq) < 0) sequence_begin(&n->heard, m->seq);
    sequence_begin(&n->order, m->seq);
    n->newest = (pose_sample){.held = true, .engagement = n->newest.engagement + (anew ? 1 : 0), .session = m->session,
                              .seq = m->seq, .utime = m->utime, .wrench_tick = m->wrench_tick, .received = now, .base = p};
    if (anew) n->travel_credit = ARRIVAL_JITTER;
    n->begin_anew = false;
    record->owner = m->session;
    record->received = now;
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
    const pose_sample *newest = &in->needles[m->needle].newest;
    sequence *order = &in->needles[m->needle].order;
    if (session == 0) {
        say(in, "session 0 refused: 0 means nobody; choose another number");
        return POSE_REFUSED;
    }
    if (!may_hold(in, m->needle, session, now)) {
        say(in, "session %" PRId64 " refused for needle %d: session %" PRId64 " holds the needle", session, m->needle, owner_of(in, m->needle));
        return POSE_REFUSED;
    }
    if (in->needles[m->needle].rests) {
        say(in, "session %" PRId64 " refused for needle %d: it is resting; take it first", session, m->needle);
        return POSE_REFUSED;
    }
    int other = other_needle_of(in, m->needle, session);
    if (other >= 0 && !is_silent(in, other, now)) {
        say(in, "session %" PRId64 " refused for needle %d: it holds needle %d; release that first, or use a session for each", session,
            m->needle, other);
        return POSE_REFUSED;
    }
    if (session == newest->session && !sequence_accepts(order, seq)) {
        say(in, "pose %" PRId64 " of session %" PRId64 ": out of order, after %" PRId64, seq, session, order->newest);
        return POSE_OLD;
    }
    return POSE_ACCEPTED;
}

static pose_verdict judge_motion(pose_arbiter *in, const trocar_needle_pose_t *m, const pose *p, int64_t now) {
    bool same_insertion = m->session == owner_of(in, m->needle) && !in->needles[m->needle].begin_anew;
    if (!same_insertion || motion_possible(in, m->needle, p, now)) return POSE_ACCEPTED;
    say(in, "pose %" PRId64 " of session %" PRId64 ": faster than the scene's limits", m->seq, m->session);
    return POSE_JUMPED;
}

static pose_verdict judge(pose_arbiter *in, const trocar_needle_pose_t *m, int64_t now) {
    count_lost(in, m);
    pose p = load_pose(m->position, m->orientation);
    pose_verdict verdict = judge_numbers(in, m, &p);
    if (verdict == POSE_ACCEPTED) verdict = judge_sender(in, m, now);
    if (verdict != POSE_ACCEPTED) return verdict;
    p.orientation = q_unit(p.orientation);
    verdict = judge_motion(in, m, &p, now);
    if (verdict == POSE_ACCEPTED) accept(in, m, p, now);
    return verdict;
}

/* Explains why a message has the wrong size. If it lacks exactly the last field, `needle`, the client is older than this server. */
static const char *advice(size_t size, int size_now) {
    bool without_needle = size + sizeof(int32_t) == (size_t)size_now;
    return without_needle ? "; it has no `needle`: build its sender with this release's trocar.lcm" : "";
}

static void say_no_needle(pose_arbiter *in, const char *what, int64_t session, int needle) {
    say(in, "%s of session %" PRId64 " refused for needle %d: the scene's `needles` is %d, counted from 0", what, session, needle,
        in->needle_count);
}

pose_verdict arbiter_pose(pose_arbiter *in, const void *data, size_t size, int64_t now) {
    trocar_needle_pose_t m = {0};
    if (!decode_pose(data, size, &m)) {
        in->record.poses_malformed++;
        say(in, "pose of %zu bytes refused: not a trocar.needle_pose_t of this version%s", size,
            advice(size, trocar_needle_pose_t_encoded_size(&m)));
        if (in->record.poses_malformed == 1) memcpy(in->record.malformed, in->record.message, sizeof in->record.malformed);
        return POSE_MALFORMED;
    }
    if (!has_needle(in, m.needle)) {
        in->record.poses_no_needle++;
        say_no_needle(in, "pose", m.session, m.needle);
        return POSE_NO_NEEDLE;
    }
    pose_verdict verdict = judge(in, &m, now);
    in->record.needles[m.needle].counts[verdict]++;
    return verdict;
}

/* Refuses the command and writes the reason to the record's message. */
static command_verdict refuse(pose_arbiter *in, needle_command *command) {
    in->record.commands_refused++;
    command->refused = true;
    snprintf(command->why, sizeof command->why, "%s", in->record.message);
    return COMMAND_SETTLED;
}

/* Carries out a command that the session may give, or passes it on to the haptic thread. Refuses any other command. */
static command_verdict carry_out(pose_arbiter *in, needle_command *command) {
    const trocar_command_t *m = &command->asked;
    arbiter_needle *n = &in->needles[m->needle];
    command->engagement = n->newest.engagement;
    command->anew = n->begin_anew;
    switch (m->command) {
    case TROCAR_COMMAND_T_RESET:
    case TROCAR_COMMAND_T_CLEAR: /* a resting needle is engaged only after the haptic thread has carried this out */
        if (!n->rests) n->begin_anew = true;
        return COMMAND_PASS_ON;
    case TROCAR_COMMAND_T_RELEASE:
        if (!n->rests) release(in, m->needle);
        return COMMAND_SETTLED;
    case TROCAR_COMMAND_T_LEAVE:
        n->rests = true;
        return COMMAND_PASS_ON;
    case TROCAR_COMMAND_T_TAKE:
    case TROCAR_COMMAND_T_DROP_SEED:
    case TROCAR_COMMAND_T_UNDO: return COMMAND_PASS_ON;
    default:
        say(in, "command %d of session %" PRId64 " refused: unknown", m->command, m->session);
        return refuse(in, command);
    }
}

/* Accepts a shutdown if the sender is on this machine or owns a needle. */
static command_verdict judge_shutdown(pose_arbiter *in, bool distant, needle_command *command) {
    int64_t session = command->asked.session;
    if (!distant || (session != 0 && other_needle_of(in, -1, session) >= 0)) return COMMAND_SHUTDOWN;
    say(in, "shutdown by session %" PRId64 " refused: it is on another machine and holds no needle", session);
    return refuse(in, command);
}

command_verdict arbiter_command(pose_arbiter *in, const void *data, size_t size, bool distant, int64_t now, needle_command *command) {
    trocar_command_t m = {0};
    if (!decode_command(data, size, &m)) {
        in->record.commands_refused++;
        say(in, "command of %zu bytes refused: not a trocar.command_t of this version%s", size,
            size < (size_t)trocar_command_t_encoded_size(&m) ? "; build its sender with this release's trocar.lcm" : "");
        return COMMAND_MALFORMED;
    }
    *command = (needle_command){.asked = m};
    if (m.command == TROCAR_COMMAND_T_SHUTDOWN) return judge_shutdown(in, distant, command);
    if (!has_needle(in, m.needle)) {
        say_no_needle(in, "command", m.session, m.needle);
        return refuse(in, command);
    }
    bool rests = in->needles[m.needle].rests;
    if (!may_hold(in, m.needle, m.session, now))
        say(in, "command %d of session %" PRId64 " refused for needle %d: another session holds the needle", m.command, m.session, m.needle);
    else if (m.command == TROCAR_COMMAND_T_LEAVE && rests)
        say(in, "needle %d of session %" PRId64 " cannot be left: it is resting already", m.needle, m.session);
    else if (m.command == TROCAR_COMMAND_T_TAKE && !rests)
        say(in, "needle %d cannot be taken by session %" PRId64 ": it is not resting", m.needle, m.session);
    else return carry_out(in, command);
    return refuse(in, command);
}

void arbiter_refuse(pose_arbiter *in, const char *reason) {
    in->record.commands_refused++;
    say(in, "%s", reason);
}

/* After LEAVE, the needle has no owner. After TAKE, or after RESET or CLEAR of a resting needle, the next pose begins a new engagement. RESET or CLEAR of a
   held needle set `begin_anew` as soon as it arrived, and a pose may have cleared that since. So if the command was refused, `begin_anew` is restored only if no
   new engagement has begun. */
void arbiter_settle(pose_arbiter *in, const needle_command *done) {
    const trocar_command_t *m = &done->asked;
    arbiter_needle *n = &in->needles[m->needle];
    if (done->refused) {
        in->record.commands_refused++;
        say(in, "command %d of session %" PRId64 " refused for needle %d: %s", m->command, m->session, m->needle, done->why);
    }
    switch (m->command) {
    case TROCAR_COMMAND_T_LEAVE:
        if (done->refused) n->rests = false;
        else release(in, m->needle);
        return;
    case TROCAR_COMMAND_T_TAKE:
    case TROCAR_COMMAND_T_RESET:
    case TROCAR_COMMAND_T_CLEAR:
        if (done->refused && !n->rests && n->newest.engagement == done->engagement) n->begin_anew = done->anew;
        if (done->refused || !n->rests) return;
        n->rests = false;
        n->begin_anew = true;
        return;
    default: return;
    }
}

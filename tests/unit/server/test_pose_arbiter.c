/* Tests which poses the arbiter accepts and refuses, depending on their bytes and their session. */
#include <string.h>

#include "intake/pose_arbiter.h"
#include "scene/device.h"
#include "trocar_command_t.h"
#include "trocar_needle_pose_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const int64_t MS = 1000000;

typedef struct { unsigned char data[256]; size_t size; } packet;

static packet pack_pose(const trocar_needle_pose_t *m) {
    packet p;
    p.size = (size_t)trocar_needle_pose_t_encode(p.data, 0, sizeof p.data, m);
    return p;
}

static trocar_needle_pose_t message(int64_t session, int64_t seq, double x) {
    return (trocar_needle_pose_t){.session = session, .seq = seq, .position = {x, 0, 0}, .orientation = {1, 0, 0, 0}};
}

static pose_verdict take(pose_arbiter *in, const trocar_needle_pose_t *m, int64_t now) {
    packet p = pack_pose(m);
    return arbiter_pose(in, p.data, p.size, now);
}

static pose_verdict take_pose(pose_arbiter *in, int64_t session, int64_t seq, double x, int64_t now) {
    trocar_needle_pose_t m = message(session, seq, x);
    return take(in, &m, now);
}

static command_verdict command_at(pose_arbiter *in, int64_t session, int what, int64_t now) {
    trocar_command_t m = {.session = session, .command = what};
    unsigned char data[128];
    int size = trocar_command_t_encode(data, 0, sizeof data, &m);
    needle_command decoded;
    return arbiter_command(in, data, (size_t)size, false, now, &decoded);
}

static command_verdict command(pose_arbiter *in, int64_t session, int what) { return command_at(in, session, what, 0); }

static pose_arbiter fresh(void) {
    pose_arbiter in;
    device_limits limits = device_defaults(); /* 2 m/s */
    arbiter_init(&in, 1, &limits);
    return in;
}

static void valid_pose_arrives_unchanged(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    trocar_needle_pose_t m = {.utime = 77, .session = -5, .seq = 3, .position = {1, 2, 3},
                              .orientation = {0.6, 0, 0.8005, 0}};
    assert_int_equal(take(&in, &m, 9 * MS), POSE_ACCEPTED);
    assert_true(in.needles[0].newest.held && in.needles[0].newest.utime == 77 && in.needles[0].newest.session == -5 && in.needles[0].newest.seq == 3);
    assert_int_equal(in.needles[0].newest.received, 9 * MS);
    assert_true(in.needles[0].newest.base.position.y == 2);
    quat q = in.needles[0].newest.base.orientation;
    assert_true(fabs(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z - 1) < 1e-14); /* normalised */
    assert_int_equal(in.record.needles[0].owner, -5);
    assert_int_equal(in.record.needles[0].counts[POSE_ACCEPTED], 1);
}

/* Sends messages of every wrong length, with each bit of the fingerprint flipped, and with random bytes. */
static void invalid_pose_messages_are_counted(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    trocar_needle_pose_t m = message(1, 1, 0);
    packet p = pack_pose(&m);
    int64_t bad = 0;
    for (size_t size = 0; size <= sizeof p.data; size++)
        if (size != p.size) {
            assert_int_equal(arbiter_pose(&in, p.data, size, 0), POSE_MALFORMED);
            bad++;
        }
    for (int bit = 0; bit < 64; bit++) {
        packet q = p;
        q.data[bit / 8] ^= (unsigned char)(1u << (bit % 8));
        assert_int_equal(arbiter_pose(&in, q.data, q.size, 0), POSE_MALFORMED);
        bad++;
    }
    assert_int_equal(in.record.poses_malformed, bad);
    assert_int_equal(in.record.needles[0].owner, 0);
    assert_false(in.needles[0].newest.held);
    assert_non_null(strstr(in.record.message, "needle_pose_t"));
    trocar_needle_pose_t nobody = message(0, 1, 0); /* the first malformed pose is reported, even if another has been refused since */
    p = pack_pose(&nobody);
    assert_int_equal(arbiter_pose(&in, p.data, p.size, 0), POSE_REFUSED);
    assert_non_null(strstr(in.record.message, "session 0"));
    assert_non_null(strstr(in.record.malformed, "pose of 0 bytes"));
}

/* Sends random payloads after a valid fingerprint. Only finite poses with unit quaternions may be accepted. */
static void random_payloads_never_pass_unchecked(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    uint32_t random = 1;
    for (int i = 0; i < 200000; i++) {
        trocar_needle_pose_t m = message(1, i, 0);
        packet p = pack_pose(&m);
        for (size_t k = 8; k < p.size - 4; k++) { /* all fields except the last, `needle` */
            random = 1664525u * random + 1013904223u;
            p.data[k] = (unsigned char)(random >> 24);
        }
        if (arbiter_pose(&in, p.data, p.size, i * MS) == POSE_ACCEPTED)
            assert_int_equal(safety_check_pose(&in.needles[0].newest.base), POSE_ACCEPTED);
    }
    assert_true(in.record.needles[0].counts[POSE_NOT_UNIT] > 100000);
    assert_true(in.record.needles[0].counts[POSE_NOT_FINITE] > 0);
}

static void nan_and_bad_quaternions_leave_the_last_pose(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    take_pose(&in, 1, 1, 0.25, 0);
    trocar_needle_pose_t m = message(1, 2, NAN);
    assert_int_equal(take(&in, &m, MS), POSE_NOT_FINITE);
    m = message(1, 2, 0.25);
    m.orientation[0] = 0.99;
    assert_int_equal(take(&in, &m, MS), POSE_NOT_UNIT);
    assert_int_equal(in.needles[0].newest.seq, 1);
    assert_int_equal(in.needles[0].newest.received, 0);
    assert_int_equal(take_pose(&in, 1, 2, 0.25, MS), POSE_ACCEPTED); /* the refused pose did not use up its sequence number */
}

static void sequence_numbers_must_increase(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    assert_int_equal(take_pose(&in, 1, 10, 0, 0), POSE_ACCEPTED);
    assert_int_equal(take_pose(&in, 1, 10, 0, MS), POSE_OLD);
    assert_int_equal(take_pose(&in, 1, 9, 0, MS), POSE_OLD);
    assert_int_equal(take_pose(&in, 1, 15, 0, MS), POSE_ACCEPTED); /* gaps in the sequence do not matter */
}

/* A single packet with the owner's session and an arbitrary number costs the owner a few poses at most. A stream of packets with old numbers, sent between
   the owner's poses, costs none. */
static void no_sequence_number_locks_the_owner_out(void **unused) {
    (void)unused;
    static const int64_t forged[] = {INT64_MAX, INT64_MIN, 0, 5000, 99, 50000000, INT64_MAX - 1};
    for (size_t k = 0; k < sizeof forged / sizeof *forged; k++) {
        pose_arbiter in = fresh();
        int64_t now = 0, seq = 100;
        int refused = 0;
        for (; seq < 200; seq++) assert_int_equal(take_pose(&in, 1, seq, 0, now += MS), POSE_ACCEPTED);
        take_pose(&in, 1, forged[k], 0, now);
        for (; seq < 300; seq++) refused += take_pose(&in, 1, seq, 0, now += MS) != POSE_ACCEPTED;
        assert_true(refused < SEQUENCE_RUN);
        for (int64_t old = 0; old < 100; old++, seq++) {
            assert_int_equal(take_pose(&in, 1, old, 1e-3, now), POSE_OLD);
            assert_int_equal(take_pose(&in, 1, seq, 0, now += MS), POSE_ACCEPTED);
        }
        assert_true(in.needles[0].newest.base.position.x == 0 && in.record.needles[0].owner == 1);
    }
}

/* The arbiter keeps following a client that restarts its numbering within a session, or that switches to numbering by time in nanoseconds. */
static void a_new_count_is_followed(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    int64_t now = 0;
    for (int64_t seq = 100000; seq < 100100; seq++) assert_int_equal(take_pose(&in, 1, seq, 0, now += MS), POSE_ACCEPTED);
    for (int64_t seq = 1; seq < 100; seq++)
        assert_int_equal(take_pose(&in, 1, seq, 0, now += MS), seq < SEQUENCE_RUN ? POSE_OLD : POSE_ACCEPTED);
    assert_int_equal(take_pose(&in, 1, 99, 0, now += MS), POSE_OLD);
    for (int64_t k = 0; k < 100; k++)
        assert_int_equal(take_pose(&in, 1, INT64_C(1000000000000) + k * MS, 0, now += MS), k < SEQUENCE_RUN - 1 ? POSE_OLD : POSE_ACCEPTED);
    assert_int_equal(take_pose(&in, 1, INT64_C(1000000000000) + 150 * MS, 0, now += MS), POSE_ACCEPTED);
}

static void second_session_is_refused_until_the_first_is_silent(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    take_pose(&in, 1, 1, 0, 0);
    uint64_t engagement = in.needles[0].newest.engagement;
    assert_int_equal(take_pose(&in, 2, 1, 0, 1999 * MS), POSE_REFUSED);
    assert_non_null(strstr(in.record.message, "session 2"));
    assert_int_equal(in.record.needles[0].owner, 1);
    assert_int_equal(take_pose(&in, 2, 2, 9, 2001 * MS), POSE_ACCEPTED); /* accepted at any position, because it starts a new insertion */
    assert_int_equal(in.record.needles[0].owner, 2);
    assert_true(in.needles[0].newest.engagement > engagement);
    assert_int_equal(take_pose(&in, 1, 2, 0, 2002 * MS), POSE_REFUSED);
    assert_int_equal(take_pose(&in, 0, 1, 0, 9000 * MS), POSE_REFUSED); /* session 0 is reserved: it means that nobody owns the needle */
}

static void a_release_frees_the_needle_at_once(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    take_pose(&in, 1, 5, 0, 0);
    command(&in, 2, TROCAR_COMMAND_T_RELEASE);
    assert_true(in.needles[0].newest.held); /* only the owner may release the needle */
    assert_int_equal(in.record.commands_refused, 1);
    command(&in, 1, TROCAR_COMMAND_T_RELEASE);
    assert_false(in.needles[0].newest.held);
    assert_int_equal(in.record.needles[0].owner, 0);
    assert_int_equal(take_pose(&in, 1, 5, 0, MS), POSE_OLD); /* a late pose does not take the needle back */
    assert_int_equal(take_pose(&in, 2, 1, 1, MS), POSE_ACCEPTED);
}

static void shut_down_from_afar(pose_arbiter *in, int64_t session, command_verdict verdict) {
    trocar_command_t m = {.session = session, .command = TROCAR_COMMAND_T_SHUTDOWN};
    unsigned char data[128];
    int size = trocar_command_t_encode(data, 0, sizeof data, &m);
    needle_command decoded;
    assert_int_equal(arbiter_command(in, data, (size_t)size, true, 0, &decoded), verdict);
    assert_int_equal(decoded.refused, verdict != COMMAND_SHUTDOWN);
}

static void another_machine_shuts_down_only_with_a_needle(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    /* session 0 means nobody, so it does not own a free needle either */
    for (int64_t session = 0; session < 3; session++) shut_down_from_afar(&in, session, COMMAND_SETTLED);
    assert_int_equal(in.record.commands_refused, 3);
    assert_non_null(strstr(in.record.message, "another machine"));
    take_pose(&in, 2, 1, 0, 0);
    shut_down_from_afar(&in, 1, COMMAND_SETTLED);
    shut_down_from_afar(&in, 2, COMMAND_SHUTDOWN);
    command(&in, 2, TROCAR_COMMAND_T_RELEASE);
    shut_down_from_afar(&in, 2, COMMAND_SETTLED);
    assert_int_equal(command(&in, 1, TROCAR_COMMAND_T_SHUTDOWN), COMMAND_SHUTDOWN); /* from here */
}

static void reset_engages_again_with_the_next_pose(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    take_pose(&in, 1, 1, 0, 0);
    uint64_t engagement = in.needles[0].newest.engagement;
    assert_int_equal(command(&in, 1, TROCAR_COMMAND_T_RESET), COMMAND_PASS_ON);
    assert_int_equal(in.needles[0].newest.engagement, engagement);
    assert_int_equal(take_pose(&in, 1, 2, 3.0, MS), POSE_ACCEPTED); /* far away, but a new insertion has no jump limit */
    assert_int_equal(in.needles[0].newest.engagement, engagement + 1);
    assert_int_equal(take_pose(&in, 1, 3, 3.0, 2 * MS), POSE_ACCEPTED);
    assert_int_equal(in.needles[0].newest.engagement, engagement + 1);
    assert_int_equal(command(&in, 1, TROCAR_COMMAND_T_CLEAR), COMMAND_PASS_ON);
    assert_int_equal(take_pose(&in, 1, 4, 0, 3 * MS), POSE_ACCEPTED);
    assert_int_equal(in.needles[0].newest.engagement, engagement + 2);
}

static void only_a_valid_shutdown_shuts_down(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    unsigned char noise[64] = {0};
    needle_command decoded;
    assert_int_equal(arbiter_command(&in, noise, sizeof noise, false, 0, &decoded), COMMAND_MALFORMED);
    assert_int_equal(command(&in, 1, 99), COMMAND_SETTLED);
    assert_int_equal(in.record.commands_refused, 2);
    assert_int_equal(command(&in, 1, TROCAR_COMMAND_T_SHUTDOWN), COMMAND_SHUTDOWN);
}

static void jumps_are_rejected_while_the_needle_is_followed(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    take_pose(&in, 1, 1, 0, 0);
    for (int i = 1; i <= 100; i++) /* a constant 1.9 m/s */
        assert_int_equal(take_pose(&in, 1, 1 + i, 0.0019 * i, i * MS), POSE_ACCEPTED);
    assert_int_equal(take_pose(&in, 1, 200, 0.19 + 0.05, 101 * MS), POSE_JUMPED);
    assert_int_equal(take_pose(&in, 1, 201, 0.191, 102 * MS), POSE_ACCEPTED);
}

/* Lost poses are counted when a later pose of the owner arrives, even one that is refused. They are never counted twice, and gaps between different clients'
   poses are not counted. */
static void lost_poses_are_counted(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    take_pose(&in, 1, 1000, 0, 0);
    assert_int_equal(in.record.needles[0].poses_lost, 0);
    take_pose(&in, 1, 1001, 0, 1 * MS);
    take_pose(&in, 1, 1005, 0, 5 * MS);
    assert_int_equal(in.record.needles[0].poses_lost, 3);
    assert_int_equal(take_pose(&in, 1, 1006, 9, 6 * MS), POSE_JUMPED);
    take_pose(&in, 1, 1007, 0, 7 * MS);
    assert_int_equal(take_pose(&in, 1, 1003, 0, 8 * MS), POSE_OLD);
    assert_int_equal(take_pose(&in, 2, 5000, 0, 9 * MS), POSE_REFUSED);
    assert_int_equal(in.record.needles[0].poses_lost, 3);
    command(&in, 1, TROCAR_COMMAND_T_RELEASE);
    take_pose(&in, 2, 5001, 0, 10 * MS);
    take_pose(&in, 2, INT64_MAX, 0, 11 * MS);
    assert_int_equal(in.record.needles[0].poses_lost, 3);
}

/* The network may delay poses and deliver several at once, so only the mean speed is limited. */
static void bunched_poses_are_accepted_but_fast_motion_is_a_jump(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    int64_t seq = 1;
    take_pose(&in, 1, seq, 0, 0);
    for (int i = 1; i <= 100; i++) { /* 1.5 m/s, with poses delivered in batches of four */
        int64_t arrival = ((i + 3) / 4) * 4 * MS;
        assert_int_equal(take_pose(&in, 1, ++seq, 0.0015 * i, arrival), POSE_ACCEPTED);
    }
    int rejected = 0;
    for (int i = 1; i <= 20; i++) /* 4 m/s, which soon exceeds the allowance for jitter */
        rejected += take_pose(&in, 1, ++seq, 0.15 + 0.004 * i, (100 + i) * MS) == POSE_JUMPED;
    assert_true(rejected > 5);
}

/* After the hold time and the ramp, the wrench is zero, and a pose at any position is accepted again. */
static void jump_is_accepted_after_the_wrench_has_ramped_out(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    take_pose(&in, 1, 1, 0, 0);
    assert_int_equal(take_pose(&in, 1, 2, 5.0, 100 * MS), POSE_JUMPED);
    assert_int_equal(take_pose(&in, 1, 3, 5.0, 111 * MS), POSE_ACCEPTED);
}

/* ---- two needles ---- */

static pose_arbiter fresh_pair(void) {
    pose_arbiter in;
    device_limits limits = device_defaults();
    arbiter_init(&in, 2, &limits);
    return in;
}

static pose_verdict take_at(pose_arbiter *in, int needle, int64_t session, int64_t seq, int64_t now) {
    trocar_needle_pose_t m = message(session, seq, 0);
    m.needle = needle;
    return take(in, &m, now);
}

static void command_to(pose_arbiter *in, int needle, int64_t session, int what) {
    trocar_command_t m = {.session = session, .command = what, .needle = needle};
    unsigned char data[128];
    int size = trocar_command_t_encode(data, 0, sizeof data, &m);
    needle_command decoded;
    arbiter_command(in, data, (size_t)size, false, 0, &decoded);
}

/* Once the owner has been silent for two seconds, commands from another session are accepted. Otherwise nobody could take over a needle in the tissue after
   its owner has crashed. */
static void commands_are_accepted_once_the_owner_is_silent(void **unused) {
    (void)unused;
    pose_arbiter in = fresh();
    assert_int_equal(take_pose(&in, 7, 1, 0, 0), POSE_ACCEPTED);
    assert_int_equal(command_at(&in, 8, TROCAR_COMMAND_T_LEAVE, 1900000000), COMMAND_SETTLED);
    assert_int_equal(in.record.commands_refused, 1);
    assert_int_equal(command_at(&in, 8, TROCAR_COMMAND_T_LEAVE, 2100000000), COMMAND_PASS_ON);
    assert_int_equal(in.record.commands_refused, 1);
}

static void each_needle_has_its_own_session(void **unused) {
    (void)unused;
    pose_arbiter in = fresh_pair();
    assert_int_equal(take_at(&in, 0, 7, 1, 0), POSE_ACCEPTED);
    assert_int_equal(take_at(&in, 1, 8, 500, 0), POSE_ACCEPTED);
    assert_int_equal(take_at(&in, 0, 9, 1, MS), POSE_REFUSED);
    assert_string_equal(in.record.message, "session 9 refused for needle 0: session 7 holds the needle");
    assert_int_equal(take_at(&in, 0, 7, 3, 2 * MS), POSE_ACCEPTED);
    assert_int_equal(take_at(&in, 1, 8, 501, 2 * MS), POSE_ACCEPTED);
    const needle_record *records = in.record.needles;
    assert_true(records[0].owner == 7 && records[1].owner == 8);
    assert_true(records[0].poses_lost == 1 && records[1].poses_lost == 0);
    assert_true(records[0].counts[POSE_REFUSED] == 1 && records[1].counts[POSE_REFUSED] == 0);

    uint64_t other = in.needles[1].newest.engagement, own = in.needles[0].newest.engagement;
    command_to(&in, 1, 7, TROCAR_COMMAND_T_RESET); /* not its needle */
    assert_int_equal(in.record.commands_refused, 1);
    assert_non_null(strstr(in.record.message, "needle 1: another session holds the needle"));
    command_to(&in, 0, 7, TROCAR_COMMAND_T_RESET);
    take_at(&in, 0, 7, 4, 3 * MS);
    take_at(&in, 1, 8, 502, 3 * MS);
    assert_true(in.needles[0].newest.engagement == own + 1 && in.needles[1].newest.engagement == other);
    command_to(&in, 1, 8, TROCAR_COMMAND_T_RELEASE);
    assert_true(in.needles[0].newest.held && !in.needles[1].newest.held);
}

static void a_session_holds_one_needle(void **unused) {
    (void)unused;
    pose_arbiter in = fresh_pair();
    take_at(&in, 0, 7, 1, 0);
    assert_int_equal(take_at(&in, 1, 7, 2, 1999 * MS), POSE_REFUSED);
    assert_string_equal(in.record.message, "session 7 refused for needle 1: it holds needle 0; release that first, or use a session for each");
    assert_true(in.record.needles[0].owner == 7 && in.record.needles[1].owner == 0);
    assert_int_equal(take_at(&in, 1, 7, 3, 2001 * MS), POSE_ACCEPTED); /* needle 0 has had no pose for two seconds */
    assert_true(in.record.needles[0].owner == 0 && in.record.needles[1].owner == 7);
    assert_true(!in.needles[0].newest.held && in.needles[1].newest.held);
}

static void needles_that_the_scene_lacks_are_refused(void **unused) {
    (void)unused;
    static const int absent[] = {2, 3, -1, INT32_MIN, INT32_MAX};
    pose_arbiter in = fresh_pair();
    for (int i = 0; i < 5; i++) assert_int_equal(take_at(&in, absent[i], 7, i, 0), POSE_NO_NEEDLE);
    assert_int_equal(in.record.poses_no_needle, 5);
    take_at(&in, 2, 7, 9, 0);
    assert_string_equal(in.record.message, "pose of session 7 refused for needle 2: the scene's `needles` is 2, counted from 0");
    for (int i = 0; i < 5; i++) command_to(&in, absent[i], 7, TROCAR_COMMAND_T_RESET);
    assert_int_equal(in.record.commands_refused, 5);
    assert_int_equal(take_at(&in, 1, 7, 1, 0), POSE_ACCEPTED); /* the refused pose did not use up its sequence number */
}

/* An older device sends needle_pose_t without the `needle` field. The fingerprint differs, and the last field is missing. */
static void an_older_device_is_told_what_to_do(void **unused) {
    (void)unused;
    static const unsigned char older[] = {0xbe, 0x3a, 0xf9, 0x6b, 0xc7, 0x21, 0xe5, 0xea};
    pose_arbiter in = fresh();
    trocar_needle_pose_t m = message(1, 1, 0);
    packet p = pack_pose(&m);
    memcpy(p.data, older, sizeof older);
    assert_int_equal(arbiter_pose(&in, p.data, p.size - 4, 0), POSE_MALFORMED);
    assert_string_equal(in.record.message, "pose of 96 bytes refused: not a trocar.needle_pose_t of this version; it has no `needle`: build its "
                                           "sender with this release's trocar.lcm");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(valid_pose_arrives_unchanged),
        cmocka_unit_test(invalid_pose_messages_are_counted),
        cmocka_unit_test(random_payloads_never_pass_unchecked),
        cmocka_unit_test(nan_and_bad_quaternions_leave_the_last_pose),
        cmocka_unit_test(sequence_numbers_must_increase),
        cmocka_unit_test(no_sequence_number_locks_the_owner_out),
        cmocka_unit_test(a_new_count_is_followed),
        cmocka_unit_test(another_machine_shuts_down_only_with_a_needle),
        cmocka_unit_test(second_session_is_refused_until_the_first_is_silent),
        cmocka_unit_test(a_release_frees_the_needle_at_once),
        cmocka_unit_test(reset_engages_again_with_the_next_pose),
        cmocka_unit_test(only_a_valid_shutdown_shuts_down),
        cmocka_unit_test(jumps_are_rejected_while_the_needle_is_followed),
        cmocka_unit_test(lost_poses_are_counted),
        cmocka_unit_test(bunched_poses_are_accepted_but_fast_motion_is_a_jump),
        cmocka_unit_test(jump_is_accepted_after_the_wrench_has_ramped_out),
        cmocka_unit_test(commands_are_accepted_once_the_owner_is_silent),
        cmocka_unit_test(each_needle_has_its_own_session),
        cmocka_unit_test(a_session_holds_one_needle),
        cmocka_unit_test(needles_that_the_scene_lacks_are_refused),
        cmocka_unit_test(an_older_device_is_told_what_to_do),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

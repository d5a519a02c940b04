/* Compares the messages of the stand-alone client with those of lcm-gen, in both directions, and tests how it reassembles fragments. The client is a single
   file; this test includes it to reach its internal functions. */
#include "trocar_client.c"

#include "trocar_command_reply_t.h"
#include "trocar_command_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_needle_wrench_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

enum { ROUNDS = 20000, LARGE = 120000 };

static unsigned char theirs[MESSAGE_MOST + 1], ours[MESSAGE_MOST];
static uint64_t state = 1;

static uint64_t random_bits(void) { /* xorshift */
    state ^= state << 13, state ^= state >> 7, state ^= state << 17;
    return state;
}

static void randomise(void *bytes, size_t size) {
    for (size_t i = 0; i < size; i++) ((unsigned char *)bytes)[i] = (unsigned char)(random_bits() >> 32);
}

/* Encodes and decodes messages of random bits, infinities included, with both implementations. Messages of the wrong size or type must be refused. */
#define SAME(field) assert_memory_equal(&mine.field, &m.field, sizeof m.field)
#define ROUND(name, theirs_name, CHECKS) \
    for (int round = 0; round < ROUNDS; round++) { \
        theirs_name m; \
        name mine; \
        randomise(&m, sizeof m); \
        int size = theirs_name##_encode(theirs, 0, sizeof theirs, &m); \
        assert_true(decode(&name##_type, theirs, (size_t)size, &mine)); \
        CHECKS \
        assert_int_equal(encode(&name##_type, &mine, ours), size); \
        assert_memory_equal(ours, theirs, size); \
        theirs_name back; \
        assert_int_equal(theirs_name##_decode(ours, 0, size, &back), size); \
        for (int wrong = 0; wrong <= size + 8; wrong += round % 8 + 1) \
            if (wrong != size) assert_false(decode(&name##_type, theirs, (size_t)wrong, &mine)); \
        theirs[random_bits() % 8] ^= 1; \
        assert_false(decode(&name##_type, theirs, (size_t)size, &mine)); \
    }

static void poses_are_the_same(void **unused) {
    (void)unused;
    ROUND(needle_pose, trocar_needle_pose_t, SAME(utime); SAME(session); SAME(seq); SAME(position); SAME(orientation); SAME(wrench_tick); SAME(needle);)
}

static void commands_are_the_same(void **unused) {
    (void)unused;
    ROUND(command, trocar_command_t, SAME(utime); SAME(session); SAME(command); SAME(needle); SAME(seq); SAME(seeds); SAME(spacing);)
}

static void wrenches_are_the_same(void **unused) {
    (void)unused;
    ROUND(needle_wrench, trocar_needle_wrench_t, SAME(utime); SAME(tick); SAME(session); SAME(pose_seq); SAME(pose_utime); SAME(force); SAME(torque);
          SAME(raw_force); SAME(raw_torque); SAME(depth); SAME(contacts); SAME(events); SAME(membrane); SAME(flags); SAME(server); SAME(needle);)
}

static void replies_are_the_same(void **unused) {
    (void)unused;
    static char text[600];
    for (int round = 0; round < ROUNDS; round++) {
        trocar_command_reply_t m;
        command_reply mine;
        size_t length = random_bits() % sizeof text;
        randomise(&m, sizeof m);
        for (size_t i = 0; i < length; i++) text[i] = (char)(1 + random_bits() % 255);
        text[length] = '\0';
        m.message = text;
        int size = trocar_command_reply_t_encode(theirs, 0, sizeof theirs, &m);
        assert_true(decode(&command_reply_type, theirs, (size_t)size, &mine));
        SAME(utime); SAME(server); SAME(session); SAME(seq); SAME(command); SAME(needle); SAME(status);
        assert_int_equal(strlen(mine.message), length < sizeof mine.message ? length : sizeof mine.message - 1);
        assert_memory_equal(mine.message, text, strlen(mine.message));
        for (int wrong = 0; wrong < size + 8; wrong += round % 8 + 1)
            if (wrong != size) assert_false(decode(&command_reply_type, theirs, (size_t)wrong, &mine));
        theirs[size - 1] = 'x'; /* no end */
        assert_false(decode(&command_reply_type, theirs, (size_t)size, &mine));
    }
}

/* The constants offered to bridges equal those of the LCM messages. */
static void constants_are_the_same(void **unused) {
    (void)unused;
#define EQUAL(word) assert_int_equal(TROCAR_CLIENT_##word, TROCAR_NEEDLE_WRENCH_T_##word)
#define EQUAL_FLAG(word) assert_int_equal(TROCAR_CLIENT_FLAG_##word, TROCAR_NEEDLE_WRENCH_T_##word)
    EQUAL_FLAG(STALE); EQUAL_FLAG(SATURATED); EQUAL_FLAG(NOT_REALTIME); EQUAL_FLAG(RAMPING); EQUAL_FLAG(LATE_WORKER); EQUAL_FLAG(UNSTABLE);
    EQUAL_FLAG(OVERRUN); EQUAL_FLAG(ACTIVE); EQUAL_FLAG(MISSED_GUIDE); EQUAL_FLAG(OUTSIDE_MODEL); EQUAL_FLAG(PROBE_STOPPED);
    EQUAL(EVENT_TOUCHED); EQUAL(EVENT_PUNCTURE); EQUAL(EVENT_ADDED); EQUAL(EVENT_REMOVED); EQUAL(EVENT_EXITED); EQUAL(EVENT_REENTERED);
    EQUAL(EVENT_WITHDRAWN); EQUAL(EVENT_LATE); EQUAL(EVENT_FULL); EQUAL(EVENT_UNSTABLE); EQUAL(EVENT_KEPT); EQUAL(EVENT_MISSED_GUIDE);
    EQUAL(EVENT_OUTSIDE_MODEL); EQUAL(EVENT_TRACK_DROPPED); EQUAL(EVENT_INEXACT);
}

/* ---- fragments ------------------------------------------------------------------------------------------------------------ */

static trocar_client *open_alone(void) {
    trocar_client *c = create_client(&(trocar_client_options){0});
    assert_non_null(c);
    assert_true(os_open(&c->os));
    return c;
}

/* Builds a reply of LARGE bytes to the client's last command, with the status "done". */
static void make_reply(const trocar_client *c) {
    static char text[LARGE];
    trocar_command_reply_t m = {.server = 5, .session = c->session, .seq = c->asked, .status = TROCAR_COMMAND_REPLY_T_DONE, .message = text};
    memset(text, 'a' + (int)(c->asked % 26), sizeof text - 1);
    text[sizeof text - (size_t)trocar_command_reply_t_encoded_size(&(trocar_command_reply_t){.message = (char[]){""}})] = '\0';
    assert_int_equal(trocar_command_reply_t_encode(theirs, 0, sizeof theirs, &m), LARGE);
}

typedef struct {
    const char *channel;
    uint32_t sequence;
    uint16_t port;           /* the sender's port */
    unsigned count;
} cut;

/* Passes fragment `number` of the message in `theirs`, which is split into equal parts, to the client. */
static void give(trocar_client *c, const cut *k, unsigned number) {
    static unsigned char packet[DATAGRAM_MOST];
    size_t part = (LARGE + k->count - 1) / k->count, offset = number * part, size = offset + part < LARGE ? part : LARGE - offset, name = 0;
    memcpy(packet, "LC03", 4);
    put_number(packet + 4, k->sequence, 4);
    put_number(packet + 8, LARGE, 4);
    put_number(packet + 12, offset, 4);
    put_number(packet + 16, number, 2);
    put_number(packet + 18, k->count, 2);
    if (number == 0) name = strlen(k->channel) + 1;
    memcpy(packet + 20, k->channel, name);
    memcpy(packet + 20 + name, theirs + offset, size);
    const struct sockaddr_in from = {.sin_family = AF_INET, .sin_port = htons(k->port), .sin_addr = {htonl(INADDR_LOOPBACK)}};
    take_datagram(c, packet, 20 + name + size, &from);
}

static bool is_answered(trocar_client *c) {
    char why[64];
    if (trocar_client_reply(c, why, sizeof why) != TROCAR_CLIENT_DONE) return false;
    assert_int_equal(strlen(why), sizeof why - 1);
    assert_int_equal(why[0], 'a' + (int)(c->asked % 26));
    return true;
}

/* After fragment 0, the fragments arrive in any order, some of them twice, interleaved with messages from other senders. */
static void fragments_come_in_any_order(void **unused) {
    (void)unused;
    trocar_client *c = open_alone();
    for (int round = 0; round < 300; round++) {
        assert_true(trocar_client_reset(c));
        make_reply(c);
        cut k = {"TROCAR_REPLY", (uint32_t)random_bits(), 1000, 2 + (unsigned)(random_bits() % (FRAGMENTS_MOST - 1))};
        unsigned order[FRAGMENTS_MOST] = {0};
        for (unsigned i = 1; i < k.count; i++) {
            unsigned j = 1 + (unsigned)(random_bits() % i);
            order[i] = order[j], order[j] = i;
        }
        for (unsigned i = 0; i < k.count; i++) {
            assert_false(is_answered(c));
            give(c, &k, order[i]);
            if (round % 3 == 1) give(c, &k, order[random_bits() % (i + 1)]);
            if (round % 3 == 2) give(c, &(cut){"TROCAR_DEFORMATION", k.sequence, 1001, k.count}, order[i]);
        }
        assert_true(is_answered(c));
    }
    free_client(c);
}

static void a_message_without_all_of_its_fragments_is_none(void **unused) {
    (void)unused;
    trocar_client *c = open_alone();
    for (unsigned lost = 0; lost < 20; lost++) {
        assert_true(trocar_client_reset(c));
        make_reply(c);
        const cut k = {"TROCAR_REPLY", lost, 1000, 20}, next = {"TROCAR_REPLY", lost + 1, 1000, 20};
        for (unsigned i = 0; i < 20; i++)
            if (i != lost) give(c, &k, i);
        give(c, &(cut){"TROCAR_REPLY", lost, 1001, 20}, lost); /* from another sender */
        give(c, &(cut){"TROCAR_REPLY", lost, 1000, 21}, lost); /* of another message */
        assert_false(is_answered(c));
        for (unsigned i = 0; i < 20; i++) give(c, &next, i);
        assert_true(is_answered(c));
    }
    free_client(c);
}

/* Default, zeroed and missing options have the same effect. */
static void default_options_are_those_of_zero(void **unused) {
    (void)unused;
    const trocar_client_options defaults = trocar_client_default_options(), zero = {0};
    assert_true(defaults.max_force > 0 && defaults.max_torque > 0 && defaults.watchdog > 0);
    trocar_client *c = create_client(&defaults), *of_zero = create_client(&zero);
    assert_true(os_open(&c->os) && os_open(&of_zero->os));
    assert_true(c->watchdog == of_zero->watchdog && c->needle == of_zero->needle && c->without_force == of_zero->without_force);
    assert_true(c->force.most == of_zero->force.most && c->force.rate == of_zero->force.rate);
    assert_true(c->torque.most == of_zero->torque.most && c->torque.rate == of_zero->torque.rate);
    assert_true(!defaults.url && defaults.priority == zero.priority);
    free_client(c);
    free_client(of_zero);
}

/* Impossible options are refused before anything is opened. */
static void impossible_options_are_refused(void **unused) {
    (void)unused;
    const trocar_client_options bad[] = {{.needle = -1}, {.watchdog = -0.02}, {.watchdog = NAN}, {.max_force = -1}, {.max_torque_rate = NAN}};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        char why[256] = "";
        assert_null(trocar_client_open(&bad[i], why, sizeof why));
        assert_non_null(strstr(why, bad[i].needle < 0 ? "needle must be" : "must be above 0"));
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(default_options_are_those_of_zero),
        cmocka_unit_test(impossible_options_are_refused),
        cmocka_unit_test(poses_are_the_same),
        cmocka_unit_test(commands_are_the_same),
        cmocka_unit_test(wrenches_are_the_same),
        cmocka_unit_test(replies_are_the_same),
        cmocka_unit_test(constants_are_the_same),
        cmocka_unit_test(fragments_come_in_any_order),
        cmocka_unit_test(a_message_without_all_of_its_fragments_is_none),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

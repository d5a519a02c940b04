/* Tests the handshake, the client table and the replay protection. Clients' datagrams are built with the functions of wire.h, which test_wire.c compares
   with Python's; addresses and times are passed in as arguments. */
#include <arpa/inet.h>
#include <stdbool.h>
#include <string.h>

#include "trocar_command_t.h"
#include "trocar_needle_pose_t.h"
#include "trocar_probe_pose_t.h"
#include "unicast/gate.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const int64_t SECOND = 1000000000;

/* A client, played by the test. */
typedef struct {
    struct sockaddr_in address;
    wire_key secret, to_server, to_client;
    wire_handshake h;
    uint64_t sent;
} player;

typedef struct {
    gate gate;
    int64_t now;
    gate_result result;
    unsigned char fresh[WIRE_TOKEN];
} fixture;

static int open_fixture(void **state) {
    static fixture f;
    wire_key secret = wire_secret_key("the right secret", 16), cookie = wire_secret_key("cookies", 7);
    memset(&f, 0, sizeof f);
    f.now = 100 * SECOND;
    gate_init(&f.gate, &secret, &cookie);
    *state = &f;
    return 0;
}

static player player_at(int port) {
    player p = {.address = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port), .sin_addr = {htonl(INADDR_LOOPBACK)}},
                .secret = wire_secret_key("the right secret", 16)};
    p.h.nonce[0] = (unsigned char)port;
    p.h.nonce[1] = (unsigned char)(port >> 8);
    return p;
}

static gate_verdict take(fixture *f, const void *datagram, size_t size, const struct sockaddr_in *from) {
    f->fresh[0]++;
    return gate_take(&f->gate, datagram, size, from, f->now, f->fresh, &f->result);
}

static gate_verdict shake(fixture *f, player *p, wire_kind kind) {
    unsigned char datagram[WIRE_HANDSHAKE];
    return take(f, datagram, wire_put_handshake(datagram, kind, &p->h, &p->secret), &p->address);
}

/* Checks that the gate has answered with this kind of datagram, no larger than the client's, and stores its token. */
static void check_answer(fixture *f, player *p, gate_verdict verdict, wire_kind kind) {
    assert_int_equal(verdict, GATE_ANSWER);
    assert_int_equal(f->result.answer_size, WIRE_HANDSHAKE);
    assert_int_equal(wire_kind_of(f->result.answer, f->result.answer_size), kind);
    wire_handshake got = wire_get_handshake(f->result.answer);
    assert_memory_equal(got.nonce, p->h.nonce, WIRE_NONCE);
    memcpy(p->h.token, got.token, WIRE_TOKEN);
}

static void connect_player(fixture *f, player *p) {
    check_answer(f, p, shake(f, p, WIRE_HELLO), WIRE_COOKIE);
    check_answer(f, p, shake(f, p, WIRE_CONNECT), WIRE_WELCOME);
    assert_true(wire_is_authentic(&p->secret, f->result.answer, f->result.answer_size));
    p->to_server = wire_direction_key(&p->secret, WIRE_TO_SERVER, p->h.nonce, p->h.token);
    p->to_client = wire_direction_key(&p->secret, WIRE_TO_CLIENT, p->h.nonce, p->h.token);
    p->sent = 0;
}

static size_t make_pose(player *p, int64_t session, unsigned char datagram[WIRE_MOST]) {
    unsigned char bytes[256];
    trocar_needle_pose_t m = {.session = session, .seq = (int64_t)p->sent};
    int size = trocar_needle_pose_t_encode(bytes, 0, sizeof bytes, &m);
    return wire_put_message(datagram, WIRE_TO_SERVER, ++p->sent, "TROCAR_POSE", bytes, (size_t)size, &p->to_server);
}

static gate_verdict send_pose(fixture *f, player *p, int64_t session) {
    static unsigned char datagram[WIRE_MOST];
    return take(f, datagram, make_pose(p, session, datagram), &p->address);
}

static gate_verdict send_message(fixture *f, player *p, const char *channel, const void *bytes, size_t size) {
    static unsigned char datagram[WIRE_MOST];
    return take(f, datagram, wire_put_message(datagram, WIRE_TO_SERVER, ++p->sent, channel, bytes, size, &p->to_server), &p->address);
}

static void a_client_connects_and_is_relayed(void **state) {
    fixture *f = *state;
    player p = player_at(1000);
    unsigned char to[WIRE_MOST];
    connect_player(f, &p);
    assert_int_equal(gate_present(&f->gate, f->now), 1);
    assert_int_equal(send_pose(f, &p, 77), GATE_RELAY);
    assert_string_equal(f->result.channel, "TROCAR_POSE");
    trocar_needle_pose_t m;
    assert_int_equal(trocar_needle_pose_t_decode(f->result.bytes, 0, (int)f->result.size, &m), f->result.size);
    assert_int_equal(m.session, 77);

    size_t size = gate_put(&f->gate, 0, 77, "TROCAR_WRENCH", "wrench", 6, f->now, to);
    assert_true(size > 0 && wire_is_authentic(&p.to_client, to, size));
    assert_int_equal(gate_put(&f->gate, 0, 78, "TROCAR_WRENCH", "wrench", 6, f->now, to), 0); /* another client's */
    assert_int_equal(gate_put(&f->gate, 1, 77, "TROCAR_WRENCH", "wrench", 6, f->now, to), 0);
    assert_int_equal(gate_put(&f->gate, 0, 77, "TROCAR_WRENCH", to, WIRE_MESSAGE_MOST + 1, f->now, to), 0);
}

static void every_type_names_its_session(void **state) {
    fixture *f = *state;
    player p = player_at(1000);
    unsigned char bytes[256];
    connect_player(f, &p);
    trocar_command_t command = {.session = 5, .command = TROCAR_COMMAND_T_SHUTDOWN};
    int size = trocar_command_t_encode(bytes, 0, sizeof bytes, &command);
    assert_int_equal(send_message(f, &p, "TROCAR_COMMAND", bytes, (size_t)size), GATE_RELAY);
    assert_string_equal(f->result.channel, "REMOTE_COMMAND"); /* on this channel, it counts as a command from another machine */
    assert_int_equal(f->gate.clients[0].session, 5);
    for (command.command = -1; command.command < 300; command.command++) {
        size = trocar_command_t_encode(bytes, 0, sizeof bytes, &command);
        assert_int_equal(send_message(f, &p, "TROCAR_COMMAND", bytes, (size_t)size), GATE_RELAY);
        assert_string_equal(f->result.channel, command.command == TROCAR_COMMAND_T_SHUTDOWN ? "REMOTE_COMMAND" : "TROCAR_COMMAND");
    }
    trocar_probe_pose_t probe = {.session = 6};
    size = trocar_probe_pose_t_encode(bytes, 0, sizeof bytes, &probe);
    assert_int_equal(send_message(f, &p, "TROCAR_PROBE", bytes, (size_t)size), GATE_RELAY);
    assert_int_equal(f->gate.clients[0].session, 6);
    assert_int_equal(send_pose(f, &p, -7), GATE_RELAY);
    assert_int_equal(f->gate.clients[0].session, -7);
}

static void other_channels_are_dropped(void **state) {
    fixture *f = *state;
    player p = player_at(1000);
    unsigned char bytes[WIRE_MESSAGE_MOST] = {0};
    static const char *const channels[] = {"REMOTE_COMMAND", "TROCAR_WRENCH", "TROCAR_REPLY", "TROCAR_STATUS", "TROCAR_POSE ", "trocar_pose", "", "\x1b[2J", "LCM_SELF_TEST"};
    connect_player(f, &p);
    for (size_t i = 0; i < sizeof channels / sizeof *channels; i++) assert_int_equal(send_message(f, &p, channels[i], bytes, 100), GATE_DROP);
    assert_int_equal(send_message(f, &p, "TROCAR_POSE", bytes, 23), GATE_DROP); /* too short to contain a session */
    assert_int_equal(f->gate.counts.malformed, 10);
    assert_int_equal(f->gate.counts.relayed, 0);
}

static void signs_of_life_are_answered(void **state) {
    fixture *f = *state;
    player p = player_at(1000);
    connect_player(f, &p);
    assert_int_equal(send_message(f, &p, "", NULL, 0), GATE_ANSWER);
    assert_int_equal(wire_kind_of(f->result.answer, f->result.answer_size), WIRE_TO_CLIENT);
    assert_int_equal(f->result.answer_size, WIRE_HEAD + 8 + 1 + WIRE_TAG);
    assert_true(wire_is_authentic(&p.to_client, f->result.answer, f->result.answer_size));
    f->now += 2 * SECOND;
    assert_int_equal(send_message(f, &p, "", NULL, 0), GATE_ANSWER);
    f->now += 2 * SECOND;
    assert_int_equal(gate_present(&f->gate, f->now), 1);
    f->now += SECOND;
    assert_int_equal(gate_present(&f->gate, f->now), 0); /* after three seconds of silence, no client is left */
    assert_int_equal(send_pose(f, &p, 1), GATE_DROP);
}

static void nothing_is_stored_before_the_cookie_returns(void **state) {
    fixture *f = *state;
    static gate before;
    player p = player_at(1000);
    before = f->gate;
    for (int i = 0; i < 1000; i++) {
        p.h.nonce[2] = (unsigned char)i;
        assert_int_equal(shake(f, &p, WIRE_HELLO), GATE_ANSWER);
    }
    assert_memory_equal(&before, &f->gate, sizeof before);
}

static void a_wrong_secret_is_refused_a_few_times_per_second(void **state) {
    fixture *f = *state;
    player p = player_at(1000);
    p.secret = wire_secret_key("another secret", 14);
    for (int second = 0; second < 2; second++, f->now += SECOND)
        for (int i = 0; i < 100; i++) {
            gate_verdict verdict = shake(f, &p, WIRE_HELLO);
            if (i >= GATE_REFUSALS) assert_int_equal(verdict, GATE_DROP);
            else check_answer(f, &p, verdict, WIRE_REFUSED);
            if (i < GATE_REFUSALS) assert_int_equal(p.h.token[0], WIRE_WRONG_SECRET);
        }
    assert_int_equal(shake(f, &p, WIRE_CONNECT), GATE_DROP);
    assert_int_equal(f->gate.counts.forged, 201);
    assert_int_equal(gate_present(&f->gate, f->now), 0);
}

static void a_cookie_belongs_to_one_address_and_nonce_for_a_short_time(void **state) {
    fixture *f = *state;
    player p = player_at(1000), other;
    check_answer(f, &p, shake(f, &p, WIRE_HELLO), WIRE_COOKIE);
    other = p;
    other.address.sin_port = htons(1001);
    assert_int_equal(shake(f, &other, WIRE_CONNECT), GATE_DROP);
    other = p;
    other.address.sin_addr.s_addr ^= htonl(1);
    assert_int_equal(shake(f, &other, WIRE_CONNECT), GATE_DROP);
    other = p;
    other.h.nonce[5] ^= 1;
    assert_int_equal(shake(f, &other, WIRE_CONNECT), GATE_DROP);
    for (int i = 0; i < WIRE_TOKEN; i++) {
        other = p;
        other.h.token[i] ^= 0x10;
        assert_int_equal(shake(f, &other, WIRE_CONNECT), GATE_DROP);
    }
    other = p;
    f->now += 5 * SECOND;
    assert_int_equal(shake(f, &other, WIRE_CONNECT), GATE_DROP);
    f->now -= 1;
    check_answer(f, &p, shake(f, &p, WIRE_CONNECT), WIRE_WELCOME);
}

static void a_repeated_connect_changes_nothing(void **state) {
    fixture *f = *state;
    player p = player_at(1000), again;
    check_answer(f, &p, shake(f, &p, WIRE_HELLO), WIRE_COOKIE);
    again = p;
    check_answer(f, &p, shake(f, &p, WIRE_CONNECT), WIRE_WELCOME);
    assert_true(f->result.is_new);
    p.to_server = wire_direction_key(&p.secret, WIRE_TO_SERVER, p.h.nonce, p.h.token);
    assert_int_equal(send_pose(f, &p, 1), GATE_RELAY);
    check_answer(f, &again, shake(f, &again, WIRE_CONNECT), WIRE_WELCOME);
    assert_false(f->result.is_new);
    assert_memory_equal(again.h.token, p.h.token, WIRE_TOKEN);
    p.sent = 0;
    assert_int_equal(send_pose(f, &p, 1), GATE_DROP); /* reuses the first counter */
    assert_int_equal(send_pose(f, &p, 1), GATE_RELAY);
}

static void an_older_connect_does_not_replace_a_connection(void **state) {
    fixture *f = *state;
    player old = player_at(1000), new = old, replay;
    check_answer(f, &old, shake(f, &old, WIRE_HELLO), WIRE_COOKIE);
    replay = old;
    f->now += SECOND;
    new.h.nonce[7] = 1;
    connect_player(f, &new);
    assert_int_equal(shake(f, &replay, WIRE_CONNECT), GATE_DROP);
    assert_int_equal(f->gate.counts.replayed, 1);
    assert_int_equal(send_pose(f, &new, 1), GATE_RELAY);
}

static void messages_of_an_earlier_connection_are_not_authentic(void **state) {
    fixture *f = *state;
    static unsigned char recorded[10][WIRE_MOST];
    size_t sizes[10];
    player p = player_at(1000);
    unsigned char connect[WIRE_HANDSHAKE];
    check_answer(f, &p, shake(f, &p, WIRE_HELLO), WIRE_COOKIE);
    wire_put_handshake(connect, WIRE_CONNECT, &p.h, &p.secret);
    check_answer(f, &p, take(f, connect, sizeof connect, &p.address), WIRE_WELCOME);
    p.to_server = wire_direction_key(&p.secret, WIRE_TO_SERVER, p.h.nonce, p.h.token);
    for (int i = 0; i < 10; i++) {
        sizes[i] = make_pose(&p, 1, recorded[i]);
        assert_int_equal(take(f, recorded[i], sizes[i], &p.address), GATE_RELAY);
    }
    f->now += 3 * SECOND; /* the client has been forgotten, but its cookie is still valid */
    assert_int_equal(gate_present(&f->gate, f->now), 0);
    assert_int_equal(take(f, connect, sizeof connect, &p.address), GATE_ANSWER);
    for (int i = 0; i < 10; i++) assert_int_equal(take(f, recorded[i], sizes[i], &p.address), GATE_DROP);
    assert_int_equal(f->gate.counts.relayed, 10);
}

static void replays_and_forgeries_are_dropped(void **state) {
    fixture *f = *state;
    static unsigned char recorded[200][WIRE_MOST];
    size_t sizes[200];
    player p = player_at(1000), other = player_at(1001);
    connect_player(f, &p);
    connect_player(f, &other);
    for (int i = 0; i < 200; i++) sizes[i] = make_pose(&p, 1, recorded[i]);
    for (int i = 0; i < 200; i++) assert_int_equal(take(f, recorded[i ^ 3], sizes[i ^ 3], &p.address), GATE_RELAY); /* in another order */
    for (int i = 0; i < 200; i++) assert_int_equal(take(f, recorded[i], sizes[i], &p.address), GATE_DROP);
    assert_int_equal(f->gate.counts.replayed, 200);
    size_t size = make_pose(&p, 1, recorded[0]);
    assert_int_equal(take(f, recorded[0], size, &other.address), GATE_DROP);  /* dropped, because it comes from another client's address */
    for (size_t i = 0; i < size; i++) assert_int_equal(take(f, recorded[0], i, &p.address), GATE_DROP);
    for (size_t i = 0; i < size; i++) {
        recorded[0][i] ^= 0x40;
        assert_int_equal(take(f, recorded[0], size, &p.address), GATE_DROP);
        recorded[0][i] ^= 0x40;
    }
    unsigned char to[WIRE_MOST];
    size_t back = gate_put(&f->gate, 0, 1, "TROCAR_POSE", recorded[1] + 24, 100, f->now, to);
    assert_int_equal(take(f, to, back, &p.address), GATE_DROP); /* dropped: the server's own datagram, reflected */
    to[3] = WIRE_TO_SERVER;
    assert_int_equal(take(f, to, back, &p.address), GATE_DROP);
    assert_int_equal(take(f, recorded[0], size, &p.address), GATE_RELAY);
    assert_int_equal(f->gate.counts.relayed, 201);
}

static void the_number_of_clients_is_bounded(void **state) {
    fixture *f = *state;
    player p;
    for (int i = 0; i < GATE_CLIENTS; i++) {
        p = player_at(2000 + i);
        connect_player(f, &p);
    }
    player late = player_at(3000);
    check_answer(f, &late, shake(f, &late, WIRE_HELLO), WIRE_COOKIE);
    check_answer(f, &late, shake(f, &late, WIRE_CONNECT), WIRE_REFUSED);
    assert_int_equal(late.h.token[0], WIRE_FULL);
    assert_true(wire_is_authentic(&late.secret, f->result.answer, f->result.answer_size));
    f->now += SECOND;
    assert_int_equal(send_pose(f, &p, 1), GATE_RELAY);
    f->now += 2 * SECOND; /* all other clients have been silent for three seconds */
    memset(late.h.token, 0, WIRE_TOKEN);
    connect_player(f, &late);
    assert_int_equal(gate_present(&f->gate, f->now), 2);
}

static void the_rate_of_a_client_is_bounded(void **state) {
    fixture *f = *state;
    player p = player_at(1000), calm = player_at(1001);
    connect_player(f, &p);
    connect_player(f, &calm);
    int relayed = 0;
    for (int i = 0; i < 20000; i++, f->now += SECOND / 20000) {
        relayed += send_pose(f, &p, 1) == GATE_RELAY;
        if (i % 20 == 0) assert_int_equal(send_pose(f, &calm, 2), GATE_RELAY);
    }
    assert_in_range(relayed, GATE_RATE, GATE_RATE + GATE_RATE / 4 + 1);
    assert_int_equal(f->gate.counts.excessive, 20000 - relayed);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup(a_client_connects_and_is_relayed, open_fixture),
        cmocka_unit_test_setup(every_type_names_its_session, open_fixture),
        cmocka_unit_test_setup(other_channels_are_dropped, open_fixture),
        cmocka_unit_test_setup(signs_of_life_are_answered, open_fixture),
        cmocka_unit_test_setup(nothing_is_stored_before_the_cookie_returns, open_fixture),
        cmocka_unit_test_setup(a_wrong_secret_is_refused_a_few_times_per_second, open_fixture),
        cmocka_unit_test_setup(a_cookie_belongs_to_one_address_and_nonce_for_a_short_time, open_fixture),
        cmocka_unit_test_setup(a_repeated_connect_changes_nothing, open_fixture),
        cmocka_unit_test_setup(an_older_connect_does_not_replace_a_connection, open_fixture),
        cmocka_unit_test_setup(messages_of_an_earlier_connection_are_not_authentic, open_fixture),
        cmocka_unit_test_setup(replays_and_forgeries_are_dropped, open_fixture),
        cmocka_unit_test_setup(the_number_of_clients_is_bounded, open_fixture),
        cmocka_unit_test_setup(the_rate_of_a_client_is_bounded, open_fixture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Tests the relay thread with a client on the loopback interface and LCM without a network (memq). The client's messages are published, and the IO thread's
   messages reach the client. The test waits for datagrams, never for fixed times. */
#include <arpa/inet.h>
#include <pthread.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/eventfd_signal.h"
#include "relay.h"
#include "trocar_needle_pose_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

enum { MESSAGES = 100, LONGEST = 10 }; /* LONGEST: s without a datagram after which the test fails */

typedef struct {
    exchange exchange;
    relay relay;
    pthread_t thread;
    int client;
    wire_key secret;
} fixture;

static int open_fixture(void **state) {
    static fixture f;
    trocar_error why;
    struct sockaddr_in address = {.sin_family = AF_INET, .sin_addr = {htonl(INADDR_LOOPBACK)}};
    socklen_t size = sizeof address;
    memset(&f, 0, sizeof f);
    f.secret = wire_secret_key("a secret", 8);
    assert_int_equal(exchange_create(&f.exchange, NULL, &why), TROCAR_OK);
    assert_int_equal(relay_create(&f.relay, &address, &f.secret, "memq://", false, &f.exchange, &why), TROCAR_OK);
    assert_int_equal(getsockname(f.relay.socket, (struct sockaddr *)&address, &size), 0);
    f.client = socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    assert_int_equal(connect(f.client, (struct sockaddr *)&address, sizeof address), 0);
    assert_int_equal(setsockopt(f.client, SOL_SOCKET, SO_RCVTIMEO, &(struct timeval){.tv_sec = LONGEST}, sizeof(struct timeval)), 0);
    *state = &f;
    return 0;
}

static int close_fixture(void **state) {
    fixture *f = *state;
    close(f->client);
    relay_free(&f->relay);
    exchange_free(&f->exchange);
    return 0;
}

static void on_pose(const lcm_recv_buf_t *b, const char *channel, const trocar_needle_pose_t *m, void *context) {
    (void)b, (void)channel;
    int64_t *next = context;
    assert_int_equal(m->seq, (*next)++);
}

/* Sends a handshake and stores the token from the answer, which must be of this kind. */
static void shake(fixture *f, wire_handshake *h, wire_kind kind, wire_kind wanted) {
    unsigned char datagram[WIRE_MOST];
    size_t size = wire_put_handshake(datagram, kind, h, &f->secret);
    assert_int_equal(send(f->client, datagram, size, 0), size);
    assert_int_equal(recv(f->client, datagram, sizeof datagram, 0), WIRE_HANDSHAKE);
    assert_int_equal(wire_kind_of(datagram, WIRE_HANDSHAKE), wanted);
    *h = wire_get_handshake(datagram);
}

static void messages_pass_both_ways(void **state) {
    fixture *f = *state;
    wire_handshake h = {.nonce = {7}};
    unsigned char datagram[WIRE_MOST], bytes[256];
    int64_t next = 0;
    trocar_needle_pose_t_subscription_t *subscription = trocar_needle_pose_t_subscribe(f->relay.lcm, "TROCAR_POSE", on_pose, &next);
    assert_non_null(subscription);
    assert_int_equal(pthread_create(&f->thread, NULL, relay_run, &f->relay), 0);
    shake(f, &h, WIRE_HELLO, WIRE_COOKIE);
    shake(f, &h, WIRE_CONNECT, WIRE_WELCOME);
    wire_key to_server = wire_direction_key(&f->secret, WIRE_TO_SERVER, h.nonce, h.token);
    wire_key to_client = wire_direction_key(&f->secret, WIRE_TO_CLIENT, h.nonce, h.token);
    for (int64_t i = 0; i < MESSAGES; i++) {
        trocar_needle_pose_t m = {.session = 9, .seq = i};
        int encoded = trocar_needle_pose_t_encode(bytes, 0, sizeof bytes, &m);
        size_t size = wire_put_message(datagram, WIRE_TO_SERVER, (uint64_t)i + 1, "TROCAR_POSE", bytes, (size_t)encoded, &to_server);
        assert_int_equal(send(f->client, datagram, size, 0), size);
        assert_true(lcm_handle_timeout(f->relay.lcm, 1000 * LONGEST) > 0);

        outgoing_message answer = {.session = 9, .channel = "TROCAR_WRENCH", .size = sizeof i};
        memcpy(answer.bytes, &i, sizeof i);
        assert_true(spsc_ring_push(&f->exchange.outgoing, &answer));
        eventfd_signal(f->exchange.relay_wake);
        ssize_t got = recv(f->client, datagram, sizeof datagram, 0);
        wire_message received;
        assert_true(got > 0 && wire_kind_of(datagram, (size_t)got) == WIRE_TO_CLIENT && wire_is_authentic(&to_client, datagram, (size_t)got));
        assert_true(wire_get_message(datagram, (size_t)got, &received));
        assert_true(received.counter == (uint64_t)i + 1 && received.size == sizeof i && memcmp(received.bytes, &i, sizeof i) == 0);
        assert_string_equal(received.channel, "TROCAR_WRENCH");
    }
    assert_int_equal(next, MESSAGES);
    relay_stop(&f->relay);
    pthread_join(f->thread, NULL);
    trocar_needle_pose_t_unsubscribe(f->relay.lcm, subscription);
    assert_int_equal(f->relay.gate.counts.relayed, MESSAGES);
    assert_int_equal(f->relay.unpublished + f->relay.unsent, 0);
}

static void the_last_messages_are_sent_before_the_end(void **state) {
    fixture *f = *state;
    wire_handshake h = {.nonce = {8}};
    unsigned char datagram[WIRE_MOST], bytes[24] = {[23] = 9};
    assert_int_equal(pthread_create(&f->thread, NULL, relay_run, &f->relay), 0);
    shake(f, &h, WIRE_HELLO, WIRE_COOKIE);
    shake(f, &h, WIRE_CONNECT, WIRE_WELCOME);
    wire_key to_server = wire_direction_key(&f->secret, WIRE_TO_SERVER, h.nonce, h.token);
    size_t size = wire_put_message(datagram, WIRE_TO_SERVER, 1, "TROCAR_POSE", bytes, sizeof bytes, &to_server);
    assert_int_equal(send(f->client, datagram, size, 0), size);
    size = wire_put_message(datagram, WIRE_TO_SERVER, 2, "", NULL, 0, &to_server); /* the answer shows that the pose has been received */
    assert_int_equal(send(f->client, datagram, size, 0), size);
    assert_true(recv(f->client, datagram, sizeof datagram, 0) > 0);
    for (int i = 0; i < MESSAGES; i++) {
        outgoing_message m = {.session = 9, .channel = "TROCAR_WRENCH", .size = 1};
        assert_true(spsc_ring_push(&f->exchange.outgoing, &m));
    }
    relay_stop(&f->relay);
    pthread_join(f->thread, NULL);
    for (int i = 0; i < MESSAGES; i++) assert_true(recv(f->client, datagram, sizeof datagram, MSG_DONTWAIT) > 0);
}

static void an_address_in_use_is_reported(void **state) {
    fixture *f = *state;
    relay other = {.socket = -1};
    exchange x;
    trocar_error why;
    struct sockaddr_in address;
    socklen_t size = sizeof address;
    assert_int_equal(getsockname(f->relay.socket, (struct sockaddr *)&address, &size), 0);
    assert_int_equal(exchange_create(&x, NULL, &why), TROCAR_OK);
    assert_int_equal(relay_create(&other, &address, &f->secret, "memq://", false, &x, &why), TROCAR_SYSTEM);
    assert_non_null(strstr(why.text, "cannot listen on 127.0.0.1:"));
    relay_free(&other);
    exchange_free(&x);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(messages_pass_both_ways, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(the_last_messages_are_sent_before_the_end, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(an_address_in_use_is_reported, open_fixture, close_fixture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

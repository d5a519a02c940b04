/* Compares the unicast protocol's datagrams with values from Python's hmac module, and tests the anti-replay window. */
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "unicast/wire.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const unsigned char NONCE[WIRE_NONCE] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
static const unsigned char TOKEN[WIRE_TOKEN] = {100, 101, 102, 103, 104, 105, 106, 107, 108, 109, 110, 111, 112, 113, 114, 115, 116, 117, 118, 119, 120, 121, 122, 123};

static void check_hex(const void *bytes, size_t size, const char *wanted) {
    char text[2 * WIRE_MOST + 1];
    for (size_t i = 0; i < size; i++) snprintf(text + 2 * i, 3, "%02x", ((const unsigned char *)bytes)[i]);
    assert_string_equal(text, wanted);
}

static void keys_agree_with_hmac_sha256(void **state) {
    (void)state;
    wire_key secret = wire_secret_key("0123456789abcdef0123456789abcdef", 32);
    wire_key to_server = wire_direction_key(&secret, WIRE_TO_SERVER, NONCE, TOKEN), to_client = wire_direction_key(&secret, WIRE_TO_CLIENT, NONCE, TOKEN);
    check_hex(secret.bytes, WIRE_KEY, 
        "a2d63910937ea218508edf4592b7d6a4efbe9b36eaf3fcd7b49107480d10d1d5");
    check_hex(to_server.bytes, WIRE_KEY, 
        "3ef07433f9e2e563f457912544b6276781450ba5b63e48511db5fb0c8571fd02");
    check_hex(to_client.bytes, WIRE_KEY, 
        "9731ea7b152d0b5f84b97ec0b91faa04fa9d841ec01fd70439dfe937bc2c4308");
}

static void datagrams_agree_with_python(void **state) {
    (void)state;
    unsigned char datagram[WIRE_MOST];
    wire_key secret = wire_secret_key("0123456789abcdef0123456789abcdef", 32);
    wire_handshake h;
    memcpy(h.nonce, NONCE, WIRE_NONCE);
    memcpy(h.token, TOKEN, WIRE_TOKEN);
    check_hex(datagram, wire_put_handshake(datagram, WIRE_CONNECT, &h, &secret), 
        "54553103000102030405060708090a0b0c0d0e0f6465666768696a6b6c6d6e6f707172737475767778797a7b3e4d26cbef7c"
        "a5988f70d18f0db21b13fd3e3841403d0ce69d4eeb2eebec830a");
    check_hex(datagram, wire_put_message(datagram, WIRE_TO_SERVER, 258, "TROCAR_POSE", "abc", 3, &secret), 
        "54553106000000000000010254524f4341525f504f5345006162637443e65b8d42d078b83edcb5312fa45f9d4222eaac6eaa"
        "6cc64d2b9094482f8b");
}

static void datagrams_are_read_back(void **state) {
    (void)state;
    unsigned char datagram[WIRE_MOST];
    wire_key key = wire_secret_key("", 0), other = wire_secret_key("x", 1);
    wire_message m;
    size_t size = wire_put_message(datagram, WIRE_TO_CLIENT, 0x0102030405060708, "CHANNEL", "message", 7, &key);
    assert_int_equal(wire_kind_of(datagram, size), WIRE_TO_CLIENT);
    assert_true(wire_is_authentic(&key, datagram, size));
    assert_false(wire_is_authentic(&other, datagram, size));
    assert_true(wire_get_message(datagram, size, &m));
    assert_true(m.counter == 0x0102030405060708 && m.size == 7);
    assert_string_equal(m.channel, "CHANNEL");
    assert_memory_equal(m.bytes, "message", 7);
    for (size_t i = 0; i < 8 * size; i++) { /* every bit counts */
        datagram[i / 8] ^= (unsigned char)(1 << i % 8);
        assert_false(wire_is_authentic(&key, datagram, size));
        datagram[i / 8] ^= (unsigned char)(1 << i % 8);
    }
}

static void impossible_sizes_have_no_kind(void **state) {
    (void)state;
    unsigned char datagram[WIRE_MOST + 1] = "TU1";
    for (int kind = 0; kind < 256; kind++) {
        datagram[3] = (unsigned char)kind;
        bool handshake = kind >= WIRE_HELLO && kind <= WIRE_REFUSED, message = kind == WIRE_TO_SERVER || kind == WIRE_TO_CLIENT;
        assert_int_equal(wire_kind_of(datagram, 76), handshake || message ? kind : 0);
        assert_int_equal(wire_kind_of(datagram, 75), message ? kind : 0);
        assert_int_equal(wire_kind_of(datagram, 44), 0);
        assert_int_equal(wire_kind_of(datagram, WIRE_MOST + 1), 0);
        assert_int_equal(wire_kind_of(datagram, 3), 0);
    }
    datagram[3] = WIRE_TO_SERVER;
    datagram[0] = 'L';
    assert_int_equal(wire_kind_of(datagram, 100), 0);
}

static void a_channel_without_end_is_refused(void **state) {
    (void)state;
    unsigned char datagram[WIRE_MOST];
    wire_message m;
    wire_key key = wire_secret_key("", 0);
    size_t size = wire_put_message(datagram, WIRE_TO_SERVER, 1, "", "", 0, &key);
    assert_true(wire_get_message(datagram, size, &m));
    memset(datagram + WIRE_HEAD + 8, 'c', sizeof datagram - WIRE_HEAD - 8);
    assert_false(wire_get_message(datagram, size, &m));
    assert_false(wire_get_message(datagram, WIRE_MOST, &m));
    datagram[WIRE_HEAD + 8 + WIRE_CHANNEL_MOST] = 0;
    assert_true(wire_get_message(datagram, WIRE_MOST, &m));
    assert_int_equal(m.size, WIRE_MESSAGE_MOST);
}

/* Compares the anti-replay window with a list of all counters, for random sequences. */
static void each_counter_is_accepted_once(void **state) {
    (void)state;
    enum { MOST = 600 };
    uint32_t random = 1;
    for (int round = 0; round < 200; round++) {
        wire_window w = {0};
        bool seen[MOST] = {0};
        uint64_t newest = 0;
        for (int i = 0; i < 400; i++) {
            random = random * 1664525u + 1013904223u;
            uint64_t low = newest > 70 ? newest - 70 : 0, counter = low + (random >> 16) % (round % 2 ? 72 : 140);
            if (counter >= MOST) continue;
            bool wanted = counter > 0 && !seen[counter] && counter + 64 > newest;
            assert_int_equal(wire_window_accepts(&w, counter), wanted);
            if (wanted) seen[counter] = true;
            if (wanted && counter > newest) newest = counter;
        }
    }
    wire_window w = {0};
    assert_true(wire_window_accepts(&w, UINT64_MAX));
    assert_false(wire_window_accepts(&w, UINT64_MAX));
    assert_true(wire_window_accepts(&w, UINT64_MAX - 63));
    assert_false(wire_window_accepts(&w, UINT64_MAX - 64));
    assert_false(wire_window_accepts(&w, 1));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(keys_agree_with_hmac_sha256),
        cmocka_unit_test(datagrams_agree_with_python),
        cmocka_unit_test(datagrams_are_read_back),
        cmocka_unit_test(impossible_sizes_have_no_kind),
        cmocka_unit_test(a_channel_without_end_is_refused),
        cmocka_unit_test(each_counter_is_accepted_once),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

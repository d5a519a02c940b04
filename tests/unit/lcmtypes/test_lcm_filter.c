/* Tests that LCM's packets are accepted, that packets that would make liblcm overrun its buffers are rejected, and that only LCM's datagrams are checked. */
#include "lcm_filter.h"

#include <arpa/inet.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static const packet_wishes anything = {0};
static const char *const poses_only[] = {"TROCAR_POSE", NULL};
static const packet_wishes poses = {.channels = poses_only, .whole_only = true};

typedef struct { unsigned char bytes[65507]; size_t size; } packet;

static void put_32(unsigned char *at, uint32_t value) {
    value = htonl(value);
    memcpy(at, &value, 4);
}

static packet whole(const char *channel, size_t message) {
    packet p = {.size = 8 + strlen(channel) + 1 + message};
    memcpy(p.bytes, "LC02", 4);
    strcpy((char *)p.bytes + 8, channel);
    return p;
}

typedef struct { uint32_t message, offset, number, count; const char *channel; size_t part; } fragment;

static packet packet_of(fragment f) {
    size_t name = f.number == 0 && f.channel ? strlen(f.channel) + 1 : 0;
    packet p = {.size = 20 + name + f.part};
    memcpy(p.bytes, "LC03", 4);
    put_32(p.bytes + 4, 7);
    put_32(p.bytes + 8, f.message);
    put_32(p.bytes + 12, f.offset);
    put_32(p.bytes + 16, f.number << 16 | f.count);
    if (name) memcpy(p.bytes + 20, f.channel, name);
    else if (f.number == 0) memset(p.bytes + 20, 'x', f.part);
    return p;
}

static void expect(packet p, const packet_wishes *wishes, packet_verdict verdict) {
    assert_int_equal(lcm_filter_judge(p.bytes, p.size, wishes), verdict);
}

static void expect_fragment(fragment f, packet_verdict verdict) { expect(packet_of(f), &anything, verdict); }

static void short_packets_need_a_terminated_channel(void **unused) {
    (void)unused;
    char longest[65];
    memset(longest, 'x', 64);
    longest[64] = '\0';
    expect(whole("TROCAR_POSE", 100), &anything, PACKET_GOOD);
    expect(whole("", 0), &anything, PACKET_GOOD);
    expect(whole(longest + 1, 0), &anything, PACKET_GOOD);
    expect(whole(longest, 0), &anything, PACKET_MALFORMED);
    packet endless = whole("TROCAR_POSE", 0);
    endless.size--;
    expect(endless, &anything, PACKET_MALFORMED);
    endless.size = 5;
    expect(endless, &anything, PACKET_MALFORMED);
}

/* Sends 150 000 bytes in three fragments, as liblcm would. */
static void fragments_of_lcm_pass(void **unused) {
    (void)unused;
    uint32_t first = 65487 - 2;
    expect_fragment((fragment){150000, 0, 0, 3, "D", first}, PACKET_GOOD);
    expect_fragment((fragment){150000, first, 1, 3, NULL, 65487}, PACKET_GOOD);
    expect_fragment((fragment){150000, first + 65487, 2, 3, NULL, 150000 - first - 65487}, PACKET_GOOD);
}

static void inconsistent_fragments_are_malformed(void **unused) {
    (void)unused;
    const char *c = "TROCAR_POSE";
    static const fragment good = {1000, 500, 1, 2, NULL, 500};
    expect_fragment(good, PACKET_GOOD);
    fragment f = good;
    f.part = 501;
    expect_fragment(f, PACKET_MALFORMED);                                        /* a fragment that extends past the end of the message */
    expect_fragment((fragment){1000, 0xffffff00, 1, 2, NULL, 0x200}, PACKET_MALFORMED); /* liblcm's sum overflows */
    expect_fragment((fragment){1000, 0xffffff00, 0, 2, c, 0x200}, PACKET_MALFORMED);
    expect_fragment((fragment){1000, 500, 2, 2, NULL, 500}, PACKET_MALFORMED);   /* third fragment of a message with two fragments */
    expect_fragment((fragment){1000, 0, 1, 2, NULL, 500}, PACKET_MALFORMED);     /* second fragment that claims offset 0 */
    expect_fragment((fragment){1000, 0, 0, 0, c, 500}, PACKET_MALFORMED);        /* first fragment of a message with no fragments */
    expect_fragment((fragment){1000, 500, 1, 2, NULL, 0}, PACKET_MALFORMED);     /* empty */
    expect_fragment((fragment){0, 0, 0, 2, c, 0}, PACKET_MALFORMED);
    expect_fragment((fragment){1000, 0, 0, 2, NULL, 200}, PACKET_MALFORMED);     /* channel name not terminated */
    expect_fragment((fragment){200000, 0, 0, 2, c, 500}, PACKET_MALFORMED);      /* too few fragments for the message's size */
    expect_fragment((fragment){1 << 28, 0, 0, 5000, c, 500}, PACKET_MALFORMED);  /* 256 MB, which liblcm would allocate */
    packet p = packet_of(good);
    for (p.size = 4; p.size <= 20; p.size++) expect(p, &anything, PACKET_MALFORMED); /* shorter than a header */
}

static void program_receives_its_channels_only(void **unused) {
    (void)unused;
    expect(whole("TROCAR_POSE", 100), &poses, PACKET_GOOD);
    expect(whole("LCM_SELF_TEST", 13), &poses, PACKET_GOOD);
    expect(whole("TROCAR_POSES", 100), &poses, PACKET_UNWANTED);
    expect(packet_of((fragment){1000, 0, 0, 2, "TROCAR_POSE", 500}), &poses, PACKET_UNWANTED);
    expect(packet_of((fragment){1000, 500, 1, 2, NULL, 500}), &poses, PACKET_UNWANTED);
}

/* Repeats the arithmetic of liblcm 1.3.1: for every accepted packet, liblcm may only copy within the packet and the message. */
static void liblcm_would_stay_within_its_buffers(const packet *p) {
    uint32_t word[5];
    memcpy(word, p->bytes, sizeof word);
    uint32_t message = ntohl(word[2]), offset = ntohl(word[3]), part = (uint32_t)p->size - 20, name = 0;
    if (ntohl(word[4]) >> 16 == 0) name = (uint32_t)strlen((const char *)p->bytes + 20) + 1; /* liblcm reads up to the next zero byte */
    assert_true(name <= 64 && 20 + name <= p->size);
    part -= name;
    assert_true(part <= p->size && (uint64_t)offset + part <= message && message <= 1 << 24);
}

static uint32_t draw(void) {
    static uint32_t state = 2463534242u; /* xorshift: Marsaglia 2003 */
    state ^= state << 13;
    state ^= state >> 17;
    return state ^= state << 5;
}

/* Returns a number close to one of the limits, or an arbitrary one. */
static uint32_t draw_number(void) {
    static const uint32_t edges[] = {0, 1, 2, 19, 20, 63, 64, 500, 1000, 65487, 1 << 24, 1 << 28, UINT32_MAX};
    uint32_t edge = edges[draw() % (sizeof edges / sizeof *edges)];
    switch (draw() % 4) {
    case 0: return draw();
    case 1: return edge + draw() % 5 - 2;
    default: return edge;
    }
}

static void random_fragments(void **unused) {
    (void)unused;
    int good = 0;
    for (int i = 0; i < 1000000; i++) {
        packet p;
        p.size = 4 + draw() % 116;
        memset(p.bytes, draw() % 2 ? 'x' : 0, 300); /* rest of the buffer, left over from a previous packet */
        p.bytes[299] = 0;
        memcpy(p.bytes, "LC03", 4);
        put_32(p.bytes + 8, draw_number());
        put_32(p.bytes + 12, draw_number());
        put_32(p.bytes + 16, (draw() % 3) << 16 | draw() % 4);
        p.bytes[20 + draw() % 100] = 0;
        if (lcm_filter_judge(p.bytes, p.size, &anything) != PACKET_GOOD) continue;
        liblcm_would_stay_within_its_buffers(&p);
        good++;
    }
    assert_true(good > 1000);
}

static int udp_pair(int *sender) {
    struct sockaddr_in here = {.sin_family = AF_INET, .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    socklen_t size = sizeof here;
    int receiver = socket(AF_INET, SOCK_DGRAM, 0);
    *sender = socket(AF_INET, SOCK_DGRAM, 0);
    assert_int_equal(bind(receiver, (struct sockaddr *)&here, sizeof here), 0);
    assert_int_equal(getsockname(receiver, (struct sockaddr *)&here, &size), 0);
    assert_int_equal(connect(*sender, (struct sockaddr *)&here, sizeof here), 0);
    return receiver;
}

static ssize_t received(int sender, int receiver, packet p) {
    unsigned char buffer[65535];
    struct iovec place = {buffer, sizeof buffer};
    struct msghdr message = {.msg_iov = &place, .msg_iovlen = 1};
    assert_int_equal(send(sender, p.bytes, p.size, 0), p.size);
    return recvmsg(receiver, &message, 0);
}

static void only_malformed_lcm_packets_are_dropped(void **unused) {
    (void)unused;
    packet good = whole("ANY", 50), bad = packet_of((fragment){1000, 0xffffff00, 1, 2, NULL, 0x200}), other = {.size = 30};
    int sender, pair[2], receiver = udp_pair(&sender);
    int64_t before = lcm_filter_dropped();
    assert_int_equal(received(sender, receiver, good), good.size);
    assert_int_equal(received(sender, receiver, other), other.size);
    assert_int_equal(received(sender, receiver, bad), 0);
    assert_int_equal(lcm_filter_dropped() - before, 1);

    assert_int_equal(socketpair(AF_UNIX, SOCK_DGRAM, 0, pair), 0); /* not UDP sockets, so not LCM's */
    assert_int_equal(received(pair[0], pair[1], bad), bad.size);

    lcm_filter_restrict(&poses);
    assert_int_equal(received(sender, receiver, good), 0);
    assert_int_equal(lcm_filter_dropped() - before, 1);
    lcm_filter_restrict(&anything);
    close(sender), close(receiver), close(pair[0]), close(pair[1]);
}

/* URLs are parsed as liblcm 1.3.1 does. */
static void urls_without_a_ttl_are_for_this_machine(void **unused) {
    (void)unused;
    static const struct { const char *url; bool local; uint16_t port; } urls[] = {
        {"udpm://239.255.76.67:7667?ttl=0", true, 7667}, {"udpm://239.255.76.67:7667", true, 7667}, {"udpm://239.255.76.67", true, 7667},
        {"udpm://", true, 7667}, {"udpm://?ttl=1", false, 7667}, {"udpm://239.255.76.67:1234?ttl=1", false, 1234},
        {"udpm://239.255.76.67:0x10?recv_buf_size=100&ttl=0x2", false, 16}, {"udpm://239.255.76.67:7668?recv_buf_size=100&ttl=0", true, 7668},
        {"udpm://239.255.76.67:7667?ttl=256", true, 7667}, {"udpm://239.255.76.67:7667?ttl=1&ttl=0", true, 7667},
        {"udpm://239.255.76.67:7667?ttl=0?ttl=3", false, 7667}, {"udpm://239.255.76.67:7667?attl=1", true, 7667},
        {"memq://", false, 0}, {"file://log", false, 0}, {"tcpq://127.0.0.1:7700", false, 0}};
    uint16_t port;
    for (size_t i = 0; i < sizeof urls / sizeof *urls; i++) {
        port = 1;
        if (lcm_filter_is_local(urls[i].url, &port) != urls[i].local || port != urls[i].port) fail_msg("%s: port %d", urls[i].url, port);
    }
    setenv("LCM_DEFAULT_URL", "udpm://239.255.76.67:7669?ttl=1", 1);
    assert_true(!lcm_filter_is_local(NULL, &port) && port == 7669 && !lcm_filter_is_local("", &port));
    unsetenv("LCM_DEFAULT_URL");
    assert_true(lcm_filter_is_local(NULL, &port) && port == 7667);
}

/* On a port that accepts only local datagrams, those from this machine pass and are not counted as coming from another. Datagrams from other machines are
   tested in tests/system/test_other_machine.sh. */
static void datagrams_of_this_machine_pass(void **unused) {
    (void)unused;
    static const packet_wishes marked = {.origin = {"TROCAR_COMMAND", "REMOTE_COMMAND"}};
    packet good = whole("TROCAR_COMMAND", 50);
    unsigned char buffer[65535];
    struct sockaddr_in own = {0}, from = {0};
    socklen_t size = sizeof own;
    char url[64], text[32] = "x";
    int sender, receiver = udp_pair(&sender);
    assert_int_equal(getsockname(receiver, (struct sockaddr *)&own, &size), 0);
    snprintf(url, sizeof url, "udpm://239.255.76.67:%d?ttl=0", ntohs(own.sin_port));
    lcm_filter_restrict(&marked);
    lcm_t *lcm = lcm_filter_create(url);
    struct iovec place = {buffer, sizeof buffer};
    struct msghdr message = {.msg_iov = &place, .msg_iovlen = 1, .msg_name = &from, .msg_namelen = sizeof from};
    assert_int_equal(send(sender, good.bytes, good.size, 0), good.size);
    assert_int_equal(recvmsg(receiver, &message, 0), good.size);
    assert_memory_equal(buffer, good.bytes, good.size);
    assert_int_equal(lcm_filter_distant(text, sizeof text), 0);
    assert_string_equal(text, "");
    if (lcm) lcm_destroy(lcm);
    lcm_filter_restrict(&anything);
    close(sender), close(receiver);
}

static void ignore(const lcm_recv_buf_t *received, const char *channel, void *context) { (void)received, (void)channel, (void)context; }

/* Returns the largest receive buffer (bytes, as the kernel counts them) of this process's UDP sockets. */
static int largest_buffer(void) {
    int most = 0;
    for (int fd = 3; fd < 256; fd++) {
        int type = 0, buffer = 0;
        socklen_t size = sizeof type;
        if (getsockopt(fd, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_DGRAM) continue;
        size = sizeof buffer;
        getsockopt(fd, SOL_SOCKET, SO_RCVBUF, &buffer, &size);
        most = buffer > most ? buffer : most;
    }
    return most;
}

/* The kernel doubles the size that a program asks for. */
static void a_wide_receive_buffer_is_as_large_as_permitted(void **unused) {
    (void)unused;
    int permitted = 0;
    FILE *limit = fopen("/proc/sys/net/core/rmem_max", "r");
    if (!limit) skip();
    assert_int_equal(fscanf(limit, "%d", &permitted), 1);
    fclose(limit);
    const int expected = permitted < 4 << 20 ? permitted : 4 << 20;
    const struct { const char *url; int buffer; } cases[] = {{"udpm://239.255.76.67:7669?ttl=0", expected}, {"udpm://239.255.76.67:7669?recv_buf_size=120000&ttl=0", 120000}};
    for (int i = 0; i < 2; i++) {
        lcm_t *lcm = lcm_filter_create_wide(cases[i].url);
        if (!lcm || !lcm_subscribe(lcm, ".*", ignore, NULL)) skip(); /* there is no multicast route */
        assert_int_equal(largest_buffer(), 2 * cases[i].buffer);
        lcm_destroy(lcm);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(short_packets_need_a_terminated_channel),
        cmocka_unit_test(fragments_of_lcm_pass),
        cmocka_unit_test(inconsistent_fragments_are_malformed),
        cmocka_unit_test(program_receives_its_channels_only),
        cmocka_unit_test(random_fragments),
        cmocka_unit_test(only_malformed_lcm_packets_are_dropped),
        cmocka_unit_test(urls_without_a_ttl_are_for_this_machine),
        cmocka_unit_test(datagrams_of_this_machine_pass),
        cmocka_unit_test(a_wide_receive_buffer_is_as_large_as_permitted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

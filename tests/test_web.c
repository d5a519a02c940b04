/* Who may open a WebSocket, what it may say, and browsers that hang. The rest of the web server is seen through a browser:
   tests/view. */
#define _GNU_SOURCE /* memmem */
#include "web.h"

#include <arpa/inet.h>
#include <errno.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static void only_pages_from_here_may_connect(void **unused) {
    (void)unused;
    static const struct { const char *origin, *host, *address, *name; bool allowed; } cases[] = {
        {"http://127.0.0.1:8686", "127.0.0.1:8686", NULL, NULL, true},
        {"http://localhost:8686", "localhost:8686", NULL, NULL, true},
        {"http://LocalHost", "localhost", NULL, NULL, true},
        {"http://[::1]:8686", "[::1]:8686", NULL, NULL, true},
        {"", "127.0.0.1:8686", NULL, NULL, false},                              /* no browser */
        {"null", "127.0.0.1:8686", NULL, NULL, false},                          /* a file, a sandboxed frame */
        {"http://evil.example", "127.0.0.1:8686", NULL, NULL, false},
        {"http://127.0.0.1:9999", "127.0.0.1:8686", NULL, NULL, false},         /* another program's page on this machine */
        {"https://127.0.0.1:8686", "127.0.0.1:8686", NULL, NULL, false},
        {"http://evil.example:8686", "evil.example:8686", NULL, NULL, false},   /* its name leads to 127.0.0.1 */
        {"http://127.0.0.1.evil.example:8686", "127.0.0.1.evil.example:8686", NULL, NULL, false},
        {"http://localhost.evil.example", "localhost.evil.example", NULL, NULL, false},
        {"http://10.0.0.5:8686", "10.0.0.5:8686", NULL, NULL, false},
        {"http://10.0.0.5:8686", "10.0.0.5:8686", "10.0.0.5", NULL, true},
        {"http://[2001:db8::5]:8686", "[2001:db8::5]:8686", "2001:db8::5", NULL, true},
        {"http://[2001:db8::5]", "[2001:db8::5]", "2001:db8::5", NULL, true},
        {"http://[2001:db8::56]:8686", "[2001:db8::56]:8686", "2001:db8::5", NULL, false},
        {"http://2001:db8::5:8686", "2001:db8::5:8686", "2001:db8::5", NULL, false},
        {"http://trainer:8686", "trainer:8686", "0.0.0.0", NULL, false},
        {"http://trainer:8686", "trainer:8686", "0.0.0.0", "trainer", true},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        if (web_origin_allowed(cases[i].origin, cases[i].host, cases[i].address, cases[i].name) != cases[i].allowed)
            fail_msg("origin \"%s\", host \"%s\"", cases[i].origin, cases[i].host);
}

static void a_page_that_is_not_built_is_said(void **unused) {
    (void)unused;
    web *w = NULL;
    report why;
    assert_int_equal(web_create(&(web_settings){.page = "/nowhere"}, &w, &why), TROCAR_BAD_INPUT);
    assert_null(w);
    assert_non_null(strstr(why.text, "/nowhere/index.html"));
}

/* Every 127.x.y.z is this machine: what listens on all addresses would answer on 127.0.0.2, too. */
static bool answers(const char *address, int port) {
    struct sockaddr_in there = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    inet_pton(AF_INET, address, &there.sin_addr);
    int s = socket(AF_INET, SOCK_STREAM, 0);
    bool connected = connect(s, (struct sockaddr *)&there, sizeof there) == 0;
    close(s);
    return connected;
}

static char folder[] = "/tmp/trocar-test-web-XXXXXX", page[64];

static int make_page(void **unused) {
    (void)unused;
    if (!mkdtemp(folder)) return -1;
    snprintf(page, sizeof page, "%s/index.html", folder);
    FILE *empty = fopen(page, "w");
    return empty ? fclose(empty) : -1;
}

static int remove_page(void **unused) {
    (void)unused;
    return remove(page) | rmdir(folder);
}

static void it_listens_on_one_address_only(void **unused) {
    (void)unused;
    static const char *const addresses[] = {NULL, "127.0.0.3"};
    for (int i = 0; i < 2; i++) {
        web *w = NULL;
        report why;
        assert_int_equal(web_create(&(web_settings){.page = folder, .address = addresses[i]}, &w, &why), TROCAR_OK);
        assert_true(answers(addresses[i] ? addresses[i] : "127.0.0.1", web_port(w)));
        assert_false(answers("127.0.0.2", web_port(w)));
        web_free(w);
    }
}

/* ---- browsers, as bytes ---- */

enum { TEXT = 1, BINARY = 2 };

typedef struct {
    int socket;
    unsigned char got[1 << 16];
    size_t length, taken;    /* bytes: received, and of frames that were looked at */
    bool open, closed;
    int updates;
} client;

typedef struct {
    web *web;
    timeline timeline;
    byte_buffer scene;
    int takes, releases;
} fixture;

static char *describe(void *context, bool drives, bool driven) {
    (void)context, (void)drives, (void)driven;
    return strdup("{}");
}

static void act(void *context, const web_action *action) {
    fixture *f = context;
    f->takes += action->kind == ACTION_TAKE;
    f->releases += action->kind == ACTION_RELEASE;
}

static void open_fixture(fixture *f, int patience) {
    report why;
    *f = (fixture){0};
    bytes_append(&f->scene, "a scene.", 8);
    assert_int_equal(timeline_create(&f->timeline, true, &why), TROCAR_OK);
    web_settings settings = {.page = folder, .timeline = &f->timeline, .scene = &f->scene, .context = f, .describe = describe,
                             .act = act, .patience = patience};
    assert_int_equal(web_create(&settings, &f->web, &why), TROCAR_OK);
}

static void close_fixture(fixture *f) {
    web_free(f->web);
    timeline_free(&f->timeline);
    bytes_free(&f->scene);
}

static void say(const client *c, int opcode, uint32_t kind, size_t length) {
    unsigned char frame[6 + 64] = {(unsigned char)(0x80 | opcode), (unsigned char)(0x80 | length)}; /* masked by zeros */
    memcpy(frame + 6, &kind, sizeof kind);
    assert_int_equal(write(c->socket, frame, 6 + length), 6 + length);
}

/* Looks at one whole frame; false when there is none. */
static bool take_frame(client *c) {
    const unsigned char *frame = c->got + c->taken;
    size_t left = c->length - c->taken, head = left >= 2 && frame[1] == 126 ? 4 : 2;
    if (left < head) return false;
    size_t length = head == 4 ? (size_t)(frame[2] << 8 | frame[3]) : frame[1];
    if (left < head + length) return false;
    c->updates += (frame[0] & 0xf) == BINARY;
    c->taken += head + length;
    return true;
}

static void take_answer(client *c) {
    const char *end = memmem(c->got, c->length, "\r\n\r\n", 4);
    if (!end) return;
    assert_memory_equal(c->got, "HTTP/1.1 101", 12);
    c->taken = (size_t)(end + 4 - (const char *)c->got);
    c->open = true;
}

/* The web's round, then the client's. */
static void go_round(fixture *f, client *clients, int count) {
    web_round(f->web);
    for (client *c = clients; c < clients + count; c++) {
        ssize_t got = read(c->socket, c->got + c->length, sizeof c->got - c->length);
        c->closed |= got == 0 || (got < 0 && errno == ECONNRESET);
        if (got > 0) c->length += (size_t)got;
        if (!c->open) take_answer(c);
        while (c->open && take_frame(c)) continue;
    }
}

static void join(fixture *f, client *c) {
    struct sockaddr_in there = {.sin_family = AF_INET, .sin_port = htons((uint16_t)web_port(f->web)), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    *c = (client){.socket = socket(AF_INET, SOCK_STREAM, 0)};
    assert_int_equal(connect(c->socket, (struct sockaddr *)&there, sizeof there), 0);
    dprintf(c->socket, "GET / HTTP/1.1\r\nHost: 127.0.0.1:%d\r\nOrigin: http://127.0.0.1:%d\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
                       "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n"
                       "Sec-WebSocket-Protocol: trocar-view\r\n\r\n", web_port(f->web), web_port(f->web));
    fcntl(c->socket, F_SETFL, O_NONBLOCK);
    while (!c->open) go_round(f, c, 1);
}

/* Answers what it has got since `seen`. */
static void acknowledge(const client *c, int *seen) {
    for (; *seen < c->updates; ++*seen) say(c, BINARY, ACTION_ACKNOWLEDGE, WEB_ACTION_BYTES);
}

static void a_browser_that_hangs_holds_up_nobody_and_loses_the_needle(void **unused) {
    (void)unused;
    fixture f;
    static client clients[2];
    client *lively = &clients[0], *hung = &clients[1];
    int answered = 0;
    open_fixture(&f, 3);
    join(&f, lively);
    join(&f, hung);
    say(hung, BINARY, ACTION_TAKE, WEB_ACTION_BYTES);
    while (f.releases == 0) {
        go_round(&f, clients, 2);
        acknowledge(lively, &answered);
    }
    assert_int_equal(f.takes, 1);
    say(lively, BINARY, ACTION_TAKE, WEB_ACTION_BYTES);
    while (lively->updates < 10) { /* one status each: more than it may be silent for */
        go_round(&f, clients, 2);
        acknowledge(lively, &answered);
    }
    assert_true(f.takes == 2 && f.releases == 1);
    assert_int_equal(hung->updates, 2);
    assert_false(hung->closed || lively->closed);
    close(lively->socket);
    while (f.releases == 1) go_round(&f, hung, 1); /* it is gone */
    close(hung->socket);
    close_fixture(&f);
}

static void what_is_no_message_of_the_page_ends_its_connection(void **unused) {
    (void)unused;
    static const struct { int opcode; uint32_t kind; size_t length; } wrong[] = {
        {BINARY, ACTION_ACKNOWLEDGE, 31}, {BINARY, ACTION_ACKNOWLEDGE, 33}, {TEXT, ACTION_ACKNOWLEDGE, 32},
        {BINARY, 0, 32}, {BINARY, ACTION_PICTURE, 32}, {BINARY, ACTION_PICTURE + 1, 32}, {BINARY, ACTION_ACKNOWLEDGE, 0}};
    fixture f;
    static client c;
    open_fixture(&f, 0);
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        join(&f, &c);
        say(&c, wrong[i].opcode, wrong[i].kind, wrong[i].length);
        while (!c.closed) go_round(&f, &c, 1);
        close(c.socket);
    }
    close_fixture(&f);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(only_pages_from_here_may_connect),
        cmocka_unit_test(it_listens_on_one_address_only),
        cmocka_unit_test(a_page_that_is_not_built_is_said),
        cmocka_unit_test(a_browser_that_hangs_holds_up_nobody_and_loses_the_needle),
        cmocka_unit_test(what_is_no_message_of_the_page_ends_its_connection),
    };
    return cmocka_run_group_tests(tests, make_page, remove_page);
}

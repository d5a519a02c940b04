/* Tests who may access the WebSocket, its messages, and browsers that hang. The rest of the web server is tested with a browser, in tests/view. */
#define _GNU_SOURCE /* memmem */
#include "view/web/web.h"

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

static void only_own_pages_may_connect(void **unused) {
    (void)unused;
    static const struct { const char *origin, *host, *address, *name; bool allowed; } cases[] = {
        {"http://127.0.0.1:8686", "127.0.0.1:8686", NULL, NULL, true},
        {"http://localhost:8686", "localhost:8686", NULL, NULL, true},
        {"http://LocalHost", "localhost", NULL, NULL, true},
        {"http://[::1]:8686", "[::1]:8686", NULL, NULL, true},
        {"", "127.0.0.1:8686", NULL, NULL, false},                              /* not a browser */
        {"null", "127.0.0.1:8686", NULL, NULL, false},                          /* the origin of a local file or a sandboxed frame */
        {"http://evil.example", "127.0.0.1:8686", NULL, NULL, false},
        {"http://127.0.0.1:9999", "127.0.0.1:8686", NULL, NULL, false},         /* another program's page on this machine */
        {"https://127.0.0.1:8686", "127.0.0.1:8686", NULL, NULL, false},
        {"http://evil.example:8686", "evil.example:8686", NULL, NULL, false},   /* a host name that resolves to 127.0.0.1 */
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

static void missing_page_is_reported(void **unused) {
    (void)unused;
    web *w = NULL;
    trocar_error why;
    assert_int_equal(web_create(&(web_settings){.page = "/nowhere"}, &w, &why), TROCAR_BAD_INPUT);
    assert_null(w);
    assert_non_null(strstr(why.text, "/nowhere/index.html"));
}

/* Returns whether the address answers. Every address 127.x.y.z refers to this machine, so a server listening on all addresses would also answer on
   127.0.0.2. */
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

static void listens_on_one_address_only(void **unused) {
    (void)unused;
    static const char *const addresses[] = {NULL, "127.0.0.3"};
    for (int i = 0; i < 2; i++) {
        web *w = NULL;
        trocar_error why;
        assert_int_equal(web_create(&(web_settings){.page = folder, .address = addresses[i]}, &w, &why), TROCAR_OK);
        assert_true(answers(addresses[i] ? addresses[i] : "127.0.0.1", web_port(w)));
        assert_false(answers("127.0.0.2", web_port(w)));
        web_free(w);
    }
}

/* ---- browsers, as bytes ---- */

enum { TEXT = 1, BINARY = 2, CLOSE = 8 };

typedef struct {
    int socket;
    unsigned char got[1 << 16];
    size_t length, taken;    /* bytes received, and bytes in frames already parsed */
    bool open, closed;
    int answer;              /* HTTP status, or 0 if it has not arrived yet */
    int updates;
    int end;                 /* status code of the WebSocket's close frame, or 0 if there is none */
    char reason[126];
} client;

typedef struct {
    web *web;
    timeline timeline;
    byte_buffer scene;
    web_section images;
    int takes, releases, leaves, removals;
    bool no_server;          /* if set, no server is heard, so driving is not allowed */
    web_page pages[WEB_BROWSERS + 1]; /* the newest description of each browser, by its number */
    int described[WEB_BROWSERS + 1];  /* how often each browser was described */
} fixture;

static char *describe(void *context, const web_page *page) {
    fixture *f = context;
    assert_in_range(page->number, 1, WEB_BROWSERS);
    f->pages[page->number] = *page;
    f->described[page->number]++;
    return strdup("{}");
}

static void act(void *context, const web_action *action) {
    fixture *f = context;
    f->takes += action->kind == ACTION_TAKE;
    f->releases += action->kind == ACTION_RELEASE;
    f->leaves += action->kind == ACTION_LEAVE;
    f->removals += action->kind == ACTION_REMOVE;
}

static bool may_drive(void *context, uint32_t needle) { return needle == 0 && !((fixture *)context)->no_server; }

static void open_fixture(fixture *f, int patience) {
    trocar_error why;
    *f = (fixture){0};
    bytes_append(&f->scene, "a scene.", 8);
    assert_int_equal(timeline_create(&f->timeline, true, 1, &why), TROCAR_OK);
    web_settings settings = {.page = folder, .timeline = &f->timeline, .scene = &f->scene, .sections = {&f->images}, .section_count = 1, .context = f, .describe = describe,
                             .act = act, .may_drive = may_drive, .patience = patience};
    assert_int_equal(web_create(&settings, &f->web, &why), TROCAR_OK);
}

static void close_fixture(fixture *f) {
    web_free(f->web);
    timeline_free(&f->timeline);
    bytes_free(&f->scene);
    bytes_free(&f->images.bytes);
}

static void say(const client *c, int opcode, uint32_t kind, size_t length) {
    unsigned char frame[6 + 64] = {(unsigned char)(0x80 | opcode), (unsigned char)(0x80 | length)}; /* masked with zeros */
    memcpy(frame + 6, &kind, sizeof kind);
    assert_int_equal(write(c->socket, frame, 6 + length), 6 + length);
}

/* Parses one complete frame. Returns false if there is none. */
static bool take_frame(client *c) {
    const unsigned char *frame = c->got + c->taken;
    size_t left = c->length - c->taken, head = left >= 2 && frame[1] == 126 ? 4 : 2;
    if (left < head) return false;
    size_t length = head == 4 ? (size_t)(frame[2] << 8 | frame[3]) : frame[1];
    if (left < head + length) return false;
    c->updates += (frame[0] & 0xf) == BINARY;
    if ((frame[0] & 0xf) == CLOSE && length >= 2) {
        c->end = frame[head] << 8 | frame[head + 1];
        memcpy(c->reason, frame + head + 2, length - 2);
    }
    c->taken += head + length;
    return true;
}

static void take_answer(client *c) {
    const char *end = memmem(c->got, c->length, "\r\n\r\n", 4);
    if (!end) return;
    c->answer = atoi((const char *)c->got + strlen("HTTP/1.1 "));
    c->taken = (size_t)(end + 4 - (const char *)c->got);
    c->open = c->answer == 101;
}

/* Runs one round of the web server, then one of each client. */
static void go_round(fixture *f, client *clients, int count) {
    web_round(f->web);
    for (client *c = clients; c < clients + count; c++) {
        ssize_t got = read(c->socket, c->got + c->length, sizeof c->got - c->length);
        c->closed |= got == 0 || (got < 0 && errno == ECONNRESET);
        if (got > 0) c->length += (size_t)got;
        if (c->answer == 0) take_answer(c);
        while (c->open && take_frame(c)) continue;
    }
}

/* Connects without sending anything. */
static void connect_client(fixture *f, client *c) {
    struct sockaddr_in there = {.sin_family = AF_INET, .sin_port = htons((uint16_t)web_port(f->web)), .sin_addr.s_addr = htonl(INADDR_LOOPBACK)};
    *c = (client){.socket = socket(AF_INET, SOCK_STREAM, 0)};
    assert_int_equal(connect(c->socket, (struct sockaddr *)&there, sizeof there), 0);
    fcntl(c->socket, F_SETFL, O_NONBLOCK);
}

/* Sends a request and waits for the head of the response. `origin` may be NULL. `protocol` is NULL for plain HTTP and "" for a WebSocket without a protocol. */
static void request(fixture *f, client *c, const char *host, const char *origin, const char *protocol) {
    connect_client(f, c);
    dprintf(c->socket, "GET / HTTP/1.1\r\nHost: %s:%d\r\n", host, web_port(f->web));
    if (origin) dprintf(c->socket, "Origin: http://%s:%d\r\n", origin, web_port(f->web));
    if (protocol) dprintf(c->socket, "Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
                                     "Sec-WebSocket-Version: 13\r\n");
    if (protocol && *protocol) dprintf(c->socket, "Sec-WebSocket-Protocol: %s\r\n", protocol);
    dprintf(c->socket, "\r\n");
    while (c->answer == 0 && !c->closed) go_round(f, c, 1);
}

static void join(fixture *f, client *c) {
    request(f, c, "127.0.0.1", "127.0.0.1", "trocar-view");
    assert_int_equal(c->answer, 101);
}

/* Acknowledges all updates received since `seen`. */
static void acknowledge(const client *c, int *seen) {
    for (; *seen < c->updates; ++*seen) say(c, BINARY, ACTION_ACKNOWLEDGE, WEB_ACTION_BYTES);
}

static void hanging_browser_delays_nobody_and_is_disconnected(void **unused) {
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
    while (lively->updates < 10) { /* each update has one status; ten updates take longer than the permitted silence */
        go_round(&f, clients, 2);
        acknowledge(lively, &answered);
    }
    assert_true(f.takes == 2 && f.releases == 1);
    assert_int_equal(hung->updates, 2);
    assert_true(hung->closed && !lively->closed);
    close(lively->socket);
    while (f.releases == 1) go_round(&f, NULL, 0); /* until the client is disconnected */
    close(hung->socket);
    close_fixture(&f);
}

/* While a browser is connected, a section counts as delivered only once it has been handed over for sending, which waits until the browser has acknowledged
   earlier images. */
static void delivery_waits_for_a_browser(void **unused) {
    (void)unused;
    fixture f;
    static client c;
    int answered = 0;
    open_fixture(&f, 0);
    assert_true(web_delivered(f.web, &f.images));
    f.images.version++;
    assert_true(web_delivered(f.web, &f.images)); /* delivered, because there is no browser to send it to */
    join(&f, &c);
    bytes_append(&f.images.bytes, "an image", 8);
    for (int i = 0; i < 4; i++) { /* afterwards, the browser has as many unacknowledged updates as permitted */
        f.images.version++;
        web_news(f.web);
        go_round(&f, &c, 1);
    }
    assert_false(web_delivered(f.web, &f.images));
    while (!web_delivered(f.web, &f.images)) acknowledge(&c, &answered), go_round(&f, &c, 1);
    assert_true(answered > 0);
    close(c.socket);
    close_fixture(&f);
}

/* Without a server, no browser can take the needle. When the server disappears, the needle is released, and the driver must take it again later. */
static void needle_is_released_when_driving_is_not_allowed(void **unused) {
    (void)unused;
    fixture f;
    static client c;
    int answered = 0;
    open_fixture(&f, 0);
    f.no_server = true;
    join(&f, &c);
    say(&c, BINARY, ACTION_TAKE, WEB_ACTION_BYTES);
    while (c.updates < 3) go_round(&f, &c, 1), acknowledge(&c, &answered);
    assert_int_equal(f.takes, 0);
    f.no_server = false;
    say(&c, BINARY, ACTION_TAKE, WEB_ACTION_BYTES);
    while (f.takes == 0) go_round(&f, &c, 1);
    f.no_server = true;
    while (f.releases == 0) go_round(&f, &c, 1), acknowledge(&c, &answered);
    f.no_server = false;
    int updates = c.updates;
    while (c.updates < updates + 3) go_round(&f, &c, 1), acknowledge(&c, &answered);
    assert_true(f.takes == 1 && f.releases == 1);
    close(c.socket);
    close_fixture(&f);
}

/* Only the driver can release its needle and pull out others. While nobody drives, any browser can pull needles out. */
static void only_the_driver_handles_needles(void **unused) {
    (void)unused;
    fixture f;
    static client clients[2];
    client *driver = &clients[0], *other = &clients[1];
    open_fixture(&f, 0);
    join(&f, driver);
    join(&f, other);
    say(other, BINARY, ACTION_REMOVE, WEB_ACTION_BYTES);
    while (f.removals == 0) go_round(&f, clients, 2);
    say(driver, BINARY, ACTION_TAKE, WEB_ACTION_BYTES);
    while (f.takes == 0) go_round(&f, clients, 2);
    say(other, BINARY, ACTION_LEAVE, WEB_ACTION_BYTES);
    say(other, BINARY, ACTION_REMOVE, WEB_ACTION_BYTES);
    for (int i = 0; i < 5; i++) go_round(&f, clients, 2);
    assert_true(f.leaves == 0 && f.removals == 1);
    say(driver, BINARY, ACTION_LEAVE, WEB_ACTION_BYTES);
    say(driver, BINARY, ACTION_REMOVE, WEB_ACTION_BYTES);
    while (f.leaves == 0 || f.removals == 1) go_round(&f, clients, 2);
    assert_true(f.leaves == 1 && f.removals == 2);
    for (int i = 0; i < 2; i++) close(clients[i].socket);
    close_fixture(&f);
}

/* Each browser has a number of its own, which is freed when it disconnects, and is told the number of the browser that drives. */
static void browsers_are_numbered(void **unused) {
    (void)unused;
    fixture f;
    static client clients[4];
    int answered[4] = {0};
    open_fixture(&f, 0);
    for (int i = 0; i < 3; i++) {
        join(&f, &clients[i]);
        while (f.described[i + 1] == 0) go_round(&f, clients, 3);
    }
    say(&clients[2], BINARY, ACTION_TAKE, WEB_ACTION_BYTES);
    while (f.pages[1].driver == 0 || f.pages[2].driver == 0 || f.pages[3].driver == 0) {
        go_round(&f, clients, 3);
        for (int i = 0; i < 3; i++) acknowledge(&clients[i], &answered[i]);
    }
    for (int i = 1; i <= 3; i++) assert_true(f.pages[i].number == i && f.pages[i].count == 3 && f.pages[i].driver == 3);
    close(clients[1].socket);
    while (f.pages[1].count == 3) go_round(&f, clients, 1), acknowledge(&clients[0], &answered[0]);
    f.described[2] = 0;
    join(&f, &clients[3]);
    while (f.described[2] == 0) go_round(&f, &clients[3], 1), acknowledge(&clients[3], &answered[3]);
    assert_int_equal(f.described[4], 0);
    assert_int_equal(f.pages[2].driver, 3);
    for (int i = 0; i < 4; i++)
        if (i != 1) close(clients[i].socket);
    close_fixture(&f);
}

/* Silent browsers take up all connections. The next browser is refused with a message, and is accepted once they have timed out. Sockets that never send a
   request block no browser. */
static void idle_connections_do_not_block_others(void **unused) {
    (void)unused;
    enum { IDLE = 300 };
    fixture f;
    static client silent[WEB_BROWSERS], idle[IDLE], late;
    int answered = 0;
    open_fixture(&f, 10);
    for (int i = 0; i < IDLE; i++) connect_client(&f, &idle[i]);
    for (int i = 0; i < WEB_BROWSERS; i++) join(&f, &silent[i]);
    join(&f, &late);
    while (late.end == 0) go_round(&f, &late, 1);
    assert_int_equal(late.end, 1013);
    assert_string_equal(late.reason, "16 browsers are connected already: close one of them.");
    assert_int_equal(late.updates, 0);
    close(late.socket);
    while (!silent[0].closed) go_round(&f, silent, WEB_BROWSERS);
    join(&f, &late);
    while (late.updates < 3) go_round(&f, &late, 1), acknowledge(&late, &answered);
    assert_int_equal(late.end, 0);
    for (int i = 0; i < WEB_BROWSERS; i++) close(silent[i].socket);
    for (int i = 0; i < IDLE; i++) close(idle[i].socket);
    close(late.socket);
    close_fixture(&f);
}

/* A page from another site may request any protocol or none, and is refused. */
static void other_sites_are_refused_on_every_protocol(void **unused) {
    (void)unused;
    static const char *const protocols[] = {"trocar-view", "http", "descriptor", "", "none", NULL};
    fixture f;
    static client c;
    open_fixture(&f, 0);
    for (size_t i = 0; i < sizeof protocols / sizeof *protocols; i++)
        for (int renamed = 0; renamed < 2; renamed++) { /* in the second case, the host name, too, is the other site's, resolving to 127.0.0.1 */
            request(&f, &c, renamed ? "evil.example" : "127.0.0.1", "evil.example", protocols[i]);
            if (c.answer != 403 && !(c.answer == 0 && c.closed))
                fail_msg("protocol %s: %d", protocols[i] ? protocols[i] : "(no WebSocket)", c.answer);
            close(c.socket);
        }
    request(&f, &c, "evil.example", NULL, NULL);
    assert_int_equal(c.answer, 403);
    while (!c.closed) go_round(&f, &c, 1);
    assert_non_null(memmem(c.got, c.length, "with this name as --host", 24)); /* the message says what to do */
    close(c.socket);
    request(&f, &c, "127.0.0.1", NULL, NULL);
    assert_int_equal(c.answer, 200);
    close(c.socket);
    for (size_t i = 1; i < 5; i++) {
        request(&f, &c, "127.0.0.1", "127.0.0.1", protocols[i]);
        assert_int_not_equal(c.answer, 101);
        close(c.socket);
    }
    close_fixture(&f);
}

static void invalid_message_closes_the_connection(void **unused) {
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
        cmocka_unit_test(only_own_pages_may_connect),
        cmocka_unit_test(listens_on_one_address_only),
        cmocka_unit_test(missing_page_is_reported),
        cmocka_unit_test(hanging_browser_delays_nobody_and_is_disconnected),
        cmocka_unit_test(delivery_waits_for_a_browser),
        cmocka_unit_test(needle_is_released_when_driving_is_not_allowed),
        cmocka_unit_test(only_the_driver_handles_needles),
        cmocka_unit_test(browsers_are_numbered),
        cmocka_unit_test(idle_connections_do_not_block_others),
        cmocka_unit_test(other_sites_are_refused_on_every_protocol),
        cmocka_unit_test(invalid_message_closes_the_connection),
    };
    return cmocka_run_group_tests(tests, make_page, remove_page);
}

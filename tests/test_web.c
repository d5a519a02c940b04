/* Whose page may open a WebSocket. The rest of the web server is seen through a browser: tests/view. */
#include "web.h"

#include <arpa/inet.h>
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

static void it_listens_on_one_address_only(void **unused) {
    (void)unused;
    char folder[] = "/tmp/trocar-test-web-XXXXXX", index[64];
    assert_non_null(mkdtemp(folder));
    snprintf(index, sizeof index, "%s/index.html", folder);
    fclose(fopen(index, "w"));
    static const char *const addresses[] = {NULL, "127.0.0.3"};
    for (int i = 0; i < 2; i++) {
        web *w = NULL;
        report why;
        assert_int_equal(web_create(&(web_settings){.page = folder, .address = addresses[i]}, &w, &why), TROCAR_OK);
        assert_true(answers(addresses[i] ? addresses[i] : "127.0.0.1", web_port(w)));
        assert_false(answers("127.0.0.2", web_port(w)));
        web_free(w);
    }
    remove(index);
    rmdir(folder);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(only_pages_from_here_may_connect),
        cmocka_unit_test(it_listens_on_one_address_only),
        cmocka_unit_test(a_page_that_is_not_built_is_said),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

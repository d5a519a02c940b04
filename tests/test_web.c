/* Whose page may open a WebSocket. The rest of the web server is seen through a browser: tests/view. */
#include "web.h"

#include <string.h>

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

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(only_pages_from_here_may_connect),
        cmocka_unit_test(a_page_that_is_not_built_is_said),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

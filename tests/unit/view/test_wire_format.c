/* Tests that buffers that run out of memory report this, keep their data and stay usable. The encoding is tested through its readers, in test_timeline.c and
   tests/view. */
#include "view/stream/wire_format.h"

#include <string.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

const char *__asan_default_options(void);
const char *__asan_default_options(void) { return "allocator_may_return_null=1"; } /* makes malloc return NULL, as it does without the sanitizer */

static const char text[] = "0123456789abcdef";

static void a_buffer_grows(void **unused) {
    (void)unused;
    byte_buffer b = {0};
    for (int i = 0; i < 1000; i++) bytes_append(&b, text, 16);
    assert_int_equal(b.length, 16000);
    for (size_t i = 0; i < b.length; i += 16) assert_memory_equal(b.data + i, text, 16);
    bytes_free(&b);
}

/* A failed append must leave the buffer's data intact. */
static void buffer_without_memory_keeps_its_data(void **unused) {
    (void)unused;
    static const size_t impossible[] = {SIZE_MAX, SIZE_MAX / 2, SIZE_MAX / 4}; /* no machine has this much memory, so the data are never read */
    static const char more[1 << 16];
    for (size_t i = 0; i < sizeof impossible / sizeof *impossible; i++) {
        byte_buffer b = {0};
        bytes_append(&b, text, 16);
        bytes_append(&b, text, impossible[i]);
        assert_true(b.failed);
        const unsigned char *data = b.data;
        bytes_append(&b, more, sizeof more);
        bytes_append(&b, text, 1);
        assert_true(b.failed && b.length == 16 && b.data == data);
        assert_memory_equal(b.data, text, 16);
        bytes_clear(&b);
        bytes_append(&b, more, sizeof more);
        assert_true(!b.failed && b.length == sizeof more);
        bytes_free(&b);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_buffer_grows),
        cmocka_unit_test(buffer_without_memory_keeps_its_data),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

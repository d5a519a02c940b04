/* Tests which addresses and secret files the server accepts for unicast. */
#include <arpa/inet.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include "unicast/settings.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static char file[] = "/tmp/secret-XXXXXX";

static int make_file(void **state) {
    (void)state;
    int descriptor = mkstemp(file);
    return descriptor < 0 ? -1 : close(descriptor);
}

static int remove_file(void **state) {
    (void)state;
    return unlink(file);
}

static void addresses_are_read(void **state) {
    (void)state;
    struct sockaddr_in a;
    trocar_error why;
    assert_int_equal(settings_address("127.0.0.1:7668", &a, &why), TROCAR_OK);
    assert_int_equal(ntohl(a.sin_addr.s_addr), INADDR_LOOPBACK);
    assert_int_equal(ntohs(a.sin_port), 7668);
    assert_int_equal(settings_address(":1", &a, &why), TROCAR_OK);
    assert_int_equal(a.sin_addr.s_addr, htonl(INADDR_ANY));
    static const char *const bad[] = {"", ":", "7668", "127.0.0.1", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:65536", "127.0.0.1:1x", "127.0.0.1.2:1", "[::1]:1"};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) assert_int_equal(settings_address(bad[i], &a, &why), TROCAR_BAD_INPUT);
}

static void write_secret(const char *text, size_t size, mode_t mode) {
    FILE *f = fopen(file, "w");
    assert_non_null(f);
    assert_int_equal(fwrite(text, 1, size, f), size);
    fclose(f);
    assert_int_equal(chmod(file, mode), 0);
}

static void a_secret_is_needed_unless_only_this_machine_is_served(void **state) {
    (void)state;
    struct sockaddr_in local = {.sin_family = AF_INET, .sin_addr = {htonl(INADDR_LOOPBACK + 5)}}, any = {.sin_family = AF_INET};
    wire_key key, none = wire_secret_key("", 0);
    trocar_error why;
    assert_int_equal(settings_secret(NULL, &local, &key, &why), TROCAR_OK);
    assert_memory_equal(&key, &none, sizeof key);
    assert_int_equal(settings_secret(NULL, &any, &key, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "--secret-file"));
    assert_int_equal(settings_secret("/nowhere/secret", &local, &key, &why), TROCAR_BAD_INPUT);
    assert_int_equal(settings_secret("/dev/zero", &local, &key, &why), TROCAR_BAD_INPUT);
}

static void secrets_are_long_and_private(void **state) {
    (void)state;
    struct sockaddr_in any = {.sin_family = AF_INET};
    char text[1100];
    wire_key key, wanted;
    trocar_error why;
    memset(text, 's', sizeof text);
    wanted = wire_secret_key(text, 32);
    memcpy(text + 32, "\r\n\n", 3); /* line endings are not part of the secret */
    write_secret(text, 35, 0600);
    assert_int_equal(settings_secret(file, &any, &key, &why), TROCAR_OK);
    assert_memory_equal(&key, &wanted, sizeof key);
    write_secret(text, 35, 0400);
    assert_int_equal(settings_secret(file, &any, &key, &why), TROCAR_OK);
    for (int bit = 0; bit < 6; bit++) {
        struct stat s;
        write_secret(text, 35, (mode_t)(0600 | 1 << bit));
        assert_int_equal(stat(file, &s), 0);
        bool credential = 1 << bit == S_IRGRP && s.st_uid == 0 && s.st_gid == 0;
        assert_int_equal(settings_secret(file, &any, &key, &why), credential ? TROCAR_OK : TROCAR_BAD_INPUT);
        if (!credential) assert_non_null(strstr(why.text, "chmod 600"));
        chmod(file, 0600);
    }
    memset(text, 's', sizeof text);
    for (size_t size = 0; size <= sizeof text; size += size < 33 ? 1 : 1 + size / 3) {
        write_secret(text, size, 0600);
        assert_int_equal(settings_secret(file, &any, &key, &why), size >= 32 && size <= 1024 ? TROCAR_OK : TROCAR_BAD_INPUT);
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(addresses_are_read),
        cmocka_unit_test(a_secret_is_needed_unless_only_this_machine_is_served),
        cmocka_unit_test(secrets_are_long_and_private),
    };
    return cmocka_run_group_tests(tests, make_file, remove_file);
}

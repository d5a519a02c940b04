/* Tests the complete server in this process, over memq: it starts, reports that it is listening, stops for every possible reason, and refuses bad input. */
#define _GNU_SOURCE
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <sys/mman.h>
#include <unistd.h>

#include "common/eventfd_signal.h"
#include "exchange.h"
#include "privileges.h"
#include "server.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

static int stop = -1;
static int readies;

static void on_ready(void) {
    readies++;
    usleep(500000); /* let it run */
    eventfd_signal(stop);
}

static server_options options(void) {
    return (server_options){.scene_path = MESHES "/figure8.yaml", .lcm_url = "memq://", .allow_non_rt = true};
}

static char *described(const server *s, void (*describe)(const server *, FILE *)) {
    char *text = NULL;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    describe(s, out);
    fclose(out);
    return text;
}

static void runs_and_stops_on_request(void **unused) {
    (void)unused;
    server_options o = options();
    server *s;
    trocar_error why = {""};
    readies = 0;
    stop = eventfd(0, EFD_NONBLOCK);
    assert_int_equal(server_create(&o, &s, &why), TROCAR_OK);
    assert_int_equal(sched_getscheduler(0), SCHED_OTHER); /* SCHED_RESET_ON_FORK, which would reset its threads' nice values, is not set */
    char *before = described(s, server_describe);
    assert_non_null(strstr(before, "figure8.yaml"));
    assert_non_null(strstr(before, "1000 Hz"));
    free(before);

    assert_int_equal(server_run(s, stop, on_ready, &why), TROCAR_OK);
    assert_int_equal(readies, 1);
    char *after = described(s, server_summarise);
    long long ticks = 0;
    assert_int_equal(sscanf(after, "ticks %lld", &ticks), 1);
    assert_in_range(ticks, 100, 1500); /* about half a second at 1 kHz */
    free(after);
    server_free(s);
    close(stop);
}

static void the_rate_can_be_replaced(void **unused) {
    (void)unused;
    server_options o = options();
    server *s;
    trocar_error why;
    o.rate_hz = 250;
    assert_int_equal(server_create(&o, &s, &why), TROCAR_OK);
    char *text = described(s, server_describe);
    assert_non_null(strstr(text, "250 Hz"));
    free(text);
    server_free(s);
    o.rate_hz = 100;
    assert_int_equal(server_create(&o, &s, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "100 Hz"));
}

static void bad_input_is_reported_and_nothing_starts(void **unused) {
    (void)unused;
    server_options o = options();
    server *s;
    trocar_error why;
    o.scene_path = "no-such-scene.yaml";
    assert_int_equal(server_create(&o, &s, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "no-such-scene.yaml"));

    o = options();
    o.lcm_url = "nonsense://";
    assert_int_equal(server_create(&o, &s, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "nonsense://"));
}

static void *create_as_a_service(void *complaint) {
    server_options o = options();
    server *s;
    trocar_error why;
    o.allow_non_rt = false;
    if (!become_a_service()) return NULL;
    if (server_create(&o, &s, &why) != TROCAR_OK) return strcpy(complaint, why.text);
    char *text = described(s, server_describe);
    strcpy(complaint, strstr(text, "real time  yes") != NULL ? "" : text);
    free(text);
    server_free(s);
    munlockall();
    return complaint;
}

static void unprivileged_service_gets_real_time(void **unused) {
    (void)unused;
    pthread_t thread;
    void *tried;
    char complaint[4096] = "";
    pthread_create(&thread, NULL, create_as_a_service, complaint);
    pthread_join(thread, &tried);
    if (tried == NULL) skip();
    assert_string_equal(complaint, "");
}

static void *create_without_permission(void *why) {
    server *s;
    server_options o = options();
    o.scene_path = "scene-without-mesh.yaml";
    if (!lose_realtime()) return "real time is permitted";
    o.allow_non_rt = false;
    if (server_create(&o, &s, why) != TROCAR_NO_REALTIME) return "not refused for lack of permission";
    o.allow_non_rt = true;
    bool refused = server_create(&o, &s, why) == TROCAR_BAD_INPUT && strstr(((trocar_error *)why)->text, "no-such.msh") != NULL;
    return refused ? NULL : "the missing mesh is not reported";
}

/* A supervisor may restart such a server many times. It must therefore refuse to start before reading the mesh, which does not exist here. */
static void missing_permission_is_reported_before_reading_the_mesh(void **unused) {
    (void)unused;
    pthread_t thread;
    void *wrong;
    trocar_error why;
    FILE *from = fopen(MESHES "/figure8.yaml", "r"), *scene = fopen("scene-without-mesh.yaml", "w");
    for (char line[256]; fgets(line, sizeof line, from) != NULL;) fputs(strncmp(line, "mesh:", 5) == 0 ? "mesh: no-such.msh\n" : line, scene);
    fclose(from);
    fclose(scene);
    pthread_create(&thread, NULL, create_without_permission, &why);
    pthread_join(thread, &wrong);
    unlink("scene-without-mesh.yaml");
    if (wrong != NULL) fail_msg("%s: %s", (char *)wrong, why.text);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(runs_and_stops_on_request),
        cmocka_unit_test(the_rate_can_be_replaced),
        cmocka_unit_test(bad_input_is_reported_and_nothing_starts),
        cmocka_unit_test(unprivileged_service_gets_real_time),
        cmocka_unit_test(missing_permission_is_reported_before_reading_the_mesh), /* must come last, because it lowers a limit for good */
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

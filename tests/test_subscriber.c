/* Valid messages reach the timeline; invalid ones are counted. */
#include "subscriber.h"

#include <stdlib.h>
#include <string.h>

#include "viewer_messages.h"
#include "timing.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"
#include "host.h"

typedef struct {
    host host;
    viewer_messages sight;
    timeline timeline;
    subscriber feed;
    lcm_t *lcm;
} fixture;

static int open_fixture(void **state) {
    fixture *f = *state = calloc(1, sizeof *f);
    report why = {""};
    trocar_pose base = {{0.005, 0.003, -0.15}, {1, 0, 0, 0}};
    f->host = host_open(MESHES "/figure8.yaml");
    trocar_sim_reset(f->host.sim, 0, &base, NULL);
    f->lcm = lcm_create("memq://");
    if (viewer_messages_create(&f->sight, f->host.model, &why) != TROCAR_OK
        || timeline_create(&f->timeline, true, &why) != TROCAR_OK
        || subscriber_open(&f->feed, f->lcm, trocar_model_node_count(f->host.model), 1000, &f->timeline, &why) != TROCAR_OK) {
        print_error("%s\n", why.text);
        return -1;
    }
    trocar_sim_take_picture(f->host.sim, f->sight.picture);
    viewer_messages_make_needle(&f->sight, 0, 77, 5000);
    assert_int_equal(viewer_messages_make_tissue(&f->sight, 77, &why), TROCAR_OK);
    return 0;
}

static int close_fixture(void **state) {
    fixture *f = *state;
    lcm_destroy(f->lcm);
    subscriber_close(&f->feed);
    timeline_free(&f->timeline);
    viewer_messages_free(&f->sight);
    host_close(&f->host);
    free(f);
    return 0;
}

static void handle_all(fixture *f) {
    while (lcm_handle_timeout(f->lcm, 0) > 0) continue;
}

static void picture_needs_both_messages_of_its_tick(void **state) {
    fixture *f = *state;
    trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
    handle_all(f);
    assert_int_equal(f->timeline.picture_end, 0);
    f->sight.deformation.tick = 76;
    trocar_deformation_t_publish(f->lcm, "TROCAR_DEFORMATION", &f->sight.deformation);
    handle_all(f);
    assert_int_equal(f->timeline.picture_end, 0);
    f->sight.deformation.tick = 77;
    trocar_deformation_t_publish(f->lcm, "TROCAR_DEFORMATION", &f->sight.deformation);
    handle_all(f);
    assert_int_equal(f->timeline.picture_end, 1);
    assert_int_equal(f->feed.refused, 0);
}

static void a_server_is_alive_while_it_sends(void **state) {
    fixture *f = *state;
    pose base;
    assert_false(subscriber_alive(&f->feed) || subscriber_base(&f->feed, &base));
    trocar_needle_wrench_t w = {.tick = 77, .force = {0, 0, -1}};
    trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &w);
    trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
    handle_all(f);
    assert_true(subscriber_alive(&f->feed) && subscriber_base(&f->feed, &base));
    assert_close_vector(base.position, v3(0.005, 0.003, -0.15), 0);
}

static void hear_wrench(fixture *f, int64_t server, int64_t tick) {
    trocar_needle_wrench_t w = {.server = server, .tick = tick};
    trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &w);
    handle_all(f);
}

static void a_server_is_gone_half_a_second_after_its_last_wrench(void **state) {
    fixture *f = *state;
    hear_wrench(f, 1, 77);
    sleep_until(f->feed.heard + 400000000);
    assert_true(subscriber_alive(&f->feed));
    sleep_until(f->feed.heard + 500000000);
    assert_false(subscriber_alive(&f->feed));
}

/* Data of the previous server is dropped: its needle may be deep while the new one's is outside. */
static void change_of_server_is_detected(void **state) {
    fixture *f = *state;
    pose base;
    trocar_status_t said = {.server = 1, .owner = 5, .host = "", .scene = "old", .inverse = "", .message = ""};
    hear_wrench(f, 1, 90000);
    f->sight.contacts.server = 1;
    trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
    trocar_status_t_publish(f->lcm, "TROCAR_STATUS", &said);
    handle_all(f);
    hear_wrench(f, 1, 90002);
    hear_wrench(f, 1, 90001); /* delayed in the network */
    assert_true(f->feed.servers == 1 && f->feed.status && subscriber_base(&f->feed, &base));
    sleep_until(f->feed.heard + 500000001);
    hear_wrench(f, 2, 3);
    assert_true(f->feed.servers == 2 && !f->feed.status && !subscriber_base(&f->feed, &base));
}

static void first_of_two_servers_is_followed(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t first = {.server = 1, .depth = 1}, second = {.server = 2, .depth = 2};
    trocar_loop_timing_t timing = {.server = 2, .rate_hz = 500};
    trocar_status_t status = {.server = 2, .host = "", .scene = "", .inverse = "", .message = ""};
    trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &first);
    trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &second);
    trocar_loop_timing_t_publish(f->lcm, "TROCAR_TIMING", &timing);
    trocar_status_t_publish(f->lcm, "TROCAR_STATUS", &status);
    f->sight.contacts.server = 2;
    trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
    handle_all(f);
    assert_true(f->feed.wrench.depth == 1 && f->feed.timing.rate_hz == 0 && f->feed.status == NULL && f->feed.contacts == NULL);
    assert_int_equal(f->timeline.sample_end, 1);
    assert_int_equal(f->feed.refused, 0);
}

/* Of two needles, only the first is shown, although the other one's messages arrive in between. */
static void the_first_needle_is_shown(void **state) {
    fixture *f = *state;
    trocar_needle_wrench_t first = {.tick = 77, .depth = 1}, second = {.tick = 77, .depth = 2, .needle = 1};
    trocar_status_t statuses[2] = {{.owner = 5, .host = "", .scene = "", .inverse = "", .message = "", .needle_count = 2},
                                   {.owner = 6, .host = "", .scene = "", .inverse = "", .message = "", .needle_count = 2, .needle = 1}};
    trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &first);
    trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &second);
    for (int i = 0; i < 2; i++) trocar_status_t_publish(f->lcm, "TROCAR_STATUS", &statuses[i]);
    trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
    f->sight.contacts.needle = 1;
    f->sight.contacts.pose_utime = 6000;
    trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
    trocar_deformation_t_publish(f->lcm, "TROCAR_DEFORMATION", &f->sight.deformation);
    handle_all(f);
    assert_true(f->feed.wrench.depth == 1 && f->feed.status->owner == 5 && f->feed.contacts->pose_utime == 5000);
    assert_int_equal(f->timeline.picture_end, 1);
    assert_int_equal(f->feed.refused, 0);
}

/* As the network might deliver them: no crash, all counted. */
static void damaged_messages_are_counted(void **state) {
    fixture *f = *state;
    static const char *const channels[] = {"TROCAR_CONTACTS", "TROCAR_DEFORMATION", "TROCAR_STATUS", "TROCAR_TIMING", "TROCAR_WRENCH"};
    uint32_t random = 3;
    unsigned char noise[600];
    for (int i = 0; i < 2000; i++) {
        for (size_t k = 0; k < sizeof noise; k++) {
            random = 1664525u * random + 1013904223u;
            noise[k] = (unsigned char)(random >> 24);
        }
        lcm_publish(f->lcm, channels[i % 5], noise, random % sizeof noise);
        handle_all(f);
    }
    assert_int_equal(f->feed.refused, 2000);
    assert_int_equal(f->timeline.picture_end, 0);
    assert_int_equal(f->timeline.sample_end, 0);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(picture_needs_both_messages_of_its_tick, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_server_is_alive_while_it_sends, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_server_is_gone_half_a_second_after_its_last_wrench, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(change_of_server_is_detected, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(first_of_two_servers_is_followed, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(the_first_needle_is_shown, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(damaged_messages_are_counted, open_fixture, close_fixture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Tests that valid messages are added to the timeline and that invalid ones are counted. */
#include "view/stream/subscriber.h"

#include <stdlib.h>
#include <string.h>

#include "common/timing.h"
#include "common/viewer_messages.h"
#include "trocar_probe_wrench_t.h"

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
    trocar_error why = {""};
    trocar_pose base = {{0.005, 0.003, -0.15}, {1, 0, 0, 0}};
    f->host = host_open_with(MESHES "/figure8.yaml", "needles", "2");
    trocar_sim_reset(f->host.sim, 0, &base, NULL);
    f->lcm = lcm_create("memq://");
    if (viewer_messages_create(&f->sight, f->host.model, &why) != TROCAR_OK
        || timeline_create(&f->timeline, true, 2, &why) != TROCAR_OK
        || subscriber_open(&f->feed, f->lcm, f->host.model, &f->timeline, &why) != TROCAR_OK) {
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

/* Tracks arrive less often than snapshots, so each snapshot is given the latest tracks. */
static void picture_shows_the_newest_tracks(void **state) {
    fixture *f = *state;
    uint32_t points[2];
    for (int i = 0; i < 2; i++) {
        trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
        if (i == 0) viewer_messages_make_tracks(&f->sight, 0, 70);
        if (i == 0) trocar_tracks_t_publish(f->lcm, "TROCAR_TRACKS", &f->sight.tracks);
        trocar_deformation_t_publish(f->lcm, "TROCAR_DEFORMATION", &f->sight.deformation);
        handle_all(f);
        memcpy(&points[i], f->timeline.pictures[0].data + 8 + 32 + 36, sizeof points[i]);
    }
    assert_true(points[0] > 10); /* the track of a needle that was in the tissue from the start */
    assert_true(points[0] == (uint32_t)f->sight.tracks.point_count && points[1] == points[0]);
}

static void a_server_is_alive_while_it_sends(void **state) {
    fixture *f = *state;
    pose base;
    assert_false(subscriber_alive(&f->feed) || subscriber_base(&f->feed, 0, &base));
    trocar_needle_wrench_t w = {.tick = 77, .force = {0, 0, -1}};
    trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &w);
    trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
    handle_all(f);
    assert_true(subscriber_alive(&f->feed) && subscriber_base(&f->feed, 0, &base));
    assert_close_vector(base.position, v3(0.005, 0.003, -0.15), 0);
}

static void hear_wrench(fixture *f, int64_t server, int64_t tick) {
    trocar_needle_wrench_t w = {.server = server, .tick = tick};
    trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &w);
    handle_all(f);
}

/* Polls every 50 ms, like a program that is running normally. */
static bool is_alive_after(fixture *f, int64_t since, int64_t until) {
    bool alive = subscriber_alive(&f->feed);
    for (int64_t at = since; at < until; at += 50000000) {
        sleep_until(at);
        alive = subscriber_alive(&f->feed);
    }
    sleep_until(until);
    return subscriber_alive(&f->feed) && alive;
}

static void a_server_is_gone_half_a_second_after_its_last_wrench(void **state) {
    fixture *f = *state;
    hear_wrench(f, 1, 77);
    int64_t heard = f->feed.heard;
    assert_true(is_alive_after(f, heard, heard + 400000000));
    assert_false(is_alive_after(f, heard + 400000000, heard + 550000000));
}

/* A program that was not scheduled for a while cannot conclude that the server was silent, because messages may be waiting. */
static void a_pause_of_this_program_is_no_silence_of_the_server(void **state) {
    fixture *f = *state;
    hear_wrench(f, 1, 77);
    sleep_until(f->feed.heard + 1200000000);
    assert_true(subscriber_alive(&f->feed));
    hear_wrench(f, 1, 78);
    assert_true(subscriber_alive(&f->feed));
}

/* The previous server's data are discarded: its needle may be deep in the tissue while the new server's is outside. */
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
    hear_wrench(f, 1, 90001); /* a wrench delayed on the network */
    assert_true(f->feed.servers == 1 && f->feed.needles[0].status && subscriber_base(&f->feed, 0, &base));
    sleep_until(f->feed.heard + 500000001);
    hear_wrench(f, 2, 3);
    assert_true(f->feed.servers == 2 && !f->feed.needles[0].status && !subscriber_base(&f->feed, 0, &base));
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
    const needle_feed *n = &f->feed.needles[0];
    assert_true(n->wrench.depth == 1 && f->feed.timing.rate_hz == 0 && n->status == NULL && n->contacts == NULL);
    assert_int_equal(f->timeline.sample_end, 1);
    assert_int_equal(f->feed.refused, 0);
}

/* Each of two needles has its own wrench, status, contacts and samples, and a snapshot contains both. The scene has no third needle. */
static void needles_are_told_apart(void **state) {
    fixture *f = *state;
    for (int i = 0; i < 3; i++) {
        trocar_needle_wrench_t wrench = {.tick = 77, .depth = 1 + i, .needle = i};
        trocar_status_t status = {.owner = 5 + i, .host = "", .scene = "", .inverse = "", .message = "", .needle_count = 3, .needle = i};
        f->sight.contacts.needle = i;
        f->sight.contacts.pose_utime = 5000 + 1000 * i;
        trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &wrench);
        trocar_status_t_publish(f->lcm, "TROCAR_STATUS", &status);
        trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
    }
    trocar_deformation_t_publish(f->lcm, "TROCAR_DEFORMATION", &f->sight.deformation);
    handle_all(f);
    assert_int_equal(f->timeline.sample_end, 2);
    for (int i = 0; i < 2; i++) {
        const needle_feed *n = &f->feed.needles[i];
        pose base;
        assert_true(n->wrench.depth == 1 + i && n->status->owner == 5 + i && n->contacts->pose_utime == 5000 + 1000 * i);
        assert_true(subscriber_base(&f->feed, i, &base));
        assert_true(f->timeline.samples[i].needle == i && f->timeline.samples[i].depth == (float)(1 + i));
    }
    uint32_t shown;
    assert_int_equal(f->timeline.picture_end, 1);
    memcpy(&shown, f->timeline.pictures[0].data + 8 + 20, sizeof shown);
    assert_int_equal(shown, 2);
    assert_int_equal(f->feed.refused, 0);
}

/* No contacts are published for a needle that has not been held, so the snapshot shows only the other one. */
static void a_picture_shows_the_needles_that_were_held(void **state) {
    fixture *f = *state;
    uint32_t shown;
    hear_wrench(f, 0, 77);
    f->sight.contacts.needle = 1;
    trocar_contacts_t_publish(f->lcm, "TROCAR_CONTACTS", &f->sight.contacts);
    trocar_deformation_t_publish(f->lcm, "TROCAR_DEFORMATION", &f->sight.deformation);
    handle_all(f);
    assert_int_equal(f->timeline.picture_end, 1);
    memcpy(&shown, f->timeline.pictures[0].data + 8 + 20, sizeof shown);
    assert_int_equal(shown, 1);
    memcpy(&shown, f->timeline.pictures[0].data + 8 + 32 + 24, sizeof shown); /* its index */
    assert_int_equal(shown, 1);
}

/* Before any needle has been held, the probe is shown alone. When another server starts, there is no probe. */
static void the_probe_is_shown(void **state) {
    fixture *f = *state;
    trocar_probe_wrench_t probe = {.server = 1, .session = 9, .position = {0.1, 0, -0.2}, .orientation = {1, 0, 0, 0}, .force = {0, 0, -2}, .contacts = 4};
    float force;
    uint32_t count;
    hear_wrench(f, 1, 77);
    probe.server = 2;
    trocar_probe_wrench_t_publish(f->lcm, "TROCAR_PROBE_WRENCH", &probe);
    handle_all(f);
    assert_false(f->feed.probe.placed || subscriber_shows(&f->feed));
    probe.server = f->sight.deformation.server = 1;
    trocar_probe_wrench_t_publish(f->lcm, "TROCAR_PROBE_WRENCH", &probe);
    trocar_deformation_t_publish(f->lcm, "TROCAR_DEFORMATION", &f->sight.deformation);
    lcm_publish(f->lcm, "TROCAR_PROBE_WRENCH", "nonsense", 8);
    handle_all(f);
    assert_true(subscriber_shows(&f->feed) && f->feed.probe_owner == 9 && f->feed.probe.force[2] == -2);
    assert_int_equal(f->feed.refused, 1);
    assert_int_equal(f->timeline.picture_end, 1);
    memcpy(&count, f->timeline.pictures[0].data + 8 + 28, sizeof count);
    memcpy(&force, f->timeline.pictures[0].data + 8 + 32 + 36, sizeof force);
    assert_true(count == 1 && force == -2);
    assert_false(f->feed.probe.stopped);
    trocar_needle_wrench_t stopped = {.server = 1, .tick = 78, .flags = TROCAR_NEEDLE_WRENCH_T_PROBE_STOPPED};
    trocar_needle_wrench_t_publish(f->lcm, "TROCAR_WRENCH", &stopped);
    trocar_probe_wrench_t_publish(f->lcm, "TROCAR_PROBE_WRENCH", &probe);
    trocar_deformation_t_publish(f->lcm, "TROCAR_DEFORMATION", &f->sight.deformation);
    handle_all(f);
    assert_true(f->feed.probe.stopped && f->feed.probe.contacts == 4);
    assert_int_equal(f->timeline.picture_end, 2);
    memcpy(&count, f->timeline.pictures[1 % f->timeline.picture_room].data + 8 + 32 + 56, sizeof count);
    assert_int_equal(count, 1);
    sleep_until(f->feed.heard + 500000001);
    hear_wrench(f, 2, 3);
    assert_false(f->feed.probe.placed);
}

/* Messages damaged in the ways a network may damage them cause no crash, and all of them are counted. */
static void damaged_messages_are_counted(void **state) {
    fixture *f = *state;
    static const char *const channels[] = {"TROCAR_CONTACTS", "TROCAR_DEFORMATION", "TROCAR_STATUS", "TROCAR_TIMING", "TROCAR_TRACKS", "TROCAR_WRENCH"};
    uint32_t random = 3;
    unsigned char noise[600];
    for (int i = 0; i < 2000; i++) {
        for (size_t k = 0; k < sizeof noise; k++) {
            random = 1664525u * random + 1013904223u;
            noise[k] = (unsigned char)(random >> 24);
        }
        lcm_publish(f->lcm, channels[i % 6], noise, random % sizeof noise);
        handle_all(f);
    }
    assert_int_equal(f->feed.refused, 2000);
    assert_int_equal(f->timeline.picture_end, 0);
    assert_int_equal(f->timeline.sample_end, 0);
}

/* Seeds and replies come from the server being followed, and only replies to this program's session are shown. When another server starts, there are none. */
static void seeds_and_replies_are_kept(void **state) {
    fixture *f = *state;
    float place[3] = {0.1f, 0.2f, 0.3f}, *rows[] = {place};
    int16_t number = 7;
    trocar_seeds_t seeds = {.server = 1, .seed_count = 1, .position = rows, .direction = rows, .rest_position = rows, .rest_direction = rows, .needle = &number,
                            .guide = &number, .hole = &number, .strand = &number};
    trocar_command_reply_t reply = {.server = 1, .session = 5, .seq = 3, .message = "too late"}, other = {.server = 1, .session = 6, .message = ""};
    f->feed.session = 5;
    hear_wrench(f, 1, 1);
    int64_t heard = f->feed.seeds_heard, replies = f->feed.replies_heard;
    trocar_seeds_t_publish(f->lcm, "TROCAR_SEEDS", &seeds);
    seeds.server = 2, seeds.seed_count = 0;
    trocar_seeds_t_publish(f->lcm, "TROCAR_SEEDS", &seeds);
    trocar_command_reply_t_publish(f->lcm, "TROCAR_REPLY", &reply);
    trocar_command_reply_t_publish(f->lcm, "TROCAR_REPLY", &other);
    lcm_publish(f->lcm, "TROCAR_REPLY", "nonsense", 8);
    lcm_publish(f->lcm, "TROCAR_SEEDS", "nonsense", 8);
    handle_all(f);
    assert_true(f->feed.seeds_heard == heard + 1 && f->feed.seeds->seed_count == 1 && f->feed.seeds->hole[0] == 7 && f->feed.seeds->position[0][2] == 0.3f);
    assert_true(f->feed.replies_heard == replies + 1 && f->feed.reply->seq == 3 && strcmp(f->feed.reply->message, "too late") == 0);
    assert_int_equal(f->feed.refused, 2);
    sleep_until(f->feed.heard + 500000001);
    hear_wrench(f, 2, 3);
    assert_true(f->feed.seeds == NULL && f->feed.reply == NULL && f->feed.seeds_heard > heard + 1);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(picture_needs_both_messages_of_its_tick, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(picture_shows_the_newest_tracks, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_server_is_alive_while_it_sends, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_server_is_gone_half_a_second_after_its_last_wrench, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_pause_of_this_program_is_no_silence_of_the_server, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(change_of_server_is_detected, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(first_of_two_servers_is_followed, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(needles_are_told_apart, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_picture_shows_the_needles_that_were_held, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(seeds_and_replies_are_kept, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(the_probe_is_shown, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(damaged_messages_are_counted, open_fixture, close_fixture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

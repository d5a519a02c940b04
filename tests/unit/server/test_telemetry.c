/* Tests the messages to monitors and viewers through a real LCM object (memq, no network). */
#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "telemetry.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"
#include "trocar_loop_timing_t.h"
#include "trocar_needle_wrench_t.h"
#include "trocar_status_t.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "host.h"
#include "needle_line.h"

typedef struct {
    host host;
    exchange exchange;
    telemetry telemetry;
    trocar_loop_timing_t *timing;      /* the first message of each type */
    trocar_status_t *status;
    trocar_deformation_t *deformation;
    trocar_contacts_t *contacts;
    trocar_tracks_t *tracks;
    int statuses[2], pictures[2];      /* messages received for each needle */
    int empty_tracks;                  /* messages without any tracks */
    int64_t owners[2];
    double tips[2];                    /* m, along z */
} fixture;

#define KEEP_FIRST(name, type)                                                                                  \
    static void on_##name(const lcm_recv_buf_t *b, const char *channel, const type *m, void *context) {         \
        (void)b, (void)channel;                                                                                 \
        fixture *f = context;                                                                                   \
        if (f->name == NULL) f->name = type##_copy(m);                                                          \
    }
KEEP_FIRST(timing, trocar_loop_timing_t)
KEEP_FIRST(status, trocar_status_t)
KEEP_FIRST(deformation, trocar_deformation_t)
KEEP_FIRST(contacts, trocar_contacts_t)
KEEP_FIRST(tracks, trocar_tracks_t)

static int open_with(void **state, const char *needles) {
    fixture *f = allocate_on_cache_lines(sizeof *f);
    trocar_error why = {""};
    *state = f;
    f->host = host_open_with(MESHES "/figure8.yaml", "needles", needles);
    telemetry_options given = {.lcm_url = "memq://", .scene_path = trocar_scene_path(f->host.scene), .rate_hz = 1000,
                                .flags = TROCAR_NEEDLE_WRENCH_T_NOT_REALTIME, .server = 55};
    if (exchange_create(&f->exchange, f->host.model, &why) != TROCAR_OK
        || telemetry_create(&f->telemetry, &given, f->host.model, &f->exchange, &why) != TROCAR_OK) {
        print_error("%s\n", why.text);
        return -1;
    }
    return 0;
}

static int open_fixture(void **state) { return open_with(state, "1"); }
static int open_pair(void **state) { return open_with(state, "2"); }

static int close_fixture(void **state) {
    fixture *f = *state;
    if (f->timing != NULL) trocar_loop_timing_t_destroy(f->timing);
    if (f->status != NULL) trocar_status_t_destroy(f->status);
    if (f->deformation != NULL) trocar_deformation_t_destroy(f->deformation);
    if (f->contacts != NULL) trocar_contacts_t_destroy(f->contacts);
    if (f->tracks != NULL) trocar_tracks_t_destroy(f->tracks);
    telemetry_free(&f->telemetry);
    exchange_free(&f->exchange);
    host_close(&f->host);
    free(f);
    return 0;
}

/* Inserts a needle 20 mm into the tissue in lockstep while turning it, and publishes it as the haptic thread would. */
static void show_turned_needle(fixture *f, double turn) {
    view_sample *view = triple_buffer_slot(&f->exchange.views);
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    assert_int_equal(trocar_sim_reset(f->host.sim, 0, &base, NULL), TROCAR_OK);
    for (int i = 0; i < 500; i++) {
        base.position[2] += 0.05e-3;
        base.orientation[0] = cos(0.5 * turn * i / 500);
        base.orientation[3] = sin(0.5 * turn * i / 500);
        host_step(&f->host, &base);
    }
    trocar_sim_take_picture(f->host.sim, view->picture);
    view->tick = 499;
    view->needles[0].engaged = true;
    view->needles[0].pose_utime = 1234;
    view->needles[0].flags = TROCAR_NEEDLE_WRENCH_T_STALE;
    view->needles[0].contacts = 6;
    view->wrench_dropped = 3;
    triple_buffer_publish(&f->exchange.views);
}

static void show_a_needle(fixture *f) { show_turned_needle(f, 0.0); }

static void show_the_rest(fixture *f) {
    loop_record *loop = triple_buffer_slot(&f->exchange.loops);
    for (int i = 0; i < 100; i++) histogram_add(&loop->compute, 50000);
    loop->stage_total[TROCAR_LOOP_TIMING_T_STAGE_CONTACT] = 100 * 30000;
    loop->stage_max[TROCAR_LOOP_TIMING_T_STAGE_CONTACT] = 45000;
    loop->usage = (thread_usage){.minor_faults = 4, .major_faults = 5, .context_switches = 6, .allocations = 7};
    loop->ticks = 500;
    loop->misses = 2;
    triple_buffer_publish(&f->exchange.loops);
    arbiter_record *in = triple_buffer_slot(&f->exchange.intakes);
    in->needles[0].owner = 8;
    in->needles[0].received = monotonic_ns() - 500000000;
    in->needles[0].counts[POSE_ACCEPTED] = 490;
    in->needles[0].counts[POSE_JUMPED] = 4;
    strcpy(in->message, "session 9 refused: session 8 holds the needle");
    triple_buffer_publish(&f->exchange.intakes);
    int64_t latency = 3000000;
    spsc_ring_push(&f->exchange.latencies, &latency);
    for (int64_t round_trip = 1000000; round_trip <= 4000000; round_trip += 1000000)
        spsc_ring_push(&f->exchange.round_trips, &round_trip);
}

/* Receives messages for this many tenths of a second. At the start of each tenth, `show` (unless NULL) publishes a new state. */
static void receive_while(fixture *f, int tenths, void (*show)(fixture *)) {
    lcm_t *lcm = f->telemetry.lcm;
    trocar_loop_timing_t_subscription_t *a = trocar_loop_timing_t_subscribe(lcm, "TROCAR_TIMING", on_timing, f);
    trocar_status_t_subscription_t *b = trocar_status_t_subscribe(lcm, "TROCAR_STATUS", on_status, f);
    trocar_deformation_t_subscription_t *c = trocar_deformation_t_subscribe(lcm, "TROCAR_DEFORMATION", on_deformation, f);
    trocar_contacts_t_subscription_t *d = trocar_contacts_t_subscribe(lcm, "TROCAR_CONTACTS", on_contacts, f);
    trocar_tracks_t_subscription_t *e = trocar_tracks_t_subscribe(lcm, "TROCAR_TRACKS", on_tracks, f);
    pthread_t thread;
    assert_int_equal(pthread_create(&thread, NULL, telemetry_run, &f->telemetry), 0);
    for (int i = 0; i < tenths; i++) {
        if (show != NULL) show(f);
        sleep_until(monotonic_ns() + 100000000);
    }
    telemetry_stop(&f->telemetry);
    pthread_join(thread, NULL);
    while (lcm_handle_timeout(lcm, 0) > 0) continue;
    trocar_loop_timing_t_unsubscribe(lcm, a);
    trocar_status_t_unsubscribe(lcm, b);
    trocar_deformation_t_unsubscribe(lcm, c);
    trocar_contacts_t_unsubscribe(lcm, d);
    trocar_tracks_t_unsubscribe(lcm, e);
}

static void receive(fixture *f) { receive_while(f, 3, NULL); }

/* The track of a needle inserted straight by 19 mm starts at the skin. It is shorter than 19 mm by the depth of the dent. */
static void the_track_is_published(void **state) {
    fixture *f = *state;
    show_a_needle(f);
    receive(f);
    const trocar_tracks_t *t = f->tracks;
    assert_non_null(t);
    assert_true(t->server == 55 && t->needle == 0 && t->tick == 499 && t->point_count > 2);
    assert_true(t->membrane[0] == 0 && fabsf(t->position[0][2]) < 1e-6f);
    const float *last = t->position[t->point_count - 1];
    assert_true(t->track[t->point_count - 1] == 0 && fabsf(last[0] - 5e-3f) < 1e-4f && last[2] > 5e-3f && last[2] < 24e-3f);
}

static void show_the_simulation(fixture *f) {
    view_sample *view = triple_buffer_slot(&f->exchange.views);
    trocar_sim_take_picture(f->host.sim, view->picture);
    view->needles[0].engaged = true;
    triple_buffer_publish(&f->exchange.views);
}

static void count_empty_tracks(const lcm_recv_buf_t *b, const char *channel, const trocar_tracks_t *m, void *context) {
    (void)b, (void)channel;
    fixture *f = context;
    f->empty_tracks += m->point_count == 0;
}

/* A viewer that loses the first message after a reset learns from the next one that there are no tracks. */
static void a_reset_is_told_again_each_second(void **state) {
    fixture *f = *state;
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    show_a_needle(f);
    receive(f);
    assert_true(f->tracks != NULL && f->tracks->point_count > 0);
    assert_int_equal(trocar_sim_reset(f->host.sim, 0, &base, NULL), TROCAR_OK);
    trocar_tracks_t_subscription_t *s = trocar_tracks_t_subscribe(f->telemetry.lcm, "TROCAR_TRACKS", count_empty_tracks, f);
    atomic_store(&f->telemetry.stop, false);
    receive_while(f, 25, show_the_simulation);
    trocar_tracks_t_unsubscribe(f->telemetry.lcm, s);
    assert_in_range(f->empty_tracks, 2, 3);
}

static void on_seeds(const lcm_recv_buf_t *b, const char *channel, const trocar_seeds_t *m, void *context) {
    (void)b, (void)channel;
    trocar_seeds_t **last = context;
    if (*last != NULL) trocar_seeds_t_destroy(*last);
    *last = trocar_seeds_t_copy(m);
}

/* Of a strand of two seeds, one is in the tissue and the other still in the needle. After the reset there are none. */
static void seeds_are_published(void **state) {
    fixture *f = *state;
    trocar_seeds_t *last = NULL;
    trocar_seeds_t_subscription_t *s = trocar_seeds_t_subscribe(f->telemetry.lcm, "TROCAR_SEEDS", on_seeds, &last);
    show_a_needle(f);
    assert_int_equal(trocar_sim_drop_seeds(f->host.sim, 0, 2, 0.0, NULL), TROCAR_OK);
    trocar_pose base = trocar_view_base(trocar_sim_view(f->host.sim), 0);
    while (trocar_view_pending_seeds(trocar_sim_view(f->host.sim), 0) > 1) {
        base.position[2] -= 1e-4;
        host_step(&f->host, &base);
    }
    view_sample *view = triple_buffer_slot(&f->exchange.views);
    trocar_sim_take_picture(f->host.sim, view->picture);
    view->tick = 600;
    view->needles[0].engaged = true;
    triple_buffer_publish(&f->exchange.views);
    receive(f);
    assert_non_null(last);
    assert_true(last->server == 55 && last->tick == 600 && last->length == 4.5e-3 && last->diameter == 0.8e-3);
    assert_true(last->needle_count == 1 && last->pending[0] == 1 && last->seed_count == 1);
    trocar_seed seed;
    assert_int_equal(trocar_view_seeds(trocar_sim_view(f->host.sim), &seed, 1), 1);
    double *field = malloc(3 * sizeof *field * (size_t)trocar_model_node_count(f->host.model)), at[3], along[3];
    assert_int_equal(trocar_view_displacements(trocar_sim_view(f->host.sim), field, NULL), TROCAR_OK);
    trocar_model_displace_seed(f->host.model, field, &seed, at, along);
    for (int a = 0; a < 3; a++) {
        assert_true(fabs(last->rest_position[0][a] - seed.position[a]) < 1e-8 && fabs(last->rest_direction[0][a] - seed.direction[a]) < 1e-6);
        assert_true(fabs(last->position[0][a] - at[a]) < 1e-8 && fabs(last->direction[0][a] - along[a]) < 1e-6);
    }
    assert_true(last->needle[0] == 0 && last->guide[0] == -1 && last->hole[0] == -1 && last->strand[0] == 0);
    free(field);

    trocar_sim_undo_seed(f->host.sim, 0, NULL);
    trocar_sim_undo_seed(f->host.sim, 0, NULL);
    atomic_store(&f->telemetry.stop, false);
    receive_while(f, 3, show_the_simulation);
    assert_true(last->seed_count == 0 && last->pending[0] == 0);
    trocar_seeds_t_destroy(last);
    trocar_seeds_t_unsubscribe(f->telemetry.lcm, s);
}

static void all_four_messages_contain_the_published_state(void **state) {
    fixture *f = *state;
    show_a_needle(f);
    show_the_rest(f);
    receive(f);
    assert_true(f->timing && f->status && f->deformation && f->contacts);

    assert_int_equal(f->timing->ticks, 500);
    assert_int_equal(f->timing->misses, 2);
    assert_int_equal(f->timing->wrenches_dropped, 3);
    assert_true(fabs(f->timing->compute_p99 - 50e-6) < 2e-6);
    assert_true(fabs(f->timing->worker_latency_max - 3e-3) < 1e-9);
    assert_true(fabs(f->timing->worker_latency_p99 - 3e-3) < 1e-9);
    assert_true(fabs(f->timing->round_trip_p50 - 2e-3) < 0.1e-3);
    assert_true(fabs(f->timing->round_trip_max - 4e-3) < 1e-9);
    assert_true(fabs(f->timing->stage_mean[TROCAR_LOOP_TIMING_T_STAGE_CONTACT] - 30e-6) < 1e-12);
    assert_true(fabs(f->timing->stage_max[TROCAR_LOOP_TIMING_T_STAGE_CONTACT] - 45e-6) < 1e-12);
    assert_int_equal(f->timing->compute_bins[12], 100); /* bin 12 covers 45 to 64 us */
    assert_int_equal(f->timing->minor_faults, 4);
    assert_int_equal(f->timing->major_faults, 5);
    assert_int_equal(f->timing->context_switches, 6);
    assert_int_equal(f->timing->allocations, 7);

    assert_true(f->status->needle == 0 && f->status->needle_count == 1 && f->status->contacts == 6);
    assert_int_equal(f->timing->contacts, 6);
    assert_int_equal(f->status->owner, 8);
    assert_int_equal(f->status->poses_accepted, 490);
    assert_int_equal(f->status->poses_jumped, 4);
    assert_true(f->status->pose_age > 0.5 && f->status->pose_age < 5);
    assert_int_equal(f->status->flags, TROCAR_NEEDLE_WRENCH_T_STALE | TROCAR_NEEDLE_WRENCH_T_NOT_REALTIME);
    assert_string_equal(f->status->message, "session 9 refused: session 8 holds the needle");
    assert_non_null(strstr(f->status->scene, "figure8.yaml"));
}

/* The viewer's data are consistent: all nodes are there, the tissue moves with the needle, and fixed nodes do not move. */
static void the_tissue_moves_with_the_needle(void **state) {
    fixture *f = *state;
    show_a_needle(f);
    receive(f);
    assert_true(f->deformation);
    assert_int_equal(f->deformation->node_count, trocar_model_node_count(f->host.model));
    assert_int_equal(f->deformation->tick, 499);
    double furthest = 0.0;
    for (int i = 0; i < f->deformation->node_count; i++) {
        const float *u = f->deformation->displacement[i];
        if (trocar_model_fixed(f->host.model)[i]) assert_true(u[0] == 0 && u[1] == 0 && u[2] == 0);
        furthest = fmax(furthest, fabs((double)u[2]));
    }
    assert_true(furthest > 1e-5 && furthest < 0.02);
}

static void the_contacts_lie_on_the_needle(void **state) {
    fixture *f = *state;
    show_a_needle(f);
    receive(f);
    const trocar_contacts_t *c = f->contacts;
    assert_non_null(c);
    assert_int_equal(c->pose_utime, 1234);
    assert_true(c->orientation[0] == 1 && c->orientation[1] == 0);
    assert_int_equal(c->joint_count, trocar_model_segments(f->host.model) + 1);
    assert_true(c->contact_count >= 2);
    double joints[TROCAR_MAX_JOINTS][3];
    for (int j = 0; j < c->joint_count; j++) memcpy(joints[j], c->centreline[j], sizeof joints[j]);
    for (int i = 0; i < c->contact_count; i++)
        assert_true(distance_from_needle((const double (*)[3])joints, c->joint_count, c->arc[i], c->position[i]) < 1e-5);
    for (int i = 0; i < c->contact_count; i++)
        assert_int_equal(c->kind[i], i == c->contact_count - 1 ? TROCAR_CONTACTS_T_TIP : TROCAR_CONTACTS_T_TISSUE);
    double pull = 0.0;
    for (int i = 0; i < c->contact_count; i++) {
        assert_true(fabs(c->position[i][2] - (c->centreline[0][2] + c->arc[i])) < 1e-3); /* the needle is nearly straight, along z */
        pull += c->force[i][2];
    }
    assert_true(pull > 0.2); /* the tissue is pushed forward */
}

static void the_tip_lags_behind_a_turned_base(void **state) {
    fixture *f = *state;
    show_turned_needle(f, 1.0);
    receive(f);
    assert_non_null(f->contacts);
    assert_true(f->contacts->tip_lead < -1e-5);
    assert_true(f->contacts->tip_lead == trocar_view_tip_lead(trocar_sim_view(f->host.sim), 0));
}

static void count_status(const lcm_recv_buf_t *b, const char *channel, const trocar_status_t *m, void *context) {
    (void)b, (void)channel;
    fixture *f = context;
    assert_true(m->needle_count == 2 && m->needle >= 0 && m->needle < 2);
    f->statuses[m->needle]++;
    f->owners[m->needle] = m->owner;
}

static void count_contacts(const lcm_recv_buf_t *b, const char *channel, const trocar_contacts_t *m, void *context) {
    (void)b, (void)channel;
    fixture *f = context;
    f->pictures[m->needle]++;
    f->tips[m->needle] = m->centreline[m->joint_count - 1][2];
}

/* A status is published for every needle, contacts only for needles that a hand has held. */
static void each_needle_has_its_messages(void **state) {
    fixture *f = *state;
    for (int held = 1; held <= 2; held++) {
        view_sample *view = triple_buffer_slot(&f->exchange.views);
        for (int n = 0; n < held; n++) {
            trocar_pose base = {{0.06 * (n - 0.5), 0.003, -0.201 - 0.01 * n}, {1, 0, 0, 0}};
            assert_int_equal(trocar_sim_reset(f->host.sim, n, &base, NULL), TROCAR_OK);
            view->needles[n].engaged = true;
        }
        trocar_sim_take_picture(f->host.sim, view->picture);
        triple_buffer_publish(&f->exchange.views);
        arbiter_record *in = triple_buffer_slot(&f->exchange.intakes);
        for (int n = 0; n < held; n++) in->needles[n].owner = 8 + n;
        triple_buffer_publish(&f->exchange.intakes);

        lcm_t *lcm = f->telemetry.lcm;
        memset(f->statuses, 0, sizeof f->statuses);
        memset(f->pictures, 0, sizeof f->pictures);
        trocar_status_t_subscription_t *a = trocar_status_t_subscribe(lcm, "TROCAR_STATUS", count_status, f);
        trocar_contacts_t_subscription_t *b = trocar_contacts_t_subscribe(lcm, "TROCAR_CONTACTS", count_contacts, f);
        atomic_store(&f->telemetry.stop, false);
        receive(f);
        trocar_status_t_unsubscribe(lcm, a);
        trocar_contacts_t_unsubscribe(lcm, b);
        assert_true(f->statuses[0] > 0 && f->statuses[0] == f->statuses[1]);
        assert_true(f->owners[0] == 8 && f->owners[1] == (held == 2 ? 9 : 0));
        assert_true(f->pictures[0] > 0 && f->pictures[1] == (held == 2 ? f->pictures[0] : 0));
    }
    assert_true(fabs(f->tips[0] + 0.001) < 1e-6 && fabs(f->tips[1] + 0.011) < 1e-6);
}

/* A refused message is reported on stderr once, even if another has been refused in the meantime. */
static void the_first_malformed_pose_is_reported(void **state) {
    fixture *f = *state;
    char said[1000] = "";
    show_a_needle(f);
    arbiter_record *in = triple_buffer_slot(&f->exchange.intakes);
    in->poses_malformed = 2;
    strcpy(in->malformed, "pose of 3 bytes refused");
    strcpy(in->message, "session 9 refused");
    triple_buffer_publish(&f->exchange.intakes);
    FILE *kept = tmpfile();
    int before = dup(STDERR_FILENO);
    fflush(stderr);
    dup2(fileno(kept), STDERR_FILENO);
    receive(f);
    dup2(before, STDERR_FILENO);
    close(before);
    rewind(kept);
    said[fread(said, 1, sizeof said - 1, kept)] = '\0';
    fclose(kept);
    assert_string_equal(said, "trocar-server: pose of 3 bytes refused\n");
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(all_four_messages_contain_the_published_state, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(the_tissue_moves_with_the_needle, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(the_track_is_published, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(seeds_are_published, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(a_reset_is_told_again_each_second, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(the_contacts_lie_on_the_needle, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(the_tip_lags_behind_a_turned_base, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(the_first_malformed_pose_is_reported, open_fixture, close_fixture),
        cmocka_unit_test_setup_teardown(each_needle_has_its_messages, open_pair, close_fixture),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

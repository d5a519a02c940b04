/* Tests, through trocar.h, several needles in the same tissue. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "trocar.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { IN = 500 }; /* 1 ms ticks; at 0.1 mm per tick, the insertion is 50 mm deep */

static trocar_model *create_model(const char *needles) {
    trocar_scene *scene;
    trocar_model *model;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    if (needles) OK(trocar_scene_set(scene, "needles", needles, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    return model;
}

/* Returns the base's pose. Needle 0 enters on the left and needle 1 on the right, `apart` (m) apart. */
static trocar_pose base_at(int needle, double apart, int tick) {
    return (trocar_pose){{(needle - 0.5) * apart, 0.003, -0.201 + 1e-4 * tick}, {1, 0, 0, 0}};
}

/* Inserts both needles, or only one of them, and fills outputs[needle][tick]. */
static trocar_sim *push_in(trocar_model *model, double apart, const int *held, trocar_output outputs[2][IN]) {
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    for (int n = 0; n < 2; n++) {
        trocar_pose start = base_at(n, apart, 0);
        OK(trocar_sim_reset(sim, n, &start, &why));
    }
    for (int t = 0; t < IN; t++)
        for (int n = 0; n < 2; n++) {
            trocar_pose base = base_at(n, apart, t + 1);
            if (held[n]) OK(trocar_sim_step(sim, n, &base, 1e-3, &outputs[n][t], &why));
        }
    return sim;
}

static double distance(const double a[3], const double b[3]) { return sqrt(pow(a[0] - b[0], 2) + pow(a[1] - b[1], 2) + pow(a[2] - b[2], 2)); }

/* The needles are 60 mm apart. By Kelvin's solution (mu = 10 kPa), a force F on one displaces the tissue at the other by at most F / (8 pi mu d) (3 - 4 nu +
   cos^2) / (2 (1 - nu)), which is 0.13 mm per N. That displacement exerts less than a tenth of F on a shaft that sticks over 50 mm. */
static void needles_far_apart_feel_what_they_feel_alone(void **state) {
    (void)state;
    static trocar_output both[2][IN], alone[2][IN];
    trocar_model *model = create_model("2");
    assert_int_equal(trocar_model_needles(model), 2);
    trocar_sim_free(push_in(model, 0.06, (int[]){1, 1}, both));
    trocar_sim_free(push_in(model, 0.06, (int[]){1, 0}, alone));
    trocar_sim_free(push_in(model, 0.06, (int[]){0, 1}, alone));
    for (int n = 0; n < 2; n++) {
        double peak = 0.0, worst = 0.0;
        for (int t = 0; t < IN; t++) {
            double off = distance(both[n][t].force, alone[n][t].force), force = distance(both[n][t].force, (double[3]){0});
            peak = force > peak ? force : peak;
            worst = off > worst ? off : worst;
        }
        print_message("needle %d: peak %.3f N, changed by %.4f N by the other one\n", n, peak, worst);
        assert_true(peak > 0.5 && both[n][IN - 1].contacts > 5);
        assert_true(worst < 0.1 * peak && worst > 1e-5);
    }
    trocar_model_free(model);
}

/* Returns the change (N) in the equilibrium force on needle `felt` when the base of needle `moved` moves by 50 um along `axis`. */
static void nudge(trocar_sim *sim, const void *start, int moved, int axis, double change[3]) {
    trocar_output before, after;
    int felt = 1 - moved;
    OK(trocar_sim_restore(sim, start, trocar_sim_state_size(sim), &why));
    trocar_pose base[2] = {trocar_view_base(trocar_sim_view(sim), 0), trocar_view_base(trocar_sim_view(sim), 1)};
    OK(trocar_sim_step(sim, felt, &base[felt], 1e-3, &before, &why));
    base[moved].position[axis] += 50e-6;
    for (int t = 0; t < 100; t++) {
        OK(trocar_sim_step(sim, moved, &base[moved], 1e-3, &after, &why));
        OK(trocar_sim_step(sim, felt, &base[felt], 1e-3, &after, &why));
    }
    for (int a = 0; a < 3; a++) change[a] = after.force[a] - before.force[a];
}

/* Reciprocity (Maxwell-Betti): the force on needle A due to a displacement of B equals the force on B due to the same displacement of A. */
static void the_coupling_is_reciprocal(void **state) {
    (void)state;
    static trocar_output outputs[2][IN];
    trocar_model *model = create_model("2");
    trocar_sim *sim = push_in(model, 0.02, (int[]){1, 1}, outputs);
    trocar_pose base[2] = {trocar_view_base(trocar_sim_view(sim), 0), trocar_view_base(trocar_sim_view(sim), 1)};
    for (int t = 0; t < 300; t++)
        for (int n = 0; n < 2; n++) OK(trocar_sim_step(sim, n, &base[n], 1e-3, &outputs[n][0], &why));
    size_t size = trocar_sim_state_size(sim);
    void *start = malloc(size);
    OK(trocar_sim_save(sim, start, size, &why));
    double of_0[3][3], of_1[3][3], largest = 0.0; /* force on the other needle when needle 0 or 1 moves; indices: axis of motion, axis of force */
    for (int axis = 0; axis < 2; axis++) { /* the lateral axes, along which no contact slides */
        nudge(sim, start, 0, axis, of_0[axis]);
        nudge(sim, start, 1, axis, of_1[axis]);
        largest = fmax(largest, fmax(fabs(of_0[axis][0]), fabs(of_0[axis][1])));
    }
    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            print_message("moved %c felt %c: %.3e and %.3e N\n", "xy"[a], "xy"[b], of_0[a][b], of_1[b][a]);
            assert_true(fabs(of_0[a][b] - of_1[b][a]) < 0.02 * largest);
        }
    assert_true(largest > 1e-5);
    free(start);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* Creates another simulation in the same state as `sim`. */
static trocar_sim *restored_copy(trocar_model *model, const trocar_sim *sim) {
    trocar_sim *copy;
    size_t size = trocar_sim_state_size(sim);
    void *state = malloc(size);
    OK(trocar_sim_create(model, &copy, &why));
    OK(trocar_sim_save(sim, state, size, &why));
    OK(trocar_sim_restore(copy, state, size, &why));
    free(state);
    return copy;
}

static void what_follows_a_restore_follows_the_save(void **state) {
    (void)state;
    static trocar_output outputs[2][IN], again[2];
    trocar_model *model = create_model("2");
    trocar_sim *sim = push_in(model, 0.02, (int[]){1, 1}, outputs), *other = restored_copy(model, sim);
    for (int t = 0; t < 50; t++)
        for (int n = 0; n < 2; n++) {
            trocar_pose base = base_at(n, 0.02, IN + t);
            OK(trocar_sim_step(sim, n, &base, 1e-3, &outputs[n][0], &why));
            OK(trocar_sim_step(other, n, &base, 1e-3, &again[n], &why));
            assert_memory_equal(&outputs[n][0], &again[n], sizeof again[n]);
        }
    trocar_sim_free(sim);
    trocar_sim_free(other);
    trocar_model_free(model);
}

/* The worker answers between ticks, as it does in real time, and serves both needles. */
static void ticks_and_worker_serve_every_needle(void **state) {
    (void)state;
    static trocar_output outputs[2][IN];
    trocar_model *model = create_model("2");
    trocar_sim_free(push_in(model, 0.06, (int[]){1, 1}, outputs));
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    for (int n = 0; n < 2; n++) {
        trocar_pose start = base_at(n, 0.06, 0);
        OK(trocar_sim_reset(sim, n, &start, &why));
    }
    for (int t = 0; t < IN; t++)
        for (int n = 0; n < 2; n++) {
            trocar_pose base = base_at(n, 0.06, t + 1);
            trocar_output output;
            trocar_work work;
            OK(trocar_sim_tick(sim, n, &base, 1e-3, &output));
            do OK(trocar_sim_work(sim, &work, &why)); while (work.answered);
            assert_true(distance(output.force, outputs[n][t].force) < 0.02);
        }
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* ---- contacts ---- */

enum { ROOM = 2 * TROCAR_MAX_CONTACTS, MOST_IDS = 256 };

/* Gets all contacts except the tip: first the active ones, then the others, each ordered from base to tip. */
static int all_contacts(const trocar_sim *sim, int needle, trocar_contact contacts[ROOM]) {
    int count = trocar_view_contacts(trocar_sim_view(sim), needle, contacts, ROOM);
    if (count > 0 && contacts[count - 1].kind == TROCAR_CONTACT_TIP) count--;
    return count + trocar_view_pending_contacts(trocar_sim_view(sim), needle, contacts + count, ROOM - count);
}

typedef struct {
    int slots[MOST_IDS], status[MOST_IDS]; /* values in the last tick, indexed by contact id; status -1: not seen yet, -2: removed */
    int seen[5];                           /* how often each status occurred */
} history;

/* Checks that a contact's status only moves forward, from planned to adding to sticking or sliding, and that a removed contact never reappears. */
static void follow(history *h, const trocar_contact *contacts, int count) {
    int last[MOST_IDS];
    memcpy(last, h->status, sizeof last);
    for (int id = 0; id < MOST_IDS; id++) h->status[id] = last[id] == -1 ? -1 : -2;
    for (int i = 0; i < count; i++) {
        const trocar_contact *c = &contacts[i];
        assert_true(c->kind == TROCAR_CONTACT_TISSUE && c->id > 0 && c->id < MOST_IDS && c->slot >= 0 && c->slot < TROCAR_MAX_CONTACTS);
        assert_true(last[c->id] != -2 && (last[c->id] <= c->status || last[c->id] == TROCAR_CONTACT_SLIDING));
        if (last[c->id] >= TROCAR_CONTACT_STICKING) assert_true(c->status >= TROCAR_CONTACT_STICKING);
        if (last[c->id] >= 0) assert_int_equal(c->slot, h->slots[c->id]);
        assert_true(c->status == TROCAR_CONTACT_SLIDING ? c->state != 0 : c->state == 0);
        assert_true(c->status >= TROCAR_CONTACT_STICKING || distance(c->force, (double[3]){0}) == 0.0);
        assert_true(i == 0 || c->depth > contacts[i - 1].depth);
        for (int k = 0; k < i; k++) assert_true(c->slot != contacts[k].slot && c->id != contacts[k].id);
        h->slots[c->id] = c->slot;
        h->status[c->id] = c->status;
        h->seen[c->status]++;
    }
}

/* Inserts a needle and withdraws it half-way. The worker answers only every 30 ms, too late for some contacts. */
static void contacts_keep_their_id_and_slot(void **state) {
    (void)state;
    trocar_model *model = create_model(NULL);
    trocar_sim *sim;
    trocar_contact contacts[ROOM];
    history h = {.seen = {0}};
    trocar_pose base = base_at(0, 0.0, 0);
    memset(h.status, -1, sizeof h.status);
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_reset(sim, 0, &base, &why));
    for (int t = 0; t < 2 * IN; t++) {
        trocar_output output;
        base = base_at(0, 0.0, t < IN ? t : t < 3 * IN / 2 ? 2 * IN - t : IN / 2);
        OK(trocar_sim_tick(sim, 0, &base, 1e-3, &output));
        if (t % 30 == 0) OK(trocar_sim_work(sim, NULL, &why));
        follow(&h, contacts, all_contacts(sim, 0, contacts));
    }
    print_message("planned %d, adding %d, sticking %d, sliding %d\n", h.seen[0], h.seen[1], h.seen[2], h.seen[3]);
    for (int i = 0; i <= TROCAR_CONTACT_SLIDING; i++) assert_true(h.seen[i] > 20);
    int removed = 0;
    for (int id = 0; id < MOST_IDS; id++) removed += h.status[id] == -2;
    assert_true(removed > 3);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static void contacts_follow_a_restore(void **state) {
    (void)state;
    static trocar_output outputs[2][IN];
    trocar_model *model = create_model("2");
    trocar_sim *sim = push_in(model, 0.02, (int[]){1, 1}, outputs), *other = restored_copy(model, sim);
    for (int t = 0; t < 100; t++)
        for (int n = 0; n < 2; n++) {
            trocar_contact expected[ROOM], found[ROOM];
            memset(expected, 0, sizeof expected);
            memset(found, 0, sizeof found);
            int count = all_contacts(sim, n, expected);
            assert_true(count > 3);
            assert_int_equal(all_contacts(other, n, found), count);
            assert_memory_equal(found, expected, sizeof found);
            trocar_pose base = base_at(n, 0.02, t < 50 ? IN + t : IN + 50 - 4 * (t - 50));
            OK(trocar_sim_step(sim, n, &base, 1e-3, &outputs[n][0], &why));
            OK(trocar_sim_step(other, n, &base, 1e-3, &outputs[n][1], &why));
        }
    trocar_sim_free(sim);
    trocar_sim_free(other);
    trocar_model_free(model);
}

/* Pushes a needle hard against the pubic arch. */
static void contacts_of_a_buckled_needle_still_hold_it(void **state) {
    (void)state;
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    trocar_output output = {0};
    trocar_contact contacts[ROOM];
    OK(trocar_scene_load(MESHES "/prostate.yaml", &scene, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    OK(trocar_sim_create(model, &sim, &why));
    trocar_pose base = {{0.013, 0.012, -0.201}, {1, 0, 0, 0}};
    OK(trocar_sim_reset(sim, 0, &base, &why));
    for (int t = 0; t < 2000; t++) {
        base.position[2] += 2e-5;
        OK(trocar_sim_step(sim, 0, &base, 1e-3, &output, &why));
    }
    assert_true(output.force[2] < -10.0);
    int count = trocar_view_contacts(trocar_sim_view(sim), 0, contacts, ROOM);
    assert_true(count > 2);
    for (int i = 0; i < count; i++) assert_true(contacts[i].status == TROCAR_CONTACT_STICKING || contacts[i].status == TROCAR_CONTACT_SLIDING);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static void a_needle_that_is_none_is_refused(void **state) {
    (void)state;
    trocar_scene *scene;
    OK(trocar_scene_create(&scene, &why));
    assert_int_equal(trocar_scene_set(scene, "needles", "0", &why), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_scene_set(scene, "needles", "33", &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "a whole number from 1 to 32"));
    trocar_scene_free(scene);
    static const int wrong[] = {-1, 1, 2};
    trocar_model *model = create_model(NULL);
    assert_int_equal(trocar_model_needles(model), 1);
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    trocar_pose base = base_at(0, 0.0, 0);
    for (int i = 0; i < 3; i++) {
        trocar_output output;
        trocar_contact contact;
        double joint[3];
        assert_int_equal(trocar_sim_reset(sim, wrong[i], &base, &why), TROCAR_BAD_INPUT);
        assert_non_null(strstr(why.text, "there is one, number 0"));
        assert_int_equal(trocar_sim_step(sim, wrong[i], &base, 1e-3, &output, &why), TROCAR_BAD_INPUT);
        assert_int_equal(trocar_sim_tick(sim, wrong[i], &base, 1e-3, &output), TROCAR_BAD_INPUT);
        assert_int_equal(trocar_view_contacts(trocar_sim_view(sim), wrong[i], &contact, 1), 0);
        assert_int_equal(trocar_view_pending_contacts(trocar_sim_view(sim), wrong[i], &contact, 1), 0);
        assert_int_equal(trocar_view_centreline(trocar_sim_view(sim), wrong[i], joint, 1), 0);
        assert_true(trocar_view_needle_energy(trocar_sim_view(sim), wrong[i]) == 0.0);
        trocar_sim_set_base_compliance(sim, wrong[i], 1.0);
        assert_true(trocar_view_base(trocar_sim_view(sim), wrong[i]).orientation[0] == 1.0);
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(needles_far_apart_feel_what_they_feel_alone), cmocka_unit_test(the_coupling_is_reciprocal),
        cmocka_unit_test(what_follows_a_restore_follows_the_save),     cmocka_unit_test(ticks_and_worker_serve_every_needle),
        cmocka_unit_test(a_needle_that_is_none_is_refused),            cmocka_unit_test(contacts_keep_their_id_and_slot),
        cmocka_unit_test(contacts_follow_a_restore),                   cmocka_unit_test(contacts_of_a_buckled_needle_still_hold_it),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

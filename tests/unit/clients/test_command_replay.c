/* Tests seed commands in a replay. A drop that comes slightly too early waits. Commands that the server refused do not end the wait, and an undo cancels the
   drop. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include "shared/command_replay.h"

#include <cmocka.h>

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static const double STEP = 1e-4; /* m, travel of the base per tick */

typedef struct {
    trocar_model *model;
    trocar_sim *sim;
    trocar_output output;
    double z;                /* m, z coordinate of the base */
    waiting_drop waiting;
} insertion;

static logged_command logged(int command, int seeds, logged_answer answer) {
    return (logged_command){.command = {.command = command, .seeds = seeds}, .answer = answer};
}

static void tick(insertion *in, double way) {
    trocar_pose base = {{0.005, 0.003, in->z += way}, {1, 0, 0, 0}};
    OK(trocar_sim_step(in->sim, 0, &base, 1e-3, &in->output, &why));
}

/* Starts with the needle 30 mm deep. One seed has been dropped, and the command to drop the next comes before that seed has left the needle. */
static void begin(insertion *in, const logged_command *early) {
    trocar_scene *scene;
    trocar_pose base = {{0.005, 0.003, -0.202}, {1, 0, 0, 0}};
    *in = (insertion){.z = base.position[2]};
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_model_create(scene, NULL, &in->model, &why));
    trocar_scene_free(scene);
    OK(trocar_sim_create(in->model, &in->sim, &why));
    OK(trocar_sim_reset(in->sim, 0, &base, &why));
    while (in->output.depth < 0.03) tick(in, STEP);
    const logged_command first = logged(TROCAR_COMMAND_T_DROP_SEED, 1, ANSWER_DONE);
    OK(replay_seed_command(&in->waiting, in->sim, 0, &first, &why));
    assert_null(in->waiting.drop);
    for (int i = 0; i < 30; i++) tick(in, -STEP);
    OK(replay_seed_command(&in->waiting, in->sim, 0, early, &why));
    assert_ptr_equal(in->waiting.drop, &early->command);
}

static void end(insertion *in) {
    trocar_sim_free(in->sim);
    trocar_model_free(in->model);
}

static int left(const insertion *in) { return trocar_view_seeds(trocar_sim_view(in->sim), NULL, 0); }
static int pending(const insertion *in) { return trocar_view_pending_seeds(trocar_sim_view(in->sim), 0); }

/* Draws the needle back, retrying the drop before each tick, as a replay does. */
static void draw_back_until_it_no_longer_waits(insertion *in, bool carried_out) {
    for (int i = 0; i < 100 && in->waiting.drop; i++) {
        bool tried = try_waiting_drop(&in->waiting, in->sim, 0);
        assert_true(tried || !carried_out);
        assert_true(tried || !in->waiting.drop);
        if (in->waiting.drop) tick(in, -STEP);
    }
    assert_null(in->waiting.drop);
    assert_int_equal(left(in), 1);
}

static void draw_out(insertion *in) {
    while (in->output.depth > 0.0) {
        assert_true(try_waiting_drop(&in->waiting, in->sim, 0));
        tick(in, -STEP);
    }
}

static void an_early_drop_waits_until_the_seed_is_out(void **state) {
    (void)state;
    insertion in;
    const logged_command early = logged(TROCAR_COMMAND_T_DROP_SEED, 2, ANSWER_DONE);
    begin(&in, &early);
    assert_int_equal(pending(&in), 1);
    draw_back_until_it_no_longer_waits(&in, true);
    assert_int_equal(pending(&in), 2);
    draw_out(&in);
    assert_int_equal(left(&in), 3);
    end(&in);
}

/* The server had carried out the drop, so the undo cancels the waiting drop and not the previous seed. */
static void an_undo_takes_back_the_drop_that_waits(void **state) {
    (void)state;
    insertion in;
    const logged_command early = logged(TROCAR_COMMAND_T_DROP_SEED, 1, ANSWER_DONE), undo = logged(TROCAR_COMMAND_T_UNDO, 0, ANSWER_DONE);
    begin(&in, &early);
    assert_true(end_waiting_drop(&in.waiting, in.sim, 0, &undo));
    OK(replay_seed_command(&in.waiting, in.sim, 0, &undo, &why));
    assert_null(in.waiting.drop);
    assert_int_equal(pending(&in), 1);
    draw_out(&in);
    assert_int_equal(left(&in), 1);
    OK(replay_seed_command(&in.waiting, in.sim, 0, &undo, &why)); /* this time the undo removes the previous seed */
    assert_int_equal(left(&in), 0);
    end(&in);
}

static void what_the_server_refused_does_not_end_the_waiting(void **state) {
    (void)state;
    static const int COMMANDS[] = {TROCAR_COMMAND_T_DROP_SEED, TROCAR_COMMAND_T_UNDO, TROCAR_COMMAND_T_LEAVE};
    insertion in;
    const logged_command early = logged(TROCAR_COMMAND_T_DROP_SEED, 2, ANSWER_DONE);
    begin(&in, &early);
    for (int i = 0; i < 3; i++) {
        const logged_command refused = logged(COMMANDS[i], 1, ANSWER_REFUSED);
        assert_true(end_waiting_drop(&in.waiting, in.sim, 0, &refused));
        if (COMMANDS[i] != TROCAR_COMMAND_T_LEAVE) OK(replay_seed_command(&in.waiting, in.sim, 0, &refused, &why));
        assert_ptr_equal(in.waiting.drop, &early.command);
        assert_int_equal(pending(&in), 1);
    }
    draw_back_until_it_no_longer_waits(&in, true);
    assert_int_equal(pending(&in), 2);
    end(&in);
}

/* The wait ends at any other command, or at an undo without a reply, because the server carried these out after the drop. If the previous seed is still in
   the needle by then, the drop fails. */
static void another_command_ends_the_waiting(void **state) {
    (void)state;
    const logged_command early = logged(TROCAR_COMMAND_T_DROP_SEED, 1, ANSWER_DONE);
    const logged_command next[] = {logged(TROCAR_COMMAND_T_DROP_SEED, 1, ANSWER_DONE), logged(TROCAR_COMMAND_T_DROP_SEED, 1, ANSWER_UNKNOWN),
                                   logged(TROCAR_COMMAND_T_UNDO, 0, ANSWER_UNKNOWN), logged(TROCAR_COMMAND_T_LEAVE, 0, ANSWER_DONE)};
    insertion in;
    begin(&in, &early);
    for (int i = 0; i <= 4; i++) {
        OK(replay_seed_command(&in.waiting, in.sim, 0, &early, &why));
        assert_false(end_waiting_drop(&in.waiting, in.sim, 0, i < 4 ? &next[i] : NULL));
        assert_null(in.waiting.drop);
        assert_non_null(strstr(in.waiting.reason.text, "needle 0 still holds 1 of the seeds"));
        assert_true(end_waiting_drop(&in.waiting, in.sim, 0, NULL)); /* nothing waits */
        assert_int_equal(pending(&in), 1);
    }
    OK(replay_seed_command(&in.waiting, in.sim, 0, &early, &why));
    while (pending(&in)) tick(&in, -STEP);
    assert_true(end_waiting_drop(&in.waiting, in.sim, 0, &next[0])); /* succeeds, because the previous seed has left the needle */
    assert_int_equal(pending(&in), 1);
    end(&in);
}

static void only_what_the_server_carried_out_waits(void **state) {
    (void)state;
    const logged_command early = logged(TROCAR_COMMAND_T_DROP_SEED, 6, ANSWER_DONE); /* a strand longer than the remaining track */
    const logged_command unknown = logged(TROCAR_COMMAND_T_DROP_SEED, 1, ANSWER_UNKNOWN);
    insertion in;
    begin(&in, &early);
    draw_back_until_it_no_longer_waits(&in, false);
    assert_int_equal(pending(&in), 0);
    assert_non_null(strstr(in.waiting.reason.text, "of the seeds: push it farther in"));
    assert_int_equal(replay_seed_command(&in.waiting, in.sim, 0, &early, &why), TROCAR_BAD_INPUT); /* refused at once, because waiting would not help */
    assert_null(in.waiting.drop);
    OK(replay_seed_command(&in.waiting, in.sim, 0, &unknown, &why));
    assert_int_equal(replay_seed_command(&in.waiting, in.sim, 0, &unknown, &why), TROCAR_BAD_INPUT);
    assert_null(in.waiting.drop);
    assert_int_equal(pending(&in), 1);
    end(&in);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(an_early_drop_waits_until_the_seed_is_out),
        cmocka_unit_test(an_undo_takes_back_the_drop_that_waits),
        cmocka_unit_test(what_the_server_refused_does_not_end_the_waiting),
        cmocka_unit_test(another_command_ends_the_waiting),
        cmocka_unit_test(only_what_the_server_carried_out_waits),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

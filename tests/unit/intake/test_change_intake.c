/* Tests the server's intake of changes: malformed messages, floods, and (under AddressSanitizer) memory ownership. */
#include <poll.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <cmocka.h>

#include "common/message_fit.h"
#include "intake/changes.h"
#include "trocar.h"
#include "trocar_change_t.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static trocar_model *model;
static trocar_sim *sim;

static int build(void **state) {
    (void)state;
    trocar_scene *scene;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &sim, &why));
    trocar_scene_free(scene);
    return 0;
}

static int discard(void **state) {
    (void)state;
    trocar_sim_free(sim);
    trocar_model_free(model);
    return 0;
}

static unsigned char bytes[4096];

/* Encodes a change into `bytes` and returns the size of the message. */
static size_t message(const char *values, double time) {
    trocar_change_t m = {.utime = 1, .session = 2, .seq = 3, .time = time, .values = (char *)(uintptr_t)values};
    int size = trocar_change_t_encode(bytes, 0, sizeof bytes, &m);
    assert_true(size > 0);
    return (size_t)size;
}

static change_verdict take(change_intake *in, const char *values, double time, needle_command *command) {
    in->busy = false;
    return changes_take(in, bytes, message(values, time), command);
}

static double skin_of(const change_intake *in) {
    for (int i = 0; i < in->shown.count; i++)
        if (strcmp(in->shown.key[i], "membranes[skin].puncture_force") == 0) return in->shown.value[i];
    fail_msg("no skin");
    return 0.0;
}

static void malformed_messages_are_not_decoded(void **state) {
    (void)state;
    change_intake in = {.wake = -1};
    needle_command command;
    OK(changes_create(&in, sim, &why));
    size_t size = message("membranes[skin].puncture_force: 2", 0.5);
    for (size_t cut = 0; cut < size; cut++) { /* copies exactly this part, so that AddressSanitizer detects reads past its end */
        unsigned char *part = malloc(cut + 1);
        memcpy(part, bytes, cut);
        assert_int_equal(changes_take(&in, part, cut, &command), CHANGE_MALFORMED);
        free(part);
    }
    unsigned seed = 1;
    for (int i = 0; i < 20000; i++) {
        message("membranes[skin].puncture_force: 2", 0.5);
        for (int k = 0; k < 3; k++) bytes[rand_r(&seed) % size] = (unsigned char)rand_r(&seed);
        in.busy = false;
        if (changes_take(&in, bytes, size, &command) == CHANGE_PASS_ON) changes_settle(&in, &command);
    }
    changes_free(&in);
}

/* Tests the check that clients make before decoding the server's values. */
static void only_whole_values_fit(void **state) {
    (void)state;
    change_intake in = {.wake = -1};
    OK(changes_create(&in, sim, &why));
    int size = trocar_values_t_encode(bytes, 0, sizeof bytes, &in.shown);
    assert_true(in.shown.count == 20 && size > 0 && values_fit(bytes, (size_t)size));
    for (size_t cut = 0; cut < (size_t)size; cut++) {
        unsigned char *part = malloc(cut + 1);
        memcpy(part, bytes, cut);
        assert_false(values_fit(part, cut));
        free(part);
    }
    assert_false(values_fit(bytes, (size_t)size + 1));
    changes_free(&in);
}

static void refusals_have_a_reason_and_no_effect(void **state) {
    (void)state;
    static const struct { const char *values; double time; const char *words; } bad[] = {
        {"membranes[skin].puncture_force: 2", 0.05, "0.1 to 60 s"}, {"membranes[skin].puncture_force: 2", -1.0, "0.1 to 60 s"},
        {"membranes[skin].puncture_force: 2", 1.0 / 0.0, "0.1 to 60 s"}, {"needle.length: 1", 0.5, "cannot change during a run"}, {"", 0.5, "nothing"}};
    change_intake in, none = {.newest = NULL};
    needle_command command;
    OK(changes_create(&in, sim, &why));
    double before = skin_of(&in);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        assert_int_equal(take(&in, bad[i].values, bad[i].time, &command), CHANGE_REFUSED);
        assert_true(command.refused && command.asked.session == 2 && command.asked.seq == 3);
        if (!strstr(command.why, bad[i].words)) fail_msg("%s", command.why);
    }
    char lengthy[CHANGE_TEXT_MOST + 2];
    memset(lengthy, '\n', sizeof lengthy - 1);
    lengthy[sizeof lengthy - 1] = '\0';
    assert_int_equal(take(&in, lengthy, 0.5, &command), CHANGE_REFUSED);
    assert_non_null(strstr(command.why, "512 bytes"));
    assert_int_equal(take(&none, "membranes[skin].puncture_force: 2", 0.5, &command), CHANGE_REFUSED);
    assert_true(skin_of(&in) == before);
    changes_free(&in);
    changes_free(&none);
}

/* A change of moduli reaches the tick only after a separate thread has built a model with them. Until then, other changes are refused. */
static void moduli_are_passed_on_later(void **state) {
    (void)state;
    change_intake in = {.wake = eventfd(0, EFD_NONBLOCK)};
    needle_command first, second;
    OK(changes_create(&in, sim, &why));
    assert_int_equal(take(&in, "regions[prostate].youngs_modulus: 30e3", 0.5, &first), CHANGE_LATER);
    assert_int_equal(take(&in, "membranes[skin].puncture_force: 3", 0.5, &second), CHANGE_REFUSED);
    change_verdict verdict;
    while ((verdict = changes_ready(&in, &first)) == CHANGE_LATER) poll(&(struct pollfd){.fd = in.wake, .events = POLLIN}, 1, -1);
    assert_int_equal(verdict, CHANGE_PASS_ON);
    assert_true(trocar_change_prepared(first.change) && first.asked.seq == 3);
    changes_settle(&in, &first);
    assert_int_equal(changes_ready(&in, &first), CHANGE_LATER);
    assert_int_equal(take(&in, "regions[prostate].youngs_modulus: 40e3", 0.5, &first), CHANGE_LATER);
    int wake = in.wake;
    changes_free(&in); /* cancels */
    close(wake);
}

static void one_change_at_a_time(void **state) {
    (void)state;
    change_intake in = {.wake = -1};
    needle_command first, second;
    OK(changes_create(&in, sim, &why));
    assert_int_equal(take(&in, "membranes[skin].puncture_force: 2", 0.0, &first), CHANGE_PASS_ON);
    assert_true(first.change_time == TROCAR_CHANGE_TIME && !first.refused);
    assert_int_equal(changes_take(&in, bytes, message("membranes[skin].puncture_force: 3", 0.5), &second), CHANGE_REFUSED); /* two changes in one round */
    assert_non_null(strstr(second.why, "too many"));
    assert_int_equal(take(&in, "membranes[skin].puncture_force: 3", 0.5, &second), CHANGE_REFUSED); /* a second change before the reply to the first */
    assert_non_null(strstr(second.why, "wait for its reply"));
    changes_settle(&in, &first);
    assert_true(skin_of(&in) == 2.0);
    assert_int_equal(take(&in, "membranes[skin].puncture_force: 3", 0.5, &second), CHANGE_PASS_ON);
    second.refused = true; /* as if the command queue had been full */
    changes_settle(&in, &second);
    assert_true(skin_of(&in) == 2.0);
    assert_int_equal(take(&in, "regions[prostate].cutting_force: 1", 0.5, &second), CHANGE_PASS_ON);
    changes_settle(&in, &second);
    assert_true(skin_of(&in) == 2.0);
    changes_free(&in);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(malformed_messages_are_not_decoded),
        cmocka_unit_test(only_whole_values_fit),
        cmocka_unit_test(refusals_have_a_reason_and_no_effect),
        cmocka_unit_test(one_change_at_a_time),
        cmocka_unit_test(moduli_are_passed_on_later),
    };
    return cmocka_run_group_tests(tests, build, discard);
}

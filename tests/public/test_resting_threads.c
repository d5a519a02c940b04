/* One thread ticks, releases, takes and removes needles while a worker serves them. Meant for the sanitizers, and to show that no command blocks. */
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>
#include <poll.h>

#include <cmocka.h>

#include "trocar.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { NEEDLES = 3, PATIENCE = 120000 }; /* ms */

typedef struct {
    trocar_sim *sim;
    atomic_bool stop;
    trocar_status status;
    trocar_error failed;
} worker;

static void *run(void *context) {
    worker *w = context;
    while (!atomic_load(&w->stop)) {
        struct pollfd wake = {.fd = trocar_sim_work_descriptor(w->sim), .events = POLLIN};
        trocar_work work = {.more = 1};
        poll(&wake, 1, 10);
        while (work.more && !atomic_load(&w->stop)) {
            trocar_error error;
            trocar_status status = trocar_sim_work(w->sim, &work, &error);
            if (status != TROCAR_OK && w->status == TROCAR_OK) w->status = status, w->failed = error;
        }
    }
    return NULL;
}

static void pause_ms(int ms) { nanosleep(&(struct timespec){ms / 1000, ms % 1000 * 1000000L}, NULL); }

static void wait_for(trocar_sim *sim, int needle, trocar_needle_state state) {
    for (int i = 0; i < PATIENCE && trocar_sim_needle_state(sim, needle) != state; i++) pause_ms(1);
    assert_int_equal(trocar_sim_needle_state(sim, needle), state);
}

static void push(trocar_sim *sim, int needle, trocar_picture *picture, double depth) {
    trocar_output out = {0};
    trocar_pose base = {{0.005 * needle, 0.003, -0.201}, {1, 0, 0, 0}};
    OK(trocar_sim_reset(sim, needle, &base, &why));
    const int moving = (int)(depth / 2e-4);
    /* After the insertion, keeps holding the needle until the worker has answered, which may take a long time. */
    for (int t = 0; t < moving || (out.contacts == 0 && t < PATIENCE); t++) {
        if (t < moving) base.position[2] += 2e-4;
        OK(trocar_sim_tick(sim, needle, &base, 1e-3, &out));
        if (t % 16 == 0) trocar_sim_take_picture(sim, picture);
        pause_ms(1);
    }
    assert_true(out.contacts > 0);
}

static void needles_change_hands_between_threads(void **state) {
    (void)state;
    trocar_scene *scene;
    trocar_model *model;
    trocar_picture *picture;
    trocar_output out;
    worker w = {.status = TROCAR_OK};
    pthread_t thread;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_scene_set(scene, "needles", "3", &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &w.sim, &why));
    OK(trocar_picture_create(model, &picture, &why));
    const trocar_pose away = {{0, 0, -10}, {1, 0, 0, 0}};
    for (int i = 0; i < NEEDLES; i++) OK(trocar_sim_reset(w.sim, i, &away, &why));
    assert_int_equal(pthread_create(&thread, NULL, run, &w), 0);
    for (int round = 0; round < 2; round++) {
        for (int i = 0; i < NEEDLES; i++) {
            push(w.sim, i, picture, 0.02);
            OK(trocar_sim_leave(w.sim, i, &why));
            if (i + 1 < NEEDLES) wait_for(w.sim, i, TROCAR_NEEDLE_RESTING); /* the last needle is removed or taken while it is still being released */
        }
        OK(trocar_sim_reset(w.sim, NEEDLES - 1, &away, &why));
        OK(trocar_sim_take(w.sim, 0, &why));
        assert_int_equal(trocar_sim_tick(w.sim, 1, &away, 1e-3, &out), TROCAR_BAD_INPUT);
        wait_for(w.sim, 0, TROCAR_NEEDLE_HELD);
        trocar_pose base = trocar_view_base(trocar_sim_view(w.sim), 0);
        double rest = 0.0;
        for (int t = 0; t < 100; t++) {
            if (t > 0) base.position[2] += 1e-4;
            OK(trocar_sim_tick(w.sim, 0, &base, 1e-3, &out));
            if (t == 0) rest = out.force[2];
            trocar_sim_take_picture(w.sim, picture);
            pause_ms(1);
        }
        print_message("at rest %.4f N, pushed on %.4f N\n", rest, out.force[2]);
        assert_true(rest > -0.01 && rest < 0.01 && out.force[2] < -0.05);
        OK(trocar_sim_leave(w.sim, 0, &why));
        wait_for(w.sim, 0, TROCAR_NEEDLE_RESTING);
        for (int i = 0; i < NEEDLES; i++) OK(trocar_sim_reset(w.sim, i, &away, &why));
    }
    atomic_store(&w.stop, true);
    pthread_join(thread, NULL);
    if (w.status != TROCAR_OK) fail_msg("%s", w.failed.text);
    trocar_picture_free(picture);
    trocar_sim_free(w.sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(needles_change_hands_between_threads)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* trocar-replay --all: a log of several needles with commands gives the forces that the same calls give. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "poselog.h"
#include "trocar.h"

#include <cmocka.h>

#include "check.h"

static report why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { IN = 250, BACK = 100 };

typedef struct {
    trocar_sim *sim;
    lcm_eventlog_t *log;
    int64_t utime, seq;
    trocar_output last;
} recording;

static char folder[] = "/tmp/test_replay_all.XXXXXX", path[64], scene_path[64], csv[64], out[64];

static void command(recording *r, int what, int needle) {
    trocar_command_t m = {.utime = r->utime, .session = 10 + needle, .command = what, .needle = needle, .seq = r->seq++};
    OK(log_write_command(r->log, &m, path, &why));
}

/* A pose in the log, `aside` from where the needle of the simulation is held. */
static void pose_at(recording *r, int needle, double x, double z, double aside) {
    trocar_pose base = {{x, 0.003, z}, {1, 0, 0, 0}};
    trocar_needle_pose_t m = {.utime = r->utime += 1000, .session = 10 + needle, .seq = r->seq++, .needle = needle,
                              .position = {x + aside, 0.003, z}, .orientation = {1, 0, 0, 0}};
    OK(log_write_pose(r->log, &m, path, &why));
    OK(trocar_sim_step(r->sim, needle, &base, 1e-3, &r->last, &why));
}

static void push(recording *r, int needle, double x) {
    trocar_pose start = {{x, 0.003, -0.201}, {1, 0, 0, 0}};
    OK(trocar_sim_reset(r->sim, needle, &start, &why));
    for (int t = 0; t <= IN; t++) pose_at(r, needle, x, -0.201 + 1e-4 * t, 0.0);
}

static void leave(recording *r, int needle) {
    command(r, TROCAR_COMMAND_T_LEAVE, needle);
    OK(trocar_sim_leave(r->sim, needle, &why));
    OK(trocar_sim_work(r->sim, NULL, &why));
}

/* Two needles put in and left, the first taken where it lies with the hand elsewhere and drawn back, the second removed. */
static void record(recording *r) {
    const trocar_pose away = {{0, 0, -10}, {1, 0, 0, 0}};
    for (int i = 0; i < 2; i++) OK(trocar_sim_reset(r->sim, i, &away, &why));
    push(r, 0, 0.0);
    leave(r, 0);
    push(r, 1, 0.005);
    leave(r, 1);
    command(r, TROCAR_COMMAND_T_TAKE, 0);
    OK(trocar_sim_take(r->sim, 0, &why));
    OK(trocar_sim_work(r->sim, NULL, &why));
    trocar_pose base = trocar_sim_base(r->sim, 0), first = base;
    command(r, TROCAR_COMMAND_T_RESET, 1);
    OK(trocar_sim_reset(r->sim, 1, &away, &why));
    for (int t = 0; t <= BACK; t++) {
        trocar_needle_pose_t m = {.utime = r->utime += 1000, .session = 10, .seq = r->seq++, .position = {0.3, 0.2, 0.1 - 1e-4 * t}, .orientation = {1, 0, 0, 0}};
        base.position[2] = first.position[2] - 1e-4 * t;
        OK(log_write_pose(r->log, &m, path, &why));
        OK(trocar_sim_step(r->sim, 0, &base, 1e-3, &r->last, &why));
    }
    command(r, TROCAR_COMMAND_T_TAKE, 1); /* refused: it is gone */
}

static int run(const char *options) {
    char line[512];
    snprintf(line, sizeof line, "%s --scene %s --poses %s %s", REPLAY, scene_path, path, options);
    return system(line);
}

static void a_log_with_commands_replays_as_it_was(void **state) {
    (void)state;
    trocar_scene *scene;
    trocar_model *model;
    recording r = {.utime = 1000000};
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/log", folder);
    snprintf(scene_path, sizeof scene_path, "%s/scene.yaml", folder);
    snprintf(csv, sizeof csv, "%s/csv", folder);
    snprintf(out, sizeof out, "%s/out", folder);
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    char line[600];
    snprintf(line, sizeof line, "sed 's|^mesh: |mesh: " MESHES "/|; 1i needles: 2' " MESHES "/figure8.yaml > %s", scene_path);
    assert_int_equal(system(line), 0);
    OK(trocar_scene_set(scene, "needles", "2", &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &r.sim, &why));
    r.log = lcm_eventlog_create(path, "w");
    record(&r);
    lcm_eventlog_destroy(r.log);

    char options[200];
    snprintf(options, sizeof options, "--all --csv %s --out %s 2>%s/text", csv, out, folder);
    assert_int_equal(run(options), 0);
    FILE *file = fopen(csv, "r");
    double t, force[3];
    int rows = -1;
    char row[1024], last[1024] = "";
    for (; fgets(row, sizeof row, file); rows++) memcpy(last, row, sizeof last);
    fclose(file);
    assert_int_equal(rows, 2 * (IN + 1) + BACK + 1);
    assert_int_equal(sscanf(last, "%lf,%lf,%lf,%lf", &t, &force[0], &force[1], &force[2]), 4);
    for (int a = 0; a < 3; a++) assert_close(force[a], r.last.force[a], 1e-9);
    snprintf(line, sizeof line, "grep -q '5 commands, 1 of them refused' %s/text", folder);
    assert_int_equal(system(line), 0);
    rename(out, path); /* what it writes can be replayed again */
    assert_int_equal(run("--all -q"), 0);
    assert_int_not_equal(run("--all --needle 1 -q 2>/dev/null"), 0);
    snprintf(line, sizeof line, "rm -r %s", folder);
    assert_int_equal(system(line), 0);
    trocar_sim_free(r.sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_log_with_commands_replays_as_it_was)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}

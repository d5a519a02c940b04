/* Checks that trocar-replay gives the same forces as the corresponding library calls, for a log of several needles with commands (--all) and for one with
   probe poses. */
#define _DEFAULT_SOURCE
#include <math.h>
#include <setjmp.h>

#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "base/vec.h"
#include "shared/poselog.h"
#include "trocar.h"

#include <cmocka.h>

#include "check.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { IN = 250, BACK = 100 };

typedef struct {
    trocar_sim *sim;
    lcm_eventlog_t *log;
    int64_t utime, seq;
    trocar_output last;
    double (*force)[3];      /* N, force in each tick; NULL if not recorded */
    int ticks;
    int64_t moved[2];        /* us, utime of each needle's last pose; 0 if the next pose starts an insertion */
} recording;

static char folder[32], path[64], scene_path[64], csv[64], out[64];

static void make_folder(void) {
    strcpy(folder, "/tmp/test_replay_all.XXXXXX");
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/log", folder);
    snprintf(scene_path, sizeof scene_path, "%s/scene.yaml", folder);
    snprintf(csv, sizeof csv, "%s/csv", folder);
    snprintf(out, sizeof out, "%s/out", folder);
}

static void command(recording *r, int what, int needle) {
    trocar_command_t m = {.utime = r->utime, .session = 10 + needle, .command = what, .needle = needle, .seq = r->seq++};
    OK(log_write_command(r->log, &m, path, &why));
}

/* Writes a pose to the log, displaced by `aside` (m) from the one at which the simulation holds the needle. */
static void pose_at(recording *r, int needle, double x, double z, double aside) {
    trocar_pose base = {{x, 0.003, z}, {1, 0, 0, 0}};
    trocar_needle_pose_t m = {.utime = r->utime += 1000, .session = 10 + needle, .seq = r->seq++, .needle = needle,
                              .position = {x + aside, 0.003, z}, .orientation = {1, 0, 0, 0}};
    double dt = r->moved[needle] != 0 ? fmin(1e-6 * (double)(r->utime - r->moved[needle]), POSE_LOG_GAP) : 1e-3;
    OK(log_write_pose(r->log, &m, path, &why));
    OK(trocar_sim_step(r->sim, needle, &base, dt, &r->last, &why));
    r->moved[needle] = r->utime;
    if (r->force != NULL) memcpy(r->force[r->ticks++], r->last.force, sizeof *r->force);
}

static void push(recording *r, int needle, double x) {
    trocar_pose start = {{x, 0.003, -0.201}, {1, 0, 0, 0}};
    OK(trocar_sim_reset(r->sim, needle, &start, &why));
    r->moved[needle] = 0;
    for (int t = 0; t <= IN; t++) pose_at(r, needle, x, -0.201 + 1e-4 * t, 0.0);
}

static void leave(recording *r, int needle) {
    command(r, TROCAR_COMMAND_T_LEAVE, needle);
    OK(trocar_sim_leave(r->sim, needle, &why));
    OK(trocar_sim_work(r->sim, NULL, &why));
}

/* Records two needles that are inserted and released. The first is taken where it rests, although the hand is somewhere else, and withdrawn. The second is
   removed. */
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
    trocar_pose base = trocar_view_base(trocar_sim_view(r->sim), 0), first = base;
    command(r, TROCAR_COMMAND_T_RESET, 1);
    OK(trocar_sim_reset(r->sim, 1, &away, &why));
    for (int t = 0; t <= BACK; t++) {
        trocar_needle_pose_t m = {.utime = r->utime += 1000, .session = 10, .seq = r->seq++, .position = {0.3, 0.2, 0.1 - 1e-4 * t}, .orientation = {1, 0, 0, 0}};
        base.position[2] = first.position[2] - 1e-4 * t;
        OK(log_write_pose(r->log, &m, path, &why));
        OK(trocar_sim_step(r->sim, 0, &base, 1e-3, &r->last, &why));
    }
    command(r, TROCAR_COMMAND_T_TAKE, 1); /* refused, because the needle has been removed */
}

/* Records two needles side by side. The first is reset twice, once while held and once after being released and taken, and is inserted again elsewhere while
   the second one moves on. */
static void record_resets(recording *r) {
    const trocar_pose away = {{0, 0, -10}, {1, 0, 0, 0}};
    for (int i = 0; i < 2; i++) OK(trocar_sim_reset(r->sim, i, &away, &why));
    push(r, 0, 0.0);
    push(r, 1, 0.005);
    command(r, TROCAR_COMMAND_T_RESET, 0);
    OK(trocar_sim_reset(r->sim, 0, &away, &why));
    for (int t = 1; t <= BACK; t++) pose_at(r, 1, 0.005, -0.201 + 1e-4 * (IN + t), 0.0); /* the second needle moves as if the first had never been inserted */
    push(r, 0, -0.01);
    leave(r, 0);
    command(r, TROCAR_COMMAND_T_TAKE, 0);
    OK(trocar_sim_take(r->sim, 0, &why));
    OK(trocar_sim_work(r->sim, NULL, &why));
    command(r, TROCAR_COMMAND_T_RESET, 0);
    OK(trocar_sim_reset(r->sim, 0, &away, &why));
    for (int t = 1; t <= BACK; t++) pose_at(r, 1, 0.005, -0.201 + 1e-4 * (IN + BACK + t), 0.0);
    push(r, 0, 0.02);
}

/* Creates a scene of two needles in a folder of its own, and the log written by `record`. Returns the model; the simulation belongs to the recording. */
static trocar_model *log_two_needles(recording *r, void (*record)(recording *)) {
    trocar_scene *scene;
    trocar_model *model;
    char line[600];
    make_folder();
    snprintf(line, sizeof line, "sed 's|^mesh: |mesh: " MESHES "/|; 1i needles: 2' " MESHES "/figure8.yaml > %s", scene_path);
    assert_int_equal(system(line), 0);
    OK(trocar_scene_load(scene_path, &scene, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    OK(trocar_sim_create(model, &r->sim, &why));
    r->log = lcm_eventlog_create(path, "w");
    record(r);
    lcm_eventlog_destroy(r->log);
    return model;
}

static void remove_folder(void) {
    char line[600];
    snprintf(line, sizeof line, "rm -r %s", folder);
    assert_int_equal(system(line), 0);
}

static int run(const char *options) {
    char line[1400];
    snprintf(line, sizeof line, "%s --scene %s --poses %s %s", REPLAY, scene_path, path, options);
    return system(line);
}

static void a_log_with_commands_replays_as_it_was(void **state) {
    (void)state;
    recording r = {.utime = 1000000};
    trocar_model *model = log_two_needles(&r, record);
    char options[200], line[600];
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
    rename(out, path); /* the next run replays this output */
    assert_int_equal(run("--all -q"), 0);
    assert_int_not_equal(run("--all --needle 1 -q 2>/dev/null"), 0);
    remove_folder();
    trocar_sim_free(r.sim);
    trocar_model_free(model);
}

/* ---- the probe ------------------------------------------------------------------------------------------------------------ */

#define RADIUS 0.008
#define LENGTH 0.1

static const char probe_keys[] = "probe: {surface: skin, radius: 0.008, tip_radius: 0.008, length: 0.1}\n";

static trocar_pose probe_at(int tick) { return (trocar_pose){{0.02, -0.015, -LENGTH - 0.001 + 2e-5 * tick}, {1, 0, 0, 0}}; }

/* Reads the forces of all ticks as rows (x, y, z). Returns the number of ticks. */
static int read_forces(double (*force)[3], int room) {
    FILE *file = fopen(csv, "r");
    char row[1024];
    int rows = -1;
    for (double t; fgets(row, sizeof row, file); rows++)
        if (rows >= 0 && rows < room) assert_int_equal(sscanf(row, "%lf,%lf,%lf,%lf", &t, &force[rows][0], &force[rows][1], &force[rows][2]), 4);
    fclose(file);
    return rows;
}

static void resets_take_effect_at_once(void **state) {
    (void)state;
    enum { ROOM = 4096 };
    static double force[ROOM][3];
    recording r = {.utime = 1000000, .force = calloc(ROOM, sizeof *r.force)};
    trocar_model *model = log_two_needles(&r, record_resets);
    char line[600];
    snprintf(line, sizeof line, "--all -q --csv %s", csv);
    assert_int_equal(run(line), 0);
    assert_int_equal(read_forces(force, ROOM), r.ticks);
    for (int i = 0; i < r.ticks; i++)
        for (int a = 0; a < 3; a++) assert_close(force[i][a], r.force[i][a], 1e-9);
    remove_folder();
    trocar_sim_free(r.sim);
    trocar_model_free(model);
    free(r.force);
}

/* ---- changes of the tissue ------------------------------------------------------------------------------------------------ */

static logged_command ask(recording *r, const char *values) {
    logged_command m = {.command = {.utime = r->utime, .session = 99, .command = TROCAR_COMMAND_T_CHANGE, .seq = r->seq++}, .change_time = 0.1, .change = (char *)(uintptr_t)values};
    OK(log_write_change(r->log, &m, path, &why));
    return m;
}

static void answer(recording *r, const logged_command *m, bool done) { OK(log_write_reply(r->log, &m->command, done, path, &why)); }

static trocar_change *prepared(recording *r, const logged_command *m) {
    trocar_change *change;
    OK(trocar_change_create(r->sim, &change, &why));
    OK(trocar_change_set(change, m->change, &why));
    OK(trocar_change_prepare(change, NULL, &why));
    return change;
}

static void carry_out(recording *r, trocar_change *change) {
    OK(trocar_sim_change(r->sim, change, 0.1, &why));
    trocar_change_free(change);
}

/* Records changes of moduli. The reply to the first comes after 40 ms. The second takes effect when the first is complete, although its reply was recorded
   earlier. The third is refused. */
static void record_changes(recording *r) {
    enum { BUILT = 40, END = 400 };
    static const trocar_pose start = {{0, 0.003, -0.201}, {1, 0, 0, 0}};
    logged_command softer = {0};
    trocar_change *waits = NULL;
    OK(trocar_sim_reset(r->sim, 0, &start, &why));
    for (int t = 0; t <= END; t++) {
        if (t == 150) {
            logged_command m = ask(r, "regions[surrounding].cutting_force: 0.5");
            carry_out(r, prepared(r, &m));
            answer(r, &m, true);
        }
        if (t == 200) softer = ask(r, "regions[prostate].youngs_modulus: 30e3\nregions[surrounding].youngs_modulus: 15e3");
        if (t == 200 + BUILT) {
            carry_out(r, prepared(r, &softer));
            answer(r, &softer, true);
        }
        if (t == 220 + BUILT) {
            assert_true(trocar_sim_changing(r->sim) > 0.0);
            logged_command m = ask(r, "membranes[skin].stiffness: 100");
            waits = prepared(r, &m);
            answer(r, &m, true);
            m = ask(r, "regions[prostate].youngs_modulus: 90e3");
            answer(r, &m, false);
        }
        if (waits && trocar_sim_accepts(r->sim, waits)) {
            carry_out(r, waits);
            waits = NULL;
        }
        pose_at(r, 0, 0.0, -0.201 + 1e-4 * t, 0.0);
    }
    assert_null(waits);
}

static void changes_take_effect_at_the_reply(void **state) {
    (void)state;
    enum { ROOM = 1024 };
    static double force[ROOM][3];
    recording r = {.utime = 1000000, .force = calloc(ROOM, sizeof *r.force)};
    trocar_model *model = log_two_needles(&r, record_changes);
    char line[600];
    static const char *const modes[] = {"", "--all"};
    for (int i = 0; i < 2; i++) {
        snprintf(line, sizeof line, "%s --csv %s --out %s 2>%s/text", modes[i], csv, out, folder);
        assert_int_equal(run(line), 0);
        assert_int_equal(read_forces(force, ROOM), r.ticks);
        for (int k = 0; k < r.ticks; k++)
            for (int a = 0; a < 3; a++) assert_close(force[k][a], r.force[k][a], 1e-9);
        snprintf(line, sizeof line, "grep -q '^4 changes of the tissue' %s/text", folder);
        assert_int_equal(system(line), 0);
        rename(out, path); /* replays the output in turn: its changes must take effect at the same times */
    }
    remove_folder();
    trocar_sim_free(r.sim);
    trocar_model_free(model);
    free(r.force);
}

/* The probe is pressed 5 mm into the skin next to a needle, with a pose in every tenth tick. Old poses and those of another session are ignored. */
static void record_with_probe(recording *r) {
    trocar_pose base = {{0, 0.003, -0.201}, {1, 0, 0, 0}};
    OK(trocar_sim_reset(r->sim, 0, &base, &why));
    for (int t = 0; t <= IN; t++) {
        trocar_pose probe = probe_at(t);
        trocar_probe_pose_t m = {.utime = r->utime + 500, .session = t % 20 ? 6 : 5, .seq = t == 100 ? 0 : t + 1, .orientation = {1, 0, 0, 0}};
        memcpy(m.position, probe.position, sizeof m.position);
        if (t % 10 == 0) OK(log_write_probe(r->log, &m, path, &why));
        if (t % 20 == 0 && t != 100) OK(trocar_sim_set_probe(r->sim, &probe, &why));
        pose_at(r, 0, 0.0, -0.201 + 1e-4 * t, 0.0);
    }
}

/* All points in the file lie on the probe's surface, and the force equals the simulation's. */
static void check_probe_file(const char *name, const trocar_probe *p) {
    char line[512], file_path[96];
    snprintf(file_path, sizeof file_path, "%s/%s", folder, name);
    FILE *file = fopen(file_path, "r");
    assert_non_null(file);
    int points = 0;
    bool force = false;
    while (fgets(line, sizeof line, file)) {
        double x[3];
        char *start = strstr(line, "hand_force");
        if (start && sscanf(strchr(start, '>') + 1, "%lf %lf %lf", &x[0], &x[1], &x[2]) == 3) {
            force = true;
            for (int a = 0; a < 3; a++) assert_close(x[a], p->force[a], 1e-9);
        }
        if (!strstr(line, "\"Points\"")) continue;
        while (fgets(line, sizeof line, file) && sscanf(line, "%lf %lf %lf", &x[0], &x[1], &x[2]) == 3) {
            double along = x[2] - p->base.position[2], beyond = fmax(0.0, along - (LENGTH - RADIUS));
            assert_close(hypot(hypot(x[0] - p->base.position[0], x[1] - p->base.position[1]), beyond), RADIUS, 1e-12);
            points++;
        }
    }
    fclose(file);
    assert_true(force && points > 100);
}

static void the_probe_of_a_log_moves_as_it_did(void **state) {
    (void)state;
    trocar_scene *scene;
    trocar_model *model;
    recording r = {.utime = 1000000};
    make_folder();
    char line[1000];
    snprintf(line, sizeof line, "sed 's|^mesh: |mesh: " MESHES "/|' " MESHES "/figure8.yaml > %s && printf '%%s' '%s' >> %s", scene_path, probe_keys, scene_path);
    assert_int_equal(system(line), 0);
    OK(trocar_scene_load(scene_path, &scene, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &r.sim, &why));
    r.log = lcm_eventlog_create(path, "w");
    record_with_probe(&r);
    lcm_eventlog_destroy(r.log);
    trocar_probe probe = trocar_view_probe(trocar_sim_view(r.sim));
    assert_true(probe.contacts > 0 && probe.force[2] < -0.1);

    snprintf(line, sizeof line, "--csv %s --out %s --vtu %s/end --pvd %s/series 2>%s/text", csv, out, folder, folder, folder);
    assert_int_equal(run(line), 0);
    FILE *file = fopen(csv, "r");
    double last[29];
    char row[1024];
    while (fgets(row, sizeof row, file)) continue;
    fclose(file);
    int columns = 0;
    for (char *at = row, *field; (field = strsep(&at, ",")) && columns < 29;) last[columns++] = strtod(field, NULL);
    assert_int_equal(columns, 28);
    for (int a = 0; a < 3; a++) {
        assert_close(last[1 + a], r.last.force[a], 1e-9);
        assert_close(last[18 + a], probe.force[a], 1e-9);
        assert_close(last[21 + a], probe.torque[a], 1e-9);
        assert_close(last[25 + a], probe.base.position[a], 1e-12);
    }
    assert_int_equal((int)last[24], probe.contacts);
    check_probe_file("end-probe.vtu", &probe);
    snprintf(line, sizeof line, "grep -q '^12 poses of the probe$' %s/text && grep -q '^14 poses of the probe skipped' %s/text && grep -q series-0003-probe.vtu %s/series.pvd",
             folder, folder, folder);
    assert_int_equal(system(line), 0);

    rename(out, path); /* the next run replays this output, with bit-identical results */
    snprintf(line, sizeof line, "-q --csv %s.2", csv);
    assert_int_equal(run(line), 0);
    snprintf(line, sizeof line, "cmp %s %s.2 && rm -r %s", csv, csv, folder);
    assert_int_equal(system(line), 0);
    trocar_sim_free(r.sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_log_with_commands_replays_as_it_was),
        cmocka_unit_test(resets_take_effect_at_once), cmocka_unit_test(changes_take_effect_at_the_reply), cmocka_unit_test(the_probe_of_a_log_moves_as_it_did)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Tests the derivatives of a step against central differences: in random states, for the pose of the base and for properties of the tissue. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

#include "trocar.h"

#include <cmocka.h>

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { BASE = TROCAR_BASE_VARIABLES, PARAMETERS = 12, VARIABLES = BASE + PARAMETERS, TARGETS = 2, BLOCKS = 4 + TARGETS, VALUES = 3 * BLOCKS };
static const char *const BLOCK_NAMES[BLOCKS] = {"force", "torque", "tip", "direction", "target", "target"};
static const double DT = 1e-3; /* s */
#define LENGTH 0.2             /* m, length of the needle: a rotation is measured by the distance by which it moves the end of a straight needle */

/* ---- a simulation and its values ------------------------------------------------------------------------------------------------ */

/* The passes of a step end at the contact tolerance: below it, results are smooth functions of their input. */
static trocar_scene *exact_scene(void) {
    trocar_scene *scene;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_scene_set_number(scene, "contact.tolerance", 1e-24, &why));
    OK(trocar_scene_set_number(scene, "contact.max_passes", 20.0, &why));
    return scene;
}

typedef struct {
    trocar_model *model;
    trocar_sim *sim;
    double *displacements;
    int32_t tets[TARGETS];       /* each target is the centroid of a tetrahedron */
    double targets[TARGETS][3];  /* m */
} set_up;

static double random_between(double low, double high) { return low + (high - low) * rand() / RAND_MAX; }

static void set_up_model(trocar_model *model, set_up *s) {
    s->model = model;
    OK(trocar_sim_create(model, &s->sim, &why));
    s->displacements = malloc(3 * (size_t)trocar_model_node_count(model) * sizeof *s->displacements);
}

static void set_down(set_up *s) {
    trocar_sim_free(s->sim);
    free(s->displacements);
}

/* Chooses tetrahedra near the needle's end or farther away, in the middle of the mesh. */
static void choose_targets(set_up *s) {
    const double *nodes = trocar_model_nodes(s->model);
    const int32_t *tets = trocar_model_tets(s->model);
    for (int t = 0; t < TARGETS; t++) {
        s->tets[t] = rand() % trocar_model_tet_count(s->model);
        for (int k = 0; k < 3; k++) {
            s->targets[t][k] = 0.0;
            for (int c = 0; c < 4; c++) s->targets[t][k] += 0.25 * nodes[3 * tets[4 * s->tets[t] + c] + k];
        }
    }
}

/* Reads the values that are differentiated, after a step. */
static void read_values(const set_up *s, const trocar_output *out, double values[VALUES]) {
    double joints[TROCAR_MAX_JOINTS][3], length = 0.0;
    const trocar_view *view = trocar_sim_view(s->sim);
    const int32_t *tets = trocar_model_tets(s->model);
    int end = trocar_view_centreline(view, 0, joints[0], TROCAR_MAX_JOINTS) - 1;
    OK(trocar_view_displacements(view, s->displacements, &why));
    for (int k = 0; k < 3; k++) length += pow(joints[end][k] - joints[end - 1][k], 2.0);
    for (int k = 0; k < 3; k++) {
        values[k] = out->force[k];
        values[3 + k] = out->torque[k];
        values[6 + k] = joints[end][k];
        values[9 + k] = (joints[end][k] - joints[end - 1][k]) / sqrt(length);
        for (int t = 0; t < TARGETS; t++) {
            values[12 + 3 * t + k] = s->targets[t][k];
            for (int c = 0; c < 4; c++) values[12 + 3 * t + k] += 0.25 * s->displacements[3 * tets[4 * s->tets[t] + c] + k];
        }
    }
}

/* Differentiates a step. derivatives[i][v]: derivative of value i with respect to variable v. */
static void differentiate(const set_up *s, const trocar_pose *base, const trocar_parameter *parameters, int count, trocar_output *out,
                          double derivatives[VALUES][VARIABLES], double range[BASE]) {
    const int variables = BASE + count;
    double all[VALUES * VARIABLES];
    trocar_derivative_request request = {.parameters = parameters, .parameter_count = count, .targets = s->targets[0], .target_count = TARGETS};
    trocar_derivatives results = {.wrench = all, .tip = all + 6 * variables, .direction = all + 9 * variables, .targets = all + 12 * variables, .range = range};
    OK(trocar_sim_differentiate(s->sim, 0, base, DT, &request, out, &results, &why));
    for (int i = 0; i < VALUES; i++)
        for (int v = 0; v < variables; v++) derivatives[i][v] = all[i * variables + v];
}

/* ---- poses ------------------------------------------------------------------------------------------------------------------ */

/* Turns an orientation about the world's axes by a rotation vector (rad). */
static void turn(const double by[3], double q[4]) {
    double angle = sqrt(by[0] * by[0] + by[1] * by[1] + by[2] * by[2]), half = angle > 0.0 ? sin(0.5 * angle) / angle : 0.5, w = cos(0.5 * angle);
    double x = half * by[0], y = half * by[1], z = half * by[2];
    const double p[4] = {q[0], q[1], q[2], q[3]};
    q[0] = w * p[0] - x * p[1] - y * p[2] - z * p[3];
    q[1] = w * p[1] + x * p[0] + y * p[3] - z * p[2];
    q[2] = w * p[2] - x * p[3] + y * p[0] + z * p[1];
    q[3] = w * p[3] + x * p[2] - y * p[1] + z * p[0];
    double norm = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int k = 0; k < 4; k++) q[k] /= norm;
}

static trocar_pose moved(trocar_pose base, int variable, double by) {
    double rotation[3] = {0.0};
    if (variable < 3) base.position[variable] += by;
    else rotation[variable - 3] = by;
    turn(rotation, base.orientation);
    return base;
}

/* ---- random states ------------------------------------------------------------------------------------------------------------ */

/* Inserts the needle at a random speed and angle, then pushes, slows down, holds or withdraws it while its base moves sideways and tilts. `state` is the state
   before the last step, whose pose is returned. */
static trocar_pose reach_state(const set_up *s, void *state, size_t size) {
    trocar_pose base = {{random_between(1e-3, 9e-3), random_between(-1e-3, 7e-3), -0.201}, {1, 0, 0, 0}};
    trocar_output out;
    double speed = random_between(5e-3, 60e-3), aside[2], tilt[3] = {0.0};
    int insertion = (int)(random_between(0.015, 0.07) / (speed * DT)), last = 1 + rand() % 60;
    const double factors[] = {1.0, -1.0, 0.3, 0.0};
    OK(trocar_sim_reset(s->sim, 0, &base, &why));
    for (int k = 0; k < 2; k++) aside[k] = random_between(-4e-6, 4e-6), tilt[k] = random_between(-3e-5, 3e-5);
    for (int t = 0; t < insertion + last; t++) {
        if (t == insertion) speed *= factors[rand() % 4];
        if (t == insertion) for (int k = 0; k < 2; k++) aside[k] = random_between(-2e-5, 2e-5), tilt[k] = random_between(-1e-4, 1e-4);
        base.position[0] += aside[0];
        base.position[1] += aside[1];
        base.position[2] += speed * DT;
        turn(tilt, base.orientation);
        if (t == insertion + last - 1) OK(trocar_sim_save(s->sim, state, size, &why));
        OK(trocar_sim_step(s->sim, 0, &base, DT, &out, &why));
    }
    return base;
}

/* Central differences from the saved state. */
static void difference(const set_up *s, const void *state, size_t size, const trocar_pose *base, const double steps[BASE], double differences[VALUES][VARIABLES]) {
    for (int v = 0; v < BASE; v++) {
        double values[2][VALUES];
        for (int side = 0; side < 2; side++) {
            trocar_output out;
            trocar_pose there = moved(*base, v, side == 0 ? steps[v] : -steps[v]);
            OK(trocar_sim_restore(s->sim, state, size, &why));
            OK(trocar_sim_step(s->sim, 0, &there, DT, &out, &why));
            read_values(s, &out, values[side]);
        }
        for (int i = 0; i < VALUES; i++) differences[i][v] = (values[0][i] - values[1][i]) / (2.0 * steps[v]);
    }
}

/* Norm of a vector's derivatives, with each variable in units of its scale. */
static double norm_of(double derivatives[VALUES][VARIABLES], double minus[VALUES][VARIABLES], int block, int from, int to, const double scales[VARIABLES]) {
    double sum = 0.0;
    for (int i = 3 * block; i < 3 * block + 3; i++)
        for (int v = from; v < to; v++) sum += pow((derivatives[i][v] - (minus ? minus[i][v] : 0.0)) * scales[v], 2.0);
    return sqrt(sum);
}

typedef struct {
    int switches;
    double largest[BLOCKS];  /* relative error away from switches */
} comparison;

/* Compares in `count` random states. At a switch, a contact would start or stop sliding within the steps of the differences. */
static comparison compare(int count) {
    static const double scales[VARIABLES] = {1, 1, 1, 1 / LENGTH, 1 / LENGTH, 1 / LENGTH};
    static const double steps[BASE] = {1e-8, 1e-8, 1e-8, 1e-7, 1e-7, 1e-7}; /* m, rad */
    trocar_scene *scene = exact_scene();
    trocar_model *model;
    set_up s;
    comparison found = {0};
    OK(trocar_model_create(scene, NULL, &model, &why));
    set_up_model(model, &s);
    size_t size = trocar_sim_state_size(s.sim);
    void *state = malloc(size);
    srand(1);
    for (int i = 0; i < count; i++) {
        double exact[VALUES][VARIABLES], differences[VALUES][VARIABLES], range[BASE];
        trocar_output out;
        trocar_pose base = reach_state(&s, state, size);
        choose_targets(&s);
        OK(trocar_sim_restore(s.sim, state, size, &why));
        differentiate(&s, &base, NULL, 0, &out, exact, range);
        bool switches = false;
        for (int v = 0; v < BASE; v++) switches = switches || range[v] < 2.0 * steps[v];
        found.switches += switches;
        if (switches) continue;
        difference(&s, state, size, &base, steps, differences);
        for (int block = 0; block < BLOCKS; block++)
            found.largest[block] = fmax(found.largest[block], norm_of(exact, differences, block, 0, BASE, scales) / norm_of(differences, NULL, block, 0, BASE, scales));
    }
    free(state);
    set_down(&s);
    trocar_model_free(model);
    trocar_scene_free(scene);
    print_message("%d random states, %d at a switch; largest relative errors:", count, found.switches);
    for (int block = 0; block < BLOCKS; block++) print_message(" %s %.1e", BLOCK_NAMES[block], found.largest[block]);
    print_message("\n");
    return found;
}

static void check(comparison found, int count) {
    for (int block = 0; block < BLOCKS; block++) assert_true(found.largest[block] < 1e-2);
    assert_true(10 * found.switches <= count);
}

static void derivatives_are_those_of_small_motions(void **unused) {
    (void)unused;
    check(compare(20), 20);
}

/* The environment variable sets another number of states; 1000 take a few minutes. */
static void derivatives_are_those_of_small_motions_in_many_states(void **unused) {
    (void)unused;
    const char *given = getenv("TROCAR_TEST_STATES");
    int count = given ? atoi(given) : 200;
    check(compare(count), count);
}

/* ---- properties of the tissue ------------------------------------------------------------------------------------------------- */

static const struct {
    const char *key;
    trocar_property property;
} PROPERTIES[] = {{"cutting_force", TROCAR_CUTTING_FORCE}, {"cutting_viscosity", TROCAR_CUTTING_VISCOSITY}, {"friction.static", TROCAR_FRICTION_STATIC},
                  {"friction.kinetic", TROCAR_FRICTION_KINETIC}, {"friction.viscous", TROCAR_FRICTION_VISCOUS},
                  {"youngs_modulus", TROCAR_YOUNGS_MODULUS}};
static const char *const REGIONS[] = {"prostate", "surrounding"};

/* Without force, the state does not depend on these properties: a needle that starts in the tissue is held for two steps, and then moved. */
static void start_in_tissue(const set_up *s, const trocar_pose *start) {
    trocar_output out;
    OK(trocar_sim_reset(s->sim, 0, start, &why));
    for (int t = 0; t < 2; t++) OK(trocar_sim_step(s->sim, 0, start, DT, &out, &why));
}

/* A model with one property changed. Only a modulus changes the stiffness matrix. */
static trocar_model *model_with(const trocar_model *base, int parameter, double factor, double *value) {
    trocar_scene *scene = exact_scene();
    trocar_model *model;
    char key[80];
    snprintf(key, sizeof key, "regions[%s].%s", REGIONS[parameter % 2], PROPERTIES[parameter / 2].key);
    OK(trocar_scene_get_number(scene, key, value, &why));
    OK(trocar_scene_set_number(scene, key, factor * *value, &why));
    if (PROPERTIES[parameter / 2].property == TROCAR_YOUNGS_MODULUS) OK(trocar_model_create(scene, NULL, &model, &why));
    else OK(trocar_model_derive(base, scene, &model, &why));
    trocar_scene_free(scene);
    return model;
}

static void values_with(const set_up *like, trocar_model *model, const trocar_pose *start, const trocar_pose *base, double values[VALUES]) {
    trocar_output out;
    set_up s = *like;
    set_up_model(model, &s);
    start_in_tissue(&s, start);
    OK(trocar_sim_step(s.sim, 0, base, DT, &out, &why));
    read_values(&s, &out, values);
    set_down(&s);
}

/* Force with torque, and the needle's end with its direction, both related by the needle's length: properties of the tissue hardly bend a straight needle, so that
   torque and direction alone would be differences of larger numbers. */
enum { GROUPS = 3 };
static const char *const GROUP_NAMES[GROUPS] = {"wrench", "needle's end", "targets"};

static double norm_of_group(double derivatives[VALUES][VARIABLES], double minus[VALUES][VARIABLES], int group, const double scales[VARIABLES]) {
    const double lengths[GROUPS] = {1.0 / LENGTH, LENGTH, 1.0};
    double first = norm_of(derivatives, minus, 2 * group, BASE, VARIABLES, scales), second = norm_of(derivatives, minus, 2 * group + 1, BASE, VARIABLES, scales);
    return hypot(first, lengths[group] * second);
}

static void derivatives_are_those_of_small_changes_of_the_tissue(void **unused) {
    (void)unused;
    trocar_scene *scene = exact_scene();
    trocar_model *model;
    set_up s;
    int depends[PARAMETERS] = {0};
    static const double limits[GROUPS] = {2e-2, 5e-2, 5e-2};
    double largest[GROUPS] = {0.0}, scales[VARIABLES];
    trocar_model *changed[PARAMETERS][2];
    OK(trocar_model_create(scene, NULL, &model, &why));
    set_up_model(model, &s);
    for (int i = 0; i < PARAMETERS; i++)
        for (int side = 0; side < 2; side++) changed[i][side] = model_with(model, i, side == 0 ? 1.001 : 0.999, &scales[BASE + i]);
    srand(2);
    for (int state = 0; state < 12; state++) {
        trocar_parameter parameters[PARAMETERS];
        double exact[VALUES][VARIABLES], range[BASE];
        trocar_output out;
        trocar_pose start = {{random_between(2e-3, 8e-3), random_between(0, 6e-3), random_between(-0.17, -0.135)}, {1, 0, 0, 0}}, base = start;
        /* The passes of a step end when the needle's shape does not change any more: it has to bend, so that they end after friction has settled, too. */
        base.position[0] += random_between(0.3e-3, 1e-3);
        base.position[2] += (state % 3 == 2 ? -1.0 : 1.0) * (state >= 8 ? 3e-3 : random_between(0.3e-3, 1.5e-3)); /* the last ones cut */
        choose_targets(&s);
        for (int i = 0; i < PARAMETERS; i++)
            parameters[i] = (trocar_parameter){.property = (int32_t)PROPERTIES[i / 2].property, .region = trocar_model_find_region(model, REGIONS[i % 2], 3)};
        start_in_tissue(&s, &start);
        differentiate(&s, &base, parameters, PARAMETERS, &out, exact, range);
        assert_true(out.contacts > 2);
        double differences[VALUES][VARIABLES];
        for (int i = 0; i < PARAMETERS; i++) {
            double high[VALUES], low[VALUES];
            values_with(&s, changed[i][0], &start, &base, high);
            values_with(&s, changed[i][1], &start, &base, low);
            for (int k = 0; k < VALUES; k++) differences[k][BASE + i] = (high[k] - low[k]) / (0.002 * scales[BASE + i]);
            depends[i] += norm_of(differences, NULL, 0, BASE + i, BASE + i + 1, scales) > 1e-3;
        }
        for (int group = 0; group < GROUPS; group++) {
            double error = norm_of_group(exact, differences, group, scales) / norm_of_group(differences, NULL, group, scales);
            if (!(error < limits[group])) fail_msg("state %d: relative error %g of the %s", state, error, GROUP_NAMES[group]);
            largest[group] = fmax(largest[group], error);
        }
    }
    print_message("largest relative errors: %s %.1e, %s %.1e, %s %.1e\n", GROUP_NAMES[0], largest[0], GROUP_NAMES[1], largest[1], GROUP_NAMES[2], largest[2]);
    for (int i = 4; i < PARAMETERS; i++) /* friction and moduli; in these states, membranes stop most tips before they cut */
        if (depends[i] == 0) fail_msg("no force depended on %s of %s", PROPERTIES[i / 2].key, REGIONS[i % 2]);
    for (int i = 0; i < PARAMETERS; i++)
        for (int side = 0; side < 2; side++) trocar_model_free(changed[i][side]);
    set_down(&s);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

/* ---- the call ------------------------------------------------------------------------------------------------------------------ */

static void differentiating_changes_no_result(void **unused) {
    (void)unused;
    trocar_scene *scene;
    trocar_model *model;
    set_up s[2];
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    for (int i = 0; i < 2; i++) set_up_model(model, &s[i]);
    choose_targets(&s[1]);
    trocar_pose base = {{5e-3, 3e-3, -0.2005}, {1, 0, 0, 0}};
    for (int i = 0; i < 2; i++) OK(trocar_sim_reset(s[i].sim, 0, &base, &why));
    for (int t = 0; t < 300; t++) {
        double exact[VALUES][VARIABLES], range[BASE];
        trocar_output with, without;
        base.position[0] += 5e-6;
        base.position[2] += 50e-6;
        OK(trocar_sim_step(s[0].sim, 0, &base, DT, &without, &why));
        differentiate(&s[1], &base, NULL, 0, &with, exact, range);
        assert_memory_equal(&with, &without, sizeof with);
    }
    for (int i = 0; i < 2; i++) set_down(&s[i]);
    trocar_model_free(model);
}

static void bad_requests_are_refused_before_the_step(void **unused) {
    (void)unused;
    trocar_scene *scene;
    trocar_model *model;
    set_up s;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    set_up_model(model, &s);
    trocar_pose base = {{5e-3, 3e-3, -0.2005}, {1, 0, 0, 0}};
    trocar_output out;
    double derivatives[200];
    const double outside[3] = {1.0, 0.0, 0.0}, undefined[3] = {NAN, 0.0, 0.0};
    const trocar_parameter surface = {TROCAR_CUTTING_FORCE, trocar_model_find_region(model, "skin", 2)}, unknown = {17, 0};
    const trocar_derivatives results = {.wrench = derivatives, .targets = derivatives + 100};
    const trocar_derivative_request bad[] = {{.targets = outside, .target_count = 1}, {.targets = undefined, .target_count = 1}, {.target_count = -1},
                                             {.parameters = &surface, .parameter_count = 1}, {.parameters = &unknown, .parameter_count = 1},
                                             {.parameters = &surface, .parameter_count = TROCAR_MAX_PARAMETERS + 1}};
    OK(trocar_sim_reset(s.sim, 0, &base, &why));
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        assert_int_equal(trocar_sim_differentiate(s.sim, 0, &base, DT, &bad[i], &out, &results, &why), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_sim_differentiate(s.sim, 0, &base, 2e-3, NULL, &out, &results, &why), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_sim_differentiate(s.sim, 1, &base, DT, NULL, &out, &results, &why), TROCAR_BAD_INPUT);
    assert_true(trocar_view_time(trocar_sim_view(s.sim)) == 0.0);
    OK(trocar_sim_differentiate(s.sim, 0, &base, DT, NULL, &out, &results, &why)); /* in the air, the needle's end moves with the base, without force */
    for (int i = 0; i < 36; i++) assert_true(derivatives[i] == 0.0);
    set_down(&s);
    trocar_model_free(model);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(derivatives_are_those_of_small_motions),
        cmocka_unit_test(derivatives_are_those_of_small_motions_in_many_states),
        cmocka_unit_test(derivatives_are_those_of_small_changes_of_the_tissue),
        cmocka_unit_test(differentiating_changes_no_result),
        cmocka_unit_test(bad_requests_are_refused_before_the_step),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Compares the needle made of tetrahedra with beam theory, with its own energy, and with the rod in tissue. */
#include "bending_solid.h"
#include "lockstep.h"
#include "shared/motion.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static const pose ORIGIN = {{0, 0, 0}, {1, 0, 0, 0}};
static const int SEGMENTS[] = {10, 20, 40};

static solid_model make(int segments) { return solid_made(segments); }

/* Returns the tip's deflection (m) along the load and across it. */
static vec3 bent_tip(const solid_model *model, double angle, double force, solid_tangent *tangent) {
    solid_state state;
    solid_rest(model, ORIGIN, &state);
    vec3 along = v3(cos(angle), sin(angle), 0), across = v3(-sin(angle), cos(angle), 0);
    solid_bend(model, &state, v3_scale(force, along), tangent);
    vec3 tip = solid_tip_of(model, &state);
    return v3(v3_dot(tip, along), v3_dot(tip, across), tip.z);
}

static void bending_is_isotropic(void **unused) {
    (void)unused;
    enum { DIRECTIONS = 9 }; /* within a right angle, because a quarter turn is a symmetry of the mesh */
    solid_tangent *tangent = malloc(sizeof *tangent);
    for (int s = 0; s < 3; s++) {
        solid_model model = make(SEGMENTS[s]);
        double least = INFINITY, most = 0.0, across = 0.0;
        for (int d = 0; d < DIRECTIONS; d++) { /* a load of 2 EI / L^2 deflects the needle by half its length */
            vec3 tip = bent_tip(&model, 0.5 * M_PI * d / DIRECTIONS, 2.0 * model.line.bending / 0.04, tangent);
            least = fmin(least, tip.x), most = fmax(most, tip.x), across = fmax(across, fabs(tip.y));
        }
        double mean = 0.5 * (least + most);
        print_message("%d segments: deflection %.4f of the length, within %.5f, across %.5f\n", SEGMENTS[s], mean / 0.2,
                      (most - mean) / mean, across / mean);
        assert_true((most - mean) / mean < 5e-3 && across / mean < 5e-3);
    }
    free(tangent);
}

static void small_deflection_matches_a_cantilever(void **unused) {
    (void)unused;
    solid_tangent *tangent = malloc(sizeof *tangent);
    for (int s = 0; s < 3; s++) {
        int n = SEGMENTS[s], middle = n / 2;
        solid_model model = make(n);
        double expected = 1e-3 * pow(0.2, 3) / (3.0 * model.line.bending);
        assert_true(fabs(bent_tip(&model, 0.4, 1e-3, tangent).x / expected - 1.0) < 1e-4);
        /* The compliance between the middle and the tip is a^2 (3 L - a) / (6 EI). Locking adds a relative error of 1 / N^2. */
        expected = 0.01 * (0.6 - 0.1) / (6.0 * model.line.bending);
        assert_true(fabs(tangent->line.compliance[3 * middle][3 * n] / expected - 1.0) < 1.0 / (n * n));
    }
    free(tangent);
}

static void large_deflection_follows_the_elastica(void **unused) {
    (void)unused;
    solid_tangent *tangent = malloc(sizeof *tangent);
    for (int s = 0; s < 3; s++)
        for (int c = 0; c < 3; c++) {
            double p = (double[]){0.5, 1.0, 2.0}[c], x, y;
            elastica(p, &x, &y);
            solid_model model = make(SEGMENTS[s]);
            vec3 tip = bent_tip(&model, 0.3, p * model.line.bending / 0.04, tangent);
            double limit = SEGMENTS[s] == 10 ? 0.01 : 0.0025;
            assert_true(fabs(tip.x / 0.2 - y) < limit * y && fabs(tip.z / 0.2 - x) < limit);
        }
    free(tangent);
}

/* As in the test of the rod, the loads are below Euler's load, close to it, and above it, where the tangent is indefinite. */
static void axial_load_softens_like_a_beam_column(void **unused) {
    (void)unused;
    solid_model model = make(40);
    solid_tangent *tangent = malloc(sizeof *tangent);
    double euler = M_PI * M_PI * model.line.bending / (4 * 0.04);
    for (int c = 0; c < 3; c++) {
        double compression = (double[]){0.3, 0.8, 2.0}[c] * euler;
        solid_state state;
        solid_rest(&model, ORIGIN, &state);
        solid_bend(&model, &state, v3(0, 0, -compression), tangent);
        double k = sqrt(compression / model.line.bending), expected = tan(k * 0.2) / (k * compression) - 0.2 / compression;
        assert_true(fabs(tangent->line.compliance[120][120] / expected - 1.0) < 5e-3);
        assert_true(fabs(tangent->line.compliance[121][121] / expected - 1.0) < 5e-3);
    }
    free(tangent);
}

static void centreline_is_smooth_and_joins_the_centres(void **unused) {
    (void)unused;
    solid_model model = make(20);
    solid_tangent *tangent = malloc(sizeof *tangent);
    solid_state state;
    solid_rest(&model, ORIGIN, &state);
    solid_bend(&model, &state, v3(0.1, 0.4, 0), tangent);
    needle_point before = needle_at(&model.line, &state.line, 0.0);
    for (int i = 1; i <= 20000; i++) {
        needle_point p = needle_at(&model.line, &state.line, 0.2 * i / 20000);
        assert_true(fabs(v3_norm(v3_sub(p.position, before.position)) / 1e-5 - 1.0) < 2e-3);
        assert_true(v3_norm(v3_sub(needle_along(&p), needle_along(&before))) < 1e-3);
        before = p;
    }
    assert_true(v3_norm(v3_sub(before.position, solid_tip_of(&model, &state))) < 1e-12);
    free(tangent);
}

static void bad_parameters_are_refused(void **unused) {
    (void)unused;
    trocar_error why;
    solid_model model;
    needle_parameters p = gauge18(40);
    p.poisson_ratio = 0.5;
    assert_int_equal(solid_create(&p, &model, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "poisson_ratio"));
}

static void rigid_motions_give_no_force(void **unused) {
    (void)unused;
    solid_model model = make(20);
    solid_tangent *tangent = malloc(sizeof *tangent);
    solid_state state;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    double stiffness = model.line.bending / pow(0.2, 2); /* N, a load that bends the needle considerably */
    for (int i = 0; i < 20; i++) {
        solid_rest(&model, (pose){v3(0.02 * i, -0.01 * i, 0.2), q_exp(v3(0.3 * i, 1.0 - 0.2 * i, 0.1 * i))}, &state);
        solid_linearise(&model, &state, load, 0, tangent);
        for (int k = 0; k <= 20; k++)
            for (int a = 0; a < SOLID_SECTION; a++) assert_true(v3_norm(tangent->internal[k][a]) < 1e-8 * stiffness);
        assert_true(solid_energy(&model, &state) < 1e-16);
    }
    free(tangent);
}

/* Moves every node by a random fraction of the radius, so that the shape is far from the rest shape. */
static void distort(solid_state *state, int segments) {
    srand(3);
    for (int k = 1; k <= segments; k++)
        for (int i = 0; i < SOLID_SECTION; i++) {
            vec3 *x = i == 0 ? &state->line.joints[k] : &state->rim[k][i - 1];
            double *c[3] = {&x->x, &x->y, &x->z};
            for (int a = 0; a < 3; a++) *c[a] += 1e-4 * (2.0 * rand() / RAND_MAX - 1.0);
        }
}

/* Compares forces and stiffness with central differences of the energy, which is a fourth-degree polynomial in the node positions. */
static void forces_are_the_gradient_of_the_energy(void **unused) {
    (void)unused;
    enum { N = 4 };
    solid_model model = make(N);
    solid_tangent *tangent = malloc(sizeof *tangent);
    solid_state state;
    vec3 load[N + 1] = {{0}};
    solid_rest(&model, (pose){v3(0, 0, 0), q_exp(v3(0.3, -0.4, 0.5))}, &state);
    distort(&state, N);
    solid_linearise(&model, &state, load, 0, tangent);
    double size = 0.0, step = 1e-7;
    for (int k = 1; k <= N; k++)
        for (int i = 0; i < SOLID_SECTION; i++) size = fmax(size, v3_norm(tangent->internal[k][i]));
    for (int k = 1; k <= N; k++)
        for (int i = 0; i < SOLID_SECTION; i++) {
            vec3 *x = i == 0 ? &state.line.joints[k] : &state.rim[k][i - 1];
            double *c[3] = {&x->x, &x->y, &x->z}, force[3];
            memcpy(force, &tangent->internal[k][i], sizeof force);
            for (int a = 0; a < 3; a++) {
                double at = *c[a];
                *c[a] = at + step;
                double above = solid_energy(&model, &state);
                *c[a] = at - step;
                double below = solid_energy(&model, &state);
                *c[a] = at;
                assert_true(fabs((above - below) / (2 * step) - force[a]) < 1e-5 * size);
            }
        }
    free(tangent);
}

static void newton_converges_quadratically(void **unused) {
    (void)unused;
    solid_model model = make(40);
    solid_state state;
    solid_tangent *tangent = malloc(sizeof *tangent);
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    solid_rest(&model, (pose){v3(0, 0, 0), q_exp(v3(0.3, -0.4, 0.5))}, &state);
    load[40] = v3(0.1, 0.25, -0.1);
    load[22] = v3(-0.2, 0.2, 0.3);
    double change[12];
    int passes = 0;
    for (bool done = false; passes < 12 && !done; passes++) {
        solid_linearise(&model, &state, load, 40, tangent);
        change[passes] = solid_advance(&model, tangent, load, &state);
        done = change[passes] < 1e-10;
    }
    assert_true(passes <= 8 && change[passes - 1] < 1e-10);
    assert_true(change[passes - 1] < fmax(1e-10, 10 * change[passes - 2] * change[passes - 2]));
    /* The moment in the clamped section balances the loads' moment about the base. */
    vec3 base = state.line.base.position, moment = v3_cross(v3_sub(state.line.joints[40], base), load[40]);
    moment = v3_add(moment, v3_cross(v3_sub(state.line.joints[22], base), load[22]));
    assert_true(v3_norm(v3_sub(solid_root_moment(&model, &state), moment)) < 1e-8 * v3_norm(moment));
    free(tangent);
}

static void rotated_base_gives_rotated_shape(void **unused) {
    (void)unused;
    solid_model model = make(20);
    solid_tangent *tangent = malloc(sizeof *tangent);
    solid_state plain, turned;
    quat q = q_exp(v3(0.7, -1.1, 2.0));
    vec3 shift = v3(0.3, -0.2, 0.1), force = v3(0.1, 0.3, -0.4);
    solid_rest(&model, ORIGIN, &plain);
    solid_rest(&model, (pose){shift, q}, &turned);
    solid_bend(&model, &plain, force, tangent);
    solid_bend(&model, &turned, q_rotate(q, force), tangent);
    for (int k = 0; k <= 20; k++)
        assert_true(v3_norm(v3_sub(turned.line.joints[k], v3_add(shift, q_rotate(q, plain.line.joints[k])))) < 1e-9);
    free(tangent);
}

/* After the base has been rolled and shifted as far as a hand can move it in one or two ticks, a free needle has followed and is straight again. */
static void free_needle_follows_its_base(void **unused) {
    (void)unused;
    solid_model model = make(20);
    solid_tangent *tangent = malloc(sizeof *tangent);
    solid_state state, straight;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    pose moved = {v3(0.01, 0.02, -0.03), q_exp(v3(0.15, -0.02, 0.8))};
    solid_rest(&model, ORIGIN, &state);
    solid_rest(&model, moved, &straight);
    solid_hold(&model, moved, &state);
    for (int i = 0; i < 8; i++) {
        solid_linearise(&model, &state, load, 0, tangent);
        solid_advance(&model, tangent, load, &state);
    }
    for (int k = 0; k <= 20; k++) assert_true(v3_norm(v3_sub(state.line.joints[k], straight.line.joints[k])) < 1e-10);
    vec3 y = q_rotate(state.line.frames[19], v3(0, 1, 0)), expected = q_rotate(moved.orientation, v3(0, 1, 0));
    assert_true(v3_norm(v3_sub(y, expected)) < 1e-8);
    free(tangent);
}

enum { TICKS = 2400 };

static void run_figure8(bool solid, double (*wrench)[6], double *punctures) {
    simulation_config c = lockstep_config();
    solid_in_tissue(solid ? &c.needle : NULL);
    lockstep *l = lockstep_create(&c, lockstep_start());
    for (int i = 0, found = 0; i < TICKS; i++) {
        lockstep_tick(l, motion_pose(motion_find("figure8"), lockstep_start(), (i + 1) * 1e-3), 1e-3);
        memcpy(wrench[i], &l->wrench.force, sizeof(vec3));
        memcpy(wrench[i] + 3, &l->wrench.torque, sizeof(vec3));
        if (l->wrench.events & EVENT_PUNCTURED && found < 2) punctures[found++] = 1e-3 * i;
        assert_false(l->wrench.events & EVENT_UNSTABLE);
    }
    lockstep_free(l);
}

/* Returns the RMS difference between components [from, to) of a and b, relative to the RMS of b. */
static double difference(double (*a)[6], double (*b)[6], int from, int to) {
    double off = 0.0, size = 0.0;
    for (int i = 0; i < TICKS; i++)
        for (int k = from; k < to; k++) off += pow(a[i][k] - b[i][k], 2), size += pow(b[i][k], 2);
    return sqrt(off / size);
}

static void insertion_forces_match_the_rod(void **unused) {
    (void)unused;
    double (*rod)[6] = calloc(TICKS, sizeof *rod), (*tets)[6] = calloc(TICKS, sizeof *tets);
    double rod_at[2] = {0}, tets_at[2] = {0};
    run_figure8(false, rod, rod_at);
    run_figure8(true, tets, tets_at);
    double force = difference(tets, rod, 0, 3), torque = difference(tets, rod, 3, 6);
    print_message("figure 8: force differs by %.4f, torque by %.4f\n", force, torque);
    assert_true(force < 0.03 && torque < 0.03);
    for (int i = 0; i < 2; i++) assert_true(rod_at[i] > 0.0 && fabs(tets_at[i] - rod_at[i]) < 5e-3);
    free(tets);
    free(rod);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(bending_is_isotropic),
        cmocka_unit_test(small_deflection_matches_a_cantilever),
        cmocka_unit_test(large_deflection_follows_the_elastica),
        cmocka_unit_test(axial_load_softens_like_a_beam_column),
        cmocka_unit_test(centreline_is_smooth_and_joins_the_centres),
        cmocka_unit_test(bad_parameters_are_refused),
        cmocka_unit_test(rigid_motions_give_no_force),
        cmocka_unit_test(forces_are_the_gradient_of_the_energy),
        cmocka_unit_test(newton_converges_quadratically),
        cmocka_unit_test(rotated_base_gives_rotated_shape),
        cmocka_unit_test(free_needle_follows_its_base),
        cmocka_unit_test(insertion_forces_match_the_rod),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* The rigid motion of a region: known motions come back, and those of a uniformly strained body are its mean. */
#include "lockstep.h"
#include "region_motion.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

enum { POINTS = 50 };

static void scatter(vec3 *points) {
    unsigned seed = 7;
    for (int i = 0; i < POINTS; i++) {
        double x[3];
        for (int k = 0; k < 3; k++) {
            seed = seed * 1664525u + 1013904223u;
            x[k] = 0.04 * (seed >> 8) / (1 << 24) + 0.1 * k;
        }
        points[i] = v3(x[0], 0.6 * x[1], x[2]);
    }
}

static void known_motions_are_recovered(void **unused) {
    (void)unused;
    const vec3 shift = v3(0.003, -0.002, 0.005);
    const vec3 turns[] = {v3(0, 0, 0), v3(1e-5, 0, 0), v3(0.1, -0.2, 0.05), v3(0, 0.24, 0), v3(0, 0, 3.0), v3(-1.5, 0.7, 0.9)};
    vec3 from[POINTS], displacement[POINTS], centre = v3(0, 0, 0);
    scatter(from);
    for (int i = 0; i < POINTS; i++) centre = v3_axpy(1.0 / POINTS, from[i], centre);
    for (size_t k = 0; k < sizeof turns / sizeof *turns; k++) {
        for (int i = 0; i < POINTS; i++) {
            vec3 arm = v3_sub(from[i], centre);
            displacement[i] = v3_add(v3_sub(q_rotate(q_exp(turns[k]), arm), arm), shift);
        }
        rigid_motion motion = rigid_motion_fit(POINTS, from, displacement);
        assert_true(v3_norm(v3_sub(motion.shift, shift)) < 1e-12);
        assert_true(v3_norm(v3_sub(motion.turn, turns[k])) < 1e-9);
    }
}

/* The eight corners of a box: symmetric, so that stretching does not turn it, and simple shear g turns it by about g/2. */
static void strain_is_not_a_rotation(void **unused) {
    (void)unused;
    vec3 from[8], stretched[8], sheared[8];
    for (int i = 0; i < 8; i++) {
        from[i] = v3(i & 1 ? 1 : -1, i & 2 ? 1 : -1, i & 4 ? 1 : -1);
        stretched[i] = v3(0.2 * from[i].x, -0.1 * from[i].y, 0.05 * from[i].z);
        sheared[i] = v3(0.02 * from[i].z, 0, 0);
    }
    assert_true(v3_norm(rigid_motion_fit(8, from, stretched).turn) < 1e-12);
    vec3 turn = rigid_motion_fit(8, from, sheared).turn;
    assert_true(fabs(turn.y - 0.01) < 1e-5 && fabs(turn.x) < 1e-12 && fabs(turn.z) < 1e-12);
}

static void coplanar_points_have_no_rotation(void **unused) {
    (void)unused;
    vec3 from[4] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}}, displacement[4];
    for (int i = 0; i < 4; i++) displacement[i] = v3(0, 0, 0.1 * i);
    assert_true(v3_norm(rigid_motion_fit(4, from, displacement).turn) == 0.0);
}

/* By reciprocity (Maxwell, Betti) the gland's mean displacement in a direction is the work of the needle's forces on the field of
   a unit force spread over the gland's nodes: one static solve that knows nothing of refinement. */
static double shift_by_reciprocity(const lockstep *l, const region_motion *motion, vec3 direction) {
    const mesh *m = &l->simulation.mesh;
    vec3 *unit = calloc((size_t)m->node_count, sizeof *unit), *field = calloc((size_t)m->node_count, sizeof *field);
    for (int i = 0; i < motion->region->node_count; i++) unit[motion->region->nodes[i]] = v3_scale(1.0 / motion->region->node_count, direction);
    inverse_apply(l->simulation.inverse, unit, field);
    double work = 0.0;
    for (int i = 0; i <= l->state.active; i++) {
        bool tip = i == l->state.active;
        int tet = tip ? l->state.tip.tet : l->state.refined.nodes[i].tet;
        double weights[4];
        mesh_barycentric(m, tet, tip ? l->state.tip.nominal : l->state.refined.nodes[i].position, weights);
        for (int c = 0; c < 4; c++)
            work += weights[c] * v3_dot(tip ? tip_load(&l->state.tip) : l->state.contacts[i].force, field[m->tets[tet][c]]);
    }
    free(unit);
    free(field);
    return work;
}

static vec3 check_shift(lockstep *l, region_motion *motion) {
    vec3 shift = region_motion_now(&l->simulation, &l->state, motion).shift;
    vec3 expected = v3(shift_by_reciprocity(l, motion, v3(1, 0, 0)), shift_by_reciprocity(l, motion, v3(0, 1, 0)),
                       shift_by_reciprocity(l, motion, v3(0, 0, 1)));
    assert_true(v3_norm(v3_sub(shift, expected)) < 1e-9 * v3_norm(expected));
    return shift;
}

/* Pushed in, the gland goes with the needle; pulled back, it comes back and past its place; swept aside, it follows. */
static void gland_is_displaced_by_the_needle(void **unused) {
    (void)unused;
    simulation_config config = lockstep_config();
    lockstep *l = lockstep_create(&config, lockstep_start());
    region_motion motion;
    report why;
    assert_int_equal(region_motion_create(&l->simulation, "liver", &motion, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "liver"));
    assert_int_equal(region_motion_create(&l->simulation, "prostate", &motion, &why), TROCAR_OK);
    assert_true(v3_norm(region_motion_now(&l->simulation, &l->state, &motion).shift) == 0.0);
    lockstep_move(l, v3(0, 0, 0.06), 1.2, 1e-3);
    assert_true(check_shift(l, &motion).z > 0.0);
    lockstep_move(l, v3(0, 0, -0.01), 0.2, 1e-3);
    vec3 pulled = check_shift(l, &motion);
    assert_true(pulled.z < 0.0);
    lockstep_move(l, v3(0.01, 0, 0), 0.2, 1e-3);
    assert_true(check_shift(l, &motion).x > pulled.x);
    region_motion_free(&motion);
    lockstep_free(l);
}

/* ---- the loosely bedded gland of twist.yaml ------------------------------------------------------------------------------ */

static const double PUBLISHED[2] = {-11.2, 13.8}; /* deg in the coronal plane, in patients (Lagerburg et al. 2005) */

typedef struct { double x, bedding, grip; bool loose_arch; } twist_case; /* m off the midplane; the surroundings' modulus and the gland's friction, of the scene's */

typedef struct { double low, high, pushed, pulled; } twist; /* deg in the coronal plane; mm of shift along the needle */

/* A needle parallel to the body's axis, 120 mm in and out again. */
static twist insert_and_draw_back(const char *title, twist_case given) {
    simulation_config c = lockstep_scene(MESHES "/twist.yaml");
    for (int i = 0; i < c.region_count; i++) {
        region_material *m = &c.regions[i].material;
        if (strcmp(c.regions[i].name, "prostate") == 0) m->friction_static *= given.grip, m->friction_kinetic *= given.grip;
        else m->youngs_modulus *= given.bedding;
    }
    assert_string_equal(c.fixed[c.fixed_count - 1], "bone");
    c.fixed_count -= given.loose_arch;
    lockstep *l = lockstep_create(&c, (pose){v3(given.x, -0.004, -1e-3 - c.needle.length), {1, 0, 0, 0}});
    region_motion motion;
    report why;
    assert_int_equal(region_motion_create(&l->simulation, "prostate", &motion, &why), TROCAR_OK);
    twist t = {0};
    for (int i = 0; i < 2400; i++) {
        pose base = l->base;
        base.position.z += i < 1200 ? 1e-4 : -1e-4;
        lockstep_tick(l, base, 2e-3);
        rigid_motion now = region_motion_now(&l->simulation, &l->state, &motion);
        double degrees = now.turn.y * 180 / M_PI, mm = 1e3 * now.shift.z;
        t = (twist){fmin(t.low, degrees), fmax(t.high, degrees), fmax(t.pushed, mm), fmin(t.pulled, mm)};
    }
    print_message("| %s | %.1f to %.1f | %.1f, %.1f |\n", title, t.low, t.high, t.pushed, t.pulled);
    region_motion_free(&motion);
    lockstep_free(l);
    return t;
}

static double largest(twist t) { return fmax(t.high, -t.low); }

/* Within what was seen in patients, one way for a needle on the left and the other way on the right; more for one further out, in
   softer surroundings, and with more friction. An arch that holds the tissue keeps the gland back. */
static void needles_rotate_the_gland(void **unused) {
    (void)unused;
    twist left = insert_and_draw_back("18 mm left of the midplane", (twist_case){-0.018, 1, 1, false});
    twist right = insert_and_draw_back("18 mm right", (twist_case){0.018, 1, 1, false});
    twist inner = insert_and_draw_back("9 mm left", (twist_case){-0.009, 1, 1, false});
    twist firm = insert_and_draw_back("surroundings of 6 kPa", (twist_case){-0.018, 2, 1, false});
    twist weak = insert_and_draw_back("half the friction in the gland", (twist_case){-0.018, 1, 0.5, false});
    twist loose = insert_and_draw_back("arch not held", (twist_case){-0.018, 1, 1, true});
    for (int i = 0; i < 2; i++) {
        twist t = i ? right : left;
        assert_true(t.low > PUBLISHED[0] && t.high < PUBLISHED[1] && largest(t) > 5.0);
        assert_true(t.pushed > 1.0 && t.pulled < -1.0);
    }
    assert_true(left.high > -left.low && right.high < -right.low);
    assert_true(largest(inner) < largest(left) && largest(firm) < largest(left) && largest(weak) < largest(left));
    assert_true(loose.pushed > left.pushed);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(known_motions_are_recovered),
        cmocka_unit_test(strain_is_not_a_rotation),
        cmocka_unit_test(coplanar_points_have_no_rotation),
        cmocka_unit_test(gland_is_displaced_by_the_needle),
        cmocka_unit_test(needles_rotate_the_gland),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

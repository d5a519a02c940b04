/* Tests the rigid motion of a region: known motions are recovered, and uniform strain gives the mean motion. */
#include "api/api.h"
#include "replay/region_motion.h"

#include <stdlib.h>
#include <string.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "check.h"

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

/* Strains the eight corners of a box. By symmetry, stretching does not rotate the box, and a simple shear g rotates it by about g/2. */
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

typedef struct {
    trocar_model *model;
    trocar_sim *sim;
    trocar_pose base;
    double *displacements;
    region_motion motion;
} followed;

/* Creates a simulation of the scene with the needle's base at `start`, and the object that measures the gland's motion. Frees the scene. */
static followed follow(trocar_scene *scene, vec3 start) {
    followed f = {.base = {{start.x, start.y, start.z}, {1, 0, 0, 0}}};
    trocar_error why;
    assert_int_equal(trocar_model_create(scene, NULL, &f.model, &why), TROCAR_OK);
    assert_int_equal(trocar_sim_create(f.model, &f.sim, &why), TROCAR_OK);
    assert_int_equal(trocar_sim_reset(f.sim, 0, &f.base, &why), TROCAR_OK);
    assert_int_equal(region_motion_create(f.model, "prostate", &f.motion, &why), TROCAR_OK);
    f.displacements = malloc(3 * (size_t)trocar_model_node_count(f.model) * sizeof(double));
    trocar_scene_free(scene);
    return f;
}

static void forget(followed *f) {
    region_motion_free(&f->motion);
    trocar_sim_free(f->sim);
    trocar_model_free(f->model);
    free(f->displacements);
}

static trocar_scene *load(const char *path) {
    trocar_scene *scene;
    trocar_error why;
    assert_int_equal(trocar_scene_load(path, &scene, &why), TROCAR_OK);
    return scene;
}

/* Moves the base by `way` (m) in `ticks` ticks of `dt` (s). */
static void move(followed *f, vec3 way, int ticks, double dt) {
    const double from[3] = {f->base.position[0], f->base.position[1], f->base.position[2]}, to[3] = {way.x, way.y, way.z};
    for (int i = 1; i <= ticks; i++) {
        trocar_output output;
        trocar_error why;
        for (int k = 0; k < 3; k++) f->base.position[k] = from[k] + to[k] * i / ticks;
        assert_int_equal(trocar_sim_step(f->sim, 0, &f->base, dt, &output, &why), TROCAR_OK);
    }
}

static rigid_motion motion_now(followed *f) {
    trocar_error why;
    assert_int_equal(trocar_view_displacements(trocar_sim_view(f->sim), f->displacements, &why), TROCAR_OK);
    return region_motion_of(&f->motion, f->displacements);
}

/* Returns the gland's mean displacement in a direction by reciprocity (Maxwell-Betti): it is the work done by the needle's forces on the displacement field
   of a unit force spread over the gland's nodes. Needs one static solve on the unrefined mesh. */
static double shift_by_reciprocity(const followed *f, vec3 direction) {
    const model_parts *parts = &f->model->parts;
    const insertion_state *state = &f->sim->needles[0].state;
    const mesh *m = &parts->mesh;
    vec3 *unit = calloc((size_t)m->node_count, sizeof *unit), *field = calloc((size_t)m->node_count, sizeof *field);
    const mesh_group *gland = &m->groups[mesh_find_group(m, "prostate", 3)];
    assert_int_equal(gland->node_count, f->motion.count);
    for (int i = 0; i < gland->node_count; i++) unit[gland->nodes[i]] = v3_scale(1.0 / gland->node_count, direction);
    inverse_apply(parts->inverse, unit, field);
    double work = 0.0;
    for (int i = 0; i <= contacts_active(state); i++) {
        bool tip = i == contacts_active(state);
        int tet = tip ? state->tip.place.tet : state->refined.nodes[i].tet;
        double weights[4];
        mesh_barycentric(m, tet, tip ? state->tip.place.nominal : state->refined.nodes[i].position, weights);
        for (int c = 0; c < 4; c++)
            work += weights[c] * v3_dot(tip ? tip_load(&state->tip) : state->contacts[i].force, field[m->tets[tet][c]]);
    }
    free(unit);
    free(field);
    return work;
}

static vec3 check_shift(followed *f) {
    vec3 shift = motion_now(f).shift;
    vec3 expected = v3(shift_by_reciprocity(f, v3(1, 0, 0)), shift_by_reciprocity(f, v3(0, 1, 0)), shift_by_reciprocity(f, v3(0, 0, 1)));
    assert_true(v3_norm(v3_sub(shift, expected)) < 1e-9 * v3_norm(expected));
    return shift;
}

/* The gland follows the needle when it is pushed in, pulled back beyond its starting position, and moved sideways. */
static void gland_is_displaced_by_the_needle(void **unused) {
    (void)unused;
    followed f = follow(load(MESHES "/figure8.yaml"), v3(0.005, 0.003, -0.201));
    region_motion other;
    trocar_error why;
    assert_int_equal(region_motion_create(f.model, "liver", &other, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "liver"));
    assert_true(v3_norm(motion_now(&f).shift) == 0.0);
    move(&f, v3(0, 0, 0.06), 1200, 1e-3);
    assert_true(check_shift(&f).z > 0.0);
    move(&f, v3(0, 0, -0.01), 200, 1e-3);
    vec3 pulled = check_shift(&f);
    assert_true(pulled.z < 0.0);
    move(&f, v3(0.01, 0, 0), 200, 1e-3);
    assert_true(check_shift(&f).x > pulled.x);
    forget(&f);
}

static void a_region_moves_with_its_parts(void **unused) {
    (void)unused;
    trocar_scene *scene = load(MESHES "/figure8.yaml");
    trocar_error why;
    assert_int_equal(trocar_scene_set(scene, "regions[surrounding].part_of", "prostate", &why), TROCAR_OK);
    followed f = follow(scene, v3(0.005, 0.003, -0.201));
    assert_int_equal(f.motion.count, trocar_model_node_count(f.model));
    forget(&f);
}

/* ---- the loosely embedded gland of twist.yaml ---------------------------------------------------------------------------- */

static const double PUBLISHED[2] = {-11.2, 13.8}; /* degrees in the coronal plane, measured in patients (Lagerburg et al. 2005) */

/* x: distance from the midplane, m; bedding, grip: factors on the modulus of the surroundings and on the friction in the gland */
typedef struct { double x, bedding, grip; bool loose_arch; } twist_case;

typedef struct { double low, high, pushed, pulled; } coronal_turn; /* low, high: smallest and largest rotation in the coronal plane, degrees; pushed, pulled:
                                                                      shifts along the needle, mm */

static void scale(trocar_scene *scene, const char *region, const char *key, double factor) {
    char path[128];
    double value;
    trocar_error why;
    snprintf(path, sizeof path, "regions[%s].%s", region, key);
    assert_int_equal(trocar_scene_get_number(scene, path, &value, &why), TROCAR_OK);
    assert_int_equal(trocar_scene_set_number(scene, path, factor * value, &why), TROCAR_OK);
}

static trocar_scene *twist_scene(twist_case given) {
    trocar_scene *scene = load(MESHES "/twist.yaml");
    trocar_error why;
    for (int i = 0; i < trocar_scene_count(scene, "regions"); i++) {
        char key[64], region[64];
        snprintf(key, sizeof key, "regions[%d].name", i);
        assert_int_equal(trocar_scene_get(scene, key, region, sizeof region, &why), TROCAR_OK);
        bool gland = strcmp(region, "prostate") == 0;
        if (gland) scale(scene, region, "friction.static", given.grip), scale(scene, region, "friction.kinetic", given.grip);
        else scale(scene, region, "youngs_modulus", given.bedding);
    }
    char fixed[256];
    assert_int_equal(trocar_scene_get(scene, "fixed", fixed, sizeof fixed, &why), TROCAR_OK);
    char *arch = strstr(fixed, ", bone]"); /* the last entry */
    assert_non_null(arch);
    strcpy(arch, "]");
    if (given.loose_arch) assert_int_equal(trocar_scene_set(scene, "fixed", fixed, &why), TROCAR_OK);
    return scene;
}

/* Advances a needle by 120 mm parallel to the body's axis and withdraws it. */
static coronal_turn insert_and_draw_back(const char *title, twist_case given) {
    trocar_scene *scene = twist_scene(given);
    trocar_error why;
    double length;
    assert_int_equal(trocar_scene_get_number(scene, "needle.length", &length, &why), TROCAR_OK);
    followed f = follow(scene, v3(given.x, -0.004, -1e-3 - length));
    coronal_turn t = {0};
    for (int i = 0; i < 2400; i++) {
        move(&f, v3(0, 0, i < 1200 ? 1e-4 : -1e-4), 1, 2e-3);
        rigid_motion now = motion_now(&f);
        double degrees = now.turn.y * 180 / M_PI, mm = 1e3 * now.shift.z;
        t = (coronal_turn){fmin(t.low, degrees), fmax(t.high, degrees), fmax(t.pushed, mm), fmin(t.pulled, mm)};
    }
    print_message("| %s | %.1f to %.1f | %.1f, %.1f |\n", title, t.low, t.high, t.pushed, t.pulled);
    forget(&f);
    return t;
}

static double largest(coronal_turn t) { return fmax(t.high, -t.low); }

/* Rotations are within the range measured in patients and have opposite signs for needles on the left and on the right. They grow with the needle's distance
   from the midplane, with softer surroundings and with more friction. A pubic arch that fixes the tissue reduces the gland's motion. */
static void needles_rotate_the_gland(void **unused) {
    (void)unused;
    coronal_turn left = insert_and_draw_back("18 mm left of the midplane", (twist_case){-0.018, 1, 1, false});
    coronal_turn right = insert_and_draw_back("18 mm right", (twist_case){0.018, 1, 1, false});
    coronal_turn inner = insert_and_draw_back("9 mm left", (twist_case){-0.009, 1, 1, false});
    coronal_turn firm = insert_and_draw_back("surroundings of 6 kPa", (twist_case){-0.018, 2, 1, false});
    coronal_turn weak = insert_and_draw_back("half the friction in the gland", (twist_case){-0.018, 1, 0.5, false});
    coronal_turn loose = insert_and_draw_back("arch not held", (twist_case){-0.018, 1, 1, true});
    for (int i = 0; i < 2; i++) {
        coronal_turn t = i ? right : left;
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
        cmocka_unit_test(a_region_moves_with_its_parts),
        cmocka_unit_test(needles_rotate_the_gland),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

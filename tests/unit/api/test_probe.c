/* Tests the probe. Its shape is checked against sampled points, the complementarity solver against a search over all subsets, its contact against projected
   Gauss-Seidel on the dense inverse, and its effect on needles against dense linear algebra. Through trocar.h: saving and restoring, motion in lockstep and
   with a worker, release, and refusal of invalid probes.

   usage: [MOTIONS=N] [SEED=N] test_unit test_probe     MOTIONS and SEED apply to the case moved_at_random; default 20 (5 under sanitizers, which take minutes for
   20) and 1 */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <lapacke.h>

#include "cube.h"
#include "linalg/complementarity.h"
#include "probe/probe.h"
#include "snapshot/free_displacement.h"
#include "trocar.h"

#include <cmocka.h>

#include "check.h"
#include "sanitized.h"

enum { TOP = CUBE_SIDE * CUBE_SIDE, N = 3 * CUBE_NODES };

static cube body;
static inverse *beneath;
static int all[CUBE_NODES];
static double dense[N * N];
static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

/* The probe presses on the upper face of the cube, at z = 0.1 m. */
static int create(void **state) {
    (void)state;
    if (cube_create(&body, 0.1, &why) != TROCAR_OK || inverse_create_attached(body.inverse, &beneath, &why) != TROCAR_OK) return -1;
    int *nodes = malloc(TOP * sizeof *nodes);
    for (int i = 0; i < TOP; i++) nodes[i] = CUBE_NODES - TOP + i;
    body.mesh.groups[2] = (mesh_group){"top", 2, TOP, nodes};
    body.mesh.group_count = 3;
    for (int i = 0; i < CUBE_NODES; i++) all[i] = i;
    return inverse_gather(body.inverse, &(inverse_blocks){CUBE_NODES, all, CUBE_NODES, all, dense, N}, &why) == TROCAR_OK ? 0 : -1;
}

static int destroy(void **state) {
    (void)state;
    inverse_free(beneath);
    cube_free(&body);
    return 0;
}

/* ---- shape ---------------------------------------------------------------------------------------------------------------- */

/* Computes the gap by brute force, as the distance to the closest of many points on the meridian. */
static double sampled_gap(const probe_shape *s, double beside, double along) {
    enum { SAMPLES = 20000 };
    double nearest = INFINITY, flat = s->radius - s->tip_radius, corner = s->length - s->tip_radius;
    for (int i = 0; i <= SAMPLES; i++) {
        double t = (double)i / SAMPLES, angle = 0.5 * M_PI * t;
        nearest = fmin(nearest, hypot(beside - s->radius, along - (corner - 0.2 * t)));
        nearest = fmin(nearest, hypot(beside - flat * t, along - s->length));
        nearest = fmin(nearest, hypot(beside - flat - s->tip_radius * cos(angle), along - corner - s->tip_radius * sin(angle)));
    }
    bool round = beside > flat && along > corner;
    bool inside = round ? hypot(beside - flat, along - corner) < s->tip_radius : beside < s->radius && along < s->length;
    return inside ? -nearest : nearest;
}

static void distance_to_a_rounded_cylinder(void **state) {
    (void)state;
    for (int shape = 0; shape < 3; shape++) {
        probe_shape s = {.radius = 0.01, .tip_radius = (const double[]){0.01, 0.004, 0.0}[shape], .length = 0.1};
        for (int i = 0; i < 60; i++) {
            pose base = {cube_random_vector(0.1), q_exp(cube_random_vector(2.0))};
            double beside = cube_random(1e-4, 0.03), along = cube_random(0.05, 0.13), angle = cube_random(-3, 3), step = 1e-7;
            vec3 x = v3_add(base.position, q_rotate(base.orientation, v3(beside * cos(angle), beside * sin(angle), along))), normal, ignored;
            double gap = probe_gap(&s, base, x, &normal);
            assert_close(gap, sampled_gap(&s, beside, along), 2e-6);
            assert_close(v3_norm(normal), 1.0, 1e-12);
            assert_close(probe_gap(&s, base, v3_axpy(step, normal, x), &ignored), gap + step, 1e-13 + 1e-6 * step);
        }
    }
}

/* ---- complementarity ----------------------------------------------------------------------------------------------------------- */

static void complementarity_among_all_subsets(void **state) {
    (void)state;
    enum { M = 8 };
    for (int problem = 0; problem < 100; problem++) {
        double root[M][M], a[M * M], q[M], z[M], scratch[M * (M + 2)], best[M];
        for (int i = 0; i < M * M; i++) root[i / M][i % M] = cube_random(-1, 1);
        for (int i = 0; i < M; i++)
            for (int j = 0; j < M; j++) {
                a[i * M + j] = i == j ? 1e-3 : 0.0;
                for (int k = 0; k < M; k++) a[i * M + j] += root[i][k] * root[j][k];
            }
        for (int i = 0; i < M; i++) q[i] = cube_random(-1, 1), z[i] = cube_random(-1, 1);
        int found = 0;
        for (int set = 0; set < 1 << M; set++) { /* exactly one subset is the solution */
            double part[M * M], right[M];
            int index[M], n = 0;
            for (int i = 0; i < M; i++)
                if (set >> i & 1) index[n++] = i;
            for (int i = 0; i < n; i++) {
                right[i] = -q[index[i]];
                for (int j = 0; j < n; j++) part[i * n + j] = a[index[i] * M + index[j]];
            }
            lapack_int pivots[M];
            if (n > 0) assert_int_equal(LAPACKE_dgesv(LAPACK_ROW_MAJOR, n, 1, part, n, pivots, right, 1), 0);
            bool good = true;
            double candidate[M] = {0};
            for (int i = 0; i < n; i++) candidate[index[i]] = right[i], good = good && right[i] > 0;
            for (int i = 0; i < M; i++) {
                double w = q[i];
                for (int j = 0; j < M; j++) w += a[i * M + j] * candidate[j];
                good = good && ((set >> i & 1) || w > 0);
            }
            if (good) found++, memcpy(best, candidate, sizeof best);
        }
        assert_int_equal(found, 1);
        assert_true(complementarity_solve(M, a, M, q, 1e-14, z, scratch));
        for (int i = 0; i < M; i++) assert_close(z[i], best[i], 1e-8 * (1 + best[i]));
    }
}

/* ---- contact ----------------------------------------------------------------------------------------------------------------------- */

static const probe_shape CAPSULE = {.radius = 0.02, .tip_radius = 0.02, .length = 0.1};

/* Reference for the distance to a capsule, computed from the distance to its axis. */
static double capsule_gap(pose base, vec3 x, vec3 *normal) {
    vec3 axis = q_axis(base.orientation);
    double along = fmin(v3_dot(axis, v3_sub(x, base.position)), CAPSULE.length - CAPSULE.radius);
    vec3 off = v3_sub(x, v3_axpy(along, axis, base.position));
    *normal = v3_unit(off);
    return v3_norm(off) - CAPSULE.radius;
}

/* Returns a pose along x, with the tip above the middle of the upper face and the probe at this depth. */
static pose lying(double depth) {
    vec3 down = v3_axpy(CAPSULE.radius - depth, v3(0, 0, 1), v3(-0.04, 0.052, CUBE_EDGE));
    return (pose){down, q_exp(v3(0, 0.5 * M_PI + 0.05, 0))};
}

static vec3 displacement_at(int node, const vec3 *forces) {
    vec3 u = v3(0, 0, 0);
    for (int j = 0; j < CUBE_NODES; j++) {
        mat3 block = {{{0}}};
        if (v3_norm(forces[j]) == 0.0) continue;
        m3_add_block(&block, 1.0, dense + (size_t)(3 * node) * N + 3 * j, N);
        u = v3_add(u, m3_apply(&block, forces[j]));
    }
    return u;
}

/* Solves the contact by Gauss-Seidel sweeps, with gaps and normals evaluated at the deformed nodes. `forces` receives `others` plus the contact forces. */
static int press_by_sweeps(pose base, const vec3 *others, vec3 *forces) {
    double lambda[CUBE_NODES] = {0};
    vec3 normal[CUBE_NODES];
    int count = 0;
    for (int i = 0; i < CUBE_NODES; i++) normal[i] = v3(0, 0, 0);
    for (int sweep = 0; sweep < 4000; sweep++) {
        double most = 0.0;
        for (int i = CUBE_NODES - TOP; i < CUBE_NODES; i++) {
            for (int k = 0; k < CUBE_NODES; k++) forces[k] = v3_axpy(lambda[k], normal[k], others[k]);
            double gap = capsule_gap(base, v3_add(body.mesh.nodes[i], displacement_at(i, forces)), &normal[i]);
            mat3 own = {{{0}}};
            m3_add_block(&own, 1.0, dense + (size_t)(3 * i) * N + 3 * i, N);
            double before = lambda[i];
            lambda[i] = fmax(0.0, lambda[i] - gap / v3_dot(normal[i], m3_apply(&own, normal[i])));
            most = fmax(most, fabs(lambda[i] - before));
        }
        if (most < 1e-11) break;
    }
    for (int k = 0; k < CUBE_NODES; k++) forces[k] = v3_axpy(lambda[k], normal[k], others[k]), count += lambda[k] > 0;
    return count;
}

/* Returns the loads that a needle exerts at three points inside the tissue. */
static tissue_loads some_loads(double size) {
    tissue_loads loads = {.count = 3};
    for (int i = 0; i < 3; i++) loads.loads[i] = (tissue_load){.tet = 97 + 60 * i, .weights = {0.1, 0.2, 0.3, 0.4}, .force = v3(0.3 * size, (0.5 - i) * size, size)};
    return loads;
}

static const needle_holds no_holds;

static void contact_against_sweeps(void **state) {
    (void)state;
    static vec3 others[CUBE_NODES], forces[CUBE_NODES];
    probe *p;
    OK(probe_create(beneath, &CAPSULE, 2, INFINITY, &p, &why));
    for (int step = 0; step < 6; step++) {
        double depth = (const double[]){0.001, 0.004, 0.008, 0.016, 0.006, -0.002}[step];
        tissue_loads loads = some_loads(step % 2 ? 3.0 : 0.0);
        other_loads held = {.count = 1, .of = {&loads}, .beneath = beneath};
        memset(others, 0, sizeof others);
        loads_spread(&body.mesh, &loads, others);
        OK(probe_press(p, lying(depth), 0.0, &held, &no_holds, false, &why));
        int expected = press_by_sweeps(lying(depth), others, forces);
        vec3 total = v3(0, 0, 0), torque = v3(0, 0, 0);
        double worst = 0.0;
        for (int i = CUBE_NODES - TOP; i < CUBE_NODES; i++) {
            vec3 f = v3_sub(forces[i], others[i]), at = v3_add(body.mesh.nodes[i], displacement_at(i, forces)), found = v3(0, 0, 0);
            total = v3_sub(total, f);
            torque = v3_sub(torque, v3_cross(v3_sub(at, lying(depth).position), f));
            for (int k = 0; k < p->state.count; k++)
                if (p->now.nodes[k] == i) found = p->now.force[k];
            worst = fmax(worst, v3_norm(v3_sub(found, f)));
        }
        print_message("%4.1f mm deep: %d nodes, %.4f N, forces differ by %.1e N\n", 1e3 * depth, p->state.count, v3_norm(total), worst);
        assert_int_equal(p->state.count, expected);
        assert_close(worst, 0.0, 1e-6);
        assert_close_vector(p->state.wrench_force, total, 1e-6);
        assert_close_vector(p->state.wrench_torque, torque, 1e-6);
        assert_true(p->state.count > 1);
    }
    assert_int_equal(inverse_attached_rows(p->inverse), p->state.count);
    probe_free(p);
}

/* ---- what needles feel ----------------------------------------------------------------------------------------------------------- */

/* Holding nodes along their normals turns K^-1 into K^-1 - C P (P^T C P)^-1 P^T C. The field of the free forces plus that of the needle's own forces must
   equal the field of all forces. */
static void needles_feel_it(void **state) {
    (void)state;
    static double expected[N * N], found[N * N], columns[TOP][N], small[TOP * TOP];
    static vec3 forces[CUBE_NODES], u[CUBE_NODES], v[CUBE_NODES];
    probe *p;
    tissue_loads loads = some_loads(3.0);
    other_loads held = {.count = 1, .of = {&loads}, .beneath = beneath};
    OK(probe_create(beneath, &CAPSULE, 2, INFINITY, &p, &why));
    OK(probe_press(p, lying(0.006), 0.0, &held, &no_holds, false, &why));
    int n = p->state.count;
    assert_true(n > 3);
    for (int k = 0; k < n; k++)
        for (int i = 0; i < N; i++) {
            vec3 row = p->state.points[k].row;
            const double *block = dense + (size_t)i * N + 3 * p->surface[p->state.points[k].point];
            columns[k][i] = row.x * block[0] + row.y * block[1] + row.z * block[2];
        }
    for (int k = 0; k < n; k++)
        for (int l = 0; l < n; l++) {
            vec3 row = p->state.points[k].row;
            const double *c = columns[l] + 3 * p->surface[p->state.points[k].point];
            small[k * n + l] = row.x * c[0] + row.y * c[1] + row.z * c[2];
        }
    lapack_int pivots[TOP];
    assert_int_equal(LAPACKE_dgetrf(LAPACK_ROW_MAJOR, n, n, small, n, pivots), 0);
    assert_int_equal(LAPACKE_dgetri(LAPACK_ROW_MAJOR, n, small, n, pivots), 0);
    double worst = 0.0, largest = 0.0;
    memcpy(expected, dense, sizeof expected);
    for (int k = 0; k < n; k++)
        for (int l = 0; l < n; l++)
            for (int i = 0; i < N; i++)
                for (int j = 0; j < N; j++) expected[i * N + j] -= columns[k][i] * small[k * n + l] * columns[l][j];
    OK(inverse_gather(p->inverse, &(inverse_blocks){CUBE_NODES, all, CUBE_NODES, all, found, N}, &why));
    for (int i = 0; i < N * N; i++) worst = fmax(worst, fabs(found[i] - expected[i])), largest = fmax(largest, fabs(dense[i]));
    assert_close(worst, 0.0, 1e-11 * largest);

    memset(forces, 0, sizeof forces);
    loads_spread(&body.mesh, &loads, forces);
    inverse_apply(p->inverse, forces, v);
    OK(nodal_displacement_add(beneath, &p->unloaded, CUBE_NODES, all, v, &why));
    for (int k = 0; k < p->now.count; k++) forces[p->now.nodes[k]] = v3_add(forces[p->now.nodes[k]], p->now.force[k]);
    inverse_apply(body.inverse, forces, u);
    for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(u[i], v[i], 1e-12);
    probe_free(p);
}

/* ---- trocar.h ------------------------------------------------------------------------------------------------------------------------- */

/* Creates the figure-8 scene with a probe below the skin, next to the needle and perpendicular to it. */
static trocar_model *create_model(void) {
    static const char *const keys[][2] = {{"probe.surface", "skin"}, {"probe.radius", "0.012"}, {"probe.tip_radius", "0.006"}, {"probe.length", "0.1"}};
    trocar_scene *scene;
    trocar_model *model;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    for (int i = 0; i < 4; i++) OK(trocar_scene_set(scene, keys[i][0], keys[i][1], &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    trocar_scene_free(scene);
    return model;
}

/* Returns a pose along x, with the probe's side at this depth below the skin's rest position. */
static trocar_pose across(double x, double depth) {
    const double half = sqrt(0.5);
    return (trocar_pose){{x - 0.09, -0.012, depth - 0.012}, {half, 0, half, 0}};
}

/* Runs tick t of a motion in which the needle is inserted while the probe approaches, presses, slides along the skin and retreats. */
static void run_tick(trocar_sim *sim, int t, trocar_output *out) {
    trocar_pose base = {{0.005, 0.01, -0.201 + 1e-4 * fmin(t, 400)}, {1, 0, 0, 0}};
    double depth = t < 200 ? -0.001 : t < 300 ? -0.001 + 7e-5 * (t - 200) : t < 500 ? 0.006 : 0.006 - 1e-4 * (t - 500), x = t < 300 ? 0.0 : 1e-4 * fmin(t - 300, 200);
    trocar_pose pose = across(x, depth);
    if (t % 10 == 0) OK(trocar_sim_set_probe(sim, &pose, &why));
    OK(trocar_sim_step(sim, 0, &base, 1e-3, out, &why));
}

static double smallest_gap(trocar_sim *sim, const trocar_model *model) {
    static const probe_shape shape = {.radius = 0.012, .tip_radius = 0.006, .length = 0.1};
    int nodes = trocar_model_node_count(model);
    const double *x = trocar_model_nodes(model);
    double *u = malloc(3 * (size_t)nodes * sizeof *u), lowest = INFINITY;
    trocar_pose base = trocar_view_probe(trocar_sim_view(sim)).base;
    pose placed = {v3(base.position[0], base.position[1], base.position[2]),
                   {base.orientation[0], base.orientation[1], base.orientation[2], base.orientation[3]}};
    OK(trocar_view_displacements(trocar_sim_view(sim), u, &why));
    for (int i = 0; i < nodes; i++) {
        vec3 ignored, at = v3(x[3 * i] + u[3 * i], x[3 * i + 1] + u[3 * i + 1], x[3 * i + 2] + u[3 * i + 2]);
        if (x[3 * i + 2] < 1e-9) lowest = fmin(lowest, probe_gap(&shape, placed, at, &ignored));
    }
    free(u);
    return lowest;
}

static void pressed_and_released(void **state) {
    (void)state;
    trocar_model *model = create_model();
    trocar_sim *sim, *alone;  /* the probe of `alone` is never used */
    trocar_output out, without;
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_create(model, &alone, &why));
    double deepest = 0.0;
    trocar_pose start = {{0.005, 0.01, -0.201}, {1, 0, 0, 0}};
    OK(trocar_sim_reset(sim, 0, &start, &why));
    OK(trocar_sim_reset(alone, 0, &start, &why));
    assert_int_equal(trocar_view_probe(trocar_sim_view(sim)).placed, 0);
    for (int t = 0; t < 600; t++) {
        run_tick(sim, t, &out);
        trocar_probe probe = trocar_view_probe(trocar_sim_view(sim));
        assert_true(probe.placed);
        if (t < 200) assert_int_equal(probe.contacts, 0);
        trocar_pose base = trocar_view_base(trocar_sim_view(sim), 0);
        OK(trocar_sim_step(alone, 0, &base, 1e-3, &without, &why));
        double felt = fabs(out.force[0] - without.force[0]) + fabs(out.force[1] - without.force[1]) + fabs(out.force[2] - without.force[2]);
        if (t < 200) assert_true(felt == 0.0);
        if (t == 495) assert_true(felt > 0.05);
        if (t % 50 != 45) continue;
        double lowest = smallest_gap(sim, model);
        print_message("t = %.3f s: %2d nodes, %.3f N, smallest gap %.4f mm, needle %.4f %.4f %.4f N, %.4f N of it by the probe\n", 1e-3 * t, probe.contacts, probe.force[2],
                      1e3 * lowest, out.force[0], out.force[1], out.force[2], felt);
        if (probe.contacts > 0) assert_close(lowest, 0.0, 20e-6); /* 20 um for the needle's motion since the probe was last solved */
        deepest = fmin(deepest, probe.force[2]);
    }
    assert_true(deepest < -3.0);
    assert_int_equal(trocar_view_probe(trocar_sim_view(sim)).contacts, 0);
    trocar_sim_free(alone);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* While the probe's contact is being solved, the forces of a held needle change with it, just as the next tick will compute them. Solving the contact again
   later therefore hardly changes the result. */
static void beside_a_held_needle(void **state) {
    (void)state;
    trocar_model *model = create_model();
    trocar_sim *sim;
    trocar_output out;
    trocar_pose start = {{0.005, 0.01, -0.201}, {1, 0, 0, 0}}, deeper = across(0.015, 0.0075);
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_reset(sim, 0, &start, &why));
    for (int t = 0; t < 450; t++) run_tick(sim, t, &out);
    trocar_pose base = trocar_view_base(trocar_sim_view(sim), 0);
    for (int t = 0; t < 50; t++) OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    double before = trocar_view_probe(trocar_sim_view(sim)).force[2];
    OK(trocar_sim_set_probe(sim, &deeper, &why));
    OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    double first = trocar_view_probe(trocar_sim_view(sim)).force[2], gap = smallest_gap(sim, model);
    for (int t = 0; t < 50; t++) OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    double last = trocar_view_probe(trocar_sim_view(sim)).force[2];
    print_message("%.4f N, deeper %.4f N with a gap of %.2f um, later %.4f N\n", before, first, 1e6 * gap, last);
    assert_true(last < before - 1.0);
    assert_close(gap, 0.0, 5e-6);     /* it would be 50 um if the needle's forces were kept constant during the solve */
    assert_close(first, last, 0.005);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

/* The probe keeps pressing while a needle rests, and the needle keeps resting while the probe presses. Snapshots of the state show both. */
static void beside_a_resting_needle(void **state) {
    (void)state;
    trocar_model *model = create_model();
    trocar_sim *sim;
    trocar_picture *picture;
    trocar_output out;
    trocar_pose start = {{0.005, 0.01, -0.201}, {1, 0, 0, 0}}, deeper = across(0.01, 0.008);
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_picture_create(model, &picture, &why));
    OK(trocar_sim_reset(sim, 0, &start, &why));
    for (int t = 0; t < 450; t++) run_tick(sim, t, &out);
    trocar_probe before = trocar_view_probe(trocar_sim_view(sim));
    OK(trocar_sim_leave(sim, 0, &why));
    OK(trocar_sim_work(sim, NULL, &why));
    assert_int_equal(trocar_sim_needle_state(sim, 0), TROCAR_NEEDLE_RESTING);
    trocar_probe left = trocar_view_probe(trocar_sim_view(sim));
    double gap_left = smallest_gap(sim, model);
    OK(trocar_sim_set_probe(sim, &deeper, &why));
    for (int i = 0; i < 20; i++) OK(trocar_sim_work(sim, NULL, &why));
    trocar_probe moved = trocar_view_probe(trocar_sim_view(sim));
    double gap_moved = smallest_gap(sim, model);
    print_message("%.3f N, needle left %.3f N, gap %.4f mm; deeper %.3f N, gap %.4f mm\n", before.force[2], left.force[2], 1e3 * gap_left,
                  moved.force[2], 1e3 * gap_moved);
    assert_close(left.force[2], before.force[2], 0.3);
    assert_true(moved.force[2] < left.force[2] - 0.5);
    assert_close(gap_left, 0.0, 20e-6);
    assert_close(gap_moved, 0.0, 20e-6);
    size_t bytes = 3 * (size_t)trocar_model_node_count(model) * sizeof(double);
    double *u = malloc(bytes), *seen = malloc(bytes);
    trocar_sim_take_picture(sim, picture);
    trocar_probe shown = trocar_view_probe(trocar_picture_view(picture));
    OK(trocar_view_displacements(trocar_sim_view(sim), u, &why));
    OK(trocar_view_displacements(trocar_picture_view(picture), seen, &why));
    assert_memory_equal(u, seen, bytes);
    assert_memory_equal(&shown, &moved, sizeof shown);
    OK(trocar_sim_take(sim, 0, &why));
    OK(trocar_sim_work(sim, NULL, &why));
    trocar_pose base = trocar_view_base(trocar_sim_view(sim), 0);
    for (int t = 0; t < 30; t++) OK(trocar_sim_step(sim, 0, &base, 1e-3, &out, &why));
    assert_close(smallest_gap(sim, model), 0.0, 20e-6);
    free(u);
    free(seen);
    trocar_picture_free(picture);
    trocar_sim_free(sim);
    trocar_model_free(model);
}

static void saved_and_restored(void **state) {
    (void)state;
    trocar_model *model = create_model();
    trocar_sim *sim, *other;
    trocar_output out, again;
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_create(model, &other, &why));
    trocar_pose start = {{0.005, 0.01, -0.201}, {1, 0, 0, 0}}, elsewhere = across(-0.02, 0.003);
    OK(trocar_sim_reset(sim, 0, &start, &why));
    for (int t = 0; t < 355; t++) run_tick(sim, t, &out);
    trocar_pose asked = across(0.006, 0.005);
    OK(trocar_sim_set_probe(sim, &asked, &why)); /* still pending when the state is saved */
    size_t size = trocar_sim_state_size(sim);
    void *saved = malloc(size);
    OK(trocar_sim_save(sim, saved, size, &why));
    OK(trocar_sim_set_probe(other, &elsewhere, &why)); /* the other simulation's probe starts somewhere else */
    OK(trocar_sim_reset(other, 0, &start, &why));
    OK(trocar_sim_step(other, 0, &start, 1e-3, &again, &why));
    OK(trocar_sim_set_probe(other, &start, &why));
    OK(trocar_sim_restore(other, saved, size, &why));
    assert_true(trocar_view_probe(trocar_sim_view(other)).contacts > 0);
    for (int t = 355; t < 480; t++) {
        run_tick(sim, t, &out);
        run_tick(other, t, &again);
        trocar_probe a = trocar_view_probe(trocar_sim_view(sim)), b = trocar_view_probe(trocar_sim_view(other));
        if (memcmp(&out, &again, sizeof out) != 0 || memcmp(&a, &b, sizeof a) != 0) fail_msg("tick %d: %.17g and %.17g N", t, out.force[2], again.force[2]);
    }
    free(saved);
    trocar_sim_free(sim);
    trocar_sim_free(other);
    trocar_model_free(model);
}

/* Ticks and worker use the real-time calls but take turns in one thread. The result equals that of lockstep. */
static void with_a_worker(void **state) {
    (void)state;
    trocar_model *model = create_model();
    trocar_sim *sim, *lockstep;
    trocar_output out, expected;
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_create(model, &lockstep, &why));
    trocar_pose base = {{0.005, 0.01, -0.201}, {1, 0, 0, 0}}, pose = across(0, -0.001);
    OK(trocar_sim_reset(sim, 0, &base, &why));
    OK(trocar_sim_reset(lockstep, 0, &base, &why));
    for (int t = 0; t < 700; t++) {
        base.position[2] = -0.201 + 1e-4 * fmin(t, 400);
        pose = across(0, -0.001 + 7e-5 * fmax(0, fmin(t - 200, 100)));
        if (t % 10 == 0) {
            OK(trocar_sim_set_probe(sim, &pose, &why));
            OK(trocar_sim_set_probe(lockstep, &pose, &why));
        }
        assert_int_equal(trocar_sim_tick(sim, 0, &base, 1e-3, &out), TROCAR_OK);
        for (trocar_work work = {.more = 1}; work.more;) OK(trocar_sim_work(sim, &work, &why));
        OK(trocar_sim_step(lockstep, 0, &base, 1e-3, &expected, &why));
    }
    trocar_probe a = trocar_view_probe(trocar_sim_view(sim)), b = trocar_view_probe(trocar_sim_view(lockstep));
    print_message("with a worker: %d nodes, %.5f N, needle %.5f N; lockstep: %d, %.5f N, %.5f N\n", a.contacts, a.force[2], out.force[2], b.contacts,
                  b.force[2], expected.force[2]);
    assert_int_equal(a.contacts, b.contacts);
    assert_true(a.contacts > 3);
    for (int i = 0; i < 3; i++) {
        assert_close(a.force[i], b.force[i], 5e-3);
        assert_close(out.force[i], expected.force[i], 5e-3);
    }
    trocar_sim_free(sim);
    trocar_sim_free(lockstep);
    trocar_model_free(model);
}

/* In meshes/trus.yaml, the probe lies in the rectum, 1 mm from the wall. Raised by more than that, it presses on the wall. */
static void rests_at_the_scenes_place(void **state) {
    (void)state;
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    trocar_pose needle = {{0, 0, -0.3}, {1, 0, 0, 0}}, up;
    trocar_output out;
    OK(trocar_scene_load(MESHES "/trus.yaml", &scene, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &sim, &why));
    OK(trocar_sim_reset(sim, 0, &needle, &why));
    OK(trocar_sim_step(sim, 0, &needle, 1e-3, &out, &why));
    trocar_probe probe = trocar_view_probe(trocar_sim_view(sim));
    assert_true(probe.placed && probe.contacts == 0 && probe.base.position[1] == -0.032);
    double before = 0.0;
    for (int mm = 1; mm <= 9; mm += 2) {
        up = probe.base;
        up.position[1] += 1e-3 * mm;
        OK(trocar_sim_set_probe(sim, &up, &why));
        OK(trocar_sim_step(sim, 0, &needle, 1e-3, &out, &why));
        double force = -trocar_view_probe(trocar_sim_view(sim)).force[1]; /* the probe pushes the hand down */
        assert_true(mm == 1 ? force < 1e-6 : force > before);
        before = force;
    }
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

/* ---- the wall of meshes/trus.yaml at any depth ------------------------------------------------------------------------------------ */

static const probe_shape TRANSRECTAL = {.radius = 9e-3, .tip_radius = 9e-3, .length = 0.15};

typedef struct {
    trocar_model *model;
    trocar_sim *sim;
    int count, *wall;        /* nodes on the rectum's wall */
    double *u;
} rectum;

/* Opens the scene and finds the nodes of the rectum's wall, which are 10 mm from the rectum's axis. */
static void open_rectum(rectum *r, const char *max_force) {
    trocar_scene *scene;
    trocar_pose needle = {{0, 0, -0.3}, {1, 0, 0, 0}};
    OK(trocar_scene_load(MESHES "/trus.yaml", &scene, &why));
    OK(trocar_scene_set(scene, "probe.max_force", max_force, &why));
    OK(trocar_model_create(scene, NULL, &r->model, &why));
    OK(trocar_sim_create(r->model, &r->sim, &why));
    OK(trocar_sim_reset(r->sim, 0, &needle, &why));
    trocar_scene_free(scene);
    int nodes = trocar_model_node_count(r->model);
    const double *x = trocar_model_nodes(r->model);
    r->wall = malloc((size_t)nodes * sizeof *r->wall);
    r->u = malloc(3 * (size_t)nodes * sizeof *r->u);
    r->count = 0;
    for (int i = 0; i < nodes; i++)
        if (fabs(hypot(x[3 * i], x[3 * i + 1] + 0.032) - 0.010) < 1e-5) r->wall[r->count++] = i;
    assert_true(r->count > 50);
}

static void close_rectum(rectum *r) {
    trocar_sim_free(r->sim);
    trocar_model_free(r->model);
    free(r->wall);
    free(r->u);
}

static trocar_probe move_to(rectum *r, pose at) {
    trocar_pose needle = {{0, 0, -0.3}, {1, 0, 0, 0}};
    trocar_pose base = {{at.position.x, at.position.y, at.position.z}, {at.orientation.w, at.orientation.x, at.orientation.y, at.orientation.z}};
    trocar_output out;
    OK(trocar_sim_set_probe(r->sim, &base, &why));
    OK(trocar_sim_step(r->sim, 0, &needle, 1e-3, &out, &why));
    return trocar_view_probe(trocar_sim_view(r->sim));
}

static pose place_of(const trocar_probe *p) {
    return (pose){v3(p->base.position[0], p->base.position[1], p->base.position[2]),
                  {p->base.orientation[0], p->base.orientation[1], p->base.orientation[2], p->base.orientation[3]}};
}

static vec3 vector(const double v[3]) { return v3(v[0], v[1], v[2]); }

/* Returns the smallest gap (m) between the probe and the wall's nodes, with the wall either at rest or displaced. */
static double least_gap(rectum *r, pose at, bool rest) {
    const double *x = trocar_model_nodes(r->model);
    double least = INFINITY;
    vec3 ignored;
    if (!rest) OK(trocar_view_displacements(trocar_sim_view(r->sim), r->u, &why));
    for (int k = 0; k < r->count; k++) {
        int i = r->wall[k];
        vec3 place = vector(x + 3 * i);
        least = fmin(least, probe_gap(&TRANSRECTAL, at, rest ? place : v3_add(place, vector(r->u + 3 * i)), &ignored));
    }
    return least;
}

/* Returns the largest change in force (N) over a short distance that does not yet count as a jump. */
static double smooth_change(double before, double after) { return fmax(0.05, 0.07 * fmax(before, after)); }

static double change_of(const trocar_probe *from, const trocar_probe *to) {
    double before = v3_norm(vector(from->force)), after = v3_norm(vector(to->force));
    return v3_norm(v3_sub(vector(to->force), vector(from->force))) / smooth_change(before, after);
}

/* Raises the probe by 20 mm in steps of 0.25 mm, once without a force limit and once with the scene's. It must never pass through the wall. The limited
   probe stops where the force of the unlimited one exceeds the limit. Far beyond that, single nodes may slip past the rounded end, but the force must not
   jump. */
static void does_not_pass_the_wall(void **state) {
    (void)state;
    enum { STEPS = 80 };
    const double limit = 35.0;
    double unlimited[STEPS + 1] = {0};
    for (int limited = 0; limited < 2; limited++) {
        rectum r;
        open_rectum(&r, limited ? "35" : "1e9");
        double before = 0.0;
        for (int step = 0; step <= STEPS; step++) {
            pose at = {v3(0, -0.032 + 0.25e-3 * step, -0.08), {1, 0, 0, 0}};
            trocar_probe p = move_to(&r, at);
            double force = v3_norm(vector(p.force));
            if (!limited) unlimited[step] = force;
            if (!p.stopped) assert_true(force >= before - (force > limit ? smooth_change(before, force) : 0.0));
            assert_true(p.stopped == (limited && unlimited[step] > limit) && force <= (limited ? limit : 1e9));
            assert_true(p.stopped ? p.base.position[1] < at.position.y : p.base.position[1] == at.position.y);
            if (step >= 8) assert_true(p.contacts > 10 && least_gap(&r, place_of(&p), false) > -1e-6);
            before = force;
        }
        print_message("raised by 20 mm, %s: %.2f N\n", limited ? "stopped" : "not stopped", before);
        assert_true(before > (limited ? 0.98 : 1.0) * limit);
        for (int step = STEPS; step >= 0; step--) { /* the limited probe follows when the hand draws back */
            trocar_probe p = move_to(&r, (pose){v3(0, -0.032 + 0.25e-3 * step, -0.08), {1, 0, 0, 0}});
            assert_int_equal(p.stopped, limited && unlimited[step] > limit);
        }
        assert_close(v3_norm(vector(trocar_view_probe(trocar_sim_view(r.sim)).force)), 0.0, 1e-9);
        close_rectum(&r);
    }
}

/* Repeats the motion to `at` from the saved state in smaller parts. `change` is the change in force over the whole motion, relative to the largest change
   that does not count as a jump. There are twice as many parts as a steady rise would need, so a real jump still falls into a single part. Returns the
   largest change per part, in the same unit. */
static double change_in_parts(rectum *r, const void *saved, size_t size, trocar_probe last, pose at, double change) {
    pose from = place_of(&last);
    double largest = 0.0;
    int parts = 2 * (int)ceil(change);
    OK(trocar_sim_restore(r->sim, saved, size, &why));
    for (int i = 1; i <= parts; i++) {
        trocar_probe p = move_to(r, i < parts ? pose_between(from, at, (double)i / parts) : at);
        largest = fmax(largest, change_of(&last, &p));
        last = p;
    }
    return largest;
}

static int motions = SANITIZED ? 5 : 20, seed = 1;

/* Moves the probe along closed paths, as far as a hand would. Each path has four random legs that raise, tilt and shift the probe (the last one also draws
   it back), followed by the return home. */
static void moved_at_random(void **state) {
    (void)state;
    enum { LEGS = 5 };
    const pose home = {v3(0, -0.032, -0.08), {1, 0, 0, 0}};
    const double longest = 0.2e-3; /* m, travel between two solutions at 20 mm/s, the speed at which the viewer moves the probe */
    rectum r;
    open_rectum(&r, "35");
    size_t size = trocar_sim_state_size(r.sim);
    void *saved = malloc(size);
    srand((unsigned)seed);
    double deepest = 0.0, worst = 0.0, least_work = INFINITY, most = 0.0;
    int places = 0, stops = 0, pressed = 0, lost = 0, jumps = 0;
    for (int path = 0; path < (motions + LEGS - 1) / LEGS; path++) {
        trocar_probe last = move_to(&r, home);
        double work = 0.0; /* J, work done by the hand */
        assert_true(!last.stopped && last.contacts == 0);
        pose at = home;
        for (int leg = 0; leg < LEGS; leg++) {
            vec3 lift = v3(cube_random(-4e-3, 4e-3), cube_random(0, 16e-3), leg == 3 ? cube_random(-30e-3, 0) : cube_random(-5e-3, 5e-3));
            pose to = leg == LEGS - 1 ? home : (pose){v3_add(home.position, lift), q_exp(v3(cube_random(-0.12, 0.12), cube_random(-0.05, 0.05), 0))};
            int steps = (int)ceil(probe_way(&TRANSRECTAL, at, to) / longest);
            for (int i = 1; i <= steps; i++, places++) {
                pose asked = i < steps ? pose_between(at, to, (double)i / steps) : to;
                OK(trocar_sim_save(r.sim, saved, size, &why));
                trocar_probe p = move_to(&r, asked);
                pose from = place_of(&last), now = place_of(&p);
                vec3 turn = q_log(q_multiply(now.orientation, q_conjugate(from.orientation)));
                work -= 0.5 * v3_dot(v3_add(vector(p.force), vector(last.force)), v3_sub(now.position, from.position));
                work -= 0.5 * v3_dot(v3_add(vector(p.torque), vector(last.torque)), turn);
                if (p.contacts == 0 && least_gap(&r, now, true) < -0.5e-3) lost++;
                deepest = fmin(deepest, least_gap(&r, now, false));
                double change = change_of(&last, &p);
                if (change > 1.0) {
                    change = change_in_parts(&r, saved, size, last, now, change);
                    p = trocar_view_probe(trocar_sim_view(r.sim));
                }
                if (change > 1.0 && last.contacts > 0 && p.contacts > 0) { /* does not count as a jump when contact begins or ends */
                    jumps++;
                    print_message("motion %d, %.1f of it: %.3f to %.3f N, %d to %d points, on a way of %.3f mm\n", LEGS * path + leg, (double)i / steps,
                                  v3_norm(vector(last.force)), v3_norm(vector(p.force)), last.contacts, p.contacts, 1e3 * probe_way(&TRANSRECTAL, from, now));
                }
                worst = fmax(worst, change);
                most = fmax(most, v3_norm(vector(p.force)));
                stops += p.stopped;
                pressed += p.contacts > 0;
                last = p;
            }
            at = to;
        }
        least_work = fmin(least_work, work);
    }
    print_message("%d motions, %d places: pressed at %d, stopped at %d, contact lost at %d, %.2f N at most, nodes inside by %.1e mm, %d jumps, the largest change "
                  "%.2f of one, least work %.1e J\n", motions, places, pressed, stops, lost, most, -1e3 * deepest, jumps, worst, least_work);
    assert_true(pressed > places / 4);
    assert_true(stops > 0 || motions < 20);
    assert_int_equal(lost, 0);
    assert_true(most <= 35.0 + 1e-9);
    assert_true(deepest > -1e-6);
    assert_int_equal(jumps, 0);
    assert_true(least_work > -1e-3);
    free(saved);
    close_rectum(&r);
}

/* Checks that the figure-8 scene is refused with these keys added. */
static void refused_in_a_file(const char *keys, const char *says) {
    char folder[] = "/tmp/test_probe.XXXXXX", path[64], line[512];
    trocar_scene *scene;
    trocar_model *model;
    assert_non_null(mkdtemp(folder));
    snprintf(path, sizeof path, "%s/scene.yaml", folder);
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    fprintf(file, "%s\n", keys);
    fclose(file);
    snprintf(line, sizeof line, "sed 's|^mesh: |mesh: " MESHES "/|' " MESHES "/figure8.yaml >> %s", path);
    assert_int_equal(system(line), 0);
    trocar_status status = trocar_scene_load(path, &scene, &why);
    if (status == TROCAR_OK) status = trocar_model_create(scene, NULL, &model, &why), trocar_scene_free(scene);
    assert_int_equal(status, TROCAR_BAD_INPUT);
    if (!strstr(why.text, says) || !strstr(why.text, path)) fail_msg("%s", why.text);
    unlink(path);
    rmdir(folder);
}

static void refused(void **state) {
    (void)state;
    static const struct { const char *key, *value, *says; } wrong[] = {
        {"probe.surface", "rectum_wall", "probe.surface: "}, {"probe.tip_radius", "0.02", "probe.tip_radius: 0.02 m exceeds the radius"},
        {"probe.surface", "fixed", "all nodes of \"fixed\" are fixed"}};
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim = NULL;
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
        OK(trocar_scene_set(scene, "probe.surface", "skin", &why));
        OK(trocar_scene_set(scene, wrong[i].key, wrong[i].value, &why));
        trocar_status status = trocar_model_create(scene, NULL, &model, &why);
        if (status == TROCAR_OK) status = trocar_sim_create(model, &sim, &why), trocar_model_free(model);
        assert_int_equal(status, TROCAR_BAD_INPUT);
        if (!strstr(why.text, wrong[i].says)) fail_msg("%s", why.text);
        trocar_scene_free(scene);
    }
    refused_in_a_file("probe: {surface: rectum_wall}", "scene.yaml:1: probe.surface: ");
    refused_in_a_file("probe: {surface: fixed}", "scene.yaml:1: probe.surface: all nodes of \"fixed\" are fixed: name");
    refused_in_a_file("probe: {surface: skin, radius: 0.01,\n  start: {position: [0, 0, -0.1]}}", "scene.yaml:2: probe.start: its axis lies in the tissue");
    refused_in_a_file("probe: {surface: skin, start: {position: [0, 0]}}", "scene.yaml:1: probe.start.position: expected three numbers");
    trocar_pose pose = across(0, 0);
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    OK(trocar_sim_create(model, &sim, &why));
    assert_int_equal(trocar_sim_set_probe(sim, &pose, &why), TROCAR_BAD_INPUT);
    assert_int_equal(trocar_view_probe(trocar_sim_view(sim)).placed, 0);
    trocar_sim_free(sim);
    trocar_model_free(model);
    model = create_model();
    OK(trocar_sim_create(model, &sim, &why));
    pose.position[0] = NAN;
    assert_int_equal(trocar_sim_set_probe(sim, &pose, &why), TROCAR_BAD_INPUT);
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(distance_to_a_rounded_cylinder), cmocka_unit_test(complementarity_among_all_subsets), cmocka_unit_test(contact_against_sweeps),
        cmocka_unit_test(needles_feel_it), cmocka_unit_test(pressed_and_released), cmocka_unit_test(beside_a_held_needle), cmocka_unit_test(beside_a_resting_needle), cmocka_unit_test(saved_and_restored), cmocka_unit_test(with_a_worker),
        cmocka_unit_test(rests_at_the_scenes_place), cmocka_unit_test(does_not_pass_the_wall), cmocka_unit_test(moved_at_random),
        cmocka_unit_test(refused),
    };
    if (getenv("MOTIONS")) motions = atoi(getenv("MOTIONS"));
    if (getenv("SEED")) seed = atoi(getenv("SEED"));
    return cmocka_run_group_tests(tests, create, destroy);
}

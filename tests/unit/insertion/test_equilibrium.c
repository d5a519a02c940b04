/* Checks the solution of a tick: the tissue's equilibrium against an assembled K, the needle's equilibrium through its bending moments, and a base on a
   spring against a rigid base. */
#include "lockstep.h"
#include "refinement/refined_mesh.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

/* Checks that K u = f on the refined mesh, with K assembled here element by element, and that the forces on tissue and base add up to zero. */
static void check_equilibrium(remesh_method method) {
    simulation_config c = lockstep_config();
    c.volumetric = STRAIN_BY_ELEMENT; /* check_vtu.py tests STRAIN_BY_NODE */
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_remesh_by(l, method);
    lockstep_move(l, v3(0, 0, 0.07), 1.0, 1e-3);
    lockstep_move(l, v3(0.004, 0.008, 0), 0.2, 1e-3);

    const mesh *m = &l->parts.mesh;
    refinement refined;
    refined_mesh whole;
    trocar_error why;
    insertion_refinement(&l->state, &refined);
    assert_int_equal(refined_mesh_create(m, &refined, &whole, &why), TROCAR_OK);
    vec3 *u = calloc((size_t)whole.node_count, sizeof *u), *residual = calloc((size_t)whole.node_count, sizeof *residual);
    vec3 sum = v3(0, 0, 0), reaction = v3(0, 0, 0);
    run_displacement(&l->run, &l->state, u, u + m->node_count);
    insertion_forces(&l->parts.insertion, &l->state, residual, residual + m->node_count);
    for (int i = 0; i < whole.node_count; i++) sum = v3_add(sum, residual[i]), residual[i] = v3_scale(-1, residual[i]);
    for (int e = 0; e < whole.tet_count; e++) {
        const region_material *material = &l->parts.materials[m->region[whole.parent[e]]];
        vec3 x[4];
        double k[12][12];
        for (int a = 0; a < 4; a++) x[a] = whole.nodes[whole.tets[e][a]];
        tet_stiffness(x, material->youngs_modulus, material->poisson_ratio, k);
        for (int a = 0; a < 12; a++)
            for (int b = 0; b < 12; b++) ((double *)&residual[whole.tets[e][a / 3]])[a % 3] += k[a][b] * ((double *)&u[whole.tets[e][b / 3]])[b % 3];
    }
    for (int i = 0; i < whole.node_count; i++) {
        if (i < m->node_count && l->parts.tissue.fixed[i]) reaction = v3_add(reaction, residual[i]);
        else assert_true(v3_norm(residual[i]) < 1e-9 * v3_norm(sum));
    }
    vec3 base = v3_sub(l->wrench.force, l->state.tip.dent.damping); /* force on the base, without the damping force at the tip */
    assert_true(v3_norm(v3_add(sum, base)) < 1e-12);
    assert_true(v3_norm(v3_sub(reaction, base)) < 1e-9 * v3_norm(sum));
    free(u);
    free(residual);
    refined_mesh_free(&whole);
    lockstep_free(l);
}

static void tissue_is_in_equilibrium_with_the_base(void **unused) {
    (void)unused;
    check_equilibrium(REMESH_NESTED);
    check_equilibrium(REMESH_IMPLICIT);
}

/* Returns the largest difference between the bending moment at the root, computed from the needle's shape alone, and the contact forces' moment about the
   base. */
static double worst_imbalance(double tolerance, double speed) {
    simulation_config c = lockstep_config();
    c.insertion.tolerance = tolerance;
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.06), 1.0, 1e-3);
    double worst = 0.0;
    for (int i = 0; i < 200; i++) {
        lockstep_move(l, v3_scale(speed, v3(0.02, 0.05, -0.1)), 1e-3, 1e-3);
        double off = v3_norm(v3_sub(needle_root_moment(&l->parts.needle, &l->state.needle), l->wrench.torque));
        worst = fmax(worst, off / fmax(v3_norm(l->wrench.torque), 1e-3));
    }
    lockstep_free(l);
    return worst;
}

/* The moments balance, whatever shape the first pass starts from. With the default tolerance the imbalance is small, whether or not the motion is slow
   enough for a single pass. */
static void needle_is_in_equilibrium_with_its_bending(void **unused) {
    (void)unused;
    const double speeds[] = {0.25e-3, 0.5e-3, 0.75e-3, 1e-3, 2e-3};
    for (int i = 0; i < 5; i++) {
        double converged = worst_imbalance(1e-18, speeds[i]), usual = worst_imbalance(lockstep_config().insertion.tolerance, speeds[i]);
        print_message("bending at the root against the base torque at %.2f of full speed: %.1e; %.1e at the default tolerance\n", 1e3 * speeds[i], converged, usual);
        assert_true(converged < 1e-6);
        assert_true(usual < 2e-3);
    }
}

/* After steps of very different lengths, or a jump of the base, the previous motion does not predict the next shape. The forces must then equal those
   without prediction. */
static void jumps_and_uneven_steps_do_not_mislead(void **unused) {
    (void)unused;
    const struct { double dt, jump; } cases[] = {{1e-3, 0.0}, {1e-5, 1e-3}, {1e-6, 1e-4}, {1e-3, 1e-3}, {0.2, 0.0}, {0.2, 1e-3}};
    simulation_config c = lockstep_config();
    for (int i = 0; i < 6; i++) {
        double force[2][5];
        for (int guessing = 0; guessing < 2; guessing++) {
            lockstep *l = lockstep_create(&c, lockstep_start());
            lockstep_move(l, v3(0, 0, 0.05), 0.5, 1e-3);
            for (int k = -1; k < 5; k++) {
                if (!guessing) l->state.motion.time = 0.0;
                if (k < 0) lockstep_move(l, v3(0, cases[i].jump, 0), cases[i].dt, cases[i].dt);
                else lockstep_move(l, v3(0, 0, 0), 1e-3, 1e-3), force[guessing][k] = v3_norm(l->wrench.force);
            }
            lockstep_free(l);
        }
        for (int k = 0; k < 5; k++) assert_true(fabs(force[1][k] - force[0][k]) < 2e-3 * force[0][k]);
    }
}

/* A rigid base that is moved, tick by tick, to where the base on the spring was feels the same wrench. The exception is a tick in which a contact becomes
   active, because the rigid base has then already moved and the other has not. */
static void spring_coupled_base_matches_rigid_base(void **state) {
    (void)state;
    simulation_config config = lockstep_config();
    lockstep *sprung = lockstep_create(&config, lockstep_start()), *rigid = lockstep_create(&config, lockstep_start());
    sprung->base_compliance = 2e-3;
    pose rest = lockstep_start();
    double furthest = 0.0;
    for (int i = 0; i < 600; i++) {
        rest.position = v3_add(rest.position, i < 500 ? v3(0, 0, 0.1e-3) : v3(0.03e-3, 0, 0));
        lockstep_tick(sprung, rest, 1e-3);
        vec3 shift = sprung->state.base_shift, expected = v3_scale(2e-3, sprung->wrench.force);
        assert_true(v3_norm(v3_sub(shift, expected)) < 1e-9);
        lockstep_tick(rigid, (pose){v3_add(rest.position, shift), rest.orientation}, 1e-3);
        assert_true(v3_norm(v3_sub(rigid->wrench.force, sprung->wrench.force)) < 5e-3 * v3_norm(rigid->wrench.force) + 1e-6);
        assert_true(v3_norm(v3_sub(rigid->wrench.torque, sprung->wrench.torque)) < 5e-3 * v3_norm(rigid->wrench.torque) + 1e-6);
        furthest = fmax(furthest, v3_norm(shift));
    }
    assert_true(sprung->wrench.contacts > 5 && furthest > 2e-3);
    lockstep_free(sprung);
    lockstep_free(rigid);
}

/* The needle is pushed, 2 mm off its axis, against skin that is never punctured, until it reaches Euler's load and buckles. Every wrench balances the
   needle's bending moment, and the wrench never jumps. Once the needle has slipped off the skin, the wrench is zero. */
static void bowed_needle_is_in_equilibrium(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    for (int i = 0; i < c.region_count; i++) c.regions[i].material.youngs_modulus = 2e6;
    for (int i = 0; i < c.membrane_count; i++) c.membranes[i].puncture_force = INFINITY;
    double section = M_PI / 64.0 * (pow(c.needle.outer_diameter, 4) - pow(c.needle.inner_diameter, 4));
    double euler = 20.19 * c.needle.youngs_modulus * section / pow(c.needle.length, 2); /* clamped and hinged */
    for (int beside = 0; beside < 3; beside++) {
        pose start = lockstep_start();
        start.position.x += 5e-3 * beside;
        lockstep *l = lockstep_create(&c, start);
        lockstep_move(l, v3(0, 0, 1.8e-3), 0.1, 1e-3);
        lockstep_move(l, v3(2e-3, 0, 0), 0.1, 1e-3);
        double peak = 0.0, worst_jump = 0.0, worst_moment = 0.0;
        for (int i = 0; i < 900; i++) {
            vec3 before = l->wrench.force;
            lockstep_move(l, v3(0, 0, 3e-5), 1e-3, 1e-3);
            double force = v3_norm(l->wrench.force), torque = v3_norm(l->wrench.torque);
            if (l->wrench.events & EVENT_UNSTABLE) {
                assert_true(force == 0.0 && torque == 0.0);
                break;
            }
            double off = v3_norm(v3_sub(needle_root_moment(&l->parts.needle, &l->state.needle), l->wrench.torque));
            worst_moment = fmax(worst_moment, off / fmax(torque, 1e-2));
            worst_jump = fmax(worst_jump, v3_norm(v3_sub(l->wrench.force, before)) / fmax(0.07 * force, 0.05));
            peak = fmax(peak, force);
        }
        print_message("%d mm beside: up to %.2f N (Euler's load %.2f N); largest step %.2f of max(7 %%, 0.05 N), moment off by %.1e\n", 5 * beside, peak,
                      euler, worst_jump, worst_moment);
        assert_true(fabs(peak / euler - 1.0) < 0.1);
        assert_true(worst_jump < 1.0 && worst_moment < 1e-3);
        lockstep_free(l);
    }
}

/* Returns the next pose of a hand that changes its motion every 13 ms, in any direction and with rotation. */
static pose next_hand(pose base, int tick, vec3 *velocity, double *turning, double *turn) {
    static const double SPEED = 0.3, TURNING = 20.0, ROOM = 0.01; /* SPEED: m/s; TURNING: rad/s; ROOM: m, to each side */
    vec3 start = lockstep_start().position;
    start.z += 0.06;
    if (tick % 13 == 0) {
        for (int a = 0; a < 3; a++) ((double *)velocity)[a] = SPEED * (2.0 * rand() / RAND_MAX - 1.0);
        *turning = TURNING * (2.0 * rand() / RAND_MAX - 1.0);
    }
    for (int a = 0; a < 3; a++) {
        double *v = &((double *)velocity)[a], off = ((double *)&base.position)[a] - ((double *)&start)[a];
        if (fabs(off) > ROOM && off * *v > 0.0) *v = -*v;
    }
    *turn += *turning * 1e-3;
    return (pose){v3_axpy(1e-3, *velocity, base.position), {cos(0.5 * *turn), 0, 0, sin(0.5 * *turn)}};
}

/* The predicted shape only gives the passes a better starting point. If they run down to rounding error, they reach the same equilibrium with and without
   prediction. Each tick is run twice from the same state, once with the last step's motion and once without. The scene has no old tracks, where several
   equilibria may lie close together. In a guide, friction depends on the previous passes to within the tolerance at the hole's edge, so there the prediction
   only has to save passes. */
static void a_guess_is_only_a_better_start(void **unused) {
    (void)unused;
    static const char *const NAMES[] = {"a guide", "tissue"};
    for (int kind = 0; kind < 2; kind++) {
        simulation_config c = lockstep_config();
        c.insertion.track_reach = 0.0;
        if (kind == 0) {
            c.guide_count = 1;
            c.guides[0] = guide_defaults();
            c.guides[0].origin = v3(0.005, 0.003, -0.06);
            c.guides[0].normal = v3(0, 0, 1);
            c.guides[0].columns = c.guides[0].rows = 1;
            c.guides[0].hole_diameter = c.needle.outer_diameter + 1e-4;
        } else {
            c.insertion.max_passes = 20;
            c.insertion.tolerance = 1e-20; /* to rounding */
        }
        lockstep *l = lockstep_engaged(&c), *without = lockstep_engaged(&c);
        vec3 velocity = v3(0, 0, 0);
        double turning = 0.0, turn = 0.0, peak = 0.0, worst = 0.0;
        int passes = 0, passes_without = 0;
        srand(1);
        for (int i = 0; i < 1500; i++) {
            pose base = next_hand(l->base, i, &velocity, &turning, &turn);
            memcpy(&without->state, &l->state, sizeof l->state);
            memcpy(without->snapshot, l->snapshot, sizeof *l->snapshot);
            without->state.motion.time = 0.0;
            lockstep_tick(l, base, 1e-3);
            lockstep_tick(without, base, 1e-3);
            passes += l->wrench.passes;
            passes_without += without->wrench.passes;
            peak = fmax(peak, v3_norm(l->wrench.force));
            worst = fmax(worst, v3_norm(v3_sub(l->wrench.force, without->wrench.force)));
        }
        print_message("%s: %d passes, without a guess %d; forces differ by up to %.1e N of %.1f N\n", NAMES[kind], passes, passes_without, worst, peak);
        assert_true(kind > 0 || passes < passes_without);
        const needle_model *needle = &l->parts.needle;
        /* force on a segment that corresponds to rotating a joint by the tolerance */
        double left = needle->bending / pow(needle->segment_length, 2) * sqrt(c.insertion.tolerance / needle->given.length);
        assert_true(kind == 0 || worst < left);
        lockstep_free(l);
        lockstep_free(without);
    }
}

/* A tick whose passes end at contact.max_passes reports INEXACT. Each tick of a fast hand is computed twice from the same state, with a single pass and with
   the default limit. The ticks that report INEXACT with a single pass must be those that need more passes, and ticks that need only one must give the same
   result in both cases. */
static void passes_that_do_not_converge_are_reported(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    lockstep *usual = lockstep_engaged(&c);
    c.insertion.max_passes = 1;
    lockstep *single = lockstep_engaged(&c);
    vec3 velocity = v3(0, 0, 0);
    double turning = 0.0, turn = 0.0;
    int reported = 0, enough = 0;
    srand(1);
    for (int i = 0; i < 1500; i++) {
        pose base = i % 100 < 50 ? next_hand(usual->base, i, &velocity, &turning, &turn) : usual->base; /* the hand alternates between moving and resting */
        memcpy(&single->state, &usual->state, sizeof usual->state);
        memcpy(single->snapshot, usual->snapshot, sizeof *usual->snapshot);
        lockstep_tick(usual, base, 1e-3);
        lockstep_tick(single, base, 1e-3);
        bool inexact = single->wrench.events & EVENT_INEXACT;
        assert_false(usual->wrench.events & EVENT_INEXACT);
        if (inexact) assert_true(usual->wrench.passes > 1);
        if (usual->wrench.passes == 1) {
            assert_false(inexact);
            assert_memory_equal(&single->wrench.force, &usual->wrench.force, sizeof usual->wrench.force);
            enough++;
        }
        reported += inexact;
    }
    print_message("with a single pass, %d ticks are inexact; in %d ticks, one pass is enough\n", reported, enough);
    assert_true(reported > 50 && enough > 500);
    lockstep_free(usual);
    lockstep_free(single);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(tissue_is_in_equilibrium_with_the_base),
        cmocka_unit_test(needle_is_in_equilibrium_with_its_bending),
        cmocka_unit_test(jumps_and_uneven_steps_do_not_mislead),
        cmocka_unit_test(spring_coupled_base_matches_rigid_base),
        cmocka_unit_test(bowed_needle_is_in_equilibrium),
        cmocka_unit_test(a_guess_is_only_a_better_start),
        cmocka_unit_test(passes_that_do_not_converge_are_reported),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

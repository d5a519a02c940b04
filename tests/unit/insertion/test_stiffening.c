/* Tests stiffening tissue: its laws against numerical integrals and a resolved disc, and its effect in the tick.
   tests/verification/needle/verify_large_deflection.py compares the rigid needle with resolved hyperelastic elements. */
#include "shared/allocator_calls.h"
#include "insertion/laws/stiffening.h"
#include "insertion/step/tick.h"
#include "lockstep.h"
#include "verification/random_hand.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <time.h>
#include <cmocka.h>

#include "check.h"

static const double RADIUS = 0.635e-3, MU = 6897.0; /* m, Pa */

/* ---- laws ----------------------------------------------------------------------------------------------------------------- */

/* Returns the shear strain under a stress of `stress` times mu, found by bisection. */
static double shear_under(double stress, double stiffening) {
    double low = 0.0, high = stress;
    for (int i = 0; i < 100; i++) {
        double middle = 0.5 * (low + high);
        *(middle * (1.0 + 2.0 * stiffening * middle * middle) < stress ? &low : &high) = middle;
    }
    return 0.5 * (low + high);
}

/* Integrates the shear strain in excess of its linear value over the distance from the axis or the tip. The stress at distance rho is `stress` times mu (r /
   rho)^power. */
static double shift_by_quadrature(double stress, double stiffening, int power) {
    const int n = 20000;
    double sum = 0.0, step = log(1e5) / n;
    for (int i = 0; i < n; i++) {
        double rho = exp((i + 0.5) * step), linear = stress / pow(rho, power);
        sum += (shear_under(linear, stiffening) - linear) * rho * step * RADIUS;
    }
    return sum;
}

static void laws_are_integrals_of_the_shear(void **unused) {
    (void)unused;
    for (double stiffening = 0.05; stiffening < 100; stiffening *= 8.0)
        for (double stress = 0.05; stress < 50; stress *= 5.0) {
            double force = stress * 2.0 * M_PI * MU * RADIUS * 0.01, stiffness = 2.0 * M_PI * MU * 0.01; /* 10 mm of shaft */
            stiffening_law law = stiffening_of_shaft(stiffening, RADIUS, stiffness, INFINITY);
            double expected = shift_by_quadrature(stress, stiffening, 1), got = stiffening_at(&law, force).shift;
            assert_close(got, expected, 1e-5 * fabs(expected));
            /* the tip, in units in which its linear displacement is `stress` radii */
            law = stiffening_of_tip(stiffening, RADIUS, 1.0, 1.0, 1.0, INFINITY);
            force = stress * RADIUS;
            double unit = force * law.scale / sqrt(2.0 * stiffening) / stress; /* stress of the tip's field per radius of linear displacement */
            expected = shift_by_quadrature(stress * unit, stiffening, 2) / unit;
            assert_close(stiffening_at(&law, force).shift, expected, 1e-5 * fabs(expected));
        }
}

/* Checks that the law is odd, that its tangent is its derivative up to the law's limit, and that the displacement, linear part included, is monotonic. */
static void check_law(const stiffening_law *law, double linear, double room) {
    stiffening_shift last = {0};
    const double step = 0.01 / law->scale;
    for (int i = 1; i < 4000; i++) {
        stiffening_shift at = stiffening_at(law, i * step), back = stiffening_at(law, -i * step);
        assert_true(at.shift == -back.shift && at.slope == back.slope);
        assert_true(at.slope <= last.slope && at.slope >= -room * (1.0 + 1e-9));
        assert_true(linear * step + at.shift - last.shift > 0.0);
        assert_close(at.shift - last.shift, 0.5 * (at.slope + last.slope) * step, 2e-3 * linear * step); /* the slope changes abruptly at the limit */
        last = at;
    }
}

static void laws_are_smooth_and_limited(void **unused) {
    (void)unused;
    for (double stiffening = 1e-12; stiffening < 200; stiffening *= 10)
        for (double part = 0.0; part < 1.0; part += 0.3) {
            double stiffness = 400.0, linear = 2.0 / stiffness;
            stiffening_law shaft = stiffening_of_shaft(stiffening, RADIUS, stiffness, part * linear);
            check_law(&shaft, linear, part * linear);
            stiffening_law tip = stiffening_of_tip(stiffening, RADIUS, 1.0 / 32.0, 1.0 / MU, 2.0 * M_PI, part / 32.0);
            check_law(&tip, 1.0 / 32.0, part / 32.0);
        }
    assert_int_equal(stiffening_of_shaft(0.0, RADIUS, 1.0, 1.0).field, NOT_STIFFENING);
    assert_int_equal(stiffening_of_tip(1.0, RADIUS, 0.03, 0.0, 6.0, 0.01).field, NOT_STIFFENING); /* bone */
}

/* Compares the law with the force (N) on a disc bonded to the surface of a 60 x 60 mm block (radius x height) and pressed in, with E = 20 kPa, nu = 0.45 and
   r = 0.635 mm. The forces were computed with CalculiX (tests/verification/references/pressed_disc.py; element size at the rim 0.1 r for S = 0.2 and 0.3 r
   for S = 1). The law was fitted only to the value for S = 1 at 1.6 mm. */
static void disc_matches_resolved_elements(void **unused) {
    (void)unused;
    static const struct { double stiffening, moved, force; } resolved[] = {
        {0.2, 0.4e-3, 0.01295}, {0.2, 0.6e-3, 0.01968}, {0.2, 0.8e-3, 0.02673}, {0.2, 0.9e-3, 0.03038},
        {1.0, 0.4e-3, 0.01406}, {1.0, 0.8e-3, 0.03109}, {1.0, 1.2e-3, 0.05180}, {1.0, 1.6e-3, 0.07631}, {1.0, 2.0e-3, 0.10472}, {1.0, 2.2e-3, 0.12038},
    };
    const double disc = 1.0 / 32.2; /* m/N, linear theory; the coarser mesh gives 33.3 N/m for small dents, so the S = 1 values are up to 3 % too stiff */
    for (int i = 0; i < (int)(sizeof resolved / sizeof *resolved); i++) {
        stiffening_law law = stiffening_of_tip(resolved[i].stiffening, RADIUS, disc, 1.0 / MU, 2.0 * M_PI, INFINITY);
        double moved = disc * resolved[i].force + stiffening_at(&law, resolved[i].force).shift;
        printf("disc, S = %g, %.1f mm: %.1f %% off; linear %.1f %%\n", resolved[i].stiffening, 1e3 * resolved[i].moved, 100 * (moved / resolved[i].moved - 1.0),
               100 * (disc * resolved[i].force / resolved[i].moved - 1.0));
        assert_close(moved / resolved[i].moved, 1.0, 0.03);
    }
}

/* ---- the tick --------------------------------------------------------------------------------------------------------------- */

static simulation_config stiffened(double stiffening) {
    simulation_config c = lockstep_config();
    for (int i = 0; i < c.region_count; i++) c.regions[i].material.stiffening = stiffening;
    return c;
}

/* Returns a scene with a rigid needle that sticks to the tissue and does not cut. */
static simulation_config stuck(double stiffening) {
    simulation_config c = stiffened(stiffening);
    c.needle.youngs_modulus = 2e18;
    for (int i = 0; i < c.region_count; i++) {
        region_material *m = &c.regions[i].material;
        m->cutting_force = m->friction_static = m->friction_kinetic = 1e4;
    }
    return c;
}

/* If the only tissue that stiffens lies outside the needle's path, the forces do not change. */
static void without_stiffening_all_bits_are_the_same(void **unused) {
    (void)unused;
    simulation_config plain = lockstep_config(), other = plain;
    assert_string_equal(other.regions[0].name, "prostate"); /* the region that stiffens, which begins 35 mm deep */
    other.regions[0].material.stiffening = 10.0;
    lockstep *a = lockstep_create(&plain, lockstep_start()), *b = lockstep_create(&other, lockstep_start());
    for (int i = 1; i <= 500; i++) {
        pose base = lockstep_start();
        base.position = v3_axpy(0.02 * sin(M_PI * i / 500), v3(0.1, 0, 1), base.position);
        lockstep_tick(a, base, 1e-3);
        lockstep_tick(b, base, 1e-3);
        assert_memory_equal(&a->wrench, &b->wrench, sizeof a->wrench);
    }
    assert_true(b->parts.insertion.stiffens && !a->parts.insertion.stiffens);
    lockstep_free(a);
    lockstep_free(b);
}

static void stiffer_the_deeper_it_is_pulled(void **unused) {
    (void)unused;
    double last = 1.0;
    for (double stiffening = 0.0; stiffening < 5.0; stiffening += 1.0) {
        simulation_config c = stuck(stiffening);
        lockstep *l = lockstep_engaged(&c);
        double secant[2];
        for (int i = 1; i <= 30; i++) { /* 3 mm */
            double before = -l->wrench.force.z;
            lockstep_move(l, v3(0, 0, 1e-4), 0.002, 1e-3);
            assert_true(-l->wrench.force.z > before || i == 1);
            secant[i > 1] = -l->wrench.force.z / (i * 1e-4);
        }
        printf("S = %g: %.1f N/m at 0.1 mm, %.1f at 3 mm\n", stiffening, secant[0], secant[1]);
        assert_true(stiffening == 0.0 ? fabs(secant[1] / secant[0] - 1.0) < 1e-3 : secant[1] / secant[0] > last);
        last = secant[1] / secant[0];
        lockstep_free(l);
    }
}

/* The base jumps by 5 mm in one tick, far more than a hand could move it in that time. */
static void passes_stay_few(void **unused) {
    (void)unused;
    for (double stiffening = 0.1; stiffening <= 10; stiffening *= 10) {
        simulation_config c = stuck(stiffening);
        c.insertion.max_passes = 20;
        lockstep *l = lockstep_engaged(&c);
        int thrown = 0, thrown_back = 0, moved = 0;
        pose base = l->base;
        base.position.z += 5e-3;
        lockstep_tick(l, base, 1e-3);
        thrown = l->wrench.passes;
        double at_once = l->wrench.force.z;
        for (int i = 0; i < 5; i++) lockstep_tick(l, base, 1e-3);
        assert_close(at_once, l->wrench.force.z, 1e-3 * fabs(at_once));
        base.position.z -= 4.9e-3;
        lockstep_tick(l, base, 1e-3);
        thrown_back = l->wrench.passes;
        base.position.z += 4.9e-3;
        for (int i = 0; i < 5; i++) lockstep_tick(l, base, 1e-3);
        for (int i = 0; i < 40; i++) { /* 100 mm/s */
            base.position.z -= 1e-4;
            lockstep_tick(l, base, 1e-3);
            moved = l->wrench.passes > moved ? l->wrench.passes : moved;
        }
        printf("S = %g: %d passes in a 5 mm tick, %d in one back, at most %d at 100 mm/s\n", stiffening, thrown, thrown_back, moved);
        assert_true(thrown <= 6 && thrown_back <= 12 && moved <= 3);
        lockstep_free(l);
    }
}

/* In elastic or relaxing tissue, no motion of the hand gets more work out of the tissue than the hand has put in. */
static void nothing_is_gained_from_the_tissue(void **unused) {
    (void)unused;
    static const relaxation_term series[] = {{0.3, 0.02}, {0.3, 0.2}};
    for (int relaxing = 0; relaxing < 2; relaxing++) {
        simulation_config c = stuck(3.0);
        c.relaxation_count = relaxing ? 2 : 0;
        memcpy(c.relaxation, series, sizeof series);
        lockstep *l = lockstep_engaged(&c);
        checkpoint *rest = malloc(sizeof *rest);
        run_save(&l->state, l->snapshot, rest);
        tick_output at_rest = l->wrench;
        pose start = l->base;
        double least = 0.0, most = 0.0, left = INFINITY;
        unsigned seed = 1;
        for (int run = 0; run < 20; run++) {
            trocar_error why;
            assert_int_equal(run_restore(&l->run, rest, &l->state, l->snapshot, &why), TROCAR_OK);
            l->base = start;
            l->wrench = at_rest;
            double work = 0.0;
            for (int leg = 0; leg < 10; leg++) { /* the last leg returns to the start */
                vec3 goal = leg < 9 ? v3(hand_uniform(&seed, -1e-3, 1e-3), hand_uniform(&seed, -1e-3, 1e-3), hand_uniform(&seed, -4e-3, 4e-3)) : v3(0, 0, 0);
                pose from = l->base;
                int ticks = (int)hand_uniform(&seed, 20, 60);
                for (int i = 1; i <= ticks; i++) {
                    vec3 then = l->wrench.force, before = l->base.position;
                    pose base = from;
                    base.position = v3_add(from.position, v3_scale((double)i / ticks, v3_sub(v3_add(start.position, goal), from.position)));
                    lockstep_tick(l, base, 1e-3);
                    work -= 0.5 * v3_dot(v3_add(then, l->wrench.force), v3_sub(base.position, before));
                    least = fmin(least, work);
                    most = fmax(most, work);
                }
            }
            left = fmin(left, work);
        }
        printf("%s: hand's work from %.3g to %.3g mJ, after a round trip at least %.3g\n", relaxing ? "creeping" : "elastic", 1e3 * least, 1e3 * most, 1e3 * left);
        assert_true(least > -2e-3 * most && left > -2e-3 * most);
        if (!relaxing) assert_true(left < 2e-2 * most);
        free(rest);
        lockstep_free(l);
    }
}

static void relaxing_spring_relaxes(void **unused) {
    (void)unused;
    static const relaxation_term series[] = {{0.4, 0.05}};
    simulation_config plain = stuck(3.0), relaxing = plain;
    relaxing.relaxation_count = 1;
    memcpy(relaxing.relaxation, series, sizeof series);
    lockstep *a = lockstep_engaged(&plain), *b = lockstep_engaged(&relaxing);
    double off = -b->wrench.force.z;
    pose base = a->base;
    base.position.z += 3e-3;
    for (int i = 0; i < 300; i++) {
        lockstep_tick(a, base, 1e-3);
        lockstep_tick(b, base, 1e-3);
        double expected = relaxation_at(1, series, i * 1e-3);
        assert_close((-b->wrench.force.z - off) / -a->wrench.force.z, expected, 0.02);
    }
    lockstep_free(a);
    lockstep_free(b);
}

enum { TICKS = 400, RUNS = 5 };

/* Measures the CPU time (s) of ticks that move the needle in and out by 1 mm, at no more than 50 mm/s. */
static void time_ticks(lockstep *l, double *times, double *passes) {
    pose start = l->base;
    for (int i = 0; i < TICKS; i++) {
        struct timespec before, after;
        pose base = start;
        base.position.z += 5e-4 * (1.0 - cos(0.1 * (i + 1)));
        tick_input tick = {.model = &l->parts.insertion, .snapshot = l->snapshot, .base = {.pose = base}, .dt = 1e-3};
        int64_t counted = allocator_calls();
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &before);
        insertion_tick(&tick, &l->state, l->run.workspace, &l->wrench);
        clock_gettime(CLOCK_THREAD_CPUTIME_ID, &after);
        if (ALLOCATIONS_ARE_COUNTED) assert_int_equal(allocator_calls() - counted, 0);
        times[i] = after.tv_sec - before.tv_sec + 1e-9 * (after.tv_nsec - before.tv_nsec);
        *passes += (double)l->wrench.passes / (RUNS * TICKS);
    }
}

static int by_size(const void *a, const void *b) { return (*(const double *)a > *(const double *)b) - (*(const double *)a < *(const double *)b); }

/* Alternates measurements in linear and in stiffening tissue. The times are printed but not checked, because the machine may be busy. */
static void tick_allocates_nothing(void **unused) {
    (void)unused;
    static double times[2][RUNS * TICKS];
    double passes[2] = {0};
    lockstep *l[2];
    checkpoint *saved[2];
    for (int k = 0; k < 2; k++) {
        simulation_config c = stiffened(2.0 * k);
        l[k] = lockstep_create(&c, lockstep_start());
        lockstep_move(l[k], v3(0, 0, 0.075), 1.0, 1e-3);
        saved[k] = malloc(sizeof *saved[k]);
        run_save(&l[k]->state, l[k]->snapshot, saved[k]);
    }
    for (int run = 0; run < RUNS; run++)
        for (int k = 0; k < 2; k++) {
            trocar_error why;
            assert_int_equal(run_restore(&l[k]->run, saved[k], &l[k]->state, l[k]->snapshot, &why), TROCAR_OK);
            time_ticks(l[k], &times[k][run * TICKS], &passes[k]);
        }
    for (int k = 0; k < 2; k++) qsort(times[k], RUNS * TICKS, sizeof **times, by_size);
    double linear = times[0][RUNS * TICKS / 2], stiff = times[1][RUNS * TICKS / 2];
    printf("tick with %d contacts: median %.1f us in %.3f passes; stiffening %.1f us in %.3f passes: %.3f times\n", contacts_active(&l[0]->state), 1e6 * linear,
           passes[0], 1e6 * stiff, passes[1], stiff / linear);
    for (int k = 0; k < 2; k++) {
        free(saved[k]);
        lockstep_free(l[k]);
    }
}

static void restored_simulation_continues_bit_identically(void **unused) {
    (void)unused;
    simulation_config c = stiffened(2.0);
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.04), 0.4, 1e-3);
    checkpoint *saved = malloc(sizeof *saved);
    run_save(&l->state, l->snapshot, saved);
    pose base = l->base;
    vec3 first[100];
    trocar_error why;
    for (int turn = 0; turn < 2; turn++) {
        l->base = base;
        for (int i = 0; i < 100; i++) {
            pose to = base;
            to.position = v3_axpy(1e-4 * i, v3(0.2, 0, 1), base.position);
            lockstep_tick(l, to, 1e-3);
            if (turn == 0) first[i] = l->wrench.force;
            else assert_memory_equal(&first[i], &l->wrench.force, sizeof *first);
        }
        assert_int_equal(run_restore(&l->run, saved, &l->state, l->snapshot, &why), TROCAR_OK);
    }
    free(saved);
    lockstep_free(l);
}

/* ---- the skin ----------------------------------------------------------------------------------------------------------------- */

/* Presses a rigid needle against the skin of a uniform body with a steadily increasing force until it punctures, and records the force at each millimetre.
   Returns the displacement at puncture (m). */
static double press(const simulation_config *given, double speed, double most, double *force, int count) {
    simulation_config c = *given;
    c.needle.youngs_modulus = 2e18;
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.9999e-3), 0.01, 1e-3);
    pose from = l->base;
    double moved = 0.0;
    for (int i = 1; moved < most; i++) {
        moved = i * 1e-3 * speed;
        pose base = from;
        base.position.z += 1e-7 + moved;
        double before = -l->wrench.force.z;
        lockstep_tick(l, base, 1e-3);
        if (l->wrench.events & EVENT_PUNCTURED) break;
        assert_true(-l->wrench.force.z > before);
        int at = (int)(1e3 * moved + 1e-6);
        if (at >= 1 && at <= count && moved < 1e-3 * at + 1e-3 * speed) force[at - 1] = -l->wrench.force.z;
    }
    lockstep_free(l);
    return moved;
}

static simulation_config one_tissue(double modulus, double stiffening, double puncture) {
    simulation_config c = stiffened(stiffening);
    for (int i = 0; i < c.region_count; i++) c.regions[i].material.youngs_modulus = modulus;
    for (int i = 0; i < c.membrane_count; i++) c.membranes[i].puncture_force = puncture;
    return c;
}

/* Okamura, Simone and O'Leary 2004: indenting bovine liver by d mm, up to 16 mm, takes 0.0061 d^2 + 0.0480 d N. E and S are fitted to the forces at 1 mm and
   16 mm, so the values in between test the shape of the curve. */
static void indentation_follows_liver(void **unused) {
    (void)unused;
    enum { DEEPEST_DENT = 16 };
    double modulus = 31.0e3, stiffening = 0.165, force[DEEPEST_DENT] = {0}, worst = 0.0;
    simulation_config c = one_tissue(modulus, stiffening, 1e3);
    press(&c, 0.02, 0.0165, force, DEEPEST_DENT);
    for (int d = 1; d <= DEEPEST_DENT; d++) {
        double liver = 0.0061 * d * d + 0.0480 * d;
        printf("%d mm: %.3f N, liver %.3f, %.1f %%\n", d, force[d - 1], liver, 100 * (force[d - 1] / liver - 1.0));
        worst = fmax(worst, fabs(force[d - 1] / liver - 1.0));
    }
    assert_true(worst < 0.05);
}

/* Mahvash and Dupont 2009: tissue loaded faster ruptures at a smaller displacement. The model reproduces this if the tissue relaxes, but it always ruptures
   at the same force, which is a constant of the membrane. */
static void faster_needle_punctures_earlier(void **unused) {
    (void)unused;
    static const relaxation_term series[] = {{0.25, 0.15}, {0.15, 2.5}};
    for (int relaxing = 0; relaxing < 2; relaxing++) {
        double last = INFINITY, speeds[] = {0.002, 0.01, 0.05, 0.2};
        for (int i = 0; i < 4; i++) {
            double force[8] = {0};
            simulation_config c = one_tissue(20e3, 0.5, 0.3);
            c.relaxation_count = relaxing ? 2 : 0;
            memcpy(c.relaxation, series, sizeof series);
            double moved = press(&c, speeds[i], 0.03, force, 8);
            printf("%s, %g mm/s: 3 mm at %.3f N, puncture at %.2f mm\n", relaxing ? "relaxing" : "elastic", 1e3 * speeds[i], force[2], 1e3 * moved);
            assert_true(moved < 0.03);
            if (relaxing) assert_true(moved < 0.99 * last || i == 0);
            else assert_true(fabs(moved - last) < 1e-3 * speeds[i] + 1e-5 || i == 0);
            last = moved;
        }
    }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(laws_are_integrals_of_the_shear),
        cmocka_unit_test(laws_are_smooth_and_limited),
        cmocka_unit_test(disc_matches_resolved_elements),
        cmocka_unit_test(without_stiffening_all_bits_are_the_same),
        cmocka_unit_test(stiffer_the_deeper_it_is_pulled),
        cmocka_unit_test(passes_stay_few),
        cmocka_unit_test(nothing_is_gained_from_the_tissue),
        cmocka_unit_test(relaxing_spring_relaxes),
        cmocka_unit_test(tick_allocates_nothing),
        cmocka_unit_test(restored_simulation_continues_bit_identically),
        cmocka_unit_test(indentation_follows_liver),
        cmocka_unit_test(faster_needle_punctures_earlier),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Guides: buckling loads against Euler, forces at the edge of a hole against beam theory, friction, which hole a tip takes, and several
   needles. */
#include "insertion/guides.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include "insertion/contact_assembly.h"
#include "lockstep.h"

/* ---- stability of a needle with its base clamped -------------------------------------------------------------------------- */

/* A single hole around the axis of figure 8's needle, `before` the tip, through which the needle fits without clearance. */
static guide_config hole_before_tip(pose start, double length, double before, double thickness, double diameter) {
    guide_config g = guide_defaults();
    g.normal = v3(0, 0, 1);
    g.origin = v3_add(start.position, v3(0, 0, length - before));
    g.hole_diameter = diameter;
    g.thickness = thickness;
    return g;
}

typedef struct {
    lockstep *l;
    tick_context tick;
} bench;

static bench bench_create(int guide_count, const guide_config *guides) {
    simulation_config c = lockstep_config();
    c.needle.segments = 64;
    c.guide_count = guide_count;
    for (int i = 0; i < guide_count; i++) c.guides[i] = guides[i];
    lockstep *l = lockstep_create(&c, lockstep_start());
    bench b = {l, {.model = &l->simulation.insertion, .state = &l->state, .snapshot = l->snapshot, .scratch = l->simulation.workspace,
                   .base = {l->base, 0.0}, .dt = 1e-3, .output = &l->wrench}};
    guides_follow(&b.tick);
    return b;
}

/* Is the straight needle stable under this dead load along it, on its tip, with its guides? By the simulation's own criterion. */
static bool is_stable(const bench *b, double load) {
    const tick_context *tick = &b->tick;
    insertion_workspace *w = tick->scratch;
    vec3 joint_loads[NEEDLE_MAX_SEGMENTS + 1] = {{0, 0, 0}};
    int n = tick->model->needle->given.segments;
    joint_loads[n] = v3(0, 0, -load);
    w->tip = false;
    list_points(tick);
    locate_points(tick);
    w->problem.count = w->problem.axial_count = w->point_count;
    needle_linearise(tick->model->needle, &tick->state->needle, joint_loads, 0, &w->tangent);
    bound_contacts(tick);
    assemble_compliance(tick);
    assemble_gaps(tick);
    assert_int_equal(contact_solve(&w->problem), TROCAR_OK);
    return w->problem.negative >= w->tangent.unstable;
}

static double buckling_load(const bench *b) {
    double low = 0.1, high = 40.0;
    assert_true(is_stable(b, low) && !is_stable(b, high));
    while (high - low > 1e-4) {
        double middle = 0.5 * (low + high);
        if (is_stable(b, middle)) low = middle; else high = middle;
    }
    return low;
}

/* Stiffness of a beam under the axial load `load` against deflection and rotation of its ends: with stability functions (Timoshenko and
   Gere, Theory of Elastic Stability). */
static void beam_column(double bending, double length, double load, double k[4][4]) {
    double u = length * sqrt(load / bending), d = 2.0 - 2.0 * cos(u) - u * sin(u);
    double a = bending / pow(length, 3) * u * u * u * sin(u) / d, b = bending / pow(length, 2) * u * u * (1.0 - cos(u)) / d;
    double near = bending / length * u * (sin(u) - u * cos(u)) / d, far = bending / length * u * (u - sin(u)) / d;
    const double rows[4][4] = {{a, b, -a, b}, {b, near, -b, far}, {-a, -b, a, -b}, {b, far, -b, near}};
    memcpy(k, rows, sizeof rows);
}

/* Is a beam stable that is clamped at one end, and held by springs at `span` and at its end, `thickness` farther? */
static bool beam_is_stable(double bending, double span, double thickness, double spring, double load) {
    double before[4][4], inside[4][4], k[4][4] = {{0}};
    beam_column(bending, span, load, before);
    beam_column(bending, thickness, load, inside);
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) k[i][j] = inside[i][j] + (i < 2 && j < 2 ? before[i + 2][j + 2] : 0.0) + (i == j && i % 2 == 0 ? spring : 0.0);
    for (int i = 0; i < 4; i++) { /* positive pivots */
        if (k[i][i] <= 0.0) return false;
        for (int r = i + 1; r < 4; r++)
            for (int c = 3; c >= i; c--) k[r][c] -= k[r][i] / k[i][i] * k[i][c];
    }
    return true;
}

static double euler_in_plate(double bending, double span, double thickness, double spring) {
    double scale = M_PI * M_PI * bending / (span * span), low = 0.3 * scale, high = 3.999 * scale;
    for (int i = 0; i < 60; i++) {
        double middle = 0.5 * (low + high);
        if (beam_is_stable(bending, span, thickness, spring, middle)) low = middle; else high = middle;
    }
    return low;
}

static void check_load(const char *what, const bench *b, double expected) {
    double load = buckling_load(b);
    print_message("%s: buckles at %.3f N, Euler %.3f N (%+.2f %%)\n", what, load, expected, 100.0 * (load / expected - 1.0));
    assert_true(fabs(load / expected - 1.0) < 0.02);
    lockstep_free(b->l);
}

static void buckling_loads_are_eulers(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    pose start = lockstep_start();
    double length = c.needle.length, d = c.needle.outer_diameter;
    double bending = c.needle.youngs_modulus * M_PI / 64.0 * (pow(d, 4) - pow(c.needle.inner_diameter, 4));
    double pi2 = M_PI * M_PI * bending / (length * length), edge = 1e-6;
    bench b = bench_create(0, NULL);
    check_load("free", &b, 0.25 * pi2);
    guide_config g = hole_before_tip(start, length, edge, 0.0, d);
    b = bench_create(1, &g);
    check_load("guided at its end", &b, 2.0457 * pi2);
    double thin = 4e-3; /* a clamp, nearly: a third of it is free to bend */
    g = hole_before_tip(start, length, thin + edge, thin, d);
    g.stiffness = 1e8;
    b = bench_create(1, &g);
    check_load("guided in direction, by 4 mm, edges rigid", &b, 4.0 * M_PI * M_PI * bending / pow(length - thin, 2));
    for (int i = 0; i < 4; i++) {
        char what[64];
        double thickness = i < 2 ? 10e-3 : 20e-3;
        g = hole_before_tip(start, length, thickness + edge, thickness, d);
        if (i % 2 == 0) g.stiffness = 1e8;
        snprintf(what, sizeof what, "guided in direction, by %.0f mm, edges of %g N/m", 1e3 * thickness, g.stiffness);
        b = bench_create(1, &g);
        check_load(what, &b, euler_in_plate(bending, length - thickness, thickness, g.stiffness));
    }
}

/* ---- the edge of a hole ---------------------------------------------------------------------------------------------------- */

/* In the air, the base moves sideways, and the needle bends at the edge of the hole: a cantilever in series with the edge. */
static void sideways_force_is_the_cantilevers(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    pose start = lockstep_start();
    start.position.z -= 0.02; /* the tip stays in the air */
    double d = c.needle.outer_diameter, clearance = 0.1e-3, arc = 0.12;
    double bending = c.needle.youngs_modulus * M_PI / 64.0 * (pow(d, 4) - pow(c.needle.inner_diameter, 4));
    c.guide_count = 1;
    c.guides[0] = hole_before_tip(start, c.needle.length, c.needle.length - arc, 0.0, d + 2.0 * clearance);
    lockstep *l = lockstep_create(&c, start);
    double expected_stiffness = 1.0 / (arc * arc * arc / (3.0 * bending) + 1.0 / c.guides[0].stiffness), step = 2e-6, worst = 0.0, jump = 0.0, last = 0.0;
    for (int i = 0; i <= 1600; i++) { /* out to one side, back, and to the other side */
        double aside = step * (i <= 400 ? i : i <= 1200 ? 800 - i : i - 1600), turned = 0.6;
        pose base = start;
        base.position = v3_add(base.position, v3(aside * cos(turned), aside * sin(turned), 0.0));
        lockstep_tick(l, base, 1e-3);
        double force = -(l->wrench.force.x * cos(turned) + l->wrench.force.y * sin(turned)), beyond = fmax(fabs(aside) - clearance, 0.0);
        worst = fmax(worst, fabs(force - copysign(expected_stiffness * beyond, aside)));
        jump = fmax(jump, fabs(force - last));
        last = force;
        if (beyond == 0.0) assert_true(v3_norm(l->wrench.force) < 1e-9);
    }
    print_message("aside: %.1f N/m; off by at most %.1e N of %.3f N, largest step %.2f of stiffness times displacement\n", expected_stiffness, worst,
                  expected_stiffness * (400 * step - clearance), jump / (expected_stiffness * step));
    assert_true(worst < 0.01 * expected_stiffness * (400 * step - clearance));
    assert_true(jump < 1.5 * expected_stiffness * step);
    lockstep_free(l);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(buckling_loads_are_eulers),
        cmocka_unit_test(sideways_force_is_the_cantilevers),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

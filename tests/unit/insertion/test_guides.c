/* Tests guides: buckling loads are compared with Euler's, and forces at the edge of a hole with beam theory. Also covers friction, the choice of the hole,
   and several needles. */
#include "insertion/guide/guides.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <time.h>
#include <cmocka.h>

#include "shared/allocator_calls.h"
#include "insertion/contact/contact_assembly.h"
#include "lockstep.h"

/* Returns the figure-8 scene with a perfectly straight needle, as beam theory assumes. */
static simulation_config straight_config(void) {
    simulation_config c = lockstep_config();
    c.needle.bow = 0.0;
    return c;
}

/* ---- stability of a needle with its base clamped -------------------------------------------------------------------------- */

/* Returns a single hole on the axis of figure 8's needle, `before` (m) from the tip. The needle fits it without clearance. */
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
    tick_input tick;
} bench;

static bench bench_create(int guide_count, const guide_config *guides) {
    simulation_config c = straight_config();
    c.needle.segments = 64;
    c.guide_count = guide_count;
    for (int i = 0; i < guide_count; i++) c.guides[i] = guides[i];
    lockstep *l = lockstep_create(&c, lockstep_start());
    bench b = {l, {.model = &l->parts.insertion, .snapshot = l->snapshot, .base = {l->base, 0.0}, .dt = 1e-3}};
    guides_follow(&b.tick, &l->state, &l->wrench);
    return b;
}

/* Returns whether the straight needle in its guides is stable under a dead load on its tip, by the simulation's own criterion. */
static bool is_stable(const bench *b, double load) {
    const tick_input *tick = &b->tick;
    insertion_state *state = &b->l->state;
    insertion_workspace *w = b->l->run.workspace;
    vec3 joint_loads[NEEDLE_MAX_SEGMENTS + 1] = {{0, 0, 0}};
    int n = tick->model->needle->given.segments;
    joint_loads[n] = v3(0, 0, -load);
    w->points.tip = false;
    points_list(tick, state, &w->points);
    points_locate(tick, state, &w->points, &w->tissue, &w->creep, w->edges);
    w->problem.count = w->problem.axial_count = w->points.count;
    needle_linearise(tick->model->needle, &state->needle, joint_loads, 0, &w->response.tangent);
    bound_contacts(tick, state, &w->points, &w->tissue, &w->ahead, w->edges, &w->problem);
    assemble_compliance(tick, state, w);
    assemble_gaps(tick, state, w);
    assert_int_equal(contact_solve(&w->problem), TROCAR_OK);
    return w->problem.negative >= w->response.tangent.unstable;
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

/* Computes a beam's stiffness to deflection and rotation of its ends under the axial load `load`, using stability functions (Timoshenko and Gere, Theory of
   Elastic Stability). */
static void beam_column(double bending, double length, double load, double k[4][4]) {
    double u = length * sqrt(load / bending), d = 2.0 - 2.0 * cos(u) - u * sin(u);
    double a = bending / pow(length, 3) * u * u * u * sin(u) / d, b = bending / pow(length, 2) * u * u * (1.0 - cos(u)) / d;
    double near = bending / length * u * (sin(u) - u * cos(u)) / d, far = bending / length * u * (u - sin(u)) / d;
    const double rows[4][4] = {{a, b, -a, b}, {b, near, -b, far}, {-a, -b, a, -b}, {b, far, -b, near}};
    memcpy(k, rows, sizeof rows);
}

/* Returns whether a beam is stable under an axial load. It is clamped at one end and rests on springs at `span` and at its other end, `thickness` further
   on. */
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
    double thin = 4e-3; /* m; almost a clamp: bending inside the plate adds a third of its thickness to the free length */
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

/* The base of a needle in the air is moved sideways. The needle bends at the edge of the hole, like a cantilever in series with the edge's compliance. */
static void sideways_force_is_the_cantilevers(void **unused) {
    (void)unused;
    simulation_config c = straight_config();
    pose start = lockstep_start();
    start.position.z -= 0.02; /* the tip stays in the air */
    double d = c.needle.outer_diameter, clearance = 0.1e-3, arc = 0.12;
    double bending = c.needle.youngs_modulus * M_PI / 64.0 * (pow(d, 4) - pow(c.needle.inner_diameter, 4));
    c.guide_count = 1;
    c.guides[0] = hole_before_tip(start, c.needle.length, c.needle.length - arc, 0.0, d + 2.0 * clearance);
    lockstep *l = lockstep_create(&c, start);
    double expected_stiffness = 1.0 / (arc * arc * arc / (3.0 * bending) + 1.0 / c.guides[0].stiffness), step = 2e-6, worst = 0.0, jump = 0.0, last = 0.0;
    for (int i = 0; i <= 1600; i++) { /* moves the base to one side, back, to the other side, and back again */
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

/* A hole without clearance always touches the needle. When it exerts no force, the passes must not try to push the residual below rounding error. */
static void a_tight_hole_without_force_takes_one_pass(void **unused) {
    (void)unused;
    simulation_config c = straight_config();
    pose start = lockstep_start();
    start.position.z -= 0.04; /* the tip stays in the air */
    c.guide_count = 1;
    c.guides[0] = hole_before_tip(start, c.needle.length, 0.05, 0.0, c.needle.outer_diameter);
    lockstep *l = lockstep_create(&c, start);
    int most = 0;
    for (int i = 1; i <= 500; i++) {
        pose base = start;
        base.position.z += 2e-5 * i;
        lockstep_tick(l, base, 1e-3);
        if (l->wrench.passes > most) most = l->wrench.passes;
        assert_true(v3_norm(l->wrench.force) < 1e-9);
    }
    assert_true(l->state.guides[0].faces[0].touching);
    assert_int_equal(most, 1);
    lockstep_free(l);
}

/* ---- friction -------------------------------------------------------------------------------------------------------------- */

/* A needle whose tip is still in the air is pressed against one side of the hole and moved along it. Once the edge has yielded by friction divided by
   stiffness, the friction is the coefficient times the normal force and opposes the motion. */
static void friction_follows_the_normal_force(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    pose start = lockstep_start();
    start.position.z -= 0.03;
    c.guide_count = 1;
    c.guides[0] = hole_before_tip(start, c.needle.length, 0.1, 0.0, c.needle.outer_diameter + 0.2e-3);
    c.guides[0].friction = 0.2;
    lockstep *l = lockstep_create(&c, start);
    lockstep_move(l, v3(4e-3, 0, 0), 0.2, 1e-3);
    const double ways[] = {0.004, -0.006, 0.006};
    for (int i = 0; i < 3; i++) {
        double sign = copysign(1.0, ways[i]), last = l->wrench.force.z;
        int ticks = 300, settled = 0;
        for (int k = 0; k < ticks; k++) {
            lockstep_move(l, v3(0, 0, ways[i] / ticks), 1e-3, 1e-3);
            /* friction acts along the needle, which is tilted by a few degrees here */
            const guide_contact *face = &l->state.guides[0].faces[0];
            needle_point at = needle_at(&l->parts.needle, &l->state.needle, face->arc);
            double along = v3_dot(face->force, needle_along(&at)), across = v3_norm(v3_axpy(-along, needle_along(&at), face->force));
            assert_true(fabs(along) <= 0.2 * across * 1.01 + 1e-9);
            if (fabs(along / (0.2 * across) - sign) < 0.01) settled++;
            assert_true(fabs(l->wrench.force.z - last) < 1.5 * c.guides[0].stiffness * fabs(ways[i]) / ticks);
            last = l->wrench.force.z;
        }
        print_message("%+.0f mm: friction at its limit in %d of %d ticks\n", 1e3 * ways[i], settled, ticks);
        assert_true(settled > ticks - 20 && l->wrench.force.z * sign < 0.0);
    }
    lockstep_free(l);
}

/* ---- which hole ------------------------------------------------------------------------------------------------------------- */

/* Returns a template with 5 x 3 holes, 5 mm apart, whose back face is 5 mm in front of the skin. The middle hole lies on the axis of lockstep_start's pose. */
static guide_config template_over_skin(const simulation_config *c) {
    guide_config g = guide_defaults();
    pose start = lockstep_start();
    snprintf(g.name, sizeof g.name, "template");
    g.origin = v3(start.position.x, start.position.y, -0.025);
    g.normal = v3(0, 0, 2);
    g.along = v3(3, 0, 1);
    g.columns = 5;
    g.rows = 3;
    g.hole_diameter = c->needle.outer_diameter + 0.2e-3;
    return g;
}

static guide_state passage_at(vec3 aside, unsigned *events, guide_state *withdrawn) {
    simulation_config c = lockstep_config();
    c.guide_count = 1;
    c.guides[0] = template_over_skin(&c);
    pose start = lockstep_start();
    start.position = v3_add(start.position, v3_add(aside, v3(0, 0, -0.026)));
    lockstep *l = lockstep_create(&c, start);
    lockstep_move(l, v3(0, 0, 0.022), 0.1, 1e-3);
    guide_state reached = l->state.guides[0];
    *events = l->wrench.events;
    lockstep_move(l, v3(0, 0, -0.03), 0.1, 1e-3);
    *withdrawn = l->state.guides[0];
    assert_false(l->wrench.events & EVENT_MISSED_GUIDE);
    assert_true(v3_norm(l->wrench.force) == 0.0);
    lockstep_free(l);
    return reached;
}

static void the_tip_chooses_the_hole(void **unused) {
    (void)unused;
    static const struct { double x, y; guide_passage passage; int hole; } cases[] = {
        {0, 0, GUIDE_IN_HOLE, 7}, {5e-3, 0, GUIDE_IN_HOLE, 8}, {-10e-3, -5e-3, GUIDE_IN_HOLE, 0}, {10.5e-3, 5.2e-3, GUIDE_IN_HOLE, 14},
        {2.5e-3, 0, GUIDE_MISSED, 0}, {0, 1.2e-3, GUIDE_MISSED, 0}, {13e-3, 8e-3, GUIDE_MISSED, 0}, {16e-3, 0, GUIDE_BESIDE, 0}, {0, -11e-3, GUIDE_BESIDE, 0},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        unsigned events;
        guide_state withdrawn, s = passage_at(v3(cases[i].x, cases[i].y, 0), &events, &withdrawn);
        assert_int_equal(s.passage, cases[i].passage);
        if (s.passage == GUIDE_IN_HOLE) assert_int_equal(s.hole, cases[i].hole);
        assert_int_equal((events & EVENT_MISSED_GUIDE) != 0, cases[i].passage == GUIDE_MISSED);
        assert_int_equal(withdrawn.passage, GUIDE_AHEAD);
    }
}

/* If the hand moves in a way that the hole makes impossible, the result stays finite and the needle is released from the hole. */
static void a_needle_turned_across_is_let_go(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    c.guide_count = 1;
    c.guides[0] = template_over_skin(&c);
    pose start = lockstep_start();
    start.position.z -= 0.01;
    lockstep *l = lockstep_create(&c, start);
    lockstep_tick(l, start, 1e-3);
    assert_true(l->state.guides[0].passage == GUIDE_IN_HOLE);
    bool told = false;
    for (int i = 1; i <= 2000; i++) {
        pose base = {start.position, q_exp(v3(1e-3 * i, 0, 0))};
        lockstep_tick(l, base, 1e-3);
        assert_true(insertion_is_finite(&l->state, &l->wrench));
        told |= (l->wrench.events & EVENT_MISSED_GUIDE) != 0;
    }
    assert_true(told || l->state.guides[0].passage == GUIDE_AHEAD);
    assert_true(v3_norm(l->wrench.force) == 0.0);
    lockstep_free(l);
}

/* A needle that already passes through the plate when it is reset is in its hole from the first tick on. */
static void a_needle_can_start_in_its_hole(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    c.guide_count = 1;
    c.guides[0] = template_over_skin(&c);
    pose start = lockstep_start();
    start.position.x += 5e-3;
    lockstep *l = lockstep_create(&c, start);
    lockstep_tick(l, start, 1e-3);
    assert_true(l->state.guides[0].passage == GUIDE_IN_HOLE && l->state.guides[0].hole == 8);
    assert_true(v3_norm(l->wrench.force) < 1e-9);
    lockstep_free(l);
}

/* ---- insertions -------------------------------------------------------------------------------------------------------------- */

/* Returns the pose of a hand that moves the needle in and out and, once it is in its hole, also moves it sideways and tilts it. `t` runs from 0 to 1. */
static pose trembling(double t, unsigned seed, double before, double deep) {
    double phase = 0.7 * seed, in = deep * 0.5 * (1.0 - cos(2.0 * M_PI * t)), grown = fmin(10.0 * t, 1.0);
    vec3 tilt = v3(0.008 * grown * sin(31.0 * t + phase), 0.008 * grown * sin(23.0 * t + 2.0 * phase), 0.0);
    vec3 aside = v3(3e-3 * grown * sin(41.0 * t + phase), 3e-3 * grown * sin(29.0 * t + 3.0 * phase), in - before);
    pose start = lockstep_start();
    return (pose){v3_add(start.position, aside), q_unit(q_multiply(q_exp(tilt), start.orientation))};
}

typedef struct { double peak, step, across; int passes, worst, touching; } trembling_result;

/* Returns the largest force, the largest change in force per tick, and the largest change per tick in the component across the axis. */
static trembling_result tremble(lockstep *l, unsigned seed, double before, double deep, int ticks, double dt) {
    trembling_result r = {0};
    pose start = trembling(0.0, seed, before, deep);
    insertion_reset(&l->parts.insertion, start, &l->state);
    vec3 last = v3(0, 0, 0);
    for (int i = 1; i < ticks; i++) {
        lockstep_tick(l, trembling((double)i / ticks, seed, before, deep), dt);
        assert_false(l->wrench.events & (EVENT_UNSTABLE | EVENT_MISSED_GUIDE));
        vec3 change = v3_sub(l->wrench.force, last);
        r.step = fmax(r.step, v3_norm(change));
        r.across = fmax(r.across, hypot(change.x, change.y));
        last = l->wrench.force;
        r.peak = fmax(r.peak, v3_norm(last));
        r.passes += l->wrench.passes;
        r.worst = l->wrench.passes > r.worst ? l->wrench.passes : r.worst;
        r.touching += l->state.guides[0].faces[0].touching + l->state.guides[0].faces[1].touching;
    }
    return r;
}

/* The needle is in the air, without friction. With eight times as many ticks, the changes per tick shrink to an eighth; a jump would not shrink. */
static void forces_are_continuous_at_the_clearance(void **unused) {
    (void)unused;
    enum { TICKS = 1000, FINER = 8 };
    simulation_config c = lockstep_config();
    c.guide_count = 1;
    c.guides[0] = template_over_skin(&c);
    c.guides[0].friction = 0.0;
    lockstep *l = lockstep_create(&c, lockstep_start());
    for (unsigned seed = 0; seed < 10; seed++) {
        trembling_result coarse = tremble(l, seed, 0.003, 0.0, TICKS, 1e-3), fine = tremble(l, seed, 0.003, 0.0, FINER * TICKS, 1e-3 / FINER);
        print_message("up to %.3f N, steps of %.4f and %.4f N, %.2f passes a tick, at most %d, faces touched %.2f\n", coarse.peak, coarse.step, fine.step,
                      coarse.passes / (double)TICKS, coarse.worst, coarse.touching / (double)TICKS);
        assert_true(coarse.peak > 0.03 && coarse.touching > 0 && coarse.touching < 2 * TICKS);
        assert_true(fine.step < 1.25 * coarse.step / FINER + 2e-3);
    }
    lockstep_free(l);
}

/* Along the axis, the force may change per tick about as much as without the guide, mostly at punctures. Across the axis, it must not jump. */
static void random_insertions_stay_stable(void **unused) {
    (void)unused;
    enum { TICKS = 2000 };
    simulation_config c = lockstep_config();
    c.guide_count = 1;
    c.guides[0] = template_over_skin(&c);
    lockstep *l = lockstep_create(&c, lockstep_start());
    for (unsigned seed = 0; seed < 10; seed++) {
        l->parts.insertion.guide_count = 0;
        trembling_result free = tremble(l, seed, 0.0, 0.07, TICKS, 1e-3);
        l->parts.insertion.guide_count = 1;
        trembling_result r = tremble(l, seed, 0.0, 0.07, TICKS, 1e-3);
        print_message("up to %.2f N, steps of %.3f N, %.3f N across, %.2f passes a tick; without guide %.2f N, %.3f N, %.3f N, %.2f\n", r.peak, r.step, r.across,
                      r.passes / (double)TICKS, free.peak, free.step, free.across, free.passes / (double)TICKS);
        assert_true(r.touching > 0 && r.peak < 2.0 * free.peak && r.step < 1.5 * free.step && r.across < 0.05);
    }
    lockstep_free(l);
}

/* Moves two needles in and out through a template. One predicts its shape; the other starts each tick from its last shape. Returns the largest difference
   between their forces (N); `peak` receives the largest force. */
static double felt_of_a_guess(double friction, double *peak) {
    simulation_config c = lockstep_config();
    c.guide_count = 1;
    c.guides[0] = template_over_skin(&c);
    c.guides[0].friction = friction;
    lockstep *guesses = lockstep_create(&c, lockstep_start()), *does_not = lockstep_create(&c, lockstep_start());
    double worst = 0.0;
    for (int i = 0; i < 1500; i++) {
        pose base = lockstep_start();
        double phase = 2e-3 * M_PI * i, depth = 0.04 * sin(0.5 * M_PI * i / 750.0);
        base.position = v3_add(base.position, v3(1.5e-3 * sin(3.0 * phase), 1e-3 * sin(5.0 * phase), depth));
        lockstep_tick(guesses, base, 1e-3);
        does_not->state.motion.time = 0.0;
        lockstep_tick(does_not, base, 1e-3);
        worst = fmax(worst, v3_norm(v3_sub(guesses->wrench.force, does_not->wrench.force)));
        *peak = fmax(*peak, v3_norm(guesses->wrench.force));
    }
    lockstep_free(guesses);
    lockstep_free(does_not);
    return worst;
}

/* Whatever shape the passes start from, the results agree to within the tolerance for edge and friction, 1 % of the force, both at the usual friction and at
   a high one. */
static void a_guess_stays_within_the_tolerance_of_a_guide(void **unused) {
    (void)unused;
    const double friction[] = {0.1, 0.6};
    for (int i = 0; i < 2; i++) {
        double peak = 0.0, worst = felt_of_a_guess(friction[i], &peak);
        print_message("friction %.1f: a guess changes the force by up to %.2e of the peak of %.2f N\n", friction[i], worst / peak, peak);
        assert_true(worst < 0.01 * peak);
    }
}

/* ---- tissue that relaxes, and a needle that turns ------------------------------------------------------------------------------ */

static const relaxation_term SERIES[] = {{0.25, 0.15}, {0.15, 2.5}, {0.10, 30.0}};

/* Returns a scene in which the shaft fits its hole without clearance and touches it at both faces of the plate. */
static simulation_config snug_scene(bool relaxing) {
    simulation_config c = straight_config();
    c.guide_count = 1;
    c.guides[0] = template_over_skin(&c);
    c.guides[0].hole_diameter = c.needle.outer_diameter;
    c.relaxation_count = relaxing ? 3 : 0;
    memcpy(c.relaxation, SERIES, sizeof SERIES);
    return c;
}

static lockstep *engaged(const simulation_config *config) {
    lockstep *l = lockstep_engaged(config);
    assert_true(contacts_active(&l->state) > 5 && l->state.guides[0].passage == GUIDE_IN_HOLE);
    return l;
}

static vec3 force_on_guide(const lockstep *l) { return v3_add(l->state.guides[0].faces[0].force, l->state.guides[0].faces[1].force); }
static vec3 force_on_tissue(const lockstep *l) { return v3_scale(-1.0, v3_add(l->wrench.force, force_on_guide(l))); }

/* A rigid needle that sticks: a step of its base deforms the tissue and the plate by the same step. Only the tissue relaxes. */
static void check_held_step(vec3 way, double on_guide) {
    simulation_config relaxing = snug_scene(true), elastic = snug_scene(false);
    simulation_config *both[] = {&relaxing, &elastic};
    for (int k = 0; k < 2; k++) {
        both[k]->needle.youngs_modulus = 2e18;
        for (int i = 0; i < both[k]->region_count; i++) {
            region_material *m = &both[k]->regions[i].material;
            m->cutting_force = m->friction_static = m->friction_kinetic = 1e4;
        }
    }
    lockstep *l = engaged(&relaxing), *plain = engaged(&elastic);
    l->base.position = plain->base.position = v3_add(l->base.position, way);
    lockstep_tick(plain, plain->base, 1e-3);
    double at_once = v3_norm(force_on_tissue(plain)), worst = 0.0, moved = 0.0;
    vec3 guided = force_on_guide(plain);
    assert_true(at_once > 0.05);
    assert_true(fabs(v3_norm(guided) - on_guide) < 1e-3 * on_guide + 1e-4);
    for (int i = 1; i <= 5000; i++) {
        lockstep_tick(l, l->base, 1e-3);
        worst = fmax(worst, fabs(v3_norm(force_on_tissue(l)) / at_once - relaxation_at(3, SERIES, i * 1e-3)));
        moved = fmax(moved, v3_norm(v3_sub(force_on_guide(l), guided)));
    }
    print_message("held step: %.3f N on the tissue %.2g off, %.3f N on the guide changes by %.2g N\n", at_once, worst, v3_norm(guided), moved);
    assert_true(worst < 1e-3 && moved < 1e-3);
    assert_int_equal(l->state.memory.count, contacts_active(&l->state) + 1);
    lockstep_free(plain);
    lockstep_free(l);
}

static void a_held_step_relaxes_in_a_guide(void **unused) {
    (void)unused;
    double edges = 2.0 * guide_defaults().stiffness;
    check_held_step(v3(2e-4, 1e-4, 0), edges * hypot(2e-4, 1e-4));
    check_held_step(v3(0, 0, 2e-4), 0.0);
}

static void turn(lockstep *l, double angle, double seconds) {
    int n = (int)(seconds * 1e3 + 0.5);
    pose from = l->base;
    for (int i = 1; i <= n; i++) lockstep_tick(l, (pose){from.position, q_unit(q_multiply(from.orientation, q_exp(v3(0, 0, angle * i / n))))}, 1e-3);
}

/* Only friction in the tissue resists turning, so torque and lag equal those in test_roll.c. A needle turned in the air is not twisted. */
static void a_needle_turns_in_its_hole(void **unused) {
    (void)unused;
    const double dry = 20.0;
    for (int relaxing = 0; relaxing < 2; relaxing++) {
        simulation_config c = snug_scene(relaxing);
        for (int i = 0; i < c.region_count; i++) {
            region_material *m = &c.regions[i].material;
            m->friction_static = m->friction_kinetic = dry;
            m->friction_viscous = 0.0;
        }
        lockstep *l = engaged(&c);
        const needle_model *needle = &l->parts.needle;
        turn(l, 2.0, 2.0);
        double f = dry * needle->radius, depth = l->state.tip.place.depth, lag = f * depth * (needle->given.length - 0.5 * depth) / needle->torsion;
        print_message("lag %.6f, expected %.6f; torque %.6f of %.6f\n", -l->state.tip_lead, lag, -l->wrench.torque.z, f * depth);
        assert_true(fabs(-l->state.tip_lead / lag - 1.0) < 0.01 && fabs(-l->wrench.torque.z / (f * depth) - 1.0) < 0.01);
        lockstep_move(l, v3(0, 0, -0.065), 0.5, 1e-3); /* out of the skin, but not out of the hole */
        assert_true(l->state.tip.place.phase == TIP_FREE && l->state.guides[0].passage == GUIDE_IN_HOLE);
        assert_true(l->state.tip_lead == 0.0 && l->state.memory.count == 0 && (l->state.memory.residual.count > 0) == (relaxing == 1));
        turn(l, 20.0, 0.5);
        assert_true(fabs(l->state.base_turn - 22.0) < 1e-9 && fabs(l->wrench.torque.z) < 1e-12);
        lockstep_move(l, v3(0, 0, 0.02), 0.5, 1e-3);
        assert_true(l->state.tip.place.phase == TIP_INSIDE && fabs(l->state.tip_lead) < 1e-9 && fabs(l->wrench.torque.z) < 1e-9);
        lockstep_free(l);
    }
}

/* ---- saved, several, cost ------------------------------------------------------------------------------------------------------ */

static void a_restored_insertion_goes_on_to_the_bit(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    c.guide_count = 1;
    c.guides[0] = template_over_skin(&c);
    lockstep *l = lockstep_create(&c, lockstep_start()), *other = lockstep_create(&c, lockstep_start());
    checkpoint *saved = malloc(sizeof *saved);
    for (int i = 0; i < 500; i++) lockstep_tick(l, trembling(i / 1500.0, 3, 0.0, 0.05), 1e-3);
    assert_true(l->state.guides[0].faces[0].touching || l->state.guides[0].faces[1].touching);
    run_save(&l->state, l->snapshot, saved);
    trocar_error why;
    assert_int_equal(run_restore(&other->run, saved, &other->state, other->snapshot, &why), TROCAR_OK);
    for (int i = 500; i < 1500; i++) {
        lockstep_tick(l, trembling(i / 1500.0, 3, 0.0, 0.05), 1e-3);
        lockstep_tick(other, trembling(i / 1500.0, 3, 0.0, 0.05), 1e-3);
        assert_memory_equal(&l->wrench.force, &other->wrench.force, sizeof l->wrench.force);
        assert_memory_equal(&l->wrench.torque, &other->wrench.torque, sizeof l->wrench.torque);
        assert_memory_equal(l->state.guides, other->state.guides, sizeof l->state.guides);
    }
    free(saved);
    lockstep_free(l);
    lockstep_free(other);
}

/* Returns the needle's largest distance (m) from the straight line between its base and its end. */
static double bow(const lockstep *l) {
    const vec3 *joints = l->state.needle.joints;
    int n = l->parts.needle.given.segments;
    vec3 line = v3_unit(v3_sub(joints[n], joints[0]));
    double most = 0.0;
    for (int i = 1; i < n; i++) {
        vec3 off = v3_sub(joints[i], joints[0]);
        most = fmax(most, v3_norm(v3_axpy(-v3_dot(off, line), line, off)));
    }
    return most;
}

/* The needle is pushed through a template against stiff skin that is never punctured. Two springs at the plate's faces support the end of the span between
   hand and plate. Beyond Euler's load for this span, the needle buckles and keeps carrying that load; by the elastica, the load is 1 % higher once the bow
   is a tenth of the span. Without a template, the needle buckles at 10 N. */
static void a_template_lets_the_needle_bear_more(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    for (int i = 0; i < c.region_count; i++) c.regions[i].material.youngs_modulus = 2e6;
    for (int i = 0; i < c.membrane_count; i++) c.membranes[i].puncture_force = INFINITY;
    c.guides[0] = template_over_skin(&c);
    c.guides[0].hole_diameter = c.needle.outer_diameter + 0.04e-3;
    double d = c.needle.outer_diameter, bending = c.needle.youngs_modulus * M_PI / 64.0 * (pow(d, 4) - pow(c.needle.inner_diameter, 4));
    for (int guides = 0; guides < 2; guides++) {
        c.guide_count = guides;
        lockstep *l = lockstep_create(&c, lockstep_start());
        lockstep_move(l, v3(0, 0, 1e-3), 0.1, 1e-3);
        lockstep_move(l, v3(1e-3, 0, 0), 0.1, 1e-3);
        double borne = 0.0, span = c.needle.length;
        for (int i = 0; i < 4000 && bow(l) < 0.1 * span; i++) {
            lockstep_move(l, v3(0, 0, 1e-5), 1e-3, 1e-3);
            assert_false(l->wrench.events & EVENT_UNSTABLE);
            borne = -l->wrench.force.z;
            if (guides) span = l->state.guides[0].faces[0].arc;
        }
        double expected = guides ? euler_in_plate(bending, span, c.guides[0].thickness, c.guides[0].stiffness) : 2.0457 * M_PI * M_PI * bending / 0.04;
        print_message("%s: bowed by %.1f mm it bears %.2f N, Euler %.2f N\n", guides ? "through the template" : "free", 1e3 * bow(l), borne, expected);
        assert_true(bow(l) >= 0.1 * span && fabs(borne / expected - 1.0) < 0.02);
        lockstep_free(l);
    }
}

/* A nearly straight needle is pushed exactly along its axis onto skin as hard as bone, at 5 and at 50 mm/s. It reaches the buckled shape and then carries
   Euler's load. */
static void a_needle_pushed_along_its_axis_bows(void **unused) {
    (void)unused;
    const double steps[] = {5e-6, 5e-5};
    for (int k = 0; k < 2; k++) {
        simulation_config c = lockstep_config();
        for (int i = 0; i < c.region_count; i++) c.regions[i].material.youngs_modulus = 1e9;
        for (int i = 0; i < c.membrane_count; i++) c.membranes[i].puncture_force = INFINITY;
        double d = c.needle.outer_diameter, bending = c.needle.youngs_modulus * M_PI / 64.0 * (pow(d, 4) - pow(c.needle.inner_diameter, 4));
        double euler = 2.0457 * M_PI * M_PI * bending / pow(c.needle.length, 2), most = 0.0;
        lockstep *l = lockstep_create(&c, lockstep_start());
        for (int i = 0; i < (int)(9e-3 / steps[k]); i++) {
            lockstep_move(l, v3(0, 0, steps[k]), 1e-3, 1e-3);
            assert_false(l->wrench.events & EVENT_UNSTABLE);
            most = fmax(most, -l->wrench.force.z);
        }
        double borne = -l->wrench.force.z;
        print_message("%.0f mm/s along the axis: bowed by %.1f mm it bears %.2f N, at most %.2f N, Euler %.2f N\n", 1e6 * steps[k], 1e3 * bow(l), borne, most, euler);
        assert_true(bow(l) > 0.1 * c.needle.length && fabs(borne / euler - 1.0) < 0.02 && most < 1.02 * euler);
        lockstep_free(l);
    }
}

/* Cost of one tick without the worker's part: time in ns and number of allocations. */
typedef struct { int64_t time, allocations; } tick_effort;

static int64_t now_ns(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1000000000 * (int64_t)t.tv_sec + t.tv_nsec;
}

static tick_effort tick_alone(lockstep *l, pose base) {
    trocar_error why;
    tick_input tick = {.model = &l->parts.insertion, .snapshot = l->snapshot, .base = {base, 0.0}, .dt = 1e-3};
    int64_t allocations = allocator_calls(), start = now_ns();
    insertion_tick(&tick, &l->state, l->run.workspace, &l->wrench);
    tick_effort effort = {now_ns() - start, allocator_calls() - allocations};
    l->base = base;
    if (l->snapshot->serial != l->state.request.serial) assert_int_equal(remesher_answer(l->run.remesher, &l->state.request, l->snapshot, &why), TROCAR_OK);
    return effort;
}

static void ticks_do_not_allocate(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    c.guide_count = 1;
    c.guides[0] = template_over_skin(&c);
    lockstep *l = lockstep_create(&c, lockstep_start());
    int64_t allocations = 0;
    int most = 0;
    for (int i = 0; i < 1000; i++) {
        allocations += tick_alone(l, trembling(i / 1000.0, 4, 0.0, 0.05)).allocations;
        most = l->wrench.contacts > most ? l->wrench.contacts : most;
    }
    assert_true(most > 5);
    assert_true(l->state.guides[0].passage == GUIDE_IN_HOLE);
    assert_int_equal(allocations, 0);
    lockstep_free(l);
}

static int compare(const void *a, const void *b) {
    int64_t x = *(const int64_t *)a, y = *(const int64_t *)b;
    return (x > y) - (x < y);
}

/* Times the alternating ticks of three needles: one without a guide, one that always touches one face of a guide, and one with more contacts in the tissue.
   Ticking a needle that is held still takes one pass. */
static void a_face_costs_what_a_contact_costs(void **unused) {
    (void)unused;
    enum { TICKS = 4001 };
    static int64_t times[3][TICKS];
    lockstep *l[3];
    for (int i = 0; i < 3; i++) {
        simulation_config c = lockstep_config();
        if (i == 1) c.guide_count = 1, c.guides[0] = hole_before_tip(lockstep_start(), c.needle.length, 0.0145, 0.0, c.needle.outer_diameter);
        l[i] = lockstep_create(&c, lockstep_start());
        lockstep_move(l[i], v3(0, 0, 0.05), 0.5, 1e-3);
        lockstep_move(l[i], v3(0, 1e-3, 0), 0.1, 1e-3);
        for (int extra = 0; i == 2 && l[2]->wrench.contacts == l[0]->wrench.contacts && extra < 300; extra++) lockstep_move(l[i], v3(0, 0, 1e-4), 1e-3, 1e-3);
    }
    for (int t = 0; t < TICKS; t++)
        for (int i = 0; i < 3; i++) times[i][t] = tick_alone(l[i], l[i]->base).time;
    double median[3];
    for (int i = 0; i < 3; i++) {
        qsort(times[i], TICKS, sizeof *times[i], compare);
        median[i] = 1e-3 * (double)times[i][TICKS / 2];
    }
    print_message("tick: %.2f us with %d contacts, %.2f us with a guide as well, %.2f us with %d contacts and no guide\n", median[0], l[0]->wrench.contacts, median[1],
                  median[2], l[2]->wrench.contacts);
    assert_true(l[1]->state.guides[0].faces[0].touching && l[1]->wrench.passes == l[0]->wrench.passes);
    assert_int_equal(l[1]->wrench.contacts, l[0]->wrench.contacts);
    assert_true(median[1] < 1.15 * median[2]);
    for (int i = 0; i < 3; i++) lockstep_free(l[i]);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(buckling_loads_are_eulers),
        cmocka_unit_test(sideways_force_is_the_cantilevers),
        cmocka_unit_test(a_tight_hole_without_force_takes_one_pass),
        cmocka_unit_test(friction_follows_the_normal_force),
        cmocka_unit_test(the_tip_chooses_the_hole),
        cmocka_unit_test(a_needle_can_start_in_its_hole),
        cmocka_unit_test(a_needle_turned_across_is_let_go),
        cmocka_unit_test(forces_are_continuous_at_the_clearance),
        cmocka_unit_test(random_insertions_stay_stable),
        cmocka_unit_test(a_guess_stays_within_the_tolerance_of_a_guide),
        cmocka_unit_test(a_held_step_relaxes_in_a_guide),
        cmocka_unit_test(a_needle_turns_in_its_hole),
        cmocka_unit_test(a_restored_insertion_goes_on_to_the_bit),
        cmocka_unit_test(a_template_lets_the_needle_bear_more),
        cmocka_unit_test(a_needle_pushed_along_its_axis_bows),
        cmocka_unit_test(ticks_do_not_allocate),
        cmocka_unit_test(a_face_costs_what_a_contact_costs),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

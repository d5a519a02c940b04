/* Compares the rod with beam theory: small deflections, the elastica under a force and a moment at the tip, bending in space, torsion, and roll of the base.
   Also measures convergence with the number of segments, and the time one linearisation takes. */
#include <time.h>

#include "bench/baseline.h"
#include "kirchhoff.h"
#include "lockstep.h"
#include "rows.h"

enum { TIP_FORCE, TIP_MOMENT, IN_SPACE, CASES };
static const char *case_names[CASES] = {"tip force", "tip moment", "forces in two planes"};
static needle_tangent tangent;

static needle_model rod(int segments) {
    simulation_config config;
    needle_model model;
    trocar_error why;
    simulation_defaults(&config);
    config.needle.bow = 0.0; /* straight, like the reference solutions */
    config.needle.segments = segments;
    if (needle_create(&config.needle, &model, &why) != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        exit(2);
    }
    return model;
}

static pose at_rest(double roll) { return (pose){v3(0, 0, 0), q_exp(v3(0, 0, roll))}; }

/* Adds a couple on the last segment whose moment keeps its direction along x. */
static void add_tip_moment(const needle_model *model, const needle_state *state, double moment, vec3 *load) {
    int n = model->given.segments;
    vec3 across = v3_scale(moment / model->segment_length, v3_cross(v3(1, 0, 0), q_rotate(state->frames[n - 1], v3(0, 0, 1))));
    load[n] = across;
    load[n - 1] = v3_scale(-1.0, across);
}

/* Solves for equilibrium under dead forces at joints and a moment at the tip by Newton's method, applying the load in increments. */
static void bend(const needle_model *model, needle_state *state, const vec3 *force, double moment) {
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    for (int step = 1; step <= 20; step++)
        for (int pass = 0; pass < 100; pass++) {
            if (moment != 0.0) add_tip_moment(model, state, step / 20.0 * moment, load);
            else
                for (int j = 0; j <= model->given.segments; j++) load[j] = v3_scale(step / 20.0, force[j]);
            needle_linearise(model, state, load, 0, &tangent);
            if (needle_advance(model, &tangent, load, state) < 1e-13) break;
        }
}

static vec3 tip_of(const needle_model *model, const needle_state *state) { return state->joints[model->given.segments]; }

/* ---- small deflections ------------------------------------------------------------------------------------------------- */

static void check_small(rows *r) {
    needle_model model = rod(40);
    double length = model.given.length, force = 1e-4, moment = 1e-5;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    needle_state state;
    load[40] = v3(0, force, 0);
    needle_set_straight(&model, at_rest(0), &state);
    bend(&model, &state, load, 0.0);
    rows_compare(r, "small tip force: deflection, 40 segments", "F L^3 / (3 E I)", tip_of(&model, &state).y, force * pow(length, 3) / (3 * model.bending),
                 1e-3, "m");
    rows_compare(r, "small tip force: elastic energy", "F^2 L^3 / (6 E I)", needle_energy(&model, &state),
                 force * force * pow(length, 3) / (6 * model.bending), 1e-3, "J");
    rows_compare(r, "small tip force: moment at the base", "F L", -needle_root_moment(&model, &state).x, force * length, 1e-6, "N m");
    needle_set_straight(&model, at_rest(0), &state);
    bend(&model, &state, load, moment);
    rows_compare(r, "small tip moment: deflection, 40 segments", "M L^2 / (2 E I)", -tip_of(&model, &state).y,
                 moment * length * length / (2 * model.bending), 1e-3, "m");
}

/* ---- large deflections and their convergence ------------------------------------------------------------------------------ */

/* The loads of a case, in units of E I / L^2, are chosen so that the tip moves sideways by half the needle's length. */
static void case_forces(int which, const needle_model *model, vec3 *middle, vec3 *tip) {
    double unit = model->bending / (model->given.length * model->given.length);
    *middle = which == IN_SPACE ? v3(4.0 * unit, 0, 0) : v3(0, 0, 0);
    *tip = which == IN_SPACE ? v3(-0.5 * unit, 1.5 * unit, -0.5 * unit) : v3(0, 2.05 * unit, 0);
}

/* Angle of a circular arc whose tip is displaced sideways by half its length: (1 - cos a) / a = 1/2. */
static const double HALF_ARC = 1.1091441817;

static vec3 reference_tip(int which, const needle_model *model) {
    double length = model->given.length, radius = length / HALF_ARC;
    if (which == TIP_MOMENT) return v3(0, -radius * (1.0 - cos(HALF_ARC)), radius * sin(HALF_ARC));
    kirchhoff_rod reference = {.length = length, .bending = model->bending, .torsion = model->torsion, .count = 2,
                               .step = {KIRCHHOFF_STEPS / 2, KIRCHHOFF_STEPS}};
    case_forces(which, model, &reference.force[0], &reference.force[1]);
    vec3 moment;
    return kirchhoff_solve(&reference, &moment).position;
}

static vec3 rod_tip(int which, const needle_model *model) {
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    needle_state state;
    int n = model->given.segments;
    case_forces(which, model, &load[n / 2], &load[n]);
    needle_set_straight(model, at_rest(0), &state);
    bend(model, &state, load, which == TIP_MOMENT ? HALF_ARC * model->bending / model->given.length : 0.0);
    return tip_of(model, &state);
}

static void check_large(rows *r, int which) {
    double segments[5], error[5];
    char check[120];
    const char *against = which == TIP_MOMENT ? "circular arc" : "Kirchhoff rod by Runge-Kutta and shooting";
    for (int i = 0; i < 5; i++) {
        needle_model model = rod(4 << i);
        vec3 expected = reference_tip(which, &model), tip = rod_tip(which, &model);
        segments[i] = 4 << i;
        error[i] = v3_norm(v3_sub(tip, expected)) / model.given.length;
        if (i == 4) {
            snprintf(check, sizeof check, "%s, tip half the length aside, 64 segments", case_names[which]);
            rows_add(r, (row){.check = check, .reference = against, .value = hypot(tip.x, tip.y), .expected = hypot(expected.x, expected.y),
                              .error = error[i], .limit = 1e-3, .unit = "m", .note = "error: distance of the tips over the length"});
        }
    }
    snprintf(check, sizeof check, "%s: observed order, 4 to 64 segments", case_names[which]);
    double order = log2(error[3] / error[4]), off = 0.0;
    for (int i = 0; i < 4; i++) off = fmax(off, fabs(log2(error[i] / error[i + 1]) - 2.0));
    rows_add(r, (row){.check = check, .reference = "2", .value = order, .expected = 2.0, .error = off, .limit = 0.2,
                      .note = "absolute, the worst of four halvings"});
    needle_model standard = rod(40);
    double at_default = v3_norm(v3_sub(rod_tip(which, &standard), reference_tip(which, &standard))) / standard.given.length;
    snprintf(check, sizeof check, "%s: the default of 40 segments", case_names[which]);
    rows_error(r, check, against, at_default, 1e-3);
    rows_curve(r, (curve){.figure = "needle-convergence", .label = case_names[which], .x_label = "segments", .y_label = "error of the tip over the length",
                          .logarithmic = true, .count = 5, .x = segments, .y = error});
}

/* ---- torsion and roll ------------------------------------------------------------------------------------------------------ */

/* Compares energy and moment under a prescribed uniform twist. A round rod bent in space has no twisting moment, because m.t is constant along it and zero
   at the tip. */
static void check_torsion(rows *r) {
    needle_model model = rod(40);
    const needle_parameters *g = &model.given;
    double rigidity = g->youngs_modulus / (2.0 * (1.0 + g->poisson_ratio)) * M_PI / 32.0 * (pow(g->outer_diameter, 4) - pow(g->inner_diameter, 4));
    double rate = 0.5 / g->length; /* rad/m, twist rate from the clamp to the middle of the last segment */
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    needle_state state;
    needle_set_straight(&model, at_rest(0), &state);
    for (int k = 0; k < 40; k++) state.frames[k] = q_exp(v3(0, 0, rate * (k + 0.5) * model.segment_length));
    rows_compare(r, "twisted by 0.5 rad: moment at the base", "G J / L times the angle", needle_root_moment(&model, &state).z, rigidity * rate, 1e-6, "N m");
    rows_compare(r, "twisted by 0.5 rad: elastic energy", "G J / 2 times rate^2 L", needle_energy(&model, &state),
                 0.5 * rigidity * rate * rate * (g->length - 0.5 * model.segment_length), 1e-6, "J");
    case_forces(IN_SPACE, &model, &load[20], &load[40]);
    needle_set_straight(&model, at_rest(0), &state);
    bend(&model, &state, load, 0.0);
    vec3 moment = needle_root_moment(&model, &state);
    rows_error(r, "forces in two planes: twisting moment over bending moment at the base", "0, a round rod", moment.z / v3_norm(moment), 1e-9);
}

/* Roll must not change the response. Forces on a needle rolled by arbitrary angles are compared with those computed with the forces rotated along with it. */
static void check_roll(rows *r) {
    needle_model model = rod(40);
    needle_state plain, rolled;
    double worst = 0.0, worst_own = 0.0;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}}, turned[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    case_forces(IN_SPACE, &model, &load[20], &load[40]);
    needle_set_straight(&model, at_rest(0), &plain);
    bend(&model, &plain, load, 0.0);
    vec3 moment = needle_root_moment(&model, &plain);
    for (double roll = 0.3; roll < 6.3; roll += 0.7) {
        quat q = at_rest(roll).orientation;
        needle_set_straight(&model, at_rest(roll), &rolled);
        bend(&model, &rolled, load, 0.0);
        worst = fmax(worst, v3_norm(v3_sub(needle_root_moment(&model, &rolled), moment)) / v3_norm(moment));
        for (int j = 0; j <= 40; j++) turned[j] = q_rotate(q, load[j]);
        needle_set_straight(&model, at_rest(roll), &rolled);
        bend(&model, &rolled, turned, 0.0);
        vec3 own = q_rotate(q_conjugate(q), needle_root_moment(&model, &rolled));
        worst_own = fmax(worst_own, v3_norm(v3_sub(own, moment)) / v3_norm(moment));
    }
    rows_error(r, "base rolled by 9 angles, forces fixed in space: moment at the base", "no roll", worst, 1e-9);
    rows_error(r, "base and forces rolled by 9 angles: moment in the base's frame", "no roll", worst_own, 1e-9);
}

/* Computes force and torque after pushing by 60 mm and then sideways. The base is rolled by `roll` before the push and by `later` at depth. In the second
   case friction is off, because it would resist the roll. */
static void push_rolled(double roll, double later, bool friction, double wrench[6]) {
    simulation_config c = lockstep_config();
    c.needle.bow = 0.0; /* otherwise the bow would rotate with the needle */
    for (int i = 0; i < c.region_count && !friction; i++)
        c.regions[i].material.friction_static = c.regions[i].material.friction_kinetic = c.regions[i].material.friction_viscous = 0.0;
    pose start = lockstep_start();
    start.orientation = q_exp(v3(0, 0, roll));
    lockstep *l = lockstep_create(&c, start);
    lockstep_move(l, v3(0, 0, 0.06), 0.6, 1e-3);
    lockstep_move(l, v3(0.002, 0.005, 0), 0.2, 1e-3);
    for (int i = 1; i <= 200; i++) {
        pose base = l->base;
        base.orientation = q_exp(v3(0, 0, roll + later * i / 200.0));
        lockstep_tick(l, base, 1e-3);
    }
    memcpy(wrench, &l->wrench.force, sizeof(vec3));
    memcpy(wrench + 3, &l->wrench.torque, sizeof(vec3));
    lockstep_free(l);
}

static double distance(const double *a, const double *b, int from) {
    double sum = 0.0, size = 0.0;
    for (int i = from; i < from + 3; i++) sum += (a[i] - b[i]) * (a[i] - b[i]), size += b[i] * b[i];
    return sqrt(sum / size);
}

static void check_roll_in_tissue(rows *r) {
    double plain[6], smooth[6], rolled[6], before = 0.0, later = 0.0;
    push_rolled(0.0, 0.0, true, plain);
    push_rolled(0.0, 0.0, false, smooth);
    for (double roll = 0.7; roll < (r->short_form ? 1.0 : 6.3); roll += 1.4) {
        push_rolled(roll, 0.0, true, rolled);
        before = fmax(before, fmax(distance(rolled, plain, 0), distance(rolled, plain, 3)));
        push_rolled(0.0, roll, false, rolled);
        later = fmax(later, fmax(distance(rolled, smooth, 0), distance(rolled, smooth, 3)));
    }
    rows_error(r, "in tissue, base rolled before the push: force and torque", "no roll", before, 1e-6);
    rows_error(r, "in tissue without friction, base rolled at 59 mm: force and torque", "no roll", later, 1e-6);
}

/* ---- speed ------------------------------------------------------------------------------------------------------------------ */

static int ascending(const void *a, const void *b) {
    double x = *(const double *)a, y = *(const double *)b;
    return (x > y) - (x < y);
}

static double seconds_now(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static void check_speed(rows *r) {
    enum { TIMES = 501 };
    needle_model model = rod(40);
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    needle_state state;
    double took[TIMES];
    load[40] = v3(0, 1.0, 0);
    needle_set_straight(&model, at_rest(0), &state);
    bend(&model, &state, load, 0.0);
    for (int i = 0; i < TIMES; i++) {
        double from = seconds_now();
        needle_linearise(&model, &state, load, 14, &tangent); /* only for the joints in the tissue; 60 mm of the needle are still outside */
        took[i] = seconds_now() - from;
    }
    qsort(took, TIMES, sizeof *took, ascending);
    double median = took[TIMES / 2];
    static histogram product;
    baseline_measure(&product);
    double ratio = median / histogram_quantile(&product, 0.5);
    rows_add(r, (row){.check = "time of a linearisation, 40 segments, 26 of them in tissue", .reference = "half of a tick of 30 contacts", .value = ratio,
                      .expected = NAN, .error = ratio, .limit = 0.061, .unit = "of a dgemm of order 256",
                      .note = "median of 501; a tick may take 80 us where the product takes 655 us"});
}

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Needle: rod, small deflections");
    check_small(&r);
    r.section = "Needle: rod, large deflections";
    for (int which = 0; which < CASES; which++) check_large(&r, which);
    r.section = "Needle: rod, torsion and roll";
    check_torsion(&r);
    check_roll(&r);
    check_roll_in_tissue(&r);
    r.section = "Needle: rod, speed";
    check_speed(&r);
    return rows_end(&r);
}

/* Tests the paper's needle, made of tetrahedra with quadratic strain: how its stiffness depends on direction, locking, what the calibration does and how
   accurate it is, and its speed and forces compared with the rod's. */
#include <time.h>

#include "bending_solid.h"
#include "lockstep.h"
#include "rows.h"
#include "shared/motion.h"

static const pose ORIGIN = {{0, 0, 0}, {1, 0, 0, 0}};
static const double LENGTH = 0.2; /* m, length of the needle assumed in bending.h */
enum { TICKS = 2400, MOST_DIRECTIONS = 36, MOST_LOADS = 12, LEAST_SEGMENTS = 20 };

/* One mesh under test. */
typedef struct {
    int segments;
    solid_model model;
    solid_tangent *tangent;
    char label[32];
} subject;

static subject subject_made(int segments) {
    subject s = {.segments = segments, .model = solid_made(segments), .tangent = malloc(sizeof *s.tangent)};
    if (!s.tangent) abort();
    snprintf(s.label, sizeof s.label, "%d segments", segments);
    return s;
}

static const char *named(const subject *s, const char *what) {
    static char text[160];
    snprintf(text, sizeof text, "%s: %s", s->label, what);
    return text;
}

/* Returns the tip displacement, relative to the length, under a load of p EI / L^2 across the needle: its components along the load, perpendicular to it,
   and along the needle. */
static vec3 bent_tip(const subject *s, double angle, double p) {
    solid_state state;
    vec3 along = v3(cos(angle), sin(angle), 0), across = v3(-sin(angle), cos(angle), 0);
    solid_rest(&s->model, ORIGIN, &state);
    solid_bend(&s->model, &state, v3_scale(p * s->model.line.bending / (LENGTH * LENGTH), along), s->tangent);
    vec3 tip = solid_tip_of(&s->model, &state);
    return v3(v3_dot(tip, along) / LENGTH, v3_dot(tip, across) / LENGTH, tip.z / LENGTH);
}

/* ---- direction ------------------------------------------------------------------------------------------------------- */

static void check_direction(rows *r, const subject *s) {
    double angles[MOST_DIRECTIONS], stiffness[MOST_DIRECTIONS], least = INFINITY, most = 0.0, across = 0.0;
    int count = r->short_form ? 8 : MOST_DIRECTIONS;
    for (int d = 0; d < count; d++) {
        double angle = (r->short_form ? 0.5 : 2.0) * M_PI * d / count;
        vec3 tip = bent_tip(s, angle, 2.0);
        angles[d] = angle * 180.0 / M_PI;
        stiffness[d] = 1.0 / tip.x;
        least = fmin(least, stiffness[d]), most = fmax(most, stiffness[d]);
        across = fmax(across, fabs(tip.y) / tip.x);
    }
    double mean = 0.5 * (least + most);
    for (int d = 0; d < count; d++) stiffness[d] = 100.0 * (stiffness[d] / mean - 1.0);
    rows_curve(r, (curve){.figure = "needle-tets-direction", .label = s->label, .x_label = "direction of the load (degrees)",
                          .y_label = "secant stiffness over its mean (%)", .count = count, .x = angles, .y = stiffness});
    rows_error(r, named(s, "stiffness against direction, deflection of half the length"), "mean over the directions", (most - mean) / mean, 5e-3);
    rows_error(r, named(s, "deflection across the load"), "deflection along it", across, 5e-3);
    solid_state state;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    solid_rest(&s->model, ORIGIN, &state);
    solid_linearise(&s->model, &state, load, 0, s->tangent);
    int x = 3 * s->segments, y = x + 1;
    double small_x = s->tangent->line.compliance[x][x];
    rows_error(r, named(s, "anisotropy under a small load"), "isotropic compliance of the tip",
               fmax(fabs(s->tangent->line.compliance[y][y] - small_x), fabs(s->tangent->line.compliance[x][y])) / small_x, 1e-6);
}

/* ---- locking and calibration ------------------------------------------------------------------------------------------ */

/* Returns the bending stiffness if plane sections stay plane and the full Young's modulus is used, relative to E I of the square that is meshed, I = r^4 /
   3. Two out of three tetrahedra at a rim node have a normal strain, which gives 2/3 r^4. All of them have a shear strain of curvature times h/2, and one in
   six also has one across the needle, which gives 5/12 G A h^2 with A = 2 r^2. */
static double plane_sections(const solid_model *model) {
    double slender = model->line.segment_length / model->line.radius;
    return 2.0 + 2.5 / (2.0 * (1.0 + model->line.given.poisson_ratio)) * slender * slender;
}

static double locking_of(const solid_model *model) {
    double square = model->line.given.youngs_modulus * pow(model->line.radius, 4) / 3.0;
    return model->line.bending / (model->solid.calibration * square);
}

static void check_locking(rows *r, const subject *s) {
    double locking = locking_of(&s->model), expected = plane_sections(&s->model);
    rows_add(r, (row){.check = named(s, "locking: bending stiffness before calibration, over that of the solid meshed"),
                      .reference = "plane sections, 2 + 5/2 (G/E) (h/r)^2", .value = locking, .expected = expected,
                      .error = fabs(locking / expected - 1.0), .limit = 0.1, .note = "linear elements see bending as shear"});
    rows_compare(r, named(s, "calibrated deflection under 1 % of EI/L^2"), "P L^3 / 3 EI", bent_tip(s, 0.4, 0.01).x, 0.01 / 3.0, 1e-4, "L");
}

static void draw_locking(rows *r) {
    enum { MESHES_DRAWN = 6 };
    const int segments[MESHES_DRAWN] = {4, 8, 16, 32, 48, 64};
    double slender[MESHES_DRAWN], measured[MESHES_DRAWN], expected[MESHES_DRAWN];
    for (int i = 0; i < MESHES_DRAWN; i++) {
        solid_model model = solid_made(segments[i]);
        slender[i] = model.line.segment_length / model.line.radius;
        measured[i] = locking_of(&model);
        expected[i] = plane_sections(&model);
    }
    curve c = {.figure = "needle-tets-locking", .label = "measured", .x_label = "length of a segment over the needle's radius",
               .y_label = "stiffness over that of the solid", .logarithmic = true, .count = MESHES_DRAWN, .x = slender, .y = measured};
    rows_curve(r, c);
    c.label = "plane sections", c.y = expected;
    rows_curve(r, c);
}

static void check_elastica(rows *r, const subject *s) {
    const double loads[] = {0.5, 1.0, 2.0};
    char what[96];
    for (int i = 0; i < 3; i++) {
        double x, y;
        elastica(loads[i], &x, &y);
        snprintf(what, sizeof what, "deflection under %g EI/L^2", loads[i]);
        rows_compare(r, named(s, what), "elastica", bent_tip(s, 0.3, loads[i]).x, y, 0.01, "L");
    }
}

static void draw_elastica(rows *r, const subject *s) {
    double load[MOST_LOADS], measured[MOST_LOADS], expected[MOST_LOADS], x;
    for (int i = 0; i < MOST_LOADS; i++) {
        load[i] = 0.25 * i;
        elastica(load[i], &x, &expected[i]);
        measured[i] = bent_tip(s, 0.3, load[i]).x;
    }
    curve c = {.figure = "needle-tets-elastica", .label = s->label, .x_label = "load on the tip (EI/L^2)", .y_label = "deflection (lengths)",
               .count = MOST_LOADS, .x = load, .y = measured};
    rows_curve(r, c);
    c.label = "elastica", c.y = expected;
    rows_curve(r, c);
}

/* Returns the couple on the tip's rim divided by its rotation (N m), from the factorised tangent stiffness at rest. */
static double torsional_stiffness(const subject *s) {
    double x[NEEDLE_MAX_SEGMENTS][TRIDIAGONAL_ROWS] = {{0}}, *tip = x[s->segments - 1], twist = 0.0;
    for (int i = 0; i < SOLID_RIM; i++) { /* a unit couple, with forces along e_z x arm */
        vec3 arm = s->model.solid.rim[i];
        tip[3 + 3 * i] = -arm.y / (SOLID_RIM * v3_dot(arm, arm));
        tip[4 + 3 * i] = arm.x / (SOLID_RIM * v3_dot(arm, arm));
    }
    tridiagonal_solve(&s->tangent->stiffness, x);
    for (int i = 0; i < SOLID_RIM; i++) {
        vec3 arm = s->model.solid.rim[i];
        twist += (arm.x * tip[4 + 3 * i] - arm.y * tip[3 + 3 * i]) / (SOLID_RIM * v3_dot(arm, arm));
    }
    return 1.0 / twist;
}

/* Checks what the factor on Young's modulus does to the stiffnesses it was not calibrated for. */
static void check_cost(rows *r, const subject *s) {
    const needle_parameters *g = &s->model.line.given;
    int z = 3 * s->segments + 2;
    double steel = g->youngs_modulus * M_PI / 4.0 * (pow(g->outer_diameter, 2) - pow(g->inner_diameter, 2)) / g->length;
    solid_state state;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    solid_rest(&s->model, ORIGIN, &state);
    solid_linearise(&s->model, &state, load, s->segments, s->tangent);
    double axial = 1.0 / s->tangent->line.compliance[z][z];
    rows_measured(r, (row){.check = named(s, "axial stiffness after calibration"), .reference = "EA/L of the steel tube", .value = axial, .expected = steel,
                           .error = fabs(axial / steel - 1.0), .unit = "N/m",
                           .note = "the price of the factor on Young's modulus; the forces below show what it does"});
    double torsion = torsional_stiffness(s), tube = s->model.line.torsion / g->length;
    rows_measured(r, (row){.check = named(s, "torsional stiffness after calibration"), .reference = "GJ/L of the steel tube", .value = torsion, .expected = tube,
                           .error = fabs(torsion / tube - 1.0), .unit = "N m", .note = "torsion locks as bending does; the rod has GJ"});
}

/* ---- compared with the rod -------------------------------------------------------------------------------------------- */

static double seconds(void) {
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

/* Returns the shortest time (s) of a Newton pass, i.e. the linearisation for contacts on the outer half plus the update. */
static double rod_pass_time(int segments) {
    needle_model model = needle_made(segments);
    needle_tangent *tangent = malloc(sizeof *tangent);
    needle_state state;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    load[segments] = v3(0.1, 0, 0);
    needle_set_straight(&model, ORIGIN, &state);
    double least = INFINITY;
    for (int i = 0; i < 500; i++) {
        double start = seconds();
        needle_linearise(&model, &state, load, segments / 2, tangent);
        needle_advance(&model, tangent, load, &state);
        least = fmin(least, seconds() - start);
    }
    free(tangent);
    return least;
}

static double solid_pass_time(int segments) {
    solid_model model = solid_made(segments);
    solid_tangent *tangent = malloc(sizeof *tangent);
    solid_state state;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    load[segments] = v3(0.1, 0, 0);
    solid_rest(&model, ORIGIN, &state);
    double least = INFINITY;
    for (int i = 0; i < 500; i++) {
        double start = seconds();
        solid_linearise(&model, &state, load, segments / 2, tangent);
        solid_advance(&model, tangent, load, &state);
        least = fmin(least, seconds() - start);
    }
    free(tangent);
    return least;
}

static void check_speed(rows *r, const subject *s) {
    double rod = rod_pass_time(s->segments), tets = solid_pass_time(s->segments);
    char note[64];
    snprintf(note, sizeof note, "%.0f times the rod's %.1f us; error: share of 1 ms", tets / rod, 1e6 * rod);
    rows_add(r, (row){.check = named(s, "time of a Newton pass"), .reference = "period of 1 kHz", .value = 1e6 * tets, .expected = NAN,
                      .error = 1e3 * tets, .limit = 1.0, .unit = "us", .note = note});
}

typedef struct { double time[TICKS], wrench[TICKS][6]; } record;

static record *run_figure8(bool solid, int segments) {
    record *run = calloc(1, sizeof *run);
    if (!run) abort();
    simulation_config c = lockstep_config();
    c.needle.segments = segments;
    solid_in_tissue(solid ? &c.needle : NULL);
    lockstep *l = lockstep_create(&c, lockstep_start());
    for (int i = 0; i < TICKS; i++) {
        run->time[i] = (i + 1) * 1e-3;
        lockstep_tick(l, motion_pose(motion_find("figure8"), lockstep_start(), run->time[i]), 1e-3);
        memcpy(run->wrench[i], &l->wrench.force, sizeof(vec3));
        memcpy(run->wrench[i] + 3, &l->wrench.torque, sizeof(vec3));
    }
    lockstep_free(l);
    return run;
}

/* Returns the RMS difference of the components [from, to), relative to the RMS for the rod. */
static double difference(const record *a, const record *rod, int from, int to) {
    double off = 0.0, size = 0.0;
    for (int i = 0; i < TICKS; i++)
        for (int k = from; k < to; k++) off += pow(a->wrench[i][k] - rod->wrench[i][k], 2), size += pow(rod->wrench[i][k], 2);
    return sqrt(off / size);
}

static void draw_force(rows *r, const record *run, const char *label) {
    double axial[TICKS];
    for (int i = 0; i < TICKS; i++) axial[i] = run->wrench[i][2];
    rows_curve(r, (curve){.figure = "needle-tets-figure8", .label = label, .x_label = "time (s)", .y_label = "axial force (N)", .count = TICKS,
                          .x = run->time, .y = axial});
}

static void check_insertion(rows *r, const subject *s, const record *rod) {
    record *tets = run_figure8(true, s->segments);
    double force = difference(tets, rod, 0, 3);
    row entry = {.check = named(s, "base force in the figure-8 run, rms of the difference"), .reference = "rod of 40 segments", .value = force,
                 .expected = NAN, .error = force, .limit = 0.05};
    if (s->segments < LEAST_SEGMENTS) {
        entry.note = "too few segments: axially too soft after calibration, so that friction turns late when the needle is pulled";
        rows_measured(r, entry);
    } else {
        rows_add(r, entry);
    }
    rows_error(r, named(s, "base torque in the figure-8 run, rms of the difference"), "rod of 40 segments", difference(tets, rod, 3, 6), 0.05);
    draw_force(r, tets, s->label);
    free(tets);
}

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Needle: tetrahedra with quadratic strain");
    record *rod = run_figure8(false, 40);
    draw_force(&r, rod, "rod");
    for (int segments = r.short_form ? 20 : 10; segments <= (r.short_form ? 20 : 40); segments *= 2) {
        subject s = subject_made(segments);
        check_direction(&r, &s);
        check_locking(&r, &s);
        check_elastica(&r, &s);
        check_cost(&r, &s);
        check_speed(&r, &s);
        check_insertion(&r, &s, rod);
        if (segments == 20) draw_elastica(&r, &s);
        free(s.tangent);
    }
    draw_locking(&r);
    free(rod);
    return rows_end(&r);
}

/* Tests bevel-tip steering: the curvature of a bevelled needle's track is compared with measurements, beam theory and symmetry. */
#include "rows.h"
#include "steering.h"

static const double FROM = 0.03, TO = 0.08; /* m, depths over which the track's curvature is fitted */
enum { MOST_SLOPES = 5 };

static double curvature_of(const steering_case *c) {
    steering_track track = steering_run(c);
    return steering_curvature(&track, FROM, TO, steering_direction(c->roll));
}

/* Returns the reciprocal of the decay length of a beam on an elastic foundation, with Vesic's subgrade modulus (ASCE J. Soil Mech. Found. Div. 87, 1961). */
static double foundation_wave_number(const steering_case *c, double poisson_ratio) {
    double d = c->needle.outer_diameter, inner = c->needle.inner_diameter;
    double bending = c->needle.youngs_modulus * M_PI / 64.0 * (pow(d, 4) - pow(inner, 4));
    double modulus = 0.65 * pow(c->tissue_modulus * pow(d, 4) / bending, 1.0 / 12.0) * c->tissue_modulus / (1.0 - poisson_ratio * poisson_ratio);
    return pow(modulus / (4.0 * bending), 0.25);
}

static void draw_track(rows *r, const char *figure, const char *label, const steering_track *track) {
    double depth[MAX_CONTACTS + 2], sideways[MAX_CONTACTS + 2];
    for (int i = 0; i < track->count; i++) {
        depth[i] = 1e3 * track->points[i].z;
        sideways[i] = 1e3 * v3_dot(v3_sub(track->points[i], track->points[0]), steering_direction(0.0));
    }
    rows_curve(r, (curve){.figure = figure, .label = label, .x_label = "depth (mm)", .y_label = "sideways, away from the bevel's face (mm)",
                          .count = track->count, .x = depth, .y = sideways});
}

#define FINE GENERATED "/prostate-3300.msh"
#define FINEST GENERATED "/prostate-6500.msh"

static const char *nodes_of(const steering_case *c) { return !c->mesh ? "570 nodes" : strcmp(c->mesh, FINEST) ? "3300 nodes" : "6500 nodes"; }

/* Asymmetric elements push the tip sideways. On coarse meshes, this deflection is only reported; on a finer mesh, it has a limit. */
static void on_mesh(rows *r, row entry, const steering_case *c, bool fine) {
    char check[160];
    snprintf(check, sizeof check, "%s, %s", entry.check, nodes_of(c));
    entry.check = check;
    if (fine || r->short_form) rows_add(r, entry);
    else rows_measured(r, entry);
}

static void check_straight(rows *r, const char *check, steering_case c) {
    c.needle.bevel_slope = 0.0;
    steering_track track = steering_run(&c);
    double off = hypot(steering_deflection(&track, v3(1, 0, 0)), steering_deflection(&track, v3(0, 1, 0)));
    on_mesh(r, (row){.check = check, .reference = "straight line", .value = off, .expected = 0.0, .error = off, .limit = 1e-4, .unit = "m",
                     .note = "deflection of the tip at 79 mm, absolute error: unsymmetric elements push the tip aside"}, &c, c.mesh && !strcmp(c.mesh, FINEST));
}

/* Checks the S-shaped track after a half turn: its end and, for a needle whose bending decays within a few millimetres, the curvature after the turn. */
static void check_half_turn(rows *r, const char *name, steering_case c, bool decays_at_once) {
    char check[96];
    steering_track arc = steering_run(&c);
    c.half_turn_at = 0.04;
    steering_track s = steering_run(&c);
    double before = steering_curvature(&arc, 0.042, TO, steering_direction(0)), after = steering_curvature(&s, 0.042, TO, steering_direction(0));
    double end = steering_deflection(&s, steering_direction(0)), superposed = steering_superposed(&c, c.half_turn_at, steering_direction(0));
    snprintf(check, sizeof check, "%s: deflection at 79 mm after a half turn at 39 mm", name);
    rows_add(r, (row){.check = check, .reference = "superposition: no turn, less twice the track of a bevel that acts from 39 mm on", .value = end,
                      .expected = superposed, .error = fabs(end - superposed) / steering_deflection(&arc, steering_direction(0)), .limit = 0.05,
                      .unit = "m", .note = "error as a part of the deflection without a turn"});
    snprintf(check, sizeof check, "%s: curvature after a half turn at 39 mm", name);
    if (decays_at_once) on_mesh(r, (row){.check = check, .reference = "curvature there without the turn, reversed", .value = after, .expected = -before,
                      .error = fabs(after / before + 1.0), .limit = 0.2, .unit = "1/m"}, &c, c.mesh);
    snprintf(check, sizeof check, "%s, no turn", name);
    draw_track(r, "steering-half-turn", check, &arc);
    snprintf(check, sizeof check, "%s, half turn", name);
    draw_track(r, "steering-half-turn", check, &s);
}

/* A needle rolled by half a turn before the insertion cuts the mirrored track, as far as the mesh's asymmetry allows. */
static void check_mirror(rows *r, const char *check, steering_case c) {
    c.x = c.y = 0.0;
    double upright = curvature_of(&c);
    c.roll = M_PI;
    double rolled = curvature_of(&c);
    on_mesh(r, (row){.check = check, .reference = "curvature with the bevel upright", .value = rolled, .expected = upright,
                     .error = fabs(rolled / upright - 1.0), .limit = 0.15, .unit = "1/m"}, &c, c.mesh);
}

static void check_nitinol_slopes(rows *r) {
    double slopes[MOST_SLOPES] = {0.0125, 0.025, 0.05, 0.075, 0.1}, curvatures[MOST_SLOPES], beam[MOST_SLOPES];
    double nu = lockstep_config().regions[0].material.poisson_ratio;
    for (int i = 0; i < MOST_SLOPES; i++) {
        steering_case c = steering_nitinol(slopes[i]);
        steering_track track = steering_run(&c);
        char label[64];
        snprintf(label, sizeof label, "slope %g", slopes[i]);
        draw_track(r, "steering-slopes", label, &track);
        curvatures[i] = steering_curvature(&track, FROM, TO, steering_direction(0.0));
        beam[i] = slopes[i] * foundation_wave_number(&c, nu);
    }
    curve shared = {.figure = "steering-curvature", .x_label = "bevel slope", .y_label = "curvature (1/m)", .count = MOST_SLOPES, .x = slopes};
    shared.label = "0.7 mm nitinol in 60 kPa", shared.y = curvatures;
    rows_curve(r, shared);
    shared.label = "beam on a Winkler foundation", shared.y = beam;
    rows_curve(r, shared);
    rows_measured(r, (row){.check = "0.7 mm nitinol, slope 0.05, tissue 60 kPa: radius of the track",
                           .reference = "about 0.22 m: Webster et al., Int. J. Robotics Research 25, 2006 (45 deg bevel, stiff gel)",
                           .value = 1.0 / curvatures[2], .expected = 0.22, .error = fabs(1.0 / (0.22 * curvatures[2]) - 1.0), .unit = "m",
                           .note = "the slope is a free parameter, chosen for the order of magnitude"});
    rows_measured(r, (row){.check = "0.7 mm nitinol, slope 0.05, tissue 60 kPa: curvature",
                           .reference = "slope / decay length of a beam on a Winkler foundation (steady state)",
                           .value = curvatures[2], .expected = beam[2], .error = fabs(curvatures[2] / beam[2] - 1.0), .unit = "1/m",
                           .note = "an estimate"});
}

/* Compares moduli from the softest tissue to rubber. In tissue softer than 60 kPa, which would otherwise be dented by centimetres, the strength is
   proportional to the modulus. */
static void check_stiffness(rows *r, const char *name, steering_case c) {
    static const double moduli[] = {5e3, 15e3, 60e3, 250e3, 1e6, 3e6};
    for (int i = 0; i < 6; i++) {
        c.tissue_modulus = moduli[i];
        c.strength = fmin(1.0, moduli[i] / 60e3);
        double curvature = curvature_of(&c), beam = c.needle.bevel_slope * foundation_wave_number(&c, 0.45);
        char check[160];
        snprintf(check, sizeof check, "%s, slope 0.05, tissue of %g kPa: radius of the track", name, 1e-3 * moduli[i]);
        rows_measured(r, (row){.check = check, .reference = "decay length of a beam on a Winkler foundation / slope (steady state)", .value = 1.0 / curvature,
                               .expected = 1.0 / beam, .error = fabs(beam / curvature - 1.0), .unit = "m",
                               .note = "no limit: a beam's decay length is no shorter than its diameter only in tissue as stiff as the needle"});
    }
}

/* Curvatures of one needle on one mesh with the bevel facing in four directions. */
typedef struct {
    double mean, spread; /* mean: 1/m; spread: largest minus smallest curvature, as a fraction of the mean */
} curvatures;

static curvatures curvatures_around(steering_case c, const char *mesh) {
    double least = INFINITY, most = -INFINITY, sum = 0.0;
    c.mesh = mesh;
    for (int side = 0; side < 4; side++) {
        c.roll = side * M_PI / 2.0;
        double k = curvature_of(&c);
        least = fmin(least, k), most = fmax(most, k), sum += k;
    }
    return (curvatures){sum / 4.0, (most - least) / (sum / 4.0)};
}

/* Asymmetric elements deflect the track by about the same amount on every mesh, but in different directions. The mean over four bevel directions therefore
   shows the effect of element size, and the spread that of the mesh's irregularity. */
static void check_meshes(rows *r) {
    static const int sizes[] = {570, 1700, 3300, 6500};
    steering_case cases[] = {steering_steel(0.05), steering_nitinol(0.05)};
    static const char *const names[] = {"18 G steel", "0.7 mm nitinol"};
    for (int k = 0; k < 2; k++) {
        curvatures coarse = {0};
        for (int i = 0; i < 4; i++) {
            char path[1024], check[160];
            snprintf(path, sizeof path, GENERATED "/prostate-%d.msh", sizes[i]);
            curvatures here = curvatures_around(cases[k], i ? path : NULL);
            snprintf(check, sizeof check, "%s, slope 0.05: spread of the curvature with the bevel facing four sides, %d nodes", names[k], sizes[i]);
            rows_measured(r, (row){.check = check, .reference = "largest less smallest, relative to the mean", .value = here.spread, .expected = 0.0,
                                   .error = here.spread, .note = "unsymmetric elements push the tip aside"});
            if (i == 0) {
                coarse = here;
                continue;
            }
            snprintf(check, sizeof check, "%s, slope 0.05: curvature on 570 nodes against %d, mean of four sides", names[k], sizes[i]);
            rows_add(r, (row){.check = check, .reference = "the finer mesh", .value = coarse.mean, .expected = here.mean,
                              .error = fabs(coarse.mean / here.mean - 1.0), .limit = 0.15, .unit = "1/m"});
        }
    }
}

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Steering: bevel tip");
    check_straight(&r, "18 G steel without bevel", steering_steel(0.0));
    check_half_turn(&r, "18 G steel, slope 0.1", steering_steel(0.1), false);
    check_nitinol_slopes(&r);
    if (!r.short_form) {
        check_stiffness(&r, "18 G steel", steering_steel(0.05));
        check_stiffness(&r, "0.7 mm nitinol", steering_nitinol(0.05));
        for (int fine = 0; fine < 2; fine++) {
            steering_case steel = steering_steel(0.1), nitinol = steering_nitinol(0.05);
            steel.mesh = nitinol.mesh = fine ? FINE : NULL;
            check_straight(&r, "0.7 mm nitinol without bevel", nitinol);
            check_half_turn(&r, "0.7 mm nitinol, slope 0.05", nitinol, true);
            check_mirror(&r, "18 G steel, slope 0.1: curvature, rolled by half a turn", steel);
            check_mirror(&r, "0.7 mm nitinol, slope 0.05: curvature, rolled by half a turn", nitinol);
        }
        steering_case finest = steering_nitinol(0.0);
        finest.mesh = FINEST;
        check_straight(&r, "0.7 mm nitinol without bevel", finest);
        check_meshes(&r);
    }
    return rows_end(&r);
}

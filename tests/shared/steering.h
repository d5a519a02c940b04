/* Pushes bevelled needles through uniform tissue and records the tracks they cut, for test_steering.c and verify_steering.c. */
#ifndef TROCAR_TESTS_STEERING_H
#define TROCAR_TESTS_STEERING_H

#include "lockstep.h"

typedef struct {
    const char *mesh;            /* path of the mesh, or NULL for the figure-8 scene's */
    needle_parameters needle;
    double tissue_modulus;       /* Pa, everywhere */
    double strength;             /* factor on membrane strength, friction and cutting resistance, relative to those of 60 kPa tissue */
    double x, y;                 /* m, entry point */
    double roll;                 /* rad, initial roll about the needle's axis; at 0, the bevel faces +y */
    double half_turn_at;         /* m, base travel at which the needle is rolled by half a turn; INFINITY for never */
    double bevel_from;           /* m, base travel from which the bevel has an effect; 0 for the start */
    double way;                  /* m, base travel along +z, starting with the tip 1 mm in front of the skin */
} steering_case;

/* The nominal track, from skin to tip. */
typedef struct {
    int count;
    vec3 points[MAX_CONTACTS + 2]; /* m */
} steering_track;

/* Returns the scene's 18 G steel needle. */
static inline steering_case steering_steel(double slope) {
    steering_case c = {.needle = lockstep_config().needle, .tissue_modulus = 60e3, .strength = 1.0, .x = 0.005, .y = 0.003, .half_turn_at = INFINITY, .way = 0.08};
    c.needle.bevel_slope = slope;
    return c;
}

/* Returns Webster's wire: solid nitinol, 0.7 mm thick. It is short, because nothing guides it between base and skin. */
static inline steering_case steering_nitinol(double slope) {
    steering_case c = steering_steel(slope);
    c.needle.length = 0.1;
    c.needle.outer_diameter = 0.7e-3;
    c.needle.inner_diameter = 0.0;
    c.needle.youngs_modulus = 75e9;
    return c;
}

/* Returns a configuration with one material, and with membranes that a thin needle can puncture without buckling. */
static inline simulation_config steering_config(const steering_case *given) {
    simulation_config c = lockstep_config();
    if (given->mesh) snprintf(c.mesh_path, sizeof c.mesh_path, "%s", given->mesh);
    c.needle = given->needle;
    for (int i = 0; i < c.region_count; i++)
        c.regions[i].material = (region_material){.youngs_modulus = given->tissue_modulus, .poisson_ratio = 0.45, .cutting_force = 0.5 * given->strength,
                                                  .cutting_viscosity = 1, .friction_static = 15 * given->strength, .friction_kinetic = 9 * given->strength,
                                                  .friction_viscous = 100 * given->strength};
    for (int i = 0; i < c.membrane_count; i++) c.membranes[i].puncture_force = 0.6 * given->strength;
    return c;
}

static inline void steering_roll_over(lockstep *l) {
    quat from = l->base.orientation;
    for (int i = 1; i <= 500; i++) {
        pose base = l->base;
        base.orientation = q_unit(q_multiply(from, q_exp(v3(0, 0, M_PI * i / 500))));
        lockstep_tick(l, base, 1e-3);
    }
}

static inline steering_track steering_run(const steering_case *given) {
    simulation_config config = steering_config(given);
    pose start = {v3(given->x, given->y, -1e-3 - given->needle.length), q_exp(v3(0, 0, given->roll))};
    lockstep *l = lockstep_create(&config, start);
    double before = given->bevel_from > 0.0 ? given->bevel_from : fmin(given->half_turn_at, given->way);
    if (given->bevel_from > 0.0) l->parts.needle.given.bevel_slope = 0.0;
    lockstep_move(l, v3(0, 0, before), 20.0 * before, 1e-3);
    if (before < given->way) {
        if (given->bevel_from > 0.0) l->parts.needle.given.bevel_slope = given->needle.bevel_slope;
        else steering_roll_over(l);
        lockstep_move(l, v3(0, 0, given->way - before), 20.0 * (given->way - before), 1e-3);
    }
    steering_track track = {.count = 1, .points = {l->state.entry}};
    for (int i = 0; i < contacts_active(&l->state); i++) track.points[track.count++] = l->state.contacts[i].track;
    track.points[track.count++] = l->state.tip.place.nominal;
    lockstep_free(l);
    return track;
}

/* Returns the direction in which the needle first steers, away from the bevel's face. */
static inline vec3 steering_direction(double roll) { return v3(sin(roll), -cos(roll), 0); }

/* Returns where the track of a needle rolled by half a turn at `at` must end, by superposition. For small deflections, cutting is linear in the bevel's
   slope, so the half turn subtracts twice the track of a bevel that only has an effect after that point. */
static inline double steering_superposed(const steering_case *given, double at, vec3 sideways) {
    steering_case always = *given, later = *given;
    always.half_turn_at = INFINITY;
    later.half_turn_at = INFINITY;
    later.bevel_from = at;
    steering_track whole = steering_run(&always), part = steering_run(&later);
    vec3 a = whole.points[whole.count - 1], b = part.points[part.count - 1];
    return v3_dot(v3_sub(a, whole.points[0]), sideways) - 2.0 * v3_dot(v3_sub(b, part.points[0]), sideways);
}

/* Returns the signed curvature (1/m) of the track between these depths (z, m) in the plane of +z and `sideways`, positive toward `sideways`. It is the
   curvature of a least-squares parabola over that part's chord. */
static inline double steering_curvature(const steering_track *track, double from, double to, vec3 sideways) {
    int first = 0, last = track->count - 1;
    while (first < last && track->points[first].z < from) first++;
    while (last > first && track->points[last].z > to) last--;
    vec3 a = track->points[first], chord = v3_sub(track->points[last], a), z = v3(0, 0, 1);
    double angle = atan2(v3_dot(chord, sideways), chord.z), length = v3_norm(chord);
    vec3 along = v3_axpy(sin(angle), sideways, v3_scale(cos(angle), z));
    vec3 across = v3_axpy(cos(angle), sideways, v3_scale(-sin(angle), z));
    double s[5] = {0};
    vec3 t = v3(0, 0, 0);
    for (int i = first; i <= last; i++) {
        vec3 p = v3_sub(track->points[i], a);
        double u = v3_dot(p, along) / length - 0.5, v = v3_dot(p, across);
        for (int k = 0; k < 5; k++) s[k] += pow(u, k);
        t = v3_add(t, v3(v, u * v, u * u * v));
    }
    mat3 normal = {{{s[0], s[1], s[2]}, {s[1], s[2], s[3]}, {s[2], s[3], s[4]}}}, inverse = m3_inverse(&normal);
    return 2.0 * m3_apply(&inverse, t).z / (length * length);
}

/* Returns how far (m) the tip deviates from a straight path, toward `sideways`. */
static inline double steering_deflection(const steering_track *track, vec3 sideways) {
    return v3_dot(v3_sub(track->points[track->count - 1], track->points[0]), sideways);
}

#endif

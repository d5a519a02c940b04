/* Random scenes and hand motions with all features enabled, through trocar.h. Scenes have blocks of two materials with random moduli, friction, cutting
   forces, stiffening, relaxation and membranes, needles 0.4 to 1.3 mm thick, guides with various clearances, and needles that rest close to the moving one.
   Motions are closed: they end where they began, outside the tissue. */
#ifndef TROCAR_VERIFICATION_RANDOM_SCENE_H
#define TROCAR_VERIFICATION_RANDOM_SCENE_H

#include <math.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "trocar.h"

/* Returns a random number in [low, high). The sequence is the same on every machine. */
static inline double random_between(uint64_t *seed, double low, double high) {
    *seed = *seed * 6364136223846793005u + 1442695040888963407u;
    return low + (high - low) * (double)(*seed >> 11) / 9007199254740992.0;
}

static inline double random_factor(uint64_t *seed, double low, double high) { return low * pow(high / low, random_between(seed, 0, 1)); }
static inline bool random_chance(uint64_t *seed, double probability) { return random_between(seed, 0, 1) < probability; }

/* ---- mesh -------------------------------------------------------------------------------------------------------------------- */

enum { MOST_CELLS = 9, MOST_SIDE = MOST_CELLS + 1 };
static const double BLOCK_WIDTH = 0.08, BLOCK_DEPTH = 0.08; /* m */

typedef struct {
    int cells, split;        /* cells: number of cells along each axis; split: layer at which the second material begins */
    double nodes[MOST_SIDE * MOST_SIDE * MOST_SIDE][3];
    int32_t tets[6 * MOST_CELLS * MOST_CELLS * MOST_CELLS][4], region[6 * MOST_CELLS * MOST_CELLS * MOST_CELLS];
    int32_t triangles[6 * MOST_CELLS * MOST_CELLS + 1][3] /* one more than needed, as room for a candidate face */, surface[6 * MOST_CELLS *
                                                             MOST_CELLS];
    int tet_count, triangle_count;
} random_block;

static inline int block_at(const random_block *b, const int at[3]) { return at[0] + (b->cells + 1) * (at[1] + (b->cells + 1) * at[2]); }

/* Adds the face of a tetrahedron whose nodes are all in layer `value`, if it has one. */
static inline void block_triangle(random_block *b, const int32_t tet[4], int at[4][3], int value, int surface) {
    int32_t *t = b->triangles[b->triangle_count];
    int count = 0;
    for (int k = 0; k < 4; k++)
        if (at[k][2] == value && count < 3) t[count++] = tet[k];
    if (count == 3) b->surface[b->triangle_count++] = surface;
}

/* Creates six tetrahedra per cell. Nodes that are not on a boundary are moved by up to a sixth of a cell. Surfaces: 0 is the skin, 1 the interface between
   the materials, 2 the bottom. */
static inline void block_create(random_block *b, uint64_t *seed) {
    static const int orders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    int n = b->cells = (int)random_between(seed, 6, MOST_CELLS + 1);
    b->split = (int)random_between(seed, 1, n - 1);
    b->tet_count = b->triangle_count = 0;
    double jitter = random_chance(seed, 0.3) ? 0.0 : 1.0 / 3.0;
    for (int z = 0; z <= n; z++)
        for (int y = 0; y <= n; y++)
            for (int x = 0; x <= n; x++) {
                double *p = b->nodes[block_at(b, (int[]){x, y, z})], cell = BLOCK_WIDTH / n;
                bool inside = x % n && y % n && z % n && z != b->split;
                double by = inside ? jitter : 0.0;
                p[0] = (x - 0.5 * n + by * random_between(seed, -0.5, 0.5)) * cell;
                p[1] = (y - 0.5 * n + by * random_between(seed, -0.5, 0.5)) * cell;
                p[2] = (z + by * random_between(seed, -0.5, 0.5)) * BLOCK_DEPTH / n;
            }
    for (int t = 0; t < 6 * n * n * n; t++) {
        int cell = t / 6, now[3] = {cell % n, cell / n % n, cell / n / n}, at[4][3];
        int32_t *tet = b->tets[b->tet_count];
        b->region[b->tet_count++] = now[2] >= b->split;
        bool top = now[2] == 0, above = now[2] == b->split - 1, bottom = now[2] == n - 1;
        for (int k = 0; k < 4; k++) {
            tet[k] = block_at(b, now);
            memcpy(at[k], now, sizeof now);
            if (k < 3) now[orders[t % 6][k]]++;
        }
        if (top) block_triangle(b, tet, at, 0, 0);
        if (above) block_triangle(b, tet, at, b->split, 1);
        if (bottom) block_triangle(b, tet, at, n, 2);
    }
}

static inline trocar_mesh block_arrays(const random_block *b) {
    static const char *const regions[] = {"a", "b"}, *const surfaces[] = {"skin", "capsule", "bottom"};
    return (trocar_mesh){.node_count = (b->cells + 1) * (b->cells + 1) * (b->cells + 1), .tet_count = b->tet_count, .nodes = b->nodes[0],
                         .tets = b->tets[0], .tet_region = b->region, .region_count = 2, .regions = regions, .triangle_count = b->triangle_count,
                         .triangles = b->triangles[0], .triangle_surface = b->surface, .surface_count = 3, .surfaces = surfaces};
}

/* ---- scene ------------------------------------------------------------------------------------------------------------------- */

typedef struct {
    random_block block;
    double length;           /* m, length of the needle */
    double entry[2];         /* m, where the needle enters the skin */
    bool guided, leaning;
    int needles;             /* one of them moves, the others rest */
    trocar_scene *scene;
} random_scene;

static inline void scene_number(trocar_scene *scene, const char *key, double value) {
    trocar_error why;
    if (trocar_scene_set_number(scene, key, value, &why) == TROCAR_OK) return;
    fprintf(stderr, "%s\n", why.text);
    abort();
}

static inline void scene_text(trocar_scene *scene, const char *key, const char *value) {
    trocar_error why;
    if (trocar_scene_set(scene, key, value, &why) == TROCAR_OK) return;
    fprintf(stderr, "%s\n", why.text);
    abort();
}

static inline void scene_region(trocar_scene *scene, const char *name, uint64_t *seed) {
    static const double ratios[] = {0.0, 0.3, 0.45, 0.45, 0.49, 0.499}, cutting[] = {0.0, 0.02, 0.05, 0.1, 0.2, 0.3, 1.0};
    char key[80];
    double kinetic = random_between(seed, 0, 1) < 0.15 ? 0.0 : random_factor(seed, 5, 100);
#define REGION(member, value) (snprintf(key, sizeof key, "regions[%s].%s", name, member), scene_number(scene, key, value))
    REGION("youngs_modulus", random_factor(seed, 3e3, 150e3));
    REGION("poisson_ratio", ratios[(int)random_between(seed, 0, 6)]);
    REGION("cutting_force", cutting[(int)random_between(seed, 0, 7)]);
    REGION("cutting_viscosity", random_chance(seed, 0.5) ? random_between(seed, 0, 5) : 0.0);
    REGION("friction.static", kinetic * random_between(seed, 1.0, 1.8));
    REGION("friction.kinetic", kinetic);
    REGION("friction.viscous", random_chance(seed, 0.5) ? 100.0 : 0.0);
    REGION("stiffening", random_chance(seed, 0.4) ? random_between(seed, 0, 2) : 0.0);
    REGION("spreading_force", random_chance(seed, 0.3) ? 0.1 : 0.0);
#undef REGION
}

static inline void scene_guide(random_scene *s, uint64_t *seed, double diameter) {
    char text[200];
    scene_text(s->scene, "guides[template].name", "template");
    snprintf(text, sizeof text, "[%.17g, %.17g, -0.02]", s->entry[0], s->entry[1]);
    scene_text(s->scene, "guides[template].origin", text);
    scene_text(s->scene, "guides[template].normal", "[0, 0, 1]");
    scene_number(s->scene, "guides[template].hole_diameter", diameter + random_chance(seed, 0.2) * 0.0 + random_factor(seed, 0.02e-3, 0.6e-3));
    scene_number(s->scene, "guides[template].thickness", random_chance(seed, 0.7) ? 0.015 : 0.0);
    scene_number(s->scene, "guides[template].friction", random_between(seed, 0, 0.6));
}

static inline random_scene *random_scene_create(uint64_t number) {
    random_scene *s = calloc(1, sizeof *s);
    uint64_t state = 0x9E3779B97F4A7C15u * (number + 1), *seed = &state;
    trocar_error why;
    for (int i = 0; i < 4; i++) random_between(seed, 0, 1);
    if (!s || trocar_scene_create(&s->scene, &why) != TROCAR_OK) abort();
    block_create(&s->block, seed);
    trocar_mesh mesh = block_arrays(&s->block);
    if (trocar_scene_set_mesh(s->scene, &mesh, &why) != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        abort();
    }
    scene_region(s->scene, "a", seed);
    scene_region(s->scene, "b", seed);
    scene_text(s->scene, "fixed", "[bottom]");
    if (random_chance(seed, 0.8)) scene_number(s->scene, "membranes[skin].puncture_force", random_factor(seed, 0.1, 8));
    if (random_chance(seed, 0.5)) scene_number(s->scene, "membranes[capsule].puncture_force", random_factor(seed, 0.1, 2));
    if (random_chance(seed, 0.5)) {
        scene_text(s->scene, "relaxation[0].weight", "0.3");
        scene_number(s->scene, "relaxation[0].time", random_chance(seed, 0.5) ? 0.05 : 0.15);
        scene_text(s->scene, "relaxation[1].weight", "0.3");
        scene_text(s->scene, "relaxation[1].time", "2.5");
    }
    static const char *const strains[] = {"patch", "element", "node"};
    scene_text(s->scene, "volumetric_strain", strains[(int)random_between(seed, 0, 3)]);
    double diameter = random_between(seed, 0.4e-3, 1.3e-3);
    s->length = 0.15;
    s->entry[0] = random_between(seed, -0.015, 0.015), s->entry[1] = random_between(seed, -0.015, 0.015);
    s->guided = random_chance(seed, 0.4);
    s->leaning = !s->guided && random_chance(seed, 0.6);
    s->needles = random_chance(seed, 0.3) ? 3 : 1;
    scene_number(s->scene, "needle.length", s->length);
    scene_number(s->scene, "needle.outer_diameter", diameter);
    scene_number(s->scene, "needle.inner_diameter", random_chance(seed, 0.5) ? 0.6 * diameter : 0.0);
    scene_number(s->scene, "needle.bevel_slope", random_chance(seed, 0.5) ? random_between(seed, 0, 0.15) : 0.0);
    scene_number(s->scene, "needle.segments", random_chance(seed, 0.5) ? 40 : 20);
    scene_number(s->scene, "needles", s->needles);
    if (s->guided) scene_guide(s, seed, diameter);
    return s;
}

static inline void random_scene_free(random_scene *s) {
    if (!s) return;
    trocar_scene_free(s->scene);
    free(s);
}

/* ---- motion ------------------------------------------------------------------------------------------------------------------- */

/* A leg from rest to rest that follows the minimum-jerk polynomial (Flash and Hogan 1985). */
typedef struct {
    double seconds, advance; /* seconds: duration, s; advance: displacement along the needle, m */
    double aside[2];         /* m, displacement of the base across the needle */
    double tilt[2], roll;    /* rad; tilt: rotation of the base about its own origin; roll: rotation about the needle's axis */
} hand_leg;

enum { MOST_LEGS = 24 };
typedef struct {
    trocar_pose start;       /* tip in front of the skin */
    int count;
    hand_leg legs[MOST_LEGS];
} hand_motion;

static inline void quaternion_turn(double q[4], double x, double y, double z) {
    double angle = sqrt(x * x + y * y + z * z), half = angle > 0.0 ? sin(0.5 * angle) / angle : 0.5, r[4] = {cos(0.5 * angle), half * x, half * y, half * z}, p[4];
    p[0] = q[0] * r[0] - q[1] * r[1] - q[2] * r[2] - q[3] * r[3];
    p[1] = q[0] * r[1] + q[1] * r[0] + q[2] * r[3] - q[3] * r[2];
    p[2] = q[0] * r[2] - q[1] * r[3] + q[2] * r[0] + q[3] * r[1];
    p[3] = q[0] * r[3] + q[1] * r[2] - q[2] * r[1] + q[3] * r[0];
    double norm = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3]);
    for (int i = 0; i < 4; i++) q[i] = p[i] / norm;
}

static inline void quaternion_rotate(const double q[4], const double v[3], double out[3]) {
    double t[3] = {2 * (q[2] * v[2] - q[3] * v[1]), 2 * (q[3] * v[0] - q[1] * v[2]), 2 * (q[1] * v[1] - q[2] * v[0])};
    out[0] = v[0] + q[0] * t[0] + q[2] * t[2] - q[3] * t[1];
    out[1] = v[1] + q[0] * t[1] + q[3] * t[0] - q[1] * t[2];
    out[2] = v[2] + q[0] * t[2] + q[1] * t[1] - q[2] * t[0];
}

static inline trocar_pose hand_pose(const hand_leg *leg, const trocar_pose *from, double time) {
    double s = fmin(time / leg->seconds, 1.0), f = s * s * s * (10 - 15 * s + 6 * s * s);
    trocar_pose p = *from;
    const double local[3] = {f * leg->aside[0], f * leg->aside[1], f * leg->advance};
    double moved[3];
    quaternion_rotate(from->orientation, local, moved);
    for (int a = 0; a < 3; a++) p.position[a] += moved[a];
    quaternion_turn(p.orientation, f * leg->tilt[0], f * leg->tilt[1], f * leg->roll);
    return p;
}

static inline void hand_add(hand_motion *m, double speed, hand_leg leg) {
    double way = fmax(fabs(leg.advance), fmax(hypot(leg.aside[0], leg.aside[1]), 0.15 * hypot(leg.tilt[0], leg.tilt[1])));
    leg.seconds = fmax(0.1, 1.875 * fmax(way / speed, fabs(leg.roll) / 6.0));
    if (m->count < MOST_LEGS) m->legs[m->count++] = leg;
}

/* Returns a motion that inserts the needle, moves it sideways, withdraws it, inserts it again along its old track or close to it, and returns to the start.
   `speed` is the speed limit (m/s). */
static inline hand_motion random_motion(const random_scene *s, uint64_t number, double speed) {
    uint64_t state = 0xD1B54A32D192ED03u * (number + 7), *seed = &state;
    hand_motion m = {.start = {.orientation = {1, 0, 0, 0}}};
    for (int i = 0; i < 4; i++) random_between(seed, 0, 1);
    if (s->leaning) quaternion_turn(m.start.orientation, random_between(seed, -0.25, 0.25), random_between(seed, -0.25, 0.25), 0);
    quaternion_turn(m.start.orientation, 0, 0, random_between(seed, -M_PI, M_PI));
    const double axis[3] = {0, 0, 1};
    double along[3], tip[3] = {s->entry[0], s->entry[1], 0}, steer = s->guided ? 0.2 : 1.0;
    quaternion_rotate(m.start.orientation, axis, along);
    for (int a = 0; a < 3; a++) m.start.position[a] = tip[a] - (s->length + 0.002) * along[a];
    for (int insertion = 0; insertion < 2; insertion++) {
        double depth = random_between(seed, 0.005, 0.055);
        hand_add(&m, speed * random_between(seed, 0.3, 1), (hand_leg){.advance = 0.002 + depth});
        int moves = (int)random_between(seed, 0, 4);
        for (int i = 0; i < moves; i++) {
            hand_leg leg = {0};
            if (random_chance(seed, 0.7)) leg.advance = fmax(fmin(random_between(seed, -0.02, 0.03), 0.06 - depth), -0.9 * depth);
            if (random_chance(seed, 0.5)) leg.aside[0] = steer * random_between(seed, -0.004, 0.004), leg.aside[1] = steer * random_between(seed, -0.004, 0.004);
            if (random_chance(seed, 0.4)) leg.roll = random_between(seed, -M_PI, M_PI);
            if (random_chance(seed, 0.3)) leg.tilt[0] = steer * random_between(seed, -0.03, 0.03), leg.tilt[1] = steer * random_between(seed, -0.03, 0.03);
            depth += leg.advance;
            hand_add(&m, speed * random_between(seed, 0.3, 1), leg);
        }
        hand_add(&m, speed * random_between(seed, 0.3, 1), (hand_leg){.advance = -depth - 0.006});
        hand_leg back = {.advance = 0.004};
        if (insertion == 0 && random_chance(seed, 0.4)) back.aside[0] = steer * random_between(seed, -0.004, 0.004);
        hand_add(&m, speed, back);
    }
    return m;
}

/* Returns the pose in the last leg of a closed motion, from the current base pose back to the start. */
static inline trocar_pose pose_towards(const trocar_pose *a, const trocar_pose *b, double f) {
    trocar_pose p;
    double norm = 0.0, sign = 0.0;
    for (int i = 0; i < 3; i++) p.position[i] = (1 - f) * a->position[i] + f * b->position[i];
    for (int i = 0; i < 4; i++) sign += a->orientation[i] * b->orientation[i];
    for (int i = 0; i < 4; i++) p.orientation[i] = (1 - f) * a->orientation[i] + (sign < 0 ? -f : f) * b->orientation[i], norm += p.orientation[i] * p.orientation[i];
    for (int i = 0; i < 4; i++) p.orientation[i] /= sqrt(norm);
    return p;
}

/* ---- judging ------------------------------------------------------------------------------------------------------------------ */

static inline double length3(const double v[3]) { return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]); }

static inline double distance3(const double a[3], const double b[3]) { return length3((const double[]){a[0] - b[0], a[1] - b[1], a[2] - b[2]}); }

static inline void fail_if(trocar_status status, const trocar_error *why) {
    if (status == TROCAR_OK) return;
    fprintf(stderr, "%s\n", why->text);
    abort();
}

/* Returns the hand's work (J) from one pose to the next, by the trapezoidal rule. `force` and `torque` are the loads on the hand before and after the step. */
static inline double hand_work(const trocar_pose *a, const double force_a[3], const double torque_a[3], const trocar_pose *b, const double force_b[3], const double torque_b[3]) {
    double sum = 0.0, turn[3], sign = 0.0;
    for (int i = 0; i < 4; i++) sign += a->orientation[i] * b->orientation[i];
    const double *p = a->orientation, *q = b->orientation; /* vector part of the quaternion q p* */
    turn[0] = -q[0] * p[1] + q[1] * p[0] - q[2] * p[3] + q[3] * p[2];
    turn[1] = -q[0] * p[2] + q[2] * p[0] - q[3] * p[1] + q[1] * p[3];
    turn[2] = -q[0] * p[3] + q[3] * p[0] - q[1] * p[2] + q[2] * p[1];
    for (int i = 0; i < 3; i++) {
        sum -= 0.5 * (force_a[i] + force_b[i]) * (b->position[i] - a->position[i]);
        sum -= 0.5 * (torque_a[i] + torque_b[i]) * (sign < 0 ? -2.0 : 2.0) * turn[i];
    }
    return sum;
}

#endif

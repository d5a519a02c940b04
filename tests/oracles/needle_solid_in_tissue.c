/* Puts the solid needle in place of the rod in an insertion. The library stores only the centreline of a needle's shape, so the rims of recent shapes are
   stored here and looked up by the centreline. */
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "oracles/needle_solid.h"

enum { SHAPES = 64 };

static struct {
    bool on;
    solid_model model;
    solid_state shapes[SHAPES];
    int last;
    solid_tangent tangent;   /* tangent stiffness of the last linearisation */
    const needle_tangent *of; /* the library's tangent that `tangent` replaces */
} s;

void __real_needle_set_straight(const needle_model *model, pose base, needle_state *state);
void __wrap_needle_set_straight(const needle_model *model, pose base, needle_state *state);
void __real_needle_move_base(const needle_model *model, pose base, needle_state *state);
void __wrap_needle_move_base(const needle_model *model, pose base, needle_state *state);
void __real_needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent);
void __wrap_needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent);
double __real_needle_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state);
double __wrap_needle_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state);
void __real_needle_motion_of(const needle_model *model, const needle_state *before, const needle_state *after, double dt, needle_motion *motion);
void __wrap_needle_motion_of(const needle_model *model, const needle_state *before, const needle_state *after, double dt, needle_motion *motion);
vec3 __real_needle_root_moment(const needle_model *model, const needle_state *state);
vec3 __wrap_needle_root_moment(const needle_model *model, const needle_state *state);
double __real_needle_energy(const needle_model *model, const needle_state *state);
double __wrap_needle_energy(const needle_model *model, const needle_state *state);

void solid_in_tissue(const needle_parameters *given) {
    trocar_error why;
    s.on = given;
    if (!given || solid_create(given, &s.model, &why) == TROCAR_OK) return;
    fprintf(stderr, "%s\n", why.text);
    abort();
}

static bool same_line(const needle_state *a, const needle_state *b) {
    size_t n = (size_t)s.model.line.given.segments;
    return memcmp(&a->base, &b->base, sizeof a->base) == 0 && memcmp(a->joints, b->joints, (n + 1) * sizeof *a->joints) == 0
        && memcmp(a->frames, b->frames, n * sizeof *a->frames) == 0;
}

static const solid_state *shape_of(const needle_state *line) {
    for (int i = 0; i < SHAPES; i++) {
        const solid_state *shape = &s.shapes[(s.last + SHAPES - i) % SHAPES];
        if (same_line(&shape->line, line)) return shape;
    }
    fprintf(stderr, "a needle's shape that is none of the last %d\n", SHAPES);
    abort();
}

/* Returns a copy that may be changed and becomes the most recent shape. */
static solid_state *next_shape(const solid_state *from) {
    solid_state *to = &s.shapes[s.last = (s.last + 1) % SHAPES];
    if (from && from != to) *to = *from;
    return to;
}

void __wrap_needle_set_straight(const needle_model *model, pose base, needle_state *state) {
    if (!s.on) {
        __real_needle_set_straight(model, base, state);
        return;
    }
    solid_state *shape = next_shape(NULL);
    solid_rest(&s.model, base, shape);
    *state = shape->line;
}

void __wrap_needle_move_base(const needle_model *model, pose base, needle_state *state) {
    if (!s.on) {
        __real_needle_move_base(model, base, state);
        return;
    }
    solid_state *shape = next_shape(shape_of(state));
    solid_hold(&s.model, base, shape);
    *state = shape->line;
}

void __wrap_needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent) {
    if (!s.on) {
        __real_needle_linearise(model, state, load, first, tangent);
        return;
    }
    solid_linearise(&s.model, shape_of(state), load, first, &s.tangent);
    s.of = tangent;
    tangent->unstable = s.tangent.line.unstable;
    memcpy(tangent->drift, s.tangent.line.drift, sizeof tangent->drift);
    memcpy(tangent->compliance, s.tangent.line.compliance, sizeof tangent->compliance);
}

double __wrap_needle_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state) {
    if (!s.on) return __real_needle_advance(model, tangent, load, state);
    if (tangent != s.of) abort();
    solid_state *shape = next_shape(shape_of(state));
    double turn = solid_advance(&s.model, &s.tangent, load, shape);
    *state = shape->line;
    return turn;
}

/* Makes no prediction for the solid needle. */
void __wrap_needle_motion_of(const needle_model *model, const needle_state *before, const needle_state *after, double dt, needle_motion *motion) {
    if (s.on) motion->time = 0.0;
    else __real_needle_motion_of(model, before, after, dt, motion);
}

vec3 __wrap_needle_root_moment(const needle_model *model, const needle_state *state) {
    return s.on ? solid_root_moment(&s.model, shape_of(state)) : __real_needle_root_moment(model, state);
}

double __wrap_needle_energy(const needle_model *model, const needle_state *state) {
    return s.on ? solid_energy(&s.model, shape_of(state)) : __real_needle_energy(model, state);
}

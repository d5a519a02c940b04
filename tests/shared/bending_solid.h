/* The functions of bending.h for the needle made of tetrahedra. */
#ifndef TROCAR_TESTS_BENDING_SOLID_H
#define TROCAR_TESTS_BENDING_SOLID_H

#include "bending.h"
#include "oracles/needle_solid.h"

static inline solid_model solid_made(int segments) {
    needle_parameters p = gauge18(segments);
    solid_model model;
    trocar_error why;
    if (solid_create(&p, &model, &why) != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        abort();
    }
    return model;
}

static inline vec3 solid_tip_of(const solid_model *model, const solid_state *state) { return state->line.joints[model->line.given.segments]; }

/* Solves for equilibrium under a constant force at the tip by Newton's method, applying the load in increments. */
static inline void solid_bend(const solid_model *model, solid_state *state, vec3 tip_force, solid_tangent *tangent) {
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    int n = model->line.given.segments;
    memset(load, 0, sizeof load);
    for (int step = 1; step <= 20; step++) {
        load[n] = v3_scale(step / 20.0, tip_force);
        for (int pass = 0; pass < 50; pass++) {
            solid_linearise(model, state, load, n, tangent);
            if (solid_advance(model, tangent, load, state) < 1e-11) break;
        }
    }
    solid_linearise(model, state, load, 0, tangent);
}

#endif

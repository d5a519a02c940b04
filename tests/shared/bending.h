/* A needle under a dead load at its tip, and the beam theory to compare it with. */
#ifndef TROCAR_TESTS_BENDING_H
#define TROCAR_TESTS_BENDING_H

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "needle/needle.h"

static inline needle_parameters gauge18(int segments) {
    return (needle_parameters){.length = 0.2, .outer_diameter = 1.27e-3, .inner_diameter = 0.84e-3, .youngs_modulus = 200e9,
                               .poisson_ratio = 0.3, .segments = segments};
}

static inline needle_model needle_made(int segments) {
    needle_parameters p = gauge18(segments);
    needle_model model;
    trocar_error why;
    if (needle_create(&p, &model, &why) != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        abort();
    }
    return model;
}

static inline vec3 needle_tip_of(const needle_model *model, const needle_state *state) { return state->joints[model->given.segments]; }

/* Solves for equilibrium under a constant force at the tip by Newton's method, applying the load in increments. */
static inline void bend(const needle_model *model, needle_state *state, vec3 tip_force, needle_tangent *tangent) {
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];
    memset(load, 0, sizeof load);
    for (int step = 1; step <= 20; step++) {
        load[model->given.segments] = v3_scale(step / 20.0, tip_force);
        for (int pass = 0; pass < 50; pass++) {
            needle_linearise(model, state, load, model->given.segments, tangent);
            if (needle_advance(model, tangent, load, state) < 1e-11) break;
        }
    }
    needle_linearise(model, state, load, 0, tangent);
}

/* Returns the tip curvature for theta'' = -p cos(theta), integrated from the base by the midpoint rule. It is zero if the curvature at the base is right. */
static inline double elastica_shot(double base_curvature, double p, double *x, double *y) {
    int n = 20000;
    double theta = 0.0, kappa = base_curvature, ds = 1.0 / n;
    *x = *y = 0.0;
    for (int i = 0; i < n; i++) {
        double tm = theta + 0.5 * ds * kappa, km = kappa - 0.5 * ds * p * cos(theta);
        *x += ds * cos(tm);
        *y += ds * sin(tm);
        theta += ds * km;
        kappa -= ds * p * cos(tm);
    }
    return kappa;
}

/* Computes the tip position of a cantilever of length 1 under a transverse dead load p = F L^2 / EI: the elastica, solved by shooting. */
static inline void elastica(double p, double *x, double *y) {
    double low = 0.0, high = 10.0;
    for (int i = 0; i < 100; i++) {
        double middle = 0.5 * (low + high);
        if (elastica_shot(middle, p, x, y) < 0) low = middle; else high = middle;
    }
}

#endif

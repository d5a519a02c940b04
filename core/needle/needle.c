#include "needle/needle.h"

#include "base/lame.h"
#include "needle/needle_kind.h"

trocar_status needle_create(const needle_parameters *given, needle_model *model, report *why) {
    const needle_parameters *g = given;
    if (!(g->length > 0 && g->outer_diameter > 0 && g->youngs_modulus > 0))
        return fail(why, TROCAR_BAD_INPUT, "needle: length, outer_diameter and youngs_modulus must be positive");
    if (!(g->inner_diameter >= 0 && g->inner_diameter < g->outer_diameter))
        return fail(why, TROCAR_BAD_INPUT, "needle: inner_diameter must be at least 0 and below outer_diameter");
    if (g->segments < 2 || g->segments > NEEDLE_MAX_SEGMENTS)
        return fail(why, TROCAR_BAD_INPUT, "needle: segments must be 2 to %d", NEEDLE_MAX_SEGMENTS);
    double area_moment = M_PI / 64.0 * (pow(g->outer_diameter, 4) - pow(g->inner_diameter, 4));
    *model = (needle_model){
        .given = *given,
        .kind = given->kind == NEEDLE_TETRAHEDRA ? &needle_kind_tetrahedra : &needle_kind_rod,
        .segment_length = g->length / g->segments,
        .radius = 0.5 * g->outer_diameter,
        .bending = g->youngs_modulus * area_moment,
        .torsion = shear_modulus(g->youngs_modulus, g->poisson_ratio) * 2.0 * area_moment,
    };
    return model->kind->create(model, why);
}

/* ---- dispatch to the model -------------------------------------------------------------------------------------------------- */

void needle_rest(const needle_model *model, pose base, needle_state *state) { model->kind->rest(model, base, state); }

void needle_hold(const needle_model *model, pose base, needle_state *state) { model->kind->hold(model, base, state); }

void needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent) {
    model->kind->linearise(model, state, load, first, tangent);
}

double needle_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state) {
    return model->kind->advance(model, tangent, load, state);
}

void needle_motion_of(const needle_model *model, const needle_state *before, const needle_state *after, double dt, needle_motion *motion) {
    motion->time = 0.0;
    if (!model->kind->motion) return;
    motion->time = dt;
    model->kind->motion(model, before, after, motion);
}

bool needle_go_on(const needle_model *model, const needle_motion *motion, double dt, needle_state *state) {
    static const double FARTHEST = 2.0; /* times as long as the last step; for longer ones it is no good guess */
    bool known = motion->time > 0.0 && dt <= FARTHEST * motion->time;
    if (known) model->kind->go_on(model, motion, dt / motion->time, state);
    return known;
}

vec3 needle_root_moment(const needle_model *model, const needle_state *state) { return model->kind->root_moment(model, state); }

double needle_energy(const needle_model *model, const needle_state *state) { return model->kind->energy(model, state); }

/* ---- the centreline ------------------------------------------------------------------------------------------------ */

static mat3 frame_along(vec3 tangent, quat frame) {
    vec3 y = q_axis_y(frame);
    vec3 n2 = v3_unit(v3_axpy(-v3_dot(y, tangent), tangent, y));
    return m3_columns(v3_cross(n2, tangent), n2, tangent);
}

needle_point needle_at(const needle_model *model, const needle_state *state, double arc) {
    int n = model->given.segments;
    double s = fmin(fmax(arc / model->segment_length, 0.0), n); /* in segments from the base */
    int joint = (int)floor(s + 0.5);                   /* nearest joint: the middle control point */
    needle_point p;
    vec3 tangent;
    if (joint < 1 || joint > n - 1) {                  /* first and last half segment: straight */
        int k = joint < 1 ? 0 : n - 1;
        double f = s - k;
        p.first = joint < 1 ? 0 : n - 2;
        for (int i = 0; i < 3; i++) p.weights[i] = 0.0;
        p.weights[k - p.first] = 1.0 - f;
        p.weights[k - p.first + 1] = f;
        tangent = q_axis(state->frames[k]);
    } else {
        double f = s + 0.5 - joint;                    /* 0..1 from the middle of one segment to that of the next */
        p.first = joint - 1;
        p.weights[0] = 0.5 * (1.0 - f) * (1.0 - f);
        p.weights[1] = 0.5 + f - f * f;
        p.weights[2] = 0.5 * f * f;
        tangent = v3_unit(v3_add(v3_scale(1.0 - f, q_axis(state->frames[joint - 1])), v3_scale(f, q_axis(state->frames[joint]))));
    }
    p.position = v3(0, 0, 0);
    for (int i = 0; i < 3; i++) p.position = v3_axpy(p.weights[i], state->joints[p.first + i], p.position);
    p.frame = frame_along(tangent, state->frames[joint < n ? joint : n - 1]);
    return p;
}

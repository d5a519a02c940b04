#include "needle/needle.h"

#include "base/lame.h"
#include "base/row_matrix.h"
#include "base/vec_lanes.h"
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

/* The tangent turns from that of one segment to that of the other, and is so far on its way (0 to 1). */
typedef struct {
    int before, after;
    double fraction;
} tangent_turn;

/* Finds the weights of the three joints at a place. */
static tangent_turn weigh_joints(const needle_model *model, double arc, needle_point *p) {
    int n = model->given.segments;
    double s = arc / model->segment_length; /* in segments from the base */
    s = smaller_of(larger_of(s, 0.0), n);
    int joint = (int)(s + 0.5);                        /* nearest joint: the middle control point */
    if (joint < 1 || joint > n - 1) {                  /* first and last half segment: straight */
        int k = joint < 1 ? 0 : n - 1;
        p->first = joint < 1 ? 0 : n - 2;
        for (int i = 0; i < NEEDLE_POINT_JOINTS; i++) p->weights[i] = 0.0;
        p->weights[k - p->first] = 1.0 - (s - k);
        p->weights[k - p->first + 1] = s - k;
        return (tangent_turn){k, k, 0.0};
    }
    double f = s + 0.5 - joint;                        /* from the middle of one segment to that of the next */
    p->first = joint - 1;
    p->weights[0] = 0.5 * (1.0 - f) * (1.0 - f);
    p->weights[1] = 0.5 + f - f * f;
    p->weights[2] = 0.5 * f * f;
    return (tangent_turn){joint - 1, joint, f};
}

/* The points' frames, from their axes. */
static void put_frames(needle_point *const *points, int count, vec3_lanes n1, vec3_lanes n2, vec3_lanes n3) {
    lanes x[LANES] = {n1.x, n2.x, n3.x, n3.x}, y[LANES] = {n1.y, n2.y, n3.y, n3.y}, z[LANES] = {n1.z, n2.z, n3.z, n3.z};
    lanes_transpose(&x[0], &x[1], &x[2], &x[3]);
    lanes_transpose(&y[0], &y[1], &y[2], &y[3]);
    lanes_transpose(&z[0], &z[1], &z[2], &z[3]);
    for (int i = 0; i < count; i++) points[i]->frame = matrix_of((row_matrix){{x[i], y[i], z[i]}});
}

static void locate_four(const needle_model *model, const needle_state *state, int count, const double *arcs, needle_point *const *points) {
    int before[LANES], after[LANES];
    double fractions[LANES];
    for (int i = 0; i < LANES; i++) {
        needle_point *p = points[i < count ? i : 0];
        tangent_turn turn = weigh_joints(model, arcs[i < count ? i : 0], p);
        before[i] = turn.before, after[i] = turn.after, fractions[i] = turn.fraction;
        const vec3 *joints = &state->joints[p->first];
        p->position = v3_axpy(p->weights[2], joints[2], v3_axpy(p->weights[1], joints[1], v3_scale(p->weights[0], joints[0])));
    }
    lanes fraction = lanes_load(fractions);
    quat_lanes here = ql_gather(state->frames, before), next = ql_gather(state->frames, after);
    vec3_lanes y = ql_axis_y(next), n3 = v3l_unit(v3l_axpy(fraction, ql_axis(next), v3l_scale(1.0 - fraction, ql_axis(here))));
    vec3_lanes n2 = v3l_unit(v3l_axpy(-v3l_dot(y, n3), n3, y));
    put_frames(points, count, v3l_cross(n2, n3), n2, n3);
}

void needle_locate(const needle_model *model, const needle_state *state, int count, const double *arcs, needle_point *const *points) {
    for (int i = 0; i < count; i += LANES) locate_four(model, state, count - i < LANES ? count - i : LANES, &arcs[i], &points[i]);
}

needle_point needle_at(const needle_model *model, const needle_state *state, double arc) {
    needle_point p, *point = &p;
    locate_four(model, state, 1, &arc, &point);
    return p;
}

#include "needle/needle.h"

#include "base/lame.h"
#include "needle/centreline_kernels.h"
#include "needle/rod_kernels.h"

static const double MOST_BOW = 0.01; /* needle lengths: maximum bow that a scene may specify. A needle with a larger bow would look bent, and the distance from
                                        base to tip would be shorter than its length. Chosen by judgement */
static const double FARTHEST = 2.0; /* ratio: the shape is not extrapolated over a step longer than this multiple of the previous one. Chosen by judgement */

/* Returns the slope (m/m) of a segment of the unloaded needle, given the bow y = bow L (1 - cos(2 pi s / L)) / 2. At the base and the tip, the needle is on its
   axis and parallel to it. */
static double natural_slope(const needle_parameters *given, int segment) {
    int last = given->segments - 1;
    return M_PI * given->bow * sin(2.0 * M_PI * segment / last);
}

trocar_status needle_create(const needle_parameters *given, needle_model *model, trocar_error *why) {
    const needle_parameters *g = given;
    if (!(g->length > 0 && g->outer_diameter > 0 && g->youngs_modulus > 0))
        return fail(why, TROCAR_BAD_INPUT, "needle: length, outer_diameter and youngs_modulus must be positive");
    if (!(g->inner_diameter >= 0 && g->inner_diameter < g->outer_diameter))
        return fail(why, TROCAR_BAD_INPUT, "needle: inner_diameter must be at least 0 and below outer_diameter");
    if (!(g->bow >= 0 && g->bow <= MOST_BOW)) return fail(why, TROCAR_BAD_INPUT, "needle: bow must be 0 to %g of the length", MOST_BOW);
    if (g->segments < 2 || g->segments > NEEDLE_MAX_SEGMENTS)
        return fail(why, TROCAR_BAD_INPUT, "needle: segments must be 2 to %d", NEEDLE_MAX_SEGMENTS);
    double area_moment = M_PI / 64.0 * (pow(g->outer_diameter, 4) - pow(g->inner_diameter, 4));
    *model = (needle_model){
        .given = *given,
        .segment_length = g->length / g->segments,
        .radius = 0.5 * g->outer_diameter,
        .bending = g->youngs_modulus * area_moment,
        .torsion = shear_modulus(g->youngs_modulus, g->poisson_ratio) * 2.0 * area_moment,
    };
    for (int k = 1; k < g->segments; k++) model->natural[k] = natural_slope(g, k - 1) - natural_slope(g, k);
    return TROCAR_OK;
}

/* ---- the rod ------------------------------------------------------------------------------------------------------------- */

void needle_set_straight(const needle_model *model, pose base, needle_state *state) {
    int n = model->given.segments;
    rod_frames of;
    quat frame = base.orientation;
    state->base = base;
    for (int k = 0; k < n + ROD_STEP; k++) *rod_frame(&of, k) = frame = k < n ? q_multiply(frame, q_exp(v3(model->natural[k], 0, 0))) : frame;
    rod_set_frames(model, &of, state);
}

/* No load twists the rod, so when the base turns about the needle's axis, every segment turns about its own axis by the same angle. */
void needle_move_base(const needle_model *model, pose base, needle_state *state) {
    double roll = q_roll_between(state->base.orientation, base.orientation);
    quat turn = q_exp(v3(0, 0, roll));
    rod_frames of;
    state->base = base;
    rod_copy_frames(model->given.segments, state, &of);
    for (int k = 0; k < model->given.segments && roll != 0.0; k++) *rod_frame(&of, k) = q_unit(q_multiply(*rod_frame(&of, k), turn));
    rod_set_frames(model, &of, state);
}

void needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent) {
    rod_linearise(model, state, load, first, tangent);
}

double needle_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state) {
    return rod_advance(model, tangent, load, state);
}

void needle_motion_of(const needle_model *model, const needle_state *before, const needle_state *after, double dt, needle_motion *motion) {
    motion->time = dt;
    for (int k = 0; k < model->given.segments; k++) motion->turn[k] = q_multiply(after->frames[k], q_conjugate(before->frames[k]));
}

bool needle_extrapolate(const needle_model *model, const needle_motion *motion, double dt, needle_state *state) {
    bool known = motion->time > 0.0 && dt <= FARTHEST * motion->time;
    if (known) rod_extrapolate(model, motion, dt / motion->time, state);
    return known;
}

vec3 needle_root_moment(const needle_model *model, const needle_state *state) { return rod_root_moment(model, state); }

double needle_energy(const needle_model *model, const needle_state *state) {
    double energy = 0.0;
    quat before = state->base.orientation;
    for (int k = 0; k < model->given.segments; k++) {
        vec3 w = q_log(q_multiply(q_conjugate(before), state->frames[k]));
        w.x -= model->natural[k];
        energy += 0.5 / rod_joint_length(model, k) * (model->bending * (w.x * w.x + w.y * w.y) + model->torsion * w.z * w.z);
        before = state->frames[k];
    }
    return energy;
}

/* ---- the centreline ------------------------------------------------------------------------------------------------ */

/* How to obtain a tangent between the middles of two segments: rotate the axis of `before` toward that of `after` by `fraction` (0 to 1) of the angle between
   them. */
typedef struct {
    int before, after;
    double fraction;
} tangent_turn;

/* Finds the three joints that determine the point at `arc` (m), with their weights. Returns how to obtain the tangent there. */
static tangent_turn weigh_joints(const needle_model *model, double arc, needle_point *p) {
    int n = model->given.segments;
    double s = arc / model->segment_length; /* distance from the base, in segments */
    s = smaller_of(larger_of(s, 0.0), n);
    int joint = (int)(s + 0.5);                        /* nearest joint: the middle control point of the spline */
    if (joint < 1 || joint > n - 1) {                  /* the first and last half segments are straight */
        int k = joint < 1 ? 0 : n - 1;
        p->first = joint < 1 ? 0 : n - 2;
        for (int i = 0; i < NEEDLE_POINT_JOINTS; i++) p->weights[i] = 0.0;
        p->weights[k - p->first] = 1.0 - (s - k);
        p->weights[k - p->first + 1] = s - k;
        return (tangent_turn){k, k, 0.0};
    }
    double f = s + 0.5 - joint;                        /* where the point lies between the middles of the two adjacent segments, 0 to 1 */
    p->first = joint - 1;
    p->weights[0] = 0.5 * (1.0 - f) * (1.0 - f);
    p->weights[1] = 0.5 + f - f * f;
    p->weights[2] = 0.5 * f * f;
    return (tangent_turn){joint - 1, joint, f};
}

static void locate_four(const needle_model *model, const needle_state *state, int count, const double *arcs, needle_point *const *points) {
    int before[CENTRELINE_STEP], after[CENTRELINE_STEP];
    double fractions[CENTRELINE_STEP];
    for (int i = 0; i < CENTRELINE_STEP; i++) {
        needle_point *p = points[i < count ? i : 0];
        tangent_turn turn = weigh_joints(model, arcs[i < count ? i : 0], p);
        before[i] = turn.before, after[i] = turn.after, fractions[i] = turn.fraction;
        const vec3 *joints = &state->joints[p->first];
        p->position = v3_axpy(p->weights[2], joints[2], v3_axpy(p->weights[1], joints[1], v3_scale(p->weights[0], joints[0])));
    }
    centreline_frames(state->frames, before, after, fractions, count, points);
}

void needle_locate(const needle_model *model, const needle_state *state, int count, const double *arcs, needle_point *const *points) {
    for (int i = 0; i < count; i += CENTRELINE_STEP) locate_four(model, state, count - i < CENTRELINE_STEP ? count - i : CENTRELINE_STEP, &arcs[i], &points[i]);
}

needle_point needle_at(const needle_model *model, const needle_state *state, double arc) {
    needle_point p, *point = &p;
    locate_four(model, state, 1, &arc, &point);
    return p;
}

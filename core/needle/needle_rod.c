/* The needle as a geometrically exact Kirchhoff rod: a chain of rigid segments with elastic joints between them. */
#include "needle/needle_kind.h"
#include "needle/rod_kernels.h"

static void rod_rest(const needle_model *model, pose base, needle_state *state) {
    int n = model->given.segments;
    rod_frames of;
    quat frame = base.orientation;
    state->base = base;
    for (int k = 0; k < n + ROD_STEP; k++) *rod_frame(&of, k) = frame = k < n ? q_multiply(frame, q_exp(v3(model->natural[k], 0, 0))) : frame;
    rod_set_frames(model, &of, state);
}

/* No load twists the rod, so every segment turns about its own axis by the base's roll. */
static void rod_hold(const needle_model *model, pose base, needle_state *state) {
    double roll = q_roll_between(state->base.orientation, base.orientation);
    quat turn = q_exp(v3(0, 0, roll));
    rod_frames of;
    state->base = base;
    rod_copy_frames(model->given.segments, state, &of);
    for (int k = 0; k < model->given.segments && roll != 0.0; k++) *rod_frame(&of, k) = q_unit(q_multiply(*rod_frame(&of, k), turn));
    rod_set_frames(model, &of, state);
}

static double rod_energy(const needle_model *model, const needle_state *state) {
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

static void rod_motion(const needle_model *model, const needle_state *before, const needle_state *after, needle_motion *motion) {
    for (int k = 0; k < model->given.segments; k++) motion->turn[k] = q_multiply(after->frames[k], q_conjugate(before->frames[k]));
}

static trocar_status rod_create(needle_model *model, report *why) {
    (void)model, (void)why;
    return TROCAR_OK;
}

const needle_kind needle_kind_rod = {rod_create, rod_rest, rod_hold, rod_linearise, rod_motion, rod_go_on, rod_advance,
                                     rod_root_moment, rod_energy};

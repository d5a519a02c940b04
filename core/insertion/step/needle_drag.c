#include "insertion/step/needle_drag.h"

static const double STEEL = 7900.0; /* kg/m^3: density of the needle, which with its stiffness sets the drag on a needle that changes shape. Cited: austenitic
                                       stainless steel (AISI 304), 7900 to 8000 */

/* A bending wave of wavenumber q has inertia rho A, stiffness EI q^4 and drag eta q^2. This choice of eta damps waves of every length critically. */
double needle_drag(const needle_model *model) {
    double outer = model->given.outer_diameter, inner = model->given.inner_diameter;
    double mass = STEEL * 0.25 * M_PI * (outer * outer - inner * inner);
    return 2.0 * sqrt(mass * model->bending);
}

/* Drag against a segment's rotation has the energy d l |t - t_start|^2 / 2. Up to a constant, that is the energy of a tension d along t_start. Tensions along
   the segments act on each joint as the difference between the two adjacent tensions; these forces add up to zero. */
static vec3 drag_at(const tick_input *tick, const needle_response *response, const pass_checkpoint *start, int joint) {
    const vec3 *joints = start->needle.joints;
    vec3 before = joint > 0 ? v3_unit(v3_sub(joints[joint], joints[joint - 1])) : v3(0, 0, 0);
    vec3 after = joint < tick->model->needle->given.segments ? v3_unit(v3_sub(joints[joint + 1], joints[joint])) : v3(0, 0, 0);
    return v3_scale(response->drag, v3_sub(before, after));
}

void drag_add_loads(const tick_input *tick, needle_response *response, const pass_checkpoint *start) {
    if (response->drag == 0.0) return;
    for (int k = 0; k <= tick->model->needle->given.segments; k++) response->load[k] = v3_add(response->load[k], drag_at(tick, response, start, k));
}

void drag_shift_joints(const tick_input *tick, needle_response *response, const pass_checkpoint *start) {
    needle_tangent *tangent = &response->tangent;
    int n = tick->model->needle->given.segments;
    if (response->drag == 0.0) return;
    for (int k = 1; k <= n; k++) {
        vec3 force = drag_at(tick, response, start, k);
        for (int i = 1; i <= n; i++) tangent->drift[i] = v3_add(tangent->drift[i], needle_joint_moved(tangent, i, k, force));
    }
}

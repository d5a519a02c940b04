/* Energy of the needle's twist and of the tissue that the needle turns. See docs/mechanics.md, "Roll". */
#ifndef TROCAR_VERIFICATION_TWIST_H
#define TROCAR_VERIFICATION_TWIST_H

#include "lockstep.h"

/* The shaft's state at a point, after the last solve. */
static inline const roll_friction *twist_at(const lockstep *l, const contact_point *p) {
    return p->kind == POINT_TIP ? &l->state.tip.shaft.roll : &l->state.contacts[p->handle].shaft.roll;
}

/* Returns the instantaneous rotation per unit torque, rad/(N m). A torque per unit length m' rotates the tissue at the shaft by m' / (4 pi mu r^2). */
static inline double twist_yielding(const lockstep *l, const contact_point *p) {
    const insertion_model *model = &l->parts.insertion;
    return 1.0 / (2.0 * pow(model->needle->radius, 2) * shaft_resistance_of(model, &l->state, p->share).axial);
}

/* Returns the needle's twisting energy (J). Each section between two points carries the torques of all points beyond it. */
static inline double twist_energy_of_needle(const lockstep *l) {
    const insertion_workspace *w = l->run.workspace;
    double sum = 0.0, torque = 0.0;
    for (int i = w->points.count - 1; i >= w->points.guided; i--) {
        torque += twist_at(l, &w->points.list[i])->torque;
        sum += torque * torque * (w->points.list[i].arc - (i > w->points.guided ? w->points.list[i - 1].arc : 0.0));
    }
    return 0.5 * sum / l->parts.needle.torsion;
}

/* Returns the energy (J) of the tissue around the shaft under the needle's torques. */
static inline double twist_energy_of_tissue(const lockstep *l) {
    const insertion_workspace *w = l->run.workspace;
    double sum = 0.0;
    for (int i = w->points.guided; i < w->points.count; i++) sum += twist_yielding(l, &w->points.list[i]) * pow(twist_at(l, &w->points.list[i])->torque, 2);
    return 0.5 * sum;
}

#endif

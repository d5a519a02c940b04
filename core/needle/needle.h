/* The needle, clamped at its base: a geometrically exact, inextensible Kirchhoff rod made of rigid segments with elastic joints between them. The base is
   at arc 0, the tip at arc `length`; the axis is local +z. See docs/mechanics.md, "The needle". */
#ifndef TROCAR_NEEDLE_H
#define TROCAR_NEEDLE_H

#include <stdbool.h>

#include "needle/needle_model.h"

/* Checks the parameters and computes the model. BAD_INPUT if a value is out of range. Allocates nothing, so there is nothing to free. */
trocar_status needle_create(const needle_parameters *given, needle_model *model, trocar_error *why);

/* Puts the base at `base` and gives the needle its unloaded shape, which is straight except for the bow. RT */
void needle_set_straight(const needle_model *model, pose base, needle_state *state);

/* Returns where the tip (m) would be if the needle were straight. RT */
static inline vec3 needle_straight_end(const needle_model *model, pose base) { return v3_axpy(model->given.length, q_axis(base.orientation), base.position); }

/* Moves the base and shifts the joints along with it. If the base rotates about the needle's axis, each segment rotates about its own axis by the same angle.
   The segments' directions stay as they are until the next solve. RT */
void needle_move_base(const needle_model *model, pose base, needle_state *state);

/* needle_at returns the point on the centreline at `arc` (m from the base). needle_locate does this for `count` points at once, writing to *points[i]. RT */
needle_point needle_at(const needle_model *model, const needle_state *state, double arc);
void needle_locate(const needle_model *model, const needle_state *state, int count, const double *arcs, needle_point *const *points);

/* Returns the unit tangent at the point, toward the tip. RT */
static inline vec3 needle_along(const needle_point *p) { return m3_column(&p->frame, 2); }

/* Linearises about the current shape under the joint forces `load` (N, segments + 1 entries), which affect the geometric stiffness. Computes the compliance for
   the joints from index `first` on. RT */
void needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent);

/* Returns the displacement (m) of `joint` under `force` (N) at joint `other`. RT */
static inline vec3 needle_joint_moved(const needle_tangent *tangent, int joint, int other, vec3 force) {
    const double f[3] = {force.x, force.y, force.z};
    double moved[3] = {0.0};
    for (int a = 0; a < 3; a++)
        for (int b = 0; b < 3; b++)
            moved[a] += (other > joint ? tangent->compliance[3 * joint + a][3 * other + b] : tangent->compliance[3 * other + b][3 * joint + a]) * f[b];
    return v3(moved[0], moved[1], moved[2]);
}

/* Moves the needle to the linearised equilibrium under `load`. Returns the largest rotation of a segment (rad). RT */
double needle_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state);

/* needle_motion_of computes how the shape changed from `before` to `after`, `dt` seconds later. needle_extrapolate continues that motion for another `dt`
   seconds; it returns false and leaves the shape unchanged if the motion's duration is unknown or less than half of `dt`. RT */
void needle_motion_of(const needle_model *model, const needle_state *before, const needle_state *after, double dt, needle_motion *motion);
bool needle_extrapolate(const needle_model *model, const needle_motion *motion, double dt, needle_state *state);

/* Returns the elastic moment (N m, world frame) at the base in the current shape. In equilibrium it equals the moment of the loads about the base. */
vec3 needle_root_moment(const needle_model *model, const needle_state *state);

double needle_energy(const needle_model *model, const needle_state *state); /* J, elastic energy in bending and torsion */

#endif

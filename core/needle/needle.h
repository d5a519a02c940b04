/* The needle, clamped at its base: a geometrically exact, inextensible Kirchhoff rod made of rigid segments with elastic joints between them. The base is
   at arc 0, the tip at arc `length`; the axis is local +z. See docs/mechanics.md, "The needle". */
#ifndef TROCAR_NEEDLE_H
#define TROCAR_NEEDLE_H

#include <stdbool.h>

#include "needle/needle_model.h"

/* Computes the model from its parameters. BAD_INPUT for values out of range; NO_MEMORY. Nothing needs to be freed. */
trocar_status needle_create(const needle_parameters *given, needle_model *model, trocar_error *why);

/* Gives the needle its unloaded shape, which is straight except for its bow, with its base at `base`. RT */
void needle_set_straight(const needle_model *model, pose base, needle_state *state);

/* Position (m) of the end of a straight needle with this base. RT */
static inline vec3 needle_straight_end(const needle_model *model, pose base) { return v3_axpy(model->given.length, q_axis(base.orientation), base.position); }

/* Moves the base, and the joints with it. Each segment rotates about its own axis by as much as the base rotates about the needle's axis; the directions of
   the axes do not change until the next solve. RT */
void needle_move_base(const needle_model *model, pose base, needle_state *state);

/* needle_at returns the point on the centreline at this arc (m); needle_locate finds several points, *points[0] to *points[count - 1]. RT */
needle_point needle_at(const needle_model *model, const needle_state *state, double arc);
void needle_locate(const needle_model *model, const needle_state *state, int count, const double *arcs, needle_point *const *points);

/* Unit vector along the centreline, toward the tip. RT */
static inline vec3 needle_along(const needle_point *p) { return m3_column(&p->frame, 2); }

/* Linearises about the current shape under the joint forces `load` (N, segments + 1), which determine the geometric stiffness. Computes the compliance
   between the joints with indices >= first. RT */
void needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent);

/* Displacement (m) of a joint under a force (N) at another joint. RT */
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

/* needle_motion_of computes the change in shape from `before` to `after`, which took `dt` seconds. needle_extrapolate extrapolates the shape by `dt` seconds;
   if it cannot, it returns false and leaves the shape unchanged. RT */
void needle_motion_of(const needle_model *model, const needle_state *before, const needle_state *after, double dt, needle_motion *motion);
bool needle_extrapolate(const needle_model *model, const needle_motion *motion, double dt, needle_state *state);

/* Elastic moment (N m, world frame) at the base in the current shape; in equilibrium, it is equal to the moment of the loads. */
vec3 needle_root_moment(const needle_model *model, const needle_state *state);

double needle_energy(const needle_model *model, const needle_state *state); /* J, elastic energy of bending and torsion */

#endif

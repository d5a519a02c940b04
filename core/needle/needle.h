/* The needle, clamped at its base: a geometrically exact, inextensible Kirchhoff rod of rigid segments with elastic joints between them.
   Base = arc 0, tip = arc `length`; axis along local +z. See docs/mechanics.md, "The needle". */
#ifndef TROCAR_NEEDLE_H
#define TROCAR_NEEDLE_H

#include <stdbool.h>

#include "needle/needle_model.h"

/* BAD_INPUT for values out of range, NO_MEMORY. Nothing to free. */
trocar_status needle_create(const needle_parameters *given, needle_model *model, report *why);

/* Sets the needle straight and unloaded, with its base at `base`. RT */
void needle_set_straight(const needle_model *model, pose base, needle_state *state);

/* Where the end of a straight needle with this base is, m. RT */
static inline vec3 needle_straight_end(const needle_model *model, pose base) { return v3_axpy(model->given.length, q_axis(base.orientation), base.position); }

/* Moves the base. The needle moves with it, and each segment turns about its own axis as the base does about its; the axes keep their
   directions until the next solve. RT */
void needle_move_base(const needle_model *model, pose base, needle_state *state);

/* The point of the centreline at a distance from the base along it (m), and those at several, into *points[0] to *points[count - 1]. RT */
needle_point needle_at(const needle_model *model, const needle_state *state, double arc);
void needle_locate(const needle_model *model, const needle_state *state, int count, const double *arcs, needle_point *const *points);

/* Unit vector along the centreline, toward the tip. RT */
static inline vec3 needle_along(const needle_point *p) { return v3(p->frame.m[0][2], p->frame.m[1][2], p->frame.m[2][2]); }

/* Linearises about the current shape under the joint forces `load` (N, segments + 1), which determine the
   geometric stiffness; compliance for joints >= first. RT */
void needle_linearise(const needle_model *model, const needle_state *state, const vec3 *load, int first, needle_tangent *tangent);

/* Moves the needle to the linearised equilibrium under `load`. Returns the largest rotation of a segment, rad. RT */
double needle_advance(const needle_model *model, const needle_tangent *tangent, const vec3 *load, needle_state *state);

/* What has changed the shape from one to the other in `dt` seconds, and a guess at the shape after `dt` more: false, and no change, if there is none. RT */
void needle_motion_of(const needle_model *model, const needle_state *before, const needle_state *after, double dt, needle_motion *motion);
bool needle_extrapolate(const needle_model *model, const needle_motion *motion, double dt, needle_state *state);

/* Elastic moment at the base in the current shape, world frame, N m; in equilibrium equal to the moment of the loads. */
vec3 needle_root_moment(const needle_model *model, const needle_state *state);

double needle_energy(const needle_model *model, const needle_state *state); /* elastic, J */

#endif

/* Reference solution for the needle: Kirchhoff's rod as an ordinary differential equation in arc length, clamped at the origin along +z, under dead forces
   at given arc lengths. It is integrated from the clamp by a fourth-order Runge-Kutta method, and Newton's method adjusts the moment at the root until the
   moment at the tip is zero. Only the vector functions are shared with the core. */
#ifndef TROCAR_VERIFICATION_KIRCHHOFF_H
#define TROCAR_VERIFICATION_KIRCHHOFF_H

#include "base/vec.h"

enum { KIRCHHOFF_STEPS = 2000 };             /* integration steps; forces act at the ends of steps */

typedef struct {
    double length, bending, torsion;         /* m, N m^2 */
    int count;
    int step[4];                             /* the step at which each force acts, 1..KIRCHHOFF_STEPS */
    vec3 force[4];                           /* N */
} kirchhoff_rod;

typedef struct {
    vec3 position, moment;                   /* position: m; moment: N m; both in the world frame */
    quat frame;                              /* its local z axis is the rod's axis */
} kirchhoff_section;

/* Derivatives with respect to arc length: r' = t, m' = -t x n, and the frame rotates with the curvature B^-1 m. */
static inline void kirchhoff_rate(const kirchhoff_rod *rod, const kirchhoff_section *s, vec3 force, vec3 *dr, vec3 *dm, quat *dq) {
    vec3 m = q_rotate(q_conjugate(s->frame), s->moment);
    vec3 curvature = v3(m.x / rod->bending, m.y / rod->bending, m.z / rod->torsion);
    *dr = q_rotate(s->frame, v3(0, 0, 1));
    *dm = v3_scale(-1.0, v3_cross(*dr, force));
    *dq = q_multiply(s->frame, (quat){0, 0.5 * curvature.x, 0.5 * curvature.y, 0.5 * curvature.z});
}

static inline kirchhoff_section kirchhoff_moved(const kirchhoff_section *s, double h, vec3 dr, vec3 dm, quat dq) {
    return (kirchhoff_section){v3_axpy(h, dr, s->position), v3_axpy(h, dm, s->moment),
                               {s->frame.w + h * dq.w, s->frame.x + h * dq.x, s->frame.y + h * dq.y, s->frame.z + h * dq.z}};
}

static inline void kirchhoff_step(const kirchhoff_rod *rod, kirchhoff_section *s, vec3 force, double h) {
    vec3 dr[4], dm[4], r = v3(0, 0, 0), m = v3(0, 0, 0);
    quat dq[4], q = {0};
    for (int k = 0; k < 4; k++) {
        kirchhoff_section at = *s;
        if (k > 0) at = kirchhoff_moved(s, k < 3 ? 0.5 * h : h, dr[k - 1], dm[k - 1], dq[k - 1]);
        kirchhoff_rate(rod, &at, force, &dr[k], &dm[k], &dq[k]);
        double weight = k == 0 || k == 3 ? 1.0 / 6.0 : 1.0 / 3.0;
        r = v3_axpy(weight, dr[k], r);
        m = v3_axpy(weight, dm[k], m);
        q = (quat){q.w + weight * dq[k].w, q.x + weight * dq[k].x, q.y + weight * dq[k].y, q.z + weight * dq[k].z};
    }
    *s = kirchhoff_moved(s, h, r, m, q);
    s->frame = q_unit(s->frame);
}

/* Integrates to the cross-section at the tip, starting from this moment at the root. */
static inline kirchhoff_section kirchhoff_shoot(const kirchhoff_rod *rod, double load, vec3 root_moment) {
    kirchhoff_section s = {v3(0, 0, 0), root_moment, {1, 0, 0, 0}};
    for (int i = 0; i < KIRCHHOFF_STEPS; i++) {
        vec3 beyond = v3(0, 0, 0);
        for (int k = 0; k < rod->count; k++)
            if (rod->step[k] > i) beyond = v3_axpy(load, rod->force[k], beyond);
        kirchhoff_step(rod, &s, beyond, rod->length / KIRCHHOFF_STEPS);
    }
    return s;
}

/* Solves for the tip in equilibrium, applying the load in increments. `root_moment` is the moment (N m) that the clamp exerts on the rod. */
static inline kirchhoff_section kirchhoff_solve(const kirchhoff_rod *rod, vec3 *root_moment) {
    const vec3 axes[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    kirchhoff_section tip = {0};
    *root_moment = v3(0, 0, 0);
    for (int step = 1; step <= 8; step++)
        for (int pass = 0; pass < 6; pass++) {
            double load = step / 8.0, small = 1e-5 * rod->bending / rod->length;
            vec3 column[3];
            tip = kirchhoff_shoot(rod, load, *root_moment);
            for (int a = 0; a < 3; a++) {
                vec3 ahead = kirchhoff_shoot(rod, load, v3_axpy(small, axes[a], *root_moment)).moment;
                vec3 behind = kirchhoff_shoot(rod, load, v3_axpy(-small, axes[a], *root_moment)).moment;
                column[a] = v3_scale(0.5 / small, v3_sub(ahead, behind));
            }
            mat3 jacobian = m3_columns(column[0], column[1], column[2]), inverse = m3_inverse(&jacobian);
            *root_moment = v3_sub(*root_moment, m3_apply(&inverse, tip.moment));
        }
    return kirchhoff_shoot(rod, 1.0, *root_moment);
}

#endif

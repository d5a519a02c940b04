/* The condensed contact problem of one tick: closed gaps sideways, bounded friction along the needle.
   See README.md, "One tick is one convex problem". */
#ifndef TROCAR_CONTACT_H
#define TROCAR_CONTACT_H

#include "remesh.h"

enum { MAX_POINTS = MAX_CONTACTS + 1, CONTACT_LD = 200 }; /* contacts and the tip */

typedef enum { STICK = 0, SLIP_FORWARD = 1, SLIP_BACKWARD = -1 } friction_state;

/* Find the forces (on the tissue, local frames): A force = gap sideways; along the axis
   slip = gap - A force, with force in [lower, upper] where slip = 0, upper + viscosity[1] * slip where slip > 0 and
   lower + viscosity[0] * slip where slip < 0. Unknowns are ordered: 2 n sideways, then n axial. */
typedef struct {
    int count;                           /* n */
    double compliance[3 * MAX_POINTS][CONTACT_LD]; /* A, m/N: lower triangle; destroyed by the solve */
    double gap[3 * MAX_POINTS];          /* m */
    double lower[MAX_POINTS], upper[MAX_POINTS];   /* N, lower <= upper; may be infinite */
    double viscosity[MAX_POINTS][2];     /* N/m (viscous friction over the tick), >= 0: backward, forward */
    friction_state state[MAX_POINTS];    /* in: warm start; out: solution */
    double force[3 * MAX_POINTS];        /* N, out */
    double slip[MAX_POINTS];             /* m, out: how far the needle slid forward past the tissue in this tick */
    double scale[MAX_POINTS];            /* m/N, size of each contact's own sideways compliance (scratch) */
    int switches;                        /* out: changes of the active set */
} contact_problem;

/* Exact solution by pivoting; the axial part stays positive definite as long as needle and tissue together are
   stable. Returns NUMERIC (forces zero) otherwise. Allocates nothing. RT */
trocar_status contact_solve(contact_problem *p);

#endif

/* The condensed contact problem of one tick: closed gaps sideways, bounded friction along the needle.
   See README.md, "One tick is one convex problem". */
#ifndef TROCAR_CONTACT_H
#define TROCAR_CONTACT_H

#include "insertion/elimination.h"
#include "insertion/guide.h"
#include "remesh/refinement.h"

enum { MAX_POINTS = MAX_GUIDE_POINTS + MAX_CONTACTS + 1, MAX_AXIAL = MAX_POINTS + 1, MAX_UNKNOWNS = 2 * MAX_POINTS + MAX_AXIAL, CONTACT_LD = MOST_COLUMNS,
       MAX_PAIRS = MAX_POINTS + PANEL_ROWS / 2 - 1 /* whole panels of sideways unknowns */ };
_Static_assert(CONTACT_LD >= ELIMINATION_SIZE(MAX_UNKNOWNS), "a row holds all unknowns, its gap and padding");

typedef enum { STICK = 0, SLIP_FORWARD = 1, SLIP_BACKWARD = -1 } friction_state;

/* Find the forces (on the tissue, local frames): A force = gap sideways; along the axis
   slip = gap - A force, with force in [lower, upper] where slip = 0, upper + viscosity[1] * slip where slip > 0 and
   lower + viscosity[0] * slip where slip < 0. Unknowns are ordered: 2 n sideways, then m axial: a point may bear more than one
   force along the needle. */
typedef struct {
    int count, axial_count;              /* n, m: guides, contacts and the tip, at most MAX_POINTS and MAX_AXIAL */
    _Alignas(CACHE_LINE) double compliance[ELIMINATION_SIZE(MAX_UNKNOWNS)][CONTACT_LD]; /* A, m/N: upper triangle; destroyed by the solve */
    double gap[MAX_UNKNOWNS];            /* m */
    double lower[MAX_AXIAL], upper[MAX_AXIAL];     /* N, lower <= upper; may be infinite */
    double viscosity[MAX_AXIAL][2];      /* N/m (viscous friction over the tick), >= 0: backward, forward */
    friction_state state[MAX_AXIAL];     /* in: warm start; out: solution */
    double force[MAX_UNKNOWNS];          /* N, out */
    double slip[MAX_AXIAL];              /* m, out: how far the needle slid forward past the tissue in this tick */
    double scale[MAX_PAIRS];             /* m/N, size of each contact's own sideways compliance (scratch) */
    int switches;                        /* out: changes of the active set */
    int negative;                        /* out: negative eigenvalues of the sideways part of A */
} contact_problem;

/* Index of an unknown: two sideways for each point, then one along the needle for each, then that of the shaft next to the tip. RT */
static inline int unknown(int count, int point, int axis) { return axis < 2 ? 2 * point + axis : 2 * count + point; }

/* Exact solution by pivoting; the axial part stays positive definite as long as needle and tissue together are
   stable. Returns NUMERIC (forces zero) otherwise. Allocates nothing. RT */
trocar_status contact_solve(contact_problem *p);

#endif

/* The condensed contact problem of one tick: closed gaps sideways, bounded friction along the needle.
   See docs/mechanics.md, "One tick is one convex problem". */
#ifndef TROCAR_CONTACT_H
#define TROCAR_CONTACT_H

#include "insertion/state/guide.h"
#include "linalg/elimination.h"
#include "refinement/refinement.h"

enum { MAX_POINTS = MAX_GUIDE_POINTS + MAX_CONTACTS + 1, MAX_AXIAL = MAX_POINTS + 1, MAX_UNKNOWNS = 2 * MAX_POINTS + MAX_AXIAL, CONTACT_LD = MOST_COLUMNS,
       MAX_PAIRS = MAX_POINTS + PANEL_ROWS / 2 - 1 /* whole panels of sideways unknowns */ };
_Static_assert(CONTACT_LD >= ELIMINATION_SIZE(MAX_UNKNOWNS), "a row holds all unknowns, its gap and padding");

/* Of the search for what sticks and what slides, here and for turning (roll.c). */
static const double MARGIN = 1e-12; /* fraction: by which a force may be beyond its bound, of itself and 1 N. Rounding */
enum { ROUNDS_TOGETHER = 10 }; /* rounds: in which all inconsistent points switch at once, before only one does. Effort: two are usual */
enum { ROUNDS_EACH = 4 }; /* rounds: for each point, in which one switches at a time. Effort */

typedef enum { STICK = 0, SLIP_FORWARD = 1, SLIP_BACKWARD = -1 } friction_state;

/* Resistance ahead of one axial unknown as a function of its slip: a staircase that only goes up. From knot k to the next one the force is level[k] +
   slope[k] (slip - at[k]); at a knot it is anything between the end of the piece below and level[k]. Drawn back, the unknown bears the force `back`. */
enum { MAX_KNOTS = 12 };
typedef struct {
    int count;                           /* knots; 0: there is no staircase */
    double at[MAX_KNOTS];                /* m, ascending, at[0] = 0 */
    double level[MAX_KNOTS];             /* N, ascending; INFINITY: impassable */
    double slope[MAX_KNOTS];             /* N/m, >= 0 */
    double back;                         /* N, at most level[0] */
} staircase;

/* Find the forces (on the tissue, local frames): A force = gap sideways; along the axis
   slip = gap - A force, with force in [lower, upper] where slip = 0, upper + viscosity[1] * slip where slip > 0 and
   lower + viscosity[0] * slip where slip < 0. Unknowns are ordered: 2 n sideways, then m axial: a point may bear more than one
   force along the needle. Axial unknown `climber` follows the staircase `ahead` instead: near knot k that is the same law, with slips counted
   from at[k]. */
typedef struct {
    int count, axial_count;              /* n, m: guides, contacts and the tip, at most MAX_POINTS and MAX_AXIAL */
    _Alignas(CACHE_LINE) double compliance[ELIMINATION_SIZE(MAX_UNKNOWNS)][CONTACT_LD]; /* A, m/N: upper triangle; destroyed by the solve */
    double gap[MAX_UNKNOWNS];            /* m */
    double lower[MAX_AXIAL], upper[MAX_AXIAL];     /* N, lower <= upper; may be infinite */
    double viscosity[MAX_AXIAL][2];      /* N/m (viscous friction over the tick), >= 0: backward, forward */
    friction_state state[MAX_AXIAL];     /* in: warm start; out: solution */
    staircase ahead;
    int climber;                         /* axial unknown, the tip; unused if ahead.count is 0 */
    int knot;                            /* that state[climber] refers to. In: warm start; out: solution */
    double force[MAX_UNKNOWNS];          /* N, out */
    double slip[MAX_AXIAL];              /* m, out: how far the needle slid forward past the tissue in this tick */
    double scale[MAX_PAIRS];             /* m/N, size of each contact's own sideways compliance (scratch) */
    int switches;                        /* out: changes of the active set */
    int negative;                        /* out: negative eigenvalues of A without what slides with a constant force */
} contact_problem;

/* Index of an unknown: two sideways for each point, then one along the needle for each, then that of the shaft next to the tip. RT */
static inline int unknown(int count, int point, int axis) { return axis < 2 ? 2 * point + axis : 2 * count + point; }

/* Exact solution by pivoting. There is one, and only one, if needle and tissue together are stable whatever slides: then the Schur complement of the axial
   part is positive definite. A needle far beyond its buckling load may be stable only because it sticks: then one solution is found, and the caller
   compares `negative` with the needle's own unstable modes. Returns NUMERIC (forces zero) if A is singular or the search does not end. Allocates
   nothing. RT */
trocar_status contact_solve(contact_problem *p);

#endif

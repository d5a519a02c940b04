/* The condensed contact problem of one tick: closed gaps across the needle, bounded friction along it. See docs/mechanics.md, "One tick is one convex
   problem". */
#ifndef TROCAR_CONTACT_H
#define TROCAR_CONTACT_H

#include "insertion/state/guide.h"
#include "linalg/elimination.h"
#include "refinement/refinement.h"

enum { MAX_POINTS = MAX_GUIDE_POINTS + MAX_CONTACTS + 1, MAX_AXIAL = MAX_POINTS + 1, MAX_UNKNOWNS = 2 * MAX_POINTS + MAX_AXIAL, CONTACT_LD = MOST_COLUMNS,
       MAX_PAIRS = MAX_POINTS + PANEL_ROWS / 2 - 1 /* whole panels of lateral unknowns */ };
_Static_assert(CONTACT_LD >= ELIMINATION_SIZE(MAX_UNKNOWNS), "a row holds all unknowns, its gap and padding");

/* Limits of the search for sticking and sliding points, used here and for roll (roll.c). */
static const double MARGIN = 1e-12; /* fraction: tolerance of a force's bound, relative to the force plus 1 N. Rounding tolerance */
enum { ROUNDS_TOGETHER = 10 }; /* rounds: number in which all inconsistent points switch at once, before they switch one at a time. Effort limit: two are
                                  usual */
enum { ROUNDS_EACH = 4 }; /* rounds: number per point in which one point switches at a time. Effort limit */

typedef enum { STICK = 0, SLIP_FORWARD = 1, SLIP_BACKWARD = -1 } friction_state;

/* Resistance ahead of one axial unknown as a function of its slip: a monotone staircase. Between knots k and k + 1 the force is level[k] + slope[k] (slip -
   at[k]); at knot k it lies between the end of the piece below and level[k]. The force is `back` when the unknown slides back. */
enum { MAX_KNOTS = 12 };
typedef struct {
    int count;                           /* knots; 0: there is no staircase */
    double at[MAX_KNOTS];                /* m, ascending, at[0] = 0 */
    double level[MAX_KNOTS];             /* N, ascending; INFINITY: impassable */
    double slope[MAX_KNOTS];             /* N/m, >= 0 */
    double back;                         /* N, force when sliding back, at most level[0] */
} staircase;

/* Find the forces on the tissue, in local frames, such that A force = gap across the needle, and along the needle slip = gap - A force, with force in [lower,
   upper] where slip = 0, upper + viscosity[1] * slip where slip > 0 and lower + viscosity[0] * slip where slip < 0. The unknowns are ordered: 2 n lateral,
   then m axial, because a point may bear several forces along the needle. Axial unknown `climber` follows the staircase `ahead` instead: near knot k, the same
   law with slips counted from at[k]. */
typedef struct {
    int count, axial_count;              /* n, m: guides, contacts and the tip, at most MAX_POINTS and MAX_AXIAL */
    _Alignas(CACHE_LINE) double compliance[ELIMINATION_SIZE(MAX_UNKNOWNS)][CONTACT_LD]; /* A, m/N: upper triangle; overwritten by the solve */
    double gap[MAX_UNKNOWNS];            /* m */
    double lower[MAX_AXIAL], upper[MAX_AXIAL];     /* N, lower <= upper; may be infinite */
    double viscosity[MAX_AXIAL][2];      /* N/m (viscous friction over the tick), >= 0: backward, forward */
    friction_state state[MAX_AXIAL];     /* in: warm start; out: solution */
    staircase ahead;
    int climber;                         /* axial unknown of the tip; unused if ahead.count is 0 */
    int knot;                            /* knot to which state[climber] refers. In: warm start; out: solution */
    double force[MAX_UNKNOWNS];          /* N, out */
    double slip[MAX_AXIAL];              /* m, out: slip of the needle forward past the tissue in this tick */
    double scale[MAX_PAIRS];             /* m/N, magnitude of each contact's own lateral compliance (scratch) */
    int switches;                        /* out: changes of the active set */
    int negative;                        /* out: negative eigenvalues of A, without the points that slide at constant force */
} contact_problem;

/* Index of an unknown: two lateral ones for each point, then one axial one for each point, then that of the shaft next to the tip. RT */
static inline int unknown(int count, int point, int axis) { return axis < 2 ? 2 * point + axis : 2 * count + point; }

/* Exact solution by pivoting. The solution is unique if needle and tissue together are stable whichever points slide: then the Schur complement of the axial
   part is positive definite. A needle far beyond its buckling load may be stable only because it sticks: then one of several solutions is found, and the
   caller compares `negative` with the number of the needle's own unstable modes. Returns NUMERIC (forces zero) if A is singular or the search does not end.
   Allocates nothing. RT */
trocar_status contact_solve(contact_problem *p);

#endif

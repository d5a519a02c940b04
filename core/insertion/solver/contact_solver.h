/* The condensed contact problem of one tick: gaps across the needle are closed, and friction along it is bounded. See docs/mechanics.md, "One tick is one
   convex problem". */
#ifndef TROCAR_CONTACT_SOLVER_H
#define TROCAR_CONTACT_SOLVER_H

#include "insertion/model/guide.h"
#include "linalg/elimination.h"
#include "refinement/refinement.h"

enum { MAX_POINTS = MAX_GUIDE_POINTS + MAX_CONTACTS + 1, MAX_AXIAL = MAX_POINTS + 1, MAX_UNKNOWNS = 2 * MAX_POINTS + MAX_AXIAL, CONTACT_LD = MOST_COLUMNS,
       MAX_PAIRS = MAX_POINTS + PANEL_ROWS / 2 - 1 /* whole panels of lateral unknowns */ };
_Static_assert(CONTACT_LD >= ELIMINATION_SIZE(MAX_UNKNOWNS), "a row holds all unknowns, its gap and padding");

/* Limits of the search for sticking and sliding points, used here and for roll (roll.c). */
static const double MARGIN = 1e-12; /* fraction of the force plus 1 N: a force may exceed its bound by this much. Rounding tolerance */
enum { ROUNDS_TOGETHER = 10 }; /* rounds: those in which all inconsistent points switch at once; after that, they switch one at a time. Cost limit: two are usual */
enum { ROUNDS_EACH = 4 }; /* rounds per point: those in which one point switches at a time. Cost limit */

typedef enum { STICK = 0, SLIP_FORWARD = 1, SLIP_BACKWARD = -1 } friction_state;

/* The resistance that one axial unknown meets as a function of its slip: a monotone staircase. Between knots k and k + 1, the force is level[k] + slope[k]
   (slip - at[k]); at knot k, it is anything between the end of the piece below and level[k]. When the unknown slides back, the force is `back`. */
enum { MAX_KNOTS = 12 };
typedef struct {
    int count;                           /* number of knots; 0 if there is no staircase */
    double at[MAX_KNOTS];                /* m, ascending, at[0] = 0 */
    double level[MAX_KNOTS];             /* N, ascending; INFINITY for an obstacle that cannot be passed */
    double slope[MAX_KNOTS];             /* N/m, >= 0 */
    double back;                         /* N, force while sliding back, at most level[0] */
} staircase;

/* The contact problem: find the forces on the tissue, in local frames. Across the needle, A force = gap. Along the needle, slip = gap - A force, and the force
   is in [lower, upper] where slip = 0, upper + viscosity[1] * slip where slip > 0, and lower + viscosity[0] * slip where slip < 0. The 2 n lateral unknowns
   come first, followed by the m axial ones; m can exceed n, because a point may bear several forces along the needle. One axial unknown, `climber`, follows the
   staircase `ahead` instead: near knot k, it obeys the same law, with slips counted from at[k]. */
typedef struct {
    int count, axial_count;              /* count is n, the number of points (guides, contacts and the tip), at most MAX_POINTS; axial_count is m, at most
                                            MAX_AXIAL */
    _Alignas(CACHE_LINE) double compliance[ELIMINATION_SIZE(MAX_UNKNOWNS)][CONTACT_LD]; /* A, m/N: only the upper triangle; overwritten by the solve */
    double gap[MAX_UNKNOWNS];            /* m */
    double lower[MAX_AXIAL], upper[MAX_AXIAL];     /* N, bounds on the axial forces, lower <= upper; may be infinite */
    double viscosity[MAX_AXIAL][2];      /* N/m, >= 0, for sliding backward and forward: viscous friction over the tick */
    friction_state state[MAX_AXIAL];     /* in: warm start; out: solution */
    staircase ahead;
    int climber;                         /* axial unknown at the tip that follows the staircase; unused if ahead.count is 0 */
    int knot;                            /* knot that state[climber] refers to. in: warm start; out: solution */
    double force[MAX_UNKNOWNS];          /* N, out */
    double slip[MAX_AXIAL];              /* m, out: slip of the needle in this tick, positive if it moves forward relative to the tissue */
    double scale[MAX_PAIRS];             /* m/N, scratch: magnitude of each contact's own lateral compliance */
    int switches;                        /* out: how often the active set changed */
    int negative;                        /* out: number of negative eigenvalues of A restricted to unknowns that do not slide at constant force */
} contact_problem;

/* Returns the index of an unknown. First come two lateral unknowns per point, then one axial unknown per point, then that of the shaft next to the tip. RT */
static inline int unknown(int count, int point, int axis) { return axis < 2 ? 2 * point + axis : 2 * count + point; }
static inline int point_of_unknown(int count, int u) { return u < 2 * count ? u / 2 : u - 2 * count < count ? u - 2 * count : count - 1; }
static inline int axis_of_unknown(int count, int u) { return u < 2 * count ? u % 2 : 2; }
static inline int unknown_count(const contact_problem *p) { return 2 * p->count + p->axial_count; }

/* Reads the compliance (m/N) between two unknowns from the upper triangle. RT */
static inline double compliance_of(const contact_problem *p, int i, int j) { return i <= j ? p->compliance[i][j] : p->compliance[j][i]; }

/* Solves exactly by pivoting. The solution is unique if needle and tissue together are stable whichever points slide, because the Schur complement of the axial
   part is then positive definite. A needle far beyond its buckling load may be stable only because it sticks. This then finds one of several solutions, and the
   caller has to compare `negative` with the number of the needle's own unstable modes. Returns NUMERIC, with zero forces, if A is singular or the search does
   not terminate. Does not allocate memory. RT */
trocar_status contact_solve(contact_problem *p);

#endif

#include "insertion/solver/contact_solver.h"

#include <math.h>
#include <string.h>

#include "linalg/rows.h"

static const double LEAST_PIVOT = 1e-8; /* fraction of the contact's own lateral compliance: smallest magnitude of a pivot. Rounding: about the square root of
                                           the machine epsilon, so that the elimination keeps half of its digits */

/* Principal directions of one contact's lateral block [p q; q r]. Rotating by the angle with cosine c and sine s makes it diagonal. Two scalar pivots stay
   accurate even if their magnitudes differ greatly; the inverse of the block would not. */
typedef struct { double c, s, pivot[2]; } principal;

/* A pivot may be negative: needle and tissue together can be stable even if the needle alone would buckle. Near a change of sign, the pivot's magnitude is kept
   above a compliance that is far too small to be felt, but large enough for the elimination to keep half of its digits. */
static double off_zero(double pivot, double least) { return fabs(pivot) < least ? copysign(least, pivot) : pivot; }

static principal diagonalise(double p, double q, double r, double scale) {
    double least = LEAST_PIVOT * scale, half = 0.5 * (r - p), root = sqrt(half * half + q * q), sum = fabs(half) + root;
    bool diagonal = root == 0.0; /* otherwise, take the smaller of the two Jacobi rotations, with tangent t */
    double t = diagonal ? 0.0 : q / copysign(sum, half), c = diagonal ? 1.0 : sqrt(0.5 * sum / root);
    return (principal){c, t * c, {off_zero(p - t * q, least), off_zero(r + t * q, least)}};
}

static void turn(principal by, double *x, double *y) {
    double first = by.c * *x - by.s * *y;
    *y = by.s * *x + by.c * *y;
    *x = first;
}

static symmetric_system system_of(contact_problem *p) { return (symmetric_system){p->compliance, unknown_count(p)}; }

/* Eliminates the lateral unknowns, using the principal directions of each contact. The axial rows become the Schur complement: compliance and gap along the
   needle with all lateral gaps closed. The lateral rows keep the factors for close_sideways(). */
static void eliminate_sideways(contact_problem *p, principal axes[MAX_PAIRS]) {
    elimination_kernel *eliminate_after_panel = elimination_kernel_here();
    symmetric_system s = system_of(p);
    elimination_panel panel;
    elimination_begin(&s);
    for (int i = 0; i < s.order; i++) p->compliance[i][s.order] = p->gap[i];
    for (panel.end = 0; next_panel(&s, &panel, 2 * p->count);) {
        IN_REGISTERS for (int k = 0; k < PANEL_ROWS; k += 2) {
            int pair = (panel.begin + k) / 2;
            principal *own = &axes[pair];
            *own = diagonalise(panel.block[k][k], panel.block[k][k + 1], panel.block[k + 1][k + 1], p->scale[pair]);
            const double inverse[2] = {1.0 / own->pivot[0], 1.0 / own->pivot[1]};
            p->negative += (inverse[0] < 0.0) + (inverse[1] < 0.0);
            turn_in_block(&panel, k, own->c, own->s);
            eliminate_in_block(&panel, k, 2, inverse);
        }
        eliminate_after_panel(&s, &panel);
    }
    for (int i = 2 * p->count; i < s.order; i++) p->gap[i] = p->compliance[i][s.order];
}

/* Returns the axial compliance after the elimination, as an upper triangle. */
static symmetric_system axial_system(contact_problem *p) {
    return (symmetric_system){(double (*)[CONTACT_LD])&p->compliance[2 * p->count][2 * p->count], p->axial_count};
}

/* Computes the slips (m) of the axial unknowns for the current forces. */
static void find_slips(contact_problem *p, double slip[MAX_AXIAL]) {
    symmetric_system s = axial_system(p);
    double force[MAX_AXIAL + PADDING] = {0}, sum[MAX_AXIAL + PADDING];
    memcpy(force, p->force + 2 * p->count, (size_t)s.order * sizeof *force);
    symmetric_multiply(&s, force, sum);
    for (int i = 0; i < s.order; i++) slip[i] = p->gap[2 * p->count + i] - sum[i];
}

/* Solves for the right-hand side, stores the solution in x and counts the negative eigenvalues, which are as many as the negative pivots. Returns false if the
   system is singular. */
static bool solve_symmetric(const symmetric_system *s, double x[MAX_AXIAL + PADDING], int *negative) {
    elimination_kernel *eliminate_after_panel = elimination_kernel_here();
    elimination_panel panel;
    elimination_begin(s);
    *negative = 0;
    for (panel.end = 0; next_panel(s, &panel, s->order);) {
        IN_REGISTERS for (int k = 0; k < PANEL_ROWS; k++) {
            double pivot = panel.block[k][k], inverse = 1.0 / pivot;
            if (!(fabs(inverse) < INFINITY)) return false;
            *negative += pivot < 0.0;
            eliminate_in_block(&panel, k, 1, &inverse);
        }
        eliminate_after_panel(s, &panel);
    }
    memset(x + s->order, 0, PADDING * sizeof *x);
    for (int begin = panel_of(s->order - 1); begin >= 0; begin -= PANEL_ROWS) {
        int end = begin + PANEL_ROWS < s->order ? begin + PANEL_ROWS : s->order;
        double side[PANEL_ROWS];
        subtract_known(s, begin, end, x, side);
        IN_REGISTERS for (int k = PANEL_ROWS - 1; k >= 0; k--) {
            if (begin + k >= end) continue;
            x[begin + k] = side[k];
            subtract_known_in_block(s, begin, k, 0, side);
        }
    }
    return true;
}

/* Gives the axial unknown `climber` the law near knot k: the piece of the staircase below it for smaller slips, the piece above it for larger ones. */
static void stand_at_knot(contact_problem *p, int k) {
    const staircase *s = &p->ahead;
    int i = p->climber;
    p->knot = k;
    p->upper[i] = s->level[k];
    p->viscosity[i][1] = s->slope[k];
    p->lower[i] = k > 0 ? s->level[k - 1] + s->slope[k - 1] * (s->at[k] - s->at[k - 1]) : s->back;
    p->viscosity[i][0] = k > 0 ? s->slope[k - 1] : 0.0;
}

/* Returns the slip (m) from which the law of unknown i counts: for the climber, that of its current knot, otherwise 0. */
static double origin(const contact_problem *p, int i) { return p->ahead.count > 0 && i == p->climber ? p->ahead.at[p->knot] : 0.0; }

static double bound(const contact_problem *p, int i) { return p->state[i] == SLIP_FORWARD ? p->upper[i] : p->lower[i]; }
static double viscosity(const contact_problem *p, int i) { return p->viscosity[i][p->state[i] == SLIP_FORWARD]; }

/* Copies the row of the a-th selected unknown from the diagonal on, leaving out the columns of unknowns that are not selected. `count`: number of selected
   unknowns; `all`: number of all unknowns. */
static void copy_row(const double *row, int all, int count, const int *unknown, int a, double *to) {
    if (count == all) row_copy(row, a, count, to);
    else for (int b = a; b < count; b++) to[b] = row[unknown[b]];
}

/* Solves for the axial forces, given which contacts stick and which slide. */
static bool solve_axial(contact_problem *p, int *negative) {
    int unknown[MAX_AXIAL], count = 0;
    _Alignas(CACHE_LINE) double system[ELIMINATION_SIZE(MAX_AXIAL)][MOST_COLUMNS];
    double slip[MAX_AXIAL], x[MAX_AXIAL + PADDING];
    double *force = p->force + 2 * p->count, (*compliance)[CONTACT_LD] = axial_system(p).a;
    for (int i = 0; i < p->axial_count; i++) {
        bool free_force = p->state[i] == STICK || viscosity(p, i) > 0.0;
        force[i] = free_force ? 0.0 : bound(p, i);
        if (free_force) unknown[count++] = i;
    }
    if (count == p->axial_count) memcpy(slip, p->gap + 2 * p->count, (size_t)count * sizeof *slip);
    else find_slips(p, slip);
    for (int a = 0; a < count; a++) {
        int i = unknown[a];
        slip[i] -= origin(p, i);
        copy_row(compliance[i], p->axial_count, count, unknown, a, system[a]);
        system[a][count] = slip[i];
        if (p->state[i] == STICK) continue;
        double slope = 1.0 / viscosity(p, i);       /* slip = (force - bound) / viscosity */
        system[a][a] += slope;
        system[a][count] += bound(p, i) * slope;
    }
    if (!solve_symmetric(&(symmetric_system){system, count}, x, negative)) return false;
    for (int a = 0; a < count; a++) force[unknown[a]] = x[a];
    return true;
}

/* Returns the state of unknown i that is consistent with the solution: the current one, or the one it must switch to. */
static friction_state consistent_state(contact_problem *p, int i, double slip) {
    double force = p->force[2 * p->count + i], margin = MARGIN * (1.0 + fabs(force));
    if (p->state[i] == STICK) {
        p->slip[i] = origin(p, i);
        if (force > p->upper[i] + margin) return SLIP_FORWARD;
        if (force < p->lower[i] - margin) return SLIP_BACKWARD;
        return STICK;
    }
    p->slip[i] = slip;
    return p->state[i] * (slip - origin(p, i)) < 0.0 ? STICK : p->state[i];
}

/* Returns the knot of unknown i that is consistent with the solution: the next one if the unknown has slid past it, otherwise the current one. */
static int consistent_knot(const contact_problem *p, int i, double slip) {
    int next = p->knot + (int)p->state[i];
    if (p->ahead.count == 0 || i != p->climber || next == p->knot || next < 0 || next >= p->ahead.count) return p->knot;
    return (int)p->state[i] * (slip - p->ahead.at[next]) > 0.0 ? next : p->knot;
}

/* Switches the state of unknown i, or the climber's knot, if it is inconsistent. Returns true if anything switched. */
static bool switch_state(contact_problem *p, int i, double slip, bool may_switch) {
    friction_state next = consistent_state(p, i, slip);
    int knot = consistent_knot(p, i, slip);
    if ((next == p->state[i] && knot == p->knot) || !may_switch) return false;
    if (knot != p->knot) {
        stand_at_knot(p, knot);
        if (p->lower[i] < p->upper[i]) next = STICK; /* it keeps sliding past a knot where the force does not jump */
    }
    p->state[i] = next;
    p->switches++;
    return true;
}

/* Active-set search. All inconsistent contacts switch at once, which usually takes about two rounds. If that cycles, they switch one at a time in least-index
   order, which terminates for positive definite problems (Murty 1974). `negative`: number of negative eigenvalues of the compliance between the points that
   stick or slide with viscosity. */
static bool search_states(contact_problem *p, int *negative) {
    int limit = ROUNDS_TOGETHER + ROUNDS_EACH * (p->axial_count + p->ahead.count);
    double slip[MAX_AXIAL];
    if (p->ahead.count > 0) stand_at_knot(p, p->knot < p->ahead.count ? p->knot : 0);
    for (int i = 0; i < p->axial_count; i++) /* contacts that slid in the last tick but no longer can, such as a tip that has met bone */
        if (isinf(bound(p, i))) p->state[i] = STICK;
    for (int round = 0; round < limit; round++) {
        if (!solve_axial(p, negative)) return false;
        find_slips(p, slip);
        bool consistent = true;
        for (int i = 0; i < p->axial_count; i++)
            if (switch_state(p, i, slip[i], consistent || round < ROUNDS_TOGETHER)) consistent = false;
        if (consistent) return true;
    }
    return false;
}

/* Finds the lateral forces from the axial ones by back substitution. */
static void close_sideways(contact_problem *p, const principal axes[MAX_PAIRS]) {
    symmetric_system s = system_of(p);
    double x[MAX_UNKNOWNS + PADDING] = {0};
    memcpy(x + 2 * p->count, p->force + 2 * p->count, (size_t)p->axial_count * sizeof *x);
    for (int begin = panel_of(2 * p->count - 1); begin >= 0; begin -= PANEL_ROWS) {
        int end = begin + PANEL_ROWS < 2 * p->count ? begin + PANEL_ROWS : 2 * p->count;
        double side[PANEL_ROWS];
        subtract_known(&s, begin, end, x, side);
        IN_REGISTERS for (int k = PANEL_ROWS - 2; k >= 0; k -= 2) {
            if (begin + k >= end) continue;
            principal own = axes[(begin + k) / 2], back = {own.c, -own.s, {0}};
            turn(back, &side[k], &side[k + 1]);
            for (int c = 0; c < 2; c++) {
                x[begin + k + c] = side[k + c];
                subtract_known_in_block(&s, begin, k, c, side);
            }
        }
    }
    memcpy(p->force, x, (size_t)(2 * p->count) * sizeof *x);
}

trocar_status contact_solve(contact_problem *p) {
    int axial = 0;
    p->switches = p->negative = 0;
    memset(p->force, 0, sizeof p->force);
    memset(p->slip, 0, sizeof p->slip);
    principal axes[MAX_PAIRS];
    for (int i = p->count; i < MAX_PAIRS; i++) p->scale[i] = 1.0; /* padding of the last panel */
    for (int i = 0; i < p->count; i++) p->scale[i] = fabs(p->compliance[2 * i][2 * i]) + fabs(p->compliance[2 * i + 1][2 * i + 1]);
    eliminate_sideways(p, axes);
    if (!search_states(p, &axial)) {
        memset(p->force, 0, sizeof p->force);
        return TROCAR_NUMERIC;
    }
    close_sideways(p, axes);
    p->negative += axial;
    return TROCAR_OK;
}

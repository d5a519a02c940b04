#include "insertion/contact.h"

#include <math.h>
#include <string.h>

/* The principal directions of one contact's sideways block [p q; q r]: turned by the angle with cosine c and sine s, it is
   diagonal. Two scalar pivots so far apart as these may become keep their digits; the block's inverse would not. */
typedef struct { double c, s, pivot[2]; } principal;

/* A pivot may be negative (a needle alone may be buckled where needle and tissue together are stable). On its way from
   one sign to the other it is kept off zero by a compliance far below anything that could be felt, and large enough for
   the elimination to keep half of its digits. */
static double off_zero(double pivot, double least) { return fabs(pivot) < least ? copysign(least, pivot) : pivot; }

static principal diagonalise(double p, double q, double r, double scale) {
    double t = 0.0, least = 1e-8 * scale;
    if (q != 0.0) { /* Jacobi's rotation, the smaller angle */
        double cotangent = 0.5 * (r - p) / q; /* of twice the angle */
        t = copysign(1.0, cotangent) / (fabs(cotangent) + sqrt(1.0 + cotangent * cotangent));
    }
    double c = 1.0 / sqrt(1.0 + t * t);
    return (principal){c, t * c, {off_zero(p - t * q, least), off_zero(r + t * q, least)}};
}

static void turn(principal by, double *x, double *y) {
    double first = by.c * *x - by.s * *y;
    *y = by.s * *x + by.c * *y;
    *x = first;
}

static symmetric_system system_of(contact_problem *p) { return (symmetric_system){&p->compliance[0][0], CONTACT_LD, 2 * p->count + p->axial_count}; }

/* Eliminates the sideways unknowns, in the principal directions of each contact. What is left of the axial rows is the Schur complement: the
   compliance and the gap along the needle with all sideways gaps closed. The sideways rows keep the factors for close_sideways(). */
static void eliminate_sideways(contact_problem *p, principal axes[MAX_POINTS]) {
    const elimination_kernels *kernels = elimination_kernels_here();
    symmetric_system s = system_of(p);
    elimination_panel panel;
    elimination_begin(&s);
    for (int i = 0; i < s.order; i++) p->compliance[i][s.order] = p->gap[i];
    for (panel.end = 0; next_panel(&panel, 2 * p->count);) {
        for (int i = panel.begin; i < panel.end; i += 2) {
            const double *row = &p->compliance[i][i];
            principal *own = &axes[i / 2];
            *own = diagonalise(row[0], row[1], row[CONTACT_LD + 1], p->scale[i / 2]);
            const double inverse[2] = {1.0 / own->pivot[0], 1.0 / own->pivot[1]};
            p->negative += (inverse[0] < 0.0) + (inverse[1] < 0.0);
            kernels->turn_rows(&s, i, own->c, own->s);
            kernels->eliminate_in_panel(&s, &panel, i, 2, inverse);
        }
        kernels->eliminate_after_panel(&s, &panel);
    }
    for (int i = 2 * p->count; i < s.order; i++) p->gap[i] = p->compliance[i][s.order];
}

/* Row i of the compliance along the needle, after the elimination: element (i, j >= i) is at j. */
static const double *axial_row(const contact_problem *p, int i) { return &p->compliance[2 * p->count + i][2 * p->count]; }

/* Slips under the present forces, where the needle slides freely, m. */
static void find_slips(const contact_problem *p, double slip[MAX_AXIAL]) {
    const double *force = p->force + 2 * p->count;
    int count = p->axial_count;
    memcpy(slip, p->gap + 2 * p->count, (size_t)count * sizeof *slip);
    for (int i = 0; i < count; i++) {
        const double *row = axial_row(p, i);
        slip[i] -= dot_product(row, force, i, count);
        if (force[i] == 0.0) continue;
        for (int j = i + 1; j < count; j++) slip[j] -= row[j] * force[i];
    }
}

/* Solves for the right-hand side and stores the solution in x; false if the system is not positive definite. */
static bool solve_definite(const symmetric_system *s, double *x) {
    const elimination_kernels *kernels = elimination_kernels_here();
    elimination_panel panel;
    elimination_begin(s);
    for (panel.end = 0; next_panel(&panel, s->order);) {
        for (int i = panel.begin; i < panel.end; i++) {
            double pivot = s->a[i * s->ld + i], inverse = 1.0 / pivot;
            if (!(pivot > 0.0)) return false;
            kernels->eliminate_in_panel(s, &panel, i, 1, &inverse);
        }
        kernels->eliminate_after_panel(s, &panel);
    }
    for (int i = s->order - 1; i >= 0; i--) {
        const double *row = s->a + i * s->ld;
        x[i] = row[s->order] - dot_product(row, x, i + 1, s->order);
    }
    return true;
}

static double bound(const contact_problem *p, int i) { return p->state[i] == SLIP_FORWARD ? p->upper[i] : p->lower[i]; }
static double viscosity(const contact_problem *p, int i) { return p->viscosity[i][p->state[i] == SLIP_FORWARD]; }

/* Axial forces for a given set of sticking and slipping contacts. */
static bool solve_axial(contact_problem *p) {
    int unknown[MAX_AXIAL], count = 0;
    _Alignas(CACHE_LINE) double system[MAX_AXIAL][ELIMINATION_COLUMNS(MAX_AXIAL)];
    double slip[MAX_AXIAL], x[MAX_AXIAL];
    double *force = p->force + 2 * p->count;
    for (int i = 0; i < p->axial_count; i++) {
        bool free_force = p->state[i] == STICK || viscosity(p, i) > 0.0;
        force[i] = free_force ? 0.0 : bound(p, i);
        if (free_force) unknown[count++] = i;
    }
    find_slips(p, slip);
    for (int a = 0; a < count; a++) {
        int i = unknown[a];
        const double *row = axial_row(p, i);
        for (int b = a; b < count; b++) system[a][b] = row[unknown[b]];
        system[a][count] = slip[i];
        if (p->state[i] == STICK) continue;
        system[a][a] += 1.0 / viscosity(p, i);      /* slip = (force - bound) / viscosity */
        system[a][count] += bound(p, i) / viscosity(p, i);
    }
    if (!solve_definite(&(symmetric_system){&system[0][0], ELIMINATION_COLUMNS(MAX_AXIAL), count}, x)) return false;
    for (int a = 0; a < count; a++) force[unknown[a]] = x[a];
    return true;
}

/* The state that contact i should change to, or its own if it is consistent. */
static friction_state consistent_state(contact_problem *p, int i, double slip) {
    double force = p->force[2 * p->count + i], margin = 1e-12 * (1.0 + fabs(force));
    if (p->state[i] == STICK) {
        p->slip[i] = 0.0;
        if (force > p->upper[i] + margin) return SLIP_FORWARD;
        if (force < p->lower[i] - margin) return SLIP_BACKWARD;
        return STICK;
    }
    p->slip[i] = slip;
    return p->state[i] * slip < 0.0 ? STICK : p->state[i];
}

/* Active-set search: all inconsistent contacts switch at once, as a rule twice or so; if that cycles, one at a time in
   least-index order, which is finite for positive definite problems (Murty 1974). */
static bool search_states(contact_problem *p) {
    int together = 10, limit = together + 4 * p->axial_count;
    double slip[MAX_AXIAL];
    for (int i = 0; i < p->axial_count; i++) /* slid up to now, but can't any more: say, the tip has met bone */
        if (isinf(bound(p, i))) p->state[i] = STICK;
    for (int round = 0; round < limit; round++) {
        if (!solve_axial(p)) return false;
        find_slips(p, slip);
        bool consistent = true;
        for (int i = 0; i < p->axial_count; i++) {
            friction_state next = consistent_state(p, i, slip[i]);
            if (next == p->state[i] || (!consistent && round >= together)) continue;
            p->state[i] = next;
            p->switches++;
            consistent = false;
        }
        if (consistent) return true;
    }
    return false;
}

/* Back substitution: sideways forces from the axial ones. */
static void close_sideways(contact_problem *p, const principal axes[MAX_POINTS]) {
    int all = 2 * p->count + p->axial_count;
    for (int i = 2 * p->count - 2; i >= 0; i -= 2) {
        double *force = p->force + i;
        for (int k = 0; k < 2; k++) force[k] = p->compliance[i + k][all] - dot_product(p->compliance[i + k], p->force, i + 2, all);
        principal back = {axes[i / 2].c, -axes[i / 2].s, {0}};
        turn(back, &force[0], &force[1]);
    }
}

trocar_status contact_solve(contact_problem *p) {
    p->switches = p->negative = 0;
    memset(p->force, 0, sizeof p->force);
    memset(p->slip, 0, sizeof p->slip);
    principal axes[MAX_POINTS];
    for (int i = 0; i < p->count; i++) p->scale[i] = fabs(p->compliance[2 * i][2 * i]) + fabs(p->compliance[2 * i + 1][2 * i + 1]);
    eliminate_sideways(p, axes);
    if (!search_states(p)) {
        memset(p->force, 0, sizeof p->force);
        return TROCAR_NUMERIC;
    }
    close_sideways(p, axes);
    return TROCAR_OK;
}

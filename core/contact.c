#include "contact.h"

#include <math.h>
#include <string.h>

/* Gaussian elimination of the sideways unknowns, pivoting among their own rows (the block is indefinite when the needle
   alone is buckled). Leaves the Schur complement, the compliance along the needle with all sideways gaps closed, in the
   axial rows. */
static bool eliminate_sideways(contact_problem *p) {
    int sideways = 2 * p->count, all = 3 * p->count;
    for (int c = 0; c < sideways; c++) {
        int pivot = c;
        for (int i = c + 1; i < sideways; i++)
            if (fabs(p->compliance[i][c]) > fabs(p->compliance[pivot][c])) pivot = i;
        if (p->compliance[pivot][c] == 0.0) return false;
        if (pivot != c) {
            for (int j = c; j < all; j++) {
                double held = p->compliance[c][j];
                p->compliance[c][j] = p->compliance[pivot][j];
                p->compliance[pivot][j] = held;
            }
            double held = p->gap[c];
            p->gap[c] = p->gap[pivot];
            p->gap[pivot] = held;
        }
        const double *restrict from = p->compliance[c];
        double inverse = 1.0 / from[c];
        for (int i = c + 1; i < all; i++) {
            double *restrict row = p->compliance[i];
            double factor = row[c] * inverse;
            for (int j = c + 1; j < all; j++) row[j] -= factor * from[j];
            p->gap[i] -= factor * p->gap[c];
        }
    }
    return true;
}

/* Compliance along the needle, after the elimination. */
static double axial(const contact_problem *p, int i, int j) {
    return i >= j ? p->compliance[2 * p->count + i][2 * p->count + j] : p->compliance[2 * p->count + j][2 * p->count + i];
}

static double slip_at(const contact_problem *p, int i) {
    double slip = p->gap[2 * p->count + i];
    for (int j = 0; j < p->count; j++) slip -= axial(p, i, j) * p->force[2 * p->count + j];
    return slip;
}

/* Cholesky factorisation and solution in place; false if not positive definite. */
static bool solve_definite(int n, double a[MAX_POINTS][MAX_POINTS], double *x) {
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = a[i][j];
            for (int k = 0; k < j; k++) sum -= a[i][k] * a[j][k];
            if (i > j) a[i][j] = sum / a[j][j];
            else if (sum <= 0.0) return false;
            else a[i][i] = sqrt(sum);
        }
        for (int k = 0; k < i; k++) x[i] -= a[i][k] * x[k];
        x[i] /= a[i][i];
    }
    for (int i = n - 1; i >= 0; i--) {
        for (int k = i + 1; k < n; k++) x[i] -= a[k][i] * x[k];
        x[i] /= a[i][i];
    }
    return true;
}

static double bound(const contact_problem *p, int i) { return p->state[i] == SLIP_FORWARD ? p->upper[i] : p->lower[i]; }
static double viscosity(const contact_problem *p, int i) { return p->viscosity[i][p->state[i] == SLIP_FORWARD]; }

/* Axial forces for a given set of sticking and slipping contacts. */
static bool solve_axial(contact_problem *p) {
    int unknown[MAX_POINTS], count = 0;
    double system[MAX_POINTS][MAX_POINTS], x[MAX_POINTS];
    double *force = p->force + 2 * p->count;
    for (int i = 0; i < p->count; i++) {
        bool free_force = p->state[i] == STICK || viscosity(p, i) > 0.0;
        force[i] = free_force ? 0.0 : bound(p, i);
        if (free_force) unknown[count++] = i;
    }
    for (int a = 0; a < count; a++) {
        int i = unknown[a];
        x[a] = slip_at(p, i);
        for (int b = 0; b <= a; b++) system[a][b] = axial(p, i, unknown[b]);
        if (p->state[i] == STICK) continue;
        system[a][a] += 1.0 / viscosity(p, i);      /* slip = (force - bound) / viscosity */
        x[a] += bound(p, i) / viscosity(p, i);
    }
    if (!solve_definite(count, system, x)) return false;
    for (int a = 0; a < count; a++) force[unknown[a]] = x[a];
    return true;
}

/* The state that contact i should change to, or its own if it is consistent. */
static friction_state consistent_state(contact_problem *p, int i) {
    double force = p->force[2 * p->count + i], margin = 1e-12 * (1.0 + fabs(force));
    if (p->state[i] == STICK) {
        p->slip[i] = 0.0;
        if (force > p->upper[i] + margin) return SLIP_FORWARD;
        if (force < p->lower[i] - margin) return SLIP_BACKWARD;
        return STICK;
    }
    p->slip[i] = slip_at(p, i);
    return p->state[i] * p->slip[i] < 0.0 ? STICK : p->state[i];
}

/* Active-set search: all inconsistent contacts switch at once, as a rule twice or so; if that cycles, one at a time in
   least-index order, which is finite for positive definite problems (Murty 1974). */
static bool search_states(contact_problem *p) {
    int together = 10, limit = together + 40 * (p->count + 1);
    for (int round = 0; round < limit; round++) {
        if (!solve_axial(p)) return false;
        bool consistent = true;
        for (int i = 0; i < p->count; i++) {
            friction_state next = consistent_state(p, i);
            if (next == p->state[i] || (!consistent && round >= together)) continue;
            p->state[i] = next;
            p->switches++;
            consistent = false;
        }
        if (consistent) return true;
    }
    return false;
}

static void close_sideways(contact_problem *p) {
    int sideways = 2 * p->count, all = 3 * p->count;
    for (int i = sideways - 1; i >= 0; i--) {
        double sum = p->gap[i];
        for (int j = i + 1; j < all; j++) sum -= p->compliance[i][j] * p->force[j];
        p->force[i] = sum / p->compliance[i][i];
    }
}

trocar_status contact_solve(contact_problem *p) {
    p->switches = 0;
    memset(p->force, 0, sizeof p->force);
    memset(p->slip, 0, sizeof p->slip);
    if (!eliminate_sideways(p) || !search_states(p)) {
        memset(p->force, 0, sizeof p->force);
        return TROCAR_NUMERIC;
    }
    close_sideways(p);
    return TROCAR_OK;
}

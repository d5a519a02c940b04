#include "contact.h"

#include <math.h>
#include <string.h>

/* Solves the 2 x 2 block of one contact's sideways unknowns for two right-hand sides. */
typedef struct { double a, b, c; } block_inverse; /* [a b; b c] */

/* The block may be indefinite (a needle alone may be buckled where needle and tissue together are stable). On its way
   from one sign to the other the eigenvalue nearest to zero is kept off it by a compliance far below anything that could
   be felt, but large enough for the elimination to keep half of its digits. */
static block_inverse invert_block(double p, double q, double r, double scale) {
    double least = 1e-8 * scale, middle = 0.5 * (p + r), spread = sqrt(0.25 * (p - r) * (p - r) + q * q);
    if (fabs(fabs(middle) - spread) < least) { /* moved towards the other eigenvalue, past zero if need be */
        double shift = copysign(2.0 * least, middle);
        p += shift, r += shift;
    }
    double determinant = p * r - q * q;
    return (block_inverse){r / determinant, -q / determinant, p / determinant};
}

/* Block elimination of the sideways unknowns, contact by contact, on the lower triangle. Row by row, what is left of the
   axial rows is the Schur complement: the compliance along the needle with all sideways gaps closed. The sideways rows
   keep the factors for close_sideways(). */
static void eliminate_sideways(contact_problem *p) {
    int sideways = 2 * p->count, all = 3 * p->count;
    double v0[3 * MAX_POINTS], v1[3 * MAX_POINTS];
    for (int c = 0; c < sideways; c += 2) {
        double (*a)[CONTACT_LD] = p->compliance;
        block_inverse inverse = invert_block(a[c][c], a[c + 1][c], a[c + 1][c + 1], p->scale[c / 2]);
        for (int i = c + 2; i < all; i++) v0[i] = a[i][c], v1[i] = a[i][c + 1];
        for (int i = c + 2; i < all; i++) {
            double f0 = inverse.a * v0[i] + inverse.b * v1[i], f1 = inverse.b * v0[i] + inverse.c * v1[i];
            double *restrict row = a[i];
            for (int j = c + 2; j <= i; j++) row[j] -= f0 * v0[j] + f1 * v1[j];
            p->gap[i] -= f0 * p->gap[c] + f1 * p->gap[c + 1];
            row[c] = f0, row[c + 1] = f1;
        }
        double g0 = p->gap[c], g1 = p->gap[c + 1];
        p->gap[c] = inverse.a * g0 + inverse.b * g1;
        p->gap[c + 1] = inverse.b * g0 + inverse.c * g1;
    }
}

/* Compliance along the needle, after the elimination. */
static double axial(const contact_problem *p, int i, int j) {
    int row = 2 * p->count + (i > j ? i : j), column = 2 * p->count + (i > j ? j : i);
    return p->compliance[row][column];
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
    for (int i = 0; i < p->count; i++) /* slid up to now, but can't any more: say, the tip has met bone */
        if (isinf(bound(p, i))) p->state[i] = STICK;
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

/* Back substitution: sideways forces from the axial ones. */
static void close_sideways(contact_problem *p) {
    int all = 3 * p->count;
    memcpy(p->force, p->gap, (size_t)(2 * p->count) * sizeof *p->force);
    for (int i = all - 1; i >= 2; i--) {
        int columns = i < 2 * p->count ? i & ~1 : 2 * p->count;
        for (int j = 0; j < columns; j++) p->force[j] -= p->compliance[i][j] * p->force[i];
    }
}

trocar_status contact_solve(contact_problem *p) {
    p->switches = 0;
    memset(p->force, 0, sizeof p->force);
    memset(p->slip, 0, sizeof p->slip);
    for (int i = 0; i < p->count; i++) p->scale[i] = fabs(p->compliance[2 * i][2 * i]) + fabs(p->compliance[2 * i + 1][2 * i + 1]);
    eliminate_sideways(p);
    if (!search_states(p)) {
        memset(p->force, 0, sizeof p->force);
        return TROCAR_NUMERIC;
    }
    close_sideways(p);
    return TROCAR_OK;
}

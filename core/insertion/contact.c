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

static void turn(const principal *to, double *x, double *y) {
    double first = to->c * *x - to->s * *y;
    *y = to->s * *x + to->c * *y;
    *x = first;
}

/* Block elimination of the sideways unknowns, contact by contact, on the lower triangle. Row by row, what is left of the
   axial rows is the Schur complement: the compliance along the needle with all sideways gaps closed. The sideways rows
   keep the factors for close_sideways(), in principal directions; the diagonal blocks keep the rotations. */
static void eliminate_sideways(contact_problem *p) {
    int sideways = 2 * p->count, all = sideways + p->axial_count;
    double v0[MAX_UNKNOWNS], v1[MAX_UNKNOWNS];
    for (int c = 0; c < sideways; c += 2) {
        double (*a)[CONTACT_LD] = p->compliance;
        principal axes = diagonalise(a[c][c], a[c + 1][c], a[c + 1][c + 1], p->scale[c / 2]);
        double inverse0 = 1.0 / axes.pivot[0], inverse1 = 1.0 / axes.pivot[1];
        p->negative += (inverse0 < 0.0) + (inverse1 < 0.0);
        a[c][c] = axes.c, a[c + 1][c] = axes.s;
        turn(&axes, &p->gap[c], &p->gap[c + 1]);
        for (int i = c + 2; i < all; i++) {
            v0[i] = a[i][c], v1[i] = a[i][c + 1];
            turn(&axes, &v0[i], &v1[i]);
        }
        for (int i = c + 2; i < all; i++) {
            double f0 = inverse0 * v0[i], f1 = inverse1 * v1[i];
            double *restrict row = a[i];
            if (v0[i] == 0.0 && v1[i] == 0.0) { /* not coupled, as to the edge of a hole that is not touched */
                row[c] = row[c + 1] = 0.0;
                continue;
            }
            for (int j = c + 2; j <= i; j++) row[j] -= f0 * v0[j] + f1 * v1[j];
            p->gap[i] -= f0 * p->gap[c] + f1 * p->gap[c + 1];
            row[c] = f0, row[c + 1] = f1;
        }
        p->gap[c] *= inverse0;
        p->gap[c + 1] *= inverse1;
    }
}

/* Compliance along the needle, after the elimination. */
static double axial(const contact_problem *p, int i, int j) {
    int row = 2 * p->count + (i > j ? i : j), column = 2 * p->count + (i > j ? j : i);
    return p->compliance[row][column];
}

static double slip_at(const contact_problem *p, int i) {
    double slip = p->gap[2 * p->count + i];
    for (int j = 0; j < p->axial_count; j++) slip -= axial(p, i, j) * p->force[2 * p->count + j];
    return slip;
}

/* Cholesky factorisation and solution in place; false if not positive definite. */
static bool solve_definite(int n, double a[MAX_AXIAL][MAX_AXIAL], double *x) {
    for (int i = 0; i < n; i++) {
        for (int j = 0; j <= i; j++) {
            double sum = a[i][j];
            for (int k = 0; k < j; k++) sum -= a[i][k] * a[j][k];
            if (i > j) a[i][j] = sum / a[j][j];
            else if (!(sum > 0.0)) return false;
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
    int unknown[MAX_AXIAL], count = 0;
    double system[MAX_AXIAL][MAX_AXIAL], x[MAX_AXIAL];
    double *force = p->force + 2 * p->count;
    for (int i = 0; i < p->axial_count; i++) {
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
    int together = 10, limit = together + 4 * p->axial_count;
    for (int i = 0; i < p->axial_count; i++) /* slid up to now, but can't any more: say, the tip has met bone */
        if (isinf(bound(p, i))) p->state[i] = STICK;
    for (int round = 0; round < limit; round++) {
        if (!solve_axial(p)) return false;
        bool consistent = true;
        for (int i = 0; i < p->axial_count; i++) {
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
    int sideways = 2 * p->count, all = sideways + p->axial_count;
    memcpy(p->force, p->gap, (size_t)sideways * sizeof *p->force);
    for (int i = all - 1; i >= 0; i--) {
        if (i < sideways && i % 2 == 1) { /* both forces of a contact are known: back from its principal directions */
            principal back = {p->compliance[i - 1][i - 1], -p->compliance[i][i - 1], {0}};
            turn(&back, &p->force[i - 1], &p->force[i]);
        }
        int columns = i < sideways ? i & ~1 : sideways;
        for (int j = 0; j < columns; j++) p->force[j] -= p->compliance[i][j] * p->force[i];
    }
}

trocar_status contact_solve(contact_problem *p) {
    p->switches = p->negative = 0;
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

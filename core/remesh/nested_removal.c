/* Removes a contact node on which no later one depends. The node is exchanged with each later node in turn until it is last; then its F S F^T can be
   subtracted. Let X and N be its factor and surplus during the exchanges, and v = sum_touched X^T c_k = y_k for the next node k. Then
       F_k <- F_k - X N v, S_k <- (S_k^-1 + v^T N v)^-1, X <- X + F_k S_k v^T, N <- (N^-1 + v S_k v^T)^-1,
   where the right-hand sides use the values before the exchange. G changes in the same way. For nodes inside elements, v is zero unless the later node depends
   on the removed one. */
#include "remesh/nested.h"

static mat3 product3(const mat3 *a, const mat3 *b, const mat3 *c) {
    mat3 ab = m3_multiply(a, b);
    return m3_multiply(&ab, c);
}

/* Returns (A^-1 + V^T B V)^-1. */
static mat3 inverse_sum(const mat3 *a, const mat3 *v, const mat3 *b) {
    mat3 transposed = m3_transposed(v), sum = m3_inverse(a), more = product3(&transposed, b, v);
    m3_add_scaled(&sum, 1.0, &more);
    return m3_inverse(&sum);
}

/* Subtracts the removed node's contribution to F_k from the G of later nodes, and updates y for these nodes. */
static void exchange_chains(nested_remesher *r, int position, const mat3 *v, const mat3 *n, const mat3 *exchanged, mat3 *y) {
    const int *order = r->shared.refined.order, k = order[position];
    mat3 stiffness = m3_inverse(&r->borders[k].surplus), nv = m3_multiply(n, v), transposed = m3_transposed(&nv);
    for (int i = position + 1; i < r->shared.refined.count; i++) {
        int j = order[i];
        if (!r->borders[j].on_face) continue;
        mat3 *chain = &r->borders[j].chain[k], reached = m3_multiply(&stiffness, chain), lost = m3_multiply(&transposed, &y[j]), gained = m3_multiply(v, chain);
        m3_add_scaled(&reached, -1.0, &lost);
        *chain = m3_multiply(exchanged, &reached);
        m3_add_scaled(&y[j], 1.0, &gained);
    }
}

/* Updates F_k and the removed node's factor X. Both are stored transposed, so this works on rows of F^T, not on columns of F. */
static void exchange_factors(nested_remesher *r, int slot, int k, const mat3 *v, const mat3 *n) {
    column_ranges columns = nested_columns(r, -1);
    mat3 transposed = m3_transposed(v), lost = m3_multiply(n, v), gained = m3_multiply(&r->borders[k].surplus, &transposed);
    double before[3 * NESTED_LD], *x = r->factors[slot][0], *f = r->factors[k][0];
    row_triple less = {before, NESTED_LD, m3_scaled(-1.0, m3_transposed(&lost))}, more = {f, NESTED_LD, m3_transposed(&gained)};
    rows_copy(&columns, x, NESTED_LD, before, NESTED_LD);
    rows_add(&columns, 1, &more, x, NESTED_LD);
    rows_add(&columns, 1, &less, f, NESTED_LD);
}

void nested_move_to_end(nested_remesher *r, int slot, int position) {
    const refinement *refined = &r->shared.refined;
    mat3 *n = &r->borders[slot].surplus, stiffness = m3_inverse(n), y[MAX_CONTACTS];
    for (int i = position; i < refined->count; i++) {
        const bordering *later = &r->borders[refined->order[i]];
        y[refined->order[i]] = later->on_face ? m3_multiply(&stiffness, &later->chain[slot]) : (mat3){{{0}}};
    }
    for (int i = position; i < refined->count; i++) {
        int k = refined->order[i];
        if (!r->borders[k].on_face) continue;
        mat3 v = y[k], transposed = m3_transposed(&v), surplus = inverse_sum(&r->borders[k].surplus, &v, n);
        exchange_chains(r, i, &v, n, &surplus, y);
        exchange_factors(r, slot, k, &v, n);
        *n = inverse_sum(n, &transposed, &r->borders[k].surplus);
        r->borders[k].surplus = surplus;
    }
}

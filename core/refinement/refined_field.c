#include "refinement/refined_field.h"

#include <string.h>

#include "refinement/patch.h"

/* ---- surplus ----------------------------------------------------------------------------------------------------- */

/* In the sub-tetrahedron that replaces corner i, whose volume is w_i V, the gradient of the surplus's hat function is g_i / w_i. */
mat3 surplus_compliance(const tissue *t, const refinement *r, int tet, const leaf_point *at) {
    double youngs_modulus, poisson_ratio;
    element_moduli(t, tet, &youngs_modulus, &poisson_ratio);
    vec3 corners[4], g[4];
    for (int i = 0; i < 4; i++) corners[i] = refinement_position(t->mesh, r, r->count, at->corners[i]);
    double volume = tet_gradients(corners, g);
    mat3 d = {{{0}}};
    for (int i = 0; i < 4; i++) {
        double weight = fmax(at->weights[i], 1e-9); /* avoids a division by zero: on a face, d is infinite and the compliance is zero */
        mat3 k = stiffness_block(g[i], g[i], volume / weight, youngs_modulus, poisson_ratio);
        m3_add_scaled(&d, 1.0, &k);
    }
    return m3_inverse(&d);
}

mat3 node_surplus(const tissue *t, const refinement *r, int position) {
    const added_node *node = &r->nodes[r->order[position]];
    if (!added_on_face(node)) return surplus_compliance(t, r, node->tet, &node->at);
    split_columns columns;
    patch_own_columns(t, r, position, &columns);
    return m3_inverse(&columns.own);
}

/* ---- displacements ------------------------------------------------------------------------------------------------- */

/* Computes the displacements under nodal forces, neglecting the coupling between surpluses and earlier nodes. This is exact if all added nodes are inside
   elements. In the arrays, the nominal nodes come first, then the added ones. `loads`: the equivalent forces on the nominal mesh. */
static void displace_uncoupled(inverse *inv, const refinement *r, const vec3 *force, vec3 *loads, vec3 *u) {
    const tissue *t = inverse_tissue(inv);
    const size_t n = (size_t)t->mesh->node_count;
    memcpy(loads, force, (n + (size_t)r->count) * sizeof *loads);
    for (int q = r->count - 1; q >= 0; q--) /* convert nodal forces to forces on the hierarchical unknowns */
        for (int i = 0; i < 4; i++) {
            int corner = r->nodes[q].at.corners[i];
            vec3 *at = corner >= 0 ? &loads[corner] : &loads[n + (size_t)(-1 - corner)];
            *at = v3_axpy(r->nodes[q].at.weights[i], loads[n + (size_t)q], *at);
        }
    inverse_apply(inv, loads, u);
    for (int q = 0; q < r->count; q++) {
        if (r->nodes[q].moved >= 0) { /* a moved node has no unknown of its own */
            u[n + (size_t)q] = v3(0, 0, 0);
            continue;
        }
        mat3 compliance = node_surplus(t, r, q);
        vec3 sum = m3_apply(&compliance, loads[n + (size_t)q]);
        for (int i = 0; i < 4; i++) {
            int corner = r->nodes[q].at.corners[i];
            sum = v3_axpy(r->nodes[q].at.weights[i], corner >= 0 ? u[corner] : u[n + (size_t)(-1 - corner)], sum);
        }
        u[n + (size_t)q] = sum;
    }
}

/* Adds the forces that the changes in stiffness cause under the displacements u. */
static void add_changes(const tissue *t, const refinement *r, const vec3 *u, vec3 *force) {
    const int n = t->mesh->node_count;
    for (int q = 0; q < r->count; q++) {
        patch p;
        patch_create(t, r, q, &p);
        for (int i = 0; i < 3 * p.count; i++)
            for (int k = 0; k < 3 * p.count; k++) {
                int node = p.nodes[i / 3], other = p.nodes[k / 3];
                (&force[node < 0 ? n - 1 - node : node].x)[i % 3] += p.change[i][k] * (&u[other < 0 ? n - 1 - other : other].x)[k % 3];
            }
    }
}

static double dot(const vec3 *a, const vec3 *b, size_t count) {
    double sum = 0.0;
    for (size_t i = 0; i < count; i++) sum += v3_dot(a[i], b[i]);
    return sum;
}

static void add_multiple(vec3 *to, double factor, const vec3 *what, size_t count) {
    for (size_t i = 0; i < count; i++) to[i] = v3_axpy(factor, what[i], to[i]);
}

/* Solves by conjugate gradients (Hestenes and Stiefel 1952) with displace_uncoupled as preconditioner. The product of the nominal stiffness and a search
   direction need not be computed, because it equals the loads that the preconditioner has returned. On return, `force` holds the residual. */
static void displace_coupled(inverse *inv, const refinement *r, vec3 *force, vec3 *u, vec3 *scratch) {
    enum { MOST = 100 };
    const tissue *t = inverse_tissue(inv);
    const size_t n = (size_t)t->mesh->node_count, all = n + (size_t)r->count;
    vec3 *direction = scratch, *borne = scratch + all, *answer = scratch + 2 * all, *loads = scratch + 3 * all, *resisted = scratch + 4 * all;
    double first = 0.0, before = 0.0;
    memset(u, 0, all * sizeof *u);
    memset(direction, 0, 2 * all * sizeof *direction); /* clears `direction` and `borne` */
    for (int step = 0; step < MOST; step++) {
        for (size_t i = 0; i < n; i++)
            if (t->fixed[i]) force[i] = v3(0, 0, 0);
        displace_uncoupled(inv, r, force, loads, answer);
        double now = dot(force, answer, all), ratio = step > 0 ? now / before : 0.0;
        if (step == 0) first = now;
        if (!(now > 1e-30 * first)) return;
        for (size_t i = 0; i < all; i++) {
            direction[i] = v3_axpy(ratio, direction[i], answer[i]);
            borne[i] = i < n ? v3_axpy(ratio, borne[i], t->fixed[i] ? v3(0, 0, 0) : loads[i]) : v3(0, 0, 0);
        }
        memcpy(resisted, borne, all * sizeof *resisted);
        add_changes(t, r, direction, resisted);
        double length = now / dot(direction, resisted, all);
        add_multiple(u, length, direction, all);
        add_multiple(force, -length, resisted, all);
        before = now;
    }
}

void refined_displacement(inverse *inv, const refinement *r, refined_vectors forces, vec3 *scratch, refined_vectors displacement) {
    const size_t n = (size_t)inverse_tissue(inv)->mesh->node_count, all = n + (size_t)r->count;
    vec3 *force = scratch, *u = scratch + all;
    memcpy(force, forces.nominal, n * sizeof *force);
    memcpy(force + n, forces.added, (size_t)r->count * sizeof *force);
    bool coupled = false;
    for (int q = 0; q < r->count; q++) {
        int moved = r->nodes[q].moved;
        coupled |= moved >= 0 || added_on_face(&r->nodes[q]);
        if (moved < 0) continue;
        force[moved] = v3_add(force[moved], force[n + (size_t)q]);
        force[n + (size_t)q] = v3(0, 0, 0);
    }
    if (coupled) displace_coupled(inv, r, force, u, scratch + 2 * all);
    else displace_uncoupled(inv, r, force, scratch + 2 * all, u);
    memcpy(displacement.nominal, u, n * sizeof *u);
    memcpy(displacement.added, u + n, (size_t)r->count * sizeof *u);
    for (int q = 0; q < r->count; q++)
        if (r->nodes[q].moved >= 0) displacement.added[q] = u[r->nodes[q].moved];
}

#include "refinement.h"

#include <stdlib.h>
#include <string.h>

/* ---- the refined mesh -------------------------------------------------------------------------------------------- */

static const double LEAST_WEIGHT = 0.02;  /* an added node keeps this far inside its leaf: no slivers, no zero volumes */

static leaf_point whole_tet(const mesh *m, int tet, vec3 x) {
    leaf_point p;
    memcpy(p.corners, m->tets[tet], sizeof p.corners);
    mesh_barycentric(m, tet, x, p.weights);
    return p;
}

static bool same_corners(const int a[4], const int b[4]) { return memcmp(a, b, 4 * sizeof *a) == 0; }

/* If added node `index` splits the leaf that p is in, moves p into the child that contains it. With p's weights b and
   the node's weights g, the child is the one opposite the corner of least b/g, and that ratio is the node's weight. */
static void descend(const added_node *node, int index, leaf_point *p) {
    if (!same_corners(node->corners, p->corners)) return;
    int least = 0;
    for (int i = 1; i < 4; i++)
        if (p->weights[i] * node->weights[least] < p->weights[least] * node->weights[i]) least = i;
    double share = p->weights[least] / node->weights[least];
    for (int i = 0; i < 4; i++) p->weights[i] -= share * node->weights[i];
    p->corners[least] = -1 - index;
    p->weights[least] = share;
}

leaf_point refinement_locate(const mesh *m, const refinement *r, int active, int tet, vec3 x) {
    leaf_point p = whole_tet(m, tet, x);
    for (int i = 0; i < active; i++)
        if (r->nodes[i].tet == tet) descend(&r->nodes[i], i, &p);
    return p;
}

static vec3 corner_position(const mesh *m, const refinement *r, int corner) {
    return corner >= 0 ? m->nodes[corner] : r->nodes[-1 - corner].position;
}

int refinement_add(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id) {
    if (r->count >= MAX_CONTACTS + 1) return -1;
    leaf_point p = refinement_locate(m, r, r->count, tet, x);
    added_node *node = &r->nodes[r->count];
    *node = (added_node){.id = id, .tet = tet};
    double sum = 0.0;
    for (int i = 0; i < 4; i++) {
        node->corners[i] = p.corners[i];
        node->weights[i] = fmax(p.weights[i], LEAST_WEIGHT);
        sum += node->weights[i];
    }
    for (int i = 0; i < 4; i++) {
        node->weights[i] /= sum;
        node->position = v3_axpy(node->weights[i], corner_position(m, r, p.corners[i]), node->position);
    }
    return r->count++;
}

/* The surplus' hat function has gradient g_i / w_i in the sub-tet that replaces corner i, whose volume is w_i V. */
mat3 surplus_compliance(const tissue *t, const refinement *r, int tet, const leaf_point *at) {
    double youngs_modulus, poisson_ratio;
    element_moduli(t, tet, &youngs_modulus, &poisson_ratio);
    vec3 corners[4], g[4];
    for (int i = 0; i < 4; i++) corners[i] = corner_position(t->mesh, r, at->corners[i]);
    double volume = tet_gradients(corners, g);
    mat3 d = {{{0}}};
    for (int i = 0; i < 4; i++) {
        double weight = fmax(at->weights[i], 1e-9); /* on a face d is infinite and the compliance zero */
        mat3 k = stiffness_block(g[i], g[i], volume / weight, youngs_modulus, poisson_ratio);
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) d.m[a][b] += k.m[a][b];
    }
    return m3_inverse(&d);
}

static mat3 node_surplus(const tissue *t, const refinement *r, const added_node *node) {
    leaf_point p;
    memcpy(p.corners, node->corners, sizeof p.corners);
    memcpy(p.weights, node->weights, sizeof p.weights);
    return surplus_compliance(t, r, node->tet, &p);
}

void refinement_displacement(inverse *inv, const refinement *r, const vec3 *nominal_force, const vec3 *added_force,
                             vec3 *nominal, vec3 *added) {
    const tissue *t = inverse_tissue(inv);
    vec3 surplus_force[MAX_CONTACTS + 1];
    memcpy(surplus_force, added_force, (size_t)r->count * sizeof *surplus_force);
    memcpy(nominal, nominal_force, (size_t)t->mesh->node_count * sizeof *nominal);
    for (int q = r->count - 1; q >= 0; q--) /* nodal forces -> forces on the hierarchical unknowns */
        for (int i = 0; i < 4; i++) {
            int corner = r->nodes[q].corners[i];
            vec3 *at = corner >= 0 ? &nominal[corner] : &surplus_force[-1 - corner];
            *at = v3_axpy(r->nodes[q].weights[i], surplus_force[q], *at);
        }
    inverse_apply(inv, nominal, nominal);
    for (int q = 0; q < r->count; q++) {
        mat3 compliance = node_surplus(t, r, &r->nodes[q]);
        added[q] = m3_apply(&compliance, surplus_force[q]);
        for (int i = 0; i < 4; i++) {
            int corner = r->nodes[q].corners[i];
            added[q] = v3_axpy(r->nodes[q].weights[i], corner >= 0 ? nominal[corner] : added[-1 - corner], added[q]);
        }
    }
}

/* ---- the refined mesh written out -------------------------------------------------------------------------------- */

static int find_leaf(const refined_mesh *out, const mesh *m, const added_node *node) {
    int corners[4];
    for (int i = 0; i < 4; i++)
        corners[i] = node->corners[i] >= 0 ? node->corners[i] : m->node_count - 1 - node->corners[i];
    if (same_corners(out->tets[node->tet], corners)) return node->tet;
    for (int e = m->tet_count; e < out->tet_count; e++)
        if (out->parent[e] == node->tet && same_corners(out->tets[e], corners)) return e;
    return -1;
}

static void split_leaf(refined_mesh *out, int leaf, int node) {
    int corners[4];
    memcpy(corners, out->tets[leaf], sizeof corners);
    for (int i = 0; i < 4; i++) {
        int child = i == 0 ? leaf : out->tet_count++;
        memcpy(out->tets[child], corners, sizeof corners);
        out->tets[child][i] = node;
        out->parent[child] = out->parent[leaf];
    }
}

trocar_status refined_mesh_create(const mesh *m, const refinement *r, refined_mesh *out, report *why) {
    size_t nodes = (size_t)(m->node_count + r->count), tets = (size_t)(m->tet_count + 3 * r->count);
    *out = (refined_mesh){.node_count = (int)nodes, .tet_count = m->tet_count, .nodes = malloc(nodes * sizeof *out->nodes),
                          .tets = malloc(tets * sizeof *out->tets), .parent = malloc(tets * sizeof *out->parent)};
    if (!out->nodes || !out->tets || !out->parent) {
        refined_mesh_free(out);
        return fail(why, TROCAR_NO_MEMORY, "no memory for a refined mesh of %zu nodes", nodes);
    }
    memcpy(out->nodes, m->nodes, (size_t)m->node_count * sizeof *out->nodes);
    memcpy(out->tets, m->tets, (size_t)m->tet_count * sizeof *out->tets);
    for (int e = 0; e < m->tet_count; e++) out->parent[e] = e;
    for (int q = 0; q < r->count; q++) {
        out->nodes[m->node_count + q] = r->nodes[q].position;
        split_leaf(out, find_leaf(out, m, &r->nodes[q]), m->node_count + q);
    }
    return TROCAR_OK;
}

void refined_mesh_free(refined_mesh *out) {
    free(out->nodes);
    free(out->tets);
    free(out->parent);
    memset(out, 0, sizeof *out);
}

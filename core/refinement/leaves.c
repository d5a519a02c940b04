#include "refinement/leaves.h"

#include <string.h>

bool same_corners(const int a[4], const int b[4]) { return memcmp(a, b, 4 * sizeof *a) == 0; }

vec3 refinement_position(const mesh *m, const refinement *r, int active, int corner) {
    if (corner < 0) return r->nodes[-1 - corner].position;
    for (int i = 0; i < active; i++)
        if (r->nodes[r->order[i]].moved == corner) return r->nodes[r->order[i]].position;
    return m->nodes[corner];
}

void leaf_positions(const mesh *m, const refinement *r, int active, const int corners[4], vec3 positions[4]) {
    for (int i = 0; i < 4; i++) positions[i] = corners[i] < 0 ? r->nodes[-1 - corners[i]].position : m->nodes[corners[i]];
    for (int k = 0; k < active; k++) {
        const added_node *node = &r->nodes[r->order[k]];
        for (int i = 0; i < 4 && node->moved >= 0; i++)
            if (corners[i] == node->moved) positions[i] = node->position;
    }
}

/* ---- leaves ------------------------------------------------------------------------------------------------------ */

/* Splits a leaf at the contact node: in each child, the contact node replaces one of the corners that have a nonzero weight. */
static int split_leaf(const leaf_point *at, int slot, int count, leaf leaves[MAX_LEAVES]) {
    int split = 0;
    while (split < count && !same_corners(leaves[split].corners, at->corners)) split++;
    if (split == count) return count;
    leaf whole = leaves[split];
    int place = split;
    for (int i = 0; i < 4; i++) {
        if (at->weights[i] == 0.0) continue;
        leaves[place] = whole;
        leaves[place].corners[i] = -1 - slot;
        place = place == split ? count : place + 1;
    }
    return place;
}

/* Returns the leaf in element `tet` that the node splits on this side; NULL if none. `side`: 0 for the node's own leaf, 1 for the one across the face on which
   the node lies. */
static const leaf_point *leaf_split(const added_node *node, int side, int tet) {
    if (node->moved >= 0 || (side == 0 ? node->tet : node->across_tet) != tet) return NULL;
    return side == 0 ? &node->at : &node->across;
}

int leaves_of(const mesh *m, const refinement *r, int active, int tet, leaf leaves[MAX_LEAVES]) {
    int count = 1;
    leaves[0].tet = tet;
    memcpy(leaves[0].corners, m->tets[tet], sizeof leaves[0].corners);
    for (int i = 0; i < active; i++)
        for (int side = 0; side < 2; side++) {
            const leaf_point *at = leaf_split(&r->nodes[r->order[i]], side, tet);
            if (at) count = split_leaf(at, r->order[i], count, leaves);
        }
    return count;
}

bool leaf_has_corner(const leaf *l, int corner) {
    return l->corners[0] == corner || l->corners[1] == corner || l->corners[2] == corner || l->corners[3] == corner;
}

int refinement_around(const mesh *m, const refinement *r, int active, int node, int start, leaf around[MAX_PATCH_LEAVES]) {
    int tets[MAX_PATCH_LEAVES], count = 0;
    int tet_count = mesh_around(m, node, start, tets, MAX_PATCH_LEAVES);
    if (tet_count < 0) return -1;
    for (int i = 0; i < tet_count; i++) {
        leaf leaves[MAX_LEAVES];
        int all = leaves_of(m, r, active, tets[i], leaves);
        for (int k = 0; k < all; k++) {
            if (!leaf_has_corner(&leaves[k], node)) continue;
            if (count == MAX_PATCH_LEAVES) return -1;
            around[count++] = leaves[k];
        }
    }
    return count;
}

/* ---- where a point is -------------------------------------------------------------------------------------------- */

static leaf_point point_in(const mesh *m, const refinement *r, int active, const int corners[4], vec3 x) {
    leaf_point p;
    vec3 positions[4];
    memcpy(p.corners, corners, sizeof p.corners);
    leaf_positions(m, r, active, corners, positions);
    tet_barycentric(positions, x, p.weights);
    return p;
}

int closest_face(const leaf_point *p) {
    int face = 0;
    for (int i = 1; i < 4; i++)
        if (p->weights[i] < p->weights[face]) face = i;
    return face;
}

static double least_weight(const leaf_point *p) { return smaller_of(smaller_of(p->weights[0], p->weights[1]), smaller_of(p->weights[2], p->weights[3])); }

bool added_on_face(const added_node *node) { return least_weight(&node->at) == 0.0; }

/* If the node in `slot` splits p's leaf, moves p into the child that contains it. With p's weights b and the node's weights g, that child replaces the corner
   with the smallest b/g, and this ratio is the node's weight. */
static bool descend(const leaf_point *at, int slot, leaf_point *p) {
    if (!same_corners(at->corners, p->corners)) return false;
    int least = at->weights[0] == 0.0;
    for (int i = least + 1; i < 4; i++)
        if (at->weights[i] > 0.0 && p->weights[i] * at->weights[least] < p->weights[least] * at->weights[i]) least = i;
    double share = p->weights[least] / at->weights[least];
    for (int i = 0; i < 4; i++) p->weights[i] -= share * at->weights[i];
    p->corners[least] = -1 - slot;
    p->weights[least] = share;
    return true;
}

/* Returns the leaf that x lies deepest in. Searches all leaves, because where nodes have been moved, the leaves no longer fill their parents. */
static leaf_point search_leaves(const mesh *m, const refinement *r, int active, int tet, vec3 x) {
    leaf leaves[MAX_LEAVES];
    int count = leaves_of(m, r, active, tet, leaves);
    leaf_point best = point_in(m, r, active, leaves[0].corners, x);
    for (int i = 1; i < count; i++) {
        leaf_point p = point_in(m, r, active, leaves[i].corners, x);
        if (least_weight(&p) > least_weight(&best)) best = p;
    }
    return best;
}

leaf_point refinement_locate(const mesh *m, const refinement *r, int active, int tet, vec3 x) {
    for (int i = 0; i < active; i++)
        if (r->nodes[r->order[i]].moved >= 0) return search_leaves(m, r, active, tet, x);
    leaf_point p = point_in(m, r, active, m->tets[tet], x);
    for (int i = 0; i < active; i++)
        for (int side = 0; side < 2; side++) {
            const leaf_point *at = leaf_split(&r->nodes[r->order[i]], side, tet);
            if (at && descend(at, r->order[i], &p)) break; /* the same node cannot also split the child */
        }
    return p;
}

static const double INSIDE = -1e-9; /* dimensionless: a point whose smallest barycentric weight is at least this counts as inside the element. Rounding
                                       tolerance */

int refinement_element(const mesh *m, const refinement *r, int active, int near, vec3 x, double weights[4]) {
    enum { MOST = 32 };
    for (int step = 0;; step++) {
        leaf_point p = point_in(m, r, active, m->tets[near], x);
        memcpy(weights, p.weights, sizeof p.weights);
        int face = closest_face(&p), next = mesh_bonded(m, near, face);
        if (p.weights[face] >= INSIDE || next < 0 || step == MOST) return near;
        near = next;
    }
}

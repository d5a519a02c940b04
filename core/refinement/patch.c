#include "refinement/patch.h"

#include <string.h>

/* Returns the index of a leaf corner in the patch, appending the corner if it is not listed yet. Returns -1 if the corner is fixed. */
static int place_of(const tissue *t, patch *p, int corner) {
    if (corner >= 0 && t->fixed[corner]) return -1;
    for (int i = 0; i < p->count; i++)
        if (p->nodes[i] == corner) return i;
    p->nodes[p->count] = corner;
    memset(p->change + 3 * p->count, 0, 3 * sizeof *p->change);
    for (int row = 0; row < 3 * p->count; row++) memset(&p->change[row][3 * p->count], 0, 3 * sizeof(double));
    return p->count++;
}

/* Adds `sign` times the stiffness of a leaf in the mesh with the first `active` contact nodes. */
static void add_leaf(const tissue *t, const refinement *r, int active, const leaf *l, double sign, patch *p) {
    double youngs_modulus, poisson_ratio, k[12][12];
    vec3 corners[4];
    int places[4];
    element_moduli(t, l->tet, &youngs_modulus, &poisson_ratio);
    for (int i = 0; i < 4; i++) {
        places[i] = place_of(t, p, l->corners[i]);
        corners[i] = refinement_position(t->mesh, r, active, l->corners[i]);
    }
    tet_stiffness(corners, youngs_modulus, poisson_ratio, k);
    for (int a = 0; a < 12; a++)
        for (int b = 0; b < 12; b++)
            if (places[a / 3] >= 0 && places[b / 3] >= 0) p->change[3 * places[a / 3] + a % 3][3 * places[b / 3] + b % 3] += sign * k[a][b];
}

static leaf leaf_of(int tet, const leaf_point *at) {
    leaf l = {.tet = tet};
    memcpy(l.corners, at->corners, sizeof l.corners);
    return l;
}

static void add_children(const tissue *t, const refinement *r, int position, int tet, const leaf_point *at, patch *p) {
    for (int i = 0; i < 4; i++) {
        if (at->weights[i] == 0.0) continue;
        leaf child = leaf_of(tet, at);
        child.corners[i] = -1 - r->order[position];
        add_leaf(t, r, position, &child, 1.0, p);
    }
}

static void add_split(const tissue *t, const refinement *r, int position, patch *p) {
    const added_node *node = &r->nodes[r->order[position]];
    leaf whole = leaf_of(node->tet, &node->at), across = leaf_of(node->across_tet, &node->across);
    add_leaf(t, r, position, &whole, -1.0, p);
    if (across.tet >= 0) add_leaf(t, r, position, &across, -1.0, p);
    add_children(t, r, position, node->tet, &node->at, p);
    if (across.tet >= 0) add_children(t, r, position, node->across_tet, &node->across, p);
}

static void add_move(const tissue *t, const refinement *r, int position, patch *p) {
    leaf leaves[MAX_PATCH_LEAVES];
    const added_node *node = &r->nodes[r->order[position]];
    int count = refinement_around(t->mesh, r, position, node->moved, node->tet, leaves);
    for (int i = 0; i < count; i++) {
        add_leaf(t, r, position, &leaves[i], -1.0, p);
        add_leaf(t, r, position + 1, &leaves[i], 1.0, p);
    }
}

/* ---- an added node's own columns ------------------------------------------------------------------------------------- */

static int split_place(const tissue *t, split_columns *s, int corner) {
    if (corner >= 0 && t->fixed[corner]) return -1;
    for (int i = 0; i < s->count; i++)
        if (s->nodes[i] == corner) return i;
    s->nodes[s->count] = corner;
    s->beside[s->count] = (mat3){{{0}}};
    return s->count++;
}

/* Adds the contributions of the leaves that result when the node at x splits leaf `at`. */
static void add_own_columns(const tissue *t, const refinement *r, int position, int tet, const leaf_point *at, vec3 x, split_columns *s) {
    double youngs_modulus, poisson_ratio;
    vec3 corners[4], gradients[4];
    int places[4];
    element_moduli(t, tet, &youngs_modulus, &poisson_ratio);
    leaf_positions(t->mesh, r, position, at->corners, corners);
    for (int i = 0; i < 4; i++) places[i] = split_place(t, s, at->corners[i]);
    for (int i = 0; i < 4; i++) {
        if (at->weights[i] == 0.0) continue;
        vec3 whole = corners[i];
        corners[i] = x;
        double volume = tet_gradients(corners, gradients);
        corners[i] = whole;
        for (int c = 0; c < 4; c++) {
            mat3 block = stiffness_block(gradients[c], gradients[i], volume, youngs_modulus, poisson_ratio);
            if (c == i) m3_add_scaled(&s->own, 1.0, &block);
            else if (places[c] >= 0) m3_add_scaled(&s->beside[places[c]], 1.0, &block);
        }
    }
}

void patch_own_columns(const tissue *t, const refinement *r, int position, split_columns *s) {
    const added_node *node = &r->nodes[r->order[position]];
    s->count = 0;
    s->own = (mat3){{{0}}};
    add_own_columns(t, r, position, node->tet, &node->at, node->position, s);
    if (node->across_tet >= 0) add_own_columns(t, r, position, node->across_tet, &node->across, node->position, s);
}

/* ---- the whole patch ------------------------------------------------------------------------------------------------- */

void patch_create(const tissue *t, const refinement *r, int position, patch *p) {
    p->count = 0;
    if (r->nodes[r->order[position]].moved >= 0) add_move(t, r, position, p);
    else add_split(t, r, position, p);
}

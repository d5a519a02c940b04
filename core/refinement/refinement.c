#include "refinement/refinement.h"

#include <string.h>

#include "refinement/leaves.h"

static const double LEAST_WEIGHT = 0.02; /* fraction: smallest barycentric weight of an added node in its leaf. Prevents degenerate elements. Chosen by
                                            judgement */
static const double ON_FACE = 1e-9; /* dimensionless: if a barycentric weight is no larger than this, the node counts as lying on the opposite face. Rounding
                                       tolerance */

/* ---- addition ---------------------------------------------------------------------------------------------------- */

/* Raises all weights to at least LEAST_WEIGHT, except that of corner `zero`, which is set to zero. `zero` is -1 if there is no such corner. */
static void keep_inside(leaf_point *p, int zero) {
    double sum = 0.0;
    for (int i = 0; i < 4; i++) sum += p->weights[i] = i == zero ? 0.0 : fmax(p->weights[i], LEAST_WEIGHT);
    for (int i = 0; i < 4; i++) p->weights[i] /= sum;
}

/* Returns a bit mask of the slots in use. */
static uint64_t slots_in_use(const refinement *r) {
    uint64_t used = 0;
    for (int i = 0; i < r->count; i++) used |= UINT64_C(1) << r->order[i];
    return used;
}

/* Returns the lowest free slot, and writes it to order[count] without counting it yet. */
static int take_slot(refinement *r) { return r->order[r->count] = __builtin_ctzll(~slots_in_use(r)); }

static int append(const mesh *m, refinement *r, int tet, const leaf_point *at, uint64_t id) {
    int slot = take_slot(r);
    added_node *node = &r->nodes[slot];
    *node = (added_node){.id = id, .tet = tet, .moved = -1, .at = *at, .across_tet = -1};
    for (int i = 0; i < 4; i++)
        node->position = v3_axpy(at->weights[i], refinement_position(m, r, r->count, at->corners[i]), node->position);
    r->count++;
    return slot;
}

int refinement_add(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id) {
    if (r->count >= MAX_CONTACTS) return -1;
    leaf_point p = refinement_locate(m, r, r->count, tet, x);
    keep_inside(&p, -1);
    return append(m, r, tet, &p, id);
}

/* Finds the leaf on the other side of the face opposite corner `face`. It may be in the same element or in an adjacent one. */
static bool find_across(const mesh *m, const refinement *r, int active, int tet, const int corners[4], int face, leaf *across) {
    leaf leaves[MAX_LEAVES];
    for (int k = -1; k < 4; k++) {
        int other = k < 0 ? tet : mesh_bonded(m, tet, k);
        int count = other < 0 ? 0 : leaves_of(m, r, active, other, leaves);
        for (int i = 0; i < count; i++) {
            bool all = !same_corners(leaves[i].corners, corners);
            for (int c = 0; c < 4 && all; c++) all = c == face || leaf_has_corner(&leaves[i], corners[c]);
            if (!all) continue;
            *across = leaves[i];
            return true;
        }
    }
    return false;
}

/* If the node is on the face opposite corner `face`, records the leaf on the other side, in the mesh with the first `active` contact nodes. */
static void split_across(const mesh *m, const refinement *r, int active, int face, added_node *node) {
    leaf across;
    if (!find_across(m, r, active, node->tet, node->at.corners, face, &across)) return;
    node->across_tet = across.tet;
    for (int i = 0; i < 4; i++) {
        node->across.corners[i] = across.corners[i];
        node->across.weights[i] = 0.0;
        for (int k = 0; k < 4; k++)
            if (node->at.corners[k] == across.corners[i]) node->across.weights[i] = node->at.weights[k];
    }
}

int refinement_add_on_face(const mesh *m, refinement *r, int tet, vec3 x, uint64_t id) {
    if (r->count >= MAX_CONTACTS) return -1;
    leaf_point p = refinement_locate(m, r, r->count, tet, x);
    int face = closest_face(&p);
    keep_inside(&p, face);
    int slot = append(m, r, tet, &p, id);
    split_across(m, r, r->count - 1, face, &r->nodes[slot]);
    return slot;
}

/* ---- removal ------------------------------------------------------------------------------------------------------- */

int refinement_find(const refinement *r, uint64_t id) {
    for (int i = 0; i < r->count; i++)
        if (r->nodes[r->order[i]].id == id) return i;
    return -1;
}

static bool touches(const leaf_point *p, uint64_t slots) {
    for (int i = 0; i < 4; i++)
        if (p->corners[i] < 0 && slots >> (-1 - p->corners[i]) & 1) return true;
    return false;
}

bool refinement_hangs_on(const added_node *node, uint64_t slots) {
    return node->moved < 0 && (touches(&node->at, slots) || (node->across_tet >= 0 && touches(&node->across, slots)));
}

/* Finds the leaf that now contains a node, in the mesh with the first `active` nodes. A node on a face may be slightly off it because of rounding, so its
   weight there is set to exactly zero. */
static void place_again(const mesh *m, const refinement *r, int active, added_node *node) {
    node->at = refinement_locate(m, r, active, node->tet, node->position);
    node->across_tet = -1;
    node->across = (leaf_point){.corners = {0}};
    int face = closest_face(&node->at);
    if (node->at.weights[face] > ON_FACE) return;
    double rest = 1.0 - node->at.weights[face];
    for (int i = 0; i < 4; i++) node->at.weights[i] = i == face ? 0.0 : node->at.weights[i] / rest;
    split_across(m, r, active, face, node);
}

int refinement_remove(const mesh *m, refinement *r, uint64_t id) {
    int position = refinement_find(r, id);
    if (position < 0) return -1;
    for (int i = position; i < r->count && position + 1 < r->count; i++)
        if (r->nodes[r->order[i]].moved >= 0) return -1;
    int slot = r->order[position];
    uint64_t changed = UINT64_C(1) << slot;
    r->count--;
    memmove(r->order + position, r->order + position + 1, (size_t)(r->count - position) * sizeof *r->order);
    for (int i = position; i < r->count; i++) {
        if (!refinement_hangs_on(&r->nodes[r->order[i]], changed)) continue;
        place_again(m, r, i, &r->nodes[r->order[i]]);
        changed |= UINT64_C(1) << r->order[i];
    }
    return slot;
}

int refinement_span(const refinement *r) {
    int span = 0;
    for (int i = 0; i < r->count; i++) span = r->order[i] >= span ? r->order[i] + 1 : span;
    return span;
}

void refinement_compact(const refinement *r, int count, refinement *out) {
    int place_of[MAX_CONTACTS] = {0};
    out->count = count;
    for (int i = 0; i < count; i++) {
        added_node *node = &out->nodes[i];
        out->order[i] = i;
        *node = r->nodes[r->order[i]];
        place_of[r->order[i]] = i;
        for (int c = 0; c < 4; c++) {
            int *at = &node->at.corners[c], *across = &node->across.corners[c];
            if (*at < 0) *at = -1 - place_of[-1 - *at];
            if (*across < 0) *across = -1 - place_of[-1 - *across];
        }
    }
}

#include "remesh/refinement.h"

#include <stdlib.h>
#include <string.h>

/* ---- the refined mesh -------------------------------------------------------------------------------------------- */

static const double LEAST_WEIGHT = 0.02;  /* an added node keeps this far inside its leaf: no slivers, no zero volumes */

static const double LEAST_SHAPE = 0.03;   /* of a moved node's elements: volume over that of the ideal tet of the longest edge */

static bool same_corners(const int a[4], const int b[4]) { return memcmp(a, b, 4 * sizeof *a) == 0; }

vec3 refinement_position(const mesh *m, const refinement *r, int active, int corner) {
    if (corner < 0) return r->nodes[-1 - corner].position;
    for (int i = 0; i < active; i++)
        if (r->nodes[r->order[i]].moved == corner) return r->nodes[r->order[i]].position;
    return m->nodes[corner];
}

static void leaf_positions(const mesh *m, const refinement *r, int active, const int corners[4], vec3 positions[4]) {
    for (int i = 0; i < 4; i++) positions[i] = refinement_position(m, r, active, corners[i]);
}

/* ---- leaves ------------------------------------------------------------------------------------------------------ */

/* A contact node of its own takes the place of each corner in turn that it has a weight for. */
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

/* The leaf that a node splits on one side of it, NULL where it splits none in element `tet`. */
static const leaf_point *leaf_split(const added_node *node, int side, int tet) {
    if (node->moved >= 0 || (side == 0 ? node->tet : node->across_tet) != tet) return NULL;
    return side == 0 ? &node->at : &node->across;
}

/* All leaves of a nominal element. Returns how many. */
static int leaves_of(const mesh *m, const refinement *r, int active, int tet, leaf leaves[MAX_LEAVES]) {
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

static bool has_corner(const leaf *l, int corner) {
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
            if (!has_corner(&leaves[k], node)) continue;
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

static int closest_face(const leaf_point *p) {
    int face = 0;
    for (int i = 1; i < 4; i++)
        if (p->weights[i] < p->weights[face]) face = i;
    return face;
}

static double least_weight(const leaf_point *p) { return fmin(fmin(p->weights[0], p->weights[1]), fmin(p->weights[2], p->weights[3])); }

bool added_on_face(const added_node *node) { return least_weight(&node->at) == 0.0; }

/* If the added node in `slot` splits the leaf that p is in, moves p into the child that contains it. With p's weights b and
   the node's weights g, the child is the one opposite the corner of least b/g, and that ratio is the node's weight. */
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

/* Where nodes have moved, leaves no longer fill the ones that they came from: the leaf that x is deepest in. */
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
            if (at && descend(at, r->order[i], &p)) break; /* once is enough: the children are not split by the same node */
        }
    return p;
}

int refinement_element(const mesh *m, const refinement *r, int active, int near, vec3 x, double weights[4]) {
    enum { MOST = 32 };
    static const double INSIDE = -1e-9;
    for (int step = 0;; step++) {
        leaf_point p = point_in(m, r, active, m->tets[near], x);
        memcpy(weights, p.weights, sizeof p.weights);
        int face = closest_face(&p), next = m->neighbours[near][face];
        if (p.weights[face] >= INSIDE || next < 0 || step == MOST) return near;
        near = next;
    }
}

/* ---- changes of the mesh ----------------------------------------------------------------------------------------- */

/* Weights of at least LEAST_WEIGHT, but for the corner `zero` (none if -1), which has none. */
static void keep_inside(leaf_point *p, int zero) {
    double sum = 0.0;
    for (int i = 0; i < 4; i++) sum += p->weights[i] = i == zero ? 0.0 : fmax(p->weights[i], LEAST_WEIGHT);
    for (int i = 0; i < 4; i++) p->weights[i] /= sum;
}

/* Bit i: slot i is in use. */
static uint64_t slots_in_use(const refinement *r) {
    uint64_t used = 0;
    for (int i = 0; i < r->count; i++) used |= UINT64_C(1) << r->order[i];
    return used;
}

/* Puts the lowest free slot behind the others, where it is not counted yet. */
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

/* The leaf on the other side of the face opposite corner `face`: in the same element or one beside it. */
static bool find_across(const mesh *m, const refinement *r, int active, int tet, const int corners[4], int face, leaf *across) {
    leaf leaves[MAX_LEAVES];
    for (int k = -1; k < 4; k++) {
        int other = k < 0 ? tet : m->neighbours[tet][k];
        int count = other < 0 ? 0 : leaves_of(m, r, active, other, leaves);
        for (int i = 0; i < count; i++) {
            bool all = !same_corners(leaves[i].corners, corners);
            for (int c = 0; c < 4 && all; c++) all = c == face || has_corner(&leaves[i], corners[c]);
            if (!all) continue;
            *across = leaves[i];
            return true;
        }
    }
    return false;
}

/* The other side of the face opposite corner `face` that the node is on, with the first `active` contact nodes. */
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

static int closest_corner(const mesh *m, const refinement *r, const leaf_point *p, int face, vec3 x) {
    int closest = -1;
    double least = INFINITY;
    for (int i = 0; i < 4; i++) {
        double distance = v3_norm(v3_sub(refinement_position(m, r, r->count, p->corners[i]), x));
        if (i == face || distance >= least) continue;
        closest = p->corners[i];
        least = distance;
    }
    return closest;
}

/* Negative where the element is inverted, 1 for the ideal tetrahedron. */
static double shape_of(const vec3 x[4]) {
    double longest = 0.0;
    for (int i = 0; i < 4; i++)
        for (int k = 0; k < i; k++) longest = fmax(longest, v3_norm(v3_sub(x[i], x[k])));
    return sqrt(2.0) * v3_dot(v3_sub(x[1], x[0]), v3_cross(v3_sub(x[2], x[0]), v3_sub(x[3], x[0]))) / (longest * longest * longest);
}

static bool well_shaped(const mesh *m, const refinement *r, const leaf *leaves, int count) {
    for (int i = 0; i < count; i++) {
        vec3 x[4];
        leaf_positions(m, r, r->count, leaves[i].corners, x);
        if (!(shape_of(x) >= LEAST_SHAPE)) return false;
    }
    return true;
}

/* How many nodes the moves so far touch; more than all, where `node` is one of those moved. */
static int moved_patches(const refinement *r, int node) {
    int sum = 0;
    for (int i = 0; i < r->count; i++) {
        const added_node *other = &r->nodes[r->order[i]];
        sum += other->moved == node ? MAX_MOVED_PATCHES : other->touched;
    }
    return sum;
}

int refinement_move(const tissue *t, refinement *r, int tet, vec3 x, uint64_t id) {
    const mesh *m = t->mesh;
    if (r->count >= MAX_CONTACTS) return -1;
    leaf_point p = refinement_locate(m, r, r->count, tet, x);
    int node = closest_corner(m, r, &p, closest_face(&p), x);
    if (node < 0 || m->anatomical[node] || t->fixed[node]) return -1;
    leaf around[MAX_PATCH_LEAVES];
    int count = refinement_around(m, r, r->count, node, tet, around), touched = count / 2 + 3;
    if (count < 0 || moved_patches(r, node) + touched > MAX_MOVED_PATCHES) return -1;
    int slot = take_slot(r);
    r->count++;
    r->nodes[slot] = (added_node){.id = id, .tet = tet, .position = x, .moved = node, .across_tet = -1, .touched = touched};
    if (well_shaped(m, r, around, count)) return slot;
    r->count--;
    return -1;
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

/* Finds the leaf that a node is in now, with the first `active` nodes. Where it is on a face of that, it is to rounding. */
static void place_again(const mesh *m, const refinement *r, int active, added_node *node) {
    static const double ON_FACE = 1e-9;
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

/* ---- the refined mesh written out -------------------------------------------------------------------------------- */

static int written_corner(const mesh *m, int corner) { return corner >= 0 ? corner : m->node_count - 1 - corner; }

/* The leaves of one element; the first stays in the element's own place. */
static void write_leaves(const mesh *m, const refinement *r, int tet, refined_mesh *out) {
    leaf leaves[MAX_LEAVES];
    int count = leaves_of(m, r, r->count, tet, leaves);
    for (int i = 0; i < count; i++) {
        int place = i == 0 ? tet : out->tet_count++;
        for (int c = 0; c < 4; c++) out->tets[place][c] = written_corner(m, leaves[i].corners[c]);
        out->parent[place] = tet;
    }
}

trocar_status refined_mesh_create(const mesh *m, const refinement *r, refined_mesh *out, report *why) {
    size_t nodes = (size_t)(m->node_count + r->count), tets = (size_t)(m->tet_count + 4 * r->count);
    *out = (refined_mesh){.node_count = (int)nodes, .tet_count = m->tet_count, .nodes = malloc(nodes * sizeof *out->nodes),
                          .tets = malloc(tets * sizeof *out->tets), .parent = malloc(tets * sizeof *out->parent)};
    if (!out->nodes || !out->tets || !out->parent) {
        refined_mesh_free(out);
        return fail(why, TROCAR_NO_MEMORY, "no memory for a refined mesh of %zu nodes", nodes);
    }
    memcpy(out->nodes, m->nodes, (size_t)m->node_count * sizeof *out->nodes);
    memcpy(out->tets, m->tets, (size_t)m->tet_count * sizeof *out->tets);
    for (int q = 0; q < r->count; q++) {
        out->nodes[m->node_count + q] = r->nodes[q].position;
        if (r->nodes[q].moved >= 0) out->nodes[r->nodes[q].moved] = r->nodes[q].position;
    }
    for (int e = 0; e < m->tet_count; e++) write_leaves(m, r, e, out);
    return TROCAR_OK;
}

void refined_mesh_free(refined_mesh *out) {
    free(out->nodes);
    free(out->tets);
    free(out->parent);
    memset(out, 0, sizeof *out);
}

#include "oracles/refinement_move.h"

static const double LEAST_SHAPE = 0.03; /* least volume of a moved node's elements, relative to the regular tetrahedron with the same longest edge */

static int free_slot(const refinement *r) {
    for (int slot = 0;; slot++) {
        bool used = false;
        for (int i = 0; i < r->count; i++) used |= r->order[i] == slot;
        if (!used) return slot;
    }
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

/* Returns the shape measure: 1 for a regular tetrahedron, negative for an inverted element. */
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

/* Returns how many nodes the moves so far affect, or MAX_MOVED_PATCHES or more if `node` itself has been moved. */
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
    int slot = free_slot(r);
    r->order[r->count++] = slot;
    r->nodes[slot] = (added_node){.id = id, .tet = tet, .position = x, .moved = node, .across_tet = -1, .touched = touched};
    if (well_shaped(m, r, around, count)) return slot;
    r->count--;
    return -1;
}

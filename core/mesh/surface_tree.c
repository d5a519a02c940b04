#include "mesh/surface_tree.h"

#include <stdlib.h>

static const double SLACK = 1e-12; /* fraction: tolerance for distances, relative to the size of the body. Rounding tolerance */
enum { LEAF_FACES = 4, STACK_SIZE = 64 };   /* each level halves the number of faces, so 64 levels are enough for any mesh */

/* ---- building ---- */

typedef struct { double position; int face; } ranked_face;

static int compare_ranks(const void *left, const void *right) {
    const ranked_face *a = left, *b = right;
    if (a->position != b->position) return a->position < b->position ? -1 : 1;
    return (a->face > b->face) - (a->face < b->face);
}

static double coordinate(vec3 x, int axis) { return axis == 0 ? x.x : axis == 1 ? x.y : x.z; }

static void bound_faces(const mesh *m, const ranked_face *faces, int count, bvh_node *node) {
    node->low = v3(INFINITY, INFINITY, INFINITY);
    node->high = v3(-INFINITY, -INFINITY, -INFINITY);
    for (int i = 0; i < count; i++)
        for (int k = 0; k < 3; k++) {
            vec3 x = m->nodes[m->boundary[faces[i].face].nodes[k]];
            node->low = v3(fmin(node->low.x, x.x), fmin(node->low.y, x.y), fmin(node->low.z, x.z));
            node->high = v3(fmax(node->high.x, x.x), fmax(node->high.y, x.y), fmax(node->high.z, x.z));
        }
}

static void rank_along_longest_axis(const mesh *m, const bvh_node *node, ranked_face *faces, int count) {
    vec3 extent = v3_sub(node->high, node->low);
    int axis = extent.x >= extent.y && extent.x >= extent.z ? 0 : extent.y >= extent.z ? 1 : 2;
    for (int i = 0; i < count; i++) {
        const int *v = m->boundary[faces[i].face].nodes;
        faces[i].position = coordinate(v3_add(m->nodes[v[0]], v3_add(m->nodes[v[1]], m->nodes[v[2]])), axis);
    }
    qsort(faces, count, sizeof *faces, compare_ranks);
}

/* Splits `all[first .. first + count)` recursively into leaves; `used` counts the tree's nodes. */
static void split_node(mesh *m, int index, ranked_face *all, int first, int count, int *used) {
    bvh_node *node = &m->bvh[index];
    bound_faces(m, all + first, count, node);
    if (count <= LEAF_FACES) {
        node->first = first;
        node->count = count;
        for (int i = first; i < first + count; i++) m->bvh_order[i] = all[i].face;
        return;
    }
    rank_along_longest_axis(m, node, all + first, count);
    int child = node->first = *used;
    node->count = 0;
    *used += 2;
    split_node(m, child, all, first, count / 2, used);
    split_node(m, child + 1, all, first + count / 2, count - count / 2, used);
}

bool surface_tree_build(mesh *m) {
    ranked_face *all = malloc(m->boundary_count * sizeof *all);
    m->bvh = malloc(2 * (size_t)m->boundary_count * sizeof *m->bvh);
    m->bvh_order = malloc(m->boundary_count * sizeof *m->bvh_order);
    if (!all || !m->bvh || !m->bvh_order) {
        free(all);
        return false;
    }
    for (int i = 0; i < m->boundary_count; i++) all[i].face = i;
    int used = 1;
    split_node(m, 0, all, 0, m->boundary_count, &used);
    free(all);
    return true;
}

/* ---- entering through the outer surface ---- */

typedef struct { vec3 from, along; double slack; } segment; /* points from + s along, 0 <= s <= 1; slack in m */

static bool clip_axis(double from, double along, double low, double high, double *enter, double *leave) {
    if (along == 0.0) return from >= low && from <= high;
    double s = (low - from) / along, t = (high - from) / along;
    *enter = fmax(*enter, fmin(s, t));
    *leave = fmin(*leave, fmax(s, t));
    return *enter <= *leave;
}

static bool meets_box(const segment *ray, const bvh_node *box, double limit) {
    double enter = 0.0, leave = limit, slack = ray->slack;
    return clip_axis(ray->from.x, ray->along.x, box->low.x - slack, box->high.x + slack, &enter, &leave)
        && clip_axis(ray->from.y, ray->along.y, box->low.y - slack, box->high.y + slack, &enter, &leave)
        && clip_axis(ray->from.z, ray->along.z, box->low.z - slack, box->high.z + slack, &enter, &leave);
}

/* True if the line passes to the left of the edge p -> q, as seen looking against `along`. The rounding error of the triple product is below 1e-14 times the
   product of the lengths. Within this tolerance, both triangles at an edge accept the line, so it cannot slip between them. */
static bool left_of_edge(vec3 along, vec3 p, vec3 q) {
    return v3_dot(along, v3_cross(p, q)) <= 1e-14 * v3_norm(along) * v3_norm(p) * v3_norm(q);
}

/* Returns the fraction of the segment at which it enters through triangle abc (counter-clockwise as seen from outside), or INFINITY. */
static double enters_triangle(const segment *ray, vec3 a, vec3 b, vec3 c) {
    vec3 normal = v3_cross(v3_sub(b, a), v3_sub(c, a));
    double inward = -v3_dot(normal, ray->along);
    if (!(inward > 0)) return INFINITY;
    vec3 p = v3_sub(a, ray->from), q = v3_sub(b, ray->from), r = v3_sub(c, ray->from);
    if (!left_of_edge(ray->along, p, q) || !left_of_edge(ray->along, q, r) || !left_of_edge(ray->along, r, p))
        return INFINITY;
    double fraction = -v3_dot(normal, p) / inward;
    double slack = ray->slack * v3_norm(normal) / inward;
    return fraction >= -slack && fraction <= 1.0 + slack ? fmin(fmax(fraction, 0.0), 1.0) : INFINITY;
}

static void enter_leaf(const mesh *m, const segment *ray, const bvh_node *leaf, surface_hit *nearest) {
    for (int i = leaf->first; i < leaf->first + leaf->count; i++) {
        const boundary_face *f = &m->boundary[m->bvh_order[i]];
        double fraction = enters_triangle(ray, m->nodes[f->nodes[0]], m->nodes[f->nodes[1]], m->nodes[f->nodes[2]]);
        if (fraction > 1.0 || (nearest->hit && fraction >= nearest->fraction)) continue;
        *nearest = (surface_hit){.hit = true, .fraction = fraction, .tet = f->tet, .face = f->face,
                                 .point = v3_axpy(fraction, ray->along, ray->from)};
    }
}

surface_hit mesh_enter(const mesh *m, vec3 a, vec3 b) {
    surface_hit nearest = {.hit = false, .tet = -1, .face = -1};
    segment ray = {a, v3_sub(b, a), SLACK * v3_norm(v3_sub(m->bvh[0].high, m->bvh[0].low))};
    int stack[STACK_SIZE], depth = 0;
    stack[depth++] = 0;
    while (depth > 0) {
        const bvh_node *node = &m->bvh[stack[--depth]];
        if (!meets_box(&ray, node, nearest.hit ? nearest.fraction : 1.0)) continue;
        if (node->count > 0) {
            enter_leaf(m, &ray, node, &nearest);
        } else {
            stack[depth++] = node->first + 1;
            stack[depth++] = node->first;
        }
    }
    return nearest;
}

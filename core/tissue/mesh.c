#include "tissue/mesh.h"

#include <stdlib.h>
#include <string.h>

/* Face i lies opposite vertex i; seen from outside a tet of positive volume its nodes run counter-clockwise. */
static const int FACE[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

static const double FLAT = 1e-9;            /* volume / longest edge^3 below which a tet counts as flat (ideal: 0.118) */
static const double INSIDE = -1e-12;        /* least barycentric weight of a point that counts as inside */
static const double SLACK = 1e-12;          /* tolerance on distances, relative to the body's size */
enum { LEAF_FACES = 4, STACK_SIZE = 64 };   /* the tree halves at each level: 64 levels hold any mesh */

/* ---- geometry of one tetrahedron ---- */

static void corners_of(const mesh *m, int tet, vec3 corners[4]) {
    for (int i = 0; i < 4; i++) corners[i] = m->nodes[m->tets[tet][i]];
}

double tet_gradients(const vec3 corners[4], vec3 gradients[4]) {
    vec3 a = v3_sub(corners[1], corners[0]), b = v3_sub(corners[2], corners[0]), c = v3_sub(corners[3], corners[0]);
    vec3 bc = v3_cross(b, c), ca = v3_cross(c, a), ab = v3_cross(a, b);
    double determinant = v3_dot(a, bc);
    gradients[1] = v3_scale(1.0 / determinant, bc);
    gradients[2] = v3_scale(1.0 / determinant, ca);
    gradients[3] = v3_scale(1.0 / determinant, ab);
    gradients[0] = v3_scale(-1.0, v3_add(gradients[1], v3_add(gradients[2], gradients[3])));
    return determinant / 6.0;
}

static double signed_volume(const vec3 corners[4]) {
    vec3 a = v3_sub(corners[1], corners[0]), b = v3_sub(corners[2], corners[0]), c = v3_sub(corners[3], corners[0]);
    return v3_dot(a, v3_cross(b, c)) / 6.0;
}

double mesh_volume(const mesh *m, int tet) {
    vec3 corners[4];
    corners_of(m, tet, corners);
    return signed_volume(corners);
}

static void weights_of(const vec3 corners[4], const vec3 gradients[4], vec3 x, double weights[4]) {
    vec3 from_first = v3_sub(x, corners[0]);
    for (int i = 1; i < 4; i++) weights[i] = v3_dot(gradients[i], from_first);
    weights[0] = 1.0 - (weights[1] + weights[2] + weights[3]);
}

void tet_barycentric(const vec3 corners[4], vec3 x, double weights[4]) {
    vec3 gradients[4];
    tet_gradients(corners, gradients);
    weights_of(corners, gradients, x, weights);
}

void mesh_barycentric(const mesh *m, int tet, vec3 x, double weights[4]) {
    vec3 corners[4];
    corners_of(m, tet, corners);
    tet_barycentric(corners, x, weights);
}

vec3 mesh_point(const mesh *m, int tet, const double weights[4]) {
    vec3 x = v3(0, 0, 0);
    for (int i = 0; i < 4; i++) x = v3_axpy(weights[i], m->nodes[m->tets[tet][i]], x);
    return x;
}

vec3 mesh_face_normal(const mesh *m, int tet, int face) {
    vec3 corners[4], gradients[4];
    corners_of(m, tet, corners);
    tet_gradients(corners, gradients);
    return v3_unit(gradients[face]);
}

/* The weight of vertex i falls at a constant rate along d and reaches zero on face i. */
int mesh_exit(const mesh *m, int tet, vec3 x, vec3 d, double *distance) {
    vec3 corners[4], gradients[4];
    double weights[4];
    corners_of(m, tet, corners);
    tet_gradients(corners, gradients);
    weights_of(corners, gradients, x, weights);
    int exit = -1;
    double nearest = INFINITY, steepest = 0;
    for (int i = 0; i < 4; i++) {
        double rate = v3_dot(gradients[i], d);
        if (!(rate < 0)) continue;
        double reach = fmax(weights[i], 0.0) / -rate;
        if (reach < nearest || (reach == nearest && rate < steepest)) {
            exit = i;
            nearest = reach;
            steepest = rate;
        }
    }
    if (exit >= 0) *distance = nearest;
    return exit;
}

/* ---- around a node ---- */

static int corner_of(const mesh *m, int tet, int node) {
    for (int i = 0; i < 4; i++)
        if (m->tets[tet][i] == node) return i;
    return -1;
}

int mesh_around(const mesh *m, int node, int start, int *tets, int most) {
    int count = 0;
    if (most < 1) return -1;
    tets[count++] = start;
    for (int next = 0; next < count; next++)
        for (int i = 0; i < 4; i++) {
            int other = m->neighbours[tets[next]][i];
            bool known = other < 0 || corner_of(m, other, node) < 0;
            for (int k = 0; k < count && !known; k++) known = tets[k] == other;
            if (known) continue;
            if (count == most) return -1;
            tets[count++] = other;
        }
    return count;
}

/* ---- finding the element of a point ---- */

static int least_weight(const mesh *m, int tet, vec3 x, double *least) {
    double weights[4];
    mesh_barycentric(m, tet, x, weights);
    int vertex = 0;
    for (int i = 1; i < 4; i++)
        if (weights[i] < weights[vertex]) vertex = i;
    *least = weights[vertex];
    return vertex;
}

static int locate_by_search(const mesh *m, vec3 x) {
    int best = -1;
    double best_weight = INSIDE;
    for (int t = 0; t < m->tet_count; t++) {
        double least;
        least_weight(m, t, x, &least);
        if (least >= best_weight) {
            best = t;
            best_weight = least;
        }
    }
    return best;
}

/* The walk crosses the face that x lies farthest behind. It may run in circles or into a notch of the outer surface;
   then every tet is tried. */
int mesh_locate(const mesh *m, vec3 x, int start) {
    int tet = start >= 0 ? start : 0;
    int steps = 64 + 8 * (int)cbrt(m->tet_count);
    while (tet >= 0 && steps-- > 0) {
        double least;
        int vertex = least_weight(m, tet, x, &least);
        if (least >= INSIDE) return tet;
        tet = m->neighbours[tet][vertex];
    }
    return locate_by_search(m, x);
}

/* ---- entering through the outer surface ---- */

typedef struct { vec3 from, along; double slack; } segment; /* from + s along, 0 <= s <= 1; slack in m */

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

/* Does the line pass the edge p -> q on its left, seen against `along`? Rounding in the triple product is below
   1e-14 of the product of lengths: within that both triangles of an edge accept, so that no line slips between them. */
static bool left_of_edge(vec3 along, vec3 p, vec3 q) {
    return v3_dot(along, v3_cross(p, q)) <= 1e-14 * v3_norm(along) * v3_norm(p) * v3_norm(q);
}

/* Fraction at which the segment enters through the triangle abc (counter-clockwise from outside), or INFINITY. */
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

/* ---- remarks ---- */

void mesh_remark(mesh *m, const char *format, ...) {
    char *text = m->remarks.text;
    size_t used = strlen(text), size = sizeof m->remarks.text;
    if (used > 0 && used + 2 < size) strcpy(text + used, "; "), used += 2;
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(text + used, size - used, format, arguments);
    va_end(arguments);
}

void mesh_compare_with_needle(mesh *m, double length, double diameter) {
    static const double LARGEST_BODY = 10.0, SMALLEST_BODY = 0.05, COARSEST = 50.0; /* needle's lengths, and diameters */
    double size = v3_norm(v3_sub(m->bvh[0].high, m->bvh[0].low)), least = INFINITY;
    for (int n = 0; n < m->node_count; n++) least = fmin(least, m->node_size[n]);
    if (size > LARGEST_BODY * length || size < SMALLEST_BODY * length)
        mesh_remark(m, "the body is %.3g m across, the needle %.3g m long: is the mesh in another unit? Set mesh_unit (m, cm, mm) in the scene",
                    size, length);
    else if (least > COARSEST * diameter)
        mesh_remark(m, "the needle, %.3g m thick, is far smaller than the smallest elements, %.3g m: refine the mesh, or check mesh_unit and the "
                    "needle's diameter", diameter, least);
}

/* ---- building: checks and orientation ---- */

static trocar_status check_nodes(const mesh *m, const char *name, report *why) {
    for (int n = 0; n < m->node_count; n++) {
        vec3 x = m->nodes[n];
        if (!isfinite(x.x) || !isfinite(x.y) || !isfinite(x.z))
            return fail(why, TROCAR_BAD_INPUT, "%s: node %d has a coordinate that is not finite: mend the mesh", name, n);
    }
    return TROCAR_OK;
}

static double longest_edge(const vec3 corners[4]) {
    double longest = 0;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < i; j++) longest = fmax(longest, v3_norm(v3_sub(corners[i], corners[j])));
    return longest;
}

static trocar_status orient_tets(mesh *m, const char *name, report *why) {
    for (int t = 0; t < m->tet_count; t++) {
        int *v = m->tets[t];
        vec3 corners[4];
        corners_of(m, t, corners);
        double volume = signed_volume(corners), longest = longest_edge(corners);
        if (!(fabs(volume) > FLAT * longest * longest * longest))
            return fail(why, TROCAR_BAD_INPUT,
                        "%s: tetrahedron %d (nodes %d %d %d %d, near %g %g %g m) has no volume: optimise or remesh", name, t,
                        v[0], v[1], v[2], v[3], corners[0].x, corners[0].y, corners[0].z);
        if (volume < 0) {
            int swapped = v[2];
            v[2] = v[3];
            v[3] = swapped;
        }
    }
    return TROCAR_OK;
}

/* Mean edge of the ideal tets of the same volumes around each node. */
static trocar_status measure_nodes(mesh *m, const char *name, report *why) {
    int *valence = calloc(m->node_count, sizeof *valence);
    if (!valence) return fail(why, TROCAR_NO_MEMORY, "%s: no memory for %d nodes", name, m->node_count);
    for (int t = 0; t < m->tet_count; t++) {
        double edge = cbrt(6.0 * sqrt(2.0) * mesh_volume(m, t));
        for (int i = 0; i < 4; i++) {
            m->node_size[m->tets[t][i]] += edge;
            valence[m->tets[t][i]]++;
        }
    }
    int unused = -1;
    for (int n = 0; n < m->node_count; n++) {
        if (valence[n] == 0) unused = n;
        else m->node_size[n] /= valence[n];
    }
    free(valence);
    return unused < 0 ? TROCAR_OK
                      : fail(why, TROCAR_BAD_INPUT, "%s: node %d belongs to no tetrahedron: remove it", name, unused);
}

/* ---- building: neighbours, named surfaces, boundary ---- */

typedef struct {
    int key[3];              /* nodes, ascending */
    bool odd;                /* the outward order of the nodes is an odd permutation of the key */
    int tet, face;
} face_record;

static void sort_key(int key[3], bool *odd) {
    *odd = false;
    for (int pass = 0; pass < 3; pass++) {
        int i = pass % 2;
        if (key[i] <= key[i + 1]) continue;
        int larger = key[i];
        key[i] = key[i + 1];
        key[i + 1] = larger;
        *odd = !*odd;
    }
}

static int compare_keys(const int a[3], const int b[3]) {
    for (int i = 0; i < 3; i++)
        if (a[i] != b[i]) return a[i] < b[i] ? -1 : 1;
    return 0;
}

/* Ties by tet, so that the order, and with it the boundary's, does not depend on the sort. */
static int compare_records(const void *left, const void *right) {
    const face_record *a = left, *b = right;
    int order = compare_keys(a->key, b->key);
    return order != 0 ? order : (a->tet > b->tet) - (a->tet < b->tet);
}

static face_record *sorted_faces(const mesh *m) {
    face_record *faces = malloc(4 * (size_t)m->tet_count * sizeof *faces);
    if (!faces) return NULL;
    for (int t = 0; t < m->tet_count; t++)
        for (int i = 0; i < 4; i++) {
            face_record *f = &faces[4 * (size_t)t + i];
            f->tet = t;
            f->face = i;
            for (int k = 0; k < 3; k++) f->key[k] = m->tets[t][FACE[i][k]];
            sort_key(f->key, &f->odd);
        }
    qsort(faces, 4 * (size_t)m->tet_count, sizeof *faces, compare_records);
    return faces;
}

/* Two tets that share a face lie on both sides of it, so that they run round it in opposite senses. */
static trocar_status join_neighbours(mesh *m, const face_record *faces, const char *name, report *why) {
    size_t count = 4 * (size_t)m->tet_count, next;
    for (size_t i = 0; i < count; i = next) {
        const face_record *a = &faces[i], *b = a + 1;
        for (next = i + 1; next < count && compare_keys(a->key, faces[next].key) == 0;) next++;
        if (next - i > 2)
            return fail(why, TROCAR_BAD_INPUT, "%s: %d tetrahedra share the face of nodes %d %d %d: make the mesh "
                        "conforming", name, (int)(next - i), a->key[0], a->key[1], a->key[2]);
        m->neighbours[a->tet][a->face] = -1;
        if (next - i < 2) {
            m->boundary_count++;
            continue;
        }
        if (a->odd == b->odd)
            return fail(why, TROCAR_BAD_INPUT, "%s: tetrahedra %d and %d overlap at the face of nodes %d %d %d: remesh",
                        name, a->tet, b->tet, a->key[0], a->key[1], a->key[2]);
        m->neighbours[a->tet][a->face] = b->tet;
        m->neighbours[b->tet][b->face] = a->tet;
    }
    return TROCAR_OK;
}

/* First record with this key, or NULL. */
static const face_record *find_face(const face_record *faces, size_t count, const int key[3]) {
    size_t low = 0, high = count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if (compare_keys(faces[middle].key, key) < 0) low = middle + 1;
        else high = middle;
    }
    return low < count && compare_keys(faces[low].key, key) == 0 ? &faces[low] : NULL;
}

static trocar_status mark_surfaces(mesh *m, const face_record *faces, int triangle_count, const int (*triangles)[3],
                                   const int *triangle_group, const char *name, report *why) {
    size_t count = 4 * (size_t)m->tet_count;
    for (int i = 0; i < triangle_count; i++) {
        int key[3] = {triangles[i][0], triangles[i][1], triangles[i][2]};
        bool odd;
        sort_key(key, &odd);
        const face_record *f = find_face(faces, count, key);
        if (!f)
            return fail(why, TROCAR_BAD_INPUT,
                        "%s: surface \"%s\" has a triangle (nodes %d %d %d) that is no tetrahedron's face: "
                        "mesh surface and volume together", name, m->groups[triangle_group[i]].name, key[0], key[1], key[2]);
        for (; f < faces + count && compare_keys(f->key, key) == 0; f++)
            m->face_groups[f->tet][f->face] |= UINT32_C(1) << triangle_group[i];
    }
    return TROCAR_OK;
}

/* Nodes that the shape of the anatomy depends on. */
static void mark_anatomy(mesh *m) {
    for (int t = 0; t < m->tet_count; t++)
        for (int i = 0; i < 4; i++) {
            int other = m->neighbours[t][i];
            if (other >= 0 && m->region[other] == m->region[t] && m->face_groups[t][i] == 0) continue;
            for (int k = 0; k < 3; k++) m->anatomical[m->tets[t][FACE[i][k]]] = true;
        }
    for (int g = 0; g < m->group_count; g++)
        for (int k = 0; k < m->groups[g].node_count && m->groups[g].dimension < 3; k++) m->anatomical[m->groups[g].nodes[k]] = true;
}

static void collect_boundary(mesh *m) {
    int b = 0;
    for (int t = 0; t < m->tet_count; t++)
        for (int i = 0; i < 4; i++) {
            if (m->neighbours[t][i] >= 0) continue;
            m->boundary[b] = (boundary_face){.tet = t, .face = i};
            for (int k = 0; k < 3; k++) m->boundary[b].nodes[k] = m->tets[t][FACE[i][k]];
            b++;
        }
}

/* ---- building: the tree over the boundary ---- */

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

/* Halves `all[first .. first + count)` until a leaf is small; `used` counts the nodes of the tree. */
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

static bool build_tree(mesh *m) {
    ranked_face *all = malloc(m->boundary_count * sizeof *all);
    if (!all) return false;
    for (int i = 0; i < m->boundary_count; i++) all[i].face = i;
    int used = 1;
    split_node(m, 0, all, 0, m->boundary_count, &used);
    free(all);
    return true;
}

/* ---- the whole mesh ---- */

static trocar_status join_faces(mesh *m, int triangle_count, const int (*triangles)[3], const int *triangle_group,
                                const char *name, report *why) {
    face_record *faces = sorted_faces(m);
    if (!faces) return fail(why, TROCAR_NO_MEMORY, "%s: no memory for %d tetrahedra", name, m->tet_count);
    trocar_status status = join_neighbours(m, faces, name, why);
    if (status == TROCAR_OK) status = mark_surfaces(m, faces, triangle_count, triangles, triangle_group, name, why);
    if (status == TROCAR_OK) mark_anatomy(m);
    free(faces);
    return status;
}

static trocar_status finish_boundary(mesh *m, const char *name, report *why) {
    m->boundary = malloc(m->boundary_count * sizeof *m->boundary);
    m->bvh = malloc(2 * (size_t)m->boundary_count * sizeof *m->bvh);
    m->bvh_order = malloc(m->boundary_count * sizeof *m->bvh_order);
    if (!m->boundary || !m->bvh || !m->bvh_order)
        return fail(why, TROCAR_NO_MEMORY, "%s: no memory for %d boundary faces", name, m->boundary_count);
    collect_boundary(m);
    if (!build_tree(m)) return fail(why, TROCAR_NO_MEMORY, "%s: no memory for %d boundary faces", name, m->boundary_count);
    return TROCAR_OK;
}

trocar_status mesh_finish(mesh *m, int triangle_count, const int (*triangles)[3], const int *triangle_group,
                          const char *name, report *why) {
    if (m->tet_count < 1) return fail(why, TROCAR_BAD_INPUT, "%s: no tetrahedra: mesh the volume", name);
    m->neighbours = malloc(m->tet_count * sizeof *m->neighbours);
    m->face_groups = calloc(m->tet_count, sizeof *m->face_groups);
    m->node_size = calloc(m->node_count, sizeof *m->node_size);
    m->anatomical = calloc(m->node_count, sizeof *m->anatomical);
    if (!m->neighbours || !m->face_groups || !m->node_size || !m->anatomical)
        return fail(why, TROCAR_NO_MEMORY, "%s: no memory for %d tetrahedra", name, m->tet_count);
    m->boundary_count = 0;
    trocar_status status = check_nodes(m, name, why);
    if (status == TROCAR_OK) status = orient_tets(m, name, why);
    if (status == TROCAR_OK) status = measure_nodes(m, name, why);
    if (status == TROCAR_OK) status = join_faces(m, triangle_count, triangles, triangle_group, name, why);
    if (status == TROCAR_OK) status = finish_boundary(m, name, why);
    return status;
}

void mesh_free(mesh *m) {
    for (int g = 0; g < m->group_count; g++) free(m->groups[g].nodes);
    free(m->nodes);
    free(m->tets);
    free(m->neighbours);
    free(m->region);
    free(m->face_groups);
    free(m->boundary);
    free(m->bvh);
    free(m->bvh_order);
    free(m->node_size);
    free(m->anatomical);
    memset(m, 0, sizeof *m);
}

int mesh_find_group(const mesh *m, const char *name, int dimension) {
    for (int g = 0; g < m->group_count; g++)
        if (strcmp(m->groups[g].name, name) == 0 && (dimension < 0 || m->groups[g].dimension == dimension)) return g;
    return -1;
}

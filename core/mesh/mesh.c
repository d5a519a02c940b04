#include "mesh/mesh.h"

#include <stdlib.h>
#include <string.h>

#include "base/hash.h"

static const double INSIDE = -1e-12; /* dimensionless: smallest barycentric weight of a point that counts as inside. Rounding tolerance */

/* ---- geometry of one tetrahedron ---- */

void mesh_corners(const mesh *m, int tet, vec3 corners[4]) {
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

double mesh_volume(const mesh *m, int tet) {
    vec3 corners[4];
    mesh_corners(m, tet, corners);
    vec3 a = v3_sub(corners[1], corners[0]), b = v3_sub(corners[2], corners[0]), c = v3_sub(corners[3], corners[0]);
    return v3_dot(a, v3_cross(b, c)) / 6.0;
}

void tet_barycentric(const vec3 corners[4], vec3 x, double weights[4]) {
    vec3 a = v3_sub(corners[1], corners[0]), b = v3_sub(corners[2], corners[0]), c = v3_sub(corners[3], corners[0]), to = v3_sub(x, corners[0]);
    vec3 bc = v3_cross(b, c);
    double scale = 1.0 / v3_dot(a, bc);
    weights[1] = scale * v3_dot(bc, to);
    weights[2] = scale * v3_dot(v3_cross(c, a), to);
    weights[3] = scale * v3_dot(v3_cross(a, b), to);
    weights[0] = 1.0 - (weights[1] + weights[2] + weights[3]);
}

void mesh_barycentric(const mesh *m, int tet, vec3 x, double weights[4]) {
    vec3 corners[4];
    mesh_corners(m, tet, corners);
    tet_barycentric(corners, x, weights);
}

double mesh_edge_length(const mesh *m, int tet) {
    double sum = 0.0;
    for (int c = 0; c < 4; c++) sum += 0.25 * m->node_size[m->tets[tet][c]];
    return sum;
}

vec3 mesh_point(const mesh *m, int tet, const double weights[4]) {
    vec3 x = v3(0, 0, 0);
    for (int i = 0; i < 4; i++) x = v3_axpy(weights[i], m->nodes[m->tets[tet][i]], x);
    return x;
}

vec3 mesh_face_normal(const mesh *m, int tet, int face) {
    vec3 corners[4], gradients[4];
    mesh_corners(m, tet, corners);
    tet_gradients(corners, gradients);
    return v3_unit(gradients[face]);
}

/* The barycentric coordinate of vertex i changes linearly along d and is zero on face i. In this function, coordinates and their rates are scaled by six
   times the volume. */
int mesh_exit(const mesh *m, int tet, vec3 x, vec3 d, double *distance) {
    const int *corners = m->tets[tet];
    vec3 first = m->nodes[corners[0]], to = v3_sub(x, first);
    vec3 a = v3_sub(m->nodes[corners[1]], first), b = v3_sub(m->nodes[corners[2]], first), c = v3_sub(m->nodes[corners[3]], first);
    vec3 bc = v3_cross(b, c), ca = v3_cross(c, a), ab = v3_cross(a, b);
    double weights[4] = {0.0, v3_dot(bc, to), v3_dot(ca, to), v3_dot(ab, to)}, rates[4] = {0.0, v3_dot(bc, d), v3_dot(ca, d), v3_dot(ab, d)};
    weights[0] = v3_dot(a, bc) - (weights[1] + weights[2] + weights[3]);
    rates[0] = -(rates[1] + rates[2] + rates[3]);
    int exit = -1;
    double nearest = INFINITY, steepest = 0;
    for (int i = 0; i < 4; i++) {
        double reach = larger_of(weights[i], 0.0) / -rates[i];
        if (rates[i] < 0 && (reach < nearest || (reach == nearest && rates[i] < steepest))) {
            exit = i;
            nearest = reach;
            steepest = rates[i];
        }
    }
    if (exit >= 0) *distance = nearest;
    return exit;
}

/* ---- around a node ---- */

int mesh_corner_of(const mesh *m, int tet, int node) {
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
            int other = mesh_bonded(m, tets[next], i);
            bool known = other < 0 || mesh_corner_of(m, other, node) < 0;
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

/* Walks from element to element through the face with the most negative barycentric coordinate. If the walk cycles, or leaves a non-convex body, tests all
   tetrahedra. */
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

/* ---- remarks ---- */

void mesh_remark(mesh *m, const char *format, ...) {
    char *text = m->remarks.text;
    size_t used = strlen(text), size = sizeof m->remarks.text;
    if (used > 0 && used + 2 < size) strcpy(text + used, "; "), used += 2;
    va_list arguments;
    va_start(arguments, format);
    decimal_vprint(text + used, size - used, format, arguments);
    va_end(arguments);
}

static const double LARGEST_BODY = 10.0; /* needle lengths: body size above which a remark warns that the unit may be wrong. Chosen by judgement */
static const double SMALLEST_BODY = 0.05; /* needle lengths: body size below which a remark warns that the unit may be wrong. Chosen by judgement */
static const double COARSEST = 50.0; /* needle diameters: element size above which a remark warns that the mesh is coarse. Chosen by judgement */

void mesh_compare_with_needle(mesh *m, double length, double diameter) {
    double size = v3_norm(v3_sub(m->bvh[0].high, m->bvh[0].low)), least = INFINITY;
    for (int n = 0; n < m->node_count; n++) least = fmin(least, m->node_size[n]);
    if (size > LARGEST_BODY * length || size < SMALLEST_BODY * length)
        mesh_remark(m, "the body is %.3g m across and the needle %.3g m long: is the mesh in another unit? Set mesh_unit (m, cm, mm) in the scene",
                    size, length);
    else if (least > COARSEST * diameter)
        mesh_remark(m, "the needle's diameter, %.3g m, is much smaller than the smallest elements, %.3g m: refine the mesh, or check mesh_unit and the "
                    "needle's diameter", diameter, least);
}

/* ---- the whole mesh ---- */

void mesh_free(mesh *m) {
    for (int g = 0; g < m->group_count; g++) free(m->groups[g].nodes);
    free(m->nodes);
    free(m->tets);
    free(m->neighbours);
    free(m->slides);
    free(m->original);
    free(m->pairs);
    free(m->region);
    free(m->face_groups);
    free(m->boundary);
    free(m->bvh);
    free(m->bvh_order);
    free(m->node_size);
    free(m->anatomical);
    memset(m, 0, sizeof *m);
}

bool mesh_set_group(mesh_group *group, int node_count, const bool *members) {
    int count = 0;
    for (int n = 0; n < node_count; n++) count += members[n];
    int *nodes = malloc(((size_t)count + 1) * sizeof *nodes);
    if (!nodes) return false;
    for (int n = 0, k = 0; n < node_count; n++)
        if (members[n]) nodes[k++] = n;
    free(group->nodes);
    group->nodes = nodes;
    group->node_count = count;
    return true;
}

int mesh_find_group(const mesh *m, const char *name, int dimension) {
    for (int g = 0; g < m->group_count; g++)
        if (strcmp(m->groups[g].name, name) == 0 && (dimension < 0 || m->groups[g].dimension == dimension)) return g;
    return -1;
}

uint64_t mesh_hash(uint64_t h, const mesh *m) {
    h = hash_bytes(h, m->nodes, (size_t)m->node_count * sizeof *m->nodes);
    h = hash_bytes(h, m->tets, (size_t)m->tet_count * sizeof *m->tets);
    return hash_bytes(h, m->region, (size_t)m->tet_count * sizeof *m->region);
}

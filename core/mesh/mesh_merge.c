#include "mesh/mesh_merge.h"

#include <stdlib.h>

#include "mesh/union_find.h"

static const double SAME_PLACE = 1e-6; /* fraction: distance, relative to the size of the body, within which nodes coincide. Rounding tolerance for files
                                          in single precision */
static const vec3 ORDER = {0.5773, 0.7211, 0.3834};               /* nodes are sorted along this direction, which is not aligned with a regular mesh's axes */
static const int FACES[4][3] = {{1, 2, 3}, {0, 2, 3}, {0, 1, 3}, {0, 1, 2}};

typedef struct { double along; int node; } placed_node;
typedef struct { int place[3], nodes[3]; } placed_face;            /* place: the lowest node index at the position of each corner, ascending; nodes: the
                                                                      face's own nodes */

static int compare_placed(const void *left, const void *right) {
    const placed_node *a = left, *b = right;
    return a->along != b->along ? (a->along > b->along) - (a->along < b->along) : (a->node > b->node) - (a->node < b->node);
}

static int compare_faces(const void *left, const void *right) {
    const placed_face *a = left, *b = right;
    for (int i = 0; i < 3; i++)
        if (a->place[i] != b->place[i]) return (a->place[i] > b->place[i]) - (a->place[i] < b->place[i]);
    return 0;
}

static double body_size(const mesh *m) {
    vec3 low = m->nodes[0], high = low;
    for (int n = 1; n < m->node_count; n++) {
        vec3 x = m->nodes[n];
        low = v3(fmin(low.x, x.x), fmin(low.y, x.y), fmin(low.z, x.z));
        high = v3(fmax(high.x, x.x), fmax(high.y, x.y), fmax(high.z, x.z));
    }
    return v3_norm(v3_sub(high, low));
}

/* Sets place[n] to the lowest-numbered node at the position of node n. Returns the number of pairs of coincident nodes. */
static int find_places(const mesh *m, placed_node *order, int *place) {
    double near = SAME_PLACE * body_size(m);
    int shared = 0;
    if (!(near > 0.0 && near < INFINITY)) near = -1.0; /* rejected later by mesh_finish */
    for (int n = 0; n < m->node_count; n++) {
        order[n] = (placed_node){v3_dot(ORDER, m->nodes[n]), n};
        place[n] = n;
    }
    qsort(order, (size_t)m->node_count, sizeof *order, compare_placed);
    for (int i = 0; i < m->node_count; i++)
        for (int k = i + 1; k < m->node_count && order[k].along - order[i].along <= near; k++) {
            int a = order[i].node, b = order[k].node;
            if (v3_norm(v3_sub(m->nodes[a], m->nodes[b])) > near) continue;
            int first = place[a] < place[b] ? place[a] : place[b];
            place[a] = place[b] = first;
            shared++;
        }
    return shared;
}

static bool shares_places(const bool *shared, const int nodes[4], int face) {
    for (int k = 0; k < 3; k++)
        if (!shared[nodes[FACES[face][k]]]) return false;
    return true;
}

static placed_face face_at(const int *place, const int nodes[4], int face) {
    placed_face f;
    for (int k = 0; k < 3; k++) {
        int node = nodes[FACES[face][k]], i = k;
        for (; i > 0 && f.place[i - 1] > place[node]; i--) {
            f.place[i] = f.place[i - 1];
            f.nodes[i] = f.nodes[i - 1];
        }
        f.place[i] = place[node];
        f.nodes[i] = node;
    }
    return f;
}

/* Joins the nodes of matching faces (union-find). On entry, parent[n] is n. */
static trocar_status join_faces(const mesh *m, const int *place, int *parent) {
    bool *shared = calloc((size_t)m->node_count, sizeof *shared);
    placed_face *faces = malloc(4 * (size_t)m->tet_count * sizeof *faces);
    size_t count = 0;
    if (shared && faces) {
        for (int n = 0; n < m->node_count; n++)
            if (place[n] != n) shared[n] = shared[place[n]] = true;
        for (int t = 0; t < m->tet_count; t++)
            for (int f = 0; f < 4; f++)
                if (shares_places(shared, m->tets[t], f)) faces[count++] = face_at(place, m->tets[t], f);
        qsort(faces, count, sizeof *faces, compare_faces);
        for (size_t i = 1; i < count; i++)
            for (int k = 0; k < 3 && compare_faces(&faces[i - 1], &faces[i]) == 0; k++) union_join(parent, faces[i - 1].nodes[k], faces[i].nodes[k]);
    }
    trocar_status status = shared && faces ? TROCAR_OK : TROCAR_NO_MEMORY;
    free(shared);
    free(faces);
    return status;
}

static void renumber(mesh *m, const int *place, int *parent, int *renumbered, mesh_merge_result *result) {
    int count = 0;
    for (int n = 0; n < m->node_count; n++) {
        int root = union_root(parent, n); /* at most n, so its new number is already known unless root == n */
        if (root == n && place[n] != n) result->apart++, result->example = n;
        renumbered[n] = root == n ? count : renumbered[root];
        if (root == n) m->nodes[count++] = m->nodes[n];
    }
    result->merged = m->node_count - count;
    m->node_count = count;
    for (int t = 0; t < m->tet_count; t++)
        for (int k = 0; k < 4; k++) m->tets[t][k] = renumbered[m->tets[t][k]];
}

trocar_status mesh_merge(mesh *m, int *renumbered, mesh_merge_result *result) {
    *result = (mesh_merge_result){.example = -1};
    size_t n = (size_t)m->node_count;
    placed_node *order = malloc(n * sizeof *order);
    int *place = malloc(2 * n * sizeof *place), *parent = place + n;
    trocar_status status = order && place ? TROCAR_OK : TROCAR_NO_MEMORY;
    for (int i = 0; i < m->node_count; i++) renumbered[i] = i;
    if (status == TROCAR_OK && find_places(m, order, place) > 0) {
        for (int i = 0; i < m->node_count; i++) parent[i] = i;
        status = join_faces(m, place, parent);
        if (status == TROCAR_OK) renumber(m, place, parent, renumbered, result);
    }
    free(order);
    free(place);
    return status;
}

/* Completes a mesh of nodes and elements: finds its orientation, neighbours, named surfaces and outer surface. Rejects invalid meshes. */
#include <stdlib.h>
#include <string.h>

#include "mesh/mesh.h"
#include "mesh/surface_tree.h"

/* Face i is opposite vertex i. In a tetrahedron of positive volume, the face's nodes are counter-clockwise as seen from outside. */
static const int FACE[4][3] = {{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}};

static const double FLAT = 1e-9; /* dimensionless: ratio of volume to longest edge^3 below which a tetrahedron counts as degenerate (0.118 for a regular one).
                                    Rounding tolerance */

/* ---- checks and orientation ---- */

static trocar_status check_nodes(const mesh *m, const char *name, trocar_error *why) {
    for (int n = 0; n < m->node_count; n++) {
        vec3 x = m->nodes[n];
        if (!isfinite(x.x) || !isfinite(x.y) || !isfinite(x.z))
            return fail(why, TROCAR_BAD_INPUT, "%s: node %d has a coordinate that is not finite: repair the mesh", name, n);
    }
    return TROCAR_OK;
}

static double longest_edge(const vec3 corners[4]) {
    double longest = 0;
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < i; j++) longest = fmax(longest, v3_norm(v3_sub(corners[i], corners[j])));
    return longest;
}

static trocar_status orient_tets(mesh *m, const char *name, trocar_error *why) {
    for (int t = 0; t < m->tet_count; t++) {
        int *v = m->tets[t];
        vec3 corners[4];
        mesh_corners(m, t, corners);
        double volume = mesh_volume(m, t), longest = longest_edge(corners);
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

/* Computes node_size: the mean edge length of regular tetrahedra with the same volumes as those around the node. */
static trocar_status measure_nodes(mesh *m, const char *name, trocar_error *why) {
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

/* ---- neighbours, named surfaces, boundary ---- */

typedef struct {
    int key[3];              /* nodes, ascending */
    bool odd;                /* true if the nodes, in outward order, are an odd permutation of the key */
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

/* Ties are broken by tetrahedron index, so that the order of records and boundary faces does not depend on the C library's sorting algorithm. */
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

/* Sets the neighbours. Two tetrahedra that share a face lie on opposite sides of it, so they must list its nodes in opposite orientations. */
static trocar_status join_neighbours(mesh *m, const face_record *faces, const char *name, trocar_error *why) {
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

/* Returns the first record with this key, or NULL. */
static const face_record *find_face(const face_record *faces, size_t count, const int key[3]) {
    size_t low = 0, high = count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if (compare_keys(faces[middle].key, key) < 0) low = middle + 1;
        else high = middle;
    }
    return low < count && compare_keys(faces[low].key, key) == 0 ? &faces[low] : NULL;
}

/* Triangles of named surfaces. */
typedef struct {
    int count;
    const int (*nodes)[3], *group;
} surface_triangles;

static trocar_status mark_surfaces(mesh *m, const face_record *faces, const surface_triangles *triangles, const char *name, trocar_error *why) {
    size_t count = 4 * (size_t)m->tet_count;
    for (int i = 0; i < triangles->count; i++) {
        int key[3] = {triangles->nodes[i][0], triangles->nodes[i][1], triangles->nodes[i][2]};
        bool odd;
        sort_key(key, &odd);
        const face_record *f = find_face(faces, count, key);
        if (!f)
            return fail(why, TROCAR_BAD_INPUT,
                        "%s: surface \"%s\" has a triangle (nodes %d %d %d) that is not a face of any tetrahedron: "
                        "mesh surface and volume together", name, m->groups[triangles->group[i]].name, key[0], key[1], key[2]);
        for (; f < faces + count && compare_keys(f->key, key) == 0; f++)
            m->face_groups[f->tet][f->face] |= UINT32_C(1) << triangles->group[i];
    }
    return TROCAR_OK;
}

/* Marks the nodes that define the shape of the anatomy. */
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

/* ---- the whole mesh ---- */

static trocar_status join_faces(mesh *m, const surface_triangles *triangles, const char *name, trocar_error *why) {
    face_record *faces = sorted_faces(m);
    if (!faces) return fail(why, TROCAR_NO_MEMORY, "%s: no memory for %d tetrahedra", name, m->tet_count);
    trocar_status status = join_neighbours(m, faces, name, why);
    if (status == TROCAR_OK) status = mark_surfaces(m, faces, triangles, name, why);
    if (status == TROCAR_OK) mark_anatomy(m);
    free(faces);
    return status;
}

static trocar_status finish_boundary(mesh *m, const char *name, trocar_error *why) {
    m->boundary = malloc(m->boundary_count * sizeof *m->boundary);
    if (m->boundary) collect_boundary(m);
    return m->boundary && surface_tree_build(m) ? TROCAR_OK
                                                : fail(why, TROCAR_NO_MEMORY, "%s: no memory for %d boundary faces", name, m->boundary_count);
}

trocar_status mesh_finish(mesh *m, int triangle_count, const int (*triangles)[3], const int *triangle_group,
                          const char *name, trocar_error *why) {
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
    if (status == TROCAR_OK) status = join_faces(m, &(surface_triangles){triangle_count, triangles, triangle_group}, name, why);
    if (status == TROCAR_OK) status = finish_boundary(m, name, why);
    return status;
}

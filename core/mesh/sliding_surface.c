#include "mesh/sliding_surface.h"

#include <stdlib.h>
#include <string.h>

#include "mesh/union_find.h"

/* What is known of the mesh while it is being split. */
typedef struct {
    mesh *mesh;
    int count;
    const sliding_surface *surfaces;
    int node_count;          /* before splitting */
    int *first, *around;     /* tetrahedra around node n: around[first[n]] to around[first[n + 1] - 1] */
    int *parent;             /* [tet_count]: sets of connected tetrahedra around the current node (union_find.h) */
    int most;                /* room for nodes */
    int slides;              /* number of faces, counted once, on which the tissue slides */
} splitting;

static bool is_on(const mesh *m, const sliding_surface *surface, int tet, int face) {
    int other = m->neighbours[tet][face];
    if (other < 0 || !(m->face_groups[tet][face] >> surface->group & 1) || m->region[tet] == m->region[other]) return false;
    return surface->beside < 0 || m->region[tet] == surface->beside || m->region[other] == surface->beside;
}

/* Returns the index of the first surface that contains the face, or -1. */
static int surface_at(const splitting *s, int tet, int face) {
    for (int i = 0; i < s->count; i++)
        if (is_on(s->mesh, &s->surfaces[i], tet, face)) return i;
    return -1;
}

static trocar_status mark_faces(splitting *s, const char *name, trocar_error *why) {
    mesh *m = s->mesh;
    int found[MESH_MAX_GROUPS] = {0};
    for (int i = 0; i < 4 * m->tet_count; i++) {
        int surface = surface_at(s, i / 4, i % 4);
        if (surface < 0) continue;
        m->slides[i / 4] |= (uint8_t)(1 << i % 4);
        found[surface]++;
        s->slides++;
    }
    for (int i = 0; i < s->count; i++) {
        int beside = s->surfaces[i].beside;
        if (found[i] == 0)
            return fail(why, TROCAR_BAD_INPUT, "sliding: no face of \"%s\" in %s lies between %s%s%s", m->groups[s->surfaces[i].group].name, name,
                        beside < 0 ? "two regions" : "\"", beside < 0 ? "" : m->groups[beside].name, beside < 0 ? "" : "\" and another region");
    }
    s->slides /= 2; /* each was seen from both sides */
    return TROCAR_OK;
}

static void list_tets_around(splitting *s) {
    const mesh *m = s->mesh;
    for (int i = 0; i < 4 * m->tet_count; i++) s->first[m->tets[i / 4][i % 4] + 1]++;
    for (int n = 0; n < m->node_count; n++) s->first[n + 1] += s->first[n];
    for (int i = 4 * m->tet_count - 1; i >= 0; i--) { /* fills each list from its end, so that first[n + 1] ends up where list n begins */
        int n = m->tets[i / 4][i % 4];
        s->around[--s->first[n + 1]] = i / 4;
    }
    memmove(s->first, s->first + 1, (size_t)m->node_count * sizeof *s->first);
    s->first[m->node_count] = 4 * m->tet_count;
}

/* ---- nodes ------------------------------------------------------------------------------------------------------------- */

/* Joins the tetrahedra around the node that share a face with it on which the tissue does not slide. */
static void connect_around(splitting *s, int node) {
    const mesh *m = s->mesh;
    for (int i = s->first[node]; i < s->first[node + 1]; i++) s->parent[s->around[i]] = s->around[i];
    for (int i = s->first[node]; i < s->first[node + 1]; i++) {
        int tet = s->around[i];
        for (int face = 0; face < 4; face++) {
            int other = mesh_bonded(m, tet, face);
            if (other >= 0 && face != mesh_corner_of(m, tet, node)) union_join(s->parent, tet, other);
        }
    }
}

static int copy_node(splitting *s, int node) {
    mesh *m = s->mesh;
    int copy = m->node_count++;
    m->nodes[copy] = m->nodes[node];
    m->node_size[copy] = m->node_size[node];
    m->anatomical[copy] = m->anatomical[node];
    m->original[copy] = node;
    return copy;
}

/* The set of the lowest tetrahedron keeps the node; each other set gets a copy. */
static void split_node(splitting *s, int node) {
    mesh *m = s->mesh;
    connect_around(s, node);
    int from = s->first[node], to = s->first[node + 1];
    for (int i = from; i < to; i++) {
        int root = union_root(s->parent, s->around[i]);
        if (root != s->around[i] || root == s->around[from]) continue;
        int copy = copy_node(s, node);
        for (int k = from; k < to; k++)
            if (union_root(s->parent, s->around[k]) == root) m->tets[s->around[k]][mesh_corner_of(m, s->around[k], node)] = copy;
    }
}

/* Visits the nodes in ascending order. While a node is being split, the tetrahedra around it still share it with their neighbours. */
static void split_nodes(splitting *s) {
    const mesh *m = s->mesh;
    for (int node = 0; node < s->node_count; node++) {
        bool touched = false;
        for (int i = s->first[node]; i < s->first[node + 1] && !touched; i++)
            touched = (m->slides[s->around[i]] & ~(1 << mesh_corner_of(m, s->around[i], node))) != 0;
        if (touched) split_node(s, node);
    }
}

/* ---- groups and pairs ------------------------------------------------------------------------------------------------- */

/* Adds the copies to the groups of their originals. A region gets only those copies that its tetrahedra use, and loses nodes that they no longer use. */
static trocar_status renew_group(const splitting *s, int index, bool *member, trocar_error *why) {
    const mesh *m = s->mesh;
    mesh_group *group = &s->mesh->groups[index];
    memset(member, 0, (size_t)m->node_count * sizeof *member);
    for (int k = 0; k < group->node_count && group->dimension < 3; k++) member[group->nodes[k]] = true;
    for (int n = s->node_count; n < m->node_count; n++) member[n] = member[m->original[n]];
    for (int i = 0; i < 4 * m->tet_count && group->dimension == 3; i++)
        if (m->region[i / 4] == index) member[m->tets[i / 4][i % 4]] = true;
    return mesh_set_group(group, m->node_count, member) ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the nodes of \"%s\"", group->name);
}

/* Adds a third of a face to the pair of nodes at one of its corners. */
static void add_to_pair(mesh *m, const node_pair *share) {
    int i = 0;
    while (i < m->pair_count && (m->pairs[i].nodes[0] != share->nodes[0] || m->pairs[i].nodes[1] != share->nodes[1] || m->pairs[i].group != share->group)) i++;
    if (i == m->pair_count) m->pairs[m->pair_count++] = (node_pair){.nodes = {share->nodes[0], share->nodes[1]}, .group = share->group};
    m->pairs[i].normal = v3_add(m->pairs[i].normal, share->normal);
    m->pairs[i].area += share->area;
}

/* Returns the node of tetrahedron `tet` at the place of `node`. */
static int node_at(const splitting *s, int tet, int node) {
    const int *corners = s->mesh->tets[tet];
    int c = 0;
    while (s->mesh->original[corners[c]] != s->mesh->original[node]) c++;
    return corners[c];
}

/* Pairs the nodes of a face on its two sides. */
static void pair_face(splitting *s, int group, int tet, int face) {
    mesh *m = s->mesh;
    const int *corners = m->tets[tet];
    int a = (face + 1) % 4, b = (face + 2) % 4, c = (face + 3) % 4, other = m->neighbours[tet][face];
    double area = 0.5 * v3_norm(v3_cross(v3_sub(m->nodes[corners[b]], m->nodes[corners[a]]), v3_sub(m->nodes[corners[c]], m->nodes[corners[a]])));
    vec3 to_other = v3_scale(-area / 3.0, mesh_face_normal(m, tet, face));
    for (int k = 1; k < 4; k++) {
        int node = corners[(face + k) % 4], partner = node_at(s, other, node);
        if (node < partner) add_to_pair(m, &(node_pair){{node, partner}, group, to_other, area / 3.0});
        if (node > partner) add_to_pair(m, &(node_pair){{partner, node}, group, v3_scale(-1.0, to_other), area / 3.0});
    }
}

static void find_pairs(splitting *s) {
    mesh *m = s->mesh;
    for (int i = 0; i < 4 * m->tet_count; i++) {
        int surface = surface_at(s, i / 4, i % 4);
        if (surface >= 0 && i / 4 < m->neighbours[i / 4][i % 4]) pair_face(s, s->surfaces[surface].group, i / 4, i % 4);
    }
    for (int i = 0; i < m->pair_count; i++) m->pairs[i].normal = v3_unit(m->pairs[i].normal);
}

static void renew_boundary(const splitting *s) {
    for (int i = 0; i < s->mesh->boundary_count; i++)
        for (int k = 0; k < 3; k++) s->mesh->boundary[i].nodes[k] = node_at(s, s->mesh->boundary[i].tet, s->mesh->boundary[i].nodes[k]);
}

/* ---- the whole mesh --------------------------------------------------------------------------------------------------- */

/* Makes room for `more` nodes and pairs. */
static bool make_room(mesh *m, int more) {
    size_t nodes = (size_t)(m->node_count + more);
    vec3 *at = realloc(m->nodes, nodes * sizeof *at);
    if (at) m->nodes = at;
    double *size = realloc(m->node_size, nodes * sizeof *size);
    if (size) m->node_size = size;
    bool *anatomical = realloc(m->anatomical, nodes * sizeof *anatomical);
    if (anatomical) m->anatomical = anatomical;
    m->pairs = malloc((size_t)more * sizeof *m->pairs);
    return at && size && anatomical && m->pairs;
}

static bool begin(splitting *s) {
    const mesh *m = s->mesh;
    s->mesh->slides = calloc((size_t)m->tet_count, sizeof *m->slides);
    s->first = calloc((size_t)m->node_count + 2, sizeof *s->first);
    s->around = malloc(4 * (size_t)m->tet_count * sizeof *s->around);
    s->parent = malloc((size_t)m->tet_count * sizeof *s->parent);
    return m->slides && s->first && s->around && s->parent;
}

/* Each corner of a face adds at most one copy and one pair. */
static bool make_room_for_copies(splitting *s) {
    s->most = 3 * s->slides;
    int *original = s->mesh->original = malloc(((size_t)s->node_count + (size_t)s->most) * sizeof *original);
    for (int n = 0; original && n < s->node_count; n++) original[n] = n;
    return original && make_room(s->mesh, s->most);
}

static trocar_status split(splitting *s, trocar_error *why) {
    bool *member;
    trocar_status status = TROCAR_OK;
    list_tets_around(s);
    split_nodes(s);
    find_pairs(s);
    renew_boundary(s);
    if (!(member = malloc((size_t)s->mesh->node_count * sizeof *member))) return fail(why, TROCAR_NO_MEMORY, "no memory for %d nodes", s->mesh->node_count);
    for (int g = 0; g < s->mesh->group_count && status == TROCAR_OK; g++) status = renew_group(s, g, member, why);
    free(member);
    return status;
}

trocar_status mesh_let_slide(mesh *m, int count, const sliding_surface *surfaces, const char *name, trocar_error *why) {
    splitting s = {.mesh = m, .count = count, .surfaces = surfaces, .node_count = m->node_count};
    trocar_status status = begin(&s) ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "%s: no memory for %d tetrahedra", name, m->tet_count);
    if (status == TROCAR_OK) status = mark_faces(&s, name, why);
    if (status == TROCAR_OK && !make_room_for_copies(&s)) status = fail(why, TROCAR_NO_MEMORY, "%s: no memory for %d more nodes", name, s.most);
    if (status == TROCAR_OK) status = split(&s, why);
    free(s.first);
    free(s.around);
    free(s.parent);
    return status;
}

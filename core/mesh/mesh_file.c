/* Creates a mesh from the contents of a file: its tetrahedra, the nodes they use, and its physical groups. */
#include <errno.h>
#include <inttypes.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "base/input_file.h"
#include "mesh/gmsh_convert.h"
#include "mesh/mesh_merge.h"
#include "mesh/msh_reader.h"

/* The groups that contain a model entity: bit g is set for group g of the mesh. */
typedef struct { int dimension, entity; uint32_t groups; } entity_groups;

typedef struct {
    const char *path;
    double unit;             /* m */
    mesh *mesh;
    trocar_error *why;
    msh_contents file;
    int *index;              /* [file.node_count]: mesh index of each node in the file; -1 if no tetrahedron uses the node */
    int tags[MESH_MAX_GROUPS]; /* tags of the groups in the file */
    entity_groups *entities; /* [entity_count]: entities that belong to a group, sorted by dimension and tag */
    size_t entity_count;
    int (*triangles)[3];     /* node indices of the triangles on all named surfaces */
    int *triangle_group;
    int triangle_count;
} mesh_maker;

static trocar_status no_memory(const mesh_maker *r) { return fail(r->why, TROCAR_NO_MEMORY, "%s: no memory for the mesh", r->path); }

/* ---- the file ---- */

static trocar_status check_not_empty(const mesh_maker *r, FILE *file) {
    int first = fgetc(file), error = ferror(file) ? errno : 0;
    if (error) return fail(r->why, TROCAR_BAD_INPUT, "%s: cannot read the mesh: %s", r->path, strerror(error));
    if (first == EOF) return fail(r->why, TROCAR_BAD_INPUT, "%s: the mesh file is empty", r->path);
    return TROCAR_OK;
}

static trocar_status read_file(mesh_maker *r) {
    const char *why;
    FILE *file = input_open(r->path, &why);
    if (!file) return fail(r->why, TROCAR_BAD_INPUT, "%s: cannot open the mesh: %s", r->path, why);
    trocar_status status = check_not_empty(r, file);
    bool readable = status == TROCAR_OK && msh_is_readable(file);
    if (status == TROCAR_OK && !readable) {
        fclose(file);
        file = gmsh_convert(r->path, &status, r->why);
    }
    if (status == TROCAR_OK) status = msh_read(file, r->path, !readable, &r->file, r->why);
    if (file) fclose(file);
    if (status == TROCAR_OK && r->file.node_count == 0)
        status = fail(r->why, TROCAR_BAD_INPUT, "%s: contains no nodes: is it a mesh in a format that Gmsh reads?", r->path);
    return status;
}

/* Returns the index in file.nodes of the node with this tag, or -1. */
static int find_node(const mesh_maker *r, uint64_t tag) {
    uint64_t place = tag - r->file.nodes[0].tag; /* the index, if there are no gaps in the tags; wraps around for tags below the first */
    if (place < r->file.node_count && r->file.nodes[place].tag == tag) return (int)place;
    size_t low = 0, high = r->file.node_count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        if (r->file.nodes[middle].tag < tag) low = middle + 1;
        else high = middle;
    }
    return low < r->file.node_count && r->file.nodes[low].tag == tag ? (int)low : -1;
}

/* Returns the index in the mesh of the node with this tag, or -1 if no tetrahedron uses it. */
static int mesh_node(const mesh_maker *r, uint64_t tag) {
    int place = find_node(r, tag);
    return place < 0 ? -1 : r->index[place];
}

/* ---- physical groups ---- */

static const char *const KINDS[] = {"point", "curve", "surface", "volume"};

static trocar_status name_group(const mesh_maker *r, mesh_group *group, int tag) {
    const msh_name *name = NULL;
    for (size_t i = 0; i < r->file.name_count && !name; i++)
        if (r->file.names[i].dimension == group->dimension && r->file.names[i].tag == tag) name = &r->file.names[i];
    int length = name ? snprintf(group->name, MESH_NAME, "%s", name->text) : snprintf(group->name, MESH_NAME, "%s_%d", KINDS[group->dimension], tag);
    if (length >= MESH_NAME)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: the name of physical %s %d is longer than %d characters: shorten it", r->path, KINDS[group->dimension],
                    tag, MESH_NAME - 1);
    if (mesh_find_group(r->mesh, group->name, group->dimension) >= 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: two physical %ss are named \"%s\": rename one", r->path, KINDS[group->dimension], group->name);
    return TROCAR_OK;
}

/* Adds a group without nodes. */
static trocar_status add_group(mesh_maker *r, int dimension, int tag) {
    if (r->mesh->group_count == MESH_MAX_GROUPS)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: more than %d physical groups: merge or remove some", r->path, MESH_MAX_GROUPS);
    mesh_group group = {.dimension = dimension};
    trocar_status status = name_group(r, &group, tag);
    if (status != TROCAR_OK) return status;
    r->tags[r->mesh->group_count] = tag;
    r->mesh->groups[r->mesh->group_count++] = group;
    return TROCAR_OK;
}

static int group_of_tag(const mesh_maker *r, int dimension, int tag) {
    for (int g = 0; g < r->mesh->group_count; g++)
        if (r->mesh->groups[g].dimension == dimension && r->tags[g] == tag) return g;
    return -1;
}

/* Returns the group that follows (dimension, tag) when groups are sorted by dimension and tag; NULL if there is none. */
static const msh_membership *next_group(const mesh_maker *r, int dimension, int tag) {
    const msh_membership *next = NULL;
    for (size_t i = 0; i < r->file.membership_count; i++) {
        const msh_membership *m = &r->file.memberships[i];
        bool after = m->dimension != dimension ? m->dimension > dimension : m->tag > tag;
        bool nearer = !next || (m->dimension != next->dimension ? m->dimension < next->dimension : m->tag < next->tag);
        if (after && nearer) next = m;
    }
    return next;
}

/* Creates the groups, sorted by dimension and tag, but without their nodes. If no volume is in a physical group, all tetrahedra form the region "tissue". */
static trocar_status make_groups(mesh_maker *r) {
    trocar_status status = TROCAR_OK;
    bool has_volume = false;
    for (const msh_membership *m = next_group(r, -1, 0); m && status == TROCAR_OK; m = next_group(r, m->dimension, m->tag)) {
        status = add_group(r, m->dimension, m->tag);
        has_volume = has_volume || m->dimension == 3;
    }
    if (status != TROCAR_OK || has_volume) return status;
    if (r->mesh->group_count == MESH_MAX_GROUPS)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: %d physical groups, but none is a volume: name the volumes", r->path, MESH_MAX_GROUPS);
    r->tags[r->mesh->group_count] = 0;
    r->mesh->groups[r->mesh->group_count++] = (mesh_group){.name = "tissue", .dimension = 3};
    return TROCAR_OK;
}

static trocar_status collect_entities(mesh_maker *r) {
    r->entities = malloc((r->file.membership_count + 1) * sizeof *r->entities);
    if (!r->entities) return no_memory(r);
    for (size_t i = 0; i < r->file.membership_count; i++) {
        const msh_membership *m = &r->file.memberships[i];
        const entity_groups *last = r->entity_count > 0 ? &r->entities[r->entity_count - 1] : NULL;
        if (!last || last->dimension != m->dimension || last->entity != m->entity)
            r->entities[r->entity_count++] = (entity_groups){m->dimension, m->entity, 0};
        r->entities[r->entity_count - 1].groups |= UINT32_C(1) << group_of_tag(r, m->dimension, m->tag);
    }
    return TROCAR_OK;
}

/* Returns the groups that contain this element, one bit each. */
static uint32_t groups_of(const mesh_maker *r, const msh_element *e) {
    size_t low = 0, high = r->entity_count;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        const entity_groups *at = &r->entities[middle];
        if (at->dimension == e->dimension && at->entity == e->entity) return at->groups;
        if (at->dimension != e->dimension ? at->dimension < e->dimension : at->entity < e->entity) low = middle + 1;
        else high = middle;
    }
    return 0;
}

/* ---- tetrahedra ---- */

/* Finds the region of an element's entity: the only physical volume that contains it, or "tissue" if there are no physical volumes. */
static trocar_status find_region(const mesh_maker *r, const msh_element *e, int *region) {
    uint32_t groups = groups_of(r, e), others = groups & (groups - 1);
    *region = groups ? __builtin_ctz(groups) : group_of_tag(r, 3, 0);
    if (others)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: volume %d is in the regions \"%s\" and \"%s\": leave it in one physical volume", r->path, e->entity,
                    r->mesh->groups[*region].name, r->mesh->groups[__builtin_ctz(others)].name);
    if (*region < 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: the tetrahedra of volume %d are not in a physical volume: add them to one", r->path, e->entity);
    return TROCAR_OK;
}

/* Takes the tetrahedra from the file, in the order of their entities. At first, `mesh->tets` holds indices into file.nodes, and `index` is 0 for each node
   used. */
static trocar_status take_tets(mesh_maker *r) {
    mesh *m = r->mesh;
    size_t first = 0, count = r->file.element_count;
    while (first < count && r->file.elements[first].dimension < 3) first++;
    if (first == count) return fail(r->why, TROCAR_BAD_INPUT, "%s: contains no tetrahedra: mesh the volume", r->path);
    m->tets = malloc((count - first) * sizeof *m->tets);
    m->region = malloc((count - first) * sizeof *m->region);
    r->index = malloc(r->file.node_count * sizeof *r->index);
    if (!m->tets || !m->region || !r->index) return no_memory(r);
    for (size_t i = 0; i < r->file.node_count; i++) r->index[i] = -1;
    for (const msh_element *e = &r->file.elements[first]; m->tet_count < (int)(count - first); e++, m->tet_count++) {
        int t = m->tet_count;
        bool same = t > 0 && e->entity == e[-1].entity;
        trocar_status status = same ? TROCAR_OK : find_region(r, e, &m->region[t]);
        if (status != TROCAR_OK) return status;
        if (same) m->region[t] = m->region[t - 1];
        for (int k = 0; k < 4; k++) {
            int node = find_node(r, r->file.corners[e->first + (size_t)k]);
            if (node < 0)
                return fail(r->why, TROCAR_BAD_INPUT, "%s: a tetrahedron refers to node %" PRId64 ", which does not exist: export the file again", r->path,
                            (int64_t)r->file.corners[e->first + (size_t)k]);
            r->index[node] = 0;
            m->tets[t][k] = node;
        }
    }
    return TROCAR_OK;
}

/* Copies the nodes that are used to the mesh, in the same order. */
static trocar_status take_nodes(mesh_maker *r) {
    mesh *m = r->mesh;
    m->nodes = malloc(r->file.node_count * sizeof *m->nodes);
    if (!m->nodes) return no_memory(r);
    for (size_t i = 0; i < r->file.node_count; i++) {
        if (r->index[i] < 0) continue;
        const double *x = r->file.nodes[i].x;
        r->index[i] = m->node_count;
        m->nodes[m->node_count++] = v3(r->unit * x[0], r->unit * x[1], r->unit * x[2]);
    }
    for (int t = 0; t < m->tet_count; t++)
        for (int k = 0; k < 4; k++) m->tets[t][k] = r->index[m->tets[t][k]];
    return TROCAR_OK;
}

/* Joins separately meshed bodies at matching faces. Adds remarks about joined nodes and about faces that do not match. */
static trocar_status merge_nodes(mesh_maker *r) {
    mesh *m = r->mesh;
    mesh_merge_result result;
    int *renumbered = malloc((size_t)m->node_count * sizeof *renumbered);
    trocar_status status = renumbered ? mesh_merge(m, renumbered, &result) : TROCAR_NO_MEMORY;
    if (status == TROCAR_OK) {
        int64_t tag = 0;
        for (size_t i = 0; i < r->file.node_count; i++) {
            if (r->index[i] < 0) continue;
            if (r->index[i] == result.example) tag = (int64_t)r->file.nodes[i].tag;
            r->index[i] = renumbered[r->index[i]];
        }
        if (result.merged > 0)
            mesh_remark(m, "%s: merged %d duplicate nodes", r->path, result.merged);
        if (result.apart > 0)
            mesh_remark(m, "%s: %d nodes coincide with others (node %" PRId64 ", for example), but their faces do not match: the bodies are not connected "
                        "there; mesh them together if they should be", r->path, result.apart, tag);
    }
    free(renumbered);
    return status == TROCAR_OK ? TROCAR_OK : no_memory(r);
}

/* ---- nodes of the groups, and triangles of named surfaces ---- */

static trocar_status take_group_nodes(mesh_maker *r, int g) {
    mesh_group *group = &r->mesh->groups[g];
    const mesh *m = r->mesh;
    bool *marked = calloc((size_t)m->node_count, sizeof *marked);
    if (!marked) return no_memory(r);
    for (int t = 0; t < m->tet_count && group->dimension == 3; t++)
        for (int k = 0; k < 4 && m->region[t] == g; k++) marked[m->tets[t][k]] = true;
    for (size_t i = 0; i < r->file.element_count && group->dimension < 3; i++) {
        const msh_element *e = &r->file.elements[i];
        if (e->dimension != group->dimension || !(groups_of(r, e) >> g & 1)) continue;
        for (int k = 0; k < msh_element_nodes(e->type); k++) {
            int node = mesh_node(r, r->file.corners[e->first + (size_t)k]);
            if (node >= 0) marked[node] = true;
        }
    }
    bool taken = mesh_set_group(group, m->node_count, marked);
    free(marked);
    if (!taken) return no_memory(r);
    if (group->node_count == 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: physical group \"%s\" touches no tetrahedron: remove it or mesh it", r->path, group->name);
    return TROCAR_OK;
}

static trocar_status take_triangle(mesh_maker *r, const msh_element *e, int group) {
    int *nodes = r->triangles[r->triangle_count];
    for (int k = 0; k < 3; k++) {
        uint64_t tag = r->file.corners[e->first + (size_t)k];
        nodes[k] = mesh_node(r, tag);
        if (nodes[k] < 0)
            return fail(r->why, TROCAR_BAD_INPUT, "%s: surface \"%s\" has a triangle on node %" PRId64 ", which no tetrahedron uses: mesh surface and volume "
                        "together", r->path, r->mesh->groups[group].name, (int64_t)tag);
    }
    r->triangle_group[r->triangle_count++] = group;
    return TROCAR_OK;
}

static trocar_status take_triangles(mesh_maker *r) {
    size_t count = 0;
    for (size_t i = 0; i < r->file.element_count; i++)
        if (r->file.elements[i].type == MSH_TRIANGLE) count += (size_t)__builtin_popcount(groups_of(r, &r->file.elements[i]));
    if (count > INT_MAX / 4) return fail(r->why, TROCAR_BAD_INPUT, "%s: too many surface triangles", r->path);
    r->triangles = malloc((count + 1) * sizeof *r->triangles);
    r->triangle_group = malloc((count + 1) * sizeof *r->triangle_group);
    if (!r->triangles || !r->triangle_group) return no_memory(r);
    trocar_status status = TROCAR_OK;
    for (size_t i = 0; i < r->file.element_count; i++) {
        const msh_element *e = &r->file.elements[i];
        if (e->type != MSH_TRIANGLE) continue;
        for (uint32_t groups = groups_of(r, e); groups && status == TROCAR_OK; groups &= groups - 1) status = take_triangle(r, e, __builtin_ctz(groups));
    }
    return status;
}

/* ---- the whole mesh ---- */

static trocar_status make_mesh(mesh_maker *r) {
    trocar_status status = read_file(r);
    if (status == TROCAR_OK) status = make_groups(r);
    if (status == TROCAR_OK) status = collect_entities(r);
    if (status == TROCAR_OK) status = take_tets(r);
    if (status == TROCAR_OK) status = take_nodes(r);
    if (status == TROCAR_OK) status = merge_nodes(r);
    for (int g = 0; status == TROCAR_OK && g < r->mesh->group_count; g++) status = take_group_nodes(r, g);
    if (status == TROCAR_OK) status = take_triangles(r);
    return status;
}

trocar_status mesh_read_in(const char *path, double unit, mesh *m, trocar_error *why) {
    memset(m, 0, sizeof *m);
    mesh_maker r = {.path = path, .unit = unit, .mesh = m, .why = why};
    trocar_status status = make_mesh(&r);
    if (status == TROCAR_OK) status = mesh_finish(m, r.triangle_count, (const int(*)[3])r.triangles, r.triangle_group, path, why);
    msh_free(&r.file);
    free(r.index);
    free(r.entities);
    free(r.triangles);
    free(r.triangle_group);
    if (status != TROCAR_OK) mesh_free(m);
    return status;
}

/* Physical groups of a mesh file: names, nodes, and the triangles of named surfaces. */
#include <gmshc.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "mesh/gmsh_reader.h"

/* ---- names ---- */

static trocar_status name_group(gmsh_reader *r, mesh_group *group, int dimension, int tag) {
    static const char *const kinds[] = {"point", "curve", "surface", "volume"};
    char *name = NULL;
    int error = 0;
    gmshModelGetPhysicalName(dimension, tag, &name, &error);
    bool named = error == 0 && name && *name;
    int length = named ? snprintf(group->name, MESH_NAME, "%s", name)
                       : snprintf(group->name, MESH_NAME, "%s_%d", kinds[dimension], tag);
    gmshFree(name);
    if (length >= MESH_NAME)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: the name of physical %s %d is longer than %d characters: shorten it",
                    r->path, kinds[dimension], tag, MESH_NAME - 1);
    if (mesh_find_group(r->mesh, group->name, dimension) >= 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: two physical %ss are named \"%s\": rename one", r->path,
                    kinds[dimension], group->name);
    return TROCAR_OK;
}

/* Adds a group without nodes: the nodes used by tetrahedra are known only after all regions have been read. */
static trocar_status add_group(gmsh_reader *r, int dimension, int tag) {
    if (r->mesh->group_count == MESH_MAX_GROUPS)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: more than %d physical groups: merge or remove some", r->path,
                    MESH_MAX_GROUPS);
    mesh_group group = {.dimension = dimension};
    trocar_status status = name_group(r, &group, dimension, tag);
    if (status == TROCAR_OK) r->mesh->groups[r->mesh->group_count++] = group;
    return status;
}

trocar_status read_groups(gmsh_reader *r, int tags[MESH_MAX_GROUPS]) {
    int *pairs = NULL, error = 0;
    size_t count = 0;
    gmshModelGetPhysicalGroups(&pairs, &count, -1, &error);
    trocar_status status = error ? reader_gmsh_failed(r) : TROCAR_OK;
    bool has_volume = false;
    for (size_t i = 0; status == TROCAR_OK && i + 1 < count; i += 2) {
        status = add_group(r, pairs[i], pairs[i + 1]);
        if (status == TROCAR_OK) tags[r->mesh->group_count - 1] = pairs[i + 1];
        has_volume = has_volume || pairs[i] == 3;
    }
    gmshFree(pairs);
    if (status != TROCAR_OK || has_volume) return status;
    if (r->mesh->group_count == MESH_MAX_GROUPS)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: %d physical groups, but none is a volume: name the volumes", r->path,
                    MESH_MAX_GROUPS);
    tags[r->mesh->group_count] = 0;
    r->mesh->groups[r->mesh->group_count++] = (mesh_group){.name = "tissue", .dimension = 3};
    return TROCAR_OK;
}

int group_of_tag(const gmsh_reader *r, const int tags[], int dimension, int tag) {
    for (int g = 0; g < r->mesh->group_count; g++)
        if (r->mesh->groups[g].dimension == dimension && tags[g] == tag) return g;
    return -1;
}

/* ---- triangles of named surfaces ---- */

static trocar_status append_triangles(gmsh_reader *r, const size_t *corners, size_t added, int group) {
    size_t total = r->triangle_count + added;
    if (total > INT_MAX / 4) return fail(r->why, TROCAR_BAD_INPUT, "%s: too many surface triangles", r->path);
    int(*grown)[3] = realloc(r->triangles, total * sizeof *grown);
    if (grown) r->triangles = grown;
    int *grown_group = realloc(r->triangle_group, total * sizeof *grown_group);
    if (grown_group) r->triangle_group = grown_group;
    if (!grown || !grown_group) return reader_no_memory(r);
    for (size_t i = 0; i < added; i++, r->triangle_count++) {
        r->triangle_group[r->triangle_count] = group;
        for (int k = 0; k < 3; k++) {
            int node = reader_node(r, corners[3 * i + k]);
            if (node < 0)
                return fail(r->why, TROCAR_BAD_INPUT, "%s: surface \"%s\" has a triangle on node %zu, which no tetrahedron "
                            "uses: mesh surface and volume together", r->path, r->mesh->groups[group].name, corners[3 * i + k]);
            r->triangles[r->triangle_count][k] = node;
        }
    }
    return TROCAR_OK;
}

static trocar_status read_surface(gmsh_reader *r, int group, int tag) {
    int *entities = NULL, error = 0;
    size_t entity_count = 0;
    gmshModelGetEntitiesForPhysicalGroup(2, tag, &entities, &entity_count, &error);
    trocar_status status = error ? reader_gmsh_failed(r) : TROCAR_OK;
    for (size_t i = 0; status == TROCAR_OK && i < entity_count; i++) {
        size_t *elements = NULL, *corners = NULL, count = 0, corner_count = 0;
        gmshModelMeshGetElementsByType(GMSH_TRIANGLE, &elements, &count, &corners, &corner_count, entities[i], 0, 1, &error);
        if (error) status = reader_gmsh_failed(r);
        else if (count > 0) status = append_triangles(r, corners, count, group);
        gmshFree(elements);
        gmshFree(corners);
    }
    gmshFree(entities);
    return status;
}

/* ---- nodes of the groups ---- */

/* Marks the nodes of a physical group; returns Gmsh's error code. */
static int mark_physical(const gmsh_reader *r, int dimension, int tag, bool *marked) {
    size_t *tags = NULL, count = 0, coordinate_count = 0;
    double *coordinates = NULL;
    int error = 0;
    gmshModelMeshGetNodesForPhysicalGroup(dimension, tag, &tags, &count, &coordinates, &coordinate_count, &error);
    for (size_t i = 0; error == 0 && i < count; i++) {
        int node = reader_node(r, tags[i]);
        if (node >= 0) marked[node] = true;
    }
    gmshFree(tags);
    gmshFree(coordinates);
    return error;
}

static void mark_region(const mesh *m, int group, bool *marked) {
    for (int t = 0; t < m->tet_count; t++)
        for (int k = 0; k < 4 && m->region[t] == group; k++) marked[m->tets[t][k]] = true;
}

static trocar_status keep_marked(gmsh_reader *r, mesh_group *group, const bool *marked) {
    for (int n = 0; n < r->mesh->node_count; n++) group->node_count += marked[n];
    if (group->node_count == 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: physical group \"%s\" touches no tetrahedron: remove it or mesh it",
                    r->path, group->name);
    group->nodes = malloc(group->node_count * sizeof *group->nodes);
    if (!group->nodes) return reader_no_memory(r);
    for (int n = 0, i = 0; n < r->mesh->node_count; n++)
        if (marked[n]) group->nodes[i++] = n;
    return TROCAR_OK;
}

trocar_status read_group_nodes(gmsh_reader *r, int g, int tag) {
    mesh_group *group = &r->mesh->groups[g];
    bool *marked = calloc(r->mesh->node_count, sizeof *marked);
    if (!marked) return reader_no_memory(r);
    int error = 0;
    if (group->dimension == 3) mark_region(r->mesh, g, marked);
    else error = mark_physical(r, group->dimension, tag, marked);
    trocar_status status = error ? reader_gmsh_failed(r) : keep_marked(r, group, marked);
    free(marked);
    return status == TROCAR_OK && group->dimension == 2 ? read_surface(r, g, tag) : status;
}

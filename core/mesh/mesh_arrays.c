/* Creates a mesh from the caller's arrays. */
#include "mesh/mesh.h"

#include <stdlib.h>
#include <string.h>

static trocar_status check_indices(const trocar_mesh *g, trocar_error *why) {
    for (int i = 0; i < 4 * g->tet_count; i++)
        if (g->tets[i] < 0 || g->tets[i] >= g->node_count)
            return fail(why, TROCAR_BAD_INPUT, "mesh: tetrahedron %d has node %d, but there are %d nodes", i / 4, g->tets[i], g->node_count);
    for (int e = 0; e < g->tet_count && g->tet_region; e++)
        if (g->tet_region[e] < 0 || g->tet_region[e] >= g->region_count)
            return fail(why, TROCAR_BAD_INPUT, "mesh: tetrahedron %d is in region %d, but there are %d regions", e, g->tet_region[e], g->region_count);
    for (int i = 0; i < 3 * g->triangle_count; i++)
        if (g->triangles[i] < 0 || g->triangles[i] >= g->node_count)
            return fail(why, TROCAR_BAD_INPUT, "mesh: triangle %d has node %d, but there are %d nodes", i / 3, g->triangles[i], g->node_count);
    for (int i = 0; i < g->triangle_count; i++)
        if (g->triangle_surface[i] < 0 || g->triangle_surface[i] >= g->surface_count)
            return fail(why, TROCAR_BAD_INPUT, "mesh: triangle %d is on surface %d, but there are %d surfaces", i, g->triangle_surface[i], g->surface_count);
    return TROCAR_OK;
}

trocar_status mesh_arrays_check(const trocar_mesh *g, trocar_error *why) {
    if (g->node_count < 4 || g->tet_count < 1 || !g->nodes || !g->tets) return fail(why, TROCAR_BAD_INPUT, "mesh: no tetrahedra");
    if (g->node_count > INT32_MAX / 4 || g->tet_count > INT32_MAX / 4 || g->triangle_count < 0 || g->triangle_count > INT32_MAX / 4)
        return fail(why, TROCAR_BAD_INPUT, "mesh: %d nodes, %d tetrahedra and %d triangles: too many", g->node_count, g->tet_count, g->triangle_count);
    if (g->region_count < 1 || g->surface_count < 0 || g->region_count + g->surface_count > MESH_MAX_GROUPS || !g->regions)
        return fail(why, TROCAR_BAD_INPUT, "mesh: %d regions and %d surfaces; expected at least one region and at most %d in total", g->region_count,
                    g->surface_count, MESH_MAX_GROUPS);
    if ((g->triangle_count > 0 && !(g->triangles && g->triangle_surface)) || (g->surface_count > 0 && !g->surfaces))
        return fail(why, TROCAR_BAD_INPUT, "mesh: triangles given without triangle_surface, or surfaces without names");
    for (int i = 0; i < 3 * g->node_count; i++)
        if (!isfinite(g->nodes[i])) return fail(why, TROCAR_BAD_INPUT, "mesh: node %d has a coordinate that is not finite", i / 3);
    return check_indices(g, why);
}

static trocar_status name_group(mesh *m, const char *name, int dimension, trocar_error *why) {
    size_t length = name ? strlen(name) : 0;
    if (length == 0 || length >= MESH_NAME) return fail(why, TROCAR_BAD_INPUT, "mesh: the name of a region or surface must have 1 to %d characters", MESH_NAME - 1);
    if (mesh_find_group(m, name, -1) >= 0) return fail(why, TROCAR_BAD_INPUT, "mesh: two regions or surfaces are named \"%s\"", name);
    mesh_group *group = &m->groups[m->group_count++];
    memcpy(group->name, name, length + 1);
    group->dimension = dimension;
    return TROCAR_OK;
}

/* Collects the nodes of a group in ascending order. */
static trocar_status collect_nodes(mesh *m, const trocar_mesh *g, int index, trocar_error *why) {
    mesh_group *group = &m->groups[index];
    bool *marked = calloc((size_t)m->node_count, sizeof *marked);
    if (!marked) return fail(why, TROCAR_NO_MEMORY, "mesh: no memory");
    int surface = index - g->region_count;
    if (surface < 0) {
        for (int e = 0; e < m->tet_count; e++)
            for (int c = 0; c < 4 && m->region[e] == index; c++) marked[m->tets[e][c]] = true;
    } else {
        for (int t = 0; t < g->triangle_count; t++)
            for (int c = 0; c < 3 && g->triangle_surface[t] == surface; c++) marked[g->triangles[3 * t + c]] = true;
    }
    bool taken = mesh_set_group(group, m->node_count, marked);
    free(marked);
    if (!taken) return fail(why, TROCAR_NO_MEMORY, "mesh: no memory");
    return group->node_count > 0 ? TROCAR_OK
                                 : fail(why, TROCAR_BAD_INPUT, "mesh: \"%s\" has no %s", group->name, surface < 0 ? "tetrahedra" : "triangles");
}

/* Returns the group index of each triangle's surface; NULL if out of memory. */
static int *triangle_groups(const trocar_mesh *g) {
    int *groups = malloc(((size_t)g->triangle_count + 1) * sizeof *groups);
    for (int t = 0; groups && t < g->triangle_count; t++) groups[t] = g->region_count + g->triangle_surface[t];
    return groups;
}

static trocar_status copy_arrays(const trocar_mesh *g, mesh *m, trocar_error *why) {
    m->node_count = g->node_count;
    m->tet_count = g->tet_count;
    m->nodes = malloc((size_t)g->node_count * sizeof *m->nodes);
    m->tets = malloc((size_t)g->tet_count * sizeof *m->tets);
    m->region = calloc((size_t)g->tet_count, sizeof *m->region);
    if (!m->nodes || !m->tets || !m->region) return fail(why, TROCAR_NO_MEMORY, "mesh: no memory for %d nodes", g->node_count);
    memcpy(m->nodes, g->nodes, (size_t)g->node_count * sizeof *m->nodes);
    memcpy(m->tets, g->tets, (size_t)g->tet_count * sizeof *m->tets);
    if (g->tet_region) memcpy(m->region, g->tet_region, (size_t)g->tet_count * sizeof *m->region);
    trocar_status status = TROCAR_OK;
    for (int r = 0; r < g->region_count && status == TROCAR_OK; r++) status = name_group(m, g->regions[r], 3, why);
    for (int s = 0; s < g->surface_count && status == TROCAR_OK; s++) status = name_group(m, g->surfaces[s], 2, why);
    for (int i = 0; i < m->group_count && status == TROCAR_OK; i++) status = collect_nodes(m, g, i, why);
    return status;
}
_Static_assert(sizeof(vec3) == 3 * sizeof(double) && sizeof(int) == sizeof(int32_t), "arrays are copied byte by byte");

trocar_status mesh_from_arrays(const trocar_mesh *given, mesh *m, trocar_error *why) {
    memset(m, 0, sizeof *m);
    trocar_status status = mesh_arrays_check(given, why);
    if (status == TROCAR_OK) status = copy_arrays(given, m, why);
    int *groups = status == TROCAR_OK ? triangle_groups(given) : NULL;
    if (status == TROCAR_OK && !groups) status = fail(why, TROCAR_NO_MEMORY, "mesh: no memory");
    if (status == TROCAR_OK) status = mesh_finish(m, given->triangle_count, (const int (*)[3])given->triangles, groups, "mesh", why);
    free(groups);
    if (status != TROCAR_OK) mesh_free(m);
    return status;
}

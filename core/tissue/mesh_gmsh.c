/* Reading meshes. All that is known of Gmsh is in this file. */
#include <errno.h>
#include <gmshc.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>
#include <threads.h>

#include "tissue/mesh.h"
#include "tissue/mesh_merge.h"

enum { TRIANGLE = 2, TETRAHEDRON = 4 }; /* Gmsh's element types, linear */

typedef struct { size_t tag; int index; } numbered_node;

/* What is known while one file is read. */
typedef struct {
    const char *path;
    double unit;             /* m */
    mesh *mesh;
    report *why;
    numbered_node *nodes;    /* all nodes of the file, ascending tags; index -1 where no tetrahedron uses the node */
    int node_count;
    double *coordinates;     /* 3 node_count, in the order of `nodes` */
    size_t *corners;         /* 4 tet_count: node tags */
    int (*triangles)[3];     /* of all named surfaces, node indices */
    int *triangle_group;
    int triangle_count;
} reader;

static trocar_status no_memory(reader *r) { return fail(r->why, TROCAR_NO_MEMORY, "%s: no memory for the mesh", r->path); }

/* Gmsh's own words for its last failure. */
static trocar_status gmsh_failed(reader *r) {
    char *reason = NULL;
    int error = 0;
    gmshLoggerGetLastError(&reason, &error);
    bool known = error == 0 && reason && *reason;
    fail(r->why, TROCAR_BAD_INPUT, "%s: Gmsh cannot read this mesh%s%s: export it again, e.g. as .msh", r->path,
         known ? ": " : "", known ? reason : "");
    gmshFree(reason);
    return TROCAR_BAD_INPUT;
}

/* Gmsh takes a missing or unreadable file for an empty model. */
static trocar_status check_readable(reader *r) {
    FILE *file = fopen(r->path, "rb");
    if (!file) return fail(r->why, TROCAR_BAD_INPUT, "%s: cannot open the mesh: %s", r->path, strerror(errno));
    int first = fgetc(file), error = ferror(file) ? errno : 0;
    fclose(file);
    if (error) return fail(r->why, TROCAR_BAD_INPUT, "%s: cannot read the mesh: %s", r->path, strerror(error));
    if (first == EOF) return fail(r->why, TROCAR_BAD_INPUT, "%s: the mesh file is empty", r->path);
    return TROCAR_OK;
}

static trocar_status open_model(reader *r) {
    int error = 0;
    gmshOptionSetNumber("General.Terminal", 0, &error);
    gmshModelAdd("trocar", &error);
    if (error == 0) gmshMerge(r->path, &error);
    return error == 0 ? TROCAR_OK : gmsh_failed(r);
}

/* ---- nodes ---- */

static int compare_tags(const void *left, const void *right) {
    const numbered_node *a = left, *b = right;
    return (a->tag > b->tag) - (a->tag < b->tag);
}

static numbered_node *find_node(const reader *r, size_t tag) {
    numbered_node wanted = {tag, 0};
    return bsearch(&wanted, r->nodes, r->node_count, sizeof *r->nodes, compare_tags);
}

/* Index of the node in the mesh, -1 if no tetrahedron uses it. */
static int node_index(const reader *r, size_t tag) {
    const numbered_node *node = find_node(r, tag);
    return node ? node->index : -1;
}

/* Gmsh hands out the nodes entity by entity; ascending tags are the file's order for all that Gmsh writes. */
static trocar_status sort_nodes(reader *r, const size_t *tags, const double *coordinates, size_t count) {
    r->nodes = malloc(count * sizeof *r->nodes);
    r->coordinates = malloc(3 * count * sizeof *r->coordinates);
    if (!r->nodes || !r->coordinates) return no_memory(r);
    r->node_count = (int)count;
    for (int i = 0; i < r->node_count; i++) r->nodes[i] = (numbered_node){tags[i], i};
    qsort(r->nodes, count, sizeof *r->nodes, compare_tags);
    for (int i = 0; i < r->node_count; i++) {
        memcpy(&r->coordinates[3 * i], &coordinates[3 * r->nodes[i].index], 3 * sizeof *coordinates);
        r->nodes[i].index = -1;
    }
    return TROCAR_OK;
}

static trocar_status read_nodes(reader *r) {
    size_t *tags = NULL, count = 0, coordinate_count = 0, parameter_count = 0;
    double *coordinates = NULL, *parameters = NULL;
    int error = 0;
    gmshModelMeshGetNodes(&tags, &count, &coordinates, &coordinate_count, &parameters, &parameter_count, -1, -1, 0, 0,
                          &error);
    trocar_status status;
    if (error) status = gmsh_failed(r);
    else if (count == 0)
        status = fail(r->why, TROCAR_BAD_INPUT, "%s: holds no nodes: is it a mesh that Gmsh reads?", r->path);
    else if (count > INT_MAX / 3) status = fail(r->why, TROCAR_BAD_INPUT, "%s: too many nodes (%zu)", r->path, count);
    else status = sort_nodes(r, tags, coordinates, count);
    gmshFree(tags);
    gmshFree(coordinates);
    gmshFree(parameters);
    return status;
}

/* ---- groups ---- */

static trocar_status name_group(reader *r, mesh_group *group, int dimension, int tag) {
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

/* The new group has no nodes yet: those that tetrahedra use are known only when all regions are. */
static trocar_status add_group(reader *r, int dimension, int tag) {
    if (r->mesh->group_count == MESH_MAX_GROUPS)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: more than %d physical groups: merge or remove some", r->path,
                    MESH_MAX_GROUPS);
    mesh_group group = {.dimension = dimension};
    trocar_status status = name_group(r, &group, dimension, tag);
    if (status == TROCAR_OK) r->mesh->groups[r->mesh->group_count++] = group;
    return status;
}

/* Names the physical groups in Gmsh's order (dimension, then tag); without any volume among them all tetrahedra
   form the region "tissue". `tags` receives each group's tag. */
static trocar_status read_groups(reader *r, int tags[MESH_MAX_GROUPS]) {
    int *pairs = NULL, error = 0;
    size_t count = 0;
    gmshModelGetPhysicalGroups(&pairs, &count, -1, &error);
    trocar_status status = error ? gmsh_failed(r) : TROCAR_OK;
    bool has_volume = false;
    for (size_t i = 0; status == TROCAR_OK && i + 1 < count; i += 2) {
        status = add_group(r, pairs[i], pairs[i + 1]);
        if (status == TROCAR_OK) tags[r->mesh->group_count - 1] = pairs[i + 1];
        has_volume = has_volume || pairs[i] == 3;
    }
    gmshFree(pairs);
    if (status != TROCAR_OK || has_volume) return status;
    if (r->mesh->group_count == MESH_MAX_GROUPS)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: %d physical groups and no volume among them: name the volumes", r->path,
                    MESH_MAX_GROUPS);
    tags[r->mesh->group_count] = 0;
    r->mesh->groups[r->mesh->group_count++] = (mesh_group){.name = "tissue", .dimension = 3};
    return TROCAR_OK;
}

static int group_of_tag(const reader *r, const int tags[], int dimension, int tag) {
    for (int g = 0; g < r->mesh->group_count; g++)
        if (r->mesh->groups[g].dimension == dimension && tags[g] == tag) return g;
    return -1;
}

/* ---- tetrahedra ---- */

static trocar_status check_element_types(reader *r) {
    int *types = NULL, error = 0, other = 0;
    size_t count = 0;
    gmshModelMeshGetElementTypes(&types, &count, 3, -1, &error);
    for (size_t i = 0; error == 0 && i < count; i++)
        if (types[i] != TETRAHEDRON) other = types[i];
    gmshFree(types);
    if (error) return gmsh_failed(r);
    if (count == 0) return fail(r->why, TROCAR_BAD_INPUT, "%s: holds no tetrahedra: mesh the volume", r->path);
    if (!other) return TROCAR_OK;

    char *name = NULL;
    double *local = NULL;
    int dimension, order, nodes, primary;
    size_t local_count;
    gmshModelMeshGetElementProperties(other, &name, &dimension, &order, &nodes, &local, &local_count, &primary, &error);
    fail(r->why, TROCAR_BAD_INPUT, "%s: holds elements of type \"%s\": only linear tetrahedra (4 nodes) are supported",
         r->path, error == 0 && name ? name : "unknown");
    gmshFree(name);
    gmshFree(local);
    return TROCAR_BAD_INPUT;
}

/* The region that the model entity belongs to: exactly one physical volume, or the only region when there is none. */
static trocar_status region_of_entity(reader *r, const int tags[], int entity, int *region) {
    int *physical = NULL, error = 0;
    size_t count = 0;
    gmshModelGetPhysicalGroupsForEntity(3, entity, &physical, &count, &error);
    *region = group_of_tag(r, tags, 3, count > 0 && !error ? physical[0] : 0);
    int second = count > 1 && !error ? group_of_tag(r, tags, 3, physical[1]) : -1;
    gmshFree(physical);
    if (error) return gmsh_failed(r);
    if (count > 1 && second >= 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: volume %d is in the regions \"%s\" and \"%s\": leave it in one physical "
                    "volume", r->path, entity, r->mesh->groups[*region].name, r->mesh->groups[second].name);
    if (*region < 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: the tetrahedra of volume %d are in no physical volume: add them to one",
                    r->path, entity);
    return TROCAR_OK;
}

static trocar_status append_tets(reader *r, const size_t *corners, size_t added, int region) {
    size_t before = r->mesh->tet_count, total = before + added;
    if (total > INT_MAX / 16) return fail(r->why, TROCAR_BAD_INPUT, "%s: too many tetrahedra", r->path);
    size_t *grown_corners = realloc(r->corners, 4 * total * sizeof *grown_corners);
    if (grown_corners) r->corners = grown_corners;
    int *grown_region = realloc(r->mesh->region, total * sizeof *grown_region);
    if (grown_region) r->mesh->region = grown_region;
    if (!grown_corners || !grown_region) return no_memory(r);
    memcpy(&r->corners[4 * before], corners, 4 * added * sizeof *corners);
    for (size_t t = before; t < total; t++) r->mesh->region[t] = region;
    r->mesh->tet_count = (int)total;
    return TROCAR_OK;
}

static trocar_status read_tets_of_entity(reader *r, const int tags[], int entity) {
    size_t *elements = NULL, *corners = NULL, count = 0, corner_count = 0;
    int error = 0, region = -1;
    gmshModelMeshGetElementsByType(TETRAHEDRON, &elements, &count, &corners, &corner_count, entity, 0, 1, &error);
    trocar_status status = error ? gmsh_failed(r) : TROCAR_OK;
    if (status == TROCAR_OK && count > 0) {
        status = region_of_entity(r, tags, entity, &region);
        if (status == TROCAR_OK) status = append_tets(r, corners, count, region);
    }
    gmshFree(elements);
    gmshFree(corners);
    return status;
}

static trocar_status read_tets(reader *r, const int tags[]) {
    int *pairs = NULL, error = 0;
    size_t count = 0;
    gmshModelGetEntities(&pairs, &count, 3, &error);
    trocar_status status = error ? gmsh_failed(r) : TROCAR_OK;
    for (size_t i = 0; status == TROCAR_OK && i + 1 < count; i += 2) status = read_tets_of_entity(r, tags, pairs[i + 1]);
    gmshFree(pairs);
    return status;
}

/* Drops the nodes that no tetrahedron uses, keeps the order of the others, and numbers the tetrahedra's corners. */
static trocar_status compact_nodes(reader *r) {
    mesh *m = r->mesh;
    for (size_t i = 0; i < 4 * (size_t)m->tet_count; i++) {
        numbered_node *node = find_node(r, r->corners[i]);
        if (!node)
            return fail(r->why, TROCAR_BAD_INPUT, "%s: a tetrahedron names node %zu, which the file lacks: export it again",
                        r->path, r->corners[i]);
        node->index = 0;
    }
    m->nodes = malloc(r->node_count * sizeof *m->nodes);
    m->tets = malloc(m->tet_count * sizeof *m->tets);
    if (!m->nodes || !m->tets) return no_memory(r);
    for (int i = 0; i < r->node_count; i++) {
        if (r->nodes[i].index < 0) continue;
        const double *x = &r->coordinates[3 * i];
        r->nodes[i].index = m->node_count;
        m->nodes[m->node_count++] = v3(r->unit * x[0], r->unit * x[1], r->unit * x[2]);
    }
    for (int t = 0; t < m->tet_count; t++)
        for (int k = 0; k < 4; k++) m->tets[t][k] = node_index(r, r->corners[4 * (size_t)t + k]);
    return TROCAR_OK;
}

/* Joins bodies that were meshed apart where their faces match; says so, and where they do not. */
static trocar_status merge_nodes(reader *r) {
    mesh *m = r->mesh;
    mesh_merge_result result;
    int *renumbered = malloc((size_t)m->node_count * sizeof *renumbered);
    trocar_status status = renumbered ? mesh_merge(m, renumbered, &result) : TROCAR_NO_MEMORY;
    if (status == TROCAR_OK) {
        int tag = 0;
        for (int i = 0; i < r->node_count; i++) {
            if (r->nodes[i].index < 0) continue;
            if (r->nodes[i].index == result.example) tag = (int)r->nodes[i].tag;
            r->nodes[i].index = renumbered[r->nodes[i].index];
        }
        if (result.merged > 0)
            mesh_remark(m, "%s: %d nodes that lie where others do were merged with these", r->path, result.merged);
        if (result.apart > 0)
            mesh_remark(m, "%s: %d nodes lie where others do (node %d, for one), but faces there do not match: the bodies are taken as touching, "
                        "not as grown together; mesh them together if they are one", r->path, result.apart, tag);
    }
    free(renumbered);
    return status == TROCAR_OK ? TROCAR_OK : no_memory(r);
}

/* ---- named surfaces ---- */

static trocar_status append_triangles(reader *r, const size_t *corners, size_t added, int group) {
    size_t total = r->triangle_count + added;
    if (total > INT_MAX / 4) return fail(r->why, TROCAR_BAD_INPUT, "%s: too many surface triangles", r->path);
    int(*grown)[3] = realloc(r->triangles, total * sizeof *grown);
    if (grown) r->triangles = grown;
    int *grown_group = realloc(r->triangle_group, total * sizeof *grown_group);
    if (grown_group) r->triangle_group = grown_group;
    if (!grown || !grown_group) return no_memory(r);
    for (size_t i = 0; i < added; i++, r->triangle_count++) {
        r->triangle_group[r->triangle_count] = group;
        for (int k = 0; k < 3; k++) {
            int node = node_index(r, corners[3 * i + k]);
            if (node < 0)
                return fail(r->why, TROCAR_BAD_INPUT, "%s: surface \"%s\" has a triangle on node %zu, which no tetrahedron "
                            "uses: mesh surface and volume together", r->path, r->mesh->groups[group].name, corners[3 * i + k]);
            r->triangles[r->triangle_count][k] = node;
        }
    }
    return TROCAR_OK;
}

static trocar_status read_surface(reader *r, int group, int tag) {
    int *entities = NULL, error = 0;
    size_t entity_count = 0;
    gmshModelGetEntitiesForPhysicalGroup(2, tag, &entities, &entity_count, &error);
    trocar_status status = error ? gmsh_failed(r) : TROCAR_OK;
    for (size_t i = 0; status == TROCAR_OK && i < entity_count; i++) {
        size_t *elements = NULL, *corners = NULL, count = 0, corner_count = 0;
        gmshModelMeshGetElementsByType(TRIANGLE, &elements, &count, &corners, &corner_count, entities[i], 0, 1, &error);
        if (error) status = gmsh_failed(r);
        else if (count > 0) status = append_triangles(r, corners, count, group);
        gmshFree(elements);
        gmshFree(corners);
    }
    gmshFree(entities);
    return status;
}

/* ---- nodes of the groups ---- */

/* Marks the nodes of a physical group; returns Gmsh's error code. */
static int mark_physical(const reader *r, int dimension, int tag, bool *marked) {
    size_t *tags = NULL, count = 0, coordinate_count = 0;
    double *coordinates = NULL;
    int error = 0;
    gmshModelMeshGetNodesForPhysicalGroup(dimension, tag, &tags, &count, &coordinates, &coordinate_count, &error);
    for (size_t i = 0; error == 0 && i < count; i++) {
        int node = node_index(r, tags[i]);
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

static trocar_status keep_marked(reader *r, mesh_group *group, const bool *marked) {
    for (int n = 0; n < r->mesh->node_count; n++) group->node_count += marked[n];
    if (group->node_count == 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: physical group \"%s\" touches no tetrahedron: remove it or mesh it",
                    r->path, group->name);
    group->nodes = malloc(group->node_count * sizeof *group->nodes);
    if (!group->nodes) return no_memory(r);
    for (int n = 0, i = 0; n < r->mesh->node_count; n++)
        if (marked[n]) group->nodes[i++] = n;
    return TROCAR_OK;
}

static trocar_status read_group_nodes(reader *r, int g, int tag) {
    mesh_group *group = &r->mesh->groups[g];
    bool *marked = calloc(r->mesh->node_count, sizeof *marked);
    if (!marked) return no_memory(r);
    int error = 0;
    if (group->dimension == 3) mark_region(r->mesh, g, marked);
    else error = mark_physical(r, group->dimension, tag, marked);
    trocar_status status = error ? gmsh_failed(r) : keep_marked(r, group, marked);
    free(marked);
    return status;
}

/* ---- the whole file ---- */

static trocar_status read_model(reader *r) {
    int tags[MESH_MAX_GROUPS]; /* of the physical groups */
    trocar_status status = open_model(r);
    if (status == TROCAR_OK) status = read_nodes(r);
    if (status == TROCAR_OK) status = check_element_types(r);
    if (status == TROCAR_OK) status = read_groups(r, tags);
    if (status == TROCAR_OK) status = read_tets(r, tags);
    if (status == TROCAR_OK) status = compact_nodes(r);
    if (status == TROCAR_OK) status = merge_nodes(r);
    for (int g = 0; status == TROCAR_OK && g < r->mesh->group_count; g++) {
        status = read_group_nodes(r, g, tags[g]);
        if (status == TROCAR_OK && r->mesh->groups[g].dimension == 2) status = read_surface(r, g, tags[g]);
    }
    return status;
}

/* Gmsh is one global. Where the host has a session of its own, the mesh becomes a model beside the host's, and goes again. */
static trocar_status read_in_session(reader *r) {
    int error = 0;
    double terminal = -1.0; /* stays so while Gmsh is not running */
    gmshOptionGetNumber("General.Terminal", &terminal, &error);
    bool hosted = error == 0 && terminal >= 0.0;
    char *host_model = NULL;
    error = 0;
    if (hosted) gmshModelGetCurrent(&host_model, &error);
    else gmshInitialize(0, NULL, 0, &error);
    if (error) return fail(r->why, TROCAR_SYSTEM, "%s: Gmsh does not start (error %d)", r->path, error);
    trocar_status status = read_model(r);
    if (!hosted) {
        gmshFinalize(&error);
        return status;
    }
    gmshModelRemove(&error);
    gmshModelSetCurrent(host_model, &error);
    gmshOptionSetNumber("General.Terminal", terminal, &error);
    gmshFree(host_model);
    return status;
}

static mtx_t session_lock;
static once_flag session_once = ONCE_FLAG_INIT;
static void create_lock(void) { mtx_init(&session_lock, mtx_plain); }
static mtx_t *gmsh_lock(void) {
    call_once(&session_once, create_lock);
    return &session_lock;
}

static void reader_free(reader *r) {
    free(r->nodes);
    free(r->coordinates);
    free(r->corners);
    free(r->triangles);
    free(r->triangle_group);
}

trocar_status mesh_read_in(const char *path, double unit, mesh *m, report *why) {
    memset(m, 0, sizeof *m);
    reader r = {.path = path, .unit = unit, .mesh = m, .why = why};
    trocar_status status = check_readable(&r);
    if (status != TROCAR_OK) return status;

    mtx_lock(gmsh_lock());
    status = read_in_session(&r);
    mtx_unlock(gmsh_lock());
    if (status == TROCAR_OK)
        status = mesh_finish(m, r.triangle_count, (const int(*)[3])r.triangles, r.triangle_group, path, why);
    reader_free(&r);
    if (status != TROCAR_OK) mesh_free(m);
    return status;
}

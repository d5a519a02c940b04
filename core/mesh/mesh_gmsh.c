/* Reads mesh files with Gmsh; only this file, gmsh_groups.c and gmsh_session.c use it. */
#include <errno.h>
#include <gmshc.h>
#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "base/input_file.h"
#include "mesh/gmsh_reader.h"
#include "mesh/gmsh_session.h"
#include "mesh/mesh_merge.h"

trocar_status reader_no_memory(gmsh_reader *r) { return fail(r->why, TROCAR_NO_MEMORY, "%s: no memory for the mesh", r->path); }

trocar_status reader_gmsh_failed(gmsh_reader *r) {
    char *reason = NULL;
    int error = 0;
    gmshLoggerGetLastError(&reason, &error);
    bool known = error == 0 && reason && *reason;
    fail(r->why, TROCAR_BAD_INPUT, "%s: Gmsh cannot read this mesh%s%s: export it again, e.g. as .msh", r->path,
         known ? ": " : "", known ? reason : "");
    gmshFree(reason);
    return TROCAR_BAD_INPUT;
}

/* Gmsh treats a missing or unreadable file as an empty model. */
static trocar_status check_readable(gmsh_reader *r) {
    const char *why;
    FILE *file = input_open(r->path, &why);
    if (!file) return fail(r->why, TROCAR_BAD_INPUT, "%s: cannot open the mesh: %s", r->path, why);
    int first = fgetc(file), error = ferror(file) ? errno : 0;
    fclose(file);
    if (error) return fail(r->why, TROCAR_BAD_INPUT, "%s: cannot read the mesh: %s", r->path, strerror(error));
    if (first == EOF) return fail(r->why, TROCAR_BAD_INPUT, "%s: the mesh file is empty", r->path);
    return TROCAR_OK;
}

static trocar_status open_model(gmsh_reader *r) {
    int error = 0;
    gmshOptionSetNumber("General.Terminal", 0, &error);
    gmshModelAdd("trocar", &error);
    if (error == 0) gmshMerge(r->path, &error);
    return error == 0 ? TROCAR_OK : reader_gmsh_failed(r);
}

/* ---- nodes ---- */

static int compare_tags(const void *left, const void *right) {
    const numbered_node *a = left, *b = right;
    return (a->tag > b->tag) - (a->tag < b->tag);
}

static numbered_node *find_node(const gmsh_reader *r, size_t tag) {
    size_t place = tag - r->nodes[0].tag; /* index in a file without gaps; wraps around below the first tag */
    if (place < (size_t)r->node_count && r->nodes[place].tag == tag) return &r->nodes[place];
    numbered_node wanted = {tag, 0};
    return bsearch(&wanted, r->nodes, r->node_count, sizeof *r->nodes, compare_tags);
}

int reader_node(const gmsh_reader *r, size_t tag) {
    const numbered_node *node = find_node(r, tag);
    return node ? node->index : -1;
}

/* Gmsh returns nodes entity by entity; ascending tags restore the order of files written by Gmsh. */
static trocar_status sort_nodes(gmsh_reader *r, const size_t *tags, const double *coordinates, size_t count) {
    r->nodes = malloc(count * sizeof *r->nodes);
    r->coordinates = malloc(3 * count * sizeof *r->coordinates);
    if (!r->nodes || !r->coordinates) return reader_no_memory(r);
    r->node_count = (int)count;
    for (int i = 0; i < r->node_count; i++) r->nodes[i] = (numbered_node){tags[i], i};
    qsort(r->nodes, count, sizeof *r->nodes, compare_tags);
    for (int i = 0; i < r->node_count; i++) {
        memcpy(&r->coordinates[3 * i], &coordinates[3 * r->nodes[i].index], 3 * sizeof *coordinates);
        r->nodes[i].index = -1;
    }
    return TROCAR_OK;
}

static trocar_status read_nodes(gmsh_reader *r) {
    size_t *tags = NULL, count = 0, coordinate_count = 0, parameter_count = 0;
    double *coordinates = NULL, *parameters = NULL;
    int error = 0;
    gmshModelMeshGetNodes(&tags, &count, &coordinates, &coordinate_count, &parameters, &parameter_count, -1, -1, 0, 0,
                          &error);
    trocar_status status;
    if (error) status = reader_gmsh_failed(r);
    else if (count == 0)
        status = fail(r->why, TROCAR_BAD_INPUT, "%s: contains no nodes: is it a mesh in a format that Gmsh reads?", r->path);
    else if (count > INT_MAX / 3) status = fail(r->why, TROCAR_BAD_INPUT, "%s: too many nodes (%zu)", r->path, count);
    else status = sort_nodes(r, tags, coordinates, count);
    gmshFree(tags);
    gmshFree(coordinates);
    gmshFree(parameters);
    return status;
}

/* ---- tetrahedra ---- */

static trocar_status check_element_types(gmsh_reader *r) {
    int *types = NULL, error = 0, other = 0;
    size_t count = 0;
    gmshModelMeshGetElementTypes(&types, &count, 3, -1, &error);
    for (size_t i = 0; error == 0 && i < count; i++)
        if (types[i] != GMSH_TETRAHEDRON) other = types[i];
    gmshFree(types);
    if (error) return reader_gmsh_failed(r);
    if (count == 0) return fail(r->why, TROCAR_BAD_INPUT, "%s: contains no tetrahedra: mesh the volume", r->path);
    if (!other) return TROCAR_OK;

    char *name = NULL;
    double *local = NULL;
    int dimension, order, nodes, primary;
    size_t local_count;
    gmshModelMeshGetElementProperties(other, &name, &dimension, &order, &nodes, &local, &local_count, &primary, &error);
    fail(r->why, TROCAR_BAD_INPUT, "%s: contains elements of type \"%s\": only linear tetrahedra (4 nodes) are supported",
         r->path, error == 0 && name ? name : "unknown");
    gmshFree(name);
    gmshFree(local);
    return TROCAR_BAD_INPUT;
}

/* Region of the model entity: its only physical volume, or "tissue" if there are no physical volumes. */
static trocar_status region_of_entity(gmsh_reader *r, const int tags[], int entity, int *region) {
    int *physical = NULL, error = 0;
    size_t count = 0;
    gmshModelGetPhysicalGroupsForEntity(3, entity, &physical, &count, &error);
    *region = group_of_tag(r, tags, 3, count > 0 && !error ? physical[0] : 0);
    int second = count > 1 && !error ? group_of_tag(r, tags, 3, physical[1]) : -1;
    gmshFree(physical);
    if (error) return reader_gmsh_failed(r);
    if (count > 1 && second >= 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: volume %d is in the regions \"%s\" and \"%s\": leave it in one physical "
                    "volume", r->path, entity, r->mesh->groups[*region].name, r->mesh->groups[second].name);
    if (*region < 0)
        return fail(r->why, TROCAR_BAD_INPUT, "%s: the tetrahedra of volume %d are not in a physical volume: add them to one",
                    r->path, entity);
    return TROCAR_OK;
}

static trocar_status append_tets(gmsh_reader *r, const size_t *corners, size_t added, int region) {
    size_t before = r->mesh->tet_count, total = before + added;
    if (total > INT_MAX / 16) return fail(r->why, TROCAR_BAD_INPUT, "%s: too many tetrahedra", r->path);
    size_t *grown_corners = realloc(r->corners, 4 * total * sizeof *grown_corners);
    if (grown_corners) r->corners = grown_corners;
    int *grown_region = realloc(r->mesh->region, total * sizeof *grown_region);
    if (grown_region) r->mesh->region = grown_region;
    if (!grown_corners || !grown_region) return reader_no_memory(r);
    memcpy(&r->corners[4 * before], corners, 4 * added * sizeof *corners);
    for (size_t t = before; t < total; t++) r->mesh->region[t] = region;
    r->mesh->tet_count = (int)total;
    return TROCAR_OK;
}

static trocar_status read_tets_of_entity(gmsh_reader *r, const int tags[], int entity) {
    size_t *elements = NULL, *corners = NULL, count = 0, corner_count = 0;
    int error = 0, region = -1;
    gmshModelMeshGetElementsByType(GMSH_TETRAHEDRON, &elements, &count, &corners, &corner_count, entity, 0, 1, &error);
    trocar_status status = error ? reader_gmsh_failed(r) : TROCAR_OK;
    if (status == TROCAR_OK && count > 0) {
        status = region_of_entity(r, tags, entity, &region);
        if (status == TROCAR_OK) status = append_tets(r, corners, count, region);
    }
    gmshFree(elements);
    gmshFree(corners);
    return status;
}

static trocar_status read_tets(gmsh_reader *r, const int tags[]) {
    int *pairs = NULL, error = 0;
    size_t count = 0;
    gmshModelGetEntities(&pairs, &count, 3, &error);
    trocar_status status = error ? reader_gmsh_failed(r) : TROCAR_OK;
    for (size_t i = 0; status == TROCAR_OK && i + 1 < count; i += 2) status = read_tets_of_entity(r, tags, pairs[i + 1]);
    gmshFree(pairs);
    return status;
}

/* Removes unused nodes, keeps the order of the others, and converts the corners of tetrahedra from tags to indices. */
static trocar_status compact_nodes(gmsh_reader *r) {
    mesh *m = r->mesh;
    for (size_t i = 0; i < 4 * (size_t)m->tet_count; i++) {
        numbered_node *node = find_node(r, r->corners[i]);
        if (!node)
            return fail(r->why, TROCAR_BAD_INPUT, "%s: a tetrahedron refers to node %zu, which does not exist: export the file again",
                        r->path, r->corners[i]);
        node->index = 0;
    }
    m->nodes = malloc(r->node_count * sizeof *m->nodes);
    m->tets = malloc(m->tet_count * sizeof *m->tets);
    if (!m->nodes || !m->tets) return reader_no_memory(r);
    for (int i = 0; i < r->node_count; i++) {
        if (r->nodes[i].index < 0) continue;
        const double *x = &r->coordinates[3 * i];
        r->nodes[i].index = m->node_count;
        m->nodes[m->node_count++] = v3(r->unit * x[0], r->unit * x[1], r->unit * x[2]);
    }
    for (int t = 0; t < m->tet_count; t++)
        for (int k = 0; k < 4; k++) m->tets[t][k] = reader_node(r, r->corners[4 * (size_t)t + k]);
    return TROCAR_OK;
}

/* Joins separately meshed bodies at matching faces; adds remarks about joined nodes and about faces that do not match. */
static trocar_status merge_nodes(gmsh_reader *r) {
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
            mesh_remark(m, "%s: merged %d duplicate nodes", r->path, result.merged);
        if (result.apart > 0)
            mesh_remark(m, "%s: %d nodes coincide with others (node %d, for example), but their faces do not match: the bodies are not connected there; "
                        "mesh them together if they should be", r->path, result.apart, tag);
    }
    free(renumbered);
    return status == TROCAR_OK ? TROCAR_OK : reader_no_memory(r);
}

/* ---- the whole file ---- */

static trocar_status read_model(void *context) {
    gmsh_reader *r = context;
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
    }
    return status;
}

static void reader_free(gmsh_reader *r) {
    free(r->nodes);
    free(r->coordinates);
    free(r->corners);
    free(r->triangles);
    free(r->triangle_group);
}

trocar_status mesh_read_in(const char *path, double unit, mesh *m, report *why) {
    memset(m, 0, sizeof *m);
    gmsh_reader r = {.path = path, .unit = unit, .mesh = m, .why = why};
    trocar_status status = check_readable(&r);
    if (status != TROCAR_OK) return status;

    status = gmsh_session_run(path, read_model, &r, why);
    if (status == TROCAR_OK)
        status = mesh_finish(m, r.triangle_count, (const int(*)[3])r.triangles, r.triangle_group, path, why);
    reader_free(&r);
    if (status != TROCAR_OK) mesh_free(m);
    return status;
}

/* Uses the core to compute a tissue's displacements under nodal forces, for the scripts in this folder.

   usage: solve_tissue MESH <INPUT >OUTPUT
   INPUT, one item per line: `strain patch`, `strain node` or `strain element` (volumetric_strain), `material REGION E NU`,
   `membrane SURFACE STIFFNESS NU` (N/m), `sliding SURFACE REGION NORMAL SHEAR` (N/m^3; one at most, before any `fixed`), `fixed GROUP`, `case` (begins a load
   case), `load NODE FX FY FZ`.
   OUTPUT: x y z of each node (m), then, for each case, ux uy uz of each node (m), all with 17 digits. Where the tissue slides, the nodes added on one side come
   last. */
#include <stdlib.h>
#include <string.h>

#include "inverse/inverse.h"
#include "mesh/sliding_surface.h"

typedef struct {
    mesh mesh;
    region_material materials[MESH_MAX_GROUPS];
    membrane_material membranes[MESH_MAX_GROUPS];
    sliding_material sliding[MESH_MAX_GROUPS];
    volumetric_strain strain;
    bool *fixed;
    tissue tissue;
    inverse *inverse;
    vec3 *force, *displacement;
    bool loaded;               /* whether a load case has started */
} problem;

static trocar_status set_material(problem *p, const char *line, trocar_error *why) {
    char name[MESH_NAME];
    region_material material = {0};
    if (sscanf(line, "material %63s %lf %lf", name, &material.youngs_modulus, &material.poisson_ratio) != 3)
        return fail(why, TROCAR_BAD_INPUT, "'%s': expected: material REGION E NU", line);
    int group = mesh_find_group(&p->mesh, name, 3);
    if (group < 0) return fail(why, TROCAR_BAD_INPUT, "material: the mesh has no region '%s'", name);
    p->materials[group] = material;
    return TROCAR_OK;
}

static trocar_status set_membrane(problem *p, const char *line, trocar_error *why) {
    char name[MESH_NAME];
    membrane_material material;
    if (sscanf(line, "membrane %63s %lf %lf", name, &material.stiffness, &material.poisson_ratio) != 3)
        return fail(why, TROCAR_BAD_INPUT, "'%s': expected: membrane SURFACE STIFFNESS NU", line);
    int group = mesh_find_group(&p->mesh, name, 2);
    if (group < 0) return fail(why, TROCAR_BAD_INPUT, "membrane: the mesh has no surface '%s'", name);
    p->membranes[group] = material;
    return TROCAR_OK;
}

static trocar_status make_arrays(problem *p, trocar_error *why) {
    size_t n = (size_t)p->mesh.node_count;
    free(p->fixed);
    free(p->force);
    free(p->displacement);
    p->fixed = calloc(n, sizeof *p->fixed);
    p->force = calloc(n, sizeof *p->force);
    p->displacement = calloc(n, sizeof *p->displacement);
    return p->fixed && p->force && p->displacement ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for %zu nodes", n);
}

static trocar_status set_sliding(problem *p, const char *line, trocar_error *why) {
    char name[MESH_NAME], region[MESH_NAME];
    sliding_material material;
    if (sscanf(line, "sliding %63s %63s %lf %lf", name, region, &material.normal, &material.shear) != 4)
        return fail(why, TROCAR_BAD_INPUT, "'%s': expected: sliding SURFACE REGION NORMAL SHEAR", line);
    sliding_surface surface = {mesh_find_group(&p->mesh, name, 2), mesh_find_group(&p->mesh, region, 3)};
    if (surface.group < 0 || surface.beside < 0) return fail(why, TROCAR_BAD_INPUT, "sliding: the mesh has no surface '%s' or no region '%s'", name, region);
    p->sliding[surface.group] = material;
    trocar_status status = mesh_let_slide(&p->mesh, 1, &surface, "mesh", why);
    return status == TROCAR_OK ? make_arrays(p, why) : status;
}

static trocar_status set_strain(problem *p, const char *line, trocar_error *why) {
    static const char *const words[] = {[STRAIN_BY_PATCH] = "patch", [STRAIN_BY_NODE] = "node", [STRAIN_BY_ELEMENT] = "element"};
    for (int i = 0; i < 3; i++)
        if (strcmp(line + strlen("strain "), words[i]) == 0) {
            p->strain = (volumetric_strain)i;
            return TROCAR_OK;
        }
    return fail(why, TROCAR_BAD_INPUT, "'%s': expected: strain patch, strain node or strain element", line);
}

static trocar_status fix_group(problem *p, const char *line, trocar_error *why) {
    char name[MESH_NAME];
    int group = sscanf(line, "fixed %63s", name) == 1 ? mesh_find_group(&p->mesh, name, -1) : -1;
    if (group < 0) return fail(why, TROCAR_BAD_INPUT, "'%s': expected: fixed GROUP, one of the mesh", line);
    const mesh_group *g = &p->mesh.groups[group];
    for (int i = 0; i < g->node_count; i++) p->fixed[g->nodes[i]] = true;
    return TROCAR_OK;
}

static trocar_status add_load(problem *p, const char *line, trocar_error *why) {
    int node;
    vec3 f;
    if (sscanf(line, "load %d %lf %lf %lf", &node, &f.x, &f.y, &f.z) != 4 || node < 0 || node >= p->mesh.node_count)
        return fail(why, TROCAR_BAD_INPUT, "'%s': expected: load NODE FX FY FZ", line);
    p->force[node] = v3_add(p->force[node], f);
    return TROCAR_OK;
}

static void print_vectors(int count, const vec3 *v) {
    for (int i = 0; i < count; i++) printf("%.17g %.17g %.17g\n", v[i].x, v[i].y, v[i].z);
}

static void solve_case(problem *p) {
    if (!p->loaded) return;
    inverse_apply(p->inverse, p->force, p->displacement);
    print_vectors(p->mesh.node_count, p->displacement);
    memset(p->force, 0, (size_t)p->mesh.node_count * sizeof *p->force);
}

static trocar_status factorise(problem *p, trocar_error *why) {
    trocar_status status = tissue_define(&p->mesh, p->materials, p->fixed, p->strain, &p->tissue, why);
    if (status != TROCAR_OK) return status;
    p->tissue.membranes = p->membranes;
    p->tissue.sliding = p->sliding;
    status = tissue_factor(&p->tissue, 0, NULL, why);
    return status == TROCAR_OK ? inverse_create_sparse(&p->tissue, SPARSE_CACHE, &p->inverse, why) : status;
}

/* Factorises the tissue at the first load case, when all materials, membranes and fixed groups have been given. */
static trocar_status begin_case(problem *p, trocar_error *why) {
    solve_case(p);
    trocar_status status = p->loaded ? TROCAR_OK : factorise(p, why);
    if (!p->loaded) print_vectors(p->mesh.node_count, p->mesh.nodes);
    p->loaded = true;
    return status;
}

static trocar_status read_line(problem *p, const char *line, trocar_error *why) {
    if (strncmp(line, "load ", 5) == 0) return add_load(p, line, why);
    if (strncmp(line, "case", 4) == 0) return begin_case(p, why);
    if (strncmp(line, "fixed ", 6) == 0) return fix_group(p, line, why);
    if (strncmp(line, "strain ", 7) == 0) return set_strain(p, line, why);
    if (strncmp(line, "membrane ", 9) == 0) return set_membrane(p, line, why);
    if (strncmp(line, "sliding ", 8) == 0) return set_sliding(p, line, why);
    return set_material(p, line, why);
}

static trocar_status run(const char *path, problem *p, trocar_error *why) {
    trocar_status status = mesh_read(path, &p->mesh, why);
    if (status != TROCAR_OK) return status;
    status = make_arrays(p, why);

    char line[256];
    while (status == TROCAR_OK && fgets(line, sizeof line, stdin)) {
        line[strcspn(line, "\n")] = '\0';
        status = read_line(p, line, why);
    }
    if (status == TROCAR_OK) solve_case(p);
    return status;
}

int main(int argc, char **argv) {
    problem p = {0};
    trocar_error why = {""};
    if (argc != 2) {
        fprintf(stderr, "usage: %s MESH <INPUT >OUTPUT\n", argv[0]);
        return 2;
    }
    trocar_status status = run(argv[1], &p, &why);
    if (status != TROCAR_OK) fprintf(stderr, "%s: %s\n", argv[0], why.text);
    inverse_free(p.inverse);
    if (p.tissue.mesh) tissue_free(&p.tissue);
    mesh_free(&p.mesh);
    free(p.fixed);
    free(p.force);
    free(p.displacement);
    return status == TROCAR_OK ? 0 : status == TROCAR_BAD_INPUT ? 2 : 1;
}

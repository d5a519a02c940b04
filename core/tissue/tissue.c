#include "tissue/tissue.h"

#include <stdlib.h>
#include <string.h>

#include "base/lame.h"
#include "tissue/strain_patches.h"

mat3 stiffness_block(vec3 ga, vec3 gb, double volume, double youngs_modulus, double poisson_ratio) {
    double mu = shear_modulus(youngs_modulus, poisson_ratio), lambda = lame_lambda(youngs_modulus, poisson_ratio);
    const double a[3] = {ga.x, ga.y, ga.z}, b[3] = {gb.x, gb.y, gb.z};
    double shear = mu * v3_dot(ga, gb);
    mat3 k;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            k.m[i][j] = volume * (lambda * a[i] * b[j] + mu * b[i] * a[j] + (i == j ? shear : 0.0));
    return k;
}

void tet_stiffness(const vec3 corners[4], double youngs_modulus, double poisson_ratio, double k[12][12]) {
    vec3 g[4];
    double volume = tet_gradients(corners, g);
    for (int a = 0; a < 4; a++)
        for (int b = 0; b < 4; b++) {
            mat3 block = stiffness_block(g[a], g[b], volume, youngs_modulus, poisson_ratio);
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++) k[3 * a + i][3 * b + j] = block.m[i][j];
        }
}

static int number_dofs(tissue *t) {
    int next = 0;
    for (int i = 0; i < t->mesh->node_count; i++) {
        t->dof[i] = t->fixed[i] ? -1 : next;
        if (!t->fixed[i]) next += 3;
    }
    return next;
}

void mix_moduli(const region_material *first, const region_material *second, double weight, region_material *mixed) {
    double a = first->youngs_modulus, b = second->youngs_modulus;
    mixed->youngs_modulus = a == b || weight == 0.0 ? a : weight == 1.0 ? b : 1.0 / value_between(1.0 / a, 1.0 / b, weight);
    mixed->stiffening = value_between(first->stiffening, second->stiffening, weight);
}

/* If the volumetric part is integrated separately, mu stays the same and lambda is 0. */
void element_moduli(const tissue *t, int tet, double *youngs_modulus, double *poisson_ratio) {
    const region_material *material = &t->materials[t->mesh->region[tet]];
    bool whole = t->volumetric == STRAIN_BY_ELEMENT;
    *youngs_modulus = whole ? material->youngs_modulus : material->youngs_modulus / (1.0 + material->poisson_ratio);
    *poisson_ratio = whole ? material->poisson_ratio : 0.0;
}

/* Adds the lower triangle of an element's stiffness, [3 a + i][3 b + j] for its nodes a and b, to the triplets. */
static void add_lower(const tissue *t, int count, const int *nodes, const double *k, cholmod_triplet *triplets) {
    int *rows = triplets->i, *columns = triplets->j;
    double *values = triplets->x;
    for (int a = 0; a < 3 * count; a++)
        for (int b = 0; b < 3 * count; b++) {
            int row = t->dof[nodes[a / 3]], column = t->dof[nodes[b / 3]];
            if (row < 0 || column < 0 || row + a % 3 < column + b % 3) continue;
            size_t at = triplets->nnz++;
            rows[at] = row + a % 3;
            columns[at] = column + b % 3;
            values[at] = k[a * 3 * count + b];
        }
}

static void add_element(const tissue *t, int tet, cholmod_triplet *triplets) {
    const mesh *m = t->mesh;
    vec3 corners[4];
    mesh_corners(m, tet, corners);
    double k[12][12], youngs_modulus, poisson_ratio;
    element_moduli(t, tet, &youngs_modulus, &poisson_ratio);
    tet_stiffness(corners, youngs_modulus, poisson_ratio, k);
    add_lower(t, 4, m->tets[tet], &k[0][0], triplets);
}

static void add_membranes(const tissue *t, cholmod_triplet *triplets) {
    membrane_face found;
    for (int i = 0; i < 4 * t->mesh->tet_count; i++)
        if (membrane_on_face(t->mesh, t->membranes, i / 4, i % 4, &found)) add_lower(t, 3, found.nodes, &found.stiffness[0][0], triplets);
}

static void add_pairs(const tissue *t, cholmod_triplet *triplets) {
    for (int i = 0; i < t->mesh->pair_count; i++) {
        const node_pair *pair = &t->mesh->pairs[i];
        mat3 block = pair_stiffness(pair, t->sliding);
        double k[6][6];
        for (int a = 0; a < 6; a++)
            for (int b = 0; b < 6; b++) k[a][b] = (a / 3 == b / 3 ? 1.0 : -1.0) * block.m[a % 3][b % 3];
        add_lower(t, 2, pair->nodes, &k[0][0], triplets);
    }
}

/* ---- mean volumetric strain ---------------------------------------------------------------------------------------- */

int tissue_means_of(const tissue *t, int tet, int means[4]) {
    if (t->volumetric == STRAIN_BY_PATCH) {
        means[0] = t->patch[tet];
        return 1;
    }
    memcpy(means, t->mesh->tets[tet], 4 * sizeof *means);
    return 4;
}

int tissue_mean_count(const tissue *t) { return t->volumetric == STRAIN_BY_PATCH ? t->patch_count : t->mesh->node_count; }

/* Adds an element's contribution to B, which has one column per mean strain. `whole`: volume over which each mean is taken. */
static void add_divergence(const tissue *t, int tet, const double *whole, cholmod_triplet *triplets) {
    const mesh *m = t->mesh;
    vec3 corners[4], g[4];
    mesh_corners(m, tet, corners);
    const region_material *material = &t->materials[m->region[tet]];
    double volume = tet_gradients(corners, g), lambda = lame_lambda(material->youngs_modulus, material->poisson_ratio);
    int *rows = triplets->i, *columns = triplets->j, means[4], count = tissue_means_of(t, tet, means);
    double *values = triplets->x;
    for (int a = 0; a < count; a++) {
        double weight = volume / count * sqrt(lambda / whole[means[a]]);
        for (int c = 0; c < 4; c++) {
            int dof = t->dof[m->tets[tet][c]];
            for (int k = 0; k < 3 && dof >= 0; k++) {
                size_t at = triplets->nnz++;
                rows[at] = dof + k;
                columns[at] = means[a];
                values[at] = weight * (k == 0 ? g[c].x : k == 1 ? g[c].y : g[c].z);
            }
        }
    }
}

/* Computes B B^T of one region. u^T B B^T u is the sum over its mean strains of lambda V (mean of div u)^2, where V is the volume over which the mean is taken.
   `whole` has room for all means. */
static cholmod_sparse *volumetric_stiffness(tissue *t, int region, double *whole) {
    const mesh *m = t->mesh;
    size_t shares = 0;
    int means[4];
    memset(whole, 0, (size_t)tissue_mean_count(t) * sizeof *whole);
    for (int e = 0; e < m->tet_count; e++) {
        if (m->region[e] != region) continue;
        int count = tissue_means_of(t, e, means);
        for (int a = 0; a < count; a++) whole[means[a]] += mesh_volume(m, e) / count;
        shares += (size_t)count;
    }
    cholmod_triplet *triplets = cholmod_allocate_triplet((size_t)t->dof_count, (size_t)tissue_mean_count(t), 12 * shares + 1, 0, CHOLMOD_REAL, &t->common);
    if (!triplets) return NULL;
    for (int e = 0; e < m->tet_count; e++)
        if (m->region[e] == region) add_divergence(t, e, whole, triplets);
    cholmod_sparse *b = cholmod_triplet_to_sparse(triplets, 0, &t->common);
    cholmod_free_triplet(&triplets, &t->common);
    cholmod_sparse *full = b ? cholmod_aat(b, NULL, 0, 1, &t->common) : NULL;
    cholmod_sparse *lower = full ? cholmod_copy(full, -1, 1, &t->common) : NULL;
    cholmod_free_sparse(&b, &t->common);
    cholmod_free_sparse(&full, &t->common);
    return lower;
}

static bool add_volumetric_stiffness(tissue *t) {
    double *whole = malloc((size_t)tissue_mean_count(t) * sizeof *whole), one[2] = {1.0, 0.0};
    bool added = whole != NULL;
    for (int g = 0; g < t->mesh->group_count && added; g++) {
        if (t->mesh->groups[g].dimension != 3 || t->materials[g].poisson_ratio == 0.0) continue;
        cholmod_sparse *region = volumetric_stiffness(t, g, whole);
        cholmod_sparse *sum = region ? cholmod_add(t->stiffness, region, one, one, 1, 1, &t->common) : NULL;
        cholmod_free_sparse(&region, &t->common);
        added = sum != NULL;
        if (!added) break;
        cholmod_free_sparse(&t->stiffness, &t->common);
        t->stiffness = sum;
    }
    free(whole);
    return added;
}

static trocar_status create_patches(tissue *t, trocar_error *why) {
    t->patch = malloc((size_t)t->mesh->tet_count * sizeof *t->patch);
    if (!t->patch) return fail(why, TROCAR_NO_MEMORY, "no memory for %d tetrahedra", t->mesh->tet_count);
    return strain_patches_create(t->mesh, t->patch, &t->patch_count, why);
}

static trocar_status assemble(tissue *t, trocar_error *why) {
    size_t n = (size_t)t->dof_count, entries = (size_t)t->mesh->tet_count * 78 + (size_t)membrane_face_count(t->mesh, t->membranes) * 45 + (size_t)t->mesh->pair_count * 21;
    cholmod_triplet *triplets = cholmod_allocate_triplet(n, n, entries, -1, CHOLMOD_REAL, &t->common);
    if (!triplets) return fail(why, TROCAR_NO_MEMORY, "no memory to assemble %zu stiffness entries", entries);
    for (int e = 0; e < t->mesh->tet_count; e++) add_element(t, e, triplets);
    add_membranes(t, triplets);
    add_pairs(t, triplets);
    t->stiffness = cholmod_triplet_to_sparse(triplets, 0, &t->common);
    cholmod_free_triplet(&triplets, &t->common);
    bool whole = t->stiffness && (t->volumetric == STRAIN_BY_ELEMENT || add_volumetric_stiffness(t));
    if (!whole) cholmod_free_sparse(&t->stiffness, &t->common);
    return whole ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for the stiffness matrix");
}

trocar_status tissue_define(const mesh *m, const region_material *materials, const bool *fixed, volumetric_strain volumetric,
                              tissue *t, trocar_error *why) {
    memset(t, 0, sizeof *t);
    t->volumetric = volumetric;
    cholmod_start(&t->common);
    t->common.supernodal = CHOLMOD_SUPERNODAL;
    t->common.print = 0;
    t->mesh = m;
    t->materials = materials;
    t->fixed = malloc((size_t)m->node_count * sizeof *t->fixed);
    t->dof = malloc((size_t)m->node_count * sizeof *t->dof);
    t->column = malloc((size_t)m->node_count * sizeof *t->column);

    trocar_status status = TROCAR_OK;
    if (!t->fixed || !t->dof || !t->column) status = fail(why, TROCAR_NO_MEMORY, "no memory for %d nodes", m->node_count);
    if (status == TROCAR_OK) {
        memcpy(t->fixed, fixed, (size_t)m->node_count * sizeof *fixed);
        t->dof_count = number_dofs(t);
        if (t->dof_count == 0) status = fail(why, TROCAR_BAD_INPUT, "every node is fixed: nothing can move");
        if (t->dof_count == 3 * m->node_count)
            status = fail(why, TROCAR_BAD_INPUT, "no node is fixed: name a surface or region under `fixed`");
    }
    if (status == TROCAR_OK && volumetric == STRAIN_BY_PATCH) status = create_patches(t, why);
    if (status != TROCAR_OK) tissue_free(t);
    return status;
}

trocar_status tissue_stiffness(tissue *t, trocar_error *why) {
    trocar_status status = t->stiffness ? TROCAR_OK : assemble(t, why);
    if (status == TROCAR_OK) atomic_store(&t->assembled, true);
    return status;
}

trocar_status tissue_assemble(const mesh *m, const region_material *materials, const bool *fixed, volumetric_strain volumetric,
                              tissue *t, trocar_error *why) {
    trocar_status status = tissue_define(m, materials, fixed, volumetric, t, why);
    if (status != TROCAR_OK) return status;
    status = tissue_stiffness(t, why);
    if (status != TROCAR_OK) tissue_free(t);
    return status;
}

trocar_status tissue_create(const mesh *m, const region_material *materials, const bool *fixed, volumetric_strain volumetric,
                            tissue *t, trocar_error *why) {
    trocar_status status = tissue_assemble(m, materials, fixed, volumetric, t, why);
    if (status != TROCAR_OK) return status;
    status = tissue_factor(t, 0, NULL, why);
    if (status != TROCAR_OK) tissue_free(t);
    return status;
}

void tissue_free(tissue *t) {
    cholmod_free_sparse(&t->stiffness, &t->common);
    cholmod_free_factor(&t->factor, &t->common);
    cholmod_finish(&t->common);
    free(t->fixed);
    free(t->dof);
    free(t->column);
    free(t->patch);
    memset(t, 0, sizeof *t);
}

tissue tissue_constants(const tissue *t) {
    return (tissue){.mesh = t->mesh, .volumetric = t->volumetric, .patch = t->patch, .patch_count = t->patch_count, .materials = t->materials,
                    .membranes = t->membranes, .sliding = t->sliding, .fixed = t->fixed, .dof_count = t->dof_count, .dof = t->dof};
}

#include "inverse/inverse_mixed.h"

#include <stdlib.h>
#include <string.h>

#include "inverse/inverse_owner.h"

enum { TILE = 32 };          /* add at most this many rows and columns of blocks at a time */

typedef struct {
    inverse shared;
    inverse *of[2];          /* the two inverses; the same one twice while no moduli change */
    double weight;           /* weight of of[1], from 0 to 1; of[0] has weight 1 - weight */
    tissue tissue;           /* the tissue of of[0], but with the mixture's materials */
    region_material materials[MESH_MAX_GROUPS];
    double *tile;            /* scratch, a 3 TILE x 3 TILE matrix */
    double *sum;             /* scratch for mixed_apply, dof_count entries */
} mixed_inverse;

static trocar_status add_tile(mixed_inverse *m, const inverse_blocks *tile, trocar_error *why) {
    int ld = 3 * tile->column_count;
    inverse_blocks other = {tile->row_count, tile->rows, tile->column_count, tile->columns, m->tile, ld};
    trocar_status status = inverse_gather(m->of[1], &other, why);
    for (int i = 0; i < 3 * tile->row_count && status == TROCAR_OK; i++) {
        double *to = tile->out + (size_t)i * (size_t)tile->ld;
        for (int j = 0; j < ld; j++) to[j] += m->weight * (m->tile[i * ld + j] - to[j]);
    }
    return status;
}

static trocar_status mixed_gather(inverse *inv, const inverse_blocks *b, trocar_error *why) {
    mixed_inverse *m = (mixed_inverse *)inv;
    trocar_status status = inverse_gather(m->of[0], b, why);
    if (m->of[0] == m->of[1]) return status;
    for (int i = 0; i < b->row_count; i += TILE)
        for (int j = 0; j < b->column_count && status == TROCAR_OK; j += TILE) {
            int rows = b->row_count - i < TILE ? b->row_count - i : TILE, columns = b->column_count - j < TILE ? b->column_count - j : TILE;
            status = add_tile(m, &(inverse_blocks){rows, b->rows + i, columns, b->columns + j, b->out + (size_t)(3 * i) * (size_t)b->ld + 3 * j, b->ld}, why);
        }
    return status;
}

static void mixed_apply(inverse *inv, const double *force, double *displacement) {
    mixed_inverse *m = (mixed_inverse *)inv;
    inverse_apply_locked(m->of[0], force, displacement);
    if (m->of[0] == m->of[1]) return;
    inverse_apply_locked(m->of[1], force, m->sum);
    for (int i = 0; i < m->tissue.dof_count; i++) displacement[i] += m->weight * (m->sum[i] - displacement[i]);
}

static trocar_status mixed_prepare(inverse *inv, trocar_error *why) {
    mixed_inverse *m = (mixed_inverse *)inv;
    trocar_status status = inverse_prepare(m->of[0], why);
    return status == TROCAR_OK ? inverse_prepare(m->of[1], why) : status;
}

static void mixed_release(inverse *inv) {
    free(((mixed_inverse *)inv)->tile);
    free(((mixed_inverse *)inv)->sum);
}

static bool mixed_prefetches(const inverse *inv) {
    const mixed_inverse *m = (const mixed_inverse *)inv;
    return inverse_prefetches(m->of[0]) || inverse_prefetches(m->of[1]);
}

static bool mixed_holds(const inverse *inv, int node) {
    const mixed_inverse *m = (const mixed_inverse *)inv;
    return inverse_holds(m->of[0], node) && inverse_holds(m->of[1], node);
}

static int mixed_slice(const inverse *inv) {
    const mixed_inverse *m = (const mixed_inverse *)inv;
    int a = inverse_slice(m->of[0]), b = inverse_slice(m->of[1]);
    return a < b ? a : b;
}

static const inverse_owner mixed_owner = {"mixed", mixed_gather, mixed_apply, mixed_prepare, mixed_release, mixed_prefetches, mixed_holds, mixed_slice};

trocar_status inverse_create_mixed(inverse *first, inverse **created, trocar_error *why) {
    mixed_inverse *m = calloc(1, sizeof *m);
    *created = m ? &m->shared : NULL;
    if (!m) return fail(why, TROCAR_NO_MEMORY, "no memory");
    m->tissue = tissue_constants(first->tissue);
    m->tissue.materials = m->materials;
    inverse_mix(&m->shared, first, first, 0.0);
    trocar_status status = inverse_init(&m->shared, &mixed_owner, &m->tissue, why);
    m->tile = calloc((size_t)9 * TILE * TILE, sizeof *m->tile);
    m->sum = calloc((size_t)m->tissue.dof_count, sizeof *m->sum);
    if (status == TROCAR_OK && !(m->tile && m->sum)) status = fail(why, TROCAR_NO_MEMORY, "no memory for %d unknowns", m->tissue.dof_count);
    if (status == TROCAR_OK) return TROCAR_OK;
    inverse_free(&m->shared);
    *created = NULL;
    return status;
}

void inverse_mix(inverse *mixed, inverse *first, inverse *second, double weight) {
    mixed_inverse *m = (mixed_inverse *)mixed;
    const region_material *a = first->tissue->materials, *b = second->tissue->materials;
    m->of[0] = first;
    m->of[1] = second;
    m->weight = weight;
    memcpy(m->materials, a, sizeof m->materials);
    for (int g = 0; g < MESH_MAX_GROUPS; g++) mix_moduli(&a[g], &b[g], weight, &m->materials[g]);
}

#include "oracles/remesh_methods.h"

#include "oracles/dense_matrix.h"
#include "oracles/remesh_dense.h"

static const struct {
    const char *name;
    trocar_status (*create)(inverse *, remesher **, trocar_error *);
} methods[REMESH_METHODS] = {
    [REMESH_NESTED] = {"nested", remesher_create},
    [REMESH_IMPLICIT] = {"implicit", remesher_create_implicit},
    [REMESH_WOODBURY] = {"woodbury", remesher_create_woodbury},
    [REMESH_WOODBURY_GENERAL] = {"woodbury-general", remesher_create_woodbury_general},
    [REMESH_BCS] = {"bcs", remesher_create_bcs},
    [REMESH_BCS_BLOCKED] = {"bcs-blocked", remesher_create_bcs_blocked},
};

bool remesh_needs_dense(remesh_method method) { return method >= REMESH_WOODBURY; }

const char *remesh_name(remesh_method method) { return methods[method].name; }

trocar_status remesher_create_by(inverse *inv, remesh_method method, remesher **created, trocar_error *why) {
    *created = NULL;
    if (remesh_needs_dense(method) && !is_dense(inv)) return fail(why, TROCAR_BAD_INPUT, "remeshing: %s needs the dense inverse", remesh_name(method));
    trocar_status status = methods[method].create(inv, created, why);
    if (status == TROCAR_OK) return TROCAR_OK;
    remesher_free(*created);
    *created = NULL;
    return status;
}

/* Returns the compliance of the nominal mesh between the positions of two nodes. */
static mat3 nominal_between(remesher *r, const added_node *node, const added_node *other) {
    const mesh *m = r->tissue->mesh;
    mat3 sum = {{{0}}};
    double w[4], v[4];
    mesh_barycentric(m, node->tet, node->position, w);
    mesh_barycentric(m, other->tet, other->position, v);
    for (int a = 0; a < 4; a++)
        for (int b = 0; b < 4; b++) {
            mat3 block = nominal_block(r, m->tets[node->tet][a], m->tets[other->tet][b]);
            m3_add_scaled(&sum, w[a] * v[b], &block);
        }
    return sum;
}

void find_between_contacts(remesher *r, int slot) {
    const refinement *refined = &r->refined;
    for (int i = 0; i <= refined->count; i++) {
        int other = refined->order[i], higher = slot > other ? slot : other, lower = slot > other ? other : slot;
        mat3 between = nominal_between(r, &refined->nodes[lower], &refined->nodes[higher]);
        for (int a = 0; a < 9; a++) r->between_contacts[lower].at[a / 3][a % 3][higher] = between.m[a / 3][a % 3];
    }
}

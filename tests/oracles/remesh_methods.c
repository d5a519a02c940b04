#include "oracles/remesh_methods.h"

#include "oracles/dense_matrix.h"
#include "oracles/remesh_dense.h"

static const struct {
    const char *name;
    trocar_status (*create)(inverse *, remesher **, trocar_error *);
} methods[] = {
    [REMESH_WOODBURY - REMESH_METHODS] = {"woodbury", remesher_create_woodbury},
    [REMESH_WOODBURY_GENERAL - REMESH_METHODS] = {"woodbury-general", remesher_create_woodbury_general},
    [REMESH_BCS - REMESH_METHODS] = {"bcs", remesher_create_bcs},
    [REMESH_BCS_BLOCKED - REMESH_METHODS] = {"bcs-blocked", remesher_create_bcs_blocked},
};

bool any_remesh_needs_dense(int method) { return method >= REMESH_METHODS; }

const char *any_remesh_name(int method) { return method < REMESH_METHODS ? remesh_name((remesh_method)method) : methods[method - REMESH_METHODS].name; }

trocar_status any_remesher_create(inverse *inv, int method, remesher **created, trocar_error *why) {
    *created = NULL;
    if (method < REMESH_METHODS) return remesher_create(inv, (remesh_method)method, created, why);
    if (!is_dense(inv)) return fail(why, TROCAR_BAD_INPUT, "remeshing: %s needs the dense inverse", any_remesh_name(method));
    trocar_status status = methods[method - REMESH_METHODS].create(inv, created, why);
    if (status == TROCAR_OK) return TROCAR_OK;
    remesher_free(*created);
    *created = NULL;
    return status;
}

#include "inverse/inverse.h"

#include <limits.h>
#include <stdlib.h>
#include <string.h>

#include "inverse/inverse_owner.h"

trocar_status inverse_go_on(inverse_progress progress, trocar_error *why) {
    bool cancelled = progress.cancelled && progress.cancelled(progress.context);
    return cancelled ? fail(why, TROCAR_CANCELLED, "cancelled while the model was being built") : TROCAR_OK;
}

trocar_status inverse_factor(tissue *t, int count, const int *last, inverse_progress progress, trocar_error *why) {
    static const char what[] = "factoring the stiffness matrix";
    if (progress.show) progress.show(what, 0.0, progress.context);
    trocar_status status = inverse_go_on(progress, why);
    if (status == TROCAR_OK) status = tissue_factor(t, count, last, why);
    if (progress.show) progress.show(what, 1.0, progress.context);
    return status == TROCAR_OK ? inverse_go_on(progress, why) : status;
}

trocar_status inverse_init(inverse *inv, const inverse_owner *owner, tissue *t, trocar_error *why) {
    inv->owner = owner;
    inv->tissue = t;
    pthread_mutex_init(&inv->apply_lock, NULL);
    inv->force = calloc((size_t)t->dof_count, sizeof *inv->force);
    inv->displacement = calloc((size_t)t->dof_count, sizeof *inv->displacement);
    return inv->force && inv->displacement ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for %d unknowns", t->dof_count);
}

void inverse_free(inverse *inv) {
    if (!inv) return;
    inv->owner->release(inv);
    free(inv->force);
    free(inv->displacement);
    pthread_mutex_destroy(&inv->apply_lock);
    free(inv);
}

trocar_status inverse_gather(inverse *inv, const inverse_blocks *blocks, trocar_error *why) { return inv->owner->gather(inv, blocks, why); }

trocar_status inverse_prepare(inverse *inv, trocar_error *why) { return inv->owner->prepare ? inv->owner->prepare(inv, why) : TROCAR_OK; }

bool inverse_holds(const inverse *inv, int node) { return !inv->owner->holds || inv->owner->holds(inv, node); }

bool inverse_prefetches(const inverse *inv) { return inv->owner->prefetches && inv->owner->prefetches(inv); }

int inverse_slice(const inverse *inv) { return inv->owner->slice ? inv->owner->slice(inv) : INT_MAX; }

const char *inverse_name(const inverse *inv) { return inv->owner->name; }

void inverse_apply_locked(inverse *inv, const double *force, double *displacement) {
    pthread_mutex_lock(&inv->apply_lock);
    inv->owner->apply(inv, force, displacement);
    pthread_mutex_unlock(&inv->apply_lock);
}

void inverse_apply(inverse *inv, const vec3 *force, vec3 *displacement) {
    const tissue *t = inv->tissue;
    pthread_mutex_lock(&inv->apply_lock);
    for (int i = 0; i < t->mesh->node_count; i++)
        if (t->dof[i] >= 0) memcpy(inv->force + t->dof[i], &force[i], sizeof force[i]);
    inv->owner->apply(inv, inv->force, inv->displacement);
    for (int i = 0; i < t->mesh->node_count; i++) {
        displacement[i] = v3(0, 0, 0);
        if (t->dof[i] >= 0) memcpy(&displacement[i], inv->displacement + t->dof[i], sizeof displacement[i]);
    }
    pthread_mutex_unlock(&inv->apply_lock);
}

const tissue *inverse_tissue(const inverse *inv) { return inv->tissue; }

#include "remesh_timing.h"
#include "oracles/refinement_move.h"

#include <stdlib.h>
#include <string.h>

enum { NEAR = 32, LEAST_SAMPLES = 3 };       /* NEAR: nodes in the window, about as many as are requested ahead of a tip */

typedef struct {
    const tissue *tissue;
    const remesh_case *wanted;
    remesher *remesher;
    remesh_request request;
    compliance_snapshot *snapshot;
    uint64_t random, next_id;
} timing_run;

const char *remesh_change_name(remesh_change change) {
    static const char *const names[REMESH_CHANGES] = {"inside", "face", "move"};
    return names[change];
}

/* Draws the same sequence on every machine (a linear congruential generator; Knuth, vol. 2). */
static double draw(timing_run *run) {
    run->random = run->random * UINT64_C(6364136223846793005) + UINT64_C(1442695040888963407);
    return (double)(run->random >> 11) * 0x1p-53;
}

static vec3 draw_point(timing_run *run, int tet) {
    double weights[4], sum = 0.0;
    for (int i = 0; i < 4; i++) sum += weights[i] = 0.2 + draw(run);
    for (int i = 0; i < 4; i++) weights[i] /= sum;
    return mesh_point(run->tissue->mesh, tet, weights);
}

/* ---- adding a node -------------------------------------------------------------------------------------------------- */

/* Returns the point nearest to corner `corner` on the face opposite corner `face`. */
static vec3 point_near(const mesh *m, int tet, int face, int corner) {
    double weights[4];
    for (int i = 0; i < 4; i++) weights[i] = i == face ? 0.0 : i == corner ? 0.8 : 0.1;
    return mesh_point(m, tet, weights);
}

static bool move_any(timing_run *run, int tet) {
    refinement *r = &run->request.wanted;
    for (int k = 0; k < 16; k++) {
        if (k / 4 == k % 4) continue;
        int index = refinement_move(run->tissue, r, tet, point_near(run->tissue->mesh, tet, k / 4, k % 4), run->next_id);
        if (index < 0) continue;
        if (run->wanted->touched == 0 || r->nodes[index].touched == run->wanted->touched) return true;
        r->count--;
    }
    return false;
}

static bool change_mesh(timing_run *run, remesh_change change, int tet) {
    const mesh *m = run->tissue->mesh;
    run->next_id++;
    switch (change) {
    case ADD_INSIDE: return refinement_add(m, &run->request.wanted, tet, draw_point(run, tet), run->next_id) >= 0;
    case ADD_ON_FACE: return refinement_add_on_face(m, &run->request.wanted, tet, draw_point(run, tet), run->next_id) >= 0;
    default: return move_any(run, tet);
    }
}

/* Adds a contact node in a random element. Returns the element, or -1 if the mesh has no suitable one. */
static int change_somewhere(timing_run *run, remesh_change change) {
    int all = run->tissue->mesh->tet_count, first = (int)(draw(run) * all);
    for (int k = 0; k < all; k++)
        if (change_mesh(run, change, (first + k) % all)) return (first + k) % all;
    return -1;
}

/* Fills the window with the nodes of `tet` and of the elements around it. */
static void look_around(timing_run *run, int tet) {
    const mesh *m = run->tissue->mesh;
    remesh_request *request = &run->request;
    int tets[NEAR] = {tet}, count = 1;
    request->window_count = 0;
    for (int next = 0; next < count; next++) {
        for (int c = 0; c < 4; c++) {
            bool known = request->window_count == NEAR;
            for (int k = 0; k < request->window_count && !known; k++) known = request->window[k] == m->tets[tets[next]][c];
            if (!known) request->window[request->window_count++] = m->tets[tets[next]][c];
        }
        for (int f = 0; f < 4 && count < NEAR; f++)
            if (m->neighbours[tets[next]][f] >= 0) tets[count++] = m->neighbours[tets[next]][f];
    }
}

/* ---- measuring -------------------------------------------------------------------------------------------------------- */

static trocar_status serve(timing_run *run, int64_t *time, trocar_error *why) {
    run->request.serial++;
    int64_t start = monotonic_ns();
    trocar_status status = remesher_serve(run->remesher, &run->request, run->snapshot, why);
    *time = monotonic_ns() - start;
    return status;
}

/* Requests the window, untimed, then adds the node and removes it, timing both. */
static trocar_status time_one(timing_run *run, int tet, remesh_timing *result, trocar_error *why) {
    int64_t unused, add = 0, removal = 0;
    look_around(run, tet);
    run->request.wanted.count--;
    trocar_status status = serve(run, &unused, why);
    run->request.wanted.count++;
    if (status == TROCAR_OK) status = serve(run, &add, why);
    run->request.wanted.count--;
    if (status == TROCAR_OK) status = serve(run, &removal, why);
    histogram_add(&result->add, add);
    histogram_add(&result->remove, removal);
    result->samples++;
    return status;
}

static trocar_status time_all(timing_run *run, remesh_timing *result, trocar_error *why) {
    const remesh_case *wanted = run->wanted;
    int64_t end = monotonic_ns() + (int64_t)(1e9 * wanted->seconds);
    for (int i = 0; i < wanted->contacts; i++) change_somewhere(run, wanted->change == MOVE_NODE ? ADD_INSIDE : wanted->change);
    for (int i = 0; i < wanted->samples && (i < LEAST_SAMPLES || monotonic_ns() < end); i++) {
        int tet = change_somewhere(run, wanted->change);
        if (tet < 0) return TROCAR_OK;
        trocar_status status = time_one(run, tet, result, why);
        if (status != TROCAR_OK) return status;
    }
    return TROCAR_OK;
}

trocar_status remesh_timing_measure(inverse *inv, const remesh_case *wanted, remesh_timing *result, trocar_error *why) {
    memset(result, 0, sizeof *result);
    timing_run *run = calloc(1, sizeof *run);
    if (run) run->snapshot = calloc(1, sizeof *run->snapshot);
    trocar_status status = run && run->snapshot ? TROCAR_OK : fail(why, TROCAR_NO_MEMORY, "no memory for a snapshot");
    if (status == TROCAR_OK) {
        run->tissue = inverse_tissue(inv);
        run->wanted = wanted;
        status = remesher_create_by(inv, wanted->method, &run->remesher, why);
        if (status == TROCAR_OK) status = time_all(run, result, why);
        remesher_free(run->remesher);
        free(run->snapshot);
    }
    free(run);
    return status;
}

void remesh_timing_valences(const tissue *t, int counts[MAX_PATCH + 1]) {
    static const refinement none = {.count = 0};
    const mesh *m = t->mesh;
    leaf around[MAX_PATCH_LEAVES];
    bool *seen = calloc((size_t)m->node_count, sizeof *seen);
    memset(counts, 0, sizeof(int[MAX_PATCH + 1]));
    for (int e = 0; e < m->tet_count && seen; e++)
        for (int c = 0; c < 4; c++) {
            int node = m->tets[e][c];
            if (seen[node] || m->anatomical[node] || t->fixed[node]) continue;
            seen[node] = true;
            int leaves = refinement_around(m, &none, 0, node, e, around);
            if (leaves >= 0) counts[leaves / 2 + 3]++;
        }
    free(seen);
}

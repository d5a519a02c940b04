#include "api/worker_answer.h"

#include <string.h>

#include "base/flush_denormals.h"
#include "snapshot/free_displacement.h"

/* ---- what else loads the tissue --------------------------------------------------------------------------------------------- */

void list_others(const trocar_sim *sim, int needle, other_loads *others) {
    *others = (other_loads){.beneath = sim->resting.inverse, .attached = needle != BESIDE_RESTING && sim->resting.count > 0 ? sim->resting.load : NULL};
    if (needle != BESIDE_PROBE && sim->probe && sim->probe->now.count > 0) others->pressed = needle >= 0 ? &sim->probe->unloaded : &sim->probe->now;
    for (int i = 0; i < sim->needle_count; i++)
        if (i != needle && sim->needles[i].held.count > 0) others->of[others->count++] = &sim->needles[i].held;
}

void mark_stale(trocar_sim *sim, const sim_needle *except) {
    for (int i = 0; i < sim->needle_count; i++)
        if (&sim->needles[i] != except) link_mark_stale(&sim->needles[i].link);
}

/* ---- answers ------------------------------------------------------------------------------------------------------------------ */

static const double AHEAD = 10e-3; /* m, how far the tip can advance before the next answer */

/* Divides the needle's track into steps. For a needle outside the tissue, uses the track it is expected to cut. */
static void lay_steps(const trocar_sim *sim, int index, const remesh_request *request, shaft_steps *steps) {
    const mesh *m = &sim->model->parts.mesh;
    double finest = sim->model->parts.insertion.settings.contact_spacing;
    shaft_steps_lay(m, &sim->needles[index].held, AHEAD, finest, steps);
    if (steps->count > 0 || request->piece_count == 0 || request->wanted.count > 0) return;
    const line_in_tet *in = &request->pieces[0];
    tissue_loads track = {.count = 1, .loads = {{.shaft = {0.0, AHEAD, 0.0, in->point, in->direction, *in}}}};
    shaft_steps_lay(m, &track, 0.0, finest, steps);
}

static void clear(const shaft_steps *steps, unresolved_shift *shift) {
    memset(shift, 0, sizeof *shift);
    shift->start = steps->start;
    shift->step = steps->step;
    shift->count = steps->count;
}

static void add_up(unresolved_shift *shift) {
    for (int k = 0; k < shift->count; k++) shift->sum[k + 1] = v3_add(shift->sum[k + 1], shift->sum[k]);
}

/* Other needles and the needle's own residual loads displace its track. Finds the part of that displacement that the mesh is too coarse to resolve. */
static trocar_status find_unresolved(const trocar_sim *sim, int index, const remesh_request *request, const other_loads *others, compliance_snapshot *snapshot,
                                     trocar_error *why) {
    shaft_steps steps = {.count = 0};
    bool residuals = sim->pairs && request->residual_loads.count > 0;
    unresolved_shift *shift = &snapshot->unresolved, *residual = snapshot->unresolved_residual;
    if (sim->pairs) lay_steps(sim, index, request, &steps);
    clear(&steps, shift);
    for (int term = 0; term < MAX_RELAXATION; term++) clear(&steps, &residual[term]);
    if (!sim->pairs) return TROCAR_OK;
    trocar_status status = TROCAR_OK;
    for (int n = 0; n < others->count && status == TROCAR_OK; n++) status = needle_pairs_shift(sim->pairs, &steps, others->of[n], shift, why);
    if (status == TROCAR_OK) status = resting_set_shift(&sim->resting, link_phase(&sim->needles[index].link) != PHASE_LEAVING, &steps, shift, why);
    if (status == TROCAR_OK && residuals) status = needle_pairs_residual_shift(sim->pairs, &steps, &request->residual_loads, residual, why);
    add_up(shift);
    for (int term = 0; term < MAX_RELAXATION && residuals; term++) add_up(&residual[term]);
    return status;
}

/* Fills the free displacements (u_free) in the worker's slot. Computes them for the first answer to a request, and reuses them for later ones. Worker only. */
static trocar_status fill_free(trocar_sim *sim, int index, const remesh_request *request, bool first, trocar_error *why) {
    sim_needle *needle = &sim->needles[index];
    compliance_snapshot *snapshot = link_answer_slot(&needle->link);
    other_loads others;
    if (!first) {
        snapshot->loaded = needle->loaded;
        memcpy(snapshot->u_free, needle->u_free, sizeof snapshot->u_free);
        snapshot->unresolved = needle->unresolved;
        memcpy(snapshot->unresolved_residual, needle->unresolved_residual, sizeof snapshot->unresolved_residual);
        return TROCAR_OK;
    }
    list_others(sim, index, &others);
    trocar_status status = free_displacement_find(sim->inverse, request, &others, snapshot, why);
    needle->loaded = snapshot->loaded;
    if (status == TROCAR_OK) status = find_unresolved(sim, index, request, &others, snapshot, why);
    memcpy(needle->u_free, snapshot->u_free, sizeof needle->u_free);
    needle->unresolved = snapshot->unresolved;
    memcpy(needle->unresolved_residual, snapshot->unresolved_residual, sizeof needle->unresolved_residual);
    needle->served_shifts = attached_shifts(sim);
    return status;
}

/* If the inverse has changed since the last answer, discards the rows computed from it. Worker only. */
static trocar_status start_anew_if_changed(trocar_sim *sim, sim_needle *needle, trocar_error *why) {
    if (needle->served_changes == attached_changes(sim)) return TROCAR_OK;
    needle->served_changes = attached_changes(sim);
    return remesher_forget(needle->remesher, why);
}

trocar_status answer_fully(trocar_sim *sim, int index, const remesh_request *request, trocar_error *why) {
    sim_needle *needle = &sim->needles[index];
    trocar_status status = start_anew_if_changed(sim, needle, why);
    if (status == TROCAR_OK) status = remesher_answer(needle->remesher, request, link_answer_slot(&needle->link), why);
    return status == TROCAR_OK ? fill_free(sim, index, request, true, why) : status;
}

trocar_status answer_and_publish(trocar_sim *sim, int index, trocar_error *why) {
    sim_needle *needle = &sim->needles[index];
    trocar_status status = answer_fully(sim, index, &needle->state.request, why);
    if (status == TROCAR_OK) link_publish_answer(&needle->link);
    return status;
}

trocar_status answer_request(trocar_sim *sim, int index, trocar_work *work, trocar_error *why) {
    bool fresh;
    sim_needle *needle = &sim->needles[index];
    if (needle->attached) return TROCAR_OK;
    const posted_request *posted = link_request(&needle->link, &fresh);
    if (!fresh) return TROCAR_OK;
    floating_mode before = flush_denormals();
    const remesh_request *request = &posted->request;
    trocar_status status = start_anew_if_changed(sim, needle, why);
    if (status == TROCAR_OK) status = remesher_serve(needle->remesher, request, link_answer_slot(&needle->link), why);
    if (status == TROCAR_OK) status = fill_free(sim, index, request, true, why);
    if (status == TROCAR_OK) link_publish_answer(&needle->link);
    if (status == TROCAR_OK && sim->clock) work->latency = sim->clock() - posted->asked;
    for (int lines = 0; status == TROCAR_OK && remesher_must_measure(needle->remesher, request); lines++) {
        if (lines > 0 && link_request_waits(&needle->link)) break;
        status = remesher_measure(needle->remesher, request, 1, link_answer_slot(&needle->link), why);
        if (status == TROCAR_OK) status = fill_free(sim, index, request, false, why);
        if (status == TROCAR_OK) link_publish_answer(&needle->link);
    }
    restore_floating_mode(before);
    work->more = 1;
    work->answered = status == TROCAR_OK;
    return status;
}

bool look_ahead(trocar_sim *sim) {
    for (int i = 0; i < sim->needle_count; i++)
        if (!sim->needles[i].attached && remesher_look_ahead(sim->needles[i].remesher)) return true;
    return false;
}

/* The worker's tasks, for a separate worker thread (trocar_sim_work) and for lockstep. */
#include "api/worker.h"

#include <stdlib.h>

#include "api/worker_answer.h"
#include "api/worker_probe.h"
#include "api/worker_resting.h"
#include "base/flush_denormals.h"

enum { MOST_ANSWERS = 4 };             /* after answering this many requests in a row, let other work have its turn */

/* Moves the mesh's compliance one step closer to the new moduli, lets resting needles follow, and marks all answers as stale. */
static trocar_status move_moduli(trocar_sim *sim, double now, trocar_error *why) {
    double *displacement;
    trocar_status status = rest_before_softening(sim, &displacement, why);
    if (status == TROCAR_OK) {
        elasticity_mix(&sim->elasticity, sim->mixed, &sim->changing->worker, now);
        if (sim->pairs) needle_pairs_soften(sim->pairs);
        sim->resting.changes++;
        mark_stale(sim, NULL);
        status = rest_after_softening(sim, displacement, why);
    }
    free(displacement);
    if (status == TROCAR_OK) status = press_probe(sim, why);
    return status == TROCAR_OK ? respond_to_loads(sim, false, why) : status;
}

/* While moduli change, keeps the mesh's compliance in step with the ticking thread. */
static trocar_status follow_moduli(trocar_sim *sim, trocar_error *why) {
    model_free_retired();
    bool felt = false;
    for (int i = 0; i < sim->needle_count; i++) felt |= sim->needles[i].served_changes == attached_changes(sim);
    double now = 1e-9 * (double)atomic_load_explicit(&sim->link.probe.time, memory_order_relaxed);
    if (!sim->changing || !elasticity_lags(&sim->elasticity, now, felt)) return TROCAR_OK;
    floating_mode before = flush_denormals();
    trocar_status status = move_moduli(sim, now, why);
    restore_floating_mode(before);
    return status;
}

/* ---- in its own thread ------------------------------------------------------------------------------------------------------ */

/* Copies the newest forces of held needles. Returns true if any of them are new. */
static bool take_loads(trocar_sim *sim) {
    bool any = false;
    for (int i = 0; i < sim->needle_count; i++) {
        bool fresh;
        sim_needle *needle = &sim->needles[i];
        const tissue_loads *loads = link_loads(&needle->link, &fresh);
        if (!fresh || needle->attached) continue;
        copy_loads(loads, &needle->held);
        mark_stale(sim, needle);
        any = true;
    }
    return any;
}

/* Lets resting needles and the probe respond to the newest loads. */
static trocar_status respond_in_turn(trocar_sim *sim, trocar_error *why) {
    sim->to_respond = false;
    sim->answers = 0;
    trocar_status status = press_probe(sim, why);
    return status == TROCAR_OK ? respond_to_loads(sim, false, why) : status;
}

/* Lets the next resting needle slip. Returns true if more have to. */
static bool slip_in_turn(trocar_sim *sim, trocar_status *status, trocar_error *why) {
    uint64_t shifts = sim->resting.shifts;
    bool more = slip_some(sim, false);
    if (sim->resting.shifts != shifts) *status = press_probe(sim, why);
    return more;
}

/* Does a small amount of work per call, so that requests never wait long. Requests have priority, but other work gets a turn, too. */
trocar_status trocar_sim_work(trocar_sim *sim, trocar_work *done, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    worker_is_awake(&sim->link);
    trocar_work work = {0};
    resting_change change;
    changing_take(sim->changing);
    if (take_loads(sim)) sim->to_respond = true;
    if (take_probe_pose(sim)) sim->to_respond = true;
    trocar_status moved = follow_moduli(sim, why), status = change_resting(sim, &change, moved == TROCAR_OK ? why : &ignored);
    work.more = change.any;
    work.still_held = change.kept;
    for (int i = 0; i < sim->needle_count && !work.more; i++) {
        int index = sim->next_served;
        sim->next_served = (sim->next_served + 1) % sim->needle_count;
        status = answer_request(sim, index, &work, why);
    }
    sim->answers += work.answered;
    floating_mode before = flush_denormals();
    if (status == TROCAR_OK && (!work.more || change.any || sim->answers >= MOST_ANSWERS)) {
        bool responds = sim->to_respond;
        if (responds) status = respond_in_turn(sim, why);
        else sim->answers = 0;
        if (responds) work.more = true;
        else if (slip_in_turn(sim, &status, why) || look_ahead(sim)) work.more = true;
    }
    restore_floating_mode(before);
    if (done) *done = work;
    return moved != TROCAR_OK ? moved : status;
}

int trocar_sim_work_descriptor(const trocar_sim *sim) { return sim->link.work_event; }

/* ---- in lockstep -------------------------------------------------------------------------------------------------------------- */

trocar_status worker_before_tick(trocar_sim *sim, int index, bool *outdated, trocar_error *why) {
    resting_change change;
    const sim_needle *needle = &sim->needles[index];
    changing_take(sim->changing);
    for (int i = 0; i < sim->needle_count; i++)
        if (link_phase(&sim->needles[i].link) == PHASE_HELD && !sim->needles[i].attached) copy_loads(&sim->needles[i].loads, &sim->needles[i].held);
    bool moved = take_probe_pose(sim);
    trocar_status status = follow_moduli(sim, why);
    if (status == TROCAR_OK) status = change_resting(sim, &change, why);
    if (status == TROCAR_OK && moved) status = press_probe(sim, why);
    *outdated = needle->served_changes != attached_changes(sim) || (moved && needle->served_shifts != attached_shifts(sim));
    return status;
}

/* Lets resting needles and the probe respond to this tick. */
static trocar_status respond(trocar_sim *sim, sim_needle *needle, double dt, trocar_error *why) {
    copy_loads(&needle->loads, &needle->held);
    sim->since_response += dt;
    double period = response_period(sim->probe ? sim->probe->state.count : 0);
    if ((sim->resting.count == 0 && !sim->probe) || sim->since_response < period - 1e-9) return TROCAR_OK;
    sim->since_response = 0.0;
    trocar_status status = press_probe(sim, why);
    return status != TROCAR_OK ? status : respond_to_loads(sim, true, why);
}

trocar_status worker_after_tick(trocar_sim *sim, int index, const compliance_snapshot *answer, double dt, trocar_error *why) {
    sim_needle *needle = &sim->needles[index];
    other_loads others;
    trocar_status status = respond(sim, needle, dt, why);
    list_others(sim, index, &others);
    bool same = answer->serial == needle->state.request.serial && needle->served_changes == attached_changes(sim);
    bool known = others.count == 0 && (others.attached || others.pressed ? needle->served_shifts == attached_shifts(sim) : !answer->loaded);
    return status == TROCAR_OK && !(same && known) ? answer_and_publish(sim, index, why) : status;
}

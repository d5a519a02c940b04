#include "api/worker_probe.h"

#include <string.h>

#include "api/view.h"
#include "api/worker_answer.h"
#include "saved/saved_state.h"

trocar_status create_probe(trocar_sim *sim, trocar_error *why) {
    const model_parts *parts = &sim->model->parts;
    if (parts->probe_surface < 0) return TROCAR_OK;
    trocar_status status = probe_create(sim->resting.inverse, &parts->config.probe.shape, parts->probe_surface, parts->config.probe.max_force, &sim->probe, why);
    if (status != TROCAR_OK) return status;
    sim->inverse = sim->probe->inverse;
    return TROCAR_OK;
}

bool take_probe_pose(trocar_sim *sim) {
    bool fresh = false;
    if (!sim->probe) return false;
    const pose *newest = probe_link_pose(&sim->link.probe, &fresh);
    if (fresh) sim->probe_pose = *newest, sim->probe_posed = true;
    return fresh;
}

static void show(trocar_sim *sim) {
    const probe *p = sim->probe;
    const probe_state *s = &p->state;
    shown_probe *slot = probe_link_slot(&sim->link.probe);
    slot->stamp = next_stamp();
    slot->output = (trocar_probe){.contacts = s->count, .placed = s->placed, .stopped = s->stopped};
    if (s->placed) slot->output.base = pose_out(s->base);
    store_vec3(s->wrench_force, slot->output.force);
    store_vec3(s->wrench_torque, slot->output.torque);
    slot->count = p->now.count;
    memcpy(slot->nodes, p->now.nodes, (size_t)slot->count * sizeof *slot->nodes);
    memcpy(slot->force, p->now.force, (size_t)slot->count * sizeof *slot->force);
    probe_link_publish(&sim->link.probe);
}

trocar_status press_probe(trocar_sim *sim, trocar_error *why) {
    probe *p = sim->probe;
    other_loads others;
    needle_holds holds = {0};
    if (!p || !sim->probe_posed) return TROCAR_OK;
    uint64_t changes = attached_changes(sim), shifts = attached_shifts(sim);
    list_others(sim, BESIDE_PROBE, &others);
    bool held = false; /* if no needle is held, nothing ticks and simulated time stands still, so `elapsed` is infinite */
    for (int i = 0; i < sim->needle_count; i++) {
        if (sim->needles[i].attached) continue;
        held = true;
        if (sim->needles[i].held.count > 0) holds.of[holds.count++] = link_hold(&sim->needles[i].link);
    }
    int64_t now = atomic_load_explicit(&sim->link.probe.time, memory_order_relaxed);
    double elapsed = held ? 1e-9 * (double)(now - sim->probe_time) : INFINITY;
    trocar_status status = probe_press(p, sim->probe_pose, elapsed, &others, &holds, sim->probe_beneath != sim->resting.changes, why);
    sim->probe_time = now;
    sim->probe_beneath = sim->resting.changes;
    if (attached_changes(sim) != changes || attached_shifts(sim) != shifts) mark_stale(sim, NULL);
    show(sim);
    return status;
}

/* ---- save and restore ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    bool placed, posed, waits; /* waits: true if `asked` is a pose that the worker has not read yet */
    pose pose, asked;
    int64_t time;            /* ns */
} saved_poses;

void save_probe(state_stream *to, trocar_sim *sim) {
    if (!sim->probe) return;
    saved_poses saved = {.placed = atomic_load(&sim->link.probe.placed), .posed = sim->probe_posed, .pose = sim->probe_pose};
    saved.waits = probe_link_waiting(&sim->link.probe, &saved.asked);
    saved.time = sim->probe_time;
    STREAM(to, saved);
    saved_probe(to, &sim->probe->state);
    for (int i = 0; i < sim->needle_count; i++) saved_hold(to, (needle_hold *)link_hold(&sim->needles[i].link));
}

trocar_status restore_probe(state_stream *from, trocar_sim *sim, trocar_error *why) {
    saved_poses saved;
    probe_state state;
    if (!sim->probe) return TROCAR_OK;
    STREAM(from, saved);
    saved_probe(from, &state);
    for (int i = 0; i < sim->needle_count; i++) {
        saved_hold(from, link_hold_slot(&sim->needles[i].link));
        link_publish_hold(&sim->needles[i].link);
    }
    atomic_store(&sim->link.probe.time, llround(1e9 * sim->rounds.time));
    sim->probe_time = saved.time;
    probe_link_restore(&sim->link.probe, saved.placed, saved.waits ? &saved.asked : NULL);
    sim->probe_posed = saved.posed;
    sim->probe_pose = saved.pose;
    trocar_status status = probe_resume(sim->probe, &state, why);
    sim->probe_beneath = sim->resting.changes;
    show(sim);
    if (saved.waits) wake_worker(&sim->link);
    return status;
}

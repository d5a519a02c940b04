/* trocar.h: the probe. See README.md, "Probe". */
#include <string.h>

#include "api/api.h"
#include "base/flush_denormals.h"

_Static_assert(TROCAR_MAX_PRESSED == (int)MAX_PRESSED, "limits differ from trocar.h");

int trocar_model_probe(const trocar_model *model, trocar_probe_shape *out) {
    const probe_shape *shape = &model->parts.config.probe.shape;
    if (model->parts.probe_surface < 0) return 0;
    *out = (trocar_probe_shape){.radius = shape->radius, .tip_radius = shape->tip_radius, .length = shape->length, .surface = model->parts.probe_surface};
    return 1;
}

int trocar_model_probe_start(const trocar_model *model, trocar_pose *start) {
    return model->parts.probe_surface < 0 ? 0 : start_out(model->parts.config.probe.start, start);
}

/* ---- the ticking thread ---------------------------------------------------------------------------------------------------- */

static void ask_for(trocar_sim *sim, pose at) {
    memcpy(triple_buffer_slot(&sim->probe_poses), &at, sizeof at);
    triple_buffer_publish(&sim->probe_poses);
    atomic_store_explicit(&sim->probe_placed, true, memory_order_relaxed);
    wake_worker(sim);
}

trocar_status trocar_sim_set_probe(trocar_sim *sim, const trocar_pose *base, trocar_error *error) {
    pose at;
    if (!sim->probe) return error ? fail(error, TROCAR_BAD_INPUT, "the scene has no probe: probe.surface says what it presses") : TROCAR_BAD_INPUT;
    trocar_status status = check_pose(base, &at, error);
    if (status == TROCAR_OK) ask_for(sim, at);
    return status;
}

const shown_probe *probe_shown(const trocar_sim *sim) {
    return sim->probe ? triple_buffer_read((triple_buffer *)&sim->probe_shown, NULL) : NULL;
}

trocar_probe trocar_sim_probe(const trocar_sim *sim) {
    const shown_probe *shown = probe_shown(sim);
    return shown ? shown->told : (trocar_probe){.placed = 0};
}

/* ---- the worker -------------------------------------------------------------------------------------------------------------- */

trocar_status create_probe(trocar_sim *sim, report *why) {
    const simulation *parts = &sim->model->parts;
    if (parts->probe_surface < 0) return TROCAR_OK;
    trocar_status status = triple_buffer_create(&sim->probe_poses, sizeof(pose), why);
    if (status == TROCAR_OK) status = triple_buffer_create(&sim->probe_shown, sizeof(shown_probe), why);
    if (status == TROCAR_OK) status = probe_create(sim->resting.inverse, &parts->config.probe.shape, parts->probe_surface, parts->config.probe.max_force, &sim->probe, why);
    if (status != TROCAR_OK) return status;
    sim->inverse = sim->probe->inverse;
    if (!isnan(parts->config.probe.start.position.x)) ask_for(sim, parts->config.probe.start);
    return TROCAR_OK;
}

bool take_probe_pose(trocar_sim *sim) {
    bool fresh = false;
    if (!sim->probe) return false;
    const pose *newest = triple_buffer_read(&sim->probe_poses, &fresh);
    if (fresh) sim->probe_pose = *newest, sim->probe_posed = true;
    return fresh;
}

static void show(trocar_sim *sim) {
    const probe *p = sim->probe;
    const probe_state *s = &p->state;
    shown_probe *slot = triple_buffer_slot(&sim->probe_shown);
    slot->stamp = next_stamp();
    slot->told = (trocar_probe){.contacts = s->count, .placed = s->placed, .stopped = s->stopped};
    if (s->placed) slot->told.base = pose_out(s->base);
    put(s->wrench_force, slot->told.force);
    put(s->wrench_torque, slot->told.torque);
    slot->count = p->now.count;
    memcpy(slot->nodes, p->now.nodes, (size_t)slot->count * sizeof *slot->nodes);
    memcpy(slot->force, p->now.force, (size_t)slot->count * sizeof *slot->force);
    triple_buffer_publish(&sim->probe_shown);
}

trocar_status press_probe(trocar_sim *sim, report *why) {
    probe *p = sim->probe;
    other_loads others;
    if (!p || !sim->probe_posed) return TROCAR_OK;
    uint64_t changes = attached_changes(sim), shifts = attached_shifts(sim);
    list_others(sim, BESIDE_PROBE, &others);
    trocar_status status = probe_press(p, sim->probe_pose, &others, sim->probe_beneath != sim->resting.changes, why);
    sim->probe_beneath = sim->resting.changes;
    if (attached_changes(sim) != changes || attached_shifts(sim) != shifts) mark_stale(sim, NULL);
    show(sim);
    return status;
}

/* ---- save and restore ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    bool placed, posed, waits; /* waits: for the worker to take the pose that was asked for */
    pose pose, asked;
    probe_state state;
} saved_probe;

size_t saved_probe_size(const trocar_sim *sim) { return sim->probe ? sizeof(saved_probe) : 0; }

void save_probe(const trocar_sim *sim, void *to) {
    if (!sim->probe) return;
    triple_buffer *poses = (triple_buffer *)&sim->probe_poses;
    saved_probe saved;
    memset(&saved, 0, sizeof saved);
    saved.placed = atomic_load(&sim->probe_placed);
    saved.waits = triple_buffer_waits(poses);
    saved.posed = sim->probe_posed;
    saved.pose = sim->probe_pose;
    saved.state = sim->probe->state;
    if (saved.waits) { /* read, and put back */
        saved.asked = *(const pose *)triple_buffer_read(poses, NULL);
        memcpy(triple_buffer_slot(poses), &saved.asked, sizeof saved.asked);
        triple_buffer_publish(poses);
    }
    memcpy(to, &saved, sizeof saved);
}

trocar_status restore_probe(trocar_sim *sim, const void *from, report *why) {
    saved_probe saved;
    if (!sim->probe) return TROCAR_OK;
    memcpy(&saved, from, sizeof saved);
    triple_buffer_read(&sim->probe_poses, NULL); /* what waits there is of another time */
    sim->probe_posed = saved.posed;
    sim->probe_pose = saved.pose;
    trocar_status status = probe_resume(sim->probe, &saved.state, why);
    sim->probe_beneath = sim->resting.changes;
    show(sim);
    atomic_store(&sim->probe_placed, saved.placed);
    if (saved.waits) ask_for(sim, saved.asked);
    return status;
}

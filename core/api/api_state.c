/* trocar.h: save and restore a simulation; what there is to see of it. */
#include <stdlib.h>
#include <string.h>

#include "api/api.h"
#include "base/flush_denormals.h"
#include "remesh/free_displacement.h"

/* ---- save and restore -------------------------------------------------------------------------------------------------------- */

/* After the model's address, the clock of the responses and the seeds, of each needle. Copied member by member: the caller's memory need not be
   aligned. What the worker has not done yet when it is saved, it does after a restore. */
typedef struct {
    int phase;
    insertion_state state;   /* of one that is being left: as it was left */
    double base_compliance;
    int64_t since_release;
    compliance_snapshot snapshot;
    resting_needle resting;  /* while it is attached */
} saved_needle;

enum { SEEDS_AT = sizeof(trocar_model *) + sizeof(double), HEAD = SEEDS_AT + sizeof(seed_list) };

size_t trocar_sim_state_size(const trocar_sim *sim) { return HEAD + (size_t)sim->needle_count * sizeof(saved_needle) + saved_probe_size(sim); }

static trocar_status check_size(const trocar_sim *sim, size_t size, report *why) {
    size_t expected = trocar_sim_state_size(sim);
    return size == expected ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "a state has %zu bytes, not %zu", expected, size);
}

static void save_needle(const trocar_sim *sim, int index, char *to) {
    needle_track *needle = &sim->needles[index];
    int phase = phase_of(needle) == PHASE_TAKEN ? PHASE_HELD : phase_of(needle);
    const insertion_state *state = phase == PHASE_LEAVING ? &((const left_needle *)triple_buffer_read(&needle->left, NULL))->state : state_of_needle(sim, index, NULL);
    memcpy(to + offsetof(saved_needle, phase), &phase, sizeof phase);
    memcpy(to + offsetof(saved_needle, state), state, sizeof *state);
    memcpy(to + offsetof(saved_needle, base_compliance), &needle->base_compliance, sizeof needle->base_compliance);
    int64_t since_release = atomic_load(&needle->since_release);
    memcpy(to + offsetof(saved_needle, since_release), &since_release, sizeof since_release);
    memcpy(to + offsetof(saved_needle, snapshot), triple_buffer_read(&needle->snapshots, NULL), sizeof(compliance_snapshot));
    if (phase == PHASE_RESTING || phase == PHASE_TAKING) memcpy(to + offsetof(saved_needle, resting), needle->resting, sizeof *needle->resting);
}

trocar_status trocar_sim_save(const trocar_sim *sim, void *state, size_t size, trocar_error *error) {
    trocar_error ignored;
    trocar_status status = check_size(sim, size, error ? error : &ignored);
    if (status != TROCAR_OK) return status;
    memcpy(state, &sim->model, sizeof sim->model);
    memcpy((char *)state + sizeof sim->model, &sim->since_response, sizeof sim->since_response);
    memcpy((char *)state + SEEDS_AT, &sim->seeds, sizeof sim->seeds);
    for (int i = 0; i < sim->needle_count; i++) save_needle(sim, i, (char *)state + HEAD + (size_t)i * sizeof(saved_needle));
    save_probe(sim, (char *)state + HEAD + (size_t)sim->needle_count * sizeof(saved_needle));
    return TROCAR_OK;
}

/* All but the remesher, which needs to know what rests. */
static trocar_status restore_needle(trocar_sim *sim, needle_track *needle, const char *from, report *why) {
    int phase;
    compliance_snapshot *slot = triple_buffer_slot(&needle->snapshots);
    memcpy(&phase, from + offsetof(saved_needle, phase), sizeof phase);
    memcpy(&needle->state, from + offsetof(saved_needle, state), sizeof needle->state);
    memcpy(&needle->base_compliance, from + offsetof(saved_needle, base_compliance), sizeof needle->base_compliance);
    int64_t since_release;
    memcpy(&since_release, from + offsetof(saved_needle, since_release), sizeof since_release);
    atomic_store(&needle->since_release, since_release);
    memcpy(slot, from + offsetof(saved_needle, snapshot), sizeof *slot);
    needle->stamp = next_stamp();
    needle->given = needle->state.needle.base;
    needle->given.position = v3_sub(needle->given.position, needle->state.base_shift);
    needle->posted = 0;
    needle->loads.count = 0;
    needle->attached = phase == PHASE_RESTING || phase == PHASE_TAKING;
    change_phase(needle, (needle_phase)phase);
    if (!needle->attached) {
        insertion_add_loads(&sim->model->parts.insertion, &needle->state, &needle->loads);
        copy_loads(&needle->loads, &needle->held);
        copy_loads(&needle->loads, &needle->posted_loads);
        copy_loads(&needle->loads, triple_buffer_slot(&needle->loads_out)); /* in place of what was posted before */
        triple_buffer_publish(&needle->loads_out);
        return TROCAR_OK;
    }
    trocar_status status = make_room_to_rest(sim, needle, why);
    if (status != TROCAR_OK) return status;
    memcpy(needle->resting, from + offsetof(saved_needle, resting), sizeof *needle->resting);
    needle->held.count = 0;
    insertion_add_residual_loads(&sim->model->parts.insertion, &needle->resting->anchor, &needle->held);
    return TROCAR_OK;
}

trocar_status trocar_sim_restore(trocar_sim *sim, const void *state, size_t size, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    const trocar_model *model;
    trocar_status status = check_size(sim, size, why);
    if (status != TROCAR_OK) return status;
    memcpy(&model, state, sizeof model);
    if (model != sim->model) return fail(why, TROCAR_BAD_INPUT, "the state is that of another model");
    floating_mode before = flush_denormals();
    memcpy(&sim->since_response, (const char *)state + sizeof model, sizeof sim->since_response);
    memcpy(&sim->seeds, (const char *)state + SEEDS_AT, sizeof sim->seeds);
    const char *from = (const char *)state + HEAD;
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++, from += sizeof(saved_needle)) status = restore_needle(sim, &sim->needles[i], from, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++)
        if (phase_of(&sim->needles[i]) == PHASE_LEAVING) post_left(sim, i); /* with the tracks of all */
    if (status == TROCAR_OK) status = rest_again(sim, why);
    if (status == TROCAR_OK) status = restore_probe(sim, from, why);
    for (int i = 0; i < sim->needle_count && status == TROCAR_OK; i++) {
        needle_track *needle = &sim->needles[i];
        needle->served_changes = attached_changes(sim);
        needle->served_shifts = attached_shifts(sim);
        status = remesher_resume(needle->remesher, &needle->state.request, triple_buffer_slot(&needle->snapshots), why);
        triple_buffer_publish(&needle->snapshots);
    }
    restore_floating_mode(before);
    return status;
}

/* ---- what there is to see -------------------------------------------------------------------------------------------------- */

static trocar_contact_status status_of(friction_state friction) {
    return friction == STICK ? TROCAR_CONTACT_STICKING : TROCAR_CONTACT_SLIDING;
}

/* Of guides that the needle touches, at most MAX_GUIDE_POINTS; returns how many they are. */
static int guide_contacts_of(const trocar_model *parent, const insertion_state *s, trocar_contact *contacts) {
    int count = 0;
    for (int i = 0; i < MAX_GUIDE_POINTS; i++) {
        const guide_contact *face = &s->guides[i / GUIDE_FACES].faces[i % GUIDE_FACES];
        if (!face->touching) continue;
        trocar_contact *contact = &contacts[count++];
        *contact = (trocar_contact){.kind = TROCAR_CONTACT_GUIDE, .state = face->friction, .arc = face->arc, .status = status_of(face->friction),
                                    .slot = i / GUIDE_FACES};
        put(needle_at(&parent->parts.needle, &s->needle, face->arc).position, contact->position);
        put(face->force, contact->force);
    }
    return count;
}

/* From base to tip. */
static void sort_by_arc(trocar_contact *contacts, int count) {
    for (int i = 1; i < count; i++)
        for (int k = i; k > 0 && contacts[k].arc < contacts[k - 1].arc; k--) {
            trocar_contact swapped = contacts[k];
            contacts[k] = contacts[k - 1];
            contacts[k - 1] = swapped;
        }
}

static int tissue_contacts_of(const trocar_model *parent, const insertion_state *s, trocar_contact *contacts, int room) {
    const needle_model *model = &parent->parts.needle;
    int active = contacts_active(s);
    for (int i = 0; i < active && i < room; i++) {
        int slot = s->refined.order[i];
        const shaft_contact *c = &s->contacts[slot];
        contacts[i] = (trocar_contact){.kind = TROCAR_CONTACT_TISSUE, .state = c->shaft.friction, .arc = contact_arc(c, model->given.length), .depth = c->depth,
                                       .id = s->refined.nodes[slot].id, .status = status_of(c->shaft.friction), .slot = slot};
        put(needle_at(model, &s->needle, contacts[i].arc).position, contacts[i].position);
        put(c->force, contacts[i].force);
    }
    if (s->tip.place.phase != TIP_INSIDE) return active;
    if (active < room) {
        contacts[active] = (trocar_contact){.kind = TROCAR_CONTACT_TIP, .state = s->tip.solved.friction, .arc = s->tip.solved.arc, .depth = s->tip.place.depth,
                                            .status = status_of(s->tip.solved.friction), .slot = -1};
        put(needle_at(model, &s->needle, s->tip.solved.arc).position, contacts[active].position);
        put(s->tip.solved.force, contacts[active].force);
    }
    return active + 1;
}

int contacts_of(const trocar_model *parent, const insertion_state *s, trocar_contact *contacts, int room) {
    trocar_contact all[MAX_POINTS];
    int guided = guide_contacts_of(parent, s, all);
    if (guided == 0) return tissue_contacts_of(parent, s, contacts, room);
    int count = guided + tissue_contacts_of(parent, s, all + guided, MAX_POINTS - guided);
    sort_by_arc(all, count - (s->tip.place.phase == TIP_INSIDE));
    int filled = count < room ? count : room;
    if (filled > 0) memcpy(contacts, all, (size_t)filled * sizeof *contacts);
    return count;
}

static int pending_contacts_of(const trocar_model *parent, const insertion_state *s, trocar_contact *contacts, int room) {
    const needle_model *model = &parent->parts.needle;
    int active = contacts_active(s), pending = s->refined.count - active;
    for (int i = 0; i < pending && i < room; i++) {
        int slot = s->refined.order[active + i];
        const shaft_contact *c = &s->contacts[slot];
        bool planned = c->status == CONTACT_PLANNED;
        double arc = planned ? model->given.length : contact_arc(c, model->given.length);
        contacts[i] = (trocar_contact){.kind = TROCAR_CONTACT_TISSUE, .arc = arc, .depth = c->depth, .id = s->refined.nodes[slot].id,
                                       .status = planned ? TROCAR_CONTACT_PLANNED : TROCAR_CONTACT_ADDING, .slot = slot};
        put(planned ? c->track : needle_at(model, &s->needle, arc).position, contacts[i].position);
    }
    return pending;
}

int tracks_of(const insertion_state *state, trocar_track_point *points, int room) {
    const track_list *list = &state->tracks;
    for (int track = 0; track < list->count; track++)
        for (int i = list->first[track]; i < track_end(list, track) && i < room; i++) {
            const track_point *p = &list->points[i];
            points[i] = (trocar_track_point){.tet = p->tet, .track = track, .membrane = p->membrane};
            put(p->at, points[i].position);
        }
    return list->point_count;
}

int centreline_of(const trocar_model *model, const insertion_state *state, double *joints, int room) {
    int count = model->parts.needle.given.segments + 1;
    for (int j = 0; j < count && j < room; j++) put(state->needle.joints[j], joints + 3 * j);
    return count;
}

trocar_pose pose_out(pose base) {
    vec3 x = base.position;
    quat q = base.orientation;
    return (trocar_pose){{x.x, x.y, x.z}, {q.w, q.x, q.y, q.z}};
}

/* NULL for a needle that does not exist. */
static const insertion_state *state_of(const trocar_sim *sim, int needle) { return has_needle(sim->model, needle) ? state_of_needle(sim, needle, NULL) : NULL; }

int trocar_sim_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room) {
    const insertion_state *state = state_of(sim, needle);
    return state ? contacts_of(sim->model, state, contacts, room) : 0;
}

int trocar_sim_pending_contacts(const trocar_sim *sim, int needle, trocar_contact *contacts, int room) {
    const insertion_state *state = state_of(sim, needle);
    return state ? pending_contacts_of(sim->model, state, contacts, room) : 0;
}

int trocar_sim_hole(const trocar_sim *sim, int needle, int guide) {
    const insertion_state *state = state_of(sim, needle);
    if (!state || guide < 0 || guide >= sim->model->parts.config.guide_count) return TROCAR_NO_HOLE;
    const guide_state *s = &state->guides[guide];
    return s->passage == GUIDE_IN_HOLE ? s->hole : s->passage == GUIDE_MISSED ? TROCAR_MISSED_HOLE : TROCAR_NO_HOLE;
}

int trocar_sim_tracks(const trocar_sim *sim, int needle, trocar_track_point *points, int room) {
    const insertion_state *state = state_of(sim, needle);
    return state ? tracks_of(state, points, room) : 0;
}

int trocar_sim_centreline(const trocar_sim *sim, int needle, double *joints, int room) {
    const insertion_state *state = state_of(sim, needle);
    return state ? centreline_of(sim->model, state, joints, room) : 0;
}

trocar_pose trocar_sim_base(const trocar_sim *sim, int needle) {
    if (!has_needle(sim->model, needle)) return pose_out((pose){.orientation = {1, 0, 0, 0}});
    const insertion_state *state = state_of_needle(sim, needle, NULL);
    pose base = sim->needles[needle].given;
    if (state != &sim->needles[needle].state) return pose_out(state->needle.base);
    base.position = v3_add(base.position, state->base_shift);
    return pose_out(base);
}

double trocar_sim_tip_lead(const trocar_sim *sim, int needle) {
    const insertion_state *state = state_of(sim, needle);
    return state ? state->tip_lead : 0.0;
}

double trocar_sim_needle_energy(const trocar_sim *sim, int needle) {
    const insertion_state *state = state_of(sim, needle);
    return state ? needle_energy(&sim->model->parts.needle, &state->needle) : 0.0;
}

void spread_others(const trocar_model *model, const insertion_state *const states[], const shown_probe *probe, vec3 *nominal) {
    for (int i = 0; probe && i < probe->count; i++) nominal[probe->nodes[i]] = v3_add(nominal[probe->nodes[i]], probe->force[i]);
    for (int i = 1; i < model->parts.config.needle_count; i++) {
        tissue_loads loads = {.count = 0};
        insertion_add_loads(&model->parts.insertion, states[i], &loads);
        loads_spread(&model->parts.mesh, &loads, nominal);
    }
}

trocar_status field_of(trocar_model *model, const insertion_state *const states[], const shown_probe *probe, vec3 **scratch, vec3 *nominal, vec3 *added, report *why) {
    simulation *parts = &model->parts;
    if (!*scratch) *scratch = malloc(simulation_field_scratch(parts) * sizeof **scratch);
    if (!*scratch) return fail(why, TROCAR_NO_MEMORY, "no memory for displacements");
    floating_mode before = flush_denormals();
    memset(nominal, 0, (size_t)parts->mesh.node_count * sizeof *nominal);
    spread_others(model, states, probe, nominal);
    simulation_field(parts, states[0], *scratch, nominal, added);
    restore_floating_mode(before);
    return TROCAR_OK;
}

trocar_status trocar_sim_displacements(trocar_sim *sim, double *displacements, trocar_error *error) {
    trocar_error ignored;
    const insertion_state *states[MAX_NEEDLES];
    vec3 added[MAX_CONTACTS];
    for (int i = 0; i < sim->needle_count; i++) states[i] = state_of_needle(sim, i, NULL);
    return field_of(sim->model, states, probe_shown(sim), &sim->field_scratch, (vec3 *)(void *)displacements, added, error ? error : &ignored);
}

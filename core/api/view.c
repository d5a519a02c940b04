#include "api/view.h"

#include <stdlib.h>
#include <string.h>

#include "base/flush_denormals.h"
#include "snapshot/free_displacement.h"

trocar_pose pose_out(pose base) {
    vec3 x = base.position;
    quat q = base.orientation;
    return (trocar_pose){{x.x, x.y, x.z}, {q.w, q.x, q.y, q.z}};
}

int start_out(pose start, trocar_pose *out) {
    if (isnan(start.position.x)) return 0;
    *out = pose_out(start);
    return 1;
}

int transform_out(const double matrix[16], double out[16]) {
    if (isnan(matrix[0])) return 0;
    memcpy(out, matrix, 16 * sizeof *out);
    return 1;
}

/* ---- contacts, tracks, centreline ------------------------------------------------------------------------------------------- */

static trocar_contact_status status_of(friction_state friction) {
    return friction == STICK ? TROCAR_CONTACT_STICKING : TROCAR_CONTACT_SLIDING;
}

/* Lists the needle's contacts with guides (at most MAX_GUIDE_POINTS), and returns how many there are. */
static int guide_contacts_of(const trocar_model *parent, const insertion_state *s, trocar_contact *contacts) {
    int count = 0;
    for (int i = 0; i < MAX_GUIDE_POINTS; i++) {
        const guide_contact *face = &s->guides[i / GUIDE_FACES].faces[i % GUIDE_FACES];
        if (!face->touching) continue;
        trocar_contact *contact = &contacts[count++];
        *contact = (trocar_contact){.kind = TROCAR_CONTACT_GUIDE, .state = face->friction, .arc = face->arc, .status = status_of(face->friction),
                                    .slot = i / GUIDE_FACES};
        store_vec3(needle_at(&parent->parts.needle, &s->needle, face->arc).position, contact->position);
        store_vec3(face->force, contact->force);
    }
    return count;
}

/* Sorts contacts from base to tip. */
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
        store_vec3(needle_at(model, &s->needle, contacts[i].arc).position, contacts[i].position);
        store_vec3(c->force, contacts[i].force);
    }
    if (s->tip.place.phase != TIP_INSIDE) return active;
    if (active < room) {
        contacts[active] = (trocar_contact){.kind = TROCAR_CONTACT_TIP, .state = s->tip.solved.friction, .arc = s->tip.solved.arc, .depth = s->tip.place.depth,
                                            .status = status_of(s->tip.solved.friction), .slot = -1};
        store_vec3(needle_at(model, &s->needle, s->tip.solved.arc).position, contacts[active].position);
        store_vec3(s->tip.solved.force, contacts[active].force);
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

int pending_contacts_of(const trocar_model *parent, const insertion_state *s, trocar_contact *contacts, int room) {
    const needle_model *model = &parent->parts.needle;
    int active = contacts_active(s), pending = s->refined.count - active;
    for (int i = 0; i < pending && i < room; i++) {
        int slot = s->refined.order[active + i];
        const shaft_contact *c = &s->contacts[slot];
        bool planned = c->status == CONTACT_PLANNED;
        double arc = planned ? model->given.length : contact_arc(c, model->given.length);
        contacts[i] = (trocar_contact){.kind = TROCAR_CONTACT_TISSUE, .arc = arc, .depth = c->depth, .id = s->refined.nodes[slot].id,
                                       .status = planned ? TROCAR_CONTACT_PLANNED : TROCAR_CONTACT_ADDING, .slot = slot};
        store_vec3(planned ? c->track : needle_at(model, &s->needle, arc).position, contacts[i].position);
    }
    return pending;
}

int tracks_of(const insertion_state *state, trocar_track_point *points, int room) {
    const track_list *list = &state->tracks;
    for (int track = 0; track < list->count; track++)
        for (int i = list->first[track]; i < track_end(list, track) && i < room; i++) {
            const track_point *p = &list->points[i];
            points[i] = (trocar_track_point){.tet = p->tet, .track = track, .membrane = p->membrane};
            store_vec3(p->at, points[i].position);
        }
    return list->point_count;
}

int centreline_of(const trocar_model *model, const insertion_state *state, double *joints, int room) {
    int count = model->parts.needle.given.segments + 1;
    for (int j = 0; j < count && j < room; j++) store_vec3(state->needle.joints[j], joints + 3 * j);
    return count;
}

/* ---- displacements ------------------------------------------------------------------------------------------------------------ */

void spread_others(const trocar_model *model, const insertion_state *const states[], const shown_probe *probe, vec3 *nominal) {
    for (int i = 0; probe && i < probe->count; i++) nominal[probe->nodes[i]] = v3_add(nominal[probe->nodes[i]], probe->force[i]);
    for (int i = 1; i < model->parts.config.needle_count; i++) {
        tissue_loads loads = {.count = 0};
        insertion_add_loads(&model->parts.insertion, states[i], &loads);
        loads_spread(&model->parts.mesh, &loads, nominal);
    }
}

trocar_status field_of(const trocar_model *model, inverse *inv, const insertion_state *const states[], const shown_probe *probe, vec3 **scratch, vec3 *nominal, vec3 *added,
                       trocar_error *why) {
    const model_parts *parts = &model->parts;
    if (!*scratch) *scratch = malloc(model_parts_field_scratch(parts) * sizeof **scratch);
    if (!*scratch) return fail(why, TROCAR_NO_MEMORY, "no memory for displacements");
    floating_mode before = flush_denormals();
    memset(nominal, 0, (size_t)parts->mesh.node_count * sizeof *nominal);
    spread_others(model, states, probe, nominal);
    model_parts_field(parts, inv, states[0], *scratch, nominal, added);
    restore_floating_mode(before);
    return TROCAR_OK;
}

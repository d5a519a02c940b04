#include "common/viewer_messages.h"

#include <stdlib.h>
#include <string.h>

static void lay_out_rows(viewer_messages *v) {
    for (int n = 0; n < v->node_count; n++) v->displacement_rows[n] = v->displacement + 3 * (size_t)n;
    for (int j = 0; j < TROCAR_MAX_JOINTS; j++) v->joint_rows[j] = v->joints[j];
    for (int i = 0; i < TROCAR_MAX_TRACK_POINTS; i++) v->track_rows[i] = v->track_points[i];
    for (int k = 0; k < 4; k++)
        for (int i = 0; i < TROCAR_MAX_SEEDS; i++) v->seed_rows[k][i] = v->seed_vectors[k][i];
    for (int i = 0; i < VIEWER_CONTACTS; i++) {
        v->position_rows[i] = v->positions[i];
        v->force_rows[i] = v->forces[i];
    }
}

trocar_status viewer_messages_create(viewer_messages *v, trocar_model *model, trocar_error *why) {
    size_t count = (size_t)trocar_model_node_count(model);
    *v = (viewer_messages){.node_count = (int)count, .model = model};
    trocar_status status = trocar_picture_create(model, &v->picture, why);
    if (status != TROCAR_OK) return status;
    v->nodal = malloc(3 * count * sizeof *v->nodal);
    v->displacement = malloc(3 * count * sizeof *v->displacement);
    v->displacement_rows = malloc(count * sizeof *v->displacement_rows);
    if (!v->nodal || !v->displacement || !v->displacement_rows) {
        viewer_messages_free(v);
        return fail(why, TROCAR_NO_MEMORY, "cannot allocate the viewers' messages for %zu nodes", count);
    }
    lay_out_rows(v);
    return TROCAR_OK;
}

void viewer_messages_free(viewer_messages *v) {
    trocar_picture_free(v->picture);
    free(v->nodal);
    free(v->displacement);
    free(v->displacement_rows);
    *v = (viewer_messages){0};
}

void viewer_messages_make_needle(viewer_messages *v, int needle, int64_t tick, int64_t pose_utime) {
    const trocar_view *view = trocar_picture_view(v->picture);
    trocar_contact contacts[VIEWER_CONTACTS];
    trocar_pose base = trocar_view_base(view, needle);
    v->contacts = (trocar_contacts_t){.needle = needle, .tick = tick, .pose_utime = pose_utime,
                                      .tip_lead = trocar_view_tip_lead(view, needle), .centreline = v->joint_rows,
                                      .position = v->position_rows, .force = v->force_rows, .arc = v->arc, .state = v->sliding, .kind = v->kind};
    memcpy(v->contacts.orientation, base.orientation, sizeof base.orientation);
    v->contacts.joint_count = trocar_view_centreline(view, needle, v->joints[0], TROCAR_MAX_JOINTS);
    v->contacts.contact_count = trocar_view_contacts(view, needle, contacts, VIEWER_CONTACTS);
    for (int i = 0; i < v->contacts.contact_count; i++) {
        memcpy(v->positions[i], contacts[i].position, sizeof v->positions[i]);
        memcpy(v->forces[i], contacts[i].force, sizeof v->forces[i]);
        v->arc[i] = contacts[i].arc;
        v->sliding[i] = (int8_t)contacts[i].state;
        v->kind[i] = (int8_t)contacts[i].kind;
    }
}

void viewer_messages_make_tracks(viewer_messages *v, int needle, int64_t tick) {
    v->tracks = (trocar_tracks_t){.needle = needle, .tick = tick, .position = v->track_rows, .tet = v->track_tets, .track = v->track_numbers,
                                  .membrane = v->track_membranes};
    v->tracks.point_count = trocar_view_tracks(trocar_picture_view(v->picture), needle, v->track_scratch, TROCAR_MAX_TRACK_POINTS);
    for (int i = 0; i < v->tracks.point_count; i++) {
        const trocar_track_point *p = &v->track_scratch[i];
        for (int a = 0; a < 3; a++) v->track_points[i][a] = (float)p->position[a];
        v->track_tets[i] = p->tet;
        v->track_numbers[i] = (int16_t)p->track;
        v->track_membranes[i] = (int8_t)p->membrane;
    }
}

trocar_status viewer_messages_make_tissue(viewer_messages *v, int64_t tick, trocar_error *why) {
    trocar_status status = trocar_view_displacements(trocar_picture_view(v->picture), v->nodal, why);
    if (status != TROCAR_OK) return status;
    for (size_t i = 0; i < 3 * (size_t)v->node_count; i++) v->displacement[i] = (float)v->nodal[i];
    v->deformation = (trocar_deformation_t){.tick = tick, .node_count = v->node_count, .displacement = v->displacement_rows};
    return TROCAR_OK;
}

static void set_row(float row[3], const double v[3]) {
    for (int a = 0; a < 3; a++) row[a] = (float)v[a];
}

void viewer_messages_make_seeds(viewer_messages *v, int64_t tick) {
    trocar_seed_size size = trocar_model_seed_size(v->model);
    v->seeds = (trocar_seeds_t){.tick = tick, .length = size.length, .diameter = size.diameter, .needle_count = trocar_model_needles(v->model),
                                .pending = v->seeds_pending, .position = v->seed_rows[0], .direction = v->seed_rows[1], .rest_position = v->seed_rows[2],
                                .rest_direction = v->seed_rows[3], .needle = v->seed_numbers[0], .guide = v->seed_numbers[1], .hole = v->seed_numbers[2],
                                .strand = v->seed_numbers[3]};
    for (int i = 0; i < v->seeds.needle_count; i++) v->seeds_pending[i] = (int16_t)trocar_view_pending_seeds(trocar_picture_view(v->picture), i);
    v->seeds.seed_count = trocar_view_seeds(trocar_picture_view(v->picture), v->seed_scratch, TROCAR_MAX_SEEDS);
    for (int i = 0; i < v->seeds.seed_count; i++) {
        const trocar_seed *s = &v->seed_scratch[i];
        double position[3], direction[3];
        trocar_model_displace_seed(v->model, v->nodal, s, position, direction);
        set_row(v->seed_vectors[0][i], position);
        set_row(v->seed_vectors[1][i], direction);
        set_row(v->seed_vectors[2][i], s->position);
        set_row(v->seed_vectors[3][i], s->direction);
        const int32_t numbers[4] = {s->needle, s->guide, s->hole, s->strand};
        for (int k = 0; k < 4; k++) v->seed_numbers[k][i] = (int16_t)numbers[k];
    }
}

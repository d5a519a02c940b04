#include "viewer_messages.h"

#include <stdlib.h>

#include "messages.h"

static void lay_out_rows(viewer_messages *v) {
    for (int n = 0; n < v->simulation->mesh.node_count; n++) v->displacement_rows[n] = v->displacement + 3 * (size_t)n;
    for (int j = 0; j <= NEEDLE_MAX_SEGMENTS; j++) v->joint_rows[j] = v->joints[j];
    for (int i = 0; i < MAX_POINTS; i++) {
        v->position_rows[i] = v->positions[i];
        v->force_rows[i] = v->forces[i];
    }
}

trocar_status viewer_messages_create(viewer_messages *v, simulation *s, report *why) {
    size_t count = (size_t)s->mesh.node_count;
    *v = (viewer_messages){.simulation = s};
    v->nodal = malloc(count * sizeof *v->nodal);
    v->added = malloc((MAX_CONTACTS + 1) * sizeof *v->added);
    v->displacement = malloc(3 * count * sizeof *v->displacement);
    v->displacement_rows = malloc(count * sizeof *v->displacement_rows);
    if (!v->nodal || !v->added || !v->displacement || !v->displacement_rows) {
        viewer_messages_free(v);
        return fail(why, TROCAR_NO_MEMORY, "cannot allocate what viewers see of %zu nodes", count);
    }
    lay_out_rows(v);
    return TROCAR_OK;
}

void viewer_messages_free(viewer_messages *v) {
    free(v->nodal);
    free(v->added);
    free(v->displacement);
    free(v->displacement_rows);
    *v = (viewer_messages){0};
}

static void add_contact(viewer_messages *v, vec3 position, vec3 force, double arc, friction_state friction) {
    int i = v->contacts.contact_count++;
    store_vec3(position, v->positions[i]);
    store_vec3(force, v->forces[i]);
    v->arc[i] = arc;
    v->sliding[i] = (int8_t)friction;
}

static void take_needle(viewer_messages *v, const insertion_state *state) {
    const needle_model *needle = &v->simulation->needle;
    int segments = needle->given.segments;
    quat q = state->needle.base.orientation;
    v->contacts = (trocar_contacts_t){.orientation = {q.w, q.x, q.y, q.z}, .joint_count = segments + 1, .centreline = v->joint_rows,
                                      .position = v->position_rows, .force = v->force_rows, .arc = v->arc, .state = v->sliding};
    for (int j = 0; j <= segments; j++) store_vec3(state->needle.joints[j], v->joints[j]);
    for (int i = 0; i < state->active; i++) {
        const shaft_contact *c = &state->contacts[i];
        add_contact(v, needle_at(needle, &state->needle, c->arc).position, c->force, c->arc, c->friction);
    }
    if (state->tip.phase == TIP_INSIDE)
        add_contact(v, state->needle.joints[segments], state->tip.force, needle->given.length, state->tip.friction);
}

static void take_tissue(viewer_messages *v, const insertion_state *state) {
    int count = v->simulation->mesh.node_count;
    simulation_displacement(v->simulation, state, v->nodal, v->added);
    for (int n = 0; n < count; n++) {
        v->displacement_rows[n][0] = (float)v->nodal[n].x;
        v->displacement_rows[n][1] = (float)v->nodal[n].y;
        v->displacement_rows[n][2] = (float)v->nodal[n].z;
    }
    v->deformation = (trocar_deformation_t){.node_count = count, .displacement = v->displacement_rows};
}

void viewer_messages_take(viewer_messages *v, const insertion_state *state, int64_t tick, int64_t pose_utime) {
    take_needle(v, state);
    take_tissue(v, state);
    v->contacts.tick = v->deformation.tick = tick;
    v->contacts.pose_utime = pose_utime;
}

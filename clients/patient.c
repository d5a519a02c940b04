#include "patient.h"

#include "messages.h"

trocar_status patient_frame_read(const trocar_scene *scene, patient_frame *frame, report *why) {
    double m[16];
    if (!trocar_scene_patient_to_mesh(scene, m))
        return fail(why, TROCAR_BAD_INPUT, "%s: has no patient_to_mesh, which patient coordinates need; trocar-anatomy writes it",
                    trocar_scene_path(scene));
    mat3 turn = {{{1e3 * m[0], 1e3 * m[1], 1e3 * m[2]}, {1e3 * m[4], 1e3 * m[5], 1e3 * m[6]}, {1e3 * m[8], 1e3 * m[9], 1e3 * m[10]}}};
    *frame = (patient_frame){v3(m[3], m[7], m[11]), q_of_matrix(&turn)};
    return TROCAR_OK;
}

vec3 patient_to_mesh(const patient_frame *frame, vec3 point) {
    return frame ? v3_axpy(1e-3, q_rotate(frame->turn, point), frame->origin) : point;
}

vec3 axes_to_patient(const patient_frame *frame, vec3 vector) { return frame ? q_rotate(q_conjugate(frame->turn), vector) : vector; }

vec3 lengths_to_patient(const patient_frame *frame, vec3 vector) {
    return frame ? v3_scale(1e3, axes_to_patient(frame, vector)) : vector;
}

vec3 mesh_to_patient(const patient_frame *frame, vec3 point) {
    return frame ? lengths_to_patient(frame, v3_sub(point, frame->origin)) : point;
}

quat turn_to_patient(const patient_frame *frame, quat orientation) {
    return frame ? q_multiply(q_conjugate(frame->turn), orientation) : orientation;
}

const char *patient_unit(const patient_frame *frame) { return frame ? "mm" : "m"; }

bool find_start(const trocar_scene *scene, const patient_frame *frame, const vec3 *given, pose *start) {
    trocar_pose p;
    bool known = trocar_scene_start(scene, &p);
    if (known) *start = load_pose(p.position, p.orientation);
    if (given) start->position = patient_to_mesh(frame, *given);
    return known || given;
}

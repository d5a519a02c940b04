#include "shared/patient.h"

#include <stdlib.h>

#include "common/messages.h"

trocar_status patient_frame_read(const trocar_scene *scene, patient_frame *frame, trocar_error *why) {
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

/* Reads the `count` numbers of a key's list. Returns false if any is missing. */
static bool read_numbers(const trocar_scene *scene, const char *key, int count, double *numbers) {
    char text[256], *rest = text;
    if (trocar_scene_get(scene, key, text, sizeof text, NULL) != TROCAR_OK) return false;
    for (int i = 0; i < count; i++) {
        char *begin = rest + 1, *end; /* after '[' or ',' */
        numbers[i] = strtod(begin, &end);
        if (end == begin || !isfinite(numbers[i])) return false;
        rest = end;
    }
    return true;
}

bool find_probe_start(const trocar_scene *scene, pose *start) {
    double x[3], q[4] = {1, 0, 0, 0};
    if (!read_numbers(scene, "probe.start.position", 3, x)) return false;
    bool turned = read_numbers(scene, "probe.start.orientation", 4, q);
    *start = (pose){.position = v3(x[0], x[1], x[2]), .orientation = turned ? (quat){q[0], q[1], q[2], q[3]} : (quat){1, 0, 0, 0}};
    return true;
}

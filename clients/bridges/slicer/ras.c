#include "ras.h"

#include "common/messages.h"

static const double TOLERANCE = 1e-3; /* allowed error in the scalar products of a rotation's columns, which arrive in single precision */
static const double FAR = 1e4;        /* mm, farthest position accepted, from the origin */

patient_frame ras_frame(const trocar_scene *scene) {
    patient_frame frame = {.turn = {1, 0, 0, 0}};
    trocar_error ignored;
    if (patient_frame_read(scene, &frame, &ignored) != TROCAR_OK) return frame;
    const quat half_turn = {0, 0, 0, 1}; /* LPS to RAS: a half turn about the head axis swaps right and left, and front and back */
    frame.turn = q_multiply(frame.turn, half_turn);
    return frame;
}

ras_matrix ras_of_pose(const patient_frame *frame, pose p) {
    mat3 turn = q_matrix(turn_to_patient(frame, p.orientation));
    vec3 place = mesh_to_patient(frame, p.position);
    ras_matrix matrix = {.numbers = {[9] = (float)place.x, (float)place.y, (float)place.z}};
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 3; column++) matrix.numbers[3 * column + row] = (float)turn.m[row][column];
    return matrix;
}

ras_matrix ras_of_vector(const patient_frame *frame, const double v[3]) {
    vec3 turned = axes_to_patient(frame, load_vec3(v));
    return (ras_matrix){{1, 0, 0, 0, 1, 0, 0, 0, 1, (float)turned.x, (float)turned.y, (float)turned.z}};
}

static vec3 column_of(const ras_matrix *m, int column) {
    const float *c = m->numbers + 3 * column;
    return v3(c[0], c[1], c[2]);
}

const char *ras_fault(const ras_matrix *m) {
    for (int i = 0; i < 12; i++)
        if (!isfinite(m->numbers[i])) return "has a number that is not finite";
    vec3 x = column_of(m, 0), y = column_of(m, 1), z = column_of(m, 2);
    for (int a = 0; a < 3; a++)
        for (int b = 0; b <= a; b++)
            if (fabs(v3_dot(column_of(m, a), column_of(m, b)) - (a == b)) > TOLERANCE) return "is not rigid";
    if (v3_dot(v3_cross(x, y), z) < 0) return "is left-handed";
    return v3_norm(column_of(m, 3)) > FAR ? "is more than 10 m away" : NULL;
}

pose ras_to_pose(const patient_frame *frame, const ras_matrix *m) {
    mat3 turn = m3_columns(column_of(m, 0), column_of(m, 1), column_of(m, 2));
    return (pose){patient_to_mesh(frame, column_of(m, 3)), q_unit(q_multiply(frame->turn, q_of_matrix(&turn)))};
}

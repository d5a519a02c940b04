#include "snapshot/snapshot_kernels.h"

#include "linalg/row_matrix.h"

static inline row_matrix rows_to_point(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], int other) {
    row_matrix sum = {{{0}}};
    for (int c = 0; c < 4; c++) {
        const double *at = &snapshot->compliance[3 * handles[c] * SNAPSHOT_LD + 3 * other], *last = at + 2 * SNAPSHOT_LD;
        sum.row[0] += weights[c] * simd4_load(at);
        sum.row[1] += weights[c] * simd4_load(at + SNAPSHOT_LD);
        sum.row[2] += weights[c] * (simd4){last[0], last[1], last[2], 0.0};
    }
    return sum;
}

mat3 compliance_to_point(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], int other) {
    return matrix_of(rows_to_point(snapshot, handles, weights, other));
}

mat3 compliance_of_point(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], const double force_weights[4]) {
    row_matrix own = {{{0}}};
    for (int c = 0; c < 4; c++) own = rm_add(own, rm_scaled(force_weights[c], rows_to_point(snapshot, handles, weights, handles[c])));
    return matrix_of(own);
}

vec3 displacement_under(const compliance_snapshot *snapshot, const int handles[4], const double weights[4], int count, const handle_load *loads) {
    row_matrix sum = {{{0}}}; /* each component of the loads is summed in its own lane */
    for (int k = 0; k < count; k++) {
        row_matrix c = rows_to_point(snapshot, handles, weights, loads[k].handle);
        for (int a = 0; a < 3; a++) sum.row[a] += c.row[a] * (simd4){loads[k].force.x, loads[k].force.y, loads[k].force.z, 0.0};
    }
    return v3(row_sum(sum.row[0]), row_sum(sum.row[1]), row_sum(sum.row[2]));
}

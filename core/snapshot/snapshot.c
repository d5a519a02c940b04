#include "snapshot/snapshot.h"

static int handle_of(const compliance_snapshot *snapshot, int node) {
    for (int k = 0; k < MAX_WINDOW; k++)
        if (snapshot->window[k] == node) return MAX_CONTACTS + k;
    return -1;
}

void snapshot_empty(compliance_snapshot *snapshot) {
    snapshot->serial = 0;
    snapshot->piece_count = 0;
    snapshot->loaded = snapshot->has_residuals = snapshot->unresolved.any = false;
}

bool snapshot_covers(const compliance_snapshot *snapshot, const int nodes[4], int handles[4]) {
    if (snapshot->serial == 0) return false;
    for (int c = 0; c < 4; c++) {
        handles[c] = handle_of(snapshot, nodes[c]);
        if (handles[c] < 0) return false;
    }
    return true;
}

mat3 compliance_between(const compliance_snapshot *snapshot, int handle, int other) {
    if (handle < MAX_CONTACTS && other < MAX_CONTACTS) {
        const contact_rows *rows = &snapshot->between_contacts[handle < other ? handle : other];
        mat3 pair;
        for (int a = 0; a < 9; a++) pair.m[a / 3][a % 3] = rows->at[a / 3][a % 3][handle < other ? other : handle];
        return handle <= other ? pair : m3_transposed(&pair);
    }
    mat3 block = {{{0}}};
    m3_add_block(&block, 1.0, &snapshot->compliance[3 * handle * SNAPSHOT_LD + 3 * other], SNAPSHOT_LD);
    return block;
}

int snapshot_known_contacts(const compliance_snapshot *snapshot, const refinement *refined) {
    if (snapshot->serial == 0) return 0;
    int known = 0;
    while (known < refined->count && refined->nodes[refined->order[known]].id == snapshot->ids[refined->order[known]]) known++;
    return known;
}

static bool lines_agree(const line_in_tet *a, const line_in_tet *b, line_tolerance tolerance) {
    vec3 off = v3_cross(a->direction, v3_sub(b->point, a->point));
    return a->tet == b->tet && v3_norm(off) < tolerance.aside && v3_norm(v3_sub(b->direction, a->direction)) < tolerance.turn;
}

const line_in_tet *request_line(const remesh_request *request, const line_in_tet *line, line_tolerance tolerance) {
    for (int i = 0; i < request->piece_count; i++)
        if (lines_agree(&request->pieces[i], line, tolerance)) return &request->pieces[i];
    return NULL;
}

const line_piece *snapshot_piece(const compliance_snapshot *snapshot, int tet) {
    for (int i = 0; i < snapshot->piece_count; i++)
        if (snapshot->pieces[i].line.tet == tet) return &snapshot->pieces[i];
    return NULL;
}

/* Along the line within an element, displacements due to a line force vary linearly, and those due to a force at the point itself quadratically. */
resolved_field piece_at(const line_piece *piece, vec3 x) {
    const resolved_field *f = piece->at;
    double way = v3_dot(v3_sub(x, piece->start), piece->line.direction);
    double s = piece->length > 0.0 ? fmin(fmax(way / piece->length, 0.0), 1.0) : 0.0, t = 1.0 - s;
    mat3 uneven = m3_scaled(t, f[0].uneven);
    m3_add_scaled(&uneven, s, &f[2].uneven);
    line_end end = {0};
    line_end_add_scaled(&end, t, &f[0].end);
    line_end_add_scaled(&end, s, &f[2].end);
    return (resolved_field){.uneven = uneven, .end = end, .lateral = exp(t * log(f[0].lateral) + s * log(f[2].lateral)),
                            .axial = exp(t * log(f[0].axial) + s * log(f[2].axial)),
                            .point = t * (t - s) * f[0].point + 4.0 * s * t * f[1].point + s * (s - t) * f[2].point};
}

static vec3 summed_up_to(const unresolved_shift *shift, double depth) {
    double steps = larger_of((depth - shift->start) / shift->step, 0.0);
    int k = smaller_of(steps, shift->count - 1);
    return v3_axpy(steps - k, v3_sub(shift->sum[k + 1], shift->sum[k]), shift->sum[k]);
}

vec3 unresolved_mean(const unresolved_shift *shift, double from, double to) {
    if (!shift->any || !(to > from)) return v3(0, 0, 0);
    return v3_scale(1.0 / (to - from), v3_sub(summed_up_to(shift, to), summed_up_to(shift, from)));
}

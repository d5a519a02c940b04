#include "saved/saved_state.h"

#include "base/hash.h"

uint64_t saved_layout(void) {
    static const size_t facts[] = {
        SAVED_FORMAT, sizeof(insertion_state), sizeof(needle_tip), sizeof(shaft_contact), sizeof(added_node), sizeof(share_memory), sizeof(residual_load), sizeof(stratum),
        sizeof(track_point), sizeof(line_in_tet), sizeof(compliance_snapshot), sizeof(line_piece), sizeof(resolved_field), sizeof(resting_needle), sizeof(contact_point),
        sizeof(attached_row), sizeof(tissue_load), sizeof(shaft_steps), sizeof(seed_list), sizeof(seed), sizeof(probe_state), sizeof(pressed_point), sizeof(needle_hold), sizeof(region_material), sizeof(membrane), sizeof(membrane_material), sizeof(calcification), sizeof(guide)};
    return hash_bytes(HASH_BASIS, facts, sizeof facts);
}

/* ---- a needle in the tissue ---------------------------------------------------------------------------------------------------- */

static void pass_needle(state_stream *s, int segments, needle_state *needle) {
    STREAM(s, needle->base);
    STREAM_ENTRIES(s, needle->frames, segments);
    STREAM_ENTRIES(s, needle->joints, segments + 1);
}

static void pass_refinement(state_stream *s, refinement *r) {
    stream_count(s, &r->count, MAX_CONTACTS);
    for (int i = 0; i < r->count; i++) {
        stream_count(s, &r->order[i], MAX_CONTACTS - 1);
        STREAM(s, r->nodes[r->order[i]]);
    }
}

static void pass_residuals(state_stream *s, residual_loads *residual) {
    STREAM(s, residual->time);
    stream_count(s, &residual->count, MAX_RESIDUAL_LOADS);
    STREAM_ENTRIES(s, residual->loads, residual->count);
}

static void pass_memory(state_stream *s, tissue_memory *memory) {
    STREAM(s, memory->time);
    STREAM(s, memory->since);
    stream_count(s, &memory->count, MAX_SHARES);
    STREAM(s, memory->tip);
    STREAM_ENTRIES(s, memory->shares, memory->count);
    STREAM(s, memory->face);
    pass_residuals(s, &memory->residual);
    STREAM(s, memory->residual_added);
    STREAM(s, memory->residual_growing);
}

static void pass_tracks(state_stream *s, track_list *tracks) {
    stream_count(s, &tracks->count, MAX_TRACKS);
    stream_count(s, &tracks->point_count, MAX_TRACK_POINTS);
    STREAM_ENTRIES(s, tracks->first, tracks->count);
    STREAM_ENTRIES(s, tracks->low, tracks->count);
    STREAM_ENTRIES(s, tracks->high, tracks->count);
    STREAM_ENTRIES(s, tracks->points, tracks->point_count);
}

static void pass_request(state_stream *s, remesh_request *request) {
    STREAM(s, request->insertion);
    STREAM(s, request->serial);
    pass_refinement(s, &request->wanted);
    stream_count(s, &request->window_count, MAX_WINDOW);
    STREAM_ENTRIES(s, request->window, request->window_count);
    stream_count(s, &request->piece_count, MAX_PIECES);
    STREAM_ENTRIES(s, request->pieces, request->piece_count);
    STREAM(s, request->needed);
    STREAM(s, request->tip);
    STREAM(s, request->direction);
    pass_residuals(s, &request->residual_loads);
}

void saved_insertion(state_stream *s, int segments, insertion_state *state) {
    if (s->reading) memset(state, 0, sizeof *state);
    STREAM(s, state->base_shift);
    pass_needle(s, segments, &state->needle);
    STREAM(s, state->motion.time);
    STREAM_ENTRIES(s, state->motion.turn, segments);
    STREAM(s, state->base_turn);
    STREAM(s, state->tip_lead);
    STREAM(s, state->tip);
    STREAM(s, state->entry);
    stream_count(s, &state->stratum_count, MAX_STRATA);
    STREAM_ENTRIES(s, state->strata, state->stratum_count);
    pass_refinement(s, &state->refined);
    for (int i = 0; i < state->refined.count; i++) STREAM(s, state->contacts[state->refined.order[i]]);
    STREAM(s, state->guides);
    STREAM(s, state->watched);
    STREAM(s, state->outside);
    STREAM(s, state->moving_on);
    STREAM(s, state->surface);
    pass_memory(s, &state->memory);
    pass_tracks(s, &state->tracks);
    STREAM(s, state->next_id);
    pass_request(s, &state->request);
}

/* ---- the inverse at its handles ------------------------------------------------------------------------------------------------- */

static int list_handles(const compliance_snapshot *snapshot, int handles[MAX_HANDLES]) {
    int count = 0;
    if (snapshot->serial == 0) return 0; /* the worker has not answered yet */
    for (int i = 0; i < MAX_CONTACTS; i++)
        if (snapshot->ids[i] != 0) handles[count++] = i;
    for (int k = 0; k < MAX_WINDOW; k++)
        if (snapshot->window[k] >= 0) handles[count++] = MAX_CONTACTS + k;
    return count;
}

static double *block_at(compliance_snapshot *snapshot, int handle, int other) {
    return snapshot->compliance + (size_t)3 * (size_t)handle * SNAPSHOT_LD + 3 * other;
}

static bool is_symmetric(compliance_snapshot *snapshot, int count, const int *handles) {
    for (int i = 0; i < count; i++)
        for (int j = 0; j < i; j++) {
            const double *upper = block_at(snapshot, handles[j], handles[i]), *lower = block_at(snapshot, handles[i], handles[j]);
            for (int a = 0; a < 3; a++)
                for (int b = 0; b < 3; b++)
                    if (memcmp(&upper[a * SNAPSHOT_LD + b], &lower[b * SNAPSHOT_LD + a], sizeof *upper) != 0) return false;
        }
    return true;
}

static void mirror(compliance_snapshot *snapshot, int count, const int *handles) {
    for (int i = 0; i < count; i++)
        for (int j = 0; j < i; j++) {
            const double *upper = block_at(snapshot, handles[j], handles[i]);
            double *lower = block_at(snapshot, handles[i], handles[j]);
            for (int a = 0; a < 9; a++) lower[a % 3 * SNAPSHOT_LD + a / 3] = upper[a / 3 * SNAPSHOT_LD + a % 3];
        }
}

/* Passes the compliance between these handles. If the matrix is exactly symmetric, passes only the blocks on and above the diagonal. */
static void pass_compliance(state_stream *s, int count, const int *handles, compliance_snapshot *snapshot) {
    bool symmetric = !s->reading && is_symmetric(snapshot, count, handles);
    STREAM(s, symmetric);
    for (int i = 0; i < count; i++)
        for (int a = 0; a < 3; a++)
            for (int j = symmetric ? i : 0; j < count; j++) stream_pass(s, block_at(snapshot, handles[i], handles[j]) + a * SNAPSHOT_LD, 3 * sizeof(double));
    if (s->reading && symmetric) mirror(snapshot, count, handles);
}

static void pass_between_contacts(state_stream *s, int count, const int *slots, contact_rows *rows) {
    for (int i = 0; i < count; i++)
        for (int j = i; j < count; j++) {
            double block[9];
            for (int a = 0; a < 9; a++) block[a] = rows[slots[i]].at[a / 3][a % 3][slots[j]];
            STREAM(s, block);
            for (int a = 0; a < 9; a++) rows[slots[i]].at[a / 3][a % 3][slots[j]] = block[a];
        }
}

static void pass_shift(state_stream *s, unresolved_shift *shift) {
    STREAM(s, shift->any);
    STREAM(s, shift->start);
    STREAM(s, shift->step);
    stream_count(s, &shift->count, SHIFT_STEPS);
    STREAM_ENTRIES(s, shift->sum, shift->count + 1);
}

void saved_snapshot(state_stream *s, compliance_snapshot *snapshot) {
    int handles[MAX_HANDLES], contacts = 0;
    STREAM(s, snapshot->insertion);
    STREAM(s, snapshot->serial);
    STREAM(s, snapshot->ids);
    STREAM(s, snapshot->window);
    int count = list_handles(snapshot, handles);
    while (contacts < count && handles[contacts] < MAX_CONTACTS) STREAM(s, snapshot->resolved[handles[contacts++]]);
    pass_between_contacts(s, contacts, handles, snapshot->between_contacts);
    stream_count(s, &snapshot->piece_count, MAX_PIECES);
    STREAM_ENTRIES(s, snapshot->pieces, snapshot->piece_count);
    STREAM(s, snapshot->loaded);
    STREAM(s, snapshot->has_residuals);
    STREAM(s, snapshot->residual_time);
    if (s->reading) memset(snapshot->u_free, 0, sizeof snapshot->u_free);
    for (int i = 0; i < count; i++) {
        if (snapshot->loaded) STREAM(s, snapshot->u_free[handles[i]]);
        for (int term = 0; term < MAX_RELAXATION && snapshot->has_residuals; term++) STREAM(s, snapshot->u_residual[term][handles[i]]);
    }
    pass_shift(s, &snapshot->unresolved);
    for (int term = 0; term < MAX_RELAXATION && snapshot->has_residuals; term++) pass_shift(s, &snapshot->unresolved_residual[term]);
    pass_compliance(s, count, handles, snapshot);
}

/* ---- resting needles, seeds and probe --------------------------------------------------------------------------------------------- */

static void pass_steps(state_stream *s, shaft_steps *steps) {
    STREAM(s, steps->start);
    STREAM(s, steps->step);
    stream_count(s, &steps->count, SHIFT_STEPS);
    STREAM_ENTRIES(s, steps->at, steps->count);
}

void saved_resting(state_stream *s, int segments, resting_needle *r) {
    if (s->reading) memset(r, 0, sizeof *r);
    STREAM(s, r->id);
    saved_insertion(s, segments, &r->anchor);
    stream_count(s, &r->point_count, MAX_POINTS);
    stream_count(s, &r->unknown_count, MAX_UNKNOWNS);
    stream_count(s, &r->axial_count, MAX_AXIAL);
    stream_count(s, &r->motion_count, MAX_MOTIONS);
    STREAM(s, r->tip);
    STREAM(s, r->loaded);
    STREAM(s, r->alone);
    STREAM_ENTRIES(s, r->points, r->point_count);
    STREAM_ENTRIES(s, r->rows, r->unknown_count);
    stream_count(s, &r->places.count, MAX_LOADS);
    STREAM_ENTRIES(s, r->places.loads, r->places.count);
    pass_steps(s, &r->steps);
    for (int u = 0; u < r->unknown_count; u++) STREAM_ENTRIES(s, r->compliance[u], u + 1);
    for (int m = 0; m < r->motion_count; m++) STREAM_ENTRIES(s, r->motions[m], r->unknown_count);
    STREAM_ENTRIES(s, r->twists, r->motion_count);
    double *of_unknowns[] = {r->offset, r->anchor_force, r->beside, r->free_force, r->force, r->aside, r->fading};
    for (size_t i = 0; i < sizeof of_unknowns / sizeof *of_unknowns; i++) STREAM_ENTRIES(s, of_unknowns[i], r->unknown_count);
    double *of_axial[] = {r->lower, r->upper, r->slip, r->slid};
    for (size_t i = 0; i < sizeof of_axial / sizeof *of_axial; i++) STREAM_ENTRIES(s, of_axial[i], r->axial_count);
    STREAM(s, r->free_motion);
    STREAM(s, r->motion);
}

static void pass_drop(state_stream *s, seed_drop *drop) {
    stream_count(s, &drop->count, MAX_STRAND);
    stream_count(s, &drop->placed, drop->count);
    STREAM_ENTRIES(s, drop->seeds, drop->count);
    STREAM_ENTRIES(s, drop->uncovered, drop->count);
}

void saved_seeds(state_stream *s, int needle_count, seed_list *seeds) {
    if (s->reading) memset(seeds, 0, sizeof *seeds);
    stream_count(s, &seeds->count, MAX_SEEDS);
    STREAM_ENTRIES(s, seeds->seeds, seeds->count);
    for (int i = 0; i < needle_count; i++) pass_drop(s, &seeds->drops[i]);
}

void saved_probe(state_stream *s, probe_state *probe) {
    if (s->reading) memset(probe, 0, sizeof *probe);
    STREAM(s, probe->placed);
    STREAM(s, probe->stopped);
    STREAM(s, probe->base);
    STREAM(s, probe->wrench_force);
    STREAM(s, probe->wrench_torque);
    stream_count(s, &probe->count, MAX_PRESSED);
    STREAM_ENTRIES(s, probe->points, probe->count);
}

void saved_hold(state_stream *s, needle_hold *hold) {
    stream_count(s, &hold->count, MAX_HOLD_ROWS);
    STREAM(s, hold->unstable);
    STREAM_ENTRIES(s, hold->rows, hold->count);
    STREAM_ENTRIES(s, hold->compliance, hold->count * (hold->count + 1) / 2);
}

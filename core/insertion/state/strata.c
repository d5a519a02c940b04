#include "insertion/state/strata.h"

void note_stratum(insertion_state *state, tick_output *output, int region) {
    const needle_tip *tip = &state->tip;
    int last = state->stratum_count - 1;
    if (last >= 0 && state->strata[last].region == region) return;
    if (last + 1 < MAX_STRATA) state->strata[state->stratum_count++] = (stratum){.depth = tip->place.depth, .region = region, .tet = tip->place.tet, .point = tip->place.nominal};
    else output->events |= EVENT_FULL;
}

void enter_stratum(const tick_input *tick, insertion_state *state, tick_output *output) {
    note_stratum(state, output, tick->model->mesh->region[state->tip.place.tet]);
}

int last_gap(const insertion_state *state) {
    int k = state->stratum_count - 1;
    while (k >= 0 && state->strata[k].region != IN_A_GAP) k--;
    return k;
}

double tip_entry_depth(const insertion_state *state) {
    int gap = last_gap(state);
    return gap >= 0 ? state->strata[gap + 1].depth : 0.0;
}

int last_sliding(const insertion_state *state, double depth) {
    int k = state->stratum_count - 1;
    while (k >= 0 && !(state->strata[k].slides && state->strata[k].depth < depth)) k--;
    return k;
}

double tip_bonded_depth(const insertion_state *state) {
    int k = last_sliding(state, INFINITY);
    return fmax(k >= 0 ? state->strata[k].depth : 0.0, tip_entry_depth(state));
}

void drop_strata_ahead(insertion_state *state) {
    while (state->stratum_count > 1 && state->strata[state->stratum_count - 1].depth > state->tip.place.depth) state->stratum_count--;
}

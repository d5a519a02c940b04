#include "insertion/step/hold.h"

#include <string.h>

#include "insertion/contact/contact_assembly.h"
#include "insertion/contact/tissue_stage.h"
#include "insertion/guide/guides.h"

_Static_assert((int)MAX_HOLD_ROWS >= (int)MAX_UNKNOWNS, "a needle may stick at all points");

/* True if displacing the tissue changes the force at this unknown. A needle that does not touch its guide exerts no force, and a sliding point exerts a
   constant one. */
static bool holds(const insertion_workspace *w, int u) {
    const contact_problem *p = &w->problem;
    int along = u - 2 * p->count;
    if (guides_is_open(&w->points, w->edges, point_of_unknown(p->count, u))) return false;
    return along < 0 || (p->state[along] == STICK && p->upper[along] > p->lower[along]);
}

static attached_row row_of(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, int u) {
    const contact_point *point = &w->points.list[point_of_unknown(w->problem.count, u)];
    int axis = axis_of_unknown(w->problem.count, u);
    attached_row row = {.tet = -1, .direction = m3_column(&point->at.frame, axis)};
    if (point->kind == POINT_TIP && state->tip.known.tet >= 0) {
        row.tet = state->tip.known.tet;
        memcpy(row.weights, state->tip.known.weights, sizeof row.weights);
    } else if (point->kind == POINT_TISSUE) {
        const added_node *node = &state->refined.nodes[point->handle];
        row.tet = node->tet;
        mesh_barycentric(tick->model->mesh, node->tet, node->position, row.weights);
    }
    return row;
}

void insertion_hold(const tick_input *tick, const insertion_state *state, insertion_workspace *w, needle_hold *hold) {
    const contact_problem *p = &w->problem;
    int held[MAX_HOLD_ROWS];
    hold->count = hold->unstable = 0;
    if (w->points.count == 0 || !touches_tissue(state)) return;
    hold->unstable = w->response.tangent.unstable;
    double yield = w->creep.yield; /* the rows are for loads, yield * force, which displace elastic tissue as much as the forces displace relaxing tissue */
    w->creep.yield = 0.0;
    memset(w->tissue.tip_row, 0, sizeof w->tissue.tip_row);
    assemble_compliance(tick, state, w); /* with a yield of 0, this leaves out the compliance of the nominal mesh */
    for (int u = 0; u < unknown_count(p); u++) {
        if (!holds(w, u)) continue;
        int i = hold->count++;
        held[i] = u;
        hold->rows[i] = row_of(tick, state, w, u);
        for (int j = 0; j <= i; j++) hold->compliance[i * (i + 1) / 2 + j] = p->compliance[held[j]][u] / yield;
    }
}

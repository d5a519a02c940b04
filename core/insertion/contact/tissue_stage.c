#include "insertion/contact/tissue_stage.h"

#include "insertion/contact/contact_assembly.h"
#include "insertion/contact/tip_damper.h"
#include "insertion/guide/guides.h"
#include "insertion/laws/creep.h"
#include "insertion/laws/stiffening.h"
#include "insertion/tip/known_tissue.h"

static void lose_contact(const tick_input *tick, insertion_state *state, const creep_step *creep) {
    state->tip_lead = 0.0;
    creep_deposit_all(tick->model, &state->memory, creep->decay);
}

bool tissue_find(const tick_input *tick, insertion_state *state, contact_points *points, tissue_step *tissue, creep_step *creep, stiffening_step *stiffening,
                 damper_step *damper, tick_output *output) {
    int handles[4];
    points->tip = state->tip.place.phase == TIP_INSIDE;
    points->count = 0;
    if (points->tip) {
        follow_known_point(tick, state, output, handles);
        follow_resolution(tick, state, output);
    }
    if (!touches_tissue(state)) lose_contact(tick, state, creep);
    if (!touches_tissue(state) && !guides_hold(tick->model, state)) return false;
    points_list(tick, state, points);
    creep_divide(tick, state, points, creep);
    if (points->tip) find_tip_rows(tick, state, points, tissue, creep, handles);
    damper->relaxed = points->tip ? damper_relaxed(tick->model, &state->tip, tick->dt) : 1.0;
    keep_shear(tick, state, points, creep);
    find_local_compliance(tick, state, points, tissue);
    stiffening_prepare(tick, state, points, tissue, stiffening);
    creep_prepare(tick, state, points, tissue, creep, stiffening);
    return true;
}

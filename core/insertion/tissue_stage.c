#include "insertion/tissue_stage.h"

#include "insertion/contact_assembly.h"
#include "insertion/creep.h"
#include "insertion/guides.h"
#include "insertion/known_tissue.h"
#include "insertion/stiffening.h"
#include "insertion/tip_damper.h"

static void lose_contact(const tick_context *tick) {
    tick->state->tip_lead = 0.0;
    creep_leave_all(tick->model, &tick->state->memory, tick->scratch->creep.decay);
}

bool tissue_find(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    insertion_state *state = tick->state;
    int handles[4];
    w->points.tip = state->tip.place.phase == TIP_INSIDE;
    w->points.count = 0;
    if (w->points.tip) {
        follow_known_point(tick, handles);
        follow_resolution(tick);
    }
    if (!touches_tissue(state)) lose_contact(tick);
    if (!touches_tissue(state) && !guides_hold(tick->model, state)) return false;
    list_points(tick);
    creep_share_out(tick);
    if (w->points.tip) find_tip_rows(tick, handles);
    w->damper.relaxed = w->points.tip ? tip_relaxed(tick->model, &state->tip, tick->dt) : 1.0;
    keep_shear(tick);
    find_local_compliance(tick);
    stiffening_prepare(tick);
    creep_recall(tick);
    return true;
}

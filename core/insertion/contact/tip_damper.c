#include "insertion/contact/tip_damper.h"

#include "insertion/laws/along_track.h"
#include "insertion/laws/creep.h"
#include "insertion/model/local_compliance.h"
#include "linalg/rows.h"

/* Returns 1 - exp(-c dt / dent), where c is the speed of shear waves: the fraction of its rebound that tissue displaced by `dent` (m) completes within dt. */
static double part_of_wave(const insertion_model *model, const needle_tip *tip, double dent, double dt) {
    return dent == 0.0 ? 1.0 : -expm1(-dt * local_wave_speed(model, tip->place.tet, tip->place.nominal) / fabs(dent));
}

double damper_relaxed(const insertion_model *model, const needle_tip *tip, double dt) {
    return tip->solved.friction == SLIP_FORWARD ? part_of_wave(model, tip, tip->dent.size, dt) : 1.0;
}

/* Returns the part of the tissue's displacement (m) along the track at the tip that does not depend on this step's forces. */
static double dent_without_forces(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                                  const stiffening_step *stiffening) {
    return creep_dent(tick, state, points, tissue, creep) + stiffening->end.offset + state->tip.dent.offset;
}

/* Returns the displacement of the tip along the track (m/N) for a unit force at point i in each direction of the world frame. */
static vec3 moved_by(const tissue_step *tissue, int i, vec3 along) { return m3_apply_transposed(&tissue->tip_row[i], along); }

void damper_keep_dent(insertion_state *state, const contact_points *points, const tissue_step *tissue) {
    int t = points->count - 1;
    vec3 along = state->tip.place.direction, own = m3_apply(&tissue->tip_row[t], along);
    for (int i = t - points->added; i < t; i++)
        state->tip.dent.offset += v3_dot(v3_sub(own, moved_by(tissue, i, along)), point_force(state, &points->list[i]));
}

_Static_assert(MAX_UNKNOWNS % ROW_STEP == 0, "the column is read in whole steps");

void damper_eliminate(const tick_input *tick, const insertion_state *state, insertion_workspace *w) {
    contact_problem *p = &w->problem;
    int t = p->count - 1, tip = unknown(p->count, t, 2), all = tip + 2;
    double *a = w->damper.column;
    vec3 along = state->tip.place.direction, own = m3_apply(&w->tissue.tip_row[t], along);
    for (int i = 0; i < p->count; i++) {
        vec3 moved = m3_apply_transposed(&w->points.list[i].at.frame, moved_by(&w->tissue, i, along));
        a[unknown(p->count, i, 0)] = moved.x;
        a[unknown(p->count, i, 1)] = moved.y;
        a[unknown(p->count, i, 2)] = moved.z;
    }
    a[tip + 1] = a[tip];
    double face = w->tissue.axial[t] + w->stiffening.end.slope;
    const track_shares at = along_track(state, &w->points, &w->tissue, t);
    for (int i = 0; i < at.count; i++) a[at.row[i]] += face * at.on_face[i] * at.along[i];
    w->damper.yield = v3_dot(along, own) + face;
    double held = (1.0 - w->damper.relaxed) / w->damper.yield;
    if (held == 0.0) return;
    /* displacement caused by this step's forces */
    double dent = state->tip.dent.size - dent_without_forces(tick, state, &w->points, &w->tissue, &w->creep, &w->stiffening);
    for (int i = 0; i < all; i++) {
        double left = held * a[i];
        row_subtract(left, a, i, all, p->compliance[i]);
        p->gap[i] -= left * dent;
    }
}

/* Returns the displacement (m) of the tissue at the tip in static equilibrium with the forces. */
static double static_dent(const tick_input *tick, const insertion_state *state, const insertion_workspace *w) {
    const contact_problem *p = &w->problem;
    int tip = unknown(p->count, p->count - 1, 2);
    double u = dent_without_forces(tick, state, &w->points, &w->tissue, &w->creep, &w->stiffening);
    for (int i = 0; i < tip + 2; i++) u += w->damper.column[i] * p->force[i];
    return u;
}

void damper_find_force(const tick_input *tick, insertion_state *state, const insertion_workspace *w) {
    needle_tip *tip = &state->tip;
    tip->dent.damping = v3_scale((1.0 - w->damper.relaxed) * (tip->dent.size - static_dent(tick, state, w)) / w->damper.yield, tip->place.direction);
}

void damper_conclude(const tick_input *tick, insertion_state *state, const insertion_workspace *w) {
    double u = static_dent(tick, state, w), dent = w->damper.relaxed * u + (1.0 - w->damper.relaxed) * state->tip.dent.size;
    state->tip.dent.offset *= 1.0 - part_of_wave(tick->model, &state->tip, larger_of(fabs(dent), fabs(state->tip.dent.offset)), tick->dt);
    state->tip.dent.damping = v3_scale((dent - u) / w->damper.yield, state->tip.place.direction);
    state->tip.dent.size = dent;
}

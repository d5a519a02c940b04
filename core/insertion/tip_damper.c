#include "insertion/tip_damper.h"

#include "insertion/along_track.h"
#include "insertion/creep.h"
#include "insertion/local_compliance.h"
#include "linalg/rows.h"

double tip_relaxed(const insertion_model *model, const needle_tip *tip, double dt) {
    if (tip->friction != SLIP_FORWARD || tip->dent == 0.0) return 1.0;
    return -expm1(-dt * local_wave_speed(model, tip->tet, tip->nominal) / fabs(tip->dent));
}

/* Displacement of the tissue at the tip along the track that does not depend on this step's forces, m. */
static double dent_without_forces(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    return creep_dent(tick) + w->stiffening.end.offset + tick->state->tip.offset;
}

/* The displacement that the forces before this step would hold, m. */
static double dent_before(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    int count = w->point_count;
    vec3 along = tick->state->tip.direction;
    double u = dent_without_forces(tick) + (w->axial[count - 1] + w->stiffening.end.slope) * force_on_face(tick);
    for (int i = w->guided; i < count; i++) u += v3_dot(m3_apply(&w->tip_row[i], along), *point_force(tick->state, &w->points[i]));
    return u;
}

void keep_dent(const tick_context *tick) {
    needle_tip *tip = &tick->state->tip;
    double change = tip->held_dent - dent_before(tick);
    contact_point *p = &tick->scratch->points[tick->scratch->point_count - 1];
    tip->offset += change;
    p->target = v3_axpy(change, tip->direction, p->target);
}

_Static_assert(MAX_UNKNOWNS % ROW_STEP == 0, "the column is read in whole steps");

void damp_tip(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    contact_problem *p = &w->problem;
    int t = p->count - 1, tip = unknown(p->count, t, 2), all = tip + 2;
    double *a = w->tip_column;
    vec3 along = tick->state->tip.direction, own = m3_apply(&w->tip_row[t], along);
    for (int i = 0; i < p->count; i++) {
        vec3 moved = m3_apply_transposed(&w->tip_row[i], along);
        moved = m3_apply_transposed(&w->points[i].at.frame, moved);
        a[unknown(p->count, i, 0)] = moved.x;
        a[unknown(p->count, i, 1)] = moved.y;
        a[unknown(p->count, i, 2)] = moved.z;
    }
    a[tip + 1] = a[tip];
    double face = w->axial[t] + w->stiffening.end.slope;
    const track_shares at = along_track(tick, t);
    for (int i = 0; i < at.count; i++) a[at.row[i]] += face * at.on_face[i] * at.along[i];
    w->tip_yield = v3_dot(along, own) + face;
    double held = (1.0 - w->relaxed) / w->tip_yield;
    if (held == 0.0) return;
    double dent = tick->state->tip.dent - dent_without_forces(tick); /* what this step's forces displace */
    for (int i = 0; i < all; i++) {
        double left = held * a[i];
        row_subtract(left, a, i, all, p->compliance[i]);
        p->gap[i] -= left * dent;
    }
}

/* The displacement that the forces would hold statically, m. */
static double static_dent(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    const contact_problem *p = &w->problem;
    int tip = unknown(p->count, p->count - 1, 2);
    double u = dent_without_forces(tick);
    for (int i = 0; i < tip + 2; i++) u += w->tip_column[i] * p->force[i];
    return u;
}

void take_damping(const tick_context *tick) {
    needle_tip *tip = &tick->state->tip;
    const insertion_workspace *w = tick->scratch;
    tip->damping = v3_scale((1.0 - w->relaxed) * (tip->dent - static_dent(tick)) / w->tip_yield, tip->direction);
}

void spring_back(const tick_context *tick) {
    insertion_state *state = tick->state;
    const insertion_workspace *w = tick->scratch;
    double u = static_dent(tick), dent = w->relaxed * u + (1.0 - w->relaxed) * state->tip.dent;
    state->tip.damping = v3_scale((dent - u) / w->tip_yield, state->tip.direction);
    state->tip.dent = dent;
    state->tip.held_dent = u;
}

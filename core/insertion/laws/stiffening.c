#include "insertion/laws/stiffening.h"

#include "insertion/laws/along_track.h"
#include "insertion/model/local_compliance.h"
#include "insertion/state/strata.h"

static const double AGREEMENT = 1e-6; /* m: the passes end when the error in the linearised displacements is below this. Chosen: a thousandth of a needle's
                                         diameter */

/* ---- laws ----------------------------------------------------------------------------------------------------------------- */

/* Returns by how much (m) stiffening changes a shaft's displacement under this traction, in tissue of this softness (m^2/N, as in stiffened_shaft). */
static double shift_under(const insertion_model *model, double stiffening, double softness, double traction) {
    stiffening_law law = stiffening_of_shaft(stiffening, model->needle->radius, 1.0 / softness, INFINITY);
    return stiffening_at(&law, traction).shift;
}

double stiffening_lead(const insertion_model *model, stiffened_shaft before, stiffened_shaft now, double traction) {
    if (before.stiffening == 0.0 && now.stiffening == 0.0) return 0.0;
    if (before.softness == 0.0 || (before.stiffening == now.stiffening && before.softness == now.softness)) return 0.0;
    return shift_under(model, now.stiffening, now.softness, traction) - shift_under(model, before.stiffening, before.softness, traction);
}

void stiffening_prepare(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, stiffening_step *stiffening) {
    const insertion_model *model = tick->model;
    double radius = model->needle->radius;
    stiffening->any = model->stiffens && points->count > points->guided;
    stiffening->end = (linear_shift){0};
    if (!stiffening->any) return;
    for (int i = points->guided; i < points->count; i++) {
        const contact_point *p = &points->list[i];
        stiffening->along[i] = stiffening_of_shaft(p->shaft.stiffening, radius, p->shaft.axial, tissue->axial[i + (p->kind == POINT_TIP)]);
    }
    if (!points->tip) return;
    const needle_tip *tip = &state->tip;
    int t = points->count - 1;
    local_disc disc = local_disc_at_tip(model, tip->place.tet, tip->place.nominal, tip->place.depth - tip_entry_depth(state), tip->filtered_push);
    stiffening->face = stiffening_of_tip(disc.stiffening, radius, disc.compliance, disc.softness, disc.angle, tissue->axial[t]);
}

double stiffening_slope(const stiffening_step *stiffening, int i, double force) {
    return stiffening->any ? stiffening_at(&stiffening->along[i], force).slope : 0.0;
}

/* ---- forces that the laws depend on ------------------------------------------------------------------------------------------ */

/* Returns the force (N) along the track on the end face, including the damper's, which acts on the same tissue. */
static double force_of_face(const insertion_state *state, const contact_points *points, const tissue_step *tissue, const damper_step *damper) {
    double damping = damper->relaxed < 1.0 ? v3_dot(state->tip.dent.damping, state->tip.place.direction) : 0.0;
    return force_on_face(state, points, tissue) + damping;
}

/* Returns the force (N) along the shaft that is equivalent to the memory of creeping tissue. */
static double remembered_along(const tick_input *tick, const creep_step *creep, int i) {
    return tick->model->creep.count > 0 ? creep->remembered[i].along : 0.0;
}

static double remembered_of_face(const tick_input *tick, const creep_step *creep) { return tick->model->creep.count > 0 ? creep->face : 0.0; }

/* Evaluates the law for the force that would strain elastic tissue just as much. In creeping tissue, that is `yield` times the sum of force and memory. */
static stiffening_shift evaluate(const creep_step *creep, const stiffening_law *law, double force, double remembered) {
    double yield = creep->yield;
    stiffening_shift at = stiffening_at(law, yield * (force + remembered));
    at.slope *= yield;
    return at;
}

/* ---- passes --------------------------------------------------------------------------------------------------------------- */

/* Returns the force about which to linearise after a pass that found `force`. The law's tangent is flatter at smaller forces, so Newton's method approaches a
   growing force from below but overshoots a falling one. For a falling force, this returns the force at which the law gives the displacement found in the
   pass. */
static double force_of_last_pass(const creep_step *creep, const stiffening_law *law, double force, double remembered, const linear_shift *linear) {
    double yield = creep->yield, before = linear->force + remembered;
    if (fabs(force + remembered) >= fabs(before) && (force + remembered) * before >= 0.0) return force;
    return stiffening_force(law, yield * law->linear * (force + remembered) + linear->offset + linear->slope * force) / yield - remembered;
}

/* Linearises the law. `offset` is the displacement at zero force. */
static void linearise(const creep_step *creep, const stiffening_law *law, bool first, double force, double remembered, linear_shift *linear) {
    if (!first && law->field != NOT_STIFFENING) force = force_of_last_pass(creep, law, force, remembered, linear);
    stiffening_shift at = evaluate(creep, law, force, remembered);
    *linear = (linear_shift){.force = force, .slope = at.slope, .offset = at.shift - at.slope * force};
}

void stiffening_linearise(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                          stiffening_step *stiffening, const damper_step *damper, bool first) {
    if (!stiffening->any) return;
    for (int i = points->guided; i < points->count; i++) {
        double force = force_on_shaft(state, points, tissue, i);
        linearise(creep, &stiffening->along[i], first, force, remembered_along(tick, creep, i), &stiffening->shaft[i]);
    }
    if (points->tip) linearise(creep, &stiffening->face, first, force_of_face(state, points, tissue, damper), remembered_of_face(tick, creep), &stiffening->end);
}

void stiffening_add_compliance(const insertion_state *state, const contact_points *points, const tissue_step *tissue, const stiffening_step *stiffening,
                               contact_problem *problem) {
    if (!stiffening->any) return;
    for (int i = points->guided; i < problem->count; i++) {
        const track_shares at = along_track(state, points, tissue, i);
        for (int a = 0; a < at.count; a++)
            for (int b = 0; b <= a; b++) {
                double slope = stiffening->shaft[i].slope * at.on_shaft[a] * at.on_shaft[b] + stiffening->end.slope * at.on_face[a] * at.on_face[b];
                problem->compliance[at.row[b]][at.row[a]] += slope * at.along[a] * at.along[b];
            }
    }
}

void stiffening_shift_gaps(const insertion_state *state, const contact_points *points, const tissue_step *tissue, const stiffening_step *stiffening,
                           contact_problem *problem) {
    if (!stiffening->any) return;
    for (int i = points->guided; i < problem->count; i++) {
        const track_shares at = along_track(state, points, tissue, i);
        for (int a = 0; a < at.count; a++) problem->gap[at.row[a]] -= (stiffening->shaft[i].offset * at.on_shaft[a] + stiffening->end.offset * at.on_face[a]) * at.along[a];
    }
}

/* True if the linearised law is accurate enough. The laws' second derivatives are at most unit scale^2; with this bound, most evaluations can be skipped. */
static bool agrees(const creep_step *creep, const stiffening_law *law, double force, double remembered, const linear_shift *linear) {
    double change = creep->yield * law->scale * (force - linear->force);
    if (law->field == NOT_STIFFENING || 0.5 * law->unit * change * change <= AGREEMENT) return true;
    return fabs(evaluate(creep, law, force, remembered).shift - linear->offset - linear->slope * force) <= AGREEMENT;
}

bool stiffening_agrees(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, const creep_step *creep,
                       const stiffening_step *stiffening, const damper_step *damper) {
    if (!stiffening->any) return true;
    for (int i = points->guided; i < points->count; i++)
        if (!agrees(creep, &stiffening->along[i], force_on_shaft(state, points, tissue, i), remembered_along(tick, creep, i), &stiffening->shaft[i])) return false;
    return !points->tip || agrees(creep, &stiffening->face, force_of_face(state, points, tissue, damper), remembered_of_face(tick, creep), &stiffening->end);
}

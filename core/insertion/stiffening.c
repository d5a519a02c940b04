#include "insertion/stiffening.h"

#include "insertion/along_track.h"
#include "insertion/local_compliance.h"
#include "insertion/strata.h"

static const double AGREEMENT = 1e-6; /* m: the passes end when the error of the linearised displacements is below this. Chosen: a thousandth of a needle's
                                         diameter */

/* ---- laws ----------------------------------------------------------------------------------------------------------------- */

/* What stiffening changes of the displacement of a shaft in tissue of this softness (m^2/N per logarithm) under this traction, m. */
static double shift_under(const insertion_model *model, double stiffening, double softness, double traction) {
    stiffening_law law = stiffening_of_shaft(stiffening, model->needle->radius, 1.0 / softness, INFINITY);
    return stiffening_at(&law, traction).shift;
}

double stiffening_lead(const insertion_model *model, stiffened_shaft before, stiffened_shaft now, double traction) {
    if (before.stiffening == 0.0 && now.stiffening == 0.0) return 0.0;
    if (before.softness == 0.0 || (before.stiffening == now.stiffening && before.softness == now.softness)) return 0.0;
    return shift_under(model, now.stiffening, now.softness, traction) - shift_under(model, before.stiffening, before.softness, traction);
}

void stiffening_prepare(const tick_context *tick) {
    const insertion_model *model = tick->model;
    const insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    stiffening_step *s = &w->stiffening;
    double radius = model->needle->radius;
    s->any = model->stiffens && w->point_count > w->guided;
    s->end = (linear_shift){0};
    if (!s->any) return;
    for (int i = w->guided; i < w->point_count; i++) {
        const contact_point *p = &w->points[i];
        s->along[i] = stiffening_of_shaft(p->shaft.stiffening, radius, p->shaft.axial, w->axial[i + (p->kind == POINT_TIP)]);
    }
    if (!w->tip) return;
    const needle_tip *tip = &state->tip;
    int t = w->point_count - 1;
    local_disc disc = local_disc_at_tip(model, tip->tet, tip->nominal, tip->depth - tip_entry_depth(state), tip->pressing);
    s->face = stiffening_of_tip(disc.stiffening, radius, disc.compliance, disc.softness, disc.angle, w->axial[t]);
}

double stiffening_slope(const tick_context *tick, int i, double force) {
    const stiffening_step *s = &tick->scratch->stiffening;
    return s->any ? stiffening_at(&s->along[i], force).slope : 0.0;
}

/* ---- forces that the laws depend on ------------------------------------------------------------------------------------------ */

/* On the end face along the track, and of the damper, which pushes on the same tissue, N. */
static double force_of_face(const tick_context *tick) {
    double damping = tick->scratch->relaxed < 1.0 ? v3_dot(tick->state->tip.damping, tick->state->tip.direction) : 0.0;
    return force_on_face(tick) + damping;
}

/* What creeping tissue remembers of it, N. */
static double remembered_along(const tick_context *tick, int i) {
    return tick->model->creep.count > 0 ? tick->scratch->creep.remembered[i].along : 0.0;
}

static double remembered_of_face(const tick_context *tick) { return tick->model->creep.count > 0 ? tick->scratch->creep.face : 0.0; }

/* The law holds for the force that would strain elastic tissue as much: in tissue that creeps, `yield` times the force and what is remembered. */
static stiffening_shift evaluate(const tick_context *tick, const stiffening_law *law, double force, double remembered) {
    double yield = tick->scratch->creep.yield;
    stiffening_shift at = stiffening_at(law, yield * (force + remembered));
    at.slope *= yield;
    return at;
}

/* ---- passes --------------------------------------------------------------------------------------------------------------- */

/* About which force to linearise after a pass that found `force`. The tangent is flatter than the law at smaller forces: Newton's method comes from below
   to a force that grows, but overshoots one that falls. That is linearised about the force under which the law displaces the tissue as far as the pass did. */
static double force_of_last_pass(const tick_context *tick, const stiffening_law *law, double force, double remembered, const linear_shift *linear) {
    double yield = tick->scratch->creep.yield, before = linear->force + remembered;
    if (fabs(force + remembered) >= fabs(before) && (force + remembered) * before >= 0.0) return force;
    return stiffening_force(law, yield * law->linear * (force + remembered) + linear->offset + linear->slope * force) / yield - remembered;
}

/* `offset` is the displacement that is left at no force. */
static void linearise(const tick_context *tick, const stiffening_law *law, bool first, double force, double remembered, linear_shift *linear) {
    if (!first && law->field != NOT_STIFFENING) force = force_of_last_pass(tick, law, force, remembered, linear);
    stiffening_shift at = evaluate(tick, law, force, remembered);
    *linear = (linear_shift){.force = force, .slope = at.slope, .offset = at.shift - at.slope * force};
}

void stiffening_linearise(const tick_context *tick, bool first) {
    insertion_workspace *w = tick->scratch;
    stiffening_step *s = &w->stiffening;
    if (!s->any) return;
    for (int i = w->guided; i < w->point_count; i++) linearise(tick, &s->along[i], first, force_on_shaft(tick, i), remembered_along(tick, i), &s->shaft[i]);
    if (w->tip) linearise(tick, &s->face, first, force_of_face(tick), remembered_of_face(tick), &s->end);
}

void stiffening_add_compliance(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    contact_problem *p = &tick->scratch->problem;
    const stiffening_step *s = &w->stiffening;
    if (!s->any) return;
    for (int i = w->guided; i < p->count; i++) {
        const track_shares at = along_track(tick, i);
        for (int a = 0; a < at.count; a++)
            for (int b = 0; b <= a; b++)
                p->compliance[at.row[b]][at.row[a]] += (s->shaft[i].slope * at.on_shaft[a] * at.on_shaft[b] + s->end.slope * at.on_face[a] * at.on_face[b]) * at.along[a] * at.along[b];
    }
}

void stiffening_shift_gaps(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    contact_problem *p = &tick->scratch->problem;
    const stiffening_step *s = &w->stiffening;
    if (!s->any) return;
    for (int i = w->guided; i < p->count; i++) {
        const track_shares at = along_track(tick, i);
        for (int a = 0; a < at.count; a++) p->gap[at.row[a]] -= (s->shaft[i].offset * at.on_shaft[a] + s->end.offset * at.on_face[a]) * at.along[a];
    }
}

/* The laws' second derivatives are at most unit scale^2, which saves evaluating most of them. */
static bool agrees(const tick_context *tick, const stiffening_law *law, double force, double remembered, const linear_shift *linear) {
    double change = tick->scratch->creep.yield * law->scale * (force - linear->force);
    if (law->field == NOT_STIFFENING || 0.5 * law->unit * change * change <= AGREEMENT) return true;
    return fabs(evaluate(tick, law, force, remembered).shift - linear->offset - linear->slope * force) <= AGREEMENT;
}

bool stiffening_agrees(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    const stiffening_step *s = &w->stiffening;
    if (!s->any) return true;
    for (int i = w->guided; i < w->point_count; i++)
        if (!agrees(tick, &s->along[i], force_on_shaft(tick, i), remembered_along(tick, i), &s->shaft[i])) return false;
    return !w->tip || agrees(tick, &s->face, force_of_face(tick), remembered_of_face(tick), &s->end);
}

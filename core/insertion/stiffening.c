#include "insertion/stiffening.h"

#include "insertion/local_compliance.h"
#include "insertion/strata.h"

static const double AGREEMENT = 1e-6; /* m: the passes end when the error of the linearised displacements is below this */

/* ---- laws ----------------------------------------------------------------------------------------------------------------- */

/* What stiffening changes of the displacement of a shaft in tissue of this softness (m^2/N per logarithm) under this traction, m. */
static double shift_under(const insertion_model *model, double stiffening, double softness, double traction) {
    stiffening_law law = stiffening_of_shaft(stiffening, model->needle->radius, 1.0 / softness, INFINITY);
    return stiffening_at(&law, traction).shift;
}

double stiffening_lead(const insertion_model *model, stiffened_shaft before, stiffened_shaft now, double traction) {
    const double same = 1e-12;
    if (before.stiffening == 0.0 && now.stiffening == 0.0) return 0.0;
    if (before.softness == 0.0 || (before.stiffening == now.stiffening && fabs(now.softness / before.softness - 1.0) < same)) return 0.0;
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
        s->along[i] = stiffening_of_shaft(p->shaft.stiffening, radius, p->shaft.axial, p->kind == POINT_TIP ? w->held_axial : w->axial[i]);
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

/* Along the track, of the needle on the tissue around the shaft, N. */
static double force_along(const tick_context *tick, int i) {
    const contact_point *p = &tick->scratch->points[i];
    vec3 force = *point_force(tick->state, p);
    if (p->kind == POINT_TIP) force = v3_axpy(-tick->state->tip.end_force, needle_along(&p->at), force);
    return v3_dot(point_track(tick->state, p), force);
}

/* Of the end face, and of the damper, which pushes on the same tissue, N. */
static double force_of_face(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    const needle_tip *tip = &tick->state->tip;
    double damping = w->relaxed < 1.0 ? v3_dot(tip->damping, needle_along(&w->points[w->point_count - 1].at)) : 0.0;
    return tip->end_force + damping;
}

/* The track's direction in the needle's frame. */
static vec3 along_in_frame(const tick_context *tick, int i) {
    const contact_point *p = &tick->scratch->points[i];
    return m3_apply_transposed(&p->at.frame, point_track(tick->state, p));
}

/* What creeping tissue remembers of it, N. */
static double remembered_along(const tick_context *tick, int i) {
    return tick->model->creep.count > 0 ? v3_dot(along_in_frame(tick, i), creep_force(tick->scratch, i)) : 0.0;
}

static double remembered_of_face(const tick_context *tick) { return tick->model->creep.count > 0 ? tick->scratch->creep.face : 0.0; }

/* The law holds for the force that would strain elastic tissue as much: in tissue that creeps, `yield` times the force and what is remembered. */
static stiffening_shift evaluate(const tick_context *tick, const stiffening_law *law, double force, double remembered) {
    double yield = tick->scratch->creep.yield;
    stiffening_shift at = stiffening_at(law, yield * (force + remembered));
    at.slope *= yield;
    return at;
}

/* A force along the track at point i, in the unknowns of the contact problem: shares along[3] of it at row[3]. */
typedef struct {
    int row[3];
    double along[3];
} track_unknowns;

static track_unknowns unknowns_of(const tick_context *tick, int i) {
    const insertion_workspace *w = tick->scratch;
    int count = w->problem.count;
    bool tip = w->points[i].kind == POINT_TIP;
    vec3 along = along_in_frame(tick, i);
    return (track_unknowns){{unknown(count, i, 0), unknown(count, i, 1), unknown(count, i, 2) + tip}, {along.x, along.y, along.z}};
}

/* ---- passes --------------------------------------------------------------------------------------------------------------- */

/* Linearises about `force`; `offset` is the displacement that is left at no force. */
static void linearise(const tick_context *tick, const stiffening_law *law, double force, double remembered, linear_shift *linear) {
    stiffening_shift at = evaluate(tick, law, force, remembered);
    *linear = (linear_shift){.force = force, .slope = at.slope, .offset = at.shift - at.slope * force};
}

void stiffening_linearise(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    stiffening_step *s = &w->stiffening;
    if (!s->any) return;
    for (int i = w->guided; i < w->point_count; i++) linearise(tick, &s->along[i], force_along(tick, i), remembered_along(tick, i), &s->shaft[i]);
    if (w->tip) linearise(tick, &s->face, force_of_face(tick), remembered_of_face(tick), &s->end);
}

void stiffening_add_compliance(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    contact_problem *p = &tick->scratch->problem;
    const stiffening_step *s = &w->stiffening;
    if (!s->any) return;
    for (int i = w->guided; i < p->count; i++) {
        track_unknowns at = unknowns_of(tick, i);
        for (int a = 0; a < 3; a++)
            for (int b = 0; b <= a; b++) p->compliance[at.row[b]][at.row[a]] += s->shaft[i].slope * at.along[a] * at.along[b];
    }
    int face = unknown(p->count, p->count - 1, 2);
    if (w->tip) p->compliance[face][face] += s->end.slope;
}

void stiffening_shift_gaps(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    contact_problem *p = &tick->scratch->problem;
    const stiffening_step *s = &w->stiffening;
    if (!s->any) return;
    for (int i = w->guided; i < p->count; i++) {
        track_unknowns at = unknowns_of(tick, i);
        for (int a = 0; a < 3; a++) p->gap[at.row[a]] -= s->shaft[i].offset * at.along[a];
    }
    if (w->tip) p->gap[unknown(p->count, p->count - 1, 2)] -= s->end.offset;
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
        if (!agrees(tick, &s->along[i], force_along(tick, i), remembered_along(tick, i), &s->shaft[i])) return false;
    return !w->tip || agrees(tick, &s->face, force_of_face(tick), remembered_of_face(tick), &s->end);
}

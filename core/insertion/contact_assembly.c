#include "insertion/contact_assembly.h"

#include <string.h>

#include "insertion/between_points.h"
#include "insertion/creep.h"
#include "insertion/guides.h"
#include "insertion/local_compliance.h"
#include "insertion/obstacle.h"
#include "insertion/old_tracks.h"
#include "insertion/roll.h"
#include "insertion/stiffening.h"
#include "insertion/strata.h"

static const double TIP_FADE = 3e-3;     /* m of depth over which the tip's lateral hold grows to its full value, */
static const double TIP_BITE = 0.05;     /* N, or the force along the needle at which it is full on the surface */
static const double LEAST_STIFFNESS = 1e-3; /* N/m, for shaft that is hardly in tissue, having come out of a gap */

/* ---- points and forces --------------------------------------------------------------------------------------------- */

void list_points(const tick_context *tick) {
    const insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    int contacts = 0;
    double border = 0.0;
    guides_list(tick);
    for (; contact_is_active(state, contacts); contacts++) {
        contact_point *p = &w->points[w->guided + contacts];
        p->kind = POINT_TISSUE;
        p->handle = state->refined.order[contacts];
        p->share = shaft_next_share(state, contacts, w->tip, &border);
        p->shaft = shaft_resistance_of(tick->model, state, p->share);
    }
    w->point_count = w->guided + contacts + w->tip;
    if (!w->tip) return;
    contact_point *p = &w->points[w->guided + contacts];
    p->kind = POINT_TIP;
    p->handle = NO_HANDLE;
    p->arc = tick->model->needle->given.length;
    p->share = shaft_next_share(state, contacts, true, &border);
    p->shaft = shaft_resistance_of(tick->model, state, p->share);
}

void locate_points(const tick_context *tick) {
    const insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    double arcs[MAX_POINTS];
    needle_point *at[MAX_POINTS];
    for (int i = 0; i < w->point_count; i++) {
        arcs[i] = w->points[i].arc;
        at[i] = &w->points[i].at;
    }
    needle_locate(tick->model->needle, &state->needle, w->point_count, arcs, at);
    guides_locate(tick);
    for (int i = w->guided; i < w->point_count; i++) {
        contact_point *p = &w->points[i];
        p->target = p->kind == POINT_TIP ? v3_add(tip_place(&state->tip), w->free_at_tip)
                                         : v3_add(state->contacts[p->handle].track, creep_free(tick, p->handle));
        if (tick->model->creep.count > 0) p->target = v3_add(p->target, w->creep.moved[i]);
    }
}

void load_needle(const tick_context *tick) {
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    memset(w->load, 0, (size_t)(tick->model->needle->given.segments + 1) * sizeof *w->load);
    for (int i = 0; i < w->point_count; i++) {
        vec3 force = *point_force(state, &w->points[i]);
        const needle_point *p = &w->points[i].at;
        for (int k = 0; k < 3; k++) w->load[p->first + k] = v3_axpy(-p->weights[k], force, w->load[p->first + k]);
    }
}

/* ---- compliance of the tissue -------------------------------------------------------------------------------------- */

void find_tip_rows(const tick_context *tick, const int handles[4]) {
    insertion_workspace *w = tick->scratch;
    const double *weights = tick->state->tip.known_weights;
    int tip = w->point_count - 1;
    double yielding[4];
    row_matrix own = {{{0}}};
    for (int c = 0; c < 4; c++) yielding[c] = w->creep.yield * weights[c];
    for (int c = 0; c < 4; c++) own = rm_add(own, rm_scaled(weights[c], compliance_rows_to_point(tick->snapshot, handles, yielding, handles[c])));
    for (int i = 0; i < w->guided; i++) w->tip_row[i] = (mat3){{{0}}};
    for (int i = w->guided; i < tip; i++) w->tip_row[i] = compliance_to_point(tick->snapshot, handles, yielding, w->points[i].handle);
    w->tip_row[tip] = matrix_of(own);
    w->free_at_tip = creep_free_at(tick, handles, weights);
}

/* Near the surface tissue holds the needle sideways the less, the less of it is in and the less it presses: from 0 to 1. It is the same for
   the tip and the contacts behind it, so that nothing jumps when one takes the place of the other. */
static double hold_near_surface(const tick_context *tick) {
    const needle_tip *tip = &tick->state->tip;
    return tick->scratch->tip ? fmin(1.0, (tip->depth - tip_entry_depth(tick->state)) / TIP_FADE + tip->pressing / TIP_BITE) : 1.0;
}

/* Point i, of this local compliance (m/N), is held by that part only. */
static void loosen(insertion_workspace *w, int i, double hold, double compliance) {
    w->loose[i] = hold < 1.0 ? compliance * (1.0 / fmax(hold, 1e-6) - 1.0) : 0.0;
    w->tightening[i] = hold < 1.0 ? compliance / (fmax(hold * hold, 1e-12) * TIP_FADE) : 0.0;
}

/* How far the middle of a point's share is behind the tip; INFINITY without a tip in the tissue. */
static double behind_tip(const tick_context *tick, int i) {
    shaft_share share = tick->scratch->points[i].share;
    return tick->scratch->tip ? tick->state->tip.depth - 0.5 * (share.from + share.to) : INFINITY;
}

void find_local_compliance(const tick_context *tick) {
    const insertion_model *model = tick->model;
    const insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    int t = w->point_count - w->tip;
    double hold = hold_near_surface(tick);
    for (int i = w->guided; i < t; i++) {
        const shaft_contact *contact = &state->contacts[w->points[i].handle];
        const shaft_resistance *shaft = &w->points[i].shaft;
        bool here = contact->depth >= tip_entry_depth(state); /* not in a previous body */
        plane_tensor lateral = local_logarithm_behind_tip(contact->log_lateral, &contact->end, here ? behind_tip(tick, i) : INFINITY);
        loosen(w, i, here ? hold : 1.0, plane_mean(lateral) / shaft->lateral);
        w->lateral[i] = plane_principal(plane_scaled(1.0 / shaft->lateral, lateral), contact->direction);
        w->axial[i] = contact->log_axial / shaft->axial;
    }
    if (!w->tip) return;
    const needle_tip *tip = &state->tip;
    double radius = model->needle->radius, depth = tip->depth - tip_entry_depth(state);
    const shaft_resistance *shaft = &w->points[t].shaft;
    double axial = local_logarithm(model, &tip->resolved).axial;
    plane_tensor endless = local_logarithm_across(model, &tip->resolved, tip->direction);
    plane_tensor lateral = local_logarithm_behind_tip(endless, &tip->resolved.end, behind_tip(tick, t));
    lateral_axial line = local_line_compliance_at(model, tip->tet, tip->nominal);
    double stiffness = shaft->lateral + radius / line.lateral; /* one radius more */
    w->lateral[t] = plane_principal(plane_scaled(1.0 / stiffness, lateral), tip->direction);
    w->held_axial = axial / (shaft->axial + radius / line.axial);
    loosen(w, t, hold, plane_mean(lateral) / stiffness);
    w->axial[t] = local_at_tip(model, tip->tet, tip->nominal, depth, tip->pressing, tip->resolved.point);
    w->axial[t + 1] = axial / fmax(shaft->axial, LEAST_STIFFNESS);
}

/* How much farther ahead of the tissue the shaft is because the tissue along its share has become softer (stiffer: less far), under
   the traction that it bears, m. Shaft that enters another region has not sheared the tissue there yet; without this, it would have to
   slide for it, in the tick in which the tip enters that region. */
static double lead_gained(const insertion_model *model, const contact_point *p, double logarithm, double traction, double *softness, double *stiffening) {
    stiffened_shaft before = {*softness, *stiffening};
    stiffened_shaft now = {(p->share.to - p->share.from) / larger_of(p->shaft.axial, LEAST_STIFFNESS), p->shaft.stiffening};
    *softness = now.softness;
    *stiffening = now.stiffening;
    if (before.softness == 0.0) return 0.0;
    return logarithm * (now.softness - before.softness) * traction + stiffening_lead(model, before, now, traction);
}

void keep_shear(const tick_context *tick) {
    const insertion_model *model = tick->model;
    insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    int t = w->point_count - w->tip;
    for (int i = w->guided; i < t; i++) {
        contact_point *p = &w->points[i];
        shaft_contact *contact = &state->contacts[p->handle];
        double traction = contact->traction + creep_traction_of(tick, i);
        p->arc = contact->arc += lead_gained(model, p, contact->log_axial, traction, &contact->softness, &contact->stiffening);
    }
    if (!w->tip) return;
    needle_tip *tip = &state->tip;
    double logarithm = local_logarithm(model, &tip->resolved).axial;
    double traction = tip->shaft_traction + creep_traction_of(tick, t);
    tip->stretch += lead_gained(model, &w->points[t], logarithm, traction, &tip->shaft_softness, &tip->shaft_stiffening);
}

/* ---- bounds of the forces along the needle ------------------------------------------------------------------------- */

static void bound_friction(const tick_context *tick, int i, const shaft_resistance *shaft, double slid, double slip, const roll_friction *roll, friction_state last) {
    contact_problem *p = &tick->scratch->problem;
    double radius = tick->model->needle->radius;
    double dry = shaft_friction_limit(tick->model, shaft, slid + roll_way(slip, roll, radius));
    shared_bound left = roll_left_to_sliding(dry, slip, roll, radius);
    p->upper[i] = left.bound;
    p->lower[i] = -left.bound;
    p->viscosity[i][0] = p->viscosity[i][1] = shaft->viscous / tick->dt + left.viscosity;
    p->state[i] = last;
}

/* Near the surface the tissue holds the needle the harder the deeper it is in, which stores elastic energy in tissue and needle. The hand
   has to do that work as the tip goes on: N along the needle. Without it, a tip without resistance, as in an old track, would go in and out in
   turns: a needle that is held harder bends more, and its end moves back. */
static double work_of_hold(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    double sum = 0.0;
    for (int i = w->guided; i < w->point_count; i++) {
        if (w->tightening[i] == 0.0) continue;
        vec3 needle = needle_along(&w->points[i].at), force = *point_force(tick->state, &w->points[i]);
        vec3 across = v3_axpy(-v3_dot(force, needle), needle, force);
        sum += 0.5 * v3_dot(across, across) * w->tightening[i];
    }
    return sum;
}

/* The tip bears two forces along the needle: what it cuts, or is stopped by, and friction of the shaft next to it. */
static void bound_tip(const tick_context *tick) {
    const insertion_model *model = tick->model;
    insertion_workspace *w = tick->scratch;
    contact_problem *p = &w->problem;
    const needle_tip *tip = &tick->state->tip;
    int t = p->count - 1;
    bool stops = w->tip_law == TIP_STOPS, blocked = stops || tip->blocked_by != NOT_BLOCKED;
    double resistance = stops ? w->stop_resistance : tip_resistance(model, tip);
    double whole = model->materials[model->mesh->region[tip->tet]].cutting_viscosity / tick->dt, viscosity = (1.0 - tip->open) * whole;
    p->upper[t] = blocked ? resistance : old_tracks_bound(tip, needle_along(&w->points[t].at), resistance) + work_of_hold(tick);
    if (w->tip_law == TIP_SPRINGS) { /* up to slip_offset as always, beyond it as in tissue that is not open */
        p->upper[t] += viscosity * w->slip_offset;
        viscosity = whole;
    }
    p->lower[t] = 0.0;
    p->viscosity[t][0] = 0.0;
    p->viscosity[t][1] = blocked ? 0.0 : viscosity;
    p->state[t] = tip->friction;
    bound_friction(tick, t + 1, &w->points[t].shaft, tip->shaft_slid, tip->shaft_slip, &tip->roll, tip->shaft_friction);
}

void bound_contacts(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    for (int i = 0; i < w->guided; i++) guides_bound(tick, i);
    for (int i = w->guided; i < w->point_count - w->tip; i++) {
        const shaft_contact *contact = &tick->state->contacts[w->points[i].handle];
        bound_friction(tick, i, &w->points[i].shaft, contact->slid, contact->slip, &contact->roll, contact->friction);
    }
    if (w->tip) bound_tip(tick);
}

/* ---- the contact problem ------------------------------------------------------------------------------------------- */

/* The shaft next to the tip acts at the same point along the same line: so far a copy of the tip's last row and column. */
static void repeat_tip(contact_problem *p) {
    int tip = unknown(p->count, p->count - 1, 2), shaft = tip + 1;
    for (int i = 0; i <= tip; i++) p->compliance[i][shaft] = p->compliance[i][tip];
    p->compliance[shaft][shaft] = p->compliance[tip][tip];
}

/* Local compliance belongs to the tissue: its principal directions are those of the track, not of the needle. If they turned with a
   needle that bends there, the passes would diverge near buckling, because the tangent lacks that term. The shaft next to the tip
   carries what lies sideways with it as a contact would, so that nothing jumps when one takes the place of the other. What the end
   face presses in yields along the needle, under its own force alone. */
static void add_local_compliance(contact_problem *p, const insertion_workspace *w, int point, vec3 track, bool tip) {
    int first = unknown(p->count, point, 0), face = unknown(p->count, point, 2), axial = face + tip;
    const int row[] = {first, first + 1, axial};
    vec3 share = m3_apply_transposed(&w->points[point].at.frame, track); /* of each force, along the track */
    vec3 aside = m3_apply_transposed(&w->points[point].at.frame, w->lateral[point].easy);
    const double along[] = {share.x, share.y, share.z}, easy[] = {aside.x, aside.y, aside.z}, least = w->lateral[point].least, more = w->lateral[point].more;
    double shaft = w->axial[point + tip], held = tip ? w->held_axial : shaft; /* held <= shaft: positive semidefinite */
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++)
            p->compliance[row[j]][row[i]] += least * ((i == j) - along[i] * along[j]) + more * easy[i] * easy[j] + (j == 2 ? shaft : held) * along[i] * along[j];
    if (tip) p->compliance[face][face] += w->axial[point];
}

void assemble_compliance(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    const insertion_state *state = tick->state;
    contact_problem *p = &w->problem;
    assemble_between_points(tick);
    if (w->tip) repeat_tip(p);
    int t = w->point_count - w->tip;
    for (int i = 0; i < w->guided; i++) guides_add_compliance(tick, i);
    for (int i = w->guided; i < t; i++) add_local_compliance(p, w, i, state->contacts[w->points[i].handle].direction, false);
    if (w->tip) add_local_compliance(p, w, t, state->tip.direction, true);
    for (int i = w->guided; i < p->count; i++)
        for (int a = 0; a < 2; a++) p->compliance[2 * i + a][2 * i + a] += w->loose[i];
    stiffening_add_compliance(tick);
}

void assemble_gaps(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    contact_problem *p = &w->problem;
    for (int i = 0; i < p->count; i++) {
        const needle_point *at = &w->points[i].at;
        vec3 gap = v3_sub(v3_sub(at->position, tick->state->base_shift), w->points[i].target);
        for (int k = 0; k < 3; k++) gap = v3_axpy(at->weights[k], w->tangent.drift[at->first + k], gap);
        gap = m3_apply_transposed(&at->frame, gap);
        p->gap[unknown(p->count, i, 0)] = gap.x;
        p->gap[unknown(p->count, i, 1)] = gap.y;
        p->gap[unknown(p->count, i, 2)] = gap.z;
    }
    for (int i = 0; i < w->guided; i++) guides_close_gap(tick, i);
    int shaft = unknown(p->count, p->count, 2);
    if (w->tip) {
        p->gap[shaft] = p->gap[shaft - 1] + tick->state->tip.stretch;
        p->gap[shaft - 1] -= w->slip_offset;
    }
    creep_shift_gaps(tick);
    stiffening_shift_gaps(tick);
}

#include "insertion/contact_assembly.h"

#include <string.h>

#include "insertion/along_track.h"
#include "insertion/between_points.h"
#include "insertion/creep.h"
#include "insertion/guides.h"
#include "insertion/local_compliance.h"
#include "insertion/resistance_ahead.h"
#include "insertion/roll.h"
#include "insertion/stiffening.h"
#include "insertion/strata.h"
#include "remesh/snapshot_kernels.h"

static const double TIP_FADE = 3e-3; /* m: depth over which the tissue's sideways hold on tip and shaft grows to its full value. Chosen */
static const double LEAST_STIFFNESS = 1e-3; /* N/m: that a share of the shaft has per logarithm at least, for shaft that is hardly in tissue, having come out of
                                               a gap. Rounding: that of 0.5 um of shaft at 1 kPa */
static const double LEAST_HOLD = 1e-6; /* fraction: of the sideways hold that is left at least, so that its compliance is finite. Rounding */

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
    p->share = shaft_next_share(state, contacts, true, &border);
    p->shaft = shaft_resistance_of(tick->model, state, p->share);
}

/* A contact bears its force where the shaft is that the tissue holds, but not beyond the needle's end. So does the shaft next to the tip, which is behind the
   needle's end by how far the end face has dented the tissue; the end face is at the end. The resultant of their sideways forces is between them. */
static void place_on_shaft(const tick_context *tick, contact_point *p) {
    const insertion_state *state = tick->state;
    double length = tick->model->needle->given.length;
    bool tip = p->kind == POINT_TIP;
    const shaft_hold *shaft = tip ? &state->tip.shaft : &state->contacts[p->handle].shaft;
    double depth = tip ? state->tip.depth : state->contacts[p->handle].depth;
    p->arc = shaft_arc(shaft, depth, length);
    if (tip) {
        p->to_end = tick->scratch->sideways_on_shaft * (length - p->arc);
        p->arc = length - p->to_end;
    }
    p->lead = shaft->origin + depth - p->arc;
}

void locate_points(const tick_context *tick) {
    const insertion_state *state = tick->state;
    insertion_workspace *w = tick->scratch;
    double arcs[MAX_POINTS];
    needle_point *at[MAX_POINTS];
    for (int i = 0; i < w->point_count; i++) {
        if (i >= w->guided) place_on_shaft(tick, &w->points[i]);
        arcs[i] = w->points[i].arc;
        at[i] = &w->points[i].at;
    }
    needle_locate(tick->model->needle, &state->needle, w->point_count, arcs, at);
    guides_locate(tick);
    for (int i = w->guided; i < w->point_count; i++) {
        contact_point *p = &w->points[i];
        p->target = p->kind == POINT_TIP ? v3_add(tip_place(&state->tip), w->free_at_tip)
                                         : v3_add(state->contacts[p->handle].track, creep_free(tick, p->handle));
        if (p->kind == POINT_TIP) p->target = v3_axpy(state->tip.offset, state->tip.direction, p->target);
        p->target = v3_add(p->target, unresolved_mean(&tick->snapshot->unresolved, p->share.from, p->share.to));
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
    w->tip_resolved = handles[0] == NO_HANDLE ? 0.0 : tick->state->tip.resolved.point;
    if (handles[0] == NO_HANDLE) { /* the mesh is rigid there */
        memset(w->tip_row, 0, (size_t)w->point_count * sizeof *w->tip_row);
        w->free_at_tip = v3(0, 0, 0);
        return;
    }
    for (int c = 0; c < 4; c++) yielding[c] = w->creep.yield * weights[c];
    for (int i = 0; i < w->guided; i++) w->tip_row[i] = (mat3){{{0}}};
    for (int i = w->guided; i < tip; i++) w->tip_row[i] = compliance_to_point(tick->snapshot, handles, yielding, w->points[i].handle);
    w->tip_row[tip] = compliance_of_point(tick->snapshot, handles, yielding, weights);
    w->free_at_tip = creep_free_at(tick, handles, weights);
}

/* Near the surface tissue holds the needle sideways the less, the less of it is in and the less it presses: from 0 to 1. It is the same for
   the tip and the contacts behind it, so that nothing jumps when one takes the place of the other. */
static double hold_near_surface(const tick_context *tick) {
    const needle_tip *tip = &tick->state->tip;
    return tick->scratch->tip ? fmin(1.0, (tip->depth - tip_entry_depth(tick->state)) / TIP_FADE + tip->pressing / FULL_GRIP) : 1.0;
}

/* Point i, of this local compliance (m/N), is held by that part only. */
static void loosen(insertion_workspace *w, int i, double hold, double compliance) {
    double part = fmax(hold, LEAST_HOLD);
    w->loose[i] = hold < 1.0 ? compliance * (1.0 / part - 1.0) : 0.0;
    w->tightening[i] = hold < 1.0 ? compliance / (part * part * TIP_FADE) : 0.0;
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
        plane_tensor lateral = local_logarithm_behind_tip(contact->log_lateral, &contact->resolved.end, here ? behind_tip(tick, i) : INFINITY);
        loosen(w, i, here ? hold : 1.0, plane_mean(lateral) / shaft->lateral);
        w->lateral[i] = plane_principal(plane_scaled(1.0 / shaft->lateral, lateral), contact->direction);
        w->axial[i] = contact->log_axial / shaft->axial;
    }
    if (!w->tip) return;
    const needle_tip *tip = &state->tip;
    double depth = tip->depth - tip_entry_depth(state);
    const shaft_resistance *shaft = &w->points[t].shaft;
    double axial = local_logarithm(model, &tip->resolved).axial;
    plane_tensor endless = local_logarithm_across(model, &tip->resolved, tip->direction);
    plane_tensor lateral = local_logarithm_behind_tip(endless, &tip->resolved.end, behind_tip(tick, t));
    double face = local_at_tip(model, tip->tet, tip->nominal, depth, tip->pressing, w->tip_resolved);
    double both = plane_mean(lateral) + face * shaft->lateral; /* shaft and end face side by side */
    w->sideways_on_shaft = face * shaft->lateral / both;
    w->lateral[t] = plane_principal(plane_scaled(1.0 / fmax(shaft->lateral, LEAST_STIFFNESS), lateral), tip->direction);
    w->axial[t] = face;
    loosen(w, t, hold, plane_mean(lateral) * face / both);
    w->axial[t + 1] = axial / fmax(shaft->axial, LEAST_STIFFNESS);
}

/* How much farther ahead of the tissue the shaft is because the tissue along its share has become softer (stiffer: less far), under
   the traction that it bears, m. Shaft that enters another region has not sheared the tissue there yet; without this, it would have to
   slide for it, in the tick in which the tip enters that region. */
static double lead_gained(const insertion_model *model, const contact_point *p, double logarithm, double traction, shaft_hold *shaft) {
    stiffened_shaft before = {shaft->softness, shaft->stiffening};
    stiffened_shaft now = {(p->share.to - p->share.from) / larger_of(p->shaft.axial, LEAST_STIFFNESS), p->shaft.stiffening};
    shaft->softness = now.softness;
    shaft->stiffening = now.stiffening;
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
        double traction = contact->shaft.traction + creep_traction_of(tick, i);
        contact->shaft.origin += lead_gained(model, p, contact->log_axial, traction, &contact->shaft);
    }
    if (!w->tip) return;
    needle_tip *tip = &state->tip;
    double logarithm = local_logarithm(model, &tip->resolved).axial;
    double traction = tip->shaft.traction + creep_traction_of(tick, t);
    shift_tip_shaft(state, lead_gained(model, &w->points[t], logarithm, traction, &tip->shaft));
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
    insertion_workspace *w = tick->scratch;
    contact_problem *p = &w->problem;
    const needle_tip *tip = &tick->state->tip;
    int t = p->count - 1;
    resistance_ahead_climb(tick, work_of_hold(tick), &p->ahead);
    p->climber = t;
    p->lower[t] = p->ahead.back;
    p->upper[t] = p->ahead.level[0];
    p->viscosity[t][0] = 0.0;
    p->viscosity[t][1] = p->ahead.slope[0];
    p->state[t] = tip->friction;
    bound_friction(tick, t + 1, &w->points[t].shaft, tip->shaft.slid, tip->shaft.slip, &tip->shaft.roll, tip->shaft.friction);
}

void bound_contacts(const tick_context *tick) {
    const insertion_workspace *w = tick->scratch;
    for (int i = 0; i < w->guided; i++) guides_bound(tick, i);
    for (int i = w->guided; i < w->point_count - w->tip; i++) {
        const shaft_contact *contact = &tick->state->contacts[w->points[i].handle];
        bound_friction(tick, i, &w->points[i].shaft, contact->shaft.slid, contact->shaft.slip, &contact->shaft.roll, contact->shaft.friction);
    }
    tick->scratch->problem.ahead.count = 0;
    if (w->tip) bound_tip(tick);
}

/* ---- the contact problem ------------------------------------------------------------------------------------------- */

/* The shaft next to the tip acts at the same point along the same line: so far a copy of the tip's last row and column. */
static void repeat_tip(contact_problem *p) {
    int tip = unknown(p->count, p->count - 1, 2), shaft = tip + 1;
    for (int i = 0; i <= tip; i++) p->compliance[i][shaft] = p->compliance[i][tip];
    p->compliance[shaft][shaft] = p->compliance[tip][tip];
}

/* Local compliance of the tissue around a shaft belongs to the tissue: its principal directions are those of the track, not of the needle. If they turned with
   a needle that bends there, the passes would diverge near buckling, because the tangent lacks that term. The tip's end face yields the same in every
   direction. */
static void add_local_compliance(const tick_context *tick, int point) {
    const insertion_workspace *w = tick->scratch;
    contact_problem *p = &tick->scratch->problem;
    const track_shares at = along_track(tick, point);
    bool tip = w->points[point].kind == POINT_TIP;
    double face = tip ? w->axial[point] : 0.0, shaft = w->axial[point + tip], least = w->lateral[point].least, more = w->lateral[point].more;
    vec3 aside = m3_apply_transposed(&w->points[point].at.frame, w->lateral[point].easy);
    const double easy[] = {aside.x, aside.y, aside.z, aside.z};
    for (int i = 0; i < at.count; i++)
        for (int j = 0; j <= i; j++) {
            double same = at.axis[i] == at.axis[j], around_shaft = least * same + (shaft - least) * at.along[i] * at.along[j] + more * easy[i] * easy[j];
            p->compliance[at.row[j]][at.row[i]] += at.on_shaft[i] * at.on_shaft[j] * around_shaft + at.on_face[i] * at.on_face[j] * face * same;
        }
}

void assemble_compliance(const tick_context *tick) {
    insertion_workspace *w = tick->scratch;
    contact_problem *p = &w->problem;
    assemble_between_points(tick);
    if (w->tip) repeat_tip(p);
    for (int i = 0; i < w->guided; i++) guides_add_compliance(tick, i);
    for (int i = w->guided; i < p->count; i++) add_local_compliance(tick, i);
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
        bool tip = w->points[i].kind == POINT_TIP;
        p->gap[unknown(p->count, i, 2)] = gap.z + (tip ? w->points[i].to_end : w->points[i].lead);
        if (tip) p->gap[unknown(p->count, i, 2) + 1] = gap.z + w->points[i].lead;
    }
    for (int i = 0; i < w->guided; i++) guides_close_gap(tick, i);
    creep_shift_gaps(tick);
    stiffening_shift_gaps(tick);
}

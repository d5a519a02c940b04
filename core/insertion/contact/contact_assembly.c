#include "insertion/contact/contact_assembly.h"

#include <string.h>

#include "insertion/contact/between_points.h"
#include "insertion/contact/resistance_ahead.h"
#include "insertion/contact/roll.h"
#include "insertion/guide/guides.h"
#include "insertion/laws/along_track.h"
#include "insertion/laws/creep.h"
#include "insertion/laws/stiffening.h"
#include "insertion/model/local_compliance.h"
#include "insertion/state/strata.h"
#include "snapshot/snapshot_kernels.h"

static const double TIP_FADE = 3e-3; /* m: depth at which the tissue near the surface reaches its full lateral support of tip and shaft. Chosen by judgement */
static const double LEAST_STIFFNESS = 1e-3; /* N/m: smallest stiffness assumed for the tissue around a share of the shaft (shaft_resistance), because a share
                                               that has come out of a gap may barely be in the tissue. Rounding tolerance: the stiffness of 0.5 um of shaft at 1
                                               kPa */
static const double LEAST_HOLD = 1e-6; /* fraction: smallest lateral support, which keeps the compliance finite. Rounding tolerance */

/* ---- points and forces --------------------------------------------------------------------------------------------- */

void points_list(const tick_input *tick, const insertion_state *state, contact_points *points) {
    int contacts = 0;
    double border = 0.0;
    guides_list(tick, state, points);
    for (; contact_is_active(state, contacts); contacts++) {
        contact_point *p = &points->list[points->guided + contacts];
        p->kind = POINT_TISSUE;
        p->handle = state->refined.order[contacts];
        p->share = shaft_next_share(state, contacts, points->tip, &border);
        p->shaft = shaft_resistance_of(tick->model, state, p->share);
    }
    points->count = points->guided + contacts + points->tip;
    if (!points->tip) return;
    contact_point *p = &points->list[points->guided + contacts];
    p->kind = POINT_TIP;
    p->handle = NO_HANDLE;
    p->share = shaft_next_share(state, contacts, true, &border);
    p->shaft = shaft_resistance_of(tick->model, state, p->share);
}

/* A contact's force acts at the point of the shaft that the tissue holds, or at the needle's end if that point would lie beyond it. For the shaft next to the
   tip, this point is behind the needle's end by the depth of the dent under the end face. The force on the end face acts at the needle's end. At the tip, the
   resultant of these two forces across the needle therefore acts somewhere in between. */
static void place_on_shaft(const tick_input *tick, const insertion_state *state, const tissue_step *tissue, contact_point *p) {
    double length = tick->model->needle->given.length;
    bool tip = p->kind == POINT_TIP;
    const shaft_hold *shaft = point_shaft(state, p);
    double depth = tip ? state->tip.place.depth : state->contacts[p->handle].depth;
    p->arc = shaft_arc(shaft, depth, length);
    if (tip) {
        p->to_end = tissue->sideways_on_shaft * (length - p->arc);
        p->arc = length - p->to_end;
    }
    p->lead = shaft->origin + depth - p->arc;
}

void points_locate(const tick_input *tick, const insertion_state *state, contact_points *points, const tissue_step *tissue, const creep_step *creep, hole_edge *edges) {
    double arcs[MAX_POINTS];
    needle_point *at[MAX_POINTS];
    for (int i = 0; i < points->count; i++) {
        if (i >= points->guided) place_on_shaft(tick, state, tissue, &points->list[i]);
        arcs[i] = points->list[i].arc;
        at[i] = &points->list[i].at;
    }
    needle_locate(tick->model->needle, &state->needle, points->count, arcs, at);
    guides_locate(tick, state, points, edges);
    for (int i = points->guided; i < points->count; i++) {
        contact_point *p = &points->list[i];
        p->target = p->kind == POINT_TIP ? v3_add(tip_position(&state->tip.place), tissue->free_at_tip)
                                         : v3_add(state->contacts[p->handle].track, creep_free(tick, state, creep, p->handle));
        if (p->kind == POINT_TIP) p->target = v3_axpy(state->tip.dent.offset, state->tip.place.direction, p->target);
        p->target = v3_add(p->target, creep_unresolved(tick, state, creep, p->share.from, p->share.to));
        if (tick->model->creep.count > 0) p->target = v3_add(p->target, creep->moved[i]);
    }
}

void points_load_needle(const tick_input *tick, const insertion_state *state, const contact_points *points, needle_response *response) {
    memset(response->load, 0, (size_t)(tick->model->needle->given.segments + 1) * sizeof *response->load);
    for (int i = 0; i < points->count; i++) {
        vec3 force = point_force(state, &points->list[i]);
        const needle_point *p = &points->list[i].at;
        for (int k = 0; k < 3; k++) response->load[p->first + k] = v3_axpy(-p->weights[k], force, response->load[p->first + k]);
    }
}

/* ---- compliance of the tissue -------------------------------------------------------------------------------------- */

void find_tip_rows(const tick_input *tick, const insertion_state *state, const contact_points *points, tissue_step *tissue, const creep_step *creep,
                   const int handles[4]) {
    const double *weights = state->tip.known.weights;
    int tip = points->count - 1;
    double yielding[4];
    tissue->tip_resolved = handles[0] == NO_HANDLE ? 0.0 : state->tip.resolution.field.point;
    if (handles[0] == NO_HANDLE) { /* treat the mesh as rigid at the tip */
        memset(tissue->tip_row, 0, (size_t)points->count * sizeof *tissue->tip_row);
        tissue->free_at_tip = v3(0, 0, 0);
        return;
    }
    for (int c = 0; c < 4; c++) yielding[c] = creep->yield * weights[c];
    for (int i = 0; i < points->guided; i++) tissue->tip_row[i] = (mat3){{{0}}};
    for (int i = points->guided; i < tip; i++) tissue->tip_row[i] = compliance_to_point(tick->snapshot, handles, yielding, points->list[i].handle);
    tissue->tip_row[tip] = compliance_of_point(tick->snapshot, handles, yielding, weights);
    tissue->free_at_tip = creep_free_at(tick, state, creep, handles, weights);
}

/* Returns the fraction (0 to 1) of its full lateral support that tissue near the surface gives. It grows with depth and with the push on the tip. Tip and
   contacts behind it get the same fraction, so that forces do not jump when a contact takes over from the tip. */
static double hold_near_surface(const insertion_state *state, const contact_points *points) {
    const needle_tip *tip = &state->tip;
    return points->tip ? fmin(1.0, (tip->place.depth - tip_entry_depth(state)) / TIP_FADE + tip->filtered_push / FULL_GRIP) : 1.0;
}

/* Reduces the lateral support of point i to the fraction `hold`. `compliance` (m/N): the point's local compliance with full support. */
static void reduce_hold(tissue_step *tissue, int i, double hold, double compliance) {
    double part = fmax(hold, LEAST_HOLD);
    tissue->extra_lateral_compliance[i] = hold < 1.0 ? compliance * (1.0 / part - 1.0) : 0.0;
    tissue->tightening[i] = hold < 1.0 ? compliance / (part * part * TIP_FADE) : 0.0;
}

/* Returns the distance (m) from the tip back to the middle of a point's share; INFINITY if the tip is not in the tissue. */
static double behind_tip(const insertion_state *state, const contact_points *points, int i) {
    shaft_share share = points->list[i].share;
    return points->tip ? state->tip.place.depth - 0.5 * (share.from + share.to) : INFINITY;
}

void find_local_compliance(const tick_input *tick, const insertion_state *state, const contact_points *points, tissue_step *tissue) {
    const insertion_model *model = tick->model;
    int t = points->count - points->tip;
    double hold = hold_near_surface(state, points);
    for (int i = points->guided; i < t; i++) {
        const shaft_contact *contact = &state->contacts[points->list[i].handle];
        const shaft_resistance *shaft = &points->list[i].shaft;
        bool here = contact->depth >= tip_entry_depth(state); /* false for a contact in a previous body */
        plane_tensor lateral = local_logarithm_behind_tip(contact->log_lateral, &contact->resolved.end, here ? behind_tip(state, points, i) : INFINITY);
        reduce_hold(tissue, i, here ? hold : 1.0, plane_mean(lateral) / shaft->lateral);
        tissue->lateral[i] = plane_principal(plane_scaled(1.0 / shaft->lateral, lateral), contact->direction);
        tissue->axial[i] = contact->log_axial / shaft->axial;
    }
    if (!points->tip) return;
    const needle_tip *tip = &state->tip;
    double depth = tip->place.depth - tip_entry_depth(state);
    const shaft_resistance *shaft = &points->list[t].shaft;
    double axial = local_logarithm(model, &tip->resolution.field).axial;
    plane_tensor endless = local_logarithm_across(model, &tip->resolution.field, tip->place.direction);
    plane_tensor lateral = local_logarithm_behind_tip(endless, &tip->resolution.field.end, behind_tip(state, points, t));
    double face = local_at_tip(model, tip->place.tet, tip->place.nominal, depth, tip->filtered_push, tissue->tip_resolved);
    double both = plane_mean(lateral) + face * shaft->lateral; /* shaft and end face act in parallel */
    tissue->sideways_on_shaft = face * shaft->lateral / both;
    tissue->lateral[t] = plane_principal(plane_scaled(1.0 / fmax(shaft->lateral, LEAST_STIFFNESS), lateral), tip->place.direction);
    tissue->axial[t] = face;
    reduce_hold(tissue, t, hold, plane_mean(lateral) * face / both);
    tissue->axial[t + 1] = axial / fmax(shaft->axial, LEAST_STIFFNESS);
}

/* Sets the shaft's softness and stiffening to those of the tissue along its share, and returns both. */
static stiffened_shaft soften_shaft(const contact_point *p, shaft_hold *shaft) {
    shaft->softness = (p->share.to - p->share.from) / larger_of(p->shaft.axial, LEAST_STIFFNESS);
    shaft->stiffening = p->shaft.stiffening;
    return (stiffened_shaft){shaft->softness, shaft->stiffening};
}

void soften_shear(const tick_input *tick, insertion_state *state, contact_points *points) {
    points->tip = state->tip.place.phase == TIP_INSIDE;
    points_list(tick, state, points);
    for (int i = points->guided; i < points->count; i++) {
        const contact_point *p = &points->list[i];
        soften_shaft(p, p->kind == POINT_TIP ? &state->tip.shaft : &state->contacts[p->handle].shaft);
    }
}

/* Returns by how much (m) the shaft's lead over the tissue, at its current traction, grows as the tissue along its share becomes softer (negative if stiffer).
   A shaft that enters another region has not sheared the tissue there yet; without this correction, it would slide in the tick in which the tip enters the
   region. */
static double lead_gained(const insertion_model *model, const contact_point *p, double logarithm, double traction, shaft_hold *shaft) {
    stiffened_shaft before = {shaft->softness, shaft->stiffening}, now = soften_shaft(p, shaft);
    if (before.softness == 0.0) return 0.0;
    return logarithm * (now.softness - before.softness) * traction + stiffening_lead(model, before, now, traction);
}

void keep_shear(const tick_input *tick, insertion_state *state, contact_points *points, const creep_step *creep) {
    const insertion_model *model = tick->model;
    int t = points->count - points->tip;
    for (int i = points->guided; i < t; i++) {
        contact_point *p = &points->list[i];
        shaft_contact *contact = &state->contacts[p->handle];
        double traction = contact->shaft.traction + creep_traction_of(tick, state, points, creep, i);
        contact->shaft.origin += lead_gained(model, p, contact->log_axial, traction, &contact->shaft);
    }
    if (!points->tip) return;
    needle_tip *tip = &state->tip;
    double logarithm = local_logarithm(model, &tip->resolution.field).axial;
    double traction = tip->shaft.traction + creep_traction_of(tick, state, points, creep, t);
    shift_tip_shaft(state, lead_gained(model, &points->list[t], logarithm, traction, &tip->shaft));
}

/* ---- bounds on the forces along the needle ------------------------------------------------------------------------- */

static void bound_friction(const tick_input *tick, contact_problem *problem, int i, const shaft_resistance *shaft, double slid, double slip, const roll_friction *roll,
                           friction_state last) {
    double radius = tick->model->needle->radius;
    double dry = shaft_friction_limit(tick->model, shaft, slid + roll_slip_length(slip, roll, radius));
    shared_bound left = roll_bound_for_sliding(dry, slip, roll, radius);
    problem->upper[i] = left.bound;
    problem->lower[i] = -left.bound;
    problem->viscosity[i][0] = problem->viscosity[i][1] = shaft->viscous / tick->dt + left.viscosity;
    problem->state[i] = last;
}

/* Returns the work done against the lateral support per metre of advance (N, along the needle). Near the surface, support grows with depth, which stores
   elastic energy in tissue and needle, and the hand has to do that work as the tip advances. Without this term, a tip that meets no resistance, as in an old
   track, would oscillate along the needle: firmer support bends the needle more, which moves its end back. */
static double work_of_hold(const insertion_state *state, const contact_points *points, const tissue_step *tissue) {
    double sum = 0.0;
    for (int i = points->guided; i < points->count; i++) {
        if (tissue->tightening[i] == 0.0) continue;
        vec3 needle = needle_along(&points->list[i].at), force = point_force(state, &points->list[i]);
        vec3 across = v3_axpy(-v3_dot(force, needle), needle, force);
        sum += 0.5 * v3_dot(across, across) * tissue->tightening[i];
    }
    return sum;
}

/* Two forces act on the tip along the needle: cutting (or an obstacle) on its end face, and friction on the shaft next to it. */
static void bound_tip(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, resistance_ahead *ahead,
                      contact_problem *problem) {
    const needle_tip *tip = &state->tip;
    int t = problem->count - 1;
    resistance_ahead_climb(tick, state, points, ahead, work_of_hold(state, points, tissue), &problem->ahead);
    problem->climber = t;
    problem->lower[t] = problem->ahead.back;
    problem->upper[t] = problem->ahead.level[0];
    problem->viscosity[t][0] = 0.0;
    problem->viscosity[t][1] = problem->ahead.slope[0];
    problem->state[t] = tip->solved.friction;
    bound_friction(tick, problem, t + 1, &points->list[t].shaft, tip->shaft.slid, tip->shaft.slip, &tip->shaft.roll, tip->shaft.friction);
}

void bound_contacts(const tick_input *tick, const insertion_state *state, const contact_points *points, const tissue_step *tissue, resistance_ahead *ahead,
                    hole_edge *edges, contact_problem *problem) {
    for (int i = 0; i < points->guided; i++) guides_bound(tick, state, points, edges, problem, i);
    for (int i = points->guided; i < points->count - points->tip; i++) {
        const shaft_contact *contact = &state->contacts[points->list[i].handle];
        bound_friction(tick, problem, i, &points->list[i].shaft, contact->shaft.slid, contact->shaft.slip, &contact->shaft.roll, contact->shaft.friction);
    }
    problem->ahead.count = 0;
    if (points->tip) bound_tip(tick, state, points, tissue, ahead, problem);
}

/* ---- the contact problem ------------------------------------------------------------------------------------------- */

/* The shaft next to the tip acts at the same point and in the same direction as the end face, so its row and column start as copies of the end face's. */
static void repeat_tip(contact_problem *p) {
    int tip = unknown(p->count, p->count - 1, 2), shaft = tip + 1;
    for (int i = 0; i <= tip; i++) p->compliance[i][shaft] = p->compliance[i][tip];
    p->compliance[shaft][shaft] = p->compliance[tip][tip];
}

/* The principal directions of the shaft's local lateral compliance are those of the track, not of the needle. If they turned with the needle as it bends, the
   passes would diverge near buckling, because the tangent has no term for that rotation. The local compliance of the end face is isotropic. */
static void add_local_compliance(const insertion_state *state, const contact_points *points, const tissue_step *tissue, contact_problem *problem, int point) {
    const track_shares at = along_track(state, points, tissue, point);
    bool tip = points->list[point].kind == POINT_TIP;
    double face = tip ? tissue->axial[point] : 0.0, shaft = tissue->axial[point + tip], least = tissue->lateral[point].least, more = tissue->lateral[point].more;
    vec3 aside = m3_apply_transposed(&points->list[point].at.frame, tissue->lateral[point].easy);
    const double easy[] = {aside.x, aside.y, aside.z, aside.z};
    for (int i = 0; i < at.count; i++)
        for (int j = 0; j <= i; j++) {
            double same = at.axis[i] == at.axis[j], around_shaft = least * same + (shaft - least) * at.along[i] * at.along[j] + more * easy[i] * easy[j];
            problem->compliance[at.row[j]][at.row[i]] += at.on_shaft[i] * at.on_shaft[j] * around_shaft + at.on_face[i] * at.on_face[j] * face * same;
        }
}

void assemble_compliance(const tick_input *tick, const insertion_state *state, insertion_workspace *w) {
    contact_problem *p = &w->problem;
    assemble_between_points(tick, w);
    if (w->points.tip) repeat_tip(p);
    for (int i = 0; i < w->points.guided; i++) guides_add_compliance(tick, &w->points, w->edges, &w->problem, i);
    for (int i = w->points.guided; i < p->count; i++) add_local_compliance(state, &w->points, &w->tissue, &w->problem, i);
    for (int i = w->points.guided; i < p->count; i++)
        for (int a = 0; a < 2; a++) p->compliance[2 * i + a][2 * i + a] += w->tissue.extra_lateral_compliance[i];
    stiffening_add_compliance(state, &w->points, &w->tissue, &w->stiffening, &w->problem);
}

void assemble_gaps(const tick_input *tick, const insertion_state *state, insertion_workspace *w) {
    contact_problem *p = &w->problem;
    for (int i = 0; i < p->count; i++) {
        const needle_point *at = &w->points.list[i].at;
        vec3 gap = v3_sub(v3_sub(at->position, state->base_shift), w->points.list[i].target);
        for (int k = 0; k < 3; k++) gap = v3_axpy(at->weights[k], w->response.tangent.drift[at->first + k], gap);
        gap = m3_apply_transposed(&at->frame, gap);
        p->gap[unknown(p->count, i, 0)] = gap.x;
        p->gap[unknown(p->count, i, 1)] = gap.y;
        bool tip = w->points.list[i].kind == POINT_TIP;
        p->gap[unknown(p->count, i, 2)] = gap.z + (tip ? w->points.list[i].to_end : w->points.list[i].lead);
        if (tip) p->gap[unknown(p->count, i, 2) + 1] = gap.z + w->points.list[i].lead;
    }
    for (int i = 0; i < w->points.guided; i++) guides_close_gap(w->edges, &w->problem, i);
    creep_shift_gaps(tick, state, &w->points, &w->tissue, &w->creep, &w->problem);
    stiffening_shift_gaps(state, &w->points, &w->tissue, &w->stiffening, &w->problem);
}

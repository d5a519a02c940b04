#include "insertion/derivatives/tissue_parameters.h"

#include <string.h>

#include "insertion/laws/along_track.h"
#include "insertion/model/local_compliance.h"
#include "insertion/state/strata.h"

static const double SMALL_CHANGE = 1e-4; /* fraction of a modulus: step of the central difference of the tip's local compliance, which is a smooth closed-form
                                            function */

/* ---- friction and cutting ---------------------------------------------------------------------------------------------------- */

/* Returns the length (m) of a share of the shaft that lies in a region. */
static double length_in(const insertion_state *state, shaft_share share, int region) {
    double sum = 0.0;
    for (int k = 0; k < state->stratum_count; k++) {
        double from = larger_of(share.from, state->strata[k].depth), to = k + 1 < state->stratum_count ? smaller_of(share.to, state->strata[k + 1].depth) : share.to;
        if (state->strata[k].region == region) sum += larger_of(to - from, 0.0);
    }
    return sum;
}

/* Returns the derivative of the friction on a share of the shaft with respect to a property, at fixed slip. */
static double friction_change(const tick_input *tick, const insertion_state *state, const contact_problem *p, const contact_point *point, int i,
                              const tissue_parameter *parameter) {
    double length = length_in(state, point->share, parameter->region), weak = exp(-slid_distance(tick, state, point) / tick->model->settings.weakening_distance);
    double along = part_along(tick, state, point, p->slip[i]);
    switch (parameter->property) {
    case FRICTION_STATIC: return along * length * weak;
    case FRICTION_KINETIC: return along * length * (1.0 - weak);
    case FRICTION_VISCOUS: return length * p->slip[i] / tick->dt;
    default: return 0.0;
    }
}

/* Returns the derivative of the resistance ahead of a tip that slides on this piece of the staircase. The region is taken to be that of the tip's element. */
static double cutting_change(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const tissue_parameter *parameter, int piece) {
    const contact_problem *p = &w->problem;
    const region_material *material = &tick->model->materials[parameter->region];
    if (piece < 0 || tick->model->mesh->region[state->tip.place.tet] != parameter->region || p->ahead.slope[piece] == 0.0) return 0.0;
    double most = 0.0, viscous = 0.0;
    for (int k = 0; k <= piece; k++) {
        const stretch_ahead *stretch = &w->ahead.stretches[w->ahead.of_knot[k]];
        double end = k < piece ? p->ahead.at[k + 1] : p->slip[p->climber];
        if (!stretch->stops) most = larger_of(most, stretch->resistance);
        viscous += p->ahead.slope[k] * (end - p->ahead.at[k]);
    }
    if (parameter->property == CUTTING_FORCE) return material->cutting_force > 0.0 ? (most - material->spreading_force) / material->cutting_force : 1.0;
    return parameter->property == CUTTING_VISCOSITY && material->cutting_viscosity > 0.0 ? viscous / material->cutting_viscosity : 0.0;
}

double resistance_change(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const tissue_parameter *parameter, int row, int piece) {
    const contact_problem *p = &w->problem;
    int i = row - 2 * p->count, point = point_of_unknown(p->count, row);
    if (point < w->points.guided) return 0.0;
    if (w->points.tip && i == p->count - 1) return cutting_change(tick, state, w, parameter, piece);
    return friction_change(tick, state, p, &w->points.list[point], i, parameter);
}

/* ---- stiffness --------------------------------------------------------------------------------------------------------------- */

/* Returns the derivative of the shaft's local displacement (m / Pa, world frame) under the force `force`. The local compliances are inversely proportional to
   the averages of the moduli over the share. */
static vec3 shaft_change(const principal_tensor *lateral, double axial, vec3 track, vec3 force, lateral_axial part) {
    double along = v3_dot(track, force);
    vec3 across = v3_axpy(lateral->more * v3_dot(lateral->easy, force), lateral->easy, v3_scale(lateral->least, v3_axpy(-along, track, force)));
    return v3_axpy(-part.axial * axial * along, track, v3_scale(-part.lateral, across));
}

/* Returns the fractions of a share's lateral and axial stiffness that come from a region, divided by the region's modulus (1 / Pa). */
static lateral_axial part_of_share(const tick_input *tick, const insertion_state *state, const contact_point *p, int region) {
    const region_material *material = &tick->model->materials[region];
    double length = length_in(state, p->share, region) / material->youngs_modulus;
    lateral_axial line = local_line_stiffness(material);
    return length == 0.0 ? (lateral_axial){0.0, 0.0} : (lateral_axial){length * line.lateral / p->shaft.lateral, length * line.axial / p->shaft.axial};
}

/* Returns the local compliance of the tip's end face with a changed modulus; NAN if out of memory. */
static double face_with(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, int region, double factor) {
    region_material materials[MESH_MAX_GROUPS];
    insertion_model model = *tick->model;
    const needle_tip *tip = &state->tip;
    trocar_error ignored;
    memcpy(materials, model.materials, sizeof materials);
    materials[region].youngs_modulus *= factor;
    model.materials = materials;
    if (local_create(&model, &ignored) != TROCAR_OK) return NAN;
    double face = local_at_tip(&model, tip->place.tet, tip->place.nominal, tip->place.depth - tip_entry_depth(state), tip->filtered_push, w->tissue.tip_resolved);
    local_free(&model);
    return face;
}

/* Returns the derivative (m / (N Pa)) of the compliance of the tip's end face with respect to the modulus. */
static double face_change(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, int region) {
    double low = face_with(tick, state, w, region, 1.0 - SMALL_CHANGE), high = face_with(tick, state, w, region, 1.0 + SMALL_CHANGE);
    return (high - low) / (2.0 * SMALL_CHANGE * tick->model->materials[region].youngs_modulus);
}

/* Adds the derivatives of the tip's local displacements. Shaft and end face are treated separately, because they bear different forces. */
static void stiffen_tip(const insertion_workspace *w, const insertion_state *state, const point_forces *forces, lateral_axial part, double face, double gaps[MAX_UNKNOWNS]) {
    int t = w->points.count - 1, x = unknown(w->problem.count, t, 0), z = unknown(w->problem.count, t, 2);
    const mat3 *frame = &w->points.list[t].at.frame;
    const double *force = forces->at[t], s = w->tissue.sideways_on_shaft;
    vec3 on_shaft = m3_apply(frame, v3(s * force[0], s * force[1], forces->shaft));
    vec3 change = m3_apply_transposed(frame, shaft_change(&w->tissue.lateral[t], w->tissue.axial[t + 1], state->tip.place.direction, on_shaft, part));
    gaps[x] -= s * change.x + (1.0 - s) * (1.0 - s) * face * force[0];
    gaps[x + 1] -= s * change.y + (1.0 - s) * (1.0 - s) * face * force[1];
    gaps[z] -= face * forces->face;
    gaps[z + 1] -= change.z;
}

bool stiffen(const tick_input *tick, const insertion_state *state, const insertion_workspace *w, const point_forces *forces, int region, const vec3 moved[MAX_POINTS],
             double gaps[MAX_UNKNOWNS]) {
    const contact_problem *p = &w->problem;
    double face = w->points.tip ? face_change(tick, state, w, region) : 0.0;
    memset(gaps, 0, MAX_UNKNOWNS * sizeof *gaps);
    for (int i = w->points.guided; i < p->count; i++) {
        const contact_point *point = &w->points.list[i];
        const bool tip = point->kind == POINT_TIP;
        const double *force = forces->at[i];
        lateral_axial part = part_of_share(tick, state, point, region);
        vec3 change = moved[i];
        if (!tip) change = v3_add(change, shaft_change(&w->tissue.lateral[i], w->tissue.axial[i], point_track(state, point), m3_apply(&point->at.frame, v3(force[0], force[1], force[2])), part));
        change = m3_apply_transposed(&point->at.frame, change);
        const double changes[3] = {change.x, change.y, change.z};
        for (int axis = 0; axis < 3; axis++) gaps[unknown(p->count, i, axis)] = -changes[axis];
        for (int a = 0; a < 2; a++) gaps[unknown(p->count, i, a)] += part.lateral * w->tissue.extra_lateral_compliance[i] * force[a];
        if (!tip) continue;
        gaps[unknown(p->count, i, 2) + 1] = -changes[2];
        stiffen_tip(w, state, forces, part, face, gaps);
    }
    return !isnan(face);
}

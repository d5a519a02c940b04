#include "insertion/state/shaft.h"

#include "insertion/model/local_compliance.h"

static const double LEAST_SHARE = 1e-6; /* m: shortest length of shaft assigned to a contact. Rounding tolerance */

/* Returns the depth of active contact k, or of the tip if k is past the last contact. */
static double depth_of(const insertion_state *state, int k) {
    return contact_is_active(state, k) ? state->contacts[state->refined.order[k]].depth : state->tip.place.depth;
}

/* Returns the depth of the border between the shares of points k and k + 1. The border is halfway between them. If the track enters another region in between,
   the border is where it does so, so that no contact stands for shaft in a different tissue. The border moves there from halfway only as fast as the next point
   moves away; otherwise forces would jump whenever the tip enters a region. */
static double border_behind(const insertion_state *state, int k) {
    double here = depth_of(state, k), next = depth_of(state, k + 1), half = 0.5 * (here + next);
    for (int s = 1; s < state->stratum_count; s++) {
        double change = state->strata[s].depth;
        if (change <= here) continue;
        return change < next ? half + smaller_of(change - half, next - change) : half;
    }
    return half;
}

shaft_share shaft_next_share(const insertion_state *state, int k, bool tip, double *border) {
    bool last = !contact_is_active(state, tip ? k : k + 1);
    double from = *border;
    *border = last ? state->tip.place.depth : border_behind(state, k);
    return (shaft_share){from, larger_of(*border, from + LEAST_SHARE)};
}

shaft_share shaft_share_of(const insertion_state *state, int k, bool tip) {
    double border = k > 0 ? border_behind(state, k - 1) : 0.0;
    return shaft_next_share(state, k, tip, &border);
}

shaft_piece shaft_piece_of_contact(const insertion_state *state, int slot, shaft_share share) {
    const shaft_contact *contact = &state->contacts[slot];
    const added_node *node = &state->refined.nodes[slot];
    line_in_tet line = v3_norm(node->line.direction) > 0.0 ? node->line : (line_in_tet){node->tet, node->position, contact->direction};
    return (shaft_piece){share.from, share.to, contact->depth, v3_sub(contact->track, contact->beside), contact->direction, line};
}

shaft_piece shaft_piece_of_tip(const insertion_state *state, shaft_share share) {
    const tip_place *place = &state->tip.place;
    line_in_tet line = {place->tet, place->nominal, place->direction};
    for (int i = 0; i < state->request.piece_count; i++) /* the tip's whole chord through an element uses the same line */
        if (state->request.pieces[i].tet == place->tet) line = state->request.pieces[i];
    return (shaft_piece){share.from, share.to, place->depth, place->nominal, place->direction, line};
}

/* Adds the resistance of a length of shaft in one material. */
static void add_resistance(const region_material *material, double length, shaft_resistance *sum) {
    lateral_axial line = local_line_stiffness(material);
    sum->kinetic += length * material->friction_kinetic;
    sum->excess += length * (material->friction_static - material->friction_kinetic);
    sum->viscous += length * material->friction_viscous;
    sum->lateral += length * line.lateral;
    sum->axial += length * line.axial;
    sum->stiffening += length * line.axial * material->stiffening;
}

shaft_resistance shaft_resistance_of(const insertion_model *model, const insertion_state *state, shaft_share part) {
    shaft_resistance sum = {0};
    for (int k = 0; k < state->stratum_count; k++) {
        double top = k > 0 ? larger_of(part.from, state->strata[k].depth) : part.from;
        double length = (k + 1 < state->stratum_count ? smaller_of(part.to, state->strata[k + 1].depth) : part.to) - top;
        if (length > 0.0 && state->strata[k].region != IN_A_GAP) add_resistance(&model->materials[state->strata[k].region], length, &sum);
    }
    if (sum.stiffening > 0.0) sum.stiffening /= sum.axial;
    return sum;
}

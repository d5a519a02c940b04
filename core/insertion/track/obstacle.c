#include "insertion/track/obstacle.h"

#include <math.h>

static const region_material *material_at(const insertion_model *model, int tet) {
    return &model->materials[model->mesh->region[tet]];
}

double calcification_entry(const calcification *c, vec3 x, vec3 direction) {
    vec3 to_centre = v3_sub(c->centre, x);
    double ahead = v3_dot(to_centre, direction), outside = v3_dot(to_centre, to_centre) - c->radius * c->radius; /* m, m^2 */
    double half_chord = sqrt(fmax(ahead * ahead - outside, 0.0));
    return outside > 0.0 && ahead > 0.0 && half_chord > 0.0 ? ahead - half_chord : INFINITY;
}

/* Returns the factor by which calcifications multiply the cutting force at x: that of the hardest one there, or 1 if there is none. */
static double calcified(const insertion_model *model, vec3 x) {
    double factor = 1.0;
    for (int i = 0; i < model->calcification_count; i++) {
        const calcification *c = &model->calcifications[i];
        if (v3_norm(v3_sub(x, c->centre)) <= c->radius) factor = fmax(factor, c->cutting_factor);
    }
    return factor;
}

double cutting_resistance(const insertion_model *model, int tet, vec3 x, double openness) {
    const region_material *material = material_at(model, tet);
    return (1.0 - openness) * calcified(model, x) * material->cutting_force + material->spreading_force;
}

double blocked_resistance(const insertion_model *model, int tet, vec3 x, double openness, int blocked_by, double damage) {
    if (blocked_by == BLOCKED_BY_BONE) return INFINITY;
    double cutting = cutting_resistance(model, tet, x, openness);
    return blocked_by == NOT_BLOCKED ? cutting : fmax(cutting, damage == 1.0 ? 0.0 : (1.0 - damage) * model->membranes[blocked_by].puncture_force);
}

double tip_resistance(const insertion_model *model, const needle_tip *tip) {
    return blocked_resistance(model, tip->place.tet, tip->place.nominal, tip->track.openness, tip->barrier.blocked_by, tip->barrier.membrane_damage);
}

int obstacle(const insertion_model *model, int tet, int face, int behind) {
    if (behind >= 0 && isinf(material_at(model, behind)->cutting_force)) return BLOCKED_BY_BONE;
    int strongest = NOT_BLOCKED;
    for (int i = 0; i < model->membrane_count; i++)
        if (model->mesh->face_groups[tet][face] >> model->membranes[i].group & 1
            && (strongest < 0 || model->membranes[i].puncture_force > model->membranes[strongest].puncture_force)) strongest = i;
    return strongest;
}

#include "insertion/track/obstacle.h"

#include <math.h>

static const region_material *material_at(const insertion_model *model, int tet) {
    return &model->materials[model->mesh->region[tet]];
}

double cutting_resistance(const insertion_model *model, int tet, double openness) {
    const region_material *material = material_at(model, tet);
    return (1.0 - openness) * material->cutting_force + material->spreading_force;
}

double blocked_resistance(const insertion_model *model, int tet, double openness, int blocked_by, double damage) {
    if (blocked_by == BLOCKED_BY_BONE) return INFINITY;
    double cutting = cutting_resistance(model, tet, openness);
    return blocked_by == NOT_BLOCKED ? cutting : fmax(cutting, damage == 1.0 ? 0.0 : (1.0 - damage) * model->membranes[blocked_by].puncture_force);
}

double tip_resistance(const insertion_model *model, const needle_tip *tip) {
    return blocked_resistance(model, tip->place.tet, tip->track.openness, tip->barrier.blocked_by, tip->barrier.membrane_damage);
}

int obstacle(const insertion_model *model, int tet, int face, int behind) {
    if (behind >= 0 && isinf(material_at(model, behind)->cutting_force)) return BLOCKED_BY_BONE;
    int strongest = NOT_BLOCKED;
    for (int i = 0; i < model->membrane_count; i++)
        if (model->mesh->face_groups[tet][face] >> model->membranes[i].group & 1
            && (strongest < 0 || model->membranes[i].puncture_force > model->membranes[strongest].puncture_force)) strongest = i;
    return strongest;
}

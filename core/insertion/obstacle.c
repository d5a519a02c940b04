#include "insertion/obstacle.h"

#include <math.h>

static const region_material *material_at(const insertion_model *model, int tet) {
    return &model->materials[model->mesh->region[tet]];
}

double tip_resistance(const insertion_model *model, const needle_tip *tip) {
    if (tip->blocked_by == BLOCKED_BY_BONE) return INFINITY;
    const region_material *material = material_at(model, tip->tet);
    double cutting = (1.0 - tip->open) * material->cutting_force + material->spreading_force;
    return tip->blocked_by == NOT_BLOCKED ? cutting : fmax(cutting, tip->torn == 1.0 ? 0.0 : (1.0 - tip->torn) * model->membranes[tip->blocked_by].puncture_force);
}

int obstacle(const insertion_model *model, int tet, int face, int behind) {
    if (behind >= 0 && isinf(material_at(model, behind)->cutting_force)) return BLOCKED_BY_BONE;
    int strongest = NOT_BLOCKED;
    for (int i = 0; i < model->membrane_count; i++)
        if (model->mesh->face_groups[tet][face] >> model->membranes[i].group & 1
            && (strongest < 0 || model->membranes[i].puncture_force > model->membranes[strongest].puncture_force)) strongest = i;
    return strongest;
}

#include "local.h"

static const double LEAST_LOGARITHM = 0.02; /* keeps contacts apart where the mesh resolves the needle's surface by itself */

local_compliance local_at(const insertion_model *model, int tet, vec3 x) {
    double weights[4], size = 0.0, lateral = 0.0, axial = 0.0, point = 0.0;
    mesh_barycentric(model->mesh, tet, x, weights);
    for (int i = 0; i < 4; i++) {
        int node = model->mesh->tets[tet][i];
        double w = fmax(weights[i], 0.0);
        size += w * model->mesh->node_size[node];
        lateral += w * model->node_lateral[node];
        axial += w * model->node_axial[node];
        point += w * model->node_point[node];
    }
    double radius = model->needle->radius, resolved = model->settings.resolution * size;
    double logarithm = fmax(log(resolved / radius), LEAST_LOGARITHM);
    return (local_compliance){lateral * logarithm, axial * logarithm, point * fmax(1.0 / radius - 1.0 / resolved, 0.0)};
}

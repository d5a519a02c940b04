#include "view/hand/parking_poses.h"

#include <math.h>

#include "shared/patient.h"
#include "view/hand/hole_approach.h"

static const double MARGIN = 0.002; /* m, gap between tip and surface */

void find_mesh_box(const trocar_model *model, vec3 *low, vec3 *high) {
    const double *nodes = trocar_model_nodes(model);
    *low = v3(INFINITY, INFINITY, INFINITY);
    *high = v3_scale(-1, *low);
    for (int n = 0; n < trocar_model_node_count(model); n++) {
        const double *x = nodes + 3 * n;
        *low = v3(fmin(low->x, x[0]), fmin(low->y, x[1]), fmin(low->z, x[2]));
        *high = v3(fmax(high->x, x[0]), fmax(high->y, x[1]), fmax(high->z, x[2]));
    }
}

static pose home_at_skin(const trocar_model *model, vec3 low, vec3 high, double needle_length, double aside) {
    double x = 0.5 * (low.x + high.x) + aside, y = 0.5 * (low.y + high.y);
    const double from[3] = {x, y, low.z - MARGIN}, to[3] = {x, y, high.z + MARGIN};
    double skin[3] = {x, y, low.z};
    trocar_model_entry(model, from, to, skin);
    return (pose){v3(x, y, skin[2] - MARGIN - needle_length), {1, 0, 0, 0}};
}

void find_parking_poses(const trocar_scene *scene, const trocar_model *model, double needle_length, int count, pose *parking_poses) {
    vec3 low, high;
    pose start;
    bool given = find_start(scene, NULL, NULL, &start);
    int template = find_template(model);
    find_mesh_box(model, &low, &high);
    for (int needle = 0; needle < count; needle++) {
        double aside = (needle % 2 ? 0.01 : -0.01) * ((needle + 1) / 2 % 3); /* m, sideways offset, on alternating sides */
        if (given) {
            parking_poses[needle] = (pose){v3_add(start.position, q_rotate(start.orientation, v3(aside, 0, 0))), start.orientation};
        } else if (template >= 0) {
            trocar_guide guide = trocar_model_guide(model, template);
            parking_poses[needle] = hole_home(&guide, 0.5 * (guide.columns - 1) + aside / guide.spacing, 0.5 * (guide.rows - 1), needle_length);
        } else {
            parking_poses[needle] = home_at_skin(model, low, high, needle_length, aside);
        }
    }
}

pose find_home_of_base(const trocar_model *model, double needle_length, pose base, pose otherwise) {
    int template = find_template(model);
    if (template < 0) return otherwise;
    trocar_guide guide = trocar_model_guide(model, template);
    return hole_home_beside(&guide, base, needle_length);
}

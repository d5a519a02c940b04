#include "device/implant_plan.h"

#include <math.h>
#include <stdio.h>

#include "common/messages.h"
#include "shared/template_holes.h"

static const double ROUNDING = 1e-5;  /* m, rounding error allowed for positions in the table */
static const double ON_FACE = 1e-9;   /* rounding error allowed for a barycentric weight */

/* Chooses the needle for the hole of the next seed: the last needle if it is in this hole, otherwise a new needle. A hole may have two names, such as
   C3 and C3.0. */
static trocar_status choose_needle(implant_plan *plan, const trocar_guide *guide, const char *hole, const char *where, report *why) {
    int column, row, known = 0;
    find_hole(guide, hole, &column, &row);
    while (known < plan->needle_count && (plan->needles[known].column != column || plan->needles[known].row != row)) known++;
    if (known == plan->needle_count - 1) return TROCAR_OK;
    if (known < plan->needle_count) return fail(why, TROCAR_BAD_INPUT, "%s: the seeds of hole %s are not together: sort the table by holes", where, hole);
    if (plan->needle_count == TROCAR_MAX_NEEDLES) return fail(why, TROCAR_BAD_INPUT, "%s: more than %d needles", where, (int)TROCAR_MAX_NEEDLES);
    planned_needle *n = &plan->needles[plan->needle_count++];
    *n = (planned_needle){.column = column, .row = row, .entry = hole_entry(guide, column, row), .depths = plan->depths + plan->seed_count,
                          .places = plan->places + plan->seed_count};
    snprintf(n->hole, sizeof n->hole, "%s", hole);
    return TROCAR_OK;
}

/* Returns six times the volume of a tetrahedron, positive if the order a, b, c is counter-clockwise as seen from d. */
static double volume_of(vec3 a, vec3 b, vec3 c, vec3 d) { return v3_dot(v3_cross(v3_sub(b, a), v3_sub(c, a)), v3_sub(d, a)); }

/* Finds the material point at a position; returns false if no tetrahedron of the model contains the position. */
static bool find_material_point(const trocar_model *model, vec3 point, material_point *found) {
    const double *nodes = trocar_model_nodes(model);
    const int32_t *tets = trocar_model_tets(model);
    for (int t = 0; t < trocar_model_tet_count(model); t++) {
        vec3 corner[4];
        bool inside = true;
        for (int c = 0; c < 4; c++) corner[c] = load_vec3(&nodes[3 * tets[4 * t + c]]);
        double whole = volume_of(corner[0], corner[1], corner[2], corner[3]);
        for (int c = 0; c < 4; c++) {
            vec3 moved[4] = {corner[0], corner[1], corner[2], corner[3]};
            moved[c] = point;
            found->nodes[c] = tets[4 * t + c];
            found->weights[c] = volume_of(moved[0], moved[1], moved[2], moved[3]) / whole;
            inside &= found->weights[c] >= -ON_FACE;
        }
        if (inside) return true;
    }
    return false;
}

static trocar_status add_seed(implant_plan *plan, const trocar_model *model, const planned_seed *seed, const char *where, report *why) {
    planned_needle *n = &plan->needles[plan->needle_count - 1];
    vec3 axis = q_axis(n->entry.orientation), from = v3_sub(load_vec3(seed->position), n->entry.position);
    double depth = v3_dot(from, axis), tip = depth + 0.5 * plan->seed_length;
    plan->greatest_aside = fmax(plan->greatest_aside, v3_norm(v3_axpy(-depth, axis, from)));
    if (tip <= 0 || tip >= plan->needle_length)
        return fail(why, TROCAR_BAD_INPUT, "%s: the seed is %.1f mm behind the template's face, where a needle of %.0f mm does not reach: choose the scene that the plan was made for", where,
                    1e3 * depth, 1e3 * plan->needle_length);
    if (n->seed_count > 0 && n->depths[n->seed_count - 1] - tip < plan->seed_length - ROUNDING)
        return fail(why, TROCAR_BAD_INPUT, "%s: the seed is not behind the one before: list them from the tip back, without overlap", where);
    if (!find_material_point(model, load_vec3(seed->position), &plan->places[plan->seed_count]))
        return fail(why, TROCAR_BAD_INPUT, "%s: the seed is not in the tissue: choose the scene that the plan was made for", where);
    plan->depths[plan->seed_count++] = tip;
    n->seed_count++;
    return TROCAR_OK;
}

static trocar_status arrange(const trocar_model *model, const plan_table *table, const char *path, implant_plan *plan, report *why) {
    int template = find_template(model), needles = trocar_model_needles(model);
    if (template < 0) return fail(why, TROCAR_BAD_INPUT, "%s: the scene has no template (guides) for this plan", path);
    trocar_guide guide = trocar_model_guide(model, template);
    trocar_status fits = plan_table_fits(table, &guide, path, why);
    if (fits != TROCAR_OK) return fits;
    *plan = (implant_plan){.needle_length = trocar_model_needle_length(model), .seed_length = trocar_model_seed_size(model).length,
                           .node_count = trocar_model_node_count(model)};
    for (int i = 0; i < table->count; i++) {
        char where[512];
        snprintf(where, sizeof where, "%s:%d", path, i + 2);
        trocar_status status = choose_needle(plan, &guide, table->seeds[i].hole, where, why);
        if (status == TROCAR_OK) status = add_seed(plan, model, &table->seeds[i], where, why);
        if (status != TROCAR_OK) return status;
    }
    if (plan->needle_count == 0) return fail(why, TROCAR_BAD_INPUT, "%s: no seeds", path);
    if (plan->needle_count > needles)
        return fail(why, TROCAR_BAD_INPUT, "%s: the plan has %d needles, the scene %d: add \"needles: %d\" to the scene", path, plan->needle_count, needles, plan->needle_count);
    return TROCAR_OK;
}

trocar_status implant_plan_read(const trocar_scene *scene, const char *path, implant_plan *plan, report *why) {
    static plan_table table;
    trocar_model *model;
    trocar_status status = plan_table_read(path, &table, why);
    if (status != TROCAR_OK) return status;
    status = trocar_model_create(scene, &(trocar_model_options){.mesh_only = 1}, &model, why);
    if (status != TROCAR_OK) return status;
    status = arrange(model, &table, path, plan, why);
    trocar_model_free(model);
    return status;
}

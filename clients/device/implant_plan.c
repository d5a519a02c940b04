#include "device/implant_plan.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "common/messages.h"
#include "shared/template_holes.h"

static const double ROUNDING = 1e-5;  /* m, rounding error to allow for in the table's positions */

/* Returns the index of the needle in this hole, or the number of needles if there is none. */
static int needle_in(const implant_plan *plan, int column, int row) {
    int i = 0;
    while (i < plan->needle_count && (plan->needles[i].column != column || plan->needles[i].row != row)) i++;
    return i;
}

static trocar_status add_needle(implant_plan *plan, const trocar_guide *guide, const char *hole, const char *where, trocar_error *why) {
    int column, row;
    find_hole(guide, hole, &column, &row);
    if (plan->needle_count == TROCAR_MAX_NEEDLES) return fail(why, TROCAR_BAD_INPUT, "%s: more than %d needles", where, (int)TROCAR_MAX_NEEDLES);
    planned_needle *n = &plan->needles[plan->needle_count++];
    *n = (planned_needle){.column = column, .row = row, .entry = hole_entry(guide, column, row), .depths = plan->depths + plan->seed_count};
    snprintf(n->hole, sizeof n->hole, "%s", hole);
    return TROCAR_OK;
}

/* Finds or adds the needle for the next seed. Fails unless it is the plan's last needle, because the table must list all seeds of a hole together. Compares
   holes by position, because a hole may have two names, such as C3 and C3.0. */
static trocar_status choose_needle(implant_plan *plan, const trocar_guide *guide, const char *hole, const char *where, trocar_error *why) {
    int column, row;
    find_hole(guide, hole, &column, &row);
    int known = needle_in(plan, column, row);
    if (known == plan->needle_count) return add_needle(plan, guide, hole, where, why);
    if (known == plan->needle_count - 1) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: the seeds of hole %s are not together: sort the table by holes", where, hole);
}

static trocar_status add_seed(implant_plan *plan, const planned_seed *seed, const char *where, trocar_error *why) {
    planned_needle *n = &plan->needles[plan->needle_count - 1];
    vec3 axis = q_axis(n->entry.orientation), from = v3_sub(load_vec3(seed->position), n->entry.position);
    double depth = v3_dot(from, axis), tip = depth + 0.5 * plan->seed_length;
    plan->greatest_aside = fmax(plan->greatest_aside, v3_norm(v3_axpy(-depth, axis, from)));
    if (tip <= 0 || tip >= plan->needle_length)
        return fail(why, TROCAR_BAD_INPUT, "%s: the seed is %.1f mm behind the template's face, where a needle of %.0f mm does not reach: choose the scene that the plan was made for", where,
                    1e3 * depth, 1e3 * plan->needle_length);
    if (n->seed_count > 0 && n->depths[n->seed_count - 1] - tip < plan->seed_length - ROUNDING)
        return fail(why, TROCAR_BAD_INPUT, "%s: the seed is not behind the one before: list them from the tip back, without overlap", where);
    if (n->seed_count == 0) n->depth = tip;
    plan->depths[plan->seed_count++] = tip;
    n->seed_count++;
    return TROCAR_OK;
}

trocar_status implant_plan_read(const trocar_model *model, const char *path, implant_plan *plan, trocar_error *why) {
    static plan_table table;
    trocar_status status = plan_table_read(path, &table, why);
    if (status != TROCAR_OK) return status;
    int template = find_template(model);
    if (template < 0) return fail(why, TROCAR_BAD_INPUT, "%s: the scene has no template (guides) for this plan", path);
    trocar_guide guide = trocar_model_guide(model, template);
    status = plan_table_fits(&table, &guide, path, why);
    if (status != TROCAR_OK) return status;
    *plan = (implant_plan){.needle_length = trocar_model_needle_length(model), .seed_length = trocar_model_seed_size(model).length, .template = template,
                           .node_count = trocar_model_node_count(model)};
    for (int i = 0; i < table.count; i++) {
        char where[512];
        snprintf(where, sizeof where, "%s:%d", path, i + 2);
        status = choose_needle(plan, &guide, table.seeds[i].hole, where, why);
        if (status == TROCAR_OK) status = add_seed(plan, &table.seeds[i], where, why);
        if (status != TROCAR_OK) return status;
    }
    return plan->needle_count > 0 ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "%s: no seeds", path);
}

static trocar_status add_stabiliser(const trocar_guide *guide, const char *hole, double depth, implant_plan *plan, trocar_error *why) {
    int column, row;
    if (!find_hole(guide, hole, &column, &row))
        return fail(why, TROCAR_BAD_INPUT, "--stabilise: the scene's template has no hole %s: it has %d x %d", hole, guide->columns, guide->rows);
    if (needle_in(plan, column, row) < plan->needle_count) return fail(why, TROCAR_BAD_INPUT, "--stabilise: hole %s is taken by another needle", hole);
    trocar_status status = add_needle(plan, guide, hole, "--stabilise", why);
    if (status == TROCAR_OK) plan->needles[plan->needle_count - 1].depth = depth;
    return status;
}

trocar_status implant_plan_stabilise(const trocar_model *model, const char *holes, implant_plan *plan, trocar_error *why) {
    trocar_guide guide = trocar_model_guide(model, plan->template);
    trocar_status status = TROCAR_OK;
    double depth = 0;
    for (int i = 0; i < plan->needle_count; i++) depth = fmax(depth, plan->needles[i].depth);
    while (status == TROCAR_OK && *holes) {
        char hole[PLAN_HOLE];
        size_t length = strcspn(holes, ",");
        snprintf(hole, sizeof hole, "%.*s", (int)length, holes);
        status = add_stabiliser(&guide, hole, depth, plan, why);
        holes += length + (holes[length] == ',');
    }
    return status;
}

trocar_status implant_plan_operator(const trocar_model *model, const implant_plan *plan, const trocar_operator_options *options, const char *path,
                                    trocar_operator **op, trocar_error *why) {
    trocar_operator_needle needles[TROCAR_MAX_NEEDLES];
    int there = trocar_model_needles(model);
    trocar_error reason;
    if (plan->needle_count > there)
        return fail(why, TROCAR_BAD_INPUT, "%s: the plan has %d needles, the scene %d: add \"needles: %d\" to the scene", path, plan->needle_count, there, plan->needle_count);
    for (int i = 0; i < plan->needle_count; i++) {
        const planned_needle *n = &plan->needles[i];
        needles[i] = (trocar_operator_needle){.entry = library_pose(n->entry), .depth = n->depth, .seeds = n->depths, .seed_count = n->seed_count, .guide = plan->template};
    }
    trocar_status status = trocar_operator_create(model, needles, plan->needle_count, options, op, &reason);
    return status == TROCAR_OK ? status : fail(why, status, "%s: %.800s: choose the scene that the plan was made for", path, reason.text);
}

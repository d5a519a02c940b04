/* A planned implant in a scene: the hole and depth of each needle, and where it is to leave its seeds. */
#ifndef TROCAR_IMPLANT_PLAN_H
#define TROCAR_IMPLANT_PLAN_H

#include "base/vec.h"
#include "shared/plan_table.h"

typedef struct {
    char hole[PLAN_HOLE];
    int column, row;         /* of the hole, from 0 */
    pose entry;              /* where the hole's axis meets the face at which needles enter the template, with z along the axis */
    double depth;            /* m, tip depth below the entry face at full insertion */
    int seed_count;          /* 0 for a stabilising needle */
    const double *depths;    /* m, tip depths at which to drop the seeds if the tissue does not move, deepest first */
} planned_needle;

typedef struct {
    double needle_length;    /* m */
    double seed_length;      /* m */
    int template;            /* index of the template in the scene's list of guides */
    int node_count;          /* in the scene's mesh */
    double greatest_aside;   /* m, farthest that a planned seed is from its hole's axis; it will be dropped on the axis */
    int needle_count, seed_count;
    planned_needle needles[TROCAR_MAX_NEEDLES];
    double depths[TROCAR_MAX_SEEDS];
} implant_plan;

/* Reads the table written by `python3 -m trocar.brachy.plan show --out`, for the scene of `model`. The needles are numbered in the order of the table, from 0.
   Returns BAD_INPUT if the table or the scene is bad, or if the plan was made for another template. */
trocar_status implant_plan_read(const trocar_model *model, const char *path, implant_plan *plan, trocar_error *why);

/* Adds stabilising needles, which carry no seeds and go as deep as the plan's deepest needle, in the named holes (separated by commas). Returns BAD_INPUT if
   the template has no such hole, or if it is taken. */
trocar_status implant_plan_stabilise(const trocar_model *model, const char *holes, implant_plan *plan, trocar_error *why);

/* Creates an operator that carries out the plan. `path` is the path of the table, for messages. Returns BAD_INPUT if the plan has more needles than the scene,
   or if a seed is outside the undeformed tissue. */
trocar_status implant_plan_operator(const trocar_model *model, const implant_plan *plan, const trocar_operator_options *options, const char *path,
                                    trocar_operator **op, trocar_error *why);

#endif

/* A planned implant in a scene: hole and depth of each needle, and the positions at which it leaves its seeds. */
#ifndef TROCAR_IMPLANT_PLAN_H
#define TROCAR_IMPLANT_PLAN_H

#include "base/vec.h"
#include "shared/plan_table.h"

typedef struct {
    char hole[PLAN_HOLE];
    int column, row;         /* column and row of the hole, counted from 0 */
    pose entry;              /* pose at the point where the hole's axis meets the template's entry face, oriented along the axis */
    double depth;            /* m, depth of the tip (measured from the entry face) at full insertion */
    int seed_count;          /* 0 for a stabilising needle */
    const double *depths;    /* m, tip depths at which the seeds are dropped if the tissue is at rest, deepest first */
} planned_needle;

typedef struct {
    double needle_length;    /* m */
    double seed_length;      /* m */
    int template;            /* index of the template among the scene's guides */
    int node_count;          /* number of nodes in the scene's mesh */
    double greatest_aside;   /* m, largest distance of a planned seed from the axis of its hole, on which it will be dropped */
    int needle_count, seed_count;
    planned_needle needles[TROCAR_MAX_NEEDLES];
    double depths[TROCAR_MAX_SEEDS];
} implant_plan;

/* Reads the table written by `python3 -m trocar.brachy.plan show --out`, for the scene of `model`. The needles keep the order of the table; the first one
   becomes the scene's needle 0. BAD_INPUT for a bad table or scene, and a plan made for a template other than the scene's. */
trocar_status implant_plan_read(const trocar_model *model, const char *path, implant_plan *plan, trocar_error *why);

/* Adds stabilising needles (needles without seeds, as deep as the deepest needle of the plan) in the named holes, separated by commas. BAD_INPUT for
   a name that is not a hole of the template, and for a hole that is taken. */
trocar_status implant_plan_stabilise(const trocar_model *model, const char *holes, implant_plan *plan, trocar_error *why);

/* Creates an operator who carries out the plan. BAD_INPUT if the plan has more needles than the scene, and for a seed outside the tissue at rest; `path` is the
   path of the table, for messages. */
trocar_status implant_plan_operator(const trocar_model *model, const implant_plan *plan, const trocar_operator_options *options, const char *path,
                                    trocar_operator **op, trocar_error *why);

#endif

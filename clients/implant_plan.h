/* A planned implant in a scene: which needle goes into which hole, how deep, and where it leaves its seeds. */
#ifndef TROCAR_IMPLANT_PLAN_H
#define TROCAR_IMPLANT_PLAN_H

#include "base/vec.h"
#include "plan_table.h"

typedef struct {
    char hole[PLAN_HOLE];
    int column, row;         /* of the hole, from 0 */
    pose entry;              /* where the hole's axis meets the face where needles enter; along the axis */
    int seed_count;          /* at least 1 */
    const double *depths;    /* m behind that face, of the tip when it drops each seed, deepest first */
} planned_needle;

typedef struct {
    double needle_length;    /* m */
    double seed_length;      /* m */
    int needle_count, seed_count;
    planned_needle needles[TROCAR_MAX_NEEDLES];
    double depths[TROCAR_MAX_SEEDS];
} implant_plan;

/* Reads the table that `python3 -m trocar.plan show --out` writes. Needles are in its order; the first is the scene's needle 0. BAD_INPUT for
   a bad table or scene, a plan that is not for the scene's template, and one with more needles than the scene. */
trocar_status implant_plan_read(const trocar_scene *scene, const char *path, implant_plan *plan, report *why);

#endif

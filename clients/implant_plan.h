/* A planned implant in a scene: which needle goes into which hole, how deep, and where it leaves its seeds. */
#ifndef TROCAR_IMPLANT_PLAN_H
#define TROCAR_IMPLANT_PLAN_H

#include "base/vec.h"
#include "plan_table.h"

/* A place in the tissue, between the corners of a tetrahedron: it moves with them. */
typedef struct {
    int nodes[4];
    double weights[4];
} material_point;

typedef struct {
    char hole[PLAN_HOLE];
    int column, row;         /* of the hole, from 0 */
    pose entry;              /* where the hole's axis meets the face where needles enter; along the axis */
    int seed_count;          /* at least 1 */
    const double *depths;    /* m behind that face, of the tip when it drops each seed, deepest first; in the tissue at rest */
    const material_point *places; /* of the seeds' centres */
} planned_needle;

typedef struct {
    double needle_length;    /* m */
    double seed_length;      /* m */
    int node_count;          /* of the scene's mesh */
    double greatest_aside;   /* m, how far the table has a seed beside the axis of its hole, on which it will be dropped */
    int needle_count, seed_count;
    planned_needle needles[TROCAR_MAX_NEEDLES];
    double depths[TROCAR_MAX_SEEDS];
    material_point places[TROCAR_MAX_SEEDS];
} implant_plan;

/* Reads the table that `python3 -m trocar.plan show --out` writes. Needles are in its order; the first is the scene's needle 0. BAD_INPUT for
   a bad table or scene, a plan that is not for the scene's template, one with more needles than the scene, and for a seed outside of the tissue at rest. */
trocar_status implant_plan_read(const trocar_scene *scene, const char *path, implant_plan *plan, report *why);

#endif

/* A planned implant in a scene: hole and depth of each needle, and the positions at which it leaves its seeds. */
#ifndef TROCAR_IMPLANT_PLAN_H
#define TROCAR_IMPLANT_PLAN_H

#include "base/vec.h"
#include "shared/plan_table.h"

/* A material point of the tissue, given by a tetrahedron with whose corners it moves. */
typedef struct {
    int nodes[4];
    double weights[4];
} material_point;

typedef struct {
    char hole[PLAN_HOLE];
    int column, row;         /* column and row of the hole, counted from 0 */
    pose entry;              /* pose at the point where the hole's axis meets the template's entry face, oriented along the axis */
    int seed_count;          /* at least 1 */
    const double *depths;    /* m, tip depths (measured from the entry face) at which the seeds are dropped if the tissue is at rest, deepest first */
    const material_point *places; /* material points at which the seeds' centres should be */
} planned_needle;

typedef struct {
    double needle_length;    /* m */
    double seed_length;      /* m */
    int node_count;          /* number of nodes in the scene's mesh */
    double greatest_aside;   /* m, largest distance of a planned seed from the axis of the hole along which it will be dropped */
    int needle_count, seed_count;
    planned_needle needles[TROCAR_MAX_NEEDLES];
    double depths[TROCAR_MAX_SEEDS];
    material_point places[TROCAR_MAX_SEEDS];
} implant_plan;

/* Reads the table written by `python3 -m trocar.brachy.plan show --out`. The needles keep the order of the table; the first one becomes the scene's
   needle 0. BAD_INPUT for a bad table or scene, a plan made for a template other than the scene's, a plan that has more needles than the scene, and a
   seed outside the tissue at rest. */
trocar_status implant_plan_read(const trocar_scene *scene, const char *path, implant_plan *plan, report *why);

#endif

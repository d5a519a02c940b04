/* A guide: a plate with holes, as the template of an implant, that holds the shaft sideways. See docs/mechanics.md, "Guides". */
#ifndef TROCAR_GUIDE_H
#define TROCAR_GUIDE_H

#include <stdbool.h>

#include "base/report.h"
#include "mesh/mesh.h"

enum {
    MAX_GUIDES = 8,
    GUIDE_FACES = 2,
    MAX_GUIDE_POINTS = MAX_GUIDES * GUIDE_FACES,
};

/* As the scene gives it. */
typedef struct {
    char name[MESH_NAME];
    vec3 origin;             /* m, middle of the grid on the front face, where needles enter */
    vec3 normal;             /* direction in which needles pass through; any length */
    vec3 along;              /* direction along which columns are counted; any length; zero: not given */
    vec3 rows_along;         /* direction along which rows are counted; its side of `along` counts; zero: normal x along */
    int columns, rows;
    double spacing;          /* m, between the axes of neighbouring holes */
    double hole_diameter;    /* m */
    double thickness;        /* m; 0: one plane, which does not guide the needle's direction */
    double stiffness;        /* N/m, of a hole's edge in all directions */
    double friction;         /* coefficient */
    int line;                /* of its origin in the scene file, for messages; 0: none */
} guide_config;

/* The same, ready to use. Constant during a run. */
typedef struct {
    vec3 origin;             /* m */
    vec3 normal;             /* unit vectors: through the plate, */
    vec3 across[2];          /* along which columns are counted, and rows; perpendicular to the normal, of either handedness */
    int columns, rows;
    double spacing;          /* m */
    double hole_radius;      /* m */
    double clearance;        /* m, how far the needle's axis may be from that of the hole without force */
    double thickness;        /* m */
    double stiffness;        /* N/m */
    double friction;
} guide;

guide_config guide_defaults(void);

/* NULL, or what is wrong with one key of it, whose name goes to `key`. `needle_diameter`: m. */
const char *guide_fault(const guide_config *given, double needle_diameter, const char **key, report *words);

/* `given` must be sound. */
guide guide_make(const guide_config *given, double needle_diameter);

/* m, where the axis of a hole (column + columns * row) meets the plane `depth` behind the front face. RT */
vec3 guide_hole(const guide *g, int hole, double depth);

enum { NO_HOLE = -1, BESIDE_PLATE = -2 };

/* The hole that a point of the front face lies in; NO_HOLE on the plate between holes, BESIDE_PLATE more than one spacing outside of
   the grid. RT */
int guide_hole_at(const guide *g, vec3 point);

/* Does the plate, or the axis of one of its holes, lie in the tissue at rest? */
bool guide_is_in_tissue(const guide *g, const mesh *m);

#endif

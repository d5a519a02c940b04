/* A guide: a plate with holes that supports the shaft laterally, such as an implant template. See docs/mechanics.md, "Guides". */
#ifndef TROCAR_GUIDE_H
#define TROCAR_GUIDE_H

#include <stdbool.h>

#include "base/error.h"
#include "mesh/mesh.h"

enum {
    MAX_GUIDES = 8,
    GUIDE_FACES = 2,
    MAX_GUIDE_POINTS = MAX_GUIDES * GUIDE_FACES,
};

/* A guide as the scene defines it. */
typedef struct {
    char name[MESH_NAME];
    vec3 origin;             /* m, middle of the grid on the front face, where needles enter */
    vec3 normal;             /* direction in which needles go through the plate; any length */
    vec3 along;              /* direction in which columns are counted; any length; zero if not given */
    vec3 rows_along;         /* direction in which rows are counted; only the side of `along` that it points to matters; zero selects normal x along */
    int columns, rows;
    double spacing;          /* m, spacing of the holes' axes */
    double hole_diameter;    /* m */
    double thickness;        /* m; 0 for a single plane, which does not constrain the needle's direction */
    double stiffness;        /* N/m, stiffness of a hole's edge, equal in all directions */
    double friction;         /* friction coefficient */
    int line;                /* line in the scene file where the guide's origin is set, for messages; 0 if none */
} guide_config;

/* A guide in the form that the tick uses. Immutable during a run. */
typedef struct {
    vec3 origin;             /* m */
    vec3 normal;             /* unit vector through the plate */
    vec3 across[2];          /* unit vectors in which columns and rows are counted; perpendicular to the normal, of either handedness */
    int columns, rows;
    double spacing;          /* m */
    double hole_radius;      /* m */
    double clearance;        /* m, how far the needle's axis can be from the hole's before the edge exerts a force */
    double thickness;        /* m */
    double stiffness;        /* N/m */
    double friction;
} guide;

guide_config guide_defaults(void);

/* Returns NULL if the guide is valid. Otherwise describes the first fault found and sets *key to the key that causes it. `needle_diameter` is in m. */
const char *guide_fault(const guide_config *given, double needle_diameter, const char **key, trocar_error *words);

/* Converts a valid guide from the form in the scene. */
guide guide_make(const guide_config *given, double needle_diameter);

/* Returns the point (m) where the axis of a hole (column + columns * row) meets the plane `depth` behind the front face. RT */
vec3 guide_hole(const guide *g, int hole, double depth);

enum { NO_HOLE = -1, BESIDE_PLATE = -2 };

/* Returns the hole at a point of the front face, NO_HOLE if the point is on the plate between holes, or BESIDE_PLATE if it is more than one spacing outside the
   grid. RT */
int guide_hole_at(const guide *g, vec3 point);

/* True if the plate, or the axis of one of its holes, cuts the tissue at rest. */
bool guide_is_in_tissue(const guide *g, const mesh *m);

#endif

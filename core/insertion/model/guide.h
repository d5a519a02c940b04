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

/* A guide as given in the scene. */
typedef struct {
    char name[MESH_NAME];
    vec3 origin;             /* m, middle of the grid on the front face, where needles enter */
    vec3 normal;             /* direction in which needles pass through the plate; any length */
    vec3 along;              /* direction along which columns are counted; any length; zero if not given */
    vec3 rows_along;         /* direction along which rows are counted; only the side of `along` to which it points matters; zero selects normal x along */
    int columns, rows;
    double spacing;          /* m, distance between the axes of neighbouring holes */
    double hole_diameter;    /* m */
    double thickness;        /* m; 0: a single plane, which does not constrain the needle's direction */
    double stiffness;        /* N/m, stiffness of a hole's edge, the same in all directions */
    double friction;         /* coefficient */
    int line;                /* line of the guide's origin in the scene file, for messages; 0 if none */
} guide_config;

/* A guide in the form used by the tick. Immutable during a run. */
typedef struct {
    vec3 origin;             /* m */
    vec3 normal;             /* unit vector through the plate */
    vec3 across[2];          /* unit vectors along which columns and rows are counted; perpendicular to the normal, of either handedness */
    int columns, rows;
    double spacing;          /* m */
    double hole_radius;      /* m */
    double clearance;        /* m, distance between the axes of needle and hole up to which there is no force */
    double thickness;        /* m */
    double stiffness;        /* N/m */
    double friction;
} guide;

guide_config guide_defaults(void);

/* Returns NULL if the guide is valid. Otherwise returns a description of the first fault and sets *key to the key concerned. `needle_diameter` is in m. */
const char *guide_fault(const guide_config *given, double needle_diameter, const char **key, trocar_error *words);

/* Converts a valid guide from the scene. */
guide guide_make(const guide_config *given, double needle_diameter);

/* Point at which the axis of a hole (column + columns * row) intersects the plane `depth` behind the front face, m. RT */
vec3 guide_hole(const guide *g, int hole, double depth);

enum { NO_HOLE = -1, BESIDE_PLATE = -2 };

/* Returns the hole at a point of the front face: NO_HOLE on the plate between holes, BESIDE_PLATE more than one spacing outside the grid. RT */
int guide_hole_at(const guide *g, vec3 point);

/* True if the plate, or the axis of one of its holes, intersects the tissue at rest. */
bool guide_is_in_tissue(const guide *g, const mesh *m);

#endif

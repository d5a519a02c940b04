/* Where ultrasound images lie and what they cover: the axial image is a sector across the probe's axis, the sagittal one a rectangle along it. */
#ifndef TROCAR_PLANES_H
#define TROCAR_PLANES_H

#include <stdbool.h>

#include "base/error.h"
#include "base/vec.h"
#include "trocar.h"

typedef enum { SLICE_AXIAL, SLICE_SAGITTAL, SLICES } slice_kind;

/* `origin` (m) is a point on the probe's axis. `axes` are unit vectors along the rows, away from the probe, and normal to the image. */
typedef struct {
    vec3 origin, axes[3];
} image_plane;

typedef struct {
    bool sector;             /* true for a sector with its apex at the origin, false for a rectangle */
    double near, far;        /* m, range of distances from the origin */
    double face;             /* m, from the origin to the transducer's face */
    double side;             /* half of the sector's angle (rad), or of the rectangle's length (m) */
    double centre;           /* m, the rectangle's centre along the first axis; 0 for a sector */
} image_field;

typedef struct {
    double pixel;            /* m */
    int width, height;       /* pixels along a row, and rows (away from the probe) */
    double left, near;       /* m, centre of the first pixel along the first two axes, relative to the origin */
} image_raster;

/* What the planes are computed from. */
typedef struct {
    vec3 low, high;          /* m, bounding box of the region of interest at rest */
    bool has_probe;
    double probe_reach;      /* m, from the probe's base to the axial plane */
    double probe_radius;     /* m */
} image_planner;

/* Returns the volume with the most faces on the outer surface, that is, the one that surrounds the organs. */
int host_of(const trocar_model *model);

/* Returns a planner for the gland and the urethra or, if the model names neither, for all soft organs inside other volumes. */
image_planner image_planner_of(const trocar_model *model);

/* Places the images at the probe, whose base has the pose `base`, and tilts them with it. */
void planes_at_probe(const image_planner *p, pose base, image_plane planes[SLICES]);

/* Places the images below the region of interest, at these positions (m) on the mesh's z and x axes. Used in scenes without a probe, and until the probe has a
   pose. */
void planes_at(const image_planner *p, double z, double x, image_plane planes[SLICES]);

/* Like planes_at, but puts the images through a needle's tip or, if `tip` is NULL, through the middle of the region. */
void planes_at_tip(const image_planner *p, const double tip[3], image_plane planes[SLICES]);

/* Returns the field that covers the region of interest in this plane. A `depth` (m, from the face) other than 0 replaces the field's own. */
image_field image_field_of(const image_planner *p, slice_kind kind, const image_plane *plane, double depth);

/* Returns a raster that covers the field. Its width and height are at most a million pixels, so that they fit into an int. */
image_raster image_raster_of(const image_field *field, double pixel);

#endif

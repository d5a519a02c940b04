/* Where ultrasound images lie and what they show: a sector across the probe's axis and a rectangle along it. */
#ifndef TROCAR_PLANES_H
#define TROCAR_PLANES_H

#include <stdbool.h>

#include "base/error.h"
#include "base/vec.h"
#include "trocar.h"

typedef enum { SLICE_AXIAL, SLICE_SAGITTAL, SLICES } slice_kind;

/* Origin, m: a point on the probe's axis. Axes: unit vectors along the rows, away from the probe, and normal to the image. */
typedef struct {
    vec3 origin, axes[3];
} image_plane;

typedef struct {
    bool sector;             /* a sector with its apex at the origin, or a rectangle */
    double near, far;        /* m, smallest and largest distance from the origin */
    double face;             /* m, distance of the transducer's face from the origin */
    double side;             /* half of the sector's angle (rad), or half of the rectangle's length (m) */
    double centre;           /* m, position of the rectangle's centre along the first axis; 0 for a sector */
} image_field;

typedef struct {
    double pixel;            /* m */
    int width, height;       /* number of pixels along a row, and number of rows (away from the probe) */
    double left, near;       /* m, coordinates of the first pixel's centre along the first two axes, relative to the origin */
} image_raster;

/* Data from which the planes are computed. */
typedef struct {
    vec3 low, high;          /* m, corners of the bounding box of the region of interest at rest */
    bool has_probe;
    double probe_reach;      /* m, distance from the probe's base to the axial plane */
    double probe_radius;     /* m */
} image_planner;

/* Returns the volume with the most faces on the outer surface, which is the one that surrounds the organs. */
int host_of(const trocar_model *model);

/* Returns a planner for the gland and the urethra or, if the model names none, for all soft organs inside other volumes. */
image_planner image_planner_of(const trocar_model *model);

/* Places the images at the probe, and tilts them with it: `base` is the pose of its base. */
void planes_at_probe(const image_planner *p, pose base, image_plane planes[SLICES]);

/* Places the images below the region of interest, at these positions (m) on the mesh's z and x axes. For scenes without a probe, and until the probe has
   a pose. */
void planes_at(const image_planner *p, double z, double x, image_plane planes[SLICES]);

/* Like planes_at, but through a needle's tip, or through the middle of the region if `tip` is NULL. */
void planes_at_tip(const image_planner *p, const double tip[3], image_plane planes[SLICES]);

/* Returns the field that covers the region of interest in this plane; `depth` (m, from the face) replaces the depth of that field unless it is 0. */
image_field image_field_of(const image_planner *p, slice_kind kind, const image_plane *plane, double depth);

/* Returns a raster that covers the field; its width and height are limited to a million pixels, so that they fit into an int. */
image_raster image_raster_of(const image_field *field, double pixel);

#endif

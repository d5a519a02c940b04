/* Images of the deformed tissue as a transrectal probe would show it: a sector across the probe's axis and a rectangle along it. The speckle moves with
   the tissue. As in the viewer, the images are meant for orientation and do not simulate ultrasound. */
#ifndef TROCAR_SLICES_H
#define TROCAR_SLICES_H

#include <stdbool.h>

#include "base/vec.h"
#include "ras.h"

typedef enum { SLICE_AXIAL, SLICE_SAGITTAL, SLICES } slice_kind;

typedef enum {
    SLICES_ECHO,             /* like ultrasound */
    SLICES_REGIONS,          /* for each pixel, the number of its volume in the scene's list of regions, starting from 1; 0 where there is no tissue */
    SLICES_NONE
} slice_style;

typedef struct {
    int width, height;       /* number of pixels along a row, and number of rows (away from the probe) */
    double left, near;       /* m, coordinates of the first pixel's centre along axes[0] and axes[1], relative to `origin` */
    float *gain;             /* gain of each pixel; 0 outside the probe's field of view */
    unsigned char *grey;     /* grey levels of the pixels, row by row */
    vec3 origin, axes[3];    /* origin, m: position of the probe; axes: unit vectors along the rows, away from the probe, and normal to the image */
} slice;

typedef struct {
    slice_style style;
    double pixel;            /* m */
    const trocar_model *model;
    const double *nodes;     /* m, positions of the model's nodes at rest, 3 coordinates each */
    double *distance;        /* m, scratch memory for the distance of each node from the plane */
    bool has_probe;
    double probe_reach;      /* m, distance from the probe's base to the image plane */
    double needle_radius;    /* m */
    vec3 low, high;          /* m, corners of the box around the region of interest at rest */
    double brightness[32];   /* brightness of each volume in the images, 0 to 1 */
    unsigned char number[32]; /* number of each volume in the scene's list of regions, starting from 1 */
    unsigned char *speckle;
    slice all[SLICES];
} slices;

/* Creates both images; `pixel` is the size of a pixel (m). BAD_INPUT if an image would have more than 2048 pixels in a row or column; NO_MEMORY. */
trocar_status slices_create(slices *s, const trocar_scene *scene, const trocar_model *model, slice_style style, double pixel, trocar_error *why);
void slices_free(slices *s);

/* The points of a needle from base to tip, in m. */
typedef struct {
    int count;
    double *const *points;
} slice_needle;

/* Draws both images. `nodes` contains the current positions of the mesh's nodes, m. `probe` is the pose of the probe's base; if it is NULL, because
   the scene has no probe or the probe has no pose yet, the images are placed in planes through the first needle's tip that are parallel to the mesh's
   coordinate planes. */
void slices_draw(slices *s, const double *nodes, const pose *probe, const slice_needle *needles, int needle_count);

/* Returns the matrix from IJK to RAS coordinates that igtl_set_image expects. */
ras_matrix slice_matrix(const slices *s, slice_kind kind, const patient_frame *frame);

#endif

/* Images of the deformed tissue as from a transrectal probe: one across its axis, a sector, and one along it, a rectangle. Speckle moves with the
   tissue. For orientation, as in the viewer; not a simulation of ultrasound. */
#ifndef TROCAR_SLICES_H
#define TROCAR_SLICES_H

#include <stdbool.h>

#include "base/vec.h"
#include "ras.h"

typedef enum { SLICE_AXIAL, SLICE_SAGITTAL, SLICES } slice_kind;

typedef enum {
    SLICES_ECHO,             /* like ultrasound */
    SLICES_REGIONS,          /* the volume at each pixel: its number in the scene's list of regions, from 1; 0: no tissue */
    SLICES_NONE
} slice_style;

typedef struct {
    int width, height;       /* pixels: along the first axis, and away from the probe */
    double left, near;       /* m from the probe's place, centre of the first pixel */
    float *gain;             /* of each pixel: 0 outside of what the probe sees */
    unsigned char *grey;     /* the picture, row by row */
    vec3 origin, axes[3];    /* m: the probe's place, and unit vectors: along rows, away from the probe, normal */
} slice;

typedef struct {
    slice_style style;
    double pixel;            /* m */
    const trocar_model *model;
    const double *nodes;     /* 3 each, m: of the mesh at rest, the model's */
    double *distance;        /* scratch: of each node from the plane, m */
    bool has_probe;
    double probe_reach;      /* m from its base to the image plane */
    double needle_radius;    /* m */
    vec3 low, high;          /* m, box around the region of interest at rest */
    double brightness[32];   /* of the volumes, 0 to 1 */
    unsigned char number[32]; /* of the volumes in the scene's list of regions, from 1 */
    unsigned char *speckle;
    slice all[SLICES];
} slices;

/* `pixel`: size in m. BAD_INPUT if an image would have more than 2048 pixels in a row or column; NO_MEMORY. */
trocar_status slices_create(slices *s, const trocar_scene *scene, const trocar_model *model, slice_style style, double pixel, report *why);
void slices_free(slices *s);

/* Points of a needle from base to tip, m. */
typedef struct {
    int count;
    double *const *points;
} slice_needle;

/* Draws both. `nodes`: present positions of the mesh's nodes, m. `probe`: its base; NULL: it has none yet, or the scene has no probe; then the images
   are parallel to the mesh's planes, through the first needle's tip. */
void slices_draw(slices *s, const double *nodes, const pose *probe, const slice_needle *needles, int needle_count);

/* IJK to RAS as OpenIGTLink gives it: see igtl_set_image. */
ras_matrix slice_matrix(const slices *s, slice_kind kind, const patient_frame *frame);

#endif

/* Ultrasound images of the deformed tissue: scatterers that move with it, boundaries, needles, seeds and calcifications, seen by a beam whose width and
   thickness depend on depth. docs/training/ultrasound.md explains the model and what it leaves out. */
#ifndef TROCAR_ECHO_H
#define TROCAR_ECHO_H

#include "view/ultrasound/reflectors.h"

#define ECHO_DENSITY 24e9    /* scatterers per m^3, about ten per resolution cell, which makes the speckle fully developed */
#define ECHO_FLOOR (-60.0)   /* dB, brightness of level 1 */
#define ECHO_STEP 0.4        /* dB between two levels */
#define ECHO_WHITE 32.0      /* dB, brightness shown as white with a gain of 0 */

typedef struct echo echo;

/* Creates what images of this scene need. `density`: scatterers per m^3. `scene` and `model` must outlive it. Returns BAD_INPUT if a calcification is invalid,
   or NO_MEMORY. */
trocar_status echo_create(const trocar_scene *scene, const trocar_model *model, const beam *transducer, double density, echo **created, trocar_error *why);
void echo_free(echo *e);

/* Sets the field that images cover, and their pixels. Returns NO_MEMORY if out of memory. */
trocar_status echo_frame(echo *e, const image_field *field, const image_raster *raster, trocar_error *why);

/* Computes an image. `nodes` [nodes][3] are the positions of the mesh's nodes (m). `levels` [height][width] receives the brightness relative to the mean of
   the prostate at rest, as 1 + (dB - ECHO_FLOOR) / ECHO_STEP; 0 is outside the field. */
void echo_image(echo *e, const image_plane *plane, const double *nodes, const echo_body *bodies, int body_count, unsigned char *levels);

/* Converts levels to grey in place, with `range` dB from black to white. With a `gain` (dB) of 0, the prostate's mean is a little darker than medium grey. */
void echo_show(unsigned char *levels, size_t count, double gain, double range);

/* The envelope of the last image, relative to its root mean square in the prostate at rest. `values`: [rows][lines]. */
typedef struct {
    int rows, lines;
    double step, first_row;  /* m, row spacing, and distance of the first row from the origin */
    double spacing, first_line; /* line spacing and position of the first line: rad in a sector, otherwise m */
    const float *values;
} echo_envelope;
echo_envelope echo_last(const echo *e);

#endif

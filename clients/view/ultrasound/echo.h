/* Ultrasound images of the deformed tissue: scatterers that move with it, boundaries, needles, seeds and calcifications, seen by a beam whose width and thickness
   depend on depth. docs/training/ultrasound.md explains the model and names what it leaves out. */
#ifndef TROCAR_ECHO_H
#define TROCAR_ECHO_H

#include "view/ultrasound/reflectors.h"

#define ECHO_DENSITY 24e9    /* scatterers per m^3, about ten in each resolution cell, so that the speckle is fully developed */
#define ECHO_FLOOR (-60.0)   /* dB, brightness of level 1 */
#define ECHO_STEP 0.4        /* dB between two levels */
#define ECHO_WHITE 32.0      /* dB, brightness that is shown white with a gain of 0 */

typedef struct echo echo;

/* Creates the data that images of this scene need. `density`: scatterers per m^3. `scene` and `model` must outlive it. Returns BAD_INPUT for an
   invalid calcification, or NO_MEMORY. */
trocar_status echo_create(const trocar_scene *scene, const trocar_model *model, const beam *transducer, double density, echo **created, trocar_error *why);
void echo_free(echo *e);

/* Sets the field that images cover, and their pixels. Returns NO_MEMORY if memory is short. */
trocar_status echo_frame(echo *e, const image_field *field, const image_raster *raster, trocar_error *why);

/* Computes an image. `nodes` [nodes][3]: positions of the mesh's nodes, m. `levels` [height][width]: brightness relative to the prostate's mean at rest, as 1 +
   (dB - ECHO_FLOOR) / ECHO_STEP; 0 outside the field. */
void echo_image(echo *e, const image_plane *plane, const double *nodes, const echo_body *bodies, int body_count, unsigned char *levels);

/* Converts levels to grey: `range` dB from black to white; with a `gain` (dB) of 0, the prostate's mean is a little below the middle. In place. */
void echo_show(unsigned char *levels, size_t count, double gain, double range);

/* The envelope from which the last image was made, relative to its root mean square in the prostate at rest. `values`: [rows][lines] */
typedef struct {
    int rows, lines;
    double step, first_row;  /* m, distance between rows; distance of the first row from the origin */
    double spacing, first_line; /* distance between lines, and position of the first line: rad in a sector, otherwise m */
    const float *values;
} echo_envelope;
echo_envelope echo_last(const echo *e);

#endif

/* The reflectors: boundaries between volumes, needles, seeds and calcifications. Each adds an echo and changes the sound behind it. */
#ifndef TROCAR_REFLECTORS_H
#define TROCAR_REFLECTORS_H

#include "view/ultrasound/acoustics.h"
#include "view/ultrasound/grid.h"

/* A face between two volumes, or on the outside. */
typedef struct {
    int32_t nodes[3];        /* counter-clockwise as seen from the volume `out` */
    int8_t in, out;          /* volumes on either side; -1 for none */
    int8_t bone;             /* 1 if it is on the surface of a bone that the mesh does not contain */
} boundary;

/* A calcification: a ball that moves with the tissue. */
typedef struct {
    int32_t nodes[4];
    double weights[4], radius; /* m */
} stone;

typedef struct {
    acoustics volumes[32];
    boundary *boundaries;
    int boundary_count;
    stone *stones;
    int stone_count;
} reflectors;

/* A bent cylinder, such as a needle or a seed. */
typedef struct {
    const double *points;    /* [count][3], m, along its axis */
    int count;
    double radius;           /* m */
    const acoustics *is;
} echo_body;

/* Finds the boundaries and calcifications of a scene. Returns BAD_INPUT if a calcification is invalid, or NO_MEMORY. */
trocar_status reflectors_create(reflectors *r, const trocar_scene *scene, const trocar_model *model, trocar_error *why);
void reflectors_free(reflectors *r);

/* Adds the boundaries and calcifications. `nodes` are the mesh's nodes; `frequency` is in Hz. */
void reflectors_add(const reflectors *r, const image_point *nodes, double frequency, echo_grid *g);

void reflectors_add_body(const image_plane *plane, const echo_body *body, echo_grid *g);

/* Returns the fraction of the sound's amplitude that is left after travelling `length` (m) and back in a material with this attenuation, dB/(cm MHz). */
double sound_left(double attenuation, double frequency, double length);

#endif

/* The two images that clients get: ultrasound (view/ultrasound/echo.h), or the number of the volume at each pixel. They are drawn in a thread of their own, so
   that they do not delay the needles' poses. */
#ifndef TROCAR_SLICES_H
#define TROCAR_SLICES_H

#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>

#include "base/triple_buffer.h"
#include "ras.h"
#include "view/ultrasound/bodies.h"
#include "view/ultrasound/echo.h"
#include "view/ultrasound/planes.h"

typedef enum {
    SLICES_ECHO,             /* ultrasound */
    SLICES_REGIONS,          /* each pixel is the number of its volume in the scene's list of regions, counted from 1; 0 where there is no tissue */
    SLICES_NONE
} slice_style;

typedef struct {
    slice_style style;
    double pixel;            /* m */
    double gain, range;      /* dB, gain and range of the grey levels: see echo_show */
    double depth;            /* m, imaging depth from the transducer's face; 0: deep enough to cover the gland */
} slice_settings;

typedef struct {
    image_plane plane;
    image_raster raster;
    echo *echo;              /* NULL except for SLICES_ECHO */
    size_t first;            /* index of the image's first pixel among the pixels of all images; pixels are stored row by row */
} slice;

/* Drawn images. */
typedef struct {
    int64_t utime;           /* us, the `utime` that was passed to slices_tell */
    image_plane planes[SLICES];
    unsigned char grey[];    /* pixels of all images */
} drawn_slices;

typedef struct {
    slice_settings settings;
    const trocar_model *model;
    const double *nodes;     /* m, positions of the model's nodes at rest, 3 coordinates each */
    double *distance;        /* m, scratch memory for the distance of each node from the plane */
    image_planner planner;
    unsigned char number[32]; /* number of each volume in the scene's list of regions, starting from 1 */
    slice all[SLICES];
    pthread_t thread;
    bool started;
    triple_buffer told, drawn; /* told: inputs of the thread (slices.c); drawn: drawn_slices */
    int news, ready;         /* eventfds that signal new input, and new images; -1 without images */
    atomic_bool stop;
} slices;

/* Creates both images and starts the thread. `s` must not be moved in memory. BAD_INPUT if an image would be more than 2048 pixels wide or high; NO_MEMORY;
   SYSTEM. */
trocar_status slices_create(slices *s, const trocar_scene *scene, const trocar_model *model, const slice_settings *settings, trocar_error *why);
void slices_free(slices *s);

/* Passes the current positions of the mesh's nodes (m), needles and seeds to the thread. `probe` is the pose of the probe's base; if it is NULL, because the
   scene has no probe or the probe has no pose yet, the images are placed in planes through the first needle's tip that are parallel to the mesh's coordinate
   planes. Does not wait; if several calls are made while an image is being drawn, only the last one is used. */
void slices_tell(slices *s, int64_t utime, const double *nodes, const pose *probe, const body_list *bodies);

/* Returns a descriptor that is readable when there are new images; -1 without images. */
int slices_descriptor(const slices *s);

/* Returns new images, which are valid until the next call; NULL if there are none. */
const drawn_slices *slices_take(slices *s);

/* Returns the matrix of a drawn image that igtl_set_image expects: from IJK to RAS coordinates. */
ras_matrix slice_matrix(const slices *s, const drawn_slices *drawn, slice_kind kind, const patient_frame *frame);

#endif

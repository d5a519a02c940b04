/* The two images that clients get. They show either ultrasound (view/ultrasound/echo.h) or the number of the volume at each pixel. A separate thread draws
   them, so that they do not delay the needles' poses. */
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
    SLICES_REGIONS,          /* each pixel is the number of its volume in the scene's list of regions, counted from 1, or 0 outside the tissue */
    SLICES_NONE
} slice_style;

typedef struct {
    slice_style style;
    double pixel;            /* m */
    double gain, range;      /* dB, gain and dynamic range of the grey levels: see echo_show */
    double depth;            /* m, imaging depth from the transducer face; 0: deep enough for the gland */
} slice_settings;

typedef struct {
    image_plane plane;
    image_raster raster;
    echo *echo;              /* NULL except for SLICES_ECHO */
    size_t first;            /* index of the image's first pixel in drawn_slices.grey, where pixels are stored row by row */
} slice;

/* Drawn images. */
typedef struct {
    int64_t utime;           /* us, as passed to slices_tell */
    image_plane planes[SLICES];
    unsigned char grey[];    /* pixels of all images */
} drawn_slices;

typedef struct {
    slice_settings settings;
    const trocar_model *model;
    const double *nodes;     /* m, rest positions of the mesh nodes, 3 coordinates each */
    double *distance;        /* m, scratch memory for each node's distance from the plane */
    image_planner planner;
    unsigned char number[32]; /* each volume's number in the scene's list of regions, counted from 1 */
    slice all[SLICES];
    pthread_t thread;
    bool started;
    triple_buffer told, drawn; /* told: input to the thread (see slices.c); drawn: drawn_slices */
    int news, ready;         /* eventfds that signal new input, and new images; -1 without images */
    atomic_bool stop;
} slices;

/* Sets up both images and starts the thread. Do not move `s` in memory afterwards. BAD_INPUT if an image would be more than 2048 pixels wide or high;
   NO_MEMORY; SYSTEM. */
trocar_status slices_create(slices *s, const trocar_scene *scene, const trocar_model *model, const slice_settings *settings, trocar_error *why);
void slices_free(slices *s);

/* Passes the current positions of mesh nodes (m), needles and seeds to the drawing thread. probe: pose of the probe's base, or NULL if there is no probe or it
   has no pose yet; the images then lie in planes through the first needle's tip, parallel to the coordinate planes of the mesh. Does not block: of several
   calls made while an image is being drawn, only the last one has an effect. */
void slices_tell(slices *s, int64_t utime, const double *nodes, const pose *probe, const body_list *bodies);

/* Returns a descriptor that becomes readable when there are new images, or -1 if there are no images. */
int slices_descriptor(const slices *s);

/* Returns the new images, valid until the next call, or NULL if there are none. */
const drawn_slices *slices_take(slices *s);

/* Returns an image's transform from IJK to RAS coordinates, as igtl_set_image expects it. */
ras_matrix slice_matrix(const slices *s, const drawn_slices *drawn, slice_kind kind, const patient_frame *frame);

#endif

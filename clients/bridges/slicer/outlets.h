/* The OpenIGTLink messages sent to clients, built from the newest messages of trocar-server. */
#ifndef TROCAR_OUTLETS_H
#define TROCAR_OUTLETS_H

#include "igtl.h"
#include "organs.h"
#include "slices.h"
#include "view/stream/subscriber.h"

typedef struct {
    const trocar_model *model;
    patient_frame frame;     /* converts between mesh and RAS coordinates */
    bool registered;         /* true if the scene is registered to a patient */
    igtl_message *messages;
    int count, light_count;  /* number of messages, and how many of the first ones are small */
    int needles;             /* index of the first needle's four messages (base, tip, force, shape); those of the other needles follow */
    int probe;               /* index of the first of the probe's two messages (pose and force); -1 if the scene has no probe */
    int images;              /* index of the first of the two images; -1 if there are none */
    organ *organs;
    int organ_count;
    slices slices;
    body_list bodies;        /* needles and seeds */
    double needle_radius;    /* m */
    double *nodes;           /* m, current positions of the mesh nodes, 3 coordinates each */
} outlets;

/* Creates the messages. BAD_INPUT for the same reasons as slices_create; NO_MEMORY. */
trocar_status outlets_create(outlets *o, const trocar_scene *scene, const trocar_model *model, const slice_settings *images, trocar_error *why);
void outlets_free(outlets *o);

/* Updates needles and organs from the newest deformation (or shows the tissue at rest if there is none yet), and requests new images. */
void outlets_show_picture(outlets *o, const subscriber *feed);

/* Updates the images if new ones are ready. */
void outlets_show_images(outlets *o);

/* Updates what changes more often than deformations arrive: the forces and the probe. */
void outlets_show_forces(outlets *o, const subscriber *feed);

/* Updates the status, a JSON text. */
void outlets_show_status(outlets *o, subscriber *feed);

#endif

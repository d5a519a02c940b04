/* The messages for clients: their names, and their values from the server's newest messages. */
#ifndef TROCAR_OUTLETS_H
#define TROCAR_OUTLETS_H

#include "igtl.h"
#include "organs.h"
#include "slices.h"
#include "view/stream/subscriber.h"

typedef struct {
    const trocar_model *model;
    patient_frame frame;     /* RAS */
    bool registered;         /* to a patient */
    igtl_message *messages;
    int count, light_count;  /* the first light_count are small */
    int needles;             /* index of the first needle's four messages: base, tip, force and shape; the others' follow */
    int probe;               /* of the probe's two: place and force; -1: the scene has none */
    int images;              /* of the two images, -1: none */
    organ *organs;
    int organ_count;
    slices slices;
    double *nodes;           /* 3 each, m: present positions of the mesh's nodes */
} outlets;

/* `pixel` in m. BAD_INPUT as in slices_create, NO_MEMORY. */
trocar_status outlets_create(outlets *o, const trocar_scene *scene, const trocar_model *model, slice_style style, double pixel, report *why);
void outlets_free(outlets *o);

/* Updates needles, organs and images from the newest deformation; at rest before the first. */
void outlets_show_picture(outlets *o, const subscriber *feed);

/* Updates what changes faster than pictures: forces, and the probe. */
void outlets_show_forces(outlets *o, const subscriber *feed);

/* Updates the status, as JSON. */
void outlets_show_status(outlets *o, subscriber *feed);

#endif

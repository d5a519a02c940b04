/* Messages for viewers: each needle's state and contacts, and the displacement of every node. */
#ifndef TROCAR_VIEWER_MESSAGES_H
#define TROCAR_VIEWER_MESSAGES_H

#include "base/error.h"
#include "trocar.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"
#include "trocar_seeds_t.h"
#include "trocar_tracks_t.h"

enum { VIEWER_CONTACTS = TROCAR_MAX_POINTS }; /* maximum number of contacts per needle, including the tip */

typedef struct {
    int node_count;
    trocar_picture *picture;       /* the caller fills this before making messages */
    double *nodal;                 /* m, displacements: 3 values per node */
    float *displacement;           /* the same in single precision, as sent */
    float **displacement_rows;     /* the rows of `displacement`, one per node, as LCM wants them */
    double joints[TROCAR_MAX_JOINTS][3], positions[VIEWER_CONTACTS][3], forces[VIEWER_CONTACTS][3];
    double *joint_rows[TROCAR_MAX_JOINTS], *position_rows[VIEWER_CONTACTS], *force_rows[VIEWER_CONTACTS];
    double arc[VIEWER_CONTACTS];
    int8_t sliding[VIEWER_CONTACTS], kind[VIEWER_CONTACTS];
    float track_points[TROCAR_MAX_TRACK_POINTS][3], *track_rows[TROCAR_MAX_TRACK_POINTS];
    int32_t track_tets[TROCAR_MAX_TRACK_POINTS];
    int16_t track_numbers[TROCAR_MAX_TRACK_POINTS];
    int8_t track_membranes[TROCAR_MAX_TRACK_POINTS];
    trocar_track_point track_scratch[TROCAR_MAX_TRACK_POINTS];
    float seed_vectors[4][TROCAR_MAX_SEEDS][3]; /* the seeds' positions and directions, displaced and at rest */
    float *seed_rows[4][TROCAR_MAX_SEEDS];      /* the rows of `seed_vectors`, as LCM wants them */
    int16_t seed_numbers[4][TROCAR_MAX_SEEDS];  /* needle, guide, hole and strand of each seed */
    int16_t seeds_pending[TROCAR_MAX_NEEDLES];
    trocar_seed seed_scratch[TROCAR_MAX_SEEDS];
    trocar_model *model;
    trocar_seeds_t seeds;
    trocar_tracks_t tracks;        /* each message is valid until it is made again; the sender fills in utime and server */
    trocar_contacts_t contacts;
    trocar_deformation_t deformation;
} viewer_messages;

/* `model` must outlive the viewer_messages. NO_MEMORY. */
trocar_status viewer_messages_create(viewer_messages *v, trocar_model *model, trocar_error *why);
void viewer_messages_free(viewer_messages *v);

/* Make the `contacts` and `tracks` messages for one needle, and the `deformation` message for the tissue, from the picture. Not for the haptic thread.
   NO_MEMORY. */
void viewer_messages_make_needle(viewer_messages *v, int needle, int64_t tick, int64_t pose_utime);
void viewer_messages_make_tracks(viewer_messages *v, int needle, int64_t tick);
trocar_status viewer_messages_make_tissue(viewer_messages *v, int64_t tick, trocar_error *why);

/* Makes the `seeds` message, with the seeds displaced as in the last `deformation`. */
void viewer_messages_make_seeds(viewer_messages *v, int64_t tick);

#endif

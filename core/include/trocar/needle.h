/* A needle's contacts and tracks, as returned by the functions in trocar/view.h. Included by trocar.h. */
#ifndef TROCAR_PUBLIC_NEEDLE_H
#define TROCAR_PUBLIC_NEEDLE_H

#include "trocar/sim.h"

/* ---- contacts ---- */

enum { TROCAR_MAX_CONTACTS = 64, TROCAR_MAX_JOINTS = 65 };
enum { TROCAR_MAX_POINTS = 2 * TROCAR_MAX_GUIDES + TROCAR_MAX_CONTACTS + 1 }; /* most contacts, of all kinds, that can be active at once */

typedef enum trocar_contact_kind {
    TROCAR_CONTACT_TISSUE = 0,
    TROCAR_CONTACT_TIP = 1,
    TROCAR_CONTACT_GUIDE = 2 /* at the edge of a guide hole, on one of the plate's faces */
} trocar_contact_kind;

/* Status of a contact. A tissue contact is first planned, then adding, then sticking or sliding until it is removed. */
typedef enum trocar_contact_status {
    TROCAR_CONTACT_PLANNED = 0,  /* ahead of the tip; bears no force */
    TROCAR_CONTACT_ADDING = 1,   /* passed by the tip, waiting for the worker's answer; bears no force */
    TROCAR_CONTACT_STICKING = 2,
    TROCAR_CONTACT_SLIDING = 3,  /* the direction is in trocar_contact.state */
    TROCAR_CONTACT_DETACHED = 4  /* no longer used: a buckling needle stays in contact */
} trocar_contact_status;

/* A point where the needle touches the tissue or a guide. */
typedef struct trocar_contact {
    int32_t kind;            /* trocar_contact_kind; more kinds may be added in future versions */
    int32_t state;           /* 0 sticks, 1 slides forward, -1 slides backward */
    double arc;              /* m, arc length from the base to the point where the force acts; for the tip contact, at the needle's end or just behind it */
    double depth;            /* m along the track, measured from the skin; 0 for a guide */
    double position[3];      /* m, on the deformed needle, world frame */
    double force[3];         /* N, on the tissue or guide, world frame */
    uint64_t id;             /* tissue contact: stays the same until the contact is removed, and is never reused for this needle; other contacts: 0 */
    int32_t status;          /* trocar_contact_status */
    int32_t slot;            /* tissue contact: 0 to TROCAR_MAX_CONTACTS - 1, like `id` but reused after removal; guide: index of the guide; tip: -1 */
} trocar_contact;

/* Return values of trocar_view_hole for a needle that is in no hole. */
enum {
    TROCAR_NO_HOLE = -1,     /* the needle is not at the guide, or passes beside its plate */
    TROCAR_MISSED_HOLE = -2  /* the needle passes through the plate outside its holes (TROCAR_EVENT_MISSED_GUIDE) */
};

/* ---- tracks ---- */

enum { TROCAR_MAX_TRACKS = 128, TROCAR_MAX_TRACK_POINTS = 1024 }; /* limits per needle; enough for 4 m of tracks */

/* A point on a track: a path that a needle has cut since its last reset. Tissue stays cut, so any needle meets less resistance along a track. */
typedef struct trocar_track_point {
    double position[3];      /* m, in the tissue at rest */
    int32_t tet;             /* tetrahedron of the model's mesh that contains the point */
    int32_t track;           /* number of the track; 0 is the oldest. The points of a track run from skin to tip, at most 4 mm apart */
    int32_t membrane;        /* index in the scene of the membrane punctured at this point; -1 if none */
    int32_t reserved;        /* 0 */
} trocar_track_point;

#endif

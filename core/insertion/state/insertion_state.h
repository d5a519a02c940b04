/* All that changes during an insertion: contacts along the shaft, the tip, the layers along its track. Plain data. */
#ifndef TROCAR_INSERTION_STATE_H
#define TROCAR_INSERTION_STATE_H

#include "insertion/state/tissue_memory.h"
#include "insertion/state/track_list.h"
#include "linalg/plane_tensor.h"
#include "needle/needle.h"

enum { NOT_BLOCKED = -1, BLOCKED_BY_BONE = -2 };

typedef enum { TIP_FREE, TIP_INSIDE, TIP_BEYOND } tip_phase; /* beyond: out on the far side or in a gap, shaft still in the tissue */

/* Planned: its node is asked for, the tip is not there yet. Waiting: the tip has left it, its row of the inverse has not come. Active: it
   takes part in the solve, and `friction` says whether it sticks. They are in this order along the track, active ones first. */
typedef enum { CONTACT_PLANNED, CONTACT_WAITING, CONTACT_ACTIVE } contact_status;

/* How the shaft turns about its axis in the tissue. */
typedef struct {
    double anchor;           /* rad, turn of the shaft at which the tissue around it is at rest; NAN: as it comes to be in the solve */
    double turned;           /* rad, by which the shaft slid round in the last step */
    double torque;           /* N m, on the tissue about the needle's axis */
    friction_state friction;
} roll_friction;

/* How the tissue along a share of the track holds the shaft. When the tip leaves a contact, or comes back to it, this is handed over as it is. */
typedef struct {
    double origin;           /* m: arc, less depth, of the shaft's material point that would be at the track if the tissue were not sheared along the
                                shaft. Near the tip that point may lie beyond the needle's end. */
    double slip;             /* m, by which the shaft slid forward past the tissue in the last solve; applied by the next tick */
    double slid;             /* m of sliding since it last stuck */
    friction_state friction;
    double traction;         /* N/m, force along the needle over the length of the share */
    double softness;         /* m^2/N, mean over the share of a line's local compliance per logarithm, along the needle; 0: not known yet */
    double stiffening;       /* mean over the share, of the regions' */
    roll_friction roll;
} shaft_hold;

static const double FULL_GRIP = 0.05; /* N: force along the needle at which the surface holds the tip sideways in full; a tip that touches begins with it, as one
                                         that the surface does not hold yet would slip aside at once if the needle is bent. Chosen: about the smallest force that
                                         a hand feels */

/* One contact: a node of the tissue that the shaft passes. */
typedef struct {
    contact_status status;
    vec3 track;              /* m, world frame: where the tip left it; its node, kept off faces, may lie a little beside it */
    vec3 beside;             /* m, by how much that is outside an outer face: as in tip_place */
    vec3 direction;          /* unit vector of the track there, in the undeformed tissue */
    double depth;            /* m along the nominal track from the skin */
    shaft_hold shaft;
    resolved_field resolved; /* what the mesh resolves there; its `point` belongs to the tip that was there */
    double log_axial;        /* logarithm of the radius that the mesh resolves over the needle's, for forces along it; 0: not known yet */
    plane_tensor log_lateral; /* the same across the track, for an endless needle */
    vec3 force;              /* N, world frame, on the tissue */
} shaft_contact;

/* An old track that leads the tip. */
typedef struct {
    double openness;         /* 0 to 1: how open it is to the tip; 0: there is none, and the rest is unused */
    vec3 direction;          /* unit nominal direction in which it leads */
    double to_end;           /* m from the tip to its end */
    vec3 tilt;               /* how the tip's direction in it differs from that in which it would cut */
} open_track;

/* Where the tip is. Written by the path stage. */
typedef struct {
    tip_phase phase;
    int tet;                 /* nominal element, -1 outside */
    vec3 nominal;            /* m, the tissue's material point at the tip */
    vec3 direction;          /* unit vector of the track at the tip, in the undeformed tissue */
    double depth;            /* m along the nominal track from the skin */
    vec3 graze_normal;       /* unit normal of the outer face along which the tip grazes; zero: it does not */
    vec3 beside;             /* m, from `nominal`, just inside that face, to the tip itself, which may be out by a radius */
    vec3 end;                /* m, world frame: where the needle's end was when the tip was last beyond; `nominal` is where it left */
} tip_place;

/* What blocks the tip where it is. Written by the path stage. */
typedef struct {
    int blocked_by;          /* membrane in front of the tip, NOT_BLOCKED or BLOCKED_BY_BONE */
    double membrane_damage;  /* 0 to 1: how far that membrane has been torn by a puncture beside the tip */
    int face;                /* of the tip's element: where the tip is on the surface or blocked */
    bool entering;           /* the tip is blocked at the outer surface and comes from outside */
} tip_barrier;

/* What the last solve found at the tip. Written by the passes; the next path stage applies the slip. */
typedef struct {
    double slip;             /* m, by which the tip went forward past the tissue (cutting) or back */
    friction_state friction; /* forward while it cuts */
    vec3 force;              /* N, world frame, on the tissue */
    double end_force;        /* N along the needle, the part of it on the end face */
    double arc;              /* m from the base, where its force acts: at the needle's end or behind it (along_track.h) */
} tip_solution;

/* How the tissue at the tip is displaced. Written by the solve. */
typedef struct {
    double size;             /* m along the track, by which it is displaced */
    double offset;           /* m along the track, by which it stays displaced after contacts have taken over force from the tip; fades within milliseconds */
    vec3 damping;            /* N, world frame, on the tissue, which springs back no faster than shear waves travel */
    vec3 rest;               /* m, world frame: where the tissue that the tip touches was without its force */
} tip_dent;

/* What the mesh resolves at the tip. Written by the tissue stage. */
typedef struct {
    bool known;              /* it has been measured */
    resolved_field field;
    vec3 at;                 /* m, nominal: where the tip was then */
} tip_resolution;

/* The last point under the tip that the snapshot covered. Written by the tissue stage. */
typedef struct {
    int tet;                 /* nominal element, -1: none yet */
    double weights[4];       /* its barycentric weights there */
} known_point;

/* The tip: a contact that moves through the tissue as it cuts, and back along its track. */
typedef struct {
    tip_place place;
    tip_barrier barrier;
    open_track track;        /* that it is led along: found by the path stage; by the solve, that on which the slip ended */
    double next_contact;     /* m of depth where the next contact node is due; NAN: to be planned. Written by the path stage */
    shaft_hold shaft;        /* of the shaft next to it, from half way to the last contact on: held by friction, not by what is ahead */
    tip_solution solved;
    tip_dent dent;
    double filtered_push;    /* N, force along the needle, low-pass filtered, that sets the lateral hold; >= 0. Written after the solve */
    tip_resolution resolution;
    known_point known;
} needle_tip;

/* m, nominal: where the tip is, which `nominal` stands for in the mesh. RT */
static inline vec3 tip_position(const tip_place *place) { return v3_add(place->nominal, place->beside); }

/* Direction in which `nominal` moves while the tip moves along `direction`: not out of the face that it grazes. RT */
static inline vec3 tip_way(const tip_place *place, vec3 direction) { return v3_axpy(-v3_dot(direction, place->graze_normal), place->graze_normal, direction); }

/* N, total force on the tissue at the tip: the needle's, and the damper's while the tissue springs back. RT */
static inline vec3 tip_load(const needle_tip *tip) { return v3_add(tip->solved.force, tip->dent.damping); }

/* A tip in the air. RT */
static inline needle_tip tip_in_air(void) {
    return (needle_tip){.place = {.phase = TIP_FREE, .tet = -1}, .known.tet = -1, .barrier.blocked_by = NOT_BLOCKED, .next_contact = NAN};
}

/* From this depth on, up to the next stratum, the track lies in this region, or in a gap between bodies. */
enum { IN_A_GAP = -1 };
typedef struct {
    double depth;            /* m */
    int region;              /* group index, or IN_A_GAP */
    int tet;                 /* element that the track starts in there; of a gap, the one that it left */
    vec3 point;              /* m, nominal: where it starts */
} stratum;

/* Where the needle is with respect to a guide. */
typedef enum { GUIDE_AHEAD, GUIDE_IN_HOLE, GUIDE_MISSED, GUIDE_BESIDE } guide_passage;

/* The needle at the edge of a hole, on one face of the plate. */
typedef struct {
    double arc;              /* m from the base: the needle's material point that friction holds there */
    double slip;             /* m, as in shaft_hold */
    friction_state friction;
    bool touching;           /* the edge */
    vec3 force;              /* N, world frame, on the guide */
} guide_contact;

typedef struct {
    guide_passage passage;
    int hole;                /* column + columns * row, while in it */
    double depth;            /* m, how far the tip is behind the front face, while in a hole; at most the thickness */
    guide_contact faces[GUIDE_FACES]; /* front, and back or where the tip is on its way there */
} guide_state;

enum { MAX_STRATA = 256 };  /* layers of 0.8 mm on a track of 200 mm */

/* All that changes. After each tick it is an equilibrium: shape, contacts and forces belong together. A plain copy saves
   and restores it. */
typedef struct {
    vec3 base_shift;             /* m, by which the spring that holds the base has yielded */
    needle_state needle;
    needle_motion motion;        /* of the last step, if it ended in equilibrium */
    double base_turn;            /* rad, of the base about the needle's axis, all turns counted */
    double tip_lead;             /* rad, of the tip's roll before the base's; negative: it lags */
    needle_tip tip;
    vec3 entry;                  /* m, nominal point where the track starts */
    stratum strata[MAX_STRATA];  /* regions along the track, from the skin to the tip */
    int stratum_count;
    refinement refined;          /* the contact nodes; in order, from base to tip */
    shaft_contact contacts[MAX_CONTACTS]; /* by the slot of their node */
    guide_state guides[MAX_GUIDES];
    int watched;                 /* segment of the needle looked at last: is it in a body from the side? */
    uint64_t outside;            /* bits of the segments that were */
    bool moving_on;              /* no stable equilibrium is near: the needle moves on to another one, against its drag */
    vec3 surface;                /* m, displacement of the surface at a free needle's end, as last known; NAN: not yet */
    tissue_memory memory;        /* of tissue that relaxes */
    track_list tracks;           /* that this needle has cut since the reset */
    uint64_t next_id;
    remesh_request request;      /* what the tick wants next; serial grows with each change */
} insertion_state;

/* Is contact number k from the base active? RT */
static inline bool contact_is_active(const insertion_state *state, int k) {
    return k < state->refined.count && state->contacts[state->refined.order[k]].status == CONTACT_ACTIVE;
}

/* How many are. RT */
static inline int contacts_active(const insertion_state *state) {
    int count = 0;
    while (contact_is_active(state, count)) count++;
    return count;
}

/* m from the base, where the tissue at this depth holds the shaft: on the needle. RT */
static inline double shaft_arc(const shaft_hold *shaft, double depth, double needle_length) {
    return smaller_of(larger_of(shaft->origin + depth, 0.0), needle_length);
}

/* m from the base, where the shaft bears the force of a contact. RT */
static inline double contact_arc(const shaft_contact *contact, double needle_length) { return shaft_arc(&contact->shaft, contact->depth, needle_length); }

/* The slot of a planned contact, the last in order, or -1. RT */
static inline int contact_planned(const insertion_state *state) {
    int last = state->refined.count > 0 ? state->refined.order[state->refined.count - 1] : -1;
    return last >= 0 && state->contacts[last].status == CONTACT_PLANNED ? last : -1;
}

/* Contact nodes that the tip has passed: all but a planned one. RT */
static inline int contacts_passed(const insertion_state *state) { return state->refined.count - (contact_planned(state) >= 0); }

/* The shaft next to the tip has moved by `shift` (m) against the tissue, and with it that at contacts that have no row yet. RT */
static inline void shift_tip_shaft(insertion_state *state, double shift) {
    state->tip.shaft.origin += shift;
    for (int k = contacts_active(state); k < contacts_passed(state); k++) state->contacts[state->refined.order[k]].shaft.origin += shift;
}

/* The last of them, or NULL. RT */
static inline const shaft_contact *last_contact(const insertion_state *state) {
    int passed = contacts_passed(state);
    return passed > 0 ? &state->contacts[state->refined.order[passed - 1]] : NULL;
}

#endif

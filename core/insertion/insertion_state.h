/* All that changes during an insertion: contacts along the shaft, the tip, the layers along its track. Plain data. */
#ifndef TROCAR_INSERTION_STATE_H
#define TROCAR_INSERTION_STATE_H

#include "insertion/plane_tensor.h"
#include "insertion/tissue_memory.h"
#include "insertion/track_list.h"
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

/* One contact: a node of the tissue that the shaft passes. */
typedef struct {
    contact_status status;
    double arc;              /* m from the base: the needle's material point that is there */
    vec3 track;              /* m, world frame: where the tip left it; its node, kept off faces, may lie a little beside it */
    vec3 beside;             /* m, by how much that is outside an outer face: as in needle_tip */
    vec3 direction;          /* unit vector of the track there, in the undeformed tissue */
    double depth;            /* m along the nominal track from the skin */
    double slip;             /* m, by which the shaft slid forward past it in the last solve; applied by the next tick */
    double slid;             /* m of sliding since it last stuck */
    friction_state friction;
    double log_axial;        /* logarithm of the radius that the mesh resolves over the needle's, for forces along it; 0: not known yet */
    plane_tensor log_lateral; /* the same across the track, for an endless needle */
    line_end end;            /* what to add to that near the needle's tip */
    double softness;         /* m^2/N, mean over its share of a line's local compliance per logarithm, along the needle; 0: not known yet */
    double stiffening;       /* mean over its share, of the regions' */
    double traction;         /* N/m, force along the needle over the length of its share */
    vec3 force;              /* N, world frame, on the tissue */
    roll_friction roll;
} shaft_contact;

/* The tip: a contact that moves through the tissue as it cuts, and back along its track. */
typedef struct {
    tip_phase phase;
    int tet;                 /* nominal element, -1 outside */
    vec3 nominal;            /* m, the tissue's material point at the tip */
    vec3 direction;          /* unit vector of the track at the tip, in the undeformed tissue */
    double depth;            /* m along the nominal track from the skin */
    double slip;             /* m, as in shaft_contact: cutting forward or drawing back */
    friction_state friction; /* forward while it cuts */
    double shaft_slip;       /* m, slip of the shaft next to it, from half way to the last contact on: held by friction, not by what is ahead */
    double shaft_slid;       /* m, and friction: as in shaft_contact */
    friction_state shaft_friction;
    double shaft_softness, shaft_stiffening, shaft_traction; /* of that shaft: as in shaft_contact */
    roll_friction roll;      /* of that shaft */
    double stretch;          /* m, how much farther than the tip that shaft is ahead of the tissue that it sticks to */
    vec3 force;              /* N, world frame, on the tissue */
    double end_force;        /* N along the needle, the part of it on the end face */
    double dent;             /* m along the track, by which the tissue at the tip is displaced */
    vec3 damping;            /* N, world frame, on the tissue at the tip, which springs back no faster than shear waves travel */
    double pressing;         /* N, force along the needle, low-pass filtered, that sets the lateral hold; >= 0 */
    bool springs;            /* tissue along an open track clearly sprang back over the tip in the last step */
    double open;             /* 0 to 1: how far an old track is open ahead of the tip; */
    vec3 open_way;           /* unit nominal direction in which it leads, */
    double open_left;        /* m to its end, */
    vec3 open_tilt;          /* and how the tip's way differs from that in which it would cut */
    int blocked_by;          /* membrane in front of the tip, NOT_BLOCKED or BLOCKED_BY_BONE */
    double torn;             /* 0 to 1: how far that membrane has been torn by a puncture beside the tip */
    int face;                /* of `tet`: where the tip is on the surface or blocked */
    double ended;            /* m: tracks that end this close ahead count as ended, as the tip would pass their ends in one step */
    bool entering;           /* the tip is blocked at the outer surface and comes from outside */
    vec3 outward;            /* unit normal of the outer face along which the tip grazes; zero: it does not */
    vec3 beside;             /* m, from `nominal`, just inside that face, to the tip itself, which may be out by a radius */
    vec3 end;                /* m, world frame: where the needle's end was when the tip was last beyond; `nominal` is where it left */
    double next_contact;     /* m of depth where the next contact node is due; NAN: to be planned */
    bool resolved_known;     /* what the mesh resolves at the tip: */
    resolved_field resolved;
    vec3 resolved_at;        /* m, nominal: where the tip was then */
    int known_tet;           /* nominal element of the last point that the snapshot covered, -1: none yet */
    double known_weights[4]; /* and that point's barycentric weights */
} needle_tip;

/* m, nominal: where the tip is, which `nominal` stands for in the mesh. RT */
static inline vec3 tip_place(const needle_tip *tip) { return v3_add(tip->nominal, tip->beside); }

/* Direction in which `nominal` moves while the tip moves along `direction`: not out of the face that it grazes. RT */
static inline vec3 tip_way(const needle_tip *tip, vec3 direction) { return v3_axpy(-v3_dot(direction, tip->outward), tip->outward, direction); }

/* N, total force on the tissue at the tip: the needle's, and the damper's while the tissue springs back. RT */
static inline vec3 tip_load(const needle_tip *tip) { return v3_add(tip->force, tip->damping); }

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
    double slip;             /* m, as in shaft_contact */
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
    bool saddle;                 /* the last tick ended, perhaps without convergence, where needle and tissue are not stable */
    bool buckled;                /* no equilibrium was found; straight and without force until its tip is back */
    vec3 stuck_at;               /* m, world frame: where the needle's end was then */
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

/* The slot of a planned contact, the last in order, or -1. RT */
static inline int contact_planned(const insertion_state *state) {
    int last = state->refined.count > 0 ? state->refined.order[state->refined.count - 1] : -1;
    return last >= 0 && state->contacts[last].status == CONTACT_PLANNED ? last : -1;
}

/* Contact nodes that the tip has passed: all but a planned one. RT */
static inline int contacts_passed(const insertion_state *state) { return state->refined.count - (contact_planned(state) >= 0); }

/* The last of them, or NULL. RT */
static inline const shaft_contact *last_contact(const insertion_state *state) {
    int passed = contacts_passed(state);
    return passed > 0 ? &state->contacts[state->refined.order[passed - 1]] : NULL;
}

#endif

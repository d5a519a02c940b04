/* The mutable state of an insertion: contacts along the shaft, the tip, and the strata along its track. Plain data. */
#ifndef TROCAR_INSERTION_STATE_H
#define TROCAR_INSERTION_STATE_H

#include "insertion/state/tissue_memory.h"
#include "insertion/state/track_list.h"
#include "linalg/plane_tensor.h"
#include "needle/needle.h"

enum { NOT_BLOCKED = -1, BLOCKED_BY_BONE = -2 };

typedef enum { TIP_FREE, TIP_INSIDE, TIP_BEYOND } tip_phase; /* TIP_BEYOND: the tip is outside, on the far side or in a gap, but the shaft is still in the
                                                                tissue */

/* Planned: the node has been requested, but the tip has not reached it. Waiting: the tip has passed the node, but its row of the inverse has not arrived.
   Active: the contact is part of the solve, and `friction` says whether it sticks. Active contacts come first along the track, then waiting ones, then a
   planned one. */
typedef enum { CONTACT_PLANNED, CONTACT_WAITING, CONTACT_ACTIVE } contact_status;

/* Rotation of the shaft about its axis, relative to the tissue. */
typedef struct {
    double anchor;           /* rad, roll of the shaft at which the surrounding tissue is unstrained; NAN until the solve sets it */
    double turned;           /* rad, rotational slip of the shaft in the last step */
    double torque;           /* N m, torque on the tissue about the needle's axis */
    friction_state friction;
} roll_friction;

/* Slip, friction and rotation of the shaft along a share of the track. When the tip leaves a contact or returns to it, this struct is handed over
   unchanged. */
typedef struct {
    double origin;           /* m: arc minus depth of the material point of the shaft that would be at the track if the tissue were not sheared along the
                                shaft. Near the tip, this point may be beyond the needle's end */
    double slip;             /* m, slip in the last solve, positive if the shaft moves forward relative to the tissue; applied by the next tick */
    double slid;             /* m, distance slid since the shaft last stuck */
    friction_state friction;
    double traction;         /* N/m, force along the needle per unit length of the share */
    double softness;         /* m^2/N, mean over the share of the material factor of the local compliance to an axial line force (local_line_stiffness); 0 if
                                not known yet */
    double stiffening;       /* stiffening coefficient of the tissue's regions, averaged over the share */
    roll_friction roll;
} shaft_hold;

static const double FULL_GRIP = 0.05; /* N: force along the needle at which the surface gives the tip its full lateral support. The tip starts with this
                                         force at first touch, because a bent needle without lateral support would slip aside at once. Chosen: about the
                                         smallest force that a hand feels */

/* One contact: a node of the tissue on the shaft's track. */
typedef struct {
    contact_status status;
    vec3 track;              /* m, nominal: position of the tip when it left the contact behind. The node, which is kept off faces, may be slightly beside
                                it */
    vec3 beside;             /* m, offset of the track from the node, outward across an outer face, as in tip_place */
    vec3 direction;          /* unit vector of the track at the contact, in the undeformed tissue */
    double depth;            /* m along the nominal track, measured from the skin */
    shaft_hold shaft;
    resolved_field resolved; /* resolution of the mesh at the contact; resolved.point is that of the tip at this position */
    double log_axial;        /* logarithm of the ratio of resolved radius to needle radius, for forces along the needle; 0 if not known yet */
    plane_tensor log_lateral; /* logarithm of the ratio of resolved radius to needle radius, for forces across the track of an infinitely long needle */
    vec3 force;              /* N, world frame, on the tissue */
} shaft_contact;

/* An old track that guides the tip. */
typedef struct {
    double openness;         /* 0 to 1: how open the track is to the tip; 0 means no track, and the other members are then unused */
    vec3 direction;          /* unit vector in the undeformed tissue: direction in which the track guides the tip */
    double to_end;           /* m from the tip to the end of the track */
    vec3 tilt;               /* tip's direction in the track minus its cutting direction */
} open_track;

/* Position of the tip; written by the path stage. */
typedef struct {
    tip_phase phase;
    int tet;                 /* nominal element; -1 outside the tissue */
    vec3 nominal;            /* m, material point of the tissue at the tip */
    vec3 direction;          /* unit vector of the track at the tip, in the undeformed tissue */
    double depth;            /* m along the nominal track, measured from the skin */
    vec3 graze_normal;       /* unit normal of the outer face that the tip grazes; zero if none */
    vec3 beside;             /* m, from `nominal` (just inside the grazed face) to the tip itself, which may be up to one radius outside */
    vec3 end;                /* m, world frame: previous position of the needle's end, used while the tip is beyond the tissue; `nominal` is then where the
                                tip left the tissue */
} tip_place;

/* Obstacle at the tip; written by the path stage. */
typedef struct {
    int blocked_by;          /* index of the membrane in front of the tip, or NOT_BLOCKED, or BLOCKED_BY_BONE */
    double membrane_damage;  /* 0 to 1: damage of that membrane by an earlier puncture near the tip */
    int face;                /* face of the tip's element, valid if the tip is on the surface or blocked */
    bool entering;           /* true if the tip is blocked at the outer surface and comes from outside */
} tip_barrier;

/* Solution at the tip; written by the passes. The next path stage applies the slip. */
typedef struct {
    double slip;             /* m, slip of the tip relative to the tissue: forward (cutting) if positive, back if negative */
    friction_state friction; /* forward while the tip cuts tissue */
    vec3 force;              /* N, world frame, on the tissue */
    double end_force;        /* N along the needle, the part of `force` on the end face */
    double arc;              /* m from the base to the point where the force acts, which is at the needle's end or behind it (along_track.h) */
} tip_solution;

/* Displacement of the tissue at the tip; written by the solve. */
typedef struct {
    double size;             /* m, displacement along the track */
    double offset;           /* m, displacement along the track that is kept when contacts have taken over force from the tip; fades within milliseconds */
    vec3 damping;            /* N, world frame, damper's force on the tissue, which limits the tissue's rebound to the speed of shear waves */
    vec3 rest;               /* m, world frame: where the tissue that the tip touches would be without the tip's force */
} tip_dent;

/* Resolution of the mesh at the tip; written by the tissue stage. */
typedef struct {
    bool known;              /* the resolution has been measured */
    resolved_field field;
    vec3 at;                 /* m, nominal position of the tip when the resolution was measured */
} tip_resolution;

/* The last point of the tip's track that the snapshot covered; written by the tissue stage. */
typedef struct {
    int tet;                 /* nominal element; -1: none yet */
    double weights[4];       /* barycentric weights of the point in that element */
} known_point;

/* The tip: a contact that moves forward through the tissue as it cuts, and back along its track. */
typedef struct {
    tip_place place;
    tip_barrier barrier;
    open_track track;        /* old track that guides the tip. The path stage finds it; after the solve, it is the track on which the tip's slip ended */
    double next_contact;     /* m, depth at which the next contact node is due; NAN if it has to be planned. Written by the path stage */
    shaft_hold shaft;        /* the shaft next to the tip, extending halfway to the last contact: it is held by friction, not by the resistance ahead of
                                the tip */
    tip_solution solved;
    tip_dent dent;
    double filtered_push;    /* N, >= 0, low-pass filtered force along the needle, which determines the lateral support. Written after the solve */
    tip_resolution resolution;
    known_point known;
} needle_tip;

/* Nominal position of the tip itself (m); in the mesh, `nominal` represents it. RT */
static inline vec3 tip_position(const tip_place *place) { return v3_add(place->nominal, place->beside); }

/* Direction in which `nominal` moves when the tip moves along `direction`: the component normal to the grazed face is removed. RT */
static inline vec3 tip_way(const tip_place *place, vec3 direction) { return v3_axpy(-v3_dot(direction, place->graze_normal), place->graze_normal, direction); }

/* Total force on the tissue at the tip (N): the needle's force plus the damper's force while the tissue springs back. RT */
static inline vec3 tip_load(const needle_tip *tip) { return v3_add(tip->solved.force, tip->dent.damping); }

/* Initial state of a tip outside the tissue. RT */
static inline needle_tip tip_in_air(void) {
    return (needle_tip){.place = {.phase = TIP_FREE, .tet = -1}, .known.tet = -1, .barrier.blocked_by = NOT_BLOCKED, .next_contact = NAN};
}

/* A stratum: from its depth to that of the next stratum, the track is in one region or in a gap between bodies. */
enum { IN_A_GAP = -1 };
typedef struct {
    double depth;            /* m */
    int region;              /* group index, or IN_A_GAP */
    int tet;                 /* element in which the stratum begins; for a gap, the element from which the track left the tissue */
    vec3 point;              /* m, nominal: point at which the stratum begins */
} stratum;

/* Position of the needle relative to a guide. */
typedef enum { GUIDE_AHEAD, GUIDE_IN_HOLE, GUIDE_MISSED, GUIDE_BESIDE } guide_passage;

/* Contact of the needle with the edge of a hole, on one face of the plate. */
typedef struct {
    double arc;              /* m from the base to the needle's material point that friction holds on the face */
    double slip;             /* m, defined as in shaft_hold */
    friction_state friction;
    bool touching;           /* true while the needle touches the edge */
    vec3 force;              /* N, world frame, on the guide */
} guide_contact;

typedef struct {
    guide_passage passage;
    int hole;                /* column + columns * row; valid while the needle is in the hole */
    double depth;            /* m, distance of the tip behind the front face while the needle is in a hole; at most the plate's thickness */
    guide_contact faces[GUIDE_FACES]; /* contacts on the front and back faces; until the tip reaches the back face, the second contact is at the tip */
} guide_state;

enum { MAX_STRATA = 256 };  /* number of strata; enough for layers of 0.8 mm on a 200 mm track */

/* The mutable state. After each tick it is an equilibrium: shape, contacts and forces are consistent. It can be saved and restored by a plain copy. */
typedef struct {
    vec3 base_shift;             /* m, deflection of the spring through which the hand holds the base; zero if the base is held rigidly */
    needle_state needle;
    needle_motion motion;        /* motion in the last step, if that step ended in equilibrium */
    double base_turn;            /* rad, total rotation of the base about the needle's axis, which may exceed a full turn */
    double tip_lead;             /* rad, roll of the tip minus that of the base; negative if the tip lags */
    needle_tip tip;
    vec3 entry;                  /* m, nominal point at which the track begins */
    stratum strata[MAX_STRATA];  /* regions along the track, from the skin to the tip */
    int stratum_count;
    refinement refined;          /* the contact nodes, ordered from base to tip */
    shaft_contact contacts[MAX_CONTACTS]; /* contacts, indexed by the slot of their node */
    guide_state guides[MAX_GUIDES];
    int watched;                 /* index of the segment that was last checked for having entered a body sideways */
    uint64_t outside;            /* bit mask of the segments that have entered a body sideways */
    bool moving_on;              /* true if no stable equilibrium is near, so that the needle moves to another one against its drag */
    vec3 surface;                /* m, last known displacement of the surface at the end of a needle outside the tissue; NAN if not known yet */
    tissue_memory memory;        /* memory of relaxing tissue */
    track_list tracks;           /* tracks that this needle has cut since its reset */
    uint64_t next_id;
    remesh_request request;      /* request for the worker; `serial` increases with each change */
} insertion_state;

/* True if contact number k, counted from the base, is active. RT */
static inline bool contact_is_active(const insertion_state *state, int k) {
    return k < state->refined.count && state->contacts[state->refined.order[k]].status == CONTACT_ACTIVE;
}

/* Number of active contacts. RT */
static inline int contacts_active(const insertion_state *state) {
    int count = 0;
    while (contact_is_active(state, count)) count++;
    return count;
}

/* Arc (m from the base) at which the tissue at this depth holds the shaft, limited to the needle's length. RT */
static inline double shaft_arc(const shaft_hold *shaft, double depth, double needle_length) {
    return smaller_of(larger_of(shaft->origin + depth, 0.0), needle_length);
}

/* Arc (m from the base) at which a contact's force acts on the shaft. RT */
static inline double contact_arc(const shaft_contact *contact, double needle_length) { return shaft_arc(&contact->shaft, contact->depth, needle_length); }

/* Slot of the planned contact, which is the last in order, or -1 if there is none. RT */
static inline int contact_planned(const insertion_state *state) {
    int last = state->refined.count > 0 ? state->refined.order[state->refined.count - 1] : -1;
    return last >= 0 && state->contacts[last].status == CONTACT_PLANNED ? last : -1;
}

/* Number of contact nodes that the tip has passed: all nodes except a planned one. RT */
static inline int contacts_passed(const insertion_state *state) { return state->refined.count - (contact_planned(state) >= 0); }

/* Shifts the shaft next to the tip relative to the tissue by `shift` (m), together with the shaft at contacts whose row of the inverse has not arrived yet.
   RT */
static inline void shift_tip_shaft(insertion_state *state, double shift) {
    state->tip.shaft.origin += shift;
    for (int k = contacts_active(state); k < contacts_passed(state); k++) state->contacts[state->refined.order[k]].shaft.origin += shift;
}

/* Returns the last contact that the tip has passed, or NULL. RT */
static inline const shaft_contact *last_contact(const insertion_state *state) {
    int passed = contacts_passed(state);
    return passed > 0 ? &state->contacts[state->refined.order[passed - 1]] : NULL;
}

#endif

/* The mutable state of an insertion: contacts along the shaft, the tip, and the strata along its track. Plain data. */
#ifndef TROCAR_INSERTION_STATE_H
#define TROCAR_INSERTION_STATE_H

#include "insertion/state/tissue_memory.h"
#include "insertion/state/track_list.h"
#include "linalg/plane_tensor.h"
#include "needle/needle.h"

enum { NOT_BLOCKED = -1, BLOCKED_BY_BONE = -2 };

typedef enum { TIP_FREE, TIP_INSIDE, TIP_BEYOND } tip_phase; /* TIP_BEYOND: the tip is outside, on the far side or in a gap, but part of the shaft is still in
                                                                the tissue */

/* Planned: the node has been requested, but the tip has not reached it yet. Waiting: the tip has passed the node, but its row of the inverse has not arrived.
   Active: the contact takes part in the solve, and `friction` says whether it sticks. Along the track, active contacts come first, then waiting ones, then a
   planned one. */
typedef enum { CONTACT_PLANNED, CONTACT_WAITING, CONTACT_ACTIVE } contact_status;

/* Rotation of the shaft about its axis, relative to the tissue. */
typedef struct {
    double anchor;           /* rad, roll angle of the shaft at which the tissue around it is unstrained; NAN until the first solve */
    double turned;           /* rad, rotational slip of the shaft in the last step */
    double torque;           /* N m, torque on the tissue about the needle's axis */
    friction_state friction;
} roll_friction;

/* Slip, friction and rotation of the shaft along a share of the track. A share is the length of track that a contact or the tip stands for. When the tip leaves
   a contact behind or returns to it, this struct is copied from one to the other unchanged. */
typedef struct {
    double origin;           /* m: arc minus depth of the material point of the shaft that would be here if the tissue were not sheared along the shaft. Near
                                the tip, this point may lie beyond the needle's end */
    double slip;             /* m, slip in the last solve, positive if the shaft moves forward relative to the tissue; the next step applies it */
    double slid;             /* m, distance slid since the shaft last stuck */
    friction_state friction;
    double traction;         /* N/m, force along the needle per unit length of track */
    double softness;         /* m^2/N, material factor of the local compliance to an axial line force (local_line_stiffness), averaged over the share; 0 if not
                                known yet */
    double stiffening;       /* stiffening coefficient of the tissue, averaged over the share */
    roll_friction roll;
} shaft_hold;

static const double FULL_GRIP = 0.05; /* N: force along the needle at which the surface gives the tip full lateral support. The tip starts with this force at
                                         first touch, because without lateral support a bent needle would slip aside at once. Chosen: about the smallest force
                                         that a hand feels */

/* One contact: a node of the tissue on the shaft's track. */
typedef struct {
    contact_status status;
    vec3 track;              /* m, nominal: where the tip was when it left the contact behind. The node is kept off faces, so it may lie slightly beside this
                                point */
    vec3 beside;             /* m, from the node to the track, outward across an outer face, as in tip_place */
    vec3 direction;          /* unit vector along the track, in the undeformed tissue */
    double depth;            /* m along the nominal track, measured from the skin */
    shaft_hold shaft;
    resolved_field resolved; /* the mesh's resolution at the contact; resolved.point is that of the tip when it was here */
    double log_axial;        /* ln(resolved radius / needle radius), for forces along the needle; 0 if not known yet */
    plane_tensor log_lateral; /* ln(resolved radius / needle radius), for forces across the track of an infinitely long needle */
    vec3 force;              /* N, world frame, on the tissue */
} shaft_contact;

/* A track cut earlier, which now guides the tip. */
typedef struct {
    double openness;         /* 0 to 1: how open the track is to the tip; if 0, there is no track and the other members are unused */
    vec3 direction;          /* unit vector in the undeformed tissue: direction in which the track leads the tip */
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
    vec3 end;                /* m, world frame: the needle end's previous position, used while the tip is beyond the tissue; `nominal` is then where the tip
                                left the tissue */
} tip_place;

/* Obstacle at the tip; written by the path stage. */
typedef struct {
    int blocked_by;          /* index of the membrane in front of the tip, or NOT_BLOCKED, or BLOCKED_BY_BONE */
    double membrane_damage;  /* 0 to 1: damage to that membrane from an earlier puncture near the tip */
    int face;                /* face of the tip's element, valid if the tip is on the surface or blocked */
    bool entering;           /* the tip is blocked at the outer surface and comes from outside */
} tip_barrier;

/* Solution at the tip; written by the passes. The next path stage applies the slip. */
typedef struct {
    double slip;             /* m, slip of the tip relative to the tissue: positive forward (cutting), negative back */
    friction_state friction; /* forward while the tip cuts tissue */
    vec3 force;              /* N, world frame, on the tissue */
    double end_force;        /* N along the needle, the part of `force` that acts on the end face */
    double arc;              /* m from the base to where the force acts, which is the needle's end or a point behind it (along_track.h) */
} tip_solution;

/* Displacement of the tissue at the tip; written by the solve. */
typedef struct {
    double size;             /* m, displacement along the track */
    double offset;           /* m, displacement along the track that remains after contacts have taken over force from the tip; fades within milliseconds */
    vec3 damping;            /* N, world frame, the damper's force on the tissue, which limits the tissue's rebound to the speed of shear waves */
    vec3 rest;               /* m, world frame: where the tissue at the tip would be without the tip's force */
} tip_dent;

/* The mesh's resolution at the tip; written by the tissue stage. */
typedef struct {
    bool known;              /* the resolution has been measured */
    resolved_field field;
    vec3 at;                 /* m, nominal position of the tip when the resolution was measured */
} tip_resolution;

/* The last point of the tip's track that the snapshot covered; written by the tissue stage. */
typedef struct {
    int tet;                 /* nominal element; -1 if there is none yet */
    double weights[4];       /* barycentric weights of the point in that element */
} known_point;

/* The tip: a contact that moves forward through the tissue as it cuts, and back along its track. */
typedef struct {
    tip_place place;
    tip_barrier barrier;
    open_track track;        /* old track that guides the tip. Found by the path stage; after the solve, the track on which the tip's slip ended */
    double next_contact;     /* m, depth at which the next contact node is due; NAN if none is planned yet. Written by the path stage */
    shaft_hold shaft;        /* the shaft behind the tip, halfway to the last contact: friction holds it, not the resistance ahead of the tip */
    tip_solution solved;
    tip_dent dent;
    double filtered_push;    /* N, >= 0, low-pass filtered force along the needle, which sets the lateral support. Written after the solve */
    tip_resolution resolution;
    known_point known;
} needle_tip;

/* Returns the nominal position of the tip itself (m); `nominal` is the point that stands for it in the mesh. RT */
static inline vec3 tip_position(const tip_place *place) { return v3_add(place->nominal, place->beside); }

/* Returns the direction in which `nominal` moves as the tip moves along `direction`, which is `direction` without its component normal to the grazed face.
   RT */
static inline vec3 tip_way(const tip_place *place, vec3 direction) { return v3_axpy(-v3_dot(direction, place->graze_normal), place->graze_normal, direction); }

/* Returns the total force on the tissue at the tip (N): the needle's and, while the tissue springs back, the damper's. RT */
static inline vec3 tip_load(const needle_tip *tip) { return v3_add(tip->solved.force, tip->dent.damping); }

/* Returns the state of a tip outside the tissue. RT */
static inline needle_tip tip_in_air(void) {
    return (needle_tip){.place = {.phase = TIP_FREE, .tet = -1}, .known.tet = -1, .barrier.blocked_by = NOT_BLOCKED, .next_contact = NAN};
}

/* A stretch of the track that lies in one region, or in a gap between bodies. It ends where the next stratum begins. */
enum { IN_A_GAP = -1 };
typedef struct {
    double depth;            /* m */
    int region;              /* group index, or IN_A_GAP */
    int tet;                 /* element where the stratum begins; for a gap, the element in which the track left the tissue */
    vec3 point;              /* m, nominal: where the stratum begins */
    bool slides;             /* the stratum begins at a surface on which the tissue slides; the members below are used only then */
    int left_tet;            /* element on the other side, which the track left there */
    vec3 left;               /* m, nominal: where it left that element, a distance of FACE_CLEARANCE before the stratum begins */
} stratum;

/* Where the needle is relative to a guide. */
typedef enum { GUIDE_AHEAD, GUIDE_IN_HOLE, GUIDE_MISSED, GUIDE_BESIDE } guide_passage;

/* Contact of the needle with the edge of a guide hole, on one face of the plate. */
typedef struct {
    double arc;              /* m from the base to the point of the shaft that friction holds on the face */
    double slip;             /* m, as in shaft_hold */
    friction_state friction;
    bool touching;           /* true while the needle touches the edge */
    vec3 force;              /* N, world frame, on the guide */
} guide_contact;

typedef struct {
    guide_passage passage;
    int hole;                /* column + columns * row; valid while the needle is in the hole */
    double depth;            /* m, how far the tip is behind the front face while the needle is in a hole; at most the plate's thickness */
    guide_contact faces[GUIDE_FACES]; /* contacts on the front and back faces; the second is at the tip until the tip reaches the back face */
} guide_state;

enum { MAX_STRATA = 256 };  /* most strata; enough for layers of 0.8 mm along a 200 mm track */

/* The mutable state. After each tick it is in equilibrium: shape, contacts and forces are consistent. A plain copy saves or restores it. */
typedef struct {
    vec3 base_shift;             /* m, deflection of the spring through which the hand holds the base; zero if the hand holds it rigidly */
    needle_state needle;
    needle_motion motion;        /* the needle's motion in the last step, if that step ended in equilibrium */
    double base_turn;            /* rad, total rotation of the base about the needle's axis; can exceed a full turn */
    double tip_lead;             /* rad, roll of the tip minus that of the base; negative if the tip lags */
    needle_tip tip;
    vec3 entry;                  /* m, nominal point where the track begins */
    stratum strata[MAX_STRATA];  /* regions along the track, from the skin to the tip */
    int stratum_count;
    refinement refined;          /* the contact nodes, ordered from base to tip */
    shaft_contact contacts[MAX_CONTACTS]; /* contacts, indexed by the slot of their node */
    guide_state guides[MAX_GUIDES];
    int watched;                 /* segment that was last checked for having entered a body sideways */
    uint64_t outside;            /* bit mask of the segments that have entered a body sideways */
    bool moving_on;              /* there is no stable equilibrium nearby, so the needle is moving to another one against its drag */
    vec3 surface;                /* m, while the needle is outside the tissue, last known displacement of the surface at its end; NAN if not known yet */
    tissue_memory memory;        /* memory of relaxing tissue */
    track_list tracks;           /* tracks that this needle has cut since its reset */
    uint64_t next_id;
    remesh_request request;      /* request to the worker; `serial` increases with each change */
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

/* Returns where tissue at this depth holds the shaft (m from the base), at most the needle's length. RT */
static inline double shaft_arc(const shaft_hold *shaft, double depth, double needle_length) {
    return smaller_of(larger_of(shaft->origin + depth, 0.0), needle_length);
}

/* Returns where a contact's force acts on the shaft (m from the base). RT */
static inline double contact_arc(const shaft_contact *contact, double needle_length) { return shaft_arc(&contact->shaft, contact->depth, needle_length); }

/* Returns the slot of the planned contact, which is the last in order, or -1 if there is none. RT */
static inline int contact_planned(const insertion_state *state) {
    int last = state->refined.count > 0 ? state->refined.order[state->refined.count - 1] : -1;
    return last >= 0 && state->contacts[last].status == CONTACT_PLANNED ? last : -1;
}

/* Returns the number of contact nodes that the tip has passed: all but a planned one. RT */
static inline int contacts_passed(const insertion_state *state) { return state->refined.count - (contact_planned(state) >= 0); }

/* Shifts the shaft relative to the tissue by `shift` (m), at the tip and at contacts still waiting for their row of the inverse. RT */
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

/* The tick: pose of the needle's base in, wrench out. Model constant, state mutable, no allocation, no clock. */
#ifndef TROCAR_INSERTION_H
#define TROCAR_INSERTION_H

#include "insertion/contact.h"
#include "needle/needle.h"

/* A named surface that resists the tip until it is punctured. */
typedef struct {
    int group;               /* of the mesh, dimension 2 */
    double puncture_force;   /* N; INFINITY: never */
} membrane;

/* Added half way through elements; or, as in the paper, where the tip leaves them: added on the face, or its closest corner moved there. */
typedef enum { PLACE_INSIDE, PLACE_ON_FACES, PLACE_MOVED } contact_placement;

typedef struct {
    contact_placement placement; /* where contact nodes are, and how they get there */
    double contact_spacing;      /* m, least distance between contact nodes along the track */
    double resolution;           /* alpha: the mesh resolves the line-force field down to alpha h (README, "Local compliance") */
    double weakening_distance;   /* m of sliding over which static friction falls to kinetic */
    double prefetch_distance;    /* m of path ahead of the tip that the window covers */
    double longest_step;         /* s, a longer tick is taken in several steps: forces do not depend on the rate */
    int most_steps;              /* a tick takes at most so many steps; in a longer tick, the steps are longer */
    int max_passes;              /* Newton passes a step, at most */
    double tolerance;            /* m, error of the needle's shape at which the passes stop */
} insertion_settings;

typedef struct {
    const mesh *mesh;
    const tissue *tissue;
    const region_material *materials;  /* by group index */
    const needle_model *needle;
    const membrane *membranes;
    int membrane_count;
    insertion_settings settings;
    double *node_lateral;        /* node_count, filled by local_create: mean of (3 - 4 nu) / (8 pi mu (1 - nu)) around the node, m^2/N */
    double *node_axial;          /* node_count: mean of 1 / (2 pi mu), m^2/N */
    double *node_disc;           /* node_count: mean of (3 - 4 nu) / (32 mu (1 - nu)), m^2/N: rigid disc in the depth, times its radius */
    double *node_punch;          /* node_count: mean of (1 - 2 nu) / (4 mu ln(3 - 4 nu)), m^2/N: the same bonded to a free surface */
} insertion_model;

typedef enum {
    EVENT_TOUCHED = 1 << 0,      /* the tip met the outer surface, from the air or from a gap between bodies */
    EVENT_PUNCTURED = 1 << 1,    /* a membrane gave way (`membrane` says which) */
    EVENT_ADDED = 1 << 2,        /* a contact became active */
    EVENT_REMOVED = 1 << 3,      /* a contact slipped off the tip */
    EVENT_EXITED = 1 << 4,       /* the tip left the tissue on the far side, or into a gap */
    EVENT_REENTERED = 1 << 5,    /* and came back the same way */
    EVENT_WITHDRAWN = 1 << 6,    /* the needle left the tissue the way it came in */
    EVENT_LATE = 1 << 7,         /* the window does not cover the tip: the tick went on with what it had */
    EVENT_FULL = 1 << 8,         /* MAX_CONTACTS reached, or MAX_STRATA: the shaft has the friction of the last layer noted */
    EVENT_UNSTABLE = 1 << 9,     /* no equilibrium: the needle buckled; no force until it is back where it was */
    EVENT_KEPT = 1 << 10,        /* the closest node may not be moved (refinement_move): one was added instead */
} insertion_event;

enum { NOT_BLOCKED = -1, BLOCKED_BY_BONE = -2 };

typedef enum { TIP_FREE, TIP_INSIDE, TIP_BEYOND } tip_phase; /* beyond: out on the far side or in a gap, shaft still in the tissue */

/* One contact: a node of the tissue that the shaft passes. */
typedef struct {
    double arc;              /* m from the base: the needle's material point that is there */
    vec3 track;              /* m, world frame: where the tip left it; its node, kept off faces, may lie a little beside it */
    vec3 beside;             /* m, how much of that is out of an outer face: as in needle_tip */
    vec3 direction;          /* unit vector of the track there, in the undeformed tissue */
    double depth;            /* m along the nominal track from the skin */
    double slip;             /* m, how far the shaft slid forward past it in the last solve; carried out by the next tick */
    double slid;             /* m of sliding since it last stuck */
    friction_state friction;
    double log_lateral;      /* logarithm of the radius that the mesh resolves over the needle's, for forces sideways */
    double log_axial;        /* the same along the needle */
    double surplus;          /* m/N, what its node yields already by being in the mesh */
    double softness;         /* m^2/N, mean over its share of a line's local compliance per logarithm, along the needle; 0: not known yet */
    double traction;         /* N/m, force along the needle over the length of its share */
    vec3 force;              /* N, world frame, on the tissue */
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
    double shaft_softness, shaft_traction; /* of that shaft: as in shaft_contact */
    double stretch;          /* m, how much farther than the tip that shaft is ahead of the tissue that it sticks to */
    vec3 force;              /* N, world frame, on the tissue */
    double dent;             /* m along the track, by which the tissue at the tip is displaced */
    vec3 damping;            /* N, world frame, on the tissue at the tip: it springs back no faster than waves spread in it */
    double pressing;         /* N, force along the needle as the hold sideways follows it, >= 0 */
    int blocked_by;          /* membrane in front of the tip, NOT_BLOCKED or BLOCKED_BY_BONE */
    int face;                /* of `tet`: where the tip is on the surface or blocked */
    bool entering;           /* what blocks is on the outer surface, and the tip comes from outside */
    vec3 outward;            /* unit normal of the outer face along which the tip grazes; zero: it does not */
    vec3 beside;             /* m, from `nominal`, just inside that face, to the tip itself, which may be out by a radius */
    vec3 end;                /* m, world frame: where the needle's end was when the tip was last beyond; `nominal` is where it left */
    double next_contact;     /* m of depth where the next contact node is due; NAN: to be planned */
    bool planned;            /* the last node of the refinement is that one, asked for in advance */
    int known_tet;           /* nominal element of the last point that the snapshot covered, -1: none yet */
    double known_weights[4]; /* and that point's barycentric weights */
} needle_tip;

/* m, nominal: where the tip is, which `nominal` stands for in the mesh. RT */
static inline vec3 tip_place(const needle_tip *tip) { return v3_add(tip->nominal, tip->beside); }

/* The way that `nominal` takes while the tip goes along `direction`: not out of the face that it grazes. RT */
static inline vec3 tip_way(const needle_tip *tip, vec3 direction) { return v3_axpy(-v3_dot(direction, tip->outward), tip->outward, direction); }

/* N, all that displaces the tissue at the tip: the needle's force, and what holds the tissue back while it springs back. RT */
static inline vec3 tip_load(const needle_tip *tip) { return v3_add(tip->force, tip->damping); }

/* From this depth on, up to the next stratum, the track lies in this region, or in a gap between bodies. */
enum { IN_A_GAP = -1 };
typedef struct {
    double depth;            /* m */
    int region;              /* group index, or IN_A_GAP */
    int tet;                 /* element that the track starts in there; of a gap, the one that it left */
    vec3 point;              /* m, nominal: where it starts */
} stratum;

enum { MAX_STRATA = 256 };  /* layers of 0.8 mm on a track of 200 mm */

/* All that changes. After each tick it is an equilibrium: shape, contacts and forces belong together. A plain copy saves
   and restores it. */
typedef struct {
    double base_compliance;      /* m/N, of the spring on which the base is held, 0: rigidly; the caller's to set, kept by a reset */
    vec3 base_shift;             /* m, by which that spring has given way */
    needle_state needle;
    needle_tip tip;
    vec3 entry;                  /* m, nominal point where the track starts */
    stratum strata[MAX_STRATA];  /* regions along the track, from the skin to the tip */
    int stratum_count;
    refinement refined;          /* the contact nodes, base to tip */
    shaft_contact contacts[MAX_CONTACTS];
    int active;                  /* contacts[0 .. active) take part; the others wait for the worker */
    bool saddle;                 /* the last tick ended, without convergence perhaps, where needle and tissue are not stable */
    bool buckled;                /* no equilibrium was found; straight and without force until its tip is back */
    vec3 stuck_at;               /* m, world frame: where the needle's end was then */
    uint64_t next_id;
    remesh_request request;      /* what the tick wants next; serial grows with each change */
} insertion_state;

typedef enum { INSERTION_TISSUE, INSERTION_NEEDLE, INSERTION_CONTACT, INSERTION_WRENCH, INSERTION_STAGES } insertion_stage;

/* Where a tick spends its time. The clock is its caller's; NULL: nothing is measured. */
typedef struct {
    int64_t (*clock)(void);          /* ns */
    int64_t last;                    /* ns, when the last stage ended */
    int64_t spent[INSERTION_STAGES]; /* ns, in this tick */
} insertion_profile;

/* RT */
static inline void profile_begin(insertion_profile *p) { *p = (insertion_profile){.clock = p->clock, .last = p->clock ? p->clock() : 0}; }

/* What has passed since the last call went into this stage. RT */
static inline void profile_end_stage(insertion_profile *p, insertion_stage stage) {
    if (!p->clock) return;
    int64_t now = p->clock();
    p->spent[stage] += now - p->last;
    p->last = now;
}

/* The part of the track that a point of the shaft stands for. */
typedef struct {
    double from, to;         /* m of depth */
} shaft_share;

/* Scratch of one tick: nothing in it but the profile outlives the call. */
typedef struct {
    bool tip;                                /* takes part in the solve, as the last of the points; the others are the contacts */
    needle_tangent tangent;
    contact_problem problem;
    needle_point points[MAX_POINTS];
    vec3 nominal[MAX_POINTS];
    shaft_share shares[MAX_POINTS];
    vec3 load[NEEDLE_MAX_SEGMENTS + 1];      /* N, of all points on the needle's joints */
    double lateral[MAX_POINTS], axial[MAX_AXIAL]; /* local compliance, m/N; the last one along the needle: of the shaft next to the tip */
    double relaxed;                          /* part of the way to its static place that the tissue at the tip goes in this step */
    double tip_column[MAX_UNKNOWNS];         /* m/N, displacement of the tissue at each unknown under a force along the track at the tip, */
    double tip_yield;                        /* m/N, and of the tip itself */
    double held_axial;                       /* m/N, along the track: of the tip's share of shaft and one radius more */
    double loose;                            /* m/N, what the tip yields sideways on top of that while it has not got its full hold */
    mat3 tip_row[MAX_POINTS];                /* compliance between the tip and each point, world frame, m/N */
    needle_state start;                      /* shape before the first pass, */
    vec3 start_force[MAX_POINTS];            /* N, and forces, */
    double start_traction;                   /* N/m, and what the shaft next to the tip bears of the last one */
    double lag[MAX_UNKNOWNS], lag_left;      /* m, by which gaps stay open while a tick is done again; share of that which is left */
    insertion_profile profile;
} insertion_workspace;

typedef struct {
    vec3 force;                  /* N, world frame: what the base exerts on the hand */
    vec3 torque;                 /* N m, world frame, about the base point, where it is */
    double depth;                /* m, length of the track in the tissue, gaps between bodies included */
    int contacts;                /* active */
    unsigned events;             /* insertion_event bits of this tick */
    int membrane;                /* index of the membrane punctured in this tick, or -1 */
    int passes, switches;        /* effort of this tick */
} insertion_wrench;

/* Needle straight, held at `base`. Where it lies in the tissue it counts as inserted along its axis, without force. RT */
void insertion_reset(const insertion_model *model, pose base, insertion_state *state);

/* One tick of length dt (s): state and `base` (where the base is without force) in, state and wrench out; takes what the snapshot
   holds and leaves in state->request what it wants next. Its time does not depend on the mesh, but for the look-up of the skin,
   O(log n), while the tip is outside or on it. No allocation, no lock, no call to a library. RT */
void insertion_tick(const insertion_model *model, insertion_state *state, insertion_workspace *scratch,
                    const compliance_snapshot *snapshot, pose base, double dt, insertion_wrench *wrench);

/* Are the wrench, and all numbers that the next tick starts from, finite? RT */
bool insertion_is_finite(const insertion_state *state, const insertion_wrench *wrench);

/* After a tick that was not: starts the insertion over at `base`. The wrench becomes zero, its event UNSTABLE. RT */
void insertion_start_over(const insertion_model *model, pose base, insertion_state *state, insertion_wrench *wrench);

/* The refined mesh as the needle sees it now: the active contact nodes. */
void insertion_refinement(const insertion_state *state, refinement *out);

/* Adds the forces on the tissue to `nominal` (node_count) and puts those on the active contact nodes into `added`; N, world
   frame. The tip's is spread over its element's corners. */
void insertion_forces(const insertion_model *model, const insertion_state *state, vec3 *nominal, vec3 *added);

#endif

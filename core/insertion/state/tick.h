/* What one tick works with: what it is given, the scratch of its stages, and its output. */
#ifndef TROCAR_TICK_H
#define TROCAR_TICK_H

#include "insertion/state/shaft.h"
#include "insertion/state/stiffening_law.h"
#include "linalg/between_kernels.h"

typedef enum {
    EVENT_TOUCHED = 1 << 0,      /* the tip met the outer surface, from the air or from a gap between bodies */
    EVENT_PUNCTURED = 1 << 1,    /* a membrane gave way (`membrane` says which) */
    EVENT_ADDED = 1 << 2,        /* a contact became active */
    EVENT_REMOVED = 1 << 3,      /* a contact slipped off the tip */
    EVENT_EXITED = 1 << 4,       /* the tip left the tissue on the far side, or into a gap */
    EVENT_REENTERED = 1 << 5,    /* and came back the same way */
    EVENT_WITHDRAWN = 1 << 6,    /* the needle left the tissue the way it came in */
    EVENT_LATE = 1 << 7,         /* the snapshot does not cover the tip, or what the mesh resolves there was not measured: the tick used what was known last, or estimates */
    EVENT_FULL = 1 << 8,         /* MAX_CONTACTS reached, or MAX_STRATA: the shaft has the friction of the last layer noted */
    EVENT_UNSTABLE = 1 << 9,     /* the result was not finite: the insertion starts over */
    EVENT_MISSED_GUIDE = 1 << 11, /* the needle passes a guide outside of its holes, and is not guided; in every tick */
    EVENT_OUTSIDE_MODEL = 1 << 12, /* the shaft is pushed into a body from the side, and bears no force there; in every tick */
    EVENT_TRACK_DROPPED = 1 << 13, /* no room for another track or point (MAX_TRACKS, MAX_TRACK_POINTS): the needle's oldest track is closed again */
    EVENT_INEXACT = 1 << 14,     /* the passes had not converged after the most that there may be */
} insertion_event;

/* What a tick answers. */
typedef struct {
    vec3 force;                  /* N, world frame: what the base exerts on the hand */
    vec3 torque;                 /* N m, world frame, about the base point, where it is */
    double depth;                /* m, length of the track in the tissue, gaps between bodies included */
    int contacts;                /* active */
    unsigned events;             /* insertion_event bits of this tick */
    int membrane;                /* index of the membrane punctured in this tick, or -1 */
    int passes, switches;        /* effort of this tick */
} tick_output;

typedef enum { INSERTION_TISSUE, INSERTION_NEEDLE, INSERTION_CONTACT, INSERTION_WRENCH, INSERTION_STAGES } insertion_stage;

/* Where a tick spends its time. The clock is its caller's; NULL: nothing is measured. */
typedef struct {
    int64_t (*clock)(void);          /* ns */
    int64_t last;                    /* ns, when the last stage ended */
    int64_t spent[INSERTION_STAGES]; /* ns, in this tick */
} insertion_profile;

/* RT */
static inline void profile_begin(insertion_profile *p) { *p = (insertion_profile){.clock = p->clock, .last = p->clock ? p->clock() : 0}; }

/* Adds the time since the last call to this stage. RT */
static inline void profile_end_stage(insertion_profile *p, insertion_stage stage) {
    if (!p->clock) return;
    int64_t now = p->clock();
    p->spent[stage] += now - p->last;
    p->last = now;
}

/* Where the needle touches something, and what with. */
typedef enum { POINT_TISSUE, POINT_TIP, POINT_GUIDE } point_kind;
enum { NO_HANDLE = -1 };
typedef struct {
    point_kind kind;
    int handle;              /* of its own in the snapshot, which is also the slot of its contact; NO_HANDLE: the tip's is interpolated */
    int guide, face;         /* of a POINT_GUIDE */
    double arc;              /* m from the base */
    double lead;             /* m along the needle, from there to the material point of the shaft that the tissue holds (shaft_hold); 0 but near the tip */
    double to_end;           /* m along the needle, from there to its end, where the end face is; the tip's only */
    needle_point at;         /* on the needle */
    vec3 target;             /* m, where what it touches would be without the needle's forces */
    shaft_share share;
    shaft_resistance shaft;  /* what this share of the shaft meets */
} contact_point;

/* Of relaxing tissue, in one step: its displacement under the forces f is (yield C) (f + remembered). Elastic: yield 1, the rest 0. */
typedef struct {
    double yield;
    double decay[MAX_RELAXATION];            /* of each term's memory, over the step; */
    double weight[MAX_RELAXATION];           /* of each term in what is remembered, over the yield; */
    double residual[MAX_RELAXATION];         /* of the snapshot's u_left, since then */
    remembered_forces remembered[MAX_POINTS]; /* by points in tissue, over the yield; the tip's along and twist: only of the shaft's part of its share */
    double face;                             /* N, remembered of the force on the tip's end face */
    double tip_moved;                        /* m, since the last step */
    vec3 moved[MAX_POINTS];                  /* m, displacement of the tissue by the remembered loads */
    int kept;                                /* shares from the base on that are as in the last step; */
    share_memory before[MAX_SHARES];         /* those beyond, as they were; */
    int before_count;                        /* so many, */
    bool before_tip;                         /* with the tip's */
} creep_step;

/* What stiffening adds to a displacement, linearised: `offset` + slope times the force. */
typedef struct {
    double force;            /* N, about which */
    double slope;            /* m/N, at most 0 */
    double offset;           /* m */
} linear_shift;

/* Of stiffening tissue, in one step. `end` is zero where nothing stiffens; the rest is then unused. */
typedef struct {
    bool any;                                /* tissue at some point may stiffen */
    stiffening_law along[MAX_POINTS], face;  /* of the shaft, and of the tip's end face */
    linear_shift shaft[MAX_POINTS], end;
} stiffening_step;

/* The map J from a displacement of the shaft across its axis, in its frame, to that of the point where its axis crosses the face of a
   guide, in the directions of the grid. A force on the needle is J^T times that in the plane of the face: across the needle. */
typedef struct {
    double m[2][2], inverse[2][2];
} crossing_map;

/* The edge of a hole as a point of the shaft meets it. */
typedef struct {
    crossing_map map;
    double offset[2];        /* m, in the plane of the face, of the needle's axis from that of the hole */
    bool touched;
    double pulled;           /* N, force of the last pass, if the edge would have to pull */
    double pressed;          /* N, about which the edge is linearised */
    double normal[2];        /* unit vector from the hole's axis to where the needle touches the edge */
    double lateral[3];       /* m/N, compliance in the needle's frame: xx, xy, yy */
    double rubbing;          /* N, across the needle, by which the last pass bounded the friction along it */
    bool agrees;             /* with the last pass's forces: those are, within the tolerance, what the needle's place asks for */
} hole_edge;

/* What the tip would come to in a step as it goes forward, stretch by stretch; what it is blocked by, if it is, is the only one. */
typedef struct {
    double from;             /* m of slip, where the stretch begins */
    double resistance;       /* N */
    bool stops;              /* a membrane or bone, which holds the tip at `from` up to its resistance; else tissue, */
    double viscosity;        /* N s/m, of it, */
    open_track track;        /* along this track */
} stretch_ahead;

typedef struct {
    stretch_ahead stretches[MAX_KNOTS];
    int count;
    int of_knot[MAX_KNOTS];  /* stretch that begins at each knot of the contact problem's staircase, which leaves out what does not stop the tip */
} resistance_ahead;

/* A copy of what the passes change, to go back to. */
typedef struct {
    needle_state needle;
    vec3 base_shift;                          /* m */
    needle_tip tip;
    guide_contact faces[MAX_GUIDE_POINTS];    /* of the points at guides, */
    struct { vec3 force; shaft_hold shaft; } contacts[MAX_POINTS]; /* and of those at contacts, by point */
    int knot;                                 /* of the contact problem's staircase */
} pass_checkpoint;

_Static_assert((int)MAX_POINTS <= BETWEEN_POINTS && (int)NEEDLE_POINT_JOINTS == BETWEEN_JOINTS, "the kernels take all points");

/* What the hand has moved in this step. Written by the hand stage. */
typedef struct {
    double carried;          /* m, by which it carries the tip forward; INFINITY: not known */
    vec3 end_before;         /* m, where the needle's end was before, */
    vec3 straight_before;    /* m, and where that of a straight needle would have been */
} hand_advance;

/* Where the tip would go. Written by the path stage. */
typedef struct {
    vec3 cut_direction;      /* unit nominal direction in which it would cut, were it not led along an old track */
} path_step;

/* The points that take part in the solve. The tissue stage lists them; `at`, `target`, `lead` and at the tip `arc` follow the needle's shape. */
typedef struct {
    int count, guided;               /* of these, the first `guided` are at guides */
    bool tip;                        /* the last of them is the tip */
    int added;                       /* so many of the contacts take part for the first time: the last ones */
    contact_point list[MAX_POINTS];  /* guides, then contacts from base to tip */
} contact_points;

/* How the tissue yields at the points. Written by the tissue stage. */
typedef struct {
    vec3 free_at_tip;                /* m, u_free there */
    mat3 tip_row[MAX_POINTS];        /* compliance between the tip and each point, world frame, m/N */
    double tip_resolved;             /* 1/m, resolved_field.point at the tip; 0: the mesh counts as rigid there */
    principal_tensor lateral[MAX_POINTS]; /* local compliance, m/N: across the track, */
    double axial[MAX_AXIAL];         /* and along it: at the tip that of the end face, then that of the shaft next to it */
    double sideways_on_shaft;        /* part of the tip's sideways force that the shaft next to it bears; the rest is on its end face */
    double extra_lateral_compliance[MAX_POINTS];  /* m/N, additional lateral compliance while the hold is not full, */
    double tightening[MAX_POINTS];   /* 1/N, and by how much less that is for each metre of depth */
} tissue_step;

/* The damper at the tip (tip_damper.h). */
typedef struct {
    double relaxed;                  /* part of the way to its static place that the tissue at the tip goes in this step */
    double column[MAX_UNKNOWNS];     /* m/N, displacement of the tissue at each unknown under a force along the track at the tip, */
    double yield;                    /* m/N, and of the tip itself */
} damper_step;

/* The needle in one pass. Written by the needle stage. */
typedef struct {
    _Alignas(CACHE_LINE) needle_tangent tangent;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1]; /* N, of all points on the joints */
    double drag;                     /* N, drag of the needle's turning over the step; 0: it is in equilibrium */
} needle_response;

/* Of a step that is repeated in small parts (continuation.c). */
typedef struct {
    double lag[MAX_UNKNOWNS];        /* m, by which the gaps differ from those that balance the forces at the start; */
    double kept_open;                /* fraction of it by which they are still kept open */
} continuation_step;

/* Scratch of one tick, by the stage that writes it: nothing in it but the profile outlives the call. */
typedef struct {
    hand_advance hand;
    path_step path;
    contact_points points;
    tissue_step tissue;
    creep_step creep;
    resistance_ahead ahead;
    needle_response response;
    _Alignas(CACHE_LINE) between_components joints_to_points[3 * (NEEDLE_MAX_SEGMENTS + 1)]; /* m/N, world frame, scratch of assemble_between_points */
    hole_edge edges[MAX_GUIDE_POINTS];       /* of the points at guides */
    stiffening_step stiffening;
    damper_step damper;
    contact_problem problem;
    pass_checkpoint start;                   /* before the first pass */
    continuation_step continuation;
    insertion_profile profile;
} insertion_workspace;

/* How the base is held: by a spring to `pose`, where it rests without force. */
typedef struct {
    pose pose;
    double compliance;       /* m/N, the same in every direction; 0: held rigidly */
} mount;

/* What a tick is given. */
typedef struct {
    const insertion_model *model;
    const compliance_snapshot *snapshot;
    const track_list *others[MAX_NEEDLES - 1]; /* tracks of the other needles in the tissue; */
    int other_count;         /* so many */
    mount base;
    double dt;               /* s */
} tick_input;

/* Force on what the point touches, N, world frame. RT */
static inline vec3 point_force(const insertion_state *state, const contact_point *p) {
    if (p->kind == POINT_GUIDE) return state->guides[p->guide].faces[p->face].force;
    return p->kind == POINT_TIP ? state->tip.solved.force : state->contacts[p->handle].force;
}
static inline void point_set_force(insertion_state *state, const contact_point *p, vec3 force) {
    if (p->kind == POINT_GUIDE) state->guides[p->guide].faces[p->face].force = force;
    else if (p->kind == POINT_TIP) state->tip.solved.force = force;
    else state->contacts[p->handle].force = force;
}

/* Direction of the track at a point in the tissue: no guide's. */
static inline vec3 point_track(const insertion_state *state, const contact_point *p) {
    return p->kind == POINT_TIP ? state->tip.place.direction : state->contacts[p->handle].direction;
}

#endif

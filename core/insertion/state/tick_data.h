/* The data of one tick: its input, the scratch memory of its stages, and its output. */
#ifndef TROCAR_TICK_DATA_H
#define TROCAR_TICK_DATA_H

#include "insertion/state/shaft.h"
#include "insertion/model/stiffening_law.h"
#include "linalg/between_kernels.h"

typedef enum {
    EVENT_TOUCHED = 1 << 0,      /* the tip met the outer surface, from outside or from a gap between bodies */
    EVENT_PUNCTURED = 1 << 1,    /* a membrane was punctured; `membrane` is its index */
    EVENT_ADDED = 1 << 2,        /* a contact became active */
    EVENT_REMOVED = 1 << 3,      /* a contact was removed because the tip returned to it */
    EVENT_EXITED = 1 << 4,       /* the tip left the tissue on the far side, or into a gap */
    EVENT_REENTERED = 1 << 5,    /* the tip returned to the tissue the way it had left */
    EVENT_WITHDRAWN = 1 << 6,    /* the needle was withdrawn from the tissue through its entry */
    EVENT_LATE = 1 << 7,         /* the snapshot does not cover the tip, or the mesh's resolution there has not been measured yet, so the tick used the last
                                    known values or estimates */
    EVENT_FULL = 1 << 8,         /* MAX_CONTACTS or MAX_STRATA has been reached; deeper parts of the shaft have the friction of the last recorded stratum */
    EVENT_UNSTABLE = 1 << 9,     /* the result was not finite, so the insertion restarts */
    EVENT_MISSED_GUIDE = 1 << 11, /* the needle passes beside a guide's holes and is not guided; set in every such tick */
    EVENT_OUTSIDE_MODEL = 1 << 12, /* the shaft is being pushed into a body sideways, for which the model computes no force; set in every such tick */
    EVENT_TRACK_DROPPED = 1 << 13, /* another track or point would not fit (MAX_TRACKS, MAX_TRACK_POINTS), so the needle's oldest track was dropped */
    EVENT_INEXACT = 1 << 14,     /* the passes did not converge within the allowed number */
} insertion_event;

/* The output of a tick. */
typedef struct {
    vec3 force;                  /* N, world frame: force of the base on the hand */
    vec3 torque;                 /* N m, world frame: torque on the hand about the base point */
    double depth;                /* m, length of the track in the tissue, including gaps between bodies */
    int contacts;                /* number of active contacts */
    unsigned events;             /* insertion_event bits of this tick */
    int membrane;                /* index of the membrane punctured in this tick, or -1 */
    int passes, switches;        /* passes, and contacts that switched state, in this tick */
} tick_output;

/* The parts of a tick that are timed separately. Each covers several stages (insertion/README.md): hand to ahead; needle and advance; problem and solve; and,
   after the last pass, conclude and output. */
typedef enum { TIMED_TISSUE, TIMED_NEEDLE, TIMED_CONTACT, TIMED_WRENCH, TIMED_PARTS } timed_part;

/* Time spent in each part of a tick. The caller supplies the clock; if it is NULL, nothing is measured. */
typedef struct {
    int64_t (*clock)(void);          /* ns */
    int64_t last;                    /* ns, when the last part ended */
    int64_t spent[TIMED_PARTS];      /* ns, time spent in each part in this tick */
} insertion_profile;

/* RT */
static inline void profile_begin(insertion_profile *p) { *p = (insertion_profile){.clock = p->clock, .last = p->clock ? p->clock() : 0}; }

/* Adds the time since the previous call to this part's total. RT */
static inline void profile_end_part(insertion_profile *p, timed_part part) {
    if (!p->clock) return;
    int64_t now = p->clock();
    p->spent[part] += now - p->last;
    p->last = now;
}

/* What the needle touches at a contact point. */
typedef enum { POINT_TISSUE, POINT_TIP, POINT_GUIDE } point_kind;
enum { NO_HANDLE = -1 };
typedef struct {
    point_kind kind;
    int handle;              /* the contact's handle in the snapshot, equal to its slot; NO_HANDLE for the tip, whose values are interpolated between other
                                handles */
    int guide, face;         /* POINT_GUIDE only */
    double arc;              /* m from the base */
    double lead;             /* m along the needle, from `arc` to the point of the shaft that the tissue holds (see shaft_hold); 0 except near the tip */
    double to_end;           /* m along the needle, from `arc` to the needle's end face; for the tip only */
    needle_point at;         /* the point on the needle at this arc */
    vec3 target;             /* m, where the touched material would be without the needle's forces */
    shaft_share share;
    shaft_resistance shaft;  /* the tissue's resistance to the motion of this share of the shaft */
} contact_point;

/* Relaxing tissue during one step. Under the forces f it is displaced by (yield C) (f + remembered). For elastic tissue, yield is 1 and the other members are
   0. */
typedef struct {
    double yield;
    double decay[MAX_RELAXATION];            /* factor by which each term's memory decays in the step */
    double weight[MAX_RELAXATION];           /* weight of each term in the remembered force, divided by the yield */
    double residual[MAX_RELAXATION];         /* factor by which the snapshot's u_residual has decayed since it was computed */
    remembered_forces remembered[MAX_POINTS]; /* remembered force at each point in the tissue, divided by the yield; at the tip, `along` and `twist` are the
                                                 adjacent shaft's only */
    double face;                             /* N, remembered force on the tip's end face */
    double tip_moved;                        /* m, how far the tip has moved since the last step */
    vec3 moved[MAX_POINTS];                  /* m, displacement of the tissue at each point due to the remembered loads */
    int kept;                                /* number of shares, counted from the base, that have not changed since the last step */
    share_memory before[MAX_SHARES];         /* the other shares, as they were in the last step */
    int before_count;                        /* number of shares in `before` */
    bool before_tip;                         /* true if the last entry of `before` is the tip's share */
} creep_step;

/* Linearised displacement due to stiffening: offset + slope * force. */
typedef struct {
    double force;            /* N, force about which the law is linearised */
    double slope;            /* m/N, at most 0 */
    double offset;           /* m */
} linear_shift;

/* Stiffening tissue during one step. If `any` is false, `end` is zero and the other members are unused. */
typedef struct {
    bool any;                                /* the tissue at one of the points can stiffen */
    stiffening_law along[MAX_POINTS], face;  /* laws for the shaft at each point, and for the tip's end face */
    linear_shift shaft[MAX_POINTS], end;
} stiffening_step;

/* Maps a lateral displacement of the shaft (in the shaft's frame) to the displacement of the point where the shaft's axis crosses the face of a guide (in the
   directions of the grid). Call the map J: a force f in the plane of the face then acts on the needle as the lateral force J^T f. */
typedef struct {
    double m[2][2], inverse[2][2];
} crossing_map;

/* Contact between the shaft and the edge of a guide hole. */
typedef struct {
    crossing_map map;
    double offset[2];        /* m, offset of the needle's axis from that of the hole, in the plane of the face */
    bool touched;
    double pulled;           /* N, force with which the edge would have to pull on the needle after the last pass; 0 if they touch */
    double pressed;          /* N, force about which the edge is linearised */
    double normal[2];        /* unit vector from the hole's axis towards the point where needle and edge touch */
    double lateral[3];       /* m/N, compliance of the edge in the needle's frame: xx, xy, yy */
    double rubbing;          /* N, lateral force that set the friction bound in the last pass */
    bool agrees;             /* the needle's position agrees with the forces of the last pass, within tolerance */
} hole_edge;

/* The resistance the tip would meet as it advances in this step, as a list of stretches. If an obstacle already blocks the tip, it is the only entry. */
typedef struct {
    double from;             /* m, slip at which the stretch begins */
    double resistance;       /* N */
    bool stops;              /* membrane or bone: stops the tip at `from` until the force exceeds the resistance. False for tissue */
    double viscosity;        /* N s/m, viscosity of the tissue */
    open_track track;        /* old track that the tip follows in this stretch */
} stretch_ahead;

typedef struct {
    stretch_ahead stretches[MAX_KNOTS];
    int count;
    int of_knot[MAX_KNOTS];  /* for each knot of the contact problem's staircase, index of its stretch; the staircase omits stretches that cannot stop the
                                tip */
} resistance_ahead;

/* A copy of everything that the passes change. */
typedef struct {
    needle_state needle;
    vec3 base_shift;                          /* m */
    needle_tip tip;
    guide_contact faces[MAX_GUIDE_POINTS];    /* the guide contacts at the guide points */
    struct { vec3 force; shaft_hold shaft; } contacts[MAX_POINTS]; /* force and shaft state at each point in contact with tissue */
    int knot;                                 /* the contact problem's current knot in the staircase */
} pass_checkpoint;

_Static_assert((int)MAX_POINTS <= BETWEEN_POINTS && (int)NEEDLE_POINT_JOINTS == BETWEEN_JOINTS, "the kernels take all points");

/* Motion of the hand in this step; written by the hand stage. */
typedef struct {
    double carried;          /* m, how far the hand carries the tip forward; INFINITY if not known */
    vec3 end_before;         /* m, where the needle's end was before */
    vec3 straight_before;    /* m, where the needle's end would have been before if the needle were straight */
} hand_advance;

/* The direction in which the tip is to go; written by the path stage. */
typedef struct {
    vec3 cut_direction;      /* unit vector in the undeformed tissue: the direction in which the tip would cut without an old track to guide it */
} path_step;

/* The contact points that take part in the solve; listed by the tissue stage. The members `at`, `target`, `lead` and (for the tip) `arc` are updated as the
   needle changes shape. */
typedef struct {
    int count, guided;               /* all points, and those at guides, which come first */
    bool tip;                        /* true if the last point is the tip */
    int added;                       /* contacts added in this step; they are at the end of the array */
    contact_point list[MAX_POINTS];  /* guides, then contacts from base to tip */
} contact_points;

/* Compliance of the tissue at the points; written by the tissue stage. */
typedef struct {
    vec3 free_at_tip;                /* m, displacement at the tip without the needle's current forces */
    mat3 tip_row[MAX_POINTS];        /* m/N, world frame, compliance of the tissue between the tip and each point */
    double tip_resolved;             /* 1/m, resolved_field.point at the tip; 0 if the mesh is treated as rigid there */
    principal_tensor lateral[MAX_POINTS]; /* m/N, local compliance across the track at each point */
    double axial[MAX_AXIAL];         /* m/N, local compliance along the track at each point; the tip has two entries, for its end face and for the adjacent
                                        shaft */
    double sideways_on_shaft;        /* fraction of the tip's lateral force that acts on the adjacent shaft; the rest acts on the end face */
    double extra_lateral_compliance[MAX_POINTS];  /* m/N, extra lateral compliance while the surface does not fully support the tip */
    double tightening[MAX_POINTS];   /* 1/N, by how much that extra compliance decreases per metre of depth */
} tissue_step;

/* The damper at the tip (tip_damper.h). */
typedef struct {
    double relaxed;                  /* fraction of the distance to static equilibrium that the tissue at the tip covers in this step */
    double column[MAX_UNKNOWNS];     /* m/N, displacement of the tissue at each unknown per unit force along the track at the tip */
    double yield;                    /* m/N, displacement of the tip per unit force along the track */
} damper_step;

/* The needle's response in one pass; written by the needle stage. */
typedef struct {
    _Alignas(CACHE_LINE) needle_tangent tangent;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1]; /* N, load on each joint from all contact points */
    double drag;                     /* drag coefficient against rotation of the needle's segments in this step; 0 if the needle is in equilibrium */
} needle_response;

/* A step divided into small increments (continuation.c). */
typedef struct {
    double lag[MAX_UNKNOWNS];        /* m, by how much each gap differs from the one that would balance the forces at the start of the step */
    double kept_open;                /* fraction of that difference still left */
} continuation_step;

/* Scratch memory of one step, grouped by the stage that writes it; only the profile covers the whole tick. After a tick, only insertion_hold and
   insertion_differentiate read it. */
typedef struct {
    hand_advance hand;
    path_step path;
    contact_points points;
    tissue_step tissue;
    creep_step creep;
    resistance_ahead ahead;
    needle_response response;
    _Alignas(CACHE_LINE) between_components joints_to_points[3 * (NEEDLE_MAX_SEGMENTS + 1)]; /* m/N, world frame: scratch for assemble_between_points */
    hole_edge edges[MAX_GUIDE_POINTS];       /* edges of the holes at the guide points */
    stiffening_step stiffening;
    damper_step damper;
    contact_problem problem;
    pass_checkpoint start;                   /* state before the first pass */
    continuation_step continuation;
    insertion_profile profile;
} insertion_workspace;

/* What holds the base: a spring between the base and `pose`, where the base would be without force. */
typedef struct {
    pose pose;
    double compliance;       /* m/N, compliance of the spring, the same in every direction; 0 if the base is held rigidly */
} mount;

/* The input of a tick. */
typedef struct {
    const insertion_model *model;
    const compliance_snapshot *snapshot;
    const track_list *others[MAX_NEEDLES - 1]; /* tracks that the other needles have cut in the tissue */
    int other_count;         /* number of entries in `others` */
    mount base;
    double dt;               /* s */
} tick_input;

/* Returns the force (N, world frame) that a point exerts on the body it touches. RT */
static inline vec3 point_force(const insertion_state *state, const contact_point *p) {
    if (p->kind == POINT_GUIDE) return state->guides[p->guide].faces[p->face].force;
    return p->kind == POINT_TIP ? state->tip.solved.force : state->contacts[p->handle].force;
}
static inline void point_set_force(insertion_state *state, const contact_point *p, vec3 force) {
    if (p->kind == POINT_GUIDE) state->guides[p->guide].faces[p->face].force = force;
    else if (p->kind == POINT_TIP) state->tip.solved.force = force;
    else state->contacts[p->handle].force = force;
}

/* Returns the direction of the track at a point, which must be in the tissue, not at a guide. */
static inline vec3 point_track(const insertion_state *state, const contact_point *p) {
    return p->kind == POINT_TIP ? state->tip.place.direction : state->contacts[p->handle].direction;
}

/* Returns the state of the shaft at a point, which must be in the tissue, not at a guide. */
static inline const shaft_hold *point_shaft(const insertion_state *state, const contact_point *p) {
    return p->kind == POINT_TIP ? &state->tip.shaft : &state->contacts[p->handle].shaft;
}

#endif

/* The data of one tick: its input, the scratch of its stages, and its output. */
#ifndef TROCAR_TICK_H
#define TROCAR_TICK_H

#include "insertion/state/shaft.h"
#include "insertion/state/stiffening_law.h"
#include "linalg/between_kernels.h"

typedef enum {
    EVENT_TOUCHED = 1 << 0,      /* the tip met the outer surface, from outside or from a gap between bodies */
    EVENT_PUNCTURED = 1 << 1,    /* a membrane was punctured (`membrane` says which) */
    EVENT_ADDED = 1 << 2,        /* a contact became active */
    EVENT_REMOVED = 1 << 3,      /* a contact slipped off the tip */
    EVENT_EXITED = 1 << 4,       /* the tip left the tissue on the far side, or into a gap */
    EVENT_REENTERED = 1 << 5,    /* the tip returned the same way */
    EVENT_WITHDRAWN = 1 << 6,    /* the needle was withdrawn through its entry */
    EVENT_LATE = 1 << 7,         /* the snapshot does not cover the tip, or the resolution there was not measured: the tick used the last known values, or
                                    estimates */
    EVENT_FULL = 1 << 8,         /* MAX_CONTACTS or MAX_STRATA was reached: the shaft has the friction of the last recorded stratum */
    EVENT_UNSTABLE = 1 << 9,     /* the result was not finite: the insertion restarts */
    EVENT_MISSED_GUIDE = 1 << 11, /* the needle passes a guide outside its holes and is not guided; set in every tick */
    EVENT_OUTSIDE_MODEL = 1 << 12, /* the shaft is pushed into a body sideways and bears no force there; set in every tick */
    EVENT_TRACK_DROPPED = 1 << 13, /* no room for another track or point (MAX_TRACKS, MAX_TRACK_POINTS): the needle's oldest track was dropped */
    EVENT_INEXACT = 1 << 14,     /* the passes did not converge within the limit */
} insertion_event;

/* The result of a tick. */
typedef struct {
    vec3 force;                  /* N, world frame: force of the base on the hand */
    vec3 torque;                 /* N m, world frame: torque about the base point */
    double depth;                /* m, length of the track in the tissue, gaps between bodies included */
    int contacts;                /* number of active contacts */
    unsigned events;             /* insertion_event bits of this tick */
    int membrane;                /* index of the membrane punctured in this tick, or -1 */
    int passes, switches;        /* number of passes and of contact switches in this tick */
} tick_output;

typedef enum { INSERTION_TISSUE, INSERTION_NEEDLE, INSERTION_CONTACT, INSERTION_WRENCH, INSERTION_STAGES } insertion_stage;

/* Time spent in the stages of a tick. The caller provides the clock; NULL: nothing is measured. */
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

/* A point of contact of the needle, and the kind of body that it touches. */
typedef enum { POINT_TISSUE, POINT_TIP, POINT_GUIDE } point_kind;
enum { NO_HANDLE = -1 };
typedef struct {
    point_kind kind;
    int handle;              /* its own handle in the snapshot, equal to the slot of its contact; NO_HANDLE for the tip, which is interpolated */
    int guide, face;         /* POINT_GUIDE only */
    double arc;              /* m from the base */
    double lead;             /* m along the needle, from `arc` to the material point of the shaft that the tissue holds (shaft_hold); 0 except near the tip */
    double to_end;           /* m along the needle, from `arc` to the needle's end face; tip only */
    needle_point at;         /* the point on the needle */
    vec3 target;             /* m, position of the touched material without the needle's forces */
    shaft_share share;
    shaft_resistance shaft;  /* resistance to this share of the shaft */
} contact_point;

/* Relaxing tissue in one step: its displacement under the forces f is (yield C) (f + remembered). For elastic tissue, yield is 1 and the rest 0. */
typedef struct {
    double yield;
    double decay[MAX_RELAXATION];            /* decay of each term's memory over the step */
    double weight[MAX_RELAXATION];           /* weight of each term in the remembered force, divided by the yield */
    double residual[MAX_RELAXATION];         /* decay of the snapshot's u_residual since its time */
    remembered_forces remembered[MAX_POINTS]; /* memory by point in tissue, divided by the yield; at the tip, `along` and `twist` are those of the shaft's part
                                                 of the share */
    double face;                             /* N, remembered force on the tip's end face */
    double tip_moved;                        /* m, motion of the tip since the last step */
    vec3 moved[MAX_POINTS];                  /* m, displacement of the tissue by the remembered loads */
    int kept;                                /* number of shares, from the base, that are unchanged since the last step */
    share_memory before[MAX_SHARES];         /* the other shares, as in the last step */
    int before_count;                        /* number of shares in `before` */
    bool before_tip;                         /* the last of these is the tip's */
} creep_step;

/* Linearised contribution of stiffening to a displacement: offset + slope * force. */
typedef struct {
    double force;            /* N, force about which it is linearised */
    double slope;            /* m/N, at most 0 */
    double offset;           /* m */
} linear_shift;

/* Stiffening tissue in one step. Without stiffening, `end` is zero and the other members are unused. */
typedef struct {
    bool any;                                /* tissue at some point may stiffen */
    stiffening_law along[MAX_POINTS], face;  /* laws of the shaft at each point, and of the tip's end face */
    linear_shift shaft[MAX_POINTS], end;
} stiffening_step;

/* The map J from a displacement of the shaft across its axis, in its own frame, to that of the point where its axis intersects the face of a guide, in the
   directions of the grid. A force in the plane of the face exerts J^T times that force on the needle, across it. */
typedef struct {
    double m[2][2], inverse[2][2];
} crossing_map;

/* Contact of a point of the shaft with the edge of a hole. */
typedef struct {
    crossing_map map;
    double offset[2];        /* m, offset of the needle's axis from that of the hole, in the plane of the face */
    bool touched;
    double pulled;           /* N, tensile force of the last pass, if the edge would have to pull */
    double pressed;          /* N, force about which the edge is linearised */
    double normal[2];        /* unit vector from the hole's axis to the needle's point of contact with the edge */
    double lateral[3];       /* m/N, compliance in the needle's frame: xx, xy, yy */
    double rubbing;          /* N, lateral force that bounded the friction in the last pass */
    bool agrees;             /* the needle's position is consistent with the forces of the last pass, within tolerance */
} hole_edge;

/* Resistance that the tip would meet in a step as it advances, as a list of stretches. An obstacle that blocks the tip is the only stretch. */
typedef struct {
    double from;             /* m of slip at which the stretch begins */
    double resistance;       /* N */
    bool stops;              /* true: a membrane or bone, which stops the tip at `from` up to its resistance; false: tissue */
    double viscosity;        /* N s/m, of the tissue */
    open_track track;        /* old track that the tip follows along the stretch */
} stretch_ahead;

typedef struct {
    stretch_ahead stretches[MAX_KNOTS];
    int count;
    int of_knot[MAX_KNOTS];  /* index of the stretch at each knot of the contact problem's staircase, which skips stretches that do not stop the tip */
} resistance_ahead;

/* A copy of everything that the passes change. */
typedef struct {
    needle_state needle;
    vec3 base_shift;                          /* m */
    needle_tip tip;
    guide_contact faces[MAX_GUIDE_POINTS];    /* contacts of the points at guides */
    struct { vec3 force; shaft_hold shaft; } contacts[MAX_POINTS]; /* forces and shaft of the points at contacts, by point */
    int knot;                                 /* knot of the contact problem's staircase */
} pass_checkpoint;

_Static_assert((int)MAX_POINTS <= BETWEEN_POINTS && (int)NEEDLE_POINT_JOINTS == BETWEEN_JOINTS, "the kernels take all points");

/* Motion of the hand in this step. Written by the hand stage. */
typedef struct {
    double carried;          /* m, by which the hand carries the tip forward; INFINITY: not known */
    vec3 end_before;         /* m, previous position of the needle's end */
    vec3 straight_before;    /* m, previous position of the end of a straight needle */
} hand_advance;

/* Intended direction of the tip. Written by the path stage. */
typedef struct {
    vec3 cut_direction;      /* unit nominal direction in which the tip would cut if no old track guided it */
} path_step;

/* The points that take part in the solve. Listed by the tissue stage; `at`, `target`, `lead` and, at the tip, `arc` follow the needle's shape. */
typedef struct {
    int count, guided;               /* number of points; the first `guided` of them are at guides */
    bool tip;                        /* the last of them is the tip */
    int added;                       /* number of contacts that take part for the first time: the last ones */
    contact_point list[MAX_POINTS];  /* guides, then contacts from base to tip */
} contact_points;

/* Compliance of the tissue at the points. Written by the tissue stage. */
typedef struct {
    vec3 free_at_tip;                /* m, u_free at the tip */
    mat3 tip_row[MAX_POINTS];        /* compliance between the tip and each point, world frame, m/N */
    double tip_resolved;             /* 1/m, resolved_field.point at the tip; 0: the mesh counts as rigid at the tip */
    principal_tensor lateral[MAX_POINTS]; /* local compliance across the track, m/N */
    double axial[MAX_AXIAL];         /* local compliance along the track, m/N: at the tip, that of the end face, then that of the adjacent shaft */
    double sideways_on_shaft;        /* fraction of the tip's lateral force on the adjacent shaft; the rest acts on its end face */
    double extra_lateral_compliance[MAX_POINTS];  /* m/N, additional lateral compliance while the surface does not fully hold the tip */
    double tightening[MAX_POINTS];   /* 1/N, decrease of that compliance per metre of depth */
} tissue_step;

/* The damper at the tip (tip_damper.h). */
typedef struct {
    double relaxed;                  /* fraction of the distance to static equilibrium that the tissue at the tip covers in this step */
    double column[MAX_UNKNOWNS];     /* m/N, displacement of the tissue at each unknown under a force along the track at the tip */
    double yield;                    /* m/N, displacement of the tip itself under a force along the track */
} damper_step;

/* The needle's response in one pass. Written by the needle stage. */
typedef struct {
    _Alignas(CACHE_LINE) needle_tangent tangent;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1]; /* N, loads of all points on the joints */
    double drag;                     /* drag of the needle's rotation over the step; 0: the needle is in equilibrium */
} needle_response;

/* A step that is repeated in small increments (continuation.c). */
typedef struct {
    double lag[MAX_UNKNOWNS];        /* m, offset of the gaps from those that balance the forces at the start */
    double kept_open;                /* fraction of that offset that still remains */
} continuation_step;

/* Scratch of one tick, by the stage that writes it. Only the profile outlives the call. */
typedef struct {
    hand_advance hand;
    path_step path;
    contact_points points;
    tissue_step tissue;
    creep_step creep;
    resistance_ahead ahead;
    needle_response response;
    _Alignas(CACHE_LINE) between_components joints_to_points[3 * (NEEDLE_MAX_SEGMENTS + 1)]; /* m/N, world frame, scratch of assemble_between_points */
    hole_edge edges[MAX_GUIDE_POINTS];       /* edges of the points at guides */
    stiffening_step stiffening;
    damper_step damper;
    contact_problem problem;
    pass_checkpoint start;                   /* state before the first pass */
    continuation_step continuation;
    insertion_profile profile;
} insertion_workspace;

/* Mount of the base: a spring to `pose`, its position without force. */
typedef struct {
    pose pose;
    double compliance;       /* m/N, the same in every direction; 0: held rigidly */
} mount;

/* The input of a tick. */
typedef struct {
    const insertion_model *model;
    const compliance_snapshot *snapshot;
    const track_list *others[MAX_NEEDLES - 1]; /* tracks of the other needles in the tissue */
    int other_count;         /* number of entries in `others` */
    mount base;
    double dt;               /* s */
} tick_input;

/* Force of a point on the body that it touches, N, world frame. RT */
static inline vec3 point_force(const insertion_state *state, const contact_point *p) {
    if (p->kind == POINT_GUIDE) return state->guides[p->guide].faces[p->face].force;
    return p->kind == POINT_TIP ? state->tip.solved.force : state->contacts[p->handle].force;
}
static inline void point_set_force(insertion_state *state, const contact_point *p, vec3 force) {
    if (p->kind == POINT_GUIDE) state->guides[p->guide].faces[p->face].force = force;
    else if (p->kind == POINT_TIP) state->tip.solved.force = force;
    else state->contacts[p->handle].force = force;
}

/* Direction of the track at a point in the tissue, which must not be a guide's. */
static inline vec3 point_track(const insertion_state *state, const contact_point *p) {
    return p->kind == POINT_TIP ? state->tip.place.direction : state->contacts[p->handle].direction;
}

#endif

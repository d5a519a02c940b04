/* A rigid probe that presses a named surface of the mesh: unilateral contact without friction at the surface's nodes and the middles of its long
   edges. See docs/mechanics.md, "Probe". Called by the worker, in one thread at a time. */
#ifndef TROCAR_PROBE_H
#define TROCAR_PROBE_H

#include "probe/probe_shape.h"
#include "snapshot/snapshot.h"

enum { MAX_PRESSED = 256 };  /* limit on nodes and on points that take part; of a larger surface, those closest to the probe */

/* A constant place on the surface: a node, or the middle of an edge, which moves as the mean of its ends. */
typedef struct {
    vec3 rest;               /* m, undeformed */
    int ends[2];             /* indices in `surface`; -1: none, or fixed */
    double weight;           /* of each end: 1 for a node, 1/2 for an edge */
    double slack;            /* m: how far it may lie inside the probe; 0 for a node */
    int tet;                 /* an element that contains it, */
    double weights[4];       /* and its barycentric weights there */
} surface_point;

typedef struct {
    int point;
    vec3 normal;             /* out of the probe, where it touches the point */
    double force;            /* N, on the tissue along `normal`, positive */
    vec3 row;                /* the direction in which the point is attached: `normal` at that time */
    vec3 free_force;         /* N: the force if no needle were held */
    double own_compliance;   /* m/N: the point's own compliance; 0 for a node */
} pressed_point;

/* Everything that changes. Plain data. */
typedef struct {
    bool placed;             /* false: the probe has no place yet */
    bool stopped;            /* true: the tissue stopped it before the requested pose */
    pose base;               /* where it is */
    vec3 wrench_force, wrench_torque; /* N, and N m about the base: on the hand that holds it */
    int count;
    pressed_point points[MAX_PRESSED]; /* the pressed points, ascending */
} probe_state;

typedef struct {
    probe_shape shape;
    inverse *beneath;        /* the inverse without the probe; not owned */
    inverse *inverse;        /* the inverse with the pressed nodes attached */
    double max_force;        /* N */
    int surface_count, *surface; /* nodes of the surface that are not fixed, ascending */
    int point_count;
    surface_point *points;   /* first the nodes, in the same order */
    probe_state state;
    uint64_t changes;        /* counts changes of the attached set, */
    uint64_t shifts;         /* and of the free forces */
    uint64_t last_attached;  /* id */
    int attached_count;      /* points */
    int near_count, near[MAX_PRESSED]; /* nodes that can take part, ascending, with */
    double *compliance;      /* m/N: 3 near_count square, row by row; kept while it is valid */
    bool compliance_known;
    int candidate_count, candidates[MAX_PRESSED]; /* points that can take part, ascending: all their ends are near */
    nodal_forces now, unloaded; /* nodal forces of the pressed points: force, and free_force */
    struct probe_scratch *scratch;
    int load_room, *load_nodes; /* loads by others: scratch */
    vec3 *load_forces;
} probe;

/* `surface`: index of a surface of the mesh. `max_force` (N): the probe stops where its force would exceed it. `beneath` must outlive the probe.
   BAD_INPUT if no node of the surface can move. */
trocar_status probe_create(inverse *beneath, const probe_shape *shape, int surface, double max_force, probe **created, report *why);
void probe_free(probe *p);

/* Presses at this pose, with these loads by others on the tissue. `beneath_changed`: the attachments beneath have changed. Moves longer than a
   quarter of the radius are taken in steps. If the force would rise above max_force, the probe stops on its way. If there are more than MOST_STEPS
   steps, or the probe has no place yet, it is placed directly at the pose, unless its axis would lie in the tissue at rest or its force
   exceed max_force: then it stays where it was, stopped. On failure nothing is pressed. Allocates when the set of pressed points changes. */
enum { MOST_STEPS = 16 };
trocar_status probe_press(probe *p, pose base, const other_loads *others, bool beneath_changed, report *why);

/* True if the axis of a probe at this pose, from base to tip, meets the undeformed tissue. */
bool probe_axis_in_tissue(const mesh *m, const probe_shape *shape, pose base);

/* Restores a saved state. */
trocar_status probe_resume(probe *p, const probe_state *state, report *why);

#endif

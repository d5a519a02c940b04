/* A rigid probe that presses a named surface of the mesh: unilateral contact without friction at points of that surface, its nodes and the middles
   of its long edges. See docs/mechanics.md, "Probe". The worker's; one thread at a time. */
#ifndef TROCAR_PROBE_H
#define TROCAR_PROBE_H

#include "probe/probe_shape.h"
#include "remesh/snapshot.h"

enum { MAX_PRESSED = 256 };  /* nodes, and points, that can take part: of a surface with more, those closest to the probe */

/* A place on the surface, constant: a node, or the middle of an edge. It moves as the mean of its ends. */
typedef struct {
    vec3 rest;               /* m, undeformed */
    int ends[2];             /* places in `surface`; -1: none, or fixed */
    double weight;           /* of each end: 1 for a node, 1/2 for an edge */
    double slack;            /* m, that it may lie inside the probe: 0 for a node */
    int tet;                 /* an element that it belongs to, */
    double weights[4];       /* and its barycentric weights there */
} surface_point;

typedef struct {
    int point;
    vec3 normal;             /* out of the probe, where it touches the point */
    double force;            /* N on the tissue along it, above 0 */
    vec3 row;                /* the direction in which the point is attached: `normal` as it was then */
    vec3 free_force;         /* N, the force if no needle were held */
    double own_compliance;   /* m/N, of the point by itself: 0 for a node */
} pressed_point;

/* All that changes. Plain data. */
typedef struct {
    bool placed;             /* false: it is nowhere yet */
    bool stopped;            /* by the tissue, before the pose that was asked for last */
    pose base;               /* where it is */
    vec3 wrench_force, wrench_torque; /* N, N m about the base: on the hand that holds it */
    int count;
    pressed_point points[MAX_PRESSED]; /* those that it presses, ascending */
} probe_state;

typedef struct {
    probe_shape shape;
    inverse *beneath;        /* without the probe, not its own */
    inverse *inverse;        /* with the nodes that it presses attached */
    double max_force;        /* N */
    int surface_count, *surface; /* nodes of the surface that are not fixed, ascending */
    int point_count;
    surface_point *points;   /* first the nodes, in the same order */
    probe_state state;
    uint64_t changes;        /* of what is attached, */
    uint64_t shifts;         /* and of the free forces */
    uint64_t last_attached;  /* id */
    int attached_count;      /* points */
    int near_count, near[MAX_PRESSED]; /* nodes that can take part, ascending, and their */
    double *compliance;      /* m/N: 3 near_count square, row by row; kept while it holds: */
    bool compliance_known;
    int candidate_count, candidates[MAX_PRESSED]; /* points that can take part, ascending: all their ends are near */
    nodal_forces now, unloaded; /* of what it presses: force, and free_force */
    struct probe_scratch *scratch;
    int load_room, *load_nodes; /* of others' loads: scratch */
    vec3 *load_forces;
} probe;

/* `surface`: index of a surface of the mesh. `max_force` (N): where its force exceeds it, the probe goes no farther. `beneath` must outlive it.
   BAD_INPUT if no node of the surface can move. */
trocar_status probe_create(inverse *beneath, const probe_shape *shape, int surface, double max_force, probe **created, report *why);
void probe_free(probe *p);

/* Presses at this pose, with these loads by others on the tissue. `beneath_changed`: what is attached beneath is not what it was. A way of
   more than a quarter of the radius is taken in steps. Where the force would rise above max_force, the probe stops on its way. If there are more
   than MOST_STEPS of them, or it has not been placed, it is put in anew, unless its axis would lie in the tissue at rest or its force exceed
   max_force: then it stays where it was, stopped. On a failure nothing is pressed. Allocates when the set of pressed points changes. */
enum { MOST_STEPS = 16 };
trocar_status probe_press(probe *p, pose base, const other_loads *others, bool beneath_changed, report *why);

/* True if the axis of a probe at this pose, from base to tip, meets the undeformed tissue. */
bool probe_axis_in_tissue(const mesh *m, const probe_shape *shape, pose base);

/* Goes back to a state that was saved. */
trocar_status probe_resume(probe *p, const probe_state *state, report *why);

#endif

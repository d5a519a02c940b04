/* A rigid probe that presses a named surface of the mesh: unilateral contact without friction at the nodes of that surface. See README.md,
   "Probe". The worker's; one thread at a time. */
#ifndef TROCAR_PROBE_H
#define TROCAR_PROBE_H

#include "probe/probe_shape.h"
#include "remesh/snapshot.h"

enum { MAX_PRESSED = 256 };  /* nodes that can take part: of a surface with more, those closest to the probe */

typedef struct {
    int node;
    vec3 normal;             /* out of the probe, where it touches the node */
    double force;            /* N on the tissue along it, above 0 */
    vec3 row;                /* the direction in which the node is attached: `normal` as it was then */
    vec3 free_force;         /* N, the force if no needle were held */
} pressed_node;

/* All that changes. Plain data. */
typedef struct {
    bool placed;             /* false: it is nowhere yet */
    pose base;
    vec3 wrench_force, wrench_torque; /* N, N m about the base: on the hand that holds it */
    int count;
    pressed_node nodes[MAX_PRESSED];  /* those that it presses, ascending */
} probe_state;

typedef struct {
    probe_shape shape;
    inverse *beneath;        /* without the probe, not its own */
    inverse *inverse;        /* with the nodes that it presses attached */
    int surface_count, *surface; /* nodes of the surface that are not fixed, ascending, */
    int *surface_tet;        /* and an element at each */
    probe_state state;
    uint64_t changes;        /* of what is attached, */
    uint64_t shifts;         /* and of the free forces */
    uint64_t last_attached;  /* id */
    int near_count, near[MAX_PRESSED]; /* nodes that can take part, ascending, and their */
    double *compliance;      /* m/N: 3 near_count square, row by row; kept while it holds: */
    bool compliance_known;
    nodal_forces now, unloaded; /* of the pressed nodes: force, and free_force */
    struct probe_scratch *scratch;
    int load_room, *load_nodes; /* of others' loads: scratch */
    vec3 *load_forces;
} probe;

/* `surface`: index of a surface of the mesh. `beneath` must outlive it. BAD_INPUT if no node of the surface can move. */
trocar_status probe_create(inverse *beneath, const probe_shape *shape, int surface, probe **created, report *why);
void probe_free(probe *p);

/* Presses at this pose, with these loads by others on the tissue. `beneath_changed`: what is attached beneath is not what it was. A way of
   more than a quarter of the radius is taken in steps; after more than MOST_STEPS of them it is taken out and put in anew. On a failure nothing
   is pressed. Allocates when the set of pressed nodes changes. */
enum { MOST_STEPS = 16 };
trocar_status probe_press(probe *p, pose base, const other_loads *others, bool beneath_changed, report *why);

/* Goes back to a state that was saved. */
trocar_status probe_resume(probe *p, const probe_state *state, report *why);

#endif

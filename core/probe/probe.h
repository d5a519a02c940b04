/* A rigid probe that presses on a named surface of the mesh: frictionless unilateral contact at the surface's nodes and at the midpoints of its long
   edges. See docs/mechanics.md, "Probe". Called by the worker; not thread-safe. */
#ifndef TROCAR_PROBE_H
#define TROCAR_PROBE_H

#include "probe/probe_shape.h"
#include "probe/support.h"

enum { MAX_PRESSED = 256 };  /* maximum number of nodes, and of points, in contact; on a larger surface, only those closest to the probe are considered */

/* A material point of the surface: either a node or the midpoint of an edge. A midpoint's displacement is the mean of the displacements of the edge's ends. */
typedef struct {
    vec3 rest;               /* m, position in the undeformed tissue */
    int ends[2];             /* indices in `surface`; -1 for a fixed node, or if there is no second end */
    double weight;           /* weight of each end: 1 for a node, 1/2 for an edge */
    double slack;            /* m, how deep the point may lie inside the probe; 0 for a node */
    int tet;                 /* a nominal element that contains the point */
    double weights[4];       /* the point's barycentric coordinates in that element */
} surface_point;

typedef struct {
    int point;
    vec3 normal;             /* outward normal of the probe at the point of contact */
    double force;            /* N, force on the tissue along `normal`, never negative */
    vec3 row;                /* direction in which the point is attached: `normal` as it was at the time */
    vec3 free_force;         /* N, what the force would be without held needles */
    double own_compliance;   /* m/N, compliance in addition to that of the nodes; 0 for a node */
} pressed_point;

/* The mutable state. Plain data. */
typedef struct {
    bool placed;             /* false if the probe has no pose yet */
    bool stopped;            /* the tissue has stopped the probe short of a requested pose, and it has not caught up since */
    pose base;               /* current pose */
    vec3 wrench_force, wrench_torque; /* force (N) and torque (N m) about the base, exerted on the hand that holds the probe */
    int count;
    pressed_point points[MAX_PRESSED]; /* the pressed points, in ascending order */
} probe_state;

typedef struct {
    probe_shape shape;
    inverse *beneath;        /* the inverse without the probe; owned by the caller */
    inverse *inverse;        /* the inverse with the pressed points attached */
    double max_force;        /* N */
    int surface_count, *surface; /* the nodes of the surface that are not fixed, in ascending order */
    int point_count;
    surface_point *points;   /* the nodes in the order of `surface`, then the midpoints */
    probe_state state;
    uint64_t changes;        /* number of changes to the set of attached points */
    uint64_t shifts;         /* number of changes to the free forces */
    uint64_t last_attached;  /* id of the last attachment */
    int attached_count;      /* number of attached points */
    int near_count, near[MAX_PRESSED]; /* the nodes that contact can involve, in ascending order */
    double *compliance;      /* m/N, compliance between the `near` nodes, row-major: 3 near_count rows of 3 MAX_PRESSED, of which the first 3 near_count are
                                used. Kept until it is no longer valid */
    bool compliance_known;
    int candidate_count, candidates[MAX_PRESSED]; /* the points that may be in contact, in ascending order; all their ends are in `near` */
    nodal_forces now, unloaded; /* the pressed points' forces as nodal forces: from `force` and from `free_force` */
    support support;         /* how held needles support the tissue while the contact is solved */
    struct probe_scratch *scratch;
} probe;

/* Creates a probe that presses on the mesh's surface group `surface` and stops when the force reaches `max_force` (N). `beneath` must outlive it. BAD_INPUT if
   all nodes of the surface are fixed. */
trocar_status probe_create(inverse *beneath, const probe_shape *shape, int surface, double max_force, probe **created, trocar_error *why);
void probe_free(probe *p);

/* Moves the probe to `base`, pressing on the tissue. `others`: the other loads on the tissue; those of held needles respond to the probe as given by `holds`.
   `elapsed`: seconds since the last call, which limits how far a stopped probe catches up; INFINITY if simulated time does not advance. `beneath_changed`:
   whether the attachments of `beneath` have changed. Motions longer than a quarter of the radius are divided into steps. If the force would exceed max_force,
   the probe stops on the way, and later catches up at a limited speed. If the motion would take more than MOST_STEPS steps, or the probe has no pose yet, it is
   put at the new pose directly; but if its axis would then intersect the undeformed tissue, or the force would exceed max_force, it stays where it was and
   counts as stopped. After an error, the probe presses on nothing. Allocates when the set of pressed points changes. */
enum { MOST_STEPS = 16 };
trocar_status probe_press(probe *p, pose base, double elapsed, const other_loads *others, const needle_holds *holds, bool beneath_changed,
                          trocar_error *why);

/* Returns whether the axis of a probe at this pose, from base to tip, intersects the undeformed tissue. */
bool probe_axis_in_tissue(const mesh *m, const probe_shape *shape, pose base);

/* Restores a saved state. After an error, the probe presses on nothing. */
trocar_status probe_resume(probe *p, const probe_state *state, trocar_error *why);

#endif

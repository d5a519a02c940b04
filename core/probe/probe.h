/* A rigid probe that presses on a named surface of the mesh: frictionless unilateral contact at the surface's nodes and at the midpoints of its long
   edges. See docs/mechanics.md, "Probe". Called by the worker; not thread-safe. */
#ifndef TROCAR_PROBE_H
#define TROCAR_PROBE_H

#include "probe/probe_shape.h"
#include "probe/support.h"

enum { MAX_PRESSED = 256 };  /* maximum number of nodes, and of points, that can be pressed; on a larger surface, only those closest to the probe are
                                considered */

/* A material point of the surface: a node, or the midpoint of an edge, whose displacement is the mean of its ends' displacements. */
typedef struct {
    vec3 rest;               /* m, position in the undeformed tissue */
    int ends[2];             /* indices in `surface`; -1 if there is none, or if it is fixed */
    double weight;           /* weight of each end: 1 for a node, 1/2 for an edge */
    double slack;            /* m, permitted depth inside the probe; 0 for a node */
    int tet;                 /* a nominal element that contains the point */
    double weights[4];       /* barycentric weights of the point in that element */
} surface_point;

typedef struct {
    int point;
    vec3 normal;             /* outward normal of the probe's surface at the point of contact */
    double force;            /* N, force on the tissue along `normal`, positive */
    vec3 row;                /* direction in which the point is attached: `normal` at the time of attachment */
    vec3 free_force;         /* N, force in the absence of held needles */
    double own_compliance;   /* m/N, the point's own compliance; 0 for a node */
} pressed_point;

/* The mutable state. Plain data. */
typedef struct {
    bool placed;             /* false if the probe has no pose yet */
    bool stopped;            /* true from when the tissue stops the probe short of the requested pose until the probe has caught up with it */
    pose base;               /* current pose */
    vec3 wrench_force, wrench_torque; /* force (N) and torque (N m) about the base, exerted on the hand that holds the probe */
    int count;
    pressed_point points[MAX_PRESSED]; /* the pressed points, in ascending order */
} probe_state;

typedef struct {
    probe_shape shape;
    inverse *beneath;        /* the inverse without the probe; owned by the caller */
    inverse *inverse;        /* the inverse with the pressed nodes attached */
    double max_force;        /* N */
    int surface_count, *surface; /* nodes of the surface that are not fixed, in ascending order */
    int point_count;
    surface_point *points;   /* points of the surface: first the nodes, in the same order as `surface` */
    probe_state state;
    uint64_t changes;        /* number of changes to the set of attached points */
    uint64_t shifts;         /* number of changes to the free forces */
    uint64_t last_attached;  /* id of the last attachment */
    int attached_count;      /* number of attached points */
    int near_count, near[MAX_PRESSED]; /* nodes that can be pressed, in ascending order */
    double *compliance;      /* m/N, compliance between the nodes in `near`: square, 3 near_count rows, row-major; reused as long as it is valid */
    bool compliance_known;
    int candidate_count, candidates[MAX_PRESSED]; /* points that can be pressed, in ascending order; all their ends are in `near` */
    nodal_forces now, unloaded; /* nodal forces of the pressed points, from `force` and from `free_force` */
    support support;         /* how held needles support the tissue while the contact is solved */
    struct probe_scratch *scratch;
} probe;

/* Creates a probe that presses on the mesh's surface group `surface`. `max_force` (N): force at which the probe stops. `beneath` must outlive the
   probe. BAD_INPUT if all nodes of the surface are fixed. */
trocar_status probe_create(inverse *beneath, const probe_shape *shape, int surface, double max_force, probe **created, trocar_error *why);
void probe_free(probe *p);

/* Presses the probe against the tissue at this pose. `others`: the other loads on the tissue; those of held needles respond to the probe according to `holds`.
   `elapsed`: s since the last call, the time that a stopped probe has had to catch up; INFINITY if simulated time does not advance. `beneath_changed`: the
   attachments of `beneath` have changed. Motions longer than a quarter of the radius are divided into steps. If the force would exceed max_force, the probe
   stops on its path, and then catches up at a limited speed. If the motion would take more than MOST_STEPS steps, or if the probe has no pose yet, it is placed
   directly at the pose. If in this case its axis would intersect the tissue at rest, or its force would exceed max_force, it stays where it was and counts as
   stopped. After a failure, the probe presses on nothing. Allocates when the set of pressed points changes. */
enum { MOST_STEPS = 16 };
trocar_status probe_press(probe *p, pose base, double elapsed, const other_loads *others, const needle_holds *holds, bool beneath_changed,
                          trocar_error *why);

/* True if the axis of a probe at this pose, from its base to its tip, intersects the undeformed tissue. */
bool probe_axis_in_tissue(const mesh *m, const probe_shape *shape, pose base);

/* Restores a saved state. After a failure, the probe presses on nothing. */
trocar_status probe_resume(probe *p, const probe_state *state, trocar_error *why);

#endif

/* How held needles support the tissue while the probe's contact is solved. The needles exert the forces of their last ticks, plus their response to the probe:
   if the probe has displaced the tissue at their contacts by d since then, the forces change by df = -(C + G)^-1 d, where C is the tissue's compliance between
   these contacts and G that of the needle's side of the contact problem (needle_hold). See docs/mechanics.md, "Probe". Called by the worker; not
   thread-safe. */
#ifndef TROCAR_PROBE_SUPPORT_H
#define TROCAR_PROBE_SUPPORT_H

#include "inverse/inverse_attached.h"
#include "snapshot/needle_hold.h"

typedef struct {
    int corners[4];          /* indices in `nodes` of the corners of the element in which the force acts */
    double weights[4];       /* barycentric; 0 if the force does not act on the tissue */
    vec3 direction;          /* unit vector */
} supporting_row;

typedef struct {
    inverse *tissue;         /* the inverse without the probe or the held needles; owned by the caller */
    int most;                /* maximum number of nodes passed to support_reach, and of points passed to support_stiffen */
    int node_count, *nodes;  /* nodes on which held needles exert forces, without duplicates */
    vec3 *force;             /* N, forces on these nodes at the last ticks */
    vec3 *force_now;         /* N, forces on these nodes, including the response to the probe */
    int row_count;           /* number of rows of all needles */
    supporting_row *rows;
    double *factor;          /* row_count square, column-major: factors of C + G, which is indefinite if a needle would buckle without the tissue */
    int *pivots;
    double *before;          /* N, row_count: (C + G)^-1 d for the displacements d under the probe's forces at the last ticks */
    int reach_count;
    double *reached;         /* m/N, row_count x 3 reach_count, column-major: compliance between the rows and the nodes that the probe reaches */
    double *responses;       /* (C + G)^-1 times `reached`: reaction of the rows to a unit force on each of these nodes */
    double *blocks, *columns, *response; /* scratch. `blocks`: compliance between `nodes` and other nodes; `columns`: 2 `most` columns of row_count entries;
                                            `response`: one such column */
    int node_room, row_room; /* number of nodes and number of rows for which memory has been allocated */
} support;

void support_free(support *s);

/* Lists in `nodes` the nodes on which held needles exert forces, and in `force` these forces. Also lists the nodes at which the needles support the tissue
   without exerting a force. */
trocar_status support_list(support *s, const other_loads *others, const needle_holds *holds, trocar_error *why);

/* Prepares the needles' response to the probe. `pressed`: the probe's forces at the needles' last ticks. Call support_list first. */
trocar_status support_prepare(support *s, const needle_holds *holds, const nodal_forces *pressed, trocar_error *why);

/* Sets the reached nodes, on which the probe can exert forces, and adds to `u` the displacements (m) that the needles would cause at these nodes without the
   probe. */
trocar_status support_reach(support *s, int count, const int *nodes, vec3 *u, trocar_error *why);

/* Adds the effect of the needles' response to the probe's forces `load` (N) to the displacements `u` (m). Both arrays have an entry for each reached node. */
void support_displace(const support *s, const vec3 *load, vec3 *u);

/* A unit force of the probe on a point, divided between reached nodes. */
typedef struct {
    int ends[2];             /* indices among the reached nodes; -1 if there is none */
    vec3 along;              /* force on each end: the direction of the unit force, times the weight of an end */
} unit_force;

/* Reduces the compliance (m/N) between these points, `count` square with leading dimension `ld`, by the effect of the needles' response. */
void support_stiffen(const support *s, int count, const unit_force *points, double *compliance, int ld);

/* Returns the held needles' forces on nodes, including their response to the probe's forces `load` (N) on the reached nodes. */
nodal_forces support_forces(const support *s, const vec3 *load);

#endif

/* How held needles support the tissue while the probe's contact is solved. Each needle exerts the forces of its last tick, plus a response to the probe: if the
   probe has since displaced the tissue at the needles' contacts by d, the forces change by -(C + G)^-1 d. C is the tissue's compliance between these contacts,
   and G that of the needles' side of the contact problem (needle_hold). See docs/mechanics.md, "Probe". Called by the worker; not thread-safe. */
#ifndef TROCAR_PROBE_SUPPORT_H
#define TROCAR_PROBE_SUPPORT_H

#include "inverse/inverse_attached.h"
#include "snapshot/needle_hold.h"

typedef struct {
    int corners[4];          /* corners of the element in which the force acts, as indices in `nodes` */
    double weights[4];       /* barycentric; all 0 if the force does not act on the tissue */
    vec3 direction;          /* unit vector */
} supporting_row;

typedef struct {
    inverse *tissue;         /* the inverse without the probe and the held needles; owned by the caller */
    int most;                /* maximum number of nodes passed to support_reach and of points passed to support_stiffen */
    int node_count, *nodes;  /* the nodes on which held needles act, without duplicates */
    vec3 *force;             /* N, forces on these nodes at the last ticks */
    vec3 *force_now;         /* N, the same forces plus the response to the probe */
    int row_count;           /* number of rows of all needles */
    supporting_row *rows;
    double *factor;          /* factors of C + G, row_count square, column-major. C + G is indefinite if a needle would buckle without the tissue */
    int *pivots;
    double *before;          /* N, row_count entries: (C + G)^-1 d, where d are the displacements due to the probe's forces at the last ticks */
    int reach_count;
    double *reached;         /* m/N, row_count x 3 reach_count, column-major: compliance between the rows and the nodes in the probe's reach */
    double *responses;       /* (C + G)^-1 times `reached`: how the rows react to unit forces on these nodes */
    double *blocks, *columns, *response; /* scratch. `blocks`: compliance between `nodes` and other nodes. `columns`: 2 `most` columns of row_count entries.
                                            `response`: one such column */
    int node_room, row_room; /* nodes and rows for which memory is allocated */
} support;

void support_free(support *s);

/* Lists the nodes on which held needles act in `nodes`, and the forces on them in `force`. Includes nodes that the needles support without exerting a force on
   them. */
trocar_status support_list(support *s, const other_loads *others, const needle_holds *holds, trocar_error *why);

/* Prepares the needles' response to the probe. `pressed`: the probe's forces at the needles' last ticks. Call support_list first. */
trocar_status support_prepare(support *s, const needle_holds *holds, const nodal_forces *pressed, trocar_error *why);

/* Sets which nodes the probe can reach, and adds to `u` how far (m) the needles alone would displace them. */
trocar_status support_reach(support *s, int count, const int *nodes, vec3 *u, trocar_error *why);

/* Adds to `u` (m) how the needles' response to the probe's forces `load` (N) displaces the reached nodes. Both arrays have one entry per reached node. */
void support_displace(const support *s, const vec3 *load, vec3 *u);

/* A unit force of the probe at a point, divided between the reached nodes at the point's ends. */
typedef struct {
    int ends[2];             /* indices among the reached nodes; -1 if none */
    vec3 along;              /* the force on each end: the unit force's direction times the ends' weight */
} unit_force;

/* Reduces the compliance (m/N) between these points by the needles' response, which stiffens the tissue. The matrix is `count` square, with leading dimension
   `ld`. */
void support_stiffen(const support *s, int count, const unit_force *points, double *compliance, int ld);

/* Returns the nodal forces of the held needles, including their response to the probe's forces `load` (N) on the reached nodes. */
nodal_forces support_forces(const support *s, const vec3 *load);

#endif

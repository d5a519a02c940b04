/* How held needles support the tissue while the probe's contact is solved. Their forces are those of their last ticks. Where the probe displaces the tissue
   at their contacts by d, they change by df = -(C + G)^-1 d, with C the tissue's compliance between these contacts and G that of the needle's side of the
   contact problem (needle_hold). See docs/mechanics.md, "Probe". Called by the worker; not thread-safe. */
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
    inverse *tissue;         /* the inverse without probe and held needles; owned by the caller */
    int most;                /* largest number of nodes that the probe reaches, and of its points */
    int node_count, *nodes;  /* nodes on which held needles exert forces, without duplicates */
    vec3 *force;             /* N, on these nodes, at the last ticks */
    vec3 *force_now;         /* N, on these nodes, as changed by the supports */
    int row_count;           /* of all needles */
    supporting_row *rows;
    double *factor;          /* row_count square, column-major: factors of C + G, which is indefinite if a needle would buckle without the tissue */
    int *pivots;
    double *before;          /* N, row_count: (C + G)^-1 d for the displacements d under the probe's forces at the last ticks */
    int reach_count;
    double *reached;         /* m/N, row_count x 3 reach_count, column-major: compliance between the rows and the nodes that the probe reaches */
    double *responses;       /* (C + G)^-1 times `reached`: what the rows take up of a unit force on each of these nodes */
    double *blocks, *columns, *response; /* scratch: blocks between `nodes` and other nodes; 2 `most` columns, and one column, of row_count entries */
    int node_room, row_room;
} support;

void support_free(support *s);

/* Lists the forces of held needles on nodes, in `nodes` and `force`; also lists nodes without forces at which the needles hold the tissue. */
trocar_status support_list(support *s, const other_loads *others, const needle_holds *holds, report *why);

/* Prepares the supports. `pressed`: the probe's forces at the last ticks. To be called after support_list. */
trocar_status support_prepare(support *s, const needle_holds *holds, const nodal_forces *pressed, report *why);

/* Prepares for forces on these nodes, and adds to their displacements `u` (m) those that would remain without the probe. */
trocar_status support_reach(support *s, int count, const int *nodes, vec3 *u, report *why);

/* Subtracts from the displacements `u` (m) of the reached nodes what the supports take up of the probe's forces `load` (N) on them. */
void support_displace(const support *s, const vec3 *load, vec3 *u);

/* A unit force of the probe at a point: it acts along `along` on the reached nodes `ends`, -1 if there is none. */
typedef struct {
    int ends[2];
    vec3 along;              /* of the length of each end's weight */
} unit_force;

/* Subtracts from the compliance (m/N) between these points, an array of `count` square, what the supports take up. */
void support_stiffen(const support *s, int count, const unit_force *points, double *compliance, int ld);

/* Returns the forces of held needles on nodes, as changed by the probe's forces `load` (N) on the reached nodes. */
nodal_forces support_forces(const support *s, const vec3 *load);

#endif

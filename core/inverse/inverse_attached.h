/* The inverse of a stiffness matrix with attachments to the tissue, such as resting needles: a low-rank correction to a base inverse, which stays unchanged.
   See docs/mechanics.md, "Resting needles". Not thread-safe. */
#ifndef TROCAR_INVERSE_ATTACHED_H
#define TROCAR_INVERSE_ATTACHED_H

#include "inverse/inverse.h"

/* A row: one component of the force on the tissue at a point. */
typedef struct {
    int tet;                 /* nominal element, or -1: the force does not act on the tissue */
    double weights[4];       /* barycentric */
    vec3 direction;          /* unit vector */
} attached_row;

/* One attachment. When other loads displace its rows by d, the change df of its forces closes all gaps, and an attachment that is free to move stays in
   equilibrium, with motions q: (G + C) df = R q - d, R^T df = 0. C: compliance of the tissue between its rows and those of all other attachments. */
typedef struct {
    uint64_t id;             /* an attachment with the same id as before is unchanged */
    int row_count;
    const attached_row *rows;
    const double *compliance; /* G, row_count square, lower triangle: [i * ld + j], j <= i, m/N; positive semidefinite, and definite together with C; 0: a
                                 rigid attachment */
    int ld;
    const double *mutual;    /* compliance between its rows and those of all attachments before it, in their order, that the mesh does not resolve: [i *
                                mutual_ld + j], m/N; NULL: none. Semidefinite together with the compliances of all attachments */
    int mutual_ld;
    int motion_count;        /* independent motions that only its rows resist */
    const double *motions;   /* R, displacement of each row under each motion: [motion * motion_ld + row] */
    int motion_ld;
} attachment;

/* Creates an inverse without attachments, which equals `base`. `base` must outlive it. */
trocar_status inverse_create_attached(inverse *base, inverse **created, report *why);

/* Replaces all attachments by these, in this order; the descriptions are copied. The cost is one factorisation of the size of all rows together, plus blocks
   of the base inverse for new attachments. After a failure nothing is attached. Allocates. */
trocar_status inverse_attach(inverse *inv, int count, const attachment *things, report *why);

int inverse_attached_rows(const inverse *inv);    /* number of rows of all attachments */
int inverse_attached_motions(const inverse *inv); /* number of motions of all attachments */

/* Forces on nodes. */
typedef struct {
    int count;
    const int *nodes;
    const vec3 *force;       /* N */
} nodal_forces;

/* Response of the attachments to these forces: changes of the forces at all rows (N), and all motions. */
trocar_status inverse_attached_response(inverse *inv, const nodal_forces *loads, double *force, double *motion, report *why);

/* Response to a unit displacement of each of these rows: force[k * rows + i], motion[k * motions + i]. */
void inverse_attached_columns(inverse *inv, int count, const int *rows, double *force, double *motion);

/* Response to displacements of all rows (m). */
void inverse_attached_displaced(inverse *inv, const double *displacement, double *force, double *motion);

/* Adds the displacements of nodes (m) that forces at all rows would cause without attachments. */
trocar_status inverse_attached_displace(inverse *inv, const double *force, int count, const int *nodes, vec3 *displacement, report *why);

#endif

/* The inverse of a stiffness matrix with attachments to the tissue, such as resting needles: a low-rank correction to an inverse that is not changed.
   See docs/mechanics.md, "Resting needles". One thread at a time. */
#ifndef TROCAR_INVERSE_ATTACHED_H
#define TROCAR_INVERSE_ATTACHED_H

#include "inverse/inverse.h"

/* One component of the force on the tissue at a point. */
typedef struct {
    int tet;                 /* nominal element, or -1: the force acts on something else than the tissue */
    double weights[4];       /* barycentric */
    vec3 direction;          /* unit vector */
} attached_row;

/* One attachment. The change df of its forces under displacements d of its rows by other loads closes all gaps, and leaves an attachment that is free
   to move in equilibrium, with motions q: (G + C) df = R q - d, R^T df = 0. C: compliance of the tissue between its rows and those of all other
   attachments. */
typedef struct {
    uint64_t id;             /* an attachment with the same id as before is unchanged */
    int row_count;
    const attached_row *rows;
    const double *compliance; /* G, row_count square, lower triangle: [i * ld + j], j <= i, m/N; positive semidefinite, and definite together with C;
                                 0: a rigid attachment */
    int ld;
    const double *mutual;    /* compliance between its rows and those of all attachments before it, in their order: [i * mutual_ld + j], m/N; NULL:
                                none. Not part of what the mesh resolves; semidefinite together with the compliances of all */
    int mutual_ld;
    int motion_count;        /* independent motions that only its rows resist */
    const double *motions;   /* R, displacement of each row under each motion: [motion * motion_ld + row] */
    int motion_ld;
} attachment;

/* Starts without attachments, and then answers what `base` answers. `base` must outlive it. */
trocar_status inverse_create_attached(inverse *base, inverse **created, report *why);

/* Replaces all attachments by these, in this order; the descriptions are copied. Takes one factorisation with as many rows as they have together and,
   for a new attachment, blocks of the base's inverse. After a failure nothing is attached. Allocates. */
trocar_status inverse_attach(inverse *inv, int count, const attachment *things, report *why);

int inverse_attached_rows(const inverse *inv);    /* of all things */
int inverse_attached_motions(const inverse *inv); /* likewise */

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

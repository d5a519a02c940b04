/* The inverse of a stiffness matrix with attachments to the tissue, such as resting needles: a low-rank correction to a base inverse, which remains
   unchanged. See docs/mechanics.md, "Resting needles". Not thread-safe. */
#ifndef TROCAR_INVERSE_ATTACHED_H
#define TROCAR_INVERSE_ATTACHED_H

#include "inverse/inverse.h"

/* A row of an attachment: one component of the force on the tissue at a point. */
typedef struct {
    int tet;                 /* nominal element; -1 if the force does not act on the tissue */
    double weights[4];       /* barycentric */
    vec3 direction;          /* unit vector */
} attached_row;

/* One attachment. When other loads displace its rows by d, its forces change by df, which closes all gaps; if the attachment is free to move, its motions
   q keep it in equilibrium: (G + C) df = R q - d, R^T df = 0. C is the compliance of the tissue between its rows and those of all other attachments. */
typedef struct {
    uint64_t id;             /* if an attachment with this id existed before, it is unchanged */
    int row_count;
    const attached_row *rows;
    const double *compliance; /* m/N, G, row_count square, lower triangle: [i * ld + j], j <= i. Positive semidefinite, and definite together with C; 0 for
                                 a rigid attachment */
    int ld;
    const double *mutual;    /* m/N, the part, finer than the mesh, of the compliance between its rows and those of all earlier attachments, in order:
                                [i * mutual_ld + j]; NULL if there is none. Semidefinite together with the compliances of all attachments */
    int mutual_ld;
    int motion_count;        /* number of independent motions that only the attachment's rows resist */
    const double *motions;   /* R, displacement of each row under each motion: [motion * motion_ld + row] */
    int motion_ld;
} attachment;

/* Creates an inverse without attachments, which is equal to `base`. `base` must outlive it. */
trocar_status inverse_create_attached(inverse *base, inverse **created, trocar_error *why);

/* Replaces all attachments by these, in this order; their descriptions are copied. The cost is one factorisation whose size is the total number of rows, plus
   blocks of the base inverse for new attachments. After a failure, nothing is attached. Allocates. */
trocar_status inverse_attach(inverse *inv, int count, const attachment *things, trocar_error *why);

int inverse_attached_rows(const inverse *inv);    /* number of rows of all attachments */
int inverse_attached_motions(const inverse *inv); /* number of motions of all attachments */

/* Forces on nodes. */
typedef struct {
    int count;
    const int *nodes;
    const vec3 *force;       /* N */
} nodal_forces;

/* Computes the response of the attachments to these forces: the changes in the forces at all rows (N), and all motions. */
trocar_status inverse_attached_response(inverse *inv, const nodal_forces *loads, double *force, double *motion, trocar_error *why);

/* Computes the response to a unit displacement of each of these rows: force[k * rows + i], motion[k * motions + i]. */
void inverse_attached_columns(inverse *inv, int count, const int *rows, double *force, double *motion);

/* Computes the response to displacements (m) of all rows. */
void inverse_attached_displaced(inverse *inv, const double *displacement, double *force, double *motion);

/* Computes the displacements (m) of all rows under forces (N) at all rows, by the compliances of tissue and attachments: (G + C) force. */
void inverse_attached_yield(const inverse *inv, const double *force, double *displacement);

/* Adds the displacements (m) of all rows that forces on nodes would cause if nothing were attached. */
trocar_status inverse_attached_under(inverse *inv, const nodal_forces *loads, double *displacement, trocar_error *why);

/* Adds the displacements (m) of nodes that forces at all rows would cause if nothing were attached. */
trocar_status inverse_attached_displace(inverse *inv, const double *force, int count, const int *nodes, vec3 *displacement, trocar_error *why);

#endif

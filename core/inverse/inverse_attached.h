/* The inverse for tissue with attachments, such as resting needles: a low-rank correction to a base inverse, which stays unchanged. See docs/mechanics.md,
   "Resting needles". Not thread-safe. */
#ifndef TROCAR_INVERSE_ATTACHED_H
#define TROCAR_INVERSE_ATTACHED_H

#include "inverse/inverse.h"

/* A row of an attachment: one component of the force on the tissue at a point. */
typedef struct {
    int tet;                 /* tetrahedron of the nominal mesh that contains the point; -1 if the force does not act on the tissue */
    double weights[4];       /* barycentric coordinates of the point */
    vec3 direction;          /* unit vector along the component */
} attached_row;

/* One attachment. When other loads displace its rows by d, its forces change by df to close all gaps, and its free motions, if it has any, change by q to keep
   it in equilibrium: (G + C) df = R q - d, R^T df = 0. C is the compliance of the tissue between the rows of all attachments. */
typedef struct {
    uint64_t id;             /* an attachment that keeps its id must not change its rows */
    int row_count;
    const attached_row *rows;
    const double *compliance; /* m/N, the lower triangle of G, row_count square: [i * ld + j], j <= i. G is positive semidefinite, and G + C positive definite;
                                 G = 0 for a rigid attachment */
    int ld;
    const double *mutual;    /* m/N, compliance between its rows and those of all earlier attachments, in order, as far as the mesh is too coarse to resolve it:
                                [i * mutual_ld + j]; NULL if there is none. Positive semidefinite together with the compliances of all attachments */
    int mutual_ld;
    int motion_count;        /* number of independent motions that only the attachment's rows resist */
    const double *motions;   /* R, the displacement of each row in each motion: [motion * motion_ld + row] */
    int motion_ld;
} attachment;

/* Creates an inverse without attachments, equal to `base`, which must outlive it. */
trocar_status inverse_create_attached(inverse *base, inverse **created, trocar_error *why);

/* Replaces all attachments with these, in this order, and copies their descriptions. Costs one dense factorisation of the size of the total number of rows,
   plus blocks of the base inverse for new attachments. On failure, nothing is attached. Allocates. */
trocar_status inverse_attach(inverse *inv, int count, const attachment *things, trocar_error *why);

int inverse_attached_rows(const inverse *inv);    /* total number of rows of all attachments */
int inverse_attached_motions(const inverse *inv); /* total number of motions of all attachments */

/* Forces on nodes. */
typedef struct {
    int count;
    const int *nodes;
    const vec3 *force;       /* N */
} nodal_forces;

/* Computes the response of the attachments to these forces: the changes in the forces at all rows (N), and all motions. */
trocar_status inverse_attached_response(inverse *inv, const nodal_forces *loads, double *force, double *motion, trocar_error *why);

/* Computes the response to a unit displacement of each of the `count` given rows in turn. Writes it to force[k * rows + i] and motion[k * motions + i], where
   rows and motions are the total numbers. */
void inverse_attached_columns(inverse *inv, int count, const int *rows, double *force, double *motion);

/* Computes the response to displacements (m) of all rows. */
void inverse_attached_displaced(inverse *inv, const double *displacement, double *force, double *motion);

/* Computes (G + C) force: how far (m) all rows yield under forces (N) at all rows, given the compliance of tissue and attachments. */
void inverse_attached_yield(const inverse *inv, const double *force, double *displacement);

/* Adds to `displacement` the displacements (m) of all rows that forces on nodes would cause if nothing were attached. */
trocar_status inverse_attached_under(inverse *inv, const nodal_forces *loads, double *displacement, trocar_error *why);

/* Adds to `displacement` the displacements (m) of nodes that forces (N) at all rows would cause if nothing were attached. */
trocar_status inverse_attached_displace(inverse *inv, const double *force, int count, const int *nodes, vec3 *displacement, trocar_error *why);

#endif

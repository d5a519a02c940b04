/* The inverse of a stiffness matrix with things attached to the tissue, such as needles that rest in it: a correction of low rank to an
   inverse that stays as it is. See docs/mechanics.md, "Resting needles". One thread at a time. */
#ifndef TROCAR_INVERSE_ATTACHED_H
#define TROCAR_INVERSE_ATTACHED_H

#include "inverse/inverse.h"

/* A component of the force on the tissue at a point. */
typedef struct {
    int tet;                 /* nominal element, or -1: the force acts on something else, and does not reach the tissue */
    double weights[4];       /* barycentric */
    vec3 direction;          /* unit vector */
} attached_row;

/* One thing. The change df of its forces under displacements d of its rows by other loads closes all gaps, and leaves a thing that
   is free to move in equilibrium, its motions being q:

       (G + C) df = R q - d,      R^T df = 0,      C: compliance of the tissue between its rows, and those of all other things */
typedef struct {
    uint64_t id;             /* what is attached under the same id stays as it was */
    int row_count;
    const attached_row *rows;
    const double *compliance; /* G, row_count square, lower triangle: [i * ld + j], j <= i, m/N; positive semidefinite, and definite
                                 with C: 0 is a rigid thing */
    int ld;
    const double *mutual;    /* and between its rows and those of all things before it, in their order: [i * mutual_ld + j], m/N; NULL: none. Not a part
                                of what the mesh resolves: semidefinite together with the compliances of all */
    int mutual_ld;
    int motion_count;        /* independent motions that nothing but its rows resists */
    const double *motions;   /* R, displacement of each row under each: [motion * motion_ld + row] */
    int motion_ld;
} attachment;

/* Nothing is attached at first: then it answers what `base` answers, which must outlive it. */
trocar_status inverse_create_attached(inverse *base, inverse **created, report *why);

/* Attaches these, in this order, in place of what was attached before; the descriptions are copied. Takes one factorisation, of as many
   rows as they have together; and of an attachment that is new, blocks of the base's inverse. On a failure nothing is attached. Allocates. */
trocar_status inverse_attach(inverse *inv, int count, const attachment *things, report *why);

int inverse_attached_rows(const inverse *inv);    /* of all things */
int inverse_attached_motions(const inverse *inv); /* likewise */

/* Forces on nodes. */
typedef struct {
    int count;
    const int *nodes;
    const vec3 *force;       /* N */
} nodal_forces;

/* How the things respond to these forces: the changes of the forces at all rows (N), and of all motions. */
trocar_status inverse_attached_response(inverse *inv, const nodal_forces *loads, double *force, double *motion, report *why);

/* The same to a unit displacement of each of these rows: force[k * rows + i], motion[k * motions + i]. */
void inverse_attached_columns(inverse *inv, int count, const int *rows, double *force, double *motion);

/* The same to displacements of all rows (m). */
void inverse_attached_displaced(inverse *inv, const double *displacement, double *force, double *motion);

/* Adds the displacements of nodes (m) that forces at all rows would cause if nothing were attached. */
trocar_status inverse_attached_displace(inverse *inv, const double *force, int count, const int *nodes, vec3 *displacement, report *why);

#endif

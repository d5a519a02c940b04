/* The whole inverse of the refined stiffness, as stored by the paper: shared by the methods that update it. */
#ifndef TROCAR_REMESH_DENSE_H
#define TROCAR_REMESH_DENSE_H

#include "remesh/remesh.h"
#include "remesh/remesh_method.h"

typedef struct dense_remesher dense_remesher;

/* A change of the stiffness at `count` dofs, the last `fresh` of which (0 or 3, of an added node) are new. */
typedef struct {
    int n;                   /* dofs up to the last one in use */
    int first;               /* dofs touched by all changes before */
    int count, fresh;
    int dofs[MAX_RANK];
    double change[MAX_RANK * MAX_RANK]; /* count square, N/m */
} dense_change;

typedef struct {
    trocar_status (*update)(dense_remesher *, const dense_change *, report *); /* adds a change to the stiffness */
    trocar_status (*undo)(dense_remesher *, const dense_change *, report *);   /* removes a change: any, or only the last one */
    bool any_order;
    int ranks;               /* number of columns of `columns` and `weighted` that the method needs */
} dense_operations;

struct dense_remesher {
    remesher shared;
    const dense_operations *operations;
    dense_change change;
    bool spoilt;             /* an update or undo has failed, and the matrix must be rebuilt */
    int ranks[MAX_CONTACTS]; /* by slot: dofs that each contact node touches */
    int ld;                  /* of `matrix` */
    double *nominal;         /* inverse of the nominal mesh, dof_count square, m/N */
    double *matrix;          /* inverse, column-major, lower triangle: nominal dofs, then three for each contact node, m/N */
    double *columns, *weighted;        /* ld x ranks, column-major */
    double block[MAX_RANK * MAX_RANK]; /* scratch */
};

trocar_status remesher_create_woodbury(inverse *inv, remesher **created, report *why);
trocar_status remesher_create_woodbury_general(inverse *inv, remesher **created, report *why);
trocar_status remesher_create_bcs(inverse *inv, remesher **created, report *why);
trocar_status remesher_create_bcs_blocked(inverse *inv, remesher **created, report *why);

/* Functions that the methods share. */
trocar_status dense_remesher_create(inverse *inv, const dense_operations *operations, remesher **created, report *why);

/* Copies the symmetric columns of some dofs, or stores them back. */
void dense_take_columns(const dense_remesher *r, int n, int count, const int *dofs, double *columns);
void dense_put_columns(dense_remesher *r, int n, int count, const int *dofs, const double *columns);

/* Rows and columns of the fresh dofs become zero, with `diagonal` on the diagonal. */
void dense_isolate(dense_remesher *r, const dense_change *change, double diagonal);

#endif

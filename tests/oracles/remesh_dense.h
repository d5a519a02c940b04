/* The whole inverse of the refined stiffness, stored as in the paper and shared by the methods that update it. */
#ifndef TROCAR_REMESH_DENSE_H
#define TROCAR_REMESH_DENSE_H

#include "oracles/remesh_methods.h"
#include "remesh/remesh_method.h"

typedef struct dense_remesher dense_remesher;

/* A change in the stiffness at `count` dofs. The last `fresh` of them are new: 3 for an added node, otherwise 0. */
typedef struct {
    int n;                   /* number of dofs up to the last one in use */
    int first;               /* dofs affected by all previous changes */
    int count, fresh;
    int dofs[MAX_RANK];
    double change[MAX_RANK * MAX_RANK]; /* count square, N/m */
} dense_change;

typedef struct {
    trocar_status (*update)(dense_remesher *, const dense_change *, trocar_error *); /* adds a change to the stiffness */
    trocar_status (*undo)(dense_remesher *, const dense_change *, trocar_error *); /* removes a change; some methods can only remove the last one */
    bool any_order;
    int ranks;               /* columns of `columns` and `weighted` that the method needs */
} dense_operations;

struct dense_remesher {
    remesher shared;
    const dense_operations *operations;
    dense_change change;
    bool spoilt;             /* an update or undo has failed, so the matrix must be rebuilt */
    int ranks[MAX_CONTACTS]; /* dofs affected by each contact node, by slot */
    int ld;                  /* of `matrix` */
    double *nominal;         /* m/N, inverse of the nominal mesh, dof_count x dof_count */
    double *matrix;          /* m/N, lower triangle of the inverse, column-major: nominal dofs, then three for each contact node */
    double *columns, *weighted;        /* ld x ranks each, column-major */
    double block[MAX_RANK * MAX_RANK]; /* scratch */
};

trocar_status remesher_create_implicit(inverse *inv, remesher **created, trocar_error *why); /* the only one of these methods that stores no dense inverse */
trocar_status remesher_create_woodbury(inverse *inv, remesher **created, trocar_error *why);
trocar_status remesher_create_woodbury_general(inverse *inv, remesher **created, trocar_error *why);
trocar_status remesher_create_bcs(inverse *inv, remesher **created, trocar_error *why);
trocar_status remesher_create_bcs_blocked(inverse *inv, remesher **created, trocar_error *why);

/* Functions shared by the methods. */
trocar_status dense_remesher_create(inverse *inv, const dense_operations *operations, remesher **created, trocar_error *why);

/* Copies the columns of some dofs out of the symmetric matrix, or into it. */
void dense_take_columns(const dense_remesher *r, int n, int count, const int *dofs, double *columns);
void dense_put_columns(dense_remesher *r, int n, int count, const int *dofs, const double *columns);

/* Sets the rows and columns of the fresh dofs to zero and their diagonal entries to `diagonal`. */
void dense_isolate(dense_remesher *r, const dense_change *change, double diagonal);

#endif

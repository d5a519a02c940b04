/* How long the remesher takes to put one contact node into the inverse, and to take it out again. */
#ifndef TROCAR_REMESH_TIMING_H
#define TROCAR_REMESH_TIMING_H

#include "remesh/remesh.h"
#include "timing.h"

typedef enum { ADD_INSIDE, ADD_ON_FACE, MOVE_NODE, REMESH_CHANGES } remesh_change;

typedef struct {
    remesh_method method;
    remesh_change change;
    int touched;             /* of moved nodes only those whose patch has this many nodes; 0: any */
    int contacts;            /* contact nodes that are there already, added in the same way (inside, where nodes are moved) */
    int samples;             /* at most, */
    double seconds;          /* and after this time none but the first three */
} remesh_case;

typedef struct {
    int samples;             /* 0 where the mesh has no such node */
    histogram add, remove;   /* remesher_serve: from the request to the snapshot, the window's nodes being known */
} remesh_timing;

const char *remesh_change_name(remesh_change change);

/* In the calling thread; BAD_INPUT and the like as from remesher_create. */
trocar_status remesh_timing_measure(inverse *inv, const remesh_case *wanted, remesh_timing *result, report *why);

/* For each number of nodes in the patch (0 .. MAX_PATCH) how many of the mesh's nodes may move. */
void remesh_timing_valences(const tissue *t, int counts[MAX_PATCH + 1]);

#endif

/* Measures how long the remesher takes to add a contact node to the inverse and to remove it. Calls the remesher, which is internal to the library, directly
   and without a needle. */
#ifndef TROCAR_REMESH_TIMING_H
#define TROCAR_REMESH_TIMING_H

#include "common/timing.h"
#include "oracles/remesh_methods.h"

typedef enum { ADD_INSIDE, ADD_ON_FACE, MOVE_NODE, REMESH_CHANGES } remesh_change;

typedef struct {
    remesh_method method;
    remesh_change change;
    int touched;             /* moved nodes only: use only those whose patch has this many nodes; 0 for any number */
    int contacts;            /* contact nodes already present, added in the same way (for moved nodes: inside elements) */
    int samples;             /* largest number of samples */
    double seconds;          /* s, time limit; three samples are taken even if they take longer */
} remesh_case;

typedef struct {
    int samples;             /* number of samples; 0 if the mesh has no such node */
    histogram add, remove;   /* time of remesher_serve, from request to snapshot, with the window's nodes already known */
} remesh_timing;

const char *remesh_change_name(remesh_change change);

/* Runs in the calling thread. Errors are those of remesher_create. */
trocar_status remesh_timing_measure(inverse *inv, const remesh_case *wanted, remesh_timing *result, trocar_error *why);

/* Counts the movable nodes by patch size (0 .. MAX_PATCH). */
void remesh_timing_valences(const tissue *t, int counts[MAX_PATCH + 1]);

#endif

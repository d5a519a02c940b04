/* What is behind the handles of trocar.h; for its own files only. */
#ifndef TROCAR_API_H
#define TROCAR_API_H

#include "base/triple_buffer.h"
#include "scene/scene.h"
#include "insertion/simulation.h"

struct trocar_scene {
    scene values;
    trocar_mesh mesh;        /* copy of a mesh that came as arrays; empty without one */
    char **names;            /* of its regions, then of its surfaces */
};

struct trocar_model {
    simulation parts;        /* without those of one run */
    double rate_hz;
};

struct trocar_sim {
    trocar_model *model;
    insertion_state *state;
    insertion_workspace *workspace;
    remesher *remesher;      /* the worker's */
    triple_buffer requests;   /* remesh_request: tick -> worker */
    triple_buffer snapshots;  /* compliance_snapshot: worker -> tick */
    uint64_t posted;         /* serial of the last request handed over */
    int work_wake;           /* eventfd: a request waits */
    vec3 *field_scratch;     /* of trocar_sim_displacements, NULL before the first */
    vec3 *added_field;
};

#endif

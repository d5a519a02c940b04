/* A lockstep simulation for tests: a scene, a state, and one call per tick. */
#ifndef TROCAR_TESTS_LOCKSTEP_H
#define TROCAR_TESTS_LOCKSTEP_H

#include <stdlib.h>
#include <string.h>

#include "oracles/remesh_methods.h"
#include "oracles/run.h"
#include "scene/scene.h"

typedef struct {
    scene scene;
    model_parts parts;
    needle_run run;
    insertion_state state;
    compliance_snapshot *snapshot;
    tick_output wrench;
    pose base;
    double base_compliance;  /* m/N, of the spring that holds the base */
} lockstep;

/* Returns the base pose of a straight needle above the gland of the figure-8 scene, with its tip 1 mm in front of the skin. */
static inline pose lockstep_start(void) { return (pose){v3(0.005, 0.003, -0.201), {1, 0, 0, 0}}; }

static inline simulation_config lockstep_scene(const char *path) {
    scene s;
    trocar_error why;
    if (scene_load(path, &s, &why) != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        abort();
    }
    return s.simulation;
}

static inline simulation_config lockstep_config(void) { return lockstep_scene(MESHES "/figure8.yaml"); }

static inline lockstep *lockstep_create(const simulation_config *config, pose start) {
    lockstep *l = calloc(1, sizeof *l);
    trocar_error why;
    l->snapshot = calloc(1, sizeof *l->snapshot);
    l->base = start;
    trocar_status status = model_parts_create(config, &l->parts, &why);
    if (status == TROCAR_OK) status = run_create(&l->parts, &l->run, &why);
    if (status != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        abort();
    }
    insertion_reset(&l->parts.insertion, start, &l->state);
    return l;
}

/* Selects the remeshing method of a simulation that has just been created. */
static inline void lockstep_remesh_by(lockstep *l, remesh_method method) {
    trocar_error why;
    remesher_free(l->run.remesher);
    if (remesher_create_by(l->parts.inverse, method, &l->run.remesher, &why) == TROCAR_OK) return;
    fprintf(stderr, "%s\n", why.text);
    abort();
}

static inline void lockstep_free(lockstep *l) {
    run_free(&l->run);
    model_parts_free(&l->parts);
    free(l->snapshot);
    free(l);
}

static inline void lockstep_tick(lockstep *l, pose base, double dt) {
    trocar_error why;
    l->base = base;
    tick_input tick = {.base = {base, l->base_compliance}, .dt = dt};
    if (run_step(&l->run, tick, &l->state, l->snapshot, &l->wrench, &why) != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        abort();
    }
}

/* Creates a simulation with the needle 60 mm deep, at rest, without force, and with all its contacts computed. */
static inline lockstep *lockstep_engaged(const simulation_config *config) {
    pose start = lockstep_start();
    start.position.z += 0.061;
    lockstep *l = lockstep_create(config, start);
    for (int i = 0; i < 3; i++) lockstep_tick(l, start, 1e-6);
    return l;
}

/* Moves the base by `way` (m) in `seconds` at constant speed. */
static inline void lockstep_move(lockstep *l, vec3 way, double seconds, double dt) {
    pose from = l->base;
    int n = (int)(seconds / dt + 0.5);
    for (int i = 1; i <= n; i++) {
        pose base = from;
        base.position = v3_axpy((double)i / n, way, from.position);
        lockstep_tick(l, base, dt);
    }
}

#endif

/* A simulation of a scene for tests, created as a program using the library would. */
#ifndef TROCAR_TESTS_HOST_H
#define TROCAR_TESTS_HOST_H

#include <stdio.h>
#include <stdlib.h>

#include "trocar.h"

typedef struct {
    trocar_scene *scene;
    trocar_model *model;
    trocar_sim *sim;
    trocar_output output;    /* of the last tick */
} host;

/* Creates the simulation, with one key of the scene set to another value unless `key` is NULL. */
static inline host host_open_with(const char *path, const char *key, const char *value) {
    host h = {NULL};
    trocar_error why;
    if (trocar_scene_load(path, &h.scene, &why) == TROCAR_OK && (key == NULL || trocar_scene_set(h.scene, key, value, &why) == TROCAR_OK)
        && trocar_model_create(h.scene, NULL, &h.model, &why) == TROCAR_OK
        && trocar_sim_create(h.model, &h.sim, &why) == TROCAR_OK) return h;
    fprintf(stderr, "%s\n", why.text);
    abort();
}

static inline host host_open(const char *path) { return host_open_with(path, NULL, NULL); }

static inline void host_close(host *h) {
    trocar_sim_free(h->sim);
    trocar_model_free(h->model);
    trocar_scene_free(h->scene);
}

static inline void host_step(host *h, const trocar_pose *base) {
    trocar_error why;
    if (trocar_sim_step(h->sim, 0, base, 1e-3, &h->output, &why) == TROCAR_OK) return;
    fprintf(stderr, "%s\n", why.text);
    abort();
}

#endif

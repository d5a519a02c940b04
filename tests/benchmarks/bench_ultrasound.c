/* Times the ultrasound images of a scene, without server and browser: both images, with two needles, in tissue that moves. CPU time is shown next to elapsed
   time, because it depends less on other load. usage: bench_ultrasound [SCENE] (default: the pelvis) */
#define _GNU_SOURCE
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#include "view/ultrasound/echo.h"

enum { IMAGES = 300 };

static int by_size(const void *a, const void *b) { return (*(const double *)a > *(const double *)b) - (*(const double *)a < *(const double *)b); }

static double milliseconds(clockid_t clock) {
    struct timespec t;
    clock_gettime(clock, &t);
    return 1e3 * (double)t.tv_sec + 1e-6 * (double)t.tv_nsec;
}

static void say(const char *name, double *times) {
    qsort(times, IMAGES, sizeof *times, by_size);
    printf("%-22s p50 %.1f ms, p99 %.1f ms\n", name, times[IMAGES / 2], times[IMAGES * 99 / 100]);
}

typedef struct {
    echo *echo;
    image_plane plane;
    unsigned char *levels;
} view;

static trocar_status prepare(view views[SLICES], const trocar_scene *scene, const trocar_model *model, trocar_error *why) {
    image_planner planner = image_planner_of(model);
    image_plane planes[SLICES];
    trocar_status status = TROCAR_OK;
    planes_at_tip(&planner, NULL, planes);
    for (int k = 0; k < SLICES && status == TROCAR_OK; k++) {
        image_field field = image_field_of(&planner, (slice_kind)k, &planes[k], 0);
        image_raster raster = image_raster_of(&field, 0.25e-3);
        views[k].plane = planes[k];
        views[k].levels = malloc((size_t)raster.width * (size_t)raster.height);
        status = echo_create(scene, model, &TRANSRECTAL, ECHO_DENSITY, &views[k].echo, why);
        if (status == TROCAR_OK) status = echo_frame(views[k].echo, &field, &raster, why);
        if (status != TROCAR_OK) break;
        echo_envelope e = echo_last(views[k].echo);
        printf("%s: %d lines of %d samples, %d x %d pixels\n", k == SLICE_AXIAL ? "axial" : "sagittal", e.lines, e.rows, raster.width, raster.height);
    }
    return status;
}

int main(int count, char **arguments) {
    trocar_scene *scene;
    trocar_model *model;
    trocar_error why;
    view views[SLICES];
    static double passed[IMAGES], used[IMAGES];
    const double needles[2][2][3] = {{{0.005, 0.006, -0.1}, {0.006, 0.009, 0.06}}, {{0, 0, -0.1}, {0.001, 0.004, 0.055}}};
    const echo_body bodies[2] = {{needles[0][0], 2, 0.635e-3, &STEEL}, {needles[1][0], 2, 0.635e-3, &STEEL}};
    const trocar_model_options mesh_only = {.mesh_only = 1};
    if (trocar_scene_load(count > 1 ? arguments[1] : MESHES "/pelvis.yaml", &scene, &why) != TROCAR_OK || trocar_model_create(scene, &mesh_only, &model, &why) != TROCAR_OK
        || prepare(views, scene, model, &why) != TROCAR_OK) {
        fprintf(stderr, "bench_ultrasound: %s\n", why.text);
        return 2;
    }
    size_t size = 3 * (size_t)trocar_model_node_count(model) * sizeof(double);
    double *nodes = malloc(size);
    memcpy(nodes, trocar_model_nodes(model), size);
    for (int i = 0; i < IMAGES; i++) {
        for (int n = 0; n < trocar_model_node_count(model); n++) nodes[3 * n + 1] += 2e-5 * (i % 2 ? 1 : -1) * (1 + n % 7);
        double began = milliseconds(CLOCK_MONOTONIC), used_before = milliseconds(CLOCK_THREAD_CPUTIME_ID);
        for (int k = 0; k < SLICES; k++) echo_image(views[k].echo, &views[k].plane, nodes, bodies, 2, views[k].levels);
        passed[i] = milliseconds(CLOCK_MONOTONIC) - began;
        used[i] = milliseconds(CLOCK_THREAD_CPUTIME_ID) - used_before;
    }
    say("both images, time", passed);
    say("both images, processor", used);
    return 0;
}

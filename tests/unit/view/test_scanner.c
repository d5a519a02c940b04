/* Tests the thread that computes ultrasound images for browsers. It works only while images are requested, ignores requests with values that are not finite,
   and places the images where requested or, if there is a probe, at the probe. 3D Slicer gets the same pixels. */
#include "view/ultrasound/scanner.h"
#include "bridges/slicer/ras.c" /* trocar-slicer has no library */
#include "bridges/slicer/slices.c"

#include <poll.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"

typedef struct {
    trocar_scene *scene;
    trocar_model *model;
    scanner *scanner;
    subscriber feed;
    byte_buffer section;
} rig;

static void begin(rig *r, const char *path) {
    const trocar_model_options mesh_only = {.mesh_only = 1};
    trocar_error why;
    *r = (rig){.feed = {.needle_count = 1}};
    assert_int_equal(trocar_scene_load(path, &r->scene, &why), TROCAR_OK);
    assert_int_equal(trocar_model_create(r->scene, &mesh_only, &r->model, &why), TROCAR_OK);
    assert_int_equal(scanner_create(r->scene, r->model, &r->scanner, &why), TROCAR_OK);
}

static void end(rig *r) {
    scanner_free(r->scanner);
    bytes_free(&r->section);
    trocar_model_free(r->model);
    trocar_scene_free(r->scene);
}

/* Returns whether new images are ready within this time. */
static bool scans(rig *r, int milliseconds) {
    scanner_tell(r->scanner, &r->feed);
    return poll(&(struct pollfd){.fd = scanner_descriptor(r->scanner), .events = POLLIN}, 1, milliseconds) > 0 && scanner_take(r->scanner, &r->section);
}

static void look(rig *r, float z, float x, float depth, float both) {
    scanner_look(r->scanner, &(web_action){.kind = ACTION_LOOK, .steer = {z, x, depth, both}});
}

/* Returns the JSON text at the start of the section. */
static const char *described(const rig *r) { return (const char *)r->section.data + 16; }

/* Returns the origin (m) of the axial image. */
static vec3 origin_of(const rig *r) {
    vec3 x = {NAN, NAN, NAN};
    const char *at = strchr(strstr(described(r), "\"origin\""), '[');
    assert_int_equal(sscanf(at, "[%lf,%lf,%lf", &x.x, &x.y, &x.z), 3);
    return x;
}

static void it_computes_what_is_asked_for(void **unused) {
    (void)unused;
    rig r;
    begin(&r, MESHES "/pelvis.yaml");
    assert_false(scans(&r, 100)); /* nobody asks */
    look(&r, NAN, 0, 0, 0);
    look(&r, 0.05f, 0, INFINITY, 0);
    assert_false(scans(&r, 100));
    look(&r, 0.05f, 0.01f, 0, 0);
    assert_true(scans(&r, 30000));
    assert_non_null(strstr(described(&r), "axial"));
    assert_null(strstr(described(&r), "sagittal"));
    assert_close(origin_of(&r).z, 0.05, 1e-6);
    assert_false(scans(&r, 100)); /* nothing has changed */
    size_t shallow, length = r.section.length;
    look(&r, 0.05f, 0.01f, 0.03f, 0);
    assert_true(scans(&r, 30000));
    shallow = r.section.length;
    assert_true(shallow < length);
    look(&r, 0.05f, 0.01f, 0.03f, 1);
    assert_true(scans(&r, 30000));
    assert_non_null(strstr(described(&r), "sagittal"));
    assert_true(r.section.length > shallow);
    look(&r, 0.05f, 0.01f, 1e9f, 0); /* limited */
    assert_true(scans(&r, 30000));
    end(&r);
}

static void the_images_lie_at_the_probe(void **unused) {
    (void)unused;
    rig r;
    begin(&r, MESHES "/trus.yaml");
    look(&r, 0, 0, 0, 1);
    assert_true(scans(&r, 30000)); /* until the server reports the probe's pose, it is at the scene's start pose, whose axial image is at z = 61 mm */
    assert_close_vector(origin_of(&r), v3(0, -0.032, 0.061), 1e-9);
    r.feed.probe = (trocar_probe){.base = {{0.002, -0.030, -0.07}, {1, 0, 0, 0}}, .placed = 1};
    look(&r, 0, 0, 0, 1); /* a request is valid for two seconds */
    assert_true(scans(&r, 30000));
    assert_close_vector(origin_of(&r), v3(0.002, -0.030, 0.071), 1e-9);
    end(&r);
}

/* Returns the levels of the images in the section, which follow its JSON text. */
static const unsigned char *levels_of(const rig *r) {
    uint32_t length;
    memcpy(&length, r->section.data + 8, sizeof length);
    return r->section.data + 16 + (length + 7) / 8 * 8;
}

/* The tissue is displaced by up to 2 mm, and the probe is tilted. */
static void slicer_gets_the_same_pixels(void **unused) {
    (void)unused;
    const slice_settings settings = {.style = SLICES_ECHO, .pixel = 0.25e-3, .gain = 3, .range = 50};
    const pose probe = {v3(0.002, -0.031, -0.08), q_exp(v3(0, 0, 0.1))};
    rig r;
    slices s;
    trocar_error why;
    begin(&r, MESHES "/trus.yaml");
    int nodes = trocar_model_node_count(r.model);
    const double *rest = trocar_model_nodes(r.model);
    double *moved = malloc(3 * (size_t)nodes * sizeof *moved);
    float *moves = malloc(3 * (size_t)nodes * sizeof *moves), **rows = malloc((size_t)nodes * sizeof *rows);
    for (int n = 0; n < nodes; n++) rows[n] = moves + 3 * n;
    for (int i = 0; i < 3 * nodes; i++) {
        moves[i] = (float)(2e-3 * sin(60 * rest[i]));
        moved[i] = rest[i] + (double)moves[i];
    }
    trocar_deformation_t deformation = {.utime = 1, .node_count = nodes, .displacement = rows};
    r.feed.deformation = &deformation;
    r.feed.probe.placed = 1;
    memcpy(r.feed.probe.base.position, &probe.position, sizeof r.feed.probe.base.position);
    memcpy(r.feed.probe.base.orientation, &probe.orientation, sizeof r.feed.probe.base.orientation);
    look(&r, 0, 0, 0, 1);
    assert_true(scans(&r, 30000));

    assert_int_equal(slices_create(&s, r.scene, r.model, &settings, &why), TROCAR_OK);
    body_list bodies;
    bodies_take(&bodies, &r.feed, r.model, 0.635e-3);
    slices_tell(&s, 1, moved, &probe, &bodies);
    assert_int_equal(poll(&(struct pollfd){.fd = slices_descriptor(&s), .events = POLLIN}, 1, 30000), 1);
    const drawn_slices *drawn = slices_take(&s);
    size_t pixels = 0, lit = 0;
    for (int k = 0; k < SLICES; k++) pixels += (size_t)s.all[k].raster.width * (size_t)s.all[k].raster.height;
    unsigned char *levels = malloc(pixels);
    memcpy(levels, levels_of(&r), pixels);
    echo_show(levels, pixels, settings.gain, settings.range);
    assert_memory_equal(levels, drawn->grey, pixels);
    for (size_t i = 0; i < pixels; i++) lit += levels[i] > 0;
    assert_true(lit > pixels / 4);
    slices_free(&s);
    free(levels), free(moved), free(moves), free(rows);
    end(&r);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(it_computes_what_is_asked_for),
        cmocka_unit_test(the_images_lie_at_the_probe),
        cmocka_unit_test(slicer_gets_the_same_pixels),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Tests how trocar-haply's options and the server's scene place the needle. */
#include "settings.h" /* before cmocka.h, whose macro hides `fail` */

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

#include "check.h"

#define MINIMAL "mesh: body.msh\nregions: [{name: tissue}]\nfixed: [back]\n"
#define PATIENT "patient_to_mesh: [0, -1e-3, 0, 0.25, 1e-3, 0, 0, -0.125, 0, 0, 1e-3, 0.5, 0, 0, 0, 1]\n"
#define NEEDLE "needle: {length: 0.15, start: {position: [0.01, 0.02, -0.2], orientation: [0.70711, 0, 0.70711, 0]}}\n" /* along x */

enum { MOST = 16 };

/* Places the needle according to a command line and a scene with this text. The command line has up to MOST words, separated by spaces. */
static trocar_status place(const char *scene, const char *options, haply_settings *settings, trocar_error *why) {
    char path[] = "/tmp/test_haply_settings.XXXXXX", line[256], *words[MOST] = {"trocar-haply", "--scene", path};
    int count = 3, file = mkstemp(path);
    assert_true(file >= 0 && write(file, scene, strlen(scene)) == (ssize_t)strlen(scene) && close(file) == 0);
    assert_true(strlen(options) < sizeof line);
    strcpy(line, options);
    for (char *word = strtok(line, " "); word && count < MOST; word = strtok(NULL, " ")) words[count++] = word;
    haply_parse(count, words, settings);
    trocar_status status = haply_place(settings, why);
    unlink(path);
    return status;
}

static void assert_base(const char *scene, const char *options, vec3 position, vec3 axis) {
    haply_settings settings;
    trocar_error why = {""};
    assert_int_equal(place(scene, options, &settings, &why), TROCAR_OK);
    mapping m;
    mapping_init(&m, &settings.mapping);
    pose base = mapping_pose(&m, v3(0, 0, 0), NULL, false);
    assert_close_vector(base.position, position, 1e-9);
    assert_close_vector(q_axis(base.orientation), axis, 1e-9);
}

static void the_needle_starts_as_the_scene_says(void **state) {
    (void)state;
    assert_base(MINIMAL NEEDLE, "", v3(0.01, 0.02, -0.2), v3(1, 0, 0));
    assert_base(MINIMAL NEEDLE, "--point tip", v3(0.01, 0.02, -0.2), v3(1, 0, 0));
}

static void the_scales_are_those_of_the_scene(void **state) {
    (void)state;
    haply_settings settings;
    trocar_error why = {""};
    assert_int_equal(place(MINIMAL NEEDLE "device: {scale: 0.5, force_scale: 2}\n", "", &settings, &why), TROCAR_OK);
    assert_true(settings.mapping.scale == 0.5 && settings.force_scale == 2);
    assert_int_equal(place(MINIMAL NEEDLE "device: {scale: 0.5, force_scale: 2}\n", "--scale 3 --force-scale 0.1", &settings, &why), TROCAR_OK);
    assert_true(settings.mapping.scale == 3 && settings.force_scale == 0.1);
    assert_int_equal(place(MINIMAL NEEDLE, "", &settings, &why), TROCAR_OK);
    assert_true(settings.mapping.scale == 1 && settings.force_scale == 1);
}

static void options_come_first(void **state) {
    (void)state;
    assert_base(MINIMAL NEEDLE, "--start 0.1,0.2,0.3", v3(0.1, 0.2, 0.3), v3(1, 0, 0));
    assert_base(MINIMAL NEEDLE, "--start 0.1,0.2,0.3 --point tip", v3(-0.05, 0.2, 0.3), v3(1, 0, 0)); /* the base is 150 mm behind the tip */
    assert_base(MINIMAL NEEDLE, "--start 0.1,0.2,0.3 --point tip --length 0.1 --direction 0,1,0", v3(0.1, 0.1, 0.3), v3(0, 1, 0));
    assert_base(MINIMAL, "--start 0.1,0.2,0.3", v3(0.1, 0.2, 0.3), v3(0, 0, 1));
}

/* The mesh's x is 250 mm minus the patient's y, its y is the patient's x minus 125 mm, and its z is the patient's z plus 500 mm. */
static void places_of_the_patient_are_millimetres_along_its_axes(void **state) {
    (void)state;
    assert_base(MINIMAL PATIENT NEEDLE, "--patient --start 100,50,-300", v3(0.2, -0.025, 0.2), v3(1, 0, 0));
    assert_base(MINIMAL PATIENT NEEDLE, "--patient --point tip --start 100,50,-300", v3(0.05, -0.025, 0.2), v3(1, 0, 0));
    assert_base(MINIMAL PATIENT NEEDLE, "--patient --offset 100,50,-300", v3(0.2, -0.025, 0.2), v3(1, 0, 0));
    assert_base(MINIMAL PATIENT NEEDLE, "--patient", v3(0.01, 0.02, -0.2), v3(1, 0, 0)); /* the scene's start pose is in the mesh's frame */
}

static void a_scene_that_does_not_say_is_refused(void **state) {
    (void)state;
    haply_settings settings;
    trocar_error why = {""};
    assert_int_equal(place(MINIMAL, "", &settings, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "has no needle.start"));
    assert_int_equal(place(MINIMAL NEEDLE, "--patient --start 1,2,3", &settings, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "patient_to_mesh"));
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_needle_starts_as_the_scene_says),
        cmocka_unit_test(the_scales_are_those_of_the_scene), cmocka_unit_test(options_come_first),
        cmocka_unit_test(places_of_the_patient_are_millimetres_along_its_axes),
        cmocka_unit_test(a_scene_that_does_not_say_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

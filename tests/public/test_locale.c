/* In a host whose locale uses a decimal comma, the library reads, writes and computes as in the C locale, and leaves the host's locale alone. Needs the
   locale de_DE.UTF-8, which test_locale.sh creates; without it, the exit status is 77. */
#include <locale.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <trocar.h>
#include <unistd.h>


#include <cmocka.h>

enum { ROOM = 1 << 18, TICKS = 300 };

/* Collects everything the library writes and computes as text. Numbers returned by functions are printed in hexadecimal, which does not depend on the
   locale. */
typedef struct {
    char text[ROOM];
    size_t used;
} record;

__attribute__((format(printf, 2, 3))) static void note(record *r, const char *format, ...) {
    va_list arguments;
    va_start(arguments, format);
    r->used += (size_t)vsnprintf(r->text + r->used, ROOM - r->used, format, arguments);
    va_end(arguments);
    assert_true(r->used < ROOM - 1);
}

static void note_bytes(record *r, const void *bytes, size_t size) {
    for (size_t i = 0; i < size; i++) note(r, "%02x", ((const unsigned char *)bytes)[i]);
    note(r, "\n");
}

static char decimal_of_host(void) {
    char text[8];
    snprintf(text, sizeof text, "%.1f", 1.5);
    return text[1];
}

static char decimal;

static void check_host(const char *what, double fraction, void *context) {
    (void)what, (void)fraction;
    assert_int_equal(decimal_of_host(), decimal);
    ++*(int *)context;
}

static void note_scene(record *r, trocar_scene *scene) {
    trocar_error why = {""};
    char text[8192];
    for (int i = 0; i < trocar_key_count(); i++) {
        trocar_key key = trocar_key_at(i);
        char first[256];
        const char *brackets = strstr(key.key, "[]");
        snprintf(first, sizeof first, "%.*s%s%s", (int)(brackets ? brackets - key.key : (long)strlen(key.key)), key.key, brackets ? "[0]" : "", brackets ? brackets + 2 : "");
        trocar_status status = trocar_scene_get(scene, first, text, sizeof text, &why);
        note(r, "%s (default %s) = %s\n", key.key, key.default_value, status == TROCAR_OK ? text : why.text);
    }
    static const double numbers[] = {0.15, 1e-7, 123456.789, 1.0 / 3.0};
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        double number = NAN;
        assert_int_equal(trocar_scene_set_number(scene, "needle.length", numbers[i], &why), TROCAR_OK);
        assert_int_equal(trocar_scene_get_number(scene, "needle.length", &number, &why), TROCAR_OK);
        assert_true(number == numbers[i]);
    }
    assert_int_equal(trocar_scene_set(scene, "needle.length", "0.2", &why), TROCAR_OK);
    assert_int_equal(trocar_scene_set(scene, "needle.length", "0,2", &why), TROCAR_BAD_INPUT);
    note(r, "%s\n", why.text);
    assert_int_equal(trocar_scene_set(scene, "needle.start.orientation", "[0.5, 0.5, 0.5, 0.25]", &why), TROCAR_BAD_INPUT);
    note(r, "%s\n", why.text);
    assert_int_equal(trocar_scene_set(scene, "mesh_unit", "1.5e-3", &why), TROCAR_OK);
    assert_int_equal(trocar_scene_set(scene, "mesh_unit", "m", &why), TROCAR_OK);
}

static void note_model(record *r, const trocar_scene *scene, const char *inverse, const char *cache) {
    trocar_error why = {""};
    trocar_model *model;
    trocar_sim *sim;
    trocar_output out;
    trocar_scene *copied;
    int called = 0;
    trocar_model_options options = {.watch = {.progress = check_host, .context = &called}};
    assert_int_equal(trocar_scene_copy(scene, &copied, &why), TROCAR_OK);
    trocar_scene_set(copied, "inverse", inverse, &why);
    trocar_scene_set(copied, "region_of_interest.regions", "[prostate]", &why);
    trocar_scene_set(copied, "cache", cache, &why);
    if (trocar_model_create(copied, &options, &model, &why) != TROCAR_OK) fail_msg("%s", why.text);
    note(r, "%s\n%s\n", trocar_model_description(model), trocar_model_remarks(model));
    note_bytes(r, trocar_model_nodes(model), 3 * (size_t)trocar_model_node_count(model) * sizeof(double));
    if (trocar_sim_create(model, &sim, &why) != TROCAR_OK) fail_msg("%s", why.text);
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}}, bad = {{0, 0, 0}, {0.5, 0, 0, 0.25}};
    trocar_sim_reset(sim, 0, &base, &why);
    for (int t = 0; t < TICKS; t++, base.position[2] += 1e-4) {
        if (trocar_sim_step(sim, 0, &base, 1e-3, &out, &why) != TROCAR_OK) fail_msg("%s", why.text);
        note_bytes(r, &out, sizeof out);
    }
    trocar_sim_step(sim, 0, &bad, 1e-3, &out, &why);
    note(r, "%s\n", why.text);
    trocar_sim_step(sim, 0, &base, 1.5, &out, &why);
    note(r, "%s\n", why.text);
    trocar_sim_free(sim);
    trocar_model_free(model);
    trocar_scene_free(copied);
    assert_true(strcmp(inverse, "condensed") != 0 || called > 0);
}

/* Records three messages: the note on the size of a mesh file in another unit, and the errors about guides that do not fit and about a malformed dose table. */
static void note_others(record *r) {
    trocar_error why = {""};
    trocar_scene *scene;
    trocar_model *model;
    trocar_model_options options = {.mesh_only = 1};
    trocar_dose_source *source;
    if (trocar_scene_load(MESHES "/template.yaml", &scene, &why) != TROCAR_OK) fail_msg("%s", why.text);
    note_scene(r, scene);
    trocar_scene_set(scene, "mesh_unit", "mm", &why);
    assert_int_equal(trocar_model_create(scene, &options, &model, &why), TROCAR_OK);
    note(r, "%s\n", trocar_model_remarks(model));
    trocar_model_free(model);
    trocar_scene_set(scene, "mesh_unit", "m", &why);
    trocar_scene_set(scene, "guides[0].hole_diameter", "0.00125", &why);
    assert_int_equal(trocar_model_create(scene, &options, &model, &why), TROCAR_BAD_INPUT);
    note(r, "%s\n", why.text);
    trocar_scene_free(scene);
    assert_int_equal(trocar_dose_source_create("I-125 6711", &source, &why), TROCAR_OK);
    trocar_dose_source_data data = trocar_dose_source_get(source);
    note_bytes(r, &data, sizeof data);
    trocar_dose_source_free(source);
    char path[] = "/tmp/test_locale.XXXXXX";
    int file = mkstemp(path);
    static const char table[] = "name: x\ndose_rate_constant: 0.965\nactive_length: 0.45\ncapsule_length: 0.25\ncapsule_diameter: 0.08\nhalf_life: 59.4\n"
                                "radial: [[0.5, 1.0], [1.0, 1.0]]\nanisotropy: {radii: [1.0], rows: [[0, 1.0], [90, 1.0]]}\n";
    assert_int_equal(write(file, table, sizeof table - 1), sizeof table - 1);
    close(file);
    assert_int_equal(trocar_dose_source_load(path, &source, &why), TROCAR_BAD_INPUT);
    note(r, "%s\n", strstr(why.text, ".XXXXXX") ? why.text : strrchr(why.text, '/') + sizeof "test_locale.XXXXXX");
    unlink(path);
}

static record *record_all(const char *cache) {
    record *r = calloc(1, sizeof *r);
    trocar_error why = {""};
    trocar_scene *scene;
    if (trocar_scene_load(MESHES "/figure8.yaml", &scene, &why) != TROCAR_OK) fail_msg("%s", why.text);
    note_scene(r, scene);
    note_model(r, scene, "dense", cache);
    note_model(r, scene, "sparse", cache);
    note_model(r, scene, "condensed", cache);
    trocar_scene_free(scene);
    note_others(r);
    assert_ptr_equal(uselocale((locale_t)0), LC_GLOBAL_LOCALE);
    assert_int_equal(decimal_of_host(), decimal);
    return r;
}

static void a_decimal_comma_changes_nothing(void **state) {
    (void)state;
    char cache[] = "/tmp/test_locale.XXXXXX", command[64];
    assert_non_null(mkdtemp(cache));
    decimal = '.';
    record *plain = record_all(cache);
    snprintf(command, sizeof command, "rm -rf %s/*", cache);
    assert_int_equal(system(command), 0);
    assert_non_null(setlocale(LC_ALL, "de_DE.UTF-8"));
    decimal = ',';
    record *german = record_all(cache);
    setlocale(LC_ALL, "C");
    assert_string_equal(german->text, plain->text);
    assert_true(plain->used > 100000);
    free(plain);
    free(german);
    snprintf(command, sizeof command, "rm -rf %s", cache);
    assert_int_equal(system(command), 0);
}

int main(void) {
    if (!setlocale(LC_ALL, "de_DE.UTF-8") || decimal_of_host() != ',') {
        fprintf(stderr, "no locale de_DE.UTF-8 here\n");
        return 77;
    }
    setlocale(LC_ALL, "C");
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_decimal_comma_changes_nothing)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Tests the message sections that describe an implant to browsers: the dose is compared with direct summation of the formula, seeds are added and removed,
   and plans with errors are refused. */
#define _GNU_SOURCE
#include "view/implant/implant.h"

#include <poll.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include "check.h"

enum { SEEDS = 3 };

typedef struct {
    trocar_scene *scene;
    trocar_model *model;
} fixture;

/* Positions of seeds in the gland, along its length. */
static float centres[SEEDS][3] = {{-0.02f, -0.005f, 0.06f}, {0.0f, 0.0f, 0.05f}, {0.01f, 0.004f, 0.055f}}, axes[SEEDS][3] = {{0, 0, 1}, {0, 0, 1}, {0, 0.6f, 0.8f}};
static float *centre_rows[SEEDS] = {centres[0], centres[1], centres[2]}, *axis_rows[SEEDS] = {axes[0], axes[1], axes[2]};
static const int16_t numbers[SEEDS] = {0};

static trocar_seeds_t message_of(int count) {
    int16_t *zeros = (int16_t *)numbers;
    return (trocar_seeds_t){.seed_count = count, .position = centre_rows, .direction = axis_rows, .rest_position = centre_rows, .rest_direction = axis_rows,
                            .needle = zeros, .guide = zeros, .hole = zeros, .strand = zeros};
}

static int open_fixture(void **state) {
    static fixture f;
    trocar_error why;
    assert_int_equal(trocar_scene_load(MESHES "/implant.yaml", &f.scene, &why), TROCAR_OK);
    assert_int_equal(trocar_model_create(f.scene, &(trocar_model_options){.mesh_only = 1}, &f.model, &why), TROCAR_OK);
    *state = &f;
    return 0;
}

static int close_fixture(void **state) {
    fixture *f = *state;
    trocar_model_free(f->model);
    trocar_scene_free(f->scene);
    return 0;
}

static implant open_implant(const fixture *f, const implant_settings *settings) {
    implant i = {.dose = NULL};
    trocar_error why = {""};
    if (implant_open(&i, f->model, settings, &why) != TROCAR_OK) fail_msg("%s", why.text);
    return i;
}

/* Returns whether the JSON text contains the dose of this many seeds. */
static bool has_seeds(const char *json, int count) {
    static const char key[] = "\"seeds\":";
    const char *found = strstr(json, key);
    return found && atoi(found + sizeof key - 1) == count;
}

/* Passes the seeds to browsers and waits until the dose is that of `count` seeds. Returns the section's JSON text. `levels` is set to the data that follow
   it. */
static const char *dose_of(implant *i, int count, const unsigned char **levels) {
    trocar_seeds_t seeds = message_of(count);
    subscriber feed = {.seeds = &seeds, .seeds_heard = i->seeds_heard + 1};
    implant_hear(i, &feed);
    for (int attempt = 0; attempt < 20; attempt++) {
        const unsigned char *section = i->sections[IMPLANT_DOSE].bytes.data;
        const char *json = section ? (const char *)section + 16 : NULL;
        if (json && has_seeds(json, count)) {
            uint32_t length;
            memcpy(&length, section + 8, sizeof length);
            *levels = section + 16 + (length + 7) / 8 * 8;
            return json;
        }
        assert_true(poll(&(struct pollfd){.fd = dose_thread_descriptor(i->dose), .events = POLLIN}, 1, 60000) == 1);
        implant_note_dose(i);
    }
    fail_msg("no dose of %d seeds", count);
    return NULL;
}

static void read_numbers(const char *json, const char *key, double *values, int count) {
    const char *at = strstr(json, key);
    assert_non_null(at);
    at = strpbrk(at + strlen(key), "-0123456789");
    for (int i = 0; i < count; i++) {
        char *end;
        values[i] = strtod(at, &end);
        assert_true(end > at);
        at = end + (*end == ',');
    }
}

/* Computes the dose (Gy) at each point from the formula. */
static void plain_doses(const implant_settings *settings, int seeds, const double *points, int64_t count, double *doses) {
    trocar_error why;
    trocar_dose_source *source;
    trocar_dose_seed list[SEEDS];
    assert_int_equal(trocar_dose_source_create(settings->dose.source, &source, &why), TROCAR_OK);
    for (int s = 0; s < seeds; s++) {
        list[s].strength = settings->dose.strength;
        for (int a = 0; a < 3; a++) list[s].position[a] = centres[s][a], list[s].direction[a] = axes[s][a];
    }
    assert_int_equal(trocar_dose_rates(source, list, seeds, points, count, doses, &why), TROCAR_OK);
    for (int64_t i = 0; i < count; i++) doses[i] *= trocar_dose_hours(source, INFINITY);
    trocar_dose_source_free(source);
}

static void check_levels(const implant_settings *settings, int seeds, const char *json, const unsigned char *levels) {
    double origin[3], spacing, counts[3];
    read_numbers(json, "\"origin\":", origin, 3);
    read_numbers(json, "\"spacing\":", &spacing, 1);
    read_numbers(json, "\"counts\":", counts, 3);
    srand(5);
    for (int trial = 0; trial < 2000; trial++) {
        int at[3];
        double point[3], dose;
        for (int a = 0; a < 3; a++) {
            at[a] = rand() % (int)counts[a];
            point[a] = origin[a] + spacing * at[a];
        }
        plain_doses(settings, seeds, point, 1, &dose);
        double level = fmin(255, 255 * dose / (3 * settings->dose.prescription));
        assert_true(fabs(levels[(at[0] * (int)counts[1] + at[1]) * (int)counts[2] + at[2]] - level) <= 0.501);
    }
}

/* Returns the voxels of a region, given the region of each tetrahedron. The caller frees them. */
static trocar_structure *voxels_of(const trocar_model *m, const int32_t *regions, const char *name) {
    trocar_error why;
    trocar_structure *voxels;
    trocar_mesh mesh = {.node_count = trocar_model_node_count(m), .tet_count = trocar_model_tet_count(m), .nodes = trocar_model_nodes(m), .tets = trocar_model_tets(m),
                        .tet_region = regions};
    assert_int_equal(trocar_structure_from_region(&mesh, trocar_model_find_region(m, name, 3), 1e-3, &voxels, &why), TROCAR_OK);
    return voxels;
}

/* Computes V100 of the gland at points distributed over the scene's own mesh. */
static double plain_v100(const fixture *f, const implant_settings *settings, int seeds) {
    trocar_structure *gland = voxels_of(f->model, trocar_model_tet_regions(f->model), "prostate");
    int64_t count = trocar_structure_count(gland), covered = 0;
    double *doses = malloc((size_t)count * sizeof *doses);
    plain_doses(settings, seeds, trocar_structure_points(gland), count, doses);
    for (int64_t i = 0; i < count; i++) covered += doses[i] >= settings->dose.prescription;
    free(doses);
    trocar_structure_free(gland);
    return (double)covered / (double)count;
}

static void the_dose_is_that_of_the_seeds(void **state) {
    fixture *f = *state;
    static const implant_settings settings = {.dose = {"I-125 6711", 0.5, 145, 1.18}};
    implant i = open_implant(f, &settings);
    for (int round = 0; round < 4; round++) { /* adds, removes and adds seeds again */
        int count = (const int[]){SEEDS, 1, 0, 2}[round];
        const unsigned char *levels;
        const char *json = dose_of(&i, count, &levels);
        check_levels(&settings, count, json, levels);
        double v100;
        read_numbers(json, "\"v100\":", &v100, 1);
        assert_close(v100, plain_v100(f, &settings, count), 1e-9);
    }
    implant_close(&i);
}

/* Computes V100 of the gland for these seeds, at its voxels `points`. */
static double covered(const implant_settings *settings, const trocar_dose_seed *seeds, const double *points, int64_t count) {
    trocar_error why;
    trocar_dose_source *source;
    double *rates = malloc((size_t)count * sizeof *rates), hours;
    int64_t inside = 0;
    assert_int_equal(trocar_dose_source_create(settings->dose.source, &source, &why), TROCAR_OK);
    assert_int_equal(trocar_dose_rates(source, seeds, SEEDS, points, count, rates, &why), TROCAR_OK);
    hours = trocar_dose_hours(source, INFINITY);
    for (int64_t i = 0; i < count; i++) inside += hours * rates[i] >= settings->dose.prescription;
    trocar_dose_source_free(source);
    free(rates);
    return (double)inside / (double)count;
}

/* The tissue is stretched away from a plane, displacing the seeds, all of which are inside the gland. The isodose lines and the dose indices for the current
   positions change accordingly; those for the rest positions do not. Once the swelling has subsided, gland and seeds are closer to the gland's centre. */
static void each_state_has_its_own_figures(void **state) {
    fixture *f = *state;
    static const implant_settings settings = {.dose = {"I-125 6711", 2.0, 145, 1.3}};
    static float inner[SEEDS][3] = {{-0.008f, -0.005f, 0.045f}, {0.0f, 0.0f, 0.05f}, {0.01f, 0.004f, 0.055f}}, moved[SEEDS][3];
    float *inner_rows[SEEDS], *moved_rows[SEEDS];
    trocar_error why;
    trocar_structure *gland;
    trocar_mesh mesh = {.node_count = trocar_model_node_count(f->model), .tet_count = trocar_model_tet_count(f->model), .nodes = trocar_model_nodes(f->model),
                        .tets = trocar_model_tets(f->model), .tet_region = trocar_model_tet_regions(f->model)};
    assert_int_equal(trocar_structure_from_region(&mesh, trocar_model_find_region(f->model, "prostate", 3), 1e-3, &gland, &why), TROCAR_OK);
    int64_t count = trocar_structure_count(gland);
    const double *rest = trocar_structure_points(gland);
    double *points = malloc(3 * (size_t)count * sizeof *points), centre[3] = {0}, scale = cbrt(1 / 1.3), stretch = 0.3;
    float (*displacement)[3] = malloc((size_t)mesh.node_count * sizeof *displacement), **rows = malloc((size_t)mesh.node_count * sizeof *rows);
    for (int n = 0; n < mesh.node_count; n++) {
        rows[n] = displacement[n];
        displacement[n][0] = (float)(stretch * mesh.nodes[3 * n]);
        displacement[n][1] = displacement[n][2] = 0;
    }
    trocar_dose_seed now[SEEDS], out[SEEDS], later[SEEDS];
    for (int64_t i = 0; i < 3 * count; i++) centre[i % 3] += rest[i] / (double)count;
    for (int s = 0; s < SEEDS; s++) {
        inner_rows[s] = inner[s], moved_rows[s] = moved[s];
        now[s] = out[s] = later[s] = (trocar_dose_seed){.direction = {axes[s][0], axes[s][1], axes[s][2]}, .strength = settings.dose.strength};
        for (int a = 0; a < 3; a++) {
            moved[s][a] = a == 0 ? (float)((1 + stretch) * inner[s][a]) : inner[s][a];
            now[s].position[a] = moved[s][a];
            out[s].position[a] = inner[s][a];
            later[s].position[a] = centre[a] + scale * (inner[s][a] - centre[a]);
        }
    }
    implant i = open_implant(f, &settings);
    trocar_seeds_t seeds = message_of(SEEDS);
    seeds.rest_position = inner_rows, seeds.position = moved_rows;
    trocar_deformation_t deformation = {.node_count = mesh.node_count, .displacement = rows};
    subscriber feed = {.seeds = &seeds, .deformation = &deformation, .seeds_heard = i.seeds_heard + 1};
    implant_hear(&i, &feed);
    const char *json = NULL;
    for (int attempt = 0; attempt < 5 && !(json && has_seeds(json, SEEDS)); attempt++) {
        assert_true(poll(&(struct pollfd){.fd = dose_thread_descriptor(i.dose), .events = POLLIN}, 1, 60000) == 1);
        implant_note_dose(&i);
        json = (const char *)i.sections[IMPLANT_DOSE].bytes.data + 16;
    }
    double figure[3];
    for (int k = 0; k < 3; k++) {
        const char *found = strstr(json, (const char *const[]){"\"now\":", "\"out\":", "\"later\":"}[k]);
        assert_non_null(found);
        read_numbers(found, "\"v100\":", &figure[k], 1);
    }
    for (int64_t n = 0; n < 3 * count; n++) points[n] = n % 3 == 0 ? (1 + stretch) * rest[n] : rest[n];
    assert_close(figure[0], covered(&settings, now, points, count), 2e-4); /* displacements are stored in single precision */
    assert_close(figure[1], covered(&settings, out, rest, count), 1e-9);
    for (int64_t n = 0; n < 3 * count; n++) points[n] = centre[n % 3] + scale * (rest[n] - centre[n % 3]);
    assert_close(figure[2], covered(&settings, later, points, count), 1e-9);
    assert_true(figure[2] > figure[1] && figure[1] > figure[0] && figure[0] > 0);
    free(points), free(displacement), free(rows);
    trocar_structure_free(gland);
    implant_close(&i);
}

/* Of the urethra, only the part in the bounding box of the gland is judged, as in reports. */
static void only_the_prostatic_urethra_counts(void **state) {
    (void)state;
    static const implant_settings settings = {.dose = {"I-125 6711", 2.0, 145, 1.18}};
    fixture pelvis;
    trocar_error why;
    assert_int_equal(trocar_scene_load(MESHES "/pelvis.yaml", &pelvis.scene, &why), TROCAR_OK);
    assert_int_equal(trocar_model_create(pelvis.scene, &(trocar_model_options){.mesh_only = 1}, &pelvis.model, &why), TROCAR_OK);
    const trocar_model *m = pelvis.model;
    int32_t *organs = malloc((size_t)trocar_model_tet_count(m) * sizeof *organs);
    for (int t = 0; t < trocar_model_tet_count(m); t++) organs[t] = trocar_model_part_of(m, trocar_model_tet_regions(m)[t]);
    trocar_structure *gland = voxels_of(m, organs, "prostate"), *urethra = voxels_of(m, organs, "urethra");
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    const double *points = trocar_structure_points(gland);
    for (int64_t i = 0; i < 3 * trocar_structure_count(gland); i++) low[i % 3] = fmin(low[i % 3], points[i]), high[i % 3] = fmax(high[i % 3], points[i]);
    int64_t all = trocar_structure_count(urethra), inside = 0;
    double *kept = malloc(3 * (size_t)all * sizeof *kept);
    points = trocar_structure_points(urethra);
    for (const double *p = points; p < points + 3 * all; p += 3)
        if (p[0] >= low[0] && p[0] <= high[0] && p[1] >= low[1] && p[1] <= high[1] && p[2] >= low[2] && p[2] <= high[2]) memcpy(kept + 3 * inside++, p, 3 * sizeof *p);
    assert_in_range(inside, all / 4, all - all / 10);
    trocar_dose_seed seeds[SEEDS];
    for (int s = 0; s < SEEDS; s++)
        seeds[s] = (trocar_dose_seed){.position = {centres[s][0], centres[s][1], centres[s][2]}, .direction = {axes[s][0], axes[s][1], axes[s][2]}, .strength = settings.dose.strength};
    double within = covered(&settings, seeds, kept, inside), anywhere = covered(&settings, seeds, points, all), v100;

    implant i = open_implant(&pelvis, &settings);
    const unsigned char *levels;
    const char *json = strstr(dose_of(&i, SEEDS, &levels), "\"urethra\"");
    assert_non_null(json);
    read_numbers(strstr(json, "\"out\":"), "\"v100\":", &v100, 1);
    assert_close(v100, within, 1e-6);
    assert_true(fabs(anywhere - within) > 0.01);
    implant_close(&i);
    free(kept), free(organs);
    trocar_structure_free(gland);
    trocar_structure_free(urethra);
    close_fixture(&(void *){&pelvis});
}

/* A reply from the previous server is not sent to a browser that connects later. */
static void answers_go_with_their_server(void **state) {
    fixture *f = *state;
    implant i = open_implant(f, &(implant_settings){.dose = {"I-125 6711", 0.5, 145, 1.18}});
    trocar_command_reply_t reply = {.command = 4, .status = 1, .message = "no"};
    subscriber feed = {.reply = &reply, .replies_heard = 1};
    implant_hear(&i, &feed);
    const web_section *s = &i.sections[IMPLANT_REPLY];
    assert_true(memmem(s->bytes.data, s->bytes.length, "\"leave\"", 7) != NULL);
    feed = (subscriber){.replies_heard = 2};
    implant_hear(&i, &feed);
    assert_int_equal(s->bytes.length, 0);
    implant_close(&i);
}

static char *write_file(const char *text) {
    static char path[] = "/tmp/trocar-plan-XXXXXX";
    strcpy(path + sizeof path - 7, "XXXXXX");
    int file = mkstemp(path);
    assert_true(file >= 0 && write(file, text, strlen(text)) == (ssize_t)strlen(text));
    close(file);
    return path;
}

static void the_plan_has_its_own_figures(void **state) {
    fixture *f = *state;
    char *path = write_file("hole,seed,x [m],y [m],z [m],left [mm]\nK3.5,1,-0.02,-0.005,0.06,20\nG4,1,0,0,0.05,0\n");
    implant_settings settings = {.plan = path, .dose = {"I-125 6711", 0.5, 145, 1.18}};
    implant i = open_implant(f, &settings);
    remove(path);
    const unsigned char *levels;
    const char *json = strstr(dose_of(&i, 0, &levels), "\"planned\":");
    double v100;
    assert_non_null(json);
    read_numbers(json, "\"v100\":", &v100, 1);
    assert_close(v100, plain_v100(f, &settings, 2), 1e-6); /* the voxel centres are stored in single precision */
    const byte_buffer *sent = &i.sections[IMPLANT_PLAN].bytes;
    assert_non_null(memmem(sent->data, sent->length, "\"K3.5\"", 6));
    implant_close(&i);
}

static void mistakes_are_refused_with_place_and_remedy(void **state) {
    fixture *f = *state;
    static const struct { const char *text, *words; } wrong[] = {
        {"", ":1: not a table"}, {"x,y\n1,2\n", ":1: not a table"}, {"hole,seed,x [m],y [m],z [m]\nC3.5,1,0,0\n", ":2: not a hole"},
        {"hole,seed,x [m],y [m],z [m]\nC3.5,1,0,0,0\nC3.5,2,nan,0,0\n", ":3: not a hole"}, {"hole,seed,x [m],y [m],z [m]\nC3.5,1,0,0,1e9\n", ":2: not a hole"},
        {"hole,seed,x [m],y [m],z [m]\nG4,1,0,0,0.05\nN4,1,0,0,0.05\n", ":3: the scene's template has no hole N4"},
        {"hole,seed,x [m],y [m],z [m]\nG4,1,0.003,0.004,0.05\n", ":2: the seed is 5.0 mm beside hole G4"}};
    for (size_t k = 0; k < sizeof wrong / sizeof *wrong; k++) {
        implant i = {.dose = NULL};
        trocar_error why = {""};
        char *path = write_file(wrong[k].text);
        assert_int_equal(implant_open(&i, f->model, &(implant_settings){.plan = path, .dose = {"I-125 6711", 0.5, 145, 1.18}}, &why), TROCAR_BAD_INPUT);
        remove(path);
        if (!strstr(why.text, wrong[k].words)) fail_msg("%s", why.text);
        implant_close(&i);
    }
    implant i = {.dose = NULL};
    trocar_error why;
    assert_int_equal(implant_open(&i, f->model, &(implant_settings){.dose = {"Ra-226", 0.5, 145, 1.18}}, &why), TROCAR_BAD_INPUT);
    assert_int_equal(implant_open(&i, f->model, &(implant_settings){.plan = "/nowhere.csv", .dose = {"I-125 6711", 0.5, 145, 1.18}}, &why), TROCAR_BAD_INPUT);
    implant_close(&i);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_dose_is_that_of_the_seeds),
        cmocka_unit_test(each_state_has_its_own_figures),
        cmocka_unit_test(only_the_prostatic_urethra_counts),
        cmocka_unit_test(answers_go_with_their_server),
        cmocka_unit_test(the_plan_has_its_own_figures),
        cmocka_unit_test(mistakes_are_refused_with_place_and_remedy),
    };
    return cmocka_run_group_tests(tests, open_fixture, close_fixture);
}

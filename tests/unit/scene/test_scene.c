/* Tests scene files: the values of a valid file, and the message for each error. */
#include "scene/scene.h" /* before cmocka.h, whose macro hides `fail` */

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cmocka.h>

static const char GOOD[] =
    "mesh: body.msh\n"                                             /* 1 */
    "rate_hz: 500\n"                                               /* 2 */
    "regions:\n"                                                   /* 3 */
    "  - name: gland\n"                                            /* 4 */
    "    youngs_modulus: 61e3\n"                                   /* 5 */
    "    poisson_ratio: 0.41\n"                                    /* 6 */
    "    cutting_force: .inf\n"                                    /* 7 */
    "    cutting_viscosity: 2.5\n"                                 /* 8 */
    "    friction: {static: 14, kinetic: 8, viscous: 90}\n"        /* 9 */
    "  - name: around\n"                                           /* 10 */
    "membranes:\n"                                                 /* 11 */
    "  - {name: skin, puncture_force: 1.1, stiffness: 250, poisson_ratio: 0.3}\n" /* 12 */
    "  - {name: capsule, puncture_force: .inf}\n"                  /* 13 */
    "fixed: [back, below]\n"                                       /* 14 */
    "needle: {length: 0.15, outer_diameter: 1.1e-3,\n"             /* 15 */
    "         inner_diameter: 0, youngs_modulus: 190e9,\n"         /* 16 */
    "         poisson_ratio: 0.29, bevel_slope: 0.02, bow: 2e-4,\n" /* 17 */
    "         segments: 30}\n"                                     /* 18 */
    "contact: {spacing: 3e-3, weakening_distance: 2e-3, prefetch_distance: 11e-3, max_passes: 5, tolerance: 1e-8, bone_compliance: 1e-4, surface_friction: 0.2, gradient_span: 4e-3}\n"
    "inverse: sparse\n"                                            /* 20 */
    "device: {profile: touch, mass: 0.3, delay: 4e-3, max_force: 15, max_torque: 0.8, max_force_rate: 1500, max_torque_rate: 70, max_speed: 1.5, max_turn_rate: 12,\n"
    "         hold_time: 0.02, ramp_time: 0.2}\n";                 /* 22 */

static char directory[] = "/tmp/test_scene.XXXXXX", path[64];

static int make_directory(void **state) {
    (void)state;
    if (!mkdtemp(directory)) return -1;
    snprintf(path, sizeof path, "%s/s.yaml", directory);
    return 0;
}

static int remove_directory(void **state) {
    (void)state;
    return rmdir(directory);
}

static trocar_status load_text(const char *text, scene *s, trocar_error *why) {
    FILE *file = fopen(path, "w");
    assert_non_null(file);
    assert_true(fputs(text, file) >= 0);
    fclose(file);
    trocar_status status = scene_load(path, s, why);
    unlink(path);
    return status;
}

static void load_good(const char *text, scene *s) {
    trocar_error why = {""};
    if (load_text(text, s, &why) != TROCAR_OK) fail_msg("%s", why.text);
}

/* Checks that the scene is refused. `words` is the part of the message after the path, such as ":12: regions[0].name: ...". */
static void assert_refused(const char *text, const char *words) {
    char expected[256];
    scene s;
    trocar_error why = {""};
    trocar_status status = load_text(text, &s, &why);
    snprintf(expected, sizeof expected, "%s%s", path, words);
    if (status != TROCAR_BAD_INPUT || strncmp(why.text, expected, strlen(expected)) != 0)
        fail_msg("status %d, \"%s\" where \"%s\" was expected", status, why.text, expected);
}

/* Checks that GOOD is refused with one part of it replaced. */
static void assert_change_refused(const char *piece, const char *other, const char *words) {
    const char *at = strstr(GOOD, piece);
    assert_non_null(at);
    char changed[sizeof GOOD + 2048];
    snprintf(changed, sizeof changed, "%.*s%s%s", (int)(at - GOOD), GOOD, other, at + strlen(piece));
    assert_refused(changed, words);
}

static void every_value_is_read(void **state) {
    (void)state;
    scene s;
    load_good(GOOD, &s);
    const simulation_config *c = &s.simulation;
    char mesh_path[128];
    snprintf(mesh_path, sizeof mesh_path, "%s/body.msh", directory);
    assert_string_equal(c->mesh_path, mesh_path);
    assert_string_equal(s.path, path);
    assert_true(s.rate_hz == 500);
    assert_int_equal(c->region_count, 2);
    assert_string_equal(c->regions[0].name, "gland");
    assert_string_equal(c->regions[1].name, "around");
    const region_material *m = &c->regions[0].material;
    assert_true(m->youngs_modulus == 61e3 && m->poisson_ratio == 0.41 && isinf(m->cutting_force) && m->cutting_viscosity == 2.5);
    assert_true(m->friction_static == 14 && m->friction_kinetic == 8 && m->friction_viscous == 90);
    assert_int_equal(c->membrane_count, 2);
    assert_string_equal(c->membranes[1].name, "capsule");
    assert_true(c->membranes[0].puncture_force == 1.1 && isinf(c->membranes[1].puncture_force));
    assert_true(c->membranes[0].material.stiffness == 250 && c->membranes[0].material.poisson_ratio == 0.3);
    assert_true(c->membranes[1].material.stiffness == 0 && c->membranes[1].material.poisson_ratio == 0.45);
    assert_int_equal(c->fixed_count, 2);
    assert_string_equal(c->fixed[0], "back");
    assert_string_equal(c->fixed[1], "below");
    const needle_parameters *n = &c->needle;
    assert_true(n->length == 0.15 && n->outer_diameter == 1.1e-3 && n->inner_diameter == 0 && n->youngs_modulus == 190e9);
    assert_true(n->poisson_ratio == 0.29 && n->bevel_slope == 0.02 && n->bow == 2e-4 && n->segments == 30);
    const insertion_settings *i = &c->insertion;
    assert_true(i->contact_spacing == 3e-3 && i->weakening_distance == 2e-3);
    assert_true(i->prefetch_distance == 11e-3 && i->max_passes == 5 && i->tolerance == 1e-8);
    assert_true(i->bone_compliance == 1e-4 && i->surface_friction == 0.2 && i->gradient_span == 4e-3);
    assert_int_equal(c->inverse, INVERSE_SPARSE);
    const device_limits *g = &s.device;
    assert_true(g->max_force == 15 && g->max_torque == 0.8 && g->max_force_rate == 1500 && g->max_torque_rate == 70);
    assert_true(g->mass == 0.3 && g->delay == 4e-3);
    assert_true(g->max_stiffness == 400); /* the stiffness comes from the profile, whose force limit is overridden */
    assert_true(g->max_speed == 1.5 && g->max_turn_rate == 12 && g->hold_time == 0.02 && g->ramp_time == 0.2);
}

static void a_device_brings_its_limits(void **state) {
    (void)state;
    scene s;
    device_limits expected = device_defaults();
    load_good("mesh: /elsewhere/a.msh\nregions: [{name: all}]\nfixed: [bottom]\ndevice: {max_torque_rate: 3, profile: delta.6}\n", &s);
    assert_true(device_use_profile("delta.6", &expected));
    expected.max_torque_rate = 3;
    assert_memory_equal(&s.device, &expected, sizeof expected);
    assert_true(s.device.max_force_rate != device_defaults().max_force_rate);
}

/* Reads a scene whose device profile is this text, stored in a file next to the scene. */
static trocar_status load_with_profile(const char *profile, const char *device, scene *s, trocar_error *why) {
    char place[96], text[256];
    snprintf(place, sizeof place, "%s/mine.yaml", directory);
    FILE *file = fopen(place, "w");
    assert_non_null(file);
    assert_true(fputs(profile, file) >= 0);
    fclose(file);
    snprintf(text, sizeof text, "mesh: a\nregions: [{name: all}]\nfixed: [b]\ndevice: {%s}\n", device);
    trocar_status status = load_text(text, s, why);
    unlink(place);
    return status;
}

static void a_profile_may_be_a_file(void **state) {
    (void)state;
    scene s;
    trocar_error why = {""};
    device_limits expected = device_defaults();
    device_use_profile("touch", &expected);
    expected.mass = 0.25;
    expected.delay = 6e-3;
    expected.max_force = 2;
    trocar_status status = load_with_profile("mass: 0.2\ndelay: 6e-3\nscale: 2\nforce_scale: 0.5\nclutch: true\nprofile: touch\nmax_force: 2\n",
                                             "mass: 0.25, profile: mine.yaml", &s, &why);
    if (status != TROCAR_OK) fail_msg("%s", why.text);
    assert_memory_equal(&s.device, &expected, sizeof expected);
    assert_true(s.mapping.scale == 2 && s.mapping.force_scale == 0.5 && s.mapping.clutch == 1);
    assert_true(s.mapping.workspace.x == 0.16 && s.mapping.workspace.z == 0.07);
    load_with_profile("workspace: [0.2, 0.3, 0.4]\nprofile: touch\n", "profile: mine.yaml", &s, &why);
    assert_true(s.mapping.workspace.x == 0.2 && s.mapping.workspace.y == 0.3 && s.mapping.workspace.z == 0.4);
}

/* The workspaces are those in 3D Systems' specifications (meshes/parameters/devices.csv). */
static void workspaces_are_those_of_the_maker(void **state) {
    (void)state;
    static const struct { const char *profile; vec3 size; } devices[] = {
        {"profile: touch\n", {0.16, 0.12, 0.07}}, {"profile: touch-x\n", {0.16, 0.12, 0.12}}, {"profile: premium-1.5-6dof\n", {0.381, 0.267, 0.191}}};
    for (int i = 0; i < 3; i++) {
        scene s;
        trocar_error why = {""};
        assert_int_equal(load_with_profile(devices[i].profile, "profile: mine.yaml", &s, &why), TROCAR_OK);
        assert_memory_equal(&s.mapping.workspace, &devices[i].size, sizeof devices[i].size);
    }
}

static void a_fault_in_a_profile_has_its_place(void **state) {
    (void)state;
    static const struct { const char *profile, *says; } bad[] = {
        {"mass: 1\nscale: 0\n", "mine.yaml:2: scale: \"0\": expected a number from 0.01 to 10"},
        {"mass: 1\n\nweight: 2\n", "mine.yaml:3: unknown key \"weight\""},
        {"mass: 1\nmass: 2\n", "mine.yaml:1: repeated key \"mass\""},
        {"profile: mine.yaml\n", "mine.yaml:1: profile: expected the name of a device"},
        {"profile: hand\n", "mine.yaml:1: profile: \"hand\": expected touch, "},
        {"[1, 2]\n", "mine.yaml:1: expected keys with values"},
        {"", "mine.yaml"},
        {"clutch: maybe\n", "mine.yaml:1: clutch: \"maybe\": expected false or true"},
        {"workspace: [1, 2]\n", "mine.yaml:1: workspace: expected three numbers (m)"},
        {"workspace: [1, 2, 0]\n", "device.workspace: expected three numbers above 0 (m)"},
    };
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        scene s;
        trocar_error why = {""};
        assert_int_equal(load_with_profile(bad[i].profile, "profile: mine.yaml", &s, &why), TROCAR_BAD_INPUT);
        if (!strstr(why.text, bad[i].says)) fail_msg("no '%s' in: %s", bad[i].says, why.text);
    }
}

static void omitted_keys_have_their_defaults(void **state) {
    (void)state;
    scene s;
    load_good("mesh: /elsewhere/a.msh\nregions: [{name: all, friction: {kinetic: 3}}]\nfixed: [bottom]\n", &s);
    simulation_config defaults;
    simulation_defaults(&defaults);
    region_material material = region_defaults();
    device_limits limits = device_defaults();
    assert_string_equal(s.simulation.mesh_path, "/elsewhere/a.msh");
    assert_true(s.rate_hz == 1000);
    assert_memory_equal(&s.simulation.needle, &defaults.needle, sizeof defaults.needle);
    assert_memory_equal(&s.simulation.insertion, &defaults.insertion, sizeof defaults.insertion);
    assert_int_equal(s.simulation.inverse, INVERSE_AUTO);
    assert_int_equal(s.simulation.membrane_count, 0);
    assert_memory_equal(&s.device, &limits, sizeof limits);
    material.friction_kinetic = 3;
    assert_memory_equal(&s.simulation.regions[0].material, &material, sizeof material);
}

/* A minimal valid scene. It ends at line 3, so lines added to it start at line 4. */
#define MINIMAL "mesh: a\nregions: [{name: x}]\nfixed: [b]\n"

/* Checks that every case is refused. A case has lines to add to MINIMAL, and `words` as in assert_refused. */
static void assert_all_refused(size_t count, const char *const cases[][2]) {
    for (size_t i = 0; i < count; i++) {
        char text[512];
        snprintf(text, sizeof text, MINIMAL "%s\n", cases[i][0]);
        assert_refused(text, cases[i][1]);
    }
}

static void inverse_and_region_of_interest_are_read(void **state) {
    (void)state;
    static const char *const names[] = {"auto", "dense", "sparse", "condensed"};
    static const inverse_choice choices[] = {INVERSE_AUTO, INVERSE_DENSE, INVERSE_SPARSE, INVERSE_CONDENSED};
    scene s;
    char text[256], cache[128];
    for (int i = 0; i < 4; i++) {
        snprintf(text, sizeof text, MINIMAL "inverse: %s\n", names[i]);
        load_good(text, &s);
        assert_int_equal(s.simulation.inverse, choices[i]);
        assert_false(roi_given(&s.simulation.roi));
        assert_string_equal(s.simulation.cache, "");
    }
    load_good(MINIMAL "cache: here\nregion_of_interest: {regions: [x, y], corridor: {from: [0, -1, 2e-3], to: [0, 0, 0.1], radius: 0.02}}\n", &s);
    const roi_config *reach = &s.simulation.roi;
    snprintf(cache, sizeof cache, "%s/here", directory);
    assert_string_equal(s.simulation.cache, cache);
    assert_int_equal(reach->region_count, 2);
    assert_string_equal(reach->regions[1], "y");
    assert_true(reach->from.y == -1.0 && reach->from.z == 2e-3 && reach->to.z == 0.1 && reach->radius == 0.02);
}

static void mesh_unit_is_read(void **state) {
    (void)state;
    static const struct { const char *line; double unit; } cases[] = {
        {"", 1.0}, {"mesh_unit: m\n", 1.0}, {"mesh_unit: cm\n", 1e-2}, {"mesh_unit: mm\n", 1e-3}, {"mesh_unit: 0.0254\n", 0.0254}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        scene s;
        char text[256];
        snprintf(text, sizeof text, MINIMAL "%s", cases[i].line);
        load_good(text, &s);
        assert_true(s.simulation.mesh_unit == cases[i].unit);
    }
}

static void a_bad_region_of_interest_is_refused(void **state) {
    (void)state;
    static const char *const cases[][2] = {
        {"inverse: big", ":4: inverse: \"big\": expected auto, dense, sparse or condensed"},
        {"cache: ''", ":4: cache: "},
        {"mesh_unit: inch", ":4: mesh_unit: \"inch\": expected m, cm, mm, or the unit's size in m"},
        {"mesh_unit: 0", ":4: mesh_unit: \"0\": expected m, cm, mm"},
        {"mesh_unit: .inf", ":4: mesh_unit: "},
        {"region_of_interest: {regions: [x, x]}", ":4: region_of_interest.regions[1]: \"x\" appears twice"},
        {"region_of_interest: {depth: 1}", ":4: region_of_interest: unknown key \"depth\""},
        {"region_of_interest: {corridor: {from: [0, 0, 0], to: [0, 0, 1]}}", ":4: region_of_interest.corridor: missing key \"radius\""},
        {"region_of_interest: {corridor: {from: [0, 0, 0], to: [0, 0, 1], radius: 0}}", ":4: region_of_interest.corridor.radius: "},
        {"region_of_interest: {corridor: {from: [0, 0, 0], to: [0, 0], radius: 1}}", ":4: region_of_interest.corridor.to: expected three numbers"},
        {"region_of_interest: {corridor: {to: [0, 0, 1], radius: 1}}", ":4: region_of_interest.corridor"},
        {"region_of_interest: {corridor: {from: [0, 0, x], to: [0, 0, 1], radius: 1}}", ":4: region_of_interest.corridor.from: \"x\""},
        {"region_of_interest: {corridor: {from: [0, 0, 1], to: [0, 0, 1], radius: 1}}", ":4: region_of_interest.corridor.to: the same point"},
    };
    assert_all_refused(sizeof cases / sizeof *cases, cases);
}

static void relaxation_is_read(void **state) {
    (void)state;
    scene s;
    trocar_error why;
    char value[32];
    load_good(MINIMAL "relaxation: [{weight: 0.25, time: 0.15}, {weight: 0.1, time: 30}]\n", &s);
    assert_int_equal(s.simulation.relaxation_count, 2);
    assert_true(s.simulation.relaxation[0].weight == 0.25 && s.simulation.relaxation[0].time == 0.15);
    assert_true(s.simulation.relaxation[1].weight == 0.1 && s.simulation.relaxation[1].time == 30);
    assert_int_equal(scene_get(&s, "relaxation[1].time", value, sizeof value, &why), TROCAR_OK);
    assert_string_equal(value, "3e+01");
    assert_int_equal(scene_set(&s, "relaxation[2].weight", "0.05", &why), TROCAR_OK); /* a new term */
    assert_int_equal(scene_check(&s, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "relaxation[2].time: not a time above 0"));
    assert_int_equal(scene_set(&s, "relaxation[2].time", "2.5", &why), TROCAR_OK);
    assert_int_equal(scene_check(&s, &why), TROCAR_OK);
    assert_int_equal(scene_set(&s, "relaxation[4].time", "1", &why), TROCAR_BAD_INPUT);
    assert_int_equal(scene_set(&s, "relaxation[liver].time", "1", &why), TROCAR_BAD_INPUT);
    load_good(MINIMAL "relaxation: []\n", &s);
    assert_int_equal(s.simulation.relaxation_count, 0);
}

static void a_bad_relaxation_is_refused(void **state) {
    (void)state;
    static const char *const cases[][2] = {
        {"relaxation: [{weight: 0, time: 1}]", ":4: relaxation[0].weight: \"0\": expected a number above 0 and below 1"},
        {"relaxation: [{weight: -0.5, time: 1}]", ":4: relaxation[0].weight: \"-0.5\": expected a number above 0 and below 1"},
        {"relaxation: [{weight: 1, time: 1}]", ":4: relaxation[0].weight: \"1\": expected a number above 0 and below 1"},
        {"relaxation:\n  - {weight: 0.5, time: 1}\n  - {weight: 0.5, time: 2}", ":6: relaxation[1].weight: the weights up to here add up to 1 or more"},
        {"relaxation: [{weight: 0.5, time: 0}]", ":4: relaxation[0].time: \"0\": expected a number above 0 (s)"},
        {"relaxation: [{weight: 0.5, time: -1}]", ":4: relaxation[0].time: \"-1\": expected a number above 0 (s)"},
        {"relaxation: [{weight: 0.5, time: .inf}]", ":4: relaxation[0].time: \".inf\": expected a number above 0 (s)"},
        {"relaxation:\n  - {weight: 0.3, time: 2}\n  - {weight: 0.3, time: 2}", ":6: relaxation[1].time: the same as that of an earlier term: add the weights"},
        {"relaxation: [{weight: 0.5}]", ":4: relaxation[0]: missing key \"time\""},
        {"relaxation: {weight: 0.5, time: 1}", ":4: relaxation: expected a list"},
        {"relaxation: [{weight: 0.1, time: 1}, {weight: 0.1, time: 2}, {weight: 0.1, time: 3}, {weight: 0.1, time: 4}, {weight: 0.1, time: 5}]",
         ":4: relaxation: 5 entries: expected at most 4"},
    };
    assert_all_refused(sizeof cases / sizeof *cases, cases);
    assert_refused("mesh: a\nregions:\n  - name: all\n    relaxation: [{weight: 0.5, time: 1}]\nfixed: [b]\n",
                   ":4: regions[0].relaxation: all regions share one series");
}

static void guides_are_read(void **unused) {
    (void)unused;
    scene s;
    load_good(MINIMAL "guides:\n  - {name: template, origin: [0, 0.01, -0.03], normal: [0, 0, 1], along: [1, 0, 0], rows_along: [0, -1, 0], columns: 13, rows: 12, spacing: 4e-3,\n"
              "     hole_diameter: 1.5e-3, thickness: 0.015, stiffness: 4e4, friction: 0.2}\n"
              "  - {name: ring, origin: [0, 0, -0.1], normal: [0, 0, 1], rows_along: [1, 0, 0], hole_diameter: 2e-3}\n", &s);
    assert_int_equal(s.simulation.guide_count, 2);
    const guide_config *g = &s.simulation.guides[0], *ring = &s.simulation.guides[1];
    assert_string_equal(g->name, "template");
    assert_true(g->origin.y == 0.01 && g->normal.z == 1.0 && g->along.x == 1.0 && g->rows_along.y == -1.0 && g->columns == 13 && g->rows == 12 && g->spacing == 4e-3);
    assert_true(g->hole_diameter == 1.5e-3 && g->thickness == 0.015 && g->stiffness == 4e4 && g->friction == 0.2 && g->line == 5);
    assert_true(ring->columns == 1 && ring->rows == 1 && ring->spacing == 5e-3 && ring->thickness == 0.02 && ring->stiffness == 50e3 && ring->friction == 0.1);
    assert_int_equal(ring->line, 7);
}

static void impossible_guides_are_refused(void **unused) {
    (void)unused;
#define GUIDE_OF(keys) "guides: [{name: g, origin: [0, 0, 0], " keys "}]"
    static const char *const cases[][2] = {
        {GUIDE_OF("normal: [0, 0, 0], hole_diameter: 2e-3"), ":4: guides[0].normal: has no direction"},
        {GUIDE_OF("normal: [0, 0, 1], hole_diameter: 1.2e-3"), ":4: guides[0].hole_diameter: a hole of 0.0012 m is smaller than the needle's outer diameter of 0.00127 m"},
        {GUIDE_OF("normal: [0, 0, 1], hole_diameter: 2e-3, columns: 2"), ":4: guides[0].along: missing"},
        {GUIDE_OF("normal: [0, 0, 1], along: [0, 0, 3], hole_diameter: 2e-3, rows: 3"), ":4: guides[0].along: parallel to the normal"},
        {GUIDE_OF("normal: [0, 0, 1], along: [1, 0, 0], rows_along: [1, 0.5, 0], hole_diameter: 2e-3, rows: 3"), ":4: guides[0].rows_along: not across the columns"},
        {GUIDE_OF("normal: [0, 0, 1], along: [1, 0, 0], rows_along: [0, 0, 1], hole_diameter: 2e-3, rows: 3"), ":4: guides[0].rows_along: not across the columns"},
        {GUIDE_OF("normal: [0, 0, 1], along: [1, 0, 0], hole_diameter: 2e-3, rows: 3, spacing: 1e-3"), ":4: guides[0].spacing: holes of 0.002 m overlap"},
        {GUIDE_OF("normal: [0, 0, .nan], hole_diameter: 2e-3"), ":4: guides[0].normal: "},
        {GUIDE_OF("normal: [0, 0, 1], hole_diameter: 0"), ":4: guides[0].hole_diameter: "},
        {GUIDE_OF("normal: [0, 0, 1], hole_diameter: 2e-3, rows: 0"), ":4: guides[0].rows: "},
        {GUIDE_OF("normal: [0, 0, 1], hole_diameter: 2e-3, columns: 101"), ":4: guides[0].columns: "},
        {GUIDE_OF("normal: [0, 0, 1], hole_diameter: 2e-3, stiffness: 0"), ":4: guides[0].stiffness: "},
        {GUIDE_OF("normal: [0, 0, 1], hole_diameter: 2e-3, friction: -1"), ":4: guides[0].friction: "},
        {GUIDE_OF("normal: [0, 0, 1], hole_diameter: 2e-3, thickness: -1"), ":4: guides[0].thickness: "},
        {GUIDE_OF("normal: [0, 0, 1]"), ":4: guides[0]: missing key \"hole_diameter\""},
        {"guides: [{origin: [0, 0, 0], normal: [0, 0, 1], hole_diameter: 2e-3}]", ":4: guides[0]: missing key \"name\""},
        {"guides: template", ":4: guides: expected a list"},
    };
    assert_all_refused(sizeof cases / sizeof *cases, cases);
}

#define TURNED "patient_to_mesh: [0, -1e-3, 0, 0.25, 1e-3, 0, 0, -0.125, 0, 0, 1e-3, 0.5, 0, 0, 0, 1]\n"

static void patient_coordinates_and_start_are_read(void **state) {
    (void)state;
    scene s;
    trocar_error why;
    char text[1024];
    load_good(MINIMAL, &s);
    assert_int_equal(scene_get(&s, "patient_to_mesh", text, sizeof text, &why), TROCAR_OK);
    assert_string_equal(text, ""); /* not given */
    assert_int_equal(scene_get(&s, "needle.start.position", text, sizeof text, &why), TROCAR_OK);
    assert_string_equal(text, "");
    load_good(MINIMAL TURNED "needle: {start: {position: [0.01, 0.02, -0.2], orientation: [0.70711, 0, 0.70711, 0]}}\n", &s);
    assert_true(s.patient_to_mesh[1] == -1e-3 && s.patient_to_mesh[3] == 0.25 && s.patient_to_mesh[7] == -0.125 && s.patient_to_mesh[15] == 1.0);
    assert_true(s.start.position.x == 0.01 && s.start.position.y == 0.02 && s.start.position.z == -0.2);
    assert_true(fabs(q_axis(s.start.orientation).x - 1.0) < 1e-12); /* normalised, although given with only five digits */
    assert_int_equal(scene_get(&s, "patient_to_mesh", text, sizeof text, &why), TROCAR_OK);
    assert_string_equal(text, "[0, -0.001, 0, 0.25, 0.001, 0, 0, -0.125, 0, 0, 0.001, 0.5, 0, 0, 0, 1]");
}

static void wrong_patient_coordinates_and_starts_are_refused(void **state) {
    (void)state;
    static const char *const cases[][2] = {
        {"patient_to_mesh: [1, 0]", ":4: patient_to_mesh: expected sixteen numbers"},
        {"patient_to_mesh: [1e-3, 0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 2]", ":4: patient_to_mesh: its last row"},
        {"patient_to_mesh: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]", ":4: patient_to_mesh: its upper left"},
        {"patient_to_mesh: [-1e-3, 0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 1]", ":4: patient_to_mesh: its upper left"},
        {"patient_to_mesh: [1e-3, 0, 0, .inf, 0, 1e-3, 0, 0, 0, 0, 1e-3, 0, 0, 0, 0, 1]", ":4: patient_to_mesh: \".inf\""},
        {"needle: {start: {orientation: [1, 0, 0, 0]}}", ":4: needle.start: missing key \"position\""},
        {"needle: {start: {position: [1, 0, 0, 0]}}", ":4: needle.start.position: expected three numbers (m)"},
        {"needle: {start: {position: [0, 0, 0], orientation: [2, 0, 0, 0]}}", ":4: needle.start.orientation: its length is 2"},
        {"needle: {start: [0, 0, 0]}", ":4: needle.start: expected keys with values"},
    };
    assert_all_refused(sizeof cases / sizeof *cases, cases);
}

static void unreadable_files_are_named(void **state) {
    (void)state;
    scene s;
    trocar_error why = {""};
    assert_int_equal(scene_load("/nowhere/lost.yaml", &s, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "/nowhere/lost.yaml: cannot open"));
    assert_int_equal(scene_load(directory, &s, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, directory));
    char *endless = malloc(2000);
    memset(endless, 'x', 1999);
    endless[1999] = '\0';
    assert_int_equal(scene_load(endless, &s, &why), TROCAR_BAD_INPUT);
    free(endless);
    assert_refused("", ": empty");
    assert_refused("# nothing\n", ": empty");
}

static void broken_yaml_is_refused_with_its_line(void **state) {
    (void)state;
    assert_change_refused("kinetic: 8, viscous: 90}", "kinetic: 8, viscous: 90", ":10: not valid YAML: ");
    assert_change_refused("rate_hz: 500", "\trate_hz: 500", ":2: not valid YAML: ");
}

static void unknown_keys_are_refused(void **state) {
    (void)state;
    assert_change_refused("rate_hz", "rate", ":2: unknown key \"rate\"");
    assert_change_refused("youngs_modulus: 61e3", "yungs_modulus: 61e3", ":5: regions[0]: unknown key \"yungs_modulus\"");
    assert_change_refused("kinetic: 8", "dynamic: 8", ":9: regions[0].friction: unknown key \"dynamic\"");
    assert_change_refused("contact: {spacing", "contact: {resolution: 0.42, spacing", ":19: contact: this release has no key \"resolution\": the simulator measures the mesh's resolution: remove the key");
    assert_change_refused("contact: {", "contact: {placement: faces, ", ":19: contact: this release has no key \"placement\": contact nodes are added inside elements: remove the key");
    assert_change_refused("needle: {", "needle: {model: tetrahedra, ", ":15: needle: this release has no key \"model\": every needle is a geometrically exact rod: remove the key");
    assert_change_refused("inverse: sparse", "remeshing: implicit", ":20: this release has no key \"remeshing\": contact nodes are added by nested addition, and scripts/bench measures other methods: remove the key");
    assert_change_refused("segments: 30", "segment: 30", ":18: needle: unknown key \"segment\"");
    assert_change_refused("rate_hz: 500", "mesh: other.msh", ":1: repeated key \"mesh\"");
    assert_change_refused("poisson_ratio: 0.41", "name: twice", ":4: regions[0]: repeated key \"name\"");
}

static void missing_mandatory_keys_are_reported(void **state) {
    (void)state;
    assert_change_refused("mesh: body.msh\n", "", ":1: missing key \"mesh\"");
    assert_change_refused("fixed: [back, below]\n", "", ":1: missing key \"fixed\"");
    assert_change_refused("  - name: around", "  - youngs_modulus: 1e3", ":10: regions[1]: missing key \"name\"");
    assert_change_refused("puncture_force: 1.1, stiffness: 250", "stiffness: 250", ":12: membranes[0]: missing key \"puncture_force\"");
    assert_refused("mesh: a\nfixed: [b]\n", ":1: missing key \"regions\"");
}

static void values_of_the_wrong_shape_are_refused(void **state) {
    (void)state;
    assert_change_refused("rate_hz: 500", "rate_hz: [500]", ":2: rate_hz: expected a single value");
    assert_change_refused("fixed: [back, below]", "fixed: back", ":14: fixed: expected a list");
    assert_change_refused("  - name: around", "  - around", ":10: regions[1]: expected keys with values");
    assert_change_refused("{static: 14, kinetic: 8, viscous: 90}", "14", ":9: regions[0].friction: expected keys with values");
    assert_refused("hello\n", ":1: expected keys with values");
    assert_refused("- mesh\n", ":1: expected keys with values");
}

static void a_part_of_a_part_is_refused(void **state) {
    (void)state;
    assert_refused("mesh: a\nregions: [{name: gland}, {name: zone, part_of: gland}, {name: cyst, part_of: zone}]\nfixed: [b]\n",
                   ":2: regions[2].part_of: \"zone\" is itself a part of \"gland\"; write that name");
}

static void values_out_of_range_are_refused(void **state) {
    (void)state;
    static const struct { const char *piece, *other, *words; } cases[] = {
        {"mesh: body.msh", "mesh: ''", ":1: mesh: "},
        {"rate_hz: 500", "rate_hz: 249", ":2: rate_hz: \"249\": expected a number from 250 to 10000 (Hz)"},
        {"rate_hz: 500", "rate_hz: 10001", ":2: rate_hz: "},
        {"rate_hz: 500", "rate_hz: fast", ":2: rate_hz: \"fast\""},
        {"rate_hz: 500", "rate_hz: 500Hz", ":2: rate_hz: \"500Hz\""},
        {"rate_hz: 500", "rate_hz: .nan", ":2: rate_hz: "},
        {"rate_hz: 500", "rate_hz: nan", ":2: rate_hz: "},
        {"rate_hz: 500", "rate_hz:", ":2: rate_hz: \"\""},
        {"name: gland", "name: ''", ":4: regions[0].name: "},
        {"name: around", "name: gland", ":10: regions[1].name: \"gland\" appears twice"},
        {"youngs_modulus: 61e3", "youngs_modulus: 0", ":5: regions[0].youngs_modulus: "},
        {"youngs_modulus: 61e3", "youngs_modulus: .inf", ":5: regions[0].youngs_modulus: "},
        {"youngs_modulus: 61e3", "youngs_modulus: 1e999", ":5: regions[0].youngs_modulus: "},
        {"poisson_ratio: 0.41", "poisson_ratio: 0.5", ":6: regions[0].poisson_ratio: \"0.5\": expected a number of at least 0 and below 0.5"},
        {"poisson_ratio: 0.41", "poisson_ratio: -0.1", ":6: regions[0].poisson_ratio: "},
        {"cutting_force: .inf", "cutting_force: -1", ":7: regions[0].cutting_force: "},
        {"cutting_viscosity: 2.5", "cutting_viscosity: .inf", ":8: regions[0].cutting_viscosity: "},
        {"poisson_ratio: 0.41", "stiffening: -0.1", ":6: regions[0].stiffening: \"-0.1\": expected a number from 0 (linear) to 10"},
        {"poisson_ratio: 0.41", "stiffening: 1e6", ":6: regions[0].stiffening: \"1e6\": expected a number from 0 (linear) to 10"},
        {"poisson_ratio: 0.41", "stiffening: .nan", ":6: regions[0].stiffening: \".nan\": expected a number from 0 (linear) to 10"},
        {"poisson_ratio: 0.41", "part_of: none", ":6: regions[0].part_of: there is no region \"none\""},
        {"poisson_ratio: 0.41", "part_of: gland", ":6: regions[0].part_of: \"gland\" is this region itself; omit the key"},
        {"kinetic: 8", "kinetic: 15", ":9: regions[0].friction.kinetic: 15 N/m exceeds the static limit of 14 N/m"},
        {"viscous: 90", "viscous: -1", ":9: regions[0].friction.viscous: "},
        {"puncture_force: 1.1", "puncture_force: -1", ":12: membranes[0].puncture_force: "},
        {"stiffness: 250", "stiffness: -1", ":12: membranes[0].stiffness: \"-1\": expected a number of at least 0"},
        {"stiffness: 250", "stiffness: .inf", ":12: membranes[0].stiffness: \".inf\": expected a number of at least 0"},
        {"stiffness: 250, poisson_ratio: 0.3", "stiffness: 250, poisson_ratio: 0.5", ":12: membranes[0].poisson_ratio: \"0.5\": expected a number of at least 0 and below 0.5"},
        {"name: capsule", "name: skin", ":13: membranes[1].name: \"skin\" appears twice"},
        {"[back, below]", "[back, back]", ":14: fixed[1]: \"back\" appears twice"},
        {"[back, below]", "[]", ":14: fixed: expected at least 1"},
        {"[back, below]", "[a, b, c, d, e, f, g, h, i]", ":14: fixed: 9 entries: expected at most 8"},
        {"length: 0.15", "length: -0.15", ":15: needle.length: "},
        {"inner_diameter: 0", "inner_diameter: 1.1e-3", ":16: needle.inner_diameter: "},
        {"outer_diameter: 1.1e-3", "outer_diameter: 1", ":15: needle.outer_diameter: "},
        {"segments: 30", "segments: 65", ":18: needle.segments: \"65\": expected a whole number from 2 to 64"},
        {"segments: 30", "segments: 2.5", ":18: needle.segments: "},
        {"spacing: 3e-3", "spacing: 0", ":19: contact.spacing: "},
        {"max_passes: 5", "max_passes: 0", ":19: contact.max_passes: "},
        {"inverse: sparse", "inverse: none", ":20: inverse: \"none\": expected "},
        {"mass: 0.3", "mass: 0", ":21: device.mass: "},
        {"delay: 4e-3", "delay: 4", ":21: device.delay: \"4\": expected a number from 0 to 0.1"},
        {"max_force: 15", "max_force: .inf", ":21: device.max_force: "},
        {"profile: touch", "profile: hand", ":21: device.profile: \"hand\": expected touch, "},
        {"ramp_time: 0.2", "ramp_time: 0", ":22: device.ramp_time: "},
    };
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++)
        assert_change_refused(cases[i].piece, cases[i].other, cases[i].words);
}

static void names_longer_than_the_mesh_can_hold_are_refused(void **state) {
    (void)state;
    char name[80] = "name: ";
    memset(name + 6, 'n', MESH_NAME - 1);
    scene s;
    char text[256];
    snprintf(text, sizeof text, "mesh: a\nregions: [{%s}]\nfixed: [b]\n", name);
    load_good(text, &s);
    assert_int_equal(strlen(s.simulation.regions[0].name), MESH_NAME - 1);
    memset(name + 6, 'n', MESH_NAME);
    snprintf(text, sizeof text, "mesh: a\nregions: [{%s}]\nfixed: [b]\n", name);
    assert_refused(text, ":2: regions[0].name: ");
}

static void recursive_aliases_are_handled(void **state) {
    (void)state;
    scene s;
    trocar_error why = {""};
    assert_int_equal(load_text("mesh: a\nregions: &r [*r]\nfixed: [b]\n", &s, &why), TROCAR_BAD_INPUT);
    assert_int_equal(load_text("mesh: a\nregions: [{name: x, friction: &f {static: *f}}]\nfixed: [b]\n", &s, &why), TROCAR_BAD_INPUT);
}

static void figure_8_scene_is_valid(void **state) {
    (void)state;
    scene s;
    trocar_error why = {""};
    if (scene_load(MESHES "/figure8.yaml", &s, &why) != TROCAR_OK) fail_msg("%s", why.text);
    assert_string_equal(s.simulation.mesh_path, MESHES "/prostate-570.msh");
    assert_int_equal(s.simulation.region_count, 2);
    assert_int_equal(s.simulation.membrane_count, 2);
}

/* A row of parameters/scene.csv: the default (NAN if none), and the values for the two regions or membranes of figure 8, which are equal if only one is
   listed. */
typedef struct { const char *key; double values[3]; } parameter;

/* Reads a row of the parameter table. Returns false for any other line. */
static bool read_parameter(const char *line, char key[64], double values[3]) {
    for (int k = 0; k < 3; k++) values[k] = NAN;
    int found = sscanf(line, "%63[^,],%lf,%lf,%lf", key, &values[0], &values[1], &values[2]) - 1;
    if (found == 0) return sscanf(line, "%*[^,],none,%lf,%lf", &values[1], &values[2]) == 2;
    for (int k = found; k < 3 && found > 0; k++) values[k] = values[found - 1];
    return found > 0;
}

static void assert_same_values(const parameter *expected, const double values[3]) {
    for (int k = 0; k < 3; k++)
        if (values[k] != expected->values[k] && !(isnan(values[k]) && isnan(expected->values[k])))
            fail_msg("parameters/scene.csv: %s: %g instead of %g", expected->key, values[k], expected->values[k]);
}

static void documented_parameter_table_is_correct(void **state) {
    (void)state;
    scene bare, figure8;
    trocar_error why = {""};
    load_good("mesh: a\nregions: [{name: all}]\nfixed: [b]\n", &bare);
    if (scene_load(MESHES "/figure8.yaml", &figure8, &why) != TROCAR_OK) fail_msg("%s", why.text);
    const calcification hard = calcification_defaults();
    const membrane_material soft = membrane_defaults();
#define ONCE(key, field) {key, {bare.field, figure8.field, figure8.field}}
#define OF_REGIONS(key, field) {"regions." key, {bare.simulation.regions[0].material.field, \
        figure8.simulation.regions[0].material.field, figure8.simulation.regions[1].material.field}}
    const parameter expected[] = {
        OF_REGIONS("youngs_modulus", youngs_modulus), OF_REGIONS("poisson_ratio", poisson_ratio),
        OF_REGIONS("stiffening", stiffening), OF_REGIONS("cutting_force", cutting_force), OF_REGIONS("cutting_viscosity", cutting_viscosity),
        OF_REGIONS("friction.static", friction_static), OF_REGIONS("friction.kinetic", friction_kinetic),
        OF_REGIONS("friction.viscous", friction_viscous), OF_REGIONS("spreading_force", spreading_force),
        ONCE("tracks.reach", simulation.insertion.track_reach), ONCE("tracks.angle", simulation.insertion.track_angle),
        {"membranes.stiffness", {soft.stiffness, figure8.simulation.membranes[0].material.stiffness, figure8.simulation.membranes[1].material.stiffness}},
        {"membranes.poisson_ratio", {soft.poisson_ratio, figure8.simulation.membranes[0].material.poisson_ratio, figure8.simulation.membranes[1].material.poisson_ratio}},
        {"membranes.puncture_force", {NAN, figure8.simulation.membranes[0].puncture_force, figure8.simulation.membranes[1].puncture_force}},
        {"calcifications.cutting_factor", {hard.cutting_factor, hard.cutting_factor, hard.cutting_factor}},
        ONCE("needle.length", simulation.needle.length), ONCE("needle.outer_diameter", simulation.needle.outer_diameter),
        ONCE("needle.inner_diameter", simulation.needle.inner_diameter), ONCE("needle.youngs_modulus", simulation.needle.youngs_modulus),
        ONCE("needle.poisson_ratio", simulation.needle.poisson_ratio), ONCE("needle.bevel_slope", simulation.needle.bevel_slope), ONCE("needle.bow", simulation.needle.bow),
        ONCE("needle.segments", simulation.needle.segments), ONCE("contact.spacing", simulation.insertion.contact_spacing),
        ONCE("contact.weakening_distance", simulation.insertion.weakening_distance),
        ONCE("contact.prefetch_distance", simulation.insertion.prefetch_distance),
        ONCE("contact.max_passes", simulation.insertion.max_passes),
        ONCE("contact.tolerance", simulation.insertion.tolerance), ONCE("contact.bone_compliance", simulation.insertion.bone_compliance),
        ONCE("contact.surface_friction", simulation.insertion.surface_friction), ONCE("contact.gradient_span", simulation.insertion.gradient_span), ONCE("rate_hz", rate_hz),
        ONCE("device.max_stiffness", device.max_stiffness), ONCE("device.mass", device.mass), ONCE("device.delay", device.delay),
        ONCE("probe.max_force", simulation.probe.max_force),
        ONCE("device.max_force", device.max_force), ONCE("device.max_torque", device.max_torque),
        ONCE("device.max_force_rate", device.max_force_rate), ONCE("device.max_torque_rate", device.max_torque_rate),
        ONCE("device.max_speed", device.max_speed), ONCE("device.max_turn_rate", device.max_turn_rate),
        ONCE("device.hold_time", device.hold_time), ONCE("device.ramp_time", device.ramp_time),
        ONCE("device.scale", mapping.scale), ONCE("device.force_scale", mapping.force_scale),
    };
#undef ONCE
#undef OF_REGIONS
    enum { COUNT = sizeof expected / sizeof *expected };
    bool seen[COUNT] = {false};
    char line[2048], key[64];
    double values[3];
    FILE *table = fopen(MESHES "/parameters/scene.csv", "r");
    assert_non_null(table);
    while (fgets(line, sizeof line, table)) {
        if (!read_parameter(line, key, values)) continue;
        int row = 0;
        while (row < COUNT && strcmp(expected[row].key, key) != 0) row++;
        if (row == COUNT || seen[row]) fail_msg("parameters/scene.csv: %s is %s", key, row == COUNT ? "not a parameter" : "listed twice");
        seen[row] = true;
        assert_same_values(&expected[row], values);
    }
    fclose(table);
    for (int row = 0; row < COUNT; row++)
        if (!seen[row]) fail_msg("parameters/scene.csv: %s is missing", expected[row].key);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_value_is_read),
        cmocka_unit_test(a_device_brings_its_limits),
        cmocka_unit_test(a_profile_may_be_a_file),
        cmocka_unit_test(workspaces_are_those_of_the_maker),
        cmocka_unit_test(a_fault_in_a_profile_has_its_place),
        cmocka_unit_test(omitted_keys_have_their_defaults),
        cmocka_unit_test(inverse_and_region_of_interest_are_read),
        cmocka_unit_test(mesh_unit_is_read),
        cmocka_unit_test(a_bad_region_of_interest_is_refused),
        cmocka_unit_test(relaxation_is_read),
        cmocka_unit_test(a_bad_relaxation_is_refused),
        cmocka_unit_test(guides_are_read),
        cmocka_unit_test(impossible_guides_are_refused),
        cmocka_unit_test(patient_coordinates_and_start_are_read),
        cmocka_unit_test(wrong_patient_coordinates_and_starts_are_refused),
        cmocka_unit_test(unreadable_files_are_named),
        cmocka_unit_test(broken_yaml_is_refused_with_its_line),
        cmocka_unit_test(unknown_keys_are_refused),
        cmocka_unit_test(missing_mandatory_keys_are_reported),
        cmocka_unit_test(values_of_the_wrong_shape_are_refused),
        cmocka_unit_test(a_part_of_a_part_is_refused),
        cmocka_unit_test(values_out_of_range_are_refused),
        cmocka_unit_test(names_longer_than_the_mesh_can_hold_are_refused),
        cmocka_unit_test(recursive_aliases_are_handled),
        cmocka_unit_test(figure_8_scene_is_valid),
        cmocka_unit_test(documented_parameter_table_is_correct),
    };
    return cmocka_run_group_tests(tests, make_directory, remove_directory);
}

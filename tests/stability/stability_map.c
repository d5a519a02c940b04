/* Computes the stability map: with devices of various masses and delays, a hand pushes the needle onto bone, into liver or through air, and then keeps
   still. Prints one CSV row for each combination. scripts/figures draws docs/figures/stability-map.svg from the files in docs/results/stability. */
#include <getopt.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "closed_loop.h"
#include "coupling/swing_observer.h"

static const char USAGE[] =
    "usage: stability_map [--OPTION=VALUE[,VALUE...]...]\n"
    "  --profile   devices of the scene (default none,touch,omega.3)\n"
    "  --tissue    bone, liver, air (default bone,liver)\n"
    "  --hand      stiffness (N/m) and damping (N s/m), as 300:3 (default 500:2)\n"
    "  --mass      kg, of device and hand (default 0.05,0.1,0.2,0.5)\n"
    "  --delay     ms, each way between bridge and device (default 0,1,2,3,4,5,7,10)\n"
    "  --told      the scene's device.delay is that of the device\n"
    "  --scale     motion of the needle per motion of the hand, and force on the hand per force on the needle, which bridge and scene apply, as 2:1 (default 1:1)\n"
    "  --set       KEY=VALUE of the scene, after the profile\n"
    "  --device    period (ms) and resolution (mm) of the device, as 1:0.05 (default 1:0.05)\n"
    "  --control   what keeps the hand from swinging: server (default), its observer of swings; known, blind: in place of it, a passivity observer and\n"
    "              controller in the bridge (tests/stability/passivity.h), which knows the device's delay or takes it for none; none: nothing\n"
    "  --check     ends with status 1 if a hand still swings by more than 0.5 mm after 5 s, or the needle buckles\n";

enum { MOST = 16 };
typedef struct { int count; char *values[MOST]; } list;

static struct {
    list profiles, tissues, hands, masses, delays, keys, devices;
    bool told, check;
    const char *scale;
    const char *control;
    int unstable;            /* points so far */
} choice = {
    .profiles = {3, {"none", "touch", "omega.3"}},
    .tissues = {2, {"bone", "liver"}},
    .hands = {1, {"500:2"}},
    .masses = {4, {"0.05", "0.1", "0.2", "0.5"}},
    .delays = {8, {"0", "1", "2", "3", "4", "5", "7", "10"}},
    .devices = {1, {"1:0.05"}},
    .control = "server",
    .scale = "1:1",
};

#define EACH(value, list) for (char **value = (list).values; value < (list).values + (list).count; value++)

/* The figure-8 scene with these keys changed. The needle's tip starts `gap` (m) in front of the skin, and the hand pushes by `push` (m). For bone, the
   tissue has the modulus of cortical bone, because skin that cannot be punctured would only be as stiff as the tissue below it (40 N/m). The needle is then
   too thick to buckle, because buckling would end the force and with it any oscillation. */
typedef struct { const char *name; double gap, push; const char *keys[4][2]; } surroundings;
static const surroundings EVERYWHERE[] = {
    {"bone", 1e-3, 11e-3, {{"membranes[skin].puncture_force", ".inf"}, {"regions[prostate].youngs_modulus", "10e9"},
                           {"regions[surrounding].youngs_modulus", "10e9"}, {"needle.outer_diameter", "4e-3"}}},
    {"liver", 1e-3, 41e-3, {{"regions[prostate].youngs_modulus", "4.5e3"}, {"regions[surrounding].youngs_modulus", "4.5e3"},
                            {"regions[prostate].cutting_force", "0.25"}}},
    {"air", 60e-3, 40e-3, {{NULL}}},
};
static const double SPEED = 0.1;             /* m/s, of the push */
static const double SETTLED = 2.0;           /* s, rest before the push */
static const double WINDOW = 0.25;           /* s */
enum { WINDOWS = 20 };                       /* after it */
static const double LARGE = 0.5e-3;          /* m; a larger oscillation counts as unstable */

static const surroundings *find_tissue(const char *name) {
    for (size_t i = 0; i < sizeof EVERYWHERE / sizeof *EVERYWHERE; i++)
        if (strcmp(EVERYWHERE[i].name, name) == 0) return &EVERYWHERE[i];
    fprintf(stderr, "no tissue '%s'\n%s", name, USAGE);
    exit(2);
}

static void pair(const char *text, double *first, double *second) {
    if (sscanf(text, "%lf:%lf", first, second) == 2) return;
    fprintf(stderr, "%s: expected two numbers with a colon\n%s", text, USAGE);
    exit(2);
}

static bool is_server_in_control(void) { return strcmp(choice.control, "server") == 0; }

/* Calls the server's own observer, or does nothing under any other control. */
int __real_swing_observe(swing_observer *s, vec3 position, vec3 force, int64_t now);
int __wrap_swing_observe(swing_observer *s, vec3 position, vec3 force, int64_t now);
int __wrap_swing_observe(swing_observer *s, vec3 position, vec3 force, int64_t now) {
    return is_server_in_control() ? __real_swing_observe(s, position, force, now) : 0;
}

/* A command's effect on the position is read one round trip and one period of the device's loop later. */
static passivity controller_of(const device_properties *d, double period, double max_force) {
    int delay = strcmp(choice.control, "blind") == 0 ? 1 : 1 + (int)lround(2.0 * d->delay / period);
    double damping = strcmp(choice.control, "none") == 0 ? 0.0 : passivity_damping(0.1, delay * period);
    return (passivity){.period = period, .delay = delay, .max_force = max_force, .most_damping = damping};
}

static void set(trocar_scene *scene, const char *key, const char *value) {
    trocar_error why;
    if (trocar_scene_set(scene, key, value, &why) == TROCAR_OK) return;
    fprintf(stderr, "%s: %s\n", key, why.text);
    exit(2);
}

static void set_number(trocar_scene *scene, const char *key, double value) {
    char text[32];
    snprintf(text, sizeof text, "%.9g", value);
    set(scene, key, text);
}

static trocar_scene *open_scene(const char *profile, const surroundings *in) {
    trocar_error why;
    trocar_scene *scene;
    if (trocar_scene_load(MESHES "/figure8.yaml", &scene, &why) != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        exit(1);
    }
    for (int i = 0; i < 4 && in->keys[i][0]; i++) set(scene, in->keys[i][0], in->keys[i][1]);
    if (strcmp(profile, "none") != 0) set(scene, "device.profile", profile);
    double scale, force_scale;
    pair(choice.scale, &scale, &force_scale);
    set_number(scene, "device.scale", scale);
    set_number(scene, "device.force_scale", force_scale);
    EACH(key, choice.keys) {
        char *value = strchr(*key, '=');
        if (value == NULL) continue;
        *value = '\0';
        set(scene, *key, value + 1);
        *value = '=';
    }
    return scene;
}

/* Simulates one point of the map and prints its row. */
static void judge(trocar_model *model, trocar_scene *scene, const char *profile, const surroundings *in, const char *hand, const char *mass,
                  const char *delay, const char *device) {
    /* Behaves like a bridge such as trocar-haply with its default settings. */
    loop_properties p = {.period = 1e-3, .sampling = 1e-3, .network = 0.1e-3, .max_force = 3, .max_force_rate = 400, .names_wrenches = true};
    device_properties d = {.mass = atof(mass), .delay = 1e-3 * atof(delay)};
    pair(choice.scale, &p.scale, &p.force_scale);
    pair(hand, &d.stiffness, &d.damping);
    pair(device, &d.period, &d.resolution);
    d.period *= 1e-3;
    d.resolution *= 1e-3;
    if (choice.told) set_number(scene, "device.delay", 2.0 * d.delay);
    trocar_device_limits limits = trocar_scene_device(scene);
    closed_loop *l = rig_create(model, &limits, &p, &d, v3(0.005, 0.003, -0.2 - in->gap));
    if (!is_server_in_control()) l->passivity = controller_of(&d, p.sampling, p.max_force);
    rig_run(l, SETTLED);
    device_push(&l->device, v3(0, 0, SPEED), rig_time(l), rig_time(l) + in->push / SPEED);
    rig_run(l, in->push / SPEED);
    double swing = 0.0, widest = 0.0, quiet = 0.0, force = l->greatest_force;
    int flags = l->flags;
    for (int i = 0; i < WINDOWS; i++) {
        rig_watch(l);
        rig_run(l, WINDOW);
        swing = device_swing(&l->device);
        widest = fmax(widest, swing);
        force = fmax(force, l->greatest_force);
        flags |= l->flags;
        if (swing > LARGE) quiet = WINDOW * (i + 1);
    }
    printf("%s,%s,%s,%s,%s,%s,%d,%.4f,%.2f,%.3f,%.3f,%.1f,%d%s", profile, in->name, hand, device, mass, delay, choice.told, 1e3 * swing, quiet,
           1e3 * widest, force, l->haptic.needles[0].coupling.stiffness, (flags & TROCAR_NEEDLE_WRENCH_T_ACTIVE) != 0, is_server_in_control() ? "\n" : "");
    if (!is_server_in_control()) printf(",%s,%.3f\n", choice.control, 1e3 * l->passivity.most);
    fflush(stdout);
    choice.unstable += swing > LARGE || (flags & TROCAR_NEEDLE_WRENCH_T_UNSTABLE);
    rig_free(l);
}

static void draw(const char *profile, const surroundings *in) {
    trocar_error why;
    trocar_model *model;
    trocar_scene *scene = open_scene(profile, in);
    if (trocar_model_create(scene, NULL, &model, &why) != TROCAR_OK) {
        fprintf(stderr, "%s\n", why.text);
        exit(1);
    }
    EACH(hand, choice.hands) EACH(device, choice.devices) EACH(mass, choice.masses) EACH(delay, choice.delays)
        judge(model, scene, profile, in, *hand, *mass, *delay, *device);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

static void parse(int count, char **arguments) {
    static const struct option options[] = {{"profile", 1, NULL, 'p'}, {"tissue", 1, NULL, 't'}, {"hand", 1, NULL, 'h'}, {"mass", 1, NULL, 'm'}, {"delay", 1, NULL, 'd'},
                                            {"set", 1, NULL, 's'}, {"device", 1, NULL, 'v'}, {"told", 0, NULL, 'k'}, {"check", 0, NULL, 'c'}, {"control", 1, NULL, 'y'},
                                            {"scale", 1, NULL, 'x'}, {0}};
    list *lists[] = {['p'] = &choice.profiles, ['t'] = &choice.tissues, ['h'] = &choice.hands, ['m'] = &choice.masses, ['d'] = &choice.delays,
                     ['s'] = &choice.keys, ['v'] = &choice.devices};
    for (int key; (key = getopt_long(count, arguments, "", options, NULL)) != -1;) {
        choice.told |= key == 'k';
        choice.check |= key == 'c';
        if (key == 'y') choice.control = optarg;
        if (key == 'x') choice.scale = optarg;
        if (key == 'k' || key == 'c' || key == 'y' || key == 'x') continue;
        if (key == '?') exit((fputs(USAGE, stderr), 2));
        list *l = lists[key];
        l->count = 0;
        for (char *value = strtok(optarg, ","); value != NULL && l->count < MOST; value = strtok(NULL, ",")) l->values[l->count++] = value;
    }
}

int main(int count, char **arguments) {
    parse(count, arguments);
    if (strstr(" server known blind none ", choice.control) == NULL) exit((fputs(USAGE, stderr), 2));
    printf("profile,tissue,hand,device,mass_kg,delay_ms,told,swing_mm,quiet_s,widest_mm,force_n,stiffness_n_per_m,active%s\n", is_server_in_control() ? "" : ",control,energy_mj");
    EACH(profile, choice.profiles) EACH(tissue, choice.tissues) draw(*profile, find_tissue(*tissue));
    if (choice.unstable > 0) fprintf(stderr, "stability_map: at %d points the hand does not come to rest, or the needle has buckled\n", choice.unstable);
    return choice.check && choice.unstable > 0;
}

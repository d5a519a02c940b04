#include "device/profile_check.h"

#include <math.h>
#include <string.h>

#include "common/coupling_rule.h"
#include "shared/json.h"

static const double HAND_DAMPING = 2.0, HAND_STIFFNESS = 500.0; /* N s/m and N/m: the hand of tests/stability/stability_map.c */
static const double RESOLUTION = 0.05e-3;    /* m, resolution of the device, as in stability_map.c */
static const double LEAST_MARGIN = 2.0;      /* stability margin below which the check gives advice */

/* ---- the profile ----------------------------------------------------------------------------------------------------- */

static trocar_status read_numbers(const trocar_scene *scene, profile_result *r, trocar_error *why) {
    const struct { const char *key; double *value; } numbers[] = {
        {"device.max_force", &r->max_force}, {"device.max_force_rate", &r->max_force_rate}, {"device.max_stiffness", &r->max_stiffness},
        {"device.scale", &r->scale}, {"device.force_scale", &r->force_scale}, {"device.mass", &r->loop.mass},
    };
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) {
        trocar_status status = trocar_scene_get_number(scene, numbers[i].key, numbers[i].value, why);
        if (status != TROCAR_OK) return status;
    }
    char text[256];
    trocar_status status = trocar_scene_get(scene, "device.clutch", text, sizeof text, why);
    if (status != TROCAR_OK) return status;
    r->clutch = strcmp(text, "true") == 0;
    r->width = r->height = r->depth = NAN;
    status = trocar_scene_get(scene, "device.workspace", text, sizeof text, why);
    if (status == TROCAR_OK) sscanf(text, "[%lf, %lf, %lf]", &r->width, &r->height, &r->depth);
    return status;
}

static trocar_status read_profile(const char *profile, profile_result *r, trocar_error *why) {
    trocar_scene *scene;
    trocar_error reason;
    trocar_status status = trocar_scene_create(&scene, why);
    if (status != TROCAR_OK) return status;
    status = trocar_scene_set(scene, "device.profile", profile, &reason);
    if (status == TROCAR_OK) status = read_numbers(scene, r, why);
    else fail(why, status, "--profile: %s", reason.text);
    if (status == TROCAR_OK) r->limits = trocar_scene_device(scene);
    if (status == TROCAR_OK) status = trocar_scene_get_number(scene, "needle.start.depth", &r->travel, why);
    trocar_scene_free(scene);
    snprintf(r->name, sizeof r->name, "%s", profile);
    return status;
}

static trocar_status read_travel(const char *path, profile_result *r, trocar_error *why) {
    trocar_scene *scene;
    trocar_status status = trocar_scene_load(path, &scene, why);
    if (status != TROCAR_OK) return status;
    status = trocar_scene_get_number(scene, "needle.start.depth", &r->travel, why);
    trocar_scene_free(scene);
    return status;
}

/* ---- the check ------------------------------------------------------------------------------------------------------- */

static double hand_travel(const profile_result *r) { return r->travel / r->scale; }

/* Sets up the simulated device, and the coupling that the server would choose for it. */
static void set_up_loop(const profile_settings *s, profile_result *r) {
    haptic_loop *l = &r->loop;
    double period = 1.0 / s->rate, to_hand = r->scale * r->force_scale;
    r->assumed_delay = s->round_trip + period + r->limits.delay;
    r->device_delay = s->device_delay >= 0.0 ? s->device_delay : r->limits.delay;
    double stiffness = coupling_rule_stiffness(&r->limits, r->assumed_delay);
    l->coupling_stiffness = to_hand * stiffness;
    l->coupling_damping = to_hand * coupling_rule_damping(stiffness, r->assumed_delay);
    if (s->mass > 0.0) l->mass = s->mass;
    l->damping = s->damping >= 0.0 ? s->damping : HAND_DAMPING;
    l->stiffness = s->stiffness > 0.0 ? s->stiffness : HAND_STIFFNESS;
    l->period = period;
    l->delay = (int)ceil((s->round_trip + r->device_delay) / period - 1e-9); /* not counting the period during which a force is held */
}

static void judge_loop(profile_result *r) {
    const haptic_loop *l = &r->loop;
    haptic_loop light = *l;
    double ignored;
    light.mass *= 0.5;
    r->stability_margin = loop_gain_margin(l, &r->stability_frequency);
    r->simulated_margin = loop_simulated_margin(l);
    r->half_mass_margin = loop_gain_margin(&light, &ignored);
    r->required_damping = loop_required_damping(l, &r->passivity_frequency);
    r->passivity_margin = l->damping / r->required_damping;
    r->push = loop_push(l, &(loop_limits){r->max_force, r->max_force_rate, RESOLUTION});
}

trocar_status profile_check(const profile_settings *settings, profile_result *r, trocar_error *why) {
    *r = (profile_result){0};
    trocar_status status = read_profile(settings->profile, r, why);
    if (status == TROCAR_OK && settings->scene) status = read_travel(settings->scene, r, why);
    if (status != TROCAR_OK) return status;
    if (isinf(r->max_stiffness))
        return fail(why, TROCAR_BAD_INPUT, "--profile: %s: max_stiffness is .inf: without a virtual coupling, there is no stiffness to check; set a number", r->name);
    r->strokes = isnan(r->depth) ? 0 : (int)ceil(hand_travel(r) / r->depth - 1e-9);
    set_up_loop(settings, r);
    judge_loop(r);
    return TROCAR_OK;
}

/* ---- the report ------------------------------------------------------------------------------------------------------ */

static bool fits(const profile_result *r) { return r->strokes <= 1 || r->clutch; }
static bool is_stable(const profile_result *r) { return r->stability_margin > 1.0 && r->simulated_margin > 1.0 && isfinite(r->push.rest_time); }

static void print_travel(const profile_result *r, FILE *out) {
    fprintf(out, "travel              %.0f mm of the needle, %.0f mm of the hand at a scale of %g: ", 1e3 * r->travel, 1e3 * hand_travel(r), r->scale);
    if (r->strokes == 0) fprintf(out, "not checked; set workspace\n");
    else if (r->strokes == 1) fprintf(out, "fits into a depth of %.0f mm\n", 1e3 * r->depth);
    else if (r->clutch) fprintf(out, "%d strokes with the clutch in a depth of %.0f mm\n", r->strokes, 1e3 * r->depth);
    else fprintf(out, "DOES NOT FIT into a depth of %.0f mm; set scale to at least %.2f, or use a clutch (clutch: true) and %d strokes\n", 1e3 * r->depth,
                 ceil(100.0 * r->travel / r->depth - 1e-9) / 100.0, r->strokes);
}

static void print_loop(const profile_result *r, FILE *out) {
    const haptic_loop *l = &r->loop;
    fprintf(out, "simulated device    %g kg and %g N s/m with the hand, which holds it with %g N/m; %g ms of delay\n", l->mass, l->damping, l->stiffness,
            1e3 * r->device_delay);
    fprintf(out, "coupling            %.0f N/m and %.2f N s/m at the hand, designed for %.1f ms; forces act %.1f ms after the position\n", l->coupling_stiffness,
            l->coupling_damping, 1e3 * r->assumed_delay, 1e3 * l->period * l->delay);
    fprintf(out, "stability           margin %.2f in theory (%.1f Hz), %.2f in simulation, %.2f with half the mass: %s\n", r->stability_margin, r->stability_frequency,
            r->simulated_margin, r->half_mass_margin, !is_stable(r) ? "UNSTABLE" : r->stability_margin < LEAST_MARGIN ? "LOW" : "stable");
    fprintf(out, "passivity           margin %.2f: device and hand damp by %g N s/m, and %.2f N s/m (at %.1f Hz) make it stable with every hand\n", r->passivity_margin,
            l->damping, r->required_damping, r->passivity_frequency);
    if (isfinite(r->push.rest_time)) fprintf(out, "push onto bone      at rest within %.2f s", r->push.rest_time);
    else fprintf(out, "push onto bone      NOT AT REST after 5 s");
    fprintf(out, ", at most %.2f N; the hand has received at most %.2f mJ more than it gave\n", r->push.force, 1e3 * r->push.energy);
    if (!is_stable(r) || r->stability_margin < LEAST_MARGIN)
        fprintf(out, "advice              measure delay and mass of the device and set them in the profile, or lower max_stiffness\n");
}

bool profile_print(const profile_result *r, FILE *out) {
    fprintf(out, "profile             %s\n", r->name);
    fprintf(out, "limits of the hand  %g N, %g N/s, %g N/m\n", r->max_force, r->max_force_rate, r->max_stiffness);
    if (isnan(r->depth)) fprintf(out, "workspace           unknown\n");
    else fprintf(out, "workspace           %.0f x %.0f x %.0f mm: width, height, depth\n", 1e3 * r->width, 1e3 * r->height, 1e3 * r->depth);
    print_travel(r, out);
    print_loop(r, out);
    return fits(r) && is_stable(r);
}

void profile_write_json(const profile_result *r, FILE *out) {
    const haptic_loop *l = &r->loop;
    const struct { const char *name; double value; } numbers[] = {
        {"max_force_N", r->max_force}, {"max_force_rate_N_per_s", r->max_force_rate}, {"max_stiffness_N_per_m", r->max_stiffness},
        {"scale", r->scale}, {"force_scale", r->force_scale}, {"depth_m", r->depth}, {"travel_m", r->travel}, {"hand_travel_m", hand_travel(r)},
        {"mass_kg", l->mass}, {"damping_Ns_per_m", l->damping}, {"hand_stiffness_N_per_m", l->stiffness}, {"device_delay_s", r->device_delay},
        {"assumed_delay_s", r->assumed_delay}, {"period_s", l->period}, {"coupling_stiffness_N_per_m", l->coupling_stiffness},
        {"coupling_damping_Ns_per_m", l->coupling_damping}, {"stability_margin", r->stability_margin}, {"stability_frequency_Hz", r->stability_frequency},
        {"simulated_stability_margin", r->simulated_margin}, {"half_mass_stability_margin", r->half_mass_margin},
        {"required_damping_Ns_per_m", r->required_damping}, {"passivity_frequency_Hz", r->passivity_frequency}, {"passivity_margin", r->passivity_margin},
        {"rest_time_s", r->push.rest_time}, {"push_force_N", r->push.force}, {"push_energy_J", r->push.energy},
    };
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_line(&j), json_text(&j, "profile", r->name);
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) json_line(&j), json_exact(&j, numbers[i].name, numbers[i].value);
    json_line(&j), json_integer(&j, "delay_periods", l->delay);
    json_line(&j), json_integer(&j, "strokes", r->strokes);
    json_line(&j), json_bool(&j, "clutch", r->clutch);
    json_line(&j), json_bool(&j, "fits", fits(r));
    json_line(&j), json_bool(&j, "stable", is_stable(r));
    fputs("\n", out);
    json_close(&j, '}');
    fputs("\n", out);
}

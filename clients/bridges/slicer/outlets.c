#include "outlets.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "common/messages.h"
#include "common/timing.h"
#include "shared/events.h"
#include "shared/json.h"

enum { STATUS, NEEDLES, BASE = 0, TIP, FORCE, CURVE, PER_NEEDLE, PER_PROBE = 2 };

/* ---- names ---- */

/* Names a needle's message: "NeedleToReference" for the first needle, "Needle2ToReference" for the second. The tip's message is called "Tip2ToReference",
   because names are limited to 20 characters. */
static void name_needle(igtl_message *m, int needle) {
    char base[32] = "NeedleToReference", tip[32] = "NeedleTipToReference", force[32] = "NeedleForce", curve[32] = "Needle";
    if (needle > 0) {
        snprintf(base, sizeof base, "Needle%dToReference", needle + 1);
        snprintf(tip, sizeof tip, "Tip%dToReference", needle + 1);
        snprintf(force, sizeof force, "Needle%dForce", needle + 1);
        snprintf(curve, sizeof curve, "Needle%d", needle + 1);
    }
    igtl_name(m + BASE, "TRANSFORM", base);
    igtl_name(m + TIP, "TRANSFORM", tip);
    igtl_name(m + FORCE, "TRANSFORM", force);
    igtl_name(m + CURVE, "POLYDATA", curve);
}

static void name_all(outlets *o) {
    igtl_message *m = o->messages;
    igtl_name(m + STATUS, "STRING", "TrocarStatus");
    for (int i = 0; i < trocar_model_needles(o->model); i++) name_needle(m + o->needles + PER_NEEDLE * i, i);
    if (o->probe >= 0) {
        igtl_name(m + o->probe, "TRANSFORM", "ProbeToReference");
        igtl_name(m + o->probe + 1, "TRANSFORM", "ProbeForce");
    }
    if (o->images >= 0) {
        igtl_name(m + o->images + SLICE_AXIAL, "IMAGE", "AxialImage");
        igtl_name(m + o->images + SLICE_SAGITTAL, "IMAGE", "SagittalImage");
    }
}

trocar_status outlets_create(outlets *o, const trocar_scene *scene, const trocar_model *model, const slice_settings *images, trocar_error *why) {
    double patient[16];
    trocar_probe_shape probe;
    *o = (outlets){.model = model, .frame = ras_frame(scene), .registered = trocar_scene_patient_to_mesh(scene, patient) != 0, .needles = NEEDLES,
                   .probe = -1, .images = -1, .organ_count = organs_count(model)};
    trocar_scene_get_number(scene, "needle.outer_diameter", &o->needle_radius, NULL);
    o->needle_radius *= 0.5;
    o->count = NEEDLES + PER_NEEDLE * trocar_model_needles(model);
    if (trocar_model_probe(model, &probe)) o->probe = o->count, o->count += PER_PROBE;
    o->light_count = o->count;
    if (images->style != SLICES_NONE) o->images = o->count, o->count += SLICES;
    int surfaces = o->count;
    o->count += o->organ_count;
    o->messages = calloc((size_t)o->count, sizeof *o->messages);
    o->organs = calloc((size_t)o->organ_count + 1, sizeof *o->organs);
    o->nodes = malloc(3 * (size_t)trocar_model_node_count(model) * sizeof *o->nodes);
    if (!o->messages || !o->organs || !o->nodes) return fail(why, TROCAR_NO_MEMORY, "no memory for the messages to clients");
    name_all(o);
    for (int i = 0; i < trocar_model_needles(model); i++)
        if (!igtl_make_curve(&o->messages[o->needles + PER_NEEDLE * i + CURVE], trocar_model_segments(model) + 1))
            return fail(why, TROCAR_NO_MEMORY, "no memory for the needles' shapes");
    trocar_status status = organs_make(model, o->organs, o->messages + surfaces, why);
    return status == TROCAR_OK ? slices_create(&o->slices, scene, model, images, why) : status;
}

void outlets_free(outlets *o) {
    for (int i = 0; i < o->count && o->messages; i++) igtl_free(&o->messages[i]);
    if (o->organs) organs_free(o->organs, o->organ_count);
    slices_free(&o->slices);
    free(o->messages);
    free(o->organs);
    free(o->nodes);
}

/* ---- pictures ---- */

/* Returns the tip frame: the base frame, parallel-transported along the needle (without twist) and then rotated by the angle by which the tip leads the
   base. */
static pose tip_of(const trocar_contacts_t *c) {
    quat turn = load_pose(c->centreline[0], c->orientation).orientation;
    for (int i = 1; i < c->joint_count; i++) {
        vec3 along = v3_sub(load_vec3(c->centreline[i]), load_vec3(c->centreline[i - 1])), axis = q_axis(turn), normal = v3_cross(axis, along);
        double sine = v3_norm(normal);
        if (sine > 0) turn = q_unit(q_multiply(q_exp(v3_scale(atan2(sine, v3_dot(axis, along)) / sine, normal)), turn));
    }
    turn = q_multiply(turn, q_exp(v3(0, 0, c->tip_lead)));
    return (pose){load_vec3(c->centreline[c->joint_count - 1]), turn};
}

static void show_needle(const outlets *o, int needle, const trocar_contacts_t *c) {
    igtl_message *m = o->messages + o->needles + PER_NEEDLE * needle;
    ras_matrix base = ras_of_pose(&o->frame, load_pose(c->centreline[0], c->orientation)), tip = ras_of_pose(&o->frame, tip_of(c));
    if (m[BASE].utime == c->utime) return;
    igtl_set_transform(m + BASE, c->utime, &base);
    igtl_set_transform(m + TIP, c->utime, &tip);
    float curve[TROCAR_MAX_JOINTS][3];
    if (c->joint_count != trocar_model_segments(o->model) + 1) return;
    for (int i = 0; i < c->joint_count; i++) {
        vec3 place = mesh_to_patient(&o->frame, load_vec3(c->centreline[i]));
        curve[i][0] = (float)place.x, curve[i][1] = (float)place.y, curve[i][2] = (float)place.z;
    }
    igtl_move_points(m + CURVE, c->utime, curve[0], c->joint_count);
}

static void displace(const outlets *o, const trocar_deformation_t *d) {
    const double *rest = trocar_model_nodes(o->model);
    for (int n = 0; n < trocar_model_node_count(o->model); n++)
        for (int a = 0; a < 3; a++) o->nodes[3 * n + a] = rest[3 * n + a] + (d ? (double)d->displacement[n][a] : 0);
}

void outlets_show_picture(outlets *o, const subscriber *feed) {
    const trocar_deformation_t *d = feed->deformation;
    int64_t utime = d ? d->utime : wall_us();
    displace(o, d);
    for (int i = 0; i < feed->needle_count; i++) {
        const trocar_contacts_t *c = feed->needles[i].contacts;
        if (!c || c->joint_count < 2) continue;
        show_needle(o, i, c);
    }
    for (int i = 0; i < o->organ_count; i++) organ_move(&o->organs[i], utime, &o->frame, o->nodes);
    pose probe = load_pose(feed->probe.base.position, feed->probe.base.orientation);
    bodies_take(&o->bodies, feed, o->model, o->needle_radius);
    slices_tell(&o->slices, utime, o->nodes, feed->probe.placed ? &probe : NULL, &o->bodies);
}

void outlets_show_images(outlets *o) {
    const drawn_slices *drawn = slices_take(&o->slices);
    for (int k = 0; k < SLICES && drawn; k++) {
        const slice *v = &o->slices.all[k];
        ras_matrix matrix = slice_matrix(&o->slices, drawn, (slice_kind)k, &o->frame);
        igtl_set_image(&o->messages[o->images + k], drawn->utime, &matrix, v->raster.width, v->raster.height, drawn->grey + v->first);
    }
}

/* ---- forces ---- */

void outlets_show_forces(outlets *o, const subscriber *feed) {
    for (int i = 0; i < feed->needle_count; i++) {
        igtl_message *m = o->messages + o->needles + PER_NEEDLE * i + FORCE;
        const trocar_needle_wrench_t *w = &feed->needles[i].wrench;
        if (feed->needles[i].heard == 0 || m->utime == w->utime) continue;
        ras_matrix force = ras_of_vector(&o->frame, w->force);
        igtl_set_transform(m, w->utime, &force);
    }
    if (o->probe < 0 || !feed->probe.placed) return;
    int64_t now = wall_us(); /* use the current time: the subscriber does not keep the times of the probe's messages */
    const trocar_probe *p = &feed->probe;
    ras_matrix place = ras_of_pose(&o->frame, load_pose(p->base.position, p->base.orientation)), force = ras_of_vector(&o->frame, p->force);
    igtl_set_transform(&o->messages[o->probe], now, &place);
    igtl_set_transform(&o->messages[o->probe + 1], now, &force);
}

/* ---- status ---- */

static void write_needle(json *j, const needle_feed *n) {
    static const char *const states[] = {"held", "leaving", "resting", "taking"};
    unsigned bit;
    const char *word;
    json_open(j, NULL, '{');
    json_text(j, "state", n->status && (size_t)n->status->state < sizeof states / sizeof *states ? states[n->status->state] : "");
    json_bool(j, "owned", n->status && n->status->owner != 0);
    json_number(j, "depth_mm", 1e3 * n->wrench.depth);
    json_number(j, "force_N", v3_norm(load_vec3(n->wrench.force)));
    json_integer(j, "contacts", n->wrench.contacts);
    json_open(j, "flags", '[');
    for (int i = 0; flag_at(i, &bit, &word); i++)
        if ((unsigned)n->wrench.flags & bit) json_text(j, NULL, word);
    json_close(j, ']');
    json_close(j, '}');
}

void outlets_show_status(outlets *o, subscriber *feed) {
    char *text = NULL;
    size_t length = 0;
    FILE *out = open_memstream(&text, &length);
    if (!out) return;
    const trocar_status_t *status = feed->needles[0].status;
    bool alive = subscriber_alive(feed);
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_bool(&j, "server", alive);
    json_text(&j, "coordinates", o->registered ? "patient, RAS mm" : "mesh, mm");
    if (alive && status) {
        json_text(&j, "scene", status->scene);
        json_text(&j, "message", status->message);
    }
    json_open(&j, "needles", '[');
    for (int i = 0; i < feed->needle_count && alive; i++)
        if (feed->needles[i].heard) write_needle(&j, &feed->needles[i]);
    json_close(&j, ']');
    json_close(&j, '}');
    fclose(out);
    if (text) igtl_set_string(&o->messages[STATUS], wall_us(), text);
    free(text);
}

#define _GNU_SOURCE
#include "view/ultrasound/scanner.h"

#include <errno.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "base/cache_line.h"
#include "base/triple_buffer.h"
#include "common/eventfd_signal.h"
#include "common/messages.h"
#include "common/timing.h"
#include "shared/json.h"
#include "shared/patient.h"
#include "view/stream/section_box.h"
#include "view/ultrasound/bodies.h"
#include "view/ultrasound/echo.h"

static const double PIXEL = 0.25e-3;         /* m, size of a pixel */
static const double SHALLOWEST = 0.02, DEEPEST = 0.15; /* m, range of depths that a browser can request */
static const int64_t PATIENCE = 2000000000;  /* ns after which a request expires */

/* What a browser wants to see. */
typedef struct {
    double place[SLICES];    /* m, of the axial image on the z axis and the sagittal one on the x axis; unused with a probe, which then determines them */
    double depth;            /* m; 0 for deep enough to cover the gland */
    bool sagittal;
} wish;

/* Input of the thread. */
typedef struct {
    wish wish;
    bool has_probe;
    pose probe;
    body_list bodies;
    double nodes[];          /* [nodes][3], m */
} told_state;

/* Identifies the data of the thread's last input. */
typedef struct {
    wish wish;
    int64_t deformation, seeds;
    trocar_pose probe;
} told_key;

struct scanner {
    const trocar_model *model;
    image_planner planner;
    double needle_radius;    /* m */
    bool starts;             /* true if the scene gives the probe an initial pose */
    pose start;
    wish wish;
    int64_t wished[SLICES];  /* ns, monotonic, when it was last requested; 0 if never */
    told_key told_key;

    echo *echoes[SLICES];    /* from here on, used by the thread */
    image_raster rasters[SLICES];
    image_field fields[SLICES]; /* they cover the gland */
    double depths[SLICES];   /* m, depths that the images are prepared for, as in `wish`; -1 before that */
    unsigned char *levels;
    size_t level_room;

    pthread_t thread;
    bool started;
    triple_buffer told;
    int news;                /* eventfd, signalled when there is new input */
    atomic_bool stop, busy;  /* busy: the images of the last input are not finished */
    section_box result;
};

/* ---- images ---- */

static void write_plane(json *j, slice_kind kind, const image_plane *plane, const image_raster *r) {
    json_open(j, NULL, '{');
    json_text(j, "name", kind == SLICE_AXIAL ? "axial" : "sagittal");
    json_numbers(j, "origin", &plane->origin.x, 3);
    json_numbers(j, "across", &plane->axes[0].x, 3);
    json_numbers(j, "up", &plane->axes[1].x, 3);
    json_numbers(j, "normal", &plane->axes[2].x, 3);
    json_number(j, "left", r->left);
    json_number(j, "near", r->near);
    json_number(j, "pixel", r->pixel);
    json_integer(j, "width", r->width);
    json_integer(j, "height", r->height);
    json_close(j, '}');
}

static size_t pixels_of(const image_raster *r) { return (size_t)r->width * (size_t)r->height; }

/* Encodes the images. The result is empty if out of memory. */
static byte_buffer encode(const scanner *s, const image_plane planes[SLICES], int count, double milliseconds) {
    byte_buffer section = {0};
    char *text = NULL;
    size_t length = 0, bytes = 0;
    FILE *out = open_memstream(&text, &length);
    if (!out) return section;
    json j = {.out = out};
    json_open(&j, NULL, '{');
    json_number(&j, "floor", ECHO_FLOOR);
    json_number(&j, "step", ECHO_STEP);
    json_number(&j, "white", ECHO_WHITE);
    json_number(&j, "milliseconds", milliseconds);
    json_open(&j, "images", '[');
    for (int k = 0; k < count; k++) {
        write_plane(&j, (slice_kind)k, &planes[k], &s->rasters[k]);
        bytes += pixels_of(&s->rasters[k]);
    }
    json_close(&j, ']');
    json_close(&j, '}');
    fclose(out);
    encode_json_and_bytes(&section, SECTION_ULTRASOUND, text, length, s->levels, bytes);
    free(text);
    if (section.failed) bytes_free(&section);
    return section;
}

/* Prepares an image for the requested depth. Apart from that, the field stays as it was for the first plane (the probe's start pose, as in trocar-slicer), so
   that the image does not change size while the plane moves. */
static trocar_status frame(scanner *s, slice_kind kind, const image_plane *plane, double depth, trocar_error *why) {
    if (s->fields[kind].far == 0) s->fields[kind] = image_field_of(&s->planner, kind, plane, 0);
    if (depth == s->depths[kind]) return TROCAR_OK;
    image_field field = s->fields[kind];
    if (depth > 0) field.far = field.face + depth;
    s->depths[kind] = depth;
    s->rasters[kind] = image_raster_of(&field, PIXEL);
    return echo_frame(s->echoes[kind], &field, &s->rasters[kind], why);
}

/* Computes the images. Returns false if out of memory. */
static bool scan(scanner *s, const told_state *state, image_plane planes[SLICES], int count) {
    static _Thread_local echo_body bodies[BODIES];
    trocar_error why;
    size_t place = 0, room = 0;
    int body_count = bodies_of(&state->bodies, bodies);
    if (state->has_probe) planes_at_probe(&s->planner, state->probe, planes);
    else planes_at(&s->planner, state->wish.place[SLICE_AXIAL], state->wish.place[SLICE_SAGITTAL], planes);
    for (int k = 0; k < count; k++) {
        if (frame(s, (slice_kind)k, &planes[k], state->wish.depth, &why) != TROCAR_OK) return false;
        room += pixels_of(&s->rasters[k]);
    }
    if (room > s->level_room) {
        unsigned char *wider = realloc(s->levels, room);
        if (!wider) return false;
        s->levels = wider;
        s->level_room = room;
    }
    for (int k = 0; k < count; k++) {
        echo_image(s->echoes[k], &planes[k], state->nodes, bodies, body_count, s->levels + place);
        place += pixels_of(&s->rasters[k]);
    }
    return true;
}

/* ---- the thread ---- */

static void *run(void *context) {
    scanner *s = context;
    while (!atomic_load(&s->stop)) {
        bool fresh = false;
        const told_state *state = triple_buffer_read(&s->told, &fresh);
        if (!fresh) {
            eventfd_wait(s->news);
            continue;
        }
        image_plane planes[SLICES];
        int images = state->wish.sagittal ? SLICES : 1;
        int64_t began = monotonic_ns();
        if (scan(s, state, planes, images)) section_box_put(&s->result, encode(s, planes, images, 1e-6 * (double)(monotonic_ns() - began)));
        atomic_store(&s->busy, false);
    }
    return NULL;
}

static trocar_status prepare(scanner *s, const trocar_scene *scene, trocar_error *why) {
    size_t size = sizeof(told_state) + 3 * (size_t)trocar_model_node_count(s->model) * sizeof(double);
    if (s->news < 0 || s->result.ready < 0) return fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    trocar_status status = triple_buffer_create(&s->told, size, why);
    for (int k = 0; k < SLICES && status == TROCAR_OK; k++) status = echo_create(scene, s->model, &TRANSRECTAL, ECHO_DENSITY, &s->echoes[k], why);
    if (status != TROCAR_OK) return status;
    if (s->starts) {
        image_plane planes[SLICES];
        planes_at_probe(&s->planner, s->start, planes);
        for (int k = 0; k < SLICES; k++) s->fields[k] = image_field_of(&s->planner, (slice_kind)k, &planes[k], 0);
    }
    int error = pthread_create(&s->thread, NULL, run, s);
    s->started = error == 0;
    return error ? fail(why, TROCAR_SYSTEM, "cannot create a thread: %s", strerror(error)) : TROCAR_OK;
}

trocar_status scanner_create(const trocar_scene *scene, const trocar_model *model, scanner **created, trocar_error *why) {
    scanner *s = allocate_on_cache_lines(sizeof *s);
    if (!s) return fail(why, TROCAR_NO_MEMORY, "no memory for ultrasound images");
    *s = (scanner){.model = model, .planner = image_planner_of(model), .depths = {-1, -1}, .news = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)};
    section_box_create(&s->result);
    trocar_scene_get_number(scene, "needle.outer_diameter", &s->needle_radius, NULL);
    s->needle_radius *= 0.5;
    s->starts = s->planner.has_probe && find_probe_start(scene, &s->start);
    trocar_status status = prepare(s, scene, why);
    if (status == TROCAR_OK) *created = s;
    else scanner_free(s);
    return status;
}

void scanner_free(scanner *s) {
    if (s->started) {
        atomic_store(&s->stop, true);
        eventfd_signal(s->news);
        pthread_join(s->thread, NULL);
    }
    for (int k = 0; k < SLICES; k++)
        if (s->echoes[k]) echo_free(s->echoes[k]);
    triple_buffer_free(&s->told);
    free(s->levels);
    section_box_free(&s->result);
    if (s->news >= 0) close(s->news);
    free(s);
}

/* ---- the main thread ---- */

void scanner_look(scanner *s, const web_action *action) {
    for (int i = 0; i < 4; i++)
        if (!isfinite(action->steer[i])) return;
    double depth = (double)action->steer[2];
    s->wish = (wish){.place = {(double)action->steer[0], (double)action->steer[1]}, .depth = depth > 0 ? fmin(fmax(depth, SHALLOWEST), DEEPEST) : 0};
    s->wished[SLICE_AXIAL] = monotonic_ns();
    if (action->steer[3] > 0) s->wished[SLICE_SAGITTAL] = s->wished[SLICE_AXIAL];
}

static bool is_wanted(const scanner *s, slice_kind kind, int64_t now) { return s->wished[kind] > 0 && now - s->wished[kind] < PATIENCE; }

static bool same_key(const told_key *a, const told_key *b) {
    return a->wish.place[0] == b->wish.place[0] && a->wish.place[1] == b->wish.place[1] && a->wish.depth == b->wish.depth && a->wish.sagittal == b->wish.sagittal
        && a->deformation == b->deformation && a->seeds == b->seeds && memcmp(&a->probe, &b->probe, sizeof a->probe) == 0;
}

void scanner_tell(scanner *s, const subscriber *feed) {
    int64_t now = monotonic_ns();
    const trocar_deformation_t *d = feed->deformation;
    if (!is_wanted(s, SLICE_AXIAL, now)) {
        s->told_key = (told_key){.deformation = -2}; /* so that the next browser gets an image even if nothing moves */
        return;
    }
    s->wish.sagittal = is_wanted(s, SLICE_SAGITTAL, now);
    told_key key = {.wish = s->wish, .deformation = d ? d->utime : -1, .seeds = feed->seeds_heard, .probe = feed->probe.base};
    if (same_key(&key, &s->told_key)) return;
    s->told_key = key;
    told_state *state = triple_buffer_slot(&s->told);
    state->wish = s->wish;
    state->has_probe = feed->probe.placed || s->starts;
    state->probe = feed->probe.placed ? load_pose(feed->probe.base.position, feed->probe.base.orientation) : s->start;
    bodies_take(&state->bodies, feed, s->model, s->needle_radius);
    const double *rest = trocar_model_nodes(s->model);
    for (int n = 0; n < trocar_model_node_count(s->model); n++)
        for (int a = 0; a < 3; a++) state->nodes[3 * n + a] = rest[3 * n + a] + (d ? (double)d->displacement[n][a] : 0);
    atomic_store(&s->busy, true);
    triple_buffer_publish(&s->told);
    eventfd_signal(s->news);
}

int scanner_descriptor(const scanner *s) { return s->result.ready; }

bool scanner_busy(const scanner *s) { return atomic_load(&s->busy); }

bool scanner_take(scanner *s, byte_buffer *section) { return section_box_take(&s->result, section); }

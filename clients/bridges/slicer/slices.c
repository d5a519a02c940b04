#include "slices.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include "common/eventfd_signal.h"

enum { LARGEST_SIDE = 2048 };           /* pixels */

/* Input of the drawing thread. */
typedef struct {
    int64_t utime;
    bool has_probe;
    pose probe;
    body_list bodies;
    double nodes[];          /* [nodes][3], m */
} told_state;

static void find_numbers(slices *s, const trocar_scene *scene) {
    for (int i = 0; i < trocar_scene_count(scene, "regions"); i++) {
        char key[64], name[64] = "";
        snprintf(key, sizeof key, "regions[%d].name", i);
        trocar_scene_get(scene, key, name, sizeof name, NULL);
        int region = trocar_model_find_region(s->model, name, 3);
        if (region >= 0) s->number[region] = (unsigned char)(i + 1);
    }
}

/* ---- planes ---- */

static void place(slices *s, const pose *probe, const double *tip) {
    image_plane planes[SLICES];
    if (probe && s->planner.has_probe) planes_at_probe(&s->planner, *probe, planes);
    else planes_at_tip(&s->planner, tip, planes);
    for (int k = 0; k < SLICES; k++) s->all[k].plane = planes[k];
}

static trocar_status frame_slice(slices *s, const trocar_scene *scene, slice_kind kind, trocar_error *why) {
    slice *v = &s->all[kind];
    image_field field = image_field_of(&s->planner, kind, &v->plane, s->settings.depth);
    v->raster = image_raster_of(&field, s->settings.pixel);
    const image_raster *r = &v->raster;
    if (r->width > LARGEST_SIDE || r->height > LARGEST_SIDE)
        return fail(why, TROCAR_BAD_INPUT, "--pixel %g: an image would have %d x %d pixels, more than %d in a row or column: choose larger pixels",
                    1e3 * r->pixel, r->width, r->height, LARGEST_SIDE);
    if (s->settings.style != SLICES_ECHO) return TROCAR_OK;
    trocar_status status = echo_create(scene, s->model, &TRANSRECTAL, ECHO_DENSITY, &v->echo, why);
    return status == TROCAR_OK ? echo_frame(v->echo, &field, r, why) : status;
}

/* ---- volumes ---- */

/* A corner of the polygon in which the plane cuts a tetrahedron, in pixels. */
typedef struct {
    double x, y;
} corner;

static double area(corner a, corner b, double x, double y) { return (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x); }

static void draw_triangle(const slices *s, const slice *v, unsigned char *grey, int region, corner a, corner b, corner c) {
    static const double ROUNDING = 1e-9; /* makes pixels on an edge belong to both polygons, so that there are no gaps */
    double whole = area(a, b, c.x, c.y);
    if (fabs(whole) < 1e-12) return;
    int from_x = (int)ceil(fmax(0, fmin(a.x, fmin(b.x, c.x)) - ROUNDING)), to_x = (int)floor(fmin(v->raster.width - 1, fmax(a.x, fmax(b.x, c.x)) + ROUNDING));
    int from_y = (int)ceil(fmax(0, fmin(a.y, fmin(b.y, c.y)) - ROUNDING)), to_y = (int)floor(fmin(v->raster.height - 1, fmax(a.y, fmax(b.y, c.y)) + ROUNDING));
    for (int y = from_y; y <= to_y; y++)
        for (int x = from_x; x <= to_x; x++) {
            double of_a = area(b, c, x, y) / whole, of_b = area(c, a, x, y) / whole, of_c = 1 - of_a - of_b;
            if (of_a < -ROUNDING || of_b < -ROUNDING || of_c < -ROUNDING) continue;
            grey[y * v->raster.width + x] = s->number[region];
        }
}

static vec3 row(const double *nodes, int node) { return v3(nodes[3 * (size_t)node], nodes[3 * (size_t)node + 1], nodes[3 * (size_t)node + 2]); }

static void to_image(const slice *v, vec3 point, double *x, double *y) {
    vec3 from = v3_sub(point, v->plane.origin);
    *x = (v3_dot(from, v->plane.axes[0]) - v->raster.left) / v->raster.pixel;
    *y = (v3_dot(from, v->plane.axes[1]) - v->raster.near) / v->raster.pixel;
}

/* Intersects the plane with the edge between two nodes. */
static corner cross_edge(const slices *s, const slice *v, const double *nodes, int a, int b) {
    double part = s->distance[a] / (s->distance[a] - s->distance[b]);
    vec3 from = row(nodes, a);
    corner c;
    to_image(v, v3_axpy(part, v3_sub(row(nodes, b), from), from), &c.x, &c.y);
    return c;
}

static void draw_tissue(const slices *s, const slice *v, unsigned char *grey, const double *nodes) {
    const int32_t *tets = trocar_model_tets(s->model), *regions = trocar_model_tet_regions(s->model);
    int node_count = trocar_model_node_count(s->model), tet_count = trocar_model_tet_count(s->model);
    for (int n = 0; n < node_count; n++) {
        double d = v3_dot(v3_sub(row(nodes, n), v->plane.origin), v->plane.axes[2]);
        s->distance[n] = d == 0 ? 1e-12 : d; /* treat a node that lies in the plane as above it */
    }
    for (int t = 0; t < tet_count; t++) {
        int below[4], above[4], low = 0, high = 0;
        for (int i = 0; i < 4; i++) {
            int node = tets[4 * t + i];
            if (s->distance[node] < 0) below[low++] = node;
            else above[high++] = node;
        }
        if (low == 0 || high == 0) continue;
        corner c[4];
        int count = 0;
        if (low == 2) {
            const int edges[4][2] = {{below[0], above[0]}, {below[0], above[1]}, {below[1], above[1]}, {below[1], above[0]}};
            for (; count < 4; count++) c[count] = cross_edge(s, v, nodes, edges[count][0], edges[count][1]);
        } else {
            for (; count < 3; count++) c[count] = cross_edge(s, v, nodes, below[low == 1 ? 0 : count], above[low == 1 ? count : 0]);
        }
        draw_triangle(s, v, grey, regions[t], c[0], c[1], c[2]);
        if (count == 4) draw_triangle(s, v, grey, regions[t], c[0], c[2], c[3]);
    }
}

/* ---- drawing ---- */

static void draw(slices *s, const told_state *state, drawn_slices *drawn) {
    static _Thread_local echo_body list[BODIES];
    int count = bodies_of(&state->bodies, list);
    drawn->utime = state->utime;
    if (state->has_probe || !s->planner.has_probe) place(s, state->has_probe ? &state->probe : NULL, bodies_tip(&state->bodies));
    for (int k = 0; k < SLICES; k++) {
        const slice *v = &s->all[k];
        unsigned char *grey = drawn->grey + v->first;
        size_t pixels = (size_t)v->raster.width * (size_t)v->raster.height;
        drawn->planes[k] = v->plane;
        if (v->echo) {
            echo_image(v->echo, &v->plane, state->nodes, list, count, grey);
            echo_show(grey, pixels, s->settings.gain, s->settings.range);
        } else {
            memset(grey, 0, pixels);
            draw_tissue(s, v, grey, state->nodes);
        }
    }
}

static void *run(void *context) {
    slices *s = context;
    while (!atomic_load(&s->stop)) {
        bool fresh = false;
        const told_state *state = triple_buffer_read(&s->told, &fresh);
        if (!fresh) {
            eventfd_wait(s->news);
            continue;
        }
        draw(s, state, triple_buffer_slot(&s->drawn));
        triple_buffer_publish(&s->drawn);
        eventfd_signal(s->ready);
    }
    return NULL;
}

static trocar_status start(slices *s, trocar_error *why) {
    size_t pixels = 0;
    for (int k = 0; k < SLICES; k++) {
        s->all[k].first = pixels;
        pixels += (size_t)s->all[k].raster.width * (size_t)s->all[k].raster.height;
    }
    s->news = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    s->ready = eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC);
    if (s->news < 0 || s->ready < 0) return fail(why, TROCAR_SYSTEM, "cannot create an eventfd: %s", strerror(errno));
    trocar_status status = triple_buffer_create(&s->told, sizeof(told_state) + 3 * (size_t)trocar_model_node_count(s->model) * sizeof(double), why);
    if (status == TROCAR_OK) status = triple_buffer_create(&s->drawn, sizeof(drawn_slices) + pixels, why);
    if (status != TROCAR_OK) return status;
    int error = pthread_create(&s->thread, NULL, run, s);
    s->started = error == 0;
    return error ? fail(why, TROCAR_SYSTEM, "cannot create a thread: %s", strerror(error)) : TROCAR_OK;
}

/* ---- for the main thread ---- */

trocar_status slices_create(slices *s, const trocar_scene *scene, const trocar_model *model, const slice_settings *settings, trocar_error *why) {
    pose at;
    *s = (slices){.settings = *settings, .model = model, .nodes = trocar_model_nodes(model), .planner = image_planner_of(model), .news = -1, .ready = -1};
    find_numbers(s, scene);
    place(s, s->planner.has_probe && find_probe_start(scene, &at) ? &at : NULL, NULL);
    if (settings->style == SLICES_NONE) return TROCAR_OK;
    s->distance = malloc((size_t)trocar_model_node_count(model) * sizeof *s->distance);
    if (!s->distance) return fail(why, TROCAR_NO_MEMORY, "no memory for images");
    trocar_status status = TROCAR_OK;
    for (int k = 0; k < SLICES && status == TROCAR_OK; k++) status = frame_slice(s, scene, (slice_kind)k, why);
    return status == TROCAR_OK ? start(s, why) : status;
}

void slices_free(slices *s) {
    if (s->started) {
        atomic_store(&s->stop, true);
        eventfd_signal(s->news);
        pthread_join(s->thread, NULL);
    }
    if (s->model) { /* true if slices_create has been called */
        triple_buffer_free(&s->told);
        triple_buffer_free(&s->drawn);
        if (s->news >= 0) close(s->news);
        if (s->ready >= 0) close(s->ready);
    }
    free(s->distance);
    for (int k = 0; k < SLICES; k++) {
        if (s->all[k].echo) echo_free(s->all[k].echo);
    }
}

void slices_tell(slices *s, int64_t utime, const double *nodes, const pose *probe, const body_list *bodies) {
    if (!s->started) return;
    told_state *state = triple_buffer_slot(&s->told);
    state->utime = utime;
    state->has_probe = probe && s->planner.has_probe;
    if (probe) state->probe = *probe;
    state->bodies = *bodies;
    memcpy(state->nodes, nodes, 3 * (size_t)trocar_model_node_count(s->model) * sizeof *nodes);
    triple_buffer_publish(&s->told);
    eventfd_signal(s->news);
}

int slices_descriptor(const slices *s) { return s->ready; }

const drawn_slices *slices_take(slices *s) {
    uint64_t count;
    bool fresh = false;
    if (!s->started || read(s->ready, &count, sizeof count) < 0) return NULL;
    const drawn_slices *drawn = triple_buffer_read(&s->drawn, &fresh);
    return fresh ? drawn : NULL;
}

ras_matrix slice_matrix(const slices *s, const drawn_slices *drawn, slice_kind kind, const patient_frame *frame) {
    const image_plane *p = &drawn->planes[kind];
    const image_raster *r = &s->all[kind].raster;
    mat3 axes = m3_columns(p->axes[0], p->axes[1], p->axes[2]);
    double across = r->left + 0.5 * (r->width - 1) * r->pixel, away = r->near + 0.5 * (r->height - 1) * r->pixel;
    vec3 middle = v3_axpy(across, p->axes[0], v3_axpy(away, p->axes[1], p->origin));
    ras_matrix matrix = ras_of_pose(frame, (pose){middle, q_of_matrix(&axes)});
    for (int i = 0; i < 9; i++) matrix.numbers[i] *= (float)(1e3 * r->pixel);
    return matrix;
}

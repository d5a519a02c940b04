#include "slices.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Dimensions of the images, same as in the viewer (clients/view/page/src/ultrasound_view.js). */
static const double MARGIN = 0.014;     /* m, margin around the region of interest */
static const double BELOW = 0.016;      /* m, distance from the region of interest to the probe if the scene has no probe */
static const double NEAR[SLICES] = {0.010, 0.006}; /* m, smallest depth shown in each image */
static const double WIDEST = 1.0;       /* rad, half of the widest sector angle */
static const double BONE = 0.95, GLAND = 0.42, HOST = 0.66, OTHER = 0.55; /* brightness */
static const double THICKNESS = 0.002;  /* m, thickness of a slice: a needle is visible if its distance from the plane is less than half of this */
enum { SPECKLE = 64 };                  /* number of voxels along each edge of the cube of speckle, which is repeated in all directions */
static const double GRAIN = 0.4e-3;     /* m, edge length of a voxel in the cube of speckle */
enum { LARGEST_SIDE = 2048 };           /* pixels */

/* ---- what there is to see ---- */

/* Returns the volume with the most faces on the outer surface, which is the one that surrounds the organs. */
static int host_of(const trocar_model *model) {
    int faces[32] = {0}, host = 0;
    const int32_t *regions = trocar_model_tet_regions(model), *neighbours = trocar_model_neighbours(model);
    for (int i = 0; i < 4 * trocar_model_tet_count(model); i++)
        if (neighbours[i] < 0 && ++faces[regions[i / 4]] > faces[host]) host = regions[i / 4];
    return host;
}

static void find_brightness(slices *s, int host) {
    for (int r = 0; r < trocar_model_region_count(s->model); r++) {
        const char *name = trocar_model_region_name(s->model, trocar_model_part_of(s->model, r));
        bool bone = isinf(trocar_model_material(s->model, r).cutting_force) != 0, gland = strstr(name, "prostate") || strstr(name, "gland");
        s->brightness[r] = bone ? BONE : r == host ? HOST : gland ? GLAND : OTHER - 0.05 * (r % 3);
    }
}

static void find_numbers(slices *s, const trocar_scene *scene) {
    for (int i = 0; i < trocar_scene_count(scene, "regions"); i++) {
        char key[64], name[64] = "";
        snprintf(key, sizeof key, "regions[%d].name", i);
        trocar_scene_get(scene, key, name, sizeof name, NULL);
        int region = trocar_model_find_region(s->model, name, 3);
        if (region >= 0) s->number[region] = (unsigned char)(i + 1);
    }
}

/* Finds the bounding box of all soft organs that lie inside another volume, or of the whole mesh if there are none. */
static void find_box(slices *s, int host) {
    const int32_t *tets = trocar_model_tets(s->model), *regions = trocar_model_tet_regions(s->model);
    for (int all = 0; all < 2; all++) {
        s->low = v3(INFINITY, INFINITY, INFINITY);
        s->high = v3_scale(-1, s->low);
        for (int i = 0; i < 4 * trocar_model_tet_count(s->model); i++) {
            int region = regions[i / 4];
            const double *x = s->nodes + 3 * (size_t)tets[i];
            if (!all && (region == host || s->brightness[region] == BONE)) continue;
            s->low = v3(fmin(s->low.x, x[0]), fmin(s->low.y, x[1]), fmin(s->low.z, x[2]));
            s->high = v3(fmax(s->high.x, x[0]), fmax(s->high.y, x[1]), fmax(s->high.z, x[2]));
        }
        if (s->low.x < s->high.x) return;
    }
}

static vec3 middle_of(const slices *s) { return v3_scale(0.5, v3_add(s->low, s->high)); }

/* ---- planes ---- */

/* Places an image at the probe. The probe's x axis points across the image, y in the viewing direction, and z along the probe. */
static void place_slice(slice *v, slice_kind kind, vec3 origin, quat turn) {
    vec3 x = q_rotate(turn, v3(1, 0, 0)), y = q_rotate(turn, v3(0, 1, 0)), z = q_axis(turn);
    v->origin = origin;
    v->axes[0] = kind == SLICE_AXIAL ? x : z;
    v->axes[1] = y;
    v->axes[2] = kind == SLICE_AXIAL ? z : v3_scale(-1, x);
}

static void place_at_probe(slices *s, const pose *probe) {
    vec3 place = v3_axpy(s->probe_reach, q_axis(probe->orientation), probe->position);
    for (int k = 0; k < SLICES; k++) place_slice(&s->all[k], (slice_kind)k, place, probe->orientation);
}

static double within(double value, double low, double high) { return fmin(fmax(value, low), high); }

/* Used without a probe: places both images below the region of interest, in planes through the needle's tip, as in the viewer. */
static void place_at_tip(slices *s, const slice_needle *needle) {
    vec3 middle = middle_of(s), tip = middle;
    const quat straight = {1, 0, 0, 0};
    if (needle && needle->count > 0) {
        const double *end = needle->points[needle->count - 1];
        tip = v3(within(end[0], s->low.x, s->high.x), end[1], within(end[2], s->low.z, s->high.z));
    }
    place_slice(&s->all[SLICE_AXIAL], SLICE_AXIAL, v3(middle.x, s->low.y - BELOW, tip.z), straight);
    place_slice(&s->all[SLICE_SAGITTAL], SLICE_SAGITTAL, v3(tip.x, s->low.y - BELOW, middle.z), straight);
}

/* Finds the pose of the probe at the start of the scene; returns false if the scene has no probe. */
static bool find_probe(slices *s, const trocar_scene *scene, pose *start) {
    trocar_probe_shape shape;
    s->has_probe = trocar_model_probe(s->model, &shape) != 0;
    if (!s->has_probe) return false;
    s->probe_reach = shape.length - shape.tip_radius;
    return find_probe_start(scene, start);
}

/* ---- what the probe sees ---- */

static double smooth(double from, double to, double x) {
    double part = within((x - from) / (to - from), 0, 1);
    return part * part * (3 - 2 * part);
}

typedef struct {
    double near, far;        /* m, smallest and largest distance from the probe in the image */
    double side;             /* half of the sector's angle (rad), or half of the rectangle's length (m) */
    double centre;           /* m, position of the rectangle's centre */
} fan;

/* Returns the gain of a pixel, with soft edges of the image and attenuation with depth. */
static double gain_at(slice_kind kind, const fan *f, double across, double away) {
    double depth = kind == SLICE_AXIAL ? hypot(across, away) : away;
    double aside = kind == SLICE_AXIAL ? fabs(atan2(across, away)) : fabs(across - f->centre), edge = kind == SLICE_AXIAL ? 0.02 : 0.002;
    double seen = smooth(f->near, f->near + 0.0012, depth) * smooth(f->far, f->far - 0.0025, depth) * smooth(f->side, f->side - edge, aside);
    return seen * (0.45 + 0.85 * exp(-9 * fmax(depth - f->near, 0)));
}

/* Chooses the fan that covers the region of interest when the probe is at rest. */
static fan frame_fan(const slices *s, slice_kind kind) {
    const slice *v = &s->all[kind];
    double low = INFINITY, high = -INFINITY, far = 0;
    for (int corner = 0; corner < 8; corner++) {
        vec3 x = v3(corner & 1 ? s->high.x : s->low.x, corner & 2 ? s->high.y : s->low.y, corner & 4 ? s->high.z : s->low.z), from = v3_sub(x, v->origin);
        double across = v3_dot(from, v->axes[0]);
        low = fmin(low, across);
        high = fmax(high, across);
        far = fmax(far, v3_dot(from, v->axes[1]));
    }
    if (kind == SLICE_SAGITTAL) return (fan){NEAR[kind], far + MARGIN, 0.5 * (high - low) + MARGIN, 0.5 * (low + high)};
    return (fan){NEAR[kind], far + MARGIN, fmin(WIDEST, atan2(fmax(high, -low) + MARGIN, 0.5 * far)), 0};
}

static trocar_status frame_slice(slices *s, slice_kind kind, trocar_error *why) {
    slice *v = &s->all[kind];
    fan f = frame_fan(s, kind);
    double half = kind == SLICE_AXIAL ? f.far * sin(f.side) : f.side, near = kind == SLICE_AXIAL ? f.near * cos(f.side) : f.near;
    double width = fmax(1, ceil(2 * half / s->pixel)), height = fmax(1, ceil((f.far - near) / s->pixel));
    if (width > LARGEST_SIDE || height > LARGEST_SIDE)
        return fail(why, TROCAR_BAD_INPUT, "--pixel %g: an image would have %.0f x %.0f pixels, more than %d in a row or column: choose larger pixels",
                    1e3 * s->pixel, width, height, LARGEST_SIDE);
    v->width = (int)width;
    v->height = (int)height;
    v->left = f.centre - 0.5 * (v->width - 1) * s->pixel;
    v->near = near;
    size_t pixels = (size_t)v->width * (size_t)v->height;
    v->gain = malloc(pixels * sizeof *v->gain);
    v->grey = malloc(pixels);
    if (!v->gain || !v->grey) return fail(why, TROCAR_NO_MEMORY, "no memory for images with pixels of %g mm", 1e3 * s->pixel);
    for (int j = 0; j < v->height; j++)
        for (int i = 0; i < v->width; i++)
            v->gain[j * v->width + i] = (float)gain_at(kind, &f, v->left + i * s->pixel, v->near + j * s->pixel);
    return TROCAR_OK;
}

/* Fills the cube of speckle with amplitudes that result from the sum of many random echoes and therefore have a Rayleigh distribution. */
static bool make_speckle(slices *s) {
    uint32_t random = 1;
    s->speckle = malloc(SPECKLE * SPECKLE * SPECKLE);
    for (int i = 0; i < SPECKLE * SPECKLE * SPECKLE && s->speckle; i++) {
        random = random * 1664525u + 1013904223u;
        double amplitude = sqrt(-2 * log((1 + (random >> 8)) / 16777217.0));
        s->speckle[i] = (unsigned char)fmin(255, 40 + 90 * amplitude);
    }
    return s->speckle != NULL;
}

trocar_status slices_create(slices *s, const trocar_scene *scene, const trocar_model *model, slice_style style, double pixel, trocar_error *why) {
    pose start;
    *s = (slices){.style = style, .pixel = pixel, .model = model, .nodes = trocar_model_nodes(model)};
    trocar_scene_get_number(scene, "needle.outer_diameter", &s->needle_radius, NULL);
    s->needle_radius *= 0.5;
    int host = host_of(model);
    find_brightness(s, host);
    find_numbers(s, scene);
    find_box(s, host);
    if (find_probe(s, scene, &start)) place_at_probe(s, &start);
    else place_at_tip(s, NULL);
    if (style == SLICES_NONE) return TROCAR_OK;
    s->distance = malloc((size_t)trocar_model_node_count(model) * sizeof *s->distance);
    if (!s->distance || !make_speckle(s)) return fail(why, TROCAR_NO_MEMORY, "no memory for images");
    trocar_status status = TROCAR_OK;
    for (int k = 0; k < SLICES && status == TROCAR_OK; k++) status = frame_slice(s, (slice_kind)k, why);
    return status;
}

void slices_free(slices *s) {
    free(s->distance);
    free(s->speckle);
    for (int k = 0; k < SLICES; k++) {
        free(s->all[k].gain);
        free(s->all[k].grey);
    }
}

/* ---- drawing ---- */

/* A corner of the polygon in which a plane cuts a tetrahedron, with its position in the image (pixels) and its position in the tissue at rest (m). */
typedef struct {
    double x, y;
    vec3 rest;
} corner;

static int voxel(double x) { return (int)lrint(x / GRAIN) & (SPECKLE - 1); }

static unsigned char shade(const slices *s, const slice *v, int pixel, int region, vec3 rest) {
    if (s->style == SLICES_REGIONS) return s->number[region];
    double speckle = s->speckle[(voxel(rest.x) * SPECKLE + voxel(rest.y)) * SPECKLE + voxel(rest.z)];
    return (unsigned char)fmin(255, v->gain[pixel] * s->brightness[region] * speckle);
}

static double area(corner a, corner b, double x, double y) { return (b.x - a.x) * (y - a.y) - (b.y - a.y) * (x - a.x); }

static void draw_triangle(const slices *s, slice *v, int region, corner a, corner b, corner c) {
    static const double ROUNDING = 1e-9; /* tolerance, so that pixels on an edge count as part of both polygons and leave no gap */
    double whole = area(a, b, c.x, c.y);
    if (fabs(whole) < 1e-12) return;
    int from_x = (int)ceil(fmax(0, fmin(a.x, fmin(b.x, c.x)) - ROUNDING)), to_x = (int)floor(fmin(v->width - 1, fmax(a.x, fmax(b.x, c.x)) + ROUNDING));
    int from_y = (int)ceil(fmax(0, fmin(a.y, fmin(b.y, c.y)) - ROUNDING)), to_y = (int)floor(fmin(v->height - 1, fmax(a.y, fmax(b.y, c.y)) + ROUNDING));
    for (int y = from_y; y <= to_y; y++)
        for (int x = from_x; x <= to_x; x++) {
            double of_a = area(b, c, x, y) / whole, of_b = area(c, a, x, y) / whole, of_c = 1 - of_a - of_b;
            int pixel = y * v->width + x;
            if (of_a < -ROUNDING || of_b < -ROUNDING || of_c < -ROUNDING || (s->style == SLICES_ECHO && v->gain[pixel] == 0)) continue;
            vec3 rest = v3_axpy(of_a, a.rest, v3_axpy(of_b, b.rest, v3_scale(of_c, c.rest)));
            v->grey[pixel] = shade(s, v, pixel, region, rest);
        }
}

static vec3 row(const double *nodes, int node) { return v3(nodes[3 * (size_t)node], nodes[3 * (size_t)node + 1], nodes[3 * (size_t)node + 2]); }

static void to_image(const slices *s, const slice *v, vec3 point, double *x, double *y) {
    vec3 from = v3_sub(point, v->origin);
    *x = (v3_dot(from, v->axes[0]) - v->left) / s->pixel;
    *y = (v3_dot(from, v->axes[1]) - v->near) / s->pixel;
}

/* Returns the point at which the plane intersects the edge between two nodes. */
static corner cross_edge(const slices *s, const slice *v, const double *nodes, int a, int b) {
    double part = s->distance[a] / (s->distance[a] - s->distance[b]);
    vec3 from = row(nodes, a), rest = row(s->nodes, a);
    corner c = {.rest = v3_axpy(part, v3_sub(row(s->nodes, b), rest), rest)};
    to_image(s, v, v3_axpy(part, v3_sub(row(nodes, b), from), from), &c.x, &c.y);
    return c;
}

static void draw_tissue(const slices *s, slice *v, const double *nodes) {
    const int32_t *tets = trocar_model_tets(s->model), *regions = trocar_model_tet_regions(s->model);
    int node_count = trocar_model_node_count(s->model), tet_count = trocar_model_tet_count(s->model);
    for (int n = 0; n < node_count; n++) {
        double d = v3_dot(v3_sub(row(nodes, n), v->origin), v->axes[2]);
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
        draw_triangle(s, v, regions[t], c[0], c[1], c[2]);
        if (count == 4) draw_triangle(s, v, regions[t], c[0], c[2], c[3]);
    }
}

static void draw_dot(const slices *s, slice *v, vec3 point) {
    double x, y, radius = fmax(1, s->needle_radius / s->pixel);
    to_image(s, v, point, &x, &y);
    if (!(x > -radius && x < v->width + radius && y > -radius && y < v->height + radius)) return;
    for (int j = (int)fmax(0, ceil(y - radius)); j <= fmin(v->height - 1, y + radius); j++)
        for (int i = (int)fmax(0, ceil(x - radius)); i <= fmin(v->width - 1, x + radius); i++) {
            unsigned char *grey = &v->grey[j * v->width + i];
            double echo = fmin(255, 255 * v->gain[j * v->width + i]);
            if (hypot(i - x, j - y) <= radius && echo > *grey) *grey = (unsigned char)echo;
        }
}

/* Draws the echo of the parts of a needle that lie within the slice. */
static void draw_needle(const slices *s, slice *v, const slice_needle *needle) {
    for (int i = 1; i < needle->count; i++) {
        const double *p = needle->points[i - 1], *q = needle->points[i];
        vec3 from = v3(p[0], p[1], p[2]), along = v3_sub(v3(q[0], q[1], q[2]), from);
        int steps = 1 + (int)fmin(1e4, v3_norm(along) / s->pixel);
        for (int k = 0; k <= steps; k++) {
            vec3 point = v3_axpy((double)k / steps, along, from);
            if (fabs(v3_dot(v3_sub(point, v->origin), v->axes[2])) < 0.5 * THICKNESS) draw_dot(s, v, point);
        }
    }
}

void slices_draw(slices *s, const double *nodes, const pose *probe, const slice_needle *needles, int needle_count) {
    if (s->style == SLICES_NONE) return;
    if (probe && s->has_probe) place_at_probe(s, probe);
    else if (!s->has_probe) place_at_tip(s, needle_count > 0 ? needles : NULL);
    for (int k = 0; k < SLICES; k++) {
        slice *v = &s->all[k];
        memset(v->grey, 0, (size_t)v->width * (size_t)v->height);
        draw_tissue(s, v, nodes);
        for (int i = 0; i < needle_count && s->style == SLICES_ECHO; i++) draw_needle(s, v, &needles[i]);
    }
}

ras_matrix slice_matrix(const slices *s, slice_kind kind, const patient_frame *frame) {
    const slice *v = &s->all[kind];
    mat3 axes = m3_columns(v->axes[0], v->axes[1], v->axes[2]);
    double across = v->left + 0.5 * (v->width - 1) * s->pixel, away = v->near + 0.5 * (v->height - 1) * s->pixel;
    vec3 middle = v3_axpy(across, v->axes[0], v3_axpy(away, v->axes[1], v->origin));
    ras_matrix matrix = ras_of_pose(frame, (pose){middle, q_of_matrix(&axes)});
    for (int i = 0; i < 9; i++) matrix.numbers[i] *= (float)(1e3 * s->pixel);
    return matrix;
}

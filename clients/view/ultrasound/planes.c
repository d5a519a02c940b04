#define _GNU_SOURCE
#include "view/ultrasound/planes.h"

#include <string.h>

/* the same values as in page/src/ultrasound_view.js */
static const double MARGIN = 0.014;     /* m, around the region of interest */
static const double BELOW = 0.016;      /* m, from the region of interest to the probe's axis in a scene without a probe */
static const double NEAR[SLICES] = {0.010, 0.006}; /* m, where each image begins */
static const double WIDEST = 1.0;       /* rad, half of the widest sector angle */

int host_of(const trocar_model *model) {
    int faces[32] = {0}, host = 0;
    const int32_t *regions = trocar_model_tet_regions(model), *neighbours = trocar_model_neighbours(model);
    for (int i = 0; i < 4 * trocar_model_tet_count(model); i++)
        if (neighbours[i] < 0 && ++faces[regions[i / 4]] > faces[host]) host = regions[i / 4];
    return host;
}

static bool is_target(const trocar_model *m, int region) {
    static const char *const words[] = {"prostate", "gland", "urethra"};
    const char *name = trocar_model_region_name(m, trocar_model_part_of(m, region));
    for (size_t i = 0; i < sizeof words / sizeof *words; i++)
        if (strcasestr(name, words[i])) return true;
    return false;
}

enum { TARGETS, ORGANS, ALL, CHOICES };

static bool counts(const trocar_model *m, int region, int host, int choice) {
    if (choice == TARGETS) return region != host && is_target(m, region);
    return choice == ALL || (region != host && !isinf(trocar_model_material(m, region).cutting_force));
}

static void find_box(image_planner *p, const trocar_model *m) {
    const int32_t *tets = trocar_model_tets(m), *regions = trocar_model_tet_regions(m);
    int host = host_of(m);
    for (int choice = 0; choice < CHOICES; choice++) {
        p->low = v3(INFINITY, INFINITY, INFINITY);
        p->high = v3_scale(-1, p->low);
        for (int i = 0; i < 4 * trocar_model_tet_count(m); i++) {
            const double *x = trocar_model_nodes(m) + 3 * (size_t)tets[i];
            if (!counts(m, regions[i / 4], host, choice)) continue;
            p->low = v3(fmin(p->low.x, x[0]), fmin(p->low.y, x[1]), fmin(p->low.z, x[2]));
            p->high = v3(fmax(p->high.x, x[0]), fmax(p->high.y, x[1]), fmax(p->high.z, x[2]));
        }
        if (p->low.x < p->high.x) return;
    }
}

image_planner image_planner_of(const trocar_model *model) {
    image_planner p = {.has_probe = false};
    trocar_probe_shape shape;
    find_box(&p, model);
    p.has_probe = trocar_model_probe(model, &shape) != 0;
    if (p.has_probe) p.probe_reach = shape.length - shape.tip_radius, p.probe_radius = shape.radius;
    return p;
}

/* The probe's x axis points across the image, y in the viewing direction, z along the probe. */
static image_plane place(slice_kind kind, vec3 origin, quat turn) {
    vec3 x = q_rotate(turn, v3(1, 0, 0)), y = q_rotate(turn, v3(0, 1, 0)), z = q_axis(turn);
    return kind == SLICE_AXIAL ? (image_plane){origin, {x, y, z}} : (image_plane){origin, {z, y, v3_scale(-1, x)}};
}

void planes_at_probe(const image_planner *p, pose base, image_plane planes[SLICES]) {
    vec3 origin = v3_axpy(p->probe_reach, q_axis(base.orientation), base.position);
    for (int k = 0; k < SLICES; k++) planes[k] = place((slice_kind)k, origin, base.orientation);
}

void planes_at(const image_planner *p, double z, double x, image_plane planes[SLICES]) {
    const quat straight = {1, 0, 0, 0};
    vec3 middle = v3_scale(0.5, v3_add(p->low, p->high));
    planes[SLICE_AXIAL] = place(SLICE_AXIAL, v3(middle.x, p->low.y - BELOW, z), straight);
    planes[SLICE_SAGITTAL] = place(SLICE_SAGITTAL, v3(x, p->low.y - BELOW, middle.z), straight);
}

static double within(double value, double low, double high) { return fmin(fmax(value, low), high); }

void planes_at_tip(const image_planner *p, const double tip[3], image_plane planes[SLICES]) {
    vec3 middle = v3_scale(0.5, v3_add(p->low, p->high));
    planes_at(p, tip ? within(tip[2], p->low.z, p->high.z) : middle.z, tip ? within(tip[0], p->low.x, p->high.x) : middle.x, planes);
}

/* Returns half of a box's extent along an axis. */
static double half_extent(vec3 half, vec3 axis) { return half.x * fabs(axis.x) + half.y * fabs(axis.y) + half.z * fabs(axis.z); }

image_field image_field_of(const image_planner *p, slice_kind kind, const image_plane *plane, double depth) {
    vec3 half = v3_scale(0.5, v3_sub(p->high, p->low)), from = v3_sub(v3_scale(0.5, v3_add(p->low, p->high)), plane->origin);
    double middle = v3_dot(from, plane->axes[0]), low = middle - half_extent(half, plane->axes[0]), high = middle + half_extent(half, plane->axes[0]);
    double far = fmax(0.0, v3_dot(from, plane->axes[1]) + half_extent(half, plane->axes[1]));
    image_field f = {.sector = kind == SLICE_AXIAL, .near = NEAR[kind], .far = far + MARGIN, .face = p->has_probe ? p->probe_radius : NEAR[kind]};
    if (f.sector) f.side = fmin(WIDEST, atan2(fmax(high, -low) + MARGIN, 0.5 * f.far));
    else f.side = 0.5 * (high - low) + MARGIN, f.centre = 0.5 * (low + high);
    if (depth > 0) f.far = f.face + depth;
    return f;
}

image_raster image_raster_of(const image_field *f, double pixel) {
    static const double MOST = 1e6;
    double half = f->sector ? f->far * sin(f->side) : f->side, near = f->sector ? f->near * cos(f->side) : f->near;
    image_raster r = {.pixel = pixel, .near = near};
    r.width = (int)within(ceil(2 * half / pixel), 1, MOST);
    r.height = (int)within(ceil((f->far - near) / pixel), 1, MOST);
    r.left = f->centre - 0.5 * (r.width - 1) * pixel;
    return r;
}

#include "view/ultrasound/reflectors.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "view/stream/model_faces.h"

/* Standard deviation of the facet slopes of a surface, and the part of the echo that does not depend on direction. Both are assumptions. */
typedef struct {
    double slope, diffuse;
} roughness;
static const roughness ORGAN = {0.35, 0.15}, METAL = {0.15, 0.03}, HARD = {0.6, 0.3};

static const double STEEL_SPEED = 5790;  /* m/s, longitudinal, stainless steel (CRC Handbook of Chemistry and Physics) */
static const double TISSUE = 1.63;       /* MRayl, of the tissue around needles and seeds */
static const double FINEST = 1.5e-4;     /* m, length of the pieces into which a needle's axis is divided */
static const double FAINT = 1e-3;        /* reverberation stops at this fraction of its first echo */
static const double DARKEST = 0.02;      /* smallest fraction of the sound that gets past a body */
enum { STRIPS = 5 };                     /* strips across a needle's surface */

double sound_left(double attenuation, double frequency, double length) {
    return pow(10, -attenuation * 1e-6 * frequency * 100 * 2 * length / 20);
}

/* Returns the echo of a rough surface relative to that at normal incidence. Models facets with Gaussian slopes (Beckmann and Spizzichino 1963), plus a diffuse
   part. `cosine`: cosine of the angle of incidence. */
static double glint(roughness r, double cosine) {
    double c = fmax(cosine * cosine, 1e-6), tangent = (1 - c) / c;
    return r.diffuse + (1 - r.diffuse) * exp(-0.5 * tangent / (r.slope * r.slope));
}

/* ---- set-up ---- */

static unsigned bones_of(const trocar_model *m, const trocar_scene *scene) {
    unsigned bits = 0;
    for (int i = 0; i < trocar_scene_count(scene, "membranes"); i++) {
        char key[64], name[64] = "";
        double force = 0;
        snprintf(key, sizeof key, "membranes[%d].name", i);
        trocar_scene_get(scene, key, name, sizeof name, NULL);
        snprintf(key, sizeof key, "membranes[%d].puncture_force", i);
        trocar_scene_get_number(scene, key, &force, NULL);
        int surface = trocar_model_find_region(m, name, 2);
        if (surface >= 0 && isinf(force)) bits |= 1u << surface;
    }
    return bits;
}

/* Lists each face on the outside, and each face between two volumes once: from the tetrahedron with the smaller index. */
static trocar_status find_boundaries(reflectors *r, const trocar_model *m, unsigned bones, trocar_error *why) {
    const int32_t *tets = trocar_model_tets(m), *neighbours = trocar_model_neighbours(m), *regions = trocar_model_tet_regions(m);
    for (int pass = 0; pass < 2; pass++) {
        r->boundary_count = 0;
        for (int t = 0; t < trocar_model_tet_count(m); t++)
            for (int f = 0; f < 4; f++) {
                int other = neighbours[4 * t + f];
                if (!face_bounds_region(m, t, f) || (other >= 0 && other < t)) continue;
                boundary *b = pass ? &r->boundaries[r->boundary_count] : NULL;
                r->boundary_count++;
                if (!b) continue;
                *b = (boundary){.in = (int8_t)regions[t], .out = (int8_t)(other < 0 ? -1 : regions[other]), .bone = (trocar_model_face_surfaces(m)[4 * t + f] & bones) != 0};
                for (int i = 0; i < 3; i++) b->nodes[i] = tets[4 * t + FACE_CORNERS[f][i]];
            }
        if (pass == 0) r->boundaries = malloc((size_t)r->boundary_count * sizeof *r->boundaries + 1);
        if (!r->boundaries) return fail(why, TROCAR_NO_MEMORY, "no memory for the ultrasound image's boundaries");
    }
    return TROCAR_OK;
}

static vec3 node_at(const trocar_model *m, int node) {
    const double *x = trocar_model_nodes(m) + 3 * (size_t)node;
    return v3(x[0], x[1], x[2]);
}

/* Finds the tetrahedron that contains a point of the undeformed tissue, and the point's barycentric weights. Returns false if there is none. */
static bool find_stone(const trocar_model *m, vec3 centre, stone *s) {
    for (int t = 0; t < trocar_model_tet_count(m); t++) {
        memcpy(s->nodes, trocar_model_tets(m) + 4 * t, sizeof s->nodes);
        vec3 corner = node_at(m, s->nodes[0]);
        mat3 edges = m3_columns(v3_sub(node_at(m, s->nodes[1]), corner), v3_sub(node_at(m, s->nodes[2]), corner), v3_sub(node_at(m, s->nodes[3]), corner)), inverse = m3_inverse(&edges);
        vec3 w = m3_apply(&inverse, v3_sub(centre, corner));
        const double weights[4] = {1 - w.x - w.y - w.z, w.x, w.y, w.z};
        memcpy(s->weights, weights, sizeof weights);
        if (fmin(fmin(weights[0], w.x), fmin(w.y, w.z)) >= -1e-9) return true;
    }
    return false;
}

static trocar_status find_stones(reflectors *r, const trocar_scene *scene, const trocar_model *m, trocar_error *why) {
    int count = trocar_scene_count(scene, "calcifications");
    r->stones = calloc((size_t)count + 1, sizeof *r->stones);
    if (!r->stones) return fail(why, TROCAR_NO_MEMORY, "no memory for the ultrasound image's calcifications");
    for (int i = 0; i < count; i++) {
        char key[64], text[128] = "";
        double x, y, z;
        stone *s = &r->stones[r->stone_count];
        snprintf(key, sizeof key, "calcifications[%d].centre", i);
        trocar_status status = trocar_scene_get(scene, key, text, sizeof text, why);
        if (status == TROCAR_OK && sscanf(text, "[%lf, %lf, %lf]", &x, &y, &z) != 3) status = fail(why, TROCAR_BAD_INPUT, "%s: %s: expected three numbers", key, text);
        snprintf(key, sizeof key, "calcifications[%d].radius", i);
        if (status == TROCAR_OK) status = trocar_scene_get_number(scene, key, &s->radius, why);
        if (status != TROCAR_OK) return status;
        r->stone_count += find_stone(m, v3(x, y, z), s);
    }
    return TROCAR_OK;
}

trocar_status reflectors_create(reflectors *r, const trocar_scene *scene, const trocar_model *model, trocar_error *why) {
    *r = (reflectors){.boundary_count = 0};
    for (int i = 0; i < trocar_model_region_count(model); i++)
        if (trocar_model_region_dimension(model, i) == 3) r->volumes[i] = acoustics_of(model, i);
    trocar_status status = find_boundaries(r, model, bones_of(model, scene), why);
    return status == TROCAR_OK ? find_stones(r, scene, model, why) : status;
}

void reflectors_free(reflectors *r) {
    free(r->boundaries);
    free(r->stones);
}

/* ---- boundaries ---- */

typedef struct {
    double u, v;
} flat_point;

/* Intersects the triangle with the image plane. Returns false if they do not meet. */
static bool cut(const image_point corner[3], flat_point ends[2]) {
    int found = 0;
    for (int i = 0; i < 3 && found < 2; i++) {
        const image_point a = corner[i], b = corner[(i + 1) % 3];
        if ((a.w < 0) == (b.w < 0)) continue;
        double part = (double)a.w / ((double)a.w - b.w);
        ends[found++] = (flat_point){a.u + part * ((double)b.u - a.u), a.v + part * ((double)b.v - a.v)};
    }
    return found == 2;
}

/* Returns the triangle's unit normal in the image's axes. */
static vec3 normal_of(const image_point c[3]) {
    vec3 n = v3_cross(v3((double)c[1].u - c[0].u, (double)c[1].v - c[0].v, (double)c[1].w - c[0].w), v3((double)c[2].u - c[0].u, (double)c[2].v - c[0].v, (double)c[2].w - c[0].w));
    return v3_scale(1 / fmax(v3_norm(n), 1e-30), n);
}

/* Returns the row at which a line crosses the segment between two points. If the line misses the segment because of rounding, returns the row of the nearer
   end. */
static double cross(const echo_grid *g, int line, flat_point p, flat_point q) {
    double across, away, place = g->first_line + line * g->spacing, du = q.u - p.u, dv = q.v - p.v, part;
    grid_beam(g, line, &across, &away);
    if (g->field.sector) part = -(across * p.v - away * p.u) / (across * dv - away * du);
    else part = (place - p.u) / du;
    part = fmin(fmax(part, 0), 1);
    return grid_row(g, p.u + part * du, p.v + part * dv);
}

/* Adds the echo of a boundary that the sound crosses, and the boundary's effect on the sound behind it. */
static void pass(const reflectors *r, const boundary *b, double cosine, double frequency, int line, double row, echo_grid *g) {
    int from = cosine > 0 ? b->in : b->out, to = cosine > 0 ? b->out : b->in;
    double from_loss = from < 0 ? 0 : r->volumes[from].attenuation, to_loss = to < 0 ? 0 : r->volumes[to].attenuation;
    double mirrored = b->bone ? reflection(BONE.impedance, r->volumes[b->in].impedance) : from < 0 || to < 0 ? 0 : reflection(r->volumes[from].impedance, r->volumes[to].impedance);
    bool hard = b->bone || mirrored > 0.3;
    grid_add(g, line, row, mirrored * glint(hard ? HARD : ORGAN, cosine));
    grid_event(g, line, row, b->bone ? 0 : (float)(1 - mirrored * mirrored), sound_left(to_loss - from_loss, frequency, g->step));
    if (row < g->first_event[line]) g->first_event[line] = (float)row, g->first_loss[line] = (float)from_loss;
}

static void add_boundary(const reflectors *r, const boundary *b, const image_point *nodes, double frequency, echo_grid *g) {
    const image_point corner[3] = {nodes[b->nodes[0]], nodes[b->nodes[1]], nodes[b->nodes[2]]};
    flat_point ends[2];
    if (!cut(corner, ends)) return;
    double a = grid_line(g, ends[0].u, ends[0].v), z = grid_line(g, ends[1].u, ends[1].v);
    if (g->field.sector && fabs(a - z) * g->spacing > M_PI) return; /* behind the probe, where the angle jumps */
    vec3 normal = normal_of(corner);
    for (int line = (int)fmax(0, ceil(fmin(a, z))); line < fmin(g->lines, fmax(a, z)); line++) {
        double across, away, row = cross(g, line, ends[0], ends[1]);
        grid_beam(g, line, &across, &away);
        pass(r, b, normal.x * across + normal.y * away, frequency, line, row, g);
    }
}

/* ---- calcifications ---- */

/* Returns the fraction of the beam's thickness that a body hides if it extends from `low` to `high` (m) out of the plane. */
static double hidden(const echo_grid *g, double row, double low, double high) {
    double s = sqrt(2.0) * g->thickness[(int)fmin(fmax(row, 0), g->rows - 1)];
    return 0.5 * (erf(high / s) - erf(low / s));
}

static void add_stone(const stone *s, const image_point *nodes, double frequency, echo_grid *g) {
    double u = 0, v = 0, w = 0;
    for (int i = 0; i < 4; i++) {
        const image_point n = nodes[s->nodes[i]];
        u += s->weights[i] * n.u, v += s->weights[i] * n.v, w += s->weights[i] * n.w;
    }
    double distance = g->field.sector ? hypot(u, v) : v, middle = grid_line(g, u, v), row = (distance - g->first_row) / g->step;
    double apart = grid_line_distance(g, row), mirrored = reflection(BONE.impedance, TISSUE);
    if (!(distance > s->radius)) return;
    for (int line = (int)fmax(0, ceil(middle - s->radius / apart)); line < fmin(g->lines, middle + s->radius / apart); line++) {
        double aside = (line - middle) * apart, half = sqrt(fmax(0, s->radius * s->radius - aside * aside)), front = row - half / g->step;
        double through = (1 - mirrored * mirrored) * sound_left(BONE.attenuation, frequency, half); /* one way; sound_left counts both */
        double part = hidden(g, front, w - half, w + half), left = 1 - part * (1 - through);
        grid_add(g, line, front, part * mirrored * glint(HARD, half / s->radius));
        grid_event(g, line, front, left * left, 1);
    }
}

void reflectors_add(const reflectors *r, const image_point *nodes, double frequency, echo_grid *g) {
    for (int i = 0; i < r->boundary_count; i++) add_boundary(r, &r->boundaries[i], nodes, frequency, g);
    for (int i = 0; i < r->stone_count; i++) add_stone(&r->stones[i], nodes, frequency, g);
}

/* ---- needles and seeds ---- */

/* A body as each line sees it: its echo, the row of its surface, and the part of the beam it hides. `row` is a sum weighted with the hidden parts. */
typedef struct {
    double echo[GRID_LINES], row[GRID_LINES], hides[GRID_LINES];
} silhouette;

/* Adds a strip of the surface with this area (m^2) to the two lines on either side of it. */
static void add_strip(silhouette *s, const echo_grid *g, double u, double v, double w, double area, double directed) {
    double row = grid_row(g, u, v), line = grid_line(g, u, v);
    if (!(row > 0 && row < g->rows - 1 && line > 0 && line < g->lines - 1)) return;
    double thick = g->thickness[(int)row], x = w / thick;
    if (fabs(x) > 4) return;
    int first = (int)line;
    double part = area * exp(-0.5 * x * x) / (sqrt(2 * M_PI) * thick * grid_line_distance(g, row));
    for (int k = 0; k < 2; k++) {
        double share = part * (k ? line - first : 1 - line + first);
        s->echo[first + k] += share * directed;
        s->row[first + k] += share * row;
        s->hides[first + k] += share;
    }
}

/* Adds a piece of the axis. Its strips lie side by side on the front of the cylinder, perpendicular to the sound and the axis. */
static void add_piece(silhouette *s, const echo_grid *g, vec3 at, vec3 along, double length, double radius) {
    double across, away;
    grid_beam(g, grid_line(g, at.x, at.y), &across, &away);
    vec3 sound = v3(across, away, 0), side = v3_cross(along, sound);
    double cosine = v3_norm(side); /* of the angle between the sound and the plane perpendicular to the axis */
    if (cosine < 1e-3) return;
    side = v3_scale(1 / cosine, side);
    for (int k = 0; k < STRIPS; k++) {
        double aside = radius * ((2 * k + 1.0) / STRIPS - 1), front = sqrt(radius * radius - aside * aside);
        vec3 point = v3_axpy(aside, side, v3_axpy(-front, sound, at));
        add_strip(s, g, point.x, point.y, point.z, length * cosine * 2 * radius / STRIPS, glint(METAL, cosine));
    }
}

/* Adds reverberation: sound bounces back and forth inside the body, and part of it leaves towards the probe each time. In the image, these echoes line up
   behind the body. */
static void add_reverberation(echo_grid *g, int line, double row, double echo, double mirrored, double diameter) {
    double pitch = diameter * SOUND_SPEED / STEEL_SPEED / g->step, size = echo * (1 - mirrored * mirrored) * mirrored;
    for (double part = 1; part > FAINT; part *= mirrored * mirrored, size *= mirrored * mirrored) grid_add(g, line, row += pitch, size);
}

void reflectors_add_body(const image_plane *plane, const echo_body *body, echo_grid *g) {
    silhouette s = {.echo = {0}};
    double mirrored = reflection(body->is->impedance, TISSUE);
    for (int i = 1; i < body->count; i++) {
        const double *p = body->points + 3 * (i - 1), *q = p + 3;
        image_point a = image_point_of(plane, v3(p[0], p[1], p[2])), b = image_point_of(plane, v3(q[0], q[1], q[2]));
        vec3 from = v3(a.u, a.v, a.w), along = v3_sub(v3(b.u, b.v, b.w), from);
        double length = v3_norm(along);
        int pieces = 1 + (int)fmin(1e4, length / FINEST);
        if (!(length > 0)) continue;
        for (int k = 0; k < pieces; k++) add_piece(&s, g, v3_axpy((k + 0.5) / pieces, along, from), v3_scale(1 / length, along), length / pieces, body->radius);
    }
    for (int line = 0; line < g->lines; line++) {
        if (s.hides[line] < 1e-4) continue;
        double row = s.row[line] / s.hides[line], open = fmax(DARKEST, 1 - s.hides[line]);
        grid_event(g, line, row, open * open, 1);
        grid_add(g, line, row, mirrored * s.echo[line]);
        add_reverberation(g, line, row, s.echo[line] / (open * open), mirrored, 2 * body->radius); /* the body does not hide its own reverberation */
    }
}

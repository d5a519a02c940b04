#include "view/ultrasound/scatterers.h"

#include <stdlib.h>

enum { TABLE = 1 << 16, COLUMNS = 4, LEAF = 256, CHUNK = LEAF + 8 };

static uint32_t hash(uint32_t x) {
    x = (x ^ x >> 16) * 0x7feb352du;
    x = (x ^ x >> 15) * 0x846ca68bu;
    return x ^ x >> 16;
}

static double fraction(double x) { return x - floor(x); }

static void swap_larger(double *a, double *b) {
    double larger = fmax(*a, *b);
    *a = fmin(*a, *b);
    *b = larger;
}

/* Fills the table with the scatterers' barycentric coordinates and the phases of their echoes. The phase, in turns, stands for the position within a
   wavelength and the sign of the scatterer. The points of a Kronecker sequence fill the unit cube evenly; sorting the coordinates of each folds the cube onto
   a tetrahedron, in which the gaps between the sorted numbers are barycentric coordinates. */
static void fill_table(float *table) {
    static const double root = 1.2207440846057594759; /* root of x^4 = x + 1; makes the sequence fill three dimensions evenly (Roberts 2018) */
    for (uint32_t i = 0; i < TABLE; i++) {
        double x = fraction(0.5 + i / root), y = fraction(0.5 + i / (root * root)), z = fraction(0.5 + i / (root * root * root));
        swap_larger(&x, &y);
        swap_larger(&y, &z);
        swap_larger(&x, &y);
        const float row[COLUMNS] = {(float)x, (float)(y - x), (float)(z - y), (float)(hash(i) / 4294967296.0)};
        for (int c = 0; c < COLUMNS; c++) table[c * TABLE + (int)i] = row[c];
    }
}

static double volume_of(const double *nodes, const int32_t tet[4]) {
    vec3 corner[4];
    for (int i = 0; i < 4; i++) corner[i] = v3(nodes[3 * tet[i]], nodes[3 * tet[i] + 1], nodes[3 * tet[i] + 2]);
    return fabs(v3_dot(v3_sub(corner[1], corner[0]), v3_cross(v3_sub(corner[2], corner[0]), v3_sub(corner[3], corner[0])))) / 6;
}

trocar_status scatterers_create(scatterers *s, const trocar_model *model, double density, const float *amplitudes, trocar_error *why) {
    *s = (scatterers){.tet_count = trocar_model_tet_count(model), .tets = trocar_model_tets(model)};
    s->expected = malloc((size_t)s->tet_count * sizeof *s->expected);
    s->amplitudes = malloc((size_t)s->tet_count * sizeof *s->amplitudes);
    s->table = malloc(COLUMNS * TABLE * sizeof *s->table);
    if (!s->expected || !s->amplitudes || !s->table) return fail(why, TROCAR_NO_MEMORY, "no memory for the ultrasound image's scatterers");
    fill_table(s->table);
    for (int t = 0; t < s->tet_count; t++) {
        s->expected[t] = (float)(density * volume_of(trocar_model_nodes(model), s->tets + 4 * t));
        s->amplitudes[t] = amplitudes[trocar_model_tet_regions(model)[t]];
    }
    return TROCAR_OK;
}

void scatterers_free(scatterers *s) {
    free(s->expected);
    free(s->amplitudes);
    free(s->table);
}

/* ---- which tetrahedra are in the beam ---- */

static inline float less(float a, float b) { return a < b ? a : b; }
static inline float more(float a, float b) { return a > b ? a : b; }
static inline float least(const float x[4]) { return less(less(x[0], x[1]), less(x[2], x[3])); }
static inline float most(const float x[4]) { return more(more(x[0], x[1]), more(x[2], x[3])); }

/* Returns the largest distance from the plane at which this tetrahedron's scatterers are seen, or 0 if none of them is. */
static float reach_of(const echo_grid *g, const image_point corner[4]) {
    float v[4], w[4], distance[4], right[4], left[4];
    for (int i = 0; i < 4; i++) {
        float u = corner[i].u - (float)g->field.centre;
        v[i] = corner[i].v, w[i] = corner[i].w;
        distance[i] = g->field.sector ? sqrtf(u * u + v[i] * v[i]) : v[i];
        right[i] = u * g->edge_cosine - v[i] * g->edge_sine - g->edge_margin;
        left[i] = -u * g->edge_cosine - v[i] * g->edge_sine - g->edge_margin;
    }
    float far = (most(distance) - (float)g->first_row) / (float)g->step, near = (least(v) - (float)g->first_row) / (float)g->step, last = (float)g->rows - 1;
    if (far < 0 || near > last || most(v) < 0 || least(right) > 0 || least(left) > 0) return 0;
    /* over the rows of the tetrahedron, the beam is thickest at one end */
    float reach = (float)THICKNESS_CUT * more(g->thickness[(int)more(near, 0)], g->thickness[(int)less(far, last)]);
    return least(w) > reach || most(w) < -reach ? 0 : reach;
}

/* ---- echoes ---- */

typedef struct {
    float u[CHUNK], v[CHUNK], w[CHUNK], phase[CHUNK];
    float row[CHUNK], line[CHUNK], real[CHUNK], imaginary[CHUNK];
} chunk;

/* Computes the cosine and sine of an angle of 0 to 1 turns by Taylor series about half a turn, to the 12th and 11th power. The errors are below 6e-5 and
   5e-4. */
static inline void turn(float turns, float *cosine, float *sine) {
    float x = 6.2831853f * (turns - 0.5f), s = x * x;
    *cosine = -(1 + s * (-0.5f + s * (1 / 24.f + s * (-1 / 720.f + s * (1 / 40320.f + s * (-1 / 3628800.f + s / 479001600.f))))));
    *sine = -x * (1 + s * (-1 / 6.f + s * (1 / 120.f + s * (-1 / 5040.f + s * (1 / 362880.f - s / 39916800.f)))));
}

/* Returns exp(-q) for q from 0 to THICKNESS_CUT^2 / 2, by a Taylor series about the middle. The error is below 3e-4. */
static inline float fading(float q) {
    float x = 1.21f - q;
    return 0.29819727f * (1 + x * (1 + x * (1 / 2.f + x * (1 / 6.f + x * (1 / 24.f + x * (1 / 120.f + x / 720.f))))));
}

/* Returns the angle in a sector, given the tangent of half the angle, up to 0.75. Uses the polynomial approximation of the arc tangent by Abramowitz and
   Stegun (4.4.49), whose error is 4e-8 for |x| <= 1. */
static inline float twice_arctan(float x) {
    float s = x * x;
    return 2 * x * (1 + s * (-0.3333314528f + s * (0.1999355085f + s * (-0.1420889944f + s * (0.1065626393f + s * (-0.0752896400f + s * (0.0429096138f
                 + s * (-0.0161657367f + s * 0.0028662257f))))))));
}

/* Computes where the scatterers of the chunk lie in the grid, and their echoes. Scatterers that are not seen get amplitude 0. */
static inline void place_echoes(const echo_grid *g, chunk *c, int count, float amplitude, bool sector) {
    const float first_row = (float)g->first_row, per_step = (float)(1 / g->step), first_line = (float)g->first_line, per_line = (float)(1 / g->spacing);
    const float last_row = (float)(g->rows - 2), last_line = (float)(g->lines - 2), turns = (float)(2 / g->wavelength), q_most = (float)(0.5 * THICKNESS_CUT * THICKNESS_CUT);
    const float *restrict thickness = g->thickness;
    for (int i = 0; i < count; i++) {
        float u = c->u[i], v = c->v[i], distance = sector ? sqrtf(u * u + v * v) : v, place = sector ? twice_arctan(u / (distance + v)) : u;
        float row = (distance - first_row) * per_step, line = (place - first_line) * per_line, inside_row = less(more(row, 0), last_row), inside_line = less(more(line, 0), last_line);
        float part = c->w[i] / thickness[(int)inside_row], q = less(0.5f * part * part, q_most), angle = c->phase[i] - turns * (distance - first_row) + 1024, cosine, sine;
        turn(angle - (float)(int)angle, &cosine, &sine);
        float size = fabsf(row - inside_row) + fabsf(line - inside_line) + (q - q_most + 1e-6f > 0 ? 1.f : 0.f) > 0 ? 0 : amplitude * fading(q);
        c->row[i] = inside_row;
        c->line[i] = inside_line;
        c->real[i] = size * cosine;
        c->imaginary[i] = size * sine;
    }
}

/* Distributes each echo over the four nearest points of the grid. */
static void splat(echo_grid *g, const chunk *c, int count) {
    size_t stride = 2 * (size_t)g->lines;
    for (int i = 0; i < count; i++) {
        int row = (int)c->row[i], line = (int)c->line[i];
        float down = c->row[i] - (float)row, right = c->line[i] - (float)line, up = 1 - down, left = 1 - right;
        float *restrict at = g->signal + (size_t)row * stride + 2 * (size_t)line;
        const float echo[4] = {left * c->real[i], left * c->imaginary[i], right * c->real[i], right * c->imaginary[i]};
        for (int k = 0; k < 4; k++) at[k] += up * echo[k];
        for (int k = 0; k < 4; k++) at[stride + (size_t)k] += down * echo[k];
    }
}

/* Adds `count` scatterers, spread evenly over a tetrahedron. `from` is where it starts to read the table. */
static void add_leaf(const scatterers *s, const image_point corner[4], float reach, int count, float amplitude, uint32_t from, echo_grid *g) {
    const float *restrict b1 = s->table, *restrict b2 = b1 + TABLE, *restrict b3 = b2 + TABLE, *restrict phase = b3 + TABLE;
    const image_point o = corner[0], e1 = {corner[1].u - o.u, corner[1].v - o.v, corner[1].w - o.w}, e2 = {corner[2].u - o.u, corner[2].v - o.v, corner[2].w - o.w},
                      e3 = {corner[3].u - o.u, corner[3].v - o.v, corner[3].w - o.w};
    chunk c;
    int kept = 0;
    for (int i = 0; i < count; i++) {
        uint32_t k = from + (uint32_t)i;
        float w = o.w + b1[k] * e1.w + b2[k] * e2.w + b3[k] * e3.w;
        c.u[kept] = o.u + b1[k] * e1.u + b2[k] * e2.u + b3[k] * e3.u;
        c.v[kept] = o.v + b1[k] * e1.v + b2[k] * e2.v + b3[k] * e3.v;
        c.w[kept] = w;
        c.phase[kept] = phase[k];
        kept += fabsf(w) < reach;
    }
    if (g->field.sector) place_echoes(g, &c, kept, amplitude, true);
    else place_echoes(g, &c, kept, amplitude, false);
    splat(g, &c, kept);
}

static image_point middle(image_point a, image_point b) { return (image_point){0.5f * (a.u + b.u), 0.5f * (a.v + b.v), 0.5f * (a.w + b.w)}; }

/* Divides a tetrahedron into eight of equal volume, again and again until each contains few scatterers, so that few of those processed are outside the beam.
   Which scatterers there are depends only on `expected` and `seed`, not on the beam. */
static void add_part(const scatterers *s, const image_point x[4], float expected, float amplitude, uint32_t seed, echo_grid *g) {
    float reach = reach_of(g, x);
    if (!(reach > 0)) return;
    if (expected < LEAF) {
        add_leaf(s, x, reach, (int)(expected + (float)(hash(seed) >> 8) / 16777216.0f), amplitude, hash(seed + 0x9e3779b9u) % (TABLE - CHUNK), g);
        return;
    }
    const image_point m01 = middle(x[0], x[1]), m02 = middle(x[0], x[2]), m03 = middle(x[0], x[3]), m12 = middle(x[1], x[2]), m13 = middle(x[1], x[3]), m23 = middle(x[2], x[3]);
    const image_point parts[8][4] = {{x[0], m01, m02, m03}, {x[1], m01, m12, m13}, {x[2], m02, m12, m23}, {x[3], m03, m13, m23},
                                     {m02, m13, m01, m12}, {m02, m13, m12, m23}, {m02, m13, m23, m03}, {m02, m13, m03, m01}};
    for (uint32_t i = 0; i < 8; i++) add_part(s, parts[i], expected / 8, amplitude, hash(seed * 8 + i + 1), g);
}

void scatterers_add(const scatterers *s, const image_point *nodes, echo_grid *g) {
    for (int t = 0; t < s->tet_count; t++) {
        const int32_t *tet = s->tets + 4 * t;
        const image_point corner[4] = {nodes[tet[0]], nodes[tet[1]], nodes[tet[2]], nodes[tet[3]]};
        add_part(s, corner, s->expected[t], s->amplitudes[t], hash((uint32_t)t), g);
    }
}

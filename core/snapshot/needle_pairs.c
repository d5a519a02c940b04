#include "snapshot/needle_pairs.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { FIELDS = 1024 };              /* number of lines whose fields are cached; enough for 32 needles */
static const double REACH = 3.0; /* edge lengths: at this distance from a line, its patch has no nodes. Derived: a patch extends 1.6 edge lengths, plus up to
                                    one element */

static const double LEAST_PIECE = 1e-5; /* m: lower limit for half the length of a piece of shaft. Rounding tolerance */

struct needle_pairs {
    resolver *resolver;
    const mesh *mesh;
    double radius;
    int count, next;                 /* how many fields are cached, and which one to replace next */
    line_in_tet lines[FIELDS];       /* line of each cached field */
    line_field *fields[FIELDS];
};

trocar_status needle_pairs_create(const tissue *t, double radius, needle_pairs **created, trocar_error *why) {
    needle_pairs *p = *created = calloc(1, sizeof *p);
    if (!p) return fail(why, TROCAR_NO_MEMORY, "no memory for needles close to each other");
    p->mesh = t->mesh;
    p->radius = radius;
    trocar_status status = resolver_create(t, &p->resolver, why);
    if (status == TROCAR_OK) return TROCAR_OK;
    needle_pairs_free(p);
    *created = NULL;
    return status;
}

void needle_pairs_free(needle_pairs *p) {
    if (!p) return;
    for (int i = 0; i < p->count; i++) free(p->fields[i]);
    resolver_free(p->resolver);
    free(p);
}

/* ---- fields ---------------------------------------------------------------------------------------------------------- */

static trocar_status find_field(needle_pairs *p, const line_in_tet *line, const line_field **found, trocar_error *why) {
    for (int i = 0; i < p->count; i++)
        if (line_same(&p->lines[i], line)) {
            *found = p->fields[i];
            return TROCAR_OK;
        }
    int place = p->next;
    if (!p->fields[place]) p->fields[place] = malloc(sizeof *p->fields[place]);
    if (!p->fields[place]) return fail(why, TROCAR_NO_MEMORY, "no memory for needles close to each other");
    if (place == p->count) p->count++;
    p->next = (place + 1) % FIELDS;
    p->lines[place] = *line;
    trocar_status status = resolver_spread(p->resolver, line, p->fields[place], why);
    if (status != TROCAR_OK) p->lines[place].tet = -1;
    *found = p->fields[place];
    return status;
}

/* Rescales the cached fields. Only their scale depends on the moduli, not their shape. */
void needle_pairs_soften(needle_pairs *p) {
    for (int i = 0; i < p->count; i++)
        if (p->lines[i].tet >= 0) p->fields[i]->softness = resolver_softness(p->resolver, p->lines[i].tet);
}

/* ---- tracks ---------------------------------------------------------------------------------------------------------- */

static vec3 place_at(const shaft_piece *piece, double depth) { return v3_axpy(depth - piece->depth, piece->direction, piece->place); }

void shaft_steps_lay(const mesh *m, const tissue_loads *own, double ahead, double finest, shaft_steps *steps) {
    const shaft_piece *pieces[MAX_LOADS];
    int count = 0, tet = -1;
    steps->count = 0;
    for (int i = 0; i < own->count; i++)
        if (!own->loads[i].residual && own->loads[i].shaft.to > own->loads[i].shaft.from) pieces[count++] = &own->loads[i].shaft;
    if (count == 0) return;
    double length = pieces[count - 1]->to + ahead - pieces[0]->from;
    steps->start = pieces[0]->from;
    steps->step = fmax(finest, length / SHIFT_STEPS);
    steps->count = (int)fmin(ceil(length / steps->step), SHIFT_STEPS);
    for (int k = 0, at = 0; k < steps->count; k++) {
        double depth = steps->start + (k + 0.5) * steps->step;
        while (at + 1 < count && depth > pieces[at]->to) at++;
        vec3 place = place_at(pieces[at], depth);
        if (tet < 0) tet = pieces[at]->line.tet;
        tet = steps->at[k].tet = mesh_locate(m, place, tet);
        if (tet >= 0) mesh_barycentric(m, tet, place, steps->at[k].weights);
        steps->at[k].place = place;
        steps->at[k].direction = pieces[at]->direction;
        steps->at[k].line = pieces[at]->line;
    }
}

/* How a piece of another needle's shaft acts on a step. */
typedef struct {
    double part;             /* 1/m, fraction of a force on the piece that acts at the step, per unit length of the step; 0 if none does */
    vec3 place;              /* m, the point on the piece that is nearest to the middle of the step */
} meeting;

/* Returns the second antiderivative of a box function that is centred at 0 and has area 1. */
static double box_twice_integrated(double t, double width) {
    if (t <= -0.5 * width) return 0.0;
    return t >= 0.5 * width ? t : 0.5 * (t + 0.5 * width) * (t + 0.5 * width) / width;
}

/* Two lines interact where they overlap, as measured along the bisector of their directions. Because this measure is the same for both lines, the forces are
   reciprocal. A force at a point of one line displaces the other line over twice the distance between them. When the distance is close to the resolved radius,
   a force spread evenly over this length causes as much unresolved displacement as the point force. A needle in its own old track counts as at least one radius
   away from the forces, because these act on the surface of the shaft (see line_field_lacks). */
static meeting meet(const shaft_steps *steps, int k, const shaft_piece *piece, double radius) {
    vec3 along = steps->at[k].direction, other = piece->direction;
    if (v3_dot(along, other) < 0.0) other = v3_scale(-1.0, other);
    vec3 between = v3_unit(v3_add(along, other));
    double lean = v3_dot(along, between), half = 0.5 * lean * steps->step, middle = v3_dot(steps->at[k].place, between);
    double a = v3_dot(place_at(piece, piece->from), between), b = v3_dot(place_at(piece, piece->to), between);
    double centre = 0.5 * (a + b), half_piece = fmax(0.5 * fabs(b - a), LEAST_PIECE);
    vec3 place = v3_axpy((middle - v3_dot(piece->place, between)) / lean, other, piece->place);
    double halfway = 0.5 * (middle + centre), apart = middle - centre; /* halfway: coordinate at which the distance between the lines is the same for both */
    vec3 here = v3_axpy((halfway - middle) / lean, along, steps->at[k].place), there = v3_axpy((halfway - middle) / lean, other, place);
    double width = 2.0 * fmax(v3_norm(v3_sub(there, here)), radius);
    if (fabs(apart) >= half + half_piece + 0.5 * width) return (meeting){.part = 0.0};
    double common = box_twice_integrated(apart + half + half_piece, width) - box_twice_integrated(apart + half - half_piece, width) -
                    box_twice_integrated(apart - half + half_piece, width) + box_twice_integrated(apart - half - half_piece, width);
    return (meeting){common * lean / (4.0 * half * half_piece), place};
}

/* Returns the displacement at a place per unit force per length on the other line, counting only what the mesh does not resolve. This is the mean of the
   estimates from the two lines' patches. If the tissue is softer at one line than at the other, both estimates are scaled to the geometric mean of the
   softnesses; this keeps the compliance matrix of all needles positive definite. */
static mat3 lacks_between(const needle_pairs *p, const line_field *of, const shaft_steps *steps, int k, const line_field *own, int tet, vec3 place) {
    double weights[4], softer = sqrt(own->softness / of->softness);
    mat3 there = line_field_lacks(of, p->mesh, steps->at[k].tet, steps->at[k].weights, steps->at[k].place, p->radius);
    mesh_barycentric(p->mesh, tet, place, weights);
    mat3 back = line_field_lacks(own, p->mesh, tet, weights, place, p->radius), mean = {{{0}}};
    back = m3_transposed(&back);
    m3_add_scaled(&mean, 0.5 * softer, &there);
    m3_add_scaled(&mean, 0.5 / softer, &back);
    return mean;
}

/* Returns how much of the unresolved displacement to add for a load at this depth. The fraction grows from 0 at the surface, because Kelvin's solution is for
   an infinite body. */
static double embedded_part(const needle_pairs *p, double depth) { return fmin(depth / (EMBEDDING_DEPTH * p->radius), 1.0); }

trocar_status needle_pairs_find(needle_pairs *p, const shaft_steps *steps, const shaft_piece *piece, int *from, int *to, mat3 *lacks, trocar_error *why) {
    const line_field *of = NULL, *own = NULL;
    const line_in_tet *own_line = NULL;
    *from = *to = 0;
    if (!(piece->to > piece->from)) return TROCAR_OK;
    int tet = piece->line.tet;
    vec3 middle = place_at(piece, 0.5 * (piece->from + piece->to));
    double reach = REACH * mesh_edge_length(p->mesh, tet) + (piece->to - piece->from);
    for (int k = 0; k < steps->count; k++) {
        lacks[k] = (mat3){{{0}}};
        if (steps->at[k].tet < 0 || v3_norm(v3_sub(steps->at[k].place, middle)) > reach) continue;
        meeting beside = meet(steps, k, piece, p->radius);
        if (beside.part == 0.0) continue;
        int found = mesh_locate(p->mesh, beside.place, tet);
        if (found < 0) continue;
        tet = found;
        trocar_status status = of ? TROCAR_OK : find_field(p, &piece->line, &of, why);
        if (status == TROCAR_OK && !(own_line && line_same(own_line, &steps->at[k].line))) {
            own_line = &steps->at[k].line;
            status = find_field(p, own_line, &own, why);
        }
        if (status != TROCAR_OK) return status;
        lacks[k] = m3_scaled(embedded_part(p, 0.5 * (piece->from + piece->to)) * beside.part, lacks_between(p, of, steps, k, own, tet, beside.place));
        if (*to == 0) *from = k;
        *to = k + 1;
    }
    return TROCAR_OK;
}

static void add_force(const shaft_steps *steps, int from, int to, const mat3 *lacks, vec3 force, unresolved_shift *shift) {
    for (int k = from; k < to; k++) shift->sum[k + 1] = v3_axpy(steps->step, m3_apply(&lacks[k], force), shift->sum[k + 1]);
    shift->any = shift->any || to > from;
}

trocar_status needle_pairs_shift(needle_pairs *p, const shaft_steps *steps, const tissue_loads *loads, unresolved_shift *shift, trocar_error *why) {
    mat3 lacks[SHIFT_STEPS];
    for (int i = 0; i < loads->count; i++) {
        int from, to;
        trocar_status status = needle_pairs_find(p, steps, &loads->loads[i].shaft, &from, &to, lacks, why);
        if (status != TROCAR_OK) return status;
        add_force(steps, from, to, lacks, loads->loads[i].force, shift);
    }
    return TROCAR_OK;
}

/* Returns what fraction of a shaft's cross-section is outside another shaft of the same radius, given the distance between their axes. */
static double outside(double distance, double radius) {
    double t = fmin(0.5 * distance / radius, 1.0);
    return 1.0 - 2.0 / M_PI * (acos(t) - t * sqrt(1.0 - t * t));
}

/* Returns how much of the displacement due to its own residual loads a needle feels: the fraction of its cross-section outside the hole in which it exerted
   them.
   Inside the hole, the load is now borne by the piece of shaft that is there. Near the surface, less is felt, as in embedded_part. */
static double residual_part(const needle_pairs *p, const shaft_steps *steps, int k, const shaft_piece *piece) {
    double apart = v3_norm(v3_cross(piece->direction, v3_sub(steps->at[k].place, piece->place)));
    return outside(apart, p->radius) * embedded_part(p, k * steps->step);
}

trocar_status needle_pairs_residual_shift(needle_pairs *p, const shaft_steps *steps, const residual_loads *loads, unresolved_shift shift[MAX_RELAXATION],
                                          trocar_error *why) {
    mat3 lacks[SHIFT_STEPS];
    for (int i = 0; i < loads->count; i++) {
        int from, to;
        trocar_status status = needle_pairs_find(p, steps, &loads->loads[i].shaft, &from, &to, lacks, why);
        if (status != TROCAR_OK) return status;
        for (int k = from; k < to; k++) lacks[k] = m3_scaled(residual_part(p, steps, k, &loads->loads[i].shaft), lacks[k]);
        for (int term = 0; term < MAX_RELAXATION; term++) add_force(steps, from, to, lacks, loads->loads[i].load[term], &shift[term]);
    }
    return TROCAR_OK;
}

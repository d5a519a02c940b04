#include "tissue/resolved_radius.h"

#include <cblas.h>
#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "base/lame.h"
#include "base/sparse_memory.h"
#include "tissue/exact_fields.h"
#include "tissue/neighbourhood.h"

static const double RADIUS = 1.6; /* edge lengths: a node's elements belong to the patch if the node is at most this far from the line. Measured: with this
                                     patch, ln R (R: resolved radius) differs from its value on the whole mesh by 0.01 across the line and by 0.02 to 0.03 along
                                     it (docs/mechanics.md) */
static const double HALF_LENGTH = 1.2; /* edge lengths: half the patch's extent along the line, and also the smallest ratio of this half extent to the line's
                                          length within the element. Measured like RADIUS */
static const double FREE = 0.45; /* edge lengths: boundary nodes closer to the line than this are left free, because the exact solution does not hold for a mesh
                                    so close to the line. Measured like RADIUS */
static const double GAP = 1e-9; /* m: consecutive pieces of the line may be this far apart. Rounding tolerance */

/* How one point moves along one axis, per unit load on each degree of freedom and per unit displacement of each fixed one. */
typedef struct {
    double of_load[AROUND_DOFS], of_moved[AROUND_DOFS];
} influence;

struct resolver {
    neighbourhood around;
    double reduced[AROUND_DOFS * AROUND_DOFS], load[AROUND_DOFS], moved[AROUND_DOFS];
    influence on[MAX_RESOLVED][2]; /* influence on each of the points */
    int unknowns, unknown[AROUND_DOFS];
};

trocar_status resolver_create(const tissue *t, resolver **created, trocar_error *why) {
    resolver *r = *created = sparse_zeros(sizeof *r);
    if (!r) return fail(why, TROCAR_NO_MEMORY, "no memory to measure the mesh's resolution");
    trocar_status status = neighbourhood_create(t, &r->around, why);
    if (status == TROCAR_OK) return TROCAR_OK;
    resolver_free(r);
    *created = NULL;
    return status;
}

void resolver_free(resolver *r) {
    if (!r) return;
    neighbourhood_free(&r->around);
    sparse_free(r, sizeof *r);
}

/* ---- solving ------------------------------------------------------------------------------------------------------- */

/* Factorises the stiffness of the free degrees of freedom. */
static trocar_status factor(resolver *r, trocar_error *why) {
    for (int i = 0; i < r->unknowns; i++)
        for (int j = 0; j <= i; j++) r->reduced[(size_t)i * (size_t)r->unknowns + (size_t)j] = r->around.stiffness[r->unknown[i] * AROUND_DOFS + r->unknown[j]];
    int failed = r->unknowns == 0 ? 1 : LAPACKE_dpotrf_work(LAPACK_COL_MAJOR, 'U', r->unknowns, r->reduced, r->unknowns);
    return failed ? fail(why, TROCAR_NUMERIC, "the elements around a contact have no stiffness: check them for degenerate ones") : TROCAR_OK;
}

static void weights_at(const resolver *r, int tet, vec3 x, int nodes[4], double weights[4]) {
    mesh_barycentric(r->around.tissue->mesh, tet, x, weights);
    for (int c = 0; c < 4; c++) nodes[c] = r->around.local[r->around.tissue->mesh->tets[tet][c]];
}

/* Computes how far the load on each degree of freedom, and the displacement of each fixed one, moves one point along one axis. One solve serves all line
   forces. */
static void find_influence(resolver *r, int tet, vec3 x, int axis, influence *on) {
    double right[AROUND_DOFS], weights[4];
    int n = 3 * r->around.node_count, nodes[4];
    weights_at(r, tet, x, nodes, weights);
    memset(on->of_moved, 0, (size_t)n * sizeof *on->of_moved);
    memset(on->of_load, 0, (size_t)n * sizeof *on->of_load);
    for (int c = 0; c < 4; c++) on->of_moved[3 * nodes[c] + axis] = weights[c];
    for (int i = 0; i < r->unknowns; i++) right[i] = on->of_moved[r->unknown[i]];
    LAPACKE_dpotrs_work(LAPACK_COL_MAJOR, 'U', r->unknowns, 1, r->reduced, r->unknowns, right, r->unknowns);
    for (int i = 0; i < r->unknowns; i++) {
        on->of_load[r->unknown[i]] = right[i];
        cblas_daxpy(n, -right[i], r->around.stiffness + (size_t)r->unknown[i] * AROUND_DOFS, 1, on->of_moved, 1);
    }
    for (int i = 0; i < r->unknowns; i++) on->of_moved[r->unknown[i]] = 0.0;
}

/* Returns the displacement due to the current load and the current displacements of the fixed degrees of freedom. */
static double moved_by(const resolver *r, const influence *on) {
    int n = 3 * r->around.node_count;
    return cblas_ddot(n, on->of_load, 1, r->load, 1) + cblas_ddot(n, on->of_moved, 1, r->moved, 1);
}

static void prescribe(resolver *r, int node, vec3 u) {
    r->moved[3 * node] = u.x;
    r->moved[3 * node + 1] = u.y;
    r->moved[3 * node + 2] = u.z;
}

/* ---- a line force -------------------------------------------------------------------------------------------------- */

static bool is_endless(const line_segment *line) { return isinf(line->to); }

static vec3 traction_of(const resolver *r, const line_segment *line, vec3 x, vec3 area) {
    return is_endless(line) ? line_traction(line->axis, x, area, r->around.poisson_ratio) : segment_traction(line, x, area, r->around.poisson_ratio);
}

static vec3 displacement_of(const resolver *r, const line_segment *line, vec3 x) {
    if (!is_endless(line)) return segment_displacement(line, x, r->around.poisson_ratio);
    if (line->axis == 2) return line_axial(x.x, x.y);
    if (line->axis == 0) return line_lateral(x.x, x.y, r->around.poisson_ratio);
    vec3 turned = line_lateral(x.y, -x.x, r->around.poisson_ratio);
    return v3(-turned.y, turned.x, 0);
}

/* Returns into how many parts to divide each edge of a face when integrating the line's traction: fewer if the line is finite and the face is far from it. */
static int parts_of_face(const line_segment *line, vec3 a, vec3 b, vec3 c) {
    enum { NEAR = 6, FAR = 2 };
    vec3 middle = v3_axpy(1.0 / 3.0, v3_add(b, c), a);
    double z = fmin(fmax(middle.z, line->from), line->to), size = fmax(v3_norm(v3_sub(b, c)), fmax(v3_norm(b), v3_norm(c)));
    return !is_endless(line) && v3_norm(v3_sub(middle, v3(0, 0, z))) > size ? FAR : NEAR;
}

/* Adds the traction that the body would exert if it continued beyond its free surface, by quadrature over parts of each face. Without it, the compliance of the
   surface itself would be blamed on the mesh. */
static void load_surface(resolver *r, const line_segment *line) {
    const mesh *m = r->around.tissue->mesh;
    for (int i = 0; i < r->around.free_count; i++) {
        int tet = r->around.free[i].tet, f = r->around.free[i].face, nodes[3];
        for (int k = 0; k < 3; k++) nodes[k] = r->around.local[m->tets[tet][(f + k + 1) % 4]];
        vec3 a = r->around.position[nodes[0]], b = v3_sub(r->around.position[nodes[1]], a), c = v3_sub(r->around.position[nodes[2]], a);
        int parts = parts_of_face(line, a, b, c);
        vec3 outward = v3_scale(0.5 / (parts * parts), v3_cross(b, c));
        if (v3_dot(outward, v3_sub(r->around.position[r->around.local[m->tets[tet][f]]], a)) > 0.0) outward = v3_scale(-1.0, outward);
        for (int p = 0; p < parts; p++)
            for (int q = 0; q < 2 * (parts - p) - 1; q++) { /* sub-triangles in row p, alternately upright and upside down */
                double s = (p + (q % 2 ? 2.0 : 1.0) / 3.0) / parts, t = (q / 2 + (q % 2 ? 2.0 : 1.0) / 3.0) / parts;
                vec3 traction = traction_of(r, line, v3_axpy(t, c, v3_axpy(s, b, a)), outward);
                const double weights[] = {1.0 - s - t, s, t};
                for (int k = 0; k < 3; k++) {
                    r->load[3 * nodes[k]] += weights[k] * traction.x;
                    r->load[3 * nodes[k] + 1] += weights[k] * traction.y;
                    r->load[3 * nodes[k] + 2] += weights[k] * traction.z;
                }
            }
    }
}

static void load_line(resolver *r, const line_segment *line) {
    vec3 along = neighbourhood_direction(&r->around);
    memset(r->load, 0, 3 * (size_t)r->around.node_count * sizeof *r->load);
    for (int i = 0; i < r->around.chord_count; i++) {
        double from = fmax(r->around.chords[i].from, line->from), to = fmin(r->around.chords[i].to, line->to), weights[4];
        int nodes[4];
        if (from >= to) continue;
        weights_at(r, r->around.chords[i].tet, v3_axpy(0.5 * (from + to), along, r->around.origin), nodes, weights);
        for (int c = 0; c < 4; c++) r->load[3 * nodes[c] + line->axis] += (to - from) * weights[c];
    }
    load_surface(r, line);
}

static bool is_near_line(const resolver *r, int node) {
    return hypot(r->around.position[node].x, r->around.position[node].y) < FREE * r->around.size;
}

/* Lists the unknowns. They are all displacements of interior nodes, and those of boundary nodes near the line, either along it (`along`) or across it. The
   exact solution prescribes all others. */
static void free_for_line(resolver *r, bool along) {
    r->unknowns = 0;
    for (int i = 0; i < r->around.node_count; i++)
        for (int a = 0; a < 3; a++)
            if (!r->around.cut[i] || (is_near_line(r, i) && (a == 2) == along)) r->unknown[r->unknowns++] = 3 * i + a;
}

static void push(resolver *r, const line_segment *line) {
    for (int i = 0; i < r->around.node_count; i++) {
        bool held = r->around.cut[i] && !(is_endless(line) && is_near_line(r, i));
        prescribe(r, i, held ? displacement_of(r, line, r->around.position[i]) : v3(0, 0, 0));
    }
    load_line(r, line);
}

static void push_endless(resolver *r, int axis) { push(r, &(line_segment){axis, -INFINITY, INFINITY}); }

/* Computes the mean of the lateral displacements due to forces along x and y of the frame, and the deviation from this mean. */
static void set_lateral(const resolver *r, double moved[2][2], resolved_field *resolved) {
    double mean = 0.5 * (moved[0][0] + moved[1][1]), nu = r->around.poisson_ratio;
    double half = line_lateral_logarithm(0.5 * (moved[0][0] - moved[1][1]), nu), shear = line_lateral_logarithm(0.5 * (moved[0][1] + moved[1][0]), nu);
    mat3 uneven = {{{half, shear, 0}, {shear, -half, 0}, {0, 0, 0}}}, back = m3_transposed(&r->around.frame);
    uneven = m3_multiply(&uneven, &back);
    resolved->lateral = line_lateral_radius(mean, nu);
    resolved->uneven = m3_multiply(&r->around.frame, &uneven);
}

static double place_on_line(const resolver *r, vec3 x) { return v3_dot(v3_sub(x, r->around.origin), neighbourhood_direction(&r->around)); }

/* Returns how far it is from a point on the line to where the line leaves the patch or the body. */
static double reach_of(const resolver *r, double place) {
    double end = place;
    for (int i = 0; i < r->around.chord_count; i++)
        if (r->around.chords[i].from <= end + GAP) end = fmax(end, r->around.chords[i].to);
    return end - place;
}

/* Returns how far ahead of the point the k-th sampled line end is. The samples are denser close to the point, where accuracy matters most. */
static double end_place(const line_end *end, int k) {
    double part = (double)k / LINE_ENDS;
    return part * part * end->reach;
}

/* Compares two displacements due to the part of the line from `from` to `to` beyond the point: that of a cylinder of the resolved radius, and that of the mesh.
   Returns the difference as the logarithm of a ratio of radii. */
static double difference_beyond(resolver *r, double place, double from, double to, double radius, const influence *on) {
    double moved = 0.0, nu = r->around.poisson_ratio;
    for (int axis = 0; axis < 2; axis++) {
        push(r, &(line_segment){axis, place + from, place + to});
        moved += 0.5 * moved_by(r, &on[axis]);
    }
    return segment_logarithm(from, to, radius, nu) - line_lateral_logarithm(moved, nu);
}

static void measure_end(resolver *r, vec3 x, const influence *on, resolved_field *resolved) {
    double place = place_on_line(r, x);
    line_end *end = &resolved->end;
    *end = (line_end){.reach = reach_of(r, place)};
    for (int k = 0; k < LINE_ENDS && end->reach > 0.0; k++) end->more[k] = difference_beyond(r, place, end_place(end, k), end->reach, resolved->lateral, on);
}

static trocar_status measure_along(resolver *r, int tet, int count, const vec3 *x, resolved_field *resolved, trocar_error *why) {
    free_for_line(r, true);
    trocar_status status = factor(r, why);
    if (status != TROCAR_OK) return status;
    push_endless(r, 2);
    for (int k = 0; k < count; k++) {
        find_influence(r, tet, x[k], 2, &r->on[k][0]);
        resolved[k].axial = line_axial_radius(moved_by(r, &r->on[k][0]));
    }
    return TROCAR_OK;
}

static trocar_status measure_across(resolver *r, int tet, int count, const vec3 *x, resolved_field *resolved, trocar_error *why) {
    free_for_line(r, false);
    trocar_status status = factor(r, why);
    if (status != TROCAR_OK) return status;
    double moved[MAX_RESOLVED][2][2];
    for (int k = 0; k < count; k++)
        for (int a = 0; a < 2; a++) find_influence(r, tet, x[k], a, &r->on[k][a]);
    for (int axis = 0; axis < 2; axis++) {
        push_endless(r, axis);
        for (int k = 0; k < count; k++)
            for (int a = 0; a < 2; a++) moved[k][axis][a] = moved_by(r, &r->on[k][a]);
    }
    for (int k = 0; k < count; k++) {
        set_lateral(r, moved[k], &resolved[k]);
        if (k == 0 || k == count - 1) measure_end(r, x[k], r->on[k], &resolved[k]);
    }
    return TROCAR_OK;
}

/* ---- a point force ------------------------------------------------------------------------------------------------- */

typedef struct {
    bool there;
    vec3 on;
    mat3 frame;              /* its z axis points inward */
} plane;

/* Returns the plane of the outer face closest to x, if the patch has one. */
static plane surface_near(const resolver *r, vec3 x) {
    const mesh *m = r->around.tissue->mesh;
    double closest = INFINITY;
    plane found = {.there = false};
    for (int i = 0; i < r->around.free_count; i++) {
        int tet = r->around.free[i].tet, f = r->around.free[i].face;
        vec3 middle = v3(0, 0, 0);
        for (int k = 1; k < 4; k++) middle = v3_axpy(1.0 / 3.0, m->nodes[m->tets[tet][(f + k) % 4]], middle);
        double distance = v3_norm(v3_sub(middle, x));
        if (distance >= closest) continue;
        closest = distance;
        found = (plane){true, middle, frame_along(mesh_face_normal(m, tet, f))};
    }
    return found;
}

/* Returns the exact displacement of a boundary node due to a unit force along the line. The force is distributed over the element's corners as in the mesh,
   because at the boundary the difference from a point force matters. */
static vec3 push_at(const resolver *r, int tet, const double weights[4], int node, const plane *surface) {
    const mesh *m = r->around.tissue->mesh;
    vec3 along = neighbourhood_direction(&r->around), at = m->nodes[r->around.nodes[node]], sum = {0};
    for (int c = 0; c < 4; c++) {
        vec3 source = m->nodes[m->tets[tet][c]], u;
        if (surface->there) {
            vec3 force = m3_apply_transposed(&surface->frame, along);
            vec3 from = m3_apply_transposed(&surface->frame, v3_sub(source, surface->on)), to = m3_apply_transposed(&surface->frame, v3_sub(at, surface->on));
            from.z = fmax(from.z, 0.0);
            to.z = fmax(to.z, 0.0);
            u = m3_apply(&surface->frame, mindlin_displacement(from, force, to, r->around.poisson_ratio));
        } else {
            u = kelvin_displacement(source, along, at, r->around.poisson_ratio);
        }
        sum = v3_axpy(weights[c], u, sum);
    }
    return m3_apply_transposed(&r->around.frame, sum);
}

static trocar_status measure_point(resolver *r, int tet, int count, const vec3 *x, resolved_field *resolved, trocar_error *why) {
    r->unknowns = 0;
    /* the force acts on these nodes, so they must be free */
    for (int c = 0; c < 4; c++) r->around.cut[r->around.local[r->around.tissue->mesh->tets[tet][c]]] = false;
    for (int i = 0; i < r->around.node_count; i++)
        for (int a = 0; a < 3 && !r->around.cut[i]; a++) r->unknown[r->unknowns++] = 3 * i + a;
    trocar_status status = factor(r, why);
    for (int k = 0; k < count && status == TROCAR_OK; k++) {
        plane surface = surface_near(r, x[k]);
        int nodes[4];
        double weights[4];
        weights_at(r, tet, x[k], nodes, weights);
        memset(r->load, 0, 3 * (size_t)r->around.node_count * sizeof *r->load);
        for (int c = 0; c < 4; c++) r->load[3 * nodes[c] + 2] = weights[c];
        for (int i = 0; i < r->around.node_count; i++) prescribe(r, i, r->around.cut[i] ? push_at(r, tet, weights, i, &surface) : v3(0, 0, 0));
        find_influence(r, tet, x[k], 2, &r->on[0][0]);
        resolved[k].point = moved_by(r, &r->on[0][0]);
    }
    return status;
}

/* ---- beside the line ----------------------------------------------------------------------------------------------- */

/* Computes how far an infinite line force along one axis displaces all nodes, using the factorised stiffness. */
static void move_all(resolver *r, int axis, line_field *field) {
    double right[AROUND_DOFS];
    int n = 3 * r->around.node_count;
    push_endless(r, axis);
    for (int i = 0; i < r->unknowns; i++)
        right[i] = r->load[r->unknown[i]] - cblas_ddot(n, r->around.stiffness + (size_t)r->unknown[i] * AROUND_DOFS, 1, r->moved, 1);
    LAPACKE_dpotrs_work(LAPACK_COL_MAJOR, 'U', r->unknowns, 1, r->reduced, r->unknowns, right, r->unknowns);
    for (int i = 0; i < r->unknowns; i++) r->moved[r->unknown[i]] += right[i];
    for (int i = 0; i < r->around.node_count; i++) field->moved[i][axis] = v3(r->moved[3 * i], r->moved[3 * i + 1], r->moved[3 * i + 2]);
}

double resolver_softness(const resolver *r, int tet) {
    const region_material *material = &r->around.tissue->materials[r->around.tissue->mesh->region[tet]];
    return 1.0 / shear_modulus(material->youngs_modulus, material->poisson_ratio);
}

trocar_status resolver_spread(resolver *r, const line_in_tet *line, line_field *field, trocar_error *why) {
    neighbourhood_take(&r->around, line->tet, line->point, line->direction, (patch_reach){.radius = RADIUS, .half_length = HALF_LENGTH});
    field->line = *line;
    field->frame = r->around.frame;
    field->poisson_ratio = r->around.poisson_ratio;
    field->softness = resolver_softness(r, line->tet);
    field->count = r->around.node_count;
    memcpy(field->nodes, r->around.nodes, (size_t)field->count * sizeof *field->nodes);
    for (int along = 0; along < 2; along++) {
        free_for_line(r, along);
        trocar_status status = factor(r, why);
        if (status != TROCAR_OK) return status;
        for (int axis = along ? 2 : 0; axis < (along ? 3 : 2); axis++) move_all(r, axis, field);
    }
    return TROCAR_OK;
}

static int number_in(const line_field *field, int node) {
    for (int i = 0; i < field->count; i++)
        if (field->nodes[i] == node) return i;
    return -1;
}

mat3 line_field_lacks(const line_field *field, const mesh *m, int tet, const double weights[4], vec3 x, double radius) {
    vec3 from = m3_apply_transposed(&field->frame, v3_sub(x, field->line.point)), moved[3] = {{0, 0, 0}, {0, 0, 0}, {0, 0, 0}};
    for (int c = 0; c < 4; c++) {
        int k = number_in(field, mesh_place(m, m->tets[tet][c]));
        if (k < 0) return (mat3){{{0}}};
        for (int axis = 0; axis < 3; axis++) moved[axis] = v3_axpy(-weights[c], field->moved[k][axis], moved[axis]);
    }
    double distance = hypot(from.x, from.y), out = distance < radius ? radius / fmax(distance, 1e-3 * radius) : 1.0;
    if (distance < 1e-3 * radius) from.x = 1e-3 * radius, from.y = 0.0;
    from.x *= out;
    from.y *= out;
    vec3 turned = line_lateral(from.y, -from.x, field->poisson_ratio);
    moved[0] = v3_add(moved[0], line_lateral(from.x, from.y, field->poisson_ratio));
    moved[1] = v3_add(moved[1], v3(-turned.y, turned.x, 0));
    moved[2] = v3_add(moved[2], line_axial(from.x, from.y));
    mat3 lacks = {{{0}}}, back = m3_transposed(&field->frame);
    for (int axis = 0; axis < 3; axis++) {
        lacks.m[0][axis] = field->softness * moved[axis].x;
        lacks.m[1][axis] = field->softness * moved[axis].y;
        lacks.m[2][axis] = field->softness * moved[axis].z;
    }
    lacks = m3_multiply(&lacks, &back);
    return m3_multiply(&field->frame, &lacks);
}

/* ---- all of it ----------------------------------------------------------------------------------------------------- */

double line_end_at(const line_end *end, double ahead) {
    if (!(end->reach > 0.0 && ahead < end->reach)) return 0.0;
    ahead = larger_of(ahead, 0.0);
    int k = (int)(sqrt(ahead / end->reach) * LINE_ENDS);
    if (k >= LINE_ENDS) return 0.0;
    double from = end_place(end, k), t = (ahead - from) / (end_place(end, k + 1) - from);
    return (1.0 - t) * end->more[k] + t * (k + 1 < LINE_ENDS ? end->more[k + 1] : 0.0);
}

void line_end_add_scaled(line_end *to, double scale, const line_end *from) {
    to->reach += scale * from->reach;
    for (int k = 0; k < LINE_ENDS; k++) to->more[k] += scale * from->more[k];
}

double line_end_total(const line_end *end) {
    double sum = end->reach;
    for (int k = 0; k < LINE_ENDS; k++) sum += end->more[k];
    return sum;
}

trocar_status resolver_measure(resolver *r, int tet, vec3 direction, int count, const vec3 *x, resolved_field *resolved, trocar_error *why) {
    patch_reach reach = {.radius = RADIUS, .half_length = HALF_LENGTH, .least = HALF_LENGTH * v3_norm(v3_sub(x[count - 1], x[0]))};
    neighbourhood_take(&r->around, tet, x[count / 2], direction, reach);
    trocar_status status = measure_along(r, tet, count, x, resolved, why);
    if (status == TROCAR_OK) status = measure_across(r, tet, count, x, resolved, why);
    if (status == TROCAR_OK) status = measure_point(r, tet, count, x, resolved, why);
    return status;
}

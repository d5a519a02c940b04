#include "tissue/resolved_radius.h"

#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "tissue/exact_fields.h"

/* The patch: elements with a node within this distance of the line, and so far along it, in mean edge lengths h. Its boundary nodes
   nearer to the line than FREE h are left free, as the exact solution has no meaning for a mesh so close to the line. */
static const double RADIUS = 1.6, HALF_LENGTH = 1.2, FREE = 0.45;
enum { MAX_NODES = 256, MAX_TETS = 1200, MAX_DOFS = 3 * MAX_NODES };

typedef struct {
    int tet;
    double from, to;         /* m along the line */
} chord;

/* All positions in the frame of the line: z along it, the first point is the origin. */
struct resolver {
    const tissue *tissue;
    int *local;              /* node_count of the mesh: number in the patch, or -1 */
    bool *taken;             /* tet_count */
    int node_count, nodes[MAX_NODES], tet_count, tets[MAX_TETS];
    vec3 position[MAX_NODES];
    bool cut[MAX_NODES], outer[MAX_NODES]; /* on the boundary to the rest of the mesh, on the outer surface */
    double free_radius;      /* m */
    mat3 frame;              /* columns: the line's frame */
    vec3 origin;
    double poisson_ratio;
    int chord_count;
    chord chords[MAX_TETS];
    double stiffness[MAX_DOFS * MAX_DOFS]; /* full, shear modulus 1 */
    double reduced[MAX_DOFS * MAX_DOFS], load[MAX_DOFS], moved[MAX_DOFS];
    int unknowns, unknown[MAX_DOFS];
};

trocar_status resolver_create(const tissue *t, resolver **created, report *why) {
    resolver *r = *created = calloc(1, sizeof *r);
    if (r) {
        r->tissue = t;
        r->local = malloc((size_t)t->mesh->node_count * sizeof *r->local);
        r->taken = calloc((size_t)t->mesh->tet_count, sizeof *r->taken);
    }
    if (!r || !r->local || !r->taken) {
        resolver_free(r);
        *created = NULL;
        return fail(why, TROCAR_NO_MEMORY, "no memory to measure what the mesh resolves");
    }
    for (int i = 0; i < t->mesh->node_count; i++) r->local[i] = -1;
    return TROCAR_OK;
}

void resolver_free(resolver *r) {
    if (!r) return;
    free(r->local);
    free(r->taken);
    free(r);
}

/* ---- the patch ----------------------------------------------------------------------------------------------------- */

static vec3 to_frame(const resolver *r, vec3 x) { return m3_apply_transposed(&r->frame, v3_sub(x, r->origin)); }

static vec3 line_direction(const resolver *r) { return v3(r->frame.m[0][2], r->frame.m[1][2], r->frame.m[2][2]); }

static mat3 frame_along(vec3 direction) {
    vec3 aside = fabs(direction.x) < 0.6 ? v3(1, 0, 0) : v3(0, 1, 0), x = v3_unit(v3_cross(aside, direction));
    return m3_columns(x, v3_cross(direction, x), direction);
}

static void clear_patch(resolver *r) {
    for (int i = 0; i < r->node_count; i++) r->local[r->nodes[i]] = -1;
    for (int i = 0; i < r->tet_count; i++) r->taken[r->tets[i]] = false;
    r->node_count = r->tet_count = 0;
}

static bool add_tet(resolver *r, int tet) {
    const int *corners = r->tissue->mesh->tets[tet];
    if (r->tet_count == MAX_TETS || r->node_count > MAX_NODES - 4) return false;
    r->taken[tet] = true;
    r->tets[r->tet_count++] = tet;
    for (int c = 0; c < 4; c++) {
        if (r->local[corners[c]] >= 0) continue;
        int node = r->local[corners[c]] = r->node_count++;
        r->nodes[node] = corners[c];
        r->position[node] = to_frame(r, r->tissue->mesh->nodes[corners[c]]);
        r->cut[node] = r->outer[node] = false;
    }
    return true;
}

static bool is_near(const resolver *r, int tet, double radius, double half_length) {
    for (int c = 0; c < 4; c++) {
        vec3 p = to_frame(r, r->tissue->mesh->nodes[r->tissue->mesh->tets[tet][c]]);
        if (hypot(p.x, p.y) < radius && fabs(p.z) < half_length) return true;
    }
    return false;
}

/* Grows from the element across faces. False: the patch has no room for so many. */
static bool grow(resolver *r, int tet, double h) {
    clear_patch(r);
    if (!add_tet(r, tet)) return false;
    for (int i = 0; i < r->tet_count; i++)
        for (int f = 0; f < 4; f++) {
            int next = r->tissue->mesh->neighbours[r->tets[i]][f];
            if (next < 0 || r->taken[next] || !is_near(r, next, RADIUS * h, HALF_LENGTH * h)) continue;
            if (!add_tet(r, next)) return false;
        }
    return true;
}

/* On the outer surface, where nothing holds it. Where it is held, the body ends no more than it does at the patch's other borders: how
   far away a support is the nominal mesh knows. */
static bool is_free_face(const resolver *r, int tet, int face) {
    const mesh *m = r->tissue->mesh;
    bool held = true;
    for (int k = 1; k < 4; k++) held = held && r->tissue->fixed[m->tets[tet][(face + k) % 4]];
    return m->neighbours[tet][face] < 0 && !held;
}

static void mark_boundary(resolver *r) {
    const mesh *m = r->tissue->mesh;
    for (int i = 0; i < r->tet_count; i++)
        for (int f = 0; f < 4; f++) {
            int next = m->neighbours[r->tets[i]][f];
            if (next >= 0 && r->taken[next]) continue;
            bool outer = is_free_face(r, r->tets[i], f);
            for (int k = 1; k < 4; k++) {
                int node = r->local[m->tets[r->tets[i]][(f + k) % 4]];
                if (outer) r->outer[node] = true;
                else r->cut[node] = true;
            }
        }
}

/* The line's way through the patch, each piece in one element: where it runs on a face or an edge, in one of those beside it. */
static int by_start(const void *a, const void *b) {
    double x = ((const chord *)a)->from, y = ((const chord *)b)->from;
    return (x > y) - (x < y);
}

static void trace_line(resolver *r) {
    static const double ON_FACE = 1e-9;
    const mesh *m = r->tissue->mesh;
    vec3 along = line_direction(r);
    int count = 0;
    for (int i = 0; i < r->tet_count; i++) {
        double here[4], there[4], from = -INFINITY, to = INFINITY, unit = m->node_size[m->tets[r->tets[i]][0]];
        mesh_barycentric(m, r->tets[i], r->origin, here);
        mesh_barycentric(m, r->tets[i], v3_axpy(unit, along, r->origin), there);
        for (int c = 0; c < 4; c++) {
            double slope = (there[c] - here[c]) / unit, value = here[c] + ON_FACE;
            if (fabs(slope) * unit < ON_FACE) {
                if (value < 0.0) to = -INFINITY;
            } else if (slope > 0.0) {
                from = fmax(from, -value / slope);
            } else {
                to = fmin(to, -value / slope);
            }
        }
        if (to > from) r->chords[count++] = (chord){r->tets[i], from, to};
    }
    qsort(r->chords, (size_t)count, sizeof *r->chords, by_start);
    double covered = -INFINITY;
    r->chord_count = 0;
    for (int i = 0; i < count; i++) {
        chord piece = r->chords[i];
        piece.from = fmax(piece.from, covered);
        if (piece.to <= piece.from) continue;
        covered = piece.to;
        r->chords[r->chord_count++] = piece;
    }
}

/* ---- stiffness ----------------------------------------------------------------------------------------------------- */

static double gradients_of(const resolver *r, int tet, vec3 gradients[4]) {
    vec3 corners[4];
    for (int c = 0; c < 4; c++) corners[c] = r->position[r->local[r->tissue->mesh->tets[tet][c]]];
    return tet_gradients(corners, gradients);
}

static void add_block(resolver *r, int a, int b, const mat3 *block) {
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++) r->stiffness[(3 * a + i) * MAX_DOFS + 3 * b + j] += block->m[i][j];
}

static void add_elements(resolver *r, double poisson_ratio) {
    for (int i = 0; i < r->tet_count; i++) {
        vec3 g[4];
        double volume = gradients_of(r, r->tets[i], g);
        for (int a = 0; a < 4; a++)
            for (int b = 0; b < 4; b++) {
                mat3 block = stiffness_block(g[a], g[b], volume, 2.0 * (1.0 + poisson_ratio), poisson_ratio);
                add_block(r, r->local[r->tissue->mesh->tets[r->tets[i]][a]], r->local[r->tissue->mesh->tets[r->tets[i]][b]], &block);
            }
    }
}

/* The elements of the patch for which this holds share their volumetric strain, each with a part of its volume. */
typedef struct {
    int region, node, strain_patch; /* those of a region with a local node as a corner, or those of a strain patch; -1: does not matter */
} strain_group;

static bool shares_strain(const resolver *r, int tet, const strain_group *group) {
    const tissue *t = r->tissue;
    if (group->strain_patch >= 0) return t->patch[tet] == group->strain_patch;
    if (t->mesh->region[tet] != group->region) return false;
    for (int c = 0; c < 4; c++)
        if (r->local[t->mesh->tets[tet][c]] == group->node) return true;
    return false;
}

static void add_mean_strain(resolver *r, const strain_group *group, double lambda) {
    int count = 0, touched[MAX_NODES];
    vec3 mean[MAX_NODES] = {{0}};
    bool listed[MAX_NODES] = {false};
    double sum = 0.0;
    for (int i = 0; i < r->tet_count; i++) {
        if (!shares_strain(r, r->tets[i], group)) continue;
        vec3 g[4];
        double volume = gradients_of(r, r->tets[i], g) * (group->node >= 0 ? 0.25 : 1.0);
        sum += volume;
        for (int c = 0; c < 4; c++) {
            int node = r->local[r->tissue->mesh->tets[r->tets[i]][c]];
            if (!listed[node]) touched[count++] = node, listed[node] = true;
            mean[node] = v3_axpy(volume, g[c], mean[node]);
        }
    }
    for (int a = 0; a < count; a++)
        for (int b = 0; b < count; b++) {
            vec3 p = v3_scale(lambda / sum, mean[touched[a]]), q = mean[touched[b]];
            mat3 block = {{{p.x * q.x, p.x * q.y, p.x * q.z}, {p.y * q.x, p.y * q.y, p.y * q.z}, {p.z * q.x, p.z * q.y, p.z * q.z}}};
            add_block(r, touched[a], touched[b], &block);
        }
}

static bool first_of(const resolver *r, int i, const int *label) {
    for (int j = 0; j < i; j++)
        if (label[r->tets[j]] == label[r->tets[i]]) return false;
    return true;
}

static void assemble(resolver *r) {
    const tissue *t = r->tissue;
    double nu = r->poisson_ratio, lambda = 2.0 * nu / (1.0 - 2.0 * nu);
    for (int i = 0; i < 3 * r->node_count; i++) memset(r->stiffness + (size_t)i * MAX_DOFS, 0, 3 * (size_t)r->node_count * sizeof(double));
    bool whole = t->volumetric == STRAIN_BY_ELEMENT, by_patch = t->volumetric == STRAIN_BY_PATCH;
    add_elements(r, whole ? nu : 0.0);
    for (int i = 0; i < r->tet_count && !whole && nu > 0.0; i++) {
        if (!first_of(r, i, by_patch ? t->patch : t->mesh->region)) continue;
        if (by_patch) add_mean_strain(r, &(strain_group){-1, -1, t->patch[r->tets[i]]}, lambda);
        for (int node = 0; node < r->node_count && !by_patch; node++)
            add_mean_strain(r, &(strain_group){t->mesh->region[r->tets[i]], node, -1}, lambda);
    }
}

/* ---- solving ------------------------------------------------------------------------------------------------------- */

/* Factorises the stiffness of the components that are free. */
static trocar_status factor(resolver *r, report *why) {
    for (int i = 0; i < r->unknowns; i++)
        for (int j = 0; j <= i; j++) r->reduced[(size_t)i * (size_t)r->unknowns + (size_t)j] = r->stiffness[r->unknown[i] * MAX_DOFS + r->unknown[j]];
    int failed = r->unknowns == 0 ? 1 : LAPACKE_dpotrf_work(LAPACK_COL_MAJOR, 'U', r->unknowns, r->reduced, r->unknowns);
    return failed ? fail(why, TROCAR_NUMERIC, "the elements around a contact have no stiffness: check them for degenerate ones") : TROCAR_OK;
}

/* Solves for the free components; `moved` holds the others. */
static void solve(resolver *r) {
    double right[MAX_DOFS];
    int n = 3 * r->node_count;
    for (int i = 0; i < r->unknowns; i++) r->moved[r->unknown[i]] = 0.0;
    for (int i = 0; i < r->unknowns; i++) {
        const double *row = r->stiffness + (size_t)r->unknown[i] * MAX_DOFS;
        right[i] = r->load[r->unknown[i]];
        for (int j = 0; j < n; j++) right[i] -= row[j] * r->moved[j];
    }
    LAPACKE_dpotrs_work(LAPACK_COL_MAJOR, 'U', r->unknowns, 1, r->reduced, r->unknowns, right, r->unknowns);
    for (int i = 0; i < r->unknowns; i++) r->moved[r->unknown[i]] = right[i];
}

static void weights_at(const resolver *r, int tet, vec3 x, int nodes[4], double weights[4]) {
    mesh_barycentric(r->tissue->mesh, tet, x, weights);
    for (int c = 0; c < 4; c++) nodes[c] = r->local[r->tissue->mesh->tets[tet][c]];
}

static double moved_at(const resolver *r, int tet, vec3 x, int axis) {
    int nodes[4];
    double weights[4], sum = 0.0;
    weights_at(r, tet, x, nodes, weights);
    for (int c = 0; c < 4; c++) sum += weights[c] * r->moved[3 * nodes[c] + axis];
    return sum;
}

/* The body goes on behind its free surface: what it would bear there, by quadrature over parts of each face. Left out, the surface's
   own yielding would count as the mesh's. */
static void load_surface(resolver *r, int axis) {
    enum { PARTS = 6 };
    const mesh *m = r->tissue->mesh;
    for (int i = 0; i < r->tet_count; i++)
        for (int f = 0; f < 4; f++) {
            if (!is_free_face(r, r->tets[i], f)) continue;
            int nodes[3];
            for (int k = 0; k < 3; k++) nodes[k] = r->local[m->tets[r->tets[i]][(f + k + 1) % 4]];
            vec3 a = r->position[nodes[0]], b = v3_sub(r->position[nodes[1]], a), c = v3_sub(r->position[nodes[2]], a);
            vec3 outward = v3_scale(0.5 / (PARTS * PARTS), v3_cross(b, c));
            if (v3_dot(outward, v3_sub(r->position[r->local[m->tets[r->tets[i]][f]]], a)) > 0.0) outward = v3_scale(-1.0, outward);
            for (int p = 0; p < PARTS; p++)
                for (int q = 0; q < 2 * (PARTS - p) - 1; q++) { /* triangles in row p, upright and upside down */
                    double s = (p + (q % 2 ? 2.0 : 1.0) / 3.0) / PARTS, t = (q / 2 + (q % 2 ? 2.0 : 1.0) / 3.0) / PARTS;
                    vec3 x = v3_axpy(t, c, v3_axpy(s, b, a)), traction = line_traction(axis, x, outward, r->poisson_ratio);
                    const double weights[] = {1.0 - s - t, s, t};
                    for (int k = 0; k < 3; k++) {
                        r->load[3 * nodes[k]] += weights[k] * traction.x;
                        r->load[3 * nodes[k] + 1] += weights[k] * traction.y;
                        r->load[3 * nodes[k] + 2] += weights[k] * traction.z;
                    }
                }
        }
}

static void load_line(resolver *r, int axis) {
    vec3 along = line_direction(r);
    memset(r->load, 0, 3 * (size_t)r->node_count * sizeof *r->load);
    for (int i = 0; i < r->chord_count; i++) {
        int nodes[4];
        double weights[4], length = r->chords[i].to - r->chords[i].from;
        weights_at(r, r->chords[i].tet, v3_axpy(0.5 * (r->chords[i].from + r->chords[i].to), along, r->origin), nodes, weights);
        for (int c = 0; c < 4; c++) r->load[3 * nodes[c] + axis] += length * weights[c];
    }
    load_surface(r, axis);
}

static void put(resolver *r, int node, vec3 u) {
    r->moved[3 * node] = u.x;
    r->moved[3 * node + 1] = u.y;
    r->moved[3 * node + 2] = u.z;
}

/* ---- a line force -------------------------------------------------------------------------------------------------- */

/* The boundary moves as by the line force; near the line it is free across the needle, or along it. */
static void free_for_line(resolver *r, bool along) {
    r->unknowns = 0;
    for (int i = 0; i < r->node_count; i++) {
        bool boundary = r->cut[i], near = hypot(r->position[i].x, r->position[i].y) < r->free_radius;
        for (int a = 0; a < 3; a++)
            if (!boundary || (near && (a == 2) == along)) r->unknown[r->unknowns++] = 3 * i + a;
    }
}

static void push_line(resolver *r, int axis) {
    for (int i = 0; i < r->node_count; i++) {
        vec3 p = r->position[i];
        bool near = hypot(p.x, p.y) < r->free_radius;
        if (near) put(r, i, v3(0, 0, 0));
        else if (axis == 2) put(r, i, line_axial(p.x, p.y));
        else if (axis == 0) put(r, i, line_lateral(p.x, p.y, r->poisson_ratio));
        else {
            vec3 turned = line_lateral(p.y, -p.x, r->poisson_ratio);
            put(r, i, v3(-turned.y, turned.x, 0));
        }
    }
    load_line(r, axis);
    solve(r);
}

static trocar_status measure_line(resolver *r, int tet, int count, const vec3 *x, resolved_field *resolved, report *why) {
    free_for_line(r, true);
    trocar_status status = factor(r, why);
    if (status != TROCAR_OK) return status;
    push_line(r, 2);
    for (int k = 0; k < count; k++) resolved[k].axial = line_axial_radius(moved_at(r, tet, x[k], 2));
    free_for_line(r, false);
    status = factor(r, why);
    if (status != TROCAR_OK) return status;
    double sideways[MAX_RESOLVED] = {0};
    for (int axis = 0; axis < 2; axis++) {
        push_line(r, axis);
        for (int k = 0; k < count; k++) sideways[k] += 0.5 * moved_at(r, tet, x[k], axis);
    }
    for (int k = 0; k < count; k++) resolved[k].lateral = line_lateral_radius(sideways[k], r->poisson_ratio);
    return TROCAR_OK;
}

/* ---- a point force ------------------------------------------------------------------------------------------------- */

typedef struct {
    bool there;
    vec3 on;
    mat3 frame;              /* its z axis points inward */
} plane;

/* The plane of the outer face that is closest to x, if there is one in the patch. */
static plane surface_near(const resolver *r, vec3 x) {
    const mesh *m = r->tissue->mesh;
    double closest = INFINITY;
    plane found = {.there = false};
    for (int i = 0; i < r->tet_count; i++)
        for (int f = 0; f < 4; f++) {
            if (!is_free_face(r, r->tets[i], f)) continue;
            vec3 middle = v3(0, 0, 0);
            for (int k = 1; k < 4; k++) middle = v3_axpy(1.0 / 3.0, m->nodes[m->tets[r->tets[i]][(f + k) % 4]], middle);
            double distance = v3_norm(v3_sub(middle, x));
            if (distance >= closest) continue;
            closest = distance;
            found = (plane){true, middle, frame_along(mesh_face_normal(m, r->tets[i], f))};
        }
    return found;
}

/* At a node of the boundary, by a unit force along the line that acts, as it does on the mesh, on the corners of the element. To the
   boundary, where this differs from a force at one point is what matters of the mesh. */
static vec3 push_at(const resolver *r, int tet, const double weights[4], int node, const plane *surface) {
    const mesh *m = r->tissue->mesh;
    vec3 along = line_direction(r), at = m->nodes[r->nodes[node]], sum = {0};
    for (int c = 0; c < 4; c++) {
        vec3 source = m->nodes[m->tets[tet][c]], u;
        if (surface->there) {
            vec3 force = m3_apply_transposed(&surface->frame, along);
            vec3 from = m3_apply_transposed(&surface->frame, v3_sub(source, surface->on)), to = m3_apply_transposed(&surface->frame, v3_sub(at, surface->on));
            from.z = fmax(from.z, 0.0);
            to.z = fmax(to.z, 0.0);
            u = m3_apply(&surface->frame, mindlin_displacement(from, force, to, r->poisson_ratio));
        } else {
            u = kelvin_displacement(source, along, at, r->poisson_ratio);
        }
        sum = v3_axpy(weights[c], u, sum);
    }
    return m3_apply_transposed(&r->frame, sum);
}

static trocar_status measure_point(resolver *r, int tet, int count, const vec3 *x, resolved_field *resolved, report *why) {
    r->unknowns = 0;
    for (int c = 0; c < 4; c++) r->cut[r->local[r->tissue->mesh->tets[tet][c]]] = false; /* the force acts on them */
    for (int i = 0; i < r->node_count; i++)
        for (int a = 0; a < 3 && !r->cut[i]; a++) r->unknown[r->unknowns++] = 3 * i + a;
    trocar_status status = factor(r, why);
    for (int k = 0; k < count && status == TROCAR_OK; k++) {
        plane surface = surface_near(r, x[k]);
        int nodes[4];
        double weights[4];
        weights_at(r, tet, x[k], nodes, weights);
        memset(r->load, 0, 3 * (size_t)r->node_count * sizeof *r->load);
        for (int c = 0; c < 4; c++) r->load[3 * nodes[c] + 2] = weights[c];
        for (int i = 0; i < r->node_count; i++) put(r, i, r->cut[i] ? push_at(r, tet, weights, i, &surface) : v3(0, 0, 0));
        solve(r);
        resolved[k].point = moved_at(r, tet, x[k], 2);
    }
    return status;
}

/* ---- all of it ----------------------------------------------------------------------------------------------------- */

trocar_status resolver_measure(resolver *r, int tet, vec3 direction, int count, const vec3 *x, resolved_field *resolved, report *why) {
    const mesh *m = r->tissue->mesh;
    const region_material *material = &r->tissue->materials[m->region[tet]];
    double weights[4], h = 0.0;
    r->origin = x[count / 2];
    r->frame = frame_along(direction);
    r->poisson_ratio = material->poisson_ratio;
    mesh_barycentric(m, tet, r->origin, weights);
    for (int c = 0; c < 4; c++) h += fmax(weights[c], 0.0) * m->node_size[m->tets[tet][c]];
    double size = h;
    while (!grow(r, tet, size)) size *= 0.9;
    r->free_radius = FREE * h;
    mark_boundary(r);
    trace_line(r);
    assemble(r);
    trocar_status status = measure_line(r, tet, count, x, resolved, why);
    if (status == TROCAR_OK) status = measure_point(r, tet, count, x, resolved, why);
    return status;
}

#include "tissue/resolved_radius.h"

#include <cblas.h>
#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "tissue/exact_fields.h"
#include "tissue/neighbourhood.h"

/* The patch: elements with a node within this distance of the line, and so far along it, in edge lengths of the mesh there; along it, at
   least in lengths of the way through the element. Its boundary nodes nearer to the line than FREE edge lengths are left free: so close to
   the line, the exact solution has no meaning for a mesh. */
static const double RADIUS = 1.6, HALF_LENGTH = 1.2, FREE = 0.45;

struct resolver {
    neighbourhood around;
    double reduced[AROUND_DOFS * AROUND_DOFS], load[AROUND_DOFS], moved[AROUND_DOFS];
    int unknowns, unknown[AROUND_DOFS];
};

trocar_status resolver_create(const tissue *t, resolver **created, report *why) {
    resolver *r = *created = calloc(1, sizeof *r);
    if (!r) return fail(why, TROCAR_NO_MEMORY, "no memory to measure what the mesh resolves");
    trocar_status status = neighbourhood_create(t, &r->around, why);
    if (status == TROCAR_OK) return TROCAR_OK;
    resolver_free(r);
    *created = NULL;
    return status;
}

void resolver_free(resolver *r) {
    if (!r) return;
    neighbourhood_free(&r->around);
    free(r);
}

/* ---- solving ------------------------------------------------------------------------------------------------------- */

/* Factorises the stiffness of the components that are free. */
static trocar_status factor(resolver *r, report *why) {
    for (int i = 0; i < r->unknowns; i++)
        for (int j = 0; j <= i; j++) r->reduced[(size_t)i * (size_t)r->unknowns + (size_t)j] = r->around.stiffness[r->unknown[i] * AROUND_DOFS + r->unknown[j]];
    int failed = r->unknowns == 0 ? 1 : LAPACKE_dpotrf_work(LAPACK_COL_MAJOR, 'U', r->unknowns, r->reduced, r->unknowns);
    return failed ? fail(why, TROCAR_NUMERIC, "the elements around a contact have no stiffness: check them for degenerate ones") : TROCAR_OK;
}

/* Solves for the free components; `moved` holds the others. */
static void solve(resolver *r) {
    double right[AROUND_DOFS];
    int n = 3 * r->around.node_count;
    for (int i = 0; i < r->unknowns; i++) r->moved[r->unknown[i]] = 0.0;
    for (int i = 0; i < r->unknowns; i++) {
        const double *row = r->around.stiffness + (size_t)r->unknown[i] * AROUND_DOFS;
        right[i] = r->load[r->unknown[i]] - cblas_ddot(n, row, 1, r->moved, 1);
    }
    LAPACKE_dpotrs_work(LAPACK_COL_MAJOR, 'U', r->unknowns, 1, r->reduced, r->unknowns, right, r->unknowns);
    for (int i = 0; i < r->unknowns; i++) r->moved[r->unknown[i]] = right[i];
}

static void weights_at(const resolver *r, int tet, vec3 x, int nodes[4], double weights[4]) {
    mesh_barycentric(r->around.tissue->mesh, tet, x, weights);
    for (int c = 0; c < 4; c++) nodes[c] = r->around.local[r->around.tissue->mesh->tets[tet][c]];
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
    const mesh *m = r->around.tissue->mesh;
    for (int i = 0; i < r->around.tet_count; i++)
        for (int f = 0; f < 4; f++) {
            if (!neighbourhood_free_face(&r->around, r->around.tets[i], f)) continue;
            int nodes[3];
            for (int k = 0; k < 3; k++) nodes[k] = r->around.local[m->tets[r->around.tets[i]][(f + k + 1) % 4]];
            vec3 a = r->around.position[nodes[0]], b = v3_sub(r->around.position[nodes[1]], a), c = v3_sub(r->around.position[nodes[2]], a);
            vec3 outward = v3_scale(0.5 / (PARTS * PARTS), v3_cross(b, c));
            if (v3_dot(outward, v3_sub(r->around.position[r->around.local[m->tets[r->around.tets[i]][f]]], a)) > 0.0) outward = v3_scale(-1.0, outward);
            for (int p = 0; p < PARTS; p++)
                for (int q = 0; q < 2 * (PARTS - p) - 1; q++) { /* triangles in row p, upright and upside down */
                    double s = (p + (q % 2 ? 2.0 : 1.0) / 3.0) / PARTS, t = (q / 2 + (q % 2 ? 2.0 : 1.0) / 3.0) / PARTS;
                    vec3 x = v3_axpy(t, c, v3_axpy(s, b, a)), traction = line_traction(axis, x, outward, r->around.poisson_ratio);
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
    vec3 along = neighbourhood_direction(&r->around);
    memset(r->load, 0, 3 * (size_t)r->around.node_count * sizeof *r->load);
    for (int i = 0; i < r->around.chord_count; i++) {
        int nodes[4];
        double weights[4], length = r->around.chords[i].to - r->around.chords[i].from;
        weights_at(r, r->around.chords[i].tet, v3_axpy(0.5 * (r->around.chords[i].from + r->around.chords[i].to), along, r->around.origin), nodes, weights);
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
    for (int i = 0; i < r->around.node_count; i++) {
        bool boundary = r->around.cut[i], near = hypot(r->around.position[i].x, r->around.position[i].y) < FREE * r->around.size;
        for (int a = 0; a < 3; a++)
            if (!boundary || (near && (a == 2) == along)) r->unknown[r->unknowns++] = 3 * i + a;
    }
}

static void push_line(resolver *r, int axis) {
    for (int i = 0; i < r->around.node_count; i++) {
        vec3 p = r->around.position[i];
        bool near = hypot(p.x, p.y) < FREE * r->around.size;
        if (near) put(r, i, v3(0, 0, 0));
        else if (axis == 2) put(r, i, line_axial(p.x, p.y));
        else if (axis == 0) put(r, i, line_lateral(p.x, p.y, r->around.poisson_ratio));
        else {
            vec3 turned = line_lateral(p.y, -p.x, r->around.poisson_ratio);
            put(r, i, v3(-turned.y, turned.x, 0));
        }
    }
    load_line(r, axis);
    solve(r);
}

/* From displacements across, by forces along the frame's x and y: their mean, and how far they are from it. */
static void set_lateral(const resolver *r, double moved[2][2], resolved_field *resolved) {
    double mean = 0.5 * (moved[0][0] + moved[1][1]), nu = r->around.poisson_ratio;
    double half = line_lateral_logarithm(0.5 * (moved[0][0] - moved[1][1]), nu), shear = line_lateral_logarithm(0.5 * (moved[0][1] + moved[1][0]), nu);
    mat3 uneven = {{{half, shear, 0}, {shear, -half, 0}, {0, 0, 0}}}, back = m3_transposed(&r->around.frame);
    uneven = m3_multiply(&uneven, &back);
    resolved->lateral = line_lateral_radius(mean, nu);
    resolved->uneven = m3_multiply(&r->around.frame, &uneven);
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
    double moved[MAX_RESOLVED][2][2];
    for (int axis = 0; axis < 2; axis++) {
        push_line(r, axis);
        for (int k = 0; k < count; k++)
            for (int a = 0; a < 2; a++) moved[k][axis][a] = moved_at(r, tet, x[k], a);
    }
    for (int k = 0; k < count; k++) set_lateral(r, moved[k], &resolved[k]);
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
    const mesh *m = r->around.tissue->mesh;
    double closest = INFINITY;
    plane found = {.there = false};
    for (int i = 0; i < r->around.tet_count; i++)
        for (int f = 0; f < 4; f++) {
            if (!neighbourhood_free_face(&r->around, r->around.tets[i], f)) continue;
            vec3 middle = v3(0, 0, 0);
            for (int k = 1; k < 4; k++) middle = v3_axpy(1.0 / 3.0, m->nodes[m->tets[r->around.tets[i]][(f + k) % 4]], middle);
            double distance = v3_norm(v3_sub(middle, x));
            if (distance >= closest) continue;
            closest = distance;
            found = (plane){true, middle, frame_along(mesh_face_normal(m, r->around.tets[i], f))};
        }
    return found;
}

/* At a node of the boundary, by a unit force along the line that acts, as it does on the mesh, on the corners of the element. To the
   boundary, where this differs from a force at one point is what matters of the mesh. */
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

static trocar_status measure_point(resolver *r, int tet, int count, const vec3 *x, resolved_field *resolved, report *why) {
    r->unknowns = 0;
    for (int c = 0; c < 4; c++) r->around.cut[r->around.local[r->around.tissue->mesh->tets[tet][c]]] = false; /* the force acts on them */
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
        for (int i = 0; i < r->around.node_count; i++) put(r, i, r->around.cut[i] ? push_at(r, tet, weights, i, &surface) : v3(0, 0, 0));
        solve(r);
        resolved[k].point = moved_at(r, tet, x[k], 2);
    }
    return status;
}

/* ---- all of it ----------------------------------------------------------------------------------------------------- */

trocar_status resolver_measure(resolver *r, int tet, vec3 direction, int count, const vec3 *x, resolved_field *resolved, report *why) {
    patch_reach reach = {.radius = RADIUS, .half_length = HALF_LENGTH, .least = HALF_LENGTH * v3_norm(v3_sub(x[count - 1], x[0]))};
    neighbourhood_take(&r->around, tet, x[count / 2], direction, reach);
    trocar_status status = measure_line(r, tet, count, x, resolved, why);
    if (status == TROCAR_OK) status = measure_point(r, tet, count, x, resolved, why);
    return status;
}

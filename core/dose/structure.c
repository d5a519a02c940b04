/* Implements structures, the voxels inside an organ (trocar/dose.h). */
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "base/error.h"
#include "base/vec.h"

static const double MAX_VOXELS = 0x1p28;
static const double FARTHEST = 1000.0; /* m, limit on coordinates and on the spacing */

/* Where a voxel's centre lies in its tetrahedron: the corner nodes and their barycentric coordinates. */
typedef struct {
    int32_t node[4];
    double weight[4];
} tet_place;

struct trocar_structure {
    int64_t count;
    double spacing;
    double *points;          /* [count][3], m */
    tet_place *places;       /* [count]; NULL if the structure was made from a surface */
};

/* The voxels in a box around an organ. Their centres are at (first + index + 1/2) spacing along each axis. */
typedef struct {
    double spacing;
    int64_t first[3], counts[3], total;
} lattice;

static vec3 node_of(const trocar_mesh *mesh, int32_t index) {
    const double *p = mesh->nodes + 3 * (int64_t)index;
    return v3(p[0], p[1], p[2]);
}

static double coordinate(vec3 p, int axis) { return axis == 0 ? p.x : axis == 1 ? p.y : p.z; }

/* Returns the index, counted from the start of the lattice, of the first voxel along this axis whose centre is at x or beyond. The voxel may be outside the
   lattice. */
static int64_t voxel_from(const lattice *l, int axis, double x) { return (int64_t)ceil(x / l->spacing - 0.5) - l->first[axis]; }
static double centre_of(const lattice *l, int axis, int64_t index) { return l->spacing * ((double)(l->first[axis] + index) + 0.5); }

static trocar_status check_node(const trocar_mesh *mesh, const char *what, int element, int32_t node, trocar_error *why) {
    if (node < 0 || node >= mesh->node_count)
        return fail(why, TROCAR_BAD_INPUT, "%s %d has the node %d: expected 0 to %d", what, element, node, mesh->node_count - 1);
    vec3 p = node_of(mesh, node);
    if (fabs(p.x) <= FARTHEST && fabs(p.y) <= FARTHEST && fabs(p.z) <= FARTHEST) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "node %d is at (%g, %g, %g): expected finite numbers, at most 1000 m", node, p.x, p.y, p.z);
}

/* Finds the lattice around the elements whose entry in `group` is `chosen`, or around all elements if `group` is NULL. `corners`: nodes per element. */
static trocar_status find_lattice(const trocar_mesh *mesh, const char *what, const int32_t *elements, int count, int corners, const int32_t *group, int chosen,
                                  double spacing, lattice *l, trocar_error *why) {
    double low[3] = {INFINITY, INFINITY, INFINITY}, high[3] = {-INFINITY, -INFINITY, -INFINITY};
    if (!(spacing > 0.0 && spacing <= FARTHEST)) return fail(why, TROCAR_BAD_INPUT, "a spacing of %g m: expected a number above 0, at most 1000", spacing);
    bool any = false;
    for (int e = 0; e < count; e++) {
        if (group && group[e] != chosen) continue;
        any = true;
        for (int c = 0; c < corners; c++) {
            int32_t node = elements[(int64_t)corners * e + c];
            trocar_status status = check_node(mesh, what, e, node, why);
            if (status != TROCAR_OK) return status;
            for (int k = 0; k < 3; k++) {
                low[k] = fmin(low[k], coordinate(node_of(mesh, node), k));
                high[k] = fmax(high[k], coordinate(node_of(mesh, node), k));
            }
        }
    }
    if (!any) return fail(why, TROCAR_BAD_INPUT, "no %s belongs to number %d: check the index", what, chosen);
    double total = 1.0;
    l->spacing = spacing;
    for (int k = 0; k < 3; k++) total *= (high[k] - low[k]) / spacing + 2.0;
    if (total > MAX_VOXELS) return fail(why, TROCAR_BAD_INPUT, "a spacing of %g m gives %.2g voxels, more than 2^28: make it larger", spacing, total);
    l->total = 1;
    for (int k = 0; k < 3; k++) {
        l->first[k] = (int64_t)floor(low[k] / spacing - 0.5);
        l->counts[k] = (int64_t)floor(high[k] / spacing - 0.5) - l->first[k] + 2;
        l->total *= l->counts[k];
    }
    return TROCAR_OK;
}

static trocar_status create(const lattice *l, int64_t count, bool with_places, trocar_structure **created, trocar_error *why) {
    if (count == 0) return fail(why, TROCAR_BAD_INPUT, "no voxel has its centre inside: make the spacing smaller than %g m", l->spacing);
    trocar_structure *s = calloc(1, sizeof *s);
    if (s) s->points = malloc(3 * (size_t)count * sizeof *s->points);
    if (s && with_places) s->places = malloc((size_t)count * sizeof *s->places);
    if (!s || !s->points || (with_places && !s->places)) {
        trocar_structure_free(s);
        return fail(why, TROCAR_NO_MEMORY, "no memory for %lld voxels", (long long)count);
    }
    s->count = count;
    s->spacing = l->spacing;
    *created = s;
    return TROCAR_OK;
}

static void put_centre(const lattice *l, int64_t voxel, double point[3]) {
    int64_t column = voxel / l->counts[2];
    point[0] = centre_of(l, 0, column / l->counts[1]);
    point[1] = centre_of(l, 1, column % l->counts[1]);
    point[2] = centre_of(l, 2, voxel % l->counts[2]);
}

/* ---- tetrahedra ------------------------------------------------------------------------------------------------------------------ */

/* Data for computing barycentric coordinates in a tetrahedron. */
typedef struct {
    vec3 origin;
    mat3 inverse;            /* inverse of the matrix whose columns are the edges from the origin */
} tet_frame;

/* Returns false if the tetrahedron is flat. */
static bool make_frame(const vec3 corner[4], tet_frame *frame) {
    mat3 edges = m3_columns(v3_sub(corner[1], corner[0]), v3_sub(corner[2], corner[0]), v3_sub(corner[3], corner[0]));
    *frame = (tet_frame){corner[0], m3_inverse(&edges)};
    return m3_determinant(&edges) != 0.0;
}

static void weights_of(const tet_frame *frame, vec3 p, double weight[4]) {
    vec3 w = m3_apply(&frame->inverse, v3_sub(p, frame->origin));
    weight[0] = 1.0 - w.x - w.y - w.z;
    weight[1] = w.x;
    weight[2] = w.y;
    weight[3] = w.z;
}

/* With the tolerance, a centre on a face is inside both adjacent tetrahedra, so rounding errors leave no gap between them. */
static bool is_inside(const double w[4]) {
    const double tolerance = -1e-12;
    return w[0] >= tolerance && w[1] >= tolerance && w[2] >= tolerance && w[3] >= tolerance;
}

static void corners_of(const trocar_mesh *mesh, int32_t tet, vec3 corner[4]) {
    for (int c = 0; c < 4; c++) corner[c] = node_of(mesh, mesh->tets[4 * (int64_t)tet + c]);
}

/* Claims the voxels inside a tetrahedron that have no owner yet: sets their owner to the tetrahedron's number plus 1. Returns how many were claimed. */
static int64_t claim(const trocar_mesh *mesh, int32_t tet, const lattice *l, int32_t *owner) {
    vec3 corner[4];
    int64_t from[3], to[3], claimed = 0;
    double weight[4];
    tet_frame frame;
    corners_of(mesh, tet, corner);
    if (!make_frame(corner, &frame)) return 0;
    for (int k = 0; k < 3; k++) {
        double low = INFINITY, high = -INFINITY;
        for (int c = 0; c < 4; c++) {
            low = fmin(low, coordinate(corner[c], k));
            high = fmax(high, coordinate(corner[c], k));
        }
        from[k] = voxel_from(l, k, low);
        to[k] = voxel_from(l, k, high);
        if (to[k] >= l->counts[k]) to[k] = l->counts[k] - 1;
        if (from[k] < 0) from[k] = 0;
    }
    for (int64_t i = from[0]; i <= to[0]; i++)
        for (int64_t j = from[1]; j <= to[1]; j++)
            for (int64_t k = from[2]; k <= to[2]; k++) {
                int32_t *o = &owner[(i * l->counts[1] + j) * l->counts[2] + k];
                vec3 p = v3(centre_of(l, 0, i), centre_of(l, 1, j), centre_of(l, 2, k));
                weights_of(&frame, p, weight);
                if (*o != 0 || !is_inside(weight)) continue;
                *o = tet + 1;
                claimed++;
            }
    return claimed;
}

trocar_status trocar_structure_from_region(const trocar_mesh *mesh, int region, double spacing, trocar_structure **created, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    lattice l;
    *created = NULL;
    trocar_status status = find_lattice(mesh, "tetrahedron", mesh->tets, mesh->tet_count, 4, mesh->tet_region, region, spacing, &l, why);
    if (status != TROCAR_OK) return status;
    int32_t *owner = calloc((size_t)l.total, sizeof *owner);
    if (!owner) return fail(why, TROCAR_NO_MEMORY, "no memory for a box of %lld voxels", (long long)l.total);
    int64_t count = 0;
    for (int32_t t = 0; t < mesh->tet_count; t++)
        if (!mesh->tet_region || mesh->tet_region[t] == region) count += claim(mesh, t, &l, owner);
    status = create(&l, count, true, created, why);
    for (int64_t voxel = 0, n = 0; status == TROCAR_OK && voxel < l.total; voxel++) {
        if (owner[voxel] == 0) continue;
        vec3 corner[4];
        tet_frame frame;
        double *p = (*created)->points + 3 * n;
        tet_place *place = &(*created)->places[n++];
        corners_of(mesh, owner[voxel] - 1, corner);
        put_centre(&l, voxel, p);
        make_frame(corner, &frame);
        weights_of(&frame, v3(p[0], p[1], p[2]), place->weight);
        memcpy(place->node, mesh->tets + 4 * (int64_t)(owner[voxel] - 1), sizeof place->node);
    }
    free(owner);
    return status;
}

/* ---- surface ----------------------------------------------------------------------------------------------------------------------- */

typedef struct { int32_t low, high; } edge;

static int by_nodes(const void *a, const void *b) {
    const edge *x = a, *y = b;
    if (x->low != y->low) return x->low < y->low ? -1 : 1;
    return (x->high > y->high) - (x->high < y->high);
}

static bool is_of_surface(const trocar_mesh *mesh, int triangle, int surface) { return !mesh->triangle_surface || mesh->triangle_surface[triangle] == surface; }

/* Checks that the surface is closed: every edge must belong to an even number of triangles. */
static trocar_status check_closed(const trocar_mesh *mesh, int surface, trocar_error *why) {
    edge *edges = malloc(3 * (size_t)mesh->triangle_count * sizeof *edges);
    if (!edges) return fail(why, TROCAR_NO_MEMORY, "no memory for the edges of %d triangles", mesh->triangle_count);
    size_t count = 0;
    for (int t = 0; t < mesh->triangle_count; t++)
        for (int k = 0; k < 3 && is_of_surface(mesh, t, surface); k++) {
            int32_t a = mesh->triangles[3 * (int64_t)t + k], b = mesh->triangles[3 * (int64_t)t + (k + 1) % 3];
            edges[count++] = a < b ? (edge){a, b} : (edge){b, a};
        }
    qsort(edges, count, sizeof *edges, by_nodes);
    trocar_status status = TROCAR_OK;
    for (size_t i = 0, next; i < count && status == TROCAR_OK; i = next) {
        for (next = i + 1; next < count && by_nodes(&edges[i], &edges[next]) == 0; next++) {}
        if ((next - i) % 2 == 0) continue;
        vec3 a = node_of(mesh, edges[i].low), b = node_of(mesh, edges[i].high);
        status = fail(why, TROCAR_BAD_INPUT, "the surface is not closed: the edge of the nodes %d and %d, from (%g, %g, %g) to (%g, %g, %g), belongs to %zu triangle%s; "
                      "close the surface, and merge nodes at the same place", edges[i].low, edges[i].high, a.x, a.y, a.z, b.x, b.y, b.z, next - i,
                      next - i == 1 ? "" : "s");
    }
    free(edges);
    return status;
}

/* Computes y and z of the point where an edge crosses the plane at this x; returns false if it does not. Both triangles at an edge get exactly the same
   numbers. */
static bool cross_edge(const trocar_mesh *mesh, int32_t a, int32_t b, double x, double at[2]) {
    vec3 p = node_of(mesh, a < b ? a : b), q = node_of(mesh, a < b ? b : a);
    if ((p.x <= x) == (q.x <= x)) return false;
    double w = (x - p.x) / (q.x - p.x);
    at[0] = p.y + w * (q.y - p.y);
    at[1] = p.z + w * (q.z - p.z);
    return true;
}

/* In each column of voxels along z, toggles the mark of the first voxel above the triangle. Once this is done for all triangles, a voxel is inside if the
   number of marks at or below it is odd. A plane of constant x cuts the triangles in closed polygons, and a line of constant y in that plane crosses these an
   even number of times, even if it passes through corners. */
static void mark_triangle(const trocar_mesh *mesh, const int32_t node[3], const lattice *l, uint8_t *marks) {
    vec3 a = node_of(mesh, node[0]), b = node_of(mesh, node[1]), c = node_of(mesh, node[2]);
    int64_t to = voxel_from(l, 0, fmax(a.x, fmax(b.x, c.x)));
    for (int64_t i = voxel_from(l, 0, fmin(a.x, fmin(b.x, c.x))); i <= to && i < l->counts[0]; i++) {
        double end[3][2];
        int ends = 0;
        for (int k = 0; k < 3; k++) ends += cross_edge(mesh, node[k], node[(k + 1) % 3], centre_of(l, 0, i), end[ends]);
        if (ends != 2) continue;
        int64_t last = voxel_from(l, 1, fmax(end[0][0], end[1][0]));
        for (int64_t j = voxel_from(l, 1, fmin(end[0][0], end[1][0])); j <= last && j < l->counts[1]; j++) {
            double y = centre_of(l, 1, j);
            if ((end[0][0] <= y) == (end[1][0] <= y)) continue;
            int64_t k = voxel_from(l, 2, end[0][1] + (y - end[0][0]) / (end[1][0] - end[0][0]) * (end[1][1] - end[0][1]));
            if (k < 0) k = 0;
            if (k < l->counts[2]) marks[(i * l->counts[1] + j) * l->counts[2] + k] ^= 1;
        }
    }
}

/* Replaces the marks with 1 for voxels inside and 0 for all others. Returns the number of voxels inside. */
static int64_t fill(const lattice *l, uint8_t *marks) {
    int64_t count = 0;
    for (int64_t column = 0; column < l->total; column += l->counts[2]) {
        uint8_t inside = 0;
        for (int64_t k = 0; k < l->counts[2]; k++) {
            inside ^= marks[column + k];
            marks[column + k] = inside;
            count += inside;
        }
    }
    return count;
}

trocar_status trocar_structure_from_surface(const trocar_mesh *mesh, int surface, double spacing, trocar_structure **created, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    lattice l;
    *created = NULL;
    trocar_status status = find_lattice(mesh, "triangle", mesh->triangles, mesh->triangle_count, 3, mesh->triangle_surface, surface, spacing, &l, why);
    if (status == TROCAR_OK) status = check_closed(mesh, surface, why);
    if (status != TROCAR_OK) return status;
    uint8_t *marks = calloc((size_t)l.total, sizeof *marks);
    if (!marks) return fail(why, TROCAR_NO_MEMORY, "no memory for a box of %lld voxels", (long long)l.total);
    for (int t = 0; t < mesh->triangle_count; t++)
        if (is_of_surface(mesh, t, surface)) mark_triangle(mesh, mesh->triangles + 3 * (int64_t)t, &l, marks);
    status = create(&l, fill(&l, marks), false, created, why);
    for (int64_t voxel = 0, n = 0; status == TROCAR_OK && voxel < l.total; voxel++)
        if (marks[voxel]) put_centre(&l, voxel, (*created)->points + 3 * n++);
    free(marks);
    return status;
}

/* ---- the object ---------------------------------------------------------------------------------------------------------------------- */

void trocar_structure_free(trocar_structure *structure) {
    if (!structure) return;
    free(structure->points);
    free(structure->places);
    free(structure);
}

int64_t trocar_structure_count(const trocar_structure *structure) { return structure->count; }
const double *trocar_structure_points(const trocar_structure *structure) { return structure->points; }
double trocar_structure_voxel(const trocar_structure *structure) { return structure->spacing * structure->spacing * structure->spacing; }

trocar_status trocar_structure_displacements(const trocar_structure *structure, const double *nodal, double *displacements, trocar_error *error) {
    trocar_error ignored, *why = error ? error : &ignored;
    if (!structure->places)
        return fail(why, TROCAR_BAD_INPUT, "a structure from a surface has no tetrahedra to interpolate in: make it with trocar_structure_from_region");
    for (int64_t i = 0; i < structure->count; i++) {
        const tet_place *p = &structure->places[i];
        for (int k = 0; k < 3; k++) {
            double sum = 0.0;
            for (int c = 0; c < 4; c++) sum += p->weight[c] * nodal[3 * (int64_t)p->node[c] + k];
            displacements[3 * i + k] = sum;
        }
    }
    return TROCAR_OK;
}

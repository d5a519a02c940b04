#include "probe/support.h"

#include <cblas.h>
#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "snapshot/free_displacement.h"

void support_free(support *s) {
    free(s->nodes);
    free(s->force);
    free(s->force_now);
    free(s->rows);
    free(s->factor);
    free(s->pivots);
    free(s->before);
    free(s->reached);
    free(s->responses);
    free(s->blocks);
    free(s->columns);
    free(s->response);
    *s = (support){.tissue = s->tissue, .most = s->most};
}

static const mesh *mesh_of(const support *s) { return inverse_tissue(s->tissue)->mesh; }

/* ---- forces of held needles ------------------------------------------------------------------------------------------------------ */

static bool make_room(support *s, int nodes) {
    if (nodes <= s->node_room) return true;
    size_t wide = 3 * (size_t)(nodes > s->most ? nodes : s->most);
    free(s->nodes);
    free(s->force);
    free(s->force_now);
    free(s->blocks);
    s->nodes = malloc((size_t)nodes * sizeof *s->nodes);
    s->force = malloc((size_t)nodes * sizeof *s->force);
    s->force_now = malloc((size_t)nodes * sizeof *s->force_now);
    s->blocks = malloc(3 * (size_t)nodes * wide * sizeof *s->blocks);
    s->node_room = s->nodes && s->force && s->force_now && s->blocks ? nodes : 0;
    s->row_room = 0; /* `reached` has to grow too */
    return s->node_room > 0;
}

static int place_of(const support *s, int node) {
    int k = 0;
    while (k < s->node_count && s->nodes[k] != node) k++;
    return k;
}

static int count_rows(const needle_holds *holds) {
    int count = 0;
    for (int n = 0; n < holds->count; n++) count += holds->of[n]->count;
    return count;
}

trocar_status support_list(support *s, const other_loads *others, const needle_holds *holds, trocar_error *why) {
    if (!make_room(s, 1 + loads_most_nodes(others) + 4 * count_rows(holds))) return fail(why, TROCAR_NO_MEMORY, "no memory for the probe's loads");
    s->node_count = loads_on_nodes(mesh_of(s), others, s->nodes, s->force);
    s->row_count = s->reach_count = 0;
    for (int n = 0; n < holds->count; n++)
        for (int i = 0; i < holds->of[n]->count; i++) {
            int tet = holds->of[n]->rows[i].tet;
            for (int c = 0; c < 4 && tet >= 0; c++) {
                int node = mesh_of(s)->tets[tet][c], k = place_of(s, node);
                if (k == s->node_count) s->nodes[s->node_count++] = node, s->force[k] = v3(0, 0, 0);
            }
        }
    return TROCAR_OK;
}

/* ---- compliance of the rows ------------------------------------------------------------------------------------------------------- */

static void list_rows(support *s, const needle_holds *holds) {
    s->row_count = 0;
    for (int n = 0; n < holds->count; n++)
        for (int i = 0; i < holds->of[n]->count; i++) {
            const attached_row *given = &holds->of[n]->rows[i];
            supporting_row *row = &s->rows[s->row_count++];
            *row = (supporting_row){.direction = given->direction};
            for (int c = 0; c < 4 && given->tet >= 0; c++) {
                row->corners[c] = place_of(s, mesh_of(s)->tets[given->tet][c]);
                row->weights[c] = given->weights[c];
            }
        }
}

/* Interpolates a nodal vector field at a row and returns its component along the row's direction. Component a at node k is values[(3 k + a) stride]. */
static double at_row(const supporting_row *row, const double *values, size_t stride) {
    double sum = 0.0;
    for (int c = 0; c < 4; c++) {
        const double *x = values + 3 * (size_t)row->corners[c] * stride;
        sum += row->weights[c] * (row->direction.x * x[0] + row->direction.y * x[stride] + row->direction.z * x[2 * stride]);
    }
    return sum;
}

/* Interpolates `blocks`, the compliance between `nodes` and `columns` other nodes, at the rows. `out`: row_count x 3 `columns`, column-major. */
static void interpolate(const support *s, int columns, double *out) {
    size_t ld = 3 * (size_t)columns;
    for (int i = 0; i < s->row_count; i++)
        for (size_t j = 0; j < ld; j++) out[j * (size_t)s->row_count + (size_t)i] = at_row(&s->rows[i], s->blocks + j, ld);
}

/* Computes the compliance between the rows and these nodes (row_count x 3 count, column-major). As a by-product, `blocks` holds the compliance between `nodes`
   and these nodes. */
static trocar_status find_compliance(support *s, int count, const int *nodes, double *out, trocar_error *why) {
    trocar_status status = inverse_gather(s->tissue, &(inverse_blocks){s->node_count, s->nodes, count, nodes, s->blocks, 3 * count}, why);
    if (status == TROCAR_OK) interpolate(s, count, out);
    return status;
}

/* Adds the compliance of the needles themselves. It is block diagonal, because needles are coupled only through the tissue. */
static void add_needles(support *s, const needle_holds *holds) {
    size_t ld = (size_t)s->row_count, first = 0;
    for (int n = 0; n < holds->count; n++) {
        const double *own = holds->of[n]->compliance;
        size_t count = (size_t)holds->of[n]->count;
        for (size_t i = 0; i < count; i++)
            for (size_t j = 0; j <= i; j++) s->factor[(first + j) * ld + first + i] += *own++;
        first += count;
    }
}

static int count_unstable(const needle_holds *holds) {
    int count = 0;
    for (int n = 0; n < holds->count; n++) count += holds->of[n]->unstable;
    return count;
}

/* Returns how many eigenvalues of the factorised matrix are negative, by Sylvester's law of inertia. Each 2 x 2 pivot contributes one. */
static int count_negative(const support *s) {
    int count = 0;
    for (int k = 0; k < s->row_count; k++) {
        bool pair = s->pivots[k] < 0;
        count += pair || s->factor[(size_t)k * ((size_t)s->row_count + 1)] < 0.0;
        k += pair;
    }
    return count;
}

/* Factorises C + G. Sets `stable` to false if needles and tissue would be unstable without the probe. In that case, the needles' forces are taken as constant
   until the next tick. */
static trocar_status factorise(support *s, const needle_holds *holds, bool *stable, trocar_error *why) {
    size_t n = (size_t)s->row_count;
    trocar_status status = find_compliance(s, s->node_count, s->nodes, s->reached, why);
    if (status != TROCAR_OK) return status;
    for (size_t j = 0; j < n; j++)
        for (size_t i = 0; i < n; i++) s->factor[j * n + i] = at_row(&s->rows[j], s->reached + i, n);
    add_needles(s, holds);
    *stable = LAPACKE_dsytrf(LAPACK_COL_MAJOR, 'L', s->row_count, s->factor, s->row_count, s->pivots) == 0 && count_negative(s) == count_unstable(holds);
    return TROCAR_OK;
}

static bool make_room_for_rows(support *s, int count) {
    size_t rows = (size_t)count, wide = 3 * (size_t)(s->node_room > s->most ? s->node_room : s->most);
    if (count <= s->row_room) return true;
    free(s->rows);
    free(s->factor);
    free(s->pivots);
    free(s->before);
    free(s->reached);
    free(s->responses);
    free(s->columns);
    free(s->response);
    s->rows = malloc(rows * sizeof *s->rows);
    s->factor = malloc(rows * rows * sizeof *s->factor);
    s->pivots = malloc(rows * sizeof *s->pivots);
    s->before = malloc(rows * sizeof *s->before);
    s->reached = malloc(rows * wide * sizeof *s->reached);
    s->responses = malloc(rows * wide * sizeof *s->responses);
    s->columns = malloc(2 * rows * (size_t)s->most * sizeof *s->columns);
    s->response = malloc(rows * sizeof *s->response);
    bool room = s->rows && s->factor && s->pivots && s->before && s->reached && s->responses && s->columns && s->response;
    s->row_room = room ? count : 0;
    return room;
}

static void respond(const support *s, int columns, double *displacements) {
    LAPACKE_dsytrs(LAPACK_COL_MAJOR, 'L', s->row_count, columns, s->factor, s->row_count, s->pivots, displacements, s->row_count);
}

trocar_status support_prepare(support *s, const needle_holds *holds, const nodal_forces *pressed, trocar_error *why) {
    int count = count_rows(holds);
    bool stable = true;
    if (count == 0) return TROCAR_OK;
    if (!make_room_for_rows(s, count)) return fail(why, TROCAR_NO_MEMORY, "no memory for the needles beside the probe");
    list_rows(s, holds);
    trocar_status status = factorise(s, holds, &stable, why);
    memset(s->before, 0, (size_t)s->row_count * sizeof *s->before);
    if (status == TROCAR_OK && stable && pressed->count > 0) {
        status = find_compliance(s, pressed->count, pressed->nodes, s->reached, why);
        if (status == TROCAR_OK) cblas_dgemv(CblasColMajor, CblasNoTrans, s->row_count, 3 * pressed->count, 1.0, s->reached, s->row_count, &pressed->force->x, 1, 0.0, s->before, 1);
        if (status == TROCAR_OK) respond(s, 1, s->before);
    }
    if (status != TROCAR_OK || !stable) s->row_count = 0;
    return status;
}

/* ---- response to the probe -------------------------------------------------------------------------------------------------------- */

trocar_status support_reach(support *s, int count, const int *nodes, vec3 *u, trocar_error *why) {
    s->reach_count = count;
    if (s->row_count == 0) return nodal_displacement_add(s->tissue, &(nodal_forces){s->node_count, s->nodes, s->force}, count, nodes, u, why);
    trocar_status status = find_compliance(s, count, nodes, s->reached, why);
    if (status != TROCAR_OK) return status;
    memcpy(s->responses, s->reached, 3 * (size_t)count * (size_t)s->row_count * sizeof *s->responses);
    respond(s, 3 * count, s->responses);
    cblas_dgemv(CblasRowMajor, CblasTrans, 3 * s->node_count, 3 * count, 1.0, s->blocks, 3 * count, &s->force->x, 1, 1.0, &u->x, 1);
    cblas_dgemv(CblasColMajor, CblasTrans, s->row_count, 3 * count, 1.0, s->reached, s->row_count, s->before, 1, 1.0, &u->x, 1);
    return TROCAR_OK;
}

void support_displace(const support *s, const vec3 *load, vec3 *u) {
    if (s->row_count == 0) return;
    cblas_dgemv(CblasColMajor, CblasNoTrans, s->row_count, 3 * s->reach_count, 1.0, s->responses, s->row_count, &load->x, 1, 0.0, s->response, 1);
    cblas_dgemv(CblasColMajor, CblasTrans, s->row_count, 3 * s->reach_count, -1.0, s->reached, s->row_count, s->response, 1, 1.0, &u->x, 1);
}

/* Combines columns of a matrix for the reached nodes into columns for the points. */
static void combine(const support *s, int count, const unit_force *points, const double *nodal, double *columns) {
    size_t rows = (size_t)s->row_count;
    memset(columns, 0, rows * (size_t)count * sizeof *columns);
    for (int i = 0; i < count; i++)
        for (int e = 0; e < 2; e++) {
            if (points[i].ends[e] < 0) continue;
            vec3 f = points[i].along;
            const double *of = nodal + 3 * (size_t)points[i].ends[e] * rows;
            for (size_t k = 0; k < rows; k++) columns[(size_t)i * rows + k] += f.x * of[k] + f.y * of[rows + k] + f.z * of[2 * rows + k];
        }
}

void support_stiffen(const support *s, int count, const unit_force *points, double *compliance, int ld) {
    int rows = s->row_count;
    if (rows == 0) return;
    double *moved = s->columns, *taken = s->columns + (size_t)rows * (size_t)s->most;
    combine(s, count, points, s->reached, moved);
    combine(s, count, points, s->responses, taken);
    cblas_dsyr2k(CblasRowMajor, CblasLower, CblasNoTrans, count, rows, -0.5, moved, rows, taken, rows, 1.0, compliance, ld);
    for (int i = 0; i < count; i++)
        for (int j = 0; j < i; j++) compliance[j * ld + i] = compliance[i * ld + j];
}

nodal_forces support_forces(const support *s, const vec3 *load) {
    if (s->row_count == 0 || s->reach_count == 0) return (nodal_forces){s->node_count, s->nodes, s->force};
    memcpy(s->force_now, s->force, (size_t)s->node_count * sizeof *s->force);
    memcpy(s->response, s->before, (size_t)s->row_count * sizeof *s->response);
    cblas_dgemv(CblasColMajor, CblasNoTrans, s->row_count, 3 * s->reach_count, -1.0, s->responses, s->row_count, &load->x, 1, 1.0, s->response, 1);
    for (int k = 0; k < s->row_count; k++) {
        const supporting_row *row = &s->rows[k];
        for (int c = 0; c < 4; c++) s->force_now[row->corners[c]] = v3_axpy(row->weights[c] * s->response[k], row->direction, s->force_now[row->corners[c]]);
    }
    return (nodal_forces){s->node_count, s->nodes, s->force_now};
}

#include "probe/support.h"

#include <cblas.h>
#include <lapacke.h>
#include <stdlib.h>
#include <string.h>

#include "snapshot/free_displacement.h"

static const double GIVE = 3.0; /* fraction: compliance across the needle, of the needle and of the tissue close to it at a contact, as a fraction of the
                                   mesh's compliance there. If it is too small, the tissue lags behind the probe by the needle's motion until the next
                                   solution; if it is much too large, the contacts of probe and needle alternate. Fitted to both: a lag of 20 um
                                   (tests/unit/api/test_probe.c) and the jumps in random motions (verify_probe_motions) */
static const double SLIDING = 100.0; /* fraction: the same along the needle, where the tissue slides. Chosen so large that the friction hardly changes */

void support_free(support *s) {
    free(s->nodes);
    free(s->force);
    free(s->force_now);
    free(s->contacts);
    free(s->factor);
    free(s->before);
    free(s->reached);
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

trocar_status support_list(support *s, const other_loads *others, report *why) {
    if (!make_room(s, 1 + loads_most_nodes(others))) return fail(why, TROCAR_NO_MEMORY, "no memory for the probe's loads");
    s->node_count = loads_on_nodes(mesh_of(s), others, s->nodes, s->force);
    s->row_count = s->reach_count = 0;
    return TROCAR_OK;
}

/* ---- compliance of the contacts --------------------------------------------------------------------------------------------------- */

/* A force that acts without a shaft, such as a residual load, supports nothing. */
static bool supports(const tissue_load *load) { return load->shaft.to > load->shaft.from; }

static int count_contacts(const other_loads *others) {
    int count = 0;
    for (int n = 0; n < others->count; n++)
        for (int i = 0; i < others->of[n]->count; i++) count += supports(&others->of[n]->loads[i]);
    return count;
}

static void list_contacts(support *s, const other_loads *others) {
    int count = 0;
    for (int n = 0; n < others->count; n++)
        for (int i = 0; i < others->of[n]->count; i++) {
            const tissue_load *load = &others->of[n]->loads[i];
            if (!supports(load)) continue;
            supporting_contact *contact = &s->contacts[count++];
            contact->along = load->shaft.direction;
            memcpy(contact->weights, load->weights, sizeof contact->weights);
            for (int c = 0; c < 4; c++) {
                int k = 0;
                while (s->nodes[k] != mesh_of(s)->tets[load->tet][c]) k++;
                contact->corners[c] = k;
            }
        }
}

/* Interpolates the blocks between `nodes` and `columns` other nodes at the contacts: row_count x 3 columns, column-major. */
static void interpolate(const support *s, int columns, double *out) {
    for (int j = 0; j < 3 * columns; j++)
        for (int i = 0; i < s->row_count; i++) {
            const supporting_contact *contact = &s->contacts[i / 3];
            double sum = 0.0;
            for (int c = 0; c < 4; c++) sum += contact->weights[c] * s->blocks[(size_t)(3 * contact->corners[c] + i % 3) * (size_t)(3 * columns) + (size_t)j];
            out[(size_t)j * (size_t)s->row_count + (size_t)i] = sum;
        }
}

/* Computes the compliance between the contacts and these nodes, row_count x 3 count, column-major; leaves the blocks of `nodes` in the scratch memory. */
static trocar_status find_compliance(support *s, int count, const int *nodes, double *out, report *why) {
    trocar_status status = inverse_gather(s->tissue, &(inverse_blocks){s->node_count, s->nodes, count, nodes, s->blocks, 3 * count}, why);
    if (status == TROCAR_OK) interpolate(s, count, out);
    return status;
}

static trocar_status factorise(support *s, report *why) {
    size_t n = (size_t)s->row_count;
    trocar_status status = find_compliance(s, s->node_count, s->nodes, s->reached, why);
    for (int j = 0; j < s->row_count && status == TROCAR_OK; j++) {
        const supporting_contact *contact = &s->contacts[j / 3];
        for (int i = 0; i < s->row_count; i++) {
            double sum = 0.0;
            for (int c = 0; c < 4; c++) sum += contact->weights[c] * s->reached[(size_t)(3 * contact->corners[c] + j % 3) * n + (size_t)i];
            s->factor[(size_t)j * n + (size_t)i] = sum;
        }
        double *own = &s->factor[(size_t)j * n + (size_t)j];
        *own = *own > 0.0 ? (1.0 + GIVE) * *own : 1.0; /* not positive: the whole element is fixed */
    }
    for (int i = 0; i < s->row_count / 3 && status == TROCAR_OK; i++) {
        vec3 d = s->contacts[i].along;
        const double along[3] = {d.x, d.y, d.z};
        double size = s->factor[(size_t)(3 * i) * (n + 1)];
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) s->factor[(size_t)(3 * i + a) * n + (size_t)(3 * i + b)] += SLIDING * size * along[a] * along[b];
    }
    if (status == TROCAR_OK && LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', s->row_count, s->factor, s->row_count) != 0)
        status = fail(why, TROCAR_NUMERIC, "the tissue's compliance at the needles is not positive definite");
    return status;
}

static bool make_room_for_contacts(support *s, int contacts) {
    size_t rows = 3 * (size_t)contacts, wide = 3 * (size_t)(s->node_room > s->most ? s->node_room : s->most);
    if ((int)rows <= s->row_room) return true;
    free(s->contacts);
    free(s->factor);
    free(s->before);
    free(s->reached);
    free(s->columns);
    free(s->response);
    s->contacts = malloc((size_t)contacts * sizeof *s->contacts);
    s->factor = malloc(rows * rows * sizeof *s->factor);
    s->before = malloc(rows * sizeof *s->before);
    s->reached = malloc(rows * wide * sizeof *s->reached);
    s->columns = malloc(rows * (size_t)s->most * sizeof *s->columns);
    s->response = malloc(rows * sizeof *s->response);
    bool room = s->contacts && s->factor && s->before && s->reached && s->columns && s->response;
    s->row_room = room ? (int)rows : 0;
    return room;
}

static void divide_by_factor(const support *s, int columns, double *rows) {
    cblas_dtrsm(CblasColMajor, CblasLeft, CblasLower, CblasNoTrans, CblasNonUnit, s->row_count, columns, 1.0, s->factor, s->row_count, rows, s->row_count);
}

trocar_status support_prepare(support *s, const other_loads *others, const nodal_forces *pressed, report *why) {
    int contacts = count_contacts(others);
    if (contacts == 0) return TROCAR_OK;
    if (!make_room_for_contacts(s, contacts)) return fail(why, TROCAR_NO_MEMORY, "no memory for the needles beside the probe");
    s->row_count = 3 * contacts;
    list_contacts(s, others);
    trocar_status status = factorise(s, why);
    memset(s->before, 0, (size_t)s->row_count * sizeof *s->before);
    if (status == TROCAR_OK && pressed->count > 0) {
        status = find_compliance(s, pressed->count, pressed->nodes, s->reached, why);
        if (status == TROCAR_OK) cblas_dgemv(CblasColMajor, CblasNoTrans, s->row_count, 3 * pressed->count, 1.0, s->reached, s->row_count, &pressed->force->x, 1, 0.0, s->before, 1);
        if (status == TROCAR_OK) divide_by_factor(s, 1, s->before);
    }
    if (status != TROCAR_OK) s->row_count = 0;
    return status;
}

/* ---- response to the probe -------------------------------------------------------------------------------------------------------- */

trocar_status support_reach(support *s, int count, const int *nodes, vec3 *u, report *why) {
    s->reach_count = count;
    if (s->row_count == 0) return nodal_displacement_add(s->tissue, &(nodal_forces){s->node_count, s->nodes, s->force}, count, nodes, u, why);
    trocar_status status = find_compliance(s, count, nodes, s->reached, why);
    if (status != TROCAR_OK) return status;
    divide_by_factor(s, 3 * count, s->reached);
    cblas_dgemv(CblasRowMajor, CblasTrans, 3 * s->node_count, 3 * count, 1.0, s->blocks, 3 * count, &s->force->x, 1, 1.0, &u->x, 1);
    cblas_dgemv(CblasColMajor, CblasTrans, s->row_count, 3 * count, 1.0, s->reached, s->row_count, s->before, 1, 1.0, &u->x, 1);
    return TROCAR_OK;
}

void support_displace(const support *s, const vec3 *load, vec3 *u) {
    if (s->row_count == 0) return;
    cblas_dgemv(CblasColMajor, CblasNoTrans, s->row_count, 3 * s->reach_count, 1.0, s->reached, s->row_count, &load->x, 1, 0.0, s->response, 1);
    cblas_dgemv(CblasColMajor, CblasTrans, s->row_count, 3 * s->reach_count, -1.0, s->reached, s->row_count, s->response, 1, 1.0, &u->x, 1);
}

void support_stiffen(const support *s, int count, const unit_force *points, double *compliance, int ld) {
    size_t rows = (size_t)s->row_count;
    if (rows == 0) return;
    memset(s->columns, 0, rows * (size_t)count * sizeof *s->columns);
    for (int i = 0; i < count; i++)
        for (int e = 0; e < 2; e++) {
            if (points[i].ends[e] < 0) continue;
            vec3 f = points[i].along;
            const double *reached = s->reached + 3 * (size_t)points[i].ends[e] * rows;
            for (size_t k = 0; k < rows; k++) s->columns[(size_t)i * rows + k] += f.x * reached[k] + f.y * reached[rows + k] + f.z * reached[2 * rows + k];
        }
    cblas_dsyrk(CblasRowMajor, CblasLower, CblasNoTrans, count, (int)rows, -1.0, s->columns, (int)rows, 1.0, compliance, ld);
    for (int i = 0; i < count; i++)
        for (int j = 0; j < i; j++) compliance[j * ld + i] = compliance[i * ld + j];
}

nodal_forces support_forces(const support *s, const vec3 *load) {
    if (s->row_count == 0 || s->reach_count == 0) return (nodal_forces){s->node_count, s->nodes, s->force};
    memcpy(s->force_now, s->force, (size_t)s->node_count * sizeof *s->force);
    memcpy(s->response, s->before, (size_t)s->row_count * sizeof *s->response);
    cblas_dgemv(CblasColMajor, CblasNoTrans, s->row_count, 3 * s->reach_count, -1.0, s->reached, s->row_count, &load->x, 1, 1.0, s->response, 1);
    cblas_dtrsv(CblasColMajor, CblasLower, CblasTrans, CblasNonUnit, s->row_count, s->factor, s->row_count, s->response, 1);
    for (int k = 0; k < s->row_count / 3; k++) {
        const supporting_contact *contact = &s->contacts[k];
        vec3 change = v3(s->response[3 * k], s->response[3 * k + 1], s->response[3 * k + 2]);
        for (int c = 0; c < 4; c++) s->force_now[contact->corners[c]] = v3_axpy(contact->weights[c], change, s->force_now[contact->corners[c]]);
    }
    return (nodal_forces){s->node_count, s->nodes, s->force_now};
}

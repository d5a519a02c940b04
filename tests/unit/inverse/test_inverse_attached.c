/* Compares the inverse with attached needles or probes, dense and sparse, with K + P S P^T factorised from scratch, and the attachments' responses with the
   displacements this matrix gives. Parts that have not changed must stay bit-identical. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <lapacke.h>

#include "cube.h"
#include "inverse/inverse_attached.h"

#include <cmocka.h>

#include "check.h"

enum { THINGS = 3, ROWS = 10, FREE = 4, ALL = THINGS * ROWS, N = 3 * CUBE_NODES };

typedef struct {
    attached_row rows[ROWS];
    double compliance[ROWS * ROWS], motions[FREE * ROWS];
} thing;

static cube body;
static inverse *sparse;
static thing things[THINGS];
static int all[CUBE_NODES];
static double dense[N * N], largest;
static trocar_error why;

/* While this is set, allocations fail. */
static bool out_of_memory;
void *__real_malloc(size_t size);
void *__real_calloc(size_t count, size_t size);
void *__wrap_malloc(size_t size);
void *__wrap_calloc(size_t count, size_t size);
void *__wrap_malloc(size_t size) { return out_of_memory ? NULL : __real_malloc(size); }
void *__wrap_calloc(size_t count, size_t size) { return out_of_memory ? NULL : __real_calloc(count, size); }

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

/* Creates an attachment at random points with three components each. Its last row is outside the tissue. The last attachment is held, the others are free to
   move. */
static void make_thing(thing *t) {
    double root[ROWS][ROWS];
    for (int i = 0; i < ROWS; i++) {
        attached_row *row = &t->rows[i];
        double sum = 0.0;
        row->tet = i + 1 < ROWS ? rand() % body.mesh.tet_count : -1;
        if (i % 3 && i + 1 < ROWS) *row = t->rows[i - 1];
        for (int c = 0; c < 4 && i % 3 == 0; c++) sum += row->weights[c] = cube_random(0.1, 1.0);
        for (int c = 0; c < 4 && i % 3 == 0; c++) row->weights[c] /= sum;
        row->direction = v3_unit(cube_random_vector(1.0));
        for (int j = 0; j < ROWS; j++) root[i][j] = cube_random(-1.0, 1.0);
        for (int k = 0; k < FREE; k++) t->motions[k * ROWS + i] = cube_random(-1.0, 1.0);
    }
    for (int i = 0; i < ROWS; i++)
        for (int j = 0; j < ROWS; j++) {
            t->compliance[i * ROWS + j] = 0.0;
            for (int k = 0; k < ROWS; k++) t->compliance[i * ROWS + j] += 1e-4 * root[i][k] * root[j][k];
        }
}

static attachment attachment_of(int i) {
    return (attachment){.id = (uint64_t)i + 1, .row_count = ROWS, .rows = things[i].rows, .compliance = things[i].compliance, .ld = ROWS,
                        .motion_count = i + 1 < THINGS ? FREE : 0, .motions = things[i].motions, .motion_ld = ROWS};
}

static int create(void **state) {
    (void)state;
    if (cube_create(&body, 0.1, &why) != TROCAR_OK || inverse_create_sparse(&body.tissue, 1e6, &sparse, &why) != TROCAR_OK) return -1;
    for (int i = 0; i < CUBE_NODES; i++) all[i] = i;
    for (int i = 0; i < THINGS; i++) make_thing(&things[i]);
    if (inverse_gather(body.inverse, &(inverse_blocks){CUBE_NODES, all, CUBE_NODES, all, dense, N}, &why) != TROCAR_OK) return -1;
    for (int i = 0; i < N * N; i++) largest = fmax(largest, fabs(dense[i]));
    return 0;
}

static int destroy(void **state) {
    (void)state;
    inverse_free(sparse);
    cube_free(&body);
    return 0;
}

/* Solves A X = B in place. A is n x n and is overwritten; B has `count` columns; both are column-major. */
static void solve(int n, double *a, int count, double *b) {
    lapack_int pivots[N];
    assert_int_equal(LAPACKE_dgesv(LAPACK_COL_MAJOR, n, count, a, n, pivots, b, n), 0);
}

/* Computes S, one attachment's forces under displacements of its rows, column by column from [G -R; R^T 0] [f q] = [d 0]. */
static void stiffness_of(const attachment *t, double s[ROWS][ROWS]) {
    enum { M = ROWS + FREE };
    double system[M * M] = {0}, right[ROWS * M] = {0};
    int n = ROWS + t->motion_count;
    for (int i = 0; i < ROWS; i++) {
        for (int j = 0; j < ROWS; j++) system[j * n + i] = t->compliance[i * ROWS + j];
        for (int k = 0; k < t->motion_count; k++) system[(ROWS + k) * n + i] = system[i * n + ROWS + k] = t->motions[k * ROWS + i];
        right[i * n + i] = 1.0;
    }
    solve(n, system, ROWS, right);
    for (int i = 0; i < ROWS; i++)
        for (int j = 0; j < ROWS; j++) s[i][j] = right[j * n + i];
}

static double row_entry(const attached_row *row, int dof) {
    const double along[] = {row->direction.x, row->direction.y, row->direction.z};
    for (int c = 0; c < 4 && row->tet >= 0; c++) {
        int first = body.tissue.dof[body.mesh.tets[row->tet][c]];
        if (first >= 0 && dof >= first && dof < first + 3) return row->weights[c] * along[dof - first];
    }
    return 0.0;
}

/* Computes (K + P S P^T)^-1, dof_count x dof_count, from scratch. */
static void reference(int count, const int *which, double *inverse_out) {
    int n = body.tissue.dof_count;
    static double k[N * N];
    memset(k, 0, sizeof k);
    const cholmod_sparse *s = body.tissue.stiffness;
    for (int j = 0; j < n; j++)
        for (int p = ((int *)s->p)[j]; p < ((int *)s->p)[j + 1]; p++) k[j * n + ((int *)s->i)[p]] = k[((int *)s->i)[p] * n + j] = ((double *)s->x)[p];
    for (int t = 0; t < count; t++) {
        attachment a = attachment_of(which[t]);
        double stiffness[ROWS][ROWS];
        static double p[ROWS][N];
        stiffness_of(&a, stiffness);
        for (int i = 0; i < ROWS; i++)
            for (int d = 0; d < n; d++) p[i][d] = row_entry(&a.rows[i], d);
        for (int i = 0; i < ROWS; i++)
            for (int j = 0; j < ROWS; j++)
                for (int d = 0; d < n; d++)
                    for (int e = 0; e < n && p[i][d] != 0.0; e++) k[e * n + d] += p[i][d] * stiffness[i][j] * p[j][e];
    }
    for (int i = 0; i < n * n; i++) inverse_out[i] = i % (n + 1) == 0;
    solve(n, k, n, inverse_out);
}

static void attach(inverse *inv, int count, const int *which) {
    attachment list[THINGS] = {0};
    for (int i = 0; i < count; i++) list[i] = attachment_of(which[i]);
    OK(inverse_attach(inv, count, list, &why));
}

static void gather_all(inverse *inv, double *out) { OK(inverse_gather(inv, &(inverse_blocks){CUBE_NODES, all, CUBE_NODES, all, out, N}, &why)); }

static void check_blocks(inverse *base) {
    static double found[N * N], expected[N * N];
    static const int sets[][THINGS] = {{0}, {0, 1, 2}, {2, 0}, {1}};
    static const int counts[] = {1, 3, 2, 1};
    inverse *inv;
    int n = body.tissue.dof_count;
    OK(inverse_create_attached(base, &inv, &why));
    for (int set = 0; set < 4; set++) { /* from one set to the next, some attachments stay but move to other indices */
        double worst = 0.0;
        attach(inv, counts[set], sets[set]);
        reference(counts[set], sets[set], expected);
        gather_all(inv, found);
        for (int i = 0; i < N; i++)
            for (int j = 0; j < N; j++) {
                int row = body.tissue.dof[i / 3], column = body.tissue.dof[j / 3];
                double e = row < 0 || column < 0 ? 0.0 : expected[(size_t)(column + j % 3) * (size_t)n + (size_t)(row + i % 3)];
                worst = fmax(worst, fabs(found[i * N + j] - e));
            }
        print_message("%s, %d attached: %.1e of the largest entry\n", inverse_name(base), counts[set], worst / largest);
        assert_true(worst < 1e-10 * largest);
    }
    inverse_free(inv);
}

static void blocks_are_those_of_the_stiffness_with_the_attachments(void **state) {
    (void)state;
    check_blocks(body.inverse);
    check_blocks(sparse);
}

/* The displacements that inverse_apply gives for nodal forces, together with each attachment's forces and motions, must close the attachment's gaps: G df =
   R q - d, R^T df = 0, where d are the displacements of its rows due to all forces. */
static void forces_and_motions_close_the_gaps(void **state) {
    (void)state;
    static const int set[] = {0, 1, 2};
    enum { LOADS = 7 };
    int nodes[LOADS];
    vec3 force[LOADS], nominal[CUBE_NODES] = {{0, 0, 0}}, u[CUBE_NODES], alone[CUBE_NODES];
    double df[ALL], q[THINGS * FREE];
    inverse *inv;
    OK(inverse_create_attached(body.inverse, &inv, &why));
    attach(inv, THINGS, set);
    assert_int_equal(inverse_attached_rows(inv), ALL);
    assert_int_equal(inverse_attached_motions(inv), 2 * FREE);
    for (int i = 0; i < LOADS; i++) nominal[nodes[i] = 20 + 15 * i] = force[i] = cube_random_vector(1.0);
    OK(inverse_attached_response(inv, &(nodal_forces){LOADS, nodes, force}, df, q, &why));
    out_of_memory = true; /* even when memory runs out, no attachment is left out */
    inverse_apply(inv, nominal, u);
    out_of_memory = false;
    inverse_apply(body.inverse, nominal, alone);
    OK(inverse_attached_displace(inv, df, CUBE_NODES, all, alone, &why)); /* displacements due to the loads and the attachments' forces, computed without
                                                                             attachments */
    double size = 0.0, strength = 0.0;
    for (int i = 0; i < CUBE_NODES; i++) size = fmax(size, v3_norm(u[i]));
    for (int i = 0; i < ALL; i++) strength = fmax(strength, fabs(df[i]));
    for (int i = 0; i < CUBE_NODES; i++) assert_close_vector(alone[i], u[i], 1e-10 * size);
    double d[ALL]; /* displacements of the rows from the compliances of tissue and attachments */
    inverse_attached_yield(inv, df, d);
    OK(inverse_attached_under(inv, &(nodal_forces){LOADS, nodes, force}, d, &why));
    for (int t = 0; t < THINGS; t++) {
        attachment a = attachment_of(t);
        for (int i = 0; i < ROWS; i++) {
            double moved = 0.0;
            for (int k = 0; k < a.motion_count; k++) moved += a.motions[k * ROWS + i] * q[t * FREE + k];
            assert_close(d[t * ROWS + i], moved, 1e-10 * size);
        }
    }
    for (int t = 0; t < THINGS; t++) {
        attachment a = attachment_of(t);
        for (int i = 0; i < ROWS; i++) {
            double gap = 0.0;
            for (int c = 0; c < 4 && a.rows[i].tet >= 0; c++) gap -= a.rows[i].weights[c] * v3_dot(a.rows[i].direction, u[body.mesh.tets[a.rows[i].tet][c]]);
            for (int k = 0; k < a.motion_count; k++) gap += a.motions[k * ROWS + i] * q[t * FREE + k];
            for (int j = 0; j < ROWS; j++) gap -= a.compliance[i * ROWS + j] * df[t * ROWS + j];
            assert_close(gap, 0.0, 1e-10 * size);
        }
        for (int k = 0; k < a.motion_count; k++) {
            double work = 0.0;
            for (int i = 0; i < ROWS; i++) work += a.motions[k * ROWS + i] * df[t * ROWS + i];
            assert_close(work, 0.0, 1e-10 * strength);
        }
    }
    inverse_free(inv);
}

/* A unit displacement of one row, without other loads, opens that row's gap by one and leaves all other gaps closed. */
static void columns_close_the_gaps_but_one(void **state) {
    (void)state;
    static const int set[] = {0, 1, 2}, rows[] = {4, 9, 25};
    double df[3 * ALL], q[3 * 2 * FREE];
    inverse *inv;
    OK(inverse_create_attached(body.inverse, &inv, &why));
    attach(inv, THINGS, set);
    inverse_attached_columns(inv, 3, rows, df, q);
    for (int column = 0; column < 3; column++) {
        vec3 u[CUBE_NODES] = {{0, 0, 0}};
        OK(inverse_attached_displace(inv, df + column * ALL, CUBE_NODES, all, u, &why));
        for (int i = 0; i < ALL; i++) {
            attachment a = attachment_of(i / ROWS);
            int own = i % ROWS;
            double gap = i == rows[column] ? -1.0 : 0.0;
            for (int c = 0; c < 4 && a.rows[own].tet >= 0; c++) gap -= a.rows[own].weights[c] * v3_dot(a.rows[own].direction, u[body.mesh.tets[a.rows[own].tet][c]]);
            for (int k = 0; k < a.motion_count; k++) gap += a.motions[k * ROWS + own] * q[column * 2 * FREE + i / ROWS * FREE + k];
            for (int j = 0; j < ROWS; j++) gap -= a.compliance[own * ROWS + j] * df[column * ALL + i / ROWS * ROWS + j];
            assert_close(gap, 0.0, 1e-9);
        }
    }
    inverse_free(inv);
}

/* Needles are attached and detached in random order. Only the final set matters, and with nothing attached the blocks are bit-identical to those of the base
   inverse. */
static void a_thousand_changes_leave_no_trace(void **state) {
    (void)state;
    static double found[N * N], fresh[N * N], before[N * N];
    static const int last[] = {0, 2};
    inverse *inv, *other;
    gather_all(body.inverse, before);
    OK(inverse_create_attached(body.inverse, &inv, &why));
    OK(inverse_create_attached(body.inverse, &other, &why));
    for (int change = 0; change < 1000; change++) {
        int which[THINGS], count = 0;
        for (int i = 0; i < THINGS; i++)
            if (rand() % 2) which[count++] = i;
        attach(inv, count, which);
    }
    attach(inv, 2, last);
    attach(other, 2, last);
    gather_all(inv, found);
    gather_all(other, fresh);
    assert_memory_equal(found, fresh, sizeof found);
    attach(inv, 0, last);
    gather_all(inv, found);
    assert_memory_equal(found, before, sizeof found);
    gather_all(body.inverse, found);
    assert_memory_equal(found, before, sizeof found);
    inverse_free(inv);
    inverse_free(other);
}

static void what_nothing_holds_is_refused(void **state) {
    (void)state;
    inverse *inv;
    attachment bad = attachment_of(0);
    double motions[FREE * ROWS] = {0};
    bad.motions = motions;
    static double found[N * N];
    OK(inverse_create_attached(body.inverse, &inv, &why));
    assert_int_equal(inverse_attach(inv, 1, &bad, &why), TROCAR_NUMERIC);
    assert_int_equal(inverse_attached_rows(inv), 0);
    gather_all(inv, found);
    assert_memory_equal(found, dense, sizeof found);
    inverse_free(inv);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(blocks_are_those_of_the_stiffness_with_the_attachments),
        cmocka_unit_test(forces_and_motions_close_the_gaps),
        cmocka_unit_test(columns_close_the_gaps_but_one),
        cmocka_unit_test(a_thousand_changes_leave_no_trace),
        cmocka_unit_test(what_nothing_holds_is_refused),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}

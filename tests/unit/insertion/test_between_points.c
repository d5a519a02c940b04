/* Compares the compliance between contact points, entry by entry, with P N P^T + R^T C R plus the compliance of the mount. */
#include "bending.h"
#include "insertion/contact/between_points.h"
#include "insertion/guide/guides.h"
#include "linalg/between_kernels.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>

#include <cmocka.h>

enum { SEGMENTS = 40 };

static needle_model needle;
static insertion_model model = {.needle = &needle};
static needle_state shape;
static insertion_workspace w;
static compliance_snapshot snapshot;
static needle_tangent whole;      /* compliance between all joints of the needle */
static const double MOUNT = 2e-4; /* m/N */

static double draw(void) { return (double)rand() / RAND_MAX - 0.5; }

static mat3 draw_block(void) {
    mat3 m;
    for (int a = 0; a < 9; a++) m.m[a / 3][a % 3] = 1e-3 * draw();
    return m;
}

/* Creates a loaded, bent needle. */
static int create(void **unused) {
    (void)unused;
    vec3 load[NEEDLE_MAX_SEGMENTS + 1] = {{0}};
    needle = needle_made(SEGMENTS);
    needle_set_straight(&needle, (pose){v3(0.1, -0.2, 0.3), q_exp(v3(0.3, -0.4, 0.5))}, &shape);
    load[SEGMENTS] = v3(0.1, 0.25, -0.1);
    load[22] = v3(-0.2, 0.2, 0.3);
    for (int i = 0; i < 6; i++) {
        needle_linearise(&needle, &shape, load, 0, &whole);
        needle_advance(&needle, &whole, load, &shape);
    }
    needle_linearise(&needle, &shape, load, 0, &whole);
    w.response.tangent = whole;
    srand(1);
    for (int i = 0; i < MAX_CONTACTS; i++)
        for (int j = i; j < MAX_CONTACTS; j++)
            for (int a = 0; a < 9; a++) snapshot.between_contacts[i].at[a / 3][a % 3][j] = 1e-3 * draw();
    for (int i = 0; i < MAX_CONTACTS; i++) /* makes each point's diagonal block symmetric */
        for (int a = 0; a < 9; a++) snapshot.between_contacts[i].at[a % 3][a / 3][i] = snapshot.between_contacts[i].at[a / 3][a % 3][i];
    return 0;
}

static mat3 tissue_between(int i, int j) {
    if (w.points.list[i].kind == POINT_TIP) return w.tissue.tip_row[j];
    if (w.points.list[j].kind == POINT_TIP) return m3_transposed(&w.tissue.tip_row[i]);
    if (i < w.points.guided || j < w.points.guided) return (mat3){{{0}}};
    return m3_scaled(w.creep.yield, compliance_between(&snapshot, w.points.list[i].handle, w.points.list[j].handle));
}

/* Returns the compliance N between joints, expanded from the stored triangle. */
static double between_joints(int row, int column) { return row / 3 <= column / 3 ? whole.compliance[row][column] : whole.compliance[column][row]; }

static mat3 expected(int i, int j) {
    const needle_point *p = &w.points.list[i].at, *q = &w.points.list[j].at;
    mat3 sum = tissue_between(i, j), turned;
    if (guides_is_open(&w.points, w.edges, i) || guides_is_open(&w.points, w.edges, j)) return (mat3){{{0}}};
    for (int a = 0; a < 9; a++) {
        sum.m[a / 3][a % 3] += a % 4 == 0 ? MOUNT : 0.0;
        for (int k = 0; k < 9; k++) sum.m[a / 3][a % 3] += p->weights[k / 3] * q->weights[k % 3] * between_joints(3 * (p->first + k / 3) + a / 3, 3 * (q->first + k % 3) + a % 3);
    }
    mat3 transposed = m3_transposed(&p->frame);
    turned = m3_multiply(&sum, &q->frame);
    return m3_multiply(&transposed, &turned);
}

/* Places contact points every 3 mm, from base to tip. */
static void set_points(int guided, int contacts, bool tip) {
    w.points.guided = guided;
    w.points.tip = tip;
    w.points.count = guided + contacts + tip;
    w.creep.yield = 0.9;
    for (int i = 0; i < w.points.count; i++) {
        bool last = tip && i == w.points.count - 1;
        w.points.list[i].kind = i < guided ? POINT_GUIDE : last ? POINT_TIP : POINT_TISSUE;
        w.points.list[i].handle = last ? NO_HANDLE : i - guided;
        w.points.list[i].at = needle_at(&needle, &shape, needle.given.length - 3e-3 * (w.points.count - 1 - i));
        w.edges[i % MAX_GUIDE_POINTS].touched = i % 2;
        w.tissue.tip_row[i] = draw_block();
    }
    mat3 *own = &w.tissue.tip_row[w.points.count - 1], other = m3_transposed(own);
    m3_add_scaled(own, 1.0, &other);
}

static void check_blocks(void) {
    contact_problem *p = &w.problem;
    tick_input tick = {.model = &model, .snapshot = &snapshot, .base = {.compliance = MOUNT}};
    p->count = w.points.count;
    int columns = 3 * p->count;
    for (int i = 0; i < columns; i++)
        for (int j = 0; j < columns; j++) p->compliance[i][j] = NAN;
    assemble_between_points(&tick, &w);
    for (int i = 0; i < p->count; i++)
        for (int j = i; j < p->count; j++) {
            mat3 block = expected(i, j);
            for (int a = 0; a < 9; a++) {
                int row = unknown(p->count, i, a / 3), column = unknown(p->count, j, a % 3);
                double found = row <= column ? p->compliance[row][column] : p->compliance[column][row];
                assert_true(fabs(found - block.m[a / 3][a % 3]) < 1e-13);
            }
        }
}

static void blocks_follow_the_formula(void **unused) {
    (void)unused;
    for (int contacts = 0; contacts <= 40; contacts += contacts < 8 ? 1 : 13)
        for (int tip = contacts == 0; tip < 2; tip++) {
            set_points(0, contacts, tip);
            check_blocks();
        }
}

static void slots_may_be_in_any_order(void **unused) {
    (void)unused;
    set_points(0, 21, true);
    for (int i = 0; i < 21; i++) w.points.list[i].handle = 8 * i % 21;
    check_blocks();
    set_points(0, 21, true);
    for (int i = 5; i < 21; i++) w.points.list[i].handle += 4; /* a gap */
    check_blocks();
}

/* One contact has been dragged past the others, all the way to the base. */
static void points_may_be_in_any_order(void **unused) {
    (void)unused;
    set_points(0, 14, true);
    w.points.list[1].at = needle_at(&needle, &shape, 0.0);
    w.points.list[9].at = needle_at(&needle, &shape, 0.1);
    check_blocks();
}

/* Contact points at guides come first in the list, wherever they are along the needle. Points without contact are not coupled. */
static void guides_are_coupled_where_they_touch(void **unused) {
    (void)unused;
    static const int guides[] = {1, 2, 3, 4, 7, 16}, contacts[] = {0, 1, 3, 6, 9, 20, 64};
    for (int g = 0; g < 6; g++)
        for (int c = 0; c < 7; c++) {
            set_points(guides[g], contacts[c], contacts[c] > 0);
            check_blocks();
            w.points.list[guides[g] - 1].at = needle_at(&needle, &shape, 0.19); /* among the contacts */
            check_blocks();
        }
}

/* Both kernels give bit-identical rows, whichever point they start at. The tissue's compliance at the tip is passed separately. */
static void wide_vectors_give_the_same_bits(void **unused) {
    (void)unused;
    if (between_kernel_here() == between_portable) skip(); /* no wide-vector kernel for this processor */
    static _Alignas(CACHE_LINE) between_components needle_rows[3 * NEEDLE_POINT_JOINTS];
    static _Alignas(CACHE_LINE) double tissue[3][3][BETWEEN_PLACES];
    static _Alignas(CACHE_LINE) between_rows frames, portable, widest;
    for (int l = 0; l < BETWEEN_PLACES; l++)
        for (int a = 0; a < 9; a++) {
            for (int m = 0; m < NEEDLE_POINT_JOINTS; m++) needle_rows[3 * m + a / 3][a % 3][l] = draw();
            tissue[a / 3][a % 3][l] = l < 40 ? draw() : NAN; /* the tip's entry is left unset, because `at_tip` is used instead */
            frames[a / 3][a % 3][l] = draw();
        }
    set_points(0, 40, true);
    for (int begin = 0; begin < 41; begin++)
        for (int lowest = 0; lowest < 3 && lowest <= begin; lowest++) {
            between_points_row row = {.lowest = lowest, .begin = begin, .end = 41, .frame = &w.points.list[begin].at.frame, .weights = w.points.list[begin].at.weights, .needle = (const between_components *)needle_rows,
                                      .tip_place = 40, .at_tip = draw_block(), .yield = 0.9, .mount = MOUNT, .frames = (const between_rows *)&frames};
            for (int a = 0; a < 9; a++) row.tissue[a / 3][a % 3] = tissue[a / 3][a % 3];
            between_portable(&row, portable);
            between_kernel_here()(&row, widest);
            for (int a = 0; a < 9; a++) {
                size_t bytes = (size_t)(41 - begin) * sizeof(double);
                assert_memory_equal(&portable[a / 3][a % 3][begin], &widest[a / 3][a % 3][begin], bytes);
                assert_true(isfinite(portable[a / 3][a % 3][40]));
            }
        }
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(blocks_follow_the_formula),
        cmocka_unit_test(slots_may_be_in_any_order),
        cmocka_unit_test(points_may_be_in_any_order),
        cmocka_unit_test(guides_are_coupled_where_they_touch),
        cmocka_unit_test(wide_vectors_give_the_same_bits),
    };
    return cmocka_run_group_tests(tests, create, NULL);
}

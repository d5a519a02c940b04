/* Compares half-solves with the dense inverse. Every block is a product of half-solves, whichever nodes are eliminated last. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include "cube.h"
#include "inverse/sparse_inverse_columns.h"

#include <cmocka.h>

#include "check.h"

enum { N = 3 * CUBE_NODES, LAST = 20 };
static cube body;
static double all_blocks[N * N], largest;

static int create(void **state) {
    (void)state;
    trocar_error why;
    int all[CUBE_NODES];
    for (int i = 0; i < CUBE_NODES; i++) all[i] = i;
    if (cube_create(&body, 0.1, &why) != TROCAR_OK) return -1;
    assert_int_equal(inverse_gather(body.inverse, &(inverse_blocks){CUBE_NODES, all, CUBE_NODES, all, all_blocks, N}, &why), TROCAR_OK);
    for (int i = 0; i < N * N; i++) largest = fmax(largest, fabs(all_blocks[i]));
    return 0;
}

static int destroy(void **state) {
    (void)state;
    cube_free(&body);
    return 0;
}

/* Assembles and factorises the matrix. The `last_count` nodes from node 40 on, if any, are eliminated last. */
static void assemble_and_factor(int last_count, tissue *t) {
    trocar_error why;
    int last[LAST];
    for (int i = 0; i < LAST; i++) last[i] = 40 + i;
    assert_int_equal(tissue_assemble(&body.mesh, body.materials, body.fixed, STRAIN_BY_ELEMENT, t, &why), TROCAR_OK);
    assert_int_equal(tissue_factor(t, last_count, last, &why), TROCAR_OK);
}

/* Checks all pairs of free nodes, in random order, in blocks of every size from 1 to PRODUCT_BLOCK. */
static void check_products(const tissue *t) {
    trocar_error why;
    sparse_columns *h;
    assert_int_equal(sparse_columns_create(t, &h, &why), TROCAR_OK);
    int nodes[CUBE_NODES], dofs[CUBE_NODES], count = 0;
    double *y[CUBE_NODES];
    for (int k = 0; k < CUBE_NODES; k++) {
        int node = k * 47 % CUBE_NODES;
        if (t->dof[node] < 0) continue;
        nodes[count] = node;
        dofs[count] = t->dof[node];
        y[count] = malloc((size_t)sparse_columns_length(h, dofs[count]) * sizeof(double[3]));
        count++;
    }
    for (int i = 0; i < count; i += HALF_BLOCK) sparse_columns_half_solve(h, count - i < HALF_BLOCK ? count - i : HALF_BLOCK, dofs + i, y + i);
    enum { LD = 3 * PRODUCT_BLOCK + 5 };
    static double block[3 * PRODUCT_BLOCK * LD];
    for (int i = 0, rows = 1; i < count; i += rows, rows = rows % PRODUCT_BLOCK + 9) {
        if (rows > PRODUCT_BLOCK) rows = PRODUCT_BLOCK;
        if (rows > count - i) rows = count - i;
        for (int j = 0; j < count; j += PRODUCT_BLOCK) {
            int columns = count - j < PRODUCT_BLOCK ? count - j : PRODUCT_BLOCK;
            sparse_columns_product(h, &(half_solved){rows, dofs + i, (const double *const *)y + i}, &(half_solved){columns, dofs + j, (const double *const *)y + j}, block, LD);
            for (int r = 0; r < 3 * rows; r++)
                for (int c = 0; c < 3 * columns; c++)
                    assert_close(block[r * LD + c], all_blocks[(3 * nodes[i + r / 3] + r % 3) * N + 3 * nodes[j + c / 3] + c % 3], 1e-12 * largest);
        }
    }
    for (int i = 0; i < count; i++) free(y[i]);
    sparse_columns_free(h);
}

static void products_are_blocks_of_the_inverse(void **state) {
    (void)state;
    tissue t;
    assemble_and_factor(0, &t);
    check_products(&t);
    tissue_free(&t);
}

static void products_do_not_depend_on_the_elimination_order(void **state) {
    (void)state;
    tissue t;
    assemble_and_factor(LAST, &t);
    check_products(&t);
    tissue_free(&t);
}

static void paths_of_nodes_eliminated_last_are_short(void **state) {
    (void)state;
    tissue t;
    sparse_columns *h;
    trocar_error why;
    assemble_and_factor(LAST, &t);
    assert_int_equal(sparse_columns_create(&t, &h, &why), TROCAR_OK);
    for (int i = 0; i < LAST; i++) assert_true(sparse_columns_length(h, t.dof[40 + i]) <= 3 * LAST);
    assert_true(sparse_columns_longest(h) > 3 * LAST && sparse_columns_longest(h) <= t.dof_count);
    sparse_columns_free(h);
    tissue_free(&t);
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(products_are_blocks_of_the_inverse),
        cmocka_unit_test(products_do_not_depend_on_the_elimination_order),
        cmocka_unit_test(paths_of_nodes_eliminated_last_are_short),
    };
    return cmocka_run_group_tests(tests, create, destroy);
}

/* The region's stiffness once all other nodes are eliminated, against the inverse of the whole matrix by LAPACK. */
#include <lapacke.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "inverse/substructure.h"

#include <cmocka.h>

#include "check.h"

enum { CELLS = 8, SIDE = CELLS + 1, BOX = SIDE * SIDE * SIDE }; /* of a box; the dissection cuts it several times */
static const region_material materials[2] = {{.youngs_modulus = 15e3, .poisson_ratio = 0.45}, {.youngs_modulus = 60e3, .poisson_ratio = 0.3}};

/* One or two boxes side by side that do not touch, Kuhn's six tets per cell; soft below, stiff above. */
static mesh boxes(int count) {
    static const int orders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    int per_box = 6 * CELLS * CELLS * CELLS;
    report why;
    mesh m = {.node_count = count * BOX, .tet_count = count * per_box, .group_count = 2};
    m.nodes = malloc((size_t)m.node_count * sizeof *m.nodes);
    m.tets = malloc((size_t)m.tet_count * sizeof *m.tets);
    m.region = malloc((size_t)m.tet_count * sizeof *m.region);
    for (int g = 0; g < 2; g++) m.groups[g] = (mesh_group){.name = {(char)('a' + g)}, .dimension = 3};
    for (int n = 0; n < m.node_count; n++)
        m.nodes[n] = v3(0.01 * (n % SIDE) + 0.1 * (n / BOX), 0.01 * (n / SIDE % SIDE), 0.01 * (n % BOX / SIDE / SIDE));
    for (int t = 0; t < m.tet_count; t++) {
        int cell = t % per_box / 6, at[3] = {cell % CELLS, cell / CELLS % CELLS, cell / CELLS / CELLS};
        m.region[t] = 2 * at[2] < CELLS ? 0 : 1;
        for (int corner = 0; corner < 4; corner++) {
            m.tets[t][corner] = at[0] + SIDE * (at[1] + SIDE * at[2]) + t / per_box * BOX;
            if (corner < 3) at[orders[t % 6][corner]]++;
        }
    }
    assert_int_equal(mesh_finish(&m, 0, NULL, NULL, "boxes", &why), TROCAR_OK);
    return m;
}

/* K^-1, dof_count square. */
static double *whole_inverse(const tissue *t) {
    int n = t->dof_count;
    const int *start = t->stiffness->p, *row = t->stiffness->i;
    const double *value = t->stiffness->x;
    double *a = calloc((size_t)n * (size_t)n, sizeof *a);
    for (int j = 0; j < n; j++)
        for (int k = start[j]; k < start[j + 1]; k++) a[(size_t)j * (size_t)n + (size_t)row[k]] += value[k];
    assert_int_equal(LAPACKE_dpotrf(LAPACK_COL_MAJOR, 'L', n, a, n), 0);
    assert_int_equal(LAPACKE_dpotri(LAPACK_COL_MAJOR, 'L', n, a, n), 0);
    return a;
}

/* (L L^T)^-1, lower triangle. */
static double *corner_inverse(const panels *corner, int n) {
    double *a = calloc((size_t)n * (size_t)n, sizeof *a);
    for (int k = 0; k < corner->count; k++)
        for (int c = 0; c < corner->panels[k].width; c++)
            for (int r = c; r < corner->panels[k].rows; r++)
                a[(corner->panels[k].first + c) * n + corner->panels[k].first + r] = ((double *)corner->panels[k].values)[c * corner->panels[k].rows + r];
    assert_int_equal(LAPACKE_dpotri(LAPACK_COL_MAJOR, 'L', n, a, n), 0);
    return a;
}

static double last_fraction;
static void note(const char *what, double fraction, void *context) {
    (void)what;
    (void)context;
    assert_true(fraction >= last_fraction);
    last_fraction = fraction;
}

static void check(const mesh *m, const bool *fixed, volumetric_strain strain, int count, const int *region) {
    tissue t;
    substructure s;
    panels corner;
    report why;
    int *nodes = malloc(((size_t)count + 1) * sizeof *nodes), free_nodes = 0;
    assert_int_equal(tissue_assemble(m, materials, fixed, strain, &t, &why), TROCAR_OK);
    for (int i = 0; i < count; i++) free_nodes += !fixed[region[i]];
    assert_int_equal(substructure_plan(&t, count, region, nodes, &s, &why), TROCAR_OK);
    assert_int_equal(s.region_count, free_nodes);
    last_fraction = 0.0;
    assert_int_equal(substructure_eliminate(&s, &corner, (inverse_progress){note, NULL}, &why), TROCAR_OK);
    assert_true(last_fraction == 1.0);
    double *expected = whole_inverse(&t), *found = corner_inverse(&corner, 3 * free_nodes);
    for (int j = 0; j < 3 * free_nodes; j++)
        for (int i = j; i < 3 * free_nodes; i++) {
            int row = t.dof[nodes[i / 3]] + i % 3, column = t.dof[nodes[j / 3]] + j % 3, least = row < column ? row : column;
            double size = sqrt(expected[row * t.dof_count + row] * expected[column * t.dof_count + column]);
            assert_close(found[j * 3 * free_nodes + i], expected[least * t.dof_count + (row + column - least)], 1e-12 * size); /* 1e-15 observed */
        }
    free(expected);
    free(found);
    free(nodes);
    panels_free(&corner);
    substructure_free(&s);
    tissue_free(&t);
}

static void fix_bottom(const mesh *m, bool *fixed) {
    for (int n = 0; n < m->node_count; n++) fixed[n] = m->nodes[n].z < 0.005;
}

static bool in_column(const mesh *m, int n, int box) {
    return n / BOX == box && fabs(m->nodes[n].x - 0.1 * box - 0.04) < 0.015 && fabs(m->nodes[n].y - 0.04) < 0.015;
}

/* A column through the body, from its fixed face up; single nodes; two pieces; one node; all nodes. */
static void regions_agree_with_the_whole_inverse(void **state) {
    (void)state;
    static bool fixed[BOX];
    static int regions[5][BOX], counts[5];
    mesh m = boxes(1);
    fix_bottom(&m, fixed);
    for (int n = 0; n < BOX; n++) {
        if (in_column(&m, n, 0)) regions[0][counts[0]++] = n;
        if (n % 7 == 0) regions[1][counts[1]++] = n;
        if (n / SIDE % SIDE == 1 || n % SIDE == CELLS) regions[2][counts[2]++] = n;
        if (n == BOX / 2) regions[3][counts[3]++] = n;
        regions[4][counts[4]++] = n;
    }
    for (int i = 0; i < 5; i++) check(&m, fixed, STRAIN_BY_PATCH, counts[i], regions[i]);
    check(&m, fixed, STRAIN_BY_ELEMENT, counts[0], regions[0]);
    check(&m, fixed, STRAIN_BY_NODE, counts[0], regions[0]);
    mesh_free(&m);
}

/* The other body has no part in the region, whichever of them is eliminated first; or each has one. */
static void bodies_may_be_apart(void **state) {
    (void)state;
    static bool fixed[2 * BOX];
    static int region[2 * BOX];
    mesh m = boxes(2);
    fix_bottom(&m, fixed);
    for (int choice = 0; choice < 3; choice++) {
        int count = 0;
        for (int n = 0; n < 2 * BOX; n++)
            if ((choice != 1 && in_column(&m, n, 0)) || (choice != 0 && in_column(&m, n, 1))) region[count++] = n;
        check(&m, fixed, STRAIN_BY_PATCH, count, region);
    }
    mesh_free(&m);
}

/* A body that nothing holds, or that can turn about two nodes, with the region in it or elsewhere. */
static void loose_body_is_refused(void **state) {
    (void)state;
    static int region[BOX];
    mesh m = boxes(2);
    for (int hinged = 0; hinged < 2; hinged++)
        for (int box = 0; box < 2; box++) {
            static bool fixed[2 * BOX];
            int nodes[BOX], count = 0;
            tissue t;
            substructure s;
            panels corner;
            report why = {""};
            fix_bottom(&m, fixed);
            for (int n = BOX; n < 2 * BOX; n++) fixed[n] = hinged && (n == BOX || n == BOX + CELLS);
            for (int n = box * BOX; n < (box + 1) * BOX; n++)
                if (in_column(&m, n, box)) region[count++] = n;
            assert_int_equal(tissue_assemble(&m, materials, fixed, STRAIN_BY_PATCH, &t, &why), TROCAR_OK);
            assert_int_equal(substructure_plan(&t, count, region, nodes, &s, &why), TROCAR_OK);
            assert_int_equal(substructure_eliminate(&s, &corner, (inverse_progress){NULL, NULL}, &why), TROCAR_BAD_INPUT);
            assert_non_null(strstr(why.text, "do not constrain the whole body"));
            assert_int_equal(corner.count, 0);
            substructure_free(&s);
            tissue_free(&t);
        }
    mesh_free(&m);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(regions_agree_with_the_whole_inverse),
        cmocka_unit_test(bodies_may_be_apart),
        cmocka_unit_test(loose_body_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

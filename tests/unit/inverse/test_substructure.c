/* Compares the region's stiffness after eliminating all other nodes with LAPACK's inverse of the whole matrix and, on a larger mesh with fronts of several
   panels, with CHOLMOD's factor. Also compares the memory estimate with what malloc reports. */
#include <cblas.h>
#include <lapacke.h>
#include <malloc.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "condensed/condensation.h"
#include "condensed/substructure.h"

#include <cmocka.h>

#include "check.h"

enum { CELLS = 8, SIDE = CELLS + 1, BOX = SIDE * SIDE * SIDE }; /* cells along an edge of the box, enough for the dissection to divide it several times */
static const region_material materials[2] = {{.youngs_modulus = 15e3, .poisson_ratio = 0.45}, {.youngs_modulus = 60e3, .poisson_ratio = 0.3}};

typedef struct {
    int cells;               /* cells along each edge */
    vec3 corner, spacing;
    quat turn;
} box;

static int cubed(int n) { return n * n * n; }

/* Creates a mesh of boxes that do not touch, with Kuhn's six tetrahedra per cell. The lower part is soft, the upper part stiff. */
static mesh mesh_of(int count, const box *boxes) {
    static const int orders[6][3] = {{0, 1, 2}, {1, 2, 0}, {2, 0, 1}, {0, 2, 1}, {2, 1, 0}, {1, 0, 2}};
    trocar_error why;
    mesh m = {.group_count = 2};
    for (int b = 0; b < count; b++) {
        m.node_count += cubed(boxes[b].cells + 1);
        m.tet_count += 6 * cubed(boxes[b].cells);
    }
    m.nodes = malloc((size_t)m.node_count * sizeof *m.nodes);
    m.tets = malloc((size_t)m.tet_count * sizeof *m.tets);
    m.region = malloc((size_t)m.tet_count * sizeof *m.region);
    for (int g = 0; g < 2; g++) m.groups[g] = (mesh_group){.name = {(char)('a' + g)}, .dimension = 3};
    for (int b = 0, node = 0, tet = 0; b < count; b++) {
        int cells = boxes[b].cells, side = cells + 1, first = node;
        vec3 spacing = boxes[b].spacing;
        for (int n = 0; n < cubed(side); n++) {
            vec3 at = v3(spacing.x * (n % side), spacing.y * (n / side % side), spacing.z * (n / side / side));
            m.nodes[node++] = v3_add(boxes[b].corner, q_rotate(boxes[b].turn, at));
        }
        for (int t = 0; t < 6 * cubed(cells); t++, tet++) {
            int cell = t / 6, at[3] = {cell % cells, cell / cells % cells, cell / cells / cells};
            m.region[tet] = 2 * at[2] < cells ? 0 : 1;
            for (int corner = 0; corner < 4; corner++) {
                m.tets[tet][corner] = first + at[0] + side * (at[1] + side * at[2]);
                if (corner < 3) at[orders[t % 6][corner]]++;
            }
        }
    }
    assert_int_equal(mesh_finish(&m, 0, NULL, NULL, "boxes", &why), TROCAR_OK);
    return m;
}

static box upright(int cells, double x) { return (box){cells, v3(x, 0.0, 0.0), v3(0.01, 0.01, 0.01), q_exp(v3(0.0, 0.0, 0.0))}; }

/* Creates one box, or two side by side. */
static mesh boxes(int count) { return mesh_of(count, (box[]){upright(CELLS, 0.0), upright(CELLS, 0.1)}); }

/* Returns K^-1, dof_count x dof_count. */
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

/* Returns the lower triangle of (L L^T)^-1. */
static double *corner_inverse(const panels *corner, int n) {
    double *a = calloc((size_t)n * (size_t)n, sizeof *a);
    for (int k = 0; k < corner->count; k++)
        for (int c = 0; c < corner->panels[k].width; c++)
            for (int r = c; r < corner->panels[k].rows; r++)
                a[(size_t)(corner->panels[k].first + c) * (size_t)n + (size_t)(corner->panels[k].first + r)] = ((double *)corner->panels[k].values)[c * corner->panels[k].rows + r];
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
    trocar_error why;
    int *nodes = malloc(((size_t)count + 1) * sizeof *nodes), free_nodes = 0;
    assert_int_equal(tissue_assemble(m, materials, fixed, strain, &t, &why), TROCAR_OK);
    for (int i = 0; i < count; i++) free_nodes += !fixed[region[i]];
    assert_int_equal(substructure_plan(&t, NULL, count, region, nodes, &s, &why), TROCAR_OK);
    assert_int_equal(s.region_count, free_nodes);
    last_fraction = 0.0;
    assert_int_equal(substructure_eliminate(&s, &corner, (inverse_progress){.show = note}, &why), TROCAR_OK);
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

/* Tests these regions: a column through the body that starts at its fixed face, scattered nodes, two separate pieces, a single node, and all nodes. */
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

/* With two bodies, the region has nodes of only one, whichever body is eliminated first, or of both. */
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

/* Tests a body that is not fixed or can rotate about two nodes, with the region inside it or in another body. */
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
            trocar_error why = {""};
            fix_bottom(&m, fixed);
            for (int n = BOX; n < 2 * BOX; n++) fixed[n] = hinged && (n == BOX || n == BOX + CELLS);
            for (int n = box * BOX; n < (box + 1) * BOX; n++)
                if (in_column(&m, n, box)) region[count++] = n;
            assert_int_equal(tissue_assemble(&m, materials, fixed, STRAIN_BY_PATCH, &t, &why), TROCAR_OK);
            assert_int_equal(substructure_plan(&t, NULL, count, region, nodes, &s, &why), TROCAR_OK);
            assert_int_equal(substructure_eliminate(&s, &corner, (inverse_progress){0}, &why), TROCAR_BAD_INPUT);
            assert_non_null(strstr(why.text, "do not constrain the whole body"));
            assert_int_equal(corner.count, 0);
            substructure_free(&s);
            tissue_free(&t);
        }
    mesh_free(&m);
}

/* Returns a random number below `below` from a generator that no library touches (METIS calls srand). */
static unsigned any(unsigned below) {
    static unsigned long long state = 1;
    state = state * 6364136223846793005ULL + 1442695040888963407ULL;
    return (unsigned)(state >> 33) % below;
}

/* Tests a body of about ten nodes next to one of thousands. The small body lies inside or outside the region, and can rotate about an arbitrary axis through
   two fixed nodes. */
static void small_loose_piece_is_refused(void **state) {
    (void)state;
    enum { LARGE = 12, BESIDE = (LARGE + 1) * (LARGE + 1) * (LARGE + 1), MOST = BESIDE + 27, TRIALS = 10 };
    for (int trial = 0; trial < 4 * TRIALS; trial++) {
        static bool fixed[MOST];
        static int region[MOST], nodes[MOST];
        unsigned cells = 1 + (unsigned)trial % 2, few = (unsigned)cubed((int)cells + 1);
        unsigned hinge = any(few), other = (hinge + 1 + any(few - 1)) % few;
        quat turn = q_exp(v3(0.01 * any(600) - 3.0, 0.01 * any(600) - 3.0, 0.01 * any(200) - 1.0));
        mesh m = mesh_of(2, (box[]){upright(LARGE, 0.0), {(int)cells, v3(-0.1, 0.0, 0.05), v3(0.0093, 0.0107, 0.0101), turn}});
        int count = 0;
        tissue t;
        substructure s;
        panels corner;
        trocar_error why = {""};
        for (int n = 0; n < m.node_count; n++) {
            fixed[n] = n < BESIDE ? m.nodes[n].z < 0.005 : n - BESIDE == (int)hinge || n - BESIDE == (int)other;
            bool inside = n < BESIDE ? fabs(m.nodes[n].x - 0.06) < 0.015 && fabs(m.nodes[n].y - 0.06) < 0.015 : trial >= 2 * TRIALS;
            if (inside) region[count++] = n;
        }
        assert_int_equal(tissue_assemble(&m, materials, fixed, STRAIN_BY_PATCH, &t, &why), TROCAR_OK);
        assert_int_equal(substructure_plan(&t, NULL, count, region, nodes, &s, &why), TROCAR_OK);
        assert_int_equal(substructure_eliminate(&s, &corner, (inverse_progress){0}, &why), TROCAR_BAD_INPUT);
        substructure_free(&s);
        tissue_free(&t);
        mesh_free(&m);
    }
}

/* ---- memory ---- */

static double most_used;
static void note_memory(const char *what, double fraction, void *context) {
    (void)what;
    (void)fraction;
    (void)context;
    struct mallinfo2 now = mallinfo2();
    most_used = fmax(most_used, (double)now.uordblks + (double)now.hblkhd);
}

/* Starts counting, and returns the memory currently in use. */
static double begin_counting(void) {
    most_used = 0.0;
    note_memory("", 0.0, NULL);
    return most_used;
}

/* Checks that the prediction covers the memory used and exceeds it by at most half. Does nothing under sanitizers, which replace malloc. */
static void assert_predicted(double predicted, double used) {
    if (mallinfo2().uordblks == 0) return;
    assert_true(predicted >= used);
    assert_true(predicted <= 1.5 * used);
}

static bool has_front_of_several_panels(const substructure *s) {
    const int *super = s->symbolic->super;
    for (int f = 0; f < (int)s->symbolic->nsuper; f++) {
        int pivots = 0;
        for (int place = super[f]; place < super[f + 1]; place++) pivots += s->region[place] < 0;
        if (3 * pivots > PANEL_WIDTH) return true;
    }
    return false;
}

static int empty_blocks(const substructure *s) {
    int count = (3 * s->region_count + PANEL_WIDTH - 1) / PANEL_WIDTH, empty = 0;
    for (int i = 0; i < count; i++)
        for (int j = 0; j <= i; j++) empty += !s->filled[i * count + j];
    return empty;
}

static void assert_same_bits(const panels *a, const panels *b) {
    assert_int_equal(a->count, b->count);
    for (int k = 0; k < a->count; k++)
        assert_memory_equal(a->panels[k].values, b->panels[k].values, (size_t)a->panels[k].rows * (size_t)a->panels[k].width * sizeof(double));
}

/* Computes a column of K^-1_RR from CHOLMOD's factor of the whole matrix. */
static double *column_by_factor(tissue *t, const int *nodes, int count, size_t column) {
    double *values = malloc(3 * (size_t)count * sizeof *values);
    cholmod_dense *load = cholmod_zeros((size_t)t->dof_count, 1, CHOLMOD_REAL, &t->common);
    assert_non_null(values);
    ((double *)load->x)[(size_t)t->dof[nodes[column / 3]] + column % 3] = 1.0;
    cholmod_dense *solution = cholmod_solve(CHOLMOD_A, t->factor, load, &t->common);
    for (size_t row = 0; row < 3 * (size_t)count; row++) values[row] = ((double *)solution->x)[(size_t)t->dof[nodes[row / 3]] + row % 3];
    cholmod_free_dense(&load, &t->common);
    cholmod_free_dense(&solution, &t->common);
    return values;
}

/* Tests a narrow region, whose triangle is full, and one wide enough to have inner nodes, each with and without a team of threads. */
static void large_fronts_agree_with_the_factor(void **state) {
    (void)state;
    enum { LARGE = 16, ALL = (LARGE + 1) * (LARGE + 1) * (LARGE + 1), COLUMNS = 5 };
    static bool fixed[ALL];
    static int region[ALL], nodes[ALL];
    tissue t;
    trocar_error why;
    mesh m = mesh_of(1, (box[]){upright(LARGE, 0.0)});
    fix_bottom(&m, fixed);
    assert_int_equal(tissue_assemble(&m, materials, fixed, STRAIN_BY_PATCH, &t, &why), TROCAR_OK);
    team *two = team_create(2);
    assert_non_null(two);
    for (int wide = 0; wide < 2; wide++) {
        substructure s;
        panels corner, alone;
        int count = 0;
        double reach = wide ? 0.045 : 0.025;
        for (int n = 0; n < ALL; n++)
            if (!fixed[n] && fabs(m.nodes[n].x - 0.08) < reach && fabs(m.nodes[n].y - 0.08) < reach) region[count++] = n;
        assert_int_equal(substructure_plan(&t, two, count, region, nodes, &s, &why), TROCAR_OK);
        assert_true(has_front_of_several_panels(&s));
        assert_true((empty_blocks(&s) > 0) == wide);
        double before = begin_counting();
        assert_int_equal(substructure_eliminate(&s, &corner, (inverse_progress){.show = note_memory}, &why), TROCAR_OK);
        assert_predicted(s.bytes, most_used - before);
        assert_true(corner.count > 1);
        s.team = NULL;
        assert_int_equal(substructure_eliminate(&s, &alone, (inverse_progress){0}, &why), TROCAR_OK);
        assert_same_bits(&corner, &alone);
        panels_free(&alone);
        if (!t.factor) assert_int_equal(tissue_factor(&t, 0, NULL, &why), TROCAR_OK);
        size_t size = 3 * (size_t)count;
        double *found = corner_inverse(&corner, (int)size);
        for (size_t i = 0; i < COLUMNS; i++) {
            size_t column = i * (size - 1) / (COLUMNS - 1);
            double *expected = column_by_factor(&t, nodes, count, column);
            for (size_t row = 0; row < size; row++) {
                size_t higher = row > column ? row : column, lower = row > column ? column : row;
                assert_close(found[lower * size + higher], expected[row], 1e-11 * expected[column]);
            }
            free(expected);
        }
        free(found);
        panels_free(&corner);
        substructure_free(&s);
    }
    team_free(two);
    tissue_free(&t);
    mesh_free(&m);
}

/* Tests several panels with empty blocks in between, in single and double precision, with one thread and with two. */
static void inverse_of_a_wide_region_agrees_with_the_factor(void **state) {
    (void)state;
    enum { LARGE = 16, ALL = (LARGE + 1) * (LARGE + 1) * (LARGE + 1), COLUMNS = 7 };
    static bool fixed[ALL];
    static int region[ALL], nodes[ALL];
    mesh m = mesh_of(1, (box[]){upright(LARGE, 0.0)});
    int count = 0;
    fix_bottom(&m, fixed);
    for (int n = 0; n < ALL; n++)
        if (!fixed[n] && fabs(m.nodes[n].x - 0.08) < 0.045 && fabs(m.nodes[n].y - 0.08) < 0.045) region[count++] = n;
    for (int single = 0; single < 2; single++) {
        tissue t;
        trocar_error why;
        double needed;
        symmetric_blocks inverses[2] = {{.count = count, .single = single}, {.count = count, .single = single}};
        condensed_region wanted = {.count = count, .nodes = region, .single = single};
        assert_int_equal(tissue_assemble(&m, materials, fixed, STRAIN_BY_PATCH, &t, &why), TROCAR_OK);
        for (int threads = 1; threads <= 2; threads++) {
            wanted.threads = threads;
            assert_int_equal(condense(&t, &wanted, nodes, &inverses[threads - 1], &needed, &why), TROCAR_OK);
        }
        assert_memory_equal(inverses[0].numbers, inverses[1].numbers, symmetric_blocks_bytes(count, single));
        if (!t.factor) assert_int_equal(tissue_factor(&t, 0, NULL, &why), TROCAR_OK);
        for (int i = 0; i < COLUMNS; i++) {
            int column = i * (count - 1) / (COLUMNS - 1);
            double *expected = column_by_factor(&t, nodes, count, 3 * (size_t)column), block[9];
            for (int row = 0; row < count; row++) {
                symmetric_blocks_get(&inverses[0], row, column, block, 3);
                for (int a = 0; a < 3; a++) assert_close(block[3 * a], expected[3 * row + a], (single ? 1e-5 : 1e-11) * expected[3 * column]);
            }
            free(expected);
        }
        free(inverses[0].numbers);
        free(inverses[1].numbers);
        tissue_free(&t);
    }
    mesh_free(&m);
}

static double memory_left = 1e12; /* bytes */
double __wrap_memory_available(void);
double __wrap_memory_available(void) { return memory_left; }

/* For a small region, the elimination needs the most memory; for the whole body, the inversion does. */
static void memory_of_condensing_is_predicted(void **state) {
    (void)state;
    static bool fixed[BOX];
    mesh m = boxes(1);
    fix_bottom(&m, fixed);
    for (int choice = 0; choice < 4; choice++) {
        int region[BOX], nodes[BOX], count = 0;
        tissue t;
        trocar_error why;
        double predicted = 0.0, needed;
        for (int n = 0; n < BOX; n++)
            if (!fixed[n] && (choice >= 2 || in_column(&m, n, 0))) region[count++] = n;
        symmetric_blocks inverse = {.count = count, .single = choice % 2 == 1};
        condensed_region wanted = {.count = count, .nodes = region, .single = inverse.single, .progress = {note_memory, NULL}};
        assert_int_equal(tissue_assemble(&m, materials, fixed, STRAIN_BY_PATCH, &t, &why), TROCAR_OK);
        memory_left = 0.0;
        assert_int_equal(condense(&t, &wanted, nodes, &inverse, &needed, &why), TROCAR_NO_MEMORY);
        assert_int_equal(sscanf(strstr(why.text, " takes ") + 7, "%lf", &predicted), 1);
        memory_left = 1e12;
        double before = begin_counting();
        assert_int_equal(condense(&t, &wanted, nodes, &inverse, &needed, &why), TROCAR_OK);
        assert_predicted(needed, most_used - before);
        assert_close(1e9 * predicted, needed, 0.005 * needed); /* to three digits */
        free(inverse.numbers);
        tissue_free(&t);
    }
    mesh_free(&m);
}

static int shown;
static void note_blas_threads(const char *what, double fraction, void *context) {
    (void)what, (void)fraction, (void)context;
    assert_int_equal(openblas_get_num_threads(), 2);
    shown++;
}

/* The number of BLAS threads is set for the whole process, and another thread may be condensing at the same time. */
static void condensing_leaves_blas_alone(void **state) {
    (void)state;
    static bool fixed[BOX];
    mesh m = boxes(1);
    fix_bottom(&m, fixed);
    int region[BOX], nodes[BOX], count = 0;
    tissue t;
    trocar_error why;
    double needed;
    for (int n = 0; n < BOX; n++)
        if (!fixed[n]) region[count++] = n;
    symmetric_blocks inverse = {.count = count};
    assert_int_equal(tissue_assemble(&m, materials, fixed, STRAIN_BY_PATCH, &t, &why), TROCAR_OK);
    openblas_set_num_threads(2);
    const condensed_region wanted = {.count = count, .nodes = region, .threads = 2, .progress = {note_blas_threads, NULL}};
    assert_int_equal(condense(&t, &wanted, nodes, &inverse, &needed, &why), TROCAR_OK);
    assert_int_equal(openblas_get_num_threads(), 2);
    assert_true(shown > 0);
    openblas_set_num_threads(1);
    free(inverse.numbers);
    tissue_free(&t);
    mesh_free(&m);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(regions_agree_with_the_whole_inverse),
        cmocka_unit_test(bodies_may_be_apart),
        cmocka_unit_test(loose_body_is_refused),
        cmocka_unit_test(small_loose_piece_is_refused),
        cmocka_unit_test(large_fronts_agree_with_the_factor),
        cmocka_unit_test(inverse_of_a_wide_region_agrees_with_the_factor),
        cmocka_unit_test(memory_of_condensing_is_predicted),
        cmocka_unit_test(condensing_leaves_blas_alone),
    };
    openblas_set_num_threads(1); /* what a simulation uses for meshes of this size */
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* The change of stiffness that a contact node brings against the whole mesh assembled with it and without it. */
#include "remeshing.h"

#include "patch.h"

/* Stiffness of the mesh with the first `count` nodes, not inverted. */
static void assemble(const refinement *all, int count, reference *r) {
    refinement some = *all;
    some.count = count;
    reference_build(tested, &some, r);
}

static int entry_of(int node) { return node >= 0 ? node : CUBE_NODES - 1 - node; }

/* Every entry of the difference, where none is fixed, is in the patch or zero. */
static void check_patch(int index) {
    static patch p;
    reference before, after;
    int places[CUBE_NODES + MAX_CONTACTS];
    patch_create(tested, &request.wanted, index, &p);
    assemble(&request.wanted, index, &before);
    assemble(&request.wanted, index + 1, &after);
    for (int i = 0; i < after.node_count; i++) places[i] = -1;
    for (int q = 0; q < p.count; q++) places[entry_of(p.nodes[q])] = q;
    for (int i = 0; i < 3 * after.node_count; i++)
        for (int j = 0; j < 3 * after.node_count; j++) {
            int row = i / 3, column = j / 3, old = before.node_count;
            if (after.fixed[row] || after.fixed[column]) continue;
            double expected = *reference_entry(&after, row, i % 3, column, j % 3), found = 0.0;
            if (row < old && column < old) expected -= *reference_entry(&before, row, i % 3, column, j % 3);
            if (places[row] >= 0 && places[column] >= 0) found = p.change[3 * places[row] + i % 3][3 * places[column] + j % 3];
            assert_close(found, expected, 1e-9 * fabs(*reference_entry(&after, row, 0, row, 0)));
        }
    reference_free(&before);
    reference_free(&after);
}

static void a_patch_is_the_difference_of_two_meshes(void **state) {
    (void)state;
    memset(&request, 0, sizeof request);
    while (request.wanted.count < 24) {
        int tet = rand() % tested->mesh->tet_count, index = request.wanted.count;
        kind wanted = (kind)(index % 3);
        if (add_node(wanted, tet, point_in(tet, 0.02)) < 0) continue;
        bool inner = request.wanted.nodes[index].across_tet >= 0;
        if (wanted == ON_FACE && inner != (index % 2 == 0)) { /* in turns inside the body and on its surface */
            request.wanted.count--;
            continue;
        }
        check_patch(index);
    }
}

int main(void) {
    srand(1);
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_patch_is_the_difference_of_two_meshes)};
    return cmocka_run_group_tests(tests, remeshing_create, remeshing_destroy);
}

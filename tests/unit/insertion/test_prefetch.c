/* Compares what the tick reads from a snapshot with the inverse itself, and what it requests with the tip's path. */
#include "insertion/tip/prefetch.h"
#include "lockstep.h"
#include "snapshot/snapshot_kernels.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static lockstep *inserted(double depth) {
    simulation_config c = lockstep_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.001 + depth), 0.02 * 1e3 * depth, 1e-3);
    return l;
}

static bool asked_for(const remesh_request *request, int node) {
    for (int i = 0; i < request->window_count; i++)
        if (request->window[i] == node) return true;
    return false;
}

static void nothing_is_known_before_the_first_snapshot(void **unused) {
    (void)unused;
    compliance_snapshot *empty = calloc(1, sizeof *empty);
    int corners[4] = {0, 1, 2, 3};
    refinement none = {.count = 0};
    int handles[4];
    assert_false(snapshot_covers(empty, corners, handles));
    assert_int_equal(snapshot_known_contacts(empty, &none), 0);
    free(empty);
}

/* Between nominal nodes, the rows of K^-1 are interpolated with the same weights as the displacement. */
static void point_interpolates_the_rows_of_its_corners(void **unused) {
    (void)unused;
    lockstep *l = inserted(0.03);
    const mesh *m = &l->parts.mesh;
    int handles[4], tet = l->state.tip.place.tet;
    leaf_point point = {.weights = {0.1, 0.2, 0.3, 0.4}};
    memcpy(point.corners, m->tets[tet], sizeof point.corners);
    assert_true(snapshot_covers(l->snapshot, point.corners, handles));
    for (int c = 0; c < 4; c++) {
        double rows[12 * 3];
        trocar_error why;
        assert_int_equal(inverse_gather(l->parts.inverse, &(inverse_blocks){4, m->tets[tet], 1, &m->tets[tet][c], rows, 3}, &why), TROCAR_OK);
        mat3 found = compliance_to_point(l->snapshot, handles, point.weights, handles[c]);
        for (int a = 0; a < 3; a++)
            for (int b = 0; b < 3; b++) {
                double expected = 0.0;
                for (int corner = 0; corner < 4; corner++) expected += point.weights[corner] * rows[(3 * corner + a) * 3 + b];
                assert_true(fabs(found.m[a][b] - expected) < 1e-12 * fabs(rows[0]));
            }
    }
    leaf_point elsewhere = point;
    elsewhere.corners[0] = m->node_count; /* an unknown node */
    assert_false(snapshot_covers(l->snapshot, elsewhere.corners, handles));
    lockstep_free(l);
}

static void contacts_are_identified_by_their_ids(void **unused) {
    (void)unused;
    lockstep *l = inserted(0.04);
    refinement other = l->state.refined;
    assert_true(other.count > 3);
    assert_int_equal(snapshot_known_contacts(l->snapshot, &other), other.count);
    other.nodes[2].id += 1000;
    assert_int_equal(snapshot_known_contacts(l->snapshot, &other), 2);
    lockstep_free(l);
}

/* The elements that a straight needle will reach within the prefetch distance are requested in advance. */
static void path_ahead_is_requested(void **unused) {
    (void)unused;
    lockstep *l = inserted(0.03);
    const mesh *m = &l->parts.mesh;
    double reach = l->parts.insertion.settings.prefetch_distance;
    assert_true(l->state.request.window_count <= MAX_WINDOW);
    for (double ahead = 0.0; ahead < 0.9 * reach; ahead += 1e-3) {
        int tet = mesh_locate(m, v3_axpy(ahead, v3(0, 0, 1), l->state.tip.place.nominal), l->state.tip.place.tet);
        for (int c = 0; c < 4; c++) assert_true(asked_for(&l->state.request, m->tets[tet][c]));
    }
    lockstep_free(l);
}

static void skin_is_requested_before_contact(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    pose start = lockstep_start();
    start.position.z -= 0.005;
    lockstep *l = lockstep_create(&c, start);
    surface_hit hit = mesh_enter(&l->parts.mesh, v3(0.005, 0.003, -0.006), v3(0.005, 0.003, 0.006));
    assert_true(hit.hit);
    for (int i = 0; i < 4; i++) assert_true(asked_for(&l->state.request, l->parts.mesh.tets[hit.tet][i]));
    lockstep_free(l);
}

static void line_is_prefetched_before_the_skin_and_follows_the_needle(void **unused) {
    (void)unused;
    simulation_config c = lockstep_config();
    pose start = lockstep_start();
    start.position.z -= 0.1;
    c.inverse = INVERSE_SPARSE;
    lockstep *l = lockstep_create(&c, start);
    lockstep_tick(l, start, 1e-3);
    uint64_t serial = l->state.request.serial;
    assert_int_equal(l->state.request.window_count, 0); /* nothing is requested far from the skin */
    assert_true(l->state.request.direction.z == 1.0 && fabs(l->state.request.tip.x - 0.005) < 1e-12);
    int slices = 1;
    while (remesher_look_ahead(l->run.remesher)) slices++;
    assert_true(slices > 1); /* the line through the body crosses several elements */
    assert_false(remesher_look_ahead(l->run.remesher));
    lockstep_move(l, v3(0, 0, 0.02), 0.1, 1e-3);
    assert_int_equal(l->state.request.serial, serial);
    lockstep_move(l, v3(0.004, 0, 0), 0.1, 1e-3);
    assert_true(l->state.request.serial > serial);
    assert_true(fabs(l->state.request.tip.x - 0.009) < 1.1e-3);
    lockstep_free(l);
}

static void needle_at_rest_requests_nothing_new(void **unused) {
    (void)unused;
    lockstep *l = inserted(0.03);
    lockstep_move(l, v3(0, 0, 0), 0.2, 1e-3);
    uint64_t serial = l->state.request.serial;
    lockstep_move(l, v3(0, 0, 0), 0.2, 1e-3);
    assert_int_equal(l->state.request.serial, serial);
    lockstep_free(l);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nothing_is_known_before_the_first_snapshot), cmocka_unit_test(point_interpolates_the_rows_of_its_corners),
        cmocka_unit_test(contacts_are_identified_by_their_ids),     cmocka_unit_test(path_ahead_is_requested),
        cmocka_unit_test(skin_is_requested_before_contact), cmocka_unit_test(needle_at_rest_requests_nothing_new),
        cmocka_unit_test(line_is_prefetched_before_the_skin_and_follows_the_needle),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

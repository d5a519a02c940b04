#include "replay/seed_table.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <cmocka.h>

#include "host.h"

static void holes_have_clinicians_names(void **state) {
    (void)state;
    static const struct { int column, row; const char *name; } cases[] = {{0, 0, "A1"}, {2, 5, "C3.5"}, {12, 12, "M7"}, {25, 1, "Z1.5"}, {26, 0, "AA1"}, {99, 99, "CV50.5"}};
    trocar_guide guide = {.columns = 100, .rows = 100};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        char name[16];
        hole_name(&guide, cases[i].column + 100 * cases[i].row, name);
        assert_string_equal(name, cases[i].name);
    }
}

/* Writes the seed of a needle without a guide, in mesh coordinates and in those of a patient whose left is the mesh's -x. */
static void a_row_has_both_places(void **state) {
    (void)state;
    host h = host_open(MESHES "/figure8.yaml");
    trocar_pose base = {{0.005, 0.003, -0.201}, {1, 0, 0, 0}};
    trocar_error why;
    assert_int_equal(trocar_sim_reset(h.sim, 0, &base, &why), TROCAR_OK);
    for (int i = 0; i < 300; i++, base.position[2] += 1e-4) host_step(&h, &base);
    assert_int_equal(trocar_sim_drop_seeds(h.sim, 0, 1, 0.0, &why), TROCAR_OK);
    for (; trocar_view_pending_seeds(trocar_sim_view(h.sim), 0) > 0; base.position[2] -= 1e-4) host_step(&h, &base);
    trocar_seed seed;
    assert_int_equal(trocar_view_seeds(trocar_sim_view(h.sim), &seed, 1), 1);
    const patient_frame turned = {v3(0, 0, 0.01), {0, 0, 0, 1}};
    for (int k = 0; k < 2; k++) {
        char *text = NULL;
        size_t size = 0;
        FILE *file = open_memstream(&text, &size);
        assert_int_equal(seed_table_write(file, h.scene, h.model, h.sim, k ? &turned : NULL, &why), TROCAR_OK);
        fclose(file);
        double now[6], rest[6];
        const char *row = strchr(text, '\n') + 1, *unit = k ? "rest_x [mm]" : "rest_x [m]";
        assert_non_null(strstr(text, unit));
        assert_int_equal(sscanf(row, "1,0,,,0,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf", &now[0], &now[1], &now[2], &now[3], &now[4], &now[5], &rest[0], &rest[1],
                                &rest[2], &rest[3], &rest[4], &rest[5]), 12);
        double sign = k ? -1 : 1, scale = k ? 1e3 : 1;
        assert_true(fabs(rest[0] - sign * scale * seed.position[0]) < 1e-7 && fabs(rest[1] - sign * scale * seed.position[1]) < 1e-7);
        assert_true(fabs(rest[2] - scale * (seed.position[2] - (k ? 0.01 : 0))) < 1e-7);
        assert_true(fabs(rest[3] - sign * seed.direction[0]) < 1e-8 && fabs(rest[5] - seed.direction[2]) < 1e-8);
        assert_true(fabs(now[2] - rest[2]) > 1e-5 * scale && fabs(now[2] - rest[2]) < 5e-3 * scale); /* the needle drags the tissue back with it */
        free(text);
    }
    host_close(&h);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(holes_have_clinicians_names), cmocka_unit_test(a_row_has_both_places)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Tests, through trocar.h, needles inserted 5 mm away from another needle or from their own old track, on meshes whose elements are larger than that
   distance. The forces must not depend on the mesh. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>

#include <cmocka.h>

#include "trocar.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { AXES = 3, WAYS = 6 };
static const double LOW[AXES] = {-0.06, -0.06, 0.0}, HIGH[AXES] = {0.06, 0.06, 0.1}; /* m: the block of tissue, fixed at z = 0 */
static const double DEPTH = 0.03, ABOVE = 1e-3, LENGTH = 0.2, APART = 5e-3, SIDEWAYS = 1e-3; /* m */
static const double FIRST[2] = {0.0007, 0.0011}; /* m: x and y of the first insertion */
static const int COARSE[AXES] = {7, 7, 6}, FINE[AXES] = {14, 14, 11}; /* boxes along each axis: elements of 17 and 9 mm; 448 and 2700 nodes */

/* ---- the block ---------------------------------------------------------------------------------------------------------- */

static int32_t node_of(const int boxes[AXES], const int at[AXES]) { return at[0] + (boxes[0] + 1) * (at[1] + (boxes[1] + 1) * at[2]); }

/* Meshes the block, splitting each box into six tetrahedra around its diagonal. */
static void set_block(trocar_scene *scene, const int boxes[AXES]) {
    static const int ORDER[WAYS][AXES] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    static const char *const regions[] = {"tissue"}, *const surfaces[] = {"low"};
    int count = (boxes[0] + 1) * (boxes[1] + 1) * (boxes[2] + 1), tet_count = WAYS * boxes[0] * boxes[1] * boxes[2], triangle_count = 0, tet = 0;
    double(*nodes)[AXES] = malloc((size_t)count * sizeof *nodes);
    int32_t(*tets)[4] = malloc((size_t)tet_count * sizeof *tets), (*triangles)[3] = malloc((size_t)(2 * boxes[0] * boxes[1]) * sizeof *triangles);
    int32_t *surface = calloc((size_t)(2 * boxes[0] * boxes[1]), sizeof *surface);
    int at[AXES];
    for (at[2] = 0; at[2] <= boxes[2]; at[2]++)
        for (at[1] = 0; at[1] <= boxes[1]; at[1]++)
            for (at[0] = 0; at[0] <= boxes[0]; at[0]++)
                for (int a = 0; a < AXES; a++) nodes[node_of(boxes, at)][a] = LOW[a] + (HIGH[a] - LOW[a]) * at[a] / boxes[a];
    for (at[2] = 0; at[2] < boxes[2]; at[2]++)
        for (at[1] = 0; at[1] < boxes[1]; at[1]++)
            for (at[0] = 0; at[0] < boxes[0]; at[0]++)
                for (int way = 0; way < WAYS; way++, tet++) {
                    int corner[AXES] = {at[0], at[1], at[2]};
                    tets[tet][0] = node_of(boxes, corner);
                    for (int k = 0; k < AXES; k++) {
                        corner[ORDER[way][k]]++;
                        tets[tet][k + 1] = node_of(boxes, corner);
                    }
                    if (at[2] > 0 || ORDER[way][2] != 2) continue; /* if the last step is along z, the first three corners lie on the bottom */
                    for (int k = 0; k < 3; k++) triangles[triangle_count][k] = tets[tet][k];
                    triangle_count++;
                }
    trocar_mesh mesh = {.node_count = count, .tet_count = tet_count, .nodes = nodes[0], .tets = tets[0], .region_count = 1, .regions = regions,
                        .triangle_count = triangle_count, .triangles = triangles[0], .triangle_surface = surface, .surface_count = 1, .surfaces = surfaces};
    OK(trocar_scene_set_mesh(scene, &mesh, &why));
    free(nodes), free(tets), free(triangles), free(surface);
}

static trocar_sim *simulate(const int boxes[AXES], const char *needles, bool relaxes, trocar_model **model) {
    static const char *const keys[][2] = {{"fixed", "[low]"}, {"regions[tissue].youngs_modulus", "20e3"}, {"regions[tissue].poisson_ratio", "0.45"},
        {"regions[tissue].cutting_force", "0.1"}, {"regions[tissue].friction.static", "12"}, {"regions[tissue].friction.kinetic", "10"},
        {"regions[tissue].friction.viscous", "0"}, {"needle.inner_diameter", "0"}, {"needle.youngs_modulus", "2e14"}};
    trocar_scene *scene;
    trocar_sim *sim;
    OK(trocar_scene_create(&scene, &why));
    set_block(scene, boxes);
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++) OK(trocar_scene_set(scene, keys[i][0], keys[i][1], &why));
    OK(trocar_scene_set(scene, "needles", needles, &why));
    if (relaxes) {
        OK(trocar_scene_set(scene, "relaxation[0].weight", "0.5", &why));
        OK(trocar_scene_set(scene, "relaxation[0].time", "1", &why));
    }
    OK(trocar_model_create(scene, NULL, model, &why));
    trocar_scene_free(scene);
    OK(trocar_sim_create(*model, &sim, &why));
    return sim;
}

/* ---- the hands ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    trocar_sim *sim;
    int count;
    trocar_pose base[2];
    trocar_output out[2];
} hands;

static trocar_pose above(double x) { return (trocar_pose){{x, FIRST[1], HIGH[2] + ABOVE + LENGTH}, {0, 1, 0, 0}}; }

/* Moves the base of one needle by x and z (m) over `seconds`; the other needle, if there is one, is held still. */
static void move(hands *h, int needle, double x, double z, double seconds) {
    int ticks = (int)lround(seconds * 1e3);
    for (int i = 0; i < ticks; i++) {
        h->base[needle].position[0] += x / ticks;
        h->base[needle].position[2] += z / ticks;
        for (int n = 0; n < h->count; n++) OK(trocar_sim_step(h->sim, n, &h->base[n], 1e-3, &h->out[n], &why));
    }
}

static hands start(const int boxes[AXES], int count, bool relaxes, trocar_model **model) {
    hands h = {.sim = simulate(boxes, count == 1 ? "1" : "2", relaxes, model), .count = count};
    for (int n = 0; n < count; n++) {
        h.base[n] = above(FIRST[0] + n * APART);
        OK(trocar_sim_reset(h.sim, n, &h.base[n], &why));
    }
    return h;
}

/* Inserts a needle, moves it sideways, holds it for three relaxation times, withdraws it, inserts it again 5 mm from its old track, and holds it for one
   relaxation time. Meanwhile the relaxing tissue recovers its original shape and pushes the needle sideways. */
static trocar_output beside_old_track(const int boxes[AXES]) {
    trocar_model *model;
    hands h = start(boxes, 1, true, &model);
    move(&h, 0, 0, -DEPTH - ABOVE, 0.3);
    move(&h, 0, SIDEWAYS, 0, 0.1);
    move(&h, 0, 0, 0, 3.0);
    move(&h, 0, -SIDEWAYS, DEPTH + 2 * ABOVE, 0.2);
    move(&h, 0, APART, 0, 0.02);
    move(&h, 0, 0, -DEPTH - 2 * ABOVE, 0.2);
    move(&h, 0, 0, 0, 1.0);
    trocar_sim_free(h.sim);
    trocar_model_free(model);
    return h.out[0];
}

static void the_mesh_is_not_felt_beside_an_old_track(void **state) {
    (void)state;
    trocar_output fine = beside_old_track(FINE), coarse = beside_old_track(COARSE);
    double sideways = coarse.force[0] / fine.force[0] - 1.0, along = coarse.force[2] / fine.force[2] - 1.0;
    print_message("%.4f N sideways, %.3f N along; on the coarse mesh %+.1f %% and %+.1f %%\n", fine.force[0], fine.force[2], 100 * sideways, 100 * along);
    assert_true(fine.force[0] < -0.03 && fine.force[2] > 0.2);
    assert_true(fabs(sideways) < 0.08 && fabs(along) < 0.01);
}

/* If a needle held to the side has displaced elastic tissue, a straight needle inserted next to it is not pushed sideways. */
static void displaced_tissue_does_not_push_a_needle_that_enters(void **state) {
    (void)state;
    trocar_model *model;
    hands h = start(COARSE, 2, false, &model);
    move(&h, 0, 0, -DEPTH - ABOVE, 0.3);
    move(&h, 0, SIDEWAYS, 0, 0.1);
    double held = h.out[0].force[0];
    move(&h, 1, 0, -DEPTH - ABOVE, 0.3);
    print_message("held aside with %.3f N; the needle that enters beside it: %.4f N sideways, %.3f N along\n", held, h.out[1].force[0], h.out[1].force[2]);
    assert_true(h.out[1].force[2] > 0.3 && fabs(h.out[1].force[0]) < 0.06 * fabs(held));
    trocar_sim_free(h.sim);
    trocar_model_free(model);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(the_mesh_is_not_felt_beside_an_old_track),
                                       cmocka_unit_test(displaced_tissue_does_not_push_a_needle_that_enters)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}

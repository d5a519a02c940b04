/* Tests through trocar.h a needle that is inserted 5 mm beside another one, on a mesh whose elements are larger than that distance. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
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
static const double FIRST[2] = {0.0007, 0.0011}; /* m: place of the first insertion */
static const int BOXES[AXES] = {7, 7, 6}; /* boxes: elements of 17 mm, 448 nodes */

/* ---- the block ---------------------------------------------------------------------------------------------------------- */

static int32_t node_of(const int at[AXES]) { return at[0] + (BOXES[0] + 1) * (at[1] + (BOXES[1] + 1) * at[2]); }

/* Sets the block's mesh: each box is divided into six tetrahedra around its diagonal. */
static void set_block(trocar_scene *scene) {
    static const int ORDER[WAYS][AXES] = {{0, 1, 2}, {0, 2, 1}, {1, 0, 2}, {1, 2, 0}, {2, 0, 1}, {2, 1, 0}};
    static const char *const regions[] = {"tissue"}, *const surfaces[] = {"low"};
    int count = (BOXES[0] + 1) * (BOXES[1] + 1) * (BOXES[2] + 1), tet_count = WAYS * BOXES[0] * BOXES[1] * BOXES[2], triangle_count = 0, tet = 0;
    double(*nodes)[AXES] = malloc((size_t)count * sizeof *nodes);
    int32_t(*tets)[4] = malloc((size_t)tet_count * sizeof *tets), (*triangles)[3] = malloc((size_t)(2 * BOXES[0] * BOXES[1]) * sizeof *triangles);
    int32_t *surface = calloc((size_t)(2 * BOXES[0] * BOXES[1]), sizeof *surface);
    int at[AXES];
    for (at[2] = 0; at[2] <= BOXES[2]; at[2]++)
        for (at[1] = 0; at[1] <= BOXES[1]; at[1]++)
            for (at[0] = 0; at[0] <= BOXES[0]; at[0]++)
                for (int a = 0; a < AXES; a++) nodes[node_of(at)][a] = LOW[a] + (HIGH[a] - LOW[a]) * at[a] / BOXES[a];
    for (at[2] = 0; at[2] < BOXES[2]; at[2]++)
        for (at[1] = 0; at[1] < BOXES[1]; at[1]++)
            for (at[0] = 0; at[0] < BOXES[0]; at[0]++)
                for (int way = 0; way < WAYS; way++, tet++) {
                    int corner[AXES] = {at[0], at[1], at[2]};
                    tets[tet][0] = node_of(corner);
                    for (int k = 0; k < AXES; k++) {
                        corner[ORDER[way][k]]++;
                        tets[tet][k + 1] = node_of(corner);
                    }
                    if (at[2] > 0 || ORDER[way][2] != 2) continue; /* the first three corners of a tetrahedron that goes up last are at the bottom */
                    for (int k = 0; k < 3; k++) triangles[triangle_count][k] = tets[tet][k];
                    triangle_count++;
                }
    trocar_mesh mesh = {.node_count = count, .tet_count = tet_count, .nodes = nodes[0], .tets = tets[0], .region_count = 1, .regions = regions,
                        .triangle_count = triangle_count, .triangles = triangles[0], .triangle_surface = surface, .surface_count = 1, .surfaces = surfaces};
    OK(trocar_scene_set_mesh(scene, &mesh, &why));
    free(nodes), free(tets), free(triangles), free(surface);
}

static trocar_sim *simulate(trocar_model **model) {
    static const char *const keys[][2] = {{"fixed", "[low]"}, {"regions[tissue].youngs_modulus", "20e3"}, {"regions[tissue].poisson_ratio", "0.45"},
        {"regions[tissue].cutting_force", "0.1"}, {"regions[tissue].friction.static", "12"}, {"regions[tissue].friction.kinetic", "10"},
        {"regions[tissue].friction.viscous", "0"}, {"needle.inner_diameter", "0"}, {"needle.youngs_modulus", "2e14"}};
    trocar_scene *scene;
    trocar_sim *sim;
    OK(trocar_scene_create(&scene, &why));
    set_block(scene);
    for (size_t i = 0; i < sizeof keys / sizeof *keys; i++) OK(trocar_scene_set(scene, keys[i][0], keys[i][1], &why));
    OK(trocar_scene_set(scene, "needles", "2", &why));
    OK(trocar_model_create(scene, NULL, model, &why));
    trocar_scene_free(scene);
    OK(trocar_sim_create(*model, &sim, &why));
    return sim;
}

/* ---- the hands ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    trocar_sim *sim;
    trocar_pose base[2];
    trocar_output out[2];
} hands;

static trocar_pose above(double x) { return (trocar_pose){{x, FIRST[1], HIGH[2] + ABOVE + LENGTH}, {0, 1, 0, 0}}; }

/* Moves one needle's base in this time (s) while the other is held. */
static void move(hands *h, int needle, double x, double z, double seconds) {
    int ticks = (int)lround(seconds * 1e3);
    for (int i = 0; i < ticks; i++) {
        h->base[needle].position[0] += x / ticks;
        h->base[needle].position[2] += z / ticks;
        for (int n = 0; n < 2; n++) OK(trocar_sim_step(h->sim, n, &h->base[n], 1e-3, &h->out[n], &why));
    }
}

static hands start(trocar_model **model) {
    hands h = {.sim = simulate(model)};
    for (int n = 0; n < 2; n++) {
        h.base[n] = above(FIRST[0] + n * APART);
        OK(trocar_sim_reset(h.sim, n, &h.base[n], &why));
    }
    return h;
}

/* A straight needle is inserted into elastic tissue that another needle holds displaced: nothing pushes it sideways. */
static void displaced_tissue_does_not_push_a_needle_that_enters(void **state) {
    (void)state;
    trocar_model *model;
    hands h = start(&model);
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
    const struct CMUnitTest tests[] = {cmocka_unit_test(displaced_tissue_does_not_push_a_needle_that_enters)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}

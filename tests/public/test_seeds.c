/* Tests, through trocar.h, seeds: dropping them, how they stay in the tissue and move with it, and undoing a drop. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "trocar.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

static const double LENGTH = 4.5e-3, STEP = 1e-4; /* m; LENGTH: of a seed; STEP: travel of the base per 1 ms tick */

typedef struct {
    trocar_model *model;
    trocar_sim *sim;
    trocar_output output;
    double out;              /* m, how far the base is drawn back from where the tip would touch the skin */
} insertion;

static trocar_pose base_of(double out) { return (trocar_pose){{0.005, 0.003, -0.2 - out}, {1, 0, 0, 0}}; }

typedef struct { const char *key, *value; } setting;

static insertion begin(const setting *settings) {
    insertion in = {.out = 2e-3};
    trocar_scene *scene;
    trocar_pose base = base_of(in.out);
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    for (; settings && settings->key; settings++) OK(trocar_scene_set(scene, settings->key, settings->value, &why));
    OK(trocar_model_create(scene, NULL, &in.model, &why));
    trocar_scene_free(scene);
    OK(trocar_sim_create(in.model, &in.sim, &why));
    OK(trocar_sim_reset(in.sim, 0, &base, &why));
    return in;
}

static void end(insertion *in) {
    trocar_sim_free(in->sim);
    trocar_model_free(in->model);
}

static void tick(insertion *in, double out) {
    in->out = out;
    trocar_pose base = base_of(out);
    OK(trocar_sim_step(in->sim, 0, &base, 1e-3, &in->output, &why));
}

/* Moves the base until the tip is at `depth` (m) in the tissue; a negative depth is outside it. */
static void go_to(insertion *in, double depth) {
    double way = in->output.depth < depth ? -STEP : STEP;
    while (way < 0.0 ? in->output.depth < depth : in->output.depth > depth) tick(in, in->out + way);
}

static int all_seeds(const trocar_sim *sim, trocar_seed seeds[TROCAR_MAX_SEEDS]) { return trocar_view_seeds(trocar_sim_view(sim), seeds, TROCAR_MAX_SEEDS); }

static void tip_of(const insertion *in, double tip[3]) {
    double joints[TROCAR_MAX_JOINTS][3];
    memcpy(tip, joints[trocar_view_centreline(trocar_sim_view(in->sim), 0, joints[0], TROCAR_MAX_JOINTS) - 1], 3 * sizeof *tip);
}

/* In very stiff tissue, rest and world positions coincide. The needle is held still during the drop, because the tip's position in the tissue lags the
   needle by one tick. */
static void a_seed_is_left_where_the_tip_was(void **state) {
    (void)state;
    static const setting stiff[] = {{"regions[prostate].youngs_modulus", "1e9"}, {"regions[surrounding].youngs_modulus", "1e9"},
                                    {"needle.bevel_slope", "0"}, {0}};
    insertion in = begin(stiff);
    trocar_seed seeds[TROCAR_MAX_SEEDS];
    double tip[3];
    go_to(&in, 0.04);
    for (int i = 0; i < 5; i++) tick(&in, in.out);
    tip_of(&in, tip);
    double dropped = in.output.depth;
    OK(trocar_sim_drop_seeds(in.sim, 0, 1, 0.0, &why));
    assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(in.sim), 0), 1);
    while (trocar_view_pending_seeds(trocar_sim_view(in.sim), 0)) {
        assert_int_equal(all_seeds(in.sim, seeds), 0);
        assert_true(in.output.depth > dropped - LENGTH);
        tick(&in, in.out + STEP);
    }
    assert_true(in.output.depth <= dropped - LENGTH && in.output.depth > dropped - LENGTH - 2 * STEP);
    assert_int_equal(all_seeds(in.sim, seeds), 1);
    double off[3];
    for (int i = 0; i < 3; i++) off[i] = seeds[0].position[i] - (tip[i] - (i == 2 ? 0.5 * LENGTH : 0.0));
    print_message("the seed is (%.3f, %.3f, %.3f) um from half its length behind the tip\n", 1e6 * off[0], 1e6 * off[1], 1e6 * off[2]);
    for (int i = 0; i < 3; i++) assert_true(fabs(off[i]) < 2e-6);
    assert_true(seeds[0].direction[2] > 0.99999);
    assert_true(seeds[0].needle == 0 && seeds[0].hole == -1 && seeds[0].guide == -1 && seeds[0].strand == 0);
    go_to(&in, 0.0);
    assert_int_equal(all_seeds(in.sim, seeds), 1);
    end(&in);
}

static void a_strand_is_left_seed_by_seed(void **state) {
    (void)state;
    insertion in = begin(NULL);
    trocar_seed seeds[TROCAR_MAX_SEEDS];
    go_to(&in, 0.045);
    double dropped = in.output.depth;
    OK(trocar_sim_drop_seeds(in.sim, 0, 4, 0.0, &why));
    for (int placed = 0; placed < 4; placed++) {
        assert_int_equal(all_seeds(in.sim, seeds), placed);
        assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(in.sim), 0), 4 - placed);
        go_to(&in, dropped - 0.01 * placed - LENGTH + STEP);
        assert_int_equal(all_seeds(in.sim, seeds), placed);
        go_to(&in, dropped - 0.01 * placed - LENGTH);
    }
    assert_int_equal(all_seeds(in.sim, seeds), 4);
    for (int i = 0; i < 4; i++) {
        assert_int_equal(seeds[i].strand, i);
        /* straight, except for slight steering by the bevel */
        assert_true(fabs(seeds[i].position[2] - (dropped - 0.01 * i - 0.5 * LENGTH)) < 2e-5);
    }
    OK(trocar_sim_drop_seeds(in.sim, 0, 1, 0.0, &why));
    end(&in);
}

/* If the needle is pushed back in, it takes the seeds up again, as if a stylet held them, and they are pending as before. */
static void a_pending_seed_waits_for_the_needle_to_be_drawn_back(void **state) {
    (void)state;
    insertion in = begin(NULL);
    trocar_seed seeds[TROCAR_MAX_SEEDS];
    go_to(&in, 0.04);
    double dropped = in.output.depth;
    OK(trocar_sim_drop_seeds(in.sim, 0, 1, 0.0, &why));
    go_to(&in, dropped - 0.8 * LENGTH);
    go_to(&in, dropped + 2e-3);
    assert_int_equal(all_seeds(in.sim, seeds), 0);
    go_to(&in, dropped - LENGTH);
    assert_int_equal(all_seeds(in.sim, seeds), 1);
    assert_true(fabs(seeds[0].position[2] - (dropped - 0.5 * LENGTH)) < 2e-5);
    end(&in);
}

/* Solves x = sum of w_i corner_i for the weights w_i by Cramer's rule. */
static void weights_in(const trocar_model *model, int tet, const double x[3], double w[4]) {
    const int32_t *corners = trocar_model_tets(model) + 4 * tet;
    const double *nodes = trocar_model_nodes(model), *last = nodes + 3 * corners[3];
    double m[3][3], rest[3];
    for (int i = 0; i < 3; i++) {
        rest[i] = x[i] - last[i];
        for (int c = 0; c < 3; c++) m[c][i] = nodes[3 * corners[c] + i] - last[i];
    }
    #define DET(a, b, c) (a[0] * (b[1] * c[2] - b[2] * c[1]) - a[1] * (b[0] * c[2] - b[2] * c[0]) + a[2] * (b[0] * c[1] - b[1] * c[0]))
    double whole = DET(m[0], m[1], m[2]);
    w[0] = DET(rest, m[1], m[2]) / whole;
    w[1] = DET(m[0], rest, m[2]) / whole;
    w[2] = DET(m[0], m[1], rest) / whole;
    w[3] = 1.0 - w[0] - w[1] - w[2];
}

static void displaced_by(const trocar_model *model, const double *u, int tet, const double x[3], double moved[3]) {
    double w[4];
    weights_in(model, tet, x, w);
    for (int i = 0; i < 3; i++) {
        moved[i] = x[i];
        for (int c = 0; c < 4; c++) moved[i] += w[c] * u[3 * trocar_model_tets(model)[4 * tet + c] + i];
    }
}

static void seeds_move_with_the_tissue_and_stay(void **state) {
    (void)state;
    insertion in = begin(NULL);
    trocar_seed seeds[TROCAR_MAX_SEEDS], later[TROCAR_MAX_SEEDS], shown[TROCAR_MAX_SEEDS];
    double *u = malloc(3 * (size_t)trocar_model_node_count(in.model) * sizeof *u), largest = 0.0;
    memset(seeds, 0, sizeof seeds);
    memset(later, 0, sizeof later);
    memset(shown, 0, sizeof shown);
    trocar_picture *picture;
    OK(trocar_picture_create(in.model, &picture, &why));
    go_to(&in, 0.045);
    OK(trocar_sim_drop_seeds(in.sim, 0, 3, 8e-3, &why));
    go_to(&in, 0.01);
    go_to(&in, 0.03);
    int count = all_seeds(in.sim, seeds);
    assert_int_equal(count, 3);
    OK(trocar_view_displacements(trocar_sim_view(in.sim), u, &why));
    for (int i = 0; i < count; i++) {
        const trocar_seed *s = &seeds[i];
        double at[3], along[3], expected[3], ahead[3], end[3], way[3], length = 0.0, w[4];
        assert_int_equal(trocar_model_displace_seed(in.model, u, s, at, along), 1);
        weights_in(in.model, s->tet, s->position, w);
        for (int c = 0; c < 4; c++) assert_true(fabs(w[c] - s->weights[c]) < 1e-9 && w[c] > -1e-5);
        displaced_by(in.model, u, s->tet, s->position, expected);
        for (int k = 0; k < 3; k++) ahead[k] = s->position[k] + 1e-4 * s->direction[k];
        displaced_by(in.model, u, s->tet, ahead, end);
        for (int k = 0; k < 3; k++) length += pow(way[k] = end[k] - expected[k], 2);
        for (int k = 0; k < 3; k++) {
            assert_true(fabs(at[k] - expected[k]) < 1e-12 && fabs(along[k] - way[k] / sqrt(length)) < 1e-9);
            largest = fmax(largest, fabs(at[k] - s->position[k]));
        }
    }
    print_message("the tissue has moved seeds by up to %.3f mm\n", 1e3 * largest);
    assert_true(largest > 2e-4);

    go_to(&in, 0.0);
    trocar_pose base = base_of(0.05);
    OK(trocar_sim_reset(in.sim, 0, &base, &why));
    assert_int_equal(all_seeds(in.sim, later), count);
    assert_memory_equal(later, seeds, sizeof seeds);
    trocar_sim_take_picture(in.sim, picture);
    assert_int_equal(trocar_view_seeds(trocar_picture_view(picture), shown, TROCAR_MAX_SEEDS), count);
    assert_memory_equal(shown, seeds, sizeof seeds);
    OK(trocar_view_displacements(trocar_picture_view(picture), u, &why));
    for (int i = 0; i < count; i++) {
        double at[3], along[3];
        trocar_model_displace_seed(in.model, u, &seeds[i], at, along);
        for (int k = 0; k < 3; k++) assert_true(fabs(at[k] - seeds[i].position[k]) < 1e-12); /* at rest: the tissue is elastic and unloaded */
    }
    trocar_seed wrong = {.tet = trocar_model_tet_count(in.model)};
    assert_int_equal(trocar_model_displace_seed(in.model, u, &wrong, u, u), 0);
    trocar_picture_free(picture);
    free(u);
    end(&in);
}

/* Checks that a drop is refused with this message and changes nothing. */
static void refused(insertion *in, int needle, int count, double spacing, const char *words) {
    trocar_seed before[TROCAR_MAX_SEEDS], after[TROCAR_MAX_SEEDS];
    memset(before, 0, sizeof before);
    memset(after, 0, sizeof after);
    int seeds = all_seeds(in->sim, before), pending = trocar_view_pending_seeds(trocar_sim_view(in->sim), 0);
    assert_int_equal(trocar_sim_drop_seeds(in->sim, needle, count, spacing, &why), TROCAR_BAD_INPUT);
    if (!strstr(why.text, words)) fail_msg("\"%s\" does not say \"%s\"", why.text, words);
    assert_int_equal(trocar_sim_drop_seeds(in->sim, needle, count, spacing, NULL), TROCAR_BAD_INPUT);
    assert_int_equal(all_seeds(in->sim, after), seeds);
    assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(in->sim), 0), pending);
    assert_memory_equal(before, after, sizeof before);
}

static void what_cannot_be_dropped_is_refused(void **state) {
    (void)state;
    insertion in = begin(NULL);
    refused(&in, 0, 1, 0.0, "outside the tissue");
    go_to(&in, 3e-3);
    refused(&in, 0, 1, 0.0, "less than the 4.5 mm of the seeds");
    go_to(&in, 0.03);
    refused(&in, 1, 1, 0.0, "needle 1: there is one, number 0");
    refused(&in, -1, 1, 0.0, "needle -1");
    refused(&in, 0, 0, 0.0, "1 to 16 at a time");
    refused(&in, 0, 17, 0.0, "1 to 16 at a time");
    refused(&in, 0, 2, 4e-3, "overlap at a spacing of 4 mm");
    refused(&in, 0, 2, -1.0, "overlap");
    refused(&in, 0, 2, NAN, "overlap");
    refused(&in, 0, 2, INFINITY, "overlap");
    refused(&in, 0, 4, 0.0, "less than the 34.5 mm");
    OK(trocar_sim_drop_seeds(in.sim, 0, 2, 0.0, &why));
    refused(&in, 0, 1, 0.0, "still holds 2 of the seeds");
    assert_int_equal(trocar_sim_undo_seed(in.sim, 3, &why), TROCAR_BAD_INPUT);
    end(&in);
    in = begin((setting[]){{"seeds.diameter", "2e-3"}, {0}});
    go_to(&in, 0.03);
    refused(&in, 0, 1, 0.0, "do not fit in a needle of 1.27 mm");
    end(&in);
}

static void there_is_room_for_so_many(void **state) {
    (void)state;
    insertion in = begin((setting[]){{"seeds.length", "1e-3"}, {"seeds.spacing", "1e-3"}, {0}});
    trocar_seed seeds[TROCAR_MAX_SEEDS];
    for (int i = 0; i < TROCAR_MAX_SEEDS / TROCAR_MAX_STRAND; i++) {
        go_to(&in, 0.02);
        OK(trocar_sim_drop_seeds(in.sim, 0, TROCAR_MAX_STRAND, 0.0, &why));
        go_to(&in, 1e-3);
    }
    assert_int_equal(all_seeds(in.sim, seeds), TROCAR_MAX_SEEDS);
    go_to(&in, 0.02);
    refused(&in, 0, 1, 0.0, "at most 256 seeds");
    OK(trocar_sim_undo_seed(in.sim, 0, &why));
    OK(trocar_sim_drop_seeds(in.sim, 0, 1, 0.0, &why));
    end(&in);
}

static void undo_takes_back_the_last(void **state) {
    (void)state;
    insertion in = begin(NULL);
    trocar_seed seeds[TROCAR_MAX_SEEDS];
    assert_int_equal(trocar_sim_undo_seed(in.sim, 0, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "has no dropped seed"));
    go_to(&in, 0.045);
    double dropped = in.output.depth;
    OK(trocar_sim_drop_seeds(in.sim, 0, 3, 0.0, &why));
    go_to(&in, dropped - 0.016);
    assert_int_equal(all_seeds(in.sim, seeds), 2);
    OK(trocar_sim_undo_seed(in.sim, 0, &why)); /* removes the third seed, which has not left the needle yet */
    assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(in.sim), 0), 0);
    assert_int_equal(all_seeds(in.sim, seeds), 2);
    go_to(&in, 0.01);
    assert_int_equal(all_seeds(in.sim, seeds), 2);
    OK(trocar_sim_undo_seed(in.sim, 0, &why));
    assert_int_equal(all_seeds(in.sim, seeds), 1);
    assert_int_equal(seeds[0].strand, 0);
    OK(trocar_sim_undo_seed(in.sim, 0, &why));
    assert_int_equal(trocar_sim_undo_seed(in.sim, 0, &why), TROCAR_BAD_INPUT);
    end(&in);
}

/* Removes the seeds of one needle only, those still in it included. */
static void clearing_removes_the_seeds_of_one_needle(void **state) {
    (void)state;
    insertion in = begin((const setting[]){{"needles", "2"}, {NULL, NULL}});
    trocar_seed seeds[TROCAR_MAX_SEEDS];
    assert_int_equal(trocar_sim_clear_seeds(in.sim, 2, &why), TROCAR_BAD_INPUT);
    OK(trocar_sim_clear_seeds(in.sim, 0, &why)); /* there are none */
    go_to(&in, 0.045);
    OK(trocar_sim_drop_seeds(in.sim, 0, 3, 0.0, &why));
    go_to(&in, in.output.depth - 0.016);
    assert_int_equal(all_seeds(in.sim, seeds), 2);
    OK(trocar_sim_clear_seeds(in.sim, 1, &why)); /* another needle's */
    assert_int_equal(all_seeds(in.sim, seeds), 2);
    OK(trocar_sim_clear_seeds(in.sim, 0, &why));
    assert_int_equal(all_seeds(in.sim, seeds), 0);
    assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(in.sim), 0), 0);
    go_to(&in, 0.01);
    assert_int_equal(all_seeds(in.sim, seeds), 0);
    end(&in);
}

static void a_reset_needle_keeps_its_pending_seeds(void **state) {
    (void)state;
    insertion in = begin(NULL);
    trocar_seed seeds[TROCAR_MAX_SEEDS];
    go_to(&in, 0.04);
    OK(trocar_sim_drop_seeds(in.sim, 0, 1, 0.0, &why));
    trocar_pose base = base_of(0.002);
    OK(trocar_sim_reset(in.sim, 0, &base, &why));
    assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(in.sim), 0), 0);
    tick(&in, 0.001);
    assert_int_equal(all_seeds(in.sim, seeds), 0);
    end(&in);
}

static void a_restore_brings_them_back(void **state) {
    (void)state;
    insertion in = begin(NULL);
    trocar_seed before[TROCAR_MAX_SEEDS], after[TROCAR_MAX_SEEDS];
    memset(before, 0, sizeof before);
    memset(after, 0, sizeof after);
    go_to(&in, 0.045);
    double dropped = in.output.depth;
    OK(trocar_sim_drop_seeds(in.sim, 0, 4, 0.0, &why));
    go_to(&in, dropped - 0.02);
    size_t size = trocar_sim_state_size(in.sim);
    void *saved = malloc(size);
    OK(trocar_sim_save(in.sim, saved, size, &why));
    insertion again = in;
    OK(trocar_sim_create(in.model, &again.sim, &why));
    go_to(&in, 0.0);
    assert_int_equal(all_seeds(in.sim, before), 4);
    OK(trocar_sim_restore(again.sim, saved, size, &why));
    assert_int_equal(all_seeds(again.sim, after), 2);
    assert_int_equal(trocar_view_pending_seeds(trocar_sim_view(again.sim), 0), 2);
    go_to(&again, 0.0);
    assert_int_equal(all_seeds(again.sim, after), 4);
    assert_memory_equal(before, after, sizeof before);
    free(saved);
    trocar_sim_free(again.sim);
    end(&in);
}

static void a_seed_knows_its_hole(void **state) {
    (void)state;
    static const setting guided[] = {{"guides[plate].origin", "[0.005, 0.003, -0.03]"}, {"guides[plate].normal", "[0, 0, 1]"},
                                     {"guides[plate].along", "[1, 0, 0]"}, {"guides[plate].columns", "5"}, {"guides[plate].rows", "3"},
                                     {"guides[plate].hole_diameter", "1.5e-3"}, {0}};
    insertion in = begin(guided);
    trocar_seed seeds[TROCAR_MAX_SEEDS];
    trocar_pose base = base_of(0.05);
    OK(trocar_sim_reset(in.sim, 0, &base, &why));
    in.out = 0.05;
    go_to(&in, 0.02);
    OK(trocar_sim_drop_seeds(in.sim, 0, 1, 0.0, &why));
    go_to(&in, 0.01);
    assert_int_equal(all_seeds(in.sim, seeds), 1);
    assert_int_equal(seeds[0].guide, 0);
    assert_int_equal(seeds[0].hole, 2 + 5 * 1);
    end(&in);
}

static void sizes_are_checked(void **state) {
    (void)state;
    trocar_scene *scene;
    trocar_model *model;
    OK(trocar_scene_load(MESHES "/figure8.yaml", &scene, &why));
    assert_int_equal(trocar_scene_set(scene, "seeds.length", "0", &why), TROCAR_BAD_INPUT);
    OK(trocar_scene_set(scene, "seeds.length", "5e-3", &why));
    OK(trocar_scene_set(scene, "seeds.spacing", "4e-3", &why));
    assert_int_equal(trocar_model_create(scene, NULL, &model, &why), TROCAR_BAD_INPUT);
    assert_non_null(strstr(why.text, "seeds.spacing: seeds of 0.005 m overlap"));
    trocar_scene_free(scene);
    insertion in = begin(NULL);
    trocar_seed_size size = trocar_model_seed_size(in.model);
    assert_true(size.length == 4.5e-3 && size.diameter == 0.8e-3 && size.spacing == 10e-3);
    end(&in);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_seed_is_left_where_the_tip_was), cmocka_unit_test(a_strand_is_left_seed_by_seed),
        cmocka_unit_test(a_pending_seed_waits_for_the_needle_to_be_drawn_back), cmocka_unit_test(seeds_move_with_the_tissue_and_stay),
        cmocka_unit_test(what_cannot_be_dropped_is_refused), cmocka_unit_test(there_is_room_for_so_many), cmocka_unit_test(undo_takes_back_the_last), cmocka_unit_test(clearing_removes_the_seeds_of_one_needle),
        cmocka_unit_test(a_reset_needle_keeps_its_pending_seeds), cmocka_unit_test(a_restore_brings_them_back), cmocka_unit_test(a_seed_knows_its_hole),
        cmocka_unit_test(sizes_are_checked),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

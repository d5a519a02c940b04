/* Tests the virtual operator without a simulation. Needles go exactly where they are held, and the tissue either does not move or moves as a whole. */
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "check.h"
#include "trocar.h"

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { NEEDLES = 16, SEEDS = 3 };
static const double LENGTH = 0.2, HALF_SEED = 2.25e-3;                              /* m; LENGTH: the scene's needle; HALF_SEED: half a seed */
static const double THICKNESS = 0.02, LIMIT = (1.5e-3 - 1.27e-3) / 0.02;            /* THICKNESS: m, the template; LIMIT: rad, tilt at which a needle touches
                                                                                       both edges of its hole */
static const double TIPS[SEEDS] = {0.0875, 0.0775, 0.0675};                         /* m, depth of the tip at which each seed is dropped */

/* Returns a needle of a 4 x 4 grid in the gland, with 5 mm spacing. */
static trocar_operator_needle needle_at(int index, int seeds) {
    return (trocar_operator_needle){.entry = {{0.005 * (index % 4) - 0.01, 0.005 * (index / 4) - 0.01, -0.025}, {1, 0, 0, 0}}, .depth = TIPS[0], .seeds = TIPS,
                                    .seed_count = seeds};
}

static trocar_model *create_model(void) {
    trocar_scene *scene;
    trocar_model *model;
    OK(trocar_scene_load(MESHES "/implant.yaml", &scene, &why));
    OK(trocar_model_create(scene, &(trocar_model_options){.mesh_only = 1}, &model, &why));
    trocar_scene_free(scene);
    return model;
}

static trocar_operator *create_operator(const trocar_operator_options *options) {
    trocar_operator_needle needles[NEEDLES];
    trocar_operator *op;
    trocar_model *model = create_model();
    for (int i = 0; i < NEEDLES; i++) needles[i] = needle_at(i, SEEDS);
    OK(trocar_operator_create(model, needles, NEEDLES, options, &op, &why));
    trocar_model_free(model);
    return op;
}

/* Returns a seed that stayed where it was dropped, in tissue displaced uniformly by `shift`. */
typedef struct {
    int needle;
    double rest[3];          /* m, position in the undeformed tissue */
} left_seed;

/* Carries out the plan in tissue displaced by `shift` (m). Returns the number of seeds. */
static int carry_out(trocar_operator *op, const double shift[3], left_seed *seeds) {
    static double field[3 * 5000];
    for (int i = 0; i < 5000; i++) memcpy(&field[3 * i], shift, 3 * sizeof *shift);
    trocar_operator_sight sight = {.displacements = field};
    trocar_operator_action action;
    int count = 0;
    for (int i = 0; i < 1000; i++) {
        OK(trocar_operator_next(op, &sight, &action, &why));
        if (action.act == TROCAR_OPERATOR_FINISHED) return count;
        if (action.act == TROCAR_OPERATOR_DROP) {
            trocar_pose base = trocar_operator_base(op, action.needle, sight.depth), behind = trocar_operator_base(op, action.needle, sight.depth - 1.0);
            for (int k = 0; k < action.seeds; k++, count++) {
                seeds[count].needle = action.needle;
                for (int a = 0; a < 3; a++) {
                    double axis = base.position[a] - behind.position[a];
                    seeds[count].rest[a] = base.position[a] + (LENGTH - HALF_SEED - k * action.spacing) * axis - shift[a];
                }
            }
        }
        sight.depth = action.depth;
    }
    fail_msg("the operator does not finish");
    return 0;
}

static trocar_operator_options published(uint64_t seed) {
    trocar_operator_options options = trocar_default_operator_options(1);
    options.seed = seed;
    return options;
}

/* ---- what is done ---------------------------------------------------------------------------------------------------------------------- */

static void expect(trocar_operator *op, trocar_operator_sight *sight, int act, int needle, double depth, double duration, double pause, int line) {
    trocar_operator_action action;
    OK(trocar_operator_next(op, sight, &action, &why));
    if (action.act != act || action.needle != needle || action.depth != depth || action.duration != duration || action.pause != pause)
        fail_msg("line %d: act %d of needle %d to %.17g m in %.17g s, %.17g s", line, action.act, action.needle, action.depth, action.duration, action.pause);
    sight->depth = action.depth;
    sight->refused = 0;
}

/* An operator who goes by the depth marks on the needles inserts them to the planned depths, whatever the tissue does. All numbers are compared exactly. */
static void marks_are_followed_blindly(void **state) {
    (void)state;
    double speed = 0.065, field[3 * 909];
    for (int i = 0; i < 3 * 909; i++) field[i] = 0.01 * sin(i);
    trocar_operator_needle needles[2] = {needle_at(0, 2), needle_at(1, 1)};
    trocar_operator *op;
    trocar_model *model = create_model();
    OK(trocar_operator_create(model, needles, 2, NULL, &op, &why));
    trocar_operator_sight sight = {.displacements = field};
    for (int n = 0; n < 2; n++) {
        expect(op, &sight, TROCAR_OPERATOR_START, n, -0.005, 0, 0, __LINE__);
        expect(op, &sight, TROCAR_OPERATOR_MOVE, n, TIPS[0], fabs(TIPS[0] - -0.005) / speed, 0.1, __LINE__);
        expect(op, &sight, TROCAR_OPERATOR_LEAVE, n, TIPS[0], 0, 0, __LINE__);
    }
    expect(op, &sight, TROCAR_OPERATOR_TAKE, 0, TIPS[0], 0, 0, __LINE__);
    sight.depth = 0.095; /* the needle was dragged along while it rested */
    expect(op, &sight, TROCAR_OPERATOR_MOVE, 0, TIPS[0], fabs(TIPS[0] - 0.095) / speed, 0.1, __LINE__);
    expect(op, &sight, TROCAR_OPERATOR_DROP, 0, TIPS[0], 0, 0, __LINE__);
    expect(op, &sight, TROCAR_OPERATOR_MOVE, 0, TIPS[1], fabs(TIPS[1] - TIPS[0]) / speed, 0.1, __LINE__);
    for (int i = 0; i < 5; i++) { /* the first seed is still in the needle */
        double before = sight.depth;
        expect(op, &sight, TROCAR_OPERATOR_DROP, 0, before, 0, 0, __LINE__);
        sight.refused = 1;
        expect(op, &sight, TROCAR_OPERATOR_MOVE, 0, before - 1e-3, fabs(before - 1e-3 - before) / speed, 0, __LINE__);
    }
    expect(op, &sight, TROCAR_OPERATOR_DROP, 0, sight.depth, 0, 0, __LINE__);
    expect(op, &sight, TROCAR_OPERATOR_MOVE, 0, -0.005, fabs(-0.005 - sight.depth) / speed, 0, __LINE__);
    expect(op, &sight, TROCAR_OPERATOR_TAKE, 1, sight.depth, 0, 0, __LINE__);
    sight.depth = 0.05; /* planned deeper than the tip is */
    expect(op, &sight, TROCAR_OPERATOR_MOVE, 1, TIPS[0], fabs(TIPS[0] - 0.05) / speed, 0.1, __LINE__);
    expect(op, &sight, TROCAR_OPERATOR_DROP, 1, TIPS[0], 0, 0, __LINE__);
    expect(op, &sight, TROCAR_OPERATOR_MOVE, 1, -0.005, fabs(-0.005 - TIPS[0]) / speed, 0, __LINE__);
    for (int i = 0; i < 2; i++) expect(op, &sight, TROCAR_OPERATOR_FINISHED, 0, sight.depth, 0, 0, __LINE__);

    trocar_pose base = trocar_operator_base(op, 1, TIPS[0]);
    assert_true(base.position[0] == needles[1].entry.position[0] && base.position[2] == -0.025 + (TIPS[0] - LENGTH) && base.orientation[0] == 1.0);
    trocar_operator_free(op);
    trocar_model_free(model);
}

/* If the target moves along with the needle, the operator makes at most six strokes. */
static void corrections_end(void **state) {
    (void)state;
    double field[3 * 909];
    trocar_operator_options options = published(1);
    options.image_error = options.splay = options.speed_spread = 0;
    trocar_operator *op = create_operator(&options);
    trocar_operator_sight sight = {.displacements = field};
    trocar_operator_action action = {.act = -1};
    int strokes = 0;
    do {
        for (int i = 0; i < 909; i++) field[3 * i + 2] = 0.5 * fmax(sight.depth, 0);
        OK(trocar_operator_next(op, &sight, &action, &why));
        strokes += action.act == TROCAR_OPERATOR_MOVE;
        sight.depth = action.depth;
    } while (action.act != TROCAR_OPERATOR_LEAVE);
    assert_int_equal(strokes, 6);
    assert_close(sight.depth, 2 * TIPS[0], 2 * TIPS[0] / 64 + 1e-12); /* each stroke halves the remaining distance */
    trocar_operator_free(op);
}

static void a_stuck_seed_ends_the_implant(void **state) {
    (void)state;
    trocar_operator *op = create_operator(NULL);
    trocar_operator_sight sight = {0};
    trocar_operator_action action;
    trocar_status status = TROCAR_OK;
    int drops = 0;
    while (status == TROCAR_OK && drops < 100) {
        status = trocar_operator_next(op, &sight, &action, &why);
        drops += status == TROCAR_OK && action.act == TROCAR_OPERATOR_DROP;
        sight = (trocar_operator_sight){.depth = action.depth, .refused = action.act == TROCAR_OPERATOR_DROP};
    }
    assert_int_equal(status, TROCAR_SYSTEM);
    assert_int_equal(drops, 21);
    assert_non_null(strstr(why.text, "needle 0 was drawn back 20 times"));
    trocar_operator_free(op);
}

static void stabilising_needles_come_first_and_last(void **state) {
    (void)state;
    trocar_operator_needle needles[3] = {needle_at(0, 1), needle_at(1, 0), needle_at(2, 1)};
    int expected[] = {1, 0, 2, 0, 2, 1}, found = 0;
    trocar_operator *op;
    trocar_model *model = create_model();
    OK(trocar_operator_create(model, needles, 3, NULL, &op, &why));
    trocar_operator_sight sight = {0};
    trocar_operator_action action;
    for (;;) {
        OK(trocar_operator_next(op, &sight, &action, &why));
        if (action.act == TROCAR_OPERATOR_FINISHED) break;
        if (action.act == TROCAR_OPERATOR_START || action.act == TROCAR_OPERATOR_TAKE) assert_int_equal(action.needle, expected[found++]);
        assert_true(action.act != TROCAR_OPERATOR_DROP || action.needle != 1);
        sight.depth = action.depth;
    }
    assert_int_equal(found, 6);
    trocar_operator_free(op);
    trocar_model_free(model);
}

/* ---- strands ---------------------------------------------------------------------------------------------------------------------------- */

/* Carries out the plan of a single needle in tissue that is displaced along the needle by `shift` (m) until the first drop, and not at all afterwards. The
   first `refusals` attempts at the second drop are refused. Returns the number of drops; `drops` has the actions. */
static int drops_of(const trocar_operator_needle *needle, const trocar_operator_options *options, double shift, int refusals, trocar_operator_action *drops) {
    static double field[3 * 909];
    for (int i = 0; i < 909; i++) field[3 * i + 2] = shift;
    trocar_operator *op;
    trocar_model *model = create_model();
    OK(trocar_operator_create(model, needle, 1, options, &op, &why));
    trocar_model_free(model);
    trocar_operator_sight sight = {.displacements = field};
    trocar_operator_action action;
    int count = 0;
    for (;;) {
        OK(trocar_operator_next(op, &sight, &action, &why));
        if (action.act == TROCAR_OPERATOR_FINISHED) break;
        bool drop = action.act == TROCAR_OPERATOR_DROP, refused = drop && count == 1 && refusals-- > 0;
        if (drop && !refused) drops[count++] = action;
        sight = (trocar_operator_sight){.depth = action.depth, .displacements = count > 0 ? NULL : field, .refused = refused};
    }
    static trocar_operator_seed seeds[TROCAR_MAX_SEEDS];
    assert_int_equal(trocar_operator_seeds(op, seeds, TROCAR_MAX_SEEDS), needle->seed_count);
    for (int i = 0; i < needle->seed_count; i++) assert_int_equal(seeds[i].number, i);
    trocar_operator_free(op);
    return count;
}

/* The image is followed for the first seed only. The other seeds are at the planned distances from it, and those at equal distances are dropped at once. */
static void a_strand_follows_its_first_seed(void **state) {
    (void)state;
    const double tips[] = {0.0875, 0.0775, 0.0675, 0.0625}, shift = 4e-3;
    trocar_operator_needle needle = needle_at(0, 0);
    trocar_operator_action drops[4];
    needle.seeds = tips;
    needle.seed_count = 4;
    for (int follows = 0; follows < 2; follows++) {
        trocar_operator_options options = trocar_default_operator_options(follows);
        double first = tips[0] + follows * shift;
        options.image_error = options.splay = options.speed_spread = 0;
        options.strands = 1;
        for (int refusals = 0; refusals < 3; refusals++) {
            assert_int_equal(drops_of(&needle, &options, shift, refusals, drops), 2);
            assert_int_equal(drops[0].seeds, 3);
            assert_close(drops[0].spacing, 0.01, 1e-12);
            assert_close(drops[0].depth, first, 1e-12);
            assert_int_equal(drops[1].seeds, 1);
            assert_true(drops[1].spacing == 0.0);
            assert_close(drops[1].depth, first - (tips[0] - tips[3]) - 1e-3 * refusals, 1e-12);
        }
    }
}

static void a_long_strand_is_dropped_in_parts(void **state) {
    (void)state;
    double tips[18];
    for (int i = 0; i < 18; i++) tips[i] = 0.11 - 2 * HALF_SEED * i;
    trocar_operator_needle needle = needle_at(0, 0);
    trocar_operator_options options = trocar_default_operator_options(0);
    trocar_operator_action drops[18];
    needle.depth = tips[0];
    needle.seeds = tips;
    needle.seed_count = 18;
    options.strands = 1;
    assert_int_equal(drops_of(&needle, &options, 0, 0, drops), 2);
    assert_int_equal(drops[0].seeds, TROCAR_MAX_STRAND);
    assert_int_equal(drops[1].seeds, 2);
    assert_close(drops[1].depth, tips[TROCAR_MAX_STRAND], 1e-12);
}

/* In tissue that moves as a whole, each seed of a strand has the same error, which is the sum of its parts. */
static void errors_of_a_strand_are_split(void **state) {
    (void)state;
    static left_seed left[TROCAR_MAX_SEEDS];
    static trocar_operator_seed seeds[TROCAR_MAX_SEEDS];
    trocar_operator_options options = published(3);
    options.strands = 1;
    trocar_operator *op = create_operator(&options);
    int count = carry_out(op, (double[3]){1e-3, -2e-3, 5e-3}, left);
    assert_int_equal(count, NEEDLES * SEEDS);
    assert_int_equal(trocar_operator_seeds(op, seeds, TROCAR_MAX_SEEDS), count);
    for (int i = 0; i < count; i++)
        for (int a = 0; a < 3; a++) {
            assert_close(left[i].rest[a] - seeds[i].planned[a], seeds[i].tissue[a] + seeds[i].image[a] + seeds[i].splay[a], 1e-12);
            assert_true(seeds[i].image[a] == seeds[i / SEEDS * SEEDS].image[a]);
        }
    trocar_operator_free(op);
}

/* ---- misplacement ----------------------------------------------------------------------------------------------------------------------- */

/* In tissue that does not move, the misplacement along the needle is the image error, and the misplacement across it comes from the tilt. */
static void in_rigid_tissue_errors_are_those_drawn(void **state) {
    (void)state;
    static left_seed left[TROCAR_MAX_SEEDS];
    static trocar_operator_seed seeds[TROCAR_MAX_SEEDS];
    trocar_operator_options options = published(7);
    trocar_operator *op = create_operator(&options);
    int count = carry_out(op, (double[3]){0}, left);
    assert_int_equal(count, NEEDLES * SEEDS);
    assert_int_equal(trocar_operator_seeds(op, seeds, TROCAR_MAX_SEEDS), count);
    for (int i = 0; i < count; i++) {
        const trocar_operator_seed *s = &seeds[i];
        double error = left[i].rest[2] - s->planned[2];
        assert_int_equal(s->needle, left[i].needle);
        assert_int_equal(s->number, i % SEEDS);
        assert_close(s->planned[2], -0.025 + TIPS[s->number] - HALF_SEED, 1e-12);
        assert_close(error, seeds[i / SEEDS * SEEDS].image[2], 0.1e-3); /* the needle's image error; the tilt shortens it by up to 6 um */
        for (int a = 0; a < 3; a++) assert_close(left[i].rest[a] - s->planned[a], s->tissue[a] + s->image[a] + s->splay[a], 1e-12);
        assert_true(s->image[0] == 0.0 && s->image[1] == 0.0);
        for (int a = 0; a < 3; a++) assert_close(s->tissue[a], 0.0, 1e-12);
        double tilt = hypot(s->splay[0], s->splay[1]) / (TIPS[s->number] + s->image[2] - HALF_SEED - 0.5 * THICKNESS); /* tilt about the middle of the hole */
        assert_true(tilt > 0.0 && tilt <= LIMIT * (1.0 + 1e-9));
    }
    trocar_operator_free(op);
}

/* If the tissue moves as a whole, an operator who follows an error-free image misplaces a seed only by the motion across the needle. One who goes by the
   marks misplaces it by the whole motion. */
static void motion_is_followed_along_the_needle(void **state) {
    (void)state;
    static left_seed left[TROCAR_MAX_SEEDS];
    static trocar_operator_seed seeds[TROCAR_MAX_SEEDS];
    const double shift[3] = {1e-3, -2e-3, 5e-3};
    for (int follows = 0; follows < 2; follows++) {
        trocar_operator_options options = trocar_default_operator_options(follows);
        options.image_error = options.splay = 0;
        trocar_operator *op = create_operator(&options);
        int count = carry_out(op, shift, left);
        trocar_operator_seeds(op, seeds, TROCAR_MAX_SEEDS);
        for (int i = 0; i < count; i++)
            for (int a = 0; a < 3; a++) {
                double expected = follows && a == 2 ? 0.0 : -shift[a];
                assert_close(left[i].rest[a] - seeds[i].planned[a], expected, 1e-12);
                assert_close(seeds[i].tissue[a], expected, 1e-12);
                assert_true(seeds[i].image[a] == 0.0);
                assert_close(seeds[i].splay[a], 0.0, 1e-15);
            }
        trocar_operator_free(op);
    }
}

/* ---- random numbers ---------------------------------------------------------------------------------------------------------------------- */

/* Returns the image error (m) and the tilts (rad) of a needle without a guide, and the mean speed of its first stroke (m/s). */
static void drawn(const trocar_model *model, const trocar_operator_options *options, double numbers[4]) {
    trocar_operator_needle needle = needle_at(5, 1);
    needle.guide = -1;
    trocar_operator *op;
    OK(trocar_operator_create(model, &needle, 1, options, &op, &why));
    trocar_operator_sight sight = {0};
    trocar_operator_action action;
    for (int i = 0; i < 2; i++) {
        OK(trocar_operator_next(op, &sight, &action, &why));
        if (i == 0) sight.depth = action.depth;
    }
    trocar_pose base = trocar_operator_base(op, 0, 0.0);
    numbers[0] = action.depth - TIPS[0];
    numbers[1] = (needle.entry.position[0] - base.position[0]) / LENGTH;
    numbers[2] = (needle.entry.position[1] - base.position[1]) / LENGTH;
    numbers[3] = (action.depth - sight.depth) / action.duration;
    trocar_operator_free(op);
}

/* Checks the means, standard deviations and correlations of 4000 draws, each to within four standard errors. */
static void draws_have_the_stated_spreads(void **state) {
    (void)state;
    enum { DRAWS = 4000 };
    static double z[4][DRAWS];
    trocar_model *model = create_model();
    trocar_operator_options options = published(0);
    for (int i = 0; i < DRAWS; i++) {
        double numbers[4];
        options.seed = (uint64_t)i;
        drawn(model, &options, numbers);
        z[0][i] = numbers[0] / options.image_error;
        z[1][i] = numbers[1] / options.splay;
        z[2][i] = numbers[2] / options.splay;
        z[3][i] = (log(numbers[3] / options.speed) + 0.5 * options.speed_spread * options.speed_spread) / options.speed_spread;
        assert_true(numbers[3] > options.speed * 0.040 / 0.123 * (1 - 1e-9) && numbers[3] < options.speed * 0.280 / 0.123 * (1 + 1e-9));
    }
    for (int k = 0; k < 4; k++)
        for (int m = 0; m <= k; m++) {
            double mean = 0, product = 0;
            for (int i = 0; i < DRAWS; i++) mean += z[k][i] / DRAWS, product += z[k][i] * z[m][i] / DRAWS;
            assert_close(mean, 0.0, 4 / sqrt(DRAWS));
            assert_close(product, k == m ? 1.0 : 0.0, 4 * (k == m ? sqrt(2) : 1) / sqrt(DRAWS));
        }
    trocar_model_free(model);
}

static void the_same_seed_draws_the_same(void **state) {
    (void)state;
    static left_seed first[TROCAR_MAX_SEEDS], again[TROCAR_MAX_SEEDS], other[TROCAR_MAX_SEEDS];
    uint64_t seeds[3] = {5, 5, 6};
    left_seed *results[3] = {first, again, other};
    int count = 0;
    for (int i = 0; i < 3; i++) {
        trocar_operator_options options = published(seeds[i]);
        trocar_operator *op = create_operator(&options);
        count = carry_out(op, (double[3]){0}, results[i]);
        trocar_operator_free(op);
    }
    assert_memory_equal(first, again, (size_t)count * sizeof *first);
    for (int i = 0; i < count; i++) assert_true(first[i].rest[2] != other[i].rest[2]);
}

/* ---- refusals ------------------------------------------------------------------------------------------------------------------------------ */

static void refuse(const trocar_model *model, trocar_operator_needle needle, const trocar_operator_options *options, const char *words) {
    trocar_operator *op = (trocar_operator *)model;
    assert_int_equal(trocar_operator_create(model, &needle, 1, options, &op, &why), TROCAR_BAD_INPUT);
    assert_null(op);
    if (!strstr(why.text, words)) fail_msg("\"%s\" does not contain \"%s\"", why.text, words);
}

static void bad_input_is_refused(void **state) {
    (void)state;
    trocar_model *model = create_model();
    trocar_operator_needle needle = needle_at(0, SEEDS), bad = needle;
    trocar_operator_options options = published(1);
    trocar_operator *op;
    assert_int_equal(trocar_operator_create(model, &needle, 0, NULL, &op, &why), TROCAR_BAD_INPUT);
    bad.guide = 1, refuse(model, bad, NULL, "no guide 1: the scene has 1"), bad = needle;
    bad.depth = 0.21, refuse(model, bad, NULL, "a depth of 0.21 m"), bad = needle;
    bad.depth = 0.08, refuse(model, bad, NULL, "seed 0 is not behind"), bad = needle;
    bad.seed_count = 300, refuse(model, bad, NULL, "300 seeds"), bad = needle;
    const double close[] = {0.08, 0.077};
    options.strands = 1, bad.seeds = close, bad.seed_count = 2, refuse(model, bad, &options, "seeds 0 and 1 overlap"), bad = needle, options = published(1);
    bad.depth = 0.01, bad.seed_count = 0, refuse(model, bad, NULL, "would not be in the tissue"), bad = needle;
    options.image_error = NAN, refuse(model, needle, &options, "an image error"), options = published(1);
    options.splay = -1, refuse(model, needle, &options, "a splay"), options = published(1);
    options.speed = 0, refuse(model, needle, &options, "a speed"), options = published(1);
    options.speed_spread = 4, refuse(model, needle, &options, "a spread of speeds");
    trocar_operator_free(NULL);
    trocar_model_free(model);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(marks_are_followed_blindly), cmocka_unit_test(corrections_end), cmocka_unit_test(a_stuck_seed_ends_the_implant),
        cmocka_unit_test(stabilising_needles_come_first_and_last), cmocka_unit_test(a_strand_follows_its_first_seed),
        cmocka_unit_test(a_long_strand_is_dropped_in_parts), cmocka_unit_test(errors_of_a_strand_are_split), cmocka_unit_test(in_rigid_tissue_errors_are_those_drawn),
        cmocka_unit_test(motion_is_followed_along_the_needle), cmocka_unit_test(draws_have_the_stated_spreads), cmocka_unit_test(the_same_seed_draws_the_same),
        cmocka_unit_test(bad_input_is_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

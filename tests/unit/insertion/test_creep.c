/* Tests relaxing tissue: the forces on a held needle, and the after-effect of a load that has been removed, are compared with exact solutions. */
#include "insertion/laws/creep.h"
#include "lockstep.h"
#include "verification/random_hand.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static const relaxation_term SERIES[] = {{0.25, 0.15}, {0.15, 2.5}, {0.10, 30.0}};

/* Returns a scene with a rigid needle that sticks, so that a step of its base displaces the tissue by the same step. */
static simulation_config scene_with(bool relaxing) {
    simulation_config c = lockstep_config();
    c.needle.youngs_modulus = 2e18;
    for (int i = 0; i < c.region_count; i++) { /* it sticks */
        region_material *m = &c.regions[i].material;
        m->cutting_force = m->friction_static = m->friction_kinetic = 1e4;
    }
    c.relaxation_count = relaxing ? 3 : 0;
    memcpy(c.relaxation, SERIES, sizeof SERIES);
    return c;
}

static lockstep *engaged(const simulation_config *config) {
    lockstep *l = lockstep_engaged(config);
    assert_true(contacts_active(&l->state) > 5);
    return l;
}

static void check_held_step(double rate, double tolerance, vec3 way) {
    simulation_config relaxing = scene_with(true), elastic = scene_with(false);
    lockstep *l = engaged(&relaxing), *plain = engaged(&elastic);
    l->base.position = plain->base.position = v3_add(l->base.position, way);
    lockstep_tick(plain, plain->base, 1.0 / rate);
    double at_once = v3_norm(plain->wrench.force), worst = 0.0;
    assert_true(at_once > 0.05);
    for (int i = 1; i <= (int)(10.0 * rate); i++) {
        lockstep_tick(l, l->base, 1.0 / rate);
        double error = v3_norm(l->wrench.force) / at_once - relaxation_at(3, SERIES, i / rate);
        worst = fmax(worst, fabs(error));
    }
    printf("held step at %g Hz: %.2g off\n", rate, worst);
    assert_true(worst < tolerance);
    lockstep_free(plain);
    lockstep_free(l);
}

static void held_step_relaxes_as_given(void **unused) {
    (void)unused;
    check_held_step(1000, 1e-3, v3(2e-4, 1e-4, 0));
    check_held_step(250, 1e-2, v3(2e-4, 1e-4, 0));
    check_held_step(1000, 1e-3, v3(0, 0, 2e-4));
}

/* ---- a load that was removed ------------------------------------------------------------------------------------------------- */

enum { TICKS_HELD = 600, TICKS_AFTER = 2000, MOST_POINTS = 40 };

/* Computes the creep under a constant unit force by numerically integrating its convolution with the relaxation function. */
static double *creep_by_quadrature(double step, int steps) {
    double *j = calloc((size_t)steps + 1, sizeof *j);
    j[0] = 1.0;
    for (int n = 1; n <= steps; n++) {
        double sum = relaxation_at(3, SERIES, n * step);
        for (int i = 1; i < n; i++) sum += (j[i] - j[i - 1]) * relaxation_at(3, SERIES, (n - i + 0.5) * step);
        j[n] = j[n - 1] + (1.0 - sum) / relaxation_at(3, SERIES, 0.5 * step);
    }
    return j;
}

/* A held needle's forces at each tick, and the points where they act. */
typedef struct {
    int count, ticks;
    insertion_state state;       /* the needle's state, which holds the points */
    vec3 force[TICKS_HELD + 1][MOST_POINTS];
} load_history;

static void record(const lockstep *l, load_history *h) {
    h->state = l->state;
    h->ticks++;
    h->count = contacts_active(&l->state) + 1;
    for (int i = 0; i + 1 < h->count; i++) h->force[h->ticks][i] = l->state.contacts[l->state.refined.order[i]].force;
    h->force[h->ticks][h->count - 1] = tip_load(&l->state.tip);
}

/* Computes the nodal forces on the nominal mesh that displace elastic tissue in the same way as the recorded history displaces relaxing tissue, `later`
   ticks after the needle was removed. Each change in force is weighted by the creep since then. */
static void recover(const lockstep *l, const load_history *h, const double *creep, int later, vec3 *nominal) {
    for (int i = 0; i < h->count; i++) {
        vec3 sum = v3(0, 0, 0);
        for (int n = 1; n <= h->ticks; n++) sum = v3_axpy(creep[h->ticks - n + 1 + later], v3_sub(h->force[n][i], h->force[n - 1][i]), sum);
        sum = v3_axpy(-creep[later], h->force[h->ticks][i], sum);
        const added_node *node = &h->state.refined.nodes[h->state.refined.order[i]];
        bool tip = i + 1 == h->count;
        int tet = tip ? h->state.tip.known.tet : node->tet;
        double weights[4];
        if (tip) memcpy(weights, h->state.tip.known.weights, sizeof weights);
        else mesh_barycentric(&l->parts.mesh, tet, node->position, weights);
        for (int c = 0; c < 4; c++) {
            vec3 *corner = &nominal[l->parts.mesh.tets[tet][c]];
            *corner = v3_axpy(weights[c], sum, *corner);
        }
    }
}

/* Removes the needle in an instant and puts it back, straight, at `base`. Unlike a reset, this keeps the loads that the tissue remembers. */
static void replace_needle(lockstep *l, pose base) {
    creep_deposit_all(&l->parts.insertion, &l->state.memory, NULL);
    tissue_memory memory = l->state.memory;
    insertion_reset(&l->parts.insertion, base, &l->state);
    l->state.memory = memory;
}

static void removed_load_recovers(void **unused) {
    (void)unused;
    simulation_config c = scene_with(true);
    lockstep *l = engaged(&c);
    load_history *h = calloc(1, sizeof *h);
    size_t nodes = (size_t)l->parts.mesh.node_count;
    vec3 *expected = calloc(nodes, sizeof *expected), *found = calloc(nodes, sizeof *found), added[MAX_CONTACTS];
    double *creep = creep_by_quadrature(1e-3, TICKS_HELD + TICKS_AFTER + 1);
    l->base.position = v3_add(l->base.position, v3(1e-3, 0.5e-3, 0));
    for (int i = 0; i < TICKS_HELD; i++) {
        lockstep_tick(l, l->base, 1e-3);
        record(l, h);
    }
    pose out = lockstep_start();
    replace_needle(l, out);
    double worst = 0.0, window = 0.0, largest = 0.0;
    for (int later = 1; later <= TICKS_AFTER; later++) {
        lockstep_tick(l, out, 1e-3);
        if (later % 250 != 0 && later != 20) continue;
        memset(expected, 0, nodes * sizeof *expected);
        recover(l, h, creep, later, expected);
        inverse_apply(l->parts.inverse, expected, expected);
        run_displacement(&l->run, &l->state, found, added);
        double size = 0.0, off = 0.0;
        for (size_t i = 0; i < nodes; i++) size = fmax(size, v3_norm(expected[i])), off = fmax(off, v3_norm(v3_sub(found[i], expected[i])));
        worst = fmax(worst, off / size);
        largest = fmax(largest, size);
        for (int k = 0; k < MAX_WINDOW; k++) { /* also compares the displacements the tick reads from the worker's answer */
            int node = l->snapshot->window[k];
            if (node >= 0) window = fmax(window, v3_norm(v3_sub(creep_free(&(tick_input){.model = &l->parts.insertion, .snapshot = l->snapshot},
                &l->state, &l->run.workspace->creep, MAX_CONTACTS + k), expected[node])) / size);
        }
    }
    printf("removed load: up to %.3g mm, %.2g off, at the handles %.2g\n", 1e3 * largest, worst, window);
    assert_true(largest > 1e-5);
    assert_true(worst < 1e-2 && window < 1e-2);
    free(creep), free(expected), free(found), free(h);
    lockstep_free(l);
}

/* ---- a needle that moves ------------------------------------------------------------------------------------------------- */

static void tick_along(lockstep *l, const hand_leg *leg, pose from, int i) {
    lockstep_tick(l, hand_pose(leg, from, NEEDLE_LENGTH - l->wrench.depth, i * 1e-3), 1e-3);
}

/* Whatever the needle does, the remembered loads of each relaxation term add up to the exponentially filtered sum of the forces on the tissue. */
static void nothing_remembered_is_lost(void **unused) {
    (void)unused;
    random_hand hand = random_hand_create(5);
    simulation_config c = lockstep_config();
    c.needle.bevel_slope = hand.bevel_slope;
    c.relaxation_count = 3;
    memcpy(c.relaxation, SERIES, sizeof SERIES);
    lockstep *l = lockstep_create(&c, hand.start);
    const creep_series *creep = &l->parts.insertion.creep;
    vec3 expected[3] = {{0, 0, 0}};
    double largest = 0.0, worst = 0.0;
    for (int leg = 0; leg < hand.leg_count; leg++) {
        pose from = l->base;
        for (int i = 1; i <= (int)(hand.legs[leg].seconds * 1e3); i++) {
            tick_along(l, &hand.legs[leg], from, i);
            const insertion_state *s = &l->state;
            vec3 sum = s->tip.place.phase == TIP_INSIDE ? tip_load(&s->tip) : v3(0, 0, 0);
            for (int k = 0; contact_is_active(s, k); k++) sum = v3_add(sum, s->contacts[s->refined.order[k]].force);
            for (int k = 0; k < creep->count; k++) {
                double decay = exp(-1e-3 / creep->time[k]);
                expected[k] = v3_add(v3_scale(decay, expected[k]), v3_scale(1.0 - decay, sum));
                vec3 found = v3(0, 0, 0);
                for (int n = 0; n < s->memory.count; n++) found = v3_add(found, s->memory.shares[n].terms[k].load);
                for (int n = 0; n < s->memory.residual.count; n++) found = v3_add(found, s->memory.residual.loads[n].load[k]);
                worst = fmax(worst, v3_norm(v3_sub(found, expected[k])));
                largest = fmax(largest, v3_norm(expected[k]));
            }
        }
    }
    printf("remembered: up to %.3g N, %.2g N off\n", largest, worst);
    assert_true(largest > 0.05);
    assert_true(worst < 1e-6); /* not zero, because residual loads below 1e-9 N are discarded */
    lockstep_free(l);
}

/* A run that continues from a saved state with residual loads is bit-identical, whether in the same simulation after a detour or in another one, and even
   after the needle was replaced. */
static void restored_memory_continues_bit_identically(void **unused) {
    (void)unused;
    simulation_config c = scene_with(true);
    c.needle = lockstep_config().needle;
    c.needle.bevel_slope = 0.05;
    memcpy(c.regions, lockstep_config().regions, sizeof c.regions);
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.050), 0.8, 1e-3);
    lockstep_move(l, v3(0.001, 0, -0.020), 0.2, 1e-3);
    assert_true(l->state.memory.residual.count > 5);
    checkpoint *saved = malloc(sizeof *saved);
    tick_output first[3][20];
    for (int run = 0; run < 3; run++) {
        trocar_error why;
        if (run == 0) run_save(&l->state, l->snapshot, saved);
        if (run == 1) lockstep_move(l, v3(0, 0.002, 0.030), 0.5, 1e-3); /* a detour */
        if (run == 2) {
            lockstep *other = lockstep_create(&c, lockstep_start());
            lockstep_free(l);
            l = other;
        }
        if (run > 0) assert_int_equal(run_restore(&l->run, saved, &l->state, l->snapshot, &why), TROCAR_OK);
        l->base = l->state.needle.base;
        for (int i = 0; i < 20; i++) {
            lockstep_move(l, v3(0, 0, i < 7 ? 0.005 : -0.005), 0.1, 1e-3);
            if (i == 14) replace_needle(l, l->base);
            first[run][i] = l->wrench;
        }
    }
    assert_true(v3_norm(first[0][10].force) > 0.05);
    for (int run = 1; run < 3; run++)
        for (int i = 0; i < 20; i++) {
            assert_memory_equal(&first[0][i].force, &first[run][i].force, sizeof(vec3));
            assert_memory_equal(&first[0][i].torque, &first[run][i].torque, sizeof(vec3));
        }
    free(saved);
    lockstep_free(l);
}

/* If a needle is inserted again while the tissue still remembers an earlier insertion, it is pushed toward the earlier position, with a force that fades. */
static void needle_feels_what_was_left(void **unused) {
    (void)unused;
    simulation_config c = scene_with(true);
    lockstep *l = engaged(&c);
    pose start = l->base;
    lockstep_move(l, v3(1e-3, 0, 0), 1e-3, 1e-3);
    lockstep_move(l, v3(0, 0, 0), 0.6, 1e-3);
    replace_needle(l, start); /* inserted again at once, where the tissue was at rest */
    for (int i = 0; i < 3; i++) lockstep_tick(l, start, 1e-6);
    double at_once = l->wrench.force.x;
    assert_true(at_once > 1e-3); /* the tissue is still displaced toward where it was held */
    lockstep_move(l, v3(0, 0, 0), 5.0, 1e-3);
    assert_true(l->wrench.force.x > 0.0 && l->wrench.force.x < 0.5 * at_once);
    lockstep_free(l);
}

/* After a reset no force is left, not even from an earlier answer of the worker. */
static void forgotten_loads_are_not_felt(void **unused) {
    (void)unused;
    simulation_config c = scene_with(true);
    lockstep *l = engaged(&c), *untouched = engaged(&c);
    pose start = l->base;
    lockstep_move(l, v3(1e-3, 0, 0), 1e-3, 1e-3);
    lockstep_move(l, v3(0, 0, 0), 0.6, 1e-3);
    replace_needle(l, start);
    l->base = start;
    lockstep_move(l, v3(0, 0, 0), 0.1, 1e-3);
    assert_true(l->snapshot->has_residuals && l->wrench.force.x > 1e-3);
    insertion_reset(&l->parts.insertion, start, &l->state);
    insertion_reset(&untouched->parts.insertion, start, &untouched->state);
    for (int i = 0; i < 20; i++) {
        lockstep_tick(l, start, 1e-3);
        lockstep_tick(untouched, start, 1e-3);
        assert_true(v3_norm(v3_sub(l->wrench.force, untouched->wrench.force)) < 1e-12);
    }
    lockstep_free(untouched);
    lockstep_free(l);
}

static void elastic_tissue_remembers_nothing(void **unused) {
    (void)unused;
    static const tissue_memory nothing;
    simulation_config c = lockstep_config();
    lockstep *l = lockstep_create(&c, lockstep_start());
    lockstep_move(l, v3(0, 0, 0.050), 0.5, 1e-3);
    lockstep_move(l, v3(0, 0, -0.030), 0.3, 1e-3);
    assert_memory_equal(&l->state.memory, &nothing, sizeof nothing);
    assert_false(l->snapshot->has_residuals);
    lockstep_free(l);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(held_step_relaxes_as_given),
        cmocka_unit_test(removed_load_recovers),
        cmocka_unit_test(nothing_remembered_is_lost),
        cmocka_unit_test(restored_memory_continues_bit_identically),
        cmocka_unit_test(needle_feels_what_was_left),
        cmocka_unit_test(forgotten_loads_are_not_felt),
        cmocka_unit_test(elastic_tissue_remembers_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

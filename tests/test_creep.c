/* Tissue that relaxes: a held needle, and what is left of a load that was removed, against the exact solutions. */
#include "insertion/creep.h"
#include "lockstep.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

static const relaxation_term SERIES[] = {{0.25, 0.15}, {0.15, 2.5}, {0.10, 30.0}};

/* A rigid needle, so that a step of its base is a step of the tissue's strain. */
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

/* 60 mm deep, without force. */
static lockstep *engaged(const simulation_config *config) {
    pose start = lockstep_start();
    start.position.z += 0.061;
    lockstep *l = lockstep_create(config, start);
    for (int i = 0; i < 3; i++) lockstep_tick(l, start, 1e-6);
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

/* Creep under a held force of 1, by quadrature of its convolution with the relaxation function. */
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

/* The forces of a held needle, tick by tick, and where they act. */
typedef struct {
    int count, ticks;
    insertion_state state;       /* with the points */
    vec3 force[TICKS_HELD + 1][MOST_POINTS];
} load_history;

static void record(const lockstep *l, load_history *h) {
    h->state = l->state;
    h->ticks++;
    h->count = contacts_active(&l->state) + 1;
    for (int i = 0; i + 1 < h->count; i++) h->force[h->ticks][i] = l->state.contacts[l->state.refined.order[i]].force;
    h->force[h->ticks][h->count - 1] = tip_load(&l->state.tip);
}

/* Nodal forces on the nominal mesh that would displace elastic tissue as the history does relaxing tissue, `later` ticks after the needle
   has gone: each change of force counts by the creep since then. */
static void recover(const lockstep *l, const load_history *h, const double *creep, int later, vec3 *nominal) {
    for (int i = 0; i < h->count; i++) {
        vec3 sum = v3(0, 0, 0);
        for (int n = 1; n <= h->ticks; n++) sum = v3_axpy(creep[h->ticks - n + 1 + later], v3_sub(h->force[n][i], h->force[n - 1][i]), sum);
        sum = v3_axpy(-creep[later], h->force[h->ticks][i], sum);
        const added_node *node = &h->state.refined.nodes[h->state.refined.order[i]];
        bool tip = i + 1 == h->count;
        int tet = tip ? h->state.tip.known_tet : node->tet;
        double weights[4];
        if (tip) memcpy(weights, h->state.tip.known_weights, sizeof weights);
        else mesh_barycentric(&l->simulation.mesh, tet, node->position, weights);
        for (int c = 0; c < 4; c++) {
            vec3 *corner = &nominal[l->simulation.mesh.tets[tet][c]];
            *corner = v3_axpy(weights[c], sum, *corner);
        }
    }
}

/* The needle is taken out at once by a reset. */
static void removed_load_recovers(void **unused) {
    (void)unused;
    simulation_config c = scene_with(true);
    lockstep *l = engaged(&c);
    load_history *h = calloc(1, sizeof *h);
    size_t nodes = (size_t)l->simulation.mesh.node_count;
    vec3 *expected = calloc(nodes, sizeof *expected), *found = calloc(nodes, sizeof *found), added[MAX_CONTACTS];
    double *creep = creep_by_quadrature(1e-3, TICKS_HELD + TICKS_AFTER + 1);
    l->base.position = v3_add(l->base.position, v3(1e-3, 0.5e-3, 0));
    for (int i = 0; i < TICKS_HELD; i++) {
        lockstep_tick(l, l->base, 1e-3);
        record(l, h);
    }
    pose out = lockstep_start();
    insertion_reset(&l->simulation.insertion, out, &l->state);
    double worst = 0.0, window = 0.0, largest = 0.0;
    for (int later = 1; later <= TICKS_AFTER; later++) {
        lockstep_tick(l, out, 1e-3);
        if (later % 250 != 0 && later != 20) continue;
        memset(expected, 0, nodes * sizeof *expected);
        recover(l, h, creep, later, expected);
        inverse_apply(l->simulation.inverse, expected, expected);
        simulation_displacement(&l->simulation, &l->state, found, added);
        double size = 0.0, off = 0.0;
        for (size_t i = 0; i < nodes; i++) size = fmax(size, v3_norm(expected[i])), off = fmax(off, v3_norm(v3_sub(found[i], expected[i])));
        worst = fmax(worst, off / size);
        largest = fmax(largest, size);
        for (int k = 0; k < MAX_WINDOW; k++) { /* what the worker tells the tick */
            int node = l->snapshot->window[k];
            if (node >= 0) window = fmax(window, v3_norm(v3_sub(creep_free(&(tick_context){.model = &l->simulation.insertion, .snapshot = l->snapshot,
                .scratch = l->simulation.workspace}, MAX_CONTACTS + k), expected[node])) / size);
        }
    }
    printf("removed load: up to %.3g mm, %.2g off, at the handles %.2g\n", 1e3 * largest, worst, window);
    assert_true(largest > 1e-5);
    assert_true(worst < 1e-2 && window < 1e-2);
    free(creep), free(expected), free(found), free(h);
    lockstep_free(l);
}

int main(void) {
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(held_step_relaxes_as_given),
        cmocka_unit_test(removed_load_recovers),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}

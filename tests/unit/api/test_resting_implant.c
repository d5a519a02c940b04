/* Compares a whole implant, in which needles slip, with the solution of one contact problem for all resting needles. The needles are inserted and released
   one after another, then taken and withdrawn in the same order.

   The library lets one needle slip at a time, at 250 Hz. In the reference run, this is disabled. Instead, after each 1 ms tick, the slips of all points of
   all needles are solved together by projected Gauss-Seidel, until no force exceeds its friction limit by more than 1e-10 N; the next tick uses the result.
   The dense compliance of needles, template and tissue is assembled here from the model's inverse. test_resting.c shows that sticking needles and the held
   needle are solved as one problem, and measures the error due to linearising a slipping needle.

   usage: [SCENE=NAME] [NEEDLES=N] [DEPTH=N] [TICKS=N] test_unit test_resting_implant

   By default, a short implant: figure8.yaml, 4 needles, 30 mm. TICKS is the number of ticks per ms in the reference run, by default 1. */
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <lapacke.h>

#include "api/worker_answer.h"
#include "api/worker_resting.h"

#include <cmocka.h>

static trocar_error why;

#define OK(call) do { if ((call) != TROCAR_OK) fail_msg("%s: %s", #call, why.text); } while (0)

enum { STILL = 20, CLEAR = 5, SETTLE = 20, MOST_SWEEPS = 20000 };
static const double WITHIN = 1e-10; /* N */

static struct { const char *scene; int needles, depth, substeps; } implant = {"figure8.yaml", 4, 30, 1};

/* ---- the reference ----------------------------------------------------------------------------------------------------------- */

/* The single contact problem of all needles that currently rest, in the order of the library's set. */
typedef struct {
    uint64_t id[MAX_NEEDLES];      /* for each needle of the scene, its id when it last rested */
    double lower[MAX_NEEDLES][MAX_AXIAL], upper[MAX_NEEDLES][MAX_AXIAL]; /* N, force limits; the library's own are set to infinity in the reference run */
    uint64_t changes;        /* the set's change counter when this was assembled */
    int rows, motions, axials;
    int *row, *needle, *axial; /* for each axial force: its row, its needle in the set, and its index within the needle */
    double *response;        /* response of rows and base motions to a unit slip at each axial force, column-major */
    double slipped;          /* m, largest slip at any point */
} one_problem;

/* Returns the compliance between two rows, using the shape functions at each row's point. */
static double between(trocar_model *model, const attached_row *a, const attached_row *b) {
    double blocks[12 * 12], sum = 0.0;
    if (a->tet < 0 || b->tet < 0) return 0.0;
    const mesh *m = &model->parts.mesh;
    OK(inverse_gather(model->parts.inverse, &(inverse_blocks){4, m->tets[a->tet], 4, m->tets[b->tet], blocks, 12}, &why));
    const double u[] = {a->direction.x, a->direction.y, a->direction.z}, v[] = {b->direction.x, b->direction.y, b->direction.z};
    for (int c = 0; c < 144; c++) sum += a->weights[c / 36] * u[c / 12 % 3] * blocks[c] * v[c % 3] * b->weights[c % 12 / 3];
    return sum;
}

static void forget(one_problem *p) {
    free(p->row);
    free(p->needle);
    free(p->axial);
    free(p->response);
    p->row = p->needle = p->axial = NULL;
    p->response = NULL;
}

/* Assembles (G + C) df = R q - s, R^T df = 0, and solves for unit slips. */
static void assemble(trocar_sim *sim, one_problem *p) {
    const resting_set *set = &sim->resting;
    forget(p);
    p->rows = p->motions = p->axials = 0;
    for (int k = 0; k < set->count; k++) {
        assert_int_equal(set->row[k], p->rows);
        p->rows += set->needles[k]->unknown_count;
        p->motions += set->needles[k]->motion_count;
        p->axials += set->needles[k]->axial_count;
    }
    size_t n = (size_t)(p->rows + p->motions);
    p->row = calloc((size_t)p->axials + 1, sizeof *p->row);
    p->needle = calloc((size_t)p->axials + 1, sizeof *p->needle);
    p->axial = calloc((size_t)p->axials + 1, sizeof *p->axial);
    p->response = calloc(n * (size_t)p->axials + 1, sizeof *p->response);
    if (n == 0) return;
    double *system = calloc(n * n, sizeof *system);
    lapack_int *pivots = malloc(n * sizeof *pivots);
    int axial = 0, motion = p->rows;
    for (int k = 0; k < set->count; k++) {
        const resting_needle *r = set->needles[k];
        size_t first = (size_t)set->row[k];
        static double nearby[MAX_UNKNOWNS * MAX_UNKNOWNS];
        for (int l = 0; l < k; l++) { /* adds the compliance between the two needles that is finer than the mesh */
            OK(resting_mutual(sim->pairs, r, set->needles[l], nearby, MAX_UNKNOWNS, &why));
            for (int u = 0; u < r->unknown_count; u++)
                for (int v = 0; v < set->needles[l]->unknown_count; v++) {
                    system[((size_t)set->row[l] + (size_t)v) * n + first + (size_t)u] += nearby[u * MAX_UNKNOWNS + v];
                    system[(first + (size_t)u) * n + (size_t)set->row[l] + (size_t)v] += nearby[u * MAX_UNKNOWNS + v];
                }
        }
        for (int u = 0; u < r->unknown_count; u++) {
            for (int v = 0; v < r->unknown_count; v++) system[(first + (size_t)v) * n + first + (size_t)u] += u > v ? r->compliance[u][v] : r->compliance[v][u];
            for (int l = 0; l < set->count; l++)
                for (int v = 0; v < set->needles[l]->unknown_count; v++)
                    system[((size_t)set->row[l] + (size_t)v) * n + first + (size_t)u] += between(sim->model, &r->rows[u], &set->needles[l]->rows[v]);
            for (int q = 0; q < r->motion_count; q++) {
                system[(size_t)(motion + q) * n + first + (size_t)u] = -r->motions[q][u];
                system[(first + (size_t)u) * n + (size_t)(motion + q)] = r->motions[q][u];
            }
        }
        for (int i = 0; i < r->axial_count; i++, axial++) {
            p->row[axial] = (int)first + 2 * r->point_count + i;
            p->needle[axial] = k;
            p->axial[axial] = i;
            p->response[(size_t)axial * n + (size_t)p->row[axial]] = -1.0;
        }
        motion += r->motion_count;
    }
    assert_int_equal(LAPACKE_dgesv(LAPACK_COL_MAJOR, (lapack_int)n, p->axials, system, (lapack_int)n, pivots, p->response, (lapack_int)n), 0);
    free(system);
    free(pivots);
}

/* Copies the force limits of needles released since the last call, and sets them to infinity in the library. */
static void take_bounds(trocar_sim *sim, one_problem *p) {
    for (int k = 0; k < sim->needle_count; k++) {
        resting_needle *r = sim->needles[k].resting;
        if (!sim->needles[k].attached || p->id[k] == r->id) continue;
        p->id[k] = r->id;
        memcpy(p->lower[k], r->lower, sizeof r->lower);
        memcpy(p->upper[k], r->upper, sizeof r->upper);
        for (int i = 0; i < r->axial_count; i++) r->upper[i] = INFINITY, r->lower[i] = -INFINITY;
    }
}

static int of_scene(const trocar_sim *sim, const resting_needle *r) {
    for (int k = 0; k < sim->needle_count; k++)
        if (sim->needles[k].resting == r) return k;
    fail();
    return -1;
}

/* Computes an axial force's current limits, which decrease as the needle slides. */
static void bounds_of(const trocar_sim *sim, const one_problem *p, int a, double *lower, double *upper) {
    resting_needle *r = sim->resting.needles[p->needle[a]];
    int k = of_scene(sim, r), i = p->axial[a];
    r->lower[i] = p->lower[k][i], r->upper[i] = p->upper[k][i];
    *lower = resting_lower(&sim->model->parts.insertion, r, i);
    *upper = resting_upper(&sim->model->parts.insertion, r, i);
    r->lower[i] = -INFINITY, r->upper[i] = INFINITY;
}

/* Solves for the slips of all needles together, and applies them. */
static void slip_together(trocar_sim *sim, one_problem *p) {
    resting_set *set = &sim->resting;
    take_bounds(sim, p);
    if (p->changes != set->changes) assemble(sim, p), p->changes = set->changes;
    if (set->count == 0) return;
    size_t n = (size_t)(p->rows + p->motions), m = (size_t)p->axials;
    double *force = malloc(m * sizeof *force), *lower = malloc(m * sizeof *lower), *upper = malloc(m * sizeof *upper), *slip = calloc(m, sizeof *slip);
    for (int a = 0; a < p->axials; a++) {
        const resting_needle *r = set->needles[p->needle[a]];
        force[a] = r->force[2 * r->point_count + p->axial[a]];
        bounds_of(sim, p, a, &lower[a], &upper[a]);
    }
    bool done = false;
    for (int sweep = 0; sweep < MOST_SWEEPS && !done; sweep++) {
        done = true;
        for (int a = 0; a < p->axials; a++) {
            const double *column = p->response + (size_t)a * n;
            double yields = -column[p->row[a]], alone = force[a] + yields * slip[a];
            if (!(yields > 1e-3)) continue; /* N/m; if smaller, slipping does not relieve this point */
            double now = alone > upper[a] ? (alone - upper[a]) / yields : alone < lower[a] ? (alone - lower[a]) / yields : 0.0, more = now - slip[a];
            if (more == 0.0) continue;
            for (int b = 0; b < p->axials; b++) force[b] += column[p->row[b]] * more;
            slip[a] = now;
            done = done && yields * fabs(more) < WITHIN;
        }
    }
    assert_true(done);
    for (int a = 0; a < p->axials; a++) {
        if (slip[a] == 0.0) continue;
        const double *column = p->response + (size_t)a * n;
        resting_needle *slips = set->needles[p->needle[a]];
        slips->slip[p->axial[a]] += slip[a];
        slips->slid[p->axial[a]] += fabs(slip[a]);
        p->slipped = fmax(p->slipped, slips->slid[p->axial[a]]);
        for (int k = 0; k < set->count; k++) {
            resting_needle *r = set->needles[k];
            for (int u = 0; u < r->unknown_count; u++) r->free_force[u] += column[set->row[k] + u] * slip[a], r->force[u] += column[set->row[k] + u] * slip[a];
            for (int q = 0; q < r->motion_count; q++) {
                double moved = column[p->rows + set->motion[k] + q] * slip[a];
                r->free_motion[q] += moved, r->motion[q] += moved;
            }
        }
    }
    for (int k = 0; k < set->count; k++)
        for (int u = 0; u < set->needles[k]->unknown_count; u++) set->load[set->row[k] + u] = set->needles[k]->free_force[u] + set->needles[k]->beside[u];
    set->shifts++;
    free(force);
    free(lower);
    free(upper);
    free(slip);
}

/* ---- the implant ---------------------------------------------------------------------------------------------------------------- */

typedef struct {
    int count;
    double (*hand)[3];       /* N, on the hand, at each millisecond */
    int *punctures;          /* so far */
    /* N, axial forces that the first needle exerts on tissue and template while it rests: sum of the positive ones, sum of the negative ones, and largest
       magnitude */
    double (*rests)[3];
    int broken;              /* membranes punctured so far */
    double slid;             /* m, largest sliding distance of any point */
} record;

static void note(const trocar_sim *sim, const trocar_output *out, record *r) {
    memcpy(r->hand[r->count], out->force, sizeof out->force);
    r->punctures[r->count] = r->broken;
    double *f = r->rests[r->count++];
    f[0] = f[1] = f[2] = 0.0;
    if (!sim->needles[0].attached) return;
    const resting_needle *first = sim->needles[0].resting;
    for (int i = 0; i < first->axial_count; i++) {
        double along = first->force[2 * first->point_count + i];
        f[along < 0.0] += along;
        f[2] = fmax(f[2], fabs(along));
    }
}

/* 1 ms. */
static void tick(trocar_sim *sim, int needle, const trocar_pose *from, const trocar_pose *to, one_problem *reference, record *r) {
    trocar_output out;
    int substeps = reference ? implant.substeps : 1;
    for (int k = 1; k <= substeps; k++) {
        trocar_pose base = *to;
        for (int a = 0; a < 3; a++) base.position[a] = from->position[a] + (to->position[a] - from->position[a]) * k / substeps;
        OK(trocar_sim_step(sim, needle, &base, 1e-3 / substeps, &out, &why));
        r->broken += (out.events & TROCAR_EVENT_PUNCTURED) != 0;
        if (!reference) continue;
        OK(respond_to_loads(sim, true, &why));
        slip_together(sim, reference);
        OK(answer_fully(sim, needle, &sim->needles[needle].state.request, &why));
        link_publish_answer(&sim->needles[needle].link);
    }
    note(sim, &out, r);
}

static void move(trocar_sim *sim, int needle, trocar_pose *base, double way, int ticks, one_problem *reference, record *r) {
    for (int t = 0; t < ticks; t++) {
        trocar_pose before = *base;
        base->position[2] += way / ticks;
        tick(sim, needle, &before, base, reference, r);
    }
}

/* Returns the base's pose for hole k. The holes are 5 mm apart, starting from the middle. */
static trocar_pose hole(int k) {
    static const int columns[] = {0, 1, -1, 0, 1, -1, 0, 1, -1}, rows[] = {0, 0, 0, 1, 1, 1, -1, -1, -1};
    return (trocar_pose){{5e-3 * columns[k % 9], 5e-3 * rows[k % 9], -0.201}, {1, 0, 0, 0}};
}

static void run(trocar_model *model, one_problem *reference, record *r) {
    const trocar_pose away = {{0, 0, -10}, {1, 0, 0, 0}};
    trocar_sim *sim;
    OK(trocar_sim_create(model, &sim, &why));
    for (int k = 0; k < implant.needles; k++) OK(trocar_sim_reset(sim, k, &away, &why));
    for (int k = 0; k < implant.needles; k++) {
        trocar_pose base = hole(k);
        OK(trocar_sim_reset(sim, k, &base, &why));
        move(sim, k, &base, 1e-3 * implant.depth, 10 * implant.depth, reference, r);
        move(sim, k, &base, 0.0, STILL, reference, r);
        OK(trocar_sim_leave(sim, k, &why));
        OK(trocar_sim_work(sim, NULL, &why));
        if (reference) slip_together(sim, reference);
    }
    for (int k = 0; k < implant.needles; k++) {
        for (int i = 0; i < sim->needles[k].resting->axial_count; i++) r->slid = fmax(r->slid, sim->needles[k].resting->slid[i]);
        OK(trocar_sim_take(sim, k, &why));
        OK(trocar_sim_work(sim, NULL, &why));
        trocar_pose base = trocar_view_base(trocar_sim_view(sim), k);
        move(sim, k, &base, -1e-3 * (implant.depth + CLEAR), 10 * (implant.depth + CLEAR), reference, r);
        OK(trocar_sim_reset(sim, k, &away, &why));
        OK(trocar_sim_work(sim, NULL, &why));
        if (reference) slip_together(sim, reference);
    }
    trocar_sim_free(sim);
    if (reference) forget(reference);
}

static double norm(const double f[3]) { return sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2]); }

static void slipping_needles_are_near_one_problem(void **state) {
    (void)state;
    static one_problem reference;
    char path[512], count[16];
    trocar_scene *scene;
    trocar_model *model;
    record library = {0}, exact = {0};
    size_t room = (size_t)(implant.needles * (20 * implant.depth + 10 * CLEAR + STILL));
    for (record *r = &library; r; r = r == &library ? &exact : NULL) r->hand = calloc(room, sizeof *r->hand), r->rests = calloc(room, sizeof *r->rests), r->punctures = calloc(room, sizeof *r->punctures);
    snprintf(path, sizeof path, MESHES "/%s", implant.scene);
    snprintf(count, sizeof count, "%d", implant.needles);
    OK(trocar_scene_load(path, &scene, &why));
    OK(trocar_scene_set(scene, "needles", count, &why));
    OK(trocar_model_create(scene, NULL, &model, &why));
    run(model, NULL, &library);
    run(model, &reference, &exact);
    assert_int_equal(library.count, exact.count);
    double worst = 0.0, peak = 0.0, squares = 0.0, off = 0.0, largest = 0.0;
    int at = 0, apart = 0, latest = 0, settling = 0, left_out = 0;
    for (int t = 0; t < exact.count; t++) {
        double d[3];
        bool differ = library.punctures[t] != exact.punctures[t];
        apart = differ ? apart + 1 : 0;
        latest = apart > latest ? apart : latest;
        settling = differ ? SETTLE : settling - 1;
        if (settling > 0) { /* one run punctures a membrane slightly earlier than the other, so the same drop in force occurs at different times */
            left_out++;
            continue;
        }
        for (int a = 0; a < 3; a++) d[a] = library.hand[t][a] - exact.hand[t][a];
        if (norm(d) > worst) worst = norm(d), at = t;
        squares += norm(d) * norm(d);
        peak = fmax(peak, norm(exact.hand[t]));
        off = fmax(off, fabs(library.rests[t][2] - exact.rests[t][2]));
        largest = fmax(largest, exact.rests[t][2]);
    }
    print_message("%s, %d needles, %d mm deep, %d ms: slid by up to %.2f mm (reference %.2f mm); force on the hand within %.4f N of up to %.3f N (%.2f %%, after %d ms), "
                  "rms %.4f N; membranes break up to %d ms apart (%d ms around that left out); largest force along the first one at rest within %.4f N of up to %.3f N\n",
                  implant.scene, implant.needles, implant.depth, exact.count, 1e3 * library.slid, 1e3 * reference.slipped, worst, peak, 100.0 * worst / peak, at,
                  sqrt(squares / exact.count), latest, left_out, off, largest);
    for (int t = at - 4; getenv("VERBOSE") && t < at + 12; t++)
        print_message("%d: %.4f %.4f %d %d\n", t, library.hand[t][2], exact.hand[t][2], library.punctures[t], exact.punctures[t]);
    assert_true(library.slid > 1e-5); /* at least one friction limit was exceeded */
    assert_true(worst < 0.05 * peak && latest <= 5);
    for (record *r = &library; r; r = r == &library ? &exact : NULL) free(r->hand), free(r->rests), free(r->punctures);
    trocar_model_free(model);
    trocar_scene_free(scene);
}

int main(void) {
    const struct CMUnitTest tests[] = {cmocka_unit_test(slipping_needles_are_near_one_problem)};
    const struct { const char *name; int *value; } numbers[] = {{"NEEDLES", &implant.needles}, {"DEPTH", &implant.depth}, {"TICKS", &implant.substeps}};
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        if (getenv(numbers[i].name)) *numbers[i].value = atoi(getenv(numbers[i].name));
    if (getenv("SCENE")) implant.scene = getenv("SCENE");
    return cmocka_run_group_tests(tests, NULL, NULL);
}

/* Measures the largest change in the base force per tick at 1 kHz, in random insertions with steering, retraction and reinsertion, on several meshes. People
   notice changes of 7 %, or of 0.05 N if the force is small. In stiffening tissue, the force must also keep rising while a sticking needle is pushed. */
#include "lockstep.h"
#include "random_hand.h"
#include "rows.h"

static const double TICK = 1e-3;              /* s */
static const double NOTICED = 0.07, NOTICED_LEAST = 0.05; /* just noticeable difference in force: as a fraction, and in N */
static const int RECOIL = 25;                 /* largest number of ticks for which a needle springs forward after a puncture */
enum { BINS = 400, BINS_PER_DECADE = 80 };
static const double FIRST_BIN = 1e-4;

/* Histogram of changes, in just noticeable differences, with logarithmic bins. */
typedef struct {
    double largest;
    long count, excesses;
    long bins[BINS];
} distribution;

static void count_change(distribution *d, double change) {
    int bin = change > FIRST_BIN ? (int)(BINS_PER_DECADE * log10(change / FIRST_BIN)) : 0;
    d->bins[bin < BINS ? bin : BINS - 1]++;
    d->count++;
    d->excesses += change > 1.0;
    d->largest = fmax(d->largest, change);
}

static double bin_end(int bin) { return FIRST_BIN * pow(10.0, (bin + 1.0) / BINS_PER_DECADE); }

static double percentile(const distribution *d, double part) {
    long below = 0;
    for (int bin = 0; bin < BINS; bin++)
        if ((below += d->bins[bin]) >= part * d->count) return bin_end(bin);
    return d->largest;
}

typedef struct {
    distribution quiet;      /* ticks that are not part of a puncture, an exit or the recoil after them */
    distribution recoil;     /* ticks of the recoil, except the two of the puncture itself */
    unsigned events;
} smoothness;

/* Records one tick. `since`: ticks since the last puncture or exit. */
static void judge(smoothness *s, const lockstep *l, vec3 last, int *since, int run, int leg) {
    bool jumps = l->wrench.events & (EVENT_PUNCTURED | EVENT_EXITED);
    *since = jumps ? 0 : *since + 1;
    s->events |= l->wrench.events;
    if (*since < 2) return;
    double change = v3_norm(v3_sub(l->wrench.force, last)) / fmax(NOTICED_LEAST, NOTICED * v3_norm(last));
    count_change(*since > RECOIL ? &s->quiet : &s->recoil, change);
    if (change > 1.0)
        printf("run %d leg %d, %d ticks after a puncture: %.2f of a noticeable change, at %.2f mm, %.3f to %.3f N, events %#x, tip %s\n", run, leg, *since,
               change, 1e3 * l->wrench.depth, v3_norm(last), v3_norm(l->wrench.force), l->wrench.events,
               l->state.tip.barrier.blocked_by == NOT_BLOCKED ? "free to cut" : "at a membrane");
}

static void run_hand(smoothness *s, lockstep *l, int run) {
    random_hand hand = random_hand_create(1000u + 7919u * (unsigned)run);
    int since = RECOIL;
    l->parts.needle.given.bevel_slope = hand.bevel_slope;
    insertion_reset(&l->parts.insertion, hand.start, &l->state);
    l->base = hand.start;
    for (int k = 0; k < hand.leg_count; k++) {
        const hand_leg *leg = &hand.legs[k];
        pose from = l->base;
        double free_length = NEEDLE_LENGTH - (l->state.tip.place.phase == TIP_FREE ? 0.0 : l->state.tip.place.depth);
        int ticks = (int)ceil(leg->seconds / TICK);
        for (int i = 1; i <= ticks; i++) {
            vec3 last = l->wrench.force;
            lockstep_tick(l, hand_pose(leg, from, free_length, fmin(i * TICK, leg->seconds)), TICK);
            judge(s, l, last, &since, run, k);
        }
    }
}

static void report_mesh(rows *r, const char *name, int runs, const smoothness *s) {
    char check[160], note[480];
    const distribution *q = &s->quiet, *c = &s->recoil;
    snprintf(check, sizeof check, "%s: largest change of a tick, %d insertions", name, runs);
    snprintf(note, sizeof note, "%ld ticks; p50 %.3f, p99 %.2f, p99.9 %.2f; %ld above", q->count, percentile(q, 0.5), percentile(q, 0.99),
             percentile(q, 0.999), q->excesses);
    rows_add(r, (row){.check = check, .reference = "max(7 %, 0.05 N)", .value = q->largest, .expected = NAN, .error = q->largest, .limit = 1.0, .note = note});
    snprintf(check, sizeof check, "%s: the same in the %d ms after a puncture", name, RECOIL);
    snprintf(note, sizeof note, "the needle springs forward; p50 %.3f, p99 %.2f; %ld of %ld above", percentile(c, 0.5), percentile(c, 0.99), c->excesses,
             c->count);
    rows_add(r, (row){.check = check, .reference = "max(7 %, 0.05 N)", .value = c->largest, .expected = NAN, .error = c->largest, .limit = 1.0, .note = note});
    snprintf(check, sizeof check, "%s: ticks without equilibrium or free contacts", name);
    bool lost = s->events & (EVENT_UNSTABLE | EVENT_FULL);
    rows_add(r, (row){.check = check, .reference = "none", .value = lost, .expected = 0.0, .error = lost, .limit = 0.0});
}

static void draw(rows *r, const char *name, const distribution *d) {
    double change[BINS], part[BINS];
    long above = d->count;
    int count = 0;
    for (int bin = 0; bin < BINS && above > 0; bin++) {
        above -= d->bins[bin];
        if (d->bins[bin] == 0 || above == 0) continue;
        change[count] = bin_end(bin);
        part[count++] = (double)above / d->count;
    }
    rows_curve(r, (curve){.figure = "smoothness", .label = name, .x_label = "change in a tick over max(7 %, 0.05 N)",
                          .y_label = "part of the ticks above it", .logarithmic = true, .count = count, .x = change, .y = part});
}

/* Creates insertions on the mesh at `path`, or on the scene's mesh if it is NULL. */
static lockstep *create_insertions(const char *path, double stiffening) {
    simulation_config config = lockstep_config();
    for (int i = 0; i < config.region_count; i++) config.regions[i].material.stiffening = stiffening;
    if (path) snprintf(config.mesh_path, sizeof config.mesh_path, "%s", path);
    return lockstep_create(&config, lockstep_start());
}

/* `chosen` lists the runs to do; if it is NULL, the first ones are done. */
static void check_runs(rows *r, const char *name, const char *path, double stiffening, int runs, const int *chosen) {
    lockstep *l = create_insertions(path, stiffening);
    smoothness *s = calloc(1, sizeof *s);
    printf("%s\n", name);
    for (int run = 0; run < runs; run++) run_hand(s, l, chosen ? chosen[run] : run);
    report_mesh(r, name, runs, s);
    draw(r, name, &s->quiet);
    free(s);
    lockstep_free(l);
}

static void check_mesh(rows *r, const char *name, const char *path, double stiffening, int runs) { check_runs(r, name, path, stiffening, runs, NULL); }

/* Insertions in stiffening tissue that test whether forces are continuous near old tracks. In this order, they test the direction of cutting before first
   contact; the work of the holding force near the surface; a last contact that is released near the surface; a membrane about to be punctured; a short track
   next to a long one; and tissue that springs back into a track, just after puncturing the skin and the capsule. */
static const int NEAR_OLD_TRACKS[] = {142, 114, 74, 170, 38, 182, 147};

/* ---- monotone ----------------------------------------------------------------------------------------------------------------

   Friction, cutting and punctures let forces fall, and so may a needle that bows. What must not fall is the force of tissue that holds a
   rigid needle: its energy is convex, so that along a straight push in any direction the force against it rises, step by step, however much
   the tissue stiffens. The same holds along the needle for a tip that presses on the skin, until that gives way. */

static const double STIFFENING = 2.0, PUSH = 3e-3, PUSH_SPEED = 0.02; /* m, m/s */

typedef struct {
    double least;            /* N, smallest increase in force in a tick */
    double most;             /* N, largest force */
    double hardest, softest; /* N/m, largest and smallest stiffness in any push */
    unsigned events;
} pushes;

/* Pushes by `way` (m) and records the forces until the end or until it punctures a membrane. */
static void push(lockstep *l, vec3 way, pushes *p) {
    vec3 direction = v3_unit(way);
    int ticks = (int)ceil(v3_norm(way) / (PUSH_SPEED * TICK));
    pose from = l->base;
    double before = -v3_dot(l->wrench.force, direction);
    for (int i = 1; i <= ticks; i++) {
        lockstep_tick(l, (pose){v3_axpy((double)i / ticks, way, from.position), from.orientation}, TICK);
        p->events |= l->wrench.events;
        if (l->wrench.events & EVENT_PUNCTURED) return;
        double now = -v3_dot(l->wrench.force, direction), rise = now - before, stiffness = rise / (v3_norm(way) / ticks);
        p->least = fmin(p->least, rise);
        p->most = fmax(p->most, now);
        p->hardest = fmax(p->hardest, stiffness);
        p->softest = fmin(p->softest, stiffness);
        before = now;
    }
}

static void add_monotone_row(rows *r, const char *what, int count, const pushes *p) {
    char check[160], note[200];
    snprintf(check, sizeof check, "stiffening tissue, S = %g, %d random %s: smallest rise of the force in a tick", STIFFENING, count, what);
    snprintf(note, sizeof note, "relative to the largest force, %.3g N; stiffness of the whole from %.0f to %.0f N/m", p->most, p->softest, p->hardest);
    rows_add(r, (row){.check = check, .reference = "not negative", .value = p->least / p->most, .expected = NAN, .error = fmax(0.0, -p->least / p->most), .limit = 1e-6, .note = note});
}

/* Checks needles that are inserted at random positions and then stick to the tissue. */
static void check_stuck(rows *r, int count) {
    simulation_config config = lockstep_config();
    config.needle.youngs_modulus *= 1e4;
    for (int i = 0; i < config.region_count; i++) {
        region_material *m = &config.regions[i].material;
        m->stiffening = STIFFENING;
        m->friction_static = m->friction_kinetic = m->cutting_force = 1e6;
    }
    for (int i = 0; i < config.membrane_count; i++) config.membranes[i].puncture_force = 1e6;
    lockstep *l = lockstep_create(&config, lockstep_start());
    pushes p = {.least = INFINITY, .softest = INFINITY};
    for (int run = 0; run < count; run++) {
        unsigned seed = 5u + 7919u * (unsigned)run;
        pose start = random_hand_create(1000u + 7919u * (unsigned)run).start;
        start.position = v3_axpy(hand_uniform(&seed, 0.01, DEEPEST), q_axis(start.orientation), start.position);
        insertion_reset(&l->parts.insertion, start, &l->state);
        for (int i = 0; i < 3; i++) lockstep_tick(l, start, 1e-6);
        vec3 way = v3(hand_uniform(&seed, -1, 1), hand_uniform(&seed, -1, 1), hand_uniform(&seed, -1, 1));
        push(l, v3_scale(PUSH / v3_norm(way), way), &p);
    }
    add_monotone_row(r, "pushes of a stuck needle by 3 mm", count, &p);
    lockstep_free(l);
}

static void check_pressed(rows *r, int count) {
    simulation_config config = lockstep_config();
    config.needle.youngs_modulus *= 1e4;
    for (int i = 0; i < config.region_count; i++) config.regions[i].material.stiffening = STIFFENING;
    lockstep *l = lockstep_create(&config, lockstep_start());
    pushes p = {.least = INFINITY, .softest = INFINITY};
    for (int run = 0; run < count; run++) {
        pose start = random_hand_create(1000u + 7919u * (unsigned)run).start;
        insertion_reset(&l->parts.insertion, start, &l->state);
        lockstep_tick(l, start, TICK);
        push(l, v3_scale(0.03, q_axis(start.orientation)), &p);
    }
    add_monotone_row(r, "punctures of the skin, until it gives way", count, &p);
    lockstep_free(l);
}

/* `--runs FIRST LAST S` does only these insertions, on the scene's mesh, in tissue with the stiffening S, and prints the changes above the limit. */
static int look_at_runs(int first, int last, double stiffening) {
    lockstep *l = create_insertions(NULL, stiffening);
    smoothness *s = calloc(1, sizeof *s);
    for (int run = first; run <= last; run++) {
        *s = (smoothness){0};
        run_hand(s, l, run);
        printf("run %d: largest change %.3f, after punctures %.3f\n", run, s->quiet.largest, s->recoil.largest);
        fflush(stdout);
    }
    free(s);
    lockstep_free(l);
    return 0;
}

int main(int argc, char **argv) {
    if (argc == 5 && strcmp(argv[1], "--runs") == 0) return look_at_runs(atoi(argv[2]), atoi(argv[3]), atof(argv[4]));
    rows r = rows_begin(argc, argv, "Coupled: smoothness");
    int runs = r.short_form ? 2 : 50;
    check_mesh(&r, "572 nodes", NULL, 0, runs);
    if (r.short_form) check_runs(&r, "stiffening tissue, S = 2, 572 nodes", NULL, 2.0, sizeof NEAR_OLD_TRACKS / sizeof *NEAR_OLD_TRACKS, NEAR_OLD_TRACKS);
    else check_mesh(&r, "stiffening tissue, S = 2, 572 nodes", NULL, 2.0, 200);
    check_stuck(&r, r.short_form ? 40 : 200);
    check_pressed(&r, r.short_form ? 10 : 200);
    if (!r.short_form) {
        check_mesh(&r, "1700 nodes", GENERATED "/prostate-1700.msh", 0, runs);
        check_mesh(&r, "3300 nodes", GENERATED "/prostate-3300.msh", 0, runs);
        check_mesh(&r, "6500 nodes", GENERATED "/prostate-6500.msh", 0, runs);
        check_mesh(&r, "structured", GENERATED "/figure8-structured.msh", 0, runs); /* made by figure8_meshes.py */
        check_mesh(&r, "graded 1:10", GENERATED "/figure8-graded.msh", 0, runs);
    }
    return rows_end(&r);
}

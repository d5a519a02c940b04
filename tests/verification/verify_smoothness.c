/* The largest change of the base force per tick at 1 kHz in random insertions with steering, retraction and reinsertion, on
   several meshes. People notice changes of 7 %, or 0.05 N for small forces. */
#include "lockstep.h"
#include "random_hand.h"
#include "rows.h"

static const double TICK = 1e-3;              /* s */
static const double NOTICED = 0.07, NOTICED_LEAST = 0.05; /* just noticeable: fraction of the force; N */
static const int RECOIL = 25;                 /* longest time for which a needle springs forward after a puncture, ticks */
enum { BINS = 400, BINS_PER_DECADE = 80 };
static const double FIRST_BIN = 1e-4;

/* Changes relative to the noticeable ones, counted in logarithmic bins. */
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
    distribution quiet;      /* ticks outside punctures, exits and their recoil */
    distribution recoil;     /* ticks within it, except the two of the puncture itself */
    unsigned events;
} smoothness;

/* One tick: `since` counts ticks since the last puncture or exit. */
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
               l->state.tip.blocked_by == NOT_BLOCKED ? "free to cut" : "at a membrane");
}

static void run_hand(smoothness *s, lockstep *l, int run) {
    random_hand hand = random_hand_create(1000u + 7919u * (unsigned)run);
    int since = RECOIL;
    l->simulation.needle.given.bevel_slope = hand.bevel_slope;
    insertion_reset(&l->simulation.insertion, hand.start, &l->state);
    l->base = hand.start;
    for (int k = 0; k < hand.leg_count; k++) {
        const hand_leg *leg = &hand.legs[k];
        pose from = l->base;
        double free_length = NEEDLE_LENGTH - (l->state.tip.phase == TIP_FREE ? 0.0 : l->state.tip.depth);
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

static void check_mesh(rows *r, const char *name, const char *path, double stiffening, int runs) {
    simulation_config config = lockstep_config();
    for (int i = 0; i < config.region_count; i++) config.regions[i].material.stiffening = stiffening;
    if (path) snprintf(config.mesh_path, sizeof config.mesh_path, "%s", path);
    lockstep *l = lockstep_create(&config, lockstep_start());
    smoothness *s = calloc(1, sizeof *s);
    printf("%s\n", name);
    for (int run = 0; run < runs; run++) run_hand(s, l, run);
    report_mesh(r, name, runs, s);
    draw(r, name, &s->quiet);
    free(s);
    lockstep_free(l);
}

int main(int argc, char **argv) {
    rows r = rows_begin(argc, argv, "Coupled: smoothness");
    int runs = r.short_form ? 2 : 50;
    check_mesh(&r, "572 nodes", NULL, 0, runs);
    check_mesh(&r, "stiffening tissue, S = 2, 572 nodes", NULL, 2.0, r.short_form ? 1 : 200);
    if (!r.short_form) {
        check_mesh(&r, "1700 nodes", GENERATED "/prostate-1700.msh", 0, runs);
        check_mesh(&r, "3300 nodes", GENERATED "/prostate-3300.msh", 0, runs);
        check_mesh(&r, "6500 nodes", GENERATED "/prostate-6500.msh", 0, runs);
        check_mesh(&r, "structured", GENERATED "/figure8-structured.msh", 0, runs); /* made by figure8_meshes.py */
        check_mesh(&r, "graded 1:10", GENERATED "/figure8-graded.msh", 0, runs);
    }
    return rows_end(&r);
}

#include "comparison.h"

#include <inttypes.h>
#include <math.h>
#include <stdlib.h>

#include "events.h"

enum { COMPONENTS = 6 };
static const struct { const char *name, *unit; double least_peak; } components[COMPONENTS] = {
    {"fx", "N", 0.1},     {"fy", "N", 0.1},     {"fz", "N", 0.1},
    {"tx", "N m", 2e-3}, {"ty", "N m", 2e-3}, {"tz", "N m", 2e-3},
};

static double component_of(const trocar_needle_wrench_t *w, int component) {
    return component < 3 ? w->raw_force[component] : w->raw_torque[component - 3];
}

static void find_peaks(const wrench_log *golden, double peaks[COMPONENTS]) {
    for (int k = 0; k < COMPONENTS; k++) {
        peaks[k] = components[k].least_peak;
        for (int i = 0; i < golden->count; i++) peaks[k] = fmax(peaks[k], fabs(component_of(&golden->wrenches[i], k)));
    }
}

static int by_pose(const void *a, const void *b) {
    int64_t x = ((const trocar_needle_wrench_t *)a)->pose_seq, y = ((const trocar_needle_wrench_t *)b)->pose_seq;
    return (x > y) - (x < y);
}

/* Distance of `value` from the range of the replay at wrench `at` and its neighbours. */
static double distance(double value, const trocar_needle_wrench_t *replayed, int count, int at, int component) {
    double least = component_of(&replayed[at], component), greatest = least;
    if (isnan(least)) return INFINITY;
    for (int i = at > 0 ? at - 1 : 0; i <= at + 1 && i < count; i++) {
        least = fmin(least, component_of(&replayed[i], component));
        greatest = fmax(greatest, component_of(&replayed[i], component));
    }
    return fmax(fmax(least - value, value - greatest), 0.0);
}

static deviation worst_component(const trocar_needle_wrench_t *golden, const trocar_needle_wrench_t *replayed, int count, int at,
                                 const double peaks[COMPONENTS]) {
    deviation worst = {.replayed = at};
    for (int k = 0; k < COMPONENTS; k++) {
        double off = distance(component_of(golden, k), replayed, count, at, k), share = off / peaks[k];
        if (share > worst.share) worst = (deviation){.replayed = at, .component = k, .off = off, .share = share};
    }
    return worst;
}

trocar_status compare_wrenches(const wrench_log *golden, const char *golden_path, const trocar_needle_wrench_t *replayed,
                               int count, double tolerance, comparison *c, report *why) {
    *c = (comparison){0};
    double peaks[COMPONENTS];
    const trocar_needle_wrench_t *first = NULL;
    find_peaks(golden, peaks);
    for (int i = 0; i < golden->count; i++) {
        const trocar_needle_wrench_t *w = &golden->wrenches[i];
        if (w->session != replayed[0].session) continue;
        if (first == NULL) first = w;
        if (w->server != first->server) {
            c->foreign++;
            continue;
        }
        if (w->pose_seq > replayed[count - 1].pose_seq)
            return fail(why, TROCAR_BAD_INPUT, "%s: a wrench answers pose %" PRId64 ", which was not replayed: is it of another recording?",
                        golden_path, w->pose_seq);
        const trocar_needle_wrench_t *match = bsearch(w, replayed, (size_t)count, sizeof *w, by_pose);
        if (!match) {
            c->unrecorded++;
            continue;
        }
        deviation d = worst_component(w, replayed, count, (int)(match - replayed), peaks);
        d.golden = i;
        if (d.share > tolerance && c->differing++ == 0) c->first = d;
        if (c->compared++ == 0 || d.share > c->largest.share) c->largest = d;
        c->last = d;
        c->bins[(int)(1e3 * fmin(d.share, 1.0))]++;
    }
    if (c->unrecorded > c->compared)
        return fail(why, TROCAR_BAD_INPUT, "%s: the poses that %d of %d wrenches answer are not in the recording: record both from the start", golden_path,
                    c->unrecorded, c->unrecorded + c->compared);
    if (c->compared > 0) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: no wrench answers the session of the poses: is it of another recording?", golden_path);
}

double comparison_quantile(const comparison *c, double q) {
    int bin = 0;
    for (int seen = c->bins[0]; seen < q * c->compared && bin < SHARE_BINS - 1;) seen += c->bins[++bin];
    return 1e-3 * (bin + 1);
}

static double time_of(const trocar_needle_wrench_t *replayed, int at) {
    return 1e-6 * (double)(replayed[at].pose_utime - replayed[0].pose_utime);
}

static void print_wrench(const char *whose, const trocar_needle_wrench_t *w, int component, FILE *out) {
    char membrane[16], events[256];
    snprintf(membrane, sizeof membrane, "%d", w->membrane);
    events_text((unsigned)w->events, membrane, events, sizeof events);
    fprintf(out, "  %s:  %s %.6g %s, depth %.3f mm, %d contacts, events: %s\n", whose, components[component].name,
            component_of(w, component), components[component].unit, 1e3 * w->depth, w->contacts, *events ? events : "none");
}

static void print_deviation(const deviation *d, const trocar_needle_wrench_t *replayed, FILE *out) {
    fprintf(out, "%s off by %.3g %s, %.2g %% of its peak, at %.3f s, pose %" PRId64 "\n", components[d->component].name,
            d->off, components[d->component].unit, 100.0 * d->share, time_of(replayed, d->replayed),
            replayed[d->replayed].pose_seq);
}

void comparison_print(const comparison *c, const wrench_log *golden, const char *golden_path,
                      const trocar_needle_wrench_t *replayed, FILE *out) {
    if (c->differing) {
        fprintf(out, "%s: %d of %d wrenches differ\n  first:   ", golden_path, c->differing, c->compared);
        print_deviation(&c->first, replayed, out);
        print_wrench("golden", &golden->wrenches[c->first.golden], c->first.component, out);
        print_wrench("replay", &replayed[c->first.replayed], c->first.component, out);
    } else {
        fprintf(out, "%s: %d wrenches agree\n", golden_path, c->compared);
    }
    if (c->foreign) fprintf(out, "  %d wrenches of another server ignored, which ran at the same time or later\n", c->foreign);
    if (c->unrecorded) fprintf(out, "  %d wrenches ignored: the recording lacks the poses that they answer\n", c->unrecorded);
    if (golden->skipped_not_finite) fprintf(out, "  %" PRId64 " non-finite wrenches ignored\n", golden->skipped_not_finite);
    fprintf(out, "  largest: ");
    print_deviation(&c->largest, replayed, out);
    fprintf(out, "  last:    ");
    print_deviation(&c->last, replayed, out);
    fprintf(out, "  95 %% of them are off by less than %.1f %%\n", 100.0 * comparison_quantile(c, 0.95));
}

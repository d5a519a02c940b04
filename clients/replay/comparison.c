#include "replay/comparison.h"

#include <inttypes.h>
#include <math.h>
#include <string.h>

#include "shared/events.h"

static const struct { const char *name, *unit; double least_peak; } components[WRENCH_COMPONENTS] = {
    {"fx", "N", 0.1},     {"fy", "N", 0.1},     {"fz", "N", 0.1},
    {"tx", "N m", 2e-3}, {"ty", "N m", 2e-3}, {"tz", "N m", 2e-3},
};

static double component_of(const trocar_needle_wrench_t *w, int component) {
    return component < 3 ? w->raw_force[component] : w->raw_torque[component - 3];
}

/* ---- the golden log ----------------------------------------------------------------------------------------------------- */

/* Reads the next golden wrench to compare, skipping those of other sessions, and of servers other than the one that sent the session's first. */
static trocar_status read_golden(comparison *c, trocar_error *why) {
    for (;;) {
        trocar_status status = wrench_stream_next(c->stream, &c->golden, &c->ended, why);
        if (status != TROCAR_OK || c->ended) return status;
        if (c->golden.session != c->session) continue;
        if (!c->begun) c->server = c->golden.server;
        c->begun = true;
        if (c->golden.server == c->server) return TROCAR_OK;
        c->foreign++;
    }
}

/* Reads all golden wrenches before the replay begins, to find the peaks and check the order. */
static trocar_status look_through(comparison *c, trocar_error *why) {
    int64_t last = -1, server = 0;
    bool begun = false, ended = false;
    for (int k = 0; k < WRENCH_COMPONENTS; k++) c->peaks[k] = components[k].least_peak;
    for (;;) {
        trocar_needle_wrench_t w;
        trocar_status status = wrench_stream_next(c->stream, &w, &ended, why);
        if (status != TROCAR_OK || ended) return status;
        for (int k = 0; k < WRENCH_COMPONENTS; k++) c->peaks[k] = fmax(c->peaks[k], fabs(component_of(&w, k)));
        if (w.session != c->session) continue;
        if (!begun) server = w.server;
        begun = true;
        if (w.server != server) continue;
        if (w.pose_seq < last)
            return fail(why, TROCAR_BAD_INPUT, "%s: a wrench answers pose %" PRId64 " after one that answers pose %" PRId64 ": record it again, in order", c->path,
                        w.pose_seq, last);
        last = w.pose_seq;
    }
}

trocar_status comparison_begin(comparison *c, const char *golden_path, int64_t session, double tolerance, trocar_error *why) {
    *c = (comparison){.path = golden_path, .tolerance = tolerance, .session = session};
    trocar_status status = wrench_stream_open(golden_path, &c->stream, why);
    if (status == TROCAR_OK) status = look_through(c, why);
    if (status != TROCAR_OK) return status;
    c->skipped_not_finite = wrench_stream_skipped(c->stream);
    snprintf(c->inverse, sizeof c->inverse, "%s", wrench_stream_inverse(c->stream));
    wrench_stream_close(c->stream);
    status = wrench_stream_open(golden_path, &c->stream, why);
    return status == TROCAR_OK ? read_golden(c, why) : status;
}

void comparison_free(comparison *c) {
    wrench_stream_close(c->stream);
    c->stream = NULL;
}

/* ---- comparing ---------------------------------------------------------------------------------------------------------- */

/* Returns how far `value` lies outside the range of the replayed values in the window (0 if inside). */
static double distance(double value, const comparison *c, int component, bool before, bool after) {
    double least = component_of(&c->window[1], component), greatest = least;
    if (isnan(least)) return INFINITY;
    for (int i = before ? 0 : 1; i <= (after ? 2 : 1); i++) {
        least = fmin(least, component_of(&c->window[i], component));
        greatest = fmax(greatest, component_of(&c->window[i], component));
    }
    return fmax(fmax(least - value, value - greatest), 0.0);
}

static deviation worst_component(const comparison *c, bool before, bool after) {
    deviation worst = {.golden = c->golden, .replayed = c->window[1], .time = 1e-6 * (double)(c->window[1].pose_utime - c->first_utime)};
    for (int k = 0; k < WRENCH_COMPONENTS; k++) {
        double off = distance(component_of(&c->golden, k), c, k, before, after), share = off / c->peaks[k];
        if (share <= worst.share) continue;
        worst.component = k;
        worst.off = off;
        worst.share = share;
    }
    return worst;
}

/* Compares the golden wrenches that answer the pose in the middle of the window, and skips those that answer earlier poses. */
static trocar_status compare_middle(comparison *c, bool before, bool after, trocar_error *why) {
    trocar_status status = TROCAR_OK;
    for (; status == TROCAR_OK && !c->ended && c->golden.pose_seq <= c->window[1].pose_seq; status = read_golden(c, why)) {
        if (c->golden.pose_seq < c->window[1].pose_seq) {
            c->unrecorded++;
            continue;
        }
        deviation d = worst_component(c, before, after);
        if (d.share > c->tolerance && c->differing++ == 0) c->first = d;
        if (c->compared++ == 0 || d.share > c->largest.share) c->largest = d;
        c->last = d;
        c->bins[(int)(1e3 * fmin(d.share, 1.0))]++;
    }
    return status;
}

trocar_status comparison_add(comparison *c, const trocar_needle_wrench_t *replayed, trocar_error *why) {
    if (c->replayed == 0) c->first_utime = replayed->pose_utime;
    memmove(c->window, c->window + 1, 2 * sizeof *c->window);
    c->window[2] = *replayed;
    return ++c->replayed >= 2 ? compare_middle(c, c->replayed >= 3, true, why) : TROCAR_OK;
}

trocar_status comparison_end(comparison *c, trocar_error *why) {
    memmove(c->window, c->window + 1, 2 * sizeof *c->window);
    trocar_status status = c->replayed > 0 ? compare_middle(c, c->replayed >= 2, false, why) : TROCAR_OK;
    if (status != TROCAR_OK) return status;
    if (!c->ended)
        return fail(why, TROCAR_BAD_INPUT, "%s: a wrench answers pose %" PRId64 ", which was not replayed: does it belong to another recording?", c->path, c->golden.pose_seq);
    if (c->unrecorded > c->compared)
        return fail(why, TROCAR_BAD_INPUT, "%s: %d of %d wrenches answer poses that are not in the recording: record both from the start", c->path,
                    c->unrecorded, c->unrecorded + c->compared);
    if (c->compared > 0) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: no wrench answers the session of the poses: does it belong to another recording?", c->path);
}

double comparison_quantile(const comparison *c, double q) {
    int bin = 0;
    for (int seen = c->bins[0]; seen < q * c->compared && bin < SHARE_BINS - 1;) seen += c->bins[++bin];
    return 1e-3 * (bin + 1);
}

/* ---- printing ----------------------------------------------------------------------------------------------------------- */

static void print_wrench(const char *whose, const trocar_needle_wrench_t *w, int component, FILE *out) {
    char membrane[16], events[256];
    snprintf(membrane, sizeof membrane, "%d", w->membrane);
    events_text((unsigned)w->events, membrane, events, sizeof events);
    fprintf(out, "  %s:  %s %.6g %s, depth %.3f mm, %d contacts, events: %s\n", whose, components[component].name,
            component_of(w, component), components[component].unit, 1e3 * w->depth, w->contacts, *events ? events : "none");
}

static void print_deviation(const deviation *d, FILE *out) {
    fprintf(out, "%s off by %.3g %s, %.2g %% of its peak, at %.3f s, pose %" PRId64 "\n", components[d->component].name,
            d->off, components[d->component].unit, 100.0 * d->share, d->time, d->replayed.pose_seq);
}

void comparison_print(const comparison *c, FILE *out) {
    if (c->differing) {
        fprintf(out, "%s: %d of %d wrenches differ\n  first:   ", c->path, c->differing, c->compared);
        print_deviation(&c->first, out);
        print_wrench("golden", &c->first.golden, c->first.component, out);
        print_wrench("replay", &c->first.replayed, c->first.component, out);
    } else {
        fprintf(out, "%s: %d wrenches agree\n", c->path, c->compared);
    }
    if (c->foreign) fprintf(out, "  %d wrenches of another server ignored, which ran at the same time or later\n", c->foreign);
    if (c->unrecorded) fprintf(out, "  %d wrenches ignored: the recording lacks the poses that they answer\n", c->unrecorded);
    if (c->skipped_not_finite) fprintf(out, "  %" PRId64 " non-finite wrenches ignored\n", c->skipped_not_finite);
    fprintf(out, "  largest: ");
    print_deviation(&c->largest, out);
    fprintf(out, "  last:    ");
    print_deviation(&c->last, out);
    fprintf(out, "  95 %% of them are off by less than %.1f %%\n", 100.0 * comparison_quantile(c, 0.95));
}

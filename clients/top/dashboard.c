#include "top/dashboard.h"

#include <inttypes.h>
#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>

#include "printable.h"
#include "shared/events.h"
#include "trocar_needle_wrench_t.h"

static const double silence = 1.0;  /* s without a message before the display shows an alarm */

/* True if the message comes from the server being displayed. */
static bool follows(dashboard *d, int64_t server, double now) {
    d->servers.patience = silence;
    return server_choice_follows(&d->servers, server, now);
}

void dashboard_take_timing(dashboard *d, const trocar_loop_timing_t *timing, double now) {
    if (!follows(d, timing->server, now)) return;
    /* the first message, or one from a restarted or another server */
    if (!d->heard || timing->ticks < d->timing.ticks || timing->server != d->timing.server) d->first_misses = timing->misses;
    d->heard = true;
    d->heard_at = now;
    d->timing = *timing;
    for (int k = 0; k < DASHBOARD_BINS; k++) {
        d->lateness[k] += timing->lateness_bins[k];
        d->compute[k] += timing->compute_bins[k];
    }
}

void dashboard_take_status(dashboard *d, const trocar_status_t *status, double now) {
    int count = status->needle_count;
    if (count < 1 || count > TROCAR_MAX_NEEDLES || status->needle < 0 || status->needle >= count) {
        d->foreign++;
        return;
    }
    if (!follows(d, status->server, now)) return;
    if (status->server != d->needles[0].server || count != d->needle_count) memset(d->needles, 0, sizeof d->needles);
    d->needle_count = count;
    trocar_status_t *kept = &d->needles[status->needle];
    *kept = *status;
    kept->host = kept->scene = kept->inverse = kept->message = NULL;
    snprintf(d->scene, sizeof d->scene, "%s", status->scene);
    snprintf(d->message, sizeof d->message, "%s", status->message);
    make_printable(d->scene);
    make_printable(d->message);
}

void dashboard_clear(dashboard *d) {
    memset(d->lateness, 0, sizeof d->lateness);
    memset(d->compute, 0, sizeof d->compute);
}

/* ---- lines ------------------------------------------------------------------------------------------------------- */

typedef struct {
    dashboard_line *lines;
    int count, room;
} page;

__attribute__((format(printf, 3, 4)))
static void add(page *p, bool alarm, const char *format, ...) {
    if (p->count == p->room) return;
    dashboard_line *line = &p->lines[p->count++];
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(line->text, sizeof line->text, format, arguments);
    va_end(arguments);
    line->alarm = alarm;
}

typedef struct { char text[16]; } duration;

static duration duration_text(double s) {
    duration d;
    if (s < 1e-3) snprintf(d.text, sizeof d.text, "%.1f us", 1e6 * s);
    else if (s < 1) snprintf(d.text, sizeof d.text, "%.2f ms", 1e3 * s);
    else snprintf(d.text, sizeof d.text, "%.2f s", s);
    return d;
}

/* Returns how many needles to show: one until the first status arrives. */
static int shown_needles(const dashboard *d) { return d->needle_count > 0 ? d->needle_count : 1; }

typedef struct { char text[24]; } label;

/* Returns `word`, followed by the needle's number if there is more than one. */
static label needle_label(const dashboard *d, const char *word, int needle) {
    label l;
    if (d->needle_count > 1) snprintf(l.text, sizeof l.text, "%s %d", word, needle);
    else snprintf(l.text, sizeof l.text, "%s", word);
    return l;
}

static void add_needle(page *p, const dashboard *d, int needle) {
    const trocar_status_t *s = &d->needles[needle];
    char text[160] = ", ";
    flags_text((unsigned)s->flags, text + 2, sizeof text - 2);
    if (!s->flags) text[0] = '\0';
    bool alarm = s->flags & ~TROCAR_NEEDLE_WRENCH_T_RAMPING; /* a ramp does not raise an alarm */
    label name = needle_label(d, "needle", needle);
    if (s->owner == 0) add(p, alarm, "%-12sfree%s", name.text, text);
    else add(p, alarm, "%-12sof session %" PRId64 ", %d contacts%s", name.text, s->owner, s->contacts, text);
}

static void add_times(page *p, const char *name, double p50, double p99, double max, const char *rest) {
    add(p, false, "%-12s%10s %10s %10s  %s", name, duration_text(p50).text, duration_text(p99).text, duration_text(max).text, rest);
}

static void add_timing(page *p, const trocar_loop_timing_t *t) {
    char age[32] = "";
    if (t->snapshot_age > 0) snprintf(age, sizeof age, "waiting for %s", duration_text(t->snapshot_age).text);
    add(p, false, "                   p50        p99        max  max since start");
    add_times(p, "lateness", t->lateness_p50, t->lateness_p99, t->lateness_max, duration_text(t->lateness_max_total).text);
    add_times(p, "compute", t->compute_p50, t->compute_p99, t->compute_max, duration_text(t->compute_max_total).text);
    add_times(p, "round trip", t->round_trip_p50, t->round_trip_p99, t->round_trip_max, "");
    add_times(p, "worker", t->worker_latency_p50, t->worker_latency_p99, t->worker_latency_max, age);
}

static void add_stages(page *p, const trocar_loop_timing_t *t) {
    const double *mean = t->stage_mean, *max = t->stage_max;
    add(p, false, "stage, us        input   tissue   needle  contact   wrench   output");
    add(p, false, "  mean        %8.2f %8.2f %8.2f %8.2f %8.2f %8.2f", 1e6 * mean[0], 1e6 * mean[1], 1e6 * mean[2], 1e6 * mean[3],
        1e6 * mean[4], 1e6 * mean[5]);
    add(p, false, "  max         %8.2f %8.2f %8.2f %8.2f %8.2f %8.2f", 1e6 * max[0], 1e6 * max[1], 1e6 * max[2], 1e6 * max[3],
        1e6 * max[4], 1e6 * max[5]);
}

/* Adds up the counters of all needles and takes the largest `pose_age`. The fields that describe the server are the same in every needle's status. */
static trocar_status_t total_of(const dashboard *d) {
    trocar_status_t total = d->needles[0];
    for (int i = 1; i < d->needle_count; i++) {
        const trocar_status_t *s = &d->needles[i];
        total.poses_accepted += s->poses_accepted;
        total.poses_not_finite += s->poses_not_finite;
        total.poses_not_unit += s->poses_not_unit;
        total.poses_jumped += s->poses_jumped;
        total.poses_refused += s->poses_refused;
        total.poses_old += s->poses_old;
        total.poses_lost += s->poses_lost;
        total.saturated_ticks += s->saturated_ticks;
        total.pose_age = fmax(total.pose_age, s->pose_age);
    }
    total.poses_refused += total.poses_no_needle;
    return total;
}

static void add_energy(page *p, const dashboard *d, int needle) {
    const trocar_status_t *s = &d->needles[needle];
    add(p, s->energy_lowest < 0, "%-12s%.1f mJ, lowest %.1f mJ, coupling %.0f N/m", needle_label(d, "energy", needle).text, 1e3 * s->energy,
        1e3 * s->energy_lowest, s->coupling_stiffness);
}

static void add_counters(page *p, const dashboard *d) {
    const trocar_loop_timing_t *t = &d->timing;
    const trocar_status_t total = total_of(d), *s = &total;
    bool loop_alarm = t->misses > d->first_misses || t->allocations || t->major_faults || t->minor_faults || t->wrenches_dropped;
    int64_t bad = s->poses_malformed + s->poses_not_finite + s->poses_not_unit + s->poses_jumped + s->poses_refused + s->poses_old + s->poses_lost;
    add(p, loop_alarm, "loop        missed %" PRId64 ", allocations %" PRId64 ", page faults %" PRId64 "+%" PRId64 ", preempted %" PRId64,
        t->misses, t->allocations, t->minor_faults, t->major_faults, t->context_switches);
    add(p, bad > 0, "poses       taken %" PRId64 ", malformed %" PRId64 ", not finite %" PRId64 ", not unit %" PRId64, s->poses_accepted,
        s->poses_malformed, s->poses_not_finite, s->poses_not_unit);
    add(p, bad > 0, "            too fast %" PRId64 ", refused %" PRId64 ", repeated %" PRId64 ", lost %" PRId64 ", last %s ago",
        s->poses_jumped, s->poses_refused, s->poses_old, s->poses_lost, duration_text(s->pose_age).text);
    add(p, t->wrenches_dropped > 0, "wrenches    dropped %" PRId64 ", limited %" PRId64 "; malformed packets dropped %" PRId64, t->wrenches_dropped,
        s->saturated_ticks, s->packets_dropped);
    for (int i = 0; i < shown_needles(d); i++) add_energy(p, d, i);
    if (d->message[0]) add(p, true, "last fault  %s", d->message);
}

/* ---- histograms -------------------------------------------------------------------------------------------------- */

/* Returns the height of a column, 0 to 1. The scale is logarithmic, so that one late tick is visible next to 100 000 good ones. */
static double column(double count, double most) { return count > 0 ? (1 + log10(count)) / (1 + log10(most)) : 0; }

static double most_of(const dashboard *d) {
    double most = 1;
    for (int k = 0; k < DASHBOARD_BINS; k++) most = fmax(most, fmax(d->lateness[k], d->compute[k]));
    return most;
}

static void draw_row(const double *bins, double most, double level, char row[DASHBOARD_BINS + 1]) {
    for (int k = 0; k < DASHBOARD_BINS; k++) row[k] = column(bins[k], most) > level ? '#' : ' ';
    row[DASHBOARD_BINS] = '\0';
}

/* Bin k counts values below 2^(k/2) us. */
static void add_histograms(page *p, const dashboard *d) {
    const char *axis = "1us       32us      1ms     32ms";
    int height = p->room - p->count - 2;
    if (height < 2) return;
    if (height > 12) height = 12;
    double most = most_of(d);
    add(p, false, "%-37s%s", "lateness (logarithmic)", "compute");
    for (int i = height - 1; i >= 0; i--) {
        char lateness[DASHBOARD_BINS + 1], compute[DASHBOARD_BINS + 1];
        draw_row(d->lateness, most, (double)i / height, lateness);
        draw_row(d->compute, most, (double)i / height, compute);
        add(p, false, "|%s    |%s", lateness, compute);
    }
    add(p, false, "+%s    +%s", axis, axis);
}

int dashboard_draw(const dashboard *d, double now, int height, dashboard_line lines[DASHBOARD_LINES]) {
    page p = {.lines = lines, .room = height < DASHBOARD_LINES ? height : DASHBOARD_LINES};
    if (d->foreign)
        add(&p, true, "%" PRId64 " messages of another version: run trocar-top of the server's release", d->foreign);
    if (!d->heard) {
        add(&p, true, "no server was heard: does it run with the same LCM URL?");
        return p.count;
    }
    add(&p, false, "trocar      %s, %g Hz, tick %" PRId64, d->scene, d->timing.rate_hz, d->timing.ticks);
    if (now - d->heard_at > silence) add(&p, true, "server      silent for %.0f s", now - d->heard_at);
    if (server_choice_has_other(&d->servers, now))
        add(&p, true, "two servers %016" PRIx64 ", shown here, and %016" PRIx64 ": stop one", d->servers.followed, d->servers.other);
    for (int i = 0; i < shown_needles(d); i++) add_needle(&p, d, i);
    add_timing(&p, &d->timing);
    add_stages(&p, &d->timing);
    add_counters(&p, d);
    add_histograms(&p, d);
    return p.count;
}

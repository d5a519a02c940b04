#include "telemetry.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "common/network.h"
#include "common/realtime.h"
#include "lcm_filter.h"
#include "trocar_loop_timing_t.h"
#include "trocar_status_t.h"

enum { PICTURES_HZ = 30, STATUS_HZ = 10, HOST_NAME = 56 };

trocar_status telemetry_create(telemetry *t, const telemetry_options *given, trocar_model *model, exchange *x, trocar_error *why) {
    const char *url = given->lcm_url;
    *t = (telemetry){.exchange = x, .given = *given, .inverse = trocar_model_inverse(model), .needle_count = trocar_model_needles(model)};
    gethostname(t->host, HOST_NAME);
    snprintf(t->host + strlen(t->host), sizeof t->host - strlen(t->host), ", process %d", (int)getpid());
    atomic_init(&t->stop, false);
    trocar_status status = viewer_messages_create(&t->messages, model, why);
    if (status == TROCAR_OK) status = views_create(&t->views, model, why);
    if (status != TROCAR_OK) {
        telemetry_free(t);
        return status;
    }
    t->latency = calloc(1, sizeof *t->latency);
    t->round_trip = calloc(1, sizeof *t->round_trip);
    if (t->latency == NULL || t->round_trip == NULL) {
        telemetry_free(t);
        return fail(why, TROCAR_NO_MEMORY, "cannot allocate telemetry's buffers");
    }
    status = network_open(url, &t->lcm, why);
    if (status != TROCAR_OK) telemetry_free(t);
    return status;
}

void telemetry_free(telemetry *t) {
    if (t->lcm != NULL) lcm_destroy(t->lcm);
    free(t->latency);
    free(t->round_trip);
    views_free(&t->views);
    viewer_messages_free(&t->messages);
    *t = (telemetry){0};
}

static void print_timing(const trocar_loop_timing_t *m) {
    fprintf(stderr, "tick %lld: lateness p99 %.0f max %.0f us, compute p99 %.0f max %.0f us, %lld missed, %d contacts\n",
            (long long)m->ticks, 1e6 * m->lateness_p99, 1e6 * m->lateness_max, 1e6 * m->compute_p99, 1e6 * m->compute_max,
            (long long)m->misses, m->contacts);
}

/* Moves the values (ns) from a ring into a histogram, which is cleared first. */
static void collect(spsc_ring *ring, histogram *h) {
    histogram_clear(h);
    for (int64_t nanoseconds; spsc_ring_pop(ring, &nanoseconds);) histogram_add(h, nanoseconds);
}

_Static_assert(HISTOGRAM_BINS == sizeof((trocar_loop_timing_t *)0)->lateness_bins / sizeof(int32_t), "bins of loop_timing_t");
_Static_assert(LOOP_STAGES == sizeof((trocar_loop_timing_t *)0)->stage_max / sizeof(double), "stages of loop_timing_t");

static void publish_timing(telemetry *t, const view_sample *view) {
    bool fresh;
    const loop_record *loop = triple_buffer_read(&t->exchange->loops, &fresh);
    if (!fresh) return; /* the loop has published nothing new */
    collect(&t->exchange->latencies, t->latency);
    collect(&t->exchange->round_trips, t->round_trip);

    int contacts = 0;
    for (int i = 0; i < t->needle_count; i++) contacts += view->needles[i].contacts;

    trocar_loop_timing_t m = {
        .utime = wall_us(), .ticks = loop->ticks, .rate_hz = t->given.rate_hz,
        .lateness_p50 = histogram_quantile(&loop->lateness, 0.50),
        .lateness_p99 = histogram_quantile(&loop->lateness, 0.99),
        .lateness_max = histogram_max(&loop->lateness),
        .compute_p50 = histogram_quantile(&loop->compute, 0.50),
        .compute_p99 = histogram_quantile(&loop->compute, 0.99),
        .compute_max = histogram_max(&loop->compute),
        .round_trip_p50 = histogram_quantile(t->round_trip, 0.50),
        .round_trip_p99 = histogram_quantile(t->round_trip, 0.99),
        .round_trip_max = histogram_max(t->round_trip),
        .worker_latency_p50 = histogram_quantile(t->latency, 0.50),
        .worker_latency_p99 = histogram_quantile(t->latency, 0.99),
        .worker_latency_max = histogram_max(t->latency),
        .snapshot_age = view->snapshot_age,
        .lateness_max_total = loop->lateness_max_total, .compute_max_total = loop->compute_max_total,
        .misses = loop->misses, .allocations = loop->usage.allocations, .minor_faults = loop->usage.minor_faults,
        .major_faults = loop->usage.major_faults, .context_switches = loop->usage.context_switches,
        .wrenches_dropped = view->wrench_dropped, .contacts = contacts, .server = t->given.server};
    histogram_bins(&loop->lateness, m.lateness_bins);
    histogram_bins(&loop->compute, m.compute_bins);
    for (int i = 0; i < LOOP_STAGES; i++) {
        m.stage_mean[i] = 1e-9 * (double)loop->stage_total[i] / (double)loop->compute.count;
        m.stage_max[i] = 1e-9 * (double)loop->stage_max[i];
    }
    trocar_loop_timing_t_publish(t->lcm, "TROCAR_TIMING", &m);
    if (t->given.verbose && t->timings_published++ % STATUS_HZ == 0) print_timing(&m);
}

/* Returns the message about the other server. Also reports each other server on stderr, once. */
static const char *other_server_text(telemetry *t, const other_server *other) {
    if (other->id == t->other_told) return t->other_text;
    t->other_told = other->id;
    snprintf(t->other_text, sizeof t->other_text, "two servers on this LCM URL: stop this one (%s) or the one on %s, scene %s, number %016llx",
             t->host, other->host, other->scene, (unsigned long long)other->id);
    fprintf(stderr, "trocar-server: %s\n", t->other_text);
    return t->other_text;
}

/* Reports the first malformed pose on stderr. A client whose message types differ from the server's never gets a needle, and may not be able to read the
   status. */
static void tell_of_malformed(telemetry *t, const arbiter_record *in) {
    if (t->malformed_told || in->poses_malformed == 0) return;
    t->malformed_told = true;
    fprintf(stderr, "trocar-server: %s\n", in->malformed);
}

/* Returns the message about the worker's fault. Also reports each new fault on stderr, once. */
static const char *fault_text(telemetry *t, const worker_fault *fault) {
    if (strcmp(t->fault_told, fault->why.text) != 0) fprintf(stderr, "trocar-server: %s\n", fault->why.text);
    snprintf(t->fault_told, sizeof t->fault_told, "%s", fault->why.text);
    return fault->why.text;
}

/* Reports once on stderr that packets from another machine are being dropped, in case somebody is trying to connect a device from there. */
static void tell_of_distant(telemetry *t) {
    char address[16];
    if (t->distant_text[0] || lcm_filter_distant(address, sizeof address) == 0) return;
    snprintf(t->distant_text, sizeof t->distant_text,
             "packets of another machine (%s) dropped: this server's LCM URL has ttl=0, so it serves only this machine; to connect others, set ttl=1 on all of them", address);
    fprintf(stderr, "trocar-server: %s\n", t->distant_text);
}

/* Returns the message for the status. Lasting faults take precedence over the last refusal. */
static const char *message_of(telemetry *t, const arbiter_record *in, bool accompanied) {
    const worker_fault *fault = triple_buffer_read(&t->exchange->faults, NULL);
    if (fault->lasts) return fault_text(t, fault);
    if (accompanied) return other_server_text(t, &in->other);
    return in->message[0] ? in->message : t->distant_text;
}

static char *text(const char *constant) { return (char *)(uintptr_t)constant; } /* LCM's generated structs have no const members */

static trocar_status_t status_of(const telemetry *t, const arbiter_record *in, const view_sample *view, int needle) {
    const needle_record *poses = &in->needles[needle];
    const needle_view *seen = &view->needles[needle];
    return (trocar_status_t){
        .utime = wall_us(), .owner = poses->owner, .flags = seen->flags | t->given.flags,
        .poses_accepted = poses->counts[POSE_ACCEPTED], .poses_malformed = in->poses_malformed, .poses_no_needle = in->poses_no_needle,
        .poses_not_finite = poses->counts[POSE_NOT_FINITE], .poses_not_unit = poses->counts[POSE_NOT_UNIT],
        .poses_jumped = poses->counts[POSE_JUMPED], .poses_refused = poses->counts[POSE_REFUSED],
        .poses_old = poses->counts[POSE_OLD], .poses_lost = poses->poses_lost, .commands_refused = in->commands_refused,
        .pose_age = poses->received == 0 ? 0.0 : 1e-9 * (double)(monotonic_ns() - poses->received),
        .energy = seen->energy, .energy_lowest = seen->energy_lowest, .coupling_stiffness = seen->coupling_stiffness,
        .saturated_ticks = seen->saturated_ticks, .packets_dropped = lcm_filter_dropped(), .server = t->given.server,
        .needle = needle, .needle_count = t->needle_count, .contacts = seen->contacts, .state = seen->state,
        .host = text(t->host), .scene = text(t->given.scene_path), .inverse = text(t->inverse)};
}

static void publish_status(telemetry *t, const view_sample *view) {
    const arbiter_record *in = triple_buffer_read(&t->exchange->intakes, NULL);
    bool accompanied = other_server_present(&in->other, monotonic_ns());
    tell_of_malformed(t, in);
    tell_of_distant(t);
    for (int i = 0; i < t->needle_count; i++) {
        trocar_status_t m = status_of(t, in, view, i);
        m.other_server = accompanied ? in->other.id : 0;
        m.message = text(message_of(t, in, accompanied));
        trocar_status_t_publish(t->lcm, "TROCAR_STATUS", &m);
    }
}

/* Sends a needle's tracks when they change, and once a second anyway: a viewer may start later, and a message may get lost, such as the one that says there are
   no tracks left after a reset. A track grows at its end, so comparing the number of points and the last point is enough to detect a change. */
static void publish_tracks(telemetry *t, int needle, int64_t tick) {
    static const int64_t SOONEST = 200000000, LATEST = 1000000000; /* ns, shortest and longest time between messages */
    viewer_messages *m = &t->messages;
    int64_t now = monotonic_ns(), age = now - t->tracks[needle].sent;
    if (age < SOONEST) return;
    viewer_messages_make_tracks(m, needle, tick);
    int count = m->tracks.point_count, before = t->tracks[needle].points;
    const float nowhere[3] = {0}, *end = count > 0 ? m->track_points[count - 1] : nowhere;
    bool same = count == before && memcmp(end, t->tracks[needle].end, sizeof nowhere) == 0;
    if (same && age < LATEST) return;
    t->tracks[needle].sent = now;
    t->tracks[needle].points = count;
    memcpy(t->tracks[needle].end, end, sizeof nowhere);
    m->tracks.utime = wall_us();
    m->tracks.server = t->given.server;
    trocar_tracks_t_publish(t->lcm, "TROCAR_TRACKS", &m->tracks);
}

/* Sends the seeds with every picture while there are any, and once a second anyway: a viewer may start later, and a message may get lost, such as the one that
   says the last seed is gone. */
static void publish_seeds(telemetry *t, int64_t tick) {
    static const int64_t LATEST = 1000000000; /* ns, longest time between messages */
    viewer_messages *m = &t->messages;
    int64_t now = monotonic_ns();
    viewer_messages_make_seeds(m, tick);
    int count = m->seeds.seed_count;
    for (int i = 0; i < m->seeds.needle_count; i++) count += m->seeds.pending[i];
    if (count == 0 && t->seeds.count == 0 && now - t->seeds.sent < LATEST) return;
    t->seeds.sent = now;
    t->seeds.count = count;
    m->seeds.utime = wall_us();
    m->seeds.server = t->given.server;
    trocar_seeds_t_publish(t->lcm, "TROCAR_SEEDS", &m->seeds);
}

/* Sends the needles first, because the deformation may take seconds to compute on a large mesh with a condensed inverse. The deformation completes the picture
   and displaces the seeds, so if there is not enough memory for it, both are skipped. */
static void publish_picture(telemetry *t, const view_sample *view) {
    trocar_error ignored;
    viewer_messages *m = &t->messages;
    trocar_picture_copy(view->picture, m->picture);
    for (int i = 0; i < t->needle_count; i++) {
        if (!view->needles[i].engaged) continue;
        publish_tracks(t, i, view->tick);
        viewer_messages_make_needle(m, i, view->tick, view->needles[i].pose_utime);
        m->contacts.utime = wall_us();
        m->contacts.server = t->given.server;
        trocar_contacts_t_publish(t->lcm, "TROCAR_CONTACTS", &m->contacts);
    }
    if (viewer_messages_make_tissue(m, view->tick, &ignored) != TROCAR_OK) return;
    publish_seeds(t, view->tick);
    m->deformation.utime = wall_us();
    m->deformation.server = t->given.server;
    trocar_deformation_t_publish(t->lcm, "TROCAR_DEFORMATION", &m->deformation);
}

static bool stopped(const telemetry *t) { return atomic_load_explicit(&t->stop, memory_order_relaxed); }

static void *publish_pictures(void *context) {
    telemetry *t = context;
    realtime_flush_denormals();
    for (int64_t due = monotonic_ns(); !stopped(t); sleep_until(due)) {
        bool fresh;
        const view_sample *view = triple_buffer_read(&t->views, &fresh);
        if (fresh) publish_picture(t, view);
        due += 1000000000 / PICTURES_HZ;
        if (due < monotonic_ns()) due = monotonic_ns(); /* on large meshes, send pictures as often as possible, but never in bursts */
    }
    return NULL;
}

void *telemetry_run(void *context) {
    telemetry *t = context;
    pthread_t pictures;
    bool shown = pthread_create(&pictures, NULL, publish_pictures, t) == 0; /* if the thread cannot be created, do without pictures */
    int64_t due = monotonic_ns();
    for (int64_t round = 0; !stopped(t); round++) {
        bool fresh;
        const view_sample *view = triple_buffer_read(&t->exchange->views, &fresh);
        if (round % (PICTURES_HZ / STATUS_HZ) == 0) {
            publish_timing(t, view);
            publish_status(t, view);
        }
        if (fresh) {
            view_copy(view, triple_buffer_slot(&t->views));
            triple_buffer_publish(&t->views);
        }
        due += 1000000000 / PICTURES_HZ;
        if (due < monotonic_ns()) due = monotonic_ns();
        sleep_until(due);
    }
    if (shown) pthread_join(pictures, NULL);
    return NULL;
}

void telemetry_stop(telemetry *t) { atomic_store_explicit(&t->stop, true, memory_order_relaxed); }

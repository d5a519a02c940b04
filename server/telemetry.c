#include "telemetry.h"

#include <stdlib.h>
#include <string.h>

#include "realtime.h"
#include "trocar_contacts_t.h"
#include "trocar_deformation_t.h"
#include "trocar_loop_timing_t.h"
#include "trocar_status_t.h"

enum { VIEW_HZ = 30, STATUS_HZ = 10 };

/* Rows of one array, as LCM's generated types want them. */
static bool lay_out_rows(telemetry *t, int count) {
    t->displacement = malloc(3 * (size_t)count * sizeof *t->displacement);
    t->displacement_rows = malloc((size_t)count * sizeof *t->displacement_rows);
    for (int n = 0; t->displacement && t->displacement_rows && n < count; n++) t->displacement_rows[n] = t->displacement + 3 * (size_t)n;
    return t->displacement && t->displacement_rows;
}

trocar_status telemetry_create(telemetry *t, const char *url, const char *scene_path, double rate_hz, int flags,
                               simulation *s, const worker *w, exchange *x, report *why) {
    *t = (telemetry){.exchange = x, .simulation = s, .worker = w, .scene_path = scene_path, .rate_hz = rate_hz, .flags = flags};
    atomic_init(&t->stop, false);
    t->nodal = malloc((size_t)s->mesh.node_count * sizeof *t->nodal);
    t->added = malloc((MAX_CONTACTS + 1) * sizeof *t->added);
    t->latency = calloc(1, sizeof *t->latency);
    t->round_trip = calloc(1, sizeof *t->round_trip);
    if (!lay_out_rows(t, s->mesh.node_count) || t->nodal == NULL || t->added == NULL || t->latency == NULL
        || t->round_trip == NULL) {
        telemetry_free(t);
        return fail(why, TROCAR_NO_MEMORY, "cannot allocate telemetry buffers for %d nodes", s->mesh.node_count);
    }
    t->lcm = lcm_create(url);
    if (t->lcm != NULL) return TROCAR_OK;
    telemetry_free(t);
    return fail(why, TROCAR_BAD_INPUT, "LCM cannot use \"%s\": check --lcm-url and the multicast route",
                url ? url : "its default URL");
}

void telemetry_free(telemetry *t) {
    if (t->lcm != NULL) lcm_destroy(t->lcm);
    free(t->latency);
    free(t->round_trip);
    free(t->displacement);
    free(t->displacement_rows);
    free(t->nodal);
    free(t->added);
    *t = (telemetry){0};
}

static void print_timing(const trocar_loop_timing_t *m) {
    fprintf(stderr, "tick %lld: lateness p99 %.0f max %.0f us, compute p99 %.0f max %.0f us, %lld missed, %d contacts\n",
            (long long)m->ticks, 1e6 * m->lateness_p99, 1e6 * m->lateness_max, 1e6 * m->compute_p99, 1e6 * m->compute_max,
            (long long)m->misses, m->contacts);
}

/* Empties a ring of nanoseconds into a histogram of this interval. */
static void collect(spsc_ring *ring, histogram *h) {
    histogram_clear(h);
    for (int64_t nanoseconds; ring_pop(ring, &nanoseconds);) histogram_add(h, nanoseconds);
}

_Static_assert(HISTOGRAM_BINS == sizeof((trocar_loop_timing_t *)0)->lateness_bins / sizeof(int32_t), "bins of loop_timing_t");
_Static_assert(LOOP_STAGES == sizeof((trocar_loop_timing_t *)0)->stage_max / sizeof(double), "stages of loop_timing_t");

static void publish_timing(telemetry *t, const view_sample *view) {
    bool fresh;
    const loop_record *loop = newest_read(&t->exchange->loops, &fresh);
    if (!fresh) return; /* no new interval: nothing to tell */
    collect(&t->exchange->latencies, t->latency);
    collect(&t->exchange->round_trips, t->round_trip);

    trocar_loop_timing_t m = {
        .utime = wall_us(), .ticks = loop->ticks, .rate_hz = t->rate_hz,
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
        .wrenches_dropped = view->wrench_dropped, .contacts = view->state.active};
    histogram_bins(&loop->lateness, m.lateness_bins);
    histogram_bins(&loop->compute, m.compute_bins);
    for (int i = 0; i < LOOP_STAGES; i++) {
        m.stage_mean[i] = 1e-9 * (double)loop->stage_total[i] / (double)loop->compute.count;
        m.stage_max[i] = 1e-9 * (double)loop->stage_max[i];
    }
    trocar_loop_timing_t_publish(t->lcm, "TROCAR_TIMING", &m);
    if (t->verbose && t->timings_published++ % STATUS_HZ == 0) print_timing(&m);
}

/* The worker's failure outlives the refusals: it will not go away by itself. */
static const char *message_of(const telemetry *t, const intake_record *in) {
    if (atomic_load_explicit(&t->worker->failed, memory_order_acquire)) return t->worker->why.text;
    return in->message;
}

static void publish_status(telemetry *t, const view_sample *view) {
    const intake_record *in = newest_read(&t->exchange->intakes, NULL);
    trocar_status_t m = {
        .utime = wall_us(), .owner = in->owner, .flags = view->flags | t->flags,
        .poses_accepted = in->counts[POSE_ACCEPTED], .poses_malformed = in->counts[POSE_MALFORMED],
        .poses_not_finite = in->counts[POSE_NOT_FINITE], .poses_not_unit = in->counts[POSE_NOT_UNIT],
        .poses_jumped = in->counts[POSE_JUMPED], .poses_refused = in->counts[POSE_REFUSED],
        .poses_old = in->counts[POSE_OLD], .commands_refused = in->commands_refused,
        .pose_age = in->received == 0 ? 0.0 : 1e-9 * (double)(monotonic_ns() - in->received),
        .saturated_ticks = view->saturated_ticks,
        .scene = (char *)(uintptr_t)t->scene_path, .message = (char *)(uintptr_t)message_of(t, in)};
    trocar_status_t_publish(t->lcm, "TROCAR_STATUS", &m);
}

static void publish_deformation(telemetry *t, const view_sample *view) {
    simulation_displacement(t->simulation, &view->state, t->nodal, t->added);
    int count = t->simulation->mesh.node_count;
    for (int n = 0; n < count; n++) {
        t->displacement_rows[n][0] = (float)t->nodal[n].x;
        t->displacement_rows[n][1] = (float)t->nodal[n].y;
        t->displacement_rows[n][2] = (float)t->nodal[n].z;
    }
    trocar_deformation_t m = {.utime = wall_us(), .tick = view->tick, .node_count = count, .displacement = t->displacement_rows};
    trocar_deformation_t_publish(t->lcm, "TROCAR_DEFORMATION", &m);
}

/* Rows of doubles as LCM's generated types want them. */
typedef struct {
    double values[MAX_POINTS][3], *rows[MAX_POINTS];
} row_list;

static void set_row(row_list *list, int i, vec3 v) {
    list->rows[i] = list->values[i];
    list->values[i][0] = v.x;
    list->values[i][1] = v.y;
    list->values[i][2] = v.z;
}

_Static_assert((int)NEEDLE_MAX_SEGMENTS + 1 <= (int)MAX_POINTS, "a row_list holds the centreline too");

static void publish_contacts(telemetry *t, const view_sample *view) {
    const insertion_state *state = &view->state;
    const needle_model *needle = &t->simulation->needle;
    row_list joints, positions, forces;
    double arc[MAX_POINTS];
    int8_t sliding[MAX_POINTS];
    int segments = needle->given.segments, count = 0;

    for (int j = 0; j <= segments; j++) set_row(&joints, j, state->needle.joints[j]);
    for (; count < state->active; count++) {
        const shaft_contact *c = &state->contacts[count];
        set_row(&positions, count, needle_at(needle, &state->needle, c->arc).position);
        set_row(&forces, count, c->force);
        arc[count] = c->arc;
        sliding[count] = (int8_t)c->friction;
    }
    if (state->tip.phase == TIP_INSIDE) {
        set_row(&positions, count, state->needle.joints[segments]);
        set_row(&forces, count, state->tip.force);
        arc[count] = needle->given.length;
        sliding[count++] = (int8_t)state->tip.friction;
    }
    quat q = state->needle.base.orientation;
    trocar_contacts_t m = {.utime = wall_us(), .tick = view->tick, .pose_utime = view->pose_utime, .orientation = {q.w, q.x, q.y, q.z},
                           .joint_count = segments + 1, .centreline = joints.rows,
                           .contact_count = count, .position = positions.rows, .force = forces.rows, .arc = arc,
                           .state = sliding};
    trocar_contacts_t_publish(t->lcm, "TROCAR_CONTACTS", &m);
}

void *telemetry_run(void *context) {
    telemetry *t = context;
    realtime_flush_denormals();
    int64_t due = monotonic_ns();
    for (int64_t view_count = 0; !atomic_load_explicit(&t->stop, memory_order_relaxed); view_count++) {
        bool fresh;
        const view_sample *view = newest_read(&t->exchange->views, &fresh);
        if (view_count % (VIEW_HZ / STATUS_HZ) == 0) {
            publish_timing(t, view);
            publish_status(t, view);
        }
        if (fresh) {
            publish_contacts(t, view);
            publish_deformation(t, view);
        }
        due += 1000000000 / VIEW_HZ;
        if (due < monotonic_ns()) due = monotonic_ns(); /* a large mesh: as often as it can, without a burst */
        sleep_until(due);
    }
    return NULL;
}

void telemetry_stop(telemetry *t) { atomic_store_explicit(&t->stop, true, memory_order_relaxed); }

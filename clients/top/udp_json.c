#include "top/udp_json.h"

#include <errno.h>
#include <netdb.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

#include "common/host_port.h"
#include "common/messages.h"
#include "shared/json.h"

/* ---- the destination -------------------------------------------------------------------------------------------------- */

/* Connects to the first address that works. A name such as localhost may have both IPv4 and IPv6 addresses. Tries IPv4 first, because PlotJuggler listens on it
   by default and a sender cannot tell which one is in use. */
static int connect_any(const struct addrinfo *found, bool version_4) {
    for (const struct addrinfo *a = found; a; a = a->ai_next) {
        if ((a->ai_family == AF_INET) != version_4) continue;
        int s = socket(a->ai_family, a->ai_socktype | SOCK_CLOEXEC, a->ai_protocol);
        if (s < 0 || connect(s, a->ai_addr, a->ai_addrlen) == 0) return s;
        int error = errno;
        close(s);
        errno = error;
    }
    return -1;
}

trocar_status udp_json_open(udp_json *u, const char *to, double rate, trocar_error *why) {
    char host[256], port[6];
    *u = (udp_json){.socket = -1, .period = rate > 0 ? (int64_t)(1e6 / rate) : 0};
    for (int i = 0; i < TROCAR_MAX_NEEDLES; i++) u->needles[i].membrane = -1;
    if (!split_host_port(to, NULL, host, port))
        return fail(why, TROCAR_BAD_INPUT, "'%s': expected HOST:PORT, for example localhost:9870, with the port from 1 to 65535 and an IPv6 address in brackets", to);
    snprintf(u->to, sizeof u->to, "%s", to);
    struct addrinfo *found, hints = {.ai_socktype = SOCK_DGRAM};
    int error = getaddrinfo(host, port, &hints, &found);
    if (error != 0) return fail(why, TROCAR_BAD_INPUT, "'%s': the host is not known: %s", host, gai_strerror(error));
    u->socket = connect_any(found, true);
    if (u->socket < 0) u->socket = connect_any(found, false);
    error = errno;
    freeaddrinfo(found);
    return u->socket >= 0 ? TROCAR_OK : fail(why, TROCAR_BAD_INPUT, "'%s' cannot be reached: %s", to, strerror(error));
}

void udp_json_close(udp_json *u) {
    if (u->socket >= 0) close(u->socket);
    u->socket = -1;
}

void udp_json_describe(const udp_json *u, char *text, size_t size) {
    if (u->error == ECONNREFUSED) snprintf(text, size, "%s: no program listens there: start PlotJuggler's UDP Server, with the protocol json", u->to);
    else if (u->error) snprintf(text, size, "%s: cannot be reached: %s", u->to, strerror(u->error));
    else snprintf(text, size, "%s: %lld datagrams sent", u->to, (long long)u->count);
}

/* ---- datagrams ---------------------------------------------------------------------------------------------------------- */

typedef struct {
    char text[2048];
    json j;
} datagram;

static bool begin(datagram *d, int64_t utime) {
    d->j = (json){.out = fmemopen(d->text, sizeof d->text, "w")};
    if (!d->j.out) return false;
    json_open(&d->j, NULL, '{');
    json_time_stamp(&d->j, 1e-6 * (double)utime);
    return true;
}

static void begin_needle(datagram *d, int needle) {
    char name[16];
    snprintf(name, sizeof name, "needle%d", needle);
    json_open(&d->j, name, '{');
}

/* Records a failure, which stands for one second: if no program listens, the system reports an error only for every second datagram, as the result of the one
   before. */
static void note(udp_json *u, int error) {
    int64_t now = monotonic_ns();
    u->count += error == 0;
    if (error == 0 && now - u->failed < 1000000000) return;
    u->error = error;
    if (error) u->failed = now;
}

/* Closes the inner object and sends the datagram. */
static void finish(udp_json *u, datagram *d) {
    json_close(&d->j, '}');
    json_close(&d->j, '}');
    long size = ftell(d->j.out);
    fclose(d->j.out);
    note(u, send(u->socket, d->text, (size_t)size, MSG_DONTWAIT | MSG_NOSIGNAL) < 0 ? errno : 0);
}

static bool exists(int needle) { return needle >= 0 && needle < TROCAR_MAX_NEEDLES; }

void udp_json_pose(udp_json *u, const trocar_needle_pose_t *m) {
    if (!exists(m->needle)) return;
    udp_needle *n = &u->needles[m->needle];
    n->session = m->session;
    memcpy(n->position, m->position, sizeof n->position);
}

/* Sends a wrench if one is due; otherwise only collects its events. Wrenches do not arrive at exact intervals, so one counts as due 0.1 ms early. */
void udp_json_wrench(udp_json *u, const trocar_needle_wrench_t *m) {
    if (!exists(m->needle)) return;
    udp_needle *n = &u->needles[m->needle];
    n->events |= m->events;
    if (m->membrane >= 0) n->membrane = m->membrane;
    int64_t since = m->utime - n->sent;
    datagram d;
    if ((since >= 0 && since < u->period - 100) || !begin(&d, m->utime)) return;
    begin_needle(&d, m->needle);
    json_integer(&d.j, "tick", m->tick);
    json_xyz(&d.j, "force_N", load_vec3(m->force));
    json_xyz(&d.j, "torque_Nm", load_vec3(m->torque));
    json_xyz(&d.j, "raw_force_N", load_vec3(m->raw_force));
    json_exact(&d.j, "depth_m", m->depth);
    json_integer(&d.j, "contacts", m->contacts);
    json_integer(&d.j, "events", n->events);
    json_integer(&d.j, "membrane", n->membrane);
    json_integer(&d.j, "flags", m->flags);
    if (m->session != 0 && m->session == n->session) json_xyz(&d.j, "base_m", load_vec3(n->position));
    finish(u, &d);
    n->sent = m->utime;
    n->events = 0;
    n->membrane = -1;
}

void udp_json_timing(udp_json *u, const trocar_loop_timing_t *m) {
    datagram d;
    if (!begin(&d, m->utime)) return;
    const struct { const char *name; double value; } numbers[] = {
        {"lateness_p50_s", m->lateness_p50}, {"lateness_p99_s", m->lateness_p99}, {"lateness_max_s", m->lateness_max},
        {"compute_p50_s", m->compute_p50}, {"compute_p99_s", m->compute_p99}, {"compute_max_s", m->compute_max},
        {"round_trip_p50_s", m->round_trip_p50}, {"round_trip_p99_s", m->round_trip_p99}, {"round_trip_max_s", m->round_trip_max},
        {"worker_latency_p50_s", m->worker_latency_p50}, {"worker_latency_p99_s", m->worker_latency_p99}, {"worker_latency_max_s", m->worker_latency_max},
        {"rate_Hz", m->rate_hz},
    };
    json_open(&d.j, "loop", '{');
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++) json_exact(&d.j, numbers[i].name, numbers[i].value);
    json_integer(&d.j, "ticks", m->ticks);
    json_integer(&d.j, "misses", m->misses);
    json_integer(&d.j, "wrenches_dropped", m->wrenches_dropped);
    finish(u, &d);
}

void udp_json_status(udp_json *u, const trocar_status_t *m) {
    datagram d;
    if (!exists(m->needle) || !begin(&d, m->utime)) return;
    begin_needle(&d, m->needle);
    json_bool(&d.j, "owned", m->owner != 0);
    json_integer(&d.j, "state", m->state);
    json_exact(&d.j, "pose_age_s", m->pose_age);
    json_exact(&d.j, "energy_J", m->energy);
    json_exact(&d.j, "energy_lowest_J", m->energy_lowest);
    json_exact(&d.j, "coupling_stiffness_N_per_m", m->coupling_stiffness);
    json_integer(&d.j, "poses_accepted", m->poses_accepted);
    json_integer(&d.j, "poses_lost", m->poses_lost);
    json_integer(&d.j, "saturated_ticks", m->saturated_ticks);
    finish(u, &d);
}

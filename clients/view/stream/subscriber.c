#include "view/stream/subscriber.h"

#include <stdlib.h>
#include <string.h>

#include "common/message_fit.h"
#include "common/messages.h"
#include "common/timing.h"
#include "lcm_filter.h"
#include "printable.h"
#include "trocar_command_t.h"
#include "trocar_deformation_t.h"
#include "trocar_probe_wrench_t.h"

enum { QUEUE = 512 * TROCAR_MAX_NEEDLES }; /* half a second of wrenches */

static const int64_t SILENCE = 500000000; /* ns without a wrench before the server counts as stopped */
static const int64_t STALL = 150000000;   /* ns; a longer gap between two checks means that this program was paused. The viewer checks every 0.1 s */
static const double OWNER_SILENCE = 2.0;  /* s of silence before an owner may lose the needle; the same as in the server */
static const int64_t NEWS = 150000000; /* ns for which a needle's last wrench names its owner more reliably than its last status */

/* ---- the channels ---- */

double subscriber_time(const subscriber *f) { return 1e-9 * (double)(monotonic_ns() - f->started); }

plot_sample sample_of_wrench(double time, const trocar_needle_wrench_t *w) {
    plot_sample s = {.time = time, .depth = (float)w->depth, .events = (uint32_t)w->events, .membrane = w->membrane, .needle = w->needle};
    for (int a = 0; a < 3; a++) {
        s.force[a] = (float)w->force[a];
        s.torque[a] = (float)w->torque[a];
    }
    return s;
}

static void forget_needles(subscriber *f) {
    for (needle_feed *n = f->needles; n < f->needles + TROCAR_MAX_NEEDLES; n++) {
        if (n->contacts) trocar_contacts_t_destroy(n->contacts);
        if (n->tracks) trocar_tracks_t_destroy(n->tracks);
        if (n->status) trocar_status_t_destroy(n->status);
        *n = (needle_feed){.contacts = NULL};
    }
}

static void forget_seeds(subscriber *f) {
    if (f->seeds) trocar_seeds_t_destroy(f->seeds);
    if (f->reply) trocar_command_reply_t_destroy(f->reply);
    if (f->change_reply) trocar_command_reply_t_destroy(f->change_reply);
    if (f->values) trocar_values_t_destroy(f->values);
    if (f->deformation) trocar_deformation_t_destroy(f->deformation);
    f->seeds = NULL;
    f->deformation = NULL;
    f->reply = f->change_reply = NULL;
    f->values = NULL;
    f->seeds_heard++;
    f->replies_heard++;
}

/* Discards the previous server's data when the subscriber switches to another. */
static void note_server(subscriber *f, const trocar_needle_wrench_t *w) {
    if (f->heard != 0 && w->server == f->server) return;
    f->servers++;
    f->server = w->server;
    forget_needles(f);
    forget_seeds(f);
    f->timing = (trocar_loop_timing_t){0};
    f->probe = (trocar_probe){.placed = 0};
}

/* Returns the record of this needle. NULL if the message is not from the followed server, or if the scene has no such needle. */
static needle_feed *find_needle(subscriber *f, int64_t server, int32_t needle) {
    return server == f->choice.followed && needle >= 0 && needle < f->needle_count ? &f->needles[needle] : NULL;
}

static void on_wrench(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_needle_wrench_t w = {0};
    if (trocar_needle_wrench_t_decode(received->data, 0, (int)received->data_size, &w) != (int)received->data_size) {
        f->refused++;
        return;
    }
    if (!server_choice_follows(&f->choice, w.server, 1e-9 * (double)monotonic_ns())) return;
    needle_feed *n = find_needle(f, w.server, w.needle);
    if (!n) return;
    note_server(f, &w);
    n->wrench = w;
    f->tick = w.tick;
    f->probe.stopped = (w.flags & TROCAR_NEEDLE_WRENCH_T_PROBE_STOPPED) != 0;
    n->heard = f->heard = f->checked = monotonic_ns();
    f->silence = 0;
    if (!f->timeline) return;
    plot_sample s = sample_of_wrench(subscriber_time(f), &w);
    s.lateness_p99 = (float)f->timing.lateness_p99;
    s.lateness_max = (float)f->timing.lateness_max;
    s.compute_p99 = (float)f->timing.compute_p99;
    s.compute_max = (float)f->timing.compute_max;
    trocar_error why;
    timeline_add_sample(f->timeline, &s, &why); /* cannot fail in live mode, where the ring is preallocated */
}

static void on_timing(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_loop_timing_t m = {0};
    if (trocar_loop_timing_t_decode(received->data, 0, (int)received->data_size, &m) != (int)received->data_size) f->refused++;
    else if (m.server == f->choice.followed) f->timing = m;
}

static void on_status(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_status_t m = {0};
    if (!status_fits(received->data, received->data_size)
        || trocar_status_t_decode(received->data, 0, (int)received->data_size, &m) < 0) {
        f->refused++;
        return;
    }
    for (char **text = (char *[]){m.host, m.scene, m.inverse, m.message, NULL}; *text; text++) make_printable(*text);
    needle_feed *n = find_needle(f, m.server, m.needle);
    if (n) {
        if (n->status) trocar_status_t_destroy(n->status);
        n->status = trocar_status_t_copy(&m);
    }
    trocar_status_t_decode_cleanup(&m);
}

static void on_contacts(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_contacts_t m = {0};
    if (!contacts_fit(received->data, received->data_size)
        || trocar_contacts_t_decode(received->data, 0, (int)received->data_size, &m) < 0) {
        f->refused++;
        return;
    }
    needle_feed *n = find_needle(f, m.server, m.needle);
    if (n) {
        if (n->contacts) trocar_contacts_t_destroy(n->contacts);
        n->contacts = trocar_contacts_t_copy(&m);
    }
    trocar_contacts_t_decode_cleanup(&m);
}

static void on_tracks(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_tracks_t m = {0};
    if (!tracks_fit(received->data, received->data_size) || trocar_tracks_t_decode(received->data, 0, (int)received->data_size, &m) < 0) {
        f->refused++;
        return;
    }
    needle_feed *n = find_needle(f, m.server, m.needle);
    if (n) {
        if (n->tracks) trocar_tracks_t_destroy(n->tracks);
        n->tracks = trocar_tracks_t_copy(&m);
    }
    trocar_tracks_t_decode_cleanup(&m);
}

static void on_seeds(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_seeds_t m = {0};
    if (!seeds_fit(received->data, received->data_size) || trocar_seeds_t_decode(received->data, 0, (int)received->data_size, &m) < 0) {
        f->refused++;
        return;
    }
    if (m.server == f->choice.followed) {
        if (f->seeds) trocar_seeds_t_destroy(f->seeds);
        f->seeds = trocar_seeds_t_copy(&m);
        f->seeds_heard++;
    }
    trocar_seeds_t_decode_cleanup(&m);
}

static void on_reply(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_command_reply_t m = {0};
    if (!reply_fits(received->data, received->data_size) || trocar_command_reply_t_decode(received->data, 0, (int)received->data_size, &m) < 0) {
        f->refused++;
        return;
    }
    bool settled = m.status != TROCAR_COMMAND_REPLY_T_PENDING;
    if (settled && m.server == f->choice.followed && m.session == f->session && m.command != TROCAR_COMMAND_T_RELEASE) {
        bool changes = m.command == TROCAR_COMMAND_T_CHANGE;
        trocar_command_reply_t **last = changes ? &f->change_reply : &f->reply;
        if (*last) trocar_command_reply_t_destroy(*last);
        make_printable(m.message);
        *last = trocar_command_reply_t_copy(&m);
        f->replies_heard += !changes;
    }
    trocar_command_reply_t_decode_cleanup(&m);
}

static void on_values(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_values_t m = {0};
    if (!values_fit(received->data, received->data_size) || trocar_values_t_decode(received->data, 0, (int)received->data_size, &m) < 0) {
        f->refused++;
        return;
    }
    if (m.server == f->choice.followed) {
        if (f->values) trocar_values_t_destroy(f->values);
        for (int i = 0; i < m.count; i++) make_printable(m.key[i]);
        f->values = trocar_values_t_copy(&m);
    }
    trocar_values_t_decode_cleanup(&m);
}

static void on_probe(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_probe_wrench_t m = {0};
    if (trocar_probe_wrench_t_decode(received->data, 0, (int)received->data_size, &m) != (int)received->data_size) {
        f->refused++;
        return;
    }
    if (m.server != f->choice.followed) return;
    f->probe = (trocar_probe){.contacts = m.contacts, .placed = 1, .stopped = f->probe.stopped};
    memcpy(f->probe.base.position, m.position, sizeof m.position);
    memcpy(f->probe.base.orientation, m.orientation, sizeof m.orientation);
    memcpy(f->probe.force, m.force, sizeof m.force);
    memcpy(f->probe.torque, m.torque, sizeof m.torque);
    f->probe_owner = m.session;
}

/* Returns the time of a tick. Also works for pictures that arrive after their tick's wrench. */
static double time_of_tick(const subscriber *f, int64_t tick) {
    return 1e-9 * (double)(f->heard - f->started) - (double)(f->tick - tick) * f->period;
}

/* Completes a picture. The deformation of a tick arrives last, after the contacts of all needles that have been held. If there are none, a placed probe is
   enough. */
static void on_deformation(const lcm_recv_buf_t *received, const char *channel, void *context) {
    (void)channel;
    subscriber *f = context;
    trocar_deformation_t m = {0};
    if (!deformation_fits(received->data, received->data_size, f->node_count)
        || trocar_deformation_t_decode(received->data, 0, (int)received->data_size, &m) < 0) {
        f->refused++;
        return;
    }
    trocar_error why; /* if out of memory, a picture is skipped */
    needle_shown needles[TROCAR_MAX_NEEDLES];
    bool complete = false, known = false;
    for (int i = 0; i < f->needle_count; i++) {
        const trocar_contacts_t *contacts = f->needles[i].contacts;
        bool current = contacts && contacts->tick == m.tick && contacts->server == m.server;
        needles[i] = (needle_shown){current ? contacts : NULL, f->needles[i].tracks};
        complete |= current;
        known |= contacts != NULL;
    }
    complete |= f->probe.placed && !known;
    if (m.server == f->choice.followed) {
        if (f->deformation) trocar_deformation_t_destroy(f->deformation);
        f->deformation = trocar_deformation_t_copy(&m);
    }
    if (complete && f->timeline) timeline_add_picture(f->timeline, time_of_tick(f, m.tick), needles, f->needle_count, &f->probe, &m, &why);
    trocar_deformation_t_decode_cleanup(&m);
}

trocar_status subscriber_open(subscriber *f, lcm_t *lcm, const trocar_model *model, timeline *t, trocar_error *why) {
    static const char *const channels[] = {"TROCAR_WRENCH", "TROCAR_TIMING", "TROCAR_STATUS", "TROCAR_CONTACTS", "TROCAR_TRACKS", "TROCAR_DEFORMATION", "TROCAR_SEEDS",
                                           "TROCAR_REPLY", "TROCAR_PROBE_WRENCH", "TROCAR_VALUES", NULL};
    static const lcm_msg_handler_t handlers[] = {on_wrench, on_timing, on_status, on_contacts, on_tracks, on_deformation, on_seeds, on_reply, on_probe, on_values};
    static const packet_wishes wishes = {.channels = channels}; /* accept fragments, because the deformation of a large mesh arrives in several */
    lcm_filter_restrict(&wishes);
    *f = (subscriber){.node_count = trocar_model_node_count(model), .needle_count = trocar_model_needles(model), .timeline = t,
                      .started = monotonic_ns(), .period = 1.0 / trocar_model_rate(model), .choice.patience = 1e-9 * (double)SILENCE};
    for (size_t i = 0; channels[i] != NULL; i++) {
        lcm_subscription_t *s = lcm_subscribe(lcm, channels[i], handlers[i], f);
        if (!s || lcm_subscription_set_queue_capacity(s, QUEUE) != 0)
            return fail(why, TROCAR_SYSTEM, "LCM cannot receive on %s: check the multicast route", channels[i]);
    }
    return TROCAR_OK;
}

void subscriber_close(subscriber *f) {
    forget_needles(f);
    forget_seeds(f);
    *f = (subscriber){0};
}

bool subscriber_alive(subscriber *f) {
    int64_t now = monotonic_ns(), since = now - f->checked;
    f->silence += since < STALL ? since : STALL;
    f->checked = now;
    return f->heard != 0 && f->silence < SILENCE;
}

bool subscriber_shows(const subscriber *f) {
    bool shows = f->probe.placed != 0;
    for (int i = 0; i < f->needle_count; i++) shows |= f->needles[i].contacts != NULL;
    return shows;
}

int64_t subscriber_owner(const subscriber *f, int needle) {
    const needle_feed *n = &f->needles[needle];
    bool newer = n->heard != 0 && monotonic_ns() - n->heard < NEWS;
    if (n->status && n->status->pose_age > OWNER_SILENCE && (!newer || n->wrench.session == n->status->owner)) return 0;
    return newer || !n->status ? n->wrench.session : n->status->owner;
}

bool subscriber_base(subscriber *f, int needle, pose *base) {
    const trocar_contacts_t *contacts = f->needles[needle].contacts;
    if (!subscriber_alive(f) || !contacts) return false;
    *base = load_pose(contacts->centreline[0], contacts->orientation);
    return true;
}

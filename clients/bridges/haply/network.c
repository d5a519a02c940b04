#include "network.h"

#include <errno.h>
#include <libwebsockets.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/timerfd.h>
#include <unistd.h>

#include "common/timing.h"

enum { PATIENCE = 3 }; /* s, time limit for the WebSocket handshake */

struct network {
    struct lws_context *lws;
    struct lws_vhost *host;
    int timer;
    void (*tick)(void *context);
    void *context;
};

static void end(websocket *s, const char *why) {
    s->wsi = NULL;
    s->open = s->trying = false;
    s->retry_at = monotonic_ns() + llround(1e9 * s->retry);
    s->closed(s->context, why);
}

static void take(websocket *s, const void *data, size_t length, bool last) {
    s->overlong = s->overlong || s->length + length > NETWORK_TEXT;
    if (!s->overlong) memcpy(s->text + s->length, data, length);
    s->length = s->overlong ? 0 : s->length + length;
    if (!last) return;
    s->received(s->context, s->text, s->length);
    s->length = 0;
    s->overlong = false;
}

/* Sends the requested message. Returns -1 if the connection must be closed. */
static int send_message(websocket *s) {
    unsigned char message[LWS_PRE + 1024];
    size_t length = s->write(s->context, (char *)message + LWS_PRE, sizeof message - LWS_PRE);
    return length > 0 && lws_write(s->wsi, message + LWS_PRE, length, LWS_WRITE_TEXT) < 0 ? -1 : 0;
}

static int on_socket(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *data, size_t length) {
    websocket *s = user;
    switch (reason) {
    case LWS_CALLBACK_CLIENT_ESTABLISHED:
        s->open = true;
        s->length = 0;
        s->overlong = false;
        s->opened(s->context);
        return 0;
    case LWS_CALLBACK_CLIENT_RECEIVE:
        take(s, data, length, lws_is_final_fragment(wsi) && lws_remaining_packet_payload(wsi) == 0);
        return 0;
    case LWS_CALLBACK_CLIENT_WRITEABLE: return s->open ? send_message(s) : 0;
    case LWS_CALLBACK_CLIENT_CONNECTION_ERROR: end(s, data ? (const char *)data : "no connection"); return 0;
    case LWS_CALLBACK_CLIENT_CLOSED: end(s, "the connection was closed"); return 0;
    default: return 0;
    }
}

static int on_timer(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *data, size_t length) {
    (void)user, (void)data, (void)length;
    network *n = lws_context_user(lws_get_context(wsi));
    uint64_t count;
    if (reason == LWS_CALLBACK_RAW_RX_FILE && read(n->timer, &count, sizeof count) > 0) n->tick(n->context);
    return 0;
}

static const struct lws_protocols protocols[] = {{.name = "socket", .callback = on_socket, .rx_buffer_size = 1 << 16},
                                                 {.name = "timer", .callback = on_timer},
                                                 {0}};

static bool start_timer(network *n, double rate) {
    n->timer = timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC);
    int own = n->timer < 0 ? -1 : dup(n->timer); /* libwebsockets closes descriptors passed to it, so give it a duplicate */
    if (own < 0) return false;
    struct timespec period = {.tv_sec = (time_t)(1 / rate), .tv_nsec = lround(1e9 * fmod(1 / rate, 1.0))};
    lws_adopt_desc_t adopted = {.vh = n->host, .type = LWS_ADOPT_RAW_FILE_DESC, .fd.filefd = own, .vh_prot_name = "timer"};
    if (!lws_adopt_descriptor_vhost_via_info(&adopted)) {
        close(own);
        return false;
    }
    return timerfd_settime(n->timer, 0, &(struct itimerspec){period, period}, NULL) == 0;
}

trocar_status network_create(double rate, void (*tick)(void *context), void *context, network **created, trocar_error *why) {
    network *n = calloc(1, sizeof *n);
    if (!n) return fail(why, TROCAR_NO_MEMORY, "no memory for the network");
    *n = (network){.timer = -1, .tick = tick, .context = context};
    lws_set_log_level(0, NULL); /* no library log: `closed` already reports the reason */
    struct lws_context_creation_info info = {.port = CONTEXT_PORT_NO_LISTEN, .protocols = protocols, .user = n, .vhost_name = "haply",
                                             .timeout_secs = PATIENCE, .connect_timeout_secs = PATIENCE,
                                             .options = LWS_SERVER_OPTION_EXPLICIT_VHOSTS};
    n->lws = lws_create_context(&info);
    if (n->lws) n->host = lws_create_vhost(n->lws, &info);
    if (!n->host || !start_timer(n, rate)) {
        fail(why, TROCAR_SYSTEM, "libwebsockets cannot start: %s", strerror(errno));
        network_free(n);
        return TROCAR_SYSTEM;
    }
    *created = n;
    return TROCAR_OK;
}

void network_free(network *n) {
    if (n->lws) lws_context_destroy(n->lws);
    if (n->timer >= 0) close(n->timer);
    free(n);
}

void network_round(network *n) { lws_service(n->lws, 0); }

void websocket_keep(network *n, websocket *s) {
    if (s->port == 0 || s->trying || monotonic_ns() < s->retry_at) return;
    s->trying = true;
    struct lws_client_connect_info info = {.context = n->lws, .vhost = n->host, .address = s->address, .port = s->port, .path = "/", .host = s->address,
                                           .local_protocol_name = "socket", .userdata = s, .pwsi = &s->wsi};
    if (!lws_client_connect_via_info(&info) && s->trying) end(s, "no connection");
}

void websocket_ask_to_write(websocket *s) {
    if (s->open) lws_callback_on_writable(s->wsi);
}

void websocket_drop(websocket *s) {
    if (s->open) lws_set_timeout(s->wsi, PENDING_TIMEOUT_USER_OK, LWS_TO_KILL_ASYNC);
}

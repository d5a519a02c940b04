#include "view/web/web.h"

#include <errno.h>
#include <libwebsockets.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

enum {
    IN_FLIGHT = 2,           /* most unacknowledged updates per browser */
    UPDATE_BYTES = 1 << 18,  /* bytes, approximate size of an update */
    PNG_BYTES = 64 << 20,    /* bytes, largest picture accepted */
    WATCHES = 4,
    HANDSHAKE_PATIENCE = 5,  /* s, timeout of a request */
    TRY_AGAIN_LATER = 1013,  /* WebSocket close code, IANA registry (RFC 6455) */
};

static const lws_usec_t STATUS_PERIOD = 100000; /* us */

/* One WebSocket. */
typedef struct browser {
    struct browser *next;
    struct lws *wsi;
    int number;              /* see web_page */
    timeline_cursor cursor;
    bool has_scene, wants_status;
    int64_t versions[WEB_SECTIONS]; /* of the sections that the browser has */
    bool refused;            /* the browser gets the reason and is disconnected; it is not in `browsers` */
    int in_flight;
    int silent;              /* statuses sent since the browser's last message */
    uint32_t steered;        /* number of its last move command */
    byte_buffer received;    /* part of a message received so far */
} browser;

typedef struct {
    void (*readable)(void *context);
} watch;

struct web {
    web_settings settings;
    struct lws_context *lws;
    struct lws_vhost *host;
    lws_sorted_usec_list_t timer;
    browser *browsers;
    browser *driver;         /* the browser that drives a needle, or NULL */
    uint32_t needle;         /* the needle that it drives */
    int browser_count;
    watch watches[WATCHES];
    int watch_count;
    byte_buffer update;      /* the update being sent, after LWS_PRE bytes */
};

/* ---- access control ---- */

/* True if the host in `given`, which is "name:port" or "[v6]:port", is `name`. */
static bool is_host(const char *given, const char *name) {
    size_t length = strlen(name);
    bool v6 = strchr(name, ':') != NULL;
    if (v6 && *given++ != '[') return false;
    if (strncasecmp(given, name, length) != 0 || (v6 && given[length++] != ']')) return false;
    return given[length] == '\0' || given[length] == ':';
}

bool web_host_allowed(const char *host, const char *address, const char *name) {
    return is_host(host, "127.0.0.1") || is_host(host, "localhost") || is_host(host, "::1")
        || (address && is_host(host, address)) || (name && is_host(host, name));
}

bool web_origin_allowed(const char *origin, const char *host, const char *address, const char *name) {
    static const char scheme[] = "http://";
    if (strncmp(origin, scheme, sizeof scheme - 1) != 0 || strcasecmp(origin + sizeof scheme - 1, host) != 0) return false;
    return web_host_allowed(host, address, name);
}

/* Answers 403 with the reason. Returns -1. */
static int forbid(struct lws *wsi, const char *reason) {
    lws_return_http_status(wsi, HTTP_STATUS_FORBIDDEN, reason);
    return -1;
}

/* Checks whether a request is allowed: for a WebSocket if `socket` is true, otherwise for a file of the page. If it is not, answers with an error and returns
   -1. */
static int filter(const web *w, struct lws *wsi, bool socket) {
    const web_settings *s = &w->settings;
    char origin[256] = "", host[256] = "";
    lws_hdr_copy(wsi, origin, sizeof origin, WSI_TOKEN_ORIGIN);
    lws_hdr_copy(wsi, host, sizeof host, WSI_TOKEN_HOST);
    bool has_origin = lws_hdr_total_length(wsi, WSI_TOKEN_ORIGIN) > 0;
    if (!web_host_allowed(host, s->address, s->host))
        return forbid(wsi, "trocar-view does not accept this host name. Open the page at 127.0.0.1 or localhost, or start trocar-view "
                           "with this name as --host.");
    if ((socket || has_origin) && !web_origin_allowed(origin, host, s->address, s->host))
        return forbid(wsi, "Pages of other sites may not connect to trocar-view.");
    return 0;
}

/* ---- sending ---- */

static void append_status(web *w, browser *b) {
    b->wants_status = false;
    char *json = w->settings.describe(w->settings.context, &(web_page){b->number, w->browser_count, w->driver ? w->driver->number : 0, b->steered});
    if (json) encode_json(&w->update, SECTION_STATUS, json);
    free(json);
}

static bool has_newest(const web *w, const browser *b, int section) { return b->versions[section] == w->settings.sections[section]->version; }

static void append_sections(web *w, browser *b) {
    for (int i = 0; i < w->settings.section_count; i++) {
        const web_section *s = w->settings.sections[i];
        if (!has_newest(w, b, i)) bytes_append(&w->update, s->bytes.data, s->bytes.length);
        b->versions[i] = s->version;
    }
}

/* Sends the browser the reason why it is refused. Returns -1 to close the connection. */
static int send_refusal(const browser *b) {
    char reason[100];
    int length = snprintf(reason, sizeof reason, "%d browsers are connected already: close one of them.", WEB_BROWSERS);
    lws_close_reason(b->wsi, (enum lws_close_status)TRY_AGAIN_LATER, (unsigned char *)reason, (size_t)length);
    return -1;
}

/* Sends an update to the browser. Returns -1 to close the connection. */
static int send_update(web *w, browser *b) {
    static const unsigned char space[LWS_PRE];
    if (b->refused) return send_refusal(b);
    if (b->in_flight >= IN_FLIGHT) return 0;
    bytes_clear(&w->update);
    bytes_append(&w->update, space, sizeof space);
    if (!b->has_scene) bytes_append(&w->update, w->settings.scene->data, w->settings.scene->length);
    if (b->wants_status) append_status(w, b);
    append_sections(w, b);
    timeline_read(w->settings.timeline, &b->cursor, UPDATE_BYTES, &w->update);
    size_t length = w->update.length - LWS_PRE;
    if (w->update.failed) return -1;
    if (length == 0) return 0;
    b->has_scene = true;
    b->in_flight++;
    return lws_write(b->wsi, w->update.data + LWS_PRE, length, LWS_WRITE_BINARY) < 0 ? -1 : 0;
}

static bool has_news(const web *w, const browser *b) {
    for (int i = 0; i < w->settings.section_count; i++)
        if (!has_newest(w, b, i)) return true;
    return !b->has_scene || b->wants_status || timeline_has_news(w->settings.timeline, &b->cursor);
}

static void offer(const web *w, const browser *b) {
    if (b->in_flight < IN_FLIGHT && has_news(w, b)) lws_callback_on_writable(b->wsi);
}

bool web_delivered(const web *w, const web_section *section) {
    int i = 0;
    while (w->settings.sections[i] != section) i++;
    for (const browser *b = w->browsers; b; b = b->next)
        if (has_newest(w, b, i)) return true;
    return w->browsers == NULL;
}

void web_news(web *w) {
    for (const browser *b = w->browsers; b; b = b->next) offer(w, b);
}

static void set_driver(web *w, browser *b, const web_action *action) {
    w->driver = b;
    w->needle = action->needle;
    w->settings.act(w->settings.context, action);
}

void web_let_go(web *w) {
    if (w->driver) set_driver(w, NULL, &(web_action){.kind = ACTION_RELEASE});
}

static bool may_drive(const web *w, uint32_t needle) {
    return !w->settings.may_drive || w->settings.may_drive(w->settings.context, needle);
}

/* Sends the status to all browsers and disconnects those that no longer answer, so that a hanging page keeps neither the needle nor a connection. The page
   reconnects when it runs again. The timer counts unanswered statuses instead of time, so that pausing this program disconnects nobody. */
static void on_timer(lws_sorted_usec_list_t *timer) {
    web *w = lws_container_of(timer, web, timer);
    for (browser *b = w->browsers; b; b = b->next) {
        b->wants_status = true;
        if (++b->silent <= w->settings.patience) continue;
        if (b == w->driver) web_let_go(w);
        lws_set_timeout(b->wsi, PENDING_TIMEOUT_USER_OK, LWS_TO_KILL_ASYNC);
    }
    if (w->driver && !may_drive(w, w->needle)) web_let_go(w);
    web_news(w);
    lws_sul_schedule(w->lws, 0, &w->timer, on_timer, STATUS_PERIOD);
}

/* ---- receiving ---- */

/* Handles an action. The first browser to ask for a needle gets it; requests from others are ignored. */
static void take_action(web *w, browser *b, const web_action *action) {
    switch (action->kind) {
    case ACTION_ACKNOWLEDGE:
        if (b->in_flight > 0) b->in_flight--;
        offer(w, b);
        break;
    case ACTION_TAKE:
        if (!w->driver && may_drive(w, action->needle)) set_driver(w, b, action);
        break;
    case ACTION_RELEASE:
        if (w->driver == b) web_let_go(w);
        break;
    case ACTION_STEER:
    case ACTION_RESET:
    case ACTION_HOLE:
    case ACTION_DROP:
    case ACTION_UNDO:
    case ACTION_LEAVE:
    case ACTION_PROBE:
        if (w->driver == b) w->settings.act(w->settings.context, action);
        break;
    case ACTION_REMOVE:
    case ACTION_START:
    case ACTION_FINISH:
        if (!w->driver || w->driver == b) w->settings.act(w->settings.context, action);
        break;
    case ACTION_LOOK: w->settings.act(w->settings.context, action); break;
    default: break;
    }
}

/* Handles a complete message. Returns false if it is invalid. */
static bool take_message(web *w, browser *b) {
    const byte_buffer *m = &b->received;
    web_action action;
    if (m->failed || m->length < sizeof action) return false;
    memcpy(&action, m->data, sizeof action);
    if (action.kind == ACTION_STEER || action.kind == ACTION_PROBE) b->steered = action.needle;
    if (action.kind == ACTION_PICTURE && w->settings.take_png) {
        w->settings.take_png(w->settings.context, m->data + sizeof action, m->length - sizeof action);
        return true;
    }
    if (action.kind == ACTION_CHANGE) {
        char text[WEB_TEXT + 1];
        size_t length = m->length - sizeof action;
        if (length > WEB_TEXT) return false;
        memcpy(text, m->data + sizeof action, length);
        text[length] = '\0';
        if (w->settings.change) w->settings.change(w->settings.context, &action, text);
        return true;
    }
    if (m->length != sizeof action || action.kind < ACTION_ACKNOWLEDGE || action.kind > ACTION_LAST || action.kind == ACTION_PICTURE) return false;
    take_action(w, b, &action);
    return true;
}

/* Receives part of a message. Returns -1 to close the connection. */
static int receive(web *w, browser *b, const void *data, size_t length) {
    size_t most = w->settings.take_png ? PNG_BYTES : WEB_ACTION_BYTES + WEB_TEXT;
    if (b->refused) return 0;
    if (b->received.length + length > most || !lws_frame_is_binary(b->wsi)) return -1;
    b->silent = 0;
    bytes_append(&b->received, data, length);
    if (!lws_is_final_fragment(b->wsi) || lws_remaining_packet_payload(b->wsi) > 0) return 0;
    bool good = take_message(w, b);
    b->received.length = 0;
    return good ? 0 : -1;
}

/* ---- connections ---- */

/* Returns the smallest number from 1 that no browser has. */
static int free_number(const web *w) {
    for (int number = 1;; number++) {
        const browser *b = w->browsers;
        while (b && b->number != number) b = b->next;
        if (!b) return number;
    }
}

static void add_browser(web *w, browser *b, struct lws *wsi) {
    *b = (browser){.next = w->browsers, .wsi = wsi, .wants_status = true, .refused = w->browser_count == WEB_BROWSERS};
    lws_callback_on_writable(wsi);
    if (b->refused) return;
    b->number = free_number(w);
    w->browsers = b;
    w->browser_count++;
}

static void remove_browser(web *w, browser *b) {
    if (w->driver == b) web_let_go(w);
    browser **link = &w->browsers;
    while (*link && *link != b) link = &(*link)->next;
    if (*link) {
        *link = b->next;
        w->browser_count--;
    }
    bytes_free(&b->received);
}

/* Serves the page's files. Also called for a WebSocket without a protocol. */
static int on_request(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *data, size_t length) {
    switch (reason) {
    case LWS_CALLBACK_FILTER_HTTP_CONNECTION: return filter(lws_context_user(lws_get_context(wsi)), wsi, false);
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION: return forbid(wsi, "Unknown WebSocket protocol.");
    default: return lws_callback_http_dummy(wsi, reason, user, data, length);
    }
}

static int on_socket(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *data, size_t length) {
    struct lws_context *context = lws_get_context(wsi);
    web *w = context ? lws_context_user(context) : NULL;
    browser *b = user;
    switch (reason) {
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION: return filter(w, wsi, true);
    case LWS_CALLBACK_ESTABLISHED: add_browser(w, b, wsi); return 0;
    case LWS_CALLBACK_SERVER_WRITEABLE: return send_update(w, b);
    case LWS_CALLBACK_RECEIVE: return receive(w, b, data, length);
    case LWS_CALLBACK_CLOSED: remove_browser(w, b); return 0;
    default: return 0;
    }
}

static int on_descriptor(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *data, size_t length) {
    (void)user, (void)data, (void)length;
    if (reason == LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION) return forbid(wsi, "Unknown WebSocket protocol.");
    if (reason != LWS_CALLBACK_RAW_RX_FILE) return 0;
    web *w = lws_context_user(lws_get_context(wsi));
    const watch *seen = lws_get_opaque_user_data(wsi);
    seen->readable(w->settings.context);
    return 0;
}

/* ---- set-up ---- */

static const struct lws_protocols protocols[] = {
    {.name = "http", .callback = on_request},
    {.name = "trocar-view", .callback = on_socket, .per_session_data_size = sizeof(browser), .rx_buffer_size = 1 << 16},
    {.name = "descriptor", .callback = on_descriptor},
    {0},
};

static trocar_status check_page(const char *page, trocar_error *why) {
    char index[4096];
    snprintf(index, sizeof index, "%s/index.html", page);
    if (access(index, R_OK) == 0) return TROCAR_OK;
    return fail(why, TROCAR_BAD_INPUT, "%s: %s: the page is not built: install npm (scripts/setup), then run scripts/build", index,
                strerror(errno));
}

static trocar_status listen_here(web *w, trocar_error *why) {
    const web_settings *s = &w->settings;
    static const struct lws_protocol_vhost_options log_type = {.name = ".log", .value = "application/octet-stream"},
                                                   types = {.next = &log_type, .name = ".csv", .value = "text/csv"};
    static struct lws_http_mount mount, task, runs;
    runs = (struct lws_http_mount){.mountpoint = "/runs", .mountpoint_len = 5, .origin = s->runs_folder, .origin_protocol = LWSMPRO_FILE, .extra_mimetypes = &types};
    task = (struct lws_http_mount){.mount_next = &runs, .mountpoint = "/task", .mountpoint_len = 5, .origin = s->task_folder, .origin_protocol = LWSMPRO_FILE};
    mount = (struct lws_http_mount){.mount_next = s->task_folder ? &task : NULL, .mountpoint = "/", .mountpoint_len = 1, .origin = s->page, .def = "index.html",
                                    .origin_protocol = LWSMPRO_FILE};
    bool v6 = s->address && strchr(s->address, ':');
    const char *place = s->socket ? s->socket : s->address ? s->address : "127.0.0.1";
    struct lws_context_creation_info info = {
        .port = s->socket ? 0 : s->port, .iface = place, .protocols = protocols, .mounts = &mount, .user = w, .vhost_name = "trocar-view",
        .timeout_secs = HANDSHAKE_PATIENCE, .keepalive_timeout = HANDSHAKE_PATIENCE, .timeout_secs_ah_idle = HANDSHAKE_PATIENCE,
        .options = LWS_SERVER_OPTION_HTTP_HEADERS_SECURITY_BEST_PRACTICES_ENFORCE | LWS_SERVER_OPTION_EXPLICIT_VHOSTS
                 | LWS_SERVER_OPTION_FAIL_UPON_UNABLE_TO_BIND | (v6 ? 0 : LWS_SERVER_OPTION_DISABLE_IPV6)
                 | (s->socket ? LWS_SERVER_OPTION_UNIX_SOCK : 0)};
    w->lws = lws_create_context(&info);
    if (w->lws) w->host = lws_create_vhost(w->lws, &info);
    if (w->host) return TROCAR_OK;
    if (s->socket) return fail(why, TROCAR_BAD_INPUT, "%s: cannot listen on this socket: does its folder exist, or is the socket in use?", place);
    return fail(why, TROCAR_BAD_INPUT, "cannot listen on %s:%d: is the port in use? Choose another --port", place, s->port);
}

trocar_status web_create(const web_settings *settings, web **created, trocar_error *why) {
    trocar_status status = check_page(settings->page, why);
    if (status != TROCAR_OK) return status;
    web *w = calloc(1, sizeof *w);
    if (!w) return fail(why, TROCAR_NO_MEMORY, "no memory for the web server");
    w->settings = *settings;
    if (w->settings.patience == 0) w->settings.patience = WEB_PATIENCE;
    lws_set_log_level(LLL_ERR, NULL);
    status = listen_here(w, why);
    if (status != TROCAR_OK) {
        web_free(w);
        return status;
    }
    lws_sul_schedule(w->lws, 0, &w->timer, on_timer, STATUS_PERIOD);
    *created = w;
    return TROCAR_OK;
}

void web_free(web *w) {
    if (w->lws) lws_context_destroy(w->lws);
    bytes_free(&w->update);
    free(w);
}

int web_port(const web *w) { return lws_get_vhost_listen_port(w->host); }

trocar_status web_watch(web *w, int descriptor, void (*readable)(void *context), trocar_error *why) {
    if (w->watch_count == WATCHES) return fail(why, TROCAR_SYSTEM, "cannot watch more than %d descriptors", WATCHES);
    int own = dup(descriptor); /* libwebsockets closes descriptors that it adopts */
    watch *added = &w->watches[w->watch_count];
    *added = (watch){readable};
    lws_adopt_desc_t adopted = {.vh = w->host, .type = LWS_ADOPT_RAW_FILE_DESC, .fd.filefd = own,
                                .vh_prot_name = "descriptor", .opaque = added};
    if (own < 0 || !lws_adopt_descriptor_vhost_via_info(&adopted)) {
        trocar_status status = fail(why, TROCAR_SYSTEM, "cannot watch a descriptor: %s", strerror(errno));
        if (own >= 0) close(own);
        return status;
    }
    w->watch_count++;
    return TROCAR_OK;
}

void web_round(web *w) { lws_service(w->lws, 0); }

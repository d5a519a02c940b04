/* The page and its WebSockets, through libwebsockets: one thread, no lock. Each browser is sent what it has not seen yet
   once it has taken what it was sent before, so that a slow one sees fewer pictures and holds up nobody. */
#ifndef TROCAR_WEB_H
#define TROCAR_WEB_H

#include "timeline.h"

typedef struct web web;

enum { WEB_PORT = 8686, WEB_BROWSERS = 16, WEB_ACTION_BYTES = 32, WEB_PATIENCE = 100 };

/* What a browser asks for; little-endian, 32 bytes. */
typedef enum { ACTION_ACKNOWLEDGE = 1, ACTION_TAKE, ACTION_STEER, ACTION_RESET, ACTION_RELEASE, ACTION_PICTURE } action_kind;
typedef struct {
    uint32_t kind;
    float steer[6];          /* ACTION_STEER: right, up, forward, pitch, yaw, roll, each -1 .. 1 */
    uint32_t unused;
} web_action;
_Static_assert(sizeof(web_action) == WEB_ACTION_BYTES, "link.js writes 32 bytes");

typedef struct {
    const char *page;        /* folder of the built page */
    const char *address;     /* to listen on; NULL: 127.0.0.1 */
    const char *socket;      /* path of a Unix socket to listen on instead, or NULL */
    const char *host;        /* name under which browsers may open the page besides localhost and `address`, or NULL */
    int port;                /* 0: any free one */
    int patience;            /* tenths of a second without a message after which a browser has hung and is disconnected;
                                0: WEB_PATIENCE */
    const timeline *timeline;
    const byte_buffer *scene; /* encoded: sent first */
    void *context;           /* of the functions below */
    char *(*describe)(void *context, bool drives, bool driven);  /* JSON of the state, to be freed; NULL: none now */
    void (*act)(void *context, const web_action *action);        /* of the one browser that drives */
    bool (*may_drive)(void *context);  /* whether a browser may take and keep the needle now; NULL: always */
    void (*take_png)(void *context, const void *png, size_t size); /* NULL: none is taken */
} web_settings;

/* Listens; the strings in `settings` must outlive it. BAD_INPUT when the page is not there or the address cannot be had. */
trocar_status web_create(const web_settings *settings, web **created, report *why);
void web_free(web *w);
int web_port(const web *w);

/* Watches a descriptor: `readable` is called whenever there is something to read. The descriptor stays the caller's. */
trocar_status web_watch(web *w, int descriptor, void (*readable)(void *context), report *why);

/* Serves what is due, waiting for it. */
void web_round(web *w);

/* There is news in the timeline. */
void web_news(web *w);

/* Takes the needle from the browser that drives, if one does. */
void web_let_go(web *w);

/* Whether a request with this Host header is meant for this program: under another name, a site could point it at 127.0.0.1. */
bool web_host_allowed(const char *host, const char *address, const char *name);

/* Whether a page from `origin` may open a WebSocket here, given the request's Host header: only a page that came from here, under
   an allowed name. Another site's page could otherwise drive the needle. */
bool web_origin_allowed(const char *origin, const char *host, const char *address, const char *name);

#endif

/* A single-threaded web server for the page and its WebSockets, based on libwebsockets. A browser gets new data only after acknowledging earlier updates, so a
   slow browser gets fewer pictures and does not hold up others. */
#ifndef TROCAR_WEB_H
#define TROCAR_WEB_H

#include "view/stream/timeline.h"

typedef struct web web;

enum { WEB_PORT = 8686, WEB_BROWSERS = 16, WEB_ACTION_BYTES = 32, WEB_PATIENCE = 100, WEB_SECTIONS = 5, WEB_TEXT = 512 }; /* WEB_TEXT: bytes, longest text */

/* A message from a browser: 32 bytes, little-endian, followed by text for ACTION_CHANGE or by a PNG for ACTION_PICTURE. */
typedef enum { ACTION_ACKNOWLEDGE = 1, ACTION_TAKE, ACTION_STEER, ACTION_RESET, ACTION_RELEASE, ACTION_PICTURE, ACTION_HOLE, ACTION_DROP, ACTION_UNDO,
               ACTION_LEAVE, ACTION_REMOVE, ACTION_PROBE, ACTION_START, ACTION_FINISH, ACTION_LOOK, ACTION_CHANGE, ACTION_LAST = ACTION_CHANGE } action_kind;
typedef struct {
    uint32_t kind;
    float steer[6];          /* ACTION_STEER and ACTION_PROBE: right, up, forward, pitch, yaw, roll, each from -1 to 1; ACTION_HOLE: guide, column, row;
                                ACTION_DROP: seeds; ACTION_LOOK: positions of the axial and the sagittal image and their depth, m, and 1 if the sagittal image
                                is wanted; ACTION_CHANGE: duration, s */
    uint32_t needle;         /* ACTION_TAKE, ACTION_REMOVE: index of the needle; ACTION_STEER, ACTION_PROBE: a number that the next status returns;
                                ACTION_FINISH: language of the report, see training_finish; ACTION_CHANGE: a number that the status with the reply returns */
} web_action;
_Static_assert(sizeof(web_action) == WEB_ACTION_BYTES, "link.js writes 32 bytes");

/* Data that each browser gets whenever it changes. Only the newest version is kept. */
typedef struct {
    byte_buffer bytes;       /* encoded section */
    int64_t version;         /* incremented with each change; 0 before the first */
} web_section;

/* The browser for which `describe` returns the state. */
typedef struct {
    int number, count;       /* its number (1 to WEB_BROWSERS, the smallest that was free when it connected), and how many browsers are connected */
    int driver;              /* number of the browser that drives a needle, 0 if none does */
    uint32_t steered;        /* number of its last ACTION_STEER or ACTION_PROBE, 0 before the first */
} web_page;

typedef struct {
    const char *page;        /* folder of the built page */
    const char *task_folder, *runs_folder; /* served as task/ and runs/; NULL without a task */
    const char *address;     /* address to listen on; NULL for 127.0.0.1 */
    const char *socket;      /* Unix socket to listen on instead of an address, or NULL */
    const char *host;        /* host name to allow besides localhost and `address`, or NULL */
    int port;                /* 0 for any free port */
    int patience;            /* statuses (ten per second) without a message before a browser is disconnected; 0 for WEB_PATIENCE */
    const timeline *timeline;
    const byte_buffer *scene; /* the encoded scene, which is sent first */
    const web_section *sections[WEB_SECTIONS]; /* [section_count]; sent after the scene */
    int section_count;
    void *context;           /* passed to the functions below */
    char *(*describe)(void *context, const web_page *page);      /* returns the state as JSON for this browser, freed by the caller; NULL for none */
    void (*act)(void *context, const web_action *action);        /* handles an action of the driving browser. ACTION_REMOVE, ACTION_START and ACTION_FINISH may
                                                                    also come from another one while none drives, ACTION_LOOK from any */
    void (*change)(void *context, const web_action *action, const char *values); /* handles ACTION_CHANGE, with its text, from any browser; NULL to ignore it */
    bool (*may_drive)(void *context, uint32_t needle);  /* true if a browser may take and keep this needle; NULL for always */
    void (*take_png)(void *context, const void *png, size_t size); /* NULL to reject pictures */
} web_settings;

/* Creates the server, which listens at once. The strings in `settings` must outlive it. Returns BAD_INPUT if the page does not exist or the address cannot be
   used. */
trocar_status web_create(const web_settings *settings, web **created, trocar_error *why);
void web_free(web *w);
int web_port(const web *w);

/* Calls `readable` whenever the descriptor is readable. The caller keeps the descriptor. */
trocar_status web_watch(web *w, int descriptor, void (*readable)(void *context), trocar_error *why);

/* Waits for events and handles them. */
void web_round(web *w);

/* Tells the server that the timeline or a section has new data. */
void web_news(web *w);

/* True if the newest version of this section (one of those in the settings) has been passed on for sending to a browser, or if there is no browser. */
bool web_delivered(const web *w, const web_section *section);

/* Takes the needle from the driving browser, if there is one. */
void web_let_go(web *w);

/* True if this Host header is allowed. This protects against DNS rebinding, in which a site's name resolves to 127.0.0.1. */
bool web_host_allowed(const char *host, const char *address, const char *name);

/* True if a page from `origin` may open a WebSocket with this Host header. Only pages that this program served under an allowed name may; otherwise, another
   site's page could drive the needle. */
bool web_origin_allowed(const char *origin, const char *host, const char *address, const char *name);

#endif

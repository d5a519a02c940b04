/* WebSocket clients that connect again by themselves, and a timer, in one loop of libwebsockets. */
#ifndef TROCAR_HAPLY_NETWORK_H
#define TROCAR_HAPLY_NETWORK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "base/report.h"

enum { NETWORK_TEXT = 1 << 18 };  /* bytes of the longest message that is received; a longer one is empty */

struct lws;
typedef struct network network;

typedef struct {
    const char *address;
    int port;                /* 0: never connects */
    double retry;            /* s between attempts to connect */
    void *context;
    void (*opened)(void *context);
    void (*closed)(void *context, const char *why);       /* also called after each failed attempt */
    void (*received)(void *context, const char *text, size_t length);
    size_t (*write)(void *context, char *text, size_t size); /* writes a requested message; returns its length, 0: none */

    /* the network's */
    struct lws *wsi;
    bool open, trying, overlong;
    int64_t retry_at;        /* ns */
    size_t length;
    char text[NETWORK_TEXT];
} websocket;

/* `tick` is called `rate` times a second. */
trocar_status network_create(double rate, void (*tick)(void *context), void *context, network **created, report *why);
void network_free(network *n);

/* Waits for events and handles them; returns after a signal, too. */
void network_round(network *n);

/* Connects if it is time to. Call it in every tick. */
void websocket_keep(network *n, websocket *s);

void websocket_ask_to_write(websocket *s);

/* Closes the connection soon; it is opened again afterwards. */
void websocket_drop(websocket *s);

#endif

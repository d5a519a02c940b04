/* WebSocket clients that reconnect automatically, and a timer, all in one event loop of libwebsockets. */
#ifndef TROCAR_HAPLY_NETWORK_H
#define TROCAR_HAPLY_NETWORK_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "base/error.h"

enum { NETWORK_TEXT = 1 << 18 };  /* bytes, longest message that can be received; longer ones are delivered as empty strings */

struct lws;
typedef struct network network;

typedef struct {
    const char *address;
    int port;                /* 0 if this client never connects */
    double retry;            /* s, interval between connection attempts */
    void *context;
    void (*opened)(void *context);
    void (*closed)(void *context, const char *why);       /* called when the connection closes and after each failed attempt to connect */
    void (*received)(void *context, const char *text, size_t length);
    size_t (*write)(void *context, char *text, size_t size); /* writes the message to send and returns its length, or 0 if there is nothing to send */

    /* used only inside network.c */
    struct lws *wsi;
    bool open, trying, overlong;
    int64_t retry_at;        /* ns */
    size_t length;
    char text[NETWORK_TEXT];
} websocket;

/* Creates the event loop, which calls `tick` at `rate` times per second. */
trocar_status network_create(double rate, void (*tick)(void *context), void *context, network **created, trocar_error *why);
void network_free(network *n);

/* Waits for events and handles them. Also returns when a signal arrives. */
void network_round(network *n);

/* Keeps the client connected: makes the next attempt if one is due. Call it in every tick. */
void websocket_keep(network *n, websocket *s);

void websocket_ask_to_write(websocket *s);

/* Closes the connection as soon as possible; websocket_keep opens it again. */
void websocket_drop(websocket *s);

#endif

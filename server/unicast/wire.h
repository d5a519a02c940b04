/* Datagrams of the unicast protocol, and their authentication. All numbers are big-endian, and every datagram ends with a 32-byte tag, the HMAC-SHA256 of the
   bytes before it. A datagram begins with "TU1" and its kind (1 byte):

       handshake   kind | client's nonce (16) | token (24) | tag
       message     kind | counter (8) | channel name with terminating zero | LCM message | tag

   A sender's counter increases with each message. An empty message (channel "", no bytes) only shows that its sender is still there.

   Keys: secret key      = HMAC("trocar unicast 1", content of the secret file)        for the handshake
         key to server   = HMAC(secret key, "to server" | client's nonce | server's nonce (24))
         key to client   = HMAC(secret key, "to client" | client's nonce | server's nonce (24)) */
#ifndef TROCAR_WIRE_H
#define TROCAR_WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum {
    WIRE_KEY = 32, WIRE_TAG = 32, WIRE_NONCE = 16, WIRE_TOKEN = 24,
    WIRE_HEAD = 4,
    WIRE_HANDSHAKE = WIRE_HEAD + WIRE_NONCE + WIRE_TOKEN + WIRE_TAG,
    WIRE_CHANNEL_MOST = 63,      /* bytes, not counting the terminating zero, as in LCM */
    WIRE_MESSAGE_MOST = 1024,    /* bytes, largest LCM message */
    WIRE_OVERHEAD = WIRE_HEAD + 8 + WIRE_CHANNEL_MOST + 1 + WIRE_TAG,
    WIRE_MOST = WIRE_OVERHEAD + WIRE_MESSAGE_MOST
};

typedef enum {
    WIRE_HELLO = 1,              /* client: asks for a cookie; the token is zero */
    WIRE_COOKIE,                 /* server: the token is a cookie. Returning it proves that the client receives at its address */
    WIRE_CONNECT,                /* client: returns the cookie */
    WIRE_WELCOME,                /* server: the token is the server's nonce; the client is connected */
    WIRE_REFUSED,                /* server: byte 0 of the token is the reason. For WIRE_WRONG_SECRET, the tag is zero */
    WIRE_TO_SERVER, WIRE_TO_CLIENT /* messages */
} wire_kind;

typedef enum { WIRE_WRONG_SECRET = 1, WIRE_FULL = 2 } wire_reason;

typedef struct {
    unsigned char bytes[WIRE_KEY];
} wire_key;

typedef struct {
    unsigned char nonce[WIRE_NONCE], token[WIRE_TOKEN];
} wire_handshake;

typedef struct {
    uint64_t counter;
    const char *channel;         /* this and the next member point into the datagram */
    const unsigned char *bytes;
    size_t size;
} wire_message;

void wire_put_number(unsigned char to[8], uint64_t number);
uint64_t wire_get_number(const unsigned char *from, int width); /* width: bytes */

void wire_tag(const wire_key *key, const void *data, size_t size, unsigned char tag[WIRE_TAG]);
wire_key wire_secret_key(const void *secret, size_t size);
/* Returns the key for one direction. `kind` is WIRE_TO_SERVER or WIRE_TO_CLIENT. */
wire_key wire_direction_key(const wire_key *secret, wire_kind kind, const unsigned char nonce[WIRE_NONCE], const unsigned char token[WIRE_TOKEN]);

/* Returns the datagram's kind, or 0 if the kind is unknown or impossible at this size. Does not check the tag. */
int wire_kind_of(const void *datagram, size_t size);
/* Returns whether the datagram ends with the right tag. Takes the same time for any tag. */
bool wire_is_authentic(const wire_key *key, const void *datagram, size_t size);

/* Write a datagram and return its size. `key` may be NULL for a handshake, whose tag is then zero. */
size_t wire_put_handshake(unsigned char to[WIRE_HANDSHAKE], wire_kind kind, const wire_handshake *h, const wire_key *key);
size_t wire_put_message(unsigned char to[WIRE_MOST], wire_kind kind, uint64_t counter, const char *channel, const void *bytes, size_t size,
                        const wire_key *key);

/* Read a datagram whose kind and size have been checked with wire_kind_of. wire_get_message returns false if the channel name is not terminated. */
wire_handshake wire_get_handshake(const void *datagram);
bool wire_get_message(const void *datagram, size_t size, wire_message *m);

/* The anti-replay window of one direction, which keeps track of the counters received. A message is accepted even if up to 63 later ones arrive first.
   Zero-initialise; counters begin at 1. */
typedef struct {
    uint64_t newest, seen;       /* bit i of `seen`: newest - i has been received */
} wire_window;

/* Returns false if the counter has been received before or is too old to tell; otherwise records it and returns true. Call this for authentic messages only. */
bool wire_window_accepts(wire_window *w, uint64_t counter);

#endif
